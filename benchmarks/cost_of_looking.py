"""What it costs to look at every step for what it missed: runs with the check and without, in turn.

    python benchmarks/cost_of_looking.py [MODELS]

One process, medians of repeated runs; the ratio is that of a whole run.
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
    looking = Advance._unseen
    print("| model | engine | without, ms | with, ms | ratio |\n|---|---|---|---|---|")
    for name in sys.argv[1].split(",") if len(sys.argv) > 1 else MODELS:
        for choice in CHOICES:
            runner = Runner(name, **choice)  # type: ignore[arg-type]
            runner.run(throw=False)
            times: dict[bool, list[float]] = {True: [], False: []}
            until = time.perf_counter() + _SECONDS
            while time.perf_counter() < until or len(times[True]) < 5:
                for look in (True, False):
                    Advance._unseen = looking if look else _nothing  # type: ignore[method-assign]
                    began = time.perf_counter()
                    runner.run(throw=False)
                    times[look].append(time.perf_counter() - began)
            Advance._unseen = looking  # type: ignore[method-assign]
            without, whole = (1e3 * statistics.median(times[look]) for look in (False, True))
            print(
                f"| {name} | {' '.join(map(str, choice.values()))} | {without:.3g} | {whole:.3g} "
                f"| {whole / without:.2f} |",
                flush=True,
            )


def _nothing(self: Advance, first: int, last: int, found: object) -> None:
    return None


if __name__ == "__main__":
    main()
