"""Bodies that touch where nothing pulls: a rack of discs seen from above, struck by another."""

from __future__ import annotations

import math

import numpy as np
import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

R, SPEED = 0.03, 5.0
SCENE = """
kind: scene
name: table
bodies:
{bodies}
collisions:
  all: {{bodies: [{names}], friction: 0, restitution: {e}}}
simultaneous: {law}
stop: {{time: 0.1}}
settings: {{engine: impulse, step: 1e-3, impulse_tolerance: {tolerance}}}
"""


def struck(places, x0, e, y0=0.0, tolerance=1e-10, law="capped"):
    """Return the velocities (n + 1, 2) of discs, the last of which strikes, and the warnings.

    The warning of the law, which all these scenes cause, is left out.
    """
    starts = [f"x: {x!r}, y: {y!r}" for x, y in places] + [f"x: {x0!r}, y: {y0!r}, dx: {SPEED}"]
    bodies = "\n".join(
        f"  d{k}: {{mass: 1, inertia: 1, shape: {{disc: {R}}}, start: {{{start}}}}}"
        for k, start in enumerate(starts)
    )
    names = ", ".join(f"d{k}" for k in range(len(starts)))
    text = SCENE.format(bodies=bodies, names=names, e=e, tolerance=tolerance, law=law)
    result = Runner(interpret(read_text(text))).run()
    reported = [
        warning for warning in result.warnings if "resolves these impacts together" not in warning
    ]
    return result.trace.final.reshape(2, -1, 3)[1, :, :2], reported


@pytest.mark.parametrize("x", [0.0, 0.1, 7.3])
@pytest.mark.parametrize("count", [3, 5])
def test_a_row_that_touches_is_hit_as_one_wherever_it_stands(x, count):
    """Moreau's law: the row parts from what strikes it as fast as that came, and stays one."""
    row = [(x + 2 * R * k, 0.0) for k in range(count)]
    speeds, warnings = struck(row, x - 0.3, 1)
    assert not warnings
    row_speed = 2 * SPEED / (count + 1)
    wanted = [row_speed] * count + [row_speed - SPEED]
    np.testing.assert_allclose(speeds[:, 0], wanted, atol=1e-6)


@pytest.mark.parametrize("law", ["capped", "sequential"])
@pytest.mark.parametrize("e", [0.5, 0.9])
def test_rack_breaks_symmetrically_at_any_place(e, law):
    rows = [(row, 2 * j - row) for row in range(5) for j in range(row + 1)]
    found = []
    for x in (0.0, 3.7):
        rack = [(x + row * R * math.sqrt(3), side * R) for row, side in rows]
        speeds, warnings = struck(rack, x - 0.3, e, law=law)
        assert not warnings
        twins = [rows.index((row, -side)) for row, side in rows]
        np.testing.assert_allclose(speeds[twins, 0], speeds[:-1, 0], atol=1e-4)
        np.testing.assert_allclose(speeds[twins, 1], -speeds[:-1, 1], atol=1e-4)
        assert speeds.sum(0) == pytest.approx([SPEED, 0.0], abs=1e-9)
        assert float((speeds**2).sum()) < SPEED**2
        found.append(speeds)
    np.testing.assert_allclose(*found, atol=1e-4)


@pytest.mark.parametrize("depth", [1e-12, 1e-9, 1e-8])
def test_slightly_overlapping_discs_without_forces_stay_at_rest(depth):
    speeds, warnings = struck([(1.0, 0.0), (1.0 + 2 * R - depth, 0.0)], -9.0, 0)
    assert not warnings
    assert np.abs(speeds[:-1]).max() == 0.0


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-12])
@pytest.mark.parametrize("beside", [0.0072, 0.0144])
@pytest.mark.parametrize("law", ["capped", "sequential"])
def test_an_elastic_rack_conserves_energy_at_any_tolerance(beside, tolerance, law):
    """Round-off separates some discs in the step in which others rebound."""
    rows = [(row, 2 * j - row) for row in range(5) for j in range(row + 1)]
    rack = [(row * R * math.sqrt(3), side * R) for row, side in rows]
    speeds, warnings = struck(rack, -0.12, 1, beside, tolerance, law)
    assert not warnings
    assert (speeds**2).sum() == pytest.approx(SPEED**2, rel=10 * tolerance + 1e-12)
