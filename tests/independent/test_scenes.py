"""Scenes of many kinds against answers that were worked out apart, on all engines."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import references

import statechart

_SCENES = Path(__file__).parent / "scenes"
NAMES = sorted(path.stem for path in _SCENES.glob("*.yaml"))
# No steps can follow: controllers that remember, contacts that may not slide.
_EVENTS_ALONE = ("gripper", "step")
# Outputs that depend on the number of bounces, or with errors that grow along the run.
_TOO_FINE = {"hammer": ("v_after", "u_after", "t"), "squeeze": ("n", "t", "v"), "bang": ("n", "q")}
_STEP = 1e-3


@functools.cache
def expected(name: str) -> Mapping[str, Any]:
    return getattr(references, name)()


def assert_close(found: Any, wanted: Any, error: float, words: str) -> None:
    if wanted is None:
        assert found is None, words
        return
    found, wanted = np.atleast_1d(found), np.atleast_1d(wanted)
    assert len(found) == len(wanted), words
    size = max(1.0, np.abs(wanted).max(initial=0.0))
    assert np.abs(found - wanted).max(initial=0.0) <= error * size, (words, found, wanted)


# Radau takes many small steps in some.
_METHODS = [("taylor", None, 1e-10), ("scipy", "DOP853", 1e-10), ("scipy", "Radau", 1e-7)]
_LONG_BY_RADAU = (
    *("gripper", "bang", "parabead", "latch"),
    *("rim_rocker", "wallpend", "rim_bowl", "rim_drum"),
)


@pytest.mark.parametrize(
    ("name", "engine", "method", "error"),
    [(n, *m) for n in NAMES for m in _METHODS if m[1] != "Radau" or n not in _LONG_BY_RADAU],
)
def test_event_times_match_references(
    name: str, engine: str, method: str | None, error: float
) -> None:
    tolerance = 1e-10 if method == "Radau" else None
    result = statechart.run(
        _SCENES / f"{name}.yaml", engine=engine, method=method, tolerance=tolerance
    )
    assert result.trace.certified
    for output, wanted in expected(name).items():
        assert_close(result.outputs[output], wanted, error, output)


@pytest.mark.parametrize("name", [n for n in NAMES if n not in _EVENTS_ALONE])
def test_steps_converge_to_references(name: str) -> None:
    result = statechart.run(_SCENES / f"{name}.yaml", engine="impulse", step=_STEP)
    for output, wanted in expected(name).items():
        # Steps do not resolve the end of a sequence, nor the forces of contacts that share it.
        if output in ("tz", "H") or output in _TOO_FINE.get(name, ()):
            continue
        assert_close(result.outputs[output], wanted, 10.0 * _STEP, output)
