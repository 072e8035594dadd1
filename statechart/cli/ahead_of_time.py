"""Ahead-of-time compilation: short runs of shipped models that enter the kernels of all engines."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from statechart import compiling

_RUNS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("toppling_stick", {"engine": "taylor"}),
    ("toppling_stick", {"engine": "taylor", "certify": True}),
    ("toppling_stick", {"engine": "scipy"}),
    ("toppling_stick", {"engine": "impulse", "step": 1e-3}),
    ("bouncing_ball_chart", {}),
    ("ball_in_a_bowl", {}),
    ("newtons_cradle", {}),
    ("compass_walker", {}),
    ("woodpecker", {"engine": "impulse", "step": 1e-3}),
    ("dice", {}),
    ("silo", {}),
    ("jacks", {}),
    ("arch", {}),
)
"""Models and settings; together they enter points, rims, shapes, joints, controllers and charts."""


def compile_kernels(*, quiet: bool) -> None:
    """Compile all kernels, with a progress line and the total time on stderr."""
    from statechart import run, sweep
    from statechart.kernels.jit import ahead_of_time

    start_time = time.perf_counter()
    parts: list[Callable[[], object]] = [
        partial(run, model, throw=False, **options) for model, options in _RUNS
    ]
    parts.append(partial(sweep, "toppling_stick", {"mu": [0.2, 0.3]}))
    show = compiling.StderrLine() if not quiet else None
    # The runs have one line of progress in all.
    compiling.announce(None)
    with ahead_of_time():
        for number, part in enumerate(parts, 1):
            if show is not None:
                line = f"compiling {compiling.KERNELS}: part {number} of {len(parts)}"
                show(compiling.KERNELS, line, False)
            part()
    if show is not None:
        show(compiling.KERNELS, "", True)
        seconds = time.perf_counter() - start_time
        print(f"compiled {compiling.KERNELS} in {seconds:.0f} s", file=sys.stderr)
