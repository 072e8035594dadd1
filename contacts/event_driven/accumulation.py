"""Impacts in turn at several contacts whose intervals shrink to nothing: what they come to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from contacts.dynamics.conditions import hidden
from contacts.dynamics.contact_law import ContactLaw, sliding_edge
from contacts.dynamics.projection import landed, on_constraints
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import PerContact, Snapshot, answer
from contacts.event_driven.decision import decide
from contacts.event_driven.impact_jump import flow_in
from contacts.impacts.jamming import Jam, struck
from contacts.impacts.simultaneous import impacts
from contacts.scene.parts import Resolution
from contacts.states import INACTIVE, OPEN
from statechart.arrays import Array
from statechart.automaton.laws import Flow, moving_mode, roles_in
from statechart.automaton.trace import Jump, Key
from statechart.errors import NoConsistentMode, SingularMode

# Impacts in turn are skipped once contacts fly no higher than this part of the length. Where
# points slide meanwhile, the path that they are given is wrong by the height; where none does,
# nothing is lost, and later impacts would be known to fewer digits only.
_LOW, _LOW_AT_REST = 1e-10, 1e-7
# So many times what is changed without friction it may change with it: beyond, contacts jam.
_MAGNIFIED = 30.0


def closed_at_once(
    setup: SceneSetup,
    at: Callable[[Array], Snapshot],
    flow: Flow,
    jump: Jump,
    took_part: Sequence[bool],
    period: float,
    rest: float,
    paradox: Resolution,
) -> tuple[Jump, Flow] | None:
    """Close the contacts that took part; return the last jump and the flow after it, changed.

    None where it is too early for that.

    What impacts in turn do to bodies that stay where they are (a light ball between the floor and a
    heavy one that comes down) is done at once. `jump` is the last impact and `flow` follows it;
    `period` is the time since the impact before at the same contact, `rest` the time that further
    impacts would take.
    """
    state = jump.after
    snapshot = hidden(at(state), flow.mode)
    took_part = [
        part and now not in INACTIVE for part, now in zip(took_part, flow.mode, strict=True)
    ]
    rates = [c.gap_rate for c, part in zip(snapshot.contacts, took_part, strict=True) if part]
    if not rates:
        return None
    height, near = max(rates) * period / 4.0, setup.tolerances["gap"]
    before = moving_mode(flow.roles)
    shut = [part or now not in OPEN for part, now in zip(took_part, before, strict=True)]
    key = tuple(
        "slide" if closed and now in OPEN else now for now, closed in zip(before, shut, strict=True)
    )
    warnings = []
    if min(rates) < -setup.tolerances["speed"]:
        early = rest > 0.0 and height > near
        low = max(_LOW * setup.scales.length, near)
        if early and (height > low or _pushed_aside(key, at(state), state, setup)):
            return None
        try:
            sequence = impacts(snapshot, setup.contacts, took_part, "sequential")
        except NoConsistentMode:
            return None
        warnings.append(sequence.warning)
        state = snapshot.moved(state, sequence.velocity)
        snapshot = at(state)
    still = 2.0 * setup.tolerances["speed"]
    left = _settled(snapshot, setup.contacts, struck(setup.contacts, shut), still)
    if left is not None:
        state = snapshot.moved(state, left)
    state = on_constraints(key, at(state), state)
    snapshot = hidden(at(state), flow.mode)
    slides = any(
        abs(c.slip) > still
        for c, closed in zip(snapshot.contacts, struck(setup.contacts, shut), strict=True)
        if closed
    )
    lowest = _LOW_AT_REST if not slides else _LOW if left is not None else 0.0
    if rest > 0.0 and height > max(lowest * setup.scales.length, near):
        return None
    if left is None and slides:
        warnings.append(
            "the friction impulse of the summed bounces is undetermined, and is left out"
        )
    choice = decide(setup, snapshot, shut, paradox)
    if isinstance(choice, Jam):
        return None
    after = landed(choice.taken.states, snapshot, state, setup.tolerances)
    warning = "; ".join(filter(None, (*warnings, choice.warning)))
    roles = choice.taken.roles
    # A bar that rattles over a crest takes off from it: there is nothing to wait for.
    wait = None if roles == roles_in(flow.mode) else rest
    following = flow_in(setup, flow.mode, roles, wait, warning, notes=choice.notes)
    energy = None if jump.energy is None else (jump.energy[0], snapshot.energy)
    return replace(jump, after=after, energy=energy, skipped=rest), following


def _pushed_aside(key: Key, snapshot: Snapshot, state: Array, setup: SceneSetup) -> bool:
    """Return whether closing the gaps of `key` would move a contact along its surface.

    What comes down closes the gap by itself in the time left, and no light body below makes way.
    """
    moved = (on_constraints(key, snapshot, state) - state)[: len(state) // 2]
    return any(
        abs(float(contact.jacobian[1] @ moved)) > setup.tolerances["gap"]
        for contact, now in zip(snapshot.whole.contacts, key, strict=True)
        if now not in OPEN
    )


def _settled(
    snapshot: Snapshot, laws: Sequence[ContactLaw], shut: Sequence[bool], still_below: float
) -> Array | None:
    """Return the velocity (n,) that impacts in turn leave, besides what forces do meanwhile.

    Whatever their order, the impulses of a contact that slides lie along the edge of its cone,
    those of one that sticks keep its point in place; so their sums follow from the gaps' rates
    being zero afterwards. None where they do not, as with more contacts than motions, or where a
    slip would be reversed or friction change far more than without it: then one of them does not
    slide to the end. Without friction, `contacts.dynamics.projection.on_constraints` gives the
    same.
    """
    rows: list[Array] = []
    columns: list[Array] = []
    rates: list[float] = []
    slides: list[PerContact] = []
    for law, contact, closed in zip(laws, snapshot.contacts, shut, strict=True):
        if not closed:
            continue
        normal, tangent = contact.jacobian
        rows.append(normal)
        rates.append(-contact.gap_rate)
        if abs(contact.slip) > still_below or "pin" not in law.states:
            cone_n, cone_t = sliding_edge(law, contact)
            columns.append(cone_n * normal - np.sign(contact.slip) * cone_t * tangent)
            slides.append(contact)
        else:
            rows.append(tangent)
            rates.append(-contact.slip)
            columns += [normal, tangent]
    change = _change(snapshot, rows, columns, rates)
    bare = _change(snapshot, rows, rows, rates)
    if change is None or bare is None:
        return None
    sizes = [math.sqrt(float(dv @ snapshot.mass @ dv)) for dv in (change, bare)]
    turned = any(
        (contact.slip + contact.jacobian[1] @ change) * np.sign(contact.slip) < -still_below
        for contact in slides
    )
    return None if turned or sizes[0] > _MAGNIFIED * sizes[1] else snapshot.velocity + change


def _change(
    snapshot: Snapshot, rows: Sequence[Array], columns: Sequence[Array], rates: Sequence[float]
) -> Array | None:
    """Return the change of velocity by impulses along `columns` that changes `rows` by `rates`."""
    try:
        solved = answer(snapshot, np.array(rows), np.array(columns), np.array(rates))
    except SingularMode:
        return None
    return None if solved is None else solved[0]
