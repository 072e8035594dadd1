"""Contact forces, modes and paradoxes of a time step."""

from __future__ import annotations

from contacts.states import PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array
from statechart.kernels.jit import part

# Velocities below this part of what they are sums of are zero.
ROUNDING = 1e-9


@part
def borne_mode(impulse: Array, slip: float, sliding: bool, cone: Array, directed: bool) -> int:
    """Return the number of the mode of a contact that bears an impulse.

    Parameters
    ----------
    impulse : (2,)
    slip : float
        After the step.
    sliding : bool
        Whether it slips under friction.
    cone : (2,)
    directed : bool
        Whether its slides have a direction, whatever the friction.
    """
    if cone[1] == 0.0 and not directed:
        return SLIDE
    if cone[1] == 0.0:
        sliding = slip != 0.0
    if not sliding:
        return PIN
    if slip != 0.0:
        return SLIDE_PLUS if slip > 0.0 else SLIDE_MINUS
    return SLIDE_PLUS if impulse[1] < 0.0 else SLIDE_MINUS


@part
def velocity_after(compliance: Array, least: Array, impulses: Array, a: int, d: int) -> float:
    """Return the velocity of contact `a` after a step, 0 where that is rounding.

    Parameters
    ----------
    compliance : (2 m, 2 m), least : (m, 2), impulses : (m, 2)
        Of the step's contact problem.
    a, d : int
        Which contact; 0 along its normal, 1 along its tangent.
    """
    after, terms = least[a, d], abs(least[a, d])
    for b in range(len(impulses)):
        for e in range(2):
            term = compliance[2 * a + d, 2 * b + e] * impulses[b, e]
            after += term
            terms += abs(term)
    return after if abs(after) > ROUNDING * terms else 0.0


@part
def pressing(compliance: Array, slip: float, cone: Array) -> bool:
    """Whether friction presses a sliding contact into its surface (Painleve's paradox)."""
    against = -cone[1] if slip > 0.0 else cone[1]
    return slip != 0.0 and compliance[0, 0] * cone[0] + compliance[0, 1] * against <= 0.0
