"""Time and memory from a cold start for scenes of growing size, with events and by time steps.

A bar with N points that may touch the ground falls on one end, topples and lies: the number of
contacts grows, that of bodies does not. N discs fall on the ground as a heap: bodies and contacts
grow together, and only time steps run it. Every run is a process of its own that imports, reads,
composes, runs and reports; kernels are compiled already, flows of modes are not. Memory is the
peak of the process beyond that of one that imports the same and runs a block on an incline.

    python benchmarks/growing_scenes.py [-o docs/growing-scenes.md]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CONTACTS = (1, 2, 4, 8, 12, 16, 20)
BODIES = (1, 3, 10, 30, 100)
STEPS = ("impulse", 1e-3)
_SLOWEST = 300.0


def bar(count: int) -> str:
    """Return a bar with `count` points that falls on the ground."""
    places = [-1 + 2 * i / max(count - 1, 1) for i in range(count)]
    contacts = "\n".join(
        f"  c{i}: {{point: {{body: bar, at: [{x:.12g}, 0]}}, surface: ground,"
        " friction: 0.3, restitution: 0}"
        for i, x in enumerate(places)
    )
    return f"""\
kind: scene
name: bar
gravity: 9.81
bodies: {{bar: {{mass: 1, inertia: 1/3, start: {{y: 0.5, angle: 0.3}}}}}}
surfaces: {{ground: {{height: 0}}}}
contacts:
{contacts}
stop: {{time: 1}}
"""


def discs_above_ground(count: int) -> str:
    """Return `count` discs, four in a row, above the ground."""
    return f"""\
kind: scene
name: heap
gravity: 9.81
bodies:
  grain:
    copies: {count}
    mass: 0.01
    inertia: 5e-7
    shape: {{disc: 0.01}}
    start:
      x: 0.022*mod(index, 4) + 0.001*sin(index)
      y: 0.012 + 0.022*floor(index/4)
surfaces:
  ground: {{height: 0}}
  wall: {{line: [[-0.015, 1], [-0.015, 0]]}}
collisions:
  all: {{bodies: [grain], surfaces: [ground, wall], friction: 0.5, restitution: 0.2}}
stop: {{time: 1}}
settings: {{engine: impulse, step: 1e-3}}
"""


def peak() -> float:
    """Return the largest resident memory of this process so far, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024
    raise OSError("no VmHWM: this benchmark needs Linux")


def one(path: str, engine: str, step: float | None) -> dict[str, object]:
    """Run a scene in this process."""
    from statechart.running.runner import Runner

    runner = Runner(path, engine=engine, step=step)
    result = runner.run(throw=False)
    report = result.to_dict()
    began = time.perf_counter()
    runner.run(throw=False)
    return {
        "outcome": report["outcome"],
        "again": time.perf_counter() - began,
        "modes": report["modes_built"],
        "events": len(report["events"]),
        "MB": peak(),
    }


def measured(text: str, engine: str, step: float | None) -> dict[str, object]:
    """Run a scene in a process of its own, from a cold start."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.yaml"
        path.write_text(text)
        command = [sys.executable, __file__, "--one", str(path), engine, str(step or 0)]
        # heyoka caches compiled code in XDG_CACHE_HOME: an empty one is a cold start.
        environment = os.environ | {"XDG_CACHE_HOME": folder}
        began = time.perf_counter()
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment, check=False, timeout=_SLOWEST
        )
        taken = time.perf_counter() - began
    if done.returncode:
        raise RuntimeError(done.stderr)
    found: dict[str, object] = json.loads(done.stdout)
    return found | {"s": taken}


def row(count: int, found: dict[str, object], base: dict[str, float]) -> str:
    """Return one line of a table."""
    extra = float(found["MB"]) - base["MB"]  # type: ignore[arg-type]
    return (
        f"| {count} | {found['s']:.1f} | {1e3 * float(found['again']):.0f} | "  # type: ignore[arg-type]
        f"{max(extra, 0.0):.0f} | {found['modes'] or '-'} | {found['events']} | "
        f"{found['outcome']} |"
    )


HEADER = (
    "| size | process, s | second run, ms | memory above imports, MB | modes built | "
    "events | outcome |\n|---|---|---|---|---|---|---|"
)


def page() -> str:
    """Measure, and return the page."""
    still = (
        "kind: scene\nname: still\ngravity: 9.81\nbodies: {b: {mass: 1}}\n"
        "surfaces: {s: {height: 0}}\ncontacts: {c: {point: {body: b}, surface: s, friction: 1,"
        " restitution: 0}}\nstop: {time: 0.1}\n"
    )
    lines = [
        "# Scenes of growing size",
        "",
        "Run time and memory of events (`taylor`) and of steps (`impulse`), for 1 s of motion. "
        "Each row is a new process; kernels are compiled, modes are not. *Process* is the time of "
        "the whole process, *second run* the time of the same run once more in this process.",
        "",
        "`python benchmarks/growing_scenes.py -o docs/growing-scenes.md` writes this page; "
        f"{platform.machine()}, {os.cpu_count()} cores.",
        "",
        "| engine | imports, s | MB |\n|---|---|---|",
    ]
    base: dict[str, dict[str, float]] = {}
    for engine, step in (("taylor", None), STEPS):
        base[engine] = measured(still, engine, step)  # type: ignore[assignment]
        lines.append(f"| `{engine}` | {base[engine]['s']:.1f} | {base[engine]['MB']:.0f} |")
    costs: dict[str, dict[int, float]] = {"taylor": {}, "impulse": {}}
    agains: dict[str, dict[int, float]] = {"taylor": {}, "impulse": {}}
    for engine, step, title in (
        ("taylor", None, "Events: a bar with N contacts falls and lies down"),
        ("impulse", 1e-3, "Steps of 1e-3: the same bar"),
    ):
        lines += ["", f"## {title}", "", HEADER]
        for count in CONTACTS:
            found = measured(bar(count), engine, step)
            costs[engine][count] = float(found["s"])  # type: ignore[arg-type]
            agains[engine][count] = float(found["again"])  # type: ignore[arg-type]
            lines.append(row(count, found, base[engine]))
            print(lines[-1], file=sys.stderr)
    lines += ["", "## Steps of 1e-3: a heap of N bodies", "", HEADER]
    heaps: dict[int, float] = {}
    for count in BODIES:
        found = measured(discs_above_ground(count), "impulse", 1e-3)
        heaps[count] = float(found["again"])  # type: ignore[arg-type]
        lines.append(row(count, found, base["impulse"]))
        print(lines[-1], file=sys.stderr)
    start = lines.index("") + 1
    lines[start:start] = ["## Summary", "", *_verdicts(costs, agains, heaps), "", "## Method", ""]
    return "\n".join(lines) + "\n"


def _verdicts(
    costs: dict[str, dict[int, float]], agains: dict[str, dict[int, float]], heaps: dict[int, float]
) -> list[str]:
    cold = [n for n in CONTACTS if costs["taylor"][n] > costs["impulse"][n]]
    warm = [n for n in CONTACTS if agains["taylor"][n] > agains["impulse"][n]]
    slow = [n for n in BODIES if heaps[n] > 1.0]
    first, second, third = _since(cold, CONTACTS), _since(warm, CONTACTS), _since(slow, BODIES)
    return [
        f"- Sizes at which steps are faster than events: in a new process {first}, because steps "
        f"build no modes; in repeated runs {second}.",
        "- Steps have an error of first order in the step; events are exact to round-off.",
        f"- Sizes of heaps at which steps of 1e-3 are slower than real time: {third}.",
    ]


def _since(sizes: list[int], measured: tuple[int, ...]) -> str:
    if not sizes:
        return "none"
    return "all" if sizes[0] == measured[0] else f"from {sizes[0]} on"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--one", nargs=3, metavar=("FILE", "ENGINE", "STEP"))
    chosen = parser.parse_args()
    if chosen.one:
        path, engine, step = chosen.one
        print(json.dumps(one(path, engine, float(step) or None)))
    else:
        text = page()
        print(text)
        if chosen.output:
            chosen.output.write_text(text)
