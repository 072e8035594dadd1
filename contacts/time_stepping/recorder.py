"""From time steps to a trace: the mode of every region at every step, arcs and jumps.

A step in which nothing strikes is one polynomial: positions of the second degree, rates of the
first, which is what the midpoint rule's positions and velocities at its ends amount to. One with
impacts has them in its middle, with the lasting forces on both sides. A mode that begins without
an impact begins with its step; sticking begins with the step after the one that ended the slip.
A step that holds an impulse has no force, nor have those after it that still carry the landing:
what is shown is that of the nearest other step of the mode.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from contacts.states import FREE, OFF_CODE, PIN, SLIDE_MINUS, SLIDE_PLUS, STATES, cause_of
from contacts.time_stepping.chunk import Chunk
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Arc, Clock, Jump, Key

TERMS = 3
"""Terms of the polynomial of a step."""


@dataclass(eq=False)
class Recorder:
    """Collects steps as arcs and jumps.

    Parameters
    ----------
    regions : sequence of str
        Names of those that steps recognise.
    start : (r,) array
        Modes at the start.
    controls : Key
        States of further regions, which change only where they are told to.
    sticks : (r,) array of bool
        Whether the region has a pin beside slide.
    again : str
        Cause of an impact on a region that is not free.
    forces : int or None
        Place of the first region's V and H among the further unknowns; None: they have none.
    energy : callable
        (state, time) -> energy.
    coordinates : int
        How many there are; behind them and their rates stands what controllers remember.
    """

    regions: Sequence[str]
    start: Ints
    controls: Key
    sticks: Bools
    again: str
    forces: int | None
    energy: Callable[[Array, float], float]
    coordinates: int
    clock: Clock = field(default_factory=Clock)
    arcs: list[Arc] = field(default_factory=list)
    jumps: list[Jump] = field(default_factory=list)
    indeterminate: dict[Key, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.row = self.start
        self._raw = self.start
        self.key = self._key(self.start)
        self.start_key = self.key
        self._began = self.clock
        self._open: list[tuple[Array, Array, Array]] = []

    def add(self, chunk: Chunk) -> None:
        """Append steps."""
        shown = self._shown(chunk.codes)
        hit: Bools = np.any(chunk.struck, axis=1)
        changed = self._changed(shown) | hit
        self._raw = chunk.codes[-1]
        after = np.concatenate([[False], hit[:-1]])
        breaks = np.unique(np.concatenate([[0], np.flatnonzero(changed | after), [len(shown)]]))
        for first, last in zip(breaks[:-1].tolist(), breaks[1:].tolist(), strict=True):
            state = chunk.states[first]
            if hit[first]:
                self._strike(chunk, first, shown[first])
                first += 1
            else:
                self._jumps(shown[first], state)
            if last > first:
                self._note_shared(chunk.shared[first:last])
                self._flow(chunk, first, last)

    def changes(self, chunk: Chunk) -> Bools:
        """Return the steps (k,) in which `add` will record jumps."""
        return self._changed(self._shown(chunk.codes)) | np.any(chunk.struck, axis=1)

    def turn(
        self,
        region: str,
        cause: str,
        controls: Key,
        states: tuple[Array, Array],
        fired: tuple[str, ...],
    ) -> Jump:
        """Append a jump of a further region, from one state to another; return it."""
        self.close()
        target = (*self.key[: len(self.row)], *controls)
        jump = Jump(
            self.clock.high, len(self.jumps), region, cause, self.key, target, *states, fired
        )
        self.jumps.append(jump)
        self.controls, self.key = controls, target
        return jump

    def rewind(self, key: Key) -> None:
        """Go back to the mode of the last arc, its end cut off."""
        self.key, self.clock = key, self.arcs[-1].end

    def stop(self, name: str, state: Array) -> None:
        """Append the jump of a stop condition."""
        self.close()
        stopped = Jump(
            self.clock.high, len(self.jumps), "", "stop", self.key, self.key, state, state, (name,)
        )
        self.jumps.append(stopped)

    def _key(self, row: Ints) -> Key:
        return (*[STATES[code] for code in row.tolist()], *self.controls)

    def _shown(self, codes: Ints) -> Ints:
        """Let a slip that comes to rest in a step last to its end."""
        before = np.vstack([self._raw, codes[:-1]])
        slid = (before == SLIDE_PLUS) | (before == SLIDE_MINUS)
        return np.where((codes == PIN) & slid & self.sticks, before, codes)

    def _changed(self, shown: Ints) -> Bools:
        found: Bools = np.any(shown != np.vstack([self.row, shown[:-1]]), axis=1)
        return found

    def _note_shared(self, shared: Bools) -> None:
        if shared.any():
            names = {self.regions[i] for i in np.flatnonzero(shared.any(axis=0)).tolist()}
            names.update(self.indeterminate.get(self.key, ()))
            self.indeterminate[self.key] = tuple(n for n in self.regions if n in names)

    def _flow(self, chunk: Chunk, first: int, last: int) -> None:
        """Append steps of one mode as one arc, or to the last arc."""
        h, n = chunk.h, self.coordinates
        left, right = chunk.states[first:last], chunk.states[first + 1 : last + 1]
        coefficients = np.zeros((*left.shape, TERMS))
        coefficients[:, :, 0] = left
        coefficients[:, :n, 1] = h * left[:, n : 2 * n]
        coefficients[:, n:, 1] = right[:, n:] - left[:, n:]
        coefficients[:, :n, 2] = 0.5 * h * coefficients[:, n : 2 * n, 1]
        times: Array = h * np.arange(last - first + 1, dtype=float)
        self._arc(times, coefficients, chunk.solved[first:last])

    def _strike(self, chunk: Chunk, k: int, row: Ints) -> None:
        """Append a step with impacts in its middle: one jump, whose impulses all regions feel."""
        h, n = chunk.h, self.coordinates
        left, right = chunk.states[k], chunk.states[k + 1]
        middle = 0.5 * (left + right)[2 * n :]
        acceleration = chunk.solved[k : k + 1, :n]
        # Of the velocities as they were and will be, so that the ends of the step are exact.
        halves = []
        for state, sign in ((left, 1.0), (right, -1.0)):
            half = np.zeros((1, len(state), TERMS))
            rates = state[n : 2 * n]
            near = rates + sign * 0.25 * h * acceleration[0]
            other = state[:n] + sign * 0.5 * h * near
            fast = rates + sign * 0.5 * h * acceleration[0]
            begin = (state[:n], rates) if sign > 0.0 else (other, fast)
            half[0, :n, 0], half[0, n : 2 * n, 0] = begin
            half[0, :n, 1] = 0.5 * h * begin[1]
            half[0, :n, 2] = 0.125 * h**2 * acceleration[0]
            half[0, n : 2 * n, 1] = 0.5 * h * acceleration[0]
            half[0, 2 * n :, 0] = state[2 * n :] if sign > 0.0 else middle
            half[0, 2 * n :, 1] = sign * (middle - state[2 * n :])
            halves.append(half)
        times = np.array([0.0, 0.5 * h])
        self._arc(times, halves[0], self._held(chunk.solved[k]))
        before, after = halves[0][0].sum(axis=1), halves[1][0, :, 0]
        impulses = {
            self.regions[i]: (float(chunk.impulses[k, i, 0]), float(chunk.impulses[k, i, 1]))
            for i in np.flatnonzero(chunk.impulses[k].any(axis=1)).tolist()
        }
        self.close()
        place = int(np.argmax(chunk.struck[k]))
        time = self.clock.high
        self._jump(
            place,
            self._cause(int(self.row[place]), int(row[place]), True),
            row,
            before,
            after,
            impulses,
            (self.energy(before, time), self.energy(after, time)),
        )
        self._arc(times, halves[1], self._held(chunk.solved[k]))

    def _held(self, solved: Array) -> Array:
        """Return the unknowns (1, u) without forces where the mode at hand is open."""
        found = solved[None].copy()
        if self.forces is not None:
            for i in np.flatnonzero((self.row == FREE) | (self.row == OFF_CODE)).tolist():
                at = self.forces + 2 * i
                found[0, at : at + 2] = 0.0
        return found

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
                roles_in(self.key),
                self._began,
                len(self.jumps),
                np.concatenate(ends),
                np.concatenate([piece[1] for piece in pieces]),
                _defined(np.concatenate([piece[2] for piece in pieces])),
            )
        )
        self._began = self.clock

    def _jumps(self, row: Ints, state: Array) -> None:
        """Append a jump for every region that changes."""
        for i in np.flatnonzero(row != self.row).tolist():
            self.close()
            following = self.row.copy()
            following[i] = row[i]
            cause = self._cause(int(self.row[i]), int(row[i]), False)
            self._jump(i, cause, following, state, state, {}, None)

    def _jump(
        self,
        place: int,
        cause: str,
        row: Ints,
        before: Array,
        after: Array,
        impulses: Mapping[str, tuple[float, float]],
        energy: tuple[float, float] | None,
    ) -> None:
        target = self._key(row)
        self.jumps.append(
            Jump(
                self.clock.high,
                len(self.jumps),
                self.regions[place],
                cause,
                self.key,
                target,
                before,
                after,
                impulse=impulses,
                energy=energy,
            )
        )
        self.row, self.key = row, target

    def _cause(self, before: int, after: int, struck: bool) -> str:
        found = cause_of(STATES[before], STATES[after])
        lasting = found in ("liftoff", "stick", "slip", "reverse")
        return self.again if struck and lasting else found


def _defined(rows: Array) -> Array:
    """Put in the place of what is not a number what the nearest row has, the later of two."""
    unknown = np.isnan(rows)
    if not unknown.any():
        return rows
    result = rows.copy()
    for column in np.flatnonzero(unknown.any(axis=0)).tolist():
        known = np.flatnonzero(~unknown[:, column])
        if not len(known):
            continue
        blank = np.flatnonzero(unknown[:, column])
        after = np.minimum(np.searchsorted(known, blank), len(known) - 1)
        before = np.maximum(after - 1, 0)
        later = np.abs(known[after] - blank) <= np.abs(known[before] - blank)
        result[blank, column] = rows[np.where(later, known[after], known[before]), column]
    return result
