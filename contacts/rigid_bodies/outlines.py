"""Colliding bodies as numbers: outlines, masses, surfaces, and who touches whom by which law."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers, PieceNumbers
from contacts.dynamics.contact_law import edge
from contacts.rigid_bodies.declared_joints import joint_numbers
from contacts.rigid_bodies.declared_surfaces import surface_numbers, touched
from contacts.scene.parts import Body
from contacts.scene.scene import Scene
from contacts.solvers.step_impulses import smoothed
from statechart.arrays import Array, Ints
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse

_Number = Callable[[str | int | float], float]


def body_numbers(
    scene: Scene, known: Mapping[str, float], owners: Mapping[str, str] | None = None
) -> BodyNumbers:
    """Evaluate a scene with collisions.

    Raises
    ------
    DeclarationProblem
        If a body that collides has no inertia.
    """

    def number(text: str | int | float) -> float:
        return parse(text).value(known)

    if owners is None:
        owners = scene.owners()
    kinds, laws, materials = _laws(scene, [*owners.values()], number)
    # Copies have the numbers of one of them.
    outlines = [_outline(body, number) for body in scene.bodies.values()]
    pieces = _pieces(outlines, kinds)
    sizes = [max((piece.span for piece in outline), default=0.0) for outline in outlines]
    inverse = [_inverse(owner, body, number) for owner, body in scene.bodies.items()]
    declared = scene.gravity
    return BodyNumbers(
        pieces,
        np.array(sizes)[kinds],
        np.array(inverse)[kinds],
        np.array(
            [number(part) for part in declared]
            if isinstance(declared, tuple)
            else [0.0, -number(declared)]
        ),
        surface_numbers(scene, [*owners], known),
        kinds,
        laws,
        materials,
        joint_numbers(scene, [*owners], known),
    )


class _Piece(NamedTuple):
    """A convex piece of a body: see `PieceNumbers`."""

    corners: Array
    middle: Array
    radius: float
    size: float
    core: float
    span: float


def _outline(body: Body, number: _Number) -> list[_Piece]:
    """Return the pieces that a body is made of."""
    found = []
    for shape in body.shape:
        if shape.disc is not None:
            radius, middle = number(shape.disc), np.array([number(text) for text in shape.at])
            span = radius + float(np.hypot(*middle))
            found.append(_Piece(np.empty((0, 2)), middle, radius, radius, radius, span))
            continue
        corners = np.array([[number(x), number(y)] for x, y in shape.polygon or ()])
        # A body of one piece is looked at from its centre of mass.
        middle = np.zeros(2) if len(body.shape) == 1 else corners.mean(axis=0)
        own = corners - middle
        size, span = (float(np.hypot(*c.T).max()) for c in (own, corners))
        found.append(_Piece(corners, middle, 0.0, size, _core(own.tolist()), span))
    return found


def _pieces(outlines: Sequence[Sequence[_Piece]], kinds: Ints) -> PieceNumbers:
    """Return the pieces of all bodies, which have these outlines."""
    counts = np.array([len(outline) for outline in outlines], dtype=np.int64)
    pieces = [piece for outline in outlines for piece in outline]
    first = np.cumsum(counts) - counts
    # Of every piece of every body which of the declared ones it is.
    which = _runs(first[kinds], counts[kinds])
    many = np.array([len(piece.corners) for piece in pieces], dtype=np.int64)
    corners = np.concatenate([np.empty((0, 2)), *(piece.corners for piece in pieces)])
    middles = np.array([piece.middle for piece in pieces], dtype=float).reshape(-1, 2)
    numbers = [np.array([piece[at] for piece in pieces], dtype=float)[which] for at in range(2, 6)]
    return PieceNumbers(
        np.repeat(np.arange(len(kinds)), counts[kinds]),
        np.concatenate([[0], np.cumsum(counts[kinds])]),
        corners[_runs((np.cumsum(many) - many)[which], many[which])],
        np.concatenate([[0], np.cumsum(many[which])]),
        middles[which],
        *numbers,
    )


def _runs(firsts: Ints, counts: Ints) -> Ints:
    """Return one after another the so many whole numbers from each of these on."""
    ends = np.cumsum(counts)
    found: Ints = np.arange(counts.sum()) + np.repeat(firsts - ends + counts, counts)
    return found


def _inverse(owner: str, body: Body, number: _Number) -> list[float]:
    """Return 1/mass, twice, and 1/inertia."""
    mass, inertia = number(body.mass), number(body.inertia or 0)
    if not inertia > 0.0:
        raise DeclarationProblem(
            "a body that collides needs a positive inertia", loc=("bodies", owner, "inertia")
        )
    return [1.0 / mass, 1.0 / mass, 1.0 / inertia]


def _core(corners: Sequence[Sequence[float]]) -> float:
    """Return how far a convex polygon reaches around its origin at least; 0 if that is outside."""
    ends = zip(corners, [*corners[1:], corners[0]], strict=True)
    cross = [(x * v - y * u) / math.hypot(u - x, v - y) for (x, y), (u, v) in ends]
    return max(0.0, min(cross), min(-turn for turn in cross))


def _laws(scene: Scene, owners: Sequence[str], number: _Number) -> tuple[Ints, Ints, Array]:
    """Return kinds of bodies (b,), which law they touch by (k, k + s), and the laws (m, 3)."""
    kinds = {name: kind for kind, name in enumerate(scene.bodies)}
    surfaces = touched(scene)
    laws = np.full((len(kinds), len(kinds) + len(surfaces)), -1, dtype=np.int64)
    materials = []
    for law, collision in enumerate(scene.collisions.values()):
        materials.append((*edge(number(collision.friction)), number(collision.restitution)))
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
        np.column_stack([smoothed(edges[:, :2]), edges[:, 2]]),
    )
