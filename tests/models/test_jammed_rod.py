"""A rod between two walls: slipping and jammed both agree with the state, by closed forms."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "outcomes.md"
LEAN, WEIGHT = 0.3, 9.81


@pytest.fixture(scope="module")
def rod() -> Runner:
    found = re.search(r"^kind: scene\nname: jammed\n.*?(?=^```)", PAGE.read_text(), re.M | re.S)
    assert found is not None
    return Runner(read_text(found[0]))


@pytest.mark.parametrize(
    ("mu", "press", "outcome", "mode"),
    [
        # Slipping: friction 2 mu N of N = press/(2 L sin(lean)) is below the weight. Jammed: the
        # line from end to end, at tan(lean) = 0.309, is in both cones.
        (0.25, 1.0, "HORIZON", ("slide+", "slide-")),
        (0.308, 1.0, "HORIZON", ("slide+", "slide-")),
        (0.311, 1.0, "AMBIGUOUS_MODE", None),
        (0.5, 1.0, "AMBIGUOUS_MODE", None),
        (0.5, 5.79, "AMBIGUOUS_MODE", None),
        (0.5, 5.81, "HORIZON", ("pin", "pin")),
    ],
)
def test_wedged_rod_slips_jams_or_is_ambiguous(
    rod: Runner, mu: float, press: float, outcome: str, mode: tuple[str, str] | None
) -> None:
    friction = mu * press / math.sin(LEAN)
    assert (friction < WEIGHT) is (mode != ("pin", "pin"))
    trace = rod.run({"mu": mu, "press": press}, throw=False).trace
    assert trace.outcome is Outcome[outcome]
    if mode is None:
        assert "A:pin B:pin, A:slide+ B:slide-" in trace.message
        assert trace.outcome.value.rstrip(".").lower() not in trace.message
        return
    assert trace.modes == (mode,)
    fallen = 0.5 * (WEIGHT - friction) if mode[0] != "pin" else 0.0
    assert trace.final[1] == pytest.approx(-fallen, rel=1e-12, abs=1e-15)
