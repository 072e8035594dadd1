"""A scene of points against surfaces, as the time stepper takes it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from contacts.complementarity import contact_problem, solve_lcp
from contacts.kernels import FREE
from contacts.mechanics import Mechanics
from contacts.recognise import Chunk
from contacts.scene_kernels import BAD_INERTIA, DONE, HARD, step_scene
from contacts.setup import SceneSetup
from contacts.step_kernels import LOOSEST, UNKNOWNS, problem, step_residual
from statechart.errors import NonFinite, SingularMode, UnsolvedImpulses
from statechart.tape import Tape, compile_tape

__all__ = ["SteppedScene", "SteppedTape", "widened"]

Array = NDArray[np.float64]


class SteppedTape:
    """What a step needs of a scene, on tape.

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    parameters : sequence of Symbol
        In the order of the values.
    """

    def __init__(self, mechanics: Mechanics, parameters: Sequence[sp.Symbol]) -> None:
        forces = mechanics.generalised_forces
        outputs: list[sp.Expr] = [*mechanics.mass_matrix, *forces]
        derivatives = [sp.diff(force, rate) for force in forces for rate in mechanics.v]
        self.damped = any(derivative != 0 for derivative in derivatives)
        if self.damped:
            outputs += derivatives
        for name in mechanics.scene.contacts:
            geometry = mechanics.contact(name)
            symbols = geometry.symbols
            outputs += [*geometry.jacobian_n, *geometry.jacobian_t, geometry.bias_n]
            outputs += [geometry.bias_t, symbols.gap, symbols.gap_rate, symbols.slip]
        rows = mechanics.joint_rows
        for row in rows:
            outputs += [*row.jacobian, row.gap, row.gap_rate, row.bias, row.redundant]
        self.joint_rows = len(rows)
        self.tape: Tape = compile_tape(
            outputs,
            variables=(*mechanics.q, *mechanics.v),
            parameters=parameters,
            time=mechanics.time,
        )
        # Of the contacts that are never free the normal velocity is given, of pins all of it.
        kinds = [contact.kinds for contact in mechanics.scene.contacts.values()]
        given = [0 if "free" in k else 2 if "pin" in k else 1 for k in kinds]
        self.held = np.array(given, dtype=np.int64)
        self.names = tuple(mechanics.scene.contacts)
        self.size = len(mechanics.q)
        self._gaps = compile_tape(
            [mechanics.contact(name).symbols.gap for name in self.names],
            variables=(*mechanics.q, *mechanics.v),
            parameters=parameters,
            time=mechanics.time,
        )

    def gaps(self, values: Array, state: Array) -> Array:
        """Return the gaps (c,) at the start."""
        return self._gaps.values(state, values, 0.0)


class SteppedScene:
    """One run of such a scene: what lasts from step to step.

    Parameters
    ----------
    source : SteppedTape
        The scene.
    setup : SceneSetup
        The run's numbers.
    """

    def __init__(self, source: SteppedTape, setup: SceneSetup) -> None:
        count = len(setup.contacts)
        self._source = source
        self._values = setup.values
        self._cones = np.array([(law.cone_n, law.cone_t) for law in setup.contacts]).reshape(-1, 2)
        self._restitution = np.array([law.restitution for law in setup.contacts])
        self._level = np.zeros(count)
        self._closed = np.zeros(count, dtype=np.bool_)
        self._bases = np.zeros((count, UNKNOWNS), dtype=np.bool_)
        self._least_gap = np.full(count, np.inf)
        self._least = np.full((count, 2), np.inf)

    @property
    def margins(self) -> dict[str, float]:
        """The least values seen, at the midpoints of steps."""
        found: dict[str, float] = {}
        for i, name in enumerate(self._source.names):
            values = (self._least_gap[i], *self._least[i])
            for what, value in zip(("gap", "V", "mu V - |H|"), values, strict=True):
                if np.isfinite(value):
                    found[f"{name}.{what}"] = float(value)
        return found

    def steps(self, start: float, h: float, state: Array, count: int) -> Chunk:
        """Take steps from `state` (2 n,).

        Returns
        -------
        Chunk
            As many as could be made; see the errors.

        Raises
        ------
        UnsolvedImpulses, SingularMode, NonFinite
            Where not one step can be made.
        """
        source, tape = self._source, self._source.tape
        n, c, r = source.size, len(source.names), source.joint_rows
        states = np.empty((count + 1, 2 * n))
        states[0] = state
        now = state.copy()
        solved, impulses = np.zeros((count, n + 2 * c + r)), np.zeros((count, c, 2))
        codes, struck = np.zeros((count, c), np.int64), np.zeros((count, c), np.bool_)
        gaps = np.full((count, c), np.inf)
        approach, closing = np.zeros(count), np.zeros(count)
        given, done = np.zeros(0), 0
        while done < count:
            taken, status, delassus, least, cones = step_scene(
                tape.code, tape.constants, tape.outputs, source.damped, self._values,
                self._cones, self._restitution, source.held, r, start + done * h, h, now,
                self._level, self._closed, self._bases, given, states[done + 1 :],
                solved[done:], impulses[done:], codes[done:], struck[done:], gaps[done:],
                approach[done:], closing[done:],
            )  # fmt: skip
            done += taken
            if status == DONE:
                break
            try:
                if status != HARD:
                    raise _failure(status)
                given = widened(delassus, least, cones)
            except (UnsolvedImpulses, SingularMode, NonFinite):
                if done == 0:
                    raise
                break
        self._note(gaps[:done], solved[:done, n : n + 2 * c].reshape(done, c, 2), codes[:done])
        return Chunk(
            h,
            states[: done + 1],
            solved[:done],
            codes[:done],
            struck[:done],
            impulses[:done],
            approach[:done],
            closing[:done],
        )

    def _note(self, gaps: Array, forces: Array, codes: NDArray[np.int64]) -> None:
        if not len(gaps):
            return
        self._least_gap = np.minimum(self._least_gap, gaps.min(axis=0))
        normal, tangential = forces[..., 0], np.abs(forces[..., 1])
        cone_n, cone_t = self._cones.T
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = np.where(cone_n > 0.0, cone_t / cone_n * normal - tangential, np.inf)
        for k, values in enumerate((normal, inside)):
            seen = np.where(codes != FREE, values, np.inf).min(axis=0)
            self._least[:, k] = np.minimum(self._least[:, k], seen)


def widened(delassus: Array, free: Array, cones: Array) -> Array:
    """Solve a step's contact problem by all the ways there are; return four unknowns a contact.

    Raises
    ------
    UnsolvedImpulses
        If none finds a solution.
    """
    solution = solve_lcp(*contact_problem(delassus, free, cones))
    z = np.zeros((len(cones), UNKNOWNS))
    at = 0
    for i, (_, cone_t) in enumerate(cones):
        width = UNKNOWNS if cone_t > 0.0 else 1
        z[i, :width] = solution.z[at : at + width]
        at += width
    # Its own measure forgives no row that is the rounding of others.
    left = step_residual(*problem(delassus, free, cones), z.ravel())
    if left > LOOSEST:
        raise UnsolvedImpulses(
            f"{len(cones)} contacts: {solution.status.value} (residual {left:.2g})"
        )
    return z.ravel()


def _failure(status: int) -> SingularMode | NonFinite:
    if status == BAD_INERTIA:
        return SingularMode(
            "the inertias do not determine the motion by themselves: time stepping needs a "
            "positive inertia of every coordinate; the engines taylor and scipy do not"
        )
    return NonFinite("a coordinate became infinite or undefined")
