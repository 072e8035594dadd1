"""The kinds of documents, found through the entry points of group ``statechart.kinds``.

Entry points are loaded also where a folder hides their package: a folder `models` or `contacts`
beside a script comes first on Python's path.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from statechart.automaton.automaton import Automaton
from statechart.documents.declaration import Declaration
from statechart.errors import StatechartError

if TYPE_CHECKING:
    from statechart.pictures.stage import Stage


@dataclass(frozen=True)
class Kind:
    """One kind of document, as a package offers it.

    The package offers the properties of runs and the sizes of their violations under the name of
    the kind in the groups `statechart.properties` and `statechart.violations` (see `load_entry`).
    """

    name: str  # the value of the document's `kind:`
    model: type[Declaration]  # pydantic model that validates the document
    automaton: Callable[[Any], Automaton]  # builds the automaton of a model
    # A commented document that runs, to start from; the word NAME in it stands for the name of the
    # model.
    starter: Path
    # Makes the stage for pictures of an automaton's runs; None for kinds without pictures.
    stage: Callable[[Automaton], Stage] | None = None

    @property
    def schema(self) -> Path:
        """Its JSON Schema, which is shipped beside the starter."""
        return self.starter.with_name("schema.json").resolve()


def kinds() -> Mapping[str, EntryPoint]:
    """Return the installed kinds by name, none of them imported."""
    return {entry.name: entry for entry in entries("statechart.kinds")}


def kind(name: str) -> Kind:
    """Return a kind, importing its package and no other.

    Raises `KeyError` if there is none of this name. Raises `TypeError` if the entry point leads to
    something else. Raises `StatechartError` if its package is hidden by another of its name.
    """
    return load_kind(kinds()[name])


def load_kind(offered: EntryPoint) -> Kind:
    """Return the kind of one of `kinds`; fails as `kind` does."""
    found = load(offered)
    if not isinstance(found, Kind):
        raise TypeError(f"the entry point of kind {offered.name!r} is not a Kind but {found!r}")
    return found


def load_entry(group: str, name: str) -> Any:
    """Return the object of a kind in a group of entry points; None if there is none.

    Raises `StatechartError` if its package is hidden by another of its name.
    """
    found = {entry.name: entry for entry in entries(group)}
    return load(found[name]) if name in found else None


_OURS = Path(__file__).resolve().parents[2]


@cache
def entries(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group; cached, since the search takes 10 ms."""
    return tuple(importlib.metadata.entry_points(group=group))


def load(entry: EntryPoint) -> Any:
    """Load the object of an entry point.

    Raises `StatechartError` if its package stands beside this one, and another of its name hides
    it.
    """
    home = _home(entry)
    hiding = None if home is None else _hiding_module(home)
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
    if home is None or _hiding_module(home) is None:
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


def _hiding_module(home: Path) -> Path | None:
    """Return the module that hides one of our packages by its name."""
    name = home.parent.name
    found = sys.modules[name].__spec__ if name in sys.modules else importlib.util.find_spec(name)
    if found is None or found.origin is None or Path(found.origin).resolve() == home:
        return None
    return Path(found.origin)
