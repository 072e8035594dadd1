"""The terminal: version, completion, tables, progress bars, pages, quiet."""

from __future__ import annotations

import argparse
import json
import os
import pty
import shutil
import subprocess
import sys
import webbrowser
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pytest

from statechart import progress
from statechart.cli import grammar
from statechart.cli.main import main
from statechart.execution.outcome import Progress

STATECHART = str(Path(sys.executable).with_name("statechart"))


def on_a_terminal(*arguments: str) -> str:
    """Return the output of a command on a terminal of 60 columns."""
    ours, theirs = pty.openpty()
    settings = {**os.environ, "COLUMNS": "60", "TERM": "dumb"}
    with subprocess.Popen(
        (STATECHART, *arguments), stdout=theirs, stderr=subprocess.DEVNULL, env=settings
    ):
        os.close(theirs)
        found = b""
        while True:
            try:
                piece = os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
            if not piece:
                break
            found += piece
    os.close(ours)
    return found.decode()


@pytest.mark.parametrize("command", [(STATECHART,), (sys.executable, "-m", "statechart")])
def test_version_is_printed(command: tuple[str, ...]) -> None:
    made = subprocess.run((*command, "--version"), capture_output=True, text=True, check=True)
    assert made.stdout == f"statechart {version('contact-statecharts')}\n"


def test_bash_completes_verbs_options_and_models(tmp_path: Path) -> None:
    bash = shutil.which("bash")
    assert bash is not None
    script = subprocess.run(
        (STATECHART, "completion", "bash"), capture_output=True, text=True, check=True
    ).stdout
    (tmp_path / "toppling_mine.yaml").write_text("")
    asked = """
    ask() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=()
            $(complete -p statechart | sed 's/.*-F \\([^ ]*\\).*/\\1/') statechart "${@: -1}" ""
            echo "${COMPREPLY[@]}"; }
    ask statechart swe
    ask statechart run topp
    ask statechart run toppling_stick --acc
    """
    made = subprocess.run(
        (bash, "-c", f"{script}\n{asked}"), capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert made.stdout.splitlines() == [
        "sweep",
        "toppling_stick toppling_mine.yaml",
        "--accuracy",
    ]


def test_fish_and_zsh_load_the_completion_script(tmp_path: Path) -> None:
    asked = {
        "fish": (
            "{0} completion fish | source; complete -C 'statechart run toppl'; "
            "complete -C 'statechart swe'; complete -C 'statechart run x --accu'",
            ["toppling_stick", "sweep", "--accuracy"],
        ),
        "zsh": (
            'autoload -Uz compinit; compinit -u -D; eval "$({0} completion zsh)"; '
            "print ${{_comps[statechart]}}",
            ["_shtab_statechart"],
        ),
    }
    found = {shell: program for shell in asked if (program := shutil.which(shell))}
    if not found:
        pytest.skip("neither fish nor zsh is here")
    for shell, program in found.items():
        commands, expected = asked[shell]
        made = subprocess.run(
            (program, "-c", commands.format(STATECHART)),
            capture_output=True, text=True, cwd=tmp_path, check=True,
            env={**os.environ, "HOME": str(tmp_path)},
        )  # fmt: skip
        assert [line.split()[0] for line in made.stdout.splitlines()] == expected


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_the_completion_script_can_be_read_by_other_shells(
    shell: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["completion", shell]) == 0
    said = capsys.readouterr().out
    assert "toppling_stick" in said
    assert "accuracy" in said
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not here")
    (tmp_path / "script").write_text(said)
    subprocess.run((program, "-n", tmp_path / "script"), check=True)


def test_a_run_is_a_table_on_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    lines = on_a_terminal("modes", "painleve_rod").splitlines()
    assert main(["modes", "painleve_rod"]) == 0
    plain = capsys.readouterr().out
    assert max(map(len, plain.splitlines())) > 60
    cells = [line.split() for line in lines if line.strip().startswith(("free ", "slide ", "pin "))]
    assert ["free", "possible"] in cells
    # Nothing is cut off: long text continues on the next line.
    assert sorted("".join(plain.split())) == sorted("".join("".join(lines).split()))


def bare(text: str) -> str:
    """Return the letters of a text that do not depend on how fast it was made, in order."""
    lines = [line for line in text.splitlines() if "s of runs" not in line]
    return "".join(sorted("".join("".join(lines).split())))


@pytest.mark.parametrize(
    ("arguments", "head"),
    [
        ("check bouncing_ball_chart --examples 1 --seed 1", ["property", "examples", "verdict"]),
        ("sweep bouncing_ball_chart --over k=0.3,0.5", ["output", "least", "greatest", "unit"]),
        (
            "run bouncing_ball_chart --set k=0 --explain",
            ["t", "region", "cause", "from", "->", "to"],
        ),
    ],
)
def test_other_verbs_are_tables_on_a_terminal_too(
    arguments: str, head: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    shown = on_a_terminal(*arguments.split())
    assert main(arguments.split()) == 0
    plain = capsys.readouterr().out
    assert head in [line.split() for line in plain.splitlines()]
    assert head in [line.split() for line in shown.splitlines()]
    assert bare(plain) == bare(shown)


def test_the_page_of_a_run_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or len(opened) == 1)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["view", "bouncing_ball", "--quiet", "--until", "0.5"]) == 0
    page = Path(capsys.readouterr().out.strip())
    assert page.name == "bouncing_ball.html"
    assert page.is_relative_to(tmp_path)
    assert opened == [page.as_uri()]
    assert "<html" in page.read_text(encoding="utf-8")
    named = tmp_path / "mine.html"
    assert main(["view", "bouncing_ball", "--until", "0.1", "-o", str(named)]) == 0
    assert named.is_file()
    assert "no browser was found" in capsys.readouterr().err
    assert main(["view", "bouncing_ball", "-o", str(tmp_path / "mine.pdf")]) == 2
    assert "the suffix must be .html or .htm" in capsys.readouterr().err


def test_quiet_suppresses_progress(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    wanted = ["check", "bouncing_ball_chart", "--examples", "1", "--seed", "1"]
    assert main(wanted) == 0
    assert "testing: runs come to their end" in capsys.readouterr().err
    assert main([*wanted, "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_progress_is_a_bar_on_a_terminal_and_lines_in_a_pipe(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr("statechart.execution.outcome.working_time", lambda: now[0])
    lines = Progress(10.0)
    for time in (0.5, 1.5, 1.7, 3.0):
        now[0] = time
        lines.show(time, 2, 30)
    lines.close()
    assert capsys.readouterr().err == (
        "t = 1.5 of 10, 2 jumps, 30 steps, 2 s\nt = 3 of 10, 2 jumps, 30 steps, 3 s\n"
    )
    monkeypatch.setattr(progress, "possible", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes the stream for a terminal
    now[0] = 0.0
    bar = Progress(10.0)
    for time in (0.5, 5.0):
        now[0] = time
        bar.show(time, 2, 30)
    bar.close()
    shown = capsys.readouterr().err
    assert "50%" in shown
    assert list(progress.count_items("abc", 3, "letters")) == ["a", "b", "c"]
    assert "letters" in capsys.readouterr().err


@pytest.mark.skipif(find_spec("heyoka") is None, reason="heyoka is not installed")
def test_an_unwritable_cache_prints_no_message_among_results(tmp_path: Path) -> None:
    kept = tmp_path / "file"
    kept.touch()
    settings = {**os.environ, "HOME": str(kept), "XDG_CACHE_HOME": str(kept)}
    command = (STATECHART, "run", "bouncing_ball_chart", "--until", "0.1", "--json")
    made = subprocess.run(command, capture_output=True, text=True, check=True, env=settings)
    assert json.loads(made.stdout)["outcome"] == "HORIZON"


def test_tables_without_a_folder_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for given in ((), ("-o", str(tmp_path / "run.zarr"))):
        assert main(["run", "toppling_stick", "--samples", *given]) == 2
        assert "--output DIR" in capsys.readouterr().err


def actions() -> list[object]:
    whole = grammar.parser()
    (verbs,) = (a for a in whole._actions if isinstance(a, argparse._SubParsersAction))
    return [
        pytest.param(action, id=f"{name} {'/'.join(action.option_strings) or action.dest}")
        for name, verb in verbs.choices.items()
        for action in verb._actions
    ]


@pytest.mark.parametrize("action", actions())
def test_every_option_and_argument_has_a_help_text(action: argparse.Action) -> None:
    assert action.help


@pytest.mark.parametrize(
    ("line", "reported"),
    [
        ("run toppling_stick --unitl 3", "run: error: no option --unitl; did you mean '--until'"),
        ("draw toppling_stick -o a.svg --sceen", "no option --sceen; did you mean '--scene'?"),
        ("-q run toppling_stick", "statechart run: error: write -q after the verb"),
        ("run toppling_stick --set mu=1 g=2", "unexpected argument 'g=2'; write --set before each"),
        ("sweep toppling_stick mu=1", "unexpected argument 'mu=1'; write --over before each"),
        ("run toppling_stick twice", "unexpected argument 'twice'; statechart run takes one FILE"),
        ("compile toppling_stick", "unexpected argument 'toppling_stick'; statechart compile take"),
        ("run toppling_stick --parameters mu=1", "no option --parameters; write --set\n"),
        ("run toppling_stick --mu 0.3", "no option --mu; a parameter is written --set mu=VALUE\n"),
        ("run toppling_stick --set mu=0.3,I_G=1", "has several values; write --set before each"),
        ("run toppling_stick --set mu 0.3", "'mu' is not of the form NAME=VALUE, such as mu=0.3"),
        ("trade toppling_stick --step 0.1", "no option --step; known: --json, --output, --quiet"),
        ("run toppling_stick --page a.html", "no option --page; write --report\n"),
        ("run toppling_stick -o", "run: error: --output lacks its value; write --output DIR\n"),
        ("run toppling_stick --t-end 3", "no option --t-end; write --until\n"),
        ("animate toppling_stick", "write statechart run FILE --animate FILM.gif"),
        ("rnu toppling_stick", "no verb 'rnu'; did you mean 'run'? known: "),
    ],
)  # fmt: skip
def test_wrong_command_lines_are_reported_with_advice(
    line: str, reported: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    shown = capsys.readouterr()
    assert reported in shown.err
    assert not shown.out


def test_a_scene_without_contacts_has_no_mode_to_start_in(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ball.yaml"
    path.write_text("kind: scene\nname: ball\nbodies: {ball: {mass: 1}}\n")
    assert main(["validate", str(path)]) == 0
    assert capsys.readouterr().out.endswith("is correct: 4 variables, 1 mode\n")
