"""The number of source lines may not grow without a word."""

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("statechart", "contacts", "models")
RECORD = ROOT / ".ci" / "source-lines"
SLACK = 300  # a smaller source is written down anew when it is smaller by more


def test_source_lines_do_not_exceed_the_recorded_number() -> None:
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    lines = sum(path.read_text(encoding="utf-8").count("\n") for path in files)
    recorded = int(RECORD.read_text(encoding="utf-8"))
    assert lines <= recorded, (
        f"{lines} source lines, {recorded} recorded in .ci/source-lines: shorten the change, or "
        f"write {lines} there and say why in the commit"
    )
    assert lines >= recorded - SLACK, f"{lines} source lines: write {lines} to .ci/source-lines"
