"""Prescribed motion and applied forces of the next steps, as kernels take them."""

from __future__ import annotations

from typing import NamedTuple

from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.jit import part
from statechart.kernels.tapes import run_tape


class ForceProgram(NamedTuple):
    """Forces and moments on some bodies."""

    bodies: Ints  # (f,): which.
    # The program (see `statechart.formulas.tape.Tape`) over the state of a run, and the parameters:
    # two components and a moment for each.
    code: Ints32
    constants: Array
    outputs: Ints32
    values: Array


class Ahead(NamedTuple):
    """Prescribed motion and forces in the next steps."""

    # Of surfaces, and what joints hold points to in the world, at the midpoints of the steps, of
    # the one before and of the one after.
    frames: Array  # shape (k + 2, s, 3)
    places: Array  # shape (k + 2, j, 2)
    memories: Array  # (k + 2, w): what controllers remember then.
    forces: ForceProgram

    def after(self, count: int) -> Ahead:
        """Return what acts after so many steps."""
        return self._replace(
            frames=self.frames[count:],
            places=self.places[count:],
            memories=self.memories[count:],
        )


@part
def apply(
    forces: ForceProgram,
    registers: tuple[int, Array],
    places: Array,
    old: Array,
    memory: Array,
    time: float,
    inverse: Array,
    h: float,
    rates: Array,
) -> None:
    """Add to rates (b, 3) what forces do to them in a step.

    Parameters
    ----------
    forces : ForceProgram
    registers : (int, array)
        See `statechart.kernels.tapes.filled`.
    places, old : (b, 3)
        Where bodies are in the middle of the step, and their rates before it.
    memory : (w,)
        What controllers remember.
    time, h : float
    inverse : (b, 3)
    """
    base, numbers = registers
    at = 0
    for source in (places, old):
        for b in range(len(source)):
            for d in range(3):
                numbers[at, 0] = source[b, d]
                at += 1
    for j in range(len(memory)):
        numbers[at + j, 0] = memory[j]
    numbers[at + len(memory), 0] = time
    run_tape(forces.code, 0, len(forces.code), base, numbers, 1)
    for i in range(len(forces.bodies)):
        b = forces.bodies[i]
        for d in range(3):
            rates[b, d] += h * inverse[b, d] * numbers[forces.outputs[3 * i + d], 0]
