"""Report of a run: the object that `statechart run --json` prints."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import HELD, moving_mode
from statechart.automaton.regions import Invariant
from statechart.automaton.trace import Arc, Jump, Key, Roles, Trace
from statechart.documents.setting import Record
from statechart.execution.simulator import Simulator
from statechart.formulas.tape import Tape
from statechart.observation.grazes import graze_warnings, grazes
from statechart.observation.observer import Observer
from statechart.observation.outputs import extremes, outputs_of, undefined_warnings
from statechart.observation.sampling import sample_arcs, subdivide
from statechart.reporting.partial_report import PartialReport
from statechart.tabular import pluralise, readable_count

_MAX_ARCS = 1024  # sampled at once


class Computation(NamedTuple):
    """Costs and accuracy of a run that its trace does not contain."""

    error_estimate: float | None = None  # if an accuracy was requested
    timings: Mapping[str, float] = MappingProxyType({})  # seconds by part
    request: Mapping[str, Any] | None = None  # requested accuracy or budget, and its cost
    conditions: Sequence[float | None] = ()  # condition number of every event


def report(
    observer: Observer,
    trace: Trace,
    computation: Computation = Computation(),  # noqa: B008, it does not change
    *,
    explain: bool = False,
    most: int | None = None,
    pieces: PartialReport | None = None,
) -> dict[str, Any]:
    """Return a run as an object of dicts, lists, strings and numbers.

    Infinite and undefined numbers are the strings ``"inf"``, ``"-inf"`` and ``"nan"``, which
    `float` reads, since strict JSON has none. Finite floats keep all their digits. With `explain`
    every event has the `margins` of its source mode at that instant. The first `most` events are
    reported. Parts that fail are recorded in `pieces` and `left_out` instead of raising an error.

    Returns
    -------
    dict
        `model`, `outcome`, `message`, `t_end`, `engine`, `record`, `certified`, `evidence`,
        `motion`, `error_estimate`, `asked`, `condition` (the largest of the events), `modes_total`
        (with directions of sliding), `modes_declared` (without), `modes_built`, `built` (modes with
        unknowns, guards and evidence), `left_out` (`what` and `why`), `modes` (in the order
        visited), `indeterminate` (modes with undetermined quantities, and their regions),
        `events`, `final`, `outputs`, `margins`, `invariants` (their least margins), `warnings`,
        `counts`, `timings`, `parameters`, `tolerances`, `units` (of outputs, variables and
        parameters).
    """
    automaton, conditions = observer.automaton, computation.conditions
    done = PartialReport(strict=True) if pieces is None else pieces
    found_outputs: dict[str, Any] = done.attempt(
        "outputs", lambda: outputs_of(observer).of(trace), {}
    )
    found_margins: dict[str, float] = {}
    left_open: tuple[str, ...] = ()
    if done.hurried:
        done.leave("margins")
    else:
        found_margins = done.attempt("margins", lambda: margins(observer, trace), {})
        left_open = done.attempt("grazes", lambda: graze_warnings(grazes(observer, trace)), ())
    found_invariants: dict[str, float] = done.attempt(
        "invariants", lambda: invariants(observer, trace), {}
    )
    jumps = trace.jumps[:most]
    events = _event_rows(observer, trace, jumps, conditions[:most], done, explain=explain)
    unused = unused_parts(automaton, trace)
    unused += [{"what": what, "why": why} for what, why in done.failed.items()]
    result = _outcome(trace) | {
        "error_estimate": computation.error_estimate,
        "asked": computation.request,
        "condition": max((c for c in conditions if c is not None), default=None),
        "modes_total": automaton.modes_total,
        "modes_declared": automaton.modes_declared,
        "modes_built": trace.counts.get("modes_built", 0),
        "built": built(observer, trace),
        "left_out": unused,
        "modes": [],
        "indeterminate": [
            {"mode": _states_by_region(trace, key), "regions": names}
            for key, names in trace.indeterminate.items()
        ],
        "events": [],
        "final": dict(zip(trace.variables, trace.final.tolist(), strict=True)),
        "outputs": found_outputs,
        "margins": found_margins,
        "invariants": found_invariants,
        "warnings": trace.warnings + left_open + undefined_warnings(found_outputs),
        "counts": trace.counts,
        "timings": computation.timings,
        "parameters": trace.parameters,
        "tolerances": trace.tolerances,
        "units": {
            name: unit
            for name in (*found_outputs, *trace.variables, *trace.parameters)
            if (unit := automaton.declaration.unit(name))
        },
    }
    safe: dict[str, Any] = json_safe(result)
    modes = [_states_by_region(trace, key) for key in trace.modes]
    return safe | {"modes": modes, "events": events}


def _outcome(trace: Trace) -> dict[str, Any]:
    """Return the outcome and the settings of a run."""
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


def _event_rows(
    observer: Observer,
    trace: Trace,
    jumps: Sequence[Jump],
    conditions: Sequence[float | None],
    pieces: PartialReport,
    *,
    explain: bool,
) -> list[dict[str, Any]]:
    """Return the jumps as objects, a selection after a signal to end."""
    explained: Sequence[dict[str, float]] = ()
    if explain and not pieces.hurried:
        explained = pieces.attempt("margins of events", lambda: observer.margins(trace, jumps), [])

    def make_events(short: bool) -> list[dict[str, Any]]:
        found: Sequence[tuple[Any, Any, Any]]
        found = list(zip_longest(jumps, conditions, explained))
        if short:
            pieces.leave("considered")
            found = pieces.some("events", found, len(trace.variables))
        return [_event(trace, *of, hurried=short) for of in found]

    kept: list[dict[str, Any]] = pieces.keep("events", make_events, [])
    return kept


def margins(observer: Observer, trace: Trace) -> dict[str, float]:
    """Return the least value of every margin, sampled at 16 points per step in its modes.

    At an event the margin is zero to within its tolerance. Time stepping records its own margins.
    """
    if trace.margins is not None:
        return dict(sorted(trace.margins.items()))
    least: dict[str, float] = {}
    flows: dict[Roles, list[Arc]] = {}
    for arc in trace.arcs:
        flows.setdefault(arc.roles, []).append(arc)
    for roles, arcs in flows.items():
        shown, tape = observer.margins_of(trace, roles)
        pairs = lowest(tape, arcs, trace.values).reshape(2, -1).T.tolist()
        for margin, (value, coefficient) in zip(shown, pairs, strict=True):
            if math.isinf(coefficient):
                continue
            before = least.get(margin.name, math.inf)
            # NaN compares false and persists.
            least[margin.name] = before if before <= value or before != before else value
    return dict(sorted(least.items()))


def lowest(tape: Tape, arcs: Sequence[Arc], parameters: Array, per_step: int = 16) -> Array:
    """Return the least value (n_out,) of every output of a tape on a grid along arcs."""
    result = np.full(len(tape.outputs), np.inf)
    for first in range(0, len(arcs), _MAX_ARCS):
        batch = arcs[first : first + _MAX_ARCS]
        points = sample_arcs(batch, subdivide(batch, per_step))
        values = tape.table(points.states, parameters, points.times)
        result = np.minimum(result, values.min(axis=0, initial=np.inf))
    return result


def invariants(observer: Observer, trace: Trace) -> dict[str, float]:
    """Return the least margin of every invariant; a negative one is violated.

    Invariants on states that the run did not record are missing.
    """
    if trace.record is Record.NOTHING:
        return {}
    automaton = observer.automaton

    def least(one: Invariant) -> float:
        def margin(key: Key) -> sp.Expr:
            return one.margin(automaton.active(key)).expression

        # `record: poses` stores no modes; an invariant without members does not depend on them.
        return extremes(observer, trace, margin if one.relation.members else margin(()))[0]

    lost = unrecorded_invariants(automaton, trace)
    return {one.name: least(one) for one in automaton.invariants if one not in lost}


def dumps(report: Mapping[str, Any]) -> str:
    """Return a report as JSON, every event on a line of its own."""
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
    if isinstance(value, float):
        return value if math.isfinite(value) else repr(float(value))
    if isinstance(value, str | int):
        return value
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): json_safe(item) for key, item in value.items()}
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
    event: dict[str, Any] = {
        "t": jump.t,
        "j": jump.j,
        "contact": jump.region or None,
        "cause": jump.cause,
        "from": _states_by_region(trace, jump.source),
        "to": _states_by_region(trace, jump.target),
        "state": dict(zip(names, jump.after.tolist(), strict=True)),
        "state_before": dict(zip(names, jump.before.tolist(), strict=True)),
        "impulse": {
            region: {"normal": normal, "tangential": tangential}
            for region, (normal, tangential) in jump.impulse.items()
        },
        "joint_impulse": dict(jump.joint_impulse),
        "fired": list(jump.fired),
        "path": list(jump.path),
        "considered": {} if hurried else dict(jump.considered),
        "energy": None if jump.energy is None else list(jump.energy),
        "skipped": jump.skipped,
        "condition": condition,
    }
    if explained is not None:
        event["margins"] = explained
    try:
        json.dumps(event, allow_nan=False)  # several times as fast as `json_safe`
    except ValueError:
        event = json_safe(event)
    return event


def _states_by_region(trace: Trace, key: Key) -> dict[str, str]:
    return dict(zip(trace.regions, key, strict=True))


def built(observer: Observer, trace: Trace) -> dict[str, Any]:
    """Return the modes that a run built, with their coordinates, unknowns and guards."""
    automaton, simulator = observer.automaton, observer.simulator
    if not isinstance(simulator, Simulator):
        count = len(set(trace.modes))
        return {"modes": [], "unknowns": len(automaton.unknowns), "recognised": count}
    modes: dict[tuple[str, ...], dict[str, Any]] = {}
    rates = () if automaton.coordinates is None else automaton.coordinates.rates
    named = enumerate(zip(automaton.names, automaton.variables, strict=True))
    unknowns = {*automaton.unknowns}
    coordinates = [(i, name) for i, (name, symbol) in named if symbol not in rates]
    for arc in trace.arcs:
        key = moving_mode(arc.roles)
        if HELD in key or key in modes:
            continue
        mode = simulator.modes.compiled(arc.roles, trace.zeros).mode
        # Forces of open contacts are zero and no unknowns.
        known = {s for s, e in mode.definitions if e == 0}
        known |= {mode.rates[place] for place in mode.eliminated}
        solved = {s for s, _ in mode.definitions if s in unknowns} - known
        modes[key] = {
            "mode": _states_by_region(trace, key),
            "integrated": [n for i, n in coordinates if i not in mode.eliminated],
            "eliminated": [n for i, n in coordinates if i in mode.eliminated],
            "unknowns": len(solved),
            "guards": {m.name: trace.evidence.get(m.name, "") for m in mode.margins},
        }
    most = max((mode["unknowns"] for mode in modes.values()), default=0)
    return {"modes": list(modes.values()), "unknowns": most, "recognised": 0}


def unrecorded_invariants(automaton: Automaton, trace: Trace) -> list[Invariant]:
    """Return the invariants on states that the run did not record."""
    regions = ((one, {m.region for m in one.relation.members}) for one in automaton.invariants)
    return [one for one, used in regions if not used <= {*trace.regions}]


def unused_parts(automaton: Automaton, trace: Trace) -> list[dict[str, str]]:
    """Return the unused parts of the model (`what`), with reasons (`why`)."""
    found: dict[str, str] = {}
    total, n_built = automaton.modes_total, trace.counts.get("modes_built", 0)
    modes, record = pluralise(total, "mode"), trace.record.value
    if trace.step is not None:
        found[f"the equations of {'all ' * (total > 1)}{modes}"] = (
            "a step solves all contacts together, and modes follow from the solution"
        )
        found["guards and the location of events"] = "events are at steps, or half-way"
        if trace.record is not Record.MODES:
            found["modes of contacts and their events"] = (
                f"record: {record} stores none; use record: modes"
            )
    elif n_built < total:
        unbuilt = readable_count(total - n_built)
        found[f"the equations of {unbuilt} of {modes}"] = "the run did not enter them"
    for one in unrecorded_invariants(automaton, trace):
        found[f"the invariant {one.name!r}"] = (
            f"record: {record} stores no states; use record: modes"
        )
    found |= automaton.declaration.omitted(trace.parameters, stepped=trace.step is not None)
    return [{"what": what, "why": why} for what, why in found.items()]
