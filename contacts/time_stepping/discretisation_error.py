"""First-order discretisation error of a run, relative to its motion.

Sources: the force quadrature error, impacts that are at mid-step instead of at the touch, reversals
and ends of slips within a step, and the phase error of springs, compared with the largest speed and
the path length of each coordinate.
"""

from __future__ import annotations

import math
from copy import copy
from typing import NamedTuple

import numpy as np

from contacts.dynamics.scales import Scales
from contacts.solvers.dependence import USER_DIGITS
from contacts.solvers.step_impulses import coordinate_impulses, coordinate_rows, new_island
from contacts.states import PIN, SLIDE_MINUS, SLIDE_PLUS
from contacts.time_stepping.chunk import ORDERED, TIME_MARGIN, Chunk
from contacts.time_stepping.scene_tape import SteppedTape
from contacts.time_stepping.stability import Swings
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.time_stepper import DEFAULT_IMPULSES
from statechart.kernels.jit import kernel

# Speed and path, relative to the scene, below which a coordinate is at rest.
_LITTLE = 1e-3
# Relative velocity errors from which a warning is given: forces; impacts (a shipped model has a
# tenth at its own step); spring phase (half a radian of the fastest motion).
_FORCES, _IMPACTS, _PHASE = 0.1, 0.15, 0.5
# The same, relative to the path of a coordinate.
_WAY = 0.2


@kernel
def _impact_impulses(
    jacobians: Array, columns: Array, before: Array, cones: Array, restitution: Array,
    allowed: float,
) -> tuple[float, Array]:  # fmt: skip
    """Return the residual and the impulses (m, 2) of an impact in coordinates."""
    m, wanted = len(before), np.zeros((len(before), 2))
    for a in range(m):
        wanted[a, 0] = restitution[a] * min(before[a, 0], 0.0)
    island = new_island(np.arange(m), before, before.copy(), wanted)
    for a in range(m):
        island.rebounds[a] = restitution[a] > 0.0
    contacts = coordinate_rows(jacobians, columns, np.zeros(m), cones)
    residual, _ = coordinate_impulses(contacts, island, allowed)
    return residual, island.chosen


def velocity_change(
    mass: Array, held: Array, pushes: Array, velocities: Array, cones: Array, restitution: Array
) -> Array | None:
    """Return the change of rates (n,) by Moreau's impact law; None if it is not solved.

    Joints and pins hold the directions `held` (r, n). Struck contacts have Jacobians `pushes` (m,
    2, n), velocities (m, 2) before, cones (m, 2) and restitution (m,).
    """
    n, m, r = len(mass), len(pushes), len(held)
    rows = pushes.reshape(2 * m, n)
    system = np.zeros((n + r, n + r))
    system[:n, :n], system[n:, :n], system[:n, n:] = mass, held, held.T
    right = np.vstack([rows.T, np.zeros((r, 2 * m))])
    rate_change = np.linalg.lstsq(system, right, rcond=USER_DIGITS)[0][:n]
    columns, allowed = np.ascontiguousarray(rate_change.T), DEFAULT_IMPULSES.tolerance
    residual, impulses = _impact_impulses(pushes, columns, velocities, cones, restitution, allowed)
    change: Array = rate_change @ impulses.reshape(2 * m)
    return change if residual <= allowed and np.isfinite(change).all() else None


class Equations(NamedTuple):
    """Equations of the present controller states."""

    source: SteppedTape
    values: Array  # (p,): parameters.
    cones: Array  # shape (c, 2)
    restitution: Array  # shape (c,)


class DiscretisationError:
    """Accumulates the error estimates of a run."""

    def __init__(self, scales: Scales) -> None:
        n = len(scales.sizes) // 2
        self._sizes, self._hit, self._order = scales.sizes, 0.0, ""
        # Largest speeds and path lengths of coordinates.
        self._fastest, self._way = np.zeros(n), np.zeros(n)
        # Velocity errors of forces: now, largest.
        self._drift, self._drifted = np.zeros(n), np.zeros(n)
        # Velocity errors of impacts and springs; position errors of ended slips.
        self._velocity, self._phase, self._stopped = np.zeros(n), np.zeros(n), np.zeros(n)

    def copy(self) -> DiscretisationError:
        """Return a copy."""
        return copy(self)  # no array is changed in place

    def add(
        self, now: Equations, chunk: Chunk, start: float, codes: Ints, swings: Swings | None
    ) -> None:
        """Add the errors of steps from `start` on.

        `codes` (c,): previous modes of contacts; `swings`: oscillations of springs.
        """
        n, h = now.source.size, chunk.h
        rates = chunk.states[:, n : 2 * n]
        self._fastest = np.maximum(self._fastest, np.abs(rates).max(axis=0))
        self._way = self._way + np.abs(np.diff(chunk.states[:, :n], axis=0)).sum(axis=0)
        known = self._slips(now, chunk, start, codes)
        if now.source.limits.forces is not None:
            mass = now.source.equations(now.values, chunk.states[0], start).mass
            known = known + now.source.limits.missed(mass, now.values, start, h, chunk.states)
        drift = self._drift + np.cumsum(known, axis=0)
        self._drift, self._drifted = drift[-1], np.maximum(self._drifted, np.abs(drift).max(axis=0))
        struck: Bools = np.any(chunk.struck, axis=1)
        times = start + h * np.nonzero(struck)[0]
        # Others land where they touch.
        middle = np.any(chunk.struck & (chunk.region_delay >= -ORDERED * h), axis=1)
        for k in np.flatnonzero(middle).tolist():
            touches = _Touches.of(now, chunk, start, k)
            self._velocity = np.maximum(self._velocity, touches.velocity_error(now, h))
            self._order = self._order or touches.order_warning(now, h)
        spans = np.concatenate([[self._hit], times, [start + h * len(struck)]])
        self._hit = float(spans[-2])
        if swings is not None:
            off = swings.off(rates, ~struck, h, float(np.diff(spans).max()))
            self._phase = np.maximum(self._phase, off)

    def remarks(self, h: float) -> tuple[str, ...]:
        """Return warnings of large errors."""
        n = len(self._way)
        fastest = np.maximum(self._fastest, _LITTLE * self._sizes[n:])
        way = np.maximum(self._way, _LITTLE * self._sizes[:n])
        errors = (
            (self._drifted / fastest, _FORCES, 0.5,
             "the forces: velocity error up to {:.2g} of the largest"),
            (self._velocity / fastest, _IMPACTS, 1.0,
             "contacts that are switched on: impacts are off by up to {:.2g} of the largest "
             "velocity"),
            (self._phase / fastest, _PHASE, 0.5,
             "the springs: velocity error up to {:.2g} of the largest"),
            (np.abs(self._stopped) / way, _WAY, 0.5,
             "the ends of slips: position error up to {:.2g} of the way"),
        )  # fmt: skip
        warnings = [
            f"step {h:g} is too long for {error_text.format(error)}; take "
            f"{0.5 * h * (limit / error) ** power:.1g} or less"
            for relative, limit, power, error_text in errors
            if (error := float(relative.max(initial=0.0))) > limit
        ]
        return *warnings, *([self._order] if self._order else [])

    def _slips(self, now: Equations, chunk: Chunk, start: float, codes: Ints) -> Array:
        """Return the rate errors (k, n) where slips reverse; note where they end.

        Friction opposes the slip at the end of the step; before the reversal it had the other sign.
        """
        source, h = now.source, chunk.h
        n, errors = source.size, np.zeros((len(chunk.codes), source.size))
        before = np.vstack([codes, chunk.codes[:-1]])
        slid = (before == SLIDE_PLUS) | (before == SLIDE_MINUS)
        # A contact that slides at the start has no previous mode.
        slid[0] |= start == 0.0
        borne = (chunk.codes == PIN) | (chunk.codes == SLIDE_PLUS) | (chunk.codes == SLIDE_MINUS)
        turned = slid & borne & (before != chunk.codes) & ~chunk.struck
        for k, i in np.argwhere(turned).tolist():
            first = n + source.joint_rows + 2 * i
            normal, tangential = chunk.solved[k, first : first + 2].tolist()
            rows = source.equations(now.values, chunk.states[k], start + k * h)
            slip, push = rows.velocities[i, 1], rows.contacts[i, n : 2 * n]
            moved = np.linalg.pinv(rows.mass) @ push
            lightness = float(push @ moved)
            if slip == 0.0 or not lightness > 0.0:
                continue
            # If an impact hides the instant, take the middle.
            part, change = 0.5, 0.0
            cone_n, cone_t = rows.cones(now.cones)[i]
            if math.isfinite(normal) and cone_n > 0.0:
                friction = -math.copysign(cone_t / cone_n * normal, slip)
                change = friction - tangential
                rate = push @ (chunk.states[k + 1] - chunk.states[k])[n : 2 * n] / h
                rate += lightness * change
                part = min(1.0, -slip / (rate * h)) if rate * slip < 0.0 else 1.0
            if chunk.codes[k, i] == PIN:
                way = 0.5 * h * slip * (part - 1.0) * moved / lightness
                self._stopped = self._stopped + way
            else:
                errors[k] += moved * change * part * h
        return errors


class _Touches(NamedTuple):
    """Impacts of a step, whose contacts touch at different times before its middle."""

    struck: Ints  # (m,): contacts.
    ago: Array  # (m,): time since they touched.
    state: Array  # At mid-step, with the rates before the step.
    time: float
    mass: Array

    @classmethod
    def of(cls, now: Equations, chunk: Chunk, start: float, k: int) -> _Touches:
        """Return the impacts of step k."""
        n, h = now.source.size, chunk.h
        struck = np.flatnonzero(chunk.struck[k])
        state, time = chunk.states[k].copy(), start + (k + 0.5) * h
        state[:n] += 0.5 * h * state[n : 2 * n]
        rows = now.source.equations(now.values, state, time)
        gaps, nearing = rows.gaps[struck], -rows.velocities[struck, 0]
        ago = np.zeros(len(struck))
        np.divide(-gaps, nearing, out=ago, where=nearing > 0.0)
        return cls(struck, np.clip(ago, 0.0, h), state, time, rows.mass)

    def rates_after(self, now: Equations, apart: float) -> Array | None:
        """Return the rates (n,) after impacts in turn, at once if touches are less than `apart`."""
        n, state, since = now.source.size, self.state.copy(), 0.0
        for touch in np.flip(np.unique(self.ago)).tolist():
            if since and since - touch <= apart:
                continue
            state[:n] += (since - touch) * state[n : 2 * n]
            struck = self.struck[self.ago >= touch - apart]
            change = _impact(now, state, self.time - touch, struck)
            if change is None:
                return None
            state[n : 2 * n], since = state[n : 2 * n] + change, touch
        return state[n : 2 * n]

    def velocity_error(self, now: Equations, h: float) -> Array:
        """Return the velocity error (n,): impacts have another direction, speed and lever arm."""
        n = now.source.size
        late, right = _impact(now, self.state, self.time, self.struck), self.rates_after(now, h)
        if late is None or right is None:
            return np.zeros(n)
        return np.abs(self.state[n : 2 * n] + late - right)

    def order_warning(self, now: Equations, h: float) -> str:
        """Return a warning if impacts in turn would have another result; "" if not."""
        n, touches = now.source.size, np.unique(self.ago)
        apart = np.diff(touches)[np.diff(touches) > TIME_MARGIN * h]
        if not apart.size:
            return ""
        once, turns = self.rates_after(now, h), self.rates_after(now, TIME_MARGIN * h)
        if once is None or turns is None:
            return ""
        difference, rates = turns - once, self.state[n : 2 * n]
        change, energy = (float(v @ self.mass @ v) for v in (difference, rates))
        if change <= _IMPACTS**2 * energy:
            return ""
        names = " and ".join(now.source.names[i] for i in self.struck.tolist())
        return (
            f"{names} touch {apart.min():.2g} apart near t = {self.time:.6g}, and the step of "
            f"{h:g} strikes them at once: in turn, velocities differ by "
            f"{math.sqrt(change / energy):.2g} of those before; take {0.5 * apart.min():.1g} or "
            "less, or run with events"
        )


def _impact(now: Equations, state: Array, time: float, struck: Ints) -> Array | None:
    """Return the change of rates (n,) by impacts of these contacts at a state."""
    source = now.source
    n, rows = source.size, source.equations(now.values, state, time)
    mass, contacts, joints = rows
    if not (np.isfinite(mass).all() and np.isfinite(contacts).all() and np.isfinite(joints).all()):
        return None
    pinned = [contacts[source.held > 0, :n], contacts[source.held > 1, n : 2 * n]]
    return velocity_change(
        mass,
        np.concatenate([joints[:, :n], *pinned]),
        contacts[struck, : 2 * n].reshape(-1, 2, n),
        np.ascontiguousarray(rows.velocities[struck]),
        rows.cones(now.cones)[struck],
        now.restitution[struck],
    )
