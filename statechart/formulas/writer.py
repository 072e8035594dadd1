"""Compiler of SymPy expressions to tapes, with shared subexpressions and constant folding."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial, reduce

import numpy as np
import sympy as sp
from sympy.core.sorting import default_sort_key, ordered
from sympy.printing.str import StrPrinter

from statechart.errors import DeclarationError, StatechartError
from statechart.formulas.linear import free_symbols
from statechart.formulas.tape import Tape
from statechart.kernels.tapes import OPCODES, tape_values
from statechart.kernels.tolerant_floor import tolerant_floor


class Whole(sp.Function):
    """Floor of a formula, unevaluated; SymPy's floor evaluates rounded numbers."""

    is_extended_real = True

    @classmethod
    def eval(cls, of: sp.Expr) -> sp.Expr | None:
        """Return the floor of a number; other arguments stay unevaluated."""
        return sp.Integer(tolerant_floor(float(of))) if of.is_number and of.is_finite else None

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Return the derivative between two jumps."""
        return sp.S.Zero


class Difference(sp.Function):
    """A difference evaluated as written: exactly zero for equal sides."""

    is_extended_real = True

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Return the derivative with respect to one side."""
        return sp.S.One if argindex == 1 else sp.S.NegativeOne


class _Extremum:
    """Extremum without the terms that a sign of a difference excludes.

    SymPy also factors all differences: two fifths of the time of scenes gated by states.
    """

    @classmethod
    def _collapse_arguments(cls, args: Iterable[sp.Expr], **_: object) -> list[sp.Expr]:
        return list(ordered(args))

    @classmethod
    def _is_connected(cls, x: sp.Expr, y: sp.Expr) -> type | bool:
        difference = x - y
        if difference.is_extended_nonnegative:
            return Max
        return Min if difference.is_extended_nonpositive else False


class Max(_Extremum, sp.Max):
    """Largest of expressions."""


class Min(_Extremum, sp.Min):
    """Least of expressions."""


class _FormulaPrinter(StrPrinter):
    """Prints functions by the names that formulas of documents use."""

    def _print_Function(self, node: sp.Expr) -> str:  # noqa: N802
        return f"{_UNARY.get(node.func, node.func.__name__)}({self.stringify(node.args, ', ')})"

    def _print_Abs(self, node: sp.Expr) -> str:  # noqa: N802
        return f"abs({self._print(node.args[0])})"

    def _print_LatticeOp(self, node: sp.Expr) -> str:  # noqa: N802
        arguments = sorted(node.args, key=default_sort_key)
        return f"{node.func.__name__.lower()}({self.stringify(arguments, ', ')})"


def to_text(expression: sp.Expr, **settings: object) -> str:
    """Return an expression in the notation of documents: ``sqrt(abs(h))``."""
    return str(_FormulaPrinter(settings).doprint(expression))


_NAMED_ALIKE = (
    "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "sign"
)  # fmt: skip
_UNARY: dict[type[sp.Basic], str] = {getattr(sp, name): name for name in _NAMED_ALIKE}
_UNARY |= {sp.Abs: "abs", Whole: "floor"}
# SymPy introduces these itself, as for tan(x + pi/2); formulas contain the last.
_RECIPROCAL = {sp.cot: "tan", sp.sec: "cos", sp.csc: "sin", sp.sech: "cosh"}
# Smaller factors, or larger ones than the inverse, may overflow with an exponential.
_MIN_FACTOR = 1e-60
# Correctly rounded on every processor. Most constants need no others, and loading the kernel takes
# as long as composing a scene.
_ROUNDED_ALIKE: dict[int, Callable[[float, float], float]] = {
    OPCODES["add"]: operator.add,
    OPCODES["sub"]: operator.sub,
    OPCODES["mul"]: operator.mul,
    OPCODES["div"]: operator.truediv,
    OPCODES["neg"]: lambda a, _: -a,
    OPCODES["square"]: lambda a, _: a * a,
}
_COMMUTATIVE = {OPCODES[name] for name in ("add", "mul", "min", "max", "hypot")}


def compile_tape(
    outputs: Sequence[sp.Expr],
    *,
    variables: Sequence[sp.Symbol],
    parameters: Sequence[sp.Symbol],
    time: sp.Symbol,
    definitions: Sequence[tuple[sp.Symbol, sp.Expr]] = (),
) -> Tape:
    """Compile expressions in variables, parameters and time to a tape.

    `definitions` are named intermediate results, each in terms of earlier ones; unused ones are
    dropped. Raises `StatechartError` for an unknown or repeated symbol, a function without an
    operation, or a constant that is not a finite real number, `DeclarationError` if it overflows.
    """
    inputs = [*variables, time, *parameters]
    names = [*inputs, *(symbol for symbol, _ in definitions)]
    if len(set(names)) != len(names):
        twice = sorted({str(s) for s in names if names.count(s) > 1})
        raise StatechartError(f"symbols are given twice: {', '.join(twice)}; rename one of each")
    needed: set[sp.Symbol] = set().union(*map(free_symbols, map(sp.sympify, outputs)))
    for symbol, expression in reversed(definitions):
        if symbol in needed:
            needed |= free_symbols(expression)
    writer = _Writer(inputs)
    for symbol, expression in definitions:
        if symbol in needed:
            writer.registers[symbol] = writer.insert(expression)
    registers = [writer.insert(sp.sympify(expression)) for expression in outputs]
    return writer.finish(registers, len(variables), len(parameters))


@lru_cache(1 << 13)
def _written(
    expression: sp.Expr,
) -> tuple[list[sp.Symbol], list[float], list[tuple[int, int, int]], int]:
    """Return inputs, constants, operations and register of an expression; modes share most."""
    writer = _Writer(sorted(free_symbols(expression), key=operator.attrgetter("name")))
    register = writer.register(expression)
    return writer.inputs, [*writer.constants], writer.operations, register


@dataclass
class _Writer:
    """Emits operations by value numbering.

    Registers are inputs, constants (~0, ~1, ... until their number is known) and operations;
    `finish` assigns their final numbers.
    """

    inputs: list[sp.Symbol]
    registers: dict[sp.Basic, int] = field(default_factory=dict)
    constants: dict[float, int] = field(default_factory=dict)
    operations: list[tuple[int, int, int]] = field(default_factory=list)
    places: dict[tuple[int, int, int], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.registers.update({symbol: k for k, symbol in enumerate(self.inputs)})

    def insert(self, node: sp.Expr) -> int:
        """Return the register of an expression, with operations from the cache."""
        if not node.args:
            return self.register(node)
        inputs, constants, operations, output = _written(node)
        found = {k: self.register(symbol) for k, symbol in enumerate(inputs)}
        found |= {~k: self._constant(number) for k, number in enumerate(constants)}
        for place, (op, left, right) in enumerate(operations, start=len(inputs)):
            right = found[right] if op <= OPCODES["pow"] else right
            found[place] = self._place(op, found[left], right)
        return found[output]

    def register(self, node: sp.Expr) -> int:
        """Return the register of an expression."""
        if node.is_Float:  # A look-up would hash it, which takes longer.
            return self._constant(node)
        found = self.registers.get(node)
        if found is None:
            found = self.registers[node] = self._write(node)
        return found

    def _write(self, node: sp.Expr) -> int:
        if node.is_Symbol:
            raise StatechartError(
                f"the symbol {node} is neither a variable, a parameter nor defined before its use"
            )
        if node.is_Number or node.is_NumberSymbol:
            if isinstance(node, sp.Rational) and sp.Rational(float(node)) != node:
                return self._emit("div", self._constant(node.p), self._constant(node.q))
            return self._constant(node)
        if node.is_Add:
            return self._sum(node)
        if node.is_Mul:
            return self._product(node)
        if node.is_Pow:
            return self._power(node)
        kind = type(node)
        if kind is sp.DiracDelta:
            # The derivative of sign where it exists.
            return self._constant(0.0)
        if kind in _UNARY:
            return self._emit(_UNARY[kind], self.register(node.args[0]))
        if kind in _RECIPROCAL:
            below = self._emit(_RECIPROCAL[kind], self.register(node.args[0]))
            return self._emit("div", self._constant(1.0), below)
        if kind is Difference:
            return self._fold("sub", [self.register(side) for side in node.args])
        if kind.__name__ in ("Min", "Max", "atan2", "hypot"):
            return self._fold(kind.__name__.lower(), [self.register(a) for a in node.args])
        where = f"{kind.__name__} in {to_text(node)[:80]}"
        raise StatechartError(f"{where} has no operation; there are {', '.join(OPCODES)}")

    def _sum(self, node: sp.Expr) -> int:
        plus, minus = _signed(node)
        if not plus:
            return self._emit("neg", self._fold("add", [self.register(term) for term in minus]))
        total = self._fold("add", [self.register(term) for term in plus])
        return self._fold("sub", [total, *(self.register(term) for term in minus)])

    def _product(self, node: sp.Expr) -> int:
        number, factors = node.as_coeff_mul()
        factors, exponent = _join_exponentials(_join_powers(factors))
        above: list[int] = []
        below: list[int] = []
        if exponent is not None:
            above.append(self._emit("exp", self.register(exponent)))
        for factor in factors:
            if factor.is_Pow and factor.exp.is_Number and factor.exp.is_negative:
                below.append(self.register(sp.Pow(factor.base, -factor.exp)))
            else:
                above.append(self.register(factor))
        if isinstance(number, sp.Rational) and sp.Rational(float(number)) != number:
            below.insert(0, self._constant(number.q))
            number = sp.Integer(number.p)
        negate = number == -1
        if not (negate or number == 1) or not above:
            above.insert(0, self._constant(abs(number) if negate else number))
        result = self._fold("mul", above)
        if below:
            result = self._emit("div", result, self._fold("mul", below))
        return self._emit("neg", result) if negate else result

    def _power(self, node: sp.Expr) -> int:
        base, exponent = node.base, node.exp
        if base is sp.E:
            return self._emit("exp", self.register(exponent))
        if exponent.is_Number and exponent.is_negative:
            return self._emit("div", self._constant(1.0), self.register(sp.Pow(base, -exponent)))
        if isinstance(exponent, sp.Rational) and exponent.q in (1, 2) and exponent.p < 2**31:
            if exponent.q == 1:
                return self._integer_power(self.register(base), int(exponent))
            sides = _sides(base)
            operation = "hypot" if sides else "sqrt"
            root = self._emit(operation, *map(self.register, sides or [base]))
            return self._integer_power(root, int(exponent.p))
        return self._emit("pow", self.register(base), self.register(exponent))

    def _integer_power(self, base: int, exponent: int) -> int:
        if exponent == 1:
            return base
        return self._emit("square", base) if exponent == 2 else self._emit("powi", base, exponent)

    def _fold(self, name: str, registers: list[int]) -> int:
        return reduce(partial(self._emit, name), registers)

    def _constant(self, number: sp.Expr | float) -> int:
        try:
            value = float(number)
        except OverflowError:
            value = math.inf
        except TypeError:
            value = math.nan
        if math.isinf(value) and sp.sympify(number).is_finite:
            constant = f"the constant {sp.N(number, 7)}, which is too large for a float"
            message = f"numbers of the model give {constant}"
            raise DeclarationError(message, advice="take larger units")
        if not math.isfinite(value):
            message = f"the constant {to_text(number)[:80]} is not a finite real number"
            raise StatechartError(f"{message}; make it a parameter or remove it")
        return ~self.constants.setdefault(value, len(self.constants))

    def _emit(self, name: str, left: int, right: int = 0) -> int:
        return self._place(OPCODES[name], left, right)

    def _place(self, op: int, left: int, right: int) -> int:
        if op in _COMMUTATIVE and right < left:
            left, right = right, left
        if left < 0 and (right < 0 or op > OPCODES["pow"]):
            return self._constant(self._evaluate(op, left, right))
        key = (op, left, right)
        if key not in self.places:
            self.places[key] = len(self.inputs) + len(self.operations)
            self.operations.append(key)
        return self.places[key]

    def _evaluate(self, op: int, left: int, right: int) -> float:
        """Fold an operation on constants, bit for bit as the kernel."""
        binary = op <= OPCODES["pow"]
        numbers = [*self.constants]
        constants = [numbers[~left], numbers[~right] if binary else 0.0]
        with suppress(ZeroDivisionError):
            if op in _ROUNDED_ALIKE:
                return float(_ROUNDED_ALIKE[op](*constants))
        code = np.array([[op, 1, 2 if binary else right]], dtype=np.int32)
        nothing = np.empty(0)
        outputs = np.array([3], dtype=np.int32)
        result = np.empty(1)
        tape_values(code, np.array(constants), outputs, nothing, nothing, 0.0, result)
        return result.item()

    def finish(self, outputs: list[int], n_variables: int, n_parameters: int) -> Tape:
        """Assign register numbers, operations on parameters and constants first."""
        n_inputs = len(self.inputs)
        fixed: dict[int, bool] = {k: k > n_variables for k in range(n_inputs)}
        for place, (op, left, right) in enumerate(self.operations, start=n_inputs):
            pair = [left, right] if op <= OPCODES["pow"] else [left]
            fixed[place] = all(r < 0 or fixed[r] for r in pair)
        places = range(n_inputs, n_inputs + len(self.operations))
        order = sorted(places, key=lambda place: not fixed[place])
        base = n_inputs + len(self.constants)
        final = {place: base + k for k, place in enumerate(order)}
        final.update({k: k for k in range(n_inputs)})
        final.update({~k: n_inputs + k for k in range(len(self.constants))})
        operations = [self.operations[place - n_inputs] for place in order]
        rows = [
            (op, final[left], final[right] if op <= OPCODES["pow"] else right)
            for op, left, right in operations
        ]
        code = np.array(rows, dtype=np.int32).reshape(-1, 3)
        registers = np.array([final[r] for r in outputs], dtype=np.int32)
        used = set(registers.tolist()) | set(code[:, 1].tolist())
        used |= set(code[code[:, 0] <= OPCODES["pow"], 2].tolist())
        return Tape(
            code=code,
            constants=np.array([*self.constants], dtype=np.float64),
            outputs=registers,
            n_variables=n_variables,
            n_parameters=n_parameters,
            n_fixed=sum(fixed[place] for place in places),
            reads=np.array(sorted(r for r in used if r <= n_variables), dtype=np.int32),
        )


@lru_cache(1 << 14)
def _signed(node: sp.Expr) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Return the added and the subtracted terms of a sum, without signs.

    Cached, since this takes longest and modes share most sums.
    """
    negative = [term.as_coeff_Mul()[0].is_negative for term in node.args]
    pairs = list(zip(node.args, negative, strict=True))
    return [term for term, sign in pairs if not sign], [-term for term, sign in pairs if sign]


def _join_powers(factors: Sequence[sp.Expr]) -> Sequence[sp.Expr]:
    """Return factors with ``x**n / x``, of SymPy derivatives, as ``x**(n - 1)``, valid at x = 0."""
    bases = {factor.base for factor in factors if factor.is_Pow and not factor.exp.is_Number}
    if not bases:
        return factors
    exponents: dict[sp.Expr, sp.Expr] = {}
    for factor in factors:
        base, exponent = factor.as_base_exp() if factor.is_Pow else (factor, sp.S.One)
        exponents[base] = exponents.get(base, sp.S.Zero) + exponent
    return [sp.Pow(base, exponent) for base, exponent in exponents.items()]


def _join_exponentials(factors: Sequence[sp.Expr]) -> tuple[Sequence[sp.Expr], sp.Expr | None]:
    """Join a number that over- or underflows with an exponential factor.

    SymPy splits exp(x + 3000.0) into two exponentials, the first of which overflows. Returns the
    remaining factors, and the joined exponent or None.
    """
    exponentials = [factor for factor in factors if isinstance(factor, sp.exp)]
    floats = [f for f in factors if exponentials and f.is_Float and f]
    numbers = [f for f in floats if not _MIN_FACTOR < abs(f) < 1 / _MIN_FACTOR]
    if not numbers:
        return factors, None
    number, first = numbers[0], exponentials[0]
    left = [factor for factor in factors if factor is not number and factor is not first]
    return [*left, sp.sign(number)], first.args[0] + sp.log(abs(number))


def _sides(square: sp.Expr) -> tuple[sp.Expr, sp.Expr] | None:
    """Return a and b of a**2 + b**2, for `hypot`."""
    if not square.is_Add or len(square.args) != 2:
        return None
    sides = []
    for term in square.args:
        if term is sp.S.One:
            sides.append(term)
        elif term.is_Pow and term.exp == 2:
            sides.append(term.base)
        else:
            return None
    return sides[0], sides[1]
