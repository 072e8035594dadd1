"""Rimless wheel and compass walker for 20 s of motion: time once compiled, and error.

The error is that of the times of all impacts and of the last state, relative to each variable's
largest value, against the reference: Taylor's method at 2.2e-16, whose own error shows in its
difference from SciPy's DOP853 at 1e-13. Every step of a walker damps what went wrong before.

    python benchmarks/walkers.py [--seconds S]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from runs import automaton

from statechart.automaton.trace import Trace
from statechart.engines.engine import Engine
from statechart.engines.scipy import SciPy
from statechart.engines.taylor import Taylor
from statechart.execution.simulator import Simulator

_REPEATS = 3


def timed(model: str, engine: Engine, seconds: float) -> tuple[Trace, float]:
    """Return a run and the shortest time it took, modes compiled before."""
    simulator = Simulator(automaton(model), engine)
    trace = simulator.run(until=seconds)
    best = float("inf")
    for _ in range(_REPEATS):
        began = time.perf_counter()
        simulator.run(until=seconds)
        best = min(best, time.perf_counter() - began)
    return trace, best


def error(trace: Trace, reference: Trace) -> float:
    """Return the largest relative difference; inf where the modes are not the same."""
    if trace.modes != reference.modes:
        return float("inf")
    times, expected = (np.array([jump.t for jump in one.jumps]) for one in (trace, reference))
    sizes = np.max([np.abs(a.coefficients[:, :, 0]).max(axis=0) for a in reference.arcs], axis=0)
    state = np.abs(trace.final - reference.final) / np.maximum(sizes, 1e-300)
    return float(max(np.abs(times / expected - 1.0).max(), state.max()))


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description="Walkers: time and error.")
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    engines: list[Engine] = [Taylor(2.2e-16), Taylor(1e-12), Taylor(1e-9)]
    engines += [SciPy(tolerance) for tolerance in (1e-13, 1e-10, 1e-7)]
    for model in ("rimless_wheel", "compass_walker"):
        reference: Trace | None = None
        for engine in engines:
            trace, took = timed(model, engine, seconds)
            reference = reference or trace
            print(
                f"{model:15} {engine.name:7} {engine.tolerance:7.0e} {took * 1e3:8.1f} ms "
                f"{trace.counts['steps']:6} steps {len(trace.jumps):4} jumps "
                f"error {error(trace, reference):.1e}"
            )


if __name__ == "__main__":
    main()
