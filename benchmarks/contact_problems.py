"""Contact problems of recorded runs and random scenes: residual and time of every method.

Runs are made step by step, and the contact problems of every step are kept, with the impulses that
it started from; what is at rest and verified at once is left out. Each method then solves all of
them from these impulses, and so does the ladder of `contacts.solvers.contact_solver`.

python benchmarks/contact_problems.py [--keep 200] [--tolerance 1e-6]
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.active_contacts import ActiveContacts
from contacts.rigid_bodies.rigid_body_run import RigidBodyRun
from contacts.solvers.contact_rows import (
    LAW,
    PAIR,
    RESTING,
    ContactRows,
    gauss_seidel,
    impulse_residual,
    velocity_scale,
    write_diagonal_blocks,
)
from contacts.solvers.contact_solver import _by_lemke, solve_rows
from contacts.solvers.proximal_points import solve_by_proximal_points
from contacts.time_stepping.chunk import Chunk, SteppedSystem
from contacts.time_stepping.scene_stepper import SteppedScene
from contacts.time_stepping.scene_tape import SteppedTape
from contacts.time_stepping.stepper import Stepper
from statechart.arrays import Array, Ints
from statechart.documents.yaml_reader import read_text
from statechart.errors import SimulationError
from statechart.kernels.jit import kernel
from statechart.loading.load import interpret
from statechart.running.runner import Runner

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / part) for part in ("", "solvers")]

SHAPES: Mapping[str, tuple[tuple[str, Mapping[str, float]], ...]] = {
    "40 dice": (("dice", {"n": 40}),),
    "100 dice": (("dice", {"n": 100}),),
    "200 dice": (("dice", {"n": 200}),),
    "discs": (("granular_column", {"n": 100}),),
    "stacks": (("box_stack", {"n": 10}), ("box_stack", {"n": 30})),
    "arches": (("arch", {}), ("arch", {"t": 0.11})),
    "joints": (("jacks", {}), ("domino", {}), ("drum", {}), ("silo", {})),
}
"""Shipped models of bodies with shapes, and the values that they are run with."""

POINTS = (
    "compass_walker",
    "woodpecker",
    "rimless_wheel",
    "four_legged_table",
    "double_contact_bar",
)
"""Shipped models of points on surfaces."""

STEP = 1e-3
"""Step size, in seconds, for models that declare none."""

_REST = 1e-10
"""Impulses that miss no more are not looked for again: such problems are left out."""


class Problem(NamedTuple):
    """Contacts of an island: `contacts.solvers.contact_rows.ContactRows` without what follows."""

    name: str
    bodies: Ints  # (m, s)
    moving: int
    rows: Array  # (m, 2, 3 s)
    columns: Array  # (m, 2, 3 s)
    cones: Array  # (m, 2)
    least: Array  # (m, 2): velocities without impulses.
    start: Array  # (m, 2): impulses of the step before.


def steps_of(
    runner: Runner, values: Mapping[str, float], h: float
) -> Iterator[tuple[SteppedSystem, Array, Chunk, float]]:
    """Take the steps of a run one by one, and yield what has just taken one."""
    assert runner.automaton.stepper is not None
    stepper = runner.automaton.stepper()
    assert isinstance(stepper, Stepper)
    begun = stepper._begin(values, h, 1e-6, False)
    if begun.failure is not None:
        return
    stepped, state, k = begun.system, begun.setup.initial, 0
    if isinstance(stepped, RigidBodyRun):
        # The detection after a step, which may reject it, would overwrite its contacts.
        stepped._options = stepped._options._replace(deepest=math.inf)
    end = min(runner.end(values, until=None), 3.0)
    while k * h < end:
        try:
            chunk = stepped.steps(k * h, h, state, 1)
        except SimulationError:
            return
        if not len(chunk.codes):
            return
        yield stepped, state, chunk, k * h
        state, k = chunk.states[-1], k + 1


def of_shapes(name: str, runner: Runner, values: Mapping[str, float]) -> Iterator[Problem]:
    """Yield the problems of islands of bodies with shapes."""
    known: dict[tuple[int, ...], Array] = {}
    assert runner.automaton.default_step is not None
    h = float(runner.model.settings.step or runner.automaton.default_step())
    for stepped, *_ in steps_of(runner, values, h):
        assert isinstance(stepped, RigidBodyRun)
        touches, inverse = stepped._workspace.active, stepped.numbers.inverse
        count = int(stepped._warm.n_contacts[0])
        keys = [tuple(key) for key in touches.keys[:count].tolist()]
        bodies = touches.bodies[:count].copy()
        for members in islands(bodies):
            yield of_island(name, touches, inverse, bodies, members, keys, known)
        known = dict(zip(keys, stepped._workspace.pressed[:count].copy(), strict=True))


def islands(bodies: Ints) -> list[list[int]]:
    """Return the contacts of each island."""
    parents: dict[int, int] = {}

    def root(b: int) -> int:
        while parents.setdefault(b, b) != b:
            b = parents[b]
        return b

    for one, other in bodies.tolist():
        if other >= 0:
            parents[root(one)] = root(other)
    found: dict[int, list[int]] = {}
    for i, (one, _) in enumerate(bodies.tolist()):
        found.setdefault(root(one), []).append(i)
    return list(found.values())


def of_island(
    name: str,
    touches: ActiveContacts,
    inverse: Array,
    bodies: Ints,
    members: list[int],
    keys: list[tuple[int, ...]],
    known: Mapping[tuple[int, ...], Array],
) -> Problem:
    """Return the problem of an island."""
    # In the order of a step, `contacts.rigid_bodies.islands.spread`.
    members = [i for first in range(5) for i in members[first::5]] if len(members) > 5 else members
    numbers = {
        b: k
        for k, b in enumerate(
            dict.fromkeys(b for i in members for b in bodies[i].tolist() if b >= 0)
        )
    }
    places = np.array([[numbers.get(b, len(numbers)) for b in bodies[i].tolist()] for i in members])
    rows = touches.rows[members].copy()
    for side in range(2):
        rows[places[:, side] == len(numbers), :, 3 * side : 3 * side + 3] = 0.0
    felt = np.vstack([inverse[list(numbers)], np.zeros(3)])[places].reshape(-1, 1, 6)
    least = touches.free[members] + touches.bias[members]
    start = np.array([known.get(keys[i], np.zeros(2)) for i in members])
    return Problem(
        name,
        places,
        len(numbers),
        rows,
        rows * felt,
        touches.materials[members, :2].copy(),
        least,
        start,
    )


def dense(name: str, delassus: Array, least: Array, cones: Array) -> Problem:
    """Return a problem of contacts that all feel each other."""
    count = len(cones)
    threes = max((2 * count + 2) // 3, 3)
    rows, columns = np.zeros((2, count, 2, 3 * threes))
    for i in range(count):
        for d in range(2):
            rows[i, d, 2 * i + d] = 1.0
            columns[i, d, : 2 * count] = delassus[:, 2 * i + d]
    bodies = np.tile(np.arange(threes), (count, 1))
    return Problem(name, bodies, threes, rows, columns, cones, least, np.zeros((count, 2)))


def of_points(name: str, runner: Runner) -> Iterator[Problem]:
    """Yield the problems of points on surfaces, at the states of the steps of a run."""
    for stepped, state, chunk, start in steps_of(runner, {}, STEP):
        assert isinstance(stepped, SteppedScene)
        source: SteppedTape = stepped._source
        n, h = source.size, chunk.h
        middle = state.copy()
        middle[:n] += 0.5 * h * state[n : 2 * n]
        numbers = source.tape.values(middle, stepped._values, start + 0.5 * h)
        mass, contacts, joints = source.equations(stepped._values, middle, start + 0.5 * h)
        which = np.flatnonzero((chunk.codes[0] > 0) & (source.held == 0) | chunk.struck[0])
        if not len(which):
            continue
        pinned = [contacts[source.held > 0, :n], contacts[source.held > 1, n : 2 * n]]
        held = np.concatenate([joints[:, :n], *pinned])
        system = np.block([[mass, held.T], [held, np.zeros((len(held), len(held)))]])
        pushes = contacts[which, : 2 * n].reshape(-1, n)
        right = np.vstack(
            [
                np.hstack([pushes.T, h * numbers[n * n : n * n + n, None]]),
                np.zeros((len(held), len(pushes) + 1)),
            ]
        )
        moved = np.linalg.lstsq(system, right, rcond=1e-12)[0][:n]
        free = pushes @ (state[n : 2 * n] + moved[:, -1])
        yield dense(name, pushes @ moved[:, :-1], free.reshape(-1, 2), stepped._cones[which])


def thinned(problems: Iterator[Problem], keep: int, most: int = 400_000) -> list[Problem]:
    """Return so many problems that are not at rest, spread over all."""
    hard: list[Problem] = []
    for k, problem in enumerate(problems):
        if k >= most:
            break
        moves = problem.least[:, 0].min() < 0.0 or problem.cones.min() < 0.0
        if len(problem.cones) > 1 and moves and residual_of(problem, problem.start) > _REST:
            hard.append(problem)
    places = np.linspace(0, len(hard) - 1, min(keep, len(hard))).round().astype(int)
    return [hard[k] for k in places]


def residual_of(problem: Problem, impulses: Array) -> float:
    """Return the residual of impulses, as `contacts.solvers.contact_rows.residual` states it."""
    bodies, rows, columns = problem.bodies, problem.rows, problem.columns
    rates = np.zeros((problem.moving + 1, 3))
    np.add.at(rates, bodies.ravel(), np.einsum("id,idk->ik", impulses, columns).reshape(-1, 3))
    if bodies.shape[1] == 2:
        rates[problem.moving] = 0.0
    normal, slip = (
        problem.least + np.einsum("idk,ik->id", rows, rates[bodies].reshape(len(bodies), -1))
    ).T
    own = np.einsum("idk,idk->id", rows, columns)
    wn, wt = own.T
    pn, pt = impulses.T
    cone_n, cone_t = problem.cones.T
    joint = cone_n < 0.0
    edge = wt * np.where(joint, 0.0, cone_t / np.maximum(cone_n, 2.0**-12)) * pn
    parts = (
        np.abs(wn * pn - np.maximum(wn * pn - normal, 0.0)),
        np.abs(wt * pt - np.clip(wt * pt - slip, -edge, edge)),
    )
    parts = (
        np.where(joint, np.abs(normal), parts[0]),
        np.where(joint, np.where(cone_n == -1.0, np.abs(slip), 0.0), parts[1]),
    )
    free = problem.least
    size = max(
        np.where(
            joint,
            np.abs(free).max(1),
            np.maximum(-free[:, 0], np.where(cone_t > 0, 1e-7 * np.abs(free[:, 1]), 0.0)),
        ).max(),
        0.0,
        *(1e-13 * wn * np.abs(pn)),
    )
    return float(max(part.max() for part in parts) / size) if size > 0.0 else 0.0


def recorded(keep: int) -> list[Problem]:
    """Return the problems of all runs."""
    from random_bodies import heap
    from test_proximal_points import of_all_masses, wall
    from test_step_problems import random_problem

    found: list[Problem] = []

    def add(name: str, problems: Iterator[Problem], keep: int) -> None:
        began = time.perf_counter()
        some = thinned(problems, keep)
        found.extend(some)
        print(
            f"{name:20}{len(some):6} problems in {time.perf_counter() - began:.0f} s",
            file=sys.stderr,
            flush=True,
        )

    for name, runs in SHAPES.items():
        for model, values in runs:
            runner = Runner(model)._fitting(values)
            add(f"{name}: {model}", of_shapes(name, runner, values), keep // len(runs))
    for seed in range(20):
        runner = Runner(interpret(read_text(heap(seed))))
        add(f"heap {seed}", of_shapes("heaps", runner, {}), keep // 10)
    for model in POINTS:
        add(model, of_points("points", Runner(model)), keep // 5)
    generator = np.random.default_rng(0)
    walls, random = [], []
    for seed in range(keep):
        rows, across = int(generator.integers(2, 9)), int(generator.integers(2, 6))
        mu = float(generator.choice([0.0, 0.5, 5.0, 500.0]))
        contacts, least = wall(rows, across, mu, generator)
        if seed % 2:
            contacts = of_all_masses(contacts, generator)
        walls.append(
            Problem(
                "walls" if seed % 2 == 0 else "walls, masses",
                contacts.bodies,
                contacts.moving,
                contacts.rows,
                contacts.columns,
                contacts.cones,
                least,
                np.zeros_like(least),
            )
        )
        sizes = int(generator.integers(1, 9)), int(generator.integers(1, 5))
        random.append(dense("random", *random_problem(generator, *sizes, friction=True)))
    found += walls + random
    return found


METHODS = ("ladder", "sweeps", "proximal points", "Lemke")


@kernel
def solve(
    contacts: ContactRows, least: Array, impulses: Array, allowed: float, method: int
) -> tuple[float, int]:
    """Improve impulses by one of the `METHODS`; return their residual, and iterations."""
    if method == 0:
        return solve_rows(contacts, least, impulses, allowed, False, True)
    size = velocity_scale(contacts, least)
    left = impulse_residual(contacts, least, size, impulses)
    if method == 1:
        return gauss_seidel(contacts, least, size, left, impulses, allowed, 64)
    if method == 2:
        return solve_by_proximal_points(contacts, least, size, left, impulses, allowed)
    if len(impulses) <= 64:
        return _by_lemke(contacts, least, allowed, impulses)
    return left, 0


def contacts_of(problem: Problem) -> ContactRows:
    """Return the contacts of a problem, with what follows from their rows."""
    count, moving = len(problem.cones), problem.moving
    contacts = ContactRows(
        problem.bodies, moving, problem.rows, problem.columns, np.empty((count, 3)), problem.cones,
        np.empty((count, LAW)), np.empty((3, 3 * moving + 3)), np.empty((7, count, 2)),
        int(problem.bodies.shape[1] != PAIR), 0, np.array([RESTING * np.abs(problem.least).max()]),
    )  # fmt: skip
    with np.errstate(all="ignore"):
        write_diagonal_blocks(contacts)
    return contacts


def replay(problems: list[Problem], allowed: float) -> None:
    """Print how many problems each method leaves unsolved, the worst residual and the mean time."""
    for name in dict.fromkeys(problem.name for problem in problems):
        some = [problem for problem in problems if problem.name == name]
        line = f"{name:16}{len(some):6}"
        for method in range(len(METHODS)):
            residuals, taken = [], 0.0
            for problem in some:
                contacts, impulses = contacts_of(problem), problem.start.copy()
                began = time.process_time()
                left, _ = solve(contacts, problem.least, impulses, allowed, method)
                taken += time.process_time() - began
                residuals.append(left)
            missed = sum(left > allowed for left in residuals)
            line += f" |{missed:5}{max(residuals):9.1e}{1e6 * taken / len(some):9.0f} us"
        print(line, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=int, default=200, help="problems of each kind")
    parser.add_argument("--tolerance", type=float, default=1e-6)
    chosen = parser.parse_args()
    print(f"{'unsolved, worst':22}", *(f"| {method:22}" for method in METHODS))
    replay(recorded(chosen.keep), chosen.tolerance)
