"""Controllers on the executor: a scene's own regions beside its contacts, and their jumps.

Contacts are classified from the state first; then the controllers are asked in the order of their
declaration (`statechart.charts.guard_watch`). A controller that changes state changes forces and
coefficients, never the motion, and the contacts are classified again at that instant: a push may
make a pinned foot slip there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from contacts.dynamics.conditions import Conditions
from contacts.dynamics.controllers import Controllers, ControllerState, opening_first
from contacts.dynamics.held_forces import HeldForces
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import PerContact, Snapshot, SnapshotTape
from contacts.dynamics.starting import jumped_in, torn
from contacts.event_driven.laws import SceneLaws
from contacts.modes.classification import Case, candidates
from contacts.scene.scene import Scene
from contacts.states import CLOSED, OFF, OPEN
from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.automaton.constraints import Constraints
from statechart.automaton.laws import Feasibility, Flow, Instant, Setup, moving_mode, roles_in
from statechart.automaton.margin_derivatives import MarginDerivatives
from statechart.automaton.regions import Region, active_in
from statechart.automaton.trace import Arc, Jump, Key, Roles
from statechart.charts.guard_watch import Judgement, Listening, considered


class ControlledLaws:
    """The laws of a scene with controllers (see `statechart.automaton.laws.Laws`)."""

    # Controllers are asked at every instant.
    compiled_laws = None

    def __init__(
        self, contacts: SceneLaws, mechanics: Mechanics, regions: Sequence[Region]
    ) -> None:
        self._contacts = contacts
        self._mechanics = mechanics
        self._controllers = mechanics.scene.controlled.flat
        self._names = tuple(self._controllers)
        self._regions = regions
        self._count = len(regions) - len(self._names)
        self._under: dict[Key, SceneLaws] = {}
        self._states = Controllers(mechanics)
        self._memory = ControllerState(mechanics)
        self._held = HeldForces(mechanics)
        variables = (*mechanics.variables, *mechanics.controller_state.values())
        self._derivatives = MarginDerivatives(
            variables, mechanics.parameters.ordered, mechanics.time
        )
        scene = mechanics.scene
        self._varying = any(
            scene.controlled.region_of(text) is not None
            for name, contact in scene.contacts.items()
            for law in (scene.friction_of(name),)
            for text in (law and law.both, contact.restitution)
        )
        self._joints = {row.joint for row in mechanics.joint_rows if row.closed is not None}
        self._leads = bool(mechanics.scene.leading)
        self._considered = {r.name: considered(r) for r in regions if r.name in self._controllers}
        self._listening = Listening(regions, self._controllers)

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the first mode, entered; transitions that are due there are taken at once."""
        assert isinstance(setup, SceneSetup)
        state = setup.initial
        for region in self._controllers.values():
            state = self._memory.updated(setup, Clock(), region.name, region.begins, state)
        own = self._states.initial
        inner = self._within(setup, own, state)
        flow, begun = self._at(own).begin(replace(inner, initial=self._memory.parted(state)))
        state = self._memory.joined(begun, state)
        return self._joined(setup, Clock(), flow, own, state), state

    def jump(self, at: Instant) -> tuple[Jump | None, Flow] | None:
        """Classify the contacts, then ask the controllers."""
        setup, clock, _, flow, state, fired = at
        assert isinstance(setup, SceneSetup)
        own = flow.mode[self._count :]
        laws = self._at(own)
        setup = self._held.within(setup, flow, state, clock.high, laws.tape)
        at = at._replace(setup=setup)
        inner = self._within(setup, own, state)
        motion = self._memory.parted(state)
        made = laws.jump(at._replace(setup=inner, flow=self._parted(flow), state=motion))
        if made is not None:
            jump, following = made
            if following.start is not None:
                start = self._memory.joined(following.start, state)
                following = following._replace(start=start)
            if jump is None:
                held = self._joined(setup, clock, following, own, state, flow)
                return None, held._replace(settled=following.settled)
            after = self._memory.joined(jump.after, state)
            jump = replace(
                jump,
                source=flow.mode,
                target=(*jump.target, *own),
                before=self._memory.joined(jump.before, state),
                after=after,
            )
            flow = flow._replace(pending=self._listening.pending_after(flow.pending, jump))
            return jump, self._joined(setup, clock, following, own, after, flow)
        judged, rows = self._judged(setup, clock, flow, state, fired)
        true = set() if judged is None else judged.due()
        guarded = opening_first(true, self._names, own, self._joints)
        firing = self._listening.first(
            self._controllers,
            own,
            flow.pending,
            guarded,
            lambda: self._holding(setup, clock, flow, state),
        )
        if firing is None:
            tolerances = flow.tolerances if judged is None else judged.watched()
            if tolerances == flow.tolerances:
                return None
            return None, flow._replace(tolerances=tolerances)
        name, taken = self._names[firing.place], firing.taken
        states = (*own[: firing.place], taken.target, *own[firing.place + 1 :])
        after = self._memory.updated(setup, clock, taken.name, taken.blocks, state)
        if name in self._joints and taken.target == CLOSED:
            return self._closed(at, name, taken.name, states, after)
        energy = laws.snapshot(inner, motion, clock.high).energy
        contacts = flow.mode[: self._count]
        if self._leads:
            there = self._within(setup, states, after)
            now = self._at(states).snapshot(there, motion, clock.high)
            was = laws.snapshot(inner, motion, clock.high)
            contacts = displaced(self._mechanics.scene, inner, contacts, was, now)
        jump = at.jump(
            name,
            taken.name,
            (*contacts, *states),
            after,
            path=() if taken.guard is not None else (taken.trigger,),
            considered=self._considered[name](taken),
            energy=(energy, energy),
        )
        flow = flow._replace(pending=self._listening.pending_after(firing.pending, jump))
        following = self._parted(flow)
        if contacts != following.mode:
            roles = zip(following.mode, contacts, following.roles, roles_in(contacts), strict=True)
            moved = tuple(role if a == b else other for a, b, role, other in roles)
            following = following._replace(mode=contacts, roles=moved)
        if taken.guard is not None:
            watch = self._states.guards(own).watch
            early = watch.early(rows, firing.due, fired)
            following = following._replace(warning=early or following.warning)
        return jump, self._joined(setup, clock, following, states, after, flow)

    def _closed(
        self, at: Instant, joint: str, cause: str, states: Key, state: Array
    ) -> tuple[Jump, Flow]:
        """Close a joint that is on in `states`; `state` is what it has captured."""
        assert isinstance(at.setup, SceneSetup)
        inner = self._within(at.setup, states, state)
        motion = self._memory.parted(state)
        parted = at._replace(setup=inner, flow=self._parted(at.flow), state=motion)
        jump, flow = self._at(states).close(parted, joint, cause)
        after = self._memory.joined(jump.after, state)
        jump = replace(
            jump, source=at.flow.mode, target=(*jump.target, *states), before=at.state, after=after
        )
        pending = self._listening.pending_after(at.flow.pending, jump)
        before = at.flow._replace(pending=pending)
        return jump, self._joined(at.setup, at.clock, flow, states, after, before)

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Let the contacts skip what accumulates; controllers that answer it just go on."""
        assert isinstance(setup, SceneSetup)
        if jumps[-1].region in self._controllers:
            return None
        own = flow.mode[self._count :]
        last = jumps[-1].after
        inner = self._within(setup, own, last)
        parted = self._memory.parted
        motions = [replace(j, before=parted(j.before), after=parted(j.after)) for j in jumps]
        made = self._at(own).accumulate(inner, clock, self._parted(flow), motions, rest)
        if made is None:
            return None
        jump, following = made
        joined = self._memory.joined
        jump = replace(jump, before=joined(jump.before, last), after=joined(jump.after, last))
        return jump, self._joined(setup, clock, following, own, jump.after, flow)

    def constraints(self, setup: Setup, roles: Roles, start: float, anchor: Array) -> Constraints:
        """Return what keeps the closed contacts of `roles` closed, and pinned points in place."""
        assert isinstance(setup, SceneSetup)
        inner = self._memory.within(setup, anchor)
        motion = self._memory.parted(anchor)
        # Which joints hold, and where surfaces go, is a matter of the states.
        own = self._joints or self._leads
        laws = self._at(moving_mode(roles[self._count :])) if own else self._contacts
        found = laws.constraints(inner, roles[: self._count], start, motion)
        return self._memory.constraints(found, setup)

    def feasibility(
        self, regions: Sequence[Region], setup: Setup, state: Array, time: float
    ) -> Feasibility:
        """Judge every product mode by the velocities that it asks for; controllers ask for none."""
        assert isinstance(setup, SceneSetup)
        inner, motion = self._memory.within(setup, state), self._memory.parted(state)
        return self._contacts.feasibility(regions, inner, motion, time)

    def remarks(self, setup: Setup, arcs: Sequence[Arc]) -> tuple[str, ...]:
        """Return warnings of contacts that stay off: see `handovers`."""
        return self._contacts.remarks(setup, arcs)

    def _at(self, states: Key) -> SceneLaws:
        """Return the contacts' laws as long as the controllers are in `states`."""
        if states not in self._under:
            named = self._states.named(states)
            self._under[states] = self._contacts.under(
                SnapshotTape(self._mechanics, named), Conditions(self._mechanics, named)
            )
        return self._under[states]

    def _within(self, setup: SceneSetup, states: Key, state: Array) -> SceneSetup:
        """Return the setup as contacts see it: with their coefficients, and what is remembered."""
        inner = self._memory.within(setup, state)
        if not self._varying:
            return inner
        named = self._states.named(states)
        return replace(inner, contacts=self._contacts.numbers.contacts(setup.values, named))

    def _judged(
        self, setup: SceneSetup, clock: Clock, flow: Flow, state: Array, fired: tuple[str, ...]
    ) -> tuple[Judgement | None, Array]:
        """Return the guards, judged, or None if none is near its boundary; and their rows."""
        own = flow.mode[self._count :]
        guarded = self._states.guards(own)
        tolerances = np.array([flow.tolerances[margin] for margin in guarded.watch.margins])
        rows = guarded.rows(setup, clock.high, state)
        watched = tolerances < np.inf
        # The first flow in a mode watches all atoms of a guard, and is judged.
        if (rows[watched, 0] > tolerances[watched]).all() and (
            guarded.watch.single or not watched.all()
        ):
            return None, rows
        solved = self._solved(setup, clock, flow, state)
        rows = guarded.rows(setup, clock.high, state, solved)
        relative = setup.precision

        assert setup.sizes is not None
        sizes = setup.sizes

        def rates(k: int) -> Array:
            return guarded.rates_of(k, setup, clock.high, state, solved)

        def later(margin: str) -> float:
            return self._derivatives.sign(
                setup, flow.moving, margin, state, sizes, clock.high, relative
            )

        active = active_in(self._regions, flow.mode)
        judged = Judgement(
            guarded.watch, rows, rates, flow.tolerances, fired, relative, later, active
        )
        return judged, rows

    def _holding(
        self, setup: SceneSetup, clock: Clock, flow: Flow, state: Array
    ) -> set[tuple[int, int]]:
        """Return the guards at events that hold."""
        guarded = self._states.guards(flow.mode[self._count :], at_events=True)
        rows = guarded.rows(setup, clock.high, state, self._solved(setup, clock, flow, state))
        return guarded.watch.holding(rows, setup.precision, active_in(self._regions, flow.mode))

    def _solved(self, setup: SceneSetup, clock: Clock, flow: Flow, state: Array) -> Array | None:
        """Return accelerations and forces in the mode; None where it leaves them open."""
        own = flow.mode[self._count :]
        inner = self._within(setup, own, state)
        snapshot = self._at(own).snapshot(inner, self._memory.parted(state), clock.high)
        modes = moving_mode(flow.roles[: self._count])
        closed = [mode not in OPEN for mode in modes]
        case = Case(snapshot, inner.contacts, closed, closed, setup.scales)
        (solved,) = candidates(case, [(mode,) for mode in modes])
        if solved.undetermined:
            return None
        accelerations, joints = snapshot.solved(solved.accelerations, solved.forces)
        captured = np.array([role.captured for role in flow.roles[: self._count]])
        forces = np.where(captured[:, None], 0.0, solved.forces)
        first = len(self._mechanics.forces)
        couples = forces[first:, 1]
        return np.concatenate([accelerations, forces[:first].ravel(), couples, joints])

    def _parted(self, flow: Flow) -> Flow:
        """Return the flow as the contacts' laws know it."""
        return flow._replace(
            mode=flow.mode[: self._count],
            roles=flow.roles[: self._count],
            terms=None if flow.terms is None else self._memory.parted(flow.terms),
        )

    def _joined(
        self,
        setup: SceneSetup,
        clock: Clock,
        flow: Flow,
        states: Key,
        state: Array,
        before: Flow | None = None,
    ) -> Flow:
        """Return the flow of the contacts and controllers; whether it holds is to be asked.

        `before`: what has come here, and what is pending then.
        """
        guarded = self._states.guards(states)
        # The size of a guard's terms is asked for, not its value: forces of the scene's size do.
        rows = guarded.rows(setup, clock.high, state, guarded.typical(setup))
        tolerances = guarded.watch.tolerances(rows, setup.precision)
        inner, motion = self._memory.within(setup, state), self._memory.parted(state)
        laws = self._at(states)
        own = laws.conditions.at(inner, motion, clock.high).tolerances()
        if laws.compliance is not None:
            mode = moving_mode(flow.roles)
            own |= laws.compliance.tolerances(inner, mode, motion, clock.high)
        return flow._replace(
            mode=(*flow.mode, *states),
            roles=(*flow.roles, *roles_in(states)),
            settled=False,
            tolerances={**setup.bands, **own, **tolerances},
            terms=None if flow.terms is None or before is None else before.terms,
            pending=before.pending if before is not None else {},
        )


def displaced(scene: Scene, setup: SceneSetup, mode: Key, before: Snapshot, after: Snapshot) -> Key:
    """Return the modes of the contacts after a jump that may have moved their surfaces.

    What no longer holds is opened by the jump itself, and judged again after it: a point that a
    surface then approaches is struck, one that it leaves is free.

    Raises `NoConsistentMode` where a surface jumps into a point, or its velocity jumps under one
    that may not leave it.
    """
    near, slow = setup.tolerances["gap"], setup.tolerances["speed"]
    laws = zip(setup.contacts, mode, before.contacts, after.contacts, strict=True)
    found = []
    for law, state, was, now in laws:
        # Couplings touch no surface.
        if law.name not in scene.contacts:
            found.append(state)
            continue
        # The normal forces of compliant contacts follow whatever a surface does.
        rigid = scene.contacts[law.name].stiffness is None
        # Where the surface begins to approach, or to leave, is judged by what it did before.
        parts = abs(now.gap - was.gap) > near or abs(now.gap_rate - was.gap_rate) > slow
        parts, touches = parts and rigid, state not in OPEN
        if rigid and state != OFF and now.gap < min(was.gap, 0.0) - near:
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
