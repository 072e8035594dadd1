"""Base of the time steppers of scenes: they are made, start, run and stream alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.scene.lint import replaced
from contacts.states import STATES
from contacts.time_stepping.loop import made_ready
from contacts.time_stepping.run_inputs import RunInputs, Span, Stepping
from contacts.time_stepping.stop_tapes import StopTapes
from contacts.time_stepping.stops import StopConditions
from statechart.arrays import Bools
from statechart.automaton.regions import Region, StopCondition
from statechart.automaton.time_stepper import (
    RECORD_ALL,
    USUAL,
    Impulses,
    RecordingPolicy,
    Sample,
    Sampling,
    in_order,
)
from statechart.automaton.trace import Arc, Jump, Key, Outcome, Trace
from statechart.documents.setting import Record
from statechart.errors import DeclarationProblem, Unsupported
from statechart.execution.outcome import error_of

_EPS = float(np.finfo(float).eps)

RELATIVE = 1e-9
"""Tolerances at the start, relative to the scene."""


class Stepper(ABC):
    """Steps a scene (see `statechart.automaton.time_stepper.TimeStepper`).

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations, or no more than its names and symbols.
    stops : sequence of StopCondition
    energy : Expr
    unknowns : sequence of Symbol
        What stop conditions may use that steps solve for.
    regions, controls, again, forces, sticks
        See `contacts.time_stepping.loop.Stepping`.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        stops: Sequence[StopCondition],
        energy: sp.Expr,
        unknowns: Sequence[sp.Symbol],
        *,
        regions: Sequence[Region],
        controls: Key = (),
        again: str,
        forces: int | None,
        sticks: Bools,
    ) -> None:
        self._mechanics, self._scene = mechanics, mechanics.scene
        self._stepping = Stepping(
            self._scene.name,
            (*mechanics.variable_names, *mechanics.memory),
            mechanics.parameters.names,
            tuple(region.name for region in regions),
            controls,
            again,
            forces,
            sticks,
            np.array([name.endswith(".angle") for name in mechanics.names]),
            StopTapes(mechanics, stops, unknowns, regions),
            tuple(stop.name for stop in stops),
            mechanics.whole_tape([energy]),
        )

    def start(self, overrides: Mapping[str, float]) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state; see `TimeStepper.start`."""
        begun = self._begin(overrides, 0.0, USUAL.tolerance, False)
        if begun.failure is not None:
            raise begun.failure
        states = tuple(STATES[code] for code in begun.codes.tolist())
        return (*states, *self._stepping.controls), (*begun.setup.warnings, *begun.warnings)

    def run(
        self,
        overrides: Mapping[str, float],
        *,
        step: float,
        until: float,
        max_jumps: int,
        show: Callable[[float, int, int], None],
        impulses: Impulses = USUAL,
        policy: RecordingPolicy = RECORD_ALL,
    ) -> Trace:
        """Run from the declared initial state; see `TimeStepper.run`."""
        record, watch = policy
        forces = record is not Record.NOTHING or (watch is not None and watch.motion)
        begun = self._able(overrides, step, until, impulses.tolerance, forces)
        span = Span(step, until, max_jumps, impulses, show, policy=policy)
        return made_ready(self._stepping, begun, span).whole()

    def stream(
        self,
        overrides: Mapping[str, float],
        sampling: Sampling,
        *,
        step: float,
        until: float,
        max_jumps: int,
        impulses: Impulses = USUAL,
    ) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps as they come; see `TimeStepper.stream`."""
        begun = self._able(overrides, step, until, impulses.tolerance)
        span = Span(step, until, max_jumps, impulses, lambda time, jumps, steps: None)
        return stream(self._stepping, begun, span, sampling, overrides)

    def _able(
        self, overrides: Mapping[str, float], step: float, until: float, allowed: float,
        forces: bool = True,
    ) -> RunInputs:  # fmt: skip
        """Return a run by steps that are long enough to move anything."""
        read = forces or bool(self._stepping.stop_names) or bool(self._stepping.controls)
        begun = self._begin(overrides, step, allowed, read)
        scales = begun.setup.scales
        least = _EPS * scales.length / scales.speed
        if step < min(least, until):
            raise DeclarationProblem(
                f"in a step of {step:g} what moves at {scales.speed:.3g} goes less far than the "
                f"rounding of {scales.length:.3g}, the size of the scene",
                advice=f"take {least:.1g} or more",
                loc=("settings", "step"),
            )
        return begun

    @abstractmethod
    def _begin(
        self, overrides: Mapping[str, float], step: float, allowed: float, forces: bool
    ) -> RunInputs:
        """Check the initial state; return a run by steps of this length, or why there is none.

        Forces need not be found where nobody reads them.
        """

    def _lacks(self, setup: SceneSetup) -> tuple[str, ...]:
        """Return what differs from the declaration."""
        values = dict(zip(self._stepping.parameter_names, setup.values.tolist(), strict=True))
        return tuple(f"{what}: {why}" for what, why in replaced(self._scene, values).items())


def stream(
    stepping: Stepping,
    begun: RunInputs,
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
