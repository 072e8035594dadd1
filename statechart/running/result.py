"""What a run gave: its trace, what can be evaluated along it, and what was asked for."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart.automaton.trace import Trace
from statechart.documents.hints import checked
from statechart.documents.setting import Record, Setting
from statechart.errors import StatechartError
from statechart.observation.observer import Observer
from statechart.reporting.pieces import Pieces
from statechart.running.answer import Asked

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from statechart.diagram.model import Diagram
    from statechart.engines.request import Measured
    from statechart.running.runner import Runner


@dataclass(frozen=True)
class Reading:
    """What held at an instant of a run.

    Attributes
    ----------
    t : float
        When.
    jumps : int
        How many jumps precede it.
    mode : mapping of str to str
        Region -> its state.
    values : mapping of str to float
        Variables, and what else can be observed: gaps, forces, energy; not a number where it has
        no value.
    """

    t: float
    jumps: int
    mode: Mapping[str, str]
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """What a run gave.

    Attributes
    ----------
    trace : Trace
        Arcs and jumps, the outcome, warnings, costs.
    observer : Observer
        Evaluates formulas along the trace.
    error_estimate : float or None
        Where an accuracy was asked for: the largest difference between this run and one at 20
        times its tolerance, or what the scheme's order makes of those at up to four times its
        step, of the final state, the times of events and the outputs, each relative to its own
        size; inf where there is none. Of a run that a study measured, its error against the study's
        reference, and what that may be off by. None where nothing was estimated.
    timings : mapping of str to float
        What took how many seconds.
    runner : Runner
        What made it.
    asked : Asked or None
        The accuracy or the budget that was asked for, and what it took.
    """

    trace: Trace
    observer: Observer
    error_estimate: float | None
    timings: Mapping[str, float]
    runner: Runner
    asked: Asked | None = None

    def __reduce__(self) -> tuple[object, ...]:
        """Travel as what was found and what made it: the observer is made anew there."""
        setting = self.runner.setting
        if self.asked is not None:  # the tolerance or the step was found
            found = {"step": self.trace.step, "accuracy": None}
            tolerance = {"tolerance": self.trace.tolerance}
            setting = replace(setting, **(found if setting.stepped else tolerance))
        return _remade, (
            self.runner, setting, self.trace, self.error_estimate, self.timings, self.asked
        )  # fmt: skip

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know: of the run, and of guards that it leaves open."""
        return self.trace.warnings + self._left_open

    @cached_property
    def _left_open(self) -> tuple[str, ...]:
        from statechart.observation.grazes import grazes, told

        return told(grazes(self.observer, self.trace))

    @cached_property
    def outputs(self) -> Mapping[str, Any]:
        """The outputs that the model declares.

        A number each; a list at `each` event or some of them; None where the event never happened.
        What it is follows from the declaration, and not from its type.
        """
        return self.runner.observers.outputs(self.observer).of(self.trace)

    @property
    def endless(self) -> frozenset[str]:
        """The outputs that count or list events of which a Zeno sequence has no end."""
        return self.runner.observers.outputs(self.observer).endless(self.trace)

    @cached_property
    def conditions(self) -> tuple[float | None, ...]:
        """How much an error is magnified into the time of every event; None if unknown."""
        from statechart.observation.condition import conditions

        return conditions(self.observer, self.trace)

    def __str__(self) -> str:
        """Return what the command line prints: how it ended, its events, outputs, margins."""
        from statechart.reporting.text import summary

        return summary(self.to_dict())

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """Return what a notebook shows: tables of outputs and events, and the figure if any."""
        from statechart.reporting.notebook import html

        try:
            drawn: Figure | str = self.plot()
        except StatechartError as error:  # what a run has not recorded is no reason to show nothing
            drawn = str(error)
        return html(self.to_dict(), drawn)

    @property
    def events(self) -> pd.DataFrame:
        """The jumps, a row each: when, of which region, why, from and to which state.

        Then what was skipped, impulses, energies, and variables before and after; units are in
        ``attrs["units"]``.
        """
        from statechart.reporting.tables import events_table

        return events_table(self.observer, self.trace)

    @property
    def samples(self) -> pd.DataFrame:
        """Variables and observables along the run, a column each, beside t, j and mode.

        A jump shows as two rows of one time; units are in ``attrs["units"]``.
        """
        from statechart.reporting.tables import samples_table

        return samples_table(self.observer, self.trace)

    def to_xarray(self) -> xr.Dataset:
        """Return the run as a data set over time.

        Returns
        -------
        Dataset
            Variables and observables over `t`, with their units and long names. Times are unique:
            at a jump the values are those after it, and what was before it stands along `event`.
            So ``.sel(t=0.3, method="nearest")`` finds the nearest sample.
        """
        from statechart.reporting.tables import by_time, to_xarray

        return by_time(to_xarray(self.observer, self.trace))

    @checked
    def at(self, t: float) -> Reading:
        """Return what held at an instant; at the instant of a jump, after it.

        Parameters
        ----------
        t : float
            From 0 to the end of the run.

        Raises
        ------
        StatechartError
            If the run has no such instant.

        Examples
        --------
        >>> from statechart import run
        >>> reading = run("bouncing_ball").at(0.2)
        >>> reading.mode, round(reading.values["height"], 3)
        ({'floor': 'free'}, 0.804)
        """
        if not 0.0 <= t <= self.trace.t_end:
            raise StatechartError(f"the run is from 0 to {self.trace.t_end!r}, without {t!r}")
        found = self.observer.sample(self.trace, times=[t])
        states = dict(zip(self.trace.regions, found.modes[found.mode[0]], strict=True))
        values = {name: float(column[0]) for name, column in found.columns.items()}
        return Reading(t, int(found.j[0]), states, values)

    @checked
    def plot(self, path: Path | str | None = None) -> Figure:
        """Return the run as one picture: the bodies at some instants, above curves and modes.

        Parameters
        ----------
        path : Path or str, optional
            Where to write it, too; svg, png or pdf by its suffix.
        """
        from statechart.reporting.figure import figure
        from statechart.reporting.film import strip_of

        trace = self.trace.at_hand()
        return figure(self.observer, trace, path, strip=strip_of(self.observer, trace))

    @checked
    def diagram(self, path: Path | str | None = None) -> Diagram:
        """Return the modes that the run visited, and its path through them.

        Parameters
        ----------
        path : Path or str, optional
            Where to write it, too; see `statechart.draw` for the suffixes.

        Raises
        ------
        StatechartError
            If the run has kept no modes.
        """
        if self.trace.record is not Record.MODES:
            raise StatechartError(
                "the run recorded no modes to draw: run it with record: modes, or --record modes"
            )
        from statechart.automaton.product import feasibility
        from statechart.diagram.build import build
        from statechart.diagram.write import write

        setup = self.runner.setup(self.overrides)
        found = feasibility(self.runner.automaton, setup, setup.initial, 0.0)
        diagram = build(
            self.runner.automaton, self.trace.start_mode, self.trace, found, visited=True
        )
        if path is not None:
            write(diagram, Path(path))
        return diagram

    @checked
    def animate(
        self,
        path: Path | str,
        *,
        speed: float | None = None,
        size: int = 720,
        trail: float | None = None,
        progress: bool = False,
    ) -> Path:
        """Write the bodies in motion, as a film.

        Parameters
        ----------
        path : Path or str
            What to write: .gif, or .mp4 where the program ffmpeg is.
        speed : float, optional
            Units of the run's time that pass in a second.
        size : int
            Pixels of the longer side.
        trail : float, optional
            How far back in time trails of bodies reach; 0 for none.
        progress : bool
            Whether pictures are counted on stderr.
        """
        from statechart.reporting.film import Showing, animate

        showing = Showing(speed, size, trail)
        return animate(self.observer, self.trace, path, showing, progress=progress)

    @checked
    def report(self, path: Path | str, *, study: Measured | None = None) -> Path:
        """Write the run as one HTML file that needs nothing else.

        The moving scene with the forces, curves, the statechart with its active mode, the events
        with their reasons, outputs and parameters; see docs/pictures.md.

        Parameters
        ----------
        path : Path or str
            What to write; .html.
        study : Study, optional
            What speed costs in accuracy, to be shown, too: of the same model, from `trade`. By
            default the one that the run was given.

        Raises
        ------
        StatechartError
            If the suffix is another, the study is of another model, or the file cannot be written.
        """
        from statechart.pages.page import write
        from statechart.running.paged import paged

        path = Path(path)
        write(paged(self, study), path)
        return path

    @property
    def overrides(self) -> dict[str, float]:
        """The values of the model's parameters in this run."""
        values = self.trace.parameters
        return {name: values[name] for name in self.runner.model.parameters if name in values}

    def to_dict(
        self, *, explain: bool = False, most: int | None = None, pieces: Pieces | None = None
    ) -> dict[str, Any]:
        """Return the run as one plain object, as ``statechart run --json`` prints it."""
        from statechart.reporting.report import report

        return report(
            self.observer,
            self.trace,
            error_estimate=self.error_estimate,
            timings=self.timings,
            explain=explain,
            most=most,
            asked=None if self.asked is None else self.asked.report(self.error_estimate),
            conditions=() if self.asked is None else self.conditions,
            pieces=pieces,
        )

    @checked
    def save(self, folder: Path | str, *, samples: bool | None = None) -> tuple[str, ...]:
        """Write tables, data set and figure; return the names of the files.

        Parameters
        ----------
        folder : Path or str
            Where to.
        samples : bool, optional
            Whether samples.csv is written, which says what trace.nc says. By default it is where
            modes were kept; that goes with version 0.3.
        """
        from statechart.reporting.tables import write_run

        if samples is None and self.trace.record is Record.MODES:
            warnings.warn(
                "save writes samples.csv from version 0.3 on only where it is asked for: say "
                "samples=True, or samples=False; trace.nc has the same",
                DeprecationWarning,
                stacklevel=2,
            )
            samples = True
        held = replace(self, trace=self.trace.at_hand())
        made = partial(held.to_dict, explain=True)
        return write_run(folder, self.observer, held.trace, made, samples=bool(samples))


def _remade(
    runner: Runner,
    setting: Setting,
    trace: Trace,
    estimate: float | None,
    timings: Mapping[str, float],
    asked: Asked | None,
) -> Result:
    return Result(trace, runner.observers.at(setting), estimate, timings, runner, asked)
