"""What a run by steps is made from: its model, where it begins, how far it goes, what is kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from contacts.dynamics.setup import SceneSetup
from contacts.time_stepping.stepped import Control, Stepped
from contacts.time_stepping.stop_tapes import StopTapes
from statechart.arrays import Bools, Ints
from statechart.automaton.recording_policy import RECORD_ALL, RecordingPolicy
from statechart.automaton.time_stepper import Impulses
from statechart.automaton.trace import Key
from statechart.errors import SimulationError
from statechart.formulas.tape import Tape


@dataclass(frozen=True, eq=False)
class Stepping:
    """What a run of a scene is made from.

    Attributes
    ----------
    name : str
        Of the model.
    names, parameter_names : tuple of str
        Of the variables and the parameters.
    regions : tuple of str
    controls : Key
        States at the start of those of them, the last, that no step recognises.
    again : str
        Cause of an impact on a region that is not free.
    forces : int or None
        See `Recorder`.
    sticks : (r,) array of bool
        See `Recorder`.
    angles : (n,) array of bool
        Which coordinates are angles.
    stops : StopTapes
    stop_names : tuple of str
    energy : Tape
    """

    name: str
    names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    regions: tuple[str, ...]
    controls: Key
    again: str
    forces: int | None
    sticks: Bools
    angles: Bools
    stops: StopTapes
    stop_names: tuple[str, ...]
    energy: Tape


class Begun(NamedTuple):
    """A run that can start, or why it cannot.

    Attributes
    ----------
    setup : SceneSetup
    stepped : Stepped
    codes : (r,) array of int
        Modes at the start, as `contacts.states` numbers them.
    warnings : tuple of str
        Besides those of the setup.
    control : Control or None
        What acts at the ends of steps.
    failure : SimulationError or None
        Why not even one step can be made.
    change : callable or None
        Lets it go on with other values of parameters; returns the numbers. None where it cannot.
    """

    setup: SceneSetup
    stepped: Stepped
    codes: Ints
    warnings: tuple[str, ...]
    control: Control | None = None
    failure: SimulationError | None = None
    change: Callable[[Mapping[str, float]], SceneSetup] | None = None


class Span(NamedTuple):
    """How far a run goes, by which steps, who is told; after what time at most it is looked at.

    And what is kept of it.
    """

    step: float
    until: float
    max_jumps: int
    impulses: Impulses
    show: Callable[[float, int, int], None]
    every: float = math.inf
    policy: RecordingPolicy = RECORD_ALL
