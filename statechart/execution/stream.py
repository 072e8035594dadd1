"""A run as it comes: arcs and jumps one by one, and parameters that are set between samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

from statechart.automaton.time_stepper import Sample, Sampling, in_order
from statechart.automaton.trace import Arc, Jump, Outcome
from statechart.execution.execution import Execution
from statechart.execution.outcome import error_of


def streamed(
    made: Execution, parameters: Mapping[str, float], sampling: Sampling
) -> Iterator[Arc | Jump]:
    """Yield what an execution makes, as it makes it.

    Raises
    ------
    SimulationError
        Where the run cannot go on, after all that it made.
    """
    values, end, count = dict(parameters), made.until, 0
    record, seen = made.record, [0, 0]
    control = sampling.control

    def fresh() -> Iterator[Arc | Jump]:
        pieces: list[Arc | Jump] = [*record.arcs[seen[0] :], *record.jumps[seen[1] :]]
        seen[:] = len(record.arcs), len(record.jumps)
        yield from in_order(pieces)

    ended = False
    with made.told():
        ended = made.begin()
    while made.outcome is Outcome.HORIZON and not ended:
        if control is not None:
            changed = control(_sample(made))
            if changed:
                values |= changed
                with made.told():
                    ended = _change(made, values)
        yield from fresh()
        count += 1
        made.until = min(end, sampling.every * count) if count * sampling.every < end else end
        window = False
        while not window and made.outcome is Outcome.HORIZON and not ended:
            with made.told():
                window = made.advance()
            yield from fresh()
        ended = ended or made.until >= end
    yield from fresh()
    trace = made.trace()
    if not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
        raise error_of(trace)


def _change(made: Execution, overrides: Mapping[str, float]) -> bool:
    """Let an execution go on with other values of parameters; whether it ends there."""
    setup = made.automaton.setup(overrides, made.engine.tolerance)
    made.zeros, made.entered = setup.zeros, {}
    made.setup = replace(setup, modes=partial(made.modes.mode, zeros=setup.zeros))
    return made.settle()


def _sample(made: Execution) -> Sample:
    automaton = made.automaton
    states = zip((region.name for region in automaton.regions), made.flow.mode, strict=True)
    values = zip(automaton.names, made.state.tolist(), strict=True)
    return Sample(made.clock.high, dict(states), dict(values))
