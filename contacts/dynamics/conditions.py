"""Conditions of contacts (`enabled`, ends of edges): verdicts and margins.

A contact is on while its gate holds, once its gap was open under it. Off, it bears no
force and its gap is not watched: a foot inside the surface (scuffing) comes back once it is out.

A condition is an atom of a gate, f >= 0 or f > 0 (`contacts.dynamics.gates`). Beyond the round-off
of its terms the sign of f decides; within, the first derivative of f in time that is not zero,
along the motion. Where all derivatives are zero the relation itself decides: f >= 0 holds, f > 0
does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.controllers import controller_rates_in, values_in
from contacts.dynamics.gates import (
    FAILS,
    HOLDS,
    PER_CONDITION,
    UNSURE,
    GateAtom,
    conditions_at,
    judge_atoms,
    margin_bands,
    round_off,
    tree,
    truths,
)
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.scene.parts import Contact
from contacts.states import INACTIVE
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.laws import roles_in
from statechart.automaton.margin_derivatives import (
    MarginDerivatives,
    rounding_scale,
    time_derivative,
)
from statechart.automaton.trace import Key, Roles

if TYPE_CHECKING:
    from contacts.dynamics.setup import SceneSetup

# More often than this, what contacts are on and how they move do not come to agree.
_ROUNDS = 8
# Gradients are differences over this part of the sizes of coordinates.
_DIFFERENCE = 1e-6


class _Condition(NamedTuple):
    """An atom of a gate: its contact, the atom, and its margin with what controllers set."""

    contact: int
    atom: GateAtom
    margin: sp.Expr


class Conditions:
    """Judges the conditions of a scene's contacts.

    The `tape` computes, from the state (2 n,) and the sizes of its entries, `PER_CONDITION` numbers
    of each atom; then as many of each contact, of which the first is its gap.
    """

    def __init__(self, mechanics: Mechanics, states: Mapping[str, str] | None = None) -> None:
        contacts = mechanics.scene.frictional
        self._count = len(contacts)
        initial = mechanics.scene.controlled.initial
        known = values_in(mechanics, initial if states is None else states)
        gates = [mechanics.gate(name) for name in contacts]
        self._conditions = tuple(
            _Condition(place, atom, atom.margin.xreplace(known))
            for place, gate in enumerate(gates)
            for atom in (() if gate is None else gate.atoms)
        )
        self.present = bool(self._conditions)
        # For every contact the first contact of the same point.
        touching = [mechanics.scene.contacts.get(name) for name in contacts]
        self.points = tuple(
            next(k for k, other in enumerate(touching) if k == place or _alike(other, one))
            for place, one in enumerate(touching)
        )
        # The margins that fall as atoms cease to hold, as they begin to, and as the gap of a
        # contact opens that is off ("" without a gate).
        self.names = tuple(one.atom.name for one in self._conditions)
        self.back = tuple(one.atom.back for one in self._conditions)
        self.gaps = tuple("" if gate is None else gate.gap for gate in gates)
        self.nodes = tree(gates)
        self._roles = roles_in(tuple((initial if states is None else states).values()))
        self._memory = len(mechanics.controller_state)
        self._moving = {*mechanics.variables}
        memory = controller_rates_in(mechanics, known)
        rates = {**dict(zip(mechanics.q, mechanics.v, strict=True)), **memory}
        sizes = {v: sp.Symbol(f"size_{v}", real=True) for v in mechanics.variables}
        outputs: list[sp.Expr] = []
        for one in self._conditions:
            # The derivatives of rates depend on the mode.
            of_rates = bool(one.margin.free_symbols.intersection(mechanics.v))
            rate = sp.S.Zero if of_rates else time_derivative(one.margin, rates, mechanics.time)
            outputs += [
                one.margin,
                rate,
                rounding_scale(one.margin, sizes),
                rounding_scale(rate, sizes),
            ]
        for name, gate in zip(contacts, gates, strict=True):
            gap = sp.S.Zero if gate is None else mechanics.contact(name).symbols.gap
            outputs += [gap, *[sp.S.Zero] * (PER_CONDITION - 1)]
        self.tape = mechanics.tape(
            outputs, unknowns=tuple(sizes.values()), definitions=mechanics.controlled(states)
        )
        self._derivatives = MarginDerivatives(
            (*mechanics.variables, *mechanics.controller_state.values()),
            mechanics.parameters.ordered,
            mechanics.time,
        )

    def slots(self, margins: Sequence[str]) -> Ints:
        """Return (2 k + c,): places among `margins` of `names`, `back` and `gaps`, or -1."""
        places = {margin: place for place, margin in enumerate(margins)}
        names = (*self.names, *self.back, *self.gaps)
        return np.array([places.get(name, -1) for name in names], np.int64)

    def first(self, verdicts: Sequence[int]) -> tuple[str, ...]:
        """Return, for every contact, the first relation of a gate that fails; else ""."""
        result = [""] * self._count
        found = np.empty(len(self.nodes), np.int64)
        truths(self.nodes, np.array(verdicts, np.int64), found)
        top = -1
        for k, (kind, above, contact) in enumerate(self.nodes.tolist()):
            top = k if above < 0 else top
            # The parts of the topmost node are the relations.
            if above == top and found[k] == FAILS and not result[contact]:
                atom = kind
                for below in range(k + 1, len(self.nodes)):
                    if atom >= 0:
                        break
                    atom = int(self.nodes[below, 0])
                result[contact] = self._conditions[atom].atom.words
        return tuple(result)

    def at(self, setup: SceneSetup, state: Array, time: float) -> ConditionsAt:
        """Evaluate the conditions in a state."""
        return ConditionsAt(self, setup, state, time)


class ConditionsAt:
    """The conditions of a scene's contacts in a state."""

    def __init__(self, of: Conditions, setup: SceneSetup, state: Array, time: float) -> None:
        self._of, self._setup, self._state, self._time = of, setup, state, time
        # Numbers of every atom, then of every contact; see `Conditions.tape`.
        self._values = self._numbers(state)
        self._verdicts = np.empty(len(of._conditions), np.int64)
        judge_atoms(self._values, setup.precision, 0, self._verdicts)

    def _numbers(self, state: Array) -> Array:
        if not self._of.present:
            return np.empty(0)
        setup = self._setup
        sizes = setup.scales.with_time
        return conditions_at(
            *self._of.tape.program, sizes, setup.precision, state, setup.values, self._time
        )

    def tolerances(self, verdicts: Sequence[int] = ()) -> dict[str, float]:
        """Return margin -> how far below zero a flow from here lets it go: its round-off.

        Infinitely far, if no certificate needs it. `verdicts` are those of the atoms, where further
        derivatives have decided them.
        """
        of, setup = self._of, self._setup
        if not of.present:
            return {}
        judged = np.array(verdicts, np.int64) if verdicts else self._verdicts
        names = (*of.names, *of.back, *of.gaps)
        bands = np.empty(len(names))
        near = setup.tolerances["gap"]
        margin_bands(of.nodes, self._values, setup.precision, near, judged, bands)
        return {name: band for name, band in zip(names, bands.tolist(), strict=True) if name}

    @cached_property
    def _margins(self) -> tuple[Array, Array]:
        """Margins (k,) of all atoms, and their round-off."""
        rows = self._values.reshape(-1, PER_CONDITION)[: len(self._verdicts)]
        bands = [round_off(size, self._setup.precision) for size in rows[:, 2].tolist()]
        return rows[:, 0], np.array(bands)

    @cached_property
    def _is_zero(self) -> Bools:
        """Mask (k,) of the atoms that are zero within their round-off."""
        margins, bands = self._margins
        return np.asarray(np.abs(margins) <= bands)

    @property
    def on_boundary(self) -> bool:
        """True if an atom is zero within its round-off."""
        return bool(self._is_zero.any())

    @cached_property
    def blurred(self) -> list[float]:
        """Distance, for every contact, that a place may be off where a gate of its point is zero.

        That is the round-off of the gate over its gradient, in coordinates.
        """
        points, state = self._of.points, self._state
        found = [0.0] * len(points)
        here, bands = self._margins
        # A margin that has just fallen lies at the bound of its round-off.
        places = np.flatnonzero(np.abs(here) <= 2.0 * bands)
        if not places.size:
            return found
        gradients = np.empty((len(here), len(state) // 2))
        for i in range(len(state) // 2):
            moved = state.copy()
            moved[i] += _DIFFERENCE * max(abs(state[i]), self._setup.scales.sizes[i])
            there = self._numbers(moved)[: PER_CONDITION * len(here) : PER_CONDITION]
            gradients[:, i] = (there - here) / (moved[i] - state[i])
        steep = np.linalg.norm(gradients, axis=1)
        for k in places[steep[places] > 0.0].tolist():
            point = points[self._of._conditions[k].contact]
            found[point] = max(found[point], bands[k] / steep[k])
        return [found[point] for point in points]

    def with_boundary(
        self, verdicts: Sequence[int], contacts: Collection[int], fired: Collection[str]
    ) -> list[int]:
        """Return the verdicts if the atoms of contacts hold that are zero within round-off.

        Not those whose margins fell.
        """
        atoms = zip(self._of._conditions, verdicts, self._is_zero.tolist(), strict=True)
        return [
            HOLDS if one.contact in contacts and one.atom.name not in fired and zero else verdict
            for one, verdict, zero in atoms
        ]

    def failing(self) -> tuple[str, ...]:
        """Return, for every contact, a condition that fails; "" where none does."""
        return self._of.first(self.verdicts())

    def verdicts(
        self,
        fired: Collection[str] = (),
        motion: Callable[[Sequence[bool]], Roles | None] | None = None,
        on: Sequence[bool] = (),
    ) -> list[int]:
        """Return the verdict of every atom.

        Where all derivatives are zero the margins decide that `fired`, and the conditions of
        contacts hold that are `on` (c,). `motion` returns, for the contacts (c,) whose conditions
        fail, the roles in which the scene then moves, or None: further derivatives are taken along
        it, until what holds and how it moves agree.
        """
        found = self._verdicts.tolist()
        unsure = [k for k, verdict in enumerate(found) if verdict == UNSURE]
        standing = [self._judge_staying(k, fired, on) for k in unsure]
        if motion is None or self._setup.modes is None or not unsure:
            for k, still in zip(unsure, standing, strict=True):
                found[k] = still
            return found
        for k in unsure:
            found[k] = self._judge_staying(k, (), on)

        def ways(verdicts: Sequence[int]) -> list[float] | None:
            roles = motion([name != "" for name in self._of.first(verdicts)])
            return None if roles is None else [self._way(roles, k) for k in unsure]

        tried = [found]
        for _ in range(_ROUNDS):
            signs = ways(found)
            if signs is None:
                return found
            found = [*found]
            for k, way, still in zip(unsure, signs, standing, strict=True):
                found[k] = HOLDS if way > 0.0 else FAILS if way < 0.0 else still
            if found == tried[-1]:
                return found
            if found in tried:
                break
            tried.append(found)
        # Each motion leads back to the boundary, as in a valley: there they hold together.
        around = tried[tried.index(found) :] if found in tried else tried
        closed = [max(verdicts) for verdicts in zip(*around, strict=True)]
        signs = ways(closed)
        return found if signs is None or min(signs) < 0.0 else closed

    def _judge_staying(self, k: int, fired: Collection[str], on: Sequence[bool]) -> int:
        """Judge an atom that stays on its boundary as far as its derivatives tell."""
        one = self._of._conditions[k]
        if one.atom.name in fired:
            return FAILS
        if on and on[one.contact] and one.margin.free_symbols & self._of._moving:
            return HOLDS
        return HOLDS if one.atom.closed or one.atom.back in fired else FAILS

    def _way(self, roles: Roles, k: int) -> float:
        """Return the sign of the first derivative of an atom in a mode that is not zero."""
        of, setup = self._of, self._setup
        memory, values = np.split(setup.values, [of._memory])
        whole = np.concatenate([self._state, memory])
        assert setup.sizes is not None
        sizes = np.maximum(np.abs(whole), setup.sizes)
        inner, roles = replace(setup, values=values), (*roles, *of._roles)
        margin = of._conditions[k].margin
        return of._derivatives.sign(inner, roles, margin, whole, sizes, self._time, setup.precision)


def _alike(one: Contact | None, other: Contact | None) -> bool:
    return (
        one is not None
        and other is not None
        and (one.point, one.radius) == (other.point, other.radius)
    )


def hidden(snapshot: Snapshot, mode: Key) -> Snapshot:
    """Return the snapshot with the contacts that are off infinitely far away.

    Their other numbers, which need not be finite, are 0.
    """
    if not any(state in INACTIVE for state in mode):
        return snapshot
    jacobians, biases = snapshot.jacobians.copy(), snapshot.biases.copy()
    contacts, forces = [*snapshot.contacts], snapshot.forces
    for i, state in enumerate(mode):
        if state in INACTIVE:
            if snapshot.pushes is not None and contacts[i].gap == 0.0:
                forces = forces - snapshot.pushes[i]
            jacobians[i] = biases[i] = 0.0
            zeros = (0.0,) * len(PerContact._fields[1:-2])
            contacts[i] = PerContact._make((math.inf, *zeros, jacobians[i], None))
    held = snapshot.held
    if held is not None:
        held = replace(held, whole=hidden(held.whole, mode))
    return snapshot._replace(
        contacts=tuple(contacts), forces=forces, jacobians=jacobians, biases=biases, held=held
    )
