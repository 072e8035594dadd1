"""Common assertions on runs of scenes: friction cones, growth of energy, ends of steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.states import OPEN
from statechart.arrays import EPS, ROUND_OFF, Array
from statechart.automaton.laws import moving_mode
from statechart.automaton.trace import Arc, Trace
from statechart.execution.simulator import Simulator
from statechart.testing.guards import dense
from statechart.testing.subject import Subject


def largest_of(impulses: Iterable[Mapping[str, tuple[float, float]]]) -> float:
    """Return the size of the largest impulse of a run.

    Parameters
    ----------
    impulses : iterable of mapping
        For each jump, contact -> normal and tangential impulse.
    """
    return max((math.hypot(*impulse) for some in impulses for impulse in some.values()), default=0)


def assert_in_cone(
    impulse: tuple[float, float], edge: tuple[float, float], largest: float, where: str
) -> None:
    """Check that an impulse pushes, within friction, up to round-off of the largest impulse.

    Parameters
    ----------
    impulse : (float, float)
        Normal and tangential.
    edge : (float, float)
        The unit edge (n, t) of the cone ``n |tangential| <= t normal``: (1, mu) over its length,
        (0, 1) for infinite friction.
    largest : float
        The size of the largest impulse of the run.
    where : str
        Place, for messages.

    Raises
    ------
    AssertionError
        If the impulse pulls, or lies outside the cone.
    """
    normal, tangential = impulse
    allowed = 100.0 * ROUND_OFF * math.hypot(normal, tangential) + 4.0 * EPS * largest
    assert normal >= -allowed, f"the impulse {where} pulls: {normal:.6g}"
    outside = edge[0] * abs(tangential) - edge[1] * normal
    assert outside <= allowed, (
        f"the impulse {where} is outside the cone: {tangential:.6g}/{normal:.6g}"
    )


def step_ends(trace: Trace, arc: Arc) -> slice:
    """Return the indices of an arc's times at which the scheme is accurate: all without steps.

    A time step with an impact is recorded in two halves; only its ends are accurate.

    Parameters
    ----------
    trace : Trace
        A run.
    arc : Arc
        One of its arcs.
    """
    if trace.step is None:
        return slice(None)
    first = arc.j > 0 and trace.jumps[arc.j - 1].energy is not None
    last = arc.j < len(trace.jumps) and trace.jumps[arc.j].energy is not None
    return slice(1 if first else 0, -1 if last else None)


def no_growth(points: Sequence[tuple[float, float, str]], allowed: float, rate: float) -> None:
    """Check that an energy never grows by more than `allowed`, and `rate` per time.

    Parameters
    ----------
    points : sequence of (float, float, str)
        Time, energy minus work, and place.
    allowed, rate : float
        Errors at an instant, and per time since the energy was smallest.

    Raises
    ------
    AssertionError
        If the energy grows by more.
    """
    least = math.inf
    for t, value, where in points:
        grown = value - rate * t - least
        if grown > allowed:
            raise AssertionError(
                f"energy grows by {grown:.6g} up to t = {t:.6g} {where}, more than it may; "
                f"errors explain {allowed:.1e}"
            )
        least = min(least, value - rate * t)


def missed_by_slopes(
    subject: Subject, trace: Trace, arc: Arc, tau: Array, gaps: Sequence[sp.Expr]
) -> Array:
    """Return the changes of gaps (m, c) by the defect of the dense output.

    The ends of a step are on the constraints, so that its error is below its length times the
    defect of its rates, plus the change of the rates by that.
    """
    simulator = subject.observers[trace.engine.split()[0]].simulator
    if not isinstance(simulator, Simulator):
        return np.zeros((len(tau), len(gaps)))
    states, times = arc.states(tau), arc.start.high + (arc.start.low + tau)
    spans, orders = np.diff(arc.times), np.arange(1, arc.coefficients.shape[2])
    steps = np.repeat(np.arange(len(spans)), len(tau) // len(spans))
    h = spans[steps][:, None]
    powers = ((tau - arc.times[steps])[:, None] / h) ** (orders - 1)
    rates = simulator.modes.compiled(arc.roles, trace.zeros).rates
    rates_there = rates.table(states, trace.values, times)
    off = np.einsum("mvk,mk->mv", arc.coefficients[steps][:, :, 1:] * orders, powers)
    off -= h * rates_there
    off = np.abs(off) + h * np.abs(rates.table(states + off, trace.values, times) - rates_there)
    most = np.zeros((len(spans), states.shape[1]))
    np.maximum.at(most, steps, off)
    here = subject.values(trace, gaps, states, times)
    displacement = np.zeros(here.shape)
    for i in range(states.shape[1]):
        there = states.copy()
        there[:, i] += most[steps, i]
        displacement += np.abs(subject.values(trace, gaps, there, times) - here)
    return displacement


def assert_couples(mechanics: Mechanics, subject: Subject, trace: Trace) -> None:
    """Check that coupling torques are within their limits, and oppose slip."""
    scene = mechanics.scene
    expressions = [
        expression
        for name in scene.couplings
        for symbols in (mechanics.coupling(name),)
        for expression in (symbols.contact.H, symbols.contact.slip, *symbols[1:3])
    ]
    # Controllers follow the couplings.
    first = len(trace.regions) - len(scene.controlled.flat) - len(scene.couplings)
    for arc, tau in dense(trace):
        times = arc.start.high + (arc.start.low + tau)
        columns = iter(subject.solved(trace, arc, tau, expressions).T)
        for name, state in zip(scene.couplings, moving_mode(arc.roles)[first:], strict=False):
            couple, slip, static, kinetic = (next(columns) for _ in range(4))
            kinetic = np.zeros_like(kinetic) if state in OPEN else kinetic
            limit = static if state == "locked" else kinetic
            if trace.step is not None:
                # A step uses the limit at its middle, which ends the halves of one with an impact.
                by_steps = limit.reshape(len(arc.times) - 1, -1)
                most = by_steps.max(axis=1) + np.ptp(by_steps, axis=1)
                limit = np.repeat(most, by_steps.shape[1])
            allowed = trace.tolerances["force"] + ROUND_OFF * np.abs(limit)
            assert_no_less(limit - np.abs(couple), -allowed, f"{name}: limit - |M|", times, state)
            slow = trace.tolerances["speed"] + ROUND_OFF * np.abs(slip)
            if state == "locked":
                assert_no_less(-np.abs(slip), -slow, f"{name}: no slip, -|slip|", times, state)
            elif state not in OPEN:
                # The couple of a step in which the slip ends is a mean.
                mean = trace.step is not None and times >= times[0] - tau[0] + arc.times[-2]
                power = np.where(mean, 0.0, -couple * np.sign(slip))
                assert_no_less(power, -slow * limit, f"{name}: -M slip", times, state)


def assert_no_less(values: Array, least: Array, what: str, times: Array, state: str) -> None:
    """Check that values (m,) of the quantity `what` are nowhere below the `least` ones."""
    if not (values >= least).all():
        m = int(np.argmin(values - least))
        raise AssertionError(f"{what} is {values[m]:.6g} at t = {times[m]:.6g} in {state}")
