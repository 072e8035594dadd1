"""Points of hybrid time: grids along arcs, instants, and the equations that hold there."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.laws import roles_in
from statechart.automaton.modes import build_mode
from statechart.automaton.regions import Mode, Region
from statechart.automaton.trace import Arc, Jump, Key, Roles, Trace
from statechart.execution.simulator import Simulator
from statechart.formulas.linear import Singular
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


Where = tuple[tuple[str, str], ...]
"""Regions, and the states or superstates that they have to be in."""


def wanted(during: Sequence[Mapping[str, str]]) -> tuple[Where, ...]:
    """Return regions and states as they are declared, as `places_in` takes them."""
    return tuple([tuple(states.items()) for states in during])


def places_in(regions: Sequence[Region], key: Key, where: Sequence[Where]) -> list[int]:
    """Return which of `where` hold in the mode `key`; superstates are states, too."""
    states = {region.name: region.active(state) for region, state in zip(regions, key, strict=True)}
    return [
        place
        for place, wanted in enumerate(where)
        if all(state in states[region] for region, state in wanted)
    ]


def seen(expressions: Sequence[sp.Expr], mode: Mode | None) -> tuple[sp.Expr, ...]:
    """Return expressions as others see a mode: without the forces that it hides."""
    hidden = mode.hidden if mode else {}
    return tuple([e.xreplace(hidden) for e in expressions]) if hidden else tuple(expressions)


def _place(arcs: Sequence[Arc], j: int, ends: bool) -> int:
    """Return the last arc after up to `j` jumps, or the first after so many or more."""
    if ends:
        return bisect_right(arcs, j, key=lambda arc: arc.j) - 1
    return bisect_left(arcs, j, key=lambda arc: arc.j)


def roles_at(trace: Trace, j: int, mode: Key, *, ends: bool) -> Roles:
    """Return the roles whose equations hold after `j` jumps, in the mode shown as `mode`.

    `ends`: at the end of that time, else at its start.
    """
    arcs, place = trace.arcs, _place(trace.arcs, j, ends)
    if 0 <= place < len(arcs) and arcs[place].j == j and arcs[place].mode == mode:
        return arcs[place].roles
    # A stop, for one, changes nothing: the arc before it goes on.
    if j > 0 and trace.jumps[j - 1].source == trace.jumps[j - 1].target == mode:
        return roles_at(trace, j - 1, mode, ends=True)
    return roles_in(mode)


def solved_rows(trace: Trace, places: Sequence[tuple[int, bool]], width: int) -> Array | None:
    """Return what steps have solved for after so many jumps, at the end of that time or its start.

    None where modes have to be solved for it; not a number where nothing flowed.
    """
    if trace.step is None:
        return None
    rows = np.full((len(places), width), np.nan)
    for row, (j, ends) in zip(rows, places, strict=True):
        if trace.arcs:
            place = min(max(_place(trace.arcs, j, ends), 0), len(trace.arcs) - 1)
            solved = trace.arcs[place].solved
            assert solved is not None
            row[:] = solved[-1 if ends else 0]
    return rows


def start_of(trace: Trace, width: int) -> Points:
    """Return the start of a run, before any jump."""
    roles = roles_at(trace, 0, trace.start_mode, ends=False)
    known = solved_rows(trace, [(0, False)], width)
    return Points(np.zeros(1), trace.initial[None], (roles,), (1,), known)


def end_of(trace: Trace, width: int, rows: int = 1) -> Points:
    """Return the end of a run, after all jumps, in so many rows."""
    j = len(trace.jumps)
    roles = roles_at(trace, j, trace.final_mode, ends=True)
    known = solved_rows(trace, [(j, True)] * rows, width)
    times, states = np.full(rows, trace.t_end), np.tile(trace.final, (rows, 1))
    return Points(times, states, (roles,), (rows,), known)


def instants(trace: Trace, jumps: Sequence[Jump], before: bool) -> tuple[Array, Array]:
    """Return the times (m,) of some jumps of a run, and the states (m, n) before or after them."""
    states = np.array([jump.before if before else jump.after for jump in jumps])
    times = np.array([jump.t for jump in jumps])
    return times, states.reshape(len(times), len(trace.variables))


def beside(trace: Trace, jumps: Sequence[Jump], before: bool, width: int) -> Points:
    """Return the instants just before some jumps of a run, or just after them."""
    times, states = instants(trace, jumps, before)
    known = solved_rows(trace, [(jump.j + (not before), before) for jump in jumps], width)
    if known is not None:
        return Points(times, states, (), (), known)
    roles = [
        roles_at(trace, jump.j, jump.source, ends=True)
        if before
        else roles_at(trace, jump.j + 1, jump.target, ends=False)
        for jump in jumps
    ]
    return Points(times, states, roles, range(1, len(jumps) + 1))


def passed(trace: Trace) -> list[Jump]:
    """Return the jumps after which nothing flowed: into modes of no duration, and the last.

    None of steps, whose arcs hold all states that their jumps lead through.
    """
    if trace.step is not None:
        return []
    flowed = {arc.j for arc in trace.arcs}
    return [trace.jumps[j] for j in range(len(trace.jumps)) if j + 1 not in flowed]


class PassedModes:
    """Modes that the runs of a simulator were in, or passed through in no time."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._passed: dict[tuple[Roles, frozenset[int]], Mode | None] = {}

    def of(self, trace: Trace) -> Callable[[Roles], Mode | None]:
        """Return the look-up roles -> solved mode; None where its equations have no solution."""
        flowed, zeros = {arc.roles for arc in trace.arcs}, trace.zeros

        def look_up(roles: Roles) -> Mode | None:
            if roles in flowed:
                return self._simulator.compiled(roles, zeros).mode
            # No integrator is compiled for what no arc flowed in.
            if (roles, zeros) not in self._passed:
                automaton = self._simulator.automaton
                gone = frozenset(automaton.parameters[i] for i in zeros)
                try:
                    mode = build_mode(automaton, roles, gone)
                except Singular:
                    mode = None
                self._passed[roles, zeros] = mode
            return self._passed[roles, zeros]

        return look_up
