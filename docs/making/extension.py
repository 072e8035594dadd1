"""Sphinx extension: pages are made before any is read, links are checked when all are written."""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

from making import changelog, formats, gallery, tutorial, verbs
from making.links import dead_links

MADE = "made"
"""Folder of the generated files, relative to the folder of the pages."""

_log = logging.getLogger(__name__)


def setup(app: Sphinx) -> dict[str, bool]:
    """Be asked by Sphinx."""
    # Sphinx asks for what it will copy before anything is made.
    (Path(app.srcdir) / MADE / "files").mkdir(parents=True, exist_ok=True)
    app.connect("builder-inited", _make)
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _make(app: Sphinx) -> None:
    folder = Path(app.srcdir) / MADE
    formats.make(folder)
    verbs.make(folder)
    changelog.make(Path(app.srcdir).parent / "CHANGELOG.md", folder)
    tutorial.make(Path(app.srcdir) / "tutorial.md", folder)
    for name in gallery.make(folder):
        _log.info("made the page of %s", name)


def _check(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.name == "html":
        for page, target in dead_links(Path(app.outdir)):
            _log.warning(
                "a link leads nowhere: %s", target, location=Path(page).with_suffix("").as_posix()
            )
