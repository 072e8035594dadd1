"""`accuracy = 1e-6` on random scenes: how often it is delivered, refused with the reason, missed.

    python benchmarks/accuracy_of_random_scenes.py [COUNT] [SEED]

Four kinds of scenes take turns: balls on hills, toppling sticks, blocks under a harmonic force,
and bars that fall on their two ends. A run is judged by the tightest run of the other engine.
Where the tightest runs of the two differ by so much that it matters, nothing can be judged.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from statechart.documents.yaml_reader import read_text
from statechart.errors import StatechartError
from statechart.running.accuracy import EvaluatedRun
from statechart.running.result import Result
from statechart.running.runner import Runner

__all__ = [
    "ACCURACY",
    "BAR",
    "ENGINES",
    "SCENES",
    "Judgement",
    "Judges",
    "draws",
    "requests",
    "table",
]

ACCURACY = 1e-6
ENGINES: dict[str, dict[str, str]] = {
    "auto": {},
    "scipy DOP853": {"engine": "scipy", "method": "DOP853"},
    "scipy RK45": {"engine": "scipy", "method": "RK45"},
}

# A bar falls on its two ends; `tilt` from level, A is the left end.
BAR = """\
kind: scene
name: falling_bar
parameters: {L: 1, tilt: 0.1, drop: 0.3, mu: 0.3, e: 0, v: 0, I_G: 1/3}
gravity: 9.81
bodies:
  bar:
    mass: 1
    inertia: I_G
    start: {x: 0, y: drop + L*sin(abs(tilt)), angle: tilt, dx: v}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: bar, at: [-L, 0]}, surface: floor, friction: mu, restitution: e}
  B: {point: {body: bar, at: [L, 0]}, surface: floor, friction: mu, restitution: e}
stop: {time: 2}
outputs:
  x_end: {value: bar.x}
"""

Draw = Callable[[np.random.Generator], dict[str, float]]


def _hills(rng: np.random.Generator) -> dict[str, float]:
    return {
        "A": rng.uniform(0.1, 1.0),
        "k": rng.uniform(1.0, 20.0),
        "phase": rng.uniform(0.0, 2 * math.pi),
        "y0": rng.uniform(1.05, 3.0),
        "vx0": rng.uniform(-8.0, 8.0),
        "vy0": rng.uniform(-3.0, 3.0),
        "e": rng.uniform(0.1, 0.9),
    }


def _stick(rng: np.random.Generator) -> dict[str, float]:
    return {
        "mu": 10.0 ** rng.uniform(-2.0, 1.0),
        "I_G": 10.0 ** rng.uniform(-3.0, 0.0),
        "theta0": 10.0 ** rng.uniform(-4.0, -0.3),
    }


def _block(rng: np.random.Generator) -> dict[str, float]:
    return {
        "F0": rng.uniform(0.5, 5.0),
        "omega": rng.uniform(0.5, 5.0),
        "mu": rng.uniform(0.01, 0.5),
        "m": rng.uniform(0.5, 2.0),
    }


def _bar(rng: np.random.Generator) -> dict[str, float]:
    return {
        "tilt": rng.uniform(0.02, 0.6) * rng.choice([-1.0, 1.0]),
        "drop": rng.uniform(0.0, 1.0),
        "mu": 10.0 ** rng.uniform(-2.0, 0.5),
        "e": rng.choice([0.0, rng.uniform(0.1, 0.7)]),
        "v": rng.uniform(-1.0, 1.0),
        "I_G": rng.uniform(0.1, 0.5),
    }


SCENES: dict[str, tuple[str, Draw]] = {
    "ball on hills": ("bouncing_ball_hills", _hills),
    "stick": ("toppling_stick", _stick),
    "block": ("stick_slip_block", _block),
    "bar": (BAR, _bar),
}
"""Kind -> model (name or text) and how its parameters are drawn."""


@dataclass(frozen=True)
class Judgement:
    """Verdict on a request: delivered, refused, missed or unjudged."""

    scene: str
    parameters: dict[str, float]
    verdict: str
    error: float
    estimate: float
    reason: str = ""


def draws(count: int, seed: int) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield kinds of scenes in turns, with random parameters."""
    rng = np.random.default_rng(seed)
    kinds = list(SCENES)
    for i in range(count):
        scene = kinds[i % len(kinds)]
        yield scene, {k: float(v) for k, v in SCENES[scene][1](rng).items()}


class Judges:
    """Runners of every kind of scene, compiled once for all draws.

    Parameters
    ----------
    options : str
        Engine and method of the runs that are judged.
    """

    def __init__(self, **options: str) -> None:
        self._runners: dict[str, tuple[Runner, Runner, Runner]] = {}
        self._options = options

    def judge(self, scene: str, parameters: dict[str, float]) -> Judgement:
        """Ask for the accuracy, and compare what is delivered with the references."""
        runner, one, other = self._of(scene)
        try:
            result = runner.run(parameters, throw=False)
        except StatechartError as problem:
            return Judgement(scene, parameters, "refused", math.nan, math.nan, str(problem))
        estimate = math.nan if result.error_estimate is None else result.error_estimate
        if not estimate <= ACCURACY:
            reason = result.warnings[-1] if result.warnings else "no estimate"
            return Judgement(scene, parameters, "refused", math.nan, estimate, reason)
        if not result.trace.outcome.succeeded:
            reason = result.trace.message
            return Judgement(scene, parameters, "refused", math.nan, estimate, reason)
        references = [r.run(parameters, throw=False) for r in (one, other)]
        unsure = _relative_difference(*references)
        # The engine that the run was not made with judges it.
        ours = result.trace.engine.split()[0]
        judge = next(r for r in references if r.trace.engine.split()[0] != ours)
        error = _relative_difference(judge, result)
        verdict, reason = "unjudged", f"the references differ by {unsure:.2g}"
        if error + unsure <= ACCURACY:
            verdict, reason = "delivered", ""
        elif error - unsure > ACCURACY:
            verdict, reason = "missed", ""
        return Judgement(scene, parameters, verdict, error, estimate, reason)

    def _of(self, scene: str) -> tuple[Runner, Runner, Runner]:
        if scene not in self._runners:
            text = SCENES[scene][0]
            model = read_text(text) if "\n" in text else text
            self._runners[scene] = (
                Runner(model, accuracy=ACCURACY, **self._options),  # type: ignore[arg-type]
                Runner(model, engine="taylor", tolerance=2.2e-16),
                Runner(model, engine="scipy", method="DOP853", tolerance=2.3e-14),
            )
        return self._runners[scene]


def _relative_difference(one: Result, other: Result) -> float:
    first, second = (EvaluatedRun.of(run.observer, run.trace) for run in (one, other))
    return first.difference(second, first.scales, brief=ACCURACY).largest


def requests(count: int, seed: int) -> dict[str, list[Judgement]]:
    """Ask for the accuracy with several engines; return engine -> judgements."""
    tables: dict[str, list[Judgement]] = {}
    for engine, options in ENGINES.items():
        judges = Judges(**options)
        found = tables[engine] = []
        for i, (scene, parameters) in enumerate(draws(count, seed)):
            found.append(judges.judge(scene, parameters))
            if (i + 1) % 20 == 0:
                print(f"{engine}: {i + 1} of {count}", file=sys.stderr, flush=True)
    return tables


def table(tables: dict[str, list[Judgement]]) -> str:
    """Return how often each engine did what."""
    verdicts = ("delivered", "refused", "missed", "unjudged")
    rows = ["| engine | " + " | ".join(verdicts) + " | largest error |", "|" + "---|" * 6]
    for engine, found in tables.items():
        counts = Counter(j.verdict for j in found)
        worst = max((j.error for j in found if j.verdict == "delivered"), default=0.0)
        shown = " | ".join(str(counts[verdict]) for verdict in verdicts)
        rows.append(f"| {engine} | {shown} | {worst:.1g} |")
    return "\n".join(rows) + "\n"


def main() -> None:
    """Print the table, and every request that was not delivered."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    tables = requests(count, seed)
    print(f"accuracy {ACCURACY:g} on {count} random scenes, seed {seed}\n\n{table(tables)}")
    for engine, found in tables.items():
        for j in found:
            if j.verdict != "delivered":
                shown = ", ".join(f"{k}={v:.6g}" for k, v in j.parameters.items())
                print(f"{engine}, {j.scene} ({shown}): {j.verdict}, error {j.error:.2g}, "
                      f"estimate {j.estimate:.2g}\n  {j.reason}\n")  # fmt: skip


if __name__ == "__main__":
    main()
