"""Points of hybrid time: grids along the arcs of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.trace import Arc, Key, Roles, Trace
from statechart.tabular import shortest


@dataclass(frozen=True, eq=False)
class Samples:
    """Values along a run, one row a point of hybrid time."""

    t: Array  # (m,): time, in order.
    j: NDArray[np.int64]  # (m,): number of jumps before the point.
    mode: NDArray[np.intp]  # (m,): place in `modes` of the mode that holds.
    modes: tuple[Key, ...]  # The modes that occur.
    columns: Mapping[str, Array]  # Formula -> values; not a number where it is undefined.


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


def subdivided(arcs: Sequence[Arc], per_step: float) -> list[Array]:
    """Return local times: `per_step` intervals in every step, both ends of each arc included."""
    every, count = max(1, math.ceil(1.0 / per_step)), math.ceil(per_step)
    alike: dict[int, list[int]] = {}
    for place, arc in enumerate(arcs):
        alike.setdefault(len(arc.times), []).append(place)
    found: dict[int, Array] = {}
    for places in alike.values():
        times = np.array([arcs[place].times for place in places])
        ends = np.concatenate([times[:, :-1:every], times[:, -1:]], axis=1)
        inner = ends[:, :-1, None] + np.diff(ends)[..., None] * (np.arange(count) / count)
        local = np.concatenate([inner.reshape(len(places), -1), ends[:, -1:]], axis=1)
        found |= zip(places, local, strict=True)
    return [found[place] for place in range(len(arcs))]


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
        raise ValueError(f"times must lie in the run, 0 to {shortest(trace.t_end)}")
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
