"""What the page of a run shows, as one plain object; arrays are base64 of their bytes."""

from __future__ import annotations

import tempfile
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Key, Trace
from statechart.diagram.model import Chart, Diagram, identifiers
from statechart.diagram.write import write
from statechart.loading.kind import kind
from statechart.observation.observer import Observer
from statechart.observation.sampling import Samples
from statechart.palette import LINES, state_colours
from statechart.pictures.film import Film, Shape, strokes
from statechart.reporting.curves import curves
from statechart.reporting.film import filmed, stage_of, until_rest
from statechart.reporting.text import change, explanation

# Pictures that a page has at most and at least, and numbers that all of them have.
_MOST, _LEAST, _NUMBERS = 600, 120, 150_000
# Events of which a page says why.
_TOLD = 300
# Points of a curve; a diagram of more modes is not looked at, nor are so many rows of states.
_POINTS, _NODES, _ROWS = 1200, 40, 16


def content(
    observer: Observer, trace: Trace, report: Mapping[str, Any], diagram: Diagram
) -> dict[str, Any]:
    """Return what a page shows of a run.

    Parameters
    ----------
    observer : Observer
        Of the simulator that made the run.
    trace : Trace
        The run.
    report : mapping
        Of the run, with the reasons of its events.
    diagram : Diagram
        Of the model, with the run's path.
    """
    automaton = observer.automaton
    seen = kind(automaton.declaration.kind).stage is not None
    stage = stage_of(automaton) if seen else None
    end = trace.t_end if stage is None else until_rest(stage, observer, trace)
    width = 3 * len(automaton.regions) + 9 if seen else 1
    count = int(np.clip(_NUMBERS // max(width, 1), _LEAST, _MOST))
    events = [event for event in report["events"] if event["t"] <= end][:_TOLD]
    times = np.unique([*np.linspace(0.0, end, count), *(event["t"] for event in events)])
    film = None if stage is None else filmed(stage, observer, trace, times)
    samples = observer.sample(trace, automaton.names[:1], times=times)
    keys = [samples.modes[place] for place in samples.mode]
    return {
        "title": trace.name,
        "doc": automaton.declaration.doc,
        "outcome": f"{report['outcome']}: {report['message']}",
        "engine": report["engine"],
        "cut": end < trace.t_end,
        "end": trace.t_end,
        "times": _packed(times, np.float64),
        "regions": _regions(automaton, keys),
        "modes": [automaton.label(key) for key in samples.modes],
        "mode": _packed(samples.mode, np.int32),
        "film": None if film is None else _film(film),
        "panels": _panels(observer, trace, end),
        "events": [_event(event, times) for event in events],
        "more": len(report["events"]) - len(events),
        "chart": _chart(automaton, diagram, samples),
        "outputs": {name: _told(value) for name, value in report["outputs"].items()},
        "parameters": {name: _told(value) for name, value in report["parameters"].items()},
        "warnings": list(report["warnings"]),
    }


def _regions(automaton: Automaton, keys: Sequence[Key]) -> list[dict[str, Any]]:
    return [
        {
            "name": region.name,
            "states": list(region.states),
            "colours": list(state_colours(region.states).values()),
            "state": _packed(np.array([region.states.index(key[k]) for key in keys]), np.int32),
            "shown": k < _ROWS,
        }
        for k, region in enumerate(automaton.regions)
    ]


def _film(film: Film) -> dict[str, Any]:
    return {
        "half": film.half,
        "unit": film.unit,
        "arrow": film.arrow,
        "longest": film.force,
        "trails": film.trails,
        "frames": film.poses.shape[1],
        "poses": _packed(film.poses, np.float32),
        "centres": _packed(film.centres, np.float32),
        "shapes": [_shape(film, shape) for shape in film.shapes],
        "touches": [
            {
                "name": touch.name,
                "region": touch.region,
                "places": _packed(touch.places, np.float32),
                "normals": _packed(touch.normals, np.float32),
                "forces": _packed(touch.forces, np.float32),
                "friction": _packed(touch.friction, np.float32),
            }
            for touch in film.touches
        ],
    }


def _shape(film: Film, shape: Shape) -> dict[str, Any]:
    made: dict[str, Any] = {
        "kind": shape.kind,
        "points": _short(shape.points),
        "frame": shape.frame,
        "other": shape.other,
        "radius": shape.radius,
        "region": shape.region,
        "name": shape.name,
    }
    if shape.kind == "ground":
        made["strokes"] = _short(strokes(shape.points, film.spacing).reshape(-1, 4))
    return made


def _panels(observer: Observer, trace: Trace, end: float) -> list[dict[str, Any]]:
    samples, found = curves(observer, trace)
    chosen = np.flatnonzero(samples.t <= end)
    chosen = chosen[:: max(1, len(chosen) // _POINTS)]
    # A jump takes no time: the curve is broken there.
    breaks = np.flatnonzero(np.diff(samples.j[chosen])) + 1

    def broken(values: Array) -> str:
        return _packed(np.insert(values[chosen], breaks, np.nan), np.float32)

    made = []
    for panel in found:
        names = panel.names
        if not names:
            continue
        cone = None
        if panel.cone is not None:
            name, friction = panel.cone
            cone = broken(np.broadcast_to(friction * samples.columns[name], samples.t.shape))
        made.append(
            {
                "title": panel.label,
                "t": broken(samples.t),
                "names": list(names),
                "curves": [broken(samples.columns[name]) for name in names],
                "colours": list(LINES[: len(names)]),
                "cone": cone,
                "more": len(panel.left_out),
            }
        )
    return made


def _event(event: Mapping[str, Any], times: Array) -> dict[str, Any]:
    return {
        "t": event["t"],
        "instant": int(np.searchsorted(times, event["t"])),
        "what": " ".join(filter(None, (event["contact"], event["cause"]))),
        "change": change(event),
        "why": explanation({"events": [event]}),
    }


def _chart(automaton: Automaton, diagram: Diagram, samples: Samples) -> dict[str, Any]:
    """Return the drawn statechart, and which node each mode is; nothing where it is too large."""
    if len(diagram.nodes) > _NODES:
        return {"svg": "", "nodes": [""] * len(samples.modes)}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chart.svg"
        write(_bare(diagram), path)
        svg = path.read_text(encoding="utf-8")
    names = identifiers(diagram)

    def node(key: Key) -> str:
        declared = tuple(r.declared(s) for r, s in zip(automaton.regions, key, strict=True))
        return names.get(" ".join(key), names.get(" ".join(declared), ""))

    return {"svg": svg[svg.index("<svg") :], "nodes": [node(key) for key in samples.modes]}


def _bare(diagram: Diagram) -> Diagram:
    """Return a diagram without guards and conditions: events tell theirs as they are chosen."""

    def bare(chart: Chart) -> Chart:
        nodes = tuple(replace(node, invariants=()) for node in chart.nodes)
        links = tuple(replace(link, guard="", reset="") for link in chart.links)
        axes = None if chart.axes is None else (bare(chart.axes[0]), bare(chart.axes[1]))
        return replace(chart, nodes=nodes, links=links, axes=axes)

    return replace(diagram, charts=tuple(map(bare, diagram.charts)), notes=(), explained=())


def _told(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_told, value))
    return repr(value) if isinstance(value, float) else str(value)


def _short(values: Array) -> list[Any]:
    """Return numbers with as many digits as a screen has."""
    found: list[Any] = [[float(f"{x:.6g}") for x in row] for row in values.tolist()]
    return found


def _packed(values: Array | NDArray[np.integer[Any]], kind: type) -> str:
    little = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    return b64encode(little.tobytes()).decode()
