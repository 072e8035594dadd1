"""Stop conditions of a stepped run: tested at the ends of steps, located by bisection inside."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.states import STATES
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.lazy_arcs import cut
from contacts.time_stepping.recorder import Recorder
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.margin_derivatives import rounding_scale
from statechart.automaton.regions import Region, StopCondition
from statechart.automaton.trace import Arc, Key
from statechart.formulas.tape import Tape


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


class StopTapes:
    """Margins of the atoms of stop conditions on tape, over variables and unknowns.

    `counts` (2, a): atoms that hold on their boundary after a step there; and at once, if only
    jumps change them.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        stops: Sequence[StopCondition],
        unknowns: Sequence[sp.Symbol],
        regions: Sequence[Region],
    ) -> None:
        self._mechanics, self._unknowns, self.stops = mechanics, unknowns, tuple(stops)
        self.names = tuple(stop.name for stop in stops)
        atoms = [atom for stop in stops for atom in stop.condition.atoms]
        self._conditions = [atom.expression for atom in atoms]
        self.margins: Tape = mechanics.whole_tape(self._conditions, unknowns=unknowns)
        flowing = mechanics.scene.controlled.flowing
        still = {*mechanics.parameters.ordered}
        still |= {
            symbol for name, symbol in mechanics.controller_state.items() if name not in flowing
        }
        stays = np.array([not atom.strict for atom in atoms], np.bool_)
        jumps = np.array([atom.expression.free_symbols <= still for atom in atoms], np.bool_)
        self.counts: Bools = np.stack([stays, stays & jumps])
        self.active = ActiveStates(regions)

    @cached_property
    def _of_terms(self) -> Tape:
        """Absolute terms of the margins, over inputs and input sizes."""
        mechanics = self._mechanics
        inputs = (*mechanics.variables, *mechanics.controller_state.values(), *self._unknowns)
        sizes = {symbol: sp.Symbol(f"size_{symbol}", real=True) for symbol in inputs}
        return mechanics.whole_tape(
            [rounding_scale(condition, sizes) for condition in self._conditions],
            unknowns=(*self._unknowns, *sizes.values()),
        )

    def terms(self, rows: Array, sizes: Array, values: Array, times: Array) -> Array:
        """Return the sums of absolute terms of margins (k, s)."""
        inputs = np.hstack([rows, np.broadcast_to(sizes, rows.shape)])
        return np.nan_to_num(self._of_terms.table(inputs, values, times))


# Bisections of a step.
_BISECTIONS = 60


class StopConditions:
    """The stop conditions of a run."""

    def __init__(self, tapes: StopTapes, setup: SceneSetup) -> None:
        self._tapes, self._names, self._values = tapes, tapes.names, setup.values
        self._tape = self._tapes.margins
        assert setup.sizes is not None
        unknowns = self._tape.n_variables - len(setup.sizes)
        self._sizes = np.concatenate([setup.sizes, setup.scales.solved(unknowns)])
        self._stays, self._counts = self._tapes.counts
        self._rounded = setup.rounded
        # States and mode of the step in which a condition was met.
        self._modes: tuple[Ints, Key] = np.zeros((1, 0), int), ()
        # Whether margins were zero at the end of the last step.
        self._near = np.zeros(len(self._stays), dtype=np.bool_)

    def unknown(self, state: Array) -> Array:
        """Return NaN for the unknowns before the first step."""
        return np.full(self._tape.n_variables - len(state), np.nan)

    def at_start(self, state: Array, recorder: Recorder) -> int | None:
        """Return the condition that holds at the start; those on unknowns wait for a step."""
        if not self._names:
            return None
        rows = np.concatenate([state, self.unknown(state)])[None]
        atoms = self._met(rows, self._margins(rows, 0.0), np.zeros(1))
        below = self._truths(atoms, recorder.start[None], recorder.controls)[0]
        return int(np.argmax(below)) if below.any() else None

    def first_met(self, chunk: Chunk, start: float, controls: Key) -> tuple[int, int] | None:
        """Return (step, condition) of the first condition that holds at the end of a step.

        `controls` are the controller states in these steps.
        """
        if not self._names:
            return None
        atoms = self._met(*self._ends(chunk, start), chunk.ends(start))
        below = self._truths(atoms, chunk.codes, controls)
        if not below.any():
            return None
        k = int(np.argmax(below.any(axis=1)))
        self._modes = chunk.codes[k : k + 1], controls
        return k, int(np.argmax(below[k]))

    def _truths(self, atoms: Bools, codes: Ints, controls: Key) -> Bools:
        """Return which conditions (k, s) hold, from their atoms (k, a)."""
        active = self._tapes.active.at(codes, controls)
        parts = self._parts(atoms)
        held = [
            stop.condition.truths(part, active)
            for stop, part in zip(self._tapes.stops, parts, strict=True)
        ]
        return np.stack(held, axis=1)

    def _parts(self, atoms: NDArray[Any]) -> list[NDArray[Any]]:
        """Split atoms (k, a) by condition."""
        counts = [len(stop.margins) for stop in self._tapes.stops]
        return np.split(atoms, np.cumsum(counts)[:-1], axis=1)

    def _met(self, rows: Array, margins: Array, times: Array) -> Bools:
        # A resting coordinate moves by solver residuals.
        zero = self._rounded * self._tapes.terms(rows, self._sizes, self._values, times)
        ends = np.vstack([self._near, np.abs(margins) <= zero])
        before, near, self._near = ends[:-1], ends[1:], ends[-1]
        inside: Bools = (margins < 0.0) & ~near
        return inside | (self._counts & (margins == 0.0)) | (self._stays & before & near)

    def lost(self, chunk: Chunk, start: float) -> tuple[int, str] | None:
        """Return the first step at whose end a condition has no value, and its name."""
        if not self._names:
            return None
        rows, margins = self._ends(chunk, start)
        single = [stop.condition.single for stop in self._tapes.stops]
        # A compound condition is lost only if all its atoms are.
        values = [
            part if alone else np.where(np.isnan(part).all(axis=1, keepdims=True), part, 0.0)
            for part, alone in zip(self._parts(margins), single, strict=True)
        ]
        found = first_undefined(np.hstack(values), rows)
        if found is None:
            return None
        owners = [stop.name for stop in self._tapes.stops for _ in stop.margins]
        return found[0], owners[found[1]]

    def _ends(self, chunk: Chunk, start: float) -> tuple[Array, Array]:
        """Return inputs and margins at the ends of steps."""
        rows = np.hstack([chunk.states[1:], chunk.solved])
        return rows, self._margins(rows, chunk.ends(start))

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
        margins = self._margins(rows, arc.start.later(local).high)
        stop, part = self._tapes.stops[condition], self._parts(margins)[condition]
        active = self._tapes.active.at(*self._modes)
        return stop.condition.margin(part[0].tolist(), lambda *of: bool(active(*of)[0]))

    def _margins(self, rows: Array, times: Array | float) -> Array:
        times = np.broadcast_to(np.asarray(times, dtype=float), len(rows)).copy()
        return self._tape.table(rows, self._values, times)


def first_undefined(margins: Array, inputs: Array) -> tuple[int, int] | None:
    """Return (row, column) of the first margin that is NaN although its inputs are finite.

    Forces of steps with impacts are NaN, and so are margins on them.
    """
    known: Bools = np.all(np.isfinite(inputs), axis=1)
    lost = np.argwhere(np.isnan(margins) & known[:, None]).tolist()
    return (lost[0][0], lost[0][1]) if lost else None
