"""Where a study is kept: trade.json in a folder, written whole after every point."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import ValidationError

from statechart.documents.files import made, write_atomic
from statechart.errors import DeclarationError, StatechartError
from statechart.study.record import Study

NAME = "trade.json"


def load(folder: Path | str) -> Study | None:
    """Return the study that a folder holds, None where there is none.

    Raises
    ------
    DeclarationError
        If what is there is no study.
    """
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
    """Write a study; the folder is made if it does not exist.

    Raises
    ------
    StatechartError
        If it cannot be written.
    """
    path = Path(folder) / NAME
    # Strict JSON: what is not finite is text.
    text = json.dumps(json.loads(study.model_dump_json()), indent=1, allow_nan=False) + "\n"
    try:
        with made(path.parent):
            write_atomic(path, text.encode())
    except OSError as error:
        raise StatechartError(f"cannot write {path}: {error.strerror or error}") from error
