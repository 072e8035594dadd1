"""Compiled time steps of many free bodies that collide.

The scheme is that of `contacts.time_stepping.scene_step`. The mass matrix is diagonal; islands of
bodies in contact have separate contact problems, solved by `contacts.solvers.island_impulses`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.active_contacts import RESISTS, ActiveContacts, velocity
from contacts.collision_detection.body_numbers import (
    BOTH,
    GREATEST,
    ROPE,
    WARM_START_COLUMNS,
    BodyNumbers,
    WarmStart,
)
from contacts.collision_detection.couplings import (
    DECLARED,
    ENABLED,
    add_couplings,
    read_limits,
)
from contacts.collision_detection.find_contacts import DetectionResult, find_contacts
from contacts.collision_detection.joints import OFF, add_joints, is_bound, joint_forces
from contacts.collision_detection.midpoint import (
    Midpoint,
    Prescribed,
    apply_forces,
    fastest_turn,
    move_to_midpoint,
    place_links,
    run_at,
    write_linked_rates,
)
from contacts.rigid_bodies.body_modes import finish_settling, settle_bodies, unsettle_bodies
from contacts.rigid_bodies.island_step import PLASTIC, apply_row_impulse, solve_islands
from contacts.rigid_bodies.workspace import Workspace
from contacts.solvers.contact_rows import GUIDED, HELD
from contacts.solvers.impulse_coupling import root
from contacts.states import FREE, LOCKED, OPEN_CODE, PIN, SLIDE, SLIP_MINUS, SLIP_PLUS
from contacts.time_stepping.chunk import (
    BAD_INERTIA,
    COARSE,
    DONE,
    FULL,
    NOT_FINITE,
    TIME_MARGIN,
    Chunk,
)
from statechart.arrays import Array
from statechart.kernels.copies import copy_numbers, copy_rows
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import BLOCK, allocate_registers

# Latest impact after the middle of the step, relative to the step: some time must follow it.
_LATEST = 0.5 - TIME_MARGIN
# Round-off of velocities, relative to the fastest approach.
_SPEED_ROUND_OFF = 1e-6
# Round-off of the slip of a coupling, relative to its terms.
_COUPLING_ROUND_OFF = 1e-13
# Displacement in a step, relative to the smallest body, below which no body passes another or is
# deep in it.
_FAR = 0.1
LEAST = 1e-9
"""Round-off of impulses, relative to the largest on a body, at any tolerance."""


class StepOptions(NamedTuple):
    """Options of a run: impact law, whether forces are recorded, and bounds of a step.

    A step is rejected with status `COARSE` if it closes a gap larger than `deepest`, if bodies pass
    or sink into each other or turn by more than half a turn, or if joints stay open; so is the step
    before it if its second half shows that. Infinite: all steps are accepted.
    """

    law: int = PLASTIC  # See `contacts.rigid_bodies.island_step`.
    forces: bool = False
    allowed: float = math.inf  # Residual of impulses.
    deepest: float = math.inf


@kernel
def _store(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, detected: DetectionResult,
    allowed: float, rates: Array, k: int, chunk: Chunk,
) -> None:  # fmt: skip
    """Store a step's contacts in the warm start, and write the modes and impulses of bodies."""
    active, pressed = space.active, space.pressed
    fall = math.hypot(numbers.gravity[0], numbers.gravity[1]) * chunk.h
    for b in range(len(numbers.inverse)):
        chunk.gaps[k, b] = space.mid.gaps[b]
        chunk.struck[k, b] = False
        chunk.codes[k, b] = FREE
        space.borne[b] = 0.0
        chunk.impulses[k, b, 0] = chunk.impulses[k, b, 1] = 0.0
    chunk.approach[k], chunk.closing[k] = max(detected.approach, detected.turned), detected.closing
    chunk.passed[k] = detected.passed
    warm.n_contacts[0] = detected.contacts
    warm.last_step[0], warm.last_step[1] = chunk.h, max(warm.last_step[1], detected.approach)
    warm.last_step[2] = max(warm.last_step[2], chunk.h * detected.approach)
    for i in range(detected.contacts):
        for side in range(2):
            b = active.bodies[i, side]
            if b >= 0 and not space.bounces[i]:
                space.borne[b] = max(space.borne[b], pressed[i, 0])
    threshold = max(allowed, LEAST)
    for i in range(detected.contacts):
        pn, pt = pressed[i]
        lasts = pn > 0.0 and not space.bounces[i]
        warm.keys[i, 0], warm.keys[i, 1] = active.keys[i]
        closed = 0.0 if active.hit[i] else -1.0
        warm.contacts[i, 0] = active.levels[i, 0]
        warm.contacts[i, 1] = 1.0 if lasts else closed
        warm.contacts[i, 2], warm.contacts[i, 3] = active.pushes[i]
        for d in range(2):
            pushed_by = velocity(active.bodies, active.rows, rates, i, d)
            pushed_by -= velocity(active.bodies, active.rows, space.mid.free_rates, i, d)
            warm.contacts[i, 4 + d] = active.free[i, d] + pushed_by
            warm.contacts[i, 6 + d] = active.rows[i, 0, d]
        if lasts and not active.hit[i]:
            chunk.closing[k] = max(chunk.closing[k], active.levels[i, 1])
        slip = warm.contacts[i, 5] + active.bias[i, 1]
        none = max(space.known[i], active.levels[i, 2], allowed * fall)
        warm.contacts[i, 8] = space.known[i]
        warm.contacts[i, 9] = 1.0 if active.slip_directions[i] != 0 else 0.0
        resists = active.rolling_roles[i] == RESISTS
        sticks = active.materials[i, 1] > 0.0 and abs(slip) <= none and not resists
        for side in range(2):
            b = active.bodies[i, side]
            if b < 0:
                continue
            if active.hit[i] and pn > 0.0:
                chunk.struck[k, b] = True
                chunk.impulses[k, b, 0] += pn
                if resists:
                    turned = active.rows[i, 1, 3 * side + 2] * pt
                    column = joint_forces(numbers) + b - chunk.joint_impulses.shape[1]
                    chunk.joint_impulses[k, column] += turned
                    chunk.impact_delay[k, column] = chunk.impact_delay[k, b]
                else:
                    chunk.impulses[k, b, 1] += pt if side == 0 else -pt
            # An impulse below this part of the largest on its body is round-off, no contact.
            pulled = space.mid.force_speed[b] / numbers.inverse[b, 0]
            bears = lasts and pn > max(threshold * space.borne[b], LEAST * pulled)
            if bears and sticks:
                chunk.codes[k, b] = PIN
            elif bears and chunk.codes[k, b] == FREE:
                chunk.codes[k, b] = SLIDE


@kernel
def _may_land(active: ActiveContacts, law: int, i: int) -> bool:
    """Return whether the impact of contact i can be delayed beyond mid-step."""
    return active.levels[i, 1] > 0.0 and (active.materials[i, 2] == 0.0 or law == PLASTIC)


@kernel
def _any_lands(active: ActiveContacts, law: int, count: int) -> bool:
    """Return whether an impact of the step can be delayed beyond mid-step."""
    any_lands = False
    for i in range(count):
        any_lands = any_lands or (active.hit[i] and _may_land(active, law, i))
    return any_lands


@kernel
def _without_impacts(
    numbers: BodyNumbers, active: ActiveContacts, mid: Midpoint, count: int, early: Array
) -> None:
    """Write rates under forces, with the contact forces of the previous step.

    Solving for these would take a quarter of a run with continual landings.
    """
    copy_rows(mid.free_rates, early)
    for i in range(count):
        for d in range(2):
            if not active.hit[i] and active.pushes[i, d] != 0.0:
                apply_row_impulse(numbers, active, mid, early, i, d, active.pushes[i, d])
    write_linked_rates(numbers, mid, early)


@kernel
def _write_delays(
    space: Workspace, law: int, rates: Array, early: Array, h: float, slight: float, count: int,
    delays: Array,
) -> None:  # fmt: skip
    """Write the delays (b,) of the first touch of landings after mid-step in the islands of bodies.

    It is 0 without an impact. Forces alone give the rates `early`. Lasting contacts
    and joints continue, up to the speed `slight`; contacts may slip, or rest until the impact
    opens them, and joints that are off may move. Delayed impulses keep the energy bound
    (`contacts.time_stepping.stepper`). Earlier ones, of penetrating contacts, do not, and would
    move bodies farther than detection covers.
    """
    active, parents = space.active, space.parents
    for b in range(len(delays)):
        delays[b] = -1.0
    for i in range(count):
        island = root(parents, active.bodies[i, 0])
        if active.hit[i] and not _may_land(active, law, i):
            delays[island] = 0.0
        elif active.hit[i] and delays[island] < 0.0:
            delays[island] = _LATEST * h
    for i in range(count):
        island = root(parents, active.bodies[i, 0])
        first = delays[island]
        holds = active.materials[i, 0] in (HELD, GUIDED) or active.compliances[i] > 0.0
        for d in range(2 if first > 0.0 else 0):
            change = velocity(active.bodies, active.rows, rates, i, d)
            change -= velocity(active.bodies, active.rows, early, i, d)
            if not active.hit[i]:
                until = velocity(active.bodies, active.rows, early, i, d) + active.free[i, d]
                until -= velocity(active.bodies, active.rows, space.mid.free_rates, i, d)
                opens = not holds and change > 0.0 and until + active.bias[i, d] >= -slight
                bound = holds or (d == 0 and active.bias[i, 0] < OFF)
                if bound and abs(change) > slight and not opens:
                    delays[island] = 0.0
            elif space.bounces[i] != 0:
                delays[island] = 0.0
            elif d == 0 and active.levels[i, 1] < change * first:
                delays[island] = active.levels[i, 1] / change
    for b in range(len(delays)):
        delays[b] = max(delays[root(parents, b)], 0.0)


@kernel
def _store_joints(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, first: int, k: int, rates: Array,
    chunk: Chunk,
) -> None:  # fmt: skip
    """Store the impulses of joints, behind the contacts, in the warm start, and write their forces.

    And the energy that they add beyond the bound of the scheme; see `RigidBodyRun`.
    """
    holds, active, mid, links = numbers.joints.kinds, space.active, space.mid, numbers.links
    n = 3 * (len(numbers.inverse) - links.bodies) + links.size
    at = n
    for b in range(len(numbers.inverse)):
        space.local[b] = 0
    for j in range(len(holds)):
        i = first + j
        for side in range(2):
            b = active.bodies[i, side]
            if b < 0 or space.local[b] == 1:
                continue
            space.local[b] = 1
            for d in range(3):
                pulled = mid.free_rates[b, d] - mid.old_rates[b, d]
                chunk.energy_gain[k] -= 0.125 * pulled**2 / numbers.inverse[b, d]
        warm.keys[i, 0], warm.keys[i, 1] = active.keys[i]
        for d in range(2):
            both = active.before[i, d] + active.free[i, d]
            both += velocity(active.bodies, active.rows, rates, i, d)
            both -= velocity(active.bodies, active.rows, mid.free_rates, i, d)
            chunk.energy_gain[k] += 0.5 * space.pressed[i, d] * both
        # As for contacts: target gap, whether it lasts; and whether the joint is closed.
        lasts = space.pressed[i, 0] > 0.0 and not space.bounces[i]
        bounds, closed = is_bound(holds[j]), 0.0 if active.hit[i] else -1.0
        warm.contacts[i, 0] = active.levels[i, 0]
        warm.contacts[i, 1] = 1.0 if lasts or not bounds else closed
        warm.contacts[i, 9] = 1.0 if numbers.joints.on[numbers.joints.owners[j]] else 0.0
        for d in range(2):
            warm.contacts[i, 2 + d] = active.pushes[i, d]
            warm.contacts[i, 4 + d] = active.open_by[i, d]
            force = space.steady[i, d] / chunk.h
            impact = space.pressed[i, d] - space.steady[i, d]
            if holds[j] == GREATEST and d == 0:
                # Both limits share one torque.
                chunk.solved[k, at - 1] -= force
                chunk.joint_impulses[k, at - 1 - n] -= impact
            elif d == 0 or holds[j] in (BOTH, ROPE):
                chunk.solved[k, at], chunk.joint_impulses[k, at - n] = force, impact
                delay = chunk.impact_delay[k, active.bodies[i, 0]]
                chunk.impact_delay[k, chunk.codes.shape[1] + at] = delay
                at += 1
    if space.joint_energy[0] > 0.0:
        # The work of all impulses is bounded: wedged contacts absorb the energy of joints.
        chunk.energy_gain[k] = 0.0
    warm.n_contacts[0] = first + len(holds)


@kernel
def _store_couplings(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, first: int, k: int, rates: Array,
    chunk: Chunk,
) -> None:  # fmt: skip
    """Store the couplings, behind the joints, in the warm start; write their modes and couples."""
    active, bodies, signs = space.active, len(numbers.inverse), numbers.couplings.signs
    levers, limits = numbers.couplings.levers, space.limits
    # Controls fill the rest.
    at = 3 * (bodies - numbers.links.bodies) + numbers.links.size + joint_forces(numbers)
    for c in range(len(limits)):
        i = first + c
        turned = velocity(active.bodies, active.rows, rates, i, 1)
        free = velocity(active.bodies, active.rows, space.mid.free_rates, i, 1)
        slip = active.free[i, 1] + active.bias[i, 1] + turned - free
        terms = abs(active.free[i, 1]) + abs(active.bias[i, 1]) + abs(turned) + abs(free)
        # And what the limit stops in a step: at rest all others are zero.
        terms += abs(active.free[i, 0])
        none = max(space.known[i], _COUPLING_ROUND_OFF * terms)
        slips = abs(slip) > max(none, active.levels[i, 2])
        mode = LOCKED
        if slips:
            mode = SLIP_PLUS if signs[c] * slip > 0.0 else SLIP_MINUS
        if not limits[c, ENABLED] > 0.0:
            mode = OPEN_CODE
        chunk.codes[k, bodies + c] = chunk.modes[k, bodies + c] = mode
        chunk.impact_delay[k, bodies + c] = chunk.impact_delay[k, active.bodies[i, 0]]
        # A limit below zero, or without a value, ends the run.
        chunk.gaps[k, bodies + c] = 0.0 if mode == OPEN_CODE else limits[c, DECLARED]
        chunk.solved[k, at + c] = signs[c] * levers[c] * space.steady[i, 1] / chunk.h
        warm.keys[i, 0], warm.keys[i, 1] = active.keys[i]
        for d in range(WARM_START_COLUMNS):
            warm.contacts[i, d] = 0.0
        warm.contacts[i, 2], warm.contacts[i, 3] = active.pushes[i]
        warm.contacts[i, 8] = none
        warm.contacts[i, 9] = 1.0 if slips else 0.0
    warm.n_contacts[0] = first + len(limits)


@kernel
def _shown(rates: Array, old: Array, forced: Array) -> None:
    """Bound the change of rates by forces by the change in the step.

    Otherwise recorded forces that an impact reverses would move bodies deeper into each other than
    at the step's detection.
    """
    for b in range(len(old)):
        for d in range(3):
            most = abs(rates[b, d] - old[b, d])
            forced[b, d] = min(max(forced[b, d], old[b, d] - most), old[b, d] + most)


@kernel
def _shown_approach(active: ActiveContacts, old: Array, forced: Array, count: int) -> float:
    """Return the fastest approach of struck contacts in the recorded motion until mid-step."""
    fastest = 0.0
    for i in range(count):
        if active.hit[i]:
            change = velocity(active.bodies, active.rows, forced, i, 0)
            change -= velocity(active.bodies, active.rows, old, i, 0)
            fastest = max(fastest, -active.before[i, 0] - 0.5 * change)
    return fastest


@kernel
def _remember(warm: WarmStart, copy: WarmStart) -> None:
    """Copy a warm start, in place."""
    count = warm.n_contacts[0]
    for i in range(count):
        copy.keys[i, 0], copy.keys[i, 1] = warm.keys[i]
    copy_rows(warm.contacts[:count], copy.contacts)
    copy.n_contacts[0] = count
    copy_numbers(warm.last_step, copy.last_step)
    copy_rows(warm.landings, copy.landings)
    for b in range(len(warm.modes)):
        copy.modes[b, 0], copy.modes[b, 1] = warm.modes[b]


@kernel
def _hurry(sizes: Array, rates: Array, h: float) -> bool:
    """Return whether a body (b,) moves in a step by more than `_FAR` sizes of the smallest one."""
    least, most = math.inf, 0.0
    for b in range(len(sizes)):
        if sizes[b] > 0.0:
            speed = math.hypot(rates[b, 0], rates[b, 1]) + sizes[b] * abs(rates[b, 2])
            least, most = min(least, sizes[b]), max(most, h * speed)
    return most > _FAR * least


@kernel
def step_bodies(
    numbers: BodyNumbers, prescribed: Prescribed, options: StepOptions, start: float, done: int,
    warm: WarmStart, space: Workspace, chunk: Chunk,
) -> tuple[int, int]:  # fmt: skip
    """Take the steps of a chunk; return (steps, status).

    Parameters
    ----------
    prescribed : Prescribed
        Motion and forces.
    start, done : float, int
        Time of the first step, and number of steps taken before these.
    warm : WarmStart
        Changed in place; too small: status `FULL`.
    chunk : Chunk
        Output, per body instead of per contact; `solved` are accelerations and joint forces, only
        written if forces are recorded.
    """
    h, links, (law, forces, allowed, deepest) = chunk.h, numbers.links, options
    free, whole = len(numbers.inverse) - links.bodies, len(numbers.sizes)
    first, delays = 3 * free, np.empty(len(numbers.inverse))
    n, state = first + links.size, chunk.states[0].copy()
    old, loose, active = space.mid.old_rates, space.mid.free_rates, space.active
    surfaces, sizes = numbers.surfaces, numbers.sizes
    ground = allocate_registers(surfaces.code, surfaces.constants, surfaces.values, 1, BLOCK)
    ground[1][1], applied = 0.0, prescribed.forces
    bounds, limits = prescribed.limits, space.limits
    width = 2 * n + prescribed.controller_states.shape[1]
    acting = allocate_registers(applied.code, applied.constants, applied.values, width, 1)
    linking = allocate_registers(links.code, links.constants, links.values, 2 * links.size, 1)
    bounding = allocate_registers(bounds.code, bounds.constants, bounds.values, width, 1)
    steps, rates, forced = len(chunk.codes), np.empty_like(loose), np.empty_like(loose)
    early, fall = np.empty_like(loose), math.hypot(numbers.gravity[0], numbers.gravity[1]) * h
    # The detection after the last step decides on its acceptance.
    for k in range(steps + 1):
        # The rates after the last step.
        if k == steps and not (deepest < math.inf and _hurry(sizes, rates, h)):
            break
        if links.bodies > 0 and not place_links(numbers, state, h, linking, space.mid):
            return k, BAD_INERTIA if k < steps else DONE
        poses = prescribed.poses[k : k + 3]
        move_to_midpoint(numbers, state, poses, h, warm.last_step[0], space.mid)
        time, memories = start + (done + k + 0.5) * h, prescribed.controller_states[k + 1]
        if len(limits) > 0:
            run_at(numbers, bounds.code, bounding, memories, state, time)
            read_limits(numbers, bounds, bounding[1], limits)
        if len(applied.bodies) > 0:
            apply_forces(numbers, applied, acting, memories, state, time, h, space.mid)
            for b in applied.bodies:
                if not math.isfinite(loose[b, 0] + loose[b, 1] + loose[b, 2]):
                    return k, NOT_FINITE if k < steps else DONE
        detected = find_contacts(numbers, ground, warm, space.mid, space.grid, h, active)
        others = len(numbers.joints.kinds) + len(limits)
        full = detected.contacts < 0 or detected.contacts + others >= len(active.hit)
        if full and k < steps:
            return k, FULL
        coarse = (
            detected.passed > 0.0 or detected.unexplained_depth > 0.0 or detected.closing > deepest
        )
        if deepest < math.inf and coarse:
            if k == 0 or not _hurry(sizes, rates, h):
                return k, COARSE
            _remember(space.earlier, warm)
            return k - 1, COARSE
        if k == steps:
            break
        _remember(warm, space.earlier)
        count, joins = detected.contacts, len(numbers.joints.kinds) > 0
        if joins:
            count = add_joints(numbers, warm, space.mid, h, count, active)
        first_coupling = count
        count = add_couplings(numbers, limits, warm, space.mid, h, count, active)
        lands = _any_lands(active, law, first_coupling)
        if lands:
            _without_impacts(numbers, active, space.mid, count, early)
        space.joint_energy[1] = 1.0 if deepest < math.inf else 0.0
        solve_islands(numbers, law, forces, h, space, count, allowed, chunk.stats[k])
        copy_rows(loose, rates)
        copy_rows(loose, forced)
        for i in range(count):
            for d in range(2):
                if space.pressed[i, d] != 0.0:
                    apply_row_impulse(numbers, active, space.mid, rates, i, d, space.pressed[i, d])
                if forces and space.steady[i, d] != 0.0:
                    apply_row_impulse(numbers, active, space.mid, forced, i, d, space.steady[i, d])
        write_linked_rates(numbers, space.mid, rates)
        open_joints = joins and space.joint_energy[0] > 0.0
        if deepest < math.inf and (open_joints or h * fastest_turn(rates[:whole]) > math.pi):
            return k, COARSE
        if forces:
            write_linked_rates(numbers, space.mid, forced)
            _shown(rates, old, forced)
        # Landing bodies move freely until they touch. All mechanisms have one delay.
        for b in range(free, len(delays)):
            space.parents[root(space.parents, b)] = root(space.parents, free)
        slight = max(fall, _SPEED_ROUND_OFF * detected.approach)
        _write_delays(space, law, rates, early, h, slight, first_coupling, delays)
        for b in range(len(delays)):
            chunk.impact_delay[k, b] = delays[b]
        _store(numbers, warm, space, detected, allowed, rates, k, chunk)
        if unsettle_bodies(warm, k, chunk):
            settle_bodies(numbers, warm, space, rates, detected.contacts, k, chunk)
        finish_settling(warm, k, chunk)
        if forces:
            chunk.approach[k] = max(chunk.approach[k], _shown_approach(active, old, forced, count))
        if joins:
            _store_joints(numbers, warm, space, detected.contacts, k, rates, chunk)
        _store_couplings(numbers, warm, space, first_coupling, k, rates, chunk)
        for at in range(n):
            # Rates of coordinates follow those of all bodies.
            b, d = (
                (at // 3, at % 3) if at < first else (whole + (at - first) // 3, (at - first) % 3)
            )
            if forces:
                chunk.solved[k, at] = (forced[b, d] - old[b, d]) / h
            state[n + at] = rates[b, d]
            state[at] += 0.5 * h * rates[b, d]
            delay = delays[b if at < first else free]
            chunk.impact_delay[k, chunk.codes.shape[1] + at] = delay
            if delay > 0.0:
                state[at] += delay * (early[b, d] - rates[b, d])
            if not math.isfinite(state[at]):
                return k, NOT_FINITE
        copy_numbers(state, chunk.states[k + 1])
    return steps, DONE
