"""Advice on wrong keys of a document and wrong arguments of a call.

The place of an error is looked up in the type annotations of the models. Advice on formulas is in
`statechart.formulas.hints`.
"""

from __future__ import annotations

import difflib
import functools
import inspect
import re
import types
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import fields
from numbers import Integral, Real
from os import PathLike
from typing import Annotated, Any, ParamSpec, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, Tag
from pydantic.fields import FieldInfo

from statechart.documents.setting import Setting
from statechart.documents.yaml_text import flow
from statechart.errors import DeclarationError, close_matches

P = ParamSpec("P")
R = TypeVar("R")

_MISSPELT = 0.8  # similarity of a misspelt key

_ARGUMENTS = {
    **dict.fromkeys(("dt", "h", "timestep", "time_step"), "step"),
    **dict.fromkeys(("rtol", "atol", "tol", "eps"), "tolerance"),
    **dict.fromkeys(("solver", "integrator", "backend"), "engine"),
    **dict.fromkeys(("t", "T", "t_end", "tmax", "t_max", "end", "time", "duration"), "until"),
    **dict.fromkeys(("params", "param", "set", "p"), "parameters"),
    **dict.fromkeys(("n", "max_examples"), "examples"),
    **dict.fromkeys(("filename", "file", "output", "out", "dir", "directory"), "path"),
}
"""Argument of another program -> argument of ours."""

_KINDS: Mapping[str, tuple[tuple[type, ...], str]] = {
    "float": ((Real,), "a number"),
    "int": ((Integral,), "a whole number"),
    "Path | str": ((str, PathLike), "a path"),
    "bool": ((bool,), "True or False"),
}
"""Annotation of an argument -> its types, and their name."""

YAML_HINTS: Mapping[str, str] = {
    r"'\t'": "write spaces, not tabs",
    "mapping values are not allowed": "write key: value, and indent the keys of one mapping alike; "
    "text with a colon stands in quotes",
    "found character '|' that cannot start": "write abs(...)",
    "found character '>' that cannot start": "write `not` for !, and put text with > in quotes",
    "found character '%' that cannot start": "write a comment after #",
    "found character '`' that cannot start": "put text in quotes",
    "found character '@' that cannot start": "put text in quotes",
    "expected the node content, but found ','": "there is a comma too many",
    "could not find expected ':'": "write key: value",
    "sequence entries are not allowed": "write -3 without a blank, and a list on lines of its own",
    "expected '<document start>'": "one model a file; what belongs to it stands in one mapping",
    "expected ',' or '}'": "close the {{{line}, and put commas between",
    "expected ',' or ']'": "close the [{line}, and put commas between",
    "expected <block end>": "indent keys of one mapping alike",
    "found unexpected end of stream": "close the quote that opens here",
}
"""Words of a YAML error message -> advice; `line` names another line, on which a bracket opens."""

OTHER_VALUES: Mapping[str, str] = {
    **dict.fromkeys(("stick", "sticking", "stuck", "fixed", "roll", "rolling"), "pin"),
    **dict.fromkeys(("slip", "slipping", "sliding"), "slide"),
    **dict.fromkeys(("open", "off", "lift", "flight", "flying"), "free"),
    **dict.fromkeys(("vx", "u", "xdot"), "dx"),
    **dict.fromkeys(("vy", "v", "ydot", "vz", "dz"), "dy"),
    "z": "y",
    **dict.fromkeys(("theta", "phi", "rotation"), "angle"),
    **dict.fromkeys(("omega", "w", "dtheta", "dphi"), "dangle"),
    **dict.fromkeys(("rk4", "rk45", "rk23", "dop853", "radau", "lsoda", "bdf", "ode45"), "scipy"),
    **dict.fromkeys(("euler", "moreau", "timestepping", "fixedstep", "mujoco"), "impulse"),
    **dict.fromkeys(("eventdriven", "events", "event"), "taylor"),
    "max": "maximum",
    "min": "minimum",
    **dict.fromkeys(("mean", "average", "sum"), "integral"),
    "final": "value",
    "last": "value",
}
"""Value of another program, in lower case without - and _, -> our value."""

OTHER_EVENTS: Mapping[str, str] = {
    **dict.fromkeys(("impact", "collision", "collide", "contact", "hit", "landing"), "touchdown"),
    **dict.fromkeys(("takeoff", "separation", "detach", "release", "lift"), "liftoff"),
}
"""Event of another program -> our event."""


def other_value(value: object, known: str) -> str:
    """Return advice on a synonym of a known value, or nothing."""
    word = OTHER_VALUES.get(_plain(str(value)), "")
    if word == "scipy" and (method := str(value).upper()) in ("RK45", "DOP853", "LSODA"):
        word += f" with the method {method}"
    return f"write {word}" if f"'{word.partition(' ')[0]}'" in known else ""


def unknown_parameter(name: str, known: Collection[str]) -> str:
    """Return advice on an unknown parameter."""
    last = name.rpartition(".")[2]
    option = _ARGUMENTS.get(last, last)
    if option in ("until", *Setting.__dataclass_fields__):
        return f"write --{option.replace('_', '-')}, in Python {option}="
    advice = close_matches(name, known)
    if advice.startswith("known"):
        advice += "; numbers of the file get a name by parameters: {g: 9.81} and gravity: g"
    return advice


def example(
    model: type[BaseModel], loc: Sequence[str | int], *, built: bool, wanted: type = object
) -> str:
    """Return an example of the value at `loc`, a `wanted` one if possible, or an empty text."""
    shown: Any = None
    examples: list[Any] = []
    for part, _, field in _walk(model, loc):
        if field is not None:
            examples = field.examples or []
            shown = examples[0] if examples else None
        elif isinstance(shown, Mapping) and not isinstance(part, int):
            shown = next(iter(shown.values()), None)
        elif isinstance(shown, list) and isinstance(part, int):
            shown = shown[min(part, len(shown) - 1)]
    if not isinstance(shown, wanted):
        shown = next((one for one in examples if isinstance(one, wanted)), shown)
    if shown is None:
        return ""
    return repr(shown) if built else flow(shown)


def one_value(loc: Sequence[str | int], value: object) -> str:
    """Return advice on a list in the place of one value, or on one in quotes, or nothing."""
    if isinstance(value, str) and value[:1] in ("[", "{"):
        return "remove the quotes"
    if not (isinstance(value, list | tuple) and value):
        return ""
    if len(loc) == 2 and loc[0] == "parameters":
        shown = f"ranges: {{{loc[1]}: {flow(value)}}}"
        return f"write {loc[1]}: {value[0]}; for checks {shown}; for a sweep --over {loc[1]}=..."
    if loc[-1] == "on":
        return f"write {' or '.join(map(str, value))}"
    return "write a contact for each surface" if loc[-1] == "surface" else ""


def known_keys(model: type[BaseModel], loc: Sequence[str | int]) -> dict[str, str]:
    """Return key -> field name in Python of the mapping at `loc`."""
    members = _models(_annotations_at(model, loc))
    fields = (pair for member in members for pair in member.model_fields.items())
    return {field.alias or name: name for name, field in fields}


def other_word(model: type[BaseModel], loc: Sequence[str | int]) -> str:
    """Return the key that corresponds to one of another program, or an empty text."""
    members = _models(_annotations_at(model, loc[:-1]))
    return next(filter(None, (_own_word(member, loc[-1]) for member in members)), "")


def word_elsewhere(model: type[BaseModel], word: str) -> str:
    """Return advice on a key of another program in a wrong section, or an empty text.

    Keys of this format, and sections of equal depth that advise differently, give none.
    """
    if next(_places_of_key(model, word), None) is not None:
        return ""
    places: dict[int, dict[str, list[str]]] = {}
    for place, member in _parts(model):
        if _is_model(member) and (written := _own_word(member, word)):
            at = places.setdefault(len(place), {}).setdefault(written, [])
            at += [place[0]] if place and place[0] not in at else []
    advice = places[min(places)] if places else {}
    if len(advice) != 1:
        return ""
    [(written, sections)] = advice.items()
    if written.partition(":")[0] in model.model_fields:
        sections = []
    return f"in {' and '.join(sections)} write {written}" if sections else f"write {written}"


def _own_word(member: type[BaseModel], word: str | int) -> str:
    key = _plain(str(word))
    words: Mapping[str, str] = getattr(member, "OTHER_WORDS", {})
    return next((own for others, own in words.items() if key in map(_plain, others.split())), "")


def _plain(word: str) -> str:
    """Return a word without -, _ and blanks, in lower case unless it is one letter."""
    return word if len(word) == 1 else re.sub("[-_ ]", "", word.lower())


def sections_with_key(
    model: type[BaseModel], loc: Sequence[str | int], known: Collection[str]
) -> str:
    """Return the sections of a misplaced key, or an empty text if it is misspelt.

    Sections on the way to it come first.
    """
    key = str(loc[-1])
    if difflib.get_close_matches(key, known, cutoff=_MISSPELT):
        return ""
    here = tuple(part for part, _, field in _walk(model, loc[:-1]) if field is not None)
    places = sorted(
        {place for place in _places_of_key(model, key) if place != here},
        key=lambda place: (-sum(part in loc for part in place), len(place), place),
    )
    if not places:
        return ""
    shown = " and of ".join(".".join(place) or "the document itself" for place in places[:2])
    return f"{key!r} is a key of {shown}; known keys here: {', '.join(sorted(known))}"


def _places_of_key(model: type[BaseModel], key: str) -> Iterator[tuple[str, ...]]:
    """Yield the places of the parts and mappings that have a key."""
    for place, member in _parts(model):
        if _is_model(member):
            names = [field.alias or name for name, field in member.model_fields.items()]
        else:
            names = [name for argument in get_args(member)[:1] for name in get_args(argument)]
        if key in names:
            yield place


def _parts(
    annotation: Any, place: tuple[str, ...] = (), above: tuple[Any, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the places and annotations of all parts and mappings."""
    for member in _members([annotation]):
        if member in above:  # recursion, as states in states
            continue
        yield place, member
        if _is_model(member):
            for name, field in member.model_fields.items():
                below = (*place, field.alias or name)
                yield from _parts(field.annotation, below, (*above, member))
        else:
            for argument in get_args(member):
                yield from _parts(argument, place, above)


def _walk(
    model: type[BaseModel], loc: Sequence[str | int]
) -> Iterator[tuple[str | int, list[Any], FieldInfo | None]]:
    """Yield every part of a place with its annotations and its field."""
    annotations: list[Any] = [model]
    for part in loc:
        below: list[Any] = []
        found: FieldInfo | None = None
        for member in _members(annotations):
            origin, arguments = get_origin(member), get_args(member)
            if _is_model(member):
                for name, field in member.model_fields.items():
                    if part in (name, field.alias):
                        below.append(field.annotation)
                        found = found or field
            elif isinstance(origin, type) and issubclass(origin, Mapping):
                below.append(arguments[1])
            elif isinstance(origin, type) and issubclass(origin, Sequence):
                below += arguments[:1] if isinstance(part, int) else ()
        annotations = below or list(_tagged_member(annotations, part)) or annotations
        yield part, annotations, found


def _annotations_at(model: type[BaseModel], loc: Sequence[str | int]) -> list[Any]:
    return [[model], *(annotations for _, annotations, _ in _walk(model, loc))][-1]


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _models(annotations: Sequence[Any]) -> Iterator[type[BaseModel]]:
    return filter(_is_model, _members(annotations))


def _members(annotations: Sequence[Any]) -> Iterator[Any]:
    """Yield the members of unions, without metadata."""
    for annotation in annotations:
        if get_origin(annotation) is Annotated:
            yield from _members(get_args(annotation)[:1])
        elif get_origin(annotation) in (Union, types.UnionType):
            yield from _members(get_args(annotation))
        else:
            yield annotation


def _tagged_member(annotations: Sequence[Any], part: str | int) -> Iterator[Any]:
    """Yield the member of a union with the tag `part` of pydantic."""
    for annotation in annotations:
        if get_origin(annotation) is Annotated:
            member, *attached = get_args(annotation)
            yield from [member] if Tag(str(part)) in attached else _tagged_member([member], part)
        elif get_origin(annotation) in (Union, types.UnionType):
            yield from _tagged_member(get_args(annotation), part)


def check_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to raise `DeclarationError` for wrong arguments.

    Wrong are unknown arguments, and arguments of a wrong type that make the call fail. Keywords
    ``**words: Unpack[TypedDict]`` are checked like the others.
    """
    signature = _expand_words(function)

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            if packed:
                signature.bind(*args, **kwargs)
            return function(*args, **kwargs)
        except (TypeError, ValueError):
            wrong = _wrong_call(signature, args, kwargs)
            if not wrong:
                raise
        name = function.__qualname__.removesuffix(".__init__")
        raise DeclarationError(f"{name}: {wrong[0]}", advice=wrong[1])

    packed = signature != inspect.signature(function)
    called.__signature__ = signature  # type: ignore[attr-defined]
    return called


def _expand_words(function: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a function with ``**words`` expanded."""
    signature = inspect.signature(function)
    parts = list(signature.parameters.values())
    if not parts or parts[-1].kind is not inspect.Parameter.VAR_KEYWORD:
        return signature
    packed = parts.pop().annotation.removeprefix("Unpack[").removesuffix("]")
    for word, annotation in function.__globals__[packed].__annotations__.items():
        shown = getattr(annotation, "__forward_arg__", annotation)
        part = inspect.Parameter(word, inspect.Parameter.KEYWORD_ONLY, annotation=shown)
        parts.append(part.replace(default=None))
    return signature.replace(parameters=parts)


def _wrong_call(
    signature: inspect.Signature, args: tuple[object, ...], kwargs: Mapping[str, object]
) -> tuple[str, str] | None:
    """Return message and advice on a wrong call, or None."""
    try:
        bound = signature.bind(*args, **kwargs)
    except TypeError as error:
        otherwise = str(error)
    else:
        found = (_type_message(signature, word, value) for word, value in bound.arguments.items())
        return next(((message, "") for message in found if message), None)
    taken = {name: part for name, part in signature.parameters.items() if name != "self"}
    known = ", ".join(taken)
    for word in kwargs:
        if word not in taken:
            return f"unknown argument {word!r}", _argument(word, kwargs[word], [*taken])
    placed = [word for word, part in taken.items() if part.kind is not part.KEYWORD_ONLY]
    count = len(args) - (len(signature.parameters) > len(taken))
    if count > len(placed):
        named = ", ".join(word for word in taken if word not in placed)
        listed = ", ".join(placed) or "nothing"
        advice = f"pass the others by name: {named}"
        if "parameters" in taken and isinstance(args[-1], Mapping):
            shown = repr(args[-1])
            advice = f"write parameters={shown if len(shown) <= 80 else '{...}'}"
        return f"too many positional arguments; these may be positional: {listed}", advice
    for word in placed[count:]:
        if taken[word].default is inspect.Parameter.empty and word not in kwargs:
            return f"{word!r} is missing", f"it takes {known}"
    return otherwise, f"it takes {known}"


def _type_message(signature: inspect.Signature, word: str, value: object) -> str:
    """Return a message on an argument of a wrong type, or an empty text."""
    annotation = str(signature.parameters[word].annotation)
    kind = annotation.removesuffix(" | None").replace("str | Path", "Path | str")
    if kind not in _KINDS or (value is None and annotation.endswith(" | None")):
        return ""
    wanted, words = _KINDS[kind]
    return "" if isinstance(value, wanted) else f"{word} must be {words}, not {value!r}"


def _argument(word: str, value: object, known: list[str]) -> str:
    """Return advice on an unknown argument."""
    meant, listed = _ARGUMENTS.get(word, word), ", ".join(known)
    if meant in known:
        return f"write {meant}=...; known: {listed}"
    if meant in {part.name for part in fields(Setting)}:
        runner = f"pass it to a runner, Runner(model, {meant}=...)"
        return f"{runner}, or write it into the settings; known: {listed}"
    advice = close_matches(word, known)
    if "over" in known and hasattr(value, "__len__") and not advice.startswith("did"):
        return f"to sweep a parameter, write over={{{word!r}: [...]}}; {advice}"
    if "parameters" in known and isinstance(value, Real) and not advice.startswith("did"):
        return f"for a parameter of the model, write parameters={{{word!r}: {value}}}; {advice}"
    return advice
