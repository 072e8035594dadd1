"""Contacts on surfaces that a transition of a controller displaces, or whose velocity it changes.

The path of a surface may jump with what controllers remember or set, and so may its velocity. What
no longer holds is opened by the jump itself, and judged again after it: a point that a surface then
approaches is struck, one that it leaves is free.
"""

from __future__ import annotations

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.dynamics.starting import jumped_in, torn
from contacts.scene.scene import Scene
from contacts.states import OFF, OPEN
from statechart.automaton.trace import Key


def displaced(scene: Scene, setup: SceneSetup, mode: Key, before: Snapshot, after: Snapshot) -> Key:
    """Return the modes of the contacts after a jump that may have moved their surfaces.

    Raises `NoConsistentMode` where a surface jumps into a point, or its velocity jumps under one
    that may not leave it.
    """
    near, slow = setup.tolerances["gap"], setup.tolerances["speed"]
    laws = zip(setup.contacts, mode, before.contacts, after.contacts, strict=True)
    found = []
    for law, state, was, now in laws:
        # Couplings touch no surface; forces of compliant contacts follow whatever a surface does.
        if law.name not in scene.contacts or scene.contacts[law.name].stiffness is not None:
            found.append(state)
            continue
        # Where the surface begins to approach, or to leave, is judged by what it did before.
        parts = abs(now.gap - was.gap) > near or abs(now.gap_rate - was.gap_rate) > slow
        touches = state not in OPEN
        if state != OFF and now.gap < min(was.gap, 0.0) - near:
            raise jumped_in(scene.contacts[law.name].surface, law.name, -now.gap)
        target = state
        if touches and parts:
            target = "free"
        elif touches and abs(now.slip - was.slip) > slow:
            target = _slipping(state, now, slow)
        if target != state and target not in law.states:
            raise torn(scene.contacts[law.name].surface, law.name, target)
        found.append(target)
    return tuple(found)


def _slipping(state: str, now: PerContact, slow: float) -> str:
    """Return how a contact goes on whose surface changes its velocity along itself."""
    if state == "slide":
        return state
    if abs(now.slip) <= slow:
        # It is judged from a slip that has ended.
        return state
    return "slide+" if now.slip > 0.0 else "slide-"
