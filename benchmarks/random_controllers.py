"""Random scenes with controllers: steps against events.

Runs by steps must have the jumps of the run with events, in their order, and their times must come
nearer as steps get shorter, or a run has to warn. Bounces of a contact in a row count once.

Run with ``python benchmarks/random_controllers.py [COUNT] [SEED]``.
"""

from __future__ import annotations

import sys

import numpy as np

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result

STEPS = (4e-4, 1e-4)
# Times may be off by so many steps: a landing comes up to one late, and a stick after it some.
LATE = 40.0

HEAD = """\
kind: scene
name: controllers
parameters: {y: 0.3, u: 0, w: 0, e: 0.3, mu: 0.3, s: 0.2, F: 10, t0: 0.2, dt: 0.4, v: 0.3, k: 1}
gravity: 9.81
stop: {time: 0.8}
controls: {push: 0}
"""
# A particle that a controller pushes at events, one on a plate that starts and stops, and a rod on
# two plastic feet.
SCENES = {
    "pushed": """\
bodies: {b: {mass: 1, start: {y: y, dx: u}}}
surfaces: {floor: {line: [[0, 0], [1, s]]}}
contacts: {c: {point: {body: b}, surface: floor, friction: mu, restitution: e}}
forces: {motor: {body: b, force: [push, 0]}}
regions:
  motor:
    initial: idle
    variables: {n: 0}
    states: {idle: {}, on: {sets: {push: -F}}, back: {sets: {push: F}}}
    transitions:
    - {name: start, from: idle, to: on, on: c.touchdown or c.slip, updates: {n: n + 1}}
    - {name: turn, from: on, to: back, guard: b.dx <= -v}
    - {name: rest, from: back, to: idle, guard: b.dx >= v}
""",
    "plate": """\
bodies: {b: {mass: 1, start: {dx: u}}}
surfaces: {plate: {height: 0, displacement: [0, p]}}
contacts: {c: {point: {body: b}, surface: plate, friction: mu, restitution: e}}
forces: {motor: {body: b, force: [push, 0]}}
regions:
  lift:
    initial: rest
    variables: {p: 0}
    states: {rest: {}, up: {flows: {p: k}}, hold: {}}
    transitions:
    - {name: go, from: rest, to: up, guard: time >= t0}
    - {name: halt, from: up, to: hold, guard: time >= t0 + dt}
  look:
    initial: slow
    states: {slow: {}, fast: {sets: {push: F}}}
    transitions:
    - {name: see, from: slow, to: fast, guard: in(lift.up) and b.dy >= 0.5*k}
    - {name: calm, from: fast, to: slow, on: lift.halt}
""",
    "rod": """\
simultaneous: plastic
bodies: {b: {mass: 1, inertia: 0.05, start: {y: y, dx: u, dangle: w}}}
surfaces: {floor: {height: 0}}
contacts:
  left: {point: {body: b, at: [-0.3, 0]}, surface: floor, friction: mu, restitution: e}
  right: {point: {body: b, at: [0.3, 0]}, surface: floor, friction: mu, restitution: e}
forces: {motor: {body: b, force: [push, 0]}}
regions:
  motor:
    initial: idle
    states: {idle: {}, on: {sets: {push: F}}}
    transitions:
    - {name: land, from: idle, to: on, on: left.touchdown or right.touchdown}
    - {name: away, from: on, to: idle, guard: b.dx >= 2*v + abs(u)}
""",
}


def events(result: Result) -> list[tuple[str, str, float]]:
    """Return regions, causes and times; of bounces of a contact in a row the first."""
    found: list[tuple[str, str, float]] = []
    for jump in result.trace.jumps:
        cause = "touchdown" if jump.cause == "zeno" else jump.cause
        if cause != "touchdown" or not found or found[-1][:2] != (jump.region, cause):
            found.append((jump.region, cause, jump.t))
    return found


def main(count: int = 300, seed: int = 0) -> int:
    """Compare `count` scenes; print those that differ, return how many."""
    random, wrong, warned = np.random.default_rng(seed), 0, 0
    texts = {name: read_text(HEAD + text) for name, text in SCENES.items()}
    exact = {name: Runner(text) for name, text in texts.items()}
    stepped = {n: [Runner(t, engine="impulse", step=h) for h in STEPS] for n, t in texts.items()}
    for index in range(count):
        name = [*SCENES][index % len(SCENES)]
        values = {
            "y": random.uniform(0.05, 0.5), "u": random.normal(), "w": 3.0 * random.normal(),
            "e": max(0.0, random.uniform(-0.3, 0.7)), "mu": random.uniform(0.05, 1.0),
            "s": random.uniform(0.0, 0.4), "F": random.uniform(2.0, 20.0),
            "t0": random.uniform(0.05, 0.4), "dt": random.uniform(0.05, 0.3),
            "v": random.uniform(0.1, 1.0), "k": random.uniform(0.3, 2.0),
        }  # fmt: skip
        want = exact[name].run(values)
        runs = [runner.run(values) for runner in stepped[name]]
        wanted, found = events(want), [events(run) for run in runs]
        differs = [event[:2] for event in wanted] != [event[:2] for event in found[-1]]
        late = max((abs(a[2] - b[2]) for a, b in zip(wanted, found[-1], strict=False)), default=0.0)
        if not differs and late <= LATE * STEPS[-1]:
            continue
        if want.warnings or runs[-1].warnings:
            warned += 1
            continue
        wrong += 1
        print(f"{index} {name}: {'other events' if differs else f'off by {late:.2g}'}, {values}")
        for each in (wanted, *found):
            print("   ", [(region, cause, round(t, 5)) for region, cause, t in each][:12])
    print(f"{count} scenes: {wrong} wrong, {warned} differ with a warning")
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:])), 1))
