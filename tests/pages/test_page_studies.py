"""The page of a run with the study of its model: speed against accuracy."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest
from browser import FOUND, Browser
from studies import scipy, traded

import statechart
from statechart import StatechartError
from statechart.cli.main import main
from statechart.documents.setting import Setting
from statechart.running.runner import Runner
from statechart.study.study import Study, save

in_browser = pytest.mark.skipif(FOUND is None, reason="no Chromium is installed here")


@pytest.fixture(scope="module")
def study() -> Study:
    settings = [Setting(engine="taylor", tolerance=2.2e-16), *scipy("RK45", 3, 4, 6)]
    return traded(Runner("toppling_stick"), settings=settings)


def shown(page: Path) -> Any:
    found = re.search(r'id="data">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return json.loads(found[1])["study"]


def test_a_page_shows_the_study_and_marks_its_setting(study: Study, tmp_path: Path) -> None:
    result = statechart.run("toppling_stick", method="RK45", tolerance=1e-4)
    reported = shown(result.report(tmp_path / "page.html", study=study))
    assert base64.b64decode(reported["figure"]).startswith(b"<?xml")
    words = " ".join(str(study).split())
    for line in (
        *reported["above"],
        *reported["below"],
        *(" ".join(row) for row in reported["rows"]),
    ):
        assert " ".join(line.split()) in words
    assert [reported["rows"][k][0].split(" *")[0] for k in reported["own"]] == ["scipy RK45 0.0001"]
    usual = statechart.run("toppling_stick", engine="taylor").report(
        tmp_path / "usual.html", study=study
    )
    assert shown(usual)["own"] == [1]
    assert shown(result.report(tmp_path / "without.html")) is None


def test_page_warns_of_other_parameters_and_rejects_other_models(
    study: Study, tmp_path: Path
) -> None:
    result = statechart.run("toppling_stick", parameters={"mu": 0.3}, engine="taylor")
    reported = shown(result.report(tmp_path / "page.html", study=study))
    assert reported["above"][-1].endswith("this run had others")
    assert reported["own"] == []
    other = statechart.run("bouncing_ball", until=1.0)
    with pytest.raises(StatechartError, match="or of 'bouncing_ball' before"):
        other.report(tmp_path / "other.html", study=study)
    assert not (tmp_path / "other.html").exists()
    given = statechart.run("toppling_stick", engine="taylor", study=study)
    assert shown(given.report(tmp_path / "given.html"))["own"] == [1]


@pytest.mark.parametrize("verb", ["run", "view"])
def test_the_command_line_includes_a_study_saved_next_to_the_page(
    verb: str, study: Study, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("webbrowser.open", lambda _: True)
    save(tmp_path / "out", study)
    page = tmp_path / "out" / "page.html"
    option = "--report" if verb == "run" else "-o"
    assert main([verb, "toppling_stick", option, str(page)]) == 0
    assert len(shown(page)["rows"]) == 5
    assert "trade.json" not in capsys.readouterr().err
    assert main([verb, "bouncing_ball_chart", "--until", "1", option, str(page)]) == 0
    assert shown(page) is None
    assert "trade.json" in capsys.readouterr().err
    (tmp_path / "out" / "trade.json").write_text("[1]")
    assert main([verb, "toppling_stick", option, str(page)]) == 0
    assert shown(page) is None
    assert "trade.json is not a study" in capsys.readouterr().err


def test_the_study_in_the_folder_of_results_is_shown_on_a_page_elsewhere(
    study: Study, tmp_path: Path
) -> None:
    save(tmp_path / "out", study)
    words = ["run", "toppling_stick", "-q", "--no-samples", "-o", str(tmp_path / "out")]
    assert main([*words, "--report", str(tmp_path / "page.html")]) == 0
    assert len(shown(tmp_path / "page.html")["rows"]) == 5


@in_browser
@pytest.mark.parametrize(("width", "dark"), [(390, True), (1280, False)])
def test_study_fits_any_screen(width: int, dark: bool, study: Study, tmp_path: Path) -> None:
    page = statechart.run("toppling_stick", engine="taylor").report(
        tmp_path / "page.html", study=study
    )
    with Browser(width=width, dark=dark) as opened:
        opened.open(page)
        opened.value("byId('figure').decode()")
        assert opened.value("byId('figure').naturalWidth") > 600
        assert opened.value("document.documentElement.scrollWidth") <= width
        rows = "[...document.querySelectorAll('#settings tr')].map((row) => row.offsetHeight)"
        heights = opened.value(rows)
        assert len(heights) == 5
        assert max(heights) < 30  # each on one line
        assert opened.value("document.querySelector('#settings .own').rowIndex") == 1
        assert opened.said == []
