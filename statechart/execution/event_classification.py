"""Classification of a located event: integrator noise, an event, or undecided.

The tolerance of a margin is the round-off of its terms at the start of the flow. Later its error
can be far smaller: after a start at x = -1 the tolerance of ``x**2 - 1e-14`` is 4e-14, but at x = 0
its error is 1e-28. A margin that starts above its tolerance is therefore searched with tolerance
zero first. A fall is an event if it exceeds the change of the margin by errors of the state.
"""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.automaton.laws import Flow, Instant, Setup
from statechart.engines.compiled_flow import EVALUATION_ROUND_OFF
from statechart.engines.engine import Engine, FlowWatch, Path
from statechart.engines.event_location import Crossing, Search, Verdict, search
from statechart.errors import NonFinite, Undecided
from statechart.execution.compiled_modes import CompiledMode
from statechart.formulas.series import sizes_at
from statechart.formulas.tape import Tape
from statechart.kernels.polynomials import sample_states

# Errors of dense output, in tolerances of the engine.
_NOISE = 100.0
# A gap below this part of its tolerance at the end of the run has just closed.
AT_END = 1e-2
_LOCATED = (Verdict.CROSSING, Verdict.GRAZE)
STATE_TOLERANCES, STATE_ROUND_OFF = 10.0, 1e-13
"""Error of a variable: the maximum of tolerances of the engine and a relative error."""


def noise(
    engine: Engine,
    compiled: CompiledMode,
    watch: FlowWatch,
    path: Path,
    initial: Array,
    found: Search,
) -> Array | None:
    """Return wider tolerances if a located fall is noise; None if it may be an event.

    A margin that starts at zero in a mode that holds rises or stays zero. If its first derivatives
    vanish, the polynomials of a step vanish to their own error only, and may dip below zero.
    """
    location = found.crossing or found.undecided
    if location is None or location.guard < 0 or found.verdict not in _LOCATED:
        return None
    guards, parameters, start = compiled.guards, watch.parameters, watch.start
    tolerance = watch.tolerances.item(location.guard)
    initial_margin = guards.values(initial, parameters, start).item(location.guard)
    if compiled.kind(location.guard) != "plain" or not abs(initial_margin) <= tolerance:
        return None
    sizes = np.maximum(np.abs(path.coefficients[location.step]).sum(axis=1), engine.floor)
    times, terms = path.times[: location.step + 2], path.coefficients[: location.step + 1]
    middle = sample_states(terms, times, np.array([0.5 * location.time]))[0]
    margin = guards.values(middle, parameters, start + 0.5 * location.time).item(location.guard)
    (size,) = sizes_at(guards, (location.guard,), middle, sizes, parameters, start + location.time)
    wider = _NOISE * engine.tolerance * size
    # At least doubled each time, so that the repetition ends.
    if margin > wider or not wider > 2.0 * tolerance:
        return None
    tolerances = watch.tolerances.copy()
    tolerances[location.guard] = wider
    return tolerances


def resolve_search(found: Search, compiled: CompiledMode, watch: FlowWatch, path: Path) -> Crossing:
    """Return the located event, or the limit of a singular margin; raise otherwise."""
    location = found.crossing or found.undecided
    assert location is not None
    time = watch.start + location.time
    if found.verdict in _LOCATED:
        return location
    names = compiled.names
    if found.verdict is Verdict.BUDGET:
        raise Undecided(
            f"the search for events of {', '.join(names)} stopped undecided after {found.boxes} "
            "interval evaluations; simplify the guard, or take shorter steps (--max-step)"
        )
    # The equations may be singular at a stop: the cosine in a force vanishes when the stick lies
    # flat, and a friction with sqrt(abs(slip)) has no value beyond it. A margin that is zero there
    # within its tolerance has been reached.
    terms = path.coefficients[location.step]
    state = (terms * location.s ** np.arange(terms.shape[1])).sum(axis=1)
    margins = compiled.guards.values(state, watch.parameters, time)
    for guard, (value, tolerance) in enumerate(zip(margins, watch.tolerances, strict=True)):
        if compiled.kind(guard) in ("plain", "speed") and abs(value) <= tolerance < math.inf:
            return location._replace(guard=guard, crossed=location.time)
    name = names[location.guard] if location.guard >= 0 else "one of " + ", ".join(names)
    raise NonFinite(
        f"the guard {name} has no value near t = {time:.6g}; look for a logarithm, root or "
        "quotient without a value there"
    )


def closing(
    engine: Engine, compiled: CompiledMode, flow: Flow, setup: Setup, state: Array, time: float
) -> tuple[bool, dict[str, float]]:
    """Return whether an event may coincide with a state, and the tolerances of the flow.

    Tolerances below the error of the run are widened.
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


def only_stops(compiled: CompiledMode, at: Instant, stops: int) -> bool:
    """Return whether only margins of stop conditions (the last ones) are on their boundary."""
    margins = compiled.guards.values(at.state, at.setup.values, at.clock.high).tolist()
    defaults, special = at.setup.tolerances, at.flow.tolerances
    watched = zip(compiled.watched[: len(margins) - stops], margins, strict=False)
    for (name, kind), margin in watched:
        tolerance = special.get(name, defaults[kind])
        if tolerance < math.inf and not margin > tolerance:
            return False
    return True


def from_here(compiled: CompiledMode, flow: Flow, setup: Setup, state: Array, time: float) -> Flow:
    """Return a flow whose violated force margins have their initial violations as tolerances."""
    tolerances = {**flow.tolerances}
    margins = compiled.guards.values(state, setup.values, time).tolist()
    for (name, kind), margin in zip(compiled.watched, margins, strict=True):
        if kind in ("force", "hold") and margin < 0.0:
            tolerances[name] = max(tolerances.get(name, 0.0), setup.tolerances[kind] - margin)
    return flow._replace(tolerances=tolerances)


def first_tolerances(compiled: CompiledMode, watch: FlowWatch, state: Array, local: float) -> Array:
    """Return the tolerances of the first search: zero for plain margins above their tolerance."""
    tolerances, plain = watch.tolerances, compiled.plain
    if not (tolerances[plain] > 0.0).any():
        return tolerances
    margins = compiled.guards.values(state, watch.parameters, watch.start + local)
    return np.where(plain & (margins > tolerances), 0.0, tolerances)


def first_event(
    found: Search,
    engine: Engine,
    compiled: CompiledMode,
    watch: FlowWatch,
    path: Path,
    tolerances: Array,
    last: int,
) -> Search:
    """Return the first event among the falls located with `first_tolerances`.

    A fall below the full tolerance, or below the local error of the margin, is an event. Otherwise
    the steps before `last` are searched again with a larger tolerance.
    """
    tolerances = tolerances.copy()
    while found.verdict in _LOCATED:
        location = found.crossing or found.undecided
        assert location is not None
        guard, full_tolerance = location.guard, watch.tolerances.item(location.guard)
        if not tolerances[guard] < full_tolerance:
            break
        repeated = search_steps(watch, path, watch.tolerances, location.step, last)
        if (
            repeated.crossing
            and repeated.crossing.guard == guard
            and _same(repeated.crossing, location)
        ):
            found = repeated
            break
        local, steps = location.time, path.coefficients[:last]
        state = sample_states(steps, path.times[: last + 1], np.array([local]))[0]
        time = watch.start + local
        errors = relative_error(engine) * path_sizes(steps)
        error = margin_errors(compiled.guards, guard, state, errors, watch.parameters, time)
        error = min(full_tolerance, error)
        if found.verdict is Verdict.CROSSING and error <= 2.0 * tolerances[guard]:
            break
        # At least doubled each time, so that the loop ends.
        tolerances[guard] = error if error > 2.0 * tolerances[guard] else full_tolerance
        found = search_steps(watch, path, tolerances, location.step, last)
    return found


def search_steps(watch: FlowWatch, path: Path, tolerances: Array, first: int, last: int) -> Search:
    """Search steps for the first fall of a watched margin."""
    return search(watch.guards, tolerances, path, watch.parameters, watch.start, first, last)


def _same(first: Crossing, second: Crossing) -> bool:
    """Return whether two crossings are the same root within the round-off of time."""
    return first.time <= max(second.time, second.crossed) * (1.0 + EVALUATION_ROUND_OFF)


def relative_error(engine: Engine) -> float:
    """Return the relative error of variables."""
    return max(STATE_TOLERANCES * engine.tolerance, STATE_ROUND_OFF)


def path_sizes(steps: Array) -> Array:
    """Return bounds of the variables (n,) over steps (m, n, d + 1)."""
    bounds: Array = np.abs(steps).sum(axis=2).max(axis=0)
    return bounds


def margin_errors(
    guards: Tape, guard: int, state: Array, errors: Array, parameters: Array, time: float
) -> float:
    """Return the error of a margin in a state (n,) with these `errors` of the variables.

    It is the sum of the changes by each of them, of either sign, by the round-off of time, and by
    that of its terms.
    """
    shifts, delay = np.diag(errors), EVALUATION_ROUND_OFF * abs(time)
    states = np.vstack([state, state, state + shifts, state, state - shifts])
    times = np.full(len(states), time)
    times[[1, len(errors) + 2]] += delay, -delay
    with np.errstate(all="ignore"):
        values = guards.table(states, parameters, times)[:, guard]
    (terms,) = sizes_at(guards, (guard,), state, np.abs(state), parameters, time)
    changes = np.abs(values[1:] - values[0]).reshape(2, -1).max(axis=0)
    return float(changes.sum()) + EVALUATION_ROUND_OFF * terms
