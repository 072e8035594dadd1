"""Contact modes of a state: complementarity on accelerations, by enumeration or Lemke's algorithm.

The answer depends on the state alone, never on which event fired. Up to four contacts that touch,
every mode is tried (enumeration is the one method that can prove that there is none, one, or
several), and judged by its own inequalities; above, Lemke's algorithm finds one. Where contacts can
stand in for each other, a mode is judged by whether some forces in the cones explain its motion
(`contacts.modes.load_sharing`). States are known to the tolerance of a run only: where the force
that a contact's rest takes is just what friction gives, the contact sticks (`ForceUncertainty`).
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

_WORDS = {
    INTO: "it would accelerate at {:.3g} into the surface",
    PULLS: "V = {:.3g} < 0",
    OUTSIDE: "|H| = {:.6g} > mu V",
    AGAINST: "slip would accelerate at {:.3g} against it",
    BEYOND: "|M| = {:.6g} > its limit",
    NEGATIVE: "its limit is {:.6g} < 0",
}
SINGULAR = "its equations do not determine the motion"
"""Why a mode is undetermined in which a body without mass or inertia is held by nothing."""
OPEN_LOAD = "how the contacts share the load changes the motion"
"""Why a mode is undetermined that more than geometry leaves open: feet of different friction."""
_UNSOLVED = {
    CONTRADICTORY: "its contacts cannot move together like that",
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
    signs: int = 0  # How many of the laws, the last, are signs (`contacts.modes.signs_at_rest`)


class Candidate(NamedTuple):
    """One assignment of modes to the contacts, solved as far as it determines a motion."""

    states: tuple[str, ...]  # Per contact
    accelerations: Array  # (n,)
    forces: Array  # (c, 2): V and H per contact
    # The largest inequality it breaks, in units of the scales; <= 0: none; inf: no motion is
    # determined, or none that forces explain
    violation: float
    # That inequality: contact, which (as `contacts.states` numbers them), its number
    broken: tuple[str, int, float]
    # How the contacts share the forces, where the motion does not determine them
    share: Share | None = None
    undetermined: str = ""  # Why it determines no motion

    def of_contacts(self, count: int, frictions: Sequence[SignFriction]) -> Candidate:
        """Return the mode of the first contacts, those behind them being signs."""
        share = None if self.share is None else self.share.of_contacts(count, frictions)
        return self._replace(states=self.states[:count], forces=self.forces[:count], share=share)

    @property
    def roles(self) -> Roles:
        """The states, and how the forces are shared: what a flow's equations follow from."""
        return roles_in(self.states) if self.share is None else self.share.roles(self.states)

    @property
    def reason(self) -> str:
        """The inequality it is judged by, in words."""
        contact, which, number = self.broken
        if self.undetermined:
            return self.undetermined
        if which == _NOWHERE:
            return _UNEXPLAINED
        return f"{contact}: " + _WORDS[which].format(number)


def consistent(tried: Iterable[Candidate], tie: float) -> list[Candidate]:
    """Return the candidates that break no inequality by more than `tie`."""
    return [c for c in tried if c.violation <= tie]


def candidates(case: Case, options: Sequence[Sequence[str]]) -> list[Candidate]:
    """Solve every combination of `options` (states per contact).

    Where contacts can stand in for each other, a combination is judged by whether some forces in
    the cones explain its motion; of those with one motion, the one that keeps most contacts closed,
    then most of them pinned, stands for all.
    """
    return _solved_combinations(case, *_combinations(tuple(options), _loads(tuple(case.laws))))


def _solved_combinations(
    case: Case, combinations: Sequence[tuple[str, ...]], codes: Ints
) -> list[Candidate]:
    snapshot, laws, closed, still, scales, tie, _ = case
    edges = bounds(laws, snapshot)
    count, contacts = codes.shape
    status, verdicts = np.empty(count, np.int64), np.empty((count, 4))
    accelerations = np.empty((count, len(snapshot.forces)))
    forces = np.empty((count, contacts, 2))
    several, _ = solve_modes(
        snapshot.mass,
        snapshot.forces,
        snapshot.jacobians,
        snapshot.biases,
        edges,
        carriers(tuple(laws)),
        codes,
        _flags(tuple(shut and not law.coupling for shut, law in zip(closed, laws, strict=True))),
        _flags(tuple(still)),
        scales.force,
        scales.acceleration,
        status,
        accelerations,
        forces,
        verdicts,
        tie,
    )
    found: list[Candidate] = []
    judged = zip(combinations, status.tolist(), verdicts.tolist(), strict=True)
    for k, (states, outcome, (violation, contact, which, number)) in enumerate(judged):
        why = "" if outcome in _DETERMINED else _UNSOLVED.get(outcome, SINGULAR)
        broken = (laws[int(contact)].name if laws else "", int(which), number)
        violation = math.inf if why else violation
        found.append(Candidate(states, accelerations[k], forces[k], violation, broken, None, why))
    if several:
        _explain(case, edges, codes, found, np.flatnonzero(status == REDUNDANT).tolist())
    return found


def _refused(candidate: Candidate, why: str) -> Candidate:
    return candidate._replace(violation=math.inf, undetermined=why)


def _explain(
    case: Case,
    edges: Array,
    codes: Ints,
    found: list[Candidate],
    redundant: Sequence[int],
) -> None:
    """Replace candidates judged by their motion alone, by whether forces explain it."""
    snapshot, scales, tie = case.snapshot, case.scales, case.tie
    inward = 0.25 * max(tie, _EXACT) * scales.force
    bound = max(tie, _SAME_MOTION)
    moving = [(k, found[k]) for k in redundant if found[k].violation <= bound]
    if not moving:
        return
    moving.sort(key=lambda item: openness(item[1]))
    motions = np.array([one.accelerations for _, one in moving]).reshape(len(moving), -1)
    largest = _SAME_MOTION * np.maximum(scales.acceleration, np.abs(motions).max(1, initial=0.0))
    known = np.zeros(len(moving), np.bool_)
    failed: list[tuple[Candidate, Ints]] = []
    for place, (k, candidate) in enumerate(moving):
        if known[place]:
            found[k] = _refused(candidate, _LESS)
            continue
        given = None
        if not any(
            _within(codes[k], code) and same_motion(one, candidate, scales, _EXACT)
            for one, code in failed
        ):
            chosen = np.empty((len(codes[k]), 2))
            choose_edges(edges, codes[k], chosen)
            given = share(
                codes[k],
                snapshot,
                chosen,
                carriers(tuple(case.laws)),
                candidate.forces,
                inward,
                case.signs,
            )
        if given is None or given.violation > tie * scales.force:
            failed.append((candidate, codes[k]))
            found[k] = _refused(candidate, _UNEXPLAINED)
            continue
        outside = given.violation / scales.force
        shared = candidate._replace(forces=given.forces, share=given)
        if outside > shared.violation:
            shared = shared._replace(violation=outside, broken=("", _NOWHERE, outside))
        found[k] = shared
        known |= np.abs(motions - motions[place]).max(1, initial=0.0) <= largest


def _within(code: Ints, other: Ints) -> bool:
    """Return whether the forces of every contact in one mode are allowed in the other."""
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
    """Return every combination of states, in names and as the kernel numbers them.

    `loads` are rolling resistances and their contacts, which are open together.
    """
    combinations = tuple(
        states
        for states in product(*options)
        if all((states[i] in OPEN) == (states[carrier] in OPEN) for i, carrier in loads)
    )
    return combinations, np.array([[CODES[state] for state in s] for s in combinations], np.int64)


def same_motion(
    one: Candidate, other: Candidate, scales: Scales, tolerance: float = _SAME_MOTION
) -> bool:
    """Return whether two candidate modes give the same accelerations."""
    size = max(scales.acceleration, float(np.abs(other.accelerations).max()))
    difference = np.abs(one.accelerations - other.accelerations).max()
    return bool(difference <= tolerance * size)


def openness(candidate: Candidate) -> tuple[int, int, str]:
    """Most contacts closed first, then most of them pinned; names make ties deterministic."""
    states = candidate.states
    return (
        sum(state == "free" for state in states),
        sum(state not in STICKING for state in states),
        " ".join(states),
    )


def by_lemke(case: Case, options: Sequence[Sequence[str]]) -> list[Candidate]:
    """Solve the modes that Lemke's algorithm ends in (see `candidates`).

    The complementarity problem is in the contacts' accelerations and forces (Stewart and Trinkle's
    form; where there is slip, the force is along the edge that opposes it). It serves to find the
    modes only; they are solved and judged as any others. None: it found no solution.
    """
    snapshot, laws, closed, still, scales, *_ = case
    group = [i for i, shut in enumerate(closed) if shut]
    slides = np.array([0.0 if still[i] else np.sign(snapshot.contacts[i].slip) for i in group])
    # The first answer of a contact at rest is by its static friction.
    edges = np.empty((len(group), 2))
    sliding = np.where(slides > 0.0, SLIDE_PLUS, np.where(slides < 0.0, SLIDE_MINUS, PIN))
    choose_edges(cones(laws, snapshot.contacts)[group], sliding, edges)
    contacts, alone = delassus_matrix(snapshot.mass, snapshot.jacobians[group], snapshot.forces)
    free = snapshot.biases[group] + alone
    for k, i in enumerate(group):
        if laws[i].coupling:
            # Its limit is the normal force of a contact that nothing else presses.
            static, kinetic = snapshot.limits[i - len(laws)].tolist()
            limit, edges[k] = static if still[i] else kinetic, math.sqrt(0.5)
            contacts[2 * k, 2 * k] = 1.0
            if laws[i].carrier < 0:
                free[k, 0] = -limit
            elif laws[i].carrier in group:
                contacts[2 * k, 2 * group.index(laws[i].carrier)] = -limit
    solved, forces = forces_by_lemke(contacts, free, edges, slides)
    if not solved:
        return []
    after = free + (contacts @ forces.ravel()).reshape(-1, 2)
    at_rest = np.abs(after) <= _SAME_MOTION * max(scales.acceleration, float(np.abs(after).max()))
    least = _SAME_MOTION * float(np.abs(forces).max())
    found = []
    # What bears no force may be closed, what is on the edge of its cone may be pinned.
    for closer, firmer in product((True, False), repeat=2):
        states = [
            several[0] if len(several) == 1 or law.coupling else "free"
            for several, law in zip(options, laws, strict=True)
        ]
        for k, i in enumerate(group):
            V, H = forces[k].tolist()
            bears = max(V, abs(H)) > least
            if not at_rest[k, 0] or not (bears or closer):
                continue
            inside = edges[k, 1] * V - edges[k, 0] * abs(H) > least
            along = slides[k] or (-H if bears and at_rest[k, 1] else after[k, 1])
            sticking = next((state for state in options[i] if state in STICKING), "")
            if still[i] and at_rest[k, 1] and (firmer or inside) and sticking:
                states[i] = sticking
            elif laws[i].coupling:
                states[i] = "slip+" if along > 0.0 else "slip-"
            elif edges[k, 1] == 0.0:
                states[i] = "slide"
            else:
                states[i] = "slide+" if along > 0.0 else "slide-"
        for i, carrier in _loads(tuple(laws)):
            if states[carrier] in OPEN:
                states[i] = "free"
        if all(state in several for state, several in zip(states, options, strict=True)):
            found.append(tuple(states))
    combinations = tuple(dict.fromkeys(found))
    if not combinations:
        return []
    codes = np.array([[CODES[state] for state in states] for states in combinations])
    return _solved_combinations(case, combinations, codes)


_NAMES = {code: name for name, code in CODES.items() if name not in INACTIVE}


class ModeRules(NamedTuple):
    """Inputs of the classification of contacts."""

    allowed: Bools  # (c, 5): Whether a contact may be in the state of that code
    cones: Array  # (c, 2): cone_n, cone_t at rest
    # `near`, `creep`: A closed contact's gap and velocities that need no projection; tolerances
    near: float
    creep: float
    gap: float
    speed: float
    tie: float  # See `contacts.solvers.mode_solver.solve_modes`
    # Forces of a contact that comes to rest are no nearer to a bound (`ForceUncertainty`)
    force_uncertainty: float
    # `force`, `acceleration`: The scales
    force: float
    acceleration: float


@lru_cache(maxsize=1024)
def allowed(states: tuple[tuple[str, ...], ...]) -> Bools:
    """Return (c, 5): whether a contact's region has the state of that code."""
    allowed = np.zeros((len(states), len(_NAMES)), np.bool_)
    for i, several in enumerate(states):
        for name in several:
            if name not in INACTIVE:
                allowed[i, CODES[name]] = True
    return allowed


# In the scene's forces: beyond, a sliding contact may bear what only rounding keeps finite.
ENDLESS = 1e13
# More combinations of states are left to the laws.
_MAX_COMBINATIONS = 64


@kernel
def _is_near_bound(
    codes: Ints, kept: Ints, closed: Bools, still: Bools, verdicts: Array, uncertainty: float
) -> bool:
    """Return whether a mode in which a contact comes to rest is close to a bound of its forces."""
    for k in range(codes.shape[0]):
        if abs(verdicts[k, 0]) <= uncertainty:
            for c in range(codes.shape[1]):
                if codes[k, c] == PIN and kept[c] != PIN and closed[c] and still[c]:
                    return True
    return False


@kernel
def write_edges(cones: Array, numbers: Array, scalars: int, edges: Array) -> None:
    """Write the edges (c, 6) of friction cones, of those at rest and of the scene's numbers."""
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
    under_way: bool,
    kept: Ints,
    lowest: Array,
    taken: Ints,
) -> bool:
    """Classify every contact; False where that is not as simple.

    Parameters
    ----------
    rules : ModeRules
    numbers : (o,) array
        The scene's.
    n : int
        Number of coordinates.
    under_way, kept
        Whether a flow led here, and in which state (c,) it kept each contact; what is off stays so.
    lowest : (c,) array
        Of the gaps.
    taken : (c,) array
        To be filled: the state of every contact.
    """
    allowed, near, creep, slow, tie = (
        rules.allowed, rules.near, rules.creep, rules.speed, rules.tie,
    )  # fmt: skip
    contacts = taken.shape[0]
    at = n * n + n + 1
    biases_at = at + 2 * n * contacts
    scalars = biases_at + 2 * contacts
    closed, still = np.empty(contacts, np.bool_), np.empty(contacts, np.bool_)
    options, counts = np.empty((contacts, 5), np.int64), np.empty(contacts, np.int64)
    total = 1
    for c in range(contacts):
        if kept[c] == OFF_CODE:
            closed[c] = still[c] = False
            options[c, 0], counts[c] = FREE, 1
            continue
        place = scalars + SCALARS * c
        gap, rate, slip = numbers[place], numbers[place + 1], numbers[place + 2]
        shut = gap <= rules.gap
        if not gap >= lowest[c] or (shut and rate < -slow):
            return False
        lasting = kept[c] != FREE
        off = gap > near or abs(rate) > creep
        if lasting and (off or (kept[c] == PIN and abs(slip) > creep)):
            return False
        closed[c], still[c] = shut and rate <= slow, abs(slip) <= 2.0 * slow
        if not closed[c] and not allowed[c, FREE]:
            return False
        if closed[c] and off and not under_way:
            return False
        counts[c] = 0
        for s in range(5):
            if not closed[c]:
                free = s == FREE
            elif s in (FREE, SLIDE) or still[c]:
                free = allowed[c, s]
            else:
                free = allowed[c, s] and s == (SLIDE_PLUS if slip > 0.0 else SLIDE_MINUS)
            if free:
                options[c, counts[c]] = s
                counts[c] += 1
        total *= counts[c]
    if total == 0 or total > _MAX_COMBINATIONS:
        return False
    codes = np.empty((total, contacts), np.int64)
    for k in range(total):
        left = k
        for c in range(contacts):
            codes[k, c] = options[c, left % counts[c]]
            left //= counts[c]
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
        still,
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
    if _is_near_bound(codes, kept, closed, still, verdicts, rules.force_uncertainty):
        return False
    for c in range(contacts):
        for force in forces[agreeing, c]:
            if abs(force) > ENDLESS * rules.force:
                return False
        place = scalars + SCALARS * c
        taken[c] = OFF_CODE if kept[c] == OFF_CODE else codes[agreeing, c]
        if taken[c] != FREE and taken[c] != OFF_CODE:
            if abs(numbers[place]) > near or abs(numbers[place + 1]) > creep:
                return False
            if taken[c] == PIN and abs(numbers[place + 2]) > creep:
                return False
    return True


class ForceUncertainty(NamedTuple):
    """Uncertainty of friction forces where contacts come to rest."""

    at: Callable[[Array, float], Snapshot]  # The scene's numbers at a state, so much later
    setup: SceneSetup  # Of the run
    state: Array  # (2 n,): As far as the run knows it
    # How contacts were kept, as far as that was in no doubt: what was pinned does not come to rest
    sure: Key
    # Contacts of which a force has just passed its bound: that is in no doubt either
    fell: Collection[int] = ()

    def with_signs(self, which: Sequence[int]) -> ForceUncertainty:
        """Return the uncertainty of contacts and signs."""

        def at(state: Array, later: float) -> Snapshot:
            return with_signs(self.at(state, later), which)

        return self._replace(at=at, sure=(*self.sure, *(["locked"] * len(which))))

    def sticking(
        self, case: Case, options: Sequence[Sequence[str]], taken: Candidate
    ) -> Candidate | None:
        """Return the mode that may hold as well as not.

        None where what the run is off by decides nothing.
        """
        if not any(map(_comes_to_rest, options, self.sure)):
            return None
        near = self.setup.force_uncertainty
        for one in sorted(candidates(case._replace(tie=near), options), key=openness):
            if openness(one)[:2] > openness(taken)[:2]:
                break
            rests = any(map(_comes_to_rest, one.states, self.sure))
            close = rests and abs(one.violation) <= near and not self._passed(case, one)
            if close and max(abs(one.violation), case.tie) <= self._spread(case, one):
                return one
        return None

    def _passed(self, case: Case, one: Candidate) -> bool:
        """Return whether a mode is broken by a force that has just passed its bound."""
        fell = [*self.fell]
        if not fell:
            return False
        if one.share is not None:
            return True
        verdict, codes = np.full(4, -np.inf), np.array([CODES[one.states[i]] for i in fell])
        edges = np.empty((len(fell), 2))
        choose_edges(bounds(case.laws, case.snapshot)[fell], codes, edges)
        judge_forces(verdict, one.forces[fell], edges, codes, case.scales.force)
        return bool(verdict[0] > _NEARLY * case.tie)

    def _spread(self, case: Case, one: Candidate) -> float:
        """Return by how much, in the scales, what a mode breaks may be off."""
        setup, near, total = self.setup, self.setup.force_uncertainty, 0.0
        slow = setup.tolerances["speed"]
        off = slow / setup.scales.speed * np.maximum(setup.scales.sizes, np.abs(self.state))
        later = slow / setup.scales.acceleration
        moved = [(self.state + step, 0.0) for step in np.diag(off)]
        for state, time in [*moved, (self.state, later)]:
            there = case._replace(snapshot=self.at(state, time), tie=near)
            (found,) = candidates(there, [(role,) for role in one.states])
            total += near if found.undetermined else abs(found.violation - one.violation)
        return total


def _comes_to_rest(may: Collection[str] | str, was: str) -> bool:
    states = (may,) if isinstance(may, str) else may
    return was not in STICKING and any(state in STICKING for state in states)


# Enumeration can prove that there is no mode, one, or several; beyond this it costs too much.
_ENUMERATED = 4
# Up to here it is the last resort.
_ENUMERATED_LAST = 6
# Of the tie band: what rounding alone makes of an equality, as between balls that touch without
# load. A contact that has just been left is near the band's edge.
_NEARLY = 0.1
# Of the largest acceleration: two motions that differ by less are one, seen from an instant that a
# coarse tolerance has put beside the event. Rivals differ by a part of the whole.
_GOES_ON = 1e-3
# Of a contact's normal: what joints leave of it below this is rounding.
_IMPLIED = 1e-10
# Rejected modes that a message lists.
_MAX_LISTED = 6
_UNCHECKED = (
    f"more than {_ENUMERATED} contacts touch: Lemke's algorithm finds a mode, and does not check "
    "that it is the only one"
)


def _verdicts(case: Case, tried: Iterable[Candidate], taken: Candidate | None) -> dict[str, str]:
    laws, coefficients = case.laws, _coefficients(case)
    found = {_label(laws, c.states): _verdict(c, case.tie) + coefficients(c.states) for c in tried}
    if taken is not None:
        firmer = _firmer(case)
        found |= {
            _label(laws, c.states): c.reason + coefficients(c.states)
            for c in tried
            if c.violation > _NEARLY * case.tie and _held(c, taken, firmer)
        }
        found[_label(laws, taken.states)] = "taken" + coefficients(taken.states)
    return found


def _listed(refused: Mapping[str, str]) -> Iterator[str]:
    """Yield candidate modes with the reason against each; of many the first, and their number."""
    for label, why in [*refused.items()][:_MAX_LISTED]:
        contact = f"{label.partition(':')[0]}: "
        yield f"{label} fails, {why.removeprefix(contact) if ' ' not in label else why}"
    if len(refused) > _MAX_LISTED:
        yield f"{len(refused) - _MAX_LISTED} more modes fail"


def _coefficients(case: Case) -> Callable[[Sequence[str]], str]:
    """Return how to say which coefficients a mode uses, where a contact has two."""
    edges = cones(case.laws, case.snapshot.contacts)
    split = [k for k, row in enumerate(edges) if not (row[:2] == row[2:].reshape(2, 2)).all()]

    def words(states: Sequence[str]) -> str:
        said = []
        for k in split:
            if states[k] in ("pin", "slide+", "slide-"):
                kind = "static" if states[k] == "pin" else "kinetic"
                n, t = edges[k].reshape(3, 2)[("pin", "slide+", "slide-").index(states[k])]
                mu = math.inf if n == 0.0 else t / n
                said.append(f"{case.laws[k].name}: {kind} friction {mu:.7g}")
        return f" ({', '.join(said)})" if said else ""

    return words


class Choice(NamedTuple):
    """The candidate taken, what was considered, and what a reader must know."""

    taken: Candidate
    considered: Mapping[str, str]  # Mode -> why it was taken or not
    warning: str = ""  # "" or a sentence, such as for an indeterminate contact
    notes: tuple[str, ...] = ()  # What is to be known of the mode whenever it is taken
    near_bound: bool = (
        False  # Whether its forces may be beyond their bounds by what the run is off by
    )


class Before(NamedTuple):
    """Modes and forces before the instant."""

    # The mode that the state comes from: of several that agree the one is taken that moves on as it
    # did. None after an impact, and at the start
    mode: tuple[str, ...] | None = None
    # Contacts that may bear. What presses others against each other comes without cause
    bearing: frozenset[int] = frozenset()

    def is_mode(self, states: tuple[str, ...]) -> bool:
        """Return whether contacts, which signs may follow, are in the mode."""
        return self.mode is not None and states[: len(self.mode)] == self.mode

    @classmethod
    def flow(cls, roles: Roles, mode: tuple[str, ...] | None = None) -> Before:
        """Return what held in a flow."""
        return cls(mode, bearing(roles))


def choose(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    closed: Sequence[bool],
    scales: Scales,
    tie: float,
    still_below: float,
    before: Before | None = None,
    uncertainty: ForceUncertainty | None = None,
) -> Choice:
    """Return the mode that the state calls for.

    Violations up to `tie` (relative) are boundary cases, slip speeds up to `still_below` are zero.
    Where contacts share a load the mode of `before` goes on as long as some forces explain it,
    whatever else agrees, if these are of contacts that bore; without `before` all may.

    Raises `NoConsistentMode` or `AmbiguousMode` with every candidate and its reason. Raises
    `NonFinite` if the state has no finite forces.
    """
    count, resting = len(laws), signs_at_rest(snapshot, still_below)
    before = before or Before(bearing=frozenset(range(count)))
    if resting:
        snapshot, laws = with_signs(snapshot, resting), (*laws, *laws_of(snapshot, resting))
        closed, signs = [*closed, *([True] * len(resting))], range(count, len(laws))
        before = before._replace(bearing=before.bearing.union(signs))
        uncertainty = None if uncertainty is None else uncertainty.with_signs(resting)
    still = [abs(contact.slip) <= still_below for contact in snapshot.contacts]
    options = [*map(_options, snapshot.contacts, laws, closed, still)]
    for i, carrier in _loads(tuple(laws)):
        options[i] = options[i] if closed[carrier] else ("free",)
    case = Case(snapshot, laws, closed, still, scales, tie, len(resting))
    tried: list[Candidate] = []
    agreeing: list[Candidate] = []
    touching = sum(closed)
    many = touching > _ENUMERATED
    if many:
        tried = by_lemke(case, options)
        agreeing = consistent(tried, tie)
    if not agreeing and touching <= _ENUMERATED_LAST:
        many = False
        tried = candidates(case, options)
        agreeing = consistent(tried, tie)
    if not agreeing:
        if not (np.isfinite(snapshot.forces).all() and np.isfinite(snapshot.mass).all()):
            raise NonFinite(
                "forces or inertias have no finite value in this state; look for a logarithm, a "
                "root or a quotient without a value there"
            )
        refused = _verdicts(case, tried, None)
        only = "Lemke's algorithm tried only these modes" if many else ""
        why = "; ".join(filter(None, (*_listed(refused), only)))
        advice = "; ".join(_advice(laws, closed, tried))
        raise NoConsistentMode(". ".join(filter(None, (why, advice))), considered=refused)
    taken, warning = _rivals(_continuing(agreeing, tried, case, before), case, before)
    doubted = None if many or uncertainty is None else uncertainty.sticking(case, options, taken)
    if doubted is not None:
        taken, warning = doubted, ""
    # What a mode left open closes besides must not move away.
    if not warning and taken.violation >= -tie and any(_opens(taken, one, closed) for one in tried):
        warning = f"indeterminate: {OPEN_LOAD}; {_label(laws, taken.states)} taken"
    notes: tuple[str, ...] = (_UNCHECKED,) if many else ()
    if taken.share is not None:
        notes += _indeterminate(laws, taken.share)
    notes += _carried(snapshot, laws, closed, taken.states)
    if uncertainty is not None and doubted is not None:
        notes += tuple(
            f"{law.name} comes to rest with its friction at the bound, within the tolerance: it "
            "sticks, and might slip on at a smaller tolerance"
            for law, state, was in zip(laws, taken.states, uncertainty.sure, strict=True)
            if _comes_to_rest(state, was)
        )
    considered = LazyMapping(partial(_verdicts, case, tried, taken))
    if snapshot.signs is not None:
        taken = taken.of_contacts(count, [snapshot.signs.frictions[k] for k in resting])
    return Choice(taken, considered, warning, notes, doubted is not None)


def _continuing(
    agreeing: list[Candidate],
    tried: Iterable[Candidate],
    case: Case,
    before: Before,
) -> list[Candidate]:
    """Return those of the candidates that agree that move on as the mode left, or all.

    Where friction presses a contact into its surface, others agree at forces without cause; none of
    them is taken because something else comes to its bound.
    """
    left = None
    if len(agreeing) > 1 and before.mode is not None:
        of_mode = (c for c in (*agreeing, *tried) if before.is_mode(c.states))
        left = next((c for c in of_mode if not c.undetermined), None)
    if left is None or (left.share is not None and not _bearing(left) <= before.bearing):
        return agreeing
    if left.violation > _NEARLY * case.tie:
        firmer = _firmer(case)
        if any(_held(left, c, firmer) for c in agreeing):
            # Static friction has just been exceeded, and kinetic friction is less.
            return agreeing
    return [c for c in agreeing if same_motion(c, left, case.scales, _GOES_ON)] or agreeing


def _rivals(agreeing: Sequence[Candidate], case: Case, before: Before) -> tuple[Candidate, str]:
    """Return the one taken of the candidates that agree with the state, and why not another.

    Raises `AmbiguousMode` where they move it apart, and all keep every contact closed.
    """
    _, laws, closed, _, scales, tie, _ = case
    taken = agreeing[0]
    if len(agreeing) == 1:
        return taken, ""
    clear = [c for c in agreeing if c.violation <= _NEARLY * tie]
    for one in clear:
        if one.share is not None and before.is_mode(one.states):
            return _without_new_loads(one, clear, case, before.bearing)
    # What static friction holds does not begin to slip because something else does.
    firmer, held = _firmer(case), clear
    if firmer:
        lost = [any(_held(d, c, firmer) > _held(c, d, firmer) for d in clear) for c in clear]
        held = [c for c, slips in zip(clear, lost, strict=True) if not slips]
    taken = min(held or clear or agreeing, key=openness)
    # On the edge of its inequalities (a massless body that needs no force) it is no rival.
    sure = [c for c in agreeing if c.violation < -tie] if taken.violation < -tie else []
    others = [
        c
        for c in sure
        if c is not taken and not same_motion(c, taken, scales) and not _held(taken, c, firmer)
    ]
    if not others and taken.share is not None:
        # What lies along a surface is on its edge wherever it goes.
        new = _bearing(taken) - before.bearing
        less = [c for c in clear if _bearing(c) < _bearing(taken) <= _bearing(c) | new]
        others = [c for c in less if not same_motion(c, taken, scales, _GOES_ON)]
    if not others:
        return taken, ""
    labels = ", ".join(_label(laws, c.states) for c in [taken, *others])
    opened = [
        c
        for c in [taken, *others]
        if any(
            state == "free" and touching for state, touching in zip(c.states, closed, strict=True)
        )
    ]
    if not opened:
        raise AmbiguousMode(f"several modes agree with the state and move it differently: {labels}")
    # Painleve's indeterminate case: contact could also hold, at a force without cause, and a
    # mode agrees without it whatever else lifts off.
    bearing = [_bearing(c) for c in opened]
    free = [c for c, own in zip(opened, bearing, strict=True) if not any(b < own for b in bearing)]
    taken = min(free, key=openness)
    return (
        taken,
        f"indeterminate: {labels} all agree with the state; {_label(laws, taken.states)} taken",
    )


def _held(taken: Candidate, other: Candidate, firmer: Sequence[int]) -> bool:
    """Return whether static friction holds what kinetic friction would let slip."""
    return any(
        taken.states[k] in STICKING and other.states[k] not in (*STICKING, *OPEN) for k in firmer
    )


def _firmer(case: Case) -> Sequence[int]:
    """Return the contacts and couplings whose static friction exceeds their kinetic friction."""
    edges = bounds(case.laws, case.snapshot)
    mu = edges[:, 1::2] / np.maximum(edges[:, ::2], np.finfo(float).tiny)
    coupled = np.array([law.coupling for law in case.laws], np.bool_)
    more = np.where(coupled, edges[:, 0] > edges[:, 1], (mu[:, :1] > mu[:, 1:]).any(1))
    firmer: list[int] = np.flatnonzero(more).tolist()
    return firmer


def _without_new_loads(
    one: Candidate, agreeing: Sequence[Candidate], case: Case, bore: frozenset[int]
) -> tuple[Candidate, str]:
    """Return the mode that goes on where contacts share a load, and what is to be known of it.

    Forces that are there may hold what else would move, as in what is wedged. A contact that bore
    nothing presses against others only where no mode agrees without it: a block that is pushed
    along a slot does not jam between its sides. The smallest forces may press it from both sides
    before it would slip, as they do at a friction above 1: then it is held, and that is told.
    """
    new = _bearing(one) - bore
    if not new:
        return one, ""
    jacobians = case.snapshot.jacobians
    without = [c for c in agreeing if _bearing(c) <= bore]
    moving = [c for c in without if rank(c.states, jacobians) < rank(one.states, jacobians)]
    if len(moving) == len(without):
        return min(moving, key=openness, default=one), ""
    pressing = [i for i in sorted(_bearing(one)) if not case.laws[i].coupling]
    edges = np.empty((len(one.states), 2))
    chosen = np.array([CODES[state] for state in one.states])
    choose_edges(cones(case.laws, case.snapshot.contacts), chosen, edges)
    both = prestressed_contacts(jacobians, edges, pressing)
    if not new <= both:
        return one, ""
    names = ", ".join(case.laws[i].name for i in sorted(both))
    return one, (
        f"indeterminate: {names} may be wedged against each other by any force; the run takes the "
        "smallest forces, and their friction may hold the body"
    )


def _advice(
    laws: Sequence[ContactLaw], closed: Sequence[bool], tried: Iterable[Candidate]
) -> Iterator[str]:
    """Yield what in the declaration keeps a state from having a mode, and what to do."""
    rough = [
        law.name
        for law, shut in zip(laws, closed, strict=True)
        if shut and "pin" in law.states and not any(s in SLIDING for s in law.states)
    ]
    if rough:
        yield (
            f"Add slide, with a friction, to the modes of {', '.join(rough)}: a point that may not "
            "slip can need a force that pulls (McGeer's paradox)"
        )
    unlisted = False
    for law, shut in zip(laws, closed, strict=True):
        kinds = {declared_state(state) for state in law.states}
        wanted = ("free", "slide", "pin") if law.cone_t > 0.0 else ("free", "slide")
        lacks = [kind for kind in wanted if kind not in kinds]
        if shut and lacks and law.name not in rough and not law.coupling:
            unlisted = True
            yield f"{law.name} has no {' and no '.join(lacks)} among its modes: add it"
    if not unlisted and any(c.undetermined == SINGULAR for c in tried):
        yield "a body that no contact holds has no mass or no inertia: add it"


def _bearing(candidate: Candidate) -> frozenset[int]:
    return frozenset(i for i, state in enumerate(candidate.states) if state not in OPEN)


def _opens(taken: Candidate, other: Candidate, closed: Sequence[bool]) -> bool:
    """Return whether the chosen mode opens contacts that a rejected mode would keep closed.

    Or lets couplings slip that it would keep locked.
    """
    if other.undetermined != OPEN_LOAD:
        return False
    pairs = zip(taken.states, other.states, closed, strict=True)
    return all(
        mine == theirs or (shut and mine == "free") or (mine in SLIPPING and theirs == "locked")
        for mine, theirs, shut in pairs
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
    """Tell of contacts that joints hold closed: no motion opens them, and any force would do."""
    if snapshot.held is None:
        return ()
    left = np.abs(snapshot.jacobians[:, 0]).max(axis=1, initial=0.0)
    whole = np.abs(snapshot.whole.jacobians[:, 0]).max(axis=1, initial=0.0)
    names = [
        law.name
        for law, shut, state, here, all_of_it in zip(laws, closed, states, left, whole, strict=True)
        if shut and state in OPEN and here <= _IMPLIED * all_of_it and not law.coupling
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
        off = DISENGAGED if law.coupling else OFF
        return (off if contact.gap == math.inf else "free",)
    return _open(law.states, contact.slip > 0.0, at_rest)


@lru_cache(maxsize=1024)
def _open(states: tuple[str, ...], forward: bool, at_rest: bool) -> tuple[str, ...]:
    """Return the states that a touching contact may be in, from the sense of its slip."""
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
