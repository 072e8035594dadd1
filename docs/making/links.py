"""Links within the built site that lead nowhere."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

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
        for target in _read(page.resolve()).targets:
            address = urlsplit(target)
            if address.scheme or address.netloc:
                continue
            file = page.parent / unquote(address.path) if address.path else page
            file = file / "index.html" if file.is_dir() else file
            place = unquote(address.fragment)
            if not file.is_file() or (place and place not in _read(file.resolve()).places):
                yield str(name), target


class _Page(HTMLParser):
    """Links of a page, and the names in it that a link may lead to."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.places: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element says."""
        for attribute, value in attrs:
            if attribute in ("href", "src"):
                self.targets.append(value or "")
            elif attribute in ("id", "name"):
                self.places.add(value or "")


@cache
def _read(page: Path) -> _Page:
    read = _Page()
    if page.suffix == ".html":
        read.feed(page.read_text(encoding="utf-8"))
        read.close()
    return read
