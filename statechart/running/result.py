"""Result of a run: trace, outputs, tables, pictures, page."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.automaton.trace import Trace
from statechart.documents.files import check_folder_name
from statechart.documents.hints import check_arguments
from statechart.documents.setting import Record, describe_value
from statechart.engines.request import Measured
from statechart.errors import StatechartError, close_matches
from statechart.observation.grazes import graze_warnings, grazes
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs, undefined_warnings
from statechart.reporting.partial_report import PartialReport
from statechart.running.accuracy import AccuracyRequest

if TYPE_CHECKING:  # slow imports
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from statechart.diagram.model import Diagram


class _Named(dict[str, Any]):
    """Values by name; a wrong name raises a `KeyError` that lists the names."""

    def __missing__(self, name: str) -> None:
        raise KeyError(f"no value is called {name!r}; {close_matches(name, self)}")


@dataclass(frozen=True)
class Reading:
    """State of a run at an instant.

    Attributes
    ----------
    t : float
        The instant.
    jumps : int
        Number of jumps before it.
    mode : mapping of str to str
        Region -> its state.
    values : mapping of str to float
        Variables and observables (gaps, forces, energy); NaN if undefined.
    """

    t: float
    jumps: int
    mode: Mapping[str, str]
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The result of a run.

    Attributes
    ----------
    trace : Trace
        Arcs and jumps, the outcome, warnings, costs.
    observer : Observer
        Evaluates formulas along the trace.
    error_estimate : float or None
        With a requested accuracy: the largest relative difference of final state, times of events
        and outputs from a run at 20 times the tolerance, or extrapolated from runs at up to four
        times the step; inf if runs are not comparable. For a run that a study measured, its error
        against the reference plus the resolution. Else None.
    timings : mapping of str to float
        Seconds of reading, composing and running.
    asked : AccuracyRequest or None
        The requested accuracy or budget, and its cost.
    study : Study or None
        The study that chose engine and tolerance.
    source : callable
        Recreates the observer; in another process it composes the model.
    """

    trace: Trace
    observer: Observer
    error_estimate: float | None
    timings: Mapping[str, float]
    source: Callable[[], Outputs]
    asked: AccuracyRequest | None = None
    study: Measured | None = None

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the trace and its source; the other process recreates the observer."""
        parts = (self.trace, self.error_estimate, self.timings, self.asked, self.study)
        return _restored, (self.source, *parts)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the run, of guards with undecided grazes, and of outputs that are NaN."""
        return self.trace.warnings + self._left_open + undefined_warnings(self.outputs)

    @cached_property
    def _left_open(self) -> tuple[str, ...]:
        return graze_warnings(grazes(self.observer, self.trace))

    @cached_property
    def outputs(self) -> Mapping[str, Any]:
        """The declared outputs.

        Numbers, lists for `each` or several events, and None if an event never happened.
        """
        return _Named(self.source().of(self.trace))

    @property
    def endless(self) -> frozenset[str]:
        """The outputs that count or list events of a Zeno sequence."""
        return frozenset(self.source().truncated(self.trace))

    @cached_property
    def conditions(self) -> tuple[float | None, ...]:
        """Condition number of the time of every event; None if unknown."""
        from statechart.observation.condition import conditions

        return conditions(self.observer, self.trace)

    def __str__(self) -> str:
        """Return the text that the command line prints: outcome, events, outputs, margins."""
        from statechart.reporting.text import summary

        return summary(self.to_dict())

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """Return the page of the run in a frame for notebooks."""
        from statechart.pages.page import frame, html

        try:
            return frame(html(_page_content(self, None)))
        except StatechartError as error:  # the run did not record enough
            return f"<pre>{escape(str(self))}</pre><p>{escape(str(error))}</p>"

    @property
    def events(self) -> pd.DataFrame:
        """The jumps, one per row: t, j, region, cause, source, target, skipped time.

        Further columns are impulses, energies, and variables before and after; units are in
        ``attrs["units"]``.
        """
        from statechart.reporting.tables import events_table

        return events_table(self.observer, self.trace)

    @property
    def samples(self) -> pd.DataFrame:
        """Variables and observables along the run in columns, with t, j and mode.

        A jump gives two rows of one time; units are in ``attrs["units"]``.
        """
        from statechart.reporting.tables import samples_table

        return samples_table(self.observer, self.trace)

    def to_xarray(self) -> xr.Dataset:
        """Return the run as a data set over time.

        Returns
        -------
        Dataset
            Variables and observables over `t`, with units and long names. Times are unique: values
            at a jump are those after it, values before it are along `event`. So
            ``.sel(t=0.3, method="nearest")`` returns the nearest sample.
        """
        from statechart.reporting.tables import by_time, to_xarray

        return by_time(to_xarray(self.observer, self.trace))

    @check_arguments
    def at(self, t: float) -> Reading:
        """Return the state at an instant; at the instant of a jump, after it.

        Parameters
        ----------
        t : float
            From 0 to the end of the run.

        Raises
        ------
        StatechartError
            If the instant is outside the run.

        Examples
        --------
        >>> from statechart import run
        >>> reading = run("bouncing_ball").at(0.2)
        >>> reading.mode, round(reading.values["height"], 3)
        ({'floor': 'free'}, 0.804)
        """
        if not 0.0 <= t <= self.trace.t_end:
            span = f"which is from 0 to {self.trace.t_end:.7g}"
            raise StatechartError(f"t must be in the run, {span}, not {describe_value(t)}")
        found = self.observer.sample(self.trace, times=[t])
        states = dict(zip(self.trace.regions, found.modes[found.mode[0]], strict=True))
        values = {name: float(column[0]) for name, column in found.columns.items()}
        return Reading(t, int(found.j[0]), states, _Named(values))

    @check_arguments
    def plot(self, path: Path | str | None = None) -> Figure:
        """Return the figure of the run: film strip of the bodies, curves, modes.

        Parameters
        ----------
        path : Path or str, optional
            File to write, svg, png or pdf by its suffix.
        """
        from statechart.reporting.figure import figure
        from statechart.reporting.film import strip_of

        trace = self.trace.at_hand()
        return figure(self.observer, trace, path, strip=strip_of(self.observer, trace))

    @check_arguments
    def diagram(self, path: Path | str | None = None) -> Diagram:
        """Return the diagram of the visited modes and the path through them.

        Parameters
        ----------
        path : Path or str, optional
            File to write; see `statechart.draw` for the suffixes.

        Raises
        ------
        StatechartError
            If the run did not record modes.
        """
        if self.trace.record is not Record.MODES:
            advice = "run it with record: modes, or --record modes"
            raise StatechartError(f"the run recorded no modes to draw: {advice}")
        from statechart.automaton.product import feasibility
        from statechart.diagram.build import build
        from statechart.diagram.write import write

        automaton = self.observer.automaton
        setup = automaton.setup(self.overrides, self.trace.tolerance)
        found = feasibility(automaton, setup, setup.initial, 0.0)
        diagram = build(automaton, self.trace.start_mode, self.trace, found, visited=True)
        if path is not None:
            write(diagram, Path(path))
        return diagram

    @check_arguments
    def animate(
        self,
        path: Path | str,
        *,
        speed: float | None = None,
        size: int = 720,
        trail: float | None = None,
        progress: bool = False,
    ) -> Path:
        """Write an animation of the bodies.

        Parameters
        ----------
        path : Path or str
            File to write: .gif, or .mp4 with the program ffmpeg.
        speed : float, optional
            Simulated time per second.
        size : int
            Longer side in pixels.
        trail : float, optional
            Length of trails in simulated time; 0 for none.
        progress : bool
            Whether to report progress to stderr.
        """
        from statechart.reporting.film import animate

        path, run = Path(path), (self.observer, self.trace)
        animate(*run, path, speed=speed, size=size, trail=trail, progress=progress)
        return path

    @check_arguments
    def report(self, path: Path | str, *, study: Measured | None = None) -> Path:
        """Write the run as one self-contained HTML file.

        It has the moving scene with forces, curves, the statechart with the active mode, events
        with reasons, outputs and parameters; see docs/pictures.md.

        Parameters
        ----------
        path : Path or str
            File to write, .html.
        study : Study, optional
            Study of the same model to show, from `trade`; by default that of the run.

        Raises
        ------
        StatechartError
            If the suffix is wrong, the study is of another model, or the file cannot be written.
        """
        from statechart.pages.page import write_page

        path = Path(path)
        write_page(_page_content(self, study), path)
        return path

    @property
    def overrides(self) -> dict[str, float]:
        """The values of the model's parameters in this run."""
        values, declared = self.trace.parameters, self.observer.automaton.declaration.parameters
        return {name: values[name] for name in declared if name in values}

    @property
    def runner(self) -> Any:
        """The runner that made the run.

        .. deprecated:: 0.2
            Use the original runner, or create one from `observer.automaton.declaration`.
        """
        warnings.warn(
            "Result.runner goes with version 0.3: keep the runner, or make one of the model, "
            "observer.automaton.declaration",
            DeprecationWarning,
            stacklevel=2,
        )
        return self.source.runner  # type: ignore[attr-defined]

    def to_dict(
        self, *, explain: bool = False, most: int | None = None, pieces: PartialReport | None = None
    ) -> dict[str, Any]:
        """Return the run as the JSON object of ``statechart run --json``."""
        from statechart.reporting.report import Computation, report

        computation = Computation(self.error_estimate, self.timings)
        if self.asked is not None:
            request = self.asked.to_dict(self.error_estimate)
            computation = computation._replace(request=request, conditions=self.conditions)
        options: Any = {"explain": explain, "most": most, "pieces": pieces}
        return report(self.observer, self.trace, computation, **options)

    @check_arguments
    def save(self, folder: Path | str, *, samples: bool | None = None) -> tuple[str, ...]:
        """Write tables, data set and figure; return the names of the files.

        Parameters
        ----------
        folder : Path or str
            Folder to write to.
        samples : bool, optional
            Whether to write samples.csv, which repeats trace.nc. By default if modes were recorded;
            this default ends with version 0.3.
        """
        from statechart.reporting.tables import write_run

        check_folder_name(folder)
        if samples is None and self.trace.record is Record.MODES:
            warnings.warn(
                "from version 0.3 on, save writes samples.csv only with samples=True; pass "
                "samples=True or samples=False (trace.nc has the same data)",
                DeprecationWarning,
                stacklevel=2,
            )
            samples = True
        held = replace(self, trace=self.trace.at_hand())
        made = partial(held.to_dict, explain=True)
        return write_run(folder, self.observer, held.trace, made, samples=bool(samples))


def _restored(source: Callable[[], Outputs], trace: Trace, *parts: Any) -> Result:
    estimate, timings, request, study = parts
    return Result(trace, source().observer, estimate, timings, source, request, study)


def _page_content(result: Result, study: Measured | None) -> dict[str, Any]:
    """Return the content of the page of a run."""
    from statechart.pages.page import MOST_EVENTS, content

    trace, model = result.trace, result.observer.automaton.declaration
    if study is None:
        known = result.study
        study = known if known is not None and known.of(model) else None
    elif not study.of(model):
        raise StatechartError(
            f"the study is of another model or version, or of {model.name!r} before a change; "
            "repeat it with trade"
        )
    trace.require_motion()
    held = replace(result, trace=trace.at_hand())
    report = held.to_dict(explain=True, most=MOST_EVENTS)
    diagram = held.diagram() if trace.record is Record.MODES else None
    page = content(result.observer, held.trace, report, diagram)
    return {**page, "study": None if study is None else _study_content(result, study)}


def _study_content(result: Result, study: Measured) -> Mapping[str, Any]:
    """Return the data of a study for a page, with a remark if the run had other parameters."""
    trace, setup = result.trace, result.observer.automaton.setup
    fineness = f"{trace.tolerance:.2g}" if trace.step is None else f"step {trace.step:.3g}"
    shown = study.shown(f"{trace.engine} {fineness}")
    own, declared = (setup(values, trace.tolerance) for values in (result.overrides, {}))
    if np.array_equal(own.values, declared.values):
        return shown
    other = "measured with the declared parameters; this run had others"
    return {**shown, "above": [*shown["above"], other], "own": []}
