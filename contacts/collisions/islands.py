"""Islands of bodies that touch each other: contacts one by one, and swept over (Gauss-Seidel).

Islands too large for a dense problem are swept contact by contact until nothing changes (Moreau and
Jean's contact dynamics).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_lcp_kernels import STEEPEST, UNKNOWNS
from contacts.solvers.step_impulses import capped
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import part

_SWEEPS = 2000
# Largest change of a velocity in a sweep that ends it, relative to the velocities; and in the last
# sweep, where contacts are so nearly redundant that they go on exchanging impulses.
_SWEPT, _SWEPT_LAST = 1e-9, 1e-6


class Touching(NamedTuple):
    """The contacts of a step, and the bodies that they move.

    Attributes
    ----------
    bodies : (m, 2), rows : (m, 2, 6)
        Which bodies touch, -1 for a surface; velocities of the contact, normal and tangential, per
        unit rates of the two.
    inverse : (b, 3)
        See `body_step.BodyNumbers`.
    cones, wanted, before, free : (m, 2)
        See `contacts.solvers.contact_lcp_kernels.solve_impacts`.
    rebounds : (m,) array of bool
    loose : (b, 3)
        Rates without impulses.
    """

    bodies: Ints
    rows: Array
    inverse: Array
    cones: Array
    wanted: Array
    before: Array
    free: Array
    rebounds: Bools
    loose: Array


@part
def island_of(parents: Ints, body: int) -> int:
    """Return the body that stands for an island (union-find, paths halved in place)."""
    while parents[body] != body:
        parents[body] = parents[parents[body]]
        body = parents[body]
    return body


@part
def velocity(bodies: Ints, rows: Array, rates: Array, i: int, d: int) -> float:
    """Return the velocity of contact i along d (0: normal, 1: tangential)."""
    total = 0.0
    for side in range(2):
        b = bodies[i, side]
        if b >= 0:
            for k in range(3):
                total += rows[i, d, 3 * side + k] * rates[b, k]
    return total


@part
def push(
    bodies: Ints, rows: Array, inverse: Array, rates: Array, i: int, d: int, amount: float
) -> None:
    """Apply an impulse of contact i along d: `rates` (b, 3) are changed in place."""
    for side in range(2):
        b = bodies[i, side]
        if b >= 0:
            for k in range(3):
                rates[b, k] += inverse[b, k] * rows[i, d, 3 * side + k] * amount


@part
def compliance(bodies: Ints, rows: Array, inverse: Array, i: int, d: int, j: int, e: int) -> float:
    """Return the velocity of contact i along d per unit impulse of contact j along e."""
    total = 0.0
    for side in range(2):
        b = bodies[i, side]
        if b < 0:
            continue
        for other in range(2):
            if bodies[j, other] == b:
                for k in range(3):
                    total += rows[i, d, 3 * side + k] * inverse[b, k] * rows[j, e, 3 * other + k]
    return total


@part
def _sweep(members: Ints, touching: Touching, wanted: Array, impulses: Array) -> bool:
    """Sweep until nothing changes; `impulses` are changed in place."""
    bodies, rows, inverse, cones, _, _, _, _, loose = touching
    rates = loose.copy()
    size = len(members)
    own = np.empty((size, 3))
    for a in range(size):
        i = members[a]
        own[a, 0] = compliance(bodies, rows, inverse, i, 0, i, 0)
        own[a, 1] = compliance(bodies, rows, inverse, i, 1, i, 1)
        own[a, 2] = compliance(bodies, rows, inverse, i, 0, i, 1)
        push(bodies, rows, inverse, rates, i, 0, impulses[i, 0])
        push(bodies, rows, inverse, rates, i, 1, impulses[i, 1])
    change, largest = 0.0, 0.0
    for _ in range(_SWEEPS):
        change, largest = 0.0, 0.0
        for a in range(size):
            i = members[a]
            normal = velocity(bodies, rows, rates, i, 0) + wanted[i, 0]
            slip = velocity(bodies, rows, rates, i, 1) + wanted[i, 1]
            before_n, before_t = impulses[i, 0], impulses[i, 1]
            # Both rows of a contact that sticks, solved together; else the edge of its cone.
            wn, wt, wx = own[a]
            cone_n, cone_t = max(cones[i, 0], STEEPEST), cones[i, 1]
            free_n = normal - wn * before_n - wx * before_t
            free_t = slip - wx * before_n - wt * before_t
            pn, pt = 0.0, 0.0
            if free_n < 0.0:
                det = wn * wt - wx * wx
                if cone_t > 0.0 and det > 0.0:
                    pn = (-wt * free_n + wx * free_t) / det
                    pt = (wx * free_n - wn * free_t) / det
                if cone_t == 0.0:
                    pn, pt = -free_n / wn, 0.0
                elif det <= 0.0 or pn < 0.0 or cone_n * abs(pt) > cone_t * pn:
                    sign = math.copysign(cone_t / cone_n, pt)
                    whole = wn + sign * wx
                    pn = -free_n / whole if whole > 0.0 else -free_n / wn
                    pt = sign * pn
            impulses[i, 0], impulses[i, 1] = pn, pt
            dn, dt = pn - before_n, pt - before_t
            if dn != 0.0:
                push(bodies, rows, inverse, rates, i, 0, dn)
            if dt != 0.0:
                push(bodies, rows, inverse, rates, i, 1, dt)
            change = max(change, wn * abs(dn), wt * abs(dt))
            largest = max(largest, wn * pn)
        if change <= _SWEPT * largest:
            break
    # Whether impulses that no longer change solve the problem, to a velocity `allowed`.
    allowed = _SWEPT_LAST * largest
    if change > allowed:
        return False
    for i in members:
        normal = velocity(bodies, rows, rates, i, 0) + wanted[i, 0]
        slip = velocity(bodies, rows, rates, i, 1) + wanted[i, 1]
        pn, pt = impulses[i, 0], impulses[i, 1]
        if normal < -allowed or (pn > 0.0 and normal > allowed):
            return False
        edge = cones[i, 1] * pn - max(cones[i, 0], STEEPEST) * abs(pt)
        if pn > 0.0 and abs(slip) > allowed and (edge > 1e-9 * pn or slip * pt > 0.0):
            return False
    return True


@part
def _moved(members: Ints, touching: Touching, impulses: Array) -> Array:
    """Return how impulses change the velocities (m, 2) of the contacts."""
    bodies, rows, inverse = touching.bodies, touching.rows, touching.inverse
    rates, moved = np.zeros_like(touching.loose), np.empty((len(members), 2))
    for i in members:
        for d in range(2):
            push(bodies, rows, inverse, rates, i, d, impulses[i, d])
    for a in range(len(members)):
        for d in range(2):
            moved[a, d] = velocity(bodies, rows, rates, members[a], d)
    return moved


@part
def swept(
    members: Ints,
    touching: Touching,
    pushes: Array,
    sliding: Bools,
    guesses: Bools,
) -> bool:
    """Solve an island by sweeps from the impulses of the step before.

    Restitution that would add energy is reduced, as `solve_impacts` does.

    Parameters
    ----------
    members : (m,) array of int
        The island's contacts.
    touching : Touching
        All contacts.
    pushes, sliding, guesses
        Changed in place.
    """
    cones, wanted, rebounds = touching.cones, touching.wanted, touching.rebounds
    part = pushes.copy()
    if not _sweep(members, touching, wanted, part):
        return False
    if rebounds[members].any():
        soft, plastic = wanted.copy(), pushes.copy()
        for i in members:
            if rebounds[i]:
                soft[i, 0] = 0.0
        if not _sweep(members, touching, soft, plastic):
            return False
        chosen, _ = capped(
            touching.before[members],
            touching.free[members],
            plastic[members],
            part[members],
            _moved(members, touching, plastic),
            _moved(members, touching, part),
        )
        for a in range(len(members)):
            part[members[a], 0], part[members[a], 1] = chosen[a, 0], chosen[a, 1]
    for i in members:
        pushes[i, 0], pushes[i, 1] = part[i, 0], part[i, 1]
        edge = cones[i, 0] * abs(part[i, 1]) - cones[i, 1] * part[i, 0]
        sliding[i] = edge >= -1e-9 * (part[i, 0] + abs(part[i, 1]))
        for u in range(UNKNOWNS):
            guesses[i, u] = False
    return True


@part
def swept_steady(
    members: Ints,
    touching: Touching,
    pushes: Array,
    sliding: Bools,
    guesses: Bools,
    hit: Bools,
    steady: Array,
) -> None:
    """Write what is force of the impulses of a swept island: see `steady_impulses`."""
    alone = pushes
    if hit[members].any():
        others = members[~hit[members]]
        alone = np.zeros_like(pushes)
        if len(others) and not swept(others, touching, alone, sliding.copy(), guesses.copy()):
            for i in others:
                alone[i, 0], alone[i, 1] = pushes[i, 0], pushes[i, 1]
    for i in members:
        steady[i, 0], steady[i, 1] = alone[i, 0], alone[i, 1]
