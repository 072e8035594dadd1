"""Warnings of transitions that are taken before their guard is true, within the tolerance."""

from __future__ import annotations

import pytest

from statechart import run
from statechart.documents.yaml_reader import read_text

_FALLS = """
kind: scene
name: falls
gravity: 10
bodies: {ball: {mass: 1, start: {y: 1}}}
controls: {one: 0, two: 0}
forces: {f: {body: ball, force: [one + two, 0]}}
regions:
  a:
    initial: w
    states: {w: {}, "on": {sets: {one: 1}}}
    transitions: [{name: first, from: w, to: "on", guard: ball.y <= 0.5}]
  b:
    initial: w
    states: {w: {}, "on": {sets: {two: 1}}}
    transitions: [{name: second, from: w, to: "on", guard: "ball.y <= 0.5 - APART"}]
stop: {time: 1}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("apart", "tolerance", "warned"),
    [(0, 1e-6, False), (1e-7, 1e-6, True), (1e-5, 1e-6, True), (1e-7, 1e-12, False)],
)
def test_guard_within_tolerance_fires_with_a_warning(
    engine: str, apart: float, tolerance: float, warned: bool
) -> None:
    result = run(read_text(_FALLS.replace("APART", str(apart))), engine=engine, tolerance=tolerance)
    first, second = (jump.t for jump in result.trace.jumps)
    assert (first == second) == (warned or apart == 0)
    assert [
        f"b.second counts as true: it is {apart:.2g} short" in text for text in result.warnings
    ] == ([True] if warned else [])
