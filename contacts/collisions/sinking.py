"""The deepest penetration of a run, beside the inner radius of what sinks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from contacts.collisions.own_step import inner_radii
from contacts.detection.body_numbers import BodyNumbers
from contacts.time_stepping.chunk import Chunk
from statechart.arrays import Array

# Deeper than this part of its inner radius, a body may leave through another side.
_DEEP = 0.1


class _Found(NamedTuple):
    """The deepest penetration: of which body, and when."""

    body: int
    depth: float
    state: Array
    time: float
    h: float


class Sinking:
    """Watches how deep bodies are in each other and in surfaces.

    Parameters
    ----------
    names : sequence of str
    numbers : BodyNumbers
    start_depth : float
        How deep bodies start in each other at most.
    """

    def __init__(self, names: Sequence[str], numbers: BodyNumbers, start_depth: float) -> None:
        self._names, self._radii = names, inner_radii(numbers)
        self._start_depth, self._part = start_depth, _DEEP
        self._found: _Found | None = None

    def look(self, start: float, chunk: Chunk) -> None:
        """Note the deepest penetration of some steps that begin at `start`."""
        depths = -np.minimum(chunk.gaps, 0.0)
        parts = np.where(depths > self._start_depth, depths / self._radii, 0.0)
        if not parts.max(initial=0.0) > self._part:
            return
        k, b = (int(i) for i in np.unravel_index(np.argmax(parts), parts.shape))
        self._part = float(parts[k, b])
        # Gaps are those in the middle of a step.
        middle, n = chunk.states[k].copy(), 3 * len(self._names)
        middle[:n] += 0.5 * chunk.h * middle[n : 2 * n]
        self._found = _Found(b, float(depths[k, b]), middle, start + (k + 0.5) * chunk.h, chunk.h)

    def remarks(self, deepest_at: Callable[[int, Array, float], str]) -> tuple[str, ...]:
        """Return a warning of what has sunk."""
        if self._found is None:
            return ()
        body, depth, state, time, h = self._found
        other = deepest_at(body, state, time) or "what it touches"
        step = _DEEP * h / self._part
        digits = 10.0 ** math.floor(math.log10(step))
        return (
            f"body {self._names[body]!r} is {depth:.3g} deep in {other} at t = "
            f"{time:.6g}, with an inner radius of {self._radii[body]:.3g}: it may pass "
            f"through; take steps of {math.floor(step / digits) * digits:.1g} or less",
        )
