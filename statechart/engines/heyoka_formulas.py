"""heyoka expressions from tapes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import heyoka as hy
import numpy as np

from statechart.errors import Unsupported
from statechart.formulas.tape import Tape
from statechart.kernels.tapes import DIV, MUL, OPCODES, POW, POWI

# No warnings on stdout about an unusable disk cache.
hy.set_logger_level_error()
# A process that opens heyoka's database of compiled equations sums the sizes of all its rows: 25 ms
# for 100 MB, and the default limit is 21 GB. A folder of our own leaves the user's limit alone.
with suppress(RuntimeError):  # a folder that cannot be written
    hy.llvm_state.set_diskcache_path(str(Path.home() / ".cache" / "statechart" / "heyoka"))
    hy.llvm_state.set_diskcache_limit(40_000_000)  # a hundred modes


def _product(base: Any, exponent: int) -> Any:
    """Return a whole power as products; heyoka's series divides by the base, which may be zero."""
    if exponent == 1:
        return base
    square = _product(base, exponent // 2) ** 2.0
    return square if exponent % 2 == 0 else square * base


_NAMES = ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
_OPERATIONS: dict[str, Callable[..., Any]] = {
    **{name: getattr(hy, name) for name in (*_NAMES, "atan2")},
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "square": lambda a: a**2.0,
    "powi": _product,
    "pow": lambda a, b: a**b if isinstance(b, float) else hy.exp(b * hy.log(a)),
    "hypot": lambda a, b: hy.sqrt(a**2.0 + b**2.0),
    # SymPy simplifies sqrt(x**2), which is analytic for x != 0.
    "abs": lambda a: hy.sqrt(a**2.0),
    "sign": lambda a: a / hy.sqrt(a**2.0),
}
_BY_CODE = {code: (name, _OPERATIONS.get(name)) for name, code in OPCODES.items()}


class Converter:
    """Outputs of a tape as heyoka `expressions`, one node per operation that varies in a flow.

    Fixed numbers are computed once per flow, by the tape `fixed`, and passed to heyoka as
    parameters after the time: as operations they would be expanded into series with one nonzero
    term, and modes whose rates differ in numbers only (a heater on or off) share a program. Fixed
    factors of products and quotients are joined, lest large masses overflow series. Unless it
    `folds`, heyoka computes all operations, in its own precision.
    """

    def __init__(self, tape: Tape, *, folds: bool) -> None:
        self._tape, first = tape, tape.n_variables + 1 + tape.n_parameters
        numbers = dict(enumerate(tape.constants.tolist(), start=first))
        begin = tape.n_fixed if folds else 0
        self._end = first + len(numbers) + begin
        self._joined: dict[tuple[int, int, int], int] = {}  # fixed operation -> register
        self._passed: dict[int, Any] = {}  # fixed register -> its parameter of heyoka
        # Fixed factor, a register, and varying factor of every register.
        self._factors: dict[int, tuple[int | None, Any]]
        self._factors = {i: (None, hy.expression(f"v{i}")) for i in range(tape.n_variables)}
        # heyoka's time starts at zero in every arc, so that late arcs lose no digits.
        self._factors[tape.n_variables] = None, hy.time + hy.par[0]
        self._factors |= {i: (i, None) for i in range(tape.n_variables + 1, self._end)}
        for register, (op, left, right) in enumerate(tape.code[begin:].tolist(), self._end):
            name, operation = _BY_CODE[op]
            if operation is None:
                raise Unsupported(
                    f"the Taylor engine cannot expand {name}() in a flow; use engine: scipy"
                )
            if folds and op in (MUL, DIV):
                self._factors[register] = self._product(op, left, right)
                continue
            values = [self._value(operand) for operand in ((left, right) if op <= POW else (left,))]
            if op == POWI:
                values.append(right)
            elif op == POW and right in numbers:
                values[1] = numbers[right]
            self._factors[register] = None, operation(*values)
        self.expressions = tuple(map(self._value, tape.outputs.tolist()))

    def _product(self, op: int, left: int, right: int) -> tuple[int | None, Any]:
        """Return the factors of a product or quotient."""
        (factor, value), (other, by) = self._factors[left], self._factors[right]
        if factor is None and op == MUL:
            factor = other
        elif other is not None:
            operation = (POWI, other, -1) if factor is None else (op, factor, other)
            factor = self._joined.setdefault(operation, self._end + len(self._joined))
        if by is not None:
            one = 1.0 if value is None else value
            value = one * by if op == MUL else one / by
        return factor, value

    def _value(self, register: int) -> Any:
        factor, value = self._factors[register]
        if factor is None:
            return value
        parameter = self._passed.setdefault(factor, hy.par[len(self._passed) + 1])
        return parameter if value is None else parameter * value

    def fixed(self, count: int) -> Tape:
        """Return the tape of the first `count` parameters after the time."""
        tape, outputs = self._tape, np.array([*self._passed][:count], np.int32)
        joined = np.array([*self._joined], np.int32).reshape(-1, 3)
        code = np.concatenate([tape.code[: tape.n_fixed], joined])
        return replace(tape, code=code, outputs=outputs, n_fixed=len(code))
