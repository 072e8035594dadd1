"""Roots of an output of a tape along a step, in floating point."""

from __future__ import annotations

from statechart.arrays import Array
from statechart.kernels.boxes import StepTape, enclose
from statechart.kernels.intervals import EPS, INF, TINY
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import horner, local_time
from statechart.kernels.tapes import run_tape


@kernel
def value_at(step_tape: StepTape, step: int, output: int, s: float, regs: Array) -> float:
    """Value of an output at one place of a step."""
    code, base, first, last, reads, times, coeffs, start = step_tape
    n = coeffs.shape[1]
    for r in range(reads.shape[0]):
        v = reads[r]
        if v == n:
            regs[n, 0] = start + local_time(times, step, s)
        else:
            regs[v, 0] = horner(coeffs, step, v, s)
    run_tape(code, first, last, base, regs, 1)
    return regs[output, 0]


_NODES = (0.046910077030668, 0.230765344947158, 0.5, 0.769234655052842, 0.953089922969332)
_WEIGHTS = (
    0.118463442528095, 0.239314335249683, 0.284444444444444, 0.239314335249683, 0.118463442528095,
)  # fmt: skip
"""Quadrature of Gauss and Legendre on [0, 1], exact for polynomials up to the ninth power."""


@kernel
def _integrate_slope(
    step_tape: StepTape, step: int, output: int, place: float, bounds: Array, jets: Array
) -> float:
    """Integral of the slope of an output over [0, place] of a step."""
    total = 0.0
    for k in range(len(_NODES)):
        enclose(step_tape, step, bounds, place * _NODES[k], 0.0, 1, jets)
        total += _WEIGHTS[k] * 0.5 * (jets[output, 2] + jets[output, 3])
    return place * total


@kernel
def return_to_zero(
    step_tape: StepTape, step: int, output: int, place: float, below: float, bounds: Array,
    regs: Array, jets: Array,
) -> float:  # fmt: skip
    """Refine the return to zero of an output that is exactly zero at the start of the step.

    The values are differences of coordinates with their round-off; the slope is more accurate.
    Newton's method on the integral of the slope gives the duration of a low flight independently
    of the origin, from a place where the output is `below` zero. The root moves within the
    round-off of the value only: over a long step the quadrature is less accurate, and callers
    compare the value at the root with its tolerance.
    """
    if value_at(step_tape, step, output, 0.0, regs) != 0.0:
        return place
    enclose(step_tape, step, bounds, place, 0.0, 0, jets)
    noise, found = jets[output, 1] - jets[output, 0], below
    if not abs(_integrate_slope(step_tape, step, output, place, bounds, jets)) <= noise:
        return place
    last = INF
    for _ in range(64):
        height = _integrate_slope(step_tape, step, output, found, bounds, jets)
        enclose(step_tape, step, bounds, found, 0.0, 1, jets)
        slope = 0.5 * (jets[output, 2] + jets[output, 3])
        if not slope < 0.0:
            return place
        move = height / slope
        found -= move
        if not found > 0.0:
            return place
        # The corrections shrink, at first by half, down to the round-off of the slope.
        if abs(move) <= EPS * found or abs(move) > 0.75 * last:
            return found
        last = abs(move)
    return place


@kernel
def locate_fall(
    step_tape: StepTape,
    step: int,
    output: int,
    shift: float,
    left: float,
    right: float,
    regs: Array,
) -> float:
    """Last place, to a few ulp, with output + shift >= 0 before it falls in [left, right].

    Chandrupatla, "A new hybrid quadratic/bisection algorithm", Advances in Engineering Software
    28 (1997) 145-149. Returns `left` if the output is already below there, and `right` if
    float64 resolves no fall.
    """
    a, fa = right, shift + value_at(step_tape, step, output, right, regs)
    b, fb = left, shift + value_at(step_tape, step, output, left, regs)
    if not fb > 0.0:
        return left
    if not fa < 0.0:
        return right
    # The secant first: on a descent one end is near the root.
    t = min(max(fa / (fa - fb), EPS), 1.0 - EPS)
    c, fc = a, fa
    for _ in range(1200):  # enough halvings from 1 to the smallest float
        x = a + t * (b - a)
        fx = shift + value_at(step_tape, step, output, x, regs)
        if (fx > 0.0) == (fa > 0.0):
            c, fc = a, fa
        else:
            c, fc, b, fb = b, fb, a, fa
        a, fa = x, fx
        reach = EPS * abs(a if abs(fa) < abs(fb) else b) + TINY
        if abs(b - a) <= 2.0 * reach or fx == 0.0:
            break
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
        t = 0.5
        if phi * phi < xi and (1.0 - phi) * (1.0 - phi) < 1.0 - xi:
            t = fa / (fb - fa) * fc / (fb - fc)
            t += (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        edge = reach / abs(b - a)
        t = min(max(t, edge), 1.0 - edge)
    return a if fa >= 0.0 else b
