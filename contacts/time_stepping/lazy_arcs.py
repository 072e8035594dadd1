"""Polynomials of time steps, and lazy arcs and jumps computed from them on access.

Positions are quadratic and rates linear in time, consistent with the midpoint rule at the ends of
steps. A step with impacts has one part more than it has times of impact, all under the same finite
forces. Steps take a quarter of the memory of arc polynomials.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from contacts.states import FREE, OFF_CODE
from contacts.time_stepping.chunk import Chunk
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.clock import Clock
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Arc, Jump, Key

TERMS = 3
"""Terms of the polynomial of a step."""


def smooth(left: Array, right: Array, h: float, n: int) -> Array:
    """Return the coefficients (k, w, TERMS) of steps without impacts."""
    coefficients = np.zeros((*left.shape, TERMS))
    coefficients[:, :, 0] = left
    coefficients[:, :n, 1] = h * left[:, n : 2 * n]
    coefficients[:, n:, 1] = right[:, n:] - left[:, n:]
    coefficients[:, :n, 2] = 0.5 * h * coefficients[:, n : 2 * n, 1]
    return coefficients


def struck(
    left: Array, right: Array, acceleration: Array, part: tuple[Array, Array], after: Bools,
    h: float,
) -> Array:  # fmt: skip
    """Return the coefficients (p, w, TERMS) of parts of steps with impacts.

    `acceleration` (p, n) is that under finite forces; `part` (p, 1) are begins and ends in a step
    of size `h`; `after` (p, n): coordinates whose impact is over.
    """
    n, (begin, end) = acceleration.shape[1], part
    rates, variables, rest = slice(n, 2 * n), slice(2 * n, None), h - begin
    length = end - begin
    terms = np.zeros((*left.shape, TERMS))
    # Velocities before and after make the ends of the step exact.
    terms[:, rates, 0] = np.where(
        after, right[:, rates] - rest * acceleration, left[:, rates] + begin * acceleration
    )
    terms[:, :n, 0] = np.where(
        after,
        right[:, :n] - rest * (right[:, rates] - 0.5 * rest * acceleration),
        left[:, :n] + begin * (left[:, rates] + 0.5 * begin * acceleration),
    )
    flow = (right[:, variables] - left[:, variables]) / h
    terms[:, variables, 0] = left[:, variables] + begin * flow
    terms[:, :n, 1], terms[:, rates, 1] = length * terms[:, rates, 0], length * acceleration
    terms[:, variables, 1] = length * flow
    terms[:, :n, 2] = 0.5 * length**2 * acceleration
    return terms


def step_polynomials(steps: Steps) -> Array:
    """Return the coefficients (p, w, TERMS) of the pieces of steps."""
    left, right, h, n = steps.states[:-1], steps.states[1:], steps.h, steps.coordinates
    hit = np.diff(steps.places) > 1
    if not hit.any():
        return smooth(left, right, h, n)
    parts = hit[steps.of_piece]
    at, begin = steps.of_piece[parts], steps.begins[parts, None]
    end = np.append(steps.begins[1:], 0.0)[parts, None]
    part = begin, np.where(end > 0.0, end, h)
    after = np.broadcast_to(begin > 0.0, (len(at), n))
    if steps.delays.size:
        r = steps.struck.shape[1]
        after = 0.5 * h + steps.delays[at, r : r + n] <= begin
    pieces = np.concatenate(
        [
            smooth(left[~hit], right[~hit], h, n),
            struck(left[at], right[at], steps.solved[at, :n], part, after, h),
        ]
    )
    # Gathering rows is ten times as fast as scattering them.
    return pieces[np.argsort(np.concatenate([np.flatnonzero(~parts), np.flatnonzero(parts)]))]


def fill_undefined(rows: Array) -> Array:
    """Replace NaN by the value of the nearest row, the later of two."""
    unknown, result = np.isnan(rows), rows
    for column in np.flatnonzero(unknown.any(axis=0) & ~unknown.all(axis=0)).tolist():
        result = rows.copy() if result is rows else result
        blank, known = np.flatnonzero(unknown[:, column]), np.flatnonzero(~unknown[:, column])
        after = np.minimum(np.searchsorted(known, blank), len(known) - 1)
        before = np.maximum(after - 1, 0)
        later = np.abs(known[after] - blank) <= np.abs(known[before] - blank)
        result[blank, column] = rows[np.where(later, known[after], known[before]), column]
    return result


Numbers = TypeVar("Numbers", bound=NDArray[Any])


def _compact(rows: Numbers) -> Numbers:
    """Return a copy of rows that use less than half of their base: chunks often end early."""
    base = rows.base
    return rows.copy() if base is not None and base.nbytes > 2 * rows.nbytes else rows


class Steps(NamedTuple):
    """Consecutive steps of one size; each is one piece of an arc, and one more per impact time."""

    begin: Clock
    h: float
    coordinates: int
    states: Array  # shape (k + 1, w)
    solved: Array  # (k, u): unknowns.
    # Impulses of impacts; struck regions. Empty if no jumps are recorded.
    impulses: Array  # shape (k, r, 2)
    joint_impulses: Array  # shape (k, f)
    struck: Bools  # shape (k, r)
    delays: Array  # `Chunk.impact_delay`; empty if no step has two impact times.
    places: Ints  # (k + 1,): first piece of each step.
    of_piece: Ints  # (p,): step of each piece.
    begins: Array  # (p,): begin of each piece after that of its step.
    # (p, u): unknowns of pieces, if they differ from those of steps.
    halves: Array | None = None

    @classmethod
    def of(cls, chunk: Chunk, coordinates: int, begin: Clock) -> Steps:
        """Return the steps of a chunk."""
        k, struck = np.nonzero(chunk.struck)
        delays = chunk.region_delay[k, struck]
        order = np.lexsort((delays, k))
        k, delays = k[order], delays[order]
        differs = np.append(True, (k[1:] > k[:-1]) | (delays[1:] > delays[:-1]))[: len(k)]
        counts = 1 + np.bincount(k[differs], minlength=len(chunk.codes))
        places, of_piece = np.append(0, counts.cumsum()), np.arange(len(counts)).repeat(counts)
        begins = np.zeros(len(of_piece))
        begins[np.arange(len(begins)) != places[of_piece]] = 0.5 * chunk.h + delays[differs]
        several = bool(counts.max(initial=0) > 2)
        return cls(
            begin, chunk.h, coordinates, _compact(chunk.states), _compact(chunk.solved),
            _compact(chunk.impulses), _compact(chunk.joint_impulses), _compact(chunk.struck),
            _compact(chunk.impact_delay) if several else np.zeros((0, 0)), places, of_piece, begins,
        )  # fmt: skip

    def without_impulses(self) -> Steps:
        """Drop impulses and struck regions."""
        names = ("impulses", "joint_impulses", "struck")
        return self._replace(**{name: getattr(self, name)[:0].copy() for name in names})

    @property
    def width(self) -> int:
        """Bytes of the polynomials of a piece."""
        return TERMS * self.states[0].nbytes

    def without_forces(self, after: Ints, delays: Array, before: Ints, columns: Ints) -> Steps:
        """Clear the forces of open regions in the parts of steps with impacts.

        Regions have modes `before` (k, r), and `after` these delays; `columns` (r, 2): columns of
        their forces.
        """
        part = (np.diff(self.places) > 1)[self.of_piece]
        if not part.any():
            return self
        at, begins = self.of_piece[part], self.begins[part, None]
        halves = self.solved[self.of_piece]
        modes = np.where(0.5 * self.h + delays[at] <= begins, after[at], before[at])
        which, regions = np.nonzero((modes == FREE) | (modes == OFF_CODE))
        halves[np.flatnonzero(part)[which, None], columns[regions]] = 0.0
        return self._replace(halves=halves)

    def at(self, step: int, part: int) -> Clock:
        """Return when a part of a step begins."""
        delay = float(self.begins[self.places[step] + part]) if part else 0.0
        return self.begin.later(self.h * step + delay).short

    @property
    def ends(self) -> Array:
        """The ends of pieces, after `begin`."""
        steps = self.h * np.append(self.of_piece, len(self.places) - 1.0)
        return steps + np.append(self.begins, 0.0)


class StepRange(NamedTuple):
    """A half-open range of steps."""

    steps: Steps
    first: int
    last: int


class LazyArc(NamedTuple):
    """An arc as ranges of steps."""

    mode: Key
    start: Clock
    j: int
    ranges: tuple[StepRange, ...]


class LazyJump(NamedTuple):
    """A jump as a part of a step that begins with an impact."""

    steps: Steps
    step: int
    part: int
    t: float
    j: int
    region: str
    cause: str
    source: Key
    target: Key


class _Polynomials:
    """Coefficients, ends and unknowns of all pieces of some steps."""

    def __init__(self, steps: Steps, energy: Callable[[Array, Array], Array] | None) -> None:
        self.terms, self.ends = step_polynomials(steps), steps.ends
        self.unknowns = steps.solved[steps.of_piece] if steps.halves is None else steps.halves
        self.steps, self._energy = steps, energy

    @cached_property
    def energies(self) -> dict[int, tuple[float, float]]:
        """Energies before and after the impacts at the begins of pieces."""
        pieces = np.flatnonzero(self.steps.begins > 0.0)
        begin, times = self.steps.begin, self.ends[pieces].tolist()
        at = np.array([begin.later(time).short.high for time in times])
        sides = (self.terms[pieces - 1].sum(axis=2), self.terms[pieces, :, 0])
        assert self._energy is not None
        energies_of_sides = (self._energy(side, at).tolist() for side in sides)
        return dict(zip(pieces.tolist(), zip(*energies_of_sides, strict=True), strict=True))


class ArcMaker:
    """Computes arcs and jumps; caches the last polynomials, since access is mostly in order."""

    def __init__(
        self,
        regions: Sequence[str] = (),
        energy: Callable[[Array, Array], Array] | None = None,
        joint_forces: Sequence[str] = (),
    ) -> None:
        self._regions, self._energy, self._joint_forces = regions, energy, joint_forces
        self._polynomials: _Polynomials | None = None

    def arc(self, lazy: LazyArc | Arc) -> Arc:
        """Return an arc, computed from steps unless it is one."""
        if isinstance(lazy, Arc):
            return lazy
        ends, reached, terms, unknowns = [np.zeros(1)], 0.0, [], []
        for steps, first, last in lazy.ranges:
            whole = self._of(steps)
            ends.append(reached + (whole.ends[first + 1 : last + 1] - whole.ends[first]))
            reached = float(ends[-1][-1])
            terms.append(whole.terms[first:last])
            unknowns.append(whole.unknowns[first:last])
        return Arc(
            lazy.mode, roles_in(lazy.mode), lazy.start, lazy.j, np.concatenate(ends),
            np.concatenate(terms), fill_undefined(np.concatenate(unknowns)),
        )  # fmt: skip

    def jump(self, lazy: LazyJump | Jump) -> Jump:
        """Return a jump, computed from a step unless it is one."""
        if isinstance(lazy, Jump):
            return lazy
        whole, steps, k = self._of(lazy.steps), lazy.steps, lazy.step
        piece = int(steps.places[k]) + lazy.part
        of_regions, of_joints = steps.impulses[k], steps.joint_impulses[k]
        if steps.delays.size:
            now = 0.5 * steps.h + steps.delays[k] == steps.begins[piece]
            of_regions = np.where(now[: len(of_regions), None], of_regions, 0.0)
            of_joints = np.where(now[len(now) - len(of_joints) :], of_joints, 0.0)
        pairs = zip(self._regions, of_regions.tolist(), strict=False)
        impulses = {name: (normal, along) for name, (normal, along) in pairs if normal or along}
        joints = zip(self._joint_forces, of_joints.tolist(), strict=True)
        return Jump(
            lazy.t, lazy.j, lazy.region, lazy.cause, lazy.source, lazy.target,
            whole.terms[piece - 1].sum(axis=1), whole.terms[piece, :, 0].copy(),
            impulse=impulses, energy=whole.energies[piece],
            joint_impulse={name: size for name, size in joints if size != 0.0},
        )  # fmt: skip

    def _of(self, steps: Steps) -> _Polynomials:
        cached = self._polynomials
        if cached is None or cached.steps is not steps:
            cached = self._polynomials = _Polynomials(steps, self._energy)
        return cached


def cut(arc: Arc, step: int, end: float) -> Arc:
    """Return an arc that ends at local time `end`, in one of its steps."""
    begin = arc.times[step]
    s = (end - begin) / (arc.times[step + 1] - begin)
    times, coefficients = arc.times[: step + 2].copy(), arc.coefficients[: step + 1].copy()
    times[-1] = end
    coefficients[-1] *= s ** np.arange(coefficients.shape[2])
    assert arc.solved is not None
    solved = arc.solved[: step + 1]
    return Arc(arc.mode, arc.roles, arc.start, arc.j, times, coefficients, solved)
