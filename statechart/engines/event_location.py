"""The certified first fall of a margin along the polynomials of an integrator.

A margin is declared as an expression, so it can be *enclosed*: its exact range over a piece of a
step lies in an interval that the computer can find, and an interval above zero is a proof that
nothing happens there. Branch and bound on the leftmost piece first therefore finds the first
crossing, however narrow, or proves that there is none; looking at values cannot (R. E. Moore,
"Interval Analysis", 1966; "Methods and Applications of Interval Analysis", 1979, chapter 5).

Over step i of an arc, variable v is sum_k coeffs[i, v, k] s**k with s in [0, 1], at the local
time tau = times[i] + s (times[i + 1] - times[i]) and the absolute time start + tau. These
polynomials are taken as exact: what is proved is proved of them, not of the differential equation.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.engines.engine import Path
from statechart.formulas.tape import Tape
from statechart.kernels.boxes import Steps
from statechart.kernels.search import BUDGET, CROSSING, GRAZE, NON_FINITE, NONE
from statechart.kernels.search import search as kernel

BOXES = 100_000
"""Most boxes of a search; one that is decided takes a handful a step."""


class Verdict(Enum):
    """Result of an event search, in a sentence."""

    NONE = "It is proved that no margin falls below minus its tolerance."
    CROSSING = "The first crossing is located, and proved to be the first."
    GRAZE = "A margin meets minus its tolerance too closely to tell whether it passes."
    BUDGET = "The search used up its boxes undecided."
    NON_FINITE = "A polynomial or a margin is infinite or undefined."


_VERDICTS = {GRAZE: Verdict.GRAZE, BUDGET: Verdict.BUDGET, NON_FINITE: Verdict.NON_FINITE}


class Crossing(NamedTuple):
    """A margin's fall, in place and local time of the arc."""

    guard: int  # Index of the margin; -1 in `Search.undecided` where it is no margin in particular.
    step: int  # Step that holds `time`.
    s: float  # Place in that step, in [0, 1].
    # Where the margin itself vanished on the descent that then passed -tolerance: the last float64
    # place, to a few ulp, where it is still >= 0. If it is below 0 on all of that descent, where
    # the descent starts (the start of the arc for one that starts below 0 and falls).
    time: float
    # End of the bracket, >= `time`: margin + tolerance is certainly <= 0 there. At the end of a
    # step it may be zero to within rounding.
    crossed: float


class Search(NamedTuple):
    """Result of `search`."""

    verdict: Verdict  # How it ended.
    crossing: Crossing | None  # The crossing, if and only if the verdict is CROSSING.
    boxes: int  # Number of boxes looked at.
    # The box [`time`, `crossed`] that could not be decided, for GRAZE, BUDGET and NON_FINITE; all
    # before it is proved clear.
    undecided: Crossing | None = None


def search(
    tape: Tape,
    tolerances: NDArray[np.float64],
    path: Path,
    parameters: NDArray[np.float64],
    start: float,
    first: int,
    last: int,
    budget: int = BOXES,
) -> Search:
    """Find the first place in the steps [first, last) where an output of the tape falls.

    The outputs are margins, >= 0 while a mode holds; one falls where it passes minus its
    tolerance. With a tolerance > 0 a start on the surface (margin 0) needs no cool-down. A margin
    that is zero to within rounding where a step starts and provably rises from there does not
    fall: that is no event either. The end of a step belongs to the step that ends there: a margin
    that falls and meets minus its tolerance to within rounding exactly at the end of a chunk is
    reported, with s = 1, by that chunk. A margin below minus its tolerance where a step starts
    crosses there. Steps before `first` are known to be clear.

    Of several margins the one that passes minus its tolerance first is reported, of equal ones
    that of lowest index. Others may fall at the same instant to within rounding: whoever acts
    on an event looks at all of them.

    For inner loops: nothing is checked, and a wrong shape reads beyond the arrays. `tolerances`
    (n_out,) are in the units of the margins, infinite for those that are not watched; `start` is
    the absolute time of the local time 0, `budget` the greatest number of boxes.
    """
    code, guard, step, s, time, crossed, boxes = kernel(
        tape.parts,
        tolerances,
        Steps(path.times, path.coefficients, parameters, start),
        first,
        last,
        budget,
    )
    if code == NONE:
        return Search(Verdict.NONE, None, boxes)
    place = Crossing(guard, step, s, time, crossed)
    if code == CROSSING:
        return Search(Verdict.CROSSING, place, boxes)
    return Search(_VERDICTS[code], None, boxes, place)
