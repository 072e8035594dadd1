"""Rigorous bounds of the defect p'(s) - h f(p(s)) of the polynomials of steps.

The defect is enclosed piecewise. If f is analytic on the Bernstein ellipse of parameter rho around
a piece, the error of Chebyshev interpolation is below 4 M rho^-n / (rho - 1), where M bounds the
deviation of f from a constant on the ellipse (L. N. Trefethen, "Approximation Theory and
Approximation Practice", 2013, theorem 8.2). Circular arithmetic bounds M, interval arithmetic the
values at the points, and the Lagrange polynomials the integral of the interpolant. At singularities
(a kink, the start of a root) the pieces are halved until the range of f suffices.
"""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array, Complexes, Ints32
from statechart.kernels.boxes import (
    Steps,
    StepTape,
    bind_tape,
    bound_third_derivatives,
    write_variable_jets,
)
from statechart.kernels.copies import copy_numbers
from statechart.kernels.discs import run_discs
from statechart.kernels.intervals import EPS, INF, mul, sub
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import write_sizes
from statechart.kernels.resolution import NARROW
from statechart.kernels.tapes import TapeCode, run_tape

MOMENTS = 4
"""Number of moments of the defect, from which its effect at the end of a step follows."""

# Bernstein ellipse: sum of its semi-axes, in half lengths of a piece.
_RHO = 4.0
_REACH = 0.5 * (_RHO + 1.0 / _RHO)
# The interpolation error falls by rho per point: with this number it is round-off.
_POINTS = 26
_MANY = 8192
# Part of the allowed defect that the interpolation error of a piece may have without bisection.
_SHARE = 1.0 / 64.0
# Margin for sums of as many terms as a series has, and for the round-off of error bounds.
_WIDER = 1.0 + 2.0**-40


def _quadrature() -> tuple[Array, Array, Array]:
    """Return Chebyshev points on [-1, 1], their weights in integrals over a piece, and in bounds.

    The integral of |p| is at most the sum of |p| at the points times the integrals of |l|, with the
    Lagrange polynomials l. A fine sum gives these integrals to a thousandth, which is added.
    """
    n = _POINTS - 1
    points = np.cos(math.pi * np.arange(n, -1, -1) / n)
    signs = np.where(np.arange(n + 1) % 2 == 0, 1.0, -1.0)
    signs[[0, -1]] *= 0.5

    def lagrange(places: Array) -> Array:
        shares = signs / (places[:, None] - points)  # barycentric (Berrut and Trefethen, 2004)
        return np.asarray(shares / shares.sum(axis=1, keepdims=True))

    exact, weights = np.polynomial.legendre.leggauss(_POINTS)
    angles = math.pi * (np.arange(_MANY) + 0.5) / _MANY
    around = np.sin(angles) * math.pi / _MANY / 2.0
    sizes = np.abs(lagrange(np.cos(angles)))
    return points, 0.5 * weights @ lagrange(exact), 1.001 * (around @ sizes)


_PLACES, _WEIGHTS, _BOUNDS = _quadrature()
_ALL = float(_BOUNDS.sum())


@kernel
def _deviation_from_constant(
    step_tape: StepTape,
    outputs: Ints32,
    step: int,
    m: float,
    w: float,
    discs: tuple[Complexes, Array],
    work: tuple[Array, Array],
) -> None:
    """Bound the deviation of every rate from a constant on the ellipse around [m - w, m + w].

    Also of the slope of every polynomial; both in the step's local time. `discs`: centres and radii
    of registers; `work`: a shifted polynomial, and the result (n, 2).
    """
    (centres, radii), (shifted, found) = discs, work
    code, base, first, last, _, times, coeffs, start = step_tape
    n, terms = coeffs.shape[1], coeffs.shape[2]
    h, reach = times[step + 1] - times[step], w * _REACH
    for v in range(n):
        for k in range(terms):
            shifted[k] = coeffs[step, v, k]
        for i in range(terms - 1):  # the polynomial around m (Ruffini and Horner)
            for k in range(terms - 2, i - 1, -1):
                shifted[k] += m * shifted[k + 1]
        radius = slope = 0.0
        for k in range(terms - 1, 0, -1):
            radius = (radius + abs(shifted[k])) * reach
            if k > 1:
                slope = (slope + k * abs(shifted[k])) * reach
        size = abs(shifted[0])
        centres[v] = complex(shifted[0], 0.0)
        radii[v] = radius * _WIDER + 2.0**-40 * size if radius > 0.0 else 0.0
        found[v, 1] = slope
    centres[n] = complex(start + (times[step] + m * h), 0.0)
    radii[n] = reach * h * _WIDER + 2.0**-40 * abs(centres[n])
    run_discs(code, first, last, base, centres, radii)
    for v in range(n):
        found[v, 0] = h * radii[outputs[v]]
        if terms > _POINTS:
            found[v, 0] += found[v, 1]


@kernel(interpreted=False)
def enclosed_defect(
    tape: TapeCode, steps: Steps, floors: Array, allowed: float, budget: int
) -> tuple[Array, Array, Array]:
    """Bound the integrals of the defect over each step, for every variable.

    The tape has the rates of all variables. The overestimation of the enclosure is a small part of
    `allowed`, relative to the motion of the variables in a step and at least `floors` (n,);
    `budget` is the largest number of pieces per step. Returns bounds (k, n) of the integrals of
    |p' - f(p, t)| over the steps (infinite if there is none); moments (k, n, `MOMENTS`), the
    integrals of (p' - f) (1 - s)**i over s in [0, 1] by quadrature; and (k, n) error bounds of the
    moments.
    """
    code, constants, outputs, _, n_fixed = tape
    times, coeffs = steps.times, steps.coeffs
    n = coeffs.shape[1]
    tail = 4.0 / (_RHO - 1.0) * _RHO ** (1.0 - _POINTS)
    every = np.arange(n + 1).astype(np.int32)
    step_tape, regs = bind_tape(TapeCode(code, constants, outputs, every, n_fixed), steps, 1)
    run_tape(code, 0, n_fixed, step_tape[1], regs, 1)
    jets, centres, radii = _constant_registers(step_tape, regs)
    thirds, sizes = np.zeros(n), np.empty(n)
    shifted, spread = np.empty(coeffs.shape[2]), np.empty((n, 2))
    worst, wide = np.empty(n), np.empty(n)
    bounds, unknown = np.zeros((coeffs.shape[0], n)), np.zeros((coeffs.shape[0], n))
    moments = np.zeros((coeffs.shape[0], n, MOMENTS))
    lefts, rights = np.empty(64), np.empty(64)
    for step in range(coeffs.shape[0]):
        h = times[step + 1] - times[step]
        if not h > 0.0:
            continue
        bound_third_derivatives(coeffs, step, every, thirds)
        write_sizes(coeffs, step, floors, sizes)
        top, looked = 1, 0
        lefts[0], rights[0] = 0.0, 1.0
        while top > 0:
            top -= 1
            a, b = lefts[top], rights[top]
            m, looked = 0.5 * (a + b), looked + 1
            w = max(b - m, m - a)
            _deviation_from_constant(
                step_tape, outputs, step, m, w, (centres, radii), (shifted, spread)
            )
            smooth = True
            for v in range(n):
                smooth = smooth and tail * spread[v, 0] <= _SHARE * allowed * sizes[v]
            worst[:], wide[:] = 0.0, 0.0
            if smooth:
                for j in range(_POINTS):
                    s = min(max(m + w * _PLACES[j], a), b)
                    _enclose_defects(step_tape, outputs, step, thirds, s, 0.0, h, jets)
                    for v in range(n):
                        low, high = jets[v, 4], jets[v, 5]
                        worst[v] += _BOUNDS[j] * max(-low, high)
                        wide[v] = max(wide[v], 0.5 * (high - low))
                        share = (b - a) * _WEIGHTS[j] * 0.5 * (low + high)
                        for i in range(MOMENTS):
                            moments[step, v, i] += share
                            share *= 1.0 - s
                for v in range(n):
                    # Round-off of the points changes the values.
                    displacement = 8.0 * EPS / w * (spread[v, 0] + spread[v, 1]) / (_REACH - 1.0)
                    rest = tail * spread[v, 0]
                    worst[v] += _ALL * displacement + rest
                    wide[v] += displacement + rest
            else:
                _enclose_defects(step_tape, outputs, step, thirds, m, w, h, jets)
                small = True
                for v in range(n):
                    worst[v] = max(-jets[v, 4], jets[v, 5])
                    small = small and (b - a) * worst[v] <= _SHARE * allowed * sizes[v]
                if not small and b - a > NARROW and looked < budget:
                    lefts[top], rights[top] = m, b
                    lefts[top + 1], rights[top + 1] = a, m
                    top += 2
                    continue
                copy_numbers(worst, wide)
            for v in range(n):
                bounds[step, v] += (b - a) * worst[v] * _WIDER
                unknown[step, v] += (b - a) * wide[v]
    return bounds, moments, unknown


@kernel
def _constant_registers(step_tape: StepTape, regs: Array) -> tuple[Array, Complexes, Array]:
    """Return registers of intervals and of discs, with those filled in that are constant."""
    code, base, fixed = step_tape[:3]
    n = step_tape[6].shape[1]
    jets = np.zeros((regs.shape[0], 6))
    centres, radii = np.zeros(regs.shape[0], np.complex128), np.zeros(regs.shape[0])
    for r in range(n + 1, base):
        jets[r, 0] = jets[r, 1] = regs[r, 0]
    run_jets(code, 0, fixed, base, jets, 0)
    for r in range(n + 1, base + fixed):
        known = abs(regs[r, 0]) < INF
        centres[r] = complex(regs[r, 0], 0.0) if known else 0j
        radii[r] = 0.0 if known else INF
    return jets, centres, radii


@kernel
def _enclose_defects(
    step_tape: StepTape,
    outputs: Ints32,
    step: int,
    thirds: Array,
    m: float,
    w: float,
    h: float,
    jets: Array,
) -> None:
    """Enclose the defects over [m - w, m + w], in columns 4 and 5 of the variables."""
    code, base, first, last = step_tape[:4]
    write_variable_jets(step_tape, step, thirds, m, w, 1, jets)
    # A piece may start at the boundary of a domain: its points are inside.
    run_jets(code, first, last, base, jets, -1 if w > 0.0 else 0)
    for v in range(step_tape[6].shape[1]):
        row = jets[outputs[v]]
        rate = mul((row[0], row[1]), (h, h))
        low, high = sub((jets[v, 2], jets[v, 3]), rate)
        if not low <= high:
            low, high = -INF, INF
        jets[v, 4], jets[v, 5] = low, high
