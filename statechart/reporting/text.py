"""The report of a run as text for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from statechart.automaton.trace import Outcome
from statechart.documents.quantities import beside
from statechart.tabular import FEW, Block, Table, apart, ends, plain, several, table

# Events listed from the start and from the end.
_SHOWN = 20
_ALL = "--json or --output has all"

_CERTIFIED: Mapping[object, str] = {
    True: "events and motion certified",
    "guards": "every event certified",
    False: "not certified",
}


def summary(report: Mapping[str, Any]) -> str:
    """Return the report of a run as lines of text; numbers keep all their digits."""
    return plain(describe_run(report))


def describe_run(report: Mapping[str, Any]) -> list[Block]:
    """Return the blocks of `summary`: texts and tables."""
    parts: list[list[Block]] = [[_head(report)], _events(report)]
    units = report.get("units", {})
    parts += [
        _values(title, values, units)
        for title, values in (
            ("outputs", _listed(report["outputs"])),
            ("final state", ends(_listed(report["final"]), FEW)),
            ("margins, least value seen", _least(report["margins"])),
            ("invariants, least margin (below 0 it does not hold)", _least(report["invariants"])),
        )
        if values
    ]
    if "alternatives" in report:
        parts.append(_alternatives(report["alternatives"]))
    return apart(parts)


def _head(report: Mapping[str, Any]) -> str:
    lines = [Outcome[report["outcome"]].value, report["message"], *computed(report)]
    return "\n".join([f"{report['model']}: {report['outcome']}", *(f"  {x}" for x in lines)]) + "\n"


def computed(report: Mapping[str, Any]) -> list[str]:
    """Return how a run was computed, its cost, and how exact it is, in lines."""
    counts = report["counts"]
    certified = _CERTIFIED[report["certified"]]
    lines = [
        f"engine {report['engine']}, {_how(report)}; {certified}",
        f"{several(counts['steps'], 'step')}, {several(counts['jumps'], 'jump')}, "
        f"{report['modes_built']} of {several(report['modes_total'], 'mode')} built",
    ]
    if report["error_estimate"] is not None:
        decides = report["asked"] and report["asked"]["decides"]
        words = f", that of {decides}" if decides else ""
        lines.append(f"estimated relative error {float(report['error_estimate']):.2g}{words}")
    if report["asked"] is not None:
        cost = report["asked"]["cost"]
        lines.append(
            f"it took {several(cost['runs'], 'run')}, {several(cost['steps'], 'step')}, "
            f"{cost['seconds']:.2g} s; first "
            f"{'tolerance' if report['step'] is None else 'step'} {report['asked']['basis']}"
        )
        if report["asked"]["not_judged"]:
            names = ", ".join(report["asked"]["not_judged"])
            lines.append(f"not judged: {names} (of events without end)")
    if report["condition"] is not None:
        condition = float(report["condition"])
        lines.append(f"times of events magnify errors of the state by up to {condition:.2g}")
    if report["motion"] is not None:
        lines.append(f"motion: {report['evidence']['motion']}")
    if not report["certified"]:
        lines += [f"evidence of {name}: {how}" for name, how in report["evidence"].items()]
    return lines


def _how(report: Mapping[str, Any]) -> str:
    if report["step"] is not None:
        return f"step {report['step']:.3g}"
    return f"tolerance {report['tolerance']:.3g}"


def _events(report: Mapping[str, Any]) -> list[Block]:
    events = report["events"]
    if not events:
        if report["record"] != "modes":
            return [f"events of contacts were not recorded (record: {report['record']})\n"]
        return ["no events\n"]
    rows = [("t", "region", "cause", "from -> to")]
    for event in shown(events):
        if isinstance(event, int):
            rows.append((f"... {event} more: {_ALL}", "", "", ""))
        else:
            rows.append((repr(event["t"]), event["contact"] or "", event["cause"], change(event)))
    return [Table(rows, headed=True)]


def shown(events: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any] | int]:
    """Return the events to list, with the number left out in the place of many."""
    return ends(events, _SHOWN)


def change(event: Mapping[str, Any], most: int | None = None) -> str:
    """Return what an event changes, such as ``A: free -> pin; B, C: free again``.

    Of more than `most` names that change alike the first are listed, and how many there are.
    """
    before, after = event["from"], event["to"]
    changes: dict[str, list[str]] = {}
    for name in before:
        if before[name] != after[name]:
            changes.setdefault(f"{before[name]} -> {after[name]}", []).append(name)
    # Whose velocity jumped in the state that it stays in, such as a ball that bounces.
    for name in before:
        if before[name] == after[name] and name in (event["contact"], *event["impulse"]):
            changes.setdefault(f"{after[name]} again", []).append(name)
    if len(before) == 1:
        return "".join(changes)

    def cut(names: list[str]) -> str:
        if most is None or len(names) <= most:
            return ", ".join(names)
        return f"{', '.join(names[: most - 1])}, {len(names) - most + 1} more"

    return "; ".join(f"{cut(names)}: {what}" for what, names in changes.items())


def _alternatives(rows: Sequence[Mapping[str, Any]]) -> list[Block]:
    if not rows:
        return ["alternatives: none, no two contacts can be hit together\n"]
    lines = [
        (
            f"  {row['choice']}",
            f"other modes from t = {row['diverged']!r} on; ends with {row['outcome']}"
            if not row["same_modes"]
            else f"same modes; largest relative difference {float(row['difference']):.2g}",
        )
        for row in rows
    ]
    return ["alternatives\n", Table(lines)]


def _listed(values: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return list(values.items())


def _least(values: Mapping[str, Any]) -> list[tuple[str, Any] | int]:
    """Return margins by name; of many the least, and how many others there are."""
    left_out = len(values) - 2 * FEW
    if left_out <= 0:
        return list(values.items())

    def size(item: tuple[str, Any]) -> float:
        # Undefined and absent values come first.
        number = math.nan if item[1] is None else float(item[1])
        return -math.inf if math.isnan(number) else number

    return [*sorted(values.items(), key=size)[: 2 * FEW], left_out]


def _values(
    title: str, values: Sequence[tuple[str, Any] | int], units: Mapping[str, str]
) -> list[Block]:
    """Return values under a title, their units in a column that no list of values pushes away.

    A number stands for as many that are left out.
    """
    numbers = [_text(i[1]) for i in values if not isinstance(i, int) and not isinstance(i[1], list)]
    width, rows = max(map(len, numbers), default=0), []
    for item in values:
        if isinstance(item, int):
            rows.append((f"  ... {item} more: {_ALL}", ""))
        else:
            name, value = item
            unit = beside(units.get(name, ""))
            rows.append((f"  {name}", f"{_text(value).ljust(width)}  {unit}".rstrip()))
    return [f"{title}\n", Table(rows)]


def _text(value: object) -> str:
    if value is None:
        return "null"
    if isinstance(value, list):
        shown = ", ".join(map(_text, value[:_SHOWN]))
        more = f", ... {len(value) - _SHOWN} more" if len(value) > _SHOWN else ""
        return f"[{shown}{more}]"
    return value if isinstance(value, str) else repr(value)


def explanation(report: Mapping[str, Any]) -> str:
    """Return the explanation of every jump: guards that fired, margins, effects, candidates."""
    return plain(explain_events(report))


def explain_events(report: Mapping[str, Any]) -> list[Block]:
    """Return the blocks of `explanation`: titles and tables."""
    return apart(
        [f"... {event} more: --json --explain or --output has all\n"]
        if isinstance(event, int)
        else _event(event)
        for event in shown(report["events"])
    )


def _event(event: Mapping[str, Any]) -> list[Block]:
    what = " ".join(filter(None, (event["contact"], event["cause"])))
    changed = change(event)
    title = f"t = {event['t']!r}, jump {event['j']}: {what}{'; ' if changed else ''}{changed}\n"
    rows = [("fired", ", ".join(event["fired"]) or "no margin: the state called for it at once")]
    margins = sorted(
        event.get("margins", {}).items(), key=lambda item: item[0] not in event["fired"]
    )
    rows += _entitled("margins", [(name, _number(value)) for name, value in margins])
    impulses = event["impulse"].items()
    rows += _entitled(
        "impulse",
        [
            (name, f"normal {_number(i['normal'])}, tangential {_number(i['tangential'])}")
            for name, i in impulses
        ],
    )
    rows += _entitled("path", [(step,) for step in event["path"]])
    if event["energy"] is not None:
        before, after = event["energy"]
        rows.append(("energy", f"{_number(before)} -> {_number(after)}"))
    if event["skipped"]:
        rows.append(("skipped", f"the bounces of {_number(event['skipped'])} units of time"))
    rows += _entitled("considered", _candidates(event))
    return [title, Table([(f"  {head}", text) for head, text in rows])]


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


def _number(value: object) -> str:
    return value if isinstance(value, str) else repr(value)
