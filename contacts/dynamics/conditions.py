"""When contacts with conditions, or on edges that end, go off and come back.

Off, a contact bears no force and its gap is not watched. It comes back when all its conditions hold
and its gap is open: a foot that is inside the surface then (scuffing) comes back once it is out.
One that touches while a condition begins to hold comes back at once: a point that slides from an
edge onto the next would be below that by the time anything is seen of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.snapshot import Snapshot
from contacts.states import OFF
from statechart.arrays import Array, Ints32
from statechart.automaton.trace import Key
from statechart.formulas.tape import Tape
from statechart.kernels.jit import seldom
from statechart.kernels.tapes import tape_values

# A condition as near zero as this, of what the state's own sizes change it by, is on the edge.
_BAND = 1e-13


class Conditions:
    """Judges the conditions of a scene's contacts.

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    states : mapping, optional
        Controller -> its state; those at the start by default.

    Attributes
    ----------
    present : bool
        Whether any contact has a condition.
    listed : tuple of (int, str)
        Of every condition: the place of its contact, and the name of its margin.
    tape : Tape
        Outputs: the margins.
    """

    def __init__(self, mechanics: Mechanics, states: Mapping[str, str] | None = None) -> None:
        self._names = tuple(mechanics.scene.contacts)
        self._margins = [mechanics.conditions(name) for name in self._names]
        self.present = any(self._margins)
        self.listed = tuple(
            (contact, margin.name)
            for contact, margins in enumerate(self._margins)
            for margin in margins
        )
        self._mechanics, self._states = mechanics, states
        self.tape = self._tape(lambda margin: margin)

    def _tape(self, of: Callable[[sp.Expr], sp.Expr]) -> Tape:
        return self._mechanics.tape(
            [of(margin.expression) for margins in self._margins for margin in margins],
            definitions=self._mechanics.controlled(self._states),
        )

    @cached_property
    def _rates(self) -> Tape:
        """The rates of the margins; 0 where they depend on more than where bodies are, and when."""
        mechanics = self._mechanics
        unknown = {*mechanics.v, *mechanics.memory.values(), *mechanics.controls}
        return self._tape(lambda m: sp.S.Zero if m.free_symbols & unknown else mechanics.rate(m))

    def bands(self, values: Array, initial: Array, sizes: Array) -> dict[str, float]:
        """Return how near zero each condition counts as on the edge: name -> band."""
        if not self.present:
            return {}
        found = np.empty(len(self.listed))
        edges(*self.tape.program, values, initial, sizes, found)
        bands = found.tolist()
        names = [margin.name for margins in self._margins for margin in margins]
        result = dict(zip(names, bands, strict=True))
        for name, margins in zip(self._names, self._margins, strict=True):
            if margins:
                result[f"{name}.{OFF}"] = min(result[margin.name] for margin in margins)
        return result

    def failing(self, values: Array, state: Array, time: float) -> tuple[str, ...]:
        """Return, for every contact, the condition that fails most; "" where none does."""
        return tuple(
            min(found)[1] if found and min(found)[0] < 0.0 else ""
            for found in self._numbers(values, state, time)
        )

    def switched(
        self,
        mode: Key,
        snapshot: Snapshot,
        values: Array,
        state: Array,
        time: float,
        fired: tuple[str, ...],
        near: float,
        bands: Mapping[str, float],
    ) -> dict[int, str]:
        """Return the contacts that go off or come back, and the state that each takes.

        Parameters
        ----------
        mode : Key
            Now.
        snapshot : Snapshot
            Numbers at `state`.
        values, state, time
            Where.
        fired : tuple of str
            Margins that fell: on the edge of a condition they tell the sides apart.
        near : float
            The gap's tolerance.
        bands : mapping
            As `bands` returned them.
        """
        result: dict[int, str] = {}
        if not self.present:
            return result
        for i, found in enumerate(self._numbers(values, state, time)):
            if not found:
                continue
            if mode[i] == OFF:
                sign = -1.0 if f"{self._names[i]}.{OFF}" in fired else 1.0
                holds = all(value > sign * bands[name] for value, name in found)
                if holds and snapshot.contacts[i].gap >= -near:
                    result[i] = "free"
            elif any(
                value < (bands[name] if name in fired else -bands[name]) for value, name in found
            ):
                result[i] = OFF
        return result or self._met(mode, snapshot, values, state, time, near, bands)

    def _met(
        self,
        mode: Key,
        snapshot: Snapshot,
        values: Array,
        state: Array,
        time: float,
        near: float,
        bands: Mapping[str, float],
    ) -> dict[int, str]:
        """Return the contacts that touch while the last of their conditions begin to hold."""
        result: dict[int, str] = {}
        for i, found in enumerate(self._numbers(values, state, time)):
            touches = mode[i] == OFF and abs(snapshot.contacts[i].gap) <= near
            if touches and found and all(value >= -bands[name] for value, name in found):
                rates = self._numbers(values, state, time, self._rates)[i]
                if all(
                    value > bands[name] or rate > 0.0
                    for (value, name), (rate, _) in zip(found, rates, strict=True)
                ):
                    result[i] = "free"
        return result

    def _numbers(
        self, values: Array, state: Array, time: float, tape: Tape | None = None
    ) -> list[list[tuple[float, str]]]:
        if not self.present:
            return [[] for _ in self._names]
        numbers = iter((tape or self.tape).at(state, values, time).tolist())
        return [[(next(numbers), margin.name) for margin in margins] for margins in self._margins]


def hidden(snapshot: Snapshot, mode: Key) -> Snapshot:
    """Return the snapshot with the contacts that are off infinitely far away."""
    if OFF not in mode:
        return snapshot
    contacts = tuple(
        contact._replace(gap=math.inf) if name == OFF else contact
        for contact, name in zip(snapshot.contacts, mode, strict=True)
    )
    return snapshot._replace(contacts=contacts)


@seldom
def edges(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    values: Array,
    initial: Array,
    sizes: Array,
    bands: Array,
) -> None:
    """Write how near zero each condition (k,) counts as on the edge.

    Parameters
    ----------
    code, constants, outputs
        Tape of the conditions' margins.
    values, initial
        Parameters, and the state at the start.
    sizes : (n,) array
        How large the variables are.
    """
    count = outputs.shape[0]
    first, moved = np.empty(count), np.empty(count)
    state = initial.copy()
    tape_values(code, constants, outputs, state, values, 0.0, first)
    for k in range(count):
        bands[k] = abs(first[k])
    for i in range(sizes.shape[0]):
        state[i] = initial[i] + sizes[i]
        tape_values(code, constants, outputs, state, values, 0.0, moved)
        state[i] = initial[i]
        for k in range(count):
            bands[k] += abs(moved[k] - first[k])
    for k in range(count):
        bands[k] = _BAND * bands[k] if abs(bands[k]) < math.inf else 0.0
