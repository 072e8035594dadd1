"""The document kind `chart`."""

from __future__ import annotations

from pathlib import Path

from statechart.automaton.automaton import Automaton
from statechart.charts.chart import Chart
from statechart.loading.kind import Kind


def _automaton(chart: Chart) -> Automaton:
    from statechart.charts.laws import automaton

    return automaton(chart)


CHART = Kind("chart", Chart, _automaton, Path(__file__).with_name("starter.yaml"))
