"""The stage of a scene: a film from the states of a run."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from contacts.dynamics.geometry import Vector, surface_frame
from contacts.dynamics.mechanics import Mechanics
from contacts.pictures.bodies import BodyShapes, disc_of
from contacts.pictures.grounds import grounds, is_straight, line_of
from contacts.pictures.links import compiled
from contacts.pictures.window import ahead, beside, cloud_of, window
from contacts.scene.scene import Scene
from contacts.states import OFF, OPEN
from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.formulas.formula import parse
from statechart.formulas.tape import Tape
from statechart.pictures.film import HATCH, WORLD, Film, Shape, Touch, arrows, cones
from statechart.pictures.stage import Moments

# Of more bodies none leaves a trail.
_MOST_TRAILS = 5
# So many times a picture's size away it is looked for where surfaces end.
_FAR = 4.0
# The arrow of a force that few exceed is a quarter of the picture.
_FEW = 0.9


class SceneStage:
    """The scene of an automaton as a stage; see `statechart.pictures.stage.Stage`."""

    def __init__(self, automaton: Automaton) -> None:
        scene = automaton.declaration
        assert isinstance(scene, Scene)
        self._automaton, self._scene = automaton, scene
        self._mechanics = Mechanics(scene)
        moved = [n for n, s in scene.surfaces.items() if s.moves]
        self._bodies = {name: 1 + k for k, name in enumerate(scene.bodies)}
        self._moved = {name: 1 + len(self._bodies) + k for k, name in enumerate(moved)}

    @property
    def wanted(self) -> tuple[str, ...]:
        """Gaps and forces of contacts, and coefficients of friction that change."""
        names = (f"{c}.{q}" for c in self._scene.contacts for q in ("gap", "V", "H", "friction"))
        return tuple(name for name in names if name in self._automaton.observables)

    def film(self, moments: Moments) -> Film:
        """Return what the scene looks like at instants of a run; see `Stage`."""
        scene, regions = self._scene, self._automaton.regions
        key = moments.keys[0]
        states, unrecorded = tuple(self._automaton.recorded_states(key)), len(regions) - len(key)
        modes = np.zeros((len(moments.times), len(regions)), dtype=np.intp)
        for instant, key in enumerate(moments.keys):
            pairs = zip(states[unrecorded:], key, strict=True)
            modes[instant, unrecorded:] = [known.index(state) for known, state in pairs]
        never = frozenset(
            region.name
            for k, region in enumerate(regions)
            if OFF in states[k] and (modes[:, k] == states[k].index(OFF)).all()
        )
        shapes = BodyShapes(self._mechanics, self._automaton, moments.parameters).shapes(never)
        poses = self._poses(moments)
        touches = tuple(
            self._touch(name, moments, poses) for name in scene.contacts if name not in never
        )
        force = _usual(touches)
        closed = [
            np.array([states[t.region][k] not in OPEN for k in modes[:, t.region]]) for t in touches
        ]
        centres, half = self._window(moments, shapes, poses, touches, closed, force)
        unit = 2.0 * max(half)
        poses = self._held(poses, moments, HATCH * unit)
        carried = self._grounds(moments, poses, centres, 1.05 * np.array(half))
        trails = tuple(self._bodies.values()) if len(self._bodies) <= _MOST_TRAILS else ()
        names = tuple(region.name for region in regions)
        return Film(
            self._automaton.name, moments.times, moments.jumps, names, states, modes,
            (*carried, *shapes), poses, touches, centres, half, force, trails,
        )  # fmt: skip

    def _window(
        self,
        moments: Moments,
        shapes: Sequence[Shape],
        poses: Array,
        touches: Sequence[Touch],
        closed: Sequence[NDArray[np.bool_]],
        force: float,
    ) -> tuple[Array, tuple[float, float]]:
        """Return the window on bodies, contacts, arrows of forces, and what holds the bodies."""
        below = [self._below(touch, moments) for touch in touches]
        cloud = cloud_of(shapes, poses, [*(touch.places for touch in touches), *below])
        centres, half = window(cloud)
        known = self._scene.surfaces
        around = self._grounds(moments, poses, centres, _FAR * np.array(half))
        held = [s for s in around if known[s.name].body is None]
        cloud = beside(cloud, held, poses)
        if len(moments.times) == 1:
            cloud = ahead(cloud, held, poses)
        _, half = window(cloud)
        tips = [(t.places + arrows(t.forces, half, force))[:, None] for t in touches]
        rims = [
            np.where(when[:, None, None], cones(t, half), t.places[:, None])
            for t, when in zip(touches, closed, strict=True)
        ]
        return window(np.concatenate([cloud, *tips, *rims], axis=1))

    def _grounds(
        self, moments: Moments, poses: Array, centres: Array, reach: Array
    ) -> tuple[Shape, ...]:
        """Return the surfaces as far as they are ever seen, for the reach of a picture."""
        shift = np.abs(poses[:, [WORLD, *self._moved.values()], :2]).max(axis=(0, 1))
        box = centres.min(axis=0) - reach - shift, centres.max(axis=0) + reach + shift
        frames = {
            name: self._bodies[s.body] if s.body is not None else self._moved.get(name, WORLD)
            for name, s in self._scene.surfaces.items()
        }
        return grounds(self._scene, moments.parameters, frames, box, 2.0 * float(reach.max()))

    def _below(self, touch: Touch, moments: Moments) -> Array:
        """Return where a surface is beside a contact point: straight below it on a graph."""
        surface = self._scene.surfaces[self._scene.contacts[touch.name].surface]
        gap = moments.columns[f"{touch.name}.gap"][:, None]
        if surface.height is None or "x" not in parse(surface.height).names or surface.turn != 0:
            return touch.places - gap * touch.normals
        return touch.places - gap / touch.normals[:, 1:] * np.array([0.0, 1.0])

    @cached_property
    def _frames(self) -> Tape:
        """The poses of all frames but the world's."""
        mechanics = self._mechanics
        expressions: list[sp.Expr] = []
        for name in self._scene.bodies:
            (x, y), angle = mechanics.body_frame(name)
            expressions += [x, y, angle]
        for name in self._moved:
            expressions += surface_frame(self._scene.surfaces[name], mechanics.known)
        return compiled(self._automaton, expressions)

    @cached_property
    def _touching(self) -> dict[str, Tape]:
        """Point and surface normal of every contact, in world coordinates."""
        return {
            name: compiled(self._automaton, [*self._point(name), *self._normal(name)])
            for name in self._scene.contacts
        }

    def _point(self, name: str) -> Vector:
        contact, normal = self._scene.contacts[name], self._normal(name)
        x, y = self._mechanics.point(contact.point)
        radius = parse(contact.radius or 0).to_sympy(self._mechanics.known)
        return x - radius * normal[0], y - radius * normal[1]

    def _normal(self, name: str) -> Vector:
        surface = self._scene.surfaces[self._scene.contacts[name].surface]
        x, y = self._mechanics.contact(name).normal
        if surface.body is None:
            angle = surface_frame(surface, self._mechanics.known)[2]
        else:
            angle = self._mechanics.body_frame(surface.body)[1]
        c, s = sp.cos(angle), sp.sin(angle)
        return c * x - s * y, s * x + c * y

    def _poses(self, moments: Moments) -> Array:
        found = self._frames.table(moments.states, moments.values, moments.times)
        still = np.zeros((len(moments.times), 1, 3))
        return np.concatenate([still, found.reshape(len(moments.times), -1, 3)], axis=1)

    def _held(self, poses: Array, moments: Moments, spacing: float) -> Array:
        """Return the poses with straight surfaces moved along themselves by less than a stroke.

        Their hatching looks the same.
        """
        result = poses.copy()
        for name, frame in self._moved.items():
            surface = self._scene.surfaces[name]
            if surface.turn != 0 or not is_straight(surface):
                continue
            _, direction = line_of(surface, lambda text: parse(text).value(moments.parameters))
            along = result[:, frame, :2] @ direction
            whole = spacing * np.round(along / spacing)
            result[:, frame, :2] -= whole[:, None] * direction
        return result

    def _touch(self, name: str, moments: Moments, poses: Array) -> Touch:
        contact = self._scene.contacts[name]
        found = self._touching[name].table(moments.states, moments.values, moments.times)
        places, normals = found[:, :2], found[:, 2:]
        radius = disc_of(self._scene, contact, lambda text: parse(text).value(moments.parameters))
        places = places - radius * normals
        names = [region.name for region in self._automaton.regions]
        region = names.index(name)
        nothing = np.zeros(len(moments.times))
        # Contacts whose modes are not recorded show the forces that steps found.
        place = region - len(names)
        open_ = np.array([len(key) >= -place and key[place] in OPEN for key in moments.keys])
        normal, tangential = (
            np.where(open_, 0.0, np.nan_to_num(moments.columns.get(f"{name}.{force}", nothing)))
            for force in ("V", "H")
        )
        tangents = np.column_stack([normals[:, 1], -normals[:, 0]])
        forces = normal[:, None] * normals + tangential[:, None] * tangents
        friction = moments.columns.get(f"{name}.friction")
        if friction is None:
            held = np.inf if contact.friction is None and "pin" in contact.kinds else 0.0
            friction = np.full(len(nothing), moments.parameters.get(f"{name}.friction", held))
        return Touch(name, region, places, normals, forces, friction)


def _usual(touches: tuple[Touch, ...]) -> float:
    """Return a force that few along a film exceed; 1 where there is none."""
    sizes = [np.hypot(*touch.forces.T) for touch in touches]
    sizes = [size[size > 0.0] for size in sizes]
    found = np.concatenate(sizes) if sizes else np.empty(0)
    return float(np.quantile(found, _FEW)) if len(found) else 1.0
