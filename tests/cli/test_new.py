"""Refusals of `new`: nothing is written, and messages are about the name or the place."""

from __future__ import annotations

from pathlib import Path

import pytest

from statechart.cli.main import main


@pytest.mark.parametrize("name", ["true", "null", "Null", "sin", "my scene", "1st"])
def test_an_invalid_document_name_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", name]) == 2
    assert f"{name!r} cannot be the name of a model" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["my scene", "my_scene.yaml", "my-scene"])
def test_advice_on_an_invalid_document_name_is_a_valid_one(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", name]) == 2
    assert capsys.readouterr().err.endswith("; write statechart new my_scene\n")


def test_a_folder_that_is_not_writable_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def locked(**_: object) -> None:
        raise PermissionError

    monkeypatch.chdir(tmp_path)
    # Whoever runs the tests may be allowed to write everywhere.
    monkeypatch.setattr("tempfile.TemporaryFile", locked)
    assert main(["new", "mine"]) == 2
    assert f"there is no folder {tmp_path} that is writable" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
