"""Tapes: expressions as straight-line programs.

Registers of a tape are variables, time, parameters, constants, and results of its operations; an
operation has two registers. The kernels in `statechart.kernels` interpret tapes, so that a new
model needs no compilation, and one program gives float values and rigorous enclosures. Common
subexpressions are shared. Operations on parameters and constants come first, and run once per call.

Constants are exact float64 numbers: 1/3 is divided at run time, pi is rounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike

from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.tapes import POW, TapeCode, tape_table, tape_values


def contiguous(array: ArrayLike) -> Array:
    """Return a float64 array, contiguous, aligned, writeable: the only type compiled by numba."""
    result = np.ascontiguousarray(array, dtype=np.float64)
    return result if result.flags.carray else np.array(result, order="C")


@dataclass(frozen=True, eq=False)
class Tape:
    """A straight-line program for a list of outputs."""

    # (o, 3): opcode (`statechart.kernels.tapes.OPCODES`), left and right register; the right is 0
    # for one operand, the exponent for integer powers.
    code: Ints32
    constants: Array
    outputs: Ints32  # registers
    n_variables: int
    n_parameters: int
    n_fixed: int  # leading operations on parameters and constants only
    reads: Ints32  # variables read; `n_variables` is the time

    @cached_property
    def program(self) -> tuple[Ints32, Array, Ints32]:
        """Code, constants and outputs for kernels."""
        return self.code, self.constants, self.outputs

    @cached_property
    def parts(self) -> TapeCode:
        """The tape for kernels that evaluate it along steps."""
        return TapeCode(self.code, self.constants, self.outputs, self.reads, self.n_fixed)

    def values(self, state: ArrayLike, parameters: ArrayLike, time: float) -> Array:
        """Return the outputs at one point; raise `ValueError` for a wrong shape."""
        state, parameters = contiguous(state), contiguous(parameters)
        if state.shape != (self.n_variables,):
            raise ValueError(f"the state has shape {state.shape}, not ({self.n_variables},)")
        self.require(parameters)
        return self.at(state, parameters, float(time))

    def at(self, state: Array, parameters: Array, time: float) -> Array:
        """Return `values` without checks: a wrong shape reads beyond the arrays."""
        result = np.empty(len(self.outputs))
        tape_values(*self.program, state, parameters, time, result)
        return result

    def table(self, states: ArrayLike, parameters: ArrayLike, times: ArrayLike) -> Array:
        """Return the outputs (m, o) at many points; raise `ValueError` for a wrong shape."""
        states, parameters, times = contiguous(states), contiguous(parameters), contiguous(times)
        if times.ndim != 1 or states.shape != (len(times), self.n_variables):
            raise ValueError(
                f"states and times have shapes {states.shape} and {times.shape}, "
                f"not (m, {self.n_variables}) and (m,)"
            )
        self.require(parameters)
        return tape_table(*self.program, self.n_fixed, states, parameters, times)

    @property
    def varying(self) -> list[bool]:
        """True for each output that depends on variables or time."""
        first = self.n_variables + 1 + self.n_parameters + len(self.constants) + self.n_fixed
        return [place <= self.n_variables or place >= first for place in self.outputs.tolist()]

    @cached_property
    def coloured_sparsity(self) -> Callable[[int], tuple[Ints, Ints, Ints]]:
        """Function of a number of variables: sparsity of the Jacobian with a column colouring.

        Arrays (k,): output, variable, colour of the variable. No output reads two variables of one
        colour.
        """
        return cache(lambda variables: _colour_columns(self._read_by_outputs(variables), variables))

    @cached_property
    def needed(self) -> Callable[[tuple[int, ...]], list[tuple[int, int, int, int]]]:
        """Function of places: the operations (result and code) that outputs there need."""
        return cache(self._operations)

    def _operations(self, places: tuple[int, ...]) -> list[tuple[int, int, int, int]]:
        base = self.n_variables + 1 + self.n_parameters + len(self.constants)
        wanted, operations = {self.outputs.item(place) for place in places}, []
        for result in range(base + len(self.code) - 1, base - 1, -1):
            if result in wanted:
                op, left, right = self.code[result - base].tolist()
                wanted |= {left, right} if op <= POW else {left}
                operations.append((result, op, left, right))
        return operations[::-1]

    def _read_by_outputs(self, variables: int) -> list[list[int]]:
        """Return the variables, of the first ones, that each output depends on."""
        base = self.n_variables + 1 + self.n_parameters + len(self.constants)
        none: frozenset[int] = frozenset()
        found = [frozenset((i,)) for i in range(variables)] + [none] * (base - variables)
        for op, left, right in self.code.tolist():
            other = found[right] if op <= POW else none
            found.append(found[left] | other if other - found[left] else found[left])
        return [sorted(found[i]) for i in self.outputs.tolist()]

    def require(self, parameters: Array) -> None:
        """Raise `ValueError` for a wrong number of parameters."""
        if parameters.shape != (self.n_parameters,):
            message = f"the parameters have shape {parameters.shape}, not ({self.n_parameters},)"
            raise ValueError(message)


def _colour_columns(reads: list[list[int]], variables: int) -> tuple[Ints, Ints, Ints]:
    """Return rows and columns of a sparsity pattern, and a greedy column colouring."""
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
