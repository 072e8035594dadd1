"""`--budget` of 0.05 to 5 s, warm and in fresh processes: how well it is kept, and what it gives.

    python benchmarks/budgets.py [MODEL ...]

Kept is what takes no more than a fifth, or 50 ms, above what was allowed, or says that it does.
"""

from __future__ import annotations

import json
import subprocess
import sys

from statechart.running.runner import Runner

MODELS = ("toppling_stick", "hopper", "compass_walker", "rimless_wheel", "newtons_cradle")
BUDGETS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


def run_in_fresh_process(model: str, budget: float) -> tuple[float, float | None, str, bool]:
    """Seconds taken, estimate, engine, and whether an overrun is reported, in a fresh process."""
    command = [sys.executable, "-m", "statechart.cli.main", "run", model, "--json", "--budget"]
    said = subprocess.run([*command, str(budget)], capture_output=True, text=True, check=False)
    report = json.loads(said.stdout)
    reported = any("more than the budget" in warning for warning in report["warnings"])
    estimate = report["error_estimate"]
    return (
        report["asked"]["cost"]["seconds"],
        None if estimate is None else float(estimate),
        report["engine"],
        reported,
    )


def warm(model: str, budget: float) -> tuple[float, float | None, str, bool]:
    """The same, of a second run in a process."""
    runner = Runner(model, budget=budget)
    runner.run(throw=False)
    result = runner.run(throw=False)
    assert result.asked is not None
    reported = any("more than the budget" in warning for warning in result.warnings)
    return result.asked.cost.seconds, result.error_estimate, result.trace.engine, reported


def main() -> None:
    models = sys.argv[1:] or MODELS
    silent = over = count = 0
    print("| model | budget | " + " | ".join(("cold", "", "warm", "")) + " |\n" + "|---" * 6 + "|")
    for model in models:
        for budget in BUDGETS:
            cells = []
            for measure in (run_in_fresh_process, warm):
                seconds, estimate, engine, reported = measure(model, budget)
                kept = seconds <= max(1.2 * budget, budget + 0.05)
                count, over = count + 1, over + (not kept)
                silent += not kept and not reported
                known = "none" if estimate is None else f"{estimate:.1g}"
                mark = "" if kept else " over" if reported else " SILENT"
                cells += [f"{seconds:.3g} s{mark}", f"{known}, {engine}"]
            print(f"| {model} | {budget:g} | " + " | ".join(cells) + " |", flush=True)
    print(f"\n{over} of {count} over, {silent} silently")


if __name__ == "__main__":
    main()
