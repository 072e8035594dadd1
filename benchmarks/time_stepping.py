"""Time stepping measured: dice against real time, and random contact problems of steps.

python benchmarks/time_stepping.py [--problems 100000] [--seed 0]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path

import numpy as np

from contacts.solvers.step_impulses import coordinate_impulses
from statechart.running.runner import Runner

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "solvers"))


def dice(count: int) -> None:
    runner = Runner("dice")
    trace = runner.run({"n": count}).trace
    taken = []
    for _ in range(5):
        began = time.perf_counter()
        runner.run({"n": count})
        taken.append(time.perf_counter() - began)
    deepest = -min((trace.margins or {}).values())
    print(
        f"{count} dice, {trace.t_end:g} s of motion at h = {trace.step:g}: "
        f"{statistics.median(taken):.3f} s; overlap {deepest:.2e}, "
        f"h times the fastest approach {trace.tolerances['gap']:.2e}"
    )


def problems(count: int, seed: int) -> None:
    from complementarity import impact_problem
    from test_step_problems import random_problem

    generator = np.random.default_rng(seed)
    inexact, began = 0, time.perf_counter()
    for _ in range(count):
        contacts = int(generator.integers(1, 9))
        bodies = int(generator.integers(1, 5))
        delassus, free, cones = random_problem(generator, contacts, bodies, friction=True)
        nothing, none = np.zeros((contacts, 2)), np.zeros(contacts, np.bool_)
        rows, island = impact_problem(delassus, free, free, nothing, cones, none)
        inexact += coordinate_impulses(rows, island, 1e-9)[0] > 1e-9
    taken = time.perf_counter() - began
    print(f"{count} problems in {taken:.1f} s: {inexact} inexact; each solution verified")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    dice(10)
    problems(chosen.problems, chosen.seed)
