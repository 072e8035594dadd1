"""What a run is asked for, by the user and the file: engine, tolerance, accuracy, step, budget."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from statechart.automaton.automaton import Automaton
from statechart.documents.declaration import Declaration
from statechart.errors import DeclarationError


class Measurement(Protocol):
    """An engine and a tolerance that were run."""

    engine: str
    method: str | None
    tolerance: float | None

    @property
    def label(self) -> str:
        """What people call it."""
        ...


class Measured(Protocol):
    """What was measured of a model at many settings, as `statechart.study.record.Study`."""

    until: float

    def of(self, model: Declaration) -> bool:
        """Whether a model is the one that was measured."""
        ...

    def choose(
        self,
        *,
        accuracy: float | None,
        budget: float | None,
        engine: str | None,
        method: str | None,
    ) -> Measurement | None:
        """Return what was seen to reach an accuracy, or the best in a time."""
        ...


@dataclass(frozen=True)
class Request:
    """How to run a model.

    Attributes
    ----------
    engine, method, tolerance, accuracy, step, budget
        As for `statechart.running.runner.Runner`; None where nothing is said.
    first : float or None
        Tolerance of the first run, where an accuracy or a budget is asked for.
    basis : str
        What that was chosen by.
    measured : float or None
        End of the runs that it was chosen by, where they were measured: what they say holds of a
        run to this end with the parameters of the model.
    reason : str
        Why an engine was taken that nobody asked for; else empty.
    """

    engine: str | None = None
    method: str | None = None
    tolerance: float | None = None
    accuracy: float | None = None
    step: float | None = None
    budget: float | None = None
    first: float | None = None
    basis: str = "estimated: nothing was measured of this run"
    measured: float | None = None
    reason: str = ""

    def settled(self, model: Declaration, automaton: Automaton) -> Request:
        """Return what is asked for with what the model's settings say in the place of None.

        Raises
        ------
        DeclarationError
            If the parts of it do not go together.
        """
        settings = model.settings
        # A method asks for the engine that has methods, whatever the file says.
        engine = self.engine or ("scipy" if self.method is not None else settings.engine)
        if engine == "impulse":
            return self._stepping(model, automaton)
        if engine == "auto" and automaton.own_step is not None:
            return self._only_steps(model, automaton, automaton.own_step)
        if self.step is not None:
            raise DeclarationError(
                f"the engine {engine} chooses its own steps",
                advice="leave the step out, or take the engine impulse",
            )
        given = {"tolerance": self.tolerance, "accuracy": self.accuracy, "budget": self.budget}
        named = [what for what, value in given.items() if value is not None]
        if len(named) > 1:
            raise DeclarationError(
                f"{' and '.join(named)} exclude each other",
                advice="accuracy and budget find the tolerance that they need",
            )
        if self.budget is not None and not 0.0 < self.budget < math.inf:
            raise DeclarationError(f"the budget must be a time in seconds, not {self.budget:g}")
        for what in ("tolerance", "accuracy"):
            value = given[what]
            if value is not None and not 0.0 < value < 1.0:
                raise DeclarationError(f"{what} must be above 0 and below 1, not {value:g}")
        settled = replace(
            self,
            engine=engine,
            method=self.method or (None if self.engine == "taylor" else settings.method),
        )
        if not named:
            settled = replace(settled, tolerance=settings.tolerance, accuracy=settings.accuracy)
        if settled.accuracy is not None:
            settled = replace(settled, first=settled.accuracy * BELOW)
        return settled

    def learned(self, study: Measured | None, model: Declaration) -> Request:
        """Return the request with engine and first tolerance chosen by what was measured."""
        if study is None or (self.accuracy is None and self.budget is None):
            return self
        if not study.of(model):
            return replace(self, basis="estimated: the study given is of another model or version")
        found = study.choose(
            accuracy=self.accuracy,
            budget=self.budget,
            engine=None if self.engine == "auto" else self.engine,
            method=self.method,
        )
        if found is None or found.tolerance is None:
            return replace(self, basis="estimated: no setting that was measured is expected to do")
        # In a budget two runs are to fit: that one, and one before it to compare it with.
        first = found.tolerance if self.budget is None else found.tolerance / TIGHTER
        return replace(
            self,
            engine=found.engine,
            method=found.method,
            first=first,
            basis=f"measured: {found.label}",
            measured=study.until,
        )

    def _only_steps(
        self, model: Declaration, automaton: Automaton, own: Callable[[], float]
    ) -> Request:
        """Return what is asked where no engine but impulse can run the model."""
        asked = self._stepping(model, automaton, own)
        given = self.step is not None or model.settings.step is not None
        by = "as given" if given else "by the scales of the scene"
        return replace(
            asked,
            reason=f"engine impulse, in steps of {asked.step:g} ({by}): bodies that collide by "
            "their shapes run on no other",
        )

    def _stepping(
        self, model: Declaration, automaton: Automaton, own: Callable[[], float] | None = None
    ) -> Request:
        """Return what is asked of the engine impulse."""
        for what, given in (
            ("method", self.method), ("tolerance", self.tolerance), ("accuracy", self.accuracy),
            ("budget", self.budget),
        ):  # fmt: skip
            if given is not None:
                raise DeclarationError(
                    f"the engine impulse has no {what}",
                    advice="its error follows the step: give a step",
                )
        if automaton.stepper is None:
            raise DeclarationError(
                f"{model.name!r} cannot run on the engine impulse, which moves bodies in "
                "contact: a scene is needed",
                advice="take the engine taylor or scipy",
            )
        step = model.settings.step if self.step is None else self.step
        if step is None and own is not None:
            step = own()
        if step is None:
            raise DeclarationError(
                "the engine impulse needs a step",
                advice="say --step 1e-3, or write settings: {engine: impulse, step: 1e-3}; a "
                "thousandth of the shortest time of interest is a good start",
            )
        if not 0.0 < step < math.inf:
            raise DeclarationError(f"the step must be a positive time, not {step:g}")
        return replace(self, engine="impulse", step=step)


TIGHTER = 1.0 / 20.0

BELOW = 1.0 / 10.0
