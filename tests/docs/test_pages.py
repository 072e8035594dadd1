"""Every block of code on a page is done: pages with files or commands are followed in a shell."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from making.following import follow, followed

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    page for page in (ROOT / "docs").rglob("*.md") if "made" not in page.relative_to(ROOT).parts
)
NAMES = {str(page.relative_to(ROOT / "docs")): page for page in PAGES}


@pytest.mark.parametrize("name", [name for name, page in NAMES.items() if followed(page)])
def test_a_page_does_what_it_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    monkeypatch.setenv("PATH", path)
    follow(NAMES[name], tmp_path)
