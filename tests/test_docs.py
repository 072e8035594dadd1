"""Documentation for developers: files, modules and names on its pages exist."""

from __future__ import annotations

import importlib
import importlib.util
import re
import tomllib
from pathlib import Path

import pytest
from ruamel import yaml

import statechart

ROOT = Path(__file__).parents[1]
PAGES = ("docs/glossary.md", "docs/architecture.md", "CONTRIBUTING.md")


@pytest.mark.parametrize("page", PAGES)
def test_modules_and_files_that_a_page_names_exist(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    for name in re.findall(r"`((?:statechart|contacts)(?:\.[a-z_]+)+)`", text):
        if name.count(".") > 1 or importlib.util.find_spec(name) is not None:
            importlib.import_module(name)
    files = re.findall(r"`((?:statechart|contacts|tests|docs)/[\w./]+)`", text)
    assert all((ROOT / file).exists() for file in files), files


def test_every_folder_docstring_states_its_purpose_in_fifteen_lines() -> None:
    for package in ("statechart", "contacts"):
        for page in (ROOT / package).rglob("__init__.py"):
            doc = importlib.import_module(".".join(page.relative_to(ROOT).parts[:-1])).__doc__
            assert doc, page
            assert len(doc.splitlines()) < 15, page
            rooms = {path.stem for path in page.parent.glob("*.py")} - {"__init__"}
            if page.parent.name not in ("statechart", "contacts", "scipy"):
                assert all(f"`{room}`" in doc for room in rooms), (page, rooms)


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.YAML().load(ROOT / "CITATION.cff")
    assert citation["version"] == project["version"] == statechart.__version__
    assert (citation["title"], citation["license"]) == (project["name"], project["license"])
