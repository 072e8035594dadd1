"""Layouts: no text on a line or on other text, and no picture larger than a slide."""

from __future__ import annotations

import json

import pytest
from layouts import border, line, texts
from layouts import clashes as clashes_of
from runs import diagram

import models
from statechart.diagram.dot import dot
from statechart.diagram.layout.graphviz_program import render
from statechart.diagram.legend import Guards
from statechart.diagram.model import Diagram
from statechart.documents.yaml_reader import read_text
from statechart.running.drawing import drawn
from statechart.running.runner import Runner


def clashes(drawn: Diagram, guards: Guards = "legend") -> list[str]:
    return clashes_of(dot(drawn, guards))


@pytest.mark.parametrize("name", models.names())
def test_no_text_of_a_shipped_model_is_on_a_line_or_on_text(name: str) -> None:
    assert clashes(diagram(name)) == []


@pytest.mark.parametrize("name", ["toppling_stick", "double_contact_bar", "simplest_walker"])
def test_pictures_with_inline_guards_have_no_clashes(name: str) -> None:
    assert clashes(diagram(name), "inline") == []


@pytest.mark.parametrize("name", ["toppling_stick", "compass_walker", "sliding_ladder"])
def test_pictures_of_visited_modes_have_no_clashes(name: str) -> None:
    assert clashes(drawn(Runner(name), visited=True)[0]) == []


@pytest.mark.parametrize("name", ["double_contact_bar", "toppling_stick", "rimless_wheel"])
def test_a_slide_of_a_thousand_pixels_shows_it_legibly(name: str) -> None:
    laid = json.loads(render(dot(diagram(name)), "json"))
    width = float(laid["bb"].split(",")[2])
    sizes = [
        one["size"]
        for item in laid["objects"]
        for one in item.get("_ldraw_", [])
        if one["op"] == "F"
    ]
    # Letters of 9 pixels are read on a slide.
    assert min(sizes) * 1000 / width > 9


LOOPS = """
kind: chart
name: loops
variables: {x: 0}
regions:
  nav:
    initial: c
    states: {a: {}, b: {}, c: {}, d: {}, e: {}, f: {}, g: {}, bad: {}, good: {}}
    transitions:
      - {name: t0, from: a, to: bad, after: 1}
      - {name: t1, from: a, to: d, after: 2}
      - {name: t2, from: a, to: b, after: 3}
      - {name: t3, from: b, to: c, after: 4}
      - {name: t4, from: b, to: a, after: 5}
      - {name: t5, from: c, to: d, after: 6}
      - {name: t6, from: c, to: b, after: 7}
      - {name: t7, from: c, to: good, after: 8}
      - {name: t8, from: d, to: a, after: 9}
      - {name: t9, from: d, to: e, after: 10}
      - {name: t10, from: d, to: f, after: 11}
      - {name: t11, from: d, to: c, after: 12}
      - {name: t12, from: e, to: d, after: 13}
      - {name: t13, from: e, to: g, after: 14}
      - {name: t14, from: e, to: bad, after: 15}
      - {name: t15, from: f, to: g, after: 16}
      - {name: t16, from: f, to: d, after: 17}
      - {name: t17, from: f, to: good, after: 18}
      - {name: t18, from: g, to: f, after: 19}
      - {name: t19, from: g, to: e, after: 20}
stop: {time: 1}
"""


@pytest.mark.parametrize("name", ["sliding_ladder", "compass_walker", "double_contact_bar"])
def test_the_dot_of_a_start_lies_on_no_frame_of_a_grid(name: str) -> None:
    laid = json.loads(render(dot(diagram(name)), "json"))
    dots = [border(item) for item in laid["objects"] if item.get("shape") == "circle"]
    frames = [border(item) for item in laid["objects"] if "dashed" in item.get("style", "")]
    assert len(dots) == 1
    assert frames
    for frame in frames:
        corners = [(x, y) for x in dots[0][1::2] for y in dots[0][2::2]]
        assert len({frame.holds(*corner) for corner in corners}) == 1


def test_no_arrow_leaves_the_area_of_its_chart() -> None:
    laid = json.loads(render(dot(drawn(Runner(read_text(LOOPS)))[0]), "json"))
    heading, table = (
        border(item) for item in laid["objects"] if item["name"] in ("_title", "_events")
    )
    heights = [y for edge in laid["edges"] for _, y in line(edge)]
    assert table.high < min(heights)
    assert max(heights) < heading.low


TALL = """\
kind: chart
name: tall
variables: {x: 0}
regions:
  m:
    initial: both
    states:
      both:
        regions:
          one: {initial: a, states: {a: {entry: {x: x + 1}}}}
          two:
            initial: b
            states: {b: {}, c: {}, d: {}, e: {}}
            transitions:
              - {name: waits_for_the_operator1, from: b, to: c, guard: x > 1}
              - {name: waits_for_the_operator2, from: c, to: d, guard: x > 2}
              - {name: waits_for_the_operator3, from: d, to: e, guard: x > 3}
stop: {time: 1}
"""


def test_regions_side_by_side_are_divided_between_them() -> None:
    source = dot(drawn(Runner(read_text(TALL)))[0], "inline")
    assert clashes_of(source) == []
    laid = json.loads(render(source, "json"))
    (divider,) = (edge for edge in laid["edges"] if edge.get("style") == "dashed")
    boxes = {item["name"]: border(item) for item in laid["objects"]}
    points = [*line(divider)]
    axis = 0 if len({round(x, 1) for x, _ in points}) == 1 else 1
    at, *others = {round(point[axis], 1) for point in points}
    assert not others
    low, high = 1 + axis, 3 + axis
    sides = {name: (boxes[name][low] > at) - (boxes[name][high] < at) for name in "abcde"}
    assert {sides["a"]} == {-sides[name] for name in "bcde"}
    assert sides["a"] != 0


FRAMES = """\
kind: chart
name: heater
variables: {x: 0}
regions:
  m:
    initial: waiting
    states:
      waiting: {}
      heating_up_to_the_set_point:
        regions:
          burner: {initial: lit, states: {lit: {initial: low, states: {low: {}}}}}
          fan: {initial: blows, states: {blows: {entry: {x: x + 1}}}}
      cooling: {initial: fast, states: {fast: {}, slow: {}}}
    transitions:
      - {name: the_operator_starts_it, from: waiting, to: heating_up_to_the_set_point, guard: x > 1}
      - {name: cool, from: waiting, to: cooling, guard: x > 2}
stop: {time: 1}
"""


def test_arrows_to_frames_lead_over_no_frame() -> None:
    source = dot(drawn(Runner(read_text(FRAMES)))[0])
    assert clashes_of(source) == []
    laid = json.loads(render(source, "json"))
    boxes = {item["name"]: border(item) for item in laid["objects"]}
    frames = [boxes[name] for name in ("heating_up_to_the_set_point", "cooling")]
    number = laid["objects"].index(next(o for o in laid["objects"] if o["name"] == "waiting"))
    arrows = [[*line(edge)] for edge in laid["edges"] if edge["tail"] == number]
    assert len(arrows) == 2
    for frame in frames:
        inner = frame.shrunk(6)
        assert not any(inner.holds(*point) for course in arrows for point in course)


DIVIDED = """\
kind: chart
name: oven
variables: {x: 0}
regions:
  m:
    initial: heating_up_to_the_set_point
    states:
      heating_up_to_the_set_point:
        regions:
          burner: {initial: lit, states: {lit: {}}}
          fan: {initial: blows, states: {blows: {}}}
          light: {initial: shines, states: {shines: {}}}
stop: {time: 1}
"""


def test_dividers_end_below_the_title_of_their_state() -> None:
    source = dot(drawn(Runner(read_text(DIVIDED)))[0])
    assert clashes_of(source) == []
    laid = json.loads(render(source, "json"))
    dividers = [[*line(edge)] for edge in laid["edges"] if edge.get("style") == "dashed"]
    (title,) = (t for o in laid["objects"] for t in texts(o) if t.what.startswith("heating"))
    assert [len({round(x, 1) for x, _ in course}) for course in dividers] == [1, 1]
    assert all(y < title.low for course in dividers for _, y in course)


NESTED = """\
kind: chart
name: nested
variables: {x: 0}
regions:
  one: {initial: a, states: {a: {}, b: {}}, transitions: [{name: go, from: a, to: b, guard: x > 1}]}
  two:
    initial: outer
    states:
      outer:
        entry: {x: x + 1}
        initial: inner
        states:
          inner:
            entry: {x: x + 1}
            exit: {x: x + 2}
            initial: c
            states: {c: {}, d: {}}
            transitions: [{name: back, from: c, to: d, guard: x > 3}]
          e: {}
        transitions: [{name: leave, from: inner, to: e, guard: x > 5}]
      f: {}
    transitions: [{name: end, from: outer, to: f, guard: x > 7}]
stop: {time: 1}
"""


@pytest.mark.parametrize("order", [("one", "two"), ("two", "one")])
@pytest.mark.parametrize("guards", ["legend", "inline"])
def test_titles_of_nested_frames_of_a_grid_are_clear_of_each_other(order, guards) -> None:
    head, one, two = NESTED.replace("  one:", "@  one:").replace("  two:", "@  two:").split("@")
    two, stop = two.split("stop:")
    parts = {"one": one, "two": two}
    text = head + "".join(parts[name] for name in order) + "stop:" + stop
    diagram = drawn(Runner(read_text(text)))[0]
    assert any(chart.axes for chart in diagram.charts)
    assert clashes(diagram, guards) == []


TRIANGLE = """\
kind: chart
name: triangle
variables: {x: 0}
regions:
  m:
    initial: a
    states: {a: {flows: {x: 1}}, b: {flows: {x: 1}}, c: {flows: {x: 1}}}
    transitions:
      - {name: first, from: a, to: b, guard: x >= 1 and cos(x)**2 + sin(x)**2 > 0}
      - {name: second, from: b, to: c, guard: x >= 2 and cos(x)**2 + sin(x)**2 > 0}
      - {name: third, from: c, to: a, guard: x >= 3 and cos(x)**2 + sin(x)**2 > 0, updates: {x: 0}}
stop: {time: 20}
"""


def test_the_count_of_rounds_is_clear_of_the_guards_of_a_triangle() -> None:
    diagram = drawn(Runner(read_text(TRIANGLE)), visited=True)[0]
    assert "rounds" in dot(diagram, "inline")
    assert clashes(diagram, "inline") == []


LANES = """\
kind: chart
name: lanes
variables: {x: 0}
regions:
  one:
    initial: a
    states: {a: {}, b: {}}
    transitions:
      - {name: rise, from: a, to: b, guard: x > 7 and x < 2*7}
      - {name: fall, from: b, to: a, guard: abs(sin(3*x) + cos(x)**2 - 10) > 4 or x > 3*10 + 2}
  two:
    initial: c
    states: {c: {}, d: {}, e: {}}
    transitions:
      - {name: far, from: c, to: e, guard: abs(sin(3*x) + cos(x)**2 - 16) > 4 or x > 3*16 + 2}
      - {name: farther, from: c, to: e, guard: x > 18}
      - {name: on, from: c, to: d, guard: abs(sin(3*x) + cos(x)**2 - 17) > 4 or x > 3*17 + 2}
      - {name: up, from: d, to: e, guard: abs(sin(3*x) + cos(x)**2 - 20) > 4 or x > 3*20 + 2}
stop: {time: 1}
"""


def test_guards_of_a_lane_are_clear_of_those_of_arrows_down() -> None:
    diagram = drawn(Runner(read_text(LANES)))[0]
    assert any(chart.axes for chart in diagram.charts)
    assert clashes(diagram, "inline") == []


def test_overlapping_text_and_arrows_are_detected() -> None:
    near = 'graph [layout=nop2]; a [shape=none label=slide pos="0,0"]; b [shape=none label=pin'
    assert clashes_of(f'digraph {{{near} pos="90,0"]}}') == []
    assert clashes_of(f'digraph {{{near} pos="10,0"]}}') == ["'slide' on 'pin'"]
    through = 'c [shape=none label=free pos="45,0"]; a -> b [pos="e,70,0 20,0 30,0 50,0 63,0"]'
    assert clashes_of(f'digraph {{{near} pos="90,0"]; {through}}}') == ["a -> b on 'free'"]
    round_half = 'c [shape=box fixedsize=true label="" width=0.5 height=0.5 pos="90,12"]'
    assert clashes_of(f'digraph {{{near} pos="90,0"]; {round_half}}}') == [
        "the border of c on 'pin'"
    ]
