"""Colliding bodies, and what is remembered of their contacts, as arrays of a compiled step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.collision_detection.surfaces import SurfaceNumbers
from statechart.arrays import Array, Bools, Ints

MEMORY = 10
"""What is kept of a contact from step to step: level; whether it lasts (1), is closed and bears
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


class BodyNumbers(NamedTuple):
    """Constants of a run of colliding bodies.

    First the bodies that move by themselves, then those that are led along a path, then fixed ones.
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

    @property
    def padded(self) -> int:
        """1 where contacts may have pads (see `contacts.rigid_bodies.island_step`), 0 else."""
        return int(self.materials[:, STIFFNESS:].any())


class Memory(NamedTuple):
    """Warm start of a step: contacts, impulses and modes of the step before."""

    # (c, 2): of the contacts of the step before: pair and feature. There is place for more than
    # take part in a step.
    keys: Ints
    contacts: Array  # (c, MEMORY): see `MEMORY`.
    many: Ints  # (1,): how many they are.
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
    def allocate(cls, numbers: BodyNumbers) -> Memory:
        """Return that of bodies that have not touched yet."""
        most = _PER_PIECE * max(len(numbers.pieces.sizes), len(numbers.sizes)) + 1
        return cls(
            np.zeros((most, 2), dtype=np.int64),
            np.zeros((most, MEMORY)),
            np.zeros(1, dtype=np.int64),
            np.zeros(3),
            np.zeros((len(numbers.inverse), 2), dtype=np.int64),
            np.zeros((len(numbers.inverse), 6)),
        )

    def copy(self) -> Memory:
        """Return it as it is now."""
        return Memory._make(rows.copy() for rows in self)

    def as_large(self, other: Memory) -> Memory:
        """Return it with place for as many contacts as another."""
        found = self
        while len(found.keys) < len(other.keys):
            found = found.larger()
        return found

    def larger(self) -> Memory:
        """Return it with place for twice as many contacts."""
        return self._replace(
            keys=np.concatenate([self.keys, np.zeros_like(self.keys)]),
            contacts=np.concatenate([self.contacts, np.zeros_like(self.contacts)]),
        )
