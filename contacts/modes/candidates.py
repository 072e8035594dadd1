"""Modes of the closed contacts, solved and judged by their own inequalities.

Where contacts can stand in for each other, a mode is judged by whether some forces in the cones
explain its motion (`contacts.modes.load_sharing`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, cones
from contacts.dynamics.scales import Scales
from contacts.dynamics.snapshot import Snapshot
from contacts.modes.load_sharing import Share, share
from contacts.solvers.contact_lcp import contact_impulses, contact_problem, delassus
from contacts.solvers.lcp import LcpStatus, solve_lcp
from contacts.solvers.mode_solver import AGAINST, INTO, OUTSIDE, PULLS, solve_modes
from contacts.solvers.saddle_point import CONTRADICTORY, REDUNDANT, SOLVED, UNDETERMINED
from contacts.states import CODES, FREE, PIN
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Roles

_WORDS = {
    INTO: "it would accelerate at {:.3g} into the surface",
    PULLS: "V = {:.3g} < 0",
    OUTSIDE: "|H| = {:.6g} > mu V",
    AGAINST: "slip would accelerate at {:.3g} against it",
}
SINGULAR = "its equations do not determine the motion"
"""Why a mode is undetermined in which a body without mass or inertia is held by nothing."""
OPEN_LOAD = "how the contacts share the load changes the motion"
"""Why a mode is undetermined that more than geometry leaves open: feet of different friction."""
_UNSOLVED = {
    CONTRADICTORY: "its contacts cannot move like that together",
    UNDETERMINED: OPEN_LOAD,
}
_DETERMINED = (SOLVED, REDUNDANT)
_UNEXPLAINED = "no forces within the cones explain its motion"
_LESS = "moves like a mode that keeps more contacts closed or pinned"
# Besides what `contacts.states` numbers: forces in no cone.
_NOWHERE = -1
# Two motions are the same when their accelerations agree to this.
_SAME_MOTION = 1e-9
# Relative to the scene's force: smaller forces cannot be told from none.
_EXACT = 1e-13


class Case(NamedTuple):
    """A state whose mode is asked for."""

    snapshot: Snapshot  # Its numbers
    laws: Sequence[ContactLaw]  # One per contact
    # `closed`, `still`: Whether the contact's gap is closed; whether its slip is zero
    closed: Sequence[bool]
    still: Sequence[bool]
    scales: Scales  # For judging inequalities
    tie: float = 0.0  # Violations up to this (relative) count as boundary cases, not as violations


Undetermined = tuple[tuple[str, ...], str]
"""States per contact, and why they determine no motion."""


class Candidate(NamedTuple):
    """One assignment of modes to the contacts, solved."""

    states: tuple[str, ...]  # Per contact
    accelerations: Array  # (n,)
    forces: Array  # (c, 2): V and H per contact
    violation: float  # The largest inequality it breaks, in units of the scales; <= 0: none
    # That inequality: contact, which (as `contacts.states` numbers them), its number
    broken: tuple[str, int, float]
    # How the contacts share the forces, where the motion does not determine them
    share: Share | None = None

    @property
    def roles(self) -> Roles:
        """The states, and how the forces are shared: what a flow's equations follow from."""
        return roles_in(self.states) if self.share is None else self.share.roles(self.states)

    @property
    def reason(self) -> str:
        """The inequality it is judged by, in words."""
        contact, which, number = self.broken
        if which == _NOWHERE:
            return _UNEXPLAINED
        return f"{contact}: " + _WORDS[which].format(number)


class _Solved(Iterable["Candidate | Undetermined"]):
    """Combinations as the kernel has solved them, made into objects when first asked for."""

    def __init__(
        self,
        laws: Sequence[ContactLaw],
        combinations: Sequence[tuple[str, ...]],
        outcomes: Ints,
        accelerations: Array,
        forces: Array,
        verdicts: Array,
        only: int,
        tie: float,
    ) -> None:
        self._laws, self._combinations = laws, combinations
        self._outcomes, self._verdicts = outcomes, verdicts
        self._accelerations, self._forces = accelerations, forces
        self._only, self._tie = only, tie
        self._made: dict[int, Candidate | Undetermined] = {}

    def __iter__(self) -> Iterator[Candidate | Undetermined]:
        return map(self._at, range(len(self._outcomes)))

    def _at(self, k: int) -> Candidate | Undetermined:
        made = self._made.get(k)
        if made is None:
            made = self._made[k] = self._make(k)
        return made

    def _make(self, k: int) -> Candidate | Undetermined:
        states, outcome = self._combinations[k], self._outcomes.item(k)
        if outcome not in _DETERMINED:
            return states, _UNSOLVED.get(outcome, SINGULAR)
        violation, contact, which, number = self._verdicts[k].tolist()
        broken = (self._laws[int(contact)].name if self._laws else "", int(which), number)
        return Candidate(states, self._accelerations[k], self._forces[k], violation, broken)

    def consistent(self, tie: float) -> list[Candidate]:
        """Return what breaks no inequality by more than `tie`."""
        tried = [self._at(self._only)] if tie == self._tie and self._only >= 0 else self
        return [c for c in tried if isinstance(c, Candidate) and c.violation <= tie]


def consistent(tried: Iterable[Candidate | Undetermined], tie: float) -> list[Candidate]:
    """Return the candidates that break no inequality by more than `tie`."""
    if isinstance(tried, _Solved):
        return tried.consistent(tie)
    return [c for c in tried if isinstance(c, Candidate) and c.violation <= tie]


def candidates(case: Case, options: Sequence[Sequence[str]]) -> Iterable[Candidate | Undetermined]:
    """Solve every combination of `options` (states per contact).

    Where contacts can stand in for each other, a combination is judged by whether some forces in
    the cones explain its motion; of those with one motion, the one that keeps most contacts closed,
    then most of them pinned, stands for all.
    """
    return _solved(case, *_combinations(tuple(options)))


def _solved(
    case: Case, combinations: Sequence[tuple[str, ...]], codes: Ints
) -> Iterable[Candidate | Undetermined]:
    snapshot, laws, closed, still, scales, tie = case
    edges = cones(tuple(laws))
    count, contacts = codes.shape
    status, verdicts = np.empty(count, np.int64), np.empty((count, 4))
    accelerations = np.empty((count, len(snapshot.forces)))
    forces = np.empty((count, contacts, 2))
    several, only = solve_modes(
        snapshot.mass,
        snapshot.forces,
        snapshot.jacobians,
        snapshot.biases,
        edges,
        codes,
        _flags(tuple(closed)),
        _flags(tuple(still)),
        scales.force,
        scales.acceleration,
        status,
        accelerations,
        forces,
        verdicts,
        tie,
    )
    solved = _Solved(laws, combinations, status, accelerations, forces, verdicts, only, tie)
    if several == 0:
        return solved
    found = [*solved]
    redundant = np.flatnonzero(status == REDUNDANT).tolist()
    _explain(case, edges, codes, found, redundant)
    return found


def _explain(
    case: Case,
    edges: Array,
    codes: Ints,
    found: list[Candidate | Undetermined],
    redundant: Sequence[int],
) -> None:
    """Replace candidates judged by their motion alone, by whether forces explain it."""
    snapshot, scales, tie = case.snapshot, case.scales, case.tie
    inward = 0.25 * max(tie, _EXACT) * scales.force
    moving: list[tuple[int, Candidate]] = []
    for k in redundant:
        candidate = found[k]
        assert isinstance(candidate, Candidate)
        if candidate.violation <= max(tie, _SAME_MOTION):
            moving.append((k, candidate))
    taken: list[Candidate] = []
    failed: list[tuple[Candidate, Ints]] = []
    for k, candidate in sorted(moving, key=lambda item: openness(item[1])):
        if any(same_motion(one, candidate, scales) for one in taken):
            found[k] = candidate.states, _LESS
            continue
        given = None
        if not any(
            _within(codes[k], code) and same_motion(one, candidate, scales, _EXACT)
            for one, code in failed
        ):
            given = share(codes[k], snapshot, edges, candidate.forces, inward)
        if given is None or given.violation > tie * scales.force:
            failed.append((candidate, codes[k]))
            found[k] = candidate.states, _UNEXPLAINED
            continue
        outside = given.violation / scales.force
        shared = candidate._replace(forces=given.forces, share=given)
        if outside > shared.violation:
            shared = shared._replace(violation=outside, broken=("", _NOWHERE, outside))
        found[k] = shared
        taken.append(shared)


def _within(code: Ints, other: Ints) -> bool:
    """Whether what every contact may bear in one mode it may bear in the other."""
    return bool(((code == other) | (code == FREE) | (other == PIN)).all())


@lru_cache(maxsize=1024)
def _flags(marks: tuple[bool, ...]) -> Bools:
    return np.array(marks, dtype=np.bool_)


@lru_cache(maxsize=1024)
def _combinations(
    options: tuple[Sequence[str], ...],
) -> tuple[tuple[tuple[str, ...], ...], Ints]:
    """Return every combination of states, in names and as the kernel numbers them."""
    combinations = tuple(product(*options))
    return combinations, np.array([[CODES[state] for state in s] for s in combinations], np.int64)


def same_motion(
    one: Candidate, other: Candidate, scales: Scales, tolerance: float = _SAME_MOTION
) -> bool:
    """Whether two candidates move the bodies alike."""
    size = max(scales.acceleration, float(np.abs(other.accelerations).max()))
    difference = np.abs(one.accelerations - other.accelerations).max()
    return bool(difference <= tolerance * size)


def openness(candidate: Candidate) -> tuple[int, int, str]:
    """Most contacts closed first, then most of them pinned; names make ties deterministic."""
    states = candidate.states
    return (
        sum(state == "free" for state in states),
        sum(state != "pin" for state in states),
        " ".join(states),
    )


def by_lemke(case: Case, options: Sequence[Sequence[str]]) -> Iterable[Candidate | Undetermined]:
    """Solve the modes that Lemke's algorithm ends in (see `candidates`).

    The complementarity problem is in the contacts' accelerations and forces (Stewart and Trinkle's
    form; where there is slip, the force is along the edge that opposes it). It serves to find the
    modes only; they are solved and judged as any others. None: it found no solution.
    """
    snapshot, laws, closed, still, scales, _ = case
    group = [i for i, shut in enumerate(closed) if shut]
    edges = cones(tuple(laws[i] for i in group))
    slides = np.array([0.0 if still[i] else np.sign(snapshot.contacts[i].slip) for i in group])
    contacts, alone = delassus(snapshot.mass, snapshot.jacobians[group], snapshot.forces)
    free = snapshot.biases[group] + alone
    solution = solve_lcp(*contact_problem(contacts, free, edges, slides))
    # A candidate that its residual does not verify may still name the right modes.
    if solution.status not in (LcpStatus.SOLVED, LcpStatus.UNVERIFIED):
        return []
    forces = contact_impulses(solution.z, edges, slides)
    after = free + (contacts @ forces.ravel()).reshape(-1, 2)
    at_rest = np.abs(after) <= _SAME_MOTION * max(scales.acceleration, float(np.abs(after).max()))
    least = _SAME_MOTION * float(np.abs(forces).max())
    found = []
    # What bears no force may be closed, what is on the edge of its cone may be pinned.
    for closer, firmer in product((True, False), repeat=2):
        states = [several[0] if len(several) == 1 else "free" for several in options]
        for k, i in enumerate(group):
            V, H = forces[k].tolist()
            bears = max(V, abs(H)) > least
            if not at_rest[k, 0] or not (bears or closer):
                continue
            inside = edges[k, 1] * V - edges[k, 0] * abs(H) > least
            along = slides[k] or (-H if bears and at_rest[k, 1] else after[k, 1])
            if still[i] and at_rest[k, 1] and (firmer or inside) and "pin" in options[i]:
                states[i] = "pin"
            elif edges[k, 1] == 0.0:
                states[i] = "slide"
            else:
                states[i] = "slide+" if along > 0.0 else "slide-"
        if all(state in several for state, several in zip(states, options, strict=True)):
            found.append(tuple(states))
    combinations = tuple(dict.fromkeys(found))
    if not combinations:
        return []
    codes = np.array([[CODES[state] for state in states] for states in combinations])
    return _solved(case, combinations, codes)
