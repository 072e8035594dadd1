"""Cells of one structure that go through one compiled call, some hundreds at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from functools import cached_property, partial

import numpy as np

from statechart.arrays import Array
from statechart.errors import DeclarationError
from statechart.execution.rows import Batch, RowRunner
from statechart.formulas.formula import parse
from statechart.observation.batch_outputs import BatchOutputs
from statechart.observation.outputs import Outputs
from statechart.running.runner import Runner
from statechart.sweeps.plan import Task

# Cells of one compiled call.
_MOST = 256
# Once so many have been tried together, they go on so if one in so many went through: a cell that
# does saves four fifths of its time, and one that does not has cost less than one fifth.
_TRIED, _WORTH = 64, 4


class Together:
    """Runs cells together, as far as they are usual.

    Parameters
    ----------
    runner : Runner
        What runs each of the others.
    task : Task
        What is asked of each.

    Attributes
    ----------
    through : int
        Cells that have gone through.
    """

    def __init__(self, runner: Runner, task: Task) -> None:
        self._runner, self._task = runner, task
        self._tried, self.through = 0, 0

    @cached_property
    def _rows(self) -> tuple[RowRunner, BatchOutputs] | None:
        found = self._runner.rows(self._task.names)
        if found is None:
            return None
        return found[1], BatchOutputs(Outputs(found[0], self._task.outputs))

    @property
    def size(self) -> int:
        """How many cells to take next; 1 where each is to be run alone."""
        lost = self._tried >= _TRIED and self.through * _WORTH < self._tried
        if lost or self._rows is None or not self._rows[0].ready(1):
            return 1
        # The first of them enter modes that are not known yet.
        return min(2 + self._tried, _MOST)

    def run(self, table: Array) -> Iterator[tuple[Batch, dict[str, Array], dict[str, list[Array]]]]:
        """Run rows (m, p) of values; yield those that go through, with their outputs."""
        assert self._rows is not None
        rows, outputs = self._rows
        until = self._ends(table)
        self._tried += len(table)
        for batch in rows.run(table, until, self._runner.model.settings.max_jumps):
            self.through += len(batch.rows)
            yield batch, *outputs.of(batch, partial(rows.jump, batch, table[batch.rows]))

    def _ends(self, table: Array) -> Array:
        """Return when runs (m,) end; not a number where that is refused."""
        runner, names, until = self._runner, self._task.names, self._task.until
        time = runner.model.stop.time
        if until is not None or time is None or not parse(time).names:
            return np.full(len(table), runner.end(until=until))
        found = np.full(len(table), math.nan)
        for k, row in enumerate(table.tolist()):
            with suppress(DeclarationError):
                found[k] = runner.end(dict(zip(names, row, strict=True)))
        return found
