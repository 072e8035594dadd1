"""One contact's frictional impact: Routh's path, ended by a restitution law.

The impulse grows along the edge of the friction cone while the point slips, along the sticking
direction while it sticks; velocities are affine along each piece, so every piece is closed form
and the path has at most a few. Restitution is Stronge's (energetic: the work of the normal
impulse in restitution is e^2 of that in compression; energy never grows), Poisson's (impulse) or
Newton's (velocity). Moreau's law has no path; one that is asked for (a jam) ends as Newton's.
Routh 1905; Stronge, Proc. R. Soc. A 431 (1990); Wang and Mason 1992.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import PerContact, Snapshot, answer
from contacts.scene.parts import MOREAU
from statechart.arrays import Array
from statechart.errors import NoConsistentMode

_LONGEST_PATH = 8
# Of the terms of a rate: less is no error that an impulse should mend.
_ROUNDING = 8 * 2.0**-52


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


@dataclass(frozen=True, eq=False)
class _Piece:
    """Rates of change along a piece of the path, per unit of its parameter."""

    name: str
    velocity: Array
    u_n: float
    u_t: float
    normal: float
    tangential: float


@dataclass(eq=False)
class _Reached:
    """How far an impact has come along its path.

    Attributes
    ----------
    velocity : (n,) array
        Rates of the coordinates; those of the gap and along the surface are `u_n` and `u_t`.
    normal, tangential : float
        Impulse so far.
    work : float
        Of the normal impulse, in compression or, after it, in restitution.
    compressed, stored : float
        Normal impulse and work that compression took; 0 until it ends.
    """

    velocity: Array
    u_n: float
    u_t: float
    normal: float = 0.0
    tangential: float = 0.0
    work: float = 0.0
    compressed: float = 0.0
    stored: float = 0.0
    compressing: bool = True

    def push(self, piece: _Piece, length: float) -> None:
        """Add an impulse along a piece; the contact's own velocities are left to the caller."""
        self.velocity += piece.velocity * length
        self.normal += piece.normal * length
        self.tangential += piece.tangential * length

    def turn(self) -> None:
        """End compression."""
        self.compressing, self.compressed = False, self.normal
        self.stored, self.work = -self.work, 0.0

    def ended(self, *path: str) -> Impact:
        """Return the impact that ends here."""
        return Impact(self.velocity, self.normal, self.tangential, path)


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
    """
    at = _Reached(snapshot.velocity.copy(), contact.gap_rate, contact.slip)
    path: list[str] = []
    for _ in range(_LONGEST_PATH):
        piece = _piece(snapshot, contact, law, at.u_t)
        if piece is None:
            _check_wedge(snapshot, contact, law, at)
            return at.ended(*path, "wedge")
        if not path or path[-1] != piece.name:
            path.append(piece.name)
        to_stop = -at.u_t / piece.u_t if at.u_t * piece.u_t < 0.0 else math.inf
        if braking and at.u_t != 0.0:
            to_end = math.inf
        elif at.compressing:
            to_end = max(-at.u_n / piece.u_n, 0.0) if piece.u_n > 0.0 else math.inf
        else:
            to_end = _restored(law, restitution, piece, at, contact.gap_rate)
        length = min(to_stop, to_end)
        if not math.isfinite(length):
            break
        at.work += piece.normal * length * (at.u_n + 0.5 * piece.u_n * length)
        at.push(piece, length)
        at.u_n = 0.0 if at.compressing and to_end <= to_stop else at.u_n + piece.u_n * length
        at.u_t = 0.0 if to_stop <= to_end else at.u_t + piece.u_t * length
        if to_end <= to_stop:
            if not at.compressing or restitution == 0.0:
                # Pieces that cancel leave their own rounding in what the law prescribes.
                row = contact.jacobian[0]
                missing = at.u_n - (contact.gap_rate + row @ (at.velocity - snapshot.velocity))
                if abs(missing) > _rounding(snapshot, contact, at):
                    at.push(piece, piece.u_n * missing)
                return at.ended(*path)
            at.turn()
    raise NoConsistentMode(
        f"{law.name}: the impact's path does not end (approach {-at.u_n:.3g}, slip {at.u_t:.3g}); "
        f"it went {', '.join(path)}"
    )


def _rounding(snapshot: Snapshot, contact: PerContact, at: _Reached) -> float:
    """Return how well the rate of the gap is known."""
    terms = np.abs(contact.jacobian[0]) @ (np.abs(at.velocity) + np.abs(snapshot.velocity))
    return float(_ROUNDING * terms)


def _check_wedge(snapshot: Snapshot, contact: PerContact, law: ContactLaw, at: _Reached) -> None:
    """Refuse a point that friction wedges and that is led on into its surface.

    What has one way to move only stops with both velocities zero at once; friction may then keep
    it from going back.
    """
    if at.u_n < -_rounding(snapshot, contact, at):
        raise NoConsistentMode(
            f"{law.name}: its impact wedges the point: slip has stopped, friction lets it "
            f"slip on neither way, and it is led on into its surface at {-at.u_n:.3g}"
        )


def _restored(
    law: ContactLaw, restitution: float, piece: _Piece, at: _Reached, approach: float
) -> float:
    """Return how far along a piece restitution ends, by the law of the contact."""
    if law.impact in ("newton", MOREAU):
        return (-restitution * approach - at.u_n) / piece.u_n if piece.u_n > 0 else math.inf
    if law.impact == "poisson":
        left = (1.0 + restitution) * at.compressed - at.normal
        return left / piece.normal if piece.normal > 0.0 else 0.0
    return _energetic(piece, at.u_n, restitution**2 * at.stored - at.work)


def _energetic(piece: _Piece, u_n: float, left: float) -> float:
    """Solve ``normal (u_n s + u_n' s^2 / 2) = left`` for s >= 0."""
    if left <= 0.0 or piece.normal <= 0.0:
        return 0.0
    a, c = 0.5 * piece.normal * piece.u_n, left
    b = piece.normal * u_n
    root = math.sqrt(b * b + 4.0 * a * c) if b * b + 4.0 * a * c > 0.0 else 0.0
    return 2.0 * c / (b + root) if b + root > 0.0 else math.inf


def _piece(snapshot: Snapshot, contact: PerContact, law: ContactLaw, u_t: float) -> _Piece | None:
    """Return the piece that follows; None where friction keeps the point from going anywhere."""
    if law.cone_t == 0.0:
        return _along(snapshot, contact, "slip", law.cone_n, 0.0)
    if u_t != 0.0:
        sign = math.copysign(1.0, u_t)
        return _slipping(snapshot, contact, law, sign)
    stick = _sticking(snapshot, contact)
    if stick is not None and law.cone_n * abs(stick.tangential) <= law.cone_t * stick.normal:
        return stick
    for sign in (1.0, -1.0):
        piece = _slipping(snapshot, contact, law, sign)
        if sign * piece.u_t > 0.0:
            return piece
    return None


def _slipping(snapshot: Snapshot, contact: PerContact, law: ContactLaw, sign: float) -> _Piece:
    name = "slip+" if sign > 0 else "slip-"
    return _along(snapshot, contact, name, law.cone_n, -sign * law.cone_t)


def _along(snapshot: Snapshot, contact: PerContact, name: str, n: float, t: float) -> _Piece:
    """Impulse along (n, t), forwards; scaled to a unit change of normal velocity.

    Where it does not change that (a particle under infinite friction), to one of slip.
    """
    column = contact.jacobian.T @ np.array([n, t])
    for direction in (0, 1):
        row = contact.jacobian[direction : direction + 1]
        solved = answer(snapshot, row, column[None], np.ones(1))
        if solved is None:
            continue
        change, amount = solved[0], float(solved[1][0])
        # Where pressing makes the approach faster (Painleve), the impulse still grows.
        forwards = 1.0 if amount >= 0.0 else -1.0
        change = forwards * change
        return _Piece(
            name,
            change,
            forwards if direction == 0 else 0.0,
            float(contact.jacobian[1] @ change),
            abs(amount) * n,
            abs(amount) * t,
        )
    raise NoConsistentMode("an impulse along the friction cone changes no velocity of the contact")


def _sticking(snapshot: Snapshot, contact: PerContact) -> _Piece | None:
    solved = answer(snapshot, contact.jacobian, contact.jacobian, np.array([1.0, 0.0]))
    if solved is None:
        return None
    normal, tangential = map(float, solved[1])
    return _Piece("stick", solved[0], 1.0, 0.0, normal, tangential)
