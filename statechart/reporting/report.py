"""A run as one plain object: what `statechart run --json` prints."""

from __future__ import annotations

import json
import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import zip_longest
from typing import Any

from statechart.automaton.dense_output import lowest
from statechart.automaton.regions import Invariant, whole_margins
from statechart.automaton.trace import Arc, Jump, Key, Roles, Trace
from statechart.documents.setting import Record
from statechart.execution.simulator import Simulator
from statechart.observation.grazes import grazes, told
from statechart.observation.observer import Observer
from statechart.observation.outputs import outputs
from statechart.reporting.inventory import built, left_out, unkept_invariants
from statechart.reporting.pieces import Pieces


def report(
    observer: Observer,
    trace: Trace,
    *,
    error_estimate: float | None = None,
    timings: Mapping[str, float] | None = None,
    explain: bool = False,
    most: int | None = None,
    asked: Mapping[str, Any] | None = None,
    conditions: Sequence[float | None] = (),
    pieces: Pieces | None = None,
) -> dict[str, Any]:
    """Return a run as an object of dicts, lists, strings and numbers.

    Infinite and undefined numbers are the strings ``"inf"``, ``"-inf"`` and ``"nan"``, since
    strict JSON has no others; `float` reads all three, and ``json.dumps(..., allow_nan=False)``
    never fails. Finite floats keep all their digits.

    Parameters
    ----------
    observer : Observer
        Of the simulator that made the run.
    trace : Trace
        The run.
    error_estimate : float, optional
        Of the final state, where an accuracy was asked for.
    timings : mapping of str to float, optional
        What took how many seconds.
    explain : bool
        Give every event its `margins`: those of the mode left, at that instant.
    most : int, optional
        How many of the first events `events` has; all by default.
    asked : mapping, optional
        What was asked for instead of a tolerance, and what it took.
    conditions : sequence of float or None
        Of every event, from `statechart.observation.condition.conditions`; shown where given.
    pieces : Pieces, optional
        Takes what could not be evaluated, and why, instead of an error; `left_out` has it too.

    Returns
    -------
    dict
        `model`, `outcome`, `message`, `t_end`, `engine`, `record`, `certified`, `evidence`,
        `motion`, `error_estimate`, `asked`, `condition` (the largest of the events'), `modes_total`
        (directions of sliding told apart), `modes_declared` (as users count), `modes_built`,
        `built` (modes with unknowns, guards and evidence), `left_out` (what, and why), `modes`
        (in the order visited), `indeterminate` (modes whose motion leaves quantities of
        regions open, and which), `events`, `final`, `outputs`, `margins`, `invariants` (the least
        margin of each), `warnings`, `counts`, `timings`, `parameters`, `tolerances`,
        `units` (of outputs, variables and parameters, where they are known).
    """
    automaton = observer.automaton
    done = Pieces(strict=True) if pieces is None else pieces
    found_outputs: dict[str, Any] = done.attempt("outputs", lambda: outputs(observer, trace), {})
    found_margins: dict[str, float] = {}
    # Of many events it takes long to say why they were what they were.
    left_open: tuple[str, ...] = ()
    if done.hurried:
        done.leave("margins")
    else:
        found_margins = done.attempt("margins", lambda: margins(observer, trace), {})
        left_open = done.attempt("grazes", lambda: told(grazes(observer, trace)), ())
    found_invariants: dict[str, float] = done.attempt(
        "invariants", lambda: invariants(observer, trace), {}
    )
    jumps = trace.jumps[:most]
    events = _events(observer, trace, jumps, conditions[:most], done, explain=explain)
    without = left_out(automaton, trace)
    without += [{"what": what, "why": why} for what, why in done.failed.items()]
    result = _ended(trace) | {
        "error_estimate": error_estimate,
        "asked": asked,
        "condition": max((c for c in conditions if c is not None), default=None),
        "modes_total": automaton.modes_total,
        "modes_declared": automaton.modes_declared,
        "modes_built": trace.counts.get("modes_built", 0),
        "built": built(observer, trace),
        "left_out": without,
        "modes": [dict(zip(trace.regions, key, strict=True)) for key in trace.modes],
        "indeterminate": [
            {"mode": dict(zip(trace.regions, key, strict=True)), "regions": names}
            for key, names in trace.indeterminate.items()
        ],
        "events": [],
        "final": dict(zip(trace.variables, trace.final.tolist(), strict=True)),
        "outputs": found_outputs,
        "margins": found_margins,
        "invariants": found_invariants,
        "warnings": trace.warnings + left_open,
        "counts": trace.counts,
        "timings": timings or {},
        "parameters": trace.parameters,
        "tolerances": trace.tolerances,
        "units": {
            name: unit
            for name in (*found_outputs, *trace.variables, *trace.parameters)
            if (unit := automaton.declaration.unit(name))
        },
    }
    safe: dict[str, Any] = json_safe(result)
    return safe | {"events": events}


def _ended(trace: Trace) -> dict[str, Any]:
    """Return how a run ended, and how it was computed."""
    return {
        "model": trace.name,
        "outcome": trace.outcome.name,
        "message": trace.message,
        "t_end": trace.t_end,
        "engine": trace.engine,
        "tolerance": None if trace.step is not None else trace.tolerance,
        "step": trace.step,
        "record": trace.record.value,
        "certified": trace.certified,
        "evidence": trace.evidence,
        "motion": None if trace.motion is None else asdict(trace.motion),
    }


def _events(
    observer: Observer,
    trace: Trace,
    jumps: Sequence[Jump],
    conditions: Sequence[float | None],
    pieces: Pieces,
    *,
    explain: bool,
) -> list[dict[str, Any]]:
    """Return each of the jumps as an object; some of them where the time presses."""
    explained: Sequence[dict[str, float]] = ()
    if explain and not pieces.hurried:
        explained = pieces.attempt("margins of events", lambda: observer.margins(trace, jumps), [])

    def made(short: bool) -> list[dict[str, Any]]:
        found: Sequence[tuple[Any, Any, Any]]
        found = list(zip_longest(jumps, conditions, explained))
        if short:
            pieces.leave("considered")
            found = pieces.some("events", found, len(trace.variables))
        return [_event(trace, *of, hurried=short) for of in found]

    kept: list[dict[str, Any]] = pieces.keep("events", made, [])
    return kept


def margins(observer: Observer, trace: Trace) -> dict[str, float]:
    """Return the least value seen of every margin, on a grid of 16 places in every step.

    A margin counts in the modes whose invariant it belongs to. Where an event ended an arc, its
    margin is about zero, or below it by less than its tolerance. A run that noted them itself, at
    its steps, is believed.
    """
    if trace.margins is not None:
        return dict(sorted(trace.margins.items()))
    simulator = observer.simulator
    assert isinstance(simulator, Simulator)
    least: dict[str, float] = {}
    flows: dict[tuple[Roles, int], list[Arc]] = {}
    for arc in trace.arcs:
        flows.setdefault((arc.roles, arc.coefficients.shape[2]), []).append(arc)
    for (roles, _), arcs in flows.items():
        compiled = simulator.compiled(roles, trace.zeros)
        found = lowest(compiled.wholes, [arc.flow for arc in arcs], trace.values)
        for margin, value in zip(whole_margins(compiled.mode.margins), found.tolist(), strict=True):
            before = least.get(margin.name, math.inf)
            # Once undefined, always undefined: NaN compares false.
            least[margin.name] = before if before <= value or before != before else value
    return dict(sorted(least.items()))


def invariants(observer: Observer, trace: Trace) -> dict[str, float]:
    """Return the least margin of every invariant of the run: below 0 it does not hold.

    Those of states that the run has not kept are missing, and all where it kept nothing.
    """
    if trace.record is Record.NOTHING:
        return {}
    automaton = observer.automaton

    def least(one: Invariant) -> float:
        if not one.relation.members:
            return observer.extremes(trace, one.margin(automaton.active(())).expression)[0]
        return observer.lowest(trace, lambda key: one.margin(automaton.active(key)).expression)

    lost = unkept_invariants(automaton, trace)
    return {one.name: least(one) for one in automaton.invariants if one not in lost}


def dumps(report: Mapping[str, Any]) -> str:
    """Return a report as JSON, every event on a line of its own.

    Floats are printed with the fewest digits that read back as the same float.
    """
    parts = []
    for key, value in report.items():
        if key == "events" and value:
            lines = ",\n    ".join(json.dumps(event, allow_nan=False) for event in value)
            text = f"[\n    {lines}\n  ]"
        else:
            text = json.dumps(value, indent=2, allow_nan=False).replace("\n", "\n  ")
        parts.append(f"  {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def json_safe(value: Any) -> Any:
    """Return `value` with tuples as lists, keys as text, and non-finite floats as text."""
    # Of many events most values are numbers and names: what they are is asked for first.
    if isinstance(value, float):
        return value if math.isfinite(value) else repr(float(value))
    if isinstance(value, str | int):
        return value
    # What is safe already is returned itself: copies of many events would fill the memory.
    if isinstance(value, list | tuple):
        items = [json_safe(item) for item in value]
        same = type(value) is list and all(map(operator.is_, items, value))
        return value if same else items
    if isinstance(value, Mapping):
        safe = {str(key): json_safe(item) for key, item in value.items()}
        same = type(value) is dict and all(
            key is mine and item is value[key]
            for key, (mine, item) in zip(value, safe.items(), strict=False)
        )
        return value if same else safe
    return value


def _event(
    trace: Trace,
    jump: Jump,
    condition: float | None,
    explained: Mapping[str, float] | None,
    *,
    hurried: bool,
) -> dict[str, Any]:
    names = trace.variables
    before, after = jump.before.tolist(), jump.after.tolist()
    energy = None if jump.energy is None else list(jump.energy)
    event: dict[str, Any] = {
        "t": jump.t,
        "j": jump.j,
        "contact": jump.region or None,
        "cause": jump.cause,
        "from": _states(trace, jump.source),
        "to": _states(trace, jump.target),
        "state": dict(zip(names, after, strict=True)),
        "state_before": dict(zip(names, before, strict=True)),
        "impulse": {
            region: {"normal": normal, "tangential": tangential}
            for region, (normal, tangential) in jump.impulse.items()
        },
        "fired": list(jump.fired),
        "path": list(jump.path),
        "considered": {} if hurried else dict(jump.considered),
        "energy": energy,
        "skipped": jump.skipped,
        "condition": condition,
    }
    if explained is not None:
        event["margins"] = explained
    numbers = [*before, *after, *(energy or ()), jump.skipped, condition or 0.0]
    numbers += [size for pair in jump.impulse.values() for size in pair]
    numbers += (explained or {}).values()
    # Of many events hardly one has a number that JSON has not.
    if all(map(math.isfinite, numbers)):
        return event
    safe: dict[str, Any] = json_safe(event)
    return safe


def _states(trace: Trace, key: Key) -> dict[str, str]:
    return dict(zip(trace.regions, key, strict=True))
