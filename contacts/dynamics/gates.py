"""Gates of contacts: the relations `enabled`, and the ends of edges, over smooth atoms.

A contact is off where its gate does not hold. The margins of its atoms fall as atoms cease to hold
while it is on, and as they begin to hold, or its gap to be open, while it is off. A certificate
says which of them are watched (see `statechart.formulas.condition`).
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from contacts.states import OFF
from statechart.arrays import Ints
from statechart.automaton.regions import Margin
from statechart.formulas.condition import Every, Some, replaced
from statechart.formulas.relation import States, parse_relation
from statechart.kernels.jit import seldom

HOLDS, FAILS, UNSURE = 1, -1, 0
"""Judgements of an atom, and of a gate; the last where derivatives are to decide."""
EVERY, SOME = -1, -2
"""Nodes of `tree` that hold where all of their parts do, and where one does."""

# Added to a margin by steps: a zero then counts as its relation says.
_TIE = 1e-300


class GateAtom(NamedTuple):
    """An atom of a gate.

    Attributes
    ----------
    name, back : str
        Names of the margins that fall as it ceases to hold, and as it begins to.
    words : str
        The relation that it belongs to.
    margin : Expr
        At or above 0 while it holds.
    closed : bool
        Whether it holds at 0.
    """

    name: str
    back: str
    words: str
    margin: sp.Expr
    closed: bool


@dataclass(frozen=True, eq=False)
class Gate:
    """The gate of a contact.

    Attributes
    ----------
    contact : str
    atoms : tuple of GateAtom
    root : int, Every or Some
        Leaves are places in `atoms`.
    wholes : mapping
        Words of a relation of several atoms -> its margin.
    """

    contact: str
    atoms: tuple[GateAtom, ...]
    root: Any
    wholes: Mapping[str, sp.Expr]

    @property
    def gap(self) -> str:
        """Name of the margin that falls as the gap opens while the contact is off."""
        return f"{self.contact}.{OFF}: gap"

    @property
    def margins(self) -> tuple[Margin, ...]:
        """The margins of its atoms, >= 0 while they hold."""
        return tuple(
            Margin(
                atom.name,
                atom.margin,
                relation=atom.words if atom.words in self.wholes else "",
                whole=self.wholes.get(atom.words),
            )
            for atom in self.atoms
        )

    def back(self, gap: sp.Expr) -> tuple[Margin, ...]:
        """Return the margins that bring the contact back: of its atoms, and of its gap."""
        parts = dict.fromkeys(atom.words for atom in self.atoms)
        margins = {atom.words: atom.margin for atom in self.atoms} | dict(self.wholes)
        whole = -sp.Min(gap, *(margins[words] for words in parts), evaluate=False)
        found = [*((atom.back, atom.margin) for atom in self.atoms), (self.gap, gap)]
        return tuple(
            Margin(name, -margin, relation=f"{self.contact}.{OFF}", whole=whole)
            for name, margin in found
        )

    def by_steps(self, values: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
        """Return the margin of the gate where steps judge it at their ends: > 0 while it holds."""
        if len(self.atoms) == 1:
            return self.atoms[0].margin.xreplace(values)

        def margin(tree: Any) -> sp.Expr:
            if isinstance(tree, Every | Some):
                return (sp.Min if isinstance(tree, Every) else sp.Max)(*map(margin, tree.parts))
            atom = self.atoms[tree]
            found = atom.margin.xreplace(values)
            if atom.words not in self.wholes:
                return found
            return found + sp.Float(_TIE if atom.closed else -_TIE)

        return margin(self.root)


def gate_of(
    contact: str,
    relations: Sequence[str],
    known: Mapping[str, sp.Expr],
    states: States,
    ends: Mapping[str, sp.Expr],
) -> Gate:
    """Return the gate of a contact.

    Parameters
    ----------
    contact : str
    relations : sequence of str
        Must all hold.
    known : mapping
        Name -> expression.
    states : mapping
        (controller, state) -> what is above 0 while the state is active, below 0 else.
    ends : mapping
        Words -> expression that must be at or above 0, too: ends of an edge.
    """
    atoms: list[GateAtom] = []
    parts: list[Any] = []
    wholes: dict[str, sp.Expr] = {}
    for text in relations:
        relation = parse_relation(text)
        condition, words, first = (
            relation.condition(known, states),
            f"{contact}: {text}",
            len(atoms),
        )
        if not condition.single:
            wholes[words] = -relation.margin(known, states)
        backs = condition.names(f"{contact}.{OFF}: {text}")
        for name, back, atom in zip(condition.names(words), backs, condition.atoms, strict=True):
            atoms.append(GateAtom(name, back, words, -atom.expression, not atom.strict))
        parts.append(replaced(condition.root, partial(operator.add, first)))
    for end, margin in ends.items():
        parts.append(len(atoms))
        words = f"{contact}: {end}"
        atoms.append(GateAtom(words, f"{contact}.{OFF}: {end}", words, margin, True))
    return Gate(contact, tuple(atoms), Every(tuple(parts)), wholes)


def tree(gates: Sequence[Gate | None]) -> Ints:
    """Return the trees of gates as nodes (m, 3): every node stands before those below it.

    Columns: the place of an atom among those of all gates, or `EVERY`, `SOME`; the node above, -1
    at the top; the contact.
    """
    rows: list[tuple[int, int, int]] = []

    def add(node: Any, above: int, place: int, first: int) -> None:
        here = len(rows)
        if isinstance(node, Every | Some):
            rows.append((EVERY if isinstance(node, Every) else SOME, above, place))
            for part in node.parts:
                add(part, here, place, first)
        else:
            rows.append((first + node, above, place))

    first = 0
    for place, gate in enumerate(gates):
        if gate is not None:
            add(gate.root, -1, place, first)
            first += len(gate.atoms)
    return np.array(rows, np.int64).reshape(-1, 3)


@seldom
def truths(nodes: Ints, verdicts: Ints, found: Ints) -> None:
    """Write the verdict of every node (m,) of `tree`, from those of the atoms (k,)."""
    for i in range(nodes.shape[0]):
        kind = nodes[i, 0]
        found[i] = HOLDS if kind == EVERY else FAILS if kind == SOME else verdicts[kind]
    for i in range(nodes.shape[0] - 1, -1, -1):
        above = nodes[i, 1]
        if above >= 0:
            every = nodes[above, 0] == EVERY
            found[above] = min(found[above], found[i]) if every else max(found[above], found[i])


@seldom
def opens(whole: int, gap: float, near: float) -> bool:
    """Return whether the gap of a contact that is off is watched, by the verdict of its gate.

    A gate that is open to doubt fails if the contact is off though its gap is not below -`near`.
    """
    return whole == HOLDS or (whole == UNSURE and gap < -near)


@seldom
def certificates(nodes: Ints, found: Ints, on: Ints, off: Ints) -> None:
    """Write which atoms (k,) decide whether gates go on to hold, and to fail: 1, else 0.

    An atom that fails is watched by a contact that is on only if its gate fails as a whole: then
    its margin falls at once.
    """
    needed = np.zeros(nodes.shape[0], np.int64)
    on[:] = 0
    off[:] = 0
    whole = UNSURE
    for i in range(nodes.shape[0]):
        kind = nodes[i, 0]
        if nodes[i, 1] < 0:
            needed[i], whole = 1, found[i]
        if needed[i] == 0:
            continue
        if kind >= 0:
            on[kind] = 1 if found[i] != FAILS or whole == FAILS else 0
            off[kind] = 1 if found[i] != HOLDS else 0
            continue
        one = found[i] == (FAILS if kind == EVERY else HOLDS)
        for j in range(i + 1, nodes.shape[0]):
            if nodes[j, 1] == i and (not one or found[j] == found[i]):
                needed[j] = 1
                if one:
                    break
