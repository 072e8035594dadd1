"""Which operations of a tape some of its outputs need.

A search asks for all outputs of a tape where a step is clear, and for one or two where it is not:
then the others' operations are skipped.
"""

from __future__ import annotations

from statechart.arrays import Ints, Ints32
from statechart.kernels.boxes import Along
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import POW, SKIP

Needed = tuple[Ints, Ints32, Ints32, Ints]
"""For every register the outputs that need it, a bit each; the operations and the variables that
are chosen; for which outputs, where the last operation is, how many variables."""

# Bits of a set; the outputs beyond share the last.
_BITS = 62


@kernel
def bit(output: int) -> int:
    """Return the set of one output."""
    return 1 << min(output, _BITS)


@kernel
def follow(along: Along, outputs: Ints32, needed: Needed) -> None:
    """Follow which registers the outputs need; of operations, those that `along` runs."""
    needs, chosen, _, kept = needed
    code, base, first, last = along[:4]
    for r in range(base + code.shape[0]):
        needs[r] = 0
    for i in range(outputs.shape[0]):
        needs[outputs[i]] |= bit(i)
    for k in range(code.shape[0]):
        chosen[k, 0], chosen[k, 1], chosen[k, 2] = code[k, 0], code[k, 1], code[k, 2]
    for k in range(last - 1, first - 1, -1):
        needs[code[k, 1]] |= needs[base + k]
        if code[k, 0] <= POW:
            needs[code[k, 2]] |= needs[base + k]
    kept[0] = kept[1] = kept[2] = 0


@kernel
def narrowed(needed: Needed, along: Along, outputs: int) -> Along:
    """Return `along` with the operations and variables that a set of outputs needs alone."""
    needs, chosen, variables, kept = needed
    code, base, first, last, reads, times, coeffs, start = along
    if kept[0] != outputs:
        end, count = first, 0
        for k in range(first, last):
            if needs[base + k] & outputs != 0:
                chosen[k, 0] = code[k, 0]
                end = k + 1
            else:
                chosen[k, 0] = SKIP
        for r in range(reads.shape[0]):
            if needs[reads[r]] & outputs != 0:
                variables[count] = reads[r]
                count += 1
        kept[0], kept[1], kept[2] = outputs, end, count
    return chosen, base, first, kept[1], variables[: kept[2]], times, coeffs, start
