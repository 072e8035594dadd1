"""What a model asserts of all of its runs: reported with its least margin, tested by `check`."""

from __future__ import annotations

from pathlib import Path

import pytest

import models
import statechart
from statechart.errors import DeclarationError
from statechart.loading.load import load
from statechart.running.result import Result


def ball(tmp_path: Path, invariants: str) -> Path:
    """Return the shipped ball with invariants."""
    shipped = models.path("bouncing_ball")
    assert shipped is not None
    text = shipped.read_text(encoding="utf-8").replace("k: 0.9 ", "k: 0.5 ")
    file = tmp_path / "ball.yaml"
    file.write_text(f"{text}\ninvariants:\n{invariants}", encoding="utf-8")
    return file


def least(found: Result) -> dict[str, float]:
    return dict(found.to_dict()["invariants"])


def test_the_least_margin_of_an_invariant_is_reported(tmp_path: Path) -> None:
    file = ball(
        tmp_path,
        "  stays below: height <= 1.25\n  never fast: dheight**2 < 20\n  in time: time >= 0\n",
    )
    found = least(statechart.run(file))
    # Dropped from 1 it is fastest at the first impact: v^2 = 2 g h.
    assert found["stays below"] == pytest.approx(0.25, rel=1e-12)
    assert found["never fast"] == pytest.approx(20 - 2 * 9.81, rel=1e-9)
    assert found["in time"] == 0.0


def test_check_tells_which_invariant_fails(tmp_path: Path) -> None:
    kept = ball(tmp_path, "  above: height >= -1e-6\n")
    assert statechart.check(load(kept), examples=3, seed=1).passed
    broken = statechart.check(load(ball(tmp_path, "  low: height <= 0.05\n")), examples=3, seed=1)
    assert not broken.passed
    assert "low is -" in broken.text()


def test_an_invariant_of_what_there_is_not_is_refused_with_its_place(tmp_path: Path) -> None:
    file = ball(tmp_path, "  low: hight <= 2\n")
    with pytest.raises(DeclarationError, match="unknown name 'hight'") as caught:
        statechart.run(file)
    text = file.read_text(encoding="utf-8")
    assert caught.value.line == text.count("\n")
    assert caught.value.column == len("  low: ") + 1
