"""What pydantic found wrong, in plain words and with its place in the document."""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError

from statechart.documents.document import Document, Loc
from statechart.documents.yaml_reader import Model
from statechart.documents.yaml_text import flow
from statechart.errors import DeclarationError, DeclarationProblem, FormulaError, close_matches

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo
    from pydantic_core import ErrorDetails


_EXPECTED: Mapping[str, str] = {
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "dict_type": "a mapping",
    "list_type": "a list",
    "tuple_type": "a list",
    "string_type": "text",
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "none_required": "null",
}


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
        value: Any = self._data
        found: list[str | int] = []
        for part in loc:
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
        return tuple(found)


# What has another form than it should: an example shows which.
_SHAPES = frozenset({*_EXPECTED, "output", "too_short", "too_long"})


def declaration_error(
    error: ValidationError, document: Document | Built, model: type[BaseModel]
) -> DeclarationError:
    """Return what pydantic found as one error with places.

    Parameters
    ----------
    error : pydantic.ValidationError
        What validating `document` as `model` raised.
    document : Document or Built
        What was validated.
    model : type of pydantic.BaseModel
        What it should have been.
    """
    errors = error.errors(include_url=False)
    found = [
        one
        for details in errors
        if not _implied(details, errors)
        for one in _all(details, document, model)
    ]
    found.sort(key=lambda one: (one.line or 0, one.column or 0))
    found[0].others = tuple(found[1:])
    return found[0]


def _implied(details: ErrorDetails, errors: Sequence[ErrorDetails]) -> bool:
    """Whether an error is no news beside the others."""
    if details["type"] == "too_short":
        # A list whose items are all wrong is empty to pydantic.
        return any(other["loc"][:-1] == details["loc"] for other in errors)
    if details["type"] == "missing":
        # A key that is misspelt is missing, too.
        *above, name = details["loc"]
        return any(
            other["type"] == "extra_forbidden"
            and list(other["loc"][:-1]) == above
            and difflib.get_close_matches(str(other["loc"][-1]), [str(name)])
            for other in errors
        )
    return False


def _all(
    details: ErrorDetails, document: Document | Built, model: type[BaseModel]
) -> Iterator[DeclarationError]:
    """Yield what is wrong, and what a validator of ours found besides."""
    cause = details.get("ctx", {}).get("error")
    yield _one(details, cause, document, model)
    if isinstance(cause, DeclarationProblem):
        for other in cause.others:
            yield _one(details, other, document, model)


def _one(
    details: ErrorDetails, cause: object, document: Document | Built, model: type[BaseModel]
) -> DeclarationError:
    loc, kind = details["loc"], details["type"]
    key, offset = kind == "extra_forbidden" or loc[-1:] == ("[key]",), 0
    if isinstance(cause, DeclarationProblem):
        loc = (*loc, *cause.loc)
        key, offset = key or cause.key, cause.offset
        message, advice = cause.message, cause.advice
    else:
        names = _known_keys(model, loc[:-1])
        example = _example(model, loc, document)
        built = isinstance(document, Built)
        if built:  # in Python a field goes by its own name
            details = {**details, "loc": (*loc[:-1], names.get(str(loc[-1]), loc[-1]))}
        known = names.values() if built else names
        message, advice = _words(details, list(known))
        if kind == "missing" and isinstance(loc[-1], str) and example:
            name = details["loc"][-1]
            advice = f"such as {name}={example}" if built else f"such as {name}: {example}"
        elif kind in _SHAPES and example:
            advice = f"such as {example}"
    path = ".".join(str(part) for part in document.existing(loc))
    if isinstance(document, Built):
        # Nothing else tells where it is: what is missing or unknown has the path of its part.
        if kind in ("extra_forbidden", "missing"):
            path = ".".join(str(part) for part in document.existing(loc[:-1]))
        message = f"{path}: {message}" if path else message
        return DeclarationError(message, advice=advice, source=document.source)
    at = document.position(loc, key=key).shifted(offset)
    if kind not in ("extra_forbidden", "missing") and path:
        message = f"{path}: {message}"
    return DeclarationError(
        message, advice=advice, source=at.source, line=at.line, column=at.column
    )


def _words(details: ErrorDetails, known: Sequence[str]) -> tuple[str, str]:
    kind, last, given = details["type"], details["loc"][-1:], details["input"]
    context: Mapping[str, Any] = details.get("ctx", {})
    if kind == "extra_forbidden":
        return f"unknown key {last[0]!r}", close_matches(str(last[0]), known).replace(
            "known:", "known keys:"
        )
    if kind == "missing":
        if isinstance(last[0], int):
            return f"must have {last[0] + 1} items", ""
        return f"{last[0]!r} is missing", ""
    if kind == "too_long":
        return f"must have {context['max_length']} items, not {context['actual_length']}", ""
    if "error" in context:
        return str(context["error"]), ""
    shown = repr(given) if isinstance(given, str | int | float | None) else type(given).__name__
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    shown = {"dict": "a mapping", "list": "a list", "None": "nothing"}.get(shown, shown)
    if kind in _EXPECTED:
        return f"must be {_EXPECTED[kind]}, not {shown}", ""
    if kind == "union_tag_invalid":
        return f"must be one of {context['expected_tags']}, not {context['tag']!r}", ""
    if kind == "too_short":
        return f"must have at least {context['min_length']} item(s)", ""
    if kind == "literal_error":
        return f"must be {context['expected']}, not {shown}", ""
    return f"{details['msg'].replace('Input should', 'must', 1)}; got {shown}", ""


def _example(model: type[BaseModel], loc: Sequence[str | int], document: Document | Built) -> str:
    """Return an example of what stands at `loc`, as it is written there; empty where none is told.

    That of a whole has those of its parts.
    """
    annotations: list[Any] = [model]
    example: Any = None
    for part in loc:
        found = _field(annotations, part)
        below = list(_below(annotations, part)) or list(_tagged(annotations, part))
        if found is not None:
            example = found.examples[0] if found.examples else None
        elif isinstance(example, Mapping):
            example = next(iter(example.values()), None)
        elif isinstance(example, list) and isinstance(part, int):
            example = example[min(part, len(example) - 1)]
        annotations = below or annotations
    if example is None:
        return ""
    return repr(example) if isinstance(document, Built) else flow(example)


def _field(annotations: Sequence[Any], part: str | int) -> FieldInfo | None:
    """Return the field that a part of a place is."""
    for annotation in _members(annotations):
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            for name, field in annotation.model_fields.items():
                if part in (name, field.alias):
                    return field
    return None


def _known_keys(model: type[BaseModel], loc: Sequence[str | int]) -> dict[str, str]:
    """Return the keys that the mapping at `loc` may have, and what Python calls these fields."""
    annotations: list[Any] = [model]
    for part in loc:
        annotations = (
            list(_below(annotations, part)) or list(_tagged(annotations, part)) or annotations
        )
    return {
        field.alias or name: name
        for annotation in _members(annotations)
        if isinstance(annotation, type) and issubclass(annotation, BaseModel)
        for name, field in annotation.model_fields.items()
    }


def _members(annotations: Sequence[Any]) -> Iterator[Any]:
    """Yield every alternative of the annotations, without what is only attached to them."""
    for annotation in annotations:
        if get_origin(annotation) is Annotated:
            yield from _members(get_args(annotation)[:1])
        elif get_origin(annotation) in (Union, types.UnionType):
            yield from _members(get_args(annotation))
        else:
            yield annotation


def _tagged(annotations: Sequence[Any], part: str | int) -> Iterator[Any]:
    """Yield the member of a union that pydantic calls `part` in the place of an error."""
    for annotation in annotations:
        if get_origin(annotation) is Annotated:
            member, *attached = get_args(annotation)
            if Tag(str(part)) in attached:
                yield member
            else:
                yield from _tagged([member], part)
        elif get_origin(annotation) in (Union, types.UnionType):
            yield from _tagged(get_args(annotation), part)


def _below(annotations: Sequence[Any], part: str | int) -> Iterator[Any]:
    for annotation in _members(annotations):
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            for name, field in annotation.model_fields.items():
                if part in (name, field.alias):
                    yield field.annotation
        elif isinstance(origin := get_origin(annotation), type):
            arguments = get_args(annotation)
            if issubclass(origin, Mapping):
                yield arguments[1]
            elif issubclass(origin, Sequence) and isinstance(part, int):
                yield arguments[0]


def validate(document: Document, model: type[Model]) -> Model:
    """Build `model` from a document.

    Parameters
    ----------
    document : Document
        What was read.
    model : type of pydantic.BaseModel
        What it should be.

    Raises
    ------
    DeclarationError
        With the place of the first wrong field; its `others` are the further ones.
    """
    try:
        # A document uses the documented spelling of a field (`from`), never its Python name.
        return model.model_validate(document.data, by_alias=True, by_name=False)
    except ValidationError as error:
        raise declaration_error(error, document, model) from None


class located:  # noqa: N801 - used as a statement, and in every run: cheaper than a generator
    """Raise problems of a model as errors with their place in its document.

    Parameters
    ----------
    document : Document or None
        What the model was read from.
    overrides : mapping of str to float
        Parameters that were given other values; a problem may come from them.
    loc : tuple of str and int, optional
        Where the formulas are that are evaluated; the parameters by default.

    Raises
    ------
    DeclarationError
        In the place of a `DeclarationProblem` or a `FormulaError`.
    """

    __slots__ = ("_document", "_loc", "_overrides")

    def __init__(
        self,
        document: Document | None,
        overrides: Mapping[str, float],
        loc: tuple[str | int, ...] | None = None,
    ) -> None:
        self._document, self._overrides, self._loc = document, overrides, loc

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, DeclarationProblem):
            found = _located(self._document, error, self._overrides)
            others = (_located(self._document, each, self._overrides) for each in error.others)
            found.others = tuple(others)
            raise found from None
        if isinstance(error, FormulaError):
            problem = DeclarationProblem(
                error.message,
                advice=error.advice,
                loc=("parameters", error.name) if self._loc is None else self._loc,
                offset=error.offset,
            )
            raise _located(self._document, problem, {}) from None


def _located(
    document: Document | None, problem: DeclarationProblem, overrides: Mapping[str, float]
) -> DeclarationError:
    path = ".".join(map(str, problem.loc))
    message = f"{path}: {problem.message}" if path else problem.message
    if overrides:
        message += " with " + ", ".join(f"{k}={v:g}" for k, v in overrides.items()) + " set"
    if document is None:
        return DeclarationError(message, advice=problem.advice)
    at = document.position(problem.loc, key=problem.key).shifted(problem.offset)
    return DeclarationError(
        message, advice=problem.advice, source=at.source, line=at.line, column=at.column
    )
