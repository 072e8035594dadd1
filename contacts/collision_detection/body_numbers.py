"""Arrays of a compiled step: colliding bodies, joints, and the warm start of contacts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.collision_detection.surfaces import SurfaceNumbers
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.kernels.tapes import tape_table

WARM_START_COLUMNS = 10
"""Columns of a contact in a warm start: level; whether it lasts (1), is closed and bears
nothing (-1), or was hit (0); impulses; its velocities, normal and tangential, after the step, and
its normal; slip that the impulses may have missed; whether it slid (1)."""

RESTITUTION, KINETIC, STIFFNESS, DAMPING, ROLLING = 2, 3, 5, 6, 7
"""Places in `BodyNumbers.materials`."""

BOTH, ALONG_X, ALONG_Y, ROD, ROPE, TURN, LEAST, GREATEST = range(8)
"""Constraint of a row of a joint: a point, along both axes or one; a distance, exactly or at most;
the relative angle, exactly, at least or at most."""

# Contacts that there is place for at first.
_PER_PIECE = 8


class PieceNumbers(NamedTuple):
    """The convex pieces that bodies are made of, in the order of these."""

    # Their bodies, and the first piece of each body.
    bodies: Ints  # shape (p,)
    begins: Ints  # shape (b + 1,)
    # Corners in the frames of their bodies, and where those of a piece begin; none of discs.
    vertices: Array  # shape (v, 2)
    firsts: Ints  # shape (p + 1,)
    middles: Array  # (p, 2): centres of discs, and places in polygons, in those frames.
    # (p,): of discs; how far a piece reaches from its middle at most, and at least.
    radii: Array
    sizes: Array
    cores: Array
    spans: Array  # (p,): how far it reaches from the centre of its body.


class JointNumbers(NamedTuple):
    """The rows of the joints of a scene: first one of each joint, then those of angles."""

    bodies: Ints  # (j, 2): of the point, and of what it is held to; -1: a place in the world.
    at: Array  # (j, 2, 2): the points in the frames of these bodies.
    holds: Ints  # shape (j,)
    owners: Ints  # (j,): which joint.
    # (j, 2): distance or angle, and restitution where one is bounded.
    sizes: Array
    on: Bools  # (j,): which joints are closed now; in place.
    passes: Bools  # (j,): whose bodies touch each other while the joint is off.


class LinkNumbers(NamedTuple):
    """The linked bodies (l) of a scene, the last of those that move, and their coordinates (c)."""

    bodies: int
    size: int
    # (l,): the first of those that share coordinates with a body, directly or through others.
    firsts: Ints
    # The program (see `statechart.formulas.tape.Tape`) over coordinates and their rates: poses
    # (l, 3), their derivatives by the coordinates (l, 3, c), mass (c, c), derivatives (c, c) of
    # forces by the rates, and forces (c,), those of inertia included.
    code: Ints32
    constants: Array
    outputs: Ints32
    values: Array

    @classmethod
    def none(cls) -> LinkNumbers:
        """Return the numbers of a scene whose bodies are free."""
        nothing = np.zeros((0, 3), np.int32), np.zeros(0), np.zeros(0, np.int32), np.zeros(0)
        return cls(0, 0, np.zeros(0, np.int64), *nothing)

    @property
    def rows(self) -> int:
        """Rows of rates that coordinates take."""
        return (self.size + 2) // 3


class BodyNumbers(NamedTuple):
    """Constants of a run of colliding bodies.

    First free bodies, then those that coordinates place; then those that are led along a path, and
    fixed ones. The state of a run has the poses of free bodies, the coordinates, and their rates.
    """

    pieces: PieceNumbers
    sizes: Array  # (b,): how far a body reaches from its centre; 0 of those without a shape.
    inverse: Array  # (m, 3): 1/mass, 1/mass, 1/moment of inertia of those that move.
    fixed: Array  # (f, 3): where fixed bodies are.
    gravity: Array  # shape (2,)
    surfaces: SurfaceNumbers
    kinds: Ints  # (b,): what bodies are copies of.
    # (k, k + s): which law kinds of bodies touch each other and surfaces by; -1: they do not.
    laws: Ints
    # (m, 8): laws: edge of the cone at rest (2), restitution, edge in motion (2), stiffness and
    # damping of compliant contacts, rolling resistance.
    materials: Array
    joints: JointNumbers
    links: LinkNumbers

    @property
    def free(self) -> int:
        """Number of free bodies."""
        return len(self.inverse) - self.links.bodies

    @property
    def size(self) -> int:
        """Number of coordinates of a state, those of free bodies included."""
        return 3 * self.free + self.links.size

    def motion(self, states: Array) -> tuple[Array, Array]:
        """Return the poses and rates (k, m, 3) of bodies that move, in states (k, n)."""
        first, n, count = 3 * self.free, self.size, len(states)
        parts = [states[:, at : at + first].reshape(count, self.free, 3) for at in (0, n)]
        if not self.links.bodies:
            return parts[0], parts[1]
        poses, gradients = self.linked(states)
        rates = gradients @ states[:, n + first : 2 * n, None]
        moving = poses, rates.reshape(poses.shape)
        one, other = (np.concatenate(pair, axis=1) for pair in zip(parts, moving, strict=True))
        return one, other

    def linked(self, states: Array) -> tuple[Array, Array]:
        """Return the poses (k, l, 3) of linked bodies, and their derivatives (k, 3 l, c)."""
        count, links, rows = len(states), self.links, 3 * self.links.bodies
        poses, gradients, _ = np.split(self.table(states), [rows, rows * (1 + links.size)], axis=1)
        return poses.reshape(count, links.bodies, 3), gradients.reshape(count, rows, links.size)

    def table(self, states: Array) -> Array:
        """Return the outputs of `LinkNumbers` in states (k, n)."""
        links, first, n = self.links, 3 * self.free, self.size
        at = np.concatenate([states[:, first:n], states[:, n + first : 2 * n]], axis=1)
        found: Array = tape_table(
            links.code, links.constants, links.outputs, 0, np.ascontiguousarray(at), links.values,
            np.zeros(len(at)),
        )  # fmt: skip
        return found

    def levers(self, state: Array) -> Array:
        """Return the largest displacement of a body per unit of a coordinate (c,), 1 for 0."""
        if not self.links.bodies:
            return np.zeros(0)
        found = self.linked(state[None])[1].reshape(-1, 3, self.links.size)[:, :2]
        most = np.abs(found).max(axis=(0, 1), initial=0.0)
        return np.where(most > 0.0, most, 1.0)

    def inertia(self, states: Array) -> tuple[Array, Array]:
        """Return mass matrices (k, c, c) and forces (k, c) of the coordinates in states."""
        size = self.links.size
        found = self.table(states)
        forces = found.shape[1] - size
        masses = found[:, forces - 2 * size * size : forces - size * size]
        return masses.reshape(len(found), size, size), found[:, forces:]

    def whole(self, rows: Array, state: Array) -> Array:
        """Return rows (r, 3 m) of all bodies that move as rows (r, n) of the coordinates."""
        first = 3 * self.free
        if not self.links.bodies:
            return rows
        gradients = self.linked(state[None])[1][0]
        return np.concatenate([rows[:, :first], rows[:, first:] @ gradients], axis=1)

    @property
    def padded(self) -> int:
        """1 where contacts may have pads (see `contacts.rigid_bodies.island_step`), 0 else."""
        return int(self.materials[:, STIFFNESS:].any())


class WarmStart(NamedTuple):
    """Warm start of a step: contacts, impulses and modes of the step before."""

    # (c, 2): of the contacts of the step before: pair and feature. There is place for more than
    # take part in a step.
    keys: Ints
    contacts: Array  # (c, WARM_START_COLUMNS): see there.
    n_contacts: Ints  # (1,): how many they are.
    # (3,): length of the step before; the fastest approach so far, and the longest in a step, of
    # which half is how deep bodies may be kept.
    past: Array
    # (b, 2): mode of every body in the last step, and 1 where it is read from accelerations; see
    # `contacts.rigid_bodies.body_modes`.
    shown: Ints
    # (b, 6): the largest gap at which a body landed, since it settles; the normal there, what lies
    # at the gap zero along it, and the corner in the frame of the body.
    landed: Array

    @classmethod
    def allocate(cls, numbers: BodyNumbers) -> WarmStart:
        """Return the warm start of bodies that have not touched yet."""
        most = _PER_PIECE * max(len(numbers.pieces.sizes), len(numbers.sizes)) + 1
        return cls(
            np.zeros((most, 2), dtype=np.int64),
            np.zeros((most, WARM_START_COLUMNS)),
            np.zeros(1, dtype=np.int64),
            np.zeros(3),
            np.zeros((len(numbers.inverse), 2), dtype=np.int64),
            np.zeros((len(numbers.inverse), 6)),
        )

    def copy(self) -> WarmStart:
        """Return a copy."""
        return WarmStart._make(rows.copy() for rows in self)

    def enlarged_to(self, other: WarmStart) -> WarmStart:
        """Return it with the capacity of another."""
        found = self
        while len(found.keys) < len(other.keys):
            found = found.doubled()
        return found

    def doubled(self) -> WarmStart:
        """Return it with twice the capacity."""
        return self._replace(
            keys=np.concatenate([self.keys, np.zeros_like(self.keys)]),
            contacts=np.concatenate([self.contacts, np.zeros_like(self.contacts)]),
        )
