"""The compiled half of tapes and enclosures: one set of numba kernels for every model.

A tape (`statechart.tape`) is data, so these kernels are compiled once, whatever the model. They
are all in this file because numba's cache looks only at the file of the function that is called:
spread over two files, an edit of one would silently run the old code of the other.

Intervals are pairs (low, high) that contain every real value of the operation. Each result is
widened outwards by one ulp, four where libm is called (its functions are within 1 to 2 ulp), and
by `TINY` where a product may underflow. A bound that is lost (overflow, inf - inf, a point outside
the domain) is not a number or infinite, and ends as the whole line: never as a proof.

A jet is the value, first and second derivative with respect to the step's own time s in [0, 1],
as three intervals in a row of six numbers; see Moore, Kearfott and Cloud, "Introduction to
Interval Analysis", 2009, chapters 5 and 9, for the centred forms built on it.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = [
    "BUDGET",
    "CROSSING",
    "GRAZE",
    "NONE",
    "NON_FINITE",
    "OPCODES",
    "append_steps",
    "cached",
    "cut_steps",
    "integrate_outputs",
    "sample_states",
    "search",
    "tape_table",
    "tape_values",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Marks = NDArray[np.uint8]
Interval = tuple[float, float]
Jet = tuple[Interval, Interval, Interval]
Along = tuple[Ints, int, int, int, Ints, Floats, Floats, float]
"""What is evaluated along what: code, the register of its first operation, the operations to run
(from, to), reads, times, coeffs, start."""

# What only kernels call needs nothing to be called by from Python, and compiles sooner without.
_kernel = njit(cache=True, error_model="numpy", no_cfunc_wrapper=True)
_inner = njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)

ADD, SUB, MUL, DIV, MIN, MAX, ATAN2, HYPOT, POW = range(9)
NEG, SQUARE, POWI, SQRT, EXP, LOG, SIN, COS, TAN, ASIN, ACOS, ATAN = range(9, 21)
SINH, COSH, TANH, ABS, SIGN = range(21, 26)

_BINARY = ("add", "sub", "mul", "div", "min", "max", "atan2", "hypot", "pow")
_USUAL = ("neg", "square", "powi", "sqrt", "exp", "log", "sin", "cos", "tan")
_OTHERS = ("asin", "acos", "atan", "sinh", "cosh", "tanh", "abs", "sign")
OPCODES: dict[str, int] = {name: index for index, name in enumerate([*_BINARY, *_USUAL, *_OTHERS])}

NONE, CROSSING, GRAZE, BUDGET, NON_FINITE = range(5)

EPS = 2.0**-52
TINY = 1e-300  # above the subnormal numbers, which some processors handle a hundred times slower
LIBM = 4.0 * EPS
INF = math.inf
NARROW = 2.0**-48  # of a step: narrower boxes tell nothing new in float64
BLOCK = 32  # points evaluated side by side; amortises the dispatch of an operation
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_NODES = (_NODES + 1.0) / 2.0
_WEIGHTS = _WEIGHTS / 2.0

WHOLE, ZERO, ONE = (-INF, INF), (0.0, 0.0), (1.0, 1.0)
HALF, MINUS_ONE = (0.5, 0.5), (-1.0, -1.0)


# ---------------------------------------------------------------- float values


@_inner
def _one(op: int, a: float, exponent: int) -> float:
    """One of the functions of one operand that no processor computes side by side."""
    if op == SIN:
        return math.sin(a)
    if op == COS:
        return math.cos(a)
    if op == POWI:
        return a ** float(exponent)
    if op == TAN:
        return math.tan(a)
    if op == EXP:
        return math.exp(a)
    if op == LOG:
        return math.log(a)
    if op == ASIN:
        return math.asin(a)
    if op == ACOS:
        return math.acos(a)
    if op == ATAN:
        return math.atan(a)
    if op == SINH:
        return math.sinh(a)
    if op == COSH:
        return math.cosh(a)
    if op == TANH:
        return math.tanh(a)
    if op == ABS:
        return abs(a)
    return 1.0 if a > 0.0 else (-1.0 if a < 0.0 else a)  # NaN has no sign


@_inner
def _two(op: int, a: float, b: float) -> float:
    """One of the less usual functions of two operands."""
    if op == POW:
        return a**b
    if op == ATAN2:
        return math.atan2(a, b)
    if op == HYPOT:
        return math.hypot(a, b)
    if a != a or b != b:
        return a + b
    return min(a, b) if op == MIN else max(a, b)


@_inner
def _run(code: Ints, first: int, last: int, base: int, regs: Floats, count: int) -> None:
    """Run the operations [first, last) on `count` columns of registers."""
    for k in range(first, last):
        op = code[k, 0]
        a = regs[code[k, 1]]
        out = regs[base + k]
        if op <= POW:
            b = regs[code[k, 2]]
            if op == ADD:
                for j in range(count):
                    out[j] = a[j] + b[j]
            elif op == SUB:
                for j in range(count):
                    out[j] = a[j] - b[j]
            elif op == MUL:
                for j in range(count):
                    out[j] = a[j] * b[j]
            elif op == DIV:
                for j in range(count):
                    out[j] = a[j] / b[j]
            else:
                for j in range(count):
                    out[j] = _two(op, a[j], b[j])
        elif op == NEG:
            for j in range(count):
                out[j] = -a[j]
        elif op == SQUARE:
            for j in range(count):
                out[j] = a[j] * a[j]
        elif op == SQRT:
            for j in range(count):
                out[j] = math.sqrt(a[j])
        else:
            exponent = code[k, 2]
            for j in range(count):
                out[j] = _one(op, a[j], exponent)


@_inner
def _fill(
    code: Ints, constants: Floats, parameters: Floats, n_variables: int, width: int
) -> tuple[int, Floats]:
    """Return the first register of the operations, and registers with what is known filled in."""
    n_parameters = parameters.shape[0]
    base = n_variables + 1 + n_parameters + constants.shape[0]
    regs = np.empty((base + code.shape[0], width))
    for j in range(width):
        for p in range(n_parameters):
            regs[n_variables + 1 + p, j] = parameters[p]
        for c in range(constants.shape[0]):
            regs[n_variables + 1 + n_parameters + c, j] = constants[c]
    return base, regs


@_kernel
def tape_values(
    code: Ints,
    constants: Floats,
    outputs: Ints,
    state: Floats,
    parameters: Floats,
    time: float,
    result: Floats,
) -> None:
    """Write the values (n_out,) of the outputs at one point.

    Filling an array costs a third of what returning one does.
    """
    n = state.shape[0]
    base, regs = _fill(code, constants, parameters, n, 1)
    for v in range(n):
        regs[v, 0] = state[v]
    regs[n, 0] = time
    _run(code, 0, code.shape[0], base, regs, 1)
    for i in range(outputs.shape[0]):
        result[i] = regs[outputs[i], 0]


@_kernel
def tape_table(
    code: Ints,
    constants: Floats,
    outputs: Ints,
    n_fixed: int,
    states: Floats,
    parameters: Floats,
    times: Floats,
) -> Floats:
    """Values of the outputs at m points; shape (m, n_out)."""
    m, n = states.shape
    base, regs = _fill(code, constants, parameters, n, BLOCK)
    first = 0
    result = np.empty((m, outputs.shape[0]))
    for begin in range(0, m, BLOCK):
        count = min(BLOCK, m - begin)
        for j in range(count):
            for v in range(n):
                regs[v, j] = states[begin + j, v]
            regs[n, j] = times[begin + j]
        # What depends on parameters alone is computed in the first block; only the last is short.
        _run(code, first, code.shape[0], base, regs, count)
        first = n_fixed
        for j in range(count):
            for i in range(outputs.shape[0]):
                result[begin + j, i] = regs[outputs[i], j]
    return result


@_inner
def _horner(coeffs: Floats, step: int, v: int, s: float) -> float:
    value = 0.0
    for k in range(coeffs.shape[2] - 1, -1, -1):
        value = value * s + coeffs[step, v, k]
    return value


@_inner
def _local(times: Floats, step: int, s: float) -> float:
    """Local time of the place s in a step; exact at both ends."""
    if s >= 1.0:
        return times[step + 1]
    return times[step] + s * (times[step + 1] - times[step])


@_kernel
def integrate_outputs(
    code: Ints,
    constants: Floats,
    outputs: Ints,
    reads: Ints,
    times: Floats,
    coeffs: Floats,
    parameters: Floats,
    start: float,
    t_from: float,
    t_to: float,
) -> Floats:
    """Integral of every output over local time [t_from, t_to], 16 Gauss nodes in a step."""
    nodes, n = _NODES.shape[0], coeffs.shape[1]
    base, regs = _fill(code, constants, parameters, n, nodes)
    result = np.zeros(outputs.shape[0])
    for step in range(coeffs.shape[0]):
        low, high = max(t_from, times[step]), min(t_to, times[step + 1])
        if not low < high:
            continue
        span = times[step + 1] - times[step]
        for j in range(nodes):
            s = (low - times[step] + _NODES[j] * (high - low)) / span
            for v in reads:
                regs[v, j] = (
                    start + _local(times, step, s) if v == n else _horner(coeffs, step, v, s)
                )
        _run(code, 0, code.shape[0], base, regs, nodes)
        for i in range(outputs.shape[0]):
            total = 0.0
            for j in range(nodes):
                total += _WEIGHTS[j] * regs[outputs[i], j]
            result[i] += total * (high - low)
    return result


@_kernel
def append_steps(
    durations: Floats, taken: int, first: int, times: Floats, coeffs: Floats, end: Floats
) -> int:
    """Make Taylor coefficients in time those in s = time / duration, in place; fill in `times`.

    The steps stand behind the `first` ones. Returns how many of them, up to `taken`, are finite,
    and writes the state at the end of those.
    """
    _, n, terms = coeffs.shape
    total, finite = 0.0, 0
    while finite < taken:
        step, duration, bounded = coeffs[first + finite], durations[finite], True
        for v in range(n):
            factor = 1.0
            for k in range(terms):
                step[v, k] *= factor
                factor *= duration
                bounded = bounded and abs(step[v, k]) < INF
        if not bounded:
            break
        # Summed from the start of these steps, so that long arcs lose nothing.
        total += duration
        finite += 1
        times[first + finite] = times[first] + total
    if finite > 0:
        for v in range(n):
            end[v] = _horner(coeffs, first + finite - 1, v, 1.0)
    return finite


@_kernel
def cut_steps(times: Floats, coeffs: Floats, count: int, end: float, state: Floats) -> int:
    """End an arc of `count` steps at local time `end`, in place, and write the state there.

    Returns how many steps are kept; with none the state is left alone.
    """
    while count > 0 and times[count - 1] >= end:
        count -= 1
    if count > 0:
        step = coeffs[count - 1]
        s = (end - times[count - 1]) / (times[count] - times[count - 1])
        times[count] = end
        for v in range(step.shape[0]):
            factor = 1.0
            for k in range(step.shape[1]):
                step[v, k] *= factor
                factor *= s
            state[v] = _horner(coeffs, count - 1, v, 1.0)
    return count


@_kernel
def sample_states(coeffs: Floats, times: Floats, tau: Floats) -> Floats:
    """States at local times; shape (m, n)."""
    last = coeffs.shape[0] - 1
    result = np.empty((tau.shape[0], coeffs.shape[1]))
    for j in range(tau.shape[0]):
        low, high = 0, last + 1
        while high - low > 1:
            step = (low + high) // 2
            if times[step] <= tau[j]:
                low = step
            else:
                high = step
        step = low
        span = times[step + 1] - times[step]
        s = (tau[j] - times[step]) / span if span > 0.0 else 0.0
        for v in range(coeffs.shape[1]):
            result[j, v] = _horner(coeffs, step, v, s)
    return result


# ---------------------------------------------------------------- intervals


@_inner
def _wide(a: Interval, ulps: float) -> Interval:
    return a[0] - abs(a[0]) * ulps - TINY, a[1] + abs(a[1]) * ulps + TINY


@_inner
def _neg(a: Interval) -> Interval:
    return -a[1], -a[0]


@_inner
def _times(number: float, a: Interval) -> Interval:
    """Product with an exact number >= 0 that loses nothing (a power of two)."""
    return number * a[0], number * a[1]


@_inner
def _add(a: Interval, b: Interval) -> Interval:
    # A sum never underflows inexactly, so that an exact 0 stays one.
    low, high = a[0] + b[0], a[1] + b[1]
    return low - abs(low) * EPS, high + abs(high) * EPS


@_inner
def _sub(a: Interval, b: Interval) -> Interval:
    return _add(a, _neg(b))


@_inner
def _hull(p: float, q: float, r: float, s: float) -> Interval:
    a, b, c, d = min(p, q), max(p, q), min(r, s), max(r, s)
    return min(a, c), max(b, d)


@_inner
def _hull4(p: float, q: float, r: float, s: float) -> Interval:
    total = p + q + r + s
    if total != total:
        return WHOLE
    return _wide(_hull(p, q, r, s), EPS)


@_inner
def _mul(a: Interval, b: Interval) -> Interval:
    return _hull4(a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1])


@_inner
def _div(a: Interval, b: Interval) -> Interval:
    if not (b[0] > 0.0 or b[1] < 0.0):
        return WHOLE
    return _hull4(a[0] / b[0], a[0] / b[1], a[1] / b[0], a[1] / b[1])


@_inner
def _even(a: Interval, p: float, q: float, ulps: float) -> Interval:
    """Range of an even power over `a`, from its values p and q at the ends."""
    small = 0.0 if a[0] <= 0.0 <= a[1] else min(p, q)
    low, high = _wide((small, max(p, q)), ulps)
    return max(0.0, low), high


@_inner
def _square(a: Interval) -> Interval:
    return _even(a, a[0] * a[0], a[1] * a[1], EPS)


@_inner
def _sqrt(a: Interval) -> Interval:
    if not a[0] >= 0.0:
        return WHOLE
    p, q = math.sqrt(a[0]), math.sqrt(a[1])
    return max(0.0, p - p * EPS), q + q * EPS


@_inner
def _power(a: Interval, exponent: int) -> Interval:
    """Integer power, exponent >= 0."""
    if exponent == 0:
        return ONE
    if exponent == 1:
        return a
    n = float(exponent)
    p, q = a[0] ** n, a[1] ** n
    if exponent % 2 == 1:
        return _wide((p, q), LIBM)
    return _even(a, p, q, LIBM)


@_inner
def _exp(a: Interval) -> Interval:
    p, q = _wide((math.exp(a[0]), math.exp(a[1])), LIBM)
    return max(0.0, p), q


@_inner
def _extrema(a: Interval, offset: float) -> tuple[float, float]:
    """How many of the points (k + offset) pi may lie in an interval (at most 2), and the last k."""
    size = max(abs(a[0]), abs(a[1])) / math.pi
    if not size < 1e14:
        return 2.0, 0.0
    slack = 4.0 * EPS * (size + 1.0)
    last = math.floor(a[1] / math.pi - offset + slack)
    return last - math.floor(a[0] / math.pi - offset - slack), last


@_kernel
def _wave(a: Interval, sine: bool) -> Interval:
    count, last = _extrema(a, 0.5 if sine else 0.0)
    if count >= 2.0:
        return -1.0, 1.0
    if sine:
        p, q = math.sin(a[0]), math.sin(a[1])
    else:
        p, q = math.cos(a[0]), math.cos(a[1])
    p, q = _wide((min(p, q), max(p, q)), LIBM)
    if count >= 1.0:
        if last % 2.0 == 0.0:
            q = 1.0
        else:
            p = -1.0
    return max(p, -1.0), min(q, 1.0)


@_inner
def _sinh(a: Interval) -> Interval:
    return _wide((math.sinh(a[0]), math.sinh(a[1])), LIBM)


@_inner
def _cosh(a: Interval) -> Interval:
    p, q = math.cosh(a[0]), math.cosh(a[1])
    p, q = _wide((1.0 if a[0] <= 0.0 <= a[1] else min(p, q), max(p, q)), LIBM)
    return max(1.0, p), q


@_inner
def _whole(a: Interval) -> Interval:
    """Return the interval, or the whole line where a bound was lost."""
    if a[0] <= a[1]:
        return a
    return WHOLE


# ---------------------------------------------------------------- jets


@_inner
def _unary(op: int, exponent: int, a: Interval, order: int) -> Jet:
    """Enclosures over an interval of f and, unless the order is 0, of f' and f''."""
    f = d = e = WHOLE
    if op == SIN:
        f = _wave(a, True)
        if order > 0:
            d, e = _wave(a, False), _neg(f)
    elif op == COS:
        f = _wave(a, False)
        if order > 0:
            d, e = _neg(_wave(a, True)), _neg(f)
    elif op == SQRT:
        f = _sqrt(a)
        if order > 0:
            d = _div(HALF, f)
            e = _div(_times(0.5, _neg(d)), a)
    elif op == EXP:
        f = d = e = _exp(a)
    elif op == POWI:
        f = _power(a, exponent)
        if order > 0:
            n = float(exponent)
            d = _mul(_power(a, exponent - 1), (n, n))
            n *= n - 1.0
            e = _mul(_power(a, exponent - 2), (n, n))
    elif op == LOG:
        if a[0] > 0.0:
            f = _wide((math.log(a[0]), math.log(a[1])), LIBM)
            d = _div(ONE, a)
            e = _neg(_square(d))
    elif op == ABS:
        if a[0] >= 0.0:
            f, d, e = a, ONE, ZERO
        elif a[1] <= 0.0:
            f, d, e = _neg(a), MINUS_ONE, ZERO
        else:
            f, d = (0.0, max(-a[0], a[1])), (-1.0, 1.0)
    elif op == SIGN:
        if a[0] > 0.0:
            f, d, e = ONE, ZERO, ZERO
        elif a[1] < 0.0:
            f, d, e = MINUS_ONE, ZERO, ZERO
        else:
            f = (-1.0, 1.0)
    elif op == TAN:
        if _extrema(a, 0.5)[0] < 1.0:
            f = _wide((math.tan(a[0]), math.tan(a[1])), LIBM)
            d = _add(_square(f), ONE)
            e = _mul(_times(2.0, f), d)
    elif op == ATAN:
        f = _wide((math.atan(a[0]), math.atan(a[1])), LIBM)
        d = _div(ONE, _add(_square(a), ONE))
        e = _mul(_times(2.0, _neg(a)), _square(d))
    elif op in (ASIN, ACOS):
        if a[0] >= -1.0 and a[1] <= 1.0:
            p = _sub(ONE, _square(a))
            d = _div(ONE, _sqrt(p))
            e = _div(_mul(a, d), p)
            if op == ASIN:
                f = _wide((math.asin(a[0]), math.asin(a[1])), LIBM)
            else:
                f = _wide((math.acos(a[1]), math.acos(a[0])), LIBM)
                d, e = _neg(d), _neg(e)
    elif op == SINH:
        f = e = _sinh(a)
        d = _cosh(a)
    elif op == COSH:
        f = e = _cosh(a)
        d = _sinh(a)
    elif op == TANH:
        f = _wide((math.tanh(a[0]), math.tanh(a[1])), LIBM)
        f = (max(f[0], -1.0), min(f[1], 1.0))
        d = _sub(ONE, _square(f))
        e = _mul(_times(2.0, _neg(f)), d)
    return f, d, e


@_inner
def _polar(op: int, y: Jet, x: Jet) -> Jet:
    """Jets of hypot(y, x) and atan2(y, x)."""
    y0, y1, y2 = y
    x0, x1, x2 = x
    # (q / 2)' = x x' + y y' with q = x^2 + y^2
    half = _add(_mul(x0, x1), _mul(y0, y1))
    if op == HYPOT:
        p, q = _even(y0, abs(y0[0]), abs(y0[1]), 0.0), _even(x0, abs(x0[0]), abs(x0[1]), 0.0)
        f = _wide((math.hypot(p[0], q[0]), math.hypot(p[1], q[1])), LIBM)
        f = (max(0.0, f[0]), f[1])
        # r r' = x x' + y y';  r r'' = x'^2 + x x'' + y'^2 + y y'' - r'^2
        d = _div(half, f)
        n = _add(_add(_square(x1), _square(y1)), _add(_mul(x0, x2), _mul(y0, y2)))
        return f, d, _div(_sub(n, _square(d)), f)
    if not (x0[0] > 0.0 or y0[0] > 0.0 or y0[1] < 0.0):
        return (-LIBM - math.pi, math.pi + LIBM), WHOLE, WHOLE
    # Away from the cut the angle is monotone along every edge: its extremes are at corners.
    a, b = math.atan2(y0[0], x0[0]), math.atan2(y0[0], x0[1])
    c, r = math.atan2(y0[1], x0[0]), math.atan2(y0[1], x0[1])
    # q w = x y' - y x';  q w' = x y'' - y x'' - 2 w (x x' + y y')
    q = _add(_square(y0), _square(x0))
    d = _div(_sub(_mul(x0, y1), _mul(y0, x1)), q)
    n = _sub(_mul(x0, y2), _mul(y0, x2))
    return _wide(_hull(a, b, c, r), LIBM), d, _div(_sub(n, _mul(_times(2.0, d), half)), q)


@_inner
def _power_jet(x: Jet, y: Jet) -> Jet:
    """Jets of x**y = exp(y log x), x > 0; the value from its corners, where its extremes are."""
    x0, x1, x2 = x
    y0, y1, y2 = y
    if not x0[0] > 0.0:
        return WHOLE, WHOLE, WHOLE
    f = _hull(x0[0] ** y0[0], x0[0] ** y0[1], x0[1] ** y0[0], x0[1] ** y0[1])
    f = _wide(f, LIBM)
    f = (max(0.0, f[0]), f[1])
    n, r, m = _unary(LOG, 0, x0, 2)
    g = _mul(r, x1)  # (log x)'
    w = _add(_mul(y1, n), _mul(y0, g))  # (y log x)'
    h = _add(_mul(m, _square(x1)), _mul(r, x2))  # (log x)''
    h = _add(_add(_mul(y0, h), _mul(y2, n)), _mul(_times(2.0, y1), g))  # (y log x)''
    return f, _mul(f, w), _mul(f, _add(h, _square(w)))


@_inner
def _extreme(op: int, u: Jet, v: Jet) -> Jet:
    """Jets of min(u, v) and max(u, v): one of them, or the hull with a second derivative lost."""
    if u[0][1] <= v[0][0]:
        return u if op == MIN else v
    if v[0][1] <= u[0][0]:
        return v if op == MIN else u
    d = (min(u[1][0], v[1][0]), max(u[1][1], v[1][1]))
    if op == MIN:
        return (min(u[0][0], v[0][0]), min(u[0][1], v[0][1])), d, WHOLE
    return (max(u[0][0], v[0][0]), max(u[0][1], v[0][1])), d, WHOLE


@_inner
def _jet(jets: Floats, r: int) -> Jet:
    return (jets[r, 0], jets[r, 1]), (jets[r, 2], jets[r, 3]), (jets[r, 4], jets[r, 5])


@_kernel
def _jets(code: Ints, first: int, last: int, base: int, jets: Floats, order: int) -> None:
    """Run the operations [first, last) on jets; no derivatives for order 0."""
    for k in range(first, last):
        op = code[k, 0]
        u, du, ddu = _jet(jets, code[k, 1])
        d = e = ZERO
        if op <= POW:
            v, dv, ddv = _jet(jets, code[k, 2])
            if op == ADD:
                f = _add(u, v)
                if order > 0:
                    d, e = _add(du, dv), _add(ddu, ddv)
            elif op == SUB:
                f = _sub(u, v)
                if order > 0:
                    d, e = _sub(du, dv), _sub(ddu, ddv)
            elif op == MUL:
                f = _mul(u, v)
                if order > 0:
                    d = _add(_mul(du, v), _mul(u, dv))
                if order > 1:
                    e = _add(_mul(ddu, v), _mul(u, ddv))
                    e = _add(e, _mul(_times(2.0, du), dv))
            elif op == DIV:
                # q v = u, hence q' v = u' - q v' and q'' v = u'' - 2 q' v' - q v''
                f = _div(u, v)
                if order > 0:
                    d = _div(_sub(du, _mul(f, dv)), v)
                if order > 1:
                    e = _sub(ddu, _mul(_times(2.0, d), dv))
                    e = _div(_sub(e, _mul(f, ddv)), v)
            elif op in (MIN, MAX):
                f, d, e = _extreme(op, (u, du, ddu), (v, dv, ddv))
            elif op == POW:
                f, d, e = _power_jet((u, du, ddu), (v, dv, ddv))
            else:
                f, d, e = _polar(op, (u, du, ddu), (v, dv, ddv))
        elif op == NEG:
            f, d, e = _neg(u), _neg(du), _neg(ddu)
        elif op == SQUARE:
            f = _square(u)
            if order > 0:
                d = _times(2.0, _mul(u, du))
            if order > 1:
                e = _times(2.0, _add(_square(du), _mul(u, ddu)))
        else:
            f, g, h = _unary(op, code[k, 2], u, order)
            if order > 0:
                d = _mul(g, du)
            if order > 1:
                e = _add(_mul(h, _square(du)), _mul(g, ddu))
        jets[base + k, 0], jets[base + k, 1] = _whole(f)
        if order > 0:
            jets[base + k, 2], jets[base + k, 3] = _whole(d)
            jets[base + k, 4], jets[base + k, 5] = _whole(e)


# ---------------------------------------------------------------- polynomials and boxes


@_kernel
def _prepare(coeffs: Floats, step: int, reads: Ints, bounds: Floats) -> bool:
    """Bound the third derivative over a step; False if the step is not finite."""
    finite = True
    for r in range(reads.shape[0]):
        v = reads[r]
        if v == coeffs.shape[1]:
            continue
        total = third = 0.0
        for k in range(coeffs.shape[2]):
            size = abs(coeffs[step, v, k])
            total += size
            third += k * (k - 1) * (k - 2) * size
        bounds[v] = third * (1.0 + 128.0 * EPS)
        if not total < INF:
            finite = False
    return finite


@_kernel
def _enclose(
    along: Along, step: int, bounds: Floats, m: float, w: float, order: int, jets: Floats
) -> None:
    """Jets of all registers over the places [m - w, m + w] of a step.

    A polynomial p is enclosed by p(m) +- w |p'(m)| +- w^2/2 |p''(m)| +- w^3/6 B with B the bound
    of its third derivative, and its derivatives likewise: three sums instead of a whole shift.
    Horner's rule passes coefficient k through 2 k + 1 roundings (Higham, "Accuracy and Stability
    of Numerical Algorithms", 2002, 5.1), its derivatives through 2 k + 2 and 2 k + 4; the sums of
    absolute values are taken at m, so that they are small near the start of a long step.
    """
    code, base, first, last, reads, times, coeffs, start = along
    for r in range(reads.shape[0]):
        v = reads[r]
        row = jets[v]
        if v == coeffs.shape[1]:
            span = times[step + 1] - times[step]
            value = start + (times[step] + m * span)
            size = abs(start) + abs(times[step]) + abs(span)
            radius = w * abs(span) * (1.0 + 4.0 * EPS) + 4.0 * EPS * size + TINY
            row[0], row[1] = value - radius, value + radius
            row[2], row[3] = _wide((span, span), EPS)
            row[4], row[5] = 0.0, 0.0
            continue
        p0 = p1 = p2 = q0 = q1 = q2 = 0.0
        for k in range(coeffs.shape[2] - 1, -1, -1):
            p2 = p2 * m + p1
            p1 = p1 * m + p0
            p0 = p0 * m + coeffs[step, v, k]
            q2 = q2 * m + q1
            q1 = q1 * m + q0
            q0 = q0 * m + abs(coeffs[step, v, k])
        p2 *= 2.0
        q2 *= 2.0
        r0 = EPS * (q0 + 2.0 * m * q1) + TINY
        r1 = EPS * (4.0 * q1 + 2.0 * m * q2) + TINY
        r2 = EPS * (8.0 + 2.0 * coeffs.shape[2]) * q2 + TINY
        b3, grow = bounds[v], 1.0 + 64.0 * EPS
        d1, d2 = abs(p1) + r1, abs(p2) + r2
        radius = grow * (r0 + w * (d1 + w * (0.5 * d2 + w * b3 / 6.0)))
        row[0], row[1] = _whole(_wide((p0 - radius, p0 + radius), EPS))
        if order > 0:
            radius = grow * (r1 + w * (d2 + w * 0.5 * b3))
            row[2], row[3] = _whole(_wide((p1 - radius, p1 + radius), EPS))
            radius = grow * (r2 + w * b3)
            row[4], row[5] = _whole(_wide((p2 - radius, p2 + radius), EPS))
    _jets(code, first, last, base, jets, order)


@_inner
def _alone(along: Along, output: int) -> Along:
    """Evaluate no operation behind the one that gives an output."""
    code, base, first, _, reads, times, coeffs, start = along
    return code, base, first, max(first, output - base + 1), reads, times, coeffs, start


@_inner
def _lower(value: Floats, middle: Floats, slope: float, w: float) -> float:
    """Lower bound of an output over a box of half width w.

    The best of its own enclosure `value`, of g(m) - slope w with `slope` bounding |g'|, and of
    g(m) - d |t| + c t^2 / 2 with d bounding |g'(m)| and c the least g''.
    """
    mean = w * slope
    least = max(value[0], middle[0] - mean - LIBM * (mean + abs(middle[0])) - TINY)
    d, c = max(abs(middle[2]), abs(middle[3])), value[4]
    if c > 0.0 and d < c * w:
        drop, curve = 0.5 * d * d / c, 0.0
    else:
        drop, curve = w * d, 0.5 * c * w * w
    bound = middle[0] - drop + curve
    bound -= LIBM * (drop + abs(curve) + abs(middle[0])) + TINY
    return bound if bound > least else least


@_inner
def _least_parabola(slope: float, bend: float, length: float) -> float:
    """Return the least of ``slope t + bend t^2 / 2`` over [0, length], for a slope <= 0."""
    if bend > 0.0 and -slope < bend * length:
        return -0.5 * slope * slope / bend
    return length * (slope + 0.5 * bend * length)


@_kernel
def _judge(
    along: Along,
    outputs: Ints,
    step: int,
    bounds: Floats,
    a: float,
    b: float,
    jets: Floats,
    work: Floats,
) -> None:
    """Evidence on the box [a, b] for every output.

    In work[i]: 0 to 3 value and slope at the middle, 4 a lower bound of the value over the box,
    5 an upper one, 6 and 7 the enclosure of the slope, 8 a lower bound of the second derivative;
    where a step starts (a = 0) also 9 and 10, the value there.
    """
    m = 0.5 * (a + b)
    w = max(b - m, m - a)
    _enclose(along, step, bounds, m, 0.0, 1, jets)
    for i in range(outputs.shape[0]):
        for c in range(4):
            work[i, c] = jets[outputs[i], c]
    _enclose(along, step, bounds, m, w, 2, jets)
    for i in range(outputs.shape[0]):
        box, row = jets[outputs[i]], work[i]
        bend = max(abs(box[4]), abs(box[5])) * w * (1.0 + LIBM)
        low, high = _add((row[2], row[3]), (-bend, bend))
        # A comparison with NaN is false and leaves the natural enclosure standing.
        row[6] = low if low > box[2] else box[2]
        row[7] = high if high < box[3] else box[3]
        row[4] = _lower(box, row, max(abs(row[6]), abs(row[7])), w)
        row[5] = box[1]
        row[8] = box[4]
    if a == 0.0:
        # A margin that leaves zero (a slip that begins) is bounded best from where it leaves.
        _enclose(along, step, bounds, 0.0, 0.0, 1, jets)
        for i in range(outputs.shape[0]):
            at, row = jets[outputs[i]], work[i]
            row[9], row[10] = at[0], at[1]
            drop = _least_parabola(min(at[2], 0.0), row[8], b)
            bound = at[0] + drop - LIBM * (abs(at[0]) - drop) - TINY
            if bound > row[4]:
                row[4] = bound


@_inner
def _margin(along: Along, step: int, output: int, s: float, regs: Floats) -> float:
    """Value of an output at one place of a step."""
    code, base, first, last, reads, times, coeffs, start = along
    n = coeffs.shape[1]
    for r in range(reads.shape[0]):
        v = reads[r]
        if v == n:
            regs[n, 0] = start + _local(times, step, s)
        else:
            regs[v, 0] = _horner(coeffs, step, v, s)
    _run(code, first, last, base, regs, 1)
    return regs[output, 0]


@_inner
def _root(
    along: Along,
    step: int,
    output: int,
    shift: float,
    left: float,
    right: float,
    regs: Floats,
) -> float:
    """Last place, to a few ulp, with output + shift >= 0 before it falls in [left, right].

    Chandrupatla, "A new hybrid quadratic/bisection algorithm", Advances in Engineering Software
    28 (1997) 145-149. Returns `left` where the fall is already done there, and `right` where
    float64 sees none.
    """
    a, fa = right, shift + _margin(along, step, output, right, regs)
    b, fb = left, shift + _margin(along, step, output, left, regs)
    if not fb > 0.0:
        return left
    if not fa < 0.0:
        return right
    c, fc, t = a, fa, 0.5
    for _ in range(200):
        x = a + t * (b - a)
        fx = shift + _margin(along, step, output, x, regs)
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


@_inner
def _descent(
    along: Along,
    guard: Ints,
    step: int,
    left: float,
    right: float,
    bounds: Floats,
    regs: Floats,
    jets: Floats,
    work: Floats,
) -> tuple[int, float]:
    """Where the margin itself vanished, on the descent that ends at `right` below its tolerance.

    The margin falls on [left, right]. Further to the left the descent is followed as long as the
    slope is proved negative, over the joints of steps too; if the margin is not positive on all
    of it, the answer is where it starts.
    """
    reads, coeffs = along[4], along[6]
    p, q = right, left
    if _margin(along, step, guard[0], p, regs) >= 0.0:
        return step, p
    for _ in range(1000):
        if _margin(along, step, guard[0], q, regs) > 0.0:
            return step, _root(along, step, guard[0], 0.0, q, p, regs)
        p = q
        if p == 0.0:
            if step == 0:
                break
            step -= 1
            p = q = 1.0
            _prepare(coeffs, step, reads, bounds)
            continue
        reach = p
        while reach >= NARROW:
            _judge(along, guard, step, bounds, p - reach, p, jets, work)
            if work[0, 7] < 0.0:
                break
            reach *= 0.5
        if reach < NARROW:
            break
        q = p - reach
    return step, p


@_inner
def _falls(
    along: Along,
    guard: Ints,
    tolerance: float,
    step: int,
    a: float,
    b: float,
    bounds: Floats,
    jets: Floats,
    work: Floats,
) -> tuple[int, float]:
    """Whether an output that falls all over [a, b] passes -tolerance there, and a sure end.

    Returns 0 for no, 1 for yes, 2 for undecided. Zero to within rounding at b is a yes if b is
    the end of the step; elsewhere it is decided a little beyond b, if it falls there too.
    """
    end = b
    for shrink in (0.0, 1.0, 0.0625):
        if shrink > 0.0:
            end = min(1.0, b + shrink * (b - a))
            _judge(along, guard, step, bounds, a, end, jets, work)
            if not work[0, 7] < 0.0:
                continue
        _enclose(along, step, bounds, end, 0.0, 0, jets)
        if jets[guard[0], 0] + tolerance > 0.0:
            return 0, end
        if jets[guard[0], 1] + tolerance <= 0.0 or end == 1.0:
            return 1, end
    return 2, b


@_kernel
def search(
    code: Ints,
    constants: Floats,
    outputs: Ints,
    reads: Ints,
    n_fixed: int,
    tolerances: Floats,
    times: Floats,
    coeffs: Floats,
    parameters: Floats,
    start: float,
    first: int,
    last: int,
    budget: int,
) -> tuple[int, int, int, float, float, float, int]:
    """First fall of an output below minus its tolerance: see `enclosure.first_crossing`.

    The steps [first, last) are searched; a descent is followed into those before.
    Returns (verdict, guard, step and place of the event, its local time, where it is certain,
    boxes).
    """
    n_out, n = outputs.shape[0], coeffs.shape[1]
    base, regs = _fill(code, constants, parameters, n, 1)
    along = (code, base, n_fixed, code.shape[0], reads, times, coeffs, start)
    _run(code, 0, n_fixed, base, regs, 1)
    jets = np.zeros((regs.shape[0], 6))
    for r in range(n + 1, base):
        jets[r, 0] = jets[r, 1] = regs[r, 0]
        if not abs(regs[r, 0]) < INF:
            jets[r, 0], jets[r, 1] = -INF, INF
    _jets(code, 0, n_fixed, base, jets, 2)
    bounds, work, aside = np.zeros(n), np.empty((n_out, 11)), np.empty((1, 11))
    lefts, rights = np.empty(64), np.empty(64)  # boxes still to see, the leftmost on top
    marks = np.empty((64, n_out), dtype=np.uint8)  # the guards that are undecided in them
    state = np.empty(n_out, dtype=np.uint8)
    for i in range(n_out):
        if not tolerances[i] >= 0.0:
            raise ValueError("the tolerances of margins are numbers >= 0")
    boxes = 0
    for step in range(first, last):
        finite = _prepare(coeffs, step, reads, bounds) and abs(start) < INF
        if not (finite and abs(times[step]) < INF and abs(times[step + 1]) < INF):
            return NON_FINITE, -1, step, 0.0, times[step], times[step + 1], boxes
        found, root, sure, found_left = -1, INF, INF, 0.0
        top = 1
        lefts[0], rights[0] = 0.0, 1.0
        for i in range(n_out):
            marks[0, i] = 1
        while top > 0:
            top -= 1
            a, b = lefts[top], rights[top]
            boxes += 1
            if boxes > budget:
                at, end = _local(times, step, a), _local(times, step, b)
                return BUDGET, -1, step, a, at, end, boxes - 1
            m = 0.5 * (a + b)
            # The natural enclosure alone is cheap, and often enough.
            _enclose(along, step, bounds, m, max(b - m, m - a), 0, jets)
            unclear = 0
            for i in range(n_out):
                state[i] = marks[top, i]
                if state[i] != 0:
                    if jets[outputs[i], 0] + tolerances[i] > 0.0:
                        state[i] = 0
                    else:
                        unclear += 1
            if unclear == 0:
                continue
            _judge(along, outputs, step, bounds, a, b, jets, work)
            unclear, improved = 0, False
            for i in range(n_out):
                if state[i] == 0:
                    continue
                tolerance = tolerances[i]
                below = a == 0.0 and work[i, 10] + tolerance < 0.0
                # It rises: positive up to a, as the boxes before are clear; or zero there to
                # within rounding, and leaving.
                rises = work[i, 6] > 0.0 and (a > 0.0 or work[i, 9] > -INF)
                if not below and (work[i, 4] + tolerance > 0.0 or rises):
                    state[i] = 0
                    continue
                here, far = INF, INF
                if below:
                    here = far = 0.0
                elif work[i, 7] < 0.0:
                    guard, alone = outputs[i : i + 1], _alone(along, outputs[i])
                    aside[0, 7] = work[i, 7]
                    falls, end = _falls(alone, guard, tolerance, step, a, b, bounds, jets, aside)
                    if falls == 0:
                        state[i] = 0
                        continue
                    if falls == 1:
                        here = _root(alone, step, guard[0], tolerance, a, end, regs)
                        # What rounding left over at the float root, the slope carries below 0.
                        _enclose(alone, step, bounds, here, 0.0, 0, jets)
                        rest = max(0.0, jets[guard[0], 1] + tolerance) / -aside[0, 7]
                        far = min(end, (here + rest * (1.0 + LIBM)) * (1.0 + LIBM))
                if here == INF and b - a <= NARROW:
                    # A jump, say: positive at a, and negative at b or, where that is the place of
                    # the jump to within rounding, a little beyond.
                    bounded = work[i, 4] > -INF and work[i, 5] < INF
                    for end in (b, min(1.0, b + 4.0 * NARROW)):
                        _enclose(along, step, bounds, end, 0.0, 0, jets)
                        if here == INF and bounded and jets[outputs[i], 1] + tolerance < 0.0:
                            here, far = a, end
                    if here == INF:
                        if found < 0 or b < root - 4.0 * NARROW:
                            verdict = GRAZE if bounded else NON_FINITE
                            at, far = _local(times, step, a), _local(times, step, b)
                            return verdict, i, step, a, at, far, boxes
                        state[i] = 0  # a tie with the crossing found, to within rounding
                        continue
                if here < INF:
                    state[i] = 0
                    if found < 0 or here < root or (here == root and i < found):
                        found, root, sure, found_left, improved = i, here, far, a, True
                    continue
                unclear += 1
            if improved:
                # Only what is undecided before the crossing matters any more.
                top = 0
            if unclear == 0:
                continue
            if improved and sure < b:
                lefts[top], rights[top] = a, max(sure, a)
                top += 1
            else:
                lefts[top], rights[top] = m, b
                lefts[top + 1], rights[top + 1] = a, m
                top += 2
            for i in range(n_out):
                marks[max(top - 2, 0), i] = marks[top - 1, i] = state[i]
        if found >= 0:
            guard = outputs[found : found + 1]
            event_step, event = _descent(
                _alone(along, guard[0]), guard, step, found_left, root, bounds, regs, jets, aside
            )
            at = _local(times, event_step, event)
            return CROSSING, found, event_step, event, at, _local(times, step, sure), boxes
    return NONE, -1, 0, 0.0, 0.0, 0.0, boxes


def cached() -> bool:
    """Whether the kernels lie compiled on disk; if not, the first use takes some seconds."""
    built = Path(search.stats.cache_path).glob(f"{Path(__file__).stem}.search-*.nbi")
    source = Path(__file__).stat().st_mtime
    return any(index.stat().st_mtime >= source for index in built)
