"""The page of a run: its content as one plain object, with arrays as base64, and its file."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Key, Trace
from statechart.diagram.build import active_states
from statechart.diagram.layout.ring import MAX_STEPS, find_rounds
from statechart.diagram.model import Chart, Diagram, identifiers
from statechart.diagram.write import svg
from statechart.documents.declaration import TIME
from statechart.documents.files import explain_os_errors, write_atomic
from statechart.documents.quantities import unit_of, unit_suffix
from statechart.errors import DeclarationError
from statechart.loading.kind import kind
from statechart.observation.observer import Observer
from statechart.observation.sampling import Samples
from statechart.palette import GRID, LINES
from statechart.pictures.film import LONGEST, Film, Shape, hatching
from statechart.reporting.curves import (
    COLUMNS,
    DrawnCurve,
    Panel,
    curves,
    end_of_activity,
    impulse_label,
    impulses_of,
    largest,
)
from statechart.reporting.figure import band_remarks, regions_with_bands
from statechart.reporting.film import film_at, stage_of
from statechart.reporting.text import ALIKE, change, computation_lines, explained
from statechart.tabular import MAX_LISTED, number

# Pictures that a page has at most and at least, and numbers that all of them have.
_MAX_SAMPLES, _MIN_SAMPLES, _NUMBERS = 600, 120, 150_000
MOST_EVENTS = 300
"""Events of which a page says why, at most."""
# At least, and regions that all of them change.
_FEW, _CHANGED = 60, 9000
# Points of a curve; a diagram of more modes is not looked at.
_POINTS, _NODES = 1200, 40
# Width of the moving scene, in its own units.
_PICTURE = 1000.0


def content(
    observer: Observer, trace: Trace, report: Mapping[str, Any], diagram: Diagram | None
) -> dict[str, Any]:
    """Return the content of the page of a run."""
    automaton = observer.automaton
    declared = automaton.declaration.parameters
    seen = kind(automaton.declaration.kind).stage is not None
    stage = stage_of(automaton) if seen else None
    drawn, panels = curves(observer, trace)
    end = end_of_activity(trace, drawn, panels)
    width = 3 * len(automaton.regions) + 9 if seen else 1
    count = int(np.clip(_NUMBERS // max(width, 1), _MIN_SAMPLES, _MAX_SAMPLES))
    limit = int(np.clip(_CHANGED // max(len(automaton.regions), 1), _FEW, MOST_EVENTS))
    events = [event for event in report["events"] if event["t"] <= end][:limit]
    times = np.unique([*np.linspace(0.0, end, count), *(event["t"] for event in events)])
    film = None if stage is None else film_at(stage, observer, trace, times)
    samples = observer.sample(trace, automaton.names[:1], times=times)
    keys = [samples.modes[place] for place in samples.mode]
    rows = regions_with_bands(automaton, trace)
    return {
        "title": trace.name,
        "doc": automaton.declaration.doc,
        "outcome": f"{report['outcome']}: {report['message']}",
        "computed": computation_lines(report),
        "lines": list(LINES),
        "unit": unit_suffix(automaton.declaration.unit(TIME)),
        "cut": end < trace.t_end,
        "end": trace.t_end,
        "times": _pack(times, np.float64),
        "regions": _regions(automaton, keys, rows),
        "unbanded": list(band_remarks(trace, rows)),
        "mode": _pack(samples.mode, np.int32),
        "film": None if film is None else _film(film, automaton.declaration.units),
        "panels": _panels(trace, _until(observer, trace, drawn, end), panels),
        "events": [_event(event, times, trace.step) for event in events],
        "more": len(trace.jumps) - len(events),
        "chart": _chart(automaton, diagram, trace, samples),
        "outputs": _with_units(report["outputs"], report["units"]),
        "parameters": _with_units(
            {name: value for name, value in report["parameters"].items() if name in declared},
            report["units"],
        ),
        "warnings": list(report["warnings"]),
    }


def _regions(
    automaton: Automaton, keys: Sequence[Key], rows: Sequence[int]
) -> list[dict[str, Any]]:
    unrecorded = len(automaton.regions) - len(keys[0])
    colours = automaton.colours
    named = zip(automaton.region_names, automaton.recorded_states(keys[0]), strict=True)
    return [
        {
            "name": name,
            "states": list(states),
            "colours": [colours[name].get(state, GRID) for state in states],
            "state": _pack(
                np.array(
                    [states.index(key[k - unrecorded]) if k >= unrecorded else 0 for key in keys]
                ),
                np.uint8,
            ),
            "shown": k - unrecorded in rows,
        }
        for k, (name, states) in enumerate(named)
    ]


def _film(film: Film, units: Mapping[str, str]) -> dict[str, Any]:
    """Return a film with lengths relative to its picture: browsers draw none of a micrometre."""
    part = _PICTURE / film.unit
    place = np.array([part, part, 1.0])
    return {
        "half": [part * film.half[0], part * film.half[1]],
        "unit": _PICTURE,
        "length": film.unit,
        "of": unit_suffix(unit_of("length", units)),
        "arrow": part * film.arrow,
        "usual": film.force,
        "longest": LONGEST * film.force,
        "trails": film.trails,
        "frames": film.poses.shape[1],
        "poses": _pack(film.poses * place, np.float32),
        "centres": _pack(part * film.centres, np.float32),
        "shapes": [_shape(film, shape, part) for shape in film.shapes],
        "touches": [
            {
                "name": touch.name,
                "region": touch.region,
                "places": _pack(part * touch.places, np.float32),
                "normals": _pack(touch.normals, np.float32),
                "forces": _pack(touch.forces, np.float32),
                "friction": _pack(touch.friction, np.float32),
            }
            for touch in film.touches
        ],
    }


def _shape(film: Film, shape: Shape, part: float) -> dict[str, Any]:
    made: dict[str, Any] = {
        "kind": shape.kind,
        "points": _short(part * shape.points),
        "frame": shape.frame,
        "other": shape.other,
        "radius": part * shape.radius,
        "region": shape.region,
        "name": shape.name,
        "aside": shape.aside,
        "turns": shape.turns,
    }
    if shape.slack is not None:
        made["slack"] = shape.slack.tolist()
    if shape.kind == "ground":
        made["strokes"] = _short(part * hatching(shape.points, film.spacing).reshape(-1, 4))
    return made


def _until(observer: Observer, trace: Trace, samples: Samples, end: float) -> Samples:
    """Return the samples of the shown part of a run, the last at its `end`."""
    if end >= trace.t_end:
        return samples
    last = observer.sample(trace, tuple(samples.columns), times=[end])
    kept = samples.t < end
    columns = {
        name: np.append(column[kept], last.columns[name] if largest(column) > 0.0 else 0.0)
        for name, column in samples.columns.items()
    }
    return Samples(
        np.append(samples.t[kept], end),
        np.append(samples.j[kept], last.j),
        np.append(samples.mode[kept], len(samples.modes) + last.mode),
        (*samples.modes, *last.modes),
        columns,
    )


def _panels(trace: Trace, samples: Samples, found: Sequence[Panel]) -> list[dict[str, Any]]:
    end = float(samples.t[-1])
    chosen = _sample_rows(samples, end)
    line = DrawnCurve.of(replace(samples, t=samples.t[chosen], j=samples.j[chosen]))

    def drawn(values: Array) -> str:
        return _pack(line.values(values[chosen]), np.float32)

    made = []
    for panel in found:
        names = panel.names
        cone = None
        if panel.cone is not None:
            name, friction = panel.cone
            cone = drawn(np.broadcast_to(friction * samples.columns[name], samples.t.shape))
        made.append(
            {
                "title": panel.label,
                "t": _pack(line.times, np.float32),
                "names": list(names),
                "curves": [drawn(samples.columns[name]) for name in names],
                "colours": list(LINES[: len(names)]),
                "cone": cone,
                "struck": [_impulses_of(trace, panel, region, end) for region in panel.impulses],
                "remarks": list(panel.remarks),
            }
        )
    return made


def _impulses_of(trace: Trace, panel: Panel, region: str, end: float) -> dict[str, Any]:
    """Return the impulses of a region: with sizes where no forces have the axis."""
    times, sizes = impulses_of(trace, region)
    seen = times <= end
    return {
        "name": impulse_label(panel, sizes) if panel.names else region,
        "t": _pack(times[seen], np.float32),
        "sizes": "" if panel.names else _pack(sizes[seen], np.float32),
    }


def _sample_rows(samples: Samples, end: float) -> NDArray[np.intp]:
    """Return the sampled rows of curves, including both ends of every flow.

    Without both ends a curve would stop before its jump. With too many flows these are all rows, of
    which `DrawnCurve` takes the least and largest of each column.
    """
    inside = np.flatnonzero(samples.t <= end)
    # One of every column, as far as there are any: a long flow looks as smooth as short ones.
    columns = np.floor(samples.t[inside] * (_POINTS / end if end > 0.0 else 0.0))
    chosen = inside[np.flatnonzero(np.diff(columns, prepend=-1.0))]
    first = np.flatnonzero(np.diff(samples.j[inside])) + 1
    if len(first) > COLUMNS:
        return inside
    return np.unique(np.concatenate([chosen, inside[first - 1], inside[first], inside[-1:]]))


def _event(event: Mapping[str, Any], times: Array, step: float | None) -> dict[str, Any]:
    title, reasons = explained(event, step)
    return {
        "t": event["t"],
        "instant": int(np.searchsorted(times, event["t"])),
        "what": " ".join(filter(None, (event["contact"], event["cause"]))),
        "change": change(event, ALIKE),
        "why": title,
        "reasons": reasons,
    }


def _chart(
    automaton: Automaton, diagram: Diagram | None, trace: Trace, samples: Samples
) -> dict[str, Any]:
    """Return the drawn statechart, and which node each instant is; nothing of a large one."""
    none: dict[str, Any] = {"svg": "", "nodes": [[]] * len(samples.modes), "states": []}
    place = np.zeros(len(samples.t), dtype=np.intp)
    if diagram is not None:
        diagram, active = _complete_diagram(automaton, diagram, samples.modes)
    if diagram is None or not 0 < len(diagram.nodes) <= _NODES:
        return {**none, "place": _pack(place, np.uint8)}
    drawn = svg(_without_markup(diagram))
    names = identifiers(diagram)
    nodes = [[names[name] for name in active(key) if name in names] for key in samples.modes]
    states = [names[node.name] for piece in diagram.pieces for node in piece.leaves]
    if len(diagram.charts) == 1 and diagram.charts[0].path:
        visits = _visits(diagram.charts[0].path, [active(jump.target) for jump in trace.jumps])
        place = visits[samples.j]
    return {
        "svg": drawn[drawn.index("<svg") :],
        "nodes": nodes,
        "states": states,
        "place": _pack(place, np.uint8),
    }


def _visits(path: Sequence[str], entered: Sequence[tuple[str, ...]]) -> NDArray[np.intp]:
    """Return which of the places of its mode a run is at (n + 1,), at the start and after jumps.

    A path is drawn as a chain, or as rounds of a cycle, in which a mode may stand more than once.
    """
    found = find_rounds(path)
    if found is None or len(found.order) > MAX_STEPS:
        return np.zeros(len(entered) + 1, dtype=np.intp)
    order, begin, step, places = found.order, found.back or 0, 0, [0]
    for names in entered:
        if step + 1 < len(path) and names == (path[step + 1],) != (path[step],):
            step += 1
        places.append(step if step < len(order) else begin + (step - begin) % (len(order) - begin))
    return np.array([order[:k].count(order[k]) for k in places], dtype=np.intp)


def _complete_diagram(
    automaton: Automaton, diagram: Diagram, modes: Sequence[Key]
) -> tuple[Diagram, Callable[[Key], tuple[str, ...]]]:
    """Return a diagram with every mode, and its active nodes in each mode.

    The diagram of a run through many modes shows the first ones; the charts of the regions show
    the others.
    """
    shown = {node.name for node in diagram.nodes}

    def of_modes(key: Key) -> tuple[str, ...]:
        declared = tuple(r.declared(s) for r, s in zip(automaton.regions, key, strict=True))
        return next(((name,) for name in (" ".join(key), " ".join(declared)) if name in shown), ())

    if not diagram.explained or all(map(of_modes, modes)):
        return diagram, of_modes
    return replace(diagram, charts=diagram.explained, explained=()), active_states(automaton)


def _without_markup(diagram: Diagram) -> Diagram:
    """Return a diagram without its title, guards, conditions and actions, for the page."""

    def bare(chart: Chart) -> Chart:
        nodes = tuple(replace(node, invariants=(), actions=()) for node in chart.nodes)
        links = tuple(replace(link, guard="", reset="") for link in chart.links)
        axes = None if chart.axes is None else (bare(chart.axes[0]), bare(chart.axes[1]))
        return replace(chart, nodes=nodes, links=links, axes=axes)

    charts = tuple(map(bare, diagram.charts))
    return replace(diagram, title="", charts=charts, notes=(), explained=())


def _with_units(values: Mapping[str, object], units: Mapping[str, str]) -> dict[str, Any]:
    """Return values as text with units, and the numbers of long lists for a sparkline."""

    def shown(name: str, value: object) -> dict[str, Any]:
        unit = "" if value is None else unit_suffix(units.get(name, ""))
        many = value if isinstance(value, list) and len(value) > MAX_LISTED else []
        return {"text": f"{number(value)} {unit}".rstrip(), "values": many}

    return {name: shown(name, value) for name, value in values.items()}


def _short(values: Array) -> list[Any]:
    found: list[Any] = [[float(f"{x:.6g}") for x in row] for row in values.tolist()]
    return found


def _pack(values: Array | NDArray[np.integer[Any]], kind: type) -> str:
    little = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    return b64encode(little.tobytes()).decode()


_HERE = Path(__file__).parent
# In this order: the moving scene, then all that moves along.
_SCRIPTS = ("scene.js", "page.js")


def frame(page: str) -> str:
    """Return a page in an isolated frame for notebooks."""
    style = "box-sizing: border-box; width: 100%; height: 760px; border: 1px solid #8886"
    return f'<iframe srcdoc="{escape(page)}" sandbox="allow-scripts" style="{style}"></iframe>'


def html(shown: Mapping[str, Any]) -> str:
    """Return the page."""
    # Nothing in it can end the element that it stands in.
    data = json.dumps(shown, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    parts = {
        "TITLE": escape(shown["title"]),
        "STYLE": (_HERE / "page.css").read_text(encoding="utf-8"),
        "SCRIPT": "".join((_HERE / name).read_text(encoding="utf-8") for name in _SCRIPTS),
        "DATA": data,
    }
    text = (_HERE / "page.html").read_text(encoding="utf-8")
    return re.sub(f"@({'|'.join(parts)})@", lambda found: parts[found[1]], text)


def write_page(shown: Mapping[str, Any], path: Path) -> None:
    """Write the page atomically."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise DeclarationError(f"a page is .html, not {path.suffix or path.name!r}")
    with explain_os_errors("write", path):
        write_atomic(path, html(shown).encode())
