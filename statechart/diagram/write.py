"""A diagram into a file, in the format that its suffix names."""

from __future__ import annotations

from pathlib import Path

from statechart.diagram.dot import dot
from statechart.diagram.graphml import graphml
from statechart.diagram.layout.graphviz_program import render
from statechart.diagram.legend import Guards
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Diagram
from statechart.diagram.scxml import scxml
from statechart.documents.files import write_atomic
from statechart.errors import StatechartError

_LABELLED = {".dot": dot, ".mmd": mermaid}
_TEXTS = {".scxml": scxml, ".graphml": graphml}
_PICTURES = {".svg": "svg", ".png": "png", ".pdf": "pdf"}

SUFFIXES = (*_PICTURES, *_LABELLED, *_TEXTS)
"""What `write` can write."""


def write(diagram: Diagram, path: Path, guards: Guards = "legend") -> None:
    """Write a diagram; svg, png and pdf need no Graphviz program and no installed fonts.

    Raises
    ------
    StatechartError
        If the suffix is not known, the picture cannot be laid out, or the file not written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise StatechartError(
            f"cannot draw to {str(path)!r}: its suffix must be one of {', '.join(SUFFIXES)}"
        )
    if not path.parent.is_dir():
        raise StatechartError(f"cannot write {str(path)!r}: there is no folder {path.parent}")
    if suffix in _TEXTS:
        data = _TEXTS[suffix](diagram).encode()
    elif suffix in _LABELLED:
        data = _LABELLED[suffix](diagram, guards).encode()
    else:
        data = render(dot(diagram, guards), _PICTURES[suffix])
    try:
        write_atomic(path, data)
    except OSError as error:
        raise StatechartError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
