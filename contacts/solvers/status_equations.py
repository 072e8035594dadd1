"""Equations of contacts whose status is given: one unknown for each that slides, two that stick."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import ContactRows
from contacts.solvers.sparse_blocks import Pattern, factored, pattern_of, solved
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel, part

OPEN, STICKS, SLIDES = range(3)
"""The status of a contact."""


class Equations(NamedTuple):
    """Equations of contacts, scaled so that compliances of their own are 1.

    Attributes
    ----------
    pattern : Pattern
    scales : (m, 2)
        Impulses per unknown, and equations per velocity.
    diagonal, after, before
        Blocks as those of the pattern, factored.
    right : (m, 2)
        Changes of the velocities that are asked for; is overwritten.
    """

    pattern: Pattern
    scales: Array
    diagonal: Array
    after: Array
    before: Array
    right: Array


@part
def _has(status: Ints, i: int, k: int) -> bool:
    """Whether a contact has an unknown along its normal (0) or its tangent (1)."""
    return status[i] == STICKS or (k == 0 and status[i] == SLIDES)


@part
def _as_status(block: Array, i: int, j: int, status: Ints, edges: Array, scales: Array) -> None:
    """Make velocities of contact i per unit impulses of j those of their unknowns, scaled."""
    if status[j] == SLIDES:
        block[0] += edges[j] * block[1]
        block[2] += edges[j] * block[3]
    for a in range(2):
        for b in range(2):
            have = _has(status, i, a) and _has(status, j, b)
            block[2 * a + b] = scales[i, a] * block[2 * a + b] * scales[j, b] if have else 0.0


@kernel
def equations_of(contacts: ContactRows) -> Equations:
    """Return room for the equations of contacts of bodies, whatever their status."""
    pattern, count = pattern_of(contacts), len(contacts.own)
    scales = np.empty((count, 2))
    for i in range(count):
        for d in range(2):
            scales[i, d] = 1.0 / math.sqrt(max(contacts.own[i, d], 1e-300))
    return Equations(
        pattern, scales, np.empty_like(pattern.diagonal), np.empty_like(pattern.after),
        np.empty_like(pattern.before), np.empty((count, 2)),
    )  # fmt: skip


@part
def eliminated(
    contacts: ContactRows, equations: Equations, compliance: float, status: Ints, edges: Array
) -> bool:
    """Eliminate the equations of a status; False where a pivot fails.

    What a contact has no unknown for is an unknown of its own, zero.

    Parameters
    ----------
    contacts : ContactRows
    equations : Equations
    compliance : float
        Added to each contact's own, as part of it.
    status : (m,) array of int, edges : (m,)
        Of what slides, tangential by normal impulse.
    """
    pattern, scales, diagonal, after, before, _ = equations
    for p in range(len(status)):
        i = pattern.order[p]
        for k in range(4):
            diagonal[p, k] = pattern.diagonal[p, k]
        _as_status(diagonal[p], i, i, status, edges, scales)
        for k in range(2):
            diagonal[p, 3 * k] += compliance if _has(status, i, k) else 1.0
        for at in range(pattern.begins[p], pattern.begins[p + 1]):
            j = pattern.others[at]
            for k in range(4):
                after[at, k], before[at, k] = pattern.after[at, k], pattern.before[at, k]
            _as_status(after[at], i, j, status, edges, scales)
            _as_status(before[at], j, i, status, edges, scales)
    return factored(pattern, diagonal, after, before)


@part
def step(equations: Equations, status: Ints, edges: Array, impulses: Array) -> None:
    """Add to impulses (m, 2) what changes the velocities as `Equations.right` asks."""
    pattern, scales, diagonal, after, before, right = equations
    for i in range(len(status)):
        for d in range(2):
            right[i, d] = scales[i, d] * right[i, d] if _has(status, i, d) else 0.0
    solved(pattern, diagonal, after, before, right)
    for i in range(len(status)):
        if _has(status, i, 0):
            impulses[i, 0] += scales[i, 0] * right[i, 0]
        if _has(status, i, 1):
            impulses[i, 1] += scales[i, 1] * right[i, 1]
        elif status[i] == SLIDES:
            impulses[i, 1] = edges[i] * impulses[i, 0]
