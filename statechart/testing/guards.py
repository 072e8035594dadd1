"""Checks of guards, invariants and relations between events, independent of the run's search.

Margins are checked on a grid of multiples of the golden ratio. Relations are evaluated in floats:
they may disagree with the mode only within errors of the state, the evaluation, and the time of an
event.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import sympy as sp

from statechart.arrays import ROUND_OFF, Array, Bools
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import HELD, region_roles
from statechart.automaton.regions import Claim, Invariant, Margin, active_in, whole_margins
from statechart.automaton.trace import Arc, Jump, Key, Role, Trace, sizes
from statechart.execution.event_classification import STATE_ROUND_OFF, STATE_TOLERANCES
from statechart.formulas.condition import Active, And, InState, Or
from statechart.formulas.relation import Comparison, Negation, Term, conjunction, parse_relation
from statechart.observation.observer import Observer
from statechart.observation.outputs import extremes_along
from statechart.observation.sampling import instantaneous_modes
from statechart.testing.agreement import NUDGE
from statechart.testing.subject import Subject

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
"""The golden ratio, whose multiples modulo 1 are a low-discrepancy sequence."""
_PER_STEP = 9


def dense(trace: Trace) -> Iterator[tuple[Arc, Array]]:
    """Yield every arc with local times at multiples of the golden ratio in its steps.

    Parameters
    ----------
    trace : Trace
        A run.

    Yields
    ------
    (Arc, (m,) array)
        Arc, and times since its start.
    """
    for arc in trace.arcs:
        steps = np.diff(arc.times)
        places = (np.arange(1, _PER_STEP * len(steps) + 1) * GOLDEN) % 1.0
        places = np.sort(places.reshape(len(steps), _PER_STEP), axis=1)
        yield arc, (arc.times[:-1, None] + places * steps[:, None]).ravel()


def assert_margins(subject: Subject, trace: Trace) -> None:
    """Check that no margin is negative between events, on a grid of its own.

    Parameters
    ----------
    subject, trace : Subject, Trace
        The model, and a run of it.
    """
    variation = _variation(trace)
    for arc, tau in dense(trace):
        mode = subject.mode(trace, arc)
        if margins := whole_margins(mode.margins):
            _assert_margins(subject, trace, arc, tau, margins, variation)


def assert_invariants(subject: Subject, trace: Trace) -> None:
    """Check the declared invariants of the run and of active states, including extrema.

    For time stepping they hold up to the change of a variable in a step.

    Parameters
    ----------
    subject, trace : Subject, Trace
        The model, and a run of it.
    """
    observer = subject.observers[trace.engine.split()[0]]
    variation = _variation(trace)
    for arc, tau in dense(trace):
        margins = _invariants(subject, arc)
        if not margins:
            continue
        allowed = _assert_margins(subject, trace, arc, tau, margins, variation)
        found = extremes_along(observer, trace, arc, [margin.expression for margin in margins])
        for margin, less, least in zip(margins, allowed, found[:, 0].tolist(), strict=True):
            if least < -less:
                place = _span(subject.automaton, arc)
                raise AssertionError(f"{margin.name} falls to {least:.6g} {place}")
    automaton, flowed = subject.automaton, {arc.j for arc in trace.arcs}
    jumps = {jump.j: jump for jump in (*trace.jumps[:1], *instantaneous_modes(trace))}
    for invariant in automaton.invariants:
        for jump in jumps.values():
            for before in (True, False):
                margin = invariant.margin(automaton.active(jump.source if before else jump.target))
                lasts = (jump.j if before else jump.j + 1) in flowed
                # A mode of zero duration has no forces.
                if lasts or not observer.programs.needed((margin.expression,)):
                    _assert_at(observer, trace, jump, margin, before=before, lasts=lasts)
    if trace.step is None:
        assert_invariant_relations(subject, trace)


def _invariants(subject: Subject, arc: Arc) -> list[Margin]:
    """Return the margins of the invariants of a mode, without those decided by its states."""
    automaton = subject.automaton
    active = automaton.active(arc.mode)
    margins = [one.margin(active) for one in invariants_of(automaton, arc.mode)]
    for margin in margins:
        if margin.expression == -sp.oo:
            raise AssertionError(f"{margin.name} does not hold {_span(automaton, arc)}")
    return [margin for margin in margins if margin.expression != sp.oo]


def _span(automaton: Automaton, arc: Arc) -> str:
    begin, end = arc.start.high, arc.start.high + arc.duration
    return f"between t = {begin:.6g} and {end:.6g} in {automaton.label(arc.mode)}"


def _assert_at(
    observer: Observer, trace: Trace, jump: Jump, margin: Margin, *, before: bool, lasts: bool
) -> None:
    """Check an invariant at a jump, possibly in a mode of zero duration."""
    expression = margin.expression
    mode = observer.automaton.label(jump.source if before else jump.target)
    mode += "" if lasts else ", which lasts no time"
    place = f"at t = {jump.t:.6g} in {mode}"
    if expression == -sp.oo:
        raise AssertionError(f"{margin.name} does not hold {place}")
    if expression == sp.oo:
        return
    value = observer.at(trace, (expression,), [jump], before=before).item()
    allowed = trace.tolerances.get(margin.kind, 0.0)
    state = jump.before if before else jump.after
    for i, size in enumerate(np.maximum(np.abs(jump.before), np.abs(jump.after)).tolist()):
        changed = state.copy()
        changed[i] += max(trace.tolerance, ROUND_OFF) * size
        variation = replace(jump, before=changed, after=changed)
        allowed += abs(observer.at(trace, (expression,), [variation], before=before).item() - value)
    if value < -allowed:
        message = f"the margin of {margin.name!r} is {value:.6g} at t = {jump.t:.6g} in {mode}"
        raise AssertionError(message)


def _assert_margins(
    subject: Subject, trace: Trace, arc: Arc, tau: Array, margins: Sequence[Margin], by: Array
) -> Array:
    """Check margins at local times of an arc; return their tolerances (`by`: `_variation`)."""
    expressions = [margin.expression for margin in margins]
    states = arc.states(tau)
    values = subject.solved(trace, arc, tau, expressions)
    rounding = np.zeros(values.shape)
    for i, change in enumerate(by.tolist()):
        changed = states.copy()
        if trace.step is None:
            changed[:, i] *= 1.0 + NUDGE
            variation = subject.solved(trace, arc, tau, expressions, changed)
            moved = np.nan_to_num(np.abs(variation - values), nan=0.0)
            rounding += moved * (max(trace.tolerance, ROUND_OFF) / NUDGE)
        # A variable after a jump has the round-off of its value before.
        changed[:, i] = states[:, i] + change
        variation = subject.solved(trace, arc, tau, expressions, changed)
        rounding += np.nan_to_num(np.abs(variation - values), nan=0.0)
    allowed = rounding + [trace.tolerances.get(margin.kind, 0.0) for margin in margins]
    holds, known = values >= -allowed, arc.unknowns(tau)
    if known is not None:
        # Steps with an impulse have NaN forces.
        holds |= np.isnan(values) & np.isnan(known).any(axis=1, keepdims=True)
    if not holds.all():
        short = np.where(holds, np.inf, values + allowed)
        m, k = np.unravel_index(int(np.argmin(short)), values.shape)
        found = f"the margin of {margins[int(k)].name!r} is {values[m, k]:.6g}"
        raise AssertionError(f"{found} {_instant(subject.automaton, arc, tau[m])}")
    largest: Array = allowed.max(axis=0, initial=0.0)
    return largest


def _instant(automaton: Automaton, arc: Arc, tau: float) -> str:
    time = arc.start.high + (arc.start.low + tau)
    return f"at t = {time:.6g} in {automaton.label(arc.mode)}"


def _variation(trace: Trace) -> Array:
    """Return the uncertainty (n,) of variables: round-off, and the change in a time step."""
    steps = np.zeros(len(trace.variables))
    for arc in trace.arcs if trace.step is not None else ():
        moves = np.abs(np.diff(arc.states(arc.times), axis=0)).max(axis=0, initial=0.0)
        steps = np.maximum(steps, moves)
    return ROUND_OFF * sizes(trace) + steps


# Samples of an arc, at least, and of a run.
_UNIFORM, _FEWEST, _ALL = 256, 16, 100_000
# Samples at geometrically decreasing distances from the ends of an arc.
_HALVINGS = 36
# Relative error of the time of an event.
_TIME_ERROR = 2.0 * STATE_ROUND_OFF
# Relative error of a solved force or acceleration.
_SOLVED = 1e-9
# Expressions whose evaluation adds no round-off.
_WITHOUT_ROUND_OFF = (sp.Symbol, sp.Number, sp.Max, sp.Min, sp.Abs)


def truth(term: Term, sides: Iterator[tuple[Array, Array]], active: Active, count: int) -> Bools:
    """Return the truth of a relation in `count` states."""
    match term:
        case Comparison():
            return np.asarray(term.holds(*next(sides)))
        case InState():
            return np.full(count, active(term.region, term.state))
        case Negation():
            return ~truth(term.part, sides, active, count)
        case And() | Or():
            parts = [truth(part, sides, active, count) for part in term.parts]
            return np.asarray((np.all if isinstance(term, And) else np.any)(parts, axis=0))


def assert_relations(subject: Subject, trace: Trace) -> None:
    """Check that guards and stop conditions are false between events, and invariants true.

    Parameters
    ----------
    subject, trace : Subject, Trace
        The model, and a run of it.
    """
    _assert_claims(subject, trace, _claims)


def assert_invariant_relations(subject: Subject, trace: Trace) -> None:
    """Check that invariants of the run and of states are true."""

    def claims(subject: Subject, arc: Arc) -> Iterator[Claim]:
        invariants = invariants_of(subject.automaton, arc.mode)
        return (Claim(one.name, (one.text,), holds=True) for one in invariants)

    _assert_claims(subject, trace, claims)


def _assert_claims(
    subject: Subject, trace: Trace, claims: Callable[[Subject, Arc], Iterable[Claim]]
) -> None:
    judge = _ClaimChecker(subject, trace)
    for arc, tau in _grids(trace):
        for claim in claims(subject, arc):
            wrong = judge.unexplained(claim, arc, tau)
            if wrong.size:
                words = f"{claim.name} {'does not hold' if claim.holds else 'holds'}"
                place = _instant(subject.automaton, arc, wrong.item(0))
                raise AssertionError(f"{words} {place}: {' and '.join(claim.relations)}")


def _claims(subject: Subject, arc: Arc) -> Iterator[Claim]:
    states = zip(subject.automaton.regions, arc.mode, region_roles(arc.roles), strict=True)
    for region, state, role in states:
        if role.state != HELD:
            yield from region.claims(state)
    for name, text in subject.model.stop.conditions.items():
        yield Claim(name, (text,), holds=False)


def invariants_of(automaton: Automaton, mode: Key) -> list[Invariant]:
    """Return the invariants of the run and of the states of a mode."""
    states = zip(automaton.regions, mode, strict=True)
    own = [one for region, state in states for one in region.build(Role(state)).invariants]
    return [*own, *automaton.invariants]


def _grids(trace: Trace) -> Iterator[tuple[Arc, Array]]:
    """Yield every arc with local times, evenly spaced and graded towards both ends."""
    margin_of_time = _TIME_ERROR * trace.t_end
    count = int(np.clip(_ALL // max(len(trace.arcs), 1), _FEWEST, _UNIFORM))
    even = (np.arange(count) + 0.5) / count
    halved = 0.5 ** np.arange(1, min(count, _HALVINGS) + 1)
    places = np.unique(np.concatenate([even, halved, 1.0 - halved]))
    for arc in trace.arcs:
        tau = places * arc.duration
        yield arc, tau[(tau > margin_of_time) & (tau < arc.duration - margin_of_time)]


def _state_errors(trace: Trace) -> Array:
    """Return the errors (n,) of the variables; constants of flows with integer values are exact."""
    errors = max(STATE_TOLERANCES * trace.tolerance, STATE_ROUND_OFF) * sizes(trace)
    moves = np.zeros(len(errors), np.bool_)
    for arc in trace.arcs:
        moves |= (arc.coefficients[:, :, 1:] != 0.0).any(axis=(0, 2))
    arc_starts = np.array([trace.initial, *(jump.after for jump in trace.jumps)])
    whole = (arc_starts == np.round(arc_starts)).all(axis=0)
    exact: Bools = ~moves & (whole | (arc_starts == arc_starts[0]).all(axis=0))
    errors[exact] = 0.0
    return errors


class _ClaimChecker:
    """Evaluates claims along the arcs of a run."""

    def __init__(self, subject: Subject, trace: Trace) -> None:
        self._subject, self._trace = subject, trace
        self._errors, self._late = _state_errors(trace), _TIME_ERROR * trace.t_end
        self._compiled = cache(self._sides)

    def unexplained(self, claim: Claim, arc: Arc, tau: Array) -> Array:
        """Return the local times at which a claim is wrong beyond errors."""
        _, _, relative = self._compiled(claim)
        if relative == _SOLVED and any(role.captured for role in region_roles(arc.roles)):
            return tau[:0]  # A contact shown free at the end of its bounces has the force of rest.
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
        """Return whether a claim is wrong, at local times (m,) in states (m, n)."""
        term, expressions, relative = self._compiled(claim)
        count, regions = len(tau), self._subject.automaton.regions
        values = self._subject.solved(self._trace, arc, tau, expressions, states)
        sides = list(zip(values.T[::2], values.T[1::2], strict=True))
        held = truth(term, iter(sides), active_in(regions, arc.mode), count)
        near = np.zeros(count, np.bool_)
        if relative > 0.0:
            off = self._trace.tolerances.get("force", 0.0) if relative == _SOLVED else 0.0
            for left, right in sides:
                near |= np.abs(left - right) <= off + relative * (np.abs(left) + np.abs(right))
        return (held != claim.holds) & ~near

    def _sides(self, claim: Claim) -> tuple[Term, list[sp.Expr], float]:
        """Return the relation of a claim, its sides, and their relative error."""
        automaton = self._subject.automaton
        relation = parse_relation(conjunction(claim.relations))
        sides = [side.to_sympy(automaton.observables) for side in relation.formulas]
        used = set[sp.Basic]().union(*(side.free_symbols for side in sides))
        exact = {v for v, e in zip(automaton.variables, self._errors, strict=True) if e == 0.0}
        inexact = used & {automaton.time, *automaton.variables} - exact
        parts = (part for side in sides for part in sp.preorder_traversal(side))
        rounds = inexact and any(not isinstance(part, _WITHOUT_ROUND_OFF) for part in parts)
        relative = _SOLVED if used & {*automaton.unknowns} else ROUND_OFF if rounds else 0.0
        return relation.root, sides, relative
