"""First zero crossing of an output along a path, by branch and bound on boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints32
from statechart.kernels.boxes import (
    Steps,
    StepTape,
    bound_third_derivatives,
    count_unclear_by_slopes,
    count_unclear_by_values,
    enclose,
    write_enclosures,
    write_step_jets,
)
from statechart.kernels.intervals import INF, LIBM
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import local_time
from statechart.kernels.roots import locate_fall, return_to_zero, value_at
from statechart.kernels.search_workspace import (
    BOXES,
    PreparedTape,
    output_bit,
    prepare_tape,
    search_workspace,
    select_outputs,
)
from statechart.kernels.tapes import TapeCode

NONE, CROSSING, GRAZE, BUDGET, NON_FINITE = range(5)

NARROW = 2.0**-48  # relative to a step: narrower boxes are round-off

# Relative to a step: a resolved output is not within round-off of zero three times in it.
FLAT = 2.0**-12

BoxWorkspace = tuple[Array, Array, Array, Array]
"""Bounds of third derivatives, registers, jets, and evidence on one output."""


@kernel
def _root_of_descent(
    step_tape: StepTape,
    guard: Ints32,
    step: int,
    left: float,
    right: float,
    workspace: BoxWorkspace,
) -> tuple[int, float]:
    """Return the zero of the margin on the descent that passes its tolerance at `right`.

    The margin falls on [left, right]. The descent is followed to the left as long as the slope is
    proved negative, also into earlier steps; if the margin is nowhere positive on it, its start is
    returned.
    """
    reads, coeffs = step_tape[4], step_tape[6]
    bounds, regs, jets, work = workspace
    p, q = right, left
    if value_at(step_tape, step, guard[0], p, regs) >= 0.0:
        return step, p
    for _ in range(1000):
        if value_at(step_tape, step, guard[0], q, regs) > 0.0:
            return step, locate_fall(step_tape, step, guard[0], 0.0, q, p, regs)
        p = q
        if p == 0.0:
            if step == 0:
                break
            step -= 1
            p = q = 1.0
            bound_third_derivatives(coeffs, step, reads, bounds)
            continue
        reach = p
        while reach >= NARROW:
            write_enclosures(step_tape, guard, step, bounds, p - reach, p, jets, work)
            if work[0, 7] < 0.0:
                break
            reach *= 0.5
        if reach < NARROW:
            break
        q = p - reach
    return step, p


@kernel
def _passes_tolerance(
    step_tape: StepTape,
    guard: Ints32,
    tolerance: float,
    step: int,
    a: float,
    b: float,
    workspace: BoxWorkspace,
) -> tuple[int, float]:
    """Return whether a monotonically falling output passes -tolerance in [a, b], and a certain end.

    Returns 0 for no, 1 for yes, 2 for undecided. A zero within round-off at b counts if b is the
    end of the step; elsewhere the output just beyond b decides, if it falls there too.
    """
    bounds, _, jets, work = workspace
    end = b
    for shrink in (0.0, 1.0, 0.0625):
        if shrink > 0.0:
            end = min(1.0, b + shrink * (b - a))
            write_enclosures(step_tape, guard, step, bounds, a, end, jets, work)
            if not work[0, 7] < 0.0:
                continue
        enclose(step_tape, step, bounds, end, 0.0, 0, jets)
        if jets[guard[0], 0] + tolerance > 0.0:
            return 0, end
        if jets[guard[0], 1] + tolerance <= 0.0 or end == 1.0:
            return 1, end
    return 2, b


@kernel
def _is_clear_at_domain_edge(
    step_tape: StepTape,
    output: int,
    tolerance: float,
    step: int,
    a: float,
    b: float,
    bounds: Array,
    jets: Array,
) -> bool:
    """Return whether an output is above -tolerance on nearly all of [a, b], where it is defined.

    At the boundary of the domain of a root, round-off makes it undefined on a narrow box, or at
    both ends and the middle of a wider one. The ends themselves are defined to within round-off,
    except the start of a step, where a logarithm is infinite.
    """
    m = 0.5 * (a + b)
    for s in (a, m, b):
        enclose(step_tape, step, bounds, s, 0.0, 0, jets)
        if b - a > NARROW and jets[output, 0] > -INF and jets[output, 1] < INF:
            return False
        enclose(step_tape, step, bounds, s, 0.0, -1, jets)
        if s > 0.0 and not (jets[output, 0] > -INF and jets[output, 1] < INF):
            return False
    enclose(step_tape, step, bounds, m, max(b - m, m - a), -1, jets)
    return jets[output, 0] + tolerance > 0.0


CLEAR, FALLS, OPEN, STUCK = range(4)
"""Verdicts on an output in a box: clear, falling, undecided, or undecided in a box that is too
narrow to bisect."""


@kernel
def _certain_end(
    step_tape: StepTape, guard: Ints32, tolerance: float, step: int, here: float, end: float,
    workspace: BoxWorkspace,
) -> float:  # fmt: skip
    """Return a place where an output falling from `here` to `end` is certainly below -tolerance."""
    bounds, _, jets, aside = workspace
    # The slope carries the output from the round-off at the float root below 0.
    enclose(step_tape, step, bounds, here, 0.0, 0, jets)
    rest = max(0.0, jets[guard[0], 1] + tolerance) / -aside[0, 7]
    far = min(end, (here + rest * (1.0 + LIBM)) * (1.0 + LIBM))
    if far > here + NARROW:
        # Nearly flat at the end of its fall: it is below long before.
        near = here + NARROW
        while near < far:
            enclose(step_tape, step, bounds, near, 0.0, 0, jets)
            if jets[guard[0], 1] + tolerance <= 0.0:
                far = near
            near = here + 2.0 * (near - here)
    return far


@kernel
def _judge_box(
    step_tape: StepTape, guard: Ints32, tolerance: float, step: int, a: float, b: float,
    evidence: Array, workspace: BoxWorkspace,
) -> tuple[int, float, float]:  # fmt: skip
    """Decide by enclosures whether an output falls on [a, b]; return where, and a certain end."""
    bounds, regs, jets, aside = workspace
    output = guard[0]
    if a == 0.0 and evidence[10] + tolerance < 0.0:
        return FALLS, 0.0, 0.0
    # It rises from a positive value, since earlier boxes are clear, or from zero within round-off.
    rises = evidence[6] > 0.0 and (a > 0.0 or evidence[9] > -INF)
    if evidence[4] + tolerance > 0.0 or rises:
        return CLEAR, INF, INF
    if evidence[7] < 0.0:
        aside[0, 7] = evidence[7]
        falls, end = _passes_tolerance(step_tape, guard, tolerance, step, a, b, workspace)
        if falls == 0:
            return CLEAR, INF, INF
        if falls == 1:
            here = locate_fall(step_tape, step, output, tolerance, a, end, regs)
            return (
                FALLS,
                here,
                _certain_end(step_tape, guard, tolerance, step, here, end, workspace),
            )
    bounded = evidence[4] > -INF and evidence[5] < INF
    edge = b - a <= FLAT and not bounded
    if edge and _is_clear_at_domain_edge(step_tape, output, tolerance, step, a, b, bounds, jets):
        return CLEAR, INF, INF
    if b - a > NARROW:
        return OPEN, INF, INF
    # A jump, for example: positive at a, and negative at b, or just beyond if b is the place of the
    # jump within round-off.
    for end in (b, min(1.0, b + 4.0 * NARROW)):
        enclose(step_tape, step, bounds, end, 0.0, 0, jets)
        if bounded and jets[output, 1] + tolerance < 0.0:
            return FALLS, a, end
    if a == 0.0 and not evidence[7] < INF:
        # A margin that jumps at the start (an angle at the origin), or leaves the boundary with an
        # infinite slope (a root at zero), has its value after it.
        enclose(step_tape, step, bounds, b, 0.0, 0, jets)
        if jets[output, 0] + tolerance > 0.0:
            return CLEAR, INF, INF
    return STUCK, INF, INF


@kernel
def search(
    tape: TapeCode, tolerances: Array, steps: Steps, first: int, last: int, budget: int
) -> tuple[int, int, int, float, float, float, int]:
    """Find the first fall of an output below minus its tolerance (see `event_location`).

    Searches the steps [first, last), and follows a descent into earlier ones. Returns (verdict,
    guard, step and place of the event, its local time, the time at which it is certain, boxes).
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
def is_step_clear(
    ready: PreparedTape, outputs: Ints32, tolerances: Array, step: int, jets: Array
) -> bool:
    """Return whether the ranges of the variables in a step exclude a fall of any output.

    Writes the ranges of all registers to `jets`, and the undecided outputs for `search_step`.
    """
    step_tape, marks = ready[0], ready[7]
    code, base, first, last = step_tape[:4]
    finite, clear = write_step_jets(step_tape, step, jets), True
    if finite:
        run_jets(code, first, last, base, jets, 0)
    for i in range(outputs.shape[0]):
        # Outputs with infinite tolerance are not searched.
        above = tolerances[i] == INF or (finite and jets[outputs[i], 0] + tolerances[i] > 0.0)
        marks[0, i] = 0 if above else 1
        clear = clear and above
    return clear and finite


@kernel
def _undecided_set(marks: NDArray[np.uint8], count: int) -> int:
    """Return the set of the marked ones among the first `count` outputs."""
    outputs = 0
    for i in range(count):
        if marks[i] != 0:
            outputs |= output_bit(i)
    return outputs


@kernel
def search_along(
    ready: PreparedTape, outputs: Ints32, tolerances: Array, first: int, last: int, budget: int
) -> tuple[int, int, int, float, float, float, int]:
    """Search steps (see `search`)."""
    boxes, jets = 0, ready[4]
    for step in range(first, last):
        if is_step_clear(ready, outputs, tolerances, step, jets) and boxes < budget:
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
    """Search a step (see `search`) for the fall of an output that `is_step_clear` has marked."""
    step_tape, needs, bounds, regs, jets, work, ends, marks = ready
    reads, times, coeffs, start = step_tape[4:]
    n_out = outputs.shape[0]
    aside, state = work[n_out:], marks[BOXES]
    workspace = (bounds, regs, jets, aside)
    lefts, rights = ends[0], ends[1]  # a stack with the leftmost box on top
    boxes = 0
    finite = bound_third_derivatives(coeffs, step, reads, bounds) and abs(start) < INF
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
        few = select_outputs(needs, step_tape, _undecided_set(state, n_out))
        if b - a == 1.0:
            unclear = count_unclear_by_slopes(
                few, outputs, tolerances, step, bounds, jets, state, work
            )
        else:
            # Ranges are cheap, and often suffice.
            m = 0.5 * (a + b)
            enclose(few, step, bounds, m, max(b - m, m - a), 0, jets)
            unclear = count_unclear_by_values(outputs, tolerances, jets, state)
        if unclear == 0:
            continue
        few = select_outputs(needs, step_tape, _undecided_set(state, n_out))
        write_enclosures(few, outputs, step, bounds, a, b, jets, work)
        unclear, improved = 0, False
        for i in range(n_out):
            if state[i] == 0:
                continue
            alone, guard = select_outputs(needs, step_tape, output_bit(i)), outputs[i : i + 1]
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
            # Only undecided boxes before the crossing remain relevant.
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
        alone = select_outputs(needs, step_tape, output_bit(found))
        event_step, event = _root_of_descent(alone, guard, step, found_left, root, workspace)
        below = root if event_step == step else 1.0
        back = return_to_zero(alone, event_step, guard[0], event, below, bounds, regs, jets)
        if abs(value_at(alone, event_step, guard[0], back, regs)) <= tolerances[found]:
            event = back
        at = local_time(times, event_step, event)
        return CROSSING, found, event_step, event, at, local_time(times, step, sure), boxes
    return NONE, -1, 0, 0.0, 0.0, 0.0, boxes
