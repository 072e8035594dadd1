"""One contact's frictional impact: Routh's path, ended by a restitution law.

The impulse grows along the edge of the friction cone while the point slips, along the sticking
direction while it sticks; velocities are affine along each piece, so every piece is closed form
and the path has at most a few. Restitution is Stronge's (energetic: the work of the normal
impulse in restitution is e^2 of that in compression; energy never grows), Poisson's (impulse) or
Newton's (velocity). Moreau's law has no path; one that is asked for (a jam) ends as Newton's.
Routh 1905; Stronge, Proc. R. Soc. A 431 (1990); Wang and Mason 1992.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from contacts.dynamics import snapshot as numbers
from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.impacts.path import (
    ENDLESS,
    NEWTON,
    POISSON,
    POWERLESS,
    SLIP,
    SLIP_MINUS,
    SLIP_PLUS,
    STICK,
    STRONGE,
    UNTRUSTED,
    WEDGE,
    WEDGED,
    strike,
)
from contacts.scene.parts import MOREAU
from statechart.arrays import Array
from statechart.errors import NoConsistentMode, SingularMode

MEANINGS: Mapping[str, int] = {
    "newton": NEWTON,
    MOREAU: NEWTON,
    "poisson": POISSON,
    "stronge": STRONGE,
}
"""Law of a contact to what its restitution means."""
_PIECES = {SLIP: "slip", SLIP_PLUS: "slip+", SLIP_MINUS: "slip-", STICK: "stick", WEDGE: "wedge"}


@dataclass(frozen=True, eq=False)
class Impact:
    """What an impact does.

    Attributes
    ----------
    velocity : (n,) array
        Rates of the coordinates after it.
    normal, tangential : float
        Impulse on the body.
    path : tuple of str
        slip+, slip-, stick in the order of the path, and wedge where friction stops it for good.
    """

    velocity: Array
    normal: float
    tangential: float
    path: tuple[str, ...]


def impact(
    snapshot: Snapshot,
    contact: PerContact,
    law: ContactLaw,
    restitution: float,
    *,
    braking: bool = False,
) -> Impact:
    """Return the outcome of an impact at `contact`, the only closed one.

    Parameters
    ----------
    snapshot : Snapshot
        The state's numbers, before.
    contact : PerContact
        With ``gap_rate < 0``.
    law : ContactLaw
        Friction and the meaning of restitution.
    restitution : float
        Coefficient, 0 to 1.
    braking : bool
        Slip is stopped first, though the contact does not approach (see
        `contacts.impacts.jamming`).

    Raises
    ------
    NoConsistentMode
        If the path does not end (possible only on the Painleve boundary), or a led joint pushes
        the point on where friction wedges it.
    SingularMode
        If a piece cannot be solved for to 1e-8.
    """
    velocity = snapshot.velocity.copy()
    status, normal, tangential, code, u_n, u_t = strike(
        np.ascontiguousarray(snapshot.mass),
        np.ascontiguousarray(contact.jacobian),
        (contact.gap_rate, contact.slip),
        np.array([law.cone_n, law.cone_t]),
        MEANINGS[law.impact],
        restitution,
        braking,
        velocity,
    )
    path = pieces(code)
    if status == WEDGED:
        raise NoConsistentMode(
            f"{law.name}: its impact wedges the point: slip has stopped, friction lets it "
            f"slip on neither way, and it is led on into its surface at {-u_n:.3g}"
        )
    if status == ENDLESS:
        raise NoConsistentMode(
            f"{law.name}: the impact's path does not end (approach {-u_n:.3g}, slip {u_t:.3g}); "
            f"it went {', '.join(path)}"
        )
    if status == POWERLESS:
        raise NoConsistentMode(
            "an impulse along the friction cone changes no velocity of the contact"
        )
    if status == UNTRUSTED:
        raise SingularMode(numbers.UNTRUSTED)
    return Impact(velocity, normal, tangential, path)


def pieces(code: int) -> tuple[str, ...]:
    """Return the names of a path's pieces."""
    names = []
    while code:
        names.append(_PIECES[code & 7])
        code >>= 3
    return tuple(names)
