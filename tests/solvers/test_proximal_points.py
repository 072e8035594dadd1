"""Impulses of many contacts, held against the contact laws by dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from batches import contact_rows

from contacts.solvers.contact_rows import impulse_residual, velocity_scale
from contacts.solvers.contact_solver import solve_rows
from contacts.solvers.proximal_points import solve_by_proximal_points
from statechart.kernels.jit import kernel


@kernel
def solved(contacts, least, impulses, allowed):
    """Call a function from Python that only kernels call."""
    return solve_rows(contacts, least, impulses, allowed, False, True)


@kernel
def improved(contacts, least, impulses, allowed):
    size = velocity_scale(contacts, least)
    lowest = impulse_residual(contacts, least, size, impulses)
    return solve_by_proximal_points(contacts, least, size, lowest, impulses, allowed)


@kernel
def missed_by(contacts, least, impulses):
    return impulse_residual(contacts, least, velocity_scale(contacts, least), impulses)


def wall(rows, across, mu, generator):
    """Return the contacts of a wall of bricks between posts, and what their velocities are.

    Each brick lies on two others, or the ground, at both ends; those at the sides press against the
    posts, at gaps that differ by a thousandth of what they fall in a step.
    """
    pairs, normals, arms = [], [], []
    for r in range(rows):
        for c in range(across):
            b = r * across + c
            for at in (-1.0, 1.0):
                below = c if at < 0 else c + 1
                below = (r - 1) * across + min(below, across - 1) if r else -1
                pairs.append((b, below))
                normals.append((0.0, 1.0))
                arms.append(((at, -0.5), (0.0, 0.5)))
            if c in (0, across - 1):
                side = 1.0 if c == 0 else -1.0
                pairs.append((b, -1))
                normals.append((side, 0.0))
                arms.append(((-2.0 * side, 0.3), (0.0, 0.0)))
    count, last = len(pairs), 3 * rows * across
    places, lines = np.tile(last + np.arange(3), (count, 2)), np.zeros((count, 2, 6))
    for i, (pair, (nx, ny), points) in enumerate(zip(pairs, normals, arms, strict=True)):
        for side, (body, (rx, ry)) in enumerate(zip(pair, points, strict=True)):
            if body < 0:
                continue
            places[i, 3 * side : 3 * side + 3] = range(3 * body, 3 * body + 3)
            for d, (ux, uy) in enumerate(((nx, ny), (ny, -nx))):
                row = np.array([ux, uy, rx * uy - ry * ux])
                lines[i, d, 3 * side : 3 * side + 3] = row if side == 0 else -row
    inverse = np.tile([1.0, 1.0, 2.0], rows * across)
    columns = lines * np.append(inverse, np.zeros(3))[places][:, None]
    contacts = contact_rows(
        places[:, ::3] // 3, rows * across, lines, columns, np.tile([1.0, mu], (count, 1))
    )
    rates = np.tile([0.0, -1.0, 0.0], rows * across) + 0.1 * generator.normal(size=last)
    free = np.einsum("idk,ik->id", lines, np.append(rates, np.zeros(3))[places])
    free[:, 0] += 1e-3 * generator.random(count)
    return contacts, free


def places_of(contacts):
    """Return which rates (m, 6) contacts move."""
    return (3 * contacts.bodies[:, :, None] + np.arange(3)).reshape(-1, 6)


def missed(contacts, free, impulses):
    """Return by how much impulses miss the contact laws, of the fastest approach."""
    count, width = len(free), 3 * contacts.moving + 3
    felt, moves = np.zeros((2, 2 * count, width))
    for i, places in enumerate(places_of(contacts)):
        for k, place in enumerate(places):
            felt[2 * i : 2 * i + 2, place] += contacts.rows[i, :, k]
            moves[2 * i : 2 * i + 2, place] += contacts.columns[i, :, k]
    normal, slip = (free + (felt @ (moves.T @ impulses.ravel())).reshape(-1, 2)).T
    (wn, wt, _), (pn, pt) = contacts.own.T, impulses.T
    edge = contacts.cones[:, 1] / contacts.cones[:, 0] * wt * pn
    parts = np.minimum(wn * pn, normal), wt * pt - np.clip(wt * pt - slip, -edge, edge)
    return max(np.abs(part).max() for part in parts) / -free[:, 0].min()


@pytest.mark.parametrize("mu", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("seed", range(6))
def test_a_wall_between_posts_is_solved_from_nothing(mu, seed):
    contacts, free = wall(8, 5, mu, np.random.default_rng(seed))
    impulses = np.zeros_like(free)
    left, taken = solved(contacts, free, impulses, 1e-9)
    assert left <= 1e-9
    assert left == pytest.approx(missed(contacts, free, impulses), rel=1e-2, abs=1e-13)
    assert taken > 0


def of_all_masses(contacts, generator):
    """Return contacts of bodies whose masses span six decades."""
    masses = 10.0 ** generator.uniform(-3, 3, contacts.moving)
    inverse = np.append(np.outer(1.0 / masses, [1.0, 1.0, 2.0]), np.zeros(3))
    columns = contacts.rows * inverse[places_of(contacts)][:, None]
    own = [(contacts.rows[:, a] * columns[:, b]).sum(-1) for a, b in ((0, 0), (1, 1), (0, 1))]
    return contacts._replace(columns=columns, own=np.stack(own, 1))


@pytest.mark.parametrize("mu", [5.0, 500.0])
@pytest.mark.parametrize("seed", range(6))
def test_a_wall_whose_masses_span_six_decades_is_solved(mu, seed):
    """Heavy bricks on light ones: of the tableau of Lemke's algorithm ten pivots leave nothing."""
    generator = np.random.default_rng(seed)
    contacts, free = wall(4, 3, mu, generator)
    contacts, impulses = of_all_masses(contacts, generator), np.zeros_like(free)
    left, _ = solved(contacts, free, impulses, 1e-8)
    assert left <= 1e-8
    assert missed(contacts, free, impulses) <= 1e-8


def test_a_solved_problem_takes_no_iterations():
    contacts, free = wall(8, 5, 0.5, np.random.default_rng(3))
    impulses = np.zeros_like(free)
    improved(contacts, free, impulses, 1e-9)
    again = impulses.copy()
    assert improved(contacts, free, again, 1e-9)[1] == 0
    assert (again == impulses).all()


@pytest.mark.parametrize("size", [1.0, 1e10, 1e20])
def test_no_impulses_keep_a_body_out_of_two_faces_that_approach_it(size):
    """Opposed impulses cancel, however large they are: both faces still approach at 1."""
    rows = np.zeros((2, 2, 6))
    rows[0, :, :2], rows[1, :, :2] = np.eye(2), -np.eye(2)
    contacts = contact_rows(np.array([[0, 1]] * 2), 1, rows, rows.copy(), np.ones((2, 2)))
    free, impulses = np.array([[-1.0, 0.0]] * 2), np.array([[size, 0.0]] * 2)
    assert missed_by(contacts, free, impulses) == 1.0
    left, _ = solved(contacts, free, impulses, 1e-6)
    assert left == pytest.approx(1.0)


def test_impulses_scale_with_masses_and_velocities():
    contacts, free = wall(6, 4, 0.5, np.random.default_rng(5))
    light, heavy = np.zeros_like(free), np.zeros_like(free)
    improved(contacts, free, light, 1e-10)
    slow = contacts._replace(columns=contacts.columns / 16.0, own=contacts.own / 16.0)
    improved(slow, 4.0 * free, heavy, 1e-10)
    assert heavy == pytest.approx(64.0 * light, rel=1e-12)
