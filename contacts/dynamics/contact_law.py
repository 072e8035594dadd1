"""Modes of a contact in a run, and the edge of its friction cone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints


class ContactLaw(NamedTuple):
    """Modes, friction and restitution of a contact."""

    name: str  # Name of the contact
    states: tuple[str, ...]  # Its region's states
    # `cone_n`, `cone_t`: Unit edge of the friction cone
    cone_n: float
    cone_t: float
    restitution: float  # Coefficient, 0 where the contact is never free
    impact: str  # stronge, newton, poisson or moreau
    coupling: bool = False  # Whether it is a coupling
    # Place of the contact whose normal force the limits of a coupling are multiples of; -1: none
    carrier: int = -1


@lru_cache(maxsize=1024)
def cones(laws: tuple[ContactLaw, ...]) -> Array:
    """Return the unit edges (c, 2) of the contacts' friction cones."""
    return np.array([(law.cone_n, law.cone_t) for law in laws], dtype=float).reshape(-1, 2)


@lru_cache(maxsize=1024)
def carriers(laws: tuple[ContactLaw, ...]) -> Ints:
    """Return the places (c,) of the contacts that load couplings; -1 elsewhere."""
    return np.array([law.carrier for law in laws], np.int64)


def bounds(laws: Sequence[ContactLaw], limits: Array) -> Array:
    """Return the cones (c, 2) of contacts, and the limits of couplings, which are the last."""
    found = cones(tuple(laws))
    if not len(limits):
        return found
    return np.concatenate([found[: len(found) - len(limits)], limits])


def edge(mu: float) -> tuple[float, float]:
    """Return the unit edge ``(1, mu) / hypot(1, mu)`` of a cone of friction, also at mu = inf."""
    if math.isinf(mu):
        return 0.0, 1.0
    return 1.0 / math.hypot(1.0, mu), mu / math.hypot(1.0, mu)
