"""Simulators of the shipped models, compiled once for all tests."""

from __future__ import annotations

import functools
import json
import math
from pathlib import Path
from typing import Any

import models
import statechart
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.diagram.model import Diagram
from statechart.documents.setting import Setting
from statechart.engines.engine import Engine
from statechart.engines.scipy import SciPy
from statechart.engines.taylor import Taylor
from statechart.execution.simulator import Simulator
from statechart.loading.kind import kind
from statechart.loading.load import load
from statechart.observation.observers import Observers
from statechart.observation.outputs import Outputs
from statechart.running.drawing import drawn
from statechart.running.result import Result
from statechart.running.runner import Runner

# These models show runs that cannot continue.
PARADOXICAL = ("no_slip_pencil",)
MODELS = {name: load(name) for name in models.names()}
# Models that declare time stepping run on no engine with events.
EVENT_BASED = tuple(name for name, model in MODELS.items() if model.settings.engine != "impulse")
SOUND = tuple(name for name in EVENT_BASED if name not in PARADOXICAL)
ENGINES = ("taylor", "scipy")
_GOLDEN = Path(__file__).parent / "golden"


def run_chart(tmp_path: Path, text: str, engine: str = "taylor") -> Result:
    """Run a chart given as text, in a file of a folder."""
    file = tmp_path / "chart.yaml"
    file.write_text("kind: chart\nname: c\n" + text, encoding="utf-8")
    return statechart.run(file, engine=engine, tolerance=1e-12)


def golden(name: str) -> Any:
    """Return the reference numbers of a file."""
    return json.loads((_GOLDEN / f"{name}.json").read_text())


def number(value: Any) -> float:
    """Return a reference number: a float, a decimal text, or a fraction."""
    if isinstance(value, str) and "/" in value:
        above, below = value.split("/")
        return float(above) / float(below)
    return math.inf if value in ("inf", None) else float(value)


def without_compilation(stderr: str) -> str:
    """Return the messages, except those on compilation, which depend on its duration."""
    lines = stderr.splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith(("compiling ", "compiled ")))


@functools.cache
def automaton(model: str) -> Automaton:
    """Return the automaton of a shipped model."""
    loaded = MODELS[model]
    built = kind(loaded.kind).automaton(loaded)
    assert isinstance(built, Automaton)
    return built


def engine(name: str) -> Engine:
    """Return an engine at its tightest sensible tolerance."""
    return Taylor(2.2e-16) if name == "taylor" else SciPy(1e-12)


@functools.cache
def _observers(model: str) -> Observers:
    return Observers(automaton(model))


def simulator(model: str, name: str) -> Simulator:
    """Return a simulator of a shipped model."""
    found = _observers(model).at(Setting(name)).simulator
    assert isinstance(found, Simulator)
    return found


@functools.cache
def _reader(model: str, name: str) -> Outputs:
    return Outputs(_observers(model).at(Setting(name)))


def run(model: str, name: str, until: float = 1000.0, **parameters: float) -> Trace:
    """Run a shipped model; a run that fails returns its trace too."""
    return simulator(model, name).run(parameters, until=until, throw=False)


def outputs(model: str, name: str, trace: Trace) -> dict[str, Any]:
    """Return the declared outputs of a run."""
    return _reader(model, name).of(trace)


@functools.cache
def shipped(model: str) -> Result:
    """Return the run of a shipped model as it is declared."""
    return statechart.run(model, throw=False)


@functools.cache
def diagram(model: str) -> Diagram:
    """Return the statechart of a shipped model."""
    return drawn(Runner(model))[0]


def modes(trace: Trace) -> list[str]:
    """Return the modes visited by a run with one contact."""
    return [key[0] for key in trace.modes]
