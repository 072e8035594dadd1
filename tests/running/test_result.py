"""A result answers for itself: text, tables, data sets, instants, pictures."""

import json
from html.parser import HTMLParser

import numpy as np
import pytest

import statechart
from statechart import Result, StatechartError
from statechart.cli.main import main


@pytest.fixture(scope="module")
def result() -> Result:
    return statechart.run("toppling_stick")


def test_a_result_reads_as_the_command_line_prints_it(result, capsys):
    assert main(["run", "toppling_stick"]) == 0
    assert str(result) == repr(result) == capsys.readouterr().out


def test_events_and_samples_are_tables(result):
    assert list(result.events["cause"]) == ["slip", "reverse", "stop"]
    assert result.samples["t"].iloc[-1] == result.trace.t_end
    assert {"stick.angle", "tip.V", "mode"} <= set(result.samples.columns)


def test_times_of_a_data_set_are_unique_and_selectable(result):
    data = result.to_xarray()
    assert data.indexes["t"].is_unique
    slip = result.trace.jumps[0].t
    assert str(data.sel(t=slip)["mode"].item()) == "tip:slide-"  # after the jump
    assert float(data.sel(t=1.0, method="nearest")["t"]) == pytest.approx(1.0, abs=0.1)
    assert list(data["event_cause"].to_numpy()) == ["slip", "reverse", "stop"]


def test_reading_contains_mode_and_state(result):
    reading = result.at(result.trace.jumps[0].t)
    assert reading.mode == {"tip": "slide-"}
    assert reading.jumps == 1
    # Equation 9 of the paper's slip: the force is on the edge of its cone, H = mu V.
    assert abs(reading.values["tip.H"]) == pytest.approx(0.2 * reading.values["tip.V"], rel=1e-9)
    assert result.at(0.0).values["stick.angle"] == pytest.approx(-0.01)
    assert result.at(0.0).mode == {"tip": "pin"}


@pytest.mark.parametrize("t", [-1.0, 6.0, np.nan, np.inf])
def test_an_instant_outside_the_run_is_refused(result, t):
    with pytest.raises(StatechartError, match="in the run, which is from 0 to"):
        result.at(t)


def test_a_notebook_shows_the_moving_page(result):
    """The page is in one frame and cannot break out of it."""
    tags: list[str] = []
    parser = HTMLParser()
    parser.handle_starttag = lambda tag, attrs: tags.append(tag)  # type: ignore[method-assign]
    shown = result._repr_html_()
    parser.feed(shown)
    assert tags == ["iframe"]
    assert "critical_angle" in shown
    assert 'sandbox="allow-scripts"' in shown


def test_a_notebook_shows_the_scene_and_the_statechart_of_a_model():
    shown = statechart.load("toppling_stick")._repr_html_()
    assert shown.count("<svg") == 2
    assert "touchdown" in shown
    assert statechart.load("bouncing_ball_chart")._repr_html_().count("<svg") == 1


def shown(drawing):
    """Return the instants of the strip above the curves."""
    times = [ax.get_title(loc="left") for ax in drawing.axes]
    return [time for time in times if time.startswith("t = ")]


def test_plot_of_bodies_includes_a_film_strip(result, tmp_path):
    drawn = result.plot(tmp_path / "run.svg")
    assert len(shown(drawn)) == 5
    assert (tmp_path / "run.svg").read_text().startswith("<?xml")
    chart = statechart.run("bouncing_ball_chart").plot()
    assert shown(chart) == []


def test_a_diagram_shows_the_run_of_these_parameters(tmp_path):
    result = statechart.run("toppling_stick", parameters={"mu": 3.0})
    diagram = result.diagram(tmp_path / "stick.mmd")
    # With so much friction it slips forwards at the end, if at all.
    assert {node.name for node in diagram.nodes} == {key[0] for key in result.trace.modes}
    assert "slide-" not in {node.name for node in diagram.nodes}
    assert (tmp_path / "stick.mmd").exists()


def test_result_is_one_json_object(result):
    assert json.dumps(result.to_dict(), allow_nan=False)
    assert result.to_dict()["outcome"] == "STOPPED"


def test_a_wrong_name_of_an_output_lists_the_names(result):
    with pytest.raises(KeyError, match=r"no value is called .slip.; known: critical_angle, omega"):
        result.outputs["slip"]
    with pytest.raises(KeyError, match=r"no value is called .tip.F.; did you mean"):
        result.at(1.0).values["tip.F"]
