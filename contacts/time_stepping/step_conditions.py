"""Contacts of a step that their conditions turn off and on."""

from __future__ import annotations

import math

import numpy as np

from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.scene_numbers import ContactMemory, Met, SceneNumbers, Tape
from statechart.arrays import Array
from statechart.kernels.jit import part

# A point that slides off a surface has left it when it is so many times as deep as it lay in it,
# and farther off than so many steps at its speed.
_LEFT_BEHIND, _STEPS = 2.0, 4.0


@part
def _gap_between(past: Array, gap: float, rate: float, part_of: float, h: float) -> float:
    """Return at most which gap a contact has between the middles of two steps.

    It is interpolated; the error is that of a parabola with the change of the gap's rate.
    """
    found: float = past[1] + part_of * (gap - past[1]) + 0.125 * h * abs(rate - past[2])
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
    scene: SceneNumbers, memory: ContactMemory, tape: Tape, k: int, met: Met, chunk: Chunk
) -> bool:  # fmt: skip
    """Let conditions turn contacts off and on, write gaps; return False where one is nowhere.

    Contacts that last are on for now where their conditions cease to hold: see `keep_leaving`.
    """
    numbers, n, off, h, left = tape.numbers, tape.size, memory.off, chunk.h, 1.0
    deepest = np.empty(len(off))
    for i in range(len(off)):
        deepest[i] = _deepest(memory, tape, i) - scene.near
    for i in range(len(off)):
        row = tape.first + tape.per * i
        gap, condition, before = numbers[row + 2 * n + 2], numbers[row + 2 * n + 5], memory.past[i]
        if not off[i] and condition < 0.0:
            inside = memory.closed[i] or memory.level[i] < 0.0
            met.leaving[i] = inside and scene.held[i] == 0
            off[i], memory.behind[i] = not met.leaving[i], met.leaving[i]
            if met.leaving[i] and before[0] > 0.0:
                left = min(left, before[0] / (before[0] - condition))
        elif off[i] and memory.behind[i]:
            away = abs(gap - memory.level[i]) - _STEPS * h * abs(numbers[row + 2 * n + 3])
            memory.behind[i] = away <= (_LEFT_BEHIND - 1.0) * abs(memory.level[i])
        if off[i] and not memory.behind[i]:
            memory.level[i] = 0.0
    leaves = met.leaving.any()
    for i in range(len(off)):
        row = tape.first + tape.per * i
        gap, condition, before = numbers[row + 2 * n + 2], numbers[row + 2 * n + 5], memory.past[i]
        rate = numbers[row + 2 * n + 3]
        if off[i]:
            entered = gap
            if before[0] <= 0.0 < condition:
                begins = before[0] / (before[0] - condition)
                entered = max(gap, _gap_between(before, gap, rate, begins, h))
            met.entered[i] = max(entered, _gap_between(before, gap, rate, left, h))
            off[i] = not (condition > 0.0 and entered >= deepest[i])
            _note_missed(memory.missed[i], off[i], condition > 0.0, -gap)
            if leaves and off[i] and memory.behind[i] and condition < 0.0:
                # Below a kink a point is beyond both surfaces that end there.
                met.leaving[i], off[i] = True, False
        before[0], before[1], before[2] = condition, gap, rate
        if not off[i] and (math.isnan(condition) or not math.isfinite(gap)):
            return False
        chunk.gaps[k, i] = math.inf if off[i] else gap
    return True
