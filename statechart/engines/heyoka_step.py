"""heyoka's compiled step, linked into this process.

A call of heyoka from Python costs as much as the step itself, and its code is at hand: an
integrator hands out its object code and the LLVM module that it comes from, so that the function
can be linked into this process once more and called by address.
"""

from __future__ import annotations

import ctypes
import itertools
import re
from functools import cache
from typing import Any

from statechart.arrays import Array
from statechart.kernels.jit import native

# What a call by address relies on: heyoka documents the module, not the function.
_SIGNATURE = re.compile(
    r"^define void @step\("
    r"ptr[^,]*%state_ptr, ptr[^,]*%par_ptr, ptr[^,]*%time_ptr, ptr[^,]*%h_ptr, ptr[^,]*%tc_ptr\)",
    re.MULTILINE,
)
# Functions that heyoka's library brings along.
_HELPERS = re.compile(r"@(heyoka_\w+)")
_numbers = itertools.count()


class Step:
    """heyoka's compiled step of one integrator, linked into this process.

    Attributes
    ----------
    address : int
        Of ``step(state, parameters, time, h, series)``, five pointers to float64: it advances
        the state by at most h, writes what it took to h and the Taylor coefficients to series.
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
        self._code = builder.export_symbol("step").link(_linker(), f"step {next(_numbers)}")
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


@native(_called)
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
