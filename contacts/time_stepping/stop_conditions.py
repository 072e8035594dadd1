"""Stop conditions of a stepped run: tested at the ends of steps, located by bisection inside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.guard_truths import ActiveStates, StepTruths
from contacts.time_stepping.lazy_arcs import cut
from contacts.time_stepping.recorder import Recorder
from statechart.arrays import Array
from statechart.automaton.regions import Region
from statechart.automaton.trace import Arc, Key
from statechart.charts.guard_watch import Guard, GuardWatch
from statechart.formulas.relation import parse_relation


class StopTapes:
    """Stop conditions over variables and unknowns, watched as guards are."""

    def __init__(
        self, mechanics: Mechanics, unknowns: Sequence[sp.Symbol], regions: Sequence[Region]
    ) -> None:
        texts = mechanics.scene.stop.conditions
        self.names, self.unknowns = tuple(texts), len(unknowns)
        self.watch = GuardWatch(
            [
                Guard(k, name, parse_relation(text), 0)
                for k, (name, text) in enumerate(texts.items())
            ],
            lambda guard: guard.relation.condition(mechanics.observables),
            {
                **dict(zip(mechanics.q, mechanics.v, strict=True)),
                **dict(zip(mechanics.v, mechanics.a, strict=True)),
            },
            inputs=(*mechanics.state, *unknowns),
            parameters=mechanics.parameters.ordered,
            time=mechanics.time,
        )
        self.active, self.coordinates = ActiveStates(regions), len(mechanics.q)


# Bisections of a step.
_BISECTIONS = 60


class StopConditions:
    """The stop conditions of a run."""

    def __init__(self, tapes: StopTapes, setup: SceneSetup) -> None:
        self._tapes, self._setup, self._watch = tapes, setup, tapes.watch
        assert setup.sizes is not None
        self._sizes = np.concatenate([setup.sizes, setup.scales.solved(tapes.unknowns)])
        self._truths = StepTruths(
            self._watch, self._table, setup.rounded, tapes.coordinates,
            lambda codes: tapes.active.at(codes, self._controls),
        )  # fmt: skip
        self._controls: Key = ()
        # Conditions (k, s) that hold at the ends of the last steps; modes where one was met.
        self._met, self._codes = np.zeros((0, 0), np.bool_), np.zeros((1, 0), int)
        # Condition -> warning that it is true for less than a step.
        self._spans = dict[str, str]()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of conditions that steps pass over."""
        return tuple(self._spans.values())

    def at_start(self, state: Array, solved: Array, recorder: Recorder, h: float) -> int | None:
        """Return the condition that holds at the start, with these unknowns, if any."""
        self._controls = recorder.controls
        _, true = self._truths.at(0.0, state, solved, h, recorder.start)
        return int(np.argmax(true)) if true.any() else None

    def take(self, chunk: Chunk, start: float, recorder: Recorder) -> None:
        """Evaluate the conditions in steps."""
        if not self._tapes.names:
            return
        self._controls = recorder.controls
        self._met = self._truths.take(chunk, start, np.vstack([recorder.row, chunk.codes]))[1]

    def first_met(self, chunk: Chunk) -> tuple[int, int] | None:
        """Return (step, condition) of the first condition that holds at the end of a step."""
        met = self._met[: len(chunk.codes)]
        if not met.any():
            return None
        k = int(np.argmax(met.any(axis=1)))
        self._codes = chunk.codes[k : k + 1]
        return k, int(np.argmax(met[k]))

    def first_undefined(self, chunk: Chunk) -> tuple[int, str] | None:
        """Return the first step at whose end a condition has no value, and its name."""
        return self._truths.undefined(chunk) if self._tapes.names else None

    def accept(self, chunk: Chunk, start: float, end: float) -> None:
        """Continue after steps, the first of those taken last, until the run is at `end`."""
        if self._tapes.names:
            self._spans = self._truths.accept(chunk, start, end) | self._spans

    def _table(self, times: Array, states: Array, solved: Array, order: int = 0) -> Array:
        """Return the margins of the atoms, or derivatives, and the sizes of terms (k, a, 2)."""
        rows = np.hstack([states, solved])
        return self._watch.table(self._setup, rows, self._sizes, times, order=order)

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
        margins = self._table(time, arc.states(at), unknowns)[0, :, 0]
        active = self._tapes.active.at(self._codes, self._controls)
        stop, first = self._watch.conditions[condition], self._watch.firsts[condition]
        return stop.margin(margins[first:].tolist(), lambda *of: bool(active(*of)[0]))
