"""JSON Schema of the documents, for editors."""

from __future__ import annotations

import json
from typing import Any

from pydantic.json_schema import models_json_schema

from statechart.errors import DeclarationError, close_matches
from statechart.loading.kind import kind, kinds

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_ID = "urn:contact-statecharts:schema"


def schema(name: str | None = None) -> str:
    """Return the JSON Schema of a kind of document, as text.

    Raises `DeclarationError` if there is no such kind.
    """
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
        # In Python the class says which kind it is; a document has to.
        definitions[key]["required"] = ["kind", *definitions[key].get("required", [])]
        if name is not None:
            result |= definitions.pop(key)
    result["$defs"] = definitions
    return json.dumps(result, indent=2, ensure_ascii=False) + "\n"


def line(name: str) -> str:
    """Return the first line of a document by which editors find the schema of its kind."""
    return f"# yaml-language-server: $schema={kind(name).schema.as_uri()}\n"
