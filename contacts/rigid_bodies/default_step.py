"""Default step size, from inscribed circles and the speeds that forces can reach.

A body moves little in a step, relative to the inscribed circle of its smallest convex piece, at the
speed of the scene, of free fall, or of its forces. Steps resolve the bounces on compliant contacts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import combinations

import numpy as np

from contacts.collision_detection.body_numbers import STIFFNESS, BodyNumbers
from contacts.dynamics.scales import Scales
from contacts.rigid_bodies.mechanics import Forces
from contacts.rigid_bodies.prescribed_motion import Paths
from statechart.arrays import Array

# Displacement in a step at the fastest speed, relative to the smallest inscribed radius; step
# relative to the time of free fall by half of that: 3e-4 s to 2e-3 s for the shipped heaps, which
# are written for 1e-3 s.
_CROSSED, _FALLEN = 0.1, 0.02
# Step relative to sqrt(m/k) of compliant contacts: an undamped bounce loses its square, 1 % of its
# energy. Stiff contacts shorten the step by the second factor at most.
_RESOLVED, _MAX_SHORTENING = 0.1, 30.0
# Instants of a run at which forces are evaluated.
_INSTANTS = 17
# Difference step of paths, relative to the run.
_SOON = 1e-6
# Round-off of the inscribed circle, relative to the polygon.
_STEP_ROUND_OFF = 1e-9


def inner_radii(numbers: BodyNumbers) -> Array:
    """Return the inscribed radius (b,) of the smallest piece of each body; inf without a shape."""
    pieces, kinds = numbers.pieces, numbers.kinds
    found = np.full(int(kinds.max(initial=-1)) + 1, np.inf)
    for kind, b in zip(*np.unique(kinds, return_index=True), strict=True):
        for p in range(pieces.begins[b], pieces.begins[b + 1]):
            radius = float(pieces.radii[p])
            corners = pieces.vertices[pieces.firsts[p] : pieces.firsts[p + 1]]
            found[kind] = min(found[kind], radius if radius > 0.0 else inscribed_radius(corners))
    radii: Array = found[kinds]
    return radii


def inscribed_radius(corners: Array) -> float:
    """Return the radius of the largest circle in a convex polygon (k, 2).

    It touches three edges.
    """
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([edges[:, 1], -edges[:, 0]], 1) / np.hypot(*edges.T)[:, None]
    bounds = (normals * corners).sum(axis=1)
    three = np.array(list(combinations(range(len(corners)), 3)))
    rows = np.concatenate([normals[three], np.ones((*three.shape, 1))], axis=2)
    regular = np.abs(np.linalg.det(rows)) > _STEP_ROUND_OFF
    circles = np.linalg.solve(rows[regular], bounds[three][regular][:, :, None])[:, :, 0]
    outside = circles @ np.column_stack([normals, np.ones(len(normals))]).T - bounds
    inside = (outside <= _STEP_ROUND_OFF * np.abs(edges).max()).all(axis=1)
    return float(circles[inside, 2].max())


def forced_speed(
    each: Iterable[Forces], numbers: BodyNumbers, state: Array, end: float, length: float
) -> float:
    """Return the largest speed that forces can give a point of a body in a run.

    An acceleration a gives at most ``a end``, ``a/d`` against damping d per mass, ``a/w`` against
    springs of frequency w, and, like gravity, ``sqrt(a length)``. `each` has the forces of every
    controller state; `end` may be infinite.
    """
    fastest, n = 0.0, numbers.inverse.size
    times = np.linspace(0.0, end, _INSTANTS) if math.isfinite(end) else np.zeros(1)
    for forces in each:
        if not len(forces.bodies):
            continue
        samples = forces.tape.table(np.tile(state, (len(times), 1)), forces.values, times)
        most = np.abs(samples).max(axis=0).reshape(-1, 3) * numbers.inverse[forces.bodies]
        stiff = forces.stiffness(numbers, 1.0, state, 0.0)
        # Springs on coordinates do not bound free bodies.
        own = (stiff.rows == stiff.columns) & (stiff.rows < 3 * numbers.free)
        springs, dampers = (
            np.bincount(stiff.rows[own], np.maximum(part[own], 0.0), minlength=n).reshape(-1, 3)
            for part in (stiff.places, 0.5 * stiff.rates)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            speeds = np.fmin(most * end, most / dampers[forces.bodies])
            speeds = np.fmin(speeds, most / np.sqrt(springs[forces.bodies]))
        straight = np.fmin(speeds[:, :2], np.sqrt(most[:, :2] * length))
        turning = speeds[:, 2] * numbers.sizes[forces.bodies]
        all_of = np.hypot(*straight.T) + np.where(np.isfinite(turning), turning, 0.0)
        fastest = max(fastest, float(all_of.max(where=np.isfinite(all_of), initial=0.0)))
    return fastest


def led_speed(
    paths: Paths, numbers: BodyNumbers, values: Array, remembered: Array, end: float
) -> float:
    """Return the largest speed of a point of a led body at sampled instants of a run."""
    first = len(numbers.inverse)
    sizes = numbers.sizes[first : first + paths.bodies]
    if not len(sizes):
        return 0.0
    whole = end if math.isfinite(end) and end > 0.0 else 1.0
    times, later = np.linspace(0.0, whole, _INSTANTS), _SOON * whole
    memories = np.tile(remembered, (_INSTANTS, 1))
    here, there = (
        paths.at(values, at, memories)[:, : paths.bodies] for at in (times, times + later)
    )
    rates = np.abs(there - here) / later
    speeds = np.hypot(rates[..., 0], rates[..., 1]) + sizes * rates[..., 2]
    return float(speeds.max(where=np.isfinite(speeds), initial=0.0))


def contact_frequency(numbers: BodyNumbers) -> float:
    """Return the largest sqrt(k/m) of compliant contacts, m the reduced mass of their bodies."""
    moving = numbers.kinds[: len(numbers.inverse)]
    lightest = np.zeros(numbers.laws.shape[1])
    np.maximum.at(lightest, moving, numbers.inverse[:, 0])
    stiffness = np.append(numbers.materials[:, STIFFNESS], 0.0)[numbers.laws]
    own = np.arange(len(stiffness))
    stiffness[own, own] *= np.bincount(numbers.kinds, minlength=len(own)) > 1  # it has a copy
    pairs = stiffness * (lightest[: len(stiffness), None] + lightest)
    return math.sqrt(float(pairs.max(initial=0.0)))


def default_step(numbers: BodyNumbers, scales: Scales, forced: float) -> float:
    """Return the default step size, rounded to a digit."""
    radius = float(inner_radii(numbers)[: len(numbers.inverse)].min())
    step = _CROSSED * radius / max(scales.speed, forced)
    gravity = math.hypot(*numbers.gravity)
    if gravity > 0.0:
        step = min(step, _FALLEN * math.sqrt(radius / gravity))
    frequency = contact_frequency(numbers)
    if frequency > 0.0:
        step = min(step, max(_RESOLVED / frequency, step / _MAX_SHORTENING))
    return float(f"{step:.0e}")
