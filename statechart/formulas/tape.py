"""Expressions as straight-line programs: what guards and outputs are evaluated from.

A tape has registers in the order variables, time, parameters, constants, results of its
operations; each operation names two registers. It is plain data, interpreted by the one set of
kernels in `statechart.kernels`, so a new model costs no compilation, and the same program gives
float values and rigorous enclosures. Shared subexpressions are computed once; operations that
read only parameters and constants stand first and are run once a call, not once a point.

Constants are float64 numbers and exact by definition: 1/3 is divided at run time, pi is rounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.tapes import POW, TapeCode, tape_table, tape_values


def contiguous(array: ArrayLike) -> Array:
    """Return the array as the kernels want it: float64, contiguous, aligned, writeable.

    Any other kind of array would be another type to numba, and compiled for once more.
    """
    result = np.ascontiguousarray(array, dtype=np.float64)
    return result if result.flags.carray else np.array(result, order="C")


@dataclass(frozen=True, eq=False)
class Tape:
    """A straight-line program for a list of outputs."""

    # Operation (`statechart.kernels.tapes.OPCODES`), left register, right register. One operand:
    # the right is 0; an integer power: the exponent.
    code: Ints32
    constants: Array  # numbers of the expressions
    outputs: Ints32  # registers of the outputs
    n_variables: int  # length of a state and of the parameters
    n_parameters: int
    n_fixed: int  # number of leading operations that read only parameters and constants
    reads: Ints32  # variables that are read at all; `n_variables` stands for the time

    @cached_property
    def program(self) -> tuple[Ints32, Array, Ints32]:
        """Code, constants and outputs, as kernels take them."""
        return self.code, self.constants, self.outputs

    @cached_property
    def parts(self) -> TapeCode:
        """The tape as kernels take it that run it along steps."""
        return TapeCode(self.code, self.constants, self.outputs, self.reads, self.n_fixed)

    def values(self, state: ArrayLike, parameters: ArrayLike, time: float) -> Array:
        """Return the outputs at one point.

        Raises `ValueError` if a shape does not fit.
        """
        state, parameters = contiguous(state), contiguous(parameters)
        if state.shape != (self.n_variables,):
            raise ValueError(f"the state has shape {state.shape}, not ({self.n_variables},)")
        self.require(parameters)
        return self.at(state, parameters, float(time))

    def at(self, state: Array, parameters: Array, time: float) -> Array:
        """Return `values` for arrays that are float64, contiguous and of the right length.

        For inner loops: nothing is checked, and a wrong shape reads beyond the arrays.
        """
        result = np.empty(len(self.outputs))
        tape_values(*self.program, state, parameters, time, result)
        return result

    def table(self, states: ArrayLike, parameters: ArrayLike, times: ArrayLike) -> Array:
        """Return the outputs at many points.

        Raises `ValueError` if a shape does not fit.
        """
        states, parameters, times = contiguous(states), contiguous(parameters), contiguous(times)
        if times.ndim != 1 or states.shape != (len(times), self.n_variables):
            raise ValueError(
                f"states and times have shapes {states.shape} and {times.shape}, "
                f"not (m, {self.n_variables}) and (m,)"
            )
        self.require(parameters)
        return tape_table(
            self.code, self.constants, self.outputs, self.n_fixed, states, parameters, times
        )

    def coloured_sparsity(self, variables: int) -> tuple[Ints, Ints, Ints]:
        """Return outputs and which of the first variables they read, and a colour of each of these.

        No output reads two variables of one colour. The arrays (k,) have a row for every pair.
        """
        if variables not in self._colourings:
            self._colourings[variables] = _coloured(self._read_by_outputs(variables), variables)
        return self._colourings[variables]

    @cached_property
    def _colourings(self) -> dict[int, tuple[Ints, Ints, Ints]]:
        return {}

    def needed(self, places: tuple[int, ...]) -> list[tuple[int, int, int, int]]:
        """Return the operations that outputs at these places need: result and code of each."""
        if places not in self._needed:
            base = self.n_variables + 1 + self.n_parameters + len(self.constants)
            wanted, operations = {self.outputs.item(place) for place in places}, []
            for result in range(base + len(self.code) - 1, base - 1, -1):
                if result in wanted:
                    op, left, right = self.code[result - base].tolist()
                    wanted |= {left, right} if op <= POW else {left}
                    operations.append((result, op, left, right))
            self._needed[places] = operations[::-1]
        return self._needed[places]

    @cached_property
    def _needed(self) -> dict[tuple[int, ...], list[tuple[int, int, int, int]]]:
        return {}

    def _read_by_outputs(self, variables: int) -> list[list[int]]:
        """Return the variables, of the first ones, that each output may change with."""
        base = self.n_variables + 1 + self.n_parameters + len(self.constants)
        none: frozenset[int] = frozenset()
        found = [frozenset((i,)) for i in range(variables)] + [none] * (base - variables)
        for op, left, right in self.code.tolist():
            other = found[right] if op <= POW else none
            found.append(found[left] | other if other - found[left] else found[left])
        return [sorted(found[i]) for i in self.outputs.tolist()]

    def require(self, parameters: Array) -> None:
        """Raise `ValueError` if the parameters are not as many as the tape has."""
        if parameters.shape != (self.n_parameters,):
            raise ValueError(
                f"the parameters have shape {parameters.shape}, not ({self.n_parameters},)"
            )


def _coloured(reads: list[list[int]], variables: int) -> tuple[Ints, Ints, Ints]:
    """Return pairs of a row and a column, and colours of columns, different within every row."""
    readers: list[list[int]] = [[] for _ in range(variables)]
    for output, columns in enumerate(reads):
        for variable in columns:
            readers[variable].append(output)
    used_colours: list[set[int]] = [set() for _ in reads]
    colours = [0] * variables
    for variable, outputs in enumerate(readers):
        while any(colours[variable] in used_colours[output] for output in outputs):
            colours[variable] += 1
        for output in outputs:
            used_colours[output].add(colours[variable])
    pairs = [(output, variable) for output, columns in enumerate(reads) for variable in columns]
    rows, read = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return rows, read, np.array(colours, dtype=np.int64)[read]
