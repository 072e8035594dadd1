"""The changelog as pages: one for unreleased changes, and one for each release."""

from __future__ import annotations

import re
from pathlib import Path

from making.texts import write


def make(changelog: Path, folder: Path) -> None:
    """Write a page for each second heading of the changelog, and one that lists them."""
    head, *parts = re.split(r"^## ", changelog.read_text(encoding="utf-8"), flags=re.M)
    names = []
    for part in parts:
        title = part.partition("\n")[0]
        names.append(re.sub(r"[^\w.]+", "-", title.split()[0].lower()))
        # Links of the file start at the root of the repository, those of pages at theirs.
        text = part.replace("\n### ", "\n## ").replace("](docs/", "](../../")
        write(folder / "changelog" / f"{names[-1]}.md", [f"# {title}", text.partition("\n")[2]])
    tree = ["```{toctree}", *(f"changelog/{name}" for name in names), "```"]
    write(folder / "changelog.md", [head.strip().replace("](docs/", "](../"), "", *tree])
