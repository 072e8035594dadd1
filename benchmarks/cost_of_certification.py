"""Cost of checking every step for missed events, and of proving that none was missed.

    python benchmarks/cost_of_certification.py [MODELS]

Runs without the check, with it, and certified, in turn in one process; medians. A certified run is
a second one, with the defects enclosed and every event made again from displaced states.
"""

from __future__ import annotations

import statistics
import sys
import time

from statechart import Runner
from statechart.execution.flow import Advance

MODELS = (
    *("toppling_stick", "bouncing_ball_hills", "rimless_wheel", "compass_walker", "woodpecker"),
    *("simplest_walker", "hopper", "rocking_block"),
)
CHOICES: tuple[dict[str, object], ...] = (
    {"engine": "taylor"},
    {"engine": "scipy", "method": "DOP853", "tolerance": 1e-9},
)
_SECONDS = 2.0


def main() -> None:
    """Print a table."""
    looking = Advance._find_missed
    print(
        "| model | engine | without, ms | with, ms | ratio | certified, ms | in runs |\n"
        "|---|---|---|---|---|---|---|"
    )
    for name in sys.argv[1].split(",") if len(sys.argv) > 1 else MODELS:
        for choice in CHOICES:
            runner = Runner(name, **choice)  # type: ignore[arg-type]
            runner.run(certify=True, throw=False)
            times: dict[str, list[float]] = {"without": [], "with": [], "certified": []}
            until = time.perf_counter() + _SECONDS
            while time.perf_counter() < until or len(times["with"]) < 5:
                for how, taken in times.items():
                    Advance._find_missed = _nothing if how == "without" else looking  # type: ignore[method-assign]
                    began = time.perf_counter()
                    runner.run(certify=how == "certified", throw=False)
                    taken.append(time.perf_counter() - began)
            Advance._find_missed = looking  # type: ignore[method-assign]
            without, whole, proved = (1e3 * statistics.median(taken) for taken in times.values())
            print(
                f"| {name} | {' '.join(map(str, choice.values()))} | {without:.3g} | {whole:.3g} "
                f"| {whole / without:.2f} | {proved:.3g} | {proved / whole:.1f} |",
                flush=True,
            )


def _nothing(self: Advance, first: int, last: int, found: object) -> None:
    return None


if __name__ == "__main__":
    main()
