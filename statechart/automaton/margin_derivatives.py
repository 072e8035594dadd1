"""Sign of a margin after an instant: its first nonzero time derivative."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
import sympy as sp
from numpy.polynomial.polynomial import polyval

from statechart.arrays import Array
from statechart.automaton.laws import Setup
from statechart.automaton.regions import Mode
from statechart.automaton.trace import Roles
from statechart.formulas.linear import Singular
from statechart.formulas.series import Series, expand
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape

UNDERFLOW = 1e-290
"""Round-off of zero terms: with tolerance zero, a margin that starts at zero with slope zero would
be undecided."""
_MAX_ORDER = 12  # of derivatives; if all vanish, the margin is constant
# If derivatives are undefined, as of sqrt(time) at 0, or jump at a kink, the sign is that of the
# margin at both these times after the instant, relative to the horizon.
_LATER = (2.0**-20, 2.0**-40)


class MarginDerivatives:
    """Taylor expansions of margins at the entry of a mode."""

    def __init__(
        self, variables: Sequence[sp.Symbol], parameters: Sequence[sp.Symbol], time: sp.Symbol
    ) -> None:
        self._variables, self._parameters, self._time = variables, parameters, time
        self._tapes: WeakKeyDictionary[
            Mode, dict[str | sp.Expr, tuple[list[int], bool, bool, Tape]]
        ]
        self._tapes = WeakKeyDictionary()

    def sign(
        self,
        setup: Setup,
        roles: Roles,
        margin: str | sp.Expr,
        state: Array,
        sizes: Array,
        time: float,
        relative: float,
    ) -> float:
        """Return the sign of the first nonzero derivative; 0.0 if all vanish.

        `margin` is the name of a margin of the mode of `roles`, or an expression of the variables,
        parameters and time. The mode is entered in `state` (n,) with terms of `sizes` (n,).
        Derivatives below `relative` times their terms are zero. NaN if neither derivatives nor
        later values determine the sign.
        """
        assert setup.modes is not None
        try:
            mode = setup.modes(roles)
        except Singular:
            return math.nan
        moving, timed, smooth, tape = self._tape(mode, margin)
        series = [
            Series([x], [max(abs(x), size)])
            for x, size in zip(state.tolist(), sizes.tolist(), strict=True)
        ]
        parameters = setup.values.tolist()
        for order in range(_MAX_ORDER + 1):
            *rates, derivative = expand(tape, series, parameters, time)
            value, size = derivative.values[order], derivative.sizes[order]
            if order > 0 and not abs(value) <= relative * size:
                if smooth and math.isfinite(value):
                    return math.copysign(1.0, value)
                smooth = False
            if not all(math.isfinite(rate.values[order]) for rate in rates):
                break
            rests = not timed
            for place, rate in zip(moving, rates, strict=True):
                value, size = rate.values[order] / (order + 1), rate.sizes[order] / (order + 1)
                rests &= abs(value) <= relative * size
                series[place].values.append(value)
                series[place].sizes.append(size)
            if order == 0 and rests:
                return 0.0
            for place, grown in enumerate(series):
                if len(grown.values) < order + 2:
                    series[place].values.append(0.0)
                    series[place].sizes.append(0.0)
        if smooth:
            return 0.0
        horizon = setup.horizon if math.isfinite(setup.horizon) else 1.0
        later = []
        for part in _LATER:
            increments = np.array([polyval(part * horizon, grown.values) for grown in series])
            later.append(tape.at(increments, setup.values, time + part * horizon)[-1].item())
        signs = {float(np.sign(value)) for value in later}
        return signs.pop() if len(signs) == 1 else math.nan

    def _tape(self, mode: Mode, margin: str | sp.Expr) -> tuple[list[int], bool, bool, Tape]:
        """Return the variables of a margin, whether it is timed and smooth, and the rates' tape."""
        tapes = self._tapes.setdefault(mode, {})
        if margin not in tapes:
            expression: sp.Expr = margin
            if isinstance(margin, str):
                expression = next(m.expression for m in mode.margins if m.name == margin)
            rates = dict(zip(self._variables, mode.rates, strict=True))
            follows = {**rates, **dict(mode.definitions)}
            used: set[sp.Basic] = set()
            queue = [expression]
            while queue:
                new = queue.pop().free_symbols - used
                used |= new
                queue += [follows[symbol] for symbol in new if symbol in follows]
            moving = [i for i, v in enumerate(self._variables) if v in used and rates[v] != 0]
            smooth = not expression.has(sp.Abs, sp.sign, sp.Min, sp.Max)
            tape = compile_tape(
                [*(mode.rates[i] for i in moving), expression], variables=self._variables,
                parameters=self._parameters, time=self._time, definitions=mode.definitions,
            )  # fmt: skip
            tapes[margin] = moving, self._time in used, smooth, tape
        return tapes[margin]


def rounding_scale(expression: sp.Expr, sizes: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    """Return the size of the terms of an expression, the scale of its round-off."""
    if not expression.args:
        return sizes.get(expression, abs(expression))
    # Exponents and numeric factors are exact.
    parts = [part for part in expression.args if not part.is_Number]
    if isinstance(expression, sp.Add | sp.Abs | sp.Min | sp.Max):
        return sp.Add(
            *(rounding_scale(part, sizes) for part in parts), *map(abs, _coefficients(expression))
        )
    if expression.is_Mul and len(parts) == 1:
        slope = abs(sp.Mul(*_coefficients(expression)))
        return sp.Add(abs(expression), slope * rounding_scale(parts[0], sizes))
    slots = {part: sp.Dummy(real=True) for part in parts}
    form = expression.func(*(slots.get(part, part) for part in expression.args))
    whole = {slot: part for part, slot in slots.items()}
    changes = (
        abs(derivative(form, slot).xreplace(whole)) * rounding_scale(part, sizes)
        for part, slot in slots.items()
    )
    return sp.Add(abs(expression), *changes)


def time_derivative(
    expression: sp.Expr, rates: Mapping[sp.Symbol, sp.Expr], time: sp.Symbol
) -> sp.Expr:
    """Return the total time derivative of an expression."""
    moving = (v for v in rates if v in expression.free_symbols)
    terms = (derivative(expression, v) * rates[v] for v in moving)
    return sp.Add(derivative(expression, time), *terms)


def _coefficients(expression: sp.Expr) -> list[sp.Expr]:
    return [part for part in expression.args if part.is_Number]


def derivative(expression: sp.Expr, symbol: sp.Symbol) -> sp.Expr:
    """Differentiate; at kinks of abs, sign, min and max one-sided, or the mean.

    SymPy does so only for provably real arguments, which roots are not.
    """
    nonsmooth = expression.atoms(sp.Abs, sp.sign, sp.Min, sp.Max)
    kinks = {node: sp.Dummy(real=True) for node in nonsmooth if symbol in node.free_symbols}
    if not kinks:
        return sp.diff(expression, symbol)
    if expression not in kinks:
        form = expression.xreplace(kinks)
        inner = {dummy: node for node, dummy in kinks.items()}
        found = sp.diff(form, symbol)
        for dummy, node in inner.items():
            if dummy in form.free_symbols:
                found += sp.diff(form, dummy) * derivative(node, symbol)
        return found.xreplace(inner)
    if isinstance(expression, sp.sign):
        return sp.S.Zero
    first, *other_factors = expression.args
    if isinstance(expression, sp.Abs):
        return sp.sign(first) * derivative(first, symbol)
    remainder = expression.func(*other_factors)
    side = sp.sign(first - remainder if isinstance(expression, sp.Max) else remainder - first)
    return ((1 + side) * derivative(first, symbol) + (1 - side) * derivative(remainder, symbol)) / 2


@lru_cache(4096)
def tape_with_sizes(
    expressions: tuple[sp.Expr, ...],
    inputs: tuple[sp.Symbol, ...],
    parameters: tuple[sp.Symbol, ...],
    time: sp.Symbol,
) -> Tape:
    """Compile expressions and then the sizes of their terms, in inputs and then their sizes."""
    sizes = {v: sp.Symbol(f"size_{v.name}", real=True) for v in inputs}
    outputs = [*expressions, *(rounding_scale(one, sizes) for one in expressions)]
    variables = (*inputs, *sizes.values())
    return compile_tape(outputs, variables=variables, parameters=parameters, time=time)
