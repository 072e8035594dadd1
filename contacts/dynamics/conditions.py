"""When contacts with conditions, or on edges that end, go off and come back.

A contact is on while all its conditions hold, once its gap was open under them. Off, it bears no
force and its gap is not watched: a foot inside the surface (scuffing) comes back once it is out.

A condition is f >= 0 or f > 0. Beyond the round-off of its terms the sign of f decides; within, the
first derivative of f in time that is not zero, along the motion. Where all derivatives are zero the
relation itself decides: f >= 0 holds, f > 0 does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.control_guards import given_in, memory_rates
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.states import OFF
from statechart.arrays import Array, Ints, Ints32
from statechart.automaton.course import UNDERFLOW, Courses, along, size_of
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Key, Roles
from statechart.formulas.formula import parse_relation
from statechart.kernels.jit import seldom
from statechart.kernels.tapes import tape_values

if TYPE_CHECKING:
    from contacts.dynamics.setup import SceneSetup

HOLDS, FAILS, UNSURE = 1, -1, 0
"""Judgements of a condition; the last where its first derivative is zero, or not known."""
PER_CONDITION = 4
"""Numbers of a condition: its margin, the first derivative in time, the sizes of their terms."""
# At a multiple zero the terms vanish with f: they are looked at this far beside it, a power of the
# relative round-off, so that what rounds to zero there does not.
_BESIDE = 0.75
# More often than this, what contacts are on and how they move do not come to agree.
_ROUNDS = 8


class _Condition(NamedTuple):
    """A condition: its contact, the name and formula of its margin, and whether 0 satisfies it."""

    contact: int
    name: str
    margin: sp.Expr
    closed: bool


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
    owners : (k,) array of int64
        Contact of every condition.
    off : mapping
        Place of a contact with conditions -> the name of the margin that brings it back.
    tape : Tape
        Variables: the state (2 n,) and the sizes of its entries; outputs: `PER_CONDITION` numbers
        of each condition.
    """

    def __init__(self, mechanics: Mechanics, states: Mapping[str, str] | None = None) -> None:
        self._names = tuple(mechanics.scene.contacts)
        initial = mechanics.scene.controlled.initial
        set_: dict[sp.Symbol, sp.Expr] = {}
        for symbol, value in given_in(mechanics, initial if states is None else states):
            set_[symbol] = value.xreplace(set_)
        self._conditions = tuple(_listed(mechanics, set_))
        self.present = bool(self._conditions)
        self.listed = tuple((one.contact, one.name) for one in self._conditions)
        self.owners = np.array([one.contact for one in self._conditions], np.int64)
        self.off = {place: f"{self._names[place]}.{OFF}" for place, _ in self.listed}
        self._roles = roles_in(tuple((initial if states is None else states).values()))
        self._memory = len(mechanics.memory)
        memory = {mechanics.memory[n]: r.xreplace(set_) for n, r in memory_rates(mechanics).items()}
        rates = {**dict(zip(mechanics.q, mechanics.v, strict=True)), **memory}
        sizes = {v: sp.Symbol(f"size_{v}", real=True) for v in mechanics.variables}
        outputs: list[sp.Expr] = []
        for one in self._conditions:
            # How rates go on depends on the mode.
            of_rates = bool(one.margin.free_symbols.intersection(mechanics.v))
            rate = sp.S.Zero if of_rates else along(one.margin, rates, mechanics.time)
            outputs += [one.margin, rate, size_of(one.margin, sizes), size_of(rate, sizes)]
        self.tape = mechanics.tape(outputs, unknowns=tuple(sizes.values()))
        self._courses = Courses(
            (*mechanics.variables, *mechanics.memory.values()),
            mechanics.parameters.ordered,
            mechanics.time,
        )

    def slots(self, margins: Sequence[str]) -> Ints:
        """Return (k + c,): places among `margins` of conditions and of what brings contacts back.

        -1 where there is none.
        """
        names = [name for _, name in self.listed]
        names += [self.off.get(place, "") for place in range(len(self._names))]
        return np.array([margins.index(n) if n in margins else -1 for n in names], np.int64)

    def tolerances(self, setup: SceneSetup, state: Array, time: float) -> dict[str, float]:
        """Return margin -> its round-off in a state: how far below zero a flow lets it go."""
        found: dict[str, float] = {}
        for one, numbers in zip(self._conditions, self._at(setup, state, time), strict=True):
            band, off = round_off(numbers[2], setup.precision), self.off[one.contact]
            found[one.name] = band
            found[off] = min(band, found.get(off, band))
        return found

    def on_boundary(self, setup: SceneSetup, state: Array, time: float) -> bool:
        """Whether a condition is zero within its round-off."""
        return any(
            abs(numbers[0]) <= round_off(numbers[2], setup.precision)
            for numbers in self._at(setup, state, time)
        )

    def failing(
        self,
        setup: SceneSetup,
        state: Array,
        time: float,
        fired: Collection[str] = (),
        motion: Callable[[Sequence[bool]], Roles | None] | None = None,
    ) -> tuple[str, ...]:
        """Return, for every contact, a condition that fails; "" where none does.

        Parameters
        ----------
        setup : SceneSetup
            The numbers of the run.
        state, time
            Where and when.
        fired : collection of str
            Margins that fell: they decide where all derivatives are zero.
        motion : callable, optional
            Contacts (c,) whose conditions fail -> the roles in which the scene then moves; None
            where that is not known. Further derivatives are taken along it, until what holds and
            how it moves agree.
        """
        found, unsure = [], []
        for k, (value, rate, size, slow) in enumerate(self._at(setup, state, time)):
            verdict = judge(value, rate, size, slow, setup.precision)
            one = self._conditions[k]
            if verdict == UNSURE:
                unsure.append((k, self._standing(one, fired)))
                verdict = unsure[-1][1]
            found.append(verdict)
        for _ in range(_ROUNDS if unsure and setup.modes is not None else 0):
            failing = self._first(found)
            roles = None if motion is None else motion([name != "" for name in failing])
            if roles is None:
                return failing
            before = [*found]
            for k, standing in unsure:
                way = self._way(setup, roles, self._conditions[k], state, time)
                found[k] = HOLDS if way > 0.0 else FAILS if way < 0.0 else standing
            if found == before:
                break
        return self._first(found)

    def _at(self, setup: SceneSetup, state: Array, time: float) -> list[list[float]]:
        """Return the numbers of every condition; see `tape`."""
        if not self.present:
            return []
        numbers = conditions_at(
            *self.tape.program,
            setup.scales.with_time,
            setup.precision,
            state,
            setup.values,
            time,
        )
        return numbers.reshape(-1, PER_CONDITION).tolist()

    def _first(self, verdicts: Sequence[int]) -> tuple[str, ...]:
        """Return, for every contact, its first condition that fails."""
        result = [""] * len(self._names)
        for one, verdict in zip(self._conditions, verdicts, strict=True):
            if verdict == FAILS and not result[one.contact]:
                result[one.contact] = one.name
        return tuple(result)

    def _standing(self, one: _Condition, fired: Collection[str]) -> int:
        """Judge a condition that stays on its boundary as far as its derivatives tell."""
        if one.name in fired:
            return FAILS
        return HOLDS if one.closed or self.off[one.contact] in fired else FAILS

    def _way(
        self, setup: SceneSetup, roles: Roles, one: _Condition, state: Array, time: float
    ) -> float:
        """Return the sign of the first derivative of a condition in a mode that is not zero."""
        memory, values = setup.values[: self._memory], setup.values[self._memory :]
        whole = np.concatenate([state, memory])
        assert setup.sizes is not None
        sizes = np.maximum(np.abs(whole), setup.sizes)
        return self._courses.sign(
            replace(setup, values=values),
            (*roles, *self._roles),
            one.margin,
            whole,
            sizes,
            time,
            setup.precision,
        )


def _listed(mechanics: Mechanics, set_: dict[sp.Symbol, sp.Expr]) -> list[_Condition]:
    """Return the conditions of all contacts, with what controllers set."""
    found = []
    for place, (name, contact) in enumerate(mechanics.scene.contacts.items()):
        # Ends of edges, which stand last, belong to them.
        closed = [parse_relation(text).operator in ("<=", ">=") for text in contact.enabled]
        for k, margin in enumerate(mechanics.conditions(name)):
            satisfied = k >= len(closed) or closed[k]
            formula = margin.expression.xreplace(set_)
            found.append(_Condition(place, margin.name, formula, satisfied))
    return found


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


@seldom
def round_off(size: float, relative: float) -> float:
    """Return up to which amount a condition is zero whose terms are so large."""
    return max(relative * size, UNDERFLOW) if size < math.inf else UNDERFLOW


@seldom
def judge(value: float, rate: float, size: float, slow: float, relative: float) -> int:
    """Judge a condition by its margin and the first derivative of that.

    Parameters
    ----------
    value, rate : float
        Margin and first derivative.
    size, slow : float
        Sizes of their terms.
    relative : float
        What is so small in parts of its terms is zero.
    """
    band = round_off(size, relative)
    if value > band:
        return HOLDS
    if value < -band:
        return FAILS
    if abs(rate) > relative * slow:
        return HOLDS if rate > 0.0 else FAILS
    return UNSURE


@seldom
def conditions_at(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    sizes: Array,
    relative: float,
    state: Array,
    parameters: Array,
    time: float,
) -> Array:
    """Return the numbers (k, `PER_CONDITION`) of conditions in a state, flat; see `Conditions`.

    `sizes` (2 n + 1,) are those of the state and of time, which are known to `relative` of them.
    The sizes of terms are the larger ones of those in the state and beside it: at a multiple zero,
    as of ``x**3``, they vanish.
    """
    n, found, beside = state.shape[0], np.empty(outputs.shape[0]), np.empty(outputs.shape[0])
    both = np.empty(2 * n)
    for i in range(n):
        both[i], both[n + i] = state[i], max(abs(state[i]), sizes[i])
    tape_values(code, constants, outputs, both, parameters, time, found)
    moved = relative**_BESIDE
    for i in range(n):
        both[i] += moved * both[n + i]
    later = time + moved * max(abs(time), sizes[n])
    tape_values(code, constants, outputs, both, parameters, later, beside)
    for k in range(2, found.shape[0], PER_CONDITION):
        found[k] = max(found[k], beside[k])
        found[k + 1] = max(found[k + 1], beside[k + 1])
    return found
