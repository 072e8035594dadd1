"""Runs as they come: the pieces of a run, and controllers in Python between samples."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from statechart.automaton.time_stepper import Sample
from statechart.automaton.trace import Arc, Jump
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, NoConsistentMode, SimulationError
from statechart.running.runner import Runner

PUSHED = """\
kind: scene
name: pushed
parameters: {u: 0, mu: 0.5, g: 10}
gravity: g
bodies:
  block: {mass: 2}
surfaces:
  floor: {height: 0}
contacts:
  base: {point: {body: block}, surface: floor, modes: [slide, pin], friction: mu}
forces:
  push: {body: block, force: [u, 0]}
stop: {time: 2}
"""


@pytest.mark.parametrize("name", ["toppling_stick", "double_contact_bar", "bouncing_ball"])
def test_a_stream_has_the_pieces_of_the_run(name: str) -> None:
    runner = Runner(name, engine="taylor")
    trace = runner.run().trace
    pieces = list(runner.stream())
    arcs = [piece for piece in pieces if isinstance(piece, Arc)]
    jumps = [piece for piece in pieces if isinstance(piece, Jump)]
    assert [(j.t, j.cause, j.target) for j in jumps] == [
        (j.t, j.cause, j.target) for j in trace.jumps
    ]
    assert [(a.j, a.start, a.mode) for a in arcs] == [(a.j, a.start, a.mode) for a in trace.arcs]
    for mine, theirs in zip(arcs, trace.arcs, strict=True):
        np.testing.assert_array_equal(mine.coefficients, theirs.coefficients)
    # Every jump comes behind the arc that it ends.
    assert [piece.j for piece in pieces] == sorted(piece.j for piece in pieces)


def test_pieces_come_before_the_run_is_over() -> None:
    pieces = Runner("bouncing_ball", engine="taylor").stream()
    first, second = next(pieces), next(pieces)
    assert isinstance(first, Arc)
    assert isinstance(second, Jump)
    assert second.t == pytest.approx(math.sqrt(2 * 1 / 9.81), abs=1e-12)


def test_arcs_of_a_streamed_run_end_at_its_samples() -> None:
    runner = Runner("toppling_stick", engine="taylor")
    arcs = [piece for piece in runner.stream(until=3.0, every=0.5) if isinstance(piece, Arc)]
    assert [arc.start.high for arc in arcs] == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0, 2.5])
    whole = runner.run(until=3.0).trace
    np.testing.assert_allclose(arcs[-1].coefficients[-1].sum(axis=1), whole.final, rtol=1e-12)


@pytest.mark.parametrize(
    "engine", [{"engine": "taylor"}, {"engine": "scipy"}, {"engine": "impulse", "step": 1e-3}]
)
def test_a_controller_sets_parameters_between_samples(engine: Mapping[str, object]) -> None:
    # Pushed with 30 for a second, which 10 of friction oppose, it gains 10; then friction stops it.
    seen: list[Sample] = []

    def control(sample: Sample) -> Mapping[str, float] | None:
        seen.append(sample)
        return {"u": 30.0 if sample.t < 0.999 else 0.0} if round(sample.t, 6) in (0, 1) else None

    runner = Runner(read_text(PUSHED), **engine)  # type: ignore[arg-type]
    pieces = list(runner.stream(every=0.25, control=control))
    assert [sample.t for sample in seen[:6]] == pytest.approx([0, 0.25, 0.5, 0.75, 1.0, 1.25])
    assert seen[0].mode == {"base": "pin"}
    assert seen[2].mode == {"base": "slide+"}
    near = 2e-2 if "step" in engine else 1e-9
    assert seen[4].values["block.dx"] == pytest.approx(10.0, abs=near)
    last = [piece for piece in pieces if isinstance(piece, Arc)][-1]
    assert last.coefficients[-1].sum(axis=1)[2] == pytest.approx(5.0, abs=near)
    causes = [piece.cause for piece in pieces if isinstance(piece, Jump)]
    assert causes == ["slip"]


def test_options_that_a_stream_lacks_are_reported() -> None:
    runner = Runner(read_text(PUSHED), engine="taylor")
    with pytest.raises(DeclarationError, match="no parameter 'v'"):
        list(runner.stream(every=0.5, control=lambda sample: {"v": 1.0}))
    for every in (0.0, -1.0, math.nan):
        with pytest.raises(DeclarationError, match="every must be a finite time above 0"):
            runner.stream(every=every)
    with pytest.raises(DeclarationError, match="give the sampling period"):
        runner.stream(control=lambda sample: None)
    with pytest.raises(DeclarationError, match="a stream is a single run"):
        Runner(read_text(PUSHED), accuracy=1e-6).stream()
    dice = Runner("dice").stream(until=0.01, every=0.005, control=lambda sample: {"g": 1.0})
    with pytest.raises(SimulationError, match="take the engine taylor or scipy"):
        list(dice)


def test_a_stream_raises_the_error_after_its_last_arc() -> None:
    pieces: list[object] = []
    with pytest.raises(NoConsistentMode):
        pieces.extend(Runner("no_slip_pencil", engine="taylor").stream())
    assert pieces


def test_other_runs_of_the_runner_do_not_disturb_a_stream() -> None:
    runner = Runner("bouncing_ball", engine="taylor")
    pieces = runner.stream()
    first = next(pieces)
    assert isinstance(first, Arc)
    before = first.coefficients.copy()
    runner.run({"k": 0.5})
    jumps = [piece.t for piece in pieces if isinstance(piece, Jump)]
    np.testing.assert_array_equal(first.coefficients, before)
    assert jumps == [jump.t for jump in runner.run().trace.jumps]


def test_samples_that_the_clock_cannot_tell_apart_are_refused() -> None:
    runner = Runner(read_text(PUSHED))
    with pytest.raises(DeclarationError, match="above the round-off of time at 2, not 1e-300"):
        next(runner.stream(every=1e-300, control=lambda sample: None))


def test_invalid_values_of_a_control_are_reported_with_their_place() -> None:
    runner = Runner(read_text(PUSHED, "pushed.yaml"))
    pieces = runner.stream(every=0.5, control=lambda sample: {"mu": -1.0})
    with pytest.raises(DeclarationError, match=r"^pushed.yaml:10:.*must be zero or positive"):
        list(pieces)


WRAPPED = """\
kind: chart
name: wrapped
parameters: {T: 0.2}
variables: {x: 0}
regions: {phase: {initial: runs, states: {runs: {flows: {x: "mod(time, T)"}}}}}
stop: {time: 1}
"""


@pytest.mark.parametrize(("first", "period"), [(0.2, 0.3), (0.2, 0.1), (0.2, 0.002), (0.002, 0.3)])
def test_a_new_period_wraps_time_anew(first: float, period: float) -> None:
    text = WRAPPED.replace("T: 0.2", f"T: {first}")
    control = lambda sample: {"T": period} if sample.t == pytest.approx(0.5) else None  # noqa: E731
    pieces = [*Runner(read_text(text), engine="taylor").stream(every=0.5, control=control)]
    ends = [piece.coefficients[-1].sum(axis=1)[0] for piece in pieces if isinstance(piece, Arc)]
    integral = lambda t, T: (t // T) * T * T / 2 + (t % T) ** 2 / 2  # noqa: E731
    before = integral(0.5 + 1e-12, first)
    after = integral(1.0 + 1e-12, period) - integral(0.5 + 1e-12, period)
    assert ends[-1] == pytest.approx(before + after, abs=1e-9)


TICKS = """\
kind: chart
name: ticks
parameters: {T: 0.3, x: 0}
regions:
  r: {initial: on, states: {on: {}}, transitions: [{name: tick, from: on, every: T}]}
stop: {time: 2}
"""
SAMPLED = TICKS.replace("chart", "scene") + "bodies: {b: {mass: 1, start: {dx: 1}}}\n"


@pytest.mark.parametrize("text", [TICKS, SAMPLED])
@pytest.mark.parametrize(
    ("period", "values", "ticks"),
    [
        ("0.3", {"x": 1}, [0.3, 0.6, 0.9, 1.2, 1.5, 1.8]),
        ("0.3", {"T": 0.5}, [0.3, 0.6, 0.9, 1.4, 1.9]),
        ("0.3", {"T": 0.25}, [0.3, 0.6, 0.9, 1.15, 1.4, 1.65, 1.9]),
        # The last tick is longer ago than a new period.
        ("0.7", {"T": 0.2}, [0.7, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0]),
        ("10", {"T": 0.01}, [1.0 + 0.01 * k for k in range(101)]),
    ],
)
def test_a_new_period_counts_from_the_last_tick(
    text: str, period: str, values: Mapping[str, float], ticks: list[float]
) -> None:
    runner = Runner(read_text(text.replace("T: 0.3", f"T: {period}")), engine="taylor")
    control = lambda sample: values if sample.t == pytest.approx(1.0) else None  # noqa: E731
    pieces = runner.stream(every=1.0, until=2.001, control=control)
    at = [piece.t for piece in pieces if isinstance(piece, Jump)]
    assert at == pytest.approx(ticks, abs=1e-12)


SURFACES = """\
kind: scene
name: surfaces
parameters: {v: 0, h: 0, wind: 0, g: 10}
gravity: g
bodies:
  ball: {mass: 1, start: {y: 0.8, dx: 0.3}}
  block: {mass: 1}
  stone: {mass: 1, start: {y: 4}}
surfaces:
  hill: {height: 0.1*sin(x) + 0*h}
  belt: {height: h, displacement: [v*time, 0]}
joints:
  rope: {point: {body: stone}, to: [0, 5], rope: 1 - h/2}
contacts:
  hop: {point: {body: ball}, surface: hill, friction: 0, restitution: 0.9}
  base: {point: {body: block}, surface: belt, friction: 0.5, restitution: 0}
forces:
  gust: {body: ball, force: [wind, 0]}
stop: {time: 1}
"""
HINGE = """\
kind: scene
name: hinge
parameters: {place: 0, w: 0}
bodies: {arm: {mass: 1, inertia: 1}}
joints: {pivot: {point: {body: arm}, to: ["place + w*(time - 0.5)", 0], limits: [w - 1, 1 + place]}}
stop: {time: 1}
"""
ENGINES = [{"engine": "taylor"}, {"engine": "scipy"}, {"engine": "impulse", "step": 1e-4}]


def changed(text: str, values: Mapping[str, float], engine: Mapping[str, object]) -> list[object]:
    """Return the pieces of a run whose parameters change at 0.5."""
    runner = Runner(read_text(text), **engine)  # type: ignore[arg-type]
    control = lambda sample: values if sample.t == pytest.approx(0.5) else None  # noqa: E731
    return list(runner.stream(every=0.5, control=control))


@pytest.mark.parametrize("engine", ENGINES)
def test_new_values_of_parameters_move_surfaces_but_no_bodies(engine: Mapping[str, object]) -> None:
    pieces = changed(SURFACES, {"v": 0.4, "h": -0.2, "wind": 3.0}, engine)
    near = 2e-3 if "step" in engine else 1e-9
    plain = [piece for piece in changed(SURFACES, {}, engine) if isinstance(piece, Arc)][-1]
    last = [piece for piece in pieces if isinstance(piece, Arc)][-1]
    ball, calm = (arc.coefficients[-1].sum(axis=1) for arc in (last, plain))
    # The wind acts on the ball in flight, after its first impact.
    assert ball[[0, 6]] - calm[[0, 6]] == pytest.approx([3 * 0.5**2 / 2, 1.5], abs=near)
    jumps = {(j.region, j.cause): j.t for j in pieces if isinstance(j, Jump)}
    # The block falls by 0.2 on the belt, the stone by 0.1 until its longer rope is taut.
    assert jumps["base", "touchdown"] == pytest.approx(0.5 + math.sqrt(0.04), abs=near)
    assert jumps["rope", "touchdown"] == pytest.approx(0.5 + math.sqrt(0.02), abs=near)
    # The impact of 2 m/s has more friction than the belt's 0.4 m/s.
    assert ball[8] == pytest.approx(0.4, abs=near)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("text", "values", "message"),
    [
        (SURFACES, {"h": 0.1}, "surface 'belt' jumps 0.1 deep|rope 'rope' jumps to 0.05 below"),
        (HINGE, {"place": 0.3}, "position that joint 'pivot' holds jump;"),
        (HINGE, {"w": 0.3}, "velocity that joint 'pivot' holds jump;"),
        (HINGE, {"place": -1.3}, "position that joint 'pivot' holds jump;"),
    ],
)
def test_new_values_that_break_a_constraint_end_the_run(
    text: str, values: Mapping[str, float], message: str, engine: Mapping[str, object]
) -> None:
    with pytest.raises(NoConsistentMode, match=rf"t = 0\.5: .*({message})"):
        changed(text, values, engine)


LIFT = """\
kind: scene
name: lift
parameters: {v: 0}
gravity: 10
bodies:
  box: {mass: 1}
  load: {mass: 1, start: {y: 1}}
surfaces: {plate: {height: 0, displacement: [0, v*(time - 0.5)]}}
joints: {rope: {point: {body: load}, to: [0, 2], rope: 1 - v*(time - 0.5), restitution: E}}
contacts: {base: {point: {body: box}, surface: plate, friction: 0.5, restitution: E}}
stop: {time: 0.53}
"""
ALARM = """\
regions:
  alarm: {initial: quiet, states: {quiet: {}, rings: {}},
          transitions: [{name: ring, from: quiet, to: rings, on: base.liftoff or rope.liftoff}]}
"""


@pytest.mark.parametrize(
    ("engine", "regions"), [*((e, "") for e in ENGINES), *((e, ALARM) for e in ENGINES[:2])]
)
@pytest.mark.parametrize("e", [0.0, 0.5])
def test_new_values_set_surfaces_and_ropes_in_motion(
    e: float, engine: Mapping[str, object], regions: str
) -> None:
    # They strike at once: box and load start with (1 + e) v.
    pieces = changed(LIFT.replace("E", f"{e}") + regions, {"v": 0.5}, engine)
    near = 11 * float(str(engine.get("step", 1e-10)))
    jumps = [piece for piece in pieces if isinstance(piece, Jump)]
    assert [jump.cause for jump in jumps] == ["touchdown"]
    assert jumps[0].t == pytest.approx(0.5, abs=near)
    motion = [0.018, 0.45] if e else [0.015, 0.5]
    last = [piece for piece in pieces if isinstance(piece, Arc)][-1]
    for body, height in ((1, 0.0), (3, 1.0)):
        state = last.coefficients[-1].sum(axis=1)[[body, body + 4]] - [height, 0.0]
        assert state == pytest.approx(motion, abs=near)


SWITCHED = """\
kind: scene
name: switched
parameters: {p: 0}
gravity: 10
bodies: {box: {mass: 1}}
surfaces: {plate: {height: p}}
contacts:
  base: {point: {body: box}, surface: plate, friction: 0.5, restitution: 0, enabled: p < 0.1}
stop: {time: 1}
"""
HELD = """\
kind: scene
name: held
parameters: {p: 0}
gravity: 10
bodies: {box: {mass: 1}}
joints: {pin: {point: {body: box}, to: ["p + p*(time - 0.5)", 0], enabled: p < 0.1}}
stop: {time: 1}
"""


@pytest.mark.parametrize(
    ("text", "engine"), [*((SWITCHED, e) for e in ENGINES), *((HELD, e) for e in ENGINES[:2])]
)
@pytest.mark.parametrize("p", [0.3, 0.05])
def test_constraints_that_new_values_switch_off_may_move(
    text: str, p: float, engine: Mapping[str, object]
) -> None:
    if p < 0.1:
        with pytest.raises(NoConsistentMode, match=r"jumps 0.05 deep|holds jump"):
            changed(text, {"p": p}, engine)
        return
    pieces = changed(text, {"p": p}, engine)
    assert [(j.t, j.cause) for j in pieces if isinstance(j, Jump)] == [(0.5, "disable")]
    last = [piece for piece in pieces if isinstance(piece, Arc)][-1]
    fallen = last.coefficients[-1].sum(axis=1)[[1, 3]]
    assert fallen == pytest.approx([-10 * 0.5**2 / 2, -5.0], abs=1e-9)
