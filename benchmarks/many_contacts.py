"""Cost of declaring many contacts: time and memory of a run that visits three or four modes.

A bar with N points that may touch the ground falls on one end: on a flat floor, where the end
slides back and then forth, and on hills. The product has 4**N modes. Every run is a process of its
own from a cold start: heyoka compiles into an empty cache, only the numerical kernels are compiled
already.

Memory is the peak beyond that of two other processes. "Above imports": one that imports the same
modules, and lets a ball drop on a floor, for which the kernels are loaded and heyoka's compiler
does its least. "Above 1": one that runs the same bar with one contact.

    python benchmarks/many_contacts.py [--contacts N ...]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

GROUNDS = {"floor": ("0", 0.33), "hills": ("0.1*sin(3*x)", 0.33)}


def scene(count: int, ground: str) -> str:
    """Return the scene of a bar with `count` points as text."""
    height, end = GROUNDS[ground]
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
bodies: {{bar: {{mass: 1, inertia: 1/3, start: {{y: {0.2 + math.sin(0.3):.12g}, angle: 0.3}}}}}}
surfaces: {{ground: {{height: {height}}}}}
contacts:
{contacts}
stop: {{time: {end}}}
"""


def peak() -> float:
    """Return the largest resident memory of this process so far, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024
    raise OSError("no VmHWM: this benchmark needs Linux")


def run(path: Path) -> dict[str, object]:
    """Validate, run, report and draw a scene in this process."""
    began = time.perf_counter()
    from statechart.diagram.build import build
    from statechart.diagram.write import write
    from statechart.running.runner import Runner

    imported = time.perf_counter()
    runner = Runner(path)
    start, _ = runner.start()
    result = runner.run()
    report = result.to_dict(explain=True)
    ran = time.perf_counter()
    write(build(runner.automaton, start, result.trace), path.with_suffix(".svg"))
    return {
        "modes": report["modes_total"],
        "built": report["modes_built"],
        "outcome": report["outcome"],
        "import": imported - began,
        "run": ran - imported,
        "draw": time.perf_counter() - ran,
        "peak": peak(),
        "modules": sorted(sys.modules),
    }


BALL = """\
kind: scene
name: ball
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 0.01}}}
surfaces: {floor: {height: 0}}
contacts: {tip: {point: {body: ball}, surface: floor, friction: 0.3, restitution: 0}}
stop: {time: 0.1}
"""


def imports(modules: list[str]) -> dict[str, object]:
    """Import what a run imports, and load its kernels and heyoka's compiler."""
    import importlib

    for name in modules:
        if not name.startswith("__"):
            try:
                importlib.import_module(name)
            except ImportError:
                continue  # made by another module on its way
    from statechart.documents.yaml_reader import read_text
    from statechart.running.runner import Runner

    Runner(read_text(BALL)).run()
    return {"peak": peak()}


def child(*arguments: str, stdin: str | None = None) -> tuple[dict[str, Any], float]:
    """Return what this script says in a process of its own, and the time that took."""
    with tempfile.TemporaryDirectory() as cache:
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, __file__, *arguments],
            env={**os.environ, "HEYOKA_CACHE_DIR": cache},
            input=stdin,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        return json.loads(done.stdout), time.perf_counter() - began


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--contacts", type=int, nargs="+", default=[2, 5, 10, 20])
    parser.add_argument("--run", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--imports", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.run:
        print(json.dumps(run(chosen.run)))
        return
    if chosen.imports:
        print(json.dumps(imports(json.load(sys.stdin))))
        return
    print(
        f"{'ground':8}{'contacts':>9}{'product':>12}{'built':>7}{'import s':>10}{'run s':>8}"
        f"{'draw s':>8}{'process s':>11}{'peak MB':>9}{'above imports':>15}{'above 1':>9}"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bar.yaml"
        path.write_text(scene(2, "hills"))
        child("--run", str(path))  # the kernels are compiled before anything is measured
        for ground in GROUNDS:
            path.write_text(scene(1, ground))
            one, _ = child("--run", str(path))
            for count in chosen.contacts:
                path.write_text(scene(count, ground))
                found, wall = child("--run", str(path))
                base, _ = child("--imports", stdin=json.dumps(found["modules"]))
                memory, imported = float(found["peak"]), float(base["peak"])
                print(
                    f"{ground:8}{count:9}{found['modes']:12.3g}{found['built']:7}"
                    f"{found['import']:10.2f}{found['run']:8.2f}{found['draw']:8.2f}{wall:11.2f}"
                    f"{memory:9.0f}{memory - imported:15.0f}{memory - float(one['peak']):9.0f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
