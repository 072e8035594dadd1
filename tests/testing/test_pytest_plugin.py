"""The plugin of pytest: models as items, failures shrunk and written."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

from statechart import load, run

# A package that was installed before the plugin was there does not offer it yet.
OFFERED = any(entry.name == "statechart" for entry in entry_points(group="pytest11"))
PLUGIN = () if OFFERED else ("-p", "statechart.pytest_plugin")

WRONG = """\
kind: chart
name: leaves
parameters: {a: 1}
ranges: {a: [0, 4]}
variables: {x: 0}
regions: {r: {initial: s, states: {s: {flows: {x: a}}}}}
invariants: {stays below: x <= 3}
stop: {time: 1}
"""


def checked(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *PLUGIN, *options, "."),
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_pytest_plugin_shrinks_and_writes_failures(tmp_path: Path) -> None:
    (tmp_path / "leaves.yaml").write_text(WRONG)
    (tmp_path / "stays.yaml").write_text(WRONG.replace("[0, 4]", "[0, 2]").replace("leaves", "ok"))
    (tmp_path / "broken.yaml").write_text(WRONG.replace("flows", "flow"))
    (tmp_path / "other.yaml").write_text("some: data\n")
    made = checked(tmp_path, "--statechart", "--statechart-examples", "10", "-v")
    assert made.returncode == 1
    assert "leaves.yaml::leaves FAILED" in made.stdout
    assert "stays.yaml::stays PASSED" in made.stdout
    assert "broken.yaml::broken FAILED" in made.stdout
    assert "other.yaml" not in made.stdout
    assert "declared invariants hold" in made.stdout
    assert "leaves_failure.yaml reproduces it" in made.stdout
    assert "broken.yaml:6:" in made.stdout
    assert "unknown key 'flow'; did you mean 'flows'?" in made.stdout
    assert "Traceback" not in made.stdout
    # The simplest that fails, which a run shows.
    written = tmp_path / "leaves_failure.yaml"
    assert 3.0 < load(written).values()["a"] <= 4.0
    assert run(str(written)).trace.final[0] > 3.0
    # Written files are not collected by the next run.
    again = checked(tmp_path, "--statechart", "--collect-only", "-q")
    assert "leaves_failure" not in again.stdout


def test_models_are_not_collected_without_the_option(tmp_path: Path) -> None:
    (tmp_path / "leaves.yaml").write_text(WRONG)
    assert "no tests ran" in checked(tmp_path).stdout
