"""The kinds of kernels: what is compiled when, and what Python runs of them as it is written."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, update_wrapper
from time import thread_time
from types import FunctionType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from statechart.arrays import Array
    from statechart.kernels.maker import Maker

LOADING = 0.15
"""Seconds that Python may take for kernels before numba is imported, which takes as long; then what
lies on disk is used."""

LINKING = 0.02
"""Seconds that Python may take for a kernel where numba is imported: to load one takes as long."""

BRIEF = 0.25
"""Seconds that Python may take for a kernel that does not: to compile it takes one to ten."""

_TOGETHER = 0.1
"""Seconds that Python takes for steps at once: between them is looked whether it still has to."""

_LONGEST = 5.0
"""Seconds that Python may take for steps before they are given up: it takes a hundred times as long
as machine code, and impulses that are hard to find are sought in thousands of tries."""

# Python's own is rounded better than that of the C library, which compiled code calls.
_MATH = SimpleNamespace(**{**vars(math), "hypot": lambda x, y: float(np.hypot(x, y))})


class Compiled:
    """A function in the place of what numba makes of it.

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
    """A kernel, or a part of kernels.

    Attributes
    ----------
    entered : bool
        Whether Python has run it as it is written; known of those that are late.
    """

    entered = False

    @cached_property
    def below(self) -> dict[str, Kernel | Native]:
        """The kernels that it names, by name: those that it calls, and maybe others."""
        names = self.py_func.__globals__
        # Names of attributes are among these: one that is a kernel's, too, is in nobody's way.
        found = {name: names.get(name) for name in self.py_func.__code__.co_names}
        return {name: one for name, one in found.items() if isinstance(one, Kernel | Native)}

    @cached_property
    def as_written(self) -> Callable[..., Any]:
        """The function as Python runs it, with all that it calls.

        From `Deadline.at` on, those that call others are given up when they are called.
        """
        return self._linked("as_written", asks=bool(self.below) or isinstance(self, Late))

    @cached_property
    def in_steps(self) -> Callable[..., Any]:
        """The same, of which parts are not given up: to ask them takes a twentieth of a step."""
        return self._linked("in_steps", asks=self._how != "part")

    def _linked(self, how: str, *, asks: bool) -> Callable[..., Any]:
        space = {**self.py_func.__globals__, "math": _MATH}
        function = FunctionType(self.py_func.__code__, space, argdefs=self.py_func.__defaults__)

        def run(*arguments: Any) -> Any:
            self.entered = True
            # To ask the clock takes as long as a small kernel.
            if Deadline.at < math.inf and thread_time() > Deadline.at:
                raise TimeoutError
            return function(*arguments)

        # Known before those below it are looked for, of which it may be one.
        found = self.__dict__[how] = run if asks else function
        space.update((name, getattr(one, how)) for name, one in self.below.items())
        return found

    def __call__(self, *arguments: Any) -> Any:
        """Run the function, compiled, or as it is written where all are."""
        if not Deadline.all_written:
            return self.made(*arguments)
        Deadline.at = thread_time() + BRIEF
        try:
            with np.errstate(all="ignore"):
                return _plain(self.as_written(*arguments))
        finally:
            Deadline.at = math.inf


class Deadline:
    """How long Python has run kernels, and when what it runs is to be given up.

    Attributes
    ----------
    all_written : bool
        Whether it runs all of them.
    patient : bool
        Whether it never took too long to run them all.
    meanwhile : bool
        Whether it takes steps while another process compiles what takes them.
    ahead : bool
        Whether kernels are compiled at their first call, whatever that costs.
    """

    spent, at, all_written, patient, meanwhile, ahead = 0.0, math.inf, False, True, False, False


class Seldom(Kernel):
    """A kernel that Python runs until it has taken some time.

    Arrays that it writes to are arguments of their own.
    """

    _spent, _settled = 0.0, False

    @cached_property
    def _on_disk(self) -> bool:
        return is_cached(self)

    def __call__(self, *arguments: Any) -> Any:
        """Run the function, compiled or as it is written."""
        if self._settled:
            return self.made(*arguments)
        left = BRIEF - self._spent
        dear = self._spent >= LINKING if numba_is_there() else Deadline.spent >= LOADING
        if left <= 0.0 or Deadline.ahead or (dear and self._on_disk):
            self._settled = True
            return self.made(*arguments)
        given = {id(a): a for a in arguments if isinstance(a, np.ndarray)}
        copies = {key: array.copy() for key, array in given.items()}
        began = thread_time()
        Deadline.at = began + left
        try:
            with np.errstate(all="ignore"):
                result = self.as_written(*(copies.get(id(a), a) for a in arguments))
        except Exception:
            # It took too long, or it is an infinity or no number to compiled code alone.
            self._settled = True
        finally:
            took = thread_time() - began
            self._spent += took
            Deadline.spent += took
            Deadline.at = math.inf
        if self._settled:
            return self.made(*arguments)
        for key, array in given.items():
            if array.flags.writeable:
                array[...] = copies[key]
        return _plain(result)


class Stepwise(Kernel):
    """A kernel that takes steps, which Python may take until another process has compiled it."""

    _spent, _looked_at, _many, _settled = 0.0, 0.0, 1, False
    _maker: Maker | None = None

    def together(self, count: int) -> int:
        """Return how many of some steps are to be asked for in a call."""
        return count if self._is_made() else min(count, self._many)

    def _is_made(self) -> bool:
        """Whether its machine code is to be used."""
        if not self._settled and Deadline.meanwhile and self._spent >= self._looked_at:
            self._looked_at = self._spent + _TOGETHER
            if self._maker is not None:
                self._settled = self._maker.is_done()
            elif self._spent >= (LINKING if numba_is_there() else LOADING):
                self._settled = is_cached(self)
        return self._settled or not Deadline.meanwhile

    def __call__(self, *arguments: Any) -> Any:
        """Take steps, compiled or as it is written."""
        if Deadline.all_written or self._is_made():
            return super().__call__(*arguments)
        if self._maker is None and self._spent >= BRIEF:
            from statechart.kernels.maker import Maker

            self._maker = Maker(self, arguments)
        before = [(array, array.copy()) for array in _arrays(arguments)]
        began = thread_time()
        Deadline.at = began + _LONGEST
        try:
            with np.errstate(all="ignore"):
                return _plain(self.in_steps(*arguments))
        except Exception:
            # It took too long, or it is an infinity or no number to compiled code alone.
            self._settled = True
            for array, content in before:
                if array.flags.writeable:
                    array[...] = content
            return self.made(*arguments)
        finally:
            Deadline.at = math.inf
            took = thread_time() - began
            self._spent += took
            self._many = max(1, 2 * self._many if 4.0 * took < _TOGETHER else self._many // 2)


class Inner(Kernel):
    """A kernel that only kernels call: its machine code has no way in from Python."""

    def __call__(self, *arguments: Any) -> Any:
        """Run the function as it is written, where all are."""
        if not Deadline.all_written:
            name = self.py_func.__name__
            raise TypeError(
                f"only kernels call {name}: Python has no way into its machine code; "
                f"{name}.as_written(...) runs it in Python"
            )
        return super().__call__(*arguments)


class Late(Inner):
    """A kernel that is compiled when a run enters it, also where another kernel calls it."""

    @cached_property
    def called(self) -> Any:
        """The type by which numba knows it in kernels that call it."""
        from statechart.kernels import later

        return later.type_of(self.py_func)


class Native(Compiled):
    """A function of kernels that writes its own code."""

    def __init__(self, function: Callable[..., Any], as_written: Callable[..., Any]) -> None:
        super().__init__(function, "native")
        self.as_written = self.in_steps = as_written


def is_cached(compiled: Any) -> bool:
    """Whether a kernel lies compiled on disk, whole, for the files as they are."""
    from statechart.kernels import machine_code

    return machine_code.is_cached(compiled.made)


def numba_is_there() -> bool:
    """Whether something has had to import numba."""
    return "statechart.kernels.machine_code" in sys.modules


def _arrays(arguments: Iterable[Any]) -> Iterator[Array]:
    """Yield the arrays among arguments, in tuples, too."""
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            yield argument
        elif isinstance(argument, tuple):
            yield from _arrays(argument)


def _plain(result: Any) -> Any:
    """Return what compiled code returns: Python's numbers in the place of numpy's."""
    if isinstance(result, tuple):
        return tuple(_plain(item) for item in result)
    return result.item() if isinstance(result, np.generic) else result
