"""Forces, paths and controls that change in a fraction of a step: how often a run misses one.

    python benchmarks/narrow_features.py [COUNT] [SEED]

A pulse or a switch (tanh, exp or rational) of a width of 1e-4 to 1 of the run, at a random time or
place. A run is judged by SciPy, with the feature given: quadrature for what depends on time
alone, an integration that is cut at the feature for the others. A run is wrong if it is off by more
than a thousand times its tolerance (whose power an order below counts with scipy), or, where an
accuracy was asked for, by more than that without saying so.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import quad, solve_ivp

from statechart.documents.yaml_reader import read_text
from statechart.errors import SimulationError
from statechart.running.runner import Runner

END = 4.0
# What changes, in u = (x - where) / w; and numpy's.
SHAPES: dict[str, Callable[[float], float]] = {
    "(1+tanh(U))/2": lambda u: 0.5 * (1.0 + math.tanh(u)),
    "exp(-(U)**2)": lambda u: math.exp(-min(u * u, 700.0)),
    "1/(1+(U)**2)": lambda u: 1.0 / (1.0 + u * u),
    "1/(1+exp(-(U)))": lambda u: 1.0 / (1.0 + math.exp(min(-u, 700.0))),
    "exp(-(U)**4)": lambda u: math.exp(-min(u**4, 700.0)),
    "1/sqrt(1+(U)**2)": lambda u: 1.0 / math.sqrt(1.0 + u * u),
    "atan(U)": math.atan,
    "1/cosh(U)": lambda u: 1.0 / math.cosh(min(abs(u), 700.0)),
}
CHOICES: tuple[dict[str, object], ...] = (
    {"engine": "taylor"},
    {"engine": "scipy", "method": "DOP853", "tolerance": 1e-8},
    {"engine": "scipy", "method": "RK45", "tolerance": 1e-6},
    {"engine": "scipy", "method": "Radau", "tolerance": 1e-6},
    {"engine": "scipy", "method": "LSODA", "tolerance": 1e-6},
    {"accuracy": 1e-6},
    {"engine": "scipy", "method": "DOP853", "accuracy": 1e-6},
    {"engine": "scipy", "method": "RK45", "accuracy": 1e-4},
)

FALL = """\
kind: scene
name: fall
gravity: 9.81
bodies: {{b: {{mass: 1, start: {{y: 1000, dx: {speed!r}}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{c: {{point: {{body: b}}, surface: floor, friction: 0.3, restitution: 0.5}}}}
{forces}
stop: {{time: 4}}
outputs: {{x: {{value: b.x}}, y: {{value: b.y}}, dx: {{value: b.dx}}, dy: {{value: b.dy}}}}
"""
FORCE = "forces: {{f: {{body: b, force: ['{x}', '{y}']}}}}"
CONTROL = (
    "controls: {{push: 0, lift: 0}}\n"
    "regions: {{r: {{initial: s, states: {{s: {{sets: {{push: '{x}', lift: '{y}'}}}}}}}}}}\n"
    "forces: {{f: {{body: b, force: [push, lift]}}}}"
)
PENDULUM = """\
kind: scene
name: pendulum
gravity: 9.81
bodies: {{b: {{mass: 1, inertia: 0.1, start: {{x: {start}, y: -1, angle: 0, dx: {rate}}}}}}}
joints: {{j: {{point: {{body: b, at: [0, 1]}}, to: ['{path}', 0]}}}}
stop: {{time: 4}}
outputs: {{angle: {{value: b.angle}}, rate: {{value: b.dangle}}}}
"""


@dataclass(frozen=True)
class Case:
    """A scene with its outputs, and what they are measured by."""

    kind: str
    text: str
    outputs: dict[str, float]
    sizes: dict[str, float]


def case(rng: np.random.Generator) -> Case:
    """Draw a scene."""
    shape = str(rng.choice(list(SHAPES)))
    w = END * 10.0 ** rng.uniform(-4.0, 0.0)
    at = rng.uniform(0.05, 0.95)
    size = float(10.0 ** rng.uniform(0.0, 2.0) * rng.choice([-1.0, 1.0]))
    kind = str(rng.choice(["time", "control", "place", "speed", "path"]))
    make = {"time": _in_time, "control": _in_time, "path": _path}.get(kind, _in_state)
    return make(kind, shape, w, at, size, rng)


def _u(shape: str, what: str, where: float, w: float) -> str:
    return shape.replace("U", f"({what}-{where!r})/{w!r}")


def _in_time(
    kind: str, shape: str, w: float, at: float, size: float, rng: np.random.Generator
) -> Case:
    t0, f, share, speed = at * END, SHAPES[shape], rng.uniform(0.0, 1.0), rng.uniform(-5.0, 5.0)
    form = _u(shape, "time", t0, w)
    text = (FORCE if kind == "time" else CONTROL).format(
        x=f"{size * share!r}*{form}", y=f"{size * (1.0 - share)!r}*{form}"
    )
    near = sorted({min(max(t0 + k * w, 0.0), END) for k in (-100, -30, -10, -3, 0, 3, 10, 30, 100)})

    def integral(g: Callable[[float], float]) -> float:
        ends = [0.0, *near, END]
        return math.fsum(
            quad(g, a, b, epsabs=1e-14, epsrel=1e-13, limit=500)[0]
            for a, b in pairwise(ends)
            if b > a
        )

    v, s = integral(lambda t: f((t - t0) / w)), integral(lambda t: (END - t) * f((t - t0) / w))
    outputs = {
        "x": speed * END + size * share * s,
        "y": 1000.0 - 0.5 * 9.81 * END**2 + size * (1.0 - share) * s,
        "dx": speed + size * share * v,
        "dy": -9.81 * END + size * (1.0 - share) * v,
    }
    sizes = {"x": 10.0 + abs(outputs["x"]), "y": 1000.0, "dx": 10.0 + abs(speed), "dy": 40.0}
    return Case(kind, FALL.format(speed=speed, forces=text), outputs, sizes)


def _in_state(
    kind: str, shape: str, w: float, at: float, size: float, rng: np.random.Generator
) -> Case:
    f, speed = SHAPES[shape], rng.uniform(2.0, 5.0)
    size = abs(size)  # never turns back
    if kind == "place":
        where, what, width, i = at * END * speed, "b.x", w * speed, 0
    else:
        where, what, width, i = -at * END * 9.81, "b.dy", w * 9.81, 3
    push = [size, 0.0]
    text = FORCE.format(x=f"{size!r}*{_u(shape, what, where, width)}", y="0")

    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[2], z[3], push[0] * f((z[i] - where) / width), -9.81]

    z, t = np.array([0.0, 1000.0, speed, 0.0]), 0.0
    sign = 1.0 if i == 0 else -1.0
    for edge in (-100, -30, -10, -3, -1, 0, 1, 3, 10, 30, 100, None):
        # With its own step size control the reference misses the feature.
        ahead = math.inf if edge is None else edge - sign * (z[i] - where) / width
        longest = min(0.2, 0.1 * w * max(ahead, 1.0))

        def stop(t: float, z: np.ndarray, edge: int | None = edge) -> float:
            return 1.0 if edge is None else sign * (z[i] - where) / width - edge

        if edge is not None and stop(t, z) >= 0.0:
            continue
        stop.terminal = True  # type: ignore[attr-defined]
        found = solve_ivp(
            rates, (t, END), z, "DOP853", rtol=1e-13, atol=1e-13, events=stop, max_step=longest
        )
        z, t = found.y[:, -1], float(found.t[-1])
        if t >= END:
            break
    outputs = dict(zip(("x", "y", "dx", "dy"), z.tolist(), strict=True))
    sizes = {"x": abs(z[0]) + 10.0, "y": 1000.0, "dx": abs(z[2]) + 10.0, "dy": 40.0}
    return Case(kind, FALL.format(speed=speed, forces=text), outputs, sizes)


def _path(
    kind: str, shape: str, w: float, at: float, size: float, rng: np.random.Generator
) -> Case:
    f, t0 = SHAPES[shape], at * END
    reach = math.copysign(min(0.3, abs(size) * w), size)  # no faster than its size

    def path(t: float) -> float:
        return reach * f((t - t0) / w)

    # With u = x' of the pivot: p = angle' (I + m) + u cos(angle) needs no second derivative.
    step = 1e-4 * w

    def speed(t: float) -> float:
        return (
            path(t - 2 * step) - 8 * path(t - step) + 8 * path(t + step) - path(t + 2 * step)
        ) / (12 * step)

    def rates(t: float, z: np.ndarray) -> list[float]:
        u, c, s = speed(t), math.cos(z[0]), math.sin(z[0])
        rate = (z[1] - u * c) / 1.1
        return [rate, -u * rate * s - 9.81 * s]

    z, t = np.array([0.0, speed(0.0)]), 0.0
    for edge in (-100, -30, -10, -3, -1, 0, 1, 3, 10, 30, 100, math.inf):
        end = min(t0 + edge * w, END)
        if end > t:
            found = solve_ivp(rates, (t, end), z, "DOP853", rtol=1e-12, atol=1e-12, max_step=0.2)
            z, t = found.y[:, -1], end
    u, c = speed(END), math.cos(z[0])
    outputs = {"angle": float(z[0]), "rate": float((z[1] - u * c) / 1.1)}
    form = f"{reach!r}*{_u(shape, 'time', t0, w)}"
    text = PENDULUM.format(path=form, start=repr(path(0.0)), rate=repr(speed(0.0)))
    return Case(kind, text, outputs, {"angle": 1.0, "rate": 3.0 + abs(size)})


def judge(found: Case, choice: dict[str, object]) -> tuple[str, float]:
    """Return delivered, refused or wrong, and how far a run was off."""
    try:
        result = Runner(read_text(found.text), **choice).run()  # type: ignore[arg-type]
    except SimulationError as error:
        return f"ended: {error}", math.inf
    off = max(
        abs(float(result.outputs[name]) - value) / found.sizes[name]
        for name, value in found.outputs.items()
    )
    asked = choice.get("accuracy")
    if asked is not None:
        if result.asked is None or not result.asked.reached(result.error_estimate):
            return "refused", off
        return ("delivered" if off <= float(asked) else "wrong"), off  # type: ignore[arg-type]
    tolerance = float(choice.get("tolerance", 1e-10))  # type: ignore[arg-type]
    return ("delivered" if off <= 50.0 * tolerance**0.85 else "wrong"), off


def main() -> None:
    """Print a table, and every case that was not delivered."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    rng = np.random.default_rng(int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    verdicts: Counter[tuple[str, str]] = Counter()
    for number in range(count):
        found, choice = case(rng), CHOICES[number % len(CHOICES)]
        verdict, off = judge(found, choice)
        verdicts[" ".join(map(str, choice.values())), verdict[:9]] += 1
        if verdict != "delivered":
            print(f"{number}: {found.kind} {choice} {verdict} by {off:.2g}", flush=True)
            print(found.text)
    for (name, verdict), times in sorted(verdicts.items()):
        print(f"{name:30} {verdict:10} {times}")


if __name__ == "__main__":
    main()
