"""Bodies that collide by their shapes, on the impulse-based engine."""

from __future__ import annotations

import math
import pickle
import re
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from strategies import examples

from contacts.collision_detection.convex import FOUND, ConvexShape, place_vertices, shape_contacts
from statechart.automaton.trace import Outcome
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, StatechartError
from statechart.loading.load import interpret
from statechart.running.runner import Runner


@pytest.fixture(scope="module")
def dice():
    return Runner("dice").run()


def test_the_dice_come_to_rest_and_overlap_by_less_than_an_eighth_of_an_edge(dice):
    trace = dice.trace
    assert trace.outcome is Outcome.HORIZON
    rates = trace.final[len(trace.final) // 2 :]
    assert np.abs(rates).max() < 1e-9
    assert min(trace.margins.values()) >= -0.016 / 8
    assert set(trace.final_mode) == {"pin"}
    assert trace.regions == tuple(f"die{k}" for k in range(10))


def test_the_energy_of_the_dice_grows_by_no_more_than_the_bound_of_a_step(dice):
    trace = dice.trace
    times = 8e-4 * np.arange(2501)
    times[-1] = trace.t_end
    energy = dice.observer.sample(trace, ["energy"], times=times).columns["energy"]
    mass = 10 * 1200 * 0.016**3
    assert np.diff(energy).max() <= mass * 9.81**2 * 8e-4**2 / 8


def test_every_jump_of_the_dice_is_an_edge_of_their_regions(dice):
    edges = {(e.cause, e.source, e.target) for e in dice.observer.automaton.regions[0].edges}
    for jump in dice.trace.jumps:
        place_ = dice.trace.regions.index(jump.region)
        assert (jump.cause, jump.source[place_], jump.target[place_]) in edges


def test_the_number_of_copies_is_a_parameter():
    result = Runner("dice").run({"n": 2}, until=0.01)
    assert len(result.trace.variables) == 12


def test_runs_with_other_copies_are_composed_once_and_do_not_mix_their_parameters():
    runner = Runner("dice")
    first, again = (runner.run({"n": 2, "throw": 1.5}, until=0.01) for _ in range(2))
    assert again.observer.automaton is first.observer.automaton
    assert again.trace.final.tolist() == first.trace.final.tolist()
    slower = runner.run({"n": 2}, until=0.01).trace
    assert slower.final.tolist() == Runner("dice").run({"n": 2}, until=0.01).trace.final.tolist()
    assert slower.final.tolist() != first.trace.final.tolist()


def test_a_stack_of_boxes_stays_at_rest():
    result = Runner("box_stack").run()
    assert result.outputs["fastest"] < 1e-10
    assert result.outputs["top"] == pytest.approx(0.45, abs=1e-12)


def test_a_stack_that_overhangs_topples():
    result = Runner("box_stack").run({"offset": 0.09})
    assert result.outputs["fastest"] > 0.1


TWO = """
kind: scene
name: two
gravity: 1
bodies:
  block:
    copies: 2
    mass: 1
    inertia: 1
    start: {y: 1 + 3*index}
    shape: {polygon: [[-1, -1], [1, -1], [1, 1], [-1, 1]]}
surfaces:
  ground: {height: 0}
collisions:
  all: {bodies: [block], surfaces: [ground], friction: 1, restitution: 0}
stop: {time: 1}
settings: {engine: impulse, step: 1e-2}
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[[-1, -1], [1, -1], [1, 1], [-1, 1]]", "[[-1, -1], [-1, 1], [1, 1]]", "convex"),
        ("[[-1, -1], [1, -1], [1, 1], [-1, 1]]", "[[-1, -1], [-1, 1], [1, 1]]", "clockwise"),
        ("[1, 1], [-1, 1]]", "[0, 0], [1, 1], [-1, 1]]", r"corner 3, at \(0, 0\), points inwards"),
        ("[1, 1], [-1, 1]]", "[1, 0], [1, 1], [-1, 1]]", r"corner 3, at \(1, 0\), lies on"),
        ("copies: 2", "copies: 1.5", "whole number"),
        ("bodies: [block], surf", "bodies: [brick], surf", "no body 'brick'"),
        ("    inertia: 1\n", "", "needs an inertia; write inertia: m"),
        ("restitution: 0", "restitution: 2", "between 0 and 1"),
    ],
)
def test_wrong_declarations_are_refused(old, new, words):
    with pytest.raises(DeclarationError, match=words):
        interpret(read_text(TWO.replace(old, new)))


def test_bodies_that_overlap_at_the_start_are_refused():
    # The lower one has nowhere to go.
    words = r"body 'block1' starts 0.5 deep in body 'block0'; move it by \(0, 0.5\) out"
    with pytest.raises(DeclarationError, match=words):
        Runner(interpret(read_text(TWO.replace("3*index", "1.5*index")))).run()
    with pytest.raises(
        DeclarationError, match=r"0.25 deep in surface 'ground'.*by \(0, 0.25\) out"
    ):
        Runner(interpret(read_text(TWO.replace("1 + 3*index", "0.75 + 3*index")))).run()
    row = TWO.replace("copies: 2", "copies: 3").replace("3*index", "1.875*index")
    with pytest.raises(DeclarationError, match=r"3 bodies overlap, by 0\.125 at"):
        Runner(interpret(read_text(row))).run()


def test_a_body_that_starts_inside_pieces_is_reported_by_name():
    """It starts at the end of a plate in overlapping pieces, where no face has a contact."""
    shape = "{polygon: [[-1, -1], [1, -1], [1, 1], [-1, 1]]}"
    halves = ", ".join(f"{{polygon: [[{x}, -1], [{x} + 1, -1], [{x} + 1, 1], [{x}, 1]]}}"
                       for x in (-1, 0))  # fmt: skip
    plates = "low: {edge: [[-9, -9], [9, -9]]}, plate: {edge: [[0.1, 0], [0.1, 5]]}"
    text = TWO.replace("copies: 2", "copies: 1").replace(shape, f"[{halves}]")
    text = text.replace("{y: 1 + 3*index}", "{}").replace("surfaces: [ground]", "surfaces: [plate]")
    text = text.replace("  ground: {height: 0}", f"  {plates}".replace(", plate", "\n  plate"))
    for listed in ("[plate]", "[low, plate]"):
        with pytest.raises(DeclarationError, match="deep in surface 'plate'; start") as caught:
            Runner(read_text(text.replace("[plate]", listed))).run()
        far = float(re.findall(r"start its centre (\S+) from it", str(caught.value))[0])
        moved = text.replace("start: {}", f"start: {{x: 0.1 - {far}}}").replace("[plate]", listed)
        Runner(read_text(moved)).start()


def test_a_body_inside_several_things_is_advised_a_way_out_of_all():
    wall = "  ground: {height: 0}\n  wall: {line: [[-0.7, 5], [-0.7, -5]]}"
    wedged = TWO.replace("copies: 2", "copies: 1").replace("1 + 3*index", "0.5")
    wedged = wedged.replace("  ground: {height: 0}", wall)
    wedged = wedged.replace("surfaces: [ground]", "surfaces: [ground, wall]")
    with pytest.raises(DeclarationError, match="move it by") as caught:
        Runner(interpret(read_text(wedged))).run()
    x, y = re.findall(r"by \((.*), (.*)\) out", str(caught.value))[0]
    assert (float(x), float(y)) == pytest.approx((0.3, 0.5))
    Runner(interpret(read_text(wedged.replace("y: 0.5", f"x: {x}, y: 0.5 + {y}")))).start()
    walls = f"{wall}\n  other: {{line: [[0.9, -5], [0.9, 5]]}}"
    narrow = TWO.replace("  ground: {height: 0}", walls)
    narrow = narrow.replace("surfaces: [ground]", "surfaces: [ground, wall, other]")
    with pytest.raises(DeclarationError, match="no small move frees it"):
        Runner(interpret(read_text(narrow))).run()


def test_overlaps_of_copies_by_a_parameter_are_reported():
    text = TWO.replace("copies: 2", "copies: n").replace("3*index", "(4 - n)*index")
    text += "parameters: {n: 1}\n"
    runner = Runner(read_text(text, "two.yaml"))
    runner.run()
    with pytest.raises(DeclarationError, match=r"two\.yaml:\d+:\d+: bodies\.block\.start.* n = 3"):
        runner.run({"n": 3})


def test_infinite_corners_are_reported_with_their_line():
    text = TWO.replace("[1, 1], [-1, 1]]", "[1, 1], [-1, a]]") + "parameters: {a: 1}\n"
    runner = pickle.loads(pickle.dumps(Runner(read_text(text, "two.yaml"))))
    place = r"two\.yaml:11:\d+: bodies\.block\.shape\.polygon\.3.*"
    for value, words in ((math.inf, "must be finite"), (-1.0, "corners 1 and 4 are in one place")):
        with pytest.raises(DeclarationError, match=f"{place}{words}.* .with a = {value:g}."):
            runner.run({"a": value})


def test_likely_mistakes_of_bodies_with_shapes_give_warnings():
    text = TWO.replace("  ground: {height: 0}", "  ground: {height: 0}\n  wall: {height: -9}")
    text = text.replace("start: {", "start: {angle: 90, ").replace(
        "surfaces:\n",
        "  idle: {mass: 1, inertia: 1, shape: {disc: 1}, start: {x: 9}}\nsurfaces:\n",
        1,
    )
    text = text.replace("y: 1 + 3", "y: 2 + 3")
    assert Runner(interpret(read_text(text))).run().trace.warnings[:3] == (
        "bodies.block.start.angle: 90 radians are 14.3 turns; of degrees write 90*pi/180",
        "bodies.idle: it collides with nothing; list it in bodies of collisions, if it should",
        "surfaces.wall: it collides with nothing; list it in surfaces of collisions, if it should",
    )


def test_a_path_without_a_start_is_reported_with_its_line():
    text = TWO.replace("{height: 0}", "{height: 0, displacement: [0, 1/time]}")
    with pytest.raises(DeclarationError, match=r":13:\d+: surfaces\.ground\.displacement: has no"):
        Runner(read_text(text, "two.yaml")).run()


def test_a_step_in_the_file_needs_no_engine_where_auto_takes_steps():
    text = TWO.replace("engine: impulse, step: 1e-2", "step: 0.004, impulse_tolerance: 1e-8")
    assert Runner(read_text(text)).run().trace.step == 0.004


def test_engines_with_events_name_the_engine_for_shapes():
    with pytest.raises(StatechartError, match="or take impulse"):
        Runner(interpret(read_text(TWO)), engine="scipy").run()


def test_a_body_may_touch_as_many_others_as_there_are():
    text = """
kind: scene
name: press
gravity: 1
bodies:
  disc: {mass: 1, inertia: 1, start: {y: 1}, shape: {disc: 1}}
surfaces: {CEILINGS, ground: {height: 0}}
collisions: {all: {bodies: [disc], surfaces: [NAMES, ground], friction: 0, restitution: 0}}
stop: {time: 1}
settings: {engine: impulse, step: 1e-2}
"""
    ceilings = [f"ceiling{k}" for k in range(60)]
    text = text.replace("CEILINGS", ", ".join(f"{c}: {{line: [[1, 2], [0, 2]]}}" for c in ceilings))
    trace = Runner(interpret(read_text(text.replace("NAMES", ", ".join(ceilings))))).run().trace
    assert trace.outcome is Outcome.HORIZON
    # The ground comes last.
    assert np.abs(trace.final - trace.initial).max() < 1e-12


SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.2, 3.2), st.floats(-3.2, 3.2))
@examples(200)
def test_contacts_of_two_squares_agree_with_their_corners(x, y, one_angle, other_angle):
    one, other = (
        place_vertices(SQUARE, 0.0, 0.0, one_angle),
        place_vertices(SQUARE, x, y, other_angle),
    )
    found, swapped = np.zeros((16, FOUND)), np.zeros((16, FOUND))
    centre, away = np.zeros(2), np.array([x, y])
    features = np.zeros(16, dtype=np.int64)
    first, second = ConvexShape(one, centre, 0.0), ConvexShape(other, away, 0.0)
    count = shape_contacts(first, second, 0.1, found, features)
    again = shape_contacts(second, first, 0.1, swapped, features)
    assert (count > 0) == (again > 0)
    normals = found[:count, :2]
    assert np.hypot(*normals.T) == pytest.approx(np.ones(count))
    if count:
        # No point is deeper than the bodies overlap along the normal.
        n = found[0, :2]
        separation = (one @ n).min() - (other @ n).max()
        assert found[:count, 4].min() >= separation - 1e-9


def test_the_first_listed_corner_does_not_change_the_motion():
    # A bar on its way down to the long side of a tooth: either could be the face that is touched.
    tooth, bar = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 1.0]]), SQUARE * [0.05, 1.0]
    lean, middle = math.atan2(0.3, 1.0), tooth.mean(axis=0)
    beside = np.array([0.15 + 0.05 * math.cos(lean), 0.5 + 0.05 * math.sin(lean)])
    for turn in np.linspace(-3e-3, 3e-3, 61):
        placed, answers = place_vertices(bar, *beside, lean + turn), []
        for first in range(3):
            found = np.zeros((16, FOUND))
            count = shape_contacts(
                ConvexShape(np.roll(tooth, first, axis=0), middle, 0.0),
                ConvexShape(placed, beside, 0.0),
                0.1,
                found,
                np.zeros(16, dtype=np.int64),
            )
            answers.append(sorted(found[:count].tolist()))
        assert len(answers[0]) == 2
        assert np.ptp(answers, axis=0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("gap", [1e-11, -1e-6])
def test_a_tip_on_a_face_strikes_no_corner_that_it_is_about_to_pass(gap):
    """The side of the tip that faces the end of the box is as near, to a thousandth of a size."""
    box = SQUARE * 0.5 - [0.5, 0.5]
    tip = np.array([[-2e-4, gap], [1.0, 0.5], [-0.5, 2.0]])
    for shapes in ((tip, box), (box, tip)):
        found = np.zeros((16, FOUND))
        both = (ConvexShape(corners, corners.mean(axis=0), 0.0) for corners in shapes)
        assert shape_contacts(*both, 0.01, found, np.zeros(16, dtype=np.int64)) > 0
        assert np.abs(found[0, :2]) == pytest.approx([0.0, 1.0], abs=1e-12)
        assert found[:1, 4] == pytest.approx(gap, abs=1e-15)


def test_a_hundred_grains_collapse_without_sinking_into_each_other():
    runner = Runner("granular_column")
    trace = runner.run({"n": 100}, until=0.3).trace
    assert trace.outcome is Outcome.HORIZON
    # The penetration is a step at the fastest approach, not a tenth of a grain.
    assert min(trace.margins.values()) >= -trace.tolerances["gap"]


def test_dice_overlap_by_less_than_a_step_at_their_fastest_approach(dice):
    assert min(dice.trace.margins.values()) >= -dice.trace.tolerances["gap"]


def test_bodies_that_collide_are_listed_and_drawn_with_their_path(tmp_path, capsys):
    assert main(["modes", "box_stack"]) == 0
    assert "243 modes" in capsys.readouterr().out
    path = tmp_path / "stack.dot"
    assert main(["draw", "box_stack", "-o", str(path), "--visited"]) == 0
    assert "pin" in path.read_text()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--step", "0.5"], 1, "STEP_TOO_LARGE"),
        (["--step", "0.1"], 1, "STEP_TOO_LARGE"),
        (["--engine", "scipy"], 2, "scipy cannot run bodies that collide by their shapes; leave"),
        (["--budget", "1"], 2, "give a step"),
        (["--set", "n=0"], 2, "whole number"),
        (["--set", "e=2"], 2, "between 0 and 1"),
        (["--set", "mu=-1"], 2, "must be zero or positive, not -1"),
        (["--set", "a=-0.01"], 2, "must be positive"),
    ],
)
def test_scenes_that_cannot_run_by_steps_give_advice(options, code, words, capsys):
    assert main(["run", "dice", "--until", "0.5", *options]) == code
    printed = capsys.readouterr()
    assert words in printed.out + printed.err
    assert "internal" not in printed.err


@cache
def fallen(simultaneous, step):
    """Return a runner of a box that falls on an incline, without gravity."""
    text = f"""
kind: scene
name: fallen
gravity: 0
parameters: {{w: 0.3, h: 0.2, I: 0.1, lean: 0, tilt: 0, u: 0, v: -1, gap: 0.002, mu: 0.5, e: 0.5}}
bodies:
  box:
    mass: 1
    inertia: I
    shape: {{polygon: [[-w, -h], [w, -h], [w, h], [-w, h]]}}
    start:
      angle: lean + tilt
      x: -sin(lean)*(gap + w*abs(sin(tilt)) + h*cos(tilt))
      y: cos(lean)*(gap + w*abs(sin(tilt)) + h*cos(tilt))
      dx: u*cos(lean) - v*sin(lean)
      dy: u*sin(lean) + v*cos(lean)
surfaces: {{slope: {{incline: lean}}}}
collisions: {{all: {{bodies: [box], surfaces: [slope], friction: mu, restitution: e}}}}
simultaneous: {simultaneous}
stop: {{time: 0.008}}
settings: {{engine: impulse, step: {step}}}
"""
    return Runner(interpret(read_text(text)))


@given(
    st.fixed_dictionaries(
        {
            "w": st.floats(0.1, 0.5),
            "h": st.floats(0.1, 0.5),
            "I": st.floats(0.02, 0.3),
            "lean": st.floats(-1.0, 1.0),
            "u": st.floats(-1.0, 1.0),
            "v": st.floats(-1.0, -0.3),
            "mu": st.sampled_from([0.0]) | st.floats(0.0, 1.5),
            "e": st.floats(0.1, 1.0),
        }
    ),
    st.sampled_from([0.0]) | st.floats(0.1, 0.5) | st.floats(-0.5, -0.1),
)
@example(
    {"w": 0.5, "h": 0.25, "I": 0.25, "lean": 1.0, "u": 0.0, "v": -1.0, "mu": 0.0, "e": 1.0}, 0.0
)
@examples(20)
def test_plastic_bodies_that_are_hit_together_do_not_rebound(values, tilt):
    values["tilt"] = tilt
    plastic = fallen("plastic", 1e-3).run(values)
    # Flat, both corners are hit; tilted, one is, which has its own law.
    other = values if tilt else {**values, "e": 0.0}
    alike = fallen("capped", 1e-3).run(other)
    assert plastic.trace.jumps
    assert plastic.trace.final == pytest.approx(alike.trace.final, abs=1e-12)


SHAPES = "collisions: {all: {bodies: [box], surfaces: [slope], friction: 0.3, restitution: 0.5}}"
CORNERS = """
contacts:
  left: {point: {body: box, at: [-w, -h]}, surface: slope, friction: 0.3, restitution: 0.5}
  right: {point: {body: box, at: [w, -h]}, surface: slope, friction: 0.3, restitution: 0.5}
"""


@pytest.mark.parametrize("touching", [SHAPES, CORNERS])
def test_a_box_that_lands_flat_at_an_edge_of_a_step_rebounds_flat(touching):
    shape = "shape: {polygon: [[-w, -h], [w, -h], [w, h], [-w, h]]}" if touching == SHAPES else ""
    start = "x: -sin(lean)*(gap + h), y: cos(lean)*(gap + h), dx: sin(lean), dy: -cos(lean)"
    runner = Runner(interpret(read_text(f"""
kind: scene
name: flat
gravity: 0
parameters: {{w: 0.3, h: 0.2, lean: 0, gap: 0.002}}
bodies:
  box:
    mass: 1
    inertia: 0.05
    start: {{angle: lean, {start}}}
    {shape}
surfaces: {{slope: {{incline: lean}}}}
{touching}
stop: {{time: 0.006}}
settings: {{engine: impulse, step: 1e-3}}
""")))  # fmt: skip
    for gap in (1e-3, 1.5e-3, 2e-3, 2.5e-3):
        for lean in (0.0, 0.1234, 0.3, 1.0, -0.7):
            for w, h in ((0.3, 0.2), (0.5, 0.25), (0.123, 0.777)):
                trace = runner.run({"gap": gap, "lean": lean, "w": w, "h": h}).trace
                rates = [0.5 * -np.sin(lean), 0.5 * np.cos(lean), 0.0]
                assert trace.final[3:] == pytest.approx(rates, abs=1e-9)


def test_round_off_friction_is_ignored():
    smooth, rough = (fallen("capped", 1e-3).run({"mu": mu, "u": 1.0}) for mu in (0.0, 1e-14))
    assert smooth.trace.final.tolist() == rough.trace.final.tolist()


BOARD = """
kind: scene
name: board
bodies:
  bullet:
    mass: 1
    inertia: 1
    shape: {polygon: [[-1, -1], [1, -1], [1, 1], [-1, 1]]}
    start: {x: -5.5, dx: 10}
  board: {mass: 1, inertia: 1e3, shape: {polygon: [[-0.1, 0.5], [0.1, 0.5], [0.1, 9], [-0.1, 9]]}}
collisions: {all: {bodies: [bullet, board], friction: 0, restitution: 1}}
stop: {time: 2}
settings: {engine: impulse, step: 1}
"""


def test_a_step_in_which_a_body_would_turn_by_more_than_half_a_turn_is_taken_in_parts():
    # Struck off its centre it would turn by some six radians in the step.
    trace = Runner(read_text(BOARD, "board.yaml")).run().trace
    assert trace.outcome is Outcome.HORIZON
    assert any("had to be split into up to" in warning for warning in trace.warnings)
    assert trace.counts["steps"] > 2
    energy, momentum = (trace.final[[6, 9]] ** 2).sum(), trace.final[[6, 9]].sum()
    spin = trace.final[8] ** 2 + 1e3 * trace.final[11] ** 2
    assert momentum == pytest.approx(10, abs=1e-9)
    assert energy + spin == pytest.approx(100, rel=1e-6)


WALL = """
kind: scene
name: wall
parameters: {v: 1e4, y: 0.1, w: 0.001, far: 3}
bodies:
  bullet: {mass: 1, inertia: 1, shape: SHAPE, start: {y: y, dx: v}}
  wall:
    mass: 1
    inertia: 1e9
    shape: {polygon: [[-w, -0.5], [w, -0.5], [w, 0.5], [-w, 0.5]]}
    start: {x: far, y: 0.5}
collisions: {all: {bodies: [bullet, wall], friction: 0, restitution: 1}}
stop: {time: 0.02}
settings: {engine: impulse, step: 1e-3}
"""
SQUARE_OF_A_BULLET = "{polygon: [[-0.01, -0.01], [0.01, -0.01], [0.01, 0.01], [-0.01, 0.01]]}"


@pytest.mark.parametrize("shape", ["{disc: 0.01}", SQUARE_OF_A_BULLET])
@pytest.mark.parametrize("y", [0.1, 0.9])
def test_a_body_that_crosses_a_thin_wall_within_a_step_strikes_it(shape, y):
    """It goes 10 m in a step; nothing is lost, and all of its momentum is the wall's."""
    trace = Runner(interpret(read_text(WALL.replace("SHAPE", shape)))).run({"y": y}).trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.final[[6, 9]] == pytest.approx([0.0, 1e4], abs=1e-5)
    # Wherever the wall is within the step.
    runner = Runner(interpret(read_text(WALL.replace("SHAPE", shape))))
    for far in (0.5 + 0.41 * k for k in range(50)):
        final = runner.run({"y": y, "far": far}).trace.final
        assert final[[6, 9]] == pytest.approx([0.0, 1e4], abs=1e-5)
    # Beside its end nothing is in the way.
    free = Runner(interpret(read_text(WALL.replace("SHAPE", shape)))).run({"y": 1.02}).trace
    assert free.final[[6, 9]] == pytest.approx([1e4, 0.0], abs=0.0)


@pytest.mark.parametrize(
    ("settings", "reported"),
    [
        ("{engine: taylor}", "two.yaml:3:20: settings.engine: the engine taylor cannot run bodies"),
        ("{tolerance: 1e-6}", "two.yaml:3:12: settings.tolerance: the engine impulse has no tol"),
        ("{max_step: 1}", "two.yaml:3:12: settings.max_step: the engine impulse has no max_step"),
    ],
)
def test_settings_unfit_for_collisions_are_reported_with_their_place(
    settings, reported, tmp_path, capsys
):
    path = tmp_path / "two.yaml"
    path.write_text(
        f"kind: scene\nname: two\nsettings: {settings}\nstop: {{time: 1}}\n"
        "bodies: {ball: {mass: 1, inertia: 0.1, shape: {disc: 0.1}, start: {y: 1}}}\n"
        "surfaces: {floor: {height: 0}}\n"
        "collisions: {all: {bodies: [ball], surfaces: [floor], friction: 0, restitution: 0}}\n"
    )
    for verb in ("validate", "run"):
        assert main([verb, str(path)]) == 2
        assert reported in capsys.readouterr().err
