"""Display of a run in a notebook: compact tables and the figure, in HTML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from statechart.automaton.trace import Outcome
from statechart.documents.quantities import beside
from statechart.reporting.figure import render
from statechart.reporting.text import change, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Digits of numbers in a table that is looked at; `--json` and `Result.to_dict` have all.
_DIGITS = 6


def html(report: Mapping[str, Any], drawing: Figure | str) -> str:
    """Return a run as a part of a page."""
    head = f"<b>{escape(report['model'])}: {escape(report['outcome'])}</b>"
    words = escape(Outcome[report["outcome"]].value)
    parts = [f"<p>{head}<br>{words} {escape(report['message'])}</p>"]
    parts += [f"<p>Warning: {escape(warning)}</p>" for warning in report["warnings"]]
    units = report["units"]
    outputs = [
        (escape(name), number(value), escape(beside(units.get(name, ""))))
        for name, value in report["outputs"].items()
    ]
    if outputs:
        parts.append(table(("output", "value", "unit" if units else ""), outputs))
    if report["events"]:
        parts.append(table(("t", "region", "cause", "from &rarr; to"), _events(report["events"])))
    drawn = f"<p>{escape(drawing)}</p>" if isinstance(drawing, str) else _picture(drawing)
    return f"<div>{''.join(parts)}{drawn}</div>"


def _picture(drawing: Figure) -> str:
    svg = render(drawing, "svg").decode()
    # As wide as what it stands in: telephones are narrower than the figure.
    whole = svg[svg.index("<svg") :].replace("<svg", '<svg style="width: 100%; height: auto"', 1)
    return f'<div style="max-width:760px">{whole}</div>'


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table; its cells are HTML."""

    def line(cells: Iterable[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{cell}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f"<table><thead>{line(head, 'th')}</thead><tbody>{body}</tbody></table>"


def number(value: object) -> str:
    """Return a value of an output, its numbers short, as HTML."""
    if isinstance(value, float):
        return f"{value:.{_DIGITS}g}"
    if isinstance(value, list):
        many = len(value) > _DIGITS
        parts = ", ".join(number(part) for part in value[:_DIGITS])
        return f"[{parts}{f', ... {len(value) - _DIGITS} more' if many else ''}]"
    return escape("none" if value is None else str(value))


def _events(events: Any) -> Iterable[tuple[str, ...]]:
    for event in shown(events):
        if isinstance(event, int):
            yield (f"... {event} more", "", "", "")
        else:
            yield (
                number(event["t"]),
                escape(event["contact"] or ""),
                escape(event["cause"]),
                escape(change(event)),
            )
