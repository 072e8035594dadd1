"""Perturbed runs, which show the growth of errors and the influence of tolerances."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import Enum, auto

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import Setup

# Smallest relative perturbation: a few units in the last place, as accumulated over many steps.
_MIN_PERTURBATION = 8.0 * float(np.finfo(float).eps)
# Perturbations are relative to the value, but at least to this part of the variable's size.
_MIN_RELATIVE_SIZE = 1e-3
# Factor of the first horizon, which changes all steps and their round-off; the horizon is 1 without
# a scale.
_HORIZON_FACTOR = 1e-3
# Factor of the tolerance of gaps. Alternating impacts of two ends of a body are closed when the
# gaps are below their tolerance, which decides the last impact. It lies between the tolerances of
# successive estimates.
_GAP_FACTOR = 4.5


class Start(Enum):
    """Initial values of a run, and tolerances of its modes."""

    DECLARED = auto()
    INCREASED = auto()  # `with_increased_start`
    INCREASED_WITH_TOLERANCES = auto()  # the same, with the tolerances of the declared start
    DECREASED = auto()  # where formulas have no value at an increased start, as acos(x) at 1


def with_increased_start(automaton: Automaton, start: Start) -> Automaton:
    """Return the automaton with all initial values increased by a small factor.

    The relative change is the tolerance of the run, at least a few units in the last place. Zeros
    stay zero, and symmetric starts symmetric. The first horizon is shorter, which changes the
    round-off of all steps. With `Start.INCREASED`, modes have their least tolerances (of gaps: a
    few times that), so that impacts which the run merges stay apart; with `Start.DECREASED` they
    do, too, and the factor is smaller than 1.
    """

    def changed(setup: Setup, relative: float) -> Setup:
        horizon = _HORIZON_FACTOR * setup.horizon if setup.horizon < math.inf else 1.0
        part = max(relative, _MIN_PERTURBATION) * (-1.0 if start is Start.DECREASED else 1.0)
        perturbed = _perturb(setup, np.sign(setup.initial) * part, gap=_GAP_FACTOR)
        return replace(perturbed, horizon=horizon)

    return _with_setup(
        automaton, changed, None if start is Start.INCREASED_WITH_TOLERANCES else 0.0
    )


def with_shifted_start(automaton: Automaton, part: float, signs: Array) -> Automaton:
    """Return the automaton with initial values changed by a factor, and doubled tolerances."""
    return _with_setup(automaton, lambda own, _: _perturb(own, signs * part), part)


def with_doubled_tolerances(automaton: Automaton) -> Automaton:
    """Return the automaton with the tolerances of all forces doubled.

    A mode is left when a force is below zero by its tolerance, which delays the event in all runs,
    whatever the accuracy of the engine; another tolerance shows the effect.
    """
    return _with_setup(automaton, lambda own, _: _perturb(own, np.zeros(len(own.initial))))


def with_loosened_modes(automaton: Automaton, relative: float) -> Automaton:
    """Return the automaton with the tolerances of modes, but not of the engine, for `relative`."""
    return _with_setup(automaton, lambda own, _: own, relative)


def _with_setup(
    automaton: Automaton, changed: Callable[[Setup, float], Setup], fixed: float | None = None
) -> Automaton:
    """Return the automaton with a changed setup, evaluated at a fixed tolerance if given."""

    def setup(overrides: Mapping[str, float], relative: float) -> Setup:
        return changed(automaton.setup(overrides, relative if fixed is None else fixed), relative)

    return replace(automaton, setup=setup)


def _perturb(setup: Setup, parts: Array, gap: float = 1.0) -> Setup:
    """Return the setup with changed initial values and doubled tolerances of forces."""
    tolerances = {**setup.tolerances}
    for kind, factor in (("force", 2.0), ("hold", 2.0), ("gap", gap)):
        if kind in tolerances:
            tolerances[kind] *= factor
    # Changes are relative to the values, or to the sizes of the variables.
    sizes = np.abs(setup.initial)
    if setup.sizes is not None:
        sizes = np.maximum(sizes, _MIN_RELATIVE_SIZE * setup.sizes)
    return replace(setup, initial=setup.initial + parts * sizes, tolerances=tolerances)
