"""A run by steps as it comes; see `statechart.automaton.time_stepper.TimeStepper.stream`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from contacts.time_stepping.begun import Begun, Span, Stepping
from contacts.time_stepping.loop import made_ready
from contacts.time_stepping.stops import StopConditions
from statechart.automaton.sampling import Sample, Sampling, in_order
from statechart.automaton.trace import Arc, Jump, Outcome
from statechart.errors import Unsupported
from statechart.execution.outcome import error_of


def stream(
    stepping: Stepping,
    begun: Begun,
    span: Span,
    sampling: Sampling,
    parameters: Mapping[str, float],
) -> Iterator[Arc | Jump]:
    """Yield arcs and jumps of a run of a scene as they come, an arc ending with every chunk."""
    if sampling.control is not None and begun.change is None:
        raise Unsupported(
            "time steps change parameters of scenes alone whose bodies do not collide by their "
            "shapes and that have no controllers of their own; take the engine taylor or scipy"
        )
    made = made_ready(stepping, begun, span._replace(every=sampling.every))
    recorder, values = made.recorder, dict(parameters)
    seen = [0, 0]

    def fresh() -> list[Arc | Jump]:
        recorder.close()
        found: list[Arc | Jump] = [*recorder.arcs[seen[0] :], *recorder.jumps[seen[1] :]]
        seen[:] = len(recorder.arcs), len(recorder.jumps)
        return in_order(found)

    for _ in made.chunks():
        yield from fresh()
        if sampling.control is None or begun.change is None:
            continue
        mode = dict(zip(stepping.regions, recorder.key, strict=True))
        state = dict(zip(stepping.names, made.state.tolist(), strict=True))
        changed = sampling.control(Sample(made.time, mode, state))
        if changed:
            values |= changed
            setup = begun.change(values)
            made.stops = StopConditions(stepping, setup)
    yield from fresh()
    trace = made.trace()
    if not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
        raise error_of(trace)
