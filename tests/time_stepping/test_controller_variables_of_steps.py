"""State of controllers by steps, against the same scene by events."""

from __future__ import annotations

import numpy as np
import pytest

from contacts.time_stepping import stepper
from contacts.time_stepping.scene_stepper import SteppedScene
from statechart.automaton.trace import Trace
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

# A winch winds up a spring until the block on its other end slides, and stops; it adds up where
# the block is, and filters its speed.
TOWED = """
kind: scene
name: towed
parameters: {m: 1, k: 60, speed: 0.5, T: 0.9, mu: 0.4, tau: 0.05}
gravity: 9.81
bodies:
  block: {mass: m, inertia: 0.02*m}
surfaces: {ground: {height: 0}}
contacts:
  a: {point: {body: block, at: [-0.1, 0]}, surface: ground, friction: mu, restitution: 0}
  b: {point: {body: block, at: [0.1, 0]}, surface: ground, friction: mu, restitution: 0}
controls: {pull: 0}
forces: {tow: {body: block, force: [pull, 0]}}
regions:
  winch:
    variables: {end: 0, way: 0, quick: 0, most: 0}
    initial: winds
    states:
      winds:
        sets: {pull: k*(end - block.x)}
        flows: {end: speed, way: block.x, quick: (block.dx - quick)/tau}
      stands:
        sets: {pull: k*(end - block.x)}
        flows: {way: block.x, quick: (block.dx - quick)/tau}
    transitions:
      - {name: stop, from: winds, to: stands, after: T, updates: {most: block.dx}}
stop: {time: 1.5}
outputs:
  way: {value: way}
  quick: {value: quick, at: first winch.stop}
"""
# The same force is on for a hundredth of a second, and off.
PULSES = """
kind: scene
name: pulses
parameters: {m: 1, F: 5, T: 0.01}
gravity: 9.81
bodies:
  block: {mass: m, inertia: 0.02*m}
surfaces: {ground: {height: 0}}
contacts:
  a: {point: {body: block, at: [-0.1, 0]}, surface: ground, friction: 0.3, restitution: 0}
  b: {point: {body: block, at: [0.1, 0]}, surface: ground, friction: 0.3, restitution: 0}
controls: {u: 0}
forces: {push: {body: block, force: [u, 0]}}
regions:
  pulse:
    initial: pause
    states: {pause: {sets: {u: 0}}, push: {sets: {u: F}}}
    transitions:
      - {name: start, from: pause, to: push, after: T}
      - {name: end, from: push, to: pause, after: T}
stop: {time: 1.005}
"""


def run(text: str, step: float | None = None) -> Trace:
    chosen = {"engine": "taylor"} if step is None else {"engine": "impulse", "step": step}
    return Runner(interpret(read_text(text)), **chosen).run().trace  # type: ignore[arg-type]


def off(step: float) -> float:
    return float(np.abs(run(TOWED, step).final - run(TOWED).final).max())


def test_variables_that_flow_with_the_motion_converge_with_order_two() -> None:
    coarse, fine = off(2e-3), off(5e-4)
    assert coarse < 5e-5
    assert fine < coarse / 10.0


def test_stepped_states_and_updates_match_events() -> None:
    exact, found = run(TOWED), run(TOWED, 1e-3)
    assert found.final_mode == exact.final_mode
    (stop,) = [jump for jump in found.jumps if jump.cause == "stop"]
    assert stop.t == pytest.approx(0.9, abs=1e-12)
    place = found.variables.index("most")
    assert stop.after[place] == stop.before[found.variables.index("block.dx")]


def test_results_do_not_depend_on_the_number_of_steps_per_call(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = run(TOWED, 1e-3)
    monkeypatch.setattr(stepper, "_CHUNK", 7)
    parts = run(TOWED, 1e-3)
    assert whole.final.tobytes() == parts.final.tobytes()
    assert [jump.t for jump in whole.jumps] == [jump.t for jump in parts.jumps]


def test_few_steps_are_discarded_after_a_transition(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    steps = SteppedScene.steps

    def counted(self, start, h, state, count):
        asked.append(count)
        return steps(self, start, h, state, count)

    monkeypatch.setattr(SteppedScene, "steps", counted)
    trace = run(PULSES, 1e-3)
    assert sum(jump.region == "pulse" for jump in trace.jumps) == 100
    assert sum(asked) < 2 * trace.counts["steps"]


def test_overflow_of_controller_memory_is_reported() -> None:
    text = TOWED.replace("flows: {end: speed,", "flows: {most: 1e3*most + 1e300, end: speed,")
    result = Runner(interpret(read_text(text)), engine="impulse", step=1e-3).run(throw=False)
    assert "a controller's variable" in result.trace.message
