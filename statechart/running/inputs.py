"""Inputs of a run besides its model: parameter values, end time, sampling times of a stream."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real

from statechart.automaton.time_stepper import Control, Sample, Sampling
from statechart.documents.declaration import Declaration
from statechart.documents.validation import Document, located
from statechart.errors import DeclarationError, DeclarationProblem, close_matches
from statechart.formulas.formula import parse


class RunInputs:
    """Checks the inputs of runs of a model; errors name their place in its document, if any."""

    def __init__(self, model: Declaration, document: Document | None) -> None:
        self.document = document
        self._parameters, self._constants = model.parameters, model.constants()
        self._count = model.counted if model.whole else None
        self._end = None if model.stop.time is None else parse(model.stop.time)

    def check(self, overrides: Mapping[str, float]) -> None:
        """Check that these are parameters, and their values numbers."""
        for name, value in overrides.items():
            if name not in self._parameters:
                raise DeclarationError(
                    f"no parameter {name!r}",
                    advice=close_matches(str(name), self._parameters),
                    source=self.document.source if self.document else "",
                )
            if not is_real(value):
                raise DeclarationError(
                    f"parameter {name!r} must be a number, not {value!r}",
                    advice=f"a formula is for with_({name}=...) of the model",
                )
            if math.isnan(value):
                raise DeclarationError(f"parameter {name!r} must be a number, not nan")

    def values(self, overrides: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters' values with `overrides`."""
        self.check(overrides)
        with located(self.document, overrides):
            return self._constants.values(overrides)

    def copies(self, overrides: Mapping[str, float]) -> Mapping[str, int | None]:
        """Return the number of copies of bodies that parameters count, with `overrides`."""
        if self._count is None:
            return {}
        values = self.values(overrides)
        with located(self.document, overrides):
            return self._count(values)

    def end(self, overrides: Mapping[str, float], until: float | None) -> float:
        """Return when a run ends at the latest; see `Runner.end`."""
        self.check(overrides)
        if until is not None:
            if not is_real(until) or not 0.0 <= until < math.inf:
                value = f"{until:g}" if is_real(until) else repr(until)
                raise DeclarationError(f"the end must be a finite time from 0 on, not {value}")
            return until
        with located(self.document, {} if self._end is None else overrides, ("stop", "time")):
            if self._end is None:
                raise DeclarationProblem(
                    "the run has no end",
                    advice="write stop: {time: 10}, or say until when",
                    loc=("stop",),
                )
            end = self._end.value(self.values(overrides) if self._end.names else {})
            if not 0.0 <= end < math.inf:
                raise DeclarationProblem(
                    f"must be a finite time, not {end:g}", loc=("stop", "time")
                )
        return end

    def sampling(self, every: float, end: float, control: Control | None) -> Sampling:
        """Return the sampling of a stream; see `Runner.stream`."""
        if not is_real(every) or not every > 0.0 or (control is not None and every == math.inf):
            value = f"{every:g}" if is_real(every) else repr(every)
            raise DeclarationError(
                f"every must be a finite time above 0, not {value}",
                advice="give the sampling period of control, such as every=0.01",
            )
        if control is not None and not callable(control):
            raise DeclarationError(
                f"control must be a function, not {control!r}",
                advice="it takes a sample, and returns parameters and their values, or None",
            )
        if end + every == end > 0.0:
            raise DeclarationError(
                f"every must be above the round-off of time at {end:g}, not {every:g}",
                advice="sample less often, or end the run earlier",
            )
        if control is None:
            return Sampling(every, None)

        def checked(sample: Sample) -> Mapping[str, float] | None:
            changed = control(sample)
            if not isinstance(changed, Mapping | None):
                raise DeclarationError(
                    f"control must return parameters and their values, or None, not {changed!r}",
                    advice="such as {'mu': 0.3}",
                )
            self.check(changed or {})
            return changed

        return Sampling(every, checked)


def as_overrides(parameters: Mapping[str, float] | None) -> dict[str, float]:
    """Return the parameter values of a call as a dictionary."""
    if parameters is not None and not isinstance(parameters, Mapping):
        raise DeclarationError(
            f"parameters are names and their values, not {parameters!r}",
            advice="such as parameters={'mu': 0.3}",
        )
    return dict(parameters or {})


def is_real(value: object) -> bool:
    """Return whether a value is a real number; annotations are not checked while a program runs."""
    return isinstance(value, Real) and not isinstance(value, bool)
