"""Positions and velocities brought back onto the constraints of joints and closed contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import sympy as sp

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.joints import JointNumbers, dependent
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.scales import Scales
from contacts.dynamics.snapshot import Snapshot, SnapshotTape, answer
from contacts.solvers.dependence import well_posed
from contacts.states import COUPLING_STATES, OPEN, STICKING
from statechart.arrays import EPS, Array
from statechart.automaton.constraints import Constraints
from statechart.automaton.trace import Key
from statechart.errors import NoConsistentMode, SingularMode
from statechart.formulas.tape import Tape

# A state is brought onto the constraints of the mode entered from this part of their tolerance on.
DRIFT = 0.05
# A velocity left over where a flow begins moves the point as long as the flow lasts. At the least
# tolerance this is nine roundings of the scene's speed: what would be projected below comes back.
CREEP = 2e-3
# Weights of an open contact's numbers.
_FREE = (0.0,) * 5
# A step farther off a surface than this part of the scene's length counts as blind. Enclosures
# as narrow as the gap's tolerance would take 1e5 boxes a step.
BLIND_GAP = 1e-4
# A residual that projection cannot reduce is round-off up to so many times a last bit's effect.
_ROUNDINGS = 64.0
# That effect is measured by a shift of so small a part of every number.
_SHIFT = 2.0**-26


class Projection:
    """Keeps the constraints of a flow: solved as accelerations only, they drift as N^2.

    No Baumgarte stabilisation: it would enter the forces that the guards read. The outputs of
    `tape` are what constraints keep: five numbers a contact, two a row of a joint.
    """

    def __init__(self, mechanics: Mechanics, snapshots: SnapshotTape) -> None:
        outputs: list[sp.Expr] = []
        for name in mechanics.scene.frictional:
            geometry = mechanics.contact(name)
            outputs += [geometry.symbols.gap, geometry.symbols.gap_rate, geometry.symbols.slip]
            outputs += geometry.anchor
        for row in mechanics.joint_rows:
            outputs += [row.gap, row.gap_rate]
        self._joints = tuple(row.joint for row in mechanics.joint_rows)
        # Controls that say which joints are closed -> 1 or 0.
        states = dict(mechanics.controlled(snapshots.states))
        closed = [row.closed for row in mechanics.joint_rows]
        self._on = [on is None or states[on] != 0 for on in closed]
        self._snapshots = snapshots
        self._compile = mechanics.whole_tape
        self.tape = mechanics.tape(outputs, definitions=[*states.items()])
        # Of the state with what controllers remember in it.
        self._whole = self.tape
        if mechanics.controller_state:
            self._whole = mechanics.whole_tape(outputs, definitions=[*states.items()])
        self._gaps = tuple(outputs[: 5 * len(mechanics.scene.frictional) : 5])
        self._soft = tuple(name in mechanics.pads for name in mechanics.scene.frictional)
        self._curved = tuple(
            mechanics.curved(name) and not soft
            for name, soft in zip(mechanics.scene.contacts, self._soft, strict=False)
        )
        self._within: dict[Key, Tape | None] = {}

    def constraints(
        self,
        flow: Key,
        start: float,
        anchor: Array,
        values: Array,
        tolerances: Mapping[str, float],
        scales: Scales,
    ) -> Constraints:
        """Return the constraints of `flow` (see `statechart.automaton.laws.Laws`).

        They are of the whole state, `project` is of positions and rates. It raises
        `NoConsistentMode` where the joints cannot be kept together,
        `SingularMode` where that is because their constraints have become dependent. The flow
        begins at `start` at the state `anchor`: pinned points stay where they were there, in the
        surface's frame.
        """
        near, slow = 1.0 / tolerances["gap"], 1.0 / tolerances["speed"]
        pinned = any(state in STICKING for state in flow)
        weights = self._weights(flow, near, slow)
        targets = np.zeros(len(weights))
        if pinned:
            then = self.tape.at(anchor, values, start)
            for i, name in enumerate(flow):
                if name in STICKING:
                    targets[5 * i + 3 : 5 * i + 5] = then[5 * i + 3 : 5 * i + 5]

        began = values

        def project(state: Array, time: float, values: Array = values) -> Array:
            snapshot, joints = self._snapshots.whole(values, state, time)
            pins = self._snapshots.whole(began, anchor, start)[0] if pinned else None
            projected = _brought(flow, snapshot, joints, state, held=pins)
            if joints is None:
                return projected
            before = constraints.off(state, values, time)
            left = constraints.off(projected, values, time)
            if left > 0.5 * before:
                # Rates were brought onto the constraints of the place left: what turns fast is as
                # far off again at the new one, and no longer at the next.
                again = self._snapshots.whole(values, projected, time)
                projected = _brought(flow, *again, projected, held=pins)
                left = constraints.off(projected, values, time)
            if left > 0.5 * before:
                # Angles of many turns, and rates that have grown, are rounded to more than the
                # tolerances.
                if left <= _ROUNDINGS * (self._rounding(state, values, time) * (near, slow)).max():
                    return state
                if left > 1.0:
                    rows = joints.jacobian * scales.sizes[: len(state) // 2]
                    kept = np.flatnonzero(~joints.redundant).tolist()
                    why = dependent([(self._joints[i], rows[i]) for i in kept])
                    if why:
                        raise SingularMode(why)
                    rows = self.tape.at(projected, values, time)[5 * len(flow) :].reshape(-1, 2)
                    rows = np.where(joints.on[:, None], np.abs(rows), 0.0)
                    raise self._broken(rows, near, slow, time)
            return projected

        # At a loose tolerance a state may be off that far without being projected.
        room = max(BLIND_GAP * scales.length, tolerances["gap"])
        constraints = Constraints(
            self.tape, targets, weights, project, self.passed_over(flow), room
        )
        return constraints._replace(tape=self._whole)

    def _rounding(self, state: Array, values: Array, time: float) -> Array:
        """Return how far a last bit of every number of the state takes the joints (rows, 2)."""
        rows = [self.tape.at(state, values, time)]
        for i, number in enumerate(state):
            moved = state.copy()
            moved[i] += _SHIFT * number
            rows.append(self.tape.at(moved, values, time))
        moves = np.abs(np.array(rows[1:]) - rows[0]).sum(axis=0)
        return (EPS / _SHIFT) * moves[5 * len(self._gaps) :].reshape(-1, 2)

    def passed_over(self, flow: Key) -> Tape | None:
        """Return what tells that a step passed over a bump of a surface, or a dip, unseen.

        Curved surfaces alone can be flat where a step begins and not where it ends.
        """
        if flow not in self._within:
            listed = zip(self._gaps, flow, self._curved, strict=False)
            gaps = [gap for gap, state, curved in listed if curved and state not in OPEN]
            within = self._compile([*gaps, *(-gap for gap in gaps)]) if gaps else None
            self._within[flow] = within
        return self._within[flow]

    def _weights(self, flow: Key, near: float, slow: float) -> Array:
        listed: list[float] = []
        for name, soft in zip(flow, self._soft, strict=True):
            if name in OPEN:
                listed += _FREE
            elif soft:
                listed += (0.0, 0.0, slow if name == "pin" else 0.0, 0.0, 0.0)
            elif name in STICKING:
                listed += (near, slow, slow, near, near)
            else:
                listed += (near, slow, 0.0, 0.0, 0.0)
        for on in self._on:
            listed += (near, slow) if on else (0.0, 0.0)
        return np.array(listed)

    def _broken(self, rows: Array, near: float, slow: float, time: float) -> NoConsistentMode:
        k = int(np.argmax((rows * (near, slow)).max(axis=1)))
        gap, rate = rows[k].tolist()
        apart = f"comes apart by {gap:.3g}" if gap * near >= rate * slow else f"parts at {rate:.3g}"
        return NoConsistentMode(
            f"the joints {', '.join(dict.fromkeys(self._joints))} cannot all hold at t = "
            f"{time:.6g}: {self._joints[k]!r} {apart}"
        )


def landing(tolerances: Mapping[str, float]) -> tuple[float, float]:
    """Return how far off a mode's constraints gaps, and velocities, may be when it is entered."""
    return DRIFT * tolerances["gap"], CREEP * tolerances["speed"]


def landed(key: Key, snapshot: Snapshot, state: Array, tolerances: Mapping[str, float]) -> Array:
    """Return `state` on the constraints of the mode entered; the same object if it is."""
    near, slow = landing(tolerances)
    if snapshot.held is not None:
        joints = snapshot.held.joints
        apart, parting = np.abs(joints.gaps[joints.on]), np.abs(joints.rates[joints.on])
        if apart.max(initial=0.0) > near or parting.max(initial=0.0) > slow:
            return on_constraints(key, snapshot, state)
    for contact, name in zip(snapshot.contacts, key, strict=True):
        off = abs(contact.gap) > near or abs(contact.gap_rate) > slow
        if name not in OPEN and (off or (name in STICKING and abs(contact.slip) > slow)):
            return on_constraints(key, snapshot, state)
    return state


def on_constraints(
    key: Key, snapshot: Snapshot, state: Array, *, inside: Sequence[bool] = ()
) -> Array:
    """Bring position and velocity onto the constraints, nearest in the mass metric."""
    joints = None if snapshot.held is None else snapshot.held.joints
    return _brought(key, snapshot.whole, joints, state, inside=inside)


def in_contact(key: Key, snapshot: Snapshot, state: Array, slow: float) -> Array:
    """Bring the velocity alone onto the constraints where it is off them by more than `slow`.

    Projected along with a place, it is that of the place left: over a curved surface the other
    place has another normal.
    """
    rates = [
        contact.gap_rate
        for contact, name in zip(snapshot.contacts, key, strict=True)
        if name not in OPEN
    ]
    if not any(abs(rate) > slow for rate in rates):
        return state
    half = len(state) // 2
    return np.append(state[:half], on_constraints(key, snapshot, state)[half:])


def _brought(
    key: Key,
    whole: Snapshot,
    joints: JointNumbers | None,
    state: Array,
    *,
    held: Snapshot | None = None,
    inside: Sequence[bool] = (),
) -> Array:
    """See `on_constraints`; `held`: where pinned points were when they were pinned."""
    rows: list[Array] = []
    off: list[tuple[float, float]] = []
    if joints is not None:
        for i in np.flatnonzero(~joints.redundant).tolist():
            rows.append(joints.jacobian[i])
            off.append((-joints.gaps[i], -joints.rates[i]))
    for i, (contact, name) in enumerate(zip(whole.contacts, key, strict=True)):
        if name in OPEN and not (inside and inside[i]):
            continue
        if name not in COUPLING_STATES:
            rows.append(contact.jacobian[0])
            off.append((-contact.gap, -contact.gap_rate if name not in OPEN else 0.0))
        if name in STICKING:
            moved = 0.0
            if held is not None:
                before = held.contacts[i]
                moved = contact.tx * (contact.x - before.x) + contact.ty * (contact.y - before.y)
            rows.append(contact.jacobian[1])
            off.append((-moved, -contact.slip))
    if not rows:
        return state
    jacobian, sides = well_posed(np.array(rows), np.array(off))
    shift = answer(whole, jacobian, jacobian, sides[:, 0].copy())
    change = answer(whole, jacobian, jacobian, sides[:, 1].copy())
    if shift is None or change is None:
        return state
    half = len(state) // 2
    return state + np.concatenate([shift[0][:half], change[0][:half]])


def dead_point(snapshot: Snapshot, laws: Sequence[ContactLaw], moving: Key, sizes: Array) -> str:
    """Return which contacts' constraints have become dependent; "" where they are not.

    A linkage that comes to a dead point (two rods that fold on each other, each with its end on
    the floor) can go on in more than one way, and its forces are not determined there.
    """
    rows = [
        (law.name, snapshot.jacobians[i, d])
        for i, (law, state) in enumerate(zip(laws, moving, strict=True))
        if state not in OPEN
        for d in range(state in COUPLING_STATES, 2 if state in STICKING else 1)
    ]
    if snapshot.held is None:
        rows = [(name, row * sizes) for name, row in rows]
    return dependent(rows)
