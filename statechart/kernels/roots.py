"""Where an output of a tape vanishes along a step, in floats."""

from __future__ import annotations

from statechart.arrays import Array
from statechart.kernels.boxes import Along
from statechart.kernels.intervals import EPS, TINY
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import horner, local_time
from statechart.kernels.tapes import run_tape


@kernel
def value_at(along: Along, step: int, output: int, s: float, regs: Array) -> float:
    """Value of an output at one place of a step."""
    code, base, first, last, reads, times, coeffs, start = along
    n = coeffs.shape[1]
    for r in range(reads.shape[0]):
        v = reads[r]
        if v == n:
            regs[n, 0] = start + local_time(times, step, s)
        else:
            regs[v, 0] = horner(coeffs, step, v, s)
    run_tape(code, first, last, base, regs, 1)
    return regs[output, 0]


@kernel
def last_place(
    along: Along,
    step: int,
    output: int,
    shift: float,
    left: float,
    right: float,
    regs: Array,
) -> float:
    """Last place, to a few ulp, with output + shift >= 0 before it falls in [left, right].

    Chandrupatla, "A new hybrid quadratic/bisection algorithm", Advances in Engineering Software
    28 (1997) 145-149. Returns `left` where the fall is already done there, and `right` where
    float64 sees none.
    """
    a, fa = right, shift + value_at(along, step, output, right, regs)
    b, fb = left, shift + value_at(along, step, output, left, regs)
    if not fb > 0.0:
        return left
    if not fa < 0.0:
        return right
    # By the secant first: where one end is near the root, as on a descent, that is nearly it.
    t = min(max(fa / (fa - fb), EPS), 1.0 - EPS)
    c, fc = a, fa
    for _ in range(1200):  # halvings from 1 to the least place, and some
        x = a + t * (b - a)
        fx = shift + value_at(along, step, output, x, regs)
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
