"""SciPy's adaptive integrators, with dense output as polynomials."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy as sp
from scipy import integrate

from statechart.arrays import Array, Bools
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.engines.engine import Continuation, Engine, FlowWatch, Path
from statechart.errors import NonFinite, StepFailure
from statechart.formulas.tape import Tape

METHODS = ("RK45", "DOP853", "Radau", "LSODA")

# With the factor below, this resolves a variable at rest to round-off.
_RATE_ROUND_OFF = 1e3 * float(np.finfo(float).eps)
# Errors of smaller magnitudes underflow.
_SMALLEST = 1e-280
# Smaller fractions of a variable are zero, since DOP853 divides squares of its errors.
_UNDERFLOW = 1e-100
# Round-off of the rates times a step, in parts of the error estimate that it causes.
_NOISE = 4.0
# Absolute tolerances are relative to this part of the scales of variables; round-off of the rates
# raises them, at most to the scales, and to `_COARSEST` of these: forces of stiff contacts follow.
_PART, _COARSEST = 1e-3, 1e-11
# Least relative tolerance of solve_ivp.
_MIN_TOLERANCE = 100 * float(np.finfo(float).eps)
# The slope error of dense output is below _SLOPE * tolerance**_SLOWER: one order lower than the
# step (RK45 5, DOP853 8). Ten times the maximum over the shipped models.
_SLOPE, _SLOWER = 50.0, 0.85


def _clamp_roots(expression: sp.Expr) -> sp.Expr:
    """Set the roots of negative bases to zero, so that trial states have rates."""
    result: sp.Expr = expression.replace(
        lambda e: e.is_Pow and e.exp.is_number and 0 < e.exp < 1 and not e.base.is_nonnegative,
        lambda e: sp.Pow(sp.Max(e.base, 0), e.exp),
    )
    return result


@dataclass(eq=False)
class _Stepper:
    rates: Tape
    trial_rates: Tape  # with roots of negative bases replaced by zero
    rooted: list[int]  # variables at whose zero the base of a root in the rates is zero
    varying: Bools  # (n,) variables that the flow changes
    solver: Any = None
    suggested: float | None = None
    noise: Array | None = None  # (n,) round-off of the rates, once it has shortened a step


class SciPy(Engine):
    """RK45, DOP853, Radau or LSODA."""

    name = "scipy"

    def __init__(
        self, tolerance: float, method: str = "DOP853", max_step: float = math.inf
    ) -> None:
        self.tolerance = max(tolerance, _MIN_TOLERANCE)
        self.method, self.max_step = method, max_step
        self.allowed = _SLOPE * self.tolerance**_SLOWER

    def compile(self, automaton: Automaton, mode: Mode, rates: Tape) -> _Stepper:
        """Return the stepper of the rates."""
        bases = [power.base for power in mode.roots]
        rooted = [
            k
            for k, v in enumerate(automaton.variables)
            if any(v in base.free_symbols and base.subs(v, 0) == 0 for base in bases)
        ]
        trial_rates = rates
        if any(not power.base.is_nonnegative for power in mode.roots):
            definitions = tuple((s, _clamp_roots(e)) for s, e in mode.definitions)
            clamped = replace(mode, definitions=definitions)
            trial_rates = automaton.tape([_clamp_roots(rate) for rate in mode.rates], clamped)
        return _Stepper(rates, trial_rates, rooted, np.array(mode.varying))

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
        """Take one step, after which the constraints are projected."""
        assert isinstance(stepper, _Stepper)
        reached = path.times.item(path.count)
        start = watch.start + reached
        solver = stepper.solver
        # Trial steps may overflow, and are rejected.
        with np.errstate(over="ignore", invalid="ignore"):
            moved = continuation is Continuation.MOVED
            if moved and self.method == "LSODA" and solver.status == "running":
                _move(solver, state)
            elif continuation is not Continuation.ON:
                if continuation is Continuation.NEW:
                    stepper.suggested = stepper.noise = None
                solver = self._solver(stepper, watch.parameters, start, state, until - reached)
                stepper.solver = solver
            tried = min(getattr(solver, "h_abs", 0.0), self.max_step)
            if stepper.noise is not None:
                noisy = np.fmin(_NOISE * tried * stepper.noise, self._coarsest)
                solver.atol = np.maximum(self._absolute, noisy)
            try:
                solver.step()
            except ValueError as error:
                # The matrix that Radau factors, its Jacobian less 1/h, overflows.
                if "NaN" not in str(error):
                    raise
                solver.status = "failed"
            if solver.status == "running" and solver.step_size < tried:
                noise = _round_off(solver)
                stepper.noise = noise if stepper.noise is None else np.fmax(noise, stepper.noise)
        if solver.status == "failed":
            raise StepFailure(
                f"{self.method} at t = {start:.6g} needs steps shorter than the resolution of "
                "time; end motion that goes to infinity by a stop condition"
            )
        if not np.all(np.isfinite(solver.y)):
            raise NonFinite(f"the state is not finite after t = {start:.6g}")
        stepper.suggested = getattr(solver, "h_abs", None)
        h = float(solver.t - solver.t_old)
        polynomial = _polynomial(solver.dense_output(), h, solver.n)
        path.append(h, polynomial)
        polynomial.sum(axis=1, out=end)
        reconstructed = watch.reconstruction.onto(end, start + h)
        if reconstructed is not end:
            end[:] = reconstructed
            if self.method != "LSODA":  # its Nordsieck history contains the state
                solver.y[:] = reconstructed
        if finished := bool(solver.status == "finished"):
            path.times[path.count] = until
        return finished

    def _solver(
        self, stepper: _Stepper, parameters: Array, start: float, state: Array, duration: float
    ) -> Any:
        values, trial_values = stepper.rates.values, stepper.trial_rates.values

        def rates(local: float, y: Array) -> Array:
            self.evaluations += 1
            return trial_values(y, parameters, start + local)

        with np.errstate(divide="ignore"):
            if not np.isfinite(values(state, parameters, start)).all():
                # SciPy would search a first step without end.
                raise NonFinite(
                    f"the rates are not finite at t = {start:.6g}; write a state for each side of "
                    "what changes there"
                )
        magnitude, sizes = np.abs(state), self.sizes
        # Counts and other constants have no scale in common with what moves.
        moved = np.where(stepper.varying, magnitude, 0.0)
        if sizes is None:
            # Without declared scales, the absolute tolerance of a variable at zero follows from the
            # others, or from rate times duration, which does not depend on the unit of time.
            rate = float(np.abs(rates(0.0, state)).max(initial=0.0)) * min(duration, 1.0)
            largest = float(moved.max(initial=0.0))
            largest = largest if largest > _UNDERFLOW * rate else rate
            smallest = np.full(len(state), max(largest, _SMALLEST) if largest > 0.0 else 1.0)
        else:
            # In declared scales, reduced to the present motion (late, low bounces), but not below
            # the round-off of a state at rest.
            moving = float((moved / sizes).max(initial=0.0))
            smallest = sizes * max(moving, _RATE_ROUND_OFF / self.tolerance)
        self.floor = np.maximum(magnitude, _PART * smallest)
        absolute = self._absolute = self.tolerance * self.floor
        # Errors of a variable near zero grow in its root; one that passes zero needs short steps.
        absolute[stepper.rooted] *= math.sqrt(self.tolerance)
        self._coarsest = min(self.tolerance, _COARSEST) * np.maximum(magnitude, smallest)
        self._coarsest[stepper.rooted] = absolute[stepper.rooted]
        options: dict[str, Any] = {"rtol": self.tolerance, "atol": absolute}
        if self.max_step < math.inf:
            options["max_step"] = self.max_step
        if stepper.suggested is not None and 0 < stepper.suggested < duration:
            options["first_step"] = stepper.suggested
        solver = getattr(integrate, self.method)
        started = np.where(magnitude < _UNDERFLOW * self.floor, 0.0, state)
        return solver(rates, 0.0, started, duration, **options)


def _round_off(solver: Any) -> Array:
    """Return the change (n,) of the rates by the last digits of the state.

    Shorter steps do not reduce the error that it causes; without it, steps would collapse.
    """
    y, last = solver.y, np.spacing(solver.y)
    alternating = np.where(np.arange(len(y)) % 2, -last, last)
    at, *others = [solver.fun(solver.t, x) for x in (y, y + last, y + alternating)]
    result: Array = np.abs(np.array(others) - at).max(axis=0)
    return result


def _move(solver: Any, state: Array) -> None:
    """Replace the state of LSODA, and retain its history.

    A restarted multistep method has order 1 and tiny steps. The state is the first column of the
    Nordsieck array; the others are correct to within its error, as in the projection of CVODE
    (E. Eich, SIAM J. Numer. Anal. 30, 1993).
    """
    inner = solver._lsoda_solver
    inner._integrator.rwork[20 : 20 + solver.n] = state
    inner._y[:] = state
    solver.y = state.copy()


def _polynomial(dense: Any, h: float, n: int) -> Array:
    """Return the dense output of a step of length `h` as (n, d + 1) coefficients in s = t / h."""
    kind = type(dense).__name__
    if kind == "RkDenseOutput":
        # y_old + h Q (s, s^2, ...)
        return np.concatenate([dense.y_old[:, None], h * dense.Q], axis=1)
    if kind == "RadauDenseOutput":
        return np.concatenate([dense.y_old[:, None], dense.Q], axis=1)
    if kind == "Dop853DenseOutput":
        return _dop853(dense.y_old, dense.F)
    if kind == "LsodaDenseOutput":
        return _nordsieck(dense, h)
    # Constant dense output.
    return np.asarray(dense(dense.t_old))[:, None]


def _dop853(old: Array, f: Array) -> Array:
    """Expand the nested form of DOP853: factors s and 1 - s in turn (Hairer, Norsett, Wanner)."""
    result = np.zeros((len(old), len(f) + 1))
    for i, row in enumerate(f[::-1]):
        result[:, 0] += row
        shifted = np.zeros_like(result)
        shifted[:, 1:] = result[:, :-1]
        result = shifted if i % 2 == 0 else result - shifted
    result[:, 0] += old
    return result


def _nordsieck(dense: Any, h: float) -> Array:
    """Shift the Nordsieck array of LSODA from the end of the step to its start."""
    scaled = np.asarray(dense.yh) * (h / dense.h) ** dense.p
    degree = scaled.shape[1] - 1
    # (s - 1)^k in powers of s.
    shift = np.zeros((degree + 1, degree + 1))
    shift[0, 0] = 1.0
    for k in range(1, degree + 1):
        shift[k, 1:] += shift[k - 1, :-1]
        shift[k] -= shift[k - 1]
    return scaled @ shift
