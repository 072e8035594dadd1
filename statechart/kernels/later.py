"""Kernels that are compiled when a run first enters them: what most runs never do costs nothing.

The machine code of a caller asks for the address of such a kernel when it first calls it, and keeps
it. Of the kernel it knows what the source says: the arguments it is given, and what it returns by
its annotation.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils, typing
from numba.core.registry import cpu_target
from numba.core.typing.templates import AbstractTemplate

Signature = tuple[Any, ...]
"""Types of arguments."""


def plain(signature: Signature) -> Signature:
    """Return what a function is compiled for when it is called with arguments of these types."""
    return tuple(_plain(kind) for kind in signature)


def _plain(kind: Any) -> Any:
    kind = types.unliteral(kind)
    return types.int64 if isinstance(kind, types.Integer) else kind


_NUMBERS = {type(None): types.none, int: types.int64, float: types.float64, bool: types.boolean}
_RESOLVER = "statechart_kernel_that_is_entered"


class Later(NamedTuple):
    """A kernel that machine code calls, and that is compiled when it does."""

    symbol: str  # By which the code asks for it.
    # Where it stands.
    module: str
    name: str
    signature: Signature

    @classmethod
    def of(cls, function: Any, signature: Signature) -> Later:
        """Return a function, called with arguments of these types."""
        digest = hashlib.blake2b(str(signature).encode(), digest_size=8).hexdigest()
        module, name = function.__module__, function.__name__
        return cls(f"{module}.{name}.{digest}", module, name, signature)

    def note(self) -> None:
        """Let machine code ask for it."""
        _known[self.symbol] = self

    def address(self) -> int:
        """Return where its machine code is, compiled or loaded now."""
        compiled = getattr(importlib.import_module(self.module), self.name).made
        compiled.compile(self.signature)
        result = compiled.overloads[self.signature]
        declared, found = returned(compiled.py_func), result.signature.return_type
        if found != declared:
            raise TypeError(f"{self.name} returns {found}, and says that it is {declared}")
        return int(result.library.get_pointer_to_function(result.fndesc.mangled_name))


_known: dict[str, Later] = {}


def noted() -> tuple[Later, ...]:
    """Return the kernels that machine code in this process may ask for."""
    return tuple(_known.values())


_failed: list[BaseException] = []


@ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_char_p, ctypes.POINTER(ctypes.c_void_p))
def _entered(symbol: bytes, error: Any) -> int | None:
    """Return the address of a kernel; where it cannot be compiled, or is interrupted, the error."""
    try:
        return _known[symbol.decode()].address()
    except BaseException as failed:
        # It cannot pass through here: the machine code raises it, while this list holds it.
        _failed[:] = [failed]
        error[0], error[1] = id(type(failed)), id(failed)
        return None


llvm.add_symbol(_RESOLVER, ctypes.cast(_entered, ctypes.c_void_p).value)


def returned(function: Any) -> Any:
    """Return the type of what a function returns, by its annotation: numbers, or tuples of them."""
    return _as_type(get_type_hints(function)["return"])


def _as_type(hint: Any) -> Any:
    if get_origin(hint) is tuple:
        return types.Tuple([_as_type(item) for item in get_args(hint)])
    return _NUMBERS[hint]


class Entered(NamedTuple):
    """What stands for a kernel that is compiled when it is entered, in those that call it."""

    function: Any


def type_of(function: Any) -> types.Function:
    """Return the type by which numba knows such a kernel in those that call it."""
    entered = Entered(function)

    class Template(AbstractTemplate):
        """How it is called."""

        key = entered

        def generic(self, args: Signature, kws: Any) -> Any:
            return typing.signature(returned(function), *plain(args))

    def call(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        later = Later.of(function, signature.args)
        kind = context.call_conv.get_function_type(signature.return_type, signature.args)
        code = builder.bitcast(_asked(context, builder, later.symbol), kind.as_pointer())
        status, result = context.call_conv.call_function(
            builder, code, signature.return_type, signature.args, arguments
        )
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return result

    cpu_target.target_context.insert_func_defn([(call, entered, (types.VarArg(types.Any),))])
    return types.Function(Template)


def _asked(context: Any, builder: Any, symbol: str) -> Any:
    """Load the address of a kernel, that is asked for the first time."""
    module = builder.module
    kept = cgutils.add_global_variable(module, cgutils.voidptr_t, f"address.{symbol}")
    kept.linkage = "internal"
    kept.initializer = kept.type.pointee(None)
    found = cgutils.alloca_once_value(builder, builder.load(kept))
    with cgutils.if_unlikely(builder, cgutils.is_null(builder, builder.load(found))):
        error = cgutils.alloca_once(builder, cgutils.voidptr_t, size=2)
        kind = ir.FunctionType(cgutils.voidptr_t, [cgutils.voidptr_t, error.type])
        resolver = cgutils.get_or_insert_function(module, kind, _RESOLVER)
        asked = builder.call(resolver, [context.insert_const_string(module, symbol), error])
        with cgutils.if_unlikely(builder, cgutils.is_null(builder, asked)):
            raised = (builder.load(builder.gep(error, [cgutils.int32_t(i)])) for i in range(2))
            context.get_python_api(builder).err_set_object(*raised)
            context.call_conv.return_exc(builder)
        builder.store(asked, kept)
        builder.store(asked, found)
    return builder.load(found)
