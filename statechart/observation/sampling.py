"""Points of hybrid time: grids along the arcs of a run, and extremes looked for on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.trace import Arc, Key, Roles, Trace

Evaluate = Callable[[Sequence[Arc], Sequence[Array]], Array]
"""Values at local times of arcs, one array of times an arc; one value a time, in order."""

# Grid on which extremes are looked for, in every piece of a step, before they are refined.
_GRID = 16
# Each round divides the bracket by 8; after 9 it is 1e-8 of a step, where a smooth extreme
# differs from its neighbourhood by 1e-16.
_ROUNDS, _DIVISIONS = 9, 16


@dataclass(frozen=True, eq=False)
class Samples:
    """Values along a run, one row a point of hybrid time.

    Attributes
    ----------
    t : (m,) array
        Time, in order.
    j : (m,) array of int
        Number of jumps before the point.
    mode : (m,) array of int
        Place in `modes` of the mode that holds.
    modes : tuple of Key
        The modes that occur.
    columns : mapping of str to (m,) array
        Formula -> values; not a number where it is undefined.
    """

    t: Array
    j: NDArray[np.int64]
    mode: NDArray[np.intp]
    modes: tuple[Key, ...]
    columns: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Points:
    """Rows to evaluate at: (m,) times, (m, n) states; ends[k]: where the rows of flow k end.

    unknowns: (m, u) array where they are known as numbers, else None.
    """

    times: Array
    states: Array
    roles: Sequence[Roles]
    ends: Sequence[int]
    unknowns: Array | None = None


def extremes(
    arcs: Sequence[Arc], pieces: Sequence[Array], evaluate: Evaluate
) -> tuple[float, float]:
    """Return the least and the greatest value over arcs; see `Observer.extremes`.

    Parameters
    ----------
    arcs : sequence of Arc
        Where they are looked for.
    pieces : sequence of arrays
        An arc each, local times where its pieces end: nothing in one is narrower than it.
    evaluate : callable
        Gives the values.
    """
    local = [_divided(np.append(0.0, ends), _GRID) for ends in pieces]
    values = evaluate(arcs, local)
    least = _least(arcs, local, values, evaluate, 1.0)
    return least, -_least(arcs, local, -values, evaluate, -1.0)


def _least(
    arcs: Sequence[Arc], local: list[Array], values: Array, evaluate: Evaluate, sign: float
) -> float:
    """Return the least of ``sign * evaluate``, from its `values` on the grid `local`."""
    if np.isnan(values).all():
        return float("nan")
    best = float(np.nanmin(values))
    first = 0
    for arc, tau in zip(arcs, local, strict=True):
        v = values[first : first + len(tau)]
        first += len(tau)
        # Between grid points a smooth function is below them by at most about its second
        # difference; only points that may hide a lower value are refined.
        with np.errstate(invalid="ignore"):
            bend = np.abs(np.diff(v, 2))
            low = v - np.concatenate([bend[:1], bend, bend[-1:]]) < best
        low[1:] &= v[1:] <= v[:-1]
        low[:-1] &= v[:-1] <= v[1:]
        for i in np.flatnonzero(low).tolist():
            left, right = float(tau[max(i - 1, 0)]), float(tau[min(i + 1, len(tau) - 1)])
            best = min(best, _refined(arc, left, right, evaluate, sign))
    return best


def _refined(arc: Arc, left: float, right: float, evaluate: Evaluate, sign: float) -> float:
    best = float("inf")
    for _ in range(_ROUNDS):
        tau = np.linspace(left, right, _DIVISIONS + 1)
        v = sign * evaluate((arc,), (tau,))
        if np.isnan(v).all():
            break
        i = int(np.nanargmin(v))
        best = min(best, float(v[i]))
        left, right = float(tau[max(i - 1, 0)]), float(tau[min(i + 1, _DIVISIONS)])
    return best


def subdivided(arc: Arc, per_step: float) -> Array:
    """Return local times: `per_step` intervals in every step, both ends of the arc included."""
    every = max(1, math.ceil(1.0 / per_step))
    return _divided(np.append(arc.times[:-1:every], arc.times[-1]), math.ceil(per_step))


def _divided(ends: Array, count: int) -> Array:
    inner = ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(count) / count)
    return np.append(inner.ravel(), ends[-1])


def along(arcs: Sequence[Arc], local: Sequence[Array]) -> Points:
    """Return the points of arcs at local times, one array of them an arc."""
    pairs = list(zip(arcs, local, strict=True))
    known = [u for u in (arc.unknowns(tau) for arc, tau in pairs) if u is not None]
    return Points(
        np.concatenate([arc.start.high + (arc.start.low + tau) for arc, tau in pairs]),
        np.concatenate([arc.states(tau) for arc, tau in pairs]),
        [arc.roles for arc in arcs],
        np.cumsum([len(tau) for tau in local]).tolist(),
        np.concatenate(known) if known else None,
    )


def at_times(trace: Trace, times: Array) -> tuple[list[Arc], list[Array]]:
    """Return the arcs that hold absolute `times`, and the local times in each."""
    if times.ndim != 1 or not (np.diff(times) >= 0.0).all():
        raise ValueError("times must be one row of numbers in ascending order")
    if len(times) and not (times[0] >= 0.0 and times[-1] <= trace.t_end):
        raise ValueError(f"times must lie in the run, 0 to {trace.t_end:.17g}")
    if not trace.arcs:
        return [], []
    starts = [arc.start.high for arc in trace.arcs]
    owner = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
    arcs, local = [], []
    for place in np.unique(owner):
        arc = trace.arcs[place]
        tau = (times[owner == place] - arc.start.high) - arc.start.low
        arcs.append(arc)
        local.append(np.clip(tau, 0.0, arc.duration))
    return arcs, local
