"""Messages of many-body scenes that cannot be run, or stop."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, NonFinite
from statechart.running.runner import Runner

SCENE = """\
kind: scene
name: grains
parameters: {n: 3, r: 0.1}
gravity: 9.81
bodies:
  grain:
    copies: n
    mass: 1
    inertia: 0.01
    shape: {disc: r}
    start: {x: 0.3*index, y: r}
  cart: {mass: 1, inertia: 1, start: {y: -5}}
surfaces:
  floor: {edge: [[-1, 0], [2, 0]]}
collisions:
  all: {bodies: [grain], surfaces: [floor], friction: 0.5, restitution: 0}
stop: {time: 0.05}
settings: {engine: impulse, step: 1e-3}
"""


def test_copies_at_one_place_are_advised_to_use_index():
    text = SCENE.replace("x: 0.3*index, ", "")
    reported = r"11:12: .*'grain0' and 'grain1' start at the same place; .* such as x: 0\.21\*index"
    with pytest.raises(DeclarationError, match=reported):
        Runner(read_text(text)).run()
    Runner(read_text(text.replace("y: r", "x: 0.21*index, y: r"))).start()
    # Bodies without a contact law may overlap.
    apart = SCENE.replace("start: {x: 0.3*index", "start: {x: 0").replace("copies: n", "copies: 1")
    Runner(read_text(apart)).start()


def test_copies_carry_no_surface():
    text = SCENE.replace("[2, 0]]}", "[2, 0]], body: grain}")
    with pytest.raises(DeclarationError, match=r"14:42: surfaces\.floor\.body: one body carries"):
        read_and_run(text)
    read_and_run(text.replace("body: grain", "body: cart").replace("y: -5", "y: 0"))


def read_and_run(text):
    return Runner(read_text(text)).run()


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        (
            "[2, 0]]}",
            "[2, 0]], displacement: [0, sqrt(0.02 - time) - sqrt(0.02)]}",
            "the path of surface 'floor' has no value, or an infinite one, at t = 0.0205",
        ),
        (
            "stop:",
            "joints: {held: {point: {body: cart}, to: [0, 'sqrt(0.02 - 50*time**2) - 5']}}\nstop:",
            "the path of joint 'held' has no value, or an infinite one, at t = 0.0205",
        ),
        (
            "stop:",
            "forces: {push: {body: grain, force: [sqrt(0.02 - time), 0]}}\nstop:",
            "a force on body 'grain0' became infinite or undefined",
        ),
    ],
)
def test_a_formula_that_loses_its_value_ends_the_run_there(old, new, reported):
    runner = Runner(read_text(SCENE.replace("y: -5", "y: sqrt(0.02) - 5").replace(old, new)))
    with pytest.raises(NonFinite, match=reported) as caught:
        runner.run()
    assert caught.value.trace.t_end == 0.02
    # A value at the start is enough.
    assert runner.run(until=0.02).trace.outcome.succeeded


def test_a_force_without_a_value_at_the_start_is_reported():
    text = SCENE.replace(
        "stop:", "forces: {f: {body: grain, force: [log(grain.dx - 5), 0]}}\nstop:"
    )
    with pytest.raises(DeclarationError, match=r"17:9: forces: a force on body 'grain0' .* start"):
        read_and_run(text)


def test_masses_are_not_blamed_for_a_tolerance_below_rounding():
    text = SCENE.replace("step: 1e-3", "step: 1e-3, impulse_tolerance: 1e-20")
    trace = Runner(read_text(text.replace("r, y: r", "r, y: 2*r"))).run().trace
    assert not any("masses" in warning for warning in trace.warnings)


SLOPES = """\
kind: scene
name: dome
gravity: 9.81
bodies:
  base: {mass: 1, inertia: 1, start: {x: 1, y: -9, dx: -1}}
  ball: {mass: 1, inertia: 1, shape: {disc: 0.1}, start: {x: 0.505, y: 2, dx: 1}}
surfaces:
  dome: {height: sqrt(1 - x**2)}
collisions: {all: {bodies: [ball], surfaces: [dome], friction: 0.3, restitution: 0}}
stop: {time: 0.7}
settings: {engine: impulse, step: 0.01}
"""


@pytest.mark.parametrize(
    ("surface", "reported"),
    [
        (
            "height: sqrt(1 - x**2)",
            "'dome' has no value at x = 1.005, where body 'ball' is at t = 0.4",
        ),
        ("height: sqrt(1.31 - x) - 9", ""),
        ("height: sin(x) - 9", ""),
        (
            "height: sqrt(1 - x**2), displacement: [time, 0]",
            "",
        ),
        (
            "height: sqrt(1 - x**2), displacement: [-time, 0]",
            "'dome' has no value at x = 1.01, where body 'ball' is at t = 0.2",
        ),
        (
            "height: sqrt(1.1 - x), body: base",
            "'dome' has no value at x = 1.105, where body 'ball' is at t = 0.75",
        ),
    ],
)
def test_a_body_that_reaches_an_undefined_height_is_reported(surface, reported):
    text = SLOPES.replace("height: sqrt(1 - x**2)", surface)
    if "body" in surface:
        text = text.replace("time: 0.7", "time: 0.9")
    warnings = [w for w in read_and_run(text).trace.warnings if "no ground" in w]
    assert [reported in warning for warning in warnings] == [True] * bool(reported), warnings


@pytest.mark.parametrize(
    ("start", "reported"),
    [
        (
            'x: "0.3*sin(index)", y: 1 + 0.3*cos(3*index)',
            "at least 118 of 120 copies overlap; write a start that depends "
            'on index, such as x: "0.21*mod(index, 10)" and y: 0.21*floor(index/10)',
        ),
        ("y: 1", "and 'grain1' start at the same place; write a start that depends on index,"),
        ('x: "0.21*mod(index, 90)", y: 0.1', "'grain0' and 'grain90' start at the same place"),
        ('x: "0.21*mod(index, 12)", y: 0.1 + 0.21*floor(index/12)', ""),
    ],
)
def test_overlapping_copies_are_counted_and_advised_to_stand_in_rows(start, reported):
    text = SCENE.replace("x: 0.3*index, y: r", start).replace("n: 3", "n: 120")
    if not reported:
        Runner(read_text(text)).start()
        return
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(text)).start()
    assert reported in str(caught.value)


def test_the_least_penetration_of_overlapping_copies_is_reported():
    text = SCENE.replace("x: 0.3*index", "x: 0.08*index").replace("n: 3", "n: 20")
    with pytest.raises(DeclarationError, match=r"'grain0' .* at least 0\.12 deep in body 'grain1'"):
        Runner(read_text(text)).start()
