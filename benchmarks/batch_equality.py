"""Cells of a sweep that go through one compiled call, against a run each: bits and time.

    python benchmarks/batch_equality.py [--cells N] [--seed S] [NAME ...]

Every shipped model that sweeps, and every scene of `hostile_scenes.py`, over its ranges: how many
cells went through together, what a cell takes so and alone (medians, microseconds), and which of
its results differ in a bit. None may.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from hostile_scenes import SCENES, subject

from statechart import load
from statechart.arrays import Array
from statechart.documents.declaration import Declaration
from statechart.documents.setting import Setting
from statechart.execution import compiled_loop
from statechart.sweeps import cells as sweep_cells
from statechart.sweeps.cells import CellBlock, run_block
from statechart.sweeps.plan import Plan

MODELS = Path(__file__).parents[1] / "models"


def models() -> Iterator[tuple[str, Declaration]]:
    for path in sorted(MODELS.glob("*.yaml")):
        model = load(path)
        whole = model.whole.intersection(model.ranges)
        if model.ranges and model.settings.engine != "impulse" and not whole:
            yield path.stem, model
    for name in SCENES:
        yield name, subject(name).model


def cells(model: Declaration, count: int, seed: int) -> Array:
    """Return values within the ranges of a model, some of them at both ends."""
    random = np.random.default_rng(seed)
    bounds = np.array([[float(end) for end in ends] for ends in model.ranges.values()])
    table = random.uniform(bounds[:, 0], bounds[:, 1], (count, len(bounds)))
    edge = random.uniform(size=table.shape) < 0.05
    ends = np.where(random.uniform(size=table.shape) < 0.5, bounds[:, 0], bounds[:, 1])
    return np.where(edge, ends, table)


def differing(one: CellBlock, other: CellBlock) -> list[str]:
    """Return what differs in a bit."""
    found = [
        part
        for part in ("outcome", "message", "certified")
        if not np.array_equal(getattr(one, part), getattr(other, part))
    ]
    found += [
        name
        for name, values in {**one.numbers, "t_end": one.t_end}.items()
        if not np.array_equal(values, {**other.numbers, "t_end": other.t_end}[name], equal_nan=True)
    ]
    for name, rows in one.lists.items():
        pairs = zip(rows, other.lists[name], strict=True)
        if not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs):
            found.append(name)
    if sequences(one) != sequences(other):
        found.append("modes")
    return found


def sequences(found: CellBlock) -> list[str]:
    names = list(found.sequences)
    return [names[code] if code >= 0 else "" for code in found.modes.tolist()]


def compared(model: Declaration, table: Array) -> tuple[int, float, float, list[str]]:
    """Return cells that went through, the times of a cell, together and alone, what differs."""
    plan = Plan(model, Setting(), dict(zip(model.ranges, table.T, strict=True)), grid=False)
    run_block(plan.task, table)  # modes are made known
    found = run_block(plan.task, table)
    through = sum(one.through for one in sweep_cells._cells(plan.task)._structures.values())
    kept, sweep_cells._MAX_BATCH = sweep_cells._MAX_BATCH, 1
    alone = run_block(plan.task, table)
    sweep_cells._MAX_BATCH = kept
    return (
        through,
        1e6 * float(np.median(found.seconds)),
        1e6 * float(np.median(alone.seconds)),
        differing(found, alone),
    )


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("names", nargs="*")
    asked = parser.parse_args()
    compiled_loop._WORTH_COMPILING = -1  # whatever lies compiled on disk
    bad = 0
    print(f"{f'of {2 * asked.cells}':>41} {'us':>9} {'alone':>9}  differs")
    for name, model in models():
        if asked.names and name not in asked.names:
            continue
        table = cells(model, asked.cells, asked.seed)
        through, one, alone, found = compared(model, table)
        print(f"{name:34} {through:6} {one:9.0f} {alone:9.0f}  {', '.join(found)}", flush=True)
        bad += bool(found)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
