import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.trace import Trace
from statechart.documents.yaml_reader import read_text
from statechart.engines.taylor import Taylor
from statechart.errors import FormulaError
from statechart.execution.simulator import Simulator
from statechart.loading.load import load
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs, extremes, outputs_of
from statechart.reporting import report as reporting
from statechart.reporting.report import Computation, report
from statechart.running.runner import Runner

MODELS = Path(__file__).parents[2] / "models"
GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "toppling_stick.json").read_text())


@pytest.fixture(scope="module")
def stick() -> Observer:
    scene = load(MODELS / "toppling_stick.yaml")
    assert isinstance(scene, Scene)
    return Observer(Simulator(automaton(scene), Taylor(2.2e-16)))


def run(observer: Observer, until: float = 1000.0, **parameters: float) -> Trace:
    return observer.simulator.run(parameters, until=until)


def declaring(observer: Observer, declared: dict[str, dict[str, object]]) -> Outputs:
    """The stick with other outputs than its file declares."""
    data = observer.automaton.declaration.model_dump(by_alias=True, exclude_unset=True)
    scene = Scene.model_validate({**data, "outputs": declared})
    other = replace(observer.automaton, declaration=scene)
    return Outputs(Observer(Simulator(other, observer.simulator.engine)))


@pytest.mark.parametrize("cell", GOLDEN["cells"], ids=lambda c: f"mu={c['mu']}-I={c['I_G_str']}")
def test_declared_outputs_match_golden(stick: Observer, cell: dict[str, float]) -> None:
    trace = run(stick, mu=cell["mu"], I_G=cell["I_G"], theta0=cell["theta0"])
    found = outputs_of(stick).of(trace)
    critical = cell["critical_angle_rad"]
    assert found["critical_angle"] == (
        None if critical is None else pytest.approx(critical, abs=1e-10)
    )
    for name in ("slip_backward", "slip_forward", "omega_impact", "t_impact"):
        assert found[name] == pytest.approx(cell[name], abs=1e-11), name


def test_outputs_give_values_counts_and_lists(stick: Observer) -> None:
    trace = run(stick)
    ready = declaring(
        stick,
        {
            "start": {"value": "-stick.angle", "at": "start"},
            "slips": {"count": "slip"},
            "slips_here": {"count": "tip.slip"},
            "liftoffs": {"count": "liftoff"},
            "ends": {"count": "stop"},
            "never": {"value": "time", "at": "last liftoff"},
            "each": {"value": "time", "at": "each tip.reverse"},
            "each_never": {"value": "time", "at": "each liftoff"},
            "first_two": {"value": "time", "at": "first 2 slip or reverse or stop"},
            "last_two": {"value": "time", "at": "last 2 slip or reverse or stop"},
            "last_many": {"value": "time", "at": "last 100 slip or reverse or stop"},
            "last_never": {"value": "time", "at": "last 3 liftoff"},
        },
    )
    found = ready.of(trace)
    assert list(found) == [
        "start",
        "slips",
        "slips_here",
        "liftoffs",
        "ends",
        "never",
        "each",
        "each_never",
        "first_two",
        "last_two",
        "last_many",
        "last_never",
    ]
    assert found["start"] == pytest.approx(0.01, abs=1e-15)
    assert (found["slips"], found["slips_here"], found["liftoffs"], found["ends"]) == (1, 1, 0, 1)
    assert found["never"] is None
    assert found["each"] == [trace.jumps[1].t]
    assert found["each_never"] == []
    times = [jump.t for jump in trace.jumps]
    assert len(times) == 3
    assert found["first_two"] == times[:2]
    assert found["last_two"] == times[-2:]
    assert found["last_many"] == times
    assert found["last_never"] == []


def test_forces_before_and_after_a_jump_are_those_of_the_modes_left_and_entered(
    stick: Observer,
) -> None:
    trace = run(stick)
    reverse = trace.jumps[1]
    assert reverse.cause == "reverse"
    (left,) = stick.at(trace, ["tip.H / tip.V"], [reverse], before=True)
    (entered,) = stick.at(trace, ["tip.H / tip.V"], [reverse])
    assert left == pytest.approx(0.2, abs=1e-14)
    assert entered == pytest.approx(-0.2, abs=1e-14)
    # A stop changes nothing: the mode goes on.
    assert stick.final(trace, ["tip.H / tip.V"]) == pytest.approx(-0.2, abs=1e-14)
    assert stick.initial(trace, ["tip.V"])[0] == pytest.approx(1.0, abs=2e-4)


def test_integral_of_power_is_work(stick: Observer) -> None:
    trace = run(stick)
    ready = declaring(stick, {"work": {"integral": "tip.H * tip.slip"}})
    work = ready.of(trace)["work"]
    energy = stick.final(trace, ["energy"])[0] - stick.initial(trace, ["energy"])[0]
    assert work < -0.01
    assert work == pytest.approx(energy, abs=1e-13)


def test_states_are_matched_by_their_declared_name_too(stick: Observer) -> None:
    trace = run(stick)
    states = {"slide": "slide", "pin": "pin", "backward": "slide-", "forward": "slide+"}
    declared: dict[str, dict[str, object]] = {
        name: {"integral": "1", "during": {"tip": state}} for name, state in states.items()
    }
    found = declaring(stick, {"time": {"integral": "1"}, **declared}).of(trace)
    time, slide, pin, backward, forward = (found[name] for name in ("time", *states))
    assert time == pytest.approx(trace.t_end, abs=1e-14)
    assert pin == pytest.approx(trace.jumps[0].t, abs=1e-14)
    assert slide == pytest.approx(backward + forward, abs=1e-14)
    assert slide == pytest.approx(time - pin, abs=1e-14)


def test_extremes_inside_steps_are_located_to_round_off(stick: Observer) -> None:
    trace = run(stick)
    # Constructed extremes, sharper than the grid: 1 at time 1.2345, -1 at time 4.321.
    for centre, sign in ((1.2345, 1.0), (4.321, -1.0)):
        least, greatest = extremes(stick, trace, f"{sign} / (1 + (10 * (time - {centre}))**2)")
        assert (greatest if sign > 0 else -least) == pytest.approx(1.0, abs=1e-14)
    least, greatest = extremes(stick, trace, "stick.y")
    assert greatest == pytest.approx(math.cos(0.01), abs=1e-15)
    assert least == pytest.approx(0.0, abs=1e-15)


def test_samples_cover_the_run_with_two_rows_at_a_jump(stick: Observer) -> None:
    trace = run(stick)
    samples = stick.sample(trace, ["stick.angle", "tip.V", "tip.gap"])
    assert samples.t[0] == 0.0
    assert samples.t[-1] == trace.t_end
    assert (np.diff(samples.t) >= 0.0).all()
    assert np.unique(samples.t[np.flatnonzero(np.diff(samples.j))]).tolist() == [
        jump.t for jump in trace.jumps[:2]
    ]
    assert [samples.modes[k][0] for k in np.unique(samples.mode)] == ["pin", "slide-", "slide+"]
    assert (samples.columns["tip.V"] > 0.0).all()
    assert np.abs(samples.columns["tip.gap"]).max() < 1e-12


def test_samples_at_the_time_of_a_jump_are_those_after_it(stick: Observer) -> None:
    trace = run(stick)
    times = np.array([0.0, 1.0, trace.jumps[1].t, trace.t_end])
    samples = stick.sample(trace, ["tip.H"], times=times)
    np.testing.assert_allclose(samples.t, times, rtol=0.0, atol=1e-15)
    assert [samples.modes[k][0] for k in samples.mode] == ["pin", "pin", "slide+", "slide+"]
    assert samples.columns["tip.H"][2] < 0.0
    with pytest.raises(ValueError, match="in the run"):
        stick.sample(trace, ["tip.H"], times=[trace.t_end + 1.0])


def test_empty_run_has_its_initial_state(stick: Observer) -> None:
    trace = run(stick, until=0.0)
    found = outputs_of(stick).of(trace)
    assert found["critical_angle"] is None
    assert (found["slip_backward"], found["t_impact"]) == (0.0, 0.0)
    samples = stick.sample(trace)
    assert samples.t.tolist() == [0.0]
    assert samples.columns["stick.angle"].tolist() == [-0.01]
    assert samples.columns["tip.V"][0] == pytest.approx(1.0, abs=2e-4)
    assert extremes(stick, trace, "stick.angle") == (-0.01, -0.01)


def test_forces_of_a_mode_of_no_duration_need_no_compilation(stick: Observer) -> None:
    trace = run(stick)
    built = stick.simulator.modes.built
    passed = replace(trace.jumps[0], target=("free",))
    changed = replace(trace, jumps=(passed, *trace.jumps[1:]))
    assert stick.at(changed, ["tip.V", "stick.y"], [passed])[0].tolist() == [0.0, passed.after[1]]
    assert stick.simulator.modes.built == built


def test_an_unknown_name_is_an_error_that_suggests(stick: Observer) -> None:
    trace = run(stick)
    with pytest.raises(FormulaError, match=r"stick\.angle"):
        stick.sample(trace, ["stick.angel"])


def test_report_is_strict_json_with_full_precision(stick: Observer) -> None:
    trace = run(stick, mu=math.inf, I_G=0.0)
    made = report(stick, trace, Computation(timings={"run": 0.5}))
    read = json.loads(json.dumps(made, allow_nan=False))
    assert read == made
    assert float(read["parameters"]["mu"]) == math.inf
    assert read["outcome"] == "STOPPED"
    assert (read["modes_total"], read["modes_declared"]) == (4, 3)
    assert read["events"][0]["t"] == trace.jumps[0].t
    assert set(read["events"][0]["from"]) == {"tip"}
    assert read["final"]["stick.angle"] == trace.final[2]
    # Equation 11: a pinned point mass lifts its tip's force to zero at acos(2/3).
    assert read["outputs"]["critical_angle"] == pytest.approx(math.acos(2 / 3), abs=1e-10)


def test_margins_are_the_least_values_of_their_modes(stick: Observer) -> None:
    trace = run(stick)
    margins = report(stick, trace)["margins"]
    assert margins["fallen"] == pytest.approx(0.0, abs=1e-15)
    assert margins["fallen backward"] == pytest.approx(math.pi / 2 + 0.01, abs=1e-14)
    samples = stick.sample(trace, ["tip.V", "tip.H"], per_step=16)
    distance = (0.2 * samples.columns["tip.V"] + samples.columns["tip.H"])[samples.j == 0]
    assert margins["tip.mu V + H"] == pytest.approx(distance.min(), abs=1e-13)
    assert -1e-11 < margins["tip.mu V - H"] <= 0.0
    assert margins["tip.V"] == pytest.approx(samples.columns["tip.V"].min(), abs=1e-13)


def test_margins_of_forces_are_forces_with_events_and_by_steps() -> None:
    """A block on a slope slides and stops: V = m g cos, and mu V -+ H = m g (mu cos -+ sin)."""
    block = {
        "kind": "scene", "name": "block", "gravity": 10.0, "parameters": {"mu": 0.75},
        "bodies": {"block": {"mass": 2.0, "start": {"dx": 0.8, "dy": 0.6}}},
        "surfaces": {"slope": {"line": [[0, 0], [4, 3]]}},
        "contacts": {"base": {
            "point": {"body": "block"}, "surface": "slope", "modes": ["slide", "pin"],
            "friction": "mu + 0.25",
        }},
        "stop": {"time": 1.0},
    }  # fmt: skip
    runner = Runner(Scene.model_validate(block))
    result = runner.run()
    (stop,) = result.to_dict(explain=True)["events"]
    assert stop["margins"] == {"base.V": pytest.approx(16.0), "base.slip": pytest.approx(0.0)}
    margins = result.to_dict()["margins"]
    assert margins["base.V"] == pytest.approx(16.0)
    assert margins["base.mu V + H"] == pytest.approx(16.0 + 12.0)
    assert margins["base.mu V - H"] == pytest.approx(16.0 - 12.0)
    stepped = Runner(runner.model, engine="impulse", step=1e-3).run().to_dict()["margins"]
    assert stepped["base.V"] == pytest.approx(16.0)
    # Infinite friction has no edges at a finite distance.
    rough = runner.run({"mu": math.inf}).to_dict()["margins"]
    assert rough["base.V"] == pytest.approx(16.0)
    assert not any("mu V" in name for name in rough)


def test_margins_without_a_value_are_reported(
    stick: Observer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Infinite friction alone leaves out a margin, not a value that is nan."""
    trace = run(stick)
    lowest = reporting.lowest

    def without_values(*arguments: Any) -> NDArray[np.float64]:
        found = lowest(*arguments)
        found[: len(found) // 2] = math.nan
        return found

    before = set(reporting.margins(stick, trace))
    monkeypatch.setattr(reporting, "lowest", without_values)
    found = reporting.margins(stick, trace)
    assert "tip.mu V - H" in before
    assert set(found) == before
    assert all(map(math.isnan, found.values()))


def test_outputs_that_are_nan_are_named_in_a_warning() -> None:
    text = """
kind: scene
name: rooted
parameters: {x0: 1}
bodies: {b: {mass: 1, start: {x: x0}}}
stop: {time: 1}
outputs: {root: {value: sqrt(b.x)}, way: {value: b.x}, largest: {maximum: log(b.x)}}
"""
    runner = Runner(read_text(text))
    for start, named in ((1.0, 0), (-1.0, 1)):
        result = runner.run({"x0": start})
        reported = result.to_dict()["warnings"]
        for warnings in (result.warnings, reported):
            assert sum("outputs root, largest" in warning for warning in warnings) == named


def test_output_scale_is_the_running_maximum() -> None:
    scene = load(MODELS / "stick_slip_block.yaml")
    assert isinstance(scene, Scene)
    block = Observer(Simulator(automaton(scene), Taylor(2.2e-16)))
    trace = run(block, until=12.0)
    made = Outputs(block)
    values, sizes = made.of(trace), made.scales(trace).outputs
    # The block has moved farther before it returns towards its start.
    assert sizes["t_first_slip"] == values["t_first_slip"] == trace.jumps[0].t
    places = [abs(float(jump.after[0])) for jump in trace.jumps]
    assert sizes["x_end"] == max(*places, abs(float(trace.final[0])))
