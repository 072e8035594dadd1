"""Truth values of transition guards and stop conditions in time steps.

A guard fires at the start if it is true there. It fires at the end of a step in which it becomes
true and still is, or at which it is true and not about to become false by itself. A quantity that
stays on its boundary for a step, as the slip of a sticking contact does, is zero up to round-off:
`<=` and `>=` hold, `<` and `>` do not.

Within a step cubics (Hermite) interpolate the margins; lines do where a rate is unknown. In steps
with impacts, margins are continued from both ends, as the impact may be anywhere. A warning names a
guard that is true within a step, at neither end.

An atom whose margin falls before an impact or transition and rises after it is false in that step
and until it is back at its bound: it is beyond by an error of the step at most. A strict atom is so
also while its margin stays. A warning says so. An atom that falls to its bound as an open contact
touches waits for the impact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np

from contacts.dynamics.controllers import ControlGuards
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.states import FREE, STATES
from contacts.time_stepping.chunk import Chunk, SteppedSystem
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.regions import Region
from statechart.automaton.trace import Key

AT_END = 1e-6
"""Part of a step within which a guard counts as true at its end: times are rounded."""

# Part of a step by which a margin may reach its bound before a contact touches, and still count as
# reversed there: lines through gaps and margins find both instants.
_AT_TOUCH = 0.1
# Part of a step by which margins are continued beyond a touch, which lines through gaps find.
_REACH = 0.05
# Steps that are taken to find forces after an impact: a landing hides them for up to five steps.
_LANDING = 8


@dataclass(eq=False)
class StepEnd:
    """An instant between steps: the start, or the end of a step, also after transitions there.

    `size` is the number of coordinates, `codes` (r,) are the modes, `last` the steps before. The
    unknowns `own` (u,) are those of the state if it is `fresh`; after jumps the next step is solved
    for them when they are read.
    """

    system: SteppedSystem
    size: int
    time: float
    h: float
    state: Array
    codes: Ints
    own: Array
    last: Chunk | None
    fresh: bool = True
    after_transitions: bool = False

    def after(self, state: Array) -> StepEnd:
        """Return this instant after a transition to a state."""
        return replace(self, state=state, fresh=False, after_transitions=True)

    @cached_property
    def next_step(self) -> Chunk | None:
        """The next step, reverted; None if it cannot be taken."""
        return self.system.next_steps(self.time, self.h, self.state, 1)

    @cached_property
    def solved(self) -> Array:
        """Unknowns (u,) of the state, NaN where they are not known."""
        if self.fresh:
            return self.own
        step = self.next_step
        return np.full_like(self.own, np.nan) if step is None else step.solved[0]

    @cached_property
    def relayed(self) -> Array:
        """`solved` without accelerations that transitions have reversed.

        Guards on their bounds wait for the next step: those of an ideal relay would never end.
        """
        known, n = self.solved.copy(), self.size
        if self.after_transitions:
            known[:n][self.own[:n] * known[:n] < 0.0] = np.nan
        return known

    @cached_property
    def settled(self) -> Array:
        """`relayed`, after an impact with the forces of the first step that knows them."""
        known, unknown = self.relayed.copy(), np.isnan(self.solved)
        if unknown.any():
            steps = self.system.next_steps(self.time, self.h, self.state, _LANDING)
            for row in () if steps is None else steps.solved:
                known[unknown] = np.where(np.isnan(known), row, known)[unknown]
        return known


def reversed_warning(name: str, time: float, h: float) -> str:
    """Return the warning of a guard that another event of the same step reverses."""
    return (
        f"{name} reaches its boundary within the step of {h:g} to t = {time:.6g}, where another "
        "event reverses it, and does not fire; a shorter step shows if it does before"
    )


def passed_warning(name: str, time: float, h: float) -> str:
    """Return the warning of a guard that is true within the step from `time` only."""
    return (
        f"{name} is true within the step of {h:g} at t = {time:.6g}, at neither end: steps pass "
        "over it; use a shorter step, or for a single instant one comparison by <= or >="
    )


class ActiveStates:
    """Active states of regions, by mode codes of steps and controller states."""

    def __init__(self, regions: Sequence[Region]) -> None:
        self._places = {region.name: (place, region) for place, region in enumerate(regions)}

    def at(self, codes: Ints, controls: Key) -> Callable[[str, str], Bools]:
        """Return a test of the rows (m,) in which a region is in a state."""

        def active(name: str, state: str) -> Bools:
            place, region = self._places[name]
            if place >= codes.shape[1]:
                now = state in region.active(controls[place - codes.shape[1]])
                return np.full(len(codes), now)
            table = [state in region.active(other) for _, other in sorted(STATES.items())]
            return np.array(table)[codes[:, place]]

        return active

    def of(self, mode: Key) -> Callable[[str, str], bool]:
        """Return a test whether a region is in a state, in this mode of all regions."""

        def active(name: str, state: str) -> bool:
            place, region = self._places[name]
            return state in region.active(mode[place])

        return active


class _Ends(NamedTuple):
    """Atoms (m, a) at the ends of steps."""

    margins: Array
    rates: Array
    zero: Array  # Round-off of the margins.
    true: Bools
    due: Bools  # True, and not about to become false within a step.
    near: Bools  # At zero within round-off; not of atoms of time alone.


class StepTruths:
    """Guards in consecutive steps, in given states of controllers."""

    def __init__(
        self,
        mechanics: Mechanics,
        setup: SceneSetup,
        regions: ActiveStates,
        guards: ControlGuards,
        states: Key,
        before: StepTruths | None = None,
    ) -> None:
        self._setup, self._regions = setup, regions
        # Places of the unknowns of guards among those of steps.
        places = {symbol: i for i, symbol in enumerate(mechanics.solved)}
        self.order = [places[symbol] for symbol in guards.unknowns]
        self.enter(guards, states)
        count = len(guards.watch.margins)
        # Atoms at the end of the last step, and those at zero there and a step before.
        self._last, self._zero = np.zeros((1, count), np.bool_), np.zeros((2, count), np.bool_)
        self._start, self._rate = np.full((2, 1, count), np.nan)
        self._gaps = np.full(1, np.nan)  # At the last midpoint.
        # Atoms that impacts or transitions have reversed, while they rise or, if strict, stay, and
        # those that wait for an impact in the next step.
        self._back, self._wait = np.zeros((2, 1, count), np.bool_)
        # Steps whose forces are unknown: their true atoms, unknown atoms, and modes.
        self._hidden = np.zeros((0, 1), np.int64)
        self.passed = dict[str, str]()  # Guard -> warning at the last instant.
        if before is not None:
            self._remember(before)

    def _remember(self, before: StepTruths) -> None:
        """Continue with what is known of the guards that other states of controllers watch, too."""
        firsts = {(g.place, g.trigger): first for g, _, first in before._watch.placed}
        atoms = [
            (first + k, firsts[g.place, g.trigger] + k)
            for g, condition, first in self._watch.placed
            if (g.place, g.trigger) in firsts
            for k in range(len(condition.atoms))
        ]
        here, there = np.array(atoms, np.int64).reshape(-1, 2).T
        self._zero[:, here], self._back[:, here] = before._zero[:, there], before._back[:, there]
        self._start[:, here], self._wait[:, here] = before._start[:, there], before._wait[:, there]
        self._gaps, self.passed = before._gaps, before.passed
        if len(before._hidden):
            new, old = self._back.shape[1], before._back.shape[1]
            true, unknown, codes = np.split(before._hidden, [old, 2 * old], axis=1)
            self._hidden = np.zeros((len(true), 2 * new + codes.shape[1]), np.int64)
            self._hidden[:, 2 * new :] = codes
            self._hidden[:, here], self._hidden[:, new + here] = true[:, there], unknown[:, there]

    def enter(self, guards: ControlGuards, states: Key) -> None:
        """Continue with the same guards in other states of controllers."""
        self._controlled, self._watch, self._states = guards, guards.watch, states

    def change(self, setup: SceneSetup, time: float, state: Array, h: float) -> None:
        """Continue with other values of parameters.

        An atom that an impact has reversed stays false, unless its bound moves farther than the
        margin rises in a step.
        """
        self._setup = setup
        at = np.array([time]), state[None], np.full((1, 1 + max(self.order, default=0)), np.nan)
        margins, rates = (self.table(*at, order)[..., 0] for order in (0, 1))
        self._back = self._back & (margins >= self._start - h * rates)
        self._start = np.where(np.isnan(margins), self._start, margins)

    def table(self, times: Array, states: Array, solved: Array, order: int = 0) -> Array:
        """Return margins, or time derivatives, and sizes of terms (m, a, 2) for m instants."""
        unknowns = solved[:, self.order]
        return self._controlled.table(self._setup, times, states, unknowns, order=order)

    def active(self, codes: Ints) -> Callable[[str, str], Bools]:
        """Return `ActiveStates.at` in the present states of controllers."""
        return self._regions.at(codes, self._states)

    def at(self, end: StepEnd, *, relay: bool = False) -> tuple[Bools, Bools]:
        """Return the guards (g,) that are due at an instant, and those that are true.

        Atoms that become false within a step make no guard due. Forces are solved for only where
        guards may read them; `relay`: see `StepEnd.relayed`.
        """
        solved = end.own
        if not end.fresh and self._read_unknowns(end):
            solved = end.relayed if relay else end.solved
        ends = self._ends(
            np.array([end.time]), end.state[None], solved[None], end.h, self._zero[:1]
        )
        back = ends.true & self._back
        early = ends.margins - end.h * ends.rates < -ends.zero
        if end.after_transitions and end.last is not None and (ends.true | early).any():
            back |= ends.true & self._before_transitions(end, end.last, ends)
        if back.any():
            # With accelerations that have reversed, too.
            rates = self.table(np.array([end.time]), end.state[None], end.solved[None], 1)[..., 0]
            back &= self._returns(end.h * rates, ends.zero)
        # No transition has moved these.
        self._wait = self._wait & (np.abs(ends.margins - self._start) <= ends.zero)
        back |= ends.true & self._wait
        true = ends.true & ~back
        self._last, self._start, self._rate = true, ends.margins, ends.rates
        self._zero[1:] = ends.near
        self._back = back & ~self._wait
        if end.last is not None:
            self._gaps = end.last.gaps[-1]
        unknown = np.isnan(ends.margins)
        if unknown.any():
            rows = np.hstack([true, unknown, end.codes[None]])
            self._hidden = np.vstack([self._hidden.reshape(-1, rows.shape[1]), rows])
        due, now = self._guards(np.vstack([ends.due & ~back, true]), np.tile(end.codes, (2, 1)))
        return due, now

    def _read_unknowns(self, end: StepEnd) -> bool:
        """Return whether accelerations or forces may decide a guard at an instant.

        They do so where a margin depends on them, or is not above zero and its rate depends on
        them, or is at zero: its second derivative does.
        """
        at = np.array([end.time]), end.state[None], np.full((1, len(end.own)), np.nan)
        margins, sizes = np.moveaxis(self.table(*at), -1, 0)
        rates, least = self.table(*at, 1)[..., 0], self._setup.rounded * sizes
        decided = (margins > least) | ((margins < -least) & np.isfinite(rates))
        return not bool(decided.all())

    def _before_transitions(self, end: StepEnd, last: Chunk, ends: _Ends) -> Bools:
        """Return the atoms (1, a) that fell to their bound in the step before transitions.

        In a step with an impact these fell before it; atoms that jump at the impact do not fall.
        Warns of guards that are true if atoms jump within the step, where others become true.
        """
        times, solved = end.time - last.h * np.array([1, 0]), np.tile(last.solved[-1], (2, 1))
        (first, now), (fall, _) = (
            self.table(times, last.states[-2:], solved, order)[..., 0] for order in (0, 1)
        )
        # An impact hides when margins reach their bounds, but for those of time alone.
        struck = last.struck[-1].any()
        known = self._watch.scheduled | ~struck
        # Part of the step that may follow the jump: all of it, if no margin falls to its bound.
        reach = (first >= 0.0) & (now + AT_END * last.h * fall < 0.0) & known
        crossed = first[reach] / (first - now)[reach]
        rest = max(1.0 - _REACH - crossed.min(), 0.0) if crossed.size else 1.0
        part = np.where(known, rest, 1.0)
        early = ends.margins - part * last.h * ends.rates < -ends.zero
        jumps = early & (np.abs(ends.margins - now) > ends.zero)
        rows, codes = np.vstack([now < 0.0, ends.true, ends.true | jumps]), end.codes[None]
        before, after, within = self._guards(rows, np.tile(codes, (3, 1)))
        for i in np.flatnonzero(within & ~after & ~before).tolist():
            name = self._watch.guards[i].name
            self.passed.setdefault(name, passed_warning(name, float(times[0]), last.h))
        # A contact may have touched up to half a step before this one.
        falls: Bools = (first >= last.h * fall * struck) & (fall < 0.0)
        return falls & (ends.margins - first >= 2.0 * last.h * fall)

    def true_at(self, time: float, state: Array, solved: Array, h: float, codes: Ints) -> Bools:
        """Return the guards (g,) that are true at an instant of the steps that `take` had last."""
        ends = self._ends(np.array([time]), state[None], solved[None], h, self._zero[:1])
        [true] = self._guards(ends.true, codes[None])
        return true

    def take(self, chunk: Chunk, start: float, codes: Ints) -> tuple[Bools, Bools]:
        """Return the guards (m, g) that are due at the ends of steps, and those that become true.

        Both fire. The regions have modes `codes` (m + 1, r) at the start and the ends.
        """
        self._at = ends = self._ends(
            chunk.ends(start), chunk.states[1:], chunk.solved, chunk.h, self._zero[1:]
        )
        self._codes, self._waits = codes[1:], self._wait_for_impacts(chunk)
        self._fall = chunk.h * np.vstack([self._rate, ends.rates])[:-1]
        true = np.vstack([self._last, ends.true & ~self._waits])
        struck = np.any(chunk.struck, axis=1, keepdims=True)
        returns = self._returns(chunk.h * ends.rates, ends.zero)
        falls = (self._fall < 0.0) & ~true[:-1]
        # Rates explain no jump of a margin at an impact.
        falls &= ends.margins - np.vstack([self._start, ends.margins])[:-1] >= 2.0 * self._fall
        self._reversed = struck & falls & returns
        # Reversed atoms stay false while their margins are beyond the bound and return.
        steps = np.arange(1, len(struck) + 1)[:, None]
        hit = np.vstack([np.where(self._back, 0, -1), np.where(self._reversed, steps, -1)])
        free = np.vstack([np.full_like(hit[:1], -1), np.where(true[1:] & returns, -1, steps)])
        self._backs = np.maximum.accumulate(hit)[1:] > np.maximum.accumulate(free)[1:]
        true[1:] &= ~self._backs
        self._all = true
        holds = self._guards(true, codes)
        return self._guards(ends.due & true[1:], self._codes), holds[1:] & ~holds[:-1]

    def _returns(self, changes: Array, zero: Array) -> Bools:
        """Return the atoms (m, a) whose margins rise; at a strict bound also those that stay."""
        returns: Bools = changes > np.where(self._watch.closed, zero, -zero)
        return returns

    def _wait_for_impacts(self, chunk: Chunk) -> Bools:
        """Return the atoms (m, a) that fall to their bound in a step as an open contact touches.

        It is struck in the next step: in this one the midpoint comes before. So atoms that the
        impact does not reverse become true a step late; those of time alone do not wait.
        """
        margins = np.vstack([self._start, self._at.margins])
        falls = (margins[:-1] >= 0.0) & self._at.true & (margins[1:] < margins[:-1])
        falls &= ~self._watch.scheduled
        if falls.any():
            touch = self._touches(chunk)
            with np.errstate(invalid="ignore", divide="ignore"):
                crossed = margins[:-1] / (margins[:-1] - margins[1:])
            touches = (
                (touch > 0.5) & (touch < 1.0 + _AT_TOUCH) & (chunk.modes == FREE) & ~chunk.struck
            )
            first = np.where(touches, touch, np.inf).min(axis=1, initial=np.inf)[:, None]
            falls &= crossed > first - _AT_TOUCH
        return falls

    def _touches(self, chunk: Chunk) -> Array:
        """Return the parts (m, r) of steps after which contacts touch, by lines through gaps."""
        gaps = np.vstack([np.broadcast_to(self._gaps, chunk.gaps[:1].shape), chunk.gaps])
        with np.errstate(invalid="ignore", divide="ignore"):
            touch: Array = 0.5 + gaps[1:] / (gaps[:-1] - gaps[1:])
        return touch

    def undefined(self, chunk: Chunk) -> tuple[int, str] | None:
        """Return the first step at whose end a guard has no value, and its name.

        Forces of steps with impacts are NaN, and so are margins on them. A guard of several atoms
        is undefined if all are.
        """
        unknown: Bools = np.isnan(self._at.margins[: len(chunk.codes)])
        if not unknown.any():
            return None
        known = np.isfinite(np.hstack([chunk.states[1:], chunk.solved]))
        unknown &= np.all(known, axis=1, keepdims=True)
        # Guards without atoms ask for states alone.
        parts = [
            unknown[:, first : first + len(condition.atoms)].all(axis=1) & bool(condition.atoms)
            for _, condition, first in self._watch.placed
        ]
        lost = np.argwhere(np.stack(parts, axis=1)).tolist()
        return (lost[0][0], self._watch.guards[lost[0][1]].name) if lost else None

    def accept(self, chunk: Chunk, start: float, end: float) -> dict[str, str]:
        """Continue after these steps, the first of those that `take` had last.

        Returns guard -> warning that it is true within a step only, until the run is at `end`,
        before its forces are known, or until an impact reverses it.
        """
        count = len(chunk.codes)
        found, self.passed = self.passed, {}
        if not count:
            return found
        found |= self._within(chunk, start, end)
        atoms, unknown = self._all[1 : count + 1], np.isnan(self._at.margins[:count])
        if unknown.any() or len(self._hidden):
            found = self._before_forces(chunk, start, atoms, unknown) | found
        self._zero = np.vstack([self._zero[1:], self._at.near[:count]])[-2:]
        self._last, self._start = atoms[-1:], self._at.margins[count - 1 : count]
        self._rate, self._back = self._at.rates[count - 1 : count], self._backs[count - 1 : count]
        self._gaps, self._wait = chunk.gaps[-1], self._waits[count - 1 : count]
        return found

    def _before_forces(
        self, chunk: Chunk, start: float, atoms: Bools, unknown: Bools
    ) -> dict[str, str]:
        """Return guard -> warning that it is true in steps whose forces are unknown.

        The forces of the first step after them stand for theirs.
        """
        early, count = len(self._hidden), len(atoms)
        rows = np.hstack([atoms, unknown, self._codes[:count]])
        rows = np.vstack([self._hidden.reshape(-1, rows.shape[1]), rows])
        atoms, unknown, codes = np.split(rows, [atoms.shape[1], 2 * atoms.shape[1]], axis=1)
        atoms, unknown = atoms.astype(np.bool_), unknown.astype(np.bool_)
        places = np.where(unknown.any(axis=1), len(rows), np.arange(len(rows)))
        first = np.minimum.accumulate(places[::-1])[::-1]  # Step with forces.
        self._hidden = np.unique(rows[first == len(rows)], axis=0)
        now = np.minimum(first, len(rows) - 1)
        true = self._guards(atoms, codes)
        hidden = self._guards(np.where(unknown, atoms[now], atoms), codes) & ~true & ~true[now]
        return {
            self._watch.guards[i].name: f"{self._watch.guards[i].name} is true before t = "
            f"{start + (now[k] - early + 1) * chunk.h:.6g}, in steps of {chunk.h:g} whose "
            "forces are unknown; use a shorter step"
            for k, i in np.argwhere(hidden & (first < len(rows))[:, None])[::-1].tolist()
        }

    def _ends(self, times: Array, states: Array, solved: Array, h: float, zero: Bools) -> _Ends:
        """Return the atoms at the ends of steps; `zero` (1, a) were at zero a step before."""
        margin, size = np.moveaxis(self.table(times, states, solved, 0), -1, 0)
        rate = self.table(times, states, solved, 1)[..., 0]
        passing = (rate > 0.0) & (margin + h * rate >= 0.0)
        falling = np.minimum(np.nan_to_num(rate, neginf=0.0), 0.0)
        true: Bools = margin + AT_END * h * falling < 0.0
        # A margin that has just come to zero was braked, and need not cross: a strict guard waits
        # until it leaves zero. Times do cross, constants do not.
        least = self._setup.rounded * size
        near = (~self._watch.scheduled | (rate == 0.0)) & (np.abs(margin) <= least)
        rises: Bools = h * rate > least
        if near.any():
            second = self.table(times, states, solved, 2)[..., 0]
            rises |= (h * rate >= -least) & (h * h * second > least)
        # The rates of forces are unknown: they stay if they were zero a step ago.
        stays = np.isfinite(rate) | np.vstack([zero, near[:-1]])
        true = np.where(near, self._watch.closed & stays & ~rises, true)
        return _Ends(margin, rate, least, true, true & (near | ~passing), near)

    def _guards(self, atoms: Bools, codes: Ints) -> Bools:
        """Return the guards (m, g) that are true, from their atoms (m, a) and modes (m, r)."""
        return self._watch.truths(atoms, self.active(codes))

    def _within(self, chunk: Chunk, start: float, end: float) -> dict[str, str]:
        """Return guard -> warning that it is true within a step, at neither end.

        Cubics interpolate the margins; lines do where a rate is unknown. In steps with impacts,
        margins are continued from both ends to the instant at which gaps say that contacts touch;
        where they do not say, over the whole step.
        """
        h, count, found = chunk.h, len(chunk.codes), dict[str, str]()
        b, d = self._at.margins[:count], h * self._at.rates[:count]
        a, c, zero = np.vstack([self._start, b])[:-1], self._fall[:count], self._at.zero[:count]
        first, last, codes = self._all[:count], self._all[1 : count + 1], self._codes[:count]
        near = self._at.near[:count]
        trusted = ~np.vstack([self._back, self._backs])[:count]  # Not beyond a bound by an error.
        before, after = (a + c < -zero) & trusted, (b - d < -zero) & trusted & ~near
        ends = self._guards(first, codes) | self._guards(last, codes)
        perhaps = self._guards(first | before | last | after, codes) & ~ends
        for k in np.flatnonzero(perhaps.any(axis=1)).tolist():
            struck = chunk.struck[k]
            if struck.any():
                touch = self._touches(chunk)[k, struck]
                touch = touch if (np.abs(touch) < 1.0).all() else np.array([_REACH, 1.0 - _REACH])
                until, since = touch.max() + _REACH, touch.min() - _REACH
                early = self._inside(_line(a[k], c[k], min(0.0, touch.min()), until), k, 1.0)
                late = self._inside(_line(b[k], d[k], since - 1.0, 0.0), k, 1.0) & ~near[k]
                rows = np.vstack([early & trusted[k], late & trusted[k] | near[k] & last[k]])
            else:
                lines = np.where(np.isnan(c[k] + d[k]), b[k] - a[k], np.stack([c[k], d[k]]))
                rows = self._inside(np.array([a[k], b[k], *lines]), k, (end - start) / h - k)
                rows &= ~self._waits[k] & ~self._backs[k]
            kinds = np.vstack([rows, rows & ~self._reversed[k]])
            true = self._guards(kinds, np.tile(codes[k], (len(kinds), 1)))
            for i in np.flatnonzero(true.any(axis=0) & ~ends[k]).tolist():
                name, time = self._watch.guards[i].name, start + k * h
                passes = passed_warning(name, time, h), reversed_warning(name, time + h, h)
                found.setdefault(name, passes[not true[len(rows) :, i].any()])
        return found

    def _inside(self, ends: Array, k: int, until: float) -> Bools:
        """Return the atoms (m, a) at and between the crossings in a step, until a part of it.

        `ends` (4, a): margins at the start and end, changes in a step by the rates there.
        """
        a, b, c, d = ends
        cubics = np.array([2.0 * (a - b) + c + d, 3.0 * (b - a) - 2.0 * c - d, c, a])
        roots = [np.roots(cubic) for cubic in cubics.T if np.isfinite(cubic).all()]
        real = np.array([x.real for x in chain(*roots) if x.imag == 0.0])
        crossings = real[(real > AT_END) & (real < 1.0 - AT_END)]
        shares = np.sort(np.append(crossings, [0.0, 1.0]))
        shares = np.hstack([crossings, 1.0, 0.5 * (shares[:-1] + shares[1:])])
        shares = shares[shares <= until + AT_END]
        at = np.array([np.polyval(cubics, share) for share in shares]).reshape(-1, len(a))
        # Atoms that cross zero at the same instant may hold there alone.
        first, last = self._all[k : k + 2]
        on_zero = np.where(first != last, self._watch.closed, last)
        inside: Bools = np.where(np.abs(at) <= self._at.zero[k], on_zero, at < 0.0)
        return inside


def _line(margins: Array, changes: Array, start: float, end: float) -> Array:
    """Return the margins (4, a) at two parts of a step and their change between, as a cubic."""
    changes = np.nan_to_num(changes)
    first, last = margins + start * changes, margins + end * changes
    return np.array([first, last, last - first, last - first])
