"""Recorded results of the shipped models, engine by engine and verb by verb.

``python tests/recording.py`` writes the records anew: only when a difference is meant, and
explained where it is committed.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
from runs import diagram

import models
from statechart.cli.main import main
from statechart.diagram.write import write

FOLDER = Path(__file__).parent / "recorded"
ENGINES = {"taylor": (), "scipy": (), "impulse": ("--step", "1e-3")}
# Number of events that are recorded completely, and with time and name only.
_WHOLE, _MANY = 6, 60
_LINES = 200
_UNTOLD = ("timings", "counts")
# Parts of a report that round-off does not change.
_FIRM = ("code", "outcome", "causes", "sequence", "instants", "t_end", "warnings")
PROCESSOR = FOLDER / "processor.txt"
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?|-?inf|nan")


def record(model: str, folder: Path) -> dict[str, Any]:
    """Return the results of a model; drawings are written to a folder."""
    found: dict[str, Any] = {}
    for engine, options in ENGINES.items():
        code, out = _said("run", model, "--engine", engine, *options, "--json")
        found[f"run {engine}"] = {"code": code, **_brief(json.loads(out) if out else {})}
    found["explain"] = _said("run", model, "--explain")[1].splitlines()[:_LINES]
    found["modes"] = json.loads(_said("modes", model, "--json")[1])
    for suffix in ("dot", "mmd", "scxml"):
        drawn = folder / f"{model}.{suffix}"
        write(diagram(model), drawn)
        lines = drawn.read_text(encoding="utf-8").splitlines()
        found[suffix] = [len(lines), *(line[:_LINES] for line in lines[:_LINES])]
    return found


def processor() -> str:
    """Return the target of the compilers, which determines the round-off of sums."""
    return numba.config.CPU_NAME or llvm.get_host_cpu_name()


def firm(record: dict[str, Any]) -> dict[str, Any]:
    """Return the results that are equal on every processor: round-off decides ties and zeros."""
    runs = {
        name: {key: value for key, value in said.items() if key in _FIRM}
        for name, said in record.items()
        if name.startswith("run ")
    }
    return {**{k: v for k, v in record.items() if k in ("modes", "dot", "mmd", "scxml")}, **runs}


def differences(recorded: Any, found: Any, tolerance: float, at: str = "") -> Iterator[str]:
    """Yield where a record differs: in anything but numbers, or in these beyond a tolerance.

    Numbers are compared with the largest beside them: what is zero but for rounding is relative to
    the coordinates that it comes from.
    """
    if isinstance(recorded, dict) and isinstance(found, dict):
        size = max((_size(v) for v in recorded.values()), default=0.0)
        for key in [*recorded, *(k for k in found if k not in recorded)]:
            if key not in recorded or key not in found:
                yield f"{at}.{key}: {'new' if key in found else 'missing'}"
            else:
                yield from _compared(recorded[key], found[key], tolerance, f"{at}.{key}", size)
    elif isinstance(recorded, list) and isinstance(found, list):
        if len(recorded) != len(found):
            yield f"{at}: {len(found)} instead of {len(recorded)}"
        size = max(map(_size, recorded), default=0.0)
        for place, (old, new) in enumerate(zip(recorded, found, strict=False)):
            yield from _compared(old, new, tolerance, f"{at}[{place}]", size)
    else:
        yield from _compared(recorded, found, tolerance, at, 0.0)


def _compared(old: Any, new: Any, tolerance: float, at: str, size: float) -> Iterator[str]:
    if old == new:
        return
    if _size(old) and _size(new):
        if not abs(old - new) <= tolerance * max(abs(old), abs(new), size):
            yield f"{at}: {new!r} instead of {old!r}"
    elif isinstance(old, str) and isinstance(new, str):
        # Columns are as wide as the last digits of their numbers are many.
        if _NUMBER.sub("#", old).split() != _NUMBER.sub("#", new).split():
            yield f"{at}: {new!r} instead of {old!r}"
        else:
            reported = ([float(n) for n in _NUMBER.findall(text)] for text in (old, new))
            yield from (
                f"{at}: {new!r} instead of {old!r}"
                for a, b in zip(*reported, strict=True)
                # Texts are rounded.
                if not (a == b or abs(a - b) <= max(tolerance, 1e-5) * max(abs(a), abs(b), 1e-9))
            )
    elif isinstance(old, dict | list) and type(old) is type(new):
        yield from differences(old, new, tolerance, at)
    else:
        yield f"{at}: {new!r} instead of {old!r}"


def _size(value: Any) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return abs(value) or math.ulp(0.0) if number else 0.0


def _said(*arguments: str) -> tuple[int, str]:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = main(arguments)
    return code, out.getvalue()


def _brief(report: dict[str, Any]) -> dict[str, Any]:
    found = {key: value for key, value in report.items() if key not in _UNTOLD}
    events = found.pop("events", [])
    found["events"] = events[: _WHOLE if len(report.get("final", ())) < _MANY else 1]
    found["instants"] = [event["t"] for event in events]
    found["causes"] = " ".join(f"{event['contact']}.{event['cause']}" for event in events)
    modes = found.pop("modes", [])
    found["sequence"] = [" ".join(mode.values()) for mode in modes[:_MANY]]
    return found


def written(record: dict[str, Any]) -> str:
    """Return a record as the text of its file."""
    return json.dumps(record, indent=1, sort_keys=True) + "\n"


if __name__ == "__main__":
    import tempfile

    FOLDER.mkdir(exist_ok=True)
    PROCESSOR.write_text(processor() + "\n", encoding="utf-8")
    with tempfile.TemporaryDirectory() as scratch:
        for name in models.names():
            text = written(record(name, Path(scratch)))
            (FOLDER / f"{name}.json").write_text(text, encoding="utf-8")
