"""The verbs that run a model many times; see `verbs`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from statechart import interrupts
from statechart.cli.arguments import assigned, runner_of, teller
from statechart.cli.places import PATIENCE, check_folder
from statechart.cli.terminal import print_json, say_left_out, show, warn
from statechart.reporting.pieces import Pieces

if TYPE_CHECKING:
    from collections.abc import Iterator


def trade(arguments: argparse.Namespace) -> int:
    """Run a model at many settings; print what each costs and gives."""
    from statechart.study.report import report, told
    from statechart.study.trade import trade as study_of

    check_folder(arguments.output)
    runner = runner_of(arguments.file)
    study = study_of(
        runner,
        folder=arguments.output,
        progress=teller(arguments),
    )
    pieces = Pieces()
    if arguments.output is not None:
        from statechart.study.figure import write

        pieces.attempt("tables and figure", lambda: write(arguments.output, study), None)
    if arguments.json:
        print_json(report(study))
    else:
        show(told(study))
    say_left_out(pieces)
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

    over, samples = cells(assigned("--over", arguments.over), arguments.samples, arguments.sobol)
    names = {part.name for part in fields(Setting)} & set(vars(arguments))
    setting = Setting(**{name: getattr(arguments, name) for name in names})
    plan = planned(
        arguments.file, over, samples, setting, until=arguments.until, outputs=arguments.outputs
    )
    target = Target(arguments.output, arguments.plot, arguments.resume)
    target.check(plan)
    shown = not arguments.quiet
    workers = arguments.workers and min(arguments.workers, plan.size)
    with crew(workers, arguments.scheduler) as executor:
        made = make(plan, executor, store=target.store, resume=arguments.resume, progress=shown)
    pieces = Pieces()
    with interrupts.held(), interrupts.limited(PATIENCE):
        data = made.loaded()
        target.write(plan, data, pieces)
        told = summary.report(plan, data, where=arguments.output)
        if arguments.json:
            print_json(told)
        else:
            show(summary.text(told))
        say_left_out(pieces)
    if made.ended:
        again = "--resume goes on" if target.store else "-o STORE.zarr keeps what is done"
        print(f"{made.ended}; {again}", file=sys.stderr)
    return 0 if summary.succeeded(told) and not pieces.failed else 1


def check(arguments: argparse.Namespace) -> int:
    """Test the properties of a model over its ranges; write a model that fails, if one does."""
    from statechart.documents.files import write_atomic
    from statechart.testing.checking import check as check_model

    runner = runner_of(arguments.file)
    warn(runner.start()[1])
    with _scratch():
        report = check_model(
            runner.model,
            examples=arguments.examples,
            seed=arguments.seed,
            progress=teller(arguments, "testing: "),
        )
    pieces, written = Pieces(), None
    if not report.passed:
        path = Path(f"{runner.model.name}_failure.yaml")
        data = report.reproduction.encode()
        pieces.attempt(str(path), lambda: write_atomic(path, data), None)
        written = None if pieces.failed else str(path)
    if arguments.json:
        print_json({**report.to_json(), "reproduction": written})
    else:
        show(report.told())
        if written is not None:
            print(f"{written} reproduces it")
    say_left_out(pieces)
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
