"""Modes of contacts after a jump of a controller, or of parameters, that moves their surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from contacts.dynamics.conditions import Conditions
from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SnapshotTape
from contacts.scene.expansion import Reach, Stop
from contacts.scene.scene import Scene
from contacts.states import OFF, OPEN
from statechart.arrays import Array, Bools
from statechart.automaton.laws import Flow, roles_in
from statechart.automaton.trace import Key
from statechart.errors import NoConsistentMode

JUMP_ADVICE = (
    "set its velocity instead, by a path such as v*(time - t0), or by a variable that flows"
)
"""Advice on places that jump."""


class ParameterChange(NamedTuple):
    """A change of parameters at a state: their values before, and the setup after."""

    before: Array  # (p,)
    setup: SceneSetup
    state: Array
    time: float


def modes_after_jump(
    scene: Scene,
    laws: Sequence[ContactLaw],
    tolerances: Mapping[str, float],
    mode: Key,
    before: Array,
    after: Array,
) -> tuple[Key, Bools, Bools]:
    """Return the modes of the contacts after a jump, and which (c,) separate, or are struck, in it.

    `before` and `after` (c, 3) are gaps, gap rates and slips. Contacts that no longer hold open,
    and are classified next: a surface that approaches strikes, one that departs leaves the contact
    free.

    Raises `NoConsistentMode` if a surface jumps into a point, or if its velocity jumps and the
    contact may not leave it.
    """
    near, slow = tolerances["gap"], tolerances["speed"]
    # Approach and departure count relative to the motion before the jump.
    gap_jumps, rate_jumps, slip_jumps = (np.abs(after - before) > (near, slow, slow)).T
    # Compliant contacts follow their surface by force alone; couplings have none.
    rigid = np.array(
        [not law.coupling and scene.contacts[law.name].stiffness is None for law in laws], np.bool_
    )
    separates, modes = rigid & (gap_jumps | rate_jumps), list(mode)
    closed = np.array([state not in OPEN for state in mode], np.bool_)
    strikes = separates & closed & (after[:, 0] <= near) & (after[:, 1] < -slow)
    for i, (law, state) in enumerate(zip(laws, mode, strict=True)):
        gap, slip = float(after[i, 0]), float(after[i, 2])
        if rigid[i] and state != OFF and gap < min(float(before[i, 0]), 0.0) - near:
            raise _displacement_error(scene, law.name, -gap)
        if state in OPEN or law.coupling:
            continue
        if separates[i]:
            modes[i] = "free"
        elif slip_jumps[i] and state != "slide" and abs(slip) > slow:
            modes[i] = "slide+" if slip > 0.0 else "slide-"
        if modes[i] != state and modes[i] not in law.states:
            surface = scene.contacts[law.name].surface
            raise NoConsistentMode(
                f"the velocity of surface {surface!r} jumps, and {law.name!r} would "
                f"be {modes[i]}, which is not among its modes; add it, or let the velocity flow"
            )
    return tuple(modes), separates, strikes


def modes_after_change(
    scene: Scene, mode: Key, tape: SnapshotTape, conditions: Conditions, change: ParameterChange
) -> tuple[Key, Bools, Bools]:
    """Return `modes_after_jump` for a change of parameters.

    A contact that the new values switch off separates, wherever its surface moves, and keeps its
    mode. Raises `NoConsistentMode` as that, and if a closed joint opens.
    """
    before, setup, at = change.before, change.setup, (change.state, change.time)
    old, new = (tape.at(values, *at) for values in (before, setup.values))
    if old.reduction is not None and new.reduction is not None:
        a, b = old.reduction.joints, new.reduction.joints
        for what, kind, jumps in (
            ("position", "gap", b.gaps - a.gaps), ("velocity", "speed", b.rates - a.rates)
        ):  # fmt: skip
            opens = np.flatnonzero(a.on & b.on & (np.abs(jumps) > setup.tolerances[kind]))
            if len(opens):
                joint = tape.joint_names[opens[0]].partition(".")[0]
                raise NoConsistentMode(
                    f"the new values of parameters let the {what} that joint {joint!r} holds "
                    "jump; let a variable of a controller flow there"
                )
    failed, fails = (
        np.array([*map(bool, conditions.at(s, *at).failing())], np.bool_)
        for s in (replace(setup, values=before), setup)
    )
    ends = fails & ~failed
    compared = tuple(np.where(ends, OFF, mode).tolist())
    after, separates, strikes = modes_after_jump(
        scene, setup.contacts, setup.tolerances, compared, old.rates, new.rates
    )
    return tuple(np.where(ends, mode, after).tolist()), separates | ends, strikes


def flow_after_move(flow: Flow, mode: Key) -> Flow:
    """Return the flow of contacts in the modes that `modes_after_jump` returns."""
    roles = zip(flow.mode, mode, flow.roles, roles_in(mode), strict=True)
    moved = tuple(role if a == b else other for a, b, role, other in roles)
    return flow._replace(mode=mode, roles=moved, settled=False)


def _displacement_error(scene: Scene, contact: str, depth: float) -> NoConsistentMode:
    surface, name = scene.surface_of(contact), scene.contacts[contact].surface
    problem = f"surface {name!r} jumps {depth:.3g} deep into the point of {contact!r}"
    if isinstance(surface, Reach):
        problem = f"rope {contact!r} jumps to {depth:.3g} below the distance of its ends"
    elif isinstance(surface, Stop):
        problem = f"limit {contact!r} jumps past the angle of its joint"
    return NoConsistentMode(f"{problem}; {JUMP_ADVICE}")
