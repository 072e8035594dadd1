"""Impacts over all closed contacts at once: plastic, capped by the energy, or one after another.

Contacts that share no coordinate do not feel each other; a contact alone has its own law: a path
(`contacts.impacts.impact`), or Moreau's. That one solves for the velocities after it, of all
contacts at once. There are two impulses then (`contacts.impacts.impulses`): the plastic one never
raises the energy; the one with restitution may. The largest share of the way from one to the
other that keeps the energy keeps the cones (they are convex) and ``v_n+ >= 0`` (it is linear) as
well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.impacts.impact import RAISES, Impact, impact
from contacts.impacts.impulses import ImpactProblem, Impulses, collisions, coupled, work_of
from contacts.scene.parts import MOREAU, Simultaneous
from contacts.solvers.step_impulses import LONGEST_SEQUENCE, shares
from statechart.arrays import Array
from statechart.errors import NoConsistentMode

# Of the first approach: what is left of a sequence then is the tail of a geometric one.
_SPENT = 1e-12
_ROUND_OFF = 64 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Impacts:
    """Result of the impacts of an instant."""

    velocity: Array  # (n,): Rates of the coordinates after them
    impulses: Array  # (c, 2): V and H on the body
    path: tuple[str, ...]  # What was done, in order
    # Of the way from the plastic impulse to the one with restitution; the smallest where several
    # groups of contacts are hit, 1 where no group needs it
    share: float
    indeterminate: tuple[bool, ...]  # See `contacts.impacts.impulses.Impulses`
    warning: str = ""  # "" or sentences


class _Done(NamedTuple):
    """Impacts of one group of contacts: what they change, and what is to be told of them."""

    change: Array
    impulses: Array
    path: list[str]
    warning: str
    share: float
    indeterminate: Sequence[bool]


def impacts(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    closed: Sequence[bool],
    choice: Simultaneous = "capped",
) -> Impacts:
    """Return the outcome of all impacts at one instant.

    Raises `NoConsistentMode` if no impulse agrees with the laws.
    """
    count = len(laws)
    change = np.zeros(len(snapshot.velocity))
    impulses = np.zeros((count, 2))
    indeterminate = [False] * count
    path: list[str] = []
    warnings: list[str] = []
    share = 1.0
    for group in groups(snapshot, closed):
        if min(snapshot.contacts[i].gap_rate for i in group) >= 0.0:
            continue
        if len(group) == 1:
            done = _single_impact(snapshot, laws, group[0])
        elif choice == "sequential":
            done = _in_sequence(snapshot, laws, group)
        else:
            done = _at_once(snapshot, laws, group, choice == "capped")
        share = min(share, done.share)
        for i in group:
            indeterminate[i] = done.indeterminate[i]
        change += done.change
        impulses += done.impulses
        path += done.path
        warnings += [done.warning] if done.warning else []
    velocity = snapshot.velocity + change
    told = "; ".join(warnings)
    return Impacts(velocity, impulses, tuple(path), share, tuple(indeterminate), told)


def groups(snapshot: Snapshot, closed: Sequence[bool]) -> list[list[int]]:
    """Return the closed contacts, those together whose impulses feel each other."""
    shut = [i for i, is_closed in enumerate(closed) if is_closed]
    if len(shut) == 1:
        return [shut]
    labels = coupled(snapshot, shut)
    groups: dict[int, list[int]] = {}
    for i in shut:
        touched = np.abs(snapshot.jacobians[i]).max(axis=0) > 0.0
        if touched.any():
            groups.setdefault(int(labels[touched][0]), []).append(i)
    return list(groups.values())


def _single_impact(snapshot: Snapshot, laws: Sequence[ContactLaw], place: int) -> _Done:
    """Let one contact be hit, by its own law."""
    law, contact = laws[place], snapshot.contacts[place]
    if law.impact == MOREAU:
        return _at_once(snapshot, laws, [place], True)
    result = impact(snapshot, contact, law, law.restitution)
    impulses = np.zeros((len(laws), 2))
    impulses[place] = result.normal, result.tangential
    change = result.velocity - snapshot.velocity
    raised = _raises(contact, result, change)
    warning = f"{law.name}: the impact law {law.impact!r} raised the energy" if raised else ""
    path = [f"{law.name} {' '.join(result.path)}"]
    return _Done(change, impulses, path, warning, 1.0, [False] * len(laws))


def _raises(contact: PerContact, result: Impact, change: Array) -> bool:
    """Return whether the impulse increases the kinetic energy beyond round-off."""
    normal, tangential = (contact.jacobian @ change).tolist()
    work = result.normal * (contact.gap_rate + 0.5 * normal)
    work += result.tangential * (contact.slip + 0.5 * tangential)
    size = result.normal * abs(contact.gap_rate) + abs(result.tangential * contact.slip)
    return work > RAISES * size


def _at_once(
    snapshot: Snapshot, laws: Sequence[ContactLaw], group: list[int], rebound: bool
) -> _Done:
    """Solve for the velocities of all contacts of a group at once."""
    closed = [i in group for i in range(len(laws))]
    names = ", ".join(laws[i].name for i in group)
    elastic = [law.restitution for law in laws]
    plastic = collisions(snapshot, laws, closed, [0.0] * len(laws))
    if not plastic and rebound and any(elastic[i] > 0.0 for i in group):
        done = _in_sequence(snapshot, laws, group)
        why = (
            f"no simultaneous impulse of {names} satisfies the friction cones; the impacts "
            "follow one another"
        )
        return done._replace(warning="; ".join(filter(None, (why, done.warning))))
    if not plastic:
        raise NoConsistentMode(f"no plastic impulse of {names} satisfies the friction cones")
    base, found = plastic[0], plastic
    rest, share, target = 1.0, 0.0, base
    warnings: list[str] = []
    if rebound and any(elastic[i] > 0.0 for i in group):
        found = collisions(snapshot, laws, closed, elastic)
        if found:
            target = found[0]
            rest, share = _shares(snapshot, group, base, target)
        else:
            warnings.append(f"{names}: no impulse satisfies Moreau's law; the impact is plastic")
    if len(plastic) > 1 or len(found) > 1:
        several = plastic if len(plastic) > 1 else found
        modes = " | ".join(", ".join(one.states[i] for i in group) for one in several)
        warnings.append(
            f"{names}: several impulses satisfy the impact law ({modes}); the first is taken"
        )
    change = rest * base.change + share * target.change
    impulses = rest * base.impulses + share * target.impulses
    modes = ", ".join(f"{laws[i].name}:{base.states[i]}" for i in group)
    path = [f"plastic {modes}"]
    if share > 0.0:
        modes = ", ".join(f"{laws[i].name}:{target.states[i]}" for i in group)
        path.append(f"to {share:.6g} moreau {modes}")
    unknown = tuple(a or b for a, b in zip(base.indeterminate, target.indeterminate, strict=True))
    return _Done(change, impulses, path, "; ".join(warnings), share, unknown)


def _shares(
    snapshot: Snapshot, group: Sequence[int], plastic: Impulses, target: Impulses
) -> tuple[float, float]:
    """Return (1 - s, s) for the largest s at which the impulses do no work on the bodies.

    That work is the change of the kinetic energy where the surfaces are at rest, and what counts
    where they move.
    """
    gain, size = _work(snapshot, group, target)
    if gain <= _ROUND_OFF * size:
        return 0.0, 1.0
    further = target.change - plastic.change
    curvature = 0.5 * float(further @ snapshot.mass @ further)
    rest, share = shares(min(_work(snapshot, group, plastic)[0], 0.0), gain, curvature)
    return rest, share


def _work(snapshot: Snapshot, group: Sequence[int], found: Impulses) -> tuple[float, float]:
    """Return what `work_of` does, of one solution."""
    before = np.array([snapshot.contacts[i][1:3] for i in group])
    problem = ImpactProblem(
        snapshot.mass, snapshot.jacobians[group], np.empty((0, 2)), before, snapshot.velocity, True
    )
    work, size = work_of(problem, found.change, found.impulses[group])
    return float(work), float(size)


def _in_sequence(snapshot: Snapshot, laws: Sequence[ContactLaw], group: list[int]) -> _Done:
    """Let one contact after another be hit."""
    impulses = np.zeros((len(laws), 2))
    path: list[str] = []
    now, first = snapshot, 0.0
    terms = np.abs(snapshot.velocity)
    told: list[str] = []
    while True:
        moving = [now.contacts[i] for i in group]
        limits = [
            _ROUND_OFF * (abs(c.gap_rate) + float(np.abs(c.jacobian[0]) @ terms)) for c in moving
        ]
        hit = [k for k in range(len(group)) if moving[k].gap_rate < (-limits[k] if path else 0.0)]
        if not hit:
            break
        k = min(hit, key=lambda k: moving[k].gap_rate)
        approach = -moving[k].gap_rate
        first = first or approach
        endless = len(path) >= LONGEST_SEQUENCE or approach < _SPENT * first
        if endless:
            names = ", ".join(laws[i].name for i in group)
            told = [
                (
                    f"{names}: the sequence of impacts does not end; after {len(path)} the "
                    f"approach velocity is {approach:.3g}, and the rest is plastic"
                )
            ]
            done = _at_once(now, laws, group, False)._replace(path=["plastic rest"])
        else:
            done = _single_impact(now, laws, group[k])
        impulses += done.impulses
        path += done.path
        told += [done.warning] if done.warning else []
        now = _with_velocity(snapshot, now.velocity + done.change)
        if endless:
            break
        terms = np.maximum(terms, np.abs(now.velocity))
    change, warning = now.velocity - snapshot.velocity, "; ".join(dict.fromkeys(told))
    return _Done(change, impulses, path, warning, 1.0, [False] * len(laws))


def _with_velocity(snapshot: Snapshot, velocity: Array) -> Snapshot:
    """Return the numbers at other rates of the coordinates."""
    contacts = []
    for contact in snapshot.contacts:
        normal, slip = (contact.jacobian @ (velocity - snapshot.velocity)).tolist()
        rates = {"gap_rate": contact.gap_rate + normal, "slip": contact.slip + slip}
        contacts.append(contact._replace(**rates))
    return snapshot._replace(velocity=velocity, contacts=tuple(contacts))
