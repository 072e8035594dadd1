"""The contact problem of a step against enumeration and an independent quadratic programme."""

from __future__ import annotations

import numpy as np
import pytest
from complementarity import every_impulses, impact_problem
from scipy.optimize import nnls

from contacts.solvers.contact_rows import BEGINS, ON_TRIAL
from contacts.solvers.step_impulses import (
    TWO,
    change_friction,
    coordinate_impulses,
    coordinate_rows,
    new_island,
)
from statechart.kernels.jit import kernel


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
    # Velocities that bodies can have. With restitution, opposed contacts may have no solution;
    # without it one always exists.
    free = (rows @ generator.normal(size=3 * bodies)).reshape(-1, 2)
    return (rows * inverse) @ rows.T, free, cones


def solved_at_once(delassus, least, cones):
    """Return the residual and the impulses of contacts that ask for no restitution."""
    nothing = np.zeros_like(least)
    none = np.zeros(len(cones), np.bool_)
    contacts, island = impact_problem(delassus, least, least, nothing, cones, none)
    missed, softened = coordinate_impulses(contacts, island, 1e-9)
    assert not softened
    return missed, island.chosen


@pytest.mark.parametrize("seed", range(60))
def test_the_solution_is_among_all_enumerated_ones(seed):
    generator = np.random.default_rng(seed)
    delassus, free, cones = random_problem(generator, 3, 2, friction=True)
    missed, impulses = solved_at_once(delassus, free, cones)
    assert missed <= 1e-9
    velocities = free.ravel() + delassus @ impulses.ravel()
    found = [free.ravel() + delassus @ one.ravel() for one in every_impulses(delassus, free, cones)]
    assert min(np.abs(velocities - other).max() for other in found) <= 1e-6


@pytest.mark.parametrize("seed", range(60))
def test_frictionless_impulses_minimise_the_energy(seed):
    generator = np.random.default_rng(seed)
    delassus, free, cones = random_problem(generator, 5, 3, friction=False)
    missed, impulses = solved_at_once(delassus, free, cones)
    assert missed <= 1e-9
    normal, right = delassus[::2, ::2], free[:, 0]
    root = np.linalg.cholesky(normal)
    best, _ = nnls(root.T, -np.linalg.solve(root, right), maxiter=1000)
    assert normal @ impulses[:, 0] == pytest.approx(normal @ best, rel=1e-6, abs=1e-8)


def test_a_problem_without_solution_is_reported():
    # Two contacts that oppose each other, both made to part.
    delassus = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([1.0, 0.0]))
    least, cones = np.array([[-1.0, 0.0], [-1.0, 0.0]]), np.array([[1.0, 0.0]] * 2)
    missed, _ = solved_at_once(delassus, least, cones)
    assert missed > 0.1


def test_restitution_is_omitted_if_plastic_impulses_are_undetermined():
    # Impulses exist for the velocities of restitution, but not for plastic ones.
    delassus = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([1.0, 0.0]))
    before, free = np.array([[-1.0, 0.0], [1.0, 0.0]]), np.array([[-2.0, 0.0], [-1.0, 0.0]])
    wanted, rebounds = np.array([[3.0, 0.0], [0.0, 0.0]]), np.array([True, False])
    cones = np.array([[1.0, 0.0]] * 2)
    contacts, island = impact_problem(delassus, before, free, wanted, cones, rebounds)
    missed, _ = coordinate_impulses(contacts, island, 1e-9)
    impulses = island.chosen.ravel()
    after = free.ravel() + delassus @ impulses
    assert missed > 1e-9 or 0.5 * impulses @ (before.ravel() + after) <= 1e-9


@kernel
def switched(contacts, island):
    """Call a function from Python that only kernels call."""
    return change_friction(contacts, island, 1e-12, False)


@pytest.mark.parametrize(("share", "sticks"), [(0.9, True), (1.0, False)])
def test_static_friction_on_trial_holds_a_contact_inside_its_cone(share, sticks):
    """The slip of a force inside the cone is the residual of the impulses, at the edge a slip."""
    cone = np.array([[1.0, 0.6]])
    contacts = coordinate_rows(np.eye(2)[None], np.eye(2), np.zeros(1), cone)
    still = np.zeros((1, 2))
    island = new_island(np.zeros(1, np.int64), still - 1e-3, still, still.copy())
    island.kinds[0], island.slip_directions[0] = TWO, ON_TRIAL
    island.frictions[0] = [[1.0, 0.6], [1.0, 0.3], [1.0, 0.3]]
    island.chosen[0], island.after[0] = (1.0, -share * 0.6), (0.0, 1e-9)
    assert switched(contacts, island)
    assert island.slip_directions[0] == (0 if sticks else BEGINS)
