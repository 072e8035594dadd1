"""A million steps of a rod on a pivot: how far do the joint and the energy drift?

The rod is a free body (x, y, angle) held by a joint, so that its constraint is solved as an
acceleration and kept by projection. It swings far above its pivot on both sides. Runs of ten
thousand steps follow one another, each from where the last one ended.

    python benchmarks/pinned_rod.py [--steps N] [--engine taylor|scipy]
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.engines.engine import Engine
from statechart.engines.scipy import SciPy
from statechart.engines.taylor import Taylor
from statechart.execution.simulator import Simulator

ROD = """\
kind: scene
name: pinned_rod
parameters: {x: sin(2.5), y: -cos(2.5), angle: 2.5, dx: 0, dy: 0, dangle: 0}
gravity: 1
bodies:
  rod:
    mass: 1
    inertia: 1/3
    start: {x: x, y: y, angle: angle, dx: dx, dy: dy, dangle: dangle}
joints:
  pivot: {point: {body: rod, at: [0, 1]}, to: [0, 0]}
"""
_NAMES = ("x", "y", "angle", "dx", "dy", "dangle")
_STEPS_A_RUN = 10_000


def drift(engine: Engine, steps: int) -> tuple[int, float, float]:
    """Return the steps made, and the largest errors of the joint and of the energy at their ends.

    Parameters
    ----------
    engine : Engine
        How to integrate.
    steps : int
        At least so many.
    """
    simulator = Simulator(automaton(validate(read_text(ROD), Scene)), engine)
    start: dict[str, float] = {}
    made, apart, energy = 0, 0.0, 0.0
    # The first run shows how long steps are.
    until = 10.0
    while made < steps:
        trace = simulator.run(start, until=until)
        ends = np.concatenate([arc.coefficients.sum(axis=2) for arc in trace.arcs])
        x, y, angle, dx, dy, spin = ends.T
        apart = max(apart, float(np.hypot(x - np.sin(angle), y + np.cos(angle)).max()))
        now = 0.5 * (dx**2 + dy**2 + spin**2 / 3) + y
        energy = max(energy, float(np.abs(now + math.cos(2.5)).max()))
        made += len(ends)
        until = min(_STEPS_A_RUN, max(steps - made, 1)) * trace.t_end / len(ends)
        start = dict(zip(_NAMES, trace.final.tolist(), strict=True))
    return made, apart, energy


def main() -> None:
    """Print the drift."""
    parser = argparse.ArgumentParser(description=Path(__file__).name)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--engine", choices=["taylor", "scipy"], default="taylor")
    chosen = parser.parse_args()
    engine: Engine = Taylor(2.2e-16) if chosen.engine == "taylor" else SciPy(1e-13)
    began = time.perf_counter()
    made, apart, energy = drift(engine, chosen.steps)
    took = time.perf_counter() - began
    print(f"{made} steps of {chosen.engine}, {took:.0f} s, {took / made * 1e6:.1f} us a step")
    print(f"  joint apart by at most  {apart:.1e}")
    print(f"  energy off by at most   {energy:.1e}")


if __name__ == "__main__":
    main()
