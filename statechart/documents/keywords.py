"""What functions for users are called with: what is wrong is told as a wrong key of a file is."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields
from numbers import Integral, Real
from os import PathLike
from typing import Any, ParamSpec, TypeVar

from statechart.documents.setting import Setting
from statechart.errors import DeclarationError, close_matches

P = ParamSpec("P")
R = TypeVar("R")

_OTHER_WORDS = {
    **dict.fromkeys(("dt", "h", "timestep", "time_step"), "step"),
    **dict.fromkeys(("rtol", "atol", "tol", "eps"), "tolerance"),
    **dict.fromkeys(("solver", "integrator", "backend"), "engine"),
    **dict.fromkeys(("t", "T", "t_end", "tmax", "t_max", "end", "time", "duration"), "until"),
    **dict.fromkeys(("params", "param", "set", "p"), "parameters"),
    **dict.fromkeys(("n", "max_examples"), "examples"),
    **dict.fromkeys(("filename", "file", "output", "out", "dir", "directory"), "path"),
}
"""What other programs call an argument."""

_KINDS: Mapping[str, tuple[tuple[type, ...], str]] = {
    "float": ((Real,), "a number"),
    "int": ((Integral,), "a whole number"),
    "Path | str": ((str, PathLike), "a path"),
    "bool": ((bool,), "True or False"),
}
"""What an argument must be, by its annotation, and in words; of others nothing is told."""

_SETTINGS = {part.name for part in fields(Setting)}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Let a call with arguments that the function has not be a `DeclarationError`: what it has.

    So is one that Python stumbles over because an argument is not what its annotation says.
    Keywords that a function takes as ``**words: Unpack[TypedDict]`` are arguments like the others.
    """
    signature = _expanded(function)
    packed = signature != inspect.signature(function)

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            if packed:
                signature.bind(*args, **kwargs)
            return function(*args, **kwargs)
        except TypeError:
            try:
                signature.bind(*args, **kwargs)
            except TypeError as error:
                wrong = _error(function, signature, args, kwargs, str(error))
            else:
                mistaken = _mistaken(function, signature.bind(*args, **kwargs))
                if mistaken is None:
                    raise
                wrong = mistaken
        raise wrong

    called.__signature__ = signature  # type: ignore[attr-defined]
    return called


def _expanded(function: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a function with the keywords of ``**words`` one by one."""
    signature = inspect.signature(function)
    parts = list(signature.parameters.values())
    if not parts or parts[-1].kind is not inspect.Parameter.VAR_KEYWORD:
        return signature
    packed = parts.pop().annotation.removeprefix("Unpack[").removesuffix("]")
    keyword = inspect.Parameter.KEYWORD_ONLY
    for word, annotation in function.__globals__[packed].__annotations__.items():
        shown = getattr(annotation, "__forward_arg__", annotation)
        parts.append(inspect.Parameter(word, keyword, default=None, annotation=shown))
    return signature.replace(parameters=parts)


def _mistaken(
    function: Callable[..., Any], given: inspect.BoundArguments
) -> DeclarationError | None:
    """Return what is said of the first argument of another kind than its annotation's."""
    for word, value in given.arguments.items():
        annotation = str(given.signature.parameters[word].annotation)
        kind = annotation.removesuffix(" | None").replace("str | Path", "Path | str")
        optional = value is None and annotation.endswith(" | None")
        if kind in _KINDS and not optional and not isinstance(value, _KINDS[kind][0]):
            name = function.__qualname__.removesuffix(".__init__")
            return DeclarationError(f"{name}: {word} must be {_KINDS[kind][1]}, not {value!r}")
    return None


def _error(
    function: Callable[..., Any],
    signature: inspect.Signature,
    args: tuple[object, ...],
    kwargs: Mapping[str, object],
    otherwise: str,
) -> DeclarationError:
    taken = {name: part for name, part in signature.parameters.items() if name != "self"}
    name = function.__qualname__.removesuffix(".__init__")
    unknown = [word for word in kwargs if word not in taken]
    if unknown:
        word = unknown[0]
        return DeclarationError(
            f"{name}: unknown argument {word!r}", advice=_meant(word, kwargs[word], [*taken])
        )
    placed = [word for word, part in taken.items() if part.kind is not part.KEYWORD_ONLY]
    given = len(args) - (len(signature.parameters) > len(taken))
    if given > len(placed):
        named = [word for word in taken if word not in placed]
        return DeclarationError(
            f"{name}: of what is given, {', '.join(placed) or 'nothing'} can stand without a name",
            advice=f"give the others by name: {', '.join(named)}",
        )
    for word in placed[given:]:
        if taken[word].default is inspect.Parameter.empty and word not in kwargs:
            return DeclarationError(
                f"{name}: {word!r} is missing", advice=f"it takes {', '.join(taken)}"
            )
    return DeclarationError(f"{name}: {otherwise}", advice=f"it takes {', '.join(taken)}")


def _meant(word: str, value: object, known: list[str]) -> str:
    meant = _OTHER_WORDS.get(word, word)
    if meant in known:
        return f"write {meant}=...; known: {', '.join(known)}"
    if meant in _SETTINGS:
        return (
            f"say it of a runner, Runner(model, {meant}=...), or among the model's settings; "
            f"known: {', '.join(known)}"
        )
    advice = close_matches(word, known)
    if "parameters" in known and isinstance(value, Real) and not advice.startswith("did"):
        return f"a parameter of the model is given by parameters={{{word!r}: {value}}}; {advice}"
    return advice
