"""Floor of a number that may be off an integer by round-off."""

from __future__ import annotations

import math

_ROUNDED = 1e-12
"""Relative distance below which a number is whole: quotients are rounded, 0.3/0.1 is a
little less than 3. Numbers of copies and rows are far below its inverse."""

_ALL_WHOLE = 2.0**53
"""From here on every float is a whole number."""


def tolerant_floor(a: float) -> float:
    """Return the floor of `a`; a number within round-off of an integer is that integer."""
    if not abs(a) < _ALL_WHOLE:
        return a
    near = float(math.floor(a + 0.5))
    if abs(a - near) <= _ROUNDED * max(1.0, abs(a)):
        return near
    return float(math.floor(a))
