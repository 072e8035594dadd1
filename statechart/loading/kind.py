"""The kinds of documents, found through the entry points of group ``statechart.kinds``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart.automaton.automaton import Automaton
from statechart.documents.declaration import Declaration
from statechart.loading.offered import entries, load

if TYPE_CHECKING:
    from statechart.pictures.stage import Stage


@dataclass(frozen=True)
class Kind:
    """One kind of document, as a package offers it.

    What must hold for its runs, and by how much it does not, it offers under the kind's name in the
    groups `statechart.properties` and `statechart.violations` (see `offered`).
    """

    name: str  # the value of the document's `kind:`
    model: type[Declaration]  # what the document is validated as
    automaton: Callable[[Any], Automaton]  # builds the automaton of a model
    # A commented document that runs, to start from; the word NAME in it stands for the name of the
    # model.
    starter: Path
    # Makes of an automaton what its runs are seen on; None where there is nothing to see.
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
    return loaded(kinds()[name])


def loaded(offered: EntryPoint) -> Kind:
    """Return the kind of one of `kinds`; fails as `kind` does."""
    found = load(offered)
    if not isinstance(found, Kind):
        raise TypeError(f"the entry point of kind {offered.name!r} is not a Kind but {found!r}")
    return found


def offered(group: str, name: str) -> Any:
    """Return what is installed under a kind's name in a group of entry points; None where nothing.

    Raises `StatechartError` if its package is hidden by another of its name.
    """
    found = {entry.name: entry for entry in entries(group)}
    return load(found[name]) if name in found else None
