"""Runs that are slightly off: what small errors are magnified into, and what tolerances shift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from statechart.automaton import Automaton, Flow, Laws, Setup
from statechart.constraints import Constraints
from statechart.trace import Clock, Jump, Key

__all__ = ["nudged", "widened"]

Array = NDArray[np.float64]

# A few units in the last place: what a run of many steps adds up to.
_LEAST = 8.0 * float(np.finfo(float).eps)
# Two ends of a body may hit the ground in turn, ever faster, and be closed together once gaps are
# below their tolerance: which one is last then depends on it. Half way, by ratio, to the next
# tolerance of an estimate, as two tolerances may have the same one for the last.
_WIDER = 4.5


def nudged(automaton: Automaton) -> Automaton:
    """Return the automaton with every initial value larger by the same small part, and `widened`.

    That part is the tolerance of the run, or a few roundings where that is more. One factor for
    all keeps symmetric starts symmetric, and zeros zero. The tolerance of gaps is larger, too.
    """
    return replace(automaton, laws=_Nudged(automaton.laws, moved=True))


def widened(automaton: Automaton) -> Automaton:
    """Return the automaton with the tolerances of all forces doubled.

    A mode is left where a force is below zero by its tolerance, whatever the engine and however
    tight: all runs are late by that, and only one with another tolerance shows by how much.
    """
    return replace(automaton, laws=_Nudged(automaton.laws, moved=False))


class _Nudged:
    """Laws of a run that is off, and those of `laws` otherwise."""

    def __init__(self, laws: Laws, *, moved: bool) -> None:
        self._laws, self._moved = laws, moved

    def setup(self, overrides: Mapping[str, float], relative: float) -> Setup:
        setup = self._laws.setup(overrides, relative)
        tolerances = dict(setup.tolerances)
        if "force" in tolerances:
            tolerances["force"] *= 2.0
        if not self._moved:
            return replace(setup, tolerances=tolerances)
        if "gap" in tolerances:
            tolerances["gap"] *= _WIDER
        initial = setup.initial * (1.0 + max(relative, _LEAST))
        return replace(setup, initial=initial, tolerances=tolerances)

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        return self._laws.begin(setup)

    def jump(
        self,
        setup: Setup,
        clock: Clock,
        j: int,
        flow: Flow,
        state: Array,
        fired: tuple[str, ...],
    ) -> tuple[Jump | None, Flow] | None:
        return self._laws.jump(setup, clock, j, flow, state, fired)

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        return self._laws.accumulate(setup, clock, flow, jumps, rest)

    def constraints(self, setup: Setup, flow: Key, start: float, anchor: Array) -> Constraints:
        return self._laws.constraints(setup, flow, start, anchor)
