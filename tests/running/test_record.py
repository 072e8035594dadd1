"""Recording policies: outputs with identical bits, and errors that name the missing data."""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np
import pytest
import xarray as xr
from runs import MODELS, automaton

from contacts.time_stepping import recorder
from statechart.automaton.trace import Arc, Outcome
from statechart.documents.setting import Setting
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, StatechartError
from statechart.loading.kind import kind
from statechart.loading.load import interpret
from statechart.observation.observers import Observers
from statechart.observation.outputs import Outputs
from statechart.reporting.run_store import write_store
from statechart.running.runner import Runner

KINDS = ("modes", "poses", "nothing")
# All but charts, couplings, and controllers beside contacts that remember: steps do not carry what
# these do.
STEPPED = [
    name
    for name, model in MODELS.items()
    if model.kind == "scene"
    and not model.couplings
    and (model.collisions or not any(region.variables for region in model.regions.values()))
]
# Number of steps of each model.
STEPS = 200

BALL = """
kind: scene
name: thrown
parameters: {mu: 0.01}
gravity: 9.81
bodies:
  ball: {mass: 1, inertia: 0.004, shape: {disc: 0.1}, start: {y: 0.5, dx: 1}}
surfaces: {floor: {height: 0}}
contacts:
  rim: {point: {body: ball, at: [0, 0]}, surface: floor, modes: [free, slide, pin], friction: mu,
    restitution: 0.6}
stop: {time: 3, conditions: {far: ball.x > 1.4}}
outputs:
  heights: {value: ball.y, at: each rim.touchdown}
  speeds: {value: ball.dy, at: first 2 rim.touchdown, before: true}
  last: {value: rim.V, at: last rim.liftoff}
  lasts: {value: rim.V, at: last 2 rim.jam or rim.touchdown, before: true}
  hits: {count: touchdown}
  never: {value: time, at: first rim.reverse}
  pressed: {integral: rim.V}
  flown: {integral: ball.y, during: {rim: free}}
  most: {maximum: rim.V}
  lowest: {minimum: ball.y}
  first: {value: rim.V, at: start}
  end: {value: rim.V}
settings: {engine: impulse, step: 1e-3}
"""

HEAP = """
kind: scene
name: pushed
parameters: {F: 6}
gravity: 9.81
bodies:
  box: {mass: 2, inertia: 0.1, start: {y: 0.1},
    shape: {polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}}
  ball: {copies: 3, mass: 1, inertia: 0.02, start: {x: 0.5 + 0.3*index, y: 0.15 + 0.1*index},
    shape: {disc: 0.1}}
surfaces: {ground: {height: 0}}
collisions:
  all: {bodies: [box, ball], surfaces: [ground], friction: 0.3, restitution: 0.4}
controls: {push: 0}
regions:
  hand:
    initial: wait
    states: {wait: {sets: {push: 0}}, act: {sets: {push: F}}}
    transitions:
      - {name: begin, from: wait, to: act, guard: time > 0.1}
      - {name: hit, from: act, to: wait, on: ball2.touchdown}
forces: {push: {body: box, force: [push, 0], at: [0, 0]}}
stop: {time: 1}
outputs:
  hits: {value: box.x, at: each box.touchdown or ball0.touchdown}
  begun: {value: ball1.y, at: first hand.begin}
  worked: {integral: box.dx**2}
  settings: {integral: time, during: {hand: act}}
settings: {engine: impulse, step: 1e-3}
"""


def runs(built, step, until, tolerance=None):
    observers = Observers(built)
    found = []
    for record in KINDS:
        observer = observers.at(
            Setting("impulse", step=step, impulse_tolerance=tolerance, record=record)
        )
        trace = observer.simulator.run({}, until=until, throw=False)
        found.append((observer, trace, Outputs(observer).of(trace)))
    return found


def assert_alike(found):
    (_, whole, outputs), *others = found
    for _, trace, others_outputs in others:
        # Compared as text, since unknown values are NaN.
        assert repr(others_outputs) == repr(outputs)
        assert trace.final.tolist() == whole.final.tolist()
        assert (trace.t_end, trace.outcome, trace.counts) == (
            whole.t_end,
            whole.outcome,
            whole.counts,
        )


@pytest.mark.parametrize("name", STEPPED)
def test_outputs_of_all_models_are_the_same_to_the_bit(name):
    declared = MODELS[name].settings
    step = declared.step or 1e-3
    assert_alike(runs(automaton(name), step, STEPS * step, declared.impulse_tolerance))


def built(text):
    scene = interpret(read_text(text))
    return kind(scene.kind).automaton(scene)


def test_outputs_of_every_kind_are_the_same_to_the_bit():
    found = runs(built(BALL), 1e-3, 3.0)
    assert_alike(found)
    outputs = found[0][2]
    assert len(outputs["heights"]) > 3
    assert len(outputs["lasts"]) == 2
    assert outputs["never"] is None
    assert outputs["flown"] > 0.0
    assert found[0][1].outcome.name == "STOPPED"


@pytest.mark.parametrize(
    "asked", ["", "outputs: {height: {value: ball.y}, speed: {value: ball.dy}}"]
)
def test_outputs_at_the_ends_build_no_intermediate_arcs(asked, monkeypatch):
    text = BALL.partition("outputs:")[0] + asked + "\nsettings: {engine: impulse, step: 1e-3}"
    made = []

    def counted(*values):
        made.append(values)
        return Arc(*values)

    monkeypatch.setattr(recorder, "Arc", counted)
    thrown = built(text)
    found = runs(thrown, 1e-3, 3.0)
    assert found[0][1].outcome is Outcome.STOPPED
    assert_alike(found)
    made.clear()
    Observers(thrown).at(Setting("impulse", step=1e-3, record="nothing")).simulator.run(
        {}, until=3.0
    )
    # Only the last step of each chunk of 512, in which the run may stop.
    assert sum(len(values[4]) - 1 for values in made) <= 2 * 3


def test_the_recording_policy_does_not_change_controllers():
    found = runs(built(HEAP), 1e-3, 1.0)
    assert_alike(found)
    poses = found[1][1]
    assert poses.regions == ("hand",)
    assert [jump.cause for jump in poses.jumps[:2]] == ["begin", "hit"]
    modes = [mode for mode, _ in groupby(arc.mode for arc in poses.arcs)]
    assert modes[:2] == [("wait",), ("act",)]
    assert found[0][2]["begun"] is not None


@pytest.mark.parametrize("text", [BALL, HEAP])
def test_poses_are_those_of_the_run(text):
    (whole, modes, _), (observer, poses, _), _ = runs(built(text), 1e-3, 3.0)
    names = observer.automaton.names
    # Between impacts, which poses have in the middles of their steps, too.
    times = np.linspace(0.0, poses.t_end, 1013)
    one = whole.sample(modes, names, times=times)
    other = observer.sample(poses, names, times=times)
    assert other.t == pytest.approx(one.t, abs=1e-12)
    for name in names:
        assert other.columns[name] == pytest.approx(one.columns[name], abs=1e-9)
    assert sum(arc.duration for arc in poses.arcs) == pytest.approx(poses.t_end, rel=1e-12)


def test_a_stop_within_a_step_ends_the_poses_there():
    _, (_, poses, _), _ = runs(built(BALL), 1e-2, 3.0)
    last = poses.arcs[-1]
    assert last.end.high == pytest.approx(poses.t_end, abs=1e-12)
    assert last.states(np.array([last.duration]))[0] == pytest.approx(poses.final, abs=1e-9)


def test_missing_recordings_are_refused_with_the_option_to_set(tmp_path):
    nothing = Runner(interpret(read_text(HEAP)), record="nothing").run(until=0.2)
    for ask in (
        lambda: nothing.samples,
        lambda: nothing.at(0.1),
        nothing.to_xarray,
        nothing.plot,
        lambda: nothing.animate(tmp_path / "film.gif"),
        lambda: nothing.report(tmp_path / "page.html"),
    ):
        with pytest.raises(StatechartError, match="--record poses"):
            ask()
    poses = Runner(interpret(read_text(HEAP)), record="poses").run(until=0.2)
    for result in (nothing, poses):
        assert result.events is not None
        assert "modes of contacts and their events" in repr(result.to_dict()["left_out"])
        with pytest.raises(StatechartError, match="--record modes"):
            result.diagram()
    reading = poses.at(0.15)
    assert reading.mode == {"hand": "act"}
    assert math.isfinite(reading.values["box.x"])


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"record": "pose"}, "poses"),
        ({"record": "poses", "accuracy": 1e-2}, "an accuracy needs the events"),
        ({"record": "poses", "engine": "scipy"}, "the engine scipy always records modes"),
    ],
)
def test_unsupported_recording_is_refused_with_the_reason(asked, words):
    with pytest.raises(DeclarationError) as caught:
        Runner(interpret(read_text(BALL)), **asked)
    assert words in str(caught.value)


def test_modes_are_drawn_with_every_recording_policy():
    scene = interpret(read_text(BALL.replace("step: 1e-3", "step: 1e-3, record: nothing")))
    runner = Runner(scene)
    assert not runner.run().trace.arcs
    assert len(runner.with_modes().run().trace.jumps) > 3
    assert Runner(scene, accuracy=0.3).setting.record == "modes"


def test_a_store_has_the_states_of_all_steps(tmp_path):
    result = Runner(interpret(read_text(HEAP)), record="poses").run(until=0.2)
    write_store(tmp_path / "run.zarr", result.observer, result.trace, result.to_dict())
    with xr.open_zarr(tmp_path / "run.zarr") as data:
        assert data.body.values.tolist() == ["box", "ball0", "ball1", "ball2"]
        assert data.event_cause.values.tolist() == [jump.cause for jump in result.trace.jumps]
        times = data.t.values
        assert (times[0], times[-1]) == (0.0, result.trace.t_end)
        for name in ("box.x", "ball2.dy"):
            body, part = name.split(".")
            column = data[part].sel(body=body).values
            place = result.trace.variables.index(name)
            assert (column[0], column[-1]) == (
                result.trace.initial[place],
                result.trace.final[place],
            )
            at = [reading.values[name] for reading in map(result.at, times[::17].tolist())]
            assert column[::17] == pytest.approx(at, abs=1e-12)
    with pytest.raises(StatechartError, match="something of this name"):
        write_store(tmp_path / "run.zarr", result.observer, result.trace, {})


def test_a_notebook_shows_a_run_without_recording() -> None:
    result = Runner(read_text(BALL), record="nothing").run()
    shown = result._repr_html_()
    assert "lowest" in shown
    assert "the run recorded no states between its start and its end" in shown
    assert "<iframe" not in shown
