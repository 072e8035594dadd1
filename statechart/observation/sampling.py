"""Points of hybrid time: grids along arcs, endpoints, and their roles."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.laws import roles_in
from statechart.automaton.regions import Mode, Region
from statechart.automaton.trace import Arc, Jump, Key, Roles, Trace


@dataclass(frozen=True, eq=False)
class Samples:
    """Values along a run at m points of hybrid time."""

    t: Array  # (m,): times, sorted
    j: NDArray[np.int64]  # (m,): number of jumps before
    mode: NDArray[np.intp]  # (m,): index in `modes`
    modes: tuple[Key, ...]
    columns: Mapping[str, Array]  # formula -> values (m,), NaN if undefined


@dataclass(frozen=True, eq=False)
class Points:
    """Points of evaluation: times (m,), states (m, n); the rows of flow k end at ends[k].

    Roles of the flows, and stored unknowns (m, u) or None, are looked up on demand.
    """

    times: Array
    states: Array
    ends: Sequence[int]
    roles: Callable[[], Sequence[Roles]]
    unknowns: Callable[[], Array | None]


class Endpoint(NamedTuple):
    """Start or end of a flow, in hybrid time."""

    t: float
    state: Array
    j: int  # number of jumps before
    mode: Key
    ends: bool


def subdivide(arcs: Sequence[Arc], per_step: float) -> list[Array]:
    """Return local times with `per_step` intervals in every step, including the ends of arcs."""
    every, count = max(1, math.ceil(1.0 / per_step)), math.ceil(per_step)
    arcs_by_length: dict[int, list[int]] = {}
    for place, arc in enumerate(arcs):
        arcs_by_length.setdefault(len(arc.times), []).append(place)
    samples: dict[int, Array] = {}
    for places in arcs_by_length.values():
        times = np.array([arcs[place].times for place in places])
        ends = np.concatenate([times[:, :-1:every], times[:, -1:]], axis=1)
        inner = ends[:, :-1, None] + np.diff(ends)[..., None] * (np.arange(count) / count)
        local = np.concatenate([inner.reshape(len(places), -1), ends[:, -1:]], axis=1)
        samples |= zip(places, local, strict=True)
    return [samples[place] for place in range(len(arcs))]


def sample_arcs(arcs: Sequence[Arc], local: Sequence[Array]) -> Points:
    """Return the points of arcs at local times, one array per arc."""
    pairs = list(zip(arcs, local, strict=True))

    def unknowns() -> Array | None:
        known = [u for u in (arc.unknowns(tau) for arc, tau in pairs) if u is not None]
        return np.concatenate(known) if known else None

    times = np.concatenate([arc.start.high + (arc.start.low + tau) for arc, tau in pairs])
    states = np.concatenate([arc.states(tau) for arc, tau in pairs])
    ends = np.cumsum([len(tau) for tau in local]).tolist()
    return Points(times, states, ends, lambda: [arc.roles for arc in arcs], unknowns)


def at_endpoints(trace: Trace, endpoints: Sequence[Endpoint], width: int) -> Points:
    """Return the points at ends of flows; modes have `width` unknowns and controls."""
    return Points(
        np.array([one.t for one in endpoints]),
        np.array([one.state for one in endpoints]).reshape(-1, len(trace.variables)),
        range(1, len(endpoints) + 1),
        lambda: [roles_at(trace, one.j, one.mode, ends=one.ends) for one in endpoints],
        lambda: _solved_rows(trace, endpoints, width),
    )


def start_of(trace: Trace) -> Endpoint:
    """Return the start of a run, before any jump."""
    return Endpoint(0.0, trace.initial, 0, trace.start_mode, False)


def end_of(trace: Trace) -> Endpoint:
    """Return the end of a run, after all jumps."""
    return Endpoint(trace.t_end, trace.final, len(trace.jumps), trace.final_mode, True)


def side_of(jump: Jump, before: bool) -> Endpoint:
    """Return the instant just before a jump, or just after it."""
    if before:
        return Endpoint(jump.t, jump.before, jump.j, jump.source, True)
    return Endpoint(jump.t, jump.after, jump.j + 1, jump.target, False)


def at_times(trace: Trace, times: Array) -> tuple[list[Arc], list[Array]]:
    """Return the arcs that contain absolute `times`, and the local times in each."""
    if times.ndim != 1 or not (np.diff(times) >= 0.0).all():
        raise ValueError("times must be one row of numbers in ascending order")
    if len(times) and not (times[0] >= 0.0 and times[-1] <= trace.t_end):
        raise ValueError(f"times must lie in the run, 0 to {trace.t_end:.7g}")
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


Where = tuple[tuple[str, str], ...]
"""Regions with required states or superstates."""


def places_in(regions: Sequence[Region], key: Key, where: Sequence[Where]) -> list[int]:
    """Return the indices of `where` that are satisfied in the mode `key`."""
    states = {region.name: region.active(state) for region, state in zip(regions, key, strict=True)}
    met = [all(state in states[region] for region, state in required) for required in where]
    return [place for place, satisfied in enumerate(met) if satisfied]


def visible_expressions(expressions: Sequence[sp.Expr], mode: Mode | None) -> tuple[sp.Expr, ...]:
    """Return expressions without the forces that a mode hides from other regions."""
    hidden = mode.hidden if mode else {}
    return tuple([e.xreplace(hidden) for e in expressions]) if hidden else tuple(expressions)


def _arc_index(arcs: Sequence[Arc], j: int, ends: bool) -> int:
    """Return the last arc after at most `j` jumps (`ends`), or the first after at least `j`."""
    if ends:
        return bisect_right(arcs, j, key=lambda arc: arc.j) - 1
    return bisect_left(arcs, j, key=lambda arc: arc.j)


def roles_at(trace: Trace, j: int, mode: Key, *, ends: bool) -> Roles:
    """Return the roles after `j` jumps in `mode`, at the end of that flow (`ends`) or its start."""
    arcs, place = trace.arcs, _arc_index(trace.arcs, j, ends)
    if 0 <= place < len(arcs) and arcs[place].j == j and arcs[place].mode == mode:
        return arcs[place].roles
    if j in trace.passed_roles:
        return trace.passed_roles[j]
    # A jump that changes no mode, such as a stop, has the roles of the arc before.
    if j > 0 and trace.jumps[j - 1].source == trace.jumps[j - 1].target == mode:
        return roles_at(trace, j - 1, mode, ends=True)
    return roles_in(mode)


def _solved_rows(trace: Trace, endpoints: Sequence[Endpoint], width: int) -> Array | None:
    """Return the unknowns of time steps at ends of flows, else None; before any, of the start."""
    if trace.step is None:
        return None
    rows = np.full((len(endpoints), width), np.nan)
    for row, one in zip(rows, endpoints, strict=True):
        if trace.arcs:
            place = min(max(_arc_index(trace.arcs, one.j, one.ends), 0), len(trace.arcs) - 1)
            solved = trace.arcs[place].solved
            assert solved is not None
            row[:] = solved[-1 if one.ends else 0]
        elif trace.start_unknowns is not None and one.mode == trace.start_mode:
            row[:] = trace.start_unknowns
    return rows


def instantaneous_modes(trace: Trace) -> list[Jump]:
    """Return the jumps into modes of zero duration, and the last jump; none for time stepping."""
    if trace.step is not None:
        return []
    flowed = {arc.j for arc in trace.arcs}
    return [trace.jumps[j] for j in range(len(trace.jumps)) if j + 1 not in flowed]
