"""The verbs of the command line: each takes its arguments and returns the exit code."""

from __future__ import annotations

import argparse
import functools
import sys
import tempfile
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart import interrupts
from statechart.cli.arguments import assigned, runner_of
from statechart.cli.places import (
    PATIENCE,
    check_animation,
    check_drawing,
    check_folder,
    check_page,
    is_store,
    kept_study,
    showing,
    shown_study,
)
from statechart.cli.terminal import print_json, show, warn
from statechart.errors import DeclarationError, SimulationError, StatechartError
from statechart.reporting.pieces import Pieces

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from statechart.running.result import Result
    from statechart.running.runner import Runner


_SAMPLES = (
    "samples.csv is written from version 0.3 on only where it is asked for: say --samples, or "
    "--no-samples; trace.nc has the same"
)


def validate(arguments: argparse.Namespace) -> int:
    """Read a model and check its initial state; print one line."""
    from statechart.reporting.modes import counted
    from statechart.tabular import ends, several

    runner = runner_of(arguments.file)
    mode, warnings = runner.start()
    automaton = runner.automaton
    kind = getattr(runner.model, "kind", "model")
    count = counted(automaton.modes_declared, automaton.modes_total)
    remarks = "".join(f"; warning: {warning}" for warning in warnings)
    # Of many regions a label is longer than what is told.
    states = automaton.label(mode).split()
    start = " ".join(f"... {s} more ..." if isinstance(s, int) else s for s in ends(states))
    starts = f", starts in {start}" if start else ""
    print(
        f"{arguments.file}: {kind} {automaton.name!r} is correct: "
        f"{several(len(automaton.names), 'variable')}, {count}{starts}{remarks}"
    )
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Run a model; print a summary or one object."""
    from statechart.documents.setting import Setting

    parameters = assigned("--set", arguments.parameters)
    runner = runner_of(
        arguments.file,
        **{part.name: getattr(arguments, part.name) for part in fields(Setting)},
        study=kept_study(arguments),
        once=True,
        progress=not arguments.quiet,
    )
    check_folder(arguments.output)
    if arguments.samples is not None and (arguments.output is None or is_store(arguments.output)):
        raise DeclarationError(
            "--samples and --no-samples are about the tables of --output",
            advice="say --output DIR, too, or leave them out",
        )
    check_animation(runner, arguments.animate, showing(arguments))
    check_page("--report", arguments.report)
    if arguments.output is not None:
        import xarray  # noqa: F401, it takes a second that a signal does not leave
    result = runner.run(parameters, until=arguments.until, certify=arguments.certify, throw=False)
    # From here on nothing is lost: what fails is left out, and what is left out is said.
    with interrupts.held(), interrupts.limited(PATIENCE):
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
        try:
            _save(result, made, pieces, arguments.output, arguments.samples)
        except StatechartError as error:
            failure = str(error)
    report = made()
    warn(report["warnings"])
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
        draw = functools.partial(
            result.animate, arguments.animate, progress=shown, **showing(arguments)
        )
        pieces.attempt(arguments.animate, draw, None)
    if arguments.report is not None:
        study, warnings = shown_study(runner.model, arguments.report, arguments.output)
        warn(warnings)
        page = functools.partial(result.report, arguments.report, study=study)
        pieces.attempt(arguments.report, page, None)
    failure = failure or (f"left out: {pieces.text()}" if pieces.failed else "")
    if failure:
        print(failure, file=sys.stderr)
    return not failure


def _save(
    result: Result,
    made: Callable[[], dict[str, Any]],
    pieces: Pieces,
    output: str,
    samples: bool | None,
) -> None:
    """Write a run into a folder or a store."""
    from statechart.documents.setting import Record
    from statechart.reporting.run_store import write_store
    from statechart.reporting.tables import write_run

    if is_store(output):
        write_store(output, result.observer, result.trace, made())
        return
    if samples is None and result.trace.record is Record.MODES:
        samples = True
        warn([_SAMPLES])
    write_run(output, result.observer, result.trace, made, pieces, bool(samples))


def view(arguments: argparse.Namespace) -> int:
    """Run a model, write the run as a page, and open that."""
    import webbrowser

    check_page("-o", arguments.output)
    runner = runner_of(arguments.file, once=True, progress=not arguments.quiet)
    parameters = assigned("--set", arguments.parameters)
    result = runner.run(parameters, until=arguments.until, throw=False)
    warn(result.warnings)
    place = arguments.output or Path(
        tempfile.mkdtemp(prefix="statechart-"), f"{runner.model.name}.html"
    )
    study, warnings = shown_study(runner.model, arguments.output)
    warn(warnings)
    page = result.report(place, study=study).resolve()
    print(page)
    if not webbrowser.open(page.as_uri()):
        print("no browser could be opened; open the page with one", file=sys.stderr)
    if not result.trace.outcome.succeeded:
        warn([f"the run ended early: {result.trace.outcome.name}, {result.trace.message}"])
    return 0 if result.trace.outcome.succeeded else 1


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

    parameters = assigned("--set", arguments.parameters)
    if arguments.latex and arguments.equations is None:
        raise DeclarationError("--latex is for equations: say --equations MODE, too")
    if arguments.latex and arguments.json:
        raise DeclarationError("--latex and --json exclude each other", advice="say one of them")
    if arguments.equations is not None and (arguments.at or arguments.until is not None):
        raise DeclarationError(
            "--equations hold at every configuration", advice="leave --at and --until out"
        )
    runner = runner_of(arguments.file, progress=not arguments.quiet)
    automaton = runner.automaton
    if arguments.equations is not None:
        from statechart.reporting import equations

        form = "latex" if arguments.latex else "json" if arguments.json else "text"
        setup = runner.setup(parameters)
        print(equations.told(automaton, setup, arguments.equations, form), end="")
        return 0
    at = assigned("--at", arguments.at)
    check_variables(automaton, at)
    if not at:
        # Where no mode agrees with the start, modes are listed all the more.
        with suppress(SimulationError):
            runner.start(parameters)
    setup = runner.setup(parameters)
    state, time, built = setup.initial.copy(), 0.0, 0
    if arguments.until is not None:
        trace = runner.run(parameters, until=arguments.until).trace
        warn(trace.warnings)
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
        print_json(listed)
    else:
        show(told(listed))
    return 0


def draw(arguments: argparse.Namespace) -> int:
    """Draw the statechart, with the path of a run where asked for or needed; or the scene."""
    from statechart.diagram.scxml import lost
    from statechart.diagram.write import SUFFIXES, write
    from statechart.running.drawing import drawn

    path = Path(arguments.output)
    if arguments.scene:
        from statechart.reporting.figure import SUFFIXES as FIGURES
        from statechart.running.drawing import draw_scene

        check_drawing(arguments.output, FIGURES)
        print(draw_scene(runner_of(arguments.file), path))
        return 0
    check_drawing(arguments.output, SUFFIXES)
    runner = runner_of(arguments.file, progress=not arguments.quiet)
    diagram, trace = drawn(runner, visited=arguments.visited)
    code = 0
    if trace is not None:
        warn(trace.warnings)
        if not trace.outcome.succeeded:
            warn([f"the run ended early: {trace.outcome.name}, {trace.message}"])
            code = 1
    write(diagram, path, arguments.guards)
    if path.suffix.lower() == ".scxml" and diagram.machine is not None:
        warn([f"SCXML does not say {sentence}" for sentence in lost(diagram.machine)])
    print(path)
    return code
