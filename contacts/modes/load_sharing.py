"""Indeterminate loads: the smallest forces in the friction cones.

Among all forces in the cones that explain a motion, those with the smallest ``sum V^2 + H^2`` are
unique: every contact force is the projection on its cone of ``w = J y``, the force of equal springs
if the bodies are displaced by y. The cone of a locked coupling is the interval up to its limit. The
part of its cone on which a contact's force lies is its *zone*. As long as no zone changes, y and
all forces follow from linear equations, which a flow integrates. A change of zone is no change of
mode; the mode ends when no forces in the cones explain the motion.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from contacts.dynamics.snapshot import Snapshot
from contacts.scene.modes import OWN, Bearing, SignFriction
from contacts.solvers.dependence import independent_rows
from contacts.solvers.mode_solver import is_coupling, judge_forces, write_limits
from contacts.solvers.redundancy import mode_columns, redundant_contacts
from contacts.solvers.smallest_forces import APEX, INSIDE, LOWER, UPPER, smallest_forces
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
    # Independent constraints of every contact ("nt", "n", "t", "")
    rows: tuple[str, ...]
    # Forces of every contact that suffice for the motion: along normal and tangent ("n", "t") or
    # along its edge ("e")
    carriers: tuple[str, ...]
    # `coordinates`, `joints`: Coordinates of independent displacements y, and their joint rows
    coordinates: tuple[int, ...]
    joints: tuple[int, ...]
    # Largest violation of a zone, in units of force; <= 0: none
    violation: float
    # Contacts inside their cones or limits whose forces lie on the boundary, to round-off
    bounded: tuple[int, ...] = ()
    signs: tuple[tuple[SignFriction, str], ...] = ()  # Signs that share, and their zones

    def of_contacts(self, count: int, frictions: Sequence[SignFriction]) -> Share | None:
        """Return the load sharing of the first contacts, without the signs that follow them."""
        behind = zip(frictions, self.zones[count:], strict=True)
        signs = tuple((sign, zone) for sign, zone in behind if zone != OWN)
        if all(zone == OWN for zone in self.zones[:count]):
            return None
        names = ("forces", "zones", "rows", "carriers")
        return replace(self, signs=signs, **{name: getattr(self, name)[:count] for name in names})

    def roles(self, states: Sequence[str]) -> Roles:
        """Return the roles of contacts in `states`, with their zones and independent rows."""
        all_rows = {"pin": "nt", "locked": "t"} | dict.fromkeys((*OPEN, *SLIPPING), "")
        first_shared = next(k for k, zone in enumerate(self.zones) if zone != OWN)
        result = []
        contacts = zip(states, self.zones, self.rows, self.carriers, strict=True)
        for k, (state, zone, rows, carriers) in enumerate(contacts):
            bearing = None
            if zone != OWN:
                once = (self.joints, self.signs) if k == first_shared else ((), ())
                bearing = Bearing(zone, rows, carriers, self.coordinates, *once)
            elif rows != all_rows.get(state, "n"):
                bearing = Bearing(zone, rows)
            result.append(Role(state, share=bearing))
        return tuple(result)


# Distances of forces from the boundary below this part of the forces are round-off.
_ON_BOUNDARY = 1e-12
# Forces below this part of the sum are round-off.
_MIN_PRESSURE = 1e-6


def share(
    code: Ints, snapshot: Snapshot, cones: Array, loaded_by: Ints, forces: Array, inward: float,
    signs: int,
) -> Share | None:  # fmt: skip
    """Return the smallest forces within the cones equivalent to `forces`; None if there are none.

    The modes `code` (c,) are those of `contacts.states`; `forces` explain the motion, inside their
    `cones` or not. A bias `inward` into the cones regularises the search of zones, so that they
    determine the forces also on the boundary of the feasible loads. `loaded_by` are the carriers of
    `ModeEquations`; the last `signs` modes are those of sign functions, which carry nothing in the
    equations of a flow.
    """
    limits, cones = cones, cones.copy()
    couplings = np.flatnonzero([is_coupling(c) for c in code.tolist()])
    cones[couplings] = 0.0, 1.0
    jacobians = snapshot.jacobians
    flat, owners = mode_columns(code, cones, jacobians, -1)
    shared = np.flatnonzero(
        redundant_contacts(code, cones, jacobians, independent_rows(flat)[0], len(flat))
    )
    shares, carrying = np.isin(owners, shared), owners < len(code) - signs
    if independent_rows(flat[shares & carrying])[0] < independent_rows(flat[shares])[0]:
        return None
    count, order, _ = independent_rows(flat[carrying])
    load = np.einsum("gdn,gd->n", jacobians[shared], forces[shared])
    motion_rank, chosen, _ = independent_rows(np.ascontiguousarray(flat[shares].T))
    coordinates = np.sort(chosen[:motion_rank])
    # The edge of a frictionless cone is (1, 0).
    smooth = code[shared] == SLIDE
    # The limit of a locked coupling bounds its couple.
    couple_limits = np.full(len(shared), np.inf)
    for k, i in enumerate(shared.tolist()):
        if code[i] == LOCKED:
            carrier = forces[loaded_by[i], 0] if loaded_by[i] >= 0 else 1.0
            couple_limits[k] = limits[i, 0] * carrier
    problem = (
        np.column_stack([np.where(smooth[:, None], [1.0, 0.0], cones[shared]), couple_limits]),
        np.array([_SLIDING.get(mode, 1.0) for mode in code[shared].tolist()]),
        np.ascontiguousarray(jacobians[shared][:, :, coordinates]),
        load[coordinates],
    )
    explained, least_forces, places, violation = smallest_forces(*problem, inward)
    if not explained or violation > 0.0:
        # The bias can change a zone: solve without it.
        unbiased = smallest_forces(*problem, 0.0)
        if unbiased[0] and (not explained or unbiased[3] < violation):
            explained, least_forces, places, violation = unbiased
    if not explained:
        return None
    if np.isin(loaded_by[couplings], shared).any():
        # The couple of a slipping coupling would depend on the load sharing: not supported.
        return None
    shared_forces, zones = forces.copy(), [OWN] * len(code)
    shared_forces[shared] = least_forces
    write_limits(shared_forces, limits, loaded_by, code)
    for k, place in zip(shared.tolist(), places.tolist(), strict=True):
        zones[k] = _ZONES[place]
    edges, limited = problem[0], np.isfinite(couple_limits)
    loads = np.abs(least_forces)
    slack = edges[:, 1] * loads[:, 0] - edges[:, 0] * loads[:, 1]
    slack[limited] = (couple_limits - loads[:, 1])[limited]
    bounded = (places == INSIDE) & (slack <= _ON_BOUNDARY * loads.max(initial=0.0))
    determined = ~np.isin(np.arange(len(code)), shared)
    verdict = np.array([violation, 0.0, 0.0, 0.0])
    judge_forces(verdict, forces[determined], cones[determined], code[determined], 1.0)
    judge_forces(verdict, shared_forces[couplings], cones[couplings], code[couplings], 1.0)
    independent = set(order[:count].tolist())
    letters = [letter for mode in code.tolist() for letter in _LETTERS.get(mode, "e")]
    carriers = tuple(
        "".join(letters[i] for i in np.nonzero(owners == k)[0].tolist() if i in independent)
        for k in range(len(code))
    )
    rows = _row_names(code[: len(code) - signs], jacobians) + ("",) * signs
    joints = np.zeros(0, dtype=np.int64)
    if snapshot.reduction is not None:
        joints = np.nonzero(~snapshot.reduction.joints.redundant)[0]
        unreduced = snapshot.unreduced.jacobians[shared]
        contact_rows, _ = mode_columns(code[shared], cones[shared], unreduced, -1)
        all_rows = np.vstack([contact_rows, snapshot.reduction.joints.jacobian[joints]])
        _, order, _ = independent_rows(np.ascontiguousarray(all_rows.T))
        # The rank of all rows is this sum, independent of round-off.
        coordinates = np.sort(order[: motion_rank + len(joints)])
    return Share(
        shared_forces, tuple(zones), rows, carriers, tuple(coordinates.tolist()),
        tuple(joints.tolist()), float(verdict[0]), tuple(shared[bounded].tolist()),
    )  # fmt: skip


def bearing_contacts(roles: Roles) -> frozenset[int]:
    """Return the contacts that may bear a load in a flow: closed, and not at the cone's apex."""
    return frozenset(
        i
        for i, role in enumerate(roles)
        if role.state not in OPEN
        and not (isinstance(role.share, Bearing) and role.share.zone == _ZONES[APEX])
    )


def rank(states: Sequence[str], jacobians: Array) -> int:
    """Return the rank of the constraints of a mode's contacts."""
    rows = [jacobians[k, d] for k, d in _mode_constraints([CODES[state] for state in states])]
    return independent_rows(np.array(rows))[0] if rows else 0


def _mode_constraints(code: Iterable[int]) -> list[tuple[int, int]]:
    """Return the constraints of a mode as (contact, direction)."""
    return [(k, "nt".index(row)) for k, c in enumerate(code) for row in _LETTERS.get(c, "n")]


def _row_names(code: Ints, jacobians: Array) -> tuple[str, ...]:
    """Return the independent constraints of each contact, as letters."""
    constraints = _mode_constraints(code.tolist())
    count, order, _ = independent_rows(np.array([jacobians[k, d] for k, d in constraints]))
    independent = {constraints[i] for i in order[:count]}
    return tuple(
        "".join("nt"[d] for d in range(2) if (k, d) in independent) for k in range(len(code))
    )


def prestressed_contacts(jacobians: Array, cones: Array, bearing: Sequence[int]) -> frozenset[int]:
    """Return the contacts that can be prestressed against each other, by linear programming."""
    from scipy.optimize import linprog

    # Variables: forces along both edges of every cone, whose sum is at most 1.
    edges = [
        cones[i, 0] * jacobians[i, 0] + side * cones[i, 1] * jacobians[i, 1]
        for i in bearing
        for side in (1.0, -1.0)
    ]
    effects = np.transpose(edges)
    scale = np.abs(effects).max(axis=1, initial=0.0)
    constraints = effects[scale > 0.0] / scale[scale > 0.0, None]
    prestressed, sums, zeros = set(), np.ones((1, len(edges))), np.zeros(len(constraints))
    for k, i in enumerate(bearing):
        objective = np.zeros(len(edges))
        objective[2 * k : 2 * k + 2] = -1.0
        result = linprog(objective, sums, [1.0], constraints, zeros)
        if result.status == 0 and -result.fun > _MIN_PRESSURE:
            prestressed.add(i)
    return frozenset(prestressed)
