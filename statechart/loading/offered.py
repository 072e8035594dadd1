"""Loads entry points of packages, also where a folder of the same name hides them.

The packages of this project have names that others use, too: a folder `models` or `contacts` beside
a script comes first on Python's path.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

from statechart.errors import StatechartError

_OURS = Path(__file__).resolve().parents[2]


@cache
def entries(group: str) -> tuple[EntryPoint, ...]:
    """Return what is installed in a group, looked for once: that takes 10 ms."""
    return tuple(importlib.metadata.entry_points(group=group))


def load(entry: EntryPoint) -> Any:
    """Return what an entry point names.

    Raises
    ------
    StatechartError
        If its package stands beside this one, and another of its name hides it.
    """
    home = _home(entry)
    hiding = None if home is None else _hiding(home)
    if hiding is not None:
        name = entry.module.partition(".")[0]
        raise StatechartError(
            f"the package {name!r} of statechart is hidden by {hiding}, which comes first on "
            "Python's path; rename that, or run from another folder"
        )
    return entry.load()


def module(entry: EntryPoint) -> ModuleType:
    """Return the module that an entry point names; from its own file, where that is hidden.

    Its package must need no other module of its own.
    """
    home = _home(entry)
    if home is None or _hiding(home) is None:
        return importlib.import_module(entry.module)
    spec = importlib.util.spec_from_file_location(f"statechart's {entry.module}", home)
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def _home(entry: EntryPoint) -> Path | None:
    """Return the file of an entry point's package if it stands beside this one."""
    home = _OURS / entry.module.partition(".")[0] / "__init__.py"
    return home if home.is_file() else None


def _hiding(home: Path) -> Path | None:
    """Return what Python imports by the name of a package of ours instead of it."""
    name = home.parent.name
    found = sys.modules[name].__spec__ if name in sys.modules else importlib.util.find_spec(name)
    if found is None or found.origin is None or Path(found.origin).resolve() == home:
        return None
    return Path(found.origin)
