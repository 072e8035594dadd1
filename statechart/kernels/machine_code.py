"""Kernels kept on disk, across several files, and the functions of numba that run them.

numba's cache looks only at the file of the function that is called: where that calls kernels of
another file, an edit there would silently run the old code. Here a kernel's cache is of the content
of all files whose kernels it can see, and of what says how kernels are compiled; where these lie,
and since when, does not matter.

Of processes that begin together one compiles a kernel, and the others wait for what it leaves on
disk: were each to compile it, what calls it would be of use only to the one that was the last.

A file of the cache that was cut off or damaged, that another version left, or that cannot be
written, must not end a run: each carries a digest of its content, and what does not agree with its
own, or names what is no longer there, is compiled again.
"""

from __future__ import annotations

import hashlib
import io
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

from numba import njit, typeof
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.compiler import compile_result
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.core.typing.typeof import typeof_impl
from numba.extending import intrinsic

from statechart import compiling, interrupts
from statechart.kernels.aggregates import Builder
from statechart.kernels.compilation import Callee, KernelCompiler, PartCompiler
from statechart.kernels.kinds import Compiled, Kernel, Late
from statechart.kernels.later import Signature, plain, returned
from statechart.kernels.lowering import Written

try:
    import fcntl
except ImportError:  # Windows, where each process compiles for itself
    fcntl = None  # type: ignore[assignment]

_DIGEST = 16  # bytes: damage is an accident, not an attack

# Seconds between looks at whether another process has compiled a kernel, and until it is thought to
# have stopped: none of ours takes half as long.
_LOOK = 0.05
_PATIENCE = 120.0

# One of each file that says how kernels are compiled.
_MAKERS = (returned, Callee.of, Written.setup_function, Builder.extract_value)


class _DigestedFile(IndexDataCacheFile):
    """Index and data of a kernel, each file with a digest of the rest at its end."""

    def _load_index(self) -> Any:
        return self._read(super()._load_index, self._index_path, {})

    def _load_data(self, name: str) -> Any:
        # None is what is not in the cache; unpickling takes no notice of what follows.
        return self._read(partial(super()._load_data, name), self._data_path(name), None)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        data = content.getvalue()
        with super()._open_for_write(filepath) as stream:
            stream.write(data + _digest(data))

    @staticmethod
    def _read(load: Callable[[], Any], path: str, nothing: Any) -> Any:
        """Return what is kept at a path; what cannot be read is removed."""
        try:
            data = Path(path).read_bytes()
        except OSError:
            return nothing
        if data[-_DIGEST:] == _digest(data[:-_DIGEST]):
            # Types may have had other names and places.
            with suppress(ImportError, AttributeError):
                return load()
        with suppress(OSError):
            os.unlink(path)
        return nothing


class _Turn:
    """The one process that compiles a kernel, as far as files can be locked.

    Entered before a kernel is loaded or compiled, left after it was kept.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._place: int | None = None

    def take(self) -> None:
        """Let no other process compile it from now on, once none does."""
        if fcntl is None or self._place is not None:
            return
        # A folder that may not be written, or a disk of a network without locks.
        with suppress(OSError):
            os.makedirs(os.path.dirname(self._path), exist_ok=True)
            self._place = place = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            if not _locked(place):
                with compiling.whole(compiling.KERNELS):
                    until = time.monotonic() + _PATIENCE
                    while not _locked(place) and time.monotonic() < until:
                        time.sleep(_LOOK)

    def __enter__(self) -> None:
        """Take it only where there is something to compile."""

    def __exit__(self, *_: object) -> None:
        """Let others."""
        if self._place is not None:
            os.close(self._place)
            self._place = None


def _locked(place: int) -> bool:
    """Lock a file as long as it is open; False if another process has."""
    try:
        fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class _Stored(CompileResultCacheImpl):
    """What a kernel is kept as: the kernels that it calls, its machine code, and how to call it.

    Numba would also keep code to take into others, the text of all types, and what functions of its
    own need to raise objects: to load that, and to import what it names, took half a warm start.
    """

    def reduce(self, result: Any) -> Any:
        library, described = result.library, result.fndesc
        # They are of use while a function is compiled.
        described.typemap = described.calltypes = None
        objects = [
            found
            for found in result._find_referenced_environments()
            if found.globals["__name__"].partition(".")[0] != "numba"
        ]
        entries = {described.llvm_cpython_wrapper_name, described.mangled_name}
        defined = {name for name in entries if library.codegen._engine.is_symbol_defined(name)}
        machine_code = library.name, library._get_compiled_object(), defined
        own = described, result.environment, result.signature, objects
        return library.callees, library.later, machine_code, own

    def rebuild(self, target_context: Any, stored: Any) -> Any:
        callees, later, (name, machine_code, defined), own = stored
        described, environment, signature, objects = own
        if not all(callee.load() for callee in callees):
            raise LookupError("a kernel that this one calls was compiled again")
        for called in later:
            called.note()
        library = target_context.codegen().create_library(name)
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        library.codegen._engine._defined_symbols |= defined
        for found in objects:
            library.codegen.set_env(found.env_name, found)
        return compile_result(
            target_context=target_context,
            typing_context=target_context.typing_context,
            library=library,
            environment=environment,
            entry_point=target_context.get_executable(library, described, environment),
            fndesc=described,
            signature=signature,
            objectmode=False,
            lifted=(),
            reload_init=(),
            referenced_envs=objects,
        )


class _Cache(FunctionCache):
    """numba's cache of one function, without which everything works, too."""

    _impl_class = _Stored

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamps: dict[str, bytes] = {}
        for one in (*_MAKERS, function):
            _collect(one, stamps)
        self._cache_file: Any = _DigestedFile(
            self._cache_path, self._impl.filename_base, tuple(sorted(stamps.items()))
        )
        place = os.path.join(self._cache_path, f"{self._impl.filename_base}.lock")
        self.turn = _Turn(place)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._loaded(sig, target_context)
        if found is None:
            self.turn.take()
            # Another process may have compiled it meanwhile.
            found = self._loaded(sig, target_context)
        return found

    def _loaded(self, sig: Any, target_context: Any) -> Any:
        # What another version of a library wrote may be whole, and of no use.
        with suppress(Exception):
            # Machine code needs what numba's runtime offers, and not the registries that a
            # compilation refreshes: to import those takes a third of a warm start.
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        # A full disk, or a folder that may not be written any more.
        with suppress(OSError):
            super().save_overload(sig, data)


class _Told(event.Listener):
    """Tells `statechart.compiling` of every function that numba compiles for a kernel."""

    def on_start(self, event: Any) -> None:
        compiled = event.data["dispatcher"]
        compiling.begin(compiling.KERNELS, lambda: len(_missing(compiled, {})))

    def on_end(self, event: Any) -> None:
        made = event.data["dispatcher"]._compiler.pipeline_class
        compiling.end(made in (KernelCompiler, PartCompiler))


event.register("numba:compile", _Told())


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=_DIGEST).digest()


@cache
def _content(file: Path, changed: float, size: int) -> bytes:
    """Return the digest of a file that was last changed then."""
    return _digest(file.read_bytes())


def kernel(function: Callable[..., Any]) -> Any:
    """Return what compiles a function when it is first called; cached."""
    return _kept(function)


def beside(function: Callable[..., Any]) -> Any:
    """Return what compiles a function that only kernels call, when they do; cached."""
    return _kept(function, no_cpython_wrapper=True)


def _kept(function: Callable[..., Any], **options: bool) -> Any:
    # Without what C would need to call it, it compiles sooner.
    compiled = njit(
        error_model="numpy", no_cfunc_wrapper=True, pipeline_class=KernelCompiler, **options
    )(function)
    # Where no folder can be written numba has no cache to offer.
    with suppress(RuntimeError):
        compiled._cache = _Cache(function)
    compile_ = compiled.compile

    def compile_plain(signature: Signature) -> Any:
        # Signals end a compilation at once: it may take half a minute.
        turn = getattr(compiled._cache, "turn", nullcontext())
        with interrupts.let_through(), turn:
            entry = compile_(plain(signature))
        compiled.overloads[plain(signature)].library.callee = Callee.of(compiled, plain(signature))
        return entry

    compiled.compile = compile_plain
    return compiled


def part(function: Callable[..., Any]) -> Any:
    """Return what compiles a function that only kernels call, into each of them."""
    compiled = njit(
        error_model="numpy",
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        pipeline_class=PartCompiler,
    )(function)
    compile_ = compiled.compile
    compiled.compile = lambda signature: compile_(plain(signature))
    return compiled


def native(function: Callable[..., Any]) -> Any:
    """Return a function that writes its own LLVM code."""
    made = intrinsic(function)
    # Made while what calls it is compiled, it would be seen by the next compilation only.
    cpu_target.typing_context.refresh()
    return made


@typeof_impl.register(Compiled)
def _type(value: Compiled, context: Any) -> Any:
    """Let kernels see in another kernel what numba made of it."""
    if isinstance(value, Late):
        return value.called
    return cpu_target.typing_context.resolve_value_type(value.made)


def entry(made: Any, arguments: tuple[Any, ...]) -> Any:
    """Return the machine code of a kernel for arguments of these types, compiled or loaded."""
    return made.compile(tuple([typeof(argument) for argument in arguments]))


def is_cached(made: Any) -> bool:
    """Whether a kernel lies compiled on disk, whole, for the files as they are."""
    file = getattr(made._cache, "_cache_file", None)
    return file is not None and bool(file._load_index())


def _missing(compiled: Any, found: dict[Any, None]) -> dict[Any, None]:
    """Return kernels and parts that are compiled with one, those that lie on disk left out."""
    if compiled in found or compiled.overloads or is_cached(compiled):
        return found
    found[compiled] = None
    names = compiled.py_func.__globals__
    for name in compiled.py_func.__code__.co_names:
        if isinstance(names.get(name), Kernel) and not isinstance(names[name], Late):
            _missing(names[name].made, found)
    return found


def _collect(function: Callable[..., Any], stamps: dict[str, bytes]) -> None:
    if function.__module__ in stamps:
        return
    file = Path(function.__code__.co_filename)
    found = file.stat()
    stamps[function.__module__] = _content(file, found.st_mtime, found.st_size)
    for value in function.__globals__.values():
        if isinstance(value, Kernel):
            _collect(value.py_func, stamps)
