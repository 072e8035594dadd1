"""The tutorial's pictures, made by doing what it says."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from making.following import follow

PICTURES = ("scene.png", "modes.svg", "crate.gif")


def make(page: Path, folder: Path) -> None:
    """Follow the tutorial, unless its pictures are there and younger, and keep these."""
    made = [folder / "tutorial" / name for name in PICTURES]
    if all(file.is_file() and file.stat().st_mtime > page.stat().st_mtime for file in made):
        return
    (folder / "tutorial").mkdir(parents=True, exist_ok=True)
    # What is installed beside this Python is what the reader's shell finds.
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as fresh:
        follow(page, Path(fresh))
        for file in made:
            shutil.copy(Path(fresh) / file.name, file)
