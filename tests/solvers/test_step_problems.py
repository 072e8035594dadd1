"""The contact problem of a step against enumeration and an independent quadratic programme."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from contacts.solvers.contact_lcp import contact_problem
from contacts.solvers.contact_lcp_kernels import (
    RESIDUAL,
    UNKNOWNS,
    impulses_of,
    problem,
    solve_contacts,
    step_residual,
)
from contacts.solvers.lcp import enumerate_lcp
from contacts.solvers.step_impulses import AS_ASKED, solve_impacts
from contacts.time_stepping.chunk import widened


def random_problem(generator, contacts, bodies, friction):
    """Return (W, free, cones) of random contacts of free bodies in the plane."""
    rows = np.zeros((2 * contacts, 3 * bodies))
    for i in range(contacts):
        angle = generator.uniform(0, 2 * np.pi)
        for b in generator.choice(bodies, size=min(2, bodies), replace=False):
            arm = generator.normal(size=2)
            for d, turn in enumerate((0.0, -np.pi / 2)):
                u = np.array([np.cos(angle + turn), np.sin(angle + turn)])
                rows[2 * i + d, 3 * b : 3 * b + 3] = *u, arm[0] * u[1] - arm[1] * u[0]
    inverse = 10.0 ** generator.uniform(-2, 2, 3 * bodies)
    mu = 10.0 ** generator.uniform(-2, 1, contacts) if friction else np.zeros(contacts)
    cones = np.column_stack([1 / np.hypot(1, mu), mu / np.hypot(1, mu)])
    # What bodies can do: with restitution at contacts that oppose each other there need be no
    # solution, without it there always is one.
    free = (rows @ generator.normal(size=3 * bodies)).reshape(-1, 2)
    return (rows * inverse) @ rows.T, free, cones


@pytest.mark.parametrize("seed", range(60))
def test_the_solution_is_among_all_enumerated_ones(seed):
    generator = np.random.default_rng(seed)
    delassus, free, cones = random_problem(generator, 3, 2, friction=True)
    solved, z, _ = solve_contacts(delassus, free, cones, np.zeros(12, np.bool_), 500)
    z = z if solved else widened(delassus, free, cones, 1e-9)[0]
    assert step_residual(*problem(delassus, free, cones, np.zeros(len(cones))), z) <= RESIDUAL
    velocities = free.ravel() + delassus @ impulses_of(z).ravel()
    every = enumerate_lcp(*contact_problem(delassus, free, cones))
    found = []
    for one in every:
        impulses = np.column_stack([one.z[::4], one.z[1::4] - one.z[2::4]])
        found.append(free.ravel() + delassus @ impulses.ravel())
    assert min(np.abs(velocities - other).max() for other in found) <= 1e-6


@pytest.mark.parametrize("seed", range(60))
def test_without_friction_it_is_the_least_energy(seed):
    generator = np.random.default_rng(seed)
    delassus, free, cones = random_problem(generator, 5, 3, friction=False)
    solved, z, _ = solve_contacts(delassus, free, cones, np.zeros(20, np.bool_), 500)
    assert solved
    normal, right = delassus[::2, ::2], free[:, 0]
    root = np.linalg.cholesky(normal)
    best, _ = nnls(root.T, -np.linalg.solve(root, right), maxiter=1000)
    assert normal @ z[::4] == pytest.approx(normal @ best, rel=1e-6, abs=1e-8)


def test_a_problem_without_solution_says_so():
    # Two contacts that oppose each other, both made to part.
    delassus = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([1.0, 0.0]))
    least, cones = np.array([[-1.0, 0.0], [-1.0, 0.0]]), np.array([[1.0, 0.0]] * 2)
    _, solved, left = widened(delassus, least, cones, 1e-9)
    assert not solved
    assert left > 0.1


def test_restitution_is_not_given_back_where_the_plastic_impulses_are_not_known():
    # As restitution asks there are impulses; plastic ones there are none.
    delassus = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([1.0, 0.0]))
    before, free = np.array([[-1.0, 0.0], [1.0, 0.0]]), np.array([[-2.0, 0.0], [-1.0, 0.0]])
    wanted = np.array([[3.0, 0.0], [0.0, 0.0]])
    rebounds, nothing = np.array([True, False]), np.zeros(2 * UNKNOWNS, dtype=bool)
    good, _, _, _, unsolved = solve_impacts(
        delassus, np.zeros(2, np.int64), before, free, wanted, np.array([[1.0, 0.0]] * 2), rebounds,
        nothing, np.zeros(0), AS_ASKED,
    )  # fmt: skip
    assert not good
    assert unsolved[:, 0].tolist() == [-2.0, -1.0]
