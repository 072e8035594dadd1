"""All declared states are drawn, those that no transition enters in grey."""

from __future__ import annotations

import random
import xml.etree.ElementTree as ET

import pytest

from statechart.automaton.regions import UNREACHED
from statechart.diagram.dot import dot
from statechart.diagram.layout.graphviz_program import render
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Diagram
from statechart.diagram.scxml import NOTES, scxml
from statechart.diagram.write import graphml
from statechart.documents.yaml_reader import read_text
from statechart.palette import FAINT
from statechart.running.drawing import drawn
from statechart.running.runner import Runner

STATE = "{http://www.w3.org/2005/07/scxml}state"

LEADS_AWAY = """
  m:
    initial: s
    states:
      s: {initial: a, states: {a: {}, b: {}}, transitions: [{name: t, from: b, to: a, after: 1}]}
"""
LOST = """
  m:
    initial: a
    states:
      a: {}
      s: {initial: s1, entry: {x: 1}, states: {s1: {}, s2: {}, s3: {}}}
      lost: {}
    transitions: [{name: go, from: a, to: s, after: 1}]
"""
FLAT = """
  m:
    initial: a
    states: {a: {}, b: {}, lost: {}, loster: {}}
    transitions:
      - {name: go, from: a, to: b, after: 1}
      - {name: in, from: lost, to: loster, after: 1}
      - {name: out, from: loster, to: a, after: 1}
"""
HISTORY = """
  m:
    initial: a
    states:
      a: {}
      q:
        initial: u
        states:
          u: {}
          p: {regions: {v: {initial: c, states: {c: {}, d: {}}}, w: {initial: e, states: {e: {}}}}}
          deep: {history: deep}
        transitions: [{name: r, from: p, to: deep, after: 1}]
"""
BESIDE = """
  n: {initial: e, states: {e: {}, f: {}}, transitions: [{name: w, from: e, to: f, after: 2}]}
"""
PARALLEL = """
  n:
    initial: p
    states:
      p: {regions: {v: {initial: c, states: {c: {}, d: {}}}, w: {initial: e, states: {e: {}}}}}
      o: {}
    transitions: [{name: w, from: p, to: o, after: 2}]
"""


def chart(*regions: str) -> str:
    head = "kind: chart\nname: some\nvariables: {x: 0}\nstop: {time: 2}\nregions:"
    return head + "".join(regions)


def diagram(text: str) -> Diagram:
    return drawn(Runner(read_text(text)))[0]


def greyed(drawing: Diagram) -> dict[str, bool]:
    """Return the states of a drawing, by their own names, and whether they are grey."""
    return {
        node.name.rpartition(":")[2]: node.infeasible == UNREACHED
        for piece in drawing.pieces
        for node in piece.nodes
    }


@pytest.mark.parametrize(
    ("text", "entered", "never"),
    [
        (chart(LEADS_AWAY), "s a", "b"),
        (chart(LOST), "a s s1", "s2 s3 lost"),
        (chart(FLAT), "a b", "lost loster"),
        (chart(HISTORY), "a", "q u p v c d w e deep"),
        (chart(LEADS_AWAY, BESIDE), "s a e f", "b"),
        (chart(LOST, BESIDE), "a s s1 e f", "s2 s3 lost"),
        (chart(FLAT, PARALLEL), "a b p v c w e o", "lost loster d"),
    ],
    ids=["leads away", "lost", "flat", "history", "one row", "grid", "two charts"],
)
def test_all_declared_states_are_in_every_format(text: str, entered: str, never: str) -> None:
    drawing = diagram(text)
    reached = dict.fromkeys(entered.split(), False)
    assert greyed(drawing) == reached | dict.fromkeys(never.split(), True)
    names = {"H*" if name == "deep" else name for name in greyed(drawing)}
    svg = render(dot(drawing), "svg").decode()
    assert all(f">{name}" in svg or f" {name}" in svg for name in names)
    assert svg.count(FAINT.lower()) >= len(never.split())
    assert UNREACHED in svg
    flowchart = mermaid(drawing)
    assert all(f'"{name}"' in flowchart or f" {name}" in flowchart for name in names)
    assert f"infeasible#58; {UNREACHED}" in flowchart
    root = ET.fromstring(scxml(drawing))
    written = {
        element.get(f"{{{NOTES}}}name"): element.get(f"{{{NOTES}}}infeasible") == UNREACHED
        for element in root.iter()
        if element.get(f"{{{NOTES}}}name")
    }
    assert written == {n: grey for n, grey in greyed(drawing).items() if n != "deep"}
    assert graphml(drawing).count(UNREACHED) >= 1
    assert drawing.graph is not None
    modes = {word for label in dict(drawing.graph.nodes(data="label")).values() for word in
             label.replace(":", " ").replace("|", " ").split()}  # fmt: skip
    holding = {node.inside and node.inside.rpartition(":")[2] for p in drawing.pieces
               for node in p.nodes}  # fmt: skip
    assert {name for name in greyed(drawing) if name not in holding and name != "deep"} <= modes


def test_the_graph_of_a_drawing_has_the_transitions_of_states_that_are_never_entered() -> None:
    graph = diagram(chart(LEADS_AWAY)).graph
    assert graph is not None
    assert list(graph.edges(data="event")) == [(("b",), ("a",), "t")]
    assert graph.nodes["b",] == {"label": "m:b", "feasible": False, "reason": UNREACHED}


def test_a_controller_next_to_a_contact_is_drawn_completely() -> None:
    drawing = diagram("""\
kind: scene
name: controlled
gravity: 9.81
bodies: {b: {mass: 1, start: {y: 1, dx: 1}}}
surfaces: {s: {height: 0}}
controls: {push: 0}
regions:
  driver:
    initial: go
    states:
      go: {sets: {push: 1}}
      rest: {initial: deep, states: {deep: {}, never: {}}}
      gone: {}
    transitions: [{name: far, from: go, to: rest, guard: b.x >= 2}]
contacts: {c: {point: {body: b}, surface: s, modes: [free, slide], friction: 0, restitution: 0}}
forces: {f: {body: b, force: [push, 0]}}
stop: {time: 3}
""")
    found = greyed(drawing)
    assert [name for name, grey in found.items() if grey] == ["never", "gone"]
    (grid,) = drawing.charts
    assert len(grid.nodes) == 8
    assert sum(node.infeasible == UNREACHED for node in grid.nodes) == 4


def nested(rng: random.Random, names: list[str], depth: int) -> str:
    """Return random states, some of them in others, with random transitions between siblings."""
    own = [f"s{len(names) + k}" for k in range(rng.randint(1, 4))]
    names += own
    states = []
    for name in own:
        kind = rng.random() if depth < 2 else 0.0
        if kind < 0.5:
            states.append(f"{name}: {{}}")
        elif kind < 0.85:
            states.append(f"{name}: {nested(rng, names, depth + 1)}")
        else:
            regions = []
            for k in range(2):
                region = f"{name}r{k}"
                names.append(region)
                regions.append(f"{region}: {nested(rng, names, depth + 1)}")
            states.append(f"{name}: {{regions: {{{', '.join(regions)}}}}}")
    moves = {(rng.choice(own), rng.choice(own)) for _ in range(rng.randint(0, 3))}
    arrows = ", ".join(
        f"{{name: t{source}, from: {source}, to: {target}, after: 1}}"
        for source, target in sorted(dict(moves).items())
    )
    return f"{{initial: {own[0]}, states: {{{', '.join(states)}}}, transitions: [{arrows}]}}"


@pytest.mark.parametrize("seed", range(25))
def test_random_charts_are_drawn_whole(seed: int) -> None:
    rng, names = random.Random(seed), list[str]()
    regions = [f"\n  m{k}: {nested(rng, names, 0)}" for k in range(1 + seed % 2)]
    runner = Runner(read_text(chart(*regions)))
    drawing = drawn(runner)[0]
    alone = [r for r in runner.automaton.regions if len(r.nesting.names) == 1 and not r.edges]
    without_choice = {r.states[0] for r in alone} if len(regions) > len(alone) else set[str]()
    assert set(greyed(drawing)) == set(names) - without_choice
    entered = {
        name for region in runner.automaton.regions for s in region.states
        for name in region.active(s)
    }  # fmt: skip
    assert {name for name, grey in greyed(drawing).items() if not grey} <= entered
    assert all(name in mermaid(drawing) for name in greyed(drawing))
    assert len(list(ET.fromstring(scxml(drawing)).iter(STATE))) > 0
