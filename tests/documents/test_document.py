import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, model_validator

from statechart.charts.chart import Chart, Region, State
from statechart.charts.kind import CHART
from statechart.charts.transitions import Transition
from statechart.documents.outputs import Count, Event, Integral, Moment, Value
from statechart.documents.settings import Settings, Stop
from statechart.documents.validation import Document, validate
from statechart.documents.yaml_reader import read, read_text
from statechart.documents.yaml_writer import dump
from statechart.errors import DeclarationError, DeclarationProblem, Position
from statechart.loading.kind import entries, kind, kinds
from statechart.loading.load import find, interpret, load

STARTER = CHART.starter.read_text(encoding="utf-8")

BALL = """\
kind: chart
name: ball
parameters: {h: 1, g: 9.81, k: 0.9}
ranges: {k: [0.1, 0.95]}
variables: {x: h, v: 0}
regions:
  ball:
    initial: flight
    states:
      flight:
        flows: {x: v, v: -g}
      rest: {}
    transitions:
    - {name: bounce, from: flight, to: flight, guard: x <= 0, updates: {v: -k*v}}
    - {name: settle, from: flight, to: rest, on: zeno, updates: {x: 0, v: 0}}
stop: {time: 10, conditions: {far: x >= 100}}
outputs:
  bounces: {count: bounce}
  t_rest: {value: time, at: first settle}
"""


def ball_with(old: str, new: str) -> str:
    assert BALL.count(old) == 1
    return BALL.replace(old, new)


def refused(text: str) -> DeclarationError:
    with pytest.raises(DeclarationError) as caught:
        validate(read_text(text, "f.yaml"), Chart)
    return caught.value


def ball() -> Chart:
    return Chart(
        name="ball",
        parameters={"h": 1, "g": 9.81, "k": 0.9},
        ranges={"k": (0.1, 0.95)},
        variables={"x": "h", "v": 0},
        regions={
            "ball": Region(
                initial="flight",
                states={"flight": State(flows={"x": "v", "v": "-g"}), "rest": State()},
                transitions=(
                    Transition(
                        name="bounce",
                        source="flight",
                        target="flight",
                        guard="x <= 0",
                        updates={"v": "-k*v"},
                    ),
                    Transition(
                        name="settle",
                        source="flight",
                        target="rest",
                        on="zeno",
                        updates={"x": 0, "v": 0},
                    ),
                ),
            )
        },
        stop=Stop(time=10, conditions={"far": "x >= 100"}),
        outputs={
            "bounces": Count(count="bounce"),
            "t_rest": Value(value="time", at="first settle"),
        },
    )


def test_yaml_and_python_declare_the_same_chart() -> None:
    assert validate(read_text(BALL), Chart) == ball()


def test_chart_round_trips_through_yaml() -> None:
    assert validate(read_text(dump(ball())), Chart) == ball()
    assert dump(ball()).startswith("kind: chart\nname: ball\n")


def test_chart_with_every_field_round_trips() -> None:
    chart = ball().model_copy(
        update={
            "doc": "off: 'a' # \"b\"\n\tnull µ {x}: - & * !",
            "settings": Settings(engine="scipy", method="Radau", tolerance=1 / 3 * 1e-9),
            "outputs": {
                "yes": Integral(integral="x", during={"ball": "flight"}),
                "null": Value(value="1e3*x", at="each ball.bounce", before=True),
                "later": Count(count="settle"),
            },
        }
    )
    assert validate(read_text(dump(chart)), Chart) == chart


@given(
    st.dictionaries(
        st.from_regex(r"q[A-Za-z0-9_]{0,8}", fullmatch=True),
        st.floats(allow_nan=False) | st.integers(-(10**20), 10**20),
        max_size=5,
    ),
    st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=80),
)
def test_numbers_and_text_survive_exactly(parameters: dict[str, float | int], doc: str) -> None:
    chart = Chart.model_validate(
        {**ball().model_dump(by_alias=True), "parameters": {"h": 1, "g": 1, "k": 1} | parameters}
        | {"doc": doc}
    )
    back = validate(read_text(dump(chart)), Chart)
    assert back == chart
    assert [type(value) for value in back.parameters.values()] == [
        type(value) for value in chart.parameters.values()
    ]


@pytest.mark.parametrize(
    "text", ["1e-3", "1", "true", "null", "~", "", ".inf", "a: b", "# x", "- a", "'", "[", "off"]
)
def test_text_that_resembles_another_type_stays_text(text: str) -> None:
    chart = ball().model_copy(update={"doc": text})
    assert validate(read_text(dump(chart)), Chart).doc == text


@pytest.mark.parametrize("spelling", ["inf", ".inf", "'inf'"])
def test_infinity_is_an_ordinary_parameter(spelling: str) -> None:
    chart = validate(read_text(ball_with("k: 0.9", f"k: {spelling}")), Chart)
    assert chart.values()["k"] == math.inf
    assert validate(read_text(dump(chart)), Chart) == chart
    python = Chart.model_validate(
        {**ball().model_dump(by_alias=True), "parameters": {"h": 1, "g": 9.81, "k": math.inf}}
    )
    assert validate(read_text(dump(python)), Chart) == python == chart


def test_plain_scalars_follow_yaml_1_2() -> None:
    data = read_text(
        "a: 1e-3\nb: off\nc: yes\nd: 0x10\ne: 1_000\nf: 12:30\ng: 2001-01-01\nh: +.5\n"
        "i: '1'\nj: true\nk: null\nl:\nm: 007\nn: -3\no: =\n"
    ).data
    assert data == {
        **{"a": 1e-3, "b": "off", "c": "yes", "d": "0x10", "e": "1_000", "f": "12:30"},
        **{"g": "2001-01-01", "h": 0.5, "i": "1", "j": True, "k": None, "l": None, "m": 7},
        **{"n": -3, "o": "="},
    }
    assert type(data["a"]) is float
    assert type(data["m"]) is int


def test_positions_are_those_of_the_text() -> None:
    found = read_text("a: 1\nb:\n  c: [1, {d: 2}]\n  'e': \"xy\"\n", "f.yaml")
    assert found.position(("a",)) == Position("f.yaml", 1, 4)
    assert found.position(("b", "c", 1, "d")) == Position("f.yaml", 3, 14)
    assert found.position(("b", "c", 1, "d"), key=True) == Position("f.yaml", 3, 11)
    assert found.position(("b", "missing", "x")) == Position("f.yaml", 3, 3)
    assert found.position(("b", "e")) == Position("f.yaml", 4, 9)
    assert found.position(("b", "name of a union", "c", 0)) == Position("f.yaml", 3, 7)
    assert found.position(("nothing",)) == Position("f.yaml", 1, 1)


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("ranges:", "rnges:", "4:1", "unknown key 'rnges'; did you mean 'ranges'? known keys: "),
        ("name: ball", "", "1:1", "'name' is missing"),
        ("name: ball", "name: 5", "2:7", "name: must be text, not 5"),
        ("name: ball", "name: a-b", "2:7", "not a name"),
        ("k: 0.9", "k: 0.9*hh", "3:36", "unknown name 'hh'; did you mean 'h'?"),
        ("k: 0.9", "k: '1 + hh'", "3:37", "unknown name 'hh'"),
        ("k: 0.9", "k: g*k", "3:32", "k -> k"),
        ("k: 0.9", "k: true", "3:32", "must be a number or a formula"),
        ("k: 0.9", "k: .nan", "3:32", "a finite number or inf"),
        ("k: 0.9", "k: [1]", "3:32", "must be a number or a formula"),
        ("k: 0.9", "k: inf - inf", "3:36", "no value"),
        (
            "k: 0.9",
            "k: 0.9, sin: 1",
            "3:37",
            "'sin' is a function of formulas; write another name, such as sin_1",
        ),
        ("k: 0.9", "k: 0.9, time: 1", "3:37", "time of the run"),
        ("{k: [0.1, 0.95]}", "{q: [0.1, 0.95]}", "4:10", "no parameter 'q'"),
        ("{k: [0.1, 0.95]}", "{k: [1, 0]}", "4:13", "least value comes first"),
        ("{k: [0.1, 0.95]}", "{k: [1]}", "4:13", "must have 2 items"),
        ("{k: [0.1, 0.95]}", "{k: [1, .inf]}", "4:17", "must be a finite number"),
        ("{k: [0.1, 0.95]}", "{k: [1, '2']}", "4:18", "must be a number, not '2'"),
        (
            "v: 0}\nreg",
            "v: 1/(k-0.1)}\nreg",
            "4:14",
            "with k = 0.1, variables.v (line 5, column 22): ",
        ),
        ("v: 0}\nreg", "v: v}\nreg", "5:22", "unknown name 'v'"),
        ("v: 0}\nreg", "v: inf}\nreg", "5:22", "must be finite"),
        (
            "v: 0}\nreg",
            "v: 0, g: 1}\nreg",
            "5:25",
            "'g' is a parameter, parameters.g (line 3, column 20)",
        ),
        ("initial: flight", "initial: fligt", "8:14", "no state 'fligt'; did you mean 'flight'?"),
        (
            "x: v,",
            "y: v,",
            "11:17",
            "no variable 'y'; known: v, x; if it is new, give its start: variables: {y: 0}",
        ),
        ("v: -g", "v: -G", "11:27", "unknown name 'G'"),
        ("rest: {}", "rest: {flow: {}}", "12:14", "did you mean 'flows'? known keys: entry"),
        ("rest: {}", "rest:", "12:7", "regions.ball.states.rest: nothing is written"),
        ("rest: {}", "rest: {invariants: {low: x <= y}}", "12:37", "unknown name 'y'"),
        ("to: rest", "to: rset", "15:40", "no state 'rset'; did you mean 'rest'?"),
        ("to: rest", "target: rest", "15:36", "unknown key 'target'"),
        ("guard: x <= 0", "guard: x + 0", "14:60", "a comparison is missing"),
        (
            "guard: x <= 0",
            "guard: x <= 0, on: zeno",
            "14:7",
            "needs one of guard, on, after, every",
        ),
        ("guard: x <= 0, ", "", "14:7", "needs one of guard, on, after, every"),
        ("on: zeno", "on: zen", "15:50", "no cause or state 'zen'; did you mean 'zeno'?"),
        ("{v: -k*v}", "{w: -k*v}", "14:73", "no variable 'w'"),
        ("time: 10", "time: -10", "16:14", "must be a finite time from 0 on"),
        ("time: 10", "time: x", "16:14", "unknown name 'x'"),
        ("x >= 100", "z >= 100", "16:36", "unknown name 'z'"),
        ("count: bounce", "count: bonce", "18:20", "'bonce'; did you mean 'bounce'?"),
        ("count: bounce", "count: bal.bounce", "18:20", "no region 'bal'"),
        ("count: bounce", "count: bounce, at: end", "18:28", "unknown key 'at'; known keys: count"),
        ("count: bounce", "cuont: bounce", "18:12", "has one of the keys"),
        ("at: first settle", "at: frist settle", "19:29", "is not a moment"),
        ("at: first settle", "at: last 0 settle", "19:29", "is not a moment"),
        ("at: first settle", "at: each 3 settle", "19:29", "is not a moment"),
        ("at: first settle", "at: last 3", "19:29", "'3' is not an event"),
        ("at: first settle", "at: end, before: true", "19:42", "there is no jump at 'end'"),
        ("at: first settle", "at: first settle, before: 1", "19:51", "must be true or false"),
        ("value: time", "value: tme", "19:19", "unknown name 'tme'; did you mean 'time'?"),
        (
            "{value: time, at: first settle}",
            "{integral: x, during: {ball: fly}}",
            "19:40",
            "no state",
        ),
        ("outputs:", "settings: {engine: taylr}\noutputs:", "17:20", "must be 'auto', 'taylor'"),
        ("outputs:", "settings: {tolerance: 0}\noutputs:", "17:23", "must be greater than 0"),
        ("outputs:", "settings: {tolerance: 1e-3, accuracy: 1e-3}\noutputs:", "17:29", "exclude"),
        ("outputs:", "settings: {engine: taylor, method: RK45}\noutputs:", "17:28", "no method"),
    ],
)
def test_every_problem_reports_place_and_message(
    old: str, new: str, place: str, words: str
) -> None:
    error = refused(ball_with(old, new))
    assert str(error).startswith(f"f.yaml:{place}: ")
    assert words in str(error)


def test_the_same_transition_twice_is_refused() -> None:
    error = refused(
        ball_with("name: settle, from: flight, to: rest", "name: bounce, from: flight, to: flight")
    )
    assert (error.line, error.column) == (15, 14)
    assert "a second transition 'bounce' from 'flight' to 'flight'" in error.message


def test_two_regions_must_not_move_the_same_variable() -> None:
    error = refused(
        ball_with("regions:\n", "regions:\n  wind: {initial: on, states: {on: {flows: {x: 1}}}}\n")
    )
    assert (error.line, error.column) == (12, 17)
    for word in ("'ball'", "'flight'", "'wind'", "'on'", "'x'"):
        assert word in error.message


def test_several_errors_are_listed_in_order() -> None:
    error = refused(ball_with("rest: {}", "rest: {flow: 1}").replace("time: 10", "tiem: 10"))
    assert [line.split(": ")[0] for line in str(error).splitlines()] == [
        "f.yaml:12:14",
        "f.yaml:16:8",
    ]
    assert len(error.others) == 1


def test_output_moments_and_events_are_parsed() -> None:
    assert Value(value=1).moment == Moment("end")
    assert Value(value=1, at="first tip.slip").moment == Moment("first", (Event("tip", "slip"),))
    assert Count(count="slip").events == (Event(None, "slip"),)


def test_a_validator_can_point_at_a_field() -> None:
    class Pair(BaseModel):
        least: float
        most: float

        @model_validator(mode="after")
        def _ordered(self) -> "Pair":
            if self.least > self.most:
                raise DeclarationProblem("below least", advice="swap them", loc=("most",))
            return self

    class Pairs(BaseModel):
        pairs: list[Pair]

    with pytest.raises(DeclarationError) as caught:
        validate(read_text("pairs:\n- {least: 2, most: 1}\n", "p.yaml"), Pairs)
    assert str(caught.value) == "p.yaml:2:20: pairs.0.most: below least; swap them"


def test_models_are_immutable() -> None:
    with pytest.raises(DeclarationError, match="Chart: name does not change once it is built"):
        ball().name = "other"  # type: ignore[misc]


@pytest.fixture
def _anew() -> Iterator[None]:
    """Search installed packages again now, and after the test."""
    entries.cache_clear()
    yield
    entries.cache_clear()


@pytest.fixture
def _installed(_anew: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Offer one kind, one broken kind and one shipped model, whatever is installed."""
    shipped = tmp_path / "shipped.yaml"
    shipped.write_text(BALL, encoding="utf-8")

    def entry(name: str, module: str, loaded: object) -> SimpleNamespace:
        def load_entry() -> object:
            assert loaded is not None, f"kind {name!r} must not be imported"
            return loaded

        return SimpleNamespace(name=name, module=module, attr="path", load=load_entry)

    groups = {
        "statechart.kinds": [
            entry("chart", "statechart.kinds", CHART),
            entry("scene", "contacts.kind", None),
        ],
        "statechart.models": [entry("shipped", "math", None)],
    }
    monkeypatch.setattr("importlib.metadata.entry_points", lambda *, group: groups[group])
    monkeypatch.setattr(math, "names", lambda: ["ball"], raising=False)
    path = {"ball": shipped}.get
    monkeypatch.setattr(math, "path", path, raising=False)


@pytest.mark.usefixtures("_installed")
def test_only_the_package_of_the_kind_is_imported() -> None:
    assert interpret(read_text(BALL)) == ball()
    assert set(kinds()) == {"chart", "scene"}
    assert kind("chart") is CHART
    assert isinstance(interpret(read_text(STARTER)), Chart)


@pytest.mark.usefixtures("_installed")
@pytest.mark.parametrize(
    ("line", "place", "words"),
    [("kind: chat", "1:7", "did you mean 'chart'?"), ("", "2:1", "'kind' is missing"),
     ("kind: [chart]", "1:7", "unknown kind")],
)  # fmt: skip
def test_an_unknown_kind_is_refused(line: str, place: str, words: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(ball_with("kind: chart", line), "f.yaml"))
    assert str(caught.value).startswith(f"f.yaml:{place}: ")
    assert words in str(caught.value)


@pytest.mark.usefixtures("_installed")
def test_load_accepts_a_path_or_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(BALL, encoding="utf-8")
    assert find(str(own)) == own
    assert find("ball") == tmp_path / "shipped.yaml"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ball").mkdir()
    assert find("ball") == tmp_path / "shipped.yaml"
    assert load("ball") == load(own) == ball()
    with pytest.raises(DeclarationError, match="did you mean 'ball'"):
        find("bal")
    with pytest.raises(DeclarationError):
        find("a\0b")
    with pytest.raises(DeclarationError):
        find("a" * 5000)


def test_a_file_without_its_suffix_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hop.yaml").write_text(BALL)
    with pytest.raises(DeclarationError, match=r"no such file: 'hop'; write hop\.yaml"):
        find("hop")
    with pytest.raises(DeclarationError, match="no such file"):
        find("a" * 253)


@pytest.mark.usefixtures("_anew")
def test_the_installed_kinds_and_models_are_optional(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.metadata.entry_points", lambda *, group: [])
    with pytest.raises(DeclarationError, match="no such file, and no shipped model"):
        find("toppling_stick")
    with pytest.raises(DeclarationError, match="unknown kind 'chart'"):
        interpret(read_text(BALL))


def test_unreadable_files_are_refused_with_the_reason(tmp_path: Path) -> None:
    def reason(path: Path) -> str:
        with pytest.raises(DeclarationError) as caught:
            read(path)
        assert str(caught.value).startswith(str(path))
        return str(caught.value)

    empty, latin = tmp_path / "empty.yaml", tmp_path / "latin.yaml"
    empty.write_bytes(b"")
    latin.write_bytes(b"a: 1\nb: \xe9\n")
    assert "no such file" in reason(tmp_path / "missing.yaml")
    assert "folder" in reason(tmp_path)
    assert "the file is empty" in reason(empty)
    assert f"{latin}:2:4: the byte 0xe9 is not UTF-8" in reason(latin)
    if Path("/dev/zero").exists():
        assert "not a file" in reason(Path("/dev/zero"))


def test_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "bom.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    found: Document = read(path)
    assert found.data == {"a": 1}
    assert found.source == str(path)
