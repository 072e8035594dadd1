"""A model's statechart as a picture or as text."""

from __future__ import annotations

from pathlib import Path

from statechart.automaton.product import feasibility
from statechart.automaton.trace import Trace
from statechart.diagram.build import build, needs_run
from statechart.diagram.model import Diagram
from statechart.diagram.write import write
from statechart.documents.declaration import Declaration
from statechart.running.runner import Runner


def draw(model: Declaration | str | Path, path: str | Path, *, visited: bool = False) -> Path:
    """Draw the statechart of a model.

    One region is drawn as its own chart, several as their product up to a bound; above it, what a
    run visits and the chart of every region.

    Parameters
    ----------
    model : Declaration, str or Path
        A model, the path of its file, or the name of a shipped one.
    path : str or Path
        What to write; its suffix says how: .svg, .png, .pdf, .dot, .mmd or .scxml.
    visited : bool
        Whether the path of a run is shown.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    StatechartError
        If the model is wrong or cannot be run where a run is shown, or Graphviz is missing where a
        picture is asked for.
    """
    path = Path(path)
    write(drawn(Runner(model), visited=visited)[0], path)
    return path


def drawn(runner: Runner, *, visited: bool = False) -> tuple[Diagram, Trace | None]:
    """Return the diagram of a model, and the run that it shows where one is asked for or needed."""
    start, _ = runner.start()
    trace = None
    if visited or needs_run(runner.automaton):
        trace = runner.run(throw=False).trace
    setup = runner.setup()
    found = feasibility(runner.automaton, setup, setup.initial, 0.0)
    return build(runner.automaton, start, trace, found), trace
