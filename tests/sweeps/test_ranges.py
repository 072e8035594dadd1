"""Ranges, lists, Sobol sequences and tables: values and refusals."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from statechart.errors import DeclarationError
from statechart.sweeps.ranges import numbers, read_table, sobol_sequence, values


def test_a_linear_range_has_equal_steps_and_its_ends() -> None:
    np.testing.assert_allclose(values("a", "lin:-1:1:5"), [-1.0, -0.5, 0.0, 0.5, 1.0], rtol=1e-15)


def test_a_logarithmic_range_has_equal_ratios_and_its_ends() -> None:
    found = values("a", "log:0.03:100:8")
    assert (found[0], found[-1]) == (0.03, 100.0)
    np.testing.assert_allclose(found[1:] / found[:-1], (100 / 0.03) ** (1 / 7), rtol=1e-13)


@given(
    st.floats(1e-6, 1e6),
    st.floats(1.1, 1e6),
    st.integers(2, 50),
    st.sampled_from(["lin", "log"]),
)
def test_ranges_rise_from_one_end_to_the_other(
    least: float, factor: float, count: int, spacing: str
) -> None:
    found = values("a", f"{spacing}:{least!r}:{least * factor!r}:{count}")
    assert len(found) == count
    assert (found[0], found[-1]) == (least, least * factor)
    assert (np.diff(found) > 0.0).all()


def test_lists_are_formulas_of_numbers() -> None:
    assert values("a", "0, 1/3,inf,20*pi/180").tolist() == [0.0, 1 / 3, math.inf, math.pi / 9]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lin:3:1:10", "3 is above 1"),
        ("log:-1:1:10", "-1 has no logarithm"),
        ("log:0:1:10", "0 has no logarithm"),
        ("lin:1:1:10", "the range is empty"),
        ("lin:0:1:1", "a range of one value has two ends"),
        ("lin:0:1:0", "'0' is not a number of values"),
        ("lin:0:1:100000000", "'100000000' is not a number of values"),
        ("lin:0:1:ten", "'ten' is not a number of values"),
        ("lin:0:1", "'lin:0:1' is no range"),
        ("geo:1:2:3", "'geo:1:2:3' is no range"),
        ("lin:0:inf:3", "the ends of a range must be finite"),
        ("1,,2", "a number is missing"),
        ("lin::1:3", "a number is missing"),
        ("1,x", "formula 'x': unknown name 'x'"),
        ("1/0", "formula '1/0': division by zero"),
        ("__import__('os')", "mu"),
    ],
)
def test_wrong_ranges_are_refused_with_parameter_and_reason(text: str, words: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        values("mu", text)
    assert str(caught.value).startswith("mu: ")
    assert words in str(caught.value)
    # One thing is wrong, and one thing is to be done.
    assert str(caught.value).count("; ") == 1


def test_a_sobol_sequence_is_in_its_intervals_balanced_and_the_same_again() -> None:
    over = {"mu": "log:0.1:10", "I_G": "lin:-1:3"}
    found = sobol_sequence(over, 64)
    assert list(found.columns) == ["mu", "I_G"]
    assert found.equals(sobol_sequence(over, 64))
    # Every interval of equal probability has as many points as another.
    for places in (np.log(found["mu"] / 0.1) / math.log(100), (found["I_G"] + 1) / 4):
        assert np.histogram(places, 16, (0.0, 1.0))[0].tolist() == [4] * 16


@pytest.mark.parametrize(
    ("over", "count", "words"),
    [
        ({"a": "lin:0:1"}, 100, "powers of two"),
        ({"a": "lin:0:1:5"}, 64, "no interval"),
        ({"a": "1,2"}, 64, "no interval"),
        ({"a": "log:0:1"}, 64, "no logarithm"),
    ],
)
def test_wrong_sobol_sequences_are_refused(over: dict[str, str], count: int, words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        sobol_sequence(over, count)


def test_a_table_has_a_column_for_every_parameter(tmp_path: Path) -> None:
    file = tmp_path / "samples.csv"
    file.write_text("mu, I_G\n0.1,1/3\ninf, 0\n")
    found = read_table(file)
    assert found.to_dict("list") == {"mu": [0.1, math.inf], "I_G": [1 / 3, 0.0]}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is no table"),
        (b"mu\n0.1,2,3\n0.1\n", "is no table"),
        (b"mu,I_G\n0.1\n", "I_G"),
        (b"mu\nfast\n", "'fast'"),
        (b"mu;I_G\n0,1;1\n", "write commas between columns, and decimals with a point"),
        (b"mu,mu\n1,2\n", "two columns have one name"),
        (b"\xff\xfe\x00", "is no table"),
    ],
)
def test_files_that_are_no_table_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "samples.csv"
    file.write_bytes(content)
    with pytest.raises(DeclarationError, match=words):
        read_table(file)


def test_a_table_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DeclarationError, match="no such file"):
        read_table(tmp_path / "none.csv")


def test_a_table_that_may_never_end_is_refused(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    for path in ("/dev/zero", pipe):
        with pytest.raises(DeclarationError, match="not a file; name a CSV file"):
            read_table(path)
    with pytest.raises(DeclarationError, match="this is a folder; name a CSV file"):
        read_table(tmp_path)


def test_a_table_is_read_up_to_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    huge = tmp_path / "huge.csv"
    with huge.open("wb") as stream:
        stream.truncate(2**40)  # of holes: it takes no room
    with pytest.raises(DeclarationError, match="more than 10000000 numbers, or 250 MB"):
        read_table(huge)
    wide = tmp_path / "wide.csv"
    wide.write_text("," * 1_000_000)
    with pytest.raises(DeclarationError, match="its first line has 1000001 names"):
        read_table(wide)
    monkeypatch.setattr("statechart.sweeps.ranges._MAX_NUMBERS", 6)
    table = tmp_path / "table.csv"
    table.write_text("a,b\n" + "1,2\n" * 2)
    assert read_table(table).shape == (2, 2)
    table.write_text("a,b\n" + "1,2\n" * 3)
    with pytest.raises(DeclarationError, match="more than 6 numbers"):
        read_table(table)


@pytest.mark.parametrize("given", [[], ["x"], [math.nan], [[1.0, 2.0]]])
def test_values_are_a_list_of_numbers(given: list[object]) -> None:
    with pytest.raises(DeclarationError, match="a"):
        numbers("a", given)  # type: ignore[arg-type]


def test_a_cell_that_is_no_number_is_reported_with_its_row(tmp_path: Path) -> None:
    table = tmp_path / "cells.csv"
    table.write_text("mu,I_G\n1,1/3\n2,\n")
    with pytest.raises(DeclarationError) as caught:
        read_table(table)
    assert str(caught.value).startswith(f"{table}, row 3: I_G: a number is missing")
    assert "lin:" not in str(caught.value)
