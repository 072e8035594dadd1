"""Rows of runs of a scene: what they have in common, made ready for the compiled call."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.projection import CREEP, DRIFT, UNSEEN
from contacts.dynamics.setup import SHORT, TIE, doubtful, tolerated
from contacts.dynamics.setup_evaluation import LOOK_AHEAD, Numbers, Rules, SceneNumbers, run_buffer
from contacts.event_driven.hit import SceneWatch, meaning
from contacts.event_driven.run_batch import SceneBatch, run_batch
from contacts.event_driven.run_compiled import CAUSES
from contacts.modes.classification import allowed
from contacts.states import CODES, OFF, OFF_CODE, superstates_of
from statechart.arrays import Array, Bools
from statechart.automaton.trace_store import TraceBuffer
from statechart.engines.flow_watch import KINDS, Watch
from statechart.execution.batch import BatchInputs, BatchResult
from statechart.execution.compiled_loop import Loop
from statechart.kernels.accumulation import WIDTH
from statechart.kernels.jit import entry

_NAMES = {code: name for name, code in CODES.items() if name != OFF} | {OFF_CODE: OFF}


class BatchCall:
    """The compiled call for rows of values of some parameters.

    Parameters
    ----------
    numbers : SceneNumbers
        From the values of the parameters to the numbers of a run.
    rules : Rules
        Of it.
    loop : Loop
        What runs go through.
    names : sequence of str
        The parameters.
    relative : float
        Tolerance of the integration.

    Attributes
    ----------
    loop : Loop
    series : (s, ..) array
        Of the jumps of the last row.
    """

    def __init__(
        self,
        numbers: SceneNumbers,
        rules: Rules,
        loop: Loop,
        names: Sequence[str],
        relative: float,
    ) -> None:
        self.loop = loop
        tape, inputs = numbers.parameters.program(frozenset(names))
        literals = numbers.parameters.literals
        self._given_at = [(i, names.index(name)) for i, name in enumerate(inputs) if name in names]
        self._fixed = np.array([*(literals.get(name, math.nan) for name in inputs), math.inf])
        laws = numbers.contacts(np.zeros(len(numbers.parameters.names)))
        scene = _declared(numbers, rules, loop, laws, relative)
        self._given = loop.program, loop.pace, loop.memory, scene, *tape.program
        self._memory = _memory(numbers, rules, loop, scene)
        self.series = self._memory[-1]
        self._entry: Callable[..., int] | None = None

    def inputs(self, table: Array) -> Array:
        """Return what the numbers of runs are computed from (m, i), of rows (m, p) of values."""
        found = np.empty((len(table), len(self._fixed)))
        found[:] = self._fixed
        for place, column in self._given_at:
            found[:, place] = table[:, column]
        return found

    def run(self, rows: BatchInputs, block: TraceBuffer, found: BatchResult) -> int:
        """Make runs; return how many of them before the block was full."""
        arguments = *self._given, rows, *self._memory, block, found
        if self._entry is None:
            self._entry = entry(run_batch, *arguments)
        return self._entry(*arguments)


def _starts(names: Sequence[str], declared: Mapping[str, str]) -> Bools:
    """Return (c, 6): whether a contact may start in the state of that code, as declared."""
    found = np.zeros((len(names), len(_NAMES)), np.bool_)
    for place, name in enumerate(names):
        wanted = declared.get(name)
        for code, state in _NAMES.items():
            fits = {state, *superstates_of((state,)).values()}
            found[place, code] = wanted is None or wanted in fits
    return found


def _declared(
    numbers: SceneNumbers, rules: Rules, loop: Loop, laws: Sequence[ContactLaw], relative: float
) -> SceneBatch:
    """Return what is the same whatever the values: what contacts may do, where coefficients are."""
    count = len(laws)
    found = [numbers.coefficients(*item) for item in numbers.scene.contacts.items()]
    places = [[-1 if place is None else place for place, _ in one] for one in found]
    fixed = [[value for _, value in one] for one in found]
    gap, speed, force = tolerated(relative)
    stops = [*numbers.stops]
    return SceneBatch(
        loop.tapes,
        rules,
        np.array(places, np.int64).reshape(count, 3),
        np.array(fixed, float).reshape(count, 3),
        np.array([stops.index(m) if m in stops else -1 for m in loop.margins], np.int64),
        allowed(tuple([law.states for law in laws])),
        np.array([meaning(law) for law in laws], np.int64),
        _starts([law.name for law in laws], numbers.scene.initial_modes),
        gap,
        speed,
        force,
        DRIFT,
        CREEP,
        UNSEEN,
        TIE,
        doubtful(relative),
        SHORT,
        LOOK_AHEAD,
    )


def _memory(
    numbers: SceneNumbers, rules: Rules, loop: Loop, scene: SceneBatch
) -> tuple[Numbers, Watch, SceneWatch, Array]:
    """Return where runs are made: of their starts, steps and instants, and series of jumps."""
    variables, parameters = len(loop.memory.state), len(numbers.parameters.names)
    contacts, count = len(scene.meanings), int(loop.tapes[1, 5])
    watch = Watch(
        np.empty(parameters),
        np.empty(len(KINDS)),
        np.empty(len(loop.margins)),
        np.empty(variables),
        loop.tapes[1],
        np.zeros(count),
        np.zeros(count),
        0.0,
    )
    instants = SceneWatch(
        loop.tapes[0],
        loop.tapes[2],
        numbers.conditions.nodes,
        numbers.conditions.slots(loop.margins),
        np.empty(variables + 1),
        scene.gap,
        scene.allowed,
        np.empty((contacts, 2)),
        np.empty(contacts),
        scene.meanings,
        numbers.gap_offsets,
        *[0.0] * 10,
    )
    series = np.empty((max(len(CAUSES) * contacts, 4), WIDTH))
    return run_buffer(parameters, variables, rules), watch, instants, series
