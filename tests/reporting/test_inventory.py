"""Inventory of a run: the parts that it built, and those it left out."""

from __future__ import annotations

from statechart.running.runner import run


def test_a_run_with_events_builds_the_modes_it_enters():
    result = run("toppling_stick")
    report = result.to_dict()
    modes = [entry["mode"]["tip"] for entry in report["built"]["modes"]]
    assert modes == ["pin", "slide-", "slide+"]
    assert report["modes_built"] == len(modes)
    # Three accelerations and two forces.
    assert report["built"]["unknowns"] == 5
    pin = report["built"]["modes"][0]["guards"]
    assert set(pin) == {"tip.V", "tip.mu V - H", "tip.mu V + H", "fallen", "fallen backward"}
    assert set(pin.values()) == {"interval enclosure"}
    left = {entry["what"]: entry["why"] for entry in report["left_out"]}
    assert left["the equations of 1 of 4 modes"] == "the run did not enter them"


def test_a_stepped_run_builds_no_modes():
    report = run("toppling_stick", engine="impulse", step=1e-2).to_dict()
    assert report["built"] == {"modes": [], "unknowns": 5, "recognised": 3}
    assert any("guards" in entry["what"] for entry in report["left_out"])


def test_the_inventory_names_parts_that_were_not_built():
    left = {e["what"]: e["why"] for e in run("hopper", until=0.1).to_dict()["left_out"]}
    assert left["pin of sole"] == "not among its modes"
    assert "frictionless" in left["friction of sole"]
    left = {e["what"] for e in run("block_on_incline", until=0.1).to_dict()["left_out"]}
    assert "the angle of block" in left


def test_a_chart_reports_its_modes_too():
    report = run("bouncing_ball_chart", until=1).to_dict()
    assert [entry["mode"] for entry in report["built"]["modes"]] == [{"ball": "flight"}]
