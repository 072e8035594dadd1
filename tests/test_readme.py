"""The README: its commands run and print the output shown."""

from __future__ import annotations

import doctest
import re
from pathlib import Path
from typing import Any

from contacts.scene.scene import Scene
from models import names, path
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_scene_in_yaml_is_the_one_in_python() -> None:
    block = re.search(r"```yaml\n(.*?)```", README, re.S)
    assert block is not None
    globals_: dict[str, Any] = {}
    example = doctest.DocTestParser().get_doctest(README, globals_, "README", None, None)
    results = doctest.DocTestRunner().run(example, clear_globs=False)
    assert (results.failed, results.attempted > 0) == (0, True)
    scene = example.globs["scene"]
    assert isinstance(scene, Scene)
    assert interpret(read_text(block[1])) == scene


def test_the_readme_opens_with_two_commands() -> None:
    first, second = re.findall(r"```bash\n(.*?)```", README, re.S)
    assert first.rstrip().endswith("statechart run models/toppling_stick.yaml")
    assert "dev" not in first
    install, test = second.split(" && ")
    assert install == '.venv/bin/pip install --quiet -e ".[dev]"'
    assert test == ".venv/bin/python -m pytest -n 2\n"


def test_links_and_pictures_of_the_documentation_exist() -> None:
    made = ROOT / "docs" / "made"  # with the site, which checks its links itself
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
            linked = page.parent / target
            there = linked.exists() or made in linked.resolve().parents
            assert there or made in page.parents, f"{page.name}: {target}"


def test_the_readme_lists_the_verbs_of_the_command_line(capsys: Any) -> None:
    assert main(["--help"]) == 0
    listed = re.search(
        r"^\s+VERB\n((?:\s{4}\S.*\n(?:\s{6,}\S.*\n)*)+)", capsys.readouterr().out, re.M
    )
    assert listed is not None
    verbs = set(re.findall(r"^\s{4}(\w+)", listed[1], re.M))
    assert verbs == set(re.findall(r"^statechart (\w+)", README, re.M))


def test_the_readme_lists_the_shipped_models_with_their_subjects() -> None:
    table = README.split("## Models\n")[1].split("\n## ")[0]
    listed = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", table, re.M))
    shipped = {name: path(name) for name in names()}
    assert listed == {
        name: re.findall(r"^doc: (.*)$", file.read_text(encoding="utf-8"), re.M)[0]
        for name, file in shipped.items()
        if file is not None
    }
