"""Sequences of modes as text, and pictures of sweeps."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from statechart import sweep
from statechart.cli.main import main
from statechart.documents.setting import Setting
from statechart.errors import DeclarationError
from statechart.running.runner import Runner
from statechart.sweeps.figure import check_drawable, figure
from statechart.sweeps.mode_sequences import (
    MAX_LETTERS,
    contract_cycles,
    shorten_alike,
    write_sequence,
)
from statechart.sweeps.plan import Plan

STICK = "toppling_stick"


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        ("a", "a"),
        ("a b a", "a > b > a"),
        ("a b a b", "(a > b) x 2"),
        ("c a b a b a b d", "c > (a > b) x 3 > d"),
        ("a b c a b c a", "(a > b > c) x 2 > a"),
    ],
)
def test_repeated_cycles_are_abbreviated(words: str, reported: str) -> None:
    assert " > ".join(contract_cycles(words.split())) == reported


def unfolded(text: str) -> list[str]:
    """Return the sequence that a text of cycles stands for."""
    written = re.sub(
        r"\(([^)]*)\) x (\d+)", lambda found: " > ".join([found[1]] * int(found[2])), text
    )
    return written.split(" > ")


@given(st.lists(st.sampled_from("abc"), min_size=1, max_size=60))
def test_abbreviated_cycles_expand_to_the_sequence(words: list[str]) -> None:
    words = [word for k, word in enumerate(words) if k == 0 or word != words[k - 1]]
    assert unfolded(" > ".join(contract_cycles(words))) == words


def drawn(columns: dict[str, np.ndarray], *, grid: bool = True, **options: object):  # type: ignore[no-untyped-def]
    plan = Plan(Runner(STICK).model, Setting(), columns, grid=grid, outputs=["slip_forward"])
    ranges = {"over": columns} if grid else {"samples": pd.DataFrame(columns)}
    data: xr.Dataset = sweep(STICK, **ranges, outputs=["slip_forward"]).load()
    return plan, data, figure(plan, data)


def test_sweeps_of_two_parameters_are_shown_as_maps() -> None:
    columns = {"mu": np.geomspace(0.05, 50, 12), "I_G": np.linspace(0.1, 1.0, 10)}
    _, data, picture = drawn(columns)
    numbers, modes = (ax.collections[0] for ax in picture.axes[:2])
    np.testing.assert_array_equal(numbers.get_array(), data["slip_forward"].to_numpy().T)
    assert modes.get_array().shape == (10, 12)
    assert (picture.axes[0].get_xscale(), picture.axes[0].get_yscale()) == ("log", "linear")
    legend = [text.get_text() for text in picture.legends[0].get_texts()]
    assert set(legend) == set(map(str, data["sequence"].to_numpy()))


def test_lines_break_where_modes_change() -> None:
    _, data, picture = drawn({"mu": np.geomspace(0.05, 50, 60)})
    line = picture.axes[0].lines[0]
    codes = data["modes"].to_numpy()
    changes = int(np.count_nonzero(np.diff(codes)))
    assert int(np.isnan(line.get_ydata()).sum()) == changes > 0


def test_counts_have_whole_ticks() -> None:
    plan, data, _ = drawn({"mu": np.geomspace(0.05, 50, 12)})
    data["slip_forward"][:] = 3.0 + np.arange(12) % 3
    ticks = figure(plan, data).axes[0].get_yticks()
    np.testing.assert_array_equal(ticks, np.rint(ticks))


def test_the_band_of_modes_has_no_seams_between_equal_cells() -> None:
    _, data, picture = drawn({"mu": np.geomspace(0.05, 50, 60)})
    codes = data["modes"].to_numpy()
    stretches = [path for bars in picture.axes[-1].collections for path in bars.get_paths()]
    assert len(stretches) == 1 + int(np.count_nonzero(np.diff(codes)))


def test_samples_that_fail_or_have_no_value_are_marked_as_in_the_legend() -> None:
    rng = np.random.default_rng(3)
    columns = {"mu": rng.uniform(0.1, 1.0, 12), "I_G": rng.uniform(0.1, 1.0, 12)}
    plan, data, _ = drawn(columns, grid=False)
    data["outcome"][2] = "STUCK"
    data["slip_forward"][[5, 7]] = np.nan
    picture = figure(plan, data)
    crosses, blank, _ = picture.axes[0].collections
    np.testing.assert_array_equal(crosses.get_offsets(), [[columns["mu"][2], columns["I_G"][2]]])
    np.testing.assert_array_equal(blank.get_offsets()[:, 0], columns["mu"][[5, 7]])
    texts = [text.get_text() for text in picture.legends[0].get_texts()]
    marks = dict(zip(texts, picture.legends[0].legend_handles, strict=True))
    assert marks["failed"].get_marker() == "x"
    assert "no value" in marks


def test_a_parameter_of_few_values_is_a_line_for_each() -> None:
    _, _, picture = drawn({"mu": np.geomspace(0.05, 50, 30), "I_G": np.array([0.0, 1 / 3, 1.0])})
    legend = [text.get_text() for text in picture.legends[0].get_texts()]
    assert legend == ["I_G = 0", "I_G = 0.3333", "I_G = 1"]


def test_more_than_two_parameters_have_no_picture() -> None:
    columns = {"mu": [0.1, 1.0], "I_G": [0.1, 1.0], "theta0": [0.01, 0.02]}
    with pytest.raises(DeclarationError, match="one or two parameters, not 3"):
        check_drawable(Plan(Runner(STICK).model, Setting(), columns))
    columns["theta0"] = [0.01]
    check_drawable(Plan(Runner(STICK).model, Setting(), columns))


def test_twelve_sequences_have_colours_and_others_share_one() -> None:
    columns = {"mu": np.linspace(0.1, 1.0, 30)}
    plan = Plan(Runner(STICK).model, Setting(), columns, outputs=[])
    data = sweep(STICK, columns, outputs=[]).load()
    data = data.drop_vars(["modes", "sequence"]).assign(
        modes=("mu", np.arange(30, dtype=np.int32)), sequence=[f"s{k}" for k in range(30)]
    )
    legend = [text.get_text() for text in figure(plan, data).legends[0].get_texts()]
    assert len(legend) == 12
    assert legend[-1] == "others (19)"


@pytest.mark.parametrize("second", [{}, {"I_G": np.linspace(0.1, 1.0, 10)}])
@pytest.mark.parametrize("length", [1, 4, 8, 40])
def test_legends_distinguish_sequences_of_any_length(
    length: int, second: dict[str, np.ndarray]
) -> None:
    columns = {"mu": np.linspace(0.1, 1.0, 6), **second}
    plan = Plan(Runner(STICK).model, Setting(), columns, outputs=[])
    data = sweep(STICK, columns, outputs=[]).load()
    kinds = np.arange(data["modes"].size, dtype=np.int32).reshape(data["modes"].shape) % 6
    texts = [f"{'heel:slide+ > ' * length}toe:pin x {k}" for k in range(6)]
    data = data.drop_vars(["modes", "sequence"]).assign(
        modes=(tuple(columns), kinds), sequence=texts
    )
    picture = figure(plan, data)
    picture.draw_without_rendering()
    box = picture.legends[0].get_window_extent()
    assert box.x0 >= 0.0
    assert box.x1 <= picture.bbox.x1
    reported = [text.get_text() for text in picture.legends[0].get_texts()]
    assert len(set(reported)) == 6
    if length < 6:
        assert set(reported) == set(texts)


def test_the_page_has_the_pictures_that_it_names() -> None:
    docs = Path(__file__).parents[2] / "docs"
    page = (docs / "sweeps.md").read_text(encoding="utf-8")
    for line in page.splitlines():
        if line.startswith("statechart sweep") and "docs/images" in line:
            picture = line.rpartition("docs/")[2]
            assert (docs / picture).exists()
            assert f"]({picture})" in page


def test_legends_tell_long_sequences_of_modes_apart() -> None:
    assert shorten_alike(["pin > slide+", "pin"]) == ["pin > slide+", "pin"]
    rest = " ".join(f"s{k}:free" for k in range(2, 20))
    long = [
        f"s0:pin s1:free {rest} > s0:free s1:pin {rest} > ... (22 modes, 0123abcd)",
        f"s0:pin s1:free {rest} > s0:free s1:pin {rest} > ... (23 modes, 4567cdef)",
        f"s0:pin s1:free {rest} > s0:slide s1:free {rest}",
    ]
    found = shorten_alike(long)
    assert len(set(found)) == 3
    assert max(map(len, found)) < 60
    assert "22 modes" in found[0]
    assert "23 modes" in found[1]
    assert "s0:slide" in found[2]
    assert not any("0123abcd" in text for text in found)


def test_sequences_that_differ_near_their_ends_are_told_apart_where_they_do() -> None:
    rounds = [f"left:{k} right:{k % 7}" for k in range(40)]
    texts = [write_sequence([*rounds, f"left:{end} right:0"]) for end in ("pin", "free")]
    assert all(len(text) < 1.25 * MAX_LETTERS and "(41 modes, " in text for text in texts)
    found = shorten_alike(texts)
    assert [text.rpartition(" > ")[2] for text in found] == [
        f"left:{end} right:0 (41 modes)" for end in ("pin", "free")
    ]


@pytest.mark.parametrize("count", range(20, 60))
def test_ends_of_a_long_sequence_do_not_overlap(count: int) -> None:
    words = [f"a{k:04d}" for k in range(count)]
    written = unfolded(re.sub(r" \(\d+ modes, .*\)", "", write_sequence(words)))
    if "..." in written:
        cut = written.index("...")
        begin, end = written[:cut], written[cut + 1 :]
        assert 0 < len(begin) + len(end) < count
        assert [*begin, *words[len(begin) : count - len(end)], *end] == words
    else:
        assert written == words


def test_sequences_of_long_names_that_differ_in_their_last_mode_are_told_apart() -> None:
    others = "left_foot:slide+ right_foot:slide- hook:closed"
    rounds = [f"nose:free{k} tail:pin {others}" for k in range(30)]
    texts = [write_sequence([*rounds, f"nose:pin tail:{end} {others}"]) for end in ("on", "off")]
    assert shorten_alike(texts) == [
        f"nose:free0 > ... > nose:pin tail:{end} (31 modes)" for end in ("on", "off")
    ]


def test_modes_that_are_left_out_are_marked_in_lists() -> None:
    texts = [f"{'long' * 16} > ... > {end} (31 modes, 0123abcd)" for end in ("pin", "free")]
    assert all("..." in text and text.endswith("(31 modes)") for text in shorten_alike(texts))


def test_reports_of_sweeps_say_where_sequences_differ(capsys: pytest.CaptureFixture[str]) -> None:
    over = ["--over", "gamma=0.08,0.09", "--until", "40"]
    assert main(["sweep", "rimless_wheel", *over]) == 0
    table = capsys.readouterr().out.partition("sequence of modes\n")[2]
    rows = [line.split(maxsplit=1)[1] for line in table.splitlines()]
    assert len({*rows}) == len(rows) >= 2
    assert not re.search(r"modes, [0-9a-f]{8}\)", table)
