"""Judgement of a located event: integrator noise, an event, or undecided."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.automaton.laws import Flow, Instant, Setup
from statechart.engines.engine import Engine, FlowWatch
from statechart.engines.event_location import Crossing, Search, Verdict
from statechart.engines.path import Path
from statechart.errors import NonFinite, Undecided
from statechart.execution.compiled_modes import CompiledMode
from statechart.formulas.series import sizes_at
from statechart.kernels.polynomials import sample_states

# Errors of dense output, in tolerances of the engine.
_NOISE = 100.0
# A gap that is closed to this part of its tolerance as the run ends has just closed.
AT_END = 1e-2
_LOCATED = (Verdict.CROSSING, Verdict.GRAZE)


def noise(
    engine: Engine,
    compiled: CompiledMode,
    watch: FlowWatch,
    path: Path,
    initial: Array,
    found: Search,
) -> Array | None:
    """Return wider tolerances where what was found is no fall but noise; None where it may be one.

    The laws have kept a mode whose margin starts at zero: it rises from there, or stays. Where its
    first derivatives are zero the polynomials are so to their own errors only, and may dip below
    zero before it rises.
    """
    where = found.crossing or found.undecided
    if where is None or where.guard < 0 or found.verdict not in _LOCATED:
        return None
    guards, parameters, start = compiled.guards, watch.parameters, watch.start
    tolerance = watch.tolerances.item(where.guard)
    begun = guards.values(initial, parameters, start).item(where.guard)
    if compiled.kind(where.guard) != "plain" or not abs(begun) <= tolerance:
        return None
    sizes = np.maximum(np.abs(path.coefficients[where.step]).sum(axis=1), engine.floor)
    times, terms = path.times[: where.step + 2], path.coefficients[: where.step + 1]
    middle = sample_states(terms, times, np.array([0.5 * where.time]))[0]
    margin = guards.values(middle, parameters, start + 0.5 * where.time).item(where.guard)
    (size,) = sizes_at(guards, (where.guard,), middle, sizes, parameters, start + where.time)
    wider = _NOISE * engine.tolerance * size
    # Twice as wide at least each time, so that this comes to an end.
    if margin > wider or not wider > 2.0 * tolerance:
        return None
    tolerances = watch.tolerances.copy()
    tolerances[where.guard] = wider
    return tolerances


def decided(
    found: Search,
    compiled: CompiledMode,
    watch: FlowWatch,
    path: Path,
) -> Crossing:
    """Return the event that a search found or must be taken for one; raise where it is neither."""
    where = found.crossing or found.undecided
    assert where is not None
    time = watch.start + where.time
    if found.verdict is Verdict.CROSSING:
        return where
    if found.verdict is Verdict.GRAZE:
        return where
    names = compiled.names
    if found.verdict is Verdict.BUDGET:
        raise Undecided(
            f"no decision within {found.boxes} boxes on one of the guards {', '.join(names)}"
        )
    # An end of the run may lie where the equations end too: the cosine under a force vanishes as
    # the stick lies flat. A margin that is zero there to within its tolerance has been reached.
    terms = path.coefficients[where.step]
    state = (terms * where.s ** np.arange(terms.shape[1])).sum(axis=1)
    margins = compiled.guards.values(state, watch.parameters, time)
    for guard, (value, tolerance) in enumerate(zip(margins, watch.tolerances, strict=True)):
        if compiled.kind(guard) == "plain" and abs(value) <= tolerance < math.inf:
            return where._replace(guard=guard, crossed=where.time)
    name = names[where.guard] if where.guard >= 0 else "one of " + ", ".join(names)
    raise NonFinite(
        f"the guard {name} cannot be evaluated near t = {time:.6g}; look for a logarithm, a root "
        "or a quotient without a value there, such as a height where it ends"
    )


def closing(
    engine: Engine, compiled: CompiledMode, flow: Flow, setup: Setup, state: Array, time: float
) -> tuple[bool, dict[str, float]]:
    """Return whether something may just be happening in a state, and the tolerances of the flow.

    Those of margins that a run may be off by more than by their own are wider.
    """
    guards, parameters = compiled.guards, setup.values
    margins = guards.values(state, parameters, time).tolist()
    sizes = np.abs(state) if flow.sizes is None else flow.sizes
    closed, tolerances = False, {**flow.tolerances}
    wider = tuple(
        place
        for place, (name, kind) in enumerate(compiled.watched)
        if kind == "plain" and tolerances.get(name, math.inf) < math.inf
    )
    terms = dict(zip(wider, sizes_at(guards, wider, state, sizes, parameters, time), strict=True))
    for place, ((name, kind), margin) in enumerate(zip(compiled.watched, margins, strict=True)):
        if kind == "gap":
            closed |= margin <= AT_END * setup.tolerances[kind]
        elif kind == "speed":
            closed |= margin <= setup.tolerances[kind]
        elif place in terms:
            tolerances[name] = max(tolerances[name], engine.tolerance * terms[place])
            closed |= margin <= tolerances[name]
    return closed, tolerances


def alone(compiled: CompiledMode, at: Instant, stops: int) -> bool:
    """Return whether nothing but stops, which stand last, is on its boundary at an instant."""
    margins = compiled.guards.values(at.state, at.setup.values, at.clock.high).tolist()
    usual, special = at.setup.tolerances, at.flow.tolerances
    watched = zip(compiled.watched[: len(margins) - stops], margins, strict=False)
    for (name, kind), margin in watched:
        tolerance = special.get(name, usual[kind])
        if tolerance < math.inf and not margin > tolerance:
            return False
    return True


def from_here(compiled: CompiledMode, flow: Flow, setup: Setup, state: Array, time: float) -> Flow:
    """Return a flow in which forces that begin beyond their bounds fall from where they begin."""
    usual, tolerances = setup.tolerances["force"], {**flow.tolerances}
    margins = compiled.guards.values(state, setup.values, time).tolist()
    for (name, kind), margin in zip(compiled.watched, margins, strict=True):
        if kind == "force" and margin < 0.0 and name not in tolerances:
            tolerances[name] = usual - margin
    return flow._replace(tolerances=tolerances)
