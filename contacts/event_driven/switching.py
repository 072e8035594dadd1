"""Contacts with conditions go off and come back."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from contacts.dynamics.conditions import Conditions, hidden
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.event_driven.decision import decide
from contacts.impacts.jamming import Jam
from contacts.modes.classification import Before
from contacts.scene.parts import Resolution
from contacts.states import OFF
from statechart.arrays import Array
from statechart.automaton.laws import Flow, Instant
from statechart.automaton.trace import Jump, Key, Role, Roles
from statechart.errors import NonFinite, SimulationError

# Of the round-off of a place; what is zero may be on either side.
_MORE = 2.0

# Where none of the contacts that meet within so many tolerances of gaps is on, it is told.
_CORNER = 1000.0

Strike = Callable[[Key], tuple[Array, Snapshot] | None]
"""Mode -> the state after an impact of its contacts, and the numbers there; None without one."""


class Switching:
    """Takes contacts off and back (see `contacts.dynamics.conditions`)."""

    def __init__(self, names: Sequence[str], conditions: Conditions, paradox: Resolution) -> None:
        self._names, self._conditions, self._paradox = names, conditions, paradox
        self._verdicts: list[int] = []  # of the instant that was asked about last

    def failing(
        self,
        setup: SceneSetup,
        snapshot: Snapshot,
        state: Array,
        time: float,
        fired: tuple[str, ...] = (),
        mode: Key = (),
    ) -> tuple[str, ...]:
        """Return, for every contact, a condition that fails in a mode; see `Conditions`."""
        near, slow = self._near(setup, snapshot, state, time), setup.tolerances["speed"]

        def motion(failing: Sequence[bool]) -> Roles | None:
            off = tuple(
                OFF if fails or (OFF in law.states and not contact.gap >= -close) else "free"
                for fails, law, contact, close in zip(
                    failing, setup.contacts, snapshot.contacts, near, strict=True
                )
            )
            here = hidden(snapshot, off)
            # What strikes is not held before it has.
            touching = [
                c.gap <= close and abs(c.gap_rate) <= slow
                for c, close in zip(here.contacts, near, strict=True)
            ]
            try:
                choice = decide(setup, here, touching, self._paradox, Before())
            except SimulationError:
                return None
            return None if isinstance(choice, Jam) else choice.taken.roles

        on = [state != OFF for state in mode[: len(self._names)]]
        verdicts = self._conditions.verdicts(setup, state, time, fired, motion, on)
        self._verdicts = self._in_corners(setup, snapshot, state, time, verdicts, fired, on)
        return self._conditions.first(self._verdicts)

    def _near(
        self, setup: SceneSetup, snapshot: Snapshot, state: Array, time: float
    ) -> list[float]:
        """Return up to which gap every contact is closed.

        A place at which a gate is zero is known to the round-off of the gate. So is, then, the gap
        of what takes over there.
        """
        whole = snapshot if snapshot.held is None else snapshot.held.whole
        blurred = self._conditions.blurred(setup, state, time)
        return [
            setup.tolerances["gap"] + _MORE * blur * float(np.linalg.norm(contact.jacobian[0]))
            for blur, contact in zip(blurred, whole.contacts, strict=True)
        ]

    def _in_corners(
        self,
        setup: SceneSetup,
        snapshot: Snapshot,
        state: Array,
        time: float,
        verdicts: list[int],
        fired: Collection[str],
        on: Sequence[bool],
    ) -> list[int]:
        """Let gates hold that are on their boundary, in a corner where nothing takes over.

        There contacts of one point meet. Edges at an acute angle have no place of their own behind
        the corner: a point that slides on one of them strikes the other, and passes the ends of
        both. Elsewhere a contact that is on waits for the other, of which less round-off tells that
        it is not there yet.
        """
        failing = self._conditions.first(verdicts)
        if not any(failing):
            return verdicts
        near, slow = self._near(setup, snapshot, state, time), setup.tolerances["speed"]
        contacts, points = snapshot.contacts, self._conditions.points
        every = range(len(points))
        near = [max(near[j] for j in every if points[j] == points[i]) for i in every]
        corners: dict[int, list[int]] = {}
        for i, point in enumerate(points):
            if abs(contacts[i].gap) <= near[i]:
                corners.setdefault(point, []).append(i)
        would = self._conditions.kept_on(setup, state, time, verdicts, every, fired)
        doubtful = [
            bool(why) and not then
            for why, then in zip(failing, self._conditions.first(would), strict=True)
        ]
        kept: set[int] = set()
        for places in corners.values():
            if len(places) < 2 or not all(failing[i] for i in places):
                continue
            leaves = [i for i in places if doubtful[i] and contacts[i].gap_rate <= slow]
            if len(leaves) > 1 and any(contacts[i].gap_rate < -slow for i in leaves):
                kept.update(leaves)
            kept.update(i for i in places if doubtful[i] and on and on[i])
        return self._conditions.kept_on(setup, state, time, verdicts, kept, fired)

    def switched(
        self, at: Instant, setup: SceneSetup, snapshot: Snapshot, strike: Strike
    ) -> dict[int, str]:
        """Return the contacts that go off, with a condition that fails, or come back, with ""."""
        if not self._conditions.present:
            return {}
        failing = self.failing(setup, snapshot, at.state, at.clock.high, at.fired, at.flow.mode)
        if any(failing) and self._conditions.on_boundary(setup, at.state, at.clock.high):
            failing = self._struck_too(at, setup, snapshot, failing, strike)
        result: dict[int, str] = {}
        near = self._near(setup, snapshot, at.state, at.clock.high)
        for i, (why, now) in enumerate(zip(failing, at.flow.mode, strict=True)):
            gap = snapshot.contacts[i].gap
            if why and now != OFF:
                result[i] = why
            elif not why and now == OFF:
                if math.isnan(gap):
                    raise NonFinite(
                        f"the conditions of contact {self._names[i]!r} hold where its surface "
                        "has no finite value; add a condition that fails there"
                    )
                if gap >= -near[i]:
                    result[i] = why
        return result

    def _struck_too(
        self,
        at: Instant,
        setup: SceneSetup,
        snapshot: Snapshot,
        failing: tuple[str, ...],
        strike: Strike,
    ) -> tuple[str, ...]:
        """Return the conditions that fail if an impact does not throw the bodies back.

        In a narrow valley an impact on one side sends the point to the other, whose contact is
        closed as well: both take part.
        """
        slow, verdicts = setup.tolerances["speed"], self._verdicts
        near = self._near(setup, snapshot, at.state, at.clock.high)
        mode = tuple(
            OFF if why else "free" if state == OFF and contact.gap >= -close else state
            for why, state, contact, close in zip(
                failing, at.flow.mode, snapshot.contacts, near, strict=True
            )
        )
        found = strike(mode)
        if found is None:
            return failing
        state, after = found
        then = self.failing(setup, after, state, at.clock.high)
        self._verdicts = verdicts
        return tuple(
            "" if not later and abs(contact.gap) <= close and contact.gap_rate < -slow else why
            for why, later, contact, close in zip(failing, then, after.contacts, near, strict=True)
        )

    def jump(
        self, at: Instant, setup: SceneSetup, snapshot: Snapshot, switched: Mapping[int, str]
    ) -> tuple[Jump, Flow]:
        """Take contacts off or back; what the others do then is asked next."""
        flow = at.flow
        mode, roles = list(flow.mode), list(flow.roles)
        for place, why in switched.items():
            mode[place] = OFF if why else "free"
            roles[place] = Role(mode[place])
        place, why = next(iter(switched.items()))
        name = self._names[place]
        reason = "its conditions hold, and its gap is open"
        if why:
            reason = f"does not hold: {why.removeprefix(f'{name}: ')}"
        jump = at.jump(
            name,
            "disable" if why else "enable",
            tuple(mode),
            considered={
                f"{name}:{flow.mode[place]}": reason,
                f"{name}:{mode[place]}": "taken",
            },
            energy=(snapshot.energy, snapshot.energy),
        )
        following = flow._replace(mode=tuple(mode), roles=tuple(roles), warning="", settled=False)
        if not any(role.captured for role in roles):
            # The bounces that were skipped were those of a contact that is off now.
            following = following._replace(remaining=math.inf)
        return jump, following._replace(warning=self._lost(setup, snapshot, flow.mode, tuple(mode)))

    def _lost(self, setup: SceneSetup, snapshot: Snapshot, before: Key, after: Key) -> str:
        """Return a warning where contacts of a point go off in a corner, and none takes over."""
        points, room = self._conditions.points, _CORNER * setup.tolerances["gap"]
        beside = [abs(contact.gap) <= room for contact in snapshot.contacts]
        for i, point in enumerate(points):
            corner = [j for j, other in enumerate(points) if other == point and beside[j]]
            left = before[i] != OFF and i in corner
            if left and len(corner) > 1 and all(after[j] == OFF for j in corner):
                names = ", ".join(self._names[j] for j in corner)
                return f"{names} meet here, and all are off: the point may fall between them"
        return ""

    def watched(
        self, setup: SceneSetup, state: Array, time: float, made: tuple[Jump | None, Flow]
    ) -> tuple[Jump | None, Flow]:
        """Give a flow from a state the round-off of the conditions that decide there.

        What a jump leaves on the boundary of a condition may go another way: it is judged again.
        """
        jump, flow = made
        own = self._conditions.tolerances(setup, state, time)
        settled = flow.settled and not (
            jump is not None and self._conditions.on_boundary(setup, state, time)
        )
        return jump, flow._replace(tolerances={**flow.tolerances, **own}, settled=settled)

    def kept(self, at: Instant, setup: SceneSetup) -> tuple[None, Flow] | None:
        """Let a mode that holds go on, if other conditions decide that it does; else None."""
        flow = at.flow
        own = self._conditions.tolerances(setup, at.state, at.clock.high, self._verdicts)
        if alike(own, flow.tolerances):
            return None
        return None, flow._replace(tolerances={**flow.tolerances, **own})


def alike(own: Mapping[str, float], tolerances: Mapping[str, float]) -> bool:
    """Return whether the margins of conditions that are watched are those of `tolerances`."""
    return all(
        (tolerances.get(name, 0.0) == math.inf) == (tolerance == math.inf)
        for name, tolerance in own.items()
    )
