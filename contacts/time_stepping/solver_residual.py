"""Residual of the contact laws over a run, and solver statistics."""

from __future__ import annotations

import numpy as np

from contacts.solvers.impact_sequence import LONGEST_SEQUENCE
from contacts.solvers.step_impulses import LIVELY
from contacts.time_stepping.chunk import (
    AMBIGUOUS,
    CALMED,
    CHOSEN,
    CONTACTS,
    ITERATIONS,
    JAMMED,
    RESIDUAL,
    UNENDED,
    Chunk,
)
from contacts.time_stepping.step_rejection import Rejection
from statechart.automaton.time_stepper import Impulses
from statechart.errors import UnsolvedImpulses
from statechart.tabular import pluralise

INDETERMINATE = (
    "friction presses a contact into its surface so that it may slide as well as lift off "
    "(Painleve's paradox, indeterminate): another engine or step may choose the other"
)
"""Warning of non-unique impulses."""


class SolverResidual:
    """Accumulates solver statistics and inexact steps.

    `residual` is the largest, relative to the fastest approach of its step.
    """

    def __init__(self, limits: Impulses) -> None:
        self._tolerance, self._bound = limits
        self._inexact = self._unended = 0
        # Of the columns of `Chunk.stats`: sums and largest values over all steps, and time of the
        # first step with a value.
        self._sums, self._largest = np.zeros(JAMMED + 1), np.zeros(JAMMED + 1)
        self._first: dict[int, float] = {}
        self.residual = self._when = 0.0

    def beyond(self, chunk: Chunk) -> Rejection | None:
        """Return the first step whose residual exceeds the bound."""
        wrong = chunk.stats[:, RESIDUAL] > self._bound
        if not wrong.any():
            return None
        k = int(np.argmax(wrong))
        return Rejection(k, UnsolvedImpulses(
            f"the residual of the contact impulses is {chunk.stats[k, RESIDUAL]:.2g} of the "
            f"fastest approach, above impulse_bound, {self._bound:g}; take a shorter step"
        ))  # fmt: skip

    def add(self, chunk: Chunk, start: float) -> None:
        """Accumulate the steps of a chunk that begins at `start`."""
        stats, h, most = chunk.stats, chunk.h, chunk.stats.max(axis=0)
        self._inexact += int((stats[:, RESIDUAL] > self._tolerance).sum())
        self._unended += int((stats[:, UNENDED] > 0.0).sum())
        for column, part in ((AMBIGUOUS, 0.5), (CHOSEN, 0.0)):
            if most[column] > 0.0:
                first = start + (int(np.argmax(stats[:, column])) + part) * h
                self._first.setdefault(column, first)
        if most[RESIDUAL] > self.residual:
            self.residual = float(most[RESIDUAL])
            self._when = start + int(np.argmax(stats[:, RESIDUAL])) * h
        self._sums += stats.sum(axis=0)
        self._largest = np.maximum(self._largest, most)

    @property
    def counts(self) -> dict[str, int]:
        """Iterations; active contacts in all steps and at most in one; inexact steps."""
        return {
            "iterations": int(self._sums[ITERATIONS]),
            "contacts": int(self._sums[CONTACTS]),
            "most_contacts": int(self._largest[CONTACTS]),
            "inexact_steps": self._inexact,
        }

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of inexact or non-unique impulses."""

        def steps(count: float, first: float | None = None) -> str:
            since = "" if first is None else f", the first at t = {first:.6g},"
            return f"in {pluralise(int(count), 'step')}{since}"

        warnings = list[str]()
        if softened := self._sums[CALMED]:
            warnings.append(
                f"{steps(softened)} no impulses satisfy Moreau's impact law at all contacts: "
                "impacts there have no rebound"
            )
        if ambiguous := self._sums[AMBIGUOUS]:
            warnings.append(
                f"{steps(ambiguous, self._first[AMBIGUOUS])} bodies with a restitution of "
                f"{LIVELY:g} or more are struck in several places at once. Moreau's law resolves "
                "these impacts together; for one after another write simultaneous: sequential "
                "(points on surfaces: with events)"
            )
        if chosen := self._sums[CHOSEN]:
            warnings.append(f"{steps(chosen, self._first[CHOSEN])} {INDETERMINATE}")
        if self._unended:
            warnings.append(
                f"{steps(self._unended)} a sequence of impacts did not end (light bodies between "
                "heavy ones): Moreau's law resolved the approach left after "
                f"{LONGEST_SEQUENCE} impacts, up to {self._largest[UNENDED]:.3g}"
            )
        if self._inexact:
            warnings.append(
                f"{steps(self._inexact)} the residual of the contact impulses exceeds the "
                f"tolerance of {self._tolerance:g}: up to {self.residual:.2g} of the fastest "
                f"approach, at t = {self._when:.6g}"
            )
        return tuple(warnings)
