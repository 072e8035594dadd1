"""Velocities above round-off are motion, in any units; below it they are rest."""

from __future__ import annotations

import pytest

import statechart
from contacts import Body, Contact, Joint, Point, Scene, Surface
from statechart import Stop


@pytest.mark.parametrize("units", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize(("spin", "rests"), [(0, True), (1e-18, True), (1e-10, False)])
def test_supports_that_a_joint_unloads_share_until_they_leave(
    units: float, spin: float, rests: bool
) -> None:
    # The joint bears the weight; a slow turn opens both supports.
    end = {"surface": "floor", "friction": 0.5, "restitution": 0}
    scene = Scene(
        name="beam",
        gravity=10 * units,
        bodies={"b": Body(mass=1, inertia=units**2, start={"dangle": spin})},
        surfaces={"floor": Surface(height=0)},
        joints={"a": Joint(point=Point(body="b"), to=(0, 0))},
        contacts={
            "m": Contact(point=Point(body="b", at=(0.5 * units, 0)), **end),
            "r": Contact(point=Point(body="b", at=(units, 0)), **end),
        },
        stop=Stop(time=0.01),
    )
    run = statechart.run(scene, engine="impulse", step=1e-3)
    assert any("m, r are indeterminate" in w for w in run.warnings) == rests, run.warnings
