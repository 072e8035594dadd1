"""The numbers of a run in compiled code, for runs that are made many at a time.

What `contacts.dynamics.setup` computes for one run, and to the same bits, where nothing is wrong
with the values and nothing is to be told of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.parameters import MASS_UNIT
from contacts.dynamics.scales import horizon, measure
from contacts.dynamics.setup import ROUNDING
from contacts.dynamics.setup_evaluation import FAR, POINT_MASS, SceneNumbers
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.engines.mode_table import Program, tape_of
from statechart.kernels.jit import beside
from statechart.kernels.ranges import tape_ranges
from statechart.kernels.tapes import tape_values

LIMITS, SCALES, MOTIONS, STOPS = range(4)
"""Rows of the tapes that they are computed from, behind those of the instants."""


class Rules(NamedTuple):
    """How the numbers of a run follow from the values of a scene's parameters."""

    # (b,): Place of every body's moment of inertia among the values; -1 where it has none
    inertias: Ints
    # `least`, `most`: (l,): Between which limits lie
    least: Array
    most: Array
    begins: Ints  # (g + 1,)
    # `places`, `gravity`, `paths`: See `contacts.dynamics.scales.ScaleTape`
    places: int
    gravity: int
    paths: int
    forced: Bools  # (s,): Which stop conditions have no value before forces are known


class Numbers(NamedTuple):
    """The numbers of a run."""

    values: Array  # (p,): Of the parameters
    initial: Array  # (n,)
    scales: Array  # (5,), sizes : (n,): See `contacts.dynamics.scales.Scales`
    sizes: Array
    bands: Array  # (s,): How near zero stop conditions count as met


def rules(numbers: SceneNumbers) -> Rules | None:
    """Return the rules of a scene without joints; None where each run is set up alone."""
    if numbers.limits is None or MASS_UNIT in numbers.places:
        return None
    return Rules(
        np.array([-1 if place is None else place for _, place in numbers.inertias], np.int64),
        np.ascontiguousarray(numbers.bounds[0]),
        np.ascontiguousarray(numbers.bounds[1]),
        numbers.scale_tape.begins,
        numbers.scale_tape.places,
        numbers.scale_tape.gravity,
        numbers.scale_tape.paths,
        np.array([name in numbers.of_forces for name in numbers.stops], np.bool_),
    )


def run_buffer(parameters: int, variables: int, rules: Rules) -> Numbers:
    """Return memory for the numbers of a run."""
    return Numbers(
        np.empty(parameters),
        np.empty(variables),
        np.empty(5),
        np.empty(variables),
        np.empty(len(rules.forced)),
    )


@beside
def run_numbers(
    program: Program,
    tapes: NDArray[np.int64],
    rules: Rules,
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    inputs: Array,
    made: Numbers,
) -> bool:
    """Write the numbers of a run; False where something is wrong with them, or to be told.

    Parameters
    ----------
    program : Program
        Holds the tapes.
    tapes : (4, 9) array of int64
        Limits, scales, motions, stops.
    rules : Rules
    code, constants, outputs
        Tape of the parameters, the initial state and the levers of bodies.
    inputs : (i,) array
        What it takes.
    made : Numbers
        To be filled.
    """
    values, initial, bodies = made.values, made.initial, rules.inertias.shape[0]
    found = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, np.empty(0), inputs, 0.0, found)
    p, n = values.shape[0], initial.shape[0]
    for i in range(p):
        values[i] = found[i]
        if values[i] != values[i]:
            return False
    for i in range(n):
        initial[i] = found[p + i]
        if not abs(initial[i]) < math.inf:
            return False
    for b in range(bodies):
        lever, place = found[p + n + b], rules.inertias[b]
        if lever != lever:
            return False
        if place >= 0 and 0.0 < values[place] < POINT_MASS * lever:
            return False
    code, constants, outputs, _, _ = tape_of(program, tapes[LIMITS])
    limits = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, initial, values, 0.0, limits)
    for i in range(limits.shape[0]):
        if not rules.least[i] <= limits[i] <= rules.most[i]:
            return False
    code, constants, outputs, _, _ = tape_of(program, tapes[SCALES])
    numbers = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, initial, values, 0.0, numbers)
    duration = horizon(numbers, rules.begins)
    code, constants, outputs, _, _ = tape_of(program, tapes[MOTIONS])
    ranges = np.empty((outputs.shape[0], 2))
    tape_ranges(code, constants, outputs, initial, values, duration, ranges)
    if not measure(
        numbers, rules.begins, rules.places, rules.gravity, rules.paths, ranges, made.scales,
        made.sizes,
    ):  # fmt: skip
        return False
    if made.scales[4] > FAR * made.scales[0]:
        return False
    code, constants, outputs, _, _ = tape_of(program, tapes[STOPS])
    bands = made.bands
    tape_values(code, constants, outputs, initial, values, 0.0, bands)
    for i in range(bands.shape[0]):
        if bands[i] != bands[i] and not rules.forced[i]:
            return False
        bands[i] = ROUNDING * abs(bands[i]) if abs(bands[i]) < math.inf else 0.0
    return True
