"""What the page of a run shows, from what the run gave, and from a study of its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from statechart.documents.setting import Record
from statechart.engines.request import Measured
from statechart.errors import StatechartError
from statechart.pages.content import MOST_EVENTS, content

if TYPE_CHECKING:
    from statechart.running.result import Result


def paged(result: Result, study: Measured | None) -> dict[str, Any]:
    """Return what the page of a run shows.

    Raises
    ------
    StatechartError
        If the study is of another model, or the run has kept nothing to show.
    """
    model = result.runner.model
    if study is None:
        known = result.runner.study
        study = known if known is not None and known.of(model) else None
    elif not study.of(model):
        raise StatechartError(
            f"the study is not of {model.name!r} as it is now and as this version runs it; make "
            "it anew with trade"
        )
    result.trace.require_motion()
    held = replace(result, trace=result.trace.at_hand())
    told = held.to_dict(explain=True, most=MOST_EVENTS)
    diagram = held.diagram() if result.trace.record is Record.MODES else None
    shown = content(result.observer, held.trace, told, diagram)
    return {**shown, "study": None if study is None else _studied(result, study)}


def _studied(result: Result, study: Measured) -> Mapping[str, Any]:
    """Return what is shown of a study, and whether the run had other parameters than it."""
    trace, runner = result.trace, result.runner
    fine = f"{trace.tolerance:.2g}" if trace.step is None else f"step {trace.step:.3g}"
    shown = study.shown(f"{trace.engine} {fine}")
    if runner.setup(result.overrides).values.tolist() == runner.setup().values.tolist():
        return shown
    other = "measured with the parameters that the model declares; this run had others"
    return {**shown, "above": [*shown["above"], other], "own": []}
