"""Two opposed contacts (a latch and its stop) have no clearance: both are closed, or none.

The small gap left when one closes must not count as clearance of the other: the body would bounce
between them, and be struck in turn instead of at once, however short the step.
"""

from __future__ import annotations

from contacts.time_stepping.scene_numbers import ContactMemory, Met, SceneNumbers, Tape
from statechart.kernels.jit import part

# Directions are opposite to within this part of their size.
_OPPOSITE = 1e-9
# By so much more than the lever of a landing says, a gap is left: gaps bend.
_BENT = 1.01


@part
def close_opposed(
    scene: SceneNumbers, memory: ContactMemory, tape: Tape, h: float, met: Met
) -> None:
    """Let contacts last that are apart by what the landing of one that faces them has left."""
    n = tape.size
    for i in range(len(scene.cones)):
        row = tape.first + tape.per * i
        gap = tape.numbers[row + 2 * n + 2]
        if memory.off[i] or met.hit[i] or scene.held[i] > 0 or not gap > 0.0:
            continue
        for other in range(len(scene.cones)):
            left = tape.numbers[tape.first + tape.per * other + 2 * n + 2]
            lasts = met.active[other] and not met.hit[other]
            if not lasts or memory.level[other] >= -scene.near:
                continue
            lever = _opposing_lever(tape, i, other)
            if lever > 0.0 and gap <= scene.near - _BENT * lever * left:
                # Kept where the other is, neither is asked to part by what the other is not.
                met.active[i], memory.closed[i] = True, True
                memory.level[i] = -lever * memory.level[other]
                above = gap + lever * memory.level[other]
                met.wanted[i, 0] = above / h + 0.5 * h * tape.numbers[row + 2 * n]
                met.wanted[i, 1] = 0.5 * h * tape.numbers[row + 2 * n + 1]
                break


@part
def _opposing_lever(tape: Tape, i: int, other: int) -> float:
    """Return how far contact `i` closes where `other` opens by 1; 0 where they do not face."""
    n, own, its = tape.size, tape.first + tape.per * i, tape.first + tape.per * other
    most = least = apart = 0.0
    for j in range(n):
        most = max(most, abs(tape.numbers[own + j]))
        least = max(least, abs(tape.numbers[its + j]))
    if most == 0.0 or least == 0.0:
        return 0.0
    lever = most / least
    for j in range(n):
        apart = max(apart, abs(tape.numbers[own + j] + lever * tape.numbers[its + j]))
    return lever if apart <= _OPPOSITE * most else 0.0
