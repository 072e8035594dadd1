"""The modes of a run as rows of coloured stretches of time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.palette import INK
from statechart.reporting.curves import remarks
from statechart.reporting.legends import legend, remark_lines, room
from statechart.reporting.thinning import COLUMNS

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

# Of a region, by the states that it is in.
Stretches = dict[str, list[tuple[float, float]]]

# Rows, and stretches of a state in a row that are named.
_MOST_BANDS, _MOST_NAMED = 12, 24


def banded(automaton: Automaton, trace: Trace) -> list[int]:
    """Return the regions whose modes are shown: all, or of many the first ones that change.

    Before those that are one of many come those that have states of their own, such as controllers.
    """
    places = list(range(len(trace.regions)))
    if len(places) > _MOST_BANDS:
        changing = [k for k in places if len(_stretches(trace, k)) > 1 or _instants(trace, k)]
        states = {region.name: region.states for region in automaton.regions}
        alike = Counter(states[name] for name in trace.regions)
        own = sorted(changing or places, key=lambda k: alike[states[trace.regions[k]]] > 1)
        places = sorted(own[:_MOST_BANDS])
    return places


def draw_bands(ax: Axes, automaton: Automaton, trace: Trace, end: float) -> None:
    """Draw one row per region, the first on top, its states as coloured stretches of time."""
    from matplotlib.patches import Patch

    places = banded(automaton, trace)
    unnamed: dict[str, Artist] = {}
    for y, row in zip(reversed(range(len(places))), places, strict=True):
        colours = automaton.colours[trace.regions[row]]
        for state, stretches in _visible(_stretches(trace, row), end).items():
            ax.broken_barh(
                [(start, last - start) for start, last in stretches],
                (y + 0.1, 0.8),
                facecolors=colours[state],
                edgecolor="white",
                linewidth=0.4 if len(stretches) < _MOST_NAMED else 0.0,
            )
            seen = [(start, min(last, end)) for start, last in stretches if start < end]
            wide = [pair for pair in seen if (pair[1] - pair[0]) / end > room(state)]
            for start, last in wide[:_MOST_NAMED]:
                ax.text((start + last) / 2, y + 0.5, state, ha="center", va="center", fontsize=8)
            if not wide:
                unnamed[state] = Patch(facecolor=colours[state], label=state)
        for state, times in _instants(trace, row).items():
            label = f"{state} for no time"
            (unnamed[label],) = ax.plot(
                times, [y + 0.5] * len(times), "D", markersize=4.5, clip_on=False, label=label,
                color=colours[state], markeredgecolor=INK, markeredgewidth=0.7,
            )  # fmt: skip
    rows = len(places)
    ax.set_ylim(0, rows or 1)
    ax.set_yticks([rows - 0.5 - k for k in range(rows)], [trace.regions[k] for k in places])
    ax.tick_params(axis="y", length=0)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    ax.set_xlim(0.0, end)
    left = remark_lines(unbanded(trace, places))
    if unnamed or left:
        legend(ax, [*unnamed.values(), *left], 2 if len(unnamed) > max(2 * rows, 3) else 1)


def unbanded(trace: Trace, places: Sequence[int]) -> tuple[str, ...]:
    """Return what is said of regions that have no row: those that stay in a state apart."""
    said: dict[str, list[str]] = {}
    for k, name in enumerate(trace.regions):
        if k not in places:
            states = list(_stretches(trace, k))
            still = len(states) == 1 and not _instants(trace, k)
            said.setdefault(f"always {states[0]}" if still else "not drawn", []).append(name)
    return remarks(said)


def _stretches(trace: Trace, row: int) -> Stretches:
    """Return state -> times that the region spends in it, adjoining ones joined."""
    result: Stretches = {}
    last = ""
    for arc in trace.arcs:
        state, start, end = arc.mode[row], arc.start.high, arc.end.high
        stretches = result.setdefault(state, [])
        if state == last:
            stretches[-1] = (stretches[-1][0], end)
        else:
            stretches.append((start, end))
        last = state
    return result


def _visible(stretches: Stretches, end: float) -> Stretches:
    """Return what is drawn of stretches: of very many the state at one time of every column."""
    if sum(map(len, stretches.values())) <= COLUMNS:
        return stretches
    every = sorted((start, state) for state, those in stretches.items() for start, _ in those)
    edges = np.linspace(0.0, end, COLUMNS + 1)
    # Multiples of the golden ratio keep no step with what goes on in a regular way.
    times = edges[:-1] + np.arange(COLUMNS) * ((5**0.5 - 1) / 2) % 1 * (end / COLUMNS)
    places = np.searchsorted([start for start, _ in every], times, side="right") - 1
    states = np.array([every[place][1] for place in places])
    begins = np.flatnonzero(states != np.roll(states, 1))
    begins = np.union1d(begins, [0])
    seen: Stretches = {state: [] for state in stretches}
    for first, after in zip(begins, [*begins[1:], COLUMNS], strict=True):
        seen[str(states[first])].append((float(edges[first]), float(edges[after])))
    return seen


def _instants(trace: Trace, row: int) -> dict[str, list[float]]:
    """Return state -> times at which the region passed through it in no time."""
    flowed = {arc.j for arc in trace.arcs}
    result: dict[str, list[float]] = {}
    for jump, following in zip(trace.jumps, trace.jumps[1:], strict=False):
        state = jump.target[row]
        if jump.j + 1 not in flowed and state not in (jump.source[row], following.target[row]):
            result.setdefault(state, []).append(jump.t)
    return result
