"""Formulas at points of many runs at once, and along their arcs."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints, Ints32
from statechart.automaton.regions import Mode
from statechart.documents.outputs import Integral
from statechart.execution.ahead import N_MODE, T_HIGH
from statechart.execution.loops import Packed
from statechart.execution.rows import ARCS, FIRST_MODE, Batch
from statechart.execution.simulator import Simulator
from statechart.formulas.tape import Tape, contiguous
from statechart.kernels.rows import extremes_rows, integrate_rows, tape_rows
from statechart.observation.flows import Where, seen, wanted
from statechart.observation.observer import Observer

_Integrands = tuple[Ints32, Array, Ints, Ints]
_Formula = str | int | float


class Points(NamedTuple):
    """Where formulas are evaluated: runs (m,), kinds of modes (m,), times (m,), states (m, n)."""

    owners: Ints
    kinds: Ints
    times: Array
    states: Array


class _Arcs(NamedTuple):
    """The arcs of rows, as kernels take them; see `integrate_rows`."""

    arcs: Ints32
    places: Ints
    starts: Array
    times: Array
    coefficients: Array
    spans: Ints
    values: Array
    variables: int

    @classmethod
    def of(cls, batch: Batch) -> _Arcs:
        block, found = batch.block, batch.found
        spans = found.spans[:, ARCS : ARCS + 2].copy()
        return cls(
            block.arcs, block.places, block.starts, block.times, block.coefficients, spans,
            found.values, found.final.shape[1],
        )  # fmt: skip


class RowFormulas:
    """Evaluates formulas of batches of rows.

    Parameters
    ----------
    observer : Observer
        Of the simulator that makes them.
    """

    def __init__(self, observer: Observer) -> None:
        assert isinstance(observer.simulator, Simulator)
        self._observer, self._simulator = observer, observer.simulator
        self._packed: dict[tuple[Hashable, ...], _Integrands] = {}

    def values(self, batch: Batch, formulas: Sequence[_Formula], points: Points) -> Array:
        """Return the values (m, f) of formulas at points."""
        observer = self._observer
        expressions = observer.expressions(formulas)
        result = np.full((len(points.owners), len(expressions)), np.nan)
        if not observer.needed(expressions):
            self._fill(observer.tape(expressions, None), batch, points, result)
            return result
        for kind in np.unique(points.kinds).tolist():
            index = np.flatnonzero(points.kinds == kind)
            mode = self._mode(batch, kind)
            part = np.empty((len(index), len(expressions)))
            some = Points._make([array[index] for array in points])
            self._fill(observer.tape(seen(expressions, mode), mode), batch, some, part)
            result[index] = part
        return result

    @staticmethod
    def _fill(tape: Tape, batch: Batch, points: Points, result: Array) -> None:
        tape_rows(
            *tape.program, contiguous(points.states), batch.found.values,
            np.ascontiguousarray(points.owners), contiguous(points.times), result,
        )  # fmt: skip

    def _mode(self, batch: Batch, kind: int) -> Mode:
        return self._simulator.compiled(batch.kinds[kind][1], batch.zeros).mode

    def integrals(self, batch: Batch, declared: Mapping[str, Integral]) -> Array:
        """Return integrals (m, f) as they are declared."""
        formulas = tuple([output.integral for output in declared.values()])
        where = wanted([output.during for output in declared.values()])
        tapes = self._tapes(batch, formulas, where)
        totals = np.zeros((len(batch.found.ends), len(formulas)))
        ints, floats, kinds, columns = tapes
        integrate_rows(ints, floats, kinds, columns, *_Arcs.of(batch), totals)
        return totals

    def extremes(self, batch: Batch, formula: _Formula) -> Array:
        """Return the least and the greatest value (m, 2) of a formula."""
        found, rows = batch.found, np.arange(len(batch.found.ends))
        result = np.empty((len(rows), 2))
        ints, floats, tapes, _ = self._tapes(batch, (formula,), ((),))
        extremes_rows(ints, floats, tapes, *_Arcs.of(batch), result)
        still = np.flatnonzero(found.spans[:, ARCS] == found.spans[:, ARCS + 1])
        if still.size:  # nothing flowed
            ends, end = found.place[still, N_MODE], found.now[still, T_HIGH]
            first, last = (
                self.values(batch, [formula], points)[:, 0]
                for points in (
                    Points(still, found.ends[still, FIRST_MODE], 0.0 * end, found.initial[still]),
                    Points(still, ends, end, found.final[still]),
                )
            )
            result[still, 0] = np.where(last < first, last, first)
            result[still, 1] = np.where(last > first, last, first)
        return result

    def _tapes(
        self, batch: Batch, formulas: tuple[_Formula, ...], where: tuple[Where, ...]
    ) -> _Integrands:
        """Return what formulas are in every kind of mode, and their places there."""
        key = batch.zeros, len(batch.kinds), formulas, where
        if key not in self._packed:
            self._packed[key] = self._taped(batch, formulas, where)
        return self._packed[key]

    def _taped(
        self, batch: Batch, formulas: tuple[_Formula, ...], where: tuple[Where, ...]
    ) -> _Integrands:
        observer = self._observer
        expressions = observer.expressions(formulas)
        packed = Packed()
        tapes = np.zeros((len(batch.kinds), 9), np.int64)
        columns = np.zeros((len(batch.kinds), len(expressions)), np.int64)
        for place, kind in enumerate(batch.kinds):
            active = observer.active(kind[0], where, expressions)
            if not (active.places and batch.modes.knows(kind)):
                continue
            mode = self._mode(batch, place) if active.needed else None
            tapes[place] = packed.tape(observer.tape(seen(active.expressions, mode), mode))
            columns[place, : len(active.places)] = active.places
        return *packed.arrays(), tapes, columns
