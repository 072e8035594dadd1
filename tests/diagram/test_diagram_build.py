"""Automata, and runs of them, as diagrams."""

from __future__ import annotations

from dataclasses import replace

import pytest
from runs import automaton, run

from statechart.automaton.product import feasibility
from statechart.diagram.build import build, needs_run
from statechart.diagram.dot import dot
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

SWITCH = """
  {name}:
    initial: off
    states: {{off: {{flows: {{x{name}: 1}}}}, on: {{flows: {{x{name}: 1}}}}}}
    transitions:
      - {{name: turn, from: off, to: on, guard: x{name} >= {when}}}
      - {{name: back, from: on, to: off, guard: x{name} >= 1, updates: {{x{name}: 0}}}}
"""


def switches(count: int) -> Runner:
    names = "abcdefgh"[:count]
    variables = ", ".join(f"x{name}: 0" for name in names)
    regions = "".join(
        SWITCH.format(name=name, when=0.3 + 0.1 * i).rstrip() for i, name in enumerate(names)
    )
    text = (
        f"kind: chart\nname: switches\nvariables: {{{variables}}}\nstop: {{time: 1.9}}\n"
        f"regions:{regions}\n"
    )
    return Runner(read_text(text))


BAR = """\
kind: scene
name: bar
gravity: 9.81
bodies: {bar: {mass: 1, inertia: 0.1, start: {y: 1}}}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: bar, at: [-1, 0]}, surface: floor, friction: 0.5, restitution: 0}
  B: {point: {body: bar, at: [1, 0]}, surface: floor, friction: 0.5, restitution: 0}
stop: {time: 0.1}
"""


def test_one_contact_is_drawn_with_its_directions_of_sliding() -> None:
    runner = Runner("toppling_stick")
    diagram = build(runner.automaton, runner.start()[0])
    assert [node.label for node in diagram.nodes] == ["free", "slide+", "slide-", "pin"]
    assert diagram.groups["slide"] == diagram.nodes[1:3]
    assert diagram.initial is not None
    assert diagram.initial.label == "pin"
    assert diagram.nodes[1].invariants == ("V >= 0", "slip >= 0")
    assert diagram.nodes[2].invariants == ("V >= 0", "slip <= 0")
    assert all(part.visits is None for part in (*diagram.nodes, *diagram.links))


def test_two_contacts_have_nine_modes_and_guards_of_both_directions() -> None:
    runner = Runner(read_text(BAR))
    assert not needs_run(runner.automaton)
    diagram = build(runner.automaton, runner.start()[0])
    assert len(diagram.nodes) == 9
    slips = [link for link in diagram.links if link.cause == "A slip"]
    assert {link.guard for link in slips} == {"H < -mu V or H > mu V"}
    assert {(link.source, link.target) for link in slips} == {
        (f"pin {other}", f"slide {other}") for other in ("free", "slide", "pin")
    }


def test_counts_follow_the_jumps_of_the_run() -> None:
    runner = switches(2)
    trace = runner.run().trace
    diagram = build(runner.automaton, trace.start_mode, trace)
    taken = sum(link.visits or 0 for link in diagram.links)
    assert taken == len(trace.jumps) == 6
    assert len(diagram.path) == len(trace.modes)
    entered = {node.name: node.visits for node in diagram.nodes}
    assert entered == {name: diagram.path.count(name) for name in entered}
    assert entered["off off"] == 2


def test_of_too_many_modes_those_visited_are_drawn_beside_every_region() -> None:
    runner = switches(5)
    assert runner.automaton.modes_declared == 32
    assert needs_run(runner.automaton)
    with pytest.raises(ValueError, match="as a run visited it"):
        build(runner.automaton, runner.start()[0])
    trace = runner.run().trace
    diagram = build(runner.automaton, trace.start_mode, trace)
    visited = diagram.groups["modes of the run"]
    assert {node.name for node in visited} == {" ".join(key) for key in trace.modes}
    assert len(diagram.nodes) == len(visited) + 5 * 2
    assert any("too many modes" in note for note in diagram.notes)


def test_a_jump_of_several_regions_at_once_is_a_link_of_its_own() -> None:
    runner = switches(2)
    trace = runner.run().trace
    both = replace(trace.jumps[0], target=("on", "on"))
    diagram = build(
        runner.automaton, trace.start_mode, replace(trace, jumps=(both, *trace.jumps[1:]))
    )
    (link,) = [
        link for link in diagram.links if link.source == "off off" and link.target == "on on"
    ]
    assert (link.cause, link.visits) == ("a turn", 1)


def test_modes_that_are_not_possible_say_why_unless_the_run_went_there() -> None:
    runner = Runner(read_text(BAR))
    setup = runner.setup()
    found = feasibility(runner.automaton, setup, setup.initial, 0.0)
    start = runner.start()[0]
    diagram = build(runner.automaton, start, None, found)
    refused = {node.name: node.infeasible for node in diagram.nodes if node.infeasible}
    assert set(refused) == {"slide pin", "pin slide"}
    assert refused["slide pin"] == "B without slip leaves A no slip"
    assert any(note.startswith("infeasible: ") for note in diagram.notes)
    grey = dot(diagram)
    assert grey.count("infeasible: ") >= 2
    trace = runner.run().trace
    went = replace(trace, start_mode=("slide+", "pin"), jumps=())
    shown = build(runner.automaton, start, went, found)
    assert {node.name for node in shown.nodes if node.infeasible} == {"pin slide"}


def test_regions_that_differ_by_a_number_share_one_chart():
    trace = run("rimless_wheel", "taylor", until=2.0)
    diagram = build(automaton("rimless_wheel"), trace.start_mode, trace)
    groups = dict.fromkeys(node.group for node in diagram.nodes)
    assert list(groups) == [
        "modes of the run",
        "s0, s1, s2, s3",
        "s4, s5, s6, ... s15 (12 in all); numbers of s4",
    ]
