"""Impulses converge in random heaps and in scenes where they once did not."""

from __future__ import annotations

import numpy as np
import pytest
from random_bodies import heap

from contacts.rigid_bodies import rigid_body_run
from contacts.rigid_bodies.body_step import step_bodies
from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.testing.body_properties import assert_depths, assert_energy_of_steps
from statechart.automaton.trace import Outcome
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner
from statechart.testing.subject import Subject

TWENTY = """
kind: scene
name: columns
gravity: 9.81
bodies:
  disc:
    copies: 600
    mass: 1
    inertia: 0.005
    shape: {disc: 0.1}
    start:
      x: (index + 0.5)/30 - 0.5 - atan(tan(pi*((index + 0.5)/30 - 0.5)))/pi
      y: 3.1 + 6.001/pi*atan(tan(pi*((index + 0.5)/30 - 0.5)))
surfaces: {ground: {height: 0}}
collisions: {all: {bodies: [disc], surfaces: [ground], friction: 0.5, restitution: 0.2}}
stop: {time: 0.3}
settings: {engine: impulse, step: 1e-3, record: nothing}
"""
"""Twenty columns of thirty discs, touching or nearly."""


@pytest.mark.parametrize("seed", range(24))
def test_heaps_settle_with_bounded_energy(seed):
    subject = Subject(interpret(read_text(heap(seed, most=20))))
    trace = subject.case({}).trace
    assert trace.outcome is Outcome.HORIZON, trace.message
    scene = subject.model
    numbers = body_numbers(scene, scene.values())
    assert_energy_of_steps(numbers, subject, trace)


@pytest.mark.parametrize("seed", [59, 226, 296, 399, 639, 650, 664])
def test_penetration_after_a_step_decides_whether_it_was_too_long(seed):
    """Light bodies between heavy ones cross more than their size in a step."""
    subject = Subject(interpret(read_text(heap(seed))))
    trace = subject.case({}).trace
    assert trace.outcome is Outcome.HORIZON, trace.message
    scene = subject.model
    numbers = body_numbers(scene, scene.values())
    assert_depths(numbers, trace)
    assert_energy_of_steps(numbers, subject, trace)


def test_a_grain_wedged_in_a_corner_gives_no_energy_to_the_bodies_on_it():
    """At 5e15 N s between ground and wall all that other bodies press onto it was round-off."""
    subject = Subject(interpret(read_text(heap(498))))
    trace, scene = subject.case({}).trace, subject.model
    assert trace.counts["inexact_steps"] == 0
    assert_energy_of_steps(body_numbers(scene, scene.values()), subject, trace)


@pytest.mark.parametrize("seed", [90, 144, 247, 249, 274, 321, 390, 412, 468, 860, 939])
def test_heaps_with_mass_ratio_1e6_satisfy_the_laws(seed):
    """Each of them had steps above the tolerance, at up to 1 of the fastest approach."""
    trace = Runner(interpret(read_text(heap(seed)))).run().trace
    assert trace.counts["inexact_steps"] == 0


def test_dice_that_wedge_are_solved_to_the_tolerance():
    # Two corners of a face press a die between others: Lemke's bases are singular there.
    trace = Runner("dice").run({"mu": 0.05612329752074041}, until=0.7).trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.counts["inexact_steps"] == 0
    assert trace.counts["iterations"] > 0
    assert trace.counts["contacts"] >= trace.counts["most_contacts"] > 10


def test_forty_dice_come_to_the_end():
    trace = Runner("dice").run({"n": 40}, until=0.7).trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.counts["inexact_steps"] == 0


def test_a_stack_at_rest_takes_less_than_an_iteration_a_step_and_does_not_creep():
    trace = Runner("box_stack").run({"offset": 0.01}, until=2).trace
    assert trace.counts["iterations"] < trace.counts["steps"]
    assert np.abs(trace.final - trace.initial).max() < 1e-12


def test_the_tolerance_trades_iterations_for_exactness():
    iterations = []
    for tolerance in (1e-2, 1e-6):
        trace = Runner("granular_column", impulse_tolerance=tolerance).run({"n": 40}).trace
        assert trace.counts["inexact_steps"] == 0
        iterations.append(trace.counts["iterations"])
    assert iterations[0] < 0.7 * iterations[1]


def test_separate_heaps_take_as_many_steps_per_call_as_one(monkeypatch):
    calls = []

    def counted(*arguments):
        calls.append(None)
        return step_bodies(*arguments)

    monkeypatch.setattr(rigid_body_run, "step_bodies", counted)
    trace = Runner(interpret(read_text(TWENTY))).run().trace
    assert trace.counts["most_contacts"] == 600
    assert len(calls) < 12


def test_residuals_above_the_tolerance_warn_and_above_the_bound_end_the_run(capsys):
    arguments = ["run", "granular_column", "--until", "0.2", "--impulse-tolerance", "1e-15"]
    assert main(arguments) == 0
    assert "contact impulses exceeds the tolerance of 1e-15" in capsys.readouterr().err
    assert main([*arguments, "--impulse-bound", "1e-15"]) == 1
    printed = capsys.readouterr()
    assert "UNSOLVED_IMPULSES" in printed.out + printed.err


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"impulse_tolerance": 0.0}, "above 0 and below 1"),
        ({"impulse_bound": -1.0}, "above 0"),
        ({"impulse_bound": 1e-6, "impulse_tolerance": 1e-3}, "runs within the tolerance would end"),
        ({"impulse_tolerance": 1e-3, "engine": "scipy"}, "has no impulse_tolerance"),
    ],
)
def test_wrong_tolerances_of_impulses_are_refused(asked, words):
    with pytest.raises(DeclarationError, match=words):
        Runner("block_on_incline", **{"engine": "impulse", **asked})
