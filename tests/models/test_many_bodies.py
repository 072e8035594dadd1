"""The arch and the row of dominoes against the literature."""

from __future__ import annotations

import math

import numpy as np
import pytest

from statechart.automaton.trace import Outcome
from statechart.running.runner import Runner

G = 9.81


@pytest.fixture(scope="module")
def arch():
    return Runner("arch")


@pytest.mark.parametrize(("thickness", "stands"), [(0.2, True), (0.11, True), (0.1, False)])
def test_an_arch_stands_from_the_thickness_of_heyman_on(arch, thickness, stands):
    # 0.1075 of the mean radius.
    outputs = arch.run({"t": thickness, "spread": 0}).outputs
    sunk = outputs["keystone_start"] - outputs["keystone_end"]
    assert sunk < 1e-9 if stands else sunk > 1.0


def test_an_arch_falls_when_its_abutment_moves_far_enough(arch):
    little = arch.run({"spread": 0.1}).outputs
    assert 0.01 < little["keystone_start"] - little["keystone_end"] < 0.1
    far = arch.run()
    assert far.trace.outcome is Outcome.HORIZON
    assert far.outputs["keystone_end"] < 0.0


def train(height, thickness, gap, count=30, behind=12):
    """Return the speed of the wave at the end of a row, without friction between dominoes.

    A train of dominoes that lean on each other has one degree of freedom: its energy is kept while
    it falls, and each impact on the next one is plastic (van Leeuwen 2010).
    """
    inertia, pitch = (height**2 + thickness**2) / 3, gap + thickness

    def leaning(head, n):
        """Return the angles of the train from its head on, and their rates per that of the head."""
        angles, rates = [head], [1.0]
        for _ in range(n):
            q = (pitch * math.cos(angles[-1]) - thickness) / height
            slope = 1.0 - pitch * math.sin(angles[-1]) / (height * math.sqrt(1.0 - q * q))
            angles.append(angles[-1] + math.asin(q))
            rates.append(rates[-1] * slope)
        return np.array(angles), np.array(rates)

    spin, last = 5.0, math.asin(gap / height)
    for k in range(count):
        n = min(k, behind)
        angles = np.linspace(0.0, last, 201)
        states = [leaning(angle, n) for angle in angles]
        masses = np.array([inertia * (rates**2).sum() for _, rates in states])
        heights = np.array(
            [G / 2 * (height * np.cos(a) + thickness * np.sin(a)).sum() for a, _ in states]
        )
        energy = masses[0] * spin**2 / 2 + heights[0]
        spins = np.sqrt(2 * (energy - heights) / masses)
        time = np.trapezoid(1.0 / spins, angles)
        before = spins[-1] * states[-1][1]
        after = leaning(0.0, n + 1)[1]
        spin = float((after[1:] * before).sum() / (after**2).sum())
    return pitch / time


def test_dominoes_fall_at_the_speed_of_van_leeuwens_train():
    height, pitch = 0.048, 0.379 * 0.048
    expected = train(height, 0.179 * height, 0.2 * height)
    assert expected == pytest.approx(1.93 * math.sqrt(G * height), rel=2e-3)
    outputs = Runner("domino").run().outputs
    found = 14 * pitch / (outputs["last"] - outputs["fifteenth"])
    assert found == pytest.approx(expected, rel=0.03)
