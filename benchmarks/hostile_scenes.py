"""Random scenes of the features that the soak leaves out, on both engines.

Edges of other bodies, controllers with springs, joints driven along paths, grounds with kinks,
friction without bound, mass ratios of a million, no gravity, forces and surfaces that change with
time. Of every scene all properties of its kind are tested (energies, cones, gaps, that both
engines take the same way), runs are timed, and what is not proved is printed with what reproduces
it.

    python benchmarks/hostile_scenes.py [--draws N] [--seed S] [--scene NAME] [--run K]

Draw k of a scene takes its numbers from the seed (S, the scene's place, k).
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections import Counter

import numpy as np

from contacts.scene.scene import Scene
from contacts.testing.scene_properties import properties
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, DeclarationProblem
from statechart.testing.agreement import Undecidable
from statechart.testing.properties import Property, generic
from statechart.testing.subject import Case, Subject, ranges

_LONG = 60.0

# Mechanisms end runs where no motion exists: a hand that moves as prescribed drags a tip at rest
# whose friction locks it (mu V turns the rod into the floor).
_IMPASSES = {("rod led along a path", "NO_CONSISTENT_MODE")}

_HEAD = "kind: scene\nname: hostile\ngravity: g\n"
_FREE = "{x: x0, y: y0, angle: a0, dx: u0, dy: w0, dangle: r0}"

SCENES = {
    "stick over the edge of a block": """
parameters: {g: 1, mu: 0.5, e: 0.2, x0: 0.6, y0: 2.5, a0: 0.7, u0: 0, w0: 0, r0: 0, b: 0.5, m: 2}
ranges: {mu: [0, 1.5], e: [0, 0.9], x0: [-1, 1], a0: [-1.5, 1.5], u0: [-1, 1], r0: [-2, 2],
  b: [0.2, 0.8], m: [0.1, 10]}
bodies:
  block: {mass: m, inertia: 2/3*m*b**2, start: {y: b}}
  stick: {mass: 1, inertia: 1/3, start: FREE}
surfaces:
  floor: {height: 0}
  top: {edge: [[-b, b], [b, b]], body: block}
  side: {edge: [[b, b], [b, -b]], body: block}
contacts:
  left: {point: {body: block, at: [-b, -b]}, surface: floor, friction: mu, restitution: 0}
  right: {point: {body: block, at: [b, -b]}, surface: floor, friction: mu, restitution: 0}
  A: {point: {body: stick, at: [-1, 0]}, surface: top, friction: mu, restitution: e}
  B: {point: {body: stick, at: [1, 0]}, surface: top, friction: mu, restitution: e}
  C: {point: {body: stick, at: [1, 0]}, surface: floor, friction: mu, restitution: e}
stop: {time: 4}
""",
    "ball on a seesaw": """
parameters: {g: 1, mu: 0.3, e: 0.3, q0: 0.1, x0: 0.5, h: 1, u0: 0, m: 1}
ranges: {mu: [0, 1], e: [0, 1], q0: [-0.4, 0.4], x0: [-0.9, 0.9], h: [0.6, 2], u0: [-0.5, 0.5],
  m: [0.01, 100]}
coordinates: {q: {start: q0}}
bodies:
  plank: {mass: 1, inertia: 1/3, position: [0, 0], angle: q}
  ball: {mass: m, start: {x: x0, y: h, dx: u0}}
surfaces:
  top: {edge: [[-1, 0], [1, 0]], body: plank}
  floor: {height: -0.5}
contacts:
  on: {point: {body: ball}, surface: top, friction: mu, restitution: e}
  ground: {point: {body: ball}, surface: floor, friction: mu, restitution: e}
  left: {point: {body: plank, at: [-1, 0]}, surface: floor, friction: mu, restitution: e}
  right: {point: {body: plank, at: [1, 0]}, surface: floor, friction: mu, restitution: e}
stop: {time: 5}
""",
    "springy leg with a controller": """
parameters: {g: 9.81, k: 200, foot: 0.05, d: 0.03, h: 0.2, mu: 0.4, u0: 0.3, hold: 1}
ranges: {k: [50, 1e5], foot: [1e-3, 0.3], d: [0, 0.1], h: [0.01, 0.5], mu: [0, 2], u0: [-1, 1]}
coordinates: {x: {rate: u0}, y: {start: 1 + h}, l: {start: 1}}
bodies:
  trunk: {mass: 1, position: [x, y]}
  toe: {mass: foot, position: [x, y - l]}
surfaces: {ground: {height: 0}, end: {height: -1, body: trunk}}
contacts:
  sole: {point: {body: toe}, surface: ground, friction: mu, restitution: 0}
  stop: {point: {body: toe}, surface: end, modes: [free, slide], friction: 0, restitution: 0}
controls: {push: hold}
forces: {on_trunk: {body: trunk, force: [0, push]}, on_toe: {body: toe, force: [0, -push]}}
regions:
  leg:
    initial: swing
    states: {swing: {}, compress: {sets: {push: k*(1 - l)}}, thrust: {sets: {push: k*(1 + d - l)}}}
    transitions:
      - {name: land, from: swing, to: compress, on: sole.touchdown}
      - {name: kick, from: compress, to: thrust, guard: dl >= 0}
      - {name: leave, from: thrust, to: swing, on: sole.liftoff}
stop: {time: 2}
""",
    "switched push on a block": """
parameters: {g: 1, mu: 0.3, x0: 0.3, u0: 0.2, F: 0.5, k: 1}
ranges: {mu: [0, 1], x0: [-1, 1], u0: [-1, 1], F: [0, 1.2], k: [0, 4]}
bodies: {block: {mass: 1, start: {x: x0, dx: u0}}}
surfaces: {floor: {height: 0}}
contacts: {sole: {point: {body: block}, surface: floor, friction: mu, restitution: 0}}
controls: {push: 0}
forces: {drive: {body: block, force: [push - k*block.x, 0]}}
regions:
  sense:
    initial: right
    states: {right: {sets: {push: -F}}, left: {sets: {push: F}}}
    transitions:
      - {name: go, from: right, to: left, guard: block.x + block.dx < 0}
      - {name: back, from: left, to: right, guard: block.x + block.dx > 0.02}
stop: {time: 5}
""",
    "rod led along a path": """
parameters: {g: 1, mu: 0.4, e: 0.1, w: 2, A: 0.3, a0: 0.9}
ranges: {mu: [0, 1.2], e: [0, 0.9], w: [0.5, 10], A: [0.01, 0.5], a0: [0.2, 1.4]}
bodies: {rod: {mass: 1, inertia: 1/3, start: {x: -sin(a0), y: 2 - cos(a0), angle: -a0, dx: A*w}}}
surfaces: {floor: {height: 1.9 - 2*cos(a0)}}
joints: {hand: {point: {body: rod, at: [0, 1]}, to: [A*sin(w*time), 2]}}
contacts: {tip: {point: {body: rod, at: [0, -1]}, surface: floor, friction: mu, restitution: e}}
stop: {time: 6}
""",
    "rod in a groove": """
parameters: {g: 1, mu: 0.3, e: 0.3, x0: 0.2, y0: 2.5, a0: 0.4, u0: 0, w0: 0, r0: 0, s: 0.5}
ranges: {mu: [0, 1.5], e: [0, 0.9], x0: [-1, 1], a0: [-1.5, 1.5], u0: [-1, 1], r0: [-2, 2],
  s: [0.1, 1.2]}
bodies: {rod: {mass: 1, inertia: 0.2, start: FREE}}
surfaces: {left: {height: -s*x}, right: {height: s*x}}
contacts:
  A: {point: {body: rod, at: [-0.8, 0]}, surface: left, friction: mu, restitution: e}
  B: {point: {body: rod, at: [0.8, 0]}, surface: left, friction: mu, restitution: e}
  C: {point: {body: rod, at: [-0.8, 0]}, surface: right, friction: mu, restitution: e}
  D: {point: {body: rod, at: [0.8, 0]}, surface: right, friction: mu, restitution: e}
stop: {time: 8}
""",
    "ball on a ridge": """
parameters: {g: 1, mu: 0.2, e: 0.5, x0: 0.7, y0: 2, u0: 0, s: 0.5}
ranges: {mu: [0, 0.6], e: [0, 0.95], x0: [-2, 2], y0: [0.5, 3], u0: [-2, 2], s: [0.05, 1]}
bodies: {ball: {mass: 1, start: {x: x0, y: y0, dx: u0}}}
surfaces: {up: {height: s*x}, down: {height: -s*x}}
contacts:
  left: {point: {body: ball}, surface: up, friction: mu, restitution: e, enabled: ball.x <= 0}
  right: {point: {body: ball}, surface: down, friction: mu, restitution: e, enabled: ball.x >= 0}
stop: {time: 8}
""",
    "friction without bound, no loss": """
parameters: {g: 1, k: 0.3, x0: 0, y0: 1.5, a0: 0.4, u0: 0.2, w0: 0, r0: 0.3}
ranges: {k: [0.01, 1], a0: [-3, 3], u0: [-1, 1], r0: [-3, 3], y0: [1.2, 2]}
bodies: {rod: {mass: 1, inertia: k, start: FREE}}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: rod, at: [-1, 0]}, surface: floor, friction: inf, restitution: 1}
  B: {point: {body: rod, at: [1, 0]}, surface: floor, friction: inf, restitution: 1}
stop: {time: 5}
""",
    "masses of a million": """
parameters: {g: 1, mu: 0.3, e: 0.7, x0: 0.02, d: 1.5, m: 1e6, u0: 0}
ranges: {mu: [0, 1], e: [0, 0.98], x0: [-0.3, 0.3], d: [1.1, 2], m: [1e-6, 1e6]}
bodies:
  low: {mass: 1, start: {y: 1.5}}
  high: {mass: m, start: {x: x0, y: 1.5 + d, dx: u0}}
surfaces: {floor: {height: 0}, shell: {circle: [0, 0], radius: 1, body: low}}
contacts:
  ground: {point: {body: low, at: [0, -0.5]}, surface: floor, friction: mu, restitution: e}
  between: {point: {body: high}, surface: shell, friction: mu, restitution: e}
  far: {point: {body: high, at: [0, -0.5]}, surface: floor, friction: mu, restitution: e}
stop: {time: 6}
""",
    "rod in a box without gravity": """
parameters: {g: 0, mu: 0.3, e: 1, x0: 0, y0: 0, a0: 0.3, u0: 0.5, w0: 0.2, r0: 1}
ranges: {mu: [0, 1], e: [0, 1], a0: [-3, 3], u0: [-1, 1], w0: [-1, 1], r0: [-2, 2]}
bodies: {rod: {mass: 1, inertia: 0.3, start: FREE}}
surfaces:
  floor: {height: -2}
  right: {line: [[2, 0], [2, 1]]}
contacts:
  A: {point: {body: rod, at: [-1, 0]}, surface: floor, friction: mu, restitution: e}
  B: {point: {body: rod, at: [1, 0]}, surface: floor, friction: mu, restitution: e}
  C: {point: {body: rod, at: [-1, 0]}, surface: right, friction: mu, restitution: e}
  D: {point: {body: rod, at: [1, 0]}, surface: right, friction: mu, restitution: e}
stop: {time: 8}
""",
    "block pushed to and fro": """
parameters: {g: 1, mu: 0.4, F: 0.6, w: 3, b: 0.4, h: 0.6, p: 0.5}
ranges: {mu: [0, 1], F: [0.1, 1.5], w: [0.5, 20], b: [0.2, 1], h: [0.2, 1], p: [-1, 1]}
bodies: {block: {mass: 1, inertia: (b**2 + h**2)/3, start: {y: h}}}
surfaces: {floor: {height: 0}}
contacts:
  left: {point: {body: block, at: [-b, -h]}, surface: floor, friction: mu, restitution: 0}
  right: {point: {body: block, at: [b, -h]}, surface: floor, friction: mu, restitution: 0}
forces: {shake: {body: block, at: [0, p*h], force: ["F*(sin(w*time) + cos(2*w*time)/4)", 0]}}
stop: {time: 6}
""",
    "rod on a shaking floor": """
parameters: {g: 1, mu: 0.4, e: 0.3, A: 0.1, B: 0.1, w: 5, x0: 0, y0: 0.5, a0: 0.1, u0: 0, w0: 0,
  r0: 0}
ranges: {mu: [0, 1], e: [0, 0.9], A: [0, 0.3], B: [0, 0.3], w: [1, 12], a0: [-0.5, 0.5]}
bodies: {rod: {mass: 1, inertia: 0.3, start: FREE}}
surfaces: {floor: {height: 0, displacement: [B*sin(w*time), A*sin(w*time)]}}
contacts:
  left: {point: {body: rod, at: [-1, 0]}, surface: floor, friction: mu, restitution: e}
  right: {point: {body: rod, at: [1, 0]}, surface: floor, friction: mu, restitution: e}
stop: {time: 4}
""",
    "balls in a groove": """
parameters: {g: 1, mu: 0.3, e: 0.4, s: 0.8, m: 1, d: 0.1, h: 2}
ranges: {mu: [0, 1], e: [0, 0.9], s: [0.2, 1.4], m: [0.1, 10], d: [-0.3, 0.3], h: [1.5, 2.5]}
bodies:
  low: {mass: 1, inertia: 0.02, start: {x: 0.1, y: 1.5}}
  high: {mass: m, inertia: 0.02*m, start: {x: d, y: 1 + h}}
surfaces:
  right: {incline: s}
  left: {incline: -s}
  shell: {circle: [0, 0], radius: 0.5, body: low}
contacts:
  r: {point: {body: low, at: [0, -0.2]}, surface: right, friction: mu, restitution: e}
  l: {point: {body: low, at: [0, -0.2]}, surface: left, friction: mu, restitution: e}
  on: {point: {body: high}, surface: shell, friction: mu, restitution: e}
  R: {point: {body: high}, surface: right, friction: mu, restitution: e}
  L: {point: {body: high}, surface: left, friction: mu, restitution: e}
stop: {time: 5}
""",
    "pendulum that grazes": """
parameters: {g: 1, mu: 0.3, e: 0.6, q0: 1, gap: 0, h: 0}
ranges: {mu: [0, 1], e: [0, 1], q0: [0.2, 1.5], gap: [-0.001, 0.001], h: [0, 0.3]}
coordinates: {q: {start: q0}, p: {start: -q0}}
bodies:
  one: {mass: 1, inertia: 0, position: [sin(q), -cos(q)], angle: q}
  two: {mass: 1, inertia: 0, position: [3 + sin(p), -cos(p)], angle: p}
surfaces:
  wall: {line: [[-sin(q0) - gap, 1], [-sin(q0) - gap, 0]]}
  floor: {height: -cos(h)}
contacts:
  touch: {point: {body: one}, surface: wall, friction: mu, restitution: e}
  low: {point: {body: two}, surface: floor, friction: mu, restitution: e}
stop: {time: 15}
""",
    "foot that is lifted": """
parameters: {g: 1, mu: 0.5, e: 0, q0: 0.3, r0: -0.4, c: 0.05, k: 4}
ranges: {mu: [0.1, 2], q0: [0.1, 0.5], r0: [-1, -0.1], c: [0, 0.2], k: [0, 20]}
coordinates: {x: {}, y: {start: cos(q0)}, a: {start: q0, rate: r0}, b: {start: -q0}}
bodies:
  hip: {mass: 5, position: [x, y]}
  one: {mass: 1, inertia: 0.1, position: [x - sin(a)/2, y - cos(a)/2], angle: -a}
  two: {mass: 1, inertia: 0.1, position: [x - sin(b)/2, y - cos(b)/2], angle: -b}
surfaces: {ground: {incline: -0.05, through: [-sin(q0), 0]}}
contacts:
  A: {point: {body: one, at: [0, -1/2]}, surface: ground, friction: mu, restitution: e}
  B: {point: {body: two, at: [0, -1/2]}, surface: ground, friction: mu, restitution: e,
    enabled: a + b <= c}
forces:
  hip_one: {body: one, moment: k*(a - b)}
  hip_two: {body: two, moment: -k*(a - b)}
stop: {time: 4}
""",
    "jammed rod": """
parameters: {mu: 2, k: 0.1, phi: 0.6, w: 0, v: 1, g: 1, e: 0.5}
ranges: {mu: [1, 10], k: [0.02, 0.4], phi: [0.3, 1.2], w: [-1, 1], v: [0.2, 2], e: [0, 1]}
bodies:
  rod: {mass: 1, inertia: k, start: {x: cos(phi), y: sin(phi), angle: phi, dx: v - w*sin(phi),
    dy: w*cos(phi), dangle: w}}
surfaces: {board: {height: 0}}
contacts:
  tip: {point: {body: rod, at: [-1, 0]}, surface: board, friction: mu, restitution: e}
  end: {point: {body: rod, at: [1, 0]}, surface: board, friction: mu, restitution: e}
stop: {time: 4}
""",
    "four bars on a floor": """
parameters: {g: 1, mu: 0.5, e: 0.2, h: 1.5, w: 0.1, t: 0.8}
ranges: {mu: [0, 1], e: [0, 0.9], h: [1, 1.6], w: [-0.2, 0.2], t: [0.4, 1.2]}
bodies:
  a: {mass: 1, inertia: 1/12, start: {x: -cos(t)/2, y: h + sin(t)/2, angle: t, dangle: w,
    dx: w*sin(t)/2, dy: w*cos(t)/2}}
  b: {mass: 1, inertia: 1/12, start: {x: cos(t)/2, y: h + sin(t)/2, angle: -t, dangle: -w,
    dx: -w*sin(t)/2, dy: w*cos(t)/2}}
  c: {mass: 1, inertia: 1/12, start: {x: cos(t)/2, y: h - sin(t)/2, angle: t, dangle: w,
    dx: -w*sin(t)/2, dy: -w*cos(t)/2}}
  d: {mass: 1, inertia: 1/12, start: {x: -cos(t)/2, y: h - sin(t)/2, angle: -t, dangle: -w,
    dx: w*sin(t)/2, dy: -w*cos(t)/2}}
surfaces: {floor: {height: 0}}
joints:
  top: {point: {body: a, at: [1/2, 0]}, to: {body: b, at: [-1/2, 0]}}
  right: {point: {body: b, at: [1/2, 0]}, to: {body: c, at: [1/2, 0]}}
  bottom: {point: {body: c, at: [-1/2, 0]}, to: {body: d, at: [1/2, 0]}}
  left: {point: {body: d, at: [-1/2, 0]}, to: {body: a, at: [-1/2, 0]}}
contacts:
  low: {point: {body: c, at: [-1/2, 0]}, surface: floor, friction: mu, restitution: e}
  side: {point: {body: c, at: [1/2, 0]}, surface: floor, friction: mu, restitution: e}
stop: {time: 3, conditions: {folded: "sin(a.angle - b.angle) < 0.1"}}
""",
}


def subject(name: str) -> Subject:
    """Return the scene, compiled for both engines."""
    text = _HEAD + SCENES[name].replace("FREE", _FREE)
    return Subject(validate(read_text(text), Scene))


def numbers(subject: Subject, random: np.random.Generator) -> dict[str, float]:
    """Draw parameters: by decades where a range spans some, now and then from a range's ends."""
    drawn = {}
    for name, (low, high) in ranges(subject.model).items():
        if low > 0.0 and high > 100.0 * low:
            value = float(np.exp(random.uniform(np.log(low), np.log(high))))
        else:
            value = float(random.uniform(low, high))
        end = random.random()
        drawn[name] = low if end < 0.08 else high if end > 0.92 else value
    return drawn


def tested(case: Case, item: Property) -> str:
    """Return how a property fares: "" where it holds."""
    try:
        item.holds(case)
    except Undecidable as reason:
        return f"undecidable: {reason}"
    except AssertionError as error:
        return f"FAILS: {error}"
    except (DeclarationError, DeclarationProblem) as error:
        return f"no model: {error}"
    return ""


def examined(name: str, draws: range, seed: int) -> Counter[str]:
    """Test draws of one scene; return how they went."""
    found: Counter[str] = Counter()
    one = subject(name)
    scene = one.model
    assert isinstance(scene, Scene)
    items = [p for p in (*generic(one), *properties(scene)) if not p.skipped]
    for k in draws:
        drawn = numbers(one, np.random.default_rng([seed, list(SCENES).index(name), k]))
        case = one.case(drawn)
        place = f"{name}, run {k}"
        began = time.perf_counter()
        try:
            runs = case.traces
        except (DeclarationError, DeclarationProblem) as error:
            found["no model"] += 1
            print(f"{place}: no model: {error}", flush=True)
            continue
        except Exception:
            found["traceback"] += 1
            print(f"{place}: {drawn}\n{traceback.format_exc()}", flush=True)
            continue
        seconds = time.perf_counter() - began
        found["runs"] += len(runs)
        found["events"] += sum(len(trace.jumps) for trace in runs.values())
        for engine, trace in runs.items():
            if not trace.outcome.succeeded:
                found[trace.outcome.name] += 1
                print(f"{place}, {engine}: {trace.outcome.name}: {trace.message}", flush=True)
        if seconds > _LONG:
            found["longer than a minute"] += 1
            print(f"{place}: {seconds:.0f} s", flush=True)
        for item in items:
            words = tested(case, item)
            if any(scene == name and f"run ended: {end}" in words for scene, end in _IMPASSES):
                words = words.replace("FAILS", "no motion")
            if words:
                found[words.split(":")[0]] += 1
                print(f"{place}, {item.name}: {words}", flush=True)
    return found


def main() -> None:
    """Print what is not proved, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scene", choices=SCENES, default=None)
    parser.add_argument("--run", type=int, default=None, help="this draw only")
    chosen = parser.parse_args()
    draws = range(chosen.draws) if chosen.run is None else range(chosen.run, chosen.run + 1)
    total: Counter[str] = Counter()
    for name in SCENES if chosen.scene is None else [chosen.scene]:
        found = examined(name, draws, chosen.seed)
        print(f"{name}: {dict(found)}", flush=True)
        total += found
    print(f"in all: {dict(total)}")
    sys.exit(bool(total["FAILS"] + total["traceback"]))


if __name__ == "__main__":
    main()
