"""From a state to the mode of every contact, and why: complementarity on accelerations.

The answer depends on the state alone, never on which event fired. Every mode of the closed
contacts is tried (enumeration is the one method that can prove that there is none, one, or
several), and judged by its own inequalities.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from contacts.scales import Scales
from contacts.snapshot import PerContact, Snapshot, solve_kkt
from statechart.errors import AmbiguousMode, NoConsistentMode

__all__ = ["Candidate", "Choice", "ContactLaw", "candidates", "choose"]

Array = NDArray[np.float64]

_SIGN = {"slide+": 1.0, "slide-": -1.0, "slide": 0.0}
# Two motions are the same when their accelerations agree to this.
_SAME_MOTION = 1e-9


@dataclass(frozen=True)
class ContactLaw:
    """What a contact may do.

    Attributes
    ----------
    name : str
        Of the contact.
    states : tuple of str
        Its region's states.
    cone_n, cone_t : float
        Unit edge of the friction cone.
    restitution : float
        Coefficient, 0 where the contact is never free.
    impact : str
        stronge, newton or poisson.
    """

    name: str
    states: tuple[str, ...]
    cone_n: float
    cone_t: float
    restitution: float
    impact: str


@dataclass(frozen=True, eq=False)
class Candidate:
    """One assignment of modes to the contacts, solved.

    Attributes
    ----------
    states : tuple of str
        Per contact.
    accelerations : (n,) array
    forces : (c, 2) array
        V and H per contact.
    violation : float
        The largest inequality it breaks, in units of the scales; <= 0: none.
    reason : str
        Which one, or "" where consistent.
    """

    states: tuple[str, ...]
    accelerations: Array
    forces: Array
    violation: float
    reason: str


@dataclass(frozen=True, eq=False)
class Choice:
    """The candidate taken, what was considered, and what a reader must know.

    Attributes
    ----------
    taken : Candidate
    considered : mapping
        Mode -> why it was taken or not.
    warning : str
        "" or a sentence, such as for an indeterminate contact.
    """

    taken: Candidate
    considered: Mapping[str, str]
    warning: str = ""


def candidates(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    options: Sequence[Sequence[str]],
    scales: Scales,
    still: Sequence[bool],
) -> list[Candidate | tuple[tuple[str, ...], str]]:
    """Solve every combination of `options` (states per contact).

    Parameters
    ----------
    snapshot : Snapshot
        The state's numbers.
    laws : sequence of ContactLaw
        One per contact.
    options : sequence of sequence of str
        States to try per contact; contacts that are not closed have ("free",).
    scales : Scales
        For judging inequalities.
    still : sequence of bool
        Whether the contact's slip is zero.

    Returns
    -------
    list
        A `Candidate`, or (states, reason) where the combination determines no motion.
    """
    found: list[Candidate | tuple[tuple[str, ...], str]] = []
    for states in product(*options):
        solved = _solve(snapshot, laws, states)
        if solved is None:
            found.append((states, "its equations do not determine the motion"))
            continue
        accelerations, forces = solved
        violation, reason = -math.inf, ""
        for contact, law, state, force, at_rest, tried in zip(
            snapshot.contacts, laws, states, forces, still, options, strict=True
        ):
            if len(tried) == 1 and state == "free":
                continue
            for amount, words in _judge(contact, law, state, accelerations, force, at_rest, scales):
                if amount > violation:
                    violation, reason = amount, f"{law.name}: {words}"
        found.append(Candidate(states, accelerations, forces, violation, reason))
    return found


def choose(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    closed: Sequence[bool],
    scales: Scales,
    tie: float,
    still_below: float,
) -> Choice:
    """Return the mode that the state calls for.

    Parameters
    ----------
    closed : sequence of bool
        Which contacts touch; the others are free.
    tie : float
        Violations up to this (relative) count as boundary cases, not as violations.
    still_below : float
        Slip speeds up to this count as zero.

    Raises
    ------
    NoConsistentMode, AmbiguousMode
        With every candidate and its reason.
    """
    still = [abs(contact.slip) <= still_below for contact in snapshot.contacts]
    options = [
        _options(contact, law, touching, at_rest)
        for contact, law, touching, at_rest in zip(
            snapshot.contacts, laws, closed, still, strict=True
        )
    ]
    tried = candidates(snapshot, laws, options, scales, still)
    solved = [c for c in tried if isinstance(c, Candidate)]
    consistent = [c for c in solved if c.violation <= tie]
    considered = {_label(laws, c): _verdict(c, tie) for c in tried}
    if not consistent:
        raise NoConsistentMode(
            "no mode of the contacts agrees with the state; "
            + "; ".join(f"{label}: {why}" for label, why in considered.items())
        )
    taken = min(consistent, key=lambda c: (c.violation > 0.0, _openness(c)))
    others = [
        c
        for c in consistent
        if np.abs(c.accelerations - taken.accelerations).max()
        > _SAME_MOTION * max(scales.acceleration, float(np.abs(taken.accelerations).max()))
        and c.violation <= 0.0
    ]
    warning = ""
    if others and taken.violation <= 0.0:
        labels = ", ".join(_label(laws, c) for c in [taken, *others])
        opened = [c for c in [taken, *others] if any(
            state == "free" and touching for state, touching in zip(c.states, closed, strict=True)
        )]
        if not opened:
            raise AmbiguousMode(f"several modes agree with the state and move it apart: {labels}")
        # Painleve's indeterminate case: contact could also hold, at a force without cause.
        taken = min(opened, key=_openness)
        warning = f"indeterminate: {labels} all agree with the state; {_label(laws, taken)} taken"
    considered[_label(laws, taken)] = "taken"
    return Choice(taken, considered, warning)


def _options(
    contact: PerContact, law: ContactLaw, touching: bool, at_rest: bool
) -> tuple[str, ...]:
    if not touching:
        return ("free",)
    direction = "slide+" if contact.slip > 0 else "slide-"
    return tuple(
        state
        for state in law.states
        if state in ("free", "slide") or at_rest or state == direction
    )


def _openness(candidate: Candidate) -> tuple[int, int, str]:
    """Most contacts closed first, then most of them pinned; names make ties deterministic."""
    states = candidate.states
    return (
        sum(state == "free" for state in states),
        sum(state != "pin" for state in states),
        " ".join(states),
    )


def _solve(
    snapshot: Snapshot, laws: Sequence[ContactLaw], states: Sequence[str]
) -> tuple[Array, Array] | None:
    """Solve a mode numerically; the same equations as the symbolic mode's."""
    n = len(snapshot.forces)
    closed = [i for i, state in enumerate(states) if state != "free"]
    size = 2 * len(closed)
    rows, constants = np.zeros((size, n + size)), np.zeros(size)
    columns = np.zeros((n, size))
    for place, i in enumerate(closed):
        contact, law, state = snapshot.contacts[i], laws[i], states[i]
        at = 2 * place
        columns[:, at : at + 2] = contact.jacobian.T
        rows[at, :n], constants[at] = contact.jacobian[0], -contact.bias_n
        if state == "pin":
            rows[at + 1, :n], constants[at + 1] = contact.jacobian[1], -contact.bias_t
        else:
            rows[at + 1, n + at] = _SIGN[state] * law.cone_t
            rows[at + 1, n + at + 1] = law.cone_n
    solved = solve_kkt(snapshot.mass, snapshot.forces, rows, columns, constants)
    if solved is None:
        return None
    forces = np.zeros((len(states), 2))
    forces[closed] = solved[1].reshape(-1, 2)
    return solved[0], forces


def _judge(
    contact: PerContact,
    law: ContactLaw,
    state: str,
    accelerations: Array,
    force: Array,
    at_rest: bool,
    scales: Scales,
) -> list[tuple[float, str]]:
    """Return (violation, words) of every inequality of a contact's mode."""
    V, H = float(force[0]), float(force[1])
    n, t = law.cone_n, law.cone_t
    if state == "free":
        apart = float(contact.jacobian[0] @ accelerations) + contact.bias_n
        return [(-apart / scales.acceleration, f"it would accelerate into the surface ({apart:.3g})")]
    if state == "pin":
        found = [(-V / scales.force, f"V = {V:.3g} < 0")]
        if n > 0.0:
            outside = n * abs(H) - t * V
            found.append((outside / scales.force, f"|H| = {abs(H):.3g} > mu V"))
        return found
    sign = _SIGN[state]
    edge = n * V - sign * t * H
    found = [(-edge / scales.force, f"V = {V:.3g} < 0")]
    if sign and at_rest:
        along = sign * (float(contact.jacobian[1] @ accelerations) + contact.bias_t)
        found.append((-along / scales.acceleration, f"slip would accelerate against it ({along:.3g})"))
    return found


def _label(
    laws: Sequence[ContactLaw], candidate: Candidate | tuple[tuple[str, ...], str]
) -> str:
    states = candidate.states if isinstance(candidate, Candidate) else candidate[0]
    return " ".join(f"{law.name}:{state}" for law, state in zip(laws, states, strict=True))


def _verdict(candidate: Candidate | tuple[tuple[str, ...], str], tie: float) -> str:
    if not isinstance(candidate, Candidate):
        return candidate[1]
    if candidate.violation <= 0.0:
        return "consistent"
    if candidate.violation <= tie:
        return f"consistent within the tie band: {candidate.reason}"
    return candidate.reason
