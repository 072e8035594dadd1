"""Random statecharts whose pictures are checked by geometry: no line or border through text.

The picture is laid out by Graphviz, and its texts, curves and borders are read from there.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator
from functools import cache
from itertools import combinations
from math import inf
from typing import Any, NamedTuple

from random_cases_common import Sibling

from statechart import Runner
from statechart.diagram.dot import dot
from statechart.diagram.layout.graphviz_program import render
from statechart.documents.yaml_reader import read_text
from statechart.running.drawing import drawn

# Of DejaVu Sans, by the size of its type: of ascenders above the line, of descenders below it.
_ABOVE, _BELOW = 0.76, 0.24
_SAMPLES = 100
# Overlaps below these points are not seen.
_TOUCH = 0.5
_WORDS = ["go", "off", "charging", "waits_for_the_operator", "heats_up_to_the_setpoint", "s"]
_GUARDS = ["x > {}", "x > {} and x < 2*{}", "abs(sin(3*x) + cos(x)**2 - {}) > 4 or x > 3*{} + 2"]


class Text(NamedTuple):
    """Words of a picture and their rectangle in points."""

    words: str
    left: float
    low: float
    right: float
    high: float

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point is on the words."""
        across = self.left + _TOUCH < x < self.right - _TOUCH
        return across and self.low + _TOUCH < y < self.high - _TOUCH


def chart(r: random.Random) -> str:
    """Return a chart: nested, parallel, with long names and guards, and many transitions."""
    count = 0
    variables = ["x"]

    def fresh(stem: str) -> str:
        nonlocal count
        count += 1
        return f"{stem}{count}"

    def region(depth: int, pad: str) -> str:
        names = [fresh(r.choice(_WORDS)) for _ in range(r.randrange(1, 5))]
        text = f"{pad}initial: {r.choice(names)}\n{pad}states:\n"
        inner: list[str] = []
        for name in names:
            kind = r.choice([0, 0, 1, 2]) if depth else 0
            body = ""
            for act in ("entry", "exit"):
                if r.random() < 0.25:
                    body += f"{pad}    {act}: {{x: x + 1}}\n"
            if r.random() < 0.25:
                variables.append(fresh("level"))
                rate = r.choice(["1", "-x", f"cos(time) - 0.1*{variables[-1]}"])
                body += f"{pad}    flows: {{{variables[-1]}: {rate}}}\n"
            if kind == 1:
                body += region(depth - 1, pad + "    ")
            if kind == 2:
                body += f"{pad}    regions:\n"
                for _ in range(2):
                    body += f"{pad}      {fresh('r')}:\n{region(depth - 1, pad + '        ')}"
            inner.append(f"{pad}  {name}:" + (f"\n{body}" if body else " {}\n"))
        text += "".join(inner)
        lines = ""
        for _ in range(r.randrange(2 * len(names) + 1)):
            name = fresh(r.choice(_WORDS))
            guard = r.choice(_GUARDS).replace("{}", str(count))
            lines += f"{pad}  - {{name: {name}, from: {r.choice(names)}, "
            lines += f"to: {r.choice(names)}, guard: {guard}}}\n"
        return text + (f"{pad}transitions:\n{lines}" if lines else "")

    depth = r.choice([0, 1, 1, 2])
    regions = range(r.choice([1, 1, 2, 3]))
    body = "".join(f"  {fresh('m')}:\n{region(depth, '    ')}" for _ in regions)
    name = "_".join(r.choice(_WORDS) for _ in range(r.randrange(1, 7)))
    declared = ", ".join(f"{variable}: 0" for variable in variables)
    head = f"kind: chart\nname: {name}\nvariables: {{{declared}}}\n"
    return f"{head}regions:\n{body}stop: {{time: 2}}\n"


def clashes(source: str) -> list[str]:
    """Return the lines and borders that pass text, and texts on each other, of a picture."""
    laid = json.loads(render(source, "json"))
    objects = laid["objects"]
    words = [text for item in objects for text in _texts(item)]
    found = [f"{a.words!r} on {b.words!r}" for a, b in combinations(words, 2) if _meet(a, b)]
    for edge in laid.get("edges", []):
        ends = f"{objects[edge['tail']]['name']} -> {objects[edge['head']]['name']}"
        points = [*_points(edge)]
        found += [f"{ends} on {w.words!r}" for w in words if any(w.holds(*p) for p in points)]
    for item in objects:
        if item.get("_draw_") and item.get("shape") != "none":
            x, y = map(float, item["pos"].split(","))
            w, h = 36.0 * float(item["width"]), 36.0 * float(item["height"])
            box = Text(item["name"], x - w, y - h, x + w, y + h)
            for text in words:
                inside = box.left <= text.left + _TOUCH and text.right - _TOUCH <= box.right
                inside = inside and box.low <= text.low + _TOUCH and text.high - _TOUCH <= box.high
                if _meet(text, box) and not inside:
                    found.append(f"the border of {box.words} on {text.words!r}")
    return found


def _meet(a: Text, b: Text) -> bool:
    across = a.left + _TOUCH < b.right - _TOUCH and b.left + _TOUCH < a.right - _TOUCH
    return across and a.low + _TOUCH < b.high - _TOUCH and b.low + _TOUCH < a.high - _TOUCH


def _texts(item: dict[str, Any]) -> Iterator[Text]:
    size = 0.0
    for one in item.get("_ldraw_", []):
        size = one.get("size", size) if one["op"] == "F" else size
        if one["op"] == "T" and one["text"].strip():
            x, y = one["pt"]
            left = x - {"l": 0.0, "c": 0.5, "r": 1.0}[one["align"]] * one["width"]
            top = y + _ABOVE * size
            yield Text(one["text"], left, y - _BELOW * size, left + one["width"], top)


def _points(edge: dict[str, Any]) -> Iterator[tuple[float, float]]:
    for points in (one["points"] for one in edge.get("_draw_", []) if one["op"] == "b"):
        for k in range(0, len(points) - 3, 3):
            (a, b), (c, d), (e, f), (g, h) = points[k : k + 4]
            for i in range(_SAMPLES + 1):
                t = i / _SAMPLES
                p, q, u, v = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3
                yield p * a + q * c + u * e + v * g, p * b + q * d + u * f + v * h


def layouts(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """Pictures of statecharts: no line or border passes text, in the picture and its legend."""
    text = chart(r)
    found = clashes(dot(drawn(Runner(read_text(text)))[0], r.choice(["legend", "inline"])))
    if found:
        print(text, *found, sep="\n")

    def draw() -> Sibling:
        return {}, lambda result: inf if found else 0.0

    return _idle(), draw


@cache
def _idle() -> Runner:
    """Return a chart to run in place of those that are only drawn."""
    head = "kind: chart\nname: idle\nvariables: {x: 0}\nstop: {time: 1}\n"
    return Runner(read_text(f"{head}regions: {{m: {{initial: rest, states: {{rest: {{}}}}}}}}\n"))
