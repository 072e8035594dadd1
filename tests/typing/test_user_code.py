"""User code under mypy --strict: correct code passes, misuse is reported."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from statechart import run

RIGHT = """\
import xarray as xr

from contacts import Body, Contact, Point, Scene, Surface
from statechart import Outcome, Result, Runner, Stop, Value, check, load, run, sweep

scene: Scene = Scene(
    name="drop",
    gravity=9.81,
    bodies={"ball": Body(mass=1, start={"y": 1})},
    surfaces={"floor": Surface(height=0)},
    contacts={
        "tip": Contact(point=Point(body="ball"), surface="floor", friction=0.5, restitution=0)
    },
    stop=Stop(time=1),
    outputs={"t": Value(value="time", at="first tip.touchdown")},
)
result: Result = run(scene)
lands: bool = result.outputs["t"] < 3.0
later: bool = result.outputs["t"] + 1.0 >= 2 * result.outputs["t"]
total: float = sum(result.outputs["t"] for _ in range(3))
several = [value for value in result.outputs["t"]]
columns = [*result.events.columns, *result.samples.columns]
data: xr.Dataset = result.to_xarray()
moment = result.at(0.5)
height: float = moment.values["ball.y"]
mode: str = moment.mode["tip"]
outcome: Outcome = result.trace.outcome
found: xr.Dataset = sweep(scene.with_(), {"t0": [0.1, 0.2]}, outputs=["t"])
runner = Runner(load("toppling_stick"), engine="taylor", accuracy=1e-9)
for mu in (0.1, 0.2):
    if runner.run({"mu": mu}).outputs["slip_forward"] > 0.0:
        print(mu)
passed: bool = check(scene, examples=3, seed=1).passed
"""
CONTROLLED = """\
from contacts import Body, Controller, ControlState, Force, Scene
from statechart import Chart, Jump, Region, Runner, Sample, State, Stop, Transition, Value

heater = Chart(
    name="heater",
    variables={"T": 15},
    regions={
        "switch": Region(
            initial="on",
            states={"on": State(flows={"T": 1}), "off": State(flows={"T": "-T/10"})},
            transitions=(
                Transition(name="cut", source="on", target="off", guard="T >= 20"),
                Transition(name="heat", source="off", target="on", guard="T <= 18"),
            ),
        )
    },
    stop=Stop(time=60),
)
cart = Scene(
    name="cart",
    bodies={"cart": Body(mass=1)},
    forces={"motor": Force(body="cart", force=("thrust", 0))},
    controls={"thrust": 0},
    regions={
        "driver": Controller(
            initial="pushing",
            states={"pushing": ControlState(sets={"thrust": 2}), "rolling": ControlState()},
            transitions=(
                Transition(name="let_go", source="pushing", target="rolling", guard="cart.dx >= 1"),
            ),
        )
    },
    stop=Stop(time=2),
    outputs={"speed": Value(value="cart.dx")},
)


def brake(sample: Sample) -> dict[str, float]:
    return {"mu": 0.5 if sample.values["stick.dx"] > 0.0 else 0.2}


times: list[float] = [
    piece.t
    for piece in Runner("toppling_stick").stream(every=0.1, control=brake)
    if isinstance(piece, Jump)
]
"""
WRONG = """\
from statechart import run

result = run(3)
mode: int = result.at(0.5).mode
result.to_xarray().nothing_of_this_name()
result.outcomes
"""


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("user")
    (folder / "right.py").write_text(RIGHT)
    (folder / "wrong.py").write_text(WRONG)
    (folder / "right_controlled.py").write_text(CONTROLLED)
    # With our own settings, so that mypy reuses its cache of the packages.
    made = subprocess.run(
        (sys.executable, "-m", "mypy", "--strict", *sorted(folder.iterdir())),
        cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert not made.stderr
    return re.sub(r"^.*?(?=(?:right\w*|wrong)\.py)", "", made.stdout, flags=re.M)


def test_code_of_users_passes_in_strict_mode(reported: str) -> None:
    assert not [line for line in reported.splitlines() if line.startswith("right")]


def test_the_typed_user_script_runs() -> None:
    found: dict[str, Any] = {}
    exec(CONTROLLED, found)
    # By hand: pushed by 2 from rest it has the speed 1 after half a second, and keeps it.
    assert run(found["cart"]).outputs["speed"] == pytest.approx(1.0, abs=1e-12)
    assert run(found["heater"]).trace.jumps[0].t == pytest.approx(5.0, abs=1e-12)
    assert found["times"]


def test_wrong_user_code_is_rejected_by_mypy(reported: str) -> None:
    places = [line.split(": error: ")[0] for line in reported.splitlines() if ": error: " in line]
    assert {"wrong.py:3", "wrong.py:4", "wrong.py:6"} <= {*places}
