"""Cost of a declared model: `toppling_stick` against loops written by hand for this scene.

Three programs, side by side in one process, once compiled:

- the framework: statechart, laws, certified guards, full trace;
- a loop hand-written with heyoka: minimal coordinates, one integrator a mode, heyoka's own event
  detection, and the outputs only (no trace, no classification, no certificate);
- a loop hand-written with SciPy's `solve_ivp` and its events, by its default method RK45 and by
  DOP853; the tolerance of each is the loosest that reaches the same final error of 1e-9.

Times are of the process, medians of repeats that take turns; ratios are medians of the ratios in
one turn.

Run with ``python benchmarks/toppling_stick.py``.
"""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import heyoka as hy
import numpy as np
from scipy.integrate import solve_ivp

from statechart.engines.taylor import Taylor
from statechart.execution.simulator import Simulator
from statechart.loading.kind import kind
from statechart.loading.load import load
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs

GOLDEN = Path(__file__).parents[1] / "tests" / "golden" / "toppling_stick.json"
ROUNDS, SLOW, TURN = 40, 3, 10
Measures = tuple[float, float, float, float, float]  # critical angle, slips, omega, time


def hand_written_heyoka(mu: float, inertia: float) -> Callable[[float], Measures]:
    """Return a function of theta0 that runs the stick on three compiled integrators."""
    theta, omega, x, u = hy.make_vars("theta", "omega", "x", "u")
    I, m = hy.par[0], hy.par[1]  # noqa: E741
    s, c = hy.sin(theta), hy.cos(theta)

    def terminal(expression: hy.expression) -> hy.t_event:
        return hy.t_event(expression, direction=hy.event_direction.negative)

    fallen = math.pi / 2 - theta
    alpha = s / (I + 1.0)
    H, V = alpha * c - omega**2 * s, 1.0 - alpha * s - omega**2 * c
    pin = hy.taylor_adaptive(
        [(theta, omega), (omega, alpha)],
        [0.0, 0.0],
        pars=[inertia, mu],
        t_events=[terminal(m * V - H), terminal(m * V + H), terminal(fallen)],
    )
    slide = {}
    for sign in (1.0, -1.0):
        k = s + m * sign * c
        denominator = I + s * k
        bend = 1.0 - omega**2 * c
        alpha = bend * k / denominator
        V = I * bend / denominator
        slide[sign] = hy.taylor_adaptive(
            [(theta, omega), (omega, alpha), (x, u),
             (u, -m * sign * V - alpha * c + omega**2 * s)],
            [0.0] * 4,
            pars=[inertia, mu],
            t_events=[terminal(sign * u), terminal(V), terminal(fallen)],
        )  # fmt: skip

    def cone(theta: float, omega: float) -> tuple[float, float]:
        s, c = math.sin(theta), math.cos(theta)
        alpha = s / (inertia + 1.0)
        return alpha * c - omega**2 * s, 1.0 - alpha * s - omega**2 * c

    def run(theta0: float) -> Measures:
        angle, rate = theta0, 2.0 * math.sin(theta0 / 2) / math.sqrt(1.0 + inertia)
        place = speed = now = backward = forward = 0.0
        critical, sign = math.nan, 0.0
        while True:
            if sign == 0.0:
                pin.time = 0.0
                pin.state[:] = (angle, rate)
                event = -int(pin.propagate_until(1000.0)[0]) - 1
                now += pin.time
                angle, rate = pin.state
                if event == 2:
                    break
                if math.isnan(critical):
                    critical = angle
                sign = -1.0 if event == 0 else 1.0
                speed = 0.0
            else:
                ta = slide[sign]
                ta.time = 0.0
                ta.state[:] = (angle, rate, place, speed)
                before = place
                event = -int(ta.propagate_until(1000.0)[0]) - 1
                now += ta.time
                angle, rate, place, speed = ta.state
                if sign > 0:
                    forward += place - before
                else:
                    backward += before - place
                if event != 0:
                    break
                H, V = cone(angle, rate)
                speed = 0.0
                sign = 0.0 if abs(H) <= mu * V else -math.copysign(1.0, H)
        return critical, backward, forward, rate, now

    return run


def hand_written_scipy(
    mu: float, inertia: float, method: str, rtol: float
) -> Callable[[float], Measures]:
    """Return the same loop on `solve_ivp`."""

    def forces(y: np.ndarray) -> tuple[float, float]:
        s, c = math.sin(y[0]), math.cos(y[0])
        alpha = s / (inertia + 1.0)
        return alpha * c - y[1] ** 2 * s, 1.0 - alpha * s - y[1] ** 2 * c

    def pinned(_: float, y: np.ndarray) -> tuple[float, ...]:
        return y[1], math.sin(y[0]) / (inertia + 1.0), 0.0, 0.0

    def slipping(sign: float) -> Callable[[float, np.ndarray], tuple[float, ...]]:
        def rates(_: float, y: np.ndarray) -> tuple[float, ...]:
            s, c = math.sin(y[0]), math.cos(y[0])
            k = s + mu * sign * c
            denominator = inertia + s * k
            bend = 1.0 - y[1] ** 2 * c
            alpha, V = bend * k / denominator, inertia * bend / denominator
            return y[1], alpha, y[3], -mu * sign * V - alpha * c + y[1] ** 2 * s

        return rates

    def event(function: Callable[[np.ndarray], float]) -> Callable[[float, np.ndarray], float]:
        def guard(_: float, y: np.ndarray) -> float:
            return function(y)

        guard.terminal, guard.direction = True, -1  # type: ignore[attr-defined]
        return guard

    fallen = event(lambda y: math.pi / 2 - y[0])
    back = event(lambda y: mu * forces(y)[1] - forces(y)[0])
    ahead = event(lambda y: mu * forces(y)[1] + forces(y)[0])

    def stop(sign: float) -> Callable[[float, np.ndarray], float]:
        return event(lambda y: sign * y[3] + 1e-13)

    stops = {sign: stop(sign) for sign in (1.0, -1.0)}

    def run(theta0: float) -> Measures:
        y = np.array([theta0, 2.0 * math.sin(theta0 / 2) / math.sqrt(1.0 + inertia), 0.0, 0.0])
        now = backward = forward = sign = 0.0
        critical = math.nan
        while True:
            rates = pinned if sign == 0.0 else slipping(sign)
            events = [back, ahead, fallen] if sign == 0.0 else [stops[sign], fallen]
            solution = solve_ivp(
                rates, (0.0, 1000.0), y, method=method, rtol=rtol, atol=rtol, events=events
            )
            fired = [len(t) > 0 for t in solution.t_events]
            moved = solution.y[2, -1] - y[2]
            y = solution.y[:, -1].copy()
            now += solution.t[-1]
            forward, backward = forward + max(moved, 0.0), backward + max(-moved, 0.0)
            if fired[-1]:
                return critical, backward, forward, y[1], now
            y[3] = 0.0
            if sign == 0.0:
                critical = y[0] if math.isnan(critical) else critical
                sign = -1.0 if fired[0] else 1.0
            else:
                H, V = forces(y)
                sign = 0.0 if abs(H) <= mu * V else -math.copysign(1.0, H)

    return run


def warm_up(function: Callable[[], object]) -> None:
    """Run a function until its kernels are worth compiling, and are."""
    for _ in range(2100):
        function()


def turns(functions: Sequence[Callable[[], object]], rounds: int) -> list[list[float]]:
    """Return the process times of each function in microseconds, a median for every turn.

    A turn is `TURN` runs in a row, so that each runs with its own code in the processor's caches,
    as it does in a sweep.
    """
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(rounds):
        for function, spent in zip(functions, times, strict=True):
            turn = []
            for _ in range(TURN):
                begin = time.process_time()
                function()
                turn.append(time.process_time() - begin)
            spent.append(statistics.median(turn) * 1e6)
    return times


def ratio(times: Sequence[float], others: Sequence[float]) -> float:
    """Return the median of the ratios turn by turn: a clock that drifts does not matter."""
    return statistics.median(a / b for a, b in zip(times, others, strict=True))


def error(found: Measures, cell: dict[str, float]) -> float:
    """Return the largest error of the outputs against the reference."""
    names = ("critical_angle_rad", "slip_backward", "slip_forward", "omega_impact", "t_impact")
    return max(abs(f - cell[name]) for f, name in zip(found, names, strict=True))


def main() -> None:
    """Print the table."""
    cells = json.loads(GOLDEN.read_text())["cells"]
    cell = next(c for c in cells if c["mu"] == 0.2)
    mu, inertia, theta0 = 0.2, 1.0 / 3.0, cell["theta0"]

    model = load("toppling_stick")
    simulator = Simulator(kind("scene").automaton(model), Taylor(2.2e-16))

    def trace() -> object:
        return simulator.run({"theta0": theta0}, until=1000.0)

    read = Outputs(Observer(simulator))

    def framework() -> Measures:
        return tuple(read.of(simulator.run({"theta0": theta0}, until=1000.0)).values())  # type: ignore[return-value]

    heyoka = hand_written_heyoka(mu, inertia)
    rows: list[tuple[str, Callable[[], object]]] = [
        ("hand-written, heyoka", lambda: heyoka(theta0)),
        ("framework, trace", trace),
        ("framework, trace and outputs", framework),
    ]
    for method in ("RK45", "DOP853"):
        for rtol in (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13):
            scipy = hand_written_scipy(mu, inertia, method, rtol)
            if error(scipy(theta0), cell) < 1e-9:
                break
        rows.append((f"hand-written, solve_ivp {method} rtol {rtol:g}", partial(scipy, theta0)))
    for _, function in rows[:3]:
        warm_up(function)
    found = [function() for _, function in rows]
    # What takes milliseconds needs fewer rounds; the trace takes part in both.
    hand, traced, full = turns([f for _, f in rows[:3]], ROUNDS)
    beside, *slow = turns([f for _, f in [rows[1], *rows[3:]]], SLOW)
    lines: list[tuple[list[float], list[float] | None, list[float]]]
    lines = [(hand, hand, traced), (traced, hand, traced), (full, hand, traced)]
    lines += [(times, None, beside) for times in slow]
    print(f"{'program':42} {'us':>10} {'to heyoka':>10} {'to trace':>10} {'error':>9}")
    for (name, _), (times, first, second), result in zip(rows, lines, found, strict=True):
        shown = f"{error(result, cell):9.1e}" if isinstance(result, tuple) else ""
        to_first = "" if first is None else f"{ratio(times, first):10.2f}"
        us = statistics.median(times)
        print(f"{name:42} {us:10.1f} {to_first:>10} {ratio(times, second):10.2f} {shown:>9}")


if __name__ == "__main__":
    main()
