"""Time against residual: this framework, pymunk, MuJoCo and Siconos on the same discs.

What impulses miss the contact laws by is measured by one function for all, on the impulses of a
step and the velocities before and after it (see `missed`). pymunk and MuJoCo make runs of their
own, as we do: what lets contacts be soft, as MuJoCo, misses the laws by that. Siconos (Debian's
`python3-siconos`, in the system's Python) solves the contact problems of our last run, and its time
is that of its solver alone, from nothing. Box2D tells no impulses of contacts. Where being pushed
out of each other would gain energy, we leave it, and miss what was asked in that step.

python benchmarks/residuals.py [--discs 100] [--python /usr/bin/python3]
"""

from __future__ import annotations

import argparse
import importlib
import math
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from many_bodies import (
    END,
    FRICTION,
    MASS,
    RADIUS,
    STEP,
    mujoco_model,
    pymunk_world,
    starts,
)

from contacts.rigid_bodies.rigid_body_run import RigidBodyRun
from contacts.time_stepping.stepper import Stepper
from statechart.arrays import Array
from statechart.running.runner import Runner

STEPS = round(END / STEP)
FELT = np.array([1.0, 1.0, 2.0 / RADIUS**2]) / MASS
"""Change of the rates of a disc by a unit force or torque."""


class Step(NamedTuple):
    """The contacts of a step.

    Attributes
    ----------
    rows : (m, 2, k) array
        Normal and tangential velocities per unit rates of what moves.
    felt : (k,) array
        What a unit of force does to them.
    least : (m, 2) array
        Velocities without impulses, plus what they are not to fall below, negated.
    after, impulses : (m, 2) array
    """

    rows: Array
    felt: Array
    least: Array
    after: Array
    impulses: Array


def median(function: Callable[[], object], repeats: int) -> float:
    """Return the median of so many times of the processor, after one that is not counted."""
    function()
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        taken.append(time.process_time() - began)
    return statistics.median(taken)


def missed(step: Step) -> float:
    """Return how far impulses are from those of the contact laws, over the fastest approach.

    The natural map of each contact, as a velocity: how far what a contact's own compliance makes of
    the velocity after the step, projected into the cone, is from its impulses.
    """
    own = (step.rows**2 * step.felt).sum(2)
    (normal, slip), (pn, pt) = step.after.T, step.impulses.T
    size = max(0.0, float(-step.least[:, 0].min(initial=0.0)))
    if size == 0.0:
        return 0.0
    pushed = own[:, 0] * pn - np.maximum(own[:, 0] * pn - normal, 0.0)
    edge = own[:, 1] * FRICTION * pn
    held = own[:, 1] * pt - np.clip(own[:, 1] * pt - slip, -edge, edge)
    return float(np.maximum(np.abs(pushed), np.abs(held)).max() / size)


def of_discs(
    pairs: list[tuple[int, int, float, float]], before: Array, after: Array, impulses: Array
) -> Step:
    """Return a step of a peer; pairs are a disc, another or -1, and the normal to the first.

    None rebounds here: what they do with restitution differs.
    """
    rows = np.zeros((len(pairs), 2, before.size))
    for i, (one, other, nx, ny) in enumerate(pairs):
        # The tangent is the normal turned clockwise; the arm goes from a centre against the normal.
        rows[i, :, 3 * one : 3 * one + 3] = [[nx, ny, 0.0], [ny, -nx, RADIUS]]
        if other >= 0:
            rows[i, :, 3 * other : 3 * other + 3] = [[-nx, -ny, 0.0], [-ny, nx, RADIUS]]
    free = before + np.array([0.0, -9.81 * STEP, 0.0])
    felt = np.tile(FELT, len(before))
    return Step(rows, felt, rows @ free.ravel(), rows @ after.ravel(), impulses)


def by_us(count: int, tolerance: float) -> tuple[float, Iterator[Step]]:
    values = {"n": count, "e": 0.0}
    runner = Runner("granular_column", impulse_tolerance=tolerance, record="nothing")
    runner = runner._fitting(values)
    taken = median(lambda: runner.run(values, throw=False), 5)

    def steps() -> Iterator[Step]:
        assert runner.automaton.stepper is not None
        stepper = runner.automaton.stepper()
        assert isinstance(stepper, Stepper)
        begun = stepper._begin(values, STEP, tolerance, forces=False)
        heap = begun.system
        assert isinstance(heap, RigidBodyRun)
        # The detection after a step, which may reject it, would overwrite its contacts.
        heap._options = heap._options._replace(deepest=math.inf)
        state = begun.setup.initial
        for k in range(STEPS):
            state = heap.steps(k * STEP, STEP, state, 1).states[-1]
            yield ours(heap, count)

    return taken, steps()


def ours(heap: RigidBodyRun, count: int) -> Step:
    """Return the step that bodies have just taken."""
    touches, m = heap._workspace.active, int(heap._warm.n_contacts[0])
    rows, impulses = np.zeros((m, 2, 3 * count)), heap._workspace.pressed[:m].copy()
    for i, (one, other) in enumerate(touches.bodies[:m].tolist()):
        rows[i, :, 3 * one : 3 * one + 3] = touches.rows[i, :, :3]
        if other >= 0:
            rows[i, :, 3 * other : 3 * other + 3] = touches.rows[i, :, 3:]
    felt = np.tile(FELT, count)
    least = touches.free[:m] + touches.bias[:m]
    added = np.einsum("idk,k,jek,je->id", rows, felt, rows, impulses, optimize=True)
    return Step(rows, felt, least, least + added, impulses)


def by_pymunk(count: int, iterations: int) -> tuple[float, Iterator[Step]]:
    places = starts(count)

    def world() -> tuple[Any, list[Any]]:
        return pymunk_world(places, iterations, 0.0)

    def run() -> None:
        space, _ = world()
        for _ in range(STEPS):
            space.step(STEP)

    def steps() -> Iterator[Step]:
        space, bodies = world()
        index = {id(body): k for k, body in enumerate(bodies)}

        def rates() -> Array:
            return np.array([[*body.velocity, body.angular_velocity] for body in bodies])

        found: list[tuple[int, int, float, float, Any]] = []

        def see(arbiter: Any, body: Any) -> None:
            one, other = (shape.body for shape in arbiter.shapes)
            if one is body:
                normal = arbiter.contact_point_set.normal
                place = index.get(id(other), -1)
                found.append((index[id(one)], place, *(-normal), arbiter.total_impulse))

        for _ in range(STEPS):
            before, found[:] = rates(), []
            space.step(STEP)
            for body in bodies:
                body.each_arbiter(see, body)
            impulses = [[p.x * nx + p.y * ny, p.x * ny - p.y * nx] for _, _, nx, ny, p in found]
            pairs = [(one, other, nx, ny) for one, other, nx, ny, _ in found]
            yield of_discs(pairs, before, rates(), np.array(impulses).reshape(-1, 2))

    return median(run, 5), steps()


def by_mujoco(count: int, tolerance: float) -> tuple[float, Iterator[Step]]:
    mujoco = importlib.import_module("mujoco")
    model = mujoco_model(starts(count), f'cone="elliptic" tolerance="{tolerance}"')
    # The plane's y is into it: it turns by -angle about that axis, as it is drawn.
    ahead = np.array([1.0, 1.0, -1.0])

    def run() -> None:
        data = mujoco.MjData(model)
        for _ in range(STEPS):
            mujoco.mj_step(model, data)

    def steps() -> Iterator[Step]:
        data, force = mujoco.MjData(model), np.zeros(6)
        for _ in range(STEPS):
            before = data.qvel.reshape(-1, 3) * ahead
            mujoco.mj_step(model, data)
            pairs, impulses = [], []
            for i in range(data.ncon):
                contact = data.contact[i]
                mujoco.mj_contactForce(model, data, i, force)
                one, other = (int(model.geom_bodyid[g]) - 1 for g in contact.geom)
                # The normal goes from the first to the second, on which the force acts.
                frame = contact.frame.reshape(3, 3)
                acting = force[:3] @ frame
                nx, ny = frame[0, 0], frame[0, 2]
                if other < 0:
                    one, other, nx, ny, acting = other, one, -nx, -ny, -acting
                pairs.append((other, one, nx, ny))
                px, py = STEP * acting[0], STEP * acting[2]
                impulses.append([px * nx + py * ny, px * ny - py * nx])
            after = data.qvel.reshape(-1, 3) * ahead
            yield of_discs(pairs, before, after, np.array(impulses).reshape(-1, 2))

    return median(run, 5), steps()


def by_siconos(
    python: str, solver: str, tolerance: float, problems: list[Step]
) -> tuple[float, Iterator[Step]]:
    with tempfile.TemporaryDirectory() as folder:
        asked, answered = Path(folder) / "asked.npz", Path(folder) / "answered.npz"
        whole = {}
        for k, step in enumerate(problems):
            whole[f"W{k}"] = np.einsum("idk,k,jek->idje", step.rows, step.felt, step.rows)
            whole[f"q{k}"] = step.least
        np.savez(asked, **whole)
        script = Path(__file__).with_name("by_siconos.py")
        arguments = [solver, str(tolerance), str(FRICTION), str(asked), str(answered)]
        subprocess.run([python, str(script), *arguments], check=True)
        with np.load(answered) as found:
            taken, impulses = float(found["taken"]), [found[f"p{k}"] for k in range(len(problems))]

    def steps() -> Iterator[Step]:
        for step, pushed in zip(problems, impulses, strict=True):
            added = np.einsum(
                "idk,k,jek,je->id", step.rows, step.felt, step.rows, pushed, optimize=True
            )
            yield step._replace(impulses=pushed, after=step.least + added)

    return taken, steps()


def print_row(program: str, how: str, taken: float, steps: Iterable[Step]) -> None:
    """Print a row of the table."""
    left = [missed(step) for step in steps if len(step.least)]
    print(
        f"{program:12}{how:20}{taken:9.3f} s{statistics.median(left):12.1e}"
        f"{np.quantile(left, 0.99):12.1e}{max(left):12.1e}",
        flush=True,
    )


def tried(program: str, how: str, make: Callable[[], tuple[float, Iterator[Step]]]) -> None:
    """Print a row of a program that may be missing."""
    try:
        taken, steps = make()
    except (ImportError, subprocess.CalledProcessError, FileNotFoundError):
        print(f"{program:12}is not installed", flush=True)
        return
    print_row(program, how, taken, steps)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--discs", type=int, default=100)
    parser.add_argument("--python", default="/usr/bin/python3", help="one that has Siconos")
    chosen = parser.parse_args()
    n = chosen.discs
    print(f"{'program':12}{'':20}{'time':>11}{'median':>12}{'of 100, 99':>12}{'worst':>12}")
    problems: list[Step] = []
    for tolerance in (1e-2, 1e-4, 1e-6, 1e-8):
        taken, steps = by_us(n, tolerance)
        problems = list(steps)
        print_row("statechart", f"tolerance {tolerance:.0e}", taken, problems)
    for iterations in (10, 30, 100, 1000):
        tried("pymunk", f"iterations {iterations}", partial(by_pymunk, n, iterations))
    for tolerance in (1e-4, 1e-8, 1e-12):
        tried("MuJoCo", f"tolerance {tolerance:.0e}", partial(by_mujoco, n, tolerance))
    struck = [step for step in problems if math.fsum(step.impulses[:, 0]) > 0.0]
    for solver, tolerance in (("NSGS", 1e-2), ("NSGS", 1e-4), ("NSGS", 1e-6), ("LEMKE", 1e-8)):
        run = partial(by_siconos, chosen.python, solver, tolerance, struck)
        tried("Siconos", f"{solver} {tolerance:.0e}", run)


if __name__ == "__main__":
    main()
