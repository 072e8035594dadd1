"""Random heaps: bodies whose masses and frictions span six decades, thrown onto each other."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array

_GRAVITY = 9.81


def heap(seed: int, most: int = 50) -> str:
    """Return a scene of 2 to `most` bodies, polygons and discs, as text.

    They fall between walls, in rows; restitution is none, one or between. A step takes no body
    farther than a hundredth of its size at first.
    """
    generator = np.random.default_rng(seed)
    count = round(math.exp(generator.uniform(math.log(2), math.log(most))))
    across = int(generator.integers(1, 6))
    size = float(generator.choice([0.01, 1.0]))
    speed = math.sqrt(_GRAVITY * size)
    bodies, names = [], []
    for k in range(count):
        row, column = divmod(k, across)
        reach = size * generator.uniform(0.3, 0.5)
        mass = 10.0 ** generator.uniform(-3, 3)
        x = size * (1.1 * column + 0.6 + generator.uniform(-0.03, 0.03))
        y = size * (0.55 + 1.1 * row)
        dx, dy = (speed * generator.uniform(-0.5, 0.5, 2)).tolist()
        turn = generator.uniform(-1, 1) * speed / size
        if generator.random() < 0.4:
            shape, inertia = f"disc: {reach!r}", mass * reach**2 / 2
        else:
            corners = _polygon(generator, reach)
            shape = f"polygon: {corners.tolist()!r}"
            inertia = mass * _square(corners)
        name = f"b{k}"
        names.append(name)
        bodies.append(
            f"  {name}: {{mass: {mass!r}, inertia: {inertia!r}, shape: {{{shape}}}, start: "
            f"{{x: {x!r}, y: {y!r}, angle: 0, dx: {dx!r}, dy: {dy!r}, dangle: {turn!r}}}}}\n"
        )
    mu = float(generator.choice([0.0, 10.0 ** generator.uniform(-3, 3)], p=[0.1, 0.9]))
    e = float(generator.choice([0.0, 1.0, generator.uniform(0, 1)]))
    wide = size * (1.1 * across + 0.1)
    step = 0.005 * size / speed
    return f"""\
kind: scene
name: heap
gravity: {_GRAVITY}
bodies:
{"".join(bodies)}surfaces:
  ground: {{height: 0}}
  left: {{line: [[0, 1], [0, 0]]}}
  right: {{line: [[{wide!r}, 0], [{wide!r}, 1]]}}
collisions:
  all: {{bodies: [{", ".join(names)}], surfaces: [ground, left, right], friction: {mu!r},
    restitution: {e!r}}}
stop: {{time: {600 * step!r}}}
settings: {{engine: impulse, step: {step!r}}}
"""


def _polygon(generator: np.random.Generator, reach: float) -> Array:
    """Return corners (k, 2) of a convex polygon around its centre of mass."""
    count = int(generator.integers(3, 7))
    angles = 2.0 * math.pi * (np.arange(count) + generator.uniform(0.0, 0.4, count)) / count
    corners = np.stack([np.cos(angles), np.sin(angles)], 1)
    corners -= _centre(corners)
    scaled: Array = reach * corners / np.hypot(*corners.T).max()
    return scaled


def _centre(corners: Array) -> Array:
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
    centre: Array = ((corners + following) * cross[:, None]).sum(0) / (3.0 * cross.sum())
    return centre


def _square(corners: Array) -> float:
    """Return the moment of inertia of a polygon about its centre of mass, by its mass."""
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
    sums = (corners**2 + corners * following + following**2).sum(1)
    return float((cross * sums).sum() / (6.0 * cross.sum()))
