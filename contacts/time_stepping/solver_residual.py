"""Residual of the contact laws over a run, and solver statistics."""

from __future__ import annotations

import numpy as np

from contacts.solvers.impact_sequence import LONGEST_SEQUENCE
from contacts.time_stepping.chunk import (
    AMBIGUOUS,
    CALMED,
    CHOSEN,
    CONTACTS,
    ITERATIONS,
    LIVELY,
    RESIDUAL,
    UNENDED,
    Chunk,
)
from statechart.automaton.time_stepper import Impulses
from statechart.errors import SimulationError, UnsolvedImpulses
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
        self._iterations = self._contacts = self._most = self._missed = self._softened = 0
        self._ambiguous = self._unended = self._several = 0
        self.residual = self._when = self._first = self._left = self._choice = 0.0

    def beyond(self, chunk: Chunk) -> tuple[int, SimulationError] | None:
        """Return the first step whose residual exceeds the bound, and the error."""
        wrong = chunk.stats[:, RESIDUAL] > self._bound
        if not wrong.any():
            return None
        k = int(np.argmax(wrong))
        return k, UnsolvedImpulses(
            f"the residual of the contact impulses is {chunk.stats[k, RESIDUAL]:.2g} of the "
            f"fastest approach, above impulse_bound, {self._bound:g}; take a shorter step"
        )

    def add(self, chunk: Chunk, start: float) -> None:
        """Accumulate the steps of a chunk that begins at `start`."""
        efforts, h = chunk.stats, chunk.h
        total, most = efforts.sum(axis=0), efforts.max(axis=0)
        self._iterations += int(total[ITERATIONS])
        self._contacts += int(total[CONTACTS])
        self._most = max(self._most, int(most[CONTACTS]))
        if most[RESIDUAL] > self._tolerance:
            self._missed += int((efforts[:, RESIDUAL] > self._tolerance).sum())
        self._softened += int(total[CALMED])
        if total[AMBIGUOUS] and not self._ambiguous:
            self._first = start + (int(np.argmax(efforts[:, AMBIGUOUS])) + 0.5) * h
        self._ambiguous += int(total[AMBIGUOUS])
        if total[CHOSEN] and not self._several:
            self._choice = start + int(np.argmax(efforts[:, CHOSEN])) * h
        self._several += int(total[CHOSEN])
        if most[UNENDED] > 0.0:
            self._unended += int((efforts[:, UNENDED] > 0.0).sum())
        self._left = max(self._left, float(most[UNENDED]))
        if most[RESIDUAL] > self.residual:
            self.residual = float(most[RESIDUAL])
            self._when = start + int(np.argmax(efforts[:, RESIDUAL])) * h

    @property
    def counts(self) -> dict[str, int]:
        """Iterations; active contacts in all steps and at most in one; inexact steps."""
        return {
            "iterations": self._iterations,
            "contacts": self._contacts,
            "most_contacts": self._most,
            "inexact_steps": self._missed,
        }

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of inexact or non-unique impulses."""
        warnings: tuple[str, ...] = ()
        if self._softened:
            warnings += (
                (
                    f"in {pluralise(self._softened, 'step')} no impulses satisfy Moreau's impact "
                    "law at all contacts: impacts there have no rebound"
                ),
            )
        if self._ambiguous:
            warnings += (
                f"in {pluralise(self._ambiguous, 'step')}, the first at t = {self._first:.6g}, "
                f"bodies with a restitution of {LIVELY:g} or more are struck in several places at "
                "once, and Moreau's law lets a body that passes the blow on not rebound. "
                "simultaneous: sequential resolves impacts one after another (points on surfaces, "
                "with events)",
            )
        if self._several:
            warnings += (
                f"in {pluralise(self._several, 'step')}, the first at t = {self._choice:.6g}, "
                + INDETERMINATE,
            )
        if self._unended:
            warnings += (
                (
                    f"in {pluralise(self._unended, 'step')} a sequence of impacts did not end "
                    f"(light bodies between heavy ones): Moreau's law resolved the approach left "
                    f"after "
                    f"{LONGEST_SEQUENCE} impacts, up to {self._left:.3g}"
                ),
            )
        if self._missed:
            warnings += (
                (
                    f"in {pluralise(self._missed, 'step')} the residual of the contact impulses "
                    f"exceeds the tolerance of {self._tolerance:g}: up to {self.residual:.2g} of "
                    f"the fastest approach, at t = {self._when:.6g}"
                ),
            )
        return warnings
