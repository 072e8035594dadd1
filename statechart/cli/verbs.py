"""The verbs of the command line: each takes its arguments and returns the exit code."""

from __future__ import annotations

import argparse
import functools
import gc
import json
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from statechart import interrupts
from statechart.cli import output_files
from statechart.errors import DeclarationError, SimulationError, StatechartError
from statechart.reporting.partial_report import PartialReport
from statechart.tabular import Table, TextBlock, table, write_plain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from statechart.automaton.trace import Trace
    from statechart.running.result import Result
    from statechart.running.runner import Runner


Value = TypeVar("Value")

_SAMPLES = (
    "from version 0.3 on, samples.csv is written only with --samples; add --samples or "
    "--no-samples (trace.nc has the same data)"
)


def validate(arguments: argparse.Namespace) -> int:
    """Read a model and check its initial state; print one line."""
    from statechart.reporting.modes import format_count
    from statechart.tabular import FEW, pluralise

    runner = _runner(arguments.file)
    mode, warnings = runner.start()
    automaton = runner.automaton
    kind = getattr(runner.model, "kind", "model")
    count = format_count(automaton.modes_declared, automaton.modes_total)
    remarks = "".join(f"; warning: {warning}" for warning in warnings)
    start = automaton.label(mode)
    if len(mode) > FEW:
        start = ", ".join(f"{number} {state}" for state, number in Counter(mode).items())
    starts = f", starts in {start}" if start else ""
    place = "" if arguments.file == automaton.name else f"{arguments.file}: "
    print(
        f"{place}{kind} {automaton.name!r} is correct: "
        f"{pluralise(len(automaton.names), 'variable')}, {count}{starts}{remarks}"
    )
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Run a model; print a summary or one object."""
    from statechart.documents.setting import Setting

    parameters = _assigned_values("--set", arguments.parameters)
    runner = _runner(
        arguments.file,
        **{part.name: getattr(arguments, part.name) for part in fields(Setting)},
        study=output_files.stored_study(arguments),
        once=True,
        progress=not arguments.quiet,
    )
    output_files.check_folder(arguments.output)
    to_folder = arguments.output is not None and not output_files.is_store(arguments.output)
    if arguments.samples is not None and not to_folder:
        raise DeclarationError("--samples and --no-samples need --output DIR")
    output_files.check_animation(runner, arguments)
    output_files.check_file("--report", arguments.report, output_files.PAGES)
    if arguments.output is not None:
        import xarray  # noqa: F401, it takes a second that a signal does not leave
    result = runner.run(parameters, until=arguments.until, certify=arguments.certify, throw=False)
    # From here on a part that fails is omitted with a message, and the others are written.
    with interrupts.deferred(), interrupts.limit_time(output_files.PATIENCE):
        complete = _deliver(runner, result, parameters, arguments)
    request = result.asked
    met = request is None or not request.setting.accuracy or request.reached(result.error_estimate)
    return 0 if complete and met and result.trace.outcome.succeeded else 1


def _deliver(
    runner: Runner, result: Result, parameters: Mapping[str, float], arguments: argparse.Namespace
) -> bool:
    """Save and print a run; return whether no part failed."""
    pieces, failure = PartialReport(), ""
    result = replace(result, trace=result.trace.at_hand())

    @functools.cache
    def report_of() -> dict[str, Any]:
        # A run that is saved has its explanations, too.
        explain = arguments.explain or arguments.output is not None
        report = result.to_dict(explain=explain, pieces=pieces)
        if arguments.alternatives:
            others = functools.partial(_alternatives, runner, result, parameters, arguments)
            none = list[dict[str, Any]]()
            report["alternatives"] = pieces.attempt("alternatives", others, none)
        return report

    if arguments.output is not None:
        try:
            _save(result, report_of, pieces, arguments.output, arguments.samples)
        except StatechartError as error:
            failure = str(error)
    report = report_of()
    warn(report["warnings"])
    if arguments.json:
        from statechart.reporting.report import dumps

        print(dumps(report), end="")
    else:
        from statechart.reporting.text import describe_run, explain_events

        show(describe_run(report, arguments.digits))
        if arguments.explain and report["events"]:
            show(["\n", *explain_events(report, arguments.digits)])
    sys.stdout.flush()
    if arguments.animate is not None:
        options = output_files.film_options(arguments) | {"progress": not arguments.quiet}
        draw = functools.partial(result.animate, arguments.animate, **options)
        pieces.attempt(arguments.animate, draw, None)
    if arguments.report is not None:
        study, warnings = output_files.study_for_page(
            runner.model, arguments.report, arguments.output
        )
        warn(warnings)
        page = functools.partial(result.report, arguments.report, study=study)
        pieces.attempt(arguments.report, page, None)
    failure = failure or (f"left out: {pieces.text()}" if pieces.failed else "")
    if failure:
        print(failure, file=sys.stderr)
    return not failure


def _save(
    result: Result,
    report_of: Callable[[], dict[str, Any]],
    pieces: PartialReport,
    output: str,
    samples: bool | None,
) -> None:
    from statechart.documents.setting import Record
    from statechart.reporting.run_store import write_store
    from statechart.reporting.tables import write_run

    if output_files.is_store(output):
        write_store(output, result.observer, result.trace, report_of())
        return
    if samples is None and result.trace.record is Record.MODES:
        samples = True
        warn([_SAMPLES])
    write_run(output, result.observer, result.trace, report_of, pieces, bool(samples))


def view(arguments: argparse.Namespace) -> int:
    """Run a model, write the run as a page, and open that."""
    output_files.check_file("-o", arguments.output, output_files.PAGES)
    runner = _runner(arguments.file, once=True, progress=not arguments.quiet)
    parameters = _assigned_values("--set", arguments.parameters)
    result = runner.run(parameters, until=arguments.until, throw=False)
    warn(result.warnings)
    place = arguments.output or Path(
        tempfile.mkdtemp(prefix="statechart-"), f"{runner.model.name}.html"
    )
    study, warnings = output_files.study_for_page(runner.model, arguments.output)
    warn(warnings)
    page = result.report(place, study=study).resolve()
    print(page)
    _open(page)
    return _warn_of_early_end(result.trace)


def _warn_of_early_end(trace: Trace) -> int:
    if trace.outcome.succeeded:
        return 0
    warn([f"the run ended early: {trace.outcome.name}, {trace.message}"])
    return 1


def _alternatives(
    runner: Runner, result: Result, parameters: Mapping[str, float], arguments: argparse.Namespace
) -> list[dict[str, Any]]:
    """Return where runs under the other choices of the model differ from a run."""
    from statechart.reporting.report import json_safe
    from statechart.running.accuracy import EvaluatedRun

    rows, own = [], EvaluatedRun.of(result.observer, result.trace)
    for choice, other_runner in runner.alternatives().items():
        other = other_runner.run(parameters, until=arguments.until, throw=False)
        found = own.difference(EvaluatedRun.of(other.observer, other.trace), own.scales)
        report = other.to_dict()
        same = found.diverged is None
        row = {"choice": choice, "outcome": other.trace.outcome.name, "same_modes": same}
        row |= {
            "diverged": found.diverged,
            "difference": json_safe(found.largest) if same else None,
        }
        rows.append(row | {part: report[part] for part in ("final", "outputs")})
    return rows


def modes(arguments: argparse.Namespace) -> int:
    """List modes, which of them are possible at a configuration, and every region's chart."""
    from statechart.reporting.modes import check_variables, format_listing, list_modes

    parameters = _assigned_values("--set", arguments.parameters)
    if arguments.latex and arguments.equations is None:
        raise DeclarationError("--latex prints equations: add --equations MODE")
    if arguments.latex and arguments.json:
        raise DeclarationError("--latex and --json exclude each other", advice="write one of them")
    if arguments.equations is not None and (arguments.at or arguments.until is not None):
        advice = "remove --at and --until"
        raise DeclarationError("--equations are the same at every configuration", advice=advice)
    runner = _runner(arguments.file, progress=not arguments.quiet)
    automaton = runner.automaton
    if arguments.equations is not None:
        from statechart.reporting import equations
        from statechart.tabular import ALL_DIGITS

        form = "latex" if arguments.latex else "json" if arguments.json else "text"
        setup = runner.setup(parameters)
        digits = ALL_DIGITS if form == "json" else arguments.digits
        text = equations.format_equations(automaton, setup, arguments.equations, form, digits)
        print(text, end="")
        return 0
    at = _assigned_values("--at", arguments.at)
    check_variables(automaton, at)
    if not at:
        # Modes are listed even if none is consistent with the start.
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
    listed = list_modes(automaton, setup, state, time, built)
    if arguments.json:
        print_json(listed)
    else:
        show(format_listing(listed, arguments.digits))
    return 0


def draw(arguments: argparse.Namespace) -> int:
    """Draw the scene or the statechart, with the path of a run if requested or needed."""
    from statechart.diagram.scxml import unexpressed_parts
    from statechart.diagram.write import SUFFIXES, write
    from statechart.reporting.figure import SUFFIXES as FIGURES
    from statechart.running.drawing import draw_scene, drawn

    output_files.check_file("-o", arguments.output, FIGURES if arguments.scene else SUFFIXES)
    runner = _runner(arguments.file, progress=not arguments.quiet)
    with _target(arguments.output, f"{runner.model.name}.svg") as path:
        if arguments.scene:
            draw_scene(runner, path)
            return 0
        diagram, trace = drawn(runner, visited=arguments.visited)
        code = 0
        if trace is not None:
            warn(trace.warnings)
            code = _warn_of_early_end(trace)
        write(diagram, path, arguments.guards)
        if path.suffix.lower() == ".scxml" and diagram.machine is not None:
            parts = unexpressed_parts(diagram.machine)
            warn(f"the SCXML file leaves out {sentence}" for sentence in parts)
    return code


@contextmanager
def _target(output: str | None, name: str) -> Iterator[Path]:
    """Yield the file to write, and print its name; without one open it, or print it to a pipe."""
    path = Path(output or Path(tempfile.mkdtemp(prefix="statechart-"), name))
    yield path
    if output is None and not sys.stdout.isatty():
        sys.stdout.write(path.read_text(encoding="utf-8"))
        shutil.rmtree(path.parent)
        return
    print(path)
    if output is None:
        _open(path)


def _open(path: Path) -> None:
    import webbrowser

    if not webbrowser.open(path.resolve().as_uri()):
        print("no browser was found; open the file yourself", file=sys.stderr)


def trade(arguments: argparse.Namespace) -> int:
    """Run a model at many settings; print cost and error of each."""
    from statechart.study.text import describe_study, to_dict
    from statechart.study.trade import trade as study_of

    output_files.check_folder(arguments.output)
    runner = _runner(arguments.file)
    study = study_of(runner, folder=arguments.output, progress=_printer(arguments))
    pieces = PartialReport()
    if arguments.output is not None:
        from statechart.study.figure import write_study_figure

        write = functools.partial(write_study_figure, arguments.output, study)
        pieces.attempt("tables and figure", write, None)
    if arguments.json:
        print_json(to_dict(study))
    else:
        show(describe_study(study))
    _print_failed_parts(pieces)
    if not study.complete:
        again = "the same command continues" if arguments.output else "-o DIR would keep it"
        print(f"interrupted; {again}", file=sys.stderr)
    return 0 if study.complete and not pieces.failed else 1


def sweep(arguments: argparse.Namespace) -> int:
    """Run a model over its parameters; print outcomes of cells and ranges of outputs."""
    from statechart.documents.setting import Setting
    from statechart.sweeps import results
    from statechart.sweeps.ranges import cells
    from statechart.sweeps.sweep import make_plan, run_plan
    from statechart.sweeps.workers import crew

    ranges = _assigned_values("--over", arguments.over)
    over, samples = cells(ranges, arguments.samples, arguments.sobol)
    names = {part.name for part in fields(Setting)} & set(vars(arguments))
    setting = Setting(**{name: getattr(arguments, name) for name in names})
    _collect_garbage()
    plan = make_plan(
        arguments.file, over, samples, setting, until=arguments.until, outputs=arguments.outputs
    )
    output_files.check_sweep(arguments, plan)
    store = arguments.output if output_files.is_store(arguments.output) else None
    shown = not arguments.quiet
    workers = arguments.workers and min(arguments.workers, plan.size)
    with crew(workers, arguments.scheduler) as executor:
        made = run_plan(plan, executor, store=store, resume=arguments.resume, progress=shown)
    pieces = PartialReport()
    with interrupts.deferred(), interrupts.limit_time(output_files.PATIENCE):
        data = made.dataset(loaded=True)
        output_files.write_sweep(arguments, plan, data, pieces)
        report = results.to_dict(plan, data, where=arguments.output)
        if arguments.json:
            print_json(report)
        else:
            show(results.format_text(report, arguments.digits))
        _print_failed_parts(pieces)
    if made.ended:
        again = "--resume goes on" if store else "-o STORE.zarr keeps what is done"
        print(f"{made.ended}; {again}", file=sys.stderr)
    return 0 if results.succeeded(report) and not pieces.failed else 1


def check(arguments: argparse.Namespace) -> int:
    """Test the properties of a model over its ranges; write a model that fails, if one does."""
    from statechart.documents.files import write_atomic
    from statechart.testing.checking import check as check_model

    runner = _runner(arguments.file)
    warn(runner.start()[1])
    with _hypothesis_folder():
        options = {"examples": arguments.examples, "seed": arguments.seed}
        report = check_model(runner.model, **options, progress=_printer(arguments, "testing: "))
    pieces, written = PartialReport(), None
    if not report.passed:
        path = Path(f"{runner.model.name}_failure.yaml")
        write = functools.partial(write_atomic, path, report.reproduction.encode())
        pieces.attempt(str(path), write, None)
        written = None if pieces.failed else str(path)
    if arguments.json:
        print_json({**report.to_json(), "reproduction": written})
    else:
        show(report.blocks())
        if written is not None:
            print(f"{written} reproduces it")
    _print_failed_parts(pieces)
    return 0 if report.passed else 1


@contextmanager
def _hypothesis_folder() -> Iterator[None]:
    """Store the example database of Hypothesis in a temporary folder."""
    from hypothesis.configuration import set_hypothesis_home_dir

    with tempfile.TemporaryDirectory() as folder:
        set_hypothesis_home_dir(folder)
        try:
            yield
        finally:
            set_hypothesis_home_dir(None)


def schema(arguments: argparse.Namespace) -> int:
    """Print the JSON Schema of one kind of document, or of all."""
    from statechart.loading.load import schema as schema_of

    print(schema_of(arguments.kind), end="")
    return 0


def compile(arguments: argparse.Namespace) -> int:
    """Compile all kernels, with a progress line and the total time on stderr."""
    from statechart.cli.ahead_of_time import compile_kernels

    compile_kernels(quiet=arguments.quiet)
    return 0


def new(arguments: argparse.Namespace) -> int:
    """Write a scene to start from."""
    from statechart.documents.files import write_atomic
    from statechart.documents.yaml_reader import read_text
    from statechart.documents.yaml_text import resolve
    from statechart.formulas.syntax import NAME
    from statechart.formulas.tree import RESERVED
    from statechart.loading.kind import kind
    from statechart.loading.load import interpret, line

    name = arguments.name
    if not NAME.fullmatch(name) or name in RESERVED or not isinstance(resolve(name), str):
        advice = "letters, digits and _, not beginning with a digit, no word of formulas or YAML"
        meant = re.sub(r"\W", "_", name.removesuffix(".yaml"), flags=re.ASCII)
        if meant != name and NAME.fullmatch(meant):
            advice = f"write statechart new {meant}"
        raise DeclarationError(f"{name!r} cannot be the name of a model", advice=advice)
    path = Path(f"{name}.yaml")
    if path.exists() or path.is_symlink():
        raise DeclarationError(f"{path} exists already", advice="choose another name")
    output_files.check_file("new", str(path))
    text = line("scene") + kind("scene").starter.read_text(encoding="utf-8").replace("NAME", name)
    interpret(read_text(text, str(path)))
    write_atomic(path, text.encode())
    print(f"{path} written; run it with: statechart run {path}")
    return 0


def completion(arguments: argparse.Namespace) -> int:
    """Print the completion script of a shell."""
    from statechart.cli.grammar import script

    print(script(arguments.shell))
    return 0


def _runner(file: str, **options: Any) -> Runner:
    """Return the runner of a model; its runs need garbage collection."""
    from statechart.running.runner import Runner

    runner = Runner(file, **options)
    _collect_garbage()
    return runner


def _collect_garbage() -> None:
    """Turn garbage collection on, except for objects that exist already."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def _assigned_values(option: str, pairs: Iterable[tuple[str, Value]]) -> dict[str, Value]:
    """Return pairs of names and values as a dictionary, each name once."""
    found: dict[str, Value] = {}
    for name, value in pairs:
        if name in found:
            raise DeclarationError(f"{option} {name} is given twice", advice="give it once")
        found[name] = value
    return found


def _printer(arguments: argparse.Namespace, before: str = "") -> Callable[[str], None]:
    """Return a function that prints lines of progress to stderr, unless --quiet."""

    def print_line(line: str) -> None:
        if not arguments.quiet:
            print(f"{before}{line}", file=sys.stderr, flush=True)

    return print_line


def _print_failed_parts(pieces: PartialReport) -> None:
    if pieces.failed:
        print(f"left out: {pieces.text()}", file=sys.stderr)


def show(blocks: Iterable[TextBlock]) -> None:
    """Print a text."""
    if not sys.stdout.isatty():
        print(write_plain(blocks), end="")
        return
    from rich.console import Console

    console = Console(markup=False, emoji=False, highlight=False)
    for block in blocks:
        if isinstance(block, Table):
            lines = table(block.rows)
            if max(map(len, lines.splitlines())) > console.width:
                console.print(_with_rules(block))
                continue
            head, _, rest = lines.partition("\n")
            console.print(head, style="bold" if block.headed else None)
            console.print(rest, end="", soft_wrap=True)
        else:
            console.print(block, end="", soft_wrap=True)


def _with_rules(table: Table) -> object:
    from rich.table import Table as Ruled
    from rich.text import Text

    rows = [[Text(cell) for cell in row] for row in table.rows]
    head = rows.pop(0) if table.headed else [Text()] * len(rows[0])
    ruled = Ruled(box=None, show_header=table.headed, pad_edge=False, header_style="bold")
    for cell in head:
        ruled.add_column(cell, overflow="fold")
    for row in rows:
        ruled.add_row(*row)
    return ruled


def warn(warnings: Iterable[str]) -> None:
    """Print warnings to stderr."""
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)


def print_json(value: object) -> None:
    """Print plain data as JSON."""
    print(json.dumps(value, indent=2, allow_nan=False))
