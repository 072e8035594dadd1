"""Contacts that are hit together in a time step, against runs with events."""

from __future__ import annotations

import math

import numpy as np
import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G = 9.81
ORDER = "struck in several places at once"


def run(text, step=None):
    """Return a run with events, or by steps of a length."""
    options = {} if step is None else {"engine": "impulse", "step": step}
    return Runner(interpret(read_text(text)), **options).run()


def rates(result):
    """Return the rates of the coordinates at the end of a run."""
    return result.trace.final[len(result.trace.final) // 2 :]


def two_particles(forces, law="plastic", lies="friction: 0.3", joint=""):
    """Return a particle that lies, and one that falls on the floor 5 m beside it."""
    return f"""
kind: scene
name: two
gravity: {G}
bodies:
  lies: {{mass: 1, start: {{x: 5}}}}
  falls: {{mass: 1, start: {{y: 1}}}}
surfaces: {{s: {{height: 0}}}}
contacts:
  a: {{point: {{body: lies}}, surface: s, {lies}, restitution: 0, impact: moreau}}
  b: {{point: {{body: falls}}, surface: s, friction: 0.3, restitution: 0.5, impact: moreau}}
forces:
{forces}
{joint}
simultaneous: {law}
stop: {{time: 0.6}}
outputs: {{top: {{maximum: falls.dy}}}}
"""


def between(force):
    """Return a force between the two, upwards on the one that lies."""
    return (
        f"  f1: {{body: falls, force: [0, -({force})]}}\n  f2: {{body: lies, force: [0, {force}]}}"
    )


@pytest.mark.parametrize("law", ["plastic", "capped"])
@pytest.mark.parametrize(
    "force",
    [
        "0.01*(falls.dy - lies.dy)",
        "2*(falls.dy - lies.dy)",
        "3*(falls.y - lies.y) + 0.5*(falls.dy - lies.dy)",
    ],
)
def test_forces_do_not_couple_impacts(force, law):
    text = two_particles(between(force), law)
    exact = run(text).outputs["top"]
    assert exact > 1.0
    for step in (1e-3, 1e-4):
        assert run(text, step).outputs["top"] == pytest.approx(exact, abs=20.0 * step)


def dumbbell(law):
    """Return a bar with a particle jointed to its end, which lies on a foot there."""
    return f"""
kind: scene
name: dumbbell
gravity: {G}
bodies:
  bar: {{mass: 2, inertia: 0.3, start: {{x: 0, y: 0.4, angle: {math.asin(-0.4)}}}}}
  end: {{mass: 1, start: {{x: {math.cos(math.asin(0.4))}, y: 0}}}}
surfaces: {{s: {{height: 0}}}}
joints: {{j: {{point: {{body: end}}, to: {{body: bar, at: [1, 0]}}}}}}
contacts:
  middle: {{point: {{body: bar}}, surface: s, friction: 0.3, restitution: 0.5, impact: moreau}}
  foot: {{point: {{body: end}}, surface: s, friction: 0.3, restitution: 0, impact: moreau}}
simultaneous: {law}
stop: {{time: 0.5}}
outputs: {{top: {{maximum: bar.dy}}}}
"""


@pytest.mark.parametrize(("law", "rebounds"), [("plastic", False), ("capped", True)])
def test_joints_couple_impacts(law, rebounds):
    text = dumbbell(law)
    exact = run(text).outputs["top"]
    assert (exact > 0.5) == rebounds
    assert run(text, 1e-4).outputs["top"] == pytest.approx(exact, abs=5e-3)


def test_pinned_contact_shares_an_impact():
    # A bead on a wire, whose contact only slides, strikes a stop at the wire's end.
    text = """
kind: scene
name: bead
bodies: {bead: {mass: 1, start: {x: 0.1, dx: -1}}}
surfaces: {wire: {height: 0}, stop: {line: [[0, 1], [0, -1]]}}
contacts:
  wire: {point: {body: bead}, surface: wire, modes: [slide], friction: 0}
  stop: {point: {body: bead}, surface: stop, modes: [free, slide], friction: 0, restitution: 0.5}
simultaneous: LAW
stop: {time: 0.3}
"""
    for law, after in (("plastic", 0.0), ("capped", 0.5)):
        scene = text.replace("LAW", law)
        assert rates(run(scene))[0] == pytest.approx(after, abs=1e-12)
        assert rates(run(scene, 1e-3))[0] == pytest.approx(after, abs=1e-12)


def test_joint_is_not_a_struck_contact():
    text = f"""
kind: scene
name: ball_on_a_guide
gravity: {G}
bodies: {{ball: {{mass: 1, inertia: 0.01, shape: {{disc: 0.1}}, start: {{y: 0.6}}}}}}
surfaces: {{s: {{height: 0}}}}
joints: {{guide: {{point: {{body: ball}}, to: {{x: 0}}}}}}
collisions: {{c: {{bodies: [ball], surfaces: [s], friction: 0, restitution: 0.5}}}}
simultaneous: plastic
stop: {{time: 0.4}}
outputs: {{top: {{maximum: ball.dy}}}}
"""
    top = run(text, 1e-3).outputs["top"]
    assert top == pytest.approx(0.5 * math.sqrt(2.0 * G * 0.5), abs=1e-2)


def beads(radii, masses, restitution, law="capped", shift=0.0, height=0.05):
    """Return beads on top of each other that fall on a floor; rounding decides their gaps."""
    coordinates, bodies, surfaces, contacts, top = "", "", "", "", "s + h"
    for k, (radius, mass) in enumerate(zip(radii, masses, strict=True)):
        top += f" + {radius}" if k == 0 else f" + ({radii[k - 1]} + {radius})"
        coordinates += f"  q{k}: {{start: {top}}}\n"
        bodies += f"  b{k}: {{mass: {mass}, position: [0, q{k}]}}\n"
        below = f"s + {radius}" if k == 0 else f"{radii[k - 1]} + {radius}"
        surfaces += f"  t{k}: {{height: {below}{f', body: b{k - 1}' if k else ''}}}\n"
        contacts += (
            f"  c{k}: {{point: {{body: b{k}}}, surface: t{k}, modes: [free, slide], friction: 0, "
            f"restitution: {restitution}, impact: moreau}}\n"
        )
    until = 1.5 * math.sqrt(2.0 * height / G)
    return (
        f"kind: scene\nname: beads\nparameters: {{h: {height}, s: {shift}}}\ngravity: {G}\n"
        f"coordinates:\n{coordinates}bodies:\n{bodies}surfaces:\n{surfaces}"
        f"contacts:\n{contacts}simultaneous: {law}\nstop: {{time: {until}}}\n"
    )


@pytest.mark.parametrize("shift", [0.0, 1e3])
@pytest.mark.parametrize(
    ("radii", "masses", "restitution", "law"),
    [
        ([0.005] * 3, [1, 1, 1], 1, "capped"),
        ([2.0**-8] * 3, [1, 1, 1], 1, "capped"),
        ([0.0317, 0.0053, 0.0211, 0.0107], [0.3, 4.1, 0.9, 2.2], 1, "capped"),
        ([0.0317, 0.0053, 0.0211], [0.3, 4.1, 0.9], 0.5, "plastic"),
    ],
)
def test_beads_that_touch_fall_as_with_events_at_every_step(radii, masses, restitution, law, shift):
    text = beads(radii, masses, restitution, law, shift)
    exact = rates(run(text))
    for step in (1e-3, 1e-4):
        result = run(text, step)
        assert rates(result) == pytest.approx(exact, abs=30.0 * step)
        assert any(ORDER in w for w in result.warnings) == (law == "capped")


def test_bodies_that_fall_side_by_side_have_no_events():
    trace = run(beads([0.0071, 0.0466, 0.0215], [0.3, 4.1, 0.9], 1), 2e-4).trace
    fall = math.sqrt(2.0 * 0.05 / G)
    assert trace.jumps[0].t == pytest.approx(fall, abs=5e-4)


def cradle(gap):
    """Return three equal balls, the first of which runs into the others."""
    return f"""
kind: scene
name: cradle
coordinates: {{q0: {{start: -0.3, rate: 1}}, q1: {{start: 0}}, q2: {{start: 0.1*2 + {gap}}}}}
bodies:
  b0: {{mass: 1, position: [q0, 0]}}
  b1: {{mass: 1, position: [q1, 0]}}
  b2: {{mass: 1, position: [q2, 0]}}
surfaces:
  t0: {{line: [[0.2, 1], [0.2, -1]], body: b0}}
  t1: {{line: [[0.2, 1], [0.2, -1]], body: b1}}
contacts:
  c0: {{point: {{body: b1}}, surface: t0, modes: [free, slide], friction: 0, restitution: 1}}
  c1: {{point: {{body: b2}}, surface: t1, modes: [free, slide], friction: 0, restitution: 1}}
stop: {{time: 0.3}}
"""


@pytest.mark.parametrize(
    ("gap", "after", "warns"),
    [
        (0.0, [-1 / 3, 2 / 3, 2 / 3], True),
        (1e-16, [-1 / 3, 2 / 3, 2 / 3], True),
        (1e-4, [0.0, 0.0, 1.0], False),
    ],
)
def test_touching_row_is_struck_simultaneously(gap, after, warns):
    for step in (3.1e-3, 1e-4):
        result = run(cradle(gap), step)
        assert rates(result) == pytest.approx(after, abs=1e-9)
        assert any(ORDER in w for w in result.warnings) == warns


def test_feet_of_a_bar_on_one_floor_are_simultaneous():
    text = f"""
kind: scene
name: bar
gravity: {G}
bodies: {{bar: {{mass: 1, inertia: 0.1, start: {{y: 0.1}}}}}}
surfaces: {{s: {{height: 0}}}}
contacts:
  l: {{point: {{body: bar, at: [-0.3, 0]}}, surface: s, friction: 0.1, restitution: 0.9}}
  r: {{point: {{body: bar, at: [0.3, 0]}}, surface: s, friction: 0.1, restitution: 0.9}}
stop: {{time: 0.2}}
"""
    result = run(text, 1e-3)
    assert rates(result)[1] > 0.0
    assert not any(ORDER in w for w in result.warnings)
    assert np.isfinite(result.trace.final).all()


ROLLING = f"""
kind: scene
name: disc
gravity: {G}
simultaneous: plastic
bodies: {{disc: {{mass: 1, inertia: 0.005, start: {{y: 0.6}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts:
  rim:
    {{point: {{body: disc}}, radius: 0.1, surface: floor, friction: 0.3, restitution: 0.5,
     impact: moreau, rolling_resistance: 0.01}}
couplings: {{brake: {{bodies: [disc], limit: 0.1}}}}
stop: {{time: 0.4}}
outputs: {{up: {{maximum: disc.dy}}}}
"""


def test_couples_do_not_make_an_impact_simultaneous() -> None:
    # Alone a contact rebounds by its restitution, whatever the scene says of several.
    speed = 0.5 * math.sqrt(2.0 * G * 0.5)
    assert run(ROLLING).outputs["up"] == pytest.approx(speed, rel=1e-9)
    assert run(ROLLING, 1e-4).outputs["up"] == pytest.approx(speed, rel=1e-3)


# A block without gravity falls on a corner. Its inertia pushes the corner back along the floor.
CORNER = """
kind: scene
name: corner
gravity: 0
bodies: {b: {mass: 1, inertia: 0.05, start: {y: 0.2, dx: 0.1, dy: -1}}}
surfaces: {floor: {height: 0}}
contacts:
  c:
    {point: {body: b, at: [-0.2, -0.1]}, surface: floor, friction: {static: 0.5, kinetic: 0.1},
     restitution: 0.4, impact: moreau}
stop: {time: 0.15}
outputs: {dx: {value: b.dx}, spin: {value: b.dangle}}
"""


@pytest.mark.parametrize("step", [None, 1e-3])
def test_an_impact_that_turns_a_slip_has_the_kinetic_friction(step) -> None:
    # Static friction would hold the corner: its impulse would be a third of the normal one. The
    # responses of the corner to V and H = 0.1 V, against the slip that it has afterwards.
    normal = 1.4 / (1.8 - 0.1 * 0.4)
    found = run(CORNER, step).outputs
    assert 0.1 + (0.1 * 1.2 - 0.4) * normal < 0.0
    assert found["dx"] == pytest.approx(0.1 + 0.1 * normal, rel=1e-11)
    assert found["spin"] == pytest.approx((0.1 * 0.1 - 0.2) / 0.05 * normal, rel=1e-11)


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5])
def test_a_foot_that_has_rebounded_takes_no_restitution_from_the_other(step) -> None:
    # The left foot lands two steps after the right one, which is still as deep as it landed: the
    # same relative error at all steps, 0.05; without rebounds it is 0.5.
    model = interpret(
        read_text("""
kind: scene
name: feet
gravity: 9.81
simultaneous: plastic
parameters: {a: 0}
bodies: {b: {mass: 1, inertia: 0.05, start: {y: 0.1, dy: -1, angle: -a}}}
surfaces: {floor: {height: 0}}
contacts:
  left: {point: {body: b, at: [-0.3, 0]}, surface: floor, friction: 0, restitution: 0.3}
  right: {point: {body: b, at: [0.3, 0]}, surface: floor, friction: 0, restitution: 0.3}
stop: {time: 0.078}
""")
    )
    values = {"a": 7.9 * step}
    events = Runner(model).run(values)
    steps = Runner(model, engine="impulse", step=step).run(values)
    assert [j.region for j in events.trace.jumps] == ["right", "left", "right"]
    assert [j.region for j in steps.trace.jumps] == ["right", "left", "right"]
    np.testing.assert_allclose(steps.trace.final[3:], events.trace.final[3:], rtol=0, atol=0.05)
