"""Cache of observers of an automaton, one per setting."""

from __future__ import annotations

import math
from dataclasses import replace

from statechart.automaton.automaton import Automaton
from statechart.automaton.time_stepper import DEFAULT_IMPULSES, Impulses
from statechart.documents.setting import Record, Setting
from statechart.engines.engine import Engine, TimeBudget
from statechart.engines.request import choose
from statechart.execution.compiled_modes import SolvedModes
from statechart.execution.perturbation import Start, with_increased_start
from statechart.execution.simulator import Simulator
from statechart.execution.time_stepping import SteppingSimulator
from statechart.observation.observer import Observer
from statechart.observation.outputs import OutputAccumulator, outputs_of


class Observers:
    """Simulators of an automaton with their observers."""

    def __init__(
        self, automaton: Automaton, *, time_budget: TimeBudget | None = None, progress: bool = False
    ) -> None:
        self._automaton, self._time_budget, self._progress = automaton, time_budget, progress
        self._kept: dict[tuple[Setting, Start], Observer] = {}
        # Solved modes do not depend on tolerance, engine or start.
        self._solved = SolvedModes(automaton)

    def at(self, setting: Setting, start: Start = Start.DECLARED) -> Observer:
        """Return the observer of a setting; raise `DeclarationError` for an unknown engine."""
        key = setting, start
        found = self._kept.get(key)
        if found is None:
            simulator = self.fresh(*key)
            observer = found = self._kept[key] = Observer(simulator)
            if isinstance(simulator, SteppingSimulator) and simulator.record is not Record.MODES:
                simulator.new_outputs = lambda: OutputAccumulator(outputs_of(observer))
        return found

    def engine(self, setting: Setting) -> Engine:
        """Return a new engine for a setting; see `choose`."""
        engine, _ = choose(setting)
        engine.time_budget = self._time_budget
        return engine

    def floor(self, setting: Setting) -> float:
        """Return the least tolerance of the engine of a setting."""
        return self.engine(replace(setting, tolerance=math.ulp(0.0))).tolerance

    def first(self, setting: Setting) -> float | None:
        """Return the first tolerance of a search for an accuracy, if the engine has one.

        The least tolerance if the cost hardly rises with the accuracy: one compilation, and two
        runs.
        """
        return self.floor(setting) if self.engine(setting).sharp else None

    def fresh(
        self, setting: Setting, start: Start = Start.DECLARED
    ) -> Simulator | SteppingSimulator:
        """Return a new simulator that shares the solved modes."""
        if setting.step is not None:
            tolerance, bound = setting.impulse_tolerance, setting.impulse_bound
            default = DEFAULT_IMPULSES
            own = Impulses(tolerance or default.tolerance, bound or default.bound)
            how = setting.step, own, setting.recorded
            return SteppingSimulator(self._automaton, *how, progress=self._progress)
        automaton = self._automaton
        if start is not Start.DECLARED:
            automaton = with_increased_start(automaton, start)
        engine, solved = self.engine(setting), self._solved
        return Simulator(automaton, engine, solved=solved, progress=self._progress)
