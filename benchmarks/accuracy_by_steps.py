"""An accuracy asked of `engine: impulse` on random scenes: delivered, refused, or missed.

    python benchmarks/accuracy_by_steps.py [COUNT] [SEED]

Eight kinds of scenes take turns: blocks that slide to rest or are driven, balls that bounce on
level ground and on hills, toppling sticks, bars that fall on their two ends, pendulums, and a bob
on a spring above the ground. Each asks for 1e-2 or 1e-3, and is judged by Taylor's method at its
least tolerance: by the outputs that both have, each relative to its size.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from statechart.documents.yaml_reader import read_text
from statechart.errors import StatechartError
from statechart.observation.outputs import Outputs
from statechart.running.result import Result
from statechart.running.runner import Runner

__all__ = ["SCENES", "Judgement", "judge", "main"]

_HEAD = "kind: scene\nname: {name}\ngravity: 9.81\n"
_BLOCK = """\
parameters: {v0: 3, mu: 0.5}
bodies: {b: {mass: 1, start: {dx: v0}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, modes: [slide, pin], friction: mu}}
stop: {time: 2}
outputs: {t_stop: {value: time, at: first c.stick}, x: {value: b.x}}
"""
_DRIVEN = """\
parameters: {F: 3, omega: 2, mu: 0.2}
bodies: {b: {mass: 1}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, modes: [slide, pin], friction: mu}}
forces: {f: {body: b, force: ["F*sin(omega*time)", 0]}}
stop: {time: 6}
outputs: {t_slip: {value: time, at: first c.slip}, x: {value: b.x}}
"""
_BALL = """\
parameters: {y0: 1, e: 0.5, vx: 0.5}
bodies: {b: {mass: 1, start: {y: y0, dx: vx}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: b}, surface: floor, modes: [free, slide], friction: 0, restitution: e}
stop: {time: 3}
outputs:
  t_hit: {value: time, at: first c.touchdown}
  x: {value: b.x}
  y: {value: b.y}
  bounces: {count: c.touchdown}
"""
_HILLS = """\
parameters: {y0: 1, e: 0.5, vx: 0.5, A: 0.1, k: 2, mu: 0.2}
bodies: {b: {mass: 1, start: {y: y0, dx: vx}}}
surfaces: {hills: {height: A*cos(k*x)}}
contacts: {c: {point: {body: b}, surface: hills, friction: mu, restitution: e}}
stop: {time: 1.5}
outputs:
  t_hit: {value: time, at: first c.touchdown}
  x: {value: b.x}
  y: {value: b.y}
"""
_STICK = """\
parameters: {L: 1, mu: 0.3, theta: 0.1}
bodies: {b: {mass: 1, inertia: 1/3, start: {x: -L*sin(theta), y: L*cos(theta), angle: theta}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b, at: [0, -L]}, surface: floor, friction: mu, restitution: 0}}
stop: {time: 5, conditions: {down: b.angle > 1.4}}
outputs: {t_down: {value: time}, x: {value: b.x}, rate: {value: b.dangle}}
"""
_BAR = """\
parameters: {L: 1, tilt: 0.1, drop: 0.3, mu: 0.3, e: 0, v: 0}
bodies: {b: {mass: 1, inertia: 1/3, start: {y: drop + L*sin(abs(tilt)), angle: tilt, dx: v}}}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: b, at: [-L, 0]}, surface: floor, friction: mu, restitution: e, impact: moreau}
  B: {point: {body: b, at: [L, 0]}, surface: floor, friction: mu, restitution: e, impact: moreau}
stop: {time: 1}
outputs: {x: {value: b.x}, t_A: {value: time, at: first A.touchdown}, angle: {value: b.angle}}
"""
_PENDULUM = """\
parameters: {L: 0.5, angle: 0.5, rate: 1}
bodies:
  b:
    mass: 1
    inertia: L**2/3
    start:
      x: L*sin(angle)
      y: -L*cos(angle)
      angle: angle
      dx: L*cos(angle)*rate
      dy: L*sin(angle)*rate
      dangle: rate
joints: {pivot: {point: {body: b, at: [0, L]}, to: [0, 0]}}
stop: {time: 3}
outputs: {angle: {value: b.angle}, rate: {value: b.dangle}, fastest: {maximum: b.dangle}}
"""
_SPRING = """\
parameters: {k: 100, y0: 0.5, e: 0.5, l: 0.6}
bodies: {b: {mass: 1, start: {y: y0}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: b}, surface: floor, modes: [free, slide], friction: 0, restitution: e}
forces: {s: {body: b, force: [0, -k*(b.y - l)]}}
stop: {time: 2}
outputs: {y: {value: b.y}, dy: {value: b.dy}, highest: {maximum: b.y}}
"""

_ROUNDING = 1e-12
"""Errors of less are none."""

Draw = Callable[[np.random.Generator], dict[str, float]]
SCENES: dict[str, tuple[str, Draw]] = {
    "block": (_BLOCK, lambda rng: {"v0": rng.uniform(1, 4), "mu": rng.uniform(0.25, 1)}),
    "driven": (
        _DRIVEN,
        lambda rng: {
            "F": rng.uniform(1, 6), "omega": rng.uniform(0.5, 4), "mu": rng.uniform(0.05, 0.4)
        },
    ),
    "ball": (
        _BALL,
        lambda rng: {
            "y0": rng.uniform(0.3, 2), "e": rng.choice([0.0, rng.uniform(0.1, 0.8)]),
            "vx": rng.uniform(-1, 1),
        },
    ),
    "hills": (
        _HILLS,
        lambda rng: {
            "y0": rng.uniform(0.5, 1.5), "e": rng.uniform(0.1, 0.7), "vx": rng.uniform(-2, 2),
            "A": rng.uniform(0.02, 0.2), "k": rng.uniform(0.5, 3), "mu": rng.uniform(0, 0.5),
        },
    ),
    "stick": (
        _STICK,
        lambda rng: {
            "L": rng.uniform(0.5, 1.5), "mu": 10 ** rng.uniform(-2, 0.5),
            "theta": 10 ** rng.uniform(-2, -0.5),
        },
    ),
    "bar": (
        _BAR,
        lambda rng: {
            "tilt": rng.choice([-1, 1]) * rng.uniform(0.05, 0.5), "drop": rng.uniform(0.1, 1),
            "mu": 10 ** rng.uniform(-2, 0), "e": rng.choice([0.0, rng.uniform(0.1, 0.6)]),
            "v": rng.uniform(-1, 1),
        },
    ),
    "pendulum": (
        _PENDULUM,
        lambda rng: {
            "L": rng.uniform(0.2, 1), "angle": rng.uniform(-2, 2), "rate": rng.uniform(-4, 4)
        },
    ),
    "spring": (
        _SPRING,
        lambda rng: {
            "k": 10 ** rng.uniform(1, 3), "y0": rng.uniform(0.3, 1), "e": rng.uniform(0.1, 0.8),
            "l": rng.uniform(0, 0.8),
        },
    ),
}  # fmt: skip
"""Kind -> text and how its parameters are drawn."""


@dataclass(frozen=True)
class Judgement:
    """Verdict on a request: delivered, refused, missed (by more than requested) or unjudged."""

    verdict: str
    error: float = math.nan
    estimate: float = math.nan
    steps: int = 0
    reason: str = ""


def judge(result: Result, exact: Result) -> Judgement:
    """Compare what was delivered with the exact outputs."""
    assert result.asked is not None
    steps = result.asked.cost.steps
    estimate = math.inf if result.error_estimate is None else result.error_estimate
    error = _error(result, exact)
    if not (result.asked.reached(result.error_estimate) and result.trace.outcome.succeeded):
        reason = result.warnings[-1] if result.warnings else result.trace.message
        return Judgement("refused", error, estimate, steps, reason)
    accuracy = result.asked.setting.accuracy
    assert accuracy is not None
    return Judgement("delivered" if error <= accuracy else "missed", error, estimate, steps)


def _error(result: Result, exact: Result) -> float:
    assert result.asked is not None
    sizes = Outputs(exact.observer).scales(exact.trace).outputs
    left = {*result.asked.not_judged, *exact.endless}
    worst = 0.0
    for name, value in exact.outputs.items():
        found = result.outputs[name]
        if name in left:
            continue
        if not (isinstance(value, float | int) and isinstance(found, float | int)):
            worst = max(worst, 0.0 if found == value else math.inf)
            continue
        known = sizes.get(name)
        size = max(abs(value), abs(known) if isinstance(known, float) else 0.0)
        worst = max(worst, abs(found - value) / (size or 1.0))
    return worst


def main() -> None:
    """Print a table, and every request that was missed or refused."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 104
    rng = np.random.default_rng(int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    found: list[tuple[str, Judgement]] = []
    kinds = list(SCENES)
    runners: dict[tuple[str, float], tuple[Runner, Runner]] = {}
    for number in range(count):
        kind = kinds[number % len(kinds)]
        accuracy = (1e-2, 1e-3)[number // len(kinds) % 2]
        text, draw = SCENES[kind]
        values = {name: float(value) for name, value in draw(rng).items()}
        if (kind, accuracy) not in runners:
            model = read_text(_HEAD.format(name=kind) + text)
            runners[kind, accuracy] = (
                Runner(model, engine="impulse", accuracy=accuracy),
                Runner(model, engine="auto"),
            )
        ours, theirs = runners[kind, accuracy]
        try:
            exact = theirs.run(values)
        except StatechartError as error:
            found.append((kind, Judgement("unjudged", reason=str(error))))
            continue
        judged = judge(ours.run(values, throw=False), exact)
        found.append((kind, judged))
        if judged.verdict != "delivered" or judged.error > judged.estimate:
            shown = ", ".join(f"{name}={value:.6g}" for name, value in values.items())
            print(f"{number} {kind} {accuracy:g} ({shown}): {judged.verdict}, error "
                  f"{judged.error:.2g}, estimate {judged.estimate:.2g} {judged.reason}",
                  flush=True)  # fmt: skip
    reported = [one for _, one in found if one.verdict in ("delivered", "missed")]
    ratios = [one.estimate / one.error for one in reported if one.error > _ROUNDING]
    print("\n".join(f"{v:10} {n}" for v, n in Counter(one.verdict for _, one in found).items()))
    print(f"estimate below the error: {sum(r < 1.0 for r in ratios)} of {len(reported)}, below "
          f"half of it: {sum(r < 0.5 for r in ratios)}; median ratio {np.median(ratios):.2g}; "
          f"median steps of all runs {np.median([one.steps for one in reported]):.3g}")  # fmt: skip


if __name__ == "__main__":
    main()
