"""Functions that are compiled when they are first called.

Nothing of numba is imported before: what calls no kernel, as drawing a statechart, starts in half
the time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, update_wrapper
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


class Compiled:
    """A function in the place of what numba makes of it.

    Parameters
    ----------
    function : callable
        As it is written.
    how : str
        What makes it, in `statechart.kernels.machine_code`.

    Attributes
    ----------
    py_func : callable
        The function.
    """

    def __init__(self, function: Callable[..., Any], how: str) -> None:
        self.py_func, self._how = function, how
        update_wrapper(self, function)

    @cached_property
    def made(self) -> Any:
        """What numba makes of it."""
        from statechart.kernels import machine_code

        return getattr(machine_code, self._how)(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        """Run what was compiled."""
        return self.made(*arguments)

    def __reduce__(self) -> str:
        """Travel by name, as functions do."""
        return self.py_func.__qualname__


class Kernel(Compiled):
    """A kernel, or a part of kernels."""


class Native(Compiled):
    """A function of kernels that writes its own code."""


def kernel(function: F) -> F:
    """Compile a function when it is first called, from Python or from other kernels; cached."""
    return cast(F, Kernel(function, "kernel"))


def part(function: F) -> F:
    """Compile a function that only kernels call, into each of them."""
    return cast(F, Kernel(function, "part"))


def native(function: Callable[..., Any]) -> Any:
    """Let a function write the code of kernels that call it, as `numba.extending.intrinsic`."""
    return Native(function, "native")


def is_cached(compiled: Any) -> bool:
    """Whether a kernel lies compiled on disk, whole, for the files as they are."""
    from statechart.kernels import machine_code

    return machine_code.is_cached(compiled.made)
