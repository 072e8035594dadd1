"""Stop conditions of a stepped run: tested at the ends of steps, located by bisection inside."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.states import STATES
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.lazy_arcs import cut
from contacts.time_stepping.recorder import Recorder
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.regions import Region
from statechart.automaton.trace import Arc, Key
from statechart.charts.guard_watch import Guard, GuardWatch
from statechart.formulas.relation import parse_relation


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


def turned_by_impact(chunk: Chunk, rates: Callable[[], Array]) -> Bools:
    """Return the atoms (m, a), or (m, 1), whose truth at the end of a step an impact may feign.

    An impact at mid-step may leave a margin beyond the bound at which the motion turns it back.
    `rates` returns those of margins (m + 1, a), NaN where an impact changes the margin itself.
    """
    hit: Bools = np.any(chunk.struck, axis=1)[:, None]
    if not hit.any():
        return hit
    at = rates()
    return hit & ~((at[:-1] >= 0.0) | (at[1:] <= 0.0))


def spans_within_steps(
    watch: GuardWatch,
    chunk: Chunk,
    times: Array,
    rows: Array,
    atoms: Bools,
    by_impact: Bools,
    active: Callable[[int, int], Callable[[str, str], Bools]],
) -> dict[str, str]:
    """Return relation -> warning that it is true within a step, at neither end.

    `times` (m + 1,), `rows` (m + 1, a) and `atoms` (m + 1, a) are the times, margins and truths at
    the start and the ends of the m steps of a chunk. A run may end before its last step does, at
    the last of the times. Margins are interpolated, and NaN where unknown. Atoms `by_impact` (of
    `turned_by_impact`) count as true only if they are so at both ends. `active` returns a test of n
    rows for states that are active in a step.
    """
    found, count = dict[str, str](), len(chunk.codes)
    changed = np.isfinite(rows[:-1] + rows[1:]) & (rows[:-1] != rows[1:]) & ~by_impact
    changed &= atoms[:count] != atoms[1 : count + 1]
    for k in np.flatnonzero(changed.sum(axis=1) > 1).tolist():
        first, last, own = rows[k], rows[k + 1], changed[k]
        # A margin at zero within round-off may change its truth without a crossing.
        shares = np.sort(np.clip(first[own] / (first - last)[own], 0.0, 1.0))
        middles = 0.5 * (shares[:-1] + shares[1:])
        middles = middles[times[k] + middles * chunk.h < times[-1]]
        at = np.where(own, first + middles[:, None] * (last - first), last)
        inside = np.where(watch.closed, at <= 0.0, at < 0.0)
        inside &= ~by_impact[k] | (atoms[k] & atoms[k + 1])
        true = watch.truths(np.vstack([inside, atoms[k : k + 2]]), active(k, len(at) + 2))
        for i in np.flatnonzero(true[:-2].any(axis=0) & ~true[-2] & ~true[-1]).tolist():
            name = watch.guards[i].name
            found[name] = (
                f"{name} is true within the step of {chunk.h:g} at t = {times[k]:.6g}, "
                "at neither end: steps pass over it; use a shorter step"
            )
    return found


class StopTapes:
    """Stop conditions over variables and unknowns, watched as guards are.

    `jumping` (a,): atoms that only jumps change.
    """

    def __init__(
        self, mechanics: Mechanics, unknowns: Sequence[sp.Symbol], regions: Sequence[Region]
    ) -> None:
        texts = mechanics.scene.stop.conditions
        self.names, self.unknowns = tuple(texts), len(unknowns)
        self.watch = GuardWatch(
            [
                Guard(k, name, parse_relation(text), 0)
                for k, (name, text) in enumerate(texts.items())
            ],
            lambda guard: guard.relation.condition(mechanics.observables),
            {
                **dict(zip(mechanics.q, mechanics.v, strict=True)),
                **dict(zip(mechanics.v, mechanics.a, strict=True)),
            },
            inputs=(*mechanics.state, *unknowns),
            parameters=mechanics.parameters.ordered,
            time=mechanics.time,
        )
        flowing = mechanics.scene.controlled.flowing
        still = {*mechanics.parameters.ordered}
        still |= {
            symbol for name, symbol in mechanics.controller_state.items() if name not in flowing
        }
        atoms = [atom for condition in self.watch.conditions for atom in condition.atoms]
        self.jumping = np.array([a.expression.free_symbols <= still for a in atoms], np.bool_)
        self.active = ActiveStates(regions)


# Bisections of a step.
_BISECTIONS = 60


class StopConditions:
    """The stop conditions of a run."""

    def __init__(self, tapes: StopTapes, setup: SceneSetup) -> None:
        self._tapes, self._setup, self._watch = tapes, setup, tapes.watch
        assert setup.sizes is not None
        self._sizes = np.concatenate([setup.sizes, setup.scales.solved(tapes.unknowns)])
        # States and mode of the step in which a condition was met.
        self._modes: tuple[Ints, Key] = np.zeros((1, 0), int), ()
        # Whether margins were zero at the end of the last step.
        self._near = np.zeros(len(tapes.jumping), dtype=np.bool_)
        # Truths (m + 1, a) of atoms at the start and the ends of the last steps, false where their
        # margins are unknown.
        self._atoms = np.zeros((1, len(tapes.jumping)), np.bool_)
        # Condition -> warning that it is true within a step only.
        self._spans = dict[str, str]()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of conditions that steps pass over."""
        return tuple(self._spans.values())

    def unknown(self) -> Array:
        """Return NaN for the unknowns before the first step."""
        return np.full(self._tapes.unknowns, np.nan)

    def at_start(self, state: Array, recorder: Recorder) -> int | None:
        """Return the condition that holds at the start; those on unknowns wait for a step."""
        if not self._tapes.names:
            return None
        self._atoms = self._met(np.concatenate([state, self.unknown()])[None], np.zeros(1))
        below = self._truths(self._atoms, recorder.start[None], recorder.controls)[0]
        return int(np.argmax(below)) if below.any() else None

    def first_met(self, chunk: Chunk, start: float, controls: Key) -> tuple[int, int] | None:
        """Return (step, condition) of the first condition that holds at the end of a step.

        `controls` are the controller states in these steps.
        """
        if not self._tapes.names:
            return None
        atoms = self._met(_ends(chunk), chunk.ends(start))
        below = self._truths(atoms, chunk.codes, controls)
        self._atoms = np.vstack([self._atoms[-1:], atoms])
        if not below.any():
            return None
        k = int(np.argmax(below.any(axis=1)))
        self._modes = chunk.codes[k : k + 1], controls
        return k, int(np.argmax(below[k]))

    def note_spans(self, chunk: Chunk, start: float, end: float, controls: Key) -> None:
        """Note warnings of conditions that are true within a step only, until the run is at `end`.

        The steps are the first of those that `first_met` had last.
        """
        if self._watch.single:
            return
        unknown = np.tile(self.unknown(), (len(chunk.states), 1))
        times, points = np.append(start, chunk.ends(start)), np.hstack([chunk.states, unknown])
        margins = self._table(points, times)[..., 0]
        by_impact = turned_by_impact(chunk, lambda: self._table(points, times, order=1)[..., 0])
        times[-1] = end

        def active(k: int, n: int) -> Callable[[str, str], Bools]:
            return self._tapes.active.at(np.tile(chunk.codes[k], (n, 1)), controls)

        found = spans_within_steps(
            self._watch, chunk, times, margins, self._atoms, by_impact, active
        )
        self._spans = found | self._spans

    def _truths(self, atoms: Bools, codes: Ints, controls: Key) -> Bools:
        """Return which conditions (k, s) hold, from their atoms (k, a)."""
        return self._watch.truths(atoms, self._tapes.active.at(codes, controls))

    def _table(self, rows: Array, times: Array, *, order: int = 0) -> Array:
        """Return the margins of the atoms, or rates, and the sizes of their terms (k, a, 2)."""
        return self._watch.table(self._setup, rows, self._sizes, times, order=order)

    def _met(self, rows: Array, times: Array) -> Bools:
        margins, terms = np.moveaxis(self._table(rows, times), -1, 0)
        # A resting coordinate moves by solver residuals.
        near = np.abs(margins) <= self._setup.rounded * np.nan_to_num(terms)
        ends = np.vstack([self._near, near])
        before, self._near = ends[:-1], ends[-1]
        # An atom that includes its boundary holds after a step there, or at once if it jumps.
        closed, jumped = self._watch.closed, self._tapes.jumping & (margins == 0.0)
        return ((margins < 0.0) & ~near) | (closed & (jumped | (before & near)))

    def first_undefined_condition(self, chunk: Chunk, start: float) -> tuple[int, str] | None:
        """Return the first step at whose end a condition has no value, and its name."""
        if not self._tapes.names:
            return None
        rows = _ends(chunk)
        margins = self._table(rows, chunk.ends(start))[..., 0]
        for condition, first in zip(self._watch.conditions, self._watch.firsts, strict=True):
            # A compound condition is lost only if all its atoms are.
            part = margins[:, first : first + len(condition.atoms)]
            if not condition.single:
                part[~np.isnan(part).all(axis=1)] = 0.0
        found = first_undefined(margins, rows)
        if found is None:
            return None
        owner = int(np.searchsorted(self._watch.firsts, found[1], side="right")) - 1
        return found[0], self._tapes.names[owner]

    def locate(self, recorder: Recorder, condition: int) -> Array:
        """Cut the recorded run where a condition is met in its last step; return that state."""
        recorder.close()
        arc, before = recorder.arcs[-1], recorder.arcs[-2:-1]
        begin = float(arc.times[-2])
        met = len(arc.times) == 2 and self._margin(arc, begin, condition) < 0.0
        if met and before and self._margin(before[0], before[0].duration, condition) < 0.0:
            # It was met in the half step before an impact; otherwise at the start of the arc.
            arc = recorder.drop()
            begin = float(arc.times[-2])
        low, high = begin, arc.duration
        if self._margin(arc, low, condition) < 0.0:
            high = low
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if self._margin(arc, middle, condition) < 0.0:
                high = middle
            else:
                low = middle
        last = cut(arc, len(arc.times) - 2, high)
        recorder.rewind(last)
        state: Array = last.coefficients[-1].sum(axis=1)
        return state

    def _margin(self, arc: Arc, local: float, condition: int) -> float:
        at = np.array([local])
        unknowns = arc.unknowns(at)
        assert unknowns is not None
        rows = np.hstack([arc.states(at), unknowns])
        margins = self._table(rows, np.array([arc.start.later(local).high]))[0, :, 0]
        active = self._tapes.active.at(*self._modes)
        stop, first = self._watch.conditions[condition], self._watch.firsts[condition]
        return stop.margin(margins[first:].tolist(), lambda *of: bool(active(*of)[0]))


def _ends(chunk: Chunk) -> Array:
    """Return the inputs of conditions at the ends of steps."""
    return np.hstack([chunk.states[1:], chunk.solved])


def first_undefined(margins: Array, inputs: Array) -> tuple[int, int] | None:
    """Return (row, column) of the first margin that is NaN although its inputs are finite.

    Forces of steps with impacts are NaN, and so are margins on them.
    """
    known: Bools = np.all(np.isfinite(inputs), axis=1)
    lost = np.argwhere(np.isnan(margins) & known[:, None]).tolist()
    return (lost[0][0], lost[0][1]) if lost else None
