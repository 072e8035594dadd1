"""Runs from a start that is slightly off: what small errors are magnified into."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from statechart.automaton import Automaton, Flow, Laws, Setup
from statechart.constraints import Constraints
from statechart.trace import Clock, Jump, Key

__all__ = ["nudged"]

Array = NDArray[np.float64]

# A few units in the last place: what a run of many steps adds up to.
_LEAST = 8.0 * float(np.finfo(float).eps)


def nudged(automaton: Automaton) -> Automaton:
    """Return the automaton with every initial value larger by the same small part.

    That part is the tolerance of the run, or a few roundings where that is more. One factor for
    all keeps symmetric starts symmetric, and zeros zero.
    """
    return replace(automaton, laws=_Nudged(automaton.laws))


class _Nudged:
    """Laws that start a run elsewhere, and are those of `laws` otherwise."""

    def __init__(self, laws: Laws) -> None:
        self._laws = laws

    def setup(self, overrides: Mapping[str, float], relative: float) -> Setup:
        setup = self._laws.setup(overrides, relative)
        return replace(setup, initial=setup.initial * (1.0 + max(relative, _LEAST)))

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
