"""The first fall of an output along a path, by branch and bound on boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints32
from statechart.kernels.boxes import (
    Along,
    Steps,
    enclose,
    judge,
    place_whole,
    prepare,
    unclear_by_slopes,
    unclear_by_values,
)
from statechart.kernels.intervals import INF, LIBM
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import local_time
from statechart.kernels.roots import last_place, return_to_zero, value_at
from statechart.kernels.search_workspace import (
    BOXES,
    PreparedTape,
    bit,
    prepare_tape,
    search_workspace,
    select_outputs,
)
from statechart.kernels.tapes import TapeCode

NONE, CROSSING, GRAZE, BUDGET, NON_FINITE = range(5)

NARROW = 2.0**-48  # of a step: narrower boxes tell nothing new in float64

FLAT = 2.0**-12  # likewise: nothing that a step resolves is within rounding of zero thrice in it

BoxWorkspace = tuple[Array, Array, Array, Array]
"""Bounds of third derivatives, registers, jets, and evidence on one output."""


@kernel
def _descent(
    along: Along, guard: Ints32, step: int, left: float, right: float, workspace: BoxWorkspace
) -> tuple[int, float]:
    """Return the root of the margin itself, on the descent that ends at `right` below tolerance.

    The margin falls on [left, right]. Further to the left the descent is followed as long as the
    slope is proved negative, over the joints of steps too; if the margin is not positive on all
    of it, the answer is where it starts.
    """
    reads, coeffs = along[4], along[6]
    bounds, regs, jets, work = workspace
    p, q = right, left
    if value_at(along, step, guard[0], p, regs) >= 0.0:
        return step, p
    for _ in range(1000):
        if value_at(along, step, guard[0], q, regs) > 0.0:
            return step, last_place(along, step, guard[0], 0.0, q, p, regs)
        p = q
        if p == 0.0:
            if step == 0:
                break
            step -= 1
            p = q = 1.0
            prepare(coeffs, step, reads, bounds)
            continue
        reach = p
        while reach >= NARROW:
            judge(along, guard, step, bounds, p - reach, p, jets, work)
            if work[0, 7] < 0.0:
                break
            reach *= 0.5
        if reach < NARROW:
            break
        q = p - reach
    return step, p


@kernel
def _falls(
    along: Along,
    guard: Ints32,
    tolerance: float,
    step: int,
    a: float,
    b: float,
    workspace: BoxWorkspace,
) -> tuple[int, float]:
    """Return whether an output that falls all over [a, b] passes -tolerance there, and a sure end.

    Returns 0 for no, 1 for yes, 2 for undecided. Zero to within rounding at b is a yes if b is
    the end of the step; elsewhere it is decided a little beyond b, if it falls there too.
    """
    bounds, _, jets, work = workspace
    end = b
    for shrink in (0.0, 1.0, 0.0625):
        if shrink > 0.0:
            end = min(1.0, b + shrink * (b - a))
            judge(along, guard, step, bounds, a, end, jets, work)
            if not work[0, 7] < 0.0:
                continue
        enclose(along, step, bounds, end, 0.0, 0, jets)
        if jets[guard[0], 0] + tolerance > 0.0:
            return 0, end
        if jets[guard[0], 1] + tolerance <= 0.0 or end == 1.0:
            return 1, end
    return 2, b


@kernel
def _clear_at_edge(
    along: Along,
    output: int,
    tolerance: float,
    step: int,
    a: float,
    b: float,
    bounds: Array,
    jets: Array,
) -> bool:
    """Return whether an output is above -tolerance on [a, b] where it is defined, nearly all.

    Where a root begins or ends, rounding leaves it undefined: on a box that is narrow, or at both
    ends and the middle of one that is wider. The ends themselves are defined to within rounding,
    but for the place where a step starts: there log is infinite.
    """
    m = 0.5 * (a + b)
    for s in (a, m, b):
        enclose(along, step, bounds, s, 0.0, 0, jets)
        if b - a > NARROW and jets[output, 0] > -INF and jets[output, 1] < INF:
            return False
        enclose(along, step, bounds, s, 0.0, -1, jets)
        if s > 0.0 and not (jets[output, 0] > -INF and jets[output, 1] < INF):
            return False
    enclose(along, step, bounds, m, max(b - m, m - a), -1, jets)
    return jets[output, 0] + tolerance > 0.0


CLEAR, FALLS, OPEN, STUCK = range(4)
"""Verdicts on an output in a box: it does not fall, it does, or neither; the last where the
box is too narrow to look closer."""


@kernel
def _certain_end(
    along: Along, guard: Ints32, tolerance: float, step: int, here: float, end: float,
    workspace: BoxWorkspace,
) -> float:  # fmt: skip
    """Return a place where an output that falls from `here` to `end` is surely below -tolerance."""
    bounds, _, jets, aside = workspace
    # The slope carries the round-off left at the float root below 0.
    enclose(along, step, bounds, here, 0.0, 0, jets)
    rest = max(0.0, jets[guard[0], 1] + tolerance) / -aside[0, 7]
    far = min(end, (here + rest * (1.0 + LIBM)) * (1.0 + LIBM))
    if far > here + NARROW:
        # Nearly flat at the end of where it falls: it is below long before.
        near = here + NARROW
        while near < far:
            enclose(along, step, bounds, near, 0.0, 0, jets)
            if jets[guard[0], 1] + tolerance <= 0.0:
                far = near
            near = here + 2.0 * (near - here)
    return far


@kernel
def _judge_box(
    along: Along, guard: Ints32, tolerance: float, step: int, a: float, b: float,
    evidence: Array, workspace: BoxWorkspace,
) -> tuple[int, float, float]:  # fmt: skip
    """Judge by the evidence whether an output falls on [a, b]; return where, and a certain end."""
    bounds, regs, jets, aside = workspace
    output = guard[0]
    if a == 0.0 and evidence[10] + tolerance < 0.0:
        return FALLS, 0.0, 0.0
    # It rises: positive up to a, as the boxes before are clear; or zero there to within rounding,
    # and leaving.
    rises = evidence[6] > 0.0 and (a > 0.0 or evidence[9] > -INF)
    if evidence[4] + tolerance > 0.0 or rises:
        return CLEAR, INF, INF
    if evidence[7] < 0.0:
        aside[0, 7] = evidence[7]
        falls, end = _falls(along, guard, tolerance, step, a, b, workspace)
        if falls == 0:
            return CLEAR, INF, INF
        if falls == 1:
            here = last_place(along, step, output, tolerance, a, end, regs)
            return FALLS, here, _certain_end(along, guard, tolerance, step, here, end, workspace)
    bounded = evidence[4] > -INF and evidence[5] < INF
    edge = b - a <= FLAT and not bounded
    if edge and _clear_at_edge(along, output, tolerance, step, a, b, bounds, jets):
        return CLEAR, INF, INF
    if b - a > NARROW:
        return OPEN, INF, INF
    # A jump, say: positive at a, and negative at b or, where that is the place of the jump to
    # within rounding, a little beyond.
    for end in (b, min(1.0, b + 4.0 * NARROW)):
        enclose(along, step, bounds, end, 0.0, 0, jets)
        if bounded and jets[output, 1] + tolerance < 0.0:
            return FALLS, a, end
    if a == 0.0 and not evidence[7] < INF:
        # A margin that jumps as it starts (an angle at the origin), or leaves the boundary with an
        # infinite slope (a root at zero), has its value behind.
        enclose(along, step, bounds, b, 0.0, 0, jets)
        if jets[output, 0] + tolerance > 0.0:
            return CLEAR, INF, INF
    return STUCK, INF, INF


@kernel
def search(
    tape: TapeCode, tolerances: Array, steps: Steps, first: int, last: int, budget: int
) -> tuple[int, int, int, float, float, float, int]:
    """First fall of an output below minus its tolerance: see `event_location`.

    The steps [first, last) are searched; a descent is followed into those before.
    Returns (verdict, guard, step and place of the event, its local time, where it is certain,
    boxes).
    """
    outputs = tape.outputs
    for i in range(outputs.shape[0]):
        if not tolerances[i] >= 0.0:
            raise ValueError("the tolerances of margins are numbers >= 0")
    n, operations = steps.coeffs.shape[1], tape.code.shape[0]
    registers = n + 1 + steps.parameters.shape[0] + tape.constants.shape[0] + operations
    workspace = search_workspace(registers, operations, outputs.shape[0], n)
    return search_along(
        prepare_tape(tape, steps, workspace), outputs, tolerances, first, last, budget
    )


@kernel
def clear_whole(
    ready: PreparedTape, outputs: Ints32, tolerances: Array, step: int, jets: Array
) -> bool:
    """Return whether the ranges of the variables in a step exclude that an output falls.

    Writes the ranges of all registers to `jets`, and the first marks for `search_step`.
    """
    along, marks = ready[0], ready[7]
    code, base, first, last = along[:4]
    finite, clear = place_whole(along, step, jets), True
    if finite:
        run_jets(code, first, last, base, jets, 0)
    for i in range(outputs.shape[0]):
        # No fall of an output with an infinite tolerance is looked for.
        above = tolerances[i] == INF or (finite and jets[outputs[i], 0] + tolerances[i] > 0.0)
        marks[0, i] = 0 if above else 1
        clear = clear and above
    return clear and finite


@kernel
def _undecided(marks: NDArray[np.uint8], count: int) -> int:
    """Return the set of those of the first outputs that are marked."""
    outputs = 0
    for i in range(count):
        if marks[i] != 0:
            outputs |= bit(i)
    return outputs


@kernel
def search_along(
    ready: PreparedTape, outputs: Ints32, tolerances: Array, first: int, last: int, budget: int
) -> tuple[int, int, int, float, float, float, int]:
    """Search steps (see `search`)."""
    boxes, jets = 0, ready[4]
    for step in range(first, last):
        if clear_whole(ready, outputs, tolerances, step, jets) and boxes < budget:
            boxes += 1
            continue
        verdict, guard, event_step, place, at, sure, looked = search_step(
            ready, outputs, tolerances, step, budget - boxes
        )
        boxes += looked
        if verdict != NONE:
            return verdict, guard, event_step, place, at, sure, boxes
    return NONE, -1, 0, 0.0, 0.0, 0.0, boxes


@kernel
def search_step(
    ready: PreparedTape, outputs: Ints32, tolerances: Array, step: int, budget: int
) -> tuple[int, int, int, float, float, float, int]:
    """Search a step (see `search`) for the fall of an output that `clear_whole` has marked."""
    along, needs, bounds, regs, jets, work, ends, marks = ready
    reads, times, coeffs, start = along[4:]
    n_out = outputs.shape[0]
    aside, state = work[n_out:], marks[BOXES]
    workspace = (bounds, regs, jets, aside)
    lefts, rights = ends[0], ends[1]  # the leftmost on top
    boxes = 0
    finite = prepare(coeffs, step, reads, bounds) and abs(start) < INF
    if not (finite and abs(times[step]) < INF and abs(times[step + 1]) < INF):
        return NON_FINITE, -1, step, 0.0, times[step], times[step + 1], boxes
    found, root, sure, found_left = -1, INF, INF, 0.0
    top = 1
    lefts[0], rights[0] = 0.0, 1.0
    while top > 0:
        top -= 1
        a, b = lefts[top], rights[top]
        boxes += 1
        if boxes > budget:
            at, end = local_time(times, step, a), local_time(times, step, b)
            return BUDGET, -1, step, a, at, end, boxes - 1
        for i in range(n_out):
            state[i] = marks[top, i]
        few = select_outputs(needs, along, _undecided(state, n_out))
        if b - a == 1.0:
            unclear = unclear_by_slopes(few, outputs, tolerances, step, bounds, jets, state, work)
        else:
            # Ranges are cheap, and often enough.
            m = 0.5 * (a + b)
            enclose(few, step, bounds, m, max(b - m, m - a), 0, jets)
            unclear = unclear_by_values(outputs, tolerances, jets, state)
        if unclear == 0:
            continue
        few = select_outputs(needs, along, _undecided(state, n_out))
        judge(few, outputs, step, bounds, a, b, jets, work)
        unclear, improved = 0, False
        for i in range(n_out):
            if state[i] == 0:
                continue
            alone, guard = select_outputs(needs, along, bit(i)), outputs[i : i + 1]
            verdict, here, far = _judge_box(
                alone, guard, tolerances[i], step, a, b, work[i], workspace
            )
            if verdict == OPEN:
                unclear += 1
                continue
            if verdict == STUCK and (found < 0 or b < root - 4.0 * NARROW):
                verdict = GRAZE if work[i, 4] > -INF and work[i, 5] < INF else NON_FINITE
                at, far = local_time(times, step, a), local_time(times, step, b)
                return verdict, i, step, a, at, far, boxes
            # A stuck output ties with the crossing found, to within round-off.
            state[i] = 0
            if verdict == FALLS and (found < 0 or here < root or (here == root and i < found)):
                found, root, sure, found_left, improved = i, here, far, a, True
        if improved:
            # Only what is undecided before the crossing matters any more.
            top = 0
        if unclear == 0:
            continue
        if improved and sure < b:
            lefts[top], rights[top] = a, max(sure, a)
            top += 1
        else:
            m = 0.5 * (a + b)
            lefts[top], rights[top] = m, b
            lefts[top + 1], rights[top + 1] = a, m
            top += 2
        for i in range(n_out):
            marks[max(top - 2, 0), i] = marks[top - 1, i] = state[i]
    if found >= 0:
        guard = outputs[found : found + 1]
        alone = select_outputs(needs, along, bit(found))
        event_step, event = _descent(alone, guard, step, found_left, root, workspace)
        below = root if event_step == step else 1.0
        event = return_to_zero(alone, event_step, guard[0], event, below, bounds, regs, jets)
        at = local_time(times, event_step, event)
        return CROSSING, found, event_step, event, at, local_time(times, step, sure), boxes
    return NONE, -1, 0, 0.0, 0.0, 0.0, boxes
