"""Where results go: what can be written there, and what is kept there already."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from statechart.errors import DeclarationError

if TYPE_CHECKING:
    from statechart.running.runner import Runner
    from statechart.study.record import Study


def check_folder(output: str | None) -> None:
    """Check that results can be written, before the work that leads to them.

    Raises
    ------
    DeclarationError
        If they cannot.
    """
    if output is None:
        return
    if not output.strip():
        raise DeclarationError("--output: the name is empty", advice="name a folder; . is this one")
    path = Path(output).absolute()
    place = next(known for known in (path, *path.parents) if known.exists())
    if not place.is_dir():
        raise DeclarationError(f"--output {output}: {place} is a file", advice="name a folder")
    if not os.access(place, os.W_OK | os.X_OK):
        raise DeclarationError(
            f"--output {output}: {place} is not writable", advice="name another folder"
        )


def kept_study(arguments: argparse.Namespace) -> Study | None:
    """Return what `trade` has left in the folder where the results go."""
    if arguments.output is None or (arguments.accuracy is None and arguments.budget is None):
        return None
    from statechart.study.file import load

    return load(arguments.output)


def check_file(option: str, output: str | None) -> None:
    """Check that a file can be written, before the work that leads to it.

    Raises
    ------
    DeclarationError
        If it cannot.
    """
    if output is None:
        return
    path = Path(output).absolute()
    if not output.strip() or path.is_dir():
        raise DeclarationError(f"{option} {output}: that is no file", advice="name a file")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK | os.X_OK):
        raise DeclarationError(
            f"{option} {output}: there is no folder {path.parent} that is writable",
            advice="name another folder, or make this one",
        )


def check_page(option: str, output: str | None) -> None:
    """Check that a page can be written, before the run that it shows.

    Raises
    ------
    DeclarationError
        If it is no page, or its place is not writable.
    """
    check_file(option, output)
    if output is not None and Path(output).suffix.lower() not in (".html", ".htm"):
        raise DeclarationError(f"{option} {output}: a page is .html", advice="name it so")


def check_animation(runner: Runner, output: str | None) -> None:
    """Check that an animation of a model can be written, before the run that it shows.

    Raises
    ------
    DeclarationError
        If it is no animation, or its place is not writable.
    StatechartError
        If the model has no bodies, or a program is missing.
    """
    if output is None:
        return
    from statechart.pictures.animation import check
    from statechart.reporting.film import Showing, stage_of

    check_file("--animate", output)
    check(Path(output), Showing.size)
    stage_of(runner.automaton)
