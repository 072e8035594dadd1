"""Properties of every run of a scene with contacts, for the tests of models.

They are computed from the scene's own quantities (gap, V, H, energy), not from the guards of the
automaton. See `statechart.testing` for their use.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np
import sympy as sp

from contacts.dynamics.contact_law import edges
from contacts.dynamics.geometry import Vector
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.scene.scene import Scene
from contacts.states import OPEN
from contacts.testing.assertions import (
    assert_couples,
    assert_in_cone,
    assert_no_less,
    largest_of,
    missed_by_slopes,
    no_growth,
    step_ends,
)
from contacts.testing.symmetry import image_properties
from contacts.testing.violations import cone_edges
from contacts.time_stepping.equations import HOLDING
from statechart.arrays import ROUND_OFF, Array
from statechart.automaton.laws import moving_mode
from statechart.automaton.trace import Arc, Jump, Trace
from statechart.testing.guards import dense
from statechart.testing.properties import Property, each
from statechart.testing.subject import Subject

# Bound of energy errors, in steps times tolerance.
_ENERGY = 100.0
# Quadrature of the power between grid points.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def assert_gaps(scene: Scene, subject: Subject, trace: Trace) -> None:
    """Check that no rigid, enabled contact point is inside its surface by more than gap_tol.

    At the ends of steps closed contacts are on their constraints; in between dense output of a
    lower order may leave the surface by the defect of its rates.

    Parameters
    ----------
    scene, subject, trace : Scene, Subject, Trace
        Declaration, compiled scene, and a run of it.
    """
    gaps = [subject.automaton.observables[f"{name}.gap"] for name in scene.contacts]
    rigid = [contact.stiffness is None for contact in scene.contacts.values()]
    for arc, tau in dense(trace):
        states = arc.mode[: len(gaps)]
        size = float(np.abs(arc.coefficients[:, :, 0]).max())
        allowed = trace.tolerances["gap"] * (1.0 + ROUND_OFF) + ROUND_OFF * size
        closed = [s not in OPEN and hard for s, hard in zip(states, rigid, strict=True)]
        free = [s == "free" and hard for s, hard in zip(states, rigid, strict=True)]
        between = (
            allowed + missed_by_slopes(subject, trace, arc, tau, gaps) if any(closed) else allowed
        )
        for local, selected, less in (
            (tau, free, allowed), (tau, closed, between), (arc.times, closed, allowed),
        ):  # fmt: skip
            times = arc.start.high + (arc.start.low + local)
            values = subject.values(trace, gaps, arc.states(local), times)
            values[:, np.logical_not(selected)] = np.inf
            if not (values >= -less).all():
                m, k = np.unravel_index(int(np.argmin(values + less)), values.shape)
                raise AssertionError(
                    f"{list(scene.contacts)[k]} is {-values[m, k]:.6g} deep in its surface "
                    f"at t = {times[m]:.6g} in {subject.automaton.label(arc.mode)}"
                )


def assert_cone(scene: Scene, subject: Subject, trace: Trace) -> None:
    """Check that ``V >= 0`` and ``|H| <= mu V`` for every closed contact.

    Parameters
    ----------
    scene, subject, trace : Scene, Subject, Trace
        Declaration, compiled scene, and a run of it.
    """
    for arc, name, state, times, V, H, slips, used in _sampled_forces(scene, subject, trace):
        if state in OPEN:
            continue
        # In a mode with impulses in all steps the forces are unknown.
        known = ~np.isnan(V) | (trace.step is None)
        V, H, times = V[known], H[known], times[known]
        law = scene.friction_of(name)
        if trace.step is not None and law is not None and law.splits:
            # Steps use the slip at their start.
            n, t = edges(used[known])
        else:
            n, t = cone_edges(scene, trace, arc.mode, name, state, slips[known])
        allowed = trace.tolerances["force"] + ROUND_OFF * np.hypot(V, H)
        assert_no_less(V, -allowed, f"{name}.V", times, state)
        assert_no_less(t * V - n * np.abs(H), -allowed, f"{name}: mu V - |H|", times, state)


def assert_no_force_when_free(scene: Scene, subject: Subject, trace: Trace) -> None:
    """Check that a free contact has no force.

    Parameters
    ----------
    scene, subject, trace : Scene, Subject, Trace
        Declaration, compiled scene, and a run of it.
    """
    for _, name, state, times, V, H, *_ in _sampled_forces(scene, subject, trace):
        if state in OPEN and ((V != 0.0) | (H != 0.0)).any():
            raise AssertionError(f"{name} is {state} at t = {times[0]:.6g} and has a force")


def assert_impulses(scene: Scene | Mechanics, subject: Subject, trace: Trace) -> None:
    """Check that impulses push, within the friction cone.

    Parameters
    ----------
    scene : Scene or Mechanics
        The scene, or its mechanics, `contacts.testing.Mechanics(scene.expanded)`.
    subject : Subject
        The compiled scene.
    trace : Trace
        A run of it.
    """
    mechanics = scene if isinstance(scene, Mechanics) else Mechanics(scene.expanded)
    scene = mechanics.scene
    largest = largest_of(jump.impulse for jump in trace.jumps)
    for jump in trace.jumps:
        for name, impulse in jump.impulse.items():
            under = jump.source[len(scene.frictional) :]
            known = mechanics.values_in(dict(zip(scene.controlled.flat, under, strict=True)))
            slip = mechanics.contact(name).slip.xreplace(known)
            slips = subject.values(trace, [slip], jump.before[None], np.array([jump.t]))[0]
            # During the impact the contact may slip either way, or stick.
            n, t = max(
                (
                    cone_edges(scene, trace, jump.source, name, state, size * np.abs(slips))
                    for state, size in (("pin", 0.0), ("slide+", 1.0), ("slide-", -1.0))
                ),
                key=lambda edge: edge[1],
            )
            edge = float(n[0]), float(t[0])
            assert_in_cone(impulse, edge, largest, f"of {name} at t = {jump.t:.6g}")


def assert_energy(mechanics: Mechanics, subject: Subject, trace: Trace) -> None:
    """Check that energy minus the work of forces and drives never grows, including impacts.

    Parameters
    ----------
    mechanics : Mechanics
        Mechanics of the scene, `contacts.testing.Mechanics(scene.expanded)`.
    subject : Subject
        The compiled scene.
    trace : Trace
        A run of it.
    """
    energy = mechanics.energy
    rates = {name: mechanics.surface_rate(name) for name in mechanics.scene.contacts}
    controllers = mechanics.scene.controlled.flat
    led = any(row.path_rate != 0 for row in mechanics.joint_rows)
    points: list[tuple[float, float, str]] = []  # (time, energy minus work, place)
    work, size, j = 0.0, 0.0, 0

    def add(states: Array, times: Array, done: Array, where: str) -> None:
        nonlocal size
        values = subject.values(trace, [energy], states, times)[:, 0]
        size = max(size, float(np.abs(values).max()), float(np.abs(done).max()))
        points.extend(
            (t, e, where) for t, e in zip(times.tolist(), (values - done).tolist(), strict=True)
        )

    def jumps(until: int) -> None:
        nonlocal work
        for jump in trace.jumps[j:until]:
            states, times = np.array([jump.before, jump.after]), np.full(2, jump.t)
            before = work
            for name, impulse in jump.impulse.items():
                if rates[name] != (0, 0):
                    under = jump.source[len(mechanics.scene.frictional) :]
                    known = mechanics.values_in(dict(zip(controllers, under, strict=True)))
                    rate = [part.xreplace(known) for part in rates[name]]
                    moved = subject.values(trace, rate, states[:1], times[:1])[0]
                    work += float(np.dot(impulse, moved))
            if trace.step is not None:
                continue
            if led and jump.impulse:
                work += _work_of_joints(mechanics, subject, trace, jump)
            add(states, times, np.array([before, work]), f"by {jump.region} {jump.cause}")

    for arc, tau in dense(trace):
        jumps(arc.j)
        j = arc.j
        ends = step_ends(trace, arc)
        inner = arc.times[1:-1] if trace.step is not None else tau
        grid = np.concatenate([[0.0], inner, [arc.duration]])
        done = work + _work_of_forces(mechanics, subject, trace, arc, grid)
        if trace.step is not None:
            done += _work_of_catches(mechanics, subject, trace, arc, rates)
        work = float(done[-1])
        times = arc.start.high + (arc.start.low + grid)
        where = f"in {subject.automaton.label(arc.mode)}"
        add(arc.states(grid)[ends], times[ends], done[ends], where)
    jumps(len(trace.jumps))
    if trace.step is not None:
        growth = _step_growth(mechanics, subject, trace)
        allowed = _ENERGY * ROUND_OFF * size + growth * trace.step
    else:
        growth = 0.0
        error = max(trace.counts["steps"] * trace.tolerance, ROUND_OFF)
        # At rest the scale is the work of forces over the gap tolerance.
        names = mechanics.scene.parameters
        overrides = {name: trace.parameters[name] for name in names}
        setup = subject.automaton.setup(overrides, trace.tolerance)
        assert isinstance(setup, SceneSetup)
        allowed = _ENERGY * error * size + setup.scales.force * trace.tolerances["gap"]
    no_growth(points, allowed, growth)


def _work_of_forces(
    mechanics: Mechanics, subject: Subject, trace: Trace, arc: Arc, grid: Array
) -> Array:
    """Return the work of forces and drives up to each of the times `grid` of an arc.

    Projections onto constraints move closed contacts and joints by round-off without work, against
    forces far larger than weights; by virtual work the constraint forces bound the accumulated
    work.
    """
    if mechanics.power == 0:
        return np.zeros(len(grid))
    constraint_powers: list[sp.Expr] = []
    if trace.step is None:
        for name, state in _contact_modes(mechanics.scene, arc):
            at = mechanics.contact(name)
            constraint_powers += [] if state in OPEN else [at.V * at.gap_rate]
            constraint_powers += [at.H * at.slip] if state == "pin" else []
        constraint_powers += [row.force * row.gap_rate for row in mechanics.joint_rows]
    middle, half = (grid[1:] + grid[:-1]) / 2, np.diff(grid) / 2
    nodes = (middle[:, None] + half[:, None] * _NODES).ravel()
    powers, *off = subject.solved(trace, arc, nodes, [mechanics.power, *constraint_powers]).T
    powers = powers + np.sum(np.abs(off), axis=0)
    parts = (powers.reshape(-1, len(_NODES)) * _WEIGHTS).sum(axis=1) * half
    return np.concatenate([[0.0], np.cumsum(parts)])


def _work_of_catches(
    mechanics: Mechanics, subject: Subject, trace: Trace, arc: Arc, rates: Mapping[str, Vector]
) -> Array:
    """Return the work of moving surfaces in the landing steps of an arc.

    A slow landing is no jump: its steps show the force of the nearest other step. Their impulses
    follow from the change of momentum that the recorded forces do not explain.
    """
    n, work = len(mechanics.q), np.zeros(len(arc.times))
    names = [name for name, state in _contact_modes(mechanics.scene, arc) if state not in OPEN]
    if all(rates[name] == (0, 0) for name in names):
        return work
    steps = np.diff(arc.times)[:HOLDING]
    middles, velocities = arc.times[: len(steps)] + steps / 2, arc.states(arc.times)[:, n : 2 * n]
    contacts = [mechanics.contact(name) for name in names]
    rows = [row for contact in contacts for row in (contact.jacobian_n, contact.jacobian_t)]
    forces = [force for contact in contacts for force in mechanics.forces[contact.name]]
    moved = [part for name in names for part in rates[name]]
    expressions = mechanics.dense((*mechanics.mass_matrix, *rows))
    expressions += [*mechanics.generalised_forces, *forces, *moved]
    for k, values in enumerate(subject.solved(trace, arc, middles, expressions)):
        mass, jacobian, applied, shown, speeds = np.split(
            values, np.cumsum([n * n, n * len(rows), n, len(rows)])
        )
        jacobian = jacobian.reshape(-1, n)
        change = mass.reshape(n, n) @ (velocities[k + 1] - velocities[k])
        change -= steps[k] * (applied + shown @ jacobian)
        work[k + 1 :] += np.linalg.lstsq(jacobian.T, change, rcond=None)[0] @ speeds
    return work


def _work_of_joints(mechanics: Mechanics, subject: Subject, trace: Trace, jump: Jump) -> float:
    rates = [row.path_rate for row in mechanics.joint_rows]
    names = [f"{row.joint}.{row.component}" for row in mechanics.joint_rows]
    impulses = [jump.joint_impulse.get(name, 0.0) for name in names]
    values = subject.values(trace, rates, jump.after[None], np.array([jump.t]))[0]
    return float(np.dot(impulses, values))


def _step_growth(mechanics: Mechanics, subject: Subject, trace: Trace) -> float:
    """Return the energy per time that steps may add: the largest ``h/8 f^T M^-1 f``.

    See `contacts.time_stepping.stepper`.
    """
    assert trace.step is not None
    n = len(mechanics.q)
    expressions = [*mechanics.dense(mechanics.mass_matrix), *mechanics.generalised_forces]
    largest = 0.0
    for arc in trace.arcs:
        values = subject.solved(trace, arc, arc.times[:-1], expressions)
        mass, force = values[:, : n * n].reshape(-1, n, n), values[:, n * n :]
        # Coordinates without inertia carry no force.
        moved = np.einsum("kij,kj->ki", np.linalg.pinv(mass, hermitian=True), force)
        largest = max(largest, float((force * moved).sum(axis=1).max(initial=0.0)))
    return trace.step * largest / 8.0


def properties(declared: Scene) -> tuple[Property, ...]:
    """Return the properties of a scene, besides those of every automaton.

    Parameters
    ----------
    declared : Scene
        The declaration.
    """
    if declared.collisions:
        from contacts.testing.body_properties import body_properties

        return (*body_properties(declared), *image_properties(declared))
    scene = declared.expanded
    mechanics = Mechanics(scene)
    none = "" if scene.contacts else "the scene has no contacts"
    free = any("free" in contact.kinds for contact in scene.contacts.values())
    never_free = none or ("" if free else "no contact can be free")
    limits = [Property("couples are within their limits", each(partial(assert_couples, mechanics)))]
    return (
        Property("no contact is inside its surface", each(partial(assert_gaps, scene)), none),
        Property("V >= 0 and |H| <= mu V", each(partial(assert_cone, scene)), none),
        *(limits if scene.couplings else []),
        Property(
            "no force without contact", each(partial(assert_no_force_when_free, scene)), never_free
        ),
        Property(
            "impulses push, within friction", each(partial(assert_impulses, mechanics)), never_free
        ),
        Property("energy never grows", each(partial(assert_energy, mechanics))),
        *image_properties(declared),
    )


def _sampled_forces(
    scene: Scene, subject: Subject, trace: Trace
) -> Iterator[tuple[Arc, str, str, Array, Array, Array, Array, Array]]:
    """Yield arc, contact, mode, times, and V, H, slip, friction, for every contact and arc."""
    known = subject.automaton.observables
    expressions = [
        known.get(f"{name}.{one}", sp.S.Zero)
        for name in scene.contacts
        for one in ("V", "H", "slip", "friction")
    ]
    for arc, tau in dense(trace):
        times = arc.start.high + (arc.start.low + tau)
        forces = iter(subject.solved(trace, arc, tau, expressions).T)
        for name, state in _contact_modes(scene, arc):
            V, H, slips, used = (next(forces) for _ in range(4))
            yield arc, name, state, times, V, H, slips, used


def _contact_modes(scene: Scene, arc: Arc) -> Iterator[tuple[str, str]]:
    return zip(scene.contacts, moving_mode(arc.roles), strict=False)  # controllers follow
