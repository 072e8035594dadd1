"""The linear equations of one time step: bodies, joints and what contacts hold, factored once."""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.saddle_point import substitute
from statechart.arrays import Array, Ints
from statechart.kernels.jit import part

CONTACT = 6
"""Numbers of a contact beside its Jacobian (2, n): biases (2,), gap, its rate, slip, condition."""

JOINT = 4
"""Numbers of a joint's row beside its Jacobian (n,): gap, rate, bias, whether others imply it."""

# A pivot below this part of the scales of its row and column, whatever the unit of mass: the
# equations do not determine the motion.
_SINGULAR = 1e-12
# Coordinates without an inertia of their own get this part of what the others have at their levers.
_LIGHTEST = 1e-9


@part
def _factor(matrix: Array) -> tuple[bool, Ints]:
    """Factor in place with partial pivoting of equilibrated rows; False where singular."""
    size = len(matrix)
    order, scale = np.empty(size, np.int64), np.empty(size)
    column, row = np.zeros(size), np.zeros(size)
    for i in range(size):
        order[i] = i
        for j in range(size):
            column[j] = max(column[j], abs(matrix[i, j]))
    for i in range(size):
        largest = 0.0
        for j in range(size):
            largest = max(largest, abs(matrix[i, j]))
            if not math.isfinite(matrix[i, j]):
                return False, order
            if matrix[i, j] != 0.0:
                row[i] = max(row[i], abs(matrix[i, j]) / column[j])
        if not largest > 0.0:
            return False, order
        scale[i] = 1.0 / largest
    for k in range(size):
        best = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) * scale[i] > abs(matrix[best, k]) * scale[best]:
                best = i
        if not abs(matrix[best, k]) > _SINGULAR * row[best] * column[k]:
            return False, order
        if best != k:
            for j in range(size):
                matrix[k, j], matrix[best, j] = matrix[best, j], matrix[k, j]
            scale[k], scale[best] = scale[best], scale[k]
            row[k], row[best] = row[best], row[k]
            order[k], order[best] = order[best], order[k]
        for i in range(k + 1, size):
            if matrix[i, k] != 0.0:
                factor = matrix[i, k] / matrix[k, k]
                matrix[i, k] = factor
                for j in range(k + 1, size):
                    matrix[i, j] -= factor * matrix[k, j]
    return True, order


@part
def back(factors: Array, order: Ints, right: Array) -> Array:
    """Return the solution for one right side (m,)."""
    x = np.empty(len(right))
    substitute(factors, order, right, x)
    return x


@part
def _lightest(numbers: Array, n: int, first: int, contacts: int) -> Array:
    """Return the least inertia (n,) of every coordinate: small beside the bodies' at its levers."""
    reach = np.zeros(n)
    for i in range(contacts):
        row = first + (2 * n + CONTACT) * i
        for d in range(2):
            for j in range(n):
                reach[j] = max(reach[j], abs(numbers[row + d * n + j]))
    heaviest = 0.0
    for j in range(n):
        if reach[j] > 0.0:
            heaviest = max(heaviest, numbers[n * j + j] / reach[j] ** 2)
    return _LIGHTEST * heaviest * reach**2


@part
def factored(
    numbers: Array, n: int, h: float, damped: bool, held: Ints, joints: int, light: bool
) -> tuple[bool, Array, Ints, Array]:
    """Return (regular, factors, order, right side) of what moves without free contacts' impulses.

    Parameters
    ----------
    numbers : (m,)
        Of the step; see `contacts.time_stepping.scene_step.step_scene`.
    n : int
        Number of coordinates.
    h : float
    damped : bool
    held : (c,) array of int
    joints : int
    light : bool
        Give coordinates without an inertia of their own a small one.
    """
    first = n * n + n + (n * n if damped else 0)
    size = n + joints
    for i in range(len(held)):
        size += held[i]
    matrix, right = np.zeros((size, size)), np.zeros(size)
    least = _lightest(numbers, n, first, len(held)) if light else np.zeros(n)
    for i in range(n):
        right[i] = h * numbers[n * n + i]
        for j in range(n):
            matrix[i, j] = numbers[n * i + j]
        if matrix[i, i] < least[i]:
            matrix[i, i] = least[i]
        if damped:
            for j in range(n):
                matrix[i, j] -= 0.5 * h * numbers[n * n + n + n * i + j]
    at = n
    for i in range(len(held)):
        row = first + (2 * n + CONTACT) * i
        for d in range(held[i]):
            # The velocity that the surface gives it, and what keeps the gap at zero.
            offset = numbers[row + 2 * n + 3 + d] + 0.5 * h * numbers[row + 2 * n + d]
            if d == 0:
                offset += numbers[row + 2 * n + 2] / h
            for j in range(n):
                matrix[at, j] = numbers[row + d * n + j]
                matrix[j, at] = -numbers[row + d * n + j]
            right[at] = -offset
            at += 1
    for i in range(joints):
        row = first + (2 * n + CONTACT) * len(held) + (n + JOINT) * i
        if numbers[row + n + 3] != 0.0:
            matrix[at, at] = 1.0
        else:
            for j in range(n):
                matrix[at, j] = numbers[row + j]
                matrix[j, at] = -numbers[row + j]
            right[at] = -numbers[row + n] / h - numbers[row + n + 1]
            right[at] -= 0.5 * h * numbers[row + n + 2]
        at += 1
    regular, order = _factor(matrix)
    return regular, matrix, order, right
