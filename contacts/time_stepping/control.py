"""Controllers of a time-stepped scene, evaluated at the ends of steps.

A transition on an impact fires at the end of its step, on another event at the begin of the step
that has it, one with a guard as `guard_truths` says. Steps are taken in chunks under the present
states; those beyond a transition are reverted.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import sliding_edge
from contacts.dynamics.controllers import Controllers
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.projection import on_constraints
from contacts.dynamics.rolling_resistance import apply_rolling_resistance, couples
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot, SnapshotTape
from contacts.dynamics.starting import check_closing
from contacts.solvers.lemke import delassus_matrix, forces_by_lemke
from contacts.states import CLOSED, OPEN, RESTS, STATES
from contacts.time_stepping.chunk import Chunk, SteppedSystem
from contacts.time_stepping.guard_truths import (
    AT_END,
    ActiveStates,
    StepEnd,
    StepTruths,
    reversed_warning,
)
from contacts.time_stepping.recorder import Recorder
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.clock import Clock
from statechart.automaton.regions import Raised, Region
from statechart.automaton.trace import Arc, Jump, Key
from statechart.charts.guard_watch import EventQueues, Firing
from statechart.errors import EventLoop, UnsolvedImpulses

_MAX_LISTED = 4  # Transitions listed in the error of an endless sequence.
_MOST_TURNS = 100
# Newton iterations onto a joint that closes up to a step late: 1e-3, 1e-7, 1e-15 of the scene.
_PROJECTIONS = 3


class ClosingImpact(NamedTuple):
    """The plastic impact in which a joint closes."""

    state: Array
    modes: dict[int, int]  # Regions that it strikes -> their modes.
    impulse: dict[str, tuple[float, float]]
    joint_impulse: dict[str, float]


class StepControl:
    """The controllers of one run, whose regions are the last of all `regions`."""

    def __init__(
        self,
        mechanics: Mechanics,
        controllers: Controllers,
        setup: SceneSetup,
        scene: SteppedSystem,
        regions: Sequence[Region],
        states: Key,
    ) -> None:
        self._states, self._setup, self._scene = controllers, setup, scene
        self._mechanics = mechanics
        self._queues = EventQueues(regions, controllers.flat)
        edges = chain.from_iterable(one.edges for one in regions[: len(regions) - len(states)])
        events = {event for edge in edges for event in (edge.cause, edge.target)}
        self._listens = any(flat.awaited & events for flat in controllers.flat.values())
        self._active = ActiveStates(regions)
        self.states = states
        self._begun = False
        # Whether events at the begin of the next step are awaited; where they were last.
        self.early, self._early_at = False, 0.0
        self._truths = self._new_truths()
        # Guards that became true in the last step, by region and trigger.
        self._became_true = set[tuple[int, int]]()
        # A moved surface strikes in the next step, before any other event.
        self.strikes, self._pending = False, dict[str, tuple[Raised, ...]]()
        self._tapes = dict[Key, SnapshotTape]()
        # Contacts with restitution -> their places.
        self._bouncing = {
            law.name: i for i, law in enumerate(setup.contacts) if law.restitution > 0.0
        }
        # Transition -> warning of events that steps leave out or add, or of a guard that is true
        # within a step only.
        self._left_out = dict[str, str]()
        self._closed_at = dict[str, float]()  # Time at which these contacts closed last.
        self._rigid = {law.name for law in setup.contacts if not law.coupling}
        self._couplings = {law.name: i for i, law in enumerate(setup.contacts) if law.coupling}

    def cut(self, chunk: Chunk, start: float, recorder: Recorder) -> tuple[Chunk, bool]:
        """Return the steps until a controller may act, and whether one may.

        Events at the begin of a step are those of the end before, once an instant.
        """
        if not len(chunk.codes):
            return chunk, False
        shown = recorder.recorded_modes(chunk)
        due, begins = self._truths.take(chunk, start, np.vstack([recorder.row, shown]))
        may_act: Bools = np.any(due | begins, axis=1)
        early = np.zeros_like(may_act)
        if sources := self._queues.sources(self.states):
            changed, hit = recorder.changes(chunk)
            heard = [None in sources or name in sources for name in recorder.regions]
            begins_with: Bools = np.any(changed[:, heard], axis=1)
            may_act |= hit
            early[:-1] = begins_with[1:]
            if begins_with[0] and not self.strikes and abs(start - self._early_at) > 0.5 * chunk.h:
                self._scene.forget()
                self.early, self._early_at = True, start
                return chunk.first(0), True
            may_act[0] |= begins_with[0]
        may_act[:1] |= self.strikes
        acts = bool((may_act | early).any())
        end = int(np.argmax(may_act | early)) if acts else len(may_act) - 1
        self.early = bool(early[end] and not may_act[end])
        if self.early:
            self._early_at = start + (end + 1) * chunk.h
        # Guards that became true at the instant of a moved surface wait for its impact.
        waiting = self._became_true if self.strikes else set[tuple[int, int]]()
        self._became_true = waiting | self._chosen(begins[end])
        if end == len(may_act) - 1:
            return chunk, acts
        self._scene.forget()
        return self._scene.steps(start, chunk.h, chunk.states[0], 1 + end), True

    def acts_by(self, time: float, last: Arc, jumps: Sequence[Jump], end: StepEnd) -> bool:
        """Return whether a controller acts by the end of an arc, not only at the end of the step.

        The step has these jumps.
        """
        at, solved = np.array([last.duration]), last.solved
        assert solved is not None
        true = self._truths.true_at(time, last.states(at)[0], solved[-1], end.h, end.codes)
        latest = time + AT_END * end.h
        return bool(
            self._pending
            or self._chosen(true)
            or any(jump.t <= latest and self._waiting(jump, end) for jump in jumps)
        )

    def turn(self, recorder: Recorder, jumps: Sequence[Jump], end: StepEnd) -> StepEnd:
        """Take the transitions due at the end of a step with these jumps; return it after them.

        Raises `EventLoop` if they do not end.
        """
        pending, self._pending, self.strikes = self._pending, {}, False
        struck = {name for jump in jumps for name in jump.impulse} & self._rigid
        self._warn_of_sticking(jumps, end)
        for first, *others in _simultaneous(jumps):
            # Simultaneous jumps of several contacts are one event, as in event-driven runs.
            jump = replace(first, target=others[-1].target) if others else first
            pending = self._queues.pending_after(pending, jump)
        failed, held, between = set[tuple[int, int]](), None, list[Ints]()
        if not self._begun:
            self._begun = True
            # No guard was true before the start.
            failed = {(g.place, g.trigger) for g in self._states.guards(self.states).watch.guards}
            end.state = self._states.enter_initial_states(
                self._setup, recorder.clock, end.state, self.states
            )
        for _ in range(_MOST_TURNS):
            due, truths = self._truths.at(end, relay=True)
            hold = self._chosen(truths)
            # The transition of another region may have turned some true.
            self._became_true |= hold & failed
            true = self._chosen(due) | (hold & self._became_true)
            held = hold & self._became_true if held is None else held
            firing = self._queues.first(
                self.states,
                pending,
                self._states.opening_first(true, self.states),
                partial(self._holding, end),
            )
            if firing is None:
                self._warn_of_left_out(jumps, end)
                self._warn_between(between, recorder, end)
                self._warn_of_reversed((held & self._became_true) - hold, end)
                return end
            failed = {one for one in self._chosen(~truths) if one[0] != firing.place}
            if self._listens and end.after_transitions and end.next_step is not None:
                between.append(end.next_step.modes[0])
            jump, end = self._take(firing, recorder, end, struck)
            pending = self._queues.pending_after(firing.pending, jump)
            if self.strikes:
                self._pending = pending
                self._truths.at(end)
                return end
        listed = (
            f"{jump.cause} -> {' '.join(jump.target)}"
            for jump in recorder.control_jumps[-_MAX_LISTED:]
        )
        raise EventLoop(
            f"more than {_MOST_TURNS} transitions of controllers at one instant: "
            f"{', '.join(listed)}"
        )

    def _take(
        self, firing: Firing, recorder: Recorder, end: StepEnd, struck: Collection[str]
    ) -> tuple[Jump, StepEnd]:
        """Take a transition; return its jump, and the instant after it."""
        watch, place, taken = self._states.guards(self.states).watch, firing.place, firing.taken
        name, source, state = self._states.names[place], self.states[place], end.state
        fired = tuple(g.name for g in watch.guards if (g.place, g.trigger) in firing.due)
        self._became_true = {one for one in self._became_true if one[0] != place}
        self.states = (*self.states[:place], taken.target, *self.states[place + 1 :])
        self._truths = self._new_truths(self._truths)
        after = self._states.updated(self._setup, recorder.clock, taken.name, taken.blocks, state)
        closing = ClosingImpact(after, {}, {}, {})
        if name in self._states.joints and taken.target == CLOSED:
            closing = self._closed(name, after, recorder, end.h, struck)
            after = closing.state
        # Joints of shapes close in the next step.
        closes = name in self._mechanics.scene.joints and taken.target == CLOSED
        next_step = end.next_step if closes and name not in self._states.joints else None
        switched, self.strikes = self._scene.switch(
            self._states.named(self.states), (state, after, recorder.clock.high)
        )
        moved = closing.modes | switched
        then = end.after(after)
        joint_impulse = closing.joint_impulse
        if next_step is not None and then.next_step is not None:
            joint_impulse = recorder.closing_impulse(next_step, then.next_step)
        if resting := [i for i, code in closing.modes.items() if code in RESTS]:
            # Forces decide the mode of a contact that the impact leaves without slip.
            codes = (recorder.row if then.next_step is None else then.next_step.modes[0]).tolist()
            moved |= {i: codes[i] for i in resting if STATES[codes[i]] not in OPEN}
        jump = recorder.turn(
            name, taken.name, self.states, (state, after), fired, moved,
            impulse=closing.impulse, joint_impulse=joint_impulse,
        )  # fmt: skip
        then.codes = recorder.row
        if watch.of_state.isdisjoint(fired):
            recorder.chatter.forget(name)
        else:
            recorder.chatter.change(name, source, taken.target, recorder.clock.high)
        return jump, then

    def _warn_of_reversed(self, guards: Collection[tuple[int, int]], end: StepEnd) -> None:
        """Warn of guards that became true in the last step, and that transitions made false."""
        for guard in self._states.guards(self.states).watch.guards:
            if (guard.place, guard.trigger) in guards:
                self._left_out.setdefault(guard.name, reversed_warning(guard.name, end.time, end.h))

    def _warn_of_left_out(self, jumps: Sequence[Jump], end: StepEnd) -> None:
        """Warn if transitions wait for events of these jumps that steps leave out."""
        for jump in jumps:
            impulses = jump.impulse
            if jump.cause == "touchdown" and not (impulses or jump.region in self._mechanics.pads):
                # A slow contact closes without an impact, one with restitution in its last bounce.
                impulses = {jump.region: (1.0, 0.0)}
                if jump.region in self._bouncing:
                    self._warn_of(
                        jump,
                        f"{jump.region}: from t = {jump.t:.6g} on bounces are shorter than a step "
                        f"of {end.h:g} and are left out, but {{}} waits for one; use a shorter "
                        "step",
                        end,
                    )
            for name, place in self._couplings.items() if impulses else ():
                if not jump.source[place] == jump.target[place] == "locked":
                    continue
                why = (
                    f"{name}: the impact at t = {jump.t:.6g} may make it slip for less "
                    f"than a step of {end.h:g}, and {{}} waits for that; use a shorter step"
                )
                for cause in ("slip", "lock"):
                    event = _event(jump, name, cause)
                    if self._waiting(event, end) and self._strikes(jump, impulses, place):
                        self._warn_of(event, why, end)

    def _warn_between(self, between: Sequence[Ints], recorder: Recorder, end: StepEnd) -> None:
        """Warn of contact events between transitions of an instant, which had these modes (r,)."""
        for modes in between:
            for i in np.flatnonzero(modes != end.codes).tolist():
                if end.next_step is None or end.next_step.modes[0, i] == modes[i]:
                    continue  # The event is in the next step.
                state, key = STATES[int(modes[i])], recorder.key
                there = (*key[:i], state, *key[i + 1 :])
                for before, after in ((key, there), (there, key)):
                    self._warn_of(
                        Jump(end.time, 0, "", "", before, after, end.state, end.state),
                        f"{recorder.regions[i]} is {state} between transitions at t = "
                        f"{end.time:.6g}, which steps leave out, but {{}} waits for that; let "
                        "the second transition come a step later",
                        end,
                    )

    def due_at_start(self, end: StepEnd) -> set[tuple[int, int]]:
        """Return the guards due at the start, by region and trigger."""
        end.state = self._states.enter_initial_states(self._setup, Clock(), end.state, self.states)
        return self._chosen(self._truths.at(end)[0])

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of events that controllers wait for and steps leave out, or add."""
        return tuple((self._truths.passed | self._left_out).values())

    def _warn_of(self, jump: Jump, why: str, end: StepEnd) -> None:
        """Warn if a transition waits for the event of a jump; `why` has a place for its name."""
        if name := self._waiting(jump, end):
            self._left_out.setdefault(name, why.format(name))

    def _waiting(self, jump: Jump, end: StepEnd) -> str:
        """Return the name of the transition that waits for the event of a jump, if any."""
        pending, holding = self._queues.pending_after({}, jump), partial(self._holding, end)
        firing = self._queues.first(self.states, pending, (), holding)
        return "" if firing is None else f"{self._states.names[firing.place]}.{firing.taken.name}"

    def _strikes(self, jump: Jump, by: Mapping[str, tuple[float, float]], place: int) -> bool:
        """Return whether impulses of contacts at a jump alone would make a coupling slip."""
        laws, first = self._setup.contacts, len(jump.source) - len(self.states)
        snapshot = self._snapshots(jump.source[first:]).at(self._setup.values, jump.before, jump.t)
        impulses = np.array([by.get(law.name, (0.0, 0.0)) for law in laws])
        change = snapshot.jacobians[place, 1] @ _velocity_change(snapshot, impulses)
        return bool(abs(change) > self._setup.slip_tolerance)

    def _snapshots(self, states: Key) -> SnapshotTape:
        """Return the snapshots in states of the controllers."""
        if states not in self._tapes:
            self._tapes[states] = SnapshotTape(self._mechanics, self._states.named(states))
        return self._tapes[states]

    def _warn_of_sticking(self, jumps: Sequence[Jump], end: StepEnd) -> None:
        """Warn if a transition takes the end of a slip for which steps between bounces stand."""
        for jump in jumps:
            for name, i in self._bouncing.items():
                if jump.source[i] in OPEN and jump.target[i] not in OPEN:
                    self._closed_at[name] = jump.t
            name = jump.region
            if jump.cause != "stick" or name not in self._closed_at:
                continue
            law = self._setup.contacts[self._bouncing[name]]
            if jump.t - self._closed_at[name] <= _bounces_end(law.restitution) * end.h:
                self._warn_of(
                    _event(jump, name, "stick"),
                    f"{name} sticks at t = {jump.t:.6g}, just after bounces that are shorter than "
                    f"a step of {end.h:g}: at their end it may be pinned at once, without the "
                    f"event that {{}} waits for; wait for {name}.pin",
                    end,
                )

    def _closed(
        self, joint: str, state: Array, recorder: Recorder, h: float, struck: Collection[str]
    ) -> ClosingImpact:
        """Close a joint, with a plastic impact of the touching contacts.

        Contacts that were `struck` in this step touch, although they may rebound.

        Raises `NoConsistentMode` if its points are farther apart than a step moves them, and
        `UnsolvedImpulses` if no impulses stop the contacts.
        """
        setup, time, before = self._setup, recorder.clock.high, state
        tape, contacts = self._snapshots(self.states), setup.contacts
        held, impulses = dict[int, int](), np.zeros((len(contacts), 2))
        snapshot = tape.at(setup.values, state, time)
        check_closing(self._mechanics, snapshot, joint, setup.tolerances["gap"], 2.0 * h)
        for _ in range(_PROJECTIONS):
            state = on_constraints(("free",) * len(contacts), snapshot, state)
            snapshot = tape.at(setup.values, state, time)
        touching = [
            i
            for i, code in enumerate(recorder.row[: len(contacts)].tolist())
            if contacts[i].name in self._rigid
            and (STATES[code] not in OPEN or contacts[i].name in struck)
        ]
        if touching and len(snapshot.velocity):
            # As with events, a contact that can slip under kinetic friction does.
            edges = np.array([sliding_edge(contacts[i], snapshot.contacts[i]) for i in touching])
            jacobians = snapshot.jacobians[touching]
            matrix, _ = delassus_matrix(snapshot.mass, jacobians, snapshot.forces)
            least, nothing = jacobians @ snapshot.velocity, np.zeros(len(edges))
            solved, pushes = forces_by_lemke(matrix, least, edges, nothing)
            if not solved:
                raise UnsolvedImpulses(
                    f"no impulses stop the contacts of what joint {joint!r} closes on at "
                    f"t = {time:.6g}; close it away from contacts, or at another time"
                )
            impulses[touching] = pushes
            velocity = snapshot.velocity + _velocity_change(snapshot, impulses)
            velocity, impulses = apply_rolling_resistance(
                snapshot, contacts, velocity, impulses, setup.slip_tolerance
            )
            state, rates = snapshot.moved(state, velocity), jacobians @ velocity
            at_rest = np.isin(recorder.row[touching], [*RESTS])
            opened = np.array([STATES[code] in OPEN for code in recorder.row[touching].tolist()])
            leaves = rates[:, 0] > setup.tolerances["speed"]
            # Some slip, or stop, without an impulse of their own.
            changes_mode = ~at_rest | (np.abs(rates[:, 1]) > setup.slip_tolerance)
            changes_mode &= ~opened & ~leaves
            held = self._scene.hold(
                {
                    touching[k]: (snapshot.contacts[touching[k]].gap, float(rates[k, 1]))
                    for k in np.flatnonzero((impulses[touching, 0] > 0.0) | changes_mode).tolist()
                },
                [touching[k] for k in np.flatnonzero(~opened & leaves).tolist()],
            )
        pairs = zip(contacts, impulses.tolist(), strict=True)
        return ClosingImpact(
            state,
            held,
            {law.name: (V, H) for law, (V, H) in pairs if (V or H) and not law.coupling},
            tape.joint_impulse(snapshot, before, state, impulses) | couples(contacts, impulses),
        )

    def first_undefined(self, chunk: Chunk) -> tuple[int, str] | None:
        """Return the first step at whose end a guard has no value, and its name."""
        return self._truths.undefined(chunk)

    def accept(self, chunk: Chunk, start: float, end: float) -> None:
        """Continue after steps, the first of those of `cut`, until the run is at `end`."""
        self._left_out = self._truths.accept(chunk, start, end) | self._left_out

    def _new_truths(self, before: StepTruths | None = None) -> StepTruths:
        """Return the guards of the present states."""
        guards = self._states.guards(self.states)
        return StepTruths(self._mechanics, self._setup, self._active, guards, self.states, before)

    def _chosen(self, which: Bools) -> set[tuple[int, int]]:
        """Return some of the guards of the present states, by region and trigger."""
        guards = self._states.guards(self.states).watch.guards
        return {(g.place, g.trigger) for g, now in zip(guards, which, strict=True) if now}

    def _holding(self, end: StepEnd) -> set[tuple[int, int]]:
        """Return the event guards that hold at the end of a step."""
        guards = self._states.guards(self.states, at_events=True)
        rows = guards.atoms_at(self._setup, end.time, end.state)
        if np.isnan(rows[:, 0]).any():
            solved = end.settled[self._truths.order]
            rows = guards.atoms_at(self._setup, end.time, end.state, solved)
        active = self._active.at(end.codes[None], self.states)
        return guards.watch.holding(rows, self._setup.rounded, lambda *of: bool(active(*of)[0]))


def _velocity_change(snapshot: Snapshot, impulses: Array) -> Array:
    """Return the change of velocity (n,) by impulses (c, 2) of contacts."""
    push = np.einsum("ckn,ck->n", snapshot.jacobians, impulses)
    change: Array = np.linalg.lstsq(snapshot.mass, push)[0]
    return change


def _bounces_end(e: float) -> float:
    """Return the steps after a closing in which bounces with restitution e end that are left out.

    Steps close at approaches of up to 3 g h: bounces last 6 h (e + e^2 + ...), a step ends later.
    """
    return 2.0 + 6.0 * e / (1.0 - e) if e < 1.0 else math.inf


def _event(jump: Jump, region: str, cause: str) -> Jump:
    """Return a jump with this event alone, at the end of another one."""
    return replace(jump, region=region, cause=cause, source=jump.target, impulse={})


def _simultaneous(jumps: Sequence[Jump]) -> Iterator[Sequence[Jump]]:
    """Group jumps of one instant; a region that jumps again begins a new group."""
    group: list[Jump] = []
    for jump in jumps:
        if group and (jump.t != group[0].t or jump.region in {j.region for j in group}):
            yield group
            group = []
        group.append(jump)
    if group:
        yield group
