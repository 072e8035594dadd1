"""SCXML that is written is a machine that runs: loaded and driven by python-statemachine."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from statechart.cli.main import main
from statechart.diagram.scxml import NOTES, SCXML, scxml, unexpressed_parts
from statechart.documents.yaml_reader import read_text
from statechart.running.drawing import drawn
from statechart.running.runner import Runner

NESTED = """\
kind: chart
name: nested
parameters: {D: 2}
variables: {x: 0, y: 1, starts: 0}
regions:
  job:
    initial: idle
    states:
      idle: {}
      running:
        initial: slow
        entry: {starts: starts + 1}
        exit: {x: y, y: x}
        states:
          slow: {flows: {x: 1}}
          fast: {flows: {x: 3}}
          last: {history: shallow}
        transitions:
          - {name: faster, from: slow, to: fast, guard: x >= D}
      both:
        regions:
          left:
            initial: l0
            states: {l0: {}, l1: {}}
            transitions: [{name: l, from: l0, to: l1, on: user.tick}]
          right:
            initial: r0
            states: {r0: {}, r1: {}}
            transitions: [{name: r, from: r0, to: r1, on: user.tick}]
    transitions:
      - {name: halt, from: running, to: idle, on: user.halt}
      - {name: begin, from: idle, to: running, guard: time >= 1 + 99*starts}
      - {name: resume, from: idle, to: last, guard: time*starts >= 6}
      - {name: part, from: running, to: both, guard: time >= 7}
  user:
    initial: first
    states: {first: {}, second: {}, third: {}}
    transitions:
      - {name: halt, from: first, to: second, guard: time >= 4}
      - {name: tick, from: second, to: third, guard: time >= 7.5}
stop: {time: 8}
"""


def test_a_machine_that_is_loaded_goes_through_the_states_of_the_run(tmp_path: Path) -> None:
    io = pytest.importorskip("statemachine.io")
    file = tmp_path / "nested.yaml"
    file.write_text(NESTED, encoding="utf-8")
    runner = Runner(file)
    trace = runner.run().trace
    written = tmp_path / "nested.scxml"
    written.write_text(scxml(drawn(runner)[0]), encoding="utf-8")
    named = {
        element.get("id"): element.get(f"{{{NOTES}}}name") for element in ET.parse(written).iter()
    }
    machine = io.load(written)()
    job = runner.automaton.regions[0]
    heard = {edge.cause for edge in job.nesting.edges if edge.events}
    seen = []
    for jump in trace.jumps:
        if jump.region != "job" or not heard.issuperset(jump.cause.split("+")):
            for name, value in zip(trace.variables, jump.before.tolist(), strict=True):
                setattr(machine.model, name, value)
            # A guard that falls is true but for rounding.
            machine.model.time = jump.t + 1e-9
            if jump.cause == "faster":
                machine.model.x += 1e-9
            machine.send(f"{jump.region}.{jump.cause}")
        active = {named[state.id] for state in machine.configuration} - {None}
        later = [other for other in trace.jumps if other.t == jump.t and other.j > jump.j]
        if later:
            continue
        wanted = {*job.active(jump.target[0]), *runner.automaton.regions[1].active(jump.target[1])}
        assert active == wanted
        assert [machine.model.x, machine.model.y, machine.model.starts] == pytest.approx(
            jump.after[:3].tolist(), abs=1e-8
        )
        seen.append(jump.target[0])
    assert seen == [
        "slow",
        "fast",
        "idle[last=fast]",
        "fast",
        "l0|r0[last=fast]",
        "l1|r1[last=fast]",
    ]


def test_parts_that_scxml_cannot_express_are_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "stick.scxml"
    assert main(["draw", "toppling_stick", "-o", str(path)]) == 0
    reported = capsys.readouterr().err
    left_out = "the SCXML file leaves out guards (the host program sends these events): tip."
    assert f"{left_out}touchdown" in reported
    assert "resets of continuous states: tip.touchdown, tip.stick" in reported
    assert path.read_text(encoding="utf-8").count("<!-- left out: ") == 2
    machine = drawn(Runner("bouncing_ball_chart"))[0].machine
    assert machine is not None
    assert unexpressed_parts(machine) == (
        "guards (the host program sends these events): ball.settle",
    )


def test_a_contact_is_written_with_its_states_in_states() -> None:
    root = ET.fromstring(scxml(drawn(Runner("toppling_stick"))[0]))
    inside = root.findall(f"{{{SCXML}}}state[@id='closed']/{{{SCXML}}}state")
    assert {element.get("id") for element in inside} == {"pin", "slide"}
    (liftoff,) = root.findall(f".//{{{SCXML}}}transition[@event='tip.liftoff']")
    assert liftoff.get("target") == "free"
    events = [t.get("event") for t in root.iter(f"{{{SCXML}}}transition")]
    # The sender of an event names the state to enter if there are several.
    assert {f"tip.touchdown.{s}" for s in ("pin", "slide_plus", "slide_minus")} <= {*events}


def test_operators_of_relations_become_those_of_scxml_conditions():
    text = """
kind: chart
name: gated
variables: {x: 1, n: 0}
regions:
  gate:
    initial: shut
    states: {shut: {}, open: {}}
    transitions: [{name: opens, from: shut, to: open, guard: x <= 0.5}]
  motion:
    initial: a
    states: {a: {flows: {x: -1}}, b: {}}
    transitions:
      - {name: go, from: a, to: b, guard: x <= 0 and not (n > 1 or in(gate.shut))}
stop: {time: 3}
"""
    root = ET.fromstring(scxml(drawn(Runner(read_text(text)))[0]))
    conditions = [element.get("cond") for element in root.iter() if element.get("cond")]
    assert conditions == ["x <= 0.5", "x <= 0 && !(n > 1 || In('gate_shut'))"]


RAISED = """
kind: chart
name: raised
variables: {x: 0}
regions:
  job:
    initial: boot
    states: {boot: {}, work: {states: {slow: {}, fast: {}}, initial: slow}, done: {}}
    transitions:
      - {name: begin, from: boot, to: work, guard: x >= 1}
      - {name: end, from: work, to: done, on: watch.seen}
  watch:
    initial: idle
    states: {idle: {}, busy: {}}
    transitions: [{name: seen, from: idle, to: busy, on: job.work}]
stop: {time: 1}
"""


def test_the_machine_raises_the_events_that_its_transitions_wait_for(tmp_path: Path) -> None:
    io = pytest.importorskip("statemachine.io")
    written = tmp_path / "raised.scxml"
    written.write_text(scxml(drawn(Runner(read_text(RAISED)))[0]), encoding="utf-8")
    raised = [(e.get("event")) for e in ET.parse(written).iter(f"{{{SCXML}}}raise")]
    assert raised == ["job.work", "watch.seen"]
    machine = io.load(written)()
    machine.model.x = 1
    machine.send("job.begin")
    active = {state.id for state in machine.configuration}
    assert {"job_done", "watch_busy"} <= active


def test_the_machine_raises_no_event_of_the_states_it_starts_in(tmp_path: Path) -> None:
    io = pytest.importorskip("statemachine.io")
    text = RAISED.replace("on: job.work", "on: job.boot").replace(
        "on: watch.seen}", "on: watch.seen}\n      - {name: back, from: work, to: boot, after: 1}"
    )
    written = tmp_path / "raised.scxml"
    written.write_text(scxml(drawn(Runner(read_text(text)))[0]), encoding="utf-8")
    machine = io.load(written)()
    assert "watch_idle" in {state.id for state in machine.configuration}
    machine.model.x = 1
    machine.send("job.begin")
    machine.send("job.back")
    # The run, too, enters `busy` when `boot` is entered again.
    assert "watch_busy" in {state.id for state in machine.configuration}
    assert Runner(read_text(text)).run().trace.modes[0] == ("boot", "idle")
