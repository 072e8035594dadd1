"""Random piles of boxes and discs, declared in another order.

Rates and places at the end have to agree to a thousand times the residual of the impulses.

Run with ``python benchmarks/random_orders.py [COUNT] [SEED]``.
"""

from __future__ import annotations

import sys

import numpy as np

from statechart import Runner
from statechart.documents.yaml_reader import read_text

RESIDUAL = 1e-10
HEAD = """\
kind: scene
name: orders
gravity: 9.81
surfaces:
  floor: {line: [[-3, 0], [3, 0]]}
  wall: {line: [[-3, 3], [-3, 0]]}
stop: {time: 0.1}
bodies:
"""


def pile(random: np.random.Generator) -> tuple[dict[str, str], str]:
    """Return the declarations of bodies, and the law of their contacts."""
    kind, top, bodies = random.choice(["stack", "row", "heap"]), 0.0, {}
    count = int(random.integers(3, 8))
    for i in range(count):
        a, b = random.uniform(0.1, 0.25), random.uniform(0.05, 0.15)
        shape = f"{{polygon: [[{-a}, {-b}], [{a}, {-b}], [{a}, {b}], [{-a}, {b}]]}}"
        if kind == "heap" and random.random() < 0.4:
            a = b
            shape = f"{{disc: {a}}}"
        mass = random.uniform(0.5, 3.0)
        x = {"stack": random.uniform(-0.03, 0.03), "row": (i - 0.5 * count) * 0.5,
             "heap": random.uniform(-0.5, 0.5)}[kind]  # fmt: skip
        y = b if kind == "row" else top + b
        top = y + b
        bodies[f"b{i}"] = (
            f"{{mass: {mass}, inertia: {mass * (a * a + b * b) / 3.0}, shape: {shape}, "
            f"start: {{x: {x}, y: {y}, dx: {0.2 * random.normal()}}}}}"
        )
    law = f"friction: {random.uniform(0.1, 0.9)}, restitution: {random.choice([0.0, 0.0, 0.3])}"
    return bodies, f"collisions: {{all: {{bodies: [{', '.join(bodies)}], surfaces: [floor, wall], "\
        f"{law}}}}}\n"  # fmt: skip


def ended(bodies: dict[str, str], law: str) -> dict[str, float]:
    """Return the coordinates and rates at the end of a run."""
    text = HEAD + "".join(f"  {name}: {body}\n" for name, body in bodies.items()) + law
    run = Runner(read_text(text), engine="impulse", step=1e-3, impulse_tolerance=RESIDUAL)
    return dict(zip(run.automaton.names, run.run().trace.final, strict=True))


def main(count: int = 300, seed: int = 0) -> int:
    """Try `count` piles; print those that differ, return how many."""
    random, wrong, most = np.random.default_rng(seed), 0, 0.0
    for index in range(count):
        bodies, law = pile(random)
        names = [*bodies]
        other = {names[i]: bodies[names[i]] for i in random.permutation(len(names))}
        want, found = ended(bodies, law), ended(other, law)
        off = max(abs(found[name] - value) for name, value in want.items())
        most = max(most, off)
        if off > 1e3 * RESIDUAL:
            wrong += 1
            print(f"{index}: off by {off:.2g}, {[*other]}")
    print(f"{count} piles: {wrong} differ, off by {most:.2g} at most")
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:])), 1))
