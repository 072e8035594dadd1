"""Shared forces that trade places: one vanishes as another leaves its cone's edge."""

from __future__ import annotations

import numpy as np
import pytest

import statechart
from contacts.solvers.smallest_forces import APEX, INSIDE, LOWER, UPPER, smallest_forces
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

# A box that just fits under a lid is pushed along the floor and lifted ever more. The forces
# of floor and lid are undetermined: friction could always hold it by unphysical preload.
_BOX = """
kind: scene
name: box_under_a_lid
gravity: 10
bodies: {box: {mass: 2, inertia: 1, start: {y: 1}}}
surfaces: {floor: {height: 0}, lid: {line: [[2, 2], [-2, 2]]}}
contacts:
  A: {point: {body: box, at: [-1, -1]}, surface: floor, friction: 0.3, restitution: 0}
  B: {point: {body: box, at: [1, -1]}, surface: floor, friction: 0.3, restitution: 0}
  C: {point: {body: box, at: [0, 1]}, surface: lid, friction: 0.3, restitution: 0}
forces:
  push: {body: box, at: [0, -1], force: [4*time, 0]}
  lift: {body: box, force: [0, 10*time]}
stop: {time: 4}
outputs:
  slip: {value: time, at: first A.slip}
  lift: {value: time, at: first B.liftoff}
  x: {value: box.x}
  A: {value: A.V}
  C: {value: C.V}
"""
# At time 3 the smallest forces leave B, and C comes off its edge.
_REACH = np.array(
    [[[0, 1, -1], [1, 0, 1]], [[0, 1, 1], [1, 0, 1]], [[0, -1, 0], [-1, 0, 1]]], dtype=float
)


@pytest.mark.parametrize(
    ("engine", "step", "error"),
    [("taylor", None, 1e-10), ("scipy", None, 1e-10), ("impulse", 1e-3, 2e-3)],
)
def test_a_box_under_a_lid_slips_as_it_is_lifted(
    engine: str, step: float | None, error: float
) -> None:
    # On the floor alone 2 a = 4t - 0.3 (20 - 10t); from 26/17 on the lid is pressed, too, and by
    # its moments A = 7t - 6, C = 17t - 26, so that 2 a = 4t - 0.3 (24t - 32).
    result = statechart.run(interpret(read_text(_BOX, "box.yaml")), engine=engine, step=step)
    slip, lift, end = 6 / 7, 26 / 17, 4.0
    first = np.polynomial.Polynomial([-3.0, 3.5])
    then = np.polynomial.Polynomial([4.8, -1.6])
    speed = first.integ(lbnd=slip)
    later = then.integ(lbnd=lift) + speed(lift)
    x = speed.integ(lbnd=slip)(lift) + later.integ(lbnd=lift)(end)
    wanted = {"slip": slip, "lift": lift, "x": x, "A": 22.0, "C": 42.0}
    assert result.outputs == pytest.approx(wanted, rel=error)


@pytest.mark.parametrize("past", [1e-9, 1e-10, 1e-11, 3e-12])
@pytest.mark.parametrize("inward", [0.0, 1e-12])
def test_load_sharing_finds_zones_on_both_sides(past: float, inward: float) -> None:
    edges = np.full((3, 3), [1.0, 0.3, np.inf]) / np.hypot(1.0, 0.3)
    for t, wanted in ((3.0 - past, [LOWER, LOWER, UPPER]), (3.0 + past, [LOWER, APEX, INSIDE])):
        load = np.array([-4.0 * t, 20.0 - 10.0 * t, -4.0 * t])
        found, forces, zones, violation = smallest_forces(edges, np.zeros(3), _REACH, load, inward)
        assert found
        assert violation <= 0.0
        assert zones.tolist() == wanted
        assert np.einsum("gdi,gd->i", _REACH, forces) == pytest.approx(load, abs=1e-12)


# A body wedged between three surfaces. From the time that c1 comes to its edge another mode, in
# which only c2 bears, is consistent, too. The run must stay in its mode.
_WEDGED = """
kind: scene
name: wedged
bodies: {b: {mass: 1, inertia: 0.5}}
surfaces:
  s0: {line: [[-0.5908161780858294, 0.6987897434705239], [-0.6891838219141706, -1.298789743470524]]}
  s1: {line: [[1.79, 0.72], [-0.21, 0.72]]}
  s2: {line: [[0, -2], [0, 0]]}
contacts:
  c0: {point: {body: b, at: [-0.64, -0.3]}, surface: s0, friction: 0.3, restitution: 0}
  c1: {point: {body: b, at: [0.79, 0.72]}, surface: s1, friction: 2, restitution: 0}
  c2: {point: {body: b, at: [0, -1]}, surface: s2, friction: 2, restitution: 0}
forces:
  f:
    body: b
    force: [-0.809 + 7.775*time, -0.468 + 1.84*time]
    moment: 8.207 - 6.213*time
stop: {time: 1}
"""
# The zones change twice within 5e-7, and a margin moves 35 times as much as the forces.
_STEEP = """
kind: scene
name: steep
bodies: {b: {mass: 1, inertia: 0.5}}
surfaces:
  s0: {line: [[-1, -2], [-1, 0]]}
  s1: {line: [[-2, 1], [0, 1]]}
  s2: {line: [[-1, 0], [1, 0]]}
  s3: {line: [[-0.57, 1.59], [-0.57, -0.41]]}
contacts:
  c0: {point: {body: b, at: [-1, -1]}, surface: s0, friction: 0.3, restitution: 0}
  c1: {point: {body: b, at: [-1, 1]}, surface: s1, friction: 0.5, restitution: 0}
  c2: {point: {body: b, at: [0, 0]}, surface: s2, friction: 0.3, restitution: 0}
  c3: {point: {body: b, at: [-0.57, 0.59]}, surface: s3, friction: 2, restitution: 0}
forces:
  f:
    body: b
    force: [0.563 + 6.098*time, -6.786 + 4.567*time]
    moment: 7.355 - 0.643*time
stop: {time: 1}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("text", [_WEDGED, _STEEP], ids=["wedged", "steep"])
def test_mode_continues_while_some_forces_in_the_cones_explain_it(text: str, engine: str) -> None:
    result = statechart.run(interpret(read_text(text, "scene.yaml")), engine=engine)
    assert not result.trace.jumps
    assert {*result.trace.modes[0]} == {"pin"}
    assert len(result.trace.arcs) > 1
