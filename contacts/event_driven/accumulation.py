"""Zeno accumulation of alternating impacts at several contacts: the state at its end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import compress

import numpy as np

from contacts.dynamics.conditions import hidden
from contacts.dynamics.contact_law import sliding_edge
from contacts.dynamics.projection import constraint_key, landed, on_constraints
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot, answer
from contacts.event_driven.decision import choose_mode
from contacts.event_driven.impact_jump import flow_in
from contacts.impacts.jamming import Jam, strike_jammed
from contacts.impacts.simultaneous import impacts
from contacts.states import INACTIVE, OPEN
from statechart.arrays import Array
from statechart.automaton.laws import Flow, moving_mode
from statechart.automaton.trace import Jump, Key
from statechart.errors import NoConsistentMode, SingularMode

# Height of the flights, relative to the length, below which alternating impacts are skipped: with
# sliding points, whose paths are then wrong by about the height, and without, where nothing is lost
# (later impacts would have fewer correct digits).
_MAX_HEIGHT, _MAX_HEIGHT_AT_REST = 1e-10, 1e-7
# Largest ratio of the velocity change with friction to that without: beyond it contacts jam.
_MAX_MAGNIFICATION = 30.0


def close_immediately(
    setup: SceneSetup,
    at: Callable[[Array], Snapshot],
    flow: Flow,
    jump: Jump,
    took_part: Sequence[bool],
    period: float,
    remaining: float,
) -> tuple[Jump, Flow] | None:
    """Close the contacts that `took_part` at once; return the last jump and the flow after it.

    Returns None while the flights are too high. Example: a light ball between the floor and a heavy
    body that comes down on it. `jump` is the last impact and `flow` follows it; `period` is the
    time since the previous impact at the same contact, `remaining` the duration of further impacts.
    """
    state = jump.after
    snapshot = hidden(at(state), flow.mode)
    took = [one and mode not in INACTIVE for one, mode in zip(took_part, flow.mode, strict=True)]
    rates = [contact.gap_rate for contact in compress(snapshot.contacts, took)]
    if not rates:
        return None
    height, gap_tolerance = max(rates) * period / 4.0, setup.tolerances["gap"]
    before = moving_mode(flow.roles)
    closing = [one or mode not in OPEN for one, mode in zip(took, before, strict=True)]
    modes = zip(before, closing, strict=True)
    key = tuple("slide" if closes and mode in OPEN else mode for mode, closes in modes)
    warnings = []
    if min(rates) < -setup.tolerances["speed"]:
        early = remaining > 0.0 and height > gap_tolerance
        low = max(_MAX_HEIGHT * setup.scales.length, gap_tolerance)
        if early and (height > low or _moves_tangentially(key, at(state), state, setup)):
            return None
        try:
            sequence = impacts(snapshot, setup.contacts, took, "sequential")
        except NoConsistentMode:
            return None
        warnings.append(sequence.warning)
        state = snapshot.moved(state, sequence.velocity)
        snapshot = at(state)
    settled_velocity = _velocity_after_impacts(setup, snapshot, closing)
    if settled_velocity is not None:
        state = snapshot.moved(state, settled_velocity)
    state = on_constraints(key, at(state), state)
    snapshot = hidden(at(state), flow.mode)
    struck = compress(snapshot.contacts, strike_jammed(setup.contacts, closing))
    slides = any(abs(contact.slip) > setup.slip_tolerance for contact in struck)
    undetermined = slides and settled_velocity is None
    lowest = 0.0 if undetermined else _MAX_HEIGHT if slides else _MAX_HEIGHT_AT_REST
    if remaining > 0.0 and height > max(lowest * setup.scales.length, gap_tolerance):
        return None
    if undetermined:
        warnings.append(
            "the friction impulse of the summed bounces is undetermined and set to zero"
        )
    choice = choose_mode(setup, snapshot, closing)
    if isinstance(choice, Jam):
        return None
    roles = choice.roles
    after = landed(constraint_key(roles, snapshot.soft), snapshot, state, setup.tolerances)
    warning = "; ".join(filter(None, warnings))
    # If no mode is left to change (a bar that rattles over a crest opens all contacts; the last of
    # several rods closes at this impact), there is no time to wait.
    wait = None if moving_mode(roles) == flow.mode else remaining
    following = flow_in(setup, flow.mode, choice, wait, warning)
    energy = None if jump.energy is None else (jump.energy[0], snapshot.energy)
    return replace(jump, after=after, energy=energy, skipped=remaining), following


def _moves_tangentially(key: Key, snapshot: Snapshot, state: Array, setup: SceneSetup) -> bool:
    """Return whether projecting the gaps of `key` to zero would move a contact tangentially."""
    displacement = (on_constraints(key, snapshot, state) - state)[: snapshot.size]
    closed = [mode not in OPEN for mode in key]
    moves = np.abs(snapshot.unreduced.jacobians[closed, 1] @ displacement)
    return bool((moves > setup.tolerances["gap"]).any())


def _velocity_after_impacts(
    setup: SceneSetup, snapshot: Snapshot, closing: Sequence[bool]
) -> Array | None:
    """Return the velocity (n,) after all alternating impacts, without the effect of other forces.

    In any order, impulses of a sliding contact lie along the edge of its cone and those of a
    sticking one keep its point in place, so that their sums follow from zero gap rates at the end.
    Returns None if the sums are not unique, if a slip would reverse, or if friction multiplies the
    velocity change: a contact then stops sliding before the end.
    """
    rows, columns, slides = list[Array](), list[Array](), list[tuple[float, Array]]()
    rates: list[float] = []
    contacts = zip(setup.contacts, snapshot.contacts, snapshot.jacobians, strict=True)
    for law, contact, (normal, tangent) in compress(contacts, closing):
        if law.coupling:
            continue
        rows.append(normal)
        rates.append(-contact.gap_rate)
        if abs(contact.slip) > setup.slip_tolerance or "pin" not in law.states:
            cone_n, cone_t = sliding_edge(law, contact)
            columns.append(cone_n * normal - np.sign(contact.slip) * cone_t * tangent)
            slides.append((contact.slip, tangent))
        else:
            rows.append(tangent)
            rates.append(-contact.slip)
            columns += [normal, tangent]
    try:
        solve = partial(answer, snapshot, np.array(rows), rates=np.array(rates))
        solved, smooth = solve(np.array(columns)), solve(np.array(rows))
    except SingularMode:
        return None
    if solved is None or smooth is None:
        return None
    change, frictionless = solved[0], smooth[0]
    sizes = [math.sqrt(float(dv @ snapshot.mass @ dv)) for dv in (change, frictionless)]
    backs = [(slip + tangent @ change) * np.sign(slip) for slip, tangent in slides]
    if min(backs, default=0.0) < -setup.slip_tolerance or sizes[0] > _MAX_MAGNIFICATION * sizes[1]:
        return None
    return snapshot.velocity + change
