"""Contacts that can stand in for each other: the smallest impulses with the same effect.

A bar that lies on two points, a table with four legs: the motion is determined, how the contacts
share the impulse is not. The least impulses within the cones are taken, and flagged.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from contacts.states import FREE, PIN, SLIDE, SLIDE_PLUS
from statechart.arrays import Array

# Columns this close to dependent are.
_DEPENDENT = 1e-13
# Relative to the terms of an inequality, and of a residual.
_EXACT, _NONE = 1e-13, 1e-9


def mode_columns(code: NDArray[np.int64], jacobians: Array, cones: Array) -> list[list[Array]]:
    """Return what each contact's impulse does to the coordinates, per unit of its unknowns.

    Parameters
    ----------
    code : (c,) array of int
        Modes as `contacts.states` numbers them: nothing where FREE, V and H where
        PIN, V where SLIDE, and the impulse along its edge of the cone where SLIDE_PLUS or
        SLIDE_MINUS.
    jacobians : (c, 2, n), cones : (c, 2)
    """
    return [
        [V * n + H * t for V, H in directions(mode, cone)]
        for mode, (n, t), cone in zip(code, jacobians, cones, strict=True)
    ]


def rank(columns: Array, tolerance: float) -> tuple[int, Array]:
    """Return the rank, and a basis of what the columns do not see (m, m - rank)."""
    sizes, right = _spectrum(columns)
    count = int((sizes > tolerance * sizes.max(initial=0.0)).sum())
    return count, _clean(right[count:].T)


def unseen(columns: Array, count: int) -> Array:
    """Return a basis (m, m - count) of what columns of rank `count` do not see."""
    return _clean(_spectrum(columns)[1][count:].T)


def _spectrum(columns: Array) -> tuple[Array, Array]:
    largest = np.abs(columns).max(axis=1, keepdims=True)
    rows = columns[largest[:, 0] > 0.0] / largest[largest[:, 0] > 0.0]
    if not len(rows):
        return np.zeros(0), np.eye(columns.shape[1])
    _, sizes, right = np.linalg.svd(rows)
    return sizes, right


def _clean(hidden: Array) -> Array:
    # Rounding would mix impulses that share nothing and differ by decades.
    return np.where(np.abs(hidden) > _DEPENDENT, hidden, 0.0)


def smallest(
    code: NDArray[np.int64], jacobians: Array, cones: Array, impulses: Array
) -> tuple[Array, list[bool]]:
    """Return the smallest impulses in the cones with the same effect, and whether others have it.

    Contacts that can stand in for each other are taken together, and no others: impulses may
    differ by decades.

    Parameters
    ----------
    code : (c,) array of int
        See `mode_columns`: what each contact may bear, whatever it bears now.
    jacobians : (c, 2, n), cones : (c, 2), impulses : (c, 2)
    """
    columns = mode_columns(code, jacobians, cones)
    owners = np.array([k for k, several in enumerate(columns) for _ in several], dtype=np.int64)
    if not len(owners) or not impulses.any():
        return impulses, [False] * len(code)
    flat = np.array([column for several in columns for column in several])
    units = np.array([d for k in range(len(code)) for d in directions(code[k], cones[k])])
    hidden = rank(flat.T, _DEPENDENT)[1]
    exchanged = np.abs(hidden @ hidden.T) > _DEPENDENT
    linked = np.zeros((len(code), len(code)), dtype=np.bool_)
    for one, other in zip(*np.nonzero(exchanged), strict=True):
        linked[owners[one], owners[other]] = True
    labels = connected(linked)
    given = impulses.copy()
    for label in np.unique(labels[linked.any(axis=1)]):
        ours = labels[owners] == label
        amounts = (units[ours] * impulses[owners[ours]]).sum(axis=1)
        least = _least(flat[ours].T, amounts, _bounds(owners[ours], code, cones))
        if least is None:
            continue
        for k in np.nonzero(labels == label)[0]:
            mine = owners[ours] == k
            given[k] = least[mine] @ units[ours][mine]
    return given, [bool(row.any()) for row in linked]


def into_cone(impulse: Array, cone: Array) -> tuple[float, float]:
    """Put an impulse that left its cone by rounding back on its edge."""
    (V, H), (cone_n, cone_t) = impulse.tolist(), cone.tolist()
    if V >= 0.0 and cone_n * abs(H) <= cone_t * V:
        return V, H
    along = max(cone_n * V + cone_t * abs(H), 0.0)
    return along * cone_n, math.copysign(along * cone_t, H)


def connected(linked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Label the connected parts of a symmetric relation (n, n)."""
    labels = [-1] * len(linked)
    beside = [np.flatnonzero(row).tolist() for row in linked]
    for first in range(len(labels)):
        left = [first] if labels[first] < 0 else []
        while left:
            k = left.pop()
            if labels[k] < 0:
                labels[k] = first
                left += beside[k]
    return np.array(labels, dtype=np.int64)


def directions(mode: int, cone: Array) -> list[tuple[float, float]]:
    """Return (V, H) per unit of a contact's columns."""
    if mode == FREE:
        return []
    if mode == PIN:
        return [(1.0, 0.0), (0.0, 1.0)]
    if mode == SLIDE:
        return [(1.0, 0.0)]
    return [(float(cone[0]), float(-cone[1] if mode == SLIDE_PLUS else cone[1]))]


def _bounds(owners: NDArray[np.int64], code: NDArray[np.int64], cones: Array) -> Array:
    """Return rows whose products with the amounts of columns are >= 0 in the cones."""
    units = np.eye(len(owners))
    rows = []
    for at, k in enumerate(owners):
        if code[k] != PIN:
            rows.append(units[at])
        elif at == 0 or owners[at - 1] != k:
            cone_n, cone_t = cones[k]
            level, along = cone_t * units[at], cone_n * units[at + 1]
            rows += [units[at], level + along, level - along]
    return np.array(rows)


def _least(columns: Array, amounts: Array, bounds: Array) -> Array | None:
    """Return the least amounts within the bounds and with the same effect; None: not found.

    Least distance programming (Lawson and Hanson, Solving Least Squares Problems, 23.4).
    """
    hidden = rank(columns, _DEPENDENT)[1]
    size = np.abs(amounts).max()
    if size == 0.0:
        return amounts
    least: Array = amounts - hidden @ (hidden.T @ amounts)
    missing = -(bounds @ least) / size
    if missing.max() > _EXACT:
        from scipy.optimize import nnls

        system = np.vstack([(bounds @ hidden).T, missing])
        target = np.zeros(len(system))
        target[-1] = 1.0
        left = system @ nnls(system, target)[0] - target
        if abs(left[-1]) <= _NONE:
            return None
        least = least - hidden @ (size * left[:-1] / left[-1])
    return least if (bounds @ least).min() >= -_EXACT * size else None
