"""Linear complementarity: Lemke against enumeration, against convex optimisation, on contacts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from complementarity import error, every_solution, impact_problem
from hypothesis import given
from hypothesis import strategies as st
from strategies import examples

from contacts.solvers.lemke import FOUND, RAY, forces_by_lemke, lemke
from contacts.solvers.step_impulses import coordinate_impulses


def solve(matrix: np.ndarray, vector: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the outcome of the path that covers with ones, and z."""
    return lemke(matrix, vector, np.ones(len(vector)))


def test_problems_of_size_one_are_solved() -> None:
    for m, q, z in ((2.0, -1.0, 0.5), (2.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)):
        outcome, found = solve(np.array([[m]]), np.array([q]))
        assert outcome == FOUND
        assert found.tolist() == [z]


def test_a_problem_without_solution_is_reported() -> None:
    for m in (-1.0, 0.0):
        assert solve(np.array([[m]]), np.array([-1.0]))[0] == RAY
    assert every_solution(np.array([[-1.0]]), np.array([-1.0])) == []


def test_a_problem_of_size_zero_is_solved() -> None:
    outcome, z = solve(np.empty((0, 0)), np.empty(0))
    assert outcome == FOUND
    assert len(z) == 0


@pytest.mark.parametrize("size", [2, 5, 10])
def test_lemke_solves_murtys_problems_of_exponential_length(size: int) -> None:
    # 1 on the diagonal, 2 below: Lemke's path visits up to 2^n bases from a bad start.
    matrix = np.eye(size) + 2.0 * np.tril(np.ones((size, size)), -1)
    vector = -(2.0 ** np.arange(size, 0, -1))
    outcome, z = lemke(matrix, vector, np.abs(vector) + 1.0)
    expected = np.zeros(size)
    expected[0] = -vector[0]
    assert outcome == FOUND
    assert z == pytest.approx(expected)


def test_degenerate_ties_do_not_cycle() -> None:
    # Kostreva's example, on which Lemke's rule without lexicographic ties cycles.
    matrix = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])
    outcome, z = solve(matrix, -np.ones(3))
    assert outcome == FOUND
    assert z == pytest.approx([1 / 3, 1 / 3, 1 / 3])


def test_lemke_solves_positive_definite_problems() -> None:
    random = np.random.default_rng(1)
    for _ in range(300):
        size = int(random.integers(1, 7))
        half = random.normal(size=(size, size))
        skew = random.normal(size=(size, size))
        matrix = half @ half.T + 0.1 * np.eye(size) + skew - skew.T
        vector = random.normal(size=size)
        (only,) = every_solution(matrix, vector)
        outcome, z = solve(matrix, vector)
        assert outcome == FOUND
        assert z == pytest.approx(only, rel=1e-9, abs=1e-11)


def test_the_solution_of_lemke_is_among_all_enumerated_ones() -> None:
    random = np.random.default_rng(2)
    solved = 0
    for _ in range(500):
        size = int(random.integers(1, 7))
        # Whole numbers give ties, singular bases and several solutions.
        matrix = random.integers(-2, 3, (size, size)).astype(float)
        vector = random.integers(-2, 3, size).astype(float)
        outcome, z = solve(matrix, vector)
        if outcome == FOUND:
            solved += 1
            assert (z >= 0.0).all()
            assert error(matrix, vector, z) <= 1e-9
    assert 50 < solved < 450


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
@examples(60)
def test_convex_problems_agree_with_nonnegative_least_squares(size: int, seed: int) -> None:
    from scipy.optimize import nnls

    random = np.random.default_rng(seed)
    # Fewer rows than columns: many z, one A z.
    A = random.normal(size=(int(random.integers(1, size + 1)), size))
    b = random.normal(size=len(A))
    outcome, z = solve(A.T @ A, -A.T @ b)
    assert outcome == FOUND
    assert A @ z == pytest.approx(A @ nnls(A, b)[0], abs=1e-8)


# --- problems of contacts


def edge(mu: float) -> tuple[float, float]:
    return (0.0, 1.0) if math.isinf(mu) else (1 / math.hypot(1, mu), mu / math.hypot(1, mu))


def stack(
    random: np.random.Generator, masses: float, decades: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Delassus matrix, free velocities and cones of blocks, corners often repeated.

    Masses and friction over that many decades to either side.
    """
    blocks = int(random.integers(1, 6))
    mass = 10.0 ** random.uniform(-masses, masses, blocks)
    size = 10.0 ** random.uniform(-0.5, 0.5, blocks)
    inverse = 1.0 / np.repeat(mass, 3)
    inverse[2::3] /= size**2 * 10.0 ** random.uniform(-1, 0, blocks)
    rows, cones = [], []
    for upper in range(blocks):
        for _ in range(int(random.integers(1, 5))):
            lower = int(random.integers(-1, upper)) if upper else -1
            angle = random.choice([0.0, 0.0, 0.0, random.uniform(0, 2 * math.pi)])
            t = np.array([math.cos(angle), math.sin(angle)])
            for n in (np.array([-t[1], t[0]]), t):
                row = np.zeros(3 * blocks)
                x, y = size[upper] * random.choice([-1.0, 1.0]), -size[upper]
                row[3 * upper : 3 * upper + 3] = *n, x * n[1] - y * n[0]
                if lower >= 0:
                    x, y = size[lower] * random.choice([-1.0, 0.5, 1.0]), size[lower]
                    row[3 * lower : 3 * lower + 3] = *-n, y * n[0] - x * n[1]
                rows.append(row)
            slope = 10.0 ** random.uniform(-decades, decades)
            cones.append(edge(random.choice([0.0, math.inf, 1.0, slope, slope, slope])))
    jacobian = np.array(rows)
    velocity = random.normal(size=3 * blocks) * random.choice([0.0, 1.0, 1.0], size=3 * blocks)
    return (
        (jacobian * inverse) @ jacobian.T,
        (jacobian @ velocity).reshape(-1, 2),
        np.array(cones),
    )


@pytest.mark.parametrize(("masses", "decades"), [(0, 1), (3, 1), (0, 12)])
def test_stacks_are_solved_or_reported_unsolved(masses: float, decades: float) -> None:
    random = np.random.default_rng(6)
    unsolved = 0
    for _ in range(600):
        delassus, free, cones = stack(random, masses, decades)
        nothing, none = np.zeros_like(free), np.zeros(len(cones), np.bool_)
        contacts, island = impact_problem(delassus, free, free, nothing, cones, none)
        missed, P = coordinate_impulses(contacts, island, 1e-9)[0], island.chosen
        if missed > 1e-9:
            unsolved += 1
            continue
        cut = np.maximum(cones[:, 0], 2.0**-12)
        assert (P[:, 0] >= 0.0).all()
        slack = cones[:, 1] * P[:, 0] - cut * np.abs(P[:, 1])
        assert (slack >= -1e-9 * (cones[:, 1] * P[:, 0] + cut * np.abs(P[:, 1]))).all()
        # Plastic impulses never raise the energy.
        after = free + (delassus @ P.ravel()).reshape(-1, 2)
        terms = np.abs(P) * (np.abs(free) + (np.abs(delassus) @ np.abs(P).ravel()).reshape(-1, 2))
        assert (P * (free + after)).sum() <= 1e-8 * terms.sum()
    assert unsolved <= 3


@pytest.mark.parametrize("mu", [0.0, 1e-12, 0.5, 1e3, math.inf])
def test_impulses_hold_or_brake_a_block_on_doubled_corners(mu: float) -> None:
    cones = np.array([edge(mu)] * 4)
    # Four corners in a row, the outer ones doubled, a unit mass above them.
    places = np.array([-1.0, -1.0, 1.0, 1.0])
    rows = np.array([row for x in places for row in ([0.0, 1.0, x], [1.0, 0.0, 1.0])])
    delassus = rows @ np.diag([1.0, 1.0, 3.0]) @ rows.T
    for u in (0.0, 0.4):
        least = (rows @ [u, -1.0, 0.0]).reshape(4, 2)
        found, P = forces_by_lemke(delassus, least, cones, np.zeros(4))
        assert found
        assert P[:, 0].sum() == pytest.approx(1.0, abs=1e-10)
        assert P[:, 1].sum() == pytest.approx(-min(mu, u), abs=1e-10)
