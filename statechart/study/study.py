"""The study of a model: its measurements with their text and page; trade.json in a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

from pydantic import ValidationError

from statechart.documents.files import new_folder, write_atomic
from statechart.errors import DeclarationError, StatechartError
from statechart.study.measurements import Measurements
from statechart.study.text import format_text

NAME = "trade.json"


class Study(Measurements):
    """Speed against accuracy of a model: its runs at many settings against a reference.

    Attributes
    ----------
    model, fingerprint : str
        Name of the model, and a digest of it.
    until : float
        End of the runs.
    reference, check : str
        The run that the others are compared with, and the independent one that checks it.
    resolution : Errors
        Difference of these two.
    shift : Errors
        Of the reference from its run with twice the tolerance of forces, which all runs share.
    parted : float or None
        When these two left each other: then the motion is chaotic or on a knife's edge, and the
        study measures when runs leave the reference, not errors.
    third : Third or None
        A run of a third kind, where two did not agree: reference and check are the two of three
        that agree best.
    step : float
        Of the check, where it steps in time: no finer step can be judged. Else 0.
    planned : int
        Number of settings.
    warnings : mapping of str to tuple of str
        Warnings of reference, check and third, by their labels.
    points : tuple of Point
        Errors and costs at the settings that were run.
    left_out : mapping of str to str
        Setting -> why it was not run.
    """

    METHODS: ClassVar[tuple[str, ...]] = ("choose", "error", "front", "kept", "missed")

    def __str__(self) -> str:
        return format_text(self)

    def shown(self, label: str) -> dict[str, Any]:
        """Return the part of a page about the study; the run's own setting has this label."""
        from statechart.study.figure import page_content

        return page_content(self, label)


def load(folder: Path | str) -> Study | None:
    """Return the study that a folder holds, None where there is none."""
    path = Path(folder) / NAME
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise StatechartError(f"cannot read {path}: {error.strerror or error}") from error
    try:
        return Study.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise DeclarationError(
            f"{path} is not a study that this version can read: {where}: {first['msg']}",
            advice="remove it, or name another folder",
        ) from None


def save(folder: Path | str, study: Study) -> None:
    """Write a study; the folder is made if it does not exist."""
    path = Path(folder) / NAME
    # Strict JSON: what is not finite is text.
    text = json.dumps(json.loads(study.model_dump_json()), indent=1, allow_nan=False) + "\n"
    try:
        with new_folder(path.parent):
            write_atomic(path, text.encode())
    except OSError as error:
        raise StatechartError(f"cannot write {path}: {error.strerror or error}") from error
