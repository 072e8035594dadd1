"""Summaries of large runs: listed and counted items."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from statechart.automaton.clock import between
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import load
from statechart.reporting.text import _values, change, summary
from statechart.running.runner import Runner
from statechart.tabular import (
    abridge,
    align_numbers,
    number,
    pluralise,
    readable_count,
    table,
)

GRAINS = """\
kind: scene
name: grains
gravity: 9.81
bodies:
  grain:
    copies: 60
    mass: 1
    inertia: 1
    shape: {disc: 0.4}
    start: {x: index, y: 0.41 + 0.001*index}
surfaces: {ground: {height: 0}}
collisions: {grains: {bodies: [grain], surfaces: [ground], friction: 0.4, restitution: 0}}
stop: {time: 0.2}
settings: {engine: impulse, step: 1e-3, record: poses}
"""


@pytest.fixture(scope="module")
def report():
    return Runner(read_text(GRAINS)).run().to_dict()


def under(text: str, title: str) -> list[str]:
    """Return the lines of a part of a summary."""
    return text.split(f"\n{title}\n")[1].split("\n\n")[0].splitlines()


def test_the_first_and_the_last_of_many_variables_are_listed(report) -> None:
    lines = under(summary(report), "final state")
    names = list(report["final"])
    assert len(names) == 360
    listed = [line.split()[0] for line in lines]
    assert listed == [*names[:10], "...", *names[-10:]]
    assert lines[10] == "  ... 340 more: --json or --output has all"


def test_the_least_of_many_margins_are_listed(report) -> None:
    lines = under(summary(report), "margins, least sampled value")
    margins = report["margins"]
    left_out = len(margins) - 20
    assert left_out > 0
    least = sorted(margins, key=margins.__getitem__)[:20]
    assert [line.split()[0] for line in lines[:-1]] == least
    assert lines[-1].split() == f"... {left_out} more: --json or --output has all".split()


def test_a_margin_without_a_value_comes_first(report) -> None:
    margins = {**report["margins"], "zz.gap": "nan"}
    lines = under(summary(report | {"margins": margins}), "margins, least sampled value")
    assert lines[0].split() == ["zz.gap", "nan"]


def test_huge_mode_counts_are_printed_as_powers(report) -> None:
    total = report["modes_total"]
    assert total > 10**20
    with_events = report | {"step": None, "tolerance": 1e-9}
    said = re.search(r"of about (\S+) modes built", summary(with_events))
    assert said is not None
    assert float(said[1]) == pytest.approx(total, rel=0.05)
    assert json.loads(json.dumps(report))["modes_total"] == total
    assert "about" in report["left_out"][0]["what"]


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (1, "1"),
        (999_999_999, "999999999"),
        (10**9, "about 1.0e9"),
        (3**302, "about 1.2e144"),
        (10**400 * 15, "about 1.5e401"),
        (3**10_000, "about 1.6e4771"),
    ],
    ids=["one", "counted", "first", "grains", "beyond floats", "beyond text"],
)
def test_integers_are_printed_without_decimals(number: int, said: str) -> None:
    assert readable_count(number) == said


def test_few_values_are_all_listed() -> None:
    result = Runner("toppling_stick").run()
    lines = under(summary(result.to_dict()), "final state")
    assert [line.split()[0] for line in lines] == list(result.trace.variables)
    assert abridge("few") == list("few")


def test_some_of_many_regions_are_listed(tmp_path, capsys) -> None:
    path = tmp_path / "grains.yaml"
    path.write_text(GRAINS)
    assert main(["validate", str(path)]) == 0
    said = capsys.readouterr().out
    assert said.endswith("starts in 60 free\n")
    assert main(["modes", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("  grain") for line in lines) == 20
    assert lines.count("  ... 40 more: --json has all") == 1
    assert lines.count("... 40 more: --json has all") == 1


def test_a_change_shared_by_many_bodies_is_listed_once() -> None:
    event = {
        "contact": "A",
        "impulse": {"A": {}, "D": {}, "E": {}},
        "from": {"A": "free", "B": "pin", "C": "free", "D": "slide", "E": "slide", "F": "pin"},
        "to": {"A": "pin", "B": "free", "C": "pin", "D": "slide", "E": "slide", "F": "pin"},
    }
    assert change(event) == "A, C: free -> pin; B: pin -> free; D, E: slide again"
    assert change(event, 1) == "2 regions: free -> pin; B: pin -> free; 2 regions: slide again"
    bounce = {"contact": "A", "impulse": {"A": {}}, "from": {"A": "free"}, "to": {"A": "free"}}
    assert change(bounce) == "free again"
    assert change({**bounce, "contact": None, "impulse": {}}) == ""


@pytest.mark.parametrize(
    ("value", "digits", "said"),
    [
        (1 / 3, 7, "0.3333333"),
        (1 / 3, 17, "0.3333333333333333"),
        (-0.0, 7, "0"),
        ("inf", 7, "inf"),
        (None, 7, "none"),
        (3**50, 7, str(3**50)),
        ([1 / 3, None], 7, "[0.3333333, none]"),
        ([*range(6)], 7, "[0, 1, 2, 3, 4, 5]"),
        ([2.5, 4.0, *[None] * 5, 1.25], 7, "8 values: 2.5 ... 1.25, min 1.25, max 4"),
        (["nan"] * 7, 7, "7 values: nan ... nan, min nan, max nan"),
    ],
)
def test_numbers_are_rounded_for_reading(value: Any, digits: int, said: str) -> None:
    assert number(value, digits) == said


def test_numbers_of_a_column_have_their_decimal_points_below_each_other() -> None:
    found = align_numbers(["-1.5", "20", "3e-05", "none", "0.125", ""])
    assert found == ["-1.5", "20", " 3e-05", "none", " 0.125", ""]


def test_several_writes_singular_and_plural():
    assert [pluralise(count, "step") for count in (0, 1, 2)] == ["0 steps", "1 step", "2 steps"]
    assert pluralise(10**143, "mode") == "about 1.0e143 modes"


ONE = """\
kind: chart
name: one
parameters: {a: 1}
ranges: {a: [1, 2]}
variables: {x: 0}
regions:
  r:
    initial: s
    states: {s: {flows: {x: a}}}
    transitions: [{name: once, from: s, to: s, guard: x >= 1, updates: {x: -10}}]
stop: {time: 2}
invariants: {low: x <= 5}
settings: {max_jumps: LIMIT}
"""
OF_ONE = re.compile(r"(?<![\d.])1 (?!is\b|was\b|has\b)[a-z]+s\b")


@pytest.mark.parametrize(
    ("verb", "limit"),
    [
        (["validate"], 100),
        (["run", "--engine", "scipy"], 100),
        (["run", "--engine", "scipy"], 1),
        (["run", "--accuracy", "1e-3", "-o", "out"], 100),
        (["modes"], 100),
        (["check", "--examples", "1"], 100),
        (["sweep", "--over", "a=1"], 100),
    ],
)
def test_messages_use_the_singular_for_one(
    verb: list[str], limit: int, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("one.yaml").write_text(ONE.replace("LIMIT", str(limit)))
    main([verb[0], "one.yaml", *verb[1:]])
    said = capsys.readouterr()
    assert re.search(r"(?<![\d.])1 [a-z]+\b", said.out + said.err)
    assert not OF_ONE.search(said.out + said.err), said.out + said.err
    for file in Path("out").glob("run.json"):
        assert not OF_ONE.search(file.read_text())


@pytest.mark.parametrize("engine", ["taylor", "impulse"])
@pytest.mark.parametrize(
    ("end", "reported"), [("pi", "3.14159"), ("0.67*3", "2.01"), ("1e-7", "1e-07")]
)
def test_times_in_messages_have_the_digits_of_other_numbers(
    engine: str, end: str, reported: str
) -> None:
    scene = f"{{kind: scene, name: b, bodies: {{ball: {{mass: 1}}}}, stop: {{time: {end}}}}}"
    step = 1e-8 if end == "1e-7" else 0.01
    runner = Runner(read_text(scene), engine=engine, step=step if engine == "impulse" else None)
    assert runner.run().trace.message == f"reached t = {reported}"


def test_a_list_of_values_leaves_units_of_others_where_they_are() -> None:
    text = summary(Runner(load("newtons_cradle")).run().to_dict())
    lines = [line for line in under(text, "outputs") if line.endswith((" s", " rad/s"))]
    assert all("]  " in line for line in lines)
    report = {"clicks": 12.5, "times": [0.125, 0.25, 0.375, 0.5], "gone": None}
    [_, found] = _values("outputs", list(report.items()), {"clicks": "m", "times": "s"})
    assert table(found.rows).splitlines() == [
        "  clicks  12.5  m",
        "  times   [0.125, 0.25, 0.375, 0.5]  s",
        "  gone    none",
    ]


def test_times_of_steps_have_no_digits_that_the_step_has_not() -> None:
    text = GRAINS.replace(", record: poses", "").replace("time: 0.2", "time: 40")
    text = text.replace("copies: 60", "copies: 2").replace("restitution: 0", "restitution: 1")
    trace = Runner(read_text(text)).run().trace
    halves = [round(jump.t / 5e-4) for jump in trace.jumps]
    assert len(halves) > 800
    # As far as decimals go: the float nearest to the number that is written so.
    assert [jump.t for jump in trace.jumps] == [float(Fraction(k, 2000)) for k in halves]
    for one, other in pairwise(trace.arcs):
        assert abs(between(one.end, other.start)) <= 1e-15


def test_times_in_tables_have_no_digits_that_the_step_has_not(tmp_path: Path) -> None:
    text = GRAINS.replace(", record: poses", "").replace("copies: 60", "copies: 2")
    result = Runner(read_text(text)).run()
    result.save(tmp_path / "run", samples=True)
    rows = (tmp_path / "run" / "samples.csv").read_text().splitlines()[1:]
    reported = [row.split(",")[0] for row in rows]
    # Eighths of steps, and of the halves of those with an impact.
    parts = [float(Fraction(round(float(t) / 6.25e-5), 16000)) for t in reported]
    assert len(parts) > 1600
    assert reported == list(map(str, parts))
    assert result.samples.t.tolist() == parts
