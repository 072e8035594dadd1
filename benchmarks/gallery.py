"""Writes docs/gallery.md and its pictures: the statechart of every shipped model.

python benchmarks/gallery.py
"""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image

import models
from statechart.diagram.dot import dot
from statechart.diagram.layout.graphviz_program import render
from statechart.diagram.write import write
from statechart.documents.files import write_atomic
from statechart.running.drawing import drawn
from statechart.running.runner import Runner

DOCS = Path(__file__).parents[1] / "docs"
WIDTH = 1000
# Whose run is shown, too: a gait, a path through nine modes and through one contact's.
VISITED = ("compass_walker", "double_contact_bar", "toppling_stick")

HEAD = (
    "# Gallery\n\n"
    "The statechart of every shipped model, as `statechart draw MODEL -o FILE.png` draws it: a "
    "contact as boxes in boxes, two contacts as a grid, of more what a run visited and each "
    "contact's chart once; guards, resets and conditions once below. "
    "`python benchmarks/gallery.py` makes this page.\n"
)


def picture(model: str, name: str, *, visited: bool = False) -> tuple[str, str]:
    """Draw a model; return what it is and the line that shows it."""
    diagram, _ = drawn(Runner(model), visited=visited)
    with Image.open(io.BytesIO(render(dot(diagram), "png"))) as drawing:
        height = round(WIDTH * drawing.height / drawing.width)
        # What is small stays as it is.
        small = drawing.width <= WIDTH
        shown = drawing if small else drawing.resize((WIDTH, height), Image.Resampling.LANCZOS)
        stream = io.BytesIO()
        shown.convert("RGB").quantize(64).save(stream, "png", optimize=True)
    write_atomic(DOCS / "images" / f"{name}.png", stream.getvalue())
    what = "The path of a run of" if visited else "The statechart of"
    return diagram.notes[0], f"![{what} {model}](images/{name}.png)\n"


def main() -> None:
    lines = [HEAD]
    for model in models.names():
        says, shown = picture(model, f"modes_{model}")
        lines += [f"## {model}\n", f"{says}\n", shown]
        if model in VISITED:
            _, shown = picture(model, f"visited_{model}", visited=True)
            lines += [f"A run, by `statechart draw {model} --visited -o FILE.png`:\n", shown]
        print(model, flush=True)
    write_atomic(DOCS / "gallery.md", "\n".join(lines).encode())
    write(drawn(Runner("toppling_stick"))[0], DOCS / "images" / "toppling_stick_modes.svg")


if __name__ == "__main__":
    main()
