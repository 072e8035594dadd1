"""Steps that end a run: too long for the motion, or without impulses that keep bodies apart."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from contacts.states import OFF_CODE
from contacts.time_stepping.chunk import RESIDUAL, Chunk
from statechart.arrays import Array, Ints
from statechart.errors import NoConsistentMode, SimulationError, StepTooLarge, UnsolvedImpulses

DEEPEST = 0.1
"""Largest gap that a step may close, relative to the scene."""

# Largest energy gain of a step, relative to the contacts' kinetic energy. Steps that follow a
# surface by a tenth of a radian add a thousandth; those that do not follow it, multiples.
_MOST_ADDED = 0.1
HELPLESS = 0.1
"""Residual, relative to the fastest approach, from which impulses are of no help."""
# Depths of round-off and joint errors, relative to the scene.
_SHALLOW = 1e-6


class Rejection(NamedTuple):
    """A rejected step."""

    step: int  # Its index in the chunk.
    why: SimulationError
    deep: str = ""  # The region that penetrates too far, if that is why.


def too_large(
    chunk: Chunk, angles: Ints, regions: Sequence[str], size: float, step: float
) -> Rejection | None:
    """Return the first step that is too long for its motion.

    `angles` are the places of angular rates in a state, `size` the scale of the scene; the chunk
    may have parts of the declared `step`.
    """
    h = chunk.h
    turn: Array = h * np.max(np.abs(chunk.states[1:, angles]), axis=1, initial=0.0)
    wrong = (turn > math.pi) | (chunk.closing > DEEPEST * size) | (chunk.passed > 0.0)
    wrong |= chunk.energy_gain > _MOST_ADDED
    if not wrong.any():
        return None
    k = int(np.argmax(wrong))
    deep, closing, gain = "", chunk.closing[k], chunk.energy_gain[k]
    if turn[k] > math.pi:
        shorter = 0.1 * h / turn[k]
        problem = f"a body turns by {turn[k]:.3g} radians in one step of {h:g}"
    elif chunk.passed[k] > 0.0:
        shorter = 0.5 * h * chunk.passed[k]
        problem = f"a body passes through another within one step of {step:g}"
    elif closing <= DEEPEST * size:
        # The energy gain grows with the square of the step.
        shorter = 0.1 * h * math.sqrt(_MOST_ADDED / gain)
        problem = (
            f"contacts would add {gain:.2g} of the kinetic energy in one step of {h:g}, in which "
            "surfaces or bodies turn too far"
        )
    else:
        shorter, deep = 0.1 * h * DEEPEST * size / closing, _deepest(chunk, regions, k)
        problem = (
            f"a contact closes at a distance of {closing:.3g} from its surface in one step of "
            f"{h:g}, in a scene of size {size:.3g}"
        )
    return Rejection(k, StepTooLarge(f"{problem}; take {shorter:.1g} or less"), deep)


class SqueezeCheck:
    """Detects bodies that sink although no impulses keep them out."""

    def __init__(self, regions: Sequence[str], step: float, start_depth: float) -> None:
        self._regions, self._step, self._start_depth = regions, step, start_depth
        # Largest depth in a helpless step, and remaining depth then.
        self._deepest, self._left = -math.inf, -math.inf

    def find(
        self, chunk: Chunk, start: float, fastest: float, left: Callable[[Array, float], float]
    ) -> Rejection | None:
        """Return a helpless step in which something sinks.

        It is deeper than a step at the fastest approach; or the depth that no motion removes has
        grown by a step's present approach since impulses first failed (an earlier fast approach
        says nothing about a later squeeze).
        """
        helpless = chunk.stats[:, RESIDUAL] > HELPLESS
        if not helpless.any():
            return None
        depths: Array = -np.min(_gaps(chunk), axis=1, initial=math.inf)
        approach = np.maximum.accumulate(np.maximum(chunk.approach, fastest))
        wrong = (depths > self._start_depth + self._step * approach) & helpless
        if wrong.any():
            k = int(np.argmax(wrong))
            name = _deepest(chunk, self._regions, k)
            return Rejection(k, UnsolvedImpulses(
                f"no impulses keep {name} out of what it touches: it is {depths[k]:.3g} deep, with "
                f"a residual of {chunk.stats[k, RESIDUAL]:.2g} of the fastest approach. A body "
                "that moves as prescribed may squeeze it, or masses may differ too much"
            ), name)  # fmt: skip
        stuck = np.flatnonzero(helpless)
        k = int(stuck[np.argmax(depths[stuck])])
        sinks = self._step * float(chunk.approach[k])
        if not depths[k] > max(0.0, self._deepest + 0.5 * sinks):
            return None
        self._deepest = float(depths[k])

        def stays(k: int) -> float:
            return max(left(chunk.states[k], start + k * chunk.h), 0.0)

        if self._left < 0.0:
            self._left = stays(int(stuck[0]))
        allowed = self._left + sinks
        if not stays(k) > allowed:
            return None
        stuck = stuck[stuck <= k]
        k = int(stuck[bisect_left(stuck, True, key=lambda i: stays(int(i)) > allowed)])
        name = _deepest(chunk, self._regions, k)
        return Rejection(k, _squeeze_error(name, stays(k)), name)


def _squeeze_error(name: str, depth: float) -> UnsolvedImpulses:
    return UnsolvedImpulses(
        f"{name} cannot get out of what it touches: some penetration of {depth:.3g} always "
        "remains; prescribed motions or constraints squeeze it"
    )


def squeezed(name: str, depth: float, size: float) -> UnsolvedImpulses | None:
    """Return the error of a region that stays too deep wherever it moves, or None."""
    return _squeeze_error(name, depth) if depth > _SHALLOW * size else None


def depth_left(gaps: Array, rows: Array, held: Array) -> tuple[float, Array]:
    """Return the depth that no displacement removes, and the best displacement.

    A linear program: the minimum over u, with ``held u = 0``, of the largest ``-gaps - rows u``
    (gaps linear in u). Below 0 if all can be apart.
    """
    from scipy.optimize import linprog

    if not len(gaps):
        return -math.inf, np.zeros(rows.shape[1])
    n = rows.shape[1]
    result = linprog(
        np.append(np.zeros(n), 1.0),
        -np.pad(rows, ((0, 0), (0, 1)), constant_values=1.0), gaps,
        np.pad(held, ((0, 0), (0, 1))), np.zeros(len(held)),
        # Bounded below: clearance does not matter.
        [*[(None, None)] * n, (-float(np.abs(gaps).max()), None)],
    )  # fmt: skip
    if result.status != 0:
        return -math.inf, np.zeros(n)
    return float(result.fun), result.x[:n]


def _gaps(chunk: Chunk) -> Array:
    found: Array = np.where(chunk.codes == OFF_CODE, math.inf, chunk.gaps)
    return found


def _deepest(chunk: Chunk, regions: Sequence[str], k: int) -> str:
    return regions[int(np.argmin(_gaps(chunk)[k]))]


def without_limit(chunk: Chunk, start: float, couplings: Sequence[str]) -> Rejection | None:
    """Return the first step in which the limit of a coupling is negative, or has no value.

    The last gaps of a step are the limits of couplings.
    """
    limits = chunk.gaps[:, chunk.gaps.shape[1] - len(couplings) :]
    for k, c in np.argwhere(~(limits >= 0.0))[:1].tolist():
        end = start + (k + 1) * chunk.h
        return Rejection(k, NoConsistentMode(
            f"coupling {couplings[c]!r}: its limit is below zero or has no value by t = {end:.7g}; "
            "a coupling that lets go is one with enabled: RELATION"
        ))  # fmt: skip
    return None
