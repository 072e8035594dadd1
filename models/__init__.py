"""The shipped models: scenes and charts as data, one YAML file each."""

from __future__ import annotations

from pathlib import Path

_FOLDER = Path(__file__).parent


def names() -> tuple[str, ...]:
    """Return the names of the shipped models."""
    return tuple(sorted(file.stem for file in _FOLDER.glob("*.yaml")))


def path(name: str) -> Path | None:
    """Return the file of the shipped model `name`, or None."""
    return _FOLDER / f"{name}.yaml" if name in names() else None
