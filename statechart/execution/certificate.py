"""Certificate of the motion: enclosed defects of the steps and the global error estimate."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.automaton.laws import Instant, Laws, Setup
from statechart.automaton.trace import Arc, Jump, Motion, Trace, sizes
from statechart.engines.engine import Engine
from statechart.errors import SimulationError
from statechart.execution.compiled_modes import CompiledMode
from statechart.formulas.tape import Tape, contiguous
from statechart.kernels.boxes import Steps
from statechart.kernels.enclosed_defect import MOMENTS, enclosed_defect

# Boxes per step.
_MAX_BOXES = 4096
# Smallest magnitude of variables relative to their sizes, as in the check of steps.
_MIN_SIZE = 1e-6
# Overestimation of the round-off of rates by interval bounds: a step is proved if its defect is
# below this multiple of the allowed one.
_PROVED = 16.0
# Step of central differences, relative to the sizes of variables; accurate enough for an estimate.
_STEP = 1e-6
# A displacement larger than this has met another event.
_MAX_DISPLACEMENT = 1e3 * _STEP
# Relative change of a guard's rate within the uncertainty of the event's time, above which the time
# is not linear in the error.
_MAX_RATE_CHANGE = 0.25
# Relative distance of the begin of a step from the end of the last one that is round-off.
_CONTINUITY_ROUND_OFF = 8.0 * float(np.finfo(float).eps)
# Changes of equations by the laws before a jump.
_MAX_REARRANGEMENTS = 8


class Certificate:
    """Bounds the local error of every step of a repeated run, and estimates the global error.

    The integral of the defect |p' - f(p, t)| over a step bounds its local error to first order. The
    global error is propagated by the variational equations of the flow, and through events by
    saltation matrices (M. A. Aizerman and F. R. Gantmakher, Quart. J. Mech. Appl. Math. 11, 1958);
    round-off is taken as independent from step to step.
    """

    def __init__(self, trace: Trace, setup: Setup, laws: Laws, engine: Engine) -> None:
        smallest_sizes = _MIN_SIZE * (
            np.ones(len(trace.variables)) if setup.sizes is None else setup.sizes
        )
        # Errors are relative to the sizes of variables, times to the end of the run.
        self._scale, self._end = np.maximum(sizes(trace), smallest_sizes), trace.t_end or 1.0
        self._variables, self._setup, self._laws = trace.variables, setup, laws
        self._allowed, self._least = engine.allowed, engine.tolerance
        self._error = np.zeros(len(self._scale))
        self._unknown = np.zeros((len(self._scale),) * 2)  # a covariance
        self._local, self._where, self._late = 0.0, (0.0, ""), 0.0
        # True while errors propagate linearly.
        self._linear = True
        self._before: tuple[Arc, CompiledMode] | None = None
        # During an event: its state and displaced ones, one per variable and one along the flow;
        # the delay of the event by each variable; the time error by round-off of the guard; the
        # largest rate.
        self._states: list[Array] = []
        self._later, self._early, self._fastest = np.zeros(len(self._scale)), 0.0, 1.0

    def motion(self) -> Motion:
        """Return the error bounds at the end of the run."""
        if self._states:
            self._carry(self._through(self._states)[:, :-1])
        with np.errstate(invalid="ignore"):
            ends = np.abs(self._error) + np.sqrt(np.diag(self._unknown))
        # The tolerance decides which contacts are closed and at rest.
        global_error = max(float(ends.max(initial=0.0)), self._late, self._least)
        return Motion(
            local=self._local,
            at=self._where[0],
            of=self._where[1],
            whole=global_error if self._linear and 0.0 <= global_error <= 1.0 else math.inf,
            proved=self._local <= _PROVED * self._allowed,
        )

    def flow(self, arc: Arc, compiled: CompiledMode) -> None:
        """Process the steps of a flow."""
        scale, rates = self._scale, compiled.rates
        from scipy.linalg import expm  # slow import

        with np.errstate(all="ignore"):
            if self._states:
                self._begin(arc, rates)
            bounds, moments, unknown = enclosed_defect(
                rates.parts,
                Steps(arc.times, arc.coefficients, self._setup.values, arc.start.high),
                scale,
                self._allowed,
                _MAX_BOXES,
            )
            # Projections onto the constraints between steps.
            shifts = np.zeros_like(bounds)
            shifts[:-1] = arc.coefficients[1:, :, 0] - arc.coefficients[:-1].sum(axis=2)
            shifts[
                np.abs(shifts) <= _CONTINUITY_ROUND_OFF * np.abs(arc.coefficients).sum(axis=2)
            ] = 0.0
            bounds += np.abs(shifts)
            bounds /= scale
            bounds[np.isnan(bounds)] = np.inf
            worst, variable = divmod(int(bounds.argmax()), len(scale))
            if not bounds[worst, variable] <= self._local:
                self._local = float(bounds[worst, variable])
                self._where = arc.start.high + float(arc.times[worst]), self._variables[variable]
            slopes = self._slopes(rates, arc)
            for step, (slope, moment, round_off) in enumerate(
                zip(slopes, moments, unknown, strict=True)
            ):
                added, power = np.zeros(len(scale)), np.eye(len(scale))
                for order in range(MOMENTS):
                    added += power @ (moment[:, order] / scale)
                    power = power @ slope / (order + 1)
                self._carry(expm(slope) if np.isfinite(slope).all() else slope)
                self._error += added
                self._unknown += np.diag((round_off / scale) ** 2)
                if shifts[step].any():
                    self._error += shifts[step] / scale
                    start, time = arc.coefficients[step + 1, :, 0], arc.times.item(step + 1)
                    displaced = self._displaced(start, np.eye(len(scale)))
                    projected = self._constrained(displaced, arc, arc.start.high + time)
                    self._carry(self._through(projected))
        self._before = arc, compiled

    def jump(self, instant: Instant, jump: Jump) -> None:
        """Process a jump: repeat it from displaced states."""
        with np.errstate(all="ignore"):
            states = self._states or self._event_states(instant)
            self._states = [self._state_after_jump(instant._replace(state=x), jump) for x in states]

    def switch(self, instant: Instant) -> None:
        """Process an instant at which only the rates jump."""
        with np.errstate(all="ignore"):
            self._states = self._states or self._event_states(instant)

    def _state_after_jump(self, instant: Instant, jump: Jump) -> Array:
        """Return the state after the jump from a displaced state."""
        target = _jump_target(self._laws, instant, jump)
        if (
            target is not None
            and np.abs((target - jump.after) / self._scale).max() < _MAX_DISPLACEMENT
        ):
            return target
        # If another jump follows, the displacement stays as it is.
        return jump.after + (instant.state - jump.before)

    def _carry(self, through: Array) -> None:
        self._error = through @ self._error
        self._unknown = through @ self._unknown @ through.T

    def _displaced(self, state: Array, by: Array) -> list[Array]:
        state = contiguous(state)
        return [state, *(state + _STEP * self._scale * column for column in by.T)]

    def _through(self, states: list[Array]) -> Array:
        return np.array([(state - states[0]) / (_STEP * self._scale) for state in states[1:]]).T

    def _constrained(self, states: list[Array], arc: Arc, time: float) -> list[Array]:
        """Project states onto the constraints of a flow from each of them."""
        laws, setup, roles = self._laws, self._setup, arc.roles
        try:
            return [laws.constraints(setup, roles, time, x).project(x, time) for x in states]
        except SimulationError:
            return states

    def _event_states(self, instant: Instant) -> list[Array]:
        """Return the event state, displaced states at their own events, and one along the flow."""
        before, size = instant.state, len(self._scale)
        self._later, self._early, flow = np.zeros(size), 0.0, np.zeros(size)
        if self._before is None:
            return self._displaced(before, np.eye(size, size + 1))
        (arc, compiled), time = self._before, instant.clock.high
        projected = self._constrained(self._displaced(before, np.eye(size)), arc, time)
        self._error += (projected[0] - before) / self._scale
        tangents = self._through(projected)
        if instant.fired and instant.fired[0] in compiled.names:
            guard = compiled.names.index(instant.fired[0])
            slope, rates, guard_rate = self._falling(compiled, guard, before, time)
            if guard_rate == 0.0:
                # The time of an event at which the guard stands still is not linear in the error.
                self._linear = False
                return self._displaced(projected[0], np.column_stack([tangents, flow]))
            self._later = -(slope / guard_rate) @ tangents
            margin = compiled.guards.values(before, self._setup.values, time)[guard]
            flow, self._early = rates, -float(margin) / guard_rate
            spread = np.sqrt(self._later @ self._unknown @ self._later)
            delay = abs(float(self._later @ self._error)) + float(spread)
            delay += abs(self._early)
            self._late = max(self._late, delay / self._end)
            # The guard must fall throughout the uncertainty of the event's time.
            earlier = before - delay * self._scale * rates
            _, _, earlier_rate = self._falling(compiled, guard, earlier, time - delay)
            self._linear = self._linear and abs(
                earlier_rate - guard_rate
            ) <= _MAX_RATE_CHANGE * abs(guard_rate)
            tangents += np.outer(rates, self._later)
        # The displacement along the flow has the size of the others.
        self._fastest = float(np.abs(flow).max(initial=0.0)) or 1.0
        return self._displaced(projected[0], np.column_stack([tangents, flow / self._fastest]))

    def _begin(self, arc: Arc, rates: Tape) -> None:
        """Propagate the errors through an event to the next flow."""
        start, time = arc.coefficients[0, :, 0], arc.start.high
        projected = self._constrained(self._states, arc, time)
        rates_after = rates.values(start, self._setup.values, time) / self._scale
        through = self._through(projected)
        self._carry(through[:, :-1] - np.outer(rates_after, self._later))
        # Time errors of events by round-off are independent.
        missed = self._early * (self._fastest * through[:, -1] - rates_after)
        self._unknown += np.outer(missed, missed)
        self._error += (start - projected[0]) / self._scale
        self._states = []

    def _slopes(self, rates: Tape, arc: Arc) -> Array:
        """Return the derivatives (k, n, n) of the rates at midpoints, times the step lengths."""
        half = 0.5 ** np.arange(arc.coefficients.shape[2])
        spans = np.diff(arc.times)
        middles = arc.start.high + arc.times[:-1] + 0.5 * spans
        slopes = self._gradients(rates, arc.coefficients @ half, middles)
        return np.asarray(slopes * (spans[:, None, None] / self._scale[:, None]))

    def _gradients(self, tape: Tape, states: Array, times: Array) -> Array:
        """Return the derivatives (m, n_out, n) of a tape's outputs by scaled variables."""
        m, n = states.shape
        displaced = np.repeat(states[:, None, :], 2 * n, axis=1)
        shift = _STEP * np.diag(self._scale)
        displaced[:, :n] -= shift
        displaced[:, n:] += shift
        values = tape.table(displaced.reshape(-1, n), self._setup.values, np.repeat(times, 2 * n))
        values = values.reshape(m, 2, n, -1)
        return np.asarray((values[:, 1] - values[:, 0]).swapaxes(1, 2) / (2.0 * _STEP))

    def _falling(
        self, compiled: CompiledMode, guard: int, state: Array, time: float
    ) -> tuple[Array, Array, float]:
        """Return gradient of a guard and rates in scaled variables, and the guard's rate."""
        rates = compiled.rates.values(state, self._setup.values, time) / self._scale
        slope = self._gradients(compiled.guards, state[None], np.array([time]))[0, guard]
        # The partial derivative with respect to time, by central differences.
        step = _STEP * self._end
        times, states = np.array([time - step, time + step]), np.array([state, state])
        below, above = compiled.guards.table(states, self._setup.values, times)[:, guard]
        return slope, rates, float(slope @ rates) + float(above - below) / (2.0 * step)


def _jump_target(laws: Laws, instant: Instant, jump: Jump) -> Array | None:
    """Return the state after a jump from a nearby instant; None for a different jump."""
    for _ in range(_MAX_REARRANGEMENTS):
        try:
            result = laws.jump(instant)
        except SimulationError:
            return None
        if result is None:
            return None
        next_jump, following = result
        if next_jump is not None:
            is_same = (next_jump.target, next_jump.cause) == (jump.target, jump.cause)
            return next_jump.after if is_same else None
        instant = instant._replace(flow=following)
    return None
