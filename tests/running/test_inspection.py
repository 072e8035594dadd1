"""Inspection of a model without a run."""

from __future__ import annotations

import pytest

import statechart
from contacts import Body, Contact, Point, Scene, Surface
from statechart import DeclarationError, Stop, check, load, trade
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

SCENE = Scene(
    name="block",
    gravity=9.81,
    bodies={"block": Body(mass=1)},
    surfaces={"floor": Surface(height=0)},
    contacts={
        "base": Contact(point=Point(body="block"), surface="floor", friction=0.5, restitution=0)
    },
    initial_modes={"base": "pin"},
    stop=Stop(time=1),
)


def test_a_model_lists_its_modes() -> None:
    found = SCENE.modes()
    assert len(found) == 3
    assert [mode["base"] for mode in found.possible] == ["free", "slide", "pin"]
    assert found.refused == ()
    assert str(found).startswith("block: 3 modes (4 with directions of sliding)")
    table = load("four_legged_table").modes()
    assert len(table.possible) + len(table.refused) == len(table)


def test_a_model_writes_its_equations() -> None:
    said = SCENE.equations("base:pin")
    assert said.startswith("block, base:pin")
    assert said == statechart.equations(SCENE, "pin")
    assert "begin{align" in SCENE.equations("free", latex=True)


def test_a_model_draws_and_checks_itself(tmp_path: object) -> None:
    assert SCENE.diagram().title == "block"
    assert SCENE.check(examples=1, seed=1).passed


def test_the_initial_mode_has_two_names() -> None:
    fields = SCENE.model_dump(by_alias=True)
    assert fields["modes"] == {"base": "pin"}
    assert Scene(**fields) == SCENE


@pytest.mark.parametrize("model", [3, {"name": "block"}, None])
def test_non_model_objects_are_reported(model: object) -> None:
    with pytest.raises(statechart.DeclarationError, match="a model is a file, the name of a"):
        statechart.run(model)  # type: ignore[arg-type]


def test_model_prints_as_a_readable_document() -> None:
    assert interpret(read_text(str(SCENE))) == SCENE


def test_inspection_results_print_their_text() -> None:
    found = check("bouncing_ball_chart", examples=1, seed=1)
    assert str(found) == repr(found) == found.text()
    drawn = SCENE.diagram()
    counts = f"{len(drawn.nodes)} states, {len(drawn.links)} transitions"
    assert repr(drawn) == f"<diagram of block: {counts}>"


def test_functions_of_models_accept_names() -> None:
    study = trade("bouncing_ball_chart", settings=(), repeats=1)
    assert study.model == "bouncing_ball_chart"
    assert str(study).startswith("bouncing_ball_chart to t = ")
    with pytest.raises(DeclarationError, match="no shipped model"):
        trade("bouncing_bal_chart")
    with pytest.raises(DeclarationError, match="no shipped model"):
        check("bouncing_bal_chart")
