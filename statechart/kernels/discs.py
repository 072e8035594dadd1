"""Circular complex arithmetic on tapes: bounds of analytic functions around a box.

Circular arithmetic (I. Gargantini and P. Henrici, "Circular arithmetic and the determination of
polynomial zeros", Numer. Math. 18, 1972): a disc is a centre and a radius. A function that is not
known to be analytic on its disc has an infinite radius. Every radius includes a small part of the
centre for round-off: only orders of magnitude are needed.
"""

from __future__ import annotations

import cmath
import math

from statechart.arrays import Array, Complexes, Ints32
from statechart.kernels import tapes
from statechart.kernels.intervals import INF
from statechart.kernels.jit import kernel

Disc = tuple[complex, float]

_WIDER = 2.0**-40
_UNKNOWN: Disc = (0j, INF)
_ONE: Disc = (1.0 + 0j, 0.0)
_I = 1j
_MAX_EXPONENT = 1024.0  # larger exponents are useless


@kernel
def _add(a: Disc, b: Disc) -> Disc:
    return a[0] + b[0], a[1] + b[1]


@kernel
def _neg(a: Disc) -> Disc:
    return -a[0], a[1]


@kernel
def _mul(a: Disc, b: Disc) -> Disc:
    return a[0] * b[0], abs(a[0]) * b[1] + abs(b[0]) * a[1] + a[1] * b[1]


@kernel
def _inverse(a: Disc) -> Disc:
    size = abs(a[0])
    if not size > a[1]:
        return _UNKNOWN
    square = (size - a[1]) * (size + a[1])
    return a[0].conjugate() / square, a[1] / square


@kernel
def _exp(a: Disc) -> Disc:
    size = math.exp(a[0].real)
    y = a[0].imag
    return complex(size * math.cos(y), size * math.sin(y)), size * math.expm1(a[1])


@kernel
def _avoids_cut(a: Disc) -> bool:
    """Return whether a disc avoids zero and the negative real axis, the cut of roots and logs."""
    reach = abs(a[0]) if a[0].real > 0.0 else abs(a[0].imag)
    return reach > a[1]


@kernel
def _sqrt(a: Disc) -> Disc:
    if not _avoids_cut(a):
        return _UNKNOWN
    size = math.sqrt(abs(a[0]))
    return cmath.sqrt(a[0]), size * (1.0 - math.sqrt(1.0 - a[1] / abs(a[0])))


@kernel
def _log(a: Disc) -> Disc:
    if not _avoids_cut(a):
        return _UNKNOWN
    size = abs(a[0])
    return complex(math.log(size), math.atan2(a[0].imag, a[0].real)), -math.log1p(-a[1] / size)


@kernel
def _sin(a: Disc) -> Disc:
    x, y = a[0].real, a[0].imag
    centre = complex(math.sin(x) * math.cosh(y), math.cos(x) * math.sinh(y))
    return centre, a[1] * math.cosh(abs(y) + a[1])


@kernel
def _cos(a: Disc) -> Disc:
    x, y = a[0].real, a[0].imag
    centre = complex(math.cos(x) * math.cosh(y), -math.sin(x) * math.sinh(y))
    return centre, a[1] * math.cosh(abs(y) + a[1])


@kernel
def _rotate(a: Disc, by: complex) -> Disc:
    """Return the product with a number of modulus one."""
    return a[0] * by, a[1]


@kernel
def _tanh(a: Disc) -> Disc:
    # (1 - q) / (1 + q), q = exp(-2 z), in the half-plane where q is small.
    left = a[0].real < 0.0
    z = _neg(a) if left else a
    q = _exp((-2.0 * z[0], 2.0 * z[1]))
    centre, radius = _inverse(_add(q, _ONE))
    found = (2.0 * centre - 1.0, 2.0 * radius)
    return _neg(found) if left else found


@kernel
def _atan(a: Disc) -> Disc:
    # The derivative is 1 / ((z - i) (z + i)); the cuts start at +-i, along the imaginary axis.
    up, down = abs(a[0] - _I) - a[1], abs(a[0] + _I) - a[1]
    if not (up > 0.0 and down > 0.0) or (abs(a[0].imag) >= 1.0 and abs(a[0].real) <= a[1]):
        return _UNKNOWN
    return cmath.atan(a[0]), a[1] / (up * down)


@kernel
def _asin(a: Disc) -> Disc:
    # The derivative is 1 / sqrt((1 - z) (1 + z)); the cuts start at +-1, along the real axis.
    near, far = abs(a[0] - 1.0) - a[1], abs(a[0] + 1.0) - a[1]
    if not (near > 0.0 and far > 0.0) or (abs(a[0].real) >= 1.0 and abs(a[0].imag) <= a[1]):
        return _UNKNOWN
    return cmath.asin(a[0]), a[1] / math.sqrt(near * far)


@kernel
def _whole_power(a: Disc, n: int) -> Disc:
    if n < 0:
        a, n = _inverse(a), -n
    size, exponent = abs(a[0]), float(n)
    radius = (size + a[1]) ** exponent - size**exponent
    found, factor = 1.0 + 0j, a[0]
    while n > 0:
        if n % 2 == 1:
            found *= factor
        factor *= factor
        n //= 2
    return found, radius


@kernel
def _power(a: Disc, b: Disc) -> Disc:
    n = math.floor(b[0].real + 0.5)
    if b[1] <= 1e-14 * abs(n) and abs(b[0] - n) <= 1e-14 * abs(n) and abs(n) <= _MAX_EXPONENT:
        return _whole_power(a, int(n))  # an integer parameter
    return _exp(_mul(b, _log(a)))


@kernel
def _angle(y: Disc, x: Disc) -> Disc:
    quarter = 0.5 * math.pi
    if x[0].real > x[1]:
        return _atan(_mul(y, _inverse(x)))
    if abs(y[0].real) > y[1]:
        centre, radius = _atan(_mul(x, _inverse(y)))
        return (quarter if y[0].real > 0.0 else -quarter) - centre, radius
    return _UNKNOWN


@kernel
def _apply_binary(op: int, a: Disc, b: Disc) -> Disc:
    """Evaluate an operation of two operands."""
    if op == tapes.ADD:
        return _add(a, b)
    if op == tapes.SUB:
        return _add(a, _neg(b))
    if op == tapes.MUL:
        return _mul(a, b)
    if op == tapes.DIV:
        return _mul(a, _inverse(b))
    if op in (tapes.MIN, tapes.MAX):
        apart = a[0].real - b[0].real
        if not abs(apart) > a[1] + b[1]:
            return _UNKNOWN
        return a if (apart < 0.0) == (op == tapes.MIN) else b
    if op == tapes.POW:
        return _power(a, b)
    if op == tapes.ATAN2:
        return _angle(a, b)
    return _sqrt(_add(_mul(a, a), _mul(b, b)))  # HYPOT


@kernel
def _apply_unary(op: int, exponent: int, a: Disc) -> Disc:
    """Evaluate an operation of one operand."""
    if op == tapes.NEG:
        return _neg(a)
    if op == tapes.SQUARE:
        return _mul(a, a)
    if op == tapes.POWI:
        return _whole_power(a, exponent)
    if op == tapes.SQRT:
        return _sqrt(a)
    if op == tapes.EXP:
        return _exp(a)
    if op == tapes.LOG:
        return _log(a)
    if op == tapes.SIN:
        return _sin(a)
    if op == tapes.COS:
        return _cos(a)
    if op == tapes.SINH:
        return _rotate(_sin(_rotate(a, _I)), -_I)
    if op == tapes.COSH:
        return _cos(_rotate(a, _I))
    if op == tapes.TANH:
        return _tanh(a)
    if op == tapes.TAN:
        return _rotate(_tanh(_rotate(a, _I)), -_I)
    if op == tapes.ATAN:
        return _atan(a)
    if op == tapes.ASIN:
        return _asin(a)
    if op == tapes.ACOS:
        centre, radius = _asin(a)
        return 0.5 * math.pi - centre, radius
    if op in (tapes.ABS, tapes.SIGN) and abs(a[0].real) > a[1]:
        if op == tapes.SIGN:
            return _ONE if a[0].real > 0.0 else _neg(_ONE)
        return a if a[0].real > 0.0 else _neg(a)
    return _UNKNOWN


@kernel
def run_discs(
    code: Ints32, first: int, last: int, base: int, centres: Complexes, radii: Array
) -> None:
    """Run the operations [first, last) on registers of discs."""
    for k in range(first, last):
        op, i = code[k, 0], code[k, 1]
        a = (centres[i], radii[i])
        if op <= tapes.POW:
            j = code[k, 2]
            f = _apply_binary(op, a, (centres[j], radii[j]))
        else:
            f = _apply_unary(op, code[k, 2], a)
        size = abs(f[0])
        known = size < INF and f[1] < INF  # a comparison with NaN is false
        centres[base + k] = f[0] if known else 0j
        radii[base + k] = f[1] + _WIDER * size if known and f[1] > 0.0 else (0.0 if known else INF)
