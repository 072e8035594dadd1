"""Indeterminate loads: the smallest forces in the friction cones.

Of all forces in the cones that explain a motion, the smallest ``sum V^2 + H^2`` are unique, and of
a simple form: every contact bears the projection on its cone of ``w = J y``, what equal springs
would bear if the bodies were displaced by y; the cone of a locked coupling is the interval up to
its limit. On which part of its cone each contact is, is its *zone*; as long as no zone changes, y
and all forces follow from linear equations, so that a flow can carry them. A zone that changes is
no change of mode: other forces explain the motion then. Only where no forces in the cones do, the
mode ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from contacts.dynamics.snapshot import Snapshot
from contacts.scene.modes import OWN, Bearing, SignFriction
from contacts.solvers.dependence import independent
from contacts.solvers.mode_solver import is_coupling, judge_forces, write_limits
from contacts.solvers.redundancy import mode_columns, sharing
from contacts.solvers.smallest_forces import APEX, INSIDE, LOWER, UPPER, springs
from contacts.states import (
    CODES,
    FREE,
    LOCKED,
    OPEN,
    PIN,
    SLIDE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    SLIP_MINUS,
    SLIP_PLUS,
    SLIPPING,
)
from statechart.arrays import Array, Ints
from statechart.automaton.trace import Role, Roles

_ZONES = {INSIDE: "inside", UPPER: "upper", LOWER: "lower", APEX: "apex"}
_LETTERS = {FREE: "", PIN: "nt", LOCKED: "t", SLIP_PLUS: "", SLIP_MINUS: ""}
_SLIDING = {PIN: 0.0, LOCKED: 0.0, SLIDE_PLUS: 1.0, SLIDE_MINUS: -1.0}


@dataclass(frozen=True, eq=False)
class Share:
    """The smallest forces that explain a motion."""

    forces: Array  # (c, 2): V and H per contact
    zones: tuple[str, ...]  # Per contact; OWN where the motion determines its force
    # Which of the contact's constraints ("nt", "n", "t", "") are among the independent ones
    rows: tuple[str, ...]
    # Which of the contact's forces, along normal and tangent ("n", "t") or along its edge ("e"),
    # are enough to move the bodies like that
    carriers: tuple[str, ...]
    # `coordinates`, `joints`: Those whose displacements y are enough, and the rows of the joints
    # that hold for them
    coordinates: tuple[int, ...]
    joints: tuple[int, ...]
    # How far the worst contact is outside its zone, in units of force; <= 0: not at all
    violation: float
    signs: tuple[tuple[SignFriction, str], ...] = ()  # Signs that share, and their zones

    def of_contacts(self, count: int, frictions: Sequence[SignFriction]) -> Share | None:
        """Return what the first contacts share, those behind them being signs."""
        behind = zip(frictions, self.zones[count:], strict=True)
        signs = tuple((sign, zone) for sign, zone in behind if zone != OWN)
        zones, rows, carriers = self.zones[:count], self.rows[:count], self.carriers[:count]
        if all(zone == OWN for zone in zones):
            return None
        return replace(
            self, forces=self.forces[:count], zones=zones, rows=rows, carriers=carriers, signs=signs
        )

    def roles(self, states: Sequence[str]) -> Roles:
        """Return the roles of contacts in `states`, with what of their equations to use."""
        whole = {"pin": "nt", "locked": "t"} | dict.fromkeys((*OPEN, *SLIPPING), "")
        first = next(k for k, zone in enumerate(self.zones) if zone != OWN)
        result = []
        parts = zip(states, self.zones, self.rows, self.carriers, strict=True)
        for k, (state, zone, rows, carriers) in enumerate(parts):
            bearing = None
            if zone != OWN:
                once = (self.joints, self.signs) if k == first else ((), ())
                bearing = Bearing(zone, rows, carriers, self.coordinates, *once)
            elif rows != whole.get(state, "n"):
                bearing = Bearing(zone, rows)
            result.append(Role(state, share=bearing))
        return tuple(result)


# Of all forces: what presses less does so by rounding.
_PRESSED = 1e-6


def share(
    code: Ints,
    snapshot: Snapshot,
    cones: Array,
    loaded_by: Ints,
    forces: Array,
    inward: float,
    signs: int,
) -> Share | None:
    """Return the smallest forces within the cones that act like `forces`; None: there are none.

    The modes `code` (c,) are numbered as in `contacts.states`; `forces` explain the motion, in
    their `cones` or not. Forces as small as `inward` inside the cones are added when zones are
    looked for: on the boundary of what can be explained the zones then still determine the forces.
    `loaded_by` are the carriers of `solve_modes`; the last `signs` of the modes are those of signs,
    which carry nothing in the equations of a flow.
    """
    limits, cones = cones, cones.copy()
    couplings = np.flatnonzero([is_coupling(c) for c in code.tolist()])
    cones[couplings] = 0.0, 1.0
    jacobians = snapshot.jacobians
    flat, owners = mode_columns(code, cones, jacobians, -1)
    count, _, _ = independent(flat)
    least, order, _ = independent(flat[owners < len(code) - signs])
    if least < count:
        return None
    shared = np.flatnonzero(sharing(code, cones, jacobians, count, len(flat)))
    load = np.einsum("gdn,gd->n", jacobians[shared], forces[shared])
    reach, chosen, _ = independent(np.ascontiguousarray(flat[np.isin(owners, shared)].T))
    coordinates = np.sort(chosen[:reach])
    # A slide without friction is one along the edge (1, 0).
    smooth = code[shared] == SLIDE
    # Of a locked coupling the limit bounds the couple.
    most = np.full(len(shared), np.inf)
    for k, i in enumerate(shared.tolist()):
        if code[i] == LOCKED:
            carrier = forces[loaded_by[i], 0] if loaded_by[i] >= 0 else 1.0
            most[k] = limits[i, 0] * carrier
    problem = (
        np.column_stack([np.where(smooth[:, None], [1.0, 0.0], cones[shared]), most]),
        np.array([_SLIDING.get(mode, 1.0) for mode in code[shared].tolist()]),
        np.ascontiguousarray(jacobians[shared][:, :, coordinates]),
        load[coordinates],
    )
    explained, borne, places, violation = springs(*problem, inward)
    if not explained or violation > 0.0:
        # What is added may be enough to change a zone that was met: its displacement moves by more.
        again = springs(*problem, 0.0)
        if again[0] and (not explained or again[3] < violation):
            explained, borne, places, violation = again
    if not explained:
        return None
    if np.isin(loaded_by[couplings], shared).any():
        # The couple of a coupling that slips would follow from the share.
        return None
    given, zones = forces.copy(), [OWN] * len(code)
    given[shared] = borne
    write_limits(given, limits, loaded_by, code)
    for k, place in zip(shared.tolist(), places.tolist(), strict=True):
        zones[k] = _ZONES[place]
    alone = ~np.isin(np.arange(len(code)), shared)
    verdict = np.array([violation, 0.0, 0.0, 0.0])
    judge_forces(verdict, forces[alone], cones[alone], code[alone], 1.0)
    judge_forces(verdict, given[couplings], cones[couplings], code[couplings], 1.0)
    kept = set(order[:count].tolist())
    letters = [letter for mode in code.tolist() for letter in _LETTERS.get(mode, "e")]
    carriers = tuple(
        "".join(letters[i] for i in np.nonzero(owners == k)[0].tolist() if i in kept)
        for k in range(len(code))
    )
    rows = _row_names(code[: len(code) - signs], jacobians) + ("",) * signs
    joints = np.zeros(0, dtype=np.int64)
    if snapshot.held is not None:
        joints = np.nonzero(~snapshot.held.joints.redundant)[0]
        seen, _ = mode_columns(code[shared], cones[shared], snapshot.whole.jacobians[shared], -1)
        together = np.vstack([seen, snapshot.held.joints.jacobian[joints]])
        _, order, _ = independent(np.ascontiguousarray(together.T))
        # What joints allow has the rank `reach`: the sum is no matter of rounding.
        coordinates = np.sort(order[: reach + len(joints)])
    return Share(
        given,
        tuple(zones),
        rows,
        carriers,
        tuple(coordinates.tolist()),
        tuple(joints.tolist()),
        float(verdict[0]),
    )


def bearing(roles: Roles) -> frozenset[int]:
    """Return the contacts that may bear in a flow: what is closed, and not at its cone's apex."""
    return frozenset(
        i
        for i, role in enumerate(roles)
        if role.state not in OPEN
        and not (isinstance(role.share, Bearing) and role.share.zone == _ZONES[APEX])
    )


def rank(states: Sequence[str], jacobians: Array) -> int:
    """Return how many independent constraints the contacts of a mode make."""
    own = [jacobians[k, d] for k, d in _own([CODES[state] for state in states])]
    return independent(np.array(own))[0] if own else 0


def _own(code: Iterable[int]) -> list[tuple[int, int]]:
    """Return the constraints of every contact: which, and along its normal or tangent."""
    return [(k, "nt".index(row)) for k, c in enumerate(code) for row in _LETTERS.get(c, "n")]


def _row_names(code: Ints, jacobians: Array) -> tuple[str, ...]:
    """Return which constraints of each contact the others do not imply."""
    own = _own(code.tolist())
    count, order, _ = independent(np.array([jacobians[k, d] for k, d in own]))
    kept = {own[i] for i in order[:count]}
    return tuple("".join("nt"[d] for d in range(2) if (k, d) in kept) for k in range(len(code)))


def prestressed_contacts(jacobians: Array, cones: Array, bearing: Sequence[int]) -> frozenset[int]:
    """Return the contacts that may press on each other without any load, by linear programming."""
    from scipy.optimize import linprog

    # Along both edges of every cone; all together are to press by 1 at most.
    edges = [
        cones[i, 0] * jacobians[i, 0] + side * cones[i, 1] * jacobians[i, 1]
        for i in bearing
        for side in (1.0, -1.0)
    ]
    effects = np.transpose(edges)
    scale = np.abs(effects).max(axis=1, initial=0.0)
    held = effects[scale > 0.0] / scale[scale > 0.0, None]
    found = set()
    for k, i in enumerate(bearing):
        aim = np.zeros(len(edges))
        aim[2 * k : 2 * k + 2] = -1.0
        most = linprog(aim, np.ones((1, len(edges))), [1.0], held, np.zeros(len(held)))
        if most.status == 0 and -most.fun > _PRESSED:
            found.add(i)
    return frozenset(found)
