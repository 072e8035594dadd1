"""Contacts that can stand in for each other, against references that know nothing of sharing."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from runs import ENGINES, engine
from scipy.optimize import minimize

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.event_driven.laws import SceneLaws
from contacts.kind import automaton
from contacts.modes.candidates import Case, candidates, lemke_candidates
from contacts.modes.classification import choose
from contacts.scene.joints import Force, Joint
from contacts.scene.modes import Free, Slide
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from contacts.solvers.smallest_forces import INSIDE, smallest_forces
from statechart.automaton.trace import Outcome, Trace
from statechart.execution.simulator import Simulator
from statechart.observation.observer import Observer

Array = NDArray[np.float64]
ALL = ("free", "slide+", "slide-", "pin")


def standing(
    arms: list[float],
    *,
    mu: Any = 0.5,
    height: float = 1.0,
    push: Any = 0,
    speed: float = 0.0,
    **contact: Any,
) -> Scene:
    """Return a body of weight 1 on points at `arms` from the middle, pushed at its centre."""
    return Scene(
        name="standing",
        gravity=1,
        parameters={"mu": mu},
        bodies={"top": Body(mass=1, inertia=0.5, start={"y": height, "dx": speed})},
        surfaces={"floor": Surface(height=0)},
        forces={"push": Force(body="top", force=(push, 0))},
        contacts={
            f"p{i}": Contact(
                point=Point(body="top", at=(arm, -height)),
                surface="floor",
                restitution=0,
                **{"friction": "mu", **contact},
            )
            for i, arm in enumerate(arms)
        },
    )


def run(scene: Scene, name: str = "taylor", until: float = 3.0) -> Trace:
    return Simulator(automaton(scene), engine(name)).run(until=until, throw=False)


def numbers(scene: Scene, time: float = 0.0) -> tuple[Snapshot, SceneSetup]:
    built = automaton(scene)
    laws = built.laws
    assert isinstance(laws, SceneLaws)
    setup = built.setup({}, 2.2e-16)
    return laws.tape.at(setup.values, setup.initial, time), setup


def least(edges: Array, reach: Array, load: Array, limits: Array) -> Array:
    """Return the smallest forces by a general optimiser, over amounts along edges of the cones.

    The amounts of the last are at most the `limits`.
    """
    count = len(edges)
    forces = lambda z: np.einsum("gk,gkd->gd", z.reshape(count, -1), edges)  # noqa: E731
    size = edges.shape[0] * edges.shape[1]
    found = minimize(
        lambda z: 0.5 * (forces(z) ** 2).sum(),
        np.ones(size),
        jac=lambda z: np.einsum("gd,gkd->gk", forces(z), edges).ravel(),
        bounds=[(0.0, None)] * (size - 2 * len(limits))
        + [(0.0, limit) for limit in limits.repeat(2).tolist()],
        constraints={
            "type": "eq",
            "fun": lambda z: np.einsum("gdn,gd->n", reach, forces(z)) - load,
        },
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-14},
    )
    return forces(found.x)


def _unbounded(cones: Array) -> Array:
    return np.insert(cones, 2, np.inf, axis=1)


@pytest.mark.parametrize("seed", range(30))
def test_springs_bear_the_smallest_couples_within_their_limits(seed: int) -> None:
    # Beside contacts, couplings: |H| <= limit. The reference is by another method.
    generator = np.random.default_rng(seed)
    rough, count = int(generator.integers(0, 3)), int(generator.integers(4, 7))
    mu, limits = generator.uniform(0.1, 1.0, count), generator.uniform(0.1, 1.0, count)
    cones = np.stack([1.0 / np.hypot(1.0, mu), mu / np.hypot(1.0, mu), limits], axis=1)
    cones[:rough, 2] = np.inf
    reach = generator.normal(size=(count, 2, 3))
    reach[rough:, 0] = 0.0
    edges = np.stack([cones[:, :2], cones[:, :2] * [1.0, -1.0]], axis=1)
    # Couplings by the difference of two couples of at most their limits.
    edges[rough:] = [[0.0, 1.0], [0.0, -1.0]]
    weights = generator.uniform(0.0, 1.0, (count, 2))
    weights[rough:] = np.outer(limits[rough:], [1.0, 0.0]) * generator.uniform(0.7, 1.0)
    load = np.einsum("gdn,gkd,gk->n", reach, edges, weights)
    found, forces, zones, violation = smallest_forces(cones, np.zeros(count), reach, load, 1e-13)
    assert found
    assert violation <= 0.0
    assert np.einsum("gdn,gd->n", reach, forces) == pytest.approx(load, rel=1e-10, abs=1e-12)
    assert (np.abs(forces[rough:, 1]) <= limits[rough:] * (1.0 + 1e-12)).all()
    at_limit = np.isclose(np.abs(forces[rough:, 1]), limits[rough:], rtol=1e-12)
    assert (at_limit == (zones[rough:] != INSIDE)).all()
    reference = least(edges, reach, load, limits[rough:])
    assert (forces**2).sum() == pytest.approx((reference**2).sum(), rel=1e-8)
    assert forces == pytest.approx(reference, abs=1e-5)


@pytest.mark.parametrize("seed", range(30))
def test_springs_bear_the_smallest_forces_in_their_cones(seed: int) -> None:
    generator = np.random.default_rng(seed)
    count = int(generator.integers(2, 6))
    mu = generator.uniform(0.1, 1.0, count)
    cones = np.stack([1.0 / np.hypot(1.0, mu), mu / np.hypot(1.0, mu)], axis=1)
    sliding = np.zeros(count)
    reach = generator.normal(size=(count, 2, 3))
    edges = np.stack([cones, cones * [1.0, -1.0]], axis=1)
    load = np.einsum("gdn,gkd,gk->n", reach, edges, generator.uniform(0.0, 1.0, (count, 2)))
    found, forces, _, violation = smallest_forces(_unbounded(cones), sliding, reach, load, 1e-13)
    assert found
    assert violation <= 0.0
    assert np.einsum("gdn,gd->n", reach, forces) == pytest.approx(load, rel=1e-12)
    reference = least(edges, reach, load, np.empty(0))
    assert (forces**2).sum() == pytest.approx((reference**2).sum(), rel=1e-8)
    assert forces == pytest.approx(reference, abs=1e-5)


@pytest.mark.parametrize("seed", range(30))
def test_springs_bear_no_load_outside_all_cones(seed: int) -> None:
    generator = np.random.default_rng(seed)
    cones = np.tile(np.array([2.0, 1.0]) / math.sqrt(5.0), (4, 1))
    reach = generator.normal(size=(4, 2, 2))
    reach[:, 1] *= 0.1
    reach[:, 0, 1] = np.abs(reach[:, 0, 1]) + 1.0  # all push upwards
    assert not smallest_forces(_unbounded(cones), np.zeros(4), reach, np.array([0.3, -1.0]), 1e-13)[
        0
    ]


def reference(snapshot: Snapshot, laws: Any, still: list[bool]) -> list[Array]:
    """Return the accelerations of all consistent modes whose forces are determined.

    Any motion that forces in cones explain is explained by independent edges of them alone
    (Caratheodory): no redundant mode is needed to find it.
    """
    n = len(snapshot.forces)
    found: list[Array] = []
    for modes in product(*(ALL if rest else ("free", "slide+") for rest in still)):
        rows, columns, right = [], [], []
        for contact, law, bias, mode in zip(
            snapshot.jacobians, laws, snapshot.biases, modes, strict=True
        ):
            if mode == "pin":
                rows += [*contact]
                columns += [*contact]
                right += [*-bias]
            elif mode != "free":
                sign = 1.0 if mode == "slide+" else -1.0
                rows.append(contact[0])
                columns.append(law.cone_n * contact[0] - sign * law.cone_t * contact[1])
                right.append(-bias[0])
        if rows and np.linalg.matrix_rank(np.array(columns), 1e-9) < len(rows):
            continue
        m = len(rows)
        system = np.zeros((n + m, n + m))
        system[:n, :n] = snapshot.mass
        if m:
            system[:n, n:] = -np.array(columns).T
            system[n:, :n] = rows
        if np.linalg.matrix_rank(system, 1e-9) < n + m:
            continue
        solved = np.linalg.solve(system, np.concatenate([snapshot.forces, right]))
        accelerations, amounts = solved[:n], solved[n:].tolist()
        holds = True
        for k, mode in enumerate(modes):
            normal, along = snapshot.biases[k] + snapshot.jacobians[k] @ accelerations
            if mode == "free":
                holds &= normal >= -1e-9
            elif mode == "pin":
                V, H = amounts.pop(0), amounts.pop(0)
                holds &= laws[k].cone_t * V - laws[k].cone_n * abs(H) >= -1e-9
            else:
                holds &= amounts.pop(0) >= -1e-9
                sign = 1.0 if mode == "slide+" else -1.0
                holds &= not still[k] or sign * along >= -1e-9
        if holds and not any(np.abs(accelerations - one).max() < 1e-7 for one in found):
            found.append(accelerations)
    return found


@pytest.mark.parametrize("seed", range(40))
def test_accelerations_are_those_of_modes_whose_forces_are_determined(seed: int) -> None:
    generator = np.random.default_rng(seed)
    arms = generator.uniform(-1.0, 1.0, int(generator.integers(2, 5))).tolist()
    speed = float(generator.choice([0.0, 0.3]))
    scene = standing(
        arms,
        mu=float(generator.uniform(0.1, 0.6)),
        height=float(generator.uniform(0.1, 0.8)),
        push=float(generator.normal()) * 0.5,
        speed=speed,
    )
    snapshot, setup = numbers(scene)
    closed = [True] * len(arms)
    expected = reference(snapshot, setup.contacts, [speed == 0.0] * len(arms))
    assert len(expected) == 1
    choice = choose(setup, snapshot, closed)
    assert choice.taken.accelerations == pytest.approx(expected[0], abs=1e-8)
    # The forces explain the motion, and are in their cones.
    forces = choice.taken.forces
    pushed = snapshot.mass @ choice.taken.accelerations - snapshot.forces
    assert np.einsum("gdn,gd->n", snapshot.jacobians, forces) == pytest.approx(pushed, abs=1e-12)
    for (V, H), law in zip(forces, setup.contacts, strict=True):
        assert law.cone_t * V - law.cone_n * abs(H) >= -1e-12
    # No mode is taken that keeps fewer contacts closed than the motion does.
    for state, contact, bias in zip(
        choice.taken.states, snapshot.jacobians, snapshot.biases, strict=True
    ):
        apart = bias[0] + contact[0] @ choice.taken.accelerations
        assert (state == "free") is bool(apart > 1e-9)


@pytest.mark.parametrize("seed", range(24))
def test_lemke_selects_the_mode_of_enumeration_above_four_contacts(seed: int) -> None:
    generator = np.random.default_rng(seed)
    count = 5 + seed % 2
    scene = standing(
        generator.uniform(-1.0, 1.0, count).tolist(),
        mu=float(generator.uniform(0.1, 0.6)),
        height=float(generator.uniform(0.1, 0.8)),
        push=float(generator.normal()) * 0.4,
        speed=float(generator.choice([0.0, 0.3, -0.3])),
    )
    snapshot, setup = numbers(scene)
    closed = [True] * count
    choice = choose(setup, snapshot, closed)
    assert any("does not check that it is the only one" in note for note in choice.notes)
    still = [abs(contact.slip) < 1e-12 for contact in snapshot.contacts]
    options = [
        ALL if rest else ("free", "slide+" if contact.slip > 0 else "slide-")
        for rest, contact in zip(still, snapshot.contacts, strict=True)
    ]
    tried = candidates(Case(snapshot, setup.contacts, closed, still, setup.scales, 5e-13), options)
    consistent = [c for c in tried if c.violation <= 5e-13]
    assert consistent
    for one in consistent:
        assert choice.taken.accelerations == pytest.approx(one.accelerations, abs=1e-9)
    assert choice.taken.states in [c.states for c in consistent if c.share is not None] or (
        choice.taken.share is None
    )


def test_lemke_reports_that_it_finds_no_mode() -> None:
    snapshot, setup = numbers(standing([-1.0, -0.5, 0.0, 0.5, 1.0]))
    options = [("slide+",)] * 5  # at rest on a level floor nothing slides
    true = [True] * 5
    tried = lemke_candidates(Case(snapshot, setup.contacts, true, true, setup.scales), options)
    assert not [c for c in tried if c.violation <= 0.0]


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("arms", [[-1.0, 1.0], [-0.6, 0.1, 1.0], [-1.0, -0.5, 0.5, 0.9]])
def test_a_sliding_bar_comes_to_rest_on_all_its_points(name: str, arms: list[float]) -> None:
    trace = run(standing(arms, height=0.3, speed=1.0), name)
    assert trace.modes == (("slide+",) * len(arms), ("pin",) * len(arms))
    assert trace.jumps[0].t == pytest.approx(2.0, rel=1e-11)  # v = mu g t
    assert trace.final[0] == pytest.approx(1.0, rel=1e-11)
    assert trace.jumps[0].energy is not None
    assert trace.jumps[0].energy[1] <= trace.jumps[0].energy[0]
    assert trace.indeterminate[("pin",) * len(arms)] == trace.regions


def test_two_points_share_an_undetermined_load_evenly() -> None:
    trace = run(standing([-1.0, 1.0], push=0.2), until=1.0)
    simulator = Simulator(automaton(standing([-1.0, 1.0], push=0.2)), engine("taylor"))
    found = Observer(simulator).final(trace, ["p0.V", "p0.H", "p1.V", "p1.H"])
    # The moments determine V, but only the sum of H.
    assert found == pytest.approx([0.4, -0.1, 0.6, -0.1], abs=1e-15)


@pytest.mark.parametrize("name", ENGINES)
def test_contacts_at_one_point_move_as_one(name: str) -> None:
    def stick(count: int) -> Scene:
        s, c = math.sin(0.3), math.cos(0.3)
        return Scene(
            name="stick",
            gravity=1,
            bodies={"rod": Body(mass=1, inertia=0.1, start={"x": s, "y": c, "angle": -0.3})},
            surfaces={"floor": Surface(height=0)},
            contacts={
                f"tip{i}": Contact(
                    point=Point(body="rod", at=(0, -1)), surface="floor", friction=0.4,
                    restitution=0,
                )
                for i in range(count)
            },
        )  # fmt: skip

    one, two = (run(stick(count), name, until=1.6) for count in (1, 2))
    assert one.outcome is two.outcome is Outcome.HORIZON
    assert [key[:1] for key in two.modes] == list(one.modes)
    assert len(one.jumps) > 0
    assert all(len(set(key)) == 1 for key in two.modes)
    for first, second in zip(one.jumps, two.jumps, strict=True):
        assert second.t == pytest.approx(first.t, abs=1e-10)
    assert two.final == pytest.approx(one.final, abs=1e-9)


@pytest.mark.parametrize("mu", [0.5, 6e3, 3e4])
def test_upright_rod_in_a_corner_stands_at_any_friction(mu: float) -> None:
    scene = Scene(
        name="corner",
        gravity=1,
        bodies={"rod": Body(mass=1, inertia=0.1, start={"x": -3, "y": 1})},
        surfaces={"floor": Surface(height=0), "wall": Surface(line=((-3, 1), (-3, 0)))},
        contacts={
            name: Contact(
                point=Point(body="rod", at=(0, end)), surface=surface, friction=mu, restitution=0
            )
            for name, end, surface in (("foot", -1, "floor"), ("C", -1, "wall"), ("D", 1, "wall"))
        },
    )
    trace = run(scene, until=10.0)
    assert (trace.outcome, trace.modes) == (Outcome.HORIZON, (("pin",) * 3,))
    assert trace.certified
    simulator = Simulator(automaton(scene), engine("taylor"))
    found = Observer(simulator).final(trace, ["foot.V", "foot.H", "C.V", "C.H", "D.V", "D.H"])
    # The force in the corner's wall is along its edge (n, t) of the cone; the top bears nothing.
    n, t = 1.0 / math.hypot(1.0, mu), mu / math.hypot(1.0, mu)
    by_wall = t / 2.0
    expected = [1.0 - t * by_wall, -n * by_wall, n * by_wall, -t * by_wall, 0.0, 0.0]
    assert found == pytest.approx(expected, abs=1e-13)


def test_without_friction_only_normal_forces_are_shared() -> None:
    modes = (Free(), Slide())
    scene = standing([-1.0, 0.2, 1.0], speed=0.5, friction=0, modes=modes)
    trace = run(scene, until=2.0)
    assert trace.modes == (("slide",) * 3,)
    assert trace.final[:3] == pytest.approx([1.0, 1.0, 0.0], abs=1e-14)


@pytest.mark.parametrize("mu", [0.0, math.inf])
def test_extreme_friction_coefficients_are_handled(mu: float) -> None:
    trace = run(standing([-1.0, 0.1, 1.0], mu=mu if mu < 1 else "inf", push="time/2"), until=2.5)
    if mu == 0.0:
        assert trace.modes == (("pin",) * 3, ("slide+",) * 3)
        assert trace.final[0] == pytest.approx(2.5**3 / 12, rel=1e-9)
    else:
        # It never slips, and tips when the push has the moment of its weight.
        assert trace.modes == (("pin",) * 3, ("free", "free", "pin"))
        assert trace.jumps[0].t == pytest.approx(2.0, rel=1e-10)


def test_feet_of_different_friction_are_reported_as_indeterminate() -> None:
    scene = standing([-1.0, 0.1, 1.0], speed=1.0)
    contacts = {
        name: contact.model_copy(update={"friction": mu})
        for (name, contact), mu in zip(scene.contacts.items(), (0.3, 0.4, 0.5), strict=True)
    }
    trace = run(scene.model_copy(update={"contacts": contacts}), until=0.1)
    assert any("its motion depends on how the contacts share the load" in w for w in trace.warnings)


@pytest.mark.parametrize("name", ENGINES)
def test_rods_held_together_share_their_load(name: str) -> None:
    rods = Scene(
        name="rods",
        gravity=1,
        bodies={
            "a": Body(mass=1, inertia=0.3, start={"x": -1, "y": 0.1}),
            "b": Body(mass=1, inertia=0.3, start={"x": 1, "y": 0.1}),
        },
        joints={"hinge": Joint(point=Point(body="a", at=(1, 0)), to=Point(body="b", at=(-1, 0)))},
        surfaces={"floor": Surface(height=0)},
        forces={"push": Force(body="b", force=("time/2", "time/5"), at=(0.5, 0))},
        contacts={
            f"{body}{i}": Contact(
                point=Point(body=body, at=(x, -0.1)), surface="floor", friction=0.4, restitution=0
            )
            for body in "ab"
            for i, x in enumerate((-0.8, 0.8))
        },
    )
    trace = run(rods, name, until=1.5)
    assert trace.modes == (("pin",) * 4, ("slide+",) * 4)
    # t/2 = mu (2 - t/5)
    assert trace.jumps[0].t == pytest.approx(0.8 / 0.58, rel=1e-9)


def test_twenty_points_lie_and_slide() -> None:
    scene = standing(np.linspace(-1.0, 1.0, 20).tolist(), height=0.2, speed=0.5)
    trace = run(scene, "scipy", until=1.5)
    assert trace.modes == (("slide+",) * 20, ("pin",) * 20)
    assert trace.jumps[0].t == pytest.approx(1.0, rel=1e-11)
    assert trace.final[0] == pytest.approx(0.25, rel=1e-11)


@pytest.mark.parametrize("count", [7, 16, 19])
def test_a_bar_that_falls_on_one_end_lies_down_on_all_its_points(count: int) -> None:
    arms = np.linspace(-1.0, 1.0, count)
    contacts = {
        f"p{i}": Contact(
            point=Point(body="bar", at=(arm, 0)), surface="floor", friction=0.3, restitution=0
        )
        for i, arm in enumerate(arms.tolist())
    }
    bar = Body(mass=1, inertia="1/3", start={"y": 0.5, "angle": 0.3})
    scene = Scene(
        name="bar",
        gravity=9.81,
        bodies={"bar": bar},
        surfaces={"floor": Surface(height=0)},
        contacts=contacts,
    )
    trace = run(scene, until=1.0)
    assert trace.modes[-1] == ("pin",) * count
    assert trace.final == pytest.approx([trace.final[0], 0, 0, 0, 0, 0], abs=1e-12)
