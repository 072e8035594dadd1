"""Modes of a contact in a run, and the edge of its friction cone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from statechart.arrays import Array

if TYPE_CHECKING:
    from contacts.dynamics.snapshot import PerContact


class ContactLaw(NamedTuple):
    """Modes, friction and restitution of a contact."""

    name: str  # Name of the contact
    states: tuple[str, ...]  # Its region's states
    # `cone_n`, `cone_t`: Unit edge of the friction cone at rest
    cone_n: float
    cone_t: float
    restitution: float  # Coefficient, 0 where the contact is never free
    impact: str  # stronge, newton, poisson or moreau


def cones(laws: Sequence[ContactLaw], contacts: Sequence[PerContact]) -> Array:
    """Return the unit edges (c, 6) of the friction cones: at rest, in slide+, in slide-."""
    edges = [
        (law.cone_n, law.cone_t, *(contact.edges or 2 * (law.cone_n, law.cone_t)))
        for law, contact in zip(laws, contacts, strict=True)
    ]
    return np.array(edges, dtype=float).reshape(-1, 6)


def sliding_edge(law: ContactLaw, contact: PerContact) -> tuple[float, float]:
    """Return the unit edge of a contact's cone in the direction of its slip."""
    plus_n, plus_t, minus_n, minus_t = contact.edges or 2 * (law.cone_n, law.cone_t)
    return (plus_n, plus_t) if contact.slip > 0.0 else (minus_n, minus_t)


def edge(mu: float) -> tuple[float, float]:
    """Return the unit edge ``(1, mu) / hypot(1, mu)`` of a cone of friction, also at mu = inf."""
    if math.isinf(mu):
        return 0.0, 1.0
    return 1.0 / math.hypot(1.0, mu), mu / math.hypot(1.0, mu)


def edges(mu: Array) -> tuple[Array, Array]:
    """Return the unit edges of cones of friction (k,), as two columns (k,)."""
    n, t = np.array([edge(one) for one in mu.tolist()]).reshape(-1, 2).T
    return n, t
