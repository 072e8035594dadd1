"""`--accuracy` of 1e-3 to 1e-10 on every engine and method: what is delivered, and what it costs.

    python benchmarks/accuracy_of_requests.py [COUNT] [SEED]

The random scenes of accuracy_of_random_scenes.py, with outputs that have kinks and peaks, extremes,
counts and lists. A request is judged by the tightest runs of two engines. Of every fifth, the cost
is in units of the coarsest single run of the same engine that delivers, both warm. Time steps
are asked for accuracies in accuracy_by_steps.py.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import cache

import numpy as np
from accuracy_of_random_scenes import SCENES, draws

from statechart.documents.declaration import Declaration
from statechart.documents.outputs import Count, Integral, Maximum, Value
from statechart.documents.yaml_reader import read_text
from statechart.errors import StatechartError
from statechart.loading.load import interpret, load
from statechart.running.accuracy import EvaluatedRun
from statechart.running.result import Result
from statechart.running.runner import Runner

OUTPUTS = {
    "ball on hills": {
        "kink": Integral(integral="abs(ball.x - 1)"),
        "peak": Integral(integral="1/(1 + ((ball.x - 0.5)/0.05)**2)"),
        "highest": Maximum(maximum="ball.y"),
    },
    "stick": {
        "kink": Integral(integral="abs(stick.angle + 0.7)"),
        "peak": Integral(integral="1/(1 + ((stick.angle + 0.2)/1e-3)**2)"),
        "push": Maximum(maximum="tip.V"),
    },
    "block": {
        "way": Integral(integral="abs(block.dx)"),
        "peak": Integral(integral="1/(1 + ((time - 2)/1e-2)**2)"),
        "slips": Count(count="base.slip"),
        "when": Value(value="time", at="each base.slip"),
    },
    "bar": {
        "kink": Integral(integral="abs(bar.angle)"),
        "highest": Maximum(maximum="bar.y"),
        "hits": Count(count="A.touchdown"),
        "when": Value(value="time", at="each A.touchdown"),
    },
}
# Engine and method, and the tightest requested accuracy, as a power of ten.
ENGINES: dict[str, tuple[dict[str, str], int]] = {
    "auto": ({}, 10),
    "taylor": ({"engine": "taylor"}, 10),
    "DOP853": ({"engine": "scipy", "method": "DOP853"}, 10),
    "RK45": ({"engine": "scipy", "method": "RK45"}, 8),
    "LSODA": ({"engine": "scipy", "method": "LSODA"}, 8),
    "Radau": ({"engine": "scipy", "method": "Radau"}, 6),
}


@cache
def model_of(scene: str) -> Declaration:
    """The scene with its further outputs."""
    text = SCENES[scene][0]
    found = interpret(read_text(text)) if "\n" in text else load(text)
    assert isinstance(found, Declaration)
    return found.model_copy(update={"outputs": {**found.outputs, **OUTPUTS[scene]}})


@cache
def runner(scene: str, engine: str, **options: float) -> Runner:
    return Runner(model_of(scene), **ENGINES[engine][0], **options)  # type: ignore[arg-type]


@cache
def references(scene: str) -> tuple[Runner, Runner]:
    tight = {"taylor": 2.2e-16, "DOP853": 2.3e-14}
    one, other = (runner(scene, engine, tolerance=tol) for engine, tol in tight.items())
    return one, other


def relative_difference(one: Result, other: Result, accuracy: float) -> float:
    first, second = (EvaluatedRun.of(run.observer, run.trace) for run in (one, other))
    return first.difference(second, first.scales, brief=accuracy).largest


def timed(call: Callable[[], Result]) -> tuple[Result, float]:
    began = time.perf_counter()
    found = call()
    _ = found.outputs
    return found, time.perf_counter() - began


def judged(
    scene: str, parameters: dict[str, float], engine: str, accuracy: float
) -> tuple[str, float, float, str]:
    """Verdict, error, estimate and reason of one request."""
    try:
        result = runner(scene, engine, accuracy=accuracy).run(parameters, throw=False)
    except StatechartError as problem:
        return "refused", math.nan, math.nan, str(problem)
    estimate = result.error_estimate
    if estimate is None or not estimate <= accuracy or not result.trace.outcome.succeeded:
        reason = result.warnings[-1] if result.warnings else result.trace.message
        return "refused", math.nan, estimate or math.nan, reason
    one, other = (r.run(parameters, throw=False) for r in references(scene))
    unsure = relative_difference(one, other, accuracy)
    ours = result.trace.engine.split()[0]
    judge = next((r for r in (one, other) if r.trace.engine.split()[0] != ours), other)
    error = relative_difference(judge, result, accuracy)
    if error + unsure <= accuracy:
        # What the references do not resolve is no error.
        return "delivered", error if error > 3.0 * unsure else 0.0, estimate, ""
    if error - unsure > accuracy:
        return "missed", error, estimate, ""
    return "unjudged", error, estimate, f"the references differ by {unsure:.2g}"


def cost(scene: str, parameters: dict[str, float], engine: str, accuracy: float) -> float | None:
    """Cost of an answer, in units of the coarsest single run that delivers it."""
    asked = runner(scene, engine, accuracy=accuracy)
    asked.run(parameters, throw=False)
    _, seconds = timed(lambda: asked.run(parameters, throw=False))
    reference = references(scene)[0].run(parameters, throw=False)
    for power in range(max(2, round(-math.log10(accuracy)) - 2), 15):
        one = runner(scene, engine, tolerance=10.0**-power)
        try:
            one.run(parameters, throw=False)
        except StatechartError:
            continue
        found, single = timed(lambda one=one: one.run(parameters, throw=False))  # type: ignore[misc]
        if relative_difference(reference, found, accuracy) <= accuracy:
            return seconds / single
    return None


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    rng = np.random.default_rng(seed + 1000)
    verdicts: Counter[str] = Counter()
    shown: list[str] = []
    ratios: list[float] = []
    costs: dict[str, list[float]] = {}
    for i, (scene, parameters) in enumerate(draws(count, seed)):
        engine = list(ENGINES)[rng.integers(len(ENGINES))]
        tightest = ENGINES[engine][1]
        accuracy = 10.0 ** -int(rng.integers(3, tightest + 1))
        verdict, error, estimate, reason = judged(scene, parameters, engine, accuracy)
        verdicts[verdict] += 1
        if verdict != "delivered":
            values = ", ".join(f"{k}={v:.17g}" for k, v in parameters.items())
            asked = f"{engine} {accuracy:g}, {scene} ({values})"
            found = f"{verdict}, error {error:.2g}, estimate {estimate:.2g}"
            shown.append(f"{asked}: {found}\n  {reason}")
        elif error > 0.0:
            ratios.append(estimate / error)
            if estimate < error:
                print(
                    f"below: {engine} {accuracy:g} {scene} {parameters} {error:.3g} {estimate:.3g}"
                )
        if i % 5 == 0 and verdict == "delivered":
            times = cost(scene, parameters, engine, accuracy)
            if times is not None:
                costs.setdefault(engine, []).append(times)
        if (i + 1) % 20 == 0:
            print(f"{i + 1} of {count}: {dict(verdicts)}", file=sys.stderr, flush=True)
    print(f"{count} requests, seed {seed}: {dict(verdicts)}")
    errors = np.array(ratios)
    print(f"estimate per error: median {np.median(errors):.3g}, below it "
          f"{np.mean(errors < 1):.2%}, below a half {np.sum(errors < 0.5)} "
          f"of {len(errors)}")  # fmt: skip
    every = [ratio for some in costs.values() for ratio in some]
    print(f"cost in coarsest runs: median {np.median(every):.3g} of {len(every)}; "
          + ", ".join(f"{k} {np.median(v):.3g}" for k, v in costs.items()))  # fmt: skip
    print("\n".join(shown))


if __name__ == "__main__":
    main()
