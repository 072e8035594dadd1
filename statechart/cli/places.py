"""Files of the command line: checks that results can be written, and studies found there."""

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
    from statechart.study.study import Study

PATIENCE = 0.9
"""Seconds after a signal in which results are saved, but for those that always are."""


def check_folder(output: str | None) -> None:
    """Raise `DeclarationError` where no results can be written, before the work for them."""
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
    """Return the study that `trade` has left in the folder of the results."""
    if arguments.output is None or (arguments.accuracy is None and arguments.budget is None):
        return None
    from statechart.study.study import load

    return load(arguments.output)


def shown_study(
    model: Declaration, page: str | None, output: str | None = None
) -> tuple[Study | None, tuple[str, ...]]:
    """Return the study that `trade` has left beside the page of a model, and warnings."""
    if page is None:
        return None, ()
    from statechart.study.study import NAME, load

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
    """Raise `DeclarationError` where a file cannot be written, before the work for it."""
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
    """Raise `DeclarationError` where a drawing of another suffix or place cannot be written."""
    check_file("-o", output)
    if Path(output).suffix.lower() not in suffixes:
        raise DeclarationError(f"-o {output}: the suffix must be one of {', '.join(suffixes)}")


def check_page(option: str, output: str | None) -> None:
    """Raise `DeclarationError` where a page cannot be written, before the run that it shows."""
    check_file(option, output)
    if output is not None and Path(output).suffix.lower() not in (".html", ".htm"):
        raise DeclarationError(f"{option} {output}: a page is .html", advice="name it so")


def film_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options of an animation that are given."""
    given = {name: getattr(arguments, name) for name in ("speed", "size", "trail")}
    return {name: value for name, value in given.items() if value is not None}


def check_animation(runner: Runner, output: str | None, options: Mapping[str, Any]) -> None:
    """Raise `StatechartError` where no animation can be written, before the run that it shows."""
    if output is None:
        if options:
            names = [f"--{name}" for name in options]
            raise DeclarationError(
                f"{' and '.join(names)} say{'s' * (len(names) == 1)} how a film is shown",
                advice="say --animate FILM, too, or leave it out",
            )
        return
    from statechart.pictures.animation import check
    from statechart.reporting.film import Showing, stage_of

    check_file("--animate", output)
    shown = Showing(**options)
    check(Path(output), shown.size, shown.speed, shown.trail)
    stage_of(runner.automaton)
