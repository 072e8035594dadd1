"""The woodpecker toy against an independent code, written from the published equations."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from statechart.running.runner import Runner

M_M, J_M, M_S, J_S, C, G = 0.0003, 5e-9, 0.0045, 7e-7, 0.0056, 9.81
R_0, R_M, H_M, L_M, L_G, H_S, L_S = 0.0025, 0.0031, 0.0058, 0.010, 0.015, 0.02, 0.0201
MU, RESTITUTION = 0.3, (0.5, 0.0, 0.0)
MASS = np.array(
    [
        [M_S + M_M, M_S * L_M, M_S * L_G],
        [M_S * L_M, J_M + M_S * L_M**2, M_S * L_M * L_G],
        [M_S * L_G, M_S * L_M * L_G, J_S + M_S * L_G**2],
    ]
)
NORMALS = np.array([[0, 0, -H_S], [0, H_M, 0], [0, -H_M, 0]])
# Along the pole, downwards.
TANGENTS = -np.array([[1, L_M, L_G - L_S], [1, R_M, 0], [1, R_M, 0]])


def gaps(q):
    return np.array([L_M + L_G - L_S - R_0, R_M - R_0, R_M - R_0]) + NORMALS @ q


def forces(q):
    pull = C * (q[1] - q[2])
    return np.array([-(M_S + M_M) * G, -pull - M_S * G * L_M, pull - M_S * G * L_G])


def solve(active, v, free):
    """Try every combination of open, stick and slip at the active contacts."""
    for modes in product(("open", "stick", "left", "right"), repeat=len(active)):
        columns, rows, wanted = [], [], []
        for i, mode in zip(active, modes, strict=True):
            n, t = NORMALS[i], TANGENTS[i]
            if mode == "open":
                continue
            rows.append(n)
            wanted.append(-RESTITUTION[i] * min(n @ v, 0.0))
            if mode == "stick":
                columns += [n, t]
                rows.append(t)
                wanted.append(0.0)
            else:
                columns.append(n + (MU if mode == "left" else -MU) * t)
        if not rows:
            after, impulses = free, []
        else:
            act = np.linalg.solve(MASS, np.array(columns).T)
            matrix = np.array(rows) @ act
            if np.linalg.cond(matrix) > 1e14:
                continue
            impulses = np.linalg.solve(matrix, np.array(wanted) - np.array(rows) @ free)
            after = free + act @ impulses
        at, good = 0, True
        for i, mode in zip(active, modes, strict=True):
            n, t = NORMALS[i], TANGENTS[i]
            if mode == "open":
                good &= n @ after + RESTITUTION[i] * min(n @ v, 0.0) >= -1e-13
                continue
            good &= impulses[at] >= 0.0
            if mode == "stick":
                good &= abs(impulses[at + 1]) <= MU * impulses[at]
                at += 2
            else:
                good &= (t @ after) * (1 if mode == "left" else -1) <= 0.0
                at += 1
        if good:
            return after
    raise AssertionError("no combination agrees")


def moreau(q, v, h, steps):
    """Moreau's midpoint rule; contacts whose gap is closed at the midpoint take part.

    If all that are new have no restitution, the motion after their impact begins at the last touch.
    """
    closed = np.zeros(3, bool)
    for _ in range(steps):
        middle = q + 0.5 * h * v
        free = v + np.linalg.solve(MASS, h * forces(middle))
        active = np.flatnonzero(gaps(middle) <= 1e-15)
        new = [i for i in active if not closed[i] and NORMALS[i] @ v < 0.0]
        if new and not any(RESTITUTION[i] for i in new):
            since = min(gaps(middle)[i] / (NORMALS[i] @ v) for i in new)
            middle = middle + since * (solve(active, v, v) - v)
        v = solve(active, v, free) if len(active) else free
        closed[:] = False
        closed[active] = np.abs(NORMALS[active] @ v) <= 1e-12
        q = middle + 0.5 * h * v
    return q, v


@pytest.fixture(scope="module")
def toy():
    return Runner("woodpecker", engine="impulse", step=2e-5)


def test_the_trajectory_is_that_of_an_independent_code(toy):
    trace = toy.run(until=0.3).trace
    start = trace.initial
    q, v = moreau(start[:3], start[3:], 2e-5, 15000)
    assert np.abs(trace.final[:3] - q).max() <= 1e-9
    assert np.abs(trace.final[3:] - v).max() <= 1e-9


def test_steps_come_to_the_run_with_events_to_first_order():
    # Impacts fall anywhere in their step, so that errors lie within a line through the origin.
    exact = Runner("woodpecker", engine="taylor").run(until=0.3)
    assert exact.trace.outcome.succeeded
    for step in (4e-5, 1e-5, 2.5e-6):
        found = Runner("woodpecker", engine="impulse", step=step).run(until=0.3)
        assert found.outputs["fallen"] == pytest.approx(exact.outputs["fallen"], abs=8.0 * step)
        assert found.outputs["pecks"] == pytest.approx(exact.outputs["pecks"], abs=40.0 * step)
        assert not found.warnings


def test_the_motion_is_a_limit_cycle(toy):
    # From the published state and from one that is not on the cycle.
    periods = []
    for parameters in ({}, {"dphi_S0": -7.3}):
        pecks = np.array(toy.run(parameters, until=2).outputs["pecks"])
        assert np.ptp(np.diff(pecks[-5:])) < 2e-3
        periods.append(np.diff(pecks[-5:]).mean())
    assert periods[0] == pytest.approx(periods[1], rel=2e-3)
    assert 0.14 < periods[0] < 0.15
