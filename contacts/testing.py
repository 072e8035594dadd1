"""Properties of every run of a scene with contacts, for the tests of models.

They are computed from the scene's own quantities (gap, V, H, energy), not from the guards of the
automaton that was run. See `statechart.testing` for how to use them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import sympy as sp
from numpy.typing import NDArray
from pydantic import ValidationError

from contacts.mechanics import Mechanics
from contacts.modes import OFF, OPEN
from contacts.scene import Scene
from contacts.setup import SceneSetup, cones, scene_parameters
from contacts.symmetry import mirrored, rescaled
from statechart.comparison import Reading, assert_same
from statechart.formula import parse
from statechart.testing import Case, Property, Subject, dense
from statechart.trace import Arc, Key, Trace

__all__ = [
    "assert_cone",
    "assert_energy",
    "assert_gaps",
    "assert_impulses",
    "assert_no_force_when_free",
    "properties",
]

Array = NDArray[np.float64]

_ROUNDING = 1e-13
# Errors of the energy add up to at most so many times steps times tolerance.
_ENERGY = 100.0
# Nodes and weights that integrate the power from one point of the grid to the next.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def assert_gaps(scene: Scene, subject: Subject, trace: Trace) -> None:
    """Check that no contact point is inside its surface, unless off, by more than gap_tol."""
    gaps = [subject.automaton.observables[f"{name}.gap"] for name in scene.contacts]
    for arc, tau, times in _points(trace):
        values = subject.values(trace, gaps, arc.states(tau), times)
        off = [state == OFF for state in arc.mode[: len(gaps)]]
        values[:, off] = np.inf
        allowed = trace.tolerances["gap"] * (1.0 + _ROUNDING) + _rounding(trace, arc, tau)
        if not (values >= -allowed).all():
            m, k = np.unravel_index(int(np.argmin(values)), values.shape)
            raise AssertionError(
                f"{list(scene.contacts)[k]} is {-values[m, k]:.6g} deep in its surface "
                f"at t = {times[m]:.17g} in {subject.automaton.label(arc.mode)}"
            )


def assert_cone(scene: Scene, subject: Subject, trace: Trace) -> None:
    """Check that V >= 0 and |H| <= mu V wherever a contact is closed."""
    for arc, times, forces in _forces(scene, subject, trace):
        edges = _edges(scene, trace, arc.mode)
        for k, (name, state) in enumerate(_states(scene, arc)):
            if state in OPEN:
                continue
            V, H = forces[:, 2 * k], forces[:, 2 * k + 1]
            n, t = edges[name]
            allowed = trace.tolerances["force"] + _ROUNDING * np.hypot(V, H)
            _no_less(V, -allowed, f"{name}.V", times, state)
            _no_less(t * V - n * np.abs(H), -allowed, f"{name}: mu V - |H|", times, state)


def assert_no_force_when_free(scene: Scene, subject: Subject, trace: Trace) -> None:
    """Check that a contact that is free has no force."""
    for arc, times, forces in _forces(scene, subject, trace):
        for k, (name, state) in enumerate(_states(scene, arc)):
            if state in OPEN and (forces[:, 2 * k : 2 * k + 2] != 0.0).any():
                raise AssertionError(f"{name} is {state} at t = {times[0]:.17g} and has a force")


def assert_impulses(scene: Scene, trace: Trace) -> None:
    """Check that impulses push, and stay in the cone of friction."""
    for jump in trace.jumps:
        edges = _edges(scene, trace, jump.source)
        for name, (normal, tangential) in jump.impulse.items():
            n, t = edges[name]
            allowed = 100.0 * _ROUNDING * math.hypot(normal, tangential)
            where = f"the impulse of {name} at t = {jump.t:.17g}"
            assert normal >= -allowed, f"{where} pulls: {normal:.6g}"
            outside = n * abs(tangential) - t * normal
            assert outside <= allowed, f"{where} is outside the cone: {tangential:.6g}/{normal:.6g}"


def assert_energy(mechanics: Mechanics, subject: Subject, trace: Trace) -> None:
    """Check that energy, less the work of forces and drives, never grows; impacts included."""
    energy, power = mechanics.energy, mechanics.power
    points: list[tuple[float, float, str]] = []  # (time, energy less work, where)
    work, size, j = 0.0, 0.0, 0

    def add(states: Array, times: Array, done: Array, where: str) -> None:
        nonlocal size
        values = subject.values(trace, [energy], states, times)[:, 0]
        size = max(size, float(np.abs(values).max()), float(np.abs(done).max()))
        points.extend(
            (t, e, where) for t, e in zip(times.tolist(), (values - done).tolist(), strict=True)
        )

    def jumps(until: int) -> None:
        for jump in trace.jumps[j:until]:
            states, times = np.array([jump.before, jump.after]), np.full(2, jump.t)
            add(states, times, np.full(2, work), f"by {jump.region} {jump.cause}")

    for arc, tau, _ in _points(trace):
        jumps(arc.j)
        j = arc.j
        grid = np.concatenate([[0.0], tau, [arc.duration]])
        done = np.full(len(grid), work)
        if power != 0:
            middle, half = (grid[1:] + grid[:-1]) / 2, np.diff(grid) / 2
            nodes = (middle[:, None] + half[:, None] * _NODES).ravel()
            powers = subject.values(
                trace,
                [power],
                arc.states(nodes),
                arc.start.high + (arc.start.low + nodes),
                subject.mode(trace, arc),
            )
            parts = (powers.reshape(-1, len(_NODES)) * _WEIGHTS).sum(axis=1) * half
            done[1:] += np.cumsum(parts)
            work = float(done[-1])
        times = arc.start.high + (arc.start.low + grid)
        add(arc.states(grid), times, done, f"in {subject.automaton.label(arc.mode)}")
    jumps(len(trace.jumps))
    error = max(trace.counts["steps"] * trace.tolerance, _ROUNDING)
    # At rest there is no energy to be relative to: what a force does over the gap's tolerance.
    names = mechanics.scene.parameters
    overrides = {name: trace.parameters[name] for name in names}
    setup = subject.automaton.laws.setup(overrides, trace.tolerance)
    assert isinstance(setup, SceneSetup)
    allowed = _ENERGY * error * size + setup.scales.force * trace.tolerances["gap"]
    least = math.inf
    for t, value, where in points:
        if value > least + allowed:
            raise AssertionError(
                f"energy grows by {value - least:.6g} up to t = {t:.17g} {where}; "
                f"errors explain {allowed:.1e}"
            )
        least = min(least, value)


def properties(scene: Scene) -> tuple[Property, ...]:
    """Return what holds for every scene, besides what holds for every automaton."""
    parameters = scene_parameters(scene)
    mechanics = Mechanics(scene, parameters.symbols, cones(scene, parameters.symbols))
    none = "" if scene.contacts else "the scene has no contacts"
    free = any("free" in contact.kinds for contact in scene.contacts.values())
    return (
        Property("no contact is inside its surface", _each(scene, assert_gaps), none),
        Property("V >= 0 and |H| <= mu V", _each(scene, assert_cone), none),
        Property(
            "no force without contact",
            _each(scene, assert_no_force_when_free),
            none or ("" if free else "no contact can be free"),
        ),
        Property(
            "impulses push, within friction",
            _each(scene, lambda scene, _, trace: assert_impulses(scene, trace)),
            none or ("" if free else "no contact can be free"),
        ),
        Property(
            "energy never grows",
            _each(scene, lambda _, subject, trace: assert_energy(mechanics, subject, trace)),
        ),
        _relation("the mirror image moves as the image", scene, mirrored),
        _relation("other units give the same motion", scene, rescaled),
    )


def _relation(
    name: str, scene: Scene, transform: Callable[[Scene], tuple[Scene, Reading]]
) -> Property:
    """Return the property that the transformed scene has the transformed runs."""
    try:
        changed, reading = transform(scene)
    except ValidationError as error:
        reason = error.errors(include_url=False)[0]["msg"]
        return Property(name, lambda case: None, f"the scene cannot be transformed: {reason}")
    subject: list[Subject] = []

    def holds(case: Case) -> None:
        if not subject:
            subject.append(Subject(changed))
        other = subject[0].case(case.parameters)
        trace = case.sound[0]
        image = other.trace
        assert image.outcome is trace.outcome, f"the changed scene ends: {image.message}"
        assert_same(trace, image, case.sensitivity, reading=reading)

    return Property(name, holds)


def _each(scene: Scene, check: Callable[[Scene, Subject, Trace], None]) -> Callable[[Case], None]:
    def holds(case: Case) -> None:
        for trace in case.traces.values():
            try:
                check(scene, case.subject, trace)
            except AssertionError as error:
                raise AssertionError(f"{trace.engine}: {error}") from None

    return holds


def _points(trace: Trace) -> Iterator[tuple[Arc, Array, Array]]:
    for arc, tau in dense(trace):
        yield arc, tau, arc.start.high + (arc.start.low + tau)


def _forces(scene: Scene, subject: Subject, trace: Trace) -> Iterator[tuple[Arc, Array, Array]]:
    """Yield arcs with times and V, H of every contact at them."""
    expressions: Sequence[sp.Expr] = [
        subject.automaton.observables[f"{name}.{force}"]
        for name in scene.contacts
        for force in ("V", "H")
    ]
    for arc, tau, times in _points(trace):
        mode = subject.mode(trace, arc)
        yield arc, times, subject.values(trace, expressions, arc.states(tau), times, mode)


def _states(scene: Scene, arc: Arc) -> Iterator[tuple[str, str]]:
    """Yield every contact with its mode."""
    return zip(scene.contacts, arc.flow, strict=False)  # controllers follow


def _edges(scene: Scene, trace: Trace, mode: Key) -> dict[str, tuple[float, float]]:
    """Return the cone's unit edge (1, mu) / hypot(1, mu) of every contact in a mode."""
    values = {name: trace.parameters[name] for name in scene.parameters}
    states = dict(zip(trace.regions, mode, strict=True))
    result = {}
    for name, contact in scene.contacts.items():
        # Without friction declared the contact does not slide, whatever that takes.
        mu = math.inf
        if contact.friction is not None:
            used = parse(contact.friction).names.intersection(scene.controls)
            set_ = {
                control: text
                for region in scene.regions
                for control, text in scene.controlled.values(region, states[region]).items()
                if control in used
            }
            known = {c: parse(text).value(values) for c, text in set_.items()}
            mu = parse(contact.friction).value({**values, **known})
        result[name] = (
            (0.0, 1.0) if math.isinf(mu) else (1.0 / math.hypot(1.0, mu), mu / math.hypot(1.0, mu))
        )
    return result


def _rounding(trace: Trace, arc: Arc, tau: Array) -> float:
    return _ROUNDING * float(np.abs(arc.coefficients[:, :, 0]).max())


def _no_less(values: Array, least: Array, what: str, times: Array, state: str) -> None:
    if not (values >= least).all():
        m = int(np.argmin(values - least))
        raise AssertionError(f"{what} is {values[m]:.6g} at t = {times[m]:.17g} in {state}")
