"""Smallest forces in cones with a given resultant (equal springs), by Newton's method on the dual.

The dual problem, ``min w P(w) - |P(w)|^2 / 2 - load y`` over displacements y, with ``w = J y`` and
P the projection on the cones, is convex and piecewise quadratic: Newton's method with line search
ends in finitely many steps if such forces exist, and diverges if not. A locked coupling has no
normal force, and an interval instead of a cone: ``|H| <= limit``.
"""

from __future__ import annotations

import numpy as np

from contacts.solvers.dependence import independent_rows
from contacts.solvers.mode_solver import dot
from contacts.solvers.saddle_point import SOLVED, largest_size, solve_refined
from statechart.arrays import Array, Ints
from statechart.kernels.copies import copy_counts
from statechart.kernels.jit import kernel

INSIDE, UPPER, LOWER, APEX = range(4)
"""Zone of ``w = J y``: inside the cone or the interval; nearest to its edge or end with H > 0, with
H < 0; nearest to its tip."""


# Regularisation where zones do not determine the displacement; a displacement beyond this multiple
# of the load shows that no forces carry it.
_DAMPING, _BEYOND = 1e-12, 1e9
_STEPS, _HALVINGS = 200, 120
# Slope along a step, relative to its start, that counts as zero.
_LEVEL = 1e-3
_FORCE_ROUND_OFF = 64 * 2.0**-52


@kernel
def _zone_of(w: Array, cone: Array, sliding: float) -> int:
    side = UPPER if w[1] > 0.0 else LOWER
    if cone[2] < np.inf:
        return side if abs(w[1]) > cone[2] else INSIDE
    if sliding != 0.0:
        # Sliding friction acts along one edge, against the slip.
        side = LOWER if sliding > 0.0 else UPPER
    elif cone[0] * abs(w[1]) <= cone[1] * w[0] and w[0] >= 0.0:
        # Without friction the first condition does not bound w_n.
        return INSIDE
    sign = 1.0 if side == UPPER else -1.0
    return side if cone[0] * w[0] + sign * cone[1] * w[1] >= 0.0 else APEX


@kernel
def _project_to_zone(zone: int, w: Array, cone: Array, force: Array) -> None:
    """Project `w` in its zone."""
    if zone == INSIDE:
        force[0], force[1] = w[0], w[1]
    elif cone[2] < np.inf:
        force[0], force[1] = 0.0, cone[2] if zone == UPPER else -cone[2]
    elif zone == APEX:
        force[0] = force[1] = 0.0
    else:
        edge = cone[1] if zone == UPPER else -cone[1]
        along = cone[0] * w[0] + edge * w[1]
        force[0], force[1] = cone[0] * along, edge * along


@kernel
def _apply_transpose(reach: Array, y: Array, w: Array) -> None:
    for g in range(len(reach)):
        for d in range(2):
            w[g, d] = 0.0
            for i in range(len(y)):
                w[g, d] += reach[g, d, i] * y[i]


@kernel
def _load_residual(reach: Array, forces: Array, load: Array) -> Array:
    residual = load.copy()
    for g in range(len(reach)):
        for d in range(2):
            for i in range(len(load)):
                residual[i] -= reach[g, d, i] * forces[g, d]
    return residual


@kernel
def _stiffness(reach: Array, zones: Ints, cones: Array) -> Array:
    size = reach.shape[2]
    result = np.zeros((size, size))
    response, bears = np.empty(2), np.empty(2)
    for g in range(len(reach)):
        if zones[g] != INSIDE and cones[g, 2] < np.inf:
            continue
        for k in range(size):
            response[0], response[1] = reach[g, 0, k], reach[g, 1, k]
            _project_to_zone(zones[g], response, cones[g], bears)
            for i in range(size):
                result[i, k] += reach[g, 0, i] * bears[0] + reach[g, 1, i] * bears[1]
    return result


@kernel
def _solve_zones(
    stiffness: Array, zones: Ints, cones: Array, reach: Array, load: Array, w: Array, forces: Array
) -> bool:
    """Solve for the forces in given zones, with refinement: the stiffness squares the condition."""
    size = len(load)
    y, step = np.zeros(size), np.empty(size)
    w[:] = 0.0
    for g in range(len(reach)):
        _project_to_zone(zones[g], w[g], cones[g], forces[g])
    residual = _load_residual(reach, forces, load)
    for _ in range(3):
        if solve_refined(stiffness.copy(), residual.copy(), step) != SOLVED:
            return False
        y += step
        _apply_transpose(reach, y, w)
        for g in range(len(reach)):
            _project_to_zone(zones[g], w[g], cones[g], forces[g])
        residual = _load_residual(reach, forces, load)
    return True


@kernel
def _evaluate_displacement(
    reach: Array, cones: Array, sliding: Array, load: Array, y: Array, w: Array, forces: Array
) -> Array:
    """Set `w` and `forces` to those of a displacement; return the residual of the load."""
    _apply_transpose(reach, y, w)
    for g in range(len(reach)):
        _project_to_zone(_zone_of(w[g], cones[g], sliding[g]), w[g], cones[g], forces[g])
    return _load_residual(reach, forces, load)


@kernel
def _step_length(
    reach: Array, cones: Array, sliding: Array, load: Array, y: Array, step: Array, w: Array,
    forces: Array,
) -> float:  # fmt: skip
    """Return the step length, up to 1, that minimises the dual function.

    Bisection of its slope, the residual of the load along the step, which falls monotonically.
    Where the slope jumps over zero (a kink at the end of a flat zone) the length is just beyond the
    kink, in the zones that follow.
    """
    level = _LEVEL * dot(_evaluate_displacement(reach, cones, sliding, load, y, w, forces), step)
    short, long, length = 0.0, 1.0, 1.0
    for _ in range(_HALVINGS):
        further = y + length * step
        slope = dot(_evaluate_displacement(reach, cones, sliding, load, further, w, forces), step)
        if abs(slope) <= level or (slope > 0.0 and length == 1.0):
            return length
        if slope > 0.0:
            short = length
        else:
            long = length
        length = 0.5 * (short + long)
    return long


@kernel
def _violation(zones: Ints, w: Array, cones: Array, sliding: Array) -> float:
    """Return the distance of the worst `w` outside its zone."""
    worst = -np.inf
    for g in range(len(zones)):
        n, t = cones[g, 0], cones[g, 1]
        sign = 1.0 if zones[g] == UPPER else -1.0
        if cones[g, 2] < np.inf:
            within = cones[g, 2] - (abs(w[g, 1]) if zones[g] == INSIDE else sign * w[g, 1])
            worst = max(worst, -within if zones[g] == INSIDE else within)
            continue
        if sliding[g] != 0.0:
            sign = -1.0 if sliding[g] > 0.0 else 1.0
        along = n * w[g, 0] + sign * t * w[g, 1]
        if zones[g] == INSIDE:
            worst = max(worst, n * abs(w[g, 1]) - t * w[g, 0])
            worst = max(worst, -w[g, 0]) if t == 0.0 else worst
        elif zones[g] == APEX:
            worst = max(worst, along if sliding[g] != 0.0 else n * w[g, 0] + t * abs(w[g, 1]))
        else:
            worst = max(worst, -along)
            if sliding[g] == 0.0:
                worst = max(worst, t * w[g, 0] - sign * n * w[g, 1])
    return worst


@kernel
def _release_edges(scaled: Array, zones: Ints, cones: Array, sliding: Array, first: int) -> bool:
    """Move contacts, from `first` on, from edges into cones until the displacement is determined.

    Forces on the edges of all cones, as those of a disc in a groove, leave a range of
    displacements; at its ends one of them is also inside its cone.
    """
    count, size = len(zones), scaled.shape[2]
    known = independent_rows(_stiffness(scaled, zones, cones))[0]
    for k in range(count):
        g = (first + k) % count
        zone = zones[g]
        if known < size and sliding[g] == 0.0 and UPPER <= zone <= LOWER:
            zones[g] = INSIDE
            more = independent_rows(_stiffness(scaled, zones, cones))[0]
            if more > known:
                known = more
            else:
                zones[g] = zone
    return known == size


@kernel
def _zones_agree(
    zones: Ints, wider: Array, scaled: Array, sliding: Array, pushed: Array, w: Array, forces: Array
) -> float:
    """Solve for the forces in zones; return their size if they lie there, 0 if not."""
    stiffness = _stiffness(scaled, zones, wider)
    if not _solve_zones(stiffness, zones, wider, scaled, pushed, w, forces):
        return 0.0
    own, error, largest = np.empty(2), 0.0, largest_size(pushed)
    for g in range(len(zones)):
        _project_to_zone(_zone_of(w[g], wider[g], sliding[g]), w[g], wider[g], own)
        for d in range(2):
            error = max(error, abs(own[d] - forces[g, d]))
            largest = max(largest, abs(w[g, d]))
    return largest if error <= _FORCE_ROUND_OFF * largest else 0.0


@kernel
def smallest_forces(
    cones: Array, sliding: Array, reach: Array, load: Array, inward: float
) -> tuple[bool, Array, Ints, float]:
    """Return the smallest forces in the cones with ``sum reach^T force = load``.

    Parameters
    ----------
    cones : (g, 3) array
        Unit edges, and infinity or the limit of a locked coupling.
    sliding : (g,) array
        0: the whole cone; +1 or -1: the edge that opposes this slip.
    reach : (g, 2, r) array
    load : (r,) array
    inward : float
        Sum of forces added inside the cones, and to the limits, while zones are identified.

    Returns
    -------
    exists : bool
        Whether there are such forces.
    forces : (g, 2), zones : (g,)
    violation : float
        Distance of the worst contact outside its zone; <= 0: none.
    """
    count, size = len(cones), len(load)
    scaled = reach.copy()
    right, pushed = load.copy(), load.copy()
    for i in range(size):
        largest = 0.0
        for g in range(count):
            largest = max(largest, abs(reach[g, 0, i]), abs(reach[g, 1, i]))
        scale = 1.0 / largest
        for g in range(count):
            scaled[g, 0, i] *= scale
            scaled[g, 1, i] *= scale
        right[i] *= scale
        pushed[i] = right[i]
    zones, wider = np.empty(count, np.int64), cones.copy()
    for g in range(count):
        wider[g, 2] += inward
        if cones[g, 2] < np.inf:
            zones[g] = INSIDE
            continue
        sign = -sliding[g] if sliding[g] != 0.0 else 0.0
        n, t = (cones[g, 0], sign * cones[g, 1]) if sign != 0.0 else (1.0, 0.0)
        zones[g] = INSIDE if sign == 0.0 else UPPER if sign > 0.0 else LOWER
        for i in range(size):
            pushed[i] += inward / count * (n * scaled[g, 0, i] + t * scaled[g, 1, i])
    w, forces = np.empty((count, 2)), np.zeros((count, 2))
    size_of_load = largest_size(pushed)
    if size_of_load == 0.0:
        return True, forces, zones, 0.0
    y, step = np.zeros(size), np.empty(size)
    for _ in range(_STEPS):
        stiffness = _stiffness(scaled, zones, cones)
        determined = independent_rows(stiffness)[0] == size
        largest, current = 0.0, zones.copy()
        if determined:
            largest = _zones_agree(zones, wider, scaled, sliding, pushed, w, forces)
        first = count if determined else 0
        while largest == 0.0 and first < count:
            copy_counts(current, zones)
            if _release_edges(scaled, zones, cones, sliding, first):
                largest = _zones_agree(zones, wider, scaled, sliding, pushed, w, forces)
            first += 1
        if largest > 0.0:
            if not _solve_zones(
                _stiffness(scaled, zones, cones), zones, cones, scaled, right, w, forces
            ):
                return False, forces, zones, np.inf
            violation = _violation(zones, w, cones, sliding)
            if abs(violation) <= _FORCE_ROUND_OFF * largest:
                violation = 0.0
            return True, forces, zones, violation
        copy_counts(current, zones)
        residual = _evaluate_displacement(scaled, wider, sliding, pushed, y, w, forces)
        for i in range(size):
            stiffness[i, i] += _DAMPING
        if solve_refined(stiffness, residual.copy(), step) != SOLVED:
            return False, forces, zones, np.inf
        length = _step_length(scaled, wider, sliding, pushed, y, step, w, forces)
        y += length * step
        _apply_transpose(scaled, y, w)
        if largest_size(y) > _BEYOND * size_of_load:
            return False, forces, zones, np.inf
        for g in range(count):
            zones[g] = _zone_of(w[g], wider[g], sliding[g])
    return False, forces, zones, np.inf
