"""Messages of validation errors, with their position in the document."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, ValidationError

from statechart.documents import hints
from statechart.documents.setting import describe_value, is_real
from statechart.documents.yaml_text import flow
from statechart.errors import (
    MAX_PROBLEMS,
    DeclarationError,
    DeclarationProblem,
    FormulaError,
    Loc,
    Position,
    close_matches,
)
from statechart.formulas.hints import no_name
from statechart.formulas.relation import conjunction, place_in
from statechart.formulas.syntax import NAME
from statechart.formulas.tree import Source
from statechart.tabular import pluralise

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

Model = TypeVar("Model", bound=BaseModel)

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
    "formula_type": "a number or a formula",
}

# Errors of form, for which an example is shown.
_SHAPES = frozenset({*_EXPECTED, "output", "too_short", "too_long"})


def declaration_error(
    error: ValidationError, document: Document | Built, model: type[BaseModel]
) -> DeclarationError:
    """Return the errors of pydantic as one error with positions."""
    errors, found = error.errors(include_url=False), list[DeclarationError]()
    if isinstance(document, Built):
        errors = _merge_iterated(errors, document)
    beside: dict[Loc, list[ErrorDetails]] = {}
    for details in errors:
        beside.setdefault(details["loc"][:-1], []).append(details)
    above = {loc[:depth] for loc in beside for depth in range(len(loc) + 1)}
    empty = document.empty
    holding = {place[:depth] for place in empty for depth in range(len(place) + 1)}
    beside_empty = empty | {place[:-1] for place in empty if len(place) > 1}
    for details in errors:
        if len(found) > MAX_PROBLEMS:
            break
        if _is_implied(details, beside, above, model):
            continue
        if _follows_from_empty(details, document, holding, beside_empty):
            continue
        cause = details.get("ctx", {}).get("error")
        others = cause.others if isinstance(cause, DeclarationProblem) else ()
        found += [_to_error(details, one, document, model) for one in (cause, *others)]
    if isinstance(document, Document):
        unknown = {_key(details) for details in errors}
        found += islice(_empty(document, model, unknown), MAX_PROBLEMS + 1)
    return _combine(found)


def _merge_iterated(errors: list[ErrorDetails], document: Built) -> list[ErrorDetails]:
    """Return errors with one for a part in the place of a list, of which pydantic lists fields."""
    merged: dict[object, ErrorDetails] = {}
    for place, details in enumerate(errors):
        loc, part = details["loc"][:-1], document.value(details["loc"][:-1])
        if isinstance(part, BaseModel) and isinstance(details["loc"][-1], int):
            merged[loc] = {**details, "type": "tuple_type", "loc": loc, "input": part}
        elif details["loc"] not in merged:
            merged[place] = details
    return list(merged.values())


def _combine(found: list[DeclarationError]) -> DeclarationError:
    found.sort(key=lambda one: (one.line or 0, one.column or 0))
    found[0].others = tuple(found[1 : MAX_PROBLEMS + 1])
    return found[0]


def _is_implied(
    details: ErrorDetails,
    beside: Mapping[Loc, Sequence[ErrorDetails]],
    above: Collection[Loc],
    model: type[BaseModel],
) -> bool:
    """Return whether an error follows from others, `beside` it (by parent) or `above` them."""
    if _lacks_items(details):
        # One error for a list that lacks two items.
        *outer, last = details["loc"]
        return any(
            _lacks_items(other) and other["loc"][-1] == int(last) + 1
            for other in beside[tuple(outer)]
        )
    if details["type"] == "too_short":
        # pydantic does not count wrong items.
        return details["loc"] in above
    if details["type"] == "model_type" and isinstance(details["input"], str):
        # The formula of a union with a mapping is wrong, and is reported.
        return any("error" in one.get("ctx", {}) for one in beside[details["loc"][:-1]])
    if details["type"] == "missing":
        # A misspelt key, or one of another program, is also missing.
        *outer, name = details["loc"]
        # Advice on the latter may replace the mapping, as `friction: 0.5` does {mu: 0.5}.
        return any(
            other["type"] == "extra_forbidden"
            and (
                difflib.get_close_matches(str(other["loc"][-1]), [str(name)])
                or hints.other_word(model, other["loc"]).partition(":")[0] in (*outer, name)
            )
            for other in beside[tuple(outer)]
        )
    return False


def _empty(
    document: Document, model: type[BaseModel], unknown: Collection[str | int | None] = ()
) -> Iterator[DeclarationError]:
    """Yield an error with an example for every known key without a value."""
    for loc in document.empty:
        if loc[-1] in unknown:
            continue
        shown = hints.example(model, loc, built=False)
        at = document.position(loc, key=True)
        # Keys that should be indented below it are unknown in its column.
        below = unknown and shown.startswith("{")
        if str(loc[-1]).isdecimal():
            yield at.error(f"{loc[-1]!r} is not a name", "decimals have a point: 9.81")
            continue
        if "=" in str(loc[-1]):
            yield at.error("a key has a colon", no_name(str(loc[-1])))
            continue
        yield at.error(
            f"{'.'.join(map(str, loc))}: nothing is written",
            f"write a value{f', such as {shown}' if shown else ''}, or remove the key"
            + ("; what belongs to it is indented below it" if below else ""),
        )


def _follows_from_empty(
    details: ErrorDetails,
    document: Document | Built,
    holding: Collection[Loc],
    beside_empty: Collection[Loc],
) -> bool:
    """Return whether an error may follow from an empty key at, above or beside its place.

    `holding` are the places with an empty key in them, `beside_empty` empty keys and the parts that
    have one.
    """
    if _key(details) is not None:
        return False
    cause = details.get("ctx", {}).get("error")
    loc = details["loc"] + (cause.loc if isinstance(cause, DeclarationProblem) else ())
    at = document.existing(loc)
    return at in holding or any(at[:depth] in beside_empty for depth in range(1, len(at) + 1))


def _key(details: ErrorDetails) -> str | int | None:
    """Return the key if it is wrong itself, not its value."""
    loc = details["loc"]
    if loc[-1:] == ("[key]",):
        return loc[-2]
    return loc[-1] if details["type"] == "extra_forbidden" else None


def _lacks_items(details: ErrorDetails) -> bool:
    return details["type"] == "missing" and isinstance(details["loc"][-1], int)


def _to_error(
    details: ErrorDetails, cause: object, document: Document | Built, model: type[BaseModel]
) -> DeclarationError:
    loc, kind = details["loc"], details["type"]
    if _lacks_items(details):
        kind, loc = "too_short", loc[:-1]
    key, offset = kind == "extra_forbidden" or loc[-1:] == ("[key]",), 0
    if isinstance(cause, DeclarationProblem):
        cause = _locate_in_list(document, cause, loc)
        loc = (*loc, *cause.loc)
        key, offset = key or cause.at_key, cause.offset
        message, advice = _message(document, cause), cause.advice
    else:
        names = hints.known_keys(model, loc[:-1])
        built = isinstance(document, Built)
        wanted = Mapping if _EXPECTED.get(kind) == "a mapping" else object
        wanted = list if kind in ("too_long", "too_short") else wanted
        shown = hints.example(model, loc, built=built, wanted=wanted)
        if built and not _lacks_items(details):  # Python uses field names, not aliases
            details = {**details, "loc": (*loc[:-1], names.get(str(loc[-1]), loc[-1]))}
        known = names.values() if built else names
        message, advice = _message_and_advice(details, list(known), built=built)
        if kind == "extra_forbidden":
            advice = _key_advice(details, model, known) or advice
        if kind == "missing" and isinstance(loc[-1], str) and shown:
            name = details["loc"][-1]
            advice = f"such as {name}={shown}" if built else f"such as {name}: {shown}"
        elif kind == "model_type" and loc[-1] in hints.known_keys(model, loc):
            value = flow(details["input"])
            advice = f"it belongs below a name, such as NAME: {{{loc[-1]}: {value}}}"
        elif kind in _SHAPES and shown and not advice:
            advice = hints.one_value(loc, details["input"]) or f"such as {shown}"
    # Missing and unknown keys have the path of their part, or a position alone.
    of_part = kind in ("extra_forbidden", "missing")
    place = document.existing(loc[:-1] if of_part else loc)
    if place and not (of_part and isinstance(document, Document)):
        message = f"{'.'.join(map(str, place))}: {message}"
    if isinstance(document, Built):
        return DeclarationError(message, advice=advice, source=document.source)
    return document.position(loc, key=key).shifted(offset).error(message, advice)


def _key_advice(details: ErrorDetails, model: type[BaseModel], known: Collection[str]) -> str:
    """Return advice on an unknown key that is not misspelt, or an empty text."""
    loc = details["loc"]
    key = str(loc[-1])
    if ":" in key:
        return "a colon has a blank behind it: key: value"
    if written := hints.other_word(model, loc):
        return f"write {written}"
    word, brace, value = key.partition("{")
    if brace and isinstance(details["input"], str | int | float):
        return f"write {word.strip()}: {{{value}: {details['input']}"
    if key and not NAME.fullmatch(key):
        if details["input"] is None and not key.isdecimal():
            word, _, value = key.partition(" ")
            if word in known and value:
                return f"write {word}: {value}"
            return f"a comma in braces ends a value; a list stands in brackets: [..., {key}]"
        return no_name(key) if " " not in key or key.replace(" ", "_") in known else ""
    return hints.sections_with_key(model, loc, known) or hints.word_elsewhere(model, key)


def _message_and_advice(
    details: ErrorDetails, known: Sequence[str], *, built: bool
) -> tuple[str, str]:
    kind, last, value = details["type"], details["loc"][-1:], details["input"]
    context: Mapping[str, Any] = details.get("ctx", {})
    if kind == "extra_forbidden":
        return f"unknown key {last[0]!r}", close_matches(str(last[0]), known).replace(
            "known:", "known keys:"
        )
    if kind == "missing":
        if isinstance(last[0], int):
            return f"must have {pluralise(last[0] + 1, 'item')}, not {len(value)}", ""
        return f"{last[0]!r} is missing", ""
    if kind == "too_long":
        # Lists of a fixed length are pairs.
        most = context["max_length"]
        words = f"{'at most ' if most > 2 else ''}{pluralise(most, 'item')}"
        return f"must have {words}, not {context['actual_length']}", ""
    if "error" in context:
        return str(context["error"]), ""
    shown = repr(value) if isinstance(value, str | int | float | None) else type(value).__name__
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    shown = {"dict": "a mapping", "list": "a list", "None": "nothing"}.get(shown, shown)
    if isinstance(value, bool) and not built:
        shown = flow(value)
    elif isinstance(value, int) and not is_real(value):
        shown = describe_value(value)
    if isinstance(value, type):
        brackets = "()" if kind == "union_tag_not_found" else "(...)"
        name = value.__name__
        return f"must be built, not the class {name}", f"write {name}{brackets}"
    if hasattr(value, "tolist"):
        return "must be plain numbers, not an array: write .tolist() behind it", ""
    if kind in _EXPECTED:
        return f"must be {_EXPECTED[kind]}, not {shown}", ""
    if kind == "output" and isinstance(value, Mapping) and value:
        word, message = str(next(iter(value))), context.get("message", details["msg"])
        return f"{message}, not {word!r}", hints.other_value(
            word, "'value', 'integral', 'minimum', 'maximum'"
        )
    if kind == "output" and isinstance(value, str | int | float) and not built:
        message = context.get("message", details["msg"])
        return f"{message}; got {shown}", f"write {flow({'value': value})}"
    if kind == "union_tag_invalid":
        tags = context["expected_tags"]
        return f"must be one of {tags}, not {context['tag']!r}", hints.other_value(
            context["tag"], tags
        )
    if kind == "too_short":
        least = pluralise(context["min_length"], "item")
        return f"must have at least {least}, not {context['actual_length'] or 'none'}", ""
    if kind == "literal_error":
        expected = context["expected"]
        return f"must be {expected}, not {shown}", hints.other_value(value, expected)
    return f"{details['msg'].replace('Input should', 'must', 1)}; got {shown}", ""


def validate(document: Document, model: type[Model]) -> Model:
    """Build `model` from a document; raise `DeclarationError` with positions of wrong fields."""
    try:
        # Documents use aliases (`from`), not Python names.
        made = model.model_validate(document.data, by_alias=True, by_name=False)
    except ValidationError as error:
        raise declaration_error(error, document, model) from None
    if empty := [*islice(_empty(document, model), MAX_PROBLEMS + 1)]:
        raise _combine(empty)
    return made


@contextmanager
def located(
    document: Document | None, overrides: Mapping[str, float], loc: Loc | None = None
) -> Iterator[None]:
    """Convert `DeclarationProblem` and `FormulaError` to `DeclarationError` with positions.

    `overrides` are parameters with other values, which may cause the problem. `loc` is the place of
    the evaluated formulas, by default the parameters.
    """
    try:
        yield
    except DeclarationProblem as error:
        found = _locate(document, error, overrides)
        found.others = tuple(_locate(document, each, overrides) for each in error.others)
        raise found from None
    except FormulaError as error:
        if loc is None and error.name:
            loc = ("parameters", error.name)
        elif loc is None:
            loc = document.where(error.text) if document else ()
        raise _locate(document, error.problem(*loc), {}) from None


def _path_parts(document: Document | None, loc: Loc) -> Iterator[str]:
    """Yield the parts of a place, without the index of a list written as its only item."""
    at: Loc = ()
    for part in loc:
        above, at = at, at if document is None else document.existing((*at, part))
        if document is None or isinstance(part, str) or at != above:
            yield str(part)


def _message(document: Document | Built | None, problem: DeclarationProblem) -> str:
    """Return the message of a problem, with the second position in it."""
    if not problem.see:
        return problem.message
    path = ".".join(map(str, document.existing(problem.see) if document else problem.see))
    if isinstance(document, Document):
        place = document.position(problem.see, key=problem.at_key)
        path += f" (line {place.line}, column {place.column})"
    return problem.message.replace("{see}", path)


def _locate_in_list(
    document: Document | Built | None, problem: DeclarationProblem, above: Loc = ()
) -> DeclarationProblem:
    """Return a problem of a conjunction as one of its item in the list."""
    texts: Any = document.value((*above, *problem.loc)) if document and problem.text else None
    if not (may_be_relations(texts) and conjunction(texts) == problem.text):
        return problem
    place, offset = place_in(texts, problem.offset)
    old, new = Source(problem.text).named, Source(texts[place]).named
    message = problem.message.replace(old, new)
    return replace(problem, message=message, loc=(*problem.loc, place), offset=offset)


def _locate(
    document: Document | None, problem: DeclarationProblem, overrides: Mapping[str, float]
) -> DeclarationError:
    problem = _locate_in_list(document, problem)
    path = ".".join(_path_parts(document, problem.loc))
    message = _message(document, problem)
    message = f"{path}: {message}" if path else message
    if overrides:
        message += " (with " + ", ".join(f"{k} = {v:.7g}" for k, v in overrides.items()) + ")"
    if document is None:
        return DeclarationError(message, advice=problem.advice)
    at = document.position(problem.loc, key=problem.at_key).shifted(problem.offset)
    return at.error(message, problem.advice)


def may_be_relations(value: object) -> bool:
    """Return whether a value may be a list of relations."""
    several = isinstance(value, list | tuple) and all(isinstance(one, str) for one in value)
    return several and value not in ([], ())


@dataclass(frozen=True)
class Document:
    """A YAML document as plain data, with positions."""

    source: str  # the file's path, or a name in angle brackets
    data: dict[str, Any]  # mappings, lists, text, numbers, booleans and None
    _values: Mapping[Loc, Position]
    _keys: Mapping[Loc, Position]
    empty: frozenset[Loc] = frozenset()  # keys without a value, which reads as None

    def position(self, loc: Loc, *, key: bool = False) -> Position:
        """Return the position of the value at `loc`, or of its nearest existing ancestor.

        Parts of `loc` that do not exist are skipped: pydantic inserts tags of unions.
        """
        at = self.existing(loc)
        return self._keys.get(at, self._values[at]) if key else self._values[at]

    def where(self, text: str) -> Loc:
        """Return the place of the first value, or conjunction of a list, equal to `text`."""
        for loc in self._values:
            value = self.value(loc)
            if value == text or (may_be_relations(value) and conjunction(value) == text):
                return loc
        return ()

    def value(self, loc: Loc) -> Any:
        """Return the value at `loc`, or at its nearest ancestor that exists."""
        value: Any = self.data
        for part in self.existing(loc):
            value = value[part]
        return value

    def existing(self, loc: Loc) -> Loc:
        """Return the parts of `loc` that exist in the data; the index of a list of one may lack."""
        at: Loc = ()
        for part in loc:
            alone = (*at, 0, part)
            if (*at, part) in self._values:
                at = (*at, part)
            elif isinstance(part, str) and alone in self._values and (*at, 1) not in self._values:
                at = alone
        return at


class Built:
    """Keywords of a part built in Python, with the interface of a `Document`."""

    empty = frozenset[Loc]()

    def __init__(self, model: type[BaseModel], data: Mapping[str, Any]) -> None:
        name = data.get("name")
        self.source = f"{model.__name__}({name!r})" if isinstance(name, str) else model.__name__
        self._data = data

    def existing(self, loc: Loc) -> Loc:
        """Return the existing parts of `loc`, with Python names."""
        return self._descend(loc)[0]

    def value(self, loc: Loc) -> Any:
        """Return the value at `loc`, or at its nearest ancestor that exists."""
        return self._descend(loc)[1]

    def _descend(self, loc: Loc) -> tuple[Loc, Any]:
        value: Any = self._data
        found: list[str | int] = []
        for part in loc:
            if isinstance(value, tuple) and len(value) == 1 and isinstance(part, str):
                value = value[0]
            names: Sequence[str | int] = (part,)
            if isinstance(value, BaseModel):
                fields = type(value).model_fields.items()
                names = [name for name, field in fields if part in (name, field.alias)]
            built = isinstance(value, BaseModel)
            for name in names:
                with suppress(KeyError, IndexError, TypeError):
                    value = getattr(value, str(name)) if built else value[name]
                    found.append(name)
        return tuple(found), value
