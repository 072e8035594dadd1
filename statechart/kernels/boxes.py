"""Enclosures of a tape's outputs over a box: a part [a, b] of the step's local time s in [0, 1]."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints32
from statechart.kernels.intervals import EPS, INF, LIBM, TINY, add, or_whole_line, round_outward
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import TapeCode, allocate_registers

StepTape = tuple[Ints32, int, int, int, Ints32, Array, Array, float]
"""A tape bound to steps: code, register of its first operation, operations to run (first, last),
reads, times, coeffs, start."""


class Steps(NamedTuple):
    """Polynomial steps of a flow, and its parameters."""

    times: Array  # (m + 1,): ends of the steps, relative to `start`
    coeffs: Array  # (m, n, d + 1): polynomials of the variables in s
    parameters: Array
    start: float  # absolute time of the flow's start


@kernel
def bind_tape(tape: TapeCode, steps: Steps, width: int) -> tuple[StepTape, Array]:
    """Bind a tape to steps; return it, and `width` columns of registers with the constants."""
    base, regs = allocate_registers(
        tape.code, tape.constants, steps.parameters, steps.coeffs.shape[1], width
    )
    last = tape.code.shape[0]
    times, coeffs, start = steps.times, steps.coeffs, steps.start
    return (tape.code, base, tape.n_fixed, last, tape.reads, times, coeffs, start), regs


@kernel
def bound_third_derivatives(coeffs: Array, step: int, reads: Ints32, bounds: Array) -> bool:
    """Bound the third derivative over a step; False if the step is not finite."""
    finite = True
    for r in range(reads.shape[0]):
        v = reads[r]
        if v == coeffs.shape[1]:
            continue
        total = third = 0.0
        for k in range(coeffs.shape[2]):
            size = abs(coeffs[step, v, k])
            total += size
            third += k * (k - 1) * (k - 2) * size
        bounds[v] = third * (1.0 + 128.0 * EPS)
        if not total < INF:
            finite = False
    return finite


@kernel
def write_variable_jets(
    step_tape: StepTape, step: int, bounds: Array, m: float, w: float, order: int, jets: Array
) -> None:
    """Write the jets of the variables and of time over [m - w, m + w] of a step.

    A polynomial p is enclosed by p(m) +- w |p'(m)| +- w^2/2 |p''(m)| +- w^3/6 B with B the bound
    of its third derivative; its derivatives accordingly. Horner's rule passes coefficient k through
    2 k + 1 roundings (Higham, "Accuracy and Stability of Numerical Algorithms", 2002, 5.1), its
    derivatives through 2 k + 2 and 2 k + 4. Sums of absolute values at m keep the bounds small near
    the start of a long step.
    """
    _, _, _, _, reads, times, coeffs, start = step_tape
    for r in range(reads.shape[0]):
        v = reads[r]
        row = jets[v]
        if v == coeffs.shape[1]:
            span = times[step + 1] - times[step]
            value = start + (times[step] + m * span)
            # Near the start of a long step the round-off of its length has little effect.
            size = abs(start) + abs(times[step]) + m * (abs(times[step]) + abs(times[step + 1]))
            radius = w * abs(span) * (1.0 + 4.0 * EPS) + 4.0 * EPS * size + TINY
            row[0], row[1] = value - radius, value + radius
            row[2], row[3] = round_outward((span, span), EPS)
            row[4], row[5] = 0.0, 0.0
            continue
        p0 = p1 = p2 = q0 = q1 = q2 = 0.0
        for k in range(coeffs.shape[2] - 1, -1, -1):
            p2 = p2 * m + p1
            p1 = p1 * m + p0
            p0 = p0 * m + coeffs[step, v, k]
            q2 = q2 * m + q1
            q1 = q1 * m + q0
            q0 = q0 * m + abs(coeffs[step, v, k])
        b3 = bounds[v]
        if q0 + q1 + q2 + b3 == 0.0:
            for c in range(6):
                row[c] = 0.0
            continue
        p2 *= 2.0
        q2 *= 2.0
        r0 = EPS * (q0 + 2.0 * m * q1) + TINY
        r1 = EPS * (4.0 * q1 + 2.0 * m * q2) + TINY
        r2 = EPS * (8.0 + 2.0 * coeffs.shape[2]) * q2 + TINY
        grow = 1.0 + 64.0 * EPS
        d1, d2 = abs(p1) + r1, abs(p2) + r2
        radius = grow * (r0 + w * (d1 + w * (0.5 * d2 + w * b3 / 6.0)))
        row[0], row[1] = or_whole_line(round_outward((p0 - radius, p0 + radius), EPS))
        if order > 0:
            radius = grow * (r1 + w * (d2 + w * 0.5 * b3))
            row[2], row[3] = or_whole_line(round_outward((p1 - radius, p1 + radius), EPS))
            radius = grow * (r2 + w * b3)
            row[4], row[5] = or_whole_line(round_outward((p2 - radius, p2 + radius), EPS))


@kernel
def write_step_jets(step_tape: StepTape, step: int, jets: Array) -> bool:
    """Write enclosures of the variables and of time over a step; False if one is not finite.

    The parabola of the first terms, plus and minus the absolute sum of the others. The terms of a
    Taylor step shrink by a factor of about exp(2) each: the enclosure is as narrow as the one of
    `write_variable_jets`, at a fifth of the work.
    """
    reads, times, coeffs, start = step_tape[4:]
    finite = abs(start) < INF and abs(times[step]) < INF and abs(times[step + 1]) < INF
    for r in range(reads.shape[0]):
        v = reads[r]
        row = jets[v]
        if v == coeffs.shape[1]:
            low, high = start + times[step], start + times[step + 1]
            radius = 4.0 * EPS * (abs(start) + abs(times[step]) + abs(times[step + 1])) + TINY
        else:
            terms, rest = coeffs[step, v], 0.0
            for k in range(3, coeffs.shape[2]):
                rest += abs(terms[k])
            slope = terms[1] if coeffs.shape[2] > 1 else 0.0
            bend = terms[2] if coeffs.shape[2] > 2 else 0.0
            size = abs(terms[0]) + abs(slope) + abs(bend)
            if size + rest == 0.0:
                row[0] = row[1] = 0.0
                continue
            end = terms[0] + (slope + bend)
            low, high = min(terms[0], end), max(terms[0], end)
            if slope * bend < 0.0 and abs(slope) < 2.0 * abs(bend):
                turn = terms[0] - 0.25 * slope * (slope / bend)
                low, high = min(low, turn), max(high, turn)
            radius = rest * (1.0 + 64.0 * EPS) + 8.0 * EPS * size + TINY
        row[0], row[1] = low - radius, high + radius
        finite = finite and row[1] - row[0] < INF
    return finite


@kernel
def enclose(
    step_tape: StepTape, step: int, bounds: Array, m: float, w: float, order: int, jets: Array
) -> None:
    """Write the jets of all registers over [m - w, m + w] of a step."""
    code, base, first, last = step_tape[:4]
    write_variable_jets(step_tape, step, bounds, m, w, order, jets)
    run_jets(code, first, last, base, jets, order)


@kernel
def _lower_bound(value: Array, middle: Array, slope: float, w: float) -> float:
    """Return a lower bound of an output g over a box of half width w.

    The largest of the lower end of its enclosure `value`, of g(m) - slope w with ``slope >= |g'|``,
    and of the minimum of g(m) - d |t| + c t^2 / 2 with ``d >= |g'(m)|`` and ``c <= g''``.
    """
    mean = w * slope
    least = max(value[0], middle[0] - mean - LIBM * (mean + abs(middle[0])) - TINY)
    d, c = max(abs(middle[2]), abs(middle[3])), value[4]
    if c > 0.0 and d < c * w:
        drop, curve = 0.5 * d * d / c, 0.0
    else:
        drop, curve = w * d, 0.5 * c * w * w
    bound = middle[0] - drop + curve
    bound -= LIBM * (drop + abs(curve) + abs(middle[0])) + TINY
    return bound if bound > least else least


@kernel
def _least_parabola(slope: float, bend: float, length: float) -> float:
    """Return the minimum of ``slope t + bend t^2 / 2`` over [0, length], for a slope <= 0."""
    if bend > 0.0 and -slope < bend * length:
        return -0.5 * slope * slope / bend
    return length * (slope + 0.5 * bend * length)


@kernel
def write_enclosures(
    step_tape: StepTape,
    outputs: Ints32,
    step: int,
    bounds: Array,
    a: float,
    b: float,
    jets: Array,
    work: Array,
) -> None:
    """Write the enclosures of every output over the box [a, b] to `work`.

    Columns: 0 to 3 value and slope at the middle, 4 and 5 bounds of the value, 6 and 7 of the
    slope, 8 a lower bound of the second derivative; at the start of a step (a = 0) also 9 and 10,
    the initial value.
    """
    m = 0.5 * (a + b)
    w = max(b - m, m - a)
    enclose(step_tape, step, bounds, m, 0.0, 1, jets)
    for i in range(outputs.shape[0]):
        for c in range(4):
            work[i, c] = jets[outputs[i], c]
    enclose(step_tape, step, bounds, m, w, 2, jets)
    for i in range(outputs.shape[0]):
        box, row = jets[outputs[i]], work[i]
        bend = max(abs(box[4]), abs(box[5])) * w * (1.0 + LIBM)
        low, high = add((row[2], row[3]), (-bend, bend))
        # Comparisons with NaN are false and keep the natural enclosure.
        row[6] = low if low > box[2] else box[2]
        row[7] = high if high < box[3] else box[3]
        row[4] = _lower_bound(box, row, max(abs(row[6]), abs(row[7])), w)
        row[5] = box[1]
        row[8] = box[4]
    if a == 0.0:
        # The bound from the start is the tightest for a margin that leaves zero (start of slip).
        enclose(step_tape, step, bounds, 0.0, 0.0, 1, jets)
        for i in range(outputs.shape[0]):
            at, row = jets[outputs[i]], work[i]
            row[9], row[10] = at[0], at[1]
            drop = _least_parabola(min(at[2], 0.0), row[8], b)
            bound = at[0] + drop - LIBM * (abs(at[0]) - drop) - TINY
            if bound > row[4]:
                row[4] = bound


@kernel
def count_unclear_by_values(
    outputs: Ints32, tolerances: Array, jets: Array, state: NDArray[np.uint8]
) -> int:
    """Clear outputs by their enclosures on a box; return the number of unclear ones."""
    unclear = 0
    for i in range(outputs.shape[0]):
        if state[i] != 0 and jets[outputs[i], 0] + tolerances[i] > 0.0:
            state[i] = 0
        unclear += state[i]
    return unclear


@kernel
def count_unclear_by_slopes(
    step_tape: StepTape,
    outputs: Ints32,
    tolerances: Array,
    step: int,
    bounds: Array,
    jets: Array,
    state: NDArray[np.uint8],
    work: Array,
) -> int:
    """Clear outputs by the mean value form over a step; return the number of unclear ones.

    If terms cancel (as in the slip of a point) it is narrower than the natural enclosure. It takes
    half the time of `write_enclosures`.
    """
    enclose(step_tape, step, bounds, 0.5, 0.0, 0, jets)
    for i in range(outputs.shape[0]):
        work[i, 0] = jets[outputs[i], 0]
    enclose(step_tape, step, bounds, 0.5, 0.5, 1, jets)
    unclear = 0
    for i in range(outputs.shape[0]):
        if state[i] != 0:
            box, middle = jets[outputs[i]], work[i, 0]
            drop = 0.5 * max(abs(box[2]), abs(box[3]))
            least = middle - drop - LIBM * (drop + abs(middle)) - TINY
            if least + tolerances[i] > 0.0 or box[0] + tolerances[i] > 0.0:
                state[i] = 0
            else:
                unclear += 1
    return unclear
