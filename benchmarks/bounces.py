"""Cost of a million bounces: time for each event, early and late, and memory.

`bouncing_ball` that loses nothing, in one process; its trace is kept whole, what memory does not
hold in a file. Times are CPU seconds of the process.

Run with ``python benchmarks/bounces.py``.
"""

from __future__ import annotations

import os
import resource
import time

from models import path
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

COUNTS = (10_000, 100_000, 1_000_000)


def main() -> None:
    place = path("bouncing_ball")
    assert place is not None
    text = place.read_text(encoding="utf-8") + f"\nsettings: {{max_jumps: {2 * COUNTS[-1]}}}\n"
    runner = Runner(read_text(text))
    # Compiles the kernels that runs of many bounces use.
    runner.run({"k": 1.0}, until=4000.0)
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    print(f"load {os.getloadavg()[0]:.1f}; imports and compiled code take {base} MB")
    for count in COUNTS:
        began = time.process_time()
        trace = runner.run({"k": 1.0}, until=0.903 * count).trace
        took = (time.process_time() - began) / len(trace.jumps)
        peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10) - base
        print(
            f"{len(trace.jumps):8d} bounces: {1e6 * took:5.1f} us each, {peak} MB more at most, "
            f"{trace.counts['python_instants']} instants in Python"
        )
        del trace


if __name__ == "__main__":
    main()
