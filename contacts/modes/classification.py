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
from dataclasses import replace
from functools import partial
from itertools import compress
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, bounds, cones, coupling_law
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import EDGES, PerContact, Snapshot
from contacts.modes.candidates import (
    NEGLIGIBLE_TIE,
    OPEN_LOAD,
    SAME_MOTION,
    SINGULAR,
    Candidate,
    Case,
    candidates,
    closedness_key,
    lemke_candidates,
    resistance_pairs,
    same_motion,
)
from contacts.modes.load_sharing import bearing_contacts, prestressed_contacts, rank
from contacts.scene.couplings import LIMIT_MARGINS
from contacts.scene.modes import FORCE_MARGINS, OWN
from contacts.solvers.mode_solver import choose_edges, judge_forces
from contacts.states import (
    CODES,
    COUPLING_STATES,
    DISENGAGED,
    INACTIVE,
    OFF,
    OPEN,
    SLIDING,
    SLIPPING,
    STICKING,
    declared_state,
    undetermined_warning,
)
from statechart.arrays import Array, Bools
from statechart.automaton.lazy import LazyMapping
from statechart.automaton.trace import Key, Roles
from statechart.errors import AmbiguousMode, NoConsistentMode, NonFinite


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
            return _with_signs(self.at(state, later), which)

        return self._replace(at=at, certain_modes=(*self.certain_modes, *(["locked"] * len(which))))

    def sticking(
        self, case: Case, options: Sequence[Sequence[str]], taken: Candidate
    ) -> Candidate | None:
        """Return a mode with more sticking that is consistent within the error, or None."""
        if not any(map(_comes_to_rest, options, self.certain_modes)):
            return None
        tolerance = self.setup.force_uncertainty
        found = sorted(candidates(case._replace(tie=tolerance), options), key=closedness_key)
        for candidate in found:
            if closedness_key(candidate)[:2] > closedness_key(taken)[:2]:
                break
            excess = abs(candidate.violation)
            rests = any(map(_comes_to_rest, candidate.states, self.certain_modes))
            if not rests or excess > tolerance or self._has_just_failed(case, candidate):
                continue
            if max(excess, case.tie) <= self._spread(case, candidate):
                return candidate
        return None

    def _has_just_failed(self, case: Case, candidate: Candidate) -> bool:
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
        return bool(verdict[0] > NEGLIGIBLE_TIE * case.tie)

    def _spread(self, case: Case, candidate: Candidate) -> float:
        """Return the uncertainty of the violation of a mode, in the scales."""
        setup, tolerance, total = self.setup, self.setup.force_uncertainty, 0.0
        slow, sizes = setup.tolerances["speed"], setup.scales.sizes
        errors = slow / setup.scales.speed * np.maximum(sizes, np.abs(self.state[: len(sizes)]))
        steps = errors[:, None] * np.eye(len(sizes), len(self.state))
        shifted_states = [(self.state + step, 0.0) for step in steps]
        for state, time in [*shifted_states, (self.state, slow / setup.scales.acceleration)]:
            shifted = case._replace(snapshot=self.at(state, time), tie=tolerance)
            (solved,) = candidates(shifted, [(role,) for role in candidate.states])
            change = abs(solved.violation - candidate.violation)
            total += tolerance if solved.undetermined else change
        return total


def _comes_to_rest(may: Collection[str] | str, was: str) -> bool:
    states = (may,) if isinstance(may, str) else may
    return was not in STICKING and any(state in STICKING for state in states)


# Contacts up to which all modes are enumerated; with more, Lemke's algorithm comes first.
_MAX_ENUMERATED = 4
# Contacts up to which enumeration is the fallback of Lemke's algorithm.
_MAX_ENUMERATED_LAST = 6
# Relative difference of accelerations up to which a motion continues, at an event located with a
# coarse tolerance. Rival motions differ by a multiple of this.
_CONTINUES = 1e-3
# The same of motions with a constraint that others imply to 1e-9 (`contacts.solvers.mode_solver`).
_SAME_BY_SHARES = 10.0 * SAME_MOTION
# Rows of a normal reduced by the joints below this part are round-off.
_IMPLIED = 1e-10
# Tolerance of a force that starts on the boundary of its cone, relative: its margin may stay zero,
# and interval arithmetic cannot prove that.
_BOUNDARY = 1e-9
# Rejected modes listed in a message.
_MAX_LISTED = 6
_UNCHECKED = (
    f"more than {_MAX_ENUMERATED} contacts touch: Lemke's algorithm finds a mode, and does not "
    "check that it is the only one"
)


def _verdicts(case: Case, tried: Iterable[Candidate], taken: Candidate | None) -> dict[str, str]:
    laws, coefficients, firmer = case.laws, _coefficients(case), _more_sticking(case)
    verdicts = {}
    for c in tried:
        held = taken is not None and _is_held_by_friction(c, taken, firmer)
        exceeded = held and c.violation > NEGLIGIBLE_TIE * case.tie
        why = c.reason if exceeded else _verdict(c, case.tie)
        verdicts[_label(laws, c.states)] = why + coefficients(c.states)
    if taken is not None:
        verdicts[_label(laws, taken.states)] = "taken" + coefficients(taken.states)
    return verdicts


def _rejections(refused: Mapping[str, str]) -> Iterator[str]:
    """Yield the first rejected modes with reasons, and the number of the others."""
    for label, why in [*refused.items()][:_MAX_LISTED]:
        contact = "" if " " in label else f"{label.partition(':')[0]}: "
        yield f"{label or 'free motion'} fails, {why.removeprefix(contact)}"
    if len(refused) > _MAX_LISTED:
        yield f"{len(refused) - _MAX_LISTED} more modes fail"


def _coefficients(case: Case) -> Callable[[Sequence[str]], str]:
    """Return a function that formats the coefficients of a mode, for contacts with two."""
    edges = cones(case.laws, case.snapshot.contacts)
    split = [k for k, row in enumerate(edges) if not (row[:2] == row[2:].reshape(2, 2)).all()]

    def format_coefficients(states: Sequence[str]) -> str:
        phrases, closed = [], ("pin", "slide+", "slide-")
        for k in (k for k in split if states[k] in closed):
            n, t = edges[k].reshape(3, 2)[closed.index(states[k])]
            kind, mu = "static" if states[k] == "pin" else "kinetic", t / n if n else math.inf
            phrases.append(f"{case.laws[k].name}: {kind} friction {mu:.7g}")
        return f" ({', '.join(phrases)})" if phrases else ""

    return format_coefficients


class Choice(NamedTuple):
    """Selected candidate with its explanation."""

    taken: Candidate
    considered: Mapping[str, str]  # Mode -> why it was taken or not
    warning: str = ""  # "" or a sentence, such as for an indeterminate contact
    notes: tuple[str, ...] = ()  # Remarks on the mode, given once per run
    # Margins of forces on the boundary of their cones -> their tolerance in the flow
    tolerances: Mapping[str, float] = MappingProxyType({})
    near_bound: bool = False  # Forces may violate their bounds within the error of the run

    @property
    def roles(self) -> Roles:
        """The roles in which contacts move."""
        return self.taken.roles


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
        return cls(mode, bearing_contacts(roles))


def choose(
    setup: SceneSetup,
    snapshot: Snapshot,
    closed: Sequence[bool],
    before: Before | None = None,
    uncertainty: ForceUncertainty | None = None,
) -> Choice:
    """Select the consistent mode of a state.

    If contacts share a load, the mode of `before` continues as long as some forces of contacts that
    were loaded explain it; without `before` all may be loaded.

    Raises `NoConsistentMode` or `AmbiguousMode` with every candidate and its reason, and
    `NonFinite` if the state has no finite forces.
    """
    laws, scales = setup.contacts, setup.scales
    tie, slip_tolerance = setup.tie, setup.slip_tolerance
    count, resting = len(laws), _signs_at_rest(snapshot, slip_tolerance)
    before = before or Before(bearing=frozenset(range(count)))
    if resting:
        snapshot, laws = _with_signs(snapshot, resting), (*laws, *_laws_of(snapshot, resting))
        closed, signs = [*closed, *([True] * len(resting))], range(count, len(laws))
        before = before._replace(bearing=before.bearing.union(signs))
        uncertainty = None if uncertainty is None else uncertainty.with_signs(resting)
    at_rest = [abs(contact.slip) <= slip_tolerance for contact in snapshot.contacts]
    options = [*map(_options, snapshot.contacts, laws, closed, at_rest)]
    for i, carrier in resistance_pairs(tuple(laws)):
        options[i] = options[i] if closed[carrier] else ("free",)
    case = Case(snapshot, laws, closed, at_rest, scales, tie, len(resting))
    tried: list[Candidate] = []
    agreeing: list[Candidate] = []
    touching = sum(closed)
    by_pivoting = touching > _MAX_ENUMERATED
    if by_pivoting:
        tried = lemke_candidates(case, options)
        agreeing = [c for c in tried if c.violation <= tie]
    if not agreeing and touching <= _MAX_ENUMERATED_LAST:
        by_pivoting = False
        tried = candidates(case, options)
        agreeing = [c for c in tried if c.violation <= tie]
    if not agreeing:
        if not (np.isfinite(snapshot.forces).all() and np.isfinite(snapshot.mass).all()):
            raise NonFinite(
                "forces or inertias have no finite value in this state; look for a logarithm, a "
                "root or a quotient without a value there"
            )
        refused = _verdicts(case, tried, None)
        note = "Lemke's algorithm tried only these modes" if by_pivoting else ""
        reasons = "; ".join(filter(None, (*_rejections(refused), note)))
        advice = "; ".join(_advice(case, tried, setup.coordinates))
        raise NoConsistentMode(". ".join(filter(None, (reasons, advice))), considered=refused)
    continuing = _continuing_candidates(agreeing, tried, case, before)
    taken, warning = _select_candidate(continuing, case, before)
    uncertain = None
    if uncertainty is not None and not by_pivoting:
        uncertain = uncertainty.sticking(case, options, taken)
    if uncertain is not None:
        taken, warning = uncertain, ""
    # A rejected mode of undetermined load may close contacts that the selected mode opens.
    doubtful = not warning and taken.violation >= -tie
    if doubtful and any(_opens_more(taken, rejected, closed) for rejected in tried):
        warning = f"indeterminate: {OPEN_LOAD}; the run takes {_label(laws, taken.states)}"
    notes: tuple[str, ...] = (_UNCHECKED,) if by_pivoting else ()
    if taken.share is not None:
        zones = zip(laws, taken.share.zones, strict=True)
        notes += (undetermined_warning([law.name for law, zone in zones if zone != OWN]),)
    notes += _note_held_contacts(snapshot, laws, closed, taken.states)
    if uncertainty is not None and uncertain is not None:
        notes += tuple(
            f"{law.name} comes to rest with its friction at the bound, within the tolerance: it "
            "sticks, and might slip on at a smaller tolerance"
            for law, state, was in zip(laws, taken.states, uncertainty.certain_modes, strict=True)
            if _comes_to_rest(state, was)
        )
    considered = LazyMapping(partial(_verdicts, case, tried, taken))
    tolerances = {}
    for k in () if taken.share is None else taken.share.bounded:
        upper, lower = LIMIT_MARGINS if laws[k].coupling else FORCE_MARGINS[1:]
        margin = upper if taken.forces[k, 1] > 0.0 else lower
        tolerances[f"{laws[k].name}.{margin}"] = _BOUNDARY * scales.force
    if snapshot.signs is not None:
        taken = taken.of_contacts(count, [snapshot.signs.frictions[k] for k in resting])
    return Choice(taken, considered, warning, notes, tolerances, uncertain is not None)


def _continuing_candidates(
    agreeing: list[Candidate], tried: Iterable[Candidate], case: Case, before: Before
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
    if previous.violation > NEGLIGIBLE_TIE * case.tie:
        firmer = _more_sticking(case)
        if any(_is_held_by_friction(previous, c, firmer) for c in agreeing):
            # Static friction has just been exceeded, and kinetic friction is less.
            return agreeing
    return [c for c in agreeing if same_motion(c, previous, case.scales, _CONTINUES)] or agreeing


def _select_candidate(
    agreeing: Sequence[Candidate], case: Case, before: Before
) -> tuple[Candidate, str]:
    """Select one of several consistent candidates; the second value is "" or a warning.

    Raises `AmbiguousMode` if their motions differ and all keep every contact closed.
    """
    _, laws, closed, _, scales, tie, _ = case
    taken = agreeing[0]
    if len(agreeing) == 1:
        return taken, ""
    clear = [c for c in agreeing if c.violation <= NEGLIGIBLE_TIE * tie]
    for candidate in clear:
        if candidate.share is not None and before.is_mode(candidate.states):
            return _without_new_loads(candidate, clear, case, before.bearing)
    # A contact held by static friction does not start to slip because another does.
    firmer, holding = _more_sticking(case), clear
    if firmer:
        holding = [c for c in clear if not any(_slips_more(c, d, firmer) for d in clear)]
    taken = min(holding or clear or agreeing, key=closedness_key)
    # A candidate on the boundary of its inequalities (an unloaded massless body) is no rival.
    certain = [c for c in agreeing if c.violation < -tie] if taken.violation < -tie else []
    same = SAME_MOTION if taken.share is None else _SAME_BY_SHARES
    rivals = [c for c in certain if c is not taken and not same_motion(c, taken, scales, same)]
    rivals = [c for c in rivals if not _slips_more(c, taken, firmer)]
    if not rivals and taken.share is not None:
        # With a shared load, candidates on the boundary are rivals, too.
        new = _bearing(taken) - before.bearing
        less = [c for c in clear if _bearing(c) < _bearing(taken) <= _bearing(c) | new]
        rivals = [c for c in less if not same_motion(c, taken, scales, _CONTINUES)]
        rivals = [c for c in rivals if not _slips_more(c, taken, firmer)]
    starting = _at_static_friction([taken, *rivals], case) if rivals and firmer else []
    if not rivals or len(starting) == 1:
        return (starting or [taken])[0], ""
    labels = ", ".join(_label(laws, c.states) for c in [taken, *rivals])
    opened = [c for c in [taken, *rivals] if "free" in compress(c.states, closed)]
    if not opened:
        raise AmbiguousMode(
            f"the declaration does not decide between {labels}; remove one of them from the modes "
            "of its contact, or change friction or the start"
        )
    # Painleve's indeterminate case: a contact could also stay closed with a force without cause.
    # The candidates with the smallest sets of loaded contacts do without.
    minimal = [c for c in opened if not any(_bearing(d) < _bearing(c) for d in opened)]
    taken = min(minimal, key=closedness_key)
    run_takes = f"the run takes {_label(laws, taken.states)}"
    return taken, f"indeterminate: {labels} all agree with the state; {run_takes}"


def _is_held_by_friction(taken: Candidate, other: Candidate, firmer: Sequence[int]) -> bool:
    """Return whether static friction holds a contact that slips in the other mode."""
    return any(
        taken.states[k] in STICKING and other.states[k] not in (*STICKING, *OPEN) for k in firmer
    )


def _slips_more(c: Candidate, d: Candidate, firmer: Sequence[int]) -> bool:
    """Return whether friction holds a contact in d that slips in c, and none the other way."""
    return _is_held_by_friction(d, c, firmer) > _is_held_by_friction(c, d, firmer)


def _at_static_friction(found: Sequence[Candidate], case: Case) -> list[Candidate]:
    """Return the candidates in which static friction does not hold the slips that begin."""
    snapshot, limits = case.snapshot, case.snapshot.limits.copy()
    rests = np.array(case.at_rest, np.bool_)[len(case.at_rest) - len(limits) :]
    limits[rests, 1] = limits[rests, 0]
    pairs = zip(snapshot.contacts, case.at_rest, strict=True)
    contacts = tuple([c._replace(edges=None) if still else c for c, still in pairs])
    static = case._replace(snapshot=snapshot._replace(contacts=contacts, limits=limits))
    alone = ((c, candidates(static, [(state,) for state in c.states])) for c in found)
    return [c for c, solved in alone if any(one.violation <= case.tie for one in solved)]


def _more_sticking(case: Case) -> Sequence[int]:
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
        return min(moving, key=closedness_key, default=candidate), ""
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


def _advice(case: Case, tried: Iterable[Candidate], coordinates: Sequence[str]) -> Iterator[str]:
    """Yield sentences on how to change a declaration whose state has no consistent mode."""
    laws = [*compress(case.laws, case.closed)]
    rough = [x.name for x in laws if "pin" in x.states and not {*SLIDING}.intersection(x.states)]
    if rough:
        yield (
            f"Add slide, with a friction, to the modes of {', '.join(rough)}: a point that may not "
            "slip can need a force that pulls (McGeer's paradox)"
        )
    unlisted = False
    for law in laws:
        kinds = {declared_state(state) for state in law.states}
        expected = ("free", "slide", "pin") if law.cone_t > 0.0 else ("free", "slide")
        missing = [kind for kind in expected if kind not in kinds]
        if missing and law.name not in rough and not law.coupling:
            unlisted = True
            yield f"{law.name} has no {' and no '.join(missing)} among its modes: add it"
    if not unlisted and any(c.undetermined == SINGULAR for c in tried):
        free = " and ".join(compress(coordinates, _massless(case.snapshot))) or "a body"
        yield (
            f"No mass or inertia moves with {free} while no contact holds it: add it to its body"
        )


def _massless(snapshot: Snapshot) -> Bools:
    """Return a mask of the coordinates in the null space of the mass matrix."""
    mass, reduction = snapshot.mass, snapshot.reduction
    diagonal = np.diag(mass)
    units = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(units[:, None] * mass * units)
    motions = units[:, None] * vectors[:, values <= _IMPLIED]
    if reduction is not None:
        motions = reduction.basis @ motions
    sizes = np.abs(motions).max(axis=1, initial=0.0)
    return sizes > _IMPLIED * sizes.max(initial=0.0)


def _bearing(candidate: Candidate) -> frozenset[int]:
    return frozenset(i for i, state in enumerate(candidate.states) if state not in OPEN)


def _opens_more(taken: Candidate, other: Candidate, closed: Sequence[bool]) -> bool:
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


def _note_held_contacts(
    snapshot: Snapshot, laws: Sequence[ContactLaw], closed: Sequence[bool], states: tuple[str, ...]
) -> tuple[str, ...]:
    """Return a note on contacts that joints hold closed, whose forces are undetermined."""
    if snapshot.reduction is None:
        return ()
    reduced = np.abs(snapshot.jacobians[:, 0]).max(axis=1, initial=0.0)
    unreduced = np.abs(snapshot.unreduced.jacobians[:, 0]).max(axis=1, initial=0.0)
    shut = [is_closed and state in OPEN for is_closed, state in zip(closed, states, strict=True)]
    idle = np.array(shut, np.bool_) & (reduced <= _IMPLIED * unreduced)
    names = [law.name for law in compress(laws, idle) if not law.coupling]
    if not names:
        return ()
    return (
        f"joints hold {', '.join(names)} closed, so that the normal force is undetermined: the "
        "run lets joints bear all of it, without friction there",
    )


def _options(
    contact: PerContact, law: ContactLaw, touching: bool, at_rest: bool
) -> tuple[str, ...]:
    """Return the possible states of a contact: with slip those of its direction."""
    if not touching:
        off_name = DISENGAGED if law.coupling else OFF
        return (off_name if contact.gap == math.inf else "free",)
    direction = ("slide+", "slip+") if contact.slip > 0.0 else ("slide-", "slip-")
    return tuple(
        state
        for state in law.states
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


def _signs_at_rest(snapshot: Snapshot, still_below: float) -> list[int]:
    if snapshot.signs is None:
        return []
    arguments, slips, _, limits = snapshot.signs.numbers.T
    slow = np.abs(slips) <= still_below * np.abs(snapshot.signs.rows).max(axis=1, initial=0.0)
    # A preload holds in its place only; friction has the slip as argument.
    rates = np.array([one.argument == one.slip for one in snapshot.signs.frictions])
    there = rates | (arguments == 0.0)
    found: list[int] = np.flatnonzero(slow & there & (limits > 0.0)).tolist()
    return found


def _laws_of(snapshot: Snapshot, which: Sequence[int]) -> tuple[ContactLaw, ...]:
    assert snapshot.signs is not None
    names = [snapshot.signs.frictions[k].name for k in which]
    return tuple(coupling_law(name, COUPLING_STATES) for name in names)


def _with_signs(snapshot: Snapshot, which: Sequence[int]) -> Snapshot:
    """Return the snapshot with signs as its last couplings, and without their forces."""
    assert snapshot.signs is not None
    arguments, _, biases, limits = snapshot.signs.numbers[which].T
    rows, reduction = snapshot.signs.rows[which], snapshot.reduction
    effect = np.sign(arguments) * limits
    if reduction is None:
        return _add_couplings(snapshot, rows, biases, limits, effect)
    whole = _add_couplings(snapshot.unreduced, rows, biases, limits, effect)
    biases, rows = biases + rows @ reduction.drift, rows @ reduction.basis
    extended = _add_couplings(snapshot, rows, biases, limits, effect)
    return extended._replace(reduction=replace(reduction, unreduced=whole))


def _add_couplings(
    snapshot: Snapshot, rows: Array, biases: Array, limits: Array, effect: Array
) -> Snapshot:
    jacobians = np.stack([np.zeros_like(rows), rows], axis=1)
    contacts = [PerContact._make((*[0.0] * EDGES, None))] * len(rows)
    return snapshot._replace(
        forces=snapshot.forces + effect @ rows,
        contacts=(*snapshot.contacts, *contacts),
        jacobians=np.concatenate([snapshot.jacobians, jacobians]),
        biases=np.concatenate([snapshot.biases, np.stack([0.0 * biases, biases], axis=1)]),
        limits=np.concatenate([snapshot.limits, np.stack([limits, limits], axis=1)]),
    )
