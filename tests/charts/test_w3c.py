"""The W3C's tests for SCXML that charts can say, and the page that lists the others."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from pydantic import ValidationError

from statechart.automaton.trace import Outcome
from statechart.charts.chart import Chart
from statechart.running.runner import Runner
from tests.charts.w3c import CHARTS, REFUSED

PAGE = Path(__file__).parents[2] / "docs" / "format" / "scxml.md"


@pytest.mark.parametrize("number", CHARTS)
def test_w3c_charts_end_as_specified(number: str) -> None:
    runner = Runner(Chart.model_validate(CHARTS[number]))
    trace = runner.run().trace
    assert trace.outcome is Outcome.HORIZON
    ended = dict(zip(runner.automaton.region_names, trace.final_mode, strict=True))["main"]
    (main,) = (region for region in runner.automaton.regions if region.name == "main")
    assert main.active(ended) == ("pass",)


@pytest.mark.parametrize("number", REFUSED)
def test_invalid_w3c_charts_are_refused(number: str) -> None:
    declared, words = REFUSED[number]
    with pytest.raises(ValidationError, match=re.escape(words)):
        Chart.model_validate(declared)


def test_guard_cannot_refer_to_a_history_state() -> None:
    text = json.dumps(CHARTS["580"])
    asked = text.replace("in(main.s12)", "in(main.sh1)")
    assert asked != text
    with pytest.raises(ValidationError, match="no state 'sh1'"):
        Chart.model_validate_json(asked)


def test_the_page_lists_the_numbers_of_at_least_sixty_tests() -> None:
    said = {*CHARTS, *REFUSED}
    assert len(said) == len(CHARTS) + len(REFUSED) >= 60
    text = PAGE.read_text("utf-8")
    (translated,) = re.findall(r"^Translated: (.*)\.$", text, re.MULTILINE)
    assert sorted(translated.split(", ")) == sorted(said)
    others = re.findall(r"\b\d{3}[a-c]?\b", text.split("## Tests without a translation")[1])
    assert len(others) == len({*others})
    assert not said & {*others}
    assert f"has {len(said) + len(others)} tests" in text
