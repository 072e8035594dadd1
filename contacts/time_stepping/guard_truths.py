"""Truth values of transition guards and stop conditions in time steps.

A guard fires at the start if it is true there. It fires at the end of a step in which it becomes
true and still is, or at which it is true and not about to become false by itself. A quantity that
stays on its boundary for a step, as the slip of a sticking contact does, is zero up to round-off:
`<=` and `>=` hold, `<` and `>` do not.

Within a step cubics (Hermite) interpolate the margins. In steps with impacts, and where a rate is
unknown, lines do. A warning names a guard that is true within a step, at neither end.

An impact or transition that reverses a margin at its bound may leave it beyond, by the order of the
step. The atom is false while the margin rises back. An atom that falls to its bound as an open
contact touches waits for the impact. An atom that jumps at an impact has the truth value of one end
of the step or of the other.
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
# Part of the fall in a step by which a margin is beyond its bound at the touch at least, if it is
# true before: below it is at the bound up to the curvature of the motion.
_TOUCHED = 0.01
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
        f"{name} becomes true within the step of {h:g} to t = {time:.6g}, where another event "
        "reverses it, and does not fire; a shorter step shows if it does before"
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
    ) -> None:
        self._setup, self._regions, self._n = setup, regions, len(mechanics.q)
        # Places of the unknowns of guards among those of steps.
        places = {symbol: i for i, symbol in enumerate(mechanics.solved)}
        self.order = [places[symbol] for symbol in guards.unknowns]
        self.enter(guards, states)
        count = len(guards.watch.margins)
        # Atoms at the end of the last step, and those at zero there and a step before.
        self._last, self._zero = np.zeros((1, count), np.bool_), np.zeros((2, count), np.bool_)
        self._start = np.full((1, count), np.nan)
        self._gaps = np.full(1, np.nan)  # At the last midpoint.
        # Atoms that impacts or transitions have reversed, while they rise.
        self._back = np.zeros((1, count), np.bool_)
        # In the last steps that do not know forces: atoms on these, other atoms that were true, and
        # guards that were true but for the first.
        self._forced, self._known = np.zeros((2, count), np.bool_)
        self._hidden = np.zeros(len(self._watch.guards), np.bool_)

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
        self._back = self._back & (margins > self._start - h * rates)
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
        if end.after_transitions and ends.true.any():
            back |= ends.true & self._falls(end)
        if back.any():
            # With accelerations that have reversed, too.
            rates = self.table(np.array([end.time]), end.state[None], end.solved[None], 1)[..., 0]
            back &= end.h * rates > ends.zero
        true = ends.true & ~back
        self._last, self._start, self._zero[1:] = true, ends.margins, ends.near
        self._back = back
        if end.last is not None:
            self._gaps = end.last.gaps[-1]
        unknown = np.isnan(ends.margins)
        rows = np.vstack([ends.due & ~back, true, true | unknown])
        due, true_now, possible = self._guards(rows, np.tile(end.codes, (3, 1)))
        self._hidden |= possible & ~true_now
        self._forced |= unknown[0]
        self._known |= true[0] & unknown.any()
        return due, true_now

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

    def _falls(self, end: StepEnd) -> Bools:
        """Return the atoms (1, a) that fell to their bound in the step before transitions.

        In a step with an impact these fell before it; atoms that jump at the impact do not fall.
        """
        last = end.last
        if last is None:
            return np.zeros_like(self._back)
        times, states = end.time - last.h * np.array([1, 0]), last.states[-2:]
        solved = np.tile(last.solved[-1], (2, 1))
        (first, now), (fall, rate) = (self.table(times, states, solved, o)[..., 0] for o in (0, 1))
        if last.struck[-1].any():
            # The contact may have touched up to half a step before this one.
            first, rate = first - last.h * fall, fall
        falls: Bools = (first >= 0.0) & (now < 0.0) & (rate < 0.0)
        return falls[None]

    def true_at(self, time: float, state: Array, solved: Array, h: float, codes: Ints) -> Bools:
        """Return the guards (g,) that are true at an instant of the steps that `take` had last."""
        ends = self._ends(np.array([time]), state[None], solved[None], h, self._zero[:1])
        [true] = self._guards(ends.true, codes[None])
        return true

    def take(self, chunk: Chunk, start: float, codes: Ints) -> tuple[Bools, Bools]:
        """Return the guards (m, g) that are due at the ends of steps, and those that become true.

        Both fire. The regions have modes `codes` (m + 1, r) at the start and the ends.
        """
        ends = self._ends(
            chunk.ends(start), chunk.states[1:], chunk.solved, chunk.h, self._zero[1:]
        )
        self._at, self._codes = ends, codes[1:]
        self._reversed, self._jumped, self._dips = np.zeros((3, *ends.true.shape), np.bool_)
        # Steps with impacts -> the part of the step at which contacts touch, and the margins then.
        self._touched = dict[int, tuple[float, Array]]()
        self._backs = np.zeros_like(self._reversed)
        waits = self._wait_for_impacts(chunk)
        if chunk.struck.any():
            self._classify_at_impacts(chunk, start)
        self._all = np.vstack([self._last, ends.true & ~waits])
        hit = np.flatnonzero(self._reversed.any(axis=1)).tolist() if self._touched else []
        back, done = self._back[0], 0
        for first in [0, *hit] if back.any() else hit:
            for k in range(max(first, done), len(ends.true)):
                back = (back | (self._reversed[k] & ~self._all[k])) & self._all[k + 1]
                back &= chunk.h * ends.rates[k] > ends.zero[k]
                done = k + 1
                if not back.any():
                    break
                self._backs[k] = back
                self._all[k + 1] &= ~back
        was = self._guards(self._all, codes)
        due = self._guards(ends.due & self._all[1:], self._codes)
        return due, was[1:] & ~was[:-1]

    def _wait_for_impacts(self, chunk: Chunk) -> Bools:
        """Return the atoms (m, a) that fall to their bound in a step as an open contact touches.

        It is struck in the next step: in this one the midpoint comes before.
        """
        margins = np.vstack([self._start, self._at.margins])
        falls: Bools = (margins[:-1] >= 0.0) & (margins[1:] < 0.0)
        if falls.any():
            touch = self._touches(chunk)
            touches = (touch > 0.5) & (touch < 1.0) & (chunk.modes == FREE) & ~chunk.struck
            first = np.where(touches, touch, np.inf).min(axis=1, initial=np.inf)[:, None]
            with np.errstate(invalid="ignore", divide="ignore"):
                crossed = margins[:-1] / (margins[:-1] - margins[1:])
            falls &= crossed > first - _AT_TOUCH
        return falls

    def _touches(self, chunk: Chunk) -> Array:
        """Return where gaps (m, r) become zero, in steps from the start of each step."""
        gaps = np.vstack([np.broadcast_to(self._gaps, chunk.gaps[:1].shape), chunk.gaps])
        with np.errstate(invalid="ignore", divide="ignore"):
            touches: Array = 0.5 + gaps[1:] / (gaps[:-1] - gaps[1:])
        return touches

    def _classify_at_impacts(self, chunk: Chunk, start: float) -> None:
        """Find the atoms that impacts reverse at or beyond their bounds, and those that jump."""
        hit = np.flatnonzero(chunk.struck.any(axis=1))
        sides, h = chunk.states[[hit, hit, hit + 1]], chunk.h
        delay = np.tile(0.5 * h + chunk.impact_delay[hit], (3, 1))
        touch = h * self._touches(chunk)[hit]
        touch = np.where(chunk.struck[hit] & np.isfinite(touch), touch, np.inf).min(axis=1)
        delay[0] = np.where(np.isfinite(touch), touch, delay[0])
        sides[:, :, : self._n] = sides[1, :, : self._n]
        sides[:, :, : self._n] += delay[..., None] * sides[1, :, self._n : 2 * self._n]
        at = (start + hit * h + delay).ravel(), np.vstack([*sides])
        solved = np.tile(chunk.solved[hit], (3, 1))
        (touched, left, right), (_, fall, rise) = (
            np.split(self.table(*at, solved, order)[..., 0], 3) for order in (0, 1)
        )
        reverses = (fall < 0.0) & (rise > 0.0)
        known = np.isfinite(touch)[:, None]
        self._dips[hit] = reverses & known & (touched < _TOUCHED * h * fall)
        self._reversed[hit] = reverses & ~self._dips[hit]
        self._jumped[hit] = (left < 0.0) != (right < 0.0)
        self._touched = dict(zip(hit.tolist(), zip(touch / h, touched, strict=True), strict=True))

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
        before steps know its forces, or until an impact reverses it.
        """
        count, found = len(chunk.codes), dict[str, str]()
        if not count:
            return found
        for k in np.flatnonzero(self._crossed(chunk)).tolist():
            for i in np.flatnonzero(self._within(chunk, start, k, end)).tolist():
                name = self._watch.guards[i].name
                found.setdefault(
                    name,
                    f"{name} is true within the step of {chunk.h:g} at t = "
                    f"{start + k * chunk.h:.6g}, at neither end: steps pass over it; use a "
                    "shorter step, or for a single instant one comparison by <= or >=",
                )
        atoms, codes = self._all[1 : count + 1], self._codes[:count]
        if self._backs[:count].any():
            back = self._guards(atoms | self._backs[:count], codes) & ~self._guards(atoms, codes)
            for k, i in np.argwhere(back).tolist():
                name, time = self._watch.guards[i].name, start + (k + 1) * chunk.h
                found.setdefault(name, reversed_warning(name, time, chunk.h))
        unknown = np.isnan(self._at.margins[:count])
        if unknown.any() or self._hidden.any():
            true = self._guards(atoms, codes)
            possible = self._guards(atoms | unknown, codes) & ~true
            for k in range(count):
                if unknown[k].any():
                    self._hidden |= possible[k]
                    self._forced |= unknown[k]
                    self._known |= atoms[k]
                else:
                    # Assume the present forces for the steps with unknown forces.
                    rows = np.where(self._forced, atoms[k : k + 1], self._known)
                    [was] = self._guards(rows, codes[k : k + 1])
                    for i in np.flatnonzero(self._hidden & was & ~true[k]).tolist():
                        name = self._watch.guards[i].name
                        found.setdefault(
                            name,
                            f"{name} is true before t = {start + (k + 1) * chunk.h:.6g}, in steps "
                            f"of {chunk.h:g} that do not know its forces; use a shorter step",
                        )
                    self._hidden[:] = self._forced[:] = self._known[:] = False
        self._zero = np.vstack([self._zero[1:], self._at.near[:count]])[-2:]
        self._last, self._start = atoms[-1:], self._at.margins[count - 1 : count]
        self._back, self._gaps = self._backs[count - 1 : count], chunk.gaps[-1]
        return found

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
        near = (~self._watch.timed | (rate == 0.0)) & (np.abs(margin) <= least)
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

    def _crossed(self, chunk: Chunk) -> Bools:
        """Return the steps (m,) in which atoms cross zero in turn, or one there and back."""
        count, ends = len(chunk.codes), self._at
        first = np.vstack([self._start, ends.margins])[:count]
        last, change = ends.margins[:count], chunk.h * ends.rates[:count]
        before, after = self._all[:count], self._all[1 : count + 1]
        crossed = (before != after) & ~self._reversed[:count]
        # The parabola last - change s + bend s^2, s back from the end.
        bend = first - last + change
        with np.errstate(divide="ignore", invalid="ignore"):
            deep = last - 0.25 * change**2 / bend < -ends.zero[:count]
        dips = deep & (change > 0.0) & (change < 2.0 * bend)
        dips &= ~(before | after | self._reversed[:count])
        if self._touched:
            dips |= self._dips[:count] & ~(before | after)
        return (crossed.sum(axis=1) > 1) | dips.any(axis=1)

    def _within(self, chunk: Chunk, start: float, k: int, end: float) -> Bools:
        """Return the guards (g,) that are true within a step, at neither end."""
        h, states, solved = chunk.h, chunk.states[k : k + 2], np.tile(chunk.solved[k], (2, 1))
        times = start + chunk.h * np.array([k, k + 1.0])
        (a, b), (c, d) = (self.table(times, states, solved, o)[..., 0] for o in (0, 1))
        straight = np.isnan(c + d) | chunk.struck[k].any()
        c, d = (np.where(straight, b - a, h * rate) for rate in (c, d))
        cubics = np.array([2.0 * (a - b) + c + d, 3.0 * (b - a) - 2.0 * c - d, c, a])
        roots = [np.roots(cubic) for cubic in cubics.T if np.isfinite(cubic).all()]
        # A margin that dips falls until the contacts touch, and rises then.
        touch, least = self._touched.get(k, (1.0, b))
        touch = min(max(touch, AT_END), 1.0 - AT_END)
        dips = np.flatnonzero(self._dips[k] & (a >= 0.0) & (b >= 0.0))
        roots.append(touch * a[dips] / (a - least)[dips])
        roots.append(1.0 - (1.0 - touch) * b[dips] / (b - least)[dips])
        real = np.array([x.real for x in chain(*roots) if x.imag == 0.0])
        crossings = real[(real > AT_END) & (real < 1.0 - AT_END)]
        shares = np.sort(np.append(crossings, [0.0, 1.0]))
        shares = np.hstack([crossings, 1.0, 0.5 * (shares[:-1] + shares[1:])])
        shares = shares[times[0] + shares * h <= end + AT_END * h]
        at = np.array([np.polyval(cubics, share) for share in shares]).reshape(-1, len(a))
        for i in dips.tolist():
            at[:, i] = np.interp(shares, [0.0, touch, 1.0], [a[i], least[i], b[i]])
        first, last = self._all[k : k + 2]
        # Atoms that cross zero at the same instant may hold there alone.
        on_zero = np.where(first != last, self._watch.closed, last)
        inside = np.where(np.abs(at) <= self._at.zero[k], on_zero, at < 0.0)
        inside = np.where(self._reversed[k], first & last, inside)
        # The impact may be anywhere in the step.
        parts = (np.where(self._jumped[k], side, inside) for side in (first, last))
        rows = np.vstack([first, last, *parts])
        true = self._guards(rows, np.tile(self._codes[k], (len(rows), 1)))
        return true[2:].any(axis=0) & ~true[0] & ~true[1]
