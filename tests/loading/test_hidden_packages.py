"""Packages of this project that a user's own folder hides."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import contacts
from statechart.errors import StatechartError
from statechart.loading.kind import kind

SCRIPT = """\
from statechart.loading.load import find
import models
assert models.MINE
print(find("dice").name)
"""


def test_a_folder_next_to_a_script_does_not_shadow_shipped_models(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "__init__.py").write_text("MINE = True\n")
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ("dice.yaml\n", "")


@pytest.mark.parametrize("hiding", ["contacts.py", "contacts/__init__.py"])
@pytest.mark.parametrize("imported", [False, True])
def test_message_names_the_file_that_hides_the_contacts_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hiding: str, imported: bool
) -> None:
    (tmp_path / hiding).parent.mkdir(exist_ok=True)
    (tmp_path / hiding).write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "contacts")
    if imported:
        assert __import__("contacts") is not contacts
    with pytest.raises(StatechartError) as caught:
        kind("scene")
    assert str(caught.value) == (
        f"the package 'contacts' of statechart is hidden by {tmp_path / hiding}, "
        "which comes first on Python's path; rename that, or run from another folder"
    )
    monkeypatch.setitem(sys.modules, "contacts", contacts)
    assert kind("scene").name == "scene"
