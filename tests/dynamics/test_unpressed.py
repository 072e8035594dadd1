"""Normal forces along directions in which nothing of the scene moves."""

from __future__ import annotations

import pytest

import statechart
from contacts import Body, Contact, Coordinate, Force, Point, Scene, Surface
from statechart import Outcome, Stop


def pile(across: str) -> Scene:
    """A pile beside soil, which sinks, and may move across its face."""
    return Scene(
        name="pile",
        gravity=9.81,
        coordinates={name: Coordinate() for name in ("x", "z") if name in (across, "z")},
        bodies={"pile": Body(mass=500, position=(across, "z"))},
        surfaces={"soil": Surface(line=((0, 0), (0, 1)))},
        contacts={
            "side": Contact(point=Point(body="pile"), surface="soil", friction=1, restitution=0)
        },
        stop=Stop(time=0.1),
    )


@pytest.mark.parametrize("engine", ["taylor", "impulse"])
def test_a_pile_without_normal_motion_gives_a_warning(engine: str) -> None:
    step = 1e-2 if engine == "impulse" else None
    sunk = statechart.run(pile("0"), engine=engine, step=step, throw=False)
    assert [w for w in sunk.warnings if "no coordinate moves side along the normal" in w]
    free = statechart.run(pile("x"), engine=engine, step=step)
    assert not [w for w in free.warnings if "no coordinate" in w]


def test_a_pin_without_normal_motion_ends_the_run_with_a_sentence() -> None:
    scene = Scene(
        name="guided",
        gravity=9.81,
        coordinates={"x": Coordinate()},
        bodies={"a": Body(mass=1, position=("x", 0))},
        surfaces={"floor": Surface(height=0)},
        contacts={
            "c": Contact(
                point=Point(body="a"), surface="floor", friction=0.2, modes=["slide", "pin"]
            )
        },
        forces={"p": Force(body="a", force=("2*sin(time) - sign(a.dx)", 0))},
        stop=Stop(time=1),
    )
    trace = statechart.run(scene, engine="taylor", throw=False).trace
    assert trace.outcome is Outcome.EVENT_LOOP
    assert "c.V falls" in trace.message
