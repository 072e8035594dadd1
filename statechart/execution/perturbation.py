"""Runs that are slightly off: what small errors are magnified into, and what tolerances shift."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import Setup

# A few units in the last place: what a run of many steps adds up to.
_MIN_PERTURBATION = 8.0 * float(np.finfo(float).eps)
# Errors of what is smaller, in the sizes of the variables, are relative to this.
_SMALL = 1e-3
# The first look ahead ends elsewhere, and so do all steps after it: their rounding is another. What
# has no scale of its own is cut at one.
_CUT = 1e-3
# Two ends of a body may hit the ground in turn, ever faster, and be closed together once gaps are
# below their tolerance: which one is last then depends on it. Half way, by ratio, to the next
# tolerance of an estimate, as two tolerances may have the same one for the last.
_WIDER = 4.5


def nudged(automaton: Automaton) -> Automaton:
    """Return the automaton with every initial value larger by a small part, and `widened`.

    That part is the tolerance of the run, or a few roundings where that is more: of the value or,
    where that is small, of the size of its variable, as the errors of its integration are. Zeros
    stay zero, and symmetric starts symmetric. The tolerance of gaps is larger, too, and
    steps are cut elsewhere, which shows what their rounding comes to.
    """

    def changed(own: Setup, relative: float) -> Setup:
        horizon = _CUT * own.horizon if own.horizon < math.inf else 1.0
        moved = _perturbed(own, np.sign(own.initial) * max(relative, _MIN_PERTURBATION), gap=_WIDER)
        return replace(moved, horizon=horizon)

    return _with_setup(automaton, changed)


def shifted(automaton: Automaton, part: float, signs: Array) -> Automaton:
    """Return the automaton with all initial values moved by a part of them, and `widened`."""
    return _with_setup(automaton, lambda own, _: _perturbed(own, signs * part), part)


def widened(automaton: Automaton) -> Automaton:
    """Return the automaton with the tolerances of all forces doubled.

    A mode is left where a force is below zero by its tolerance, whatever the engine and however
    tight: all runs are late by that, and only one with another tolerance shows by how much.
    """
    return _with_setup(automaton, lambda own, _: _perturbed(own, np.zeros(len(own.initial))))


def loosened(automaton: Automaton, relative: float) -> Automaton:
    """Return the automaton whose modes are chosen as in a run at the tolerance `relative`.

    It is integrated as tightly as asked for; what counts as closed and as at rest is as there.
    """
    return _with_setup(automaton, lambda own, _: own, relative)


def _with_setup(
    automaton: Automaton, changed: Callable[[Setup, float], Setup], fixed: float | None = None
) -> Automaton:
    """Return the automaton with changed numbers of its runs, those of a fixed tolerance if any."""

    def setup(overrides: Mapping[str, float], relative: float) -> Setup:
        return changed(automaton.setup(overrides, relative if fixed is None else fixed), relative)

    return replace(automaton, setup=setup)


def _perturbed(own: Setup, parts: Array, gap: float = 1.0) -> Setup:
    """Return numbers with the initial values moved by parts of their sizes, forces doubled."""
    tolerances = {**own.tolerances}
    for kind, factor in (("force", 2.0), ("hold", 2.0), ("gap", gap)):
        if kind in tolerances:
            tolerances[kind] *= factor
    return replace(own, initial=own.initial + parts * _variable_sizes(own), tolerances=tolerances)


def _variable_sizes(setup: Setup) -> Array:
    """Return what errors of initial values are relative to."""
    own = np.abs(setup.initial)
    return own if setup.sizes is None else np.maximum(own, _SMALL * setup.sizes)
