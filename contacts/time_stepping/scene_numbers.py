"""Arguments of the compiled step of a scene."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_lcp_kernels import UNKNOWNS
from contacts.states import FREE
from statechart.arrays import Array, Bools, Ints, Ints32

HOLDING = 3
"""So many steps hold an impulse: that of a landing; the next, as the motion turned the contact off
its level in the landing's; and the one after that, which ends what the next began."""

LANDED = 2
"""The contact settles after an impact, not after a change of a mode."""


class SceneNumbers(NamedTuple):
    """Constants of a run between changes of controllers and conditions."""

    # The program of a tape over the state (2 n + w,), which ends with what controllers remember
    # (see `statechart.formulas.tape.Tape.program`): mass (n, n), forces (n,), where `damped` also
    # their derivatives by the rates (n, n), then per contact Jacobian (2, n) and what `CONTACT`
    # lists, per component of a joint Jacobian (n,) and what `JOINT` lists, and what controllers
    # give (u,).
    equations: tuple[Ints32, Array, Ints32]
    flows: tuple[Ints32, Array, Ints32]  # That of the rates of what controllers remember (w,).
    size: int  # Coordinates.
    damped: bool
    parameters: Array  # shape (p,)
    cones: Array  # shape (c, 2)
    restitution: Array  # shape (c,)
    plastic: bool  # Whether contacts that are hit together do not rebound.
    # (c, 2): the body of each contact's point, and of its surface; -1 for none, and for all where
    # the scene does not ask for impacts at once that rebound.
    bodies: Ints
    # (c,): the number of the pair of a body and a surface's body, or a surface, that touch.
    pairs: Ints
    # (c,): how many components of a contact's velocity are constrained whatever the impulse: 0, 1
    # (normal), 2 (both).
    held: Ints
    slips: Ints  # (c,): whether a contact may slide: 0, 1, or 2 if its slides have a direction.
    joints: int  # Number of components of joints.
    # Tolerances of gaps and speeds. A contact touches up to this gap, and lasts up to this speed of
    # approach. A contact that was off comes back where it is no deeper than the gap tolerance below
    # those that last.
    near: float
    still: float
    # Round-off of velocities: no contact begins to press at an approach up to this.
    rounding: float
    speed: float  # The scene's scale of velocities.
    # What contacts add to the energy is told in parts of what they move with: at this speed at
    # least, and twice this energy at least.
    slowest: float
    negligible: float


class ContactMemory(NamedTuple):
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
    # (c, 3): depths of contacts that are off though their conditions hold: where these began to
    # hold, and now; and the least that contacts never came back from, before their conditions
    # failed.
    missed: Array
    light: Bools  # (1,): whether coordinates without an inertia of their own were given one.
    bases: Bools  # (c, 4): positive unknowns of the last problem.

    @classmethod
    def of(cls, off: Bools) -> ContactMemory:
        """Return that of contacts that have not touched yet."""
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
            np.tile([0.0, 0.0, np.inf], (count, 1)),
            np.zeros(1, dtype=np.bool_),
            np.zeros((count, UNKNOWNS), dtype=np.bool_),
        )

    def copy(self) -> ContactMemory:
        """Return it as it is now."""
        return ContactMemory._make(array.copy() for array in self)


class Tape(NamedTuple):
    """The numbers of a step's tape; the Jacobian of contact i begins at ``first + per * i``."""

    numbers: Array  # shape (k,)
    # Coordinates; where contacts begin; numbers of a contact.
    size: int
    first: int
    per: int


class Met(NamedTuple):
    """Roles of contacts in a step."""

    # (c,): who takes part, who is struck, whose condition ceases to hold while it lasts.
    active: Bools
    hit: Bools
    leaving: Bools
    # (c,): the gap of a contact that is off where its point leaves another surface in this step.
    entered: Array
    # (c, 2): what velocities may not fall below, negated; what they are before the step, and after
    # it without impulses.
    wanted: Array
    before: Array
    free: Array


class Problem(NamedTuple):
    """The contact problem of those that take part."""

    which: Ints  # (m,): contacts.
    # What unit impulses do to all that moves, and to the contacts' velocities.
    columns: Array  # shape (2 m, s)
    delassus: Array  # shape (2 m, 2 m)
    groups: Ints  # (m,): equal for those that feel each other's impulses.
    # of shape (m, 2) each
    cones: Array
    before: Array
    free: Array
    wanted: Array
    # (m,): who asks for restitution; whose impulse is one at an instant.
    rebounds: Bools
    sudden: Bools


class Answer(NamedTuple):
    """Solution of the contact problem."""

    # (4 m,): unknowns; which of them are positive.
    z: Array
    basis: Bools
    least: Array  # (m, 2): velocities without impulses, as they were asked for.
    # Impulses; those of them that are forces, and who slides under these.
    pushes: Array  # shape (m, 2)
    steady: Array  # shape (m, 2)
    slides: Bools  # shape (m,)
    # Whether another solution lets a contact come off that slides, or slide that comes off.
    several: bool
    # 1 + the number of a contact that friction lets neither slide on nor come off; 0: none.
    jammed: int
