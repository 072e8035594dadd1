"""Modes of contacts after a jump of a controller that moves or accelerates their surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.scene.expansion import reach_of
from contacts.scene.scene import Scene
from contacts.states import OFF, OPEN
from statechart.arrays import Array, Bools
from statechart.automaton.trace import Key
from statechart.errors import NoConsistentMode


def modes_after_jump(
    scene: Scene,
    laws: Sequence[ContactLaw],
    tolerances: Mapping[str, float],
    mode: Key,
    before: Array,
    after: Array,
) -> tuple[Key, Bools]:
    """Return the modes of the contacts after a jump, and which rigid ones (c,) separate in it.

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
    for i, (law, state) in enumerate(zip(laws, mode, strict=True)):
        gap, slip = float(after[i, 0]), float(after[i, 2])
        if rigid[i] and state != OFF and gap < min(float(before[i, 0]), 0.0) - near:
            raise _displacement_error(scene.contacts[law.name].surface, law.name, -gap)
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
    return tuple(modes), separates


def _displacement_error(surface: str, contact: str, depth: float) -> NoConsistentMode:
    problem = f"surface {surface!r} jumps {depth:.3g} deep into the point of {contact!r}"
    if surface == reach_of(contact):
        problem = f"rope {contact!r} jumps to {depth:.3g} below the distance of its ends"
    return NoConsistentMode(
        f"{problem}; write a path that moves there in a time, or let a variable flow"
    )
