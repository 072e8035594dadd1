"""Arguments of the compiled step of a scene, and its linear equations, factored once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.solvers.saddle_point import factorise, substitute
from contacts.states import FREE
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.kernels.jit import kernel

HOLDING = 3
"""So many steps hold an impulse: that of a landing; the next, as the motion turned the contact off
its level in the landing's; and the one after that, which ends what the next began."""

LANDED = 2
"""The contact settles after an impact, not after a change of a mode."""


class StepConstants(NamedTuple):
    """Constants of a run between changes of controllers and conditions."""

    # The program of a tape over the state (2 n + w,), which ends with what controllers remember
    # (see `statechart.formulas.tape.Tape.program`): mass (n, n), forces (n,), where `damped` also
    # their derivatives by the rates (n, n), then per contact Jacobian (2, n) and what `CONTACT`
    # lists, per component of a joint Jacobian (n,) and what `JOINT` lists, and what controllers
    # give (u,), and for `signs` what `hold_signs` reads.
    equations: tuple[Ints32, Array, Ints32]
    flows: tuple[Ints32, Array, Ints32]  # That of the rates of what controllers remember (w,).
    size: int  # Coordinates.
    damped: bool
    parameters: Array  # shape (p,)
    cones: Array  # (c, 2): unit edges of friction cones at rest.
    # (c,): place of the coefficient in use among what controllers give; -1 where there is but one.
    used: Ints
    restitution: Array  # shape (c,)
    plastic: bool  # Whether contacts that are hit together do not rebound.
    capped: bool  # Whether those rebound, as far as no energy is added.
    # (c,): the number of the pair of a body and a surface's body, or a surface, that touch.
    pairs: Ints
    # (c,): how many components of a contact's velocity are constrained whatever the impulse: 0, 1
    # (normal), 2 (both).
    held: Ints
    slips: Ints  # (c,): whether a contact may slide: 0, 1, or 2 if its slides have a direction.
    joints: int  # Number of components of joints.
    signs: int  # Number of signs of velocities in forces.
    allowed: float  # Residual of impulses that are good enough.
    # Tolerances of gaps and speeds. A contact touches up to this gap, and lasts up to this speed of
    # approach. A contact that was off comes back where it is no deeper than the gap tolerance below
    # those that last.
    near: float
    still: float
    # Round-off of velocities: no contact begins to press at an approach up to this.
    rounding: float
    speed: float  # The scene's scale of velocities.
    # The energy that contacts add is relative to the energy of their motion: at this speed at
    # least, and twice this energy at least.
    slowest: float
    negligible: float
    # (c, 2): stiffness and damping of compliant contacts; 0 of rigid ones.
    soft: Array
    couplings: int  # So many of the contacts, the last, are couplings; see `load_couplings`.
    carriers: Ints  # (c,): contacts whose normal forces load rolling resistances; -1: none.


@kernel
def is_coupling(scene: StepConstants, i: int) -> bool:
    """Return whether contact i is a coupling."""
    return i >= len(scene.cones) - scene.couplings


class ContactHistory(NamedTuple):
    """Contact state that lasts from step to step."""

    # (c,): gap at which a contact that lasts is kept: what its landing has left, above 0 only where
    # that of one that faces it is as far below.
    level: Array
    # (c,): whether it lasts, and slipped in the last step by more than rounding.
    closed: Bools
    slid: Bools
    # (c,): of how many steps, this one included, impulses are not those of forces alone.
    fresh: Ints
    # (c,): whether its mode is read from accelerations: 0, 1 after a change of a mode, `LANDED`
    # after an impact; the mode of the last step.
    settling: Ints
    shown: Ints
    off: Bools  # (c,): whether its condition keeps it off.
    # (c,): whether it was closed as it went off, and its point has not left its surface yet.
    behind: Bools
    past: Array  # (c, 3): condition, gap and its rate in the middle of the last step.
    # (c, 4): depths of contacts that are off though their conditions hold: where these began to
    # hold, and now; and the least that contacts never came back from, before their conditions
    # failed; when a contact first went off as its point touched.
    missed: Array
    light: Bools  # (1,): whether coordinates without an inertia of their own were given one.
    pushes: Array  # (c, 2): impulses of the last problem.
    pushed: Array  # (n,): what contacts that last changed the rates by in the last step.

    @classmethod
    def of(cls, off: Bools, size: int) -> ContactHistory:
        """Return that of contacts that have not touched yet, in so many coordinates."""
        count = len(off)
        return cls(
            np.zeros(count),
            np.zeros(count, dtype=np.bool_),
            np.zeros(count, dtype=np.bool_),
            np.zeros(count, dtype=np.int64),
            np.zeros(count, dtype=np.int64),
            np.full(count, FREE),
            off.copy(),
            np.zeros(count, dtype=np.bool_),
            np.full((count, 3), np.nan),
            np.tile([0.0, 0.0, np.inf, np.inf], (count, 1)),
            np.zeros(1, dtype=np.bool_),
            np.zeros((count, 2)),
            np.zeros(size),
        )

    def copy(self) -> ContactHistory:
        """Return it as it is now."""
        return ContactHistory._make(array.copy() for array in self)


class TapeValues(NamedTuple):
    """The numbers of a step's tape; the Jacobian of contact i begins at ``first + per * i``."""

    numbers: Array  # shape (k,)
    # Coordinates; where contacts begin; numbers of a contact.
    size: int
    first: int
    per: int


class FactoredEquations(NamedTuple):
    """The equations of a step in all that moves: rates (n,), what is held, and joints."""

    factors: Array  # See `contacts.solvers.saddle_point.factorise`.
    order: Ints
    # What a step changes: without free contacts at first; under what lasts alone.
    change: Array
    lasting: Array


class StepInstant(NamedTuple):
    """The middle of a step."""

    time: float
    state: Array  # Before the step.
    middle: Array  # The coordinates there, and the velocities before the step.


class ContactRoles(NamedTuple):
    """Roles of contacts in a step."""

    # (c,): who takes part, who is struck, whose condition ceases to hold while it lasts.
    active: Bools
    hit: Bools
    leaving: Bools
    # (c,): the gap of a contact that is off where its point leaves another surface in this step.
    entered: Array
    groups: Ints  # (c,): the first of those that feel each other's impulses; see `label_groups`.
    # (c, 2): what velocities may not fall below, negated; what they are before the step, and after
    # it without impulses.
    wanted: Array
    before: Array
    free: Array


CONTACT, EDGES = 12, 8
"""Numbers of a contact beside its Jacobian (2, n): biases (2,), gap, its rate, slip, condition, and
the condition without the ends of edges at which another edge makes a valley, and that with obtuse
valleys; from `EDGES` on the unit edges of its friction cone in slide+ and slide-, at the size of
its slip. The gap of a coupling
is its limit at rest; of rolling resistance, its length."""

JOINT = 4
"""Numbers of a joint's row beside its Jacobian (n,): gap, rate, bias, whether others imply it."""

# Coordinates without an inertia of their own get this part of what the others have at their levers.
_LIGHTEST = 1e-9


@kernel
def solve_factored(factors: Array, order: Ints, right: Array) -> Array:
    """Return the solution for one right side (m,)."""
    x = np.empty(len(right))
    substitute(factors, order, right, x)
    return x


@kernel
def _lightest(numbers: Array, n: int, first: int, contacts: int) -> Array:
    """Return the least inertia (n,) of every coordinate: small beside the bodies' at its levers."""
    reach = np.zeros(n)
    for i in range(contacts):
        row = first + (2 * n + CONTACT) * i
        for d in range(2):
            for j in range(n):
                reach[j] = max(reach[j], abs(numbers[row + d * n + j]))
    heaviest = 0.0
    for j in range(n):
        if reach[j] > 0.0:
            heaviest = max(heaviest, numbers[n * j + j] / reach[j] ** 2)
    return _LIGHTEST * heaviest * reach**2


@kernel
def factor_equations(
    numbers: Array, n: int, h: float, damped: bool, held: Ints, joints: int, light: bool
) -> tuple[bool, Array, Ints, Array]:
    """Return (regular, factors, order, right side) of what moves without free contacts' impulses.

    Parameters
    ----------
    numbers : (m,)
        Of the step; see `contacts.time_stepping.scene_step.step_scene`.
    n : int
        Number of coordinates.
    held : (c,) array of int
    light : bool
        Give coordinates without an inertia of their own a small one.
    """
    first = n * n + n + (n * n if damped else 0)
    size = n + joints
    for i in range(len(held)):
        size += held[i]
    matrix, right = np.zeros((size, size)), np.zeros(size)
    least = _lightest(numbers, n, first, len(held)) if light else np.zeros(n)
    for i in range(n):
        right[i] = h * numbers[n * n + i]
        for j in range(n):
            matrix[i, j] = numbers[n * i + j]
        if matrix[i, i] < least[i]:
            matrix[i, i] = least[i]
        if damped:
            for j in range(n):
                matrix[i, j] -= 0.5 * h * numbers[n * n + n + n * i + j]
    at = n
    for i in range(len(held)):
        row = first + (2 * n + CONTACT) * i
        for d in range(held[i]):
            # The velocity that the surface gives it, and what keeps the gap at zero.
            offset = numbers[row + 2 * n + 3 + d] + 0.5 * h * numbers[row + 2 * n + d]
            if d == 0:
                offset += numbers[row + 2 * n + 2] / h
            for j in range(n):
                matrix[at, j] = numbers[row + d * n + j]
                matrix[j, at] = -numbers[row + d * n + j]
            right[at] = -offset
            at += 1
    for i in range(joints):
        row = first + (2 * n + CONTACT) * len(held) + (n + JOINT) * i
        if numbers[row + n + 3] != 0.0:
            matrix[at, at] = 1.0
        else:
            for j in range(n):
                matrix[at, j] = numbers[row + j]
                matrix[j, at] = -numbers[row + j]
            right[at] = -numbers[row + n] / h - numbers[row + n + 1]
            right[at] -= 0.5 * h * numbers[row + n + 2]
        at += 1
    order = np.arange(size)
    return factorise(matrix, order, np.empty((size, size))), matrix, order, right
