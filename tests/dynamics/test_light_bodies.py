"""A light body beside heavy ones: events that the tolerance of forces delays are announced."""

from __future__ import annotations

from typing import Any

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result
from statechart.running.runner import run

_SCENE = """\
kind: scene
name: light_beside_heavy
gravity: 10
parameters: {m: 1, M: 1000}
bodies:
  light: {mass: m}
  heavy: {mass: M, start: {x: 20, dx: 1}}
surfaces: {floor: {height: 0}}
contacts:
  l: {point: {body: light}, surface: floor, friction: 0.4, restitution: 0}
  h: {point: {body: heavy}, surface: floor, friction: 0.4, restitution: 0}
forces: {pull: {body: light, force: [4*m*time, 0]}}
stop: {time: 2}
outputs: {slip: {value: time, at: first l.slip}}
"""
# The light body rides on the heavy one, which accelerates at 4 t.
_RIDES = _SCENE.replace("light: {mass: m}", "light: {mass: m, start: {y: 1}}").replace(
    "surfaces: {", "surfaces: {top: {body: heavy, line: [[-50, 1], [5, 1]]}, "
)
_RIDES = _RIDES.replace("surface: floor, friction: 0.4", "surface: top, friction: 0.4", 1)
_RIDES = _RIDES.replace("surface: floor, friction: 0.4", "surface: floor, friction: 0")
_RIDES = _RIDES.replace("body: light, force: [4*m*time", "body: heavy, force: [(m + M)*4*time")
_RIDES = _RIDES.replace("{x: 20, dx: 1}", "{x: 0}")


def _pulled(text: str, mass: float, engine: str = "taylor") -> Result:
    options: dict[str, Any] = {"step": 1e-3} if engine == "impulse" else {}
    return run(read_text(text), parameters={"m": mass}, engine=engine, **options)


@pytest.mark.parametrize("text", [_SCENE, _RIDES], ids=["beside", "on top"])
def test_a_light_body_slips_on_time_or_is_named(text: str) -> None:
    for mass, error in ((1.0, 1e-8), (1e-2, 1e-6)):
        found = _pulled(text, mass)
        assert found.outputs["slip"] == pytest.approx(1.0, abs=error)
        assert not found.warnings
    found = _pulled(text, 1e-6)
    # 1e-12 of the force of the scene, 1e4, is 2.5e-3 of the bound of friction.
    assert found.outputs["slip"] == pytest.approx(1.0, abs=3e-3)
    assert ["'light' change their modes late" in warning for warning in found.warnings] == [True]
    assert "by up to 0.001 of its weight" in found.warnings[0]


@pytest.mark.parametrize("text", [_SCENE, _RIDES], ids=["beside", "on top"])
def test_by_steps_a_light_body_slips_on_time(text: str) -> None:
    found = _pulled(text, 1e-6, "impulse")
    assert found.outputs["slip"] == pytest.approx(1.0, abs=1e-3)
    assert not any("late" in warning for warning in found.warnings)


@pytest.mark.parametrize("e", [0.0, 1.0])
def test_a_body_that_always_rebounds_is_not_named(e: float) -> None:
    thrown = _SCENE.replace("light: {mass: m}", "light: {mass: m, start: {y: 1}}")
    thrown = thrown.replace("0.4, restitution: 0}", "0.4, restitution: e}", 1)
    found = _pulled(thrown.replace("{m: 1,", f"{{e: {e}, m: 1,"), 1e-6)
    assert any("'light'" in warning for warning in found.warnings) == (e == 0.0)


@pytest.mark.parametrize(("start", "named"), [("{}", True), ("{dy: 1}", False), ("{y: 1}", False)])
def test_a_body_that_starts_at_rest_on_a_perfectly_elastic_surface_is_named(
    start: str, named: bool
) -> None:
    text = _SCENE.replace("light: {mass: m}", f"light: {{mass: m, start: {start}}}")
    found = _pulled(text.replace("0.4, restitution: 0}", "0.4, restitution: 1}", 1), 1e-6)
    assert any("'light'" in warning for warning in found.warnings) == named
    if named:
        # The bound of friction is 4 m, the pull 4 m t: the warning gives the delay.
        (warning,) = (each for each in found.warnings if "'light'" in each)
        share = float(warning.split("by up to ")[1].split(" of its weight")[0])
        assert found.outputs["slip"] - 1.0 == pytest.approx(10.0 * share / 4.0, rel=0.1)
