"""From time steps to a trace: the mode of every region at every step, arcs and jumps.

A step in which nothing strikes is one polynomial: positions of the second degree, rates of the
first, which is what the midpoint rule's positions and velocities at its ends amount to. One with
impacts has them in its middle, with the lasting forces on both sides. A mode that begins without
an impact begins with its step; sticking begins with the step after the one that ended the slip.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contacts.kernels import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.trace import Arc, Clock, Jump, Key

__all__ = ["Chunk", "Recorder"]

Array = NDArray[np.float64]
Codes = NDArray[np.int64]

_NAMES = {
    FREE: "free",
    PIN: "pin",
    SLIDE: "slide",
    SLIDE_PLUS: "slide+",
    SLIDE_MINUS: "slide-",
}


@dataclass(frozen=True, eq=False)
class Chunk:
    """Consecutive steps of one length.

    Attributes
    ----------
    h : float
        Length of a step.
    states : (k + 1, 2 n) array
        The first is where the first step begins.
    solved : (k, u) array
        Accelerations (n,) under what lasts, and the further unknowns.
    codes : (k, r) array
        Mode of every region, as `contacts.kernels` numbers them.
    struck : (k, r) array of bool
        Regions with an impact in the middle of the step.
    impulses : (k, r, 2) array
        Of them.
    approach, closing : (k,) array
        The fastest approach of an impact; the largest gap, of either sign, that a step closes.
    """

    h: float
    states: Array
    solved: Array
    codes: Codes
    struck: NDArray[np.bool_]
    impulses: Array
    approach: Array
    closing: Array

    def first(self, count: int) -> Chunk:
        """Return the first `count` steps."""
        return Chunk(
            self.h,
            self.states[: count + 1],
            self.solved[:count],
            self.codes[:count],
            self.struck[:count],
            self.impulses[:count],
            self.approach[:count],
            self.closing[:count],
        )


@dataclass(eq=False)
class Recorder:
    """Collects steps as arcs and jumps.

    Parameters
    ----------
    regions : sequence of str
        Their names.
    start : (r,) array
        Modes at the start.
    sticks : (r,) array of bool
        Whether the region has a pin beside slide.
    energy : callable
        (state, time) -> energy.
    """

    regions: Sequence[str]
    start: Codes
    sticks: NDArray[np.bool_]
    energy: Callable[[Array, float], float]
    clock: Clock = field(default_factory=Clock)
    arcs: list[Arc] = field(default_factory=list)
    jumps: list[Jump] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.row = self.start
        self.raw = self.start
        self.key = _key(self.start)
        self.start_key = self.key
        self._began = self.clock
        self._open: list[tuple[Array, Array, Array]] = []

    def add(self, chunk: Chunk) -> None:
        """Append steps."""
        shown = self._shown(chunk.codes)
        before = np.vstack([self.row, shown[:-1]])
        hit: NDArray[np.bool_] = np.any(chunk.struck, axis=1)
        changed = np.any(shown != before, axis=1) | hit
        after = np.concatenate([[False], hit[:-1]])
        breaks = np.unique(np.concatenate([[0], np.flatnonzero(changed | after), [len(shown)]]))
        for first, last in zip(breaks[:-1].tolist(), breaks[1:].tolist(), strict=True):
            state = chunk.states[first]
            struck = chunk.struck[first]
            row = np.where(struck, self.row, shown[first])
            self._jump(row, state, state, {})
            if struck.any():
                self._strike(chunk, first, shown[first])
                first += 1
            if last > first:
                self._flow(chunk, first, last)

    def stop(self, name: str, state: Array) -> None:
        """Append the jump of a stop condition."""
        self.close()
        stopped = Jump(
            self.clock.high, len(self.jumps), "", "stop", self.key, self.key, state, state, (name,)
        )
        self.jumps.append(stopped)

    def _shown(self, codes: Codes) -> Codes:
        """Let a slip that comes to rest in a step last to its end."""
        before = np.vstack([self.raw, codes[:-1]])
        slid = (before == SLIDE_PLUS) | (before == SLIDE_MINUS)
        self.raw = codes[-1]
        return np.where((codes == PIN) & slid & self.sticks, before, codes)

    def _flow(self, chunk: Chunk, first: int, last: int) -> None:
        """Append steps of one mode as one arc, or to the last arc."""
        h, n = chunk.h, chunk.states.shape[1] // 2
        left, right = chunk.states[first:last], chunk.states[first + 1 : last + 1]
        coefficients = np.zeros((last - first, 2 * n, 3))
        coefficients[:, :, 0] = left
        coefficients[:, :n, 1] = h * left[:, n:]
        coefficients[:, n:, 1] = right[:, n:] - left[:, n:]
        coefficients[:, :n, 2] = 0.5 * h * coefficients[:, n:, 1]
        times: Array = h * np.arange(last - first + 1, dtype=float)
        self._arc(times, coefficients, chunk.solved[first:last])

    def _strike(self, chunk: Chunk, k: int, row: Codes) -> None:
        """Append a step with impacts in its middle."""
        h, n = chunk.h, chunk.states.shape[1] // 2
        left, right = chunk.states[k], chunk.states[k + 1]
        acceleration = chunk.solved[k : k + 1, :n]
        # Of the velocities as they were and will be, so that the ends of the step are exact.
        halves = []
        for state, sign in ((left, 1.0), (right, -1.0)):
            half = np.zeros((1, 2 * n, 3))
            near = state[n:] + sign * 0.25 * h * acceleration[0]
            other = state[:n] + sign * 0.5 * h * near
            fast = state[n:] + sign * 0.5 * h * acceleration[0]
            begin = (state[:n], state[n:]) if sign > 0.0 else (other, fast)
            half[0, :n, 0], half[0, n:, 0] = begin
            half[0, :n, 1] = 0.5 * h * begin[1]
            half[0, :n, 2] = 0.125 * h**2 * acceleration[0]
            half[0, n:, 1] = 0.5 * h * acceleration[0]
            halves.append(half)
        times = np.array([0.0, 0.5 * h])
        solved = chunk.solved[k : k + 1]
        self._arc(times, halves[0], solved)
        before, after = halves[0][0].sum(axis=1), halves[1][0, :, 0]
        impulses = {
            self.regions[i]: (float(chunk.impulses[k, i, 0]), float(chunk.impulses[k, i, 1]))
            for i in np.flatnonzero(chunk.struck[k]).tolist()
        }
        self._jump(row, before, after, impulses)
        self._arc(times, halves[1], solved)

    def _arc(self, times: Array, coefficients: Array, solved: Array) -> None:
        self._open.append((times, coefficients, solved))
        self.clock = self.clock.later(float(times[-1]))

    def close(self) -> None:
        """End the arc at hand."""
        if not self._open:
            return
        pieces, self._open = self._open, []
        ends, reached = [np.zeros(1)], 0.0
        for times, _, _ in pieces:
            ends.append(reached + times[1:])
            reached = float(ends[-1][-1])
        self.arcs.append(
            Arc(
                self.key,
                self.key,
                self._began,
                len(self.jumps),
                np.concatenate(ends),
                np.concatenate([piece[1] for piece in pieces]),
                np.concatenate([piece[2] for piece in pieces]),
            )
        )
        self._began = self.clock

    def _jump(
        self,
        row: Codes,
        before: Array,
        after: Array,
        impulses: Mapping[str, tuple[float, float]],
    ) -> None:
        """Append a jump for every region that changes, or has an impact."""
        for i, name in enumerate(self.regions):
            if row[i] == self.row[i] and name not in impulses:
                continue
            self.close()
            following = self.row.copy()
            following[i] = row[i]
            target = _key(following)
            energy = None
            if before is not after:
                time = self.clock.high
                energy = self.energy(before, time), self.energy(after, time)
            self.jumps.append(
                Jump(
                    self.clock.high,
                    len(self.jumps),
                    name,
                    _cause(int(self.row[i]), int(row[i]), name in impulses),
                    self.key,
                    target,
                    before,
                    after,
                    impulse={name: impulses[name]} if name in impulses else {},
                    energy=energy,
                )
            )
            self.row, self.key, before = following, target, after


def _key(row: Codes) -> Key:
    return tuple([_NAMES[code] for code in row.tolist()])


def _cause(before: int, after: int, struck: bool) -> str:
    if before == FREE:
        return "touchdown"
    if struck:
        return "impact"
    if after == FREE:
        return "liftoff"
    if after == PIN:
        return "stick"
    return "slip" if before == PIN else "reverse"
