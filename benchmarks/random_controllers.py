"""Random scenes with controllers: steps against events.

Runs by steps must have the jumps of the run with events, in their order, at times off by some
steps, or a run has to warn. Where they differ, shorter steps must agree. Series of bounces amplify
errors of their landings: where times differ by more, the run with events is perturbed by a step.

Run with ``python benchmarks/random_controllers.py [COUNT] [SEED]``.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result

STEPS = (1e-4, 2.5e-5, 6.25e-6, 1.5625e-6)
# Times may be off by so many steps: a landing comes up to one late, and a stick after it some.
LATE = 40.0
# Events that repeat within so many steps may be missing, and sticks so soon after a landing.
SHORT = 32.0

HEAD = """\
kind: scene
name: controllers
parameters: {y: 0.3, u: 0, w: 0, e: 0.3, mu: 0.3, s: 0.2, F: 10, t0: 0.2, dt: 0.4, v: 0.3, k: 1}
gravity: 9.81
stop: {time: 0.8}
"""
# A particle that a controller pushes at events, one on a plate that starts and stops, a rod on two
# plastic feet, and others.
SCENES = {
    "pushed": """\
bodies: {b: {mass: 1, start: {y: y, dx: u}}}
surfaces: {floor: {line: [[0, 0], [1, s]]}}
contacts: {c: {point: {body: b}, surface: floor, friction: mu, restitution: e}}
controls: {push: 0}
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
controls: {push: 0}
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
  left:
    {point: {body: b, at: [-0.3, 0]}, surface: floor, friction: mu, restitution: e,
     impact: moreau}
  right:
    {point: {body: b, at: [0.3, 0]}, surface: floor, friction: mu, restitution: e,
     impact: moreau}
controls: {push: 0}
forces: {motor: {body: b, force: [push, 0]}}
regions:
  motor:
    initial: idle
    states: {idle: {}, on: {sets: {push: F}}}
    transitions:
    - {name: land, from: idle, to: on, on: left.touchdown or right.touchdown}
    - {name: away, from: on, to: idle, guard: b.dx >= 2*v + abs(u)}
""",
    "pair": """\
simultaneous: plastic
bodies: {a: {mass: 2, start: {x: 3}}, b: {mass: 1, start: {y: y, dx: u}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: a}, surface: floor, friction: mu, restitution: 0, impact: moreau}
  d: {point: {body: b}, surface: floor, friction: grip, restitution: e, impact: moreau}
forces:
  f: {body: b, force: [-k*(b.dx - a.dx), -k*(b.dy - a.dy)]}
  g: {body: a, force: [k*(b.dx - a.dx) + push, k*(b.dy - a.dy)]}
controls: {push: 0, grip: 0}
regions:
  count:
    initial: roll
    variables: {n: 0}
    states: {roll: {}, brake: {sets: {grip: 2*mu}}, pull: {sets: {push: F}}}
    transitions:
    - {name: one, from: roll, to: roll, on: d.touchdown, guard: n < 1, updates: {n: n + 1}}
    - {name: two, from: roll, to: brake, on: d.touchdown, guard: n >= 1}
    - {name: three, from: brake, to: pull, on: d.touchdown}
    - {name: four, from: pull, to: roll, guard: a.dx >= v, updates: {n: 0}}
""",
    "belt": """\
bodies: {b: {mass: 1, inertia: 0.01, start: {y: y + 0.1, dx: u, dangle: w}}}
surfaces: {belt: {height: 0, displacement: [p, 0]}}
contacts:
  c:
    {point: {body: b}, radius: 0.1, surface: belt, friction: mu, restitution: e, impact: moreau}
regions:
  drive:
    initial: rest
    variables: {p: 0}
    states: {rest: {}, run: {flows: {p: k}}, back: {flows: {p: -k}}}
    transitions:
    - {name: go, from: rest, to: run, on: c.touchdown}
    - {name: turn, from: run, to: back, on: c.stick}
    - {name: halt, from: back, to: rest, guard: b.dx <= -v}
""",
    "grip": """\
bodies: {a: {mass: 2, start: {x: 0.5, y: 0.2, dx: u}}, b: {mass: 1, start: {y: y, dx: u + v}}}
surfaces:
  floor: {height: 0}
  wall: {line: [[0.6, -1], [0.6, 1]]}
contacts:
  d: {point: {body: b}, surface: floor, friction: mu, restitution: e, impact: moreau}
  stop:
    {point: {body: b}, surface: wall, friction: mu, restitution: e, impact: moreau,
     enabled: in(hand.shut)}
joints: {j: {point: {body: b}, to: {body: a}, enabled: in(hand.shut), rest: captured}}
controls: {push: 0}
forces: {motor: {body: a, force: [push, 2*9.81 + 0.4*push]}}
regions:
  hand:
    initial: open
    states: {open: {}, shut: {sets: {push: F}}}
    transitions:
    - {name: close, from: open, to: shut, on: d.touchdown}
    - {name: part, from: shut, to: open, after: dt}
""",
    "tow": """\
simultaneous: plastic
bodies:
  a: {mass: 2, start: {dx: u}}
  b: {mass: 1, inertia: 0.05, start: {x: 3, y: y, dx: u, dangle: w}}
surfaces: {floor: {height: 0}}
contacts:
  c:
    {point: {body: a}, surface: floor, friction: {static: 1.3*mu, kinetic: mu}, restitution: 0,
     impact: moreau}
  left:
    {point: {body: b, at: [-0.3, 0]}, surface: floor, friction: mu, restitution: 0, impact: moreau}
  right:
    {point: {body: b, at: [0.3, 0]}, surface: floor, friction: mu, restitution: 0, impact: moreau}
controls: {pull: 0, push: 0}
forces: {motor: {body: a, force: [pull, 0]}, fan: {body: b, force: [push, 0]}}
regions:
  winch:
    initial: idle
    states: {idle: {}, forth: {sets: {pull: 2*F}}, back: {sets: {pull: -2*F}}}
    transitions:
    - {name: land, from: idle, to: forth, on: left.touchdown or right.touchdown}
    - {name: turn, from: forth, to: back, guard: a.dx >= v + abs(u)}
    - {name: rest, from: back, to: idle, on: c.stick or c.reverse}
  air:
    initial: calm
    states: {calm: {}, blows: {sets: {push: 0.5*F}}}
    transitions:
    - {name: open, from: calm, to: blows, on: left.touchdown or right.touchdown}
    - {name: shut, from: blows, to: calm, on: c.stick or c.reverse}
""",
}


Event = tuple[tuple[str, str], float, float]


def events(result: Result) -> list[Event]:
    """Return names (region and new mode), times, and times since the last event of the same name.

    The last one of a stick (mode `pin`) may also be a landing of its contact.
    """
    trace, last = result.trace, dict[tuple[str, str], float]()
    found = list[Event]()
    for jump in trace.jumps:
        changed = [
            (region, "lands" if before == "free" else mode)
            for region, before, mode in zip(trace.regions, jump.source, jump.target, strict=True)
            if before != mode and "off" not in (before, mode) and "closed" not in (before, mode)
        ]
        if jump.cause == "touchdown" and (jump.region, "lands") not in changed:
            changed.append((jump.region, "lands"))
        for name in changed:
            earlier = (name, (name[0], "lands")) if name[1] == "pin" else (name,)
            before = max(last.get(key, -np.inf) for key in earlier)
            found.append((name, jump.t, jump.t - before))
            last[name] = jump.t
    return found


def lateness(wanted: Result, result: Result, short: float) -> float:
    """Return how late events are; infinity if there are others.

    Events that repeat within `short` may be missing, such as the last bounces; so may a stick
    within `short` of a landing of its contact.
    Events of two regions in less than a step may change places.
    """
    late = 0.0
    for region in wanted.trace.regions:
        one, other = ([e for e in events(run) if e[0][0] == region] for run in (wanted, result))
        late = max(late, _lateness(one, other, short))
    return late


def _lateness(one: list[Event], other: list[Event], short: float) -> float:
    late = np.full((len(one) + 1, len(other) + 1), np.inf)
    late[0, 0] = 0.0
    for i, j in np.ndindex(*late.shape):
        if i and one[i - 1][2] <= short:
            late[i, j] = min(late[i, j], late[i - 1, j])
        if j and other[j - 1][2] <= short:
            late[i, j] = min(late[i, j], late[i, j - 1])
        if i and j and one[i - 1][0] == other[j - 1][0]:
            off = abs(one[i - 1][1] - other[j - 1][1])
            repeats = min(one[i - 1][2], other[j - 1][2]) <= short
            late[i, j] = min(late[i, j], max(late[i - 1, j - 1], 0.0 if repeats else off))
    return float(late[-1, -1])


def draw(random: np.random.Generator) -> dict[str, float]:
    """Return the parameters of a scene."""
    e = random.uniform(-0.3, 0.7)  # Bounces by small ones are late by h/e.
    return {
        "y": random.uniform(0.05, 0.5), "u": random.normal(), "w": 3.0 * random.normal(),
        "e": e if e > 0.05 else 0.0, "mu": random.uniform(0.05, 1.0),
        "s": random.uniform(0.0, 0.4), "F": random.uniform(2.0, 20.0),
        "t0": random.uniform(0.05, 0.4), "dt": random.uniform(0.05, 0.3),
        "v": random.uniform(0.1, 1.0), "k": random.uniform(0.3, 2.0),
    }  # fmt: skip


def main(count: int = 300, seed: int = 0) -> int:
    """Compare `count` scenes; print those late at all steps, return how many differ silently."""
    random, found = np.random.default_rng(seed), Counter[str]()
    texts = {name: read_text(HEAD + text) for name, text in SCENES.items()}
    exact = {name: Runner(text) for name, text in texts.items()}
    stepped = {n: [Runner(t, engine="impulse", step=h) for h in STEPS] for n, t in texts.items()}
    for index in range(count):
        name, values = [*SCENES][index % len(SCENES)], draw(random)
        want, late = exact[name].run(values), []
        for runner, h in zip(stepped[name], STEPS, strict=True):
            run = runner.run(values)
            late.append(lateness(want, run, SHORT * h))
            warned = any("indeterminate" not in text for text in run.warnings)
            if late[-1] <= LATE * h:
                break
        agrees = f"agree at {h:g}"
        if late[-1] > LATE * h:
            nudged = exact[name].run({**values, "u": values["u"] + h, "w": values["w"] + h})
            moved = lateness(want, nudged, 0.0)
            amplified = np.isfinite(moved) and late[-1] <= LATE * moved
            agrees = "amplified" if amplified else "differ"
        kind = f"{agrees}, {'warned' if warned else 'silent'}"
        found[kind] += 1
        if agrees in ("amplified", "differ"):
            print(f"{index} {name}: {kind}, late {late}, {values}")
    for kind, often in sorted(found.items()):
        print(f"{often:6} {kind}")
    return found["differ, silent"]


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:])), 1))
