"""A soak over random scenes: nothing tunnels, nothing ends unexplained.

Scenes of one to four contacts (balls on hills, sticks, boxes on slopes and in corners, balls that
meet) start from random positions and velocities with random friction and restitution. Every run is
sampled densely; counted are events, outcomes, and the deepest gap in units of its tolerance. An end
before the horizon is explained only where the physics has no unique continuation and the outcome
names why (a dead point). All else, a loop, a budget spent, a failed step, a state without mode, or
a gap beyond 1.1 tolerances, is a defect and is printed with what reproduces it.

    python benchmarks/soak.py [--events N] [--seed S] [--engine taylor|scipy] [--scene NAME]
        [--log FILE]

Run k of a scene draws its numbers from the seed (S, the scene's place, k). With a log an
interrupted soak goes on where it ended.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from contacts.kind import automaton
from contacts.scene.parts import Body, Contact, Coordinate, Point, Surface
from contacts.scene.scene import Scene
from statechart.automaton.trace import Outcome, Trace
from statechart.documents.setting import Setting
from statechart.documents.settings import Settings
from statechart.engines.request import choose
from statechart.execution.simulator import Simulator
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape
from statechart.reporting.report import lowest

Numbers = Mapping[str, float]
Draw = Callable[[np.random.Generator], dict[str, float]]

START = {"x": "x0", "y": "y0", "angle": "a0", "dx": "u0", "dy": "w0", "dangle": "r0"}
BALL = {name: START[name] for name in ("x", "y", "dx", "dy")}
_LONGEST = 2000
_ENDED = (Outcome.HORIZON.name, Outcome.TOO_MANY_JUMPS.name)


def scene(
    name: str,
    bodies: Mapping[str, Body],
    surfaces: Mapping[str, Surface],
    points: Mapping[str, tuple[str, tuple[str | float, str | float], str]],
    parameters: Mapping[str, float],
    coordinates: Mapping[str, Coordinate] | None = None,
) -> Scene:
    """Return a scene whose contacts all have friction mu and restitution e."""
    return Scene(
        name=name,
        coordinates=dict(coordinates or {}),
        gravity="g",
        settings=Settings(max_jumps=_LONGEST),
        parameters={"g": 1, "mu": 0.5, "e": 0.5, **parameters},
        bodies=dict(bodies),
        surfaces=dict(surfaces),
        contacts={
            label: Contact(
                point=Point(body=body, at=at), surface=surface, friction="mu", restitution="e"
            )
            for label, (body, at, surface) in points.items()
        },
    )


def coefficients(random: np.random.Generator) -> dict[str, float]:
    return {
        "mu": float(random.choice([0.0, random.uniform(0, 1), 10 ** random.uniform(-6, 4)])),
        "e": float(random.choice([0.0, random.uniform(0, 0.98), 1.0], p=[0.4, 0.5, 0.1])),
    }


def motion(random: np.random.Generator, height: float) -> dict[str, float]:
    return {
        "x0": random.uniform(-1, 1),
        "y0": height + random.uniform(0, 2),
        "a0": random.uniform(-math.pi, math.pi),
        "u0": random.normal(),
        "w0": random.normal(),
        "r0": random.normal(),
    }


def explained(outcome: str, message: str) -> bool:
    """Return whether a run ended where it should.

    At a dead point the constraints of the contacts that the message names have become dependent
    (`contacts.impacts.jamming.dead_point` has tested the rank there): the paths that the contacts
    allow branch, and on the way there the forces that keep to one branch grow without bound, as
    1/angle against the path, unless masses and friction are in balance. Rigid bodies have no unique
    continuation then. Other singular modes are defects: no scene here has equations that leave
    something open by nature.
    """
    if outcome == Outcome.SINGULAR_MODE.name:
        return "a dead point of the linkage" in message
    return outcome in _ENDED


@dataclass(frozen=True)
class Family:
    """Scenes of one structure, and how their numbers are drawn."""

    scene: Scene
    draw: Draw


def families() -> dict[str, Family]:
    """Return the scenes."""
    zero = dict.fromkeys(("x0", "y0", "a0", "u0", "w0", "r0"), 0.0) | {"y0": 5.0}
    rod = Body(mass=1, inertia="k", start=START)
    box = Body(mass=1, inertia="(b**2 + h**2)/3", start=START)
    corners = {f"c{i}": ("box", (f"{x}*b", f"{y}*h"), "floor")
               for i, (x, y) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1)))}  # fmt: skip
    floor, hill = Surface(height=0), Surface(height="A*sin(w*x)")

    def rod_numbers(random: np.random.Generator) -> dict[str, float]:
        return {**motion(random, 1.0), **coefficients(random), "k": 10 ** random.uniform(-4, 0.5)}

    def box_numbers(random: np.random.Generator) -> dict[str, float]:
        b, h = random.uniform(0.1, 1, size=2)
        found = {**motion(random, math.hypot(b, h)), **coefficients(random), "b": b, "h": h}
        return found | {"slope": random.uniform(-0.5, 0.5), "y0": found["y0"] + 1.5}

    def ball_numbers(random: np.random.Generator) -> dict[str, float]:
        found = {**motion(random, 1.0), **coefficients(random)}
        return found | {"A": random.uniform(0, 1), "w": random.uniform(0.5, 8)}

    def pair_numbers(random: np.random.Generator) -> dict[str, float]:
        found = {**motion(random, 0.6), **coefficients(random)}
        return found | {"y1": found["y0"] + random.uniform(1.5, 3), "m": 10 ** random.normal()}

    def hilly_rod_numbers(random: np.random.Generator) -> dict[str, float]:
        found = rod_numbers(random) | {"A": random.uniform(0, 0.5), "w": random.uniform(0.5, 4)}
        return found | {"y0": found["y0"] + 0.5}

    def linkage_numbers(random: np.random.Generator) -> dict[str, float]:
        found = rod_numbers(random) | {"b0": random.uniform(-math.pi, math.pi)}
        return found | {"y0": found["y0"] + 2.0, "m": 10 ** random.normal()}

    return {
        "ball on hills": Family(
            scene(
                "hills",
                {"ball": Body(mass=1, start=BALL)},
                {"floor": hill},
                {"tip": ("ball", (0, 0), "floor")},
                {**zero, "A": 0.5, "w": 2},
            ),
            ball_numbers,
        ),
        "rod on floor": Family(
            scene(
                "rod",
                {"rod": rod},
                {"floor": floor},
                {"A": ("rod", (0, -1), "floor"), "B": ("rod", (0, 1), "floor")},
                {**zero, "k": 0.3},
            ),
            rod_numbers,
        ),
        "rod on hills": Family(
            scene(
                "rod_on_hills",
                {"rod": rod},
                {"floor": hill},
                {"low": ("rod", (0, -1), "floor"), "high": ("rod", (0, 1), "floor")},
                {**zero, "k": 0.3, "A": 0.5, "w": 2},
            ),
            hilly_rod_numbers,
        ),
        "two rods on a hinge": Family(
            scene(
                "linkage",
                {
                    "one": Body(
                        mass=1, inertia="k", position=("x - sin(a)", "y + cos(a)"), angle="a"
                    ),
                    "other": Body(
                        mass="m", inertia="k*m", position=("x - sin(b)", "y + cos(b)"), angle="b"
                    ),
                },
                {"floor": floor},
                {
                    "hinge": ("one", (0, -1), "floor"),
                    "A": ("one", (0, 1), "floor"),
                    "B": ("other", (0, 1), "floor"),
                },
                {**zero, "b0": 1, "k": 0.3, "m": 1},
                {
                    "x": Coordinate(start="x0", rate="u0"),
                    "y": Coordinate(start="y0", rate="w0"),
                    "a": Coordinate(start="a0", rate="r0"),
                    "b": Coordinate(start="b0", rate="-r0"),
                },
            ),
            linkage_numbers,
        ),
        "rod in a corner": Family(
            scene(
                "corner",
                {"rod": rod},
                {"floor": floor, "wall": Surface(line=((-3, 1), (-3, 0)))},
                {
                    "A": ("rod", (0, -1), "floor"),
                    "B": ("rod", (0, 1), "floor"),
                    "C": ("rod", (0, -1), "wall"),
                    "D": ("rod", (0, 1), "wall"),
                },
                {**zero, "k": 0.3},
            ),
            rod_numbers,
        ),
        "box on a slope": Family(
            scene(
                "slope",
                {"box": box},
                {"floor": Surface(incline="slope")},
                corners,
                {**zero, "b": 0.5, "h": 0.5, "slope": 0.1},
            ),
            box_numbers,
        ),
        "two balls on a floor": Family(
            scene(
                "pair",
                {
                    "low": Body(mass=1, start=BALL),
                    "high": Body(mass="m", start={"x": "x0/10", "y": "y1"}),
                },
                {"floor": floor, "shell": Surface(circle=(0, 0), radius=1, body="low")},
                {
                    "ground": ("low", (0, -0.5), "floor"),
                    "between": ("high", (0, 0), "shell"),
                    "far": ("high", (0, -0.5), "floor"),
                },
                {**zero, "y1": 9, "m": 1},
            ),
            pair_numbers,
        ),
    }


@dataclass(frozen=True, eq=False)
class Running:
    """A family on an engine: everything is compiled once, and only numbers change."""

    family: Family
    simulator: Simulator
    gaps: Tape

    @classmethod
    def of(cls, family: Family, engine: str) -> Running:
        built = automaton(family.scene)
        return cls(
            family,
            Simulator(built, choose(Setting(engine))[0]),
            compile_tape(
                [built.observables[f"{name}.gap"] for name in family.scene.contacts],
                variables=built.variables,
                parameters=built.parameters,
                time=built.time,
            ),
        )

    def run(self, seed: list[int]) -> tuple[Trace, float]:
        """Return the run of a seed, and its deepest gap on a grid in every step, in tolerances."""
        numbers = self.family.draw(np.random.default_rng(seed))
        trace = self.simulator.run(numbers, until=20.0, throw=False)
        values = np.array(list(trace.parameters.values()))
        least = 0.0
        for arc in trace.arcs:
            found = lowest(self.gaps, [arc], values)
            least = min(least, float(found.min()))
        return trace, -least / trace.tolerances["gap"]


class Tally:
    """Counts of a soak test; read from the log of an interrupted one, and continued run by run."""

    def __init__(self, log: Path | None) -> None:
        self.runs: Counter[str] = Counter()
        self.events: Counter[str] = Counter()
        self.outcomes: Counter[str] = Counter()
        self.deepest, self.defects = 0.0, 0
        self._log = log
        if log is not None and log.exists():
            for line in log.read_text().splitlines():
                self._add(json.loads(line))

    def _add(self, record: dict[str, Any]) -> None:
        name = record["scene"]
        self.runs[name] += 1
        self.events[name] += record["events"]
        self.outcomes[record["outcome"]] += 1
        self.deepest = max(self.deepest, record["deepest"])
        self.defects += self._defective(record)

    @staticmethod
    def _defective(record: dict[str, Any]) -> bool:
        explained_end = explained(record["outcome"], record.get("message", ""))
        return not explained_end or record["deepest"] > 1.1

    def add(self, name: str, trace: Trace, deepest: float) -> None:
        """Add a run."""
        record = {
            "scene": name,
            "run": self.runs[name],
            "events": len(trace.jumps),
            "outcome": trace.outcome.name,
            "deepest": deepest,
        }
        if trace.outcome.name not in _ENDED or deepest > 1.1:
            record |= {"message": trace.message}
        if self._defective(record):
            print(json.dumps(record, indent=2), flush=True)
        self._add(record)
        if self._log is not None:
            with self._log.open("a") as stream:
                stream.write(json.dumps(record) + "\n")


def soak(events: int, seed: int, engine: str, only: str | None, log: Path | None) -> int:
    """Run until so many events were seen; return the number of defects."""
    chosen = {name: f for name, f in families().items() if only in (None, name)}
    places = {name: place for place, name in enumerate(families())}
    running = {name: Running.of(family, engine) for name, family in chosen.items()}
    tally, began = Tally(log), time.perf_counter()
    while tally.events.total() < events:
        # The scene with the fewest events so far: where little happens, more runs are made.
        name = min(chosen, key=lambda one: tally.events[one])
        tally.add(name, *running[name].run([seed, places[name], tally.runs[name]]))
        if time.perf_counter() - began > 60.0:
            began = time.perf_counter()
            print(f"{tally.events.total()} events", file=sys.stderr, flush=True)
    print(f"events: {dict(tally.events)}")
    print(f"runs: {dict(tally.runs)}")
    print(f"outcomes: {dict(tally.outcomes)}")
    print(f"deepest gap: {tally.deepest:.6g} of its tolerance; defects: {tally.defects}")
    return tally.defects


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--events", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", default="taylor", choices=("taylor", "scipy"))
    parser.add_argument("--scene", default=None)
    parser.add_argument("--log", type=Path, default=None, help="runs, one a line; continued")
    arguments = parser.parse_args()
    sys.exit(
        bool(
            soak(
                arguments.events,
                arguments.seed,
                arguments.engine,
                arguments.scene,
                arguments.log,
            )
        )
    )
