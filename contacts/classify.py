"""From a state to the mode of every contact, and why: complementarity on accelerations.

The answer depends on the state alone, never on which event fired. Every mode of the closed
contacts is tried (enumeration is the one method that can prove that there is none, one, or
several), and judged by its own inequalities.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.kernels import (
    AGAINST,
    FREE,
    INTO,
    OUTSIDE,
    PIN,
    PULLS,
    SLIDE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    SOLVED,
    solve_modes,
)
from contacts.modes import OFF
from contacts.scales import Scales
from contacts.snapshot import PerContact, Snapshot
from statechart.errors import AmbiguousMode, NoConsistentMode

__all__ = ["Candidate", "Choice", "ContactLaw", "candidates", "choose"]

Array = NDArray[np.float64]

_CODES = {
    "free": FREE,
    OFF: FREE,
    "pin": PIN,
    "slide": SLIDE,
    "slide+": SLIDE_PLUS,
    "slide-": SLIDE_MINUS,
}
_WORDS = {
    INTO: "it would accelerate at {:.3g} into the surface",
    PULLS: "V = {:.3g} < 0",
    OUTSIDE: "|H| = {:.6g} > mu V",
    AGAINST: "slip would accelerate at {:.3g} against it",
}
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


Undetermined = tuple[tuple[str, ...], str]
"""States per contact, and why they determine no motion."""


class Candidate(NamedTuple):
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
    broken : (str, int, float)
        That inequality: contact, which (as `contacts.kernels` numbers them), its number.
    """

    states: tuple[str, ...]
    accelerations: Array
    forces: Array
    violation: float
    broken: tuple[str, int, float]

    @property
    def reason(self) -> str:
        """The inequality it is judged by, in words."""
        contact, which, number = self.broken
        return f"{contact}: " + _WORDS[which].format(number)


class Considered(Mapping[str, str]):
    """Every mode tried and why it was taken or not; put into words when first read."""

    def __init__(
        self,
        laws: Sequence[ContactLaw],
        tried: Sequence[Candidate | Undetermined],
        taken: Candidate,
        tie: float,
    ) -> None:
        self._parts = laws, tried, taken, tie

    @cached_property
    def _words(self) -> dict[str, str]:
        laws, tried, taken, tie = self._parts
        return {_label(laws, c): "taken" if c is taken else _verdict(c, tie) for c in tried}

    def __getitem__(self, label: str) -> str:
        return self._words[label]

    def __iter__(self) -> Iterator[str]:
        return iter(self._words)

    def __len__(self) -> int:
        return len(self._words)


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
    closed: Sequence[bool],
    still: Sequence[bool],
    scales: Scales,
) -> list[Candidate | Undetermined]:
    """Solve every combination of `options` (states per contact).

    Parameters
    ----------
    snapshot : Snapshot
        The state's numbers.
    laws : sequence of ContactLaw
        One per contact.
    options : sequence of sequence of str
        States to try per contact; contacts that are not closed have ("free",).
    closed, still : sequence of bool
        Whether the contact's gap is closed; whether its slip is zero.
    scales : Scales
        For judging inequalities.

    Returns
    -------
    list
        A `Candidate`, or (states, reason) where the combination determines no motion.
    """
    combinations, codes = _combinations(tuple(options))
    cones = np.array([(law.cone_n, law.cone_t) for law in laws], dtype=float).reshape(-1, 2)
    status, accelerations, forces, verdicts = solve_modes(
        snapshot.mass,
        snapshot.forces,
        snapshot.jacobians,
        snapshot.biases,
        cones,
        codes,
        np.array(closed, dtype=np.bool_),
        np.array(still, dtype=np.bool_),
        scales.force,
        scales.acceleration,
    )
    found: list[Candidate | Undetermined] = []
    for k, (states, solved, verdict) in enumerate(
        zip(combinations, status.tolist(), verdicts.tolist(), strict=True)
    ):
        if solved != SOLVED:
            found.append((states, "its equations do not determine the motion"))
            continue
        violation, contact, which, number = verdict
        broken = (laws[int(contact)].name if laws else "", int(which), number)
        found.append(Candidate(states, accelerations[k], forces[k], violation, broken))
    return found


@lru_cache(maxsize=1024)
def _combinations(
    options: tuple[Sequence[str], ...],
) -> tuple[tuple[tuple[str, ...], ...], NDArray[np.int64]]:
    """Return every combination of states, in names and as the kernel numbers them."""
    combinations = tuple(product(*options))
    return combinations, np.array([[_CODES[state] for state in s] for s in combinations], np.int64)


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
    tried = candidates(snapshot, laws, options, closed, still, scales)
    solved = [c for c in tried if isinstance(c, Candidate)]
    consistent = [c for c in solved if c.violation <= tie]
    if not consistent:
        considered = {_label(laws, c): _verdict(c, tie) for c in tried}
        raise NoConsistentMode(
            "no mode of the contacts agrees with the state; "
            + "; ".join(f"{label}: {why}" for label, why in considered.items())
        )
    taken = min(consistent, key=lambda c: (c.violation > 0.0, _openness(c)))
    # On the edge of its inequalities (a massless body that needs no force) a mode is no rival.
    sure = [c for c in consistent if c.violation < -tie] if taken.violation < -tie else []
    others = [c for c in sure if c is not taken and not _same_motion(c, taken, scales)]
    warning = ""
    if others:
        labels = ", ".join(_label(laws, c) for c in [taken, *others])
        opened = [
            c
            for c in [taken, *others]
            if any(
                state == "free" and touching
                for state, touching in zip(c.states, closed, strict=True)
            )
        ]
        if not opened:
            raise AmbiguousMode(f"several modes agree with the state and move it apart: {labels}")
        # Painleve's indeterminate case: contact could also hold, at a force without cause.
        taken = min(opened, key=_openness)
        warning = f"indeterminate: {labels} all agree with the state; {_label(laws, taken)} taken"
    return Choice(taken, Considered(laws, tried, taken, tie), warning)


def _same_motion(one: Candidate, other: Candidate, scales: Scales) -> bool:
    size = max(scales.acceleration, float(np.abs(other.accelerations).max()))
    difference = np.abs(one.accelerations - other.accelerations).max()
    return bool(difference <= _SAME_MOTION * size)


def _options(
    contact: PerContact, law: ContactLaw, touching: bool, at_rest: bool
) -> tuple[str, ...]:
    if not touching:
        return (OFF if contact.gap == math.inf else "free",)
    direction = "slide+" if contact.slip > 0 else "slide-"
    return tuple(
        state
        for state in law.states
        if state != OFF and (state in ("free", "slide") or at_rest or state == direction)
    )


def _openness(candidate: Candidate) -> tuple[int, int, str]:
    """Most contacts closed first, then most of them pinned; names make ties deterministic."""
    states = candidate.states
    return (
        sum(state == "free" for state in states),
        sum(state != "pin" for state in states),
        " ".join(states),
    )


def _label(laws: Sequence[ContactLaw], candidate: Candidate | Undetermined) -> str:
    states = candidate.states if isinstance(candidate, Candidate) else candidate[0]
    return " ".join(f"{law.name}:{state}" for law, state in zip(laws, states, strict=True))


def _verdict(candidate: Candidate | Undetermined, tie: float) -> str:
    if not isinstance(candidate, Candidate):
        return candidate[1]
    if candidate.violation <= 0.0:
        return "consistent"
    if candidate.violation <= tie:
        return f"consistent within the tie band: {candidate.reason}"
    return candidate.reason
