"""The verbs of the command line: each takes its arguments and returns the exit code."""

from __future__ import annotations

import argparse
import functools
import gc
import json
import sys
import tempfile
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from statechart import interrupts
from statechart.cli.places import (
    check_animation,
    check_drawing,
    check_folder,
    check_page,
    is_store,
    kept_study,
)
from statechart.cli.terminal import show
from statechart.errors import DeclarationError, SimulationError, StatechartError
from statechart.reporting.pieces import Pieces

T = TypeVar("T")

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from statechart.running.result import Result
    from statechart.running.runner import Runner


_SAMPLES = (
    "samples.csv is written from version 0.3 on only where it is asked for: say --samples, or "
    "--no-samples; trace.nc has the same"
)
# Seconds after a signal in which what was computed is saved, but for what is always saved.
_PATIENCE = 0.9


def validate(arguments: argparse.Namespace) -> int:
    """Read a model and check its initial state; print one line."""
    from statechart.reporting.modes import counted
    from statechart.tabular import ends

    runner = _runner(arguments.file)
    mode, warnings = runner.start()
    automaton = runner.automaton
    kind = getattr(runner.model, "kind", "model")
    count = counted(automaton.modes_declared, automaton.modes_total)
    remarks = "".join(f"; warning: {warning}" for warning in warnings)
    # Of many regions a label is longer than what is told.
    states = automaton.label(mode).split()
    start = " ".join(f"... {s} more ..." if isinstance(s, int) else s for s in ends(states))
    print(
        f"{arguments.file}: {kind} {automaton.name!r} is correct: "
        f"{len(automaton.names)} variables, {count}, starts in {start}{remarks}"
    )
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Run a model; print a summary or one object."""
    from statechart.documents.setting import Setting

    parameters = _assigned("--set", arguments.parameters)
    runner = _runner(
        arguments.file,
        **{part.name: getattr(arguments, part.name) for part in fields(Setting)},
        study=kept_study(arguments),
        once=True,
        progress=not arguments.quiet,
    )
    check_folder(arguments.output)
    check_animation(runner, arguments.animate)
    check_page("--report", arguments.report)
    if arguments.output is not None:
        import xarray  # noqa: F401, it takes a second that a signal does not leave
    result = runner.run(parameters, until=arguments.until, certify=arguments.certify, throw=False)
    # From here on nothing is lost: what fails is left out, and what is left out is said.
    with interrupts.held(), interrupts.limited(_PATIENCE):
        complete = _tell(runner, result, parameters, arguments)
    asked = result.asked
    met = asked is None or asked.setting.accuracy is None or asked.reached(result.error_estimate)
    return 0 if complete and met and result.trace.outcome.succeeded else 1


def _tell(
    runner: Runner, result: Result, parameters: Mapping[str, float], arguments: argparse.Namespace
) -> bool:
    """Save and print a run; return whether all of it could be."""
    pieces, failure = Pieces(), ""
    result = replace(result, trace=result.trace.at_hand())

    @functools.cache
    def made() -> dict[str, Any]:
        # What was saved must be able to answer why, too.
        explain = arguments.explain or arguments.output is not None
        report = result.to_dict(explain=explain, pieces=pieces)
        if arguments.alternatives:
            none: list[dict[str, Any]] = []
            report["alternatives"] = pieces.attempt(
                "alternatives", lambda: _alternatives(runner, result, parameters, arguments), none
            )
        return report

    if arguments.output is not None:
        from statechart.documents.setting import Record
        from statechart.reporting.run_store import write_store
        from statechart.reporting.tables import write_run

        store, samples = is_store(arguments.output), arguments.samples
        if samples is None and not store and result.trace.record is Record.MODES:
            samples = True
            _warn([_SAMPLES])
        try:
            if store:
                write_store(arguments.output, result.observer, result.trace, made())
            else:
                run, asked = (result.observer, result.trace), bool(samples)
                write_run(arguments.output, *run, made, pieces, asked)
        except StatechartError as error:
            failure = str(error)
    report = made()
    _warn(result.warnings)
    if arguments.json:
        from statechart.reporting.report import dumps

        print(dumps(report), end="")
    else:
        from statechart.reporting.text import told

        show(told(report))
        if arguments.explain and report["events"]:
            from statechart.reporting.text import explained

            show(["\n", *explained(report)])
    sys.stdout.flush()
    if arguments.animate is not None:
        shown = not arguments.quiet
        draw = functools.partial(result.animate, arguments.animate, progress=shown)
        pieces.attempt(arguments.animate, draw, None)
    if arguments.report is not None:
        pieces.attempt(arguments.report, lambda: result.report(arguments.report), None)
    failure = failure or (f"left out: {pieces.text()}" if pieces.failed else "")
    if failure:
        print(failure, file=sys.stderr)
    return not failure


def view(arguments: argparse.Namespace) -> int:
    """Run a model, write the run as a page, and open that."""
    import webbrowser

    check_page("-o", arguments.output)
    runner = _runner(arguments.file, once=True, progress=not arguments.quiet)
    parameters = _assigned("--set", arguments.parameters)
    result = runner.run(parameters, until=arguments.until, throw=False)
    _warn(result.warnings)
    place = arguments.output or Path(
        tempfile.mkdtemp(prefix="statechart-"), f"{runner.model.name}.html"
    )
    page = result.report(place).resolve()
    print(page)
    if not webbrowser.open(page.as_uri()):
        print("no browser could be opened; open the page with one", file=sys.stderr)
    if not result.trace.outcome.succeeded:
        _warn([f"the run ended early: {result.trace.outcome.name}, {result.trace.message}"])
    return 0 if result.trace.outcome.succeeded else 1


def trade(arguments: argparse.Namespace) -> int:
    """Run a model at many settings; print what each costs and gives."""
    from statechart.study.report import report, told
    from statechart.study.trade import trade as study_of

    runner = _runner(arguments.file)
    check_folder(arguments.output)
    study = study_of(
        runner,
        folder=arguments.output,
        progress=_teller(arguments),
    )
    pieces = Pieces()
    if arguments.output is not None:
        from statechart.study.figure import write

        pieces.attempt("tables and figure", lambda: write(arguments.output, study), None)
    if arguments.json:
        _print_json(report(study))
    else:
        show(told(study))
    _say_left_out(pieces)
    if not study.complete:
        again = "the same command goes on" if arguments.output is not None else "-o DIR keeps it"
        print(f"interrupted; {again}", file=sys.stderr)
    return 0 if study.complete and not pieces.failed else 1


def sweep(arguments: argparse.Namespace) -> int:
    """Run a model over its parameters; print how cells ended and between what outputs lie."""
    from statechart.documents.setting import Setting
    from statechart.sweeps import summary
    from statechart.sweeps.deliver import Target
    from statechart.sweeps.ranges import cells
    from statechart.sweeps.sweep import make, planned
    from statechart.sweeps.workers import crew

    over, samples = cells(_assigned("--over", arguments.over), arguments.samples, arguments.sobol)
    names = {part.name for part in fields(Setting)} & set(vars(arguments))
    setting = Setting(**{name: getattr(arguments, name) for name in names})
    plan = planned(
        arguments.file, over, samples, setting, until=arguments.until, outputs=arguments.outputs
    )
    target = Target(arguments.output, arguments.plot, arguments.resume)
    target.check(plan)
    shown = not arguments.quiet
    with crew(arguments.workers, arguments.scheduler) as executor:
        made = make(plan, executor, store=target.store, resume=arguments.resume, progress=shown)
    pieces = Pieces()
    with interrupts.held(), interrupts.limited(_PATIENCE):
        data = made.dataset().load()
        target.write(plan, data, pieces)
        told = summary.report(plan, data, where=arguments.output)
        if arguments.json:
            _print_json(told)
        else:
            show(summary.text(told))
        _say_left_out(pieces)
    if made.ended:
        again = "--resume goes on" if target.store else "-o STORE.zarr keeps what is done"
        print(f"{made.ended}; {again}", file=sys.stderr)
    return 0 if summary.succeeded(told) and not pieces.failed else 1


def _alternatives(
    runner: Runner, result: Result, parameters: Mapping[str, float], arguments: argparse.Namespace
) -> list[dict[str, Any]]:
    from statechart.running.alternatives import compared

    others = {
        choice: other.run(parameters, until=arguments.until, throw=False)
        for choice, other in runner.alternatives().items()
    }
    return compared(result, others)


def modes(arguments: argparse.Namespace) -> int:
    """List modes, which of them are possible at a configuration, and every region's chart."""
    from statechart.automaton.product import feasibility
    from statechart.reporting.modes import check_variables, listing, told

    parameters = _assigned("--set", arguments.parameters)
    runner = _runner(arguments.file, progress=not arguments.quiet)
    automaton = runner.automaton
    if arguments.equations is not None or arguments.latex:
        from statechart.reporting import equations

        form = "latex" if arguments.latex else "json" if arguments.json else "text"
        setup = runner.setup(parameters)
        print(equations.told(automaton, setup, arguments.equations, form), end="")
        return 0
    at = _assigned("--at", arguments.at)
    check_variables(automaton, at)
    if not at:
        # Where no mode agrees with the start, modes are listed all the more.
        with suppress(SimulationError):
            runner.start(parameters)
    setup = runner.setup(parameters)
    state, time, built = setup.initial.copy(), 0.0, 0
    if arguments.until is not None:
        trace = runner.run(parameters, until=arguments.until).trace
        _warn(trace.warnings)
        state, time, built = trace.final.copy(), trace.t_end, trace.counts["modes_built"]
    for name, value in at.items():
        state[automaton.names.index(name)] = value
    listed = listing(
        automaton,
        built=built,
        time=time,
        state=dict(zip(automaton.names, state.tolist(), strict=True)),
        found=feasibility(automaton, setup, state, time),
    )
    if arguments.json:
        _print_json(listed)
    else:
        show(told(listed))
    return 0


def draw(arguments: argparse.Namespace) -> int:
    """Draw the statechart, with the path of a run where asked for or needed; or the scene."""
    from statechart.diagram.machine import lost
    from statechart.diagram.write import SUFFIXES, write
    from statechart.running.drawing import drawn

    path = Path(arguments.output)
    if arguments.scene:
        from statechart.reporting.figure import SUFFIXES as FIGURES
        from statechart.running.drawing import draw_scene

        check_drawing(arguments.output, FIGURES)
        print(draw_scene(_runner(arguments.file), path))
        return 0
    check_drawing(arguments.output, SUFFIXES)
    runner = _runner(arguments.file, progress=not arguments.quiet)
    diagram, trace = drawn(runner, visited=arguments.visited)
    code = 0
    if trace is not None:
        _warn(trace.warnings)
        if not trace.outcome.succeeded:
            _warn([f"the run ended early: {trace.outcome.name}, {trace.message}"])
            code = 1
    write(diagram, path, arguments.guards)
    if path.suffix.lower() == ".scxml" and diagram.machine is not None:
        _warn([f"SCXML does not say {sentence}" for sentence in lost(diagram.machine)])
    print(path)
    return code


def check(arguments: argparse.Namespace) -> int:
    """Test the properties of a model over its ranges; write a model that fails, if one does."""
    from statechart.documents.files import write_atomic
    from statechart.testing.checking import check as check_model

    runner = _runner(arguments.file)
    runner.start()
    with _scratch():
        report = check_model(
            runner.model,
            examples=arguments.examples,
            seed=arguments.seed,
            progress=_teller(arguments, "testing: "),
        )
    pieces, written = Pieces(), None
    if not report.passed:
        path = Path(f"{runner.model.name}_failure.yaml")
        data = report.reproduction.encode()
        pieces.attempt(str(path), lambda: write_atomic(path, data), None)
        written = None if pieces.failed else str(path)
    if arguments.json:
        _print_json({**report.to_json(), "reproduction": written})
    else:
        show(report.told())
        if written is not None:
            print(f"{written} reproduces it")
    _say_left_out(pieces)
    return 0 if report.passed else 1


@contextmanager
def _scratch() -> Iterator[None]:
    """Let Hypothesis keep its notes elsewhere: in the user's folder nothing is left behind."""
    from hypothesis.configuration import set_hypothesis_home_dir

    with tempfile.TemporaryDirectory() as folder:
        set_hypothesis_home_dir(folder)
        try:
            yield
        finally:
            set_hypothesis_home_dir(None)


def _runner(file: str, **options: Any) -> Runner:
    from statechart.running.runner import Runner

    runner = Runner(file, **options)
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    return runner


def _assigned(option: str, pairs: Iterable[tuple[str, T]]) -> dict[str, T]:
    found: dict[str, T] = {}
    for name, value in pairs:
        if name in found:
            raise DeclarationError(f"{option} {name} is given twice", advice="give it once")
        found[name] = value
    return found


def _teller(arguments: argparse.Namespace, before: str = "") -> Callable[[str], None]:
    """Return what is told how far work is, and says it, unless that is not wanted."""

    def tell(line: str) -> None:
        if not arguments.quiet:
            print(f"{before}{line}", file=sys.stderr, flush=True)

    return tell


def _warn(warnings: Iterable[str]) -> None:
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)


def _say_left_out(pieces: Pieces) -> None:
    if pieces.failed:
        print(f"left out: {pieces.text()}", file=sys.stderr)


def _print_json(value: object) -> None:
    # Floats are printed with the fewest digits that read back as the same float.
    print(json.dumps(value, indent=2, allow_nan=False))
