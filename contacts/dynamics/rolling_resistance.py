"""Impulses of rolling resistance: a couple of at most a length times the normal impulse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, sliding_edge
from contacts.dynamics.snapshot import Snapshot, answer, solve_kkt
from statechart.arrays import Array


def apply_rolling_resistance(
    snapshot: Snapshot, laws: Sequence[ContactLaw], velocity: Array, impulses: Array,
    slip_tolerance: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Return velocity and impulses of an instant with those of rolling resistance.

    The angular impulse is at most a length times the normal impulse, opposes the rotation after the
    impact and does not reverse it. A contact that sticks after the impact still sticks if friction
    suffices, kinetic friction where it slipped before; else the slip goes on, and friction is on
    the edge of its cone. A slip that the angular impulse stops has ended. One that does not rebound
    remains closed.
    """
    for place, law in rolling(laws):
        if not impulses[law.carrier, 0] > 0.0:
            continue
        limit = float(snapshot.limits[place - len(laws)][1])
        bound = limit * float(impulses[law.carrier, 0])
        touching, cone = snapshot.contacts[law.carrier], laws[law.carrier]
        jacobian, couple = snapshot.jacobians[law.carrier], snapshot.jacobians[place, 1]
        stops = True
        while stops:
            change = velocity - snapshot.velocity
            slip = snapshot.contacts[place].slip + float(couple @ change)
            if not (abs(slip) > slip_tolerance and bound > 0.0):
                break
            after = [
                rate + float(row @ change)
                for rate, row in zip((touching.gap_rate, touching.slip), jacobian, strict=True)
            ]
            sticking = [d for d in range(2) if abs(after[d]) <= slip_tolerance]
            rows = np.array([couple, *(jacobian[d] for d in sticking)])
            solved = answer(snapshot, rows, rows, np.array([-slip, *(0.0 for _ in sticking)]))
            if solved is None:
                break
            share = min(1.0, bound / abs(solved[1][0])) if solved[1][0] != 0.0 else 1.0
            # Where it would turn a slip round, the rest of it acts on a contact that sticks.
            braking = 0.0
            if 1 not in sticking:
                braking = -share * float(jacobian[1] @ solved[0]) / after[1]
            stops = braking > 1.0
            share = share / braking if stops else share
            bound -= share * abs(float(solved[1][0]))
            rolled = impulses.copy()
            rolled[place, 1] += share * solved[1][0]
            for d, impulse in zip(sticking, solved[1][1:].tolist(), strict=True):
                rolled[law.carrier, d] += share * impulse
            normal, tangential = rolled[law.carrier].tolist()
            slipped = abs(touching.slip) > slip_tolerance
            edge = sliding_edge(cone, touching) if slipped else (cone.cone_n, cone.cone_t)
            if 1 not in sticking or edge[0] * abs(tangential) <= edge[1] * normal:
                velocity, impulses = velocity + share * solved[0], rolled
                continue
            edge = edge[0], math.copysign(edge[1], tangential)
            change, impulses = _continue_slip(
                snapshot, impulses, place, law.carrier, slip, limit, edge
            )
            velocity = velocity + change
    return velocity, impulses


def couples(laws: Sequence[ContactLaw], impulses: Array) -> dict[str, float]:
    """Return the angular impulses of rolling resistance other than zero, by name."""
    sizes = {f"{law.name}.M": law.lever * impulses.item(i, 1) for i, law in rolling(laws)}
    return {name: size for name, size in sizes.items() if size}


def rolling(laws: Sequence[ContactLaw]) -> list[tuple[int, ContactLaw]]:
    """Return the places and laws of rolling resistance."""
    return [(place, law) for place, law in enumerate(laws) if law.carrier >= 0]


def _continue_slip(
    snapshot: Snapshot,
    impulses: Array,
    couple_place: int,
    place: int,
    slip: float,
    limit: float,
    edge: tuple[float, float],
) -> tuple[Array, Array]:
    """Return the change of velocity, and the impulses, where a resisted contact goes on to slip.

    Its impulse along the `edge` of its cone leaves its gap rate as it is; the angular impulse stops
    the rotation `slip`, or is `limit` times the normal impulse. Both replace those in `impulses`.
    """
    couple, jacobian = snapshot.jacobians[couple_place, 1], snapshot.jacobians[place]
    rates = np.array([-slip, 0.0])
    push, rows = np.array(edge) @ jacobian, np.array([couple, jacobian[0]])
    replaced = jacobian.T @ impulses[place] + couple * impulses[couple_place, 1]
    solve = partial(solve_kkt, snapshot.mass, -replaced)
    solved = solve(rows, np.array([couple, push]), rates)
    if solved is None:
        return np.zeros(len(snapshot.velocity)), impulses
    stop, size = solved[1].tolist()
    if abs(stop) > limit * edge[0] * size:
        push = push + math.copysign(limit * edge[0], stop) * couple
        solved = solve(rows[1:], push[None], rates[1:])
        if solved is None:
            return np.zeros(len(snapshot.velocity)), impulses
        size = float(solved[1][0])
        stop = math.copysign(limit * edge[0] * size, stop)
    impulses = impulses.copy()
    impulses[place], impulses[couple_place, 1] = size * np.array(edge), stop
    return solved[0], impulses
