"""Laws of a scene with controllers: regions of its own in addition to its contacts.

At an event the contacts are classified first; then the controllers are evaluated in the order of
their declaration (`statechart.charts.guard_watch`). A transition of a controller changes forces and
coefficients, never the motion; the contacts are then classified again at the same instant, since a
new force can make a sticking foot slip.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace
from functools import cache

import numpy as np

from contacts.dynamics.controllers import Controllers
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneInstant, SceneSetup
from contacts.dynamics.snapshot import close_compliant
from contacts.dynamics.surface_jumps import flow_after_move, modes_after_jump
from contacts.event_driven.laws import SceneLaws
from contacts.modes.candidates import Case, candidates
from contacts.states import CLOSED, OFF, OPEN
from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.automaton.constraints import Constraints
from statechart.automaton.laws import Flow, JumpResult, moving_mode, roles_in
from statechart.automaton.margin_derivatives import MarginDerivatives
from statechart.automaton.regions import Region, active_in
from statechart.automaton.trace import Jump, Key, Roles
from statechart.charts.flatten import Updates
from statechart.charts.guard_watch import (
    EventQueues,
    GuardTruths,
    restart_periods,
    transition_outcomes,
)
from statechart.documents.fields import FormulaText


class ControlledLaws:
    """The laws of a scene with controllers (see `statechart.automaton.laws.Laws`)."""

    # Controllers are evaluated at every instant, by Python.
    compiled_laws = None

    def __init__(
        self, contacts: SceneLaws, mechanics: Mechanics, regions: Sequence[Region]
    ) -> None:
        self._contacts = contacts
        self._mechanics, self._states = mechanics, Controllers(mechanics)
        self._controllers, self._names = self._states.flat, self._states.names
        self._regions = regions
        self._count = len(regions) - len(self._names)
        self._at = cache(self._laws_in)
        self._derivatives = MarginDerivatives(
            mechanics.state, mechanics.parameters.ordered, mechanics.time
        )
        scene = mechanics.scene
        texts: list[FormulaText | None] = [one.restitution for one in scene.contacts.values()]
        texts += [law.both for law in map(scene.friction_of, scene.contacts) if law is not None]
        self._varying = any(scene.controlled.region_of(text) is not None for text in texts)
        self._leads = bool(scene.leading)
        self._considered = {
            r.name: transition_outcomes(r) for r in regions if r.name in self._controllers
        }
        self._queues = EventQueues(regions, self._controllers)
        self.feasibility, self.remarks = contacts.feasibility, contacts.remarks

    def begin(self, setup: SceneSetup) -> tuple[Flow, Array]:
        """Return the first flow; transitions that are due there follow as jumps."""

        def due_in(controllers: Key, start: tuple[Flow, Array]) -> Set[tuple[int, int]]:
            flow, state = start
            laws = self._at(controllers)
            within = laws.held.within(setup, flow, state, 0.0, laws.tape)
            truths, _ = self._guard_truths(SceneInstant(within, Clock(), 0, flow, state))
            return frozenset() if truths is None else truths.due()

        return self._states.settle_start(lambda states: self._begin(setup, states), due_in)

    def _begin(self, setup: SceneSetup, controllers: Key) -> tuple[Flow, Array]:
        state = self._states.enter_initial_states(setup, Clock(), setup.initial, controllers)
        inner = replace(self._within(setup, controllers), initial=state)
        flow, state = self._at(controllers).begin(inner)
        return self._joined(setup, Clock(), flow, controllers, state), state

    def jump(self, at: SceneInstant) -> JumpResult:
        """Classify the contacts, then evaluate the controllers."""
        setup, clock, _, flow, state, fired = at
        controllers = flow.mode[self._count :]
        laws = self._at(controllers)
        setup = laws.held.within(setup, flow, state, clock.high, laws.tape)
        at = at._replace(setup=setup)
        inner = self._within(setup, controllers)
        result = laws.jump(at._replace(setup=inner, flow=self._parted(flow)))
        if result is not None:
            jump, following = result
            if jump is None:
                flow_on = self._joined(setup, clock, following, controllers, state, flow)
                # The contacts' laws have decided which conditions of contacts are watched.
                conditions = laws.conditions
                names = filter(None, (*conditions.names, *conditions.back, *conditions.gaps))
                watched = {name: following.tolerances[name] for name in names}
                joined = {**flow_on.tolerances, **watched}
                return None, flow_on._replace(settled=following.settled, tolerances=joined)
            return self._joined_jump(at, jump, following, controllers)
        truths, rows = self._guard_truths(at)
        true = set() if truths is None else truths.due()
        guarded = self._states.opening_first(true, controllers)
        firing = self._queues.first(controllers, flow.pending, guarded, lambda: self._holding(at))
        if firing is None:
            return None if truths is None else truths.continued()
        name, edge = self._names[firing.place], firing.taken
        states = (*controllers[: firing.place], edge.target, *controllers[firing.place + 1 :])
        after = self._states.updated(setup, clock, edge.name, edge.blocks, state)
        if name in self._states.joints and edge.target == CLOSED:
            return self._closed(at, name, edge.name, states, after)
        before_update = laws.snapshot(inner, state, clock.high)
        contacts = flow.mode[: self._count]
        if self._leads:
            setup_after = self._within(setup, states)
            after_update = self._at(states).snapshot(setup_after, after, clock.high)
            contacts, _, _ = modes_after_jump(
                self._mechanics.scene, inner.contacts, inner.tolerances, contacts,
                before_update.rates, after_update.rates,
            )  # fmt: skip
        jump = at.jump(
            name, edge.name, (*contacts, *states), after,
            path=() if edge.guard is not None else (edge.trigger,),
            considered=self._considered[name](edge), energy=(before_update.energy,) * 2,
        )  # fmt: skip
        flow = flow._replace(pending=self._queues.pending_after(firing.pending, jump))
        following = flow_after_move(self._parted(flow), contacts)
        if edge.guard is not None:
            watch = self._states.guards(controllers).watch
            early = watch.early(rows, firing.due, fired)
            following = following._replace(warning=early or following.warning)
        return jump, self._joined(setup, clock, following, states, after, flow)

    def change(self, at: SceneInstant, before: SceneSetup) -> tuple[Jump | None, Flow]:
        """Return the jump and the flow at a change of parameters, which may move surfaces."""

        def updated(
            setup: SceneSetup, name: str, blocks: tuple[Updates, ...], state: Array
        ) -> Array:
            return self._states.updated(setup, at.clock, name, blocks, state)

        start = restart_periods(self._controllers, updated, (before, at.setup), at.state)
        at = at._replace(state=start)
        controllers = at.flow.mode[self._count :]
        old, new = (self._within(setup, controllers) for setup in (before, at.setup))
        inner = at._replace(setup=new, flow=self._parted(at.flow))
        jump, flow = self._at(self._without_opening(at)).change(inner, old)
        if jump is None:
            joined = self._joined(at.setup, at.clock, flow, controllers, start, at.flow)
        else:
            jump, joined = self._joined_jump(at, jump, flow, controllers)
        return jump, joined._replace(start=start)

    def _without_opening(self, at: SceneInstant) -> Key:
        """Return the states of the controllers, with those joints off that open now."""
        states = at.flow.mode[self._count :]
        truths = self._guard_truths(at)[0] if self._states.joints else None
        due = frozenset() if truths is None else truths.due()
        opens = {self._states.names[place] for place, _ in due} & self._states.joints
        named = zip(self._states.names, states, strict=True)
        return tuple(OFF if name in opens and state == CLOSED else state for name, state in named)

    def _closed(
        self, at: SceneInstant, joint: str, cause: str, states: Key, state: Array
    ) -> tuple[Jump, Flow]:
        """Close a joint that is on in `states`; `state` includes the captured values."""
        inner = self._within(at.setup, states)
        parted = at._replace(setup=inner, flow=self._parted(at.flow), state=state)
        jump, flow = self._at(states).close(parted, joint, cause)
        return self._joined_jump(at, replace(jump, before=at.state), flow, states)

    def _joined_jump(
        self, at: SceneInstant, jump: Jump, flow: Flow, states: Key
    ) -> tuple[Jump, Flow]:
        """Return a jump of the contacts and its flow with controllers in `states`."""
        jump = replace(jump, source=at.flow.mode, target=(*jump.target, *states))
        pending = self._queues.pending_after(at.flow.pending, jump)
        source = at.flow._replace(pending=pending)
        return jump, self._joined(at.setup, at.clock, flow, states, jump.after, source)

    def accumulate(
        self, setup: SceneSetup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Skip accumulating impacts, unless a controller reacts to them."""
        if jumps[-1].region in self._controllers:
            return None
        controllers = flow.mode[self._count :]
        inner = self._within(setup, controllers)
        result = self._at(controllers).accumulate(inner, clock, self._parted(flow), jumps, rest)
        if result is None:
            return None
        jump, following = result
        return jump, self._joined(setup, clock, following, controllers, jump.after, flow)

    def constraints(
        self, setup: SceneSetup, roles: Roles, start: float, anchor: Array
    ) -> Constraints:
        """Return the constraints of the closed contacts of `roles`, and of pinned points."""
        # Switched joints and led surfaces depend on the states of controllers.
        depends_on_states = self._states.joints or self._leads
        laws = self._at(moving_mode(roles[self._count :])) if depends_on_states else self._contacts
        return laws.constraints(setup, roles[: self._count], start, anchor)

    def _laws_in(self, states: Key) -> SceneLaws:
        start, named = self._contacts, self._states.named(states)
        return SceneLaws(self._mechanics, start.numbers, named, start)

    def _within(self, setup: SceneSetup, states: Key) -> SceneSetup:
        if not self._varying:
            return setup
        laws = self._contacts.numbers.contacts(setup.values, self._states.named(states))
        return replace(setup, contacts=laws)

    def _guard_truths(self, at: SceneInstant) -> tuple[GuardTruths | None, Array]:
        """Return the judgement of the guards, or None far from all boundaries; and their rows."""
        setup, clock, _, flow, state, fired = at
        guarded = self._states.guards(flow.mode[self._count :])
        tolerances = np.array([flow.tolerances[margin] for margin in guarded.watch.margins])
        rows = guarded.atoms_at(setup, clock.high, state)
        watched = tolerances < np.inf
        far = (rows[watched, 0] > tolerances[watched]).all()
        # The first flow in a mode watches all atoms of a guard, and is evaluated in any case.
        known = guarded.watch.single or not watched.all()
        # A margin that jumps as its mode starts (an angle at the origin) has its value behind.
        if far and known and not {*fired}.intersection(guarded.watch.margins):
            return None, rows
        inputs, sizes = guarded.inputs(state, self._solved(at)), guarded.sizes(setup)
        active = active_in(self._regions, flow.mode)
        truths = GuardTruths(guarded.watch, at, inputs, sizes, self._derivatives, active)
        return truths, truths.rows

    def _holding(self, at: SceneInstant) -> set[tuple[int, int]]:
        setup, clock, _, flow, state, _ = at
        guarded = self._states.guards(flow.mode[self._count :], at_events=True)
        rows = guarded.atoms_at(setup, clock.high, state, self._solved(at))
        return guarded.watch.holding(rows, setup.precision, active_in(self._regions, flow.mode))

    def _solved(self, at: SceneInstant) -> Array | None:
        """Return accelerations and forces in the mode; None if they are undetermined."""
        setup, clock, _, flow, state, _ = at
        controllers = flow.mode[self._count :]
        inner = self._within(setup, controllers)
        snapshot = self._at(controllers).snapshot(inner, state, clock.high)
        modes = moving_mode(flow.roles[: self._count])
        closed = [mode not in OPEN for mode in modes]
        snapshot = close_compliant(snapshot, closed)
        case = Case(snapshot, inner.contacts, closed, closed, setup.scales)
        (solved,) = candidates(case, [(mode,) for mode in modes])
        if solved.undetermined:
            return None
        accelerations, joints = snapshot.solved(solved.accelerations, solved.forces)
        captured = np.array([role.captured for role in flow.roles[: self._count]])
        forces = np.where(captured[:, None], 0.0, solved.forces)
        contacts, couples = np.split(forces, [len(self._mechanics.forces)])
        return np.concatenate([accelerations, contacts.ravel(), couples[:, 1], joints])

    def _parted(self, flow: Flow) -> Flow:
        return flow._replace(mode=flow.mode[: self._count], roles=flow.roles[: self._count])

    def _joined(
        self, setup: SceneSetup, clock: Clock, flow: Flow, states: Key, state: Array,
        source: Flow | None = None,
    ) -> Flow:  # fmt: skip
        """Return the unsettled flow of contacts and controllers; `source` is the last flow."""
        guarded = self._states.guards(states)
        # Only the sizes of a guard's terms are needed: forces of typical size suffice.
        rows = guarded.atoms_at(setup, clock.high, state, guarded.typical(setup))
        tolerances = guarded.watch.tolerances(rows, setup.precision)
        special, _ = self._at(states).special_tolerances(setup, flow, state, clock.high)
        return flow._replace(
            mode=(*flow.mode, *states),
            roles=(*flow.roles, *roles_in(states)),
            settled=False,
            tolerances={**setup.bands, **special, **tolerances},
            terms=None if flow.terms is None or source is None else source.terms,
            pending=source.pending if source is not None else {},
        )
