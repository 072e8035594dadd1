"""Ten thousand pairs of balls that hit the floor together or a rounding apart: is any impact lost?

Counts runs in which a ball missed its impact, was counted twice, or was not thrown up; and how
many pairs were hit in one jump.

    python benchmarks/two_balls.py [--runs N] [--engine taylor|scipy]
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

from runs import outputs, run

_G, _RADIUS = 9.81, 0.1
# Identical, and so much apart relatively: around a rounding, around the tolerances, well apart.
_APART = (0.0, 0.0, 1e-16, 1e-15, 1e-14, 1e-13, 1e-12, 1e-11, 1e-9)


def pairs(count: int, engine: str, seed: int) -> Counter[str]:
    """Return how the runs went."""
    random = np.random.default_rng(seed)
    found: Counter[str] = Counter()
    for n in range(count):
        height = float(random.uniform(0.5, 2.0))
        other = height * (1.0 + float(random.choice((-1.0, 1.0))) * _APART[n % len(_APART)])
        first = math.sqrt(2.0 * (height - _RADIUS) / _G)
        trace = run("two_balls", engine, until=1.5 * first, h1=height, h2=other)
        seen = outputs("two_balls", engine, trace)
        counts = seen["impacts1"], seen["impacts2"]
        found["lost"] += min(counts) < 1
        found["counted twice"] += max(counts) > 1
        found["not thrown up"] += bool((trace.final[[5, 7]] <= 0.0).any())
        found["ended early"] += not trace.outcome.succeeded
        found["not certified"] += not trace.certified
        found["in one jump"] += len(trace.jumps) == 1
    return found


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--engine", choices=["taylor", "scipy"], default="taylor")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    began = time.perf_counter()
    found = pairs(chosen.runs, chosen.engine, chosen.seed)
    print(f"{chosen.runs} pairs on {chosen.engine}, {time.perf_counter() - began:.0f} s")
    for name, number in found.items():
        print(f"  {name:16} {number}")


if __name__ == "__main__":
    main()
