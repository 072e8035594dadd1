"""High-order Taylor method of heyoka (Biscani and Izzo, MNRAS 504, 2021).

heyoka computes steps and dense output. Its event detection is not used: it gives no proof.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.compiling import whole
from statechart.documents.fields import TIME
from statechart.documents.setting import LONG_DOUBLE
from statechart.engines.engine import Continuation, Engine, FlowWatch, Pace, Path, StepFunction
from statechart.engines.taylor_loop import (
    MAX_HALVINGS,
    MAX_SLOPE_ERROR,
    MIN_MOTION,
    Step,
    limited_length,
    taylor_steps,
)
from statechart.errors import NonFinite, StepFailure, Unsupported
from statechart.formulas.tape import Tape
from statechart.formulas.writer import to_text
from statechart.kernels.polynomials import append_steps
from statechart.tabular import pluralise

# Unrolled and unoptimised, 20 operations compile in 0.015 s, 250 in 0.13 s; optimised, in 0.2 s and
# 2 s, for steps of 0.5 to 0.85 of the time. Above _LARGE operations on tape, heyoka's compact mode
# compiles faster, optimised, and steps as fast.
_LARGE = 500
# This to the power -20, the order of the method, is near the largest float.
_LEAST_BASE = 1e-12
# Allowed slope error, relative to the motion and in tolerances: ten times the maximum over the
# shipped models.
_SLOPE, _ORDERS = 1e-12, 1e3
_SHOWN = 80  # characters of a formula in a message


def has_long_double() -> bool:
    """Return whether heyoka supports long doubles with more digits than a double."""
    import heyoka as hy

    finer = np.finfo(np.longdouble).eps < np.finfo(float).eps
    return bool(finer) and hasattr(hy, "taylor_adaptive_ldbl")


@dataclass(eq=False)
class _Stepper:
    integrator: Any
    compiled: Step | None
    fixed: Tape  # parameters of the integrator after the time
    powers: tuple[str, ...]  # without a Taylor series at base zero
    poles: tuple[bool, ...]  # marks of negative ones
    bases: Tape
    rates: Tape

    def __post_init__(self) -> None:
        # Views into the memory of the integrator.
        self.state, self.pars = self.integrator.state, self.integrator.pars
        self.series, self.shape = self.integrator.tc, self.integrator.tc.shape
        # Arguments of compiled steps: address, state, parameters, clock, series.
        address, self._clock = 0 if self.compiled is None else self.compiled.address, np.zeros(2)
        series = np.empty(self.shape)
        self.integrator_memory = address, self.state, self.pars, self._clock, series
        self.durations: Array = np.empty(0)

    def enter(self, state: Array, watch: FlowWatch, time: float) -> None:
        """Set the initial state and time."""
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
        self.sharp = not extended
        self._number: type[Any] = np.longdouble if extended else float
        self.tolerance = max(tolerance, float(np.finfo(self._number).eps))
        self.allowed = max(_SLOPE, _ORDERS * self.tolerance)
        self.max_step = max_step
        # Rates, with constants as parameters -> integrator and step.
        self._programs: dict[tuple[Any, ...], tuple[Any, Step | None]] = {}

    def compile(self, automaton: Automaton, mode: Mode, rates: Tape) -> _Stepper:
        """Compile the rates, shared by modes that differ in parameters only."""
        import heyoka as hy

        from statechart.engines.heyoka_formulas import Converter

        extended = self._number is not float
        convert = Converter(rates, folds=not extended)
        states = [hy.expression(f"v{i}") for i in range(len(automaton.variables))]
        form = convert.expressions
        cached = self._programs.get(form)
        if cached is None:
            compact = extended or len(rates.code) > _LARGE
            with whole(f"the equations of a mode ({pluralise(len(states), 'variable')})"):
                integrator = hy.taylor_adaptive(
                    list(zip(states, form, strict=True)),
                    [self._number(0)] * len(states),
                    tol=self._number(self.tolerance),
                    fp_type=self._number,
                    compact_mode=compact,
                    opt_level=3 if compact else 0,
                )
            cached = self._programs[form] = integrator, None if extended else Step.of(integrator)
        integrator, compiled = cached
        # heyoka drops parameters that it simplifies away (a mass may cancel); the first is the
        # start of the arc.
        fixed = convert.fixed(max(len(integrator.pars) - 1, 0))
        singular = _singular_powers(automaton, mode)
        return _Stepper(
            integrator,
            compiled,
            fixed,
            tuple(_shown(automaton, *power) for power in singular),
            tuple(bool(exponent.is_negative) for _, exponent in singular),
            automaton.tape([base for base, _ in singular], mode),
            rates,
        )

    def step_function(self, stepper: object) -> StepFunction | None:
        """Return the step function for compiled loops (see `Engine`)."""
        assert isinstance(stepper, _Stepper)
        if stepper.compiled is None:
            return None
        pace = Pace(self.tolerance, self.max_step, self.allowed, stepper.shape[1])
        return StepFunction(stepper.compiled.address, stepper.fixed, len(stepper.pars), pace)

    def check(
        self, stepper: object, path: Path, state: Array, parameters: Array, time: float
    ) -> None:
        """Raise `Unsupported` at a non-integer power with base zero, `NonFinite` at its pole."""
        assert isinstance(stepper, _Stepper)
        bases = stepper.bases.values(state, parameters, time)
        before, times = path.coefficients[: path.count, :, 0], np.full(path.count, time)
        largest = stepper.bases.table(before, parameters, times).max(axis=0, initial=0.0)
        for k, (power, base) in enumerate(zip(stepper.powers, bases.tolist(), strict=True)):
            if stepper.poles[k] and base <= _LEAST_BASE * largest[k]:
                raise NonFinite(
                    f"{power} grows without bound at t = {time:.6g}; add "
                    "stop: {conditions: {NAME: RELATION}} that ends the run before, as at the "
                    "target of a pursuit"
                )
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
        continuation: Continuation,
        end: Array,
    ) -> bool:
        """Take up to `count` steps (see `Engine`)."""
        assert isinstance(stepper, _Stepper)
        first = path.count
        reached = path.times.item(first)
        path.reserve(count, *stepper.shape)
        start = watch.start + reached
        if continuation is not Continuation.ON:
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
            self.check(stepper, path, state, watch.parameters, start)
            if np.isfinite(stepper.rates.values(state, watch.parameters, start)).all():
                raise Unsupported(
                    f"the Taylor series of the rates overflows at t = {start:.6g}; use "
                    "engine: scipy"
                )
            raise NonFinite(
                f"the state or its rate is not finite near t = {start:.6g}; look for a logarithm, "
                "root or quotient without a value there"
            )
        if h == 0.0 and remaining > 0.0:
            # The steps before the one that underflowed are valid, and may contain an event.
            if path.times.item(limit) == path.times.item(limit - 1):
                limit -= 1
            if limit == first:
                self.check(stepper, path, state, watch.parameters, start)
                raise StepFailure(f"the step near t = {start:.6g} underflowed")
        path.count = limit
        if finished := bool(finite == steps_taken and h == remaining):
            path.times[limit] = until
        end[:] = watch.reconstruction.onto(end, watch.start + path.times.item(limit))
        return finished


def _singular_powers(automaton: Automaton, mode: Mode) -> list[tuple[sp.Expr, sp.Expr]]:
    """Return base and exponent of the powers in the rates that have no series at base zero."""
    used, defined = set(mode.rates), dict(mode.definitions)
    while fresh := {defined[x] for e in used for x in e.free_symbols & defined.keys()} - used:
        used |= fresh
    powers = {power.args for e in used for power in e.atoms(sp.Pow) if not power.exp.is_Integer}
    # A step has the root of a square for an absolute value.
    sizes = {(size.args[0] ** 2, sp.S.Half) for e in used for size in e.atoms(sp.Abs, sp.sign)}
    singular = [*sp.ordered(powers), *sp.ordered(sizes - powers)]
    tape = automaton.tape([base for base, _ in singular], mode)
    return list(itertools.compress(singular, tape.varying))


def _shown(automaton: Automaton, base: sp.Expr, exponent: sp.Expr) -> str:
    """Return a power with the declared names."""
    symbols = (*automaton.variables, *automaton.parameters, automaton.time)
    symbol_names = (*automaton.names, *automaton.parameter_names, TIME)
    names = dict(zip(symbols, map(sp.Symbol, symbol_names), strict=True))
    # Unevaluated: the root of a square would become an absolute value.
    return to_text(sp.Pow(base.xreplace(names), exponent, evaluate=False))[:_SHOWN]


def _one_by_one(
    stepper: _Stepper,
    path: Path,
    watch: FlowWatch,
    duration: Any,
    max_step: float,
    count: int,
    end: Array,
) -> tuple[int, int, float, float]:
    """Take steps by heyoka's Python interface, in the precision of `duration`."""
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
        for _ in range(MAX_HALVINGS):
            stepper.state[:], stepper.integrator.time = started, began
            h = step(longest, True)[1]
            taken = float(h)
            with np.errstate(over="ignore"):  # an infinite size does not limit the step
                limit = limited_length(now.astype(float), taken)
            if limit < taken:
                longest = type(h)(limit)
                continue
            slopes = now * (order * h**order)
            ends = stepper.state.astype(float)
            rates = stepper.rates.values(ends, watch.parameters, time + taken)
            distance = np.abs(slopes.sum(axis=1) - h * rates).max()
            if not distance > MAX_SLOPE_ERROR * max(
                MIN_MOTION, np.abs(started).max(), np.abs(slopes).sum(axis=1).max()
            ):
                break
            longest = h / 2
        with np.errstate(over="ignore"):  # long doubles beyond the range of doubles
            series[first + steps_taken] = now
        durations[steps_taken] = h
        time += float(h)
        steps_taken += 1
        # The last step ends at the duration exactly.
        if h == remaining or not h > 0.0:
            break
        remaining -= h
    finite = append_steps(durations, steps_taken, first, path.times, series, end)
    return steps_taken, finite, float(h), float(remaining)
