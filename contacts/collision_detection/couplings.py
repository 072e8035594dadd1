"""Couplings of bodies with shapes, as rows of a step.

The tangential row is the slip; the normal row moves only the coupling's pad, whose load is the
impulse of the static limit: the friction law of coefficient 1 then bounds the couple by the limit.
"""

from __future__ import annotations

from contacts.collision_detection.active_contacts import ActiveContacts, restore_impulses, velocity
from contacts.collision_detection.body_numbers import (
    ALONG_X,
    TURN,
    BodyNumbers,
    WarmStart,
    first_joint_key,
)
from contacts.collision_detection.midpoint import LimitProgram, Midpoint
from contacts.collision_detection.surfaces import to_world
from statechart.arrays import Array
from statechart.kernels.jit import kernel

COUPLED = -2
"""In `ActiveContacts.laws`: the coupling 0; one less for each of the next."""

STATIC, KINETIC_LIMIT, ENABLED, DECLARED = range(4)
"""Columns of limits: bounds at rest and in motion of the couple over its lever, 0 where they have
no value or are negative; above 0 while it is enabled; the smaller bound as declared."""


@kernel
def read_limits(numbers: BodyNumbers, program: LimitProgram, values: Array, limits: Array) -> None:
    """Write the limits (c, 4) of couplings from the registers of their tape."""
    for c in range(len(limits)):
        for d in range(ENABLED + 1):
            limits[c, d] = values[program.outputs[3 * c + d], 0]
        static, kinetic = limits[c, STATIC], limits[c, KINETIC_LIMIT]
        # Without a value if one of them has none.
        limits[c, DECLARED] = min(static, kinetic) + 0.0 * (static + kinetic)
        for d in range(ENABLED):
            bound = limits[c, d] / numbers.couplings.levers[c]
            limits[c, d] = bound if bound > 0.0 else 0.0


@kernel
def _response(numbers: BodyNumbers, mid: Midpoint, b: int, row: Array) -> float:
    """Return the velocity along a row (3,) that a unit impulse along it gives to body b."""
    free, response = len(numbers.inverse) - numbers.links.bodies, 0.0
    if b < free:
        for d in range(3):
            response += row[d] * numbers.inverse[b, d] * row[d]
        return response
    gradients = mid.links.gradients[b - free]
    for j in range(numbers.links.size):
        for k in range(numbers.links.size):
            left = right = 0.0
            for d in range(3):
                left += row[d] * gradients[d, j]
                right += row[d] * gradients[d, k]
            response += left * mid.links.compliance[j, k] * right
    return response


@kernel
def _slip_row(
    numbers: BodyNumbers, c: int, mid: Midpoint, h: float, m: int, active: ActiveContacts
) -> float:
    """Write the slip of coupling c as the tangential row of contact m; return its response."""
    couplings, rows, response = numbers.couplings, active.rows[m, 1], 0.0
    for side in range(2):
        b, at = couplings.bodies[c, side], 3 * side
        sign = couplings.levers[c] * (1.0 - 2.0 * side)
        active.bodies[m, side] = b if b < len(numbers.inverse) else -1
        if b < 0:
            continue
        if couplings.holds[c] == TURN:
            rows[at + 2] = sign
        else:
            x, y = to_world(mid.poses[b], couplings.at[c, 0], couplings.at[c, 1])
            rx, ry = x - mid.poses[b, 0], y - mid.poses[b, 1]
            ux, uy = (1.0, 0.0) if couplings.holds[c] == ALONG_X else (0.0, 1.0)
            rows[at], rows[at + 1], rows[at + 2] = ux, uy, rx * uy - ry * ux
            # The point's acceleration towards the centre.
            active.bias[m, 1] = -0.5 * h * mid.old_rates[b, 2] ** 2 * (rx * ux + ry * uy)
        if active.bodies[m, side] >= 0:
            response += _response(numbers, mid, b, rows[at : at + 3])
        else:
            # A led body turns as prescribed.
            active.before[m, 1] += sign * mid.old_rates[b, 2]
            active.free[m, 1] += sign * mid.free_rates[b, 2]
            rows[at + 2] = 0.0
    active.before[m, 1] += velocity(active.bodies, active.rows, mid.old_rates, m, 1)
    active.free[m, 1] += velocity(active.bodies, active.rows, mid.free_rates, m, 1)
    return response if response > 0.0 else 1.0


@kernel
def add_couplings(
    numbers: BodyNumbers, limits: Array, warm: WarmStart, mid: Midpoint, h: float, count: int,
    active: ActiveContacts,
) -> int:  # fmt: skip
    """Append the couplings to the contacts of a step; return the number of rows.

    `limits` (c, 4) are those at its midpoint; see `STATIC`.
    """
    first, at_old, m = first_joint_key(numbers) + len(numbers.joints.kinds), 0, count
    for c in range(len(limits)):
        on, static = limits[c, ENABLED] > 0.0, limits[c, STATIC]
        for d in range(2):
            active.before[m, d] = active.free[m, d] = active.bias[m, d] = 0.0
            for k in range(6):
                active.rows[m, d, k] = 0.0
        while at_old < warm.n_contacts[0] and warm.keys[at_old, 0] < first + c:
            at_old += 1
        _, _, place = restore_impulses(warm, at_old, first + c, 0, h, m, active)
        active.keys[m, 0], active.keys[m, 1] = first + c, 0
        active.compliances[m] = _slip_row(numbers, c, mid, h, m, active)
        active.free[m, 0] = -active.compliances[m] * h * static if on else 0.0
        active.laws[m], active.rolling_roles[m], active.hit[m] = COUPLED - c, 0, False
        active.slip_directions[m] = 0
        if on and (place < 0 or warm.contacts[place, 9] != 0.0):
            slip = active.before[m, 1]
            if abs(slip) > active.levels[m, 2]:
                active.slip_directions[m] = 1 if slip > 0.0 else -1
        active.materials[m, 0], active.materials[m, 2] = 1.0, 0.0
        active.materials[m, 1] = bound_in(limits[c], active.slip_directions[m]) if on else 0.0
        for d in range(2):
            active.pushes[m, d] = active.pushes[m, d] if on else 0.0
        for k in range(4):
            active.levels[m, k] = active.levels[m, k] if k == 2 else 0.0
        m += 1
    return m


@kernel
def bound_in(limits: Array, way: int) -> float:
    """Return the bound of a couple that slips this `way`, or rests (0), relative to `STATIC`."""
    if way == 0:
        return 1.0
    return limits[KINETIC_LIMIT] / limits[STATIC] if limits[STATIC] > 0.0 else 0.0
