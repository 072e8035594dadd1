"""Candidate modes of a state: every assignment of modes to contacts, solved and checked.

A mode gives accelerations and contact forces by one linear system
(`contacts.solvers.mode_solver`) and is consistent if they satisfy its inequalities. The modes come
from enumeration (`candidates`) or from Lemke's algorithm (`lemke_candidates`). If the constraints
of contacts are dependent, a mode is consistent if some forces in the cones explain its motion
(`contacts.modes.load_sharing`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, bounds, carriers, cones
from contacts.dynamics.scales import Scales
from contacts.dynamics.snapshot import Snapshot
from contacts.modes.load_sharing import Share, share
from contacts.scene.modes import SignFriction
from contacts.solvers.lemke import delassus_matrix, forces_by_lemke
from contacts.solvers.mode_solver import (
    AGAINST,
    BEYOND,
    INTO,
    NEGATIVE,
    OUTSIDE,
    PULLS,
    ModeEquations,
    ModeSolutions,
    choose_edges,
    solve_modes,
)
from contacts.solvers.saddle_point import CONTRADICTORY, REDUNDANT, SOLVED, UNDETERMINED
from contacts.states import CODES, FREE, LOCKED, OPEN, PIN, SLIDE_MINUS, SLIDE_PLUS, STICKING
from statechart.arrays import Array, Ints
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Roles

_REASONS = {
    INTO: "it would accelerate at {:.3g} into the surface",
    PULLS: "V = {:.3g} < 0",
    OUTSIDE: "|H| = {:.6g} > mu V",
    AGAINST: "slip would accelerate at {:.3g} against it",
    BEYOND: "|M| = {:.6g} > its limit",
    NEGATIVE: "its limit is {:.6g} < 0 (a coupling that lets go has enabled: RELATION)",
}
SINGULAR = "its equations do not determine the motion"
"""Reason of a mode in which a body without mass or inertia is free."""
OPEN_LOAD = "its motion depends on how the contacts share the load"
"""Reason of a mode whose motion depends on the load sharing (feet of different friction)."""
_UNSOLVED = {
    CONTRADICTORY: "no motion of the bodies moves all its contacts like that",
    UNDETERMINED: OPEN_LOAD,
}
_DETERMINED = (SOLVED, REDUNDANT)
_UNEXPLAINED = "no forces within the cones explain its motion"
_DUPLICATE = "moves like a mode that keeps more contacts closed or pinned"
# Kind of violation: forces outside all cones; the other kinds are those of `mode_solver`.
_OUTSIDE_ALL = -1
# Relative difference of accelerations up to which two motions are equal.
SAME_MOTION = 1e-9
NEGLIGIBLE_TIE = 0.1
"""Part of the tie band that is round-off of an equality (balls that touch without load). A contact
that has just opened is near the edge of the band."""
# Forces below this part of the scene's force are round-off.
_EXACT = 1e-13


class Case(NamedTuple):
    """State to be classified."""

    snapshot: Snapshot
    laws: Sequence[ContactLaw]  # One per contact
    # `closed`, `at_rest`: Masks of contacts with closed gap and with zero slip
    closed: Sequence[bool]
    at_rest: Sequence[bool]
    scales: Scales  # For judging inequalities
    tie: float = 0.0  # Relative violations up to this are boundary cases
    signs: int = 0  # How many of the laws, the last, are signs (`contacts.modes.classification`)


class Candidate(NamedTuple):
    """Assignment of modes to the contacts, with its solution."""

    states: tuple[str, ...]  # Per contact
    accelerations: Array  # (n,)
    forces: Array  # (c, 2): V and H per contact
    # Largest violation of an inequality, in the scales; inf if no motion is determined, or no
    # forces explain it
    violation: float
    # The violated inequality: contact, kind (`contacts.solvers.mode_solver`), value
    broken: tuple[str, int, float]
    share: Share | None = None  # Smallest forces, if the motion does not determine them
    undetermined: str = ""  # Reason why it determines no motion

    def of_contacts(self, count: int, frictions: Sequence[SignFriction]) -> Candidate:
        """Return the mode of the first contacts, those behind them being signs."""
        share = None if self.share is None else self.share.of_contacts(count, frictions)
        return self._replace(states=self.states[:count], forces=self.forces[:count], share=share)

    @property
    def roles(self) -> Roles:
        """The states with the load sharing, which determine the equations of a flow."""
        return roles_in(self.states) if self.share is None else self.share.roles(self.states)

    @property
    def reason(self) -> str:
        """Text of the violated inequality."""
        contact, kind, number = self.broken
        if self.undetermined:
            return self.undetermined
        if kind == _OUTSIDE_ALL:
            return _UNEXPLAINED
        return f"{contact}: " + _REASONS[kind].format(number)


def candidates(case: Case, options: Sequence[Sequence[str]]) -> list[Candidate]:
    """Solve every combination of `options` (states per contact).

    If constraints are dependent, a combination is consistent if some forces in the cones explain
    its motion. Among combinations with the same motion the one with most closed, then most pinned
    contacts is returned.
    """
    pairs = resistance_pairs(tuple(case.laws))
    return _solved_combinations(case, *_combinations(tuple(options), pairs))


def _solved_combinations(
    case: Case, combinations: Sequence[tuple[str, ...]], codes: Ints
) -> list[Candidate]:
    snapshot, laws, closed, at_rest, scales, tie, _ = case
    edges = bounds(laws, snapshot)
    count, contacts = codes.shape
    touching = [c and not law.coupling for c, law in zip(closed, laws, strict=True)]
    equations = ModeEquations(
        snapshot.mass, snapshot.forces, snapshot.jacobians, snapshot.biases, edges,
        carriers(tuple(laws)), np.array(touching, np.bool_), np.array(at_rest, np.bool_),
    )  # fmt: skip
    status, accelerations, forces, verdicts = solutions = ModeSolutions(
        np.empty(count, np.int64), np.empty((count, len(snapshot.forces))),
        np.empty((count, contacts, 2)), np.empty((count, 4)),
    )  # fmt: skip
    redundant, _ = solve_modes(equations, codes, scales.force, scales.acceleration, tie, solutions)
    solved: list[Candidate] = []
    judged = zip(combinations, status.tolist(), verdicts.tolist(), strict=True)
    for k, (states, outcome, (violation, contact, kind, number)) in enumerate(judged):
        undetermined = "" if outcome in _DETERMINED else _UNSOLVED.get(outcome, SINGULAR)
        law, lever = (laws[int(contact)].name, laws[int(contact)].lever) if laws else ("", 1.0)
        broken = (law, int(kind), number / lever if kind == AGAINST else number * lever)
        violation = math.inf if undetermined else violation
        solved.append(
            Candidate(states, accelerations[k], forces[k], violation, broken, None, undetermined)
        )
    if redundant:
        _explain(case, edges, codes, solved, np.flatnonzero(status == REDUNDANT).tolist())
    return solved


def _refuse(candidate: Candidate, why: str) -> Candidate:
    return candidate._replace(violation=math.inf, undetermined=why)


def _explain(
    case: Case, edges: Array, codes: Ints, solved: list[Candidate], redundant: Sequence[int]
) -> None:
    """Check whether forces in the cones explain the motion of candidates with dependent rows."""
    snapshot, scales, tie = case.snapshot, case.scales, case.tie
    inward = 0.25 * max(tie, _EXACT) * scales.force
    bound = max(tie, SAME_MOTION)
    moving = [(k, solved[k]) for k in redundant if solved[k].violation <= bound]
    if not moving:
        return
    moving.sort(key=lambda item: closedness_key(item[1]))
    motions = np.array([rejected.accelerations for _, rejected in moving]).reshape(len(moving), -1)
    largest = SAME_MOTION * np.maximum(scales.acceleration, np.abs(motions).max(1, initial=0.0))
    represented = np.zeros(len(moving), np.bool_)
    failed: list[tuple[Candidate, Ints]] = []
    for place, (k, candidate) in enumerate(moving):
        if represented[place]:
            solved[k] = _refuse(candidate, _DUPLICATE)
            continue
        shared_forces, code = None, codes[k]
        # A mode within a failed one has fewer forces to explain the same motion.
        if not any(
            ((code == other) | (code == FREE) | (other == PIN) | (other == LOCKED)).all()
            and same_motion(rejected, candidate, scales, _EXACT)
            for rejected, other in failed
        ):
            chosen, loaded_by = np.empty((len(code), 2)), carriers(tuple(case.laws))
            choose_edges(edges, code, chosen)
            forces = candidate.forces
            shared_forces = share(code, snapshot, chosen, loaded_by, forces, inward, case.signs)
        if shared_forces is None or shared_forces.violation > tie * scales.force:
            failed.append((candidate, code))
            solved[k] = _refuse(candidate, _UNEXPLAINED)
            continue
        excess = shared_forces.violation / scales.force
        shared = candidate._replace(forces=shared_forces.forces, share=shared_forces)
        if excess > shared.violation:
            shared = shared._replace(violation=excess, broken=("", _OUTSIDE_ALL, excess))
        solved[k] = shared
        # In the band of ties a mode with fewer forces may satisfy all inequalities.
        if shared.violation <= NEGLIGIBLE_TIE * tie:
            represented |= np.abs(motions - motions[place]).max(1, initial=0.0) <= largest


@lru_cache(maxsize=1024)
def resistance_pairs(laws: tuple[ContactLaw, ...]) -> tuple[tuple[int, int], ...]:
    """Return pairs of a rolling resistance and its contact, which open together."""
    return tuple((i, law.carrier) for i, law in enumerate(laws) if law.carrier >= 0)


@lru_cache(maxsize=1024)
def _combinations(
    options: tuple[Sequence[str], ...], pairs: tuple[tuple[int, int], ...]
) -> tuple[tuple[tuple[str, ...], ...], Ints]:
    combinations = tuple(
        states
        for states in product(*options)
        if all((states[i] in OPEN) == (states[carrier] in OPEN) for i, carrier in pairs)
    )
    return combinations, _codes(combinations)


def _codes(combinations: Sequence[Sequence[str]]) -> Ints:
    return np.array([[*map(CODES.__getitem__, states)] for states in combinations], np.int64)


def same_motion(
    first: Candidate, second: Candidate, scales: Scales, tolerance: float = SAME_MOTION
) -> bool:
    """Return whether two candidate modes give the same accelerations."""
    size = max(scales.acceleration, float(np.abs(second.accelerations).max(initial=0.0)))
    difference = np.abs(first.accelerations - second.accelerations).max(initial=0.0)
    return bool(difference <= tolerance * size)


def closedness_key(candidate: Candidate) -> tuple[int, int, str]:
    """Sort key: most contacts closed, then most of them pinned, then names."""
    states = candidate.states
    return (
        sum(state == "free" for state in states),
        sum(state not in STICKING for state in states),
        " ".join(states),
    )


def lemke_candidates(case: Case, options: Sequence[Sequence[str]]) -> list[Candidate]:
    """Solve the modes that Lemke's algorithm ends in (see `candidates`).

    The complementarity problem is in accelerations and forces of the contacts (Stewart and
    Trinkle's form; the force of a slipping contact is along the edge that opposes the slip). It
    only proposes modes; these are solved and checked as all others. Empty without a solution.
    """
    snapshot, laws, closed, at_rest, scales, *_ = case
    group = [i for i, is_closed in enumerate(closed) if is_closed]
    slides = np.array([0.0 if at_rest[i] else np.sign(snapshot.contacts[i].slip) for i in group])
    # Contacts at rest have their static friction.
    edges = np.empty((len(group), 2))
    sliding = np.where(slides > 0.0, SLIDE_PLUS, np.where(slides < 0.0, SLIDE_MINUS, PIN))
    choose_edges(cones(laws, snapshot.contacts)[group], sliding, edges)
    jacobians = snapshot.jacobians[group]
    contacts, unconstrained = delassus_matrix(snapshot.mass, jacobians, snapshot.forces)
    free_accelerations = snapshot.biases[group] + unconstrained
    for k, i in enumerate(group):
        if laws[i].coupling:
            # The limit of a coupling acts as a constant normal force.
            static, kinetic = snapshot.limits[i - len(laws)].tolist()
            limit, edges[k] = static if at_rest[i] else kinetic, math.sqrt(0.5)
            contacts[2 * k, 2 * k] = 1.0
            if laws[i].carrier < 0:
                free_accelerations[k, 0] = -limit
            elif laws[i].carrier in group:
                contacts[2 * k, 2 * group.index(laws[i].carrier)] = -limit
    solved, forces = forces_by_lemke(contacts, free_accelerations, edges, slides)
    if not solved:
        return []
    after = free_accelerations + (contacts @ forces.ravel()).reshape(-1, 2)
    largest = max(scales.acceleration, float(np.abs(after).max()))
    not_accelerating = np.abs(after) <= SAME_MOTION * largest
    negligible = SAME_MOTION * float(np.abs(forces).max())
    assignments: dict[tuple[str, ...], None] = {}
    # An unloaded contact may be closed or open, one at the edge of its cone pinned or sliding.
    for close_unloaded, pin_at_edge in product((True, False), repeat=2):
        pairs = zip(options, laws, strict=True)
        states = [may[0] if len(may) == 1 or law.coupling else "free" for may, law in pairs]
        for k, i in enumerate(group):
            V, H = forces[k].tolist()
            bears = max(V, abs(H)) > negligible
            if not not_accelerating[k, 0] or not (bears or close_unloaded):
                continue
            is_inside = edges[k, 1] * V - edges[k, 0] * abs(H) > negligible
            slip_direction = slides[k] or (-H if bears and not_accelerating[k, 1] else after[k, 1])
            sticking = next((state for state in options[i] if state in STICKING), "")
            if at_rest[i] and not_accelerating[k, 1] and (pin_at_edge or is_inside) and sticking:
                states[i] = sticking
            elif edges[k, 1] == 0.0 and not laws[i].coupling:
                states[i] = "slide"
            else:
                sign = "+" if slip_direction > 0.0 else "-"
                states[i] = ("slip" if laws[i].coupling else "slide") + sign
        for i, carrier in resistance_pairs(tuple(laws)):
            if states[carrier] in OPEN:
                states[i] = "free"
        if all(state in may for state, may in zip(states, options, strict=True)):
            assignments[tuple(states)] = None
    combinations = tuple(assignments)
    return _solved_combinations(case, combinations, _codes(combinations)) if combinations else []
