"""Interval arithmetic with outward rounding.

Intervals (low, high) contain every real value of the operation. Each result is widened by one ulp,
by four after libm functions (accurate to 1 to 2 ulp), and by `TINY` if a product may underflow.
Exact zeros, such as derivatives of constants, stay zero: `TINY` there would lead to slow subnormal
numbers. A lost bound (overflow, inf - inf, a point outside the domain) is NaN or infinite and
becomes the whole line, which proves nothing.
"""

from __future__ import annotations

import math

from statechart.kernels.jit import kernel

Interval = tuple[float, float]

EPS = 2.0**-52
TINY = 1e-300  # above the subnormal numbers, which are a hundred times slower on some processors
LIBM = 4.0 * EPS
INF = math.inf
LARGEST = 1.7976931348623157e308

WHOLE_LINE, ZERO, ONE = (-INF, INF), (0.0, 0.0), (1.0, 1.0)
HALF, MINUS_ONE = (0.5, 0.5), (-1.0, -1.0)


@kernel
def round_outward(a: Interval, ulps: float) -> Interval:
    """Return an interval widened by `ulps` ulp on both sides."""
    return a[0] - abs(a[0]) * ulps - TINY, a[1] + abs(a[1]) * ulps + TINY


@kernel
def neg(a: Interval) -> Interval:
    """Negation."""
    return -a[1], -a[0]


@kernel
def scaled(number: float, a: Interval) -> Interval:
    """Product with a power of two, which is exact."""
    return number * a[0], number * a[1]


@kernel
def add(a: Interval, b: Interval) -> Interval:
    """Sum."""
    # Sums do not underflow: an exact zero stays zero.
    low, high = a[0] + b[0], a[1] + b[1]
    return low - abs(low) * EPS, high + abs(high) * EPS


@kernel
def sub(a: Interval, b: Interval) -> Interval:
    """Difference."""
    return add(a, neg(b))


@kernel
def hull(p: float, q: float, r: float, s: float) -> Interval:
    """Return the interval from the least to the greatest of four numbers."""
    a, b, c, d = min(p, q), max(p, q), min(r, s), max(r, s)
    return min(a, c), max(b, d)


@kernel
def _hull4(p: float, q: float, r: float, s: float) -> Interval:
    total = p + q + r + s
    if total != total:
        return WHOLE_LINE
    return round_outward(hull(p, q, r, s), EPS)


@kernel
def mul(a: Interval, b: Interval) -> Interval:
    """Product."""
    if (a[0] == 0.0 == a[1] and b[1] - b[0] < INF) or (b[0] == 0.0 == b[1] and a[1] - a[0] < INF):
        return ZERO
    return _hull4(a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1])


@kernel
def div(a: Interval, b: Interval) -> Interval:
    """Quotient; the whole line if the divisor may be zero."""
    if not (b[0] > 0.0 or b[1] < 0.0):
        return WHOLE_LINE
    return _hull4(a[0] / b[0], a[0] / b[1], a[1] / b[0], a[1] / b[1])


@kernel
def even_power(a: Interval, p: float, q: float, ulps: float) -> Interval:
    """Range of an even power over `a`, from its values p and q at the ends."""
    small = 0.0 if a[0] <= 0.0 <= a[1] else min(p, q)
    if a[0] == 0.0 == a[1]:
        return ZERO
    low, high = round_outward((small, max(p, q)), ulps)
    return max(0.0, low), high


@kernel
def square(a: Interval) -> Interval:
    """Square."""
    return even_power(a, a[0] * a[0], a[1] * a[1], EPS)


@kernel
def sqrt(a: Interval) -> Interval:
    """Square root; the whole line if the argument may be negative."""
    if not a[0] >= 0.0:
        return WHOLE_LINE
    p, q = math.sqrt(a[0]), math.sqrt(a[1])
    return max(0.0, p - p * EPS), q + q * EPS


@kernel
def power(a: Interval, exponent: int) -> Interval:
    """Integer power, exponent >= 0."""
    if exponent == 0:
        return ONE
    if exponent == 1:
        return a
    n = float(exponent)
    p, q = a[0] ** n, a[1] ** n
    if exponent % 2 == 1:
        return round_outward((p, q), LIBM)
    return even_power(a, p, q, LIBM)


@kernel
def exp(a: Interval) -> Interval:
    """Exponential function; overflow gives an infinite upper bound."""
    p, q = round_outward((min(math.exp(a[0]), LARGEST), math.exp(a[1])), LIBM)
    return max(0.0, p), q


@kernel
def extrema(a: Interval, offset: float) -> tuple[float, float]:
    """Return the number of points (k + offset) pi in an interval (at most 2), and the last k."""
    size = max(abs(a[0]), abs(a[1])) / math.pi
    if not size < 1e14:
        return 2.0, 0.0
    slack = 4.0 * EPS * (size + 1.0)
    last = math.floor(a[1] / math.pi - offset + slack)
    return last - math.floor(a[0] / math.pi - offset - slack), last


@kernel
def sine_or_cosine(a: Interval, sine: bool) -> Interval:
    """Sine or cosine."""
    if sine and a[0] == 0.0 == a[1]:
        return ZERO
    count, last = extrema(a, 0.5 if sine else 0.0)
    if count >= 2.0:
        return -1.0, 1.0
    if sine:
        p, q = math.sin(a[0]), math.sin(a[1])
    else:
        p, q = math.cos(a[0]), math.cos(a[1])
    p, q = round_outward((min(p, q), max(p, q)), LIBM)
    if count >= 1.0:
        if last % 2.0 == 0.0:
            q = 1.0
        else:
            p = -1.0
    return max(p, -1.0), min(q, 1.0)


@kernel
def sinh(a: Interval) -> Interval:
    """Hyperbolic sine."""
    low, high = min(math.sinh(a[0]), LARGEST), max(math.sinh(a[1]), -LARGEST)
    return round_outward((low, high), LIBM)


@kernel
def cosh(a: Interval) -> Interval:
    """Hyperbolic cosine."""
    p, q = math.cosh(a[0]), math.cosh(a[1])
    least = 1.0 if a[0] <= 0.0 <= a[1] else min(p, q, LARGEST)
    p, q = round_outward((least, max(p, q)), LIBM)
    return max(1.0, p), q


@kernel
def or_whole_line(a: Interval) -> Interval:
    """Return the interval, or the whole line if a bound is NaN."""
    if a[0] <= a[1]:
        return a
    return WHOLE_LINE
