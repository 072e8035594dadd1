"""Runs by steps of scenes that are text with STEP in it, and of their mirror images."""

from __future__ import annotations

import functools

import pytest

from contacts.testing.symmetry import mirrored
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner


@functools.cache
def runner(text):
    return Runner(interpret(read_text(text)))


def run(text, *, step, **values):
    result = runner(text.replace("STEP", repr(step))).run(values)
    assert result.trace.outcome is Outcome.HORIZON, result.trace.message
    # Forces of guides are open where faces press; no answer here depends on them.
    assert not [text for text in result.trace.warnings if "in several ways" not in text]
    return result


def assert_moves_as_its_image(text, *, step, within, **values):
    """The mirror image ends as the image of the end, to that distance and speed."""
    model, reading = mirrored(interpret(read_text(text.replace("STEP", repr(step)))))
    image = Runner(model).run(values).trace.final * reading.factors
    assert image == pytest.approx(run(text, step=step, **values).trace.final, abs=within)
