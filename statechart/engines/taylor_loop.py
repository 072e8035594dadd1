"""Taylor steps in one call: heyoka's compiled step, linked into this process and called by address.

A call of heyoka from Python costs as much as the step itself, and its code is at hand: an
integrator hands out its object code and the LLVM module that it comes from.
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
from statechart.kernels.copies import put
from statechart.kernels.jit import intrinsic, kernel
from statechart.kernels.polynomials import horner
from statechart.kernels.reconstruction import Program, reconstruct_any

# A call by address relies on this: heyoka documents the module, not the function.
_SIGNATURE = re.compile(
    r"^define void @step\("
    r"ptr[^,]*%state_ptr, ptr[^,]*%par_ptr, ptr[^,]*%time_ptr, ptr[^,]*%h_ptr, ptr[^,]*%tc_ptr\)",
    re.MULTILINE,
)
# Functions that heyoka's library brings along.
_HELPERS = re.compile(r"@(heyoka_\w+)")
_serial_numbers = itertools.count()


class Step:
    """heyoka's compiled step of one integrator, linked into this process.

    Its address is that of ``step(state, parameters, time, h, series)``, five pointers to float64:
    it advances the state by at most h, writes what it took to h and the Taylor coefficients to
    series.
    """

    def __init__(self, module: str, code: bytes) -> None:
        import llvmlite.binding as llvm
        from heyoka import _core  # elsewhere than on Linux there is none

        builder = llvm.JITLibraryBuilder().add_object_img(code).add_current_process()
        library = ctypes.CDLL(_core.__file__)
        for name in set(_HELPERS.findall(module)):
            place = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
            builder.import_symbol(name, place)
        # The code is freed with what tracks it.
        self._code = builder.export_symbol("step").link(_linker(), f"step {next(_serial_numbers)}")
        self.address = int(self._code["step"])

    @classmethod
    def of(cls, integrator: Any) -> Step | None:
        """Return the step of a heyoka integrator; None where it has no such function."""
        state = integrator.llvm_state
        if not isinstance(state.ir, str) or _SIGNATURE.search(state.ir) is None:
            return None
        try:
            return cls(state.ir, state.object_code)
        except (AttributeError, RuntimeError):  # a symbol that is not to be found
            return None


@cache
def _linker() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    return llvm.create_lljit_compiler(machine)


_FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5)


def _called(address: int, *arrays: Array) -> None:
    _FUNCTION(int(address))(*(array.ctypes.data for array in arrays))


@intrinsic(_called)
def call_step(
    typing: Any, address: Any, state: Any, parameters: Any, time: Any, h: Any, series: Any
) -> Any:
    """Call the step at an address."""
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


# So far off the rate may the slope at the end of a step be, in parts of the motion in it and for
# orders that do better: stiff springs at rest are by less in rounding.
STRAY = 1e-9
ORDERS = 1e2  # likewise in tolerances, for orders that do worse
# The motion counts as so much at least: below 1 heyoka's tolerance is absolute.
LEAST_MOTION = 1e-6
# Above this it is never rounding; below, what falls by less as a step is halved is: what a series
# leaves out falls with a power above its order.
_ROUGH, _ROUNDING = 1e-3, 0.25
# No step is made where the rate itself ends: shorter ones do not help.
HALVINGS = 40

Integrator = tuple[int, Array, Array, Array, Array, float, float]
"""heyoka's, its step linked: address, state (n,), parameters (p,), clock (2,) with the time since
the integration began and its rounding, series (n, d + 1), tolerance, longest step."""


@kernel
def stray(row: Array, h: float, series: Array, offs: Array, reaches: Array) -> float:
    """Return the error of the slope at the end of a step, in parts of the motion.

    Infinite where the step is not finite.

    Writes how far it is of each variable (n,), and how large each is and moves in the step.
    """
    worst, size = 0.0, LEAST_MOTION
    for v in range(row.shape[0]):
        slope, reach = 0.0, abs(row[v, 0])
        for k in range(1, row.shape[1]):
            slope += k * row[v, k]
            reach += k * abs(row[v, k])
        off = abs(slope - h * series[v, 1])
        offs[v], reaches[v] = off, reach
        if not (off < math.inf and reach < math.inf):
            return math.inf
        worst, size = max(worst, off), max(size, reach)
    return worst / size


@kernel
def expand(series: Array, h: float, row: Array, powers: Array) -> None:
    """Write a series in time as a polynomial in s = time / h, and the powers (d + 1,) of h.

    Term by term without a look at any: so processors do many at once.
    """
    factor = 1.0
    for k in range(series.shape[1]):
        powers[k] = factor
        factor *= h
    for v in range(series.shape[0]):
        for k in range(series.shape[1]):
            # Nothing to a power beyond all floats is nothing.
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
def let_pass(clock: Array, h: float) -> None:
    """Let the time `h` pass (Knuth's two-sum)."""
    later = clock[0] + h
    passed = later - clock[0]
    clock[1] += (clock[0] - (later - passed)) + (h - passed)
    clock[0] = later


@kernel
def taylor_steps(
    integrator: Integrator,
    duration: float,
    count: int,
    times: Array,
    coeffs: Array,
    end: Array,
    follows: Program,
    start: float,
) -> tuple[int, int, float, float]:
    """Take up to `count` steps in `duration`, behind those of an arc that end at ``times[0]``.

    Writes when they end to `times`, their polynomials in s = time / duration to `coeffs`, and
    the state at the end of the last finite one to `end`. The integrator's state is left where the
    last step ends, and its clock is advanced.

    The length of a step follows from the last two terms of its series, and where these are
    missing it says nothing: x' = 1 - x**4 has every fourth only, from x = 0. So the slope at the
    end of each step is compared with the rate there, with which the series of the next begins,
    and a step that strays is made again at half its length.

    What follows from other variables (`follows`) does so wherever a step begins, and at the end;
    `start` is when the flow begins. Returns how many steps were made, how many of them are finite,
    the length of the last step, and what was left before it.
    """
    address, state, parameters, clock, series, tolerance, max_step = integrator
    n, allowed = series.shape[0], max(STRAY, ORDERS * tolerance)
    step, here, begun = np.empty(1), np.empty(n), np.empty(n)
    offs, reaches, powers = np.empty(n), np.empty(n), np.empty(series.shape[1])
    left, total, taken = duration, 0.0, 0
    longest, off, halvings, done, again = max_step, math.inf, 0, False, False
    h, since, rest, summed, length = 0.0, 0.0, 0.0, 0.0, left
    while True:
        reconstruct_any(follows, state, start + times[taken])
        put(state, here)
        step[0] = 0.0 if done else min(left, longest)
        call_step(address, state, parameters, clock, step, series)
        # The step before the one that is made again has been looked at.
        if taken > 0 and not again:
            last = taken - 1
            before, off = off, stray(coeffs[last], h, series, offs, reaches)
            falls = halvings == 0 or off > _ROUGH or off <= _ROUNDING * before
            if off > allowed and falls:
                halvings += 1
                longest, done, again = 0.5 * h, False, True
                taken -= 1
                total, left, clock[0], clock[1] = summed, length, since, rest
                put(begun, state)
                put(begun, end)
                if halvings > HALVINGS:
                    return taken, taken, 0.0, left
                continue
            longest, halvings = max_step, 0
        if done:
            return taken, taken, h, left
        h, again = step[0], False
        put(here, begun)
        expand(series, h, coeffs[taken], powers)
        bounded = _finite(coeffs[taken])
        taken += 1
        summed, length, since, rest = total, left, clock[0], clock[1]
        let_pass(clock, h)
        if not bounded:
            return taken, taken - 1, h, left
        total += h
        # Summed from the start of these steps, so that long arcs lose nothing.
        times[taken] = times[0] + total
        for v in range(n):
            end[v] = horner(coeffs, taken - 1, v, 1.0)
        if not times[taken] > times[taken - 1]:
            # On its way into a singularity, for ever.
            return taken, taken, 0.0, left
        # A step is cut to end at the duration exactly, and then its length is what was left.
        done = taken == count or h == left
        if not done:
            left -= h
