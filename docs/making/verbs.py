"""The reference of the command line, out of its parser."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from making.texts import in_cell, write
from statechart.cli.grammar import parser


def make(folder: Path) -> None:
    """Write the page of all verbs."""
    grammar = parser()
    verbs = next(a for a in grammar._actions if isinstance(a, argparse._SubParsersAction))
    lines = ["# Command line", "", f"{grammar.description}", ""]
    lines += [*(f"{line}  " for line in (grammar.epilog or "").strip().splitlines()), ""]
    lines += _options(grammar._actions)
    for name, verb in verbs.choices.items():
        lines += [f"## {name}", "", f"{_sentence(verb.description)}", ""]
        lines += ["```text", verb.format_usage().removeprefix("usage: ").rstrip(), "```", ""]
        lines += _options(verb._actions)
    write(folder / "command-line.md", lines)


def _options(actions: Sequence[argparse.Action]) -> Iterator[str]:
    shown = [
        a
        for a in actions
        if not isinstance(a, argparse._HelpAction | argparse._SubParsersAction)
        and a.help != argparse.SUPPRESS
    ]
    if shown:
        yield from ("| | |", "|---|---|")
        yield from (f"| {_name(action)} | {in_cell(_meaning(action))} |" for action in shown)
        yield ""


def _name(action: argparse.Action) -> str:
    value = action.metavar if action.metavar is not None else action.dest.upper()
    if action.choices is not None:
        value = "|".join(map(str, action.choices))
    if not action.option_strings:
        return f"`{in_cell(value)}`"
    takes = action.nargs != 0
    return ", ".join(
        f"`{option} {in_cell(value)}`" if takes else f"`{option}`"
        for option in action.option_strings
    )


def _meaning(action: argparse.Action) -> str:
    values = {**vars(action), "prog": "statechart"}
    return _sentence((action.help or "") % values)


def _sentence(text: str | None) -> str:
    text = (text or "").strip()
    return text[:1].upper() + text[1:] + ("" if not text or text.endswith(".") else ".")
