"""Condition number of event times: state error to time error."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import EPS, Array
from statechart.automaton.regions import whole_margins
from statechart.automaton.trace import Arc, Jump, Trace, sizes
from statechart.execution.simulator import Simulator
from statechart.observation.observer import Observer

# Relative step of central differences that balances truncation and round-off.
_STEP = EPS ** (1.0 / 3.0)


def conditions(observer: Observer, trace: Trace) -> tuple[float | None, ...]:
    """Return the condition number of the time of every event.

    An event is the zero of a margin m(x, t) along the flow. An error dx of the state moves it by

        dt = -(dm/dx . dx) / (dm/dt along the flow).

    With relative errors eps of the sizes s_i (largest magnitudes in the run) and times relative to
    the end T of the run,

        |dt| / T <= kappa eps,    kappa = sum_i |dm/dx_i| s_i / (T |dm/dt|).

    kappa is about 1 for a ball that hits the ground squarely, larger for a flat approach, and inf
    for a graze. dx includes errors magnified by earlier events. The condition is None if no margin
    fired the jump (a further jump of an instant, a Zeno accumulation, a time step), or the margin
    is undefined on one side. Gradients are central differences with relative error 1e-10.
    """
    simulator = observer.simulator
    if not isinstance(simulator, Simulator):
        return (None,) * len(trace.jumps)
    before, scale = {arc.j: arc for arc in trace.arcs}, sizes(trace)
    with np.errstate(all="ignore"):
        found = [_condition(simulator, trace, before.get(j.j), j, scale) for j in trace.jumps]
    return tuple(found)


def _condition(
    simulator: Simulator, trace: Trace, arc: Arc | None, jump: Jump, scale: Array
) -> float | None:
    if arc is None or not jump.fired:
        return None
    compiled, fired = simulator.modes.compiled(arc.roles, trace.zeros), jump.fired[0]
    tape, names = compiled.guards, compiled.names
    if fired not in names:
        # A stop names the condition, not its atom.
        tape = compiled.wholes
        names = tuple(margin.name for margin in whole_margins(compiled.mode.margins))
    if fired not in names:
        return None
    span = trace.t_end or 1.0
    steps = _STEP * np.append(np.where(scale > 0.0, scale, 1.0), span)
    shifts = np.vstack([np.diag(steps), np.diag(-steps)])
    states, times = jump.before + shifts[:, :-1], jump.t + shifts[:, -1]
    above, below = np.split(tape.table(states, trace.values, times)[:, names.index(fired)], 2)
    *slopes, delay = (above - below) / (2.0 * steps)
    rate = delay + np.dot(slopes, compiled.rates.values(jump.before, trace.values, jump.t))
    kappa = float(np.dot(np.abs(slopes), scale) / (span * np.abs(rate)))
    return None if math.isnan(kappa) else kappa
