"""Switching of contacts by their conditions."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from contacts.dynamics.conditions import Conditions, ConditionsAt, hidden
from contacts.dynamics.setup import SceneInstant, SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.event_driven.decision import choose_mode
from contacts.impacts.jamming import Jam, engaged_state, off_state
from contacts.modes.classification import Before
from contacts.states import INACTIVE, OFF, cause_of
from statechart.arrays import Array
from statechart.automaton.laws import Flow
from statechart.automaton.trace import Jump, Key, Role, Roles
from statechart.errors import NonFinite, SimulationError

# Safety factor of the round-off of a place: a zero may be on either side.
_MORE = 2.0

# Size of a corner, in gap tolerances, above which a warning says that all its contacts are off.
_CORNER = 1000.0

Strike = Callable[[Key], tuple[Array, Snapshot] | None]
"""Mode -> state and snapshot after an impact of its contacts; None without one."""


class _Site(NamedTuple):
    """Contacts and conditions at a state."""

    setup: SceneSetup
    snapshot: Snapshot
    conditions: ConditionsAt
    near: list[float]  # Largest gap at which each contact is closed


class Switching:
    """Disables and enables contacts (see `contacts.dynamics.conditions`)."""

    def __init__(self, names: Sequence[str], conditions: Conditions) -> None:
        self._names, self._conditions = names, conditions
        self.verdicts: list[int] = []  # Of the last instant in `switched`.

    def failing(
        self, setup: SceneSetup, snapshot: Snapshot, state: Array, time: float
    ) -> tuple[str, ...]:
        """Return a failing condition of each contact, or ""; see `ConditionsAt`."""
        return self._conditions.first(self._atom_verdicts(self._site(setup, snapshot, state, time)))

    def _site(self, setup: SceneSetup, snapshot: Snapshot, state: Array, time: float) -> _Site:
        """Return the contacts and conditions at a state.

        The zero of a gate is known to its round-off, and so is the gap of the contact that takes
        over there.
        """
        conditions, gap_tolerance = self._conditions.at(setup, state, time), setup.tolerances["gap"]
        normals = snapshot.unreduced.jacobians[:, 0]
        near = [
            gap_tolerance + _MORE * blur * float(np.linalg.norm(normal))
            for blur, normal in zip(conditions.position_uncertainty, normals, strict=True)
        ]
        return _Site(setup, snapshot, conditions, near)

    def _atom_verdicts(
        self, site: _Site, fired: tuple[str, ...] = (), on: Sequence[bool] = ()
    ) -> list[int]:
        """Return the verdicts of the atoms; `on`: contacts enabled in the flow that ends here."""
        setup, snapshot, here, near = site
        slow = setup.tolerances["speed"]

        def motion(failing: Sequence[bool]) -> Roles | None:
            contacts = zip(failing, setup.contacts, snapshot.contacts, near, strict=True)
            off = [why or (OFF in law.states and not c.gap >= -at) for why, law, c, at in contacts]
            mode = (off_state(x) if y else "free" for x, y in zip(setup.contacts, off, strict=True))
            shown = hidden(snapshot, tuple(mode))
            # A striking contact does not constrain the motion yet.
            gaps = zip(shown.contacts, near, strict=True)
            touching = [c.gap <= close and abs(c.gap_rate) <= slow for c, close in gaps]
            try:
                choice = choose_mode(setup, shown, touching, Before())
            except SimulationError:
                return None
            return None if isinstance(choice, Jam) else choice.taken.roles

        verdicts = here.verdicts(fired, motion, on)
        certified = self._certified_in_corners(site, verdicts, fired, on)
        return here.with_boundary(verdicts, certified, fired)

    def _certified_in_corners(
        self, site: _Site, verdicts: list[int], fired: Collection[str], on: Sequence[bool]
    ) -> set[int]:
        """Return the contacts whose atoms hold on their boundary, as no other contact takes over.

        In a corner where contacts of one point meet: edges at an acute angle overlap behind the
        corner, so that a point sliding on one strikes the other and passes the ends of both.
        Elsewhere an enabled contact waits for the other, whose condition has less round-off.
        """
        failing = self._conditions.first(verdicts)
        certified: set[int] = set()
        if not any(failing):
            return certified
        contacts, points = site.snapshot.contacts, self._conditions.points
        slow, every = site.setup.tolerances["speed"], range(len(points))
        would = self._conditions.first(site.conditions.with_boundary(verdicts, every, fired))
        on_boundary = [bool(why) and not then for why, then in zip(failing, would, strict=True)]
        for point in {*points}:
            same = [i for i in every if points[i] == point]
            near = max(site.near[i] for i in same)
            places = [i for i in same if abs(contacts[i].gap) <= near]
            if len(places) < 2 or not all(failing[i] for i in places):
                continue
            leaves = [i for i in places if on_boundary[i] and contacts[i].gap_rate <= slow]
            if len(leaves) > 1 and any(contacts[i].gap_rate < -slow for i in leaves):
                certified.update(leaves)
            certified.update(i for i in places if on_boundary[i] and on and on[i])
        return certified

    def switched(self, at: SceneInstant, snapshot: Snapshot, strike: Strike) -> dict[int, str]:
        """Return the contacts that go off, with a failing condition, or come back, with ""."""
        if not self._conditions.present:
            return {}
        site = self._site(at.setup, snapshot, at.state, at.clock.high)
        on = [state not in INACTIVE for state in at.flow.mode]
        self.verdicts = self._atom_verdicts(site, at.fired, on)
        failing = self._conditions.first(self.verdicts)
        if any(failing) and site.conditions.on_boundary:
            failing = self._struck_too(at, site, failing, strike)
        result: dict[int, str] = {}
        for i, (why, active) in enumerate(zip(failing, on, strict=True)):
            gap = snapshot.contacts[i].gap
            if not (why or active) and math.isnan(gap):
                raise NonFinite(
                    f"the conditions of contact {self._names[i]!r} hold where its surface "
                    "has no finite value; add a condition that fails there"
                )
            if bool(why) == active and (active or gap >= -site.near[i]):
                result[i] = why
        return result

    def _struck_too(
        self, at: SceneInstant, site: _Site, failing: tuple[str, ...], strike: Strike
    ) -> tuple[str, ...]:
        """Return the conditions that fail unless an impact sends the bodies back.

        A contact that is on, and would be again after the impact, has not changed. In a narrow
        valley an impact on one side sends the point to the other, whose contact is closed as well:
        both take part.
        """
        setup, snapshot, _, near = site
        slow, mode, result = setup.tolerances["speed"], [*at.flow.mode], [*failing]
        for i, (law, contact) in enumerate(zip(setup.contacts, snapshot.contacts, strict=True)):
            if failing[i]:
                mode[i] = off_state(law)
            elif mode[i] in INACTIVE and contact.gap >= -near[i]:
                mode[i] = engaged_state(law, contact, setup.slip_tolerance)
        struck = strike(tuple(mode))
        if struck is None:
            return failing
        state, after = struck
        then = self.failing(setup, after, state, at.clock.high)
        for i, contact in enumerate(after.contacts):
            strikes = abs(contact.gap) <= near[i] and contact.gap_rate < -slow
            if not then[i] and (strikes or at.flow.mode[i] not in INACTIVE):
                result[i] = ""
        return tuple(result)

    def corner_contacts(
        self, setup: SceneSetup, snapshot: Snapshot, state: Array, time: float, mode: Key
    ) -> list[int]:
        """Return the disabled contacts in a corner where one of the same point is closed.

        Only round-off decides there which of them is on.
        """
        if not self._conditions.present:
            return []
        _, _, here, near = self._site(setup, snapshot, state, time)
        points, every = self._conditions.points, range(len(self._conditions.points))
        fails = self._conditions.first(here.with_boundary(here.verdicts(), every, ()))
        met = [i for i in every if abs(snapshot.contacts[i].gap) <= near[i]]
        occupied = {points[i] for i in met if mode[i] not in INACTIVE}
        return [i for i in met if mode[i] == OFF and not fails[i] and points[i] in occupied]

    def jump(
        self, at: SceneInstant, snapshot: Snapshot, switched: Mapping[int, str]
    ) -> tuple[Jump, Flow]:
        """Disable or enable contacts; the others are classified next."""
        setup, flow = at.setup, at.flow
        mode, roles = list(flow.mode), list(flow.roles)
        for place, why in switched.items():
            law, contact = setup.contacts[place], snapshot.contacts[place]
            engaged = engaged_state(law, contact, setup.slip_tolerance)
            mode[place] = off_state(law) if why else engaged
            roles[place] = Role(mode[place])
        place, why = next(iter(switched.items()))
        name, before, after = self._names[place], flow.mode[place], mode[place]
        gap = "" if setup.contacts[place].coupling else ", and its gap is open"
        fails = f"does not hold: {why.removeprefix(f'{name}: ')}"
        reason = fails if why else f"its conditions hold{gap}"
        jump = at.jump(
            name, cause_of(before, after), tuple(mode),
            considered={f"{name}:{before}": reason, f"{name}:{after}": "taken"},
            energy=(snapshot.energy, snapshot.energy),
        )  # fmt: skip
        warning = self._corner_warning(setup, snapshot, flow.mode, tuple(mode))
        # Without captured contacts, the skipped bounces belonged to one that is off now.
        captured = any(role.captured for role in roles)
        return jump, flow._replace(
            mode=tuple(mode), roles=tuple(roles), warning=warning, settled=False,
            remaining=flow.remaining if captured else math.inf,
        )  # fmt: skip

    def _corner_warning(
        self, setup: SceneSetup, snapshot: Snapshot, before: Key, after: Key
    ) -> str:
        """Return a warning if all contacts of a point go off in a corner that it does not leave."""
        points, corner_size = self._conditions.points, _CORNER * setup.tolerances["gap"]
        nearby = [abs(contact.gap) <= corner_size for contact in snapshot.contacts]
        slow = setup.tolerances["speed"]
        for i, point in enumerate(points):
            corner = [j for j, other in enumerate(points) if other == point and nearby[j]]
            goes_off = before[i] not in INACTIVE and i in corner
            if not goes_off:
                continue
            rates = [snapshot.contacts[j].gap_rate for j in corner]
            # It leaves one side of the tip of a ridge, or slides out between opposed sides.
            slides = max(abs(snapshot.contacts[j].slip) for j in corner) > slow
            normals = snapshot.jacobians[corner, 0]
            opposed = slides and float((normals @ normals.T).min()) < 0.0
            if min(rates) >= -slow and (max(rates) > slow or opposed):
                continue
            if len(corner) > 1 and all(after[j] in INACTIVE for j in corner):
                names = ", ".join(self._names[j] for j in corner)
                return (
                    f"{names} meet here, and all are off: the point may fall through; "
                    "let their conditions overlap"
                )
        return ""


def alike(own: Mapping[str, float], tolerances: Mapping[str, float]) -> bool:
    """Return whether the same margins of conditions are watched as in `tolerances`."""
    return all(
        (tolerances.get(name, 0.0) == math.inf) == (tolerance == math.inf)
        for name, tolerance in own.items()
    )
