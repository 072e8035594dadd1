"""Ahead-of-time compilation: short runs of shipped models that enter the kernels of all engines."""

from __future__ import annotations

import sys
import time
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
    """Compile all kernels; say on stderr how far that is, and at the end how long it took."""
    from statechart import Runner, sweep
    from statechart.kernels.jit import ahead_of_time

    start_time, total = time.perf_counter(), len(_RUNS) + 1
    show = compiling.StderrLine() if not quiet else None
    # The runs have one line of progress in all.
    compiling.announce(None)
    with ahead_of_time():
        for done in range(total):
            if show is not None:
                line = f"compiling {compiling.KERNELS}: part {done + 1} of {total}"
                show(compiling.KERNELS, line, False)
            if done == len(_RUNS):
                sweep("toppling_stick", {"mu": [0.2, 0.3]})
                break
            model, options = _RUNS[done]
            certify = options.get("certify", False)
            setting = {name: value for name, value in options.items() if name != "certify"}
            Runner(model, **setting).run({}, certify=certify, throw=False)
    if show is not None:
        show(compiling.KERNELS, "", True)
        seconds = time.perf_counter() - start_time
        print(f"compiled {compiling.KERNELS} in {seconds:.0f} s", file=sys.stderr)
