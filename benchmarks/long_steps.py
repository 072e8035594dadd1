"""Time steps that are too long for a scene: whether that is said, or an answer plainly wrong.

    python benchmarks/long_steps.py [COUNT] [SEED]

Ten kinds of random scenes at random steps: particles that meet thin posts, discs, walls and edges,
discs and polygons that meet or miss each other, fast spinning bars, springs of 0.1 to 5 radians a
step, drives that steps sample too coarsely, and a bead on a wavy ground. Each is judged by the
engine that locates events, where it can run, and by the same scene in steps a hundredth as long.
Silent is what differs by more than 20 steps of the run and 5 times what is done in a step, or gains
energy from nothing, without an outcome or a warning; needless is a warning where the answer was
right, or an end where a tenth of a width, of a radian or of a hill is crossed in a step; sensitive
is where an eighth of the step is as far off.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import StatechartError
from statechart.observation.outputs import Outputs
from statechart.running.result import Result
from statechart.running.runner import Runner

__all__ = ["KINDS", "Kind", "judge", "main"]

_FLYING = """\
kind: scene
name: {name}
parameters: {{x0: -0.5, y0: 0.5, v: 10, w: 0.01, e: 0.5, mu: 0.2}}
gravity: {gravity}
bodies: {{b: {{mass: 1, start: {{x: x0, y: y0, dx: v}}}}}}
surfaces: {{s: {{{surface}}}}}
contacts: {{c: {{point: {{body: b}}, surface: s, friction: mu, restitution: e}}}}
stop: {{time: 1.5/v}}
outputs: {{x: {{value: b.x}}, y: {{value: b.y}}, dx: {{value: b.dx}}, dy: {{value: b.dy}}}}
"""
_BODIES = """\
kind: scene
name: {name}
parameters: {{x0: -0.5, y0: 0, v: 10, w: 0.02, e: 0.5, spin: 0}}
gravity: 0
bodies:
  a: {{mass: 1, inertia: 1e-3, shape: {{{one}}}, start: {{x: 0, y: 0}}}}
  b: {{mass: 1, inertia: 1e-3, shape: {{{other}}}, start: {{x: x0, y: y0, dx: v, dangle: spin}}}}
collisions: {{all: {{bodies: [a, b], friction: 0, restitution: e}}}}
stop: {{time: 1/v}}
outputs: {{x: {{value: b.x}}, y: {{value: b.y}}, dx: {{value: b.dx}}, dy: {{value: b.dy}}}}
"""
_BAR = """\
kind: scene
name: bar
parameters: {L: 0.2, y0: 0.4, dy: -2, spin: 20, e: 0.3, mu: 0.2, angle: 0.3}
gravity: 9.81
bodies: {b: {mass: 1, inertia: L**2/3, start: {y: y0, dy: dy, angle: angle, dangle: spin}}}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: b, at: [-L, 0]}, surface: floor, friction: mu, restitution: e, impact: moreau}
  B: {point: {body: b, at: [L, 0]}, surface: floor, friction: mu, restitution: e, impact: moreau}
stop: {time: 0.25}
outputs: {x: {value: b.x}, y: {value: b.y}, dy: {value: b.dy}, spin: {value: b.dangle}}
"""
_SPRING = """\
kind: scene
name: spring
parameters: {omega: 10, y0: 1.2, T: 1}
gravity: 0
bodies: {b: {mass: 1, start: {x: 0.1, y: y0}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.2, restitution: 0.5}}
forces: {f: {body: b, force: [-omega**2*b.x, -omega**2*(b.y-1)]}}
stop: {time: T}
outputs: {x: {value: b.x}, y: {value: b.y}}
"""
_DRIVE = """\
kind: scene
name: drive
parameters: {A: 10, f: 50, phase: 1, T: 1}
gravity: 9.81
bodies: {b: {mass: 1}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, modes: [slide, pin], friction: 0.1}}
forces: {f: {body: b, force: ["A*sin(2*pi*f*time+phase)", 0]}}
stop: {time: T}
outputs: {x: {value: b.x}, dx: {value: b.dx}}
"""
_BEAD = """\
kind: scene
name: bead
parameters: {A: 0.05, k: 10, v: 3, mu: 0.1}
gravity: 9.81
bodies: {b: {mass: 1, start: {y: A, dx: v}}}
surfaces: {s: {height: A*cos(k*x)}}
contacts: {c: {point: {body: b}, surface: s, friction: mu, restitution: 0}}
stop: {time: 1}
outputs: {x: {value: b.x}, y: {value: b.y}, dx: {value: b.dx}}
"""

Rng = np.random.Generator


@dataclass(frozen=True)
class Kind:
    """A scene, how its parameters are drawn, its step, and the rate of the fastest that it does."""

    text: str
    draw: Callable[[Rng], dict[str, float]]
    step: Callable[[Rng, Mapping[str, float]], float]
    rate: Callable[[Mapping[str, float]], float]
    events: bool = True


def _log(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _flying(rng: Rng) -> dict[str, float]:
    return {
        "x0": rng.uniform(-0.7, -0.4), "y0": rng.uniform(0.05, 1.1), "v": _log(rng, 1.0, 100.0),
        "w": _log(rng, 1e-3, 0.1), "e": rng.uniform(0.0, 1.0), "mu": rng.uniform(0.0, 0.5),
    }  # fmt: skip


def _bodies(rng: Rng) -> dict[str, float]:
    w = _log(rng, 3e-3, 0.1)
    return {
        "x0": rng.uniform(-0.7, -0.4), "y0": rng.uniform(-3.0, 3.0) * w, "v": _log(rng, 1.0, 100.0),
        "w": w, "e": rng.uniform(0.0, 1.0), "spin": rng.choice([0.0, rng.uniform(-50.0, 50.0)]),
    }  # fmt: skip


def _bar(rng: Rng) -> dict[str, float]:
    return {
        "L": _log(rng, 0.05, 0.3), "y0": rng.uniform(0.35, 0.6), "dy": rng.uniform(-5.0, 0.0),
        "spin": rng.choice([-1.0, 1.0]) * _log(rng, 1.0, 300.0), "e": rng.uniform(0.0, 0.8),
        "mu": rng.uniform(0.0, 0.5), "angle": rng.uniform(-1.5, 1.5),
    }  # fmt: skip


def _crossing(rng: Rng, known: Mapping[str, float]) -> float:
    """A step in which 0.03 to 10 widths are crossed."""
    return _log(rng, 0.03, 10.0) * known["w"] / known["v"]


def _ball(shape: str, gravity: float = 0.0) -> str:
    return _FLYING.format(name="flying", gravity=gravity, surface=shape)


def _across(known: Mapping[str, float]) -> float:
    return known["v"] / known["w"]


_SQUARE = "polygon: [[-w, -w], [w, -w], [w, w], [-w, w]]"
KINDS: dict[str, Kind] = {
    "post": Kind(_ball('height: "exp(-(x/w)**2)"'), _flying, _crossing, _across),
    "shelf": Kind(_ball('height: "(tanh((x+w)/(w/5)) - tanh((x-w)/(w/5)))/2"', 9.81), _flying,
                  _crossing, _across),
    "step": Kind(_ball('height: "0.5*(1+tanh(x/w))"', 9.81), _flying, _crossing, _across),
    "discs": Kind(_BODIES.format(name="discs", one="disc: w", other="disc: w"), _bodies, _crossing,
                  _across, events=False),
    "polygons": Kind(_BODIES.format(name="polygons", one=_SQUARE, other=_SQUARE), _bodies,
                     _crossing, _across, events=False),
    "mixed": Kind(_BODIES.format(
        name="mixed", one="polygon: [[-w, -10*w], [w, -10*w], [w, 10*w], [-w, 10*w]]",
        other="disc: w"), _bodies, _crossing, _across, events=False),
    "bar": Kind(_BAR, _bar, lambda rng, known: _log(rng, 0.01, 2.0) / abs(known["spin"]) / 10.0,
                lambda known: abs(known["spin"])),
    "spring": Kind(
        _SPRING,
        lambda rng: {"omega": _log(rng, 3.0, 300.0), "y0": rng.uniform(0.8, 2.5)},
        lambda rng, known: _log(rng, 0.1, 5.0) / known["omega"],
        lambda known: known["omega"],
    ),
    "drive": Kind(
        _DRIVE,
        lambda rng: {
            "A": _log(rng, 3.0, 300.0), "f": _log(rng, 5.0, 100.0), "phase": rng.uniform(0.0, 6.0)
        },
        lambda rng, known: _log(rng, 0.02, 3.0) / known["f"],
        lambda known: 2.0 * math.pi * known["f"],
    ),
    "bead": Kind(
        _BEAD,
        lambda rng: {
            "A": _log(rng, 0.01, 0.1), "k": _log(rng, 2.0, 30.0), "v": rng.uniform(-4.0, 4.0),
            "mu": rng.uniform(0.0, 0.3),
        },
        lambda rng, known: _log(rng, 0.01, 3.0) / known["k"] / 4.0,
        lambda known: known["k"] * max(abs(known["v"]), math.sqrt(9.81 / known["k"])),
    ),
}  # fmt: skip
"""Scenes that are drawn in turn."""

# An error is wrong above _ALLOWED steps of the run and _ORDER changes in a step; below _MIN_ERROR
# never, above _MAX_ERROR always.
_ALLOWED, _ORDER, _MIN_ERROR, _MAX_ERROR = 20.0, 5.0, 0.05, 0.5
# A run whose steps change less than this must reach its end.
_FOLLOWED = 0.1
# A relative energy gain above this is neither round-off nor first-order error.
_GAIN = 0.05


def _numbers(result: Result) -> np.ndarray:
    return np.array([float(v) for v in result.outputs.values()])


def _sizes(result: Result) -> np.ndarray:
    """Return how large the outputs were on the way, speeds not below those of the whole motion."""
    found = Outputs(result.observer).scales(result.trace).outputs
    return np.array([max(float(found[name]), 1e-3) for name in result.outputs])  # type: ignore[arg-type]


def _gained(result: Result) -> float:
    """Return by how much the energy rises above that of the start, in parts of its range."""
    found = result.observer.sample(result.trace, ["energy"], per_step=1).columns["energy"]
    return float(found.max() - found[0]) / max(float(np.ptp(found)), abs(float(found[0])), 1e-9)


def judge(
    kind: Kind, known: dict[str, float], step: float, runners: tuple[Runner, Runner | None]
) -> tuple[str, str]:
    """Return what became of a run, and why."""
    model = runners[0].model
    coarse = Runner(model, engine="impulse", step=step).run(known, throw=False)
    refused = coarse.trace.outcome is not Outcome.HORIZON
    said = refused or any("replaced" not in w and "applies" not in w and "bodies that collide" not
                          in w for w in coarse.warnings)  # fmt: skip
    half = Runner(model, engine="impulse", step=step / 8.0).run(known, throw=False)
    exact: Result | None = None
    if runners[1] is not None:
        try:
            exact = runners[1].run(known, throw=False)
        except StatechartError:
            exact = None
    if exact is None or not exact.trace.outcome.succeeded:
        exact = Runner(model, engine="impulse", step=step / 100.0).run(known, throw=False)
    if not exact.trace.outcome.succeeded:
        return "unjudged", exact.trace.message
    if refused:
        followed = step * kind.rate(known) < _FOLLOWED
        return ("needless" if followed else "reported"), coarse.trace.message
    gained = 0.0 if "drive" in model.name else _gained(coarse) - max(_gained(exact), 0.0)
    ours, theirs = _numbers(coarse), _numbers(exact)
    end = exact.trace.t_end
    scale = np.maximum(_sizes(exact), _sizes(coarse))
    error = float((np.abs(ours - theirs) / scale).max())
    # Where shorter steps do not converge, the motion is too sensitive for a comparison.
    unclear = (
        not half.trace.outcome.succeeded
        or float((np.abs(_numbers(half) - theirs) / scale).max()) > 0.3
    )
    # A bounce off an obstacle that a step crosses is compared by its side only.
    allowed = max(_ALLOWED * step / end, _ORDER * step * kind.rate(known), _MIN_ERROR)
    wrong = error > min(allowed, _MAX_ERROR) or gained > _GAIN
    if not wrong and not (said and error > _MIN_ERROR):
        return ("needless" if said else "right"), f"error {error:.2g}"
    if said:
        return "reported", coarse.warnings[-1] if coarse.warnings else ""
    if unclear and gained <= _GAIN:
        return "sensitive", f"error {error:.2g}"
    return "silent", f"error {error:.2g}, gained {gained:.2g}"


def main() -> None:
    """Print a table, and every silent case."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    rng = np.random.default_rng(int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    verdicts: Counter[tuple[str, str]] = Counter()
    names = list(KINDS)
    runners: dict[str, tuple[Runner, Runner | None]] = {}
    for number in range(count):
        name = names[number % len(names)]
        kind = KINDS[name]
        known = {k: float(v) for k, v in kind.draw(rng).items()}
        step = kind.step(rng, known)
        if name not in runners:
            model = read_text(kind.text)
            events = Runner(model, engine="auto") if kind.events else None
            runners[name] = Runner(model, engine="impulse", step=1e-3), events
        try:
            verdict, why = judge(kind, known, step, runners[name])
        except StatechartError as error:
            verdict, why = "unjudged", str(error)
        verdicts[name, verdict] += 1
        if verdict in ("silent", "needless", "unjudged", "sensitive"):
            shown = ", ".join(f"{k}={v:.6g}" for k, v in known.items())
            print(f"{number} {name} step={step:.3g} ({shown}): {verdict}, {why[:120]}", flush=True)
    for (name, verdict), times in sorted(verdicts.items()):
        print(f"{name:10} {verdict:10} {times}")
    totals: Counter[str] = Counter()
    for (_, verdict), times in verdicts.items():
        totals[verdict] += times
    print(dict(totals))


if __name__ == "__main__":
    main()
