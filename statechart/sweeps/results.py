"""Results of a sweep: as one plain object, in words, as a file, as a picture."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.automaton.trace import Outcome
from statechart.documents.files import made, obstacle, write_atomic
from statechart.documents.quantities import beside
from statechart.errors import DeclarationError
from statechart.reporting.figure import SUFFIXES, render
from statechart.reporting.pieces import Pieces
from statechart.reporting.tables import netcdf
from statechart.sweeps.figure import check_drawable, figure
from statechart.sweeps.plan import Plan
from statechart.tabular import Block, Table, apart, several

if TYPE_CHECKING:  # imported where a sweep is made: it takes half a second
    import xarray as xr

_STORE, _FILE = ".zarr", ".nc"
# Sequences of modes that are listed in words.
_LISTED = 12
_SUCCEEDED = frozenset(outcome.name for outcome in Outcome if outcome.succeeded)


def to_dict(plan: Plan, data: xr.Dataset, *, where: str | None) -> dict[str, Any]:
    """Return a sweep as one plain object."""
    outcomes = data["outcome"].to_numpy().ravel().astype(object)
    done = outcomes != ""
    outputs: dict[str, Any] = {}
    for name, variable in plan.variables.items():
        several = name in plan.lists
        values = data[f"{variable}_count" if several else variable].to_numpy().ravel()[done]
        known = values[np.isfinite(values)]
        ends = (float(known.min()), float(known.max())) if known.size else (None, None)
        outputs[name] = {
            "of": "lengths" if several else "values",
            "least": ends[0],
            "greatest": ends[1],
            "none": int(values.size - known.size),
        }
    texts = data["sequence"].to_numpy()
    codes = Counter(data["modes"].to_numpy().ravel()[done].tolist())
    ended = Counter(outcomes[done].tolist())
    messages = data["message"].to_numpy().ravel()
    seconds = float(np.nansum(data["seconds"].to_numpy()))
    return {
        "model": plan.model.name,
        "over": {
            name: {
                "values": len(column),
                "least": _plain(column.min()),
                "greatest": _plain(column.max()),
            }
            for name, column in plan.columns.items()
        },
        "grid": plan.grid,
        "cells": plan.size,
        "done": int(np.count_nonzero(done)),
        "ended": data.attrs.get("ended", ""),
        "outcomes": [
            {
                "outcome": outcome,
                "cells": count,
                "succeeded": outcome in _SUCCEEDED,
                "example": str(messages[outcomes == outcome][0]),
            }
            for outcome, count in ended.most_common()
        ],
        "certified": int(np.count_nonzero(data["certified"].to_numpy())),
        "outputs": outputs,
        "units": {
            name: unit for name in (*plan.columns, *outputs) if (unit := plan.model.unit(name))
        },
        "sequences": [
            {"modes": str(texts[code]), "cells": count}
            for code, count in codes.most_common()
            if code >= 0
        ],
        "seconds": seconds,
        "store": where,
    }


def succeeded(report: dict[str, Any]) -> bool:
    """Whether all cells are done, and some came to an end that the declaration names."""
    return report["done"] == report["cells"] and any(o["succeeded"] for o in report["outcomes"])


def format_text(report: dict[str, Any]) -> list[Block]:
    """Return the report of a sweep in words and tables."""
    over = ", ".join(
        f"{name} ({one['values']} from {_with(one['least'], report, name)} to "
        f"{_with(one['greatest'], report, name)})"
        for name, one in report["over"].items()
    )
    done = report["done"]
    counted = several(report["cells"], "cell")
    if done < report["cells"]:
        counted = f"{done} of {counted}"
    each = report["seconds"] / done if done else 0.0
    head = (
        f"{report['model']} over {over}\n"
        f"{counted}, {report['certified']} certified; "
        f"{report['seconds']:.3g} s of runs, {1e3 * each:.3g} ms each\n"
    )
    outcomes = [(one["outcome"], str(one["cells"]), one["example"]) for one in report["outcomes"]]
    outputs = [
        (
            name,
            "" if one["of"] == "values" else "lengths",
            _number(one["least"]),
            _number(one["greatest"]),
            beside(report["units"].get(name, "")) if one["of"] == "values" else "",
            str(one["none"] or ""),
        )
        for name, one in report["outputs"].items()
    ]
    sequences = [(str(one["cells"]), one["modes"]) for one in report["sequences"][:_LISTED]]
    rest = report["sequences"][_LISTED:]
    if rest:
        sequences.append((str(sum(one["cells"] for one in rest)), f"others ({len(rest)})"))
    return apart(
        [
            [head],
            _listed(("outcome", "cells", "such as"), outcomes),
            _listed(("output", "", "least", "greatest", "unit", "cells without"), outputs),
            _listed(("cells", "sequence of modes"), sequences),
            [f"in {report['store']}\n"] if report["store"] else [],
        ]
    )


def _listed(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[Block]:
    """Return a table without the columns that say nothing."""
    said = [k for k in range(len(head)) if any(row[k] for row in rows)]
    return [Table([[row[k] for k in said] for row in (head, *rows)], headed=True)] if rows else []


def _with(value: float | str, report: dict[str, Any], name: str) -> str:
    """Return a value with its unit."""
    return f"{_number(value)} {beside(report['units'].get(name, ''))}".rstrip()


def _number(value: float | str | None) -> str:
    return value if isinstance(value, str) else "none" if value is None else f"{value:.6g}"


def _plain(value: float) -> float | str:
    """Return a number that JSON has, else its name."""
    return float(value) if math.isfinite(value) else str(float(value))


@dataclass(frozen=True)
class Target:
    """Files of a sweep: a store or NetCDF file, and a picture; a store that exists may go on."""

    output: str | None
    plot: str | None
    resume: bool

    @property
    def store(self) -> str | None:
        """The store, to which blocks are written as they are done."""
        output = self.output
        return output if output is not None and Path(output).suffix == _STORE else None

    def check(self, plan: Plan) -> None:
        """Raise `DeclarationError` where a file cannot be written."""
        output, plot = self.output, self.plot
        if output is not None:
            if Path(output).suffix not in (_STORE, _FILE):
                raise DeclarationError(
                    f"-o {output}: the suffix must be {_STORE} or {_FILE}",
                    advice="a store that a sweep can go on with, or one file of NetCDF",
                )
            if self.store is None and os.path.lexists(output):
                raise DeclarationError(
                    f"{output} exists already", advice="name another, or remove it"
                )
            _check_place("-o", output)
        if self.resume and self.store is None:
            raise DeclarationError(
                "--resume goes on with a store", advice=f"name it: -o STORE{_STORE}"
            )
        if plot is not None:
            if Path(plot).suffix.lower() not in SUFFIXES:
                raise DeclarationError(
                    f"--plot {plot}: the suffix must be one of {', '.join(SUFFIXES)}"
                )
            if Path(plot).is_dir():
                raise DeclarationError(f"--plot {plot}: it is a folder", advice="name a file")
            _check_place("--plot", plot)
            check_drawable(plan)

    def write(self, plan: Plan, data: xr.Dataset, pieces: Pieces) -> None:
        """Write the file and the picture; what cannot be written is left out, and noted."""
        if self.output is not None and self.store is None:
            path = Path(self.output)
            pieces.keep(str(path), lambda _: _write(path, netcdf(data)), None)
        if self.plot is not None:
            pieces.attempt(self.plot, partial(_draw, Path(self.plot), plan, data), None)


def _check_place(option: str, name: str) -> None:
    if why := obstacle(Path(name).absolute().parent):
        raise DeclarationError(f"{option} {name}: {why}", advice="name another place")


def _write(path: Path, content: bytes) -> None:
    with made(path.parent):
        write_atomic(path, content)


def _draw(path: Path, plan: Plan, data: xr.Dataset) -> None:
    _write(path, render(figure(plan, data), path.suffix.lower().lstrip(".")))
