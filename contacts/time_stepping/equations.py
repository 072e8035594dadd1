"""Arguments of the compiled step of a scene, and its factored linear equations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.solvers.saddle_point import factorise, substitute
from contacts.states import FREE
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.kernels.jit import kernel

HOLDING = 3
"""Steps whose impulses include a landing: the landing; the next, as the motion turned the contact
off its target gap; and the one after, which stops that correction."""

LANDED = 2
"""The contact settles after an impact, not after a mode change."""

# Gap of a held row at mid-step that closes it at the ends of steps, in h^2/2 of its acceleration by
# curvature. A consistent start, and a change of the step size, then need no correction.
_PART_AT_MIDDLE = 0.25


class StepConstants(NamedTuple):
    """Constants of a run between changes of controllers and parameters."""

    # Tape over the state (2 n + w,), controller variables last (see
    # `statechart.formulas.tape.Tape.program`): mass (n, n), forces (n,), if `damped` their
    # derivatives by the rates (n, n); per contact Jacobian (2, n) and the numbers of `CONTACT`; per
    # joint component Jacobian (n,) and the numbers of `JOINT`; controlled values (u,); for `signs`
    # the inputs of `hold_signs`.
    equations: tuple[Ints32, Array, Ints32]
    flows: tuple[Ints32, Array, Ints32]  # Tape of the rates of controller variables (w,).
    size: int  # Number of coordinates.
    damped: bool
    parameters: Array  # shape (p,)
    cones: Array  # (c, 2): unit edges of friction cones at rest.
    # (c,): index of the current coefficient in the controlled values; -1 with a single one.
    coefficient_places: Ints
    restitution: Array  # shape (c,)
    plastic: bool  # Simultaneous impacts have no restitution.
    capped: bool  # Simultaneous impacts have restitution that adds no energy.
    pairs: Ints  # (c,): number of the touching pair of bodies, or of body and surface.
    # (c,): components of a contact's velocity that are bilaterally constrained: 0, 1 (normal), 2.
    bilateral: Ints
    slips: Ints  # (c,): whether a contact may slide: 0, 1, or 2 if its slides have a direction.
    joints: int  # Number of joint components.
    signs: int  # Number of signs in forces.
    impulse_tolerance: float  # Residual of impulses.
    # Tolerances of gap and approach velocity of a lasting contact. A contact is re-enabled up to
    # the gap tolerance below lasting ones.
    gap_tolerance: float
    speed_tolerance: float
    round_off: float  # Round-off of velocities.
    speed: float  # Velocity scale of the scene.
    # Smallest speed, and half the smallest energy, to which energy gains are relative.
    min_speed: float
    min_energy: float
    compliance: Array  # (c, 2): stiffness and damping; 0 if rigid.
    couplings: int  # Number of couplings, the last contacts; see `load_couplings`.
    carriers: Ints  # (c,): contacts whose normal forces load rolling resistances; -1: none.


@kernel
def is_coupling(scene: StepConstants, i: int) -> bool:
    """Return whether contact i is a coupling."""
    return i >= len(scene.cones) - scene.couplings


class ContactHistory(NamedTuple):
    """Contact state that persists between steps."""

    # (c,): target gap of a lasting contact, from its landing; above 0 only for an opposed contact
    # of a deeper one; infinite: that of the first midpoint.
    target_gap: Array
    # (c,): whether it lasts; its slip at the end of the last step, 0 within round-off.
    closed: Bools
    slip: Array
    # (c,): number of steps, from this one on, whose impulses include a landing.
    landing_steps: Ints
    # (c,): whether its mode follows from accelerations: 0, 1 after a mode change, `LANDED` after an
    # impact; the mode of the last step.
    settling: Ints
    modes: Ints
    disabled: Bools  # (c,): whether its condition disables it.
    left_behind: (
        Bools  # (c,): whether it was closed when disabled, and has not left its surface yet.
    )
    last: Array  # (c, 3): condition, gap and gap rate at the last midpoint.
    # (c, 4): depths of contacts off although their conditions hold: when these began to hold, now,
    # and the least that ended with failing conditions; when a contact was first disabled as its
    # point touched.
    missed_depths: Array
    light: Bools  # (1,): whether coordinates without inertia received one.
    impulses: Array  # (c, 2): impulses of the last problem.
    contact_change: Array  # (n,): change of rates by lasting contacts in the last step.

    @classmethod
    def of(cls, off: Bools, size: int) -> ContactHistory:
        """Return the history of contacts that have not touched yet."""
        count = len(off)
        return cls(
            np.zeros(count), np.zeros(count, dtype=np.bool_), np.zeros(count),
            np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64), np.full(count, FREE),
            off.copy(), np.zeros(count, dtype=np.bool_), np.full((count, 3), np.nan),
            np.tile([0.0, 0.0, np.inf, np.inf], (count, 1)), np.zeros(1, dtype=np.bool_),
            np.zeros((count, 2)), np.zeros(size),
        )  # fmt: skip

    def copy(self) -> ContactHistory:
        """Return a copy."""
        return ContactHistory._make(array.copy() for array in self)


class TapeValues(NamedTuple):
    """Values of a step's tape; the Jacobian of contact i begins at ``first + per * i``."""

    numbers: Array  # shape (k,)
    # Number of coordinates; start of contacts; values per contact.
    size: int
    first: int
    per: int


class FactoredEquations(NamedTuple):
    """Factored equations of a step in rates (n,), bilateral contacts and joints."""

    factors: Array  # See `contacts.solvers.saddle_point.factorise`.
    order: Ints
    # Changes in a step: initially without free contacts; under finite forces.
    change: Array
    lasting: Array


class StepInstant(NamedTuple):
    """The middle of a step."""

    time: float
    state: Array  # Before the step.
    middle: Array  # Coordinates at mid-step, velocities before the step.


class ContactRoles(NamedTuple):
    """Roles of contacts in a step."""

    # (c,): active; struck; lasting while its condition ceases to hold.
    active: Bools
    hit: Bools
    leaving: Bools
    # (c,): gap of a disabled contact where its point leaves another surface in this step.
    entered: Array
    groups: Ints  # (c,): first contact of the coupled group; see `label_groups`.
    # (c, 2): bias (required velocities, negated); velocities before the step, and after it without
    # impulses.
    bias: Array
    before: Array
    free: Array


CONTACT, EDGES = 12, 8
"""Numbers of a contact after its Jacobian (2, n): biases (2,), gap, gap rate, slip, condition,
condition without the ends of edges at valleys, the same with obtuse valleys; from `EDGES` on the
cone edges in slide+ and slide- at the size of its slip. The gap of a coupling is its static limit;
of rolling resistance, its length."""

JOINT = 4
"""Numbers of a joint's row after its Jacobian (n,): gap, rate, bias, whether it is redundant."""

# Inertia of coordinates without one, relative to the others at their lever arms.
_LIGHTEST = 1e-9


@kernel
def solve_factored(factors: Array, order: Ints, right: Array) -> Array:
    """Return the solution for one right side (m,)."""
    x = np.empty(len(right))
    substitute(factors, order, right, x)
    return x


@kernel
def _lightest(numbers: Array, n: int, first: int, contacts: int) -> Array:
    """Return a lower bound (n,) of inertias, small relative to the bodies at their lever arms."""
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
    numbers: Array, n: int, h: float, damping: float, held: Ints, joints: int, light: bool
) -> tuple[bool, Array, Ints, Array]:
    """Return (regular, factors, order, right side) of the equations without free contacts.

    `numbers` (m,): see `contacts.time_stepping.scene_step.step_scene`; n coordinates; `held` (c,);
    `damping`: how long forces act at the new rates, 0 if they do not depend on rates; `light`: give
    coordinates without inertia a small one.
    """
    first = n * n + n + (n * n if damping > 0.0 else 0)
    size = n + joints
    for i in range(len(held)):
        size += held[i]
    matrix, right = np.zeros((size, size)), np.zeros(size)
    lightest = _lightest(numbers, n, first, len(held)) if light else np.zeros(n)
    for i in range(n):
        right[i] = h * numbers[n * n + i]
        for j in range(n):
            matrix[i, j] = numbers[n * i + j]
        if matrix[i, i] < lightest[i]:
            matrix[i, i] = lightest[i]
        if damping > 0.0:
            for j in range(n):
                matrix[i, j] -= damping * numbers[n * n + n + n * i + j]
    at = n
    for i in range(len(held)):
        row = first + (2 * n + CONTACT) * i
        for d in range(held[i]):
            # Surface velocity, and stabilisation of the gap.
            bias = 0.5 * h * numbers[row + 2 * n + d]
            offset = numbers[row + 2 * n + 3 + d] + bias
            if d == 0:
                offset += numbers[row + 2 * n + 2] / h - _PART_AT_MIDDLE * bias
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
            bias = 0.5 * h * numbers[row + n + 2]
            right[at] = -numbers[row + n] / h - numbers[row + n + 1]
            right[at] -= (1.0 - _PART_AT_MIDDLE) * bias
        at += 1
    order = np.arange(size)
    return factorise(matrix, order, np.empty((size, size))), matrix, order, right
