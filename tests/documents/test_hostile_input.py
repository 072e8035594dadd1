"""Nothing in a file can run code, hang the reader, or end in anything but a DeclarationError."""

import builtins
import os
import sys
from collections import namedtuple
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from statechart.charts.chart import Chart
from statechart.documents.validation import Document, validate
from statechart.documents.yaml_reader import MAX_BYTES, MAX_DEPTH, MAX_VALUES, read, read_text
from statechart.errors import DeclarationError, FormulaError
from statechart.formulas.formula import parse
from statechart.formulas.relation import parse_relation
from statechart.formulas.syntax import MAX_LENGTH

# Each would run code, reach an object's inside or exhaust memory in some reader of formulas.
ESCAPES = [
    "__import__('os').system('x')",
    "__import__",
    "__builtins__",
    "(1).__class__",
    "().__class__.__bases__[0].__subclasses__()",
    "1.__class__",
    "x.__class__.__mro__",
    "g.real",
    "x.func",
    "lambda: 1",
    "(lambda: 1)()",
    "[].append(1)",
    "[i for i in (1, 2)]",
    "{1: 2}",
    "'text'",
    '"text"',
    "f'{x}'",
    "x if x else 1",
    "x and 1",
    "not x",
    "x; import os",
    "x\nimport os",
    "x := 1",
    "x = 1",
    "x[0]",
    "x()",
    "eval(x)",
    "exec(x)",
    "open(x)",
    "getattr(x, x)",
    "sqrt.__self__",
    "sin.func(x)",
    "Function(x)",
    "Symbol(x)",
    "factorial(1e9)",
    "x!",
    "x % 2",
    "x // 2",
    "x @ x",
    "x | x",
    "~x",
    "x ** 2 ** 99",
    "2**2**2**2**99",
    "9**9**9**9",
    "((((10**64)**64)**64)**64)",
    "(1/10**64)**64**64",
    "x**1e9",
    "x**-1e9",
    "x**inf",
    "exp(exp(exp(exp(9))))",
    "1e999",
    "9" * 400,
    "(" * 10**6,
    "-" * 1000 + "1",
    "(" * 500 + "1" + ")" * 500,
    "sin(" * 300 + "1" + ")" * 300,
    "1" + "**1" * 300,
    "1" + "+1" * 900,
    "x" * (MAX_LENGTH + 1),
    "х",  # noqa: RUF001 -- CYRILLIC SMALL LETTER HA, looks like x
    "ｓｉｎ(x)",  # noqa: RUF001 -- full width
    "ⅹ + 1",  # noqa: RUF001 -- SMALL ROMAN NUMERAL TEN
    "١ + 1",  # noqa: RUF001 -- ARABIC-INDIC DIGIT ONE
    "x²",
    "2×3",  # noqa: RUF001
    "1 − 1",  # noqa: RUF001 -- MINUS SIGN
    "x\u00a0+ 1",
    "x\u200b + 1",
    "x\u202e",
    "x\0",
    "\\x41",
    "%s",
    "$x",
    "`ls`",
    "# x",
    "...",
    "None",
    "True",
]

BUILT = """\
kind: chart
name: hostile
parameters: {{g: {parameter}}}
variables: {{x: {initial}}}
regions:
  r:
    initial: s
    states: {{s: {{flows: {{x: {flow}}}, invariants: {{i: {invariant}}}}}}}
    transitions: [{{name: t, from: s, to: s, guard: {guard}, updates: {{x: {update}}}}}]
stop: {{time: {stop}, conditions: {{c: {condition}}}}}
outputs: {{v: {{value: {value}}}, i: {{integral: {integral}}}, m: {{maximum: {maximum}}}}}
"""
FORMULAS = dict.fromkeys(
    ("parameter", "initial", "flow", "update", "stop", "value", "integral", "maximum"), "1"
)
RELATIONS = dict.fromkeys(("invariant", "guard", "condition"), "x <= 0")


def quoted(text: str) -> str:
    """Return YAML text with every unusual character escaped."""
    escaped = "".join(c if c.isalnum() and c.isascii() else f"\\U{ord(c):08X}" for c in text)
    return f'"{escaped}"'


@pytest.fixture(autouse=True)
def _nothing_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluate = builtins.eval

    def forbidden(*arguments: object, **options: object) -> object:
        # Late imports, such as numpy.random by Hypothesis, may have named tuples.
        if sys._getframe(1).f_code is namedtuple.__code__:
            return evaluate(*arguments, **options)  # type: ignore[arg-type]
        raise AssertionError("text of a file was run")

    monkeypatch.setattr(os, "system", forbidden)
    monkeypatch.setattr(builtins, "eval", forbidden)


@pytest.mark.parametrize("text", ESCAPES, ids=lambda text: ascii(text[:40]))
def test_formulas_cannot_escape_the_sandbox(text: str) -> None:
    with pytest.raises(FormulaError):
        parse(text).require({"x", "g"})
    with pytest.raises(FormulaError):
        parse_relation(f"0 <= {text}").require({"x", "g"})


@pytest.mark.parametrize("text", ESCAPES, ids=lambda text: ascii(text[:40]))
def test_documents_cannot_escape_the_sandbox(text: str) -> None:
    shown = text if len(text) < 5000 else text[:5000]
    for field in (*FORMULAS, *RELATIONS):
        hostile = f"0 <= {shown}" if field in RELATIONS else shown
        document = BUILT.format(**FORMULAS | RELATIONS | {field: quoted(hostile)})
        try:
            validate(read_text(document, "f.yaml"), Chart)
        except DeclarationError as error:
            line = error.line
        else:
            pytest.fail(f"{field} lets it through")
        lines = enumerate(document.splitlines(), 1)
        place = next(number for number, line in lines if quoted(hostile) in line)
        assert line == place, field


def test_document_without_escapes_is_valid() -> None:
    assert validate(read_text(BUILT.format(**FORMULAS | RELATIONS)), Chart).name == "hostile"


LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(20)
)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        (LAUGHS, "1:4", "anchor"),
        ("a: &a [*a]\n", "1:4", "anchor"),
        ("a: *b\n", "1:4", "alias"),
        ("a: 1\nb: {<<: {c: 1}}\n", "2:5", "merge key"),
        ("a: !!python/object/apply:os.system ['x']\n", "1:4", "tag"),
        ("a: !!python/name:os.system\n", "1:4", "tag"),
        ("a: !!str 1\n", "1:4", "tag"),
        ("a: ! 1\n", "1:4", "tag"),
        ("!!map {a: 1}\n", "1:1", "tag"),
        ("%TAG ! tag:x,2000:\n---\na: 1\n", "2:1", "directive"),
        ("%YAML 1.1\n---\na: off\n", "2:1", "directive"),
        ("a: 1\na: 2\n", "2:1", "duplicate key 'a'; the first is on line 1"),
        ("a: {b: 1, 'b': 2}\n", "1:11", "duplicate key 'b'"),
        ("a: 1\n---\nb: 2\n", "2:1", "second document"),
        ("a: 1\n...\n---\n", "3:1", "second document"),
        ("a: " + "[" * 100_000, "1:35", "nested deeper"),
        ("{a: " * 50_000, "1:129", "nested deeper"),
        ("- " * 50_000, "1:1", "a model is a mapping"),
        ("a:\n" + "- " * 50_000, "2:63", "nested deeper"),
        ("? " * 50_000, "1:3", "a key must be a word"),
        ("? [1]\n: 2\n", "1:3", "a key must be a word"),
        ("a: [" + "1," * (MAX_VALUES + 1) + "]", "1:", "more than"),
        ("a: 1\nb: x\0y\n", "2:5", "U+0000"),
        ("a: \x1b[31m\n", "1:4", "U+001B"),
        ("a:\n\tb: 1\n", "2:1", "not YAML"),
        ("a: [1\n", "2:1", "not YAML"),
        ("a: 'x\n", "1:4", "not YAML"),
        ("a: b: c\n", "1:5", "not YAML"),
        ("a: " + "9" * 10_000, "1:4", "too many digits"),
        ("", "1:1", "empty"),
        ("# only a comment\n", "1:1", "empty"),
        ("--- \n", "", "a model is a mapping"),
        ("just text\n", "1:1", "a model is a mapping"),
        ("x" * 2_000_000, "", "more than"),
        ("a: 1\n" * 400_000, "", "more than"),
    ],
    ids=lambda value: ascii(value[:30]),
)
def test_hostile_yaml_is_refused_with_its_place(text: str, place: str, words: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        read_text(text, "f.yaml")
    assert str(caught.value).startswith(f"f.yaml:{place}" if place else "f.yaml:")
    assert words in str(caught.value)


def test_values_at_the_bounds_are_allowed() -> None:
    depth = MAX_DEPTH - 1
    assert read_text("a: " + "[" * depth + "]" * depth).data["a"]
    comment = "# " + "x" * (MAX_BYTES - len("a: 1\n") - 3) + "\n"
    assert read_text("a: 1\n" + comment).data == {"a": 1}


def test_a_scene_of_a_thousand_bodies_is_read() -> None:
    bodies = "".join(f"  p{i}:\n    mass: 1\n    start:\n      y: {i}\n" for i in range(1000))
    contacts = "".join(
        f"  c{i}:\n    point: {{body: p{i}}}\n    surface: ground\n    friction: 0.3\n"
        "    restitution: 0.5\n"
        for i in range(1000)
    )
    found = read_text(f"bodies:\n{bodies}contacts:\n{contacts}")
    assert [*found.data["bodies"]] == [f"p{i}" for i in range(1000)]
    assert found.data["contacts"]["c999"]["point"] == {"body": "p999"}


def test_hostile_input_is_rejected_before_it_is_built() -> None:
    # Would take 9^20 list items if the aliases were followed.
    with pytest.raises(DeclarationError, match="anchor"):
        read_text(LAUGHS)
    assert len(LAUGHS) < 2000


@given(st.text(max_size=200))
def test_any_text_is_a_document_or_a_declaration_error(text: str) -> None:
    with suppress(DeclarationError):
        assert isinstance(read_text(text), Document)


@given(st.text(alphabet="ab:{}[],-? \n\t'\"#|>&*!%@`<0.", max_size=60))
def test_anything_like_yaml_is_a_document_or_a_declaration_error(text: str) -> None:
    try:
        found = read_text(text)
    except DeclarationError as caught:
        error = caught
    else:
        with pytest.raises(DeclarationError) as refused:
            validate(found, Chart)
        error = refused.value
    assert error.source == "<text>"
    assert error.line is not None
    assert error.line >= 1


@pytest.mark.parametrize("text", ["kind: scene\rname = x\r: {", "kind scene\rname: x\r"])
def test_line_ends_of_old_computers_give_a_place(text):
    with pytest.raises(DeclarationError) as caught:
        read_text(text)
    assert caught.value.line is not None


@pytest.mark.parametrize(
    ("raw", "reported"),
    [
        (b"%PDF-1.4\n1 0 obj\n", "1:1: this is a PDF; name a YAML file"),
        (b"\x89PNG\r\n\x1a\n", "1:1: this is a picture; name"),
        (b'<?xml version="1.0"?><robot/>', "1:1: this is XML or HTML, such as URDF, SDF or MJCF"),
        (b"PK\x03\x04kind: scene\n", "1:1: this is a ZIP archive, or a document of an office"),
        ("kind: scene\n".encode("utf-16-le"), "1:2: the character U+0000 is not allowed; save the"),
    ],
)
def test_a_file_of_another_format_is_named_in_the_error(tmp_path, raw, reported):
    path = tmp_path / "model.yaml"
    path.write_bytes(raw)
    with pytest.raises(DeclarationError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}:{reported}")
