"""The same run under the other choices that a model leaves open, and where it differs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from statechart.observation.difference import compare
from statechart.observation.outputs import Outputs
from statechart.reporting.report import json_safe

if TYPE_CHECKING:
    from statechart.running.result import Result


def compared(result: Result, others: Mapping[str, Result]) -> list[dict[str, Any]]:
    """Return where each of the other runs differs from `result`."""
    rows: list[dict[str, Any]] = []
    for choice, other in others.items():
        found = compare(
            result.trace,
            other.trace,
            result.outputs,
            other.outputs,
            scales=Outputs(result.observer).scales(result.trace),
            endless=result.endless | other.endless,
        )
        report = other.to_dict()
        rows.append(
            {
                "choice": choice,
                "outcome": other.trace.outcome.name,
                "same_modes": found.diverged is None,
                "diverged": found.diverged,
                "difference": None if found.diverged is not None else json_safe(found.largest),
                "final": report["final"],
                "outputs": report["outputs"],
            }
        )
    return rows
