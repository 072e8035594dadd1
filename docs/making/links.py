"""Links within the built site that lead nowhere."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote, urlsplit

from bs4 import BeautifulSoup

# Pages that need nothing else: what their script links is not there before it runs.
_ALONE = "runs"


def dead_links(site: Path) -> Iterator[tuple[str, str]]:
    """Yield page and target of every link to a file or a place that is not there.

    Parameters
    ----------
    site : Path
        The folder of the built site. What is elsewhere is not asked for.
    """
    for page in sorted(site.rglob("*.html")):
        name = page.relative_to(site)
        if name.parts[0] == _ALONE:
            continue
        for target in _targets(page):
            address = urlsplit(target)
            if address.scheme or address.netloc:
                continue
            file = page.parent / unquote(address.path) if address.path else page
            file = file / "index.html" if file.is_dir() else file
            place = unquote(address.fragment)
            if not file.is_file() or (place and place not in _places(file.resolve())):
                yield str(name), target


def _targets(page: Path) -> Iterator[str]:
    for element in _read(page).find_all(True):
        for attribute in ("href", "src"):
            if attribute in element.attrs:
                yield str(element[attribute])


@cache
def _places(page: Path) -> frozenset[str]:
    """Return the names in a page that a link may lead to."""
    if page.suffix != ".html":
        return frozenset()
    return frozenset(
        str(element[key])
        for element in _read(page).find_all(True)
        for key in ("id", "name")
        if key in element.attrs
    )


def _read(page: Path) -> BeautifulSoup:
    return BeautifulSoup(page.read_text(encoding="utf-8"), "html.parser")
