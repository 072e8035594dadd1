"""Which equations hold at an instant of a run, and what steps have solved for there."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence

import numpy as np

from statechart.arrays import Array
from statechart.automaton.laws import roles_in
from statechart.automaton.modes import build_mode
from statechart.automaton.regions import Mode
from statechart.automaton.trace import Arc, Key, Roles, Trace
from statechart.execution.simulator import Simulator
from statechart.formulas.linear import Singular


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


class PassedModes:
    """Modes that the runs of a simulator were in, or passed through in no time.

    Parameters
    ----------
    simulator : Simulator
        What made the runs.
    """

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
