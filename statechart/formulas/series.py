"""Taylor series of a tape along a flow by automatic differentiation, with error bounds.

Coefficients follow from recurrences (Moore, "Interval Analysis", 1966, chapter 11). The size of a
coefficient times the relative error of the inputs, or the round-off, bounds its error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from statechart.arrays import Array
from statechart.formulas.tape import Tape
from statechart.kernels.tapes import OPCODES

_NAMES = {code: name for name, code in OPCODES.items()}
# A coefficient is zero below this fraction of its size.
_ZERO_COEFFICIENT = 2.0**-46
# Integer powers up to this are products.
_MAX_EXPONENT = 1024


class Series(NamedTuple):
    """Coefficients of 1, t, t**2, ..., and their sizes, at least their magnitudes."""

    values: list[float]
    sizes: list[float]


def expand(
    tape: Tape,
    variables: Sequence[Series],
    parameters: Sequence[float],
    time: float,
    places: tuple[int, ...] | None = None,
) -> list[Series]:
    """Return the series of the outputs (at `places`) of a tape, as long as those of its variables.

    Coefficients are NaN if there is no series (a root at zero).
    """
    terms = len(variables[0].values) if variables else 1
    places = tuple(range(len(tape.outputs))) if places is None else places
    clock = _constant(time, terms)
    clock.values[1:2] = [1.0][: terms - 1]
    registers = dict(enumerate((*variables, clock)))
    numbers = (*parameters, *tape.constants.tolist())

    def register(place: int) -> Series:
        if place not in registers:
            registers[place] = _constant(numbers[place - len(variables) - 1], terms)
        return registers[place]

    for place, op, left, right in tape.needed(places):
        a, name = register(left), _NAMES[op]
        try:
            if name in _BINARY:
                found = _BINARY[name](a, register(right))
            else:
                found = _integer_power(a, right) if name == "powi" else _UNARY[name](a)
        except (ValueError, ZeroDivisionError, OverflowError):
            found = Series([math.nan] * terms, [math.nan] * terms)
        registers[place] = found
    return [register(tape.outputs.item(place)) for place in places]


def sizes_at(
    tape: Tape, places: tuple[int, ...], state: Array, sizes: Array, parameters: Array, time: float
) -> list[float]:
    """Return the sizes of outputs from those of the state."""
    pairs = zip(state.tolist(), sizes.tolist(), strict=True)
    variables = [Series([x], [max(abs(x), size)]) for x, size in pairs]
    found = expand(tape, variables, parameters.tolist(), time, places)
    return [one.sizes[0] for one in found]


def _constant(value: float, terms: int) -> Series:
    zeros = [0.0] * (terms - 1)
    return Series([value, *zeros], [abs(value), *zeros])


def _product(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [sum(a[i] * b[k - i] for i in range(k + 1)) for k in range(len(a))]


def _absolute_values(a: Sequence[float]) -> list[float]:
    return [abs(x) for x in a]


def _sum(*parts: Sequence[float]) -> list[float]:
    return [sum(column) for column in zip(*parts, strict=True)]


def _add(a: Series, b: Series) -> Series:
    return Series(_sum(a.values, b.values), _sum(a.sizes, b.sizes))


def _neg(a: Series) -> Series:
    return Series([-x for x in a.values], a.sizes)


def _sub(a: Series, b: Series) -> Series:
    return _add(a, _neg(b))


def _mul(a: Series, b: Series) -> Series:
    left, right = _absolute_values(a.values), _absolute_values(b.values)
    sizes = _sum(_product(left, b.sizes), _product(a.sizes, right))
    return Series(_product(a.values, b.values), sizes)


def _div(a: Series, b: Series) -> Series:
    below = [-x for x in b.values]

    def quotient(above: Sequence[float], signed: Sequence[float]) -> list[float]:
        quotients: list[float] = []
        for k, x in enumerate(above):
            total = x + sum(quotients[i] * signed[k - i] for i in range(k))
            quotients.append(total / abs(b.values[0]))
        return quotients

    sign = math.copysign(1.0, b.values[0])
    values = quotient([sign * x for x in a.values], [sign * x for x in below])
    sizes = _sum(a.sizes, _product(_absolute_values(values), b.sizes))
    return Series(values, quotient(sizes, _absolute_values(b.values)))


def _chain(first: float, *parts: tuple[Series, Series]) -> Series:
    """Return f(a, b, ...) from its first coefficient and pairs (argument, partial derivative)."""
    values = [first]
    pairs = [(a.values, slope.values) for a, slope in parts]
    for k in range(1, len(parts[0][0].values)):
        total = sum(i * a[i] * slope[k - i] for a, slope in pairs for i in range(1, k + 1))
        values.append(total / k)
    sizes = [_product(_absolute_values(slope.values), a.sizes) for a, slope in parts]
    return Series(values, _sum(_absolute_values(values), *sizes))


def _coupled_series(
    a: Series, first: tuple[float, float], signs: tuple[float, float]
) -> tuple[Series, Series]:
    """Return f and g with f' = signs[0] g and g' = signs[1] f."""
    f, g = [first[0]], [first[1]]
    for k in range(1, len(a.values)):
        rates = [i * a.values[i] / k for i in range(1, k + 1)]
        f_k = signs[0] * sum(rate * g[k - 1 - i] for i, rate in enumerate(rates))
        g_k = signs[1] * sum(rate * f[k - 1 - i] for i, rate in enumerate(rates))
        f.append(f_k)
        g.append(g_k)
    first_sizes, second_sizes = _absolute_values(f), _absolute_values(g)
    changes = _product(second_sizes, a.sizes), _product(first_sizes, a.sizes)
    return Series(f, _sum(first_sizes, changes[0])), Series(g, _sum(second_sizes, changes[1]))


def _trigonometric(a: Series) -> tuple[Series, Series]:
    return _coupled_series(a, (math.sin(a.values[0]), math.cos(a.values[0])), (1.0, -1.0))


def _hyperbolic(a: Series) -> tuple[Series, Series]:
    return _coupled_series(a, (math.sinh(a.values[0]), math.cosh(a.values[0])), (1.0, 1.0))


def _exp(a: Series) -> Series:
    first = math.exp(a.values[0])
    return _coupled_series(a, (first, first), (1.0, 1.0))[0]


def _one(a: Series) -> Series:
    return _constant(1.0, len(a.values))


def _sqrt(a: Series) -> Series:
    if not any(a.values):
        return a
    values = [math.sqrt(a.values[0])]
    for k in range(1, len(a.values)):
        mixed = sum(values[i] * values[k - i] for i in range(1, k))
        values.append((a.values[k] - mixed) / (2.0 * values[0]))
    root = Series(values, _absolute_values(values))
    slope = _div(_constant(0.5, len(values)), root)
    return Series(values, _sum(root.sizes, _product(_absolute_values(slope.values), a.sizes)))


def _log(a: Series) -> Series:
    return _chain(math.log(a.values[0]), (a, _div(_one(a), a)))


def _arc(a: Series) -> Series:
    return _div(_one(a), _sqrt(_sub(_one(a), _mul(a, a))))


def _atan2(y: Series, x: Series) -> Series:
    square = _add(_mul(x, x), _mul(y, y))
    first = math.atan2(y.values[0], x.values[0])
    return _chain(first, (y, _div(x, square)), (x, _neg(_div(y, square))))


def _integer_power(a: Series, exponent: int) -> Series:
    result = None
    while exponent:
        if exponent & 1:
            result = a if result is None else _mul(result, a)
        exponent >>= 1
        a = _mul(a, a) if exponent else a
    return _one(a) if result is None else result


def _pow(a: Series, b: Series) -> Series:
    n = b.values[0]
    if not any(b.values[1:]) and n == math.floor(n) and 0.0 <= n <= _MAX_EXPONENT:
        return _integer_power(a, int(n))
    return _exp(_mul(b, _log(a)))


def _sign_of(a: Series) -> float:
    for value, size in zip(a.values, a.sizes, strict=True):
        if not abs(value) <= _ZERO_COEFFICIENT * size:
            return math.copysign(1.0, value)
    return 0.0


_BINARY: dict[str, Callable[[Series, Series], Series]] = {
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "div": _div,
    "min": lambda a, b: b if _sign_of(_sub(a, b)) > 0.0 else a,
    "max": lambda a, b: b if _sign_of(_sub(a, b)) < 0.0 else a,
    "atan2": _atan2,
    "hypot": lambda a, b: _sqrt(_add(_mul(a, a), _mul(b, b))),
    "pow": _pow,
}
_UNARY: dict[str, Callable[[Series], Series]] = {
    "neg": _neg,
    "square": lambda a: _mul(a, a),
    "sqrt": _sqrt,
    "exp": _exp,
    "log": _log,
    "sin": lambda a: _trigonometric(a)[0],
    "cos": lambda a: _trigonometric(a)[1],
    "tan": lambda a: _div(*_trigonometric(a)),
    "asin": lambda a: _chain(math.asin(a.values[0]), (a, _arc(a))),
    "acos": lambda a: _chain(math.acos(a.values[0]), (a, _neg(_arc(a)))),
    "atan": lambda a: _chain(math.atan(a.values[0]), (a, _div(_one(a), _add(_one(a), _mul(a, a))))),
    "sinh": lambda a: _hyperbolic(a)[0],
    "cosh": lambda a: _hyperbolic(a)[1],
    "tanh": lambda a: _div(*_hyperbolic(a)),
    "abs": lambda a: _neg(a) if _sign_of(a) < 0.0 else a,
    "sign": lambda a: _constant(_sign_of(a), len(a.values)),
}
