"""Metaclass of declared parts: help on their fields, and errors with their paths."""

# ruff: noqa: N805 -- methods of a metaclass take `cls`

from __future__ import annotations

import inspect
import textwrap
import types
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, cast, get_args, get_origin

from pydantic import BaseModel, Field, JsonValue, ValidationError

from statechart.errors import DeclarationError, Loc

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
    from pydantic.fields import FieldInfo
else:
    ModelMetaclass = type(BaseModel)

_WORDS = {str: "text", int: "whole number", float: "number", bool: "True or False"}
_FORMULA = {str, int, float}
_WIDTH = 90


def declare(
    description: str, *examples: Any, unit: str = "", default: Any = ..., **limits: Any
) -> Any:
    """Return a field with description, examples and unit; required without a default.

    A document may use any consistent units; angles are in rad, ratios in 1.
    """
    extra: dict[str, JsonValue] | None = {"unit": unit} if unit else None
    keywords: dict[str, Any] = {"examples": [*examples]} if examples else {}
    return Field(default, description=description, json_schema_extra=extra, **keywords, **limits)


def leaves(
    value: Any, loc: Loc = (), unit: str = "", *, single: str = ""
) -> Iterator[tuple[Loc, Any, str]]:
    """Yield the texts and numbers in a part, with their places and the units of their fields.

    An only item of a field `single` has no index.
    """
    match value:
        case BaseModel():
            for name, field in type(value).model_fields.items():
                own, extra = getattr(value, name), field.json_schema_extra
                own_unit = str(extra["unit"]) if isinstance(extra, dict) else ""
                yield from leaves(own, (*loc, name), own_unit, single=single)
        case Mapping():
            for key, item in value.items():
                yield from leaves(item, (*loc, key), unit, single=single)
        case list() | tuple():
            alone = loc[-1:] == (single,) and len(value) == 1
            for place, item in enumerate(value):
                yield from leaves(item, loc if alone else (*loc, place), unit, single=single)
        case _:
            yield loc, value, unit


class Documented(ModelMetaclass):
    """Metaclass of parts.

    `help` shows the docstring with the descriptions of the fields, the signature without types, and
    the public `METHODS`. Validation errors are raised as `DeclarationError`.
    """

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        """Create a part."""
        if args:
            name = next((name for name, _ in _fields(cls)), "")
            message = f"{cls.__name__}: fields are given by their names"
            raise DeclarationError(message, advice=f"write {cls.__name__}({name}=...)")
        try:
            return super().__call__(**kwargs)
        except ValidationError as error:
            from statechart.documents.validation import Built, declaration_error

            model = cast("type[BaseModel]", cls)
            raise declaration_error(error, Built(model, kwargs), model) from None

    def __dir__(cls) -> list[str]:
        return sorted(getattr(cls, "METHODS", ()))

    @property
    def __doc__(cls) -> str | None:  # type: ignore[override]
        own = cls.__dict__.get("__doc__")
        if not own:
            return None
        # Fields without a description have theirs in the docstring.
        shown = "\n".join(_field_text(*field) for field in _fields(cls) if field[1].description)
        return f"{inspect.cleandoc(own)}\n\nParameters\n----------\n{shown}" if shown else own

    @property
    def __signature__(cls) -> inspect.Signature:
        parts = []
        for name, field in _fields(cls):
            default = inspect.Parameter.empty if field.is_required() else field.default
            kind = inspect.Parameter.KEYWORD_ONLY
            parts.append(inspect.Parameter(name, kind, default=default))
        return inspect.Signature(parts)

    @__signature__.setter
    def __signature__(cls, value: object) -> None:
        """Discard the signature of pydantic, which contains addresses of validators."""


def own_words(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Describe the JSON Schema of a model by its own docstring, without the fields."""
    schema["description"] = inspect.cleandoc(model.__dict__["__doc__"])


def _fields(cls: type) -> Iterator[tuple[str, FieldInfo]]:
    fields: Mapping[str, FieldInfo] = cls.__dict__.get("__pydantic_fields__", {})
    yield from sorted(fields.items(), key=lambda item: not item[1].is_required())


def _field_text(name: str, field: FieldInfo) -> str:
    """Return the description of a field as a numpydoc entry."""
    optional = "" if field.is_required() else ", optional"
    sentences = [(field.description or "").rstrip(".") + "."]
    extra = field.json_schema_extra
    if isinstance(extra, dict):
        sentences.append(f"Unit: {extra['unit']}.")
    if field.examples:
        sentences.append(f"Example: ``{field.examples[0]}``.")
    lines = textwrap.wrap(" ".join(sentences), _WIDTH, break_long_words=False)
    return "\n    ".join([f"{name} : {_type(field.annotation)}{optional}", *lines])


def _type(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type(arguments[0])
    if origin in (Union, types.UnionType):
        members = [member for member in arguments if member is not type(None)]
        formula = "formula" if set(members) >= _FORMULA else ""
        others = [_type(m) for m in members if not (formula and m in _FORMULA)]
        return " or ".join(dict.fromkeys(filter(None, (formula, *others))))
    if origin is Literal:
        return " or ".join(map(repr, arguments))
    if origin is tuple and arguments[-1] is not Ellipsis:
        return f"({', '.join(map(_type, arguments))})"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"mapping of {_type(arguments[0])} to {_type(arguments[1])}"
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return f"sequence of {_type(arguments[0])}"
    return _WORDS.get(annotation) or str(getattr(annotation, "__name__", annotation))
