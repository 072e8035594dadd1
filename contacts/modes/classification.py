"""Contact modes of a state: complementarity on accelerations, by enumeration or Lemke's algorithm.

The mode depends on the state alone, not on the event. With up to four touching contacts every mode
is solved and checked by its inequalities: only enumeration can prove that there is none, one, or
several. With more contacts Lemke's algorithm finds one. If the constraints of contacts are
dependent, a mode is consistent if some forces in the cones explain its motion
(`contacts.modes.load_sharing`). States are known to the tolerance of a run only: if the friction
force needed for rest is at its bound within that error, the contact sticks (`ForceUncertainty`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from itertools import product
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, bounds, carriers, cones
from contacts.dynamics.scales import Scales
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import EDGES, SCALARS, PerContact, Snapshot
from contacts.modes.load_sharing import Share, bearing, prestressed_contacts, rank, share
from contacts.modes.signs_at_rest import laws_of, signs_at_rest, with_signs
from contacts.scene.modes import OWN, SignFriction
from contacts.solvers.lemke import delassus_matrix, forces_by_lemke
from contacts.solvers.mode_solver import (
    AGAINST,
    BEYOND,
    INTO,
    NEGATIVE,
    OUTSIDE,
    PULLS,
    choose_edges,
    judge_forces,
    solve_modes,
)
from contacts.solvers.saddle_point import CONTRADICTORY, REDUNDANT, SOLVED, UNDETERMINED
from contacts.states import (
    CODES,
    DISENGAGED,
    FREE,
    INACTIVE,
    LOCKED,
    OFF,
    OFF_CODE,
    OPEN,
    PIN,
    SLIDE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    SLIDING,
    SLIPPING,
    STICKING,
    declared_state,
    undetermined,
)
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.laws import roles_in
from statechart.automaton.lazy import LazyMapping
from statechart.automaton.trace import Key, Roles
from statechart.errors import AmbiguousMode, NoConsistentMode, NonFinite
from statechart.kernels.jit import kernel

_REASONS = {
    INTO: "it would accelerate at {:.3g} into the surface",
    PULLS: "V = {:.3g} < 0",
    OUTSIDE: "|H| = {:.6g} > mu V",
    AGAINST: "slip would accelerate at {:.3g} against it",
    BEYOND: "|M| = {:.6g} > its limit",
    NEGATIVE: "its limit is {:.6g} < 0",
}
SINGULAR = "its equations do not determine the motion"
"""Reason of a mode in which a body without mass or inertia is free."""
OPEN_LOAD = "how the contacts share the load changes the motion"
"""Reason of a mode whose motion depends on the load sharing (feet of different friction)."""
_UNSOLVED = {
    CONTRADICTORY: "its contacts cannot move together like that",
    UNDETERMINED: OPEN_LOAD,
}
_DETERMINED = (SOLVED, REDUNDANT)
_UNEXPLAINED = "no forces within the cones explain its motion"
_DUPLICATE = "moves like a mode that keeps more contacts closed or pinned"
# Kind of violation: forces outside all cones; the other kinds are those of `mode_solver`.
_OUTSIDE_ALL = -1
# Relative difference of accelerations up to which two motions are equal.
_SAME_MOTION = 1e-9
# Forces below this part of the scene's force are round-off.
_EXACT = 1e-13


class Case(NamedTuple):
    """State to be classified."""

    snapshot: Snapshot
    laws: Sequence[ContactLaw]  # One per contact
    # `closed`, `at_rest`: Masks of contacts whose gap is closed, and whose slip is zero
    closed: Sequence[bool]
    at_rest: Sequence[bool]
    scales: Scales  # For judging inequalities
    tie: float = 0.0  # Relative violations up to this are boundary cases
    signs: int = 0  # How many of the laws, the last, are signs (`contacts.modes.signs_at_rest`)


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


def consistent(tried: Iterable[Candidate], tie: float) -> list[Candidate]:
    """Return the candidates that violate no inequality by more than `tie`."""
    return [c for c in tried if c.violation <= tie]


def candidates(case: Case, options: Sequence[Sequence[str]]) -> list[Candidate]:
    """Solve every combination of `options` (states per contact).

    If constraints are dependent, a combination is consistent if some forces in the cones explain
    its motion; of the combinations with the same motion only the one with most closed, then most
    pinned contacts is kept.
    """
    return _solved_combinations(case, *_combinations(tuple(options), _loads(tuple(case.laws))))


def _solved_combinations(
    case: Case, combinations: Sequence[tuple[str, ...]], codes: Ints
) -> list[Candidate]:
    snapshot, laws, closed, at_rest, scales, tie, _ = case
    edges = bounds(laws, snapshot)
    count, contacts = codes.shape
    status, verdicts = np.empty(count, np.int64), np.empty((count, 4))
    accelerations = np.empty((count, len(snapshot.forces)))
    forces = np.empty((count, contacts, 2))
    redundant, _ = solve_modes(
        snapshot.mass,
        snapshot.forces,
        snapshot.jacobians,
        snapshot.biases,
        edges,
        carriers(tuple(laws)),
        codes,
        _flags(
            tuple(
                is_closed and not law.coupling for is_closed, law in zip(closed, laws, strict=True)
            )
        ),
        _flags(tuple(at_rest)),
        scales.force,
        scales.acceleration,
        status,
        accelerations,
        forces,
        verdicts,
        tie,
    )
    solved: list[Candidate] = []
    judged = zip(combinations, status.tolist(), verdicts.tolist(), strict=True)
    for k, (states, outcome, (violation, contact, kind, number)) in enumerate(judged):
        undetermined = "" if outcome in _DETERMINED else _UNSOLVED.get(outcome, SINGULAR)
        broken = (laws[int(contact)].name if laws else "", int(kind), number)
        violation = math.inf if undetermined else violation
        solved.append(
            Candidate(states, accelerations[k], forces[k], violation, broken, None, undetermined)
        )
    if redundant:
        _explain(case, edges, codes, solved, np.flatnonzero(status == REDUNDANT).tolist())
    return solved


def _refused(candidate: Candidate, why: str) -> Candidate:
    return candidate._replace(violation=math.inf, undetermined=why)


def _explain(
    case: Case,
    edges: Array,
    codes: Ints,
    solved: list[Candidate],
    redundant: Sequence[int],
) -> None:
    """Check whether forces in the cones explain the motion of candidates with dependent rows."""
    snapshot, scales, tie = case.snapshot, case.scales, case.tie
    inward = 0.25 * max(tie, _EXACT) * scales.force
    bound = max(tie, _SAME_MOTION)
    moving = [(k, solved[k]) for k in redundant if solved[k].violation <= bound]
    if not moving:
        return
    moving.sort(key=lambda item: openness(item[1]))
    motions = np.array([rejected.accelerations for _, rejected in moving]).reshape(len(moving), -1)
    largest = _SAME_MOTION * np.maximum(scales.acceleration, np.abs(motions).max(1, initial=0.0))
    represented = np.zeros(len(moving), np.bool_)
    failed: list[tuple[Candidate, Ints]] = []
    for place, (k, candidate) in enumerate(moving):
        if represented[place]:
            solved[k] = _refused(candidate, _DUPLICATE)
            continue
        shared_forces = None
        if not any(
            _within(codes[k], code) and same_motion(rejected, candidate, scales, _EXACT)
            for rejected, code in failed
        ):
            chosen = np.empty((len(codes[k]), 2))
            choose_edges(edges, codes[k], chosen)
            shared_forces = share(
                codes[k],
                snapshot,
                chosen,
                carriers(tuple(case.laws)),
                candidate.forces,
                inward,
                case.signs,
            )
        if shared_forces is None or shared_forces.violation > tie * scales.force:
            failed.append((candidate, codes[k]))
            solved[k] = _refused(candidate, _UNEXPLAINED)
            continue
        excess = shared_forces.violation / scales.force
        shared = candidate._replace(forces=shared_forces.forces, share=shared_forces)
        if excess > shared.violation:
            shared = shared._replace(violation=excess, broken=("", _OUTSIDE_ALL, excess))
        solved[k] = shared
        represented |= np.abs(motions - motions[place]).max(1, initial=0.0) <= largest


def _within(code: Ints, other: Ints) -> bool:
    return bool(((code == other) | (code == FREE) | (other == PIN) | (other == LOCKED)).all())


@lru_cache(maxsize=1024)
def _flags(marks: tuple[bool, ...]) -> Bools:
    return np.array(marks, dtype=np.bool_)


@lru_cache(maxsize=1024)
def _loads(laws: tuple[ContactLaw, ...]) -> tuple[tuple[int, int], ...]:
    return tuple((i, law.carrier) for i, law in enumerate(laws) if law.carrier >= 0)


@lru_cache(maxsize=1024)
def _combinations(
    options: tuple[Sequence[str], ...], loads: tuple[tuple[int, int], ...]
) -> tuple[tuple[tuple[str, ...], ...], Ints]:
    """Return every combination of states, as names and as codes.

    `loads` are rolling resistances and their contacts, which open together.
    """
    combinations = tuple(
        states
        for states in product(*options)
        if all((states[i] in OPEN) == (states[carrier] in OPEN) for i, carrier in loads)
    )
    return combinations, np.array([[CODES[state] for state in s] for s in combinations], np.int64)


def same_motion(
    first: Candidate, second: Candidate, scales: Scales, tolerance: float = _SAME_MOTION
) -> bool:
    """Return whether two candidate modes give the same accelerations."""
    size = max(scales.acceleration, float(np.abs(second.accelerations).max()))
    difference = np.abs(first.accelerations - second.accelerations).max()
    return bool(difference <= tolerance * size)


def openness(candidate: Candidate) -> tuple[int, int, str]:
    """Sort key: most contacts closed, then most of them pinned, then names."""
    states = candidate.states
    return (
        sum(state == "free" for state in states),
        sum(state not in STICKING for state in states),
        " ".join(states),
    )


def by_lemke(case: Case, options: Sequence[Sequence[str]]) -> list[Candidate]:
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
    contacts, unconstrained = delassus_matrix(
        snapshot.mass, snapshot.jacobians[group], snapshot.forces
    )
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
    not_accelerating = np.abs(after) <= _SAME_MOTION * max(
        scales.acceleration, float(np.abs(after).max())
    )
    negligible = _SAME_MOTION * float(np.abs(forces).max())
    assignments = []
    # An unloaded contact may be closed or open, one at the edge of its cone pinned or sliding.
    for close_unloaded, pin_at_edge in product((True, False), repeat=2):
        states = [
            allowed_states[0] if len(allowed_states) == 1 or law.coupling else "free"
            for allowed_states, law in zip(options, laws, strict=True)
        ]
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
            elif laws[i].coupling:
                states[i] = "slip+" if slip_direction > 0.0 else "slip-"
            elif edges[k, 1] == 0.0:
                states[i] = "slide"
            else:
                states[i] = "slide+" if slip_direction > 0.0 else "slide-"
        for i, carrier in _loads(tuple(laws)):
            if states[carrier] in OPEN:
                states[i] = "free"
        if all(
            state in allowed_states for state, allowed_states in zip(states, options, strict=True)
        ):
            assignments.append(tuple(states))
    combinations = tuple(dict.fromkeys(assignments))
    if not combinations:
        return []
    codes = np.array([[CODES[state] for state in states] for states in combinations])
    return _solved_combinations(case, combinations, codes)


class ModeRules(NamedTuple):
    """Constants of the classification of contacts."""

    allowed: Bools  # (c, 5): Mask of the state codes that a contact may take
    cones: Array  # (c, 2): cone_n, cone_t at rest
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


@lru_cache(maxsize=1024)
def allowed(states: tuple[tuple[str, ...], ...]) -> Bools:
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
def classify(
    rules: ModeRules,
    numbers: Array,
    n: int,
    after_flow: bool,
    states_before: Ints,
    lowest: Array,
    states: Ints,
) -> bool:
    """Classify every contact; False if the mode is ambiguous.

    Parameters
    ----------
    rules : ModeRules
    numbers : (o,) array
        Snapshot of the scene.
    n : int
        Number of coordinates.
    after_flow, states_before
        Whether a flow ends here, and the states (c,) of the contacts; those that are off stay off.
    lowest : (c,) array
        Lower bounds of the gaps.
    states : (c,) array
        Filled with the state of every contact.
    """
    allowed, gap_drift, speed_drift, speed_tolerance, tie = (
        rules.allowed, rules.gap_drift, rules.speed_drift, rules.speed, rules.tie,
    )  # fmt: skip
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
        gap_closed = gap <= rules.gap
        if not gap >= lowest[c] or (gap_closed and rate < -speed_tolerance):
            return False
        lasting = states_before[c] != FREE
        drifted = gap > gap_drift or abs(rate) > speed_drift
        if lasting and (drifted or (states_before[c] == PIN and abs(slip) > speed_drift)):
            return False
        closed[c], at_rest[c] = (
            gap_closed and rate <= speed_tolerance,
            abs(slip) <= 2.0 * speed_tolerance,
        )
        if not closed[c] and not allowed[c, FREE]:
            return False
        if closed[c] and drifted and not after_flow:
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
    codes = np.empty((total, contacts), np.int64)
    for k in range(total):
        remainder = k
        for c in range(contacts):
            codes[k, c] = options[c, remainder % counts[c]]
            remainder //= counts[c]
    status, verdicts = np.empty(total, np.int64), np.empty((total, 4))
    forces = np.empty((total, contacts, 2))
    edges = np.empty((contacts, 6))
    write_edges(rules.cones, numbers, scalars, edges)
    redundant, agreeing = solve_modes(
        numbers[: n * n].reshape((n, n)),
        numbers[n * n : n * n + n],
        numbers[at:biases_at].reshape((contacts, 2, n)),
        numbers[biases_at:scalars].reshape((contacts, 2)),
        edges,
        np.full(contacts, -1),
        codes,
        closed,
        at_rest,
        rules.force,
        rules.acceleration,
        status,
        np.empty((total, n)),
        forces,
        verdicts,
        tie,
    )
    if redundant > 0 or agreeing < 0 or not verdicts[agreeing, 0] < -tie:
        return False
    if _is_near_bound(codes, states_before, closed, at_rest, verdicts, rules.force_uncertainty):
        return False
    for c in range(contacts):
        for force in forces[agreeing, c]:
            if abs(force) > ENDLESS * rules.force:
                return False
        place = scalars + SCALARS * c
        states[c] = OFF_CODE if states_before[c] == OFF_CODE else codes[agreeing, c]
        if states[c] != FREE and states[c] != OFF_CODE:
            if abs(numbers[place]) > gap_drift or abs(numbers[place + 1]) > speed_drift:
                return False
            if states[c] == PIN and abs(numbers[place + 2]) > speed_drift:
                return False
    return True


class ForceUncertainty(NamedTuple):
    """Uncertainty of friction forces where contacts come to rest."""

    at: Callable[[Array, float], Snapshot]  # Snapshot at a state, after a time
    setup: SceneSetup
    state: Array  # (2 n,)
    # Modes of the contacts before, as far as they were certain: pinned ones do not come to rest
    certain_modes: Key
    # Contacts with a force that has just passed its bound, which is certain, too
    fell: Collection[int] = ()

    def with_signs(self, which: Sequence[int]) -> ForceUncertainty:
        """Return the uncertainty of contacts and signs."""

        def at(state: Array, later: float) -> Snapshot:
            return with_signs(self.at(state, later), which)

        return self._replace(at=at, certain_modes=(*self.certain_modes, *(["locked"] * len(which))))

    def sticking(
        self, case: Case, options: Sequence[Sequence[str]], taken: Candidate
    ) -> Candidate | None:
        """Return a mode with more sticking that is consistent within the error, or None."""
        if not any(map(_comes_to_rest, options, self.certain_modes)):
            return None
        tolerance = self.setup.force_uncertainty
        for candidate in sorted(candidates(case._replace(tie=tolerance), options), key=openness):
            if openness(candidate)[:2] > openness(taken)[:2]:
                break
            rests = any(map(_comes_to_rest, candidate.states, self.certain_modes))
            is_close = (
                rests
                and abs(candidate.violation) <= tolerance
                and not self._passed(case, candidate)
            )
            if is_close and max(abs(candidate.violation), case.tie) <= self._spread(
                case, candidate
            ):
                return candidate
        return None

    def _passed(self, case: Case, candidate: Candidate) -> bool:
        """Return whether a mode is violated by a force that has just passed its bound."""
        fell = [*self.fell]
        if not fell:
            return False
        if candidate.share is not None:
            return True
        verdict, codes = np.full(4, -np.inf), np.array([CODES[candidate.states[i]] for i in fell])
        edges = np.empty((len(fell), 2))
        choose_edges(bounds(case.laws, case.snapshot)[fell], codes, edges)
        judge_forces(verdict, candidate.forces[fell], edges, codes, case.scales.force)
        return bool(verdict[0] > _NEGLIGIBLE_TIE * case.tie)

    def _spread(self, case: Case, candidate: Candidate) -> float:
        """Return the uncertainty of the violation of a mode, in the scales."""
        setup, tolerance, total = self.setup, self.setup.force_uncertainty, 0.0
        speed_tolerance = setup.tolerances["speed"]
        state_errors = (
            speed_tolerance
            / setup.scales.speed
            * np.maximum(setup.scales.sizes, np.abs(self.state))
        )
        time_error = speed_tolerance / setup.scales.acceleration
        shifted_states = [(self.state + step, 0.0) for step in np.diag(state_errors)]
        for state, time in [*shifted_states, (self.state, time_error)]:
            shifted = case._replace(snapshot=self.at(state, time), tie=tolerance)
            (solved,) = candidates(shifted, [(role,) for role in candidate.states])
            total += (
                tolerance if solved.undetermined else abs(solved.violation - candidate.violation)
            )
        return total


def _comes_to_rest(may: Collection[str] | str, was: str) -> bool:
    states = (may,) if isinstance(may, str) else may
    return was not in STICKING and any(state in STICKING for state in states)


# Contacts up to which all modes are enumerated; with more, Lemke's algorithm comes first.
_MAX_ENUMERATED = 4
# Contacts up to which enumeration is the fallback of Lemke's algorithm.
_MAX_ENUMERATED_LAST = 6
# Part of the tie band that is round-off of an equality (balls that touch without load). A contact
# that has just opened is near the edge of the band.
_NEGLIGIBLE_TIE = 0.1
# Relative difference of accelerations up to which a motion continues, at an event located with a
# coarse tolerance. Rival motions differ by a multiple of this.
_CONTINUES = 1e-3
# Rows of a normal reduced by the joints below this part are round-off.
_IMPLIED = 1e-10
# Rejected modes listed in a message.
_MAX_LISTED = 6
_UNCHECKED = (
    f"more than {_MAX_ENUMERATED} contacts touch: Lemke's algorithm finds a mode, and does not "
    "check that it is the only one"
)


def _verdicts(case: Case, tried: Iterable[Candidate], taken: Candidate | None) -> dict[str, str]:
    laws, coefficients = case.laws, _coefficients(case)
    verdicts = {
        _label(laws, c.states): _verdict(c, case.tie) + coefficients(c.states) for c in tried
    }
    if taken is not None:
        firmer = _firmer(case)
        verdicts |= {
            _label(laws, c.states): c.reason + coefficients(c.states)
            for c in tried
            if c.violation > _NEGLIGIBLE_TIE * case.tie and _held(c, taken, firmer)
        }
        verdicts[_label(laws, taken.states)] = "taken" + coefficients(taken.states)
    return verdicts


def _rejections(refused: Mapping[str, str]) -> Iterator[str]:
    """Yield the first rejected modes with reasons, and the number of the others."""
    for label, why in [*refused.items()][:_MAX_LISTED]:
        contact = f"{label.partition(':')[0]}: "
        yield f"{label} fails, {why.removeprefix(contact) if ' ' not in label else why}"
    if len(refused) > _MAX_LISTED:
        yield f"{len(refused) - _MAX_LISTED} more modes fail"


def _coefficients(case: Case) -> Callable[[Sequence[str]], str]:
    """Return a function that formats the coefficients of a mode, for contacts with two."""
    edges = cones(case.laws, case.snapshot.contacts)
    split = [k for k, row in enumerate(edges) if not (row[:2] == row[2:].reshape(2, 2)).all()]

    def words(states: Sequence[str]) -> str:
        phrases = []
        for k in split:
            if states[k] in ("pin", "slide+", "slide-"):
                kind = "static" if states[k] == "pin" else "kinetic"
                n, t = edges[k].reshape(3, 2)[("pin", "slide+", "slide-").index(states[k])]
                mu = math.inf if n == 0.0 else t / n
                phrases.append(f"{case.laws[k].name}: {kind} friction {mu:.7g}")
        return f" ({', '.join(phrases)})" if phrases else ""

    return words


class Choice(NamedTuple):
    """Selected candidate with its explanation."""

    taken: Candidate
    considered: Mapping[str, str]  # Mode -> why it was taken or not
    warning: str = ""  # "" or a sentence, such as for an indeterminate contact
    notes: tuple[str, ...] = ()  # Remarks on the mode, given once per run
    near_bound: bool = False  # Forces may violate their bounds within the error of the run


class Before(NamedTuple):
    """Mode and loads before the instant."""

    # Mode before; of several consistent modes the one that continues its motion is selected. None
    # after an impact, and at the start
    mode: tuple[str, ...] | None = None
    # Contacts that may bear a load; a load on others would have no cause
    bearing: frozenset[int] = frozenset()

    def is_mode(self, states: tuple[str, ...]) -> bool:
        """Return whether contacts, which signs may follow, are in the mode."""
        return self.mode is not None and states[: len(self.mode)] == self.mode

    @classmethod
    def flow(cls, roles: Roles, mode: tuple[str, ...] | None = None) -> Before:
        """Return mode and loads of a flow."""
        return cls(mode, bearing(roles))


def choose(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    closed: Sequence[bool],
    scales: Scales,
    tie: float,
    slip_tolerance: float,
    before: Before | None = None,
    uncertainty: ForceUncertainty | None = None,
) -> Choice:
    """Select the consistent mode of a state.

    Relative violations up to `tie` are boundary cases, slips up to `slip_tolerance` are zero. If
    contacts share a load, the mode of `before` continues as long as some forces of contacts that
    were loaded explain it; without `before` all may be loaded.

    Raises `NoConsistentMode` or `AmbiguousMode` with every candidate and its reason, and
    `NonFinite` if the state has no finite forces.
    """
    count, resting = len(laws), signs_at_rest(snapshot, slip_tolerance)
    before = before or Before(bearing=frozenset(range(count)))
    if resting:
        snapshot, laws = with_signs(snapshot, resting), (*laws, *laws_of(snapshot, resting))
        closed, signs = [*closed, *([True] * len(resting))], range(count, len(laws))
        before = before._replace(bearing=before.bearing.union(signs))
        uncertainty = None if uncertainty is None else uncertainty.with_signs(resting)
    at_rest = [abs(contact.slip) <= slip_tolerance for contact in snapshot.contacts]
    options = [*map(_options, snapshot.contacts, laws, closed, at_rest)]
    for i, carrier in _loads(tuple(laws)):
        options[i] = options[i] if closed[carrier] else ("free",)
    case = Case(snapshot, laws, closed, at_rest, scales, tie, len(resting))
    tried: list[Candidate] = []
    agreeing: list[Candidate] = []
    touching = sum(closed)
    by_pivoting = touching > _MAX_ENUMERATED
    if by_pivoting:
        tried = by_lemke(case, options)
        agreeing = consistent(tried, tie)
    if not agreeing and touching <= _MAX_ENUMERATED_LAST:
        by_pivoting = False
        tried = candidates(case, options)
        agreeing = consistent(tried, tie)
    if not agreeing:
        if not (np.isfinite(snapshot.forces).all() and np.isfinite(snapshot.mass).all()):
            raise NonFinite(
                "forces or inertias have no finite value in this state; look for a logarithm, a "
                "root or a quotient without a value there"
            )
        refused = _verdicts(case, tried, None)
        note = "Lemke's algorithm tried only these modes" if by_pivoting else ""
        reasons = "; ".join(filter(None, (*_rejections(refused), note)))
        advice = "; ".join(_advice(laws, closed, tried))
        raise NoConsistentMode(". ".join(filter(None, (reasons, advice))), considered=refused)
    taken, warning = _rivals(_continuing(agreeing, tried, case, before), case, before)
    uncertain = (
        None if by_pivoting or uncertainty is None else uncertainty.sticking(case, options, taken)
    )
    if uncertain is not None:
        taken, warning = uncertain, ""
    # A rejected mode of undetermined load may close contacts that the selected mode opens.
    if (
        not warning
        and taken.violation >= -tie
        and any(_opens(taken, rejected, closed) for rejected in tried)
    ):
        warning = f"indeterminate: {OPEN_LOAD}; {_label(laws, taken.states)} taken"
    notes: tuple[str, ...] = (_UNCHECKED,) if by_pivoting else ()
    if taken.share is not None:
        notes += _indeterminate(laws, taken.share)
    notes += _carried(snapshot, laws, closed, taken.states)
    if uncertainty is not None and uncertain is not None:
        notes += tuple(
            f"{law.name} comes to rest with its friction at the bound, within the tolerance: it "
            "sticks, and might slip on at a smaller tolerance"
            for law, state, was in zip(laws, taken.states, uncertainty.certain_modes, strict=True)
            if _comes_to_rest(state, was)
        )
    considered = LazyMapping(partial(_verdicts, case, tried, taken))
    if snapshot.signs is not None:
        taken = taken.of_contacts(count, [snapshot.signs.frictions[k] for k in resting])
    return Choice(taken, considered, warning, notes, uncertain is not None)


def _continuing(
    agreeing: list[Candidate],
    tried: Iterable[Candidate],
    case: Case,
    before: Before,
) -> list[Candidate]:
    """Return the consistent candidates that continue the previous motion, or all of them.

    If friction presses a contact into its surface, other modes are consistent with forces without
    cause; an event of another contact does not select them.
    """
    previous = None
    if len(agreeing) > 1 and before.mode is not None:
        of_mode = (c for c in (*agreeing, *tried) if before.is_mode(c.states))
        previous = next((c for c in of_mode if not c.undetermined), None)
    if previous is None or (
        previous.share is not None and not _bearing(previous) <= before.bearing
    ):
        return agreeing
    if previous.violation > _NEGLIGIBLE_TIE * case.tie:
        firmer = _firmer(case)
        if any(_held(previous, c, firmer) for c in agreeing):
            # Static friction has just been exceeded, and kinetic friction is less.
            return agreeing
    return [c for c in agreeing if same_motion(c, previous, case.scales, _CONTINUES)] or agreeing


def _rivals(agreeing: Sequence[Candidate], case: Case, before: Before) -> tuple[Candidate, str]:
    """Select one of several consistent candidates; the second value is "" or a warning.

    Raises `AmbiguousMode` if their motions differ and all keep every contact closed.
    """
    _, laws, closed, _, scales, tie, _ = case
    taken = agreeing[0]
    if len(agreeing) == 1:
        return taken, ""
    clear = [c for c in agreeing if c.violation <= _NEGLIGIBLE_TIE * tie]
    for candidate in clear:
        if candidate.share is not None and before.is_mode(candidate.states):
            return _without_new_loads(candidate, clear, case, before.bearing)
    # A contact held by static friction does not start to slip because another does.
    firmer, holding = _firmer(case), clear
    if firmer:
        lost = [any(_held(d, c, firmer) > _held(c, d, firmer) for d in clear) for c in clear]
        holding = [c for c, slips in zip(clear, lost, strict=True) if not slips]
    taken = min(holding or clear or agreeing, key=openness)
    # A candidate on the boundary of its inequalities (an unloaded massless body) is no rival.
    certain = [c for c in agreeing if c.violation < -tie] if taken.violation < -tie else []
    rivals = [
        c
        for c in certain
        if c is not taken and not same_motion(c, taken, scales) and not _held(taken, c, firmer)
    ]
    if not rivals and taken.share is not None:
        # With a shared load, candidates on the boundary are rivals, too.
        new = _bearing(taken) - before.bearing
        less = [c for c in clear if _bearing(c) < _bearing(taken) <= _bearing(c) | new]
        rivals = [c for c in less if not same_motion(c, taken, scales, _CONTINUES)]
    if not rivals:
        return taken, ""
    labels = ", ".join(_label(laws, c.states) for c in [taken, *rivals])
    opened = [
        c
        for c in [taken, *rivals]
        if any(
            state == "free" and touching for state, touching in zip(c.states, closed, strict=True)
        )
    ]
    if not opened:
        raise AmbiguousMode(f"several modes agree with the state and move it differently: {labels}")
    # Painleve's indeterminate case: a contact could also stay closed with a force without cause.
    # The candidates with the smallest sets of loaded contacts do without.
    bearing = [_bearing(c) for c in opened]
    minimal = [
        c for c, loaded in zip(opened, bearing, strict=True) if not any(b < loaded for b in bearing)
    ]
    taken = min(minimal, key=openness)
    return (
        taken,
        f"indeterminate: {labels} all agree with the state; {_label(laws, taken.states)} taken",
    )


def _held(taken: Candidate, other: Candidate, firmer: Sequence[int]) -> bool:
    """Return whether static friction holds a contact that slips in the other mode."""
    return any(
        taken.states[k] in STICKING and other.states[k] not in (*STICKING, *OPEN) for k in firmer
    )


def _firmer(case: Case) -> Sequence[int]:
    """Return the contacts and couplings whose static friction exceeds their kinetic friction."""
    edges = bounds(case.laws, case.snapshot)
    mu = edges[:, 1::2] / np.maximum(edges[:, ::2], np.finfo(float).tiny)
    coupled = np.array([law.coupling for law in case.laws], np.bool_)
    exceeds = np.where(coupled, edges[:, 0] > edges[:, 1], (mu[:, :1] > mu[:, 1:]).any(1))
    firmer: list[int] = np.flatnonzero(exceeds).tolist()
    return firmer


def _without_new_loads(
    candidate: Candidate, agreeing: Sequence[Candidate], case: Case, loaded_before: frozenset[int]
) -> tuple[Candidate, str]:
    """Return the mode that continues with a shared load, and "" or a warning.

    Existing forces may hold a wedged body. A contact without load before is loaded only if no mode
    is consistent without it: a block pushed along a slot does not jam between its sides. At a
    friction above 1 the smallest forces may press it from both sides: it is held, with a warning.
    """
    new = _bearing(candidate) - loaded_before
    if not new:
        return candidate, ""
    jacobians = case.snapshot.jacobians
    unloaded = [c for c in agreeing if _bearing(c) <= loaded_before]
    moving = [c for c in unloaded if rank(c.states, jacobians) < rank(candidate.states, jacobians)]
    if len(moving) == len(unloaded):
        return min(moving, key=openness, default=candidate), ""
    pressing = [i for i in sorted(_bearing(candidate)) if not case.laws[i].coupling]
    edges = np.empty((len(candidate.states), 2))
    chosen = np.array([CODES[state] for state in candidate.states])
    choose_edges(cones(case.laws, case.snapshot.contacts), chosen, edges)
    prestressed = prestressed_contacts(jacobians, edges, pressing)
    if not new <= prestressed:
        return candidate, ""
    names = ", ".join(case.laws[i].name for i in sorted(prestressed))
    return candidate, (
        f"indeterminate: {names} may be wedged against each other by any force; the run takes the "
        "smallest forces, and their friction may hold the body"
    )


def _advice(
    laws: Sequence[ContactLaw], closed: Sequence[bool], tried: Iterable[Candidate]
) -> Iterator[str]:
    """Yield sentences on how to change a declaration whose state has no consistent mode."""
    rough = [
        law.name
        for law, is_closed in zip(laws, closed, strict=True)
        if is_closed and "pin" in law.states and not any(s in SLIDING for s in law.states)
    ]
    if rough:
        yield (
            f"Add slide, with a friction, to the modes of {', '.join(rough)}: a point that may not "
            "slip can need a force that pulls (McGeer's paradox)"
        )
    unlisted = False
    for law, is_closed in zip(laws, closed, strict=True):
        kinds = {declared_state(state) for state in law.states}
        expected = ("free", "slide", "pin") if law.cone_t > 0.0 else ("free", "slide")
        missing = [kind for kind in expected if kind not in kinds]
        if is_closed and missing and law.name not in rough and not law.coupling:
            unlisted = True
            yield f"{law.name} has no {' and no '.join(missing)} among its modes: add it"
    if not unlisted and any(c.undetermined == SINGULAR for c in tried):
        yield "a body that no contact holds has no mass or no inertia: add it"


def _bearing(candidate: Candidate) -> frozenset[int]:
    return frozenset(i for i, state in enumerate(candidate.states) if state not in OPEN)


def _opens(taken: Candidate, other: Candidate, closed: Sequence[bool]) -> bool:
    """Return whether `taken` opens contacts, or unlocks couplings, that `other` keeps closed."""
    if other.undetermined != OPEN_LOAD:
        return False
    pairs = zip(taken.states, other.states, closed, strict=True)
    return all(
        state == other_state
        or (is_closed and state == "free")
        or (state in SLIPPING and other_state == "locked")
        for state, other_state, is_closed in pairs
    )


def _indeterminate(laws: Sequence[ContactLaw], shared: Share) -> tuple[str, ...]:
    names = [law.name for law, zone in zip(laws, shared.zones, strict=True) if zone != OWN]
    return (undetermined(names),)


def _carried(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    closed: Sequence[bool],
    states: tuple[str, ...],
) -> tuple[str, ...]:
    """Return a note on contacts that joints hold closed, whose forces are undetermined."""
    if snapshot.reduction is None:
        return ()
    reduced = np.abs(snapshot.jacobians[:, 0]).max(axis=1, initial=0.0)
    unreduced = np.abs(snapshot.unreduced.jacobians[:, 0]).max(axis=1, initial=0.0)
    names = [
        law.name
        for law, is_closed, state, remaining, full in zip(
            laws, closed, states, reduced, unreduced, strict=True
        )
        if is_closed and state in OPEN and remaining <= _IMPLIED * full and not law.coupling
    ]
    if not names:
        return ()
    return (
        f"joints hold {', '.join(names)} closed, so that the normal force is undetermined: the "
        "run lets joints bear all of it, without friction there",
    )


def _options(
    contact: PerContact, law: ContactLaw, touching: bool, at_rest: bool
) -> tuple[str, ...]:
    if not touching:
        off_name = DISENGAGED if law.coupling else OFF
        return (off_name if contact.gap == math.inf else "free",)
    return _open(law.states, contact.slip > 0.0, at_rest)


@lru_cache(maxsize=1024)
def _open(states: tuple[str, ...], forward: bool, at_rest: bool) -> tuple[str, ...]:
    """Return the possible states of a touching contact with this direction of slip."""
    direction = ("slide+", "slip+") if forward else ("slide-", "slip-")
    return tuple(
        state
        for state in states
        if state not in INACTIVE and (state in ("free", "slide") or at_rest or state in direction)
    )


def _label(laws: Sequence[ContactLaw], states: Sequence[str]) -> str:
    return " ".join(f"{law.name}:{state}" for law, state in zip(laws, states, strict=True))


def _verdict(candidate: Candidate, tie: float) -> str:
    if candidate.violation <= 0.0:
        return "consistent"
    if candidate.violation <= tie:
        return f"consistent within the tie band: {candidate.reason}"
    return candidate.reason
