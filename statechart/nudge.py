"""Runs that are slightly off: what small errors are magnified into, and what tolerances shift."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from statechart.arrays import Array
from statechart.automaton import Automaton, Flow, Laws, Setup
from statechart.constraints import Constraints
from statechart.trace import Clock, Jump, Key

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

    def setup(overrides: Mapping[str, float], relative: float) -> Setup:
        own = automaton.laws.setup(overrides, relative)
        initial = own.initial * (1.0 + max(relative, _LEAST))
        tolerances = _wider(own.tolerances, force=2.0, gap=_WIDER)
        return replace(own, initial=initial, tolerances=tolerances)

    return replace(automaton, laws=_Changed(automaton.laws, setup))


def widened(automaton: Automaton) -> Automaton:
    """Return the automaton with the tolerances of all forces doubled.

    A mode is left where a force is below zero by its tolerance, whatever the engine and however
    tight: all runs are late by that, and only one with another tolerance shows by how much.
    """

    def setup(overrides: Mapping[str, float], relative: float) -> Setup:
        own = automaton.laws.setup(overrides, relative)
        return replace(own, tolerances=_wider(own.tolerances, force=2.0))

    return replace(automaton, laws=_Changed(automaton.laws, setup))


def loosened(automaton: Automaton, relative: float) -> Automaton:
    """Return the automaton whose modes are chosen as in a run at the tolerance `relative`.

    It is integrated as tightly as asked for; what counts as closed and as at rest is as there.
    """

    def setup(overrides: Mapping[str, float], _: float) -> Setup:
        return automaton.laws.setup(overrides, relative)

    return replace(automaton, laws=_Changed(automaton.laws, setup))


def _wider(tolerances: Mapping[str, float], **factors: float) -> dict[str, float]:
    return {kind: size * factors.get(kind, 1.0) for kind, size in tolerances.items()}


class _Changed:
    """Laws of `laws`, from another setup."""

    def __init__(self, laws: Laws, setup: Callable[[Mapping[str, float], float], Setup]) -> None:
        self._laws, self.setup = laws, setup

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
