"""Painleve's paradoxes: a sliding contact that friction presses into its surface.

At a sliding contact the normal acceleration is ``b + p V`` with the force along the edge of the
cone (Painleve 1895; Genot and Brogliato, Eur. J. Mech. A 18 (1999)). Where ``p > 0`` there is one
answer. Where ``p < 0`` there is none if ``b < 0`` (inconsistent), and there are two if ``b > 0``
(indeterminate): free flight, and a force without cause.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import PerContact, Snapshot, answer, solve_kkt

# Of the response to a normal force alone: p this small cannot be told from none, and the force
# that it asks for stops slip in less time than can be told from none.
_NONE = 1e-14


@dataclass(frozen=True)
class Paradox:
    """A sliding contact with p <= 0 (or nearly so), the other contacts seen as open."""

    contact: str
    # Normal acceleration per unit of normal force V while it slides; per unit of the force along
    # the cone's edge where mu is infinite. In 1/mass
    p: float
    b: float  # Normal acceleration without force
    mu: float  # Coefficient of friction
    critical: float  # The mu at which p = 0

    @property
    def kind(self) -> str:
        """inconsistent, or indeterminate; about to be so where p > 0 still."""
        if self.p > 0.0:
            return "about to be inconsistent"
        return "inconsistent" if self.b < 0.0 else "indeterminate"

    def __str__(self) -> str:
        return (
            f"Painleve: sliding of {self.contact} is {self.kind}: p = {self.p:.6g}, free normal "
            f"acceleration {self.b:.6g}, mu = {self.mu:.6g}, critical mu = {self.critical:.6g}"
        )


def paradoxes(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    touching: Sequence[bool],
    still_below: float,
    nearly: float = 0.0,
) -> dict[int, Paradox]:
    """Return the touching contacts that slide with p <= 0, or pressed with next to none.

    Slip speeds up to `still_below` are zero; p up to `nearly`, in parts of the response to a normal
    force, is next to none.
    """
    found: dict[int, Paradox] = {}
    for i, (law, contact) in enumerate(zip(laws, snapshot.contacts, strict=True)):
        if not touching[i] or abs(contact.slip) <= still_below or law.cone_t == 0.0:
            continue
        sign = math.copysign(1.0, contact.slip)
        p = _response(snapshot, contact, law.cone_n, -sign * law.cone_t)
        straight = _response(snapshot, contact, 1.0, 0.0)
        if p > max(nearly, _NONE) * straight:
            continue
        none = np.zeros((0, len(snapshot.forces)))
        free = solve_kkt(snapshot.mass, snapshot.forces, none, none, np.zeros(0))
        b = math.nan if free is None else float(contact.jacobian[0] @ free[0]) + contact.bias_n
        if p >= 0.0 and not b < 0.0:
            continue
        across = sign * _response(snapshot, contact, 0.0, 1.0)
        steep = law.cone_n == 0.0
        found[i] = Paradox(
            law.name,
            p if steep else p / law.cone_n,
            b,
            math.inf if steep else law.cone_t / law.cone_n,
            straight / across if across > 0.0 else math.inf,
        )
    return found


def _response(snapshot: Snapshot, contact: PerContact, n: float, t: float) -> float:
    """Return the normal acceleration per unit force along (n, t)."""
    column = contact.jacobian.T @ np.array([n, t])
    solved = answer(snapshot, contact.jacobian[:1], column[None], np.ones(1))
    # The force that one unit of acceleration takes; none does where p = 0.
    if solved is None:
        return 0.0
    amount = float(solved[1][0])
    return 1.0 / amount if amount != 0.0 else math.inf
