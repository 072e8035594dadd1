"""Ties: an inequality broken by round-off is a tie, one broken by more is not."""

from __future__ import annotations

import pytest
from runs import ENGINES

from statechart import Runner
from statechart.documents.yaml_reader import read_text

# Pushed along the floor by the part `more` beyond what friction holds.
PUSHED = """\
kind: scene
name: pushed
parameters: {more: 0, mu: 0.3}
gravity: [9.81*mu*(1 + more), -9.81]
bodies: {block: {mass: 1, start: {y: 0}}}
surfaces: {floor: {height: 0}}
contacts: {foot: {point: {body: block}, surface: floor, friction: mu, restitution: 0}}
stop: {time: 1}
"""


@pytest.mark.parametrize("engine", ENGINES)
def test_friction_holds_up_to_its_bound(engine: str) -> None:
    runner = Runner(read_text(PUSHED), engine=engine)
    for more, mode in (
        (-1e-12, "pin"), (0.0, "pin"), (1e-13, "pin"), (1e-12, "slide+"), (1e-11, "slide+"),
    ):  # fmt: skip
        trace = runner.run({"more": more}).trace
        assert trace.modes[0] == (mode,), more
        assert not trace.jumps
