"""Steps of one size: their arrays, the role of a contact in a step, and the stepped system."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Bools, Ints
from statechart.errors import SimulationError
from statechart.kernels.jit import kernel

DONE, BAD_INERTIA, NOT_FINITE, FULL, COARSE = range(5)
"""Status of a chunk: complete, singular inertia, non-finite number, too many contacts, rejected
step."""

SEPARATED, LASTING, HIT = range(3)
"""Role of a contact in a step."""

TIME_MARGIN = 1e-6
"""Round-off of time bounds, relative to a step: it must not separate simultaneous corners."""

ORDERED = 1e-3
"""Part of a step within which impacts at its middle are recorded in the order of their touches."""

SLOW = 2.0 + TIME_MARGIN
"""Approach velocity of an impact, in velocity changes of a free step: a slower contact lasts."""

RESIDUAL, ITERATIONS, CONTACTS, CALMED, AMBIGUOUS, UNENDED, CHOSEN, WORK, JAMMED = range(9)
"""Columns of `Chunk.stats`: residual of impulses; iterations; active contacts; 1 if restitution was
dropped because no impulses exist; 1 if a body is struck at several `LIVELY` places; fastest
approach after sequential impacts; 1 if the impulses are not unique; iterations times contacts, per
island; 1 + index of a jamming contact."""

_COLUMNS = JAMMED + 1


class Chunk(NamedTuple):
    """Consecutive steps of one size."""

    h: float  # Step size.
    states: Array  # (k + 1, 2 n)
    solved: Array  # (k, u): accelerations (n,) under finite forces, and further unknowns.
    # (k, r): mode of each region by the impulses of the step (codes of `contacts.states`), and the
    # recorded mode (`contacts.time_stepping.settling`).
    codes: Ints
    modes: Ints
    # (k, r): regions with an impact at mid-step; regions with undetermined forces.
    struck: Bools
    shared: Bools
    impulses: Array  # (k, r, 2): of impacts, including transmitted ones.
    joint_impulses: Array  # (k, f): impulses of joint forces and rolling resistances in impacts.
    gaps: Array  # (k, r): at the midpoints.
    # (k,): fastest approach of touching contacts; largest gap, of either sign, that a step closes.
    approach: Array
    closing: Array
    passed: Array  # (k,): part of a step in which a body that passed another overlapped it.
    # (k, r + n + f): time from mid-step to the impacts of regions, coordinates and joint forces;
    # of regions without one to the begin of the step, where their modes begin.
    impact_delay: Array
    energy_gain: Array  # (k,): relative energy gain; see `contacts.time_stepping.step_contacts`.
    stats: Array  # (k, e): solver statistics, columns `RESIDUAL` to `JAMMED`.

    @classmethod
    def allocate(
        cls, h: float, state: Array, sizes: tuple[int, int, int, int], count: int
    ) -> Chunk:
        """Allocate steps from `state`; sizes: coordinates, unknowns, regions, joint forces."""
        coordinates, unknowns, regions, joints = sizes
        states = np.empty((count + 1, len(state)))
        states[0] = state
        return cls(
            h, states, np.zeros((count, unknowns)), np.zeros((count, regions), dtype=np.int64),
            np.zeros((count, regions), dtype=np.int64), np.zeros((count, regions), dtype=np.bool_),
            np.zeros((count, regions), dtype=np.bool_), np.zeros((count, regions, 2)),
            np.zeros((count, joints)), np.full((count, regions), np.inf), np.zeros(count),
            np.zeros(count), np.zeros(count),
            np.zeros((count, regions + coordinates + joints)), np.zeros(count),
            np.zeros((count, _COLUMNS)),
        )  # fmt: skip

    @property
    def region_delay(self) -> Array:
        """The delays (k, r) of regions."""
        return self.impact_delay[:, : self.struck.shape[1]]

    def first(self, count: int) -> Chunk:
        """Return the first `count` steps."""
        return Chunk._make((self.h, self.states[: count + 1], *(rows[:count] for rows in self[2:])))

    def ends(self, start: float) -> Array:
        """Return the end times of steps from `start` on."""
        ends: Array = start + self.h * np.arange(1, len(self.codes) + 1, dtype=float)
        return ends

    def after(self, count: int) -> Chunk:
        """Return the steps after the first `count`."""
        return Chunk._make((self.h, *(rows[count:] for rows in self[1:])))


class SteppedSystem(ABC):
    """A system that provides (M, f, rows of contacts and joints) to its time step."""

    @property
    @abstractmethod
    def margins(self) -> dict[str, float]:
        """The smallest margins, at the midpoints of steps."""

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
            If no step can be taken.
        """

    @abstractmethod
    def forget(self) -> None:
        """Revert the last steps."""

    def next_steps(self, start: float, h: float, state: Array, count: int) -> Chunk | None:
        """Return up to `count` steps, and revert them; None if none can be taken."""
        steps = None
        with suppress(SimulationError):  # The run may end before.
            steps = self.steps(start, h, state, count)
        self.forget()
        return steps if steps is not None and len(steps.codes) else None

    @abstractmethod
    def switch(
        self, states: Mapping[str, str], at: tuple[Array, Array, float]
    ) -> tuple[dict[int, int], bool]:
        """Change the states of controllers; `at`: state before, state after, time.

        Returns the modes of regions whose surface moved, and whether one is struck at once.
        """

    def hold(
        self, stopped: Mapping[int, tuple[float, float]], leaving: Collection[int]
    ) -> dict[int, int]:
        """Let contacts with these gaps and slips last, and others leave; return their modes.

        For systems whose joints `StepControl` closes: a joint has stopped or lifted the contacts.
        """
        return {}

    @abstractmethod
    def slips(self, state: Array, time: float) -> Array:
        """Return the slips (r,) of regions that close without an impact; 0 for other regions."""

    def slip_errors(self, ends: Array, times: tuple[float, float], codes: Ints) -> Array:
        """Return the first-order errors of the slips (r,) of regions that land.

        `ends` (2, s) and `times`: states before and after the step before the landing; `codes`
        (r,): its modes.
        """
        return np.zeros(len(codes))

    @abstractmethod
    def depth_left(self, state: Array, time: float) -> float:
        """Return the penetration near a state that no motion removes; see `step_rejection`."""


@kernel
def contact_role(
    gap: float, level: float, lasting: bool, nearing: float, slow: float, closing: float,
    reached: float, near: float,
) -> tuple[int, float, float]:  # fmt: skip
    """Return the role of a contact in a step, its target gap, and the excess of its gap over that.

    Parameters
    ----------
    gap, level : float
        Gap at the midpoint, and target gap of a lasting contact.
    lasting : bool
    nearing, slow : float
        Approach velocity before the step, and its limit for a lasting contact.
    closing : float
        Largest approach of a slow contact within the step without impulses.
    reached : float
        Gap up to which a fast contact is struck in this step.
    near : float
        Gap tolerance.
    """
    if not lasting:
        # A contact that has come out does not sink as deep again.
        level = min(max(level, gap), 0.0)
    above = gap - level
    # A slow contact is active before it arrives: others may push it there in this step.
    soon = gap <= near or above <= closing
    if lasting or (nearing <= slow and soon):
        if above < 0.0 and not lasting:
            return LASTING, gap, 0.0
        return LASTING, level, above
    if above <= reached and nearing > slow:
        # It rests where it has landed: above zero it would fall and land again in every few steps.
        return HIT, min(gap, near), above
    return SEPARATED, level, above


@kernel
def curvature_speed(towards: float, depth: float) -> float:
    """Return the approach velocity, over `SLOW`, that curvature explains at a depth.

    After a tangential touch a surface that curves `towards` a point, with this acceleration,
    approaches at ``sqrt(2 towards depth)``, or somewhat slower if the curvature grows.
    """
    return math.sqrt(towards * depth) if towards > 0.0 and depth > 0.0 else 0.0


@kernel
def time_in_contact(start: float, rate: float, h: float) -> float:
    """Return how long the force of a compliant contact acts in a step: from its touchdown on.

    `start`, `rate`: gap and its rate at the start of the step.
    """
    if start > 0.0 >= start + h * rate:
        return max(h + start / rate, TIME_MARGIN * h)
    return h


@kernel
def compliant_row(
    stiffness: float, damping: float, own: float, start: float, rate: float, h: float, whole: float
) -> tuple[float, float]:
    """Return the compliance and the bias of a compliant contact's normal row in a step.

    The trapezoidal rule integrates the force to second order. The weight of implicit Euler is of
    second order in h, and 1 in steps that do not resolve the contact, which dissipate. In the
    step of a touchdown the force acts from the touchdown on: it then stores no more energy than
    it takes. A part of a step dissipates as the whole does: it must not return energy that the
    force would store in a depth which the whole does not resolve.

    Parameters
    ----------
    stiffness, damping : float
    own : float
        Velocity of the contact under unit impulses of all compliant contacts.
    start, rate : float
        Gap and its rate at the start of the step.
    h, whole : float
        Step size, and that of the step of which this one is a part.
    """
    weight = min(1.0, whole * whole * own * (stiffness + own * damping * damping))
    acts = time_in_contact(start, rate, h)
    if acts < h:
        h, start = acts, 0.0
    trapezoid = 1.0 - weight
    push = (0.25 * trapezoid * h + weight * whole) * stiffness + (0.5 + 0.5 * weight) * damping
    force = stiffness * (start + 0.25 * trapezoid * h * rate) + 0.5 * trapezoid * damping * rate
    return 1.0 / (h * push), force / push
