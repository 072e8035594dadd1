"""Units: declared ones, inferred ones, and their display."""

from __future__ import annotations

import re

import pytest

import models
from statechart import Chart, load, run
from statechart.documents.quantities import axis_label, unit_of
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
        ("tip.slip", "m/s"), ("energy", "J"), ("theta", "rad"), ("dtheta", "rad/s"), ("far", "m"),
        ("t_land", "s"), ("top", "m"), ("heat", "J"), ("hits", "1"), ("twice", "m"), ("mu", "1"),
    ],
)  # fmt: skip
def test_a_scene_knows_the_units_of_its_names(result: Result, name: str, unit: str) -> None:
    assert result.observer.automaton.declaration.unit(name) == unit


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
    assert data["far"].attrs["units"] == "m"


def test_summaries_show_units(result: Result) -> None:
    lines = str(result).splitlines()
    (land,) = [line.split() for line in lines if line.startswith("  t_land")]
    assert land[-1] == "s"
    assert result.to_dict()["units"]["top"] == "m"


def test_units_refer_to_existing_names() -> None:
    wrong = SCENE.replace("heat: J}", "heart: J}")
    with pytest.raises(DeclarationError, match=r"f\.yaml:3:39: units\.heart: unknown name") as e:
        Runner(read_text(wrong, "f.yaml"))
    assert "did you mean 'heat'" in str(e.value)


def test_variables_of_charts_have_the_units_that_are_declared() -> None:
    model = load("bouncing_ball_chart")
    assert isinstance(model, Chart)
    assert (model.unit("x"), model.unit("v"), model.unit("time")) == ("m", "m/s", "s")


def test_the_names_of_every_shipped_model_have_units() -> None:
    for name in models.names():
        model = load(name)
        unknown = [output for output in model.outputs if not model.unit(output)]
        runner = Runner(model)
        unknown += [x for x in runner.automaton.names if not model.unit(x)]
        assert not unknown, name


def measures(text: str, units: object = "SI") -> Chart:
    """Return a chart in which y is a speed whose parameters are found in a formula."""
    return Chart.model_validate(
        {
            "kind": "chart", "name": "test", "units": units,
            "variables": {"x": 1, "y": 0, "angle": "a"},
            "parameters": {"a": 1, "k": 1.5, "n": 2},
            "regions": {"r": {"initial": "on", "states": {"on": {"flows": {"x": "y"}}}}},
            "outputs": {"z": {"value": text}},
            "stop": {"time": 1},
        }
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("x + y*time", "m"), ("x**2 + 1", "m\u00b2"), ("sqrt(x**2)", "m"), ("x/y", "s"),
        ("max(x, 0)", "m"), ("hypot(x, k)", "m"), ("2*x", "m"), ("x/12", "m"), ("sin(angle)", "1"),
        ("atan2(x, y*time)", "rad"), ("-x", "m"), ("1/x", "1/m"), ("y**2/x", "m/s\u00b2"),
        ("pi*x", "m"), ("180*x", ""), ("0.5*x", ""), ("k*x", ""), ("x**n", ""), ("7", ""),
        ("+".join(["x"] * 120), ""), ("atan2(x, y*time)/(2*pi)", "1"), ("atan(x/x)/2", "rad"),
        ("atan(x/x)/time/(2*pi)", "1/s"), ("2*pi/time", "1/s"), ("pi*x**2", "m\u00b2"),
    ],
)  # fmt: skip
def test_an_output_has_the_unit_of_its_formula(text: str, unit: str) -> None:
    model = measures(text, {"length": "m", "time": "s", "x": "m"})
    assert model.unit("z") == unit


def test_parameters_have_the_units_of_their_uses() -> None:
    springs = load("hopper")
    found = {name: springs.unit(name) for name in springs.parameters}
    assert found == {
        "m": "kg", "foot": "kg", "k": "N/m", "l0": "m", "d": "m", "hold": "N", "h0": "m",
        "g": "m/s\u00b2",
    }  # fmt: skip
    turned = load("raibert_hopper")
    assert [turned.unit(n) for n in ("J", "c", "Kp", "gain")] == ["kg m\u00b2", "kg/s", "N m", "s"]
    # A conversion factor of degrees is no angle; a parameter without use has no unit.
    bar = load("double_contact_bar").model_copy(update={"units": SI})
    assert [bar.unit(n) for n in ("tilt_deg", "tilt", "L")] == ["", "rad", "m"]


def test_all_base_units_have_names() -> None:
    assert measures("x").units == SI
    without = measures("x", "dimensionless")
    assert (without.unit("z"), without.unit("time"), without.unit("k")) == ("1", "1", "1")
    with pytest.raises(DeclarationError, match="unknown system of units 'si'") as caught:
        Runner(read_text(SCENE.replace("{length: m, time: s, mass: kg, heat: J}", "si"), "f.yaml"))
    assert (caught.value.line, "SI" in str(caught.value)) == (3, True)


def test_quantities_without_a_unit_show_none() -> None:
    assert (axis_label("x", "1"), axis_label("x", ""), axis_label("x", "m")) == ("x", "x", "x in m")
    shown = str(run("toppling_stick", until=0.5))
    assert not re.search(r"stick\.x .* 1$", shown, re.M)
    assert re.search(r"stick\.angle .* rad$", shown, re.M)


@pytest.mark.parametrize(
    "start",
    [
        "{x: 2*index, y: 1, angle: half*(2*index + 1)}",
        # A saw-tooth, and a hash: sines of numbers make no angles of them.
        "{x: 3*index - n/pi*atan(tan(pi*(index - (n - 1)/2)/n)) + 0.02*sin(index), y: 1}",
    ],
)
@pytest.mark.parametrize("count", [1, 3])
def test_number_of_copies_has_no_unit_of_angle(start: str, count: int) -> None:
    scene = f"""\
kind: scene
name: row
units: SI
parameters: {{n: {count}, half: pi/(2*n)}}
gravity: 9.81
bodies: {{disc: {{copies: n, mass: 1, inertia: 1, shape: {{disc: 0.1}}, start: {start}}}}}
surfaces: {{floor: {{height: 0}}}}
collisions: {{all: {{bodies: [disc], surfaces: [floor], friction: 0, restitution: 0}}}}
outputs: {{tilted: {{value: cos(half), at: end}}}}
"""
    model = Runner(read_text(scene)).automaton.declaration
    assert model.unit("n") in ("", "1")
    assert model.unit("half") == "rad"


def test_constant_gains_do_not_change_the_units_of_rates() -> None:
    scene = read_text(
        "kind: scene\nname: leg\nunits: SI\nstop: {time: 1}\n"
        "coordinates: {lean: {start: 0}}\ncontrols: {tau: 0}\n"
        "bodies: {leg: {mass: 1, inertia: 1, position: [sin(lean), cos(lean)], angle: lean}}\n"
        "forces: {hip: {body: leg, moment: tau}}\n"
        "regions: {hip: {initial: on, states: {on: {sets: {tau: 60*lean - 5*dlean}}}}}\n"
    )
    model = Runner(scene).model
    assert (model.unit("dlean"), model.unit("tau")) == ("rad/s", "N m")
