"""A run as a film: instants chosen, and what its kind of document shows of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.errors import StatechartError
from statechart.loading.kind import kind
from statechart.observation.observer import Observer
from statechart.pictures import animation
from statechart.pictures.film import Film
from statechart.pictures.stage import Moments, Stage
from statechart.reporting.curves import without_rounding

# What moves less than this part of the picture does not move.
_STILL = 2e-3
# How much of a run is shown after that, of what comes before.
_REST = 0.08
_LOOKED_AT = 400


def stage_of(automaton: Automaton) -> Stage:
    """Return what runs of a model are seen on.

    Raises
    ------
    StatechartError
        If nothing of its kind is to be seen.
    """
    name = automaton.declaration.kind
    made = kind(name).stage
    if made is None:
        raise StatechartError(
            f"a {name} has no bodies to look at; its figure and its diagram show what it does"
        )
    return made(automaton)


def filmed(stage: Stage, observer: Observer, trace: Trace, times: ArrayLike) -> Film:
    """Return a run at instants, after the jumps at them."""
    automaton = observer.automaton
    names = (*automaton.names, *stage.wanted)
    samples = observer.sample(trace, names, times=times)
    seen = without_rounding(automaton, trace, samples).columns
    return stage.film(
        Moments(
            samples.t,
            samples.j,
            tuple(samples.modes[place] for place in samples.mode),
            np.column_stack([samples.columns[name] for name in automaton.names]),
            {name: seen[name] for name in stage.wanted},
            trace.parameters,
        )
    )


def until_rest(stage: Stage, observer: Observer, trace: Trace) -> float:
    """Return when nothing that can be seen moves any more, and a little later; at most the end."""
    times = np.linspace(0.0, trace.t_end, _LOOKED_AT)
    film = filmed(stage, observer, trace, times)
    moved = np.abs(film.poses[:, :, :2] - film.poses[-1:, :, :2]).max(axis=(1, 2)) / film.unit
    turned = np.abs(film.poses[:, :, 2] - film.poses[-1:, :, 2]).max(axis=1)
    moving = np.flatnonzero(np.maximum(moved, turned) > _STILL)
    if not len(moving):
        return trace.t_end
    last = float(times[min(moving[-1] + 1, len(times) - 1)])
    return min(trace.t_end, (1.0 + _REST) * last)


@dataclass(frozen=True)
class Showing:
    """How an animation is shown.

    Attributes
    ----------
    speed : float or None
        Units of the run's time that pass in a second; None for what makes it neither short nor
        long.
    size : int
        Pixels of the longer side.
    trail : float or None
        How far back in time trails of bodies reach: None for all the way, 0 for none.
    """

    speed: float | None = None
    size: int = 720
    trail: float | None = None


def animate(
    observer: Observer,
    trace: Trace,
    path: Path | str,
    showing: Showing,
    *,
    progress: bool = False,
) -> Path:
    """Write a run as an animation, from its start until nothing moves any more.

    Parameters
    ----------
    observer : Observer
        Of the simulator that made the run.
    trace : Trace
        The run.
    path : Path or str
        What to write: .gif, or .mp4 where the program ffmpeg is.
    showing : Showing
        How it is shown.
    progress : bool
        Whether pictures are counted on stderr.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    StatechartError
        If there is nothing to see, the suffix, the speed, the size or the trail is none, or the
        file cannot be written.
    """
    path = Path(path)
    animation.check(path, showing.size, showing.speed, showing.trail)
    stage = stage_of(observer.automaton)
    speed, times = animation.pace(until_rest(stage, observer, trace), showing.speed)
    film = filmed(stage, observer, trace, times)
    animation.write(
        film, path, speed=speed, size=showing.size, trail=showing.trail, progress=progress
    )
    return path


def strip_of(observer: Observer, trace: Trace) -> Film | None:
    """Return a run to be seen above its curves; None where nothing is to be seen."""
    if kind(observer.automaton.declaration.kind).stage is None:
        return None
    stage = stage_of(observer.automaton)
    end = until_rest(stage, observer, trace)
    return filmed(stage, observer, trace, np.linspace(0.0, end, _LOOKED_AT))
