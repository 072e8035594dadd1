"""Painleve's paradoxes, and the impacts without collision (jams) that resolve them.

At a sliding contact the normal acceleration is ``b + p V`` with the force along the edge of the
cone (Painleve 1895; Genot and Brogliato, Eur. J. Mech. A 18 (1999)). Where ``p > 0`` there is one
answer. Where ``p < 0`` there is none if ``b < 0`` (inconsistent), and there are two if ``b > 0``
(indeterminate): free flight, and a force without cause. Where friction presses closed contacts
into their surfaces whatever forces they bear, or a sliding contact's force has grown without bound,
impulses at contacts that do not approach stop the slip that presses (Lecornu 1905).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, sliding_edge
from contacts.dynamics.snapshot import PerContact, Snapshot, answer, solve_kkt
from contacts.impacts.impact import impact
from contacts.impacts.impulses import Impulses, collisions
from contacts.impacts.simultaneous import Impacts, groups
from contacts.states import DISENGAGED, OFF, SLIDING
from statechart.automaton.trace import Key
from statechart.errors import NoConsistentMode

# Of the response to a normal force alone: p this small cannot be told from none, and the force
# that it asks for stops slip in less time than can be told from none.
_NONE = 1e-14


@dataclass(frozen=True)
class Paradox:
    """A sliding contact with p <= 0 (or nearly so), the other contacts seen as open."""

    contact: str
    # Normal acceleration per unit of normal force V while it slides; per unit of the force along
    # the cone's edge where mu is infinite. In 1/mass
    p: float
    b: float  # Normal acceleration without force
    mu: float  # Coefficient of friction
    critical: float  # The mu at which p = 0

    @property
    def kind(self) -> str:
        """inconsistent, or indeterminate; about to be so where p > 0 still."""
        if self.p > 0.0:
            return "about to be inconsistent"
        return "inconsistent" if self.b < 0.0 else "indeterminate"

    def __str__(self) -> str:
        return (
            f"sliding of {self.contact} is {self.kind} (Painleve's paradox: mu = {self.mu:.6g}, "
            f"critical mu = {self.critical:.6g}, p = {self.p:.6g}, free normal acceleration "
            f"{self.b:.6g})"
        )


def paradoxes(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    touching: Sequence[bool],
    still_below: float,
    nearly: float = 0.0,
) -> dict[int, Paradox]:
    """Return the touching contacts that slide with p <= 0, or pressed with next to none.

    Slip speeds up to `still_below` are zero; p up to `nearly`, in parts of the response to a normal
    force, is next to none.
    """
    found: dict[int, Paradox] = {}
    for i, (law, contact) in enumerate(zip(laws, snapshot.contacts, strict=True)):
        if not touching[i] or abs(contact.slip) <= still_below or law.cone_t == 0.0:
            continue
        if law.coupling:
            continue
        sign = math.copysign(1.0, contact.slip)
        cone_n, cone_t = sliding_edge(law, contact)
        p = _response(snapshot, contact, cone_n, -sign * cone_t)
        straight = _response(snapshot, contact, 1.0, 0.0)
        if p > max(nearly, _NONE) * straight:
            continue
        none = np.zeros((0, len(snapshot.forces)))
        free = solve_kkt(snapshot.mass, snapshot.forces, none, none, np.zeros(0))
        b = math.nan if free is None else float(contact.jacobian[0] @ free[0]) + contact.bias_n
        if p >= 0.0 and not b < 0.0:
            continue
        across = sign * _response(snapshot, contact, 0.0, 1.0)
        steep = cone_n == 0.0
        found[i] = Paradox(
            law.name,
            p if steep else p / cone_n,
            b,
            math.inf if steep else cone_t / cone_n,
            straight / across if across > 0.0 else math.inf,
        )
    return found


def _response(snapshot: Snapshot, contact: PerContact, n: float, t: float) -> float:
    """Return the normal acceleration per unit force along (n, t)."""
    column = contact.jacobian.T @ np.array([n, t])
    solved = answer(snapshot, contact.jacobian[:1], column[None], np.ones(1))
    # The force that one unit of acceleration takes; none does where p = 0.
    if solved is None:
        return 0.0
    amount = float(solved[1][0])
    return 1.0 / amount if amount != 0.0 else math.inf


# Of the response to a normal force alone: where p falls below, a force is 1e6 times what holds the
# contact closed without friction.
_HARDLY = 1e-6
# Of the velocities before: impulses that change them by less are none.
_NOTHING = 1e-9


@dataclass(frozen=True)
class Jam:
    """Contacts that friction presses in: an impact without collision resolves it."""

    why: str  # Which contacts, and by what numbers
    places: tuple[int, ...]  # They
    sliding: Key  # The mode in which they do
    # Mode -> why it does not agree with the state
    considered: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.why}; an impact without collision resolves it"


def closed_state(law: ContactLaw, contact: PerContact, still_below: float) -> str:
    """Return the state in which an impact without rebound leaves a contact or a coupling."""
    if law.coupling:
        slips = abs(contact.slip) > still_below
        return ("slip+" if contact.slip > 0.0 else "slip-") if slips else "locked"
    sliding = [name for name in law.states if name in SLIDING]
    if not sliding and "pin" not in law.states:
        return "free"
    if "pin" in law.states and (abs(contact.slip) <= still_below or not sliding):
        return "pin"
    return sliding[0] if len(sliding) == 1 or contact.slip > 0.0 else sliding[-1]


def off_state(law: ContactLaw) -> str:
    """Return the state of a contact or a coupling whose conditions fail."""
    return DISENGAGED if law.coupling else OFF


def engaged(law: ContactLaw, contact: PerContact, still_below: float) -> str:
    """Return the state in which a contact or a coupling begins whose conditions hold again."""
    return closed_state(law, contact, still_below) if law.coupling else "free"


def listed(
    key: Key, laws: Sequence[ContactLaw], contacts: Sequence[PerContact], still_below: float
) -> Key:
    """Return the mode with contacts closed that may not be free, as long as they still strike."""
    return tuple(
        closed_state(law, contact, still_below) if name == "free" and name not in law.states
        else name
        for name, law, contact in zip(key, laws, contacts, strict=True)
    )  # fmt: skip


def jammed(
    snapshot: Snapshot, laws: Sequence[ContactLaw], touching: Sequence[bool], still_below: float
) -> Jam | None:
    """Return the jam of a state that no mode agrees with; None: an impact would change nothing."""
    found = paradoxes(snapshot, laws, touching, still_below)
    for group in groups(snapshot, struck(laws, touching)):
        why = ""
        if len(group) == 1:
            why = str(found.get(group[0], ""))
        elif _at_once(snapshot, laws, group) is not None:
            names = ", ".join(laws[i].name for i in group)
            why = "; ".join(
                [f"friction jams {names}", *(str(found[i]) for i in group if i in found)]
            )
        if why:
            return Jam(why, tuple(group), _sliding(snapshot, laws, group, still_below))
    return None


def unbounded(
    snapshot: Snapshot, laws: Sequence[ContactLaw], closed: Sequence[bool], still_below: float
) -> Jam | None:
    """Return the jam that a flow has come to the brink of: p falls to zero, and b < 0."""
    found = paradoxes(snapshot, laws, closed, still_below, _HARDLY)
    for group in groups(snapshot, struck(laws, closed)):
        paradox = found.get(group[0])
        if len(group) == 1 and paradox is not None and paradox.b < 0.0:
            why = f"the force of {paradox.contact} grows without bound: {paradox}"
            return Jam(why, tuple(group), _sliding(snapshot, laws, group, still_below))
    return None


def without_collision(
    snapshot: Snapshot, laws: Sequence[ContactLaw], places: Sequence[int]
) -> Impacts:
    """Return the impact of closed contacts that friction presses into their surfaces.

    One contact: Routh's path from a normal velocity of zero; slip is braked until it stops,
    pressing the point inwards meanwhile; then the point sticks, and compression and restitution
    follow. Several: the impulses other than none that agree with the plastic law of impact.

    Raises `NoConsistentMode` if the path does not end, or there are no such impulses.
    """
    impulses = np.zeros((len(laws), 2))
    unknown = (False,) * len(laws)
    if len(places) == 1:
        place = places[0]
        law, contact = laws[place], snapshot.contacts[place]._replace(gap_rate=0.0)
        result = impact(snapshot, contact, law, law.restitution, braking=True)
        impulses[place] = result.normal, result.tangential
        velocity, path = result.velocity, f"{law.name} {' '.join(result.path)}"
    else:
        found = _at_once(snapshot, laws, places)
        if found is None:
            names = ", ".join(laws[i].name for i in places)
            raise NoConsistentMode(f"no impulse ends the jam of {names} (Painleve's paradox)")
        impulses, unknown = found.impulses, found.indeterminate
        velocity = snapshot.velocity + found.change
        path = "plastic " + ", ".join(f"{laws[i].name}:{found.states[i]}" for i in places)
    return Impacts(velocity, impulses, (path,), 1.0, unknown)


def struck(laws: Sequence[ContactLaw], closed: Sequence[bool]) -> list[bool]:
    """Return which contacts take part in an impact; a couple that is bounded has no impulse."""
    return [shut and not law.coupling for law, shut in zip(laws, closed, strict=True)]


def _sliding(
    snapshot: Snapshot, laws: Sequence[ContactLaw], places: Sequence[int], still_below: float
) -> Key:
    return tuple(
        closed_state(law, contact, still_below)
        if i in places or (law.coupling and contact.gap < np.inf and law.carrier in (-1, *places))
        else off_state(law) if contact.gap == np.inf else "free"
        for i, (law, contact) in enumerate(zip(laws, snapshot.contacts, strict=True))
    )  # fmt: skip


def _at_once(
    snapshot: Snapshot, laws: Sequence[ContactLaw], places: Sequence[int]
) -> Impulses | None:
    """Return the preferred plastic impulse that is not none."""
    contacts = tuple(c._replace(gap_rate=0.0) for c in snapshot.contacts)
    closed = [i in places for i in range(len(laws))]
    found = collisions(snapshot._replace(contacts=contacts), laws, closed, [0.0] * len(laws))
    least = _NOTHING * float(np.abs(snapshot.velocity).max())
    return next((one for one in found if np.abs(one.change).max() > least), None)
