"""Warnings of loads that bodies with shapes share in several ways; independent: statics by hand."""

from __future__ import annotations

import numpy as np
import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

DISC = "disc: 0.05"
PAN = "polygon: [[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]"
PLANK = "{polygon: [[-1, -0.05], [1, -0.05], [1, 0.05], [-1, 0.05]]}"


def scales(*places, shape=DISC, friction=0.0):
    """Return a run of a plank of 20 N on scales: bodies of 10 N, each held by a weld."""
    named = [(f"s{i}", f"w{i}", x) for i, x in enumerate(places)]
    bodies = "\n".join(
        f"  {s}: {{mass: 1, inertia: 0.01, shape: {{{shape}}}, start: {{x: {x}}}}}"
        for s, _, x in named
    )
    joints = "\n".join(
        f"  {w}: {{point: {{body: {s}}}, to: [{x}, 0], angle: held}}" for s, w, x in named
    )
    others = ", ".join(s for s, _, _ in named)
    text = f"""
kind: scene
name: scales
gravity: 10
bodies:
  plank: {{mass: 2, inertia: 0.5, shape: {PLANK}, start: {{x: 0.1, y: 0.1}}}}
{bodies}
joints:
{joints}
collisions:
  all: {{bodies: [plank, {others}], friction: {friction}, restitution: 0}}
stop: {{time: 0.1}}
settings: {{engine: impulse, step: 2e-3}}
outputs:
""" + "\n".join(f"  {w}: {{value: {w}.Y}}" for _, w, _ in named)
    return Runner(interpret(read_text(text))).run()


def open_forces(result):
    """Return the forces and the contacts that the warnings name."""
    found = []
    for warning in result.trace.warnings:
        forces, _, contacts = warning.partition(" are indeterminate: ")
        contacts = contacts.removesuffix(" can share their load in several ways, and one is shown")
        found.append((forces.partition(" the forces ")[2].split(", "), contacts.split(", ")))
    return found


def test_three_scales_bear_a_plank_in_several_ways():
    result = scales(-0.8, 0.0, 0.7)
    contacts = ["plank/s0", "plank/s1", "plank/s2"]
    assert open_forces(result) == [(["w0.Y", "w1.Y", "w2.Y"], contacts)]
    # Any distribution has the weight, and no moment about the centre of the plank.
    loads = np.array([*result.outputs.values()]) - 10
    assert loads.sum() == pytest.approx(20, abs=1e-6)
    assert loads @ [-0.9, -0.1, 0.6] == pytest.approx(0, abs=1e-6)


def test_two_scales_bear_a_plank_in_one_way():
    result = scales(-0.8, 0.7)
    assert not result.trace.warnings
    assert [*result.outputs.values()] == pytest.approx([10 + 20 * 0.6 / 1.5, 10 + 20 * 0.9 / 1.5])


def test_friction_leaves_thrusts_of_two_scales_open():
    """Plank and scales may press each other apart; the loads are determined."""
    assert open_forces(scales(-0.8, 0.7, friction=0.5)) == [
        (["w0.X", "w1.X", "w0.M", "w1.M"], ["plank/s0", "plank/s1"])
    ]


def test_places_of_loads_on_flat_pans_are_open():
    [(forces, _)] = open_forces(scales(-0.8, 0.7, shape=PAN))
    assert forces == ["w0.Y", "w1.Y", "w0.M", "w1.M"]
    # One pan bears all.
    assert not scales(0.1, shape=PAN, friction=0.5).trace.warnings


def rough(*frictions, speed=1.0):
    places = zip((-0.8, -0.3, 0.6), frictions, strict=False)
    named = [(f"s{i}", x, mu) for i, (x, mu) in enumerate(places)]
    text = f"""
kind: scene
name: rough
gravity: 10
bodies:
  plank: {{mass: 2, inertia: 0.5, shape: {PLANK}, start: {{y: 0.1, dx: {speed}}}}}
""" + "\n".join(
        f"  {s}: {{fixed: true, shape: {{{DISC}}}, start: {{x: {x}}}}}" for s, x, _ in named
    )
    text += "\ncollisions:\n" + "\n".join(
        f"  c{s}: {{bodies: [plank, {s}], friction: {mu}, restitution: 0}}" for s, _, mu in named
    )
    text += "\nstop: {time: 0.05}\nsettings: {engine: impulse, step: 1e-3}\n"
    return Runner(interpret(read_text(text))).run().trace


def test_a_plank_slides_over_three_blocks_of_different_friction():
    [warning] = rough(0.1, 0.5, 0.3).warnings
    names = "plank/s0, plank/s1, plank/s2"
    assert f"how {names} share the load changes the motion" in warning
    # Equal friction, two blocks, or a plank at rest determine the motion.
    for settled in (rough(0.3, 0.3, 0.3), rough(0.1, 0.5), rough(0.1, 0.5, 0.3, speed=0.0)):
        assert not settled.warnings


PUSHED = """
kind: scene
name: pushed
gravity: 10
HEAD
bodies:
  pad:
    mass: 1
    PLACE
    shape: {polygon: [[-0.02, -0.05], [0.02, -0.05], [0.02, 0.05], [-0.02, 0.05]]}
  box:
    mass: 2
    inertia: 0.05
    start: {x: 0.12, y: 0.1}
    shape: {polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}
surfaces: {table: {height: 0}}
forces: {push: {body: pad, force: [30, 0]}}
collisions: {all: {bodies: [pad, box], surfaces: [table], friction: 0.5, restitution: 0}}
stop: {time: 0.1}
settings: {engine: impulse, step: 1e-3}
outputs: {v: {value: box.dx}}
"""
GUIDE = "joints: {g: {point: {body: pad}, to: {y: 0.1}, angle: held}}"


@pytest.mark.parametrize(
    ("head", "place"),
    [(GUIDE, "start: {y: 0.1}\n    inertia: 1"), ("coordinates: {s: {}}", "position: [s, 0.1]")],
)
def test_a_guided_pad_may_press_the_box_that_it_pushes_on_the_table(head, place):
    """Friction t of the pad, up to half of its load N, loads the table; the guide bears it.

    With ``3 a = 30 - 0.5 (20 + t)`` and ``N = 30 - a`` every t from -N/2 to N/2 is a motion.
    """
    text = PUSHED.replace("HEAD", head).replace("PLACE", place)
    result = Runner(interpret(read_text(text))).run()
    least, most = ((20 - 7.5 * sign) / (3 - 0.25 * sign) for sign in (1, -1))
    assert least <= result.outputs["v"] / 0.1 <= most
    [warning] = [text for text in result.trace.warnings if "changes the motion" in text]
    assert warning.startswith("from t = 0 ")
    assert "box/table share the load" in warning
