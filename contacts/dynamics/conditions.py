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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.controllers import given_in, memory_rates
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
from contacts.states import OFF
from statechart.arrays import Array, Ints
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
_APART = 1e-6


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
        contacts = tuple(mechanics.scene.contacts)
        self._count = len(contacts)
        initial = mechanics.scene.controlled.initial
        set_: dict[sp.Symbol, sp.Expr] = {}
        for symbol, value in given_in(mechanics, initial if states is None else states):
            set_[symbol] = value.xreplace(set_)
        gates = [mechanics.gate(name) for name in contacts]
        self._conditions = tuple(
            _Condition(place, atom, atom.margin.xreplace(set_))
            for place, gate in enumerate(gates)
            for atom in (() if gate is None else gate.atoms)
        )
        self.present = bool(self._conditions)
        # Of every contact the first contact of the same point.
        touching = [mechanics.scene.contacts[name] for name in contacts]
        self.points = tuple(
            next(k for k, other in enumerate(touching) if _alike(other, one)) for one in touching
        )
        # The margins that fall as atoms cease to hold, as they begin to, and as the gap of a
        # contact opens that is off ("" without a gate).
        self.names = tuple(one.atom.name for one in self._conditions)
        self.back = tuple(one.atom.back for one in self._conditions)
        self.gaps = tuple("" if gate is None else gate.gap for gate in gates)
        self.nodes = tree(gates)
        self._roles = roles_in(tuple((initial if states is None else states).values()))
        self._memory = len(mechanics.memory)
        self._moving = {*mechanics.variables}
        memory = {mechanics.memory[n]: r.xreplace(set_) for n, r in memory_rates(mechanics).items()}
        rates = {**dict(zip(mechanics.q, mechanics.v, strict=True)), **memory}
        sizes = {v: sp.Symbol(f"size_{v}", real=True) for v in mechanics.variables}
        outputs: list[sp.Expr] = []
        for one in self._conditions:
            # How rates go on depends on the mode.
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
        self.tape = mechanics.tape(outputs, unknowns=tuple(sizes.values()))
        self._derivatives = MarginDerivatives(
            (*mechanics.variables, *mechanics.memory.values()),
            mechanics.parameters.ordered,
            mechanics.time,
        )

    def slots(self, margins: Sequence[str]) -> Ints:
        """Return (2 k + c,): places among `margins` of `names`, `back` and `gaps`, or -1."""
        places = {margin: place for place, margin in enumerate(margins)}
        names = (*self.names, *self.back, *self.gaps)
        return np.array([places.get(name, -1) for name in names], np.int64)

    def tolerances(
        self, setup: SceneSetup, state: Array, time: float, verdicts: Sequence[int] = ()
    ) -> dict[str, float]:
        """Return margin -> how far below zero a flow lets it go: its round-off in a state.

        Infinitely far, if no certificate needs it. `verdicts` are those of the atoms there, where
        further derivatives have told them.
        """
        if not self.present:
            return {}
        values = self._at(setup, state, time)
        judged = np.array(verdicts, np.int64) if verdicts else self._judged(setup, values)
        bands = np.empty(2 * len(judged) + self._count)
        near = setup.tolerances["gap"]
        margin_bands(self.nodes, values, setup.precision, near, judged, bands)
        names = (*self.names, *self.back, *self.gaps)
        return {name: band for name, band in zip(names, bands.tolist(), strict=True) if name}

    def _judged(self, setup: SceneSetup, values: Array) -> Ints:
        """Return the verdict of every atom, by its margin and the first derivative of that."""
        verdicts = np.empty(len(self._conditions), np.int64)
        judge_atoms(values, setup.precision, 0, verdicts)
        return verdicts

    def _truths(self, verdicts: Sequence[int]) -> Ints:
        """Return the verdicts of the nodes of all gates."""
        found = np.empty(len(self.nodes), np.int64)
        truths(self.nodes, np.array(verdicts, np.int64), found)
        return found

    def on_boundary(self, setup: SceneSetup, state: Array, time: float) -> bool:
        """Return whether a condition is zero within its round-off."""
        margins, bands = self._margins(setup, state, time)
        return bool((np.abs(margins) <= bands).any())

    def _margins(self, setup: SceneSetup, state: Array, time: float) -> tuple[Array, Array]:
        """Return the margins (k,) of all atoms in a state, and their round-off."""
        rows = self._at(setup, state, time).reshape(-1, PER_CONDITION)[: len(self._conditions)]
        bands = [round_off(size, setup.precision) for size in rows[:, 2].tolist()]
        return rows[:, 0], np.array(bands)

    def blurred(self, setup: SceneSetup, state: Array, time: float) -> list[float]:
        """Return, for every contact, how far off a place may be where a gate of its point is zero.

        That is the round-off of the gate over its gradient, in coordinates.
        """
        found = [0.0] * self._count
        here, bands = self._margins(setup, state, time)
        # What has just fallen lies at the bound of its round-off.
        places = np.flatnonzero(np.abs(here) <= 2.0 * bands)
        if not places.size:
            return found
        gradients = np.empty((len(here), len(state) // 2))
        for i in range(len(state) // 2):
            moved = state.copy()
            moved[i] += _APART * max(abs(state[i]), setup.scales.sizes[i])
            there, _ = self._margins(setup, moved, time)
            gradients[:, i] = (there - here) / (moved[i] - state[i])
        steep = np.linalg.norm(gradients, axis=1)
        for k in places[steep[places] > 0.0].tolist():
            point = self.points[self._conditions[k].contact]
            found[point] = max(found[point], bands[k] / steep[k])
        return [found[point] for point in self.points]

    def kept_on(
        self,
        setup: SceneSetup,
        state: Array,
        time: float,
        verdicts: Sequence[int],
        contacts: Collection[int],
        fired: Collection[str],
    ) -> list[int]:
        """Return the verdicts if the atoms of contacts hold that are zero within round-off.

        Not those whose margins fell.
        """
        margins, bands = self._margins(setup, state, time)
        return [
            HOLDS if one.contact in contacts and one.atom.name not in fired and zero else verdict
            for one, verdict, zero in zip(
                self._conditions, verdicts, (np.abs(margins) <= bands).tolist(), strict=True
            )
        ]

    def failing(
        self,
        setup: SceneSetup,
        state: Array,
        time: float,
        fired: Collection[str] = (),
        motion: Callable[[Sequence[bool]], Roles | None] | None = None,
    ) -> tuple[str, ...]:
        """Return, for every contact, a condition that fails; "" where none does.

        See `verdicts` for the parameters.
        """
        return self.first(self.verdicts(setup, state, time, fired, motion))

    def verdicts(
        self,
        setup: SceneSetup,
        state: Array,
        time: float,
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
        found, unsure = [], []
        for k, verdict in enumerate(self._judged(setup, self._at(setup, state, time)).tolist()):
            if verdict == UNSURE:
                unsure.append(k)
                verdict = self._standing(self._conditions[k], (), on)
            found.append(verdict)
        standing = [self._standing(self._conditions[k], fired, on) for k in unsure]
        if motion is None or setup.modes is None or not unsure:
            for k, still in zip(unsure, standing, strict=True):
                found[k] = still
            return found

        def ways(verdicts: Sequence[int]) -> list[float] | None:
            roles = motion([name != "" for name in self.first(verdicts)])
            if roles is None:
                return None
            return [self._way(setup, roles, self._conditions[k], state, time) for k in unsure]

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

    def _at(self, setup: SceneSetup, state: Array, time: float) -> Array:
        """Return the numbers of every atom, then of every contact, flat; see `tape`."""
        if not self.present:
            return np.empty(0)
        return conditions_at(
            *self.tape.program,
            setup.scales.with_time,
            setup.precision,
            state,
            setup.values,
            time,
        )

    def first(self, verdicts: Sequence[int]) -> tuple[str, ...]:
        """Return, for every contact, the first relation of a gate that fails; else ""."""
        result = [""] * self._count
        found = self._truths(verdicts).tolist() if verdicts else []
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

    def _standing(self, one: _Condition, fired: Collection[str], on: Sequence[bool]) -> int:
        """Judge a condition that stays on its boundary as far as its derivatives tell."""
        if one.atom.name in fired:
            return FAILS
        if on and on[one.contact] and one.margin.free_symbols & self._moving:
            return HOLDS
        return HOLDS if one.atom.closed or one.atom.back in fired else FAILS

    def _way(
        self, setup: SceneSetup, roles: Roles, one: _Condition, state: Array, time: float
    ) -> float:
        """Return the sign of the first derivative of a condition in a mode that is not zero."""
        memory, values = setup.values[: self._memory], setup.values[self._memory :]
        whole = np.concatenate([state, memory])
        assert setup.sizes is not None
        sizes = np.maximum(np.abs(whole), setup.sizes)
        return self._derivatives.sign(
            replace(setup, values=values),
            (*roles, *self._roles),
            one.margin,
            whole,
            sizes,
            time,
            setup.precision,
        )


def _alike(one: Contact, other: Contact) -> bool:
    return (one.point, one.radius) == (other.point, other.radius)


def hidden(snapshot: Snapshot, mode: Key) -> Snapshot:
    """Return the snapshot with the contacts that are off infinitely far away.

    Their other numbers, which need not be finite, are 0.
    """
    if OFF not in mode:
        return snapshot
    jacobians, biases = snapshot.jacobians.copy(), snapshot.biases.copy()
    contacts = [*snapshot.contacts]
    for i, state in enumerate(mode):
        if state == OFF:
            jacobians[i] = biases[i] = 0.0
            zeros = dict.fromkeys(PerContact._fields[1:-1], 0.0)
            contacts[i] = PerContact(gap=math.inf, jacobian=jacobians[i], **zeros)
    held = snapshot.held
    if held is not None:
        held = replace(held, whole=hidden(held.whole, mode))
    return snapshot._replace(
        contacts=tuple(contacts), jacobians=jacobians, biases=biases, held=held
    )
