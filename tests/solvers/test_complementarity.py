"""Linear complementarity: Lemke against enumeration, against convex optimisation, on contacts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import examples

from contacts.solvers import lcp
from contacts.solvers.contact_lcp import contact_impulses, contact_problem
from contacts.solvers.lcp import LcpSolution, LcpStatus, enumerate_lcp, solve_lcp


def error(matrix: np.ndarray, vector: np.ndarray, solution: LcpSolution) -> float:
    """Return how far z is from a solution, per row relative to the row's terms."""
    z, w = solution.z, matrix @ solution.z + vector
    terms = np.abs(matrix) @ z + np.abs(vector) + 1e-300
    assert (z >= 0.0).all()
    return float((np.where(z > 0.0, np.abs(w), -w) / terms).max())


def test_one_unknown() -> None:
    for m, q, z in ((2.0, -1.0, 0.5), (2.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)):
        found = solve_lcp(np.array([[m]]), np.array([q]))
        assert found.status is LcpStatus.SOLVED
        assert found.z.tolist() == [z]


def lemke_alone(matrix: np.ndarray, vector: np.ndarray) -> LcpSolution:
    """Solve without enumeration where Lemke's algorithm finds nothing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lcp, "_ENUMERATED_LAST", -1)
        return solve_lcp(matrix, vector)


@pytest.mark.parametrize("solve", [solve_lcp, lemke_alone])
def test_a_problem_without_solution_is_reported(
    solve: Callable[[np.ndarray, np.ndarray], LcpSolution],
) -> None:
    for m in (-1.0, 0.0):
        found = solve(np.array([[m]]), np.array([-1.0]))
        assert found.status is LcpStatus.RAY
        assert found.residual == 1.0
    assert enumerate_lcp(np.array([[-1.0]]), np.array([-1.0])) == ()


def test_all_solutions_are_found() -> None:
    # Two that are repelled by each other: either one alone, or both.
    matrix = np.array([[1.0, 2.0], [2.0, 1.0]])
    found = sorted(s.z.tolist() for s in enumerate_lcp(matrix, np.array([-1.0, -1.0])))
    assert found == [[0.0, 1.0], pytest.approx([1 / 3, 1 / 3]), [1.0, 0.0]]
    # m < 0 and q > 0, Painleve's indeterminate case: free, and a force without cause.
    found = sorted(s.z.tolist() for s in enumerate_lcp(np.array([[-0.5]]), np.array([1.0])))
    assert found == [[0.0], [2.0]]


def test_no_unknowns() -> None:
    found = solve_lcp(np.empty((0, 0)), np.empty(0))
    assert found.status is LcpStatus.SOLVED
    assert len(found.z) == 0


@pytest.mark.parametrize("size", [2, 5, 10])
def test_murtys_long_paths(size: int) -> None:
    # 1 on the diagonal, 2 below: Lemke's path visits up to 2^n bases from a bad start.
    matrix = np.eye(size) + 2.0 * np.tril(np.ones((size, size)), -1)
    vector = -(2.0 ** np.arange(size, 0, -1))
    found = lemke_alone(matrix, vector)
    expected = np.zeros(size)
    expected[0] = -vector[0]
    assert found.status is LcpStatus.SOLVED
    assert found.z == pytest.approx(expected)


def test_degenerate_ties_do_not_cycle() -> None:
    # Kostreva's example, on which Lemke's rule without lexicographic ties cycles.
    matrix = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])
    found = lemke_alone(matrix, -np.ones(3))
    assert found.status is LcpStatus.SOLVED
    assert found.z == pytest.approx([1 / 3, 1 / 3, 1 / 3])


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        solve_lcp(np.eye(2), np.ones(3))
    with pytest.raises(ValueError, match="finite"):
        solve_lcp(np.eye(2), np.array([1.0, math.nan]))
    with pytest.raises(ValueError, match="at most 16"):
        enumerate_lcp(np.eye(17), -np.ones(17))


def test_matrices_with_one_solution() -> None:
    random = np.random.default_rng(1)
    for _ in range(300):
        size = int(random.integers(1, 9))
        half = random.normal(size=(size, size))
        skew = random.normal(size=(size, size))
        matrix = half @ half.T + 0.1 * np.eye(size) + skew - skew.T
        vector = random.normal(size=size)
        all_of_them = enumerate_lcp(matrix, vector)
        found = lemke_alone(matrix, vector)
        assert len(all_of_them) == 1
        assert found.status is LcpStatus.SOLVED
        assert found.z == pytest.approx(all_of_them[0].z, rel=1e-9, abs=1e-11)


def test_the_solution_of_lemke_is_among_all_enumerated_ones() -> None:
    random = np.random.default_rng(2)
    counts = {True: 0, False: 0}
    for _ in range(500):
        size = int(random.integers(1, 7))
        # Whole numbers give ties, singular bases and several solutions.
        matrix = random.integers(-2, 3, (size, size)).astype(float)
        vector = random.integers(-2, 3, size).astype(float)
        all_of_them = enumerate_lcp(matrix, vector)
        for solution in all_of_them:
            assert error(matrix, vector, solution) <= 1e-12
        found = solve_lcp(matrix, vector)
        solved = found.status is LcpStatus.SOLVED
        counts[solved] += 1
        if solved:
            assert error(matrix, vector, found) <= 1e-9
        else:
            assert not all_of_them
    assert min(counts.values()) > 50


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
@examples(60)
def test_convex_problems_as_least_squares(size: int, seed: int) -> None:
    from scipy.optimize import nnls

    random = np.random.default_rng(seed)
    # Fewer rows than columns: many z, one A z.
    A = random.normal(size=(int(random.integers(1, size + 1)), size))
    b = random.normal(size=len(A))
    found = lemke_alone(A.T @ A, -A.T @ b)
    assert found.status is LcpStatus.SOLVED
    assert A @ found.z == pytest.approx(A @ nnls(A, b)[0], abs=1e-8)


def test_convex_problems_as_quadratic_programs() -> None:
    from scipy.optimize import minimize

    random = np.random.default_rng(4)
    for _ in range(20):
        size = int(random.integers(2, 12))
        half = random.normal(size=(size, size))
        matrix, vector = half @ half.T + np.eye(size), random.normal(size=size)
        found = solve_lcp(matrix, vector)
        best = minimize(
            lambda z, M=matrix, q=vector: 0.5 * z @ M @ z + q @ z,
            np.ones(size),
            jac=lambda z, M=matrix, q=vector: M @ z + q,
            bounds=[(0.0, None)] * size,
            method="SLSQP",
            options={"ftol": 1e-15, "maxiter": 500},
        )
        assert found.z == pytest.approx(best.x, abs=1e-6)
        assert 0.5 * found.z @ matrix @ found.z + vector @ found.z <= best.fun + 1e-13


def test_scales_do_not_matter() -> None:
    random = np.random.default_rng(5)
    for _ in range(50):
        size = int(random.integers(1, 12))
        half = random.normal(size=(size, size))
        matrix, vector = half @ half.T + 0.1 * np.eye(size), random.normal(size=size)
        rows, columns = np.ldexp(1.0, random.integers(-40, 40, (2, size)))
        plain = solve_lcp(matrix, vector)
        scaled = solve_lcp(rows[:, None] * matrix * columns, rows * vector)
        assert scaled.status is LcpStatus.SOLVED
        assert scaled.z * columns == pytest.approx(plain.z, rel=1e-9, abs=1e-12)


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
        matrix, vector = contact_problem(delassus, free, cones)
        found = solve_lcp(matrix, vector)
        if found.status is not LcpStatus.SOLVED:
            unsolved += 1
            continue
        assert error(matrix, vector, found) <= 1e-9
        P = contact_impulses(found.z, cones)
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
def test_a_block_at_rest_and_a_block_that_slides(mu: float) -> None:
    cones = np.array([edge(mu)] * 4)
    # Four corners in a row, the outer ones doubled, a unit mass above them.
    places = np.array([-1.0, -1.0, 1.0, 1.0])
    rows = np.array([row for x in places for row in ([0.0, 1.0, x], [1.0, 0.0, 1.0])])
    delassus = rows @ np.diag([1.0, 1.0, 3.0]) @ rows.T
    for u in (0.0, 0.4):
        matrix, vector = contact_problem(delassus, (rows @ [u, -1.0, 0.0]).reshape(4, 2), cones)
        found = solve_lcp(matrix, vector)
        P = contact_impulses(found.z, cones)
        assert found.status is LcpStatus.SOLVED
        assert P[:, 0].sum() == pytest.approx(1.0, abs=1e-10)
        assert P[:, 1].sum() == pytest.approx(-min(mu, u), abs=1e-10)
