"""A scene without contacts and regions is run, drawn, listed and put on a page, too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from statechart.cli.main import main

FLIGHT = """\
kind: scene
name: flight
gravity: 9.81
bodies: {ball: {mass: 1, start: {x: 0, y: 1, dx: 1}}}
stop: {time: 1}
"""


@pytest.mark.parametrize(
    "words",
    [
        ["modes"],
        ["validate"],
        ["run", "--report", "page.html"],
        *(["draw", "-o", f"drawn.{kind}"] for kind in ("svg", "dot", "mmd", "scxml", "graphml")),
        ["draw", "--visited", "-o", "drawn.svg"],
        ["draw", "--scene", "-o", "drawn.svg"],
    ],
    ids=" ".join,
)
def test_every_verb_accepts_a_scene_without_regions(
    words: list[str], tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("flight.yaml").write_text(FLIGHT)
    assert main([words[0], "flight.yaml", *words[1:]]) == 0, capsys.readouterr().err
    if len(words) > 1:
        assert Path(words[-1]).stat().st_size > 100
