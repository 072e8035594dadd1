"""Grammar of the command line: verbs, options, types of values, and completion in shells."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NoReturn

from statechart.errors import close_matches
from statechart.tabular import ALL_DIGITS, DIGITS

# A count that no machine comes to.
_MAX_COUNT = 10**18 + 1

SHELLS = ("bash", "zsh", "fish")
"""Shells that complete commands."""

_FILES = ("PATH", "FILM", "PAGE", "PICTURE", "TABLE.csv")

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
            _flag(added, "-q --quiet", "show no progress; warnings and errors remain")
        return added

    verb("validate", "check a model and its initial state")
    run = verb("run", "run a model and report what happened")
    _settable(run)
    _add_run_options(run)
    _add_report_options(run)
    view = verb("view", "run a model, write the run as a page and open it in the browser")
    _settable(view)
    _number(view, "--until", "T", "end time of the run")
    _value(view, "-o --output", "PAGE", "file of the page; a temporary one by default")
    trade = verb("trade", "run a model at many settings, and compare error with run time")
    _json(trade)
    words = "folder for table, data and figure; an interrupted study continues there"
    _value(trade, "-o --output", "DIR", words)
    _add_sweep_options(verb("sweep", "run a model over its parameters: grids, tables, samples"))
    _add_list_options(
        verb("modes", "list a model's modes, which are possible, and their transitions")
    )
    _add_draw_options(verb("draw", "draw the statechart of a model, or its scene"))
    check = verb("check", "test a model's invariants over its ranges of parameters")
    words = "examples per property (default 50)"
    _value(check, "--examples", "N", words, type=_positive, default=50)
    words = "seed of the examples; the same one repeats a check exactly"
    _value(check, "--seed", "S", words, type=_count)
    _json(check)
    ahead = verb("compile", "compile all numerical kernels, once per machine", file=False)
    _flag(ahead, "-q --quiet", "show no progress")
    schema = verb("schema", "print the JSON Schema of the documents", file=False)
    schema.add_argument("kind", nargs="?", metavar="KIND", help="scene or chart; both by default")
    new = verb("new", "write a commented scene to start from", file=False)
    new.add_argument("name", metavar="NAME", help="name of the model; the file is NAME.yaml")
    completion = verb("completion", "print the completion script of a shell", file=False)
    completion.epilog = (
        'source <(statechart completion bash); eval "$(statechart completion zsh)"; '
        "statechart completion fish | source"
    )
    completion.add_argument("shell", choices=SHELLS, help="shell that runs the script")
    return whole


_OPTIONS = {
    **dict.fromkeys(("--page", "--html"), "--report"),
    **dict.fromkeys(("--t-end", "--tend", "--stop-time", "--end"), "--until"),
    **dict.fromkeys(("--tmax", "--t-max", "--time", "--duration"), "--until"),
    **dict.fromkeys(("--dt", "--timestep", "--time-step"), "--step"),
    **dict.fromkeys(("--tol", "--rtol", "--atol"), "--tolerance"),
    **dict.fromkeys(("--solver", "--integrator"), "--engine"),
    **dict.fromkeys(("--param", "--parameter", "--parameters", "-p"), "--set"),
    **dict.fromkeys(("--gif", "--film", "--video", "--movie"), "--animate"),
    **dict.fromkeys(("--out", "--plot", "--figure", "--format"), "--output"),
    "--fps": "--speed",
}
"""Option of another program -> option of ours."""

_VERBS = {
    **dict.fromkeys(("simulate", "sim", "solve"), "run"),
    **dict.fromkeys(("animate", "film"), "run FILE --animate FILM.gif"),
    "plot": "run FILE -o DIR",
    "report": "run FILE --report PAGE.html",
    **dict.fromkeys(("test", "verify"), "check"),
    **dict.fromkeys(("show", "open", "page"), "view"),
    **dict.fromkeys(("diagram", "chart", "graph"), "draw"),
    **dict.fromkeys(("init", "create"), "new"),
    "lint": "validate",
    "help": "--help",
    **dict.fromkeys(("compare", "benchmark"), "trade FILE, or run FILE --alternatives"),
}
"""Verb of another program -> what ours are called."""


def read(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse a command line; end the process with the reason if it is invalid."""
    whole = parser()
    (verbs,) = (one for one in whole._actions if isinstance(one, argparse._SubParsersAction))
    words = sys.argv[1:] if arguments is None else arguments
    first = next((word for word in words if not word.startswith("-")), None)
    if not words:
        whole.error(f"no verb; such as: statechart run FILE; known: {', '.join(verbs.choices)}")
    if first is not None and first not in verbs.choices:
        written = f"write statechart {_VERBS[first]}" if first in _VERBS else ""
        whole.error(f"no verb {first!r}; {written or close_matches(first, verbs.choices)}")
    chosen, unknown = whole.parse_known_args(arguments)
    if unknown:
        verb: argparse.ArgumentParser = verbs.choices[chosen.verb]
        verb.error(_unknown(unknown[0], verb))
    return chosen


def _unknown(argument: str, verb: argparse.ArgumentParser) -> str:
    name = argument.partition("=")[0]
    assigned = [a.option_strings[0] for a in verb._actions if str(a.metavar).startswith("NAME=")]
    if name != argument and assigned and not name.startswith("-"):
        return f"unexpected argument {argument!r}; write {assigned[0]} before each"
    if not name.startswith("-"):
        files = [a.metavar for a in verb._actions if not a.option_strings and a.metavar]
        takes = f"one {files[0]}, with blanks in quotes" if files else "options only"
        return f"unexpected argument {argument!r}; {verb.prog} takes {takes}"
    if name in verb._option_string_actions:
        return f"write {name} after the verb"
    if (written := _OPTIONS.get(name, "")) in verb._option_string_actions:
        return f"no option {name}; write {written}"
    known = (o for o in verb._option_string_actions if o.startswith("--") and o != "--help")
    advice = close_matches(name, known).partition(" known:")[0]
    if assigned and not advice.startswith("did you mean"):
        advice = f"a parameter is written {assigned[0]} {name.lstrip('-')}=VALUE"
    return f"no option {name}; {advice}"


def _value(
    parser: argparse._ActionsContainer, names: str, metavar: str, words: str, **more: Any
) -> None:
    parser.add_argument(*names.split(), metavar=metavar, help=words, **more)


def _number(parser: argparse._ActionsContainer, name: str, metavar: str, words: str) -> None:
    parser.add_argument(name, metavar=metavar, help=words, type=_number_argument)


def _flag(parser: argparse._ActionsContainer, names: str, words: str) -> None:
    parser.add_argument(*names.split(), action="store_true", help=words)


def _add_run_options(parser: argparse.ArgumentParser) -> None:
    _number(parser, "--until", "T", "end time of the run")
    _engine(parser)
    words = (
        "allowed residual of the contact impulses, relative to the fastest approach velocity in "
        "the step (engine impulse)"
    )
    _number(parser, "--impulse-tolerance", "R", words)
    words = "residual of the contact impulses above which the run ends (engine impulse)"
    _number(parser, "--impulse-bound", "R", words)
    words = (
        "data that the engine impulse records: modes and events, the states at every step, "
        "or start, end and outputs"
    )
    parser.add_argument("--record", choices=("modes", "poses", "nothing"), help=words)
    _number(parser, "--max-step", "H", "longest time step of the engines taylor and scipy")
    words = "RK45, DOP853, Radau or LSODA (engine scipy), 'long double' (engine taylor)"
    _value(parser, "--method", "M", words)
    error = parser.add_mutually_exclusive_group()
    _errors(error)
    _number(error, "--budget", "S", "time budget in seconds, used for the best accuracy")


def _errors(group: argparse._ActionsContainer) -> None:
    _number(group, "--accuracy", "A", "allowed relative error of the result")
    _number(group, "--tolerance", "R", "relative tolerance of every step")


def _add_report_options(parser: argparse.ArgumentParser) -> None:
    _flag(parser, "--certify", "enclose the defect of every step, and estimate the global error")
    words = "also run with the other laws of simultaneous impacts, and compare"
    _flag(parser, "--alternatives", words)
    words = "list for every event the guard that fired, margins, candidates and energy"
    _flag(parser, "--explain", words)
    words = "folder for tables, data set and figure; or STORE.zarr for the states at every step"
    _value(parser, "-o --output", "DIR", words)
    words = "also write samples.csv, with the data of trace.nc"
    parser.add_argument("--samples", action=argparse.BooleanOptionalAction, help=words)
    _value(parser, "--animate", "FILM", "draw the bodies in motion: .gif, or .mp4 with ffmpeg")
    _number(parser, "--speed", "V", "simulated time per second of the film")
    words = "longer side of the film in pixels (default 720)"
    _value(parser, "--size", "PIXELS", words, type=_count)
    _number(parser, "--trail", "T", "length of the trails in simulated time; 0 for none")
    _value(parser, "--report", "PAGE", "write the run as one page: .html")
    _json(parser, digits=True)


def _json(parser: argparse.ArgumentParser, *, digits: bool = False) -> None:
    _flag(parser, "--json", "print one JSON object")
    if digits:
        words = f"significant digits of printed numbers (default {DIGITS}; {ALL_DIGITS} for all)"
        _value(parser, "--digits", "N", words, type=_positive, default=DIGITS)


def _add_list_options(parser: argparse.ArgumentParser) -> None:
    _settable(parser)
    where = parser.add_mutually_exclusive_group()
    words = "check this configuration instead of the initial one, such as bar.angle=0.3"
    _value(where, "--at", "NAME=VALUE", words, action="append", default=[], type=_assigned_value)
    _number(where, "--until", "T", "check the state of a run at this time")
    _json(parser, digits=True)
    words = "print the equations of motion of a mode, such as 'tip:pin' or 'A:free B:slide+'"
    _value(parser, "--equations", "MODE", words)
    _flag(parser, "--latex", "print the equations in LaTeX")


def _add_draw_options(parser: argparse.ArgumentParser) -> None:
    words = (
        "file to write: .svg .png .pdf .dot .mmd .scxml .graphml; without it the picture opens in "
        "the browser, or goes to a pipe as SVG"
    )
    _value(parser, "-o --output", "PATH", words)
    what = parser.add_mutually_exclusive_group()
    _flag(what, "--visited", "run the model, and draw the visited modes and the path through them")
    words = "draw bodies, surfaces and contacts where a run starts: .svg .png .pdf"
    _flag(what, "--scene", words)
    words = "place of guards and resets: the legend (default), or every arrow"
    places = ("legend", "inline")
    parser.add_argument("--guards", choices=places, default="legend", help=words)


def _engine(parser: argparse.ArgumentParser) -> None:
    words = "taylor and scipy locate events, impulse takes fixed time steps; auto chooses"
    engines = ("auto", "taylor", "scipy", "impulse")
    parser.add_argument("--engine", choices=engines, help=words)
    _number(parser, "--step", "H", "time step of the engine impulse")


def _add_sweep_options(parser: argparse.ArgumentParser) -> None:
    words = (
        "values of a parameter: lin:A:B:N, log:A:B:N, or 0.1,1/3,inf; "
        "all combinations of them are run"
    )
    _value(parser, "--over", "NAME=RANGE", words, action="append", default=[], type=_range)
    cells = parser.add_mutually_exclusive_group()
    words = "points of a Sobol sequence over NAME=lin:A:B, a power of two"
    _value(cells, "--sobol", "N", words, type=_positive)
    words = "table of values: a column for every parameter, a row for every run"
    _value(cells, "--samples", "TABLE.csv", words)
    words = "outputs to compute, separated by commas; all by default"
    _value(parser, "--outputs", "NAMES", words, type=_names)
    _number(parser, "--until", "T", "end time of the runs")
    _engine(parser)
    _errors(parser.add_mutually_exclusive_group())
    where = parser.add_mutually_exclusive_group()
    _value(where, "--workers", "N", "number of processes on this machine", type=_positive)
    _value(where, "--scheduler", "ADDRESS", "address of a Dask scheduler: tcp://HOST:PORT")
    words = "STORE.zarr, which is written block by block, or FILE.nc"
    _value(parser, "-o --output", "PATH", words)
    _flag(parser, "--resume", "continue the sweep in STORE.zarr")
    _value(parser, "--plot", "PICTURE", "picture of the sweep: .svg .png .pdf")
    _json(parser, digits=True)


def _settable(parser: argparse.ArgumentParser) -> None:
    words = "value of a parameter: a number, 1/3, inf, 20*pi/180"
    more: Any = {"dest": "parameters", "action": "append", "default": [], "type": _assignment}
    _value(parser, "--set", "NAME=VALUE", words, **more)


class _Parser(argparse.ArgumentParser):
    """Reports an error in one line, without the list of all options."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        known = action.choices
        if known is not None and value not in known:
            from statechart.documents.hints import other_value

            advice = other_value(value, str(tuple(known))) or close_matches(value, known)
            raise argparse.ArgumentError(action, f"no value {value!r}; {advice}")

    def error(self, message: str) -> NoReturn:
        message = message.replace("the following arguments are required", "missing")
        if message.endswith(": expected one argument"):
            option = message.removesuffix(": expected one argument").rpartition("/")[2].split()[-1]
            value = self._option_string_actions[option].metavar
            message = f"{option} lacks its value; write {option} {value}"
        self.exit(2, f"{self.prog}: error: {message}\nfor the options: {self.prog} --help\n")


class _Version(argparse.Action):
    """Prints the version, which is looked up for that alone."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        import statechart

        print(f"statechart {statechart.__version__}")
        parser.exit()


def _number_argument(text: str) -> float:
    from statechart.errors import FormulaError
    from statechart.formulas.formula import parse

    try:
        return parse(text).value({})
    except FormulaError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _assignment(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VALUE, such as mu=0.3")
    if "=" in value and "," in value:
        raise argparse.ArgumentTypeError(f"{text!r} has several values; write --set before each")
    return name.strip(), _number_argument(value)


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


def _assigned_value(text: str) -> tuple[str, float]:
    name, value = _assignment(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r}: must be finite")
    return name, value


def _count(text: str, least: int = 0) -> int:
    try:
        count = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, such as 20") from None
    if not least <= count < _MAX_COUNT:
        raise argparse.ArgumentTypeError(f"must be {least} or more, up to 10**18, not {text}")
    return count


_positive = partial(_count, least=1)


def script(shell: str) -> str:
    """Return the completion script of a shell: verbs, options, files, shipped models."""
    import shtab

    whole = parser()
    completed = {"FILE": _models(), **dict.fromkeys(_FILES, shtab.FILE), "DIR": shtab.DIRECTORY}
    for action in _actions(whole):
        if isinstance(action.metavar, str) and action.metavar in completed:
            action.complete = completed[action.metavar]  # type: ignore[attr-defined]
    text: str = shtab.complete(whole, shell)
    return text


def _models() -> dict[str, object]:
    """Return completions of a model: the name of a shipped one, or a file."""
    from statechart.loading.load import shipped_models

    names = " ".join(sorted(shipped_models()))
    return {
        "bash": "_statechart_model_file",
        "zsh": "_statechart_models",
        "fish": "(__statechart_models)",
        "preamble": {
            "bash": "_statechart_model_file() {\n"
            f'  compgen -W "{names}" -- "$1"\n  compgen -f -- "$1"\n}}',
            "zsh": "_statechart_models() {\n"
            f"  _alternative 'models:shipped model:({names})' 'files:file:_files'\n}}",
            "fish": "function __statechart_models\n"
            f"  printf '%s\\n' {names}\n  __fish_complete_path (commandline -ct)\nend",
        },
    }


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from _actions(verb)
