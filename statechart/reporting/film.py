"""Animation of a run: poses of its bodies at equidistant instants."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.documents.declaration import TIME
from statechart.documents.quantities import unit_suffix
from statechart.errors import StatechartError
from statechart.loading.kind import kind
from statechart.observation.observer import Observer
from statechart.pictures import animation
from statechart.pictures.film import Film
from statechart.pictures.stage import FilmInstants, Stage
from statechart.reporting.curves import REST, without_round_off

_STILL = 2e-3  # motion below this fraction of the picture is rest
_INSTANTS = 400


def stage_of(automaton: Automaton) -> Stage:
    """Return the stage of a model: the shapes of its bodies and surfaces."""
    name = automaton.declaration.kind
    stage = kind(name).stage
    if stage is None:
        message = f"a {name} has no bodies to draw; its figure and its diagram show the run"
        raise StatechartError(message)
    return stage(automaton)


def film_at(stage: Stage, observer: Observer, trace: Trace, times: ArrayLike) -> Film:
    """Return the film of a run at instants, after the jumps at them."""
    automaton = observer.automaton
    names = (*automaton.names, *stage.observables)
    samples = observer.sample(trace, names, times=times)
    seen = without_round_off(automaton, trace, samples).columns
    modes = tuple(samples.modes[place] for place in samples.mode)
    states = np.column_stack([samples.columns[name] for name in automaton.names])
    observed = {name: seen[name] for name in stage.observables}
    instants = FilmInstants(samples.t, samples.j, modes, states, observed, trace.parameters)
    film = stage.film(instants)
    return replace(film, unit_of_time=unit_suffix(automaton.declaration.unit(TIME)))


def until_rest(stage: Stage, observer: Observer, trace: Trace) -> float:
    """Return the time of the last visible motion plus a margin, at most the end of the run."""
    times = np.linspace(0.0, trace.t_end, _INSTANTS)
    film = film_at(stage, observer, trace, times)
    off = np.abs(film.poses - film.poses[-1]).max(axis=1) / (film.unit, film.unit, 1.0)
    moving = np.flatnonzero(off.max(axis=1) > _STILL)
    if not len(moving):
        return trace.t_end
    last = float(times[min(moving[-1] + 1, len(times) - 1)])
    return min(trace.t_end, (1.0 + REST) * last)


def animate(
    observer: Observer,
    trace: Trace,
    path: Path,
    *,
    speed: float | None,
    size: int,
    trail: float | None,
    progress: bool,
) -> None:
    """Write an animation of a run until the last visible motion; see `Result.animate`."""
    animation.check(path, size, speed, trail)
    stage = stage_of(observer.automaton)
    speed, times = animation.pace(until_rest(stage, observer, trace), speed)
    film = film_at(stage, observer, trace, times)
    animation.write_animation(film, path, speed=speed, size=size, trail=trail, progress=progress)


def strip_of(observer: Observer, trace: Trace) -> Film | None:
    """Return the film strip above the curves of a run, or None without bodies."""
    if kind(observer.automaton.declaration.kind).stage is None:
        return None
    stage = stage_of(observer.automaton)
    end = until_rest(stage, observer, trace)
    return film_at(stage, observer, trace, np.linspace(0.0, end, _INSTANTS))
