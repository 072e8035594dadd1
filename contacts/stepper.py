"""The time stepper of scenes (see `statechart.stepping.TimeStepper`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from contacts import impulse
from contacts.impulse import Stepping
from contacts.kernels import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from contacts.mechanics import Mechanics
from contacts.setup import SceneNumbers, SceneSetup
from contacts.stepped_scene import SteppedScene, SteppedTape
from statechart.automaton import Margin, Region
from statechart.errors import DeclarationProblem, SimulationError, Unsupported
from statechart.parameters import Parameters
from statechart.tape import compile_tape
from statechart.trace import Key, Trace

__all__ = ["SceneStepper"]

Array = NDArray[np.float64]

_STATES = {FREE: "free", PIN: "pin", SLIDE: "slide", SLIDE_PLUS: "slide+", SLIDE_MINUS: "slide-"}
# The modes at the start are those of a step this short, in the scene's own time.
_TRIAL = 1e-6
# Tolerances at the start, relative to the scene.
_RELATIVE = 1e-9
_STEEPEST = 4096.0


class SceneStepper:
    """Steps a scene of points against surfaces.

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    parameters : Parameters
        From `contacts.setup.scene_parameters`.
    stops : mapping
        Stop condition -> margin.
    regions : tuple of Region
        One per contact.

    Raises
    ------
    Unsupported
        If the scene has regions of its own, or contacts that can be off.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        parameters: Parameters,
        stops: Mapping[str, Margin],
        regions: tuple[Region, ...],
    ) -> None:
        scene = mechanics.scene
        if scene.regions:
            raise Unsupported(
                f"time stepping knows no regions beside contacts ({', '.join(scene.regions)}): "
                "take the engine taylor or scipy"
            )
        gated = [name for name in scene.contacts if scene.gate(name)]
        if gated:
            raise Unsupported(
                f"time stepping knows no conditions of contacts ({', '.join(gated)}): take the "
                "engine taylor or scipy"
            )
        symbols = list(parameters.symbols.values())
        self._scene = scene
        self._numbers = SceneNumbers(mechanics, parameters, stops)
        self._tape = SteppedTape(mechanics, symbols)
        forces = [symbol for pair in mechanics.forces.values() for symbol in pair]
        forces += [row.force for row in mechanics.joint_rows]
        names = mechanics.names
        self._stepping = Stepping(
            scene.name,
            (*names, *map(scene.rate_name, names)),
            parameters.names,
            tuple(region.name for region in regions),
            np.array([name.endswith(".angle") for name in names]),
            compile_tape(
                [margin.expression for margin in stops.values()],
                variables=(*mechanics.q, *mechanics.v, *mechanics.a, *forces),
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
        self._sticks = np.array(
            [{"pin", "slide"} <= contact.kinds for contact in scene.contacts.values()],
            dtype=np.bool_,
        )

    def start(self, overrides: Mapping[str, float]) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state; see `TimeStepper.start`."""
        setup, codes, warnings = self._begin(overrides)
        return tuple(_STATES[code] for code in codes.tolist()), (*setup.warnings, *warnings)

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
        setup = self._numbers.at(overrides, _RELATIVE)
        start = np.full(len(self._sticks), FREE)
        warnings: list[str] = []
        failure: SimulationError | None = None
        try:
            setup, start, warnings = self._begin(overrides)
        except SimulationError as error:
            failure = error
        return impulse.run(
            self._stepping,
            SteppedScene(self._tape, setup),
            setup,
            start,
            self._sticks,
            step=step,
            until=until,
            max_jumps=max_jumps,
            show=show,
            warnings=warnings,
            failure=failure,
        )

    def _begin(
        self, overrides: Mapping[str, float]
    ) -> tuple[SceneSetup, NDArray[np.int64], list[str]]:
        setup = self._numbers.at(overrides, _RELATIVE)
        warnings = self._lacks(setup)
        gaps = self._tape.gaps(setup.values, setup.initial)
        for law, gap in zip(setup.contacts, gaps.tolist(), strict=True):
            if gap < -setup.tolerances["gap"]:
                raise DeclarationProblem(
                    f"contact {law.name!r} starts inside its surface, {-gap:.6g} deep",
                    advice="move the body out of the surface",
                    loc=("contacts", law.name),
                )
            if gap > setup.tolerances["gap"] and "free" not in law.states:
                raise DeclarationProblem(
                    f"contact {law.name!r} starts {gap:.6g} off its surface, "
                    "and free is not among its modes",
                    loc=("contacts", law.name, "modes"),
                )
        trial = SteppedScene(self._tape, setup)
        h = _TRIAL * setup.scales.length / setup.scales.speed
        return setup, trial.steps(0.0, h, setup.initial, 1).codes[0], warnings

    def _lacks(self, setup: SceneSetup) -> list[str]:
        """Return what differs from the declaration; raise where it cannot be done at all."""
        warnings = []
        for law in setup.contacts:
            kinds = self._scene.contacts[law.name].kinds
            if "free" not in kinds and "slide" in kinds and ("pin" in kinds or law.cone_t > 0.0):
                raise Unsupported(
                    f"contact {law.name!r} is never free and has friction, whose force time "
                    "stepping cannot bound without V >= 0; list free among its modes, or take "
                    "the engine taylor or scipy"
                )
            if law.restitution > 0.0 and law.cone_t > 0.0 and law.impact != "newton":
                warnings.append(
                    f"contact {law.name!r}: time stepping applies Newton's law of impact, "
                    f"not {law.impact!r}"
                )
            if law.cone_t > _STEEPEST * law.cone_n and "free" in kinds:
                mu = math.inf if law.cone_n == 0.0 else law.cone_t / law.cone_n
                warnings.append(
                    f"contact {law.name!r}: friction {mu:g} is computed as {_STEEPEST:g}"
                )
        return warnings
