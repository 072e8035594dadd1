"""Arcs and jumps of a run by steps, as what they are made of where somebody looks at them.

A run keeps what its steps are, which is a quarter of the polynomials of its arcs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from contacts.states import FREE, OFF_CODE
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.polynomials import TERMS, Pieces, defined
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.clock import Clock
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Arc, Jump, Key

T = TypeVar("T", bound=NDArray[Any])


def _own(rows: T) -> T:
    """Return rows that hold no more than twice their memory: chunks often end early."""
    base = rows.base
    return rows.copy() if base is not None and base.nbytes > 2 * rows.nbytes else rows


class Steps(NamedTuple):
    """Consecutive steps as pieces of arcs: one of each, two of one with impacts in its middle.

    Attributes
    ----------
    begin : Clock
    h : float
    coordinates : int
    states : (k + 1, w) array
    solved : (k, u) array
        Their unknowns.
    felt : (k, r, 2), struck : (k, r) array
        Impulses of impacts; on whom.
    hit : (k,) array of bool
        Which have some.
    places : (k + 1,) array of int
        Where the pieces of each begin.
    halves : (p, u) array or None
        Unknowns of pieces, where they are not those of their steps.
    """

    begin: Clock
    h: float
    coordinates: int
    states: Array
    solved: Array
    felt: Array
    struck: Bools
    hit: Bools
    places: Ints
    halves: Array | None = None

    @classmethod
    def of(cls, chunk: Chunk, hit: Bools, coordinates: int, begin: Clock) -> Steps:
        """Return those of a chunk."""
        places = np.zeros(len(hit) + 1, np.int64)
        np.cumsum(1 + hit, out=places[1:])
        return cls(
            begin, chunk.h, coordinates, _own(chunk.states), _own(chunk.solved),
            _own(chunk.impulses), _own(chunk.struck), hit, places,
        )  # fmt: skip

    @property
    def width(self) -> int:
        """Bytes of the polynomials of a piece."""
        return TERMS * self.states[0].nbytes

    def without_forces(self, before: Ints, after: Ints, first: int) -> Steps:
        """Return them without forces in halves of steps with impacts in which a region is open.

        Parameters
        ----------
        before, after : (k, r) array
            Modes.
        first : int
            Place of the first region's V and H among the unknowns.
        """
        if not self.hit.any():
            return self
        halves = np.repeat(self.solved, 1 + self.hit, axis=0)
        for rows, places in ((before, self.places[:-1]), (after, self.places[:-1] + 1)):
            opened = (rows[self.hit] == FREE) | (rows[self.hit] == OFF_CODE)
            which, regions = np.nonzero(opened)
            at, column = places[self.hit][which], first + 2 * regions
            halves[at, column] = halves[at, column + 1] = 0.0
        return self._replace(halves=halves)

    def step_of(self, piece: int) -> int:
        """Return which step a piece is of."""
        return int(np.searchsorted(self.places, piece, side="right")) - 1

    def mark(self, piece: int) -> int:
        """Return after how many half steps a piece begins."""
        step = self.step_of(piece)
        return 2 * step + piece - int(self.places[step])

    def at(self, piece: int) -> Clock:
        """Return when a piece begins."""
        return self.begin.later(0.5 * self.h * self.mark(piece)).short

    def parts(self, first: int, last: int) -> tuple[Array, Array, Array]:
        """Return pieces as those of an arc: their ends (p + 1,), coefficients, unknowns (p, u)."""
        begin, end = self.step_of(first), self.step_of(last - 1) + 1
        hit, solved, left = self.hit[begin:end], self.solved[begin:end], int(self.places[begin])
        found = Pieces.of(
            self.states[begin : end + 1], solved[:, : self.coordinates], self.h, hit,
            self.coordinates,
        )  # fmt: skip
        marks = np.append(0, np.cumsum(np.repeat(2 - hit, 1 + hit)))[first - left : last - left + 1]
        unknowns = np.repeat(solved, 1 + hit, axis=0)[first - left : last - left]
        if self.halves is not None:
            unknowns = self.halves[first:last]
        ends: Array = 0.5 * self.h * (marks - marks[0])
        return ends, found.terms[first - left : last - left], unknowns


class Stretch(NamedTuple):
    """Pieces of steps, from the first to before the last."""

    steps: Steps
    first: int
    last: int


class Line(NamedTuple):
    """What an arc is made of."""

    mode: Key
    start: Clock
    j: int
    stretches: tuple[Stretch, ...]

    def made(self) -> Arc:
        """Return the arc."""
        parts = [steps.parts(first, last) for steps, first, last in self.stretches]
        ends, reached = [np.zeros(1)], 0.0
        for times, _, _ in parts:
            ends.append(reached + times[1:])
            reached = float(ends[-1][-1])
        terms, solved = (np.concatenate([part[i] for part in parts]) for i in (1, 2))
        times = np.concatenate(ends)
        roles = roles_in(self.mode)
        return Arc(self.mode, roles, self.start, self.j, times, terms, defined(solved))


class Stroke(NamedTuple):
    """What the jump of a step with impacts is made of."""

    steps: Steps
    step: int
    t: float
    j: int
    region: str
    cause: str
    source: Key
    target: Key
    regions: Sequence[str]
    energy: Callable[[Array, float], float]

    def made(self) -> Jump:
        """Return the jump, at the state before and after it."""
        first = int(self.steps.places[self.step])
        _, terms, _ = self.steps.parts(first, first + 2)
        before, after = terms[0].sum(axis=1), terms[1, :, 0].copy()
        felt = self.steps.felt[self.step]
        places = np.flatnonzero(felt.any(axis=1))
        impulses = {
            self.regions[i]: (normal, tangential)
            for i, (normal, tangential) in zip(places.tolist(), felt[places].tolist(), strict=True)
        }
        energies = self.energy(before, self.t), self.energy(after, self.t)
        return Jump(
            self.t, self.j, self.region, self.cause, self.source, self.target, before, after,
            impulse=impulses, energy=energies,
        )  # fmt: skip


@overload
def made(kept: Line | Arc) -> Arc: ...
@overload
def made(kept: Stroke | Jump) -> Jump: ...
def made(kept: Line | Arc | Stroke | Jump) -> Arc | Jump:
    """Return the arc or the jump that something is, or is made to."""
    return kept.made() if isinstance(kept, Line | Stroke) else kept
