"""Cost of an event against the number of bodies that have nothing to do with it.

    python benchmarks/components.py [N ...]

N particles, each above the ground with a contact of its own (restitution 0.5), fall for 2 s: the
first run of a fresh process (composition, modes, compilation of their flows), the same run again,
and what a jump takes then.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COUNTS = (1, 4, 16, 64, 256)


def particles(count: int) -> str:
    """Return a scene of particles at heights that all differ."""
    heights = [1.0 + 2.0 * i / max(count, 32) for i in range(count)]
    bodies = "\n".join(
        f"  p{i}: {{mass: 1, start: {{x: {3 * i}, y: {height:.12g}}}}}"
        for i, height in enumerate(heights)
    )
    contacts = "\n".join(
        f"  c{i}: {{point: {{body: p{i}}}, surface: ground, friction: 0.3, restitution: 0.5}}"
        for i in range(count)
    )
    return f"""\
kind: scene
name: particles
gravity: 9.81
bodies:
{bodies}
surfaces: {{ground: {{height: 0}}}}
contacts:
{contacts}
stop: {{time: 2}}
"""


def measure(count: int) -> dict[str, float]:
    """Return the times of a first run and of one more, in this process."""
    from statechart import Runner

    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "particles.yaml"
        model.write_text(particles(count))
        runner = Runner(model)
    trace = runner.run().trace
    first = time.process_time() - began
    warm = []
    for _ in range(3):
        began = time.process_time()
        trace = runner.run().trace
        warm.append(time.process_time() - began)
    return {
        "first": first,
        "warm": min(warm),
        "jumps": len(trace.jumps),
        "modes": trace.counts["modes_built"],
        "python": trace.counts["python_instants"],
    }


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("counts", nargs="*", type=int, default=list(COUNTS))
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.inside:
        print(json.dumps(measure(*asked.counts)))
        return 0
    print(f"{'n':>5} {'first, s':>9} {'warm, ms':>9} {'jumps':>6} {'a jump, ms':>11} {'modes':>6}")
    for count in asked.counts:
        command = [sys.executable, __file__, "--inside", str(count)]
        found = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
        print(
            f"{count:5} {found['first']:9.2f} {1e3 * found['warm']:9.1f} {found['jumps']:6}"
            f" {1e3 * found['warm'] / found['jumps']:11.3f} {found['modes']:6}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
