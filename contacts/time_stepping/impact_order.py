"""Impacts at one instant whose order matters: Moreau's law and impacts one after another differ."""

from __future__ import annotations

from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import part

# Another impact that changes a velocity by less than this part of its own change is not felt: a
# body turns within a step.
_FELT = 1e-3


@part
def order_matters(bodies: Ints, pairs: Ints, lively: Bools, struck: Ints) -> bool:
    """Return whether a body is struck at once at several of the things that it touches."""
    for a in range(len(pairs)):
        for side in range(2):
            if bodies[a, side] >= 0:
                struck[bodies[a, side]] = -1
    for a in range(len(pairs)):
        if not lively[a]:
            continue
        for side in range(2):
            b = bodies[a, side]
            if b >= 0 and struck[b] >= 0 and struck[b] != pairs[a]:
                return True
            if b >= 0:
                struck[b] = pairs[a]
    return False


@part
def coupled_order_matters(
    bodies: Ints, pairs: Ints, lively: Bools, delassus: Array, cones: Array, impulses: Array
) -> bool:
    """Return whether a body is struck at once at contacts whose impacts change each other.

    Parameters
    ----------
    bodies, pairs, lively
        See `order_matters`.
    delassus : (2 m, 2 m), cones : (m, 2), impulses : (m, 2)
        Of the step's contact problem.
    """
    for a in range(len(pairs)):
        for b in range(len(pairs)):
            if lively[a] and lively[b] and pairs[a] != pairs[b]:
                for d in range(2 if cones[b, 1] > 0.0 else 1):
                    own = abs(delassus[2 * b + d, 2 * b + d] * impulses[b, 0])
                    moved = 0.0
                    for e in range(2):
                        moved += delassus[2 * b + d, 2 * a + e] * impulses[a, e]
                    if _share_body(bodies, a, b) and abs(moved) > _FELT * own:
                        return True
    return False


@part
def _share_body(bodies: Ints, a: int, b: int) -> bool:
    shared = False
    for i in range(2):
        for j in range(2):
            shared = shared or (bodies[a, i] >= 0 and bodies[a, i] == bodies[b, j])
    return shared
