"""Painleve's paradoxes, and the impacts without collision (jams) that resolve them.

At a sliding contact the normal acceleration is ``b + p V`` with the force along the edge of the
cone (Painleve 1895; Genot and Brogliato, Eur. J. Mech. A 18 (1999)). For ``p > 0`` the solution is
unique. For ``p < 0`` there is none if ``b < 0`` (inconsistent), and there are two if ``b > 0``
(indeterminate): free flight, and a force without cause. If friction presses closed contacts into
their surfaces under any forces, or the force of a sliding contact grows without bound, an impact
without collision stops the slip (Lecornu 1905).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, sliding_edge
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import PerContact, Snapshot, answer, solve_kkt
from contacts.impacts.impact import impact
from contacts.impacts.simultaneous import Impacts, groups
from contacts.states import DISENGAGED, OFF, SLIDING
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Key, Roles

# Values of p below this part of the frictionless response are round-off; the corresponding force
# stops the slip within the resolution of time.
_P_ROUND_OFF = 1e-14


@dataclass(frozen=True)
class Paradox:
    """A sliding contact with p <= 0 (or nearly so), with the other contacts open."""

    contact: str
    # Normal acceleration per unit of normal force while it slides, in 1/mass; per unit of the force
    # along the cone's edge if mu is infinite
    p: float
    b: float  # Normal acceleration without force
    mu: float  # Coefficient of friction
    critical: float  # The mu at which p = 0

    @property
    def kind(self) -> str:
        """inconsistent, indeterminate, or about to be inconsistent (p > 0)."""
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
    setup: SceneSetup, snapshot: Snapshot, touching: Sequence[bool], threshold: float = 0.0
) -> dict[int, Paradox]:
    """Return the touching contacts that slide with p <= 0, or pressed with next to none.

    p up to `threshold`, in parts of the response to a normal force, is next to none.
    """
    paradoxes_met: dict[int, Paradox] = {}
    for i, (law, contact) in enumerate(zip(setup.contacts, snapshot.contacts, strict=True)):
        slides = touching[i] and abs(contact.slip) > setup.slip_tolerance
        if not slides or law.cone_t == 0.0 or law.coupling:
            continue
        sign = math.copysign(1.0, contact.slip)
        cone_n, cone_t = sliding_edge(law, contact)
        p = _response(snapshot, i, cone_n, -sign * cone_t)
        frictionless = _response(snapshot, i, 1.0, 0.0)
        if p > max(threshold, _P_ROUND_OFF) * frictionless:
            continue
        no_rows, b = np.zeros((0, len(snapshot.forces))), math.nan
        unconstrained = solve_kkt(snapshot.mass, snapshot.forces, no_rows, no_rows, np.zeros(0))
        if unconstrained is not None:
            b = float(snapshot.jacobians[i, 0] @ unconstrained[0] + snapshot.biases[i, 0])
        if p >= 0.0 and not b < 0.0:
            continue
        across = sign * _response(snapshot, i, 0.0, 1.0)
        critical = frictionless / across if across > 0.0 else math.inf
        p, mu = (p / cone_n, cone_t / cone_n) if cone_n else (p, math.inf)
        paradoxes_met[i] = Paradox(law.name, p, b, mu, critical)
    return paradoxes_met


def _response(snapshot: Snapshot, place: int, n: float, t: float) -> float:
    """Return the normal acceleration of a contact per unit force along (n, t)."""
    jacobian = snapshot.jacobians[place]
    column = jacobian.T @ np.array([n, t])
    solved = answer(snapshot, jacobian[:1], column[None], np.ones(1))
    # The force that one unit of acceleration takes; none does where p = 0.
    if solved is None:
        return 0.0
    amount = float(solved[1][0])
    return 1.0 / amount if amount != 0.0 else math.inf


# Relative p below which a force counts as unbounded: it is 1e6 times the frictionless one.
_UNBOUNDED_P = 1e-6


@dataclass(frozen=True)
class Jam:
    """Contact that friction presses into its surface; an impact without collision follows."""

    why: str  # Sentence on the contact
    place: int  # Index of the contact
    sliding: Key  # The mode in which it slides
    # Mode -> reason why it is not consistent
    considered: Mapping[str, str] = field(default_factory=dict)

    @property
    def roles(self) -> Roles:
        """The roles in which contacts move before the impact."""
        return roles_in(self.sliding)

    def __str__(self) -> str:
        return f"{self.why}; an impact without collision resolves it"


def closed_state(law: ContactLaw, contact: PerContact, slip_tolerance: float) -> str:
    """Return the state in which an impact without rebound leaves a contact or a coupling."""
    if law.coupling:
        slips = abs(contact.slip) > slip_tolerance
        return ("slip+" if contact.slip > 0.0 else "slip-") if slips else "locked"
    sliding = [name for name in law.states if name in SLIDING]
    if not sliding and "pin" not in law.states:
        return "free"
    if "pin" in law.states and (abs(contact.slip) <= slip_tolerance or not sliding):
        return "pin"
    return sliding[0] if len(sliding) == 1 or contact.slip > 0.0 else sliding[-1]


def off_state(law: ContactLaw) -> str:
    """Return the state of a contact or a coupling whose conditions fail."""
    return DISENGAGED if law.coupling else OFF


def engaged_state(law: ContactLaw, contact: PerContact, slip_tolerance: float) -> str:
    """Return the state in which a contact or a coupling begins whose conditions hold again."""
    return closed_state(law, contact, slip_tolerance) if law.coupling else "free"


def listed_mode(key: Key, setup: SceneSetup, snapshot: Snapshot) -> Key:
    """Return the mode with closed states for contacts that do not list free."""
    mode, still = [*key], setup.slip_tolerance
    for i, law in enumerate(setup.contacts):
        if key[i] == "free" and "free" not in law.states:
            mode[i] = closed_state(law, snapshot.contacts[i], still)
    return tuple(mode)


def resolve_jam(
    setup: SceneSetup, snapshot: Snapshot, closed: Sequence[bool], *, unbounded: bool = False
) -> Jam | None:
    """Return the jam of a state without a consistent mode; None if no impact resolves it.

    `unbounded` asks for that at the end of a flow in which p falls to zero with b < 0.
    """
    paradoxes_met = paradoxes(setup, snapshot, closed, _UNBOUNDED_P if unbounded else 0.0)
    for place, *others in groups(snapshot, strike_jammed(setup.contacts, closed)):
        paradox = paradoxes_met.get(place)
        if others or paradox is None or (unbounded and not paradox.b < 0.0):
            continue
        grows = f"the force of {paradox.contact} grows without bound: " if unbounded else ""
        return Jam(f"{grows}{paradox}", place, _sliding(setup, snapshot, place))
    return None


def impact_without_collision(snapshot: Snapshot, laws: Sequence[ContactLaw], place: int) -> Impacts:
    """Return the impact without collision of a contact that friction presses into its surface.

    It is Routh's path from a normal velocity of zero: friction brakes the slip to zero and presses
    the point inwards, then it sticks, and compression and restitution follow.

    Raises `NoConsistentMode` if the path does not end.
    """
    impulses = np.zeros((len(laws), 2))
    law = laws[place]
    result = impact(snapshot, place, law, law.restitution, braking=True)
    impulses[place] = result.normal, result.tangential
    return Impacts(result.velocity, impulses, (f"{law.name} {' '.join(result.path)}",))


def strike_jammed(laws: Sequence[ContactLaw], closed: Sequence[bool]) -> list[bool]:
    """Return a mask of the closed contacts without couplings, whose impulses are zero."""
    return [shut and not law.coupling for law, shut in zip(laws, closed, strict=True)]


def _sliding(setup: SceneSetup, snapshot: Snapshot, place: int) -> Key:
    mode: list[str] = []
    for i, (law, contact) in enumerate(zip(setup.contacts, snapshot.contacts, strict=True)):
        on = contact.gap < math.inf
        closed = i == place or (law.coupling and on and law.carrier in (-1, place))
        opened = "free" if on else off_state(law)
        mode.append(closed_state(law, contact, setup.slip_tolerance) if closed else opened)
    return tuple(mode)
