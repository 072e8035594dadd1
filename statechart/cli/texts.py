"""The verbs that print or write texts, and run nothing."""

from __future__ import annotations

import argparse
from pathlib import Path

from statechart.errors import DeclarationError


def schema(arguments: argparse.Namespace) -> int:
    """Print the JSON Schema of one kind of document, or of all."""
    from statechart.loading.schema import schema as schema_of

    print(schema_of(arguments.kind), end="")
    return 0


def new(arguments: argparse.Namespace) -> int:
    """Write a scene to start from."""
    from statechart.cli.places import check_file
    from statechart.documents.files import write_atomic
    from statechart.documents.yaml_reader import read_text
    from statechart.documents.yaml_text import resolve
    from statechart.formulas.syntax import NAME
    from statechart.formulas.tree import RESERVED
    from statechart.loading.kind import kind
    from statechart.loading.load import interpret
    from statechart.loading.schema import line

    name = arguments.name
    if not NAME.fullmatch(name) or name in RESERVED or not isinstance(resolve(name), str):
        raise DeclarationError(
            f"{name!r} cannot be the name of a model",
            advice="letters, digits and _, not beginning with a digit, no word of formulas or YAML",
        )
    path = Path(f"{name}.yaml")
    if path.exists() or path.is_symlink():
        raise DeclarationError(f"{path} exists already", advice="choose another name")
    check_file("new", str(path))
    text = line("scene") + kind("scene").starter.read_text(encoding="utf-8").replace("NAME", name)
    interpret(read_text(text, str(path)))
    write_atomic(path, text.encode())
    print(f"{path} written; run it with: statechart run {path}")
    return 0


def completion(arguments: argparse.Namespace) -> int:
    """Print what a shell is to read to complete commands."""
    from statechart.cli.completion import script
    from statechart.cli.grammar import parser

    print(script(parser(), arguments.shell))
    return 0
