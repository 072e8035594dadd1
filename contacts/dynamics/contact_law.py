"""Contact law: the modes, friction cone and restitution of a contact in a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from contacts.scene.scene import Scene
from statechart.arrays import Array, Ints

if TYPE_CHECKING:
    from contacts.dynamics.snapshot import PerContact, Snapshot


class ContactLaw(NamedTuple):
    """Modes, friction and restitution of a contact."""

    name: str  # Name of the contact
    states: tuple[str, ...]  # Its region's states
    # `cone_n`, `cone_t`: Unit edge of the friction cone at rest
    cone_n: float
    cone_t: float
    restitution: float  # Coefficient, 0 where the contact is never free
    impact: str  # stronge, newton, poisson or moreau
    coupling: bool = False  # Whether it is a coupling
    # Index of the contact whose normal force multiplies the limits of a coupling; -1: none
    carrier: int = -1
    pair: int = -1  # Its number of `touching_pairs`
    lever: float = 1.0  # From the force of a coupling to its couple


def coupling_law(
    name: str, states: tuple[str, ...], carrier: int = -1, lever: float = 1.0
) -> ContactLaw:
    """Return the law of a coupling, which only sticks or slips."""
    return ContactLaw(name, states, 0.0, 1.0, 0.0, "newton", True, carrier, lever=lever)


def touching_pairs(scene: Scene) -> Ints:
    """Return numbers (c,) of the pairs of bodies, or of a body and a surface, in contact."""
    things: list[frozenset[str]] = []
    for contact in scene.contacts.values():
        carrier = scene.surfaces[contact.surface].body
        ground = f"surface {contact.surface}" if carrier is None else f"body {carrier}"
        things.append(frozenset({f"body {contact.point.body}", ground}))
    things += [frozenset({f"coupling {name}"}) for name in scene.couplings]
    numbers = {pair: k for k, pair in enumerate(dict.fromkeys(things))}
    return np.array([numbers[pair] for pair in things], dtype=np.int64)


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


@lru_cache(maxsize=1024)
def carriers(laws: tuple[ContactLaw, ...]) -> Ints:
    """Return the indices (c,) of the contacts that load couplings; -1 elsewhere."""
    return np.array([law.carrier for law in laws], np.int64)


def bounds(laws: Sequence[ContactLaw], snapshot: Snapshot) -> Array:
    """Return `cones` (c, 6), with the two limits of couplings in their first two columns."""
    edges = cones(laws, snapshot.contacts)
    edges[len(edges) - len(snapshot.limits) :, :2] = snapshot.limits
    return edges


def edge(mu: float) -> tuple[float, float]:
    """Return the unit edge ``(1, mu) / hypot(1, mu)`` of a cone of friction, also at mu = inf."""
    if math.isinf(mu):
        return 0.0, 1.0
    return 1.0 / math.hypot(1.0, mu), mu / math.hypot(1.0, mu)


def edges(mu: Array) -> tuple[Array, Array]:
    """Return the unit edges of cones of friction (k,), as two columns (k,)."""
    n, t = np.array([edge(coefficient) for coefficient in mu.tolist()]).reshape(-1, 2).T
    return n, t
