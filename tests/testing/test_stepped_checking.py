"""Checks of models that run by time stepping: passed, failed and undecidable properties."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import statechart
from contacts.dynamics.mechanics import Mechanics
from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.testing.assertions import assert_in_cone
from contacts.testing.body_properties import (
    assert_depths,
    assert_energy_of_steps,
    assert_free_fall,
    assert_impulses_of_bodies,
)
from contacts.testing.scene_properties import assert_cone, assert_energy
from contacts.testing.symmetry import image_property, mirrored
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.testing.agreement import Sensitivity, Undecidable, assert_same
from statechart.testing.checking import check
from statechart.testing.subject import Subject

HEAP = """
kind: scene
name: heap
parameters: {n: 2, v: 1, mu: 0.3, e: 0.4}
ranges: {n: [1, 3], v: [0, 2], e: [0, 1]}
gravity: 9.81
bodies:
  box:
    copies: n
    mass: 1
    inertia: 0.1
    shape: {polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}
    start: {x: 0.05*index, y: 0.2 + 0.3*index, angle: 0.3*index, dx: v}
  ball: {mass: 2, inertia: 0.01, shape: {disc: 0.1}, start: {x: 0.5, y: 0.11, dx: -1}}
surfaces:
  ground: {height: 0}
  wall: {line: [[-1, 1], [-1, 0]]}
collisions:
  all: {bodies: [box, ball], surfaces: [ground, wall], friction: mu, restitution: e}
stop: {time: 0.3}
settings: {engine: impulse, step: 1e-3}
"""

BLOCK = """
kind: scene
name: block
parameters: {v0: 1, vy: -1, mu: 0.3, e: 0.5, g: 9.81}
ranges: {v0: [-2, 2], vy: [-3, 3], e: [0, 0.8]}
gravity: g
bodies: {block: {mass: 2, start: {x: 1, y: 1, dx: v0, dy: vy}}}
surfaces: {ground: {height: 0}}
contacts:
  base: {point: {body: block}, surface: ground, friction: mu, restitution: e, impact: newton}
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
"""

SOFT = HEAP.replace("restitution: e", "stiffness: 1e5, damping: 100").replace(", e: 0.4", "")
SOFT = SOFT.replace(", e: [0, 1]", "")


def model(text):
    return interpret(read_text(text))


@pytest.fixture(scope="module")
def heap():
    """Return a subject, its run, and its numbers."""
    subject = Subject(model(HEAP))
    scene = subject.model
    return subject, subject.case({}).trace, body_numbers(scene, scene.values())


@pytest.mark.parametrize("text", [HEAP, BLOCK])
def test_a_good_model_passes(text):
    report = check(model(text), examples=4, seed=2)
    assert report.passed, report.text()
    assert report.engines == ("impulse at steps of 0.001",)
    left = {result.name for result in report.properties if result.skipped}
    assert left == {
        "no guard is passed",
        "declared invariants hold",
        "relations hold where modes say so",
        "engines agree",
    }
    units = report.properties[-1]
    assert units.examples > units.undecidable


def test_compliant_bodies_may_sink_in():
    report = check(model(SOFT), examples=1, seed=2)
    assert report.passed, report.text()


def test_depths_of_rigid_contacts_are_checked_beside_compliant_ones():
    soft = "soft: {bodies: [ball], surfaces: [ground], friction: mu, stiffness: 2e3}"
    text = HEAP.replace("collisions:", f"collisions:\n  {soft}")
    report = check(model(text), examples=1, seed=2)
    assert report.passed, report.text()
    depths = next(r for r in report.properties if "deeper" in r.name)
    assert depths.examples == 1
    subject = Subject(model(text))
    trace, numbers = subject.case({}).trace, body_numbers(subject.model, subject.model.values())
    assert_depths(numbers, trace)
    with pytest.raises(AssertionError, match=r"ball is .* deep in a surface"):
        assert_depths(numbers._replace(materials=0.0 * numbers.materials), trace)


def test_joints_that_break_are_regions_of_checked_runs():
    text = HEAP.replace(
        "stop:", "joints: {glue: {point: {body: ball}, to: [0.5, 0.11], enabled: time > 9}}\nstop:"
    )
    report = check(model(text), examples=1, seed=2)
    assert report.passed, report.text()


def test_invariants_of_stepped_runs_allow_the_change_in_a_step():
    # The ball comes to the ground by up to a step of its fall deeper than its radius, at -3.4.
    text = HEAP.replace("y: 0.11", "y: 0.5")
    sound = model(
        text + "invariants: {above: ball.y >= 0.1, slow: ball.dx <= 3, push: energy >= 0}\n"
    )
    of_sound = check(sound, examples=4, seed=2).properties[6]
    assert of_sound.name == "declared invariants hold"
    assert of_sound.failure is None, of_sound.failure
    assert of_sound.examples == 4
    for broken in ("ball.y >= 0.12", "ball.dy >= -1", "ball.dx <= -1.1"):
        found = check(model(f"{text}invariants: {{broken: {broken}}}\n"), examples=4, seed=2)
        assert "the margin of 'broken' is" in found.properties[6].failure.message


def test_a_run_that_does_not_end_is_shrunk_to_a_model_that_shows_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fast.yaml").write_text(
        BLOCK.replace("name: block", "name: fast").replace("vy: [-3, 3]", "g: [1, 1e6]")
    )
    assert main(["check", "fast.yaml", "--examples", "10", "--seed", "1"]) == 1
    assert "STEP_TOO_LARGE" in capsys.readouterr().out
    assert main(["run", "fast_failure.yaml"]) == 1
    assert "STEP_TOO_LARGE" in capsys.readouterr().out


def test_depth_assertion_catches_excess_penetration(heap):
    _, trace, numbers = heap
    assert_depths(numbers, trace)
    shallow = dataclasses.replace(trace, tolerances={**trace.tolerances, "gap": 1e-9})
    with pytest.raises(AssertionError, match="deep in"):
        assert_depths(numbers, shallow)


def test_a_box_may_rest_on_an_accelerated_table():
    # At the end of a step h the table is h^2 a / 8 above its motion with the box, which is held at
    # the middle. The box does not leave it: 0.02 m * (20/s)^2 < g.
    table = """
kind: scene
name: table
gravity: 9.81
bodies:
  box:
    mass: 1
    inertia: 0.01
    shape: {polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}
    start: {y: 0.1, dy: 0.4}
surfaces: {top: {height: 0, displacement: [0, 0.02*sin(20*time)]}}
collisions: {all: {bodies: [box], surfaces: [top], friction: 0.5, restitution: 0}}
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
"""
    report = check(model(table), examples=1)
    assert report.passed, report.text()


def test_jointed_bodies_may_overlap():
    subject = Subject(
        model("""
kind: scene
name: elbow
gravity: 9.81
bodies:
  upper: {mass: 1, inertia: 0.02, shape: {polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1],
    [-0.2, 0.1]]}}
  lower: {mass: 1, inertia: 0.02, shape: {disc: 0.2}, start: {x: 0.25}}
surfaces: {ground: {height: -0.5}}
joints:
  shoulder: {point: {body: upper, at: [-0.2, 0]}, to: [-0.2, 0]}
  elbow: {point: {body: lower, at: [-0.1, 0]}, to: {body: upper, at: [0.15, 0]}}
collisions: {all: {bodies: [upper, lower], surfaces: [ground], friction: 0.3, restitution: 0}}
stop: {time: 0.3}
settings: {engine: impulse, step: 1e-3}
""")
    )
    trace, numbers = subject.case({}).trace, body_numbers(subject.model, subject.model.values())
    assert_depths(numbers, trace)
    first = {"bodies": numbers.joints.bodies[:1], "kinds": numbers.joints.kinds[:1]}
    apart = numbers._replace(joints=numbers.joints._replace(**first))
    with pytest.raises(AssertionError, match=r"upper is 0\.18\d* deep in lower"):
        assert_depths(apart, trace)


def test_free_fall_assertion_catches_wrong_gravity(heap):
    _, trace, numbers = heap
    assert_free_fall(numbers, trace)
    with pytest.raises(AssertionError, match="does not fall"):
        assert_free_fall(numbers._replace(gravity=np.array([0.0, -9.8])), trace)


def test_impulses_outside_the_cone_are_caught(heap):
    _, trace, numbers = heap
    assert_impulses_of_bodies(numbers, trace)
    smooth = np.array([[1.0, 0.0, 0.4]])
    with pytest.raises(AssertionError, match="outside the cone"):
        assert_impulses_of_bodies(numbers._replace(materials=smooth), trace)


def test_round_off_impulses_are_ignored():
    edge, where = (0.6, 0.8), "of it"
    assert_in_cone((-2e-19, 3e-19), edge, 1e-3, where)
    with pytest.raises(AssertionError, match="pulls"):
        assert_in_cone((-2e-17, 0.0), edge, 1e-3, where)
    with pytest.raises(AssertionError, match="outside the cone"):
        assert_in_cone((0.0, 2e-17), edge, 1e-3, where)


def test_energy_gain_is_caught(heap):
    subject, trace, numbers = heap
    assert_energy_of_steps(numbers, subject, trace)
    last = trace.arcs[-1]
    faster = dataclasses.replace(last, coefficients=last.coefficients * 1.5)
    with pytest.raises(AssertionError, match="energy grows"):
        assert_energy_of_steps(
            numbers, subject, dataclasses.replace(trace, arcs=(*trace.arcs[:-1], faster))
        )


def test_runs_by_steps_that_differ_are_reported_with_the_difference(heap):
    _, trace, _ = heap
    moved = dataclasses.replace(trace, final=trace.final + 1e-3)
    assert_same(trace, trace, Sensitivity((trace,), ()))
    with pytest.raises(AssertionError, match=r"the end: .* their errors explain \d"):
        assert_same(trace, moved, Sensitivity((trace,), ()))


def test_residuals_of_impulses_count_in_comparison_of_runs(heap):
    _, trace, _ = heap
    left = dataclasses.replace(trace, tolerances={**trace.tolerances, "impulse": 1e-6})
    sensitivity = Sensitivity((left,), ())
    near = dataclasses.replace(left, final=left.final * (1 + 1e-6))
    exact = dataclasses.replace(trace, tolerances={**trace.tolerances, "impulse": 0.0})
    moved = dataclasses.replace(exact, final=near.final)
    with pytest.raises(AssertionError, match="the end: "):
        assert_same(exact, moved, Sensitivity((exact,), ()))
    assert_same(left, near, sensitivity)
    with pytest.raises(AssertionError, match="the end: "):
        assert_same(left, dataclasses.replace(left, final=left.final * 1.001), sensitivity)
    parted = dataclasses.replace(left.jumps[0], cause="slip")
    with pytest.raises(Undecidable, match="use a smaller impulse_tolerance"):
        assert_same(left, dataclasses.replace(left, jumps=(parted, *left.jumps[1:])), sensitivity)


# Two plates close on a disc. Only errors of the impulses turn the plates.
JAWS = """
kind: scene
name: jaws
gravity: 9.81
bodies:
  left: {mass: 0.2, inertia: 1e-3, start: {x: -0.1, y: 0.08},
    shape: {polygon: [[-0.02, -0.06], [0.02, -0.06], [0.02, 0.06], [-0.02, 0.06]]}}
  right: {mass: 0.2, inertia: 1e-3, start: {x: 0.1, y: 0.08},
    shape: {polygon: [[-0.02, -0.06], [0.02, -0.06], [0.02, 0.06], [-0.02, 0.06]]}}
  box: {mass: 1, inertia: 0.00166, start: {y: 0.05},
    shape: {polygon: [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]}}
surfaces: {ground: {height: 0}}
collisions:
  hand: {bodies: [left, right, box], friction: 0.4, restitution: 0}
  floor: {bodies: [box], surfaces: [ground], friction: 0.5, restitution: 0}
joints:
  left_one: {point: {body: left, at: [-0.02, 0]}, to: {y: 0.08}}
  left_two: {point: {body: left, at: [0.02, 0]}, to: {y: 0.08}}
  right_one: {point: {body: right, at: [-0.02, 0]}, to: {y: 0.08}}
  right_two: {point: {body: right, at: [0.02, 0]}, to: {y: 0.08}}
forces:
  left: {body: left, force: [20 - 40*left.dx, 0]}
  right: {body: right, force: [-20 - 40*right.dx, 0]}
stop: {time: 0.09}
settings: {engine: impulse, step: 1e-3}
"""


def test_mirror_property_allows_residuals_of_impulses():
    scene = model(JAWS)
    image_property("mirror", scene, mirrored).holds(Subject(scene).case({}))


BOXES = """
kind: scene
name: boxes
gravity: 9.81
bodies:
BODIES
surfaces:
  low: {edge: [[-5, 0], [0.1, 0]]}
  middle: {edge: [[0.1, 0], [0.3, 0]]}
  rise: {edge: [[0.3, 0], [0.3, 0.263]]}
  high: {edge: [[0.3, 0.263], [0.3, 3]]}
collisions:
  all:
    bodies: [NAMES]
    surfaces: [low, middle, rise, high]
    friction: MU
    restitution: E
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
"""


@pytest.mark.parametrize(
    ("mu", "e", "boxes"),
    [
        # Pushed by another, with friction beside its support: its impulses are partly undetermined.
        (0.1, 0.5, [(0.8, 0.011, 0.1, 0.1, -0.1, 2), (0.6, 0.034, 0.075, 0.1, -0.44, 2.989)]),
        (0.1, 0.248, [(2, 0.046, 0.1, 0.1, -0.1, 2), (0.8, 0.033, 0.069, 0.1, -0.411, 2)]),
        # About to tip as it passes from one plate to the next.
        (0.5, 0, [(0.8, 0.025, 0.1, 0.2, -0.1, 1.14)]),
        # It falls beside the wall, which then bears nothing.
        (0.377, 0, [(1.5, 0.044, 0.1, 0.286, -0.1, 1.925)]),
    ],
)
def test_boxes_that_slide_into_each_other_and_a_wall_move_as_their_image(mu, e, boxes):
    """Friction in a corner stands in for what bears a box: its impulses are those nearest none."""
    bodies = "\n".join(
        f"  b{k}: {{mass: {m}, inertia: {inertia}, shape: {{polygon: [[-{w}, -{h}], [{w}, -{h}], "
        f"[{w}, {h}], [-{w}, {h}]]}}, start: {{x: {x}, y: {h}, dx: {dx}}}}}"
        for k, (m, inertia, w, h, x, dx) in enumerate(boxes)
    )
    names = ", ".join(f"b{k}" for k in range(len(boxes)))
    text = BOXES.replace("BODIES", bodies).replace("NAMES", names)
    scene = model(text.replace("MU", str(mu)).replace("restitution: E", f"restitution: {e}"))
    image_property("mirror", scene, mirrored).holds(Subject(scene).case({}))


def test_broken_mirror_symmetry_is_caught():
    def other(scene):
        image, reading = mirrored(scene)
        return image.model_copy(update={"gravity": (1e-3, image.gravity[1])}), reading

    scene = model(JAWS)
    with pytest.raises(AssertionError, match=r"right\.dx before"):
        image_property("mirror", scene, other).holds(Subject(scene).case({}))


# A point lands shortly before the run ends.
LANDING = """
kind: scene
name: landing
gravity: 9.81
bodies: {b: {mass: 1, start: {y: 0.1}}}
surfaces: {ground: {height: 0}}
contacts: {c: {point: {body: b}, surface: ground, friction: 0.5, restitution: 0}}
stop: {time: 0.144}
settings: {engine: impulse, step: 1e-3}
"""


def test_steps_with_impacts_have_no_force_check():
    subject = Subject(model(LANDING))
    trace = subject.case({}).trace
    assert trace.final_mode == ("pin",)
    assert_cone(subject.model, subject, trace)
    with pytest.raises(AssertionError, match="is nan"):
        assert_cone(subject.model, subject, dataclasses.replace(trace, step=None))


# A slow landing is caught by forces, without a jump that lists an impulse.
RISING = """
kind: scene
name: plate
gravity: 9.81
parameters: {u: 0.5, w: 0.2}
bodies: {ball: {mass: 1, start: {x: -0.1, y: 0.3}}}
surfaces: {plate: {line: [[0, 0], [1, 0.1]], displacement: ["w*time", "u*time"]}}
contacts: {c: {point: {body: ball}, surface: plate, friction: 0.3, restitution: 0.5}}
stop: {time: 1}
settings: {engine: impulse, step: 1e-3}
"""


@pytest.mark.parametrize("u", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("step", [4e-3, 1e-3, 3e-4])
def test_energy_counts_the_work_of_a_plate_that_catches_a_ball_slowly(u, step):
    scene = interpret(read_text(RISING))
    subject = Subject(scene)
    trace = statechart.run(scene, parameters={"u": u}, engine="impulse", step=step).trace
    mechanics = Mechanics(scene)
    assert_energy(mechanics, subject, trace)
    # A speed above the plate's after the catch would need extra work.
    last = trace.arcs[-1]
    faster = last.coefficients.copy()
    faster[len(faster) // 2 :, 3] *= 1.1
    arcs = [*trace.arcs[:-1], dataclasses.replace(last, coefficients=faster)]
    with pytest.raises(AssertionError, match="energy grows"):
        assert_energy(mechanics, subject, dataclasses.replace(trace, arcs=arcs))
