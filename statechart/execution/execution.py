"""Execution on hybrid time: flow to the first event, evaluate the laws, jump, repeat."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart import errors, interrupts
from statechart.automaton.clock import Clock, between
from statechart.automaton.laws import UNBOUNDED, Flow, Instant, Setup, flow_sizes, roles_in
from statechart.automaton.regions import Margin
from statechart.automaton.switches import is_of_switch
from statechart.automaton.time_stepper import Sample, Sampling, unread
from statechart.automaton.trace import Arc, Jump, Key, Outcome, Roles, Trace, check_size
from statechart.automaton.trace_store import TraceStore
from statechart.engines.engine import FlowWatch, Path
from statechart.engines.event_location import Crossing
from statechart.execution import compiled_loop as runs
from statechart.execution.compiled_loop import LOOK_AHEAD, Batch, LoopModes
from statechart.execution.compiled_modes import CompiledMode, CompiledModes
from statechart.execution.event_classification import closing, from_here, only_stops
from statechart.execution.filippov import Filippov
from statechart.execution.flow import FOLLOWED, UNFOLLOWED, Advance
from statechart.execution.livelock import JUMPS_AT_ONCE, Livelock, check_pace, loop_error
from statechart.execution.outcome import TWO_BOUNDS, Progress, error_of
from statechart.execution.slow_start import slow_start_warning
from statechart.execution.zeno import Accumulation, summed
from statechart.formulas.series import sizes_at
from statechart.kernels.polynomials import term_sizes
from statechart.kernels.tapes import SIGN
from statechart.tabular import pluralise

if TYPE_CHECKING:
    from statechart.automaton.constraints import Constraints
    from statechart.execution.certificate import Certificate

# Change of a variable over a step, relative to its size, above which its rate is unbounded.
_STEEP = 1e6
# Factor by which the tolerance of an undecidable margin is widened, and its limit.
_WIDENING, _MAX_WIDENING = 16.0, 1e4
# Distance in time, in its last digits, at which enclosures tell a time from a sign's change.
PASSED = 8.0
# First horizon of a flow without a scale, whose powers do not overflow.
FARTHEST = 1e12


@dataclass(eq=False)
class Execution:
    """State of a run of an automaton."""

    modes: CompiledModes  # Automaton and engine, with the modes entered in this run or before.
    path: Path  # Buffer of the steps of the current flow.
    record: TraceStore  # Arcs and jumps so far.
    setup: Setup
    zeros: frozenset[int]  # Indices of the parameters that are exactly zero.
    until: float  # End of the run.
    progress: bool  # Report to stderr.
    loop: LoopModes | None = None  # Compiled event loop, if the automaton has one.
    certificate: Certificate | None = None  # Collects error bounds, if they are to be proved.
    batch_start: Batch | None = None  # First part of the run, by the compiled loop.
    clock: Clock = field(default_factory=Clock)
    outcome: Outcome = Outcome.HORIZON
    message: str = ""
    warnings: dict[str, None] = field(default_factory=dict)
    evidence: dict[str, str] = field(default_factory=dict)
    boxes: int = 0
    steps: int = 0
    instants: int = 0
    entered: dict[Roles, CompiledMode] = field(default_factory=dict)
    grazed: bool = False
    failure: errors.SimulationError | None = None

    def __post_init__(self) -> None:
        self.automaton, self.engine = self.modes.automaton, self.modes.engine
        self.flow: Flow  # from `begin` on
        self.state = self.started_state = self.setup.initial
        self.started_mode: Key | None = None
        self.horizon = min(self.setup.horizon, FARTHEST)
        self.evaluations = self.engine.evaluations
        self._progress = Progress(self.until)
        self.accumulation = Accumulation(() if self.loop is None else self.loop.series)
        if self.batch_start is not None:
            self.accumulation.series = self.batch_start.series.copy()
        self._boundary: Crossing | None = None  # where the rates end
        self._livelock = Livelock(min(self.horizon, self.until))
        self._filippov = Filippov(self.modes) if self.automaton.switching else None
        self._signs_of_time = self.automaton.signs_of_time
        self.passed_roles: dict[int, Roles] = {}  # see `Trace`
        self._switched: tuple[Any, ...] = ()  # key of the current flow, see `_switch`
        self._switch_tolerances: dict[str, float] = {}  # in the current flow
        self._sizes = np.zeros(len(self.state))  # largest magnitudes so far, with switches

    def run(self) -> Trace:
        """Run to the end; return the trace, also of a run that failed."""
        with self.ending():
            ended = self.begin()
            while not ended:
                ended = self.advance()
        return self.trace()

    @contextmanager
    def ending(self, at: str = "") -> Iterator[None]:
        """Turn interrupts and simulation errors into outcomes of the run, with the place `at`."""
        try:
            with interrupts.deferred():
                yield
        except KeyboardInterrupt:
            self._end(Outcome.INTERRUPTED, "interrupted by the user")
        except errors.SimulationError as error:
            started = self.started_mode is not None
            location = self.automaton.label(self.flow.mode) if started else "at the start"
            place = f"{at}mode {location}: " if location else at
            self._end(Outcome[error.outcome], f"{place}{error}")
        finally:
            self._progress.close()

    def _end(self, outcome: Outcome, message: str) -> None:
        self.outcome, self.message = outcome, message

    def stream(self, parameters: Mapping[str, float], sampling: Sampling) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps as they are computed; parameters may be set between samples."""
        values, end, count = dict(parameters), self.until, 0
        fresh = unread(self.record.arcs, self.record.jumps)
        ended = False
        with self.ending():
            ended = self.begin()
        while self.outcome is Outcome.HORIZON and not ended:
            changed = None if sampling.control is None else sampling.control(self._sample())
            if changed:
                values |= changed
                with self.ending(f"t = {self.clock.high:.6g}: "):
                    ended = self._change(values)
            yield from fresh()
            count += 1
            self.until = min(end, sampling.every * count) if count * sampling.every < end else end
            window = False
            while not window and self.outcome is Outcome.HORIZON and not ended:
                with self.ending():
                    window = self.advance()
                yield from fresh()
            ended = ended or self.until >= end
        yield from fresh()
        trace = self.trace()
        if not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)

    def _sample(self) -> Sample:
        states = zip(self.automaton.region_names, self.flow.mode, strict=True)
        values = zip(self.automaton.names, self.state.tolist(), strict=True)
        return Sample(self.clock.high, dict(states), dict(values))

    def _change(self, overrides: Mapping[str, float]) -> bool:
        setup = self.automaton.setup(overrides, self.engine.tolerance)
        self.zeros, self.entered = setup.zeros, {}
        before = self.setup
        self.setup = replace(setup, modes=partial(self.modes.mode, zeros=setup.zeros))
        jump, flow = self.automaton.laws_of_events.change(self._instant(), before)
        self.state = self.state if flow.start is None else flow.start
        self.flow = flow._replace(start=None)
        if jump is not None:
            self.record.add_jump(jump)
        return self.settle()

    def begin(self) -> bool:
        """Find the first mode; return whether the run ends there."""
        if self.batch_start and self.loop:
            kind = self.batch_start.kinds[self.batch_start.result.ends.item(runs.FIRST_MODE)]
            self.flow = self.loop.flow(self.setup, kind, self.state, 0.0)
        else:
            self.flow, self.state = self.automaton.laws_of_events.begin(self.setup)
        self.started_mode, self.started_state = self.flow.mode, self.state
        self._warn()
        settled = self.flow.settled and self._filippov is None
        return self._stop_holds() if settled else self.settle()

    def advance(self) -> bool:
        """Flow to the next event and jump; return whether the run ends."""
        fired = None if self.loop is None else self._run_compiled(self.loop)
        if fired is None:
            fired = self._flow()
        if self.outcome is not Outcome.HORIZON:
            return True
        if fired:
            return self.settle(fired)
        if not self._ending() or not self.settle():
            self.message = f"reached t = {self.clock.high:.6g}"
        return True

    def _run_compiled(self, loop: LoopModes) -> tuple[str, ...] | None:
        """Run the compiled loop; return the margins that fired, () at the end of the run.

        Returns None if the next flow must be computed in Python.
        """
        while True:
            batch, self.batch_start = self.batch_start, None
            jumps, arcs = 0, 0
            if batch is None:
                jumps, arcs = len(self.record.jumps), len(self.record.arcs)
                since = self.record.jumps[-1].t if self.record.jumps else 0.0
                clock = np.array([*self.clock, self.until, self.horizon, since, 0.0])
                batch = loop.resume(
                    self.setup, self.flow, clock, (jumps, self.automaton.max_jumps), self.state,
                    self.record.buffer, self.accumulation.series, self.zeros,
                )  # fmt: skip
                if batch is None:
                    return None
            self._apply_loop_result(loop, batch, jumps, arcs)
            reason, margin = batch.result.ends[0, runs.REASON : runs.MARGIN + 1].tolist()
            if reason in (runs.FULL, runs.PAUSED):
                continue
            if reason == runs.OVER:
                return ()
            if reason == runs.FLOW:
                return None
            if reason == runs.FELL and margin >= 0:
                return self.resolve_fall(loop.compiled[self.flow.mode, self.flow.roles], margin)
            if reason == runs.ACCUMULATES:
                row, rest = self.accumulation.series[margin], batch.result.clock[0, runs.T_REST]
                self._skip_by(summed(row, float(rest)))
            if reason in (runs.ACCUMULATES, runs.COUNTED) and self.reaches_jump_limit():
                return ()
            if not self.flow.settled and self.settle():
                return ()

    def _apply_loop_result(self, loop: LoopModes, batch: Batch, jumps: int, arcs: int) -> None:
        """Update the run from the result of the loop; it had this many jumps and arcs before."""
        record, flow = self.record, self.flow
        clock, place, ends = batch.result.clock[0], batch.result.place[0], batch.result.ends[0]
        for (_, roles), compiled in batch.entered():
            self.entered.setdefault(roles, compiled)
        if ends[runs.REASON] == runs.FULL:
            record.seal()
        self.clock, self.state = Clock(*clock[: runs.T_LOW + 1].tolist()), batch.result.final[0]
        self.horizon = clock.item(runs.T_HORIZON)
        self.steps += place.item(runs.N_STEPS)
        self.boxes += place.item(runs.N_BOXES)
        self.show()
        interrupts.check()
        jumped, flew = place[runs.N_JUMPS] > jumps, len(record.arcs) > arcs
        if jumped:
            kind = batch.kinds[place[runs.N_MODE]]
            flow = loop.flow(self.setup, kind, self.state, self.clock.high)
            values = batch.result.values[0]
            flow = flow._replace(settled=bool(place[runs.N_RETRY] == 0), values=values)
        if ends[runs.REASON] == runs.OVER or (
            ends[runs.REASON] == runs.FELL and ends[runs.MARGIN] >= 0
        ):
            terms = flow.terms
            if flew and record.arcs[-1].j == place[runs.N_JUMPS]:
                arc = record.arcs[-1]
                terms = term_sizes(arc.times, arc.coefficients)
            flow = flow._replace(settled=False, terms=terms, warning="", notes=(), start=None)
        self.flow = flow

    def _flow(self) -> tuple[str, ...]:
        """Flow to the next event; return the margins that fired, () at the end of the run."""
        interrupts.check()
        self._switch()
        flow = self.flow
        remaining = flow.remaining
        if flow.held:
            remaining = min(remaining, *(between(self.clock, end) for end in flow.held.values()))
        duration = min(self.clock.until(self.until), remaining)
        if duration <= 0.0:
            return ("zeno",) if remaining <= 0.0 else ()
        laws, start = self.automaton.laws_of_events, self.clock.high
        constraints = laws.constraints(self.setup, flow.roles, start, self.state)
        compiled = self._enter(flow.moving)
        if self.loop is not None:
            self.loop.add(flow.mode, flow.roles, compiled)
        if flow.near_bound:
            flow = self.flow = from_here(compiled, flow, self.setup, self.state, self.clock.high)
        watch = self._watch(flow, compiled, constraints)
        initial = watch.reconstruction.onto(self.state, watch.start)
        on_steps = self.show if self.progress else None
        reached = Advance(
            self.engine, compiled, self.path, watch, initial, duration, self.horizon, on_steps
        ).run()
        self._record_arc(flow, reached)
        if isinstance(reached.failure, errors.StepFailure | errors.NonFinite | errors.TooLong):
            self.failure, self._boundary = reached.failure, reached.crossing
            return (UNBOUNDED,)
        if reached.failure is not None:
            raise reached.failure
        check_size(0, len(self.record.made), self.clock.high)
        if reached.crossing is None:
            return ("zeno",) if duration == remaining else ()
        return self.resolve_fall(compiled, reached.crossing.guard, graze=reached.graze)

    def _switch(self, fired: tuple[str, ...] = (), *, accumulates: bool = False) -> None:
        """Determine the signs of the switching functions for the next flow.

        Where switches accumulate, a spiral shrinks into its limit, with its own scales.
        """
        if self._filippov is None:
            return
        flow, known = self.flow, self._switched
        now = flow.roles, len(self.record.jumps), self.clock
        if not fired and known[:3] == now and known[4] is self.state:
            self.flow = flow._replace(signs=known[3])
            return
        self._measure()
        before = known[3][0].share if known[:2] == now[:2] and known[3] else None
        self.flow = flow._replace(signs=())
        at = self._instant(*fired)
        if accumulates:
            at = at._replace(flow=self.flow._replace(summed=self.engine.sizes))
        try:
            found = self._filippov.resolved(at, self.zeros, before)
        except errors.SingularMode:
            # Constraints that have just closed may share loads, which the laws decide next.
            if flow.settled:
                raise
            self.flow = flow
            return
        self.flow = flow._replace(signs=found.roles)
        self.state, self._switch_tolerances = found.state, found.tolerances
        self._switched = (*now, found.roles, self.state)
        for text in found.warnings:
            self.warnings.setdefault(f"t = {self.clock.high:.6g}: {text}", None)

    def _pass_sign_changes(self) -> None:
        """Advance the clock by round-off where a sign of the time changes: forces jump there."""
        signs, time = self._signs_of_time, self.clock.high
        step = PASSED * math.ulp(time)
        if signs is not None and time > 0.0:
            sides = [signs.values(self.state, self.setup.values, time + d) for d in (-step, step)]
            if (sides[0] * sides[1] <= 0.0).any():
                self.clock = self.clock.later(step)

    def _measure(self) -> None:
        """Update the engine's sizes of variables: their largest magnitudes so far.

        A variable that has always been zero, as of a slide that starts at rest, has the size of the
        largest one that moves.
        """
        if self.setup.sizes is not None:
            return
        terms = np.abs(self.state) if self.flow.sizes is None else self.flow.sizes
        self._sizes = np.max([self._sizes, terms, np.abs(self.state)], axis=0)
        varying = np.array(self.modes.mode(self.flow.roles, self.zeros).varying)
        largest = self._sizes.max(initial=0.0, where=varying)
        sizes = np.where(self._sizes > 0.0, self._sizes, largest)
        self.engine.sizes = sizes if sizes.all() else None

    def _enter(self, roles: Roles) -> CompiledMode:
        compiled = self.entered.get(roles)
        if compiled is None:
            with interrupts.let_through():
                compiled = self.modes.compiled(roles, self.zeros)
            self.entered[roles] = compiled
        return compiled

    def _watch(self, flow: Flow, compiled: CompiledMode, constraints: Constraints) -> FlowWatch:
        setup, start, special = self.setup, self.clock.high, flow.tolerances
        special = {**special, **self._switch_tolerances} if self._switch_tolerances else special
        allowed = [special.get(name, setup.tolerances[kind]) for name, kind in compiled.watched]
        reconstruction = compiled.reconstruction.start(self.state, setup.values, start)
        values = setup.values if flow.values is None else flow.values
        return FlowWatch(
            compiled.guards, np.array(allowed), constraints, values, start, reconstruction
        )

    def _record_arc(self, flow: Flow, reached: Advance) -> None:
        """Record the steps of a flow as an arc, and go to its end."""
        path = self.path
        if reached.unfollowed is not None:
            self.evidence["motion"] = UNFOLLOWED
            self.warnings[f"from t = {reached.unfollowed:.6g} on {UNFOLLOWED}"] = None
        self.boxes += reached.boxes
        self.steps += path.count
        self.show()  # flows that end in their first steps say nothing themselves
        elapsed, terms = 0.0, flow.terms
        if path.count > 0:
            times, coefficients = path.arc()
            elapsed, terms = times.item(-1), term_sizes(times, coefficients)
            self.record.add_arc(flow.mode, flow.moving, self.clock, times, coefficients)
            if self.certificate is not None:
                self.certificate.flow(self.record.arcs[-1], self._enter(flow.moving))
        self.clock = self.clock.later(elapsed)
        if elapsed > 0.0:
            # A mode may continue after the fall of a margin without a jump.
            since = self.record.jumps[-1].t if self.record.jumps else 0.0
            self.horizon = LOOK_AHEAD * max(elapsed, self.clock.high - since)
        self.state = reached.state
        following = Flow(
            flow.mode, flow.roles, flow.remaining - elapsed, near_bound=flow.near_bound
        )
        self.flow = following._replace(
            held=flow.held, tolerances=flow.tolerances, terms=terms, values=flow.values,
            signs=flow.signs,
        )  # fmt: skip

    def resolve_fall(
        self, compiled: CompiledMode, guard: int, *, graze: bool = False
    ) -> tuple[str, ...]:
        """Return the margins that fired; a stop ends the run if no other event coincides."""
        margin, self.grazed = compiled.mode.margins[guard], graze
        # A guard that falls at the end of a smooth piece is evaluated in the next piece.
        if switch := self._switch_margin(compiled, margin):
            return (switch,)
        # Stop margins are the last ones.
        count = len(self.automaton.stop_margins)
        stops = guard >= len(compiled.mode.margins) - count
        if graze and stops and self._unbounded():
            # Near unbounded rates other margins are dominated by round-off.
            return (UNBOUNDED,)
        if graze:
            self.evidence[margin.name] = "graze: touches zero within the last bits of time"
            self.warnings[f"{margin.name} grazes zero at t = {self.clock.high:.6g}"] = None
        elif (beyond := -self._hidden(margin.name, margin.kind)) > 0.0:
            self._warn_hidden(margin.name, beyond)
        if stops:
            taped = self.modes.taped(self.flow.moving, self.zeros)
            at, laws = self._instant(margin.name), self.automaton.laws_of_events
            if met := self.modes.stops.judge_fall(taped.mode, taped.guards, at):
                # Other events of this instant come first.
                at = self._instant()
                result = None if only_stops(compiled, at, count) else laws.jump(at)
                if result is None or result[0] is None:
                    self._stop(met)
        return (margin.name,)

    def _switch_margin(self, compiled: CompiledMode, margin: Margin) -> str | None:
        """Return the margin of a switch that falls with `margin`, or None."""
        if is_of_switch(margin.name):
            return margin.name
        tolerances = self._switch_tolerances if margin.kind == "plain" else {}
        if not tolerances:
            return None
        values = compiled.guards.values(self.state, self.setup.values, self.clock.high).tolist()
        rows = zip(compiled.watched, values, strict=True)
        return next((name for (name, _), v in rows if abs(v) <= tolerances.get(name, -1.0)), None)

    def _fell_at_last(self) -> tuple[str, ...]:
        """Return the guard on whose boundary the rates end, as h <= 0 for h' = -1/h.

        The end is the zero of the base of a root, or recognised by steps that become too short, not
        by an unbounded state.
        """
        compiled, setup, state = self._enter(self.flow.moving), self.setup, self.state
        if self._boundary is not None:
            return self.resolve_fall(compiled, self._boundary.guard)
        if not isinstance(self.failure, errors.StepFailure):
            return ()
        guards, time = compiled.guards, self.clock.high
        sizes, places = flow_sizes(setup, self.flow, state), tuple(range(len(guards.outputs)))
        terms = sizes_at(guards, places, state, sizes, setup.values, time)
        near = np.abs(guards.values(state, setup.values, time)) <= setup.precision * np.array(terms)
        return self.resolve_fall(compiled, int(near.argmax())) if near.any() else ()

    def _unbounded(self) -> bool:
        """Return whether rates have become unbounded and a jump resolves that."""
        flow, laws = self.flow, self.automaton.laws_of_events
        if flow.terms is None or not self.record.arcs:
            return False
        sizes = np.abs(self.record.arcs[-1].coefficients[:, :, 0]).max(axis=0)
        steep = bool((np.abs(flow.terms[:, -1]) > _STEEP * sizes).any())
        return steep and laws.jump(self._instant(UNBOUNDED)) is not None

    def _instant(self, *fired: str) -> Instant:
        return Instant(self.setup, self.clock, len(self.record.jumps), self.flow, self.state, fired)

    def _ending(self) -> bool:
        """Return whether an event coincides with the end of the run within the tolerances.

        Such an event belongs to the run. Gaps and slips are located below zero, and a guard may
        miss its boundary by the error of the run.
        """
        compiled = self.entered.get(self.flow.moving)
        if compiled is None:
            return False
        flow = self.flow
        if self._switch_tolerances:
            flow = flow._replace(tolerances={**flow.tolerances, **self._switch_tolerances})
        happens, tolerances = closing(
            self.engine, compiled, flow, self.setup, self.state, self.clock.high
        )
        self.flow = self.flow._replace(tolerances=tolerances)
        return happens

    def _warn(self) -> None:
        self.warnings |= dict.fromkeys(self.flow.notes)
        if self.flow.warning:
            self.warnings[f"t = {self.clock.high:.6g}: {self.flow.warning}"] = None

    def settle(self, fired: tuple[str, ...] = ()) -> bool:
        """Jump until the mode holds; return whether the run ends."""
        laws = self.automaton.laws_of_events
        self.instants += 1
        projected = False
        self._pass_sign_changes()
        if fired and is_of_switch(fired[0]):
            if not self.automaton.stop_margins:
                self._livelock.switched(self.clock, self.until)
            accumulates = self._livelock.rearranged(self.clock, fired)
            if self.certificate is not None:
                self.certificate.switch(self._instant(*fired))
            self._switch(fired, accumulates=accumulates)
            fired = ()
        for _ in range(JUMPS_AT_ONCE):
            self._switch()
            result = laws.jump(self._instant(*fired))
            if result is None:
                break
            jump, following = result
            if jump is None:
                if (following.roles, following.tolerances) != (
                    self.flow.roles,
                    self.flow.tolerances,
                ):
                    projected = True
                    self._livelock.rearranged(self.clock, fired)
                if following.start is not None:
                    self.state = following.start
                self.flow = following._replace(start=None)
                if projected:
                    self._warn()
                continue
            projected = True
            if self.certificate is not None:
                self.certificate.jump(self._instant(*fired), jump)
            self._record_load_sharing()
            self.flow = following
            self._warn()
            self.record.add_jump(jump)
            self.state = jump.after
            self._skip(jump)
            fired = ()
            if self.reaches_jump_limit():
                return True
            # Switching forces depend on the state after the jump.
            if self.flow.settled and self._filippov is None:
                break
        else:
            raise loop_error(self.record.jumps[-6:], self.clock, self.automaton)
        if fired and not projected:
            if self.failure is not None:
                if fired != (UNBOUNDED,) or not (last := self._fell_at_last()):
                    raise self.failure
                return self.outcome is Outcome.STOPPED or self.settle((*last, UNBOUNDED))
            if self._livelock.stalled(self.clock, fired) and not self._widen(*fired):
                advice = ""
                if self.flow.signs:
                    advice = (
                        "; instead of sign write couplings: {f: {bodies: [a], limit: F}}, "
                        "or a contact"
                    )
                elif dict(self.entered[self.flow.moving].watched).get(fired[0]) == "plain":
                    advice = f"; {TWO_BOUNDS}"
                elif SIGN in self.entered[self.flow.moving].guards.code[:, 0]:
                    other = "" if self.engine.name == "taylor" else "take the engine taylor, or "
                    advice = f"; a sign jumps there: {other}write a state for each side"
                self.failure = errors.EventLoop(
                    f"{', '.join(fired)} falls at t = {self.clock.high:.6g}, but no jump follows"
                    + advice
                )
                return self.settle((UNBOUNDED,))
        self.failure = self._boundary = None
        return self._stop_holds()

    def _stop_holds(self) -> bool:
        """Return whether a stop condition on its boundary ends the run."""
        if judge := self.modes.stops:
            taped = self.modes.taped(self.flow.moving, self.zeros)
            met, self.flow = judge.judge_start(taped.mode, taped.guards, self._instant())
            if met:
                self._stop(met)
        return self.outcome is Outcome.STOPPED

    def _record_load_sharing(self) -> None:
        """Record the load sharing of a mode that ends without an arc."""
        arcs, jumps, roles = self.record.arcs, len(self.record.jumps), self.flow.moving
        if roles != roles_in(self.flow.mode) and not (len(arcs) and arcs[-1].j == jumps):
            self.passed_roles[jumps] = roles

    def _stop(self, condition: str) -> None:
        self._record_load_sharing()
        self.record.add_jump(self._instant(condition).jump("", "stop", self.flow.mode))
        self._end(Outcome.STOPPED, f"{condition} at t = {self.clock.high:.6g}")

    def reaches_jump_limit(self) -> bool:
        """Return whether the run ends by the limit of the number of jumps.

        Raises `TooLong` or `EventLoop` if the number is certain to exceed the limit, or if jumps
        take no time.
        """
        self._livelock.check(self.record.jumps, self.clock, self.automaton)
        most = self.automaton.max_jumps
        if not self.automaton.stops:
            check_pace(self.record.jumps, self.clock, self.until, most)
        if too_many := len(self.record.jumps) >= most:
            self._end(Outcome.TOO_MANY_JUMPS, pluralise(most, "jump"))
        return too_many

    def _skip(self, jump: Jump) -> None:
        pair, flowed = (jump.region, jump.cause), bool(jump.fired)
        if self.loop is not None and pair not in self.loop.series:
            return  # It cannot accumulate, and compiled code does not count it.
        remaining = self.accumulation.watch(pair, self.clock, self.setup.short, flowed=flowed)
        if remaining is not None:
            self._skip_by(remaining)

    def _skip_by(self, remaining: float) -> None:
        recent, laws = self.record.jumps[-JUMPS_AT_ONCE:], self.automaton.laws_of_events
        result = laws.accumulate(self.setup, self.clock, self.flow, recent, remaining)
        if result is not None:
            jump, self.flow = result
            self.record.replace_last(jump)
            self.state = jump.after
            self._warn()

    def _widen(self, margin: str) -> bool:
        """Widen the tolerance of a margin that is zero to round-off; False at the limit.

        The enclosure of a force that is identically zero (balls that fall side by side) can be
        wider than its tolerance.
        """
        kind = dict(self.entered[self.flow.moving].watched).get(margin)
        if kind is None or not (self.grazed or kind == "speed"):
            return False
        default = self.setup.tolerances[kind]
        before = self.flow.tolerances.get(margin, default)
        hidden = abs(self._hidden(margin, kind))
        # An enclosure that reaches from here to zero is below zero at twice its width.
        widened = 2.0 * hidden or _WIDENING * before
        if widened <= before or (not hidden and widened > _MAX_WIDENING * default):
            return False
        self.flow = self.flow._replace(tolerances={**self.flow.tolerances, margin: widened})
        if hidden:
            self._warn_hidden(margin, hidden)
        else:
            warning = f"{margin} is zero to round-off; its tolerance there is {widened:.3g}"
            self.warnings[f"t = {self.clock.high:.6g}: {warning}"] = None
        return True

    def _hidden(self, margin: str, kind: str) -> float:
        """Return a force's distance from its bound beyond what wider tolerances explain, or 0.0."""
        compiled = self._enter(self.flow.moving)
        # Forces with a sign jump.
        if kind not in ("force", "hold") or SIGN in compiled.guards.code[:, 0]:
            return 0.0
        values = compiled.guards.values(self.state, self.setup.values, self.clock.high)
        value = values.item(compiled.names.index(margin))
        return value if abs(value) > _MAX_WIDENING * self.setup.tolerances[kind] else 0.0

    def _warn_hidden(self, margin: str, size: float) -> None:
        self.warnings[
            f"{margin} is known to {size:.2g} only where it falls at t = {self.clock.high:.6g}: "
            "nearly dependent constraints magnify round-off"
        ] = None

    def show(self, local: float = 0.0, steps: int = 0) -> None:
        """Report progress, if it is enabled."""
        if self.progress:
            time, jumps = self.clock.high + local, len(self.record.jumps)
            self._progress.show(time, jumps, self.steps + steps)

    def trace(self) -> Trace:
        """Return the trace of a run that has ended."""
        automaton, engine = self.automaton, self.engine
        evidence = evidence_of(compiled.names for compiled in self.entered.values()) | self.evidence
        motion = None if self.certificate is None else self.certificate.motion()
        if motion is not None:
            evidence["motion"] = str(motion)
        proved = motion is not None and motion.proved
        unproved = self.evidence.keys() - ({"motion"} if proved else set())
        decided = not unproved and self.outcome not in (Outcome.UNDECIDED, Outcome.NON_FINITE)
        if self.started_mode:
            self._record_load_sharing()
        arcs, jumps = self.record.close()
        remarks = automaton.laws_of_events.remarks(self.setup, arcs)
        if len(arcs):
            rates, values = lambda: self._enter(arcs[0].roles).rates, self.setup.values
            remarks += slow_start_warning(arcs[0], rates, values, engine.tolerance)
        start = self.started_mode or tuple(r.states[0] for r in automaton.regions)
        return automaton.trace(
            self.setup.values,
            arcs=arcs,
            jumps=jumps,
            initial=self.started_state,
            final=self.state,
            start_mode=start,
            final_mode=self.flow.mode if self.started_mode else start,
            passed_roles=self.passed_roles,
            t_end=self.clock.high,
            outcome=self.outcome,
            message=self.message,
            certified=decided and (proved or "guards"),
            evidence=evidence,
            tolerances=dict(self.setup.tolerances),
            engine=engine.title,
            tolerance=engine.tolerance,
            warnings=(*self.setup.warnings, *self.warnings, *remarks),
            counts={
                "steps": self.steps,
                "evaluations": engine.evaluations - self.evaluations,
                "boxes": self.boxes,
                "jumps": len(jumps),
                "modes_built": self.modes.built,
                "python_instants": self.instants,
            },
            motion=motion,
        )


def evidence_of(margins: Iterable[Sequence[str]]) -> dict[str, str]:
    """Return how the margins of the modes, and the motion, were verified."""
    names = chain.from_iterable(margins)
    return dict.fromkeys(names, "interval enclosure") | {"motion": FOLLOWED}
