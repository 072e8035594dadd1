"""The command line: its grammar, and what errors become."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from statechart import compiling, interrupts

if TYPE_CHECKING:
    # Signals are listened to before anything is imported that takes long.
    import argparse
    from collections.abc import Callable, Sequence


_DONE, _FAILED, _WRONG = 0, 1, 2

_EPILOG = """\
FILE is a path, or the name of a shipped model such as toppling_stick.
Results go to stdout, progress and warnings to stderr.
Exit code: 0 done, 1 the run or the check failed, 2 the input is wrong.
"""


# Imports make a million objects that stay; looking for garbage among them is a tenth of a start.
_COLLECTED_AFTER = 200_000


def program() -> int:
    """Be the process `statechart`: `main` with its signals, streams and garbage looked after."""
    try:
        interrupts.listen()
        from statechart.cli.streams import be_quiet, take_streams

        take_streams()
        be_quiet()
        compiling.announce(lambda line: print(line, file=sys.stderr, flush=True))
        import gc

        gc.set_threshold(_COLLECTED_AFTER)
        return main()
    except KeyboardInterrupt:
        return _say("interrupted", _FAILED)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default. With ``STATECHART_DEBUG=1`` in the environment an
        unexpected error shows where it came from.

    Returns
    -------
    int
        0 done, 1 the run or the check failed, 2 the input is wrong.
    """
    try:
        chosen = _parser().parse_args(arguments)
    except SystemExit as exit_:
        return exit_.code if isinstance(exit_.code, int) else _WRONG
    from statechart.errors import DeclarationError, StatechartError

    try:
        verb: Callable[[argparse.Namespace], int] = _verb(chosen.verb)
        code = verb(chosen)
        sys.stdout.flush()
        return code or (_say("interrupted", _FAILED) if interrupts.arrived() else _DONE)
    except DeclarationError as error:
        return _say(str(error), _WRONG)
    except StatechartError as error:
        file = getattr(chosen, "file", "")
        return _say(f"{file}: {error}" if file else str(error), _FAILED)
    except KeyboardInterrupt:
        return _say("interrupted", _FAILED)
    except BrokenPipeError:
        # Whoever read our output has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _DONE
    except OSError as error:
        return _say(f"cannot go on: {error.strerror or error}", _FAILED)
    except Exception as error:
        if os.environ.get("STATECHART_DEBUG") == "1":
            raise
        return _say(_unexpected(error), _FAILED)


def _unexpected(error: Exception) -> str:
    if interrupts.arrived():
        # In compiled code a signal becomes another error.
        return "interrupted"
    causes: list[BaseException] = [error]
    while (cause := causes[-1].__cause__ or causes[-1].__context__) and cause not in causes:
        causes.append(cause)
    if any(isinstance(cause, MemoryError) for cause in causes):
        return "out of memory; end the run earlier, or give the process more"
    if any(isinstance(cause, RecursionError) for cause in causes):
        limit = sys.getrecursionlimit()
        return f"Python's recursion limit, {limit}, is too low; its usual 1000 is enough"
    if isinstance(error, ImportError):
        return f"a library cannot be loaded: {error}"
    return (
        f"internal error, {type(error).__name__}: {error}\n"
        "please report it; STATECHART_DEBUG=1 shows where it came from"
    )


def _verb(name: str) -> Callable[[argparse.Namespace], int]:
    from statechart.cli import verbs as cli_verbs

    verb: Callable[[argparse.Namespace], int] = getattr(cli_verbs, name)
    return verb


def _say(message: str, code: int) -> int:
    print(message, file=sys.stderr)
    return code


# A grammar reads best in one piece, in the order in which --help shows it.
def _parser() -> argparse.ArgumentParser:
    import argparse

    parser = argparse.ArgumentParser(
        prog="statechart",
        description="Statecharts of rigid bodies in contact: declare, draw, run, check.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def verb(name: str, words: str, *, file: bool = True) -> argparse.ArgumentParser:
        added = verbs.add_parser(name, help=words, description=words, allow_abbrev=False)
        if file:
            added.add_argument("file", metavar="FILE", help="a path, or a shipped model's name")
        return added

    verb("validate", "read a model and check it, its initial state too")
    run = verb("run", "run a model and report what happened")
    _settable(run)
    run.add_argument("--until", metavar="T", type=_number, help="end of the run")
    run.add_argument("--engine", choices=("auto", "taylor", "scipy", "impulse"))
    run.add_argument("--step", metavar="H", type=_number, help="of the engine impulse, in time")
    run.add_argument(
        "--impulse-tolerance", metavar="R", type=_number,
        help="of the impulses of a step of the engine impulse, in parts of its fastest approach",
    )  # fmt: skip
    run.add_argument(
        "--impulse-bound",
        metavar="R",
        type=_number,
        help="of the same: what is above it ends the run",
    )
    run.add_argument(
        "--max-step", metavar="H", type=_number, help="longest step of the other engines, in time"
    )
    run.add_argument(
        "--method", metavar="M",
        help="RK45, DOP853, Radau or LSODA (engine scipy), 'long double' (engine taylor)",
    )  # fmt: skip
    error = run.add_mutually_exclusive_group()
    error.add_argument("--accuracy", metavar="A", type=_number, help="relative error allowed")
    error.add_argument("--tolerance", metavar="R", type=_number, help="of every step, relative")
    error.add_argument(
        "--budget", metavar="S", type=_number, help="best accuracy within so many seconds"
    )
    run.add_argument(
        "--certify", action="store_true",
        help="prove of every step how far it is off, and estimate the error of the whole",
    )  # fmt: skip
    run.add_argument(
        "--alternatives", action="store_true",
        help="run under the other choices of simultaneous: too, and show where that matters",
    )  # fmt: skip
    run.add_argument(
        "--explain", action="store_true",
        help="of every event: what fired, the margins, what else was considered, the energy",
    )  # fmt: skip
    run.add_argument("--output", metavar="DIR", help="write tables, data set and figure there")
    run.add_argument(
        "--animate", metavar="FILM", help="draw the bodies in motion: .gif, or .mp4 with ffmpeg"
    )
    run.add_argument(
        "--report", metavar="PAGE", help="write the run as one page to look at and to send: .html"
    )
    run.add_argument("--json", action="store_true", help="print one JSON object")
    trade = verb("trade", "measure what speed costs in accuracy")
    trade.add_argument("--json", action="store_true", help="print one JSON object")
    trade.add_argument(
        "-o", "--output", metavar="DIR",
        help="keep table, data and figure there; what was interrupted goes on from there",
    )  # fmt: skip
    sweep = verb("sweep", "run a model over its parameters: grids, tables, samples")
    _sweeping(sweep)
    modes = verb("modes", "list a model's modes, which are possible, and their transitions")
    _settable(modes)
    where = modes.add_mutually_exclusive_group()
    where.add_argument(
        "--at", metavar="NAME=VALUE", action="append", default=[], type=_place,
        help="judge another configuration than the initial one, such as bar.angle=0.3",
    )  # fmt: skip
    where.add_argument("--until", metavar="T", type=_number, help="judge where a run is then")
    modes.add_argument("--json", action="store_true", help="print one JSON object")
    modes.add_argument(
        "--equations", metavar="MODE",
        help="print the equations of motion of a mode, such as 'tip:pin' or 'A:free B:slide+'",
    )  # fmt: skip
    modes.add_argument("--latex", action="store_true", help="print them in LaTeX")
    draw = verb("draw", "draw the statechart of a model, or its scene")
    draw.add_argument(
        "-o",
        "--output",
        metavar="PATH",
        required=True,
        help=".svg .png .pdf .dot .mmd .scxml .graphml",
    )
    what = draw.add_mutually_exclusive_group()
    what.add_argument(
        "--visited", action="store_true", help="run, and draw the modes and the path it took"
    )
    what.add_argument(
        "--scene", action="store_true",
        help="draw bodies, surfaces and contacts where a run starts: .svg .png .pdf",
    )  # fmt: skip
    draw.add_argument(
        "--guards", choices=("legend", "inline"), default="legend",
        help="guards and resets once below, or at every arrow; legend",
    )  # fmt: skip
    check = verb("check", "test a model's invariants over its ranges of parameters")
    check.add_argument(
        "--examples", metavar="N", type=_positive, default=50, help="per property; 50"
    )
    check.add_argument("--seed", metavar="S", type=_count, help="repeats a check exactly")
    check.add_argument("--json", action="store_true", help="print one JSON object")
    schema = verb("schema", "print the JSON Schema of the documents", file=False)
    schema.add_argument("kind", nargs="?", metavar="KIND", help="scene or chart; else both")
    new = verb("new", "write a commented scene to start from", file=False)
    new.add_argument("name", metavar="NAME")
    return parser


def _sweeping(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--over", metavar="NAME=RANGE", action="append", default=[], type=_range,
        help="values of a parameter: lin:A:B:N, log:A:B:N, or 0.1,1/3,inf; "
        "all combinations of them are run",
    )  # fmt: skip
    cells = parser.add_mutually_exclusive_group()
    cells.add_argument(
        "--sobol", metavar="N", type=_positive,
        help="so many points of a Sobol sequence over NAME=lin:A:B, a power of two",
    )  # fmt: skip
    cells.add_argument(
        "--samples", metavar="TABLE.csv", help="a column for every parameter, a row for every run"
    )
    parser.add_argument(
        "--outputs", metavar="NAMES", type=_names, help="separated by commas; else all"
    )
    parser.add_argument("--until", metavar="T", type=_number, help="end of the runs")
    parser.add_argument("--engine", choices=("auto", "taylor", "scipy", "impulse"))
    parser.add_argument("--step", metavar="H", type=_number, help="of the engine impulse, in time")
    error = parser.add_mutually_exclusive_group()
    error.add_argument("--accuracy", metavar="A", type=_number, help="relative error allowed")
    error.add_argument("--tolerance", metavar="R", type=_number, help="of every step, relative")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", metavar="N", type=_positive, help="processes of this machine")
    where.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster: tcp://HOST:PORT")
    parser.add_argument(
        "-o", "--output", metavar="PATH",
        help="STORE.zarr, which is written block by block, or FILE.nc",
    )  # fmt: skip
    parser.add_argument("--resume", action="store_true", help="go on with the sweep in STORE.zarr")
    parser.add_argument("--plot", metavar="PICTURE", help="draw it: .svg .png .pdf")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _settable(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set", dest="parameters", metavar="NAME=VALUE", action="append", default=[],
        type=_assignment, help="give a parameter another value: a number, 1/3, inf, 20*pi/180",
    )  # fmt: skip


def _number(text: str) -> float:
    import argparse

    from statechart.errors import FormulaError
    from statechart.formulas.formula import parse

    try:
        return parse(text).value({})
    except FormulaError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from None


def _assignment(text: str) -> tuple[str, float]:
    import argparse

    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VALUE")
    return name.strip(), _number(value)


def _range(text: str) -> tuple[str, str]:
    import argparse

    name, equals, values = text.partition("=")
    if not equals or not name.strip() or not values.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=RANGE")
    return name.strip(), values.strip()


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _place(text: str) -> tuple[str, float]:
    import argparse
    import math

    name, value = _assignment(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r}: must be finite")
    return name, value


def _count(text: str) -> int:
    import argparse

    if not text.isdecimal() or len(text) > 18:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
    return int(text)


def _positive(text: str) -> int:
    import argparse

    count = _count(text)
    if count == 0:
        raise argparse.ArgumentTypeError("at least 1 is needed")
    return count


if __name__ == "__main__":
    sys.exit(program())
