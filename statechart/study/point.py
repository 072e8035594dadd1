"""What a study is made of: errors of a run, what was measured at a setting, a third run."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, field_serializer

from statechart.documents.documented import Documented
from statechart.documents.setting import Setting

_Time = Annotated[float, Field(ge=0)]

RESOLVED = 20.0
"""Errors below so many times what the reference resolves are rounding."""


class Record(BaseModel, metaclass=Documented):
    """Base of what is written to a file and read back."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")


class Errors(Record):
    """Of a run against the reference; None where there is nothing to compare.

    Attributes
    ----------
    state, times, outputs : float or None
        As in `statechart.observation.difference.Difference`; times and outputs None where the modes
        differ.
    named : mapping of str to float
        Of every output, whatever the modes.
    path : float or None
        See `statechart.observation.difference.distance`.
    energy : float or None
        Largest difference of the energy at the events and the end, relative to its size.
    violations : mapping of str to float
        By how much the run violates what must hold, whatever the reference (constraint, cone).
    """

    state: float | None = None
    times: float | None = None
    outputs: float | None = None
    named: dict[str, float] = {}
    path: float | None = None
    energy: float | None = None
    violations: dict[str, float] = {}

    @property
    def largest(self) -> float | None:
        """Of state, times, outputs and path."""
        found = [x for x in (self.state, self.times, self.outputs, self.path) if x is not None]
        return max(found, default=None)

    @property
    def decides(self) -> str:
        """The quantity that `largest` is of."""
        parts = {"the final state": self.state, "the times of events": self.times}
        parts |= {"the path": self.path} | {f"output {n}": off for n, off in self.named.items()}
        known = {what: off for what, off in parts.items() if off is not None}
        return max(known, key=known.__getitem__, default="")

    def without(self, names: Collection[str]) -> Errors:
        """Return the errors without those of some outputs."""
        if self.outputs is None or not names:
            return self
        left = [error for name, error in self.named.items() if name not in names]
        return self.model_copy(update={"outputs": max(left, default=0.0)})

    def worse(self, other: Errors) -> Errors:
        """Return the larger of the errors of two runs; None where one of them has none."""
        mine, its = self.model_dump(), other.model_dump()
        found = {
            name: None if its[name] is None or value is None else max(value, its[name])
            for name, value in mine.items()
            if name not in ("violations", "named")
        }
        named = {k: max(v, other.named[k]) for k, v in self.named.items() if k in other.named}
        violated = {k: max(v, other.violations.get(k, v)) for k, v in self.violations.items()}
        return Errors(**found, named=named, violations=violated)


class Point(Record):
    """One setting: what it gave and what it cost.

    Attributes
    ----------
    setting : Setting
        What was run. A step, four times, of which three are shorter by up to a twentieth: events
        fall anywhere between two steps, and what is told is the worst of the four.
    outcome : str
        Why it ended.
    same_modes : bool
        Whether it took the modes of the reference, one by one.
    diverged : float or None
        When it first did not.
    parted : float or None
        When it left the reference for good to the eye; see
        `statechart.observation.difference.parted`.
    refused : str
        Why a run to an accuracy says itself that it did not reach it; else empty.
    warnings : tuple of str
        What its runs warn of, each text once.
    errors : Errors
        Against the reference.
    seconds : float
        Median time of a run that follows others in one process: warm.
    repeats : int
        How many runs that is the median of.
    cold : float or None
        Time of the first run of a process, see `statechart.study.cold.Fresh`; None where no process
        could be had.
    steps, evaluations : int
        Of the integrator and of the rates; evaluations are 0 where they are not counted.
    flows : int
        Number of arcs of the run.
    """

    setting: Setting
    outcome: str
    same_modes: bool
    diverged: float | None
    parted: float | None
    refused: str = ""
    warnings: tuple[str, ...] = ()
    errors: Errors
    seconds: _Time
    repeats: int
    cold: _Time | None
    steps: int
    evaluations: int
    flows: int

    def cost(self, *, once: bool) -> float:
        """Return the seconds of a run: of the first of a process, or of one that follows others."""
        return self.seconds if self.cold is None or not once else self.cold

    @field_serializer("setting")
    def _plain(self, setting: Setting) -> dict[str, Any]:
        # No run of a study has a budget, a longest step, or a bound of its impulses.
        unused = ("budget", "max_step", "impulse_bound")
        return {name: value for name, value in asdict(setting).items() if name not in unused}


class Third(Record):
    """The one of three runs that is neither reference nor check, made where two did not agree.

    Attributes
    ----------
    setting : str
        Which.
    parted : float or None
        When it left the nearer of the two others for good.
    errors : Errors
        Against that.
    odd : bool
        Whether the two others agree so much better that it is taken to be wrong.
    shift : float
        How far off the start of the reference was put, as a part of it, to see what rounding does
        to the motion: it may be as large as the errors of a run.
    edge : float or None
        When the reference left itself by that: then one that left it need not be wrong.
    """

    setting: str
    parted: float | None
    errors: Errors
    odd: bool
    shift: float
    edge: float | None
