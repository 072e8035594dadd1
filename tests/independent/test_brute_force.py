"""Mechanisms on moving, turning and carried surfaces, against a code that tries every mode.

A separate program that shares nothing with the packages made the reference values: Lagrange's
equations of the document by SymPy; at every event each combination of modes is solved as a linear
system and followed for 1e-6, and the one whose inequalities hold there is taken; impacts are
solved likewise, a single one along Routh's path; SciPy's DOP853 at 1e-13, events by bisection of
its steps.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import statechart

_FOLDER = Path(__file__).parent / "brute_force"
_ANSWERS = json.loads((_FOLDER / "answers.json").read_text())
# Error by force bands of 1e-12 at slopes of 0.1 per second, and by magnification in impacts.
_ERROR = 1e-9


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("name", _ANSWERS)
def test_brute_force_over_modes_agrees(name: str, engine: str) -> None:
    answer = _ANSWERS[name]
    result = statechart.run(_FOLDER / f"{name}.yaml", engine=engine)
    report = result.to_dict()
    assert report["certified"]
    assert report["t_end"] == pytest.approx(answer["end"], abs=_ERROR)
    contacts = [*answer["modes"][0][1]]
    entered: list[tuple[float, Any]] = [(0.0, {c: report["modes"][0][c] for c in contacts})]
    for event in report["events"]:
        # The last of several events at one instant counts.
        same = event["t"] - entered[-1][0] <= _ERROR
        entered[-1 if same else len(entered) :] = [
            (event["t"], {c: event["to"][c] for c in contacts})
        ]
    # Events that keep all contact modes are omitted.
    entered = [now for before, now in pairwise([(0.0, None), *entered]) if now[1] != before[1]]
    assert [mode for _, mode in entered] == [mode for _, mode in answer["modes"]]
    times = [t for t, _ in answer["modes"]]
    assert [t for t, _ in entered] == pytest.approx(times, abs=_ERROR)
    for variable, value in answer["state"].items():
        assert report["final"][variable] == pytest.approx(value, abs=_ERROR, rel=_ERROR), variable
    end = result.at(report["t_end"]).values
    for force, value in answer["forces"].items():
        assert end[force] == pytest.approx(value, abs=_ERROR, rel=_ERROR), force
