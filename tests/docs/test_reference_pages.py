"""The reference of the format lists the values and unit of every key."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from making import changelog, formats

import contacts
import statechart
from statechart.loading.load import schema


def rows(folder: Path, kind: str) -> dict[tuple[str, str], list[str]]:
    """Return of every heading and key the cells of its row."""
    formats.make(folder)
    found, head = {}, ""
    pages = sorted(folder.glob(f"keys-of-a-{kind}*.md"))
    for line in (line for page in pages for line in page.read_text("utf-8").splitlines()):
        head = "" if line.startswith("# ") else head
        head = line.removeprefix("## ") if line.startswith("## ") else head
        if row := re.match(r"\| `(\w+)` \| (.*) \|$", line):
            found[head, row[1]] = [cell.strip() for cell in re.split(r"(?<!\\)\|", row[2])]
    return found


@pytest.mark.parametrize("kind", formats.KINDS)
def test_every_key_has_a_row_with_its_unit(kind: str, tmp_path: Path) -> None:
    reported, whole = rows(tmp_path, kind), json.loads(schema(kind))
    parts: dict[str, Any] = {"": whole, **whole["$defs"]}
    fields = {
        (name, key): field
        for name, part in parts.items()
        for key, field in part.get("properties", {}).items()
    }
    assert reported.keys() == fields.keys()
    for place, field in fields.items():
        value, _, meaning = reported[place]
        assert value
        assert field["description"] in meaning.replace("\\|", "|")
        assert ("Unit: " in meaning) == ("unit" in field)


def test_reference_lists_both_forms_of_a_field(tmp_path: Path) -> None:
    reported = rows(tmp_path, "scene")
    assert reported["", "gravity"][0] == "formula or [formula, formula]"
    assert reported["Body", "mass"][0] == "formula"
    assert reported["Body", "mass"][2] == (
        "Above 0; bodies that are fixed, or led along a path, have none. Unit: mass. Such as `m`."
    )
    to = "[formula, formula] or [Point](#scene-point) or [Path](#scene-path)"
    assert reported["Joint", "to"][0] == to


def test_every_release_of_the_changelog_has_a_page(tmp_path: Path) -> None:
    file = Path(__file__).parents[2] / "CHANGELOG.md"
    changelog.make(file, tmp_path)
    heads = re.findall(r"^## (.*)$", file.read_text(encoding="utf-8"), re.M)
    pages = sorted((tmp_path / "changelog").glob("*.md"))
    texts = [page.read_text(encoding="utf-8") for page in pages]
    assert {text.partition("\n")[0] for text in texts} == {f"# {head}" for head in heads}
    listed = (tmp_path / "changelog.md").read_text(encoding="utf-8")
    assert re.findall(r"^changelog/(\S+)$", listed, re.M)[0] == "unreleased"
    assert all(f"changelog/{page.stem}\n" in listed for page in pages)
    # Every line of the file is on a page.
    lines = file.read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith("- ") for line in lines) == "".join(texts).count("\n- ")


@pytest.mark.parametrize("package", [statechart, contacts])
def test_every_public_name_is_on_exactly_one_page_of_the_reference(package: ModuleType) -> None:
    pages = (Path(__file__).parents[2] / "docs" / "api").glob("*.md")
    listed = [
        name
        for page in pages
        if f"currentmodule:: {package.__name__}\n" in (text := page.read_text(encoding="utf-8"))
        for name in re.findall(r"^\.\. auto(?:class|function):: (\w+)$", text, re.M)
    ]
    assert sorted(listed) == sorted(package.__all__)
