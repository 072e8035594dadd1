"""Functions that are compiled when they are called, or when that pays.

Nothing of numba is imported before: what calls no kernel, as drawing a statechart, starts in half
the time. A kernel that most runs call a few times only is `seldom` worth its compilation, which
takes some seconds: Python runs it as it is written, to the same bits, until it took `BRIEF` in all.
One that takes steps of a run may be run so for longer, while another process compiles it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar, cast

from statechart.errors import StatechartError
from statechart.kernels.kinds import (
    Deadline,
    Inner,
    Kernel,
    Late,
    Native,
    Seldom,
    Stepwise,
    is_cached,
    numba_is_there,
)

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


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
    """Let a function write the code of kernels that call it, as `numba.extending.intrinsic`."""
    return lambda function: Native(function, as_written)


def by_python(look: Callable[[], T]) -> T:
    """Return what a function returns whose kernels are all run by Python, as far as that can be.

    For a look at one step, which does not pay to compile it: sums and products of arrays may be
    rounded otherwise. Once that took too long it is tried no more.
    """
    Deadline.all_written = Deadline.patient and not Deadline.ahead
    try:
        return look()
    except StatechartError:
        raise
    except Exception as error:
        if not Deadline.all_written:
            raise
        Deadline.all_written = False
        Deadline.patient = not isinstance(error, TimeoutError)
        return look()
    finally:
        Deadline.all_written = False


@contextmanager
def meanwhile() -> Iterator[None]:
    """Let Python take the steps of a run while another process compiles what takes them.

    For what is run once: it takes as long as steps do that Python takes, and the next run finds
    what was compiled. Times of what is run so are those of Python.
    """
    outer, Deadline.meanwhile = Deadline.meanwhile, True
    try:
        yield
    finally:
        Deadline.meanwhile = outer


@contextmanager
def ahead_of_time() -> Iterator[None]:
    """Compile every kernel at its first call, for runs whose purpose is to fill the cache."""
    Deadline.ahead = True
    try:
        yield
    finally:
        Deadline.ahead = False


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
    if Deadline.ahead:
        return True
    return numba_is_there() and (bool(compiled.made.overloads) or is_cached(compiled))
