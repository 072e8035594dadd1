"""`statechart modes`: declared modes, feasible ones, and reasons against the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from statechart.automaton.product import feasibility
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

BAR = """\
kind: scene
name: bar
gravity: 9.81
parameters: {tilt: 0.1, half: 1}
bodies: {bar: {mass: 1, inertia: 1/3, start: {y: half*sin(tilt), angle: tilt}}}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: bar, at: [-half, 0]}, surface: floor, friction: 0.5, restitution: 0}
  B: {point: {body: bar, at: [half, 0]}, surface: floor, friction: 0.5, restitution: 0}
stop: {time: 1}
"""
# A stick between two walls: each contact's normal passes through the other contact.
SPREADER = """\
kind: scene
name: spreader
bodies: {stick: {mass: 1, inertia: 1/3}}
surfaces:
  left: {line: [[-1, 1], [-1, -1]]}
  right: {line: [[1, -1], [1, 1]]}
contacts:
  L: {point: {body: stick, at: [-1, 0]}, surface: left, friction: 0.5, restitution: 0}
  R: {point: {body: stick, at: [1, 0]}, surface: right, friction: 0.5, restitution: 0}
stop: {time: 1}
"""
BELTS = BAR.replace(
    "surfaces: {floor: {height: 0}}",
    "surfaces:\n"
    "  west: {height: 0, displacement: [-time, 0]}\n"
    "  east: {height: 0, displacement: [time, 0]}",
)
BELTS = BELTS.replace("surface: floor", "surface: west", 1).replace(
    "surface: floor", "surface: east"
)


@pytest.fixture
def listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    def run(text: str, *arguments: str) -> dict:
        path = tmp_path / "model.yaml"
        path.write_text(text, encoding="utf-8")
        assert main(["modes", str(path), "--json", *arguments]) == 0
        return json.loads(capsys.readouterr().out)

    return run


def numbers(listed: dict) -> tuple[int, int, int, int]:
    directed = listed["feasibility"]["with_direction"]
    plain = listed["feasibility"]["without_direction"]
    for level in (directed, plain):
        assert len(level["feasible"]) + len(level["infeasible"]) == level["declared"]
        assert all(refused["reason"] for refused in level["infeasible"])
    return (
        len(plain["feasible"]), plain["declared"],
        len(directed["feasible"]), directed["declared"],
    )  # fmt: skip


def test_a_bar_on_two_points_has_seven_modes_of_nine(listed) -> None:
    found = listed(BAR)
    assert numbers(found) == (7, 9, 10, 16)
    assert (found["modes_declared"], found["modes_total"], found["modes_built"]) == (9, 16, 0)
    assert found["enumerated"]
    refused = found["feasibility"]["without_direction"]["infeasible"]
    assert [r["mode"] for r in refused] == [{"A": "slide", "B": "pin"}, {"A": "pin", "B": "slide"}]
    assert "A cannot slip" in refused[0]["reason"]


def test_an_open_contact_is_classified_as_if_closed_and_its_gap_reported(listed) -> None:
    found = listed(BAR)["feasibility"]["remarks"]
    assert found == ["B does not touch (gap 0.199667): judged as if it did"]
    assert listed(BAR, "--set", "tilt=0")["feasibility"]["remarks"] == []
    inside = listed(BAR, "--at", "bar.y=-1", "--at", "bar.angle=0")["feasibility"]["remarks"]
    assert inside == ["A is 1 inside its surface", "B is 1 inside its surface"]


def test_feasibility_depends_on_the_configuration(listed) -> None:
    assert numbers(listed(SPREADER))[:2] == (4, 9)
    found = listed(SPREADER, "--at", "stick.angle=0.3")
    assert numbers(found)[:2] == (7, 9)
    assert found["state"]["stick.angle"] == 0.3


def test_modes_with_until_use_the_final_configuration(listed) -> None:
    found = listed(BAR, "--until", "0.5")
    assert found["time"] == 0.5
    assert found["modes_built"] >= 2
    assert found["feasibility"]["remarks"] == []  # it has fallen flat
    assert abs(found["state"]["bar.angle"]) < 1e-9


def test_pinning_all_driven_contacts_is_infeasible(listed) -> None:
    refused = listed(BELTS)["feasibility"]["without_direction"]["infeasible"]
    reasons = {(r["mode"]["A"], r["mode"]["B"]): r["reason"] for r in refused}
    assert reasons == {("pin", "pin"): "the prescribed motion cannot go on with A pin and B pin"}


def test_a_mode_impossible_for_every_point_leaves_no_feasible_mode(listed) -> None:
    # Points of a body that cannot turn and lists no free: they slide alike or not at all.
    text = BAR.replace(", inertia: 1/3", "").replace(", angle: tilt", "")
    text = (
        text.replace("half*sin(tilt)", "0")
        .replace("[-half, 0]", "[0, 0]")
        .replace("[half, 0]", "[0, 0]")
    )
    text = text.replace(
        "surface: floor, friction: 0.5, restitution: 0", "surface: floor, modes: [pin]", 1
    )
    text = text.replace("friction: 0.5, restitution: 0", "modes: [slide], friction: 0.5")
    found = listed(text)
    assert numbers(found) == (0, 1, 0, 2)
    assert found["feasibility"]["without_direction"]["infeasible"][0]["reason"]


def test_modes_of_many_contacts_are_counted_and_never_enumerated(listed, capsys, tmp_path) -> None:
    lines = BAR.splitlines()
    point = lines[7]
    text = "\n".join(
        lines[:7]
        + [point.replace("A:", f"c{i}:").replace("-half", f"{i}*half/19") for i in range(20)]
        + lines[9:]
    )
    found = listed(text)
    assert not found["enumerated"]
    assert found["feasibility"] is None
    assert (found["modes_declared"], found["modes_total"]) == (3**20, 4**20)
    assert [(r["modes_declared"], r["modes_total"]) for r in found["regions"]] == [(3, 4)] * 20
    assert main(["modes", str(tmp_path / "model.yaml")]) == 0
    assert "the product is not enumerated" in capsys.readouterr().out


def test_charts_have_no_feasibility_verdicts(listed) -> None:
    runner = Runner("bouncing_ball_chart")
    setup = runner.setup()
    assert feasibility(runner.automaton, setup, setup.initial, 0.0) is None


def test_every_product_mode_has_one_verdict() -> None:
    runner = Runner(read_text(BAR))
    setup = runner.setup()
    found = feasibility(runner.automaton, setup, setup.initial, 0.0)
    assert found is not None
    assert len(found.modes) == runner.automaton.modes_total
    assert len(found.declared) == runner.automaton.modes_declared
    for key, reason in found.declared.items():
        directions = [
            why
            for mode, why in found.modes.items()
            if tuple(state.rstrip("+-") for state in mode) == key
        ]
        assert bool(reason) == all(directions)


def test_listing_is_printed_as_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(BAR, encoding="utf-8")
    assert main(["modes", str(path)]) == 0
    said = capsys.readouterr().out
    assert "bar: 9 modes (16 with directions of sliding); none built" in said
    assert "kinematically possible at t = 0: 7 of 9 (10 of 16 with directions)" in said
    assert "  slide  slide  possible\n" in said
    assert "  slide  pin    not: " in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--at", "bar.angel=0"], "no such variable"),
        (["--at", "bar.angel=0"], "bar.angle"),
        (["--at", "bar.y=inf"], "must be finite"),
        (["--at", "bar.y"], "not of the form NAME=VALUE"),
        (["--at", "bar.y=1", "--at", "bar.y=2"], "given twice"),
        (["--at", "bar.y=1", "--until", "1"], "not allowed with"),
        (["--set", "tlit=0"], "no parameter 'tlit'"),
        (["--until", "-1"], "from 0 on"),
    ],
)
def test_bad_input_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(BAR, encoding="utf-8")
    assert main(["modes", str(path), *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_configuration_without_directions_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(BAR.replace("{height: 0}", "{circle: [0, 0], radius: 0.5}"), encoding="utf-8")
    arguments = ["--at", "bar.x=1", "--at", "bar.y=0", "--at", "bar.angle=0"]
    assert main(["modes", str(path), *arguments]) != 0
    assert "choose another" in capsys.readouterr().err


def test_open_joints_and_contacts_that_are_off_are_reported(listed) -> None:
    gated = BAR.replace("restitution: 0}", "restitution: 0, enabled: bar.angle >= 0.2}", 1)
    found = listed(gated, "--set", "tilt=0")
    assert found["feasibility"]["remarks"] == [
        "A is off, as 'A: bar.angle >= 0.2' does not hold: judged as if it were on"
    ]
    assert numbers(found)[1] == 12
    hinged = BAR + "joints: {pivot: {point: {body: bar, at: [-half, 0]}, to: [-cos(tilt), 0]}}\n"
    hinged = hinged.replace("to: [-cos(tilt), 0]", "to: {x: -cos(tilt)}")
    assert listed(hinged, "--set", "tilt=0")["feasibility"]["remarks"] == []
    apart = listed(hinged, "--set", "tilt=0", "--at", "bar.x=0.5")["feasibility"]["remarks"]
    assert apart == ["joints are apart by up to 0.5"]
    # Held at x, the points of a bar that lies flat cannot slip.
    refused = listed(hinged, "--set", "tilt=0")["feasibility"]["without_direction"]["infeasible"]
    assert {"A": "slide", "B": "slide"} in [r["mode"] for r in refused]
