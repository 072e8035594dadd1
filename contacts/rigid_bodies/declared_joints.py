"""Joints of bodies with shapes as numbers: what they hold, and whether they do at the start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from contacts.collision_detection.body_numbers import ALONG_X, ALONG_Y, BOTH, JointNumbers
from contacts.scene.parts import Point
from contacts.scene.scene import Scene
from contacts.solvers.dependence import column_scales, implied, rank
from contacts.states import implied_joints
from statechart.arrays import Array
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse

_HOLDS = {("X", "Y"): BOTH, ("X",): ALONG_X, ("Y",): ALONG_Y}
_HELD = {BOTH: slice(0, 2), ALONG_X: slice(0, 1), ALONG_Y: slice(1, 2)}


def joint_numbers(scene: Scene, names: Sequence[str], known: Mapping[str, float]) -> JointNumbers:
    """Evaluate the joints of a scene whose bodies have these names, copies one by one."""
    bodies, at = [], []
    for joint in scene.joints.values():
        ends = [joint.point, joint.to if isinstance(joint.to, Point) else None]
        bodies.append([-1 if end is None else names.index(end.body) for end in ends])
        at.append(
            [
                [0.0, 0.0] if end is None else [parse(text).value(known) for text in end.at]
                for end in ends
            ]
        )
    return JointNumbers(
        np.array(bodies, dtype=np.int64).reshape(-1, 2),
        np.array(at, dtype=float).reshape(-1, 2, 2),
        np.array([_HOLDS[joint.components] for joint in scene.joints.values()], dtype=np.int64),
    )


def closed(
    scene: Scene, joints: JointNumbers, moved: Array, places: Array, speeds: Array, near: float,
    slow: float,
) -> JointNumbers:  # fmt: skip
    """Check that joints hold where a run starts; return them closed to rounding there.

    What is declared in eight digits is open by 1e-8, and joints that others imply are so by
    something else than these: no motion closes them all.

    Parameters
    ----------
    scene : Scene
        Its bodies one by one.
    joints : JointNumbers
    moved : (6 b,)
        Coordinates and rates of the bodies.
    places, speeds : (j, 2)
        Of the places in the world that joints hold points to.
    near, slow : float
        Distances and speeds that are none.

    Raises
    ------
    DeclarationProblem
        At the first joint that is open, or whose points move apart.
    """
    (at, rates), own = moved.reshape(2, -1, 3), joints.at.copy()
    for j, name in enumerate(scene.joints):
        ends, moving = [places[j]], [speeds[j]]
        for side in (0, 1):
            b = int(joints.bodies[j, side])
            if b >= 0:
                arm = _arm(at[b, 2], joints.at[j, side])
                ends.insert(side, at[b, :2] + arm)
                moving.insert(side, rates[b, :2] + rates[b, 2] * np.array([-arm[1], arm[0]]))
        held = _HELD[int(joints.holds[j])]
        apart = float(np.hypot.reduce((ends[0] - ends[1])[held]))
        if apart > near:
            u, v = ends[0].tolist()
            x, y = ends[1].tolist()
            raise DeclarationProblem(
                f"joint {name!r} is open at the start: its point is at ({u:.6g}, {v:.6g}), what it "
                f"is held to at ({x:.6g}, {y:.6g})",
                advice=f"move the body by ({x - u:.6g}, {y - v:.6g})",
                loc=("joints", name),
            )
        parting = float(np.hypot.reduce((moving[0] - moving[1])[held]))
        if parting > slow:
            u, v = (moving[1] - moving[0]).tolist()
            raise DeclarationProblem(
                f"joint {name!r} does not hold at the start: its ends move apart at {parting:.6g}",
                advice=f"add ({u:.6g}, {v:.6g}) to the velocity of the body",
                loc=("joints", name),
            )
        missing = np.zeros(2)
        missing[held] = (ends[1] - ends[0])[held]
        own[j, 0] += _arm(-at[joints.bodies[j, 0], 2], missing)
    return joints._replace(at=own)


def implied_remarks(scene: Scene, joints: JointNumbers, moved: Array) -> tuple[str, ...]:
    """Return what is said of joints that others imply where a run starts; see `closed`."""
    at, rows, names = moved.reshape(2, -1, 3)[0], [], []
    for j, name in enumerate(scene.joints):
        both = np.zeros((2, *at.shape))
        for side in (0, 1):
            b = int(joints.bodies[j, side])
            if b >= 0:
                x, y = _arm(at[b, 2], joints.at[j, side]).tolist()
                both[:, b] += (1 - 2 * side) * np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        held = both[_HELD[int(joints.holds[j])]]
        rows.append(held.reshape(len(held), -1))
        names += [name] * len(held)
    if not rows:
        return ()
    known = np.concatenate(rows)
    known = known[:, known.any(axis=0)]
    _, sizes, _ = np.linalg.svd(known * column_scales(known), full_matrices=False)
    if rank(sizes) == len(known):
        return ()
    found = implied(known)
    return (implied_joints(n for n, more in zip(names, found.tolist(), strict=True) if more),)


def _arm(angle: float, at: Array) -> Array:
    """Return a place in the frame of a body as it is turned."""
    c, s = math.cos(angle), math.sin(angle)
    turned: Array = np.array([[c, -s], [s, c]]) @ at
    return turned
