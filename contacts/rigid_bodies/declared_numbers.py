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


def led_parts(scene: Scene) -> tuple[list[str], list[str], list[str]]:
    """Return the names of led bodies, of moving surfaces, and of joints with an anchor.

    Surfaces and anchors are led bodies without a shape.
    """
    bodies, owners = scene.bodies, scene.owners().items()
    return (
        [n for n, owner in owners if bodies[owner].prescribed and not bodies[owner].fixed],
        [name for name in touchable_surfaces(scene) if scene.surfaces[name].moves],
        [name for name, joint in scene.joints.items() if not isinstance(joint.to, Point)],
    )


def body_names(scene: Scene, owners: Mapping[str, str]) -> list[str]:
    """Return the names of bodies, copies one by one, in the order of `BodyNumbers`.

    `owners` are their declared bodies.
    """
    _, surfaces, joints = led_parts(scene)
    fixed = [name for name, owner in owners.items() if scene.bodies[owner].fixed]
    without_shape = [*map(surface_title, surfaces), *map(joint_title, joints)]
    return [*[*owners][: len(owners) - len(fixed)], *without_shape, *fixed]


def surface_title(name: str) -> str:
    """Return the name of a surface in messages, and of the body that moves it."""
    return f"surface {name!r}"


def joint_title(name: str) -> str:
    """Return the name of a joint in messages, and of the body that is its anchor."""
    return f"joint {name!r}"


def surface_numbers(
    scene: Scene, bodies: Sequence[str], known: Mapping[str, float]
) -> SurfaceNumbers:
    """Evaluate the surfaces of a scene; `bodies` are those of `body_names`."""
    number, names = evaluator(known), touchable_surfaces(scene)
    surfaces = [scene.surfaces[name] for name in names]
    places = {name: b for b, name in enumerate(bodies)}
    forms = [_form(surface, number) for surface in surfaces]
    heights = tuple(
        str(surface.height)
        for (kind, _), surface in zip(forms, surfaces, strict=True)
        if kind == GRAPH
    )
    program = _program(heights, tuple(known))
    graphs = np.cumsum([kind == GRAPH for kind, _ in forms], dtype=np.int64) - 1
    values = np.array([*known.values()], dtype=float)
    carriers = [
        places.get(surface_title(name), -1) if surface.body is None else places[surface.body]
        for name, surface in zip(names, surfaces, strict=True)
    ]
    return SurfaceNumbers(
        np.array([kind for kind, _ in forms], dtype=np.int64),
        np.array([numbers for _, numbers in forms], dtype=float).reshape(-1, 4),
        np.array(carriers, np.int64),
        3 * graphs,
        *program.program,
        values,
    )


def turns_about_pivot(surface: Surface) -> bool:
    """Return whether the body that moves a surface has its origin at the pivot: not with a graph.

    The velocities of a circle that turns about its centre are then exact.
    """
    return surface.moves and (
        surface.straight or surface.circle is not None or surface.edge is not None
    )


def _form(surface: Surface, number: Number) -> tuple[int, _Numbers]:
    """Return the kind of a surface, and its numbers."""
    u, v = map(number, surface.pivot) if turns_about_pivot(surface) else (0.0, 0.0)
    if surface.straight:
        (x, y), (along, up) = surface.point_and_direction(number)
        return LINE, (x - u, y - v, 0.0 - up, along)
    if surface.circle is not None and surface.radius is not None:
        x, y = (number(text) for text in surface.circle)
        return HOLLOW if surface.hollow else ROUND, (x - u, y - v, number(surface.radius), 0.0)
    if surface.edge is not None:
        (x0, y0), (x1, y1) = ((number(x), number(y)) for x, y in surface.edge)
        return PLATE, (x0 - u, y0 - v, x1 - u, y1 - v)
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
# Components x, y and angle that the kinds of joint rows hold.
_HELD = np.zeros((GREATEST + 1, 3))
_HELD[BOTH, :2] = _HELD[ALONG_X, 0] = _HELD[ALONG_Y, 1] = _HELD[TURN, 2] = 1.0


def joint_numbers(scene: Scene, names: Sequence[str], known: Mapping[str, float]) -> JointNumbers:
    """Evaluate the joints of a scene; `names` are those of `body_names`."""
    # Captured poses are known when joints close.
    number = evaluator({**dict.fromkeys(scene.controlled.controller_state, 0.0), **known})
    bodies, at, rows, angles = [], [], [], []
    for j, (name, joint) in enumerate(scene.joints.items()):
        rebound = number(joint.restitution or 0)
        length = joint.rope if joint.rod is None else joint.rod
        kind = _KINDS[tuple(c for c in joint.components if c != "M")]
        rows.append((kind, j, number(length or 0), rebound))
        if joint.angle is not None:
            angles.append((TURN, j, 0.0, 0.0))
        for bound, limit in zip((LEAST, GREATEST), joint.limits or (), strict=False):
            angles.append((bound, j, number(limit), rebound))
        point, to = joint.point, joint.to if isinstance(joint.to, Point) else None
        other, end = (joint_title(name), (0, 0)) if to is None else (to.body, to.at)
        bodies.append([names.index(point.body), names.index(other)])
        at.append([[*map(number, point.at)], [*map(number, end)]])
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
    """Evaluate the couplings of a scene; `names` are those of `body_names`."""
    bodies, signs, holds, at, levers = [], [], [], [], []
    owners, number = scene.owners(), evaluator(known)
    for name, coupling in scene.couplings.items():
        guide, own = scene.along_guide(name), scene.coupled(name)
        backward = scene.bodies[owners[own[0]]].prescribed
        pair = [names.index(body) for body in own] if not guide else [names.index(own[0])]
        pair = (pair[::-1] if backward else pair) + [-1] * (2 - len(pair))
        point = scene.joints[coupling.joint or ""].point.at if guide else (0, 0)
        bodies.append(pair)
        signs.append(-1.0 if backward else 1.0)
        holds.append({"X": ALONG_X, "Y": ALONG_Y}.get(guide, TURN))
        at.append([*map(number, point)])
        first = scene.bodies[owners[own[-1] if backward else own[0]]]
        mass, inertia = number(first.mass), number(first.inertia or 0)
        levers.append(1.0 if guide or not inertia > 0.0 else math.sqrt(inertia / mass))
    return CouplingNumbers(
        np.array(bodies, dtype=np.int64).reshape(-1, 2), np.array(signs),
        np.array(holds, dtype=np.int64), np.array(at, dtype=float).reshape(-1, 2),
        np.array(levers),
    )  # fmt: skip


# Allowed violation of angle limits at the start, radians.
_ANGLE_NEAR = 1e-9


def rotated(angles: Array, points: Array) -> Array:
    """Return points (..., 2) of body frames, rotated by angles (...)."""
    c, s = np.cos(angles), np.sin(angles)
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def joint_ends(joints: JointNumbers, moved: Array) -> tuple[Array, Array, Array]:
    """Return arms, positions and velocities (j, 2, 2) of the ends of joints.

    `moved` (2, b, 3): poses and rates of all bodies.
    """
    poses, rates = moved[:, joints.bodies]
    arms = rotated(poses[..., 2], joints.points)
    turned = rates[..., 2:] * np.stack([-arms[..., 1], arms[..., 0]], axis=-1)
    return arms, poses[..., :2] + arms, rates[..., :2] + turned


def joint_openings(joints: JointNumbers, ends: Array, angles: Array) -> Array:
    """Return by how much joints (j,) are open: distances, and radians of rows of angles."""
    kinds, way = joints.kinds, ends[:, 0] - ends[:, 1]
    beyond = np.where(kinds < TURN, np.hypot(*way.T), angles) - joints.sizes[:, 0]
    beyond[kinds == LEAST] *= -1.0
    far = np.where(np.isin(kinds, (ROD, TURN)), np.abs(beyond), np.maximum(beyond, 0.0))
    open_by: Array = np.where(kinds < ROD, np.hypot(*(way * _HELD[kinds, :2]).T), far)
    return open_by


def closed_joints(
    scene: Scene, joints: JointNumbers, moved: Array, near: float, slow: float
) -> JointNumbers:
    """Check that joints hold at the start; return them closed to round-off.

    Positions declared with eight digits are open by 1e-8, inconsistently in redundant joints: no
    motion closes them all. `moved` (2, b, 3) are poses and rates of all bodies, which `scene` has
    one by one; `near` and `slow` are tolerances. Raises `DeclarationProblem` at the first joint
    that is open, or whose points move apart.
    """
    points, sizes = joints.points.copy(), joints.sizes.copy()
    _, ends, speeds = joint_ends(joints, moved)
    way, parting = ends[:, 1] - ends[:, 0], speeds[:, 1] - speeds[:, 0]
    # No negative zeros.
    across, held = way * _HELD[joints.kinds, :2] + 0.0, parting * _HELD[joints.kinds, :2] + 0.0
    one, other = joints.bodies.T
    angles = moved[0, one, 2] - moved[0, other, 2]
    sizes[joints.kinds == TURN, 0] = angles[joints.kinds == TURN]
    open_by = joint_openings(joints._replace(sizes=sizes), ends, angles)
    for j, owner in enumerate(joints.owners.tolist()):
        name, kind = [*scene.joints][owner], int(joints.kinds[j])
        loc = ("joints", name)
        if not joints.on[owner]:
            continue
        if kind >= TURN and open_by[j] > _ANGLE_NEAR:
            raise DeclarationProblem(
                f"the relative angle of joint {name!r} is {angles[j]:.7g} at the start, beyond its "
                f"limit {sizes[j, 0]:.7g}",
                advice="start within the limits",
                loc=(*loc, "limits"),
            )
        far, apart = float(np.hypot(*way[j])), float(np.hypot(*held[j]))
        change = "add ({:.6g}, {:.6g}) to the velocity of the body".format(*held[j])
        if kind == ROD:
            apart = abs(float(way[j] @ parting[j])) / far if far > 0.0 else 0.0
            change = "let the body start with a velocity across the rod"
        if open_by[j] > near and kind in (ROD, ROPE):
            key = "rod" if kind == ROD else "rope"
            raise DeclarationProblem(
                f"joint {name!r} is {sizes[j, 0]:.7g} long, and its ends are {far:.7g} apart at "
                "the start",
                advice=f"write {key}: {far:.7g}, or start the body elsewhere",
                loc=(*loc, key),
            )
        if kind < ROD and open_by[j] > near:
            at, end = ("({:.6g}, {:.6g})".format(*point) for point in ends[j])
            raise DeclarationProblem(
                f"joint {name!r} is open at the start: its point is at {at}, what it is held to at "
                f"{end}",
                advice="move the body by ({:.6g}, {:.6g})".format(*across[j]),
                loc=loc,
            )
        if apart > slow:
            raise DeclarationProblem(
                f"joint {name!r} does not hold at the start: its ends move apart at {apart:.6g}",
                advice=change,
                loc=loc,
            )
        points[j, 0] += rotated(-moved[0, one[j], 2], across[j])
    return joints._replace(points=points, sizes=sizes)


def implied_remarks(scene: Scene, bodies: BodyNumbers, at: Array) -> tuple[str, ...]:
    """Return warnings of redundant joints and couplings for bodies `at` (b, 3)."""
    joints, couplings, moving = bodies.joints, bodies.couplings, len(bodies.inverse)
    arms, _, _ = joint_ends(joints, np.stack([at, at]))
    held = _HELD[joints.kinds] * joints.on[joints.owners, None]
    j, d = np.nonzero(held)
    c = np.flatnonzero(couplings.holds == TURN)
    pairs = np.concatenate([joints.bodies[j], couplings.bodies[c]])
    rows, i = np.zeros((len(pairs), len(at) + 1, 3)), np.arange(len(j))
    for side, sign in enumerate((1.0, -1.0)):
        rows[i, pairs[i, side], d] += sign
        across = np.stack([-arms[j, side, 1], arms[j, side, 0], np.zeros(len(j))])
        rows[i, pairs[i, side], 2] += sign * across[d, i]
        rows[len(j) :][np.arange(len(c)), pairs[len(j) :, side], 2] += sign
    if not len(rows):
        return ()
    matrix = rows[:, :moving].reshape(len(rows), -1)
    matrix = matrix[:, matrix.any(axis=0)]
    _, sizes, _ = np.linalg.svd(matrix * column_scales(matrix), full_matrices=False)
    if rank(sizes) == len(matrix):
        return ()
    dependent = np.flatnonzero(dependent_rows(matrix)).tolist()
    declared = [*scene.joints]
    joined = [declared[joints.owners[j[k]]] for k in dependent if k < len(j)]
    turns = [[*scene.couplings][c[k - len(j)]] for k in dependent if k >= len(j)]
    return (
        *([implied_joints(joined)] if joined else []),
        *([implied_couplings(turns)] if turns else []),
    )


def body_numbers(
    scene: Scene,
    known: Mapping[str, float],
    owners: Mapping[str, str] | None = None,
    links: LinkNumbers | None = None,
) -> BodyNumbers:
    """Evaluate a scene with collisions; `links` are those of `link_numbers`.

    Raises `DeclarationProblem` if a body that collides has no inertia.
    """
    number, owners = evaluator(known), scene.owners() if owners is None else owners
    names = body_names(scene, owners)
    places = {owner: kind for kind, owner in enumerate(scene.bodies)}
    # The last kind has no shape.
    kinds = np.array([places.get(owners.get(name, ""), len(places)) for name in names], np.int64)
    laws, materials = _laws(scene, number)
    # Evaluated once per kind.
    outlines = [*(_outline(body, number) for body in scene.bodies.values()), []]
    pieces = _concatenate_pieces(outlines, kinds)
    sizes = [max((piece.span for piece in outline), default=0.0) for outline in outlines]
    inverse = [
        [0.0] * 3 if body.prescribed else _inverse(owner, body, number)
        for owner, body in scene.bodies.items()
    ]
    moving = np.array([*(not body.prescribed for body in scene.bodies.values()), False])
    gravity = scene.gravity if isinstance(scene.gravity, tuple) else (0, f"-({scene.gravity})")
    return BodyNumbers(
        pieces,
        np.array(sizes)[kinds],
        np.array(inverse)[kinds[moving[kinds]]],
        _fixed(scene, owners, known),
        np.array([number(part) for part in gravity]),
        surface_numbers(scene, names, known),
        kinds,
        laws,
        materials,
        joint_numbers(scene, names, known),
        coupling_numbers(scene, names, known),
        link_numbers(linked_mechanics(scene), known) if links is None else links,
    )


class LinkedMechanics(Mechanics):
    """Equations of the linked bodies."""

    @cached_property
    def program(self) -> Tape:
        """The tape of `LinkNumbers`."""
        frames = [self.body_frame(name) for name in self.scene.bodies]
        poses = [part for (x, y), angle in frames for part in (x, y, angle)]
        rows = self.dense((*map(self.gradient, poses), *self.mass_matrix))
        forces = self.generalised_forces
        damping = [derivative(force, rate) for force in forces for rate in self.v]
        return self.tape([*poses, *rows, *damping, *forces])

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


# Inscribed radius about the centre of mass, relative to that about the mean of the corners, below
# which the centre is at the boundary: bodies that touch would pass each other.
_INSIDE = 0.1


def _outline(body: Body, number: Number) -> list[_ConvexPiece]:
    pieces = []
    for shape in body.shape:
        if shape.disc is not None:
            radius, middle = number(shape.disc), np.array([number(text) for text in shape.at])
            span = radius + float(np.hypot(*middle))
            pieces.append(_ConvexPiece(np.empty((0, 2)), middle, radius, radius, radius, span))
            continue
        corners = np.array([[number(x), number(y)] for x, y in shape.polygon or ()])
        middle = corners.mean(axis=0)
        own, core = corners - middle, _core((corners - middle).tolist())
        # A single piece is described about the centre of mass, unless that is at its boundary.
        if len(body.shape) == 1 and (about := _core(corners.tolist())) > _INSIDE * core:
            middle, own, core = np.zeros(2), corners, about
        size, span = (float(np.hypot(*c.T).max()) for c in (own, corners))
        pieces.append(_ConvexPiece(corners, middle, 0.0, size, core, span))
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


def _laws(scene: Scene, number: Number) -> tuple[Ints, Array]:
    """Return the contact law of each pair of kinds (k, k + s), and the laws (m, 8)."""
    kinds = {name: kind for kind, name in enumerate(scene.bodies)}
    surfaces, count = touchable_surfaces(scene), len(kinds) + 1
    laws, materials = np.full((count, count + len(surfaces)), -1, dtype=np.int64), []
    for law, collision in enumerate(scene.collisions.values()):
        static, kinetic = (edge(number(text)) for text in coefficients(collision.friction))
        compliance = (
            number(0 if text is None else text)
            for text in (collision.stiffness, collision.damping, collision.rolling_resistance)
        )
        materials.append((*static, number(collision.restitution or 0), *kinetic, *compliance))
        members = [kinds[owner] for owner in collision.bodies]
        others = [count + surfaces.index(name) for name in collision.surfaces]
        for one in members:
            for other in members + others:
                if laws[one, other] < 0:
                    laws[one, other] = law
    edges = np.array(materials)
    return (
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
