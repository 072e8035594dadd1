"""A limit on the time of a run: an engine that gives up when it is over."""

from __future__ import annotations

import math
from collections.abc import Callable

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.compiling import working_time
from statechart.engines.engine import Begin, Engine, FlowWatch, Path
from statechart.errors import OutOfBudget
from statechart.formulas.tape import Tape


class Allowance:
    """Seconds that several runs share."""

    def __init__(self, seconds: float, clock: Callable[[], float] = working_time) -> None:
        self.seconds, self.clock = seconds, clock
        self._until = math.inf

    def begin(self) -> None:
        """Count from now on."""
        self._until = self.clock() + self.seconds

    def lift(self) -> None:
        """Count no more."""
        self._until = math.inf

    def check_for(self, seconds: float) -> None:
        """Raise where there is no time for what takes so many `seconds`.

        Raises
        ------
        OutOfBudget
        """
        if self.clock() + seconds > self._until:
            raise OutOfBudget(
                f"{self.seconds:g} s are too few to compile the mode's integrator; allow more "
                "time, or take the engine scipy"
            )

    def check(self, now: float) -> None:
        """Raise where the time is over; `now` is how far the run came.

        Raises
        ------
        OutOfBudget
        """
        if self.clock() > self._until:
            raise OutOfBudget(
                f"the {self.seconds:g} s were used up at t = {now:.6g}; allow more time, "
                "shorten the run, or take a looser tolerance"
            )


class Limited(Engine):
    """An engine within an allowance of time, looked at before every call for steps.

    A mode that is being compiled is not interrupted.
    """

    def __init__(self, engine: Engine, allowance: Allowance) -> None:
        self._engine, self._allowance = engine, allowance
        self.name, self.method, self.tolerance = engine.name, engine.method, engine.tolerance
        self.allowed, self.sharp = engine.allowed, engine.sharp

    def compile(self, automaton: Automaton, mode: Mode, rates: Tape) -> object:
        """Compile (see `Engine`), unless the time would be over then."""
        self._allowance.check_for(self._engine.compiling(rates))
        return self._engine.compile(automaton, mode, rates)

    def check(self, stepper: object, state: Array, parameters: Array, time: float) -> None:
        """Raise `Unsupported` where the method cannot go on (see `Engine`)."""
        self._engine.check(stepper, state, parameters, time)

    def steps(
        self,
        stepper: object,
        path: Path,
        watch: FlowWatch,
        state: Array,
        until: float,
        count: int,
        begin: Begin,
        end: Array,
    ) -> bool:
        """Take steps, unless the time is over (see `Engine`)."""
        self._allowance.check(watch.start + path.times.item(path.count))
        self._engine.sizes = self.sizes
        made = self._engine.steps(stepper, path, watch, state, until, count, begin, end)
        self.evaluations, self.floor = self._engine.evaluations, self._engine.floor
        return made
