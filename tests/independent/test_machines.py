"""Machines with many events of their own kinds, against answers that were worked out apart."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import machine_references
import numpy as np
import pytest

import statechart

_MACHINES = Path(__file__).parent / "machines"


@functools.cache
def expected(name: str) -> Mapping[str, Any]:
    return getattr(machine_references, name)()


@pytest.mark.parametrize("name", sorted(path.stem for path in _MACHINES.glob("*.yaml")))
@pytest.mark.parametrize(
    ("engine", "method", "tolerance", "error"),
    [
        ("taylor", None, None, 1e-12),
        ("taylor", None, 1e-8, 1e-6),
        ("scipy", "DOP853", None, 1e-10),
        ("scipy", "RK45", 1e-9, 1e-6),
        ("scipy", "LSODA", 1e-10, 1e-6),
    ],
)
def test_a_machine_follows_its_closed_form(
    name: str, engine: str, method: str | None, tolerance: float | None, error: float
) -> None:
    result = statechart.run(
        _MACHINES / f"{name}.yaml", engine=engine, method=method, tolerance=tolerance
    )
    assert result.trace.certified
    for output, wanted in expected(name).items():
        found = result.outputs[output]
        assert np.shape(found) == np.shape(wanted), (output, found, wanted)
        assert found == pytest.approx(wanted, rel=error, abs=error), output
