"""The time stepper of scenes (see `statechart.automaton.laws.TimeStepper`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneNumbers, SceneSetup
from contacts.dynamics.snapshot import SnapshotTape
from contacts.dynamics.starting import check_joints, check_start
from contacts.scene.other_laws import replaced
from contacts.solvers.contact_lcp_kernels import STEEPEST
from contacts.states import FREE, OFF, SLIDE_MINUS, SLIDE_PLUS, STATES
from contacts.time_stepping import loop as impulse
from contacts.time_stepping.control import StepControl, SteppedTapes
from contacts.time_stepping.loop import Span, Stepping
from contacts.time_stepping.scene_steps import SteppedScene
from statechart.automaton.regions import Margin, Region
from statechart.automaton.trace import Key, Trace
from statechart.errors import SimulationError
from statechart.formulas.parameters import Parameters
from statechart.formulas.writer import compile_tape

# The modes at the start are those of a step this short, in the scene's own time.
_TRIAL = 1e-6
# Tolerances at the start, relative to the scene.
_RELATIVE = 1e-9


@dataclass(frozen=True, eq=False)
class _Begun:
    """A run that can start: its numbers, modes, contacts that are off, what to know."""

    setup: SceneSetup
    codes: NDArray[np.int64]
    off: NDArray[np.bool_]
    warnings: tuple[str, ...]


class SceneStepper:
    """Steps a scene of points against surfaces.

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    parameters : Parameters
        From `contacts.dynamics.setup.scene_parameters`.
    stops : mapping
        Stop condition -> margin.
    regions : tuple of Region
        One per contact, then one per controller.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        parameters: Parameters,
        stops: Mapping[str, Margin],
        regions: tuple[Region, ...],
    ) -> None:
        scene = mechanics.scene
        symbols = list(parameters.symbols.values())
        self._scene = scene
        self._numbers = SceneNumbers(mechanics, parameters, stops)
        self._mechanics, self._parameters, self._regions = mechanics, symbols, regions
        self._tapes = SteppedTapes(mechanics, symbols)
        names = mechanics.names
        self._stepping = Stepping(
            scene.name,
            (*names, *map(scene.rate_name, names)),
            parameters.names,
            tuple(region.name for region in regions),
            self._tapes.initial,
            "jam",
            len(mechanics.a) + len(mechanics.joint_rows),
            np.array(
                [{"pin", "slide"} <= contact.kinds for contact in scene.contacts.values()], bool
            ),
            np.array([name.endswith(".angle") for name in names]),
            compile_tape(
                [margin.expression for margin in stops.values()],
                variables=(
                    *mechanics.q,
                    *mechanics.v,
                    *mechanics.a,
                    *mechanics.unknown_forces,
                    *mechanics.controls,
                ),
                parameters=symbols,
                time=mechanics.time,
            ),
            tuple(stops),
            compile_tape(
                [mechanics.energy],
                variables=(*mechanics.q, *mechanics.v),
                parameters=symbols,
                time=mechanics.time,
            ),
        )

    def start(self, overrides: Mapping[str, float]) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state; see `TimeStepper.start`."""
        begun = self._begin(overrides)
        states = tuple(STATES[code] for code in begun.codes.tolist())
        return (*states, *self._tapes.initial), (*begun.setup.warnings, *begun.warnings)

    def run(
        self,
        overrides: Mapping[str, float],
        *,
        step: float,
        until: float,
        max_jumps: int,
        show: Callable[[float, int, int], None],
    ) -> Trace:
        """Run from the declared initial state; see `TimeStepper.run`."""
        failure: SimulationError | None = None
        try:
            begun = self._begin(overrides)
        except SimulationError as error:
            failure, setup = error, self._numbers.at(overrides, _RELATIVE)
            free = np.full(len(self._scene.contacts), FREE)
            begun = _Begun(setup, free, np.zeros(len(free), dtype=np.bool_), ())
        setup = begun.setup
        scene = SteppedScene(self._tapes.at(self._tapes.initial), setup, begun.off)
        control = None
        if self._scene.regions:
            control = StepControl(
                self._mechanics, self._tapes, self._numbers, setup, scene, self._regions
            )
        return impulse.run(
            self._stepping,
            scene,
            setup,
            begun.codes,
            Span(step, until, max_jumps, show),
            warnings=begun.warnings,
            control=control,
            failure=failure,
        )

    def _begin(self, overrides: Mapping[str, float]) -> _Begun:
        setup = self._numbers.at(overrides, _RELATIVE)
        warnings = self._lacks(setup)
        if self._mechanics.joint_rows:
            snapshots = SnapshotTape(self._mechanics, self._parameters)
            check_joints(self._mechanics, snapshots, setup, _RELATIVE)
        tape = self._tapes.at(self._tapes.initial)
        near = setup.tolerances["gap"]
        off = np.zeros(len(setup.contacts), dtype=np.bool_)
        measured = tape.contacts(setup.values, setup.initial)
        for i, (law, row) in enumerate(zip(setup.contacts, measured.tolist(), strict=True)):
            gap, *_, condition = row
            gated = OFF in law.states
            off[i] = gated and (
                condition < 0.0 or (gap < -near and self._scene.modes.get(law.name) == OFF)
            )
            if not off[i]:
                check_start(law, row[:3], near, near, setup.tolerances["speed"])
        trial = SteppedScene(tape, setup, off)
        h = _TRIAL * setup.scales.length / setup.scales.speed
        first = trial.steps(0.0, h, setup.initial, 1)
        codes = first.codes[0]
        # Contacts that strike at once are free before; those that jam slide before.
        resting = first.struck[0] & (np.abs(measured[:, 1]) <= setup.tolerances["speed"])
        slides = np.where(measured[:, 2] > 0.0, SLIDE_PLUS, SLIDE_MINUS)
        codes = np.where(resting, slides, np.where(first.struck[0], FREE, codes))
        if trial.filled:
            warnings.append(
                "coordinates without an inertia of their own are computed with 1e-9 of the bodies' "
                "at the contacts"
            )
        return _Begun(setup, codes, off, tuple(warnings))

    def _lacks(self, setup: SceneSetup) -> list[str]:
        """Return what differs from the declaration."""
        values = dict(zip(self._stepping.parameter_names, setup.values.tolist(), strict=True))
        warnings = [f"{what}: {why}" for what, why in replaced(self._scene, values).items()]
        for law in setup.contacts:
            kinds = self._scene.contacts[law.name].kinds
            if law.cone_t * STEEPEST > law.cone_n and "free" in kinds:
                mu = math.inf if law.cone_n == 0.0 else law.cone_t / law.cone_n
                warnings.append(
                    f"contact {law.name!r}: friction {mu:g} is computed as {1.0 / STEEPEST:g}"
                )
        return warnings
