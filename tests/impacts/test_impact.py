"""Frictional impacts of one contact: reference numbers and laws that hold for all."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, golden

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.impacts.impact import Impact, impact
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

GOLDEN = golden("impacts_and_timestepping")["impacts"]


def rod(phi: float, u: float, v: float, inertia: float = 1 / 3, mass: float = 1.0) -> Snapshot:
    """Return a rod of unit arm that leans by phi and whose tip moves at (u, v)."""
    s, c = math.sin(phi), math.cos(phi)
    # The tip is at the centre plus (-s, -c); the angle is counter-clockwise.
    jacobian = np.array([[0.0, 1.0, -s], [1.0, 0.0, c]])
    velocity = np.array([u, v, 0.0])
    contact = PerContact(0.0, v, u, 0.0, 0.0, 1.0, 0.0)
    return Snapshot(
        np.diag([mass, mass, inertia]),
        np.zeros(3),
        velocity,
        0.0,
        (contact,),
        jacobian[None],
        np.zeros((1, 2)),
    )


def law(mu: float, name: str = "stronge") -> ContactLaw:
    edge = math.hypot(1.0, mu) if math.isfinite(mu) else math.inf
    n, t = (0.0, 1.0) if math.isinf(mu) else (1.0 / edge, mu / edge)
    return ContactLaw("tip", ("free", "slide+", "slide-", "pin"), n, t, 0.0, name)


def energy(snapshot: Snapshot, velocity: np.ndarray) -> float:
    return float(0.5 * velocity @ snapshot.mass @ velocity)


def after(snapshot: Snapshot, result: Impact) -> tuple[float, float]:
    n, t = snapshot.jacobians[0] @ result.velocity
    return float(n), float(t)


@pytest.mark.parametrize("case", GOLDEN, ids=lambda c: f"phi={c['phi_deg']} e={c['e']}")
def test_routh_path_with_poisson_restitution(case: dict) -> None:
    tilt, u, v, e = (float(case[key]) for key in ("phi_deg", "u_minus", "v_minus", "e"))
    snapshot = rod(math.radians(tilt), u, v)
    result = impact(snapshot, 0, law(case["mu"], "poisson"), e)
    expected = case["routh_poisson"]
    assert list(result.path) == expected["sequence"]
    assert result.normal == pytest.approx(float(expected["Py"]), abs=1e-11)
    assert result.tangential == pytest.approx(float(expected["Px"]), abs=1e-11)
    normal, tangential = after(snapshot, result)
    assert tangential == pytest.approx(float(expected["u_plus"]), abs=1e-11)
    assert normal == pytest.approx(float(expected["v_plus"]), abs=1e-11)


@pytest.mark.parametrize("name", ["stronge", "newton", "poisson"])
@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_the_laws_agree_on_a_central_impact(name: str, e: float) -> None:
    snapshot = rod(0.0, 0.0, -2.0)
    result = impact(snapshot, 0, law(0.3, name), e)
    assert after(snapshot, result)[0] == pytest.approx(2.0 * e, abs=1e-14)
    assert result.normal == pytest.approx(2.0 * (1 + e), abs=1e-14)
    assert result.tangential == 0.0


def test_newton_is_a_ratio_of_speeds() -> None:
    snapshot = rod(0.7, 0.4, -1.0)
    result = impact(snapshot, 0, law(0.2, "newton"), 0.6)
    assert after(snapshot, result)[0] == pytest.approx(0.6, abs=1e-14)


def test_stronge_is_a_ratio_of_works() -> None:
    snapshot, e = rod(0.9, 0.8, -1.0), 0.7
    full = impact(snapshot, 0, law(0.4), e)
    # Work of the normal force: lost energy minus work of friction, in compression and after.
    plastic = impact(snapshot, 0, law(0.4), 0.0)
    assert plastic.path[0] == full.path[0]
    assert after(snapshot, plastic)[0] == pytest.approx(0.0, abs=1e-14)
    assert 0.0 < after(snapshot, full)[0] < 1.0
    assert full.normal > plastic.normal


@pytest.mark.parametrize("mu", [0.0, 0.3, math.inf])
def test_mirror_images_have_mirrored_impacts(mu: float) -> None:
    one, other = rod(0.6, 0.5, -1.0), rod(-0.6, -0.5, -1.0)
    left, right = (impact(s, 0, law(mu), 0.5) for s in (one, other))
    assert left.normal == pytest.approx(right.normal, rel=1e-14)
    assert left.tangential == pytest.approx(-right.tangential, rel=1e-14, abs=1e-16)


def test_random_impacts_keep_energy_cone_and_separation() -> None:
    random = np.random.default_rng(7)
    for _ in range(6_000):
        inertia = 10.0 ** random.uniform(-12, 12)
        mu = 10.0 ** random.uniform(-12, 6)
        e = random.choice([0.0, 1.0, random.uniform()])
        snapshot = rod(
            random.uniform(-math.pi, math.pi),
            random.normal(),
            -abs(random.normal()) - 1e-3,
            inertia,
        )
        # Spin as well, without changing how the tip moves.
        spin = random.normal()
        jacobian = snapshot.jacobians[0]
        velocity = snapshot.velocity + np.array([-jacobian[1, 2], -jacobian[0, 2], 1.0]) * spin
        snapshot = snapshot._replace(velocity=velocity)
        result = impact(snapshot, 0, law(mu), e)
        before, left = energy(snapshot, snapshot.velocity), energy(snapshot, result.velocity)
        assert left <= before * (1 + 1e-12), (inertia, mu, e)
        assert abs(result.tangential) <= mu * result.normal * (1 + 1e-12) + 1e-300
        # The round-off of the normal velocity is relative to its terms.
        terms = np.abs(jacobian[0]) @ np.abs(result.velocity - velocity) + np.abs(velocity).sum()
        assert after(snapshot, result)[0] >= -1e-13 * terms, (inertia, mu, e)


def test_a_point_mass_on_a_stick_stops_along_it() -> None:
    snapshot = rod(0.3, 0.0, -1.0, inertia=0.0)
    result = impact(snapshot, 0, law(1.0), 0.0)
    # Without inertia no impulse across the stick is possible.
    assert result.path == ("stick",)
    assert result.tangential / result.normal == pytest.approx(math.tan(0.3), rel=1e-12)


SWINGING = """
kind: scene
name: swinging
parameters: {mu: 1, e: 0.5, low: 0.2}
gravity: 1
coordinates: {q: {start: 1}}
bodies: {bob: {mass: 1, position: [sin(q), -cos(q)], angle: q}}
surfaces: {floor: {height: -cos(low)}}
contacts: {touch: {point: {body: bob}, surface: floor, friction: mu, restitution: e}}
stop: {time: 4}
"""


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(("mu", "wedged"), [(0.1, False), (0.19, False), (0.21, True), (3, True)])
def test_pushed_bob_wedges_above_the_critical_friction(name: str, mu: float, wedged: bool) -> None:
    # Going back, its way leaves the floor at the angle `low`: tan(0.2) = 0.203. Steeper friction
    # keeps it where it stopped, and whatever restitution there is has nothing to give back to.
    trace = Runner(read_text(SWINGING), engine=name).run({"mu": mu}).trace
    first = trace.jumps[0]
    assert first.after[0] == pytest.approx(0.2, abs=1e-12)
    if wedged:
        assert "wedge" in " ".join(first.path)
        assert trace.final_mode == ("pin",)
        assert trace.final == pytest.approx([0.2, 0.0], abs=1e-12)
        assert len(trace.jumps) == 1
    else:
        assert first.after[1] > 0.0
        assert first.energy is not None
        assert first.energy[1] < first.energy[0]
