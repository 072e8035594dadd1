"""The grammar of the command line: verbs, options, and the types of their values."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import NoReturn

from statechart.errors import close_matches

# A count that no machine comes to.
_UNCOUNTABLE = 10**18 + 1

SHELLS = ("bash", "zsh", "fish")
"""Those whose commands can be completed."""

_EPILOG = """\
FILE is a path, or the name of a shipped model such as toppling_stick.
Results go to stdout, progress and warnings to stderr.
Exit code: 0 done, 1 the run or the check failed, 2 the input is wrong.
"""


def parser() -> argparse.ArgumentParser:
    """Return the grammar of the command line: verbs in the order in which --help shows them."""
    whole = _Parser(
        prog="statechart",
        description="Statecharts of rigid bodies in contact: declare, draw, run, check.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    whole.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    verbs = whole.add_subparsers(dest="verb", required=True, metavar="VERB")

    def verb(name: str, words: str, *, file: bool = True) -> argparse.ArgumentParser:
        added = verbs.add_parser(name, help=words, description=words, allow_abbrev=False)
        if file:
            added.add_argument("file", metavar="FILE", help="a path, or a shipped model's name")
            added.add_argument(
                "-q", "--quiet", action="store_true",
                help="say nothing of progress; warnings and errors remain",
            )  # fmt: skip
        return added

    verb("validate", "read a model and check it, its initial state too")
    run = verb("run", "run a model and report what happened")
    _settable(run)
    _running(run)
    _reporting(run)
    _viewing(verb("view", "run a model, write the run as a page and open it in the browser"))
    _trading(verb("trade", "measure what speed costs in accuracy"))
    _sweeping(verb("sweep", "run a model over its parameters: grids, tables, samples"))
    _listing(verb("modes", "list a model's modes, which are possible, and their transitions"))
    _drawing(verb("draw", "draw the statechart of a model, or its scene"))
    _checking(verb("check", "test a model's invariants over its ranges of parameters"))
    ahead = verb("compile", "compile all numerical kernels, once per machine", file=False)
    ahead.add_argument("-q", "--quiet", action="store_true", help="show no progress")
    schema = verb("schema", "print the JSON Schema of the documents", file=False)
    schema.add_argument("kind", nargs="?", metavar="KIND", help="scene or chart; else both")
    new = verb("new", "write a commented scene to start from", file=False)
    new.add_argument("name", metavar="NAME", help="of the model; NAME.yaml is written")
    completion = verb("completion", "print what completes commands in a shell", file=False)
    completion.epilog = (
        'source <(statechart completion bash); eval "$(statechart completion zsh)"; '
        "statechart completion fish | source"
    )
    completion.add_argument("shell", choices=SHELLS, help="the shell that is to complete")
    return whole


def read(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return what a command line says; end the process with the reason where it cannot be read."""
    whole = parser()
    chosen, unknown = whole.parse_known_args(arguments)
    if unknown:
        (verbs,) = (one for one in whole._actions if isinstance(one, argparse._SubParsersAction))
        verb: argparse.ArgumentParser = verbs.choices[chosen.verb]
        verb.error(_unknown(unknown[0], verb))
    return chosen


def _unknown(argument: str, verb: argparse.ArgumentParser) -> str:
    name = argument.partition("=")[0]
    assigned = [a.option_strings[0] for a in verb._actions if str(a.metavar).startswith("NAME=")]
    if name != argument and assigned and not name.startswith("-"):
        return f"{argument!r} is left over; write {assigned[0]} before each"
    if not name.startswith("-"):
        return f"{argument!r} is left over; what has blanks stands in quotes"
    if name in verb._option_string_actions:
        return f"{name} stands behind the verb"
    advice = close_matches(name, verb._option_string_actions)
    return f"no option {name}; {advice}"


def _running(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--until", metavar="T", type=_number, help="end of the run")
    _engine(parser)
    parser.add_argument(
        "--impulse-tolerance", metavar="R", type=_number,
        help="of the impulses of a step of the engine impulse, in parts of its fastest approach",
    )  # fmt: skip
    parser.add_argument(
        "--impulse-bound",
        metavar="R",
        type=_number,
        help="of the same: what is above it ends the run",
    )
    parser.add_argument(
        "--record",
        choices=("modes", "poses", "nothing"),
        help="what is kept of a run of the engine impulse: modes and their events, the states at "
        "every step, or start, end and outputs alone",
    )
    parser.add_argument(
        "--max-step", metavar="H", type=_number, help="longest step of the other engines, in time"
    )
    parser.add_argument(
        "--method", metavar="M",
        help="RK45, DOP853, Radau or LSODA (engine scipy), 'long double' (engine taylor)",
    )  # fmt: skip
    error = parser.add_mutually_exclusive_group()
    error.add_argument("--accuracy", metavar="A", type=_number, help="relative error allowed")
    error.add_argument("--tolerance", metavar="R", type=_number, help="of every step, relative")
    error.add_argument(
        "--budget", metavar="S", type=_number, help="best accuracy within so many seconds"
    )


def _reporting(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--certify", action="store_true",
        help="prove of every step how far it is off, and estimate the error of the whole",
    )  # fmt: skip
    parser.add_argument(
        "--alternatives", action="store_true",
        help="run under the other choices of simultaneous: too, and show where that matters",
    )  # fmt: skip
    parser.add_argument(
        "--explain", action="store_true",
        help="of every event: what fired, the margins, what else was considered, the energy",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", metavar="DIR",
        help="write tables, data set and figure there; to STORE.zarr the states at every step",
    )  # fmt: skip
    parser.add_argument(
        "--samples", action=argparse.BooleanOptionalAction,
        help="write samples.csv there, too, which says what trace.nc says",
    )  # fmt: skip
    parser.add_argument(
        "--animate", metavar="FILM", help="draw the bodies in motion: .gif, or .mp4 with ffmpeg"
    )
    parser.add_argument(
        "--speed", metavar="V", type=_number,
        help="of the film: units of the run's time that pass in a second",
    )  # fmt: skip
    parser.add_argument(
        "--size", metavar="PIXELS", type=_count, help="of the film: its longer side; 720"
    )
    parser.add_argument(
        "--trail", metavar="T", type=_number,
        help="of the film: how far back in time trails reach; 0 for none",
    )  # fmt: skip
    parser.add_argument(
        "--report", metavar="PAGE", help="write the run as one page to look at and to send: .html"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _viewing(parser: argparse.ArgumentParser) -> None:
    _settable(parser)
    parser.add_argument("--until", metavar="T", type=_number, help="end of the run")
    parser.add_argument(
        "-o", "--output", metavar="PAGE", help="write the page there, and not to a passing folder"
    )  # fmt: skip


def _trading(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "-o", "--output", metavar="DIR",
        help="keep table, data and figure there; what was interrupted goes on from there",
    )  # fmt: skip


def _listing(parser: argparse.ArgumentParser) -> None:
    _settable(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--at", metavar="NAME=VALUE", action="append", default=[], type=_place,
        help="judge another configuration than the initial one, such as bar.angle=0.3",
    )  # fmt: skip
    where.add_argument("--until", metavar="T", type=_number, help="judge where a run is then")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--equations", metavar="MODE",
        help="print the equations of motion of a mode, such as 'tip:pin' or 'A:free B:slide+'",
    )  # fmt: skip
    parser.add_argument("--latex", action="store_true", help="print them in LaTeX")


def _drawing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-o",
        "--output",
        metavar="PATH",
        required=True,
        help=".svg .png .pdf .dot .mmd .scxml .graphml",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--visited", action="store_true", help="run, and draw the modes and the path it took"
    )
    what.add_argument(
        "--scene", action="store_true",
        help="draw bodies, surfaces and contacts where a run starts: .svg .png .pdf",
    )  # fmt: skip
    parser.add_argument(
        "--guards", choices=("legend", "inline"), default="legend",
        help="guards and resets once below, or at every arrow; legend",
    )  # fmt: skip


def _checking(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--examples", metavar="N", type=_positive, default=50, help="per property; 50"
    )
    parser.add_argument("--seed", metavar="S", type=_count, help="repeats a check exactly")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _engine(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--engine", choices=("auto", "taylor", "scipy", "impulse"),
        help="what integrates: taylor and scipy locate events, impulse takes fixed steps; "
        "auto chooses",
    )  # fmt: skip
    parser.add_argument("--step", metavar="H", type=_number, help="of the engine impulse, in time")


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, which the list of all options would hide."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}\n{self.prog} --help has what there is\n")


class _Version(argparse.Action):
    """Prints the version, which is looked up for that alone."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        import statechart

        print(f"statechart {statechart.__version__}")
        parser.exit()


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
    _engine(parser)
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
    from statechart.errors import FormulaError
    from statechart.formulas.formula import parse

    try:
        return parse(text).value({})
    except FormulaError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _assignment(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VALUE")
    return name.strip(), _number(value)


def _range(text: str) -> tuple[str, str]:
    name, equals, values = text.partition("=")
    if not equals or not name.strip() or not values.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=RANGE")
    return name.strip(), values.strip()


def _names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise argparse.ArgumentTypeError("no name is written; leave the option out for all")
    return names


def _place(text: str) -> tuple[str, float]:
    name, value = _assignment(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r}: must be finite")
    return name, value


def _count(text: str, least: int = 0) -> int:
    try:
        count = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, such as 20") from None
    if not least <= count < _UNCOUNTABLE:
        raise argparse.ArgumentTypeError(f"must be from {least} to 10**18, not {text}")
    return count


def _positive(text: str) -> int:
    return _count(text, least=1)
