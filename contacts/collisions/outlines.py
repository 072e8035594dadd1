"""Colliding bodies as numbers: outlines, masses, surfaces, and who touches whom by which law."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from contacts.collisions.body_numbers import BodyNumbers
from contacts.collisions.declared_joints import joint_numbers
from contacts.collisions.declared_surfaces import surface_numbers, touched
from contacts.dynamics.contact_law import edge
from contacts.scene.fields import copies
from contacts.scene.scene import Scene
from contacts.solvers.step_impulses import smoothed
from statechart.arrays import Array, Ints
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse


def owners_of(scene: Scene) -> list[str]:
    """Return what each of the single bodies is a copy of, or itself."""
    return [
        name
        for name, count in copies(scene, scene.values()).items()
        for _ in range(1 if count is None else count)
    ]


def body_numbers(scene: Scene, owners: Sequence[str], known: Mapping[str, float]) -> BodyNumbers:
    """Evaluate a scene with collisions.

    Parameters
    ----------
    scene : Scene
        Its bodies one by one.
    owners : sequence of str
        See `owners_of`.
    known : mapping of str to float
        Parameters.

    Raises
    ------
    DeclarationProblem
        If a body that collides has no inertia.
    """

    def number(text: str | int | float) -> float:
        return parse(text).value(known)

    corners: list[list[float]] = []
    firsts, radii, sizes, cores, inverse = [0], [], [], [], []
    for name, body in scene.bodies.items():
        shape, radius = body.shape, 0.0
        mine: list[list[float]] = []
        if shape is not None and shape.polygon is not None:
            mine = [[number(x), number(y)] for x, y in shape.polygon]
        elif shape is not None and shape.disc is not None:
            radius = number(shape.disc)
        mass, inertia = number(body.mass), number(body.inertia or 0)
        if not inertia > 0.0:
            raise DeclarationProblem(
                "a body that collides needs a positive inertia",
                loc=("bodies", name, "inertia"),
            )
        corners += mine
        firsts.append(len(corners))
        radii.append(radius)
        sizes.append(max([math.hypot(*corner) for corner in mine], default=radius))
        cores.append(_core(mine) if mine else radius)
        inverse.append([1.0 / mass, 1.0 / mass, 1.0 / inertia])
    declared = scene.gravity
    kinds, laws, materials = _laws(scene, owners, number)
    return BodyNumbers(
        np.array(corners, dtype=float).reshape(-1, 2),
        np.array(firsts, dtype=np.int64),
        np.array(radii),
        np.array(sizes),
        np.array(cores),
        np.array(inverse),
        np.array(
            [number(part) for part in declared]
            if isinstance(declared, tuple)
            else [0.0, -number(declared)]
        ),
        surface_numbers(scene, known),
        kinds,
        laws,
        materials,
        joint_numbers(scene, known),
    )


def _core(corners: Sequence[Sequence[float]]) -> float:
    """Return how far a convex polygon reaches around its origin at least; 0 if that is outside."""
    ends = zip(corners, [*corners[1:], corners[0]], strict=True)
    cross = [(x * v - y * u) / math.hypot(u - x, v - y) for (x, y), (u, v) in ends]
    return max(0.0, min(cross), min(-turn for turn in cross))


def _laws(
    scene: Scene, owners: Sequence[str], number: Callable[[str | int | float], float]
) -> tuple[Ints, Ints, Array]:
    """Return kinds of bodies (b,), which law they touch by (k, k + s), and the laws (m, 3)."""
    kinds = {owner: kind for kind, owner in enumerate(dict.fromkeys(owners))}
    surfaces = touched(scene)
    laws = np.full((len(kinds), len(kinds) + len(surfaces)), -1, dtype=np.int64)
    materials = []
    for law, collision in enumerate(scene.collisions.values()):
        materials.append((*edge(number(collision.friction)), number(collision.restitution)))
        members = [kinds[owner] for owner in collision.bodies if owner in kinds]
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
