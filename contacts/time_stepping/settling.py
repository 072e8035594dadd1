"""Modes of contacts after an impact, from the complementarity problem of accelerations.

The impulses of the steps after an impact hold what the landing has left: the motion turns a contact
off the gap at which it landed by ``h^2 b/2``, and its normal velocity by ``h b``, where b is the
bias of its normal acceleration. These impulses are wrong by the order of the forces. So these steps
read the modes from the velocities after the impact, as the engines with events do::

    0 <= V,  0 <= a_n,  V a_n = 0,  a = J M^-1 f + b + W F,  F in the cone of friction

until the impulses of a step say the same. A velocity that the landing explains counts as zero.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_lcp_kernels import impulses_by_lemke
from contacts.states import FREE, OFF_CODE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.equations import JOINT, back
from contacts.time_stepping.forces import ROUNDING
from contacts.time_stepping.scene_numbers import ContactMemory, SceneNumbers, Tape
from contacts.time_stepping.step_contacts import SETTLING, delassus_of, moved_columns
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import indices
from statechart.kernels.jit import beside, part

# A landing leaves velocities of so many steps of the accelerations, and a gap of so many steps of
# such a velocity.
_LEFT = 4.0


@part
def is_settling(memory: ContactMemory) -> bool:
    """Whether the mode of a contact is that of the problem of accelerations."""
    found = False
    for i in range(len(memory.settling)):
        found = found or memory.settling[i]
    return found


@part
def _free_accelerations(scene: SceneNumbers, tape: Tape, factors: Array, order: Ints) -> Array:
    """Return the accelerations of the coordinates without free contacts' forces."""
    n, numbers, right = tape.size, tape.numbers, np.zeros(len(order))
    for j in range(n):
        right[j] = numbers[n * n + j]
    at = n
    for i in range(len(scene.held)):
        for d in range(scene.held[i]):
            right[at] = -numbers[tape.first + tape.per * i + 2 * n + d]
            at += 1
    for i in range(scene.joints):
        row = tape.first + tape.per * len(scene.held) + (n + JOINT) * i
        if numbers[row + n + 3] == 0.0:
            right[at] = -numbers[row + n + 2]
        at += 1
    return back(factors, order, right)


@part
def _write_accelerations(tape: Tape, i: int, moving: Array, found: Array) -> float:
    """Write the accelerations (2,) of contact i; return the sum of the sizes of their terms."""
    n, size = tape.size, 0.0
    row = tape.first + tape.per * i
    for d in range(2):
        found[d] = tape.numbers[row + 2 * n + d]
        size += abs(found[d])
        along = 0.0
        for j in range(n):
            along += tape.numbers[row + d * n + j] * moving[j]
        found[d] += along
        size += abs(along)
    return size


@part
def _is_closed(
    scene: SceneNumbers, memory: ContactMemory, tape: Tape, i: int, size: float, k: int,
    chunk: Chunk,
) -> bool:  # fmt: skip
    """Whether a contact takes part in the problem of accelerations."""
    if scene.held[i] > 0 or memory.off[i]:
        return False
    borne = chunk.codes[k, i] != FREE
    if not memory.settling[i] or (memory.fresh[i] == SETTLING and borne):
        return borne
    if memory.shown[i] == FREE:
        return False
    row = tape.first + tape.per * i + 2 * tape.size
    gap, rate, left = tape.numbers[row + 2], tape.numbers[row + 3], _LEFT * chunk.h * size
    return gap - memory.level[i] <= _LEFT * chunk.h * left and rate <= left


@part
def _mode_of(
    acceleration: Array, terms: Array, slip: float, still: bool, cone: Array, directed: bool
) -> int:
    """Return the number of the mode of a contact with these accelerations (2,)."""
    if acceleration[0] > ROUNDING * terms[0]:
        return FREE
    if cone[1] == 0.0 and not directed:
        return SLIDE
    along = slip
    if still:
        along = acceleration[1] if abs(acceleration[1]) > ROUNDING * terms[1] else 0.0
    if along == 0.0:
        return PIN
    return SLIDE_PLUS if along > 0.0 else SLIDE_MINUS


@beside
def settle(
    scene: SceneNumbers, memory: ContactMemory, tape: Tape, factors: Array, order: Ints, k: int,
    chunk: Chunk,
) -> None:  # fmt: skip
    """Write the modes of settling contacts in step k.

    Parameters
    ----------
    scene : SceneNumbers
    memory : ContactMemory
        Changed in place.
    tape : Tape
        In the middle of the step, with the velocities after it.
    factors, order
        The equations of the step (`contacts.time_stepping.equations.factored`).
    k : int
    chunk : Chunk
        Its step k is changed in place.
    """
    c, n, h = len(scene.cones), tape.size, chunk.h
    moving = _free_accelerations(scene, tape, factors, order)
    free, sizes = np.zeros((c, 2)), np.zeros(c)
    closed: Bools = np.zeros(c, np.bool_)
    for i in range(c):
        sizes[i] = _write_accelerations(tape, i, moving, free[i])
        closed[i] = _is_closed(scene, memory, tape, i, sizes[i], k, chunk)
    which = indices(closed)
    m = len(which)
    modes, solved = np.full(c, FREE), True
    if m > 0:
        delassus = delassus_of(tape, which, moved_columns(tape, factors, order, which))
        slips, slides = np.empty(m), np.zeros(m)
        accelerations, terms, cones = np.empty((m, 2)), np.empty((m, 2)), np.empty((m, 2))
        for a in range(m):
            i = which[a]
            slips[a] = tape.numbers[tape.first + tape.per * i + 2 * n + 4]
            if abs(slips[a]) > _LEFT * h * sizes[i]:
                slides[a] = 1.0 if slips[a] > 0.0 else -1.0
            for d in range(2):
                accelerations[a, d], cones[a, d] = free[i, d], scene.cones[i, d]
        solved, forces = impulses_by_lemke(delassus, accelerations, cones, slides, False)
        if not solved:
            solved, forces = impulses_by_lemke(delassus, accelerations, cones, slides, True)
        for a in range(m):
            for d in range(2):
                terms[a, d] = sizes[which[a]]
                for b in range(m):
                    for e in range(2):
                        term = delassus[2 * a + d, 2 * b + e] * forces[b, e]
                        accelerations[a, d] += term
                        terms[a, d] += abs(term)
        for a in range(m):
            i = which[a]
            modes[i] = _mode_of(
                accelerations[a], terms[a], slips[a], slides[a] == 0.0, cones[a],
                scene.slips[i] == 2,
            )  # fmt: skip
    _show(memory, modes, solved, n + scene.joints, k, chunk)


@part
def _show(
    memory: ContactMemory, modes: Ints, solved: bool, first: int, k: int, chunk: Chunk
) -> None:
    """Write modes (c,) into step k; end the settling where its impulses agree with all of them.

    Forces of contacts begin at `first` among the step's unknowns.
    """
    agree = True
    for i in range(len(modes)):
        borne = chunk.codes[k, i]
        if not solved or (memory.shown[i] == FREE and memory.fresh[i] == 0):
            modes[i] = borne
        elif memory.off[i]:
            modes[i] = OFF_CODE
        if memory.settling[i]:
            agree = agree and modes[i] == borne and memory.fresh[i] == 0
    for i in range(len(modes)):
        if not memory.settling[i]:
            continue
        if modes[i] != chunk.codes[k, i]:
            for d in range(2):
                force = math.nan if modes[i] != FREE else 0.0
                chunk.solved[k, first + 2 * i + d] = force
        chunk.codes[k, i] = modes[i]
        memory.settling[i] = not agree
        memory.shown[i] = FREE if agree else modes[i]
