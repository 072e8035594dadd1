"""The unambiguous instants of a scene, compiled (see `statechart.automaton.laws.CompiledLaws`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, cast

from contacts.dynamics.projection import Projection
from contacts.dynamics.setup import SceneInstant, SceneSetup
from contacts.dynamics.setup_evaluation import SceneNumbers
from contacts.dynamics.snapshot import SnapshotTape
from contacts.event_driven.decision import cause
from contacts.event_driven.impact_jump import flow_in
from contacts.event_driven.scene_loop import SceneLoop, run_batch
from contacts.event_driven.switching import alike
from contacts.impacts.impact import segment_names
from contacts.impacts.impulses import STATES as IMPULSE_STATES
from contacts.states import CODES, OFF, OFF_CODE
from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.automaton.laws import Flow, JumpResult, roles_in
from statechart.automaton.lazy import LazyMapping
from statechart.automaton.trace import Jump, Key, Roles
from statechart.automaton.trace_store import RecordedEvent
from statechart.execution.compiled_loop import Loop
from statechart.formulas.tape import Tape
from statechart.kernels.jit import Kernel, is_ready


class CompiledSceneLaws:
    """Compiled laws of a scene without joints; `ask` are the laws in Python."""

    def __init__(
        self,
        names: tuple[str, ...],
        numbers: SceneNumbers,
        snapshots: SnapshotTape,
        projection: Projection,
        ask: Callable[[SceneInstant], JumpResult],
    ) -> None:
        self._names, self._projection, self._ask = names, projection, ask
        self._numbers, conditions, limits = numbers, numbers.conditions, numbers.limits
        self.setup = numbers.at
        self.tapes: tuple[Tape, ...] = snapshots.tape, projection.tape, conditions.tape
        if limits is not None:
            scales = numbers.scale_tape
            self.tapes += limits, scales.tape, scales.motions, numbers.stop_tape
        self._of_margins = {name: k for k, name in enumerate(conditions.names, 1)}
        self._of_margins |= {name: -k for k, name in enumerate(conditions.back, 1)}
        self._conditions = conditions
        self.warnings, self.has_remarks = numbers.lint, conditions.present
        self.series = tuple((name, "touchdown") for name in names)

    def compiled(self) -> bool:
        """Return whether the compiled loop is cached on disk."""
        return cast(Kernel, run_batch).is_cached

    def ready(self) -> bool:
        """Return whether it is cached and this process has loaded the compiler."""
        return is_ready(run_batch)

    def listed(self, mode: Key, roles: Roles, margins: Sequence[str]) -> Sequence[int] | None:
        """Return the state codes of the contacts, then the condition number of every margin.

        Conditions are numbered from 1 on, negative for margins that bring a contact back, 0 for
        none. Returns None if a contact moves in another state than it is shown in.
        """
        if roles != roles_in(mode):
            return None
        states = [OFF_CODE if state == OFF else CODES[state] for state in mode]
        return [*states, *(self._of_margins.get(name, 0) for name in margins)]

    def tolerances(self, setup: SceneSetup, state: Array, time: float) -> Mapping[str, float]:
        """Return the special tolerances of margins in a flow from a state, by margin."""
        tolerances = self._conditions.at(setup, state, time).tolerances()
        return {**setup.bands, **tolerances} if tolerances else setup.bands

    def takes(self, setup: SceneSetup, flow: Flow, state: Array, time: float) -> bool:
        """Return whether a flow skips no bounces and has the default tolerances."""
        conditions = self._conditions
        own = {*conditions.names, *conditions.back, *conditions.gaps}
        special = {n: t for n, t in flow.tolerances.items() if n not in own}
        regular = flow.tolerances is setup.bands or special == setup.bands
        regular = regular and alike(conditions.at(setup, state, time).tolerances(), flow.tolerances)
        return regular and flow.remaining == math.inf and not flow.held and not flow.near_bound

    def within(self, mode: Key) -> Tape | None:
        """Return the tape that detects bumps of a surface that a step missed."""
        return self._projection.missed_surface_tape(mode)

    def call(self, loop: Loop, relative: float) -> SceneLoop:
        """Return calls of the loop."""
        return SceneLoop(self._numbers, loop, relative)

    def about(self, event: RecordedEvent) -> tuple[str, str]:
        """Return the contact that an event is about, and its cause."""
        if event.struck >= 0:
            return self._names[event.struck], "touchdown"
        return cause(self._names, event.source, event.target, False)

    def jump(self, setup: Callable[[], SceneSetup], event: RecordedEvent, fired: str) -> Jump:
        """Return the jump of an event recorded by the loop."""
        region, cause = self.about(event)
        impulse: Mapping[str, tuple[float, float]] = {}
        path: tuple[str, ...] = ()
        explained = partial(self._explain, setup, event, fired)
        if event.struck >= 0 and event.group == 0:
            path = (" ".join([region, *segment_names(event.path)]),)
            if event.normal != 0.0 or event.tangential != 0.0:
                impulse = {region: (event.normal, event.tangential)}
        elif event.struck >= 0:
            path = (f"plastic {', '.join(self._modes(event))}",)
            impulse = LazyMapping(partial(explained, "impulse"))
        return Jump(
            event.t, event.j, region, cause, event.source, event.target, event.before, event.after,
            (fired,) if fired else (), impulse, path, LazyMapping(partial(explained, "considered")),
            (event.energy_before, event.energy_after),
        )  # fmt: skip

    def _explain(
        self, setup: Callable[[], SceneSetup], event: RecordedEvent, fired: str, field: str
    ) -> Mapping[str, Any]:
        """Return `impulse` or `considered` of a jump, computed by the laws in Python on demand."""
        numbers = setup()
        flow, clock = flow_in(numbers, event.source), Clock(event.t)
        at = SceneInstant(numbers, clock, event.j, flow, event.before, (fired,) if fired else ())
        result = self._ask(at)
        assert result is not None
        mapping: Mapping[str, Any] = getattr(result[0], field)
        return mapping

    def _modes(self, event: RecordedEvent) -> Iterator[str]:
        """Yield the modes of the contacts of a group in a plastic impact."""
        group, code = event.group, event.path
        for place, name in enumerate(self._names):
            if group >> place & 1:
                yield f"{name}:{IMPULSE_STATES[code & 7]}"
                code >>= 3
