"""Contacts with conditions go off and come back: by the laws of a scene, and compiled."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from contacts.dynamics.conditions import (
    FAILS,
    HOLDS,
    PER_CONDITION,
    UNSURE,
    Conditions,
    conditions_at,
    hidden,
    judge,
    round_off,
)
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SCALARS, Snapshot
from contacts.event_driven.decision import decide
from contacts.event_driven.hit import SceneWatch
from contacts.impacts.jamming import Jam
from contacts.modes.classification import Before
from contacts.scene.parts import Resolution
from contacts.states import FREE, OFF, OFF_CODE
from statechart.arrays import Array, Ints
from statechart.automaton.laws import Flow, Instant
from statechart.automaton.trace import Jump, Role, Roles
from statechart.engines.mode_table import Program, tape_of
from statechart.engines.whole_flow import Watch
from statechart.errors import NonFinite, SimulationError
from statechart.kernels.jit import part


class Switching:
    """Takes contacts off and back (see `contacts.dynamics.conditions`).

    Parameters
    ----------
    names : sequence of str
        Of the contacts.
    conditions : Conditions
        Of them.
    paradox : str
        What the scene says of states that no mode agrees with.
    """

    def __init__(self, names: Sequence[str], conditions: Conditions, paradox: Resolution) -> None:
        self._names, self._conditions, self._paradox = names, conditions, paradox

    def failing(
        self,
        setup: SceneSetup,
        snapshot: Snapshot,
        state: Array,
        time: float,
        fired: tuple[str, ...] = (),
    ) -> tuple[str, ...]:
        """Return, for every contact, a condition that fails; see `Conditions.failing`."""
        near, slow = setup.tolerances["gap"], setup.tolerances["speed"]

        def motion(failing: Sequence[bool]) -> Roles | None:
            off = tuple(
                OFF if fails or (OFF in law.states and not contact.gap >= -near) else "free"
                for fails, law, contact in zip(
                    failing, setup.contacts, snapshot.contacts, strict=True
                )
            )
            here = hidden(snapshot, off)
            # What strikes is not held before it has.
            touching = [c.gap <= near and abs(c.gap_rate) <= slow for c in here.contacts]
            try:
                choice = decide(setup, here, touching, self._paradox, Before())
            except SimulationError:
                return None
            return None if isinstance(choice, Jam) else choice.taken.roles

        return self._conditions.failing(setup, state, time, fired, motion)

    def switched(self, at: Instant, setup: SceneSetup, snapshot: Snapshot) -> dict[int, str]:
        """Return the contacts that go off, with a condition that fails, or come back, with ""."""
        if not self._conditions.present:
            return {}
        failing = self.failing(setup, snapshot, at.state, at.clock.high, at.fired)
        result: dict[int, str] = {}
        for i, (why, now) in enumerate(zip(failing, at.flow.mode, strict=True)):
            gap = snapshot.contacts[i].gap
            if why and now != OFF:
                result[i] = why
            elif not why and now == OFF:
                if math.isnan(gap):
                    raise NonFinite(
                        f"the conditions of contact {self._names[i]!r} hold where its surface has "
                        "no finite value; write one that fails there"
                    )
                if gap >= -setup.tolerances["gap"]:
                    result[i] = why
        return result

    def jump(self, at: Instant, energy: float, switched: Mapping[int, str]) -> tuple[Jump, Flow]:
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
            energy=(energy, energy),
        )
        following = flow._replace(mode=tuple(mode), roles=tuple(roles), warning="", settled=False)
        return jump, following

    def watched(
        self, setup: SceneSetup, state: Array, time: float, made: tuple[Jump | None, Flow]
    ) -> tuple[Jump | None, Flow]:
        """Give a flow from a state the round-off of conditions there.

        What a jump leaves on the boundary of a condition may go another way: it is judged again.
        """
        jump, flow = made
        own = self._conditions.tolerances(setup, state, time)
        settled = flow.settled and not (
            jump is not None and self._conditions.on_boundary(setup, state, time)
        )
        return jump, flow._replace(tolerances={**flow.tolerances, **own}, settled=settled)


@part
def hold_conditions(
    program: Program, watch: Watch, scene: SceneWatch, state: Array, time: float
) -> None:
    """Write how far below zero a flow from a state lets the margins of conditions go.

    See `contacts.dynamics.conditions.Conditions.tolerances`.
    """
    conditions = scene.owners.shape[0]
    for slot in scene.slots[conditions:]:
        if slot >= 0:
            watch.bands[slot] = math.inf
    code, constants, outputs, _, _ = tape_of(program, scene.conditions)
    values = conditions_at(
        code, constants, outputs, scene.sizes, scene.relative, state, watch.parameters, time
    )
    for k in range(conditions):
        band = round_off(values[PER_CONDITION * k + 2], scene.relative)
        own, off = scene.slots[k], scene.slots[conditions + scene.owners[k]]
        if own >= 0:
            watch.bands[own] = band
        if off >= 0:
            watch.bands[off] = min(watch.bands[off], band)


@part
def switched(
    scene: SceneWatch, values: Array, numbers: Array, first: int, fired: int, kept: Ints,
    taken: Ints,
) -> int:  # fmt: skip
    """Take contacts off or back whose conditions say so; return the first, -1 where there is none.

    -2 where further derivatives of a condition decide.

    Parameters
    ----------
    values : (4 k,) array
        Numbers of the conditions.
    numbers : (o,) array
        The scene's, those of contacts from `first` on.
    fired : int
        Number of the condition whose margin fell, from 1 on; minus that of the contact that is
        off, where that is what fell. It decides where the first derivative does not: a flow on
        whose way a margin falls did not begin on its boundary.
    kept, taken : (c,) array
        State of every contact; the latter is to be filled.

    See `contacts.dynamics.conditions.Conditions.failing`.
    """
    place, at, unsure = -1, 0, False
    for c in range(kept.shape[0]):
        taken[c] = kept[c]
    for c in range(kept.shape[0]):
        begin, fails, open_ = at, False, False
        while at < scene.owners.shape[0] and scene.owners[at] == c:
            k = PER_CONDITION * at
            verdict = judge(values[k], values[k + 1], values[k + 2], values[k + 3], scene.relative)
            if verdict == UNSURE and fired == at + 1:
                verdict = FAILS
            elif verdict == UNSURE and fired == -1 - c:
                verdict = HOLDS
            fails, open_ = fails or verdict == FAILS, open_ or verdict == UNSURE
            at += 1
        gap = numbers[first + SCALARS * c]
        if at > begin and fails:
            taken[c] = OFF_CODE
        elif kept[c] == OFF_CODE and gap >= -scene.gap:
            taken[c] = FREE
        # Where a gap has no value the laws say so.
        unsure = unsure or (not fails and (open_ or (kept[c] == OFF_CODE and gap != gap)))
        if place < 0 and taken[c] != kept[c]:
            place = c
    return -2 if unsure else place
