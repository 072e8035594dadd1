"""Report of a run as text."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from statechart.automaton.trace import Outcome
from statechart.documents.quantities import unit_suffix
from statechart.tabular import (
    DIGITS,
    FEW,
    Table,
    TextBlock,
    abridge,
    align_numbers,
    join_blocks,
    number,
    pluralise,
    table,
    write_plain,
)

_SHOWN = 20  # events listed from the start and from the end
# Names per line; characters of the name of a margin, and of a candidate in a table.
_NAMES, _CHARACTERS, _CANDIDATE, _CANDIDATES = 8, 60, 80, 12
_PART = re.compile(r" #(\d+)$")
_NUMBER = re.compile(r"(?<= )-?\d[\w.+-]*")
# Regions with the same change that are named in a list of events.
ALIKE = 4
_ALL = "--json or --output has all"
# Causes of an event at which no guard fired: event-driven, and by time steps.
_IMMEDIATE = "immediate: the mode just entered was not valid"
_STEPPED = "no guard: found by the time step"

_CERTIFIED: Mapping[object, str] = {
    True: "events and motion certified",
    "guards": "every event certified",
    False: "not certified",
}


def summary(report: Mapping[str, Any], digits: int = DIGITS) -> str:
    """Return the report of a run as lines of text."""
    return write_plain(describe_run(report, digits))


def describe_run(report: Mapping[str, Any], digits: int = DIGITS) -> list[TextBlock]:
    """Return the texts and tables of `summary`."""
    parts: list[list[TextBlock]] = [[_head(report)], _event_blocks(report, digits)]
    units = report.get("units", {})
    tables: Mapping[str, Sequence[tuple[str, Any] | int]] = {
        "outputs": list(report["outputs"].items()),
        "final state": abridge(list(report["final"].items()), FEW),
        "margins, least sampled value": _least(report["margins"]),
        "invariants, least exact margin (violated below 0)": _least(report["invariants"]),
    }
    parts += [_values(title, values, units, digits) for title, values in tables.items() if values]
    if "alternatives" in report:
        parts.append(_alternatives(report["alternatives"], digits))
    return join_blocks(parts)


def _head(report: Mapping[str, Any]) -> str:
    lines = [Outcome[report["outcome"]].value, report["message"], *computation_lines(report)]
    return "\n".join([f"{report['model']}: {report['outcome']}", *(f"  {x}" for x in lines)]) + "\n"


def computation_lines(report: Mapping[str, Any]) -> list[str]:
    """Return lines on engine, cost and accuracy of a run."""
    counts = report["counts"]
    certified = _CERTIFIED[report["certified"]]
    kind = "tolerance" if report["step"] is None else "step"
    lines = [
        f"engine {report['engine']}, {kind} {report[kind]:.3g}; {certified}",
        f"{pluralise(counts['steps'], 'step')}, {pluralise(counts['jumps'], 'jump')}",
    ]
    if report["step"] is None:  # time steps build no modes
        built = f"{report['modes_built']} of {pluralise(report['modes_total'], 'mode')} built"
        lines[-1] = f"{lines[-1]}, {built}"
    if report["error_estimate"] is not None:
        decides = report["asked"] and report["asked"]["decides"]
        words = f", in {decides}" if decides else ""
        lines.append(f"estimated relative error {float(report['error_estimate']):.2g}{words}")
    if report["asked"] is not None:
        cost = report["asked"]["cost"]
        took = f"{pluralise(cost['runs'], 'run')}, {pluralise(cost['steps'], 'step')}"
        basis = f"first {kind} {report['asked']['basis']}"
        lines.append(f"it took {took}, {cost['seconds']:.2g} s; {basis}")
        if report["asked"]["not_judged"]:
            names = ", ".join(report["asked"]["not_judged"])
            lines.append(f"without estimate: {names} (they count infinitely many events)")
    if report["condition"] is not None:
        condition = float(report["condition"])
        lines.append(f"times of events magnify errors of the state by up to {condition:.2g}")
    if report["motion"] is not None:
        lines.append(f"motion: {report['evidence']['motion']}")
    if not report["certified"]:
        alike: dict[str, list[str]] = {}
        for name, how in report["evidence"].items():
            alike.setdefault(how, []).append(_guard(name))
        for how, those in alike.items():
            what = "motion" if those == ["motion"] else f"events of {_cut(those)}"
            lines.append(f"{what}: {how}")
    return lines


def _cut(names: Sequence[str]) -> str:
    if len(names) <= _NAMES:
        return ", ".join(names)
    return f"{', '.join(names[: _NAMES - 1])}, {len(names) - _NAMES + 1} more"


def _event_blocks(report: Mapping[str, Any], digits: int) -> list[TextBlock]:
    events = report["events"]
    if not events:
        if report["record"] != "modes":
            return [f"events of contacts were not recorded (record: {report['record']})\n"]
        return ["no events\n"]
    rows = []
    for event in abridge(events, _SHOWN):
        if isinstance(event, int):
            rows.append((f"... {event} more: {_ALL}", "", "", ""))
        else:
            what = event["contact"] or "", event["cause"], change(event, ALIKE)
            rows.append((number(event["t"], digits), *what))
    times = align_numbers([row[0] for row in rows])
    rows = [(t, *row[1:]) for t, row in zip(times, rows, strict=True)]
    return [Table([("t", "region", "cause", "from -> to"), *rows], headed=True)]


def change(event: Mapping[str, Any], most: int | None = None) -> str:
    """Return the change of mode at an event: ``A: free -> pin; B, C: free again``.

    The number replaces the names of more than `most` regions with the same change.
    """
    before, after = event["from"], event["to"]
    changes: dict[str, list[str]] = {}
    for name in before:
        if before[name] != after[name]:
            changes.setdefault(f"{before[name]} -> {after[name]}", []).append(name)
    # Regions with an impact that stay in their state, such as a bouncing ball.
    for name in before:
        if before[name] == after[name] and name in (event["contact"], *event["impulse"]):
            changes.setdefault(f"{after[name]} again", []).append(name)
    if len(before) == 1:
        return "".join(changes)
    most = len(before) if most is None else most
    return "; ".join(
        f"{', '.join(names) if len(names) <= most else pluralise(len(names), 'region')}: {what}"
        for what, names in changes.items()
    )


def _alternatives(rows: Sequence[Mapping[str, Any]], digits: int) -> list[TextBlock]:
    if not rows:
        return ["alternatives: none, no two contacts can be hit together\n"]
    lines = []
    for row in rows:
        if row["same_modes"]:
            words = f"same modes; largest relative difference {float(row['difference']):.2g}"
        else:
            words = f"other modes from t = {number(row['diverged'], digits)} on"
            words += f"; ends with {row['outcome']}"
        lines.append((f"  {row['choice']}", words))
    return ["alternatives\n", Table(lines)]


def _least(values: Mapping[str, Any]) -> list[tuple[str, Any] | int]:
    """Return margins by name; if there are many, the smallest and the number of the others."""
    left_out = len(values) - 2 * FEW
    if left_out <= 0:
        return list(values.items())

    def size(item: tuple[str, Any]) -> float:
        # Undefined and absent values come first.
        known = math.nan if item[1] is None else float(item[1])
        return -math.inf if math.isnan(known) else known

    return [*sorted(values.items(), key=size)[: 2 * FEW], left_out]


def _values(
    title: str,
    values: Sequence[tuple[str, Any] | int],
    units: Mapping[str, str],
    digits: int = DIGITS,
) -> list[TextBlock]:
    """Return a table of values and units; an integer item is a number of omitted values."""
    known = [item for item in values if not isinstance(item, int)]
    texts = align_numbers([number(value, digits) for _, value in known])
    shown = dict(zip((name for name, _ in known), texts, strict=True))
    numbers = (shown[name] for name, value in known if not isinstance(value, list))
    width = max(map(len, numbers), default=0)
    rows = []
    for item in values:
        if isinstance(item, int):
            rows.append((f"  ... {item} more: {_ALL}", ""))
            continue
        name, unit = _guard(item[0]), unit_suffix(units.get(item[0], ""))
        name = name if len(name) <= _CHARACTERS else f"{name[: _CHARACTERS - 3]}..."
        rows.append((f"  {name}", f"{shown[item[0]].ljust(width)}  {unit}".rstrip()))
    return [f"{title}\n", Table(rows)]


def explained(
    event: Mapping[str, Any], step: float | None, digits: int = DIGITS
) -> tuple[str, list[tuple[str, list[tuple[str, ...]]]]]:
    """Return the title of an event, and of its explanation each subject with rows of texts."""

    def columns(values: Mapping[str, Any]) -> list[tuple[str, ...]]:
        texts = align_numbers([number(value, digits) for value in values.values()])
        return list(zip(map(_guard, values), texts, strict=True))

    what = " ".join(filter(None, (event["contact"], event["cause"])))
    changed = change(event)
    time = number(event["t"], digits)
    title = f"t = {time}, jump {event['j']}: {what}{'; ' if changed else ''}{changed}"
    path = event["path"]
    if awaited := [] if event["fired"] else [step for step in path if step.startswith("on ")]:
        path = []
    otherwise = _IMMEDIATE if step is None else _STEPPED
    fired = ", ".join(map(_guard, event["fired"] or awaited)) or otherwise
    margins = dict(event.get("margins", {}))
    ordered = sorted(margins, key=lambda name: name not in event["fired"])
    impulses = {
        name: ", ".join(f"{part} {number(size, digits)}" for part, size in pair.items())
        for name, pair in event["impulse"].items()
    }
    parts: dict[str, list[tuple[str, ...]]] = {
        "fired": [(fired,)],
        "margins": columns({name: margins[name] for name in ordered}),
        "impulse": [*impulses.items(), *columns(event.get("joint_impulse", {}))],
        "path": [(step,) for step in path],
    }
    if event["energy"] is not None:
        before, after = (number(energy, digits) for energy in event["energy"])
        parts["energy"] = [(f"{before} -> {after}",)]
    if event["skipped"]:
        skipped = number(event["skipped"], digits)
        parts["skipped"] = [(f"the bounces of {skipped} units of time",)]
    parts["considered"] = _candidates(event)
    return title, [(head, rows) for head, rows in parts.items() if rows]


def _guard(name: str) -> str:
    """Return the name of a margin for people: an atom of a condition is a numbered part of it."""
    return _PART.sub(r", part \1", name)


def explain_events(report: Mapping[str, Any], digits: int = DIGITS) -> list[TextBlock]:
    """Return for every jump its title, and a table: guards, margins, effects, candidates."""
    return join_blocks(
        [f"... {event} more: --json --explain or --output has all\n"]
        if isinstance(event, int)
        else _event(*explained(event, report["step"], digits))
        for event in abridge(report["events"], _SHOWN)
    )


def _event(title: str, parts: Sequence[tuple[str, list[tuple[str, ...]]]]) -> list[TextBlock]:
    rows = []
    for head, lines in parts:
        first, *others = table(lines).splitlines()
        rows += [(f"  {head}", first), *(("  ", text) for text in others)]
    return [f"{title}\n", Table(rows)]


def _candidates(event: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return candidates and verdicts, without states common to all candidates.

    Of many candidates, one stands for all that have its reason with other numbers.
    """
    labels = {label: label.split() for label in event["considered"]}
    common = set.intersection(*map(set, labels.values())) if len(labels) > 1 else set()
    found: list[tuple[str, ...]] = [
        (" ".join(part for part in labels[label] if part not in common) or label, verdict)
        for label, verdict in event["considered"].items()
    ]
    if len(found) > _CANDIDATES:
        groups: dict[str, list[tuple[str, ...]]] = {}
        for label, verdict in found:
            groups.setdefault(_NUMBER.sub("", verdict), []).append((label, verdict))
        found = [
            (label, verdict + (f"; {len(more)} more alike" if more else ""))
            for (label, verdict), *more in groups.values()
        ]
    short = all(len(label) <= _CANDIDATE for label, *_ in found)
    return found if short else [(": ".join(parts),) for parts in found]
