"""Whether bodies start apart from each other and from surfaces; what is said where they do not."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from contacts.collisions.stepped_heap import SteppedHeap
from contacts.detection.body_numbers import BodyNumbers
from statechart.arrays import Array
from statechart.errors import DeclarationProblem

# Depths that are equal but for rounding.
_SAME = 1e-9


def check_apart(
    tried: Callable[[Array], SteppedHeap],
    names: Sequence[str],
    owners: Sequence[str],
    initial: Array,
    near: float,
) -> None:
    """Check that no body is deeper in another or a surface than `near`.

    Parameters
    ----------
    tried : callable
        Coordinates and rates -> what has taken a step of no length from there, which finds who
        overlaps.
    names, owners : sequence of str
        Of the bodies, and what they are declared by.
    initial : (6 b,) array
        Coordinates and rates at the start.
    near : float

    Raises
    ------
    DeclarationProblem
        If one is.
    """
    trial = tried(initial)
    for name, margin in trial.margins.items():
        if margin < -near:
            body = name.removesuffix(".gap")
            b = list(names).index(body)
            seen = trial.deepest_of(body)
            found = None if seen is None else (b, *seen)
            b, where, advice = found or _covered(tried, trial.numbers, names, initial, b, margin)
            raise DeclarationProblem(
                f"body {names[b]!r} starts {-margin:.6g} deep in {where}",
                advice=f"{advice} out",
                loc=("bodies", owners[b], "start"),
            )


def _covered(
    tried: Callable[[Array], SteppedHeap],
    numbers: BodyNumbers,
    names: Sequence[str],
    initial: Array,
    b: int,
    margin: float,
) -> tuple[int, str, str]:
    """Return who is in the middle of what, where pieces of one cover each other, and advice.

    No face of those is left to touch: of whom the body is as deep in with all others away, that is
    who it is in, or who is in it.
    """
    places = initial[: 3 * len(names)].reshape(-1, 3)[:, :2]
    away = np.hypot(*(places - places[b]).T)
    reach = numbers.sizes[b] + numbers.sizes
    for other in np.flatnonzero(away < reach).tolist():
        state = initial.copy()
        for i in range(len(names)):
            if i not in (b, other):
                state[3 * i] += (i + 2.0) * (np.ptp(places[:, 0]) + 4.0 * numbers.sizes.max())
        gap = tried(state).margins.get(f"{names[b]}.gap", np.inf)
        if other != b and gap <= (1.0 - _SAME) * margin:
            one, whole = sorted((b, other), key=lambda i: float(numbers.sizes[i]))
            far = f"start it {reach[other]:.6g} from the centre of {names[whole]!r}, or move it"
            return one, f"body {names[whole]!r}", far
    return b, "several surfaces", "move it"
