"""Equations of contacts whose status is given, each held to impulses by a compliance.

What a contact is off by is its impulse times its compliance; so impulses follow from how the bodies
move, and what is solved for are the rates of these: fewer than there are contacts, and what touches
twice is neighbours once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import ContactRows
from contacts.solvers.sparse_blocks import Pattern, factored, pattern_of, solved
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

OPEN, STICKS, SLIDES = range(3)
"""The status of a contact."""


class Equations(NamedTuple):
    """Room for the equations of bodies in contact."""

    pattern: Pattern
    # Blocks as those of the pattern, factored.
    diagonal: Array
    after: Array
    before: Array
    rates: Array  # (b, 3): of the bodies.
    right: Array  # (m, 2): changes of the velocities of contacts that are asked for.


@kernel
def equations_of(contacts: ContactRows) -> Equations:
    """Return room for the equations of contacts of bodies, whatever their status."""
    pattern = pattern_of(contacts)
    bodies, entries = len(pattern.begins) - 1, len(pattern.others)
    return Equations(
        pattern, np.empty((bodies, 9)), np.empty((entries, 9)), np.empty((entries, 9)),
        np.empty((bodies, 3)), np.empty((len(contacts.own), 2)),
    )  # fmt: skip


@kernel
def _add(
    contacts: ContactRows, i: int, d: int, share: float, edge: float, one: int, other: int,
    block: Array,
) -> None:  # fmt: skip
    """Add to a block what the rates of one body do to another's through an impulse of a contact."""
    columns, rows = contacts.columns[i], contacts.rows[i, d]
    for r in range(3):
        column = share * (columns[d, 3 * one + r] + edge * columns[1, 3 * one + r])
        for c in range(3):
            block[3 * r + c] += column * rows[3 * other + c]


@kernel
def eliminated(
    contacts: ContactRows, equations: Equations, compliance: float, status: Ints, edges: Array
) -> bool:
    """Eliminate the equations of a status; False where a pivot fails.

    Parameters
    ----------
    contacts : ContactRows
    equations : Equations
    compliance : float
        Of each contact, in parts of its own.
    status : (m,) array of int, edges : (m,)
        Of what slides, tangential by normal impulse.
    """
    pattern, diagonal, after, before, _, _ = equations
    for p in range(len(diagonal)):
        for k in range(9):
            diagonal[p, k] = 1.0 if k % 4 == 0 else 0.0
    for at in range(len(after)):
        for k in range(9):
            after[at, k] = before[at, k] = 0.0
    for i in range(len(status)):
        if status[i] == OPEN:
            continue
        edge = edges[i] if status[i] == SLIDES else 0.0
        p, q, at = pattern.ends[i, 0], pattern.ends[i, 1], pattern.entries[i]
        for d in range(2 if status[i] == STICKS else 1):
            share = 1.0 / (compliance * contacts.own[i, d])
            if p >= 0:
                _add(contacts, i, d, share, edge, 0, 0, diagonal[p])
            if q >= 0:
                _add(contacts, i, d, share, edge, 1, 1, diagonal[q])
            if at >= 0:
                _add(contacts, i, d, share, edge, 0, 1, after[at] if p < q else before[at])
                _add(contacts, i, d, share, edge, 1, 0, before[at] if p < q else after[at])
    return factored(pattern, diagonal, after, before)


@kernel
def step(
    contacts: ContactRows, equations: Equations, compliance: float, status: Ints, edges: Array,
    impulses: Array,
) -> None:  # fmt: skip
    """Add to impulses (m, 2) what changes the velocities as `Equations.right` asks.

    Parameters
    ----------
    contacts, compliance, status, edges
        Those of what was eliminated.
    equations : Equations
    impulses : (m, 2)
        Changed in place.
    """
    pattern, diagonal, after, before, rates, right = equations
    own, rows, columns = contacts.own, contacts.rows, contacts.columns
    for p in range(len(rates)):
        rates[p, 0] = rates[p, 1] = rates[p, 2] = 0.0
    for i in range(len(status)):
        if status[i] == OPEN:
            continue
        normal = right[i, 0] / (compliance * own[i, 0])
        tangential = edges[i] * normal
        if status[i] == STICKS:
            tangential = right[i, 1] / (compliance * own[i, 1])
        for side in range(2):
            p = pattern.ends[i, side]
            if p >= 0:
                for k in range(3):
                    rates[p, k] += columns[i, 0, 3 * side + k] * normal
                    rates[p, k] += columns[i, 1, 3 * side + k] * tangential
    solved(pattern, diagonal, after, before, rates)
    for i in range(len(status)):
        if status[i] == OPEN:
            continue
        normal, tangential = right[i]
        for side in range(2):
            p = pattern.ends[i, side]
            if p >= 0:
                for k in range(3):
                    normal -= rows[i, 0, 3 * side + k] * rates[p, k]
                    tangential -= rows[i, 1, 3 * side + k] * rates[p, k]
        normal /= compliance * own[i, 0]
        impulses[i, 0] += normal
        if status[i] == STICKS:
            impulses[i, 1] += tangential / (compliance * own[i, 1])
        else:
            impulses[i, 1] += edges[i] * normal
