"""Packings: a run can start where another ended."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.testing.body_properties import assert_depths, assert_energy_of_steps
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner
from statechart.testing.subject import Subject

SHAPES = {
    "disc": ("disc: 0.01", 0.5e-6),
    "box": ("polygon: [[-0.01, -0.008], [0.01, -0.008], [0.01, 0.008], [-0.01, 0.008]]", 5.5e-7),
    "wedge": ("polygon: [[-0.01, -0.006], [0.01, -0.006], [0, 0.012]]", 3.4e-7),
}
COUNT = 24


def packing(starts, until, step=1e-3):
    """Return bodies of three shapes between walls, that begin where `starts` (b, 6) say."""
    kinds = list(SHAPES.values())
    bodies = "".join(
        f"  b{i}: {{mass: 0.01, inertia: {kinds[i % 3][1]}, shape: {{{kinds[i % 3][0]}}}, start: "
        f"{{{', '.join(f'{k}: {v!r}' for k, v in zip(KEYS, row, strict=True))}}}}}\n"
        for i, row in enumerate(starts.tolist())
    )
    return interpret(
        read_text(f"""\
kind: scene
name: packing
gravity: 9.81
bodies:
{bodies}surfaces:
  ground: {{height: 0}}
  left: {{line: [[0, 1], [0, 0]]}}
  right: {{line: [[0.1, 0], [0.1, 1]]}}
collisions:
  all: {{bodies: [{", ".join(f"b{i}" for i in range(len(starts)))}],
    surfaces: [ground, left, right], friction: 0.5, restitution: 0}}
stop: {{time: {until!r}}}
settings: {{engine: impulse, step: {step!r}}}
""")
    )


KEYS = ("x", "y", "angle", "dx", "dy", "dangle")


def thrown():
    generator = np.random.default_rng(4)
    places = np.arange(COUNT)
    starts = np.zeros((COUNT, 6))
    starts[:, 0] = 0.014 + 0.024 * (places % 4) + 1e-3 * generator.uniform(-1, 1, COUNT)
    starts[:, 1] = 0.013 + 0.026 * (places // 4)
    starts[:, 2] = 0.3 * generator.uniform(-1, 1, COUNT)
    return starts


def left(trace):
    """Return where a run ended (b, 6)."""
    return trace.final.reshape(2, -1, 3).transpose(1, 0, 2).reshape(-1, 6)


@pytest.mark.parametrize("after", [5e-4, 0.001])
def test_a_settled_packing_stays_at_rest_when_it_is_the_start(after):
    settled = left(Runner(packing(thrown(), 1.5, after)).run().trace)
    deepest = {}
    for step in (after, 2e-4):
        trace = Runner(packing(settled, 0.2, step)).run().trace
        (reported,) = trace.warnings
        assert reported.startswith("bodies start up to ")
        deepest[step] = -min(trace.margins.values())
        # It was about to rest: so fast it may go on.
        moved = 0.2 * np.abs(settled[:, 3:]).max() * np.array([1.0, 1.0, 100.0])
        assert (np.abs(left(trace) - settled)[:, :3] <= 1e-9 + moved).all()
    assert deepest[after] == pytest.approx(deepest[2e-4], rel=1e-6)


@pytest.mark.parametrize("at", [0.06, 0.1, 0.2])
def test_a_packing_amid_a_collapse_continues_it(at):
    scene = packing(left(Runner(packing(thrown(), at, 5e-4)).run().trace), 0.2, 5e-4)
    subject = Subject(scene)
    trace, numbers = subject.case({}).trace, body_numbers(scene, scene.values())
    assert_depths(numbers, trace)
    assert_energy_of_steps(numbers, subject, trace)


def test_too_deep_starts_are_refused():
    starts = thrown()[:1]
    starts[0, 1], starts[0, 2] = 0.0089, 0.0
    with pytest.raises(DeclarationError, match=r"'b0' starts 0\.0011 deep in surface 'ground'"):
        Runner(packing(starts, 0.1)).run()
    starts[0, 1] = 0.0091
    trace = Runner(packing(starts, 0.1)).run().trace
    assert trace.warnings[0].startswith(
        "bodies start up to 0.0009 deep in others or in surfaces ('b0' in surface 'ground')"
    )
    assert math.isclose(trace.final[1], 0.0091, rel_tol=1e-12)
