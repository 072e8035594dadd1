"""Gates of contacts: the relations `enabled`, and the ends of edges, over smooth atoms.

A contact is off where its gate does not hold. The margins of its atoms fall as atoms cease to hold
while it is on, and as they begin to hold, or its gap to be open, while it is off. A certificate
says which of them are watched (see `statechart.formulas.condition`).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Array, Ints, Ints32
from statechart.automaton.margin_derivatives import UNDERFLOW
from statechart.automaton.regions import Margin
from statechart.formulas.condition import Every, Some, replaced
from statechart.formulas.relation import States, parse_relation
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import tape_values

HOLDS, FAILS, UNSURE = 1, -1, 0
"""Judgements of an atom, and of a gate; the last where derivatives are to decide."""
EVERY, SOME = -1, -2
"""Nodes of `tree` that hold where all of their parts do, and where one does."""

PER_CONDITION = 4
"""Numbers of a condition: its margin, the first derivative in time, the sizes of their terms."""
# At a multiple zero the terms vanish with f: they are looked at this far beside it, a power of the
# relative round-off, so that what rounds to zero there does not.
_OFFSET_POWER = 0.75
# Added to a margin by steps: a zero then counts as its relation says.
_TIE = 1e-300


class GateAtom(NamedTuple):
    """An atom of a gate."""

    # `name`, `back`: Names of the margins that fall as it ceases to hold, and as it begins to
    name: str
    back: str
    words: str  # The relation that it belongs to
    margin: sp.Expr  # At or above 0 while it holds
    closed: bool  # It holds at 0


@dataclass(frozen=True, eq=False)
class Gate:
    """The gate of a contact."""

    contact: str
    off: str  # Its state while the gate does not hold, as in ``tip.off``
    atoms: tuple[GateAtom, ...]
    root: Any  # Leaves are places in `atoms`
    wholes: Mapping[str, sp.Expr]  # Words of a relation of several atoms -> its margin

    @property
    def gap(self) -> str:
        """Name of the margin that falls as the gap opens while the contact is off."""
        return f"{self.off}: gap"

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
        found = [(atom.back, atom.margin) for atom in self.atoms]
        limits = [margins[words] for words in parts]
        if gap != 0:
            # A coupling has none.
            found.append((self.gap, gap))
            limits.insert(0, gap)
        whole = -sp.Min(*limits, evaluate=False)
        return tuple(
            Margin(name, -margin, relation=self.off, whole=whole) for name, margin in found
        )

    def by_steps(
        self, values: Mapping[sp.Symbol, sp.Expr], valleys: Mapping[str, sp.Expr] | None = None
    ) -> sp.Expr:
        """Return the margin of the gate where steps judge it at their ends: > 0 while it holds.

        An end of an edge counts for nothing where its value in `valleys` is positive.
        """
        eased = valleys or {}
        if len(self.atoms) == 1 and not eased:
            return self.atoms[0].margin.xreplace(values)

        def margin(tree: Any) -> sp.Expr:
            if isinstance(tree, Every | Some):
                return (sp.Min if isinstance(tree, Every) else sp.Max)(*map(margin, tree.parts))
            atom = self.atoms[tree]
            found = atom.margin.xreplace(values)
            if atom.words in eased:
                found = sp.Max(found, eased[atom.words])
            if atom.words not in self.wholes:
                return found
            return found + sp.Float(_TIE if atom.closed else -_TIE)

        return margin(self.root)


def gate_of(
    off: str,
    relations: Sequence[str],
    known: Mapping[str, sp.Expr],
    states: States,
    ends: Mapping[str, sp.Expr],
) -> Gate:
    """Return the gate of a contact: the conjunction of relations, and of `ends` of an edge.

    `off` is the contact with its state while the gate does not hold, as in ``tip.off``. `known`
    are the expressions of names; those of `states`, by controller and state, are above 0 while the
    state is active, below 0 else. Ends are words -> an expression that is >= 0.
    """
    contact, atoms = off.rpartition(".")[0], list[GateAtom]()
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
        backs = condition.names(f"{off}: {text}")
        for name, back, atom in zip(condition.names(words), backs, condition.atoms, strict=True):
            atoms.append(GateAtom(name, back, words, -atom.expression, not atom.strict))
        parts.append(replaced(condition.root, partial(operator.add, first)))
    for end, margin in ends.items():
        parts.append(len(atoms))
        words = f"{contact}: {end}"
        atoms.append(GateAtom(words, f"{off}: {end}", words, margin, True))
    return Gate(contact, off, tuple(atoms), Every(tuple(parts)), wholes)


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


@kernel
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


@kernel
def opens(whole: int, gap: float, near: float) -> bool:
    """Return whether the gap of a contact that is off is watched, by the verdict of its gate.

    A gate that is open to doubt fails if the contact is off though its gap is not below -`near`.
    """
    return whole == HOLDS or (whole == UNSURE and gap < -near)


@kernel
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


@kernel
def round_off(size: float, relative: float) -> float:
    """Return up to which amount a condition is zero whose terms are so large."""
    return max(relative * size, UNDERFLOW) if size < math.inf else UNDERFLOW


@kernel
def judge(value: float, rate: float, size: float, slow: float, relative: float) -> int:
    """Judge a condition by its margin and the first derivative of that.

    The sizes of their terms are `size` and `slow`, of which the part `relative` is zero.
    """
    band = round_off(size, relative)
    if value > band:
        return HOLDS
    if value < -band:
        return FAILS
    if abs(rate) > relative * slow:
        return HOLDS if rate > 0.0 else FAILS
    return UNSURE


@kernel
def conditions_at(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    sizes: Array,
    relative: float,
    state: Array,
    parameters: Array,
    time: float,
) -> Array:
    """Return the numbers (k, `PER_CONDITION`) of conditions in a state, flat; see `Conditions`.

    `sizes` (2 n + 1,) are those of the state and of time, which are known to `relative` of them.
    The sizes of terms are the larger ones of those in the state and beside it: at a multiple zero,
    as of ``x**3``, they vanish.
    """
    n, found, beside = state.shape[0], np.empty(outputs.shape[0]), np.empty(outputs.shape[0])
    both = np.empty(2 * n)
    for i in range(n):
        both[i], both[n + i] = state[i], max(abs(state[i]), sizes[i])
    tape_values(code, constants, outputs, both, parameters, time, found)
    moved = relative**_OFFSET_POWER
    for i in range(n):
        both[i] += moved * both[n + i]
    later = time + moved * max(abs(time), sizes[n])
    tape_values(code, constants, outputs, both, parameters, later, beside)
    for k in range(2, found.shape[0], PER_CONDITION):
        found[k] = max(found[k], beside[k])
        found[k + 1] = max(found[k + 1], beside[k + 1])
    return found


@kernel
def judge_atoms(values: Array, relative: float, fired: int, verdicts: Ints) -> None:
    """Write the verdicts of the atoms (k,) from the numbers of `conditions_at`.

    An atom that its first derivative leaves open is decided if its margin has just fallen: `fired`
    is its number, from 1 on; minus it, if the margin that brings its contact back fell; else 0.
    """
    for k in range(verdicts.shape[0]):
        at = PER_CONDITION * k
        verdict = judge(values[at], values[at + 1], values[at + 2], values[at + 3], relative)
        if verdict == UNSURE and abs(fired) == k + 1:
            verdict = FAILS if fired > 0 else HOLDS
        verdicts[k] = verdict


@kernel
def margin_bands(
    nodes: Ints, values: Array, relative: float, near: float, verdicts: Ints, bands: Array
) -> None:
    """Write how far below zero a flow lets the margins of conditions fall.

    That is their round-off; infinitely far, if no certificate needs a margin. `nodes` (m, 3) are
    from `tree`, `values` (4 (k + c),) from `conditions_at`, `verdicts` (k,); `relative` is a
    round-off, `near` the tolerance of gaps. Fills `bands` (2 k + c,): margins of atoms that hold,
    of atoms that fail, and of gaps of contacts.
    """
    count = verdicts.shape[0]
    found = np.empty(nodes.shape[0], np.int64)
    on, off = np.empty(count, np.int64), np.empty(count, np.int64)
    truths(nodes, verdicts, found)
    certificates(nodes, found, on, off)
    for k in range(count):
        band = round_off(values[PER_CONDITION * k + 2], relative)
        bands[k] = band if on[k] == 1 else math.inf
        bands[count + k] = band if off[k] == 1 else math.inf
    for i in range(2 * count, bands.shape[0]):
        bands[i] = math.inf
    for i in range(nodes.shape[0]):
        if nodes[i, 1] < 0:
            gap = values[PER_CONDITION * (count + nodes[i, 2])]
            if opens(found[i], gap, near):
                bands[2 * count + nodes[i, 2]] = UNDERFLOW
