"""Impulses at several contacts at once, as a complementarity problem.

Moreau's law: a contact with an impulse separates at ``v_n+ = -e v_n-``; friction opposes the
remaining slip and lies in its cone. With e = 0 the energy never grows; otherwise it may. Every
combination of modes is solved, and checked by the inequalities of the law relative to their terms.
`strike_group` computes plastic impacts with one solution that is not near a boundary,
`solve_collisions` all others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, cones
from contacts.dynamics.snapshot import SCALARS, Snapshot
from contacts.modes.compiled_classification import InstantConstants, write_edges
from contacts.solvers.contact_rows import STEEPEST
from contacts.solvers.dependence import independent_rows
from contacts.solvers.impulse_coupling import label_coordinates
from contacts.solvers.lemke import delassus_matrix, forces_by_lemke
from contacts.solvers.mode_solver import (
    ModeEquations,
    ModeSolutions,
    choose_edges,
    list_combinations,
    solve_modes,
)
from contacts.solvers.redundancy import mode_columns, smallest_impulses
from contacts.solvers.saddle_point import SOLVED
from contacts.solvers.step_impulses import project_into_cone
from contacts.states import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS, SLIDING
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import copy_numbers
from statechart.kernels.jit import kernel

# Contacts up to which all modes are enumerated, which finds every solution; above, Lemke's
# algorithm comes first.
_MAX_ENUMERATED = 4
# Contacts up to which enumeration is the fallback: inertia ratios above 1e12 ruin Lemke's matrix.
_MAX_LAST_RESORT = 7
# Above this mu the edges of a cone do not span it in double precision: sticking without friction,
# as the mode SLIDE, is tried in addition.
_STEEP = 1e3
# Violations relative to the terms of an inequality: round-off, rejection, and certain decision.
_EXACT, _TIE, _EDGE = 1e-13, 1e-11, 1e-9
# Largest ratio of velocities after an impact to those before.
_MAX_VELOCITY_RATIO = 1e9
# Round-off of a work, relative to its terms.
_WORK_ROUND_OFF = 1e-9
_SAME_IMPULSE = 1e-8
# Velocities below this part of the largest in their group are compared with that instead.
_MIN_VELOCITY_SHARE = 1e-4

STATES = {FREE: "open", PIN: "stick", SLIDE_PLUS: "slip+", SLIDE_MINUS: "slip-", SLIDE: "slip"}
"""Names of the modes of a contact in an impact."""


class ImpactProblem(NamedTuple):
    """Impact of a group of contacts, and the coordinates that they move."""

    mass: Array  # (m, m)
    jacobians: Array  # (g, 2, m)
    cones: Array  # (g, 6): Unit edges at rest, in slip+ and in slip-; see `hold_at_rest`
    start: Array  # (g, 2): v_n + e min(v_n-, 0) and v_t without impulses
    velocity: Array  # (m,): Before the impact
    plastic: bool  # All e = 0: impulses cannot raise the energy


@kernel
def velocities_after(problem: ImpactProblem, change: Array, after: Array, terms: Array) -> float:
    """Write the velocities (g, 2) after a change, and the sizes of their terms.

    Velocities that cancel (a ball that stays on the floor under an impact) have the round-off of
    the impulses although their own terms are zero. Returns the size of the largest terms.
    """
    largest, jacobians = 0.0, problem.jacobians
    for g in range(after.shape[0]):
        for d in range(2):
            after[g, d] = problem.start[g, d]
            terms[g, d] = abs(problem.start[g, d])
            for i in range(change.shape[0]):
                after[g, d] += jacobians[g, d, i] * change[i]
                terms[g, d] += abs(jacobians[g, d, i] * change[i])
            largest = max(largest, terms[g, d])
    for g in range(after.shape[0]):
        for d in range(2):
            terms[g, d] = max(terms[g, d], _MIN_VELOCITY_SHARE * largest)
    return largest


@kernel
def momentum_residual(
    problem: ImpactProblem, change: Array, impulses: Array, fastest: float
) -> float:
    """Return the largest residual of the momentum balance, relative to its terms.

    The solver's residual is relative to the largest row, which hides that of a light body. A mass
    that couples two coordinates has the round-off of both, and a momentum that moves no contact has
    the round-off of the velocities of the `fastest` contact.
    """
    mass, worst, slow = problem.mass, 0.0, np.zeros(change.shape[0])
    for i in range(change.shape[0]):
        reach = np.abs(problem.jacobians[:, :, i]).max()
        # The coordinate's rate at that round-off.
        slow[i] = _MIN_VELOCITY_SHARE * fastest / reach if reach > 0.0 else 0.0
    for i in range(change.shape[0]):
        missed = terms = least = 0.0
        for k in range(change.shape[0]):
            if mass[i, k] != 0.0:
                coupled = math.sqrt(mass[i, i] * mass[k, k])
                missed += mass[i, k] * change[k]
                terms += coupled * abs(change[k])
                least = max(least, coupled * slow[k])
        for g in range(impulses.shape[0]):
            for d in range(2):
                row = problem.jacobians[g, d, i]
                missed -= row * impulses[g, d]
                terms += abs(row) * math.hypot(impulses[g, 0], impulses[g, 1])
        terms += least
        if terms > 0.0:
            worst = max(worst, abs(missed) / terms)
    return worst


@kernel
def work_of(problem: ImpactProblem, change: Array, impulses: Array) -> tuple[float, float]:
    """Return the work of impulses against the surfaces, and the size of its terms.

    It is computed at the contacts and from the momenta, and the sum with the smaller terms is
    returned: round-off is large at the contacts if impulses cancel, in the momenta if bodies are
    fast.
    """
    at_contacts = size_there = of_momenta = size_of = 0.0
    velocity, m = problem.velocity, change.shape[0]
    for g in range(impulses.shape[0]):
        for d in range(2):
            rate = spread = receding = 0.0
            for i in range(m):
                row = problem.jacobians[g, d, i]
                rate += 0.5 * row * change[i]
                spread += abs(row * change[i])
                receding -= row * velocity[i]
            impulse, before = impulses[g, d], problem.start[g, d]
            receding += before
            at_contacts += impulse * (before + rate)
            size_there += abs(impulse) * (abs(before) + spread)
            of_momenta += impulse * receding
            size_of += abs(impulse) * abs(receding)
    for i in range(m):
        momentum = 0.0
        for k in range(m):
            momentum += problem.mass[i, k] * change[k]
        of_momenta += momentum * (velocity[i] + 0.5 * change[i])
        size_of += abs(momentum) * (abs(velocity[i]) + 0.5 * abs(change[i]))
    if size_there <= size_of:
        return at_contacts, size_there
    return of_momenta, size_of


@kernel
def _judge_impact(
    problem: ImpactProblem, code: Ints, cones: Array, change: Array, impulses: Array
) -> tuple[float, float]:
    """Return the largest violation of a combination of modes, and its margin to the boundary.

    Both are relative to the terms of each inequality; the margin is negative if all hold.
    """
    count = code.shape[0]
    after, terms = np.empty((count, 2)), np.empty((count, 2))
    largest, fastest = velocities_after(problem, change, after, terms), 0.0
    for g in range(count):
        for d in range(2):
            fastest = max(fastest, abs(problem.start[g, d]))
    # Solutions that consist of round-off (contacts at one place) have far larger velocities.
    if not largest <= _MAX_VELOCITY_RATIO * fastest:
        return math.inf, math.inf
    worst, edge = 0.0, -math.inf
    for g in range(count):
        normal = after[g, 0] / terms[g, 0] if terms[g, 0] > 0.0 else 0.0
        slip = after[g, 1] / terms[g, 1] if terms[g, 1] > 0.0 else 0.0
        if code[g] == FREE:
            edge = max(edge, -normal)
            continue
        cone_n, cone_t = cones[g, 0], cones[g, 1]
        V, H = impulses[g, 0], impulses[g, 1]
        size = math.hypot(V, H)
        worst = max(worst, abs(normal))
        if code[g] == SLIDE_PLUS or code[g] == SLIDE_MINUS:
            sign = 1.0 if code[g] == SLIDE_PLUS else -1.0
            violation = sign * cone_t * H - cone_n * V
            edge = max(edge, -sign * slip)
        else:
            violation = -V
            if code[g] == PIN or cone_t > 0.0:
                violation = max(violation, cone_n * abs(H) - cone_t * V)
                worst = max(worst, abs(slip))
        edge = max(edge, violation / size if size > 0.0 else 0.0)
    worst = max(worst, edge)
    if worst > _EDGE:
        return worst, edge
    worst = max(worst, momentum_residual(problem, change, impulses, largest))
    if problem.plastic and worst <= _TIE:
        work, size = work_of(problem, change, impulses)
        if work > _WORK_ROUND_OFF * size:
            return math.inf, math.inf
    return worst, edge


@kernel
def solve_impacts(
    problem: ImpactProblem,
    codes: Ints,
    changes: Array,
    impulses: Array,
    violations: Array,
    edges: Array,
) -> None:
    """Solve the combinations of modes (k, g) of an impact, and check them.

    Writes the changes of velocity (k, m), the impulses (k, g, 2), the violations (k,), infinite for
    a combination without a solution, and the margins to the boundary (k,). Combinations with
    dependent rows are rejected, also if round-off makes their system regular.
    """
    total, count = codes.shape
    status, judged = np.empty(total, np.int64), np.zeros(count, np.bool_)
    cones = np.empty((count, 2))
    equations = ModeEquations(
        problem.mass, np.zeros(problem.mass.shape[0]), problem.jacobians, problem.start,
        problem.cones, np.full(count, -1), judged, judged,
    )  # fmt: skip
    solutions = ModeSolutions(status, changes, impulses, np.empty((total, 4)))
    solve_modes(equations, codes, 1.0, 1.0, 0.0, solutions)
    for k in range(total):
        violations[k] = edges[k] = math.inf
        choose_edges(problem.cones, codes[k], cones)
        if status[k] == SOLVED:
            violations[k], edges[k] = _judge_impact(
                problem, codes[k], cones, changes[k], impulses[k]
            )
        if violations[k] <= _TIE:
            columns, _ = mode_columns(codes[k], cones, problem.jacobians, -1)
            if independent_rows(columns)[0] < columns.shape[0]:
                violations[k] = edges[k] = math.inf


@kernel
def _list_modes(allowed: Bools, cone: Array, modes: Ints) -> int:
    """List the modes of a contact in an impact; return their number."""
    modes[0] = FREE
    if cone[1] == 0.0:
        modes[1] = SLIDE
        return 2
    if not (allowed[SLIDE] or allowed[SLIDE_PLUS] or allowed[SLIDE_MINUS]):
        modes[1] = PIN  # Declared not to slip, at whatever force
        return 2
    modes[1], modes[2], modes[3], modes[4] = SLIDE_PLUS, SLIDE_MINUS, PIN, SLIDE
    return 5 if cone[1] > _STEEP * cone[0] else 4


@kernel
def hold_at_rest(start: Array, cones: Array) -> None:
    """Write the cones of contacts at rest: kinetic if they slip before the impact, else static.

    Slips up to the round-off of the fastest contact are zero.
    """
    fastest = 0.0
    for g in range(len(start)):
        fastest = max(fastest, abs(start[g, 0]), abs(start[g, 1]))
    for g in range(len(start)):
        if abs(start[g, 1]) > _EDGE * fastest:
            at = 2 if start[g, 1] > 0.0 else 4
            cones[g, 0], cones[g, 1] = cones[g, at], cones[g, at + 1]


@kernel
def strike_group(
    scene: InstantConstants, numbers: Array, group: Ints, velocity: Array, impulse: Array
) -> int:
    """Compute the plastic impact of the closed contacts `group` (g,), which are coupled.

    `numbers` (o,) are the snapshot of the scene. Updates `velocity` (n,), and writes the `impulse`
    (c, 2) of the group. Returns the modes in digits of base 8 above 1, the first contact the
    lowest; 0 in an ambiguous case.
    """
    n, count, contacts = velocity.shape[0], group.shape[0], scene.allowed.shape[0]
    if count > _MAX_ENUMERATED:
        return 0
    mass = numbers[: n * n].reshape((n, n))
    at = n * n + n + 1
    scalars = at + (2 * n + 2) * contacts
    jacobians, start, cones = np.empty((count, 2, n)), np.empty((count, 2)), np.empty((count, 6))
    edges = np.empty((contacts, 6))
    write_edges(scene.cones, numbers, scalars, edges)
    modes, counts = np.empty((count, 5), np.int64), np.empty(count, np.int64)
    total = 1
    for g in range(count):
        c = group[g]
        counts[g] = _list_modes(scene.allowed[c], scene.cones[c], modes[g])
        if scene.restitution[c] != 0.0 or counts[g] > 4:
            return 0
        total *= counts[g]
        jacobians[g] = numbers[at + 2 * n * c : at + 2 * n * (c + 1)].reshape((2, n))
        copy_numbers(edges[c], cones[g])
        place = scalars + SCALARS * c
        start[g, 0], start[g, 1] = numbers[place + 1], numbers[place + 2]
    labels = label_coordinates(mass, jacobians.reshape((count, 2 * n)), 2 * n)
    for i in range(n):
        # All coordinates must be coupled by the contacts.
        if labels[i] != labels[0]:
            return 0
    codes = list_combinations(modes, counts, total)
    changes, forces = np.empty((total, n)), np.empty((total, count, 2))
    violations, boundary_distance = np.empty(total), np.empty(total)
    hold_at_rest(start, cones)
    problem = ImpactProblem(mass, jacobians, cones, start, velocity, True)
    solve_impacts(problem, codes, changes, forces, violations, boundary_distance)
    agreeing, several = -1, False
    for k in range(total):
        if violations[k] <= _EDGE:
            several, agreeing = several or agreeing >= 0, k
    if (
        several
        or agreeing < 0
        or violations[agreeing] > _TIE
        or boundary_distance[agreeing] > -_EDGE
    ):
        return 0
    path, chosen = 1, np.empty((count, 2))
    choose_edges(cones, codes[agreeing], chosen)
    for g in range(count - 1, -1, -1):
        path = 8 * path + codes[agreeing, g]
        impulse[group[g]] = project_into_cone(forces[agreeing, g], chosen[g])
    for i in range(n):
        velocity[i] += changes[agreeing, i]
    return path


@dataclass(frozen=True, eq=False)
class Impulses:
    """One solution of the impact's complementarity problem."""

    change: Array  # (n,): Of the rates of the coordinates
    impulses: Array  # (c, 2): V and H on the body; zero where a contact is not closed
    states: tuple[str, ...]  # open, stick, slip+, slip- or slip (no friction), per contact
    violation: float  # Largest one, relative to the terms of its inequality


def solve_collisions(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    closed: Sequence[bool],
    restitution: Sequence[float],
) -> tuple[Impulses, ...]:
    """Return the solutions of Moreau's law, one per distinct motion, preferred first.

    ``0 <= P_n``, ``v_n+ + e min(v_n-, 0) >= 0``, their product 0; friction in its cone, against
    the remaining slip. The saddle-point system is solved, so that inertias that the contacts do not
    accelerate may be zero. Up to four contacts all combinations of modes are tried; above, Lemke's
    algorithm finds one solution, which need not be unique. Empty if there is none, or if round-off
    hides it (inertia ratios of 1e24).
    """
    group = [i for i, is_closed in enumerate(closed) if is_closed]
    problem, moved = _problem(snapshot, laws, group, restitution)
    agree: list[Impulses] = []
    if len(group) > _MAX_ENUMERATED:
        agree = _solutions(problem, _modes_by_lemke(problem))
    if not agree and len(group) <= _MAX_LAST_RESORT:
        agree = _solutions(problem, [*product(*(_modes_of(laws[i]) for i in group))])
    distinct: list[Impulses] = []
    for collision in sorted(agree, key=_preference):
        if not any(_same_motion(problem, collision, kept_solution) for kept_solution in distinct):
            distinct.append(collision)
    size = len(snapshot.velocity), len(laws)
    return tuple(_expand_solution(problem, collision, moved, group, size) for collision in distinct)


def label_coupled_coordinates(snapshot: Snapshot, group: Sequence[int]) -> Ints:
    """Label the coordinates (n,) by the components that impulses couple."""
    width = 2 * len(snapshot.mass)
    rows = snapshot.jacobians[list(group)].reshape(len(group), width)
    return label_coordinates(snapshot.mass, rows, width)


def _problem(
    snapshot: Snapshot, laws: Sequence[ContactLaw], group: list[int], restitution: Sequence[float]
) -> tuple[ImpactProblem, Ints]:
    """Return the problem of a group, and the coordinates that its contacts move."""
    labels, jacobians = label_coupled_coordinates(snapshot, group), snapshot.jacobians[group]
    touched = {label for row in jacobians for label in labels[np.abs(row).max(axis=0) > 0.0]}
    moved = np.nonzero([label in touched for label in labels])[0]
    contacts, e = [snapshot.contacts[i] for i in group], np.array(restitution, float)[group]
    start = np.array([c[1:3] for c in contacts]).reshape(-1, 2)
    start[:, 0] += e * np.minimum(start[:, 0], 0.0)
    edges = cones([laws[i] for i in group], contacts)
    hold_at_rest(start, edges)
    mass = np.ascontiguousarray(snapshot.mass[np.ix_(moved, moved)])
    rows, velocity = np.ascontiguousarray(jacobians[:, :, moved]), snapshot.velocity[moved]
    return ImpactProblem(mass, rows, edges, start, velocity, not (e > 0.0).any()), moved


def _modes_of(law: ContactLaw) -> list[int]:
    allowed = np.zeros(5, np.bool_)
    allowed[SLIDE] = any(state in SLIDING for state in law.states)
    modes = np.empty(5, np.int64)
    count = _list_modes(allowed, np.array([law.cone_n, law.cone_t]), modes)
    codes: list[int] = modes[:count].tolist()
    return codes


def _solutions(problem: ImpactProblem, codes: Sequence[Sequence[int]]) -> list[Impulses]:
    count, size = len(problem.cones), len(problem.mass)
    table = np.array(codes, dtype=np.int64).reshape(-1, count)
    changes, impulses = np.empty((len(table), size)), np.empty((len(table), count, 2))
    violations, edges = np.empty(len(table)), np.empty(len(table))
    solve_impacts(problem, table, changes, impulses, violations, edges)
    rough = (problem.cones[:, 1] > 0.0).tolist()
    found = []
    for k in np.flatnonzero(violations <= _TIE).tolist():
        modes = zip(table[k].tolist(), rough, strict=True)
        states = tuple("stick" if m == SLIDE and rubs else STATES[m] for m, rubs in modes)
        found.append(Impulses(changes[k], impulses[k], states, float(violations[k])))
    return found


def _modes_by_lemke(problem: ImpactProblem) -> list[tuple[int, ...]]:
    """Return the modes proposed by Lemke's algorithm on the Delassus matrix.

    It only proposes modes, so that zero inertias may be replaced by small ones.
    """
    size = len(problem.mass)
    contacts, _ = delassus_matrix(problem.mass, problem.jacobians, np.zeros(size))
    no_slip, static_cones = np.zeros(len(problem.cones)), np.ascontiguousarray(problem.cones[:, :2])
    solved, impulses = forces_by_lemke(contacts, problem.start, static_cones, no_slip)
    if not solved:
        return []
    return [tuple(map(_mode, impulses.tolist(), static_cones.tolist()))]


def _mode(impulse: tuple[float, float], cone: tuple[float, float]) -> int:
    (V, H), (cone_n, cone_t) = impulse, cone
    if V == 0.0 and H == 0.0:
        return FREE
    if H == 0.0:
        return SLIDE
    # Steep cones were cut for Lemke's algorithm.
    inner_distance = cone_t * V - max(cone_n, STEEPEST) * abs(H)
    if inner_distance > _EDGE * math.hypot(V, H):
        return PIN
    return SLIDE_MINUS if H > 0.0 else SLIDE_PLUS


def _motion(problem: ImpactProblem, change: Array) -> tuple[Array, Array, float]:
    after, terms = np.empty((2, len(problem.cones), 2))
    return after, terms, velocities_after(problem, change, after, terms)


def _same_motion(problem: ImpactProblem, first: Impulses, second: Impulses) -> bool:
    after, terms, _ = _motion(problem, first.change)
    other_after, sizes, _ = _motion(problem, second.change)
    return bool((np.abs(after - other_after) <= _SAME_IMPULSE * (terms + sizes)).all())


def _expand_solution(
    problem: ImpactProblem, collision: Impulses, moved: Ints, group: list[int],
    size: tuple[int, int],
) -> Impulses:  # fmt: skip
    """Expand a solution to all coordinates and contacts, with its smallest impulses."""
    after, terms, fastest = _motion(problem, collision.change)
    is_closed = np.abs(after[:, 0]) <= _TIE * terms[:, 0]
    sticks = np.abs(after[:, 1]) <= _TIE * terms[:, 1]
    rough = np.where(sticks, PIN, np.where(after[:, 1] > 0.0, SLIDE_PLUS, SLIDE_MINUS))
    code = np.where(problem.cones[:, 1] == 0.0, SLIDE, rough)
    code = np.where(is_closed, code, FREE)
    edges = np.empty((len(code), 2))
    choose_edges(problem.cones, code, edges)
    least_impulses, _ = smallest_impulses(code, problem.jacobians, edges, collision.impulses)
    if momentum_residual(problem, collision.change, least_impulses, fastest) > _TIE:
        least_impulses = collision.impulses
    change, impulses = np.zeros(size[0]), np.zeros((size[1], 2))
    change[moved] = collision.change
    impulses[group] = list(map(project_into_cone, least_impulses, edges))
    states = dict.fromkeys(range(size[1]), "open") | dict(zip(group, collision.states, strict=True))
    return Impulses(change, impulses, tuple(states.values()), collision.violation)


def _preference(collision: Impulses) -> tuple[bool, int, int, tuple[str, ...]]:
    """Sort key: most contacts closed, then most of them sticking, then names."""
    states = collision.states
    return (
        collision.violation > _EXACT,
        states.count("open"),
        len(states) - states.count("stick"),
        states,
    )
