"""Arrival of a flow at the zero of a base e under a root, as in a tank h' = -c sqrt(h).

The rates depend on e**p, 0 < p < 1, so that steps in time shrink without end before e = 0. With
u = e**(1 - p) as independent variable the flow stays smooth (for h' = -c h**p the rate u' is
constant): dx/du = x'/u', dt/du = 1/u'.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array
from statechart.execution.compiled_modes import CompiledMode
from statechart.formulas.series import Series, expand

# A step reduces u by this factor.
_RATIO = 0.7
_ROUND_OFF = float(np.finfo(float).eps)
# The last step begins at this part of the terms of e, where a difference has an error of 1e-4.
_SMALL = 1e4 * _ROUND_OFF
# Part of e' that depends on e**p, below which ordinary steps pass the zero of abs(x) or max(x, 0).
_CONSTANT = 0.1


def steps_to_zero(
    compiled: CompiledMode, index: int, parameters: Array, state: Array, time: float
) -> list[tuple[float, Array]]:
    """Return steps (duration, polynomials (n, 4)) to the zero of a base; [] if it turns before."""
    from scipy.integrate import RK45  # slow import

    p, place = compiled.roots.exponents[index], (index,)
    n = len(state)

    def base(now: Array, rates: Array) -> Series:
        pairs = zip(now[:-1].tolist(), rates.tolist(), strict=True)
        variables = [Series([x, v], [abs(x), abs(v)]) for x, v in pairs]
        return expand(compiled.roots.bases, variables, parameters.tolist(), now.item(-1), place)[0]

    def flow(now: Array) -> tuple[Array, float, float]:
        """Return (state, time)', e and e'; NaN if e does not fall."""
        rates = compiled.rates.values(now[:-1], parameters, now.item(-1))
        e, change = base(now, rates).values
        return np.append(rates, 1.0), e, change if e > 0.0 > change else np.nan

    def moved_to(now: Array, u: float) -> Array:
        """Return (state, time) with the state moved along the flow to the value of u."""
        rates, e, change = flow(now)
        moved = now + rates * (u ** (1.0 / (1.0 - p)) - e) / change
        return np.append(moved[:-1], now[-1])

    def slope(now: Array, u: float) -> Array:
        rates, e, change = flow(moved_to(now, u))
        return rates * e**p / ((p - 1.0) * change)

    def last_step(now: Array, h: float) -> tuple[float, Array]:
        # x' = a + b e**p, and e ends below zero.
        rates, e, change = flow(now)
        halved, _, _ = flow(now - 0.5 * rates * e / change)
        motion = h * (rates - p * (rates - halved) / (1.0 - 0.5**p))
        end = now + motion
        (excess, _), (terms, _) = base(end, np.zeros(n))
        # abs(x) and max(x, 0) may stay at zero, others end below it by round-off.
        below = 0.0 if compiled.roots.nonnegative[index] else _ROUND_OFF * max(terms, initial)
        rest = (excess + below) / (initial - excess)
        motion[:-1] += rest * (end[:-1] - state)
        linear = h * rates
        return h, np.stack([now, linear, motion - linear], axis=1)[:-1]

    now = np.append(state, time)
    rates, initial, change = flow(now)
    if not change < 0.0:
        return []
    if compiled.roots.nonnegative[index]:
        _, _, halved = flow(now - 0.5 * rates * initial / change)
        if not change - halved < _CONSTANT * (1.0 - 0.5**p) * change:
            return []
    u = initial ** (1.0 - p)
    found, slopes = list[tuple[float, Array]](), np.empty((RK45.n_stages, n + 1))
    slopes[0] = slope(now, u)
    while np.isfinite(slopes[0]).all():
        (e, _), (terms, _) = base(now, np.zeros(n))
        if not e > _SMALL * max(terms, initial):
            return [*found, last_step(now, u * slopes[0].item(-1))]
        length = u * (1.0 - _RATIO)
        for i in range(1, len(slopes)):
            node = now + length * (RK45.A[i, :i] @ slopes[:i])
            slopes[i] = slope(node, u - RK45.C[i] * length)
        u -= length
        end = moved_to(now + length * (RK45.B @ slopes), u)
        first, slopes[0] = slopes[0].copy(), slope(end, u)
        change = (end - now)[:-1]
        h = end.item(-1) - now.item(-1)
        a, b = h / first[-1] * first[:-1], h / slopes[0, -1] * slopes[0, :-1]
        terms_in_s = [now[:-1], a, 3.0 * change - 2.0 * a - b, a + b - 2.0 * change]
        found.append((h, np.stack(terms_in_s, axis=1)))
        now = end
    return []
