"""Moreau's law of impact on both engines, against an enumeration written for these tests.

With several contacts ``v_n+ + e v_n-`` and ``P_n`` are complementary, friction lies in its cone and
opposes the remaining slip (Moreau 1988). If the energy would rise, the impulse is the point on the
line from the plastic one at which it does not.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from runs import golden
from scipy.optimize import linprog
from strategies import examples

from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from statechart.documents.settings import Stop
from statechart.running.runner import Runner

# Remaining part of the step after an impact; the error is of this order.
STEP = 1e-7
# A step does not distinguish solutions closer to a change of mode than this.
MARGIN = 1e-4


def agreeing(mass, jacobians, velocity, mu, e):
    """Return the velocities after, one a solution; None where one is near another mode."""
    found = []
    for modes in product(("open", "stick", "slip+", "slip-"), repeat=len(mu)):
        rows, columns, wanted = [], [], []
        for (n, t), mode, friction, rebound in zip(jacobians, modes, mu, e, strict=True):
            if mode == "open":
                continue
            rows.append(n)
            wanted.append(-rebound * (n @ velocity))
            if mode == "stick":
                rows.append(t)
                wanted.append(0.0)
                columns += [n, t]
            else:
                columns.append(n - friction * t if mode == "slip+" else n + friction * t)
        rows, columns = np.array(rows).reshape(-1, 3), np.array(columns).reshape(-1, 3)
        matrix = rows @ np.linalg.solve(mass, columns.T)
        if len(rows) > 3 or (len(rows) and np.linalg.cond(matrix) > 1e8):
            after, impulses = at_rest(mass, rows, columns, velocity, np.array(wanted), modes, mu)
            if after is None:
                continue
        else:
            impulses = np.linalg.solve(matrix, np.array(wanted) - rows @ velocity)
            after = velocity + np.linalg.solve(mass, columns.T @ impulses)
        at, margins = 0, []
        for (n, t), mode, friction, rebound in zip(jacobians, modes, mu, e, strict=True):
            if mode == "open":
                margins.append(n @ after + rebound * (n @ velocity))
                continue
            margins.append(impulses[at])
            if mode == "stick":
                margins.append(friction * impulses[at] - abs(impulses[at + 1]))
                at += 2
            else:
                margins.append((t @ after) * (1.0 if mode == "slip+" else -1.0))
                at += 1
        if min(margins) > -MARGIN:
            if min(margins) < MARGIN:
                return None
            found.append(after)
    return found


def at_rest(mass, rows, columns, velocity, wanted, modes, mu):
    """Return (velocity after, impulses) where more is held than can move, deepest in the cones."""
    after, _, rank, _ = np.linalg.lstsq(rows, wanted)
    if rank < 3 or np.abs(rows @ after - wanted).max() > 1e-9:
        return None, None
    within, at = [], 0
    for mode, friction in zip(modes, mu, strict=True):
        if mode == "open":
            continue
        sides = (-1.0, 0.0, 1.0) if mode == "stick" else (0.0,)
        for side in sides:
            row = np.zeros(len(columns) + 1)
            row[at] = -1.0 if side == 0.0 else -friction
            if side != 0.0:
                row[at + 1] = side
            row[-1] = 1.0
            within.append(row)
        at += 2 if mode == "stick" else 1
    equal = np.hstack([columns.T, np.zeros((3, 1))])
    found = linprog(
        [*np.zeros(len(columns)), -1.0],
        A_ub=np.array(within),
        b_ub=np.zeros(len(within)),
        A_eq=equal,
        b_eq=mass @ (after - velocity),
        bounds=[(None, None)] * len(columns) + [(-1.0, 1.0)],
    )
    return (after, found.x[:-1]) if found.success else (None, None)


def capped(mass, before, plastic, target):
    """Return the velocity on the way from one to the other that has the energy before."""

    def energy(v):
        return 0.5 * v @ mass @ v

    if energy(target) <= energy(before):
        return target
    further = target - plastic
    a, b = energy(further), plastic @ mass @ further
    c = energy(plastic) - energy(before)
    return plastic + (-b + math.sqrt(b * b - 4.0 * a * c)) / (2.0 * a) * further


@cache
def runner(contacts, simultaneous, engine):
    """Return a runner of a body with these contacts, each with a line through its point."""
    numbers = range(contacts)
    parameters = {"m": 1.0, "inertia": 1.0, "u": 0.0, "v": 0.0, "w": 0.0}
    for i in numbers:
        parameters |= {f"x{i}": 1.0, f"y{i}": 0.0, f"a{i}": 0.0, f"mu{i}": 1.0, f"e{i}": 0.0}
    scene = Scene(
        name="thrown",
        parameters=parameters,
        gravity=0,
        bodies={
            "b": Body(mass="m", inertia="inertia", start={"dx": "u", "dy": "v", "dangle": "w"})
        },
        surfaces={
            f"s{i}": Surface(line=((f"x{i}", f"y{i}"), (f"x{i} + cos(a{i})", f"y{i} + sin(a{i})")))
            for i in numbers
        },
        contacts={
            f"c{i}": Contact(
                point=Point(body="b", at=(f"x{i}", f"y{i}")),
                surface=f"s{i}",
                friction=f"mu{i}",
                restitution=f"e{i}",
                impact="moreau",
            )
            for i in numbers
        },
        simultaneous=simultaneous,
        stop=Stop(time=4 * STEP),
    )
    if engine == "impulse":
        return Runner(scene, engine=engine, step=STEP)
    return Runner(scene, engine=engine)


@st.composite
def throws(draw):
    """Draw a body whose points all approach the lines through them."""
    unit, wide = st.floats(0.2, 1.0), st.floats(-1.0, 1.0)
    velocity = np.array([draw(wide), draw(wide), draw(wide)])
    mass = np.array([draw(st.floats(0.5, 2.0)), draw(st.floats(0.05, 2.0))])
    jacobians, values = [], {"m": mass[0], "inertia": mass[1]}
    values |= dict(zip("uvw", velocity, strict=True))
    mu, e = [], []
    for i in range(draw(st.integers(1, 3))):
        x, y, a = (
            draw(unit | unit.map(lambda x: -x)),
            draw(wide),
            draw(st.floats(-math.pi, math.pi)),
        )
        for angle in (a, a + math.pi):
            t = np.array([math.cos(angle), math.sin(angle)])
            n = np.array([-t[1], t[0]])
            rows = np.array([[*d, x * d[1] - y * d[0]] for d in (n, t)])
            if rows[0] @ velocity < 0.0:
                break
        assume(rows[0] @ velocity < -0.05)
        jacobians.append(rows)
        mu.append(draw(st.floats(0.0, 2.0)))
        e.append(draw(st.sampled_from([0.0, 1.0]) | unit))
        values |= {f"x{i}": x, f"y{i}": y, f"a{i}": angle, f"mu{i}": mu[-1], f"e{i}": e[-1]}
    mass = np.diag([mass[0], mass[0], mass[1]])
    return values, mass, np.array(jacobians), velocity, mu, e


@given(throws(), st.sampled_from(["capped", "plastic"]))
@examples(30)
def test_both_engines_give_the_velocities_of_the_law(throw, simultaneous):
    values, mass, jacobians, velocity, mu, e = throw
    if simultaneous == "plastic" and len(mu) > 1:
        e = [0.0] * len(mu)
    plastic = agreeing(mass, jacobians, velocity, mu, [0.0] * len(mu))
    target = agreeing(mass, jacobians, velocity, mu, e)
    assume(plastic is not None and target is not None)
    assume(len(plastic) == 1 and len(target) == 1)
    expected = capped(mass, velocity, plastic[0], target[0])
    for engine, error in (("scipy", 10.0 * STEP), ("impulse", 100.0 * STEP)):
        result = runner(len(mu), simultaneous, engine).run(values)
        found = result.trace.final
        if engine == "scipy":
            # At once, before forces have turned the body any further.
            found = [jump for jump in result.trace.jumps if jump.t == 0.0][-1].after
        assert found[3:] == pytest.approx(expected, abs=error), engine
        # A run warns where sequential impacts would have another outcome.
        lively = simultaneous == "capped" and sum(value >= 0.5 for value in e) > 1
        reported = [w for w in result.warnings if "law" in w]
        if lively:
            reported = [w for w in reported if "at once" not in w]
        assert not reported, engine


@pytest.mark.parametrize(("place", "warned"), [(-1.0, False), (-0.5, True)])
def test_uncoupled_impacts_have_no_order(place, warned):
    # A turning body is struck in directions that are across each other, as its inertia counts.
    values = {
        "w": 1.0, "x0": 1.0, "a0": 1.0 + math.pi, "mu0": 0.0, "e0": 1.0, "x1": place, "y1": 0.0,
        "mu1": 0.0, "e1": 1.0,
    }  # fmt: skip
    rows = [(-math.sin(1.0 + math.pi), math.cos(1.0 + math.pi), math.cos(1.0 + math.pi))]
    rows.append((0.0, 1.0, place))
    assert (abs(np.dot(*rows)) > 1e-9) == warned
    for engine, words in (
        ("impulse", "in several places at once"),
        ("taylor", "are struck at once"),
    ):
        warnings = runner(2, "capped", engine).run(values).warnings
        assert any(words in w for w in warnings) == warned, engine


@pytest.mark.parametrize("case", golden("impacts_and_timestepping")["impacts"])
def test_one_contact_is_the_closed_form_of_the_law(case):
    phi, mu = math.radians(case["phi_deg"]), case["mu"]
    values = {
        "m": 1.0, "inertia": 1 / 3, "u": case["u_minus"], "v": case["v_minus"], "mu0": mu,
        "x0": -math.sin(phi), "y0": -math.cos(phi), "e0": case["e"],
    }  # fmt: skip
    (expected,) = case["newton_lcp"]
    before = 0.5 * (values["u"] ** 2 + values["v"] ** 2)
    for engine in ("taylor", "scipy", "impulse"):
        (jump, *_) = runner(1, "capped", engine).run(values).trace.jumps
        V, H = jump.impulse["c0"]
        if float(expected["energy_change"]) <= 0.0:
            assert pytest.approx((float(expected["Py"]), float(expected["Px"])), abs=1e-6) == (V, H)
        else:
            after = 0.5 * (jump.after[3:] ** 2 @ [1.0, 1.0, 1 / 3])
            assert after == pytest.approx(before, abs=1e-6)


def rod(impact):
    """Return a rod that strikes the floor with its end while it slips."""
    return Scene(
        name="rod",
        parameters={"lean": "pi/4"},
        gravity=0,
        bodies={
            "b": Body(
                mass=1,
                inertia="1/3",
                start={"x": "sin(lean)", "y": "cos(lean)", "dx": 0.3, "dy": -1},
            )
        },
        surfaces={"floor": Surface(height=0)},
        contacts={
            "tip": Contact(
                point=Point(body="b", at=("-sin(lean)", "-cos(lean)")),
                surface="floor",
                friction=0.4,
                restitution=0,
                impact=impact,
            )
        },
        stop=Stop(time=1e-3),
    )


@pytest.mark.parametrize("impact", ["stronge", "newton", "poisson", "moreau"])
def test_a_run_warns_if_it_applies_another_law_than_the_declared_one(impact):
    events = Runner(rod(impact)).run()
    steps = Runner(rod(impact), engine="impulse", step=1e-5).run()
    ours, theirs = (r.trace.jumps[0].impulse["tip"] for r in (steps, events))
    left_out = [part["what"] for part in steps.to_dict()["left_out"]]
    if impact == "moreau":
        assert ours == pytest.approx(theirs, rel=1e-3)
        assert not steps.warnings
        assert not any("impact" in what for what in left_out)
    else:
        # The path slips to its end; the law of velocities ends where it would stick.
        assert abs(ours[1] - theirs[1]) > 0.05
        assert any(impact in warning and "Moreau" in warning for warning in steps.warnings)
        assert f"impact: {impact} at tip" in left_out
    assert not any("Moreau" in warning for warning in events.warnings)


def test_a_sequence_of_impacts_is_no_law_of_steps():
    result = Runner("newtons_cradle", engine="impulse", step=1e-3).run(until=0.1)
    said = "simultaneous: sequential"
    assert any(warning.startswith(said) for warning in result.warnings)
    assert said in [part["what"] for part in result.to_dict()["left_out"]]
