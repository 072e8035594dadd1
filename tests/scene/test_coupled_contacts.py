"""Impacts accumulate at plastic contacts only where joints or coordinates couple several."""

import pytest

from contacts.scene.scene import Scene
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

CHAIN = """
kind: scene
name: chain
bodies:
  a: {mass: 1, inertia: 1}
  b: {mass: 1, inertia: 1, start: {x: 1}}
  c: {mass: 1, inertia: 1, start: {x: 2}}
  d: {mass: 1, inertia: 1, start: {x: 5}}
surfaces: {ground: {height: -1}}
joints:
  ab: {point: {body: a, at: [1, 0]}, to: {body: b, at: [0, 0]}}
  cb: {point: {body: c, at: [-1, 0]}, to: {body: b, at: [0, 0]}}
contacts:
"""


@pytest.mark.parametrize(
    ("touching", "accumulating"),
    [("a", ""), ("ac", "ac"), ("abd", "ab"), ("acd", "ac"), ("bd", ""), ("dd", "dd")],
)
def test_plastic_impacts_accumulate_in_a_chain_with_two_contacts(
    touching: str, accumulating: str
) -> None:
    contacts = "".join(
        f"  c{i}{body}: {{point: {{body: {body}, at: [0, -0.5]}}, surface: ground, friction: 0, "
        "restitution: 0}\n"
        for i, body in enumerate(touching)
    )
    scene = interpret(read_text(CHAIN + contacts))
    assert isinstance(scene, Scene)
    assert "".join(name[-1] for name in scene.contacts if scene.bounces(name)) == accumulating
