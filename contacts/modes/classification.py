"""From a state to the mode of every contact, and why: complementarity on accelerations.

The answer depends on the state alone, never on which event fired. Up to four contacts that touch,
every mode is tried (enumeration is the one method that can prove that there is none, one, or
several), and judged by its own inequalities; above, Lemke's algorithm finds one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, cones
from contacts.dynamics.scales import Scales
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.modes.candidates import (
    OPEN_LOAD,
    SINGULAR,
    Candidate,
    Case,
    Undetermined,
    by_lemke,
    candidates,
    consistent,
    openness,
    same_motion,
)
from contacts.modes.force_uncertainty import ForceUncertainty
from contacts.modes.load_sharing import Share, bearing, pressed_together, rank
from contacts.scene.modes import OWN
from contacts.states import OFF, OPEN, SLIDING, declared_state, undetermined
from statechart.automaton.lazy import LazyMapping
from statechart.automaton.trace import Roles
from statechart.errors import AmbiguousMode, NoConsistentMode, NonFinite

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
_UNCHECKED = (
    f"where more than {_ENUMERATED} contacts touch, Lemke's algorithm finds the mode: "
    "uniqueness not checked"
)


def _verdicts(
    laws: Sequence[ContactLaw],
    tried: Iterable[Candidate | Undetermined],
    taken: Candidate | None,
    tie: float,
) -> dict[str, str]:
    found = {_label(laws, c): _verdict(c, tie) for c in tried}
    return found if taken is None else {**found, _label(laws, taken): "taken"}


class Choice(NamedTuple):
    """The candidate taken, what was considered, and what a reader must know."""

    taken: Candidate
    considered: Mapping[str, str]  # Mode -> why it was taken or not
    warning: str = ""  # "" or a sentence, such as for an indeterminate contact
    notes: tuple[str, ...] = ()  # What is to be known of the mode whenever it is taken
    doubted: bool = False  # Whether its forces may be beyond their bounds by what the run is off by


class Before(NamedTuple):
    """Modes and forces before the instant."""

    # The mode that the state comes from: of several that agree the one is taken that moves on as it
    # did. None after an impact, and at the start
    mode: tuple[str, ...] | None = None
    # Contacts that may bear. What presses others against each other comes without cause
    bearing: frozenset[int] = frozenset()

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

    Raises
    ------
    NoConsistentMode, AmbiguousMode
        With every candidate and its reason.
    NonFinite
        If the state has no finite forces.
    """
    still = [abs(contact.slip) <= still_below for contact in snapshot.contacts]
    options = [*map(_options, snapshot.contacts, laws, closed, still)]
    case = Case(snapshot, laws, closed, still, scales, tie)
    before = before or Before(bearing=frozenset(range(len(laws))))
    tried: Iterable[Candidate | Undetermined] = ()
    count, agreeing = sum(closed), []
    many = count > _ENUMERATED
    if many:
        tried = by_lemke(case, options)
        agreeing = consistent(tried, tie)
    if not agreeing and count <= _ENUMERATED_LAST:
        many = False
        tried = candidates(case, options)
        agreeing = consistent(tried, tie)
    if not agreeing:
        if not (np.isfinite(snapshot.forces).all() and np.isfinite(snapshot.mass).all()):
            raise NonFinite(
                "forces or inertias have no finite value in this state; look for a logarithm, a "
                "root or a quotient without a value there"
            )
        refused = _verdicts(laws, tried, None, tie)
        only = "only modes that Lemke's algorithm ends in were tried" if many else ""
        words = (
            "no mode of the contacts agrees with the state",
            *(f"{label}: {why}" for label, why in refused.items()),
            only,
            *_advice(laws, closed, tried),
        )
        raise NoConsistentMode("; ".join(filter(None, words)), considered=refused)
    taken, warning = _rivals(_continuing(agreeing, tried, scales, before), case, before)
    doubted = None if many or uncertainty is None else uncertainty.sticking(case, options, taken)
    if doubted is not None:
        taken, warning = doubted, ""
    # What a mode left open closes besides must not move away.
    if not warning and taken.violation >= 0.0 and any(_opens(taken, one, closed) for one in tried):
        warning = f"indeterminate: {OPEN_LOAD}; {_label(laws, taken)} taken"
    notes: tuple[str, ...] = (_UNCHECKED,) if many else ()
    if taken.share is not None:
        notes += _indeterminate(laws, taken.share)
    notes += _carried(snapshot, laws, closed, taken.states)
    if uncertainty is not None and doubted is not None:
        notes += tuple(
            f"{law.name} comes to rest where that takes just the force that friction gives, as far "
            "as the tolerance tells: it sticks, and might slip on"
            for law, state, was in zip(laws, taken.states, uncertainty.sure, strict=True)
            if state == "pin" and was != "pin"
        )
    considered = LazyMapping(partial(_verdicts, laws, tried, taken, tie))
    return Choice(taken, considered, warning, notes, doubted is not None)


def _continuing(
    agreeing: list[Candidate],
    tried: Iterable[Candidate | Undetermined],
    scales: Scales,
    before: Before,
) -> list[Candidate]:
    """Return those of the candidates that agree that move on as the mode left, or all.

    Where friction presses a contact into its surface, others agree at forces without cause; none of
    them is taken because something else comes to its bound.
    """
    left = None
    if len(agreeing) > 1 and before.mode is not None:
        left = next((c for c in tried if c[0] == before.mode and isinstance(c, Candidate)), None)
    if left is None or (left.share is not None and not _bearing(left) <= before.bearing):
        return agreeing
    return [c for c in agreeing if same_motion(c, left, scales, _GOES_ON)] or agreeing


def _rivals(agreeing: Sequence[Candidate], case: Case, before: Before) -> tuple[Candidate, str]:
    """Return the one taken of the candidates that agree with the state, and why not another.

    Raises
    ------
    AmbiguousMode
        Where they move it apart, and all keep every contact closed.
    """
    _, laws, closed, _, scales, tie = case
    taken = agreeing[0]
    if len(agreeing) == 1:
        return taken, ""
    clear = [c for c in agreeing if c.violation <= _NEARLY * tie]
    for one in clear:
        if one.share is not None and one.states == before.mode:
            return _without_new_loads(one, clear, case, before.bearing)
    taken = min(clear or agreeing, key=openness)
    # On the edge of its inequalities (a massless body that needs no force) it is no rival.
    sure = [c for c in agreeing if c.violation < -tie] if taken.violation < -tie else []
    others = [c for c in sure if c is not taken and not same_motion(c, taken, scales)]
    if not others and taken.share is not None:
        # What lies along a surface is on its edge wherever it goes.
        new = _bearing(taken) - before.bearing
        less = [c for c in clear if _bearing(c) < _bearing(taken) <= _bearing(c) | new]
        others = [c for c in less if not same_motion(c, taken, scales, _GOES_ON)]
    if not others:
        return taken, ""
    labels = ", ".join(_label(laws, c) for c in [taken, *others])
    opened = [
        c
        for c in [taken, *others]
        if any(
            state == "free" and touching for state, touching in zip(c.states, closed, strict=True)
        )
    ]
    if not opened:
        raise AmbiguousMode(f"several modes agree with the state and move it apart: {labels}")
    # Painleve's indeterminate case: contact could also hold, at a force without cause, and a
    # mode agrees without it whatever else lifts off.
    bearing = [_bearing(c) for c in opened]
    free = [c for c, own in zip(opened, bearing, strict=True) if not any(b < own for b in bearing)]
    taken = min(free, key=openness)
    return taken, f"indeterminate: {labels} all agree with the state; {_label(laws, taken)} taken"


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
    both = pressed_together(jacobians, cones(tuple(case.laws)), sorted(_bearing(one)))
    if not new <= both:
        return one, ""
    names = ", ".join(case.laws[i].name for i in sorted(both))
    return one, (
        f"indeterminate: {names} may press on each other by any force; the smallest forces have "
        "them do so from now on, and friction may hold what would slip if nothing but loads pressed"
    )


def _advice(
    laws: Sequence[ContactLaw], closed: Sequence[bool], tried: Iterable[Candidate | Undetermined]
) -> Iterator[str]:
    """Yield what in the declaration keeps a state from having a mode, and what to do."""
    rough = [
        law.name
        for law, shut in zip(laws, closed, strict=True)
        if shut and "pin" in law.states and not any(s in SLIDING for s in law.states)
    ]
    if rough:
        yield (
            f"{', '.join(rough)} may not slip, and that can take a force that no surface gives: "
            "let go, the point would accelerate into the surface (McGeer's paradox); "
            "list slide among the modes, with a friction"
        )
    unlisted = False
    for law, shut in zip(laws, closed, strict=True):
        kinds = {declared_state(state) for state in law.states}
        wanted = ("free", "slide", "pin") if law.cone_t > 0.0 else ("free", "slide")
        lacks = [kind for kind in wanted if kind not in kinds]
        if shut and lacks and law.name not in rough:
            unlisted = True
            yield f"{law.name} does not list {', '.join(lacks)} among its modes: add what it needs"
    if not unlisted and any(not isinstance(c, Candidate) and c[1] == SINGULAR for c in tried):
        yield "what no contact holds has no mass or inertia of its own: give it some"


def _bearing(candidate: Candidate) -> frozenset[int]:
    return frozenset(i for i, state in enumerate(candidate.states) if state not in OPEN)


def _opens(taken: Candidate, other: Candidate | Undetermined, closed: Sequence[bool]) -> bool:
    """Whether the mode taken is one of several that leave out contacts of a mode left open."""
    if isinstance(other, Candidate) or other[1] != OPEN_LOAD:
        return False
    pairs = zip(taken.states, other[0], closed, strict=True)
    return all(mine == theirs or (shut and mine == "free") for mine, theirs, shut in pairs)


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
        if shut and state in OPEN and here <= _IMPLIED * all_of_it
    ]
    if not names:
        return ()
    return (
        f"joints hold {', '.join(names)} closed: they are taken to bear all of the load, and no "
        "friction acts there",
    )


def _options(
    contact: PerContact, law: ContactLaw, touching: bool, at_rest: bool
) -> tuple[str, ...]:
    if not touching:
        return (OFF if contact.gap == math.inf else "free",)
    return _open(law.states, contact.slip > 0.0, at_rest)


@lru_cache(maxsize=1024)
def _open(states: tuple[str, ...], forward: bool, at_rest: bool) -> tuple[str, ...]:
    """Return the states that a touching contact may be in, from the sense of its slip."""
    direction = "slide+" if forward else "slide-"
    return tuple(
        state
        for state in states
        if state != OFF and (state in ("free", "slide") or at_rest or state == direction)
    )


def _label(laws: Sequence[ContactLaw], candidate: Candidate | Undetermined) -> str:
    states = candidate.states if isinstance(candidate, Candidate) else candidate[0]
    return " ".join(f"{law.name}:{state}" for law, state in zip(laws, states, strict=True))


def _verdict(candidate: Candidate | Undetermined, tie: float) -> str:
    if not isinstance(candidate, Candidate):
        return candidate[1]
    if candidate.violation <= 0.0:
        return "consistent"
    if candidate.violation <= tie:
        return f"consistent within the tie band: {candidate.reason}"
    return candidate.reason
