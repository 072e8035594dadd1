"""Interval jets of tapes: enclosures of values and of their derivatives with respect to time.

A jet is the value, first and second derivative with respect to the step's local time s in [0, 1],
as three intervals in a row of six numbers; see Moore, Kearfott and Cloud, "Introduction to
Interval Analysis", 2009, chapters 5 and 9, for the centred forms built on it.
"""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels import tapes
from statechart.kernels.intervals import (
    HALF,
    INF,
    LIBM,
    MINUS_ONE,
    ONE,
    WHOLE_LINE,
    ZERO,
    Interval,
    add,
    cosh,
    div,
    even_power,
    exp,
    extrema,
    hull,
    mul,
    neg,
    or_whole_line,
    power,
    round_outward,
    scaled,
    sine_or_cosine,
    sinh,
    sqrt,
    square,
    sub,
)
from statechart.kernels.jit import kernel

Jet = tuple[Interval, Interval, Interval]

_MAX_EXPONENT = 1024.0  # larger exponents are useless


@kernel
def _defined(op: int, a: Interval) -> Interval:
    """Return the part of an interval on which a function is defined, if there is one."""
    low, high = a
    if op in (tapes.SQRT, tapes.LOG, tapes.POW) and low < 0.0 <= high:
        low = 0.0
    elif op in (tapes.ASIN, tapes.ACOS):
        if low < -1.0 <= high:
            low = -1.0
        if low <= 1.0 < high:
            high = 1.0
    return low, high


@kernel
def _kinked(op: int, a: Interval) -> Jet:
    """Enclosures of abs or sign and of their derivatives."""
    f = d = e = WHOLE_LINE
    if op == tapes.ABS:
        if a[0] >= 0.0:
            f, d, e = a, ONE, ZERO
        elif a[1] <= 0.0:
            f, d, e = neg(a), MINUS_ONE, ZERO
        else:
            f, d = (0.0, max(-a[0], a[1])), (-1.0, 1.0)
    elif a[0] > 0.0:
        f, d, e = ONE, ZERO, ZERO
    elif a[1] < 0.0:
        f, d, e = MINUS_ONE, ZERO, ZERO
    else:
        f = (-1.0, 1.0)
    return f, d, e


@kernel
def _inverse(op: int, a: Interval) -> Jet:
    """Enclosures of atan, asin or acos and of their derivatives."""
    f = d = e = WHOLE_LINE
    if op == tapes.ATAN:
        f = round_outward((math.atan(a[0]), math.atan(a[1])), LIBM)
        d = div(ONE, add(square(a), ONE))
        e = mul(scaled(2.0, neg(a)), square(d))
    elif a[0] >= -1.0 and a[1] <= 1.0:
        p = sub(ONE, square(a))
        d = div(ONE, sqrt(p))
        e = div(mul(a, d), p)
        if op == tapes.ASIN:
            f = round_outward((math.asin(a[0]), math.asin(a[1])), LIBM)
        else:
            f = round_outward((math.acos(a[1]), math.acos(a[0])), LIBM)
            d, e = neg(d), neg(e)
    return f, d, e


@kernel
def _hyperbolic(op: int, a: Interval) -> Jet:
    """Enclosures of sinh, cosh or tanh and of their derivatives."""
    f = d = e = WHOLE_LINE
    if op == tapes.SINH:
        f = e = sinh(a)
        d = cosh(a)
    elif op == tapes.COSH:
        f = e = cosh(a)
        d = sinh(a)
    else:
        f = round_outward((math.tanh(a[0]), math.tanh(a[1])), LIBM)
        f = (max(f[0], -1.0), min(f[1], 1.0))
        d = sub(ONE, square(f))
        e = mul(scaled(2.0, neg(f)), d)
    return f, d, e


@kernel
def _unary(op: int, exponent: int, a: Interval, order: int) -> Jet:
    """Enclosures over an interval of f and, if the order is above 0, of f' and f''."""
    if order < 0:
        a = _defined(op, a)
    f = d = e = WHOLE_LINE
    if op == tapes.SIN:
        f = sine_or_cosine(a, True)
        if order > 0:
            d, e = sine_or_cosine(a, False), neg(f)
    elif op == tapes.COS:
        f = sine_or_cosine(a, False)
        if order > 0:
            d, e = neg(sine_or_cosine(a, True)), neg(f)
    elif op == tapes.SQRT:
        f = sqrt(a)
        if order > 0:
            d = div(HALF, f)
            e = div(scaled(0.5, neg(d)), a)
    elif op == tapes.EXP:
        f = d = e = exp(a)
    elif op == tapes.POWI:
        f = power(a, exponent)
        if order > 0:
            n = float(exponent)
            d = mul(power(a, exponent - 1), (n, n))
            n *= n - 1.0
            e = mul(power(a, exponent - 2), (n, n))
    elif op == tapes.LOG:
        if a[0] > 0.0:
            f = round_outward((math.log(a[0]), math.log(a[1])), LIBM)
            d = div(ONE, a)
            e = neg(square(d))
        elif order < 0 and a[0] == 0.0:
            f = round_outward((-INF, math.log(a[1]) if a[1] > 0.0 else -INF), LIBM)
    elif op == tapes.TAN:
        if extrema(a, 0.5)[0] < 1.0:
            f = round_outward((math.tan(a[0]), math.tan(a[1])), LIBM)
            d = add(square(f), ONE)
            e = mul(scaled(2.0, f), d)
    elif op in (tapes.ABS, tapes.SIGN):
        f, d, e = _kinked(op, a)
    elif op in (tapes.ATAN, tapes.ASIN, tapes.ACOS):
        f, d, e = _inverse(op, a)
    elif op in (tapes.SINH, tapes.COSH, tapes.TANH):
        f, d, e = _hyperbolic(op, a)
    return f, d, e


@kernel
def _polar(op: int, y: Jet, x: Jet) -> Jet:
    """Jets of hypot(y, x) and atan2(y, x)."""
    y0, y1, y2 = y
    x0, x1, x2 = x
    # (q / 2)' = x x' + y y' with q = x^2 + y^2
    half = add(mul(x0, x1), mul(y0, y1))
    if op == tapes.HYPOT:
        p, q = (
            even_power(y0, abs(y0[0]), abs(y0[1]), 0.0),
            even_power(x0, abs(x0[0]), abs(x0[1]), 0.0),
        )
        f = round_outward((math.hypot(p[0], q[0]), math.hypot(p[1], q[1])), LIBM)
        f = (max(0.0, f[0]), f[1])
        # r r' = x x' + y y';  r r'' = x'^2 + x x'' + y'^2 + y y'' - r'^2
        d = div(half, f)
        n = add(add(square(x1), square(y1)), add(mul(x0, x2), mul(y0, y2)))
        return f, d, div(sub(n, square(d)), f)
    if not (x0[0] > 0.0 or y0[0] > 0.0 or y0[1] < 0.0):
        return (-LIBM - math.pi, math.pi + LIBM), WHOLE_LINE, WHOLE_LINE
    # Away from the cut the angle is monotone along every edge: its extremes are at corners.
    a, b = math.atan2(y0[0], x0[0]), math.atan2(y0[0], x0[1])
    c, r = math.atan2(y0[1], x0[0]), math.atan2(y0[1], x0[1])
    # q w = x y' - y x';  q w' = x y'' - y x'' - 2 w (x x' + y y')
    q = add(square(y0), square(x0))
    d = div(sub(mul(x0, y1), mul(y0, x1)), q)
    n = sub(mul(x0, y2), mul(y0, x2))
    return round_outward(hull(a, b, c, r), LIBM), d, div(sub(n, mul(scaled(2.0, d), half)), q)


@kernel
def _whole_power(x: Jet, n: int) -> Jet:
    """Jets of an integer power, for x of any sign."""
    x0, x1, x2 = x
    if n == 0:
        return ONE, ZERO, ZERO
    if n == 1:
        return x
    c = float(n)
    first, second = (c, c), (c * (c - 1.0), c * (c - 1.0))
    if n > 0:
        f = power(x0, n)
        g, h = mul(power(x0, n - 1), first), mul(power(x0, n - 2), second)
    else:
        f = div(ONE, power(x0, -n))
        g, h = div(first, power(x0, 1 - n)), div(second, power(x0, 2 - n))
    return f, mul(g, x1), add(mul(h, square(x1)), mul(g, x2))


@kernel
def _power_jet(x: Jet, y: Jet, order: int) -> Jet:
    """Jets of x**y = exp(y log x), x >= 0; the extremes of the value are at the corners.

    An exponent within round-off of an integer counts as the integer.
    """
    x0, x1, x2 = x
    y0, y1, y2 = y
    k, steady = math.floor(0.5 * (y0[0] + y0[1]) + 0.5), max(-y1[0], y1[1], -y2[0], y2[1])
    if steady <= 1e-290 and max(k - y0[0], y0[1] - k) <= 1e-14 * abs(k) and abs(k) <= _MAX_EXPONENT:
        return _whole_power(x, int(k))
    if order < 0:
        x0 = _defined(tapes.POW, x0)
    if not (x0[0] > 0.0 or (x0[0] == 0.0 and y0[0] > 0.0)):
        return WHOLE_LINE, WHOLE_LINE, WHOLE_LINE
    f = hull(x0[0] ** y0[0], x0[0] ** y0[1], x0[1] ** y0[0], x0[1] ** y0[1])
    f = round_outward(f, LIBM)
    f = (max(0.0, f[0]), f[1])
    n, r, m = _unary(tapes.LOG, 0, x0, 2)
    g = mul(r, x1)  # (log x)'
    w = add(mul(y1, n), mul(y0, g))  # (y log x)'
    h = add(mul(m, square(x1)), mul(r, x2))  # (log x)''
    h = add(add(mul(y0, h), mul(y2, n)), mul(scaled(2.0, y1), g))  # (y log x)''
    return f, mul(f, w), mul(f, add(h, square(w)))


@kernel
def _extreme(op: int, u: Jet, v: Jet) -> Jet:
    """Jets of min(u, v) and max(u, v): one of them, or the hull without a second derivative."""
    if u[0][1] <= v[0][0]:
        return u if op == tapes.MIN else v
    if v[0][1] <= u[0][0]:
        return v if op == tapes.MIN else u
    d = (min(u[1][0], v[1][0]), max(u[1][1], v[1][1]))
    if op == tapes.MIN:
        return (min(u[0][0], v[0][0]), min(u[0][1], v[0][1])), d, WHOLE_LINE
    return (max(u[0][0], v[0][0]), max(u[0][1], v[0][1])), d, WHOLE_LINE


@kernel
def _jet(jets: Array, r: int) -> Jet:
    return (jets[r, 0], jets[r, 1]), (jets[r, 2], jets[r, 3]), (jets[r, 4], jets[r, 5])


@kernel
def run_jets(code: Ints32, first: int, last: int, base: int, jets: Array, order: int) -> None:
    """Run the operations [first, last) on jets, up to the derivatives of this order.

    Order -1: values on the part of the intervals where the operations are defined.
    """
    for k in range(first, last):
        op = code[k, 0]
        if op == tapes.SKIP:
            continue
        u, du, ddu = _jet(jets, code[k, 1])
        d = e = ZERO
        if op <= tapes.POW:
            v, dv, ddv = _jet(jets, code[k, 2])
            if op == tapes.ADD:
                f = add(u, v)
                if order > 0:
                    d, e = add(du, dv), add(ddu, ddv)
            elif op == tapes.SUB:
                f = sub(u, v)
                if order > 0:
                    d, e = sub(du, dv), sub(ddu, ddv)
            elif op == tapes.MUL:
                f = mul(u, v)
                if order > 0:
                    d = add(mul(du, v), mul(u, dv))
                if order > 1:
                    e = add(mul(ddu, v), mul(u, ddv))
                    e = add(e, mul(scaled(2.0, du), dv))
            elif op == tapes.DIV:
                # q v = u, hence q' v = u' - q v' and q'' v = u'' - 2 q' v' - q v''
                f = div(u, v)
                if order > 0:
                    d = div(sub(du, mul(f, dv)), v)
                if order > 1:
                    e = sub(ddu, mul(scaled(2.0, d), dv))
                    e = div(sub(e, mul(f, ddv)), v)
            elif op in (tapes.MIN, tapes.MAX):
                f, d, e = _extreme(op, (u, du, ddu), (v, dv, ddv))
            elif op == tapes.POW:
                f, d, e = _power_jet((u, du, ddu), (v, dv, ddv), order)
            else:
                f, d, e = _polar(op, (u, du, ddu), (v, dv, ddv))
        elif op == tapes.NEG:
            f, d, e = neg(u), neg(du), neg(ddu)
        elif op == tapes.SQUARE:
            f = square(u)
            if order > 0:
                d = scaled(2.0, mul(u, du))
            if order > 1:
                e = scaled(2.0, add(square(du), mul(u, ddu)))
        else:
            f, g, h = _unary(op, code[k, 2], u, order)
            if order > 0:
                d = mul(g, du)
            if order > 1:
                e = add(mul(h, square(du)), mul(g, ddu))
        jets[base + k, 0], jets[base + k, 1] = or_whole_line(f)
        if order > 0:
            jets[base + k, 2], jets[base + k, 3] = or_whole_line(d)
            jets[base + k, 4], jets[base + k, 5] = or_whole_line(e)


@kernel
def tape_ranges(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    state: Array,
    parameters: Array,
    end: float,
    ranges: Array,
) -> None:
    """Write the enclosures (n_out, 2) of the outputs over the times [0, end].

    Natural interval extension: bounds may be wide if an output depends on the time more than once,
    and are infinite where it is undefined.
    """
    n, p = state.shape[0], parameters.shape[0]
    base = n + 1 + p + constants.shape[0]
    jets = np.zeros((base + code.shape[0], 6))
    for v in range(n):
        jets[v, 0] = jets[v, 1] = state[v]
    jets[n, 1] = end
    for k in range(p):
        jets[n + 1 + k, 0] = jets[n + 1 + k, 1] = parameters[k]
    for k in range(constants.shape[0]):
        jets[n + 1 + p + k, 0] = jets[n + 1 + p + k, 1] = constants[k]
    for r in range(base):
        if not jets[r, 1] - jets[r, 0] < INF:
            jets[r, 0], jets[r, 1] = -INF, INF
    run_jets(code, 0, code.shape[0], base, jets, 0)
    for i in range(outputs.shape[0]):
        ranges[i, 0], ranges[i, 1] = jets[outputs[i], 0], jets[outputs[i], 1]
