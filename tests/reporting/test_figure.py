import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex

import statechart
from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.diagram.build import build
from statechart.documents.yaml_reader import read_text
from statechart.engines.taylor import Taylor
from statechart.errors import StatechartError
from statechart.execution.simulator import Simulator
from statechart.loading.kind import kind
from statechart.loading.load import load
from statechart.observation.observer import Observer
from statechart.palette import region_colours, state_colours
from statechart.reporting.curves import curves
from statechart.reporting.figure import figure, regions_with_bands, render
from statechart.running.runner import Runner


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
    position, angle, velocity, turning, force, band = figure(observer, trace).axes
    assert {"stick.x", "stick.y"} == set(labels(position)) - {"_child0"}
    assert "stick.angle" in labels(angle)
    assert {"stick.dx", "stick.dy"} == set(labels(velocity)) - {"_child0"}
    assert "stick.dangle" in labels(turning)
    assert {"tip.V", "tip.H"} <= set(labels(force))
    assert {"pin", "slide-"} <= set(texts(band))
    assert texts(position) == ["tip.slip", "tip.reverse", "stop"]
    assert [ax.get_ylabel() for ax in (position, angle, force)] == [
        "position",
        "angle in rad",
        "force",
    ]
    lines = {str(line.get_label()): line for line in force.get_lines()}
    edge = next(line for name, line in lines.items() if name.endswith("cone"))
    np.testing.assert_allclose(edge.get_ydata(), 0.2 * lines["tip.V"].get_ydata())


def test_variables_of_a_chart_are_apart_by_their_units() -> None:
    chart = load(Path(__file__).parents[2] / "models" / "bouncing_ball_chart.yaml")
    made = kind("chart").automaton(chart)
    assert isinstance(made, Automaton)
    simulator = Simulator(made, Taylor(1e-12))
    trace = simulator.run(until=20.0)
    drawn = figure(Observer(simulator), trace)
    x, v, band = drawn.axes
    assert [ax.get_ylabel() for ax in (x, v)] == ["position in m", "velocity in m/s"]
    assert ("x" in labels(x), "v" in labels(v)) == (True, True)
    assert {"flight", "rest"} <= set(texts(band))
    height = next(line for line in x.get_lines() if line.get_label() == "x")
    # The ball rests from 8.6 on; the axis ends a little later, with a remark.
    assert 8.6 < band.get_xlim()[1] < 10.0
    assert band.get_xlabel() == "time in s; no change until the end at 20"
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


def drawn(text: str) -> tuple[Trace, list[object]]:
    """Return a run of a scene, and the axes of its figure."""
    result = Runner(read_text(text)).run()
    return result.trace, list(figure(result.observer, result.trace).axes)


MANY = """\
kind: scene
name: many
units: {length: m, time: s, mass: kg}
gravity: 9.81
bodies:
""" + "".join(f"  ball{k}: {{mass: 1, start: {{x: {k}, y: 1, dy: -1}}}}\n" for k in range(8))
MANY += "stop: {time: 1}\n"


def test_the_curves_that_move_most_are_drawn_and_the_others_named() -> None:
    _, (position, velocity, _) = drawn(MANY)
    names = [name for name in labels(position) if name.startswith("ball")]
    assert len(names) == 5
    assert all(name.endswith(".y") for name in names)
    legend = [text.get_text() for text in position.get_legend().get_texts()]  # type: ignore[attr-defined]
    words = " ".join(legend[-1].split())
    assert words == "not drawn: ball0.x, ball1.x, 9 more"
    assert position.get_ylabel() == "position in m"  # type: ignore[attr-defined]
    assert velocity.get_ylabel() == "velocity in m/s"  # type: ignore[attr-defined]


DROP = """\
kind: scene
name: drop
gravity: 9.81
bodies:
  ball: {mass: 2, start: {y: 0.5, dx: 1e-17}}
surfaces:
  floor: {height: 0}
contacts:
  tip: {point: {body: ball}, surface: floor, modes: [free, slide], friction: 0, restitution: E}
stop: {time: 0.5}
"""


FALLING = """\
kind: scene
name: falling
gravity: 9.81
bodies:
  big: {mass: 1, inertia: 1, shape: {disc: 0.4}, start: {x: -2, y: HEIGHT}}
  disc: {copies: 22, mass: 1, inertia: 1, shape: {disc: 0.4}, start: {x: index, y: 1}}
surfaces: {ground: {height: 0}}
collisions: {all: {bodies: [big, disc], surfaces: [ground], friction: 0.4, restitution: 0.2}}
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
"""


@pytest.mark.parametrize("height", [1, 100])
def test_similar_curves_are_represented_by_some_of_the_whole_range(height: int) -> None:
    runner = Runner(read_text(FALLING.replace("HEIGHT", str(height))))
    result = runner.run()
    _, panels = curves(result.observer, result.trace)
    # While the big one still falls, its speed is of their order.
    every = [n.rpartition(".")[0] for n in runner.automaton.names if n.endswith(".y")]
    spread = [every[k] for k in (0, 6, 11, 16, 22)]  # quarters of 22, half to even
    for panel in panels:
        if panel.title in ("position", "velocity"):
            assert [n.rpartition(".")[0] for n in panel.names] == spread
            assert len({n.rpartition(".")[2] for n in panel.names}) == 1
            assert not set(panel.names) & set(panel.left_out)
            assert len({*panel.names, *panel.left_out}) == 2 * len(every)
    (struck,) = (panel for panel in panels if panel.title == "impulse")
    hit = every if height == 1 else every[1:]
    last = len(hit) - 1
    assert list(struck.impulses) == [hit[round(k * last / 4)] for k in range(5)]


def test_gaps_of_contacts_that_change_are_drawn_first() -> None:
    result = Runner("rimless_wheel").run()
    _, panels = curves(result.observer, result.trace)
    (gaps,) = (panel for panel in panels if panel.title == "gap")
    rolled = {jump.region for jump in result.trace.jumps}
    assert len(gaps.names) == 5
    assert {name.removesuffix(".gap") for name in gaps.names} <= rolled
    # Contacts that stay off lose only their curve.
    assert {*gaps.names, *gaps.left_out} == {f"{r}.gap" for r in result.trace.regions}


def test_impulses_are_marked_on_the_axis_of_forces() -> None:
    trace, axes = drawn(DROP.replace("E}", "0}"))
    force = axes[-2]
    assert labels(force)[1] == "tip.V"  # no H, which is zero
    (marks,) = [line for line in force.get_lines() if "impulse" in str(line.get_label())]  # type: ignore[attr-defined]
    assert marks.get_xdata().tolist() == [jump.t for jump in trace.jumps if jump.impulse]
    assert marks.get_label() == f"impulse, up to {2 * math.sqrt(2 * 9.81 * 0.5):.3g}"


def test_impulses_without_forces_have_an_axis_of_their_own() -> None:
    trace, axes = drawn(DROP.replace("E}", "1}"))
    impulse = axes[-2]
    assert impulse.get_ylabel() == "impulse"  # type: ignore[attr-defined]
    (stems,) = [line for line in impulse.get_lines() if line.get_label() == "tip"]  # type: ignore[attr-defined]
    assert stems.get_xdata().tolist() == [jump.t for jump in trace.jumps]
    np.testing.assert_allclose(stems.get_ydata(), 4 * math.sqrt(2 * 9.81 * 0.5))


def test_round_off_of_zero_does_not_scale_an_axis() -> None:
    _, axes = drawn(DROP.replace("E}", "0}"))
    velocity = axes[1]
    lines = {str(line.get_label()): line for line in velocity.get_lines()}  # type: ignore[attr-defined]
    assert not lines["ball.dx"].get_ydata()[np.isfinite(lines["ball.dx"].get_ydata())].any()
    # Forces of rounding alone have no axis.
    text = DROP.replace("gravity: 9.81", "gravity: 0").replace("y: 0.5", "y: 0")
    _, axes = drawn(text.replace("E}", "0}").replace("free, ", "").replace(", restitution: 0", ""))
    assert "force" not in [ax.get_ylabel() for ax in axes]  # type: ignore[attr-defined]


def test_curves_that_stay_zero_have_no_axis_and_are_named() -> None:
    result = Runner("box_stack").run()
    _, panels = curves(result.observer, result.trace)
    (position,) = panels
    assert position.title == "position"
    names = {name for name in result.observer.automaton.names if name.endswith("angle")}
    assert names < set(position.zero)
    assert position.remarks[-1].startswith("0 all along: box0.")
    assert position.remarks[-1].endswith(f"{len(position.zero) - 2} more")


def test_regions_that_change_have_a_row() -> None:
    result = Runner("rimless_wheel").run()
    rows = [
        result.trace.regions[k] for k in regions_with_bands(result.observer.automaton, result.trace)
    ]
    assert rows == [f"s{k}" for k in range(8)]  # the others are off all the time
    band = figure(result.observer, result.trace).axes[-1]
    (said,) = [text.get_text() for text in band.get_legend().get_texts()]
    assert " ".join(said.split()) == "always off: s8, s9, 6 more"


@pytest.mark.parametrize("name", ["rimless_wheel", "woodpecker", "hopper"])
def test_figures_have_no_clipped_text_and_no_overlapping_legends(name: str) -> None:
    drawing = Runner(name).run().plot()
    outer, paper = drawing.get_tightbbox(), drawing.get_size_inches()  # both in inches
    assert outer.x0 >= 0.0
    assert outer.y0 >= 0.0
    assert outer.x1 <= paper[0]
    assert outer.y1 <= paper[1]
    legends = [ax.get_legend() for ax in drawing.axes]
    boxes = [legend.get_window_extent() for legend in legends if legend is not None]
    assert len(boxes) > 3
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])


ROD = """\
kind: scene
name: rod
gravity: 9.81
bodies: {rod: {mass: 1, inertia: L**2/12, start: {y: L, angle: 0.3}}}
parameters: {L: 1}
surfaces: {ground: {height: 0}}
contacts:
  one: {point: {body: rod, at: [-L/2, 0]}, surface: ground, friction: 0.4, restitution: 0.3}
  two: {point: {body: rod, at: [L/2, 0]}, surface: ground, friction: 0.4, restitution: 0.3}
stop: {time: 4*sqrt(L/9.81)}
"""


def test_panels_do_not_depend_on_the_unit_of_length() -> None:
    found = []
    for length in ("1e-6", "1", "1e5"):
        result = Runner(read_text(ROD.replace("L: 1", f"L: {length}"))).run()
        _, panels = curves(result.observer, result.trace)
        found.append([(panel.title, panel.names) for panel in panels])
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("name", ["sampled_balance", "rocking_block"])
def test_axis_labels_do_not_overlap(name: str) -> None:
    drawing = Runner(name).run().plot()
    drawing.draw_without_rendering()
    labelled = [ax.yaxis.label for ax in drawing.axes if ax.get_ylabel()]
    said = [label.get_window_extent().padded(3.0) for label in labelled]
    assert len(said) > 4
    for k, box in enumerate(said):
        assert not any(box.overlaps(other) for other in said[:k])


def test_figures_omit_timers_of_transitions() -> None:
    result = Runner("sampled_balance").run(until=0.1)
    timers = result.observer.automaton.declaration.timers
    assert timers == {"controller.sample_clock", "controller.sample_count"}
    _, panels = curves(result.observer, result.trace)
    reported = {name for p in panels for name in (*p.names, *p.left_out, *p.zero)}
    assert not reported & timers
    assert {"held", "sum"} <= reported


def test_a_controller_among_many_bodies_has_a_row() -> None:
    result = Runner("silo").run(until=0.1)
    assert len(result.trace.regions) == 152
    rows = [
        result.trace.regions[k] for k in regions_with_bands(result.observer.automaton, result.trace)
    ]
    assert len(rows) == 12
    assert rows[-1] == "valve"


def test_many_events_at_one_instant_are_named_once() -> None:
    result = Runner("box_stack").run()
    first = figure(result.observer, result.trace).axes[0]
    assert [text.get_text() for text in first.texts] == ["box0.touchdown and 4 more"]


def test_constant_curves_far_from_zero_are_drawn_first() -> None:
    result = Runner("box_stack").run()
    _, (position, *_) = curves(result.observer, result.trace)
    # Boxes of 0.1 m on each other, moved aside by 0.02 m each: the lowest is at 0 and 0.05 m.
    assert position.names == ("box1.y", "box2.y", "box3.y", "box4.x", "box4.y")


def test_impulses_have_a_unit_where_forces_have_the_axis() -> None:
    result = Runner("bouncing_ball").run()
    force = figure(result.observer, result.trace).axes[-2]
    assert labels(force)[-1] == f"impulse, up to {1.9 * math.sqrt(2 * 9.81):.3g} N s"


def test_powers_of_ten_stand_above_their_axes_and_below_others() -> None:
    result = Runner(read_text(DROP.replace("mass: 2", "mass: 2e9").replace("E}", "0}"))).run()
    drawing = figure(result.observer, result.trace)
    drawing.draw_without_rendering()
    axes = drawing.axes
    powers = [ax.yaxis.get_offset_text() for ax in axes]
    said = [k for k, power in enumerate(powers) if power.get_text()]
    assert said
    for k in said:
        assert powers[k].get_window_extent().y1 <= axes[k - 1].bbox.y0


def test_controllers_have_colours_of_their_own() -> None:
    contact, one, two = region_colours([("free", "pin"), ("on", "wait"), ("on", "wait")])
    assert contact["free"] == state_colours(["free"])["free"]
    assert len({*one.values(), *two.values(), *contact.values()}) == 6


def test_a_controller_has_the_same_colours_in_every_picture(tmp_path: Path) -> None:
    result = Runner("simplest_walker").run()
    legs, foot = result.observer.automaton.colours.values()
    apart = {legs["walking"], foot["above"], foot["below"]}
    assert len(apart) == 3
    charts = build(result.observer.automaton, result.trace.start_mode, result.trace).charts
    drawn = {colour for chart in charts for node in chart.nodes for colour in node.colours}
    assert drawn == {*foot.values()}
    page = result.report(tmp_path / "page.html").read_text(encoding="utf-8")
    assert apart <= set(re.findall(r"#[0-9A-F]{6}", page))


def test_a_legend_names_the_region_of_a_state_that_two_regions_colour_differently() -> None:
    """The bars of `locked` are too short for its name, and each coupling has its own colour."""
    body = {"mass": 1, "inertia": 1, "start": {"dangle": 3}}
    scene = Scene.model_validate({
        "name": "two_brakes",
        "bodies": {"a": body, "b": body},
        "couplings": {f"brake_{name}": {"bodies": [name], "limit": 1} for name in ("a", "b")},
        "stop": {"time": 3.01},
    })  # fmt: skip
    result = Runner(scene).run()
    colours, axes = result.observer.automaton.colours, figure(result.observer, result.trace).axes
    legend = axes[-1].get_legend()
    shown = {
        text.get_text(): to_hex(patch.get_facecolor()).upper()
        for text, patch in zip(legend.get_texts(), legend.get_patches(), strict=True)
    }
    assert shown == {f"{name} locked": colours[name]["locked"] for name in ("brake_a", "brake_b")}


def test_an_empty_run_can_be_drawn(observer: Observer) -> None:
    trace = observer.simulator.run(until=0.0)
    assert render(figure(observer, trace), "png").startswith(b"\x89PNG")


def test_figure_files_follow_the_suffix_and_are_reproducible(
    observer: Observer, trace: Trace, tmp_path: Path
) -> None:
    for name, begin in (("a.svg", b"<?xml"), ("a.pdf", b"%PDF"), ("a.png", b"\x89PNG")):
        figure(observer, trace, tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(begin)
    figure(observer, trace, tmp_path / "b.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_unknown_suffix_or_folder_is_an_error(
    observer: Observer, trace: Trace, tmp_path: Path
) -> None:
    with pytest.raises(StatechartError, match="svg, png or pdf"):
        figure(observer, trace, tmp_path / "a.docx")
    with pytest.raises(StatechartError, match="cannot write"):
        figure(observer, trace, tmp_path / "missing" / "a.svg")


def test_couples_of_couplings_are_drawn_by_their_dimension() -> None:
    wheel = {"mass": 1, "inertia": 1, "start": {"dangle": 3}}
    scene = Scene(
        name="brakes",
        bodies={"a": wheel, "b": {"mass": 1, "start": {"dx": 2}}},
        joints={"rail": {"point": {"body": "b"}, "to": {"y": 0}}},
        couplings={"brake": {"bodies": ["a"], "limit": 2}, "shoe": {"joint": "rail", "limit": 4}},
        stop={"time": 2},
    )
    result = statechart.run(scene)
    samples, panels = curves(result.observer, result.trace)
    drawn = {panel.title: panel.names for panel in panels}
    assert (drawn["moment"], drawn["force"]) == (("brake.M",), ("shoe.M",))
    assert samples.columns["brake.M"][0] == -2.0
