"""Controllers on the executor: a scene's own regions beside its contacts, and their jumps.

Contacts are classified from the state first; then the controllers are asked in the order of their
declaration (`statechart.charts.firing`). A controller that changes state changes forces and
coefficients, never the motion, and the contacts are classified again at that instant: a push may
make a pinned foot slip there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from contacts.dynamics.conditions import Conditions
from contacts.dynamics.control_guards import Controllers, precision
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SnapshotTape
from contacts.event_driven.laws import SceneLaws
from contacts.modes.candidates import Candidate, Case, candidates
from contacts.states import OPEN
from statechart.arrays import Array
from statechart.automaton.constraints import Constraints
from statechart.automaton.course import Courses
from statechart.automaton.feasibility import Feasibility
from statechart.automaton.laws import Flow, Instant, Setup, moving_mode, roles_in
from statechart.automaton.regions import Region
from statechart.automaton.trace import Clock, Jump, Key, Roles
from statechart.charts.firing import Guard, Listening, considered


class ControlledLaws:
    """The laws of a scene with controllers (see `statechart.automaton.laws.Laws`).

    Parameters
    ----------
    contacts : SceneLaws
        Of the contacts, the controllers in their initial states.
    mechanics : Mechanics
        The scene's equations.
    regions : sequence of Region
        All, those of the controllers last.
    """

    # Controllers are asked at every instant.
    ordinary = None

    def __init__(
        self,
        contacts: SceneLaws,
        mechanics: Mechanics,
        regions: Sequence[Region],
    ) -> None:
        self._contacts = contacts
        self._mechanics = mechanics
        self._controllers = mechanics.scene.controlled.flat
        self._names = tuple(self._controllers)
        self._count = len(regions) - len(self._names)
        self._under: dict[Key, SceneLaws] = {}
        self._states = Controllers(mechanics)
        self._courses = Courses(mechanics.variables, mechanics.parameters.ordered, mechanics.time)
        region_of = mechanics.scene.controlled.region_of
        self._varying = any(
            region_of(text) is not None
            for contact in mechanics.scene.contacts.values()
            for text in (contact.friction, contact.restitution)
        )
        self._considered = {r.name: considered(r) for r in regions if r.name in self._controllers}
        self._listening = Listening(regions, self._controllers)

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the first mode; transitions that are due there are taken at once."""
        assert isinstance(setup, SceneSetup)
        flow, state = self._contacts.begin(setup)
        return self._joined(setup, Clock(), flow, self._states.initial, state), state

    def jump(self, at: Instant) -> tuple[Jump | None, Flow] | None:
        """Classify the contacts, then ask the controllers."""
        setup, clock, _, flow, state, fired = at
        assert isinstance(setup, SceneSetup)
        own = flow.mode[self._count :]
        laws = self._at(own)
        setup = self._within(setup, own)
        made = laws.jump(at._replace(setup=setup, flow=self._parted(flow)))
        if made is not None:
            jump, following = made
            if jump is None:
                return None, self._joined(setup, clock, following, own, state, flow.pending)
            jump = replace(jump, source=flow.mode, target=(*jump.target, *own))
            pending = self._listening.heard(flow.pending, jump)
            return jump, self._joined(setup, clock, following, own, jump.after, pending)
        guarded, rows = self._due(setup, clock, flow, state, fired)
        firing = self._listening.first(self._names, own, flow.pending, guarded)
        if firing is None:
            return None
        name = self._names[firing.place]
        taken = self._controllers[name].transitions[firing.transition]
        states = (*own[: firing.place], taken.target, *own[firing.place + 1 :])
        energy = laws.snapshot(setup, state, clock.high).energy
        jump = at.jump(
            name,
            taken.name,
            (*flow.mode[: self._count], *states),
            path=() if taken.guard is not None else (taken.trigger,),
            considered=self._considered[name][firing.transition],
            energy=(energy, energy),
        )
        pending = self._listening.heard(firing.pending, jump)
        following = self._parted(flow)
        if taken.guard is not None:
            watch = self._states.guards(own).watch
            early = watch.early(rows, firing.place, firing.transition, fired)
            following = following._replace(warning=early or following.warning)
        return jump, self._joined(setup, clock, following, states, state, pending)

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Let the contacts skip what accumulates; controllers that answer it just go on."""
        assert isinstance(setup, SceneSetup)
        if jumps[-1].region in self._controllers:
            return None
        own = flow.mode[self._count :]
        setup = self._within(setup, own)
        made = self._at(own).accumulate(setup, clock, self._parted(flow), jumps, rest)
        if made is None:
            return None
        jump, following = made
        return jump, self._joined(setup, clock, following, own, jump.after, flow.pending)

    def constraints(self, setup: Setup, roles: Roles, start: float, anchor: Array) -> Constraints:
        """Return what keeps the closed contacts of `roles` closed, and pinned points in place."""
        return self._contacts.constraints(setup, roles[: self._count], start, anchor)

    def feasibility(
        self, regions: Sequence[Region], setup: Setup, state: Array, time: float
    ) -> Feasibility:
        """Judge every product mode by the velocities that it asks for; controllers ask for none."""
        return self._contacts.feasibility(regions, setup, state, time)

    def _at(self, states: Key) -> SceneLaws:
        """Return the contacts' laws as long as the controllers are in `states`."""
        if states not in self._under:
            named = self._states.named(states)
            self._under[states] = self._contacts.under(
                SnapshotTape(self._mechanics, named),
                Conditions(self._mechanics, named),
            )
        return self._under[states]

    def _within(self, setup: SceneSetup, states: Key) -> SceneSetup:
        """Return the setup with the contacts' coefficients in `states`."""
        if not self._varying:
            return setup
        named = self._states.named(states)
        return replace(setup, contacts=self._contacts.numbers.contacts(setup.values, named))

    def _due(
        self, setup: SceneSetup, clock: Clock, flow: Flow, state: Array, fired: tuple[str, ...]
    ) -> tuple[dict[int, int], Array]:
        """Return place -> transition whose guard is due, and what was known of the guards."""
        own = flow.mode[self._count :]
        guarded = self._states.guards(own)
        watched = guarded.watch.guards
        tolerances = np.array([flow.tolerances[guard.margin] for guard in watched])
        rows = guarded.rows(setup, clock.high, state)
        if (rows[:, 0] > tolerances).all():
            return {}, rows
        snapshot = self._at(own).snapshot(setup, state, clock.high)
        modes = moving_mode(flow.roles[: self._count])
        closed = [mode not in OPEN for mode in modes]
        case = Case(snapshot, setup.contacts, closed, closed, setup.scales)
        (solved,) = candidates(case, [(mode,) for mode in modes])
        found = None
        if isinstance(solved, Candidate):
            accelerations, joints = snapshot.solved(solved.accelerations, solved.forces)
            captured = np.array([role.captured for role in flow.roles[: self._count]])
            forces = np.where(captured[:, None], 0.0, solved.forces)
            found = np.concatenate([accelerations, forces.ravel(), joints])
        rows = guarded.rows(setup, clock.high, state, found)
        relative = precision(setup)

        def later(guard: Guard) -> float:
            return self._courses.sign(
                setup, flow.roles, guard.margin, state, setup.scales.sizes, clock.high, relative
            )

        return guarded.watch.due(rows, flow.tolerances, fired, relative, later), rows

    def _parted(self, flow: Flow) -> Flow:
        """Return the flow as the contacts' laws know it."""
        return flow._replace(mode=flow.mode[: self._count], roles=flow.roles[: self._count])

    def _joined(
        self,
        setup: SceneSetup,
        clock: Clock,
        flow: Flow,
        states: Key,
        state: Array,
        pending: Mapping[str, tuple[Jump, ...]] | None = None,
    ) -> Flow:
        """Return the flow of the contacts and controllers; whether it holds is to be asked."""
        guarded = self._states.guards(states)
        # The size of a guard's terms is asked for, not its value: forces of the scene's size do.
        rows = guarded.rows(setup, clock.high, state, guarded.typical(setup))
        tolerances = guarded.watch.tolerances(rows, precision(setup))
        return flow._replace(
            mode=(*flow.mode, *states),
            roles=(*flow.roles, *roles_in(states)),
            settled=False,
            tolerances={**setup.bands, **tolerances},
            pending=pending or {},
        )
