"""Time stepper of points on surfaces (see `statechart.automaton.time_stepper.TimeStepper`)."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import compress

import numpy as np

from contacts.dynamics.conditions import Conditions
from contacts.dynamics.contact_law import ContactLaw, carriers, edge
from contacts.dynamics.controllers import Controllers
from contacts.dynamics.mechanics import Mechanics, winch_end_message
from contacts.dynamics.setup import ROUNDING, SceneSetup
from contacts.dynamics.setup_evaluation import SceneNumbers
from contacts.dynamics.snapshot import SnapshotTape
from contacts.dynamics.starting import (
    check_joints,
    check_limits,
    check_place,
    check_start,
    hovering_warnings,
)
from contacts.dynamics.surface_jumps import ParameterChange, modes_after_change, modes_after_jump
from contacts.scene.lint import NEARLY_MEETING, goes_off_warning, stays_off_warning
from contacts.solvers.contact_rows import STEEPEST
from contacts.solvers.dependence import independent_rows
from contacts.solvers.redundancy import mode_columns
from contacts.solvers.step_impulses import drop_round_off_friction
from contacts.states import (
    FREE,
    LOCKED,
    OFF,
    OFF_CODE,
    OPEN_CODE,
    PIN,
    RESTS,
    SLIDE_MINUS,
    SLIDE_PLUS,
    SLIPS,
    STATES,
    open_motion_warning,
)
from contacts.time_stepping.chunk import BAD_INERTIA, CHOSEN, JAMMED, Chunk, SteppedSystem
from contacts.time_stepping.discretisation_error import DiscretisationError, Equations
from contacts.time_stepping.equations import HOLDING, LANDED, ContactHistory, StepConstants
from contacts.time_stepping.guard_truths import StepEnd
from contacts.time_stepping.scene_step import step_scene
from contacts.time_stepping.scene_tape import SteppedTape
from contacts.time_stepping.solver_residual import INDETERMINATE
from contacts.time_stepping.stability import Swings, check_swing, remarks
from contacts.time_stepping.step_contacts import mode_of_impulse
from contacts.time_stepping.step_rejection import depth_left
from contacts.time_stepping.stepper import RELATIVE, RunInputs, Stepper
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.clock import Clock
from statechart.automaton.regions import Region, StopCondition
from statechart.automaton.trace import Key
from statechart.errors import NoConsistentMode, NonFinite, SimulationError, SingularMode
from statechart.kernels.boxes import Steps, bind_tape, bound_third_derivatives, enclose
from statechart.kernels.jit import kernel
from statechart.kernels.resolution import jet_registers
from statechart.kernels.tapes import TapeCode

# Depth between midpoints, relative to a step at the scene's speed, up to which a point only grazes.
_GRAZED = 0.1
# Contact speed, relative to the scene's, below which it is no energy scale.
_SLOWEST = 0.1
# Energy, relative to the scene's, that counts as zero.
_NEGLIGIBLE = 1e-6
# Landing depth, in approach steps.
_LANDED = 2.0
# Limits of bisection: boxes per line, and width relative to the line. The rest touches at most.
_BOXES, _NARROW = 256, 2.0**-32
# Distance of friction from its bound that is round-off, relative to the normal force.
_AT_BOUND = 1e-9
# Friction below which the impulse of a slide is round-off beside the momentum.
_LEAST_FRICTION = 1e-9
_CODES = {state: code for code, state in STATES.items()}


@kernel
def find_passage(tape: TapeCode, lines: Steps, seen: Bools, near: float) -> tuple[int, int, float]:
    """Return (line, contact, part) of the first line on which a contact passes a surface.

    Steps evaluate gaps at midpoints, between which coordinates move in straight lines. A contact
    that is open at both ends of a line and closed in between passed its surface; one that is deeper
    in between than at the end landed elsewhere. An interval enclosure of the gap along the line
    decides, however short the overlap.

    The tape has the gaps (c,), `lines` are m steps; contacts `seen` (m, c) are active at the start
    of a line; a depth up to `near` only touches. `part` is a lower bound of the closed part of the
    line; line and contact are -1 if there is none.
    """
    outputs, reads, coeffs = tape.outputs, tape.reads, lines.coeffs
    step_tape, regs = bind_tape(tape, lines, 1)
    jets = jet_registers(step_tape, regs)
    bounds, count = np.zeros(coeffs.shape[1]), outputs.shape[0]
    is_open, depths = np.empty(count, np.bool_), np.empty(count)
    lefts, rights = np.empty(64), np.empty(64)
    for line in range(coeffs.shape[0]):
        bound_third_derivatives(coeffs, line, reads, bounds)
        enclose(step_tape, line, bounds, 0.0, 0.0, 0, jets)
        for i in range(count):
            is_open[i] = not seen[line, i] and jets[outputs[i], 0] > 0.0
        enclose(step_tape, line, bounds, 1.0, 0.0, 0, jets)
        for i in range(count):
            depths[i] = min(jets[outputs[i], 0], 0.0) - near
        top, boxes = 1, 0
        lefts[0], rights[0] = 0.0, 1.0
        while top > 0 and boxes < _BOXES:
            top -= 1
            boxes += 1
            a, b = lefts[top], rights[top]
            m = 0.5 * (a + b)
            enclose(step_tape, line, bounds, m, 0.5 * (b - a), 0, jets)
            clear = True
            for i in range(count):
                clear = clear and not (is_open[i] and jets[outputs[i], 0] <= depths[i])
            if clear or b - a <= _NARROW:
                continue
            enclose(step_tape, line, bounds, m, 0.0, 0, jets)
            for i in range(count):
                if is_open[i] and jets[outputs[i], 1] < depths[i]:
                    return line, i, b - a
            lefts[top], rights[top] = m, b
            lefts[top + 1], rights[top + 1] = a, m
            top += 2
    return -1, -1, 0.0


@dataclass(eq=False)
class _StepState:
    """State between steps: contact history, last modes, least values, errors, warnings."""

    contacts: ContactHistory
    codes: Ints
    least_gap: Array
    least: Array
    errors: DiscretisationError
    loads: dict[bytes, str]  # Modes -> warnings about their load sharing.
    # (c,): whether a contact has just come to rest; whether one did with friction at its bound.
    rests: Bools
    at_bound: Bools

    def copy(self) -> _StepState:
        return _StepState(**{name: part.copy() for name, part in vars(self).items()})


class SteppedTapes(Controllers):
    """Equations of a scene per combination of controller states, compiled on demand."""

    def __init__(self, mechanics: Mechanics) -> None:
        super().__init__(mechanics)
        self.at = cache(lambda states: SteppedTape(mechanics, self.named(states)))
        self.conditions = cache(lambda states: Conditions(mechanics, self.named(states)))

    @cached_property
    def snapshots(self) -> SnapshotTape:
        """Snapshots of a scene without controllers."""
        return SnapshotTape(self._mechanics)


class SteppedScene(SteppedSystem):
    """One run of a scene of points on surfaces.

    `off` (c,): contacts that are disabled at the start; `allowed`: residual of impulses;
    `controls`: initial states of controllers.
    """

    def __init__(
        self,
        tapes: SteppedTapes,
        numbers: SceneNumbers,
        setup: SceneSetup,
        off: Bools,
        allowed: float,
        controls: Key,
    ) -> None:
        self._tapes, self._numbers = tapes, numbers
        count = len(setup.contacts)
        self._values, self._near = setup.values, setup.tolerances["gap"]
        self._still = setup.tolerances["speed"]
        self._nearly = NEARLY_MEETING * setup.scales.length
        self._speed, self._allowed = setup.scales.speed, allowed
        self._negligible = _NEGLIGIBLE * setup.scales.force * setup.scales.length
        self._use(tapes.at(controls), setup.contacts)
        self._step_state = _StepState(
            ContactHistory.of(off, self._source.size),
            np.full(count, FREE),
            np.full(count, np.inf),
            np.full((count, 2), np.inf),
            DiscretisationError(setup.scales),
            {},
            np.zeros(count, np.bool_),
            np.zeros(count, np.bool_),
        )
        self._close_turning(setup.initial)
        self._saved = self._step_state.copy()
        self._swing = self._length = 0.0

    def change(
        self, values: Mapping[str, float], state: Array, time: float
    ) -> tuple[SceneSetup, dict[int, int]]:
        """Change the values of parameters at a state and time; return the setup, and open contacts.

        These are contacts that their surface strikes, and their mode. Raises `NoConsistentMode` if
        a surface jumps into a point, or a joint opens.
        """
        setup, tape = self._numbers.at(values, RELATIVE, stepped=True), self._tapes.snapshots
        mode, change = self._mode, ParameterChange(self._values, setup, state, time)
        jump = modes_after_change(self._source.scene, mode, tape, self._numbers.conditions, change)
        self._values = setup.values
        self._use(self._source, setup.contacts)
        switched, strikes = self._move(mode, *jump)
        # Its gap and condition did not flow here from those of the last step.
        self._step_state.contacts.last[jump[1]] = np.nan
        return setup, {i: code for i, code in switched.items() if strikes[i]}

    def switch(
        self, states: Mapping[str, str], at: tuple[Array, Array, float]
    ) -> tuple[dict[int, int], bool]:
        """Change the states of controllers; see `SteppedSystem`."""
        was, (before, after, time) = self._source, at
        contacts = self._numbers.contacts(self._values, states)
        self._use(self._tapes.at(tuple(states.values())), contacts)
        if not was.scene.leading:
            return {}, False
        mode = self._mode
        old = was.contacts(self._values, before, time)[:, :3]
        now = self._source.contacts(self._values, after, time)[:, :3]
        tolerances = {"gap": self._near, "speed": self._still}
        jump = modes_after_jump(was.scene, contacts, tolerances, mode, old, now)
        switched, strikes = self._move(mode, *jump)
        return switched, bool(strikes.any())

    def _move(
        self, before: Key, after: Key, separates: Bools, strikes: Bools
    ) -> tuple[dict[int, int], Bools]:
        """Set the modes that `modes_after_jump` returns; return the changed ones, and strikes."""
        memory = self._step_state.contacts
        # A contact that a surface strikes or leaves does not last.
        memory.closed[separates] = False
        switched = {i: _CODES[after[i]] for i in range(len(after)) if after[i] != before[i]}
        for i, code in switched.items():
            self._step_state.codes[i] = memory.modes[i] = code
        return switched, strikes

    @property
    def _mode(self) -> Key:
        """The last modes of the contacts."""
        memory, codes = self._step_state.contacts, self._step_state.codes
        return tuple(STATES[i] for i in np.where(memory.disabled, OFF_CODE, codes).tolist())

    def _use(self, source: SteppedTape, contacts: Sequence[ContactLaw]) -> None:
        """Set equations and coefficients."""
        self._source = source
        edges = [edge(1.0) if law.coupling else (law.cone_n, law.cone_t) for law in contacts]
        self._cones = drop_round_off_friction(np.array(edges, float).reshape(-1, 2))
        self._restitution = np.array([law.restitution for law in contacts])
        self._carriers = carriers(tuple(contacts))
        self._levers = np.array([law.lever for law in contacts if law.coupling])
        nowhere = np.zeros(source.soft.n_variables)
        self._soft = source.soft.at(nowhere, self._values, 0.0).reshape(-1, 2)
        # The impact of a rigid contact may stop its slip, and that of its rolling resistance.
        loads = np.where(self._carriers >= 0, self._carriers, np.arange(len(contacts)))
        rigid = np.array([not law.coupling for law in contacts], np.bool_)
        rigid[rigid] = self._soft[: rigid.sum(), 0] == 0.0
        self._is_rigid = rigid[loads]
        undeclared = [[state not in law.states for state in STATES.values()] for law in contacts]
        self._undeclared = np.array(undeclared, np.bool_).reshape(-1, len(STATES))

    @property
    def filled(self) -> bool:
        """True if coordinates without inertia received a small one."""
        return bool(self._step_state.contacts.light[0])

    def press(self, closed: Bools) -> None:
        """Let contacts (c,) be closed and sliding, and forces decide modes, as after impacts."""
        memory = self._step_state.contacts
        memory.closed[closed], memory.slip[closed], memory.settling[:] = True, 1.0, LANDED

    def keep(self, idle: Bools, state: Array) -> None:
        """Let contacts (c,) that touch without a load last at the start."""
        if idle.any():
            slips = self._source.contacts(self._values, state)[:, 2]
            memory = self._step_state.contacts
            memory.closed[idle], memory.slip[idle], memory.modes[idle] = True, slips[idle], PIN
            memory.landing_steps[idle], memory.settling[idle] = HOLDING, LANDED

    def _close_turning(self, state: Array) -> None:
        """Let contacts that touch last at the start where rotation alone presses them.

        Their approach at the middle of the first step is no impact.
        """
        source, memory = self._source, self._step_state.contacts
        c = len(source.names) - source.couplings
        _, rows, _ = at = source.equations(self._values, state, 0.0)
        slow = np.hypot(at.gaps / self._near, at.velocities[:, 0] / self._still) <= 1.0
        turning = (rows[:, 2 * source.size] < 0.0) & (source.held == 0) & self._is_rigid
        closed = np.flatnonzero((slow & turning & ~memory.disabled)[:c])
        memory.closed[closed], memory.target_gap[closed] = True, np.inf
        memory.slip[closed] = at.velocities[closed, 1]

    def hold(
        self, stopped: Mapping[int, tuple[float, float]], leaving: Collection[int]
    ) -> dict[int, int]:
        """Let stopped contacts last, and others leave; see `SteppedSystem`."""
        memory, codes = self._step_state.contacts, self._step_state.codes
        for i, (gap, slip) in stopped.items():
            if not memory.closed[i]:
                memory.closed[i], memory.target_gap[i] = True, gap
            slides, directed = abs(slip) > self._still, bool(self._source.slips[i] == 2)
            slip = slip if slides else 0.0
            codes[i] = mode_of_impulse(np.zeros(2), slip, slides, self._cones[i], directed)
            memory.modes[i] = codes[i]
        for i in leaving:
            memory.closed[i], memory.modes[i], codes[i] = False, FREE, FREE
        return {i: int(codes[i]) for i in (*stopped, *leaving)}

    def forget(self) -> None:
        """Revert the last steps."""
        self._step_state = self._saved.copy()

    @property
    def margins(self) -> dict[str, float]:
        """The smallest margins, at the midpoints of steps."""
        rigid = len(self._source.names) - self._source.couplings
        least = np.column_stack([self._step_state.least_gap, self._step_state.least])
        least[rigid:] *= self._levers[:, None]
        values = least.tolist()
        margins: dict[str, float] = {}
        for i, name in enumerate(self._source.names):
            kinds = ("gap", "V", "mu V - |H|") if i < rigid else ("limit",)
            margins |= {f"{name}.{kind}": v for kind, v in zip(kinds, values[i], strict=False)}
        return {name: value for name, value in margins.items() if math.isfinite(value)}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings of the run."""
        return (
            *remarks(self._swing, self._length),
            *self._step_state.errors.remarks(self._length),
            *filter(None, self._step_state.loads.values()),
            *(
                f"{name} comes to rest with its friction at the bound: it sticks, and might slip on"
                for name in compress(self._source.names, self._step_state.at_bound)
            ),
            *self._stays_off(),
        )

    def _stays_off(self) -> Iterator[str]:
        """Yield a warning for each contact that has missed its surface, if by a small depth."""
        for name, (first, last, past, time) in zip(
            self._source.names, self._step_state.contacts.missed_depths.tolist(), strict=True
        ):
            if time < math.inf:
                yield goes_off_warning(name, time)
            depth = min(past, first) if last > first else past
            if self._near < depth <= self._nearly:
                yield stays_off_warning(self._source.scene, name, depth)

    def steps(self, start: float, h: float, state: Array, count: int) -> Chunk:
        """Take steps from `state` (2 n + w,).

        Raises `SingularMode`, `NonFinite` or `NoConsistentMode` if no step can be taken.
        """
        source, tape = self._source, self._source.tape
        n, c, r = source.size, len(source.names), source.joint_rows
        chunk = Chunk.allocate(
            h, state, (n, n + r + 2 * c + source.given, c, r + source.couplings), count
        )
        self._saved = self._step_state.copy()
        memory = self._step_state.contacts
        scene = StepConstants(
            tape.program, source.flows.program, n, source.damped, self._values, self._cones,
            source.used, self._restitution, source.plastic, source.capped, source.pairs,
            source.held, source.slips, r, source.signs, self._allowed, self._near, self._still,
            ROUNDING * self._speed,
            self._speed, _SLOWEST * self._speed, self._negligible, self._soft, source.couplings,
            self._carriers,
        )  # fmt: skip
        swings = self._check_springs(chunk, start)

        done, status = step_scene(scene, memory, start, chunk)
        if not done:
            raise _failure(status)
        followed = self._count_allowed(chunk.first(done), start)
        if followed < done:
            # The history must be that of the accepted steps.
            self.forget()
            return self.steps(start, h, state, followed)
        chunk = chunk.first(done)
        chunk.joint_impulses[:, r:] *= self._levers
        forces = chunk.solved[:, n + r : n + r + 2 * c].reshape(len(chunk.codes), c, 2)
        self._note(chunk.gaps, forces, chunk.codes, chunk.solved[:, n + r + 2 * c :])
        self._note_passed(chunk, start)
        self._note_loads(chunk, start)
        now = Equations(source, self._values, self._cones, self._restitution)
        self._step_state.errors.add(now, chunk, start, self._saved.codes, swings)
        # Loads of couplings are no unknowns.
        loads = n + r + 2 * np.arange(c - source.couplings, c)
        return chunk._replace(solved=np.delete(chunk.solved, loads, axis=1))

    def slips(self, state: Array, time: float) -> Array:
        """Return the slips of couplings and compliant contacts; see `SteppedSystem`."""
        slips = self._source.equations(self._values, state, time).velocities[:, 1]
        return np.where(self._is_rigid, 0.0, slips)

    def slip_errors(self, ends: Array, times: tuple[float, float], codes: Ints) -> Array:
        """Return the errors of slips of compliant contacts; see `SteppedSystem`.

        A contact moves on until it lands, and bodies are as deep on rigid ones as they landed.
        """
        c, errors = len(codes) - self._source.couplings, np.zeros(len(codes))
        before, now = map(partial(self._source.equations, self._values), ends, times)
        lasts = self._is_rigid[:c] & ~np.isin(codes[:c], (FREE, OFF_CODE))
        lands = ~self._is_rigid[:c] & (now.gaps[:c] > 0.0) & (now.gaps[:c] < before.gaps[:c])
        fallen = (before.gaps[:c] - now.gaps[:c])[lands]
        changes = np.abs(now.velocities[:c, 1] - before.velocities[:c, 1])[lands]
        errors[:c][lands] = changes * (1.0 + np.abs(now.gaps[:c][lasts]).max(initial=0.0) / fallen)
        return errors

    def depth_left(self, state: Array, time: float) -> float:
        """Return the penetration that no motion removes; see `SteppedSystem`."""
        n, at = self._source.size, self._source.equations(self._values, state, time)
        on = ~self._step_state.contacts.disabled & (self._soft[:, 0] == 0.0)
        return depth_left(at.gaps[on], at.contacts[on, :n], at.joints[:, :n])[0]

    def _check_springs(self, chunk: Chunk, start: float) -> Swings | None:
        """Return the oscillations of springs; raise `StepTooLarge` if they are unstable."""
        source, state = self._source, chunk.states[0]
        n = source.size
        mass, rows, joints = source.equations(self._values, state, start)
        codes = self._step_state.codes
        closed = (codes != FREE) & (codes != OFF_CODE)
        sticks = np.isin(codes, (PIN, LOCKED))
        held = np.concatenate([rows[closed, :n], rows[sticks, n : 2 * n], joints[:, :n]])
        swings = source.limits.swings(mass, self._values, state, start, held)
        swing = 0.0 if swings is None else float(swings.speeds.max())
        check_swing(swing, chunk.h)
        self._swing, self._length = max(self._swing, swing), max(self._length, chunk.h)
        return swings

    def _note_passed(self, chunk: Chunk, start: float) -> None:
        """Note the first step that passed over a contact."""
        gaps, count, h = self._source.gaps, len(chunk.codes), chunk.h
        n = self._source.size
        places, rates = chunk.states[:, :n], chunk.states[:, n : 2 * n]
        # From each midpoint to the next, and from the start to the first.
        lengths = np.full(count, h)
        lengths[0] = h if start > 0.0 else 0.5 * h
        lines = np.zeros((*chunk.states[:-1].shape, 2))
        back = lengths - 0.5 * h
        lines[:, :n, 0] = places[:count] - back[:, None] * rates[:count]
        lines[:, :n, 1] = lengths[:, None] * rates[:count]
        lines[:, n : 2 * n, 0] = rates[:count]
        # Controller variables change as in the step.
        flows = np.diff(chunk.states[:, 2 * n :], axis=0) / h
        lines[:, 2 * n :, 1] = lengths[:, None] * flows
        lines[:, 2 * n :, 0] = chunk.states[:-1, 2 * n :] - back[:, None] * flows
        taking = (chunk.codes != FREE) | chunk.struck
        seen = np.vstack([self._saved.codes != FREE, taking[:-1]])
        times, begin = np.concatenate([[0.0], np.cumsum(lengths)]), start - float(back[0])
        steps, near = Steps(times, lines, self._values, begin), _GRAZED * h * self._speed
        line, _, part = find_passage(gaps.parts, steps, seen, near)
        if line >= 0:
            chunk.passed[line] = part
        # A point that leaves when first detected, or is deeper than its approach explains, entered
        # elsewhere.
        deep = (chunk.codes != OFF_CODE) & (chunk.gaps < -self._near)
        # A re-enabled contact is no deeper than a lasting one.
        deep &= np.vstack([self._saved.codes, chunk.codes[:-1]]) != OFF_CODE
        deep[1:] &= chunk.gaps[:-1] > 0.0
        deep[0] &= ~(self._saved.contacts.last[:, 1] <= 0.0)
        for k, i in np.argwhere(deep).tolist():
            state = lines[k].sum(axis=1)
            before = gaps.values(lines[k, :, 0], self._values, begin + times[k])[i]
            rows = self._source.equations(self._values, state, begin + times[k + 1])
            rate = rows.velocities[i, 0]
            slow, depth = _GRAZED * self._speed, -chunk.gaps[k, i]
            approach = max(-rate, slow)
            if before > 0.0 and (rate > slow or depth > _LANDED * h * approach):
                chunk.passed[k] = max(chunk.passed[k], min(1.0, h * approach / depth))
                break

    def _note_loads(self, chunk: Chunk, start: float) -> None:
        """Note the first mode in which undetermined load sharing affects the motion.

        Forces of dependent constraints are not unique, and with sliding friction their effects
        differ.
        """
        modes, source, loads = chunk.modes, self._source, self._step_state.loads
        n = source.size
        changed = np.any(modes != np.vstack([modes[:1] - 1, modes[:-1]]), axis=1)
        for k in np.flatnonzero(changed).tolist():
            key, bears = modes[k].tobytes(), ~np.isin(modes[k], (FREE, OFF_CODE, OPEN_CODE))
            if key in loads or bears.sum() < 2 or any(loads.values()):
                continue
            time = start + (k + 1) * chunk.h
            _, rows, joints = source.equations(self._values, chunk.states[k + 1], time)
            jacobians = rows[bears, : 2 * n].reshape(-1, 2, n)
            acts = partial(_spare_rows, modes[k, bears], jacobians, joints[:, :n])
            smooth, loads[key] = self._cones[bears] * (1.0, 0.0), ""
            spare = acts(smooth)
            if spare > acts(self._cones[bears]):
                names = np.array(source.names)[bears]
                shared = [i for i in range(len(names)) if acts(smooth, i) < spare]
                loads[key] = open_motion_warning(names[shared], time)

    def _count_allowed(self, chunk: Chunk, start: float) -> int:
        """Return the number of steps in declared modes; replace a stick that only passes.

        Raises `NoConsistentMode` if the first step is in none.
        """
        codes, shown, h = chunk.codes, chunk.modes, chunk.h
        before = np.vstack([self._step_state.codes, codes[:-1]])
        slid = (before == SLIDE_PLUS) | (before == SLIDE_MINUS)
        # A slip that reverses in a step is at rest at its end, and without friction may stay so.
        turning = (codes == PIN) & self._undeclared[:, PIN] & (slid | (self._cones[:, 1] == 0.0))
        codes[turning] = np.where(slid, before, SLIDE_PLUS)[turning]
        self._step_state.codes = codes[-1]
        places = np.arange(codes.shape[1])
        wrong = self._undeclared[places, codes]
        np.copyto(shown, codes, where=self._undeclared[places, shown])
        if len(self._source.hauled):
            ends = chunk.ends(start)
            lengths = self._source.lengths.table(chunk.states[1:], self._values, ends)
            wrong[:, self._source.hauled] |= lengths < 0.0
        if not self._source.may_jam:
            jams = chunk.stats[:, JAMMED, None] == 1 + places
            wrong |= jams & (codes != before)
        if not wrong.any():
            return len(codes)
        k, i = np.argwhere(wrong)[0].tolist()
        if k == 0:
            raise self._refusal(i, int(codes[0, i]), start + h)
        return int(k)

    def _refusal(self, contact: int, code: int, end: float) -> NoConsistentMode:
        """Return the error of a contact that does not declare a mode of a step."""
        name, state = self._source.names[contact], STATES[code]
        if contact in self._source.hauled:
            return winch_end_message(name, end)
        why = (
            f"would be {state} by t = {end:.7g}, and {state.rstrip('+-')} is not among its modes; "
            "add it, or end the run before"
        )
        if not self._undeclared[contact, code]:
            why = (
                "can neither slide nor lift off: friction presses it into its surface (Painleve, "
                "inconsistent); with paradox: impact an impact without collision resolves this"
            )
        return NoConsistentMode(f"contact {name!r} {why}")

    def _note(self, gaps: Array, forces: Array, codes: Ints, controlled: Array) -> None:
        memory = self._step_state
        memory.least_gap = np.minimum(memory.least_gap, gaps.min(axis=0))
        normal, tangential = forces[..., 0], np.abs(forces[..., 1])
        cone_n, cone_t = self._cones.T
        with np.errstate(divide="ignore", invalid="ignore"):
            mu = np.tile(cone_t / cone_n, (len(gaps), 1))
            split = self._source.used >= 0
            mu[:, split] = controlled[:, self._source.used[split]]
            inside = np.where(np.isfinite(mu), mu * normal - tangential, np.inf)
        # Friction stays at its bound where a slip decays to round-off.
        before = np.vstack([self._saved.codes, codes[:-1]])
        sticks, slid = np.isin(codes, [*RESTS]), np.isin(before, SLIPS)
        rests = np.vstack([memory.rests, slid & sticks])
        bounded = rests[:-1] & sticks & (inside <= _AT_BOUND * normal)
        memory.rests, memory.at_bound = rests[-1], memory.at_bound | bounded.any(axis=0)
        for k, values in enumerate((normal, inside)):
            borne = (codes != FREE) & (codes != OFF_CODE) & ~np.isnan(values)
            seen = np.where(borne, values, np.inf).min(axis=0)
            memory.least[:, k] = np.minimum(memory.least[:, k], seen)


def _spare_rows(
    codes: Ints, jacobians: Array, joints: Array, cones: Array, left_out: int = -1
) -> int:
    """Return the number of dependent columns of contacts and joints."""
    rows = np.vstack([mode_columns(codes, cones, jacobians, left_out)[0], joints])
    return len(rows) - int(independent_rows(rows)[0])


def _failure(status: int) -> SingularMode | NonFinite:
    if status == BAD_INERTIA:
        return SingularMode(
            "the equations do not determine the motion: a coordinate has no inertia and "
            "nothing to hold it, or constraints contradict each other"
        )
    return NonFinite(
        "a coordinate, a controller's variable, or a gap or condition of a contact became "
        "infinite or undefined; look for a logarithm, root or quotient without a value there"
    )


# Trial step for the initial modes, in the scene's time; factor of the step that follows it, if none
# is declared.
_TRIAL, _LONGER = 1e-6, 1e3


def _trial_step(setup: SceneSetup) -> float:
    return _TRIAL * setup.scales.length / setup.scales.speed


class SceneStepper(Stepper):
    """Steps a scene of points on surfaces."""

    def __init__(
        self,
        mechanics: Mechanics,
        stops: Sequence[StopCondition],
        regions: tuple[Region, ...],
    ) -> None:
        contacts = mechanics.scene.contacts
        self._tapes = SteppedTapes(mechanics)
        c, couplings = len(contacts), len(mechanics.scene.couplings)
        rigid = np.arange(2 * c).reshape(-1, 2)
        places = np.vstack([rigid, np.repeat(2 * c + np.arange(couplings)[:, None], 2, axis=1)])
        sticks = [{"pin", "slide"} <= one.kinds for one in contacts.values()] + [True] * couplings
        super().__init__(
            mechanics, regions, self._tapes, again="jam",
            forces=len(mechanics.a) + len(mechanics.joint_rows) + places,
            sticks=np.array(sticks, bool), turning=tuple(mechanics.scene.couplings),
        )  # fmt: skip
        self._numbers = SceneNumbers(mechanics, stops)

    def _begin(
        self, overrides: Mapping[str, float], step: float, allowed: float, forces: bool
    ) -> RunInputs:
        setup = self._numbers.at(overrides, RELATIVE, stepped=True)

        def begin(controls: Key) -> RunInputs:
            failure, warnings, solved = None, tuple[str, ...](), np.zeros(0)
            off = idle = np.zeros(len(setup.contacts), np.bool_)
            codes = np.full(len(off), FREE)
            try:
                codes, off, idle, warnings, solved = self._checked(setup, step, allowed, controls)
            except SimulationError as error:
                failure = error
            scene = SteppedScene(self._tapes, self._numbers, setup, off, allowed, controls)
            scene.keep(idle, setup.initial)
            change = None if self._scene.regions else scene.change
            return RunInputs(setup, scene, codes, warnings, controls, solved, failure, change)

        def due_in(_: Key, start: RunInputs) -> Set[tuple[int, int]]:
            control = self.control(start)
            if control is None or start.failure is not None:
                return frozenset()
            h, size = _trial_step(setup), len(self._mechanics.q)
            begin = setup.initial, start.codes, start.solved, None
            return control.due_at_start(StepEnd(start.system, size, 0.0, h, *begin))

        return self._tapes.settle_start(begin, due_in)

    def _checked(
        self, setup: SceneSetup, step: float, allowed: float, controls: Key
    ) -> tuple[Ints, Bools, Bools, tuple[str, ...], Array]:
        """Check the initial state.

        Returns initial modes, contacts that are disabled, and those that bear in the next steps
        only; warnings, and unknowns of a short step.
        """
        warnings = [*self._replaced_laws(setup), *self._cut(setup)]
        entered = self._tapes.enter_initial_states(setup, Clock(), setup.initial, controls)
        setup = replace(setup, initial=entered)
        named = self._tapes.named(controls)
        if self._mechanics.joint_rows:
            check_joints(self._mechanics, SnapshotTape(self._mechanics, named), setup, RELATIVE)
        if self._scene.couplings:
            snapshot = SnapshotTape(self._mechanics, named).at(setup.values, entered, 0.0)
            check_limits(setup.contacts, snapshot.limits)
        tape = self._tapes.at(controls)
        near = setup.tolerances["gap"]
        closed = max(ROUNDING * setup.scales.length, setup.scales.rounding)
        off = np.zeros(len(setup.contacts), dtype=np.bool_)
        measured = tape.contacts(setup.values, setup.initial)
        conditions = self._numbers.conditions
        if controls != self._tapes.initial:
            conditions = self._tapes.conditions(controls)
        here = conditions.at(setup, entered, 0.0)
        # Both edges of a valley hold a point at the kink.
        kinks = np.flatnonzero((np.abs(measured[:, 0]) <= near) & (measured[:, 4] > 0.0)).tolist()
        failing = conditions.first(here.with_boundary(here.verdicts(), kinks, ()))
        for i, (law, row) in enumerate(zip(setup.contacts, measured.tolist(), strict=True)):
            buried = row[0] < -near and self._scene.initial_modes.get(law.name) == OFF
            off[i] = failing[i] != "" or (OFF in law.states and buried)
            if off[i]:
                continue
            check_place(self._scene, law.name, row[:3])
            if not law.coupling and self._scene.contacts[law.name].stiffness is None:
                slow = setup.tolerances["speed"]
                check_start(self._scene, law, row[:3], near, near, slow)
                warnings += hovering_warnings(self._scene, setup.scales, closed, [law.name], [row])
        slow, sticks = (np.abs(measured[:, 1:3]) <= setup.tolerances["speed"]).T
        # A contact that could slide may have another motion as good.
        sliding = slow & ~sticks & (np.abs(measured[:, 0]) <= near) & ~off
        sliding[len(self._scene.contacts) :] = False

        new_trial = partial(SteppedScene, self._tapes, self._numbers, setup, off, allowed, controls)

        def try_step(closed: Bools) -> tuple[SteppedScene, Chunk]:
            trial = new_trial()
            trial.press(closed)
            return trial, trial.steps(0.0, h, setup.initial, 1)

        h = _trial_step(setup)
        trial, first = try_step(np.zeros_like(off))
        codes = first.modes[0]
        # Contacts that strike at once are free before. Jamming ones slide before, and so do those
        # that the short step stops.
        slides = np.where(measured[:, 2] > 0.0, SLIDE_PLUS, SLIDE_MINUS)
        slips = slow & (first.struck[0] | ((codes == PIN) & ~sticks))
        codes = np.where(slips, slides, np.where(first.struck[0], FREE, codes))
        # Contacts without a load are closed if they bear in the first step, or, as a taut rope, in
        # the next steps.
        idle = slow & (np.abs(measured[:, 0]) <= near) & ~off & (codes == FREE)
        if idle.any():
            touches, idle, later = idle, np.zeros_like(off), new_trial()
            later.keep(touches, setup.initial)
            with suppress(SimulationError):  # of the first steps of the run
                steps = later.steps(0.0, step or _LONGER * h, setup.initial, HOLDING + 1)
                idle = touches & ~np.any((steps.modes == FREE) | steps.struck, axis=0)
                codes = np.where(idle, steps.modes[0], codes)
                if np.any(touches & ~idle):
                    soon = new_trial().steps(0.0, step or _LONGER * h, setup.initial, 1)
                    codes = np.where(touches & ~idle & ~soon.struck[0], soon.modes[0], codes)
        if sliding.any() and try_step(sliding)[1].stats[0, CHOSEN]:
            warnings.append(f"at the start {INDETERMINATE}")
        if trial.filled:
            warnings.append(
                "coordinates without an inertia of their own are computed with 1e-9 of the bodies' "
                "at the contacts"
            )
        return codes, off, idle, tuple(warnings), first.solved[0]

    def _cut(self, setup: SceneSetup) -> Iterator[str]:
        """Yield a warning for each friction coefficient that is reduced, or is round-off."""
        for law in setup.contacts:
            if law.cone_t * STEEPEST > law.cone_n and "free" in law.states and not law.coupling:
                mu = math.inf if law.cone_n == 0.0 else law.cone_t / law.cone_n
                yield f"contact {law.name!r}: friction {mu:g} is replaced by {1.0 / STEEPEST:g}"
            elif 0.0 < law.cone_t < _LEAST_FRICTION * law.cone_n and not law.coupling:
                yield (
                    f"contact {law.name!r}: with friction {law.cone_t / law.cone_n:g} steps do not "
                    "tell a slide from a pin; write 0"
                )
