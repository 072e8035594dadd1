"""Properties of every run of colliding bodies, computed from their outlines and masses.

Distances are projections on all edge normals, vectorised over the steps, independent of the
collision detection.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from contacts.collision_detection.body_numbers import ROPE, STIFFNESS, BodyNumbers, PieceNumbers
from contacts.collision_detection.surfaces import HOLLOW, LINE, PLATE, ROUND, SurfaceNumbers
from contacts.rigid_bodies.body_step import LEAST
from contacts.rigid_bodies.declared_numbers import body_numbers, led_parts
from contacts.rigid_bodies.mechanics import BodyMechanics
from contacts.rigid_bodies.prescribed_motion import Paths
from contacts.scene.scene import Scene
from contacts.testing.assertions import (
    assert_couples,
    assert_in_cone,
    largest_of,
    no_growth,
    step_ends,
)
from statechart.arrays import ROUND_OFF, Array
from statechart.automaton.trace import Trace
from statechart.kernels.tapes import tape_table
from statechart.testing.properties import Property, each
from statechart.testing.subject import Subject

# Samples of a graph near a disc.
GRAPH_SAMPLES = 65


def assert_depths(
    numbers: BodyNumbers,
    trace: Trace,
    paths: Callable[[Array, Array, Mapping[str, str]], Array] | None = None,
) -> None:
    """Check that no penetration of rigid contacts exceeds a step at the fastest approach.

    On an accelerated obstacle bodies rest at the middle of steps; at their ends they are off by its
    path's distance from a straight one.

    `paths` returns the poses of led bodies at times (m,), for controller variables (m, w) and
    controller states.
    """
    count = len(numbers.inverse)
    first = count + len(numbers.couplings.holds)
    pieces_of_run = [
        *(
            (arc.coefficients[:, :, 0], arc.start.high + arc.times[:-1], arc.mode)
            for arc in trace.arcs
        ),
        (trace.final[None], np.array([trace.t_end]), trace.final_mode),
    ]
    whole, times = (np.concatenate([part[k] for part in pieces_of_run]) for k in range(2))
    states, pieces = numbers.motion(whole)[0], numbers.pieces
    if paths is not None:
        led = [
            paths(
                at,
                some[:, 2 * numbers.size :],
                # Couplings precede controllers.
                dict(zip(trace.regions[first:], mode[first:], strict=True)),
            )
            for some, at, mode in pieces_of_run
        ]
        states = numbers.poses(whole, np.concatenate(led))
    outlines = [_placed(pieces, states[:, b], p) for p, b in enumerate(pieces.bodies.tolist())]
    allowed = trace.tolerances["gap"] * (1.0 + ROUND_OFF)
    for p, q in _contact_candidates(numbers):
        b = int(pieces.bodies[p])
        if b >= count:
            continue
        if q < len(pieces.bodies):
            other = int(pieces.bodies[q])
            reach = numbers.sizes[b] + numbers.sizes[other]
            away = np.hypot(*(states[:, b, :2] - states[:, other, :2]).T)
            if (away > reach).all():
                continue
            gaps = _between(outlines[p], pieces.radii[p], outlines[q], pieces.radii[q])
            obstacle = trace.regions[other] if other < count else "a body that moves as prescribed"
            carrier = other
        else:
            s = q - len(pieces.bodies)
            carrier, outline = numbers.surfaces.carriers[s], outlines[p]
            if carrier == b:
                continue
            if carrier >= 0:
                outline = _in_frames(states[:, carrier], outline)
            gaps = _above(numbers.surfaces, s, outline, pieces.radii[p])
            obstacle = "a surface"
        bent = np.zeros(len(times))
        if carrier >= count:
            arms = np.hypot(*(states[:, b, :2] - states[:, carrier, :2]).T) + numbers.sizes[b]
            bent = _path_bends(states[:, carrier], times, arms)
        k = int(np.argmin(gaps + bent))
        if gaps[k] + bent[k] < -allowed:
            raise AssertionError(
                f"{trace.regions[b]} is {-gaps[k]:.6g} deep in {obstacle} at t = {times[k]:.6g}; "
                f"a step at the fastest approach is {allowed:.3g}"
            )


def _path_bends(poses: Array, times: Array, arms: Array) -> Array:
    """Return bounds (m,) of h^2 a / 8 for an acceleration a of points at these `arms` of a path.

    A pose is h^2 a / 2 from the chord of its neighbours; twice the largest of three is used.
    """
    if len(times) < 3:
        return np.zeros(len(times))
    spans = times[2:] - times[:-2]
    parts = np.divide(times[1:-1] - times[:-2], spans, out=np.zeros_like(spans), where=spans > 0.0)
    off = np.abs(poses[1:-1] - poses[:-2] - parts[:, None] * (poses[2:] - poses[:-2]))
    bends = np.pad(np.hypot(off[:, 0], off[:, 1]) + arms[1:-1] * off[:, 2], 2)
    largest: Array = 0.5 * np.maximum(np.maximum(bends[:-2], bends[1:-1]), bends[2:])
    return largest


def _contact_candidates(numbers: BodyNumbers) -> Iterator[tuple[int, int]]:
    """Yield pairs of pieces, and of pieces and surfaces, with a rigid contact law.

    Surfaces have the indices behind the pieces; joined bodies are excluded.
    """
    bodies, kinds = numbers.pieces.bodies, numbers.laws.shape[0]
    bonds = numbers.joints.bodies[numbers.joints.kinds != ROPE]
    joined = {tuple(sorted(pair)) for pair in bonds.tolist()}
    for p, b in enumerate(bodies.tolist()):
        # Compliant contacts sink in; -1 stands for no contact.
        rigid = np.append(numbers.materials[:, STIFFNESS] == 0.0, False)
        touches = rigid[numbers.laws[numbers.kinds[b]]]
        for q in np.flatnonzero(touches[numbers.kinds[bodies]]).tolist():
            if bodies[q] > b and (b, int(bodies[q])) not in joined:
                yield p, q
        for surface in np.flatnonzero(touches[kinds:]).tolist():
            yield p, len(bodies) + surface


def _placed(pieces: PieceNumbers, states: Array, p: int) -> Array:
    """Return the corners (m, k, 2) of a polygon, or the centre (m, 1, 2) of a disc."""
    own = pieces.vertices[pieces.firsts[p] : pieces.firsts[p + 1]]
    if not len(own):
        own = pieces.middles[p : p + 1]
    cos, sin = np.cos(states[:, 2, None]), np.sin(states[:, 2, None])
    turned = np.stack([cos * own[:, 0] - sin * own[:, 1], sin * own[:, 0] + cos * own[:, 1]], -1)
    return turned + states[:, None, :2]


def _between(one: Array, radius: float, other: Array, other_radius: float) -> Array:
    """Return the gaps (m,) of two bodies; for polygons the largest along their normals."""
    both = radius + other_radius
    if one.shape[1] == 1 and other.shape[1] == 1:
        return np.hypot(*(one - other)[:, 0].T) - both
    if one.shape[1] == 1:
        one, other = other, one
    gaps = _along_normals(one, other)
    if other.shape[1] > 1:
        return np.maximum(gaps, _along_normals(other, one))
    # Beside an edge the disc is nearest to a corner.
    sides = np.roll(one, -1, axis=1) - one
    to = other - one
    fractions = np.clip((to * sides).sum(-1) / (sides * sides).sum(-1), 0.0, 1.0)
    nearest = np.linalg.norm(to - fractions[..., None] * sides, axis=-1).min(axis=1)
    # A plate has no inside, and ends.
    return np.where((gaps > 0.0) | (one.shape[1] == 2), nearest, gaps) - both


def _in_frames(frames: Array, points: Array) -> Array:
    cos, sin = np.cos(frames[:, 2, None]), np.sin(frames[:, 2, None])
    dx, dy = np.moveaxis(points - frames[:, None, :2], -1, 0)
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx], -1)


def _above(surfaces: SurfaceNumbers, s: int, outline: Array, radius: float) -> Array:
    """Return upper bounds of the gaps (m,) between a surface and a body in its frame."""
    kind, (a, b, c, d) = surfaces.kinds[s], surfaces.numbers[s].tolist()
    if kind == LINE:
        return np.asarray(((outline - [a, b]) @ np.array([c, d])).min(axis=1) - radius)
    if kind == HOLLOW:
        return np.asarray(c - np.hypot(*(outline - [a, b]).T).T.max(axis=1) - radius)
    if kind == ROUND:
        return _between(outline, radius, np.tile([[a, b]], (len(outline), 1, 1)), c)
    if kind == PLATE:
        return _between(outline, radius, np.tile([[a, b], [c, d]], (len(outline), 1, 1)), 0.0)
    # Sampled points of the graph are not nearer than the nearest one.
    tried = np.linspace(-radius, radius, GRAPH_SAMPLES) if radius > 0.0 else np.zeros(1)
    x = outline[..., 0, None] + tried
    heights = tape_table(
        surfaces.code, surfaces.constants, surfaces.outputs, 0, x.reshape(-1, 1), surfaces.values,
        np.zeros(x.size),
    )[:, surfaces.graphs[s]].reshape(x.shape)  # fmt: skip
    over = outline[..., 1, None] - heights
    away = np.where(over > 0.0, np.hypot(tried, over), over)
    return np.asarray(away.min(axis=(1, 2)) - radius)


def _along_normals(one: Array, other: Array) -> Array:
    """Return the largest distance (m,) of the points `other` along a normal of `one`."""
    sides = np.roll(one, -1, axis=1) - one
    normals = np.stack([sides[..., 1], -sides[..., 0]], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    away = np.einsum("mkd,mjd->mkj", normals, other) - (normals * one).sum(-1)[..., None]
    return np.asarray(away.min(axis=2).max(axis=1))


def assert_free_fall(numbers: BodyNumbers, trace: Trace) -> None:
    """Check that only gravity acts on a free body."""
    assert trace.step is not None
    count, n = numbers.free, numbers.size
    fall, arms = np.array([*numbers.gravity, 0.0]), np.ones((count, 3))
    inverse = numbers.inverse[:count]
    arms[:, 2] = numbers.sizes[:count] * inverse[:, 2] / inverse[:, 0]
    for arc in trace.arcs:
        assert arc.solved is not None  # steps record accelerations
        free = np.array([state == "free" for state in arc.mode[:count]])
        # The halves of a step with an impact have one mode each, and the forces of the step.
        whole = step_ends(trace, arc)
        off = np.abs(arc.solved[whole, : 3 * count].reshape(-1, count, 3)[:, free] - fall)
        rates = arc.coefficients[whole, n : n + 3 * count, 0]
        speeds = np.abs(rates).reshape(-1, count, 3)[:, free]
        # Smaller forces, at the end of their lever arm, are no contact.
        allowed = LEAST * np.abs(fall).max() * arms[free] + ROUND_OFF * speeds / trace.step
        if (off > allowed).any():
            b = np.flatnonzero(free)[int(np.argmax((off > allowed).any(axis=(0, 2))))]
            raise AssertionError(
                f"{trace.regions[b]} is free from t = {arc.start.high:.6g} and does not fall"
            )


def assert_impulses_of_bodies(numbers: BodyNumbers, trace: Trace) -> None:
    """Check that impulses push, within the largest friction of the body's contacts."""
    largest = largest_of(jump.impulse for jump in trace.jumps)
    for jump in trace.jumps:
        for name, impulse in jump.impulse.items():
            b, kinds = trace.regions.index(name), len(numbers.laws)
            # Carriers of surfaces receive the impulses on them.
            carried = np.flatnonzero(numbers.surfaces.carriers == b)
            laws = np.append(numbers.laws[numbers.kinds[b]], numbers.laws[:, kinds + carried])
            edges = numbers.materials[np.unique(laws[laws >= 0])]
            n, t, *_ = min(edges, key=lambda edge: float(edge[0]))
            assert_in_cone(impulse, (n, t), largest, f"on {name} at t = {jump.t:.6g}")


def assert_energy_of_steps(numbers: BodyNumbers, subject: Subject, trace: Trace) -> None:
    """Check that the energy grows in no step by more than ``h^2/8 f^T M^-1 f``."""
    assert trace.step is not None
    energy = [subject.automaton.observables["energy"]]
    points: list[tuple[float, float, str]] = []
    for arc in trace.arcs:
        ends = arc.times[step_ends(trace, arc)]
        times = arc.start.high + ends
        values = subject.values(trace, energy, arc.states(ends), times)[:, 0]
        where = f"in {subject.automaton.label(arc.mode)}"
        points += [(t, e, where) for t, e in zip(times.tolist(), values.tolist(), strict=True)]
    size = max((abs(e) for _, e, _ in points), default=0.0)
    weights = float(numbers.gravity @ numbers.gravity) / numbers.inverse[: numbers.free, 0]
    rate = trace.step / 8.0 * (float(weights.sum()) + _pull(numbers, trace))
    no_growth(points, 100.0 * ROUND_OFF * size + rate * trace.step, rate)


def _pull(numbers: BodyNumbers, trace: Trace) -> float:
    """Return the largest ``f^T M^-1 f`` of the coordinates in the steps of a run."""
    states = np.concatenate([arc.coefficients[:, :, 0] for arc in trace.arcs])
    masses, forces = numbers.inertia(states)
    pulled = forces[:, :, None] * np.linalg.solve(masses, forces[:, :, None])
    return float(pulled.sum(axis=(1, 2)).max(initial=0.0))


def _scene(subject: Subject) -> Scene:
    assert isinstance(subject.model, Scene)
    return subject.model


def _body_numbers(subject: Subject, trace: Trace) -> BodyNumbers:
    scene = _scene(subject)
    overrides = {name: trace.parameters[name] for name in scene.parameters}
    return body_numbers(scene, scene.values(overrides))


def _depths(subject: Subject, trace: Trace) -> None:
    scene = _scene(subject).expanded
    paths = Paths(BodyMechanics(scene))

    def at(times: Array, memories: Array, states: Mapping[str, str]) -> Array:
        known = {name: states[name] for name in scene.controlled.flat}
        return paths.at(trace.values, times, memories, known)

    assert_depths(_body_numbers(subject, trace), trace, at)


def _energy(subject: Subject, trace: Trace) -> None:
    numbers = _body_numbers(subject, trace)
    # Prescribed motion and forces do work.
    bodies, surfaces, _ = led_parts(_scene(subject))
    if not (bodies or surfaces or _pushed(subject)):
        assert_energy_of_steps(numbers, subject, trace)


def _fall(subject: Subject, trace: Trace) -> None:
    if not (_pushed(subject) or _scene(subject).couplings):
        assert_free_fall(_body_numbers(subject, trace), trace)


def _couples(subject: Subject, trace: Trace) -> None:
    assert_couples(BodyMechanics(_scene(subject)), subject, trace)


def _impulses(subject: Subject, trace: Trace) -> None:
    assert_impulses_of_bodies(_body_numbers(subject, trace), trace)


def _pushed(subject: Subject) -> bool:
    scene = _scene(subject)
    return bool(scene.forces or scene.joints)


def body_properties(declared: Scene) -> tuple[Property, ...]:
    """Return the properties of a scene of colliding bodies."""
    soft = [law.stiffness is not None for law in declared.collisions.values()]
    limits = [Property("couples are within their limits", each(_couples))]
    return (
        Property(
            "no body is deeper than a step takes it",
            each(_depths),
            "compliant contacts sink in" if all(soft) else "",
        ),
        Property("no force without contact", each(_fall)),
        Property("impulses push, within friction", each(_impulses)),
        *(limits if declared.couplings else []),
        Property(
            "energy grows by no more than the scheme's bound",
            each(_energy),
            "compliant contacts give back what they store" if any(soft) else "",
        ),
    )
