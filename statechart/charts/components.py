"""Components of a chart: groups of regions that share no variable and no event."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

from pydantic import ValidationError

from statechart.automaton.automaton import Automaton, Component, Places
from statechart.automaton.components import Data, composed, reserved_words, split
from statechart.automaton.laws import Setup
from statechart.charts.chart import Chart
from statechart.errors import StatechartError


@cache
def _reserved() -> frozenset[str]:
    schema = Path(__file__).with_name("schema.json").read_text("utf-8")
    return frozenset(reserved_words(json.loads(schema)))


def components(chart: Chart, compose: Callable[[Chart], Automaton]) -> tuple[Component, ...]:
    """Return the components of a chart, none where all of it belongs together."""
    data = chart.model_dump(by_alias=True, exclude_unset=True)
    parts = split(data, ("variables", "regions"), ("regions",), _reserved)
    try:
        return composed(
            parts,
            _form,
            lambda part: compose(Chart.model_validate(part)),
            lambda _: _restricted,
            joint=False,
        )
    except (StatechartError, ValidationError):
        return ()


def _form(part: Data) -> Data:
    """Return a declaration without the values that its variables start from."""
    return {**part, "variables": list(part.get("variables", ()))}


def _restricted(whole: Setup, places: Places) -> Setup:
    return replace(
        whole,
        values=whole.values[places.parameters],
        initial=whole.initial[places.variables],
        modes=None,
    )
