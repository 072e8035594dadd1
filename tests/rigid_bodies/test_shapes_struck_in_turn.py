"""Impacts at one instant carried out one after another, against impacts of two worked out apart."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contacts.solvers.impact_sequence import LONGEST_SEQUENCE
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

R, START = 0.1, 0.5
NEWS = "struck in several places at once"


def run(text, step=1e-3, law="sequential", until=2.0):
    """Return a run of a scene with a law of simultaneous impacts."""
    rest = f"\nsimultaneous: {law}\nstop: {{time: {until}}}\n"
    return Runner(interpret(read_text(text + rest)), engine="impulse", step=step).run()


def row(masses, restitution, gaps, speeds, friction=0.0, spins=None):
    """Return discs in a row; those that move are so far off that they need START."""
    bodies, place, before = "", 0.0, 0.0
    for k, (mass, speed) in enumerate(zip(masses, speeds, strict=True)):
        if k:
            place += 2 * R + (gaps[k - 1] if speeds[k - 1] == speed else START * (before - speed))
        before = speed
        bodies += (
            f"  b{k}: {{mass: {mass}, inertia: {mass * R**2 / 2}, shape: {{disc: {R}}}, "
            f"start: {{x: {place}, dx: {speed}, dangle: {spins[k] if spins else 0.0}}}}}\n"
        )
    names = ", ".join(f"b{k}" for k in range(len(masses)))
    return (
        f"kind: scene\nname: row\nbodies:\n{bodies}collisions:\n"
        f"  all: {{bodies: [{names}], friction: {friction}, restitution: {restitution}}}\n"
    )


def in_turn(masses, restitution, speeds):
    """Return the speeds after impacts of two, the fastest first."""
    v, e = list(speeds), restitution
    while True:
        k = max(range(len(v) - 1), key=lambda i: v[i] - v[i + 1])
        nearing = v[k] - v[k + 1]
        if nearing <= 1e-14:
            return v
        impulse = (1 + e) * nearing / (1 / masses[k] + 1 / masses[k + 1])
        v[k] -= impulse / masses[k]
        v[k + 1] += impulse / masses[k + 1]


def event_by_event(masses, restitution, places, speeds, until):
    """Return positions and velocities of discs in a row with gaps, impact by impact."""
    x, v, t = list(places), list(speeds), 0.0
    while True:
        times = [
            max(x[k + 1] - x[k] - 2 * R, 0.0) / (v[k] - v[k + 1])
            if v[k] - v[k + 1] > 1e-14
            else math.inf
            for k in range(len(x) - 1)
        ]
        k = int(np.argmin(times))
        ahead = min(times[k], until - t)
        x, t = [a + b * ahead for a, b in zip(x, v, strict=True)], t + ahead
        if t >= until:
            return x, v
        nearing = v[k] - v[k + 1]
        impulse = (1 + restitution) * nearing / (1 / masses[k] + 1 / masses[k + 1])
        v[k], v[k + 1] = v[k] - impulse / masses[k], v[k + 1] + impulse / masses[k + 1]


def speeds_of(result):
    """Return the rates along x."""
    trace = result.trace
    return trace.final[len(trace.final) // 2 :: 3]


ROWS = [
    ([1, 1, 1], 1.0, [1, 0, 0]),
    ([1, 1, 1, 1, 1], 1.0, [1, 0, 0, 0, 0]),
    ([1, 1, 1, 1, 1], 1.0, [1, 1, 0, 0, 0]),
    ([3, 1, 2], 1.0, [1, 0, 0]),
    ([1, 5, 0.2, 2, 1], 1.0, [2, 0, 0, 0, 0]),
    ([1, 1, 1], 0.5, [1, 0, 0]),
    ([2, 1, 0.3, 1, 4], 0.7, [1, 0, 0, 0, 0]),
    ([1, 1, 1, 1, 1], 0.0, [1, 0, 0, 0, 0]),
]


@pytest.mark.parametrize(("masses", "e", "speeds"), ROWS)
@pytest.mark.parametrize("step", [1e-2, 1e-4])
def test_a_row_that_touches_passes_a_blow_on(masses, e, speeds, step):
    result = run(row(masses, e, [0.0] * len(masses), speeds), step)
    assert not result.warnings
    left = [what["what"] for what in result.to_dict()["left_out"]]
    assert not any("simultaneous" in what for what in left)
    np.testing.assert_allclose(speeds_of(result), in_turn(masses, e, speeds), atol=1e-9)
    assert result.trace.jumps[0].t == pytest.approx(START, abs=step)


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-6, 1e-4])
@pytest.mark.parametrize("masses", [[1, 1, 1], [1, 3, 0.5]])
@pytest.mark.parametrize("e", [0.5, 1.0])
def test_a_row_converges_to_the_run_with_events(masses, e, gap):
    places = [0.0, 2 * R + START, 4 * R + START + gap]
    speeds = [1.0, 0.0, 0.0]
    x, v = event_by_event(masses, e, places, speeds, 2.0)
    for step in (1e-2, 1e-3, 1e-4):
        result = run(row(masses, e, [0.0, gap], speeds), step)
        np.testing.assert_allclose(speeds_of(result), v, atol=1e-9)
        found = result.trace.final[: 3 * len(x) : 3]
        # An impact is within a step of its instant: three or four follow each other.
        assert np.abs(found - x).max() <= 4 * step


@pytest.mark.parametrize("gap", [0.0, 1e-8, 1e-5, 1e-3])
@pytest.mark.parametrize("e", [0.5, 1.0])
def test_a_row_on_a_floor_does_not_depend_on_the_contact_tolerance(e, gap):
    """Gaps below what falls in two steps do, 2e-5 m at 1e-3 s and 2e-7 at 1e-4."""
    text = row([1, 1, 1], e, [0.0, gap], [1, 0, 0]) + "gravity: 9.81\n"
    text += "surfaces: {floor: {line: [[-1, -0.1], [1, -0.1]]}}\n"
    text = text.replace("collisions:\n", "collisions:\n  feet: {bodies: [b0, b1, b2], "
                        f"surfaces: [floor], friction: 0, restitution: {e}}}\n")  # fmt: skip
    for step in (1e-3, 1e-4):
        result = run(text, step, until=1.0)
        assert not result.warnings
        np.testing.assert_allclose(speeds_of(result), in_turn([1, 1, 1], e, [1, 0, 0]), atol=1e-9)


@pytest.mark.parametrize("mu", [0.1, 0.3, 5.0])
def test_friction_of_impacts_in_turn_is_coulombs(mu):
    """Discs that spin: each impact is one of two, with the tangential impulse that it takes."""
    masses, e, spins = [1.0, 2.0, 1.5], 0.8, [12.0, -3.0, 5.0]
    u, w, y = np.array([1.0, 0.0, 0.0]), np.array(spins), np.zeros(3)
    m = np.array(masses)
    while (u[:-1] - u[1:]).max() > 1e-14:
        k = int(np.argmax(u[:-1] - u[1:]))
        normal = (1 + e) * (u[k] - u[k + 1]) / (1 / m[k] + 1 / m[k + 1])
        # Slip of the left rim against the right one; a disc has a third of its mass at its rim.
        slip = (y[k] + R * w[k]) - (y[k + 1] - R * w[k + 1])
        push = np.clip(-slip / (3 / m[k] + 3 / m[k + 1]), -mu * normal, mu * normal)
        u[k], u[k + 1] = u[k] - normal / m[k], u[k + 1] + normal / m[k + 1]
        y[k], y[k + 1] = y[k] + push / m[k], y[k + 1] - push / m[k + 1]
        w[k] += 2 * push / (m[k] * R)
        w[k + 1] += 2 * push / (m[k + 1] * R)
    for step in (1e-3, 1e-5):
        result = run(row(masses, e, [0.0] * 3, [1.0, 0.0, 0.0], mu, spins), step, until=0.6)
        found = result.trace.final.reshape(2, 3, 3)[1]
        # The rims meet half of their gap away from the contact point.
        np.testing.assert_allclose(found, np.stack([u, y, w], 1), rtol=5 * step, atol=1e-9)


def test_a_light_ball_between_a_wall_and_a_heavy_one_counts_the_digits_of_pi():
    """Galperin: 100**k as heavy, it is struck so often that what follows has a closed form."""
    ratio = 100.0**2
    wall = "surfaces: {wall: {line: [[0, -1], [0, 1]]}}\n"
    text = row([ratio, 1.0], 1.0, [0.0], [1.0, 0.0])
    place = 2 * R + START + R
    text = text.replace("restitution", "surfaces: [wall], restitution") + wall.replace(
        "[[0, -1], [0, 1]]", f"[[{place!r}, -1], [{place!r}, 1]]"
    )
    result = run(text, until=1.0)
    assert not result.warnings
    # In velocities times roots of masses every impact is a reflection; two are a rotation.
    angle = math.atan(math.sqrt(1 / ratio))
    count = math.ceil(math.pi / angle) - 1
    turned = 2 * angle * ((count + 1) // 2)
    after = [math.cos(turned), math.sqrt(ratio) * math.sin(turned)]
    assert count == 314
    heavy, light = speeds_of(result)
    assert heavy == pytest.approx(after[0], abs=1e-9)
    assert abs(light) == pytest.approx(abs(after[1]), abs=1e-7)


def test_endless_impact_sequences_give_a_warning_and_end_together():
    ratio = 1e10
    assert math.pi * math.sqrt(ratio) > LONGEST_SEQUENCE
    place = 3 * R + START
    text = row([ratio, 1.0], 1.0, [0.0], [1.0, 0.0])
    text = text.replace("restitution", "surfaces: [wall], restitution")
    text += f"surfaces: {{wall: {{line: [[{place!r}, -1], [{place!r}, 1]]}}}}\n"
    result = run(text, until=0.6)
    reported = [warning for warning in result.warnings if "did not end" in warning]
    assert len(reported) == 1
    speeds = speeds_of(result)
    once = speeds_of(run(text, law="capped", until=0.6))
    np.testing.assert_allclose(speeds, once, atol=1e-12)
    assert ratio * speeds[0] ** 2 + speeds[1] ** 2 <= ratio * (1 + 1e-12)


@pytest.mark.parametrize(("heavy", "light"), [(1.0, 1.0), (3.0, 1.0), (10.0, 0.1)])
def test_a_ball_that_falls_with_another_on_it_throws_that_up(heavy, light):
    """Huygens: the lower one bounces first, and meets the upper one that still falls."""
    height = 0.5
    text = f"""
kind: scene
name: balls
gravity: 9.81
bodies:
  low: {{mass: {heavy}, inertia: 1, shape: {{disc: {R}}}, start: {{y: {R + height}}}}}
  high: {{mass: {light}, inertia: 1, shape: {{disc: {R}}}, start: {{y: {3 * R + height}}}}}
surfaces: {{floor: {{height: 0}}}}
collisions: {{all: {{bodies: [low, high], surfaces: [floor], friction: 0, restitution: 1}}}}
"""
    v = math.sqrt(2 * 9.81 * height)
    # The floor is a ball that nothing moves.
    _, low, high = in_turn([1e30, heavy, light], 1.0, [0.0, -v, -v])
    landed, until = v / 9.81, v / 9.81 + 0.05
    for step in (1e-3, 1e-4):
        result = run(text, step, until=until)
        y = result.trace.final[[1, 4]]
        since = until - landed
        wanted = [R + low * since, 3 * R + high * since] - 0.5 * np.array(9.81 * since**2)
        # Three times as heavy it has given all away, and rests.
        wanted[0] = max(wanted[0], R)
        assert np.abs(y - wanted).max() <= 5 * step


PENDULUM = """
kind: scene
name: cradle
parameters: {L: 1, r: 0.1, m: 1, A: 0.3}
gravity: 9.81
bodies:
"""


def test_a_cradle_on_strings_passes_the_speed_on():
    """Physical pendulums that are alike hand over their speed, whatever their joints bear."""
    text = PENDULUM
    for k in range(5):
        tilt = "-A" if k == 0 else "0"
        text += (
            f"  b{k}: {{mass: m, inertia: m*r**2/2, shape: {{disc: r}}, start: "
            f"{{x: 2*r*{k} + L*sin({tilt}), y: -L*cos({tilt}), angle: {tilt}}}}}\n"
        )
    text += "joints:\n" + "".join(
        f"  j{k}: {{point: {{body: b{k}, at: [0, L]}}, to: [2*r*{k}, 0]}}\n" for k in range(5)
    )
    text += "collisions: {all: {bodies: [b0, b1, b2, b3, b4], friction: 0, restitution: 1}}\n"
    inertia = 1 + 0.1**2 / 2
    speed = math.sqrt(2 * 9.81 * (1 - math.cos(0.3)) / inertia)
    quarter = math.pi / 2 * math.sqrt(inertia / 9.81) * (1 + 0.3**2 / 16)
    # A little later than at the bottom the last one has risen.
    late, speed = 0.01, speed * math.cos(0.01 * math.sqrt(9.81 / inertia))
    for step, swings in [(1e-3, 1), (2e-4, 1), (1e-3, 9), (2e-4, 9)]:
        result = run(text, step, until=swings * quarter + late)
        assert not result.warnings
        rates = result.trace.final[len(result.trace.final) // 2 + 2 :: 3]
        np.testing.assert_allclose(rates, [0, 0, 0, 0, speed], atol=0.2 * step)


@pytest.mark.parametrize("mu", [0.0, 0.5])
def test_a_box_that_lands_flat_stays_flat(mu):
    """Two corners of one face are one impact: a box and the floor."""
    text = f"""
kind: scene
name: box
gravity: 9.81
bodies:
  box:
    mass: 1
    inertia: 0.1
    shape: {{polygon: [[-0.3, -0.1], [0.3, -0.1], [0.3, 0.1], [-0.3, 0.1]]}}
    start: {{y: 0.3}}
surfaces: {{floor: {{height: 0}}}}
collisions: {{all: {{bodies: [box], surfaces: [floor], friction: {mu}, restitution: 1}}}}
"""
    once = run(text, law="capped")
    result = run(text)
    assert not once.warnings
    assert not result.warnings
    assert abs(result.trace.final[2]) < 1e-9
    np.testing.assert_allclose(result.trace.final, once.trace.final, atol=1e-9)


def test_equal_approaches_at_two_places_are_resolved_together():
    """A disc between two does not swerve, in either order of impacts."""
    x, y = 2 * R * math.cos(math.pi / 6), 2 * R * math.sin(math.pi / 6)
    text = f"""
kind: scene
name: wedge
bodies:
  one: {{mass: 1, inertia: 1, shape: {{disc: {R}}}, start: {{x: {-0.5!r}, dx: 1}}}}
  up: {{mass: 1, inertia: 1, shape: {{disc: {R}}}, start: {{x: {x!r}, y: {y!r}}}}}
  down: {{mass: 1, inertia: 1, shape: {{disc: {R}}}, start: {{x: {x!r}, y: {-y!r}}}}}
collisions: {{all: {{bodies: [one, up, down], friction: 0, restitution: 1}}}}
"""
    found = run(text, 1e-3).trace.final.reshape(2, 3, 3)[1]
    # 1 - 2 P cos = v, and P along both normals: the energy of before gives P.
    c = math.cos(math.pi / 6)
    push = 2 * c / (1 + 2 * c**2)
    wanted = [[1 - 2 * push * c, 0], [push * c, push / 2], [push * c, -push / 2]]
    # They meet within a step of where they touch.
    np.testing.assert_allclose(found[:, :2], wanted, atol=5e-3)
    np.testing.assert_allclose(found[1, :2], found[2, :2] * [1, -1], atol=1e-12)
    assert abs(found[0, 1]) < 1e-12


@pytest.mark.parametrize(("e", "reported"), [(1.0, True), (0.6, True), (0.4, False), (0.0, False)])
@pytest.mark.parametrize("record", ["modes", "nothing"])
def test_a_run_warns_where_the_order_of_impacts_matters(e, reported, record):
    text = row([1, 1, 1], e, [0.0] * 3, [1.0, 0.0, 0.0])
    result = run(text + f"settings: {{record: {record}}}", law="capped")
    news = [warning for warning in result.warnings if NEWS in warning]
    assert len(news) == reported
    assert result.warnings == tuple(news)
    if reported:
        assert news[0].startswith("in 1 step, the first at t = 0.4995,")
        assert "simultaneous: sequential" in news[0]
    assert not any(NEWS in warning for warning in run(
        row([1, 1, 1], e, [0.0, 1e-3, 1e-3], [1.0, 0.0, 0.0]), law="capped"
    ).warnings)  # fmt: skip


def test_other_simultaneous_laws_are_alternatives():
    text = row([1, 1, 1], 1, [0.0] * 3, [1, 0, 0]) + "stop: {time: 1}\n"
    runner = Runner(interpret(read_text(text)), engine="impulse", step=1e-3)
    others = {name: speeds_of(other.run()) for name, other in runner.alternatives().items()}
    assert set(others) == {"simultaneous: plastic", "simultaneous: sequential"}
    np.testing.assert_allclose(others["simultaneous: plastic"], [1 / 3] * 3, atol=1e-9)
    np.testing.assert_allclose(others["simultaneous: sequential"], [0, 0, 1], atol=1e-9)
