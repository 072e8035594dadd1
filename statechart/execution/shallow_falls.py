"""Falls of a margin by less than its tolerance, judged by the round-off where they happen.

The tolerance of a margin is the round-off of its terms where the flow begins. Elsewhere the margin
can be known far better: after a start at x = -1 the tolerance of ``x**2 - 1e-14`` is 4e-14, but at
x = 0 its error is 1e-28. A margin that begins above its tolerance is therefore searched with
tolerance zero first. What that finds is an event if the margin falls further than an error of the
state changes it by.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array
from statechart.engines.engine import Engine, FlowWatch
from statechart.engines.event_location import Crossing, Search, Verdict, search
from statechart.engines.flow_watch import EVALUATED
from statechart.engines.path import Path
from statechart.execution.compiled_modes import CompiledMode
from statechart.formulas.series import sizes_at
from statechart.formulas.tape import Tape
from statechart.kernels.polynomials import sample_states

STATE_TOLERANCES, STATE_ROUND_OFF = 10.0, 1e-13
"""Error of a variable: so many tolerances of the engine, or that part of its size."""
_LOCATED = (Verdict.CROSSING, Verdict.GRAZE)


def first_tolerances(compiled: CompiledMode, watch: FlowWatch, state: Array, local: float) -> Array:
    """Return the tolerances to search with first, from a state at a local time on.

    They are zero for the plain margins that are above their tolerance there.
    """
    usual, plain = watch.tolerances, compiled.plain
    if not (usual[plain] > 0.0).any():
        return usual
    margins = compiled.guards.values(state, watch.parameters, watch.start + local)
    return np.where(plain & (margins > usual), 0.0, usual)


def judge(
    found: Search,
    engine: Engine,
    compiled: CompiledMode,
    watch: FlowWatch,
    path: Path,
    tolerances: Array,
    last: int,
) -> Search:
    """Return the first event among the falls that a search with `first_tolerances` comes upon.

    A fall below the usual tolerance is one, and a fall below the local error of the margin. The
    steps before `last` are searched again with a larger tolerance where a fall is neither.
    """
    tolerances = tolerances.copy()
    while found.verdict in _LOCATED:
        where = found.crossing or found.undecided
        assert where is not None
        guard, usual = where.guard, watch.tolerances.item(where.guard)
        if not tolerances[guard] < usual:
            break
        again = _search(watch, path, watch.tolerances, where.step, last)
        if again.crossing and again.crossing.guard == guard and _same(again.crossing, where):
            found = again
            break
        local, steps = where.time, path.coefficients[:last]
        state = sample_states(steps, path.times[: last + 1], np.array([local]))[0]
        time = watch.start + local
        errors = relative_error(engine) * path_sizes(steps)
        error = margin_errors(compiled.guards, guard, state, errors, watch.parameters, time)
        error = min(usual, error)
        if found.verdict is Verdict.CROSSING and error <= 2.0 * tolerances[guard]:
            break
        # At least twice as large each time, so that this comes to an end.
        tolerances[guard] = error if error > 2.0 * tolerances[guard] else usual
        found = _search(watch, path, tolerances, where.step, last)
    return found


def _search(watch: FlowWatch, path: Path, tolerances: Array, first: int, last: int) -> Search:
    return search(watch.guards, tolerances, path, watch.parameters, watch.start, first, last)


def _same(one: Crossing, other: Crossing) -> bool:
    """Tell whether two crossings are one root to within round-off of time."""
    return one.time <= max(other.time, other.crossed) * (1.0 + EVALUATED)


def relative_error(engine: Engine) -> float:
    """Return by what part of its size a variable may be off."""
    return max(STATE_TOLERANCES * engine.tolerance, STATE_ROUND_OFF)


def path_sizes(steps: Array) -> Array:
    """Return bounds of the variables (n,) over steps (m, n, d + 1)."""
    found: Array = np.abs(steps).sum(axis=2).max(axis=0)
    return found


def margin_errors(
    guards: Tape, guard: int, state: Array, errors: Array, parameters: Array, time: float
) -> float:
    """Return by how much a margin is off in a state (n,) whose variables are off by `errors`.

    That is what it changes by when each of them is moved alone, and time by its round-off, and the
    round-off of its own terms.
    """
    states = np.vstack([state, state, state + np.diag(errors)])
    times = np.full(len(states), time)
    times[1] += EVALUATED * abs(time)
    with np.errstate(all="ignore"):
        values = guards.table(states, parameters, times)[:, guard]
    (terms,) = sizes_at(guards, (guard,), state, np.abs(state), parameters, time)
    return float(np.abs(values[1:] - values[0]).sum()) + EVALUATED * terms
