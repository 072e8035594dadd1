"""Kinematic feasibility of product modes: velocities that satisfy them, or the reason.

A mode is a set of conditions on each contact's normal and tangential velocity, v_n = Jn v and
v_t = Jt v, so at one configuration it is a linear system: equations, and strict inequalities.
By Motzkin's theorem of the alternative either a velocity solves it, or weights >= 0, not all
zero, combine its inequalities to a row in the span of the equations. These weights are a
certificate, which deletion reduces to an irreducible set of conditions (Chinneck, Feasibility and
Infeasibility in Optimization, 2008, section 2). The answer is valid at the configuration only: it
changes where a contact's normal passes through another contact.

Moving surfaces are one additional coordinate: its column has their velocities, and a row that
selects it, with the only state "free", requires that it moves forwards.
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
from statechart.tabular import pluralise

Condition = tuple[int, int, int]
"""Contact, row (0: normal, 1: tangential), sign of the velocity."""

DRIVEN = "the prescribed motion"
"""Name of the coordinate of prescribed surfaces and joints in reasons."""

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
# Projections of unit rows below this are zero: nearly dependent equations (`USER_DIGITS`) leave an
# error of this size.
_ZERO = 1e-8
# Entries below this part of the largest of their contact are round-off, such as cos(pi/2) = 6e-17.
_CONE_ROUND_OFF = 1e-14
_MAX_MODES = 4096


@dataclass(frozen=True)
class ModeVerdict:
    """Kinematic feasibility of a mode."""

    states: tuple[str, ...]  # Per contact
    feasible: bool
    reason: str  # Why it is not feasible, in words; "" where it is
    # Irreducible set of contacts and conditions that exclude one another
    conflict: tuple[tuple[int, str], ...] = ()


def feasible_modes(
    jacobians: ArrayLike, options: Sequence[Sequence[str]], names: Sequence[str] | None = None
) -> tuple[ModeVerdict, ...]:
    """Judge every combination of `options`, in the order of ``itertools.product(*options)``.

    A mode that is possible only by a margin of less than 1e-8, with rows and columns of the
    Jacobian scaled to 1, is infeasible. Raises `ValueError` if there are more than 4096
    combinations, a state is unknown, or a number is not finite.

    Examples
    --------
    A stick that lies on its two ends can lift one of them, but not slip at one alone.

    >>> ends = [[[0, 1, -1], [1, 0, 0]], [[0, 1, 1], [1, 0, 0]]]
    >>> for mode in feasible_modes(ends, [["free", "pin"], ["pin", "slide+"]], ["A", "B"]):
    ...     print(*mode.states, mode.reason or "feasible", sep=" | ")
    free | pin | feasible
    free | slide+ | feasible
    pin | pin | feasible
    pin | slide+ | B cannot slip with A without slip
    """
    total = math.prod(len(states) for states in options)
    if total > _MAX_MODES:
        raise ValueError(
            f"{total} modes are too many to judge them all (most: {_MAX_MODES}); "
            "give fewer states per contact, or one each for a single mode"
        )
    if names is None:
        names = [f"contact {i + 1}" for i in range(len(options))]
    rows = _scaled(np.asarray(jacobians, float))
    conflicts: set[frozenset[Condition]] = set()
    conditions_of: dict[tuple[str, ...], frozenset[Condition] | None] = {}
    for states in product(*options):
        conditions = _conditions(states, len(rows))
        conditions_of[states] = required = frozenset(conditions)
        # Most modes contain a conflict that has been found before.
        if not any(known <= required for known in conflicts):
            conflict = _conflict(rows, conditions)
            if conflict is None:
                conditions_of[states] = None
            else:
                conflicts.add(frozenset(conflict))
    # Report the shortest conflict of a mode.
    shortest = sorted(map(sorted, conflicts), key=lambda conflict: (len(conflict), conflict))
    refusals = [(c, _sentence(c, names), _formulas(c)) for c in shortest]
    verdicts = []
    for states, refused in conditions_of.items():
        verdict = ModeVerdict(states, True, "")
        if refused is not None:
            reasons = (r for r in refusals if refused.issuperset(r[0]))
            verdict = ModeVerdict(states, False, *next(reasons)[1:])
        verdicts.append(verdict)
    return tuple(verdicts)


def without_direction(judged: Iterable[ModeVerdict]) -> dict[tuple[str, ...], str]:
    """Return modes without directions of sliding -> reason, "" if one direction is feasible.

    A reason independent of the direction stands alone, else those of all directions are joined.
    """
    groups: dict[tuple[str, ...], list[ModeVerdict]] = {}
    for mode in judged:
        groups.setdefault(tuple(map(declared_state, mode.states)), []).append(mode)
    return {
        key: "" if any(mode.feasible for mode in group) else _reason(group)
        for key, group in groups.items()
    }


def _reason(directions: Iterable[ModeVerdict]) -> str:
    """Join the reasons of all directions, unless one is independent of the direction."""
    reasons = {m.reason: {"v_t > 0", "v_t < 0"} & {f for _, f in m.conflict} for m in directions}
    undirected = (reason for reason, directed in reasons.items() if not directed)
    return next(undirected, "; ".join(reasons))


def _conditions(states: Sequence[str], count: int) -> list[Condition]:
    if len(states) != count or not _CONDITIONS.keys() >= set(states):
        raise ValueError(
            f"mode {' '.join(states)!r}: expected one state for each of "
            f"{pluralise(count, 'contact')}, of {', '.join(_CONDITIONS)}"
        )
    return [(c, row, sign) for c, state in enumerate(states) for row, sign in _CONDITIONS[state]]


def _scaled(jacobians: Array) -> Array:
    if not np.isfinite(jacobians).all():
        raise ValueError("the contacts' Jacobians are not finite at this configuration")
    if not jacobians.size:
        return jacobians
    size = np.abs(jacobians)
    rows = np.where(size <= _CONE_ROUND_OFF * size.max(axis=(1, 2), keepdims=True), 0.0, jacobians)
    rows /= _divisors(np.abs(rows).max(axis=(0, 1)))
    rows /= _divisors(np.abs(rows).max(axis=(1, 2), keepdims=True))
    sizes = np.linalg.norm(rows, axis=2, keepdims=True)
    # Both rows are velocities of one point: a row that is relatively small is zero.
    scaled: Array = np.where(sizes <= _ZERO, 0.0, rows / _divisors(sizes))
    return scaled


def _divisors(sizes: Array) -> Array:
    return np.where(sizes > 0.0, sizes, 1.0)


def _conflict(rows: Array, conditions: list[Condition]) -> list[Condition] | None:
    """Return an irreducible infeasible subset of the conditions, or None."""
    conflict = _certificate(rows, conditions)
    if conflict is None:
        return None
    for condition in [*conflict]:
        if condition in conflict:
            fewer = [other for other in conflict if other != condition]
            conflict = _certificate(rows, fewer) or conflict
    return sorted(conflict)


def _certificate(rows: Array, conditions: list[Condition]) -> list[Condition] | None:
    """Return an infeasible subset of the conditions, or None."""
    equations = [condition for condition in conditions if condition[2] == 0]
    strict = [condition for condition in conditions if condition[2] != 0]
    if not strict:
        return None
    equation_rows = np.array([rows[c, row] for c, row, _ in equations])
    basis = null_space(equation_rows.reshape(len(equations), rows.shape[2]))
    inequalities = np.array([sign * rows[c, row] for c, row, sign in strict]) @ basis
    sizes = np.linalg.norm(inequalities, axis=1)
    smallest = int(sizes.argmin())
    if sizes[smallest] <= _ZERO:
        return [*equations, strict[smallest]]
    inequalities /= sizes[:, None]
    guess = np.linalg.lstsq(inequalities, np.ones(len(inequalities)), rcond=USER_DIGITS)[0]
    if (inequalities @ guess).min() > _ZERO * np.linalg.norm(guess):
        return None
    weights = _weights(inequalities)
    if weights is None:
        return None
    return [*equations, *(c for c, weight in zip(strict, weights, strict=True) if weight > 0.0)]


def _weights(inequalities: Array) -> Array | None:
    """Return weights >= 0 that combine the rows A (m, k) to zero, None if A w > 0 for some w.

    They are the dual solution of: maximise s with A w >= s, |w| <= 1. HiGHS satisfies constraints
    to 1e-10 at best, so that the sign of s is computed from w.
    """
    from scipy.optimize import linprog

    m, k = inequalities.shape
    result = linprog(
        np.append(np.zeros(k), -1.0),
        A_ub=np.hstack([-inequalities, np.ones((m, 1))]),
        b_ub=np.zeros(m),
        bounds=[*[(-1.0, 1.0)] * k, (None, None)],
        method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if not result.success:
        raise ArithmeticError(f"feasibility of a mode is undecided: {result.message}")
    if (inequalities @ result.x[:k]).min() > _ZERO:
        return None
    weights: Array = -result.ineqlin.marginals
    return weights


def _formulas(conflict: Sequence[Condition]) -> tuple[tuple[int, str], ...]:
    return tuple((c, f"v_{'nt'[row]} {'=><'[sign]} 0") for c, row, sign in conflict)


def _sentence(conflict: Sequence[Condition], names: Sequence[str]) -> str:
    zero: dict[int, set[int]] = {}
    for c, row, sign in conflict:
        if sign == 0:
            zero.setdefault(c, set()).add(row)
    strict = [condition for condition in conflict if condition[2] != 0]
    if len(strict) == 1:
        c, row, _ = strict[0]
        excluded = "go on" if names[c] == DRIVEN else ("separate", "slip")[row]
        premise = f"with {_is_held(zero, names)}" if zero else "in any motion"
        return f"{names[c]} cannot {excluded} {premise}"
    moving = []
    for c, row, sign in strict:
        if names[c] == DRIVEN:
            moving.append(DRIVEN)
            continue
        verb = "slide" if zero.pop(c, None) else "slip"
        moving.append(f"{names[c]} " + (f"{verb}{'+' if sign > 0 else '-'}" if row else "free"))
    premise = f" with {_is_held(zero, names)}" if zero else ""
    return f"{_joined(moving)} exclude one another{premise}"


def _is_held(zero: Mapping[int, set[int]], names: Sequence[str]) -> str:
    phrases = {(0,): "closed", (1,): "without slip", (0, 1): "pin"}
    return _joined([f"{names[c]} {phrases[tuple(sorted(rows))]}" for c, rows in zero.items()])


def _joined(phrases: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(phrases[:-1]), phrases[-1])))


def scene_feasibility(
    regions: Sequence[Region], setup: SceneSetup, snapshot: Snapshot, failing: Sequence[str]
) -> Feasibility:
    """Judge every product mode of a scene by the velocities that it requires.

    All contacts count as touching and on; remarks list those that are not. A contact without a
    normal (a point at the centre of a circle) is an error.
    """
    names = [law.name for law in setup.contacts]
    options = [law.states for law in setup.contacts]
    jacobians = snapshot.jacobians
    driven = _prescribed_velocities(snapshot)
    if driven.any():
        jacobians = np.pad(jacobians, ((0, 1), (0, 0), (0, 1)))
        jacobians[:-1, :, -1], jacobians[-1, 0, -1] = driven, 1.0
        names, options = [*names, DRIVEN], [*options, ("free",)]
    if not np.isfinite(jacobians).all():
        raise StatechartError(
            "the contacts have no direction at this configuration; choose another configuration"
        )
    verdicts = feasible_modes(jacobians, options, names)
    count = len(setup.contacts)
    directed = {mode.states[:count]: mode.reason for mode in verdicts}
    undirected = {key[:count]: reason for key, reason in without_direction(verdicts).items()}
    places = [[region.name for region in regions].index(n) for n in names[:count]]
    declared = (dict.fromkeys(map(region.declared, region.states)) for region in regions)
    return Feasibility(
        {k: directed[tuple(k[i] for i in places)] for k in product(*(r.states for r in regions))},
        {k: undirected[tuple(k[i] for i in places)] for k in product(*declared)},
        _remarks(setup, snapshot, failing),
    )


def _prescribed_velocities(snapshot: Snapshot) -> Array:
    """Return the velocities (c, 2) of the contacts due to prescribed motions."""
    rates = np.array([(contact.gap_rate, contact.slip) for contact in snapshot.contacts])
    reduced_rates = snapshot.jacobians @ snapshot.velocity
    driven: Array = rates.reshape(-1, 2) - reduced_rates
    sizes = np.abs(snapshot.jacobians) @ np.abs(snapshot.velocity)
    # Small differences are round-off.
    return np.where(np.abs(driven) > 1e-12 * (sizes + np.abs(reduced_rates)), driven, 0.0)


def _remarks(setup: SceneSetup, snapshot: Snapshot, failing: Sequence[str]) -> tuple[str, ...]:
    near, remarks = setup.tolerances["gap"], list[str]()
    for law, contact, why in zip(setup.contacts, snapshot.contacts, failing, strict=True):
        name, gap = law.name, contact.gap
        if why:
            off, on = ("open", "closed") if law.coupling else ("off", "on")
            remarks.append(f"{name} is {off}, as {why!r} does not hold: judged as if it were {on}")
        elif gap > near:
            remarks.append(f"{name} does not touch (gap {gap:.6g}): judged as if it did")
        elif gap < -near:
            remarks.append(f"{name} is {-gap:.6g} inside its surface")
    if snapshot.reduction is not None:
        joints = snapshot.reduction.joints
        distance = float(np.abs(joints.gaps[joints.on]).max(initial=0.0))
        remarks += [f"joints are apart by up to {distance:.6g}"] if distance > near else []
    return tuple(remarks)
