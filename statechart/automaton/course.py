"""Which way a margin goes on from an instant, by the first of its derivatives that is not zero."""

from __future__ import annotations

import math
from collections.abc import Sequence
from weakref import WeakKeyDictionary

import sympy as sp

from statechart.arrays import Array
from statechart.automaton.laws import Setup
from statechart.automaton.regions import Mode
from statechart.automaton.trace import Roles
from statechart.formulas.determinants import Singular
from statechart.formulas.series import Series, expand
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape

# Derivatives up to this order are looked at; a margin that has none there stays where it is.
_ORDERS = 12


class Courses:
    """The margins of modes, expanded in time where a mode is entered.

    Parameters
    ----------
    variables, parameters : sequence of Symbol
        What the modes depend on.
    time : Symbol
        Time.
    """

    def __init__(
        self, variables: Sequence[sp.Symbol], parameters: Sequence[sp.Symbol], time: sp.Symbol
    ) -> None:
        self._variables, self._parameters, self._time = variables, parameters, time
        self._tapes: WeakKeyDictionary[Mode, dict[str, tuple[list[int], bool, Tape]]]
        self._tapes = WeakKeyDictionary()

    def sign(
        self,
        setup: Setup,
        roles: Roles,
        margin: str,
        state: Array,
        sizes: Array,
        time: float,
        relative: float,
    ) -> float:
        """Return the sign of the first derivative that is not zero; 0.0 where all are.

        Parameters
        ----------
        setup : Setup
            The numbers of the run.
        roles : Roles
            The mode whose equations apply.
        margin : str
            Name of one of its margins.
        state, sizes : (n,) array
            Where the mode is entered, and how large the terms of each variable are.
        time : float
            When.
        relative : float
            Derivatives this small relative to their terms are zero.

        Returns
        -------
        float
            Not a number where the derivatives have no value.
        """
        assert setup.modes is not None
        try:
            mode = setup.modes(roles)
        except Singular:
            return math.nan
        moving, timed, tape = self._tape(mode, margin)
        series = [
            Series([x], [max(abs(x), size)])
            for x, size in zip(state.tolist(), sizes.tolist(), strict=True)
        ]
        parameters = setup.values.tolist()
        for order in range(_ORDERS + 1):
            *rates, found = expand(tape, series, parameters, time)
            value, size = found.values[order], found.sizes[order]
            if order > 0 and not abs(value) <= relative * size:
                return math.copysign(1.0, value) if math.isfinite(value) else math.nan
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
        return 0.0

    def _tape(self, mode: Mode, margin: str) -> tuple[list[int], bool, Tape]:
        """Return which variables a margin depends on, whether on time, their rates and it."""
        tapes = self._tapes.setdefault(mode, {})
        if margin not in tapes:
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
            tapes[margin] = (
                moving,
                self._time in used,
                compile_tape(
                    [*(mode.rates[i] for i in moving), expression],
                    variables=self._variables,
                    parameters=self._parameters,
                    time=self._time,
                    definitions=mode.definitions,
                ),
            )
        return tapes[margin]
