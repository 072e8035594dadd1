"""Couplings whose `enabled` is at its bound while they are locked."""

from __future__ import annotations

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

WHEELS = """
kind: scene
name: wheels
coordinates: {p: {}, q: {}}
bodies:
  motor: {mass: 1, inertia: 1, position: [0, 0], angle: p SHAPE}
  load: {mass: 1, inertia: 1, position: [3, 0], angle: q SHAPE}
couplings: {ow: {bodies: [motor, load], limit: 9, enabled: RELATION}}
forces: {torque: {body: motor, moment: 3*sin(time)}}
stop: {time: 0.1}
"""
SHAPES = "collisions: {all: {bodies: [motor, load], friction: 0, restitution: 0}}"


@pytest.mark.parametrize("shapes", [False, True])
@pytest.mark.parametrize(
    ("relation", "warns"),
    [
        ("ow.slip <= 0", True),
        ("ow.slip < 0", True),
        ("dp - dq <= 0", True),
        ("dp <= 0", False),
        ("ow.slip <= 1", False),
        ("time <= 0.05", False),
    ],
)
def test_a_coupling_enabled_by_the_sign_of_its_slip_names_the_freewheel(
    shapes: bool, relation: str, warns: bool
) -> None:
    text = WHEELS.replace("RELATION", relation) + (SHAPES if shapes else "")
    model = interpret(read_text(text.replace("SHAPE", ", shape: {disc: 0.3}" if shapes else "")))
    found = statechart.run(model, engine="impulse", step=1e-2)
    assert warns is any("for a freewheel write enabled" in warning for warning in found.warnings)
