"""Conditions of contacts (`enabled`, ends of edges): verdicts and margins.

A contact is on while its gate holds and its gap has been open since the gate began to hold. A
contact that is off bears no force and its gap is not watched: a foot inside the surface (scuffing)
becomes active again once it is outside.

A condition is an atom of a gate, f >= 0 or f > 0 (`contacts.dynamics.gates`). The sign of f decides
beyond the round-off of its terms; within it, the first nonzero time derivative of f along the
motion decides. If all derivatives are zero, f >= 0 holds and f > 0 does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.gates import (
    FAILS,
    HOLDS,
    PER_CONDITION,
    UNSURE,
    GateAtom,
    conditions_at,
    gate_trees,
    judge_atoms,
    margin_bands,
    round_off,
    write_node_verdicts,
)
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.snapshot import EDGES, PerContact, Snapshot, SnapshotTape
from contacts.states import INACTIVE
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.laws import roles_in
from statechart.automaton.margin_derivatives import (
    MarginDerivatives,
    derivative,
    rounding_scale,
    time_derivative,
)
from statechart.automaton.trace import Key, Roles

if TYPE_CHECKING:
    from contacts.dynamics.setup import SceneSetup

# Limit of the fixed-point iteration between verdicts and the motion that they imply.
_MAX_VERDICT_ROUNDS = 8
# Step of difference quotients, relative to the sizes of coordinates.
_DIFFERENCE = 1e-6


class _Condition(NamedTuple):
    """An atom of a gate: its contact, the atom, and its margin with what controllers set."""

    contact: int
    atom: GateAtom
    margin: sp.Expr


class Conditions:
    """Conditions of a scene's contacts as one tape.

    From the state and the sizes of its entries the `tape` computes `PER_CONDITION` numbers
    per atom, then as many per contact, of which the first is its gap.
    """

    def __init__(self, mechanics: Mechanics, states: Mapping[str, str] | None = None) -> None:
        contacts = mechanics.scene.frictional
        self._count = len(contacts)
        initial = mechanics.scene.controlled.initial
        controlled = mechanics.values_in(states)
        gates = [mechanics.gate(name) for name in contacts]
        self._conditions = tuple(
            _Condition(place, atom, atom.margin.xreplace(controlled))
            for place, gate in enumerate(gates)
            if gate is not None
            for atom in gate.atoms
        )
        self.present = bool(self._conditions)
        # Index of the first contact of the same point, per contact.
        touching = [mechanics.scene.contacts.get(name) for name in contacts]
        points = [k if c is None else (c.point, c.radius) for k, c in enumerate(touching)]
        firsts = {point: k for k, point in reversed([*enumerate(points)])}
        self.points = tuple(map(firsts.__getitem__, points))
        # Names of the margins that fall as atoms cease to hold, as they begin to hold, and as the
        # gap of a contact opens that is off ("" without a gate).
        self.names = tuple(condition.atom.name for condition in self._conditions)
        self.back = tuple(condition.atom.back for condition in self._conditions)
        self.gaps = tuple("" if gate is None else gate.gap for gate in gates)
        self.nodes = gate_trees(gates)
        self._roles = roles_in(tuple((initial if states is None else states).values()))
        self._places = {*mechanics.q}
        memory = mechanics.controller_rates_in(controlled)
        rates = {**dict(zip(mechanics.q, mechanics.v, strict=True)), **memory}
        sizes = {v: sp.Symbol(f"size_{v}", real=True) for v in mechanics.variables}
        outputs: list[sp.Expr] = []
        for condition in self._conditions:
            rate = time_derivative(condition.margin, rates, mechanics.time)
            # The derivatives of rates depend on the mode; those of controls may jump.
            if condition.margin.free_symbols.intersection(mechanics.v) or rate.has(sp.sign):
                rate = sp.S.Zero
            outputs += [
                condition.margin,
                rate,
                rounding_scale(condition.margin, sizes),
                rounding_scale(rate, sizes),
            ]
        for name, gate in zip(contacts, gates, strict=True):
            gap = sp.S.Zero if gate is None else mechanics.contact(name).gap
            outputs += [gap, *[sp.S.Zero] * (PER_CONDITION - 1)]
        unknowns = [sizes.get(v, sp.Symbol(f"size_{v}", real=True)) for v in mechanics.state]
        self.tape = mechanics.tape(
            outputs, unknowns=unknowns, definitions=mechanics.controlled(states)
        )
        self._derivatives = MarginDerivatives(
            mechanics.state, mechanics.parameters.ordered, mechanics.time
        )

    def slots(self, margins: Sequence[str]) -> Ints:
        """Return the indices (2 k + c,) of `names`, `back` and `gaps` in `margins`, or -1."""
        places = {margin: place for place, margin in enumerate(margins)}
        names = (*self.names, *self.back, *self.gaps)
        return np.array([places.get(name, -1) for name in names], np.int64)

    def first(self, verdicts: Sequence[int]) -> tuple[str, ...]:
        """Return the first relation that fails in the gate of every contact, or ""."""
        result = [""] * self._count
        node_verdicts = np.empty(len(self.nodes), np.int64)
        write_node_verdicts(self.nodes, np.array(verdicts, np.int64), node_verdicts)
        top = -1
        for k, (_, above, contact) in enumerate(self.nodes.tolist()):
            top = k if above < 0 else top
            # The parts of the topmost node are the relations.
            if above == top and node_verdicts[k] == FAILS and not result[contact]:
                # Parents come before children: the first atom from here on is its own.
                atom = next(kind for kind in self.nodes[k:, 0].tolist() if kind >= 0)
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
        sizes = np.append(setup.sizes, setup.scales.length / setup.scales.speed)
        return conditions_at(
            *self._of.tape.program, sizes, setup.precision, state, setup.values, self._time
        )

    def tolerances(self, verdicts: Sequence[int] = ()) -> dict[str, float]:
        """Return margin -> how far below zero a flow may let it fall: its round-off.

        The tolerance of a margin that no certificate needs is infinite. `verdicts` are those of
        the atoms, if higher derivatives have decided them.
        """
        of, setup = self._of, self._setup
        if not of.present:
            return {}
        judged = np.array(verdicts, np.int64) if verdicts else self._verdicts
        names = (*of.names, *of.back, *of.gaps)
        bands = np.empty(len(names))
        gap_tolerance = setup.tolerances["gap"]
        margin_bands(of.nodes, self._values, setup.precision, gap_tolerance, judged, bands)
        return {name: band for name, band in zip(names, bands.tolist(), strict=True) if name}

    @cached_property
    def _margins(self) -> tuple[Array, Array]:
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
    def position_uncertainty(self) -> list[float]:
        """Position error of every contact's point at the boundary of its gate.

        The round-off of the gate divided by the norm of its gradient in the coordinates.
        """
        points, state = self._of.points, self._state
        uncertainties = [0.0] * len(points)
        margins, bands = self._margins
        # A margin that has just fallen lies at the limit of its round-off.
        places = np.flatnonzero(np.abs(margins) <= 2.0 * bands)
        if not places.size:
            return uncertainties
        sizes = self._setup.scales.coordinates
        gradients = np.empty((len(margins), len(sizes)))
        for i in range(len(sizes)):
            displaced = state.copy()
            displaced[i] += _DIFFERENCE * max(abs(state[i]), sizes[i])
            shifted = self._numbers(displaced)[::PER_CONDITION][: len(margins)]
            gradients[:, i] = (shifted - margins) / (displaced[i] - state[i])
        steep = np.linalg.norm(gradients, axis=1)
        for k in places[steep[places] > 0.0].tolist():
            point = points[self._of._conditions[k].contact]
            uncertainties[point] = max(uncertainties[point], bands[k] / steep[k])
        return [uncertainties[point] for point in points]

    def with_boundary(
        self, verdicts: Sequence[int], contacts: Collection[int], fired: Collection[str]
    ) -> list[int]:
        """Return the verdicts if the zero atoms of `contacts` hold, except those that fired."""
        atoms = zip(self._of._conditions, verdicts, self._is_zero.tolist(), strict=True)
        return [
            HOLDS if zero and one.contact in contacts and one.atom.name not in fired else verdict
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

        If all derivatives of an atom are zero, a margin in `fired` decides it, and the conditions
        of contacts that are `on` (c,) hold. `motion` returns the roles in which the scene moves if
        the conditions of given contacts (c,) fail, or None. Higher derivatives are taken along that
        motion, by a fixed-point iteration on verdicts and motion.
        """
        verdicts = self._verdicts.tolist()
        unsure = [k for k, verdict in enumerate(verdicts) if verdict == UNSURE]
        moves = motion is not None and self._setup.modes is not None
        at_rest = [self._judge_staying(k, fired, on) for k in unsure]
        for k, verdict in zip(unsure, at_rest, strict=True):
            verdicts[k] = self._judge_staying(k, (), on) if moves else verdict
        if motion is None or not moves or not unsure:
            return verdicts

        def derivative_signs(verdicts: Sequence[int]) -> list[float] | None:
            roles = motion([name != "" for name in self._of.first(verdicts)])
            return None if roles is None else [self._derivative_sign(roles, k) for k in unsure]

        tried = [verdicts]
        for _ in range(_MAX_VERDICT_ROUNDS):
            signs = derivative_signs(verdicts)
            if signs is None:
                return verdicts
            verdicts = [*verdicts]
            for k, sign, verdict in zip(unsure, signs, at_rest, strict=True):
                # A velocity that friction stops at zero has fired, but does not pass zero.
                stays = sign == 0.0 and self._of._conditions[k].atom.back in fired
                judged = self._judge_staying(k, (), on) if stays else verdict
                verdicts[k] = HOLDS if sign > 0.0 else FAILS if sign < 0.0 else judged
            if verdicts == tried[-1]:
                return verdicts
            if verdicts in tried:
                break
            tried.append(verdicts)
        # A cycle: each motion leads back to the boundary, as in a valley, where all of them hold.
        cycle = tried[tried.index(verdicts) :] if verdicts in tried else tried
        union = [max(judged) for judged in zip(*cycle, strict=True)]
        signs = derivative_signs(union)
        if signs is None or min(signs) >= 0.0:
            return verdicts if signs is None else union
        # Conditions that fall while they hold, and stay at their boundary while they fail, fail.
        least = [min(judged) for judged in zip(*cycle, strict=True)]
        signs = derivative_signs(least)
        return verdicts if signs is None or max(signs) > 0.0 else least

    def _judge_staying(self, k: int, fired: Collection[str], closed: Sequence[bool]) -> int:
        """Judge an atom whose derivatives are all zero, or undefined."""
        if not self._is_zero[k]:
            return HOLDS if self._margins[0][k] > 0.0 else FAILS
        condition = self._of._conditions[k]
        if condition.atom.name in fired:
            return FAILS
        lasts = closed and closed[condition.contact]
        if lasts and condition.margin.free_symbols & self._of._places:
            return HOLDS
        return HOLDS if condition.atom.closed or condition.atom.back in fired else FAILS

    def _derivative_sign(self, roles: Roles, k: int) -> float:
        """Return the sign of the first nonzero derivative of an atom's margin in a mode."""
        of, setup = self._of, self._setup
        sizes = np.maximum(np.abs(self._state), setup.sizes)
        margin, moving = of._conditions[k].margin, (*roles, *of._roles)
        return of._derivatives.sign(
            setup, moving, margin, self._state, sizes, self._time, setup.precision
        )


def undecided_couplings(mechanics: Mechanics) -> Iterator[str]:
    """Yield a warning for each relation of a coupling that is at its bound while it is locked."""
    for name in mechanics.scene.couplings:
        gate, slip = mechanics.gate(name), mechanics.contact(name).slip
        for rate in [v for v in mechanics.v if v in slip.free_symbols][:1]:
            locked = {rate: rate - slip / derivative(slip, rate)}
            for atom in () if gate is None else gate.atoms:
                if rate in atom.margin.free_symbols and atom.margin.subs(locked).expand() == 0:
                    yield (
                        f"couplings.{atom.words} is at its bound while {name} is locked, whatever "
                        f"the sign of {name}.M; for a freewheel write enabled: in(REGION.STATE), "
                        f"and guards on {name}.M and {name}.slip there"
                    )


def hidden(snapshot: Snapshot, mode: Key) -> Snapshot:
    """Return the snapshot with infinite gaps, and zeros, for the contacts that are off."""
    if not any(state in INACTIVE for state in mode):
        return snapshot
    jacobians, biases = snapshot.jacobians.copy(), snapshot.biases.copy()
    contacts, forces = [*snapshot.contacts], snapshot.forces
    for i in (i for i, state in enumerate(mode) if state in INACTIVE):
        if snapshot.pushes is not None and contacts[i].gap == 0.0:
            forces = forces - snapshot.pushes[i]
        jacobians[i] = biases[i] = 0.0
        contacts[i] = PerContact._make((math.inf, *[0.0] * (EDGES - 1), None))
    reduction = snapshot.reduction
    if reduction is not None:
        reduction = replace(reduction, unreduced=hidden(reduction.unreduced, mode))
    return snapshot._replace(
        contacts=tuple(contacts), forces=forces, jacobians=jacobians, biases=biases,
        reduction=reduction,
    )  # fmt: skip


def hidden_at(
    tape: SnapshotTape, values: Array, start: float, mode: Key
) -> Callable[[Array, float], Snapshot]:
    """Return a function from a state, and a time after `start`, to the snapshot of a mode."""
    return lambda state, later: hidden(tape.at(values, state, start + later), mode)
