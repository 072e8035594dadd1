"""Wrong scenes: one message with place and remedy, before anything is run."""

from __future__ import annotations

import math
import re

import pytest

from contacts.scene.lint import lint
from contacts.scene.scene import Scene
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, close_matches
from statechart.running.runner import Runner

SCENE = """\
kind: scene
name: thrown
parameters: {m: 1, mu: 0.5, e: 0.5, h: 1, g: 9.81, big: inf}
gravity: g
bodies:
  rod: {mass: m, inertia: 1/3, start: {y: h, angle: 0.3}}
surfaces:
  ground: {height: 0}
contacts:
  tip: {point: {body: rod, at: [0, -0.5]}, surface: ground, friction: mu, restitution: e}
stop: {time: 1}
outputs:
  y: {value: rod.y}
"""
CHAIN = (
    "surfaces:",
    "  arm: {mass: 1, inertia: 1, start: {x: 2, y: 2}}\n"
    "joints:\n"
    "  a: {point: {body: rod, at: [0, -0.5]}, to: [0, 0]}\n"
    "  b: {point: {body: rod, at: [0, 0.5]}, to: {body: arm}}\n"
    "  c: @{point: {body: arm, at: [0, 1]}, to: [9, 9]}\n"
    "surfaces:",
)


def refused(*pairs: tuple[str, str]) -> DeclarationError:
    """Return the error of the scene so changed; it must stand where the text has an @."""
    text = SCENE
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    before, _, _ = text.partition("@")
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(text.replace("@", "", 1), "f.yaml")).start()
    error = caught.value
    line = before.count("\n") + 1
    column = len(before) - (before.rfind("\n") + 1) + 1
    assert str(error).startswith(f"f.yaml:{line}:{column}: ")
    assert not error.others
    return error


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        (
            "mu: [@-1, 3]",
            "with mu = -1, contacts.tip.friction (line 11, column 71): must be zero or po",
        ),
        ("m: [@0, 2]", "with m = 0, bodies.rod.mass (line 7, column 15): must be positive"),
        ("e: [0, @1.5]", "with e = 1.5, contacts.tip.restitution (line 11, column 88): must b"),
        (
            "m: [1, 2], g: [9, @10]",
            "with g = 10, gravity (line 5, column 10): formula '9.81/(10 - g)': division by",
        ),
        ("end: [@-1, 2]", "with end = -1, stop.time (line 12, column 14): must be a finite time"),
        (
            "h: [@-1, 2]",
            "with h = -1, parameters.big (line 3, column 57): formula 'sqrt(h)': sqrt has",
        ),
    ],
)
def test_range_ends_are_valid_models(ranges: str, words: str) -> None:
    changes = (
        ("big: inf}", f"big: sqrt(h), end: 1}}\nranges: {{{ranges}}}"),
        ("gravity: g", "gravity: 9.81/(10 - g)"),
        ("time: 1", "time: end"),
    )
    error = refused(*changes)
    assert words in str(error)
    assert "narrow the range to values of valid models" in str(error)


@pytest.mark.parametrize("size", ["1e300", "-2e100"])
def test_a_point_too_far_for_floats_is_reported_at_its_place(size: str) -> None:
    error = refused(("at: [0, -0.5]", f"at: [0, @{size}]"))
    words = f"contacts.tip.point.at.1: must be at most 1e+100 in size, not {float(size):g}; take"
    assert words in str(error)


def test_an_angle_too_large_for_floats_is_reported_at_its_place() -> None:
    text = "kind: scene\nname: n\nbodies: {b: {mass: 1, inertia: 1, start: {angle: a}}}\n"
    runner = Runner(read_text(text + "parameters: {a: 1}\nstop: {time: 0.1}\n"))
    assert runner.run({"a": 1e8}).trace.outcome.succeeded
    with pytest.raises(DeclarationError, match=r"start\.angle.* at most 1e\+08 rad .*turns$"):
        runner.run({"a": 1e300})


def test_an_error_in_a_list_has_the_place_of_the_item() -> None:
    text = SCENE.replace("mass: m", "mass: m, shape: {polygon: [[-e, 0], [e, 0], [0, 1]]}")
    with pytest.raises(
        DeclarationError, match=r"rod\.shape\.polygon \(line 7, column 35\): all cor"
    ):
        Runner(read_text(text.replace("gravity", "ranges: {e: [0, 1]}\ngravity")))


def test_range_of_an_integer_contains_an_integer() -> None:
    ball = (
        "bodies:\n  ball: {copies: n, mass: 1, inertia: 1, shape: {disc: 0.1}, start: {x: index}}\n"
    )
    law = "collisions: {all: {bodies: [ball], friction: 0, restitution: 0}}\nstop: {time: 1}\n"
    text = "kind: scene\nname: balls\nparameters: {n: 3}\nranges: {n: [2.2, 2.8]}\n" + ball + law
    reported = r"4:13: ranges\.n: 'n' is a whole number: none is from 2\.2 to 2\.8; write \[2, 3\]"
    with pytest.raises(DeclarationError, match=reported):
        Runner(read_text(text))


GRAINS = """\
kind: scene
name: grains
parameters: {n: 4, r: 0.1}
gravity: 9.81
bodies:
  grain: {copies: n, mass: 1, inertia: r**2/2, shape: {disc: r}, start: {x: 0.3*index, y: 2}}
surfaces:
  floor: {height: 0}
collisions:
  all: {bodies: [grain], surfaces: [floor], friction: 0.5, restitution: 0}
controls: {lift: 0}
regions:
  hand: {initial: up, states: {up: {sets: {lift: 1}}}}
stop: {time: 1}
outputs:
  y: {value: grain3.y}
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("grain3.y", "@grain7.y", "unknown name 'grain7.y'; there are grain0.y to grain3.y"),
        ("grain3.y", "@grain.y", "there are grain0.y to grain3.y"),
        ("mass: 1", "mass: 1 + @index", "'index': copies differ only in their start"),
        ("copies: n, ", "", "'index': it is the number of a copy; add copies"),
        ("height: 0", "height: 0, displacement: [0, @lift]", "'lift': a control jumps"),
        ("0.3*index", "0.3*(index @% 2)", "a remainder as mod(a, b)"),
        ("0.3*index", "0.3*(index/@/2)", "rounded down it is floor(a/b)"),
        ("0.3*index", "@ceil(index/2)", "unknown function 'ceil'; write -floor(-x)"),
        ("mass: 1", "mass: 1 + @floor(n/3)", "write a parameter if its arguments are constant"),
        ("disc: r", "disc: r*(1 + @index)", "'index': copies differ only in their start"),
        ("disc: r", "disc: r*@time", "'time': it changes during a run, and this value is"),
        ("friction: 0.5", "friction: @grain1.dx", "this value is constant; write a formula of pa"),
        ("height: 0", "line: [[0, @time], [1, 0]]", "a surface that moves has a displacement"),
        ("height: 0", "height: @floor(x)", "floor jumps, and may stand only in"),
        ("{disc: r}", "[{disc: @-r}]", "bodies.grain.shape.0.disc: must be positive, not -0.1"),
        ("[grain]", "[grain, @grain]", "'grain' is listed twice; list it once; bodies of one list"),
        ("[floor]", "[floor, @floor]", "'floor' is listed twice; list it once"),
        ("0.3*index", '"mod(index, 0)"', "it has no real value"),
        (
            "controls:",
            "forces: {f: @{body: grain}}\ncontrols:",
            "neither force nor moment is given",
        ),
        (
            "controls:",
            "forces: {f: {body: grain, force: [0, 1], at: [@time, 0]}}\ncontrols:",
            "'time': the point of a force is fixed in its body; let moment change instead",
        ),
        ("mass: 1", "mass: @nan", "nan is not a value; write a number"),
        ("{disc: r}", "@[" + "{disc: r}, " * 17 + "]", "must have at most 16 items, not 17"),
    ],
)
def test_mistakes_with_copies_are_reported_with_their_place(old: str, new: str, words: str) -> None:
    assert old in GRAINS
    text = GRAINS.replace(old, new, 1)
    before, found, _ = text.partition("@")
    with pytest.raises(DeclarationError, match=r"^f\.yaml:\d+:\d+: ") as caught:
        Runner(read_text(text.replace("@", "", 1), "f.yaml"))
    assert words in str(caught.value)
    if found:
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        assert str(caught.value).startswith(f"f.yaml:{line}:{column}: ")


def test_names_are_listed_in_the_order_of_their_numbers() -> None:
    known = ["rod10.x", "time", "rod2.x", "rod1.x"]
    assert close_matches("mu", known) == "known: rod1.x, rod2.x, rod10.x, time"
    assert close_matches("rod3.x", known) == "there are rod1.x to rod10.x"
    assert close_matches("rod.y", ["rod1.x", "rod2.x"]).endswith("known: rod1.x, rod2.x")
    assert close_matches("", ["a1", "a2"]) == "known: a1, a2"


@pytest.mark.parametrize(("inertia", "warned"), [("r**2/2", False), ("1e-9", True), ("1e3", True)])
def test_an_inertia_in_other_units_than_its_shape_is_warned_of(inertia: str, warned: bool) -> None:
    scene = Runner(read_text(GRAINS.replace("inertia: r**2/2", f"inertia: {inertia}"))).model
    assert isinstance(scene, Scene)
    said = [line for line in lint(scene) if "check the units" in line]
    assert bool(said) == warned


@pytest.mark.parametrize(
    ("surface", "words"),
    [
        ("line: [[0, 2], [1, 2]]", "out of the surface; the solid of a line is on the right"),
        ("circle: [0, 0], radius: 5", "out of the surface; a circle is solid inside"),
        ("height: 2", "out of the surface"),
    ],
)
def test_the_solid_side_is_explained_for_each_form_of_surface(surface: str, words: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(SCENE.replace("height: 0", surface))).start()
    assert words in str(caught.value)
    assert ("right" in str(caught.value)) == ("line" in surface)


def test_base_scene_is_valid() -> None:
    assert Runner(read_text(SCENE)).start()[0] == ("free",)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gravity: g", "@gravty: 9.81", "did you mean 'gravity'?"),
        ("mass: m", "@mas: m", "did you mean 'mass'?"),
        ("gravity: g", "gravity: @[1, 2, 3]", "must have 2 items, not 3"),
        ("gravity: g", "gravity: @.nan", "a finite number"),
        ("gravity: g", "gravity: @.inf", "must be finite"),
        ("gravity: g", "gravity: @1e400", "too large for a float"),
        ("gravity: g", "gravity: 9.81@/(h-m)", "division by zero"),
        ("gravity: g", "gravity: 9@**9**9", "exponent"),
        ("gravity: g", "gravity: '@__import__(1)'", "unknown function '__import__'"),
        ("angle: 0.3", "angle: 1@/(h-h)", "division by zero"),
        ("angle: 0.3", "angle: @sqrt(-h)", "sqrt has no value"),
        ("y: h, angle", "y: @inf, angle", "must be finite"),
        ("y: h, angle", "y: @h*big, angle", "must be finite, not inf"),
        ("height: 0", "height: @inf*x", "must be finite"),
        ("height: 0", "line: @[[0, 0], [0, m - 1]]", "its two points coincide"),
        ("height: 0", "line: @[[0, 0]]", "must have 2 items"),
        ("height: 0", "circle: [0, 0], radius: @m - 1", "must be positive, not 0"),
        ("height: 0", "circle: [0, 0], radius: @-1", "must be positive, not -1"),
        ("time: 1", "time: @inf", "must be a finite time from 0 on, not inf"),
        ("time: 1", "time: 1@/0", "division by zero"),
        ("1}\n", "1, conditions: {low: @sqrt(rod.y - 5) <= 1}}\n", "has no value at the start"),
        ("1}\n", "1, conditions: {low: 1@/(rod.y - rod.y) <= 1}}\n", "it has no real value"),
        ("1}\n", "1, conditions: {low: @rod.y >= inf}}\n", "nothing is compared with infinity"),
        ("bodies:", "coordinates: {@q: {start: 1}}\nbodies:", "it moves no body"),
        ("mass: m", "mass: @-m", "must be positive, not -1"),
        ("friction: mu", "friction: @-mu", "must be zero or positive, not -0.5"),
        ("restitution: e", "restitution: @3*e", "must be between 0 and 1, not 1.5"),
        ("restitution: e", "restitution: @-e", "must be between 0 and 1, not -0.5"),
        ("stop:", "modes: {tip: @pin}\nstop:", "its gap is open or opening"),
    ],
)
def test_every_invalid_scene_reports_place_and_message(old: str, new: str, words: str) -> None:
    assert words in str(refused((old, new)))


@pytest.mark.parametrize(
    ("height", "words"),
    [
        ("log(x - 5)", "its place at the start is not finite"),
        ("0.8", "starts inside its surface, 0.277668 deep; move the body out of the surface"),
    ],
)
def test_contact_starting_undefined_or_inside_is_named(height: str, words: str) -> None:
    found = refused(("height: 0", f"height: {height}"), ("tip: {", "tip: @{"))
    assert found.message.startswith("contacts.tip: ")
    assert words in str(found)


@pytest.mark.parametrize(
    ("path", "at", "words"),
    [
        ("0, 2", "j: ", "joint 'j' is open at the start"),
        ("time, 1", "k: ", "the joints 'j', 'k' contradict one another: no velocity of the bodies"),
        ("time**2, 1", "k: ", "contradict one another: no acceleration of the bodies"),
    ],
)
def test_contradictory_joints_are_named(path: str, at: str, words: str) -> None:
    held = "\n  ".join(
        f"{name}: {{point: {{body: rod}}, to: [{to}]}}" for name, to in (("j", path), ("k", "0, 1"))
    )
    joints = f"joints:\n  {held}\n".replace(at, f"{at}@")
    assert words in str(refused(("contacts:", f"{joints}contacts:")))


def test_a_joint_violated_at_the_start_suggests_velocities() -> None:
    error = refused(("contacts:", "joints: {j: @{point: {body: rod}, to: [time, 1]}}\ncontacts:"))
    assert error.message == (
        "joints.j: joint 'j' does not hold at the start: its point of 'rod' and its place in the "
        "world are moving apart at 1"
    )
    assert error.advice == "velocities that it allows: rod.dx = 1"


def test_a_loop_that_cannot_close_reports_its_least_distance() -> None:
    error = refused(CHAIN)
    assert "'c' is open at the start" in error.message
    assert "no position near the start closes all joints (least distance found" in str(error)


@pytest.mark.parametrize(
    ("parameter", "value", "words"),
    [
        ("h", math.inf, "bodies.rod.start.y: must be finite, not inf (with h = inf)"),
        ("g", math.inf, "gravity: must be finite, not inf (with g = inf)"),
        ("m", 0.0, "bodies.rod.mass: must be positive, not 0 (with m = 0)"),
        ("h", 0.1, "starts inside its surface, 0.377668 deep (with h = 0.1)"),
        ("g", math.nan, "parameter 'g' must be a number"),
    ],
)
def test_overridden_values_are_checked(parameter: str, value: float, words: str) -> None:
    with pytest.raises(DeclarationError, match=re.escape(words)):
        Runner(read_text(SCENE)).run({parameter: value})


def test_a_wrong_set_value_is_reported_by_its_path_in_the_file() -> None:
    text = """
kind: scene
name: bars
parameters: {b: 0.1, R: 0.2}
bodies:
  one: {mass: 1, inertia: 1, shape: {polygon: [[-1, -b], [1, -b], [1, b], [-1, b]]}}
  two: {mass: 1, inertia: 1, shape: [{disc: 0.1}, {disc: R}], start: {x: 3}}
collisions: {all: {bodies: [one, two], friction: 0, restitution: 0}}
stop: {time: 1}
"""
    runner = Runner(read_text(text))
    with pytest.raises(DeclarationError, match=r"7:58: bodies\.two\.shape\.1\.disc: must be pos"):
        runner.run({"R": 0})
    reported = r"6:47: bodies\.one\.shape\.polygon: all corners lie on the line"
    with pytest.raises(DeclarationError, match=reported):
        runner.run({"b": 0})
    with pytest.raises(DeclarationError, match=reported):
        Runner(read_text(text.replace("b: 0.1", "b: 0")))
