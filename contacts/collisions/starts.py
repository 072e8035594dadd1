"""Where bodies start: formulas of what is declared, over the numbers of its copies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import sympy as sp

from contacts.dynamics.scales import check_range
from contacts.scene.fields import copies
from contacts.scene.scene import Scene
from contacts.scene.shapes import INDEX
from statechart.arrays import Array
from statechart.documents.fields import value_of
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse
from statechart.formulas.parameters import Parameters
from statechart.formulas.writer import compile_tape

_KEYS = ("x", "y", "angle", "dx", "dy", "dangle")


class Starts:
    """The starts of the bodies of a scene.

    Parameters
    ----------
    scene : Scene
        As declared.
    parameters : Parameters
        Its own, and what follows from them.
    """

    def __init__(self, scene: Scene, parameters: Parameters) -> None:
        self._scene = scene
        counts = [1 if n is None else n for n in copies(scene, scene.values()).values()]
        # Of every body what it is a copy of, and its number among those.
        self._kinds = np.repeat(np.arange(len(counts)), counts)
        self._numbers = np.concatenate([np.arange(count) for count in counts])
        index = sp.Symbol("index", real=True)
        expressions = []
        for body in scene.bodies.values():
            known = dict(parameters.symbols) if body.copies is None else {
                **parameters.symbols, INDEX: index
            }  # fmt: skip
            expressions += [parse(body.start.get(k, 0)).to_sympy(known) for k in _KEYS]  # type: ignore[call-overload]
        self._tape = compile_tape(
            expressions,
            variables=(index,),
            parameters=parameters.ordered,
            time=sp.Symbol("t", real=True),
        )

    def at(self, values: Array, known: Mapping[str, float]) -> Array:
        """Return coordinates, then rates, of all bodies (6 b,).

        Raises
        ------
        DeclarationProblem
            If one has no value, or none that can be computed with.
        """
        rows = np.arange(self._numbers.max() + 1, dtype=float)
        found = self._tape.table(rows[:, None], values, np.zeros(len(rows)))
        starts: Array = found.reshape(len(rows), -1, 6)[self._numbers, self._kinds]
        worst = np.abs(starts)
        b, at = np.unravel_index(int(np.argmax(worst)), worst.shape)
        self._check(int(b), int(at), float(starts[b, at]), known)
        return starts.reshape(-1, 2, 3).transpose(1, 0, 2).reshape(-1)

    def _check(self, b: int, at: int, value: float, known: Mapping[str, float]) -> None:
        """Check the largest of the numbers of a start, or one that is none."""
        owner, key = list(self._scene.bodies)[self._kinds[b]], _KEYS[at]
        loc, copied = ("bodies", owner, "start", key), self._scene.bodies[owner].copies is not None
        which = f" of {owner}{self._numbers[b]}" if copied else ""
        if not np.isfinite(value):
            text = self._scene.bodies[owner].start[key]  # type: ignore[index]
            numbered = {**known, INDEX: float(self._numbers[b])} if copied else known
            try:
                value_of(text, numbered, *loc)
            except DeclarationProblem as problem:
                problem.message += f", the {key}{which}" if copied else ""
                raise
            raise DeclarationProblem(f"must be finite, not {value:g}{which}", loc=loc)
        check_range(value, f"the start{which}", loc)
