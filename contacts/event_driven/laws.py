"""Laws of a scene between flows: classification, impacts, Zeno capture."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from itertools import islice

import numpy as np

from contacts.dynamics.conditions import Conditions, hidden, hidden_at
from contacts.dynamics.held_forces import HeldForces
from contacts.dynamics.mechanics import HAULED, Mechanics, winch_end_message
from contacts.dynamics.projection import (
    Projection,
    constraint_key,
    dead_point,
    in_contact,
    landed,
    on_constraints,
)
from contacts.dynamics.setup import SceneInstant, SceneSetup
from contacts.dynamics.setup_evaluation import SceneNumbers
from contacts.dynamics.snapshot import Snapshot, SnapshotTape, close_compliant
from contacts.dynamics.starting import (
    check_closing,
    check_joints,
    check_limits,
    check_place,
    check_start,
    hovering_warnings,
    weak_coupling_warnings,
)
from contacts.dynamics.surface_jumps import ParameterChange, flow_after_move, modes_after_change
from contacts.event_driven.accumulation import close_immediately
from contacts.event_driven.compiled_laws import CompiledSceneLaws
from contacts.event_driven.decision import cause, check_declared, choose_at_rest
from contacts.event_driven.handovers import Handovers
from contacts.event_driven.impact_jump import (
    Landing,
    flow_in,
    impact_jump,
    mark_captured_roles,
    uncertainty_at,
)
from contacts.event_driven.switching import Switching, alike
from contacts.impacts.bounces import reopens_immediately, rest_of_passages
from contacts.impacts.jamming import Jam, listed_mode, off_state, resolve_jam, strike_jammed
from contacts.impacts.simultaneous import impacts
from contacts.modes.classification import Before, Choice
from contacts.modes.feasibility import scene_feasibility
from contacts.scene.couplings import LIMIT_MARGINS
from contacts.scene.modes import FORCE_MARGINS, OUTSIDE, PULL
from contacts.states import OFF, OPEN, SLIPPING
from statechart.arrays import EPS, Array
from statechart.automaton.clock import Clock
from statechart.automaton.constraints import Constraints
from statechart.automaton.laws import (
    UNBOUNDED,
    CompiledLaws,
    Feasibility,
    Flow,
    JumpResult,
    moving_mode,
    roles_in,
    uncaptured,
)
from statechart.automaton.margin_derivatives import UNDERFLOW
from statechart.automaton.regions import Region
from statechart.automaton.trace import Jump, Key, Roles
from statechart.errors import NoConsistentMode, SingularMode

# Largest initial depth, relative to the scene's length; it is projected out.
_START_DEPTH = 1e-9


class SceneLaws:
    """The laws of a scene (see `statechart.automaton.laws.Laws`).

    Controllers are in `states`, by default those at the start; `start` are the laws with these.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        numbers: SceneNumbers,
        states: Mapping[str, str] | None = None,
        start: SceneLaws | None = None,
    ) -> None:
        self._mechanics, self._states, self._start = mechanics, states, start
        self._modes = mechanics.scene.initial_modes
        self._names = mechanics.scene.frictional
        self._count = len(mechanics.scene.contacts)
        self.numbers = numbers
        self.conditions = numbers.conditions if states is None else Conditions(mechanics, states)
        self._switching = Switching(self._names, self.conditions)
        self.held = HeldForces(mechanics)
        self.compliance = Compliance(mechanics, states) if mechanics.pads else None
        self.remarks = Handovers(mechanics).remarks

    # Compiled on demand: a scene that runs by components needs no arrays of all bodies times all
    # coordinates.

    @cached_property
    def tape(self) -> SnapshotTape:
        """The tape of snapshots."""
        return SnapshotTape(self._mechanics, self._states)

    @cached_property
    def _projection(self) -> Projection:
        joints = any(row.closed is not None for row in self._mechanics.joint_rows)
        if self._start is not None and not (joints or self._mechanics.scene.leading):
            return self._start._projection
        return Projection(self._mechanics, self.tape)

    @cached_property
    def compiled_laws(self) -> CompiledLaws | None:
        """The compiled part of the laws; None with joints, and if stop conditions overlap."""
        scene = self._mechanics.scene
        slow = self._mechanics.joint_rows or self._mechanics.pads or scene.couplings
        if slow or not self.numbers.disjoint:
            return None
        return CompiledSceneLaws(self._names, self.numbers, self.tape, self._projection, self.jump)

    def snapshot(self, setup: SceneSetup, state: Array, time: float) -> Snapshot:
        """Return the snapshot at a state."""
        return self.tape.at(setup.values, state, time)

    def begin(self, setup: SceneSetup) -> tuple[Flow, Array]:
        """Return the first mode, checked against the declared one."""
        flow, state = self._initial_flow(setup, setup.initial)
        own, _ = self.special_tolerances(setup, flow, state, 0.0)
        return flow._replace(tolerances={**flow.tolerances, **own}) if own else flow, state

    def _initial_flow(self, setup: SceneSetup, state: Array) -> tuple[Flow, Array]:
        """Return the first flow, and its initial state."""
        check_joints(self._mechanics, self.tape, setup, _START_DEPTH)
        snapshot = self.tape.at(setup.values, state, 0.0)
        failing = self._switching.failing(setup, snapshot, state, 0.0)
        depth = max(_START_DEPTH * setup.scales.length, setup.tolerances["gap"])
        off = tuple(
            off_state(law)
            if why or (self._modes.get(law.name) == OFF and contact.gap < -depth)
            else "free"
            for law, why, contact in zip(setup.contacts, failing, snapshot.contacts, strict=True)
        )
        snapshot = hidden(snapshot, off)
        near, slow = setup.tolerances["gap"], setup.tolerances["speed"]
        scene = self._mechanics.scene
        for name, contact in zip(scene.frictional, snapshot.contacts, strict=True):
            check_place(scene, name, contact[:5])
        declared = islice(setup.contacts, len(scene.contacts))
        for law, contact in zip(declared, snapshot.contacts, strict=False):
            check_start(scene, law, contact[:3], depth, near, slow)
        check_limits(setup.contacts, snapshot.limits)
        closed = [c.gap <= near for c in snapshot.contacts]
        touching = [c.gap <= near and abs(c.gap_rate) <= slow for c in snapshot.contacts]
        key = tuple(
            ("slip+" if law.coupling else "slide") if shut else "free"
            for law, shut in zip(setup.contacts, touching, strict=True)
        )
        inside = [c.gap < 0.0 for c in snapshot.contacts]
        if any(inside):
            state = on_constraints(key, snapshot, state, penetrating=inside)
        else:
            state = landed(key, snapshot, state, setup.tolerances)
        if state is not setup.initial:
            snapshot = hidden(self.tape.at(setup.values, state, 0.0), off)
        warnings = self._start_warnings(setup, state, off)
        choice = choose_at_rest(
            setup, snapshot, touching, state, hidden_at(self.tape, setup.values, 0.0, off), Before()
        )
        moving = moving_mode(choice.roles)
        starts = listed_mode(moving, setup, snapshot)
        if isinstance(choice, Jam):
            return flow_in(setup, starts, choice.roles, None, warnings, settled=False), state
        check_declared(self._modes, self._names, choice, snapshot, touching, failing)
        settled = not snapshot.approaching(closed, slow)
        return flow_in(setup, starts, choice, None, warnings, settled), state

    def _start_warnings(self, setup: SceneSetup, state: Array, mode: Key) -> str:
        """Return warnings about hovering contacts, and about couplings with tiny limits."""
        snapshot = self.tape.at(setup.values, state, 0.0)
        on = [i for i, name in enumerate(mode[: self._count]) if name != OFF]
        hovering = hovering_warnings(
            self._mechanics.scene, setup.scales, setup.tolerances["gap"],
            [self._names[i] for i in on], [snapshot.contacts[i][:2] for i in on],
        )  # fmt: skip
        weak = weak_coupling_warnings(setup.contacts, snapshot.limits, setup.tolerances["force"])
        return "; ".join([*hovering, *weak])

    def jump(self, at: SceneInstant) -> JumpResult:
        """Classify every contact; see `contacts.modes.classification`."""
        if at.flow.signs and not self._mechanics.scene.regions:
            within = self.held.within(at.setup, at.flow, at.state, at.clock.high, self.tape)
            at = at._replace(setup=within)
        return self._watched(at, self._with_gap_offsets(at, self._jump(at)))

    def _watched(self, at: SceneInstant, result: JumpResult) -> JumpResult:
        """Set the special tolerances of a flow, also of one that continues.

        A jump that leaves a state on the boundary of a condition is classified again.
        """
        setup, clock = at.setup, at.clock
        jump, flow = (None, at.flow) if result is None else result
        after = flow.start if jump is None else jump.after
        state = at.state if after is None else after
        # If no contact is switched, the verdicts of higher derivatives certify the flow.
        verdicts = self._switching.verdicts if result is None else []
        own, on_boundary = self.special_tolerances(setup, flow, state, clock.high, verdicts)
        if not own or (result is None and alike(own, flow.tolerances)):
            return result
        settled = flow.settled and (jump is None or not on_boundary)
        return jump, flow._replace(tolerances={**flow.tolerances, **own}, settled=settled)

    def special_tolerances(
        self, setup: SceneSetup, flow: Flow, state: Array, time: float, verdicts: Sequence[int] = ()
    ) -> tuple[dict[str, float], bool]:
        """Return the tolerances of conditions and compliant contacts in a flow from a state.

        Also returns whether a condition is on its boundary. `verdicts` are those of the atoms, if
        higher derivatives have decided them.
        """
        own, on_boundary = dict[str, float](), False
        if self.conditions.present:
            here = self.conditions.at(setup, state, time)
            own, on_boundary = here.tolerances(verdicts), here.on_boundary
        if self.compliance is not None:
            own |= self.compliance.tolerances(setup, moving_mode(flow.roles), state, time)
        return own, on_boundary

    def _with_gap_offsets(self, at: SceneInstant, result: JumpResult) -> JumpResult:
        """Measure the gaps of starting flights from their round-off."""
        if result is None or (jump := result[0]) is None:
            return result
        flow, setup, offsets = result[1], at.setup, self.numbers.gap_offsets
        known = setup.values if at.flow.values is None else at.flow.values
        count = self._count
        before, moving = moving_mode(at.flow.roles)[:count], moving_mode(flow.roles)[:count]
        modes = zip(self._names[:count], before, moving, strict=True)
        began = [now == "free" and (n in jump.impulse or was != "free") for n, was, now in modes]
        if not (any(began) or known[offsets].any()):
            return result
        new_offsets = np.where([state == "free" for state in moving], known[offsets], 0.0)
        if any(began):
            contacts = self.tape.at(setup.values, jump.after, at.clock.high).contacts
            gaps = np.array([contact.gap for contact in contacts[:count]])
            # Others, projected onto their surfaces, may move a contact that leaves into its own.
            near = (gaps >= -count * setup.tolerances["gap"]) & (gaps <= setup.tolerances["gap"])
            new_offsets = np.where(began, np.where(near, gaps, 0.0), new_offsets)
        values = None
        if new_offsets.any():
            values = setup.values.copy()
            values[offsets] = new_offsets
        return jump, flow._replace(values=values)

    def _jump(self, at: SceneInstant) -> JumpResult:
        setup, clock, _, flow, state, fired = at
        snapshot = self.tape.at(setup.values, state, clock.high)
        strike = partial(self._strike, at, snapshot)
        switched = self._switching.switched(at, snapshot, strike)
        if switched:
            return self._switching.jump(at, snapshot, switched)
        here = self._landing(at, hidden(snapshot, flow.mode))
        if fired == (UNBOUNDED,):
            return self._unbounded(here)
        for name in self._names:
            if f"{name}.{HAULED}" in fired:
                raise winch_end_message(name, clock.high)
        if here.hitting:
            return self._impact(here, here.hitting)
        touching = here.snapshot.remaining(here.closed, here.slow)
        uncertainty = uncertainty_at(self.tape, here)
        before = Before.flow(flow.roles, here.moving)
        around = hidden_at(self.tape, setup.values, clock.high, flow.mode)
        choice = choose_at_rest(
            setup, here.snapshot, touching, here.at.state, around, before, uncertainty
        )
        if isinstance(choice, Jam):
            if choice.sliding[choice.place] == here.moving[choice.place]:
                # A contact that slid to where sliding ends: p fell to zero on the way.
                grown = self._grown(here)
                choice = choice if grown is None else dataclasses.replace(choice, why=grown.why)
            return self._impact(here, [choice.place], choice)
        for law, soft, taken in zip(
            setup.contacts, snapshot.soft, choice.taken.states, strict=False
        ):
            if soft and taken == "free" and law.cone_n == 0.0 and f"{law.name}.gap" in fired:
                raise NoConsistentMode(
                    f"contact {law.name!r} touches with a slip, and its infinite friction has no "
                    f"normal force yet; write contacts.{law.name}.friction: 100"
                )
        return self._enter(at, here, choice)

    def change(self, at: SceneInstant, before: SceneSetup) -> tuple[Jump | None, Flow]:
        """Return the jump and the flow at a change of parameters, which may move surfaces."""
        setup, flow = at.setup, at.flow
        if flow.values is not None:
            offsets = self.numbers.gap_offsets
            values = setup.values.copy()
            values[offsets] = flow.values[offsets]
            flow = flow._replace(values=values)
        here = at.state, at.clock.high
        target, _, strikes = modes_after_change(
            self._mechanics.scene, flow.mode, self.tape, self.conditions,
            ParameterChange(before.values, setup, *here),
        )  # fmt: skip
        # A contact that its surface strikes lifts off at most after its touchdown, which follows.
        modes = zip(flow.mode, target, strikes.tolist(), strict=True)
        shown = tuple(old if struck else new for old, new, struck in modes)
        following = flow if target == flow.mode else flow_after_move(flow, target)
        if shown == flow.mode:
            return None, following
        energy = self.tape.at(setup.values, *here).energy
        event = cause(self._names, flow.mode, shown, False)
        return at.jump(*event, target, energy=(energy, energy)), following

    def close(self, at: SceneInstant, joint: str, cause: str) -> tuple[Jump, Flow]:
        """Close a joint: its points stop, and so do contacts that are closed, without rebound.

        Raises `NoConsistentMode` if the joint is open or beyond its limits.
        """
        setup = at.setup
        snapshot = self.tape.at(setup.values, at.state, at.clock.high)
        near = setup.tolerances["gap"]
        apart = max(_START_DEPTH * setup.scales.length, near)
        check_closing(self._mechanics, snapshot, joint, apart)
        snapshot = hidden(snapshot, at.flow.mode)
        state = on_constraints(("free",) * len(self._names), snapshot, at.state)
        after = hidden(self.tape.at(setup.values, state, at.clock.high), at.flow.mode)
        plastic = tuple(law._replace(restitution=0.0) for law in setup.contacts)
        at_rest = at._replace(setup=dataclasses.replace(setup, contacts=plastic), state=state)
        closed = [c.gap <= near for c in after.contacts]
        here = Landing(at_rest, after, moving_mode(at.flow.roles), closed)
        jump, flow, _ = impact_jump(self.tape, here, (joint, cause), before=at.state)
        _, energy_after = jump.energy or (0.0, 0.0)
        energy = snapshot.energy, energy_after
        return dataclasses.replace(jump, before=at.state, energy=energy), flow

    def _strike(
        self, at: SceneInstant, snapshot: Snapshot, mode: Key
    ) -> tuple[Array, Snapshot] | None:
        """Return the state and snapshot after an impact of the contacts of a mode."""
        at = at._replace(flow=at.flow._replace(mode=mode, roles=roles_in(mode)))
        here = self._landing(at, hidden(snapshot, mode))
        if not here.hitting:
            return None
        after = impact_jump(self.tape, here, (self._names[here.hitting[0]], "touchdown"))[0].after
        return after, self.tape.at(at.setup.values, after, at.clock.high)

    def _landing(self, at: SceneInstant, snapshot: Snapshot) -> Landing:
        """Project the state onto the constraints of the flow.

        Between steps dense output leaves them by its own error: a contact that was closed counts as
        closed.
        """
        setup, flow, moving = at.setup, at.flow, moving_mode(at.flow.roles)
        held = constraint_key(flow.roles, snapshot.soft)
        state = landed(held, snapshot, at.state, setup.tolerances)
        slow, close = setup.tolerances["speed"], setup.tolerances["gap"]
        rested = self._rested(flow, held, snapshot, at.fired, setup.slip_tolerance)
        if rested != held:
            state = on_constraints(rested, snapshot, state)
        if state is not at.state:
            snapshot = hidden(self.tape.at(setup.values, state, at.clock.high), flow.mode)
            state = in_contact(rested, snapshot, brought := state, slow)
            if state is not brought:
                snapshot = hidden(self.tape.at(setup.values, state, at.clock.high), flow.mode)
        # A gap that falls between two floats of time is still above its tolerance at one of them.
        # The top of a low flight, where a drag of its speed switches, is no contact.
        rounding = math.ulp(at.clock.high)
        closed = [
            c.gap <= close - rounding * c.gap_rate
            if f"{name}.gap" in at.fired
            else c.gap <= close
            and (was != "free" or c.gap <= setup.scales.rounding or abs(c.gap_rate) > slow)
            for name, was, c in zip(self._names, moving, snapshot.contacts, strict=True)
        ]
        snapshot = close_compliant(snapshot, closed)
        return Landing(at._replace(state=state), snapshot, moving, closed)

    def _unbounded(self, here: Landing) -> tuple[Jump, Flow] | None:
        """Resolve a flow that ends because a force grows without bound."""
        setup, snapshot, moving = here.at.setup, here.snapshot, here.moving
        jam = self._grown(here)
        if jam is None:
            sizes = np.append(setup.scales.coordinates, np.ones(snapshot.unreduced.pads))
            # Contacts that share a load have dependent constraints by design.
            why = dead_point(snapshot, setup.contacts, moving, sizes)
            if why and roles_in(moving) == uncaptured(here.at.flow.roles):
                raise SingularMode(why)
            return None
        if setup.paradox == "stop":
            raise NoConsistentMode(jam.why)
        return self._impact(here, [jam.place], jam)

    def _grown(self, here: Landing) -> Jam | None:
        shut = [state not in OPEN for state in here.moving]
        return resolve_jam(here.at.setup, here.snapshot, shut, unbounded=True)

    def _enter(self, at: SceneInstant, here: Landing, choice: Choice) -> JumpResult:
        """Return the jump to a mode from an instant; None if the flow already moves in it."""
        (setup, clock, _, flow, state, fired), snapshot, moving, _ = here
        target = choice.taken.states
        skipping = moving != flow.mode
        if target == moving and not (skipping and fired == ("zeno",)):
            goes_on = mark_captured_roles(flow.mode, choice.taken.roles)
            if goes_on != flow.roles:
                # Zones that change may leave or come to the boundary of a cone.
                own = {n: t for n, t in flow.tolerances.items() if not self._of_forces((n,))}
                flow = flow._replace(warning=choice.warning, notes=choice.notes)
                flow = flow._replace(tolerances={**own, **choice.tolerances})
                return None, flow._replace(roles=goes_on, settled=True)
            if not fired or flow.settled:
                return None
            # The force fell off the constraints by their error: on them it may not have. Projected
            # once per instant (`settled`): twice changes the last bits.
            if state is at.state and self._of_forces(fired):
                state = on_constraints(constraint_key(flow.roles, snapshot.soft), snapshot, state)
            if np.array_equal(state, at.state):
                return None
            return None, flow._replace(settled=True, start=state)
        held, energy = constraint_key(choice.taken.roles, snapshot.soft), snapshot.energy
        after = landed(held, snapshot, state, setup.tolerances)
        if after is not state:
            energy = self.tape.at(setup.values, after, clock.high).energy
        jump = at.jump(
            *cause(self._names, flow.mode, target, skipping), target, after,
            considered=choice.considered, energy=(snapshot.energy, energy),
        )  # fmt: skip
        return jump, flow_in(setup, target, choice)

    def _of_forces(self, fired: tuple[str, ...]) -> bool:
        kinds = (*FORCE_MARGINS, *LIMIT_MARGINS)
        forces = {f"{name}.{force}" for name in self._names for force in kinds}
        return bool(fired) and forces.issuperset(fired)

    def _rested(
        self, flow: Flow, moving: Key, snapshot: Snapshot, fired: tuple[str, ...], still: float
    ) -> Key:
        """Return the mode with contacts pinned whose slip has ended within the resolution of time.

        Under an unbounded force slip changes by more than its tolerance in the last bit of time.
        """
        if flow.sizes is None:
            return moving
        # Round-off of the rates of coordinates; rates of pads of compliant contacts come after.
        n, whole, rested = snapshot.size, snapshot.unreduced, [*moving]
        rounding = np.abs(whole.jacobians[:, 1, :n]) @ (EPS * flow.sizes[n : 2 * n])
        for i, name in enumerate(self._names):
            if f"{name}.slip" in fired and still < abs(whole.contacts[i].slip) <= rounding[i]:
                rested[i] = "locked" if moving[i] in SLIPPING else "pin"
        return tuple(rested)

    def accumulate(
        self, setup: SceneSetup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Close all contacts of impacts whose intervals shrink to zero.

        For example a block that rocks from corner to corner; bounces of one contact are summed at
        its impact (`contacts.impacts.bounces`).
        """
        jump = jumps[-1]
        same_event = jump.region, jump.cause
        since = [j for j, past in enumerate(jumps[:-1]) if (past.region, past.cause) == same_event]
        if jump.cause != "touchdown" or not since:
            return None
        took_part = set().union(*(past.impulse for past in jumps[since[-1] :]))
        if len(took_part) < 2:
            return None
        took = [name in took_part for name in self._names]
        period = jump.t - jumps[since[-1]].t
        jump, flow, in_corner = self._engage_corner(setup, clock, flow, jump)
        result = self._closed_at_once(setup, clock, flow, jump, took, period, rest)
        if result is None or not in_corner:
            return result
        jump, flow = result
        if not all(flow.roles[i].captured for i in in_corner):
            return None
        own, on_boundary = self.special_tolerances(setup, flow, jump.after, clock.high)
        settled = flow.settled and not on_boundary
        return jump, flow._replace(tolerances={**flow.tolerances, **own}, settled=settled)

    def _engage_corner(
        self, setup: SceneSetup, clock: Clock, flow: Flow, jump: Jump
    ) -> tuple[Jump, Flow, list[int]]:
        """Enable the disabled contacts of the corner at which an impact has left their point."""
        snapshot = self.tape.at(setup.values, jump.after, clock.high)
        in_corner = self._switching.corner_contacts(
            setup, snapshot, jump.after, clock.high, flow.mode
        )
        if in_corner:
            mode = tuple("free" if i in in_corner else now for i, now in enumerate(flow.mode))
            jump, flow = dataclasses.replace(jump, target=mode), flow_after_move(flow, mode)
        return jump, flow, in_corner

    def _closed_at_once(
        self, setup: SceneSetup, clock: Clock, flow: Flow, jump: Jump, took_part: Sequence[bool],
        period: float, rest: float,
    ) -> tuple[Jump, Flow] | None:  # fmt: skip
        at = partial(self.tape.at, setup.values, time=clock.high)
        return close_immediately(setup, at, flow, jump, took_part, period, rest)

    def constraints(
        self, setup: SceneSetup, roles: Roles, start: float, anchor: Array
    ) -> Constraints:
        """Return the constraints of the closed contacts of `roles`, and of pinned points."""
        return self._projection.constraints(setup, roles, start, anchor)

    def feasibility(
        self, regions: Sequence[Region], setup: SceneSetup, state: Array, time: float
    ) -> Feasibility:
        """Test every product mode by the velocities that it requires."""
        failing = self.conditions.at(setup, state, time).failing()
        return scene_feasibility(regions, setup, self.snapshot(setup, state, time), failing)

    def _impact(
        self, here: Landing, hitting: list[int], jam: Jam | None = None
    ) -> tuple[Jump, Flow]:
        # Round-off decides which of simultaneous impacts is named.
        event = self._names[hitting[0]], "touchdown" if jam is None else "jam"
        jump, flow, following = impact_jump(self.tape, here, event, jam)
        setup, closed, (before, after) = here.at.setup, here.closed, jump.energy or (0.0, 0.0)
        clock, done = here.at.clock, None
        idle = jam is None and sum(strike_jammed(setup.contacts, closed)) > 1 and after >= before
        if idle and reopens_immediately(setup, following, closed):
            done = self._closed_at_once(setup, clock, flow, jump, closed, 0.0, jump.skipped)
        if done is None and jam is None and self.conditions.present and not jump.skipped:
            done = self._captured_in_corner(setup, clock, jump, flow)
        return done or (jump, flow)

    def _captured_in_corner(
        self, setup: SceneSetup, clock: Clock, jump: Jump, flow: Flow
    ) -> tuple[Jump, Flow] | None:
        """Stop a point that oscillates through a corner so slowly that round-off moves it.

        The place of a takeover is known to the round-off of its condition: a fall over that
        distance gives the speed that the impact takes.
        """
        engaged, following, in_corner = self._engage_corner(setup, clock, flow, jump)
        shut = [i for i, now in enumerate(flow.mode) if now not in OPEN]
        at = partial(self.tape.at, setup.values, time=clock.high)
        if len(in_corner) != 1:
            return None
        points, other = self.conditions.points, in_corner[0]

        def strike(snapshot: Snapshot, closed: Sequence[bool]) -> Array:
            closed = strike_jammed(setup.contacts, closed)
            return impacts(snapshot, setup.contacts, closed, setup.simultaneous).velocity

        for on in (i for i in shut if points[i] == points[other]):
            rest = rest_of_passages(setup, at, strike, jump.after, on, other)
            if rest is None:
                continue
            took = [i == other or i in shut for i in range(len(flow.mode))]
            result = self._closed_at_once(setup, clock, following, engaged, took, 0.0, rest)
            if result is not None and result[1].roles[other].captured:
                return result
        return None


class Compliance:
    """Compliant contacts of a scene.

    A damped contact lifts off inside its surface, where its force vanishes. From there it presses
    again, or leaves the surface, whichever comes first.
    """

    def __init__(self, mechanics: Mechanics, states: Mapping[str, str] | None) -> None:
        names = [*mechanics.scene.contacts]
        self._places = [(name, names.index(name)) for name in mechanics.pads]
        symbols = map(mechanics.contact, mechanics.pads)
        numbers = [e for one in symbols for e in (one.gap, one.compliance)]
        self._tape = mechanics.tape(numbers, definitions=mechanics.controlled(states))

    def tolerances(
        self, setup: SceneSetup, mode: Key, state: Array, time: float
    ) -> dict[str, float]:
        """Return margin -> tolerance in a flow from here; infinity: unwatched."""
        own: dict[str, float] = {}
        near, press = setup.tolerances["gap"], setup.tolerances["force"]
        numbers = self._tape.at(state, setup.values, time).reshape(-1, 2)
        for (name, place), (gap, force) in zip(self._places, numbers.tolist(), strict=True):
            if mode[place] in OPEN:
                bands = (math.inf, press, UNDERFLOW) if gap < -near else (near, math.inf, math.inf)
                margins = (f"{name}.{margin}" for margin in ("gap", PULL, OUTSIDE))
                own |= dict(zip(margins, bands, strict=True))
            elif gap >= 0.0 and force < 0.0:
                # Round-off of a gap that has just closed, times a stiffness.
                edge = max(setup.contacts[place].cone_n, np.finfo(float).tiny)
                own |= {f"{name}.{margin}": press - 2.0 * force / edge for margin in FORCE_MARGINS}
        return own
