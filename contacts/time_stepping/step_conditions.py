"""Contacts of a step that their conditions turn off and on."""

from __future__ import annotations

import math

import numpy as np

from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.scene_numbers import ContactMemory, SceneNumbers, Tape
from statechart.arrays import Array
from statechart.kernels.jit import part


@part
def _gap_where_it_begins(past: Array, condition: float, gap: float, rate: float, h: float) -> float:
    """Return at most which gap a contact has where its condition begins to hold in a step.

    The gap is interpolated between the middles of two steps; its error is that of a parabola with
    the change of the gap's rate. Without a sign change of the condition: the gap in the middle.
    """
    if not (past[0] <= 0.0 < condition):
        return gap
    since = condition / (condition - past[0])
    found: float = gap + since * (past[1] - gap) + 0.125 * h * abs(rate - past[2])
    return found


@part
def _deepest(memory: ContactMemory, tape: Tape, i: int) -> float:
    """Return the least gap that contact i has where a point comes from the surfaces it lies on.

    A surface that goes on from another is reached as deep as the point lies in that, at most so
    many times as the gap of the one changes faster with a coordinate.
    """
    found, n = 0.0, tape.size
    for k in range(len(memory.off)):
        deep = memory.level[k]
        if not memory.off[k] and memory.past[k, 1] < deep:
            deep = memory.past[k, 1]
        if k == i or not deep < 0.0:
            continue
        factor = 1.0
        for j in range(n):
            one = abs(tape.numbers[tape.first + tape.per * i + j])
            other = abs(tape.numbers[tape.first + tape.per * k + j])
            if one > factor * other > 0.0:
                factor = one / other
        found = min(found, factor * deep)
    return found


@part
def _note_missed(missed: Array, off: bool, holds: bool, depth: float) -> None:
    """Write how deep a point is in a surface whose contact is off: see `ContactMemory`."""
    if off and holds:
        missed[0] = missed[0] if missed[0] > 0.0 else depth
        missed[1] = depth
        return
    if off and missed[1] > missed[0]:
        missed[2] = min(missed[2], missed[0])
    missed[0] = missed[1] = 0.0


@part
def switched(
    scene: SceneNumbers, memory: ContactMemory, tape: Tape, k: int, chunk: Chunk
) -> bool:  # fmt: skip
    """Let conditions turn contacts off and on, write gaps; return False where one is nowhere."""
    numbers, n, off = tape.numbers, tape.size, memory.off
    deepest = np.empty(len(off))
    for i in range(len(off)):
        deepest[i] = _deepest(memory, tape, i) - scene.near
    for i in range(len(off)):
        row = tape.first + tape.per * i
        gap, condition = numbers[row + 2 * n + 2], numbers[row + 2 * n + 5]
        rate = numbers[row + 2 * n + 3]
        if off[i]:
            entered = _gap_where_it_begins(memory.past[i], condition, gap, rate, chunk.h)
            off[i] = not (condition > 0.0 and max(gap, entered) >= deepest[i])
            _note_missed(memory.missed[i], off[i], condition > 0.0, -gap)
        elif condition < 0.0:
            off[i] = True
        memory.past[i, 0], memory.past[i, 1], memory.past[i, 2] = condition, gap, rate
        if not off[i] and (math.isnan(condition) or not math.isfinite(gap)):
            return False
        chunk.gaps[k, i] = math.inf if off[i] else gap
    return True
