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

# Most pieces of a step.
_MAX_BOXES = 4096
# Variables are as large as this part of their sizes at least, as where steps are checked.
_MIN_SIZE = 1e-6
# The rounding of rates, bounded operation by operation, is up to so many times what it is: a step
# may be off by as much more than what the check of steps allows.
_PROVED = 16.0
# Step of central differences, in sizes of the variables: truncation and round-off do not matter to
# an estimate.
_STEP = 1e-6
# A displacement that becomes as large has met another event.
_FAR = 1e3 * _STEP
# By what part a guard's rate may change within what its event may be late by: where it turns, the
# time of its event goes with the root of the error.
_TURNS = 0.25
# A step that begins this close to the end of the last one continues it.
_ROUNDED = 8.0 * float(np.finfo(float).eps)
# Terms of the exponential of a matrix of norm up to 1/2: the remainder is below 1e-18.
_TERMS = 15
# A law may change its equations so often before it jumps.
_PATIENCE = 8


class Certificate:
    """Bounds the error of every step of a run that is made again, and estimates that of the whole.

    The integral of the defect |p' - f(p, t)| over a step bounds what it adds to the error, to
    first order in that. For the whole, what the defects add is carried on by the flow's
    variational equations, and through events by their saltation matrices (M. A. Aizerman and
    F. R. Gantmakher, Quart. J. Mech. Appl. Math. 11, 1958); what is not known of them, their
    rounding, is taken for independent from step to step.
    """

    def __init__(self, trace: Trace, setup: Setup, laws: Laws, engine: Engine) -> None:
        least = _MIN_SIZE * (np.ones(len(trace.variables)) if setup.sizes is None else setup.sizes)
        # All that follows is in parts of the variables' sizes, and of the end of the run.
        self._scale, self._end = np.maximum(sizes(trace), least), trace.t_end or 1.0
        self._variables, self._setup, self._laws = trace.variables, setup, laws
        self._allowed, self._least = engine.allowed, engine.tolerance
        self._error = np.zeros(len(self._scale))
        self._unknown = np.zeros((len(self._scale),) * 2)  # a covariance
        self._local, self._where, self._late = 0.0, (0.0, ""), 0.0
        # Errors are so small that they propagate linearly.
        self._linear = True
        self._before: tuple[Arc, CompiledMode] | None = None
        # During an event: its state and those displaced from it, one for every variable and one
        # along the flow; the delay of the event by each variable; how much too early it was taken,
        # as its guard was rounded; the largest rate.
        self._states: list[Array] = []
        self._later, self._early, self._fastest = np.zeros(len(self._scale)), 0.0, 1.0

    def motion(self) -> Motion:
        """Return what was found, at the end of the run."""
        if self._states:
            self._carry(self._through(self._states)[:, :-1])
        with np.errstate(invalid="ignore"):
            ends = np.abs(self._error) + np.sqrt(np.diag(self._unknown))
        # The tolerance decides which contacts are closed and at rest.
        whole = max(float(ends.max(initial=0.0)), self._late, self._least)
        return Motion(
            local=self._local,
            at=self._where[0],
            of=self._where[1],
            whole=whole if self._linear and 0.0 <= whole <= 1.0 else math.inf,
            proved=self._local <= _PROVED * self._allowed,
        )

    def flow(self, arc: Arc, compiled: CompiledMode) -> None:
        """Take the steps of a flow."""
        scale, rates = self._scale, compiled.rates
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
            # A step begins where the last one was brought back onto its constraints.
            shifts = np.zeros_like(bounds)
            shifts[:-1] = arc.coefficients[1:, :, 0] - arc.coefficients[:-1].sum(axis=2)
            shifts[np.abs(shifts) <= _ROUNDED * np.abs(arc.coefficients).sum(axis=2)] = 0.0
            bounds += np.abs(shifts)
            bounds /= scale
            bounds[np.isnan(bounds)] = np.inf
            worst, variable = divmod(int(bounds.argmax()), len(scale))
            if not bounds[worst, variable] <= self._local:
                self._local = float(bounds[worst, variable])
                self._where = arc.start.high + float(arc.times[worst]), self._variables[variable]
            slopes = self._slopes(rates, arc)
            for step, (slope, moment, rest) in enumerate(
                zip(slopes, moments, unknown, strict=True)
            ):
                added, power = np.zeros(len(scale)), np.eye(len(scale))
                for order in range(MOMENTS):
                    added += power @ (moment[:, order] / scale)
                    power = power @ slope / (order + 1)
                self._carry(_exponential(slope) if np.isfinite(slope).all() else slope)
                self._error += added
                self._unknown += np.diag((rest / scale) ** 2)
                if shifts[step].any():
                    self._error += shifts[step] / scale
                    begun, time = arc.coefficients[step + 1, :, 0], arc.times.item(step + 1)
                    displaced = self._displaced(begun, np.eye(len(scale)))
                    near = self._constrained(displaced, arc, arc.start.high + time)
                    self._carry(self._through(near))
        self._before = arc, compiled

    def jump(self, instant: Instant, jump: Jump) -> None:
        """Take a jump: make it again from displaced states."""
        with np.errstate(all="ignore"):
            states = self._states or self._arrived(instant)
            self._states = [self._jumped(instant._replace(state=x), jump) for x in states]

    def switch(self, instant: Instant) -> None:
        """Take an instant at which only the rates jump."""
        with np.errstate(all="ignore"):
            self._states = self._states or self._arrived(instant)

    def _jumped(self, instant: Instant, jump: Jump) -> Array:
        """Return where a state next to that of a jump goes."""
        found = _jump_target(self._laws, instant, jump)
        if found is not None and np.abs((found - jump.after) / self._scale).max() < _FAR:
            return found
        # If another jump follows, the displacement stays as it is.
        return jump.after + (instant.state - jump.before)

    def _carry(self, through: Array) -> None:
        self._error = through @ self._error
        self._unknown = through @ self._unknown @ through.T

    def _displaced(self, state: Array, by: Array) -> list[Array]:
        """Return a state, and those that small displacements (the columns) lead to."""
        state = contiguous(state)
        return [state, *(state + _STEP * self._scale * column for column in by.T)]

    def _through(self, states: list[Array]) -> Array:
        """Return what became of displacements (the columns)."""
        return np.array([(state - states[0]) / (_STEP * self._scale) for state in states[1:]]).T

    def _constrained(self, states: list[Array], arc: Arc, time: float) -> list[Array]:
        """Bring states onto the constraints of a flow from each of them."""
        laws, setup, roles = self._laws, self._setup, arc.roles
        try:
            return [laws.constraints(setup, roles, time, x).project(x, time) for x in states]
        except SimulationError:
            return states

    def _arrived(self, instant: Instant) -> list[Array]:
        """Return the state of an event and, of states displaced from it, where they meet it.

        Behind them one that is displaced along the flow.
        """
        before, size = instant.state, len(self._scale)
        self._later, self._early, flow = np.zeros(size), 0.0, np.zeros(size)
        if self._before is None:
            return self._displaced(before, np.eye(size, size + 1))
        (arc, compiled), time = self._before, instant.clock.high
        near = self._constrained(self._displaced(before, np.eye(size)), arc, time)
        self._error += (near[0] - before) / self._scale
        tangents = self._through(near)
        if instant.fired and instant.fired[0] in compiled.names:
            guard = compiled.names.index(instant.fired[0])
            slope, rates, along = self._falling(compiled, guard, before, time)
            self._later = -(slope / along) @ tangents
            margin = compiled.guards.values(before, self._setup.values, time)[guard]
            flow, self._early = rates, -float(margin) / along
            spread = np.sqrt(self._later @ self._unknown @ self._later)
            late = abs(float(self._later @ self._error)) + float(spread)
            late += abs(self._early)
            self._late = max(self._late, late / self._end)
            # Within what the event may be late by, the guard has to fall on.
            earlier = before - late * self._scale * rates
            _, _, there = self._falling(compiled, guard, earlier, time - late)
            self._linear = self._linear and abs(there - along) <= _TURNS * abs(along)
            tangents += np.outer(rates, self._later)
        # As far as the others.
        self._fastest = float(np.abs(flow).max(initial=0.0)) or 1.0
        return self._displaced(near[0], np.column_stack([tangents, flow / self._fastest]))

    def _begin(self, arc: Arc, rates: Tape) -> None:
        """Carry the errors through an event to the flow that follows it."""
        start, time = arc.coefficients[0, :, 0], arc.start.high
        near = self._constrained(self._states, arc, time)
        flown = rates.values(start, self._setup.values, time) / self._scale
        through = self._through(near)
        self._carry(through[:, :-1] - np.outer(flown, self._later))
        # From one event to the next they are as independent as rounding is.
        missed = self._early * (self._fastest * through[:, -1] - flown)
        self._unknown += np.outer(missed, missed)
        self._error += (start - near[0]) / self._scale
        self._states = []

    def _slopes(self, rates: Tape, arc: Arc) -> Array:
        """Return the derivatives (k, n, n) of the rates half way through steps, in their time."""
        half = 0.5 ** np.arange(arc.coefficients.shape[2])
        spans = np.diff(arc.times)
        middles = arc.start.high + arc.times[:-1] + 0.5 * spans
        slopes = self._gradients(rates, arc.coefficients @ half, middles)
        return np.asarray(slopes * (spans[:, None, None] / self._scale[:, None]))

    def _gradients(self, tape: Tape, states: Array, times: Array) -> Array:
        """Return the derivatives (m, n_out, n) of a tape's outputs, by sizes of the variables."""
        m, n = states.shape
        moved = np.repeat(states[:, None, :], 2 * n, axis=1)
        shift = _STEP * np.diag(self._scale)
        moved[:, :n] -= shift
        moved[:, n:] += shift
        values = tape.table(moved.reshape(-1, n), self._setup.values, np.repeat(times, 2 * n))
        values = values.reshape(m, 2, n, -1)
        return np.asarray((values[:, 1] - values[:, 0]).swapaxes(1, 2) / (2.0 * _STEP))

    def _falling(
        self, compiled: CompiledMode, guard: int, state: Array, time: float
    ) -> tuple[Array, Array, float]:
        """Return a guard's derivative and the flow, by sizes of the variables; the guard's rate."""
        rates = compiled.rates.values(state, self._setup.values, time) / self._scale
        slope = self._gradients(compiled.guards, state[None], np.array([time]))[0, guard]
        along = float(slope @ rates) + self._rate(compiled.guards, guard, state, time)
        return slope, rates, along

    def _rate(self, guards: Tape, guard: int, state: Array, time: float) -> float:
        """Return the rate of a guard with time alone."""
        step = _STEP * self._end
        times, states = np.array([time - step, time + step]), np.array([state, state])
        below, above = guards.table(states, self._setup.values, times)[:, guard]
        return float(above - below) / (2.0 * step)


def _jump_target(laws: Laws, instant: Instant, jump: Jump) -> Array | None:
    """Return the state after a jump from a nearby instant; None if another jump is made there."""
    for _ in range(_PATIENCE):
        try:
            made = laws.jump(instant)
        except SimulationError:
            return None
        if made is None:
            return None
        found, following = made
        if found is not None:
            same = (found.target, found.cause) == (jump.target, jump.cause)
            return found.after if same else None
        instant = instant._replace(flow=following)
    return None


def _exponential(matrix: Array) -> Array:
    """Return the exponential of a matrix: Taylor's series, by scaling and squaring.

    Method 3 of C. Moler and C. Van Loan, SIAM Review 45, 2003.
    """
    # SciPy's takes 0.15 s to import, and its BLAS wakes threads for matrices as small as these.
    _, doublings = math.frexp(float(np.abs(matrix).sum(axis=1).max(initial=0.0)))
    squarings = max(doublings + 1, 0)  # the sum of no row is above 1/2 then
    scaled, term = matrix * 0.5**squarings, np.eye(len(matrix))
    total = term
    for order in range(1, _TERMS + 1):
        term = term @ scaled / order
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return total
