"""Warnings about gated contacts that points pass through, in runs with events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.scene.lint import (
    NEARLY_MEETING,
    goes_off_warning,
    missed_edge_warning,
    stays_off_warning,
)
from contacts.states import OFF, OPEN
from statechart.arrays import Array
from statechart.automaton.trace import Arc, Key
from statechart.formulas.tape import Tape

# Samples per step of an arc, and bisections between two of them. Shorter intervals are missed.
_SAMPLES, _BISECTIONS = 8, 50
# Part of the scene's length: a point that passes an edge so near to its end hardly was meant to.
_BESIDE = 1e-6
# Margin of a condition on a state, which no motion nearly meets.
_OTHER_STATE = 1e300
_SAMPLE_POINTS = np.linspace(0.0, 1.0, _SAMPLES + 1)


class Handovers:
    """Search for contacts that stay off although all their conditions hold.

    A point inside its surface when the conditions begin to hold may come out again (a scuffing
    foot). It has missed the surface if it is deeper when the conditions fail or the run ends.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        names = enumerate(mechanics.scene.contacts)
        self._gated = {i: name for i, name in names if mechanics.gate(name) is not None}
        self._tapes: dict[Key, Tape] = {}

    def remarks(self, setup: SceneSetup, arcs: Sequence[Arc]) -> tuple[str, ...]:
        """Return a warning for each contact that has missed its surface by a small depth."""
        if not self._gated:
            return ()
        arcs, gap_tolerance = list(arcs), setup.tolerances["gap"]
        tables, inside = self._tables(setup, arcs, gap_tolerance)
        early = self._let_through(arcs, tables, gap_tolerance)
        missed_ends = self._past_ends(setup, arcs, tables, gap_tolerance)
        shallow = NEARLY_MEETING * setup.scales.length
        missed: dict[str, float] = {}
        for place, (contact, name) in enumerate(self._gated.items()) if inside else ():
            # Depth of the point as the conditions began to hold, and now.
            first = now = 0.0
            for k, arc in enumerate(arcs):
                if arc.mode[contact] != OFF:
                    first = now = 0.0
                    continue
                margins, gaps = tables[k][:, 2 * place], tables[k][:, 2 * place + 1]
                if not first and not (~(margins < 0.0) & (gaps < -gap_tolerance)).any():
                    continue
                for sample, (margin, gap) in enumerate(zip(margins, gaps, strict=True)):
                    if margin < 0.0:
                        if 0.0 < first < now and first <= shallow:
                            missed.setdefault(name, first)
                        first = now = 0.0
                        continue
                    now = -gap
                    if not first:
                        entered = self._at_crossing(setup, arc, place, sample) if sample else gap
                        first = -entered if -entered > gap_tolerance else 0.0
            if 0.0 < first < now and first <= shallow:
                missed.setdefault(name, first)
        scene = self._mechanics.scene
        stays_off = (stays_off_warning(scene, name, depth) for name, depth in missed.items())
        return (*early, *missed_ends, *stays_off)

    def _past_ends(
        self, setup: SceneSetup, arcs: Sequence[Arc], tables: Mapping[int, Array], near: float
    ) -> Iterator[str]:
        """Yield a warning for each contact that just misses its condition as its gap closes."""
        names = [*self._mechanics.scene.contacts]
        points = [self._mechanics.scene.contacts[name].point for name in names]
        gated, missed_ends = list(self._gated.items()), _BESIDE * setup.scales.length
        warned: set[str] = set()
        for k, table in tables.items():
            arc, gaps = arcs[k], table[:, 1::2]
            through = (gaps[:-1] > near) & (gaps[1:] < -near)
            for place in np.flatnonzero(through.any(axis=0)).tolist():
                contact, name = gated[place]
                same = (i for i, point in enumerate(points) if point == points[contact])
                # Another contact of the point that is closed takes its place.
                replaced = any(arc.mode[i] not in OPEN for i in same)
                if replaced or name in warned or arc.mode[contact] != OFF:
                    continue
                sample = int(through[:, place].argmax()) + 1
                around = table[sample - 1 : sample + 1, 2 * place]
                low, high = around.min(), around.max()
                if 2.0 * high - low < -missed_ends or 2.0 * low - high > 0.0:
                    continue  # Far from its boundary before and after
                if -missed_ends <= self._at_crossing(setup, arc, place, sample, gap=True) <= 0.0:
                    warned.add(name)
                    yield missed_edge_warning(name)

    def _let_through(
        self, arcs: Sequence[Arc], tables: Mapping[int, Array], gap_tolerance: float
    ) -> list[str]:
        """Return a warning for each contact that goes off at the instant at which it touches."""
        warnings: dict[str, str] = {}
        for k, (before, after) in enumerate(pairwise(arcs), 1):
            for place, (contact, name) in enumerate(self._gated.items()):
                if (before.mode[contact], after.mode[contact]) == ("free", OFF):
                    gap, later = tables[k][[0, _SAMPLES], 2 * place + 1]
                    if abs(gap) <= gap_tolerance and later < -gap_tolerance:
                        warnings.setdefault(name, goes_off_warning(name, after.start.high))
        return [*warnings.values()]

    def _tables(
        self, setup: SceneSetup, arcs: Sequence[Arc], gap_tolerance: float
    ) -> tuple[dict[int, Array], bool]:
        """Sample `_tape` on the arcs in which a gated contact is off.

        Also returns whether a point is inside a surface while its conditions hold.
        """
        count = len(self._mechanics.scene.frictional)
        groups: dict[tuple[Key, int], list[int]] = {}
        for k, arc in enumerate(arcs):
            if any(arc.mode[i] == OFF for i in self._gated):
                groups.setdefault((arc.mode[count:], arc.coefficients.shape[2]), []).append(k)
        tables: dict[int, Array] = {}
        inside = False
        for (states, terms), places in groups.items():
            group = [arcs[k] for k in places]
            steps = np.concatenate([arc.coefficients for arc in group])
            sampled = np.swapaxes(steps @ _SAMPLE_POINTS ** np.arange(terms)[:, None], 1, 2)
            times = np.concatenate([arc.start.high + _samples(arc) for arc in group])
            sampled = sampled.reshape(-1, steps.shape[1])
            rows = self._tape(states).table(sampled, setup.values, times)
            holds, below = ~(rows[:, ::2] < 0.0), rows[:, 1::2] < -gap_tolerance
            inside = inside or bool((holds & below).any())
            ends = np.cumsum([len(_SAMPLE_POINTS) * len(arc.coefficients) for arc in group])
            tables |= zip(places, np.split(rows, ends[:-1]), strict=True)
        return tables, inside

    def _tape(self, states: Key) -> Tape:
        if states not in self._tapes:
            controllers = self._mechanics.scene.controlled.flat
            controlled = self._mechanics.values_in(dict(zip(controllers, states, strict=True)))
            for symbol in self._mechanics.state_symbols.values():
                controlled[symbol] *= _OTHER_STATE
            outputs: list[sp.Expr] = []
            for name in self._gated.values():
                gate = self._mechanics.gate(name)
                assert gate is not None
                outputs.append(gate.by_steps(controlled, {}))
                outputs.append(self._mechanics.contact(name).gap.xreplace(controlled))
            self._tapes[states] = self._mechanics.tape(outputs)
        return self._tapes[states]

    def _at_crossing(
        self, setup: SceneSetup, arc: Arc, place: int, sample: int, *, gap: bool = False
    ) -> float:
        """Return the gap where the gate's margin rises through zero before a sample of an arc.

        With `gap`, return the margin where the gap falls through zero.
        """
        tape = self._tape(arc.mode[len(self._mechanics.scene.frictional) :])

        def at(local: float) -> Array:
            state = arc.states(np.array([local]))[0]
            return tape.values(state, setup.values, arc.start.high + local)

        before, after = _samples(arc)[sample - 1 : sample + 1].tolist()
        for _ in range(_BISECTIONS):
            middle = 0.5 * (before + after)
            if (at(middle)[2 * place + gap] < 0.0) != gap:
                before = middle
            else:
                after = middle
        return float(at(after)[2 * place + (not gap)])


def _samples(arc: Arc) -> Array:
    times: Array = arc.times[:-1, None] + np.diff(arc.times)[:, None] * _SAMPLE_POINTS
    return times.ravel()
