"""Drawings of a model: statechart, scene, and product automaton as a graph."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from statechart.automaton.product import explore, feasibility
from statechart.automaton.trace import Key, Trace
from statechart.diagram.build import build, needs_run
from statechart.diagram.legend import GUARDS, Guards
from statechart.diagram.model import Diagram, Machine
from statechart.diagram.write import write
from statechart.documents.declaration import TIME, Declaration
from statechart.documents.hints import check_arguments
from statechart.documents.setting import Record
from statechart.errors import DeclarationError, StatechartError
from statechart.loading.kind import kind
from statechart.running.runner import Runner

if TYPE_CHECKING:
    import networkx as nx
    from matplotlib.figure import Figure

# Fraction of the time in which a scene moves by its own length.
_MOMENT = 1e-6


@check_arguments
def draw(
    model: Declaration | str | Path,
    path: str | Path | None = None,
    *,
    visited: bool = False,
    guards: Guards = "legend",
) -> Diagram:
    """Draw the statechart of a model.

    One region is drawn as its chart, two as the grid of their product. For more regions or many
    states the modes that a run visits are drawn, and the chart of every region.

    Parameters
    ----------
    model : Declaration, str or Path
        A model, the path of its file, or the name of a shipped one.
    path : str or Path, optional
        The file to write: .svg, .png, .pdf, .dot, .mmd, .scxml or .graphml.
    visited : bool
        Draw only the modes and the path of a run.
    guards : str
        Place of guards, resets and conditions: once in a ``legend``, or ``inline`` at every arrow.

    Returns
    -------
    Diagram
        Notebooks show it.

    Raises
    ------
    StatechartError
        If the model is wrong, its run fails, the suffix or `guards` is unknown, or Graphviz is
        missing for a picture.

    Examples
    --------
    >>> draw("toppling_stick")
    <diagram of toppling_stick: 6 states, 12 transitions>
    """
    if guards not in GUARDS:
        raise StatechartError(f"guards is one of {', '.join(GUARDS)}, not {guards!r}")
    diagram, _ = drawn(Runner(model), visited=visited)
    if path is not None:
        write(diagram, Path(path), guards)
    return diagram


def draw_scene(model: Declaration | Runner | str | Path, path: str | Path) -> Path:
    """Draw the initial scene: bodies, surfaces, contacts coloured by mode, and names."""
    from statechart.reporting.figure import write_figure

    write_figure(_scene(model if isinstance(model, Runner) else Runner(model)), path)
    return Path(path)


def notebook(model: Declaration) -> str:
    """Return the scene (if any) and the statechart of a model as HTML."""
    from statechart.reporting.figure import render

    runner = Runner(model)
    pictures = [drawn(runner)[0].svg()]
    if kind(model.kind).stage is not None:
        pictures.insert(0, render(_scene(runner), "svg").decode())
    # At most as wide as the cell.
    style = '<svg style="max-width: 100%; max-height: 420px; height: auto"'
    drawings = (svg[svg.index("<svg") :].replace("<svg", style, 1) for svg in pictures)
    frame = "background: #fff; max-width: 760px; padding: 8px"
    return f'<div style="{frame}">{"<br>".join(drawings)}</div>'


def _scene(runner: Runner) -> Figure:
    from statechart.pictures.drawing import picture
    from statechart.reporting.film import film_at, stage_of

    stage = stage_of(runner.automaton)
    start = runner.run(until=0.0)
    # Shared forces, and modes of time stepping, are known after a short time.
    least = start.trace.tolerances
    moment = start.trace.step or _MOMENT * least["gap"] / least["speed"]
    start = runner.run(until=moment, throw=False)
    return picture(film_at(stage, start.observer, start.trace, [0.0]))


@check_arguments
def graph(
    model: Declaration | str | Path,
    *,
    trace: Trace | None = None,
    around: Key | None = None,
    within: int | None = None,
    directions: bool = True,
) -> nx.MultiDiGraph:
    """Return the product automaton of a model as a networkx graph, or a part of it.

    Parameters
    ----------
    model : Declaration, str or Path
        A model, the path of its file, or the name of a shipped one.
    trace : Trace, optional
        A run of it, whose visits are counted.
    around : tuple of str, optional
        A mode, as a state of every region; by default those of the trace, or the initial one.
    within : int, optional
        Largest distance of modes from there in edges: with 0 and a trace, the modes visited. By
        default all modes, up to 4096.
    directions : bool
        Whether directions of sliding are separate modes.

    Returns
    -------
    MultiDiGraph
        Nodes are modes with `label`, `feasible` and `reason` at the initial state if decidable, and
        with a trace `visits`, the number of entries. Edges have `region`, `event`, `guard`,
        `reset`, and `visits`.

    Raises
    ------
    StatechartError
        If the model is wrong, has too many modes, or the mode or the run is of another model.

    Examples
    --------
    >>> modes = graph("double_contact_bar", directions=False)
    >>> len(modes), modes.nodes["slide", "pin"]["reason"]
    (9, 'A cannot slip with A closed and B pin')
    """
    if trace is not None and not isinstance(trace, Trace):
        raise DeclarationError(
            f"trace is that of a run, not of type {type(trace).__name__}",
            advice="such as trace=run(model).trace",
        )
    runner = Runner(model)
    start = [around] if around is not None else []
    if trace is None and within is not None:
        start = start or [runner.start()[0]]
    values = {} if trace is None else trace.parameters
    setup = runner.setup({name: values[name] for name in runner.model.parameters if name in values})
    found = feasibility(runner.automaton, setup, setup.initial, 0.0)
    part = explore(
        runner.automaton, around=start, within=within, trace=trace, found=found,
        directions=directions,
    )  # fmt: skip
    return part.graph()


def drawn(
    runner: Runner, *, visited: bool = False, known: Trace | None = None
) -> tuple[Diagram, Trace | None]:
    """Return the diagram of a model, and the run that it shows if one is requested or needed.

    A `known` run with recorded modes is used, else one is computed.
    """
    start, _ = runner.start()
    trace = None
    if visited or needs_run(runner.automaton):
        kept = known is not None and known.record is Record.MODES
        trace = known if kept else runner.with_modes().run(throw=False).trace
    setup = runner.setup()
    found = feasibility(runner.automaton, setup, setup.initial, 0.0)
    diagram = build(runner.automaton, start, trace, found, visited=visited)
    automaton = runner.automaton
    values = dict(zip(automaton.parameter_names, setup.values.tolist(), strict=True))
    values |= dict(zip(automaton.names, setup.initial.tolist(), strict=True))
    machine = Machine(automaton.regions, start, {**values, TIME: 0.0})
    return replace(diagram, machine=machine), trace
