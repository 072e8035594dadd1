"""Contacts that stay off, as a point is inside the surface that should take over."""

from __future__ import annotations

import math

import pytest
from scipy.special import ellipk

from contacts.scene.lint import nearly_meeting_ends
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

STEPS = pytest.mark.parametrize("step", [None, 1e-3, 1e-4])


def planks(begin=0.0, rise=1e-6, until=1.0):
    """Return a puck that slides from a plank, which ends at 0, to another one."""
    return f"""
kind: scene
name: planks
gravity: 9.81
bodies: {{puck: {{mass: 1, start: {{x: -0.5, dx: 2}}}}}}
surfaces:
  a: {{edge: [[-2, 0], [0, 0]]}}
  b: {{edge: [[{begin}, {rise}], [3, {rise}]]}}
contacts:
  on_a: {{point: {{body: puck}}, surface: a, friction: 0.05, restitution: 0}}
  on_b: {{point: {{body: puck}}, surface: b, friction: 0.05, restitution: 0}}
stop: {{time: {until}}}
"""


def run(text, step=None):
    """Return (height at the end, warnings of contacts that stay off)."""
    options = {} if step is None else {"engine": "impulse", "step": step}
    result = Runner(interpret(read_text(text)), **options).run()
    return result.trace.final[1], [w for w in result.warnings if "stays off" in w]


@STEPS
@pytest.mark.parametrize(
    ("begin", "rise"),
    [(0.0, 1e-6), (0.0, 1e-4), (-0.1, 1e-6), (1e-3, 0.0)],
)
def test_a_warning_reports_the_depth_of_a_point_below_the_next_edge(begin, rise, step):
    height, reported = run(planks(begin, rise), step)
    assert height < -0.5
    assert len(reported) == 1
    assert reported[0].startswith("on_b stays off: its point is ")
    # Over the gap of 1 mm it falls by g (begin/v)^2/2.
    depth = float(reported[0].split()[6])
    fallen = 0.5 * 9.81 * (max(begin, 0.0) / 1.875) ** 2
    assert depth == pytest.approx(rise + fallen, abs=1e-8 if step is None else 0.02 * step)


@STEPS
@pytest.mark.parametrize(("begin", "rise"), [(0.0, 0.0), (0.0, -1e-4), (-0.1, -1e-3)])
def test_a_point_that_meets_the_next_edge_has_no_warning(begin, rise, step):
    height, reported = run(planks(begin, rise), step)
    assert height == pytest.approx(rise, abs=1e-9 if step is None else 0.2 * step)
    assert reported == []


@STEPS
def test_points_far_below_an_edge_give_no_warning(step):
    _, reported = run(planks(0.1, 0.3), step)
    assert reported == []


@STEPS
def test_gaps_between_ground_pieces_give_a_warning(step):
    text = """
kind: scene
name: pieces
gravity: 9.81
bodies: {puck: {mass: 1, start: {x: -0.5, dx: 2}}}
surfaces: {a: {height: 0}, b: {height: 1e-5 + 0.1*x}}
contacts:
  on_a: {point: {body: puck}, surface: a, friction: 0, modes: [free, slide], restitution: 0,
         enabled: puck.x <= 0}
  on_b: {point: {body: puck}, surface: b, friction: 0, modes: [free, slide], restitution: 0,
         enabled: puck.x >= 0}
stop: {time: 0.6}
"""
    _, reported = run(text, step)
    assert len(reported) == 1
    assert "on_b stays off" in reported[0]
    assert "below the surface b when its conditions become true" in reported[0]


@STEPS
def test_scuffing_foot_gives_no_warning(step):
    text = """
kind: scene
name: scuffing
coordinates: {q: {start: 1e-5, rate: -0.1}}
bodies: {foot: {mass: 1, position: [0, q]}}
surfaces: {ground: {height: 0}}
contacts:
  c: {point: {body: foot}, surface: ground, friction: 0, modes: [free, slide], restitution: 0,
      enabled: time >= 0.005}
forces: {lift: {body: foot, force: [0, 1]}}
stop: {time: 1}
"""
    height, reported = run(text, step)
    assert height > 0.1
    assert reported == []


@pytest.mark.parametrize(
    ("begin", "rise", "meets"), [(0, 1e-6, False), (1e-4, 0, False), (0, 0, True), (0, 0.1, True)]
)
def test_validation_reports_ends_of_edges_that_nearly_meet(begin, rise, meets):
    scene = interpret(read_text(planks(begin, rise)))
    reported = list(nearly_meeting_ends(scene))
    assert bool(reported) != meets
    assert all("surfaces.b.edge: its first point is" in one for one in reported)
    runner = Runner(scene)
    assert bool([w for w in runner.start()[1] if "nearly" in w or ".edge:" in w]) != meets


ONE_WAY = """
kind: scene
name: one_way
gravity: 9.81
bodies: {hero: {mass: 60, start: {dy: 6}}}
surfaces: {ground: {height: 0}, platform: {height: 1}}
contacts:
  feet: {point: {body: hero}, surface: ground, friction: 0.5, restitution: 0}
  soles: {point: {body: hero}, surface: platform, friction: 0.5, restitution: 0, enabled: WHEN}
stop: {time: 1.1}
"""


@pytest.mark.parametrize(
    ("when", "count"),
    [
        ("hero.dy <= 0 and hero.y >= 1", 1),
        ("hero.dy <= 0 and hero.y >= 0.9", 0),
        ("hero.dy <= 0", 0),
        ("hero.dy <= 0 and time < 1.024", 0),
    ],
)
@STEPS
def test_contact_disabled_at_touch_gives_a_warning(when, count, step):
    options = {} if step is None else {"engine": "impulse", "step": step}
    result = Runner(interpret(read_text(ONE_WAY.replace("WHEN", when))), **options).run()
    warned = [w for w in result.warnings if "soles goes off at t = 1.02418" in w]
    assert len(warned) == count
    # It falls through the platform, or stands on it.
    landed = any(
        jump.region == "soles" and jump.cause == "touchdown" for jump in result.trace.jumps
    )
    assert landed == ("0.9" in when or when == "hero.dy <= 0")


@pytest.mark.parametrize("gap", [1e-12, 1e-9])
def test_a_point_that_falls_between_an_arc_and_an_edge_has_a_warning(gap):
    scene = f"""
kind: scene
name: loop
gravity: 9.81
bodies: {{ball: {{mass: 1, start: {{x: X, y: 0.5}}}}}}
parameters: {{X: 0}}
surfaces:
  bowl: {{circle: [0, 1], radius: 1, hollow: true}}
  floor: {{edge: [[-3, 0], [{-gap}, 0]]}}
contacts:
  arc:
    point: {{body: ball}}
    surface: bowl
    friction: 0
    restitution: 0
    enabled: ball.x > 0 and ball.y < 0.9
  flat: {{point: {{body: ball}}, surface: floor, friction: 0, restitution: 0}}
stop: {{time: 1}}
"""
    runner = Runner(interpret(read_text(scene)))
    for x, falls in ((0.0, True), (-2 * gap, False), (gap, False), (-0.1, False), (0.1, False)):
        result = runner.run({"X": x})
        warned = [w.split()[0] for w in result.warnings if "just fail" in w]
        assert bool(result.trace.final[1] < -1) is falls
        assert bool(warned) is falls, (x, warned)


# A puck runs from a floor into a bowl, turns round, and comes back to the floor at the time at
# which it is at rest above the seam, later by a swing of a pendulum and a way of L.
HALF_PIPE = """
kind: scene
name: half_pipe
parameters: {R: 1, L: 1, v: 3}
gravity: 9.81
bodies: {puck: {mass: 1, start: {dx: v}}}
surfaces:
  flat: {height: 0}
  bowl: {circle: [L, R], radius: R, hollow: true}
contacts:
  a: {point: {body: puck}, surface: flat, friction: 0, restitution: 0, enabled: puck.x <= L}
  b: {point: {body: puck}, surface: bowl, friction: 0, restitution: 0, enabled: puck.x > L}
stop: {time: 3}
outputs:
  leaves: {value: time, at: first b.enable or a.disable}
  returns: {value: time, at: first a.enable or b.disable}
  rests: {value: time, at: first a.slide}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("v", [1.1, 2.3, 3.0, 3.7])
def test_the_next_surface_takes_over_at_once_whatever_the_round_off_of_its_gap(engine, v):
    result = Runner(interpret(read_text(HALF_PIPE)), engine=engine).run({"v": v})
    # The quarter of a period of a pendulum of length 1 with the speed v at its lowest place.
    swing = 2 * ellipk(v**2 / (4 * 9.81)) / 9.81**0.5
    assert result.outputs["leaves"] == pytest.approx(1 / v, abs=1e-12)
    assert result.outputs["returns"] == pytest.approx(1 / v + swing, abs=1e-10)
    assert result.outputs["rests"] == pytest.approx(result.outputs["returns"], abs=1e-12)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_no_warning_of_a_contact_that_another_surface_hands_over_to(engine, tolerance):
    # The error of the run leaves the point slightly inside the floor at the seam.
    scene = interpret(read_text(HALF_PIPE))
    result = Runner(scene, engine=engine, tolerance=tolerance).run(until=1.5)
    assert result.outputs["rests"] is not None
    assert result.warnings == ()


PEG = """
kind: scene
name: peg
parameters: {L: 1, d: 0.6, swing: 1.2}
gravity: 9.81
bodies: {bob: {mass: 1, start: {x: -L*sin(swing), y: -L*cos(swing)}}}
joints:
  long: {point: {body: bob}, to: [0, 0], rope: L, enabled: bob.x <= 0}
  short: {point: {body: bob}, to: [0, -d], rope: L - d, enabled: bob.x > 0}
stop: {time: 0.7}
outputs:
  caught: {value: time, at: first long.disable}
  taut: {value: time, at: first short.slide}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize(("peg", "swing"), [(0.6, 1.2), (0.5, 0.9), (0.7, 1.3)])
def test_a_peg_takes_over_the_rope_of_a_pendulum_at_once(engine, peg, swing):
    scene = interpret(read_text(PEG))
    outputs = Runner(scene, engine=engine).run({"d": peg, "swing": swing}).outputs
    quarter = ellipk(math.sin(swing / 2) ** 2) / 9.81**0.5
    assert outputs["caught"] == pytest.approx(quarter, abs=1e-11)
    assert outputs["taut"] == pytest.approx(outputs["caught"], abs=1e-12)


@STEPS
def test_a_point_that_stops_at_the_foot_of_a_wall_has_no_warning(step):
    # Down a slope, against a wall that ends at its foot.
    text = """
kind: scene
name: foot
gravity: 9.81
bodies: {p: {mass: 1, start: {x: -0.5*cos(0.4), y: 0.5*sin(0.4)}}}
surfaces: {slope: {edge: [[-cos(0.4), sin(0.4)], [0, 0]]}, wall: {edge: [[0, 0], [0, 1]]}}
contacts:
  on_slope: {point: {body: p}, surface: slope, friction: 0, restitution: 0}
  on_wall: {point: {body: p}, surface: wall, friction: 0, restitution: 0}
stop: {time: 1}
outputs: {hits: {value: time, at: first on_wall.touchdown}}
"""
    options = {} if step is None else {"engine": "impulse", "step": step}
    result = Runner(interpret(read_text(text)), **options).run()
    assert not result.warnings
    # 1/2 g sin(a) t^2 = 1/2
    fall = 1.0 / math.sqrt(9.81 * math.sin(0.4))
    assert result.outputs["hits"] == pytest.approx(fall, abs=1e-12 if step is None else step)
    assert result.trace.final[:2] == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(("up", "falls"), [(True, False), (False, True)])
def test_a_warning_names_a_corner_through_which_a_point_may_fall(up, falls):
    # Off the tip of a tooth upwards, or to the bottom of a groove where both sides end.
    slope, beyond = (0.4, -3.0) if up else (-0.4, 0.4)
    conditions = "p.x <= 0", f"p.x >= 0 and p.y {'<= 0' if up else '>= 1e-6'}"
    text = f"""
kind: scene
name: corner
gravity: 9.81
bodies: {{p: {{mass: 1, start: {{x: -0.5, y: {-0.5 * slope}, dx: 3, dy: {3 * slope}}}}}}}
surfaces: {{a: {{height: {slope}*x}}, b: {{height: {beyond}*x}}}}
contacts:
  on_a: {{point: {{body: p}}, surface: a, friction: 0, restitution: 0, enabled: "{conditions[0]}"}}
  on_b: {{point: {{body: p}}, surface: b, friction: 0, restitution: 0, enabled: "{conditions[1]}"}}
stop: {{time: 0.5}}
"""
    result = Runner(interpret(read_text(text))).run()
    assert any("may fall through" in warning for warning in result.warnings) == falls


def test_a_pin_leaves_the_open_end_of_a_slot_without_a_warning():
    # A Geneva drive: the pin turns the wheel by a quarter, and leaves its slot tangentially.
    text = """
kind: scene
name: geneva
parameters: {w: 2, d: sqrt(2), q: -pi/4 - 0.5}
bodies:
  pin: {mass: 0.01, start: {x: d - cos(q), y: sin(q), dx: w*sin(q), dy: w*cos(q)}}
  wheel: {mass: 1, inertia: 0.3, start: {angle: -pi/4}}
joints:
  drive: {point: {body: pin}, to: [d - cos(q + w*time), sin(q + w*time)]}
  axle: {point: {body: wheel}, to: [0, 0]}
surfaces:
  up: {edge: [[0.2, 0], [1, 0]], body: wheel}
  low: {edge: [[1, 0], [0.2, 0]], body: wheel}
contacts:
  a: {point: {body: pin}, surface: up, friction: 0, restitution: 0}
  b: {point: {body: pin}, surface: low, friction: 0, restitution: 0}
stop: {time: 1.6}
outputs: {left: {value: time, at: last a.disable or b.disable}, fastest: {maximum: wheel.dangle}}
"""
    result = Runner(interpret(read_text(text))).run()
    assert not any("may fall through" in warning for warning in result.warnings)
    final = dict(zip(result.trace.variables, result.trace.final.tolist(), strict=True))
    assert final["wheel.angle"] == pytest.approx(math.pi / 4, abs=1e-12)
    assert final["wheel.dangle"] == pytest.approx(0.0, abs=1e-12)
    assert result.outputs["left"] == pytest.approx(0.25 + math.pi / 4, abs=1e-12)
    assert result.outputs["fastest"] == pytest.approx(2.0 / (math.sqrt(2) - 1.0), abs=1e-9)


GATED = """
kind: scene
name: gated
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 1e6}}}
surfaces: {floor: {height: 0}}
contacts:
  b: {point: {body: ball}, surface: floor, friction: 0, restitution: 0, enabled: in(leg.down)}
regions: {leg: {initial: up, states: {up: {}, down: {}}}}
stop: {time: 500}
"""


def test_a_contact_of_another_state_gives_no_warning_in_a_large_scene():
    height, reported = run(GATED)
    assert height == pytest.approx(1e6 - 0.5 * 9.81 * 500**2)
    assert not reported
