"""Compilation of kernels by `numba.njit`, and their machine code on disk."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numba
from numba import njit
from numba.extending import intrinsic, typeof_impl

from statechart import compiling, interrupts
from statechart.kernels.cache import CodeCache, Compilable
from statechart.kernels.lowering import KernelCompiler, from_bytes, plain, to_bytes

Signature = tuple[Any, ...]
"""Types of arguments."""

_njit = partial(njit, error_model="numpy", no_cfunc_wrapper=True, pipeline_class=KernelCompiler)


_TYPING = _njit()(lambda: None).typingctx


def inner_dispatcher(function: Callable[..., Any]) -> Any:
    """Return numba's dispatcher for calls of a function from kernels."""
    made = _njit(no_cpython_wrapper=True)(function)
    compile_ = made.compile

    def compile_part(signature: Signature) -> Any:
        signature = plain(signature)
        if signature not in made.overloads:
            with compiling.whole(compiling.KERNELS):
                compile_(signature)
        return made.overloads[signature].entry_point

    made.compile = compile_part
    return made


def dispatcher(function: Callable[..., Any], cache: CodeCache, count: Callable[[], int]) -> Any:
    """Return numba's dispatcher for calls from Python; it compiles a function or loads its code.

    `count` returns the number of functions to compile, for the line that shows progress.
    """
    made = _njit()(function)
    compile_ = made.compile

    def is_loaded(signature: Signature) -> bool:
        data = cache.load(_key(signature, made))
        # A file that another version of a library wrote may be whole, and of no use.
        with suppress(Exception):
            if data is not None:
                made.add_overload(from_bytes(data, made.targetctx))
        return signature in made.overloads

    def compile_whole(signature: Signature) -> Any:
        signature = plain(signature)
        # Signals end a compilation at once: it may take half a minute.
        with interrupts.let_through():
            if signature not in made.overloads and not is_loaded(signature):
                with compiling.whole(compiling.KERNELS, count), cache.turn():
                    # Another process may have compiled it meanwhile.
                    if not is_loaded(signature):
                        _with_stack(lambda: compile_(signature))
                        data = to_bytes(made.overloads[signature])
                        if data is not None:
                            cache.save(_key(signature, made), data)
        return made.overloads[signature].entry_point

    made.compile = compile_whole
    return made


def _with_stack(call: Callable[[], Any]) -> None:
    call()


# CPython maps 16 kB of stack at a call that needs them and unmaps them as it returns, which inner
# calls of a compilation do a million times. A frame of 1 MB brings as much for all calls in it.
_with_stack.__code__ = _with_stack.__code__.replace(co_stacksize=2**17)


def _key(signature: Signature, made: Any) -> str:
    return repr((signature, numba.__version__, made.targetctx.codegen().magic_tuple()))


def intrinsic_dispatcher(function: Callable[..., Any]) -> Any:
    """Return a function that writes its own LLVM code."""
    made = intrinsic(function)
    # Made while what calls it is compiled, it would be seen by the next compilation only.
    _TYPING.refresh()
    return made


@typeof_impl.register(Compilable)
def _type(value: Any, context: Any) -> Any:
    """Type a kernel, where a kernel names it, as its dispatcher."""
    return _TYPING.resolve_value_type(value.inner)
