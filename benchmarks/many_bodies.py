"""Run time and residual of impulses of many bodies, compared with other engines; random heaps.

All engines run the same discs with the same step, in one process on one core. The motion of discs
is chaotic, and its cost varies by a fifth between nearly equal runs: times are means over gravities
that differ by 1e-6 relatively. Box2D 3, pymunk and MuJoCo are measured if they are installed
(`pip install "contact-statecharts[bench]"`), each in its own process. They do not give the impulses
of contacts, so that their residuals are not reported. For every engine the table shows the largest
penetration at the end, and the height of the highest disc.

python benchmarks/many_bodies.py [--discs 100] [--dice 10 40] [--heaps 1000] [--memory 3000]
    [--repeats 10]
"""

from __future__ import annotations

import argparse
import importlib
import math
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.spatial

from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.scene.scene import Scene
from contacts.testing.body_properties import assert_depths, assert_energy_of_steps
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner
from statechart.testing.subject import Subject

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

STEP, END, _LONG, GRAVITY = 1e-3, 0.6, 1.0, 9.81
RADIUS, MASS, FRICTION, RESTITUTION = 0.01, 0.01, 0.5, 0.2


def mean_over_gravities(function: Callable[[float], object], repeats: int) -> float:
    """Return the mean time of the processor over so many gravities, after one run not counted."""
    function(GRAVITY)
    began = time.process_time()
    for k in range(repeats):
        function(GRAVITY * (1.0 + 1e-6 * k))
    return (time.process_time() - began) / repeats


def ours(name: str, count: int, tolerance: float, repeats: int, text: str = "") -> None:
    """Print what a run of a shipped model takes, or of a text, and what it reaches."""
    runner = Runner(interpret(read_text(text)) if text else name, impulse_tolerance=tolerance)
    trace = runner.run({"n": count}, throw=False).trace
    taken = mean_over_gravities(lambda g: runner.run({"n": count, "g": g}, throw=False), repeats)
    counts, deepest = trace.counts, -min((trace.margins or {}).values())
    per = taken / max(counts["contacts"], 1)
    print(
        f"{name:16}{count:6}{tolerance:10.0e}{taken:10.3f} s{1e6 * per:10.2f} us"
        f"{counts['iterations'] / counts['steps']:10.1f}{counts['inexact_steps']:9}"
        f"{deepest / trace.tolerances['gap']:10.2f}  {trace.outcome.name}",
        flush=True,
    )


COLUMNS = """
kind: scene
name: columns
parameters: {n: 100, r: 0.01, m: 0.01, gap: 2.2*r, g: 9.81}
gravity: g
bodies:
  grain:
    copies: n
    mass: m
    inertia: m*r**2/2
    shape: {disc: r}
    start:
      x: 0.8*floor(index/100) + gap*mod(index, 4) + 0.09*r*sin(mod(index, 100))
      y: 1.01*r + gap*floor(mod(index, 100)/4)
surfaces: {ground: {height: 0}}
collisions: {all: {bodies: [grain], surfaces: [ground], friction: 0.5, restitution: 0.2}}
stop: {time: 0.6}
settings: {engine: impulse, step: 1e-3, record: nothing}
"""
"""As many columns of a hundred discs as there are discs for, beside each other: of a higher column
more and more discs touch nothing."""


def starts(count: int) -> list[tuple[float, float]]:
    """Return where the discs of granular_column start."""
    trace = Runner("granular_column").run({"n": count}, until=STEP).trace
    places = trace.initial[: 3 * count].reshape(-1, 3)
    return [(x, y) for x, y, _ in places.tolist()]


def by_box2d(places: list[tuple[float, float]]) -> Callable[[float], list[tuple[float, float]]]:
    box2d = importlib.import_module("pyb2d3")
    # Of two coefficients of friction the geometric mean is taken, of restitution the larger.
    material = box2d.surface_material(friction=FRICTION, restitution=RESTITUTION)
    shape = box2d.shape_def(density=MASS / (math.pi * RADIUS**2), material=material)

    def run(gravity: float) -> list[tuple[float, float]]:
        world = box2d.World(gravity=(0.0, -gravity))
        ground = world.create_static_body(position=(0.0, 0.0))
        for ends in (((-10.0, 0.0), (10.0, 0.0)), ((0.0, 0.0), (0.0, 10.0))):
            ground.create_shape(shape, box2d.segment(*ends))
        discs = []
        for place in places:
            discs.append(world.create_dynamic_body(position=place))
            discs[-1].create_shape(shape, box2d.circle(radius=RADIUS))
        for _ in range(round(END / STEP)):
            world.step(STEP, 4)
        found = [(disc.position[0], disc.position[1]) for disc in discs]
        world.destroy()
        return found

    return run


def pymunk_world(
    places: list[tuple[float, float]], iterations: int = 30, restitution: float = RESTITUTION
) -> tuple[Any, list[Any]]:
    """Return pymunk's space, and the bodies of its discs."""
    pymunk = importlib.import_module("pymunk")
    space = pymunk.Space()
    space.gravity, space.iterations = (0.0, -GRAVITY), iterations
    for ends in (((-10.0, 0.0), (10.0, 0.0)), ((0.0, 0.0), (0.0, 10.0))):
        wall = pymunk.Segment(space.static_body, *ends, 0.0)
        # Coefficients of a pair are products.
        wall.friction, wall.elasticity = FRICTION**0.5, restitution**0.5
        space.add(wall)
    discs = []
    for place in places:
        body = pymunk.Body(MASS, MASS * RADIUS**2 / 2)
        body.position = place
        disc = pymunk.Circle(body, RADIUS)
        disc.friction, disc.elasticity = FRICTION**0.5, restitution**0.5
        space.add(body, disc)
        discs.append(body)
    return space, discs


def by_pymunk(places: list[tuple[float, float]]) -> Callable[[float], list[tuple[float, float]]]:
    importlib.import_module("pymunk")

    def run(gravity: float) -> list[tuple[float, float]]:
        space, discs = pymunk_world(places)
        space.gravity = (0.0, -gravity)
        for _ in range(round(END / STEP)):
            space.step(STEP)
        return [(body.position.x, body.position.y) for body in discs]

    return run


def mujoco_model(places: list[tuple[float, float]], options: str = "") -> Any:
    """Return MuJoCo's model, with further options of its solver."""
    mujoco = importlib.import_module("mujoco")
    inertia = MASS * RADIUS**2 / 2
    discs = "".join(
        f'<body pos="{x} 0 {z}"><joint type="slide" axis="1 0 0"/>'
        f'<joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>'
        f'<geom type="sphere" size="{RADIUS}"/><inertial '
        f'pos="0 0 0" mass="{MASS}" diaginertia="{inertia} {inertia} {inertia}"/></body>'
        for x, z in places
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" gravity="0 0 {-GRAVITY}" {options}/><default><geom '
        f'condim="3" friction="{FRICTION} 0 0"/></default><worldbody><geom type="plane" '
        f'size="9 9 1"/><geom type="plane" size="9 9 1" zaxis="1 0 0"/>{discs}</worldbody></mujoco>'
    )


def by_mujoco(places: list[tuple[float, float]]) -> Callable[[float], list[tuple[float, float]]]:
    mujoco, model = importlib.import_module("mujoco"), mujoco_model(places)

    def run(gravity: float) -> list[tuple[float, float]]:
        data = mujoco.MjData(model)
        model.opt.gravity[2] = -gravity
        for _ in range(round(END / STEP)):
            mujoco.mj_step(model, data)
        return [(x, z) for x, _, z in data.xpos[1:].tolist()]

    return run


PEERS = {"box2d": by_box2d, "pymunk": by_pymunk, "mujoco": by_mujoco}


def peer(name: str, count: int, repeats: int) -> None:
    """Print what a run of a peer takes, and what it reaches."""
    try:
        run = PEERS[name](starts(count))
    except ImportError:
        print(f"{name:16}{count:6}  is not installed", flush=True)
        return
    taken, places = mean_over_gravities(run, repeats), np.array(run(GRAVITY))
    away = scipy.spatial.distance.pdist(places).min() - 2 * RADIUS
    deepest = max(0.0, -min(float(away), float(places.min()) - RADIUS))
    print(
        f"{name:16}{count:6}{'':10}{taken:10.3f} s  overlap at the end {deepest / RADIUS:.1e} r, "
        f"height {places[:, 1].max() / RADIUS:.2f} r",
        flush=True,
    )


def heaps(count: int) -> None:
    """Print how random heaps end, and which break a bound."""
    from random_bodies import heap

    ends: dict[str, int] = {}
    deep, gained, inexact, began = [], [], [], time.perf_counter()
    for seed in range(count):
        subject = Subject(interpret(read_text(heap(seed))))
        trace = subject.case({}).trace
        ends[trace.outcome.name] = ends.get(trace.outcome.name, 0) + 1
        scene = subject.model
        assert isinstance(scene, Scene)
        numbers = body_numbers(scene, scene.values())
        try:
            assert_depths(numbers, trace)
        except AssertionError:
            deep.append(seed)
        try:
            assert_energy_of_steps(numbers, subject, trace)
        except AssertionError:
            gained.append(seed)
        if trace.counts["inexact_steps"]:
            inexact.append(seed)
        if sys.stderr.isatty() or seed % 50 == 49:
            print(f"\r{seed + 1} of {count} heaps", end="", file=sys.stderr, flush=True)
    print(
        f"\n{count} heaps in {time.perf_counter() - began:.0f} s: {ends}; unsolved "
        f"{ends.get(Outcome.UNSOLVED_IMPULSES.name, 0)}; energy above the bound {gained}; with "
        f"steps above the tolerance {len(inexact)}; deeper than a step at the fastest approach "
        f"{len(deep)} {deep[:20]}"
    )


def _kilobytes(name: str) -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.split(f"{name}:")[1].split()[0])


def print_memory(count: int, record: str) -> None:
    """Print how much more than after its imports a run takes at most, in this process."""
    runner = Runner("granular_column", record=record)
    # Loads the compiled kernels.
    runner.run({"n": 4}, until=STEP)
    before = _kilobytes("VmRSS")
    trace = runner.run({"n": count}, until=_LONG, throw=False).trace
    # `getrusage` reports at least the memory of the parent process.
    most = _kilobytes("VmHWM")
    print(
        f"{record:16}{count:6}{trace.counts['steps']:10} steps{(most - before) / 1024:10.0f} MB "
        f"above imports  {trace.outcome.name}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--discs", type=int, nargs="*", default=[100])
    parser.add_argument("--dice", type=int, nargs="*", default=[10, 40])
    parser.add_argument("--tolerances", type=float, nargs="*", default=[1e-2, 1e-4, 1e-6, 1e-8])
    parser.add_argument("--heaps", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--peer", choices=PEERS, help="this program alone")
    parser.add_argument("--memory", type=int, nargs="*", default=[], help="so many discs")
    parser.add_argument("--record", choices=("modes", "poses", "nothing"), help="this one alone")
    chosen = parser.parse_args()
    if chosen.record:
        for count in chosen.memory:
            print_memory(count, chosen.record)
        return
    if chosen.peer:
        for count in chosen.discs:
            peer(chosen.peer, count, chosen.repeats)
        return
    print(
        f"{'model':16}{'bodies':>6}{'tolerance':>10}{'mean':>12}{'a contact':>13}"
        f"{'iterations':>10}{'inexact':>9}{'overlap':>10}"
    )
    for count in chosen.discs:
        for tolerance in chosen.tolerances:
            ours("granular_column", count, tolerance, chosen.repeats)
        ours("columns", count, 1e-4, chosen.repeats, COLUMNS)
        for name in PEERS:
            alone = [sys.executable, __file__, "--peer", name, "--discs", str(count)]
            subprocess.run([*alone, "--repeats", str(chosen.repeats)], check=True)
    for count in chosen.dice:
        ours("dice", count, 1e-6, chosen.repeats)
    for count in chosen.memory:
        for record in ("modes", "poses", "nothing"):
            alone = [sys.executable, __file__, "--memory", str(count), "--record", record]
            subprocess.run(alone, check=True)
    if chosen.heaps:
        heaps(chosen.heaps)


if __name__ == "__main__":
    main()
