"""Taylor integration by heyoka's compiled step, called from compiled code by its address.

A call of heyoka from Python takes as long as the step itself. Its integrators provide their object
code and LLVM module; `Step` links the code into this process, `taylor_steps` is the loop.
"""

from __future__ import annotations

import ctypes
import itertools
import math
import re
from functools import cache
from typing import Any

import numpy as np

from statechart.arrays import Array
from statechart.kernels.copies import copy_numbers
from statechart.kernels.jit import intrinsic, kernel
from statechart.kernels.polynomials import horner
from statechart.kernels.reconstruction import ReconstructionProgram, reconstruct_any

# Signature that the call by address requires: heyoka documents the module, not the function.
_SIGNATURE = re.compile(
    r"^define void @step\("
    r"ptr[^,]*%state_ptr, ptr[^,]*%par_ptr, ptr[^,]*%time_ptr, ptr[^,]*%h_ptr, ptr[^,]*%tc_ptr\)",
    re.MULTILINE,
)
# Functions of heyoka's library that the code calls.
_HELPERS = re.compile(r"@(heyoka_\w+)")
_serial_numbers = itertools.count()


class Step:
    """heyoka's compiled step of one integrator, linked into this process.

    `address` is the address of ``step(state, parameters, time, h, series)``, five pointers to
    float64. The step advances the state by at most h, and writes its size to h and the Taylor
    coefficients to series.
    """

    def __init__(self, module: str, code: bytes) -> None:
        import llvmlite.binding as llvm
        from heyoka import _core  # exists on Linux only

        builder = llvm.JITLibraryBuilder().add_object_img(code).add_current_process()
        library = ctypes.CDLL(_core.__file__)
        for name in set(_HELPERS.findall(module)):
            place = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
            builder.import_symbol(name, place)
        # The code is freed with its resource tracker.
        self._code = builder.export_symbol("step").link(_linker(), f"step {next(_serial_numbers)}")
        self.address = int(self._code["step"])

    @classmethod
    def of(cls, integrator: Any) -> Step | None:
        """Return the step of a heyoka integrator; None if its module has no such function."""
        state = integrator.llvm_state
        if not isinstance(state.ir, str) or _SIGNATURE.search(state.ir) is None:
            return None
        try:
            return cls(state.ir, state.object_code)
        except (AttributeError, RuntimeError):  # an unknown symbol
            return None


@cache
def _linker() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    # JITLink places the sections of an object side by side. Without it they may lie more than 2 GB
    # apart, which 32-bit relative addresses do not reach, and LLVM ends the process.
    return llvm.create_lljit_compiler(machine, use_jit_link=True)


_FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5)


def _call_by_address(address: int, *arrays: Array) -> None:
    _FUNCTION(int(address))(*(array.ctypes.data for array in arrays))


@intrinsic(_call_by_address)
def call_step(
    typing: Any, address: Any, state: Any, parameters: Any, time: Any, h: Any, series: Any
) -> Any:
    """Call the compiled step at an address."""
    from llvmlite import ir
    from numba import types

    arrays = (state, parameters, time, h, series)

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = ir.PointerType(ir.IntType(8))
        target = ir.FunctionType(ir.VoidType(), [pointer] * len(arrays)).as_pointer()
        data = [
            builder.bitcast(context.make_array(kind)(context, builder, value).data, pointer)
            for kind, value in zip(arrays, arguments[1:], strict=True)
        ]
        builder.call(builder.inttoptr(arguments[0], target), data)
        return context.get_dummy_value()

    return types.void(address, *arrays), build


# Largest slope error at the end of a step, relative to the motion in it. The round-off of stiff
# springs at rest is smaller.
MAX_SLOPE_ERROR = 1e-9
SLOPE_ERROR_FACTOR = 1e2  # the same in units of the tolerance, for low orders
# Lower bound of the motion: heyoka's tolerance is absolute below 1.
MIN_MOTION = 1e-6
# A slope error is round-off if it is below `_MAX_ROUND_OFF`, and halving the step leaves more than
# `_MIN_REDUCTION` of it: the truncation error falls with a power above the order.
_MAX_ROUND_OFF, _MIN_REDUCTION = 1e-3, 0.25
# heyoka's tolerance is absolute where all variables are below 1. Below this largest variable the
# length of a step is taken relative to it.
_SMALL, _SHORTER = 1e-3, 0.99
# Largest number of halvings of a step, for rates that end in a singularity.
MAX_HALVINGS = 40

Integrator = tuple[int, Array, Array, Array, Array, float, float]
"""heyoka's integrator: address of its step, state (n,), parameters (p,), clock (2,) with the time
since the start of the integration and its round-off, series (n, d + 1), tolerance, longest step."""


@kernel
def slope_error(row: Array, h: float, series: Array, errors: Array, motions: Array) -> float:
    """Return the error of the slope at the end of a step, relative to the motion; inf: not finite.

    `errors` (n,): slope errors of the variables; `motions` (n,): sums of absolute terms.
    """
    worst, largest_motion = 0.0, MIN_MOTION
    for v in range(row.shape[0]):
        slope, motion = 0.0, abs(row[v, 0])
        for k in range(1, row.shape[1]):
            slope += k * row[v, k]
            motion += k * abs(row[v, k])
        error = abs(slope - h * series[v, 1])
        errors[v], motions[v] = error, motion
        if not (error < math.inf and motion < math.inf):
            return math.inf
        worst, largest_motion = max(worst, error), max(largest_motion, motion)
    return worst / largest_motion


@kernel
def limited_length(series: Array, h: float) -> float:
    """Return the length of a step by Jorba and Zou, relative to small variables; at most `h`.

    The size is the largest sum of absolute terms, so that a start at zero has one. Polynomials of
    lower order, as clocks, are exact and do not count.
    """
    order = series.shape[1] - 1
    while True:
        size, last, before = 0.0, 0.0, 0.0
        for v in range(series.shape[0]):
            ends = abs(series[v, order]), abs(series[v, order - 1])
            if ends[0] > 0.0 or ends[1] > 0.0:
                last, before, terms = max(last, ends[0]), max(before, ends[1]), 0.0
                for k in range(order, -1, -1):
                    terms = terms * h + abs(series[v, k])
                size = max(size, terms)
        if not 0.0 < size < _SMALL:
            return h
        for _ in range(order - 1):
            last, before = last * h, before * h
        last *= h
        excess = max((last / size) ** (1.0 / order), (before / size) ** (1.0 / (order - 1)))
        # heyoka's factor of safety
        ratio = math.exp(-2.0 - 0.7 / (order - 1)) / excess if excess > 0.0 else 1.0
        if not ratio < _SHORTER:
            return h
        h *= ratio


@kernel
def limit_step(series: Array, length: Array, state: Array) -> None:
    """Shorten a step of `length` (1,), and write its end to the state (see `limited_length`)."""
    h = limited_length(series, length[0])
    if h < length[0]:
        length[0] = h
        for v in range(series.shape[0]):
            value = 0.0
            for k in range(series.shape[1] - 1, -1, -1):
                value = value * h + series[v, k]
            state[v] = value


@kernel
def scale_series(series: Array, h: float, row: Array, powers: Array) -> None:
    """Write a series in time as a polynomial in s = time / h, and the powers (d + 1,) of h.

    The loop has no branch, so that compilers vectorise it.
    """
    factor = 1.0
    for k in range(series.shape[1]):
        powers[k] = factor
        factor *= h
    for v in range(series.shape[0]):
        for k in range(series.shape[1]):
            # 0 times an infinite power is 0.
            value = series[v, k] * powers[k]
            row[v, k] = 0.0 if series[v, k] == 0.0 else value


@kernel
def _finite(row: Array) -> bool:
    """Return whether all terms of a step are finite."""
    bounded = True
    for v in range(row.shape[0]):
        for k in range(row.shape[1]):
            bounded = bounded and abs(row[v, k]) < math.inf
    return bounded


@kernel
def advance_clock(clock: Array, h: float) -> None:
    """Advance a clock, the sum of its first two numbers, by `h` (as `Clock.later` does)."""
    later = clock[0] + h
    elapsed = later - clock[0]
    error = (clock[0] - (later - elapsed)) + (h - elapsed) + clock[1]
    clock[0] = later + error
    clock[1] = error - (clock[0] - later)


@kernel
def taylor_steps(
    integrator: Integrator,
    duration: float,
    count: int,
    times: Array,
    coeffs: Array,
    end: Array,
    dependent: ReconstructionProgram,
    start: float,
) -> tuple[int, int, float, float]:
    """Take up to `count` Taylor steps in `duration`, with control of the slope error.

    Writes the ends of the steps to `times` (from ``times[0]`` on), their polynomials in
    s = time / step size to `coeffs`, and the state at the end of the last finite step to `end`.
    Advances the integrator's state and clock to the end of the last step.

    heyoka chooses a step size by the last two terms of the series (Jorba and Zou 2005), and fails
    if these are zero: from x = 0 the series of x' = 1 - x**4 has every fourth term only. The loop
    compares the slope at the end of each step with the rate there, the first-order term of the
    next step, and repeats a step with too large an error at half its size.

    Each step starts with reconstructed variables (see `dependent`); the flow starts at time
    `start`. Returns the number of steps, the number of finite ones, the size of the last step, and
    the duration that remained before it.
    """
    address, state, parameters, clock, series, tolerance, max_step = integrator
    n, allowed = series.shape[0], max(MAX_SLOPE_ERROR, SLOPE_ERROR_FACTOR * tolerance)
    step, current, last_start = np.empty(1), np.empty(n), np.empty(n)
    errors, motions, powers = np.empty(n), np.empty(n), np.empty(series.shape[1])
    remaining, total, n_steps = duration, 0.0, 0
    step_limit, error, halvings, done, repeats = max_step, math.inf, 0, False, False
    h, last_time, last_round_off, last_total, last_remaining = 0.0, 0.0, 0.0, 0.0, remaining
    while True:
        reconstruct_any(dependent, state, start + times[n_steps])
        copy_numbers(state, current)
        step[0] = 0.0 if done else min(remaining, step_limit)
        call_step(address, state, parameters, clock, step, series)
        limit_step(series, step, state)
        # The step before a repeated one is already checked.
        if n_steps > 0 and not repeats:
            last = n_steps - 1
            last_error, error = error, slope_error(coeffs[last], h, series, errors, motions)
            is_truncation = (
                halvings == 0 or error > _MAX_ROUND_OFF or error <= _MIN_REDUCTION * last_error
            )
            if error > allowed and is_truncation:
                halvings += 1
                step_limit, done, repeats = 0.5 * h, False, True
                n_steps -= 1
                total, remaining, clock[0], clock[1] = (
                    last_total,
                    last_remaining,
                    last_time,
                    last_round_off,
                )
                copy_numbers(last_start, state)
                copy_numbers(last_start, end)
                if halvings > MAX_HALVINGS:
                    return n_steps, n_steps, 0.0, remaining
                continue
            step_limit, halvings = max_step, 0
        if done:
            return n_steps, n_steps, h, remaining
        h, repeats = step[0], False
        copy_numbers(current, last_start)
        scale_series(series, h, coeffs[n_steps], powers)
        bounded = _finite(coeffs[n_steps])
        n_steps += 1
        last_total, last_remaining, last_time, last_round_off = total, remaining, clock[0], clock[1]
        advance_clock(clock, h)
        if not bounded:
            return n_steps, n_steps - 1, h, remaining
        total += h
        # The sum starts at the first of these steps: less round-off in long arcs.
        times[n_steps] = times[0] + total
        for v in range(n):
            end[v] = horner(coeffs, n_steps - 1, v, 1.0)
        if not times[n_steps] > times[n_steps - 1]:
            # The step sizes shrink towards a singularity.
            return n_steps, n_steps, 0.0, remaining
        # The last step is cut to end exactly at the duration.
        done = n_steps == count or h == remaining
        if not done:
            remaining -= h
