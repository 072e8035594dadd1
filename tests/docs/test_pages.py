"""Every block of code on a page is done: in a shell, as a doctest, or as the document it is."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import ModuleType
from urllib.parse import urlsplit

import pytest
from making.following import blocks, follow, followed, shell

import contacts.testing
import statechart.testing
from statechart import Outcome, Runner
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NAMES = {
    str(page.relative_to(DOCS)): page
    for page in sorted(DOCS.rglob("*.md"))
    if "made" not in page.relative_to(DOCS).parts
} | {"README.md": ROOT / "README.md"}


def thinner(command: str) -> str:
    """Return a sweep with fewer cells; only the first one with `--workers` keeps them."""
    fewer = re.sub(r"((?:lin|log):[^:\s]+:[^:\s]+):\d+", r"\1:3", command)
    if "figure_10" not in command:
        fewer = fewer.replace(" --workers 2", "")
    return fewer.replace("--until 1200", "--until 60")


@pytest.fixture
def at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which a shell finds this installation."""
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    return tmp_path


def here(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a verb in this process, which has imported the program; a shell runs other commands."""
    said = re.sub(r"\s#.*", "", command)
    if not said.startswith("statechart ") or re.search(r"[;|&<>$`~*?{}]", said):
        return shell(command, folder)
    words, out, err = shlex.split(said), io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), redirect_stdout(out), redirect_stderr(err):
        code = main(words[1:])
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


@pytest.mark.parametrize("name", [name for name, page in NAMES.items() if followed(page)])
def test_examples_of_a_page_run(name: str, at_home: Path) -> None:
    if name == "sweeps.md":
        shutil.copy(DOCS / "models" / "ball_on_a_plate.yaml", at_home)
    follow(NAMES[name], at_home, thinner if name == "sweeps.md" else str, here)


# Frame of a part of a document on a page; `@` is the place of the part.
HOSTS = {
    ("format/contacts.md", "Wheels and round feet"): """
        kind: scene
        name: bicycle
        parameters: {r: 0.35, mu: 0.8}
        gravity: 9.81
        bodies: {bicycle: {mass: 15, inertia: 2, start: {x: 0, y: 0.8}}}
        surfaces: {road: {height: 0}}
        stop: {time: 1}
        @
        """,
    ("format/collisions.md", "Bodies of several shapes"): """
        kind: scene
        name: gym
        gravity: 9.81
        surfaces: {floor: {height: -1}}
        collisions:
          heap: {bodies: [dumbbell], surfaces: [floor], friction: 0.5, restitution: 0}
        settings: {engine: impulse, step: 1e-3}
        stop: {time: 0.5}
        @
        """,
    ("format/bodies.md", "Forces"): """
        kind: scene
        name: pushed
        gravity: 9.81
        bodies: {stone: {mass: 1, inertia: 0.1}}
        stop: {time: 1}
        @
        """,
    ("format/charts.md", "States in states"): """
        kind: chart
        name: machine
        variables: {x: 0, starts: 0}
        stop: {time: 5}
        @
          user:
            initial: one
            states: {one: {}, two: {}, three: {}, four: {}}
            transitions:
              - {name: go, from: one, to: two, after: 1}
              - {name: halt, from: two, to: three, after: 1}
              - {name: reset, from: three, to: four, after: 1}
        """,
    ("format.md", "Functions that switch"): """
        @
        """,
    ("format.md", "Periodic formulas"): """
        @
        """,
    ("format/charts.md", "Timeouts and samples"): """
        kind: chart
        name: sampled
        parameters: {T: 0.1, K: 1, D: 1}
        variables: {theta: 1, dtheta: 0, held: 0}
        stop: {time: 1}
        regions:
          controller:
            initial: looking
            states: {looking: {flows: {theta: dtheta, dtheta: held}}}
            @
        """,
    ("format/charts.md", "Sampled guards"): """
        kind: chart
        name: tank
        variables: {h: 0}
        stop: {time: 3}
        @
        """,
}


def parts() -> list[tuple[str, str, str]]:
    """The blocks of YAML that are not files: page, heading, text."""
    found = []
    for name, page in NAMES.items():
        heads = {
            place: line.lstrip("# ")
            for place, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1)
            if re.match(r"#+ ", line)
        }
        for block in blocks(page):
            if block.language == "yaml" and block.typed is None:
                head = heads[max(place for place in heads if place < block.line)]
                found.append((name, head, block.text))
    return found


@pytest.mark.parametrize(("name", "head", "text"), parts())
def test_document_fragments_run_in_a_whole_document(name: str, head: str, text: str) -> None:
    host = textwrap.dedent(HOSTS[name, head]).lstrip()
    indent = re.search(r"^( *)@$", host, re.M)
    assert indent is not None
    whole = host.replace(indent[0], textwrap.indent(text, indent[1]))
    assert Runner(read_text(whole)).run().trace.outcome is Outcome.HORIZON


def test_every_block_has_a_tested_kind() -> None:
    for name, page in NAMES.items():
        for block in blocks(page):
            place = f"{name}:{block.line}"
            if block.language == "python":
                assert ">>> " in block.text, f"{place}: not run; write it as a doctest"
            elif block.language == "bash":
                assert f"```bash\n{block.text}" in (ROOT / "README.md").read_text("utf-8"), place
            else:
                # Cells run when the site is built; `text` is the prose.
                known = block.language in ("yaml", "console", "text") or "{" in block.language
                assert known, f"{place}: a block of {block.language or 'no language'}"


@pytest.mark.parametrize("room", [statechart.testing, contacts.testing])
def test_strategies_and_assertions_have_examples_and_parameters(
    room: ModuleType,
) -> None:
    page = (DOCS / "testing.md").read_text(encoding="utf-8")
    code = "\n".join(re.findall(r"^(?:>>>|\.\.\.) (.*)$", page, re.M))
    for name in room.__all__:
        offered = getattr(room, name)
        if isinstance(offered, type):
            assert re.search(rf"\b{name}\b", page), name
            continue
        # Once it is imported, and once it is used.
        assert len(re.findall(rf"(?<!\.)\b{name}\b", code)) > 1, f"{name} has no example"
        assert "Parameters\n" in (offered.__doc__ or ""), name


def test_links_to_other_sites_are_well_formed_and_stand_once_on_a_page() -> None:
    pages = [*NAMES.values(), *(ROOT / name for name in ("README.md", "CONTRIBUTING.md"))]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        links = re.findall(r"\]\((\w+://[^)]*)\)|<(\w+://[^>]*)>", text)
        found = [one or other for one, other in links]
        assert len(found) == len({*found}), f"{page}: a link stands twice"
        for link in found:
            parts = urlsplit(link)
            assert parts.scheme == "https", f"{page}: {link}"
            assert re.fullmatch(r"([\w-]+\.)+[a-z]{2,}", parts.netloc), f"{page}: {link}"
            assert not re.search(r"[\s\"'`]", link), f"{page}: {link}"


def test_each_outcome_has_an_entry_with_an_example() -> None:
    pages = [DOCS / "how-to" / f"outcomes{part}.md" for part in ("", "-numerics")]
    entries = [
        entry
        for page in pages
        for entry in re.split(r"^## ", page.read_text(encoding="utf-8"), flags=re.M)[1:]
    ]
    assert [entry.splitlines()[0] for entry in entries] == [o.name for o in Outcome]
    # Every run shows the first two; the third is the reader's Ctrl-C.
    unshown = {"HORIZON", "STOPPED", "INTERRUPTED"}
    for entry in entries:
        name, _, text = entry.partition("\n")
        assert (f": {name}\n" in text) == (name not in unshown), name
