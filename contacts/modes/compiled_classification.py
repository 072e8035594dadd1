"""Compiled classification of contact modes, by enumeration, for states with one clear mode.

Everything else (dependent constraints, forces near their bounds, several consistent modes, drift
that needs a projection) is left to `contacts.modes.classification`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.snapshot import EDGES, SCALARS
from contacts.solvers.mode_solver import (
    ModeEquations,
    ModeSolutions,
    list_combinations,
    solve_modes,
)
from contacts.states import CODES, FREE, INACTIVE, OFF_CODE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel


class InstantConstants(NamedTuple):
    """Constants of a run for the compiled instants of its contacts."""

    # (9,): Tapes of the snapshot, and of the margins of contacts' conditions
    numbers: NDArray[np.int64]
    conditions: NDArray[np.int64]
    # (m, 3): Trees of the contacts' conditions; see `contacts.dynamics.gates.gate_trees`
    nodes: Ints
    # (2 k + c,): Indices in `FlowInputs.bands` of the margins that fall as conditions cease to
    # hold, as they begin to hold, and as gaps of contacts that are off open; -1 for none
    slots: Ints
    sizes: Array  # (n + 1,): Of the state, and of time
    relative: float  # Round-off of margins, relative to their terms
    allowed: Bools  # (c, 5): Mask of the state codes that a contact may take
    cones: Array  # (c, 2): Unit edges of friction cones at rest
    restitution: Array  # (c,)
    meanings: Ints  # (c,): Kind of restitution; -1 for impacts that are not computed along a path
    offsets: Ints  # (c,): Indices of the gaps' offsets among the parameters
    # `gap_drift`, `speed_drift`: Errors of a closed contact's gap and velocities that need no
    # projection; `gap`, `speed`: Tolerances
    gap_drift: float
    speed_drift: float
    gap: float
    speed: float
    tie: float  # See `contacts.solvers.mode_solver.solve_modes`
    # Minimal distance of forces from their bounds when a contact comes to rest (`ForceUncertainty`)
    force_uncertainty: float
    # `force`, `acceleration`: The scales
    force: float
    acceleration: float
    short: float  # Longest flight that may belong to an accumulation of impacts
    capture: float  # Rebounds slower than this may be summed with those that follow


def allowed(states: Sequence[Sequence[str]]) -> Bools:
    """Return the mask (c, 5) of the state codes of every contact's region."""
    allowed = np.zeros((len(states), len({*CODES.values()})), np.bool_)
    for i, several in enumerate(states):
        for name in several:
            if name not in INACTIVE:
                allowed[i, CODES[name]] = True
    return allowed


# Forces beyond this multiple of the scene's force are infinite up to round-off (Painleve).
ENDLESS = 1e13
# Python solves more combinations of states.
_MAX_COMBINATIONS = 64


@kernel
def _is_near_bound(
    codes: Ints,
    states_before: Ints,
    closed: Bools,
    at_rest: Bools,
    verdicts: Array,
    uncertainty: float,
) -> bool:
    """Return whether a contact comes to rest in a mode whose forces are near their bounds."""
    for k in range(codes.shape[0]):
        if abs(verdicts[k, 0]) <= uncertainty:
            for c in range(codes.shape[1]):
                if codes[k, c] == PIN and states_before[c] != PIN and closed[c] and at_rest[c]:
                    return True
    return False


@kernel
def write_edges(cones: Array, numbers: Array, scalars: int, edges: Array) -> None:
    """Write the edges (c, 6) of friction cones from those at rest and from the snapshot."""
    for c in range(len(edges)):
        place = scalars + SCALARS * c + EDGES
        edges[c, 0], edges[c, 1] = cones[c, 0], cones[c, 1]
        for k in range(4):
            edges[c, 2 + k] = numbers[place + k]


@kernel
def violates_constraints(scene: InstantConstants, numbers: Array, place: int, state: int) -> bool:
    """Return whether a contact, whose scalars begin at `place`, has left its constraints."""
    if state in (FREE, OFF_CODE):
        return False
    drifted = abs(numbers[place]) > scene.gap_drift or abs(numbers[place + 1]) > scene.speed_drift
    return drifted or (state == PIN and abs(numbers[place + 2]) > scene.speed_drift)


@kernel
def classify(
    scene: InstantConstants, numbers: Array, n: int, after_flow: bool, states_before: Ints,
    lowest: float, states: Ints,
) -> bool:  # fmt: skip
    """Write the state of every contact to `states` (c,); False if the mode is ambiguous.

    `numbers` (o,) are the snapshot of `n` coordinates, `states_before` (c,) the states of contacts
    before; those that are off stay off. `after_flow` is true if a flow ends here. `lowest` is the
    lower bound of the gaps of free contacts.
    """
    allowed, speed_tolerance, tie = scene.allowed, scene.speed, scene.tie
    contacts = states.shape[0]
    at = n * n + n + 1
    biases_at = at + 2 * n * contacts
    scalars = biases_at + 2 * contacts
    closed, at_rest = np.empty(contacts, np.bool_), np.empty(contacts, np.bool_)
    options, counts = np.empty((contacts, 5), np.int64), np.empty(contacts, np.int64)
    total = 1
    for c in range(contacts):
        if states_before[c] == OFF_CODE:
            closed[c] = at_rest[c] = False
            options[c, 0], counts[c] = FREE, 1
            continue
        place = scalars + SCALARS * c
        gap, rate, slip = numbers[place], numbers[place + 1], numbers[place + 2]
        gap_closed = gap <= scene.gap
        least = lowest if states_before[c] == FREE else -scene.gap_drift
        if not gap >= least or (gap_closed and rate < -speed_tolerance):
            return False
        if violates_constraints(scene, numbers, place, states_before[c]):
            return False
        closed[c] = gap_closed and rate <= speed_tolerance
        at_rest[c] = abs(slip) <= 2.0 * speed_tolerance
        if not closed[c] and not allowed[c, FREE]:
            return False
        if closed[c] and not after_flow and violates_constraints(scene, numbers, place, SLIDE):
            return False
        counts[c] = 0
        for s in range(5):
            if not closed[c]:
                is_allowed = s == FREE
            elif s in (FREE, SLIDE) or at_rest[c]:
                is_allowed = allowed[c, s]
            else:
                is_allowed = allowed[c, s] and s == (SLIDE_PLUS if slip > 0.0 else SLIDE_MINUS)
            if is_allowed:
                options[c, counts[c]] = s
                counts[c] += 1
        total *= counts[c]
    if total == 0 or total > _MAX_COMBINATIONS:
        return False
    codes = list_combinations(options, counts, total)
    verdicts, forces = np.empty((total, 4)), np.empty((total, contacts, 2))
    edges = np.empty((contacts, 6))
    write_edges(scene.cones, numbers, scalars, edges)
    equations = ModeEquations(
        numbers[: n * n].reshape((n, n)), numbers[n * n : n * n + n],
        numbers[at:biases_at].reshape((contacts, 2, n)),
        numbers[biases_at:scalars].reshape((contacts, 2)),
        edges, np.full(contacts, -1), closed, at_rest,
    )  # fmt: skip
    solutions = ModeSolutions(np.empty(total, np.int64), np.empty((total, n)), forces, verdicts)
    redundant, agreeing = solve_modes(
        equations, codes, scene.force, scene.acceleration, tie, solutions
    )
    if redundant > 0 or agreeing < 0 or not verdicts[agreeing, 0] < -tie:
        return False
    if _is_near_bound(codes, states_before, closed, at_rest, verdicts, scene.force_uncertainty):
        return False
    for c in range(contacts):
        for force in forces[agreeing, c]:
            if abs(force) > ENDLESS * scene.force:
                return False
        states[c] = OFF_CODE if states_before[c] == OFF_CODE else codes[agreeing, c]
        if violates_constraints(scene, numbers, scalars + SCALARS * c, states[c]):
            return False
    return True
