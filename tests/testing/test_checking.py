"""Property tests: broken laws and automata are caught and shrunk."""

import dataclasses
import json

import numpy as np
import pytest
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.kind import automaton as scene_automaton
from contacts.testing.scene_properties import assert_energy, assert_gaps
from contacts.testing.scene_properties import properties as contact_properties
from contacts.testing.symmetry import LENGTH, TIMES, image_property, mirrored, rescaled
from statechart.automaton.regions import State
from statechart.automaton.trace import sizes
from statechart.charts.chart import Chart
from statechart.charts.laws import automaton as chart_automaton
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret, load
from statechart.testing.agreement import Reading
from statechart.testing.checking import check, examine
from statechart.testing.guards import assert_invariants, assert_margins, dense
from statechart.testing.properties import assert_engines_agree, assert_prefix, generic
from statechart.testing.subject import Subject, ranges


def model(text):
    return interpret(read_text(text))


BALL = """
kind: chart
name: ball
parameters: {height: 1, g: 9.81, k: 0.5}
ranges: {height: [0.5, 2], k: [0.1, 0.9]}
variables: {x: height, v: 0}
regions:
  ball:
    initial: flight
    states:
      flight:
        flows: {x: v, v: -g}
        invariants: {above ground: x >= 0, not too fast: v**2 + 2*g*x <= 2.001*g*height}
      rest: {}
    transitions:
      - {name: bounce, from: flight, to: flight, guard: x <= 0, updates: {x: 0, v: -k*v}}
      - {name: settle, from: flight, to: rest, on: zeno, updates: {x: 0, v: 0}}
stop: {time: 2}
"""

ROD = """
kind: scene
name: block
parameters: {v0: 1, vy: -1, mu: 0.3, e: 0.5, g: 9.81}
ranges: {v0: [-2, 2], vy: [-3, 3], e: [0, 0.8]}
gravity: g
bodies:
  block: {mass: 2, start: {x: 1, y: 1, dx: v0, dy: vy}}
surfaces:
  ground: {height: 0}
contacts:
  base:
    point: {body: block}
    surface: ground
    friction: mu
    restitution: e
stop: {time: 1}
"""

SLIDING = ROD.replace("y: 1, dx: v0, dy: vy", "dx: v0").replace("v0: [-2, 2]", "v0: [1, 5]")

# Fingers on springs press a block a hundred times harder than it weighs; it rests between them.
GRIPPER = """
kind: scene
name: gripper
parameters: {F: 800, k: 2, a: -0.05, w: 0.05, more: 0}
ranges: {F: [300, 1000], k: [1, 100], a: [-0.3, 0.3]}
gravity: 9.81
coordinates: {l: {start: -w}, r: {start: w}}
bodies:
  block: {mass: 1, inertia: w**2, start: {angle: a}}
  one: {mass: 0.1, position: [l*cos(a), l*sin(a)], angle: a}
  two: {mass: 0.1, position: [r*cos(a), r*sin(a)], angle: a}
surfaces:
  near: {line: [[-w, -1], [-w, 1]], body: block}
  far: {line: [[w, 1], [w, -1]], body: block}
contacts:
  left: {point: {body: one}, surface: near, friction: 0.5, restitution: 0}
  right: {point: {body: two}, surface: far, friction: 0.5, restitution: 0}
forces:
  push: {body: one, force: [(F + more - k*(l + w))*cos(a), (F + more - k*(l + w))*sin(a) + 0.981]}
  hold: {body: two, force: [-(F + k*(r - w))*cos(a), -(F + k*(r - w))*sin(a) + 0.981]}
stop: {time: 1}
"""

UNSTABLE = """
kind: chart
name: unstable
parameters: {a: 0.7, b: 0.7}
ranges: {a: [0.5, 0.9]}
variables: {x: a - b, y: b}
regions:
  r:
    initial: s
    states: {s: {flows: {x: 30*x + sin(y) - sin(b), y: 0}}}
stop: {time: 1}
"""


def report_on(subject, name, examples=15, seed=3):
    everything = (
        *generic(subject),
        *(contact_properties(subject.model) if subject.model.kind == "scene" else ()),
    )
    chosen = [item for item in everything if item.name == name]
    assert len(chosen) == 1
    return examine(subject, chosen, examples=examples, seed=seed)


def failure(subject, name, **options):
    report = report_on(subject, name, **options)
    assert not report.passed
    return report.properties[0].failure


class Altered:
    """Laws with one changed part."""

    def __init__(self, laws, **changes):
        self._laws = laws
        self._changes = changes

    def __getattr__(self, name):
        if name in self._changes:
            return lambda *arguments: self._changes[name](
                getattr(self._laws, name)(*arguments), *arguments
            )
        return getattr(self._laws, name)


def scene_with(changed_jump):
    scene = model(ROD)
    automaton = scene_automaton(scene)
    laws = Altered(automaton.laws, jump=changed_jump)
    return Subject(scene, dataclasses.replace(automaton, laws=laws))


def with_jump(**fields):
    def change(made, *arguments):
        if made is None:
            return None
        jump, flow = made
        return dataclasses.replace(
            jump, **{key: compute(jump) for key, compute in fields.items()}
        ), flow

    return change


def with_states(scene, change):
    automaton = scene_automaton(scene)
    regions = tuple(
        dataclasses.replace(
            region, build=lambda role, build=region.build: change(role.state, build(role))
        )
        for region in automaton.regions
    )
    return Subject(scene, dataclasses.replace(automaton, regions=regions))


CARRIED = """
kind: scene
name: carried
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 0.1}}}
surfaces: {belt: {height: 0, displacement: [s, 0]}}
contacts: {foot: {point: {body: ball}, surface: belt, friction: 0.3, restitution: 0}}
regions:
  drive: {initial: runs, variables: {s: 0}, states: {runs: {flows: {s: 1}}}}
stop: {time: 0.5}
"""


def test_a_good_chart_passes_every_property():
    report = check(model(BALL), examples=np.int64(6), seed=np.int64(1))
    assert report.passed, report.text()
    assert not any(result.skipped for result in report.properties)
    assert json.loads(json.dumps(report.to_json()))["seed"] == 1


def test_a_good_scene_passes_every_property():
    report = check(model(ROD), examples=6, seed=1)
    assert report.passed, report.text()


@pytest.mark.parametrize("e", [1e-4, 1e-6])
def test_round_off_of_an_impact_explains_the_duration_of_the_next_flight(e):
    case = Subject(model(ROD)).case({"vy": 0.0, "e": e})
    first, *others = case.sensitivity.conditions
    assert first < 1.0
    assert others[0] == pytest.approx(first / e)
    assert_prefix(case)


def test_a_reset_that_gains_speed_breaks_the_invariant():
    faulty = model(BALL.replace("v: -k*v", "v: -k*v*2.2"))
    found = failure(Subject(faulty), "declared invariants hold")
    assert "ball.not too fast" in found.message


def test_a_dropped_guard_breaks_the_invariant_with_all_parameters_as_declared():
    text = "\n".join(line for line in BALL.splitlines() if "name: bounce" not in line)
    found = failure(Subject(model(text)), "declared invariants hold")
    assert "above ground" in found.message
    assert found.parameters == {}


def test_shrunk_failure_reproduces_from_yaml():
    faulty = model(BALL.replace("v: -k*v", "v: '-k*v*(1 + 9*max(0, k - 0.7))'"))
    found = failure(Subject(faulty), "declared invariants hold", examples=60)
    assert set(found.parameters) == {"k"}  # height does not matter and is as declared
    assert 0.7 < found.parameters["k"] <= 0.9
    again = model(found.reproduction)
    assert isinstance(again, Chart)
    assert again.values()["k"] == found.parameters["k"]
    assert failure(Subject(again), "declared invariants hold", examples=1).parameters == {}


GROWING = """
kind: chart
name: growing
parameters: {a: 1, b: 1}
ranges: {a: [0, 10], b: [0, 10]}
variables: {x: 0}
regions:
  it:
    initial: on
    states: {on: {flows: {x: a + b}, invariants: {outside: IN_STATE}}}
stop: {time: 5}
invariants: {far: IN_RUN}
"""


@pytest.mark.parametrize("where", ["IN_STATE", "IN_RUN"])
def test_an_invariant_that_is_broken_for_a_moment_is_caught(where):
    # For 4e-4 of 5 about the time at which x passes 1, between any samples.
    broken = "exp(-((x - 1)/1e-3)**2) <= 0.9"
    faulty = (
        GROWING.replace(where, broken).replace("IN_STATE", "x >= -1").replace("IN_RUN", "x >= -1")
    )
    found = failure(Subject(model(faulty)), "declared invariants hold", examples=1)
    assert "falls to -0.1 between t = 0 and 5" in found.message


@pytest.mark.parametrize("broken", ["k <= 2", "x >= -1", "x <= 19"])
def test_an_invariant_violated_in_a_state_without_duration_is_caught(broken):
    # In a mode of no duration, and after the jump that the run ends with.
    text = """
kind: chart
name: passing
variables: {x: 0, k: 0}
regions:
  it:
    initial: a
    states: {a: {flows: {x: 1}}, b: {flows: {x: 1}}, c: {flows: {x: 1}}, d: {}}
    transitions:
      - {name: down, from: a, to: b, guard: x >= 1, updates: {x: -7, k: 3}}
      - {name: back, from: b, to: c, guard: x <= -6, updates: {x: 0.5, k: 1}}
      - {name: up, from: c, to: d, guard: x >= 1, updates: {x: 20}}
stop: {time: 3, conditions: {far: x >= 19.5}}
"""
    sound = "invariants: {at most: x <= 20, few: k <= 3, at least: x >= -7}\n"
    assert check(model(text + sound), examples=1).passed
    found = failure(
        Subject(model(f"{text}invariants: {{it: {broken}}}\n")),
        "declared invariants hold",
        examples=1,
    )
    assert "the margin of 'it' is -" in found.message


def test_check_finds_a_failure_in_a_corner_of_the_ranges():
    # In 5e-5 of the square that is varied, by the largest of both.
    faulty = GROWING.replace("IN_STATE", "x >= -1").replace("IN_RUN", "x <= 99.5")
    found = failure(Subject(model(faulty)), "declared invariants hold", examples=200)
    assert found.parameters["a"] + found.parameters["b"] > 19.9


def test_an_impact_that_gains_energy_is_caught():
    def faster(jump):
        after = jump.after.copy()
        if jump.cause == "touchdown":
            after[3] *= 1.5
        return after

    change = with_jump(after=faster)

    def energetic(made, *arguments):
        return change(made, *arguments)

    scene = model(ROD.replace("e: [0, 0.8]", "e: [0.75, 0.8]"))
    automaton = scene_automaton(scene)
    laws = Altered(automaton.laws, jump=energetic)
    subject = Subject(scene, dataclasses.replace(automaton, laws=laws))
    assert "energy grows" in failure(subject, "energy never grows").message


def test_work_of_the_drive_is_no_energy_gain():
    driven = ROD + "forces:\n  push: {body: block, force: [30*sin(5*time), 0]}\n"
    assert report_on(Subject(model(driven)), "energy never grows").passed


def test_body_pressed_beyond_its_weight_gains_no_energy():
    subject = Subject(model(GRIPPER))
    assert subject.case({}).trace.modes == (("pin", "pin"),)
    report = report_on(subject, "energy never grows", examples=40)
    assert report.passed, report.text()


def test_an_undeclared_part_of_a_large_force_is_caught():
    def judge(declared):
        assert_energy(Mechanics(declared), subject, pushed)

    subject = Subject(model(GRIPPER))
    pushed = subject.case({"more": 800e-7}).trace
    judge(subject.model)
    with pytest.raises(AssertionError, match="energy grows"):
        judge(model(GRIPPER.replace(" + more", "")))


def test_missing_gap_guard_is_caught():
    def blind(name, state):
        return State(state.equations, ()) if name == "free" else state

    found = failure(with_states(model(ROD), blind), "no contact is inside its surface")
    assert "deep in its surface" in found.message


def test_a_point_that_slides_is_not_inside_its_surface_by_an_interpolant():
    # Steps are so long that dense output in between is off by 1.3 of the tolerance of gaps.
    scene = load("toppling_stick")
    subject = Subject(scene)
    for trace in subject.case({"mu": 0.0, "I_G": 1.0, "theta0": 0.25}).traces.values():
        assert_gaps(scene, subject, trace)
        arc = max(trace.arcs, key=lambda arc: arc.duration)
        coefficients = arc.coefficients.copy()
        coefficients[len(coefficients) // 2, 1, 0] -= 1e-10
        sunk = dataclasses.replace(
            trace, arcs=(dataclasses.replace(arc, coefficients=coefficients),)
        )
        with pytest.raises(AssertionError, match="deep in its surface"):
            assert_gaps(scene, subject, sunk)


def test_a_contact_that_sinks_between_steps_is_inside_its_surface():
    # It sinks by some tolerances of the gap in a step, and comes back at its end.
    def sinking(name, state):
        if name == "free":
            return state
        return dataclasses.replace(
            state, equations=(state.equations[0] + 1e-8, *state.equations[1:])
        )

    scene = model(ROD)
    subject = with_states(scene, sinking)
    trace = subject.case({"v0": 2.0, "vy": -1.0, "e": 0.0}).traces["scipy"]
    with pytest.raises(AssertionError, match="deep in its surface"):
        assert_gaps(scene, subject, trace)


def test_adhesion_is_caught():
    def sticky(name, state):
        margins = tuple(
            dataclasses.replace(margin, expression=margin.expression + 1000)
            if margin.kind == "force"
            else margin
            for margin in state.margins
        )
        return State(state.equations, margins)

    pulled = model(SLIDING + "forces:\n  lift: {body: block, force: [0, 100*time]}\n")
    found = failure(with_states(pulled, sticky), "V >= 0 and |H| <= mu V")
    assert "base.V is -" in found.message


def test_a_force_outside_the_cone_is_caught():
    def rough(name, state):
        # Twice the friction that was declared.
        if not name.startswith("slide"):
            return state
        normal, edge = state.equations
        H = next(s for s in edge.free_symbols if s.name.startswith("H"))
        return State((normal, edge - edge.coeff(H) * H / 2), state.margins)

    found = failure(with_states(model(SLIDING), rough), "V >= 0 and |H| <= mu V")
    assert "mu V - |H|" in found.message


def test_a_pulling_impulse_is_caught():
    subject = scene_with(
        with_jump(impulse=lambda jump: {k: (-n, t) for k, (n, t) in jump.impulse.items()})
    )
    assert "pulls" in failure(subject, "impulses push, within friction").message


def test_impulses_on_a_surface_that_a_controller_moves_are_checked():
    report = check(model(CARRIED), examples=1, seed=1)
    assert report.passed, report.text()


def test_an_impulse_outside_the_cone_is_caught():
    subject = scene_with(
        with_jump(impulse=lambda jump: {k: (n, 0.31 * n) for k, (n, _) in jump.impulse.items()})
    )
    assert "outside the cone" in failure(subject, "impulses push, within friction").message


def test_a_force_without_contact_is_caught():
    def pushing(name, state):
        if name != "free":
            return state
        V, H = state.equations
        return State((V - 1, H), state.margins)

    found = failure(with_states(model(ROD), pushing), "no force without contact")
    assert "has a force" in found.message


def test_a_jump_that_is_no_edge_is_caught():
    subject = scene_with(with_jump(cause=lambda jump: "teleport"))
    assert "no such edge" in failure(subject, "every jump is an edge").message


def test_a_jump_back_in_time_is_caught():
    subject = scene_with(with_jump(t=lambda jump: jump.t / 2))
    assert "does not begin" in failure(subject, "events are ordered in time").message


def test_a_state_that_changes_without_a_jump_is_caught():
    subject = scene_with(with_jump(before=lambda jump: jump.before + 1e-6))
    assert "without a jump" in failure(subject, "arcs are continuous").message


def test_a_start_that_is_not_the_declared_one_is_caught():
    scene = model(ROD)
    automaton = scene_automaton(scene)

    def stopped(began, *arguments):
        flow, state = began
        return flow, np.concatenate([state[:2], np.zeros(2)])

    laws = Altered(automaton.laws, begin=stopped)
    subject = Subject(scene, dataclasses.replace(automaton, laws=laws))
    assert "starts at 0" in failure(subject, "runs start as declared").message


COUNTED = """
kind: chart
name: counted
variables: {rounds: 0, x: 1}
regions:
  machine:
    initial: runs
    states:
      runs:
        initial: slow
        entry: {rounds: rounds + 1}
        states: {slow: {flows: {x: 1}}}
stop: {time: 1}
"""


def test_variables_that_an_entry_of_an_initial_state_updates_are_not_compared_with_the_start():
    assert report_on(Subject(model(COUNTED)), "runs start as declared").passed


def test_a_start_beside_entry_updates_that_is_not_the_declared_one_is_caught():
    chart = model(COUNTED)
    automaton = chart_automaton(chart)
    laws = Altered(automaton.laws, begin=lambda began, *arguments: (began[0], began[1] + 1))
    subject = Subject(chart, dataclasses.replace(automaton, laws=laws))
    assert "x starts at 2, declared is 1" in failure(subject, "runs start as declared").message


def test_an_asymmetric_law_breaks_the_mirror():
    # Friction that pushes to the right only, which laws can express but no declared scene.
    def drifting(name, state):
        if name != "free":
            return state
        V, H = state.equations
        return State((V, H - sp.Rational(1, 100)), state.margins)

    found = failure(with_states(model(ROD), drifting), "the mirror image moves as the image")
    assert "block" in found.message


def test_unit_dependence_is_caught():
    def dragged(made, *arguments):
        if made is None:
            return None
        jump, flow = made
        after = jump.after.copy()
        if jump.cause == "touchdown":
            after[3] *= 1 - 0.1 * np.tanh(abs(after[3]))
        return dataclasses.replace(jump, after=after), flow

    found = failure(scene_with(dragged), "other units give the same motion")
    assert "their errors explain" in found.message


def test_engine_disagreement_is_caught():
    subject = Subject(model(BALL))
    other = Subject(model(BALL.replace("g: 9.81", "g: 9.8100001")))
    subject.observers["scipy"] = other.observers["scipy"]
    found = failure(subject, "engines agree")
    assert "bounce" in found.message or "end" in found.message


def test_grown_errors_count_as_undecidable():
    # An error grows by e^30 = 1e13 in the run: two runs can differ by anything.
    report = report_on(Subject(model(UNSTABLE)), "engines agree", examples=1)
    assert report.passed
    (result,) = report.properties
    assert result.undecidable == result.examples > 0
    assert "grown too large" in result.reason
    assert "undecidable" in report.text()


def test_a_variable_that_is_zero_at_every_event_has_the_size_of_its_path():
    """A ball thrown up at 3 m/s from the ground is 0.45 m high between two events at x = 0."""
    thrown = """
kind: chart
name: thrown
parameters: {g: 10, v0: 3, k: 0.5}
variables: {x: 0, v: v0}
regions:
  ball:
    initial: flight
    states: {flight: {flows: {x: v, v: -g}}, hop: {flows: {x: v, v: -g}}, rest: {}}
    transitions:
      - {name: bounce, from: flight, to: hop, guard: x <= 0, updates: {x: 0, v: -k*v}}
      - {name: land, from: hop, to: rest, guard: x <= 0, updates: {x: 0, v: 0}}
stop: {time: 1}
"""
    case = Subject(model(thrown)).case({})
    assert [jump.t for jump in case.trace.jumps] == pytest.approx([0.6, 0.9])
    assert sizes(case.trace)[0] == pytest.approx(0.45)
    assert_engines_agree(case)
    assert_prefix(case)


def test_errors_that_stay_small_are_decided():
    steady = model(
        UNSTABLE.replace("a: 0.7", "a: 0.9").replace("ranges: {a: [0.5", "ranges: {a: [0.8")
    )
    report = report_on(Subject(steady), "engines agree")
    assert report.properties[0].undecidable == 0


def test_ranges_that_allow_no_model_are_a_failure_of_the_ranges():
    # Either alone is; with both at their ends nothing is left of the mass.
    ends = "e: [0, 0.8], mu: [0, 0.5]"
    scene = model(ROD.replace("mass: 2", "mass: mu + e").replace("e: [0, 0.8]", ends))
    report = check(scene, examples=30, seed=2)
    first = report.properties[0]
    assert first.failure is not None
    assert "the ranges contain values that make no valid model" in first.failure.message
    assert "mass" in first.failure.message
    assert first.failure.parameters == {"mu": 0.0, "e": 0.0}


def test_a_run_that_cannot_go_on_is_a_failure():
    stuck = BALL.replace("on: zeno", "guard: x >= 5")
    found = failure(Subject(model(stuck)), "runs come to their end")
    assert found.message.startswith("run ended: ZENO")


def test_ranges_are_derived_where_none_are_declared():
    scene = model("\n".join(line for line in ROD.splitlines() if not line.startswith("ranges")))
    found = ranges(scene)
    assert found["v0"] == (0.5, 2.0)
    assert found["vy"] == (-2.0, -0.5)
    assert found["e"] == (0.25, 1.0)  # a restitution of 1.0 is the largest there is
    assert check(scene, examples=3, seed=1).passed


def test_the_same_seed_gives_the_same_report():
    one, other = (check(model(BALL), examples=4, seed=7).to_json() for _ in range(2))
    assert one == other
    json.dumps(one)


def test_the_text_lists_skipped_and_failed_properties():
    faulty = model(BALL.replace("v: -k*v", "v: -k*v*2.2"))
    text = check(faulty, examples=3, seed=1).text()
    assert "FAILED" in text
    assert "with the declared parameters" in text or "with k" in text
    scene = check(model(ROD), examples=2, seed=1).text()
    assert "skipped: no invariants are declared" in scene
    assert scene.endswith("passed\n")


def test_the_number_of_examples_is_positive():
    with pytest.raises(DeclarationError, match="examples"):
        check(model(BALL), examples=0)


def test_the_dense_grid_has_no_step_end():
    trace = Subject(model(ROD)).case({}).trace
    for arc, tau in dense(trace):
        assert (np.diff(tau) > 0).all()
        assert not set(tau) & set(arc.times)


def test_mirroring_twice_gives_the_run_itself():
    scene = load("toppling_stick")
    once, reading = mirrored(scene)
    twice, _ = mirrored(once)
    assert (reading.factors == [-1, 1, -1, -1, 1, -1]).all()
    start = Subject(scene).case({}).trace
    assert (Subject(twice).case({}).trace.final == start.final).all()
    assert (Subject(once).case({}).trace.initial * reading.factors == start.initial).all()


def test_terrain_with_literal_lengths_is_rescaled():
    scene, reading = rescaled(load("bouncing_ball_hills"))
    assert reading.time == 1 / TIMES
    assert f"x/({LENGTH!r})" in scene.surfaces["hills"].height


def test_a_formula_too_long_to_transform_is_skipped_with_the_reason():
    long = " + ".join(["x"] * 130)
    scene = model(ROD.replace("height: 0", f"height: {long}"))
    skipped = {item.name: item.skipped for item in contact_properties(scene)}
    assert "cannot be transformed" in skipped["other units give the same motion"]
    assert not skipped["energy never grows"]


def test_most_accurate_run_is_computed_first():
    subject = Subject(model(BALL))
    subject.observers["scipy"] = None
    assert subject.case({}).trace.engine.startswith("taylor")


def test_examples_without_a_taylor_series_leave_earlier_ones_as_they_are():
    subject = Subject(
        model(
            """
kind: scene
name: pulled
bodies: {b: {mass: 1, start: {x: 1.8}}}
parameters: {L: 1.5}
forces: {pull: {body: b, force: [sqrt(b.x - L), 0]}}
stop: {time: 2}
"""
        )
    )
    earlier = subject.case({})
    assert [*earlier.traces] == ["taylor", "scipy"]
    assert [*subject.case({"L": 1.8}).traces] == ["scipy"] == [*subject.engines]
    assert "no Taylor series" in subject.missing["taylor"]
    assert earlier.trace.engine.startswith("taylor")
    assert subject.mode(earlier.trace, earlier.trace.arcs[0]).margins == ()
    assert earlier.shorter(1.0).engine.startswith("taylor")


def test_readings_are_the_identity_by_default():
    assert Reading().factors == 1.0
    assert Reading().time == 1.0


def test_a_flight_shorter_than_earlier_round_off_passes_no_guard():
    subject = Subject(load("bouncing_ball_chart"))
    for trace in subject.case({"k": 1.07e-301}).traces.values():
        assert_margins(subject, trace)
        assert_invariants(subject, trace)


SHAKEN = """
kind: scene
name: shaken
parameters: {g: 1, mu: 0.4, e: 0.3, A: 0.1, w: 5, a0: 0.1}
ranges: {mu: [0, 1], e: [0, 0.9], A: [0.05, 0.3], a0: [-0.5, 0.5]}
gravity: g
bodies: {rod: {mass: 1, inertia: 0.3, start: {y: 0.6, angle: a0}}}
surfaces: {floor: {height: 0, displacement: [A*sin(w*time)/2, A*sin(w*time)]}}
contacts:
  left: {point: {body: rod, at: [-1, 0]}, surface: floor, friction: mu, restitution: e}
  right: {point: {body: rod, at: [1, 0]}, surface: floor, friction: mu, restitution: e}
stop: {time: 2}
"""


def test_the_work_of_a_shaken_floor_is_no_gain_of_energy() -> None:
    scene = model(SHAKEN)
    subject = Subject(scene)
    energy = next(p for p in contact_properties(scene) if p.name == "energy never grows")
    case = subject.case({"A": 0.2, "a0": 0.05})
    assert max(trace.jumps[-1].j for trace in case.traces.values()) >= 3
    # It does grow: the floor throws the rod up.
    trace = case.trace
    gains = [jump.energy[1] - jump.energy[0] for jump in trace.jumps if jump.energy is not None]
    assert max(gains) > 1e-3
    energy.holds(case)


def test_limits_of_a_joint_change_places_in_the_mirror() -> None:
    """A door with dry friction strikes its greater angle; its image strikes the lesser one."""
    scene = interpret(
        read_text(
            """
kind: scene
name: door
bodies: {d: {mass: 4, inertia: 0.8, start: {x: 0.4, dangle: 3, dy: 1.2}}}
joints:
  h: {point: {body: d, at: [-0.4, 0]}, to: [0, 0], limits: [-1, 1.2], restitution: 0.3}
couplings: {f: {joint: h, limit: 0.9}}
stop: {time: 3}
"""
        )
    )
    (trace,) = Subject(scene).case({}).sound[:1]
    assert [jump.region for jump in trace.jumps] == ["h_max", "f"]
    image_property("mirror", scene, mirrored).holds(Subject(scene).case({}))


def test_an_open_coupling_with_an_infinite_limit_has_no_couple() -> None:
    scene = model("""
kind: scene
name: rotor
bodies: {rotor: {mass: 3, inertia: 2, start: {dangle: 3}}}
joints: {pivot: {point: {body: rotor}, to: [0, 0], enabled: time <= 1}}
couplings: {bearing: {joint: pivot, limit: "exp(1000*max(time - 1.5, 0))"}}
stop: {time: 3}
""")
    properties = {one.name: one for one in contact_properties(scene)}
    case = Subject(scene).case({})
    assert [jump.region for jump in case.trace.jumps] == ["pivot", "bearing"]
    properties["couples are within their limits"].holds(case)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_slips_along_a_guide_turn_round_in_the_mirror_if_it_is_level(axis: str) -> None:
    other = {"x": "y", "y": "x"}[axis]
    scene = model(f"""
kind: scene
name: slider
bodies: {{s: {{mass: 2, start: {{d{axis}: 2}}}}}}
joints: {{rail: {{point: {{body: s}}, to: {{{other}: 0}}}}}}
couplings: {{rub: {{joint: rail, limit: 3}}}}
stop: {{time: 3}}
""")
    (trace,) = Subject(scene).case({}).sound[:1]
    assert [(jump.source, jump.target) for jump in trace.jumps] == [(("slip+",), ("locked",))]
    image_property("mirror", scene, mirrored).holds(Subject(scene).case({}))


def test_force_whose_sign_changes_at_a_time_leaves_no_gap_between_arcs():
    report = check(
        model("""
kind: scene
name: pushed
bodies: {b: {mass: 1}}
forces: {f: {body: b, force: ["2*sign(time - 0.05)", 0]}}
stop: {time: 0.25}
"""),
        examples=1,
        seed=1,
    )
    assert report.passed
