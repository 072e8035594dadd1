"""Automata, and runs of them, as diagrams."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from runs import automaton, run

from statechart.automaton.product import feasibility
from statechart.diagram.build import build, mode_label, needs_run
from statechart.diagram.dot import dot
from statechart.diagram.legend import GUARDS, legend
from statechart.diagram.mermaid import mermaid
from statechart.documents.yaml_reader import read_text
from statechart.running.drawing import drawn
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


MODES = ("free", "slide", "pin")

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


def test_one_contact_is_drawn_as_boxes_in_boxes() -> None:
    runner = Runner("toppling_stick")
    diagram = build(runner.automaton, runner.start()[0])
    (chart,) = diagram.charts
    inside = {node.name: node.inside for node in chart.nodes}
    assert inside == {
        "free": None, "closed": None, "pin": "closed", "slide": "closed",
        "slide+": "slide", "slide-": "slide",
    }  # fmt: skip
    assert [node.name for node in chart.leaves] == ["free", "slide+", "slide-", "pin"]
    assert chart.initial is not None
    assert chart.initial.label == "pin"
    held = {node.name: node.invariants for node in chart.nodes}
    assert held["slide+"] == ("V >= 0", "slip >= 0")
    assert held["slide-"] == ("V >= 0", "slip <= 0")
    assert all(part.visits is None for part in (*diagram.nodes, *diagram.links))
    ends = {(link.source, link.cause, link.target) for link in chart.links}
    assert {("closed", "liftoff", "free"), ("free", "touchdown", "closed")} <= ends
    # If the stick turns so fast that its tip recedes, the impact ends in flight.
    assert {("free", "touchdown", "free"), ("slide", "stick", "pin")} <= ends
    assert sum(link.cause in ("liftoff", "touchdown", "stick") for link in chart.links) == 4


def test_places_that_a_joint_captures_are_not_drawn_as_formulas() -> None:
    text = (
        "kind: scene\nname: s\nbodies: {b: {mass: 1, inertia: 1}}\n"
        "joints: {j: {point: {body: b, at: [1, 0]}, to: [0, time], angle: held, rest: captured, "
        "enabled: time >= 1}}\nstop: {time: 2}\n"
    )
    runner = Runner(read_text(text))
    (chart,) = build(runner.automaton, runner.start()[0]).charts
    assert [(node.name, node.actions) for node in chart.nodes] == [("off", ()), ("closed", ())]
    assert [(link.cause, link.reset) for link in chart.links] == [("disable", ""), ("enable", "")]


def test_a_compliant_contact_is_free_above_its_surface_or_where_it_would_pull() -> None:
    runner = Runner("soft_landing")
    diagram = build(runner.automaton, runner.start()[0])
    held = {node.name: node.invariants for node in diagram.charts[0].nodes}
    assert held["free"] == ("gap >= 0 or pull >= 0",)


def test_a_choice_of_targets_shows_the_reset_of_each() -> None:
    runner = Runner("toppling_stick")
    (chart,) = build(runner.automaton, runner.start()[0]).charts
    resets = {link.target: link.reset for link in chart.links if link.cause == "touchdown"}
    assert resets["closed"].split("\n") == [
        "to slide: impact; dgap := 0",
        "to pin: impact; dgap := 0, slip := 0",
    ]
    assert resets["free"] == "impact; dgap := 0"


def test_two_contacts_are_a_grid_of_nine_modes_with_guards_of_both_directions() -> None:
    runner = Runner(read_text(BAR))
    assert not needs_run(runner.automaton)
    diagram = build(runner.automaton, runner.start()[0])
    (chart,) = diagram.charts
    assert [node.name for node in chart.nodes] == [
        f"{a} {b}" for a in ("free", "slide", "pin") for b in ("free", "slide", "pin")
    ]
    assert chart.axes is not None
    for name, axis in zip("AB", chart.axes, strict=True):
        assert [node.label for node in axis.frames] == [f"{name} closed"]
        assert [node.name for node in axis.leaves] == [f"{name}:{s}" for s in MODES]
    slips = [link for link in diagram.links if link.event == "A slip"]
    assert {link.guard for link in slips} == {"H < -mu V or H > mu V"}
    assert {(link.source, link.target) for link in slips} == {
        (f"pin {other}", f"slide {other}") for other in MODES
    }


def test_a_region_without_a_choice_is_not_drawn() -> None:
    runner = Runner("simplest_walker")
    assert [len(region.states) for region in runner.automaton.regions] == [1, 2]
    (chart,) = build(runner.automaton, runner.start()[0]).charts
    assert [node.name for node in chart.nodes] == ["above", "below"]


def test_counts_follow_the_jumps_of_the_run() -> None:
    runner = switches(2)
    trace = runner.run().trace
    diagram = build(runner.automaton, trace.start_mode, trace, visited=True)
    (chart,) = diagram.charts
    taken = sum(link.visits or 0 for link in chart.links)
    assert taken == len(trace.jumps) == 6
    assert len(chart.path) == len(trace.modes)
    entered = {node.name: node.visits for node in chart.nodes}
    assert entered == {name: chart.path.count(name) for name in entered}
    assert entered["off off"] == 2


def test_too_many_modes_are_drawn_as_visited_with_every_region() -> None:
    runner = switches(5)
    assert runner.automaton.modes_declared == 32
    assert needs_run(runner.automaton)
    with pytest.raises(ValueError, match="as a run visited it"):
        build(runner.automaton, runner.start()[0])
    trace = runner.run().trace
    diagram = build(runner.automaton, trace.start_mode, trace)
    run, *charts = diagram.charts
    assert {node.name for node in run.nodes} == {" ".join(key) for key in trace.modes}
    assert [chart.title for chart in charts] == ["a", "b", "c", "d", "e"]
    alone = build(runner.automaton, trace.start_mode, trace, visited=True)
    assert alone.charts == (run,)
    assert legend(alone) == legend(diagram)


def test_a_long_run_is_drawn_by_its_first_steps() -> None:
    runner = switches(8)
    trace = runner.run().trace
    assert len(set(trace.modes)) > 12
    diagram = build(runner.automaton, trace.start_mode, trace)
    run = diagram.charts[0]
    assert run.path == tuple(" ".join(key) for key in trace.modes[:16])
    visits, modes = len(trace.modes), len(set(trace.modes))
    assert f"the first 16 of {visits} visits to {modes} modes are drawn" in diagram.notes


def test_simultaneous_touchdowns_are_one_edge_of_the_diagram() -> None:
    runner = Runner("box_stack")
    trace = runner.run().trace
    assert len(trace.jumps) == 5  # one for every box, all at the start
    diagram = build(runner.automaton, trace.start_mode, trace)
    run = diagram.charts[0]
    assert run.path == (" ".join(["free"] * 5), " ".join(["pin"] * 5))
    assert [node.visits for node in run.nodes] == [1, 1]
    (link,) = run.links
    assert (link.event, link.visits) == ("box0 and 4 more touchdown", 1)


def test_legend_of_visited_modes_lists_visited_states_only() -> None:
    runner = Runner("toppling_stick")
    trace = runner.run().trace
    whole = legend(build(runner.automaton, trace.start_mode))
    alone = legend(build(runner.automaton, trace.start_mode, trace, visited=True))
    assert [row[0] for row in whole.states] == ["free", "slide+", "slide-", "pin"]
    assert [row[0] for row in alone.states] == ["slide+", "slide-", "pin"]


def test_modes_are_named_by_states_other_than_the_defaults() -> None:
    regions = automaton("woodpecker").regions
    names = [
        mode_label(list(zip(regions, states, strict=True)))[0]
        for states in (
            ("free", "free", "free"),
            ("free", "slide+", "free"),
            ("pin", "free", "slide-"),
        )
    ]
    last = f"{regions[0].name} pin\n{regions[2].name} slide-"
    assert names == ["all free", f"{regions[1].name} slide+", last]
    controller = Runner("hopper").automaton.regions[-1]
    assert mode_label([(controller, "swing")])[0] == "swing"


def test_a_mode_of_many_closed_contacts_is_named_by_their_states() -> None:
    region = automaton("woodpecker").regions[0]
    contacts = [replace(region, name=f"c{k}") for k in range(12)]
    states = ["pin"] * 10 + ["slide+", "free"]
    label, reported = mode_label(list(zip(contacts, states, strict=True)))
    assert label == "pin: 10 of 12\nc10 slide+"
    assert [(region.name, state) for region, state in reported] == [
        ("c0", "pin"),
        ("c10", "slide+"),
    ]


def test_a_simultaneous_jump_of_several_regions_is_one_link() -> None:
    runner = switches(2)
    trace = runner.run().trace
    both = replace(trace.jumps[0], target=("on", "on"))
    diagram = build(
        runner.automaton, trace.start_mode, replace(trace, jumps=(both, *trace.jumps[1:]))
    )
    (link,) = [
        link for link in diagram.links if link.source == "off off" and link.target == "on on"
    ]
    assert (link.event, link.visits) == ("a turn", 1)


def test_infeasible_unvisited_modes_show_the_reason() -> None:
    runner = Runner(read_text(BAR))
    setup = runner.setup()
    found = feasibility(runner.automaton, setup, setup.initial, 0.0)
    start = runner.start()[0]
    diagram = build(runner.automaton, start, None, found)
    refused = {node.name: node.infeasible for node in diagram.nodes if node.infeasible}
    assert set(refused) == {"slide pin", "pin slide"}
    assert refused["slide pin"] == "A cannot slip with B without slip"
    drawn = dot(diagram)
    for reason in legend(diagram).reasons:
        assert f"{reason}<" in drawn
    trace = runner.run().trace
    went = replace(trace, start_mode=("slide+", "pin"), jumps=())
    shown = build(runner.automaton, start, went, found)
    assert not any(node.infeasible for node in shown.nodes)


def test_regions_that_differ_by_a_number_share_one_chart():
    trace = run("rimless_wheel", "taylor", until=2.0)
    diagram = build(automaton("rimless_wheel"), trace.start_mode, trace)
    assert [chart.title for chart in diagram.charts] == [
        "modes of the run",
        "s0, s1, s2, s3",
        "s4, s5, s6, ... s15 (12 in all); numbers of s4",
    ]
    # Every region has a start, though those of a chart start in different states.
    starts = [{n.label: n.starting for n in c.nodes if n.starting} for c in diagram.charts[1:]]
    assert starts == [
        {"free": "s1, s2, s3", "pin": "s0"},
        {"free": "s4, s5, s6, s7", "off": "s8, s9, s10, s11, s12, s13, s14, s15"},
    ]
    drawn = mermaid(diagram).splitlines()
    assert [line.strip() for line in drawn if line.endswith((" : s0", " : s1, s2, s3"))] == [
        "[*] --> s0_free : s1, s2, s3",
        "[*] --> s0_pin : s0",
    ]


def test_legend_distinguishes_region_events_with_different_effects() -> None:
    runner = Runner("woodpecker")
    trace = runner.run(until=0.1).trace
    rows = legend(build(runner.automaton, trace.start_mode, trace)).events
    touchdowns = [(m.route, m.reset) for m in rows if m.event == "touchdown"]
    assert touchdowns[1:] == [
        ("beak_tip: free → free", "impact: rebound by restitution"),
        ("lower, upper: free → free", "impact; dgap := 0"),
    ]
    names = [m.event for m in rows]
    assert names == sorted(names, key=names.index)


RESUMED = """
kind: chart
name: resumed
variables: {x: 0}
regions:
  job:
    initial: work
    states:
      work:
        initial: first
        states:
          first: {flows: {x: 1}}
          second: {flows: {x: 2}}
          last: {history: shallow}
        transitions: [{name: onward, from: first, to: second, guard: x >= 1}]
      pause: {}
    transitions:
      - {name: stop, from: work, to: pause, guard: x >= 2}
      - {name: go, from: pause, to: last, guard: time >= 4}
stop: {time: 1}
"""


def test_nested_states_of_a_controller_are_drawn_as_declared_with_their_history() -> None:
    runner = Runner(read_text(RESUMED))
    (chart,) = build(runner.automaton, runner.start()[0]).charts
    shown = {node.label: (node.inside, node.initial, node.default) for node in chart.nodes}
    assert shown == {
        "work": (None, True, False),
        "first": ("work", False, True),
        "second": ("work", False, False),
        "pause": (None, False, False),
        "H": ("work", False, False),
    }
    ends = [(link.source, link.cause, link.target) for link in chart.links]
    assert sorted(ends) == [
        ("first", "onward", "second"), ("pause", "go", "last"), ("work", "stop", "pause"),
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["double_contact_bar", "compass_walker", "raibert_hopper"])
def test_arrows_of_a_grid_are_all_transitions_of_its_modes(name: str) -> None:
    runner = Runner(name)
    (chart,) = build(runner.automaton, runner.start()[0]).charts
    assert chart.axes is not None
    drawn: set[tuple[str, str, str]] = set()
    for place, (region, axis) in enumerate(zip(runner.automaton.regions, chart.axes, strict=True)):
        inner = {
            node.name: [
                leaf.name.split(":")[1]
                for leaf in axis.leaves
                if node.name in (leaf.name, *axis.around(leaf.name))
            ]
            for node in axis.nodes
        }
        others = [leaf.name.split(":")[1] for leaf in chart.axes[1 - place].leaves]
        for link in axis.links:
            for source in inner[link.source]:
                for target in inner[link.target]:
                    for other in others:
                        ends = [
                            f"{state} {other}" if place == 0 else f"{other} {state}"
                            for state in (source, target)
                        ]
                        drawn.add((ends[0], f"{region.name} {link.cause}", ends[1]))
    meant = {(link.source, link.event, link.target) for link in chart.links}
    apart = {link for link in meant if link[0] != link[2]}
    assert {link for link in drawn if link[0] != link[2]} == apart


REVIEW = """
kind: chart
name: review
variables: {ok: 0, x: 0}
regions:
  plan:
    initial: written
    states:
      written: {flows: {x: 1}}
      review:
        entry: {ok: 0}
        exit: {x: x + ok}
        regions:
          one: {initial: w1, states: {w1: {}, ok1: {entry: {ok: ok + 1}}},
                transitions: [{name: a1, from: w1, to: ok1, after: 2}]}
          two: {initial: w2, states: {w2: {}, ok2: {flows: {x: -1.25*x + 0.625*ok + 0.12345}}},
                transitions: [{name: a2, from: w2, to: ok2, after: 3}]}
      approved: {}
    transitions:
      - {name: submit, from: written, to: review, after: 1}
      - {name: done, from: review, to: approved, guard: ok >= 1}
stop: {time: 9}
"""


def test_parallel_regions_have_starts_and_dashed_dividers() -> None:
    runner = Runner(read_text(REVIEW))
    diagram = build(runner.automaton, runner.start()[0])
    (chart,) = diagram.charts
    assert [node.name for node in chart.nodes if node.initial] == ["written"]
    assert [node.name for node in chart.nodes if node.default] == ["w1", "w2"]
    assert chart.node("review").parallel
    lines = dot(diagram).splitlines()
    heads = [line.split("->")[1].split()[0] for line in lines if "start" in line and "->" in line]
    assert sorted(heads) == ["w1", "w2", "written"]
    (divider,) = [line for line in lines if "dashed" in line and "->" in line]
    assert "arrowhead=none" in divider
    (one, two) = [
        [float(part) for part in line.split('pos="')[1].split('"')[0].split(",")]
        for line in lines
        for name in ("one", "two")
        if line.strip().startswith(f"{name} [")
    ]
    places = [
        [float(part) for part in point.split(",")]
        for point in divider.split('pos="')[1].split('"')[0].split()
    ]
    (axis,) = [k for k in (0, 1) if len({place[k] for place in places}) == 1]
    assert min(one[axis], two[axis]) < places[0][axis] < max(one[axis], two[axis])


def test_long_entry_exit_and_rates_move_to_the_legend() -> None:
    runner = Runner(read_text(REVIEW))
    diagram = build(runner.automaton, runner.start()[0])
    actions = {node.name: node.actions for node in diagram.nodes if node.actions}
    assert actions == {
        "written": ("x' = 1",),
        "review": ("entry / ok := 0", "exit / x := x + ok"),
        "ok1": ("entry / ok := ok + 1",),
        "ok2": ("x' = -1.25*x + 0.625*ok + 0.12345",),
    }
    assert legend(diagram).states == (("ok2", "", *actions["ok2"]),)
    assert legend(diagram, "inline").states == ()
    for guards in GUARDS:
        for text in ("entry / ok := 0", "x&#x27; = 1", "0.12345"):
            assert dot(diagram, guards).count(text) == 1


def test_mermaid_separates_regions_and_begins_each() -> None:
    runner = Runner(read_text(REVIEW))
    lines = [
        line.strip() for line in mermaid(build(runner.automaton, runner.start()[0])).split("\n")
    ]
    assert lines.count("--") == 1
    assert [line for line in lines if line.startswith("[*]")] == [
        "[*] --> w1", "[*] --> w2", "[*] --> written",
    ]  # fmt: skip
    assert lines.index("[*] --> w1") < lines.index("--") < lines.index("[*] --> w2")


def test_mermaid_enters_charts_side_by_side_from_one_bar() -> None:
    runner = Runner("double_contact_bar")
    text = mermaid(build(runner.automaton, runner.start()[0]))
    outermost = [line.strip() for line in text.split("\n") if re.match(r" {4}\S", line)]
    assert [line for line in outermost if line.startswith("[*]")] == ["[*] --> begin"]
    # Mermaid takes the shape of a state from the first line that names it.
    assert next(line for line in outermost if "begin" in line) == "state begin <<fork>>"
    assert "state begin <<fork>>" in outermost
    started = [line for line in outermost if line.startswith("begin --> ")]
    assert started == ["begin --> A_free", "begin --> B_free"]


ALONE = """
kind: chart
name: alone
variables: {x: 0}
regions:
  m0: {initial: n0, states: {n0: {flows: {x: 1}}}}
  m1:
    initial: n1
    states: {n1: {initial: n2, states: {n2: {}}}, n3: {}}
    transitions: [{name: go, from: n1, to: n3, guard: x > 1}]
stop: {time: 2}
"""


def test_regions_of_one_state_are_noted_and_frames_around_one_state_drawn():
    diagram = drawn(Runner(read_text(ALONE)))[0]
    assert diagram.notes == ("always n0: m0",)
    text = ALONE.replace("n0: {flows: {x: 1}}}", "n0: {flows: {x: 1}}, n4: {}}")
    diagram = drawn(Runner(read_text(text)))[0]
    names = {node.name.rpartition(":")[2] for chart in diagram.charts for node in chart.nodes}
    assert names == {"n0", "n1", "n2", "n3", "n4"}
