"""Gates of contacts: the relations `enabled`, and the ends of edges, as trees of smooth atoms.

A contact is off while its gate does not hold. While it is on, the margins of its atoms fall as
they cease to hold; while it is off, as they begin to hold, and the margin of its gap falls as the
gap opens. Certificates (`statechart.formulas.condition`) select the margins that are watched.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Array, Ints, Ints32
from statechart.automaton.margin_derivatives import UNDERFLOW, derivative
from statechart.automaton.regions import Margin
from statechart.formulas.condition import And, Or, replaced
from statechart.formulas.relation import States, parse_relation
from statechart.formulas.writer import Max, Min
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import tape_values

HOLDS, FAILS, UNSURE = 1, -1, 0
"""Verdicts of an atom and of a gate; derivatives decide an UNSURE one."""
EVERY, SOME = -1, -2
"""Kinds of nodes of `gate_trees`: conjunction and disjunction."""

PER_CONDITION = 4
"""Numbers of a condition: its margin, the first derivative in time, the sizes of their terms."""
# At a multiple zero the terms vanish with f. Their sizes are therefore also evaluated at a state
# shifted by this power of the relative round-off.
_OFFSET_POWER = 0.75
# Added to a margin in runs by steps, so that a zero counts as the relation (>= or >) says; beside
# the residual motion of resting bodies, relative to the sizes of coordinates and rates.
_ZERO_SHIFT, RESIDUAL_MOTION = 1e-300, 1e-12


class GateAtom(NamedTuple):
    """An atom of a gate."""

    # `name`, `back`: Names of the margins that fall as it ceases, and as it begins to hold
    name: str
    back: str
    words: str  # The relation that it belongs to
    margin: sp.Expr  # At or above 0 while it holds
    closed: bool  # It holds at 0
    is_end: bool = False  # It is an end of an edge


@dataclass(frozen=True, eq=False)
class Gate:
    """The gate of a contact."""

    contact: str
    off: str  # Its state while the gate does not hold, as in ``tip.off``
    atoms: tuple[GateAtom, ...]
    root: Any  # Leaves are indices of `atoms`
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
        relations = dict.fromkeys(atom.words for atom in self.atoms)
        margins = {atom.words: atom.margin for atom in self.atoms} | dict(self.wholes)
        margins_by_name = [(atom.back, atom.margin) for atom in self.atoms]
        limits = [margins[words] for words in relations]
        if gap != 0:
            # A coupling has none.
            margins_by_name.append((self.gap, gap))
            limits.insert(0, gap)
        distance = -Min(*limits, evaluate=False)
        return tuple(
            Margin(name, -margin, relation=self.off, whole=distance)
            for name, margin in margins_by_name
        )

    def by_steps(
        self,
        values: Mapping[sp.Symbol, sp.Expr],
        sizes: Mapping[sp.Symbol, sp.Expr],
        valleys: Mapping[str, sp.Expr] | None = None,
    ) -> sp.Expr:
        """Return the margin of the gate at the end of a time step: > 0 while it holds.

        `sizes` of coordinates and rates determine what the residual motion of resting bodies
        changes. An end of an edge is ignored if its value in `valleys` is positive.
        """
        ignored = valleys or {}

        def margin(tree: Any, beside: Sequence[Any] = ()) -> sp.Expr:
            if isinstance(tree, And | Or):
                parts = tree.parts if isinstance(tree, And) else ()
                kind = Min if isinstance(tree, And) else Max
                return kind(*(margin(part, parts) for part in tree.parts))
            atom = self.atoms[tree]
            # The other parts of a conjunction tell where a power has no value.
            held = {self.atoms[part].margin for part in beside if isinstance(part, int)}
            powers = {
                p for p in atom.margin.atoms(sp.Pow) if p.base in held and not p.exp.is_integer
            }
            kept = {power: Max(power.base, 0) ** power.exp for power in powers}
            value = atom.margin.xreplace(kept).xreplace(values)
            if atom.is_end:
                return Max(value, ignored[atom.words]) if atom.words in ignored else value
            pieces = ([*sides, (piece, atom.closed)] for sides, piece in _pieces(value))
            return Max(*(Min(*(shifted(*part) for part in parts)) for parts in pieces))

        def shifted(value: sp.Expr, closed: bool) -> sp.Expr:
            moves = [
                abs(derivative(value, symbol)) * sizes[symbol]
                for symbol in sizes
                if symbol in value.free_symbols
            ]
            # Roots have no slope at zero.
            moves = [
                move
                for move in moves
                if not any(
                    power.exp.is_negative and not power.base.free_symbols.isdisjoint(sizes)
                    for power in move.atoms(sp.Pow)
                )
            ]
            shift = sp.Add(sp.Float(_ZERO_SHIFT), RESIDUAL_MOTION * sp.Add(*moves))
            # A constant of the margin would absorb the shift.
            return sp.Add(value, shift if closed else -shift, evaluate=False)

        return margin(self.root)


def _pieces(margin: sp.Expr) -> Iterator[tuple[list[tuple[sp.Expr, bool]], sp.Expr]]:
    """Yield the pieces of a margin between branch cuts of `atan2`.

    Each comes with functions that are >= 0 in its domain, and whether it includes 0. A margin that
    jumps at a cut would rise after it, as that of a contact at the kink of a valley does.
    """
    choices = []
    for angle in sp.ordered(margin.atoms(sp.atan2)):
        y, x = angle.args
        if x.free_symbols and not x.is_nonnegative:
            behind, left = sp.atan2(-y, -x), (-x, False)
            upper, lower = [left, (y, True)], [left, (-y, False)]
            choices.append(
                [
                    ([(x, True)], angle, angle),
                    (upper, angle, behind + sp.pi),
                    (lower, angle, behind - sp.pi),
                ]
            )
    for chosen in itertools.product(*choices):
        sides = [side for own, _, _ in chosen for side in own]
        yield sides, margin.xreplace({angle: piece for _, angle, piece in chosen})


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
        condition = relation.condition(known, states)
        words, offset = f"{contact}: {text}", len(atoms)
        if not condition.single:
            wholes[words] = -relation.margin(known, states)
        backs = condition.names(f"{off}: {text}")
        for name, back, atom in zip(condition.names(words), backs, condition.atoms, strict=True):
            atoms.append(GateAtom(name, back, words, -atom.expression, not atom.strict))
        parts.append(replaced(condition.root, partial(operator.add, offset)))
    for end, margin in ends.items():
        parts.append(len(atoms))
        words = f"{contact}: {end}"
        atoms.append(GateAtom(words, f"{off}: {end}", words, margin, True, is_end=True))
    return Gate(contact, off, tuple(atoms), And(tuple(parts)), wholes)


def gate_trees(gates: Sequence[Gate | None]) -> Ints:
    """Return the trees of gates as nodes (m, 3), parents before children.

    Columns: the index of an atom among those of all gates, or `EVERY`, `SOME`; the parent, -1 for
    a root; the contact.
    """
    rows: list[tuple[int, int, int]] = []

    def add(node: Any, above: int, place: int, offset: int) -> None:
        index = len(rows)
        if isinstance(node, And | Or):
            rows.append((EVERY if isinstance(node, And) else SOME, above, place))
            for child in node.parts:
                add(child, index, place, offset)
        else:
            rows.append((offset + node, above, place))

    count = 0
    for place, gate in enumerate(gates):
        if gate is not None:
            add(gate.root, -1, place, count)
            count += len(gate.atoms)
    return np.array(rows, np.int64).reshape(-1, 3)


@kernel
def write_node_verdicts(nodes: Ints, verdicts: Ints, node_verdicts: Ints) -> None:
    """Write the verdict of every node (m,) of `gate_trees`, from those of the atoms (k,)."""
    for i in range(nodes.shape[0]):
        kind = nodes[i, 0]
        node_verdicts[i] = HOLDS if kind == EVERY else FAILS if kind == SOME else verdicts[kind]
    for i in range(nodes.shape[0] - 1, -1, -1):
        above = nodes[i, 1]
        if above >= 0:
            if nodes[above, 0] == EVERY:
                node_verdicts[above] = min(node_verdicts[above], node_verdicts[i])
            else:
                node_verdicts[above] = max(node_verdicts[above], node_verdicts[i])


@kernel
def mark_certificates(nodes: Ints, node_verdicts: Ints, on: Ints, off: Ints) -> None:
    """Mark the atoms (k,) that certify that gates hold (`on`), and that they fail (`off`).

    A contact that is on watches an atom that fails only if its whole gate fails: then the margin
    falls at once.
    """
    needed = np.zeros(nodes.shape[0], np.int64)
    on[:] = 0
    off[:] = 0
    gate_verdict = UNSURE
    for i in range(nodes.shape[0]):
        kind = nodes[i, 0]
        if nodes[i, 1] < 0:
            needed[i], gate_verdict = 1, node_verdicts[i]
        if needed[i] == 0:
            continue
        if kind >= 0:
            on[kind] = 1 if node_verdicts[i] != FAILS or gate_verdict == FAILS else 0
            off[kind] = 1 if node_verdicts[i] != HOLDS else 0
            continue
        decided_by_one = node_verdicts[i] == (FAILS if kind == EVERY else HOLDS)
        for j in range(i + 1, nodes.shape[0]):
            if nodes[j, 1] == i and (not decided_by_one or node_verdicts[j] == node_verdicts[i]):
                needed[j] = 1
                if decided_by_one:
                    break


@kernel
def round_off(size: float, relative: float) -> float:
    """Return the round-off of a condition whose terms have this size."""
    return max(relative * size, UNDERFLOW) if size < math.inf else UNDERFLOW


@kernel
def judge(value: float, rate: float, size: float, rate_size: float, relative: float) -> int:
    """Judge a condition by its margin and its first derivative.

    The sizes of their terms are `size` and `rate_size`, their round-off is `relative` times these.
    A margin without a derivative may be about to jump, as an angle at the origin.
    """
    if math.isnan(rate) or math.isnan(size):
        return UNSURE
    band = round_off(size, relative)
    if value > band:
        return HOLDS
    if value < -band:
        return FAILS
    if abs(rate) > relative * rate_size:
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

    `sizes` (2 n + 1,) are those of the state and of time, `relative` is their round-off. The sizes
    of terms are the maximum over the state and a shifted one: at a multiple zero, as of ``x**3``,
    they vanish.
    """
    n, numbers, shifted = state.shape[0], np.empty(outputs.shape[0]), np.empty(outputs.shape[0])
    state_and_sizes = np.empty(2 * n)
    for i in range(n):
        state_and_sizes[i], state_and_sizes[n + i] = state[i], max(abs(state[i]), sizes[i])
    tape_values(code, constants, outputs, state_and_sizes, parameters, time, numbers)
    displaced = relative**_OFFSET_POWER
    for i in range(n):
        state_and_sizes[i] += displaced * state_and_sizes[n + i]
    later = time + displaced * max(abs(time), sizes[n])
    tape_values(code, constants, outputs, state_and_sizes, parameters, later, shifted)
    for k in range(2, numbers.shape[0], PER_CONDITION):
        numbers[k] = max(numbers[k], shifted[k])
        numbers[k + 1] = max(numbers[k + 1], shifted[k + 1])
    return numbers


@kernel
def judge_atoms(values: Array, relative: float, fired: int, verdicts: Ints) -> None:
    """Write the verdicts of the atoms (k,) from the numbers of `conditions_at`.

    An unsure atom whose margin has just fallen is decided by that: `fired` is its number from 1 on,
    negative if the margin that brings its contact back fell, 0 for none.
    """
    for k in range(verdicts.shape[0]):
        at = PER_CONDITION * k
        verdict = judge(values[at], values[at + 1], values[at + 2], values[at + 3], relative)
        if verdict == UNSURE and abs(fired) == k + 1:
            verdict = FAILS if fired > 0 else HOLDS
        verdicts[k] = verdict


@kernel
def margin_bands(
    nodes: Ints, values: Array, relative: float, gap_tolerance: float, verdicts: Ints, bands: Array
) -> None:
    """Write the tolerances `bands` (2 k + c,) of the margins of conditions in a flow.

    A tolerance is the round-off of the margin, or infinite if no certificate needs it. The margins
    are those of atoms that hold, of atoms that fail, and of gaps. `nodes` (m, 3) are from
    `gate_trees`, `values` (4 (k + c),) from `conditions_at`; `relative` is the round-off.
    """
    count = verdicts.shape[0]
    node_verdicts = np.empty(nodes.shape[0], np.int64)
    on, off = np.empty(count, np.int64), np.empty(count, np.int64)
    write_node_verdicts(nodes, verdicts, node_verdicts)
    mark_certificates(nodes, node_verdicts, on, off)
    for k in range(count):
        band = round_off(values[PER_CONDITION * k + 2], relative)
        bands[k] = band if on[k] == 1 else math.inf
        bands[count + k] = band if off[k] == 1 else math.inf
    for i in range(2 * count, bands.shape[0]):
        bands[i] = math.inf
    for i in range(nodes.shape[0]):
        if nodes[i, 1] < 0:
            gap = values[PER_CONDITION * (count + nodes[i, 2])]
            # An unsure gate fails if the contact is off although its gap is open.
            unsure = node_verdicts[i] == UNSURE and gap < -gap_tolerance
            if unsure or node_verdicts[i] == HOLDS:
                bands[2 * count + nodes[i, 2]] = UNDERFLOW
