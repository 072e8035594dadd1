"""What a run built, and what it left out and why: only what the model requires is there."""

from __future__ import annotations

from typing import Any

from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import HELD, moving_mode
from statechart.automaton.regions import Invariant
from statechart.automaton.trace import Trace
from statechart.documents.setting import Record
from statechart.execution.simulator import Simulator
from statechart.observation.observer import Observer
from statechart.tabular import several, whole


def built(observer: Observer, trace: Trace) -> dict[str, Any]:
    """Return what a run built."""
    automaton = observer.automaton
    simulator = observer.simulator
    if not isinstance(simulator, Simulator):
        return {
            "modes": [],
            "unknowns": len(automaton.unknowns),
            "recognised": len(set(trace.modes)),
        }
    modes: dict[tuple[str, ...], dict[str, Any]] = {}
    rates = () if automaton.coordinates is None else automaton.coordinates.rates
    named = enumerate(zip(automaton.names, automaton.variables, strict=True))
    coordinates = [(i, name) for i, (name, symbol) in named if symbol not in rates]
    for arc in trace.arcs:
        key = moving_mode(arc.roles)
        if HELD in key or key in modes:
            continue
        mode = simulator.compiled(arc.roles, trace.zeros).mode
        # Contacts that are open have forces that are zero: they are no unknowns.
        known = {s for s, e in mode.definitions if e == 0}
        known |= {mode.rates[place] for place in mode.eliminated}
        solved = {s for s, _ in mode.definitions if s in automaton.unknowns} - known
        modes[key] = {
            "mode": dict(zip(trace.regions, key, strict=True)),
            "integrated": [n for i, n in coordinates if i not in mode.eliminated],
            "eliminated": [n for i, n in coordinates if i in mode.eliminated],
            "unknowns": len(solved),
            "guards": {m.name: trace.evidence.get(m.name, "") for m in mode.margins},
        }
    return {
        "modes": list(modes.values()),
        "unknowns": max((mode["unknowns"] for mode in modes.values()), default=0),
        "recognised": 0,
    }


def unkept_invariants(automaton: Automaton, trace: Trace) -> list[Invariant]:
    """Return the invariants that ask for states which the run has not kept."""
    kept = {*trace.regions}
    return [
        one
        for one in automaton.invariants
        if not kept.issuperset(member.region for member in one.relation.members)
    ]


def left_out(automaton: Automaton, trace: Trace) -> list[dict[str, str]]:
    """Return what a run did without: `what`, and `why`."""
    found = []
    total, made = automaton.modes_total, trace.counts.get("modes_built", 0)
    if trace.step is not None:
        found.append(
            {
                "what": f"the equations of {'all ' * (total > 1)}{several(total, 'mode')}",
                "why": "a step solves for all contacts at once, and modes are told from it",
            }
        )
        found.append(
            {
                "what": "guards and the location of events",
                "why": "events are at steps, or half-way",
            }
        )
        if trace.record is not Record.MODES:
            found.append(
                {
                    "what": "modes of contacts and their events",
                    "why": f"record: {trace.record.value} keeps none; ask for record: modes",
                }
            )
    elif made < total:
        found.append(
            {
                "what": f"the equations of {whole(total - made)} of {several(total, 'mode')}",
                "why": "the run did not enter them",
            }
        )
    found += [
        {
            "what": f"the invariant {one.name!r}",
            "why": f"record: {trace.record.value} keeps none of its states; ask for record: modes",
        }
        for one in unkept_invariants(automaton, trace)
    ]
    omitted = automaton.declaration.omitted(trace.parameters, stepped=trace.step is not None)
    return found + [{"what": what, "why": why} for what, why in omitted.items()]
