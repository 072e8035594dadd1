"""Study of a model: its measurements with text and page; stored as trade.json."""

from __future__ import annotations

import json
from base64 import b64encode
from contextlib import suppress
from html import escape
from pathlib import Path
from typing import Any, ClassVar

from pydantic import ValidationError

from statechart.documents.files import explain_os_errors, new_folder, write_atomic
from statechart.errors import DeclarationError
from statechart.study.measurements import Measurements
from statechart.study.text import describe_study
from statechart.tabular import write_plain

NAME = "trade.json"


class Study(Measurements):
    """Work-precision study of a model: runs at many settings against a reference.

    Attributes
    ----------
    model, fingerprint : str
        Name and digest of the model.
    until : float
        End time of the runs.
    reference, check : str
        The reference run, and the independent run that checks it.
    resolution : Errors
        Difference of these two.
    shift : Errors
        Difference of the reference from its run with twice the force tolerance.
    parted : float or None
        Time of separation of reference and check. The motion is then chaotic or ambiguous, and the
        study measures times of separation instead of errors.
    third : Third or None
        A third run if two did not agree: reference and check are the two of three that agree best.
    step : float
        Time step of the check, the finest that can be compared; 0 without time stepping.
    planned : int
        Number of settings.
    warnings : mapping of str to tuple of str
        Label -> warnings of reference, check and third.
    points : tuple of Point
        Errors and costs at the settings.
    left_out : mapping of str to str
        Skipped setting -> reason.
    """

    METHODS: ClassVar[tuple[str, ...]] = ("choose", "error", "front", "kept", "missed")

    def __str__(self) -> str:
        return write_plain(describe_study(self))

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """Return the figure and the text for notebooks."""
        from statechart.study.figure import svg

        picture = f"data:image/svg+xml;base64,{b64encode(svg(self)).decode()}"
        return f'<img src="{picture}" alt="{self.model}"><pre>{escape(str(self))}</pre>'

    def shown(self, label: str) -> dict[str, Any]:
        """Return the data for a page; `label` marks the setting of the run."""
        from statechart.study.figure import page_content

        return page_content(self, label)


def load(folder: Path | str) -> Study | None:
    """Return the study in a folder, or None."""
    path = Path(folder) / NAME
    try:
        with explain_os_errors("read", path), suppress(FileNotFoundError, NotADirectoryError):
            return Study.model_validate_json(path.read_bytes())
        return None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        message = f"{path} is not a study that this version can read: {where}: {first['msg']}"
        raise DeclarationError(message, advice="remove it, or name another folder") from None


def save(folder: Path | str, study: Study) -> None:
    """Write a study to a folder, created if needed."""
    path = Path(folder) / NAME
    # Strict JSON, with non-finite numbers as text.
    text = json.dumps(json.loads(study.model_dump_json()), indent=1, allow_nan=False) + "\n"
    with explain_os_errors("write", path), new_folder(path.parent):
        write_atomic(path, text.encode())
