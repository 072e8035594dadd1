"""Pages that are followed: their commands run in a shell, and their output is compared."""

from __future__ import annotations

from pathlib import Path

import pytest
from making.following import Block, blocks, follow, followed

PAGE = """\
Write this into `a.txt`:

```text
one
```

Then add to the end of `a.txt`:

```text
two
```

<!-- varies: `0.123456` -->
```console
$ cat a.txt
one
...
$ echo a 0.123; true
a 0.123456
$ false
expected
```
"""


def page(tmp_path: Path, text: str) -> Path:
    made = tmp_path / "page.md"
    made.write_text(text, encoding="utf-8")
    return made


def test_blocks_have_a_place_and_a_file(tmp_path: Path) -> None:
    first, second, third = blocks(page(tmp_path, PAGE))
    assert first == Block("text", "one\n", "Write this into `a.txt`:", 4)
    assert (first.typed, second.typed, third.typed) == (("a.txt", False), ("a.txt", True), None)


def test_following_a_page_stops_at_different_output(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=r"page\.md:15: \$ false"):
        follow(page(tmp_path, PAGE), tmp_path)
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "one\ntwo\n"
    follow(page(tmp_path, PAGE.replace("$ false\nexpected\n", "")), tmp_path)


@pytest.mark.parametrize(
    ("command", "printed"),
    [("false", ""), ("echo one", "two"), ("echo one", "one\ntwo"), ("seq 3", "1\n...\n4")],
)
def test_follow_reports_the_command_whose_output_differs(
    command: str, printed: str, tmp_path: Path
) -> None:
    text = f"```console\n$ {command}\n{printed}\n```\n"
    with pytest.raises(AssertionError, match=command):
        follow(page(tmp_path, text), tmp_path)


def test_pages_without_commands_or_files_are_not_followed(tmp_path: Path) -> None:
    assert not followed(page(tmp_path, "```text\na\n```\n"))
    assert followed(page(tmp_path, PAGE))


@pytest.mark.parametrize("printed", ["a  0.3822630", "a 0.382263", "a 0.3822633"])
def test_numbers_may_differ_in_their_last_digits_and_columns_in_width(
    printed: str, tmp_path: Path
) -> None:
    text = f"```console\n$ echo '{printed}'\na  0.382263\n```\n"
    follow(page(tmp_path, text), tmp_path)


@pytest.mark.parametrize("printed", ["a 0.3823", "b 0.382263", "a 0.382263 m", "a"])
def test_different_numbers_and_text_are_refused(printed: str, tmp_path: Path) -> None:
    text = f"```console\n$ echo '{printed}'\na  0.382263\n```\n"
    with pytest.raises(AssertionError, match="echo"):
        follow(page(tmp_path, text), tmp_path)


def test_only_the_named_parts_of_a_line_may_differ(tmp_path: Path) -> None:
    text = "```console\n$ echo '3 cells; 0.9 s each'\n2 cells; 1.2 s each\n```\n"
    follow(page(tmp_path, f"<!-- varies: `2 cells`, `1.2 s` -->\n{text}"), tmp_path)
    with pytest.raises(AssertionError, match="echo"):
        follow(page(tmp_path, f"<!-- varies: `1.2 s` -->\n{text}"), tmp_path)


def test_lines_are_shown_as_printed(tmp_path: Path) -> None:
    text = "```console\n$ echo 'one two three'\none ... three\n```\n"
    with pytest.raises(AssertionError, match="echo"):
        follow(page(tmp_path, text), tmp_path)
