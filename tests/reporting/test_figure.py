import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.engines.taylor import Taylor
from statechart.errors import StatechartError
from statechart.execution.simulator import Simulator
from statechart.loading.kind import kind
from statechart.loading.load import load
from statechart.observation.observer import Observer
from statechart.reporting.figure import figure, render


@pytest.fixture(scope="module")
def observer() -> Observer:
    scene = load(Path(__file__).parents[2] / "models" / "toppling_stick.yaml")
    assert isinstance(scene, Scene)
    return Observer(Simulator(automaton(scene), Taylor(2.2e-16)))


@pytest.fixture(scope="module")
def trace(observer: Observer) -> Trace:
    return observer.simulator.run(until=1000.0)


def labels(axes: object) -> list[str]:
    return [str(line.get_label()) for line in axes.get_lines()]  # type: ignore[attr-defined]


def texts(axes: object) -> list[str]:
    return [text.get_text() for text in axes.texts]  # type: ignore[attr-defined]


def test_panels_show_states_forces_with_the_cone_and_modes(
    observer: Observer, trace: Trace
) -> None:
    position, velocity, force, band = figure(observer, trace).axes
    assert {"stick.x", "stick.y", "stick.angle"} <= set(labels(position))
    assert {"stick.dx", "stick.dy", "stick.dangle"} <= set(labels(velocity))
    assert {"tip.V", "tip.H"} <= set(labels(force))
    assert {"pin", "slide-"} <= set(texts(band))
    assert texts(position) == ["slip", "reverse", "stop"]
    lines = {str(line.get_label()): line for line in force.get_lines()}
    edge = next(line for name, line in lines.items() if name.endswith("cone"))
    np.testing.assert_allclose(edge.get_ydata(), 0.2 * lines["tip.V"].get_ydata())


def test_a_chart_of_few_variables_has_a_panel_each() -> None:
    chart = load(Path(__file__).parents[2] / "models" / "bouncing_ball_chart.yaml")
    made = kind("chart").automaton(chart)
    assert isinstance(made, Automaton)
    simulator = Simulator(made, Taylor(1e-12))
    trace = simulator.run(until=20.0)
    x, v, band = figure(Observer(simulator), trace).axes
    assert ("x" in labels(x), "v" in labels(v)) == (True, True)
    assert {"flight", "rest"} <= set(texts(band))
    height = next(line for line in x.get_lines() if line.get_label() == "x")
    # Broken at every bounce, and nowhere else.
    assert np.isnan(height.get_ydata()).sum() == len({jump.j for jump in trace.jumps})


def test_every_state_of_the_band_is_named(observer: Observer, trace: Trace) -> None:
    band = figure(observer, trace).axes[-1]
    legend = band.get_legend()
    named = set(texts(band)) | {text.get_text() for text in legend.get_texts()}
    assert {"pin", "slide-", "slide+"} <= named


@pytest.mark.parametrize("mu", [0.0, math.inf, 1e6])
def test_extreme_friction_keeps_the_force_in_view(observer: Observer, mu: float) -> None:
    trace = observer.simulator.run({"mu": mu, "I_G": 0.0}, until=1000.0)
    force = figure(observer, trace).axes[-2]
    low, high = force.get_ylim()
    assert -25.0 < low < 0.0 < high < 25.0


def test_modes_of_no_duration_are_marked(observer: Observer, trace: Trace) -> None:
    # As in a reversal with a pin phase of zero duration: slide-, pin, slide+ at one instant.
    slip, reverse, stop = trace.jumps
    stick = replace(reverse, cause="stick", target=("pin",))
    again = replace(reverse, cause="slip", j=2, source=("pin",))
    first, second, third = trace.arcs
    passing = replace(
        trace,
        jumps=(slip, stick, again, replace(stop, j=3)),
        arcs=(first, second, replace(third, j=3)),
    )
    band = figure(observer, passing).axes[-1]
    (marks,) = [line for line in band.get_lines() if str(line.get_label()).startswith("pin")]
    assert marks.get_xdata().tolist() == [reverse.t]


def test_an_empty_run_can_be_drawn(observer: Observer) -> None:
    trace = observer.simulator.run(until=0.0)
    assert render(figure(observer, trace), "png").startswith(b"\x89PNG")


def test_files_are_by_suffix_and_the_same_each_time(
    observer: Observer, trace: Trace, tmp_path: Path
) -> None:
    for name, begin in (("a.svg", b"<?xml"), ("a.pdf", b"%PDF"), ("a.png", b"\x89PNG")):
        figure(observer, trace, tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(begin)
    figure(observer, trace, tmp_path / "b.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_another_suffix_or_place_is_an_error(
    observer: Observer, trace: Trace, tmp_path: Path
) -> None:
    with pytest.raises(StatechartError, match="svg, png or pdf"):
        figure(observer, trace, tmp_path / "a.docx")
    with pytest.raises(StatechartError, match="cannot write"):
        figure(observer, trace, tmp_path / "missing" / "a.svg")
