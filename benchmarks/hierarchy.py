"""Cost of an event in a chart of three levels, two regions and a history, and in a flat one.

The flat chart has the same states written out by hand, with the same guards in the same order. Both
run in one process, in turn; given is the median over the runs of time per jump.

    python benchmarks/hierarchy.py [--runs N] [--until T]
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

from statechart.charts.chart import Chart
from statechart.running.runner import Runner

_RUN = {"flows": {"x": 1, "y": 1, "z": 1}}
_VARIABLES = {"x": 0, "y": 0, "z": 0}


def _move(name: str, source: str, target: str, guard: str, **updates: int) -> dict[str, Any]:
    return {"name": name, "from": source, "to": target, "guard": guard, "updates": updates}


def nested() -> Chart:
    """Return the chart with states in states."""
    left = {
        "initial": "p",
        "states": {
            "p": {},
            "q": {
                "initial": "q1",
                "states": {"q1": {}, "q2": {}},
                "transitions": [_move("step", "q1", "q2", "x >= 1", x=0)],
            },
            "last": {"history": "deep"},
        },
        "transitions": [
            _move("up", "p", "q", "x >= 1", x=0),
            _move("down", "q2", "p", "x >= 1", x=0),
        ],
    }
    right = {
        "initial": "r1",
        "states": {"r1": {}, "r2": {}},
        "transitions": [
            _move("there", "r1", "r2", "y >= 0.7", y=0),
            _move("back", "r2", "r1", "y >= 0.7", y=0),
        ],
    }
    region = {
        "initial": "work",
        "states": {
            "work": {"regions": {"left": left, "right": right}, **_RUN, "exit": {"z": 0}},
            "idle": {"flows": {"z": 1}, "exit": {"z": 0}},
        },
        "transitions": [
            _move("pause", "work", "idle", "z >= 5.3"),
            _move("resume", "idle", "last", "z >= 0.5"),
        ],
    }
    return _chart("nested", region)


def flat() -> Chart:
    """Return the same chart without states in states."""
    states: dict[str, Any] = {}
    moves: list[dict[str, Any]] = []
    for one, name, following in (("p", "up", "q1"), ("q1", "step", "q2"), ("q2", "down", "p")):
        states[f"idle_{one}"] = {"flows": {"z": 1}}
        for other, back, opposite in (("r1", "there", "r2"), ("r2", "back", "r1")):
            here = f"{one}_{other}"
            states[here] = _RUN
            moves += [
                _move(name, here, f"{following}_{other}", "x >= 1", x=0),
                _move(back, here, f"{one}_{opposite}", "y >= 0.7", y=0),
                _move("pause", here, f"idle_{one}", "z >= 5.3", z=0),
            ]
        moves.append(_move("resume", f"idle_{one}", f"{one}_r1", "z >= 0.5", z=0))
    return _chart("flat", {"initial": "p_r1", "states": states, "transitions": moves})


def _chart(name: str, region: dict[str, Any]) -> Chart:
    return Chart.model_validate({"name": name, "variables": _VARIABLES, "regions": {"m": region}})


def main() -> None:
    """Print time per jump, and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--until", type=float, default=200.0)
    chosen = parser.parse_args()
    runners = {chart.name: Runner(chart, engine="taylor") for chart in (nested(), flat())}
    traces = {name: runner.run(until=chosen.until).trace for name, runner in runners.items()}
    causes = [[(jump.t, jump.cause) for jump in trace.jumps] for trace in traces.values()]
    if causes[0] != causes[1]:
        raise SystemExit("the two charts do not do the same")
    spent: dict[str, list[float]] = {name: [] for name in runners}
    for _ in range(chosen.runs):
        for name, runner in runners.items():
            began = time.perf_counter()
            runner.run(until=chosen.until)
            spent[name].append((time.perf_counter() - began) / len(causes[0]))
    medians = {name: statistics.median(times) for name, times in spent.items()}
    print(f"{len(causes[0])} jumps, median of {chosen.runs} runs")
    for name, median in medians.items():
        print(f"  {name:8}{median * 1e6:8.1f} us a jump")
    print(f"  ratio {medians['nested'] / medians['flat']:.2f}")


if __name__ == "__main__":
    main()
