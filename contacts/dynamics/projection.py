"""Projection of positions and velocities onto the constraints of joints and closed contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import sympy as sp

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.joints import JointNumbers, dependent
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot, SnapshotTape, answer
from contacts.scene.modes import Bearing
from contacts.solvers.dependence import reduce_to_independent
from contacts.states import COUPLING_STATES, OPEN, STICKING
from statechart.arrays import EPS, Array, Bools
from statechart.automaton.constraints import Constraints
from statechart.automaton.laws import moving_mode, region_roles
from statechart.automaton.trace import Key, Roles
from statechart.errors import NoConsistentMode, SingularMode
from statechart.formulas.tape import Tape

# Position errors above this part of the tolerance are projected when a mode is entered.
DRIFT = 0.05
# Velocity errors above this part of the tolerance are projected, too: they move the point as long
# as the flow lasts. At the smallest tolerance this is nine round-offs of the scene's speed, below
# which projection is not effective.
CREEP = 2e-3
# Distance from a surface, relative to the scene's length, beyond which a step missed a curvature.
# Enclosures as narrow as the gap's tolerance would take 1e5 boxes a step.
BLIND_GAP = 1e-4
# A residual that projection cannot reduce counts as round-off up to this multiple of the effect of
# the last bits of the state.
_MAX_ROUNDINGS = 64.0
# Relative shift of every number that measures this effect.
_SHIFT = 2.0**-26


class Projection:
    """Coordinate projection of a flow, whose constraints hold on acceleration level only.

    Without it they drift as N^2 in the number of steps. Baumgarte stabilisation would enter the
    forces that guards read. The outputs of `tape` are the constrained quantities: five numbers per
    contact, two per joint row.
    """

    def __init__(self, mechanics: Mechanics, snapshots: SnapshotTape) -> None:
        outputs: list[sp.Expr] = []
        for name in mechanics.scene.frictional:
            contact = mechanics.contact(name)
            outputs += [contact.gap, contact.gap_rate, contact.slip, *contact.anchor]
        for row in mechanics.joint_rows:
            outputs += [row.gap, row.gap_rate]
        self._joints = tuple(row.joint for row in mechanics.joint_rows)
        # Controls that say which joints are closed -> 1 or 0.
        states = dict(mechanics.controlled(snapshots.states))
        closed = [row.closed for row in mechanics.joint_rows]
        self._on = [on is None or states[on] != 0 for on in closed]
        self._snapshots = snapshots
        self._compile = mechanics.tape
        self.tape = mechanics.tape(outputs, definitions=[*states.items()])
        self._gaps = tuple(outputs[: 5 * len(mechanics.scene.frictional) : 5])
        self._soft = tuple(name in mechanics.pads for name in mechanics.scene.frictional)
        contacts = mechanics.scene.contacts
        self._curved = [mechanics.curved(n) and n not in mechanics.pads for n in contacts]
        self.missed_surface_tape = cache(self._missed_surface_tape)

    def constraints(
        self, setup: SceneSetup, roles: Roles, start: float, anchor: Array
    ) -> Constraints:
        """Return the constraints of a flow (see `statechart.automaton.laws.Laws`).

        Pinned points keep their positions of the state `anchor` at the time `start`, in the frame
        of the surface. `project` raises `NoConsistentMode` if the joints cannot all hold, and
        `SingularMode` if their constraints have become dependent.
        """
        values, tolerances, scales = setup.values, setup.tolerances, setup.scales
        gap_weight, speed_weight = 1.0 / tolerances["gap"], 1.0 / tolerances["speed"]
        flow = constraint_key(roles, self._soft)
        pinned = [i for i, state in enumerate(flow) if state in STICKING]
        weights = self._weights(flow, gap_weight, speed_weight)
        targets = np.zeros(len(weights))
        if pinned:
            places = np.add.outer(5 * np.array(pinned), [3, 4])
            targets[places] = self.tape.at(anchor, values, start)[places]

        def project(state: Array, time: float) -> Array:
            snapshot, joints = self._snapshots.unreduced(values, state, time)
            pins = self._snapshots.unreduced(values, anchor, start)[0] if pinned else None
            projected = _brought(flow, snapshot, joints, state, pinned=pins)
            if joints is None:
                return projected
            before = constraints.off(state, values, time)
            residual = constraints.off(projected, values, time)
            if residual > 0.5 * before:
                # The first projection uses the velocity constraints at the old position, which
                # are off by as much at the new one if a body turns fast; the second is not.
                numbers = self._snapshots.unreduced(values, projected, time)
                projected = _brought(flow, *numbers, projected, pinned=pins)
                residual = constraints.off(projected, values, time)
            if residual > 0.5 * before:
                # The round-off of large angles and rates can exceed the tolerances.
                rounding = self._rounding(state, values, time) * (gap_weight, speed_weight)
                if residual <= _MAX_ROUNDINGS * rounding.max():
                    return state
                if residual > 1.0:
                    rows = joints.jacobian[:, : snapshot.size] * scales.coordinates
                    independent = np.flatnonzero(~joints.redundant).tolist()
                    reason = dependent([(self._joints[i], rows[i]) for i in independent])
                    if reason:
                        raise SingularMode(reason)
                    rows = self.tape.at(projected, values, time)[5 * len(flow) :].reshape(-1, 2)
                    rows = np.where(joints.on[:, None], np.abs(rows), 0.0)
                    raise self._broken(rows, joints.redundant, gap_weight, speed_weight, time)
            return projected

        # At a loose tolerance a state that is not projected may be off by the gap's tolerance.
        blind_gap = max(BLIND_GAP * scales.length, tolerances["gap"])
        missed = self.missed_surface_tape(flow)
        constraints = Constraints(self.tape, targets, weights, project, missed, blind_gap)
        return constraints

    def _rounding(self, state: Array, values: Array, time: float) -> Array:
        """Return the effect of the last bits of the state on the joint rows (rows, 2)."""
        displaced = state + _SHIFT * np.diag(state)
        rows = np.array([self.tape.at(one, values, time) for one in (state, *displaced)])
        moves = np.abs(rows[1:] - rows[0]).sum(axis=0)
        return (EPS / _SHIFT) * moves[5 * len(self._gaps) :].reshape(-1, 2)

    def _missed_surface_tape(self, flow: Key) -> Tape | None:
        """Return a tape of the gaps to curved surfaces, which detects bumps that a step missed."""
        contacts = zip(self._gaps, flow, self._curved, strict=False)
        gaps = [gap for gap, state, curved in contacts if curved and state not in OPEN]
        return self._compile([*gaps, *(-gap for gap in gaps)]) if gaps else None

    def _weights(self, flow: Key, gap_weight: float, speed_weight: float) -> Array:
        # Of each contact: gap, its rate, slip, and position; of each joint row gap and rate.
        parts = np.array([gap_weight, speed_weight, speed_weight, gap_weight, gap_weight])
        states = np.array(flow, str)
        shut, sticks = ~np.isin(states, OPEN), np.isin(states, STICKING)
        weights = np.array([shut, shut, sticks, sticks, sticks]).T * parts
        weights[np.array(self._soft, bool)] *= (0.0, 0.0, 1.0, 0.0, 0.0)
        return np.append(weights, np.outer(self._on, parts[:2]))

    def _broken(
        self, rows: Array, redundant: Bools, gap_weight: float, speed_weight: float, time: float
    ) -> NoConsistentMode:
        k = int(np.argmax((rows * (gap_weight, speed_weight)).max(axis=1)))
        gap, rate = rows[k].tolist()
        apart = gap * gap_weight >= rate * speed_weight
        violation = f"comes apart by {gap:.3g}" if apart else f"parts at {rate:.3g}"
        implied = ", implied by the others at the start, not past a dead point"
        cause = f"{implied}; take the engine impulse" if redundant[k] else ""
        return NoConsistentMode(
            f"the joints {', '.join(dict.fromkeys(self._joints))} cannot all hold at t = "
            f"{time:.6g}: {self._joints[k]!r} {violation}{cause}"
        )


def constraint_key(roles: Roles, soft: Sequence[bool]) -> Key:
    """Return the states of roles, `slide` for a pinned compliant contact that others imply.

    Its tangential constraint holds within a tolerance only (`contacts.scene.modes.share_of`):
    projection on it would take the rotation of a body on two feet that are nearly level.
    """
    key, shares = [*moving_mode(roles)], [role.share for role in region_roles(roles)]
    for i in np.flatnonzero(soft).tolist():
        share = shares[i]
        if key[i] == "pin" and isinstance(share, Bearing) and "t" not in share.rows:
            key[i] = "slide"
    return tuple(key)


def landed(key: Key, snapshot: Snapshot, state: Array, tolerances: Mapping[str, float]) -> Array:
    """Project `state` onto the constraints of the mode entered, if it violates them."""
    gap_tolerance, speed_tolerance = DRIFT * tolerances["gap"], CREEP * tolerances["speed"]
    if snapshot.reduction is not None:
        joints = snapshot.reduction.joints
        gaps, rates = np.abs(joints.gaps[joints.on]), np.abs(joints.rates[joints.on])
        if gaps.max(initial=0.0) > gap_tolerance or rates.max(initial=0.0) > speed_tolerance:
            return on_constraints(key, snapshot, state)
    for contact, name in zip(snapshot.contacts, key, strict=True):
        violated = abs(contact.gap) > gap_tolerance or abs(contact.gap_rate) > speed_tolerance
        violated = violated or (name in STICKING and abs(contact.slip) > speed_tolerance)
        if violated and name not in OPEN:
            return on_constraints(key, snapshot, state)
    return state


def on_constraints(
    key: Key, snapshot: Snapshot, state: Array, *, penetrating: Sequence[bool] = ()
) -> Array:
    """Project position and velocity onto the constraints in the mass metric."""
    joints = None if snapshot.reduction is None else snapshot.reduction.joints
    return _brought(key, snapshot.unreduced, joints, state, penetrating=penetrating)


def in_contact(key: Key, snapshot: Snapshot, state: Array, speed_tolerance: float) -> Array:
    """Project the velocity alone if it violates the constraints by more than `speed_tolerance`.

    A projection with the position uses the normals at the old position, which differ from those at
    the new one on a curved surface.
    """
    contacts = zip(snapshot.contacts, key, strict=True)
    if not any(abs(c.gap_rate) > speed_tolerance for c, name in contacts if name not in OPEN):
        return state
    half = snapshot.size
    return np.append(state[:half], on_constraints(key, snapshot, state)[half:])


def _brought(
    key: Key,
    snapshot: Snapshot,
    joints: JointNumbers | None,
    state: Array,
    *,
    pinned: Snapshot | None = None,
    penetrating: Sequence[bool] = (),
) -> Array:
    """Project as `on_constraints` does; `pinned` is the snapshot when the points were pinned."""
    rows: list[Array] = []
    residuals: list[tuple[float, float]] = []
    if joints is not None:
        for i in np.flatnonzero(~joints.redundant).tolist():
            rows.append(joints.jacobian[i])
            residuals.append((-joints.gaps[i], -joints.rates[i]))
    for i, (contact, name) in enumerate(zip(snapshot.contacts, key, strict=True)):
        if name in OPEN and not (penetrating and penetrating[i]):
            continue
        if name not in COUPLING_STATES:
            rows.append(snapshot.jacobians[i, 0])
            residuals.append((-contact.gap, -contact.gap_rate if name not in OPEN else 0.0))
        if name in STICKING:
            before = contact if pinned is None else pinned.contacts[i]
            displaced = contact.tx * (contact.x - before.x) + contact.ty * (contact.y - before.y)
            rows.append(snapshot.jacobians[i, 1])
            residuals.append((-displaced, -contact.slip))
    if not rows:
        return state
    jacobian, sides = reduce_to_independent(np.array(rows), np.array(residuals))
    shift = answer(snapshot, jacobian, jacobian, sides[:, 0].copy())
    change = answer(snapshot, jacobian, jacobian, sides[:, 1].copy())
    if shift is None or change is None:
        return state
    moved, half = state.copy(), snapshot.size
    moved[: 2 * half] += np.concatenate([shift[0][:half], change[0][:half]])
    return moved


def dead_point(snapshot: Snapshot, laws: Sequence[ContactLaw], moving: Key, sizes: Array) -> str:
    """Return a sentence on contacts whose constraints have become dependent; "" if none have.

    At a dead point of a linkage (two folded rods, each with its end on the floor) neither the
    motion nor the forces are unique.
    """
    rows = [
        (law.name, snapshot.jacobians[i, d])
        for i, (law, state) in enumerate(zip(laws, moving, strict=True))
        if state not in OPEN
        for d in range(state in COUPLING_STATES, 2 if state in STICKING else 1)
    ]
    if snapshot.reduction is None:
        rows = [(name, row * sizes) for name, row in rows]
    return dependent(rows)
