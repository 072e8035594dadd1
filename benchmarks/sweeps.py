"""Cost of sweeps: runs a second, the time of a map, and the gain by a second process.

    python benchmarks/sweeps.py

The toppling stick over friction and moment of inertia, in the ranges of the paper's figure 10,
certified, with all its outputs. Rates are medians over blocks in one process; what a sweep adds to
its runs (rows, arrays, the store) stands beside them. The load of the machine says what they are
worth: on a busy one two processes cannot be twice as fast as one.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from statechart import Runner, sweep
from statechart.documents.setting import Setting
from statechart.sweeps.cells import run_block
from statechart.sweeps.plan import Plan
from statechart.sweeps.workers import processes

MODEL = "toppling_stick"
BLOCK, REPEATS = 1000, 5


def grid(count: int) -> dict[str, np.ndarray]:
    return {"mu": np.geomspace(0.03, 100.0, count), "I_G": np.geomspace(1e-4, 1.0, count)}


def parameter_table() -> np.ndarray:
    # Of all the map, in an order without pattern.
    table = np.stack(np.meshgrid(*grid(100).values(), indexing="ij"), axis=-1).reshape(-1, 2)
    return np.random.default_rng(0).permutation(table)[: BLOCK * REPEATS]


def in_one_process() -> None:
    plan = Plan(Runner(MODEL).model, Setting(), grid(2))
    table = parameter_table().reshape(REPEATS, BLOCK, 2)
    run_block(plan.task, table[0])
    runner = Runner(MODEL)
    runner.run({"mu": 0.2})
    blocks, runs = [], []
    for part in table:
        began = time.perf_counter()
        found = run_block(plan.task, part)
        blocks.append(time.perf_counter() - began)
        assert found.certified.all()
        values = [{"mu": mu, "I_G": inertia} for mu, inertia in part.tolist()]
        began = time.perf_counter()
        for overrides in values:
            result = runner.run(overrides, throw=False)
            _ = result.outputs, result.trace.modes
        runs.append(time.perf_counter() - began)
    block, run = (statistics.median(times) / BLOCK for times in (blocks, runs))
    print(f"runs/s of one core, certified, with outputs  {1.0 / block:10.0f}")
    print(f"a cell, us                                   {1e6 * block:10.0f}")
    print(f"a run of Runner with outputs and modes, us   {1e6 * run:10.0f}")


def used() -> tuple[int, float]:
    """Return which process this is, and the seconds that it has computed."""
    time.sleep(0.05)  # so that every process gets one
    return os.getpid(), time.process_time()


def computed(executor: Executor) -> float:
    """Return the seconds that all processes have computed."""
    found = [executor.submit(used) for _ in range(8)]
    return sum(dict(sorted(future.result() for future in found)).values())


def arithmetic() -> float:
    """Return the sum of many numbers, which takes no memory."""
    total = 0.0
    for k in range(6_000_000):
        total += 0.5 * k
    return total


def speedup_of_two_processes(executor: Executor) -> float:
    """Return how many times as much two processes do as one, as the machine is."""
    taken = []
    for count in (1, 2):
        began = time.perf_counter()
        for future in [executor.submit(arithmetic) for _ in range(count)]:
            future.result()
        taken.append(time.perf_counter() - began)
    return 2.0 * taken[0] / taken[1]


def maps(count: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        # What a process imports and compiles once is no part of a map.
        sweep(MODEL, grid(20), store=Path(folder) / "first.zarr")
        began, busy = time.perf_counter(), time.process_time()
        sweep(MODEL, grid(count), store=Path(folder) / "one.zarr")
        one, alone = time.perf_counter() - began, time.process_time() - busy
        with processes(2) as executor:
            sweep(MODEL, grid(20), executor=executor)
            before = computed(executor)
            began, busy = time.perf_counter(), time.process_time()
            sweep(MODEL, grid(count), store=Path(folder) / "two.zarr", executor=executor)
            two, here = time.perf_counter() - began, time.process_time() - busy
            there = computed(executor) - before
            most = speedup_of_two_processes(executor)
    print(f"figure 10 at {count} x {count}, to a store, s        {one:10.2f}")
    print(f"the same by two processes, s                 {two:10.2f}")
    print(f"two processes against one                    {one / two:10.2f}")
    print(f"  two processes that add numbers             {most:10.2f}")
    # What others take of the machine is in the times above, not in these.
    print(f"seconds computed: alone                      {alone:10.2f}")
    print(f"  by two processes together                  {there:10.2f}")
    print(f"  by the one that hands out and writes       {here:10.2f}")
    print(f"two against one on two cores of their own    {2.0 * alone / (there + here):10.2f}")


def main() -> int:
    print(f"load of the machine before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores")
    in_one_process()
    for count in (100, 200):
        maps(count)
    print(f"load of the machine after: {os.getloadavg()[0]:.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
