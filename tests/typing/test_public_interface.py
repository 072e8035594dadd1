"""Public interface: every name once, with its types, and lazy imports."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import networkx as nx
import pytest
import xarray as xr

import contacts
import statechart
from contacts import (
    Body,
    Collision,
    Contact,
    Coordinate,
    Force,
    Free,
    Joint,
    Pin,
    Point,
    Scene,
    Shape,
    Slide,
    Surface,
)
from statechart import Chart, Diagram, Outcome, Result, Runner, Stop, Trace, Value


def sled() -> Scene:
    return Scene(
        name="sled",
        parameters={"mu": 0.5},
        gravity=9.81,
        bodies={"sled": Body(mass=1, start={"dx": 3})},
        surfaces={"floor": Surface(height=0)},
        contacts={
            "base": Contact(
                point=Point(body="sled"), surface="floor", modes=(Slide(), Pin()), friction="mu"
            )
        },
        forces={"wind": Force(body="sled", force=("-time", 0))},
        stop=Stop(time=2),
        outputs={"rest": Value(value="time", at="first base.stick")},
    )


def test_a_scene_is_built_run_drawn_and_saved(tmp_path: Path) -> None:
    scene: Scene = sled()
    result: Result = statechart.run(scene, parameters={"mu": 0.25})
    trace: Trace = result.trace
    outcome: Outcome = trace.outcome
    assert outcome is Outcome.HORIZON
    assert Runner(scene).run().trace.modes == trace.modes
    path = tmp_path / "sled.dot"
    drawn: Diagram = statechart.draw(scene, path)
    assert "pin" in path.read_text(encoding="utf-8")
    assert "pin" in drawn._repr_svg_()
    modes: nx.MultiDiGraph = statechart.graph(scene, trace=trace, around=("pin",), within=1)
    assert modes.nodes["pin",]["visits"] == 1


def test_scene_parts_are_typed() -> None:
    parts = (
        Coordinate(start=1),
        Shape(disc=1),
        Collision(bodies=("a", "b"), friction=0, restitution=0),
        Joint(point=Point(body="a"), to=Point(body="b")),
        Free(),
    )
    assert all(part.model_dump() for part in parts)


def test_a_shipped_model_loads_by_its_name() -> None:
    model = statechart.load("bouncing_ball_chart")
    assert isinstance(model, Chart)
    assert model.alternatives() == {}


def test_sweep_returns_a_dataset() -> None:
    found: xr.Dataset = statechart.sweep(sled(), {"mu": [0.2, 0.4]}, outputs=["rest"])
    assert found["rest"].dims == ("mu",)


def test_errors_share_one_base_class() -> None:
    with pytest.raises(statechart.DeclarationError):
        statechart.load("no such model")
    assert issubclass(statechart.Zeno, statechart.SimulationError)
    assert issubclass(statechart.SimulationError, statechart.StatechartError)


@pytest.mark.parametrize("face", [statechart, contacts])
def test_every_public_name_exists_and_is_listed(face: object) -> None:
    for name in face.__all__:  # type: ignore[attr-defined]
        assert getattr(face, name).__doc__
        assert name in dir(face)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = face.nothing  # type: ignore[attr-defined]


def test_results_of_public_functions_have_public_types() -> None:
    public = {getattr(face, name) for face in (statechart, contacts) for name in face.__all__}
    functions = [value for value in public if inspect.isfunction(value)]
    functions += [
        value
        for owner in (statechart.Result, statechart.Runner)
        for name, value in inspect.getmembers(owner, inspect.isfunction)
        if not name.startswith("_") and name not in ("batch", "setup")  # of the machinery
    ]
    returned = set()
    for function in functions:
        home = vars(sys.modules[function.__module__])
        for word in re.findall(r"\w+", function.__annotations__["return"]):
            if getattr(home.get(word), "__module__", "").startswith("statechart"):
                returned.add(home[word])
    assert {statechart.Study, statechart.Reading, statechart.Declaration} <= returned
    assert returned <= public


def test_version_matches_the_distribution() -> None:
    assert statechart.__version__.count(".") == 2


def test_a_declaration_needs_no_arrays_and_no_reader_of_files() -> None:
    code = (
        "import sys; from contacts import Scene; from statechart import Chart; "
        "print({'numpy', 'sympy', 'scipy', 'numba', 'ruamel.yaml'}.intersection(sys.modules))"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout == "set()\n"


def test_public_packages_import_lazily() -> None:
    code = "import sys, statechart, contacts; print('numpy' in sys.modules, len(dir(statechart)))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.startswith("False")
