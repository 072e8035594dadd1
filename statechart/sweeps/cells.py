"""Runs of the cells of a sweep, in compiled batches or one by one."""

from __future__ import annotations

import math
import pickle
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache, cached_property, lru_cache, partial
from importlib.metadata import version
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from statechart import interrupts
from statechart.arrays import Array, Bools, Ints32
from statechart.automaton.trace import Key, Outcome
from statechart.compiling import working_time
from statechart.documents.declaration import Declaration
from statechart.errors import DeclarationError, DeclarationProblem, FormulaError, SimulationError
from statechart.execution.compiled_loop import EVENTS, EVENTS_END, FIRST_MODE, T_HIGH, Batch
from statechart.execution.simulator import BatchRunner
from statechart.formulas.formula import parse
from statechart.observation.observer import Observer
from statechart.observation.output_kernels import TARGET
from statechart.observation.outputs import Outputs
from statechart.observation.scales import OutputValue
from statechart.running.result import Result
from statechart.running.runner import Runner
from statechart.sweeps.mode_sequences import write_sequence
from statechart.sweeps.plan import Task, lists

REFUSED = "DECLARATION_ERROR"
"""Outcome of a cell with values that the declaration refuses."""
FAULTY = "INTERNAL_ERROR"
"""Outcome of a cell that ended with an internal error."""
OUTCOMES = {
    **{outcome.name: outcome.value for outcome in Outcome},
    REFUSED: "These parameter values make no valid model, or it cannot start.",
    FAULTY: "An internal error ended the run; please report it.",
}
"""Outcome -> sentence."""
SUCCEEDED = tuple(outcome.name for outcome in Outcome if outcome.succeeded)
"""Outcomes of cells that reached a declared end."""

_MAX_STRUCTURES, _MAX_TEXTS = 8, 4096  # cached runners and texts of sequences
_MAX_BATCH = 256  # cells of one compiled call
# After _MIN_TRIALS cells, batches go on if one in _WORTH completes: a complete cell saves four
# fifths of its time, an incomplete one costs less than one fifth.
_MIN_TRIALS, _WORTH = 64, 4
# A runner is not thread-safe.
_ONE_AT_A_TIME = threading.Lock()


@dataclass
class CellBlock:
    """Results of n cells; arrays have shape (n,)."""

    numbers: dict[str, Array]  # output -> values, NaN if there is none
    lists: dict[str, list[Array]]  # output -> values at each event
    outcome: NDArray[np.object_]
    message: NDArray[np.object_]  # empty for a declared end
    certified: Bools
    modes: Ints32  # codes of sequences, -1 for cells that did not run
    sequences: dict[str, int]  # sequence -> its code
    t_end: Array
    seconds: Array  # computing time
    error_estimate: Array  # if an accuracy was requested

    def take(self, places: NDArray[np.intp], other: CellBlock, modes: Ints32) -> None:
        """Copy another block to `places` of this one, with mode codes `modes`."""
        for name, values in self.numbers.items():
            values[places] = other.numbers[name]
        for name, rows in self.lists.items():
            for place, row in zip(places.tolist(), other.lists[name], strict=True):
                rows[place] = row
        for part in ("outcome", "message", "certified", "t_end", "seconds", "error_estimate"):
            getattr(self, part)[places] = getattr(other, part)
        self.modes[places] = modes

    def take_output(self, name: str, cells: Sequence[int], values: Sequence[OutputValue]) -> None:
        """Set the values of an output in some cells."""
        if name in self.lists:
            for k, value in zip(cells, values, strict=True):
                self.lists[name][k] = np.array(value, dtype=float)
        else:
            self.numbers[name][cells] = [math.nan if v is None else v for v in values]

    def code(self, sequence: str) -> int:
        """Return the code of a sequence of modes."""
        return self.sequences.setdefault(sequence, len(self.sequences))

    def end(self, k: int, outcome: str, message: str) -> None:
        """Set the outcome of a cell."""
        self.outcome[k], self.message[k] = outcome, message

    @classmethod
    def empty(cls, size: int, numbers: Iterable[str], lists: Iterable[str]) -> CellBlock:
        """Return a block of cells that have not run, with empty outcomes."""
        unknown: Callable[[], Array] = partial(np.full, size, math.nan)
        text: Callable[[], NDArray[np.object_]] = partial(np.full, size, "", dtype=object)
        return cls(
            {name: unknown() for name in numbers},
            {name: [np.empty(0)] * size for name in lists},
            text(), text(), np.zeros(size, dtype=bool), np.full(size, -1, dtype=np.int32), {},
            unknown(), unknown(), unknown(),
        )  # fmt: skip


def run_block(task: Task, rows: Array) -> CellBlock:
    """Run cells in this process."""
    here = version("contact-statecharts")
    if task.version != here:
        message = f"a worker has version {here} of contact-statecharts, not {task.version}"
        raise DeclarationError(message, advice="install the same version on all workers")
    with _ONE_AT_A_TIME:
        return _cells(task).block(rows)


@lru_cache(maxsize=2)
def _cells(task: Task) -> _Cells:
    return _Cells(task)


class _Cells:
    """Runs cells, with cached runners."""

    def __init__(self, task: Task) -> None:
        model = pickle.loads(task.model)
        assert isinstance(model, Declaration)
        self._task, self._model = task, model
        self._whole = [k for k, name in enumerate(task.names) if name in model.whole]
        self._lists = lists(model, task.outputs)
        self._numbers = tuple(name for name in task.outputs if name not in self._lists)
        self._structures: dict[tuple[float, ...], _Structure] = {}

    def block(self, rows: Array) -> CellBlock:
        """Run rows of values, ordered by the structure of the model."""
        found = CellBlock.empty(len(rows), self._numbers, self._lists)
        groups: dict[tuple[float, ...], list[int]] = {}
        for k, values in enumerate(rows[:, self._whole].tolist()):
            groups.setdefault(tuple(values), []).append(k)
        for key in sorted(groups):
            places = np.array(groups[key])
            while places.size:
                for k in self._run_batch(key, places, rows, found).tolist():
                    self._run_single(key, rows[k].tolist(), found, k)
                places = places[np.flatnonzero(found.outcome[places] == "")]
        return found

    def _run_batch(
        self, key: tuple[float, ...], places: NDArray[np.intp], rows: Array, found: CellBlock
    ) -> NDArray[np.intp]:
        """Run the next rows in one compiled call; return the places that did not complete."""
        structure = self._structures.get(key)
        size = 1 if structure is None else structure.batch_size
        if structure is None or size == 1:
            return places[:size]
        places = places[:size]
        began = working_time()
        done: list[NDArray[np.intp]] = []
        for batch, outputs in structure.run_batch(rows[places]):
            here = places[batch.rows]
            done.append(here)
            for name, values in outputs.items():
                found.take_output(name, here.tolist(), values)
            found.outcome[here] = Outcome.HORIZON.name
            found.outcome[here[batch.stopped]] = Outcome.STOPPED.name
            found.message[here] = ""
            found.certified[here] = True
            found.t_end[here] = batch.result.clock[:, T_HIGH]
            found.modes[here] = [found.code(structure.sequence(m)) for m in _modes_of(batch)]
        if done:
            through = np.concatenate(done)
            found.seconds[through] = (working_time() - began) / len(through)
        return places[found.outcome[places] == ""]

    def _run_single(
        self, key: tuple[float, ...], row: list[float], found: CellBlock, k: int
    ) -> None:
        """Run one cell; errors become its outcome."""
        began = working_time()
        try:
            structure = self._structure(key)
            values = dict(zip(self._task.names, row, strict=True))
            result = structure.runner.run(values, until=self._task.until, throw=False)
            self._take(structure, result, found, k)
        except SimulationError as error:
            found.end(k, error.outcome or FAULTY, error.message)
        except DeclarationError as error:
            found.end(k, REFUSED, str(error))
        except MemoryError:
            raise
        except Exception as error:
            interrupts.check()  # compiled code turns a signal into another error
            found.end(k, FAULTY, f"{type(error).__name__}: {error}")
        found.seconds[k] = working_time() - began

    def _structure(self, key: tuple[float, ...]) -> _Structure:
        """Return the runner of the model with `key` numbers of copies of bodies."""
        found = self._structures.pop(key, None)
        if found is None:
            whole = {self._task.names[k]: value for k, value in zip(self._whole, key, strict=True)}
            try:
                model = self._model.variant(whole)
            except (DeclarationProblem, FormulaError) as error:
                raise DeclarationError(str(error)) from None
            found = _Structure(Runner(model, **asdict(self._task.setting)), self._task)
        self._structures[key] = found
        if len(self._structures) > _MAX_STRUCTURES:
            del self._structures[next(iter(self._structures))]
        return found

    def _take(self, structure: _Structure, result: Result, block: CellBlock, k: int) -> None:
        trace = result.trace
        if trace.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        block.end(k, trace.outcome.name, "" if trace.outcome.succeeded else trace.message)
        block.certified[k] = trace.certified is not False
        block.t_end[k] = trace.t_end
        block.modes[k] = block.code(structure.sequence(trace.modes))
        if result.error_estimate is not None:
            block.error_estimate[k] = result.error_estimate
        if not self._task.outputs:
            return
        outputs = structure.outputs(result.observer)
        for name, value in outputs.of(trace).items():
            block.take_output(name, [k], [value])


class _Structure:
    """A runner of the model with one structure, and the evaluation of its outputs."""

    def __init__(self, runner: Runner, task: Task) -> None:
        self.runner, self._task = runner, task
        self._trials, self.through = 0, 0
        # Evaluation of the outputs of the sweep, and sequences of modes as texts.
        self.outputs = cache(partial(Outputs, names=task.outputs))
        self.sequence = lru_cache(_MAX_TEXTS)(self._text)

    @cached_property
    def _batches(self) -> tuple[Observer, BatchRunner] | None:
        return self.runner.batch(self._task.names)

    @property
    def batch_size(self) -> int:
        """Number of cells of the next batch; 1 without batches."""
        lost = self._trials >= _MIN_TRIALS and self.through * _WORTH < self._trials
        if lost or self._batches is None or not self._batches[1].ready(1):
            return 1
        # The first batches are small, since they enter modes that are not compiled yet.
        return min(2 + self._trials, _MAX_BATCH)

    def run_batch(self, table: Array) -> Iterator[tuple[Batch, dict[str, list[OutputValue]]]]:
        """Run rows (m, p) of values; yield the complete ones with their outputs."""
        assert self._batches is not None
        observer, rows = self._batches
        outputs, until = self.outputs(observer), self._ends(table)
        self._trials += len(table)
        for batch in rows.run(table, until):
            self.through += len(batch.rows)
            yield batch, outputs.of_batch(batch, partial(rows.jump, batch, table[batch.rows]))

    def _text(self, modes: Sequence[Key]) -> str:
        return write_sequence([self._word(key) for key in modes])

    def _word(self, key: Key) -> str:
        """Return the name of a mode, without regions of a single state."""
        regions = self.runner.automaton.recorded_regions(key)
        states = [(r.name, s) for r, s in zip(regions, key, strict=True) if len(r.states) > 1]
        if len(states) < 2:
            return states[0][1] if states else key[0]
        return " ".join(f"{name}:{state}" for name, state in states)

    def _ends(self, table: Array) -> Array:
        """Return the end times (m,) of runs, NaN if refused."""
        runner, names, until = self.runner, self._task.names, self._task.until
        time = runner.model.stop.time
        if until is not None or time is None or not parse(time).names:
            return np.full(len(table), runner.end(until=until))
        found = np.full(len(table), math.nan)
        for k, row in enumerate(table.tolist()):
            with suppress(DeclarationError):
                found[k] = runner.end(dict(zip(names, row, strict=True)))
        return found


def _modes_of(batch: Batch) -> list[tuple[Key, ...]]:
    """Return the sequence of modes of each run of a batch (`Trace.modes`)."""
    keys = [kind[0] for kind in batch.kinds]
    sequences: dict[tuple[int, bytes], tuple[Key, ...]] = {}
    found = []
    targets = batch.block.events[:, TARGET]
    firsts = batch.result.ends[:, FIRST_MODE].tolist()
    spans = batch.result.spans[:, EVENTS : EVENTS_END + 1].tolist()
    for first, (begin, end) in zip(firsts, spans, strict=True):
        entered = targets[begin:end]
        code = first, entered.tobytes()
        known = sequences.get(code)
        if known is None:
            visited = groupby(keys[kind] for kind in (first, *entered.tolist()))
            known = sequences[code] = tuple(key for key, _ in visited)
        found.append(known)
    return found
