"""Piles that are declared in another order move alike."""

from __future__ import annotations

import pytest

from statechart import Runner
from statechart.documents.yaml_reader import read_text

HEAD = """\
kind: scene
name: orders
gravity: 9.81
surfaces: {floor: {height: 0}}
collisions: {all: {bodies: [low, middle, top], surfaces: [floor], friction: 0.65, restitution: 0}}
stop: {time: 0.15}
bodies:
"""
PILES = {
    "a disc falls on a disc below a box": [
        "low: {mass: 0.8, inertia: 0.005, shape: {disc: 0.095}, start: {x: -0.15, y: 0.095}}",
        "middle: {mass: 1, inertia: 0.022, shape: {disc: 0.18}, start: {x: -0.045, y: 0.37}}",
        "top: {mass: 1.5, inertia: 0.027, start: {x: -0.11, y: 0.65, dx: -0.145},"
        " shape: {polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}}",
    ],
    "boxes of three sizes topple on each other": [
        "low: {mass: 1, inertia: 0.02, start: {y: 0.1, dx: 0.2},"
        " shape: {polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}}",
        "middle: {mass: 2, inertia: 0.03, start: {x: 0.12, y: 0.3005, dangle: -0.4},"
        " shape: {polygon: [[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]]}}",
        "top: {mass: 1.5, inertia: 0.02, start: {x: 0.2, y: 0.52, dangle: 0.3},"
        " shape: {polygon: [[-0.12, -0.1], [0.12, -0.1], [0.12, 0.1], [-0.12, 0.1]]}}",
    ],
}


@pytest.mark.parametrize("pile", PILES)
def test_piles_move_the_same_in_any_order_of_declaration(pile: str) -> None:
    def ended(bodies: list[str]) -> dict[str, float]:
        text = HEAD + "".join(f"  {body}\n" for body in bodies)
        run = Runner(read_text(text), engine="impulse", step=1e-3, impulse_tolerance=1e-10)
        return dict(zip(run.automaton.names, run.run().trace.final, strict=True))

    want, found = ended(PILES[pile]), ended(PILES[pile][::-1])
    assert found == pytest.approx(want, abs=1e-8)
