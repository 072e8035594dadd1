"""Savings by minimal coordinates: microseconds a step of a mode, milliseconds a run of 20 s.

    python benchmarks/minimal_coordinates.py

In turn in one process, medians; "all" is the same automaton without minimal coordinates.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from runs import automaton

from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Role
from statechart.engines.taylor import Taylor
from statechart.execution.simulator import Simulator

STEPS = (
    ("compass_walker", ("pin", "off")),
    ("rimless_wheel", ("pin", "free", "free", "free", *("off",) * 12)),
    ("toppling_stick", ("pin",)),
    ("rocking_block", ("pin", "free")),
)
RUNS = ("rimless_wheel", "compass_walker")
_END, _REPEATS = 20.0, 41
_SHORT = 0.2  # of the time of a model: a few steps


def forms(model: str) -> tuple[Automaton, Automaton]:
    """Return a model in all coordinates, and in minimal ones."""
    built = automaton(model)
    return replace(built, coordinates=None), built


def stepping(built: Automaton, states: tuple[str, ...]) -> tuple[Callable[[], float], int]:
    """Return what measures the microseconds of a step in a mode, and the length of its program."""
    simulator = Simulator(built, Taylor(2.2e-16))
    setup = built.setup({}, 2.2e-16)
    stepper = simulator.modes.compiled(tuple(map(Role, states)), setup.zeros).stepper
    integrator, fixed = stepper.integrator, stepper.fixed  # type: ignore[attr-defined]

    def measure() -> float:
        integrator.time = 0.0
        integrator.state[:] = setup.initial
        if len(integrator.pars):
            integrator.pars[0] = 0.0
            integrator.pars[1:] = fixed.at(setup.initial, setup.values, 0.0)
        began = time.perf_counter()
        steps = integrator.propagate_until(_SHORT, write_tc=True)[3]
        return 1e6 * (time.perf_counter() - began) / float(steps)

    return measure, len(integrator.decomposition)


def running(built: Automaton) -> Callable[[], float]:
    """Return what measures the milliseconds of a run."""
    simulator = Simulator(built, Taylor(2.2e-16))
    simulator.run(until=_END)

    def measure() -> float:
        began = time.perf_counter()
        simulator.run(until=_END)
        return 1e3 * (time.perf_counter() - began)

    return measure


def medians(measures: list[Callable[[], float]]) -> list[float]:
    """Return the medians of what is measured in turn."""
    taken = [[measure() for measure in measures] for _ in range(_REPEATS)]
    return [statistics.median(column) for column in zip(*taken, strict=True)]


def main() -> None:
    """Print a table."""
    print("| mode | all | minimal | terms of heyoka |\n|---|---|---|---|")
    for model, states in STEPS:
        made = [stepping(built, states) for built in forms(model)]
        whole, least = medians([measure for measure, _ in made])
        terms = " -> ".join(str(count) for _, count in made)
        print(
            f"| {model} {states[0]}, us a step | {whole:.2f} | {least:.2f} | {terms} |", flush=True
        )
    for model in RUNS:
        whole, least = medians([running(built) for built in forms(model)])
        print(f"| {model}, ms a run | {whole:.2f} | {least:.2f} | |", flush=True)


if __name__ == "__main__":
    main()
