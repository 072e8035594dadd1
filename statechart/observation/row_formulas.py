"""Outputs as arrays: a tape of every formula in every kind of mode that runs go through."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from statechart.arrays import Ints
from statechart.automaton.regions import Mode
from statechart.documents.outputs import Event
from statechart.engines.mode_table import TAPE
from statechart.execution.compiled_loop import Packed
from statechart.execution.simulator import Batch, Simulator
from statechart.observation.flows import Where, seen, wanted
from statechart.observation.grouped import Grouped
from statechart.observation.row_values import Wanted

_Formula = str | int | float


class RowFormulas:
    """Puts the outputs of runs on tapes.

    Parameters
    ----------
    outputs : Grouped

    Attributes
    ----------
    waits : tuple of tuples of Event
        What outputs wait for.
    extremes : tuple of formulas
        Whose least and greatest values are wanted.
    """

    def __init__(self, outputs: Grouped) -> None:
        assert isinstance(outputs.observer.simulator, Simulator)
        self._outputs, self._observer = outputs, outputs.observer
        self._simulator = outputs.observer.simulator
        waits: dict[tuple[Event, ...], None] = {}
        waits |= dict.fromkeys(moment.events for _, _, moment in outputs.at)
        waits |= dict.fromkeys(events for _, events in outputs.counts)
        self.waits = tuple(waits)
        self.extremes = tuple(dict.fromkeys(formula for _, formula, _ in outputs.extremes))

    def wanted(self, batch: Batch) -> Wanted:
        """Return them for the kinds of modes of a batch."""
        outputs, packed = self._outputs, Packed()
        everywhere = ((),)
        moments = [
            (self.waits.index(moment.events), _most(moment.when, moment.most), output.before)
            for _, output, moment in outputs.at
        ]
        integrals = tuple([output.integral for output in outputs.integrals.values()])
        during = wanted([output.during for output in outputs.integrals.values()])

        def along(formulas: Sequence[_Formula], where: tuple[Where, ...]) -> tuple[Ints, Ints]:
            return self._taped(packed, batch, tuple(formulas), where)

        def alone(formulas: Sequence[_Formula]) -> Ints:
            tapes = [along([formula], everywhere)[0] for formula in formulas]
            return np.array(tapes, np.int64).reshape(len(tapes), len(batch.kinds), TAPE)

        start, end = (
            along(list(group.values()), everywhere * len(group))[0]
            for group in (outputs.start, outputs.end)
        )
        over, columns = along(integrals, during)
        values = alone([output.value for _, output, _ in outputs.at])
        extremes = alone(self.extremes)
        counts = [self.waits.index(events) for _, events in outputs.counts]
        return Wanted(
            *packed.arrays(),
            start,
            end,
            over,
            columns,
            values,
            extremes,
            np.array(moments, np.int64).reshape(len(moments), 3),
            np.array(counts, np.int64),
        )

    def _taped(
        self,
        packed: Packed,
        batch: Batch,
        formulas: tuple[_Formula, ...],
        where: tuple[Where, ...],
    ) -> tuple[Ints, Ints]:
        """Add what formulas are in every kind of mode; return the tapes and their places there."""
        programs = self._observer.programs
        expressions = programs.expressions(formulas)
        tapes = np.zeros((len(batch.kinds), TAPE), np.int64)
        columns = np.zeros((len(batch.kinds), len(expressions)), np.int64)
        for place, kind in enumerate(batch.kinds):
            active = programs.active(kind[0], where, expressions)
            if not (active.places and batch.modes.knows(kind)):
                continue
            mode = self._mode(batch, place) if active.needed else None
            tapes[place] = packed.tape(programs.tape(seen(active.expressions, mode), mode))
            columns[place, : len(active.places)] = active.places
        return tapes, columns

    def _mode(self, batch: Batch, kind: int) -> Mode:
        return self._simulator.compiled(batch.kinds[kind][1], batch.zeros).mode


def _most(when: str, most: int | None) -> int:
    """Return how many events are chosen: the first, the last below 0, each at 0."""
    if when == "each":
        return 0
    return (most or 1) if when == "first" else -(most or 1)
