"""What happens to a scene between its flows: classification, impacts, Zeno capture."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from contacts.classify import Choice, choose
from contacts.impact import impact
from contacts.mechanics import Mechanics
from contacts.projection import Projection, landed, on_constraints
from contacts.setup import SceneNumbers, SceneSetup
from contacts.snapshot import Snapshot, SnapshotTape
from statechart.automaton import Flow, Margin, Setup
from statechart.errors import DeclarationProblem, NoConsistentMode
from statechart.parameters import Parameters
from statechart.trace import Clock, Jump, Key

__all__ = ["SceneLaws"]

Array = NDArray[np.float64]

_EPS = float(np.finfo(float).eps)
# Bounces lower than this many roundings of the gap are summed. The sum's error is of the third
# order in their speed: 1e-12 of the scene's time where coordinates are of its size.
_DIGITS = 1e8
# No bounce this fast, in the scene's own speed, is summed.
_FAST = 1e-3
# An impact may raise the energy by rounding, in units of the scene's.
_ENERGY_ROUNDING = 1e-12
# A start may be inside a surface by so much of the scene's length (and is projected out).
_START_DEPTH = 1e-9


class SceneLaws:
    """The laws of a scene (see `statechart.automaton.Laws`).

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    parameters : Parameters
        From `contacts.setup.scene_parameters`.
    stops : mapping
        Stop condition -> margin.
    """

    def __init__(
        self, mechanics: Mechanics, parameters: Parameters, stops: Mapping[str, Margin]
    ) -> None:
        symbols = list(parameters.symbols.values())
        self._modes = mechanics.scene.modes
        self._names = tuple(mechanics.scene.contacts)
        self._numbers = SceneNumbers(mechanics, parameters, stops)
        self._tape = SnapshotTape(mechanics, symbols)
        self._projection = Projection(mechanics, symbols, self._tape)

    def setup(self, overrides: Mapping[str, float], relative: float) -> SceneSetup:
        """Evaluate parameters, initial state, scales and tolerances."""
        return self._numbers.at(overrides, relative)

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the first mode, checked against the declared one."""
        assert isinstance(setup, SceneSetup)
        state = setup.initial
        snapshot = self._tape.at(setup.values, state, 0.0)
        for law, contact in zip(setup.contacts, snapshot.contacts, strict=True):
            if contact.gap < -max(_START_DEPTH * setup.scales.length, setup.tolerances["gap"]):
                raise DeclarationProblem(
                    f"contact {law.name!r} starts inside its surface, {-contact.gap:.6g} deep",
                    advice="move the body out of the surface",
                    loc=("contacts", law.name),
                )
            if contact.gap > setup.tolerances["gap"] and "free" not in law.states:
                raise DeclarationProblem(
                    f"contact {law.name!r} starts {contact.gap:.6g} off its surface, "
                    "and free is not among its modes",
                    loc=("contacts", law.name, "modes"),
                )
        closed = [c.gap <= setup.tolerances["gap"] for c in snapshot.contacts]
        slow = setup.tolerances["speed"]
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
            snapshot = self._tape.at(setup.values, state, 0.0)
        choice = self._choose(setup, snapshot, touching)
        self._check_declared(choice, touching)
        taken = choice.taken.states
        settled = not any(
            shut and c.gap_rate < -slow for shut, c in zip(closed, snapshot.contacts, strict=True)
        )
        return self._flow(setup, taken, warning=choice.warning, settled=settled), state

    def jump(
        self,
        setup: Setup,
        clock: Clock,
        j: int,
        flow: Flow,
        state: Array,
        fired: tuple[str, ...],
    ) -> tuple[Jump, Flow] | None:
        """Classify every contact from the state; see `contacts.classify`."""
        assert isinstance(setup, SceneSetup)
        before = state
        snapshot = self._tape.at(setup.values, state, clock.high)
        # Between steps a dense output leaves the constraints by its own error: a contact that the
        # flow kept closed is judged as closed.
        state = landed(flow.flow, snapshot, state, setup.tolerances)
        if state is not before:
            snapshot = self._tape.at(setup.values, state, clock.high)
        slow, close = setup.tolerances["speed"], setup.tolerances["gap"]
        closed = [c.gap <= close for c in snapshot.contacts]
        hitting = [i for i, c in enumerate(snapshot.contacts) if closed[i] and c.gap_rate < -slow]
        if hitting:
            return self._impact(setup, clock, j, flow, state, fired, snapshot, hitting, closed)
        touching = [
            shut and c.gap_rate <= slow for shut, c in zip(closed, snapshot.contacts, strict=True)
        ]
        choice = self._choose(setup, snapshot, touching)
        target = choice.taken.states
        skipping = flow.flow != flow.mode
        if target == flow.flow and not (skipping and fired == ("zeno",)):
            return None
        after = landed(target, snapshot, state, setup.tolerances)
        energy = snapshot.energy
        left = energy if after is state else self._energy(setup, after, clock.high)
        jump = Jump(
            clock.high,
            j,
            *self._cause(flow.mode, target, skipping),
            flow.mode,
            target,
            before,
            after,
            fired,
            considered=choice.considered,
            energy=(energy, left),
        )
        return jump, self._flow(setup, target, warning=choice.warning)

    def project(self, setup: Setup, flow: Key, state: Array, anchor: Array) -> tuple[Array, float]:
        """Return `state` on the constraints of `flow`, and how far it was off in tolerances."""
        assert isinstance(setup, SceneSetup)
        return self._projection.kept(flow, state, anchor, setup.values, setup.tolerances)

    def _impact(
        self,
        setup: SceneSetup,
        clock: Clock,
        j: int,
        flow: Flow,
        state: Array,
        fired: tuple[str, ...],
        snapshot: Snapshot,
        hitting: list[int],
        closed: list[bool],
    ) -> tuple[Jump, Flow]:
        if sum(closed) > 1:
            names = ", ".join(
                law.name for law, shut in zip(setup.contacts, closed, strict=True) if shut
            )
            raise NoConsistentMode(f"an impact with several closed contacts ({names})")
        place = hitting[0]
        law, contact = setup.contacts[place], snapshot.contacts[place]
        coordinates = state[: len(snapshot.velocity)]
        result = impact(snapshot, contact, law, law.restitution)
        after = np.concatenate([coordinates, result.velocity])
        following = self._tape.at(setup.values, after, clock.high)
        rebound = following.contacts[place].gap_rate
        rest = self._rest_of_bounces(setup, following, coordinates, place, rebound)
        considered: Mapping[str, str] = {}
        warning = ""
        target = moving = tuple("free" if i == place else name for i, name in enumerate(flow.mode))
        if rest is not None or rebound <= setup.tolerances["speed"]:
            if law.restitution > 0.0:
                result = impact(snapshot, contact, law, 0.0)
                after = np.concatenate([coordinates, result.velocity])
                following = self._tape.at(setup.values, after, clock.high)
            choice = self._choose(setup, following, [i == place for i in range(len(closed))])
            considered, warning, moving = choice.considered, choice.warning, choice.taken.states
            after = landed(moving, following, after, setup.tolerances)
            if rest is None:
                target = moving
            # Else bounces are skipped: the contact is still free, and moves as if closed.
        before, left = snapshot.energy, self._energy(setup, after, clock.high)
        if left > before + _ENERGY_ROUNDING * setup.scales.force * setup.scales.length:
            warning = f"the impact law {law.impact!r} raised the energy by {left - before:.3g}"
        jump = Jump(
            clock.high,
            j,
            law.name,
            "touchdown",
            flow.mode,
            target,
            state,
            after,
            fired,
            impulse={law.name: (result.normal, result.tangential)},
            considered=considered,
            energy=(before, left),
            skipped=rest or 0.0,
        )
        return jump, self._flow(setup, target, moving, rest, warning)

    def _rest_of_bounces(
        self,
        setup: SceneSetup,
        landed: Snapshot,
        coordinates: Array,
        place: int,
        rebound: float,
    ) -> float | None:
        """Return how long the bounces after this one would take, where they need no resolving.

        They sum to ``2 v / (g_n (1 - e))`` (equation 5); the impulse of a plastic impact plus the
        weight over that time equals the exact sum of theirs. A bounce is resolved as long as its
        height is known to some digits; below, its duration would be noise.
        """
        e = setup.contacts[place].restitution
        if not rebound > 0.0 or not 0.0 < e < 1.0 or rebound > _FAST * setup.scales.speed:
            return None
        free = choose(
            landed, setup.contacts, [False] * len(setup.contacts), setup.scales, 0.0, 0.0
        ).taken
        contact = landed.contacts[place]
        falling = -(float(contact.jacobian[0] @ free.accelerations) + contact.bias_n)
        if falling <= 0.0:
            return None
        # How high it bounces, against what rounding of the coordinates does to the gap.
        height = rebound**2 / (2.0 * falling)
        rounding = _EPS * float(np.abs(contact.jacobian[0]) @ np.abs(coordinates))
        if rebound > setup.capture and height > _DIGITS * rounding:
            return None
        return 2.0 * rebound / (falling * (1.0 - e))

    def _choose(self, setup: SceneSetup, snapshot: Snapshot, touching: list[bool]) -> Choice:
        tie = 0.5 * setup.tolerances["force"] / setup.scales.force
        return choose(
            snapshot, setup.contacts, touching, setup.scales, tie, 2.0 * setup.tolerances["speed"]
        )

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
    ) -> Flow:
        remaining = math.inf if rest is None else rest
        return Flow(mode, flow or mode, remaining, warning, settled, tolerances=setup.stops)

    def _check_declared(self, choice: Choice, touching: list[bool]) -> None:
        for name, declared in self._modes.items():
            place = self._names.index(name)
            found = choice.taken.states[place]
            if declared not in (found, found.rstrip("+-")):
                why = next(
                    (
                        reason
                        for label, reason in choice.considered.items()
                        if f"{name}:{declared}" in label.split()
                    ),
                    "its gap is closed" if touching[place] else "its gap is open or opening",
                )
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
