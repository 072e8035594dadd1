"""The window of a picture: the whole of a run, or a part that follows the bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from statechart.arrays import Array
from statechart.pictures.film import Shape, placed

# Around what is shown, of its own size.
_MARGIN = 0.15
# Of its height a picture is at most so wide, and the other way round; what moves farther than this
# is followed, and shown by a part of it.
_LONGEST, _FOLLOWED = 4.0, 3.0
# A side is at least this part of the other.
_SHORTEST = 0.45
_ROUND = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
# A surface is shown whole if it is no larger than so many times what moves; one that goes round it
# may be larger.
_AROUND, _ROUND_ABOUT = 2.2, 6.0
# Of an instant it is not known where bodies will go: what goes on is seen up to so many times half
# the size of what moves away, beyond which bodies would be dots.
_SEEN = 20.0
# Followed through what a camera would not see: this part of the run.
_SMOOTH = 0.04


def cloud_of(shapes: Sequence[Shape], poses: Array, places: Sequence[Array]) -> Array:
    """Return all that is to be seen at every instant, as points (k, m, 2)."""
    clouds = [at[:, None, :] for at in places if np.isfinite(at).any()]
    for shape in shapes:
        points = shape.points
        if shape.kind == "disc":
            points = points + shape.radius * np.column_stack([np.cos(_ROUND), np.sin(_ROUND)])
        ends = [(points, shape.frame)]
        if shape.other != shape.frame:
            ends = [(points[:1], shape.frame), (points[-1:], shape.other)]
        clouds += [placed(part, poses[:, frame]) for part, frame in ends]
    cloud = np.concatenate(clouds, axis=1)
    return np.where(np.isfinite(cloud), cloud, np.nanmean(cloud, axis=(0, 1)))


def window(cloud: Array) -> tuple[Array, tuple[float, float]]:
    """Return the middle (k, 2) of the picture at every instant, and half its width and height."""
    low, high = cloud.min(axis=1), cloud.max(axis=1)
    least, most = low.min(axis=0), high.max(axis=0)
    whole, own = most - least, (high - low).max(axis=0)
    centres = np.tile((least + most) / 2.0, (len(cloud), 1))
    half = whole / 2.0
    for axis in (0, 1):
        size = max(own.max(), whole[1 - axis])
        if size > 0.0 and whole[axis] > _LONGEST * size:
            half[axis] = _FOLLOWED * size / 2.0
            centres[:, axis] = _smooth(((low + high) / 2.0)[:, axis])
    half = half * (1.0 + 2.0 * _MARGIN)
    largest = float(half.max()) or 1.0
    half = np.maximum(half, _SHORTEST * largest)
    return centres, (float(half[0]), float(half[1]))


def beside(cloud: Array, surfaces: Sequence[Shape], poses: Array) -> Array:
    """Return a cloud with the surfaces that end not far from it.

    A drum around its grains or a floor between walls counts; a surface without ends does not.
    """
    low, high = cloud.min(axis=(0, 1)), cloud.max(axis=(0, 1))
    middle, size = (low + high) / 2.0, float((high - low).max()) / 2.0
    found = [cloud]
    for surface in surfaces:
        line = placed(surface.points, poses[:, surface.frame])
        near = (np.abs(line - middle) <= _AROUND * size).all()
        if np.allclose(line[:, 0], line[:, -1], atol=1e-9 * size):
            around = line.min(axis=1) <= low, line.max(axis=1) >= high
            near |= np.all(around) and np.ptp(line, axis=1).max() <= _ROUND_ABOUT * 2.0 * size
        if near:
            found.append(line)
    return np.concatenate(found, axis=1)


def ahead(cloud: Array, surfaces: Sequence[Shape], poses: Array) -> Array:
    """Return the cloud of one instant with the places of surfaces that are nearest to it.

    So the ground is seen that a body is about to fall on.
    """
    low, high = cloud.min(axis=(0, 1)), cloud.max(axis=(0, 1))
    middle, size = (low + high) / 2.0, float((high - low).max()) / 2.0
    found = [cloud]
    for surface in surfaces:
        line = placed(surface.points, poses[:, surface.frame])[0]
        along = np.diff(line, axis=0)
        squares = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
        part = ((middle - line[:-1]) * along).sum(axis=1) / squares
        places = line[:-1] + np.clip(part, 0.0, 1.0)[:, None] * along
        away = np.hypot(*(places - middle).T)
        if len(away) and away.min() <= _SEEN * size:
            found.append(places[None, [int(away.argmin())]])
    return np.concatenate(found, axis=1)


def _smooth(values: Array) -> Array:
    """Return a moving average whose ends are held."""
    width = max(1, round(_SMOOTH * len(values)))
    held = np.concatenate([np.full(width, values[0]), values, np.full(width, values[-1])])
    kernel = np.hanning(2 * width + 1) if width > 1 else np.array([0.25, 0.5, 0.25])
    averaged: Array = np.convolve(held, kernel / kernel.sum(), mode="valid")
    return averaged
