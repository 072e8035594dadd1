"""Dense output: polynomials of steps, sampled, integrated, and their least values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from statechart.arrays import Array
from statechart.formulas.tape import Tape, contiguous
from statechart.kernels.boxes import Steps
from statechart.kernels.polynomials import sample_states
from statechart.kernels.quadrature import integrate_outputs

Flow = tuple[float, ArrayLike, ArrayLike]
"""Start, local times (k + 1,) of the steps' ends and coefficients (k, n, d + 1) of a flow."""

# Flows of one batch.
_MAX_FLOWS = 1024


def lowest(tape: Tape, flows: Sequence[Flow], parameters: ArrayLike, per_step: int = 16) -> Array:
    """Return the least value of every output on a grid along flows.

    Raises `ValueError` if a shape does not fit.
    """
    s = np.arange(per_step + 1) / per_step
    parameters, found = contiguous(parameters), np.full(len(tape.outputs), np.inf)
    for first in range(0, len(flows), _MAX_FLOWS):
        some = flows[first : first + _MAX_FLOWS]
        parts = [checked_arc(tape, *flow[1:], parameters)[:2] for flow in some]
        begin = np.concatenate([times[:-1] for times, _ in parts])[:, None]
        end = np.concatenate([times[1:] for times, _ in parts])[:, None]
        start = np.repeat([flow[0] for flow in some], [len(times) - 1 for times, _ in parts])
        coeffs = np.concatenate([coeffs for _, coeffs in parts])
        local = np.where(s < 1.0, begin + s * (end - begin), end)
        states = np.swapaxes(coeffs @ s ** np.arange(coeffs.shape[2])[:, None], 1, 2)
        times = (start[:, None] + local).ravel()
        values = tape.table(states.reshape(-1, coeffs.shape[1]), parameters, times)
        found = np.minimum(found, values.min(axis=0, initial=np.inf))
    return found


def integrals(
    tape: Tape,
    times: ArrayLike,
    coeffs: ArrayLike,
    parameters: ArrayLike,
    start: float,
    t_from: float,
    t_to: float,
) -> tuple[Array, Array]:
    """Integrate every output over local time, by Gauss and Legendre with 16 nodes in a piece.

    Pieces are steps, halved until every output is resolved in them: what is narrower than a step is
    found by its enclosure, and a kink ends in a piece as wide as rounding. The limits are local
    times; what lies outside the steps does not count. Returns the integrals (n_out,), and the local
    times at which the pieces end. Raises `ValueError` if a shape does not fit.
    """
    times, coeffs, parameters = checked_arc(tape, times, coeffs, parameters)
    return integrate_outputs(
        tape.parts, Steps(times, coeffs, parameters, float(start)), float(t_from), float(t_to)
    )


def sample(coeffs: ArrayLike, times: ArrayLike, tau: ArrayLike) -> Array:
    """Evaluate the polynomials; raises `ValueError` if a shape does not fit."""
    coeffs, times, tau = contiguous(coeffs), contiguous(times), contiguous(tau)
    if coeffs.ndim != 3 or len(coeffs) == 0 or times.shape != (len(coeffs) + 1,) or tau.ndim != 1:
        raise ValueError(
            f"coeffs, times and tau have shapes {coeffs.shape}, {times.shape} and {tau.shape}, "
            "not (n_steps, n, degree + 1), (n_steps + 1,) and (m,) with a step at least"
        )
    return sample_states(coeffs, times, tau)


def checked_arc(
    tape: Tape, times: ArrayLike, coeffs: ArrayLike, parameters: ArrayLike
) -> tuple[Array, Array, Array]:
    """Return an arc's arrays and the parameters as kernels want them; their shapes fit the tape."""
    times, coeffs, parameters = contiguous(times), contiguous(coeffs), contiguous(parameters)
    tape.require(parameters)
    if coeffs.ndim != 3 or times.shape != (len(coeffs) + 1,) or coeffs.shape[1] != tape.n_variables:
        raise ValueError(
            f"times and coeffs have shapes {times.shape} and {coeffs.shape}, "
            f"not (n_steps + 1,) and (n_steps, {tape.n_variables}, degree + 1)"
        )
    return times, coeffs, parameters
