"""Hybrid statecharts: declared, composed, drawn, run and checked.

A model is a YAML file, or its pydantic model (`Chart` here, `Scene` in `contacts`). `run` runs it
once, `Runner` many times, `sweep` over its parameters; `draw` draws its statechart, `graph` makes a
networkx graph of it, `check` tests invariants of its runs, `trade` measures run time against error.
All other names are internal.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from statechart.automaton.time_stepper import Sample
    from statechart.automaton.trace import Arc, Jump, Motion, Outcome, Trace
    from statechart.charts.chart import Chart, Region, State
    from statechart.charts.transitions import Transition
    from statechart.diagram.model import Diagram
    from statechart.documents.declaration import Declaration
    from statechart.documents.outputs import Count, Integral, Maximum, Minimum, Value
    from statechart.documents.setting import Setting
    from statechart.documents.settings import Settings, Stop
    from statechart.errors import (
        AmbiguousMode,
        DeclarationError,
        EventLoop,
        FormulaError,
        NoConsistentMode,
        NonFinite,
        OutOfBudget,
        SimulationError,
        SingularMode,
        StatechartError,
        StepFailure,
        StepTooLarge,
        TooLong,
        Undecided,
        UnsolvedImpulses,
        Unsupported,
        Zeno,
    )
    from statechart.loading.load import load
    from statechart.running.accuracy import AccuracyRequest
    from statechart.running.drawing import draw, graph
    from statechart.running.inspection import Modes, equations, modes
    from statechart.running.result import Reading, Result
    from statechart.running.runner import Runner, run
    from statechart.study.study import Study
    from statechart.study.trade import trade
    from statechart.sweeps.sweep import sweep
    from statechart.testing.checking import CheckReport, PropertyReport, check

    __version__: str

__all__ = [
    "AccuracyRequest",
    "AmbiguousMode",
    "Arc",
    "Chart",
    "CheckReport",
    "Count",
    "Declaration",
    "DeclarationError",
    "Diagram",
    "EventLoop",
    "FormulaError",
    "Integral",
    "Jump",
    "Maximum",
    "Minimum",
    "Modes",
    "Motion",
    "NoConsistentMode",
    "NonFinite",
    "OutOfBudget",
    "Outcome",
    "PropertyReport",
    "Reading",
    "Region",
    "Result",
    "Runner",
    "Sample",
    "Setting",
    "Settings",
    "SimulationError",
    "SingularMode",
    "State",
    "StatechartError",
    "StepFailure",
    "StepTooLarge",
    "Stop",
    "Study",
    "TooLong",
    "Trace",
    "Transition",
    "Undecided",
    "UnsolvedImpulses",
    "Unsupported",
    "Value",
    "Zeno",
    "check",
    "draw",
    "equations",
    "graph",
    "load",
    "modes",
    "run",
    "sweep",
    "trade",
]

# Nothing is imported before it is used: the command line starts as fast as without this page.
_HOMES = {
    "automaton.time_stepper": ("Sample",),
    "automaton.trace": ("Arc", "Jump", "Motion", "Outcome", "Trace"),
    "charts.chart": ("Chart", "Region", "State"),
    "charts.transitions": ("Transition",),
    "diagram.model": ("Diagram",),
    "documents.declaration": ("Declaration",),
    "documents.setting": ("Setting",),
    "documents.settings": ("Settings", "Stop"),
    "documents.outputs": ("Count", "Integral", "Maximum", "Minimum", "Value"),
    "loading.load": ("load",),
    "running.accuracy": ("AccuracyRequest",),
    "running.drawing": ("draw", "graph", "notebook"),
    "running.inspection": ("Modes", "equations", "modes"),
    "running.result": ("Reading", "Result"),
    "running.runner": ("Runner", "run"),
    "study.study": ("Study",),
    "study.trade": ("trade",),
    "sweeps.sweep": ("sweep",),
    "testing.checking": ("CheckReport", "PropertyReport", "check"),
}
_RENAMED = {"Asked": "AccuracyRequest"}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("contact-statecharts")
    if name in _RENAMED:
        from warnings import warn

        new = _RENAMED[name]
        warn(
            f"statechart.{name} is now statechart.{new}; the old name goes with version 0.3",
            DeprecationWarning,
            stacklevel=2,
        )
        name = new
    if name not in __all__ and name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME.get(name, 'errors')}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
