"""Guards, stop and contact conditions that reach their boundary where a control or force saturates.

A block stands on a floor (friction 0.5, weight 10) and is pushed by u = 3 min(t, 1): from t = 1 on,
u and the friction force stay at 3 and -3.
"""

from __future__ import annotations

import math

import pytest
from runs import ENGINES

from statechart import Runner
from statechart.documents.yaml_reader import read_text

_PUSHED = """\
kind: scene
name: pushed
gravity: 10
bodies: {{b: {{mass: 1}}}}
surfaces: {{floor: {{height: 0}}}}
contacts:
  c: {{point: {{body: b}}, surface: floor, friction: 0.5, restitution: 0, enabled: "{enabled}"}}
controls: {{u: 0}}
forces: {{push: {{body: b, force: [{force}, 0]}}}}
regions:
  motor: {{initial: on, states: {{on: {{sets: {{u: "{law}"}}}}}}}}
  watch:
    initial: waits
    states: {{waits: {{}}, done: {{}}}}
    transitions: [{{name: go, from: waits, to: done, guard: "{guard}"}}]
stop: {{time: 3, conditions: {{hit: "{stop}"}}}}
outputs:
  fires: {{value: time, at: first watch.go}}
  off: {{value: time, at: first c.disable}}
  ends: {{value: time}}
"""
_LAWS = ["3*min(time, 1)", "min(3*time, 3)", "3*sat(time, 0, 1)", "3 - 3*max(1 - time, 0)"]


def _outputs(
    name: str, law: str, guard: str = "time > 4", stop: str = "time > 4",
    enabled: str = "b.y <= 1", force: str = "u",
) -> list[float | None]:  # fmt: skip
    text = _PUSHED.format(law=law, guard=guard, stop=stop, enabled=enabled, force=force)
    outputs = Runner(read_text(text), engine=name).run().outputs
    return [outputs[key] for key in ("fires", "off", "ends")]


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("law", _LAWS)
@pytest.mark.parametrize(
    ("guard", "fires"),
    [
        ("c.H <= -3", 1), ("abs(c.H) >= 3", 1), ("c.H < -3", None), ("u >= 3", 1),
        ("not u < 3", 1), ("u >= 3 and b.x <= 0", 1), ("u > 3", None), ("u >= 2.4", 0.8),
    ],
)  # fmt: skip
def test_a_guard_that_stays_on_its_boundary_fires_where_it_comes_there(
    name: str, law: str, guard: str, fires: float | None
) -> None:
    fired, off, ends = _outputs(name, law, guard)
    assert fired == (None if fires is None else pytest.approx(fires, rel=1e-12))
    assert (off, ends) == (None, 3)


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(("stop", "ends"), [("c.H <= -3", 1), ("u >= 3", 1), ("u > 3", 3)])
def test_a_stop_condition_that_stays_on_its_boundary_ends_the_run(
    name: str, stop: str, ends: float
) -> None:
    assert _outputs(name, _LAWS[0], stop=stop)[2] == pytest.approx(ends, rel=1e-12)


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("force", ["u", "0"])
@pytest.mark.parametrize(("enabled", "off"), [("u < 3", 1), ("not u >= 3", 1), ("u <= 3", None)])
def test_contacts_whose_condition_stays_on_its_boundary_close_or_open(
    name: str, force: str, enabled: str, off: float | None
) -> None:
    """The block falls from t = 1 on, and is 0.001 lower sqrt(0.002/10) later."""
    _, disabled, ends = _outputs(name, _LAWS[0], stop="b.y <= -0.001", enabled=enabled, force=force)
    assert disabled == (None if off is None else pytest.approx(off, rel=1e-12))
    assert ends == pytest.approx(3 if off is None else 1 + math.sqrt(2e-4), rel=1e-12)
