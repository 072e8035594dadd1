"""Units: what is declared, what follows, and where they are shown."""

from __future__ import annotations

import pytest

from contacts import Scene
from statechart import Chart, load, run
from statechart.documents.quantities import unit_of
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.running.result import Result
from statechart.running.runner import Runner

SI = {"length": "m", "time": "s", "mass": "kg"}
SCENE = """\
kind: scene
name: drop
units: {length: m, time: s, mass: kg, heat: J}
parameters: {mu: 0.3}
gravity: 9.81
coordinates: {theta: {start: 0.1}, far: {}}
bodies:
  arm: {mass: 1, inertia: 1, position: [far, 2], angle: theta}
  ball: {mass: 1, inertia: 1, start: {y: 0.5}}
surfaces:
  floor: {height: 0}
contacts:
  tip: {point: {body: ball}, surface: floor, friction: mu, restitution: 0}
stop: {time: 0.5}
outputs:
  t_land: {value: time, at: first tip.touchdown}
  top: {maximum: ball.y}
  heat: {integral: abs(tip.H*tip.slip)}
  hits: {count: tip.touchdown}
  twice: {value: 2*ball.y}
"""


@pytest.fixture(scope="module")
def result() -> Result:
    return Runner(read_text(SCENE)).run()


@pytest.mark.parametrize(
    ("dimension", "units", "unit"),
    [
        ("length", SI, "m"), ("angle", {}, "rad"), ("angle/time", SI, "rad/s"),
        ("length/time", SI, "m/s"), ("force", SI, "N"), ("energy", SI, "J"), ("impulse", SI, "N s"),
        ("force", {"length": "cm", "time": "s", "mass": "g"}, "g cm/s\u00b2"),
        ("energy", {"force": "lbf", "length": "ft"}, "lbf ft"),
        ("force", {"length": "m"}, ""), ("length/time", {"length": "m"}, ""), ("", SI, ""),
    ],
)  # fmt: skip
def test_units_follow_from_those_of_length_time_and_mass(
    dimension: str, units: dict[str, str], unit: str
) -> None:
    assert unit_of(dimension, units) == unit  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("time", "s"), ("ball.x", "m"), ("ball.dangle", "rad/s"), ("tip.gap", "m"), ("tip.V", "N"),
        ("tip.slip", "m/s"), ("energy", "J"), ("theta", "rad"), ("dtheta", "rad/s"), ("far", ""),
        ("t_land", "s"), ("top", "m"), ("heat", "J"), ("hits", "1"), ("twice", ""), ("mu", ""),
    ],
)  # fmt: skip
def test_a_scene_knows_the_units_of_its_names(result: Result, name: str, unit: str) -> None:
    assert result.runner.model.unit(name) == unit


def test_tables_and_data_sets_have_units_and_long_names(result: Result) -> None:
    samples, events, data = result.samples, result.events, result.to_xarray()
    assert samples.attrs["units"]["ball.dy"] == "m/s"
    assert samples.attrs["long_names"]["tip.V"] == "V of tip"
    assert events.attrs["units"]["tip.normal"] == "N s"
    assert events.attrs["units"]["ball.y before"] == "m"
    assert data["ball.dy"].attrs == {
        "long_name": "rate of y of ball", "role": "variable", "units": "m/s",
    }  # fmt: skip
    assert data["t"].attrs["units"] == "s"
    assert data["event_tip.normal"].attrs["units"] == "N s"
    assert "units" not in data["far"].attrs


def test_summaries_show_units(result: Result) -> None:
    lines = str(result).splitlines()
    (land,) = [line.split() for line in lines if line.startswith("  t_land")]
    assert land[-1] == "s"
    assert "<td>s</td>" in result._repr_html_()
    assert result.to_dict()["units"]["top"] == "m"


def test_units_are_of_names_that_exist() -> None:
    wrong = SCENE.replace("heat: J}", "heart: J}")
    with pytest.raises(
        DeclarationError, match=r"f\.yaml:3:39: units\.heart: nothing is called"
    ) as e:
        Runner(read_text(wrong, "f.yaml"))
    assert "did you mean 'heat'" in str(e.value)


def test_variables_of_charts_have_the_units_that_are_declared() -> None:
    model = load("bouncing_ball_chart")
    assert isinstance(model, Chart)
    assert (model.unit("x"), model.unit("v"), model.unit("time")) == ("m", "m/s", "s")
    assert isinstance(load("bouncing_ball"), Scene)
    assert run("bouncing_ball", until=0.1).samples.attrs["units"] == {}
