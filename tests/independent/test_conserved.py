"""Conserved or balanced quantities of scenes without a closed form."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

import statechart

_SCENES = Path(__file__).parent / "conserved"

pytestmark = pytest.mark.parametrize("engine", ["taylor", "scipy"])


def outputs(name: str, engine: str, **parameters: float) -> Any:
    path = _SCENES / f"{name}.yaml"
    return statechart.run(path, engine=engine, parameters=parameters).outputs


def test_a_bead_on_a_turning_rod_keeps_momentum_and_energy(engine: str) -> None:
    inertia, start, rate = 0.5, 0.2, 3.0
    found = outputs("turntable", engine)
    momentum = (inertia + start**2) * rate
    assert (inertia + found["r"] ** 2) * found["w"] == pytest.approx(momentum, rel=1e-11)
    # The rest of the energy moves the bead outwards; the rod pushes it by 2 m r' w + m r w'.
    energy = momentum * rate
    outwards = math.sqrt(energy - momentum * found["w"])
    slowing = -2 * found["r"] * outwards * found["w"] / (inertia + found["r"] ** 2)
    push = 2 * outwards * found["w"] + found["r"] * slowing
    assert found["V"] == pytest.approx(push, rel=1e-9)


def test_the_impulse_of_a_lift_floor_is_weight_and_momentum(engine: str) -> None:
    g, shake, w, mass, end = 9.81, 0.5, 6.0, 2.0, 2.0
    found = outputs("elevator", engine)
    off = math.asin(g / (shake * w**2)) / w
    assert found["off"] == pytest.approx([off, off + 2 * math.pi / w], rel=1e-11)
    speed = shake * w * math.cos(w * off)
    # It falls on the floor as it left it, one period after the other.
    flight = found["on"][0] - off
    height = speed * flight - g / 2 * flight**2
    floor = shake * (math.sin(w * (off + flight)) - math.sin(w * off))
    assert height == pytest.approx(floor, abs=1e-11)
    assert found["on"][1] - found["on"][0] == pytest.approx(2 * math.pi / w, rel=1e-11)
    blows = [mass * (after - (speed - g * flight)) for after in found["imp"]]
    gained = mass * (found["v"] - shake * w) + mass * g * end
    assert found["J"] + sum(blows) == pytest.approx(gained, rel=1e-11)


@pytest.mark.parametrize("e", [0.0, 0.25, 1.0])
def test_a_ball_in_a_corner_is_hit_by_both_walls_at_once(engine: str, e: float) -> None:
    found = outputs("corner", engine, e=e)
    assert [found["dx"], found["dy"]] == pytest.approx([2.0 * e, 2.0 * e], abs=1e-12)
    assert [found["x"], found["y"]] == pytest.approx([2.0 * e * 1.5] * 2, abs=1e-12)


def test_hinged_rods_with_a_motor_conserve_momenta(engine: str) -> None:
    g, length, mass, push, first, second, end = 9.81, 0.375, 2.0, 6.0, -0.9, -2.2, 2.5
    found = outputs("tumble", engine)
    # The middle of both falls; they start at rest, and the motor turns them against each other.
    x = length / 4 * (3 * math.sin(first) + math.sin(second))
    y = -length / 4 * (3 * math.cos(first) + math.cos(second))
    assert found["x"] == pytest.approx(x, abs=1e-9)
    assert found["y"] == pytest.approx(y - g / 2 * end**2, abs=1e-9)
    assert found["spin"] == pytest.approx(0.0, abs=1e-9)
    work = push * found["turned"]
    assert work > 1000.0
    # The speeds contain the work of the motor; rates of 300 rad/s have their round-off.
    assert found["energy"] - work == pytest.approx(2 * mass * g * y, abs=1e-9 * work)
