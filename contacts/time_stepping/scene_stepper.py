"""The time stepper of scenes (see `statechart.automaton.time_stepper.TimeStepper`)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from contacts.dynamics.controllers import ControllerState, given
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import ROUNDING, SceneSetup
from contacts.dynamics.setup_evaluation import SceneNumbers
from contacts.dynamics.snapshot import SnapshotTape
from contacts.dynamics.starting import check_joints, check_start, hovering
from contacts.solvers.contact_lcp_kernels import STEEPEST
from contacts.states import FREE, OFF, SLIDE_MINUS, SLIDE_PLUS
from contacts.time_stepping.chunk import CHOSEN, Chunk
from contacts.time_stepping.control import StepControl, SteppedTapes
from contacts.time_stepping.run_inputs import RunInputs
from contacts.time_stepping.scene_steps import SteppedScene
from contacts.time_stepping.solver_residual import INDETERMINATE
from contacts.time_stepping.stepper import RELATIVE, Stepper
from statechart.arrays import Bools, Ints
from statechart.automaton.regions import Region, StopCondition
from statechart.errors import SimulationError
from statechart.kernels.jit import by_python

# The modes at the start are those of a step this short, in the scene's own time.
_TRIAL = 1e-6


class SceneStepper(Stepper):
    """Steps a scene of points against surfaces."""

    def __init__(
        self,
        mechanics: Mechanics,
        stops: Sequence[StopCondition],
        regions: tuple[Region, ...],
    ) -> None:
        contacts = mechanics.scene.contacts
        self._tapes = SteppedTapes(mechanics)
        super().__init__(
            mechanics,
            stops,
            mechanics.energy,
            (*mechanics.a, *mechanics.unknown_forces, *given(mechanics)),
            regions=regions,
            controls=self._tapes.initial,
            again="jam",
            forces=len(mechanics.a) + len(mechanics.joint_rows),
            sticks=np.array([{"pin", "slide"} <= c.kinds for c in contacts.values()], bool),
        )
        self._numbers = SceneNumbers(mechanics, stops)
        self._regions = regions

    def _begin(
        self, overrides: Mapping[str, float], step: float, allowed: float, forces: bool
    ) -> RunInputs:
        try:
            return self._checked(overrides, allowed)
        except SimulationError as error:
            setup = self._numbers.at(overrides, RELATIVE)
            free = np.full(len(setup.contacts), FREE)
            return self._begun(setup, free, np.zeros(len(free), np.bool_), allowed, (), error)

    def _begun(
        self,
        setup: SceneSetup,
        codes: Ints,
        off: Bools,
        allowed: float,
        warnings: tuple[str, ...],
        failure: SimulationError | None = None,
    ) -> RunInputs:
        scene = SteppedScene(self._tapes.at(self._tapes.initial), setup, off, allowed)
        control = None

        def change(values: Mapping[str, float]) -> SceneSetup:
            numbers = self._numbers.at(values, RELATIVE)
            scene.change(numbers)
            return numbers

        if self._scene.regions:
            tapes, numbers = self._tapes, self._numbers

            def switch(states: Mapping[str, str]) -> None:
                contacts = numbers.contacts(setup.values, states)
                scene.switch(tapes.at(tuple(states.values())), contacts)

            control = StepControl(self._mechanics, tapes, setup, scene, switch, self._regions)
        able = None if self._scene.regions else change
        return RunInputs(setup, scene, codes, warnings, control, failure, able)

    def _checked(self, overrides: Mapping[str, float], allowed: float) -> RunInputs:
        setup = self._numbers.at(overrides, RELATIVE)
        warnings = [*self._lacks(setup), *self._cut(setup)]
        memory = ControllerState(self._mechanics)
        within = memory.within(setup, setup.initial)
        within = replace(within, initial=memory.parted(setup.initial))
        if self._mechanics.joint_rows:
            check_joints(self._mechanics, SnapshotTape(self._mechanics), within, RELATIVE)
        failing = self._numbers.conditions.failing(within, within.initial, 0.0)
        tape = self._tapes.at(self._tapes.initial)
        near = setup.tolerances["gap"]
        closed = max(ROUNDING * setup.scales.length, setup.scales.rounding)
        off = np.zeros(len(setup.contacts), dtype=np.bool_)
        measured = tape.contacts(setup.values, setup.initial)
        for i, (law, row) in enumerate(zip(setup.contacts, measured.tolist(), strict=True)):
            buried = row[0] < -near and self._scene.initial_modes.get(law.name) == OFF
            off[i] = failing[i] != "" or (OFF in law.states and buried)
            if not off[i]:
                surface, slow = self._scene.surface_of(law.name), setup.tolerances["speed"]
                check_start(surface, law, row[:3], near, near, slow)
                warnings += hovering(self._scene, setup.scales, closed, [law.name], [row])
        h = _TRIAL * setup.scales.length / setup.scales.speed

        slow, sticks = (np.abs(measured[:, 1:3]) <= setup.tolerances["speed"]).T
        # Nothing lasts yet; what slides could, and then another motion may be as good.
        sliding = slow & ~sticks & (np.abs(measured[:, 0]) <= near) & ~off

        def tried(closed: Bools) -> tuple[SteppedScene, Chunk]:
            trial = SteppedScene(tape, setup, off, allowed)
            trial.press(closed)
            return trial, trial.steps(0.0, h, setup.initial, 1)

        trial, first = by_python(lambda: tried(np.zeros_like(off)))
        codes = first.codes[0]
        # Contacts that strike at once are free before; those that jam slide before.
        resting = first.struck[0] & slow
        slides = np.where(measured[:, 2] > 0.0, SLIDE_PLUS, SLIDE_MINUS)
        codes = np.where(resting, slides, np.where(first.struck[0], FREE, codes))
        if sliding.any() and by_python(lambda: tried(sliding))[1].efforts[0, CHOSEN]:
            warnings.append(f"at the start {INDETERMINATE}")
        if trial.filled:
            warnings.append(
                "coordinates without an inertia of their own are computed with 1e-9 of the bodies' "
                "at the contacts"
            )
        return self._begun(setup, codes, off, allowed, tuple(warnings))

    def _cut(self, setup: SceneSetup) -> Iterator[str]:
        """Yield whose friction is computed as less."""
        for law in setup.contacts:
            kinds = self._scene.contacts[law.name].kinds
            if law.cone_t * STEEPEST > law.cone_n and "free" in kinds:
                mu = math.inf if law.cone_n == 0.0 else law.cone_t / law.cone_n
                yield f"contact {law.name!r}: friction {mu:g} is computed as {1.0 / STEEPEST:g}"
