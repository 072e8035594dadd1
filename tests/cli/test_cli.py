"""The command line: verbs, exit codes, and one clear message for whatever is wrong."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from runs import SOUND

import models
from statechart.cli.main import main

EVENT_KEYS = {"t", "j", "contact", "cause", "from", "to", "state", "impulse"}
REPORT_KEYS = {
    "model", "outcome", "message", "t_end", "engine", "certified", "evidence", "motion",
    "error_estimate", "modes_total", "modes_built", "events", "final", "outputs", "margins",
    "warnings", "counts", "timings",
}  # fmt: skip

SCENE = """\
kind: scene
name: drop
parameters:
  e: 0.5
  mu: 0.3
gravity: 9.81
bodies:
  ball: {mass: 1, start: {y: 1}}
surfaces:
  floor: {height: 0}
contacts:
  tip:
    point: {body: ball}
    surface: floor
    friction: mu
    restitution: e
stop: {time: 0.4}
"""


class Cli:
    """Runs the command line in this process, in a folder of its own."""

    def __init__(self, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
        self._capsys, self.folder = capsys, folder

    def __call__(self, *arguments: str) -> tuple[int, str, str]:
        code = main(arguments)
        said = self._capsys.readouterr()
        # Progress is shown by the clock: on a busy machine even of short runs.
        lines = said.err.splitlines(keepends=True)
        return code, said.out, "".join(line for line in lines if not line.startswith("t = "))

    def write(self, text: str, name: str = "model.yaml") -> str:
        (self.folder / name).write_text(text, encoding="utf-8")
        return name


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cli:
    monkeypatch.chdir(tmp_path)
    return Cli(capsys, tmp_path)


@pytest.mark.parametrize("name", models.names())
def test_shipped_models_are_correct(cli: Cli, name: str) -> None:
    code, out, err = cli("validate", name)
    assert (code, err, out.count("\n")) == (0, "", 1)
    assert f"{name!r} is correct" in out


def test_modes_are_not_listed_of_a_start_that_is_wrong(cli: Cli) -> None:
    code, out, err = cli("modes", cli.write(SCENE.replace("y: 1", "y: -1")))
    assert (code, out) == (2, "")
    assert "model.yaml:13:5: contacts.tip: contact 'tip' starts inside its surface" in err


def test_validate_reports_static_warnings(cli: Cli) -> None:
    text = SCENE.replace("{mass: 1,", "{mass: 1, inertia: 1e-15,").replace(
        "point: {body: ball}", "point: {body: ball, at: [0, -1]}"
    )
    code, out, _ = cli("validate", cli.write(text))
    assert code == 0
    assert "warning: body 'ball' is run as a point mass" in out


def test_run_proves_the_motion_on_request(cli: Cli) -> None:
    code, out, _ = cli("run", "toppling_stick", "--certify", "--json")
    report = json.loads(out)
    assert code == 0
    assert report["certified"] is True
    assert report["motion"]["proved"] is True
    # It slips where a force is below zero by a tolerance of 1e-12, so later by 7e-12 of a second.
    assert 0.0 < report["motion"]["local"] < 1e-13
    assert 1e-12 < report["motion"]["whole"] < 1e-11
    code, out, _ = cli("run", "toppling_stick", "--certify")
    assert "events and motion certified" in out
    assert "motion: interval enclosure: no step is off by more than" in out
    code, _, err = cli("run", "toppling_stick", "--engine", "impulse", "--step", "1", "--certify")
    assert code == 2
    assert "cannot certify" in err


@pytest.mark.parametrize("name", SOUND)
def test_run_prints_one_object(cli: Cli, name: str) -> None:
    code, out, _ = cli("run", name, "--json")
    report = json.loads(out)
    assert code == 0
    assert report.keys() >= REPORT_KEYS
    assert report["model"] == name
    assert report["outcome"] in ("HORIZON", "STOPPED")
    assert report["certified"] == "guards"
    assert report["error_estimate"] is None
    assert 1 <= report["modes_built"] <= report["modes_total"]
    assert report["counts"].keys() >= {"steps", "evaluations", "boxes", "jumps"}
    assert [event["t"] for event in report["events"]] == sorted(
        event["t"] for event in report["events"]
    )
    for event in report["events"]:
        assert event.keys() >= EVENT_KEYS
        assert event["from"].keys() == event["to"].keys()


def test_json_keeps_every_digit(cli: Cli) -> None:
    report = json.loads(cli("run", "toppling_stick", "--json")[1])
    stop = next(event for event in report["events"] if event["cause"] == "stop")
    assert report["outputs"]["t_impact"] == report["t_end"] == stop["t"]
    assert report["outputs"]["omega_impact"] == -report["final"]["stick.dangle"]


def test_summary_has_events_outputs_and_margins(cli: Cli) -> None:
    report = json.loads(cli("run", "toppling_stick", "--json")[1])
    code, out, err = cli("run", "toppling_stick")
    assert (code, err) == (0, "")
    whole = cli("run", "toppling_stick", "--digits", "17")[1]
    for value in report["outputs"].values():
        assert f"{value:.7g}" in out
        assert repr(value) in whole
    for event in report["events"]:
        assert re.search(rf"^{event['t']:.7g} .*{event['cause']}", out, re.M)
        assert re.search(rf"^{re.escape(repr(event['t']))} .*{event['cause']}", whole, re.M)
    assert all(name in out for name in report["margins"])


def test_the_summary_lists_the_first_and_the_last_of_many_events(cli: Cli) -> None:
    _, out, _ = cli("run", "bouncing_ball_chart")
    assert re.search(r"^\.\.\. \d+ more", out, re.M)
    assert len(re.findall(r"^\d.* bounce ", out, re.M)) == 39
    assert "settle" in out


@pytest.mark.parametrize(
    ("text", "value"),
    [("1/3", 1 / 3), ("inf", math.inf), ("20*pi/180", math.pi / 9), ("-1e-3", -1e-3), ("2", 2.0)],
)
def test_set_takes_numbers_and_formulas_of_numbers(cli: Cli, text: str, value: float) -> None:
    path = cli.write(SCENE.replace("stop:", "outputs: {p: {value: q}}\nstop:").replace(
        "  mu: 0.3\n", "  mu: 0.3\n  q: 0\n"))  # fmt: skip
    code, out, _ = cli("run", path, "--set", f"q={text}", "--json")
    report = json.loads(out)
    assert code == 0
    assert float(report["outputs"]["p"]) == float(report["parameters"]["q"]) == value


@pytest.mark.parametrize(
    "arguments",
    [
        (), ("fly",), ("run",), ("run", "bouncing_ball", "--speed", "3"),
        ("run", "bouncing_ball", "--set", "k"), ("run", "bouncing_ball", "--set", "=1"),
        ("run", "bouncing_ball", "--set", "k=k"), ("run", "bouncing_ball", "--set", "k=nan"),
        ("run", "bouncing_ball", "--set", "k=__import__('os')"),
        ("run", "bouncing_ball", "--set", "k=9**9**9**9"),
        ("run", "bouncing_ball", "--set", "nope=1"),
        ("run", "bouncing_ball", "--set", "k=0.1", "--set", "k=0.2"),
        ("run", "bouncing_ball", "--set", "k=2"),
        ("run", "bouncing_ball", "--set", "x0=-1"),
        ("run", "bouncing_ball", "--set", "x0=inf"),
        ("run", "bouncing_ball", "--until", "-1"), ("run", "bouncing_ball", "--until", "inf"),
        ("run", "bouncing_ball", "--until", "soon"),
        ("run", "bouncing_ball", "--engine", "magic"),
        ("run", "bouncing_ball", "--method", "Euler"),
        ("run", "bouncing_ball", "--engine", "taylor", "--method", "RK45"),
        ("run", "bouncing_ball", "--accuracy", "1e-6", "--tolerance", "1e-6"),
        ("run", "bouncing_ball", "--accuracy", "0"), ("run", "bouncing_ball", "--tolerance", "1"),
        ("run", "no_such_model"), ("run", "."), ("validate", "a\0b"), ("modes", ""),
        ("draw", "bouncing_ball", "-o", "a.gif"),
        ("draw", "bouncing_ball", "-o", "a.svg", "--guards", "below"),
        ("check", "bouncing_ball", "--examples", "0"), ("check", "bouncing_ball", "--seed", "x"),
        ("schema", "statue"), ("new",), ("new", "../a"), ("new", "1a"), ("new", "a b"),
        ("new", "sqrt"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_wrong_arguments_exit_with_two_and_write_nothing(
    cli: Cli, arguments: tuple[str, ...]
) -> None:
    code, out, err = cli(*arguments)
    assert (code, out) == (2, "")
    assert err.strip()
    assert "Traceback" not in err
    assert list(cli.folder.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("gravity:", "gravty:", "6:1", "unknown key 'gravty'; did you mean 'gravity'"),
        ("gravity: 9.81", "gravity: 9.81\ngravity: 1", "7:1", "duplicate key"),
        ("{mass: 1,", "{mass: [1],", "8:16", "mass"),
        ("restitution: e", "restitution: ee", "16:18", "'ee'"),
        ("e: 0.5\n  mu: 0.3", "e: mu\n  mu: e", "4:6", "need each other"),
        ("{mass: 1,", "{mass: -1,", "8:16", "must be positive"),
        ("mu: 0.3", "mu: -0.3", "15:15", "must be zero or positive"),
        ("e: 0.5", "e: 1.5", "16:18", "must be between 0 and 1"),
        ("e: 0.5", "e: .nan", "4:6", "nan"),
        ("friction:", "modes: [slip]\n    friction:", "15:13", "must be one of 'free', 'slide'"),
        ("friction:", "modes: []\n    friction:", "15:12", "at least 1 item"),
        ("stop:", "modes: {tip: pin}\nstop:", "17:14", "cannot start in mode 'pin'"),
        ("{y: 1}", "{y: -1}", "13:5", "starts inside its surface"),
        ("time: 0.4", "time: 0.4, conditions: {a: 'b < 0'}", "17:36", "'b'"),
        ("gravity: 9.81", "gravity: &a 9.81", "6:10", "anchor"),
        ("gravity: 9.81", "gravity: !!python/name:os.system 9.81", "6:10", "tag"),
        ("gravity: 9.81", "gravity: " + 40 * "[" + 40 * "]", "6:", "deep"),
        ("gravity: 9.81", "gravity: 9**9**9**9", "6:", ""),
        ("gravity: 9.81", "gravity: __import__('os').system('id')", "6:", "__import__"),
        ("kind: scene", "kind: statue", "1:7", "statue"),
        ("kind: scene\n", "", "", "'kind' is missing"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("verb", ["validate", "run"])
def test_a_wrong_document_gets_its_place_and_exits_with_two(
    cli: Cli, verb: str, old: str, new: str, place: str, words: str
) -> None:
    assert old in SCENE
    path = cli.write(SCENE.replace(old, new, 1))
    arguments = (verb, path) if verb == "validate" else (verb, path, "--output", "out")
    code, out, err = cli(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"model.yaml:{place}"), err
    assert words in err
    assert "Traceback" not in err
    assert [file.name for file in cli.folder.iterdir()] == ["model.yaml"]


def test_an_override_at_fault_is_named_at_the_place_that_it_breaks(cli: Cli) -> None:
    path = cli.write(SCENE)
    code, _, err = cli("run", path, "--set", "mu=-1")
    assert code == 2
    assert err.startswith("model.yaml:15:15: contacts.tip.friction: must be zero or positive")
    assert "(with mu = -1)" in err


def test_output_has_the_report_tables_and_figure(cli: Cli) -> None:
    code, out, err = cli("run", "bouncing_ball", "--until", "1", "--output", "out", "--json")
    assert code == 0
    assert "add --samples or --no-samples" in err
    written = {file.name for file in (cli.folder / "out").iterdir()}
    assert written >= {"run.json", "events.csv", "samples.csv", "trace.nc", "figure.svg"}
    assert json.loads((cli.folder / "out" / "run.json").read_text()) == json.loads(out)


def test_samples_are_written_on_request(cli: Cli) -> None:
    asked = ("run", "box_stack", "--until", "0.01", "--output", "out", "--record")
    for options, names in (
        (("poses",), {"run.json", "events.csv", "trace.nc", "figure.svg", "figure.png"}),
        (("nothing", "--samples"), {"run.json", "events.csv"}),
        (("poses", "--samples"), {"samples.csv", "trace.nc"}),
    ):
        code, _, err = cli(*asked, *options)
        assert (code, "--samples" in err) == (0, False)
        found = {file.name for file in (cli.folder / "out").iterdir()}
        assert found >= names
        assert "samples.csv" in names or "samples.csv" not in found
        shutil.rmtree(cli.folder / "out")


def test_an_output_that_is_a_file_is_refused_before_running(cli: Cli) -> None:
    (cli.folder / "out").write_text("mine")
    code, _, err = cli("run", "bouncing_ball", "--output", "out")
    assert code == 2
    assert "out is a file" in err
    assert (cli.folder / "out").read_text() == "mine"
    code, _, err = cli("run", "bouncing_ball", "--output", "out/deeper")
    assert code == 2
    assert "out is a file" in err


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder that root cannot write to")
@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "bouncing_ball", "--output", "/proc/out"),
        ("run", "bouncing_ball", "--output", "/proc/out.zarr"),
        ("run", "bouncing_ball", "--animate", "/proc/out.gif"),
        ("run", "bouncing_ball", "--report", "/proc/out.html"),
        ("view", "bouncing_ball", "-o", "/proc/out.html"),
        ("draw", "bouncing_ball", "-o", "/proc/out.svg"),
        ("trade", "bouncing_ball", "-o", "/proc/out"),
        ("sweep", "bouncing_ball", "--over", "k=0.1,0.2", "-o", "/proc/out.zarr"),
        ("sweep", "bouncing_ball", "--over", "k=0.1,0.2", "-o", "/proc/new/out.nc"),
        ("sweep", "bouncing_ball", "--over", "k=0.1,0.2", "--plot", "/proc/new/out.png"),
    ],
)
def test_an_output_that_cannot_be_written_is_refused_before_running(
    cli: Cli, arguments: tuple[str, ...]
) -> None:
    code, out, err = cli(*arguments)
    assert (code, out) == (2, "")
    assert "/proc is not writable" in err or "there is no folder /proc that is writable" in err
    assert not any(cli.folder.iterdir())


def test_a_run_that_cannot_go_on_exits_with_one_and_saves_its_trace(cli: Cli) -> None:
    path = cli.write(
        "kind: chart\nname: blow_up\nvariables: {v: 1}\nstop: {time: 5}\n"
        "regions: {r: {initial: s, states: {s: {flows: {v: v**3}}}}}\n"
    )
    code, out, err = cli("run", path, "--output", "out")
    assert code == 1
    assert "Traceback" not in err
    assert "t = 0.5 needs steps" in out
    report = json.loads((cli.folder / "out" / "run.json").read_text())
    # To the tolerance of scipy, from either side.
    assert report["t_end"] == pytest.approx(0.5, abs=1e-8)
    assert report["outcome"] in ("NON_FINITE", "STEP_FAILURE")
    assert "r:s" in report["message"]


def test_a_flow_without_taylor_series_warns_on_stderr(cli: Cli) -> None:
    path = cli.write(
        "kind: chart\nname: drag\nvariables: {v: 0}\nstop: {time: 1}\n"
        "regions: {r: {initial: s, states: {s: {flows: {v: 1 - v**1.5}}}}}\n"
    )
    code, out, err = cli("run", path, "--json")
    assert code == 0
    assert err.startswith("warning: engine scipy")
    assert json.loads(out)["final"]["v"] == pytest.approx(0.71105232391, rel=1e-9)


def test_accuracy_reports_its_estimate(cli: Cli) -> None:
    report = json.loads(cli("run", "bouncing_ball", "--accuracy", "1e-6", "--json")[1])
    assert 0.0 <= report["error_estimate"] <= 1e-6
    assert "estimated relative error" in cli("run", "bouncing_ball", "--accuracy", "1e-6")[1]


def test_modes_are_listed_and_none_is_built(cli: Cli) -> None:
    code, out, _ = cli("modes", "toppling_stick", "--json")
    listed = json.loads(out)
    assert code == 0
    counts = [listed[key] for key in ("modes_declared", "modes_total", "modes_built")]
    assert counts == [3, 4, 0]
    (region,) = listed["regions"]
    assert [state["name"] for state in region["states"]] == ["free", "slide+", "slide-", "pin"]
    slips = [edge for edge in region["edges"] if edge["cause"] == "slip"]
    assert {(e["from"], e["to"], e["guard"]) for e in slips} == {
        ("pin", "slide+", "H < -mu V"),
        ("pin", "slide-", "H > mu V"),
    }
    assert "3 modes (4 with directions of sliding)" in cli("modes", "toppling_stick")[1]


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf", "dot", "mmd", "scxml"])
def test_draw_writes_the_format_of_the_suffix(cli: Cli, suffix: str) -> None:
    code, out, _ = cli("draw", "toppling_stick", "-o", f"chart.{suffix}")
    assert (code, out.strip()) == (0, f"chart.{suffix}")
    data = (cli.folder / f"chart.{suffix}").read_bytes()
    assert data
    if suffix in ("svg", "dot", "mmd", "scxml"):
        assert b"touchdown" in data


def test_draw_shows_the_path_that_a_run_took(cli: Cli) -> None:
    assert cli("draw", "toppling_stick", "-o", "chart.mmd", "--visited")[0] == 0
    text = (cli.folder / "chart.mmd").read_text(encoding="utf-8")
    assert "pin → slide- → slide+" in text
    assert "slip #215;1" in text
    assert "reverse #215;1" in text
    assert "free" not in text.split("classDef")[0].split("legend :")[0]


def test_draw_writes_guards_at_arrows_with_the_option(cli: Cli) -> None:
    for guards in ("legend", "inline"):
        assert cli("draw", "two_balls", "-o", f"{guards}.mmd", "--guards", guards)[0] == 0
    reported = [(cli.folder / f"{g}.mmd").read_text(encoding="utf-8") for g in ("legend", "inline")]
    assert [text.count("V #60; 0") for text in reported] == [1, 1]
    assert "legend : liftoff" in reported[0]
    assert "legend : liftoff" not in reported[1]


@pytest.mark.parametrize("scene", [(), ("--scene",)])
def test_a_drawing_without_a_file_is_svg_in_a_pipe_and_opens_on_a_terminal(
    cli: Cli, scene: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, _ = cli("draw", "bouncing_ball", *scene)
    assert (code, out[:5], out.rstrip()[-6:]) == (0, "<?xml", "</svg>")
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or True)
    monkeypatch.setattr("tempfile.tempdir", str(cli.folder))
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    code, out, _ = cli("draw", "bouncing_ball", *scene)
    assert opened == [Path(out.strip()).as_uri()]
    assert Path(out.strip()).name == "bouncing_ball.svg"


@pytest.mark.parametrize("scene", [(), ("--scene",)])
def test_place_and_suffix_of_a_drawing_are_checked_first(cli: Cli, scene: tuple[str, ...]) -> None:
    Path("file.yaml").write_text("")
    Path("folder.svg").mkdir()
    for place, reported in (
        ("nowhere/chart.svg", "-o nowhere/chart.svg: there is no folder"),
        ("file.yaml/chart.svg", "-o file.yaml/chart.svg: there is no folder"),
        ("folder.svg", "-o folder.svg: that is a folder; name a file in it"),
        ("", "-o: the name is empty; name a file"),
        ("chart.docx", "-o chart.docx: the suffix must be one of .svg, .png, .pdf"),
    ):
        code, out, err = cli("draw", "nobody_reads_this", *scene, "-o", place)
        assert (code, out) == (2, "")
        assert reported in err


@pytest.mark.parametrize("verb", ["run", "trade"])
def test_the_name_of_a_file_is_refused_for_a_folder(cli: Cli, verb: str) -> None:
    code, out, err = cli(verb, "bouncing_ball_chart", "-o", "a.csv")
    assert (code, out) == (2, "")
    assert "--output a.csv: the results are several files, in a folder; write --output a\n" in err
    assert not Path("a.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        ("check bouncing_ball_chart --examples -3", "must be 1 or more, up to 10**18, not -3"),
        ("check bouncing_ball_chart --examples 0", "must be 1 or more, up to 10**18, not 0"),
        ("check bouncing_ball_chart --examples 2.5", "'2.5' is not a whole number, such as 20"),
        ("check bouncing_ball_chart --seed -1", "must be 0 or more, up to 10**18, not -1"),
        (
            "sweep bouncing_ball_chart --over k=0.1 --workers 0",
            "must be 1 or more, up to 10**18, not 0",
        ),
        ("sweep bouncing_ball_chart --over k=0.1 --outputs ,", "no name is written"),
        (
            "run bouncing_ball --engine impulse --step 1e-300",
            "size of the scene; take 7e-17 or more",
        ),
        ("run bouncing_ball --engine impulse --step 0", "the step must be a positive time, not 0"),
        ("run bouncing_ball --until -1", "the end must be a finite time from 0 on, not -1"),
        ("run bouncing_ball --max-step -1", "the max_step must be a positive time, not -1"),
        ("run bouncing_ball --tolerance 2", "tolerance must be above 0 and below 1, not 2"),
        ("run bouncing_ball --engine rk45", "no value 'rk45'; write scipy with the method RK45"),
        ("run bouncing_ball --engine impuls", "no value 'impuls'; did you mean 'impulse'? known"),
        ("run bouncing_ball --budget 0", "the budget must be a positive time in seconds, not 0"),
    ],
)
def test_a_number_out_of_range_is_reported_with_the_range(
    cli: Cli, arguments: str, reported: str
) -> None:
    code, out, err = cli(*arguments.split())
    assert (code, out) == (2, "")
    assert reported in err


def test_an_empty_model_name_is_reported(cli: Cli) -> None:
    assert cli("run", "")[0] == 2
    assert "the name of the model is empty; known: arch" in cli("run", " ")[2]


def test_step_equal_to_a_short_run_is_accepted(cli: Cli) -> None:
    code, _, _ = cli(
        "run", "bouncing_ball", "--engine", "impulse", "--step", "0.1", "--until", "1e-300"
    )
    assert code == 0


def test_check_passes_on_a_shipped_model(cli: Cli) -> None:
    code, out, _ = cli("check", "bouncing_ball", "--examples", "1", "--seed", "1", "--json")
    report = json.loads(out)
    assert (code, report["passed"], report["seed"]) == (0, True, 1)
    assert list(cli.folder.iterdir()) == []


def test_failing_check_exits_with_1_and_writes_a_reproduction(cli: Cli) -> None:
    path = cli.write(
        "kind: chart\nname: fall\nparameters: {v0: 1}\nranges: {v0: [0, 1]}\n"
        "variables: {x: 0, v: v0}\nstop: {time: 3}\nregions:\n  r:\n    initial: s\n"
        "    states: {s: {flows: {x: v, v: -1}, invariants: {above: x >= -1}}}\n"
    )
    code, out, _ = cli("check", path, "--examples", "5", "--seed", "1")
    assert code == 1
    assert "above" in out
    assert "fall_failure.yaml reproduces it" in out
    assert cli("check", "fall_failure.yaml", "--examples", "1", "--seed", "1")[0] == 1


def test_new_writes_a_scene_that_runs_and_overwrites_nothing(cli: Cli) -> None:
    assert cli("new", "rod")[0] == 0
    text = (cli.folder / "rod.yaml").read_text()
    assert "NAME" not in text
    code, out, err = cli("run", "rod.yaml", "--json")
    assert (code, err) == (0, "")
    assert {event["cause"] for event in json.loads(out)["events"]} > {"touchdown", "slip"}
    code, _, err = cli("new", "rod")
    assert code == 2
    assert "exists already" in err
    assert (cli.folder / "rod.yaml").read_text() == text


def test_an_unexpected_error_is_one_message_without_a_traceback(
    cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(arguments: object) -> int:
        raise ZeroDivisionError("a bug")

    monkeypatch.delenv("STATECHART_DEBUG", raising=False)
    monkeypatch.setattr("statechart.cli.verbs.schema", broken)
    code, _, err = cli("schema")
    assert code == 1
    assert err.startswith("internal error, ZeroDivisionError: a bug")
    monkeypatch.setenv("STATECHART_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        cli("schema")


def test_an_interrupted_run_reports_and_saves_its_trace(
    cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    from statechart.charts.laws import ChartLaws

    jump, calls = ChartLaws.jump, []

    def interrupting(self: ChartLaws, *arguments: object) -> object:
        calls.append(1)
        if len(calls) == 8:
            raise KeyboardInterrupt
        return jump(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(ChartLaws, "jump", interrupting)
    code, out, _ = cli("run", "bouncing_ball_chart", "--output", "out")
    assert code == 1
    assert "INTERRUPTED" in out
    assert json.loads((cli.folder / "out" / "run.json").read_text())["events"]


def test_closed_stdout_pipe_is_no_error(tmp_path: Path) -> None:
    command = f"{sys.executable} -m statechart.cli.main schema | head -c 10"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("model", "others"),
    [
        ("toppling_stick", "{'scipy.integrate'}"),
        ("dice", "{'scipy.integrate', 'heyoka'}"),
    ],
    ids=["events", "steps"],
)
def test_a_run_imports_neither_plots_nor_tables_nor_other_engines(model: str, others: str) -> None:
    pytest.importorskip("heyoka")
    code = (
        f"import sys; from statechart.cli.main import main; main(['run', '{model}']);"
        "print(sorted(({'matplotlib', 'pandas', 'xarray', 'hypothesis', 'networkx', 'pygraphviz',"
        f"'rich', 'zarr'}} | {others}) & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
