"""Random scenes: their origin shifted, in other units, with starts moved by next to nothing.

Events (bounces before a `zeno` left out) and the state at the end have to agree to 1e-9 of the
scene, or a run has to warn. A start moved by d may move the end by a thousand times d.

Run with ``python benchmarks/random_moves.py [COUNT] [SEED]``.
"""

from __future__ import annotations

import sys

import numpy as np

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result

HEAD = """\
kind: scene
name: moves
parameters: {L: 1, M: 1, T: 1, x0: 0, y0: 0, x: 0, y: 1, u: 0, w: 0, a: 0, e: 0.5, mu: 0.3, s: 0.2}
gravity: 9.81*L/T**2
stop: {time: 0.9*T}
"""
# A particle above a slope and a wall; a disc between them; a rod on two tips.
SCENES = {
    "particle": """\
bodies: {b: {mass: M, start: {x: x0 + x*L, y: y0 + y*L, dx: u*L/T}}}
contacts:
  low: {point: {body: b}, surface: floor, friction: mu, restitution: e}
  side: {point: {body: b}, surface: wall, friction: mu, restitution: e}
""",
    "disc": """\
bodies:
  b: {mass: M, inertia: 0.005*M*L**2,
      start: {x: x0 + x*L, y: y0 + (y + 0.15)*L, dx: u*L/T, dangle: w/T}}
contacts:
  low: {point: {body: b, at: [0, 0]}, radius: 0.1*L, surface: floor, friction: mu, restitution: e}
  side: {point: {body: b, at: [0, 0]}, radius: 0.1*L, surface: wall, friction: mu, restitution: e}
""",
    "rod": """\
bodies:
  b: {mass: M, inertia: 0.03*M*L**2,
      start: {x: x0 + x*L, y: y0 + (y + 0.3)*L, angle: a, dx: u*L/T}}
contacts:
  low: {point: {body: b, at: [-0.3*L, 0]}, surface: floor, friction: mu, restitution: 0}
  side: {point: {body: b, at: [0.3*L, 0]}, surface: floor, friction: mu, restitution: 0}
""",
}
SURFACES = """\
surfaces:
  floor: {line: [[x0, y0], [x0 + L, y0 + s*L]]}
  wall: {line: [[x0 + L, y0], [x0 + L, y0 + L]]}
"""


def events(result: Result) -> list[tuple[str, str]]:
    """Return regions and causes; of touchdowns that a `zeno` follows only the first."""
    found: list[tuple[str, str]] = []
    for jump in result.trace.jumps:
        event = jump.region, jump.cause
        if not (event[1] == "touchdown" and found and found[-1] == event):
            found.append(event)
    return found


def ended(result: Result, values: dict[str, float]) -> np.ndarray:
    """Return the state at the end in units of the scene, from its origin."""
    n = len(result.trace.final) // 2
    size = np.where(np.arange(n) < 2, values.get("L", 1.0), 1.0)
    size = np.concatenate([size, size / values.get("T", 1.0)])
    state = np.array(result.trace.final)
    state[:2] -= values.get("x0", 0.0), values.get("y0", 0.0)
    return state / size


def main(count: int = 300, seed: int = 0) -> int:
    """Try all moves of `count` scenes; print those that differ, return how many."""
    random, wrong, reported, tried = np.random.default_rng(seed), 0, 0, 0
    runners = {
        name: Runner(read_text(HEAD + SURFACES + text.replace("\n      start", " start")))
        for name, text in SCENES.items()
    }
    for index in range(count):
        name = [*SCENES][index % len(SCENES)]
        base = {
            "x": random.uniform(0.0, 0.4), "y": random.uniform(0.2, 1.0), "u": random.normal(),
            "w": 3.0 * random.normal(), "a": random.uniform(-1.0, 1.0), "mu": random.uniform(0, 1),
            "e": random.uniform(0.0, 0.8), "s": random.uniform(0.0, 0.3),
        }  # fmt: skip
        want = runners[name].run(base)
        moves: list[tuple[dict[str, float], float]] = [
            ({"x0": by, "y0": -by}, 0.0) for by in (1.0, -30.0, 1e3, 1e6)
        ]
        moves += [({unit: by}, 0.0) for unit in "LMT" for by in (1e-6, 1e6)]
        moves += [({"y": base["y"] + d}, d) for d in 10.0 ** np.arange(-17, -7, 2)]
        for move, by in moves:
            tried += 1
            values = {**base, **move}
            found = runners[name].run(values)
            off = np.abs(ended(found, values) - ended(want, base)).max()
            if events(found) == events(want) and off <= 1e-9 + 1e3 * by:
                continue
            if found.warnings or want.warnings:
                reported += 1
                continue
            wrong += 1
            print(f"{index} {name} {move}: off by {off:.2g}, {base}")
            print("   ", events(want)[:9], "\n   ", events(found)[:9])
    print(f"{count} scenes, {tried} moves: {wrong} wrong, {reported} differ with a warning")
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:])), 1))
