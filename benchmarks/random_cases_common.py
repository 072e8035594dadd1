"""Shared runners, readings and comparisons of the families of random cases.

A family returns a runner and a function that draws siblings: parameters, and a check of the run.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from math import inf

import numpy as np

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result

G = 9.81
Values = dict[str, float]
Check = Callable[[Result], float]  # error relative to the allowed one
Sibling = tuple[Values, Check]
Family = Callable[[random.Random], tuple[Runner, Callable[[], Sibling]]]
Signal = Callable[[np.ndarray, list[float]], np.ndarray]


def scene(text: str, end: object = 1, **setting: object) -> Runner:
    """Return the runner of a scene under gravity."""
    head = f"kind: scene\nname: sibling\ngravity: {G}\nstop: {{time: {end}}}\n"
    return Runner(read_text(head + text), **setting)  # type: ignore[arg-type]


def final(result: Result, name: str) -> float:
    """Return a component of the state at the end."""
    return float(result.trace.final[list(result.trace.variables).index(name)])


def instants(result: Result, *causes: str) -> list[float]:
    """Return the times of all jumps of some causes."""
    return [jump.t for jump in result.trace.jumps if jump.cause in causes]


def off(found: list[float], wanted: list[float], allowed: float) -> float:
    """Return by how much lists of numbers differ, in parts of what is allowed."""
    if len(found) != len(wanted):
        return inf
    return max((abs(a - b) for a, b in zip(found, wanted, strict=True)), default=0.0) / allowed


def power(r: random.Random, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(10.0 ** r.uniform(low, high))


def slid(v: float, push: float, drag: float, t: float) -> float:
    """Return how far something slides in t under a push and friction, which holds it at rest."""
    a = push - drag
    return v * t + 0.5 * a * t * t if a >= 0 or v + a * t > 0 else -0.5 * v * v / a
