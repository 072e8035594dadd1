"""Final states, histories of regions and internal transitions in diagrams, Mermaid and SCXML."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from statechart.diagram.dot import dot
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Diagram
from statechart.diagram.scxml import SCXML, scxml
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.drawing import drawn
from statechart.running.inspection import modes
from statechart.running.runner import Runner

CHART = """\
kind: chart
name: job
variables: {x: 0}
regions:
  job:
    initial: work
    states:
      work:
        initial: first
        states: {first: {flows: {x: 1}}, second: {}, ready: {final: true}}
        transitions:
          - {name: onward, from: first, to: second, after: 1, guard: x >= 1.5}
          - {name: skip, from: work, to: second, guard: x >= 3, internal: true}
          - {name: finish, from: second, to: ready, guard: x >= 8}
      both:
        regions:
          left: {initial: l0, states: {l0: {}, l1: {final: true}},
                 transitions: [{name: l, from: l0, to: l1, guard: x >= 9}]}
          right: {initial: r0, states: {r0: {}}}
        states: {last: {history: deep}}
    transitions:
      - {name: part, from: work, to: last, on: work.done, guard: x <= 20}
      - {name: back, from: both, to: work, on: left.done}
stop: {time: 1}
"""


@pytest.fixture(scope="module")
def diagram() -> Diagram:
    return drawn(Runner(interpret(read_text(CHART, "f.yaml"))))[0]


def test_scxml_has_final_states_histories_of_regions_and_types_of_transitions(
    diagram: Diagram,
) -> None:
    root = ET.fromstring(scxml(diagram))
    found = {element.get("id"): element for element in root.iter() if element.get("id")}
    assert found["ready"].tag == found["l1"].tag == f"{{{SCXML}}}final"
    last = found["last"]
    assert (last.tag, last.get("type")) == (f"{{{SCXML}}}history", "deep")
    assert last in list(found["both"])
    assert last[0].get("target") == "left right"
    leaving = {(t.get("event"), t.get("cond"), t.get("type"), t.get("target"))
               for t in root.iter(f"{{{SCXML}}}transition")}  # fmt: skip
    assert ("job.skip", "x >= 3", "internal", "second") in leaving
    assert ("done.state.work", "x <= 20", None, "last") in leaving
    assert ("done.state.left", None, None, "work") in leaving


def test_mermaid_ends_inside_the_states_that_are_done(diagram: Diagram) -> None:
    lines = mermaid(diagram).splitlines()
    work = lines.index(next(line for line in lines if line.strip().startswith('state "work')))
    end = next(k for k in range(work, len(lines)) if lines[k].strip() == "}")
    assert "ready --> [*]" in [line.strip() for line in lines[work:end]]
    # A history is not a separate region.
    assert sum(line.strip() == "--" for line in lines) == 1


def test_pictures_show_final_states_histories_and_dead_ends(diagram: Diagram) -> None:
    source = dot(diagram)
    assert source.count("\N{FISHEYE}") == 2
    assert source.count("shape=circle") == 1 + 4  # the history, and where charts begin
    assert "skip → second" in source
    assert "↻ skip" not in source


def test_the_list_of_modes_has_triggers_in_words() -> None:
    listed = str(modes(interpret(read_text(CHART, "f.yaml"))))
    assert "[after 1 and x >= 1.5]" in listed
    assert "[on work.done if x <= 20]" in listed
    assert "[x >= 3], internal" in listed
