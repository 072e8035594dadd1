"""Stop conditions of a stepped run: tested at the ends of steps, located by bisection inside."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from contacts.dynamics.controllers import ControlGuards, Controllers
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.guard_truths import (
    ActiveStates,
    StepEnd,
    StepTruths,
    reversed_warning,
)
from contacts.time_stepping.lazy_arcs import cut
from contacts.time_stepping.recorder import Recorder
from statechart.arrays import Array
from statechart.automaton.regions import Region
from statechart.automaton.trace import Arc, Key
from statechart.charts.guard_watch import Guard
from statechart.formulas.relation import parse_relation


class StopGuards:
    """Stop conditions, watched as guards are."""

    def __init__(
        self, mechanics: Mechanics, controllers: Controllers, regions: Sequence[Region]
    ) -> None:
        texts = mechanics.scene.stop.conditions
        self.names, self.active, self.mechanics = tuple(texts), ActiveStates(regions), mechanics
        self._controllers, self._built = controllers, dict[Key, ControlGuards]()
        self._watched = [
            Guard(k, name, parse_relation(text), 0) for k, (name, text) in enumerate(texts.items())
        ]

    def within(self, states: Key) -> ControlGuards:
        """Return the conditions in states of the controllers."""
        if states not in self._built:
            named = self._controllers.named(states)
            self._built[states] = ControlGuards(self.mechanics, named, self._watched)
        return self._built[states]


# Bisections of a step.
_BISECTIONS = 60


class StopConditions:
    """The stop conditions of a run."""

    def __init__(self, guards: StopGuards, setup: SceneSetup, states: Key) -> None:
        self._guards = guards
        self._truths = StepTruths(
            guards.mechanics, setup, guards.active, guards.within(states), states
        )
        # Conditions (k, s) at the ends of the last steps: those that fire, and those that do so
        # although they are about to become false.
        self._met = np.zeros((1, len(guards.names)), np.bool_)
        self._passing = ~self._met
        # Condition -> warning that it is true for less than a step.
        self._spans = dict[str, str]()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of conditions that steps pass over."""
        return tuple((self._truths.passed | self._spans).values())

    def change(self, setup: SceneSetup, time: float, state: Array, h: float) -> None:
        """Continue with other values of parameters."""
        if self._guards.names:
            self._truths.change(setup, time, state, h)

    def after_jumps(self, recorder: Recorder, end: StepEnd) -> int | None:
        """Return the condition that is met at the start, or after jumps at the end of a step.

        That step is the last accepted one.
        """
        if not self._guards.names:
            return None
        self._truths.enter(self._guards.within(recorder.controls), recorder.controls)
        due, true = self._truths.at(end)
        met = due | (true & self._passing[-1])
        for k in np.flatnonzero(self._met[-1] & ~met).tolist():
            name = self._guards.names[k]
            self._spans.setdefault(name, reversed_warning(name, end.time, end.h))
        return int(np.argmax(met)) if met.any() else None

    def take(self, chunk: Chunk, start: float, recorder: Recorder) -> None:
        """Evaluate the conditions in steps."""
        if not self._guards.names:
            return
        self._truths.enter(self._guards.within(recorder.controls), recorder.controls)
        codes = np.vstack([recorder.row, recorder.recorded_modes(chunk)])
        due, begins = self._truths.take(chunk, start, codes)
        self._met, self._passing = due | begins, begins & ~due

    def first_met(self, chunk: Chunk) -> tuple[int, int] | None:
        """Return (step, condition) of the first condition that fires at the end of a step."""
        met = self._met[: len(chunk.codes)]
        if not met.any():
            return None
        k = int(np.argmax(met.any(axis=1)))
        return k, int(np.argmax(met[k]))

    def first_undefined(self, chunk: Chunk) -> tuple[int, str] | None:
        """Return the first step at whose end a condition has no value, and its name."""
        return self._truths.undefined(chunk) if self._guards.names else None

    def accept(self, chunk: Chunk, start: float, end: float) -> None:
        """Continue after steps, the first of those taken last, until the run is at `end`."""
        if self._guards.names:
            self._met, self._passing = (x[: len(chunk.codes)] for x in (self._met, self._passing))
            self._spans = self._truths.accept(chunk, start, end) | self._spans

    def locate(self, recorder: Recorder, condition: int) -> tuple[Arc, int]:
        """Return the arc that ends where a condition is met in the last step, and arcs after it.

        A condition may be met in a part of the step before an impact.
        """
        recorder.close()
        margin = partial(self._margin, condition, len(recorder.row))
        arc, later, arcs = recorder.arcs[-1], 0, recorder.arcs
        while len(arc.times) == 2 and margin(arc, 0.0) < 0.0 and later + 1 < len(arcs):
            before = arcs[-2 - later]
            # An arc may also end where only the parameters change.
            if not (before.j < arc.j and margin(before, before.duration) < 0.0):
                break
            arc, later = before, later + 1
        low, high = float(arc.times[-2]), arc.duration
        if margin(arc, low) < 0.0:
            high = low
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if margin(arc, middle) < 0.0 else (middle, high)
        return cut(arc, len(arc.times) - 2, high), later

    def _margin(self, condition: int, regions: int, arc: Arc, local: float) -> float:
        at = np.array([local])
        unknowns = arc.unknowns(at)
        assert unknowns is not None
        time = np.array([arc.start.later(local).high])
        states = arc.mode[regions:]
        self._truths.enter(self._guards.within(states), states)
        margins = self._truths.table(time, arc.states(at), unknowns)[0, :, 0]
        _, stop, first = self._guards.within(states).watch.placed[condition]
        return stop.margin(margins[first:].tolist(), self._guards.active.of(arc.mode))
