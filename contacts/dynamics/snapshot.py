"""Dynamic quantities of a scene at one state, and the linear systems of contact forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.joints import (
    OFF_ROW,
    ROUND_OFF,
    JointGroup,
    JointNumbers,
    joint_groups,
    motions,
)
from contacts.dynamics.mechanics import Mechanics
from contacts.scene.modes import SignFriction
from contacts.solvers.saddle_point import INEXACT, SINGULAR, saddle
from statechart.arrays import Array
from statechart.errors import SingularMode
from statechart.formulas.tape import Tape
from statechart.formulas.writer import to_text

SCALARS, EDGES = 11, 7
"""Numbers per contact after the Jacobians and biases: gap, its rate, slip, point, tangent; from
`EDGES` on the unit edges of its cone in slide+ and slide-, at the size of its slip."""

INEXACT_SYSTEM = (
    "the equations of a mode cannot be solved to 1e-8: masses or lengths differ too much; "
    "use more similar ones"
)


class PerContact(NamedTuple):
    """Kinematics of one contact."""

    gap: float  # Distance from the surface, to first order
    # `gap_rate`, `slip`: Normal and tangential velocity
    gap_rate: float
    slip: float
    # `x`, `y`: Position of the point
    x: float
    y: float
    # `tx`, `ty`: Unit tangent of the surface there
    tx: float
    ty: float
    # Unit edges (n, t) of the friction cone in slide+ and slide- at the present slip; None: the
    # edges at rest
    edges: tuple[float, float, float, float] | None = None


class Snapshot(NamedTuple):
    """Dynamic quantities of a scene at one state.

    With joints, `n` is the number of independent motions that they allow: mass, forces, velocity,
    Jacobians and biases are reduced to the null space of the joint rows (`reduction`).
    """

    mass: Array  # (n, n): Mass matrix
    forces: Array  # (n,): Right-hand side of ``M a = forces`` without contacts
    velocity: Array  # (n,): Rates of the coordinates, or of the motions
    energy: float  # Kinetic plus gravity's
    contacts: tuple[PerContact, ...]  # In the order of the declaration
    jacobians: Array  # (c, 2, n): Rows: normal, tangential
    # (c, 2): Accelerations of the points, normal and tangential, without those of the coordinates
    biases: Array
    reduction: JointReduction | None = None  # None without joints
    # (k, 2): Static and kinetic limits of the couplings, which are the last of the contacts
    limits: Array = np.empty((0, 2))
    pads: int = 0  # Coordinates that are pads of compliant contacts, the last ones
    # (c, n): Generalised normal forces of compliant contacts; `forces` includes those with gap 0
    pushes: Array | None = None
    signs: SignNumbers | None = None  # None where no sign is dry friction

    @property
    def unreduced(self) -> Snapshot:
        """The snapshot in the scene's coordinates, without joints."""
        return self if self.reduction is None else self.reduction.unreduced

    @property
    def size(self) -> int:
        """Number n of the scene's coordinates, without pads."""
        return len(self.unreduced.forces) - self.pads

    @property
    def rates(self) -> Array:
        """Gaps, gap rates and slips (c, 3) of the contacts."""
        return np.array([contact[:3] for contact in self.contacts]).reshape(-1, 3)

    @property
    def soft(self) -> list[bool]:
        """Marks of the compliant contacts."""
        on_pads = self.unreduced.jacobians[:, 0, self.size :]
        return [bool(row.any()) for row in on_pads]

    def approaching(self, closed: Sequence[bool], speed: float) -> list[int]:
        """Return the closed contacts that approach their surfaces faster than `speed`."""
        contacts = enumerate(self.contacts)
        return [i for i, contact in contacts if closed[i] and contact.gap_rate < -speed]

    def remaining(self, closed: Sequence[bool], speed: float) -> list[bool]:
        """Return a mask of the closed contacts that leave their surfaces at most at `speed`."""
        contacts = zip(closed, self.contacts, strict=True)
        return [is_closed and contact.gap_rate <= speed for is_closed, contact in contacts]

    def moved(self, state: Array, velocity: Array) -> Array:
        """Return `state` (of the scene) after its velocity (n,) has jumped to `velocity`."""
        moved, n = state.copy(), self.size
        if self.reduction is None:
            moved[n : 2 * n] = velocity[:n]
        else:
            moved[n : 2 * n] += (self.reduction.basis @ (velocity - self.velocity))[:n]
        return moved

    def solved(self, accelerations: Array, forces: Array) -> tuple[Array, Array]:
        """Return the accelerations of the scene's coordinates and the forces of joint rows.

        The forces of redundant rows are zero.
        """
        if self.reduction is None:
            return accelerations[: len(accelerations) - self.pads], np.zeros(0)
        whole = self.unreduced
        full = self.reduction.basis @ accelerations + self.reduction.drift
        joint_forces = self.joint_forces(whole.mass @ full - whole.forces, forces)
        return full[: len(full) - whole.pads], joint_forces

    def joint_forces(self, total: Array, forces: Array) -> Array:
        """Return the forces of joint rows, which with those of contacts add up to `total` (n,)."""
        assert self.reduction is not None
        joints = self.reduction.joints
        independent, result = ~joints.redundant, np.zeros(len(joints.redundant))
        rest = total - np.einsum("ckn,ck->n", self.unreduced.jacobians, forces)
        result[independent] = np.linalg.lstsq(joints.jacobian[independent].T, rest)[0]
        return result


class SignNumbers(NamedTuple):
    """Signs that are dry friction."""

    frictions: tuple[SignFriction, ...]
    numbers: Array  # (k, 4): argument, slip, its bias, limit
    rows: Array  # (k, coordinates)


@dataclass(frozen=True, eq=False)
class JointReduction:
    """Null-space reduction by the joints at one state."""

    unreduced: Snapshot  # Without joints
    joints: JointNumbers
    basis: Array  # (coordinates, motions): Null space of the joint rows
    drift: Array  # (coordinates,): Accelerations at zero accelerations of the motions


class SnapshotTape:
    """Evaluates snapshots."""

    def __init__(self, mechanics: Mechanics, states: Mapping[str, str] | None = None) -> None:
        self.states = states  # Of the controllers; those at the start where None
        self.size = len(mechanics.q)
        self.count = len(mechanics.scene.frictional)
        forces = list(mechanics.generalised_forces)
        for i, place in enumerate(mechanics.held_forces):
            forces[i] += mechanics.parameters.ordered[place]
        names = [*mechanics.scene.frictional]
        contacts = [mechanics.contact(name) for name in names]
        scalars: list[sp.Expr] = []
        for contact in contacts:
            scalars += [contact.gap, contact.gap_rate, contact.slip]
            scalars += [*contact.anchor, *contact.slipping, *mechanics.sliding_edges(contact)]
        self._pads = tuple((names.index(name), pad) for name, pad in mechanics.pads.items())
        pads: list[sp.Expr] = []
        for name in mechanics.pads:
            body = mechanics.scene.contacts[name].point.body
            symbols = mechanics.contact(name)
            mass, _ = mechanics.inertia(body, mechanics.scene.bodies[body])
            pads += [mass, symbols.compliance, symbols.gap_rate]
        rows = mechanics.joint_rows
        self.joint_names = [f"{row.joint}.{row.component}" for row in rows]
        moved = np.zeros((len(rows), self.size + len(self._pads)), np.bool_)
        for k, row in enumerate(rows):
            moved[k, [*row.jacobian]] = True
        self._groups: tuple[JointGroup, ...] = joint_groups(moved)
        self.signs = sign_frictions(mechanics, mechanics.values_in(states))
        # Grouped by quantity, so that arrays are views of the outputs.
        quantities: list[list[sp.Expr]] = [
            mechanics.dense(mechanics.mass_matrix),
            forces,
            [mechanics.energy],
            mechanics.dense(row for c in contacts for row in (c.jacobian_n, c.jacobian_t)),
            [bias for c in contacts for bias in (c.bias_n, c.bias_t)],
            scalars,
            [number for r in rows for number in (r.gap, r.gap_rate, r.bias, r.status)],
            mechanics.dense(row.jacobian for row in rows),
            pads,
            [limit for name in mechanics.scene.couplings for limit in mechanics.limits(name)],
            [
                number
                for s in self.signs
                for number in (s.argument, s.slip, s.bias, s.limit, *mechanics.dense([s.row]))
            ],
        ]
        ends = accumulate(map(len, quantities), initial=0)
        self._slices = [slice(begin, end) for begin, end in pairwise(ends)]
        self.tape: Tape = mechanics.tape(
            [expression for quantity in quantities for expression in quantity],
            definitions=mechanics.controlled(states),
        )

    def joint_impulse(
        self, snapshot: Snapshot, before: Array, after: Array, impulses: Array
    ) -> dict[str, float]:
        """Return the impulses of joints other than zero in a jump between states, by name.

        `impulses` (c, 2) are those of contacts. The impulses of redundant rows are zero.
        """
        if snapshot.reduction is None:
            return {}
        change = (after - before)[self.size : 2 * self.size]
        total = snapshot.unreduced.mass[:, : self.size] @ change
        sizes = snapshot.joint_forces(total, impulses).tolist()
        return {name: size for name, size in zip(self.joint_names, sizes, strict=True) if size}

    def at(self, values: Array, state: Array, time: float) -> Snapshot:
        """Return the snapshot at `state`, reduced to the motions that joints allow."""
        whole, joints = self.unreduced(values, state, time)
        return whole if joints is None else _reduce(whole, joints, self._groups)

    def unreduced(
        self, values: Array, state: Array, time: float
    ) -> tuple[Snapshot, JointNumbers | None]:
        """Return the snapshot without joints, and the joint rows."""
        n, count, numbers = self.size, self.count, self.tape.at(state, values, time)
        (
            mass, forces, energy, jacobians, biases, scalars, joints, joint_jacobian, pads, limits,
            signs,
        ) = (numbers[part] for part in self._slices)  # fmt: skip
        whole = Snapshot(
            mass.reshape(n, n),
            forces,
            state[n : 2 * n],
            energy.item(),
            tuple(
                [
                    PerContact._make((*row[:EDGES], tuple(row[EDGES:])))
                    for row in scalars.reshape(count, SCALARS).tolist()
                ]
            ),
            jacobians.reshape(count, 2, n),
            biases.reshape(count, 2),
            limits=limits.reshape(-1, 2),
        )
        no_pads = (0, 0), (0, len(self._pads))
        if self.signs:
            rows = np.pad(signs.reshape(-1, 4 + n), no_pads)
            whole = whole._replace(signs=SignNumbers(self.signs, rows[:, :4], rows[:, 4:]))
        if self._pads:
            whole = self._padded(whole, pads)
        if not self.joint_names:
            return whole, None
        gaps, rates, bias, status = joints.reshape(-1, 4).T
        rows = np.pad(joint_jacobian.reshape(len(self.joint_names), n), no_pads)
        return whole, JointNumbers(gaps, rates, bias, rows, status != 0.0, status < OFF_ROW)

    def _padded(self, whole: Snapshot, numbers: Array) -> Snapshot:
        """Return the numbers with the pads of compliant contacts (`Mechanics.pads`).

        The mass of a pad, which the force of its contact holds at rest, is that of the body.
        """
        n, pads = self.size, len(self._pads)
        masses, forces, rates = numbers.reshape(pads, 3).T
        # A closing contact does not pull: its gap is zero up to round-off.
        pressed = np.where(rates < 0.0, np.maximum(forces, 0.0), forces)
        pushes, acting = np.zeros((self.count, n + pads)), np.zeros(self.count)
        mass = np.pad(whole.mass, (0, pads)) + np.diag(np.append(np.zeros(n), masses))
        jacobians = np.pad(whole.jacobians, ((0, 0), (0, 0), (0, pads)))
        biases, contacts = whole.biases.copy(), [*whole.contacts]
        for i, pad in self._pads:
            if pressed[pad] > 0.0:
                pushes[i] = pressed[pad] * jacobians[i, 0]
            acting[i] = contacts[i].gap <= 0.0
            jacobians[i, 0], biases[i, 0] = 0.0, 0.0
            jacobians[i, 0, n + pad] = 1.0
            contacts[i] = contacts[i]._replace(gap=max(contacts[i].gap, 0.0), gap_rate=0.0)
        return whole._replace(
            mass=mass, jacobians=jacobians, biases=biases, contacts=tuple(contacts), pads=pads,
            forces=np.append(whole.forces, -pressed) + acting @ pushes, pushes=pushes,
            velocity=np.append(whole.velocity, np.zeros(pads)),
        )  # fmt: skip


def close_compliant(snapshot: Snapshot, closed: Sequence[bool]) -> Snapshot:
    """Return the snapshot with the forces of compliant contacts whose gap is round-off."""
    if snapshot.pushes is None:
        return snapshot
    contacts, forces, reduction = [*snapshot.contacts], snapshot.forces, snapshot.reduction
    for i, contact in enumerate(snapshot.contacts):
        if closed[i] and contact.gap > 0.0 and snapshot.pushes[i].any():
            forces, contacts[i] = forces + snapshot.pushes[i], contact._replace(gap=0.0)
    if reduction is not None:
        reduction = replace(reduction, unreduced=close_compliant(reduction.unreduced, closed))
    return snapshot._replace(contacts=tuple(contacts), forces=forces, reduction=reduction)


def _reduce(whole: Snapshot, joints: JointNumbers, groups: Sequence[JointGroup]) -> Snapshot:
    allowed = motions(joints, whole.velocity, groups)
    basis = allowed.basis
    mass = basis.T @ whole.mass @ basis
    jacobians = whole.jacobians @ basis
    # What joints hold cannot move: a row of round-off would let a contact close there, or stop all.
    largest = np.abs(whole.jacobians) @ np.abs(basis)
    jacobians[np.abs(jacobians) <= ROUND_OFF * largest] = 0.0
    biases = whole.biases + whole.jacobians @ allowed.acceleration
    return whole._replace(
        mass=0.5 * (mass + mass.T),
        forces=basis.T @ (whole.forces - whole.mass @ allowed.acceleration),
        velocity=allowed.left_inverse @ (whole.velocity - allowed.velocity),
        jacobians=jacobians,
        biases=biases,
        reduction=JointReduction(whole, joints, basis, allowed.acceleration),
        pushes=None if whole.pushes is None else whole.pushes @ basis,
    )


def solve_kkt(
    mass: Array, right: Array, rows: Array, columns: Array, constants: Array
) -> tuple[Array, Array] | None:
    """Solve ``mass a - columns^T f = right``, ``rows a = constants``.

    The unknowns are accelerations and forces (m,), or velocity changes and impulses. None if the
    system is singular: the mode does not determine the motion. The saddle-point form is solved
    because the Delassus matrix ``J M^-1 J^T`` is wrong by 7 % at a moment of inertia of 1e-16, and
    does not exist at 0.

    Raises `SingularMode` if the solution cannot be trusted to 1e-8.
    """
    status, x = saddle(mass, right, rows, columns, constants)
    if status == SINGULAR:
        return None
    if status == INEXACT:
        raise SingularMode(INEXACT_SYSTEM)
    n = len(right)
    return x[:n], x[n:]


def answer(
    snapshot: Snapshot, rows: Array, columns: Array, rates: Array
) -> tuple[Array, Array] | None:
    """Return the velocity change by impulses along `columns` that changes `rows` by `rates`.

    The second array is the impulses; None if the system is singular (see `solve_kkt`).
    """
    return solve_kkt(snapshot.mass, np.zeros(len(snapshot.forces)), rows, columns, rates)


def sign_frictions(
    mechanics: Mechanics, known: Mapping[sp.Symbol, sp.Expr]
) -> tuple[SignFriction, ...]:
    """Return the signs of speeds in the forces of a scene, where all are dry friction; else none.

    Forces ``-limit sign(s) ds/dv`` of rates of change s: where s is zero the force is any up to the
    limit, as that of a locked coupling (Moreau 1988). So is that of a preload,
    ``-limit sign(p) dp/dq``, at rest in the place p = 0.

    `known` are the values of what states of controllers set.
    """
    if not mechanics.held_forces:
        return ()
    forces = [force.xreplace(known) for force in mechanics.generalised_forces]
    names = dict(zip(mechanics.variables, map(sp.Symbol, mechanics.variable_names), strict=True))
    found = []
    for sign in sorted(set().union(*(f.atoms(sp.sign) for f in forces)), key=sp.default_sort_key):
        (argument,) = sign.args
        size = sp.Dummy("sign", real=True)
        effects = [sp.diff(force.xreplace({sign: size}), size) for force in forces]
        is_rate = argument.has(*mechanics.v)
        slip = argument if is_rate else mechanics.rate(argument)
        row = {i: by for i, v in enumerate(mechanics.v) if (by := sp.diff(slip, v)) != 0}
        limit = next((-effects[i] / by for i, by in row.items()), None)
        kinked = argument.has(sp.sign, sp.Abs, sp.Max, sp.Min, *mechanics.controller_state.values())
        if (
            limit is not None
            and not (kinked or limit.has(sp.sign, size))
            and not any(sp.expand(e + limit * row.get(i, 0)) != 0 for i, e in enumerate(effects))
        ):
            name = to_text(sign.xreplace(names)).replace(" ", "")
            found.append(SignFriction(name, argument, slip, mechanics.drift(slip), limit, row))
        elif is_rate:
            return ()
    return tuple(found)
