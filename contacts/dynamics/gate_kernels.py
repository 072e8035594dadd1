"""Verdicts and tolerances of the conditions of contacts, in compiled code."""

from __future__ import annotations

import math

import numpy as np

from contacts.dynamics.gates import FAILS, HOLDS, UNSURE, certificates, opens, truths
from statechart.arrays import Array, Ints, Ints32
from statechart.automaton.margin_derivatives import UNDERFLOW
from statechart.kernels.jit import seldom
from statechart.kernels.tapes import tape_values

PER_CONDITION = 4
"""Numbers of a condition: its margin, the first derivative in time, the sizes of their terms."""
# At a multiple zero the terms vanish with f: they are looked at this far beside it, a power of the
# relative round-off, so that what rounds to zero there does not.
_BESIDE = 0.75


@seldom
def round_off(size: float, relative: float) -> float:
    """Return up to which amount a condition is zero whose terms are so large."""
    return max(relative * size, UNDERFLOW) if size < math.inf else UNDERFLOW


@seldom
def judge(value: float, rate: float, size: float, slow: float, relative: float) -> int:
    """Judge a condition by its margin and the first derivative of that.

    Parameters
    ----------
    value, rate : float
        Margin and first derivative.
    size, slow : float
        Sizes of their terms.
    relative : float
        What is so small in parts of its terms is zero.
    """
    band = round_off(size, relative)
    if value > band:
        return HOLDS
    if value < -band:
        return FAILS
    if abs(rate) > relative * slow:
        return HOLDS if rate > 0.0 else FAILS
    return UNSURE


@seldom
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
    moved = relative**_BESIDE
    for i in range(n):
        both[i] += moved * both[n + i]
    later = time + moved * max(abs(time), sizes[n])
    tape_values(code, constants, outputs, both, parameters, later, beside)
    for k in range(2, found.shape[0], PER_CONDITION):
        found[k] = max(found[k], beside[k])
        found[k + 1] = max(found[k + 1], beside[k + 1])
    return found


@seldom
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


@seldom
def margin_bands(
    nodes: Ints, values: Array, relative: float, near: float, verdicts: Ints, bands: Array
) -> None:
    """Write how far below zero a flow lets the margins of conditions fall.

    That is their round-off; infinitely far, if no certificate needs a margin.

    Parameters
    ----------
    nodes : (m, 3) array of int64
        See `contacts.dynamics.gates.tree`.
    values : (4 (k + c),) array
        From `conditions_at`.
    relative, near : float
        Relative round-off; tolerance of gaps.
    verdicts : (k,) array of int64
    bands : (2 k + c,) array
        To be filled: margins of atoms that hold, of atoms that fail, and of gaps of contacts.
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
