"""Whether every contact may be where, and move as, the initial state has it."""

from __future__ import annotations

from collections.abc import Sequence

from contacts.dynamics.contact_law import ContactLaw
from contacts.states import OFF
from statechart.errors import DeclarationProblem


def check_start(
    law: ContactLaw,
    moves: Sequence[float],
    depth: float,
    near: float,
    slow: float,
) -> None:
    """Refuse a contact that starts inside its surface, or free though it does not list that.

    Parameters
    ----------
    law : ContactLaw
    moves : sequence of float
        Gap, its rate and slip at the start, of a contact that is not off.
    depth : float
        A start may be inside by so much.
    near, slow : float
        Tolerances of gap and speed.

    Raises
    ------
    DeclarationProblem
        With what to do.
    """
    gap, gap_rate, slip = moves
    if gap < -depth:
        gated = f", or write modes: {{{law.name}: off}}" if OFF in law.states else ""
        raise DeclarationProblem(
            f"contact {law.name!r} starts inside its surface, {-gap:.6g} deep",
            advice=f"move the body out of the surface{gated}",
            loc=("contacts", law.name),
        )
    if "free" in law.states:
        return
    loc = ("contacts", law.name, "modes")
    if gap > near:
        raise DeclarationProblem(
            f"contact {law.name!r} starts {gap:.6g} off its surface, "
            "and free is not among its modes",
            advice="add free, or start the body on the surface",
            loc=loc,
        )
    if gap_rate > slow:
        raise DeclarationProblem(
            f"contact {law.name!r} starts leaving its surface at {gap_rate:.6g}, "
            "and free is not among its modes",
            advice="add free, or start the body along the surface",
            loc=loc,
        )
    if law.states == ("pin",) and abs(slip) > 2.0 * slow and gap_rate >= -slow:
        raise DeclarationProblem(
            f"contact {law.name!r} starts slipping at {slip:.6g}, and slide is not among its modes",
            advice="add slide, with a friction, or start its point at rest",
            loc=loc,
        )
