"""Observers of an automaton, one for each setting."""

from __future__ import annotations

import math
from dataclasses import replace

from statechart.automaton.automaton import Automaton
from statechart.automaton.time_stepper import DEFAULT_IMPULSES, Impulses
from statechart.documents.setting import Record, Setting
from statechart.engines.engine import Allowance, Engine
from statechart.engines.request import choose
from statechart.execution.compiled_modes import SolvedModes
from statechart.execution.perturbation import nudged
from statechart.execution.simulator import Simulator
from statechart.execution.time_stepping import SteppingSimulator
from statechart.observation.observer import Observer
from statechart.observation.outputs import OutputAccumulator, outputs_of


class Observers:
    """Simulators of an automaton, each with the observer of its runs."""

    def __init__(
        self, automaton: Automaton, *, allowance: Allowance | None = None, progress: bool = False
    ) -> None:
        self._automaton, self._allowance, self._progress = automaton, allowance, progress
        self._kept: dict[tuple[Setting, bool], Observer] = {}
        # What is solved of a mode holds at any tolerance, on any engine and from any start.
        self._solved = SolvedModes(automaton)

    def at(self, setting: Setting, *, off: bool = False) -> Observer:
        """Return the observer of a setting's simulator, made once.

        `off`: its runs start off by the tolerance. Raises `DeclarationError` if there is no such
        engine or method, or the engine is not installed.
        """
        found = self._kept.get((setting, off))
        if found is None:
            simulator = self._simulator(setting, off)
            observer = found = self._kept[setting, off] = Observer(simulator)
            if isinstance(simulator, SteppingSimulator) and simulator.record is not Record.MODES:
                simulator.new_outputs = lambda: OutputAccumulator(outputs_of(observer))
        return found

    def engine(self, setting: Setting) -> Engine:
        """Return a new engine as a setting asks for it; see `choose`."""
        engine, _ = choose(setting)
        engine.allowance = self._allowance
        return engine

    def floor(self, setting: Setting) -> float:
        """Return the least tolerance of a setting's engine."""
        return self.engine(replace(setting, tolerance=math.ulp(0.0))).tolerance

    def first(self, setting: Setting) -> float | None:
        """Return the tolerance that a search for an accuracy begins with, if the engine says one.

        Where the last digits cost little more than the first, the least: one compilation, and one
        run with another that tells its error.
        """
        return self.floor(setting) if self.engine(setting).sharp else None

    def fresh(self, setting: Setting) -> Simulator | SteppingSimulator:
        """Return a new simulator that shares the solved modes."""
        return self._simulator(setting, off=False)

    def _simulator(self, setting: Setting, off: bool) -> Simulator | SteppingSimulator:
        if setting.step is not None:
            asked = Impulses(
                setting.impulse_tolerance or DEFAULT_IMPULSES.tolerance,
                setting.impulse_bound or DEFAULT_IMPULSES.bound,
            )
            return SteppingSimulator(
                self._automaton, setting.step, asked, setting.recorded, progress=self._progress
            )
        automaton = nudged(self._automaton) if off else self._automaton
        engine, solved = self.engine(setting), self._solved
        return Simulator(automaton, engine, solved=solved, progress=self._progress)
