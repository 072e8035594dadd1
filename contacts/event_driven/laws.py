"""What happens to a scene between its flows: classification, impacts, Zeno capture."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from contacts.dynamics.assembly import check_joints
from contacts.dynamics.conditions import Conditions, hidden
from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.projection import Projection, dead_point, landed, on_constraints
from contacts.dynamics.setup import SceneNumbers, SceneSetup
from contacts.dynamics.snapshot import Snapshot, SnapshotTape
from contacts.dynamics.starting import check_start
from contacts.event_driven.accumulation import closed_at_once
from contacts.event_driven.decision import check_listed, decide, explained
from contacts.impacts.bounces import opens_in_vain, rests_of_bounces, stands_for_bounces
from contacts.impacts.jamming import Jam, closed_state, listed, unbounded, without_collision
from contacts.impacts.simultaneous import Impacts, impacts
from contacts.modes.classification import Choice, Considered
from contacts.modes.configuration import judged
from contacts.modes.fast_classification import fast_mode
from contacts.states import OFF, OPEN
from statechart.arrays import Array
from statechart.automaton.constraints import Constraints
from statechart.automaton.feasibility import Feasibility
from statechart.automaton.laws import (
    CAPTURED,
    UNBOUNDED,
    Flow,
    Instant,
    Setup,
    shown_mode,
    uncaptured,
)
from statechart.automaton.regions import Region
from statechart.automaton.trace import Clock, Jump, Key
from statechart.errors import DeclarationProblem, NoConsistentMode, SingularMode
from statechart.formulas.parameters import Parameters

_EPS = float(np.finfo(float).eps)
# A start may be inside a surface by so much of the scene's length (and is projected out).
_START_DEPTH = 1e-9


def _alike(one: Jump, other: Jump) -> bool:
    return (one.region, one.cause) == (other.region, other.cause)


def _shown(mode: Key, flow: Key) -> Key:
    """Return a flow with the contacts marked whose bounces are skipped: they are shown as free."""
    return tuple(
        CAPTURED + moves if shown in OPEN and moves not in OPEN else moves
        for shown, moves in zip(mode, flow, strict=True)
    )


class SceneLaws:
    """The laws of a scene (see `statechart.automaton.laws.Laws`).

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    parameters : Parameters
        From `contacts.dynamics.setup.scene_parameters`.
    numbers : SceneNumbers
        From the values of the parameters to the numbers of a run.
    """

    def __init__(self, mechanics: Mechanics, parameters: Parameters, numbers: SceneNumbers) -> None:
        symbols = list(parameters.symbols.values())
        self._mechanics = mechanics
        self._modes = mechanics.scene.modes
        self._simultaneous = mechanics.scene.simultaneous
        self._paradox = mechanics.scene.paradox
        self._names = tuple(mechanics.scene.contacts)
        self.numbers = numbers
        self._tape = SnapshotTape(mechanics, symbols)
        self._gates = self.numbers.gates
        # Without joints and conditions, an instant may be a usual one.
        self._plain = not mechanics.joint_rows and not self._gates.present
        self._projection = Projection(mechanics, symbols, self._tape)

    def under(self, tape: SnapshotTape, gates: Conditions) -> SceneLaws:
        """Return the laws where forces are those of `tape`, and conditions those of `gates`."""
        laws = copy.copy(self)
        laws._tape, laws._gates = tape, gates
        return laws

    def snapshot(self, setup: Setup, state: Array, time: float) -> Snapshot:
        """Return the scene's numbers at a state."""
        return self._tape.at(setup.values, state, time)

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the first mode, checked against the declared one."""
        assert isinstance(setup, SceneSetup)
        state = setup.initial
        if self._plain and not self._modes:
            mode = fast_mode(setup, self._tape, state, 0.0, None)
            if mode is not None:
                return self._flow(setup, mode[0]), state
        check_joints(self._mechanics, self._tape, setup, _START_DEPTH)
        snapshot = self._tape.at(setup.values, state, 0.0)
        failing = self._gates.failing(setup.values, state, 0.0)
        depth = max(_START_DEPTH * setup.scales.length, setup.tolerances["gap"])
        off = tuple(
            OFF if why or (self._modes.get(name) == OFF and contact.gap < -depth) else "free"
            for name, why, contact in zip(self._names, failing, snapshot.contacts, strict=True)
        )
        snapshot = hidden(snapshot, off)
        near, slow = setup.tolerances["gap"], setup.tolerances["speed"]
        for law, contact in zip(setup.contacts, snapshot.contacts, strict=True):
            check_start(law, contact[:3], depth, near, slow)
        closed = [c.gap <= near for c in snapshot.contacts]
        touching = [
            shut and abs(c.gap_rate) <= slow
            for shut, c in zip(closed, snapshot.contacts, strict=True)
        ]
        key = tuple("slide" if shut else "free" for shut in touching)
        inside = [c.gap < 0.0 for c in snapshot.contacts]
        if any(inside):
            state = on_constraints(key, snapshot, state, inside=inside)
        else:
            state = landed(key, snapshot, state, setup.tolerances)
        if state is not setup.initial:
            snapshot = hidden(self._tape.at(setup.values, state, 0.0), off)
        choice = decide(setup, snapshot, touching, self._paradox)
        if isinstance(choice, Jam):
            starts = listed(choice.sliding, setup.contacts, snapshot.contacts, 2.0 * slow)
            return self._flow(setup, starts, choice.sliding, settled=False), state
        self._check_declared(choice, snapshot, touching, failing)
        taken = choice.taken
        settled = not any(
            shut and c.gap_rate < -slow for shut, c in zip(closed, snapshot.contacts, strict=True)
        )
        starts = listed(taken.states, setup.contacts, snapshot.contacts, 2.0 * slow)
        return self._flow(
            setup, starts, taken.flow, None, choice.warning, settled, choice.notes
        ), state

    def jump(self, at: Instant) -> tuple[Jump | None, Flow] | None:
        """Classify every contact from the state; see `contacts.modes.classification`."""
        setup, clock, _, flow, state, fired = at
        assert isinstance(setup, SceneSetup)
        if self._plain and flow.mode == flow.flow and fired != (UNBOUNDED,):
            mode = fast_mode(setup, self._tape, state, clock.high, flow.flow)
            if mode is not None:
                return self._usual(at, setup, *mode)
        before = state
        snapshot = self._tape.at(setup.values, state, clock.high)
        switched = self._gates.switched(
            flow.mode,
            snapshot,
            setup.values,
            state,
            clock.high,
            fired,
            setup.tolerances["gap"],
            setup.bands,
        )
        if switched:
            return self._switch(at, snapshot, switched)
        snapshot = hidden(snapshot, flow.mode)
        # Between steps a dense output leaves the constraints by its own error: a contact that the
        # flow kept closed is judged as closed.
        moving = shown_mode(flow.flow)
        state = landed(moving, snapshot, state, setup.tolerances)
        slow, close = setup.tolerances["speed"], setup.tolerances["gap"]
        rested = self._rested(flow, moving, snapshot, fired, 2.0 * slow)
        if rested != moving:
            state = on_constraints(rested, snapshot, state)
        landing = at._replace(state=state)
        if state is not before:
            snapshot = hidden(self._tape.at(setup.values, state, clock.high), flow.mode)
        closed = [c.gap <= close for c in snapshot.contacts]
        if fired == (UNBOUNDED,):
            shut = [state not in OPEN for state in moving]
            jam = unbounded(snapshot, setup.contacts, shut, 2.0 * slow)
            if jam is None:
                sizes = setup.scales.sizes[: len(state) // 2]
                # Where contacts share a load their constraints are dependent, and rightly so.
                why = dead_point(snapshot, setup.contacts, moving, sizes)
                if why and moving == uncaptured(flow.flow):
                    raise SingularMode(why)
                return None
            if self._paradox == "stop":
                raise NoConsistentMode(jam.why)
            return self._impact(landing, setup, snapshot, [*jam.places], closed, jam)
        hitting = [i for i, c in enumerate(snapshot.contacts) if closed[i] and c.gap_rate < -slow]
        if hitting:
            return self._impact(landing, setup, snapshot, hitting, closed)
        touching = [
            shut and c.gap_rate <= slow for shut, c in zip(closed, snapshot.contacts, strict=True)
        ]
        choice = decide(setup, snapshot, touching, self._paradox)
        if isinstance(choice, Jam):
            if all(choice.sliding[i] == moving[i] for i in choice.places):
                # A contact that slid on to where none can: p fell to zero on the way.
                shut = [state not in OPEN for state in moving]
                grown = unbounded(snapshot, setup.contacts, shut, 2.0 * slow)
                choice = choice if grown is None else dataclasses.replace(choice, why=grown.why)
            return self._impact(landing, setup, snapshot, [*choice.places], closed, choice)
        target = choice.taken.states
        skipping = moving != flow.mode
        if target == moving and not (skipping and fired == ("zeno",)):
            goes_on = _shown(flow.mode, choice.taken.flow)
            if goes_on != flow.flow:
                return None, flow._replace(flow=goes_on, settled=True)
            if state is before or not fired or flow.settled:
                return None
            # What fell off the constraints has not fallen on them.
            return None, flow._replace(settled=True, start=state)
        after = landed(target, snapshot, state, setup.tolerances)
        energy = snapshot.energy
        left = energy if after is state else self._energy(setup, after, clock.high)
        jump = at.jump(
            *self._cause(flow.mode, target, skipping),
            target,
            after,
            considered=choice.considered,
            energy=(energy, left),
        )
        return jump, self._flow(
            setup, target, choice.taken.flow, warning=choice.warning, notes=choice.notes
        )

    def _rested(
        self, flow: Flow, moving: Key, snapshot: Snapshot, fired: tuple[str, ...], still: float
    ) -> Key:
        """Return the mode with those contacts pinned whose slip has ended as far as time tells.

        Under a force that grows without bound slip changes by more than its tolerance in the last
        bit of the time at which it ends.
        """
        if flow.sizes is None:
            return moving
        rounding = _EPS * flow.sizes[len(flow.sizes) // 2 :]
        return tuple(
            "pin"
            if f"{name}.slip" in fired
            and still < abs(contact.slip) <= float(np.abs(contact.jacobian[1]) @ rounding)
            else state
            for name, state, contact in zip(self._names, moving, snapshot.contacts, strict=True)
        )

    def _usual(
        self, at: Instant, setup: SceneSetup, target: Key, energy: float
    ) -> tuple[Jump, Flow] | None:
        """Return the jump to the one mode that agrees with the state."""
        if target == at.flow.mode:
            return None

        def considered() -> Mapping[str, str]:
            snapshot = self._tape.at(setup.values, at.state, at.clock.high)
            near = setup.tolerances["gap"]
            touching = [
                c.gap <= near and c.gap_rate <= setup.tolerances["speed"] for c in snapshot.contacts
            ]
            choice = decide(setup, snapshot, touching, self._paradox)
            return {} if isinstance(choice, Jam) else choice.considered

        jump = at.jump(
            *self._cause(at.flow.mode, target, False),
            target,
            considered=Considered(considered),
            energy=(energy, energy),
        )
        return jump, self._flow(setup, target)

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Close all contacts that took part in impacts whose intervals shrink to nothing.

        A block that rocks from corner to corner, a bar that rattles on both ends; the bounces of
        one contact are summed where they happen (`contacts.impacts.bounces`).
        """
        assert isinstance(setup, SceneSetup)
        jump = jumps[-1]
        since = [j for j, past in enumerate(jumps[:-1]) if _alike(past, jump)]
        if jump.cause != "touchdown" or not since:
            return None
        took_part = set().union(*(past.impulse for past in jumps[since[-1] :]))
        if len(took_part) < 2:
            return None
        took = [name in took_part for name in self._names]
        period = jump.t - jumps[since[-1]].t
        return self._closed_at_once(setup, clock, flow, jump, took, period, rest)

    def _closed_at_once(
        self,
        setup: SceneSetup,
        clock: Clock,
        flow: Flow,
        jump: Jump,
        took_part: Sequence[bool],
        period: float,
        rest: float,
    ) -> tuple[Jump, Flow] | None:
        found = closed_at_once(
            setup,
            lambda state: self._tape.at(setup.values, state, clock.high),
            flow,
            jump.after,
            took_part,
            period,
            rest,
            self._paradox,
        )
        if found is None:
            return None
        energy = None if jump.energy is None else (jump.energy[0], found.energy)
        # A bar that rattles over a crest takes off from it: there is nothing to wait for.
        wait = None if found.choice.taken.flow == flow.mode else rest
        following = self._flow(
            setup,
            flow.mode,
            found.choice.taken.flow,
            wait,
            found.warning,
            notes=found.choice.notes,
        )
        return dataclasses.replace(jump, after=found.state, energy=energy, skipped=rest), following

    def constraints(self, setup: Setup, flow: Key, start: float, anchor: Array) -> Constraints:
        """Return what keeps the closed contacts of `flow` closed, and pinned points in place."""
        assert isinstance(setup, SceneSetup)
        return self._projection.constraints(
            shown_mode(flow), start, anchor, setup.values, setup.tolerances, setup.scales
        )

    def feasibility(
        self, regions: Sequence[Region], setup: Setup, state: Array, time: float
    ) -> Feasibility:
        """Judge every product mode by the velocities that it asks for."""
        assert isinstance(setup, SceneSetup)
        failing = self._gates.failing(setup.values, state, time)
        return judged(regions, setup, self.snapshot(setup, state, time), failing)

    def _impact(
        self,
        at: Instant,
        setup: SceneSetup,
        snapshot: Snapshot,
        hitting: list[int],
        closed: list[bool],
        jam: Jam | None = None,
    ) -> tuple[Jump, Flow]:
        clock, flow, state = at.clock, at.flow, at.state

        def collided(laws: Sequence[ContactLaw]) -> Impacts:
            if jam is not None:
                return without_collision(snapshot, laws, jam.places)
            return impacts(snapshot, laws, closed, self._simultaneous)

        laws, slow = setup.contacts, setup.tolerances["speed"]
        result = collided(laws)
        after = snapshot.moved(state, result.velocity)
        following = hidden(self._tape.at(setup.values, after, clock.high), flow.mode)
        rests = rests_of_bounces(setup, following, after, closed)
        if rests:
            plastic = tuple(
                law._replace(restitution=0.0) if i in rests else law for i, law in enumerate(laws)
            )
            captured = collided(plastic)
            stopped = snapshot.moved(state, captured.velocity)
            held = hidden(self._tape.at(setup.values, stopped, clock.high), flow.mode)
            if stands_for_bounces(rests, following, held, closed):
                laws, result, after, following = plastic, captured, stopped, held
            else:
                rests = {}
        rates = [contact.gap_rate for contact in following.contacts]
        touching = [shut and rate <= slow for shut, rate in zip(closed, rates, strict=True)]
        considered: Mapping[str, str] = {}
        warnings = [*filter(None, ("" if jam is None else str(jam), result.warning))]
        target = moving = tuple(OFF if name == OFF else "free" for name in flow.mode)
        notes: tuple[str, ...] = ()
        # A sequence of impacts may leave an approach behind: then it is asked again.
        settled = not any(shut and rate < -slow for shut, rate in zip(closed, rates, strict=True))
        check_listed(setup, following, touching)
        if any(touching):
            choice = decide(setup, following, touching, self._paradox)
            if isinstance(choice, Jam):
                moving, settled = choice.sliding, False
            else:
                considered, moving, notes = choice.considered, choice.taken.flow, choice.notes
                warnings += [choice.warning] if choice.warning else []
            after = landed(shown_mode(moving), following, after, setup.tolerances)
            # Where bounces are skipped the contact is still free, and moves as if closed.
            target = tuple(
                "free" if i in rests else name for i, name in enumerate(shown_mode(moving))
            )
        if jam is None and not rests:
            # What is hit without rebound and thrown off by the turning of its body closes first.
            ended = tuple(
                closed_state(law, contact, 2.0 * slow)
                if i in hitting and touching[i] and target[i] == "free" and law.restitution == 0.0
                else target[i]
                for i, (law, contact) in enumerate(zip(laws, following.contacts, strict=True))
            )
            if ended != target:
                target = moving = ended
                settled = False
        target = listed(target, laws, following.contacts, 2.0 * slow)
        before, left = snapshot.energy, self._energy(setup, after, clock.high)
        rest = max(rests.values(), default=None)
        jump = at.jump(
            laws[hitting[0]].name,  # whichever gap fell by a rounding earlier
            "touchdown" if jam is None else "jam",
            target,
            after,
            impulse={
                law.name: (normal, tangential)
                for law, (normal, tangential) in zip(laws, result.impulses.tolist(), strict=True)
                if normal != 0.0 or tangential != 0.0
            },
            path=result.path,
            considered=Considered(
                partial(
                    explained,
                    {} if jam is None else jam.considered,
                    laws,
                    following.contacts,
                    closed,
                    touching,
                    considered,
                )
            ),
            energy=(before, left),
            skipped=rest or 0.0,
        )
        warning = "; ".join(warnings)
        flow = self._flow(setup, target, moving, rest, warning, settled, notes)
        idle = jam is None and sum(closed) > 1 and left >= before
        if idle and opens_in_vain(setup, following, closed):
            done = self._closed_at_once(setup, clock, flow, jump, closed, 0.0, rest or 0.0)
            if done is not None:
                return done
        # Where a long flight's rounding has left a gap below its tolerance, it opens from there.
        below = {
            f"{law.name}.gap": -2.0 * contact.gap
            for law, contact, now in zip(laws, following.contacts, shown_mode(moving), strict=True)
            if now == "free" and contact.gap < -setup.tolerances["gap"]
        }
        return jump, flow._replace(tolerances={**flow.tolerances, **below}) if below else flow

    def _switch(
        self, at: Instant, snapshot: Snapshot, switched: Mapping[int, str]
    ) -> tuple[Jump, Flow]:
        """Take contacts off or back; what the others do then is asked next."""
        flow = at.flow
        mode, moving = list(flow.mode), list(flow.flow)
        for place, target in switched.items():
            mode[place] = moving[place] = target
        place = next(iter(switched))
        name, goes = self._names[place], mode[place] == OFF
        reason = "its conditions hold, and its gap is open"
        if goes:
            margins = [margin.name for margin in self._mechanics.gates(name)]
            failing = [margin for margin in margins if margin in at.fired]
            now = at.setup.values, at.state, at.clock.high
            failing = failing or [self._gates.failing(*now)[place]]
            reason = f"does not hold: {failing[0].removeprefix(f'{name}: ')}"
        jump = at.jump(
            name,
            "disable" if goes else "enable",
            tuple(mode),
            considered={
                f"{name}:{flow.mode[place]}": reason,
                f"{name}:{mode[place]}": "taken",
            },
            energy=(snapshot.energy, snapshot.energy),
        )
        following = flow._replace(mode=tuple(mode), flow=tuple(moving), warning="", settled=False)
        return jump, following

    def _energy(self, setup: SceneSetup, state: Array, time: float) -> float:
        return self._tape.at(setup.values, state, time).energy

    def _flow(
        self,
        setup: SceneSetup,
        mode: Key,
        flow: Key | None = None,
        rest: float | None = None,
        warning: str = "",
        settled: bool = True,
        notes: tuple[str, ...] = (),
    ) -> Flow:
        remaining = math.inf if rest is None else rest
        moving = _shown(mode, flow or mode)
        return Flow(mode, moving, remaining, warning, settled, notes, tolerances=setup.bands)

    def _check_declared(
        self, choice: Choice, snapshot: Snapshot, touching: list[bool], failing: Sequence[str]
    ) -> None:
        for name, declared in self._modes.items():
            place = self._names.index(name)
            found = choice.taken.states[place]
            if declared not in (found, found.rstrip("+-")):
                why = next(
                    (
                        reason
                        for label, reason in choice.considered.items()
                        if {f"{name}:{declared}{way}" for way in ("", "+", "-")} & {*label.split()}
                    ),
                    f"its point slips at {snapshot.contacts[place].slip:.3g}"
                    if touching[place]
                    else "its gap is open or opening",
                )
                if found == OFF:
                    why = f"the condition {failing[place]} fails"
                elif declared == OFF:
                    why = "its conditions hold, and it is not inside its surface"
                raise DeclarationProblem(
                    f"contact {name!r} cannot start in mode {declared!r}: {why}",
                    advice=f"the initial state calls for {found!r}",
                    loc=("modes", name),
                )

    def _cause(self, source: Key, target: Key, skipping: bool) -> tuple[str, str]:
        """Return (region, cause) of the first contact that changes."""
        for name, before, after in zip(self._names, source, target, strict=True):
            if before == after:
                continue
            if before == "free":
                return name, "zeno" if skipping else "touchdown"
            if after == "free":
                return name, "liftoff"
            if after == "pin":
                return name, "stick"
            return name, "slip" if before == "pin" else "reverse"
        return self._names[0], "zeno"
