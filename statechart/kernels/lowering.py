"""The code of a function as LLVM gets it: what numba writes, without what nobody needs.

- References are counted to arrays that a function makes: whoever called it holds all others.
- A variable that is assigned once is a value, and has no place in memory.
- Tuples and arrays are put together where they are needed (`statechart.kernels.aggregates`).
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils, ir
from numba.core.analysis import compute_cfg_from_blocks, compute_use_defs
from numba.core.imputils import impl_ret_borrowed
from numba.core.lowering import Lower

from statechart.kernels.aggregates import Builder, Fields
from statechart.kernels.later import plain

# What gives an array, or a tuple of arrays, that somebody holds already.
_VIEWS = ("getitem", "static_getitem", "getattr", "build_tuple", "cast", "exhaust_iter", "getiter",
          "iternext", "pair_first", "pair_second", "phi")  # fmt: skip


class References:
    """Which variables of a function, that has been typed, hold references of their own.

    What a function is given is held by whoever called it, and so is all that it takes out of that;
    only what it makes itself, and what it gives back, needs to be counted. A part that gives back
    nothing but views of its arguments lends them to its caller, who holds them.

    Attributes
    ----------
    borrowing : set of str
        Variables whose references are not counted.
    counted : set of str
        Those whose references are.
    lends : bool
        Whether what is given back is held by the caller already.
    """

    def __init__(self, state: Any, *, may_lend: bool) -> None:
        self._models, self._kinds = state.targetctx.data_model_manager, state.typemap
        self._calls = state.calltypes
        blocks = state.func_ir.blocks.values()
        assigned = [
            one
            for block in blocks
            for one in block.find_insts(ir.Assign)
            if self._counted(one.target.name)
        ]
        returned = {one.value.name for block in blocks for one in block.find_insts(ir.Return)}
        self._owning: set[str] = set()
        self._spread(assigned)
        self.lends = may_lend and not self._owning & returned
        if not self.lends:
            self._owning |= returned
            self._spread(assigned)
        self.borrowing = {one.target.name for one in assigned} - self._owning
        self.counted = {one.target.name for one in assigned} & self._owning

    def _counted(self, name: str) -> bool:
        return bool(self._models[self._kinds[name]].contains_nrt_meminfo())

    def _spread(self, assigned: list[Any]) -> None:
        """Find what owns because of what does: a view holds what it looks at."""
        found = -1
        while found < len(self._owning):
            found = len(self._owning)
            self._owning |= {one.target.name for one in assigned if self._owns(one.value)}

    def _owns(self, value: Any) -> bool:
        if not isinstance(value, ir.Expr):
            return isinstance(value, ir.Var) and value.name in self._owning
        view = value.op in _VIEWS or (value.op == "call" and self._lent(value))
        # An array as an index chooses what is copied.
        view = view and not (value.op == "getitem" and self._counted(value.index.name))
        return not view or any(one.name in self._owning for one in value.list_vars())

    def _lent(self, call: Any) -> bool:
        kind = self._kinds[call.func.name]
        if isinstance(kind, types.BoundFunction):
            return str(kind.typing_key) == "array.reshape"
        return _lender(kind, self._calls[call])


def _lender(kind: Any, signature: Any) -> bool:
    """Whether a function is a part that lends what it gives back."""
    if not isinstance(kind, types.Dispatcher):
        return False
    compiled = kind.dispatcher.overloads.get(plain(signature.args))
    return compiled is not None and getattr(compiled.library, "lends", False)


def _lasting(blocks: dict[int, Any]) -> set[str]:
    """Return variables that are assigned once, before they are read in any block."""
    assigned: dict[str, list[int]] = {}
    for label, block in blocks.items():
        for one in block.find_insts(ir.Assign):
            assigned.setdefault(one.target.name, []).append(label)
    once = {name: labels[0] for name, labels in assigned.items() if len(labels) == 1}
    before = compute_cfg_from_blocks(blocks).dominators()
    for label, names in compute_use_defs(blocks).usemap.items():
        # Read before the block assigns it, if it does.
        for name in names & once.keys():
            if once[name] == label or once[name] not in before[label] or once[name] > label:
                del once[name]
    return set(once)


class Written(Lower):
    """Lowers a function, counting references to what it makes alone."""

    context: Any

    def __init__(self, references: References, *arguments: Any, **others: Any) -> None:
        # Only a compilation needs it: to import what it names takes a part of a warm start.
        from numba.np import arrayobj

        super().__init__(*arguments, **others)
        self._arrays = arrayobj
        self._borrowing = references.borrowing
        self._not_counting = self.context.subtarget(enable_nrt=False)
        self._lasting = _lasting(self.blocks) - references.counted
        self._singly_assigned_vars |= self._lasting

    def setup_function(self, fndesc: Any) -> None:
        """Begin a function."""
        super().setup_function(fndesc)
        self.builder = Builder(self.entry_block)
        self.call_helper = self.call_conv.init_call_helper(self.builder)

    def delvar(self, name: str) -> None:
        """End the life of a variable."""
        if name not in self._lasting:
            super().delvar(name)

    def lower_inst(self, inst: Any) -> None:
        """Write an instruction."""
        name = inst.value if isinstance(inst, ir.Del) else None
        if isinstance(inst, ir.Assign):
            name = inst.target.name
        counting = self.context
        if name in self._borrowing:
            self.context = self._not_counting
        super().lower_inst(inst)
        self.context = counting

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        """Write what is assigned."""
        if expr.op == "getattr" and expr.attr == "shape" and self._is_array(expr.value.name):
            return self._fields(expr.value.name).shape
        return super().lower_expr(resty, expr)

    def lower_getitem(self, resty: Any, expr: Any, value: Any, index: Any, signature: Any) -> Any:
        """Write what an array has at an index: a number, or a view."""
        found = self._place(value.name, index.name)
        if found is None:
            return super().lower_getitem(resty, expr, value, index, signature)
        array, place, shape, strides = found
        if not isinstance(resty, types.Array):
            kind = self.typeof(value.name)
            return self._arrays.load_item(self.context, self.builder, kind, place)
        view = Fields(self.context, self.builder, resty)
        self._arrays.populate_array(
            view, place, shape, strides, array.itemsize, array.meminfo, array.parent
        )
        return impl_ret_borrowed(self.context, self.builder, resty, view.whole())

    def lower_setitem(self, target: Any, index: Any, value: Any, signature: Any) -> Any:
        """Write that an array is given a number."""
        found = self._place(target.name, index.name)
        if found is None or found[2]:
            return super().lower_setitem(target, index, value, signature)
        kind, given = self.typeof(target.name), self.typeof(value.name)
        item = self.context.cast(self.builder, self.loadvar(value.name), given, kind.dtype)
        return self._arrays.store_item(self.context, self.builder, kind, item, found[1])

    def _is_array(self, name: str) -> bool:
        return isinstance(self.typeof(name), types.Array)

    def _fields(self, name: str) -> Fields:
        return Fields(self.context, self.builder, self.typeof(name), self.loadvar(name))

    def _place(self, name: str, index: str) -> Any:
        """Return the members of an array of numbers, and where what it has at an index is.

        With the shape and strides of that. None where the index is not one of numbers and slices.
        """
        kind, chosen = self.typeof(name), self.typeof(index)
        several = isinstance(chosen, types.BaseTuple)
        kinds = chosen.types if several else [chosen]
        if not (
            self._is_array(name)
            and isinstance(kind.dtype, types.Number | types.Boolean)
            and all(isinstance(one, types.Integer | types.SliceType) for one in kinds)
        ):
            return None
        array, indices = self._fields(name), [self.loadvar(index)]
        if several:
            indices = cgutils.unpack_tuple(self.builder, *indices, count=len(kinds))
        check = self.context.enable_boundscheck
        return array, *self._arrays.basic_indexing(
            self.context, self.builder, kind, array, kinds, indices, boundscheck=check
        )

    def _lower_call_normal(self, function: Any, expression: Any, signature: Any) -> Any:
        if getattr(function, "typing_key", None) is len and self._is_array(expression.args[0].name):
            return self.builder.extract_value(self._fields(expression.args[0].name).shape, 0)
        result = super()._lower_call_normal(function, expression, signature)
        if _lender(function, signature):
            self.incref(signature.return_type, result)
        return result
