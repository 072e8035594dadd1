"""The jump of an impact: its impulses, the bounces that it stands for, and the mode after it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

from contacts.dynamics.conditions import hidden
from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.projection import landed
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot, SnapshotTape
from contacts.event_driven.decision import check_listed, decide, explained
from contacts.impacts.bounces import rests_of_bounces, stands_for_bounces
from contacts.impacts.jamming import Jam, closed_state, listed, without_collision
from contacts.impacts.simultaneous import Impacts, impacts
from contacts.modes.classification import Considered
from contacts.scene.parts import Resolution, Simultaneous
from contacts.states import OFF, OPEN
from statechart.automaton.laws import CAPTURED, Flow, Instant, shown_mode
from statechart.automaton.trace import Jump, Key


class Rules(NamedTuple):
    """What a scene says of impacts, and its numbers at any state."""

    tape: SnapshotTape
    simultaneous: Simultaneous
    paradox: Resolution


def flow_in(
    setup: SceneSetup,
    mode: Key,
    flow: Key | None = None,
    rest: float | None = None,
    warning: str = "",
    settled: bool = True,
    notes: tuple[str, ...] = (),
) -> Flow:
    """Return the flow in a mode; `rest` is how long the bounces last that it stands for."""
    remaining = math.inf if rest is None else rest
    moving = shown_flow(mode, flow or mode)
    return Flow(mode, moving, remaining, warning, settled, notes, tolerances=setup.bands)


def shown_flow(mode: Key, flow: Key) -> Key:
    """Return a flow with the contacts marked whose bounces are skipped: they are shown as free."""
    return tuple(
        CAPTURED + moves if shown in OPEN and moves not in OPEN else moves
        for shown, moves in zip(mode, flow, strict=True)
    )


def impact_jump(
    rules: Rules,
    at: Instant,
    setup: SceneSetup,
    snapshot: Snapshot,
    hitting: list[int],
    closed: list[bool],
    jam: Jam | None = None,
) -> tuple[Jump, Flow, Snapshot]:
    """Return the jump of an impact, the flow after it, and the numbers there.

    Parameters
    ----------
    rules : Rules
        What the scene says of impacts.
    at : Instant
        Before the impact, on the constraints of the flow.
    setup : SceneSetup
        Of the instant.
    snapshot : Snapshot
        There.
    hitting : list of int
        Contacts that strike, or are jammed.
    closed : list of bool
        Of every contact.
    jam : Jam or None
        Where it is an impact without collision.
    """
    clock, flow, state = at.clock, at.flow, at.state

    def collided(laws: Sequence[ContactLaw]) -> Impacts:
        if jam is not None:
            return without_collision(snapshot, laws, jam.places)
        return impacts(snapshot, laws, closed, rules.simultaneous)

    laws, slow = setup.contacts, setup.tolerances["speed"]
    result = collided(laws)
    after = snapshot.moved(state, result.velocity)
    following = hidden(rules.tape.at(setup.values, after, clock.high), flow.mode)
    rests = rests_of_bounces(setup, following, after, closed)
    if rests:
        plastic = tuple(
            law._replace(restitution=0.0) if i in rests else law for i, law in enumerate(laws)
        )
        captured = collided(plastic)
        stopped = snapshot.moved(state, captured.velocity)
        held = hidden(rules.tape.at(setup.values, stopped, clock.high), flow.mode)
        if stands_for_bounces(rests, following, held, closed):
            laws, result, after, following = plastic, captured, stopped, held
        else:
            rests = {}
    rates = [contact.gap_rate for contact in following.contacts]
    touching = [shut and rate <= slow for shut, rate in zip(closed, rates, strict=True)]
    considered: Mapping[str, str] = {}
    warnings = [*filter(None, ("" if jam is None else str(jam), result.warning))]
    target = moving = tuple(OFF if name == OFF else "free" for name in flow.mode)
    notes: tuple[str, ...] = ()
    # A sequence of impacts may leave an approach behind: then it is asked again.
    settled = not any(shut and rate < -slow for shut, rate in zip(closed, rates, strict=True))
    check_listed(setup, following, touching)
    if any(touching):
        choice = decide(setup, following, touching, rules.paradox)
        if isinstance(choice, Jam):
            moving, settled = choice.sliding, False
        else:
            considered, moving, notes = choice.considered, choice.taken.flow, choice.notes
            warnings += [choice.warning] if choice.warning else []
        after = landed(shown_mode(moving), following, after, setup.tolerances)
        # Where bounces are skipped the contact is still free, and moves as if closed.
        target = tuple("free" if i in rests else name for i, name in enumerate(shown_mode(moving)))
    if jam is None and not rests:
        # What is hit without rebound and thrown off by the turning of its body closes first.
        ended = tuple(
            closed_state(law, contact, 2.0 * slow)
            if i in hitting and touching[i] and target[i] == "free" and law.restitution == 0.0
            else target[i]
            for i, (law, contact) in enumerate(zip(laws, following.contacts, strict=True))
        )
        if ended != target:
            target = moving = ended
            settled = False
    target = listed(target, laws, following.contacts, 2.0 * slow)
    before, left = snapshot.energy, rules.tape.at(setup.values, after, clock.high).energy
    rest = max(rests.values(), default=None)
    jump = at.jump(
        laws[hitting[0]].name,  # whichever gap fell by a rounding earlier
        "touchdown" if jam is None else "jam",
        target,
        after,
        impulse={
            law.name: (normal, tangential)
            for law, (normal, tangential) in zip(laws, result.impulses.tolist(), strict=True)
            if normal != 0.0 or tangential != 0.0
        },
        path=result.path,
        considered=Considered(
            partial(
                explained,
                {} if jam is None else jam.considered,
                laws,
                following.contacts,
                closed,
                touching,
                considered,
            )
        ),
        energy=(before, left),
        skipped=rest or 0.0,
    )
    warning = "; ".join(warnings)
    flow = flow_in(setup, target, moving, rest, warning, settled, notes)
    # Where a long flight's rounding has left a gap below its tolerance, it opens from there.
    below = {
        f"{law.name}.gap": -2.0 * contact.gap
        for law, contact, now in zip(laws, following.contacts, shown_mode(moving), strict=True)
        if now == "free" and contact.gap < -setup.tolerances["gap"]
    }
    if below:
        flow = flow._replace(tolerances={**flow.tolerances, **below})
    return jump, flow, following
