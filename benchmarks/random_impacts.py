"""A million random frictional impacts, ten thousand at several contacts, and LCPs of stacks.

Counts what raised energy, left its cone or separated negatively; what was not solved is listed.

    python benchmarks/random_impacts.py [--single N] [--several N] [--problems N]
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "solvers"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "impacts"))

from complementarity import impact_problem
from test_complementarity import stack
from test_simultaneous import body, check, in_grooves, law, random_scene

from contacts.impacts.impact import impact
from contacts.impacts.simultaneous import impacts
from contacts.solvers.step_impulses import coordinate_impulses
from statechart.errors import NoConsistentMode


def single(count: int, seed: int) -> Counter[str]:
    """Impacts at one contact: inertia ratios and mu over 24 decades, Stronge's law."""
    random = np.random.default_rng(seed)
    found: Counter[str] = Counter()
    for _ in range(count):
        angle = random.uniform(-math.pi, math.pi)
        inertia = 10.0 ** random.uniform(-12, 12)
        mu = 10.0 ** random.uniform(-12, 12)
        snapshot = body([(math.sin(angle), -math.cos(angle))], random.normal(size=3), inertia)
        contact = snapshot.contacts[0]
        if contact.gap_rate >= 0.0:
            snapshot = body([(math.sin(angle), -math.cos(angle))], -snapshot.velocity, inertia)
            contact = snapshot.contacts[0]
        e = random.choice([0.0, 1.0, random.uniform()])
        try:
            result = impact(snapshot, 0, law(mu), e)
        except NoConsistentMode as error:
            found[str(error)[:60]] += 1
            continue
        v, w = snapshot.velocity, result.velocity
        before, after = (0.5 * x @ snapshot.mass @ x for x in (v, w))
        terms = np.abs(snapshot.jacobians[0, 0]) @ (np.abs(w - v) + np.abs(v))
        found["raises energy"] += after > before * (1 + 1e-12)
        found["leaves the cone"] += abs(result.tangential) > mu * result.normal * (1 + 1e-12)
        found["separates negatively"] += snapshot.jacobians[0, 0] @ w < -1e-12 * terms
    return found


def grooves(count: int, seed: int) -> Counter[str]:
    """The same, and further contacts at the places of some, with surfaces of other directions."""
    return several(count, seed, grooved=True)


def several(count: int, seed: int, *, grooved: bool = False) -> Counter[str]:
    """Impacts at two to six contacts of one to three bodies, some contacts declared twice."""
    random = np.random.default_rng(seed)
    found: Counter[str] = Counter()
    for _ in range(count):
        snapshot, laws = random_scene(random)
        if grooved:
            snapshot, laws = in_grooves(random, snapshot, laws)
        for choice in ("plastic", "capped"):
            try:
                result = impacts(snapshot, laws, [True] * len(laws), choice)
                check(snapshot, laws, result)
            except NoConsistentMode:
                found["no impulse found"] += 1
            except AssertionError as error:
                found[str(error).splitlines()[0]] += 1
            else:
                found["right"] += 1
    return found


def problems(count: int, seed: int) -> Counter[str]:
    """Complementarity problems of stacked blocks."""
    random = np.random.default_rng(seed)
    found: Counter[str] = Counter()
    for k in range(count):
        masses, decades = ((0, 1), (3, 1), (0, 12))[k % 3]
        delassus, free, edges = stack(random, masses, decades)
        nothing, none = np.zeros_like(free), np.zeros(len(edges), np.bool_)
        rows, island = impact_problem(delassus, free, free, nothing, edges, none)
        solved = coordinate_impulses(rows, island, 1e-9)[0] <= 1e-9
        found["solved" if solved else f"unsolved, masses 1e+-{masses}, mu 1e+-{decades}"] += 1
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--single", type=int, default=1_000_000)
    parser.add_argument("--several", type=int, default=10_000)
    parser.add_argument("--problems", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for run, count in (
        (single, options.single),
        (several, options.several),
        (grooves, options.several),
        (problems, options.problems),
    ):
        start = time.perf_counter()
        found = run(count, options.seed)
        each = (time.perf_counter() - start) / max(count, 1)
        print(f"{run.__name__}: {count}, {1e6 * each:.0f} us each")
        for name, times in sorted(found.items()):
            print(f"  {name}: {times}")


if __name__ == "__main__":
    main()
