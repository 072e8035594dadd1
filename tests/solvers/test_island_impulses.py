"""Impulses of an island against closed forms: stabilisation of penetration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from batches import contact_rows

from contacts.solvers.island_impulses import island_impulses
from statechart.kernels.jit import kernel


@kernel
def found(contacts, before, free, wanted, rebounds, impulses, allowed, bound):
    """Call a function from Python that only kernels call."""
    return island_impulses(
        contacts, before, free, wanted, rebounds, impulses, allowed, bound, False
    )


def pushed(mass, fall, back, bound):
    """Return the impulse on a disc at rest on the ground, which gravity makes as fast as `fall`.

    It is to be sent back out of the ground.
    """
    rows = np.zeros((1, 2, 6))
    rows[0, 0, 1], rows[0, 1, 0], rows[0, 1, 2] = 1.0, 1.0, 1.0
    columns = rows * (np.array([1.0, 1.0, 2.0, 0.0, 0.0, 0.0]) / mass)
    contacts = contact_rows(np.array([[0, 1]]), 1, rows, columns, np.array([[1.0, 0.5]]))
    free, wanted = np.array([[-fall, 0.0]]), np.array([[-back, 0.0]])
    impulses, rest = np.zeros((1, 2)), np.zeros((1, 2))
    left, _, _ = found(contacts, rest, free, wanted, np.array([False]), impulses, 1e-6, bound)
    assert left <= 1e-6
    return impulses[0].tolist()


@pytest.mark.parametrize("mass", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("fall", [1e-3, 1.0])
def test_push_out_of_penetration_is_limited_by_the_energy_bound(mass, fall):
    """A speed u takes the work m u (u + v) / 2, at most m v^2 / 8."""
    speed = 0.5 * (math.sqrt(2.0) - 1.0) * fall
    expected = [mass * (fall + speed), 0.0]
    assert pushed(mass, fall, 0.5 * fall, mass * fall**2 / 8.0) == pytest.approx(expected, rel=1e-9)


def test_push_out_within_the_bound_is_complete_and_without_a_bound_absent():
    assert pushed(2.0, 1.0, 0.2, 0.25) == pytest.approx([2.4, 0.0], rel=1e-12)
    assert pushed(2.0, 1.0, 0.5, 0.0) == pytest.approx([2.0, 0.0], rel=1e-6)


@pytest.mark.parametrize("mass", [1e-3, 1e-2, 0.3])
def test_approaches_below_round_off_have_no_residual(mass):
    """The impulse that would stop it has a digit or two, and was 8 % off."""
    assert pushed(mass, 1.012e-320, 0.0, 1.0)[0] == pytest.approx(0.0, abs=1e-300)
