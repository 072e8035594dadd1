"""Runs every shipped model and writes its page: film, run, scene, statechart, curves, source.

    python -m making.gallery FOLDER

makes them without Sphinx, which then finds them.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import models
from making.texts import in_cell, write
from statechart.diagram.write import write as write_diagram
from statechart.loading.kind import kind
from statechart.running.drawing import draw_scene, drawn
from statechart.running.result import Result
from statechart.running.runner import Runner

ROOT = Path(__file__).resolve().parents[2]

_PACKAGES = ("statechart", "contacts", "models", "docs/making")
_FILM = 400  # pixels of its longer side
_LISTED = 8  # values of an output that is a list


def make(folder: Path) -> Iterator[str]:
    """Make what is older than the packages, on all processors; yield the names of the models.

    Parameters
    ----------
    folder : Path
        Pages go to `gallery` there, what the site copies as it is to `files`.
    """
    newest = max(
        file.stat().st_mtime
        for package in _PACKAGES
        for file in (ROOT / package).rglob("*.*")
        if "__pycache__" not in file.parts and file.is_file()
    )
    for place in ("gallery", "files/runs", "files/films"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    stale = [name for name in models.names() if not _fresh(folder, name, newest)]
    if stale:
        # What is compiled in one process is read by the others; threads of numba do not fork.
        with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as processes:
            yield from processes.map(_page, [folder] * len(stale), stale)
    write(folder / "gallery.html", _thumbnails(folder))


def _fresh(folder: Path, name: str, newest: float) -> bool:
    page = folder / "gallery" / f"{name}.md"
    return page.is_file() and page.stat().st_mtime > newest


def _page(folder: Path, name: str) -> str:
    """Make the page of a model, its text last."""
    runner = Runner(name)
    result = runner.run(throw=False)
    place, files = folder / "gallery", folder / "files"
    model = runner.model
    lines = [f"# {name}", "", model.doc, ""]
    if kind(model.kind).stage is not None:
        result.animate(files / "films" / f"{name}.gif", size=_FILM)
        draw_scene(runner, place / f"{name}_scene.png")
    result.report(files / "runs" / f"{name}.html")
    result.plot(place / f"{name}_run.png")
    write_diagram(drawn(runner, known=result.trace)[0], place / f"{name}_modes.svg")
    if kind(model.kind).stage is None:
        shutil.copy(place / f"{name}_modes.svg", files / "films" / f"{name}.svg")
    page = f"../../runs/{name}.html"
    lines += [
        f'<p><a href="{page}">The page of this run</a>: play it, and ask each event why.</p>',
        "",
        f'<iframe class="run" src="{page}" title="A run of {name}" loading="lazy"></iframe>',
        "",
    ]
    if kind(model.kind).stage is not None:
        lines += ["## Scene", "", f"![Where a run of {name} starts]({name}_scene.png)", ""]
        lines += [f'<img src="../../films/{name}.gif" alt="A run of {name}" loading="lazy">', ""]
    lines += ["## Statechart", "", f"![The statechart of {name}]({name}_modes.svg)", ""]
    lines += ["## Run", "", f"![A run of {name}]({name}_run.png)", ""]
    lines += _outputs(result)
    lines += ["## Source", "", f"```{{literalinclude}} ../../../models/{name}.yaml"]
    lines += [":language: yaml", "```"]
    (place / f"{name}.md").unlink(missing_ok=True)
    write(place / f"{name}.md", lines)
    return name


def _outputs(result: Result) -> Iterator[str]:
    yield from ("| output | value |", "|---|---|")
    for name, value in result.outputs.items():
        yield f"| `{name}` | {in_cell(_short(value))} |"
    yield ""
    yield f"It ends as {result.trace.outcome.name}: {result.trace.message}"
    yield ""


def _short(value: object) -> str:
    if isinstance(value, (list, tuple)):
        said = ", ".join(map(_short, value[:_LISTED]))
        return said + (f", ... ({len(value)} in all)" if len(value) > _LISTED else "")
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _thumbnails(folder: Path) -> Iterator[str]:
    """Return what leads to every model: its film, or its statechart where it has no bodies."""
    yield '<div class="gallery">'
    for name in models.names():
        # What has no bodies is seen by its statechart.
        film = f"films/{name}.gif"
        shown = film if (folder / "files" / film).is_file() else f"films/{name}.svg"
        seen = f'<img src="{shown}" alt="" loading="lazy">'
        yield f'<a href="made/gallery/{name}.html">{seen}<b>{name}</b></a>'
    yield "</div>"


if __name__ == "__main__":
    for _ in make(Path(sys.argv[1]).resolve()):
        pass
