"""Resolution of a tape along a polynomial: error bounds of sampling.

A function is *resolved* on a box if the distance of its singularities from the range of its
argument is at least the width of the range or, without singularities, if it does not turn twice in
the range. Compositions of resolved functions are smooth on the scale of the box, and a few samples
describe them (the distance of singularities determines the convergence of polynomials: L. N.
Trefethen, "Approximation Theory and Approximation Practice", 2013, chapter 8). Of other functions
only the range between samples is known. Each register therefore has a range and a *roughness*, a
bound of its deviation from a composition of resolved functions.
"""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels import tapes
from statechart.kernels.boxes import StepTape, write_step_jets, write_variable_jets
from statechart.kernels.intervals import INF, LIBM, TINY, Interval
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import local_time, values_at
from statechart.kernels.tapes import run_tape

PLACES = np.array([0.146, 0.382, 0.764])
"""Sampled places of a box, relative to its length, for functions resolved in it."""

NARROW = 2.0**-48
"""Narrowest box, relative to the step: rough boxes are not halved further."""

# Largest ratio of the width of an argument's range to its distance from a singularity.
_MAX_SPAN = 2.0
# Largest width without singularities, in units of growth by a factor e or a turn by a radian.
_MAX_TURN = 4.0


@kernel
def _distance_from_zero(a: Interval) -> float:
    """Distance of an interval from zero."""
    return max(a[0], -a[1], 0.0)


@kernel
def _magnitude(a: Interval) -> float:
    return max(-a[0], a[1])


@kernel
def _resolved(op: int, exponent: int, a: Interval) -> bool:
    """Return whether a function of one operand is resolved on an interval."""
    low, high = a
    span = high - low
    if span == 0.0:
        return True
    if op in (tapes.SIN, tapes.COS, tapes.EXP, tapes.SINH, tapes.COSH):
        return span <= _MAX_TURN
    if op == tapes.TANH:
        return span <= _MAX_SPAN * math.hypot(_distance_from_zero(a), 0.5 * math.pi)
    if op == tapes.ATAN:
        return span <= _MAX_SPAN * math.hypot(_distance_from_zero(a), 1.0)
    if op in (tapes.ABS, tapes.SIGN):
        return low >= 0.0 or high <= 0.0
    if op == tapes.TAN:
        turn = math.floor(low / math.pi - 0.5)
        begin = (turn + 0.5) * math.pi
        return span <= _MAX_SPAN * min(low - begin, begin + math.pi - high)
    if op in (tapes.ASIN, tapes.ACOS):
        return span <= _MAX_SPAN * min(low + 1.0, 1.0 - high)
    if op == tapes.POWI:
        n, near, size = abs(float(exponent)), _distance_from_zero(a), _magnitude(a)
        return n * span <= 2.0 * _MAX_TURN * size or (
            near > 0.0 and n * math.log(size / near) <= _MAX_TURN
        )
    return span <= _MAX_SPAN * low  # SQRT, LOG


@kernel
def _power_resolved(x: Interval, y: Interval) -> bool:
    """Return whether x**y is resolved."""
    low, high = x
    n = math.floor(0.5 * (y[0] + y[1]) + 0.5)
    if max(n - y[0], y[1] - n) <= 1e-14 * abs(n):  # an integer parameter
        whole = n < 2.0**31 and _resolved(tapes.POWI, int(n), x)
        return whole and (n >= 0.0 or high - low <= _MAX_SPAN * _distance_from_zero(x))
    if not low > 0.0:
        return high == low and y[0] == y[1]
    logs = max(abs(math.log(low)), abs(math.log(high)))
    return (
        high - low <= _MAX_SPAN * low
        and _magnitude(y) * math.log(high / low) <= _MAX_TURN
        and (y[1] - y[0]) * logs <= _MAX_TURN
    )


@kernel
def _write_roughness(code: Ints32, first: int, last: int, base: int, jets: Array) -> None:
    """Write the roughness (column 2) of operations with known ranges (columns 0 and 1)."""
    for k in range(first, last):
        op, i = code[k, 0], code[k, 1]
        a, p = (jets[i, 0], jets[i, 1]), jets[i, 2]
        f = jets[base + k, 0], jets[base + k, 1]
        width = f[1] - f[0]
        if op in (tapes.NEG, tapes.SQUARE) or op > tapes.POW:
            if op == tapes.NEG:
                rough = p
            elif op == tapes.SQUARE:
                rough = p * (2.0 * _magnitude(a) + p)
            elif not _resolved(op, code[k, 2], a):
                rough = width
            else:
                # A resolved function is nearly linear.
                rough = 4.0 * p * width / (a[1] - a[0]) if p > 0.0 else 0.0
        else:
            j = code[k, 2]
            b, q = (jets[j, 0], jets[j, 1]), jets[j, 2]
            if op in (tapes.ADD, tapes.SUB):
                rough = p + q
            elif op == tapes.MUL:
                rough = 0.0
                if p > 0.0:
                    rough += p * (_magnitude(b) + q)
                if q > 0.0:
                    rough += q * _magnitude(a)
            elif op == tapes.DIV:
                near = _distance_from_zero(b)
                if b[1] - b[0] <= _MAX_SPAN * near:
                    rough = (p + q * _magnitude(f)) / near if p > 0.0 or q > 0.0 else 0.0
                else:
                    rough = width
            elif op in (tapes.MIN, tapes.MAX):
                rough = max(p, q)
                if a[1] > b[0] and b[1] > a[0]:
                    rough += min(a[1] - b[0], b[1] - a[0])
            elif op == tapes.POW:
                seen = p == 0.0 and q == 0.0 and _power_resolved(a, b)
                rough = 0.0 if seen else width
            else:
                span = max(a[1] - a[0], b[1] - b[0])
                seen = p == 0.0 and q == 0.0
                seen = seen and span <= _MAX_SPAN * math.hypot(
                    _distance_from_zero(a), _distance_from_zero(b)
                )
                rough = 0.0 if seen else width
        jets[base + k, 2] = min(rough, width) if rough == rough else INF


@kernel
def jet_registers(step_tape: StepTape, regs: Array) -> Array:
    """Return registers of jets, with constants and parameters filled in."""
    code, base, fixed, _, _, _, coeffs, _ = step_tape
    n = coeffs.shape[1]
    run_tape(code, 0, fixed, base, regs, regs.shape[1])
    jets = np.zeros((regs.shape[0], 8))
    for r in range(n + 1, base + fixed):
        jets[r, 0] = jets[r, 1] = regs[r, 0]
        if not abs(regs[r, 0]) < INF:
            jets[r, 0], jets[r, 1] = -INF, INF
    return jets


@kernel
def write_roughness(step_tape: StepTape, jets: Array) -> None:
    """Write the roughness of all registers with known ranges."""
    code, base, first, last, reads = step_tape[:5]
    for v in reads:
        jets[v, 2] = 0.0
    _write_roughness(code, first, last, base, jets)


@kernel
def bound_box(
    step_tape: StepTape, step: int, bounds: Array, a: float, b: float, jets: Array
) -> None:
    """Write ranges and roughness of all registers over the box [a, b] of a step."""
    code, base, first, last = step_tape[:4]
    m = 0.5 * (a + b)
    write_variable_jets(step_tape, step, bounds, m, max(b - m, m - a), 0, jets)
    run_jets(code, first, last, base, jets, 0)
    write_roughness(step_tape, jets)


@kernel
def bound_step(step_tape: StepTape, step: int, jets: Array) -> bool:
    """Write ranges and roughness over a whole step, from cheap ranges of the variables.

    Returns False if a range is not finite.
    """
    code, base, first, last = step_tape[:4]
    if not write_step_jets(step_tape, step, jets):
        return False
    run_jets(code, first, last, base, jets, 0)
    write_roughness(step_tape, jets)
    return True


@kernel
def bound_box_tightly(
    step_tape: StepTape, step: int, bounds: Array, a: float, b: float, jets: Array
) -> None:
    """Write ranges and roughness over a box, also by the mean value form (second order).

    Needed for differences of large numbers, such as the determinant of a nearly singular mode.
    """
    code, base, first, last = step_tape[:4]
    m = 0.5 * (a + b)
    w = max(b - m, m - a)
    write_variable_jets(step_tape, step, bounds, m, 0.0, 0, jets)
    run_jets(code, first, last, base, jets, 0)
    for k in range(base + first, base + last):
        jets[k, 6], jets[k, 7] = jets[k, 0], jets[k, 1]
    write_variable_jets(step_tape, step, bounds, m, w, 1, jets)
    run_jets(code, first, last, base, jets, 1)
    for k in range(base + first, base + last):
        reach = w * max(abs(jets[k, 2]), abs(jets[k, 3])) * (1.0 + LIBM) + TINY
        low, high = jets[k, 6] - reach, jets[k, 7] + reach
        if low > jets[k, 0]:
            jets[k, 0] = low
        if high < jets[k, 1]:
            jets[k, 1] = high
    write_roughness(step_tape, jets)


@kernel
def _narrow_range(r: int, count: int, regs: Array, rounded: Array, jets: Array) -> None:
    """Narrow the range of a resolved register to its sampled range, enlarged by its own width."""
    low, high = INF, -INF
    for j in range(count):
        value = regs[r, j]
        if value != value:
            return
        low, high = min(low, value), max(high, value)
    about = high - low + rounded[r]
    jets[r, 0], jets[r, 1] = max(jets[r, 0], low - about), min(jets[r, 1], high + about)


@kernel
def refine_roughness(
    step_tape: StepTape, regs: Array, count: int, rounded: Array, jets: Array
) -> None:
    """Refine the roughness by sampled values of resolved registers.

    Enclosures do not detect cancellation (``cos(x)**2 + sin(x)**2 - 1``) on boxes of any size: the
    kink of a function that is only round-off would be bisected to the limit. `regs` (r, ..): values
    at `count` places of the box; `rounded` (r,): widths of ranges at single places; `jets`
    (r, 8): ranges over the box (see `bound_box`).
    """
    code, base, first, last, reads = step_tape[:5]
    for v in reads:
        _narrow_range(v, count, regs, rounded, jets)
    for k in range(first, last):
        _write_roughness(code, k, k + 1, base, jets)
        op, i, r = code[k, 0], code[k, 1], base + k
        if op == tapes.ABS and jets[i, 2] == 0.0:
            jets[r, 2] = min(jets[r, 2], _magnitude((jets[i, 0], jets[i, 1])))
        elif op == tapes.SQRT and jets[i, 2] == 0.0:
            jets[r, 2] = min(jets[r, 2], math.sqrt(max(jets[i, 1], 0.0)))
        elif op == tapes.HYPOT and jets[i, 2] == 0.0 and jets[code[k, 2], 2] == 0.0:
            j = code[k, 2]
            size = math.hypot(
                _magnitude((jets[i, 0], jets[i, 1])), _magnitude((jets[j, 0], jets[j, 1]))
            )
            jets[r, 2] = min(jets[r, 2], size)
        if jets[r, 2] == 0.0:
            _narrow_range(r, count, regs, rounded, jets)


@kernel
def evaluate_at_places(
    step_tape: StepTape, step: int, a: float, b: float, places: Array, regs: Array
) -> None:
    """Run the tape at places of the box [a, b] of a step, relative to its length."""
    code, base, first, last, reads, times, coeffs, start = step_tape
    n, count = coeffs.shape[1], places.shape[0]
    clock = regs[n]
    for j in range(count):
        clock[j] = a + places[j] * (b - a)
    for v in reads:
        if v < n:
            values_at(coeffs, step, v, clock[:count], regs[v])
    for j in range(count):
        clock[j] = start + local_time(times, step, clock[j])
    run_tape(code, first, last, base, regs, count)
