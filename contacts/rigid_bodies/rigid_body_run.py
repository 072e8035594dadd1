"""One run of rigid bodies with shapes, in chunks of steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from typing import NamedTuple, Self

import numpy as np

from contacts.collision_detection.body_numbers import (
    BOTH,
    KINETIC,
    TURN,
    BodyNumbers,
    WarmStart,
    split_key,
)
from contacts.collision_detection.find_contacts import LANDED
from contacts.collision_detection.joints import joint_forces
from contacts.collision_detection.surfaces import GRAPH
from contacts.dynamics.surface_jumps import JUMP_ADVICE
from contacts.rigid_bodies.body_step import StepOptions, step_bodies
from contacts.rigid_bodies.declared_numbers import (
    implied_remarks,
    joint_ends,
    joint_openings,
    rotated,
    surface_title,
)
from contacts.rigid_bodies.default_step import inner_radii
from contacts.rigid_bodies.mechanics import energy_root
from contacts.rigid_bodies.prescribed_motion import PrescribedMotion
from contacts.rigid_bodies.shared_loads import MAX_BODIES, BearingForces
from contacts.rigid_bodies.workspace import Workspace
from contacts.scene.parts import Point
from contacts.states import CLOSED, FREE
from contacts.time_stepping.chunk import (
    BAD_INERTIA,
    COARSE,
    DONE,
    FULL,
    NOT_FINITE,
    RESIDUAL,
    Chunk,
    SteppedSystem,
)
from contacts.time_stepping.stability import UNSTABLE, Held, check_stiffness
from contacts.time_stepping.step_rejection import HELPLESS, depth_left
from statechart import interrupts
from statechart.arrays import Array, Bools, Ints
from statechart.errors import (
    NoConsistentMode,
    NonFinite,
    SimulationError,
    SingularMode,
    StepTooLarge,
    UnsolvedImpulses,
)
from statechart.kernels.tapes import ACOS, ASIN, DIV, LOG, POW, POWI, SQRT, TAN, tape_table
from statechart.tabular import pluralise

# Depth, relative to the inscribed radius, from which a body may leave through another side.
_DEEP = 0.1


class _Deepest(NamedTuple):
    """The deepest penetration."""

    body: int
    depth: float
    state: Array
    time: float
    h: float


class Penetration:
    """Monitor of the penetration of bodies."""

    def __init__(self, names: Sequence[str], numbers: BodyNumbers, start_depth: float) -> None:
        self._names, self._radii = names, inner_radii(numbers)[: len(numbers.inverse)]
        self._start_depth, self._part, self._size = start_depth, _DEEP, numbers.size
        self._found: _Deepest | None = None

    def add(self, start: float, chunk: Chunk) -> None:
        """Note the deepest penetration in the steps of a chunk."""
        depths = -np.minimum(chunk.gaps[:, : len(self._radii)], 0.0)
        parts = np.where(depths > self._start_depth, depths / self._radii, 0.0)
        if not parts.max(initial=0.0) > self._part:
            return
        k, b = (int(i) for i in np.unravel_index(np.argmax(parts), parts.shape))
        self._part = float(parts[k, b])
        # Gaps are those at mid-step.
        middle, n = chunk.states[k].copy(), self._size
        middle[:n] += 0.5 * chunk.h * middle[n : 2 * n]
        self._found = _Deepest(b, float(depths[k, b]), middle, start + (k + 0.5) * chunk.h, chunk.h)

    def remarks(self, deepest_at: Callable[[int, Array, float], str]) -> list[tuple[str, float]]:
        """Return a warning of the deepest penetration, with a step that avoids it."""
        if self._found is None:
            return []
        body, depth, state, time, h = self._found
        other = deepest_at(body, state, time) or "what it touches"
        warning = (
            f"body {self._names[body]!r}, of inner radius {self._radii[body]:.3g}, is {depth:.3g} "
            f"deep in {other} at t = {time:.6g} and may pass through it"
        )
        return [(warning, _DEEP * h / self._part)]


# Operations that are not finite everywhere.
_PARTIAL = (DIV, POW, POWI, SQRT, LOG, TAN, ASIN, ACOS)


class MissingGround:
    """Monitor of the first place of each height function without a value."""

    def __init__(self, names: Sequence[str], surfaces: Sequence[str], numbers: BodyNumbers) -> None:
        self._names, self._surfaces, self._numbers = names, surfaces, numbers
        ground = numbers.surfaces
        partial = np.isin(ground.code[:, 0], _PARTIAL).any()
        self._unseen = np.flatnonzero(ground.kinds == GRAPH).tolist() if partial else []
        self.remarks: tuple[str, ...] = ()

    def add(self, start: float, h: float, states: Array, poses: Array) -> None:
        """Check below both ends and the centre of bodies, at ends of steps.

        `poses` (m, l, 3): led bodies at their midpoints.
        """
        for s in self._unseen.copy():
            if found := self._first(s, states, poses):
                step, body, x = found
                self._unseen.remove(s)
                self.remarks += (
                    f"the height of surface {self._surfaces[s]!r} has no value at x = {x:.6g}, "
                    f"where body {self._names[body]!r} is at t = {start + step * h:.6g}: there is "
                    "no ground",
                )

    def _first(self, s: int, states: Array, poses: Array) -> tuple[int, int, float] | None:
        """Return the first step and body above a place without height, and the place."""
        numbers, ground = self._numbers, self._numbers.surfaces
        count, carrier = len(numbers.inverse), int(ground.carriers[s])
        places = numbers.motion(states)[0]
        below = numbers.laws[numbers.kinds[:count], len(numbers.laws) + s] >= 0
        if 0 <= carrier < count:
            below[carrier] = False
        bodies = np.flatnonzero(below)
        frame = np.zeros((len(states), 3))
        if carrier >= 0:
            looks = np.minimum(np.arange(len(states)), len(poses) - 1)
            frame = numbers.poses(states, poses[looks])[:, carrier]
        x = rotated(-frame[:, None, 2], places[:, bodies, :2] - frame[:, None, :2])[..., 0]
        points = x[:, :, None] + numbers.sizes[bodies, None] * np.array([0.0, -1.0, 1.0])
        at = int(ground.graphs[s])
        heights = tape_table(
            ground.code, ground.constants, ground.outputs[at : at + 1], 0,
            np.ascontiguousarray(points.reshape(-1, 1)), ground.values, np.zeros(points.size),
        )  # fmt: skip
        lost = ~np.isfinite(heights.reshape(points.shape))
        if not lost.any():
            return None
        step, body, end = np.unravel_index(int(np.argmax(lost)), lost.shape)
        return int(step), int(bodies[body]), float(points[step, body, end])


# Radians that a struck body turns in a step: warning, and recommended limit.
_TURNED, _FOLLOWED = 0.5, 0.1
# Energy that joints may add, relative to the largest kinetic energy: a bridge that a load jerks
# taut gets up to 0.25 for a moment, and returns it.
_ADDED = 0.5
# Numbers of parts of a rejected step, in order.
_PARTS = (4, 16, 64, 256)
# Depth change, relative to the body, by which a path has jumped into it.
_JUMPED_INTO = 1e-6
# Modes in which loads are checked, attempts including those in steps that are reverted, and steps
# that a mode lasts before one.
_CHECKS, _ATTEMPTS, _LASTING = 8, 32, 3
# Cutting planes against overlap; part of a step that a detection takes.
_MOVES, _INSTANT = 20, 1e-6
# Contacts of the warm start with this feature are detected again.
_NO_FEATURE = np.iinfo(np.int64).min


class DetectedContacts(NamedTuple):
    """Contacts and joints of bodies in one state."""

    # (b,): smallest gap of each body, and the piece or surface there.
    gaps: Array
    deepest: Ints
    keys: Ints  # (m,): pairs; see `WarmStart`.
    levels: Array  # (m,): target gaps.
    lasts: Bools  # (m,): lasting contacts.
    rough: Bools  # (m,): contacts with friction.
    normal: Held
    tangential: Held
    joints: Held
    couplings: Ints  # (c,): their modes.
    slips: Array  # (c,): those of couplings before the step.

    @classmethod
    def of(cls, space: Workspace, warm: WarmStart, numbers: BodyNumbers, modes: Ints) -> Self:
        """Return the contacts of a step, which joints and couplings in `modes` follow."""
        holds, couplings, count = numbers.joints.kinds, numbers.couplings, int(warm.n_contacts[0])
        active = space.active
        many = count - len(modes)
        bodies, rows, contacts_end = active.bodies[:many].copy(), active.rows, many - len(holds)
        both, firm = holds == BOTH, active.materials[contacts_end:many, 0] < 0.0
        joints = [rows[contacts_end:many][firm, 0], rows[contacts_end:many][both & firm, 1]]
        return cls(
            space.mid.gaps.copy(),
            space.mid.deepest.copy(),
            active.keys[:contacts_end, 0].copy(),
            active.levels[:contacts_end, 0].copy(),
            warm.contacts[:contacts_end, 1] == 1.0,
            active.materials[:contacts_end, 1] > 0.0,
            Held(bodies[:contacts_end], rows[:contacts_end, 0].copy()),
            Held(bodies[:contacts_end], rows[:contacts_end, 1].copy()),
            Held(
                np.concatenate([bodies[contacts_end:][firm], bodies[contacts_end:][both & firm]]),
                np.concatenate(joints),
            ),
            modes,
            couplings.signs * active.before[many:count, 1] / couplings.levers,
        )

    def deepest_of(
        self, body: int, bodies: Ints, names: Sequence[str], known: Sequence[str]
    ) -> str:
        """Return the name of the body or surface with the deepest penetration; "" without contact.

        `bodies` are those of the pieces, `known` the names of surfaces (indices behind the pieces).
        """
        if not self.gaps[body] < math.inf:
            return ""
        q = int(self.deepest[body])
        if q >= len(bodies):
            return surface_title(known[q - len(bodies)])
        return f"body {names[int(bodies[q])]!r}"

    def is_covered(self, body: int) -> bool:
        """Return whether a body is deeper than its contacts show, inside overlapping pieces."""
        mine = (self.normal.bodies == body).any(axis=1)
        return bool(self.levels[mine].min(initial=math.inf) > self.gaps[body])

    def ways_out(self, body: int, near: float) -> tuple[Array, Array]:
        """Return directions (k, 2) out of penetrations deeper than `near`, and depths (k,)."""
        sides, rows = self.normal.bodies == body, self.normal.rows
        deep = sides.any(axis=1) & (self.levels < -near)
        normals = np.where(sides[:, :1], rows[:, :2], rows[:, 3:5])
        return normals[deep], -self.levels[deep]


class RigidBodyRun(SteppedSystem):
    """One run of colliding bodies.

    Bodies start up to `start_depth` deep in each other, and stay no deeper. Steps of size `step`;
    `resisted` is the number of bodies whose impulses by rolling resistance are recorded.
    """

    def __init__(
        self,
        names: Sequence[str],
        surfaces: Sequence[str],
        numbers: BodyNumbers,
        prescribed: PrescribedMotion,
        options: StepOptions,
        start_depth: float = 0.0,
        step: float = 0.0,
        resisted: int = 0,
    ) -> None:
        self.surfaces, self._options, self._resisted = surfaces, options, resisted
        self.numbers, self._names, self._prescribed = numbers._replace(step=step), names, prescribed
        count = self._moving = len(numbers.inverse)
        self._warm = self._saved = WarmStart.allocate(numbers)
        # The first step counts as one after an impact.
        self._warm.last_step[2] = start_depth / LANDED
        self._workspace = Workspace.of(self.numbers, self._warm)
        self._min_gaps = np.full(count, np.inf)
        # Largest rotation in a step, and step size.
        self._turned, self._length = 0.0, step
        self._parted, self._most_parts = 0, 1
        # Energy added by joints, and largest kinetic energy so far.
        self._added = self._moved = 0.0
        self._gain_error: StepTooLarge | UnsolvedImpulses | None = None
        self._before: tuple[float, float, StepTooLarge | UnsolvedImpulses | None]
        self._before = 0.0, 0.0, None
        self._no_ground = MissingGround(names, surfaces, numbers)
        self._implied = dict[str, None]()  # Warnings of redundant joints.
        self._penetration = Penetration(names, numbers, start_depth)
        # Only what holds bodies, or different friction, makes a shared load matter.
        held = len(numbers.joints.kinds) + len(numbers.couplings.holds) + numbers.links.bodies > 0
        mixed = (numbers.materials != numbers.materials[:1])[:, KINETIC : KINETIC + 2].any()
        few = 0 < count <= MAX_BODIES
        self._checks_loads = options.forces and few and bool(held or mixed)
        # Modes in which loads were checked, and warnings of them; both before the last steps.
        self._checks, self._loads = 0, (frozenset[bytes](), dict[str, str]())
        self._saved_loads = self._loads
        # The rotation of a centred disc is irrelevant.
        pieces, seen = numbers.pieces, np.ones(len(names), dtype=np.bool_)
        seen[pieces.bodies] = pieces.spans != pieces.radii
        seen = seen[:count]
        self._angular = np.flatnonzero(seen)

    def switch(
        self, states: Mapping[str, str], at: tuple[Array, Array, float]
    ) -> tuple[dict[int, int], bool]:
        """Change the states of controllers; see `SteppedSystem`."""
        _, after, time = at
        self._prescribed.switch(states)
        on, closes = self.numbers.joints.on, False
        for j, joint in enumerate(self._prescribed.joints):
            if joint in states:
                if states[joint] == CLOSED and not on[j]:
                    self._close(j, joint, after, time)
                    closes = True
                on[j] = states[joint] == CLOSED
        if closes:
            led = self._prescribed.poses(time, after[2 * self.numbers.size :])
            [poses, _] = self.numbers.moved(after, np.stack([led, np.zeros_like(led)]))
            remarks = implied_remarks(self._prescribed.scene, self.numbers, poses)
            self._implied |= dict.fromkeys(remarks)
        if not self._prescribed.leads:
            return {}, False
        found = self.detect(after, time, _INSTANT * self._length)
        struck = found.keys[self._workspace.active.hit[: len(found.keys)]]
        if len(struck):
            # The rate between two midpoints would be half of the one that has just been set.
            self._prescribed.restart()
            met = int(self._warm.n_contacts[0])
            self._warm.keys[:met, 1][np.isin(self._warm.keys[:met, 0], struck)] = _NO_FEATURE
        return {}, bool(len(struck))

    def capture(self, remembered: Array) -> None:
        """Let joints that start closed hold the pose that they have captured."""
        for j, joint in enumerate(self._prescribed.joints):
            if self.numbers.joints.on[j]:
                self._capture(j, joint, remembered)

    def _capture(self, j: int, joint: str, remembered: Array) -> None:
        """Let a joint hold the pose that it has captured."""
        joints, pose = self.numbers.joints, self._prescribed.captured(joint, remembered)
        if "turn" in pose:
            joints.sizes[(joints.owners == j) & (joints.kinds == TURN), 0] = pose["turn"]
        if "x" in pose and isinstance(self._prescribed.joints[joint].to, Point):
            joints.points[j, 1] = pose["x"], pose["y"]

    def _close(self, j: int, joint: str, state: Array, time: float) -> None:
        """Close a joint at the pose that it has captured.

        Raises `NoConsistentMode` if it is open by more than a step moves its points.
        """
        joints, remembered = self.numbers.joints, state[2 * self.numbers.size :]
        self._capture(j, joint, remembered)
        open_by, allowed = self._joint_openings(state, self._prescribed.poses(time, remembered))
        for row in np.flatnonzero((open_by > allowed) & (joints.owners == j))[:1].tolist():
            problem = (
                f"its points are {open_by[row]:.3g} apart; write rest: captured, or let enabled "
                "hold where they meet"
            )
            if joints.kinds[row] >= TURN:
                problem = (
                    f"its angle is {open_by[row]:.3g} radians beyond its limits; let enabled hold "
                    "within them"
                )
            raise NoConsistentMode(f"joint {joint!r} closes at t = {time:.6g} while {problem}")

    def _joint_openings(self, state: Array, led: Array) -> tuple[Array, Array]:
        """Return by how much joints (j,) are open (radians at angles), and tolerances.

        These are motions of two steps. `led` (l, 3): poses of led bodies.
        """
        moved = self.numbers.moved(state, np.stack([led, np.zeros_like(led)]))
        joints, size = self.numbers.joints, float(self.numbers.sizes[: self._moving].max())
        _, ends, rates = joint_ends(joints, moved)
        turns, is_angle = moved[:, joints.bodies, 2], joints.kinds >= TURN
        speeds = np.where(is_angle, np.abs(turns[1]).T, np.hypot(*rates.T)).sum(axis=0)
        allowed = 2.0 * self._length * speeds + _JUMPED_INTO * np.where(is_angle, 1.0, size)
        return joint_openings(joints, ends, turns[0, :, 0] - turns[0, :, 1]), allowed

    def forget(self) -> None:
        """Revert the last steps."""
        self._saved = self._saved.enlarged_to(self._warm)
        self._warm = self._saved.copy()
        self._added, self._moved, self._gain_error = self._before
        self._loads = self._saved_loads
        self._prescribed.forget()

    @property
    def margins(self) -> dict[str, float]:
        """The smallest gap of every body, at the midpoints of steps."""
        gaps = zip(self._names[: self._moving], self._min_gaps.tolist(), strict=True)
        return {f"{name}.gap": gap for name, gap in gaps if math.isfinite(gap)}

    def depth_left(self, state: Array, time: float) -> float:
        """Return the penetration that no motion removes; see `SteppedSystem`.

        Cutting planes (Kelley 1960): bodies are moved out of all known overlaps as far as possible,
        perhaps into others, until no move removes all, or none is left.
        """
        n, placed = self.numbers.size, state.copy()
        placed[n : 2 * n] = 0.0
        known, gaps, depth = np.zeros((0, n)), np.zeros(0), -math.inf
        for _ in range(_MOVES):
            detected = self.detect(placed, time, _INSTANT * self._length)
            deep = detected.levels < 0.0
            if not deep.any():
                break
            rows = self._by_coordinates(detected.normal.only(deep), placed)
            known = np.concatenate([known, rows])
            gaps = np.concatenate([gaps, detected.levels[deep] - rows @ (placed - state)[:n]])
            depth, move = depth_left(gaps, known, self._by_coordinates(detected.joints, placed))
            if depth > 0.0:
                break
            placed[:n] = state[:n] + move
        return depth if depth > 0.0 else -math.inf

    def _by_coordinates(self, held: Held, state: Array) -> Array:
        return self.numbers.whole(held.whole(self._moving), state)

    def detect(self, state: Array, time: float, h: float) -> DetectedContacts:
        """Return the contacts of a step of `h` from a state; the run itself does not change."""
        before, prescribed = self._warm, self._prescribed
        # As large as the workspace: steps check the capacity of that only.
        self._warm = WarmStart.allocate(self.numbers).enlarged_to(before)
        self._prescribed = copy(prescribed)
        try:
            chunk, status = self._accepted_steps(time, h, state, 1, math.inf)
            self._check_finite(chunk, status)
            modes = chunk.codes[0, self._moving :]
            return DetectedContacts.of(self._workspace, self._warm, self.numbers, modes)
        finally:
            self._warm, self._prescribed = before.enlarged_to(self._warm), prescribed

    def _check_loads(self, start: float, chunk: Chunk) -> None:
        """Note the first loads that are shared in several ways, where modes of bodies end."""
        modes, numbers = chunk.modes, self.numbers
        if not self._checks_loads or not len(modes):
            return
        changes = np.append(np.any(modes[1:] != modes[:-1], axis=1), True)
        ends = np.flatnonzero(changes)
        begins = np.append(0, ends[:-1] + 1)
        lasting = (ends - begins >= _LASTING - 1) & ~chunk.struck[ends].any(axis=1)
        for first, k in zip(begins[lasting].tolist(), ends[lasting].tolist(), strict=True):
            key, (checked, warnings) = modes[k].tobytes(), self._loads
            if key in checked or not (modes[k, : self._moving] != FREE).any():
                continue
            if len(checked) == _CHECKS or self._checks == _ATTEMPTS:
                return
            self._checks += 1
            state, time = chunk.states[k], start + k * chunk.h
            with suppress(SimulationError):  # The run may end there.
                found = self.detect(state, time, chunk.h)
                titles = [*self._prescribed.joints], [*self._prescribed.scene.couplings]
                forces = BearingForces.of(
                    numbers, self._workspace, len(found.keys), found.couplings, titles, state
                )
                if forces is not None:
                    pair, time = self._pair_names(found.keys), start + first * chunk.h
                    warnings = forces.warnings(time, pair) | warnings
            self._loads = checked | {key}, warnings

    def _pair_names(self, keys: Ints) -> Callable[[int], str]:
        """Return a function of a contact that returns the names of its pair."""
        names = [*(self._names[b] for b in self.numbers.pieces.bodies), *self.surfaces]
        return lambda i: "/".join(names[piece] for piece in split_key(self.numbers, keys[i]))

    def slips(self, state: Array, time: float) -> Array:
        """Return the slips of couplings; see `SteppedSystem`."""
        detected = self.detect(state, time, _INSTANT * self._length)
        return np.append(np.zeros(self._moving), detected.slips)

    def _deepest_at(self, body: int, state: Array, time: float) -> str:
        detected, pieces = self.detect(state, time, _INSTANT * self._length), self.numbers.pieces
        return detected.deepest_of(body, pieces.bodies, self._names, self.surfaces)

    def _check_finite(self, chunk: Chunk, status: int) -> None:
        if status == BAD_INERTIA and not len(chunk.codes):
            raise SingularMode(
                "the inertia of the coordinates does not determine their motion, or has no value"
            )
        if status == NOT_FINITE and not len(chunk.codes):
            lost = np.argwhere(~np.isfinite(self._workspace.mid.free_rates))[:, 0].tolist()
            known = lost and lost[0] < len(self._names)
            what = f"a force on body {self._names[lost[0]]!r}" if known else "a coordinate"
            raise NonFinite(f"{what} became infinite or undefined")

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of the run."""
        too_long = self._penetration.remarks(self._deepest_at)
        if self._turned > _TURNED:
            turned = (
                f"bodies that are hit turn by up to {self._turned:.2g} radians in one step of "
                f"{self._length:.6g}, too much to follow how they touch"
            )
            too_long.append((turned, _FOLLOWED * self._length / self._turned))
        if self._parted:
            joints = ", or joints would not close" if len(self.numbers.joints.kinds) else ""
            parted = (
                f"{pluralise(self._parted, 'step')} of {self._length:.6g} had to be split into up "
                f"to {self._most_parts} parts: bodies would pass through each other, "
                f"rebound far off, or turn by more than half a turn{joints}"
            )
            helps = self._most_parts < _PARTS[-1]
            too_long.append((parted, self._length / self._most_parts if helps else math.inf))
        finest = min((step for _, step in too_long), default=math.inf)
        advice = ""
        if finest < math.inf:
            digit = 10.0 ** math.floor(math.log10(finest))
            advice = f"; take steps of {math.floor(finest / digit) * digit:.1g} or less"
        return (
            *self._implied,
            *self._no_ground.remarks,
            *(text + advice for text, _ in too_long),
            *self._loads[1].values(),
        )

    def steps(self, start: float, h: float, state: Array, count: int) -> Chunk:
        """Take steps; see `SteppedSystem.steps`. A rejected step is split."""
        # Steps beyond a jump are reverted.
        self._saved = self._warm.copy()
        self._before = (self._added, self._moved, self._gain_error)
        self._saved_loads = self._loads
        self._prescribed.save()
        if self._gain_error is not None:
            raise self._gain_error
        self._check_forces(start, h, state)
        self._check_jumps(start, state)
        chunk, status = self._accepted_steps(start, h, state, count, self._options.deepest)
        parts = iter(_PARTS)
        while status == COARSE and not len(chunk.codes):
            before, most = self._warm.copy(), next(parts)
            deepest = math.inf if most == _PARTS[-1] else self._options.deepest
            chunk, status = self._accepted_steps(start, h / most, state, most, deepest)
            if status == COARSE:
                self._warm = before
                chunk = chunk.first(0)
            else:
                self._parted, self._most_parts = self._parted + 1, max(self._most_parts, most)
        self._check_finite(chunk, status)
        if len(self.numbers.joints.kinds):
            chunk = self._without_gain(chunk)
            if not len(chunk.codes) and self._gain_error is not None:
                raise self._gain_error
        gaps = chunk.gaps[:, : self._moving]
        self._min_gaps = np.minimum(self._min_gaps, gaps.min(axis=0, initial=np.inf))
        self._penetration.add(start, chunk)
        self._check_loads(start, chunk)
        self._prescribed.advance(len(chunk.codes))
        turns = chunk.h * np.abs(self.numbers.motion(chunk.states[1:])[1][:, self._angular, 2])
        struck = chunk.struck[:, self._angular]
        self._turned = max(self._turned, float(np.max(turns, where=struck, initial=0.0)))
        self._length = max(self._length, h)
        return chunk

    def _without_gain(self, chunk: Chunk) -> Chunk:
        """Return the steps before joints have added too much energy, relative to the kinetic one.

        Joints do no work: they return stored energy, or steps are too long for the oscillation that
        they couple. The error of the next step is stored.
        """
        added = self._added + np.append(0.0, np.cumsum(chunk.energy_gain))
        chunk.energy_gain[:] = 0.0
        rates = self.numbers.motion(chunk.states[1:])[1]
        moving = 0.5 * (rates**2 / self.numbers.inverse).sum(axis=(1, 2))
        ever_moved = np.maximum.accumulate(np.append(self._moved, moving))
        added -= np.minimum.accumulate(np.minimum(added, 0.0))
        self._added, self._moved = float(added[-1]), float(ever_moved[-1])
        wrong = np.flatnonzero(added[1:] > _ADDED * ever_moved[1:])
        if not len(wrong):
            return chunk
        k = int(wrong[0])
        part = float(added[k + 1] / ever_moved[k + 1])
        self._gain_error = StepTooLarge(
            f"steps of {chunk.h:g} are too long for the joints: these have added {part:.2g} of the "
            f"largest kinetic energy, and should add none; take "
            f"{0.1 * chunk.h / math.sqrt(part):.1g} or less"
        )
        if chunk.stats[: k + 1, RESIDUAL].max() > HELPLESS:
            name = self._names[int(np.argmin(chunk.gaps[k, : self._moving]))]
            self._gain_error = UnsolvedImpulses(
                f"no impulses keep {name} out of what it touches while joints hold; prescribed "
                "motions or constraints squeeze it"
            )
        return chunk.first(k)

    def _check_jumps(self, start: float, state: Array) -> None:
        """Raise `NoConsistentMode` if a path has jumped into a body, or off a closed joint."""
        remembered = state[2 * self.numbers.size :]
        jumped = self._prescribed.jumped(start, remembered)
        if not jumped or self._prescribed.end is None:
            return
        joints = self.numbers.joints
        before, _ = self._joint_openings(state, self._prescribed.end[1])
        open_by, allowed = self._joint_openings(state, self._prescribed.poses(start, remembered))
        off = np.flatnonzero((open_by - before > allowed) & joints.on[joints.owners])
        for j in off[:1].tolist():
            unit = " radians" if joints.kinds[j] >= TURN else ""
            raise NoConsistentMode(
                f"the path of {jumped[0]} jumps at t = {start:.6g}, and opens joint "
                f"{[*self._prescribed.joints][joints.owners[j]]!r} by {open_by[j]:.3g}{unit}; "
                f"{JUMP_ADVICE}"
            )
        met = self.detect(state, start, _INSTANT * self._length)
        landed = LANDED * float(self._warm.last_step[2]) + _JUMPED_INTO * self.numbers.sizes
        deep = met.gaps[: self._moving] + landed[: self._moving]
        b = int(np.argmin(deep))
        if deep[b] < 0.0:
            other = met.deepest_of(b, self.numbers.pieces.bodies, self._names, self.surfaces)
            raise NoConsistentMode(
                f"the path of {jumped[0]} jumps, and body {self._names[b]!r} is "
                f"{-met.gaps[b]:.3g} deep in {other}; {JUMP_ADVICE}"
            )

    def _check_forces(self, start: float, h: float, state: Array) -> None:
        """Raise `StepTooLarge` if forces are too stiff for these steps."""
        stiff = self._prescribed.forces.stiffness(self.numbers, h, state, start)
        if not stiff.most() > UNSTABLE:
            return
        met = self.detect(state, start, _INSTANT * h)
        parts = met.normal.only(met.lasts), met.tangential.only(met.lasts & met.rough), met.joints
        held = Held(*(np.concatenate(three) for three in zip(*parts, strict=True)))
        rows = self._by_coordinates(held, state)
        if self.numbers.links.bodies:
            rows = rows @ energy_root(self.numbers, state)
        else:
            rows = rows * np.sqrt(self.numbers.inverse).ravel()
        check_stiffness(stiff, rows, h)

    def _accepted_steps(
        self, start: float, h: float, state: Array, count: int, deepest: float
    ) -> tuple[Chunk, int]:
        """Return the accepted steps, and the status of their end."""
        bodies, n = self._moving, self.numbers.size
        couplings = len(self.numbers.couplings.holds)
        joints = joint_forces(self.numbers)
        unknowns = n + joints + couplings + self._prescribed.count
        # One more, for the last detection.
        motion, remembered, known = self._prescribed.prescribe(start, h, state[2 * n :], count + 1)
        count = min(count, known)
        remembered = remembered[: count + 1]
        columns = joints + self._resisted
        chunk = Chunk.allocate(h, state, (n, unknowns, bodies + couplings, columns), count)
        done, status = 0, DONE
        while status == FULL or (status == DONE and done < count):
            if done and interrupts.signal_count():
                break
            some = chunk.after(done).first(count - done)
            taken, status = step_bodies(
                self.numbers, motion.after(done), self._options._replace(deepest=deepest), start,
                done, self._warm, self._workspace, some,
            )  # fmt: skip
            done += taken
            if status == FULL:
                self._warm = self._warm.doubled()
                self._workspace = Workspace.of(self.numbers, self._warm)
        chunk.states[1:, 2 * n :] = remembered[:-1]
        chunk = chunk.first(done)
        if done:
            at = slice(1, done + 1)
            self._no_ground.add(start, h, chunk.states, motion.poses[at])
        if self._prescribed.count:
            chunk.solved[:, n + joints + couplings :] = self._prescribed.control_values(
                start, h, chunk.states
            )
        return chunk, status
