"""Conversion of tapes to heyoka expressions."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import heyoka as hy

from statechart.errors import Unsupported
from statechart.formulas.tape import Tape
from statechart.kernels.tapes import OPCODES, POW

# No warnings on stdout about an unusable disk cache.
hy.set_logger_level_error()

_NAMES = {code: name for name, code in OPCODES.items()}
_UNARY: dict[str, Callable[[Any], Any]] = {
    "neg": operator.neg,
    "square": lambda x: x**2.0,
    # Analytic for x != 0, on either side.
    "abs": lambda x: hy.sqrt(x**2.0),
    "sign": lambda x: x / hy.sqrt(x**2.0),
    **{
        name: getattr(hy, name)
        for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh",
                     "cosh", "tanh")
    },
}  # fmt: skip
_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "hypot": lambda x, y: hy.sqrt(x**2.0 + y**2.0),
    "atan2": hy.atan2,
    "pow": lambda x, y: hy.exp(y * hy.log(x)),
}
# Functions of a power without a Taylor series at base zero: exponent of their base in that power.
_SINGULAR = {"sqrt": 1, "pow": 1, "abs": 2, "sign": 2, "hypot": 2}


class HeyokaFormulas(NamedTuple):
    """The outputs of a tape as heyoka expressions."""

    expressions: tuple[Any, ...]
    parameters: tuple[int, ...]  # registers that are heyoka's parameters, after the time
    bases: dict[int, int]  # register -> exponent of the base of a power without a series at zero


def convert(tape: Tape, *, folds: bool) -> HeyokaFormulas:
    """Convert a tape in variables v0, v1, ..., one heyoka node per operation.

    Constants, parameters and, if it `folds`, operations on these alone are parameters of heyoka:
    as operations they would be expanded into series with one nonzero term, and modes that differ in
    numbers only share a program. Raises `Unsupported` for a function without a Taylor series.
    """
    first = tape.n_variables + 1 + tape.n_parameters
    base = first + len(tape.constants)
    known: dict[int, Any] = {i: hy.expression(f"v{i}") for i in range(tape.n_variables)}
    # heyoka's time starts at zero in every arc, so that late arcs lose no digits.
    known[tape.n_variables] = hy.time + hy.par[0]
    parameters: list[int] = []
    bases: dict[int, int] = {}

    def register(place: int) -> Any:
        if place not in known:
            parameters.append(place)
            known[place] = hy.par[len(parameters)]
        return known[place]

    skipped = tape.n_fixed if folds else 0
    for place, (op, left, right) in enumerate(tape.code[skipped:].tolist(), base + skipped):
        name, x = _NAMES[op], register(left)
        if name in _SINGULAR:
            bases[place if name == "hypot" else left] = _SINGULAR[name]
        if name == "powi":
            found = _product(x, right)
        elif name == "pow" and first <= right < base:
            found = x ** tape.constants.item(right - first)
        elif op <= POW and name in _BINARY:
            found = _BINARY[name](x, register(right))
        elif name in _UNARY:
            found = _UNARY[name](x)
        else:
            raise Unsupported(
                f"the Taylor engine cannot expand {name}() in a flow; use engine: scipy"
            )
        known[place] = found
    return HeyokaFormulas(tuple(map(register, tape.outputs.tolist())), tuple(parameters), bases)


def _product(base: Any, exponent: int) -> Any:
    """Return a power as a product: heyoka's series of a power divides by the base."""
    if exponent == 1:
        return base
    square = _product(base, exponent // 2) ** 2.0
    return square if exponent % 2 == 0 else square * base
