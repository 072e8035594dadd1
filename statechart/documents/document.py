"""The source of a model with the place of each value: a YAML document, or Python keywords."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from statechart.errors import Position
from statechart.formulas.relation import conjunction

Loc = tuple[str | int, ...]


def relations(value: object) -> bool:
    """Return whether a value may be a list of relations."""
    return (
        isinstance(value, list | tuple)
        and len(value) > 0
        and all(isinstance(one, str) for one in value)
    )


@dataclass(frozen=True)
class Document:
    """A YAML document as plain data, with the place of everything in it."""

    source: str  # the file's path, or a name in angle brackets
    data: dict[str, Any]  # Mappings, lists, text, numbers, booleans and None
    _values: Mapping[Loc, Position]
    _keys: Mapping[Loc, Position]
    empty: frozenset[Loc] = frozenset()  # where a key has nothing behind it, which reads as None

    def position(self, loc: Loc, *, key: bool = False) -> Position:
        """Return where the value at `loc` stands, or its nearest ancestor that exists.

        Parts of `loc` that the data does not have on the way are skipped: pydantic puts the
        names of the members of a union there.
        """
        at = self.existing(loc)
        return self._keys.get(at, self._values[at]) if key else self._values[at]

    def where(self, text: str) -> Loc:
        """Return the place of the first value that is `text`, or a list that stands for it.

        The top if none is.
        """
        for loc in self._values:
            value = self.value(loc)
            if value == text or (relations(value) and conjunction(value) == text):
                return loc
        return ()

    def value(self, loc: Loc) -> Any:
        """Return the value at `loc`, or at its nearest ancestor that exists."""
        value: Any = self.data
        for part in self.existing(loc):
            value = value[part]
        return value

    def existing(self, loc: Loc) -> Loc:
        """Return the parts of `loc` that lead down the data; of a list of one it may say none."""
        at: Loc = ()
        for part in loc:
            alone = (*at, 0, part)
            if (*at, part) in self._values:
                at = (*at, part)
            elif isinstance(part, str) and alone in self._values and (*at, 1) not in self._values:
                at = alone
        return at


class Built:
    """Keywords that a part is built of in Python: what a `Document` is to a part of a file."""

    def __init__(self, model: type[BaseModel], data: Mapping[str, Any]) -> None:
        name = data.get("name")
        self.source = f"{model.__name__}({name!r})" if isinstance(name, str) else model.__name__
        self._data = data

    def existing(self, loc: Loc) -> Loc:
        """Return the parts of `loc` that lead down the data, as Python names them."""
        return self._followed(loc)[0]

    def value(self, loc: Loc) -> Any:
        """Return the value at `loc`, or at its nearest ancestor that exists."""
        return self._followed(loc)[1]

    def _followed(self, loc: Loc) -> tuple[Loc, Any]:
        value: Any = self._data
        found: list[str | int] = []
        for part in loc:
            if isinstance(value, tuple) and len(value) == 1 and isinstance(part, str):
                value = value[0]
            names: Sequence[str | int] = (part,)
            if isinstance(value, BaseModel):
                fields = type(value).model_fields.items()
                names = [name for name, field in fields if part in (name, field.alias)]
            for name in names:
                with suppress(KeyError, IndexError, TypeError):
                    value = (
                        getattr(value, str(name)) if isinstance(value, BaseModel) else value[name]
                    )
                    found.append(name)
        return tuple(found), value
