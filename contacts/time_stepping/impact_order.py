"""Impacts at one instant whose order matters: Moreau's law and impacts one after another differ."""

from __future__ import annotations

from statechart.arrays import Bools, Ints
from statechart.kernels.jit import part


@part
def order_matters(bodies: Ints, pairs: Ints, lively: Bools, struck: Ints) -> bool:
    """Whether a body is struck at once at several of the things that it touches.

    Parameters
    ----------
    bodies : (m, 2) array of int
        The bodies that touch at each contact; -1 for none.
    pairs : (m,) array of int
        The number of the pair of things that touch.
    lively : (m,) array of bool
        Contacts with an impact whose restitution is `contacts.time_stepping.chunk.LIVELY` or more.
    struck : (b,) array of int
        Workspace, one entry per body; is overwritten.
    """
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
