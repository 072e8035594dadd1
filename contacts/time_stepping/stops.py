"""Stop conditions of a run by steps: seen at the ends of steps, located inside them."""

from __future__ import annotations

import numpy as np

from contacts.scene.controls import ControlState
from contacts.scene.scene import Scene
from contacts.time_stepping.begun import Stepping
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.recorder import Recorder
from statechart.arrays import Array, Bools
from statechart.automaton.trace import Arc
from statechart.charts.transitions import nested
from statechart.formulas.formula import parse_relation

# A condition is located within its step to this part of it.
_BISECTIONS = 60
# So small a part of what a margin has just been is what rounding leaves of zero.
_ROUNDED = 1e-13


class StopConditions:
    """The conditions that end a run.

    Parameters
    ----------
    stepping : Stepping
        Whose.
    values : (p,) array
        Of the parameters.
    """

    def __init__(self, stepping: Stepping, values: Array) -> None:
        self._tape, self._names, self._values = stepping.stops, stepping.stop_names, values
        self._stays, self._counts = stepping.stop_counts
        self._last = np.full((2, len(self._names)), np.nan)  # of the margins, as they were last

    def unknown(self, state: Array) -> Array:
        """Return what is solved for where it is not known yet, before the first step."""
        return np.full(self._tape.n_variables - len(state), np.nan)

    def at_start(self, state: Array) -> int | None:
        """Return the condition that holds at the start; those on unknowns wait for a step."""
        if not self._names:
            return None
        margins = self._margins(np.concatenate([state, self.unknown(state)])[None], 0.0)
        below = self._met(margins)[0]
        return int(np.argmax(below)) if below.any() else None

    def met(self, chunk: Chunk, start: float) -> tuple[int, int] | None:
        """Return (step, condition) of the first condition met, by the steps' ends."""
        if not self._names:
            return None
        below = self._met(self._ends(chunk, start)[1])
        if not below.any():
            return None
        k = int(np.argmax(below.any(axis=1)))
        return k, int(np.argmax(below[k]))

    def _met(self, margins: Array) -> Bools:
        ends = np.abs(np.vstack([self._last, margins]))
        before, begun, now = ends[:-2], ends[1:-1], ends[2:]
        near = _ROUNDED * np.fmax(np.fmax(before, begun), now)
        stands = self._stays & (begun <= near) & (now <= near) & (near < np.inf)
        self._last = ends[-2:]
        found: Bools = (margins < 0.0) | (self._counts & (margins == 0.0)) | stands
        return found

    def lost(self, chunk: Chunk, start: float) -> tuple[int, str] | None:
        """Return the first step at whose end a condition has no value, and its name."""
        if not self._names:
            return None
        rows, margins = self._ends(chunk, start)
        found = first_lost(margins, rows)
        return None if found is None else (found[0], self._names[found[1]])

    def _ends(self, chunk: Chunk, start: float) -> tuple[Array, Array]:
        """Return what the margins are of, and the margins, at the ends of steps."""
        rows = np.hstack([chunk.states[1:], chunk.solved])
        return rows, self._margins(rows, chunk.ends(start))

    def locate(self, recorder: Recorder, condition: int) -> Array:
        """Cut what is recorded where a condition is met in its last step; return that state."""
        recorder.close()
        arc, before = recorder.arcs[-1], recorder.arcs[-2:-1]
        begin = float(arc.times[-2])
        met = len(arc.times) == 2 and self._margin(arc, begin, condition) < 0.0
        if met and before and self._margin(before[0], before[0].duration, condition) < 0.0:
            # It was met in the half of the step before an impact; else what begins it meets it.
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
        return float(self._margins(rows, arc.start.later(local).high)[0, condition])

    def _margins(self, rows: Array, times: Array | float) -> Array:
        times = np.broadcast_to(np.asarray(times, dtype=float), len(rows)).copy()
        return self._tape.table(rows, self._values, times)


def counting(scene: Scene) -> Bools:
    """Return which stop conditions hold on their boundary, too, where their relation counts it.

    Returns
    -------
    (2, s) array of bool
        Those that do where they stay there for a step; and at once, of what jumps alone change,
        so that no motion tells the way it goes.
    """
    flowing = {
        variable
        for name, region in scene.regions.items()
        for _, state, _ in nested(region, name)
        if isinstance(state, ControlState)
        for variable in state.flows
    }
    kept = {variable for region in scene.regions.values() for variable in region.variables}
    still = {*scene.parameters, *(kept - flowing)}
    relations = [parse_relation(text) for text in scene.stop.conditions.values()]
    stays = np.array([r.operator in ("<=", ">=") for r in relations], np.bool_)
    jumps = np.array([{*r.left.names, *r.right.names} <= still for r in relations], np.bool_)
    return np.stack([stays, stays & jumps])


def first_lost(margins: Array, inputs: Array) -> tuple[int, int] | None:
    """Return (row, column) of the first margin that is not a number though all its inputs are.

    Forces of steps that hold an impulse are not known, nor are margins on them.
    """
    known: Bools = np.all(np.isfinite(inputs), axis=1)
    lost = np.argwhere(np.isnan(margins) & known[:, None]).tolist()
    return (lost[0][0], lost[0][1]) if lost else None


def cut(arc: Arc, step: int, end: float) -> Arc:
    """Return an arc that ends at local time `end`, in one of its steps."""
    begin = arc.times[step]
    s = (end - begin) / (arc.times[step + 1] - begin)
    times, coefficients = arc.times[: step + 2].copy(), arc.coefficients[: step + 1].copy()
    times[-1] = end
    coefficients[-1] *= s ** np.arange(coefficients.shape[2])
    assert arc.solved is not None
    solved = arc.solved[: step + 1]
    return Arc(arc.mode, arc.roles, arc.start, arc.j, times, coefficients, solved)
