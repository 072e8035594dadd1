"""Force quadrature error of time steps: mean force over a step minus the midpoint force.

Gauss-Legendre quadrature in each piece in which the force is resolved (see
`statechart.kernels.resolution`); unresolved pieces count with their range.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array
from statechart.kernels.boxes import Steps, bind_tape, bound_third_derivatives
from statechart.kernels.intervals import INF
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import local_time
from statechart.kernels.resolution import bound_box, evaluate_at_places, jet_registers
from statechart.kernels.tapes import TapeCode

# Three points: exact for degree five; error 0.002 over a turn of four radians.
_PLACES = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
# Limits of bisection: pieces per step, and width relative to the step.
_MAX_INTERVALS, _NARROW = 128, 2.0**-20


@kernel
def force_quadrature_error(tape: TapeCode, steps: Steps) -> tuple[Array, Array]:
    """Integrate each output (n_out,) over each step, minus its midpoint value.

    Returns two arrays (m, n_out): the error, and a bound of its unresolved part.
    """
    outputs, reads, times, coeffs = tape.outputs, tape.reads, steps.times, steps.coeffs
    count = outputs.shape[0]
    step_tape, regs = bind_tape(tape, steps, len(_PLACES))
    jets, bounds = jet_registers(step_tape, regs), np.zeros(coeffs.shape[1])
    known = np.zeros((coeffs.shape[0], count))
    unknown = np.zeros((coeffs.shape[0], count))
    middle, mean = np.empty(count), np.empty(count)
    lefts, rights = np.empty(64), np.empty(64)
    for step in range(coeffs.shape[0]):
        bound_third_derivatives(coeffs, step, reads, bounds)
        h = local_time(times, step, 1.0) - local_time(times, step, 0.0)
        evaluate_at_places(step_tape, step, 0.0, 1.0, _PLACES, regs)
        for i in range(count):
            middle[i] = regs[outputs[i], 1]
        top, pieces = 1, 0
        lefts[0], rights[0] = 0.0, 1.0
        while top > 0:
            top -= 1
            pieces += 1
            a, b = lefts[top], rights[top]
            bound_box(step_tape, step, bounds, a, b, jets)
            resolved = True
            for i in range(count):
                resolved = resolved and jets[outputs[i], 2] == 0.0
            if not resolved and pieces < _MAX_INTERVALS and b - a > _NARROW:
                m = 0.5 * (a + b)
                lefts[top], rights[top] = m, b
                lefts[top + 1], rights[top + 1] = a, m
                top += 2
                continue
            evaluate_at_places(step_tape, step, a, b, _PLACES, regs)
            for i in range(count):
                mean[i] = 0.0
                for j in range(len(_PLACES)):
                    mean[i] += _WEIGHTS[j] * regs[outputs[i], j]
                if abs(mean[i] - middle[i]) < INF:
                    known[step, i] += h * (b - a) * (mean[i] - middle[i])
                if jets[outputs[i], 2] < INF:
                    unknown[step, i] += h * (b - a) * jets[outputs[i], 2]
    return known, unknown
