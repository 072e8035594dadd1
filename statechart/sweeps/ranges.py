"""Values of swept parameters: ranges, Sobol sequences, tables."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from statechart.arrays import Array
from statechart.documents.files import read_bounded
from statechart.documents.yaml_reader import MAX_VALUES
from statechart.errors import DeclarationError, FormulaError
from statechart.formulas.formula import parse

if TYPE_CHECKING:
    import pandas as pd

_SPACINGS = ("lin", "log")
_FORMS = "write lin:A:B:N, log:A:B:N, or the values themselves, such as 0.1,1/3,inf"
_MAX_NUMBERS = 10_000_000  # values of one parameter
_MAX_BYTES = 25 * _MAX_NUMBERS  # of a table: 25 characters per number
_SEED = 0  # sequences are reproducible


@dataclass(frozen=True)
class Interval:
    """A closed interval of a parameter, with its spacing: lin or log."""

    spacing: str
    least: float
    greatest: float

    def at(self, places: Array) -> Array:
        """Return the values at `places` in [0, 1]; the ends are exact."""
        if self.spacing == "lin":
            found = self.least + places * (self.greatest - self.least)
        else:
            low, high = math.log(self.least), math.log(self.greatest)
            found = np.exp(low + places * (high - low))
        found = np.where(places == 1.0, self.greatest, found)
        return np.where(places == 0.0, self.least, found)


def cells(
    over: Mapping[str, str], table: str | None, sobol: int | None
) -> tuple[dict[str, Array] | None, pd.DataFrame | None]:
    """Return the grid or the table of samples of a command line; None for the other."""
    if table is not None:
        if over:
            advice = "the table has all parameters"
            raise DeclarationError("--samples and --over exclude each other", advice=advice)
        return None, read_table(table)
    if not over:
        advice = "such as --over mu=log:0.03:100:50, or --samples TABLE.csv"
        raise DeclarationError("a sweep needs parameters to vary", advice=advice)
    if sobol is not None:
        return None, sobol_sequence(over, sobol)
    return {name: values(name, text) for name, text in over.items()}, None


def values(name: str, text: str) -> Array:
    """Parse values (n,): `lin:A:B:N`, `log:A:B:N`, or a list."""
    if ":" not in text:
        return np.array([_number_in_range(name, word) for word in text.split(",")])
    spacing, *words = text.split(":")
    if spacing not in _SPACINGS or len(words) != 3:
        raise _wrong(name, f"{text!r} is no range", _FORMS)
    count = words[2].strip()
    if not count.isdecimal() or not 0 < int(count) <= _MAX_NUMBERS:
        advice = f"write one from 1 to {_MAX_NUMBERS}"
        raise _wrong(name, f"{count!r} is not a number of values", advice)
    interval = _interval(name, spacing, *words[:2])
    if int(count) == 1:
        if interval.least != interval.greatest:
            raise _wrong(name, "a range of one value has two ends", "write the value itself")
        return np.array([interval.least])
    if interval.least == interval.greatest:
        raise _wrong(name, "the range is empty", "its ends must differ")
    return interval.at(np.linspace(0.0, 1.0, int(count)))


def sobol_sequence(over: Mapping[str, str], count: int) -> pd.DataFrame:
    """Return a scrambled Sobol sequence (Owen 1998) over intervals, one row per point."""
    import pandas as pd
    from scipy.stats import qmc

    power = count.bit_length() - 1
    if count > _MAX_NUMBERS:
        raise DeclarationError(f"--sobol {count}: at most {_MAX_NUMBERS} points can be drawn")
    if count != 1 << power:
        message = f"--sobol {count}: a Sobol sequence is balanced for powers of two only"
        raise DeclarationError(message, advice=f"take {1 << power} or {1 << (power + 1)}")
    intervals = {}
    for name, text in over.items():
        spacing, *words = text.split(":")
        if spacing not in _SPACINGS or len(words) != 2:
            raise _wrong(name, f"{text!r} is no interval", "with --sobol write lin:A:B or log:A:B")
        intervals[name] = _interval(name, spacing, *words)
    places = qmc.Sobol(len(intervals), scramble=True, rng=_SEED).random_base2(power)
    return pd.DataFrame(
        {name: each.at(places[:, k]) for k, (name, each) in enumerate(intervals.items())}
    )


def read_table(path: Path | str) -> pd.DataFrame:
    """Read a CSV file with a column per parameter and a row per run."""
    import pandas as pd

    raw = read_bounded(Path(path), _MAX_BYTES, "name a CSV file")
    cells = raw.count(b",") + max(raw.count(b"\n"), raw.count(b"\r"))
    if len(raw) > _MAX_BYTES or cells > _MAX_NUMBERS:
        message = f"{path}: more than {_MAX_NUMBERS} numbers, or {_MAX_BYTES // 10**6} MB"
        raise DeclarationError(message, advice="sweep over one part of the table at a time")
    head = raw.partition(b"\n")[0]
    if b";" in head or b"\t" in head:
        advice = "write commas between columns, and decimals with a point"
        raise DeclarationError(f"{path}: a semicolon or a tab in its first line", advice=advice)
    width = head.count(b",") + 1
    if width > MAX_VALUES:
        raise DeclarationError(
            f"{path} is no table: its first line has {width} names, and no model has more "
            f"than {MAX_VALUES} parameters",
            advice="write a row for every run, a column for every parameter",
        )
    try:
        # Without a header, since pandas renames duplicate columns.
        found = pd.read_csv(
            io.BytesIO(raw), dtype=str, header=None, keep_default_na=False, skipinitialspace=True
        )
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        advice = "its first line names parameters, every other has their values"
        raise DeclarationError(f"{path} is no table: {str(error).strip()}", advice=advice) from None
    names = [str(name).strip() for name in found.iloc[0]]
    if len(set(names)) < len(names):
        raise DeclarationError(f"{path}: two columns have one name", advice="remove one")
    columns: dict[str, list[float]] = {name: [] for name in names}
    for row, words in enumerate(found.iloc[1:].itertuples(index=False), 2):
        for name, word in zip(names, words, strict=True):
            try:
                columns[name].append(_number_in_range(name, str(word)))
            except DeclarationError as error:
                message = f"{path}, row {row}: {error.message}"
                advice = "write numbers or formulas such as 1/3, with commas between them"
                raise DeclarationError(message, advice=advice) from None
    return pd.DataFrame(columns)


def numbers(name: str, values: Sequence[float] | Array) -> Array:
    """Return values (n,) of a parameter as floats."""
    try:
        found = np.atleast_1d(np.asarray(values, dtype=float))
    except (TypeError, ValueError, OverflowError):
        raise DeclarationError(f"the values of {name} must be numbers") from None
    if found.ndim != 1 or found.size == 0:
        raise DeclarationError(
            f"{name} has no values" if found.size == 0 else f"the values of {name} are no list",
            advice="give one list of numbers for every parameter",
        )
    if np.isnan(found).any():
        raise DeclarationError(f"the values of {name} must be numbers, not nan")
    return found


def _interval(name: str, spacing: str, first: str, last: str) -> Interval:
    least, greatest = _number_in_range(name, first), _number_in_range(name, last)
    if not (math.isfinite(least) and math.isfinite(greatest)):
        raise _wrong(name, "the ends of a range must be finite", _FORMS)
    if least > greatest:
        raise _wrong(name, f"{least:g} is above {greatest:g}", "the least value comes first")
    if spacing == "log" and least <= 0.0:
        advice = "take a positive end, or lin: in the place of log:"
        raise _wrong(name, f"{least:g} has no logarithm", advice)
    return Interval(spacing, least, greatest)


def _number_in_range(name: str, text: str) -> float:
    word = text.strip()
    if not word:
        raise _wrong(name, "a number is missing", _FORMS)
    try:
        found = parse(word).value({})
    except FormulaError as error:
        # Without its advice, which is about formulas.
        raise _wrong(name, error.message, _FORMS) from None
    if math.isnan(found):
        raise _wrong(name, f"{word!r} is not a number", _FORMS)
    return found


def _wrong(name: str, message: str, advice: str) -> DeclarationError:
    return DeclarationError(f"{name}: {message}", advice=advice)
