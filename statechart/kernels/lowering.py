"""Lowering of kernels, with private classes of numba: `njit` as it is counts too many references.

- A function counts references to arrays that it makes or returns: its caller holds the others.
- Tuples of arrays are hundreds of words. They are put together only where one value is needed.
- LLVM optimises a kernel that kernels call once, as part of the kernel that Python calls.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from functools import partial
from typing import Any

from llvmlite import ir as llvm
from llvmlite.binding import Linkage, parse_assembly, set_option
from numba import _dynfunc, types
from numba.core import ir
from numba.core.analysis import compute_cfg_from_blocks, compute_use_defs
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, CompileResult, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.environment import lookup_environment
from numba.core.lowering import Lower
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.core.typed_passes import NativeLowering

# Expressions that give an array, or a tuple of arrays, that somebody holds already.
_VIEWS = ("getitem", "static_getitem", "getattr", "build_tuple", "cast", "exhaust_iter", "getiter",
          "iternext", "pair_first", "pair_second", "phi")  # fmt: skip
# Passes for what kernels have not: closures, and loops that formulas of whole arrays share.
_IDLE = ("inline_closure_likes", "inline_overloads", "nopython_rewrites")


class _References:
    """Variables of a typed function that hold nothing but views of arguments, and all others.

    A function `lends` its result if that is a view of arguments.
    """

    def __init__(self, state: Any, *, may_lend: bool) -> None:
        self._models = state.targetctx.data_model_manager
        self._kinds, self._calls = state.typemap, state.calltypes
        blocks = state.func_ir.blocks.values()
        every = [one for block in blocks for one in block.find_insts(ir.Assign)]
        assigned = [one for one in every if self._has_references(one.target.name)]
        returned = {one.value.name for block in blocks for one in block.find_insts(ir.Return)}
        self.counted: set[str] = set()
        self._spread(assigned)
        self.lends = may_lend and not self.counted & returned
        if not self.lends:
            self.counted |= returned
            self._spread(assigned)
        self.borrowing = {one.target.name for one in assigned} - self.counted
        # Numbers unpacked from an array, whose iterator lasts no longer than that.
        taken = {one.target.name for one in every if getattr(one.value, "op", 0) == "exhaust_iter"}
        self.borrowing |= {name for name in taken if not self._has_references(name)}

    def _has_references(self, name: str) -> bool:
        return bool(self._models[self._kinds[name]].contains_nrt_meminfo())

    def _spread(self, assigned: list[Any]) -> None:
        # A view of what is counted is counted.
        while new := {x.target.name for x in assigned if self._is_counted(x.value)} - self.counted:
            self.counted |= new

    def _is_counted(self, value: Any) -> bool:
        if not isinstance(value, ir.Expr):
            return isinstance(value, ir.Var) and value.name in self.counted
        view = value.op in _VIEWS or (value.op == "call" and self._is_view(value))
        # An array as an index chooses what is copied.
        view = view and not (value.op == "getitem" and self._has_references(value.index.name))
        return not view or any(one.name in self.counted for one in value.list_vars())

    def _is_view(self, call: Any) -> bool:
        kind = self._kinds[call.func.name]
        if isinstance(kind, types.BoundFunction):
            return str(kind.typing_key) == "array.reshape"
        return isinstance(kind, types.NamedTupleClass) or _lends(kind, self._calls[call])


def _lends(kind: Any, signature: Any) -> bool:
    """Return whether a function is a kernel whose result is a view of its arguments."""
    if not isinstance(kind, types.Dispatcher):
        return False
    compiled = kind.dispatcher.overloads.get(plain(signature.args))
    return compiled is not None and getattr(compiled.library, "lends", False)


def _lasting(blocks: dict[int, Any]) -> set[str]:
    """Return variables that are assigned once, in a block that all blocks that read them follow."""
    assigned: dict[str, list[int]] = {}
    for label, block in blocks.items():
        for one in block.find_insts(ir.Assign):
            assigned.setdefault(one.target.name, []).append(label)
    once = {name: labels[0] for name, labels in assigned.items() if len(labels) == 1}
    before = compute_cfg_from_blocks(blocks).dominators()
    for label, names in compute_use_defs(blocks).usemap.items():
        for name in names & once.keys():
            if once[name] not in before[label] - {label} or once[name] > label:
                del once[name]
    return set(once)


class _Aggregate(llvm.Value):
    """A value whose members are known, and that no code puts together yet."""

    def __init__(self, base: Any, members: dict[int, Any]) -> None:
        self.type, self.base, self.members = base.type, base, members


class _Builder(llvm.IRBuilder):
    """Writes the code of a function; puts values together where an instruction needs them."""

    def insert_value(self, agg: Any, value: Any, idx: Any, name: str = "") -> Any:
        first, *deeper = [idx] if isinstance(idx, int) else idx
        if deeper:
            value = self.insert_value(self.extract_value(agg, first), value, deeper)
        if isinstance(agg, _Aggregate):
            return _Aggregate(agg.base, {**agg.members, first: value})
        return _Aggregate(agg, {first: value})

    def extract_value(self, agg: Any, idx: Any, name: str = "") -> Any:
        indices = [idx] if isinstance(idx, int) else idx
        for i, index in enumerate(indices):
            if not isinstance(agg, _Aggregate):
                return super().extract_value(agg, indices[i:], name=name)
            if index in agg.members:
                agg = agg.members[index]
            else:
                agg = super().extract_value(agg.base, index)
        return agg

    def _insert(self, instr: Any) -> None:
        if any(isinstance(operand, _Aggregate) for operand in instr.operands):
            instr.operands = [self._whole(operand) for operand in instr.operands]
        super()._insert(instr)

    def _whole(self, value: Any) -> Any:
        if not isinstance(value, _Aggregate):
            return value
        whole = value.base
        for index, member in value.members.items():
            whole = llvm.instructions.InsertValue(self.block, whole, self._whole(member), [index])
            super()._insert(whole)
        return whole


class _Lower(Lower):
    """Lowers a function without counting references to what it borrows."""

    context: Any

    def __init__(self, references: _References, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self._borrowing = references.borrowing
        self._not_counting = self.context.subtarget(enable_nrt=False)
        self._lasting = _lasting(self.blocks) - references.counted
        self._singly_assigned_vars |= self._lasting

    def setup_function(self, fndesc: Any) -> None:
        super().setup_function(fndesc)
        self.builder = _Builder(self.entry_block)
        self.call_helper = self.call_conv.init_call_helper(self.builder)

    def delvar(self, name: str) -> None:
        if name not in self._lasting:
            super().delvar(name)

    def lower_inst(self, inst: Any) -> None:
        # A `Del` has a name as its value.
        name = inst.target.name if isinstance(inst, ir.Assign) else getattr(inst, "value", None)
        counting = self.context
        self.context = self._not_counting if name in self._borrowing else counting
        super().lower_inst(inst)
        self.context = counting

    def _lower_call_normal(self, function: Any, expression: Any, signature: Any) -> Any:
        result = super()._lower_call_normal(function, expression, signature)
        if _lends(function, signature):
            self.incref(signature.return_type, result)
        return result


class _Library(JITCodeLibrary):
    """Code of a kernel: a part of others as lowered, or machine code with all its parts."""

    is_part = lends = False
    _linking_libraries: list[Any]

    def _optimize_functions(self, module: Any) -> None:
        # LLVM optimises them with the whole.
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        if self.is_part:
            self._finalized = True
            return
        self._linking_libraries = _callers_first(self._linking_libraries)
        super().finalize()

    def _optimize_final_module(self) -> None:
        # No other module calls the functions in here.
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr:
                function.linkage = Linkage.internal
        # Unrolled, loops of unknown length would double the code. LLVM's options are the process's.
        set_option("", "-unroll-runtime=false")
        super()._optimize_final_module()
        set_option("", "-unroll-runtime=true")

    def _get_module_for_linking(self) -> Any:
        if self.is_part:
            return super()._get_module_for_linking()
        # On disk numba keeps the code, to inline it elsewhere; names of what is called will do.
        defined = (
            f'define void @"{function.name}"() {{ ret void }}'
            for function in self._final_module.functions
            if function.linkage == Linkage.external and not function.is_declaration
        )
        return parse_assembly("\n".join(defined))


def _callers_first(libraries: list[Any]) -> list[Any]:
    """Return libraries and those below: LLVM's linker leaves out what no one before it calls."""
    found: dict[Any, None] = {}

    def visit(library: Any) -> None:
        if library not in found:
            for below in library._linking_libraries if getattr(library, "is_part", False) else ():
                visit(below)
            found[library] = None

    for library in reversed(libraries):
        visit(library)
    return list(found)[::-1]


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    _name = "kernel_lowering"

    @property
    def lowering_class(self) -> Callable[..., Lower]:
        return partial(_Lower, self._references)

    def run_pass(self, state: Any) -> bool:
        library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        library.enable_object_caching()
        library.is_part = state.flags.no_compile = bool(state.flags.no_cpython_wrapper)
        self._references = _References(state, may_lend=library.is_part)
        library.lends, state.library = self._references.lends, library
        super().run_pass(state)
        if library.is_part:
            # It has no address; some object has to stand for it.
            lowered = state["cr"]
            entry = _dynfunc.make_function(
                lowered.fndesc.lookup_module(), lowered.fndesc.qualname, "", 0, lowered.env, ()
            )
            state.targetctx.insert_user_function(entry, lowered.fndesc, [library])
            state["cr"] = lowered._replace(cfunc=entry)
            return True
        # Exceptions are made from the globals of each function.
        for variable in library._final_module.global_variables:
            if (environment := lookup_environment(variable.name)) is not None:
                library.codegen.set_env(variable.name, environment)
        return True


class KernelCompiler(CompilerBase):
    """Numba's passes with our lowering."""

    def define_pipelines(self) -> list[Any]:
        """Return the passes."""
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.passes = [
            (_Lowering if one is NativeLowering else one, why)
            for one, why in manager.passes
            if one._name not in _IDLE
        ]
        manager.finalize()
        return [manager]


def to_bytes(result: Any) -> bytes | None:
    """Return compiled code as it is kept on disk; None where it holds addresses."""
    return None if result.library.has_dynamic_globals else dumps(result._reduce())


def from_bytes(data: bytes, context: Any) -> Any:
    """Return compiled code that was kept."""
    rtsys.initialize(context)
    return CompileResult._rebuild(context, *pickle.loads(data))


def plain(signature: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the types of arguments that a function is compiled for: no literals, one integer."""
    kinds = (types.unliteral(kind) for kind in signature)
    return tuple(types.int64 if isinstance(kind, types.Integer) else kind for kind in kinds)
