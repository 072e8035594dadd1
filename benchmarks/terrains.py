"""Two thousand steep hills and narrow bumps on both engines: is any impact missed?

A ball is thrown over a random terrain and bounces for a second. Every flight of a run is a
parabola from a known state, so that where it ends is known without integration: brute force
marches along it, as far at a time as the terrain's curvature cannot reach up. Counted are impacts
that were missed, came early or late, and runs that are not certified. Each run is also made up
to just behind its first impact, and what that takes in all is reported, in CPU time.

    python benchmarks/terrains.py [--terrains N] [--engine taylor|scipy]
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np

from contacts.kind import automaton
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from statechart.automaton.trace import Trace
from statechart.documents.setting import Setting
from statechart.documents.settings import Settings
from statechart.engines.request import choose
from statechart.execution import compiled_loop
from statechart.execution.simulator import Simulator

_G, _UNTIL = 9.81, 1.0
_HILLS, _BUMP = "A*sin(k*x + phase)", "A*exp(-((x - c)/w)**2)"
# Of the scene's lengths of about 1: how far the ball may be off where its impact is reported.
_OFF = 1e-9
# Duration of a timed run after its first impact.
_JUST = 1e-3
# Flights rise so far at least; lower ones are captured.
_LOW = 1e-8


def scene(name: str, height: str, numbers: dict[str, float]) -> Scene:
    """Return a ball without friction over a terrain."""
    start = {"x": 0.0, "y": 5.0, "u": 0.0, "v": 0.0, "e": 0.5}
    return Scene(
        name=name,
        gravity=_G,
        settings=Settings(max_jumps=1000),
        parameters={f"{key}0" if key != "e" else key: value for key, value in start.items()}
        | numbers,
        bodies={"ball": Body(mass=1, start={"x": "x0", "y": "y0", "dx": "u0", "dy": "v0"})},
        surfaces={"ground": Surface(height=height)},
        contacts={
            "tip": Contact(
                point=Point(body="ball", at=(0, 0)),
                surface="ground",
                modes=("free", "slide"),
                friction=0,
                restitution="e",
            )
        },
    )


@dataclass(frozen=True)
class Terrain:
    """A height function with its slope and a bound of its curvature."""

    numbers: dict[str, float]

    @property
    def bump(self) -> bool:
        return "c" in self.numbers

    @property
    def curvature(self) -> float:
        n = self.numbers
        # |f''| <= 2 a / w^2 for the bell a exp(-(u / w)^2).
        return 2.0 * n["A"] / n["w"] ** 2 if self.bump else n["A"] * n["k"] ** 2

    def at(self, x: float) -> tuple[float, float]:
        n = self.numbers
        if self.bump:
            u = (x - n["c"]) / n["w"]
            height = n["A"] * math.exp(-u * u)
            return height, -2.0 * u / n["w"] * height
        angle = n["k"] * x + n["phase"]
        return n["A"] * math.sin(angle), n["A"] * n["k"] * math.cos(angle)

    def impact(self, x: float, y: float, u: float, v: float, end: float) -> float | None:
        """Return when a parabola from above the ground first meets it, up to `end`."""

        def gap(t: float) -> float:
            return y + t * (v - _G * t / 2) - self.at(x + u * t)[0]

        def rate(t: float) -> float:
            return v - _G * t - u * self.at(x + u * t)[1]

        # gap'' >= -bend: a step that a parabola of that curvature allows cannot pass a root.
        bend = _G + u * u * self.curvature
        t = 0.0
        if gap(0.0) <= _LOW:
            t = rate(0.0) / bend
        while t <= end:
            g, w = gap(t), rate(t)
            step = (w + math.sqrt(w * w + 2.0 * bend * max(g, 0.0))) / bend
            if g <= 0.0 or step <= 4e-16 * t:
                return t
            t += step
        return None


def draw(random: np.random.Generator, index: int) -> tuple[Terrain, dict[str, float]]:
    """Return a terrain, and where and how fast the ball starts above it."""
    x, u = random.uniform(-1, 1), random.uniform(0.5, 8) * random.choice([-1, 1])
    height = random.uniform(0.2, 2)
    if index % 2:
        width = abs(u) * 10 ** random.uniform(-3, -1)
        numbers = {"A": height, "c": x + u * random.uniform(0.05, 0.95), "w": width}
        y = random.uniform(0.05, 2)
    else:
        numbers = {"A": height, "k": random.uniform(3, 60), "phase": random.uniform(0, 2 * math.pi)}
        y = height + random.uniform(-0.2, 0.6)
    terrain = Terrain({key: float(value) for key, value in numbers.items()})
    ground = terrain.at(x)[0]
    y = y if y > ground + 1e-3 else ground + 0.05
    start = {"x0": x, "y0": y, "u0": u, "v0": random.uniform(-3, 5), "e": random.uniform(0.2, 0.9)}
    return terrain, {key: float(value) for key, value in start.items()}


def compare(terrain: Terrain, trace: Trace, found: Counter[str]) -> float:
    """Count how the flights of a run ended; return how far off the worst impact was."""
    state, since, worst = trace.initial, 0.0, 0.0
    flights = [(jump.t, jump.before) for jump in trace.jumps] + [(trace.t_end, None)]
    for number, (until, before) in enumerate(flights):
        x, y, u, v = state.tolist()
        rise = v - u * terrain.at(x)[1]
        if number and rise**2 < 2.0 * _LOW * (_G + u * u * terrain.curvature):
            break  # captured, or on the ground
        truth = terrain.impact(x, y, u, v, until - since)
        found["flights"] += 1
        if before is None:
            found["missed"] += truth is not None and truth < (until - since) * (1 - 1e-12)
            break
        found["impacts"] += 1
        slope = abs(before[3] - before[2] * terrain.at(float(before[0]))[1])
        off = math.inf if truth is None else abs(until - since - truth) * slope
        if truth is None:
            # The march stops short of an impact at the end of the flight by rounding.
            off = abs(float(before[1]) - terrain.at(float(before[0]))[0])
        worst = max(worst, off)
        if off > _OFF:
            found["missed" if truth is not None and truth < until - since else "invented"] += 1
        jump = trace.jumps[number]
        if jump.skipped > 0.0 or jump.target != ("free",):
            break
        state, since = jump.after, until
    return worst


def soak(count: int, engine: str, seed: int) -> tuple[Counter[str], float, list[float]]:
    """Run and compare so many terrains; return what each first impact took, too."""
    random = np.random.default_rng(seed)
    scenes = (
        scene("hills", _HILLS, {"A": 1.0, "k": 3.0, "phase": 0.0}),
        scene("bump", _BUMP, {"A": 1.0, "c": 1.0, "w": 0.1}),
    )
    simulators = [Simulator(automaton(one), choose(Setting(engine))[0]) for one in scenes]
    found: Counter[str] = Counter()
    worst, spent = 0.0, []
    for index in range(count):
        terrain, start = draw(random, index)
        trace = simulators[index % 2].run(start | terrain.numbers, until=_UNTIL, throw=False)
        found["runs"] += 1
        found["without impact"] += not trace.jumps
        found["not certified"] += not trace.certified
        found["ended early"] += not trace.outcome.succeeded
        worst = max(worst, compare(terrain, trace, found))
        if trace.jumps:
            first, end = trace.jumps[0].t, (trace.jumps[1].t if len(trace.jumps) > 1 else _UNTIL)
            began = time.process_time()
            simulators[index % 2].run(
                start | terrain.numbers, until=min(0.5 * (first + end), first + _JUST), throw=False
            )
            spent.append(time.process_time() - began)
    return found, worst, spent


def main() -> None:
    """Print the counts."""
    # What is timed are runs in compiled loops, as of runners that make many.
    compiled_loop._WORTH_COMPILING = 0
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--terrains", type=int, default=2000)
    parser.add_argument("--engine", choices=["taylor", "scipy"], nargs="+")
    parser.add_argument("--seed", type=int, default=20)
    chosen = parser.parse_args()
    for engine in chosen.engine or ("taylor", "scipy"):
        began = time.perf_counter()
        found, worst, spent = soak(chosen.terrains, engine, chosen.seed)
        took = time.perf_counter() - began
        print(f"{engine}: {took:.0f} s, impacts off the ground by at most {worst:.1e}")
        some = " ".join(f"{1e6 * value:.0f}" for value in np.percentile(spent, (10, 50, 90)))
        print(f"  first impact, in all, us: 10, 50 and 90 % of {len(spent)} take up to {some}")
        for name in ("runs", "flights", "impacts", "without impact", "missed", "invented",
                     "not certified", "ended early"):  # fmt: skip
            print(f"  {name:16} {found[name]}")


if __name__ == "__main__":
    main()
