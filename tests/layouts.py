"""Texts, borders and lines of a diagram as Graphviz lays it out, and where they meet."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import combinations
from typing import Any, NamedTuple

from statechart.diagram.layout.graphviz_program import render

# Heights of ascenders and descenders of DejaVu Sans, relative to the font size.
ABOVE, BELOW = 0.76, 0.24


class Rectangle(NamedTuple):
    what: str
    left: float
    low: float
    right: float
    high: float

    def meets(self, other: Rectangle) -> bool:
        across = self.left < other.right and other.left < self.right
        return across and self.low < other.high and other.low < self.high

    def holds(self, x: float, y: float) -> bool:
        return self.left < x < self.right and self.low < y < self.high

    def shrunk(self, by: float) -> Rectangle:
        return Rectangle(self.what, self.left + by, self.low + by, self.right - by, self.high - by)


def texts(item: dict[str, Any]) -> Iterator[Rectangle]:
    size = 0.0
    for one in item.get("_ldraw_", []):
        size = one.get("size", size) if one["op"] == "F" else size
        if one["op"] == "T" and one["text"].strip():
            x, y = one["pt"]
            left = x - {"l": 0.0, "c": 0.5, "r": 1.0}[one["align"]] * one["width"]
            yield Rectangle(
                one["text"], left, y - BELOW * size, left + one["width"], y + ABOVE * size
            )


def border(item: dict[str, Any]) -> Rectangle:
    x, y = map(float, item["pos"].split(","))
    width, height = 36 * float(item["width"]), 36 * float(item["height"])
    return Rectangle(item["name"], x - width, y - height, x + width, y + height)


def line(item: dict[str, Any]) -> Iterator[tuple[float, float]]:
    """Points on an edge, closer to each other than any letter is wide."""
    curves = [one["points"] for one in item["_draw_"] if one["op"] == "b"]
    for points in curves:
        for k in range(0, len(points) - 3, 3):
            (a, b), (c, d), (e, f), (g, h) = points[k : k + 4]
            for i in range(201):
                t = i / 200
                p, q, u, v = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3
                yield p * a + q * c + u * e + v * g, p * b + q * d + u * f + v * h


def clashes(source: str, touch: float = 0.0) -> list[str]:
    """Return the lines and borders that pass text, and texts on each other, by more than `touch`.

    `source` is in Graphviz' language; `touch` in points.
    """
    laid = json.loads(render(source, "json"))
    words = [text.shrunk(touch) for item in laid["objects"] for text in texts(item)]
    assert words
    found = [f"{a.what!r} on {b.what!r}" for a, b in combinations(words, 2) if a.meets(b)]
    for edge in laid.get("edges", []):
        course = list(line(edge))
        assert course
        ends = f"{laid['objects'][edge['tail']]['name']} -> {laid['objects'][edge['head']]['name']}"
        found += [f"{ends} on {w.what!r}" for w in words if any(w.holds(*p) for p in course)]
    for item in laid["objects"]:
        if item.get("_draw_") and item.get("shape") != "none":
            box = border(item)
            found += [
                f"the border of {box.what} on {w.what!r}"
                for w in words
                if w.meets(box.shrunk(touch))
                and not (box.holds(w.left, w.low) and box.holds(w.right, w.high))
            ]
    return found
