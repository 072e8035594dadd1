"""Joints of every kind beside contacts that share their load, against Newton's equations by hand.

A cart stands on two or three feet, so that how they share what holds it in place is not
determined; bodies hang on it by hinges, some of them in loops, on pivots, guides or driven points.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from runs import ENGINES, engine
from scipy.linalg import null_space
from strategies import examples

from contacts.kind import automaton
from contacts.scene.joints import Force, Joint, Path
from contacts.scene.parts import Body, Contact, Coordinate, Point, Surface
from contacts.scene.scene import Scene
from statechart.automaton.trace import Outcome, Trace
from statechart.execution.simulator import Simulator
from statechart.observation.observer import Observer
from statechart.running.runner import Runner

Array = NDArray[np.float64]

GRAVITY = 9.81
HEIGHT = 0.2
# Beside the hinges of a tree: nothing, a loop, a guide of one component, a driven one, a fixed
# pivot, a hinge once more, and a second hinge that makes two bodies one.
KINDS = ("tree", "loop", "guide", "driven", "pivot", "twice", "weld")


def turned(angle: float, x: float, y: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * x - s * y, s * x + c * y])


def cart(feet: list[float], mu: float | str, push: float = 0.0) -> dict[str, Any]:
    """Return the parts of a scene with a cart of mass 1 at rest on its feet."""
    return {
        "name": "cart",
        "gravity": GRAVITY,
        "surfaces": {"floor": Surface(height=0)},
        "contacts": {
            f"foot{i}": Contact(
                point=Point(body="cart", at=(x, -HEIGHT)), surface="floor", friction=mu,
                restitution=0,
            )
            for i, x in enumerate(feet)
        },
        "forces": {"push": Force(body="cart", force=(push, 0))},
    }  # fmt: skip


@st.composite
def jointed(draw: st.DrawFn, kind: str) -> Scene:
    """Draw a cart with bodies that hang on it; they swing where no loop forbids it."""

    def number(least: float, most: float) -> float:
        return round(draw(st.floats(least, most)), 3)

    feet = [-number(0.2, 0.5), number(0.2, 0.5), number(-0.1, 0.1)][: draw(st.integers(2, 3))]
    bodies = {"cart": Body(mass=1, inertia=0.1, start={"y": HEIGHT})}
    joints = {}
    places = {"cart": (np.array([0.0, HEIGHT]), 0.0, np.zeros(2), 0.0)}
    for i in range(draw(st.integers(1, 2))):
        above = draw(st.sampled_from([*places]))
        at = (number(-0.2, 0.2), number(-0.1, 0.2))
        arm = (number(-0.1, 0.1), number(0.2, 0.4))
        angle, rate = number(-1.5, 1.5), number(-2, 2) if kind in ("tree", "twice") else 0.0
        centre, lean, speed, spin = places[above]
        held, hung = turned(lean, *at), turned(angle, *arm)
        place = centre + held - hung
        velocity = speed + spin * np.array([-held[1], held[0]])
        velocity = velocity - rate * np.array([-hung[1], hung[0]])
        name = f"bob{i}"
        places[name] = place, angle, velocity, rate
        start = {"x": place[0], "y": place[1], "angle": angle}
        start |= {"dx": velocity[0], "dy": velocity[1], "dangle": rate}
        bodies[name] = Body(mass=number(0.3, 3), inertia=number(0.05, 0.5), start=start)
        joints[f"hinge{i}"] = Joint(point=Point(body=name, at=arm), to=Point(body=above, at=at))
    if kind == "twice":
        joints["again"] = joints["hinge0"]
    elif kind != "tree":
        centre, lean, *_ = places[name]
        spot = (number(-0.2, 0.2), number(-0.3, 0.1))
        end = centre + turned(lean, *spot)
        to: Any = Path(x=end[0]) if draw(st.booleans()) else Path(y=end[1])
        if kind == "driven":
            to = Path(x=f"{end[0]} + time**2*{number(-1, 1)}")
        elif kind == "pivot":
            to = (end[0], end[1])
        elif kind in ("loop", "weld"):
            # In a loop the chain's end; a weld where there is one body but the cart.
            to = Point(body="cart", at=tuple((end - [0, HEIGHT]).tolist()))
        joints["last"] = Joint(point=Point(body=name, at=spot), to=to)
    mu: float | str = draw(st.sampled_from([0.3, 0.6, 1.5, "inf"]))
    return Scene(bodies=bodies, joints=joints, **cart(feet, mu, number(-8, 8)))


def assert_newton(scene: Scene, simulator: Simulator, trace: Trace) -> None:
    """Assert Newton's equations of every body, and that forces are in their cones, and least."""
    model = simulator.automaton
    names, size = [*scene.bodies], 3 * len(scene.bodies)
    contacts = [f"{contact}.{f}" for contact in scene.contacts for f in "VH"]
    rows = [f"{joint}.{c}" for joint, held in scene.joints.items() for c in held.components]
    formulas = [*model.names, *model.rates[size:], *contacts, *rows]
    found = Observer(simulator).sample(trace, formulas, per_step=1)  # type: ignore[arg-type]
    table = np.column_stack([found.columns[formula] for formula in formulas])
    masses = np.array([m for b in scene.bodies.values() for m in (b.mass, b.mass, b.inertia)])
    weight = -GRAVITY * np.array([0.0, 1.0, 0.0] * len(names)) * masses
    weight[0] += scene.forces["push"].force[0]
    scale = GRAVITY * masses[::3].sum() + 10.0

    def columns(body: str, at: Any, angle: float) -> Array:
        x, y = turned(angle, *at)
        found = np.zeros((2, size))
        found[:, 3 * names.index(body) : 3 * names.index(body) + 3] = [[1, 0, -y], [0, 1, x]]
        return found

    for row, mode in zip(table, found.mode, strict=True):
        states = found.modes[mode]
        angles = dict(zip(names, row[2:size:3], strict=True))
        accelerations = row[2 * size : 3 * size]
        forces, reactions = np.split(row[3 * size :], [len(contacts)])
        touch = np.vstack([
            columns("cart", contact.point.at, angles["cart"])[::-1]
            for contact in scene.contacts.values()
        ])  # fmt: skip
        held = []
        for joint in scene.joints.values():
            both = columns(joint.point.body, joint.point.at, angles[joint.point.body])
            if isinstance(joint.to, Point):
                both = both - columns(joint.to.body, joint.to.at, angles[joint.to.body])
            held += [both["XY".index(c)] for c in joint.components]
        left = masses * accelerations - weight - touch.T @ forces - np.array(held).T @ reactions
        size_of_forces = max(scale, np.abs(row[3 * size :]).max())
        assert np.abs(left).max() <= 1e-8 * size_of_forces
        inside = []
        for k, contact in enumerate(scene.contacts.values()):
            V, H = forces[2 * k : 2 * k + 2]
            mu = float(contact.friction)
            room = math.inf if mu == math.inf else mu * V - abs(H)
            assert min(V, room) >= -1e-8 * size_of_forces
            if states[k] == "free":
                assert V == H == 0.0
            elif states[k] == "pin" and min(V, room) > 1e-6 * size_of_forces:
                inside += [2 * k, 2 * k + 1]
            elif states[k].startswith("slide"):
                assert abs(V if mu == math.inf else room) <= 1e-8 * size_of_forces
        if len(inside) == len(contacts):
            # No change of the forces that moves nothing makes them smaller.
            same = null_space(np.vstack([touch, held]).T, rcond=1e-9)
            assert np.abs(same[: len(contacts)].T @ forces).max() <= 1e-7 * size_of_forces


@given(st.sampled_from(KINDS).flatmap(jointed))
@examples(6)
def test_joints_with_indeterminate_feet_satisfy_newton(scene: Scene) -> None:
    simulator = Simulator(automaton(scene), engine("scipy"))
    trace = simulator.run(until=0.2)
    assert trace.outcome is Outcome.HORIZON
    assert trace.certified
    assert_newton(scene, simulator, trace)


def swinging(angle: float, rate: float, mu: float | str) -> dict[bool, Scene]:
    """Return a cart with a pendulum: hung by a joint, and by formulas of its angle."""
    s, c = math.sin(angle), math.cos(angle)
    start = {"x": 0.3 * s, "y": HEIGHT - 0.3 * c, "angle": angle}
    start |= {"dx": 0.3 * rate * c, "dy": 0.3 * rate * s, "dangle": rate}
    stand = Body(mass=1, inertia=0.1, start={"y": HEIGHT})
    hinge = Joint(point=Point(body="bob", at=(0, 0.3)), to=Point(body="cart"))
    led = {
        "cart": Body(mass=1, inertia=0.1, position=("x", "y"), angle="tilt"),
        "bob": Body(
            mass=2,
            inertia=0.4,
            position=("x + 0.3*sin(lean)", "y - 0.3*cos(lean)"),
            angle="lean",
        ),
    }
    coordinates = {
        "x": Coordinate(start=0),
        "y": Coordinate(start=HEIGHT),
        "tilt": Coordinate(start=0),
        "lean": Coordinate(start=angle, rate=rate),
    }
    return {
        True: Scene(
            bodies={"cart": stand, "bob": Body(mass=2, inertia=0.4, start=start)},
            joints={"hinge": hinge},
            **cart([-0.3, 0.3], mu),
        ),
        False: Scene(coordinates=coordinates, bodies=led, **cart([-0.3, 0.3], mu)),
    }


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(
    ("angle", "rate", "mu"), [(0, 0, 0.6), (0.5, 0, "inf"), (1.0, 3.0, 0.6), (1.4, 0.0, 0.3)]
)
def test_a_pendulum_swings_on_a_cart_as_without_the_joint(
    name: str, angle: float, rate: float, mu: float | str
) -> None:
    ends = []
    for jointed, scene in swinging(angle, rate, mu).items():
        simulator = Simulator(automaton(scene), engine(name))
        trace = simulator.run(until=0.5)
        assert trace.certified
        place = ("cart.x", "cart.y", "bob.angle") if jointed else ("x", "y", "lean")
        feet = ("foot0.V", "foot0.H", "foot1.V", "foot1.H")
        ends.append(Observer(simulator).final(trace, [*place, *feet]))
        if angle == rate == 0.0:
            assert ends[-1] == pytest.approx([0, HEIGHT, 0, 14.715, 0, 14.715, 0], abs=1e-12)
    assert ends[0] == pytest.approx(ends[1], rel=1e-8, abs=1e-9)


def test_a_pendulum_swings_on_a_cart_as_by_time_steps() -> None:
    scene = swinging(1.0, 3.0, 0.6)[True]
    exact = Runner(scene, engine="scipy").run(until=0.3).trace.final
    by_steps = Runner(scene, engine="impulse", step=1e-4).run(until=0.3).trace.final
    assert by_steps == pytest.approx(exact, abs=2e-3)


def chain(starts: list[float], e: float) -> Scene:
    """Return a chain of links over a floor, with a contact at every joint and both ends."""
    x, y = "x", "y"
    bodies, contacts = {}, {}
    coordinates = {"x": Coordinate(start=0), "y": Coordinate(start="h")}
    for i, start in enumerate(starts):
        coordinates[f"a{i}"] = Coordinate(start=start)
        along, up = f"l*cos(a{i})", f"l*sin(a{i})"
        bodies[f"link{i}"] = Body(
            mass="m", inertia="m*l**2/12", position=(f"{x} + {along}/2", f"{y} + {up}/2"),
            angle=f"a{i}",
        )  # fmt: skip
        x, y = f"{x} + {along}", f"{y} + {up}"
        ends = {"c0": "-l/2"} if i == 0 else {}
        for name, at in {**ends, f"c{i + 1}": "l/2"}.items():
            contacts[name] = Contact(
                point=Point(body=f"link{i}", at=(at, 0)), surface="floor", friction="mu",
                restitution=e,
            )  # fmt: skip
    return Scene(
        name="chain",
        gravity=GRAVITY,
        parameters={"l": 0.2, "m": 0.1, "h": 1, "mu": 0.4},
        coordinates=coordinates,
        bodies=bodies,
        surfaces={"floor": Surface(height=0)},
        contacts=contacts,
    )


@pytest.mark.parametrize("e", [0.0, 0.2])
def test_a_chain_falls_on_a_floor_and_comes_to_rest(e: float) -> None:
    simulator = Simulator(automaton(chain([0.35, 0.9, -0.4, 0.5, -0.1], e)), engine("scipy"))
    trace = simulator.run(until=1.5)
    assert trace.outcome is Outcome.HORIZON
    assert trace.certified
    # At rest, and all of its weight on the floor.
    assert trace.final[7:] == pytest.approx([0.0] * 7, abs=1e-9)
    forces = Observer(simulator).final(trace, [f"c{i}.V" for i in range(6)])
    assert forces.min() >= -1e-9
    assert forces.sum() == pytest.approx(5 * 0.1 * GRAVITY, rel=1e-9)
