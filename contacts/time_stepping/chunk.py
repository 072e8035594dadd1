"""Steps of one length: their arrays, when a contact takes part in one, and how hard ones are taken.

What points on surfaces and bodies with shapes have in common; both have a compiled step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel

DONE, BAD_INERTIA, NOT_FINITE, FULL, COARSE = range(5)
"""End of a chunk: with its last step, before an inertia that determines no motion, a number that
is none, more contacts than there is place for, or more motion than the step follows."""

SEPARATED, LASTING, HIT = range(3)
"""How a contact takes part in a step."""

TIME_MARGIN = 1e-6
"""Margin of time bounds, in parts of a step: round-off of gaps and speeds must not separate corners
that arrive together."""

SLOW = 2.0 + TIME_MARGIN
"""Impulses of contacts that approach slower than what so many steps without contact would make of
rest are those of a contact that lasts."""

LIVELY = 0.5
"""Restitution from which a warning says that impacts at once are not those in turn: the approach
that is given back has a quarter of its energy. The order rarely matters to heaps that rebound less.
"""

RESIDUAL, ITERATIONS, CONTACTS, CALMED, AMBIGUOUS, UNENDED, CHOSEN, WORK, JAMMED = range(9)
"""Columns of `Chunk.efforts`: the residual of impulses, iterations, and contacts that took part; 1
where none were found that make all contacts part as they should; 1 where a body is struck at
several places that are `LIVELY`; the fastest approach that impacts in turn left; 1 where the
impulses that were taken are not the only ones; iterations times contacts, island by island; 1 + the
number of a contact that jams."""

_COLUMNS = JAMMED + 1


class Chunk(NamedTuple):
    """Consecutive steps of one length."""

    h: float  # Length of a step.
    states: Array  # (k + 1, 2 n): the first is where the first step begins.
    solved: Array  # (k, u): accelerations (n,) under what lasts, and the further unknowns.
    # (k, r): mode of every region under the impulses of the step, as `contacts.states` numbers
    # them, and the mode that the trace shows (`contacts.time_stepping.settling`).
    codes: Ints
    modes: Ints
    # (k, r): regions with an impact in the middle of the step; those whose forces the motion does
    # not determine.
    struck: Bools
    shared: Bools
    impulses: Array  # (k, r, 2): of the impacts, and of what they make others bear.
    gaps: Array  # (k, r): at the midpoints.
    # (k,): the fastest approach of what touches; the largest gap, of either sign, that a step
    # closes.
    approach: Array
    closing: Array
    # (k,): where something passed another between the middle of the step before and that of this
    # one: the part of a step in which they overlapped.
    passed: Array
    impact_delay: Array  # (k,): how long after the middle of the step its impacts are.
    # (k,): what contacts add to the energy, or would; see `contacts.time_stepping.step_contacts`.
    gained: Array
    stats: Array  # (k, e): what impulses took, in the columns `RESIDUAL` to `JAMMED`.

    @classmethod
    def allocate(cls, h: float, state: Array, unknowns: int, regions: int, count: int) -> Chunk:
        """Return place for steps from `state`."""
        states = np.empty((count + 1, len(state)))
        states[0] = state
        return cls(
            h,
            states,
            np.zeros((count, unknowns)),
            np.zeros((count, regions), dtype=np.int64),
            np.zeros((count, regions), dtype=np.int64),
            np.zeros((count, regions), dtype=np.bool_),
            np.zeros((count, regions), dtype=np.bool_),
            np.zeros((count, regions, 2)),
            np.full((count, regions), np.inf),
            np.zeros(count),
            np.zeros(count),
            np.zeros(count),
            np.zeros(count),
            np.zeros(count),
            np.zeros((count, _COLUMNS)),
        )

    def first(self, count: int) -> Chunk:
        """Return the first `count` steps."""
        return Chunk._make((self.h, self.states[: count + 1], *(rows[:count] for rows in self[2:])))

    def ends(self, start: float) -> Array:
        """Return when the steps end that begin at `start`."""
        ends: Array = start + self.h * np.arange(1, len(self.codes) + 1, dtype=float)
        return ends

    def after(self, count: int) -> Chunk:
        """Return the steps after the first `count`."""
        return Chunk._make((self.h, *(rows[count:] for rows in self[1:])))


class SteppedSystem(ABC):
    """A system that is stepped: it gives (M, f, rows of contacts and joints) to its time step."""

    @property
    @abstractmethod
    def margins(self) -> dict[str, float]:
        """The least values seen, at the midpoints of steps."""

    @property
    @abstractmethod
    def remarks(self) -> tuple[str, ...]:
        """Warnings of the run."""

    @abstractmethod
    def steps(self, start: float, h: float, state: Array, count: int) -> Chunk:
        """Take up to `count` steps from a state.

        Raises
        ------
        SimulationError
            Where not one step can be taken.
        """

    @abstractmethod
    def forget(self) -> None:
        """Take back the last steps."""

    @abstractmethod
    def switch(
        self, states: Mapping[str, str], at: tuple[Array, Array, float]
    ) -> tuple[dict[int, int], bool]:
        """Go on with controllers in other states; `at`: from a state, to another, at a time.

        Return the modes of regions whose surface was moved, and whether one is struck at once.
        """

    @abstractmethod
    def depth_left(self, state: Array, time: float) -> float:
        """Return how deep something stays in what it touches, whatever moves.

        After the last steps, which have come near that state; see `step_rejection`.
        """


@kernel
def arriving(
    gap: float, level: float, lasting: bool, nearing: float, slow: float, closing: float,
    reached: float, near: float,
) -> tuple[int, float, float]:  # fmt: skip
    """Return how a contact takes part in a step, its level, and how far above that it is.

    Parameters
    ----------
    gap, level : float
        At the midpoint; at which a contact that lasts is kept.
    lasting : bool
        Whether it does.
    nearing, slow : float
        Speed of approach before the step; up to which that is one of a contact that lasts.
    closing : float
        How much nearer a slow contact comes within the step without impulses, at most.
    reached : float
        What is fast is struck in this step up to so far off.
    near : float
        Gap tolerance: a contact touches up to this gap.
    """
    if not lasting:
        # A contact that has come out does not go as deep again.
        level = min(max(level, gap), 0.0)
    above = gap - level
    # A slow contact takes part before it arrives: others may push it there in this step.
    soon = gap <= near or above <= closing
    if lasting or (nearing <= slow and soon):
        if above < 0.0 and not lasting:
            return LASTING, gap, 0.0
        return LASTING, level, above
    if above <= max(reached, near) and nearing > slow:
        return HIT, min(gap, 0.0), above
    return SEPARATED, level, above
