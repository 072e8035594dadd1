"""The first crossing of a margin along an arc given as arrays."""

from __future__ import annotations

from numpy.typing import ArrayLike

from statechart.engines.engine import Path
from statechart.engines.event_location import BOXES, Search, search
from statechart.formulas.tape import Tape, contiguous


def first_crossing(
    tape: Tape,
    tolerances: ArrayLike,
    times: ArrayLike,
    coeffs: ArrayLike,
    parameters: ArrayLike,
    start: float,
    *,
    budget: int = BOXES,
) -> Search:
    """Return the result of `search` in all steps, for arrays of any kind."""
    times, coeffs, parameters = contiguous(times), contiguous(coeffs), contiguous(parameters)
    tolerances = contiguous(tolerances)
    if tolerances.shape != tape.outputs.shape:
        raise ValueError(f"the tolerances have shape {tolerances.shape}, not {tape.outputs.shape}")
    path = Path()
    path.times, path.coefficients, path.count = times, coeffs, len(coeffs)
    return search(tape, tolerances, path, parameters, float(start), 0, len(coeffs), budget)
