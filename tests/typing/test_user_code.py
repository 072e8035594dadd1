"""What users write passes mypy --strict, and what they must not write does not."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

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
WRONG = """\
from statechart import run

result = run(3)
mode: int = result.at(0.5).mode
result.to_xarray().nothing_of_this_name()
result.outcomes
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("user")
    (folder / "right.py").write_text(RIGHT)
    (folder / "wrong.py").write_text(WRONG)
    # With our own settings, so that what was checked of the packages is known already.
    made = subprocess.run(
        (sys.executable, "-m", "mypy", "--strict", folder / "right.py", folder / "wrong.py"),
        cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert not made.stderr
    return re.sub(r"^.*?(?=(?:right|wrong)\.py)", "", made.stdout, flags=re.M)


def test_code_of_users_passes_in_strict_mode(told: str) -> None:
    assert not [line for line in told.splitlines() if line.startswith("right.py")]


def test_what_is_wrong_in_it_is_told(told: str) -> None:
    places = [line.split(": error: ")[0] for line in told.splitlines() if ": error: " in line]
    assert {"wrong.py:3", "wrong.py:4", "wrong.py:6"} <= {*places}
