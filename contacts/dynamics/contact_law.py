"""Modes of a contact in a run, and the edge of its friction cone."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array


class ContactLaw(NamedTuple):
    """Modes, friction and restitution of a contact."""

    name: str  # Name of the contact
    states: tuple[str, ...]  # Its region's states
    # `cone_n`, `cone_t`: Unit edge of the friction cone
    cone_n: float
    cone_t: float
    restitution: float  # Coefficient, 0 where the contact is never free
    impact: str  # stronge, newton, poisson or moreau


@lru_cache(maxsize=1024)
def cones(laws: tuple[ContactLaw, ...]) -> Array:
    """Return the unit edges (c, 2) of the contacts' friction cones."""
    return np.array([(law.cone_n, law.cone_t) for law in laws], dtype=float).reshape(-1, 2)


def edge(mu: float) -> tuple[float, float]:
    """Return the unit edge ``(1, mu) / hypot(1, mu)`` of a cone of friction, also at mu = inf."""
    if math.isinf(mu):
        return 0.0, 1.0
    return 1.0 / math.hypot(1.0, mu), mu / math.hypot(1.0, mu)
