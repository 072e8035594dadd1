"""Condition number of event times: state error to time error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from statechart.arrays import EPS, Array
from statechart.automaton.regions import Margin, whole_margins
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
    before = {arc.j: arc for arc in trace.arcs}
    groups: dict[Margin, list[int]] = {}
    for place, jump in enumerate(trace.jumps):
        margin = _fired(observer, trace, before.get(jump.j), jump)
        if margin is not None:
            groups.setdefault(margin, []).append(place)
    numbers: list[float | None] = [None] * len(trace.jumps)
    scale = sizes(trace)
    for margin, places in groups.items():
        jumps = [trace.jumps[place] for place in places]
        for place, kappa in zip(
            places, _condition(observer, trace, margin, jumps, scale), strict=True
        ):
            numbers[place] = kappa if not math.isnan(kappa) else None
    return tuple(numbers)


def _fired(observer: Observer, trace: Trace, arc: Arc | None, jump: Jump) -> Margin | None:
    """Return the margin whose fall ended `arc` in `jump`."""
    simulator = observer.simulator
    if arc is None or not jump.fired or not isinstance(simulator, Simulator):
        return None
    margins = simulator.modes.compiled(arc.roles, trace.zeros).mode.margins
    # A stop names the condition, not its atom.
    named = (*margins, *whole_margins(margins))
    return next((margin for margin in named if margin.name == jump.fired[0]), None)


def _condition(
    observer: Observer, trace: Trace, margin: Margin, jumps: Sequence[Jump], scale: Array
) -> list[float]:
    """Return the conditions of the events of one margin."""

    def gradient(perturbed: Sequence[tuple[Jump, Jump]], steps: Array) -> Array:
        below, above = (
            observer.at(trace, [margin.expression], side, before=True)[:, 0]
            for side in zip(*perturbed, strict=True)
        )
        return np.asarray((above - below) / (2.0 * steps))

    rates = observer.at(trace, list(observer.automaton.rates), jumps, before=True)
    span = trace.t_end or 1.0
    rate = gradient(
        [(replace(j, t=j.t - _STEP * span), replace(j, t=j.t + _STEP * span)) for j in jumps],
        np.full(len(jumps), _STEP * span),
    )
    total = np.zeros(len(jumps))
    for i, size in enumerate(scale.tolist()):
        step = _STEP * (size or 1.0)
        shift = np.zeros(len(scale))
        shift[i] = step
        slope = gradient(
            [
                (replace(j, before=j.before - shift), replace(j, before=j.before + shift))
                for j in jumps
            ],
            np.full(len(jumps), step),
        )
        rate += slope * rates[:, i]
        total += np.abs(slope) * size
    with np.errstate(divide="ignore", invalid="ignore"):
        return (total / (span * np.abs(rate))).tolist()
