"""Reader of YAML documents; every error has file:line:column.

A document is built from the YAML event stream, not by a loader: size, depth, number of values,
anchors, aliases, merge keys, tags and duplicate keys are checked first, since a few hundred bytes
of aliases can occupy a loader for minutes.

Plain scalars follow the core schema of YAML 1.2: `1e-3` is a number, `off` and `inf` are text.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from ruamel.yaml import YAML, events
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.reader import ReaderError

from statechart.documents.files import read_bounded
from statechart.documents.hints import YAML_HINTS
from statechart.documents.validation import Document
from statechart.documents.yaml_text import resolve
from statechart.errors import DeclarationError, Loc, Position
from statechart.formulas.hints import character, no_name
from statechart.formulas.syntax import NAME

# The YAML parser takes at most 20 us per value and 1 us per character: with these bounds it reads
# every file in less than two seconds; validation comes on top. A thousand bodies with a contact
# each have 24,000 values in 120 to 170 KiB.
MAX_BYTES = 1024 * 1024
MAX_VALUES = 60_000
MAX_DEPTH = 32

# First bytes of files of other formats.
_OTHERS = {
    b"%PDF": "a PDF",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"PK\x03\x04": "a ZIP archive, or a document of an office program",
    b"\x1f\x8b": "a compressed file",
    b"<": "XML or HTML, such as URDF, SDF or MJCF",
}


def read(path: Path) -> Document:
    """Read a YAML file; raise `DeclarationError` if it is missing or no valid document."""
    source = str(path)
    raw = read_bounded(path, MAX_BYTES, "name a YAML file")
    for begin, what in _OTHERS.items():
        if raw.startswith(begin):
            raise Position(source, 1, 1).error(f"this is {what}", "name a YAML file")
    try:
        # A file that is too long may be cut inside a character; read_text refuses it.
        text = raw.decode("utf-8-sig", "ignore" if len(raw) > MAX_BYTES else "strict")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - (raw.rfind(b"\n", 0, error.start) + 1) + 1
        message = f"the byte 0x{raw[error.start]:02x} is not UTF-8"
        raise Position(source, line, column).error(message, "save the file as UTF-8") from None
    return read_text(text if len(raw) <= MAX_BYTES else " " * (MAX_BYTES + 1), source)


def _lines(text: str) -> list[str]:
    return [*re.split(r"\r\n|\r|\n", text), ""]


def read_text(text: str, source: str = "<text>") -> Document:
    """Read YAML text; raise `DeclarationError` if it is not a valid document."""
    if len(text) > MAX_BYTES:
        advice = "a model is a page or two"
        raise DeclarationError(f"more than {MAX_BYTES // 1024} KiB", advice=advice, source=source)
    return _Builder(source).build(text)


class _Builder:
    """Builds data and positions from events; refuses the first event that is not allowed."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._values: dict[Loc, Position] = {}
        self._keys: dict[Loc, Position] = {}
        self._empty: set[Loc] = set()

    def build(self, text: str) -> Document:
        try:
            parsed = self._wanted(YAML(typ="safe", pure=True).parse(io.StringIO(text)))
            data = self._document(parsed, text)
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            if "expected ':'" in str(error.problem):  # the line without a colon, not the next
                mark = error.context_mark or mark
                self._check_equals(text, mark.line)
                self._check_colon(text, mark.line + 1)
            elif mark and "mapping values are not allowed" in str(error.problem):
                self._check_colon(text, mark.line)
            self._check_blanks(text, mark.line if mark else 0)
            opened = error.context_mark or mark
            if "unexpected end of stream" in str(error.problem) and opened:
                mark = opened
            message = " ".join(str(error.problem or error.context).split())
            place = self._at(mark.line, mark.column) if mark else self._at(0, 0)
            advice = next((hint for words, hint in YAML_HINTS.items() if words in message), "")
            above = opened and mark and opened.line < mark.line
            advice = advice.format(line=f" of line {opened.line + 1}" if above else "")
            if closing := re.match(r"expected <block end>, but (?:got|found) '([\]}])'", message):
                message, advice = f"this {closing[1]} closes nothing", "remove it"
            elif message.startswith("expected <block end>"):
                message = "this line is indented neither as the line above nor as its parent"
            raise place.error(f"not YAML: {message}", advice) from None
        except ReaderError as error:
            at = int(error.position)
            # Every second byte of ASCII text in UTF-16 is zero.
            wide = text.count("\0") > 1
            raise self._at(text.count("\n", 0, at), at - text.rfind("\n", 0, at) - 1).error(
                f"the character U+{int(error.character):04X} is not allowed",
                "save the file as UTF-8" if wide else "remove it",
            ) from None
        return Document(self._source, data, self._values, self._keys, frozenset(self._empty))

    def _check_blanks(self, text: str, line: int) -> None:
        """Refuse characters that look like a blank but are none in YAML."""
        for at, written in list(enumerate(_lines(text)))[max(0, line - 1) : line + 1]:
            for column, one in enumerate(written):
                if one.isspace() and one not in " \t\r":
                    message = f"not YAML: the blank U+{ord(one):04X}"
                    raise self._at(at, column).error(message, character(one)) from None

    def _check_equals(self, text: str, line: int) -> None:
        """Refuse `name = value`."""
        written = _lines(text)[line]
        if "=" in written:
            advice = no_name(written.strip())
            raise self._at(line, written.index("=")).error("a key has a colon", advice) from None

    def _check_colon(self, text: str, line: int) -> None:
        """Refuse a key without a colon, or without a blank behind it, above a line."""
        lines = _lines(text)
        for at in range(max(line - 1, 0), line + 1):
            if lines[at].lstrip().startswith("//"):
                advice = "write a comment after #"
                raise self._at(at, lines[at].index("//")).error("not YAML: '//'", advice) from None
        above = max((k for k in range(line) if lines[k].strip()), default=line)
        indent = len(lines[line]) - len(lines[line].lstrip())
        for at in (above, line):
            text = lines[at].split(" #")[0].rstrip()
            found = braced = re.fullmatch(r"( *)([\w.]+) *(\{.*)", text)
            if at == above and ": " not in text:
                found = found or re.fullmatch(r"( *)([\w.]+)[ :]+(\S.*)", text)
            if found and len(found[1]) == indent:
                raise self._at(at, indent).error(
                    f"not YAML: {(found[2] if braced else text.strip())!r} has no colon with a "
                    "blank behind it",
                    f"write {found[2]}: {found[3]}",
                ) from None

    def _document(self, parsed: Iterator[events.Event], text: str) -> dict[str, Any]:
        first = next(parsed, None)
        if first is None:
            advice = "`statechart new NAME` writes one to start from"
            raise self._at(0, 0).error("the file is empty", advice)
        if not isinstance(first, events.MappingStartEvent):
            self._check_equals(text, self._position(first).line - 1)
            self._fail(first, "a model is a mapping", "begin with a line such as kind: scene")
        data: dict[str, Any] = self._value(first, parsed, ())
        for _ in parsed:
            pass  # the rest is checked too: it may be a second document
        return data

    def _wanted(self, parsed: Iterator[events.Event]) -> Iterator[events.Event]:
        """Yield the events of one document after checking them."""
        depth = documents = 0
        for count, event in enumerate(parsed):
            match event:
                case events.DocumentStartEvent():
                    documents += 1
                    if documents > 1:
                        self._fail(event, "a second document", "one model a file")
                    if event.version or event.tags:
                        self._fail(event, "a YAML directive", "remove the line that begins with %")
                case events.CollectionStartEvent():
                    depth += 1
                    if depth > MAX_DEPTH:
                        self._fail(event, f"nested deeper than {MAX_DEPTH} levels")
                case events.CollectionEndEvent():
                    depth -= 1
                case events.AliasEvent():
                    self._fail(event, "an alias (*)", "write the value out")
            if getattr(event, "anchor", None):
                self._fail(event, "an anchor (&)", "write the value out where it is needed")
            if getattr(event, "ctag", None):
                self._fail(event, "a tag (!)", "write plain values; put text in quotes")
            if count > MAX_VALUES:
                self._fail(event, f"more than {MAX_VALUES} values")
            if isinstance(event, events.NodeEvent | events.CollectionEndEvent):
                yield event

    def _value(self, event: events.Event, parsed: Iterator[events.Event], loc: Loc) -> Any:
        self._values[loc] = self._position(event)
        if isinstance(event, events.ScalarEvent):
            if event.style in ("'", '"'):
                self._values[loc] = self._position(event).shifted(1)
            elif not event.value and loc in self._keys:
                # The mark of an empty value is on the next line.
                self._values[loc] = self._keys[loc]
                self._empty.add(loc)
            return event.value if event.style else self._plain(event, loc)
        if isinstance(event, events.SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(item := next(parsed), events.SequenceEndEvent):
                self._check_cut(items[-1:], item)
                items.append(self._value(item, parsed, (*loc, len(items))))
            return items
        mapping: dict[str, Any] = {}
        before: list[Any] = []  # the last value that is not empty
        while not isinstance(key := next(parsed), events.MappingEndEvent):
            if not isinstance(key, events.ScalarEvent):
                self._fail(key, "a key must be a word")
            name = key.value
            self._check_cut(before, key)
            if name == "<<":
                self._fail(key, "a merge key (<<)", "write the values out")
            at = (*loc, name)
            if name in mapping:
                self._fail(
                    key, f"duplicate key {name!r}", f"the first is on line {self._keys[at].line}"
                )
            self._keys[at] = self._position(key)
            mapping[name] = self._value(next(parsed), parsed, at)
            before = before if mapping[name] is None else [mapping[name]]
        return mapping

    def _check_cut(self, before: list[Any], event: events.Event) -> None:
        """Refuse a formula that YAML cut at a comma."""
        if not (before and isinstance(before[0], str) and isinstance(event, events.ScalarEvent)):
            return
        first, second = (text.count("(") - text.count(")") for text in (before[0], event.value))
        if not event.style and first > 0 and (second != 0 or not NAME.fullmatch(event.value)):
            message = f"a comma in braces or brackets ends a value, here {before[0]!r}"
            self._fail(event, message, f'put the whole formula in quotes: "{before[0]}, ..."')

    def _plain(self, event: events.ScalarEvent, loc: Loc) -> Any:
        text = event.value
        try:
            value = resolve(text)
        except ValueError:
            self._fail(event, "a number of too many digits, or too large for a float")
        if text.startswith("+") and loc[-2:-1] == ("updates",) and not isinstance(value, str):
            more = f"{loc[-1]} + {text[1:]}"
            self._fail(
                event, f"{text} is the new value, no increment", f"write {more}, or {text[1:]}"
            )
        return value

    def _position(self, event: events.Event) -> Position:
        return self._at(event.start_mark.line, event.start_mark.column)

    def _at(self, line: int, column: int) -> Position:
        return Position(self._source, line + 1, column + 1)

    def _fail(self, event: events.Event, message: str, advice: str = "") -> NoReturn:
        raise self._position(event).error(message, advice)
