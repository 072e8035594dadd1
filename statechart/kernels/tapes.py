"""Evaluation of tapes in floating point, at one point or vectorised over many."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tolerant_floor import tolerant_floor

ADD, SUB, MUL, DIV, MIN, MAX, ATAN2, HYPOT, POW = range(9)
NEG, SQUARE, POWI, SQRT, EXP, LOG, SIN, COS, TAN, ASIN, ACOS, ATAN = range(9, 21)
SINH, COSH, TANH, ABS, SIGN, FLOOR = range(21, 27)

_BINARY = ("add", "sub", "mul", "div", "min", "max", "atan2", "hypot", "pow")
_INLINE = ("neg", "square", "powi", "sqrt", "exp", "log", "sin", "cos", "tan")
_LIBRARY = ("asin", "acos", "atan", "sinh", "cosh", "tanh", "abs", "sign", "floor")
OPCODES: dict[str, int] = {
    name: index for index, name in enumerate([*_BINARY, *_INLINE, *_LIBRARY])
}

SKIP = -1
"""Code of an operation to skip."""

_tolerant_floor = kernel(tolerant_floor)


class TapeCode(NamedTuple):
    """Arrays of a tape for kernels; see `statechart.formulas.tape.Tape`."""

    code: Ints32  # shape (c, 3)
    constants: Array
    outputs: Ints32
    reads: Ints32
    n_fixed: int


BLOCK = 32  # points per block; amortises the dispatch of an operation


@kernel
def _apply_unary(op: int, a: float, exponent: int) -> float:
    """Evaluate a function of one operand that is not vectorised."""
    if op == SIN:
        return math.sin(a)
    if op == COS:
        return math.cos(a)
    if op == POWI:
        return a ** float(exponent)
    if op == TAN:
        return math.tan(a)
    if op == EXP:
        return math.exp(a)
    if op == LOG:
        return math.log(a)
    if op == ASIN:
        return math.asin(a)
    if op == ACOS:
        return math.acos(a)
    if op == ATAN:
        return math.atan(a)
    if op == SINH:
        return math.sinh(a)
    if op == COSH:
        return math.cosh(a)
    if op == TANH:
        return math.tanh(a)
    if op == ABS:
        return abs(a)
    if op == FLOOR:
        return _tolerant_floor(a)
    return 1.0 if a > 0.0 else (-1.0 if a < 0.0 else a)  # NaN has no sign


@kernel
def _apply_binary(op: int, a: float, b: float) -> float:
    """Evaluate one of the rarer functions of two operands."""
    if op == POW:
        return a**b
    if op == ATAN2:
        return math.atan2(a, b)
    if op == HYPOT:
        return math.hypot(a, b)
    if a != a or b != b:
        return a + b
    return min(a, b) if op == MIN else max(a, b)


@kernel
def run_tape(code: Ints32, first: int, last: int, base: int, regs: Array, count: int) -> None:
    """Run the operations [first, last) on `count` columns of registers."""
    for k in range(first, last):
        op = code[k, 0]
        if op == SKIP:
            continue
        a = regs[code[k, 1]]
        out = regs[base + k]
        if op <= POW:
            b = regs[code[k, 2]]
            if op == ADD:
                for j in range(count):
                    out[j] = a[j] + b[j]
            elif op == SUB:
                for j in range(count):
                    out[j] = a[j] - b[j]
            elif op == MUL:
                for j in range(count):
                    out[j] = a[j] * b[j]
            elif op == DIV:
                for j in range(count):
                    out[j] = a[j] / b[j]
            else:
                for j in range(count):
                    out[j] = _apply_binary(op, a[j], b[j])
        elif op == NEG:
            for j in range(count):
                out[j] = -a[j]
        elif op == SQUARE:
            for j in range(count):
                out[j] = a[j] * a[j]
        elif op == SQRT:
            for j in range(count):
                out[j] = math.sqrt(a[j])
        else:
            exponent = code[k, 2]
            for j in range(count):
                out[j] = _apply_unary(op, a[j], exponent)


@kernel
def allocate_registers(
    code: Ints32, constants: Array, parameters: Array, n_variables: int, width: int
) -> tuple[int, Array]:
    """Return the first register of the operations, and registers with constants and parameters."""
    base = n_variables + 1 + parameters.shape[0] + constants.shape[0]
    regs = np.empty((base + code.shape[0], width))
    write_inputs(constants, parameters, n_variables, regs)
    return base, regs


@kernel
def write_inputs(constants: Array, parameters: Array, n_variables: int, regs: Array) -> None:
    """Write constants and parameters to their registers."""
    n_parameters = parameters.shape[0]
    for j in range(regs.shape[1]):
        for p in range(n_parameters):
            regs[n_variables + 1 + p, j] = parameters[p]
        for c in range(constants.shape[0]):
            regs[n_variables + 1 + n_parameters + c, j] = constants[c]


@kernel
def tape_values(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    state: Array,
    parameters: Array,
    time: float,
    result: Array,
) -> None:
    """Write the values (n_out,) of the outputs at one point.

    Writing to an array takes a third of the time of returning a new one.
    """
    n = state.shape[0]
    base, regs = allocate_registers(code, constants, parameters, n, 1)
    for v in range(n):
        regs[v, 0] = state[v]
    regs[n, 0] = time
    run_tape(code, 0, code.shape[0], base, regs, 1)
    for i in range(outputs.shape[0]):
        result[i] = regs[outputs[i], 0]


@kernel
def tape_table(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    n_fixed: int,
    states: Array,
    parameters: Array,
    times: Array,
) -> Array:
    """Values of the outputs at m points; shape (m, n_out)."""
    m, n = states.shape
    base, regs = allocate_registers(code, constants, parameters, n, BLOCK)
    first = 0
    result = np.empty((m, outputs.shape[0]))
    for begin in range(0, m, BLOCK):
        count = min(BLOCK, m - begin)
        for j in range(count):
            for v in range(n):
                regs[v, j] = states[begin + j, v]
            regs[n, j] = times[begin + j]
        # Operations on parameters alone run in the first block; only the last block is short.
        run_tape(code, first, code.shape[0], base, regs, count)
        first = n_fixed
        for j in range(count):
            for i in range(outputs.shape[0]):
                result[begin + j, i] = regs[outputs[i], j]
    return result


@kernel
def largest_deviation(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    targets: Array,
    weights: Array,
    state: Array,
    parameters: Array,
    time: float,
) -> float:
    """Largest weighted distance of an output from its target; undefined outputs do not count."""
    numbers = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, state, parameters, time, numbers)
    off = 0.0
    for i in range(numbers.shape[0]):
        distance = weights[i] * abs(numbers[i] - targets[i])
        if distance > off:
            off = distance
    return off
