"""Contacts that joints hold closed: their share of the load is undetermined, with a warning."""

from __future__ import annotations

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

_GUIDED = """
kind: scene
name: guided
gravity: 10
bodies: {b: {mass: 1, inertia: 0.1, start: {dx: 2}}}
surfaces: {floor: {height: 0}}
joints: {guide: {point: {body: b}, to: PATH}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.5, restitution: 0}}
stop: {time: 2}
outputs: {x: {value: b.x}, push: {value: c.V}, guide: {value: guide.COMPONENT}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("path", "component", "push", "force"),
    [("{y: 0}", "Y", 0.0, 10.0), ("{x: 2*time}", "X", 10, 5)],
)
def test_a_contact_that_a_joint_holds_closed_has_no_force(
    engine: str, path: str, component: str, push: float, force: float
) -> None:
    # The drive along the floor carries no load.
    text = _GUIDED.replace("PATH", path).replace("COMPONENT", component)
    result = statechart.run(interpret(read_text(text, "guided.yaml")), engine=engine)
    assert [*result.outputs.values()] == pytest.approx([4.0, push, force], abs=1e-12)
    words = (
        "joints hold c closed, so that the normal force is undetermined: the run lets joints bear "
        "all of it, without friction there"
    )
    assert result.warnings == ((words,) if push == 0.0 else ())
