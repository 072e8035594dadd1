"""Numerical settings of a run: engine, method, tolerance, accuracy, step, budget."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from numbers import Real
from typing import TypedDict

from statechart.errors import DeclarationProblem
from statechart.formulas.formula import power_of_ten

_BETWEEN, _POSITIVE = "{} must be above 0 and below 1", "the {} must be a positive time"
# Number -> its least upper bound, and the message; the lower bound is 0.
_BOUNDS = {
    "tolerance": (1.0, _BETWEEN),
    "accuracy": (1.0, _BETWEEN),
    "impulse_tolerance": (1.0, _BETWEEN),
    "impulse_bound": (math.nan, "{} must be above 0"),
    "step": (math.inf, _POSITIVE),
    "budget": (math.inf, f"{_POSITIVE} in seconds"),
    "max_step": (math.inf, _POSITIVE),
}

OF_STEPS = "step", "impulse_tolerance", "impulse_bound"
"""Settings that only the engine impulse has."""
LONG_DOUBLE = "long double"
"""Method of the engine taylor in extended precision."""


def is_real(value: object) -> bool:
    """Return whether a value is a real number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def describe_value(value: object) -> str:
    """Return a value for a message, a number with at most seven digits."""
    if is_real(value):
        return f"{value:.7g}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{power_of_ten(value)}, which is too large for a float"
    return repr(value)


class Record(Enum):
    """Recording of a run between its start and its end.

    MODES: arcs and jumps of all regions. POSES: states and solved unknowns at every step, and jumps
    of controllers. NOTHING: start and end only.
    """

    MODES = "modes"
    POSES = "poses"
    NOTHING = "nothing"


class IntegrationWords(TypedDict, total=False):
    """Keyword arguments of a setting for one or many runs; see `Setting`."""

    engine: str | None
    method: str | None
    tolerance: float | None
    accuracy: float | None
    step: float | None
    max_step: float | None


class SettingWords(IntegrationWords, total=False):
    """All keyword arguments of a setting; see `Setting`."""

    budget: float | None
    impulse_tolerance: float | None
    impulse_bound: float | None
    record: str | None


@dataclass(frozen=True)
class Setting:
    """The engine of a run and its settings, as the parameters of `Runner`; None for defaults.

    A further `method`, of taylor, is "long double".
    """

    engine: str | None = None
    method: str | None = None
    tolerance: float | None = None
    accuracy: float | None = None
    step: float | None = None
    budget: float | None = None
    max_step: float | None = None
    impulse_tolerance: float | None = None
    impulse_bound: float | None = None
    record: str | None = None

    def check(self) -> None:
        """Check that the settings are compatible and in range.

        Raises
        ------
        DeclarationProblem
            At the first wrong setting.
        """
        for what in _BOUNDS:
            value = getattr(self, what)
            if value is not None and not is_real(value):
                message = f"{what} must be a number, not {describe_value(value)}"
                raise DeclarationProblem(message, loc=(what,))
        engine = self.engine or "auto"
        self._check_engine(engine)
        self._check_record(engine)
        finders = ("tolerance", "accuracy", "budget")
        named = [what for what in finders if getattr(self, what) is not None]
        if len(named) > 1:
            advice = "give one; accuracy and budget choose the tolerance themselves"
            self._refuse(named[1:], f"{' and '.join(named)} exclude each other", advice)
        self._check_bounds()

    def _check_engine(self, engine: str) -> None:
        """Check that an engine supports all settings."""
        if engine == "impulse":
            unused = "method", "tolerance", "budget", "max_step"
            advice = "give a step, which decides its error, or an accuracy"
            self._refuse(unused, "the engine impulse has no {}", advice)
        elif engine != "auto":  # the model decides which engine that is
            self.check_no_steps()
        if engine == "taylor" and self.method != LONG_DOUBLE:
            message = f"the engine taylor has no method {self.method!r}"
            self._refuse(["method"], message, "leave the method out, or take the engine scipy")

    def check_no_steps(self) -> None:
        """Check that nothing is set that only the engine impulse has: `OF_STEPS`."""
        step, *others = OF_STEPS
        advice = "add --engine impulse, in a file engine: impulse, or remove the step"
        self._refuse([step], f"the engine {self.engine} chooses its own steps", advice)
        advice = "remove it, or take the engine impulse"
        self._refuse(others, f"the engine {self.engine} has no {{}}", advice)

    def _refuse(self, parts: Sequence[str], message: str, advice: str) -> None:
        """Raise an error at the first of the parts that is set."""
        for what in parts:
            if getattr(self, what) is not None:
                raise DeclarationProblem(message.format(what), advice=advice, key=(what,))

    def _check_bounds(self) -> None:
        for what, (highest, words) in _BOUNDS.items():
            value = getattr(self, what)
            if value is not None and (not value > 0.0 or value >= highest):
                raise DeclarationProblem(f"{words.format(what)}, not {value:g}", loc=(what,))
        bound, allowed = self.impulse_bound, self.impulse_tolerance
        if bound is not None and allowed is not None and bound < allowed:
            raise DeclarationProblem(
                f"impulse_bound, {bound:g}, is below impulse_tolerance, {allowed:g}, so that "
                "runs within the tolerance would end",
                advice="give a larger bound, or a smaller tolerance",
                loc=("impulse_bound",),
            )

    def _check_record(self, engine: str) -> None:
        kinds = [kind.value for kind in Record]
        if self.record is None or self.record == Record.MODES.value:
            return
        if self.record not in kinds:
            message = f"record must be one of {', '.join(kinds)}, not {self.record!r}"
            raise DeclarationProblem(message, loc=("record",))
        if engine not in ("impulse", "auto"):
            message = f"the engine {engine} always records modes"
            self._refuse(["record"], message, "remove record, or take the engine impulse")
        if self.accuracy is not None:
            message = "an accuracy needs the events of runs, and so record: modes"
            self._refuse(["record"], message, "remove record, or give a step")

    @property
    def recorded(self) -> Record:
        """The recording as enumeration."""
        return Record(self.record or Record.MODES.value)

    @property
    def stepped(self) -> bool:
        """True if runs take fixed time steps."""
        return self.engine == "impulse"

    @property
    def family(self) -> str:
        """The name of the settings that differ in tolerance or step only."""
        if self.accuracy is not None:
            return "accuracy"
        return " ".join((self.method or self.engine or "auto", *self._impulses))

    @property
    def _impulses(self) -> tuple[str, ...]:
        """The impulse tolerance as text, if set."""
        return () if self.impulse_tolerance is None else (f"to {self.impulse_tolerance:g}",)

    @property
    def fineness(self) -> float:
        """The tolerance, accuracy or step."""
        return self.accuracy or self.tolerance or self.step or math.nan

    @property
    def promise(self) -> float | None:
        """The relative error that a user may expect, or None."""
        return self.accuracy or self.tolerance

    @property
    def label(self) -> str:
        """Its name in tables and figures."""
        what = "accuracy" if self.accuracy is not None else "step" if self.step is not None else ""
        engine = (self.engine or "auto", self.method or "", *self._impulses)
        words = (*engine, what, f"{self.fineness:.3g}")
        return " ".join(word for word in words if word)
