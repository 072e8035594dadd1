"""Polynomials of time steps, and lazy arcs and jumps computed from them on access.

Positions are quadratic and rates linear in time, consistent with the midpoint rule at the ends of
steps. A step with impacts has them at one instant, and consists of two parts under the same finite
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
    left: Array, right: Array, acceleration: Array, lengths: tuple[Array, Array], n: int
) -> tuple[Array, Array]:
    """Return the coefficients (k, w, TERMS) of both parts of steps with impacts.

    `acceleration` (k, n) is that under finite forces; `lengths` (k, 1) are those of the parts.
    """
    variables = slice(2 * n, None)
    middle = 0.5 * (left[:, variables] + right[:, variables])
    # Velocities before and after make the ends of the step exact.
    rates, (before, after) = right[:, n : 2 * n], lengths
    second = np.empty_like(right)
    second[:, :n] = right[:, :n] - after * (rates - 0.5 * after * acceleration)
    second[:, n : 2 * n] = rates - after * acceleration
    second[:, variables] = middle
    parts = []
    for begin, change, length in (
        (left, middle - left[:, variables], before),
        (second, -(middle - right[:, variables]), after),
    ):
        terms = np.zeros((*left.shape, TERMS))
        terms[:, :, 0] = begin
        terms[:, :n, 1] = length * begin[:, n : 2 * n]
        terms[:, :n, 2] = 0.5 * length**2 * acceleration
        terms[:, n : 2 * n, 1] = length * acceleration
        terms[:, variables, 1] = change
        parts.append(terms)
    return parts[0], parts[1]


def step_polynomials(
    states: Array, acceleration: Array, h: float, delay: Array, hit: Bools, n: int
) -> Array:
    """Return the coefficients (p, w, TERMS) of steps of size `h` between states (k + 1, w).

    One polynomial per step, two per step `hit` (k,), whose impact is `delay` (k,) after its middle;
    acceleration, `n`: see `struck`.
    """
    left, right = states[:-1], states[1:]
    if not hit.any():
        return smooth(left, right, h, n)
    before = 0.5 * h + delay[hit, None]
    parts = struck(left[hit], right[hit], acceleration[hit], (before, h - before), n)
    pieces = np.concatenate([smooth(left[~hit], right[~hit], h, n), *parts])
    # Gathering rows is ten times as fast as scattering them.
    at = _places(hit)[:-1]
    return pieces[np.argsort(np.concatenate([at[~hit], at[hit], at[hit] + 1]))]


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
    """Consecutive steps of one size; each is one piece of an arc, one with impacts two."""

    begin: Clock
    h: float
    coordinates: int
    states: Array  # shape (k + 1, w)
    solved: Array  # (k, u): unknowns.
    # Impulses of impacts; struck regions. Empty if no jumps are recorded.
    impulses: Array  # shape (k, r, 2)
    joint_impulses: Array  # shape (k, f)
    struck: Bools  # shape (k, r)
    hit: Bools  # (k,): whether a step has impacts.
    impact_delay: Array  # (k,): time from the middle of a step to its impacts.
    places: Ints  # (k + 1,): first piece of each step.
    # (p, u): unknowns of pieces, if they differ from those of steps.
    halves: Array | None = None

    @classmethod
    def of(cls, chunk: Chunk, hit: Bools, coordinates: int, begin: Clock) -> Steps:
        """Return the steps of a chunk."""
        return cls(
            begin, chunk.h, coordinates, _compact(chunk.states), _compact(chunk.solved),
            _compact(chunk.impulses), _compact(chunk.joint_impulses), _compact(chunk.struck), hit,
            _compact(chunk.impact_delay), _places(hit),
        )  # fmt: skip

    def without_impulses(self) -> Steps:
        """Drop impulses and struck regions."""
        names = ("impulses", "joint_impulses", "struck")
        return self._replace(**{name: getattr(self, name)[:0].copy() for name in names})

    @property
    def width(self) -> int:
        """Bytes of the polynomials of a piece."""
        return TERMS * self.states[0].nbytes

    def without_forces(self, before: Ints, after: Ints, columns: Ints) -> Steps:
        """Clear the forces of open regions in the halves of steps with impacts.

        `columns` (r, 2): columns of the forces of regions.
        """
        if not self.hit.any():
            return self
        halves = np.repeat(self.solved, 1 + self.hit, axis=0)
        for rows, places in ((before, self.places[:-1]), (after, self.places[:-1] + 1)):
            opened = (rows[self.hit] == FREE) | (rows[self.hit] == OFF_CODE)
            which, regions = np.nonzero(opened)
            halves[places[self.hit][which, None], columns[regions]] = 0.0
        return self._replace(halves=halves)

    def at(self, step: int, half: int) -> Clock:
        """Return when a step, or its second part, begins."""
        delay = 0.5 * self.h + float(self.impact_delay[step]) if half else 0.0
        return self.begin.later(self.h * step + delay).short

    @property
    def ends(self) -> Array:
        """The ends of pieces, after `begin`."""
        steps = self.h * np.arange(len(self.hit) + 1.0)
        middles = steps[:-1] + (0.5 * self.h + self.impact_delay)
        return np.insert(steps, np.flatnonzero(self.hit) + 1, middles[self.hit])


def _places(hit: Bools) -> Ints:
    places = np.zeros(len(hit) + 1, np.int64)
    np.cumsum(1 + hit, out=places[1:])
    return places


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
    """A jump as a step with impacts."""

    steps: Steps
    step: int
    t: float
    j: int
    region: str
    cause: str
    source: Key
    target: Key


class _Polynomials:
    """Coefficients, ends and unknowns of all pieces of some steps."""

    def __init__(self, steps: Steps, energy: Callable[[Array, Array], Array] | None) -> None:
        n, hit = steps.coordinates, np.asarray(steps.hit)
        delay, halves = np.asarray(steps.impact_delay), steps.halves
        self.terms = step_polynomials(steps.states, steps.solved[:, :n], steps.h, delay, hit, n)
        self.ends = steps.ends
        self.unknowns = np.repeat(steps.solved, 1 + hit, axis=0) if halves is None else halves
        self.steps, self._energy = steps, energy

    @cached_property
    def energies(self) -> dict[int, tuple[float, float]]:
        """Energies before and after the impacts of each step with impacts."""
        hit = np.flatnonzero(self.steps.hit)
        second = self.steps.places[hit] + 1
        times = np.array([self.steps.at(k, 1).high for k in hit.tolist()])
        sides = (self.terms[second - 1].sum(axis=2), self.terms[second, :, 0])
        assert self._energy is not None
        energies_of_sides = (self._energy(side, times).tolist() for side in sides)
        return dict(zip(hit.tolist(), zip(*energies_of_sides, strict=True), strict=True))


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
        whole, steps = self._of(lazy.steps), lazy.steps
        first = int(steps.places[lazy.step])
        of_regions = zip(self._regions, steps.impulses[lazy.step].tolist(), strict=False)
        impulses = {name: (normal, along) for name, (normal, along) in of_regions}
        impulses = {name: impulse for name, impulse in impulses.items() if any(impulse)}
        of_joints = zip(self._joint_forces, steps.joint_impulses[lazy.step].tolist(), strict=True)
        return Jump(
            lazy.t, lazy.j, lazy.region, lazy.cause, lazy.source, lazy.target,
            whole.terms[first].sum(axis=1), whole.terms[first + 1, :, 0].copy(),
            impulse=impulses, energy=whole.energies[lazy.step],
            joint_impulse={name: size for name, size in of_joints if size != 0.0},
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
