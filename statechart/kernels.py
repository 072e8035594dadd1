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
    "integrate_outputs",
    "least_values",
    "sample_states",
    "search",
    "tape_table",
    "tape_values",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Marks = NDArray[np.uint8]
Interval = tuple[float, float]
Along = tuple[Ints, int, Ints, Floats, Floats, float]
"""What is evaluated along what: code, n_fixed, reads, times, coeffs, start."""

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


# ---------------------------------------------------------------- float values


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _registers(
    code: Ints, constants: Floats, n_fixed: int, parameters: Floats, n_variables: int, width: int
) -> Floats:
    """Return registers with parameters, constants and what depends on these alone filled in."""
    n_parameters = parameters.shape[0]
    base = n_variables + 1 + n_parameters + constants.shape[0]
    regs = np.empty((base + code.shape[0], width))
    for j in range(width):
        for p in range(n_parameters):
            regs[n_variables + 1 + p, j] = parameters[p]
        for c in range(constants.shape[0]):
            regs[n_variables + 1 + n_parameters + c, j] = constants[c]
    _run(code, 0, n_fixed, base, regs, width)
    return regs


@njit(cache=True, error_model="numpy")
def tape_values(
    code: Ints,
    constants: Floats,
    outputs: Ints,
    n_fixed: int,
    state: Floats,
    parameters: Floats,
    time: float,
) -> Floats:
    """Values of the outputs at one point; shape (n_out,)."""
    n = state.shape[0]
    regs = _registers(code, constants, n_fixed, parameters, n, 1)
    for v in range(n):
        regs[v, 0] = state[v]
    regs[n, 0] = time
    _run(code, n_fixed, code.shape[0], regs.shape[0] - code.shape[0], regs, 1)
    result = np.empty(outputs.shape[0])
    for i in range(outputs.shape[0]):
        result[i] = regs[outputs[i], 0]
    return result


@njit(cache=True, error_model="numpy")
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
    regs = _registers(code, constants, n_fixed, parameters, n, BLOCK)
    base = regs.shape[0] - code.shape[0]
    result = np.empty((m, outputs.shape[0]))
    for first in range(0, m, BLOCK):
        count = min(BLOCK, m - first)
        for j in range(count):
            for v in range(n):
                regs[v, j] = states[first + j, v]
            regs[n, j] = times[first + j]
        _run(code, n_fixed, code.shape[0], base, regs, count)
        for j in range(count):
            for i in range(outputs.shape[0]):
                result[first + j, i] = regs[outputs[i], j]
    return result


@njit(cache=True, error_model="numpy")
def _horner(coeffs: Floats, step: int, v: int, s: float) -> float:
    value = 0.0
    for k in range(coeffs.shape[2] - 1, -1, -1):
        value = value * s + coeffs[step, v, k]
    return value


@njit(cache=True, error_model="numpy")
def _local(times: Floats, step: int, s: float) -> float:
    """Local time of the place s in a step; exact at both ends."""
    if s >= 1.0:
        return times[step + 1]
    return times[step] + s * (times[step + 1] - times[step])


@njit(cache=True, error_model="numpy")
def _run_along(along: Along, step: int, places: Floats, count: int, regs: Floats) -> None:
    """Run the tape at `count` places of one step."""
    code, n_fixed, reads, times, coeffs, start = along
    n = coeffs.shape[1]
    for r in range(reads.shape[0]):
        v = reads[r]
        if v == n:
            for j in range(count):
                regs[n, j] = start + _local(times, step, places[j])
        else:
            for j in range(count):
                regs[v, j] = _horner(coeffs, step, v, places[j])
    _run(code, n_fixed, code.shape[0], regs.shape[0] - code.shape[0], regs, count)


@njit(cache=True, error_model="numpy")
def least_values(
    code: Ints,
    constants: Floats,
    outputs: Ints,
    reads: Ints,
    n_fixed: int,
    times: Floats,
    coeffs: Floats,
    parameters: Floats,
    start: float,
    per_step: int,
) -> Floats:
    """Least value of every output on a grid of per_step + 1 places in every step."""
    along = (code, n_fixed, reads, times, coeffs, start)
    regs = _registers(code, constants, n_fixed, parameters, coeffs.shape[1], per_step + 1)
    places = np.empty(per_step + 1)
    for j in range(per_step + 1):
        places[j] = j / per_step
    result = np.empty(outputs.shape[0])
    for i in range(outputs.shape[0]):
        result[i] = INF
    for step in range(coeffs.shape[0]):
        _run_along(along, step, places, per_step + 1, regs)
        for i in range(outputs.shape[0]):
            for j in range(per_step + 1):
                value = regs[outputs[i], j]
                if value < result[i] or value != value:
                    result[i] = value
    return result


@njit(cache=True, error_model="numpy")
def integrate_outputs(
    code: Ints,
    constants: Floats,
    outputs: Ints,
    reads: Ints,
    n_fixed: int,
    times: Floats,
    coeffs: Floats,
    parameters: Floats,
    start: float,
    t_from: float,
    t_to: float,
) -> Floats:
    """Integral of every output over local time [t_from, t_to], 16 Gauss nodes in a step."""
    along = (code, n_fixed, reads, times, coeffs, start)
    nodes = _NODES.shape[0]
    regs = _registers(code, constants, n_fixed, parameters, coeffs.shape[1], nodes)
    places = np.empty(nodes)
    result = np.zeros(outputs.shape[0])
    for step in range(coeffs.shape[0]):
        low, high = max(t_from, times[step]), min(t_to, times[step + 1])
        if not low < high:
            continue
        span = times[step + 1] - times[step]
        for j in range(nodes):
            places[j] = (low - times[step] + _NODES[j] * (high - low)) / span
        _run_along(along, step, places, nodes, regs)
        for i in range(outputs.shape[0]):
            total = 0.0
            for j in range(nodes):
                total += _WEIGHTS[j] * regs[outputs[i], j]
            result[i] += total * (high - low)
    return result


@njit(cache=True, error_model="numpy")
def scaled_steps(series: Floats, durations: Floats, count: int) -> tuple[int, Floats]:
    """Taylor coefficients in time of `count` steps as coefficients in s = time / duration.

    Returns how many leading steps are finite, and their coefficients.
    """
    _, n, terms = series.shape
    scaled = np.empty((count, n, terms))
    for i in range(count):
        finite = True
        for v in range(n):
            factor = 1.0
            for k in range(terms):
                value = series[i, v, k] * factor
                scaled[i, v, k] = value
                factor *= durations[i]
                finite = finite and abs(value) < INF
        if not finite:
            return i, scaled[:i].copy()
    return count, scaled


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _wide(low: float, high: float, ulps: float) -> Interval:
    return low - abs(low) * ulps - TINY, high + abs(high) * ulps + TINY


@njit(cache=True, error_model="numpy")
def _add(al: float, ah: float, bl: float, bh: float) -> Interval:
    # A sum never underflows inexactly, so that an exact 0 stays one.
    low, high = al + bl, ah + bh
    return low - abs(low) * EPS, high + abs(high) * EPS


@njit(cache=True, error_model="numpy")
def _hull4(p: float, q: float, r: float, s: float) -> Interval:
    total = p + q + r + s
    if total != total:
        return -INF, INF
    low, high = min(p, q, r, s), max(p, q, r, s)
    return low - abs(low) * EPS - TINY, high + abs(high) * EPS + TINY


@njit(cache=True, error_model="numpy")
def _mul(al: float, ah: float, bl: float, bh: float) -> Interval:
    return _hull4(al * bl, al * bh, ah * bl, ah * bh)


@njit(cache=True, error_model="numpy")
def _div(al: float, ah: float, bl: float, bh: float) -> Interval:
    if not (bl > 0.0 or bh < 0.0):
        return -INF, INF
    return _hull4(al / bl, al / bh, ah / bl, ah / bh)


@njit(cache=True, error_model="numpy")
def _square(low: float, high: float) -> Interval:
    p, q = low * low, high * high
    big = max(p, q)
    small = 0.0 if low <= 0.0 <= high else min(p, q)
    return max(0.0, small - small * EPS - TINY), big + big * EPS + TINY


@njit(cache=True, error_model="numpy")
def _sqrt(low: float, high: float) -> Interval:
    if not low >= 0.0:
        return -INF, INF
    p, q = math.sqrt(low), math.sqrt(high)
    return max(0.0, p - p * EPS), q + q * EPS


@njit(cache=True, error_model="numpy")
def _power(low: float, high: float, exponent: int) -> Interval:
    """Integer power, exponent >= 0."""
    if exponent == 0:
        return 1.0, 1.0
    if exponent == 1:
        return low, high
    n = float(exponent)
    p, q = low**n, high**n
    if exponent % 2 == 1:
        return _wide(p, q, LIBM)
    big = max(p, q)
    small = 0.0 if low <= 0.0 <= high else min(p, q)
    return max(0.0, small - small * LIBM - TINY), big + big * LIBM + TINY


@njit(cache=True, error_model="numpy")
def _exp(low: float, high: float) -> Interval:
    p, q = _wide(math.exp(low), math.exp(high), LIBM)
    return max(0.0, p), q


@njit(cache=True, error_model="numpy")
def _extrema(low: float, high: float, offset: float) -> tuple[float, float]:
    """How many of the points (k + offset) pi may lie in [low, high] (at most 2), and the last k."""
    size = max(abs(low), abs(high)) / math.pi
    if not size < 1e14:
        return 2.0, 0.0
    slack = 4.0 * EPS * (size + 1.0)
    last = math.floor(high / math.pi - offset + slack)
    return last - math.floor(low / math.pi - offset - slack), last


@njit(cache=True, error_model="numpy")
def _wave(low: float, high: float, sine: bool) -> Interval:
    count, last = _extrema(low, high, 0.5 if sine else 0.0)
    if count >= 2.0:
        return -1.0, 1.0
    if sine:
        p, q = math.sin(low), math.sin(high)
    else:
        p, q = math.cos(low), math.cos(high)
    p, q = _wide(min(p, q), max(p, q), LIBM)
    if count >= 1.0:
        if last % 2.0 == 0.0:
            q = 1.0
        else:
            p = -1.0
    return max(p, -1.0), min(q, 1.0)


@njit(cache=True, error_model="numpy")
def _hyperbolic_cosine(low: float, high: float) -> Interval:
    p, q = math.cosh(low), math.cosh(high)
    p, q = _wide(1.0 if low <= 0.0 <= high else min(p, q), max(p, q), LIBM)
    return max(1.0, p), q


@njit(cache=True, error_model="numpy")
def _whole(bounds: Interval) -> Interval:
    """Return the interval, or the whole line where a bound was lost."""
    if bounds[0] <= bounds[1]:
        return bounds
    return -INF, INF


# ---------------------------------------------------------------- jets


@njit(cache=True, error_model="numpy")
def _unary(
    op: int, exponent: int, low: float, high: float, order: int
) -> tuple[float, float, float, float, float, float]:
    """Enclosures of f, f' and f'' over [low, high] (the derivatives up to `order`)."""
    f: Interval = (-INF, INF)
    d: Interval = (-INF, INF)
    e: Interval = (-INF, INF)
    if op in (SIN, COS):
        f = _wave(low, high, op == SIN)
        if order > 0:
            d = _wave(low, high, op == COS)
            if op == COS:
                d = (-d[1], -d[0])
            e = (-f[1], -f[0])
    elif op == SQRT:
        f = _sqrt(low, high)
        if order > 0:
            d = _div(0.5, 0.5, f[0], f[1])
            e = _div(-0.5 * d[1], -0.5 * d[0], low, high)
    elif op == EXP:
        f = _exp(low, high)
        d = f
        e = f
    elif op == POWI:
        f = _power(low, high, exponent)
        if order > 0:
            n = float(exponent)
            p = _power(low, high, exponent - 1)
            d = _mul(p[0], p[1], n, n)
            p = _power(low, high, exponent - 2)
            e = _mul(p[0], p[1], n * (n - 1.0), n * (n - 1.0))
    elif op == LOG:
        if low > 0.0:
            f = _wide(math.log(low), math.log(high), LIBM)
            if order > 0:
                d = _div(1.0, 1.0, low, high)
                p = _square(d[0], d[1])
                e = (-p[1], -p[0])
    elif op == ABS:
        if low >= 0.0:
            f, d, e = (low, high), (1.0, 1.0), (0.0, 0.0)
        elif high <= 0.0:
            f, d, e = (-high, -low), (-1.0, -1.0), (0.0, 0.0)
        else:
            f, d = (0.0, max(-low, high)), (-1.0, 1.0)
    elif op == SIGN:
        if low > 0.0:
            f, d, e = (1.0, 1.0), (0.0, 0.0), (0.0, 0.0)
        elif high < 0.0:
            f, d, e = (-1.0, -1.0), (0.0, 0.0), (0.0, 0.0)
        else:
            f = (-1.0, 1.0)
    elif op == TAN:
        if _extrema(low, high, 0.5)[0] < 1.0:
            f = _wide(math.tan(low), math.tan(high), LIBM)
            if order > 0:
                p = _square(f[0], f[1])
                d = _add(p[0], p[1], 1.0, 1.0)
                e = _mul(2.0 * f[0], 2.0 * f[1], d[0], d[1])
    elif op == ATAN:
        f = _wide(math.atan(low), math.atan(high), LIBM)
        if order > 0:
            p = _square(low, high)
            p = _add(p[0], p[1], 1.0, 1.0)
            d = _div(1.0, 1.0, p[0], p[1])
            p = _square(d[0], d[1])
            e = _mul(-2.0 * high, -2.0 * low, p[0], p[1])
    elif op in (ASIN, ACOS):
        if low >= -1.0 and high <= 1.0:
            if op == ASIN:
                f = _wide(math.asin(low), math.asin(high), LIBM)
            else:
                f = _wide(math.acos(high), math.acos(low), LIBM)
            if order > 0:
                p = _square(low, high)
                p = _add(1.0, 1.0, -p[1], -p[0])
                q = _sqrt(p[0], p[1])
                d = _div(1.0, 1.0, q[0], q[1])
                q = _mul(low, high, d[0], d[1])
                e = _div(q[0], q[1], p[0], p[1])
                if op == ACOS:
                    d, e = (-d[1], -d[0]), (-e[1], -e[0])
    elif op == SINH:
        f = _wide(math.sinh(low), math.sinh(high), LIBM)
        if order > 0:
            d = _hyperbolic_cosine(low, high)
            e = f
    elif op == COSH:
        f = _hyperbolic_cosine(low, high)
        if order > 0:
            d = _wide(math.sinh(low), math.sinh(high), LIBM)
            e = f
    elif op == TANH:
        f = _wide(math.tanh(low), math.tanh(high), LIBM)
        f = (max(f[0], -1.0), min(f[1], 1.0))
        if order > 0:
            p = _square(f[0], f[1])
            d = _add(1.0, 1.0, -p[1], -p[0])
            e = _mul(-2.0 * f[1], -2.0 * f[0], d[0], d[1])
    return f[0], f[1], d[0], d[1], e[0], e[1]


@njit(cache=True, error_model="numpy")
def _polar(
    op: int, y: Floats, x: Floats, order: int
) -> tuple[float, float, float, float, float, float]:
    """Jets of hypot(y, x) and atan2(y, x)."""
    p, q = _square(y[0], y[1]), _square(x[0], x[1])
    qq = _add(p[0], p[1], q[0], q[1])
    f: Interval = (-INF, INF)
    d: Interval = (-INF, INF)
    e: Interval = (-INF, INF)
    if op == HYPOT:
        yl = 0.0 if y[0] <= 0.0 <= y[1] else min(abs(y[0]), abs(y[1]))
        xl = 0.0 if x[0] <= 0.0 <= x[1] else min(abs(x[0]), abs(x[1]))
        yh, xh = max(abs(y[0]), abs(y[1])), max(abs(x[0]), abs(x[1]))
        f = _wide(math.hypot(yl, xl), math.hypot(yh, xh), LIBM)
        f = (max(0.0, f[0]), f[1])
    elif x[0] > 0.0 or y[0] > 0.0 or y[1] < 0.0:
        # Away from the cut the angle is monotone along every edge: its extremes are at corners.
        p, q = math.atan2(y[0], x[0]), math.atan2(y[0], x[1])
        r, s = math.atan2(y[1], x[0]), math.atan2(y[1], x[1])
        f = _wide(min(p, q, r, s), max(p, q, r, s), LIBM)
    else:
        return -LIBM - math.pi, math.pi + LIBM, -INF, INF, -INF, INF
    if order > 0:
        if op == HYPOT:
            # r r' = x x' + y y';  r r'' = x'^2 + x x'' + y'^2 + y y'' - r'^2
            a, b = _mul(x[0], x[1], x[2], x[3]), _mul(y[0], y[1], y[2], y[3])
            n = _add(a[0], a[1], b[0], b[1])
            d = _div(n[0], n[1], f[0], f[1])
            if order > 1:
                a, b = _square(x[2], x[3]), _square(y[2], y[3])
                n = _add(a[0], a[1], b[0], b[1])
                a, b = _mul(x[0], x[1], x[4], x[5]), _mul(y[0], y[1], y[4], y[5])
                a = _add(a[0], a[1], b[0], b[1])
                n = _add(n[0], n[1], a[0], a[1])
                a = _square(d[0], d[1])
                n = _add(n[0], n[1], -a[1], -a[0])
                e = _div(n[0], n[1], f[0], f[1])
        else:
            # q w = x y' - y x' with q = x^2 + y^2;  q w' = x y'' - y x'' - 2 w (x x' + y y')
            a, b = _mul(x[0], x[1], y[2], y[3]), _mul(y[0], y[1], x[2], x[3])
            n = _add(a[0], a[1], -b[1], -b[0])
            d = _div(n[0], n[1], qq[0], qq[1])
            if order > 1:
                a, b = _mul(x[0], x[1], y[4], y[5]), _mul(y[0], y[1], x[4], x[5])
                n = _add(a[0], a[1], -b[1], -b[0])
                a, b = _mul(x[0], x[1], x[2], x[3]), _mul(y[0], y[1], y[2], y[3])
                a = _add(a[0], a[1], b[0], b[1])
                a = _mul(2.0 * d[0], 2.0 * d[1], a[0], a[1])
                n = _add(n[0], n[1], -a[1], -a[0])
                e = _div(n[0], n[1], qq[0], qq[1])
    return f[0], f[1], d[0], d[1], e[0], e[1]


@njit(cache=True, error_model="numpy")
def _power_jet(x: Floats, y: Floats, order: int) -> tuple[float, float, float, float, float, float]:
    """Jets of x**y = exp(y log x), x > 0; the value from its corners, where its extremes are."""
    if not x[0] > 0.0:
        return -INF, INF, -INF, INF, -INF, INF
    p, q, r, s = x[0] ** y[0], x[0] ** y[1], x[1] ** y[0], x[1] ** y[1]
    f = _wide(min(p, q, r, s), max(p, q, r, s), LIBM)
    f = (max(0.0, f[0]), f[1])
    d: Interval = (-INF, INF)
    e: Interval = (-INF, INF)
    if order > 0:
        n0, n1, l0, l1, m0, m1 = _unary(LOG, 0, x[0], x[1], 2)
        g = _mul(l0, l1, x[2], x[3])  # (log x)'
        a, b = _mul(y[2], y[3], n0, n1), _mul(y[0], y[1], g[0], g[1])
        w = _add(a[0], a[1], b[0], b[1])  # (y log x)'
        d = _mul(f[0], f[1], w[0], w[1])
        if order > 1:
            a, b = _square(x[2], x[3]), _mul(l0, l1, x[4], x[5])
            a = _mul(m0, m1, a[0], a[1])
            a = _add(a[0], a[1], b[0], b[1])  # (log x)''
            a, b = _mul(y[0], y[1], a[0], a[1]), _mul(y[4], y[5], n0, n1)
            a = _add(a[0], a[1], b[0], b[1])
            b = _mul(2.0 * y[2], 2.0 * y[3], g[0], g[1])
            a = _add(a[0], a[1], b[0], b[1])  # (y log x)''
            b = _square(w[0], w[1])
            a = _add(a[0], a[1], b[0], b[1])
            e = _mul(f[0], f[1], a[0], a[1])
    return f[0], f[1], d[0], d[1], e[0], e[1]


@njit(cache=True, error_model="numpy")
def _extreme(op: int, u: Floats, v: Floats) -> tuple[float, float, float, float, float, float]:
    """Jets of min(u, v) and max(u, v): one of them, or the hull with a second derivative lost."""
    if u[1] <= v[0]:
        w = u if op == MIN else v
    elif v[1] <= u[0]:
        w = v if op == MIN else u
    else:
        low, high = min(u[2], v[2]), max(u[3], v[3])
        if op == MIN:
            return min(u[0], v[0]), min(u[1], v[1]), low, high, -INF, INF
        return max(u[0], v[0]), max(u[1], v[1]), low, high, -INF, INF
    return w[0], w[1], w[2], w[3], w[4], w[5]


@njit(cache=True, error_model="numpy")
def _jets(code: Ints, first: int, last: int, base: int, jets: Floats, order: int) -> None:
    """Run the operations [first, last) on jets, up to the derivative of the given order."""
    for k in range(first, last):
        op = code[k, 0]
        u = jets[code[k, 1]]
        out = jets[base + k]
        f0 = f1 = d0 = d1 = e0 = e1 = 0.0
        if op <= POW:
            v = jets[code[k, 2]]
            if op == ADD:
                f0, f1 = _add(u[0], u[1], v[0], v[1])
                if order > 0:
                    d0, d1 = _add(u[2], u[3], v[2], v[3])
                    e0, e1 = _add(u[4], u[5], v[4], v[5])
            elif op == SUB:
                f0, f1 = _add(u[0], u[1], -v[1], -v[0])
                if order > 0:
                    d0, d1 = _add(u[2], u[3], -v[3], -v[2])
                    e0, e1 = _add(u[4], u[5], -v[5], -v[4])
            elif op == MUL:
                f0, f1 = _mul(u[0], u[1], v[0], v[1])
                if order > 0:
                    p0, p1 = _mul(u[2], u[3], v[0], v[1])
                    q0, q1 = _mul(u[0], u[1], v[2], v[3])
                    d0, d1 = _add(p0, p1, q0, q1)
                    if order > 1:
                        p0, p1 = _mul(u[4], u[5], v[0], v[1])
                        q0, q1 = _mul(u[0], u[1], v[4], v[5])
                        p0, p1 = _add(p0, p1, q0, q1)
                        q0, q1 = _mul(2.0 * u[2], 2.0 * u[3], v[2], v[3])
                        e0, e1 = _add(p0, p1, q0, q1)
            elif op == DIV:
                # q v = u, hence q' v = u' - q v' and q'' v = u'' - 2 q' v' - q v''
                f0, f1 = _div(u[0], u[1], v[0], v[1])
                if order > 0:
                    p0, p1 = _mul(f0, f1, v[2], v[3])
                    p0, p1 = _add(u[2], u[3], -p1, -p0)
                    d0, d1 = _div(p0, p1, v[0], v[1])
                    if order > 1:
                        p0, p1 = _mul(2.0 * d0, 2.0 * d1, v[2], v[3])
                        p0, p1 = _add(u[4], u[5], -p1, -p0)
                        q0, q1 = _mul(f0, f1, v[4], v[5])
                        p0, p1 = _add(p0, p1, -q1, -q0)
                        e0, e1 = _div(p0, p1, v[0], v[1])
            elif op in (MIN, MAX):
                f0, f1, d0, d1, e0, e1 = _extreme(op, u, v)
            elif op == POW:
                f0, f1, d0, d1, e0, e1 = _power_jet(u, v, order)
            else:
                f0, f1, d0, d1, e0, e1 = _polar(op, u, v, order)
        elif op == NEG:
            f0, f1, d0, d1, e0, e1 = -u[1], -u[0], -u[3], -u[2], -u[5], -u[4]
        elif op == SQUARE:
            f0, f1 = _square(u[0], u[1])
            if order > 0:
                p0, p1 = _mul(u[0], u[1], u[2], u[3])
                d0, d1 = 2.0 * p0, 2.0 * p1
                if order > 1:
                    p0, p1 = _square(u[2], u[3])
                    q0, q1 = _mul(u[0], u[1], u[4], u[5])
                    p0, p1 = _add(p0, p1, q0, q1)
                    e0, e1 = 2.0 * p0, 2.0 * p1
        else:
            f0, f1, g0, g1, h0, h1 = _unary(op, code[k, 2], u[0], u[1], order)
            if order > 0:
                d0, d1 = _mul(g0, g1, u[2], u[3])
                if order > 1:
                    p0, p1 = _square(u[2], u[3])
                    p0, p1 = _mul(h0, h1, p0, p1)
                    q0, q1 = _mul(g0, g1, u[4], u[5])
                    e0, e1 = _add(p0, p1, q0, q1)
        out[0], out[1] = _whole((f0, f1))
        if order > 0:
            out[2], out[3] = _whole((d0, d1))
            out[4], out[5] = _whole((e0, e1))


# ---------------------------------------------------------------- polynomials and boxes


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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
    code, n_fixed, reads, times, coeffs, start = along
    for r in range(reads.shape[0]):
        v = reads[r]
        row = jets[v]
        if v == coeffs.shape[1]:
            span = times[step + 1] - times[step]
            value = start + (times[step] + m * span)
            size = abs(start) + abs(times[step]) + abs(span)
            radius = w * abs(span) * (1.0 + 4.0 * EPS) + 4.0 * EPS * size + TINY
            row[0], row[1] = value - radius, value + radius
            row[2], row[3] = _wide(span, span, EPS)
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
        row[0], row[1] = _whole(_wide(p0 - radius, p0 + radius, EPS))
        if order > 0:
            radius = grow * (r1 + w * (d2 + w * 0.5 * b3))
            row[2], row[3] = _whole(_wide(p1 - radius, p1 + radius, EPS))
            radius = grow * (r2 + w * b3)
            row[4], row[5] = _whole(_wide(p2 - radius, p2 + radius, EPS))
    _jets(code, n_fixed, code.shape[0], jets.shape[0] - code.shape[0], jets, order)


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _least_parabola(slope: float, bend: float, length: float) -> float:
    """Return the least of ``slope t + bend t^2 / 2`` over [0, length], for a slope <= 0."""
    if bend > 0.0 and -slope < bend * length:
        return -0.5 * slope * slope / bend
    return length * (slope + 0.5 * bend * length)


@njit(cache=True, error_model="numpy")
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
    5 an upper one, 6 and 7 the enclosure of the slope, 8 a lower bound of the second derivative.
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
        low, high = _add(row[2], row[3], -bend, bend)
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
            drop = _least_parabola(min(at[2], 0.0), row[8], b)
            bound = at[0] + drop - LIBM * (abs(at[0]) - drop) - TINY
            if bound > row[4]:
                row[4] = bound


@njit(cache=True, error_model="numpy")
def _margin(along: Along, step: int, place: Floats, output: int, s: float, regs: Floats) -> float:
    place[0] = s
    _run_along(along, step, place, 1, regs)
    return regs[output, 0]


@njit(cache=True, error_model="numpy")
def _root(
    along: Along,
    step: int,
    place: Floats,
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
    a, fa = right, shift + _margin(along, step, place, output, right, regs)
    b, fb = left, shift + _margin(along, step, place, output, left, regs)
    if not fb > 0.0:
        return left
    if not fa < 0.0:
        return right
    c, fc, t = a, fa, 0.5
    for _ in range(200):
        x = a + t * (b - a)
        fx = shift + _margin(along, step, place, output, x, regs)
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


@njit(cache=True, error_model="numpy")
def _descent(
    along: Along,
    guard: Ints,
    step: int,
    left: float,
    right: float,
    bounds: Floats,
    place: Floats,
    regs: Floats,
    jets: Floats,
    work: Floats,
) -> tuple[int, float]:
    """Where the margin itself vanished, on the descent that ends at `right` below its tolerance.

    The margin falls on [left, right]. Further to the left the descent is followed as long as the
    slope is proved negative, over the joints of steps too; if the margin is not positive on all
    of it, the answer is where it starts.
    """
    coeffs, reads = along[4], along[2]
    p, q = right, left
    if _margin(along, step, place, guard[0], p, regs) >= 0.0:
        return step, p
    for _ in range(1000):
        if _margin(along, step, place, guard[0], q, regs) > 0.0:
            return step, _root(along, step, place, guard[0], 0.0, q, p, regs)
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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
    budget: int,
) -> tuple[int, int, int, float, int, float, int]:
    """First fall of an output below minus its tolerance: see `enclosure.first_crossing`.

    Returns (verdict, guard, step and place of the event, step and place where it is certain,
    boxes).
    """
    along = (code, n_fixed, reads, times, coeffs, start)
    n_out, n = outputs.shape[0], coeffs.shape[1]
    regs = _registers(code, constants, n_fixed, parameters, n, 1)
    jets = np.zeros((regs.shape[0], 6))
    base = regs.shape[0] - code.shape[0]
    for r in range(n + 1, base):
        jets[r, 0] = jets[r, 1] = regs[r, 0]
        if not abs(regs[r, 0]) < INF:
            jets[r, 0], jets[r, 1] = -INF, INF
    _jets(code, 0, n_fixed, base, jets, 2)
    bounds, work, place = np.zeros(n), np.empty((n_out, 9)), np.empty(1)
    aside = np.empty((1, 9))
    lefts, rights = np.empty(64), np.empty(64)  # boxes still to see, the leftmost on top
    marks = np.empty((64, n_out), dtype=np.uint8)  # the guards that are undecided in them
    state = np.empty(n_out, dtype=np.uint8)
    at_left = np.empty((n_out, 2))
    for i in range(n_out):
        if not tolerances[i] >= 0.0:
            raise ValueError("the tolerances of margins are numbers >= 0")
    boxes = 0
    for step in range(coeffs.shape[0]):
        finite = _prepare(coeffs, step, reads, bounds) and abs(start) < INF
        if not (finite and abs(times[step]) < INF and abs(times[step + 1]) < INF):
            return NON_FINITE, -1, step, 0.0, step, 1.0, boxes
        found, root, sure, found_left = -1, INF, INF, 0.0
        left_known = False
        top = 1
        lefts[0], rights[0] = 0.0, 1.0
        for i in range(n_out):
            marks[0, i] = 1
        while top > 0:
            top -= 1
            a, b = lefts[top], rights[top]
            boxes += 1
            if boxes > budget:
                return BUDGET, -1, step, a, step, b, boxes - 1
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
            if a == 0.0 and not left_known:
                left_known = True
                _enclose(along, step, bounds, 0.0, 0.0, 0, jets)
                for i in range(n_out):
                    at_left[i, 0], at_left[i, 1] = jets[outputs[i], 0], jets[outputs[i], 1]
            unclear, improved = 0, False
            for i in range(n_out):
                if state[i] == 0:
                    continue
                tolerance = tolerances[i]
                below = a == 0.0 and at_left[i, 1] + tolerance < 0.0
                # It rises: positive up to a, as the boxes before are clear; or zero there to
                # within rounding, and leaving.
                rises = work[i, 6] > 0.0 and (a > 0.0 or at_left[i, 0] > -INF)
                if not below and (work[i, 4] + tolerance > 0.0 or rises):
                    state[i] = 0
                    continue
                here, far = INF, INF
                if below:
                    here = far = 0.0
                elif work[i, 7] < 0.0:
                    guard = outputs[i : i + 1]
                    aside[0, 7] = work[i, 7]
                    falls, end = _falls(along, guard, tolerance, step, a, b, bounds, jets, aside)
                    if falls == 0:
                        state[i] = 0
                        continue
                    if falls == 1:
                        here = _root(along, step, place, guard[0], tolerance, a, end, regs)
                        # What rounding left over at the float root, the slope carries below 0.
                        _enclose(along, step, bounds, here, 0.0, 0, jets)
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
                            return verdict, i, step, a, step, b, boxes
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
            event_step, event = _descent(
                along, outputs[found : found + 1], step, found_left, root, bounds, place, regs,
                jets, work,
            )  # fmt: skip
            return CROSSING, found, event_step, event, step, sure, boxes
    return NONE, -1, 0, 0.0, 0, 0.0, boxes
