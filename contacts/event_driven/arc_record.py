"""Arcs of a run in compiled code, written to its block."""

from __future__ import annotations

from statechart.automaton.trace_store import ARCS, TERMS, TIMES, TraceBuffer
from statechart.engines.mode_table import Scratch
from statechart.kernels.jit import part


@part
def record_arc(
    block: TraceBuffer, memory: Scratch, mode: int, j: int, steps: int, high: float, low: float
) -> None:
    """Write the steps of a flow behind the others, without terms that are zero in all of them."""
    coeffs, used = memory.coefficients, block.used
    n, width = coeffs.shape[1], coeffs.shape[2]
    zero = True
    while zero and width > 1:
        for i in range(steps):
            for v in range(n):
                zero = zero and coeffs[i, v, width - 1] == 0.0
        if zero:
            width -= 1
    arc, at, place = used[ARCS], used[TIMES], used[TERMS]
    block.arcs[arc, 0], block.arcs[arc, 1] = mode, j
    block.arcs[arc, 2], block.arcs[arc, 3] = steps, width
    block.places[arc, 0], block.places[arc, 1] = at, place
    block.starts[arc, 0], block.starts[arc, 1] = high, low
    for i in range(steps + 1):
        block.times[at + i] = memory.times[i]
    for i in range(steps):
        for v in range(n):
            for k in range(width):
                block.coefficients[place + k] = coeffs[i, v, k]
            place += width
    used[ARCS], used[TIMES], used[TERMS] = arc + 1, at + steps + 1, place
