"""One contact's frictional impact: Routh's path, ended by a restitution law.

The impulse grows along the edge of the friction cone while the point slips, and along the sticking
direction while it sticks. Velocities are affine in the impulse on each segment, so that the few
segments of a path are computed in closed form. Restitution is Stronge's (energetic: the work of the
normal impulse in restitution is e^2 of that in compression; energy never grows), Poisson's
(impulse) or Newton's (velocity, also for the jams of contacts with Moreau's law). Slip has the
kinetic coefficient at the slip before the impact, sticking the static one. Routh 1905; Stronge,
Proc. R. Soc. A 431 (1990); Wang and Mason 1992.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from contacts.dynamics import snapshot as numbers
from contacts.dynamics.contact_law import ContactLaw, cones
from contacts.dynamics.snapshot import Snapshot
from contacts.scene.parts import MOREAU
from contacts.solvers.mode_solver import dot
from contacts.solvers.saddle_point import INEXACT, SOLVED, saddle
from statechart.arrays import Array
from statechart.errors import NoConsistentMode, SingularMode
from statechart.kernels.jit import kernel

ENDED, RAISED, WEDGED, ENDLESS, POWERLESS, UNSOLVED = range(6)
"""Status of a path: complete, complete with an energy that it raised, wedged while pushed on by a
joint, without an end, without effect on the contact's velocity, numerically unsolved."""

NEWTON, POISSON, STRONGE = range(3)
"""Kinds of restitution."""

SLIP, SLIP_PLUS, SLIP_MINUS, STICK, WEDGE = range(1, 6)
"""Segments of a path; its code has a digit of base 8 for each, the first one the lowest."""

MEANINGS: Mapping[str, int] = {
    "newton": NEWTON,
    MOREAU: NEWTON,
    "poisson": POISSON,
    "stronge": STRONGE,
}
"""Impact law of a contact -> kind of restitution."""
_SEGMENTS = {SLIP: "slip", SLIP_PLUS: "slip+", SLIP_MINUS: "slip-", STICK: "stick", WEDGE: "wedge"}

_MAX_SEGMENTS = 8
# Relative work of an impact above which it raises the energy.
_RAISES = 1e-9
# Errors of a rate below this part of its terms are not corrected.
_PATH_ROUND_OFF = 8 * 2.0**-52


@kernel
def _unit_impulse(
    mass: Array, jacobian: Array, n: float, t: float, change: Array
) -> tuple[int, float, float, float, float]:
    """Return the impulse along (n, t) scaled to a unit change of normal velocity.

    If it does not change that (a particle with infinite friction), to a unit change of slip.
    Returns a status, the rates of both velocities, and the impulse.
    """
    size = len(change)
    right, unit, column = np.zeros(size), np.ones(1), np.empty((1, size))
    for i in range(size):
        column[0, i] = n * jacobian[0, i] + t * jacobian[1, i]
    for direction in range(2):
        status, x = saddle(mass, right, jacobian[direction : direction + 1], column, unit)
        if status == INEXACT:
            return UNSOLVED, 0.0, 0.0, 0.0, 0.0
        if status != SOLVED:
            continue
        # In Painleve's case the impulse increases the approach velocity.
        amount = x[size]
        forwards = 1.0 if amount >= 0.0 else -1.0
        for i in range(size):
            change[i] = forwards * x[i]
        u_n = forwards if direction == 0 else 0.0
        return ENDED, u_n, dot(jacobian[1], change), abs(amount) * n, abs(amount) * t
    return POWERLESS, 0.0, 0.0, 0.0, 0.0


@kernel
def _guided(jacobian: Array) -> bool:
    for i in range(jacobian.shape[1]):
        if abs(jacobian[1, i]) > _PATH_ROUND_OFF * abs(jacobian[0, i]):
            return False
    return True


@kernel
def _next_segment(
    mass: Array, jacobian: Array, cone: Array, u_t: float, change: Array
) -> tuple[int, int, float, float, float, float]:
    """Compute the next segment; `WEDGE` if friction prevents every motion."""
    cone_n, cone_t = cone[0], cone[1]
    if cone_t == 0.0 or (u_t == 0.0 and _guided(jacobian)):
        status, un, ut, normal, tangential = _unit_impulse(mass, jacobian, cone_n, 0.0, change)
        return status, SLIP, un, ut, normal, tangential
    if u_t == 0.0:
        size = len(change)
        status, x = saddle(mass, np.zeros(size), jacobian, jacobian, np.array([1.0, 0.0]))
        if status == INEXACT:
            return UNSOLVED, STICK, 0.0, 0.0, 0.0, 0.0
        if status == SOLVED and cone_n * abs(x[size + 1]) <= cone_t * x[size]:
            for i in range(size):
                change[i] = x[i]
            return ENDED, STICK, 1.0, 0.0, x[size], x[size + 1]
    for sign in (1.0, -1.0):
        if u_t * sign < 0.0:
            continue
        at = 2 if sign > 0.0 else 4
        n, t = cone[at], -sign * cone[at + 1]
        status, un, ut, normal, tangential = _unit_impulse(mass, jacobian, n, t, change)
        if status != ENDED or u_t != 0.0 or sign * ut > 0.0:
            return status, SLIP_PLUS if sign > 0.0 else SLIP_MINUS, un, ut, normal, tangential
    return ENDED, WEDGE, 0.0, 0.0, 0.0, 0.0


@kernel
def _energetic(rate: float, normal: float, u_n: float, missing: float) -> float:
    """Solve ``normal (u_n s + u_n' s^2 / 2) = left`` for s >= 0."""
    if missing <= 0.0 or normal <= 0.0:
        return 0.0
    # Divided by the impulse, whose square overflows at masses above 1e154.
    share = missing / normal
    discriminant = u_n * u_n + 2.0 * rate * share
    root = math.sqrt(discriminant) if discriminant > 0.0 else 0.0
    return 2.0 * share / (u_n + root) if u_n + root > 0.0 else math.inf


@kernel
def solve_impact(
    mass: Array,
    jacobian: Array,
    rates: tuple[float, float],
    cone: Array,
    meaning: int,
    restitution: float,
    braking: bool,
    velocity: Array,
) -> tuple[int, float, float, int, float, float]:
    """Compute the impact of one contact along Routh's path.

    Inputs are mass (n, n) and jacobian (2, n); `rates` of the gap and along the surface; unit edges
    `cone` (6,) at rest, in slip+ and in slip-; `meaning` NEWTON, POISSON or STRONGE. If `braking`,
    slip is stopped first, although the contact does not approach. Updates `velocity` (n,). Returns
    a status, the normal and tangential impulse on the body, the code of the path, and the rates of
    the gap and along the surface at its end.
    """
    size = len(velocity)
    before, change = velocity.copy(), np.empty(len(velocity))
    approach, slip = rates
    u_n, u_t = rates
    normal = tangential = work = total_work = 0.0
    compressed, stored, compressing = 0.0, 0.0, True
    path, segments, last_segment = 0, 0, 0
    for _ in range(_MAX_SEGMENTS):
        status, name, un, ut, pn, pt = _next_segment(mass, jacobian, cone, u_t, change)
        if status != ENDED:
            break
        terms = 0.0
        for i in range(size):
            terms += abs(jacobian[0, i]) * (abs(velocity[i]) + abs(before[i]))
        if name != last_segment:
            path += name << 3 * segments
            segments, last_segment = segments + 1, name
        if name == WEDGE:
            # With one degree of freedom both velocities vanish at once; friction may then prevent
            # the rebound.
            pushed_on = u_n < -_PATH_ROUND_OFF * terms
            status = WEDGED if pushed_on else ENDED
            break
        status = ENDLESS
        to_stop = -u_t / ut if u_t * ut < 0.0 else math.inf
        if braking and u_t != 0.0:
            to_end = math.inf
        elif compressing:
            to_end = max(-u_n / un, 0.0) if un > 0.0 else math.inf
        elif meaning == NEWTON:
            to_end = (-restitution * approach - u_n) / un if un > 0.0 else math.inf
        elif meaning == POISSON:
            missing_impulse = (1.0 + restitution) * compressed - normal
            to_end = missing_impulse / pn if pn > 0.0 else 0.0
        else:
            to_end = _energetic(un, pn, u_n, restitution * restitution * stored - work)
        length = min(to_stop, to_end)
        if not length < math.inf:
            break
        normal_work = pn * length * (u_n + 0.5 * un * length)
        work += normal_work
        total_work += normal_work + pt * length * (u_t + 0.5 * ut * length)
        for i in range(size):
            velocity[i] += change[i] * length
        normal += pn * length
        tangential += pt * length
        u_n = 0.0 if compressing and to_end <= to_stop else u_n + un * length
        u_t = 0.0 if to_stop <= to_end else u_t + ut * length
        if to_end <= to_stop:
            if not compressing or restitution == 0.0:
                # Correct the round-off of segments that cancel.
                terms = change_of_gap_rate = 0.0
                for i in range(size):
                    terms += abs(jacobian[0, i]) * (abs(velocity[i]) + abs(before[i]))
                    change_of_gap_rate += jacobian[0, i] * (velocity[i] - before[i])
                residual = u_n - (approach + change_of_gap_rate)
                if abs(residual) > _PATH_ROUND_OFF * terms:
                    for i in range(size):
                        velocity[i] += change[i] * un * residual
                    normal += pn * un * residual
                    tangential += pt * un * residual
                status = ENDED
                break
            compressing, compressed = False, normal
            stored, work = -work, 0.0
    if status == ENDED and total_work > _RAISES * (normal * abs(approach) + abs(tangential * slip)):
        status = RAISED
    return status, normal, tangential, path, u_n, u_t


@dataclass(frozen=True, eq=False)
class Impact:
    """Result of an impact: the rates (n,) after it, the impulse on the body, and its path.

    Segments of the path are slip, slip+, slip-, stick, and wedge if friction stops the point.
    """

    velocity: Array
    normal: float
    tangential: float
    path: tuple[str, ...]
    raises_energy: bool = False


def impact(
    snapshot: Snapshot, place: int, law: ContactLaw, restitution: float, *, braking: bool = False
) -> Impact:
    """Return the outcome of an impact at the contact of this index, the only closed one.

    With `braking` slip is stopped first, though the contact does not approach (see
    `contacts.impacts.jamming`).

    Raises `NoConsistentMode` if the path does not end (possible only on the Painleve boundary), or
    if a driven joint pushes on a wedged point. Raises `SingularMode` if a segment cannot be solved
    to 1e-8.
    """
    velocity, contact = snapshot.velocity.copy(), snapshot.contacts[place]
    status, normal, tangential, code, u_n, u_t = solve_impact(
        np.ascontiguousarray(snapshot.mass),
        np.ascontiguousarray(snapshot.jacobians[place]),
        (0.0 if braking else contact.gap_rate, contact.slip),
        cones([law], [contact])[0],
        MEANINGS[law.impact],
        restitution,
        braking,
        velocity,
    )
    path = segment_names(code)
    if status in (ENDED, RAISED):
        return Impact(velocity, normal, tangential, path, status == RAISED)
    if status == UNSOLVED:
        raise SingularMode(numbers.INEXACT_SYSTEM)
    reasons = {
        WEDGED: f"{law.name}: the impact wedges the point: it cannot slip either way, and is "
        f"driven into its surface at {-u_n:.3g}",
        ENDLESS: f"{law.name}: the impact's path does not end (approach {-u_n:.3g}, slip "
        f"{u_t:.3g}); it went {', '.join(path)}",
        POWERLESS: "no impulse changes the velocity of the contact: joints or prescribed motions "
        "hold its body; let a spring or a rope give way",
    }
    raise NoConsistentMode(reasons[status])


def segment_names(code: int) -> tuple[str, ...]:
    """Return the names of a path's segments."""
    names = []
    while code:
        names.append(_SEGMENTS[code & 7])
        code >>= 3
    return tuple(names)
