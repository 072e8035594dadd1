"""Contacts that stay off in a run with events, as their points are inside where they take over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from contacts.dynamics.controllers import given_in
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.scene.lint import NEARLY_MEETING, stays_off
from contacts.states import OFF
from statechart.arrays import Array
from statechart.automaton.laws import Setup
from statechart.automaton.trace import Arc, Key
from statechart.formulas.tape import Tape

# Samples of each step of an arc, and halvings between two of them: what is shorter is not found.
_SAMPLES, _HALVINGS = 8, 50
_PARTS = np.linspace(0.0, 1.0, _SAMPLES + 1)


class Handovers:
    """Looks for contacts that never come back on, though all their conditions hold.

    A point that is inside a surface where the conditions of its contact begin to hold may come out
    again, as a foot does that scuffs. It has missed the surface where it goes deeper until they
    fail again, or the run ends.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        names = enumerate(mechanics.scene.contacts)
        self._gated = {i: name for i, name in names if mechanics.gate(name) is not None}
        self._tapes: dict[Key, Tape] = {}

    def remarks(self, setup: Setup, arcs: Sequence[Arc]) -> tuple[str, ...]:
        """Return a warning for each contact that has missed its surface by a small depth."""
        assert isinstance(setup, SceneSetup)
        found: dict[int, float] = {}
        depths: dict[int, tuple[float, float]] = {}

        def end(contact: int) -> None:
            first, last = depths.pop(contact, (0.0, 0.0))
            if last > first and first <= NEARLY_MEETING * setup.scales.length:
                found.setdefault(contact, first)

        for arc in arcs if self._goes_below(setup, arcs) else ():
            off = [i for i in self._gated if arc.mode[i] == OFF]
            for i in set(depths).difference(off):
                del depths[i]
            if not off:
                continue
            tape = self._tape(arc.mode)
            local = _samples(arc)
            times = arc.start.high + local
            numbers = tape.table(arc.states(local), setup.values, times)
            for k, now in enumerate(numbers):
                for i in off:
                    place = 2 * list(self._gated).index(i)
                    if now[place] < 0.0:
                        end(i)
                    elif i in depths:
                        depths[i] = depths[i][0], -now[place + 1]
                    else:
                        begun = now
                        if k:
                            begun = _begin(tape, setup, arc, place, local[k - 1], local[k])
                        if -begun[place + 1] > setup.tolerances["gap"]:
                            depths[i] = -begun[place + 1], -now[place + 1]
        for i in list(depths):
            end(i)
        return tuple(
            stays_off(self._mechanics.scene, self._gated[i], depth) for i, depth in found.items()
        )

    def _goes_below(self, setup: SceneSetup, arcs: Sequence[Arc]) -> bool:
        """Return whether a sample has a contact off with its conditions true and its gap closed."""
        if not self._gated:
            return False
        near = setup.tolerances["gap"]
        groups: dict[tuple[Key, int], list[Arc]] = {}
        count, contacts = len(self._mechanics.scene.contacts), tuple(self._gated)
        for arc in arcs:
            if any(arc.mode[i] == OFF for i in contacts):
                key = arc.mode[count:], arc.coefficients.shape[2]
                groups.setdefault(key, []).append(arc)
        for (_, terms), group in groups.items():
            steps = np.concatenate([arc.coefficients for arc in group])
            starts = np.concatenate([arc.start.high + arc.times[:-1] for arc in group])
            lengths = np.concatenate([np.diff(arc.times) for arc in group])
            off = np.repeat(
                [[arc.mode[i] == OFF for i in contacts] for arc in group],
                [len(arc.coefficients) for arc in group],
                axis=0,
            )
            states = np.swapaxes(steps @ _PARTS ** np.arange(terms)[:, None], 1, 2)
            times = starts[:, None] + lengths[:, None] * _PARTS
            found = self._tape(group[0].mode).table(
                states.reshape(-1, steps.shape[1]), setup.values, times.ravel()
            )
            conditions, gaps = found[:, ::2], found[:, 1::2]
            below = ~(conditions < 0.0) & (gaps < -near)
            if (below & np.repeat(off, len(_PARTS), axis=0)).any():
                return True
        return False

    def _tape(self, mode: Key) -> Tape:
        """Return the tape of the margin of its gate and the gap of each contact with conditions."""
        states = mode[len(self._mechanics.scene.contacts) :]
        if states not in self._tapes:
            controllers = self._mechanics.scene.controlled.flat
            named = dict(zip(controllers, states, strict=True))
            set_: dict[sp.Symbol, sp.Expr] = {}
            for control, value in given_in(self._mechanics, named):
                set_[control] = value.xreplace(set_)
            outputs: list[sp.Expr] = []
            for name in self._gated.values():
                gate = self._mechanics.gate(name)
                assert gate is not None
                outputs.append(gate.by_steps(set_))
                outputs.append(self._mechanics.contact(name).symbols.gap)
            self._tapes[states] = self._mechanics.whole_tape(outputs)
        return self._tapes[states]


def _samples(arc: Arc) -> Array:
    """Return local times of an arc: some of every step, and its end."""
    steps = arc.times[:-1, None] + np.diff(arc.times)[:, None] * _PARTS[:-1]
    return np.append(steps, arc.times[-1])


def _at(tape: Tape, setup: SceneSetup, arc: Arc, local: float) -> Array:
    """Return the numbers of a tape at a local time of an arc."""
    state = arc.states(np.array([local]))[0]
    return tape.values(state, setup.values, arc.start.high + local)


def _begin(
    tape: Tape, setup: SceneSetup, arc: Arc, place: int, before: float, after: float
) -> Array:
    """Return the numbers where a condition begins to hold between two local times."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (before + after)
        if _at(tape, setup, arc, middle)[place] < 0.0:
            before = middle
        else:
            after = middle
    return _at(tape, setup, arc, after)
