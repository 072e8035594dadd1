"""The jump of an impact: its impulses, the bounces that it stands for, and the mode after it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from contacts.dynamics.conditions import hidden
from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.projection import landed
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot, SnapshotTape, answer
from contacts.event_driven.decision import check_listed, decide, explained
from contacts.impacts.bounces import corrected, rests_of_bounces, stands_for_bounces
from contacts.impacts.jamming import Jam, listed, struck, without_collision
from contacts.impacts.simultaneous import Impacts, impacts
from contacts.modes.classification import Before, ForceUncertainty
from contacts.scene.modes import INSIDE, OUTSIDE
from contacts.scene.parts import Resolution, Simultaneous
from contacts.states import INACTIVE, OPEN
from statechart.arrays import Array
from statechart.automaton.laws import Flow, Instant, moving_mode, roles_in
from statechart.automaton.lazy import LazyMapping
from statechart.automaton.trace import Jump, Key, Roles
from statechart.errors import NoConsistentMode

# Margins of a contact that are none of its forces.
_NO_FORCES = ("gap", "slip", INSIDE, OUTSIDE)


class Rules(NamedTuple):
    """Laws of impact of a scene, and its numbers at any state."""

    tape: SnapshotTape
    simultaneous: Simultaneous
    paradox: Resolution

    def uncertainty(self, here: Landing, after: Array | None = None) -> ForceUncertainty | None:
        """Return what a state may be off by where a flow has just ended, or after an impact there.

        None where a mode has been chosen meanwhile.
        """
        at, names = here.at, [law.name for law in here.setup.contacts]
        if not at.fired and not at.flow.near_bound:
            return None

        def numbers(state: Array, later: float) -> Snapshot:
            found = self.tape.at(here.setup.values, state, at.clock.high + later)
            return hidden(found, at.flow.mode)

        sure = tuple(["free"] * len(names)) if at.flow.near_bound else here.moving
        off = tuple(f"{name}.{state}:" for name in names for state in INACTIVE)
        others = tuple(f"{name}.{kind}" for name in names for kind in _NO_FORCES)
        fell = [
            i
            for i, name in enumerate(names)
            if any(
                f.startswith(f"{name}.") and f not in others and not f.startswith(off)
                for f in at.fired
            )
        ]
        state = at.state if after is None else after
        return ForceUncertainty(numbers, here.setup, state, sure, fell)


class Landing(NamedTuple):
    """End of a flow on its constraints, and the numbers of the scene there."""

    at: Instant  # On the constraints.
    setup: SceneSetup  # Numbers of the run.
    snapshot: Snapshot  # There.
    moving: Key  # The mode that the flow moves in.
    closed: list[bool]  # Mask of the closed contacts.

    @property
    def slow(self) -> float:
        """Speeds up to this are none."""
        return self.setup.tolerances["speed"]

    @property
    def hitting(self) -> list[int]:
        """The closed contacts that approach."""
        contacts = enumerate(self.snapshot.contacts)
        return [i for i, c in contacts if self.closed[i] and c.gap_rate < -self.slow]


class _Struck(NamedTuple):
    """Result of an impact."""

    laws: Sequence[ContactLaw]  # By which it went.
    result: Impacts  # Its impulses.
    # After it.
    state: Array
    snapshot: Snapshot
    rests: Mapping[int, float]  # Contact -> how long the bounces last that it stands for.


class _Entered(NamedTuple):
    """The mode that follows: as shown, as it moves, and what there is to say of it."""

    target: Key
    roles: Roles
    state: Array
    settled: bool
    considered: Mapping[str, str] = MappingProxyType({})
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    near_bound: bool = False


def flow_in(
    setup: SceneSetup,
    mode: Key,
    roles: Roles | None = None,
    rest: float | None = None,
    warning: str = "",
    settled: bool = True,
    notes: tuple[str, ...] = (),
) -> Flow:
    """Return the flow in a mode; `rest` is how long the bounces last that it stands for."""
    remaining = math.inf if rest is None else rest
    moving = roles_in(mode) if roles is None else shown_roles(mode, roles)
    return Flow(mode, moving, remaining, warning, settled, notes, tolerances=setup.bands)


def shown_roles(mode: Key, roles: Roles) -> Roles:
    """Return roles with the contacts captured whose bounces are skipped: they are shown as free."""
    return tuple(
        [
            role._replace(captured=True) if shown in OPEN and role.state not in OPEN else role
            for shown, role in zip(mode, roles, strict=True)
        ]
    )


def impact_jump(
    rules: Rules, here: Landing, event: tuple[str, str], jam: Jam | None = None
) -> tuple[Jump, Flow, Snapshot]:
    """Return the jump of an impact, the flow after it, and the numbers there.

    `event` is the region and the cause of the jump.
    """
    at, setup, closed, slow = here.at, here.setup, here.closed, here.slow
    struck = _struck(rules, here, jam)
    laws, contacts, rests = struck.laws, struck.snapshot.contacts, struck.rests
    touching = [
        shut and contact.gap_rate <= slow for shut, contact in zip(closed, contacts, strict=True)
    ]
    entered = _entered(rules, here, struck, touching)
    target = listed(entered.target, laws, contacts, 2.0 * slow)
    left = rules.tape.at(setup.values, entered.state, at.clock.high).energy
    rest = max(rests.values(), default=None)
    jump = at.jump(
        *event,
        target,
        entered.state,
        impulse={
            law.name: (normal, tangential)
            for law, (normal, tangential) in zip(laws, struck.result.impulses.tolist(), strict=True)
            if normal != 0.0 or tangential != 0.0
        },
        path=struck.result.path,
        considered=LazyMapping(
            partial(
                explained,
                {} if jam is None else jam.considered,
                laws,
                contacts,
                closed,
                touching,
                entered.considered,
            )
        ),
        energy=(here.snapshot.energy, left),
        skipped=rest or 0.0,
    )
    told = ("" if jam is None else str(jam), struck.result.warning, *entered.warnings)
    warning = "; ".join(filter(None, told))
    flow = flow_in(setup, target, entered.roles, rest, warning, entered.settled, entered.notes)
    flow = flow._replace(near_bound=entered.near_bound)
    # A gap that round-off of a long flight has left below its tolerance opens from there.
    below = {
        f"{law.name}.gap": -2.0 * contact.gap
        for law, contact, now in zip(laws, contacts, moving_mode(entered.roles), strict=True)
        if now == "free" and contact.gap < -setup.tolerances["gap"]
    }
    if below:
        flow = flow._replace(tolerances={**flow.tolerances, **below})
    return jump, flow, struck.snapshot


def _struck(rules: Rules, here: Landing, jam: Jam | None) -> _Struck:
    """Return what the impact does; bounces that follow it are summed where they can be."""
    (_, clock, _, flow, state, _), setup, snapshot, _, closed = here

    def under(laws: Sequence[ContactLaw], rests: Mapping[int, float]) -> _Struck:
        if jam is not None:
            result = without_collision(snapshot, laws, jam.places)
        else:
            result = impacts(snapshot, laws, struck(laws, closed), rules.simultaneous)
        result = resisted(snapshot, laws, result, 2.0 * here.slow)
        after = snapshot.moved(state, result.velocity)
        following = hidden(rules.tape.at(setup.values, after, clock.high), flow.mode)
        return _Struck(laws, result, after, following, rests)

    made = under(setup.contacts, {})
    rests = rests_of_bounces(setup, made.snapshot, closed)
    if not rests:
        return made
    plastic = tuple(
        law._replace(restitution=0.0) if i in rests else law for i, law in enumerate(made.laws)
    )
    try:
        captured = under(plastic, rests)
    except NoConsistentMode:
        # Friction jams a plastic impact: the bounces are resolved.
        return made
    if not stands_for_bounces(rests, made.snapshot, captured.snapshot, closed):
        return made
    lasting = corrected(
        rests,
        setup,
        lambda state, later: hidden(
            rules.tape.at(setup.values, state, clock.high + later), flow.mode
        ),
        made.snapshot,
        captured.snapshot,
        captured.state,
        closed,
    )
    return made if lasting is None else captured._replace(rests=lasting)


def _entered(rules: Rules, here: Landing, struck: _Struck, touching: list[bool]) -> _Entered:
    """Return the mode that the state after an impact calls for."""
    setup, following = here.setup, struck.snapshot
    # A sequence of impacts may leave an approach behind: then it is asked again.
    settled = not any(
        shut and contact.gap_rate < -here.slow
        for shut, contact in zip(here.closed, following.contacts, strict=True)
    )
    check_listed(setup, following, touching)
    if not any(touching):
        flying = tuple(name if name in INACTIVE else "free" for name in here.at.flow.mode)
        return _Entered(flying, roles_in(flying), struck.state, settled)
    uncertainty = rules.uncertainty(here, struck.state)
    before = Before.flow(here.at.flow.roles)
    choice = decide(setup, following, touching, rules.paradox, before, uncertainty)
    roles = roles_in(choice.sliding) if isinstance(choice, Jam) else choice.taken.roles
    moving = moving_mode(roles)
    state = landed(moving, following, struck.state, setup.tolerances)
    # A contact whose bounces are skipped is still free, and moves as if closed.
    target = tuple(
        "free" if not struck.rests.keys().isdisjoint((i, law.carrier)) else name
        for i, (name, law) in enumerate(zip(moving, struck.laws, strict=True))
    )
    if isinstance(choice, Jam):
        return _Entered(target, roles, state, settled=False)
    said = choice.considered, (choice.warning,), choice.notes, choice.near_bound
    return _Entered(target, roles, state, settled, *said)


def resisted(
    snapshot: Snapshot, laws: Sequence[ContactLaw], result: Impacts, still_below: float
) -> Impacts:
    """Return the impacts of an instant with the couples of rolling resistance.

    The couple is at most a length times the normal impulse; it opposes the rotation that the impact
    leaves, and reverses none. A contact that sticks afterwards goes on to stick, if friction gives
    what that takes; so does one that does not rebound stay closed. Speeds up to `still_below` are
    zero.
    """
    for place, law in enumerate(laws):
        if law.carrier < 0 or not result.impulses[law.carrier, 0] > 0.0:
            continue
        _, bound = (snapshot.limits[place - len(laws)] * result.impulses[law.carrier, 0]).tolist()
        touching, cone = snapshot.contacts[law.carrier], laws[law.carrier]
        change = result.velocity - snapshot.velocity
        slip = snapshot.contacts[place].slip + float(snapshot.jacobians[place, 1] @ change)
        if not abs(slip) > still_below or bound == 0.0:
            continue
        after = [
            rate + float(row @ change)
            for rate, row in zip((touching.gap_rate, touching.slip), touching.jacobian, strict=True)
        ]
        kept = [d for d in range(2) if abs(after[d]) <= still_below]
        # Once more without the tangent, where friction does not hold the point.
        for held in (kept, [d for d in kept if d == 0]):
            rows = np.array([snapshot.jacobians[place, 1], *(touching.jacobian[d] for d in held)])
            solved = answer(snapshot, rows, rows, np.array([-slip, *(0.0 for _ in held)]))
            if solved is None:
                continue
            part = min(1.0, bound / abs(solved[1][0])) if solved[1][0] != 0.0 else 1.0
            impulses = result.impulses.copy()
            for d, impulse in zip(held, solved[1][1:].tolist(), strict=True):
                impulses[law.carrier, d] += part * impulse
            normal, tangential = impulses[law.carrier].tolist()
            if 1 not in held or cone.cone_n * abs(tangential) <= cone.cone_t * normal:
                velocity = result.velocity + part * solved[0]
                result = replace(result, velocity=velocity, impulses=impulses)
                break
    return result
