"""What is given for a run besides its model: values of parameters, and its end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real

from statechart.documents.declaration import Declaration
from statechart.documents.document import Document
from statechart.documents.validation import located
from statechart.errors import DeclarationError, DeclarationProblem, close_matches
from statechart.formulas.formula import parse


class Given:
    """Checks what is given for runs of a model.

    What is wrong is told with its place in the document, where there is one.

    Parameters
    ----------
    model : Declaration
        What is run.
    """

    def __init__(self, model: Declaration) -> None:
        self._parameters, self._constants = model.parameters, model.constants()
        self._counted = model.counted if model.whole else None
        self._end = None if model.stop.time is None else parse(model.stop.time)

    def check(self, overrides: Mapping[str, float], document: Document | None) -> None:
        """Check that these are parameters, and their values numbers."""
        for name, value in overrides.items():
            if name not in self._parameters:
                raise DeclarationError(
                    f"no parameter {name!r}",
                    advice=close_matches(str(name), self._parameters),
                    source=document.source if document else "",
                )
            if not real(value):
                raise DeclarationError(
                    f"parameter {name!r} must be a number, not {value!r}",
                    advice=f"a formula is for with_({name}=...) of the model",
                )
            if math.isnan(value):
                raise DeclarationError(f"parameter {name!r} must be a number, not nan")

    def values(self, overrides: Mapping[str, float], document: Document | None) -> dict[str, float]:
        """Return the parameters' values with `overrides`."""
        self.check(overrides, document)
        with located(document, overrides):
            return self._constants.values(overrides)

    def counted(
        self, overrides: Mapping[str, float], document: Document | None
    ) -> Mapping[str, int | None]:
        """Return how many there are of what parameters count, with `overrides`."""
        if self._counted is None:
            return {}
        values = self.values(overrides, document)
        with located(document, overrides):
            return self._counted(values)

    def end(
        self, overrides: Mapping[str, float], until: float | None, document: Document | None
    ) -> float:
        """Return when a run ends at the latest; see `Runner.end`."""
        self.check(overrides, document)
        if until is not None:
            if not real(until) or not 0.0 <= until < math.inf:
                told = f"{until:g}" if real(until) else repr(until)
                raise DeclarationError(f"the end must be a finite time from 0 on, not {told}")
            return until
        with located(document, {} if self._end is None else overrides, ("stop", "time")):
            if self._end is None:
                raise DeclarationProblem(
                    "the run has no end",
                    advice="write stop: {time: 10}, or say until when",
                    loc=("stop",),
                )
            end = self._end.value(self.values(overrides, document) if self._end.names else {})
            if not 0.0 <= end < math.inf:
                raise DeclarationProblem(
                    f"must be a finite time, not {end:g}", loc=("stop", "time")
                )
        return end


def overridden(parameters: Mapping[str, float] | None) -> dict[str, float]:
    """Return what is given for parameters, by their names."""
    if parameters is not None and not isinstance(parameters, Mapping):
        raise DeclarationError(
            f"parameters are names and their values, not {parameters!r}",
            advice="such as parameters={'mu': 0.3}",
        )
    return dict(parameters or {})


def real(value: object) -> bool:
    """Whether it is a number: Python's types are not asked for while a program runs."""
    return isinstance(value, Real) and not isinstance(value, bool)
