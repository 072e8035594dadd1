"""Tapes along the arcs of many runs at once, each with parameters of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.extremes import widen
from statechart.kernels.jit import beside
from statechart.kernels.quadrature import integrate_outputs


@beside
def integrate_rows(
    ints: Ints32,
    floats: Array,
    tapes: Ints,
    columns: Ints,
    arcs: Ints32,
    places: NDArray[np.int64],
    starts: Array,
    times: Array,
    coefficients: Array,
    spans: Ints,
    values: Array,
    variables: int,
    totals: Array,
) -> None:
    """Add up the integrals (r, f) of tapes along the arcs of runs.

    Parameters
    ----------
    ints, floats : (..,) array
        Tapes, packed.
    tapes : (k, 9) array of int64
        The tape of every kind of arc, see `statechart.engines.mode_table.TAPE`; one without
        outputs where nothing is integrated.
    columns : (k, f) array of int64
        Where each of its outputs is added.
    arcs, places, starts, times, coefficients
        See `statechart.automaton.trace_store.TraceBuffer`.
    spans : (r, ..) array of int64
        Where the arcs of a run begin and end.
    values : (r, p) array
        Parameters of the runs.
    variables : int
        Of a state.
    totals : (r, f) array
    """
    for row in range(spans.shape[0]):
        for arc in range(spans[row, 0], spans[row, 1]):
            tape = tapes[arcs[arc, 0]]
            if tape[5] == 0:
                continue
            steps, width = np.int64(arcs[arc, 2]), np.int64(arcs[arc, 3])
            at, place = places[arc, 0], places[arc, 1]
            found, _ = integrate_outputs(
                ints[tape[0] : tape[0] + 3 * tape[1]].reshape((tape[1], 3)),
                floats[tape[2] : tape[2] + tape[3]],
                ints[tape[4] : tape[4] + tape[5]],
                ints[tape[6] : tape[6] + tape[7]],
                tape[8],
                times[at : at + steps + 1],
                coefficients[place : place + steps * variables * width].reshape(
                    (steps, variables, width)
                ),
                values[row],
                starts[arc, 0],
                0.0,
                times[at + steps],
            )
            for i in range(found.shape[0]):
                totals[row, columns[arcs[arc, 0], i]] += found[i]


@beside
def extremes_rows(
    ints: Ints32,
    floats: Array,
    tapes: Ints,
    arcs: Ints32,
    places: NDArray[np.int64],
    starts: Array,
    times: Array,
    coefficients: Array,
    spans: Ints,
    values: Array,
    variables: int,
    extremes: Array,
) -> None:
    """Bring the least and the greatest value (r, 2) of tapes up to date by those along arcs.

    See `integrate_rows`; tapes have one output.
    """
    for row in range(spans.shape[0]):
        for arc in range(spans[row, 0], spans[row, 1]):
            tape = tapes[arcs[arc, 0]]
            steps, width = np.int64(arcs[arc, 2]), np.int64(arcs[arc, 3])
            at, place = places[arc, 0], places[arc, 1]
            terms = coefficients[place : place + steps * variables * width]
            terms = terms.reshape((steps, variables, width))
            widen(
                ints[tape[0] : tape[0] + 3 * tape[1]].reshape((tape[1], 3)),
                floats[tape[2] : tape[2] + tape[3]],
                ints[tape[4] : tape[4] + tape[5]],
                ints[tape[6] : tape[6] + tape[7]],
                tape[8],
                times[at : at + steps + 1],
                terms,
                terms,
                values[row],
                starts[arc, 0],
                starts[arc, 1],
                extremes[row],
            )
