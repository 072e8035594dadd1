"""From time steps to a trace: the mode of every region at every step, arcs and jumps.

Impacts are in the middle of their step. A mode that begins without an impact begins with its step;
sticking begins with the step after the one that ended the slip. A step that holds an impulse has no
force, nor have those after it that still carry the landing: what is shown is that of the nearest
other step of the mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from contacts.states import (
    FREE,
    OFF_CODE,
    PIN,
    SLIDE_MINUS,
    SLIDE_PLUS,
    STATES,
    cause_of,
    undetermined,
)
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.polynomials import defined, smooth, struck
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.clock import Clock
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Arc, Jump, Key

# An arc longer than so many bytes goes on as another one.
_LONGEST = 2**23


class _Tail(NamedTuple):
    """A step, and the recorder before it: modes shown and told, jumps, and when it begins."""

    step: Chunk
    row: Ints
    raw: Ints
    jumps: int
    clock: Clock


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
    modes : bool
        Whether modes and jumps of regions are told; else it is counted how many jumps there are,
        and arcs end where they would.
    arcs_too : bool
        Whether somebody looks at arcs; else they are made of the last step of a run alone, in which
        a stop condition may be met.

    Attributes
    ----------
    arcs, jumps : list
        Since they were last taken.
    told : list of Jump
        Those of further regions, as a trace tells them that has no others, and the stop.
    """

    regions: Sequence[str]
    start: Ints
    controls: Key
    sticks: Bools
    again: str
    forces: int | None
    energy: Callable[[Array, float], float]
    coordinates: int
    modes: bool = True
    arcs_too: bool = True
    clock: Clock = field(default_factory=Clock)
    arcs: list[Arc] = field(default_factory=list)
    jumps: list[Jump] = field(default_factory=list)
    told: list[Jump] = field(default_factory=list)
    count: int = 0
    indeterminate: dict[Key, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.row, self._sticking = self.start, bool(self.sticks.any())
        self._raw = self.start
        self.key = self._key(self.start)
        self.start_key = self.key
        self._began = self.clock
        self._open: list[tuple[Array, Array, Array]] = []
        self._size = 0
        self._tail: _Tail | None = None

    def add(self, chunk: Chunk) -> None:
        """Append steps."""
        if self.arcs_too:
            self._append(chunk)
        else:
            self._tail = self._counted(chunk)

    def _append(self, chunk: Chunk) -> None:
        shown = self._shown(chunk.codes)
        hit: Bools = np.any(chunk.struck, axis=1)
        begins = np.ones(len(shown) + 1, np.bool_)
        begins[:-1] = self._changed(shown) | hit
        begins[1:-1] |= hit[:-1]
        begins[0] = True
        breaks = np.flatnonzero(begins)
        self._raw = chunk.codes[-1]
        shared, halves = self.modes and bool(chunk.shared.any()), self._halves(chunk, hit)
        for first, last in zip(breaks[:-1].tolist(), breaks[1:].tolist(), strict=True):
            if hit[first]:
                self._strike(chunk, first, shown[first], next(halves))
                first += 1
            else:
                self._jumps(shown[first], chunk.states[first])
            if last > first:
                if shared:
                    self._note_shared(chunk.shared[first:last])
                self._flow(chunk, first, last)

    def _counted(self, chunk: Chunk) -> _Tail:
        """Count the jumps of steps; return the last of them as it can be appended."""
        last, half = len(chunk.codes) - 1, 0.5 * chunk.h
        shown, hit = self._shown(chunk.codes), np.any(chunk.struck, axis=1).tolist()
        jumps = np.where(hit, 1, np.count_nonzero(self._differs(shown), axis=1))
        begin = self.clock.later(last * chunk.h).short
        tail = _Tail(
            chunk.after(last),
            shown[last - 1] if last else self.row,
            chunk.codes[last - 1] if last else self._raw,
            self.count + int(jumps[:last].sum()),
            begin,
        )
        self.row, self._raw = shown[last], chunk.codes[last]
        self.count, self.clock = tail.jumps + int(jumps[last]), begin
        # As it is appended.
        for part in (half, half) if hit[last] else (chunk.h,):
            self.clock = self.clock.later(part).short
        return tail

    def _append_tail(self, tail: _Tail) -> None:
        """Append the last step of those that were only counted."""
        self.row, self._raw, self.count, self.clock = tail[1:]
        self._began, self._tail = self.clock, None
        self._append(tail.step)

    def changes(self, chunk: Chunk) -> Bools:
        """Return the steps (k,) in which `add` will record jumps."""
        return self._changed(self._shown(chunk.codes)) | np.any(chunk.struck, axis=1)

    def taken(self) -> tuple[list[Arc], list[Jump]]:
        """Hand over the arcs that have ended, and the jumps, since the last time."""
        found = self.arcs, self.jumps
        self.arcs, self.jumps = [], []
        return found

    def since(self, count: int) -> list[Jump]:
        """Return the jumps after so many."""
        return self.jumps[len(self.jumps) - (self.count - count) :] if self.modes else []

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
        jump = Jump(self.clock.high, self.count, region, cause, self.key, target, *states, fired)
        self._note(jump)
        self.told.append(replace(jump, j=len(self.told), source=self.controls, target=controls))
        self.controls, self.key = controls, target
        return jump

    def drop(self) -> Arc:
        """Take back the last arc, and the jumps before it; return the one that is the last now."""
        self.arcs.pop()
        last = self.arcs[-1]
        if self.modes:
            del self.jumps[len(self.jumps) - (self.count - last.j) :]
        self.count = last.j
        return last

    def rewind(self, last: Arc) -> None:
        """Go back to the end of the last arc, cut off, which stands in its place."""
        self.arcs[-1] = last
        self.key, self.clock = last.mode, last.end

    def stop(self, name: str, state: Array) -> None:
        """Append the jump of a stop condition."""
        self.close()
        key, controls = self.key, self.controls
        stopped = Jump(self.clock.high, self.count, "", "stop", key, key, state, state, (name,))
        self._note(stopped)
        self.told.append(replace(stopped, j=len(self.told), source=controls, target=controls))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is told of forces that the motion leaves open, once each."""
        return tuple(dict.fromkeys(map(undetermined, self.indeterminate.values())))

    def _key(self, row: Ints) -> Key:
        return (*map(STATES.__getitem__, row.tolist()), *self.controls)

    def _shown(self, codes: Ints) -> Ints:
        """Let a slip that comes to rest in a step last to its end."""
        if not self._sticking:
            return codes
        before = np.vstack([self._raw, codes[:-1]])
        slid = (before == SLIDE_PLUS) | (before == SLIDE_MINUS)
        return np.where((codes == PIN) & slid & self.sticks, before, codes)

    def _changed(self, shown: Ints) -> Bools:
        found: Bools = np.any(self._differs(shown), axis=1)
        return found

    def _differs(self, shown: Ints) -> Bools:
        """Return which regions (k, r) are otherwise than in the step before."""
        found = np.empty(shown.shape, np.bool_)
        np.not_equal(shown[:1], self.row, out=found[:1])
        np.not_equal(shown[1:], shown[:-1], out=found[1:])
        return found

    def _note_shared(self, shared: Bools) -> None:
        if shared.any():
            names = {self.regions[i] for i in np.flatnonzero(shared.any(axis=0)).tolist()}
            names.update(self.indeterminate.get(self.key, ()))
            self.indeterminate[self.key] = tuple(n for n in self.regions if n in names)

    def _flow(self, chunk: Chunk, first: int, last: int) -> None:
        """Append steps of one mode as one arc, or to the last arc."""
        h, left, right = chunk.h, chunk.states[first:last], chunk.states[first + 1 : last + 1]
        coefficients = smooth(left, right, h, self.coordinates)
        times: Array = h * np.arange(last - first + 1, dtype=float)
        self._arc(times, coefficients, chunk.solved[first:last])

    def _halves(self, chunk: Chunk, hit: Bools) -> Iterator[tuple[Array, Array, Array]]:
        """Yield the coefficients (1, w, TERMS) of both halves of every step with impacts.

        And the states (2, w) before and after these.
        """
        steps, n = np.flatnonzero(hit), self.coordinates
        if not len(steps):
            return
        left, right = chunk.states[steps], chunk.states[steps + 1]
        first, second = struck(left, right, chunk.solved[steps, :n], chunk.h, n)
        states = np.stack([first.sum(axis=2), second[:, :, 0]], axis=1)
        for i in range(len(steps)):
            yield first[i : i + 1], second[i : i + 1], states[i]

    def _strike(self, chunk: Chunk, k: int, row: Ints, halves: tuple[Array, Array, Array]) -> None:
        """Append a step with impacts in its middle: one jump, whose impulses all regions feel."""
        times, (first, second, states) = np.array([0.0, 0.5 * chunk.h]), halves
        self._arc(times, first, self._held(chunk.solved[k : k + 1]))
        self.close()
        if self.modes:
            self._struck(chunk, k, row, states)
        else:
            self.row, self.count = row, self.count + 1
        self._arc(times, second, self._held(chunk.solved[k : k + 1]))

    def _struck(self, chunk: Chunk, k: int, row: Ints, states: Array) -> None:
        """Append the jump of a step with impacts, at the states (2, w) before and after it."""
        felt = np.flatnonzero(chunk.impulses[k].any(axis=1))
        impulses = {
            self.regions[i]: (normal, tangential)
            for i, (normal, tangential) in zip(
                felt.tolist(), chunk.impulses[k, felt].tolist(), strict=True
            )
        }
        place, (before, after) = int(chunk.struck[k].argmax()), states
        cause = self._cause(int(self.row[place]), int(row[place]), True)
        time = self.clock.high
        energy = self.energy(before, time), self.energy(after, time)
        self._jump(place, cause, row, before, after, impulses, energy)

    def _held(self, solved: Array) -> Array:
        """Return the unknowns (1, u) without forces where the mode at hand is open."""
        if self.forces is None:
            return solved
        found = solved.copy()
        for i in np.flatnonzero((self.row == FREE) | (self.row == OFF_CODE)).tolist():
            at = self.forces + 2 * i
            found[0, at : at + 2] = 0.0
        return found

    def _arc(self, times: Array, coefficients: Array, solved: Array) -> None:
        self._open.append((times, coefficients, solved))
        self.clock = self.clock.later(float(times[-1])).short
        self._size += coefficients.nbytes
        if self._size > _LONGEST:
            self.close()

    def close(self) -> None:
        """End the arc at hand."""
        if self._tail is not None:
            self._append_tail(self._tail)
        if not self._open:
            return
        pieces, self._open, self._size = self._open, [], 0
        times, coefficients, solved = pieces[0]
        if len(pieces) > 1:
            ends, reached = [times], float(times[-1])
            for further, _, _ in pieces[1:]:
                ends.append(reached + further[1:])
                reached = float(ends[-1][-1])
            times = np.concatenate(ends)
            coefficients = np.concatenate([piece[1] for piece in pieces])
            solved = np.concatenate([piece[2] for piece in pieces])
        roles = roles_in(self.key)
        self.arcs.append(
            Arc(self.key, roles, self._began, self.count, times, coefficients, defined(solved))
        )
        self._began = self.clock

    def _jumps(self, row: Ints, state: Array) -> None:
        """Append a jump for every region that changes."""
        changed = np.flatnonzero(row != self.row).tolist()
        if not self.modes and changed:
            self.close()
            self.row, self.count = row, self.count + len(changed)
            return
        for i in changed:
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
        self._note(
            Jump(
                self.clock.high,
                self.count,
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

    def _note(self, jump: Jump) -> None:
        self.jumps.append(jump)
        self.count += 1

    def _cause(self, before: int, after: int, struck: bool) -> str:
        found = cause_of(STATES[before], STATES[after])
        lasting = found in ("liftoff", "stick", "slip", "reverse")
        return self.again if struck and lasting else found
