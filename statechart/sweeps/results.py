"""Report of a sweep as JSON object and as text."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.documents.quantities import unit_suffix
from statechart.sweeps.cells import SUCCEEDED
from statechart.sweeps.mode_sequences import shorten_alike
from statechart.sweeps.plan import Plan
from statechart.tabular import (
    DIGITS,
    Table,
    TextBlock,
    align_numbers,
    join_blocks,
    number,
    pluralise,
)

if TYPE_CHECKING:  # importing xarray takes half a second
    import xarray as xr

_LISTED = 12  # sequences of modes


def to_dict(plan: Plan, data: xr.Dataset, *, where: str | None) -> dict[str, Any]:
    """Return the report of a sweep as a JSON object."""
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
                "least": _plain_value(column.min()),
                "greatest": _plain_value(column.max()),
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
                "succeeded": outcome in SUCCEEDED,
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
    """Return whether all cells are done and some reached a declared end."""
    return report["done"] == report["cells"] and any(o["succeeded"] for o in report["outcomes"])


def format_text(report: dict[str, Any], digits: int = DIGITS) -> list[TextBlock]:
    """Return the report of a sweep as texts and tables."""
    units = report["units"]

    def with_unit(value: float | str, name: str) -> str:
        return f"{number(value, digits)} {unit_suffix(units.get(name, ''))}".rstrip()

    over = ", ".join(
        f"{name} ({one['values']} from {with_unit(one['least'], name)} to "
        f"{with_unit(one['greatest'], name)})"
        for name, one in report["over"].items()
    )
    done = report["done"]
    counted = pluralise(report["cells"], "cell")
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
            number(one["least"], digits),
            number(one["greatest"], digits),
            unit_suffix(units.get(name, "")) if one["of"] == "values" else "",
            str(one["none"] or ""),
        )
        for name, one in report["outputs"].items()
    ]
    listed = report["sequences"][:_LISTED]
    texts = shorten_alike([one["modes"] for one in listed])
    sequences = [(str(one["cells"]), text) for one, text in zip(listed, texts, strict=True)]
    rest = report["sequences"][_LISTED:]
    if rest:
        sequences.append((str(sum(one["cells"] for one in rest)), f"others ({len(rest)})"))
    return join_blocks(
        [
            [head],
            _without_empty_columns(("outcome", "cells", "such as"), outcomes),
            _without_empty_columns(
                ("output", "", "least", "greatest", "unit", "cells without"), outputs
            ),
            _without_empty_columns(("cells", "sequence of modes"), sequences),
            [f"in {report['store']}\n"] if report["store"] else [],
        ]
    )


def _without_empty_columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[TextBlock]:
    """Return a table without empty columns."""
    used_columns = [k for k in range(len(head)) if any(row[k] for row in rows)]
    columns = [[head[k], *align_numbers([row[k] for row in rows])] for k in used_columns]
    return [Table(list(zip(*columns, strict=True)), headed=True)] if rows else []


def _plain_value(value: float) -> float | str:
    return float(value) if math.isfinite(value) else str(float(value))
