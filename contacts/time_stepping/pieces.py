"""Arcs and jumps of a run by steps, as what they are made of where somebody looks at them.

A run keeps what its steps are, which is a quarter of the polynomials of its arcs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

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
    """Consecutive steps as pieces of arcs: one of each, two of one with impacts.

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
    late : (k,) array
        How long after their middles these are.
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
    late: Array
    places: Ints
    halves: Array | None = None

    @classmethod
    def of(cls, chunk: Chunk, hit: Bools, coordinates: int, begin: Clock) -> Steps:
        """Return those of a chunk."""
        places = np.zeros(len(hit) + 1, np.int64)
        np.cumsum(1 + hit, out=places[1:])
        return cls(
            begin, chunk.h, coordinates, _own(chunk.states), _own(chunk.solved),
            _own(chunk.impulses), _own(chunk.struck), hit, _own(chunk.late), places,
        )  # fmt: skip

    @property
    def width(self) -> int:
        """Bytes of the polynomials of a piece."""
        return TERMS * self.states[0].nbytes

    def without_forces(self, before: Ints, after: Ints, first: int) -> Steps:
        """Return them without forces in halves of steps with impacts in which a region is open."""
        if not self.hit.any():
            return self
        halves = np.repeat(self.solved, 1 + self.hit, axis=0)
        for rows, places in ((before, self.places[:-1]), (after, self.places[:-1] + 1)):
            opened = (rows[self.hit] == FREE) | (rows[self.hit] == OFF_CODE)
            which, regions = np.nonzero(opened)
            at, column = places[self.hit][which], first + 2 * regions
            halves[at, column] = halves[at, column + 1] = 0.0
        return self._replace(halves=halves)

    def at(self, step: int, half: int) -> Clock:
        """Return when a step begins, or its second part."""
        late = float(self.late[step]) if half else 0.0
        return self.begin.later(0.5 * self.h * (2 * step + half) + late).short


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


class _Whole:
    """All pieces of steps: coefficients, when they begin, their unknowns.

    They begin so many half steps after the first, and so much later.
    """

    def __init__(self, steps: Steps, energy: Callable[[Array, Array], Array]) -> None:
        n, hit = steps.coordinates, steps.hit
        self.terms, _ = Pieces.of(steps.states, steps.solved[:, :n], steps.h, steps.late, hit, n)
        self.marks = np.append(0, np.cumsum(np.repeat(2 - hit, 1 + hit)))
        self.late = np.zeros(len(self.marks))
        self.late[steps.places[:-1][hit] + 1] = steps.late[hit]
        halves = steps.halves
        self.unknowns = np.repeat(steps.solved, 1 + hit, axis=0) if halves is None else halves
        self.steps, self._energy = steps, energy

    @cached_property
    def energies(self) -> dict[int, tuple[float, float]]:
        """Those before and after the impacts of each step that has some."""
        hit = np.flatnonzero(self.steps.hit)
        second = self.steps.places[hit] + 1
        times = np.array([self.steps.at(k, 1).high for k in hit.tolist()])
        sides = (self.terms[second - 1].sum(axis=2), self.terms[second, :, 0])
        found = (self._energy(side, times).tolist() for side in sides)
        return dict(zip(hit.tolist(), zip(*found, strict=True), strict=True))


class ArcMaker:
    """Makes arcs and jumps, in order: it remembers all of the steps that it is at.

    Parameters
    ----------
    regions : sequence of str
        Their names.
    energy : callable
        (states, times) -> energies.
    """

    def __init__(self, regions: Sequence[str], energy: Callable[[Array, Array], Array]) -> None:
        self._regions, self._energy = regions, energy
        self._whole: _Whole | None = None

    def arc(self, kept: Line | Arc) -> Arc:
        """Return the arc that something is, or is made to."""
        if isinstance(kept, Arc):
            return kept
        ends, reached, terms, unknowns = [np.zeros(1)], 0.0, [], []
        for steps, first, last in kept.stretches:
            whole = self._all_of(steps)
            marks = whole.marks[first + 1 : last + 1] - whole.marks[first]
            late = whole.late[first + 1 : last + 1] - whole.late[first]
            ends.append(reached + (0.5 * steps.h * marks + late))
            reached = float(ends[-1][-1])
            terms.append(whole.terms[first:last])
            unknowns.append(whole.unknowns[first:last])
        return Arc(
            kept.mode, roles_in(kept.mode), kept.start, kept.j, np.concatenate(ends),
            np.concatenate(terms), defined(np.concatenate(unknowns)),
        )  # fmt: skip

    def jump(self, kept: Stroke | Jump) -> Jump:
        """Return the jump that something is, or is made to."""
        if isinstance(kept, Jump):
            return kept
        whole, steps = self._all_of(kept.steps), kept.steps
        first = int(steps.places[kept.step])
        felt = steps.felt[kept.step]
        places = np.flatnonzero(felt.any(axis=1))
        impulses = {
            self._regions[i]: (normal, tangential)
            for i, (normal, tangential) in zip(places.tolist(), felt[places].tolist(), strict=True)
        }
        return Jump(
            kept.t, kept.j, kept.region, kept.cause, kept.source, kept.target,
            whole.terms[first].sum(axis=1), whole.terms[first + 1, :, 0].copy(),
            impulse=impulses, energy=whole.energies[kept.step],
        )  # fmt: skip

    def _all_of(self, steps: Steps) -> _Whole:
        whole = self._whole
        if whole is None or whole.steps is not steps:
            whole = self._whole = _Whole(steps, self._energy)
        return whole
