"""Stop conditions of a stepped run: tested at the ends of steps, located by bisection inside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from contacts.dynamics.controllers import ControlGuards, Controllers
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.guard_truths import ActiveStates, StepTruths
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
        # Conditions (k, s) that fire at the ends of the last steps; modes where one was met.
        self._met, self._codes = np.zeros((0, 0), np.bool_), np.zeros((1, 0), int)
        # Condition -> warning that it is true for less than a step.
        self._spans = dict[str, str]()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of conditions that steps pass over."""
        return tuple(self._spans.values())

    def at_start(self, state: Array, solved: Array, recorder: Recorder, h: float) -> int | None:
        """Return the condition that holds at the start, with these unknowns, if any."""
        _, true = self._truths.at(0.0, state, solved, h, recorder.start)
        return int(np.argmax(true)) if true.any() else None

    def take(self, chunk: Chunk, start: float, recorder: Recorder) -> None:
        """Evaluate the conditions in steps."""
        if not self._guards.names:
            return
        self._truths.enter(self._guards.within(recorder.controls), recorder.controls)
        self._met, _ = self._truths.take(chunk, start, np.vstack([recorder.row, chunk.codes]))

    def first_met(self, chunk: Chunk) -> tuple[int, int] | None:
        """Return (step, condition) of the first condition that fires at the end of a step."""
        met = self._met[: len(chunk.codes)]
        if not met.any():
            return None
        k = int(np.argmax(met.any(axis=1)))
        self._codes = chunk.codes[k : k + 1]
        return k, int(np.argmax(met[k]))

    def first_undefined(self, chunk: Chunk) -> tuple[int, str] | None:
        """Return the first step at whose end a condition has no value, and its name."""
        return self._truths.undefined(chunk) if self._guards.names else None

    def accept(self, chunk: Chunk, start: float, end: float) -> None:
        """Continue after steps, the first of those taken last, until the run is at `end`."""
        if self._guards.names:
            self._spans = self._truths.accept(chunk, start, end) | self._spans

    def locate(self, recorder: Recorder, condition: int) -> Array:
        """Cut the recorded run where a condition is met in its last step; return that state."""
        recorder.close()
        arc, before = recorder.arcs[-1], recorder.arcs[-2:-1]
        begin = float(arc.times[-2])
        met = len(arc.times) == 2 and self._margin(arc, begin, condition) < 0.0
        if met and before and self._margin(before[0], before[0].duration, condition) < 0.0:
            # It was met in the half step before an impact; otherwise at the start of the arc.
            arc = recorder.drop()
            begin = float(arc.times[-2])
        low, high = begin, arc.duration
        if self._margin(arc, low, condition) < 0.0:
            high = low
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if self._margin(arc, middle, condition) < 0.0:
                high = middle
            else:
                low = middle
        last = cut(arc, len(arc.times) - 2, high)
        recorder.rewind(last)
        state: Array = last.coefficients[-1].sum(axis=1)
        return state

    def _margin(self, arc: Arc, local: float, condition: int) -> float:
        at = np.array([local])
        unknowns = arc.unknowns(at)
        assert unknowns is not None
        time = np.array([arc.start.later(local).high])
        states = arc.mode[self._codes.shape[1] :]
        self._truths.enter(self._guards.within(states), states)
        margins = self._truths.table(time, arc.states(at), unknowns)[0, :, 0]
        active = self._truths.active(self._codes)
        _, stop, first = self._guards.within(states).watch.placed[condition]
        return stop.margin(margins[first:].tolist(), lambda *of: bool(active(*of)[0]))
