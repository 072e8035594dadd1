"""Cost of first runs: whole processes of the command line with empty caches, and warm ones.

Times are CPU seconds of the process and its children, which a busy machine changes less than wall
time. Cold: numba and heyoka begin with empty caches for every line. In turn: the models one after
the other from one empty cache, as after an installation; what they have in common is compiled by
the first that needs it. Warm: the same once more, the median of repeats.

    python benchmarks/cold_start.py [--verbs run ...] [--models toppling_stick ...] [--in-turn]
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

MODELS = tuple(sorted(path.stem for path in (Path(__file__).parents[1] / "models").glob("*.yaml")))
VERBS = {
    "validate": ("validate",),
    "run": ("run",),
    "certify": ("run", "--certify"),
    "modes": ("modes",),
    "draw": ("draw", "-o", "{folder}/chart.svg"),
}

_NO_BYTECODE = "PYTHONDONTWRITEBYTECODE"


def seconds(verb: str, model: str, folder: str) -> float:
    """Return the CPU seconds of a process whose caches are in a folder."""
    name, *options = VERBS[verb]
    command = [sys.executable, "-m", "statechart.cli.main", name, model]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    # That a run ends before its time, or cannot be certified, is no failure here.
    subprocess.run(
        [*command, *(option.format(folder=folder) for option in options)],
        # As after an installation: Python's byte code is cached, too.
        env={
            **{name: value for name, value in os.environ.items() if name != _NO_BYTECODE},
            "NUMBA_CACHE_DIR": f"{folder}/numba",
            "HEYOKA_CACHE_DIR": f"{folder}/heyoka",
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def table(verbs: Sequence[str], models: Sequence[str], repeats: int, alone: bool) -> None:
    """Print a line for each model and verb, and the sums."""
    print(f"{'':24}{'':10}{'cold':>8}{'in turn':>9}{'warm':>8}")
    sums = [0.0, 0.0, 0.0]
    with tempfile.TemporaryDirectory() as together:
        for model in models:
            for verb in verbs:
                with tempfile.TemporaryDirectory() as empty:
                    cold = seconds(verb, model, empty) if alone else math.nan
                turn = seconds(verb, model, together)
                warm = statistics.median(seconds(verb, model, together) for _ in range(repeats))
                print(f"{model:24}{verb:10}{cold:8.1f}{turn:9.1f}{warm:8.2f}", flush=True)
                sums = [total + new for total, new in zip(sums, (cold, turn, warm), strict=True)]
    print(f"{'all':34}{sums[0]:8.1f}{sums[1]:9.1f}{sums[2]:8.2f}")


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--verbs", nargs="+", choices=VERBS, default=["run"])
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--in-turn", action="store_true", help="no line with empty caches alone")
    chosen = parser.parse_args()
    table(chosen.verbs, chosen.models, chosen.repeats, not chosen.in_turn)


if __name__ == "__main__":
    main()
