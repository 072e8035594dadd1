"""Surfaces that bodies collide with, as numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import numpy as np
import sympy as sp

from contacts.collision_detection.surfaces import GRAPH, HOLLOW, LINE, PLATE, ROUND, SurfaceNumbers
from contacts.scene.parts import Surface
from contacts.scene.scene import Scene
from statechart.documents.fields import FormulaText
from statechart.formulas.formula import parse
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape

Number = Callable[[FormulaText], float]
_Numbers = tuple[float, float, float, float]


def touched(scene: Scene) -> list[str]:
    """Return the names of the surfaces that bodies with shapes touch."""
    used = {name for collision in scene.collisions.values() for name in collision.surfaces}
    return [name for name in scene.surfaces if name in used]


def surface_numbers(
    scene: Scene, bodies: Sequence[str], known: Mapping[str, float]
) -> SurfaceNumbers:
    """Evaluate the surfaces of a scene."""

    def number(text: FormulaText) -> float:
        return parse(text).value(known)

    surfaces = [scene.surfaces[name] for name in touched(scene)]
    found = [_form(surface, number) for surface in surfaces]
    heights = tuple(
        str(surface.height)
        for (kind, _), surface in zip(found, surfaces, strict=True)
        if kind == GRAPH
    )
    program = _program(heights, tuple(known))
    graphs = np.cumsum([kind == GRAPH for kind, _ in found], dtype=np.int64) - 1
    values = np.array([*known.values()], dtype=float)

    return SurfaceNumbers(
        np.array([kind for kind, _ in found], dtype=np.int64),
        np.array([numbers for _, numbers in found], dtype=float).reshape(-1, 4),
        np.array([-1 if s.body is None else bodies.index(s.body) for s in surfaces], np.int64),
        np.array([s.moves for s in surfaces], np.bool_),
        3 * graphs,
        program.code,
        program.constants,
        program.outputs,
        values,
    )


def _form(surface: Surface, number: Number) -> tuple[int, _Numbers]:
    """Return the kind of a surface, and its numbers."""
    if surface.height is not None:
        if "x" in parse(surface.height).names:
            return GRAPH, (0.0, 0.0, 0.0, 0.0)
        return LINE, (0.0, number(surface.height), 0.0, 1.0)
    if surface.circle is not None and surface.radius is not None:
        x, y = (number(text) for text in surface.circle)
        return HOLLOW if surface.hollow else ROUND, (x, y, number(surface.radius), 0.0)
    ends = surface.line or surface.edge
    if ends is not None:
        (x0, y0), (x1, y1) = ((number(x), number(y)) for x, y in ends)
        if surface.edge is not None:
            return PLATE, (x0, y0, x1, y1)
        length = math.hypot(x1 - x0, y1 - y0)
        return LINE, (x0, y0, (y0 - y1) / length, (x1 - x0) / length)
    angle = number(surface.incline or 0)
    x, y = (number(text) for text in surface.through)
    return LINE, (x, y, -math.sin(angle), math.cos(angle))


@lru_cache(maxsize=16)
def _program(heights: tuple[str, ...], names: tuple[str, ...]) -> Tape:
    """Compile heights, their slopes and curvatures over x and parameters."""
    x, parameters = sp.Symbol("x", real=True), symbols_of(names)
    found: list[sp.Expr] = []
    for text in heights:
        height = parse(text).to_sympy({**dict(zip(names, parameters, strict=True)), "x": x})
        found += [height, sp.diff(height, x), sp.diff(height, x, 2)]
    return compile_tape(
        found, variables=(x,), parameters=parameters, time=sp.Symbol("t", real=True)
    )


def symbols_of(names: Sequence[str]) -> tuple[sp.Symbol, ...]:
    """Return symbols for parameters."""
    return tuple(sp.Symbol(f"p{i}", real=True) for i in range(len(names)))
