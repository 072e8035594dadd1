"""Warnings of a run: its deepest penetration, and heights that have no value below bodies."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.collision_detection.surfaces import GRAPH
from contacts.rigid_bodies.own_step import inner_radii
from contacts.time_stepping.chunk import Chunk
from statechart.arrays import Array
from statechart.kernels.tapes import ACOS, ASIN, DIV, LOG, POW, POWI, SQRT, TAN, tape_table

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
    """Watches how deep bodies are in each other and in surfaces."""

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


# What has no value, or an infinite one, somewhere; the others have one wherever their operands do.
_PARTIAL = (DIV, POW, POWI, SQRT, LOG, TAN, ASIN, ACOS)


class NoGround:
    """Looks, in a run, for the first place of each height that has no value."""

    def __init__(self, names: Sequence[str], surfaces: Sequence[str], numbers: BodyNumbers) -> None:
        self._names, self._surfaces, self._numbers = names, surfaces, numbers
        ground = numbers.surfaces
        partial = np.isin(ground.code[:, 0], _PARTIAL).any()
        self._unseen = np.flatnonzero(ground.kinds == GRAPH).tolist() if partial else []
        self.remarks: tuple[str, ...] = ()

    def look(self, start: float, h: float, states: Array, frames: Array) -> None:
        """Look below the left and the right end of bodies, and their centres, at ends of steps."""
        for s in self._unseen.copy():
            if found := self._first(s, states, frames):
                step, body, x = found
                self._unseen.remove(s)
                self.remarks += (
                    f"the height of surface {self._surfaces[s]!r} has no value at x = {x:.6g}, "
                    f"where body {self._names[body]!r} is at t = {start + step * h:.6g}: there is "
                    "no ground",
                )

    def _first(self, s: int, states: Array, frames: Array) -> tuple[int, int, float] | None:
        """Return the first step and body with a place that has no height, and the place."""
        numbers, ground = self._numbers, self._numbers.surfaces
        count, carrier = len(self._names), int(ground.carriers[s])
        places = states[:, : 3 * count].reshape(len(states), count, 3)
        below = numbers.laws[numbers.kinds, len(numbers.laws) + s] >= 0
        if carrier >= 0:
            below[carrier] = False
        bodies = np.flatnonzero(below)
        frame = frames[np.minimum(np.arange(len(states)), len(frames) - 1), s]
        if carrier >= 0:
            frame = places[:, carrier]
        u, v, angle = (frame[:, d, None] for d in range(3))
        x = np.cos(angle) * (places[:, bodies, 0] - u) + np.sin(angle) * (places[:, bodies, 1] - v)
        asked = x[:, :, None] + numbers.sizes[bodies, None] * np.array([0.0, -1.0, 1.0])
        at = int(ground.graphs[s])
        heights = tape_table(
            ground.code, ground.constants, ground.outputs[at : at + 1], 0,
            np.ascontiguousarray(asked.reshape(-1, 1)), ground.values, np.zeros(asked.size),
        )  # fmt: skip
        lost = ~np.isfinite(heights.reshape(asked.shape))
        if not lost.any():
            return None
        step, body, end = np.unravel_index(int(np.argmax(lost)), lost.shape)
        return int(step), int(bodies[body]), float(asked[step, body, end])
