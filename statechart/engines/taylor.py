"""Taylor's method of high order, by heyoka (Biscani and Izzo, MNRAS 504, 2021).

Steps and polynomials are heyoka's; its own event detection is not used, because it samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.compiling import whole
from statechart.documents.setting import LONG_DOUBLE
from statechart.engines.engine import Begin, Engine, Entry, FlowWatch, Pace, Path
from statechart.engines.taylor_loop import HALVINGS, LEAST_MOTION, STRAY, Step, taylor_steps
from statechart.errors import NonFinite, StepFailure, Unsupported
from statechart.formulas.tape import Tape
from statechart.kernels.polynomials import append_steps
from statechart.tabular import several

# Compiling 250 operations without loops takes 1.7 s and 42 MB, with loops 0.4 s and 8 MB; unless
# they are so few on tape, where each is there once.
_COMPACT, _FEW = 240, 100
# Seconds that compiling takes at least, and for each operation: above the shipped models' times.
_BEGIN, _EACH = 0.01, 2e-4
# To the power -20, the order of the method, and some more for the derivatives of a surface, this is
# near the largest float. Asked for only where a step fails.
_LEAST_BASE = 1e-12
# Slopes may be off their rates by so much in parts of the motion, or in tolerances: ten times what
# the shipped models show.
_SLOPE, _ORDERS = 1e-12, 1e3
_SHOWN = 80  # characters of a formula in a message


def _many(mode: Mode, rates: Tape) -> bool:
    """Return whether the operations of a mode are too many to be compiled without loops."""
    written = sp.count_ops([*(value for _, value in mode.definitions), *mode.rates])
    return bool(len(rates.code) > _FEW and written > _COMPACT)


def has_long_double() -> bool:
    """Return whether a long double has more digits than a double, and heyoka computes with it."""
    import heyoka as hy

    finer = np.finfo(np.longdouble).eps < np.finfo(float).eps
    return bool(finer) and hasattr(hy, "taylor_adaptive_ldbl")


@dataclass(eq=False)
class _Stepper:
    integrator: Any
    compiled: Step | None
    fixed: Tape  # The integrator's parameters behind the time.
    powers: tuple[str, ...]  # Without a series where their base is zero.
    bases: Tape
    rates: Tape

    def __post_init__(self) -> None:
        # Views into the integrator's own memory; it alone writes the last.
        self.state, self.pars = self.integrator.state, self.integrator.pars
        self.series, self.shape = self.integrator.tc, self.integrator.tc.shape
        # Arguments of compiled steps: address, state, parameters, clock, series.
        address, self._clock = 0 if self.compiled is None else self.compiled.address, np.zeros(2)
        series = np.empty(self.shape)
        self.integrator_memory = address, self.state, self.pars, self._clock, series
        self.durations: Array = np.empty(0)

    def enter(self, state: Array, watch: FlowWatch, time: float) -> None:
        """Begin in a state at a time."""
        self._clock[:] = 0.0
        if self.compiled is None:
            self.integrator.time = self.state.dtype.type(0.0)
        self.state[:] = state
        if len(self.pars):
            self.pars[0] = time
            self.pars[1:] = self.fixed.at(state, watch.parameters, watch.start)


class Taylor(Engine):
    """Adaptive Taylor integration with dense output of the order of the method."""

    name = "taylor"

    def __init__(
        self, tolerance: float, *, extended: bool = False, max_step: float = math.inf
    ) -> None:
        self.method = LONG_DOUBLE if extended else "taylor"
        # The order rises with the digits.
        self.sharp = not extended
        self._number: type[Any] = np.longdouble if extended else float
        self.tolerance = max(tolerance, float(np.finfo(self._number).eps))
        self.allowed = max(_SLOPE, _ORDERS * self.tolerance)
        self.max_step = max_step
        # Rates, with numbers of a run as parameters -> what was compiled of them.
        self._programs: dict[tuple[Any, ...], tuple[Any, Step | None]] = {}

    def compile(self, automaton: Automaton, mode: Mode, rates: Tape) -> _Stepper:
        """Compile the rates, once for all modes in which they are the same but for parameters."""
        # Whoever only asks for a tolerance need not wait for them.
        import heyoka as hy

        from statechart.engines.heyoka_formulas import Converter

        extended = self._number is not float
        convert = Converter(automaton, dict(mode.definitions), folds=not extended)
        states = [hy.expression(f"v{i}") for i in range(len(automaton.variables))]
        form = tuple(convert.rate(rate) for rate in mode.rates)
        cached = self._programs.get(form)
        if cached is None:
            # Loops in the compiled code cost small modes up to half of their speed; without them
            # the compiler needs half a minute for a mode of two thousand operations. Of long
            # doubles it takes several times as long.
            compact = extended or _many(mode, rates)
            with whole(f"the equations of a mode ({several(len(states), 'variable')})"):
                integrator = hy.taylor_adaptive(
                    list(zip(states, form, strict=True)),
                    [self._number(0)] * len(states),
                    tol=self._number(self.tolerance),
                    fp_type=self._number,
                    compact_mode=compact,
                )
            cached = self._programs[form] = integrator, None if extended else Step.of(integrator)
        integrator, compiled = cached
        # heyoka keeps as many parameters as it needs after its own simplifications (a mass may
        # cancel); the first is the start of the arc.
        fixed = automaton.tape(convert.constants[: max(len(integrator.pars) - 1, 0)], mode)
        symbols = (*automaton.variables, *automaton.parameters)
        symbol_names = (*automaton.names, *automaton.parameter_names)
        names = dict(zip(symbols, map(sp.Symbol, symbol_names), strict=True))
        return _Stepper(
            integrator,
            compiled,
            fixed,
            tuple(
                # The root of a square would become an absolute value again.
                sp.sstr(sp.Pow(base.xreplace(names), exponent, evaluate=False))[:_SHOWN]
                for base, exponent in convert.singular
            ),
            automaton.tape([base for base, _ in convert.singular], mode),
            rates,
        )

    def entry(self, stepper: object) -> Entry | None:
        """Return where loops enter a step (see `Engine`)."""
        assert isinstance(stepper, _Stepper)
        if stepper.compiled is None:
            return None
        pace = Pace(self.tolerance, self.max_step, self.allowed, stepper.shape[1])
        return Entry(stepper.compiled.address, stepper.fixed, len(stepper.pars), pace)

    def compiling(self, rates: Tape) -> float:
        """Return about how many seconds `compile` takes."""
        return _BEGIN + _EACH * len(rates.code)

    def check(self, stepper: object, state: Array, parameters: Array, time: float) -> None:
        """Raise `Unsupported` where a power that is not a whole one meets a base of zero."""
        assert isinstance(stepper, _Stepper)
        bases = stepper.bases.values(state, parameters, time)
        for power, base in zip(stepper.powers, bases.tolist(), strict=True):
            if not base > _LEAST_BASE:
                raise Unsupported(
                    f"{power} has no Taylor series at t = {time:.6g}, where its base is "
                    f"{base:.3g}; use engine: scipy"
                )

    def steps(
        self,
        stepper: object,
        path: Path,
        watch: FlowWatch,
        state: Array,
        until: float,
        count: int,
        begin: Begin,
        end: Array,
    ) -> bool:
        """Take up to `count` steps (see `Engine`)."""
        assert isinstance(stepper, _Stepper)
        first = path.count
        reached = path.times.item(first)
        path.reserve(count, *stepper.shape)
        start = watch.start + reached
        if begin is not Begin.ON:
            stepper.enter(state, watch, start)
        if stepper.compiled is None:
            remaining = self._number(until - reached)
            steps_taken, finite, h, remaining = _one_by_one(
                stepper, path, watch, remaining, self.max_step, count, end
            )
        else:
            steps_taken, finite, h, remaining = taylor_steps(
                (*stepper.integrator_memory, self.tolerance, self.max_step),
                until - reached, count, path.times[first:], path.coefficients[first:], end,
                watch.reconstruction.program, watch.start,
            )  # fmt: skip
        limit = first + finite
        if limit == first:
            self.check(stepper, state, watch.parameters, start)
            if np.isfinite(stepper.rates.values(state, watch.parameters, start)).all():
                raise Unsupported(
                    f"the Taylor series of the rates overflows at t = {start:.6g}; use "
                    "engine: scipy"
                )
            raise NonFinite(f"the state or its rate is not finite near t = {start:.6g}")
        if h == 0.0 and remaining > 0.0:
            # The steps before the one that underflowed stand, and may hold an event.
            if path.times.item(limit) == path.times.item(limit - 1):
                limit -= 1
            if limit == first:
                self.check(stepper, state, watch.parameters, start)
                raise StepFailure(f"the step near t = {start:.6g} underflowed")
        path.count = limit
        if finished := bool(finite == steps_taken and h == remaining):
            path.times[limit] = until
        end[:] = watch.reconstruction.onto(end, watch.start + path.times.item(limit))
        return finished


def _one_by_one(
    stepper: _Stepper,
    path: Path,
    watch: FlowWatch,
    duration: Any,
    max_step: float,
    count: int,
    end: Array,
) -> tuple[int, int, float, float]:
    """Do what the compiled steps do with heyoka's own calls, in the precision of `duration`."""
    if count > len(stepper.durations):
        stepper.durations = np.empty(count)
    step, durations = stepper.integrator.step, stepper.durations
    series, now = path.coefficients, stepper.series
    first, remaining, h = path.count, duration, duration
    time = watch.start + path.times.item(first)
    steps_taken = 0
    order = np.arange(now.shape[1])
    while steps_taken < count:
        started, began = stepper.state.copy(), stepper.integrator.time
        longest = min(remaining, type(remaining)(max_step))
        for _ in range(HALVINGS):
            stepper.state[:], stepper.integrator.time = started, began
            h = step(longest, True)[1]
            slopes = now * (order * h**order)
            ends = stepper.state.astype(float)
            rates = stepper.rates.values(ends, watch.parameters, time + float(h))
            distance = np.abs(slopes.sum(axis=1) - h * rates).max()
            if not distance > STRAY * max(
                LEAST_MOTION, np.abs(started).max(), np.abs(slopes).sum(axis=1).max()
            ):
                break
            longest = h / 2
        with np.errstate(over="ignore"):  # of what no double can hold, the step is not finite
            series[first + steps_taken] = now
        durations[steps_taken] = h
        time += float(h)
        steps_taken += 1
        # The step is cut to end at the duration exactly, and then its length is what was left.
        if h == remaining or not h > 0.0:
            break
        remaining -= h
    finite = append_steps(durations, steps_taken, first, path.times, series, end)
    return steps_taken, finite, float(h), float(remaining)
