"""What a shell completes: verbs, options, files, and the names of shipped models."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import shtab

from statechart.loading.load import shipped

_FOLDERS = ("DIR",)
_FILES = ("PATH", "FILM", "PAGE", "PICTURE", "TABLE.csv")


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return what a shell is to read to complete commands."""
    completed = {"FILE": _models(), **dict.fromkeys(_FILES, shtab.FILE)}
    completed |= dict.fromkeys(_FOLDERS, shtab.DIRECTORY)
    for action in _actions(parser):
        if isinstance(action.metavar, str) and action.metavar in completed:
            action.complete = completed[action.metavar]  # type: ignore[attr-defined]
    text: str = shtab.complete(parser, shell)
    return text


def _models() -> dict[str, object]:
    """Return how shells complete a model: the name of a shipped one, or a file."""
    names = " ".join(sorted(shipped()))
    return {
        "bash": "_statechart_model_file",
        "zsh": "_statechart_models",
        "fish": "(__statechart_models)",
        "preamble": {
            "bash": "_statechart_model_file() {\n"
            f'  compgen -W "{names}" -- "$1"\n  compgen -f -- "$1"\n}}',
            "zsh": "_statechart_models() {\n"
            f"  _alternative 'models:shipped model:({names})' 'files:file:_files'\n}}",
            "fish": "function __statechart_models\n"
            f"  printf '%s\\n' {names}\n  __fish_complete_path (commandline -ct)\nend",
        },
    }


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from _actions(verb)
