"""Loads models from files, or by the names of shipped ones; JSON Schema of the documents."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from statechart.documents.declaration import Declaration
from statechart.documents.validation import Document, validate
from statechart.documents.yaml_reader import read
from statechart.errors import DeclarationError, close_matches
from statechart.loading.kind import entries, kind, kinds, load_kind, module


def interpret(document: Document) -> Declaration:
    """Build the model of the kind that the document names in its `kind:`.

    Raises `DeclarationError` if it names no known kind, or is not a correct model of it.
    """
    name = document.data.get("kind")
    offered = kinds().get(name) if isinstance(name, str) else None
    if offered is not None:
        return validate(document, load_kind(offered).model)
    at = document.position(("kind",))
    named, known = name is not None, close_matches(str(name), kinds())
    if named:
        raise at.error(f"unknown kind {name!r}", known)
    wrong = "kind: nothing is written" if "kind" in document.data else "'kind' is missing"
    raise at.error(wrong, f"begin with kind: scene (bodies) or kind: chart (states alone); {known}")


def load(path_or_name: str | Path) -> Declaration:
    """Read a model: a file, or a shipped model by its name.

    Parameters
    ----------
    path_or_name : str or Path
        An existing file comes first.

    Raises
    ------
    DeclarationError
        If there is none, or it is wrong.

    Examples
    --------
    >>> load("toppling_stick").doc
    'A stick balanced on its tip topples toward +x and may slip (paper, section 4).'
    """
    return resolve_model(path_or_name)[0]


def resolve_model(
    model: Declaration | Document | str | Path,
) -> tuple[Declaration, Document | None]:
    """Return a model, and the document that it was read from.

    Raises `DeclarationError` if it is none of these, or wrong.
    """
    if isinstance(model, str | Path):
        model = read(find(str(model)))
    if isinstance(model, Document):
        return interpret(model), model
    if not isinstance(model, Declaration):
        raise DeclarationError(
            (
                "a model is a file, the name of a shipped model, or a Scene or Chart, not of "
                f"type {type(model).__name__}"
            ),
            advice="build contacts.Scene(...) or statechart.Chart(...), or write a file",
        )
    return model, None


def find(path_or_name: str) -> Path:
    """Return the file that a path or the name of a shipped model stands for.

    Raises `DeclarationError` if neither exists; with the names that it may have meant.
    """
    if not path_or_name.strip():
        raise DeclarationError(
            "the name of the model is empty", advice=close_matches(path_or_name, shipped_models())
        )
    path = Path(path_or_name)
    try:
        exists, is_file = path.exists(), path.is_file()
    except (OSError, ValueError) as error:
        raise DeclarationError(f"not a path: {error}", source=repr(path_or_name)) from None
    if is_file:
        return path
    for offered in entries("statechart.models"):
        of_name: Callable[[str], Path | None] = getattr(module(offered), offered.attr)
        if (found := of_name(path_or_name)) is not None:
            return found
    if exists:
        return path
    for suffix in (".yaml", ".yml"):
        if os.path.isfile(f"{path}{suffix}"):
            raise DeclarationError(
                f"no such file: {path_or_name!r}", advice=f"write {path}{suffix}"
            )
    meant = close_matches(path.stem, shipped_models())
    if path.suffix in (".yaml", ".yml") and not meant.startswith("did"):
        raise DeclarationError(
            f"no such file: {path_or_name!r}", advice="`statechart new NAME` writes one"
        )
    raise DeclarationError(
        f"no such file, and no shipped model of this name: {path_or_name!r}",
        advice=close_matches(path_or_name, shipped_models()),
    )


def shipped_models() -> list[str]:
    """Return the names of the models that installed packages offer."""
    names: list[str] = []
    for offered in entries("statechart.models"):
        names += getattr(module(offered), "names", list)()
    return names


_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_ID = "urn:contact-statecharts:schema"


def schema(name: str | None = None) -> str:
    """Return the JSON Schema of a kind of document, as text.

    Raises `DeclarationError` if there is no such kind.
    """
    from pydantic.json_schema import models_json_schema

    if name is not None and name not in kinds():
        raise DeclarationError(f"no kind {name!r}", advice=close_matches(name, kinds()))
    models = [kind(each).model for each in ([name] if name else sorted(kinds()))]
    references, found = models_json_schema([(model, "validation") for model in models])
    definitions: dict[str, Any] = found["$defs"]
    result: dict[str, Any] = {"$schema": _DIALECT, "$id": f"{_ID}:{name or 'document'}"}
    if name is None:
        result["oneOf"] = [references[model, "validation"] for model in models]
    for model in models:
        key = str(references[model, "validation"]["$ref"]).rpartition("/")[2]
        # In Python the class determines the kind; a document must name it.
        definitions[key]["required"] = ["kind", *definitions[key].get("required", [])]
        if name is not None:
            result |= definitions.pop(key)
    result["$defs"] = definitions
    return json.dumps(result, indent=2, ensure_ascii=False) + "\n"


def line(name: str) -> str:
    """Return the first line of a document by which editors find the schema of its kind."""
    return f"# yaml-language-server: $schema={kind(name).schema.as_uri()}\n"
