"""Colours of states, lines and ink: one palette for diagrams and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours of curves and arrows by Okabe and Ito (2008), which colour-blind people distinguish."""

INK, FRAME, FAINT, GRID = "#333333", "#5B6670", "#8A939C", "#E6E6E6"
"""Colours of text and arrows, of boxes and remarks, of the impossible, of grids."""

RUN = LINES[0]
"""Colour of the states and transitions that a run took."""

PAPER, CLOSED = "#FFFFFF", "#F6F8FA"
"""Colours of the background, and of boxes that hold others."""

# A state has the same colour in all pictures, independent of the other states of its region.
_NAMED = {
    "free": "#A6D8F5",
    "slide+": "#F3C14B",
    "slide-": "#E88A4A",
    "slide": "#F3C14B",
    "pin": "#6CC4A4",
    "off": "#E6E6E6",
}
# States of other names; none of these looks like a named one.
_OTHERS = ("#CDBBE8", "#F2B8C6", "#D3C1A0", "#B7C4D6", "#D5E08F", "#D99A9A", "#B9A3B5", "#BDBDBD")


def state_colours(states: Sequence[str]) -> Mapping[str, str]:
    """Return the colour of every state of a region, by its name or in order."""
    others = [state for state in dict.fromkeys(states) if state not in _NAMED]
    return {s: _NAMED.get(s) or _OTHERS[others.index(s) % len(_OTHERS)] for s in states}


def region_colours(regions: Sequence[Sequence[str]]) -> list[Mapping[str, str]]:
    """Return the colours of the states of several regions: those of no contact are apart."""
    before: list[str] = []
    found: list[Mapping[str, str]] = []
    for states in regions:
        others = [state for state in dict.fromkeys(states) if state not in _NAMED]
        colours = state_colours([*(f"{len(found)}.{n}" for n in before), *others])
        found.append({state: _NAMED.get(state) or colours[state] for state in states})
        before += others
    return found
