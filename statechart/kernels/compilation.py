"""How numba compiles kernels and their parts: every function is typed once, and optimised once.

numba by itself compiles a function again for every literal that a caller passes (an order of 0, 1,
2 are three types to it); makes machine code of every function, whoever calls it; and takes the code
of a function into each of its callers, where LLVM optimises it again, level by level. Here

- a function has one signature: a literal is a number, and a whole number has 64 bits;
- the code of a part is taken into kernels as it was written, and LLVM sees it there alone;
- a kernel that another kernel calls is called, not taken in: its machine code stands beside;
- what most runs never do is compiled when one does (`statechart.kernels.later`);
- what numba writes is shorter (`statechart.kernels.lowering`).

That kernels call others makes what is on disk of one depend on what is there of them (`Callee`).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from llvmlite.binding import Linkage
from numba import _dynfunc, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.environment import lookup_environment
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering

from statechart.kernels.later import Entered, Later, Signature
from statechart.kernels.lowering import References, Written


class Callee(NamedTuple):
    """A kernel that the machine code of another one calls."""

    # Where it stands.
    module: str
    name: str
    signature: Signature
    symbol: str  # What its machine code is called; another one whenever it is compiled again.

    @classmethod
    def of(cls, compiled: Any, signature: Signature) -> Callee:
        """Return a kernel that was compiled or loaded."""
        function = compiled.py_func
        symbol = compiled.overloads[signature].fndesc.mangled_name
        return cls(function.__module__, function.__name__, signature, symbol)

    def load(self) -> bool:
        """Have its machine code in memory; False if it is not the one that is called."""
        compiled = getattr(importlib.import_module(self.module), self.name).made
        compiled.compile(self.signature)
        return Callee.of(compiled, self.signature) == self


class _PartLibrary(JITCodeLibrary):
    """Code that is optimised in kernels."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalized = True


class _KernelLibrary(JITCodeLibrary):
    """Machine code of a kernel and all its parts."""

    callees: list[Callee]  # The kernels that it calls.
    later: set[Later]  # Those that are compiled when they are entered.
    _linking_libraries: list[Any]

    def finalize(self) -> None:
        found = _callers_first(self._linking_libraries)
        self.callees = [library.callee for library in found if _is_kernel(library)]
        self._linking_libraries = [library for library in found if not _is_kernel(library)]
        # Code of numba's own calls none.
        self.later = self.later.union(
            *(getattr(part, "later", ()) for part in self._linking_libraries)
        )
        super().finalize()

    def _optimize_final_module(self) -> None:
        # Nobody else calls the copies of parts in here: LLVM may take those with one call into it,
        # and leave out what they do not read of the many words that a tuple of arrays is.
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr:
                function.linkage = Linkage.internal
        super()._optimize_final_module()


def _is_kernel(library: Any) -> bool:
    return hasattr(library, "callee")


def _callers_first(libraries: list[Any]) -> list[Any]:
    """Return libraries, and those of all parts below them, each before those that it calls.

    LLVM's linker leaves out what nothing calls that it has seen.
    """
    seen: set[Any] = set()
    found: list[Any] = []

    def visit(library: Any) -> None:
        if library in seen:
            return
        seen.add(library)
        if isinstance(library, _PartLibrary):
            for below in library._linking_libraries:
                visit(below)
        found.append(library)

    for library in reversed(libraries):
        visit(library)
    return found[::-1]


class _Lowering(NativeLowering):
    """Lowers a function, without counting references where that can be."""

    _may_lend = False

    @property
    def lowering_class(self) -> Callable[..., Lower]:
        return partial(Written, self._references)

    def run_pass(self, state: Any) -> bool:
        state.library.later = set(_later(state))
        for called in state.library.later:
            called.note()
        self._references = References(state, may_lend=self._may_lend)
        changed = bool(super().run_pass(state))
        state.library.lends = self._references.lends
        return changed


def _later(state: Any) -> Iterator[Later]:
    """Find the kernels that a function, that has been typed, calls when they are entered."""
    for call, signature in state.calltypes.items():
        kind = state.typemap[call.func.name] if getattr(call, "op", "") == "call" else None
        if isinstance(kind, types.Function) and isinstance(kind.typing_key, Entered):
            yield Later.of(kind.typing_key.function, signature.args)


def _begin_library(state: Any, kind: type[JITCodeLibrary]) -> None:
    state.library = kind(state.targetctx.codegen(), state.func_id.func_qualname)
    state.library.enable_object_caching()


@register_pass(mutates_CFG=True, analysis_only=False)
class _KernelLowering(_Lowering):
    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        _begin_library(state, _KernelLibrary)
        super().run_pass(state)
        # Numba tells each function's own code where its Python objects are.
        for variable in state.library._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:
                state.library.codegen.set_env(variable.name, environment)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(_Lowering):
    _name = "part_lowering"
    _may_lend = True

    def run_pass(self, state: Any) -> bool:
        _begin_library(state, _PartLibrary)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        # What stands for a function that only compiled code calls has no address, as with numba's
        # own.
        entry = _dynfunc.make_function(
            lowered.fndesc.lookup_module(), lowered.fndesc.qualname, "", 0, lowered.env, ()
        )
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


def _passes(state: Any, lowering: type[NativeLowering]) -> list[Any]:
    """Return numba's passes, its lowering replaced."""
    manager = DefaultPassBuilder.define_nopython_pipeline(state)
    manager.passes = [
        (lowering if made is NativeLowering else made, why) for made, why in manager.passes
    ]
    manager._finalized = False
    manager.finalize()
    return [manager]


class KernelCompiler(CompilerBase):
    """Compiles a kernel."""

    def define_pipelines(self) -> list[Any]:
        """Return the passes that a function goes through."""
        return _passes(self.state, _KernelLowering)


class PartCompiler(CompilerBase):
    """Compiles a part of kernels, but for what LLVM does."""

    def define_pipelines(self) -> list[Any]:
        """Return the passes that a function goes through."""
        return _passes(self.state, _PartLowering)
