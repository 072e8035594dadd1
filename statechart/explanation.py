"""Why every jump of a run happened, as text for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from statechart.summary import change, shown, table


def explanation(report: Mapping[str, Any]) -> str:
    """Return what fired at every jump, the margins, what it did, and what else was considered.

    Parameters
    ----------
    report : mapping
        From `statechart.report.report` with `explain`, or read from a ``run.json``.
    """
    events = report["events"]
    blocks = []
    for event in shown(events):
        if isinstance(event, int):
            blocks.append(f"... {event} more: --json --explain or --output has all\n")
        else:
            blocks.append(_event(event))
    return "\n".join(blocks)


def _event(event: Mapping[str, Any]) -> str:
    what = " ".join(filter(None, (event["contact"], event["cause"])))
    changed = change(event)
    title = f"t = {event['t']!r}, jump {event['j']}: {what}{', ' if changed else ''}{changed}\n"
    rows = [("fired", ", ".join(event["fired"]) or "no margin: the state called for it at once")]
    margins = sorted(
        event.get("margins", {}).items(), key=lambda item: item[0] not in event["fired"]
    )
    rows += _entitled("margins", [(name, _told(value)) for name, value in margins])
    impulses = event["impulse"].items()
    rows += _entitled(
        "impulse",
        [
            (name, f"normal {_told(i['normal'])}, tangential {_told(i['tangential'])}")
            for name, i in impulses
        ],
    )
    rows += _entitled("path", [(step,) for step in event["path"]])
    if event["energy"] is not None:
        before, after = event["energy"]
        rows.append(("energy", f"{_told(before)} -> {_told(after)}"))
    if event["skipped"]:
        rows.append(("skipped", f"the bounces of {_told(event['skipped'])} units of time"))
    rows += _entitled("considered", _candidates(event))
    return title + table([(f"  {head}", text) for head, text in rows])


def _entitled(head: str, lines: list[tuple[str, ...]]) -> list[tuple[str, str]]:
    """Return the lines of a table under one heading."""
    if not lines:
        return []
    texts = table(lines).splitlines()
    return [(head if place == 0 else "", text) for place, text in enumerate(texts)]


def _candidates(event: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return candidates and verdicts, without the states that all candidates share."""
    labels = {label: label.split() for label in event["considered"]}
    common = set.intersection(*map(set, labels.values())) if len(labels) > 1 else set()
    return [
        (" ".join(part for part in labels[label] if part not in common) or label, verdict)
        for label, verdict in event["considered"].items()
    ]


def _told(value: object) -> str:
    return value if isinstance(value, str) else repr(value)
