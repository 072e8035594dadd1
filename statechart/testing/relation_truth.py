"""Truth of relations along a run, compared with the claims of its modes.

The margins of a run, their tolerances and what its search has found are not used: a relation is
evaluated in floats on a grid of the run's states. It may disagree with its mode only where an error
of the state, of its evaluation, or of an event's time explains that.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator

import numpy as np
import sympy as sp

from statechart.arrays import Array, Bools
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import HELD
from statechart.automaton.regions import Claim, Invariant, active_in
from statechart.automaton.trace import Arc, Key, Role, Trace, sizes
from statechart.execution.shallow_falls import STATE_ROUND_OFF, STATE_TOLERANCES
from statechart.formulas.condition import Active
from statechart.formulas.relation import (
    Comparison,
    Junction,
    Member,
    Negation,
    Term,
    conjunction,
    parse_relation,
)
from statechart.testing.subject import Subject

_COMPARISONS = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
    "==": operator.eq, "!=": operator.ne,
}  # fmt: skip
# Places between the ends of an arc, the fewest of them in runs of many arcs, and all of a run.
_UNIFORM, _FEWEST, _ALL = 256, 16, 100_000
# Distances to an end, each half of the one before, and as many places about every event.
_HALVINGS = 36
# An event may be late by this part of the run: some units in the last place of time.
_LATE = 2.0 * STATE_ROUND_OFF
# A solved force or acceleration is off by this part of it.
_SOLVED = 1e-9


def truth(term: Term, sides: Iterator[tuple[Array, Array]], active: Active, count: int) -> Bools:
    """Return where a relation is true, in `count` states."""
    match term:
        case Comparison():
            return np.asarray(_COMPARISONS[term.operator](*next(sides)))
        case Member():
            return np.full(count, active(term.region, term.state))
        case Negation():
            return ~truth(term.part, sides, active, count)
        case Junction():
            parts = [truth(part, sides, active, count) for part in term.parts]
            return np.asarray((np.all if term.word == "and" else np.any)(parts, axis=0))


def assert_relations(subject: Subject, trace: Trace) -> None:
    """Check that guards and stop conditions are false between events, and conditions true.

    Parameters
    ----------
    subject, trace : Subject, Trace
        The model, and a run of it.
    """
    _assert_claims(subject, trace, _claims)


def assert_invariant_relations(subject: Subject, trace: Trace) -> None:
    """Check that invariants, of the run and of states, are true."""

    def claims(subject: Subject, arc: Arc) -> Iterator[Claim]:
        invariants = invariants_of(subject.automaton, arc.mode)
        return (Claim(one.name, (one.text,), holds=True) for one in invariants)

    _assert_claims(subject, trace, claims)


def _assert_claims(
    subject: Subject, trace: Trace, claims: Callable[[Subject, Arc], Iterable[Claim]]
) -> None:
    judge = _Judge(subject, trace)
    for arc, tau in _grids(trace):
        for claim in claims(subject, arc):
            wrong = judge.unexplained(claim, arc, tau)
            if wrong.size:
                time = arc.start.high + (arc.start.low + wrong.item(0))
                raise AssertionError(
                    f"{claim.name} {'does not hold' if claim.holds else 'holds'} at t = "
                    f"{time:.6g} in {subject.automaton.label(arc.mode)}: "
                    f"{' and '.join(claim.relations)}"
                )


def _claims(subject: Subject, arc: Arc) -> Iterator[Claim]:
    for region, state, role in zip(subject.automaton.regions, arc.mode, arc.roles, strict=True):
        if role.state != HELD:
            yield from region.claims(state)
    for name, text in subject.model.stop.conditions.items():
        yield Claim(name, (text,), holds=False)


def invariants_of(automaton: Automaton, mode: Key) -> list[Invariant]:
    """Return the invariants of the states of a mode, and of the run."""
    states = zip(automaton.regions, mode, strict=True)
    own = [one for region, state in states for one in region.build(Role(state)).invariants]
    return [*own, *automaton.invariants]


def _grids(trace: Trace) -> Iterator[tuple[Arc, Array]]:
    """Yield every arc with local times: evenly spaced, and ever closer to both ends.

    None is as near to an end as an event may be late.
    """
    late = _LATE * trace.t_end
    count = int(np.clip(_ALL // max(len(trace.arcs), 1), _FEWEST, _UNIFORM))
    even = (np.arange(count) + 0.5) / count
    halved = 0.5 ** np.arange(1, min(count, _HALVINGS) + 1)
    places = np.unique(np.concatenate([even, halved, 1.0 - halved]))
    for arc in trace.arcs:
        tau = places * arc.duration
        yield arc, tau[(tau > late) & (tau < arc.duration - late)]


def _state_errors(trace: Trace) -> Array:
    """Return by how much each variable (n,) may be off.

    One that no flow changes is exact, unless jumps give it values that are not whole.
    """
    errors = max(STATE_TOLERANCES * trace.tolerance, STATE_ROUND_OFF) * sizes(trace)
    moves = np.zeros(len(errors), np.bool_)
    for arc in trace.arcs:
        moves |= (arc.coefficients[:, :, 1:] != 0.0).any(axis=(0, 2))
    begun = np.array([trace.initial, *(jump.after for jump in trace.jumps)])
    whole = (begun == np.round(begun)).all(axis=0)
    exact: Bools = ~moves & (whole | (begun == begun[0]).all(axis=0))
    errors[exact] = 0.0
    return errors


class _Judge:
    """Evaluates claims about the arcs of a run."""

    def __init__(self, subject: Subject, trace: Trace) -> None:
        self._subject, self._trace = subject, trace
        self._errors, self._late = _state_errors(trace), _LATE * trace.t_end
        self._sides: dict[Claim, tuple[Term, list[sp.Expr], bool]] = {}

    def unexplained(self, claim: Claim, arc: Arc, tau: Array) -> Array:
        """Return those of local times where a claim is wrong, and no error explains it."""
        states = arc.states(tau)
        tau = tau[self._wrong(claim, arc, tau, states)]
        for later in (-self._late, self._late):
            if tau.size:
                there = tau + later
                tau = tau[self._wrong(claim, arc, there, arc.states(there))]
        for i, error in enumerate(self._errors.tolist()):
            for sign in (-1.0, 1.0):
                if tau.size and error > 0.0:
                    states = arc.states(tau)
                    states[:, i] += sign * error
                    tau = tau[self._wrong(claim, arc, tau, states)]
        return tau

    def _wrong(self, claim: Claim, arc: Arc, tau: Array, states: Array) -> Bools:
        """Return where a claim is wrong, at local times (m,) in states (m, n)."""
        term, expressions, solved = self._compiled(claim)
        count, regions = len(tau), self._subject.automaton.regions
        values = self._subject.solved(self._trace, arc, tau, expressions, states)
        sides = list(zip(values.T[::2], values.T[1::2], strict=True))
        held = truth(term, iter(sides), active_in(regions, arc.mode), count)
        near = np.zeros(count, np.bool_)
        if solved:
            off = self._trace.tolerances.get("force", 0.0)
            for left, right in sides:
                near |= np.abs(left - right) <= off + _SOLVED * (np.abs(left) + np.abs(right))
        return (held != claim.holds) & ~near

    def _compiled(self, claim: Claim) -> tuple[Term, list[sp.Expr], bool]:
        """Return the relation of a claim, its sides, and whether a mode solves for them."""
        found = self._sides.get(claim)
        if found is None:
            automaton = self._subject.automaton
            relation = parse_relation(conjunction(claim.relations))
            sides = [side.to_sympy(automaton.observables) for side in relation.formulas]
            solved = any(side.free_symbols & {*automaton.unknowns} for side in sides)
            found = self._sides[claim] = relation.root, sides, solved
        return found
