"""Where results go: what can be written there, and what is kept there already."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart.documents.files import obstacle
from statechart.errors import DeclarationError, StatechartError

if TYPE_CHECKING:
    from statechart.documents.declaration import Declaration
    from statechart.running.runner import Runner
    from statechart.study.record import Study

PATIENCE = 0.9
"""Seconds after a signal in which what was computed is saved, but for what is always saved."""


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
    if is_store(output) and path.exists():
        raise DeclarationError(
            f"--output {output}: there is something of this name",
            advice="name another store: runs are not written over each other",
        )
    if why := obstacle(path):
        raise DeclarationError(f"--output {output}: {why}", advice="name another folder")


def is_store(output: str) -> bool:
    """Return whether a run is to be written to a Zarr store."""
    return Path(output).suffix == ".zarr"


def kept_study(arguments: argparse.Namespace) -> Study | None:
    """Return what `trade` has left in the folder where the results go."""
    if arguments.output is None or (arguments.accuracy is None and arguments.budget is None):
        return None
    from statechart.study.file import load

    return load(arguments.output)


def shown_study(
    model: Declaration, page: str | None, output: str | None = None
) -> tuple[Study | None, tuple[str, ...]]:
    """Return what `trade` has left of a model beside its page, and what is to be warned of."""
    if page is None:
        return None, ()
    from statechart.study.file import NAME, load

    warnings = []
    for folder in dict.fromkeys((Path(page).parent, *([] if output is None else [Path(output)]))):
        try:
            study = load(folder)
        except StatechartError as error:
            warnings.append(f"the page shows no study: {error}")
            continue
        if study is not None and study.of(model):
            return study, tuple(warnings)
        if study is not None:
            warnings.append(
                f"the page does not show {folder / NAME}: it is of another model, or of "
                f"{study.model!r} as it was before it was changed or by another version"
            )
    return None, tuple(warnings)


def check_file(option: str, output: str | None) -> None:
    """Check that a file can be written, before the work that leads to it.

    Raises
    ------
    DeclarationError
        If it cannot.
    """
    if output is None:
        return
    if not output.strip():
        raise DeclarationError(f"{option}: the name is empty", advice="name a file")
    path = Path(output).absolute()
    if path.is_dir():
        raise DeclarationError(f"{option} {output}: that is a folder", advice="name a file in it")
    if not path.parent.is_dir() or obstacle(path.parent):
        raise DeclarationError(
            f"{option} {output}: there is no folder {path.parent} that is writable",
            advice="name another folder, or make this one",
        )


def check_drawing(output: str, suffixes: Collection[str]) -> None:
    """Check that a drawing can be written, before what it shows is made.

    Raises
    ------
    DeclarationError
        If its suffix is none of these, or its place is not writable.
    """
    check_file("-o", output)
    if Path(output).suffix.lower() not in suffixes:
        raise DeclarationError(f"-o {output}: the suffix must be one of {', '.join(suffixes)}")


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


def showing(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return how an animation is to be shown, as far as that is said."""
    said = {name: getattr(arguments, name) for name in ("speed", "size", "trail")}
    return {name: value for name, value in said.items() if value is not None}


def check_animation(runner: Runner, output: str | None, said: Mapping[str, Any]) -> None:
    """Check that an animation of a model can be written, before the run that it shows.

    Raises
    ------
    DeclarationError
        If it is no animation, its place is not writable, or how it is to be shown is wrong.
    StatechartError
        If the model has no bodies, or a program is missing.
    """
    if output is None:
        if said:
            names = [f"--{name}" for name in said]
            raise DeclarationError(
                f"{' and '.join(names)} say{'s' * (len(names) == 1)} how a film is shown",
                advice="say --animate FILM, too, or leave it out",
            )
        return
    from statechart.pictures.animation import check
    from statechart.reporting.film import Showing, stage_of

    check_file("--animate", output)
    shown = Showing(**said)
    check(Path(output), shown.size, shown.speed, shown.trail)
    stage_of(runner.automaton)
