"""Files of the command line: checks that results can be written, and studies found there."""

from __future__ import annotations

import argparse
import os
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart.documents.files import check_folder_name, new_folder, obstacle, write_atomic
from statechart.errors import DeclarationError, StatechartError

if TYPE_CHECKING:
    import xarray as xr

    from statechart.documents.declaration import Declaration
    from statechart.reporting.partial_report import PartialReport
    from statechart.running.runner import Runner
    from statechart.study.study import Study
    from statechart.sweeps.plan import Plan

PATIENCE = 0.9
"""Seconds after a signal in which results are saved, but for those that always are."""
PAGES = (".html", ".htm")
"""Suffixes of a page."""
_STORE, _FILE = ".zarr", ".nc"


def check_folder(output: str | None) -> None:
    """Raise `DeclarationError` for a folder that cannot be written, before the run."""
    if output is None:
        return
    if not output.strip():
        raise DeclarationError("--output: the name is empty", advice="name a folder; . is this one")
    path = Path(output).absolute()
    if is_store(output) and path.exists():
        raise DeclarationError(f"--output {output} exists already", advice="name another store")
    if why := obstacle(path):
        raise DeclarationError(f"--output {output}: {why}", advice="name another folder")
    check_folder_name(output, "--output ")


def check_file(
    option: str, output: str | None, suffixes: Collection[str] = (), *, deep: bool = False
) -> None:
    """Raise `DeclarationError` for a file that cannot be written, before the run.

    With `deep` its folder need not exist yet.
    """
    if output is None:
        return
    if not output.strip():
        raise DeclarationError(f"{option}: the name is empty", advice="name a file")
    path = Path(output).absolute()
    if path.is_dir():
        raise DeclarationError(f"{option} {output}: that is a folder", advice="name a file in it")
    if deep and (why := obstacle(path.parent)):
        raise DeclarationError(f"{option} {output}: {why}", advice="name another place")
    if not deep and (not path.parent.is_dir() or obstacle(path.parent)):
        message = f"{option} {output}: there is no folder {path.parent} that is writable"
        raise DeclarationError(message, advice="name another folder, or make this one")
    if suffixes and path.suffix.lower() not in suffixes:
        known = suffixes if len(suffixes) < 3 else ("one of " + ", ".join(suffixes),)
        raise DeclarationError(f"{option} {output}: the suffix must be {' or '.join(known)}")


def is_store(output: str | None) -> bool:
    """Return whether results are to be written to a Zarr store."""
    return output is not None and Path(output).suffix == _STORE


def stored_study(arguments: argparse.Namespace) -> Study | None:
    """Return the study that `trade` stored in the folder of the results."""
    if arguments.output is None or (arguments.accuracy is None and arguments.budget is None):
        return None
    from statechart.study.study import load

    return load(arguments.output)


def study_for_page(
    model: Declaration, page: str | None, output: str | None = None
) -> tuple[Study | None, tuple[str, ...]]:
    """Return the study that `trade` stored in the folder of a page, and warnings."""
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
                f"the page does not show {folder / NAME}: it belongs to another model or version, "
                f"or to {study.model!r} before a change"
            )
    return None, tuple(warnings)


def film_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options of an animation on the command line."""
    options = {name: getattr(arguments, name) for name in ("speed", "size", "trail")}
    return {name: value for name, value in options.items() if value is not None}


def check_animation(runner: Runner, arguments: argparse.Namespace) -> None:
    """Raise `StatechartError` for an animation that cannot be written, before its run."""
    output, options = arguments.animate, film_options(arguments)
    if output is None:
        if options:
            names = [f"--{name}" for name in options]
            message = f"{' and '.join(names)} need{'s' * (len(names) == 1)} --animate FILM"
            advice = f"add --animate FILM, or remove {'it' if len(names) == 1 else 'them'}"
            raise DeclarationError(message, advice=advice)
        return
    from statechart.pictures.animation import check
    from statechart.reporting.film import stage_of

    check_file("--animate", output)
    check(Path(output), **options)
    stage_of(runner.automaton)


def check_sweep(arguments: argparse.Namespace, plan: Plan) -> None:
    """Raise `DeclarationError` for a store, a file or a picture that cannot be written."""
    from statechart.reporting.figure import SUFFIXES
    from statechart.sweeps.figure import check_drawable

    output = arguments.output
    if is_store(output):
        if why := obstacle(Path(output).absolute().parent):
            raise DeclarationError(f"-o {output}: {why}", advice="name another place")
    else:
        check_file("-o", output, (_STORE, _FILE), deep=True)
        if output is not None and os.path.lexists(output):
            raise DeclarationError(f"{output} exists already", advice="name another, or remove it")
    if arguments.resume and not is_store(output):
        raise DeclarationError("--resume continues a store", advice=f"add -o STORE{_STORE}")
    if arguments.plot is not None:
        check_file("--plot", arguments.plot, SUFFIXES, deep=True)
        check_drawable(plan)


def write_sweep(
    arguments: argparse.Namespace, plan: Plan, data: xr.Dataset, pieces: PartialReport
) -> None:
    """Write the file and the picture of a sweep; note those that cannot be written."""
    from statechart.reporting.figure import render
    from statechart.reporting.tables import netcdf
    from statechart.sweeps.figure import figure

    def write(path: Path, content: bytes) -> None:
        with new_folder(path.parent):
            write_atomic(path, content)

    if arguments.output is not None and not is_store(arguments.output):
        target = Path(arguments.output)
        pieces.keep(str(target), lambda _: write(target, netcdf(data)), None)
    if arguments.plot is not None:
        picture = Path(arguments.plot)
        kind = picture.suffix.lower().lstrip(".")
        pieces.attempt(
            arguments.plot, lambda: write(picture, render(figure(plan, data), kind)), None
        )
