"""Bodies of several shapes, beside closed forms, plain bodies and other ways to cut them."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import statechart
from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.testing.body_properties import assert_depths, assert_energy_of_steps
from contacts.testing.symmetry import mirrored, rescaled
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner
from statechart.testing.subject import Subject

G = 9.81


def scene(bodies, surfaces, *, mu=0.0, e=0.0, step=1e-3, time=1.0, more=""):
    """Return a scene as text; `bodies`: name -> (its keys, its start)."""
    inside = "\n".join(f"  {n}: {{{what}, start: {{{s}}}}}" for n, (what, s) in bodies.items())
    grounds = "\n".join(f"  {name}: {{{text}}}" for name, text in surfaces.items())
    return f"""kind: scene
name: compounds
parameters: {{g: 9.81, r: 0.1, l: 0.4}}
gravity: g
bodies:
{inside}
surfaces:
{grounds}
collisions:
  all: {{bodies: [{", ".join(bodies)}], surfaces: [{", ".join(surfaces)}],
    friction: {mu}, restitution: {e}}}
{more}
stop: {{time: {time}}}
settings: {{engine: impulse, step: {step}, impulse_tolerance: 1e-10}}
"""


def run(text):
    trace = Runner(interpret(read_text(text))).run().trace
    assert trace.outcome is Outcome.HORIZON, trace.message
    return trace


def box(x0, x1, y0, y1):
    return f"{{polygon: [[{x0}, {y0}], [{x1}, {y0}], [{x1}, {y1}], [{x0}, {y1}]]}}"


def shaped(*parts, mass=1.0, inertia=0.05):
    return f"mass: {mass}, inertia: {inertia}, shape: [{', '.join(parts)}]"


DUMBBELL = shaped("{disc: r, at: [-l, 0]}", "{disc: r, at: [l, 0]}", box("-l", "l", -0.02, 0.02))
FLOOR = {"floor": "height: 0"}
SURFACES = {
    "line": ("line: [[-1, -1], [1, 1]]", lambda x, y: (y - x) / math.sqrt(2)),
    "plate": ("edge: [[-3, 0], [3, 0]]", lambda x, y: y),
    "post": ("circle: [0, -1], radius: 1", lambda x, y: math.hypot(x, y + 1) - 1),
    "drum": ("circle: [0, 0], radius: 2, hollow: true", lambda x, y: 2 - math.hypot(x, y)),
    "graph": ("height: 0*x", lambda x, y: y),
    "moved": ("height: 0, displacement: [0, -0.3]", lambda x, y: y + 0.3),
}


@pytest.mark.parametrize("form", SURFACES)
def test_a_dumbbell_is_as_far_from_a_surface_as_its_nearer_end(form):
    text, distance = SURFACES[form]
    x, y, angle = 0.3, 1.0, 0.4
    trace = run(
        scene({"bell": (DUMBBELL, f"x: {x}, y: {y}, angle: {angle}, dy: 0.5*g*1e-9")},
              {"s": text}, step=1e-9, time=1e-9)
    )  # fmt: skip
    ends = [(x + s * 0.4 * math.cos(angle), y + s * 0.4 * math.sin(angle)) for s in (-1, 1)]
    expected = min(distance(*end) for end in ends) - 0.1
    near = trace.margins.get("bell.gap", math.inf)
    assert near == pytest.approx(expected, abs=1e-8) or (expected > 0.1 and near == math.inf)


def falling(distance):
    return math.sqrt(2 * distance / G)


def test_a_dumbbell_falls_on_its_lower_disc_and_then_on_the_other():
    angle = 0.3
    text = scene({"bell": (DUMBBELL, f"y: 1, angle: {angle}")}, FLOOR, step=1e-4, time=1.5, mu=0.3)
    trace = run(text)
    first = trace.jumps[0]
    assert first.cause == "touchdown"
    assert first.t == pytest.approx(falling(1 - 0.1 - 0.4 * math.sin(angle)), abs=1.1e-4)
    # It may stay as deep as it lands.
    deepest = trace.tolerances["gap"]
    assert trace.final[1:3] == pytest.approx([0.1, 0.0], abs=deepest)
    assert deepest < 1e-3


@pytest.mark.parametrize("shape", ["{disc: r}", box(-0.1, 0.1, -0.05, 0.05)])
def test_a_list_of_one_shape_is_that_shape_bit_by_bit(shape):
    start, surfaces = (
        "x: 0.1, y: 0.5, angle: 0.7, dx: 1",
        {**FLOOR, "wall": "line: [[1, 0], [1, 1]]"},
    )
    plain = f"mass: 1, inertia: 0.05, shape: {shape}"
    one, other = (
        run(scene({"body": (what, start)}, surfaces, mu=0.4, e=0.3))
        for what in (plain, shaped(shape))
    )
    assert one.final.tolist() == other.final.tolist()


# An L of two arms, cut in three ways, about its centre of mass; the last two overlap.
ARM, WIDTH = 0.4, 0.1
AREA = 2 * ARM * WIDTH - WIDTH**2
MIDDLE = (ARM**2 / 2 * WIDTH + (ARM - WIDTH) * WIDTH**2 / 2) / AREA
LOW, HIGH, INNER = -MIDDLE, ARM - MIDDLE, WIDTH - MIDDLE
LS = {
    "upright": (box(LOW, INNER, LOW, HIGH), box(INNER, HIGH, LOW, INNER)),
    "lying": (box(LOW, HIGH, LOW, INNER), box(LOW, INNER, INNER, HIGH)),
    "crossing": (box(LOW, HIGH, LOW, INNER), box(LOW, INNER, LOW, HIGH)),
    "three": (
        box(LOW, INNER, LOW, INNER), box(INNER, HIGH, LOW, INNER), box(LOW, INNER, INNER, HIGH),
    ),
}  # fmt: skip


@pytest.mark.parametrize("cut", ["lying", "crossing", "three"])
@pytest.mark.parametrize("start", ["y: 0.5, angle: 0.4", "y: 0.5, angle: 2.4, dangle: 3, dx: 1"])
def test_l_shape_moves_equally_for_every_decomposition(cut, start):
    surfaces = {**FLOOR, "wall": "line: [[0.8, 0], [0.8, 1]]"}
    post = ("mass: 1, inertia: 1, shape: {disc: 0.05}", "x: 0.2, y: 0.05")
    one, other = (
        run(scene({"ell": (shaped(*LS[way]), start), "post": post}, surfaces, mu=0.3, time=0.6))
        for way in ("upright", cut)
    )
    assert any(jump.cause == "impact" or jump.region == "post" for jump in one.jumps)
    assert other.final == pytest.approx(one.final, abs=1e-6)


def test_an_l_moves_as_two_boxes_that_joints_weld():
    """The upright arm and the foot, each with the inertia that it has alone."""
    first, second = ARM * WIDTH, (ARM - WIDTH) * WIDTH
    centres = np.array([[WIDTH / 2, ARM / 2], [(ARM + WIDTH) / 2, WIDTH / 2]]) - MIDDLE
    sides = [(WIDTH, ARM), (ARM - WIDTH, WIDTH)]
    masses = [first, second]
    own = [m * (a * a + b * b) / 12 for m, (a, b) in zip(masses, sides, strict=True)]
    inertia = sum(own) + sum(m * (c @ c) for m, c in zip(masses, centres, strict=True))
    angle, height = 0.4, 0.6
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    whole = {"ell": (shaped(*LS["upright"], mass=first + second, inertia=inertia),
                     f"y: {height}, angle: {angle}")}  # fmt: skip
    welded = {}
    for name, mass, i, (a, b), c in zip("pq", masses, own, sides, centres, strict=True):
        x, y = turn @ c
        welded[name] = (
            f"mass: {mass}, inertia: {i}, shape: {box(-a / 2, a / 2, -b / 2, b / 2)}",
            f"x: {x}, y: {height + y}, angle: {angle}",
        )
    ends = [np.array([WIDTH, y]) - MIDDLE for y in (0.0, WIDTH)]
    joints = "joints:\n" + "".join(
        f"  j{k}: {{point: {{body: p, at: {list(map(float, e - centres[0]))}}}, "
        f"to: {{body: q, at: {list(map(float, e - centres[1]))}}}}}\n"
        for k, e in enumerate(ends)
    )
    one = run(scene(whole, FLOOR, mu=0.5, step=2.5e-4, time=0.8))
    other = run(scene(welded, FLOOR, mu=0.5, step=2.5e-4, time=0.8, more=joints))
    assert {jump.cause for jump in one.jumps} >= {"touchdown"}
    x, y, angle = one.final[:3]
    c, s = math.cos(angle), math.sin(angle)
    place = np.array([x, y]) + np.array([[c, -s], [s, c]]) @ centres[0]
    assert other.final[:2] == pytest.approx(place, abs=2e-3)
    assert other.final[2] == pytest.approx(angle, abs=5e-3)


@pytest.mark.parametrize("body", ["{disc: 0.1}", box(-0.1, 0.1, -0.1, 0.1)])
@pytest.mark.parametrize("overlap", [0.0, 0.3])
def test_bodies_slide_over_the_seam_of_two_parts(body, overlap):
    table = shaped(
        box(-2, overlap, -0.1, 0.1), box(-overlap, 2, -0.1, 0.1), mass=1000, inertia=1000
    )
    bodies = {
        "table": (table, "y: 0.1"),
        "slider": (f"mass: 1, inertia: 1, shape: {body}", "x: -1, y: 0.3, dx: 2"),
    }
    trace = run(scene(bodies, FLOOR, time=1.0))
    names = trace.variables
    final = dict(zip(names, trace.final.tolist(), strict=True))
    assert final["slider.x"] == pytest.approx(1.0, abs=1e-9)
    assert final["slider.dx"] == pytest.approx(2.0, abs=1e-12)
    assert final["slider.y"] == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize("cut", LS)
@pytest.mark.parametrize("body", ["{disc: 0.05}", box(-0.05, 0.05, -0.05, 0.05)])
@pytest.mark.parametrize("gravity", ["[0, -9.81]", "[-5, -5]", "[-9.81, 0]"])
def test_a_disc_in_the_angle_of_an_l_touches_both_arms(cut, body, gravity):
    """It comes down the one arm, or along the other, and stays in the angle."""
    bodies = {
        "ell": (shaped(*LS[cut], mass=1e6, inertia=1e6), ""),
        "lump": (
            f"mass: 1, inertia: 1, shape: {body}",
            f"x: {INNER + 0.07}, y: {INNER + 0.06}, dx: -0.5",
        ),
    }
    text = scene(bodies, {"far": "height: -9"}, time=1.0).replace("gravity: g", "gravity: 0")
    pull = gravity.strip("[]").split(",")
    force = f"forces: {{pull: {{body: lump, force: [{pull[0]}, {pull[1]}]}}}}\n"
    trace = run(text.replace("stop:", force + "stop:"))
    final = dict(zip(trace.variables, trace.final.tolist(), strict=True))
    beside = [final[f"lump.{c}"] - final[f"ell.{c}"] - INNER - 0.05 for c in "xy"]
    deepest = trace.tolerances["gap"]
    assert min(beside) >= -deepest
    if gravity != "[-9.81, 0]":
        assert beside == pytest.approx([0.0, 0.0], abs=deepest)


@pytest.mark.parametrize("cut", LS)
@pytest.mark.parametrize("off", [-1e-9, 0.0, 1e-12, 1e-9])
def test_a_box_that_slides_down_one_arm_lands_flat_on_the_other(cut, off):
    bodies = {
        "ell": (shaped(*LS[cut], mass=1e6, inertia=1e6), ""),
        "lump": (
            f"mass: 1, inertia: 1, shape: {box(-0.05, 0.05, -0.05, 0.05)}",
            f"x: {INNER + 0.05 + off}, y: {INNER + 0.0601}",
        ),
    }
    text = scene(bodies, {"far": "height: -9"}, time=0.3).replace("gravity: g", "gravity: 0")
    force = "forces: {pull: {body: lump, force: [0, -9.81]}}\n"
    trace = run(text.replace("stop:", force + "stop:"))
    final = dict(zip(trace.variables, trace.final.tolist(), strict=True))
    assert final["lump.x"] == pytest.approx(final["ell.x"] + INNER + 0.05, abs=1e-8)
    assert final["lump.angle"] == pytest.approx(0.0, abs=1e-6)


def test_two_parts_that_make_one_face_slide_over_a_floor():
    skid = shaped(box(-0.5, 0, -0.1, 0.1), box(0, 0.5, -0.1, 0.1), "{disc: 0.1, at: [0.2, 0]}")
    trace = run(scene({"skid": (skid, "y: 0.1, dx: 1")}, FLOOR, mu=0.1, time=0.5))
    assert trace.final[0] == pytest.approx(0.5 - 0.1 * G * 0.125, abs=1e-6)
    assert trace.final[1:3] == pytest.approx([0.1, 0.0], abs=1e-12)


def test_an_eccentric_disc_rocks_about_its_lowest_place():
    """Rolling without slip: (I + m |r|^2) a'' = -m g c sin a for small angles."""
    c, r, inertia, angle = 0.04, 0.1, 0.006, 0.05
    body = f"mass: 1, inertia: {inertia}, shape: {{disc: r, at: [0, {c}]}}"
    x, y = c * math.sin(angle), r - c * math.cos(angle)
    text = scene({"egg": (body, f"x: {x}, y: {y}, angle: {angle}")}, FLOOR, mu=5, step=2e-4)
    rate = math.sqrt(G * c / (inertia + (r - c) ** 2))
    half = math.pi / rate
    trace = run(text.replace("time: 1.0", f"time: {half}"))
    assert trace.final[2] == pytest.approx(-angle, rel=1e-2)


CROSS = shaped(
    box(-0.1, 0.1, -0.02, 0.02),
    box(-0.02, 0.02, -0.1, 0.1),
    "{disc: 0.03, at: [0.1, 0]}",
    inertia=0.01,
)
EVERY = {
    "bowl": "circle: [0, 0.6], radius: 0.8, hollow: true",
    "hill": "height: 0.05*cos(5*x) - 0.1",
    "shelf": "edge: [[-0.3, 0.2], [0, 0.25]]",
}


def heap(count, **values):
    starts = {
        f"cross{k}": (CROSS, f"x: {0.1 * math.sin(3 * k)}, y: {0.4 + 0.25 * k}, angle: {0.7 * k}")
        for k in range(count)
    }
    return scene(starts, EVERY, **values)


@pytest.mark.parametrize(("mu", "e"), [(0.0, 1.0), (0.5, 0.3), (2.0, 0.0)])
def test_energy_and_depth_of_a_heap_stay_within_the_bounds_of_a_step(mu, e):
    subject = Subject(interpret(read_text(heap(4, mu=mu, e=e, step=2e-3))))
    trace = subject.case({}).trace
    assert trace.outcome.succeeded, trace.message
    numbers = body_numbers(subject.model, subject.model.values())
    assert_energy_of_steps(numbers, subject, trace)
    assert_depths(numbers, trace)


@pytest.mark.parametrize("e", [0.0, 0.03125, 0.1, 0.25])
def test_discs_that_fall_on_jacks_do_not_penetrate_them(e):
    subject = Subject(statechart.load("jacks"))
    assert_depths(body_numbers(subject.model, subject.model.values()), subject.case({"e": e}).trace)


@pytest.mark.parametrize("change", [mirrored, rescaled])
def test_transformed_heaps_have_transformed_runs(change):
    declared = interpret(read_text(heap(2, mu=0.4, e=0.2, time=0.5)))
    changed, reading = change(declared)
    one, other = (Runner(model).run().trace for model in (declared, changed))
    assert one.outcome is Outcome.HORIZON, one.message
    assert {jump.cause for jump in one.jumps} >= {"touchdown", "impact"}
    assert other.final * reading.factors == pytest.approx(one.final, abs=1e-6)


def test_a_compound_hangs_on_a_joint_as_a_pendulum():
    c, inertia, angle = 0.3, 0.02, 0.1
    body = f"mass: 1, inertia: {inertia}, shape: [{{disc: 0.1}}, {box(-0.02, 0.02, 0, 0.3)}]"
    start = f"x: {c * math.sin(angle)}, y: {2 - c * math.cos(angle)}, angle: {angle}"
    joint = f"joints: {{pin: {{point: {{body: bob, at: [0, {c}]}}, to: [0, 2]}}}}"
    half = math.pi * math.sqrt((inertia + c * c) / (G * c)) * (1 + angle**2 / 16)
    trace = run(scene({"bob": (body, start)}, FLOOR, time=half, more=joint))
    assert trace.final[2] == pytest.approx(-angle, rel=1e-3)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (
            "{polygon: [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]}",
            "corner 4, at (1, 1), points inwards; split it from there to corner 1: shape: "
            "[{polygon: corners 4, 5, 6, 1}, {polygon: corners 1, 2, 3, 4}]",
        ),
        (
            "[{disc: 1}, {polygon: [[0, 0], [1, 0], [0.2, 0.2], [0, 1]]}]",
            "corner 3, at (0.2, 0.2), points inwards; split it from there to corner 1",
        ),
        ("[{disc: 1}, {disc: 0}]", "must be positive, not 0"),
        ("[{disc: 1}, {}]", "a shape is a polygon or a disc"),
        ("{polygon: [[0, 0], [1, 0], [0, 1]], at: [1, 0]}", "a polygon has no at"),
        ("{disc: 1, at: [k, 0]}", "unknown name 'k'"),
        ("{disc: 1, at: [inf, 0]}", "must be finite"),
        (json.dumps([{"disc": 1}] * 17), "16"),
    ],
)
def test_invalid_shapes_are_refused_with_their_place(shape, words):
    text = scene({"body": (f"mass: 1, inertia: 1, shape: {shape}", "y: 9")}, FLOOR)
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(text, "c.yaml"))
    assert words in str(caught.value)
    assert caught.value.line == 1 + text[: text.index("shape:")].count("\n")


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ("y: 0.09", "0.01 deep in surface 'floor'; move it by (0, 0.01) out"),
        ("y: 1, x: 0.91", "0.01 deep in body 'other'; move it by (-0.01, 0) out"),
    ],
)
def test_a_compound_that_starts_inside_a_body_is_reported_with_its_name(start, words):
    other = ("mass: 1, inertia: 1, shape: {disc: 0.1}", "x: 1.5, y: 1")
    text = scene({"bell": (DUMBBELL, start), "other": other}, FLOOR)
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(text, "c.yaml")).start()
    assert "body 'bell' starts " + words in str(caught.value)
    assert caught.value.line == 6


def test_a_point_on_the_seam_of_two_pieces_counts_as_inside():
    # It is nearest to the covered sides of two boxes side by side.
    boxes = shaped(box(-1, 0, -0.5, 0.5), box(0, 1, -0.5, 0.5))
    small = "mass: 1, inertia: 1, shape: {polygon: [[-0.05, -0.05], [0.05, -0.05], [0, 0.1]]}"
    bodies = {"boxes": (boxes, "y: 0.5"), "small": (small, "x: 0.02, y: 0.6")}
    # Neither a disc around the one nor one around the other is left at that distance.
    far = math.hypot(1, 0.5) + math.hypot(0, 0.1)
    with pytest.raises(DeclarationError) as caught:
        run(scene(bodies, FLOOR))
    assert (
        "small.start: body 'small' starts 0.07 deep in body 'boxes'; start it "
        f"{far:.6g} from the centre of 'boxes', or move it out"
    ) in str(caught.value)
