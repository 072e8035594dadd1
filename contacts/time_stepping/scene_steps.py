"""A scene of points against surfaces, as the time stepper takes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from contacts.dynamics.contact_law import ContactLaw, cones
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.solvers.contact_lcp_kernels import UNKNOWNS
from contacts.solvers.step_impulses import smoothed
from contacts.states import FREE, OFF_CODE, PIN, SLIDE_MINUS, SLIDE_PLUS, STATES
from contacts.time_stepping.chunk import BAD_INERTIA, Chunk, softened_remark, stepped
from contacts.time_stepping.equations import CONTACT, JOINT
from contacts.time_stepping.limits import StepLimits, check_swing, remarks
from contacts.time_stepping.passing import passed
from contacts.time_stepping.scene_step import step_scene
from statechart.arrays import Array, Bools, Ints
from statechart.errors import NoConsistentMode, NonFinite, SingularMode
from statechart.formulas.tape import Tape

# Beside what a step moves at the scene's speed: what goes no deeper between two looks grazes.
_GRAZED = 0.1
# Slower than this part of the scene's speed, what a contact moves at is no measure of anything.
_SLOWEST = 0.1
# And energies below this part of the scene's are none.
_NEGLIGIBLE = 1e-6
# A landing goes as deep as its approach in a step.
_LANDED = 2.0
_CODES = {state: code for code, state in STATES.items()}


class SteppedTape:
    """What a step needs of a scene, on tape.

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    states : mapping
        Controller -> its state.
    """

    def __init__(self, mechanics: Mechanics, states: Mapping[str, str]) -> None:
        set_: dict[sp.Symbol, sp.Expr] = {}
        for control, value in mechanics.controlled(states):
            set_[control] = value.xreplace(set_)
        forces = [force.xreplace(set_) for force in mechanics.generalised_forces]
        outputs: list[sp.Expr] = [*mechanics.mass_matrix, *forces]
        derivatives = [sp.diff(force, rate) for force in forces for rate in mechanics.v]
        self.damped = any(derivative != 0 for derivative in derivatives)
        if self.damped:
            outputs += derivatives
        self.names = tuple(mechanics.scene.contacts)
        for name in self.names:
            geometry = mechanics.contact(name)
            symbols = geometry.symbols
            outputs += [*geometry.jacobian_n, *geometry.jacobian_t, geometry.bias_n]
            outputs += [geometry.bias_t, symbols.gap, symbols.gap_rate, symbols.slip]
            conditions = [margin.expression.xreplace(set_) for margin in mechanics.conditions(name)]
            outputs.append(sp.Min(*conditions) if conditions else sp.S.One)
        rows = mechanics.joint_rows
        for row in rows:
            outputs += [*row.jacobian, row.gap, row.gap_rate, row.bias, row.redundant]
        self.joint_rows = len(rows)
        self.limits = StepLimits(mechanics, forces)
        # A contact that its condition keeps off passes nothing.
        self.gaps: Tape = mechanics.tape(
            [
                sp.Max(
                    mechanics.contact(name).symbols.gap,
                    *(-m.expression.xreplace(set_) for m in mechanics.conditions(name)),
                )
                for name in self.names
            ]
        )
        outputs += [set_[control] for control in mechanics.controls]
        self.controls = len(mechanics.controls)
        self.tape: Tape = mechanics.tape(
            outputs,
        )
        # Of pins the velocity is given, of slides without friction the normal one.
        self.held = np.array(
            [
                2 if contact.kinds == {"pin"} else 1 if contact.kinds == {"slide"} and smooth else 0
                for contact in mechanics.scene.contacts.values()
                for smooth in (contact.frictionless,)
            ],
            dtype=np.int64,
        )
        declared = mechanics.scene.contacts.values()
        self.slips = np.array(
            [0 if "slide" not in c.kinds else 1 if c.frictionless else 2 for c in declared],
            dtype=np.int64,
        )
        self.size = len(mechanics.q)
        self.plastic = mechanics.scene.simultaneous == "plastic"

    def contacts(self, values: Array, state: Array) -> Array:
        """Return gap, gap rate, slip and condition (c, 4) at the start."""
        n, c = self.size, len(self.names)
        found = self.tape.values(state, values, 0.0)
        first = n * n + n + (n * n if self.damped else 0)
        rows = found[first : first + c * (2 * n + CONTACT)].reshape(c, 2 * n + CONTACT)
        return rows[:, -4:]


@dataclass(eq=False)
class _Memory:
    """What lasts from step to step; see `contacts.time_stepping.scene_step.step_scene`."""

    level: Array
    closed: Bools
    fresh: Ints
    off: Bools
    light: Bools
    bases: Bools
    codes: Ints
    least_gap: Array
    least: Array

    def copy(self) -> _Memory:
        return _Memory(**{name: array.copy() for name, array in vars(self).items()})


class SteppedScene:
    """One run of such a scene.

    Parameters
    ----------
    source : SteppedTape
        The scene.
    setup : SceneSetup
        The run's numbers.
    off : (c,) array of bool
        Contacts that are off at the start.
    """

    def __init__(self, source: SteppedTape, setup: SceneSetup, off: Bools) -> None:
        count = len(setup.contacts)
        self._values, self._near = setup.values, setup.tolerances["gap"]
        self._setup, self._speed = setup, setup.scales.speed
        self._negligible = _NEGLIGIBLE * setup.scales.force * setup.scales.length
        self.switch(source, setup.contacts)
        self._memory = _Memory(
            np.zeros(count),
            np.zeros(count, dtype=np.bool_),
            np.zeros(count, dtype=np.int64),
            off.copy(),
            np.zeros(1, dtype=np.bool_),
            np.zeros((count, UNKNOWNS), dtype=np.bool_),
            np.full(count, FREE),
            np.full(count, np.inf),
            np.full((count, 2), np.inf),
        )
        self._kept = self._memory.copy()
        self._softened = 0
        self._swing = self._missed = self._length = 0.0

    def switch(self, source: SteppedTape, contacts: Sequence[ContactLaw]) -> None:
        """Go on with other forces and coefficients."""
        self._source = source
        self._cones = smoothed(cones(tuple(contacts)))
        self._restitution = np.array([law.restitution for law in contacts])
        allowed = [{_CODES[state] for state in law.states} for law in contacts]
        self._undeclared = np.array(
            [[code not in codes for code in range(len(STATES))] for codes in allowed],
            dtype=np.bool_,
        ).reshape(-1, len(STATES))

    @property
    def filled(self) -> bool:
        """Whether coordinates without an inertia of their own were given one."""
        return bool(self._memory.light[0])

    def forget(self) -> None:
        """Take back the last steps."""
        self._memory = self._kept.copy()

    @property
    def margins(self) -> dict[str, float]:
        """The least values seen, at the midpoints of steps."""
        found: dict[str, float] = {}
        for i, name in enumerate(self._source.names):
            values = (self._memory.least_gap[i], *self._memory.least[i])
            for what, value in zip(("gap", "V", "mu V - |H|"), values, strict=True):
                if np.isfinite(value):
                    found[f"{name}.{what}"] = float(value)
        return found

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader must know of the run."""
        return (
            *softened_remark(self._softened),
            *remarks(self._swing, self._length, self._missed),
        )

    def steps(self, start: float, h: float, state: Array, count: int) -> Chunk:
        """Take steps from `state` (2 n,).

        Returns
        -------
        Chunk
            As many as could be made; see the errors.

        Raises
        ------
        UnsolvedImpulses, SingularMode, NonFinite, NoConsistentMode
            Where not one step can be made.
        """
        source, tape = self._source, self._source.tape
        n, c, r = source.size, len(source.names), source.joint_rows
        chunk = Chunk.room(h, state, n + r + 2 * c + source.controls, c, count)
        self._kept = self._memory.copy()
        memory = self._memory
        self._check_springs(chunk, start)

        def step(
            left: Chunk, done: int, given: Array, softened: bool
        ) -> tuple[int, int, Array, Array, Array]:
            return step_scene(
                tape.code, tape.constants, tape.outputs, source.damped, self._values,
                self._cones, self._restitution, source.plastic, source.held, source.slips, r,
                self._near, _SLOWEST * self._speed, self._negligible, start + done * h,
                memory.level, memory.closed, memory.fresh, memory.off, memory.light, memory.bases,
                given, softened, left,
            )  # fmt: skip

        done, softened = stepped(step, _failure, chunk)
        self._softened += softened
        chunk = chunk.first(self._declared(chunk.codes[:done], start, h))
        forces = chunk.solved[:, n + r : n + r + 2 * c].reshape(len(chunk.codes), c, 2)
        self._note(chunk.gaps, forces, chunk.codes)
        self._look_between(chunk, start)
        return chunk

    def _check_springs(self, chunk: Chunk, start: float) -> None:
        """Raise `StepTooLarge` where steps of this length make springs swing ever farther."""
        source, state = self._source, chunk.states[0]
        n, r = source.size, source.joint_rows
        found = source.tape.values(state, self._values, start)
        first = n * n + n + (n * n if source.damped else 0)
        contacts = found[first : first + len(source.names) * (2 * n + CONTACT)]
        rows = contacts.reshape(len(source.names), 2 * n + CONTACT)
        codes = self._memory.codes
        closed = (codes != FREE) & (codes != OFF_CODE)
        joints = found[first + contacts.size :][: r * (n + JOINT)].reshape(r, n + JOINT)
        held = np.concatenate([rows[closed, :n], rows[codes == PIN, n : 2 * n], joints[:, :n]])
        swing = source.limits.swing(self._values, state, start, held)
        check_swing(swing, chunk.h)
        self._swing, self._length = max(self._swing, swing), max(self._length, chunk.h)

    def _look_between(self, chunk: Chunk, start: float) -> None:
        """Note the first step that passed over a contact, and what steps miss of the forces."""
        gaps, count, h = self._source.gaps, len(chunk.codes), chunk.h
        if not count:
            return
        n = self._source.size
        places, rates = chunk.states[:, :n], chunk.states[:, n:]
        # From each midpoint to the next one, but from where the run starts to the first.
        lengths = np.full(count, h)
        lengths[0] = h if start > 0.0 else 0.5 * h
        lines = np.zeros((count, 2 * n, 2))
        back = lengths - 0.5 * h
        lines[:, :n, 0] = places[:count] - back[:, None] * rates[:count]
        lines[:, :n, 1] = lengths[:, None] * rates[:count]
        lines[:, n:, 0] = rates[:count]
        taking = (chunk.codes != FREE) | chunk.struck
        seen = np.vstack([self._kept.codes != FREE, taking[:-1]])
        times, begin = np.concatenate([[0.0], np.cumsum(lengths)]), start - float(back[0])
        self._missed += self._source.limits.missed(self._setup, begin, times, lines)
        line, _, part = passed(
            *gaps.program,
            gaps.reads,
            gaps.n_fixed,
            self._values,
            begin,
            times,
            lines,
            seen,
            _GRAZED * h * self._speed,
        )
        if line >= 0:
            chunk.passed[line] = part
        # What leaves at its first look, or is deeper than its approach explains, was entered
        # elsewhere.
        deep = (chunk.codes != OFF_CODE) & (chunk.gaps < -self._near)
        deep[1:] &= chunk.gaps[:-1] > 0.0
        first = n * n + n + (n * n if self._source.damped else 0)
        for k, i in np.argwhere(deep).tolist():
            state = np.concatenate([lines[k, :n].sum(axis=1), rates[k]])
            before = gaps.values(lines[k, :, 0], self._values, begin + times[k])[i]
            numbers = self._source.tape.values(state, self._values, begin + times[k + 1])
            rate = numbers[first + i * (2 * n + CONTACT) + 2 * n + 3]
            slow, depth = _GRAZED * self._speed, -chunk.gaps[k, i]
            approach = max(-rate, slow)
            if before > 0.0 and (rate > slow or depth > _LANDED * h * approach):
                chunk.passed[k] = max(chunk.passed[k], min(1.0, h * approach / depth))
                break

    def _declared(self, codes: Ints, start: float, h: float) -> int:
        """Return how many steps take declared modes; replace a stick that only passes.

        Raises
        ------
        NoConsistentMode
            If not even the first does.
        """
        before = np.vstack([self._memory.codes, codes[:-1]])
        slid = (before == SLIDE_PLUS) | (before == SLIDE_MINUS)
        # A slip that turns round in a step is at rest at its end; without friction it may stay so.
        turning = (codes == PIN) & self._undeclared[:, PIN] & (slid | (self._cones[:, 1] == 0.0))
        codes[turning] = np.where(slid, before, SLIDE_PLUS)[turning]
        self._memory.codes = codes[-1] if len(codes) else self._memory.codes
        wrong = self._undeclared[np.arange(codes.shape[1]), codes]
        if not wrong.any():
            return len(codes)
        k = int(np.argmax(wrong.any(axis=1)))
        if k == 0:
            i = int(np.argmax(wrong[0]))
            state = STATES[int(codes[0, i])]
            raise NoConsistentMode(
                f"contact {self._source.names[i]!r} would be {state} by t = {start + h:.9g}, and "
                f"{state.rstrip('+-')} is not among its modes; add it, or end the run before"
            )
        return k

    def _note(self, gaps: Array, forces: Array, codes: Ints) -> None:
        if not len(gaps):
            return
        memory = self._memory
        memory.least_gap = np.minimum(memory.least_gap, gaps.min(axis=0))
        normal, tangential = forces[..., 0], np.abs(forces[..., 1])
        cone_n, cone_t = self._cones.T
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = np.where(cone_n > 0.0, cone_t / cone_n * normal - tangential, np.inf)
        for k, values in enumerate((normal, inside)):
            borne = (codes != FREE) & (codes != OFF_CODE) & ~np.isnan(values)
            seen = np.where(borne, values, np.inf).min(axis=0)
            memory.least[:, k] = np.minimum(memory.least[:, k], seen)


def _failure(status: int) -> SingularMode | NonFinite:
    if status == BAD_INERTIA:
        return SingularMode(
            "the equations do not determine the motion: a coordinate without inertia moves "
            "nothing that could hold it, or what is held contradicts itself"
        )
    return NonFinite("a coordinate became infinite or undefined")
