"""Initial penetration of bodies in each other and in surfaces; starts outside hollow circles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers, PieceNumbers
from contacts.collision_detection.surfaces import HOLLOW
from contacts.rigid_bodies.declared_numbers import rotated
from contacts.rigid_bodies.rigid_body_run import DetectedContacts
from statechart.arrays import Array
from statechart.errors import DeclarationProblem

# Allowed penetration, relative to the inscribed circle: a fast body moves about so far in a step of
# default size, and a landed one stays half as deep. The end of one run can be the start of another.
_LEFT = 0.1
# Relative round-off of depths.
_SAME_GAP = 1e-9
# Excess of the radius of an enclosing circle, relative to a hollow one, that counts as none.
_RADIUS_TOLERANCE = 1e-6
# Bodies for which a way out is searched, and moves of each.
_MOVES = 20
# Number of copies above which the advice is a grid.
_CROWD = 20
# Overlapping bodies of a single pair.
_PAIR = 2
_STUCK = "no small move frees it: start it elsewhere, or move what it is in"


Detect = Callable[[BodyNumbers, Array], DetectedContacts]
"""Detects the contacts of bodies with these numbers in a state (2 n + w,)."""


def check_penetration(
    detect: Detect,
    numbers: BodyNumbers,
    names: Sequence[str],
    surfaces: Sequence[str],
    owners: Sequence[str],
    initial: Array,
    near: float,
) -> tuple[float, tuple[str, ...]]:
    """Check that no body is deeper in another or a surface than steps leave a landed one.

    Bodies are declared by `owners` and start at `initial` (2 n,); a depth up to `near` is contact.
    Returns the largest depth, and a warning if it exceeds `near`.

    Raises `DeclarationProblem` if one is deeper.
    """
    _check_copies(numbers, names, owners, initial)
    contacts = detect(numbers, initial)

    def deepest_of(b: int) -> str:
        return contacts.deepest_of(b, numbers.pieces.bodies, names, surfaces)

    cores = np.full(len(names), np.inf)
    np.minimum.at(cores, numbers.pieces.bodies, numbers.pieces.cores)
    cores, gaps = cores[: len(numbers.inverse)], contacts.gaps[: len(numbers.inverse)]
    too_deep = np.flatnonzero(gaps < -np.maximum(near, _LEFT * cores)).tolist()
    # Linked bodies move with their coordinates.
    too_deep = [b for b in too_deep if b < numbers.free] or too_deep
    deep = {b: float(gaps[b]) for b in too_deep}
    if not deep:
        first, depth = int(np.argmin(gaps)), -float(gaps.min())
        if depth <= near:
            return 0.0, ()
        return depth, (
            f"bodies start up to {depth:.3g} deep in others or in surfaces ({names[first]!r} in "
            f"{deepest_of(first)}): the run lets them stay as deep, but no deeper",
        )
    # Report the first body that a move frees, else the first.
    for b in [b for b in deep if b < numbers.free][:_MOVES]:
        out = _way_out(detect, numbers, contacts, initial, b, near)
        if out and not contacts.is_covered(b):
            break
    else:
        b, out = next(iter(deep)), _STUCK
    where = deepest_of(b)
    if contacts.is_covered(b):
        b, where, out = _covered(numbers, contacts, names, b, where)
    if len(deep) > _PAIR:
        out += f"; {len(deep)} bodies overlap, by {-min(deep.values()):.3g} at most"
    key = "start"
    if b >= numbers.free:
        key, out = "position", "start the coordinates that place it elsewhere"
    raise DeclarationProblem(
        f"body {names[b]!r} starts {-deep[b]:.6g} deep in {where}",
        advice=out,
        loc=("bodies", owners[b], key),
    )


def _enclosing_radius(pieces: PieceNumbers, b: int) -> float:
    """Return the radius of the smallest circle around body b: a convex minimum over its centre."""
    from scipy.optimize import minimize_scalar

    first, end = pieces.begins[b : b + 2]
    corners = pieces.vertices[pieces.firsts[first] : pieces.firsts[end]]
    discs = first + np.flatnonzero(pieces.radii[first:end])
    x, y = np.concatenate([corners, pieces.middles[discs]]).T
    radii = np.append(np.zeros(len(corners)), pieces.radii[discs])
    size = float(pieces.spans[first:end].max())

    def smallest(radius: Callable[[float], float]) -> float:
        options = {"xatol": 1e-4 * _RADIUS_TOLERANCE * size}
        found = minimize_scalar(radius, bounds=(-size, size), method="bounded", options=options)
        return float(found.fun)

    return smallest(lambda u: smallest(lambda v: np.max(np.hypot(x - u, y - v) + radii)))


def check_containers(
    numbers: BodyNumbers,
    names: Sequence[str],
    surfaces: Sequence[str],
    owners: Sequence[str],
    poses: Array,
) -> None:
    """Check that bodies fit into the hollow circles that they collide with, and start in them.

    Compliant contacts allow any depth inside, but no body that is too large. `poses` (b, 3) are
    those of all bodies.

    Raises `DeclarationProblem` if a body is too large, or starts outside.
    """
    pieces, circles, poses = numbers.pieces, numbers.surfaces, np.vstack([poses, np.zeros(3)])
    bodies, places = pieces.bodies, poses[pieces.bodies]
    centres = places[:, :2] + rotated(places[:, 2], pieces.middles)
    for s in np.flatnonzero(circles.kinds == HOLLOW).tolist():
        carrier, middle, radius = circles.carriers[s], circles.numbers[s, :2], circles.numbers[s, 2]
        meets = numbers.laws[numbers.kinds[bodies], len(numbers.laws) + s] >= 0
        meets &= (bodies != carrier) & (bodies < len(numbers.inverse))
        centre = poses[carrier, :2] + rotated(poses[carrier, 2], middle)
        inside = np.hypot(*(centres - centre).T) < radius
        # Copies have the outline of their kind.
        large = np.unique(bodies[meets & (pieces.spans > radius)])
        for b in large[np.unique(numbers.kinds[large], return_index=True)[1]].tolist():
            reach = _enclosing_radius(pieces, b)
            if reach > (1.0 + _RADIUS_TOLERANCE) * radius:
                raise DeclarationProblem(
                    f"body {names[b]!r} does not fit into {surfaces[s]!r}: the smallest circle "
                    f"around it has a radius of {reach:.6g}, and the hollow one of {radius:.6g}",
                    advice="make the circle larger, or the body smaller",
                    loc=("bodies", owners[b], "shape"),
                )
        for b in np.setdiff1d(bodies[meets], bodies[inside])[:1].tolist():
            raise DeclarationProblem(
                f"body {names[b]!r} starts outside the hollow circle {surfaces[s]!r}",
                advice=f"place it within {radius:.6g} of ({centre[0]:.6g}, {centre[1]:.6g}); to "
                "touch a circle from outside, remove hollow",
                loc=("bodies", owners[b], "start" if b < numbers.free else "position"),
            )


def _check_copies(
    numbers: BodyNumbers, names: Sequence[str], owners: Sequence[str], initial: Array
) -> None:
    """Check that no colliding copies start at one place, and that most of many do not overlap.

    Then moving a single one would not help, and full detection would take many times as long. Two
    bodies whose inscribed circles have their centres in one cell of this size overlap too deeply.
    """
    pieces = numbers.pieces
    members = np.flatnonzero(np.diff(pieces.begins[: len(numbers.inverse) + 1]))
    one, kinds = pieces.begins[:-1][members], numbers.kinds[members]
    poses = numbers.motion(initial[None])[0][0, members]
    centres = poses[:, :2] + rotated(poses[:, 2], pieces.middles[one])
    checks = [(poses, 0)]
    if len(members) >= _CROWD and not len(numbers.joints.bodies):
        cells = np.floor(centres / ((2.0 - _LEFT) / math.sqrt(2.0) * pieces.cores[one])[:, None])
        checks.append((cells, len(members) // 2))
    for places, allowed in checks:
        _, which, many = np.unique(
            np.column_stack([kinds, places]), axis=0, return_inverse=True, return_counts=True
        )
        which = which.reshape(-1)
        deep = (many[which] > 1) & (numbers.laws[kinds, kinds] >= 0)
        if np.count_nonzero(deep) <= allowed:
            continue
        first, other = np.flatnonzero(deep & (which == which[int(np.argmax(deep))]))[:2].tolist()
        b, c = int(members[first]), int(members[other])
        problem = f"bodies {names[b]!r} and {names[c]!r} start at the same place"
        if places is not poses:
            depth = 2.0 * pieces.cores[one[first]] - math.dist(centres[first], centres[other])
            problem = (
                f"body {names[b]!r} starts at least {depth:.6g} deep in body {names[c]!r}, and at "
                f"least {np.count_nonzero(deep)} of {len(members)} copies overlap"
            )
        raise DeclarationProblem(
            problem,
            advice=f"write a start that depends on index, {_row_formulas(numbers, b)}",
            loc=("bodies", owners[b], "start"),
        )


def _row_formulas(numbers: BodyNumbers, b: int) -> str:
    """Return start formulas that separate the copies of a body."""
    count = int(np.count_nonzero(numbers.kinds == numbers.kinds[b]))
    spacing = f"{float(f'{2.1 * numbers.sizes[b]:.2g}'):g}"
    if count < _CROWD:
        return f"such as x: {spacing}*index"
    row = math.isqrt(count)
    return f'such as x: "{spacing}*mod(index, {row})" and y: {spacing}*floor(index/{row})'


def _way_out(
    detect: Detect, numbers: BodyNumbers, contacts: DetectedContacts, initial: Array, b: int,
    near: float,
) -> str:  # fmt: skip
    """Return the advice that frees a body from all that it penetrates, or "".

    The smallest move out of all contacts met so far (least distance programming, Lawson and Hanson
    1974), repeated until it meets nothing new.
    """
    from scipy.optimize import nnls

    move, ways, far = np.zeros(2), np.zeros((0, 2)), np.zeros(0)
    for _ in range(_MOVES):
        normals, depths = contacts.ways_out(b, near)
        if not len(depths):
            dx, dy = np.where(np.abs(move) < near, 0.0, move).tolist()
            return f"move it by ({dx:.6g}, {dy:.6g}) out"
        ways = np.concatenate([ways, normals])
        far = np.concatenate([far, depths + normals @ move])
        least = np.concatenate([ways.T, far[None]])
        size = float(far.max())
        least[2] /= size
        weights, _ = nnls(least, np.array([0.0, 0.0, 1.0]))
        remainder = least @ weights - np.array([0.0, 0.0, 1.0])
        if not -remainder[2] > _SAME_GAP:
            break
        move = -size * remainder[:2] / remainder[2]
        state = initial.copy()
        state[3 * b : 3 * b + 2] += move
        contacts = detect(numbers, state)
    return ""


def _covered(
    numbers: BodyNumbers, contacts: DetectedContacts, names: Sequence[str], b: int, where: str
) -> tuple[int, str, str]:
    """Return the inner body, the outer one, and advice, if pieces of the outer cover each other.

    No face is left to touch, and so no contact shows a way out.
    """
    bodies, q = numbers.pieces.bodies, int(contacts.deepest[b])
    if q >= len(bodies):
        return b, where, f"start its centre {numbers.sizes[b]:.6g} from it, or move it out"
    if bodies[q] >= len(numbers.inverse):
        return b, where, _STUCK
    pair = b, int(bodies[q])
    one, whole = sorted(pair, key=lambda i: float(numbers.sizes[i]))
    reach = float(numbers.sizes[[*pair]].sum())
    far = f"start it {reach:.6g} from the centre of {names[whole]!r}, or move it out"
    return one, f"body {names[whole]!r}", far
