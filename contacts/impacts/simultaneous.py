"""Impacts over all closed contacts at once: plastic, capped by the energy, or one after another.

Contacts without common coordinates are independent. A single contact has its own law: a path
(`contacts.impacts.impact`), or Moreau's. Several contacts have two solutions of Moreau's law
(`contacts.impacts.impulses`): the plastic one never raises the energy; the one with restitution
may. The impulse is the farthest convex combination of both that does not raise the energy; it
satisfies the friction cones (convex) and ``v_n+ >= 0`` (linear). A note says where another order of
the impacts would give other velocities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import Snapshot
from contacts.impacts.impact import impact
from contacts.impacts.impulses import (
    ImpactProblem,
    Impulses,
    label_coupled_coordinates,
    solve_collisions,
    work_of,
)
from contacts.scene.parts import MOREAU, Simultaneous
from contacts.solvers.impact_sequence import ALIKE, LONGEST_SEQUENCE
from contacts.solvers.island_impulses import parabola_root
from contacts.solvers.step_impulses import LIVELY, NEGLIGIBLE_CHANGE
from statechart.arrays import Array
from statechart.errors import NoConsistentMode

# A sequence of impacts ends at this part of the first approach velocity: it is geometric.
_MIN_APPROACH = 1e-12
_ROUND_OFF = 64 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Impacts:
    """Result of the impacts of an instant."""

    velocity: Array  # (n,): Rates of the coordinates after the impacts
    impulses: Array  # (c, 2): V and H on the body
    path: tuple[str, ...]  # Impacts in order
    warning: str = ""  # "" or sentences
    notes: tuple[str, ...] = ()  # Sentences that a run reports once


class _GroupImpacts(NamedTuple):
    """Result of the impacts of one group of contacts."""

    change: Array
    impulses: Array
    path: list[str]
    warning: str
    note: str = ""


def impacts(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    closed: Sequence[bool],
    choice: Simultaneous = "capped",
) -> Impacts:
    """Return the outcome of all impacts at one instant.

    Raises `NoConsistentMode` if no impulse agrees with the laws.
    """
    change, impulses = np.zeros(len(snapshot.velocity)), np.zeros((len(laws), 2))
    path: list[str] = []
    warnings: list[str] = []
    notes: list[str] = []
    for group in groups(snapshot, closed):
        if min(snapshot.contacts[i].gap_rate for i in group) >= 0.0:
            continue
        if len(group) == 1:
            result = _single_impact(snapshot, laws, group[0])
        elif choice == "sequential":
            result = _solve_sequentially(snapshot, laws, group)
        else:
            result = _solve_simultaneously(snapshot, laws, group, choice == "capped")
        change += result.change
        impulses += result.impulses
        path += result.path
        warnings += [result.warning] if result.warning else []
        notes += [result.note] if result.note else []
    warning = "; ".join(warnings)
    return Impacts(snapshot.velocity + change, impulses, tuple(path), warning, tuple(notes))


def groups(snapshot: Snapshot, closed: Sequence[bool]) -> list[list[int]]:
    """Return the groups of closed contacts that are coupled by their coordinates."""
    closed_contacts = [i for i, is_closed in enumerate(closed) if is_closed]
    if len(closed_contacts) == 1:
        return [closed_contacts]
    labels = label_coupled_coordinates(snapshot, closed_contacts)
    groups: dict[int, list[int]] = {}
    for i in closed_contacts:
        touched = np.abs(snapshot.jacobians[i]).max(axis=0) > 0.0
        if touched.any():
            groups.setdefault(int(labels[touched][0]), []).append(i)
    return list(groups.values())


def _single_impact(snapshot: Snapshot, laws: Sequence[ContactLaw], place: int) -> _GroupImpacts:
    law = laws[place]
    if law.impact == MOREAU:
        return _solve_simultaneously(snapshot, laws, [place], True)
    result = impact(snapshot, place, law, law.restitution)
    impulses = np.zeros((len(laws), 2))
    impulses[place] = result.normal, result.tangential
    change = result.velocity - snapshot.velocity
    raised = f"{law.name}: the impact law {law.impact!r} raised the energy"
    warning = raised if result.raises_energy else ""
    path = [f"{law.name} {' '.join(result.path)}"]
    return _GroupImpacts(change, impulses, path, warning)


def _solve_simultaneously(
    snapshot: Snapshot, laws: Sequence[ContactLaw], group: list[int], rebound: bool
) -> _GroupImpacts:
    """Solve for the velocities of all contacts of a group at once."""
    closed = [i in group for i in range(len(laws))]
    names = ", ".join(laws[i].name for i in group)
    elastic = [law.restitution for law in laws]
    plastic = solve_collisions(snapshot, laws, closed, [0.0] * len(laws))
    if not plastic:
        raise NoConsistentMode(
            f"no plastic impulse of {names} satisfies the friction cones; lower their friction"
        )
    base, elastic_solutions = plastic[0], plastic
    plastic_share, share, target = 1.0, 0.0, base
    warnings: list[str] = []
    if rebound and any(elastic[i] > 0.0 for i in group):
        elastic_solutions = solve_collisions(snapshot, laws, closed, elastic)
        if elastic_solutions:
            target = elastic_solutions[0]
            plastic_share, share = _work_free_shares(snapshot, group, base, target)
        else:
            warnings.append(f"{names}: no impulse satisfies Moreau's law; the impact is plastic")
    several = plastic if len(plastic) > 1 else elastic_solutions
    if len(several) > 1:
        modes = " | ".join(", ".join(solution.states[i] for i in group) for solution in several)
        warnings.append(
            f"{names}: several impulses satisfy the impact law ({modes}); the run takes the first"
        )
    change = plastic_share * base.change + share * target.change
    impulses = plastic_share * base.impulses + share * target.impulses
    base_modes, modes = (
        ", ".join(f"{laws[i].name}:{one.states[i]}" for i in group) for one in (base, target)
    )
    path = [f"plastic {base_modes}"] + ([f"to {share:.6g} moreau {modes}"] if share > 0.0 else [])
    note = ""
    if rebound and (struck := _order_matters(snapshot, laws, group, target.impulses)):
        note = (
            f"{', '.join(struck)} are struck at once, with a restitution of {LIVELY:g} or more: "
            "Moreau's law resolves these impacts together; for one after another write "
            "simultaneous: sequential"
        )
    return _GroupImpacts(change, impulses, path, "; ".join(warnings), note)


def _order_matters(
    snapshot: Snapshot, laws: Sequence[ContactLaw], group: Sequence[int], impulses: Array
) -> list[str]:
    """Return the names of `LIVELY` contacts of different body pairs whose impacts interact."""
    lively = [i for i in group if laws[i].restitution >= LIVELY and impulses[i, 0] > 0.0]
    pairs = np.array([laws[i].pair for i in lively])
    if len(set(pairs.tolist())) < 2:
        return []
    moved = np.abs(snapshot.jacobians[lively]).max(axis=(0, 1)) > 0.0
    normals = snapshot.jacobians[lively][:, 0, moved]
    columns = np.linalg.solve(snapshot.mass[np.ix_(moved, moved)], normals.T)
    changes = np.abs(normals @ columns * impulses[lively, 0])
    others = pairs[:, None] != pairs
    affects = (changes > NEGLIGIBLE_CHANGE * np.diag(changes)[:, None]) & others
    named = affects.any(axis=0) | affects.any(axis=1)
    return [laws[i].name for i, one in zip(lively, named.tolist(), strict=True) if one]


def _work_free_shares(
    snapshot: Snapshot, group: Sequence[int], plastic: Impulses, target: Impulses
) -> tuple[float, float]:
    """Return (1 - s, s) for the largest s at which the impulses do no work on the bodies.

    With surfaces at rest that work is the change of the kinetic energy.
    """
    gain, size = _work(snapshot, group, target)
    if gain <= _ROUND_OFF * size:
        return 0.0, 1.0
    difference = target.change - plastic.change
    curvature = 0.5 * float(difference @ snapshot.mass @ difference)
    return parabola_root(min(_work(snapshot, group, plastic)[0], 0.0), gain, curvature)


def _work(snapshot: Snapshot, group: Sequence[int], solution: Impulses) -> tuple[float, float]:
    before = np.array([snapshot.contacts[i][1:3] for i in group])
    problem = ImpactProblem(
        snapshot.mass, snapshot.jacobians[group], np.empty((0, 2)), before, snapshot.velocity, True
    )
    work, size = work_of(problem, solution.change, solution.impulses[group])
    return float(work), float(size)


def _solve_sequentially(
    snapshot: Snapshot, laws: Sequence[ContactLaw], group: list[int]
) -> _GroupImpacts:
    """Compute impacts one after another, the fastest approach first, equal ones together."""
    impulses, path, warnings = np.zeros((len(laws), 2)), list[str](), list[str]()
    current, first_approach, struck = snapshot, 0.0, set[int]()
    normals, terms = np.abs(snapshot.jacobians[group, 0]), np.abs(snapshot.velocity)
    while True:
        rates = np.array([current.contacts[i].gap_rate for i in group])
        limits = _ROUND_OFF * (np.abs(rates) + normals @ terms) if path else 0.0
        approaching: list[int] = np.flatnonzero(rates < -limits).tolist()
        if not approaching:
            break
        approach = -float(rates[approaching].min())
        first_approach = first_approach or approach
        endless = len(path) >= LONGEST_SEQUENCE or approach < _MIN_APPROACH * first_approach
        if endless:
            if struck.issuperset(approaching):
                names = ", ".join(laws[i].name for i in group)
                warnings = [
                    f"{names}: the sequence of impacts does not end; after {len(path)} the "
                    f"approach velocity is {approach:.3g}, and the rest is plastic"
                ]
            result = _solve_simultaneously(current, laws, group, False)
            results = [result._replace(path=["plastic rest"])]
        else:
            # Equal approaches are one impact where they affect each other.
            alike = [k for k in approaching if -rates[k] >= (1.0 - ALIKE) * approach]
            fastest = [i in {group[k] for k in alike} for i in range(len(laws))]
            struck.update(alike)
            results = [
                _single_impact(current, laws, together[0])
                if len(together) == 1
                else _solve_simultaneously(current, laws, together, True)
                for together in groups(snapshot, fastest)
            ]
        velocity = current.velocity
        for result in results:
            impulses += result.impulses
            path += result.path
            warnings += [result.warning] if result.warning else []
            velocity = velocity + result.change
        current = _with_velocity(snapshot, velocity)
        if endless:
            break
        terms = np.maximum(terms, np.abs(current.velocity))
    change, warning = current.velocity - snapshot.velocity, "; ".join(dict.fromkeys(warnings))
    return _GroupImpacts(change, impulses, path, warning)


def _with_velocity(snapshot: Snapshot, velocity: Array) -> Snapshot:
    changes = (snapshot.jacobians @ (velocity - snapshot.velocity)).tolist()
    contacts = tuple(
        contact._replace(gap_rate=contact.gap_rate + normal, slip=contact.slip + tangential)
        for contact, (normal, tangential) in zip(snapshot.contacts, changes, strict=True)
    )
    return snapshot._replace(velocity=velocity, contacts=contacts)
