"""From time steps to a trace: modes of regions, arcs and jumps.

Impacts are at mid-step, or delayed as their step says; those of several times are jumps in their
order. A mode without impact begins with its step; sticking begins with the step after the end of
slip. A step with an impulse has no force, nor have the steps that still correct the landing: the
recorded force is that of the nearest other step of the mode.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from contacts.states import (
    FREE,
    OFF_CODE,
    OPEN,
    OPEN_CODE,
    RESTS,
    SLIDE,
    SLIPS,
    STATES,
    cause_of,
    undetermined_warning,
)
from contacts.time_stepping.chatter import Chatter
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.lazy_arcs import ArcMaker, LazyArc, LazyJump, StepRange, Steps, cut
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.clock import Clock
from statechart.automaton.lazy import LazySequence
from statechart.automaton.trace import Arc, Jump, Key
from statechart.automaton.trace_store import Blocks

_OPEN = [code for code, state in STATES.items() if state in OPEN]
_SLIDES = (SLIDE, *SLIPS)  # Bodies slide without a direction.
# Largest arc, bytes; a longer one is split.
_LONGEST = 2**23


@dataclass(eq=False)
class Recorder:
    """Collects steps as arcs and jumps, which are computed on access.

    Regions have initial modes (r,); `controls` are states of the controllers, which `turn` changes.
    `sticks` (r,): regions with pin and slide, and couplings. `gated`: see `Chatter`. An impact
    on a region that is not free has the cause `again`. `joint_forces` (f,) are names. `forces`
    (r, 2): places of V and H among the further unknowns, or twice that of a torque; None: no
    forces. Controller variables follow the `coordinates` and their rates. `slips` and `slip_errors`
    are those of `SteppedSystem`; up to `still` they count as rest. Without `modes`, jumps of
    regions are only counted, and arcs end where they would; without `motion`, too, only the last
    two arcs of each chunk are kept. `control_jumps` are those of controllers and the stop.
    """

    regions: Sequence[str]
    start: Ints
    controls: Key
    sticks: Bools
    gated: Bools
    again: str
    joint_forces: Sequence[str]
    forces: Ints | None
    energy: Callable[[Array, Array], Array]
    coordinates: int
    slips: Callable[[Array, float], Array]
    slip_errors: Callable[[Array, tuple[float, float], Ints], Array]
    still: float
    modes: bool = True
    motion: bool = True
    clock: Clock = field(default_factory=Clock)
    control_jumps: list[Jump] = field(default_factory=list)
    count: int = 0
    indeterminate: dict[Key, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._keys: dict[bytes, Key] = {}
        self.row, self._sticking = self.start, bool(self.sticks.any())
        self._raw = self.start
        self._last: Chunk | None = None  # The last step; None after a jump of coordinates or rates.
        self.chatter = Chatter(self.regions, self.gated, self.start)
        self.key = self._key(self.start)
        self.start_key = self.key
        self._began = self.clock
        self._open: list[StepRange] = []
        self._size = 0
        self._maker = ArcMaker(self.regions, self.energy, self.joint_forces)
        self._arcs: list[LazyArc | Arc] = []
        self._jumps: list[LazyJump | Jump] = []
        self.arcs, self.jumps = self.sequences(kept=False)

    def sequences(self, *, kept: bool) -> tuple[LazySequence[Arc], LazySequence[Jump]]:
        """Return all arcs and jumps, also future ones; `kept`: cached after the first access."""
        arcs, jumps, maker = self._arcs, self._jumps, self._maker
        return (
            LazySequence(lambda i: maker.arc(arcs[i]), lambda: len(arcs), cached=kept),
            LazySequence(lambda i: maker.jump(jumps[i]), lambda: len(jumps), cached=kept),
        )

    def add(self, chunk: Chunk) -> None:
        """Append steps."""
        shown = self.recorded_modes(chunk)
        self.chatter.add(shown, self.clock.high, chunk.h)
        hit: Bools = np.any(chunk.struck, axis=1)
        steps, was = Steps.of(chunk, self.coordinates, self.clock), self._before(shown)
        if self.forces is not None:
            steps = steps.without_forces(shown, chunk.region_delay, was, self.forces)
        early, begun = self._begin_modes(chunk, shown)
        changes = self._changed(shown) | hit
        precedes = np.any((early != was) | (begun != early), axis=1) & changes
        first, done, shared = 0, 0, self.modes and bool(chunk.shared.any())
        jumps, impacts = np.flatnonzero(changes).tolist(), np.diff(steps.places) - 1
        if not (self.modes or self.motion) and len(jumps) > 2:
            # Count the jumps before the last two arcs.
            k, jumps = jumps[-3], jumps[-2:]
            changed = impacts + (begun != early).sum(axis=1) + (early != was).sum(axis=1)
            self.count += int(changed[: k + 1].sum())
            self.row, self.key, done = shown[k], self._key(shown[k]), int(steps.places[k + 1]) - 1
            self.clock = self._began = steps.at(k, int(impacts[k]))
            self._open, self._size = [], 0
        for k in jumps:
            if shared:
                self._note_shared(chunk.shared[first:k])
            first = k + int(hit[k])
            if precedes[k]:
                done = self._flow(steps, done, k, 0)
                self._change(early[k], chunk.states[k])
                self._change(begun[k], chunk.states[k])
            for part in range(1, int(impacts[k]) + 1):
                done = self._flow(steps, done, k, part)
                self._strike(steps, k, part, chunk.region_delay[k], shown[k])
        if shared:
            self._note_shared(chunk.shared[first:])
        self._flow(steps, done, len(shown), 0)
        self._raw, self._last = chunk.modes[-1], chunk.after(len(shown) - 1)
        if self._size > _LONGEST:
            self.close()

    def changes(self, chunk: Chunk) -> tuple[Bools, Bools]:
        """Return the regions (k, r) that jump at the begins of steps, and steps with impacts."""
        shown = self.recorded_modes(chunk)
        was, (early, begun) = self._before(shown), self._begin_modes(chunk, shown)
        return (was != early) | (early != begun), np.any(chunk.struck, axis=1)

    def _begin_modes(self, chunk: Chunk, shown: Ints) -> tuple[Ints, Ints]:
        """Return the modes (k, r) at the begins of steps, in their order.

        A disabled contact that closes at once is free first, as with events. A slip that has
        stopped in the step before, and a coupling that opens or closes, precede an impact; the slip
        of a body precedes its own impacts only. Impacts elsewhere do not delay the mode of a
        region.
        """
        hit: Bools = np.any(chunk.struck, axis=1)[:, None]
        was, last = self._before(shown), np.vstack([self._raw, chunk.modes[:-1]])
        enabled = (was == OFF_CODE) & (shown != OFF_CODE) & (chunk.struck | (shown != FREE))
        stopped = (chunk.struck | (hit & self.sticks)) & _stops(was, last)
        turned = hit & ((was == OPEN_CODE) != (shown == OPEN_CODE))
        early = np.where(enabled, FREE, np.where(shown == OFF_CODE, OFF_CODE, was))
        early = np.where(turned, shown, np.where(stopped, last, early))
        struck = hit & (chunk.region_delay > -0.5 * chunk.h)
        return early, np.where(struck, early, shown)

    def take_finished(self, *, ended: bool) -> tuple[Sequence[Arc], Sequence[Jump]]:
        """Remove finished arcs and jumps; return them if outputs ask for the motion.

        Otherwise return the last arc if the run has `ended`, else nothing.
        """
        finished: tuple[Sequence[Arc], Sequence[Jump]] = (), ()
        if self.motion:
            finished = tuple(self.arcs), tuple(self.jumps)
        elif ended and self._arcs:
            finished = (self._maker.arc(self._arcs[-1]),), ()
        self._arcs.clear()
        self._jumps.clear()
        return finished

    def since(self, count: int) -> Sequence[Jump]:
        """Return the jumps after the first `count`."""
        return self.jumps[len(self.jumps) - (self.count - count) :] if self.modes else ()

    def turn(
        self,
        region: str,
        cause: str,
        controls: Key,
        states: tuple[Array, Array],
        fired: tuple[str, ...],
        moved: Mapping[int, int],
        *,
        impulse: Mapping[str, tuple[float, float]],
        joint_impulse: Mapping[str, float],
    ) -> Jump:
        """Append and return a jump of a controller from one state to another.

        Afterwards the regions `moved` have these modes; the impulses are those of the `Jump`.
        """
        self.close()
        before, after = states
        if np.any((before != after)[: 2 * self.coordinates]):
            self._last = None
        source, was, self.controls = self.key, self.controls, controls
        self.move(moved)
        jump = Jump(
            self.clock.high, self.count, region, cause, source, self.key, *states, fired,
            impulse=impulse, joint_impulse=joint_impulse,
        )  # fmt: skip
        self._note(jump)
        self.control_jumps.append(
            replace(jump, j=len(self.control_jumps), source=was, target=controls)
        )
        return jump

    def move(self, moved: Mapping[int, int]) -> None:
        """Set modes of regions without a jump."""
        self.row, self._raw = self.row.copy(), self._raw.copy()
        for i, code in moved.items():
            self.row[i] = self._raw[i] = code
        self.key = (*self._key(self.row)[: len(self.row)], *self.controls)

    def closing_impulse(self, before: Chunk, after: Chunk) -> dict[str, float]:
        """Return the impulses of joints in a step `after` a joint closes, beyond those `before`.

        Those of a step with impacts belong to them.
        """
        if after.struck.any():
            return {}
        gained = (after.joint_impulses[0] - before.joint_impulses[0]).tolist()
        return {name: size for name, size in zip(self.joint_forces, gained, strict=True) if size}

    def rewind(self, last: Arc, *, later: int) -> Array:
        """Go back to the end of a part of an arc, the last but `later`; return the state."""
        del self._arcs[len(self._arcs) - later :]
        if self.modes:
            del self._jumps[len(self._jumps) - (self.count - last.j) :]
        self._arcs[-1] = last
        self.key, self.clock, self.count = last.mode, last.end, last.j
        state: Array = last.coefficients[-1].sum(axis=1)
        return state

    def slips_end(self, chunk: Chunk) -> Bools:
        """Return the regions (k, r) whose recorded slip ends with a step, if they then stick."""
        shown = self.recorded_modes(chunk)
        return _stops(shown, chunk.modes)

    def begin(self, step: Chunk, which: Bools) -> bool:
        """Append jumps of regions (r,) at the begin of the next step; return if there are any."""
        before = self.count
        for modes in self._begin_modes(step, self.recorded_modes(step)):
            self._change(np.where(which, modes[0], self.row), step.states[0])
        return self.count > before

    def stop(self, name: str, state: Array) -> None:
        """Append the jump of a stop condition."""
        self.close()
        key, controls = self.key, self.controls
        stopped = Jump(self.clock.high, self.count, "", "stop", key, key, state, state, (name,))
        self._note(stopped)
        self.control_jumps.append(
            replace(stopped, j=len(self.control_jumps), source=controls, target=controls)
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of undetermined forces, once each, and of chatter."""
        undetermined = dict.fromkeys(map(undetermined_warning, self.indeterminate.values()))
        return *undetermined, *self.chatter.remarks

    def _key(self, row: Ints) -> Key:
        states = self._keys.get(row.tobytes())
        if states is None:
            states = self._keys[row.tobytes()] = tuple(map(STATES.__getitem__, row.tolist()))
        return (*states, *self.controls) if self.controls else states

    def recorded_modes(self, chunk: Chunk) -> Ints:
        """Return the recorded modes: a slip lasts to the end of the step in which it stops.

        One that turns round, and rests at the end of one step, does not stick. An impact that stops
        a slip ends it at once. A region that closes without an impact slips in that step, unless it
        lands with a slip of first order in the step: it rests from its landing on.
        """
        codes = chunk.modes
        before = np.vstack([self._raw, codes[:-1]])
        stops = _stops(before, codes)
        in_impact = chunk.struck[stops] | chunk.impulses[stops].any(axis=1)
        shown = codes.copy()
        shown[stops] = np.where(in_impact, codes[stops], before[stops])
        if not self._sticking:
            return shown
        rests = np.isin(codes, [*RESTS])
        closes = (rests | np.isin(codes, SLIPS)) & np.isin(before, _OPEN)
        closes &= self.sticks & ~(chunk.struck | chunk.impulses.any(axis=2))
        settling = np.isin(self.row, [*RESTS]) & np.isin(self._raw, SLIPS)
        resting = [(0, i) for i in np.flatnonzero(settling).tolist()]
        for k in np.flatnonzero(closes.any(axis=1)).tolist():
            time = self.clock.high + k * chunk.h
            slips = self.slips(chunk.states[k], time)
            errors, last = np.zeros_like(slips), chunk.first(k).after(k - 1) if k else self._last
            if last is not None and not last.struck.any():
                errors = self.slip_errors(last.states, (time - last.h, time), before[k])
            level, moves = np.abs(slips) < errors, np.abs(slips) > self.still
            resting += [(k, i) for i in np.flatnonzero(closes[k] & level).tolist()]
            for i in np.flatnonzero(closes[k] & rests[k] & moves & ~level).tolist():
                forward, backward = RESTS[int(codes[k, i])]
                shown[k, i] = forward if slips[i] > 0.0 else backward
        for first, i in resting:
            for k in range(first, len(codes)):
                times = self.clock.high + chunk.h * np.arange(k, k + 2)
                began, slip = (s[i] for s in map(self.slips, chunk.states[k : k + 2], times))
                slows = 0.0 <= slip * began <= began * began
                if not (rests[k, i] or (codes[k, i] in SLIPS and slows)):
                    break
                shown[k, i] = next(rest for rest in RESTS if codes[k, i] in (rest, *RESTS[rest]))
                if rests[k, i]:
                    break
        return shown

    def _before(self, shown: Ints) -> Ints:
        return np.vstack([self.row, shown[:-1]])

    def _changed(self, shown: Ints) -> Bools:
        """Return the steps (k,) in which a region changes its mode."""
        changed: Bools = np.any(shown != self._before(shown), axis=1)
        return changed

    def _note_shared(self, shared: Bools) -> None:
        if shared.any():
            names = {self.regions[i] for i in np.flatnonzero(shared.any(axis=0)).tolist()}
            names.update(self.indeterminate.get(self.key, ()))
            self.indeterminate[self.key] = tuple(n for n in self.regions if n in names)

    def _flow(self, steps: Steps, first: int, step: int, part: int) -> int:
        """Append pieces up to a part of a step; return the next piece."""
        last = int(steps.places[step]) + part
        if last > first:
            self._open.append(StepRange(steps, first, last))
            self.clock = steps.at(step, part)
            self._size += (last - first) * steps.width
        return last

    def _strike(self, steps: Steps, k: int, part: int, delays: Array, after: Ints) -> None:
        """Append the jump of the impacts at the begin of a part of a step."""
        self.close()
        times, now = 0.5 * steps.h + delays, steps.begins[steps.places[k] + part]
        row = np.where(times <= now, after, self.row)
        if not self.modes:
            self.row, self.count, self.key = row, self.count + 1, self._key(row)
            return
        place = int((steps.struck[k] & (times == now)).argmax())
        cause = self._cause(int(self.row[place]), int(row[place]), True)
        source, self.row, self.key = self.key, row, self._key(row)
        region = self.regions[place]
        self._note(
            LazyJump(steps, k, part, self.clock.high, self.count, region, cause, source, self.key)
        )

    def close(self) -> None:
        """Finish the current arc."""
        if not self._open:
            return
        self._arcs.append(LazyArc(self.key, self._began, self.count, tuple(self._open)))
        self._open, self._size, self._began = [], 0, self.clock

    def _change(self, row: Ints, state: Array) -> None:
        """Append a jump for every region that changes."""
        changed = np.flatnonzero(row != self.row).tolist()
        if not self.modes and changed:
            self.close()
            self.row, self.count, self.key = row, self.count + len(changed), self._key(row)
            return
        for i in changed:
            self.close()
            following = self.row.copy()
            following[i] = row[i]
            cause = self._cause(int(self.row[i]), int(row[i]), False)
            source, self.row, self.key = self.key, following, self._key(following)
            self._note(
                Jump(
                    self.clock.high, self.count, self.regions[i], cause, source, self.key,
                    state, state,
                )
            )  # fmt: skip

    def _note(self, jump: LazyJump | Jump) -> None:
        self._jumps.append(jump)
        self.count += 1

    def _cause(self, before: int, after: int, struck: bool) -> str:
        cause = cause_of(STATES[before], STATES[after])
        is_lasting = cause in ("liftoff", "stick", "slip", "reverse")
        return self.again if struck and is_lasting else cause


def _stops(before: Ints, after: Ints) -> Bools:
    """Return the regions (k, r) that slip in the modes `before` and rest in those `after`."""
    stops, changed = np.zeros(before.shape, np.bool_), np.nonzero(before != after)
    stops[changed] = np.isin(before[changed], _SLIDES) & np.isin(after[changed], [*RESTS])
    return stops


class PoseRecorder:
    """Collects chunks of steps; each is an arc."""

    def __init__(self, coordinates: int) -> None:
        self._coordinates = coordinates
        self._blocks = Blocks[Steps]()
        # Number of jumps before each chunk, and controller states.
        self._shown: list[tuple[int, Key]] = []

    def add(self, chunk: Chunk, start: Clock, j: int, key: Key) -> None:
        """Append steps from `start` on, after `j` jumps, in these controller states."""
        self._shown.append((j, key))
        steps = Steps.of(chunk, self._coordinates, start)
        self._blocks.add(steps.without_impulses())

    def arcs(self, end: float) -> LazySequence[Arc]:
        """Return the arcs of a run that ended at `end`."""
        blocks, shown, maker = self._blocks, self._shown, ArcMaker()

        def arc(place: int) -> Arc:
            steps, (j, key) = blocks[place], shown[place]
            all_steps = StepRange(steps, 0, int(steps.places[-1]))
            whole = maker.arc(LazyArc(key, steps.begin, j, (all_steps,)))
            last = (end - whole.start.high) - whole.start.low
            if place < len(blocks) - 1 or not last < whole.times[-1]:
                return whole
            step = int(np.searchsorted(whole.times, last, side="right")) - 1
            return cut(whole, max(step, 0), last)

        return LazySequence(arc, lambda: len(blocks), cached=False)
