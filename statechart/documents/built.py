"""What a part is built of in Python, as a place to point at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from pydantic import BaseModel

from statechart.documents.document import Loc


class Built:
    """Keywords that a part is built of in Python: what a `Document` is to a part of a file.

    Parameters
    ----------
    model : type of pydantic.BaseModel
        The part.
    data : mapping
        What was given.
    """

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
