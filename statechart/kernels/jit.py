"""Functions that Python interprets until they are hot, and that numba compiles then.

Numba is imported when a kernel is compiled or loaded: what calls few kernels starts in half the
time. Interpreted and compiled kernels give identical bits.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property, update_wrapper
from time import thread_time
from types import FunctionType, SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar, cast, overload

import numpy as np

from statechart.kernels.cache import CodeCache, Compilable

if TYPE_CHECKING:
    from statechart.arrays import Array

F = TypeVar("F", bound=Callable[..., Any])

LOADING = 0.08
"""Seconds of all interpreted kernels before numba is imported to load cached ones: half the time of
that import. Of 37 models 12 stay below it, and 20 need more than 0.3."""

LINKING = 0.005
"""Seconds of one interpreted kernel before it is loaded from the cache, where numba is imported;
that takes as long."""

HOT = 0.25
"""Seconds of one interpreted kernel before it is compiled, which takes one to forty."""

# Python's own is rounded better than that of the C library, which compiled code calls.
_MATH = SimpleNamespace(**{**vars(math), "hypot": lambda x, y: float(np.hypot(x, y))})

_CLOCK = 32  # calls between two looks at the clock, which takes as long as a small kernel


class _Interpreter:
    """State of the interpretation of kernels.

    `kernel` is under way since the CPU time `began`; `calls` are the kernels called by interpreted
    kernels, `spent` the seconds of those before; `ahead_of_time`: this process fills the cache.
    """

    kernel: Kernel | None = None
    began, calls, spent, ahead_of_time = 0.0, 0, 0.0, False


class Kernel(Compilable):
    """A kernel: Python calls it interpreted or compiled, other kernels call its compiled code."""

    def __init__(self, function: Callable[..., Any], interpreted: bool) -> None:
        self.py_func = function
        self._hot, self._spent = not interpreted, 0.0
        update_wrapper(self, function)

    @cached_property
    def compiled(self) -> Any:
        """Numba's dispatcher for calls from Python."""
        from statechart.kernels import compiler

        return compiler.dispatcher(self.py_func, self.cache, self._count_uncompiled)

    @cached_property
    def inner(self) -> Any:
        """Numba's dispatcher for calls from kernels."""
        from statechart.kernels import compiler

        return compiler.inner_dispatcher(self.py_func)

    @cached_property
    def written(self) -> Callable[..., Any]:
        """The function with functions of the C library."""
        space = {**self.py_func.__globals__, "math": _MATH}
        return FunctionType(self.py_func.__code__, space, argdefs=self.py_func.__defaults__)

    @cached_property
    def cache(self) -> CodeCache:
        """Its machine code on disk."""
        return CodeCache(self.py_func)

    @cached_property
    def is_cached(self) -> bool:
        """Return whether its machine code lies on disk."""
        return self.cache.is_filled()

    @cached_property
    def below(self) -> set[Kernel]:
        """The kernel and those that it may call, by the names in their code."""
        found: set[Kernel] = set()
        queue = [self]
        while queue:
            one = queue.pop()
            if one not in found:
                found.add(one)
                function = one.py_func
                named = (function.__globals__.get(name) for name in function.__code__.co_names)
                queue += [kernel for kernel in named if isinstance(kernel, Kernel)]
        return found

    def _count_uncompiled(self) -> int:
        return sum(not one.inner.overloads for one in self.below)

    def __call__(self, *arguments: Any) -> Any:
        """Run the function."""
        outer = _Interpreter.kernel
        if outer is not None:
            _Interpreter.calls += 1
            looks = _Interpreter.calls % _CLOCK == 0
            if looks and outer._is_hot(thread_time() - _Interpreter.began):
                raise TimeoutError
            return self.written(*arguments)
        if self._hot or self._is_hot():
            return self.compiled(*arguments)
        return self._interpret(arguments)

    def _is_hot(self, under_way: float = 0.0) -> bool:
        """Return whether to compile it, after this many seconds of the present call."""
        own, total = self._spent + under_way, _Interpreter.spent + under_way
        loads = own >= LINKING if numba_is_imported() else total >= LOADING
        hot = own >= HOT or _Interpreter.ahead_of_time
        self._hot = hot or (loads and self.is_cached)
        return self._hot

    def _interpret(self, arguments: tuple[Any, ...]) -> Any:
        before = [(array, array.copy()) for array in _arrays(arguments) if array.flags.writeable]
        _Interpreter.kernel, _Interpreter.began = self, thread_time()
        try:
            with np.errstate(all="ignore"):
                return _python_numbers(self.written(*arguments))
        except Exception:
            # It took too long, or only compiled code gives an infinity or no number.
            self._hot = True
        finally:
            took = thread_time() - _Interpreter.began
            self._spent += took
            _Interpreter.spent += took
            _Interpreter.kernel = None
        for array, content in before:
            array[...] = content
        return self.compiled(*arguments)

    def __reduce__(self) -> str:
        """Travel by name, as functions do."""
        return self.py_func.__qualname__


class Intrinsic(Compilable):
    """A function of kernels that writes its own LLVM code, as `numba.extending.intrinsic`."""

    def __init__(self, function: Callable[..., Any], as_written: Callable[..., Any]) -> None:
        self.py_func, self._as_written = function, as_written

    def __call__(self, *arguments: Any) -> Any:
        """Run the function that Python has in its place."""
        return self._as_written(*arguments)

    @cached_property
    def inner(self) -> Any:
        """The kernel as numba compiles it."""
        from statechart.kernels import compiler

        return compiler.intrinsic_dispatcher(self.py_func)


@overload
def kernel(function: F) -> F: ...
@overload
def kernel(*, interpreted: bool) -> Callable[[F], F]: ...
def kernel(function: Any = None, *, interpreted: bool = True) -> Any:
    """Let Python interpret a function until it has taken `HOT` seconds; then compile it.

    Arrays are arguments, or stand in tuples of arguments. For identical bits a kernel has no sums
    and products of whole arrays, which numpy takes in another order, no powers but those of floats,
    and no complex numbers. A kernel that is not to be `interpreted` is compiled at its first call.
    """
    if function is None:
        return lambda function: Kernel(function, interpreted)
    return Kernel(function, interpreted)


def intrinsic(as_written: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Declare an intrinsic, which writes LLVM code; Python calls `as_written` in its place."""
    return lambda function: Intrinsic(function, as_written)


@contextmanager
def ahead_of_time() -> Iterator[None]:
    """Interpret no kernels, in runs whose purpose is to fill the cache."""
    _Interpreter.ahead_of_time = True
    try:
        yield
    finally:
        _Interpreter.ahead_of_time = False


def entry(kernel: Any, *arguments: Any) -> Callable[..., Any]:
    """Return the machine code of a kernel for arguments of these types.

    To look it up for sixty arrays in tuples takes three times as long as to pass them.
    """
    from numba import typeof

    found = kernel.compiled.compile(tuple([typeof(argument) for argument in arguments]))
    return cast(Callable[..., Any], found)


def is_ready(kernel: Any) -> bool:
    """Return whether a kernel is compiled, or on disk, in a process that has imported numba."""
    if _Interpreter.ahead_of_time:
        return True
    return numba_is_imported() and (bool(kernel.compiled.overloads) or kernel.is_cached)


def numba_is_imported() -> bool:
    """Return whether some kernel has had to be compiled or loaded."""
    return "statechart.kernels.compiler" in sys.modules


def _arrays(arguments: Iterable[Any]) -> Iterator[Array]:
    """Yield the arrays among arguments, in tuples, too."""
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            yield argument
        elif isinstance(argument, tuple):
            yield from _arrays(argument)


def _python_numbers(result: Any) -> Any:
    """Return a result with Python's numbers in the place of numpy's, as compiled code does."""
    if isinstance(result, tuple):
        items = map(_python_numbers, result)
        return type(result)(*items) if hasattr(result, "_fields") else tuple(items)
    return result.item() if isinstance(result, np.generic) else result
