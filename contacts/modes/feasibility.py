"""Kinematic feasibility of product modes: velocities that satisfy them, or the reason.

A mode is a set of conditions on each contact's normal and tangential velocity, v_n = Jn v and
v_t = Jt v, so at one configuration it is a linear system: equations, and strict inequalities.
By Motzkin's theorem of the alternative either a velocity solves it, or weights >= 0, not all
zero, combine its inequalities to something that the equations hold at zero; the latter is the
certificate, which deletion reduces to conditions of which none can be spared (Chinneck,
Feasibility and Infeasibility in Optimization, 2008, section 2). The answer holds at the
configuration alone: it changes where a contact's normal passes through another contact.

Surfaces that move enter as one more coordinate, their own: its column holds the velocities that
it gives, and a row that selects it, with the one state "free", says that it moves forwards.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.solvers.dependence import USER_DIGITS, null_space
from contacts.states import declared_state
from statechart.arrays import Array
from statechart.automaton.laws import Feasibility
from statechart.automaton.regions import Region
from statechart.errors import StatechartError
from statechart.tabular import several

Condition = tuple[int, int, int]
"""Contact, row (0: normal, 1: tangential), sign of the velocity."""

DRIVEN = "what is driven"
"""What reasons call the coordinate of surfaces and joints that move as they are told."""

_CONDITIONS: Mapping[str, tuple[tuple[int, int], ...]] = {
    "free": ((0, 1),),
    "off": (),
    "pin": ((0, 0), (1, 0)),
    "slide": ((0, 0),),
    "slide+": ((0, 0), (1, 1)),
    "slide-": ((0, 0), (1, -1)),
    "open": (),
    "locked": ((1, 0),),
    "slip+": ((1, 1),),
    "slip-": ((1, -1),),
}
# What the conditions leave to a row of length 1 counts from here on: equations that are next to
# dependent (`USER_DIGITS`) leave it with an error as large.
_ZERO = 1e-8
# Entries so far below the largest of their contact are rounding, such as cos(pi/2) = 6e-17.
# Units put entries this far apart only where lengths are below 1e-14 or angles are not radians.
_CONE_ROUND_OFF = 1e-14
_MOST_MODES = 4096


@dataclass(frozen=True)
class ModeVerdict:
    """Kinematic feasibility of a mode."""

    states: tuple[str, ...]  # Per contact
    feasible: bool
    reason: str  # Why it is not feasible, in words; "" where it is
    # Contacts and their conditions that exclude one another, none of which can be spared
    conflict: tuple[tuple[int, str], ...] = ()


def feasible_modes(
    jacobians: ArrayLike, options: Sequence[Sequence[str]], names: Sequence[str] | None = None
) -> tuple[ModeVerdict, ...]:
    """Judge every combination of `options`.

    Returns
    -------
    tuple of Feasibility
        In the order of ``itertools.product(*options)``. A mode that is possible only by a margin
        of less than 1e-8, with rows and columns of the Jacobian scaled to 1, is infeasible.

    Raises
    ------
    ValueError
        If there are more than 4096 combinations, a state is unknown, or a number is not finite.

    Examples
    --------
    A stick that lies on its two ends can lift one of them, but not slip at one alone.

    >>> ends = [[[0, 1, -1], [1, 0, 0]], [[0, 1, 1], [1, 0, 0]]]
    >>> for mode in feasible_modes(ends, [["free", "pin"], ["pin", "slide+"]], ["A", "B"]):
    ...     print(*mode.states, mode.reason or "feasible", sep=" | ")
    free | pin | feasible
    free | slide+ | feasible
    pin | pin | feasible
    pin | slide+ | A without slip leaves B no slip
    """
    total = math.prod(len(states) for states in options)
    if total > _MOST_MODES:
        raise ValueError(
            f"{total} modes are too many to judge them all (most: {_MOST_MODES}); "
            "give fewer states per contact, or one each for a single mode"
        )
    if names is None:
        names = [f"contact {i + 1}" for i in range(len(options))]
    return _mode_verdicts(jacobians, product(*options), names)


def without_direction(judged: Iterable[ModeVerdict]) -> dict[tuple[str, ...], str]:
    """Return modes without their directions of sliding, and why they are not possible.

    "" stands where one of its directions is possible. A reason that asks for no direction stands
    alone, else those of all directions are joined.
    """
    groups: dict[tuple[str, ...], list[ModeVerdict]] = {}
    for mode in judged:
        groups.setdefault(tuple(map(declared_state, mode.states)), []).append(mode)
    return {
        key: "" if any(mode.feasible for mode in group) else _reason(group)
        for key, group in groups.items()
    }


def _mode_verdicts(
    jacobians: ArrayLike, modes: Iterable[tuple[str, ...]], names: Sequence[str]
) -> tuple[ModeVerdict, ...]:
    rows = _scaled(np.asarray(jacobians, float))
    conflicts: set[frozenset[Condition]] = set()
    held: dict[tuple[str, ...], frozenset[Condition] | None] = {}
    for states in modes:
        conditions = _conditions(states, len(rows))
        held[states] = whole = frozenset(conditions)
        # Modes share their conflicts: most are refused by one that is already known.
        if not any(known <= whole for known in conflicts):
            conflict = _conflict(rows, conditions)
            if conflict is None:
                held[states] = None
            else:
                conflicts.add(frozenset(conflict))
    # Of the conflicts in a mode the shortest says most.
    refusals = [
        (frozenset(conflict), _words(conflict, names), _formulas(conflict))
        for conflict in sorted(
            map(sorted, conflicts), key=lambda conflict: (len(conflict), conflict)
        )
    ]
    return tuple(
        ModeVerdict(states, True, "")
        if conditions is None
        else next(
            ModeVerdict(states, False, reason, formulas)
            for conflict, reason, formulas in refusals
            if conflict <= conditions
        )
        for states, conditions in held.items()
    )


def _reason(directions: Iterable[ModeVerdict]) -> str:
    """Join the reasons of all directions, unless one of them asks for no direction."""
    reasons = {
        mode.reason: any(formula in ("v_t > 0", "v_t < 0") for _, formula in mode.conflict)
        for mode in directions
    }
    return next(
        (reason for reason, directed in reasons.items() if not directed), "; ".join(reasons)
    )


def _conditions(states: Sequence[str], count: int) -> list[Condition]:
    if len(states) != count or not _CONDITIONS.keys() >= set(states):
        raise ValueError(
            f"mode {' '.join(states)!r}: expected one state for each of "
            f"{several(count, 'contact')}, of {', '.join(_CONDITIONS)}"
        )
    return [(c, row, sign) for c, state in enumerate(states) for row, sign in _CONDITIONS[state]]


def _scaled(jacobians: Array) -> Array:
    """Scale columns and rows to a size of 1: units of coordinates and velocities drop out."""
    if not np.isfinite(jacobians).all():
        raise ValueError("the contacts' Jacobians are not finite at this configuration")
    if not jacobians.size:
        return jacobians
    size = np.abs(jacobians)
    rows = np.where(size <= _CONE_ROUND_OFF * size.max(axis=(1, 2), keepdims=True), 0.0, jacobians)
    rows /= _divisors(np.abs(rows).max(axis=(0, 1)))
    rows /= _divisors(np.abs(rows).max(axis=(1, 2), keepdims=True))
    sizes = np.linalg.norm(rows, axis=2, keepdims=True)
    # Both rows are velocities of one point, so that each tells when the other is zero.
    scaled: Array = np.where(sizes <= _ZERO, 0.0, rows / _divisors(sizes))
    return scaled


def _divisors(sizes: Array) -> Array:
    return np.where(sizes > 0.0, sizes, 1.0)


def _conflict(rows: Array, conditions: list[Condition]) -> list[Condition] | None:
    """Return a minimal part of the conditions that no velocity satisfies, None if there is none."""
    kept = _certificate(rows, conditions)
    if kept is None:
        return None
    for condition in list(kept):
        if condition in kept:
            smaller = _certificate(rows, [other for other in kept if other != condition])
            kept = kept if smaller is None else smaller
    return sorted(kept)


def _certificate(rows: Array, conditions: list[Condition]) -> list[Condition] | None:
    """Return conditions that no velocity satisfies, None if one satisfies all."""
    equations = [condition for condition in conditions if condition[2] == 0]
    strict = [condition for condition in conditions if condition[2] != 0]
    if not strict:
        return None
    held = np.array([rows[c, row] for c, row, _ in equations])
    basis = null_space(held.reshape(len(equations), rows.shape[2]))
    left = np.array([sign * rows[c, row] for c, row, sign in strict]) @ basis
    sizes = np.linalg.norm(left, axis=1)
    at = int(sizes.argmin())
    if sizes[at] <= _ZERO:
        return [*equations, strict[at]]
    left /= sizes[:, None]
    guess = np.linalg.lstsq(left, np.ones(len(left)), rcond=USER_DIGITS)[0]
    if (left @ guess).min() > _ZERO * np.linalg.norm(guess):
        return None
    weights = _weights(left)
    if weights is None:
        return None
    return [*equations, *(c for c, weight in zip(strict, weights, strict=True) if weight > 0.0)]


def _weights(left: Array) -> Array | None:
    """Return weights >= 0 that combine the rows (m, k) to zero, None if some w has left w > 0.

    Largest s with left w >= s, |w| <= 1; the weights are the dual solution. HiGHS keeps the
    conditions to 1e-10 at best, so that the sign of s is read from w itself.
    """
    from scipy.optimize import linprog

    m, k = left.shape
    result = linprog(
        np.append(np.zeros(k), -1.0),
        A_ub=np.hstack([-left, np.ones((m, 1))]),
        b_ub=np.zeros(m),
        bounds=[*[(-1.0, 1.0)] * k, (None, None)],
        method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if not result.success:
        raise ArithmeticError(f"feasibility of a mode is undecided: {result.message}")
    if (left @ result.x[:k]).min() > _ZERO:
        return None
    weights: Array = -result.ineqlin.marginals
    return weights


def _formulas(conflict: Sequence[Condition]) -> tuple[tuple[int, str], ...]:
    return tuple((c, f"v_{'nt'[row]} {'=><'[sign]} 0") for c, row, sign in conflict)


def _words(conflict: Sequence[Condition], names: Sequence[str]) -> str:
    """Put a minimal conflict into words: what is held, and what that excludes."""
    zero: dict[int, set[int]] = {}
    for c, row, sign in conflict:
        if sign == 0:
            zero.setdefault(c, set()).add(row)
    strict = [condition for condition in conflict if condition[2] != 0]
    if len(strict) == 1:
        c, row, _ = strict[0]
        lost = "motion" if names[c] == DRIVEN else ("separation", "slip")[row]
        if not zero:
            return f"no motion gives {names[c]} any {lost}"
        verb = "leaves" if len(zero) == 1 else "leave"
        return f"{_held(zero, names)} {verb} {names[c]} no {lost}"
    moving = []
    for c, row, sign in strict:
        if names[c] == DRIVEN:
            moving.append(DRIVEN)
            continue
        verb = "slide" if zero.pop(c, None) else "slip"
        moving.append(f"{names[c]} " + (f"{verb}{'+' if sign > 0 else '-'}" if row else "free"))
    given = f" with {_held(zero, names)}" if zero else ""
    return f"{_listed(moving)} exclude one another{given}"


def _held(zero: Mapping[int, set[int]], names: Sequence[str]) -> str:
    words = {(0,): "closed", (1,): "without slip", (0, 1): "pin"}
    return _listed([f"{names[c]} {words[tuple(sorted(rows))]}" for c, rows in zero.items()])


def _listed(words: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def scene_feasibility(
    regions: Sequence[Region], setup: SceneSetup, snapshot: Snapshot, failing: Sequence[str]
) -> Feasibility:
    """Judge every product mode of a scene by the velocities that it asks for.

    Contacts that do not touch at the configuration, or are off, are judged as if they did and were
    not: the remarks say which. Regions that are no contact's ask for no velocity. A contact without
    a direction there (a point at the centre of a circle) is an error.
    """
    names = [law.name for law in setup.contacts]
    options = [law.states for law in setup.contacts]
    jacobians = snapshot.jacobians
    driven = _driven(snapshot)
    if driven.any():
        further = np.zeros((1, 2, jacobians.shape[2] + 1))
        further[0, 0, -1] = 1.0
        jacobians = np.concatenate(
            [np.concatenate([jacobians, driven[:, :, None]], axis=2), further]
        )
        names, options = [*names, DRIVEN], [*options, ("free",)]
    if not np.isfinite(jacobians).all():
        raise StatechartError(
            "the contacts have no direction at this configuration: give another one"
        )
    found = feasible_modes(jacobians, options, names)
    count = len(setup.contacts)
    directed = {mode.states[:count]: mode.reason for mode in found}
    undirected = {key[:count]: reason for key, reason in without_direction(found).items()}
    places = [[region.name for region in regions].index(n) for n in names[:count]]
    declared = (dict.fromkeys(map(region.declared, region.states)) for region in regions)
    return Feasibility(
        {k: directed[tuple(k[i] for i in places)] for k in product(*(r.states for r in regions))},
        {k: undirected[tuple(k[i] for i in places)] for k in product(*declared)},
        _remarks(setup, snapshot, failing),
    )


def _driven(snapshot: Snapshot) -> Array:
    """Return the velocities (c, 2) of the contacts while all that is not driven rests."""
    rates = np.array([(contact.gap_rate, contact.slip) for contact in snapshot.contacts])
    moved = snapshot.jacobians @ snapshot.velocity
    found: Array = rates.reshape(-1, 2) - moved
    sizes = np.abs(snapshot.jacobians) @ np.abs(snapshot.velocity)
    # What is left of a difference of equal numbers is rounding.
    return np.where(np.abs(found) > 1e-12 * (sizes + np.abs(moved)), found, 0.0)


def _remarks(setup: SceneSetup, snapshot: Snapshot, failing: Sequence[str]) -> tuple[str, ...]:
    near = setup.tolerances["gap"]
    found = []
    for law, contact, why in zip(setup.contacts, snapshot.contacts, failing, strict=True):
        if why:
            off, on = ("open", "closed") if law.coupling else ("off", "on")
            found.append(
                f"{law.name} is {off}, as {why!r} does not hold: judged as if it were {on}"
            )
        elif contact.gap > near:
            found.append(f"{law.name} does not touch (gap {contact.gap:.6g}): judged as if it did")
        elif contact.gap < -near:
            found.append(f"{law.name} is {-contact.gap:.6g} inside its surface")
    if snapshot.reduction is not None:
        joints = snapshot.reduction.joints
        apart = float(np.abs(joints.gaps[joints.on]).max(initial=0.0))
        if apart > near:
            found.append(f"joints are apart by up to {apart:.6g}")
    return tuple(found)
