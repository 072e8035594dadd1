"""Arrays of a compiled step: colliding bodies, joints, and the warm start of contacts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.collision_detection.surfaces import SurfaceNumbers
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import tape_table

WARM_START_COLUMNS = 10
"""Columns of a contact in a warm start: target gap; 1 lasting, -1 closed and unloaded, 0 hit;
impulses (2); velocities after the step (2); normal (2); slip error of the impulses; 1 if it slid.
"""

RESTITUTION, KINETIC, STIFFNESS, DAMPING, ROLLING = 2, 3, 5, 6, 7
"""Columns of `BodyNumbers.materials`."""

BOTH, ALONG_X, ALONG_Y, ROD, ROPE, TURN, LEAST, GREATEST = range(8)
"""Constraint of a joint row: a point, along both axes or one; a distance, exactly or at most; the
relative angle, exactly, at least or at most."""

# Initial capacity of contacts.
_PER_PIECE = 8


class PieceNumbers(NamedTuple):
    """The convex pieces of bodies, sorted by body."""

    # Their bodies; first piece of each body.
    bodies: Ints  # shape (p,)
    begins: Ints  # shape (b + 1,)
    # Corners in body frames (discs have none), and where those of a piece begin.
    vertices: Array  # shape (v, 2)
    firsts: Ints  # shape (p + 1,)
    middles: Array  # (p, 2): centres of discs and of polygons, in body frames.
    # (p,): radius of discs; largest and smallest distance of the boundary from the middle.
    radii: Array
    sizes: Array
    cores: Array
    spans: Array  # (p,): largest distance from the centre of the body.


class JointNumbers(NamedTuple):
    """The joint rows of a scene: first one of each joint, then those of angles."""

    bodies: Ints  # (j, 2): the two bodies; the second may be an anchor in the world.
    points: Array  # (j, 2, 2): joint points in body frames.
    kinds: Ints  # shape (j,)
    owners: Ints  # (j,): joint of the row.
    # (j, 2): distance or angle, and restitution of a bound.
    sizes: Array
    on: Bools  # (j,): whether a joint is closed now; changed in place.
    passes: Bools  # (j,): whether its bodies collide while it is off.


class CouplingNumbers(NamedTuple):
    """The couplings of a scene."""

    # (c, 2): the two bodies; -1: the world. The first one moves by itself; `signs` (c,) is -1 where
    # it was declared as the second.
    bodies: Ints
    signs: Array
    holds: Ints  # (c,): `TURN`; or `ALONG_X`, `ALONG_Y`: friction along the free direction.
    at: Array  # (c, 2): point of a guide in the body frame.
    # (c,): radius of gyration of the first body, so that the row is a velocity; 1 along a guide.
    levers: Array


class LinkNumbers(NamedTuple):
    """The linked bodies (l), the last of the moving ones, and their coordinates (c)."""

    bodies: int
    size: int
    # (l,): first of the bodies that share coordinates with a body, directly or indirectly.
    firsts: Ints
    # Tape (`statechart.formulas.tape.Tape`) over coordinates and rates: poses (l, 3), their
    # Jacobian (l, 3, c), mass (c, c), derivatives (c, c) of forces by the rates, and forces (c,)
    # including inertial ones.
    code: Ints32
    constants: Array
    outputs: Ints32
    values: Array

    @classmethod
    def none(cls) -> LinkNumbers:
        """Return the numbers of a scene of free bodies."""
        nothing = np.zeros((0, 3), np.int32), np.zeros(0), np.zeros(0, np.int32), np.zeros(0)
        return cls(0, 0, np.zeros(0, np.int64), *nothing)

    @property
    def rows(self) -> int:
        """Rows of rates that the coordinates take."""
        return (self.size + 2) // 3


class BodyNumbers(NamedTuple):
    """Constants of a run of colliding bodies.

    Order: free bodies, linked bodies, bodies led along paths, fixed bodies. Moving surfaces and the
    world anchors of joints are led bodies without a shape. A state holds the poses of free bodies,
    the coordinates, and their rates.
    """

    pieces: PieceNumbers
    sizes: Array  # (b,): radius about the centre; 0 without a shape.
    inverse: Array  # (m, 3): 1/mass, 1/mass, 1/moment of inertia of moving bodies.
    fixed: Array  # (f, 3): poses of fixed bodies.
    gravity: Array  # shape (2,)
    surfaces: SurfaceNumbers
    kinds: Ints  # (b,): kind of a body; copies share it.
    # (k, k + s): contact law of two kinds, or of a kind and a surface; -1: no contact.
    laws: Ints
    # (m, 8): static cone edge (2), restitution, kinetic cone edge (2), stiffness and damping of
    # compliant contacts, rolling resistance.
    materials: Array
    joints: JointNumbers
    couplings: CouplingNumbers
    links: LinkNumbers
    step: float = 0.0  # Size of whole steps; a part of one is shorter.

    @property
    def free(self) -> int:
        """Number of free bodies."""
        return len(self.inverse) - self.links.bodies

    @property
    def size(self) -> int:
        """Number of coordinates of a state, including those of free bodies."""
        return 3 * self.free + self.links.size

    def motion(self, states: Array) -> tuple[Array, Array]:
        """Return the poses and rates (k, m, 3) of moving bodies in states (k, n)."""
        first, n, count = 3 * self.free, self.size, len(states)
        parts = [states[:, at : at + first].reshape(count, self.free, 3) for at in (0, n)]
        if not self.links.bodies:
            return parts[0], parts[1]
        poses, gradients = self.linked(states)
        rates = gradients @ states[:, n + first : 2 * n, None]
        moving = poses, rates.reshape(poses.shape)
        one, other = (np.concatenate(pair, axis=1) for pair in zip(parts, moving, strict=True))
        return one, other

    def poses(self, states: Array, led: Array) -> Array:
        """Return the poses (k, b, 3) of all bodies in states (k, n), with led ones (k, l, 3)."""
        fixed = np.broadcast_to(self.fixed, (len(states), *self.fixed.shape))
        return np.concatenate([self.motion(states)[0], led, fixed], axis=1)

    def moved(self, state: Array, led: Array) -> Array:
        """Return the poses and rates (2, b, 3) of all bodies, with those of led ones (2, l, 3)."""
        fixed = np.stack([self.fixed, np.zeros_like(self.fixed)])
        return np.concatenate([np.concatenate(self.motion(state[None])), led, fixed], axis=1)

    def linked(self, states: Array) -> tuple[Array, Array]:
        """Return the poses (k, l, 3) of linked bodies, and their Jacobians (k, 3 l, c)."""
        count, links, rows = len(states), self.links, 3 * self.links.bodies
        poses, gradients, _ = np.split(self.table(states), [rows, rows * (1 + links.size)], axis=1)
        return poses.reshape(count, links.bodies, 3), gradients.reshape(count, rows, links.size)

    def table(self, states: Array) -> Array:
        """Return the outputs of `LinkNumbers` in states (k, n)."""
        links, first, n = self.links, 3 * self.free, self.size
        at = np.concatenate([states[:, first:n], states[:, n + first : 2 * n]], axis=1)
        result: Array = tape_table(
            links.code, links.constants, links.outputs, 0, np.ascontiguousarray(at), links.values,
            np.zeros(len(at)),
        )  # fmt: skip
        return result

    def levers(self, state: Array) -> Array:
        """Return the largest displacement of a body per unit of a coordinate (c,), 1 for 0."""
        if not self.links.bodies:
            return np.zeros(0)
        gradients = self.linked(state[None])[1].reshape(-1, 3, self.links.size)[:, :2]
        most = np.abs(gradients).max(axis=(0, 1), initial=0.0)
        return np.where(most > 0.0, most, 1.0)

    def inertia(self, states: Array) -> tuple[Array, Array]:
        """Return mass matrices (k, c, c) and forces (k, c) of the coordinates in states."""
        size = self.links.size
        outputs = self.table(states)
        forces = outputs.shape[1] - size
        masses = outputs[:, forces - 2 * size * size : forces - size * size]
        return masses.reshape(len(outputs), size, size), outputs[:, forces:]

    def whole(self, rows: Array, state: Array) -> Array:
        """Return rows (r, 3 m) on moving bodies as rows (r, n) on coordinates."""
        first = 3 * self.free
        if not self.links.bodies:
            return rows
        gradients = self.linked(state[None])[1][0]
        return np.concatenate([rows[:, :first], rows[:, first:] @ gradients], axis=1)

    @property
    def padded(self) -> int:
        """1 if contacts may have pads (see `contacts.rigid_bodies.island_step`), else 0."""
        return int(self.materials[:, STIFFNESS:].any() or len(self.couplings.holds) > 0)


@kernel
def split_key(numbers: BodyNumbers, key: int) -> tuple[int, int]:
    """Return the two pieces of a contact by its key; surfaces are counted behind the pieces."""
    others = len(numbers.pieces.sizes) + len(numbers.surfaces.kinds)
    return key // others, key % others


@kernel
def first_joint_key(numbers: BodyNumbers) -> int:
    """Return the key of the first joint, above those of all contacts; couplings follow joints."""
    pieces = len(numbers.pieces.sizes)
    return pieces * (pieces + len(numbers.surfaces.kinds))


class WarmStart(NamedTuple):
    """Contacts, impulses and modes of the previous step."""

    # (c, 2): pair and feature of each contact; with spare capacity.
    keys: Ints
    contacts: Array  # (c, WARM_START_COLUMNS)
    n_contacts: Ints  # (1,)
    # (3,): previous step size; fastest approach so far, and largest approach in a step, half of
    # which is the allowed penetration.
    last_step: Array
    # (b, 2): mode of each body in the last step, and 1 if it follows from accelerations; see
    # `contacts.rigid_bodies.body_modes`.
    modes: Ints
    # (b, 7): landing of a body that settles: largest gap; normal (2) and its offset at gap zero, in
    # the frame of the surface; corner in the body frame (2); body that carries the surface, or -1.
    landings: Array

    @classmethod
    def allocate(cls, numbers: BodyNumbers) -> WarmStart:
        """Return an empty warm start."""
        most = _PER_PIECE * max(len(numbers.pieces.sizes), len(numbers.sizes)) + 1
        return cls(
            np.zeros((most, 2), dtype=np.int64), np.zeros((most, WARM_START_COLUMNS)),
            np.zeros(1, dtype=np.int64), np.zeros(3),
            np.zeros((len(numbers.inverse), 2), dtype=np.int64),
            np.zeros((len(numbers.inverse), 7)),
        )  # fmt: skip

    def copy(self) -> WarmStart:
        """Return a copy."""
        return WarmStart._make(rows.copy() for rows in self)

    def enlarged_to(self, other: WarmStart) -> WarmStart:
        """Return it with the capacity of another."""
        result = self
        while len(result.keys) < len(other.keys):
            result = result.doubled()
        return result

    def doubled(self) -> WarmStart:
        """Return it with twice the capacity."""
        return self._replace(
            keys=np.concatenate([self.keys, np.zeros_like(self.keys)]),
            contacts=np.concatenate([self.contacts, np.zeros_like(self.contacts)]),
        )
