"""Hybrid statecharts: declared, composed, drawn, run and checked.

A model is a YAML file, or its pydantic model (`Chart` here, `Scene` in `contacts`). `run` runs it
once, `Runner` many times, `sweep` over its parameters; `draw` draws its statechart, `graph` makes a
networkx graph of it, `check` tests invariants of its runs, `trade` measures run time against error.
All other names are internal.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from statechart.automaton.time_stepper import Sample as Sample
    from statechart.automaton.trace import Arc as Arc
    from statechart.automaton.trace import Jump as Jump
    from statechart.automaton.trace import Motion as Motion
    from statechart.automaton.trace import Outcome as Outcome
    from statechart.automaton.trace import Trace as Trace
    from statechart.charts.chart import Chart as Chart
    from statechart.charts.chart import Region as Region
    from statechart.charts.chart import State as State
    from statechart.charts.transitions import Transition as Transition
    from statechart.diagram.model import Diagram as Diagram
    from statechart.documents.declaration import Declaration as Declaration
    from statechart.documents.outputs import Count as Count
    from statechart.documents.outputs import Integral as Integral
    from statechart.documents.outputs import Maximum as Maximum
    from statechart.documents.outputs import Minimum as Minimum
    from statechart.documents.outputs import Value as Value
    from statechart.documents.setting import Setting as Setting
    from statechart.documents.settings import Settings as Settings
    from statechart.documents.settings import Stop as Stop
    from statechart.errors import AmbiguousMode as AmbiguousMode
    from statechart.errors import DeclarationError as DeclarationError
    from statechart.errors import EventLoop as EventLoop
    from statechart.errors import FormulaError as FormulaError
    from statechart.errors import NoConsistentMode as NoConsistentMode
    from statechart.errors import NonFinite as NonFinite
    from statechart.errors import OutOfBudget as OutOfBudget
    from statechart.errors import SimulationError as SimulationError
    from statechart.errors import SingularMode as SingularMode
    from statechart.errors import StatechartError as StatechartError
    from statechart.errors import StepFailure as StepFailure
    from statechart.errors import StepTooLarge as StepTooLarge
    from statechart.errors import TooLong as TooLong
    from statechart.errors import Undecided as Undecided
    from statechart.errors import UnsolvedImpulses as UnsolvedImpulses
    from statechart.errors import Unsupported as Unsupported
    from statechart.errors import Zeno as Zeno
    from statechart.loading.load import load as load
    from statechart.running.accuracy import AccuracyRequest as AccuracyRequest
    from statechart.running.drawing import draw as draw
    from statechart.running.drawing import graph as graph
    from statechart.running.inspection import Modes as Modes
    from statechart.running.inspection import equations as equations
    from statechart.running.inspection import modes as modes
    from statechart.running.result import Reading as Reading
    from statechart.running.result import Result as Result
    from statechart.running.runner import Runner as Runner
    from statechart.running.runner import run as run
    from statechart.study.study import Study as Study
    from statechart.study.trade import trade as trade
    from statechart.sweeps.sweep import sweep as sweep
    from statechart.testing.checking import CheckReport as CheckReport
    from statechart.testing.checking import PropertyReport as PropertyReport
    from statechart.testing.checking import check as check

    __version__: str

# Nothing is imported before it is used: the command line starts as fast as without this page.
_HOMES = {
    "automaton.time_stepper": "Sample",
    "automaton.trace": "Arc Jump Motion Outcome Trace",
    "charts.chart": "Chart Region State",
    "charts.transitions": "Transition",
    "diagram.model": "Diagram",
    "documents.declaration": "Declaration",
    "documents.outputs": "Count Integral Maximum Minimum Value",
    "documents.setting": "Setting",
    "documents.settings": "Settings Stop",
    "errors": "AmbiguousMode DeclarationError EventLoop FormulaError NoConsistentMode NonFinite "
    "OutOfBudget SimulationError SingularMode StatechartError StepFailure StepTooLarge "
    "TooLong Undecided UnsolvedImpulses Unsupported Zeno",
    "loading.load": "load",
    "running.accuracy": "AccuracyRequest",
    "running.drawing": "draw graph",
    "running.inspection": "Modes equations modes",
    "running.result": "Reading Result",
    "running.runner": "Runner run",
    "study.study": "Study",
    "study.trade": "trade",
    "sweeps.sweep": "sweep",
    "testing.checking": "CheckReport PropertyReport check",
}
_RENAMED = {"Asked": "AccuracyRequest"}
_HOME = {name: home for home, names in _HOMES.items() for name in names.split()}
if not TYPE_CHECKING:
    # Type checkers take the names from the imports above.
    __all__ = list(_HOME)
_HOME["notebook"] = "running.drawing"


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
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, "__version__"} - {"notebook"})
