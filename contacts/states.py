"""States of a contact: their names in documents, and their codes in kernels."""

from __future__ import annotations

from collections.abc import Iterable

FREE, PIN, SLIDE, SLIDE_PLUS, SLIDE_MINUS, OFF_CODE, LOCKED, SLIP_PLUS, SLIP_MINUS, OPEN_CODE = (
    range(10)
)

OFF = "off"
"""The state of a contact whose conditions fail; no mode that a contact lists."""

DISENGAGED = "open"
"""The state of a coupling whose conditions fail."""

INACTIVE = (OFF, DISENGAGED)
"""States of contacts and couplings whose conditions fail."""

STATES = {
    FREE: "free",
    PIN: "pin",
    SLIDE: "slide",
    SLIDE_PLUS: "slide+",
    SLIDE_MINUS: "slide-",
    OFF_CODE: "off",
    LOCKED: "locked",
    SLIP_PLUS: "slip+",
    SLIP_MINUS: "slip-",
    OPEN_CODE: DISENGAGED,
}
"""Number of a mode of a region to its state."""

CODES = {state: code for code, state in STATES.items()} | dict.fromkeys(INACTIVE, FREE)
"""State of a region to the number of its mode; without force if its conditions fail."""

OPEN = ("free", *INACTIVE)
"""States without force."""

STICKING = ("pin", "locked")
"""States of a contact, and of a coupling, that hold their slip at zero."""

SLIDING = ("slide", "slide+", "slide-")
"""Slip without friction, along the tangent, and against it."""

SLIPPING = ("slip+", "slip-")
"""States of a coupling that slips: its first body turns ahead of the other, or behind it."""

RESTS = {PIN: (SLIDE_PLUS, SLIDE_MINUS), LOCKED: (SLIP_PLUS, SLIP_MINUS)}
"""Codes of states at rest, and of the slips that end in them."""

SLIPS = (*RESTS[PIN], *RESTS[LOCKED])
"""Codes of slips with a direction."""

CLOSED = "closed"
"""The superstate of those that touch the surface."""

COUPLING_STATES = ("locked", *SLIPPING)
"""States of a coupling that is not open."""

SUPERSTATES = {
    "slide+": "slide",
    "slide-": "slide",
    "slide": CLOSED,
    "pin": CLOSED,
} | dict.fromkeys(SLIPPING, "slipping")
"""State -> superstate: ``free | closed { pin | slide { slide+ | slide- } }`` of a contact,
``open | locked | slipping { slip+ | slip- }`` of a coupling."""


def superstates_of(states: Iterable[str]) -> dict[str, str]:
    """Return state or superstate -> superstate, as far as a region of `states` has them."""
    found: dict[str, str] = {}
    for state in states:
        while state in SUPERSTATES:
            found[state] = SUPERSTATES[state]
            state = SUPERSTATES[state]
    return found


def declared_state(state: str) -> str:
    """Return a state as a contact lists it: `slide` or `slipping`, without direction."""
    return "slide" if state in SLIDING else "slipping" if state in SLIPPING else state


def cause_of(before: str, after: str) -> str:
    """Return the name of a change of a contact's state without an impact."""
    if DISENGAGED in (before, after):
        return "close" if before == DISENGAGED else "open"
    if after == "locked":
        return "lock"
    if OFF in (before, after):
        return "enable" if before == OFF else "disable"
    if before == "free":
        return "touchdown"
    if after in ("free", "pin"):
        return "liftoff" if after == "free" else "stick"
    return "slip" if before in STICKING else "reverse"


def undetermined_warning(names: Iterable[str]) -> str:
    """Return the warning of contacts whose forces the motion leaves open."""
    return f"the forces of {', '.join(names)} are indeterminate: the smallest are shown"


def open_motion_warning(names: Iterable[str], time: float) -> str:
    """Return the warning of contacts whose load sharing decides on the motion."""
    return (
        f"from t = {time:.6g} how {', '.join(names)} share the load changes the motion, and "
        "nothing determines it: another engine or step may differ"
    )


def implied_joints(names: Iterable[str]) -> str:
    """Return the message on redundant joints, from the names of their rows."""
    return (
        f"coordinates or other joints imply {' and '.join(map(repr, dict.fromkeys(names)))}: the "
        "motion is determined, the shares of the forces are not"
    )


def implied_couplings(names: Iterable[str]) -> str:
    """Return the message on couplings that hold what others hold."""
    return (
        f"other couplings hold the same rotation as {' and '.join(map(repr, names))}: while all "
        "are locked, their shares of the couple are not determined"
    )
