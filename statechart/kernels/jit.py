"""Functions that are compiled when they are called, or when that pays.

Nothing of numba is imported before: what calls no kernel, as drawing a statechart, starts in half
the time. A kernel that most runs call a few times only is `seldom` worth its compilation, which
takes some seconds: Python runs it as it is written, to the same bits, until it took `BRIEF` in all.
One that takes steps of a run may be run so for longer, while another process compiles it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property, update_wrapper
from time import thread_time
from types import FunctionType, SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from statechart.errors import StatechartError

if TYPE_CHECKING:
    from statechart.arrays import Array
    from statechart.kernels.maker import Maker

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

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
    """A kernel, or a part of kernels.

    Attributes
    ----------
    entered : bool
        Whether Python has run it as it is written; known of those that call others or are late.
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

        From `_Deadline.at` on, those that call others are given up when they are called.
        """
        space = {**self.py_func.__globals__, "math": _MATH}
        code, below = self.py_func.__code__, self.below
        function = FunctionType(code, space, argdefs=self.py_func.__defaults__)

        def run(*arguments: Any) -> Any:
            self.entered = True
            # To ask the clock takes as long as a small kernel.
            if _Deadline.at < math.inf and thread_time() > _Deadline.at:
                raise TimeoutError
            return function(*arguments)

        # Known before those below it are looked for, of which it may be one.
        found = self.__dict__["as_written"] = run if below or isinstance(self, Late) else function
        space.update((name, one.as_written) for name, one in below.items())
        return found

    def __call__(self, *arguments: Any) -> Any:
        """Run the function, compiled, or as it is written where all are."""
        if not _Deadline.all_written:
            return self.made(*arguments)
        _Deadline.at = thread_time() + BRIEF
        try:
            with np.errstate(all="ignore"):
                return _plain(self.as_written(*arguments))
        finally:
            _Deadline.at = math.inf


class _Deadline:
    """How long Python has run kernels, and when what it runs is to be given up.

    Attributes
    ----------
    all_written : bool
        Whether it runs all of them.
    patient : bool
        Whether it never took too long to run them all.
    meanwhile : bool
        Whether it takes steps while another process compiles what takes them.
    """

    spent, at, all_written, patient, meanwhile = 0.0, math.inf, False, True, False


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
        dear = self._spent >= LINKING if _numba_is_there() else _Deadline.spent >= LOADING
        if left <= 0.0 or (dear and self._on_disk):
            self._settled = True
            return self.made(*arguments)
        given = {id(a): a for a in arguments if isinstance(a, np.ndarray)}
        copies = {key: array.copy() for key, array in given.items()}
        began = thread_time()
        _Deadline.at = began + left
        try:
            with np.errstate(all="ignore"):
                result = self.as_written(*(copies.get(id(a), a) for a in arguments))
        except Exception:
            # It took too long, or it is an infinity or no number to compiled code alone.
            self._settled = True
        finally:
            took = thread_time() - began
            self._spent += took
            _Deadline.spent += took
            _Deadline.at = math.inf
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
        if not self._settled and _Deadline.meanwhile and self._spent >= self._looked_at:
            self._looked_at = self._spent + _TOGETHER
            if self._maker is not None:
                self._settled = self._maker.is_done()
            elif self._spent >= (LINKING if _numba_is_there() else LOADING):
                self._settled = is_cached(self)
        return self._settled or not _Deadline.meanwhile

    def __call__(self, *arguments: Any) -> Any:
        """Take steps, compiled or as it is written."""
        if _Deadline.all_written or self._is_made():
            return super().__call__(*arguments)
        if self._maker is None and self._spent >= BRIEF:
            from statechart.kernels.maker import Maker

            self._maker = Maker(self, arguments)
        before = [(array, array.copy()) for array in _arrays(arguments)]
        began = thread_time()
        _Deadline.at = began + _LONGEST
        try:
            with np.errstate(all="ignore"):
                return _plain(self.as_written(*arguments))
        except Exception:
            # It took too long, or it is an infinity or no number to compiled code alone.
            self._settled = True
            for array, content in before:
                if array.flags.writeable:
                    array[...] = content
            return self.made(*arguments)
        finally:
            _Deadline.at = math.inf
            took = thread_time() - began
            self._spent += took
            self._many = max(1, 2 * self._many if 4.0 * took < _TOGETHER else self._many // 2)


class Inner(Kernel):
    """A kernel that only kernels call: its machine code has no way in from Python."""

    def __call__(self, *arguments: Any) -> Any:
        """Run the function as it is written, where all are."""
        if not _Deadline.all_written:
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
    """A function of kernels that writes its own code.

    Parameters
    ----------
    function : callable
        Writes it.
    as_written : callable
        Does the same in Python.
    """

    def __init__(self, function: Callable[..., Any], as_written: Callable[..., Any]) -> None:
        super().__init__(function, "native")
        self.as_written = as_written


def kernel(function: F) -> F:
    """Compile a function when it is first called, from Python or from other kernels; cached."""
    return cast(F, Kernel(function, "kernel"))


def seldom(function: F) -> F:
    """Compile a function as `kernel` does, when that pays.

    It must give the same bits as it is written: so no sums and products of whole arrays, which
    numpy takes in another order, no powers but those of floats, and no complex numbers.
    """
    return cast(F, Seldom(function, "kernel"))


def stepwise(function: Callable[..., Any]) -> Stepwise:
    """Compile a function as `kernel` does; within `meanwhile`, in another process.

    Its first result is how many steps it took, and it gives the same bits as it is written; see
    `seldom`. Whoever calls it asks it how many steps it takes `together`.
    """
    return Stepwise(function, "kernel")


def late(function: F) -> F:
    """Compile a function as `kernel` does, but when it is entered, and not with those that call it.

    For what many runs never do; only kernels call it. It returns numbers or tuples of numbers,
    which its annotation says.
    """
    return cast(F, Late(function, "beside"))


def beside(function: F) -> F:
    """Compile a function that only kernels call, once for all of them.

    That it cannot be called from Python, with arrays to unpack, saves up to a third of its
    compilation.
    """
    return cast(F, Inner(function, "beside"))


def part(function: F) -> F:
    """Compile a function that only kernels call, into each of them."""
    return cast(F, Inner(function, "part"))


def native(as_written: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Let a function write the code of kernels that call it, as `numba.extending.intrinsic`.

    Parameters
    ----------
    as_written : callable
        Does the same in Python.
    """
    return lambda function: Native(function, as_written)


def by_python(look: Callable[[], T]) -> T:
    """Return what a function returns whose kernels are all run by Python, as far as that can be.

    For a look at one step, which does not pay to compile it: sums and products of arrays may be
    rounded otherwise. Once that took too long it is tried no more.
    """
    _Deadline.all_written = _Deadline.patient
    try:
        return look()
    except StatechartError:
        raise
    except Exception as error:
        if not _Deadline.all_written:
            raise
        _Deadline.all_written = False
        _Deadline.patient = not isinstance(error, TimeoutError)
        return look()
    finally:
        _Deadline.all_written = False


@contextmanager
def meanwhile() -> Iterator[None]:
    """Let Python take the steps of a run while another process compiles what takes them.

    For what is run once: it takes as long as steps do that Python takes, and the next run finds
    what was compiled. Times of what is run so are those of Python.
    """
    outer, _Deadline.meanwhile = _Deadline.meanwhile, True
    try:
        yield
    finally:
        _Deadline.meanwhile = outer


def entry(compiled: Any, *arguments: Any) -> Callable[..., Any]:
    """Return the machine code of a kernel for arguments of these types.

    It takes what it is given for the same types again: to look takes three times as long as to pass
    sixty arrays in tuples.
    """
    from statechart.kernels import machine_code

    found: Callable[..., Any] = machine_code.entry(compiled.made, arguments)
    return found


def is_ready(compiled: Any) -> bool:
    """Whether a kernel is compiled, or lies on disk, in a process that has had to import numba."""
    if not _numba_is_there():
        return False
    return bool(compiled.made.overloads) or is_cached(compiled)


def is_cached(compiled: Any) -> bool:
    """Whether a kernel lies compiled on disk, whole, for the files as they are."""
    from statechart.kernels import machine_code

    return machine_code.is_cached(compiled.made)


def _numba_is_there() -> bool:
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
