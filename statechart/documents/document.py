"""Plain data with the position of each value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

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
    """A YAML document as plain data, with the place of everything in it.

    Attributes
    ----------
    source : str
        The file's path, or a name in angle brackets.
    data : dict
        Mappings, lists, text, numbers, booleans and None.
    empty : frozenset
        Where a key has nothing behind it, which reads as None.
    """

    source: str
    data: dict[str, Any]
    _values: Mapping[Loc, Position]
    _keys: Mapping[Loc, Position]
    empty: frozenset[Loc] = frozenset()

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
