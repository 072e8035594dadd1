"""The loop on hybrid time: flow to the first event, ask the laws, jump, flow on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, pairwise

import numpy as np
import sympy as sp

from statechart import interrupts
from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import (
    CAPTURED,
    HELD,
    UNBOUNDED,
    Flow,
    Instant,
    Setup,
    shown_mode,
    uncaptured,
)
from statechart.automaton.modes import build_mode, captured
from statechart.automaton.regions import Mode
from statechart.automaton.trace import (
    FAR_TOO_MANY,
    Arc,
    Clock,
    Jump,
    Key,
    Outcome,
    Trace,
    between,
    check_size,
)
from statechart.engines.engine import Engine, FlowWatch, Path
from statechart.errors import EventLoop, NonFinite, SimulationError, StepFailure, TooLong
from statechart.execution.flow import CompiledMode, advance, compile_mode
from statechart.execution.outcome import Progress, error_of
from statechart.execution.zeno import Accumulation
from statechart.formulas.series import size_at

# At such a rate a variable would have changed by this many times its size.
_STEEP = 1e6
# More jumps than this at one instant are a loop; products of a few contacts settle in a handful.
_JUMPS_AT_ONCE = 64
# A margin that cannot be decided gets so much more room at a time, and in all.
_WIDER, _WIDEST = 16.0, 1e4
# A gap that is closed to this part of its tolerance as the run ends has just closed.
_AT_END = 1e-2
# How far to look ahead at first, in lengths of the last flow: those of bounces shrink.
_AHEAD = 16.0
# Jumps whose pace was steady while their number doubled thrice, from so many on, go on like that
# where no condition ends them.
_STEADY = 512
# A flow of no scale is looked at so far ahead at first: its powers are floats.
_FARTHEST = 1e12


class Simulator:
    """An automaton on an engine: modes are compiled when first entered and kept between runs.

    Parameters
    ----------
    automaton : Automaton
        What to run.
    engine : Engine
        How to integrate.
    progress : bool
        Whether runs above about a second report to stderr.
    """

    def __init__(self, automaton: Automaton, engine: Engine, *, progress: bool = False) -> None:
        self.automaton = automaton
        self.engine = engine
        self.progress = progress
        self._modes: dict[tuple[Key, frozenset[int]], Mode] = {}
        self._compiled: dict[tuple[Key, frozenset[int]], CompiledMode] = {}
        self._built: set[Key] = set()
        self.path = Path()

    def run(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        until: float,
        max_jumps: int = 100_000,
        throw: bool = True,
    ) -> Trace:
        """Run from the declared initial state.

        Parameters
        ----------
        parameters : mapping
            Overrides, name -> value.
        until : float
            End of the run, in the scene's time.
        max_jumps : int
            End after so many jumps.
        throw : bool
            Raise on an outcome that is not an end the declaration names; else return the trace.

        Returns
        -------
        Trace

        Raises
        ------
        DeclarationError
            If a parameter is unknown or the initial state is inconsistent.
        SimulationError
            With the trace so far, where the run cannot go on and `throw` is set.
        """
        setup = self.automaton.setup(parameters or {}, self.engine.tolerance)
        setup = replace(setup, modes=partial(self._mode, zeros=setup.zeros))
        self.engine.sizes = setup.sizes
        run = _Run(self, setup, until, max_jumps)
        try:
            with interrupts.held():
                run.loop()
        except KeyboardInterrupt:
            run.end(Outcome.INTERRUPTED, "interrupted by the user")
        except SimulationError as error:
            run.end(Outcome[error.outcome], f"mode {run.mode_label}: {error}")
        trace = run.trace()
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        return trace

    def compiled(self, key: Key, zeros: frozenset[int]) -> CompiledMode:
        """Return the mode `key`, compiled for zero parameters at the places `zeros`."""
        found = self._compiled.get((key, zeros))
        if found is None:
            mode = self._mode(key, zeros)
            found = next((made for made in self._compiled.values() if made.mode is mode), None)
            if found is None:
                bare = uncaptured(key)
                stepper = None if bare == key else self.compiled(bare, zeros).stepper
                found = compile_mode(self.engine, self.automaton, mode, stepper)
                if HELD not in key:
                    self._built.add(shown_mode(key))
            self._compiled[key, zeros] = found
        return found

    def _mode(self, key: Key, zeros: frozenset[int]) -> Mode:
        """Return the mode `key`, solved where the parameters at the places `zeros` are zero."""
        found = self._modes.get((key, zeros))
        if found is None:
            # Zeros that its equations do not mention call for no mode of its own.
            mentioned = zeros & self._used(key)
            found = self._modes.get((key, mentioned))
            if found is None:
                symbols, bare = self.automaton.parameters, uncaptured(key)
                if bare != key:
                    found = captured(self.automaton, self._mode(bare, zeros), key)
                else:
                    gone = frozenset(symbols[i] for i in mentioned)
                    found = build_mode(self.automaton, key, gone)
                self._modes[key, mentioned] = found
            self._modes[key, zeros] = found
        return found

    def _used(self, key: Key) -> frozenset[int]:
        """Return the places of the parameters that the equations of `key` mention."""
        automaton = self.automaton
        parts = list(automaton.equations) + list(automaton.rates)
        for region, name in zip(automaton.regions, key, strict=True):
            state = region.build(name.removeprefix(CAPTURED))
            parts += (*state.equations, *state.values.values())
        used: set[sp.Symbol] = set().union(*(part.free_symbols for part in parts))
        return frozenset(i for i, symbol in enumerate(automaton.parameters) if symbol in used)

    @property
    def modes_built(self) -> int:
        """Number of modes whose equations were built so far."""
        return len(self._built)


@dataclass(eq=False)
class _Run:
    simulator: Simulator
    setup: Setup
    until: float
    max_jumps: int
    clock: Clock = field(default_factory=Clock)
    arcs: list[Arc] = field(default_factory=list)
    jumps: list[Jump] = field(default_factory=list)
    outcome: Outcome = Outcome.HORIZON
    message: str = ""
    warnings: dict[str, None] = field(default_factory=dict)
    evidence: dict[str, str] = field(default_factory=dict)
    boxes: int = 0
    steps: int = 0
    size: int = 0
    entered: dict[Key, CompiledMode] = field(default_factory=dict)
    stalled: tuple[float, float, tuple[str, ...]] | None = None
    stalls: int = 0
    grazed: bool = False
    failure: SimulationError | None = None
    rearranged: tuple[tuple[float, float], int] = (0.0, 0.0), 0

    def __post_init__(self) -> None:
        self.flow: Flow | None = None
        self.state = self.setup.initial
        self.started_mode: Key | None = None
        self.started_state = self.setup.initial
        self.horizon = min(self.setup.horizon, _FARTHEST)
        self.evaluations = self.simulator.engine.evaluations
        self._progress = Progress(self.until)
        self._accumulation = Accumulation()

    @property
    def mode_label(self) -> str:
        return (
            "at the start" if self.flow is None else self.simulator.automaton.label(self.flow.mode)
        )

    def end(self, outcome: Outcome, message: str) -> None:
        self.outcome, self.message = outcome, message

    def loop(self) -> None:
        laws = self.simulator.automaton.laws_of_events
        self.flow, self.state = laws.begin(self.setup)
        self.started_mode, self.started_state = self.flow.mode, self.state
        self._warn()
        fired: tuple[str, ...] = ()
        if not self.flow.settled and self._settle(fired):
            return
        while True:
            fired = self._flow()
            if self.outcome is Outcome.STOPPED:
                return
            if not fired:
                if not self._ending() or not self._settle(()):
                    self.message = f"reached t = {self.clock.high:.17g}"
                return
            if self._settle(fired):
                return

    def _flow(self) -> tuple[str, ...]:
        """Flow to the next event; return what fired, or nothing at the end of the run."""
        interrupts.check()
        flow = self.flow
        assert flow is not None
        left = self.clock.until(self.until)
        remaining = flow.remaining
        if flow.held:
            remaining = min(remaining, *(between(self.clock, end) for end in flow.held.values()))
        duration = min(left, remaining)
        if duration <= 0.0:
            return ("zeno",) if remaining <= 0.0 else ()
        compiled = self.entered.get(flow.flow)
        if compiled is None:
            with interrupts.let_through():
                compiled = self.simulator.compiled(flow.flow, self.setup.zeros)
            self.entered[flow.flow] = compiled
        setup, start = self.setup, self.clock.high
        tolerances, special = setup.tolerances, flow.tolerances
        allowed = [
            special[name] if name in special else tolerances[kind]
            for name, kind in compiled.watched
        ]
        laws, path = self.simulator.automaton.laws_of_events, self.simulator.path
        constraints = laws.constraints(setup, flow.flow, start, self.state)
        reached = advance(
            self.simulator.engine,
            compiled,
            path,
            FlowWatch(compiled.guards, np.array(allowed), constraints, setup.values, start),
            state=self.state,
            duration=duration,
            horizon=self.horizon,
            on_steps=self._show if self.simulator.progress else None,
        )
        self.boxes += reached.boxes
        self.steps += reached.steps
        if self.simulator.progress:
            self._show(0.0, 0)  # flows that end in their first steps say nothing themselves
        elapsed, terms = 0.0, flow.terms
        if path.count > 0:
            times, coefficients = path.arc()
            elapsed, terms = times.item(-1), _terms(times, coefficients)
            self.arcs.append(
                Arc(flow.mode, flow.flow, self.clock, len(self.jumps), times, coefficients)
            )
            self.size += times.nbytes + coefficients.nbytes
        self.clock = self.clock.later(elapsed)
        if elapsed > 0.0:
            # A mode may flow on from where a margin fell, without a jump.
            since = self.jumps[-1].t if self.jumps else 0.0
            self.horizon = _AHEAD * max(elapsed, self.clock.high - since)
        self.state = reached.state
        self.flow = Flow(
            flow.mode, flow.flow, flow.remaining - elapsed, "", False, (), flow.held, special, terms
        )
        if isinstance(reached.failure, StepFailure | NonFinite | TooLong):
            self.failure = reached.failure
            return (UNBOUNDED,)
        if reached.failure is not None:
            raise reached.failure
        check_size(self.size, len(self.jumps), self.clock.high)
        if reached.crossing is None:
            return ("zeno",) if duration == remaining else ()
        margin = compiled.mode.margins[reached.crossing.guard]
        # They stand last; zeros and controls have been replaced in their formulas.
        stops = reached.crossing.guard >= len(compiled.mode.margins) - len(
            self.simulator.automaton.stops
        )
        self.grazed = reached.graze
        if reached.graze and stops and self._unbounded():
            # Rates without bound make noise of what is watched next to where they end.
            return (UNBOUNDED,)
        if reached.graze:
            self.evidence[margin.name] = "graze: touches zero within the last bits of time"
            self.warnings[f"{margin.name} grazes zero at t = {self.clock.high:.17g}"] = None
        if stops:
            self._stop(margin.name)
        return (margin.name,)

    def _unbounded(self) -> bool:
        """Whether rates have grown without bound towards here, and a jump resolves it."""
        flow, laws = self.flow, self.simulator.automaton.laws_of_events
        if flow is None or flow.terms is None or not self.arcs:
            return False
        sizes = np.abs(self.arcs[-1].coefficients[:, :, 0]).max(axis=0)
        if not (np.abs(flow.terms[:, -1]) > _STEEP * sizes).any():
            return False
        return laws.jump(self._instant(flow, (UNBOUNDED,))) is not None

    def _instant(self, flow: Flow, fired: tuple[str, ...]) -> Instant:
        return Instant(self.setup, self.clock, len(self.jumps), flow, self.state, fired)

    def _ending(self) -> bool:
        """Whether something may just be happening as the run ends: it belongs to the run.

        Gaps are searched for below zero, and a guard may fall short of its boundary by what the
        run is off.
        """
        assert self.flow is not None
        compiled = self.entered.get(self.flow.flow)
        if compiled is None:
            return False
        guards, parameters, time = compiled.guards, self.setup.values, self.clock.high
        margins = guards.values(self.state, parameters, time).tolist()
        relative, sizes = self.simulator.engine.tolerance, self.flow.sizes
        sizes = np.abs(self.state) if sizes is None else sizes
        closed, tolerances = False, dict(self.flow.tolerances)
        for place, ((name, kind), margin) in enumerate(zip(compiled.watched, margins, strict=True)):
            if kind == "gap":
                closed |= margin <= _AT_END * self.setup.tolerances[kind]
            elif kind == "plain" and name in tolerances:
                size = size_at(guards, place, self.state, sizes, parameters, time)
                tolerances[name] = max(tolerances[name], relative * size)
                closed |= margin <= tolerances[name]
        self.flow = self.flow._replace(tolerances=tolerances)
        return closed

    def _warn(self) -> None:
        if self.flow is not None:
            self.warnings |= dict.fromkeys(self.flow.notes)
        if self.flow is not None and self.flow.warning:
            self.warnings[f"t = {self.clock.high:.17g}: {self.flow.warning}"] = None

    def _stop(self, name: str) -> None:
        assert self.flow is not None
        self.jumps.append(
            Jump(
                self.clock.high,
                len(self.jumps),
                "",
                "stop",
                self.flow.mode,
                self.flow.mode,
                self.state,
                self.state,
                fired=(name,),
            )
        )
        self.end(Outcome.STOPPED, f"{name} at t = {self.clock.high:.17g}")

    def _check_pace(self) -> None:
        """Raise `TooLong` where steady jumps are so many that the run cannot reach its end."""
        count = len(self.jumps)
        if count < 8 * _STEADY or count & (count - 1) or self.simulator.automaton.stops:
            return
        times = [self.jumps[(count >> k) - 1].t for k in range(4)]
        paces = [
            (after - before) / (count >> k) for k, (after, before) in enumerate(pairwise(times), 1)
        ]
        left = self.until - self.clock.high
        if max(paces) <= 2.0 * min(paces) and left > FAR_TOO_MANY * self.max_jumps * max(paces):
            raise TooLong(
                f"{count} jumps took {self.clock.high:.3g}, and {left:.3g} is left, too much for "
                f"{self.max_jumps} jumps; end the run earlier"
            )

    def _settle(self, fired: tuple[str, ...]) -> bool:
        """Jump until the mode holds; True when the run ends here."""
        laws = self.simulator.automaton.laws_of_events
        moved = False
        for _ in range(_JUMPS_AT_ONCE):
            assert self.flow is not None
            made = laws.jump(self._instant(self.flow, fired))
            if made is None:
                break
            jump, following = made
            if jump is None:
                if following.flow != self.flow.flow:
                    moved = True
                    self._rearrange(fired)
                if following.start is not None:
                    self.state = following.start
                self.flow = following._replace(start=None)
                continue
            moved = True
            self.flow = following
            self._warn()
            self.jumps.append(jump)
            self.state = jump.after
            self._skip(jump)
            fired = ()
            self._check_pace()
            if len(self.jumps) >= self.max_jumps:
                self.end(Outcome.TOO_MANY_JUMPS, f"{self.max_jumps} jumps")
                return True
            if self.flow.settled:
                break
        else:
            recent = ", ".join(
                f"{jump.cause} -> {self.simulator.automaton.label(jump.target)}"
                for jump in self.jumps[-6:]
            )
            raise EventLoop(f"{_JUMPS_AT_ONCE} jumps at t = {self.clock.high:.17g}: {recent}")
        if fired and not moved:
            if self.failure is not None:
                raise self.failure
            self.failure = self._stall(fired)
            if self.failure is not None:
                return self._settle((UNBOUNDED,))
        self.failure = None
        return False

    def _rearrange(self, fired: tuple[str, ...]) -> None:
        """Note that a mode goes on by other equations: again and again at one instant is a loop."""
        now = (self.clock.high, self.clock.low)
        self.rearranged = (now, self.rearranged[1] + 1 if self.rearranged[0] == now else 1)
        if self.rearranged[1] > _JUMPS_AT_ONCE:
            raise EventLoop(
                f"{', '.join(fired)} falls at t = {now[0]:.17g}, and equations of the mode follow "
                "one another for ever"
            )

    def _skip(self, jump: Jump) -> None:
        """Skip the rest of a sequence of jumps that accumulate, where the laws can."""
        rest = self._accumulation.watch(jump, self.clock, self.setup.short)
        if rest is None:
            return
        assert self.flow is not None
        recent = self.jumps[-_JUMPS_AT_ONCE:]
        made = self.simulator.automaton.laws_of_events.accumulate(
            self.setup, self.clock, self.flow, recent, rest
        )
        if made is not None:
            self.jumps[-1], self.flow = made
            self.state = self.jumps[-1].after
            self._warn()

    def _stall(self, fired: tuple[str, ...]) -> EventLoop | None:
        """Note a fall that changes no mode: once a graze, at the same instant again a loop."""
        now = (self.clock.high, self.clock.low, fired)
        before = self.stalled
        near = before is not None and before[0] == now[0] and before[2] == fired
        # Time may creep on by less than a rounding.
        self.stalls = self.stalls + 1 if near else 0
        if (before == now or self.stalls > _JUMPS_AT_ONCE) and not self._widen(*fired):
            return EventLoop(f"{', '.join(fired)} falls at t = {now[0]:.17g}, but no jump follows")
        self.stalled = now
        return None

    def _widen(self, margin: str) -> bool:
        """Give a margin that rounding keeps at zero more room in this flow; False if it had much.

        Where a force is zero as a whole (balls that fall side by side) its enclosure is wider
        than the band of its kind. The laws may take a speed for none that is beyond its own.
        """
        assert self.flow is not None
        compiled = self.entered[self.flow.flow]
        kind = dict(compiled.watched).get(margin)
        if kind is None or not (self.grazed or kind == "speed"):
            return False
        usual = self.setup.tolerances[kind]
        wide = _WIDER * self.flow.tolerances.get(margin, usual)
        if wide > _WIDEST * usual:
            return False
        self.flow = self.flow._replace(tolerances={**self.flow.tolerances, margin: wide})
        self.warnings[
            f"t = {self.clock.high:.17g}: {margin} is zero to within rounding; "
            f"it is watched with the tolerance {wide:.3g}"
        ] = None
        return True

    def _show(self, local: float, steps: int) -> None:
        self._progress.show(self.clock.high + local, len(self.jumps), self.steps + steps)

    def trace(self) -> Trace:
        simulator = self.simulator
        automaton, engine = simulator.automaton, simulator.engine
        names = chain.from_iterable(compiled.names for compiled in self.entered.values())
        evidence = dict.fromkeys(names, "interval enclosure") | self.evidence
        start = self.started_mode or tuple(r.states[0] for r in automaton.regions)
        return Trace(
            name=automaton.name,
            regions=tuple(region.name for region in automaton.regions),
            variables=automaton.names,
            parameters=dict(
                zip(automaton.parameter_names, self.setup.values.tolist(), strict=True)
            ),
            arcs=tuple(self.arcs),
            jumps=tuple(self.jumps),
            initial=self.started_state,
            final=self.state,
            start_mode=start,
            final_mode=self.flow.mode if self.flow else start,
            t_end=self.clock.high,
            outcome=self.outcome,
            message=self.message,
            certified=not self.evidence and self.outcome not in _UNCERTIFIED,
            evidence=evidence,
            tolerances=dict(self.setup.tolerances),
            engine=engine.name
            if engine.name == engine.method
            else f"{engine.name} {engine.method}",
            tolerance=engine.tolerance,
            warnings=(*self.setup.warnings, *self.warnings),
            counts={
                "steps": self.steps,
                "evaluations": engine.evaluations - self.evaluations,
                "boxes": self.boxes,
                "jumps": len(self.jumps),
                "modes_built": simulator.modes_built,
            },
        )


def _terms(times: Array, coefficients: Array) -> Array:
    """Return what each variable was summed from as a flow ended, its rounded time among them."""
    last, long = coefficients[-1], len(coefficients)
    # A last step shorter than the time can tell has no rate; the one before it has.
    while long and times[long] == times[long - 1]:
        long -= 1
    if not long:
        return last
    terms = np.empty((len(last), last.shape[1] + 1))
    terms[:, :-1] = last
    rates = coefficients[long - 1] @ np.arange(last.shape[1])
    terms[:, -1] = rates / (times[long] - times[long - 1]) * times[-1]
    return terms


_UNCERTIFIED = (Outcome.UNDECIDED, Outcome.NON_FINITE)
