"""Colliding bodies as arrays: outlines, masses, surfaces, joints, and contact laws."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.collision_detection.body_numbers import (
    ALONG_X,
    ALONG_Y,
    BOTH,
    GREATEST,
    LEAST,
    ROD,
    ROPE,
    TURN,
    BodyNumbers,
    CouplingNumbers,
    JointNumbers,
    LinkNumbers,
    PieceNumbers,
)
from contacts.collision_detection.surfaces import GRAPH, HOLLOW, LINE, PLATE, ROUND, SurfaceNumbers
from contacts.dynamics.contact_law import edge
from contacts.dynamics.mechanics import Mechanics
from contacts.scene.friction import coefficients
from contacts.scene.parts import Body, Point, Surface
from contacts.scene.scene import Scene
from contacts.scene.shapes import INDEX
from contacts.solvers.dependence import column_scales, dependent_rows, rank
from contacts.solvers.step_impulses import drop_round_off_friction
from contacts.states import CLOSED, implied_couplings, implied_joints
from statechart.arrays import Array, Ints
from statechart.automaton.margin_derivatives import derivative
from statechart.documents.fields import FormulaText, value_of
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import evaluator, parse
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape

Number = Callable[[FormulaText], float]
_Numbers = tuple[float, float, float, float]


def touchable_surfaces(scene: Scene) -> list[str]:
    """Return the names of the surfaces that bodies with shapes can touch."""
    used = {name for collision in scene.collisions.values() for name in collision.surfaces}
    return [name for name in scene.surfaces if name in used]


def surface_numbers(
    scene: Scene, bodies: Sequence[str], known: Mapping[str, float]
) -> SurfaceNumbers:
    """Evaluate the surfaces of a scene."""
    number = evaluator(known)
    surfaces = [scene.surfaces[name] for name in touchable_surfaces(scene)]
    forms = [_form(surface, number) for surface in surfaces]
    heights = tuple(
        str(surface.height)
        for (kind, _), surface in zip(forms, surfaces, strict=True)
        if kind == GRAPH
    )
    program = _program(heights, tuple(known))
    graphs = np.cumsum([kind == GRAPH for kind, _ in forms], dtype=np.int64) - 1
    values = np.array([*known.values()], dtype=float)

    return SurfaceNumbers(
        np.array([kind for kind, _ in forms], dtype=np.int64),
        np.array([numbers for _, numbers in forms], dtype=float).reshape(-1, 4),
        np.array([-1 if s.body is None else bodies.index(s.body) for s in surfaces], np.int64),
        np.array([s.moves for s in surfaces], np.bool_),
        3 * graphs,
        *program.program,
        values,
    )


def _form(surface: Surface, number: Number) -> tuple[int, _Numbers]:
    """Return the kind of a surface, and its numbers."""
    if surface.straight:
        (x, y), (along, up) = surface.point_and_direction(number)
        return LINE, (x, y, 0.0 - up, along)
    if surface.circle is not None and surface.radius is not None:
        x, y = (number(text) for text in surface.circle)
        return HOLLOW if surface.hollow else ROUND, (x, y, number(surface.radius), 0.0)
    if surface.edge is not None:
        (x0, y0), (x1, y1) = ((number(x), number(y)) for x, y in surface.edge)
        return PLATE, (x0, y0, x1, y1)
    return GRAPH, (0.0, 0.0, 0.0, 0.0)


@lru_cache(maxsize=16)
def _program(heights: tuple[str, ...], names: tuple[str, ...]) -> Tape:
    """Compile heights, their slopes and curvatures over x and parameters."""
    x, parameters = sp.Symbol("x", real=True), symbols_of(names)
    expressions: list[sp.Expr] = []
    for text in heights:
        height = parse(text).to_sympy({**dict(zip(names, parameters, strict=True)), "x": x})
        expressions += [height, sp.diff(height, x), sp.diff(height, x, 2)]
    return compile_tape(
        expressions, variables=(x,), parameters=parameters, time=sp.Symbol("t", real=True)
    )


def symbols_of(names: Sequence[str]) -> tuple[sp.Symbol, ...]:
    """Return symbols for parameters."""
    return tuple(sp.Symbol(f"p{i}", real=True) for i in range(len(names)))


_KINDS = {
    ("X", "Y"): BOTH, ("X",): ALONG_X, ("Y",): ALONG_Y, ("T",): ROD, ("V", "H"): ROPE,
}  # fmt: skip
_COMPONENTS = {BOTH: slice(0, 2), ALONG_X: slice(0, 1), ALONG_Y: slice(1, 2)}


def joint_numbers(scene: Scene, names: Sequence[str], known: Mapping[str, float]) -> JointNumbers:
    """Evaluate the joints of a scene; `names` are its bodies, copies one by one."""
    # Captured poses are known when joints close.
    number = evaluator({**dict.fromkeys(scene.controlled.controller_state, 0.0), **known})
    bodies, at, rows, angles = [], [], [], []
    for j, joint in enumerate(scene.joints.values()):
        rebound = number(joint.restitution or 0)
        length = joint.rope if joint.rod is None else joint.rod
        kind = _KINDS[tuple(c for c in joint.components if c != "M")]
        rows.append((kind, j, number(length or 0), rebound))
        if joint.angle is not None:
            angles.append((TURN, j, 0.0, 0.0))
        for bound, limit in zip((LEAST, GREATEST), joint.limits or (), strict=False):
            angles.append((bound, j, number(limit), rebound))
        ends = [joint.point, joint.to if isinstance(joint.to, Point) else None]
        bodies.append([-1 if end is None else names.index(end.body) for end in ends])
        at.append([[0.0, 0.0] if end is None else [*map(number, end.at)] for end in ends])
    table = np.array(rows + angles, dtype=float).reshape(-1, 4)
    owners, initial = table[:, 1].astype(np.int64), scene.controlled.initial
    return JointNumbers(
        np.array(bodies, dtype=np.int64).reshape(-1, 2)[owners],
        np.array(at, dtype=float).reshape(-1, 2, 2)[owners],
        table[:, 0].astype(np.int64),
        owners,
        table[:, 2:].copy(),
        np.array([initial.get(name, CLOSED) == CLOSED for name in scene.joints], dtype=np.bool_),
        np.array([joint.rest is not None for joint in scene.joints.values()], dtype=np.bool_),
    )


def coupling_numbers(
    scene: Scene, names: Sequence[str], known: Mapping[str, float]
) -> CouplingNumbers:
    """Evaluate the couplings of a scene; `names` are its bodies, copies one by one."""
    bodies, signs, holds, at, levers = [], [], [], [], []
    single, number = scene.single_bodies(), evaluator(known)
    for name, coupling in scene.couplings.items():
        guide, own = scene.along_guide(name), scene.coupled(name)
        backward = single[own[0]].prescribed
        pair = [names.index(body) for body in own] if not guide else [names.index(own[0])]
        pair = (pair[::-1] if backward else pair) + [-1] * (2 - len(pair))
        point = scene.joints[coupling.joint or ""].point.at if guide else (0, 0)
        bodies.append(pair)
        signs.append(-1.0 if backward else 1.0)
        holds.append({"X": ALONG_X, "Y": ALONG_Y}.get(guide, TURN))
        at.append([*map(number, point)])
        first = single[own[-1] if backward else own[0]]
        mass, inertia = number(first.mass), number(first.inertia or 0)
        levers.append(1.0 if guide or not inertia > 0.0 else math.sqrt(inertia / mass))
    return CouplingNumbers(
        np.array(bodies, dtype=np.int64).reshape(-1, 2), np.array(signs),
        np.array(holds, dtype=np.int64), np.array(at, dtype=float).reshape(-1, 2),
        np.array(levers),
    )  # fmt: skip


# Allowed violation of angle limits at the start, radians.
_ANGLE_NEAR = 1e-9


def closed_joints(
    scene: Scene, joints: JointNumbers, moved: Array, places: Array, speeds: Array, near: float,
    slow: float,
) -> JointNumbers:  # fmt: skip
    """Check that joints hold at the start; return them closed to round-off.

    Positions declared with eight digits are open by 1e-8, inconsistently in redundant joints: no
    motion closes them all.

    Parameters
    ----------
    scene : Scene
        Its bodies one by one.
    moved : (2, b, 3)
        Poses and rates of the bodies.
    places, speeds : (j, 2)
        Positions and velocities of the world anchors of joints.
    near, slow : float
        Tolerances of distances and speeds.

    Raises
    ------
    DeclarationProblem
        At the first joint that is open, or whose points move apart.
    """
    (at, rates), own = moved, joints.points.copy()
    sizes = joints.sizes.copy()
    for j in np.flatnonzero(joints.kinds == TURN).tolist():
        one, other = joints.bodies[j].tolist()
        sizes[j, 0] = at[one, 2] - (at[other, 2] if other >= 0 else 0.0)
    for j, name in enumerate(scene.joints):
        if not joints.on[j]:
            continue
        ends, moving = [places[j]], [speeds[j]]
        for side in (0, 1):
            b = int(joints.bodies[j, side])
            if b >= 0:
                arm = _arm(at[b, 2], joints.points[j, side])
                ends.insert(side, at[b, :2] + arm)
                moving.insert(side, rates[b, :2] + rates[b, 2] * np.array([-arm[1], arm[0]]))
        _check_angles(joints, j, name, at)
        if joints.kinds[j] in (ROD, ROPE):
            _check_distance(joints, j, name, ends, moving, near, slow)
            continue
        components = _COMPONENTS[int(joints.kinds[j])]
        distance = float(np.hypot.reduce((ends[0] - ends[1])[components]))
        if distance > near:
            u, v = ends[0].tolist()
            x, y = ends[1].tolist()
            raise DeclarationProblem(
                f"joint {name!r} is open at the start: its point is at ({u:.6g}, {v:.6g}), what it "
                f"is held to at ({x:.6g}, {y:.6g})",
                advice=f"move the body by ({x - u:.6g}, {y - v:.6g})",
                loc=("joints", name),
            )
        parting = float(np.hypot.reduce((moving[0] - moving[1])[components]))
        if parting > slow:
            u, v = (moving[1] - moving[0]).tolist()
            raise DeclarationProblem(
                f"joint {name!r} does not hold at the start: its ends move apart at {parting:.6g}",
                advice=f"add ({u:.6g}, {v:.6g}) to the velocity of the body",
                loc=("joints", name),
            )
        missing = np.zeros(2)
        missing[components] = (ends[1] - ends[0])[components]
        own[j, 0] += _arm(-at[joints.bodies[j, 0], 2], missing)
    return joints._replace(points=own, sizes=sizes)


def _check_distance(
    joints: JointNumbers, j: int, name: str, ends: Sequence[Array], moving: Sequence[Array],
    near: float, slow: float,
) -> None:  # fmt: skip
    """Check the initial length of a rod, or that a rope is not longer."""
    way, length = ends[0] - ends[1], float(joints.sizes[j, 0])
    far, rod = float(np.hypot(*way)), joints.kinds[j] == ROD
    if far > length + near or (rod and far < length - near):
        raise DeclarationProblem(
            f"joint {name!r} is {length:.7g} long, and its ends are {far:.7g} apart at the start",
            advice=f"write {'rod' if rod else 'rope'}: {far:.7g}, or start the body elsewhere",
            loc=("joints", name, "rod" if rod else "rope"),
        )
    parting = float(way @ (moving[0] - moving[1])) / far if far > 0.0 else 0.0
    if rod and abs(parting) > slow:
        raise DeclarationProblem(
            f"joint {name!r} does not hold at the start: its ends move apart at {parting:.6g}",
            advice="let the body start with a velocity across the rod",
            loc=("joints", name),
        )


def _check_angles(joints: JointNumbers, owner: int, name: str, at: Array) -> None:
    """Check that a relative angle starts within its limits."""
    for j in np.flatnonzero(joints.owners == owner).tolist():
        one, other = joints.bodies[j].tolist()
        angle = float(at[one, 2] - (at[other, 2] if other >= 0 else 0.0))
        sign = {LEAST: 1.0, GREATEST: -1.0}.get(int(joints.kinds[j]), 0.0)
        if sign * (angle - float(joints.sizes[j, 0])) < -_ANGLE_NEAR:
            raise DeclarationProblem(
                f"the relative angle of joint {name!r} is {angle:.7g} at the start, beyond its "
                f"limit {joints.sizes[j, 0]:.7g}",
                advice="start within the limits",
                loc=("joints", name, "limits"),
            )


def implied_remarks(scene: Scene, bodies: BodyNumbers, at: Array) -> tuple[str, ...]:
    """Return warnings of redundant joints and couplings for bodies `at` (b, 3)."""
    joints, couplings = bodies.joints, bodies.couplings
    rows, names = list[Array](), list[str]()
    every = [*scene.joints]
    for j, holds in enumerate(joints.kinds.tolist()):
        name = every[joints.owners[j]]
        if not joints.on[joints.owners[j]] or holds not in _COMPONENTS:
            continue
        both = np.zeros((2, *at.shape))
        for side in (0, 1):
            b = int(joints.bodies[j, side])
            if b >= 0:
                x, y = _arm(at[b, 2], joints.points[j, side]).tolist()
                both[:, b] += (1 - 2 * side) * np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        constrained = both[_COMPONENTS[int(joints.kinds[j])]]
        rows.append(constrained.reshape(len(constrained), -1))
        names += [name] * len(constrained)
    for (one, other), holds, name in zip(
        couplings.bodies.tolist(), couplings.holds.tolist(), scene.couplings, strict=True
    ):
        turns = np.zeros((1, *at.shape))
        for b, sign in ((one, 1.0), (other, -1.0)):
            if 0 <= b < len(at):
                turns[0, b, 2] = sign
        if holds == TURN:
            rows.append(turns.reshape(1, -1))
            names.append(name)
    if not rows:
        return ()
    matrix = np.concatenate(rows)
    matrix = matrix[:, matrix.any(axis=0)]
    _, sizes, _ = np.linalg.svd(matrix * column_scales(matrix), full_matrices=False)
    if rank(sizes) == len(matrix):
        return ()
    dependent = zip(names, dependent_rows(matrix).tolist(), strict=True)
    implied = [name for name, more in dependent if more]
    held = [name for name in implied if name in scene.couplings]
    joined = [name for name in implied if name not in held]
    return (
        *([implied_joints(joined)] if joined else []),
        *([implied_couplings(held)] if held else []),
    )


def _arm(angle: float, at: Array) -> Array:
    """Return a vector of a body frame, rotated."""
    c, s = math.cos(angle), math.sin(angle)
    turned: Array = np.array([[c, -s], [s, c]]) @ at
    return turned


def body_numbers(
    scene: Scene,
    known: Mapping[str, float],
    owners: Mapping[str, str] | None = None,
    links: LinkNumbers | None = None,
) -> BodyNumbers:
    """Evaluate a scene with collisions; `links` are those of `link_numbers`.

    Raises `DeclarationProblem` if a body that collides has no inertia.
    """
    number = evaluator(known)
    if owners is None:
        owners = scene.owners()
    kinds, laws, materials = _laws(scene, [*owners.values()], number)
    # Evaluated once per kind.
    outlines = [_outline(body, number) for body in scene.bodies.values()]
    pieces = _concatenate_pieces(outlines, kinds)
    sizes = [max((piece.span for piece in outline), default=0.0) for outline in outlines]
    inverse = [
        [0.0] * 3 if body.prescribed else _inverse(owner, body, number)
        for owner, body in scene.bodies.items()
    ]
    prescribed = np.array([body.prescribed for body in scene.bodies.values()])
    gravity = scene.gravity if isinstance(scene.gravity, tuple) else (0, f"-({scene.gravity})")
    return BodyNumbers(
        pieces,
        np.array(sizes)[kinds],
        np.array(inverse)[kinds[~prescribed[kinds]]],
        _fixed(scene, owners, known),
        np.array([number(part) for part in gravity]),
        surface_numbers(scene, [*owners], known),
        kinds,
        laws,
        materials,
        joint_numbers(scene, [*owners], known),
        coupling_numbers(scene, [*owners], known),
        link_numbers(linked_mechanics(scene), known) if links is None else links,
    )


class LinkedMechanics(Mechanics):
    """Equations of the linked bodies."""

    @cached_property
    def program(self) -> Tape:
        """The tape of `LinkNumbers`."""
        frames = [self.body_frame(name) for name in self.scene.bodies]
        poses = [part for (x, y), angle in frames for part in (x, y, angle)]
        gradients = [part for pose in poses for part in self.gradient(pose)]
        forces = self.generalised_forces
        damping = [derivative(force, rate) for force in forces for rate in self.v]
        return self.tape([*poses, *gradients, *self.mass_matrix, *damping, *forces])

    @cached_property
    def firsts(self) -> Ints:
        """For each body, the first that shares coordinates with it."""
        used: list[set[sp.Symbol]] = []
        for name in self.scene.bodies:
            (x, y), angle = self.body_frame(name)
            used.append((x.free_symbols | y.free_symbols | angle.free_symbols) & {*self.q})
        for _ in used:
            used = [set().union(one, *(other for other in used if one & other)) for one in used]
        return np.array([next(i for i, o in enumerate(used) if o & one or o is one)
                         for one in used], dtype=np.int64)  # fmt: skip


def linked_mechanics(scene: Scene) -> LinkedMechanics | None:
    """Return the equations of the linked bodies; None if all are free."""
    linked = {name: body for name, body in scene.bodies.items() if body.linked}
    if not linked:
        return None
    emptied = ("collisions", "joints", "couplings", "forces", "surfaces", "regions", "controls")
    fields = {name: getattr(scene, name) for name in type(scene).model_fields}
    fields |= {"bodies": linked, **{name: {} for name in emptied}}
    return LinkedMechanics(type(scene).model_construct(**fields))


def link_numbers(mechanics: LinkedMechanics | None, known: Mapping[str, float]) -> LinkNumbers:
    """Evaluate the linked bodies."""
    if mechanics is None:
        return LinkNumbers.none()
    scene, tape = mechanics.scene, mechanics.program
    values, _ = mechanics.parameters.values({name: known[name] for name in scene.parameters})
    return LinkNumbers(len(scene.bodies), len(mechanics.q), mechanics.firsts, *tape.program, values)


class _ConvexPiece(NamedTuple):
    """A convex piece of a body: see `PieceNumbers`."""

    corners: Array
    middle: Array
    radius: float
    size: float
    core: float
    span: float


def _outline(body: Body, number: Number) -> list[_ConvexPiece]:
    pieces = []
    for shape in body.shape:
        if shape.disc is not None:
            radius, middle = number(shape.disc), np.array([number(text) for text in shape.at])
            span = radius + float(np.hypot(*middle))
            pieces.append(_ConvexPiece(np.empty((0, 2)), middle, radius, radius, radius, span))
            continue
        corners = np.array([[number(x), number(y)] for x, y in shape.polygon or ()])
        # A single piece is described about the centre of mass.
        middle = np.zeros(2) if len(body.shape) == 1 else corners.mean(axis=0)
        own = corners - middle
        size, span = (float(np.hypot(*c.T).max()) for c in (own, corners))
        pieces.append(_ConvexPiece(corners, middle, 0.0, size, _core(own.tolist()), span))
    return pieces


def _concatenate_pieces(outlines: Sequence[Sequence[_ConvexPiece]], kinds: Ints) -> PieceNumbers:
    """Return the pieces of all bodies, with the outlines of their kinds."""
    counts = np.array([len(outline) for outline in outlines], dtype=np.int64)
    pieces = [piece for outline in outlines for piece in outline]
    first = np.cumsum(counts) - counts
    # Index of the declared piece for every piece of every body.
    which = _concatenated_ranges(first[kinds], counts[kinds])
    many = np.array([len(piece.corners) for piece in pieces], dtype=np.int64)
    corners = np.concatenate([np.empty((0, 2)), *(piece.corners for piece in pieces)])
    middles = np.array([piece.middle for piece in pieces], dtype=float).reshape(-1, 2)
    numbers = [np.array([piece[at] for piece in pieces], dtype=float)[which] for at in range(2, 6)]
    return PieceNumbers(
        np.repeat(np.arange(len(kinds)), counts[kinds]),
        np.concatenate([[0], np.cumsum(counts[kinds])]),
        corners[_concatenated_ranges((np.cumsum(many) - many)[which], many[which])],
        np.concatenate([[0], np.cumsum(many[which])]),
        middles[which],
        *numbers,
    )


def _concatenated_ranges(firsts: Ints, counts: Ints) -> Ints:
    """Return the concatenated ranges of `counts` integers from `firsts` on."""
    ends = np.cumsum(counts)
    runs: Ints = np.arange(counts.sum()) + np.repeat(firsts - ends + counts, counts)
    return runs


def _fixed(scene: Scene, owners: Mapping[str, str], known: Mapping[str, float]) -> Array:
    """Return the poses of fixed bodies (f, 3), evaluated for each copy."""
    poses = []
    for name, owner in owners.items():
        if scene.bodies[owner].fixed:
            body = scene.bodies[owner]
            numbered = known
            if body.copies is not None:
                numbered = {**known, INDEX: float(name.removeprefix(owner))}
            keys = ("x", "y", "angle")
            at = ("bodies", owner, "start")
            poses.append(
                [value_of(t, numbered, *at, k) for k, t in zip(keys, body.path, strict=True)]
            )
    return np.array(poses, dtype=float).reshape(-1, 3)


def _inverse(owner: str, body: Body, number: Number) -> list[float]:
    mass, inertia = number(body.mass), number(body.inertia or 0)
    if body.linked and inertia == 0.0:
        return [1.0 / mass, 1.0 / mass, math.inf]
    if not inertia > 0.0:
        raise DeclarationProblem(
            "a body that collides needs a positive inertia", loc=("bodies", owner, "inertia")
        )
    return [1.0 / mass, 1.0 / mass, 1.0 / inertia]


def _core(corners: Sequence[Sequence[float]]) -> float:
    """Return the inscribed radius of a convex polygon about its origin; 0 if that is outside."""
    ends = zip(corners, [*corners[1:], corners[0]], strict=True)
    cross = [(x * v - y * u) / math.hypot(u - x, v - y) for (x, y), (u, v) in ends]
    return max(0.0, min(cross), min(-turn for turn in cross))


def _laws(scene: Scene, owners: Sequence[str], number: Number) -> tuple[Ints, Ints, Array]:
    """Return kinds of bodies (b,), contact law of each pair (k, k + s), and the laws (m, 8)."""
    kinds = {name: kind for kind, name in enumerate(scene.bodies)}
    surfaces = touchable_surfaces(scene)
    laws = np.full((len(kinds), len(kinds) + len(surfaces)), -1, dtype=np.int64)
    materials = []
    for law, collision in enumerate(scene.collisions.values()):
        static, kinetic = (edge(number(text)) for text in coefficients(collision.friction))
        compliance = (
            number(0 if text is None else text)
            for text in (collision.stiffness, collision.damping, collision.rolling_resistance)
        )
        materials.append((*static, number(collision.restitution or 0), *kinetic, *compliance))
        members = [kinds[owner] for owner in collision.bodies]
        others = [len(kinds) + surfaces.index(name) for name in collision.surfaces]
        for one in members:
            for other in members + others:
                if laws[one, other] < 0:
                    laws[one, other] = law
    edges = np.array(materials)
    return (
        np.array([kinds[owner] for owner in owners], dtype=np.int64),
        laws,
        np.column_stack(
            [
                drop_round_off_friction(edges[:, :2]),
                edges[:, 2],
                drop_round_off_friction(edges[:, 3:5]),
                edges[:, 5:],
            ]
        ),
    )
