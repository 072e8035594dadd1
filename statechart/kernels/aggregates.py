"""Tuples and arrays as numba hands them on, without the code that puts them together.

To LLVM a tuple of arrays is some hundreds of words. numba puts those that a function is given
together to one value, word by word, and takes it apart, word by word, wherever it is handed on: of
the code of a step of bodies three quarters were that. Here words stay apart until one value is
needed. LLVM does the same to numba's code, much later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from llvmlite import ir


class Aggregate(ir.Value):
    """A value whose members are known, and that no code puts together yet."""

    def __init__(self, base: Any, members: dict[int, Any]) -> None:
        self.type, self.base, self.members = base.type, base, members

    def get_reference(self) -> str:
        """Refuse to be named: there is no code of it."""
        raise NotImplementedError("a value that is not put together has no name")


class Builder(ir.IRBuilder):
    """Writes the code of a function; puts values together where an instruction needs them."""

    def insert_value(self, agg: Any, value: Any, idx: Any, name: str = "") -> Any:
        """Return an aggregate with another member."""
        first, *deeper = _indices(idx)
        if deeper:
            value = self.insert_value(self.extract_value(agg, first), value, deeper)
        wanted = agg.type.elements[first]
        if value.type is not wanted and value.type != wanted:
            raise TypeError(f"a member of type {wanted} cannot be {value.type}")
        if isinstance(agg, Aggregate):
            return Aggregate(agg.base, {**agg.members, first: value})
        return Aggregate(agg, {first: value})

    def extract_value(self, agg: Any, idx: Any, name: str = "") -> Any:
        """Return a member of an aggregate."""
        indices = _indices(idx)
        for i, index in enumerate(indices):
            if not isinstance(agg, Aggregate):
                return super().extract_value(agg, indices[i:], name=name)
            if index in agg.members:
                agg = agg.members[index]
            elif isinstance(agg.base, ir.Constant) and agg.base.constant is ir.Undefined:
                agg = ir.Constant(agg.type.elements[index], ir.Undefined)
            else:
                agg = super().extract_value(agg.base, index)
        return agg

    def _insert(self, instr: Any) -> None:
        if any(isinstance(operand, Aggregate) for operand in instr.operands):
            instr.operands = [self._whole(operand) for operand in instr.operands]
        super()._insert(instr)

    def _whole(self, value: Any) -> Any:
        """Put a value together here."""
        if not isinstance(value, Aggregate):
            return value
        whole = value.base
        for index, member in value.members.items():
            made = ir.instructions.InsertValue(self.block, whole, self._whole(member), [index])
            super()._insert(made)
            whole = made
        return whole


def _indices(index: int | Sequence[int]) -> list[int]:
    return [index] if isinstance(index, int) else list(index)


class Fields:
    """The members of an array, by numba's names, where numba's own lie in memory."""

    def __init__(self, context: Any, builder: Builder, kind: Any, value: Any = None) -> None:
        self._context, self._builder = context, builder
        self._datamodel = context.data_model_manager[kind]
        if value is not None:
            for i, name in enumerate(self._datamodel._fields):
                setattr(self, name, builder.extract_value(value, i))

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    def whole(self) -> Any:
        """Return the array."""
        made = ir.Constant(self._datamodel.get_value_type(), ir.Undefined)
        for i, name in enumerate(self._datamodel._fields):
            made = self._builder.insert_value(made, getattr(self, name), i)
        return made
