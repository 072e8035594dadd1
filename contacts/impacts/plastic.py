"""The plastic impact of several contacts where one combination of modes agrees, compiled.

See `contacts.impacts.impulses` for what is decided here only where nothing is near its edge.
"""

from __future__ import annotations

import numpy as np

from contacts.dynamics.snapshot import SCALARS
from contacts.modes.fast_classification import ModeRules
from contacts.solvers.dependence import independent
from contacts.solvers.mode_solver import solve_modes
from contacts.solvers.redundancy import connected, mode_columns
from contacts.solvers.saddle_point import SOLVED
from contacts.solvers.step_impulses import into_cone
from contacts.states import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import part

MAX_CONTACTS = 4
"""Contacts in one impact."""
STEEP = 1e3
"""Above this mu a cone's edges alone do not span it in double precision."""
# Of the sizes of impulses and velocities: nearer to its edge an inequality is not decided here.
_EDGE = 1e-9
# Of the terms of a momentum: what no impulse explains.
_UNEXPLAINED = 1e-12


@part
def _choices(allowed: Bools, cone: Array, choices: Ints) -> int:
    """List what a contact may do in an impact; return how many, 0 where its cone is too steep."""
    choices[0] = FREE
    if cone[1] == 0.0:
        choices[1] = SLIDE
        return 2
    if not (allowed[SLIDE] or allowed[SLIDE_PLUS] or allowed[SLIDE_MINUS]):
        choices[1] = PIN
        return 2
    if cone[1] > STEEP * cone[0]:
        return 0
    choices[1], choices[2], choices[3] = SLIDE_PLUS, SLIDE_MINUS, PIN
    return 4


@part
def _explained(mass: Array, jacobians: Array, change: Array, impulses: Array) -> bool:
    """Whether impulses explain all changes of momentum."""
    for i in range(change.shape[0]):
        missed = terms = 0.0
        for k in range(change.shape[0]):
            missed += mass[i, k] * change[k]
            terms += abs(mass[i, k] * change[k])
        for g in range(jacobians.shape[0]):
            for d in range(2):
                missed -= jacobians[g, d, i] * impulses[g, d]
                terms += abs(jacobians[g, d, i] * impulses[g, d])
        if abs(missed) > _UNEXPLAINED * terms:
            return False
    return True


@part
def strike_group(
    rules: ModeRules, numbers: Array, restitution: Array, group: Ints, velocity: Array,
    impulse: Array,
) -> int:  # fmt: skip
    """Let a group of contacts be hit that do not rebound, and that all feel each other.

    Parameters
    ----------
    rules : ModeRules
        Of all contacts.
    numbers : (o,) array
        The scene's (`contacts.dynamics.snapshot.SnapshotTape`).
    restitution : (c,) array
    group : (g,) array of int64
        The contacts that are closed.
    velocity : (n,) array
        Rates of the coordinates; brought up to date.
    impulse : (c, 2) array
        To be filled, where the contacts are in the group.

    Returns
    -------
    int
        Modes that agree, in digits of base 8 above 1, the first contact the lowest; 0 where there
        is not one that is clear.
    """
    n, allowed, cones = velocity.shape[0], rules.allowed, rules.cones
    mass = numbers[: n * n].reshape((n, n))
    count, contacts = group.shape[0], allowed.shape[0]
    if count > MAX_CONTACTS:
        return 0
    at = n * n + n + 1
    scalars = at + (2 * n + 2) * contacts
    jacobians, start = np.empty((count, 2, n)), np.empty((count, 2))
    edges, choices = np.empty((count, 2)), np.empty((count, 4), np.int64)
    counts = np.empty(count, np.int64)
    total, fastest = 1, rules.speed
    linked = mass != 0.0
    for g in range(count):
        c = group[g]
        counts[g] = _choices(allowed[c], cones[c], choices[g])
        total *= counts[g]
        if restitution[c] != 0.0:
            return 0
        jacobians[g] = numbers[at + 2 * n * c : at + 2 * n * (c + 1)].reshape((2, n))
        edges[g] = cones[c]
        place = scalars + SCALARS * c
        for d in range(2):
            start[g, d] = numbers[place + 1 + d]
            fastest = max(fastest, abs(start[g, d]))
        for i in range(n):
            for k in range(n):
                touched = abs(jacobians[g, 0, i]) + abs(jacobians[g, 1, i]) > 0.0
                other = abs(jacobians[g, 0, k]) + abs(jacobians[g, 1, k]) > 0.0
                linked[i, k] = linked[i, k] or (touched and other)
    labels = connected(linked)
    for i in range(n):
        # Bodies that do not feel the impact would make groups of their own.
        if labels[i] != labels[0]:
            return 0
    if total == 0:
        return 0
    codes = np.empty((total, count), np.int64)
    for k in range(total):
        left = k
        for g in range(count):
            codes[k, g] = choices[g, left % counts[g]]
            left //= counts[g]
    everywhere = np.ones(count, np.bool_)
    status, changes = np.empty(total, np.int64), np.empty((total, n))
    forces, verdicts = np.empty((total, count, 2)), np.empty((total, 4))
    solve_modes(
        mass,
        np.zeros(n),
        jacobians,
        start,
        edges,
        codes,
        everywhere,
        everywhere,
        rules.force / rules.acceleration * fastest,
        fastest,
        status,
        changes,
        forces,
        verdicts,
        _EDGE,
    )
    # Impulses that the motion leaves open are those of no mode.
    agreeing, several = -1, False
    for k in range(total):
        if status[k] == SOLVED and verdicts[k, 0] <= _EDGE:
            several, agreeing = several or agreeing >= 0, k
    if several or agreeing < 0 or not verdicts[agreeing, 0] < -_EDGE:
        return 0
    if not _explained(mass, jacobians, changes[agreeing], forces[agreeing]):
        return 0
    columns, _ = mode_columns(codes[agreeing], edges, jacobians, -1)
    if independent(columns)[0] < columns.shape[0]:
        return 0
    path = 1
    for g in range(count - 1, -1, -1):
        path = 8 * path + codes[agreeing, g]
        impulse[group[g]] = into_cone(forces[agreeing, g], edges[g])
    for i in range(n):
        velocity[i] += changes[agreeing, i]
    return path
