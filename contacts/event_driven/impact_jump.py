"""Jump of an impact: impulses, bounces that are summed in it, and the mode after it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from contacts.dynamics.conditions import hidden_at
from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.projection import constraint_key, landed
from contacts.dynamics.rolling_resistance import apply_rolling_resistance, couples
from contacts.dynamics.setup import SceneInstant, SceneSetup
from contacts.dynamics.snapshot import Snapshot, SnapshotTape
from contacts.event_driven.decision import check_listed, choose_mode, explain_choice
from contacts.impacts.bounces import correct_durations, remaining_bounces, stands_for_bounces
from contacts.impacts.jamming import Jam, impact_without_collision, listed_mode, strike_jammed
from contacts.impacts.simultaneous import Impacts, impacts
from contacts.modes.classification import Before, Choice, ForceUncertainty
from contacts.scene.modes import OUTSIDE, PULL
from contacts.states import INACTIVE, OPEN
from statechart.arrays import Array
from statechart.automaton.laws import Flow, moving_mode, roles_in
from statechart.automaton.lazy import LazyMapping
from statechart.automaton.trace import Jump, Key, Roles
from statechart.errors import NoConsistentMode

# Margins of a contact that position and velocity determine, as they do the pull of a compliant one.
_KINEMATIC_MARGINS = ("gap", "slip", PULL, OUTSIDE)


class Landing(NamedTuple):
    """End of a flow, projected onto its constraints."""

    at: SceneInstant  # With the projected state.
    snapshot: Snapshot  # At the projected state.
    moving: Key  # The mode in which the flow moves.
    closed: list[bool]  # Mask of the closed contacts.

    @property
    def slow(self) -> float:
        """Tolerance of speeds."""
        return self.at.setup.tolerances["speed"]

    @property
    def hitting(self) -> list[int]:
        """The closed contacts that approach."""
        return self.snapshot.approaching(self.closed, self.slow)


def uncertainty_at(
    tape: SnapshotTape, landing: Landing, after: Array | None = None
) -> ForceUncertainty | None:
    """Return the uncertainty of forces at the end of a flow, or after an impact there.

    Returns None if a mode has been chosen since.
    """
    at, names = landing.at, [law.name for law in landing.at.setup.contacts]
    if not at.fired and at.flow.terms is None and not at.flow.near_bound:
        return None
    around = hidden_at(tape, at.setup.values, at.clock.high, at.flow.mode)
    certain_modes = ("free",) * len(names) if at.flow.near_bound else landing.moving
    # Margins of contacts that are off are `NAME.off: RELATION`.
    off = tuple(f"{state}:" for state in INACTIVE)
    fired = [margin.partition(".") for margin in at.fired]
    forces = {n for n, _, x in fired if x not in _KINEMATIC_MARGINS and not x.startswith(off)}
    uncertain = [i for i, name in enumerate(names) if name in forces]
    state = at.state if after is None else after
    return ForceUncertainty(around, at.setup, state, certain_modes, uncertain)


class _Struck(NamedTuple):
    """Result of an impact."""

    laws: Sequence[ContactLaw]  # The impact laws used.
    result: Impacts  # Impulses.
    state: Array  # After the impact.
    snapshot: Snapshot  # After the impact.
    bounce_times: Mapping[int, float]  # Contact -> duration of the bounces that are summed.


def flow_in(
    setup: SceneSetup,
    mode: Key,
    moved_by: Choice | Roles | None = None,
    bounce_time: float | None = None,
    warning: str = "",
    settled: bool = True,
) -> Flow:
    """Return the flow shown as a mode, with the equations of a choice, of roles, or of the mode.

    `bounce_time` is the duration of the bounces summed before it; the warning of the choice follows
    `warning`.
    """
    remaining = math.inf if bounce_time is None else bounce_time
    if not isinstance(moved_by, Choice):
        roles = roles_in(mode) if moved_by is None else mark_captured_roles(mode, moved_by)
        return Flow(mode, roles, remaining, warning, settled, tolerances=setup.bands)
    warning = "; ".join(filter(None, (warning, moved_by.warning)))
    tolerances = {**setup.bands, **moved_by.tolerances} if moved_by.tolerances else setup.bands
    roles, notes = mark_captured_roles(mode, moved_by.roles), moved_by.notes
    flow = Flow(mode, roles, remaining, warning, settled, notes, tolerances=tolerances)
    return flow._replace(near_bound=moved_by.near_bound)


def mark_captured_roles(mode: Key, roles: Roles) -> Roles:
    """Mark contacts as captured that move as closed and are shown as free (skipped bounces)."""
    return tuple([
        role._replace(captured=True) if shown in OPEN and role.state not in OPEN else role
        for shown, role in zip(mode, roles, strict=True)
    ])  # fmt: skip


def impact_jump(
    tape: SnapshotTape,
    landing: Landing,
    event: tuple[str, str],
    jam: Jam | None = None,
    before: Array | None = None,
) -> tuple[Jump, Flow, Snapshot]:
    """Return the jump of an impact, the flow after it, and the snapshot after it.

    `event` is the region and the cause of the jump. `before` is the state that a closing joint
    meets, whose velocity it does not allow.
    """
    at, setup, closed = landing.at, landing.at.setup, landing.closed
    struck = _solve_struck(tape, landing, jam)
    laws, contacts, bounce_times = struck.laws, struck.snapshot.contacts, struck.bounce_times
    touching = struck.snapshot.remaining(closed, landing.slow)
    mode, moved_by, after, settled = _choose_entered(tape, landing, struck, touching)
    target = listed_mode(mode, setup, struck.snapshot)
    energy = tape.at(setup.values, after, at.clock.high).energy
    bounce_time = max(bounce_times.values(), default=None)
    impulses = struck.result.impulses
    joint_impulse = tape.joint_impulse(
        landing.snapshot, at.state if before is None else before, after, impulses
    )
    considered_before = {} if jam is None else jam.considered
    considered_after = moved_by.considered if isinstance(moved_by, Choice) else {}
    jump = at.jump(
        *event, target, after,
        impulse={
            law.name: (normal, tangential)
            for law, (normal, tangential) in zip(laws, impulses.tolist(), strict=True)
            if law.carrier < 0 and (normal != 0.0 or tangential != 0.0)
        },
        joint_impulse=joint_impulse | couples(laws, impulses),
        path=struck.result.path,
        considered=LazyMapping(partial(
            explain_choice, considered_before, laws, contacts, closed, touching, considered_after
        )),
        energy=(landing.snapshot.energy, energy),
        skipped=bounce_time or 0.0,
    )  # fmt: skip
    warning = "; ".join(filter(None, ("" if jam is None else str(jam), struck.result.warning)))
    flow = flow_in(setup, target, moved_by, bounce_time, warning, settled)
    flow = flow._replace(notes=(*flow.notes, *struck.result.notes))
    # After a long flight the round-off of a gap can exceed its tolerance: it opens from there.
    penetrating = {
        f"{law.name}.gap": -2.0 * contact.gap
        for law, contact, mode in zip(laws, contacts, moving_mode(flow.roles), strict=True)
        if mode == "free" and contact.gap < -setup.tolerances["gap"]
    }
    if penetrating:
        flow = flow._replace(tolerances={**flow.tolerances, **penetrating})
    return jump, flow, struck.snapshot


def _solve_struck(tape: SnapshotTape, landing: Landing, jam: Jam | None) -> _Struck:
    """Compute an impact, and sum the bounces that follow it if that is possible."""
    (setup, clock, _, flow, state, _), snapshot, _, closed = landing
    snapshot_at = hidden_at(tape, setup.values, clock.high, flow.mode)

    def apply(
        laws: Sequence[ContactLaw], snapshot: Snapshot, state: Array, result: Impacts,
        later: float = 0.0,
    ) -> _Struck:  # fmt: skip
        velocity, impulses = apply_rolling_resistance(
            snapshot, laws, result.velocity, result.impulses, setup.slip_tolerance
        )
        result = replace(result, velocity=velocity, impulses=impulses)
        after = snapshot.moved(state, velocity)
        return _Struck(laws, result, after, snapshot_at(after, later), {})

    def under(laws: Sequence[ContactLaw]) -> _Struck:
        if jam is not None:
            result = impact_without_collision(snapshot, laws, jam.place)
        else:
            result = impacts(snapshot, laws, strike_jammed(laws, closed), setup.simultaneous)
        return apply(laws, snapshot, state, result)

    def strike_again(state: Array, later: float, hit: Sequence[bool]) -> tuple[Snapshot, Snapshot]:
        laws, again = setup.contacts, snapshot_at(state, later)
        result = impacts(again, laws, strike_jammed(laws, hit), setup.simultaneous)
        return again, apply(laws, again, state, result, later).snapshot

    elastic = under(setup.contacts)
    bounces = remaining_bounces(setup, strike_again, elastic.snapshot, elastic.state, closed)
    if not bounces:
        return elastic
    plastic = tuple(
        law._replace(restitution=0.0) if i in bounces else law for i, law in enumerate(elastic.laws)
    )
    try:
        captured = under(plastic)
    except NoConsistentMode:
        # Friction jams the plastic impact: the bounces are simulated.
        return elastic
    if not stands_for_bounces(bounces, elastic.snapshot, captured.snapshot, closed):
        return elastic
    lasting = correct_durations(
        bounces, setup, snapshot_at, elastic.snapshot, captured.snapshot, captured.state, closed
    )
    return elastic if lasting is None else captured._replace(bounce_times=lasting)


def _choose_entered(
    tape: SnapshotTape, landing: Landing, struck: _Struck, touching: list[bool]
) -> tuple[Key, Choice | Roles, Array, bool]:
    """Return the mode after an impact, its choice or roles, the state, and if it is settled."""
    setup, following = landing.at.setup, struck.snapshot
    # If a contact still approaches after a sequence of impacts, the next jump is its impact.
    settled = not following.approaching(landing.closed, landing.slow)
    check_listed(setup, following, touching)
    if not any(touching):
        flying = tuple(name if name in INACTIVE else "free" for name in landing.at.flow.mode)
        return flying, roles_in(flying), struck.state, settled
    uncertainty = uncertainty_at(tape, landing, struck.state)
    before = Before.flow(landing.at.flow.roles)
    choice = choose_mode(setup, following, touching, before, uncertainty)
    moving = moving_mode(choice.roles)
    key = constraint_key(choice.roles, following.soft)
    state = landed(key, following, struck.state, setup.tolerances)
    # A contact whose bounces are skipped moves as closed and is shown as free.
    target = tuple(
        "free" if not struck.bounce_times.keys().isdisjoint((i, law.carrier)) else name
        for i, (name, law) in enumerate(zip(moving, struck.laws, strict=True))
    )
    if isinstance(choice, Jam):
        return target, choice.roles, state, False
    return target, choice, state, settled
