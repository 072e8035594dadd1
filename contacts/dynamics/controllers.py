"""Controllers as regions: guards, and variables that follow those of the motion in the state.

Forces may depend on the variables, but contacts do not change them: contact laws take them as
parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from functools import partial
from itertools import chain
from typing import TypeVar

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.scene.expansion import BROKEN, joints_judged_at_start
from contacts.states import CLOSED, OFF
from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.automaton.regions import Edge, Region, State
from statechart.automaton.trace import Key, Role
from statechart.charts.flatten import FlatRegion, FlatTransition, Updates
from statechart.charts.guard_watch import (
    Guard,
    GuardWatch,
    check_updated,
    guard_claims,
    guard_margins,
    guards,
    guards_at_events,
    values_after,
)
from statechart.errors import DeclarationProblem
from statechart.formulas.tape import Tape

_T = TypeVar("_T")


def controller(name: str, flat: FlatRegion, mechanics: Mechanics) -> Region:
    """Return the region of a controller."""
    joint = [row for row in mechanics.joint_rows if row.joint == name and row.closed is not None]

    def build(role: Role) -> State:
        off = role.state != CLOSED
        return State(
            tuple(row.force if off else row.equation(mechanics.a) for row in joint),
            margins=guard_margins(flat, role.state, mechanics.observables),
            values=mechanics.sets(name, role.state),
            holds=() if off else tuple(row.hold(mechanics.a) for row in joint),
        )

    sets = {state: mechanics.scene.controlled.values(name, state) for state in flat.states}

    def edge(transition: FlatTransition) -> Edge:
        before, after = sets[transition.source], sets[transition.target]
        changed = [f"{c} := {after[c]}" for c in after if after[c] != before[c]]
        return Edge(
            transition.name,
            transition.source,
            transition.target,
            transition.trigger,
            ", ".join(filter(None, (transition.reset(), *changed))),
        )

    edges = tuple(map(edge, flat.transitions))
    return Region(
        name,
        flat.ordered,
        build,
        edges,
        flat.superstates,
        nesting=flat.nesting,
        forces=tuple(row.force for row in joint),
        claims=partial(guard_claims, flat),
    )


class Controllers:
    """States and variables of a scene's controllers; guards and updates are built when needed."""

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        self._guards: dict[tuple[Key, bool], ControlGuards] = {}
        self._updates: dict[tuple[tuple[tuple[str, object], ...], ...], Tape] = {}
        self.flat = mechanics.scene.controlled.flat
        self.names = tuple(self.flat)
        # Joints that controllers switch.
        self.joints = {row.joint for row in mechanics.joint_rows if row.closed is not None}
        self.initial: Key = tuple(mechanics.scene.controlled.initial.values())
        self._joints_judged_at_start = joints_judged_at_start(mechanics.scene)

    def named(self, states: Key) -> dict[str, str]:
        """Return controller -> state."""
        return dict(zip(self.names, states, strict=True))

    def guards(self, states: Key, *, at_events: bool = False) -> ControlGuards:
        """Return the guards of the states: those that fire in a flow, or those judged at events."""
        key = states, at_events
        if key not in self._guards:
            select = guards_at_events if at_events else guards
            regions = zip(self.flat.values(), states, strict=True)
            chosen = (select(place, *region) for place, region in enumerate(regions))
            watched = [*chain.from_iterable(chosen)]
            self._guards[key] = ControlGuards(self._mechanics, self.named(states), watched)
        return self._guards[key]

    def settle_start(
        self, begin: Callable[[Key], _T], due_in: Callable[[Key, _T], Set[tuple[int, int]]]
    ) -> _T:
        """Return the start with those joints closed whose relations hold there.

        Relations on contacts and forces are judged at the start that `begin` makes of initial
        states of controllers; `due_in` returns its due guards, by region and trigger. Both states
        may agree with the relation of a joint: it starts closed then.
        """
        states, seen, refused = self.initial, set[Key](), dict[Key, DeclarationProblem]()
        while True:
            seen.add(states)
            try:
                start = begin(states)
            except DeclarationProblem as problem:
                # A joint that cannot be closed is off, if its relation then fails.
                following = self._opened(states, problem)
                if following is None or following in seen:
                    raise next(iter(refused.values()), problem) from None
                refused[states] = problem
            else:
                due = due_in(states, start) if self._joints_judged_at_start else frozenset()
                following = self._switched(states, due)
                if following in refused:
                    raise refused[following]
                if following in seen:
                    return start
            states = following

    def _opened(self, states: Key, problem: DeclarationProblem) -> Key | None:
        """Return the states with the closed joint of a problem off, None if it stays closed."""
        joint = str(problem.loc[1]) if problem.loc[:1] == ("joints",) else ""
        place = self._joints_judged_at_start.get(joint)
        if place is None or states[place] != CLOSED:
            return None
        return (*states[:place], OFF, *states[place + 1 :])

    def _switched(self, states: Key, due: Set[tuple[int, int]]) -> Key:
        """Return the states with the first joint switched whose guard is due."""
        regions = [*self.flat.values()]
        for place in self._joints_judged_at_start.values():
            if triggers := [trigger for region, trigger in due if region == place]:
                target = regions[place].answer(states[place], triggers).target
                if target != BROKEN:
                    return (*states[:place], target, *states[place + 1 :])
        return states

    def opening_first(self, due: Set[tuple[int, int]], states: Key) -> Set[tuple[int, int]]:
        """Return the due guards, by region and trigger; where joints close, first those that open.

        A joint that closes stops a body against the joints that still hold it.
        """
        of_joints = {one for one in due if self.names[one[0]] in self.joints}
        opening = {one for one in of_joints if states[one[0]] == CLOSED}
        return opening if opening and opening != of_joints else due

    def enter_initial_states(
        self, setup: SceneSetup, clock: Clock, state: Array, states: Key
    ) -> Array:
        """Return the state after the controllers have entered their initial `states`.

        A joint that starts off although its region begins closed captures nothing.
        """
        for (name, region), entered in zip(self.flat.items(), states, strict=True):
            if entered == region.initial:
                state = self.updated(setup, clock, name, region.begins, state)
        return state

    def updated(
        self, setup: SceneSetup, clock: Clock, cause: str, blocks: tuple[Updates, ...], state: Array
    ) -> Array:
        """Return the state after updates; each block uses the values that the last one set.

        Raises `NonFinite` if one has no finite value.
        """
        if not blocks:
            return state
        key = tuple(tuple(block.items()) for block in blocks)
        tape = self._updates.get(key)
        if tape is None:
            mechanics = self._mechanics
            values = values_after(blocks, mechanics.controller_state, mechanics.known)
            tape = self._updates[key] = mechanics.tape(values)
        remembered = tape.at(state, setup.values, clock.high)
        check_updated(cause, self._mechanics.controller_state, remembered)
        return np.concatenate([state[: len(state) - len(remembered)], remembered])


class ControlGuards:
    """Guards in given states of the controllers, and the quantities that they depend on.

    Accelerations and contact forces are inputs, solved for when a guard is on its boundary, so
    that no mode is built for them. Accelerations count as constant there. The rates of forces are
    unknown: a guard on forces waits for its margin to fall.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        states: Mapping[str, str],
        watched: Sequence[Guard],
    ) -> None:
        known = mechanics.values_in(states)
        memory = mechanics.controller_rates_in(known)
        names = set().union(*(guard.relation.names for guard in watched))
        named = {n: e for n, e in mechanics.observables.items() if n in names}
        forces = [force for pair in mechanics.forces.values() for force in pair]
        forces += [*mechanics.couples.values(), *(row.force for row in mechanics.joint_rows)]
        self.unknowns = (*mechanics.a, *forces)
        # A symbol for each force: the unknown rates of two do not cancel.
        unknown = sp.symbols(f"unknown:{len(forces)}", real=True)
        self.watch = GuardWatch(
            watched,
            lambda guard: guard.relation.condition(named),
            {
                **dict(zip(mechanics.q, mechanics.v, strict=True)),
                **dict(zip(mechanics.v, mechanics.a, strict=True)),
                **dict(zip(forces, unknown, strict=True)),
                **memory,
            },
            inputs=(*mechanics.state, *self.unknowns, *unknown),
            parameters=mechanics.parameters.ordered,
            time=mechanics.time,
            timers=[
                mechanics.controller_state[timer] for timer in mechanics.scene.controlled.timers
            ],
            substitutions=known,
        )
        self._unsolved = np.full(len(self.unknowns), np.nan)
        self._unknown = np.full(len(forces), np.nan)

    def typical(self, setup: SceneSetup) -> Array:
        """Return the typical sizes of accelerations and forces."""
        return setup.scales.solved(len(self._unsolved))

    def atoms_at(
        self, setup: SceneSetup, time: float, state: Array, solved: Array | None = None
    ) -> Array:
        """Evaluate `GuardWatch.at`; `solved` are accelerations and forces."""
        return self.watch.at(setup, self.inputs(state, solved), self.sizes(setup), time)

    def table(
        self, setup: SceneSetup, times: Array, states: Array, solved: Array, *, order: int = 0
    ) -> Array:
        """Return `GuardWatch.table` for instants (m,), states (m, 2 n) and unknowns (m, u)."""
        inputs = np.hstack([states, solved, np.tile(self._unknown, (len(states), 1))])
        return self.watch.table(setup, inputs, self.sizes(setup), times, order=order)

    def inputs(self, state: Array, solved: Array | None) -> Array:
        """Return the inputs of the watch."""
        return np.concatenate([state, self._unsolved if solved is None else solved, self._unknown])

    def sizes(self, setup: SceneSetup) -> Array:
        """Return the sizes of the inputs."""
        return np.concatenate([setup.sizes, self.typical(setup), np.zeros_like(self._unknown)])
