"""The shipped models reproduce their recorded results to the digit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import recording

import models

ROUNDING = 1e-13
# The compiler chooses instructions by the machine: on another one sums are rounded otherwise, and
# warnings on ties may differ. Events are the same, at times that impacts perturb.
ELSEWHERE = 1e-7


@pytest.mark.parametrize("model", models.names())
def test_a_shipped_model_reproduces_its_record(model: str, tmp_path: Path) -> None:
    recorded = json.loads((recording.FOLDER / f"{model}.json").read_text(encoding="utf-8"))
    found = json.loads(recording.written(recording.record(model, tmp_path)))
    tolerance = ROUNDING
    if recording.processor() != recording.PROCESSOR.read_text(encoding="utf-8").strip():
        recorded, found = recording.firm(recorded), recording.firm(found)
        tolerance = ELSEWHERE
    assert not [*recording.differences(recorded, found, tolerance, model)]


def test_record_comparison_detects_differences() -> None:
    old = {"a": [1.0, 2.0], "b": "at t = 3.5", "c": True, "x": 1e-17, "y": 0.5}
    assert not [*recording.differences(old, {**old, "x": 2e-17}, 1e-13)]
    for new in ({"a": [1.0, 2.0 + 1e-12]}, {"a": [1.0]}, {"b": "at t = 3.6"}, {"c": False}):
        assert len([*recording.differences(old, {**old, **new}, 1e-13)]) == 1
    assert len([*recording.differences(old, {"a": [1.0, 2.0], "b": "at t = 3.5"}, 1e-13)]) == 3
