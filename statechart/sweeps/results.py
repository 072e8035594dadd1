"""Report of a sweep as JSON object and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart import tabular
from statechart.arrays import Array
from statechart.documents.quantities import unit_suffix
from statechart.reporting.report import json_safe
from statechart.sweeps.cells import SUCCEEDED
from statechart.sweeps.mode_sequences import shorten_alike
from statechart.sweeps.plan import Plan

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
        outputs[name] = {
            "of": "lengths" if several else "values",
            "least": float(known.min()) if known.size else None,
            "greatest": float(known.max()) if known.size else None,
            "none": int(values.size - known.size),
        }
    texts = data["sequence"].to_numpy()
    codes = Counter(data["modes"].to_numpy().ravel()[done].tolist())
    ended = Counter(outcomes[done].tolist())
    messages = data["message"].to_numpy().ravel()
    seconds = float(np.nansum(data["seconds"].to_numpy()))
    return {
        "model": plan.model.name,
        "over": {name: _range(column) for name, column in plan.columns.items()},
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
        "units": {n: unit for n in (*plan.columns, *outputs) if (unit := plan.model.unit(n))},
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


def format_text(report: dict[str, Any], digits: int = tabular.DIGITS) -> list[tabular.TextBlock]:
    """Return the report of a sweep as texts and tables."""
    units = report["units"]

    def with_unit(value: float | str, name: str) -> str:
        return f"{tabular.number(value, digits)} {unit_suffix(units.get(name, ''))}".rstrip()

    over = ", ".join(
        f"{name} ({one['values']} from {with_unit(one['least'], name)} to "
        f"{with_unit(one['greatest'], name)})"
        for name, one in report["over"].items()
    )
    done = report["done"]
    counted = tabular.pluralise(report["cells"], "cell")
    if done < report["cells"]:
        counted = f"{done} of {counted}"
    each = report["seconds"] / done if done else 0.0
    time = f"{report['seconds']:.3g} s of runs, {1e3 * each:.3g} ms each"
    head = f"{report['model']} over {over}\n{counted}, {report['certified']} certified; {time}\n"
    outcomes = [(one["outcome"], str(one["cells"]), one["example"]) for one in report["outcomes"]]
    outputs = []
    for name, one in report["outputs"].items():
        ends = (tabular.number(one[end], digits) for end in ("least", "greatest"))
        what, unit = "lengths", ""
        if one["of"] == "values":
            what, unit = "", unit_suffix(units.get(name, ""))
        outputs.append((name, what, *ends, unit, str(one["none"] or "")))
    listed = report["sequences"][:_LISTED]
    texts = shorten_alike([one["modes"] for one in listed])
    sequences = [(str(one["cells"]), text) for one, text in zip(listed, texts, strict=True)]
    rest = report["sequences"][_LISTED:]
    if rest:
        sequences.append((str(sum(one["cells"] for one in rest)), f"others ({len(rest)})"))
    heads = ("output", "", "least", "greatest", "unit", "cells without")
    parts: list[list[tabular.TextBlock]] = [
        [head],
        _without_empty_columns(("outcome", "cells", "such as"), outcomes),
        _without_empty_columns(heads, outputs),
        _without_empty_columns(("cells", "sequence of modes"), sequences),
        [f"in {report['store']}\n"] if report["store"] else [],
    ]
    return tabular.join_blocks(parts)


def _without_empty_columns(
    head: Sequence[str], rows: Sequence[Sequence[str]]
) -> list[tabular.TextBlock]:
    used_columns = [k for k in range(len(head)) if any(row[k] for row in rows)]
    columns = [[head[k], *tabular.align_numbers([row[k] for row in rows])] for k in used_columns]
    return [tabular.Table(list(zip(*columns, strict=True)), headed=True)] if rows else []


def _range(column: Array) -> dict[str, Any]:
    ends = {"least": column.min(), "greatest": column.max()}
    return {"values": len(column), **json_safe({name: float(x) for name, x in ends.items()})}
