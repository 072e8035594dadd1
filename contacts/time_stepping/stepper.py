"""Moreau-Jean time stepping: fixed step, one contact problem per step, no mode selection.

Per step (Moreau 1988; theta method of Jean 1999 with theta = 1/2, exact and energy-conserving for
free motion under constant forces)::

    q_m = q + h/2 v
    M(q_m) (v+ - v) = h f(q_m, v, t_m) + J(q_m)^T P
    q+ = q_m + h/2 v+

with impulses P in the friction cones. A closed, approaching contact obeys Moreau's impact law,
``0 <= P_n``, ``v_n+ + e v_n >= 0``. A lasting contact, or one that approaches no faster than two
steps of free fall, keeps its landing gap: ``v_n+ + gap/h + h/2 b >= 0``, where b is the bias of the
gap acceleration, so that it neither sinks nor chatters as its body turns. Friction opposes the slip
at the end of the step and never moves a contact at rest. Joints of coordinates, and contacts that
never open, close at the ends of steps, where their gap at mid-step is ``h^2/8 b``.

The energy grows by at most ``h^2/8 f^T M^-1 f`` in a step: if impulses P add no energy to the
velocities they act on, ``P (U+ + U-)/2 <= -P (h J M^-1 f)/2 - P W P/2``, whose maximum that is.
Restitution with friction that would add more is reduced (`capped`).

Bodies with shapes have their impact in the step nearest to the touch. If all impacts of an island
are landings, and the first touch is ``s`` after mid-step, the impacts I act then: ``q+`` is
corrected by ``-s M^-1 J^T I``, so that landed contacts touch. That takes ``-s f M^-1 J^T I`` from
the energy in the forces; if all impulses are impacts the bound above becomes
``(h - 2 s)^2/8 f^T M^-1 f``. Until then lasting contacts carry their previous forces, if these
close none by more than a step of free fall, and joints by no more in either direction; otherwise
impacts are at mid-step.

Points whose coupled group lands without restitution land at its last touch, at ``-h < s < 0``
(found by Newton's method), with the mass and Jacobians there. Forces depend on the new velocities
for the time ``h/2 - s``. Other impacts of points are at the first mid-step inside the surface.
Jumps of a step are recorded in the order of the touches.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.controllers import Controllers
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.scene.lint import replaced_laws
from contacts.states import STATES
from contacts.time_stepping.chunk import WORK, Chunk, SteppedSystem
from contacts.time_stepping.control import StepControl
from contacts.time_stepping.guard_truths import AT_END, StepEnd
from contacts.time_stepping.lazy_arcs import TERMS
from contacts.time_stepping.recorder import PoseRecorder, Recorder
from contacts.time_stepping.solver_residual import SolverResidual
from contacts.time_stepping.step_rejection import (
    Rejection,
    SqueezeCheck,
    squeezed,
    too_large,
    without_limit,
)
from contacts.time_stepping.stop_conditions import StopConditions, StopGuards
from statechart import interrupts
from statechart.arrays import EPS, Array, Bools, Ints
from statechart.automaton.regions import Region
from statechart.automaton.time_stepper import (
    DEFAULT_IMPULSES,
    Sample,
    Sampling,
    StepRequest,
    unread,
)
from statechart.automaton.trace import (
    FAR_TOO_MANY,
    LARGEST,
    Arc,
    Jump,
    Key,
    Outcome,
    Trace,
    check_size,
)
from statechart.documents.setting import Record
from statechart.errors import DeclarationProblem, NonFinite, SimulationError, TooLong, Unsupported
from statechart.execution.outcome import error_of
from statechart.formulas.tape import Tape
from statechart.tabular import pluralise


class RunInputs(NamedTuple):
    """Inputs of a run, or the reason why it cannot start."""

    setup: SceneSetup
    system: SteppedSystem
    codes: Ints  # (r,): initial modes, codes of `contacts.states`.
    warnings: tuple[str, ...]  # Besides those of the setup.
    controls: Key  # Initial states of controllers.
    solved: Array  # (u,): unknowns at the start, NaN if unknown.
    failure: SimulationError | None = None  # Why no step can be taken.
    # Changes values of parameters at a state and time, and returns the setup, and modes of
    # contacts that open; None if unsupported.
    change: (
        Callable[[Mapping[str, float], Array, float], tuple[SceneSetup, dict[int, int]]] | None
    ) = None


# Largest chunk, within which no signal is handled, and its target of iterations times contacts,
# some tenths of a second: above it the chunk is halved, below a quarter doubled, below a sixteenth
# multiplied by eight. A clock would make the last bits depend on the load of the machine.
_CHUNK, _WORK = 512, 3_000_000
# Largest memory of the polynomials of a chunk.
_CHUNK_BYTES = 2**23
# Largest number of steps that a float counts.
_COUNTED = 2.0**53
# Steps after which the memory per step is extrapolated.
_TIMED_STEPS = 2**15


class SteppedRun:
    """A stepped run in progress; it yields after each `every`, at least."""

    def __init__(
        self, stepper: Stepper, inputs: RunInputs, request: StepRequest, every: float = math.inf
    ) -> None:
        self._inputs, self.stepper, self.request, self._every = inputs, stepper, request, every
        self.setup, self.system = inputs.setup, inputs.system
        self.control = stepper.control(inputs)
        values, record, watch = self.setup.values, request.record, request.outputs
        # Controllers react to the events of regions.
        records = record is Record.MODES or self.control is not None
        regions = len(inputs.codes)
        self.recorder = Recorder(
            stepper.regions[:regions], inputs.codes, inputs.controls, stepper.sticks,
            stepper.gated[:regions], stepper.again, stepper.joint_forces, stepper.forces,
            lambda states, times: stepper.energy.table(states, values, times)[:, 0],
            len(stepper.angles), self.system.slips, self.system.slip_errors,
            self.setup.residual_slip,
            modes=records or (watch is not None and watch.events),
            motion=watch is not None and watch.motion,
        )  # fmt: skip
        self.stops = StopConditions(stepper.stops, self.setup, inputs.controls)
        self.state = self.setup.initial
        self.time, self.taken, self.fastest, self.size = 0.0, 0, 0.0, 0
        self.outcome, self.message = Outcome.HORIZON, ""
        self.solver_residual = SolverResidual(request.impulses)
        self._squeeze = SqueezeCheck(stepper.regions, request.step, inputs.setup.start_depth)
        poses = record is Record.POSES
        self._poses = PoseRecorder(len(stepper.angles)) if poses else None
        self._last: Chunk | None = None
        self._turning = len(stepper.angles) + np.flatnonzero(stepper.angles)

    def end(self, outcome: Outcome, message: str) -> None:
        """Set outcome and message."""
        self.outcome, self.message = outcome, message

    def chunks(self) -> Iterator[None]:
        """Run; yield at the start and after every chunk of steps."""
        try:
            if self._inputs.failure is not None:
                raise self._inputs.failure
            steps = self._steps()
            while True:
                with interrupts.deferred():
                    going = next(steps, False)
                if not going:
                    return
                yield
        except KeyboardInterrupt:
            self.end(Outcome.INTERRUPTED, "interrupted by the user")
        except SimulationError as error:
            self.end(Outcome[error.outcome], f"t = {self.time:.6g}: {error}")

    def _steps(self) -> Iterator[bool]:
        step, until = self.request.step, self.request.until
        control, at = self.control, self._instant(step)
        # Bodies with shapes do not know forces at the start.
        at.fresh = not bool(np.isnan(at.own).any())
        if control is not None:
            at = control.turn(self.recorder, (), at)
            self.state = at.state
        # As with events, a run of no duration reaches its end time.
        met = self._met_after_jumps(at) if until else None
        if met is not None:
            self._stop(met)
            return
        yield True
        whole = math.floor(min(until / step * (1.0 + 4e-16), _COUNTED))
        rest, counts = until - whole * step, [(whole, step)]
        if rest > 1e-9 * step:
            # Forces are impulses over a step: in a very short one they would be round-off.
            counts = [(whole - 1, step), (2, 0.5 * (step + rest))]
        largest = max(1, min(_CHUNK, _CHUNK_BYTES // (TERMS * self.state.nbytes)))
        most = min(largest, max(1, _CHUNK // max(1, len(self.stepper.regions))))
        each = max(1, round(min(self._every / step, _COUNTED)))
        for count, h in counts:
            # A step may be split into a power of two of parts.
            done, first = 0.0, self.time
            while done < count:
                interrupts.check()
                begin, left, due = first + done * h, count - done, False
                size, number = min(left, 1.0) * h, min(int(left), most, each - int(done) % each)
                chunk = self.system.steps(begin, size, self.state, max(number, 1))
                if control is not None:
                    chunk, due = control.cut(chunk, begin, self.recorder)
                    if due and not len(chunk.codes):
                        if self._act_early(control, h):
                            return
                        continue
                work, steps = float(chunk.stats[:, WORK].sum()), len(chunk.codes)
                chunk = self._until_stop(chunk, begin)
                due = due and len(chunk.codes) == steps
                if due:
                    # Steps beyond a transition are reverted, and the next may be as far off.
                    most = max(1, len(chunk.codes))
                elif work > _WORK:
                    most = max(1, most // 2)
                elif work < 0.25 * _WORK and len(chunk.codes) == most:
                    most = min((8 if work < 0.0625 * _WORK else 2) * most, largest)
                if self._accept(chunk, begin, h, due):
                    return
                done += len(chunk.codes) * (chunk.h / h)
                if self._every == math.inf or done % each == 0.0:
                    yield True
        self.time = until
        self.message = f"reached t = {until:.6g}"

    def _accept(self, chunk: Chunk, start: float, h: float, due: bool) -> bool:
        """Record steps; return whether the run ends in them.

        At their end contacts act first, then controllers, which may be `due`, then stop conditions.
        """
        control, recorder, steps = self.control, self.recorder, len(chunk.codes)
        jumps = recorder.count
        chunk, failure = self._admissible(chunk, start)
        stopped = self.stops.first_met(chunk)
        if stopped is not None:
            chunk = chunk.first(stopped[0] + 1)
        ends = np.zeros(len(recorder.row), np.bool_)
        if len(chunk.codes):
            if due or stopped is not None:
                ends = recorder.slips_end(chunk)[-1]
                ends |= due and control is not None and control.early
            self._hand_on()
            if self._poses is not None:
                jumped = len(recorder.control_jumps)
                self._poses.add(chunk, recorder.clock, jumped, recorder.controls)
            recorder.add(chunk)
            self._last = chunk.after(len(chunk.codes) - 1)
            self.solver_residual.add(chunk, start)
            self.fastest = max(self.fastest, float(chunk.approach.max()))
        self.taken += len(chunk.codes)
        self.state = chunk.states[-1]
        self.time = start + len(chunk.codes) * chunk.h
        self.request.show(self.time, recorder.count, self.taken)
        met, last, end, waits = None, None, self.time, True
        whole, transitions = len(chunk.codes) == steps and failure is None, 0
        at = self._instant(h)
        if stopped is not None:
            met, last = stopped[1], self.stops.locate(recorder, stopped[1])
            end = last[0].end.high
            # Contacts that stick at the end of the step precede a stop there, not one before.
            waits = whole and end >= self.time - AT_END * h
        stuck = whole and waits and self._begin_next(ends, at)
        turns = whole and control is not None
        if last is not None and turns:
            fresh = recorder.since(jumps)
            turns = due and control is not None and control.acts_by(end, last[0], fresh, at)
        if stuck or turns:
            end = self.time
        self.stops.accept(chunk, start, end)
        if control is not None:
            control.accept(chunk, start, end)
        if turns and control is not None:
            stuck = stuck or self._begin_next(ends, at)
            transitions, fresh = len(recorder.control_jumps), recorder.since(jumps)
            at = control.turn(recorder, fresh, at)
            self.state, transitions = at.state, len(recorder.control_jumps) - transitions
        if stuck or transitions:
            met, last = self._met_after_jumps(at), None
        if met is not None:
            if last is not None:
                self.state = recorder.rewind(last[0], later=last[1])
            self._stop(met)
            return True
        if failure is not None:
            raise failure
        if self.request.record is Record.NOTHING:
            return False
        modes = self.request.record is Record.MODES
        jumps = self.recorder.count if modes else len(self.recorder.control_jumps)
        if jumps >= self.request.max_jumps:
            self.end(Outcome.TOO_MANY_JUMPS, pluralise(self.request.max_jumps, "jump"))
            return True
        self.size += chunk.states[1:].nbytes + chunk.solved.nbytes
        self.size += chunk.impulses.nbytes if modes else 0
        if modes:  # of poses there is as much as the disk takes
            check_size(self.size, jumps, self.time)
        self._check_pace()
        return False

    def _admissible(self, chunk: Chunk, start: float) -> tuple[Chunk, SimulationError | None]:
        """Return the steps before the first one that ends the run as a failure, and that."""
        failure: SimulationError | None = None
        checks: tuple[Callable[[Chunk], Rejection | None], ...] = (
            lambda chunk: without_limit(chunk, start, self.stepper.couplings),
            lambda chunk: self._rejected(chunk, start),
            self.solver_residual.beyond,
            lambda chunk: self._squeeze.find(chunk, start, self.fastest, self.system.depth_left),
            self._undefined,
        )
        for check in checks:
            if (rejection := check(chunk)) is not None:
                chunk, failure = chunk.first(rejection.step), rejection.why
        return chunk, failure

    def _undefined(self, chunk: Chunk) -> Rejection | None:
        """Return the first step at whose end a guard has no value."""
        lost = self.stops.first_undefined(chunk)
        if lost is None and self.control is not None:
            lost = self.control.first_undefined(chunk)
        if lost is None:
            return None
        why = f"the guard {lost[1]} has no finite value one step of {chunk.h:g} later"
        return Rejection(lost[0], NonFinite(why))

    def _instant(self, h: float) -> StepEnd:
        """Return the end of the recorded steps."""
        recorder, last, begin = self.recorder, self._last, self._inputs.solved
        time, row, coordinates = recorder.clock.high, recorder.row, len(self.stepper.angles)
        solved = begin if last is None else last.solved[-1]
        return StepEnd(self.system, coordinates, time, h, self.state, row, solved, last)

    def _act_early(self, control: StepControl, h: float) -> bool:
        """Let controllers act on what begins with the next step; return whether the run ends."""
        recorder, jumps, at = self.recorder, self.recorder.count, self._instant(h)
        self._begin_next(np.ones(len(at.codes), np.bool_), at)
        at = control.turn(recorder, recorder.since(jumps), at)
        self.state = at.state
        met = self._met_after_jumps(at) if recorder.count > jumps else None
        if met is not None:
            self._stop(met)
        return met is not None

    def _until_stop(self, chunk: Chunk, start: float) -> Chunk:
        """Evaluate the stop conditions; retake steps up to one that is met as a contact sticks."""
        self.stops.take(chunk, start, self.recorder)
        met = self.stops.first_met(chunk)
        if met is None or not self.recorder.slips_end(chunk)[met[0]].any():
            return chunk
        if met[0] + 1 < len(chunk.codes):
            self.system.forget()
            chunk = self.system.steps(start, chunk.h, chunk.states[0], met[0] + 1)
        return chunk

    def _begin_next(self, which: Bools, at: StepEnd) -> bool:
        """Record jumps of regions (r,) at the begin of the next step; return if there are any."""
        step = at.next_step if which.any() else None
        if step is None:
            return False
        begins = self.recorder.begin(step, which)
        at.codes, at.fresh = self.recorder.row, not begins
        return begins

    def _met_after_jumps(self, at: StepEnd) -> int | None:
        """Return the stop condition that is met in the present state; a struck surface is first."""
        if self.control is not None and self.control.strikes:
            return None
        return self.stops.after_jumps(self.recorder, at)

    def _hand_on(self, *, ended: bool = False) -> None:
        """Pass finished arcs and jumps to the watcher, and drop them if they are not recorded."""
        watch = self.request.outputs
        if self.request.record is not Record.MODES:
            arcs, jumps = self.recorder.take_finished(ended=ended)
            if watch is not None and (arcs or jumps):
                watch.add(replace(self._piece, arcs=arcs, jumps=jumps))

    @cached_property
    def _piece(self) -> Trace:
        """A trace without arcs and jumps: names and numbers of a piece of the run."""
        return self._trace(Record.MODES, (), ())

    def _check_pace(self) -> None:
        """Raise `TooLong` if the trace of a run without stop conditions would be too large."""
        if self.taken < _TIMED_STEPS or self.stepper.stops.names:
            return
        steps = self.request.until / self.request.step
        needed = self.size / self.taken * steps
        if needed > FAR_TOO_MANY * LARGEST:
            raise TooLong(
                f"{steps:.3g} steps take {needed / 2**20:.3g} MB, and a trace may take "
                f"{LARGEST >> 20} MB; end the run earlier, or take longer steps"
            )

    def _rejected(self, chunk: Chunk, start: float) -> Rejection | None:
        """Return the first rejected step."""
        regions, size, step = self.stepper.regions, self.setup.scales.length, self.request.step
        rejection = too_large(chunk, self._turning, regions, size, step)
        if rejection is None or not rejection.deep:
            return rejection
        k, why, deep = rejection
        depth = self.system.depth_left(chunk.states[k], start + k * chunk.h)
        return Rejection(k, squeezed(deep, depth, size) or why, deep)

    def _stop(self, condition: int) -> None:
        name, self.time = self.stepper.stops.names[condition], self.recorder.clock.high
        self.recorder.stop(name, self.state)
        self.end(Outcome.STOPPED, f"{name} at t = {self.time:.6g}")

    def whole(self) -> Trace:
        """Run to the end."""
        for _ in self.chunks():
            pass
        return self.trace()

    def trace(self) -> Trace:
        """Return the trace."""
        recorder, record, watch = self.recorder, self.request.record, self.request.outputs
        recorder.close()
        self._hand_on(ended=True)
        if record is Record.MODES:
            # Arcs of a long run are recomputed on access: they take several times the memory.
            return self._trace(record, *recorder.sequences(kept=TERMS * self.size <= LARGEST))
        # The end follows all jumps, including unrecorded ones.
        outputs = {} if watch is None else watch.end(self._trace(Record.MODES, (), ()))
        if self._poses is None:
            return replace(self._trace(record, (), ()), outputs=outputs)
        arcs = self._poses.arcs(self.time)
        return replace(self._trace(record, arcs, tuple(recorder.control_jumps)), outputs=outputs)

    def _trace(self, record: Record, arcs: Sequence[Arc], jumps: Sequence[Jump]) -> Trace:
        recorder, stepper, warnings = self.recorder, self.stepper, self._inputs.warnings
        regions, start, final = stepper.regions, recorder.start_key, recorder.key
        if record is Record.POSES:
            controlled = len(regions) - len(stepper.controls)
            regions, start, final = regions[controlled:], self._inputs.controls, recorder.controls
        elif record is Record.NOTHING:
            regions, start, final = (), (), ()
        tolerances = dict(self.setup.tolerances)
        # A landing depth is at most that of one step, and remains.
        landed = self.setup.start_depth + self.request.step * self.fastest
        tolerances["gap"] = max(tolerances["gap"], landed)
        tolerances["impulse"] = self.solver_residual.residual
        return Trace(
            name=stepper.name,
            regions=regions,
            variables=stepper.names,
            parameters=dict(zip(stepper.parameter_names, self.setup.values.tolist(), strict=True)),
            arcs=arcs,
            jumps=jumps,
            initial=self.setup.initial,
            final=self.state,
            start_mode=start,
            final_mode=final,
            t_end=self.time,
            outcome=self.outcome,
            message=self.message,
            certified=False,
            evidence=dict.fromkeys(regions, "recognised at every step"),
            tolerances=tolerances,
            engine="impulse",
            tolerance=math.nan,
            warnings=(
                *self.setup.warnings,
                *warnings,
                *self.solver_residual.remarks,
                *self.system.remarks,
                *recorder.remarks,
                *self.stops.remarks,
                *(() if self.control is None else self.control.remarks),
            ),
            counts={
                "steps": self.taken,
                "evaluations": self.taken,
                "boxes": 0,
                "jumps": recorder.count,
                "modes_built": 0,
                **self.solver_residual.counts,
            },
            step=self.request.step,
            margins=self.system.margins,
            undetermined=recorder.indeterminate if record is Record.MODES else {},
            record=record,
            start_unknowns=None if self._inputs.failure else self._inputs.solved,
        )


RELATIVE = 1e-9
"""Relative tolerances at the start."""


class Stepper(ABC):
    """Time stepper of a scene (see `statechart.automaton.time_stepper.TimeStepper`).

    The mechanics have the scene's equations, or only its names and symbols; `regions` are all,
    controllers last; `again`: cause of an impact on a region that is not free; `forces`, `sticks`:
    see `Recorder`; `turning`: names of the couples behind `Chunk.joint_impulses` of joints.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        regions: Sequence[Region],
        controllers: Controllers,
        *,
        again: str,
        forces: Ints | None,
        sticks: Bools,
        turning: Sequence[str],
    ) -> None:
        self._mechanics, self._scene, self._regions = mechanics, mechanics.scene, regions
        self.name = mechanics.scene.name
        self._controllers, self.controls = controllers, controllers.initial
        self.couplings = tuple(mechanics.scene.couplings)
        self.names = mechanics.state_names
        self.parameter_names = mechanics.parameters.names
        self.regions = tuple(region.name for region in regions)
        self.again, self.forces, self.sticks = again, forces, sticks
        self.gated = np.array([self._reads_motion(name) for name in self.regions], np.bool_)
        joints = (f"{row.joint}.{row.component}" for row in mechanics.joint_rows)
        self.joint_forces = (*joints, *(f"{name}.M" for name in turning))
        self.angles = np.array([name.endswith(".angle") for name in mechanics.names])
        self.stops = StopGuards(mechanics, controllers, regions)
        self.energy: Tape = mechanics.tape([mechanics.energy])

    def _reads_motion(self, name: str) -> bool:
        """Return whether a coordinate or rate decides the relation `enabled` of a region."""
        gate = self._mechanics.gate(name) if name in self._scene.frictional else None
        atoms = () if gate is None else gate.atoms
        read = set[sp.Basic]().union(*(a.margin.free_symbols for a in atoms if not a.is_end))
        return not read.isdisjoint(self._mechanics.variables)

    def start(self, overrides: Mapping[str, float]) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state; see `TimeStepper.start`."""
        inputs = self._begin(overrides, 0.0, DEFAULT_IMPULSES.tolerance, False)
        if inputs.failure is not None:
            raise inputs.failure
        states = tuple(STATES[code] for code in inputs.codes.tolist())
        return (*states, *inputs.controls), (*inputs.setup.warnings, *inputs.warnings)

    def run(self, overrides: Mapping[str, float], request: StepRequest) -> Trace:
        """Run from the declared initial state; see `TimeStepper.run`."""
        record, watch = request.record, request.outputs
        forces = record is not Record.NOTHING or (watch is not None and watch.motion)
        return SteppedRun(self, self._checked_inputs(overrides, request, forces), request).whole()

    def stream(
        self, overrides: Mapping[str, float], sampling: Sampling, request: StepRequest
    ) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps as they come; see `TimeStepper.stream`."""
        inputs = self._checked_inputs(overrides, request)
        run = SteppedRun(self, inputs, request, sampling.every)
        return self._streamed(run, inputs, sampling, dict(overrides))

    def _streamed(
        self, run: SteppedRun, inputs: RunInputs, sampling: Sampling, parameters: dict[str, float]
    ) -> Iterator[Arc | Jump]:
        if sampling.control is not None and inputs.change is None:
            raise Unsupported(
                "the engine impulse can change parameters only in a scene without collisions and "
                "without controllers; take the engine taylor or scipy"
            )
        recorder, fresh = run.recorder, unread(run.recorder.arcs, run.recorder.jumps)
        for _ in run.chunks():
            recorder.close()
            yield from fresh()
            if sampling.control is None or inputs.change is None:
                continue
            mode = dict(zip(self.regions, recorder.key, strict=True))
            state = dict(zip(self.names, run.state.tolist(), strict=True))
            changed = sampling.control(Sample(run.time, mode, state))
            if changed:
                parameters |= changed
                try:
                    setup, moved = inputs.change(parameters, run.state, run.time)
                except SimulationError as error:
                    run.end(Outcome[error.outcome], f"t = {run.time:.6g}: {error}")
                    break
                recorder.move(moved)
                run.stops.change(setup, run.time, run.state, run.request.step)
        recorder.close()
        yield from fresh()
        trace = run.trace()
        if not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)

    def _checked_inputs(
        self, overrides: Mapping[str, float], request: StepRequest, forces: bool = True
    ) -> RunInputs:
        """Return the inputs of a run; raise for a step too short to change the state."""
        read = forces or bool(self.stops.names) or bool(self.controls)
        step = request.step
        inputs = self._begin(overrides, step, request.impulses.tolerance, read)
        scales = inputs.setup.scales
        least = EPS * scales.length / scales.speed
        if step < min(least, request.until):
            raise DeclarationProblem(
                f"a step of {step:g} is too short: a speed of {scales.speed:.3g} moves nothing by "
                f"more than the round-off of {scales.length:.3g}, the size of the scene",
                advice=f"take {least:.1g} or more",
                loc=("settings", "step"),
            )
        return inputs

    def control(self, inputs: RunInputs) -> StepControl | None:
        """Return the controllers of a run, if there are any."""
        if not self.controls:
            return None
        system, regions = inputs.system, self._regions
        return StepControl(
            self._mechanics, self._controllers, inputs.setup, system, regions, inputs.controls
        )

    @abstractmethod
    def _begin(
        self, overrides: Mapping[str, float], step: float, allowed: float, forces: bool
    ) -> RunInputs:
        """Check the initial state; return the inputs of a run, or the reason why there is none.

        Unless `forces`, forces are not computed.
        """

    def _replaced_laws(self, setup: SceneSetup) -> tuple[str, ...]:
        """Return warnings of replaced laws."""
        values = dict(zip(self.parameter_names, setup.values.tolist(), strict=True))
        return tuple(f"{what}: {why}" for what, why in replaced_laws(self._scene, values).items())
