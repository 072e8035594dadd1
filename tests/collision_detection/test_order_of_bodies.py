"""Piles that are declared in another order move alike."""

from __future__ import annotations

import math

import pytest
from scipy.integrate import solve_ivp

from statechart import Runner
from statechart.arrays import Array
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


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("friction", [0, 0.3])
def test_two_cards_that_lean_against_each_other_stay_mirror_images(
    order: int, friction: float
) -> None:
    """Their corners meet without friction; tan(0.4)/2 of it holds their feet."""
    lean, length, width = 0.4, 1.0, 0.02
    x = width / 2 * math.cos(lean) + length / 2 * math.sin(lean)
    y = width / 2 * math.sin(lean) + length / 2 * math.cos(lean)
    cards = [
        f"{name}: {{mass: 1, inertia: {(length**2 + width**2) / 12}, shape: {{polygon: "
        f"[[{-width / 2}, {-length / 2}], [{width / 2}, {-length / 2}], "
        f"[{width / 2}, {length / 2}], [{-width / 2}, {length / 2}]]}}, "
        f"start: {{x: {side * x}, y: {y}, angle: {side * lean}}}}}"
        for name, side in (("left", -1), ("right", 1))
    ]
    text = f"""\
kind: scene
name: cards
gravity: 9.81
surfaces: {{floor: {{height: 0}}}}
collisions:
  tops: {{bodies: [left, right], friction: 0, restitution: 0}}
  feet: {{bodies: [left, right], surfaces: [floor], friction: {friction}, restitution: 0}}
stop: {{time: 0.3}}
outputs:
  left: {{value: left.angle}}
  right: {{value: right.angle}}
  middle: {{value: left.x + right.x}}
bodies:
""" + "".join(f"  {card}\n" for card in cards[::order])
    outputs = Runner(read_text(text), engine="impulse", step=1e-3).run().outputs
    # Without friction one angle describes both: the foot and the top slide on a corner's walls.
    inertia = (length**2 + width**2) / 12

    def fall(_: float, state: Array) -> list[float]:
        q, w = state
        u, v = width / 2, length / 2
        du, dv = u * math.sin(q) - v * math.cos(q), u * math.cos(q) - v * math.sin(q)
        bend = du * (u * math.cos(q) + v * math.sin(q)) - dv * (u * math.sin(q) + v * math.cos(q))
        return [w, (-bend * w * w - 9.81 * dv) / (inertia + du * du + dv * dv)]

    want = lean
    if friction == 0:
        want = solve_ivp(fall, (0, 0.3), [lean, 0], rtol=1e-12, atol=1e-13).y[0, -1]
    assert outputs["right"] == pytest.approx(want, abs=1e-6)
    assert outputs["left"] == pytest.approx(-outputs["right"], abs=1e-12)
    assert outputs["middle"] == pytest.approx(0, abs=1e-12)
