"""Couplings against closed forms: dry friction as a couple, locking, slipping and opening."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import statechart
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import EventLoop
from statechart.loading.load import interpret
from statechart.running.runner import Runner

ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy"])
# Error of an event time: SciPy integrates to 1e-12.
EXACT = 1e-9


def run(text: str, engine: str = "taylor", **parameters: float):
    return statechart.run(interpret(read_text(text)), engine=engine, parameters=parameters)


def events(trace, *causes: str) -> list[tuple[str, float]]:
    return [(f"{j.region} {j.cause}", j.t) for j in trace.jumps if not causes or j.cause in causes]


ROTOR = """
kind: scene
name: rotor
parameters: {J: 2, k: 8, T: 1, start: 1.1}
bodies: {rotor: {mass: 3, inertia: J, start: {angle: start}}}
joints: {pivot: {point: {body: rotor}, to: [0, 0]}}
couplings: {bearing: {joint: pivot, limit: T}}
forces: {spring: {body: rotor, moment: -k*rotor.angle}}
stop: {time: 8}
outputs: {end: {value: rotor.angle}, couple: {value: bearing.M}}
"""


@ENGINES
@pytest.mark.parametrize("start", [1.1, -1.1, 0.8, 0.1])
def test_pendulum_in_a_dry_joint_stops_after_whole_half_swings(engine: str, start: float) -> None:
    # Each half swing lasts pi/w and costs 2 T/k; it rests once the spring is below T.
    w, lost, rest = 2.0, 0.25, 0.125
    swings = max(0, math.ceil((abs(start) - rest) / lost))
    result = run(ROTOR, engine, start=start)
    found = events(result.trace)
    turns = [("bearing reverse", (n + 1) * math.pi / w) for n in range(swings - 1)]
    expected = [*turns, *([("bearing lock", swings * math.pi / w)] if swings else [])]
    assert [name for name, _ in found] == [name for name, _ in expected]
    np.testing.assert_allclose([t for _, t in found], [t for _, t in expected], atol=EXACT)
    end = start * (1.0 - lost * swings / abs(start)) * (-1) ** swings
    assert result.outputs["end"] == pytest.approx(end, abs=EXACT)
    assert result.outputs["couple"] == pytest.approx(8.0 * end, abs=1e-8)
    assert result.trace.arcs[-1].mode == ("locked",)


GUIDE = """
kind: scene
name: guide
gravity: 9.81
parameters: {v: 2, F: 3, m: 2}
bodies: {slider: {mass: m, start: {dx: v}}}
joints: {rail: {point: {body: slider}, to: {y: 0}}}
couplings: {rail_friction: {joint: rail, limit: F}}
stop: {time: 3}
outputs: {way: {value: slider.x}}
"""


@ENGINES
def test_friction_along_a_guide_stops_a_slider_in_its_braking_distance(engine: str) -> None:
    result = run(GUIDE, engine)
    ((name, t),) = events(result.trace)
    assert name == "rail_friction lock"
    assert t == pytest.approx(2.0 * 2 / 3, abs=EXACT)
    assert result.outputs["way"] == pytest.approx(2.0 * 4 / (2 * 3), abs=EXACT)


RAMP = """
kind: scene
name: ramp
parameters: {J: 2, s: 3, k: 2, rate: 1.5}
coordinates: {phi: {}}
bodies: {wheel: {mass: 1, inertia: J, position: [0, 0], angle: phi}}
couplings: {brake: {bodies: [wheel], limit: {static: s, kinetic: k}}}
forces: {drive: {body: wheel, moment: rate*time}}
stop: {time: 4}
outputs: {speed: {value: dphi}}
"""


@ENGINES
def test_static_limit_holds_until_the_moment_exceeds_it(engine: str) -> None:
    result = run(RAMP, engine)
    ((name, t),) = events(result.trace)
    assert (name, t) == ("brake slip", pytest.approx(2.0, abs=EXACT))
    # J w' = rate t - k from t = s/rate on.
    speed = (1.5 * (16 - 4) / 2 - 2 * (4 - 2)) / 2
    assert result.outputs["speed"] == pytest.approx(speed, abs=EXACT)


def test_static_limit_below_the_kinetic_one_is_refused_at_its_place() -> None:
    with pytest.raises(statechart.DeclarationError) as result:
        run(RAMP, s=1)
    assert "couplings.brake.limit" in str(result.value)
    assert "static limit 1 is below the kinetic one, 2" in str(result.value)


CLUTCHES = """
kind: scene
name: coupled_clutches
parameters: {T2: 0.4, T3: 0.9, M: 10, peak: 1.1, w0: 10}
coordinates: {p1: {rate: w0}, p2: {}, p3: {}, p4: {}}
bodies:
  J1: {mass: 1, inertia: 1, position: [0, 0], angle: p1}
  J2: {mass: 1, inertia: 1, position: [1, 0], angle: p2}
  J3: {mass: 1, inertia: 1, position: [2, 0], angle: p3}
  J4: {mass: 1, inertia: 1, position: [3, 0], angle: p4}
couplings:
  clutch1:
    bodies: [J1, J2]
    limit: {static: peak*M*cos(0.4*pi*time), kinetic: M*cos(0.4*pi*time)}
    enabled: cos(0.4*pi*time) >= 0
  clutch2: {bodies: [J2, J3], limit: {static: peak*M, kinetic: M}, enabled: time >= T2}
  clutch3: {bodies: [J3, J4], limit: {static: peak*M, kinetic: M}, enabled: time >= T3}
forces: {drive: {body: J1, moment: 10*sin(10*pi*time)}}
stop: {time: 1.5}
outputs: {w1: {value: dp1}, w2: {value: dp2}, w3: {value: dp3}, w4: {value: dp4}}
"""
T2, T3, PEAK = 0.4, 0.9, 1.1


def _limits(t: float) -> np.ndarray:
    """Return the kinetic limits of the three clutches, 0 while they are open."""
    return np.array([max(10 * math.cos(0.4 * math.pi * t), 0), 10 * (t >= T2), 10 * (t >= T3)])


def _drive(t: float) -> float:
    return 10 * math.sin(10 * math.pi * t)


@functools.cache
def _clutch_events() -> tuple[list[tuple[str, float]], np.ndarray]:
    """Return lock, slip and open times of the clutches, and the last speeds, by quadratures.

    Each clutch is open, locked or slips forwards. Wheels that are locked to each other are one; all
    moments are elementary functions of time, so that speeds have antiderivatives.
    """
    t, speeds, states, found = 0.0, np.array([10.0, 0, 0, 0]), ["slip", "open", "open"], []

    def impulses(k: int, a: float, b: float) -> float:
        if k == 0:
            w = 0.4 * math.pi
            return 10 * (math.sin(w * min(b, 1.25)) - math.sin(w * min(a, 1.25))) / w
        return 10 * (b - a)

    def groups() -> list[list[int]]:
        found = [[0]]
        for k in range(3):
            if states[k] == "locked":
                found[-1].append(k + 1)
            else:
                found.append([k + 1])
        return found

    def after(b: float) -> np.ndarray:
        w = 10 * math.pi
        given = np.array([10 * (math.cos(w * t) - math.cos(w * b)) / w, 0, 0, 0])
        for k in range(3):
            if states[k] == "slip":
                given[k] -= impulses(k, t, b)
                given[k + 1] += impulses(k, t, b)
        result = speeds.copy()
        for group in groups():
            result[group] += given[group].mean()
        return result

    def couple(k: int, t: float) -> float:
        """Return the couple that a locked clutch transmits to its second wheel."""
        moments = np.array([_drive(t), 0, 0, 0])
        limits = _limits(t)
        for i in range(3):
            if states[i] == "slip":
                moments[i] -= limits[i]
                moments[i + 1] += limits[i]
        group = next(g for g in groups() if k in g and k + 1 in g)
        rate = moments[group].mean()
        behind = [i for i in group if i > k]
        return rate * len(behind) - moments[behind].sum()

    def margin(k: int, b: float) -> float:
        if states[k] == "slip":
            wheels = after(b)
            return wheels[k] - wheels[k + 1]
        return PEAK * _limits(b)[k] - abs(couple(k, b))

    changes = [(1, T2, "slip", "close"), (2, T3, "slip", "close"), (0, 1.25, "open", "open")]
    while True:
        due = min((c[1] for c in changes if c[1] > t + 1e-12), default=1.5)
        due = min(due, 1.5)
        first = None
        for k in range(3):
            if states[k] == "open":
                continue
            grid = np.linspace(t, due, 4001)
            values = [margin(k, b) for b in grid]
            # A clutch that has just closed or slipped begins at a margin of zero.
            for one, other, low, high in zip(grid, grid[1:], values, values[1:], strict=False):
                if low > 1e-9 and high < 0:
                    root = brentq(lambda b, k=k: margin(k, b), one, other, xtol=1e-15, rtol=1e-15)
                    if first is None or root < first[0]:
                        first = root, k
                    break
        if first is not None and first[0] < due:
            b, k = first
            now, cause = ("locked", "lock") if states[k] == "slip" else ("slip", "slip")
        elif due < 1.5:
            k, b, now, cause = next(c for c in changes if c[1] == due)
        else:
            return found, after(1.5)
        speeds, t = after(b), b
        states[k] = now
        found.append((f"clutch{k + 1} {cause}", b))


@ENGINES
def test_coupled_clutches_lock_at_the_quadrature_times(engine: str) -> None:
    result = run(CLUTCHES, engine)
    expected, speeds = _clutch_events()
    found = events(result.trace)
    assert [name for name, _ in found] == [name for name, _ in expected]
    np.testing.assert_allclose([t for _, t in found], [t for _, t in expected], atol=EXACT)
    np.testing.assert_allclose([*result.outputs.values()], speeds, atol=EXACT)


def test_coupled_clutches_move_as_regularised_friction_does() -> None:
    # No event: each couple is a steep smooth function of its slip, with a peak near zero.
    width = 2e-4

    def rate(t: float, w: np.ndarray) -> np.ndarray:
        slip = w[:3] - w[1:]
        s = slip / width
        peak = 1 + (PEAK - 1) * 2 * np.abs(s) / (1 + s**2)
        m = _limits(t) * np.tanh(4 * s) * peak
        return np.array([_drive(t) - m[0], m[0] - m[1], m[1] - m[2], m[2]])

    w = np.array([10.0, 0, 0, 0])
    for a, b in ((0, T2), (T2, T3), (T3, 1.5)):
        part = solve_ivp(rate, (a + 1e-12, b), w, "LSODA", rtol=1e-8, atol=1e-9, max_step=1e-3)
        w = part.y[:, -1]
    np.testing.assert_allclose([*run(CLUTCHES).outputs.values()], w, atol=1e-3)


CAR = """
kind: scene
name: braking
parameters:
  {mc: 1200, Ic: 1500, mw: 40, Iw: 1.8, r: 0.3, h: 0.55, lf: 1.2, lr: 1.4, mu: 0.8, kf: 400,
   kr: 500, v0: 30, g: 9.81}
gravity: g
bodies:
  car: {mass: mc, inertia: Ic, start: {y: h, dx: v0}}
  front: {mass: mw, inertia: Iw, start: {x: lf, y: r, dx: v0, dangle: -v0/r}}
  rear: {mass: mw, inertia: Iw, start: {x: -lr, y: r, dx: v0, dangle: -v0/r}}
surfaces: {road: {height: 0}}
joints:
  front_axle: {point: {body: front}, to: {body: car, at: [lf, r - h]}}
  rear_axle: {point: {body: rear}, to: {body: car, at: [-lr, r - h]}}
contacts:
  f: {point: {body: front}, radius: r, surface: road, friction: mu, restitution: 0}
  b: {point: {body: rear}, radius: r, surface: road, friction: mu, restitution: 0}
couplings:
  front_brake: {bodies: [front, car], limit: kf*time}
  rear_brake: {bodies: [rear, car], limit: kr*time}
stop: {time: 6}
outputs: {v: {value: car.dx}}
"""


def _car() -> tuple[float, float, float]:
    """Return when the rear wheel begins to slip, when it locks, and the speed then.

    While both roll, a = -(kf + kr) t / (r M*), and all forces are linear in time; once the rear
    wheel slips, its force is mu V, and a, V and the wheel's rate follow linearly again.
    """
    mc, mw, iw, r, h, lf, lr, mu = 1200, 40, 1.8, 0.3, 0.55, 1.2, 1.4, 0.8
    kf, kr, v0, g = 400, 500, 30, 9.81
    lead = mc * h + 2 * mw * r
    weight = (mc + 2 * mw) * g

    # Rolling: per time, of a, H_r and V_r (and V_r at the start).
    a = -(kf + kr) / r / (mc + 2 * mw + 2 * iw / r**2)
    rear0 = (weight * lf - mw * g * (lf - lr)) / (lf + lr)
    rear = (lead * a + 2 * iw * a / r) / (lf + lr)
    push = -kr / r - iw * a / r**2
    slips = mu * rear0 / (-push - mu * rear)
    v, w = v0 + a * slips**2 / 2, -(v0 + a * slips**2 / 2) / r

    # Slipping: unknown a, rate of the rear wheel u, H_f, V_r, linear in what time gives.
    def solved(t: float) -> np.ndarray:
        front = -iw / r**2  # H_f = -kf t/r + front a
        matrix = np.array(
            [
                [mc + 2 * mw - front, 0, mu],
                [0, iw, mu * r],
                [lead + iw / r, -iw, -(lf + lr)],
            ]
        )
        right = np.array([-kf * t / r, kr * t, -weight * lf + mw * g * (lf - lr)])
        return np.linalg.solve(matrix, right)

    one, two = solved(slips), solved(slips + 1)
    (a1, u1, _), (a2, u2, _) = one, two - one
    # w + u1 s + u2 s^2/2 = 0
    s = (-u1 + math.sqrt(u1**2 - 2 * u2 * w)) / u2
    return slips, slips + s, v + a1 * s + a2 * s**2 / 2


@ENGINES
def test_rear_wheels_lock_at_the_load_transfer_limit(engine: str) -> None:
    slips, locks, speed = _car()
    trace = run(CAR, engine).trace
    found = events(trace)[:2]
    assert [name for name, _ in found] == ["b slip", "rear_brake lock"]
    np.testing.assert_allclose([t for _, t in found], [slips, locks], atol=EXACT)
    jump = trace.jumps[1]
    assert jump.after[9] == pytest.approx(speed, abs=EXACT * 30)


def test_braked_car_comes_to_rest_on_locked_wheels() -> None:
    result = run(CAR)
    assert result.outputs["v"] == pytest.approx(0.0, abs=1e-12)
    assert result.trace.arcs[-1].mode == ("pin", "pin", "locked", "locked")


BEAM = """
kind: scene
name: beam
gravity: 9.81
parameters: {I: 2, m: 0.5, L: 1.5, drop: 0.4, T: 12}
coordinates: {phi: {}}
bodies:
  beam: {mass: 1, inertia: I, position: [0, 0], angle: phi}
  ball: {mass: m, start: {x: L, y: drop}}
surfaces: {top: {line: [[0, 0], [1, 0]], body: beam}}
contacts: {c: {point: {body: ball}, surface: top, friction: 5, restitution: 0}}
couplings: {brake: {bodies: [beam], limit: T}}
stop: {time: 1}
outputs: {angle: {value: phi}}
"""


def test_impact_makes_a_locked_coupling_slip() -> None:
    # The solid of a line is on the right of its way: below, from the left to the right.
    trace = run(BEAM).trace
    first = trace.jumps[0]
    assert (first.region, first.cause) == ("c", "touchdown")
    assert first.target[-1] == "slip-"
    v = math.sqrt(2 * 9.81 * 0.4)
    assert first.after[3] == pytest.approx(-0.5 * 1.5 * v / (2 + 0.5 * 1.5**2), abs=EXACT)
    assert [name for name, _ in events(trace)][1] == "brake lock"


def test_steps_warn_of_a_slip_shorter_than_a_step_that_a_controller_waits_for() -> None:
    watch = """regions:
  watch:
    initial: rests
    states: {rests: {}, rings: {}}
    transitions: [{name: ring, from: rests, to: rings, on: brake.lock}]
"""
    model = interpret(read_text(BEAM + watch))
    # It slips for I w/(T - m g L): 0.2 ms at T = 1e4.
    exact = statechart.run(model, parameters={"T": 1e4})
    assert exact.trace.final_mode[-1] == "rings"
    setting = {"engine": "impulse", "parameters": {"T": 1e4}}
    coarse = statechart.run(model, step=1e-3, **setting)
    assert coarse.trace.final_mode[-1] == "rests"
    assert any("brake: the impact at" in w and "watch.ring waits" in w for w in coarse.warnings)
    fine = statechart.run(model, step=1e-5, **setting)
    assert fine.trace.final_mode[-1] == "rings"
    assert not any("brake: the impact at" in warning for warning in fine.warnings)


@pytest.mark.parametrize(("drop", "restitution"), [(0.4, 0.0), (1e-5, 0.0), (1e-5, 0.2)])
@pytest.mark.parametrize("struck", [True, False])
def test_steps_warn_of_impacts_at_the_bodies_of_a_locked_coupling_only(
    struck: bool, drop: float, restitution: float
) -> None:
    """A ball falls on the beam of a brake, or on the world beside it.

    From 1e-5 it closes without an impulse by steps.
    """
    text = BEAM if struck else BEAM.replace(", body: beam}", "}")
    text = text.replace("restitution: 0", f"restitution: {restitution}")
    watch = """regions:
  watch:
    initial: rests
    states: {rests: {}, rings: {}}
    transitions: [{name: ring, from: rests, to: rings, on: brake.slip}]
"""
    result = statechart.run(
        read_text(text + watch), engine="impulse", step=1e-3, parameters={"T": 1e4, "drop": drop}
    )
    assert bool(result.trace.jumps[0].impulse) == (drop == 0.4)
    assert [jump.cause for jump in result.trace.jumps][:1] == ["touchdown"]
    assert sum("brake: the impact at" in warning for warning in result.warnings) == struck


def test_open_coupling_that_closes_on_turning_wheels_slips_until_the_speeds_meet() -> None:
    text = CLUTCHES.replace("10*sin(10*pi*time)", "0").replace("cos(0.4*pi*time) >= 0", "time >= 9")
    trace = run(text.replace("w0: 10", "w0: 0").replace("p2: {}", "p2: {rate: 3}")).trace
    # Wheels 2 and 3 meet at 1.5 each after 1.5/10 s; then 4 takes part.
    found = events(trace)
    assert [name for name, _ in found] == [
        "clutch2 close", "clutch2 lock", "clutch3 close", "clutch3 lock",
    ]  # fmt: skip
    assert found[1][1] == pytest.approx(T2 + 0.15, abs=EXACT)
    assert found[3][1] == pytest.approx(T3 + 0.1, abs=EXACT)


def test_open_couplings_are_distinguished_by_their_names() -> None:
    trace = run(CLUTCHES).trace
    assert trace.arcs[0].mode == ("slip+", "open", "open")


def test_limit_that_falls_below_zero_ends_the_run_with_its_name() -> None:
    text = RAMP.replace("{static: s, kinetic: k}", "1 - time").replace("rate: 1.5", "rate: 1")
    with pytest.raises(
        statechart.NoConsistentMode, match=r"brake:slip\+ fails, its limit is -2.*e-12 < 0"
    ):
        run(text)


# A controller that opens a brake on a wheel without a drive, and hears it open.
OPENED = (
    (
        RAMP.replace("rate*time", "0")
        .replace("phi: {}", "phi: {rate: 3}")
        .replace("kinetic: k}}", "kinetic: k}, enabled: in(hand.holds)}")
    )
    + """
regions:
  hand:
    initial: holds
    states: {holds: {}, rests: {}, away: {}}
    transitions:
      - {name: let_go, from: holds, to: rests, guard: brake.M <= -1.5 and dphi <= 2}
      - {name: see, from: rests, to: away, on: brake.open}
"""
)


def test_controller_listens_to_a_coupling_and_opens_it() -> None:
    # J w' = -k down to a speed of 2, then no couple.
    result = run(OPENED)
    assert [name for name, _ in events(result.trace)] == ["hand let_go", "brake open", "hand see"]
    assert result.trace.jumps[0].t == pytest.approx(1.0, abs=EXACT)
    assert result.outputs["speed"] == pytest.approx(2.0, abs=EXACT)


@ENGINES
@pytest.mark.parametrize("sign", [">=", ">"])
def test_brake_that_lets_go_at_a_speed_leaves_the_wheel_at_it(engine: str, sign: str) -> None:
    text = RAMP.replace("kinetic: k}", f"kinetic: k}}, enabled: dphi {sign} 2")
    text = text.replace("rate*time", "0").replace("phi: {}", "phi: {rate: 3}")
    result = run(text, engine)
    ((name, t),) = events(result.trace)
    assert (name, t) == ("brake open", pytest.approx(1.0, abs=EXACT))
    assert result.outputs["speed"] == pytest.approx(2.0, abs=EXACT)


def test_advice_on_two_bounds_for_a_brake_whose_condition_turns_over() -> None:
    text = RAMP.replace("kinetic: k}", "kinetic: k}, enabled: dphi >= 2").replace("rate*time", "1")
    with pytest.raises(statechart.EventLoop, match=r"dphi >= 2 falls.*two bounds: guards"):
        run(text.replace("phi: {}", "phi: {rate: 3}"))


def test_coupling_is_open_while_its_joint_is_off() -> None:
    text = ROTOR.replace("to: [0, 0]}", "to: [0, 0], enabled: time <= 1}")
    result = run(text, start=0.05)
    assert [name for name, _ in events(result.trace)] == ["pivot disable", "bearing open"]
    assert result.outputs["couple"] == 0.0


ROLLING = """
kind: scene
name: rolling
parameters: {m: 1, r: 0.1, L: 0.002, v0: 2, g: 9.81, slope: 0}
gravity: [g*sin(slope), -g*cos(slope)]
bodies:
  ball: {mass: m, inertia: 2*m*r**2/5, start: {y: r, dx: v0, dangle: -v0/r}}
surfaces: {floor: {height: 0}}
contacts:
  rim:
    point: {body: ball}
    radius: r
    surface: floor
    friction: 0.5
    restitution: 0
    rolling_resistance: L
stop: {time: 20}
outputs: {way: {value: ball.x}}
"""


@ENGINES
@pytest.mark.parametrize("slope", [0.0, 0.005, -0.015])
def test_rolling_resistance_stops_a_ball_and_holds_it(engine: str, slope: float) -> None:
    # r F = I a/r, and the moment about the point of contact: (1 + 2/5) a = g sin - (L/r) g cos.
    result = run(ROLLING, engine, slope=slope)
    a = 9.81 * (math.sin(slope) - 0.02 * math.cos(slope)) / 1.4
    ((name, t),) = events(result.trace)
    assert name == "rim_rolling lock"
    assert t == pytest.approx(-2.0 / a, abs=EXACT * 10)
    assert result.outputs["way"] == pytest.approx(-2.0 / a, abs=EXACT * 10)
    assert result.trace.arcs[-1].mode == ("pin", "locked")


@pytest.mark.parametrize(("part", "holds"), [(0.999, True), (1.001, False)])
def test_rolling_resistance_holds_a_disc_below_the_angle_of_its_length(
    part: float, holds: bool
) -> None:
    slope = part * math.atan(0.02)
    result = run(ROLLING, v0=0, slope=slope)
    assert result.trace.arcs[0].mode == ("pin", "locked" if holds else "slip-")
    a = 0.0 if holds else 9.81 * (math.sin(slope) - 0.02 * math.cos(slope)) / 1.4
    assert result.outputs["way"] == pytest.approx(a * 200, abs=EXACT)


@ENGINES
def test_slipping_ball_rolls_then_stops(engine: str) -> None:
    # Slip is braked by mu g, spin driven by (mu r - L) g m/I; both resist when it rolls.
    text = ROLLING.replace("dangle: -v0/r", "dangle: 0").replace("friction: 0.5", "friction: 0.1")
    found = events(run(text, engine).trace)
    assert [name for name, _ in found] == ["rim stick", "rim_rolling lock"]
    g, r = 9.81, 0.1
    brake, spin = 0.1 * g, (0.1 * r - 0.002) * g / (0.4 * r**2)
    rolls = 2.0 / (brake + spin * r)
    speed = 2.0 - brake * rolls
    assert found[0][1] == pytest.approx(rolls, abs=EXACT)
    assert found[1][1] == pytest.approx(rolls + speed / (0.02 * g / 1.4), abs=EXACT * 10)


@ENGINES
@pytest.mark.parametrize("e", [0.0, 0.3, 0.6])
def test_rolling_resistance_is_free_in_flight_and_acts_in_impacts(engine: str, e: float) -> None:
    text = ROLLING.replace("y: r, dx: v0, dangle: -v0/r", "y: 0.3, dx: 1, dangle: -5")
    trace = run(text.replace("restitution: 0\n", f"restitution: {e}\n"), engine).trace
    assert trace.arcs[0].mode == ("free", "free")
    assert trace.jumps[-1].cause == "lock"
    assert trace.arcs[-1].mode == ("pin", "locked")
    # About the ground, m r v - I w is used up by L times the normal impulse, m g T in all.
    spin = 1 * 0.1 * 1 + 0.4 * 0.1**2 * 5
    assert trace.jumps[-1].t == pytest.approx(spin / (0.002 * 9.81), rel=1e-7)


@ENGINES
@pytest.mark.parametrize("friction", ["0.35", "{static: 0.6, kinetic: 0.35}"])
def test_slip_sustained_by_rolling_resistance_survives_an_impact(
    engine: str, friction: str
) -> None:
    text = ROLLING.replace("y: r, dx: v0, dangle: -v0/r", "y: 0.3, dx: 2")
    text = text.replace("rolling_resistance: L", "rolling_resistance: 0.02")
    text = text.replace("friction: 0.5", f"friction: {friction}")
    landing = run(text, engine).trace.jumps[0]
    # Without the couple an impulse of 2/3.5 would end the slip; with it friction is on its edge.
    normal = math.sqrt(2 * 9.81 * 0.2)
    assert landing.after[3] == pytest.approx(2 - 0.35 * normal, abs=EXACT)
    couple = 0.4 * 0.1**2 * landing.after[5] - 0.1 * landing.impulse["rim"][1]
    assert abs(couple) <= 0.02 * normal + EXACT
    assert landing.joint_impulse["rim_rolling.M"] == pytest.approx(couple, abs=EXACT)
    assert "rim_rolling" not in landing.impulse


@pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])
def test_rolling_resistance_stops_a_slip_that_friction_alone_leaves(engine: str) -> None:
    text = ROLLING.replace("y: r, dx: v0, dangle: -v0/r", "y: 0.3, dangle: 8")
    text = text.replace("rolling_resistance: L", "rolling_resistance: 0.005")
    text = text.replace("friction: 0.5", "friction: 0.1")
    setting = {"step": 1e-4} if engine == "impulse" else {}
    trace = statechart.run(interpret(read_text(text)), engine=engine, **setting).trace
    # With both at their bounds the slip would end at 0.8 - 3.5*0.1*V - 25*0.005*V < 0.
    normal = math.sqrt(2 * 9.81 * 0.2)
    tangential = (0.1 * 8 - 0.1 * 0.005 * normal / 0.004) / 3.5
    near = 1e-3 if engine == "impulse" else EXACT
    expected = -tangential, tangential / 0.1
    assert trace.jumps[0].after[[3, 5]] == pytest.approx(expected, abs=near)
    assert trace.jumps[0].target[0] == "pin"


@ENGINES
@pytest.mark.parametrize("length", [0.012, 0.02])
def test_rolling_resistance_that_turns_a_slip_round_stays_within_its_bound(
    engine: str, length: float
) -> None:
    text = ROLLING.replace("y: r, dx: v0, dangle: -v0/r", "y: 0.3, dx: -0.5, dangle: 8")
    text = text.replace("rolling_resistance: L", f"rolling_resistance: {length}")
    landing = run(text.replace("friction: 0.5", "friction: 0.02"), engine).trace.jumps[0]
    # Friction on its edge drives the rotation; the couple is at its bound, or stops the rotation.
    normal = math.sqrt(2 * 9.81 * 0.2)
    couple = max(-length * normal, -0.004 * 8 - 0.1 * 0.02 * normal)
    assert landing.impulse["rim"] == pytest.approx((normal, 0.02 * normal), abs=EXACT)
    assert landing.joint_impulse["rim_rolling.M"] == pytest.approx(couple, abs=EXACT)
    spin = 8 + (couple + 0.1 * 0.02 * normal) / 0.004
    assert landing.after[[3, 5]] == pytest.approx((-0.5 + 0.02 * normal, spin), abs=EXACT)


def test_an_impact_by_steps_lists_the_impulse_of_rolling_resistance() -> None:
    text = ROLLING.replace("y: r, dx: v0, dangle: -v0/r", "y: 0.3, dx: 2")
    text = text.replace("rolling_resistance: L", "rolling_resistance: 0.02")
    model = interpret(read_text(text.replace("friction: 0.5", "friction: 0.35"), "rolling.yaml"))
    landing = statechart.run(model, engine="impulse", step=1e-4).trace.jumps[0]
    couple = 0.4 * 0.1**2 * landing.after[5] - 0.1 * landing.impulse["rim"][1]
    assert landing.joint_impulse == {"rim_rolling.M": pytest.approx(couple, abs=1e-9)}
    assert couple == pytest.approx(0.02 * math.sqrt(2 * 9.81 * 0.2), rel=1e-3)


@ENGINES
def test_outputs_guards_and_units_know_the_couple_of_rolling_resistance(engine: str) -> None:
    text = ROLLING.replace(
        "outputs: {way: {value: ball.x}}",
        """units: SI
regions:
  watch:
    initial: rolls
    states: {rolls: {}, rests: {}}
    transitions: [{name: rest, from: rolls, to: rests, guard: rim_rolling.M < 1e-3}]
outputs:
  couple: {maximum: rim_rolling.M}
  slip: {value: rim_rolling.slip, at: start}
  rests: {value: time, at: first watch.rest}
""",
    )
    result = run(text, engine)
    assert result.outputs["couple"] == pytest.approx(0.002 * 9.81, abs=EXACT)
    assert result.outputs["slip"] == pytest.approx(-20.0, abs=EXACT)
    assert result.outputs["rests"] == pytest.approx(result.trace.jumps[0].t, abs=1e-9)
    assert result.observer.automaton.declaration.unit("couple") == "N m"


def test_rolling_resistance_requires_a_disc() -> None:
    with pytest.raises(statechart.DeclarationError, match="rolling resistance is of a disc"):
        run(ROLLING.replace("    radius: r\n", "").replace("y: r", "y: 0"))


def steps(text: str, h: float):
    return statechart.run(interpret(read_text(text)), engine="impulse", step=h)


@pytest.mark.parametrize("slope", [0.0, 0.005, -0.015])
@pytest.mark.parametrize("contact", ["friction: 0.5\n    restitution: 0", "modes: [pin]"])
def test_steps_roll_a_ball_to_rest_where_the_closed_form_does(slope: float, contact: str) -> None:
    a = 9.81 * (math.sin(slope) - 0.02 * math.cos(slope)) / 1.4
    text, h = ROLLING.replace("friction: 0.5\n    restitution: 0", contact), 4e-3
    result = steps(text.replace("slope: 0", f"slope: {slope}"), h)
    ((name, t),) = events(result.trace)
    assert name == "rim_rolling lock"
    assert t == pytest.approx(-2.0 / a, abs=h)
    assert result.outputs["way"] == pytest.approx(-2.0 / a, abs=1e-2 * h)
    assert result.trace.arcs[-1].mode == ("pin", "locked")


@pytest.mark.parametrize(("part", "holds"), [(0.999, True), (1.001, False)])
def test_steps_hold_a_disc_below_the_angle_of_its_length(part: float, holds: bool) -> None:
    slope = part * math.atan(0.02)
    text = ROLLING.replace("v0: 2", "v0: 0").replace("slope: 0", f"slope: {slope}")
    result = steps(text, 4e-3)
    assert result.trace.arcs[0].mode == ("pin", "locked" if holds else "slip-")
    a = 0.0 if holds else 9.81 * (math.sin(slope) - 0.02 * math.cos(slope)) / 1.4
    assert result.outputs["way"] == pytest.approx(a * 200, abs=EXACT)


@pytest.mark.parametrize("e", [0.0, 0.3, 0.6])
def test_steps_resist_rolling_in_impacts(e: float) -> None:
    text = ROLLING.replace("y: r, dx: v0, dangle: -v0/r", "y: 0.3, dx: 1, dangle: -5")
    trace = steps(text.replace("restitution: 0\n", f"restitution: {e}\n"), 4e-3).trace
    assert trace.arcs[0].mode == ("free", "free")
    assert trace.arcs[-1].mode == ("pin", "locked")
    spin = 1 * 0.1 * 1 + 0.4 * 0.1**2 * 5
    assert trace.jumps[-1].t == pytest.approx(spin / (0.002 * 9.81), abs=8e-3)


TRAILER = """
kind: scene
name: trailer
gravity: 9.81
parameters: {m: 1, r: 0.1, L: 0.03, v: 3}
bodies:
  cart: {mass: 2, inertia: 0.1, start: {y: 0.6, x: -0.5, dx: v}}
  ball: {mass: m, inertia: 2*m*r**2/5, start: {y: r, dx: v, dangle: -v/r}}
surfaces: {floor: {height: 0}}
joints:
  rail: {point: {body: cart}, to: {y: 0.6}}
  hinge: {point: {body: ball}, to: {body: cart, at: [0.5, -0.5]}}
contacts:
  rim:
    point: {body: ball}
    radius: r
    surface: floor
    friction: 0.5
    restitution: 0
    rolling_resistance: L
forces: {hold: {body: cart, moment: -20*cart.angle - 2*cart.dangle}}
stop: {time: 6}
outputs: {way: {value: ball.x}, load: {value: rim.V, at: first rim_rolling.lock}}
"""


def test_steps_find_the_normal_force_that_rolling_resistance_changes() -> None:
    # The couple turns the cart through its wheel, which loads the wheel otherwise.
    exact = run(TRAILER)
    wrong = []
    for h in (4e-3, 1e-3):
        found = steps(TRAILER, h)
        assert found.trace.arcs[-1].mode == ("pin", "locked")
        wrong.append(abs(found.outputs["way"] - exact.outputs["way"]))
        assert found.trace.jumps[-1].t == pytest.approx(exact.trace.jumps[-1].t, abs=h)
    assert wrong[1] < 0.5 * wrong[0] < 4e-3


@ENGINES
def test_rolling_resistance_of_a_compliant_tyre_stops_it(engine: str) -> None:
    # It sinks by m g/k at once, the normal force stays m g.
    text = ROLLING.replace("restitution: 0\n", "stiffness: 2000\n")
    result = run(text.replace("start: {y: r,", "start: {y: r - m*g/2000,"), engine)
    ((name, t),) = events(result.trace)
    assert (name, t) == ("rim_rolling lock", pytest.approx(2 * 1.4 / (0.02 * 9.81), abs=1e-8))
    assert result.trace.arcs[-1].mode == ("pin", "locked")


@pytest.mark.parametrize(("text", "h", "count"), [(ROTOR, 4e-3, 4), (RAMP, 4e-3, 1)])
def test_steps_meet_the_events_within_a_step(text: str, h: float, count: int) -> None:
    exact, found = run(text), steps(text, h)
    assert len(found.trace.jumps) == count
    for one, other in zip(events(exact.trace), events(found.trace), strict=True):
        assert one[0] == other[0]
        assert one[1] == pytest.approx(other[1], abs=2 * h)
    for name, value in exact.outputs.items():
        assert found.outputs[name] == pytest.approx(value, abs=h)


def test_steps_of_coupled_clutches_are_of_first_order() -> None:
    exact = run(CLUTCHES)
    wrong = []
    for h in (4e-3, 1e-3):
        found = steps(CLUTCHES, h)
        assert [name for name, _ in events(found.trace)] == [n for n, _ in events(exact.trace)]
        wrong.append(max(abs(found.outputs[n] - v) for n, v in exact.outputs.items()))
    assert wrong[1] < 0.5 * wrong[0] < 10 * 4e-3


def test_steps_brake_a_car_as_events_do() -> None:
    exact, found = run(CAR), steps(CAR, 2e-3)
    for one, other in zip(events(exact.trace)[:2], events(found.trace)[:2], strict=True):
        assert one[0] == other[0]
        assert one[1] == pytest.approx(other[1], abs=4e-3)
    assert found.trace.arcs[-1].mode == ("pin", "pin", "locked", "locked")


def test_steps_end_where_a_limit_falls_below_zero() -> None:
    text = RAMP.replace("{static: s, kinetic: k}", "1 - time").replace("rate: 1.5", "rate: 1")
    with pytest.raises(statechart.NoConsistentMode, match="'brake': its limit is below zero"):
        steps(text, 1e-2)


@pytest.mark.parametrize("part", ["max(0, time - 0.1)", "time*0"])
def test_steps_slip_while_both_limits_are_zero(part: str) -> None:
    text = RAMP.replace("{static: s, kinetic: k}", f"{{static: 's*{part}', kinetic: 'k*{part}'}}")
    assert steps(text, 1e-3).outputs == pytest.approx(run(text).outputs, abs=1e-6)


@ENGINES
def test_static_friction_holds_an_arm_that_lands_on_its_stop(engine: str) -> None:
    text = """
kind: scene
name: stopped
parameters: {s: 2, k: 1, M: 1.5}
bodies: {a: {mass: 1, inertia: 0.5, start: {angle: 0.1, dangle: -2}}}
joints: {p: {point: {body: a}, to: [0, 0], limits: [0, 1]}}
couplings: {rub: {joint: p, limit: {static: s, kinetic: k}}}
forces: {f: {body: a, moment: M}}
stop: {time: 1}
outputs: {angle: {value: a.angle}}
"""
    result = run(text, engine)
    # 0.1 - 2 t + 2.5 t**2 = 0: friction and moment brake it; the moment is below static friction.
    lands = (2 - (4 - 1) ** 0.5) / 5
    ((name, t),) = events(result.trace)
    assert (name, t) == ("p_min touchdown", pytest.approx(lands, abs=EXACT))
    assert result.trace.final_mode == ("slide", "free", "locked")
    assert result.outputs["angle"] == pytest.approx(0.0, abs=EXACT)
    # Weaker static friction lets it go against kinetic friction.
    free = run(text, engine, s=1.2)
    assert free.outputs["angle"] == pytest.approx(0.5 * (1 - lands) ** 2, abs=EXACT)


def test_bounces_of_a_rope_beside_a_slipping_brake_are_summed_with_all_engines() -> None:
    text = """
kind: scene
name: bob
gravity: 9.81
bodies: {a: {mass: 1, inertia: 0.05, start: {x: 0.4, y: 0.2}}}
joints: {cord: {point: {body: a, at: [0, 0.1]}, to: [0, 0], rope: L - 0.1*time, restitution: 0.3}}
couplings: {rub: {bodies: [a], limit: 0.05}}
parameters: {L: 0.9}
stop: {time: 1}
"""
    ends = []
    for engine in ("taylor", "scipy"):
        jumps = run(text, engine).trace.jumps
        assert [jump.cause for jump in jumps if jump.skipped > 0.0] == ["touchdown"]
        ends += [jump.t for jump in jumps if jump.cause == "zeno"]
    assert ends[0] == pytest.approx(ends[1], abs=1e-11)


def test_only_the_wrong_part_of_a_limit_is_reported() -> None:
    text = RAMP.replace("{static: s, kinetic: k}", "{static: s}")
    with pytest.raises(statechart.DeclarationError, match="'kinetic' is missing") as found:
        run(text)
    assert found.value.others == ()


def test_stepped_controllers_receive_coupling_events() -> None:
    found = steps(OPENED, 1e-3)
    names = [name for name, _ in events(found.trace)]
    assert names == ["hand let_go", "brake open", "hand see"]
    assert found.trace.jumps[0].t == pytest.approx(1.0, abs=2e-3)
    assert found.outputs["speed"] == pytest.approx(2.0, abs=2e-3)


BRAKES = """
kind: scene
name: brakes
parameters: {J: 2, a: 1, b: 2.5, rate: 1}
coordinates: {phi: {}}
bodies: {wheel: {mass: 1, inertia: J, position: [0, 0], angle: phi}}
couplings:
  one: {bodies: [wheel], limit: a}
  other: {bodies: [wheel], limit: b}
forces: {drive: {body: wheel, moment: rate*time}}
stop: {time: 5}
outputs: {speed: {value: dphi}, of_one: {value: one.M}, of_other: {value: other.M}}
"""
ALL_ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])


@ALL_ENGINES
@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_parallel_brakes_slip_where_their_limits_together_are_reached(
    engine: str, rate: float
) -> None:
    model = interpret(read_text(BRAKES))
    options = {"engine": engine, "step": 1e-3} if engine == "impulse" else {"engine": engine}

    def until(end: float):
        return statechart.run(model, parameters={"rate": rate}, until=end, **options)

    # Equal shares up to the limit of the weaker brake; then the stronger bears the rest.
    for end, shares in ((1.5, (0.75, 0.75)), (3.0, (1.0, 2.0)), (3.4, (1.0, 2.4))):
        result = until(end)
        assert not result.trace.jumps
        found = result.outputs["of_one"], result.outputs["of_other"]
        within = 1e-3 if engine == "impulse" else 1e-12
        assert found == pytest.approx([-rate * share for share in shares], abs=within)
    result = until(5.0)
    assert result.trace.jumps[0].cause == "slip"
    within = 1e-3 if engine == "impulse" else EXACT
    assert result.trace.jumps[-1].t == pytest.approx(3.5, abs=within)
    assert result.outputs["speed"] == pytest.approx(rate * 1.5**2 / 2 / 2, abs=within)


@ALL_ENGINES
def test_brake_shares_a_couple_with_rolling_resistance_up_to_both_limits(engine: str) -> None:
    text = (
        ROLLING.replace("v0: 2", "v0: 0, b: 0.005").replace("time: 20", "time: 0.5")
        + """
couplings: {brake: {bodies: [ball], limit: b}}
forces: {drive: {body: ball, moment: -0.1*time}}
"""
    )
    found = steps(text, 1e-3) if engine == "impulse" else run(text, engine)
    slips = (0.002 * 9.81 + 0.005) / 0.1
    within = 2e-3 if engine == "impulse" else EXACT
    assert found.trace.jumps[0].cause == "slip"
    assert found.trace.jumps[0].t == pytest.approx(slips, abs=within)
    assert found.trace.arcs[-1].mode == ("pin", "slip-", "slip-")
    # 7/5 m r^2 w' = 0.1 (t - slips), and the ball goes r times its angle.
    way = 0.1 * (0.5 - slips) ** 3 / 6 / (1.4 * 0.1)
    assert found.outputs["way"] == pytest.approx(way, abs=within)


@ALL_ENGINES
@pytest.mark.parametrize("static", ["{static: 2, kinetic: 0.5}", "3"])
def test_static_friction_holds_on_while_a_clutch_begins_to_slip(engine: str, static: str) -> None:
    # The brake bears the clutch's limit, 1: more than in motion, less than at rest.
    text = BRAKES.replace("limit: a}", f"limit: {static}}}").replace("phi: {}", "phi: {}, psi: {}")
    text = text.replace(
        "bodies: {wheel", "bodies: {top: {mass: 1, inertia: 1, position: [0, 0], angle: psi}, wheel"
    )
    text = text.replace("{bodies: [wheel], limit: b}", "{bodies: [top, wheel], limit: 1}")
    text = text.replace("body: wheel, moment", "body: top, moment").replace("dphi", "dpsi")
    text = text.replace("time: 5", "time: 3")
    found = steps(text, 1e-3) if engine == "impulse" else run(text, engine)
    within = 2e-3 if engine == "impulse" else EXACT
    ((name, t),) = events(found.trace)
    assert (name, t) == ("other slip", pytest.approx(1.0, abs=within))
    assert found.trace.arcs[-1].mode == ("locked", "slip+")
    assert found.outputs["speed"] == pytest.approx(2.0, abs=within)


HUB = """
kind: scene
name: hub
coordinates: {phi: {start: 1}, psi: {}}
bodies:
  wheel: {mass: 1, inertia: 1, position: [0, 0], angle: phi}
  hub: {mass: 1, inertia: 1, position: [0, 0], angle: psi}
couplings:
  clutch: {bodies: [wheel, hub], limit: {static: 1, kinetic: 0.5}}
  brake: {bodies: [hub], limit: {static: 1.8, kinetic: 1.2}}
forces:
  spring: {body: wheel, moment: -10*phi}
  load: {body: hub, moment: 1}
stop: {time: 2.5}
outputs: {wheel: {value: phi}, hub: {value: psi}}
"""


@ALL_ENGINES
def test_brake_holds_where_static_friction_of_a_clutch_would_move_it_at_a_reversal(
    engine: str,
) -> None:
    # The wheel loses 2*0.5/10 of its amplitude in every half swing, and the hub is at rest.
    found = steps(HUB, 1e-3) if engine == "impulse" else run(HUB, engine)
    within = 1e-3 if engine == "impulse" else EXACT
    half = math.pi / math.sqrt(10)
    expected = [("clutch reverse", half), ("clutch reverse", 2 * half)]
    assert [name for name, _ in events(found.trace)] == [name for name, _ in expected]
    times = [t for _, t in events(found.trace)]
    assert times == pytest.approx([t for _, t in expected], abs=within)
    last = 0.05 + (0.8 - 0.05) * math.cos(math.sqrt(10) * (2.5 - 2 * half))
    assert found.outputs["wheel"] == pytest.approx(last, abs=2 * within)
    assert found.outputs["hub"] == pytest.approx(0, abs=1e-12)


def test_limit_knows_the_angle_of_a_body_that_a_formula_places() -> None:
    # The limit grows as the couple of a spring, which stops the wheel in a quarter of its period.
    text = """
kind: scene
name: spool
coordinates: {phi: {rate: 2}}
bodies: {wheel: {mass: 1, inertia: 1, position: [0, 0], angle: phi}}
couplings: {brake: {bodies: [wheel], limit: 3*wheel.angle}}
stop: {time: 2}
outputs: {locks: {value: time, at: first brake.lock}, angle: {value: phi}}
"""
    outputs = run(text).outputs
    assert outputs["locks"] == pytest.approx(math.pi / 2 / math.sqrt(3), abs=EXACT)
    assert outputs["angle"] == pytest.approx(2 / math.sqrt(3), abs=EXACT)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("force", ["-sat(dp1, -0.2, 0.2)", "-0.2*sign(dp1)", "-max(dp1/9, 0.2)"])
def test_a_second_brake_closes_beside_a_force_that_switches(engine: str, force: str) -> None:
    """Both wheels turn as one of inertia 2: the rate falls by 0.1 a second."""
    text = f"""
kind: scene
name: second
coordinates: {{p0: {{rate: 1}}, p1: {{rate: 1}}}}
bodies:
  w0: {{mass: 1, inertia: 1, position: [0, 0], angle: p0}}
  w1: {{mass: 1, inertia: 1, position: [1, 0], angle: p1}}
couplings:
  c0: {{bodies: [w0, w1], limit: 3}}
  c1: {{bodies: [w1, w0], limit: 3, enabled: time >= 0.5}}
forces: {{f1: {{body: w1, moment: "{force}"}}}}
stop: {{time: 1}}
outputs: {{w: {{value: dp0}}, closes: {{value: time, at: first c1.close}}}}
"""
    result = statechart.run(interpret(read_text(text)), engine=engine)
    assert result.outputs == pytest.approx({"w": 0.9, "closes": 0.5}, abs=1e-12)
    assert [jump.cause for jump in result.trace.jumps] == ["close"]


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("other", ["", " + sign(q - 9)", " + sign(sin(time + 1) - 9)"])
def test_brakes_share_beside_a_wheel_that_is_held_by_a_sign(engine: str, other: str) -> None:
    """The wheel w stands under 1.2, of which each brake bears half; u keeps the rate of a belt.

    Signs of places and of time are no friction, and change nothing of that.
    """
    text = f"""
kind: scene
name: belt
coordinates: {{p: {{}}, q: {{rate: 1}}}}
bodies:
  w: {{mass: 1, inertia: 1, position: [0, 0], angle: p}}
  u: {{mass: 1, inertia: 1, position: [1, 0], angle: q}}
couplings:
  a: {{bodies: [w], limit: 2}}
  b: {{bodies: [w], limit: 3, enabled: time >= 1}}
forces:
  f: {{body: w, moment: 1.2}}
  g: {{body: u, moment: "-2*sign(dq - 0.3){other}"}}
stop: {{time: 2}}
outputs: {{a: {{value: a.M}}, b: {{value: b.M}}, q: {{value: q}}}}
"""
    result = statechart.run(interpret(read_text(text)), engine=engine)
    # u loses its 0.7 at the rate 2, or 3 where the other sign, -1, adds to it.
    slows = 2.0 if not other else 3.0
    way = 0.3 * 2 + 0.7**2 / (2 * slows)
    assert result.outputs == pytest.approx({"a": -0.6, "b": -0.6, "q": way}, abs=1e-12)
    assert "the forces of a, b are indeterminate: the smallest are shown" in result.warnings


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_brake_and_sign_share_a_load_with_a_position_sign(engine: str) -> None:
    """At rest each bears a third of 0.9, up to 0.2 for the sign; u swings past its place."""
    text = """
kind: scene
name: place
coordinates: {p: {}, q: {rate: 1}}
bodies:
  w: {mass: 1, inertia: 1, position: [0, 0], angle: p}
  u: {mass: 1, inertia: 1, position: [1, 0], angle: q}
couplings:
  a: {bodies: [w], limit: 2}
  b: {bodies: [w], limit: 3, enabled: time >= 0.5}
forces:
  f: {body: w, moment: "0.9 - 0.2*sign(dp)"}
  g: {body: u, moment: "-2*sign(q - 0.1)"}
stop: {time: 1}
outputs: {a: {value: a.M}, b: {value: b.M}, p: {value: p}, q: {value: q}}
"""
    result = statechart.run(interpret(read_text(text)), engine=engine)
    # u passes 0.1 at rate v after t1, is back there after v, and passes it again.
    v = math.sqrt(1 + 4 * 0.1)
    t1 = (v - 1) / 2
    late = 1 - t1
    assert late < v
    q = 0.1 + v * late - late**2
    expected = {"a": -0.35, "b": -0.35, "p": 0.0, "q": q}
    assert result.outputs == pytest.approx(expected, abs=1e-12)


def test_an_infinite_limit_is_refused_with_advice() -> None:
    text = ROTOR.replace("limit: T", "limit: inf")
    assert text != ROTOR
    with pytest.raises(statechart.DeclarationError, match="a joint with angle: held"):
        run(text)


_WHEELS = """
kind: scene
name: wheels
coordinates:
  p0: {rate: 1.463}
  p1: {rate: -1.257}
bodies:
  w0: {mass: 1, inertia: 1.241, position: [0, 0], angle: p0}
  w1: {mass: 1, inertia: 1.245, position: [1, 0], angle: p1}
couplings:
  c0: {bodies: [w1, w0], limit: 0.956}
  c1: {bodies: [w1, w0], limit: 2.399, enabled: 'mod(time, 0.686) <= 0.297'}
  BRAKES
forces:
  f0: {body: w0, moment: 1.296*sin(3.469*time) SIGN0}
  f1: {body: w1, moment: 1.765*sin(5.426*time) SIGN1}
stop: {time: 2}
"""


def test_signs_for_brakes_near_a_locked_clutch_suggest_couplings() -> None:
    signs = _WHEELS.replace("BRAKES", "").replace("SIGN0", "- 0.591*sign(dp0)")
    with pytest.raises(EventLoop, match="instead of sign write couplings"):
        statechart.run(read_text(signs.replace("SIGN1", "- 0.531*sign(dp1)")))
    brakes = (
        _WHEELS.replace("SIGN0", "")
        .replace("SIGN1", "")
        .replace("BRAKES", "d0: {bodies: [w0], limit: 0.591}\n  d1: {bodies: [w1], limit: 0.531}")
    )
    assert statechart.run(read_text(brakes)).trace.outcome is Outcome.HORIZON


@pytest.mark.parametrize(("limit", "late"), [(1e-3, 2e-8), (1e-8, 2e-3)])
def test_a_coupling_far_below_the_forces_of_the_scene_warns(limit: float, late: float) -> None:
    text = """
kind: scene
name: needle
parameters: {T: 1}
coordinates: {q: {}, x: {}}
bodies:
  needle: {mass: 1e-3, inertia: T, position: [0, 0], angle: q}
  cart: {mass: 1, position: [x, 0]}
couplings: {pivot: {bodies: [needle], limit: T}}
forces:
  turn: {body: needle, moment: T*time}
  push: {body: cart, force: [10, 0]}
stop: {time: 2}
"""
    trace = run(text, T=limit).trace
    ((_, t),) = events(trace)
    assert t == pytest.approx(1.0, abs=1.1 * late)
    assert any("'pivot' slips up to" in warning for warning in trace.warnings) == (late > 1e-6)


UNITS = """
kind: scene
name: roller_and_arm
parameters: {l: 1, F: 0.02}
gravity: 9.81*l
bodies:
  b: {mass: 1, inertia: 0.005*l**2, start: {y: 0.1*l, dx: l, dangle: -10}}
  arm: {mass: 2, inertia: 0.1*l**2, start: {x: 9*l, dangle: 3}}
surfaces: {s: {height: 0}}
joints: {pivot: {point: {body: arm}, to: [9*l, 0], limits: [-0.5, 0.5], restitution: 0.6}}
contacts:
  f:
    point: {body: b}
    radius: 0.1*l
    surface: s
    friction: 0.5
    restitution: 0
    rolling_resistance: 0.01*l
couplings: {brake: {joint: pivot, limit: {static: 0.25*l**2, kinetic: 0.2*l**2}}}
forces: {drive: {body: arm, moment: F*l**2*(time - 5)**2*sin(2*time)}}
stop: {time: 10.35}
outputs:
  way: {value: b.x/l}
  couple: {value: brake.M/l**2}
  rolls: {value: f_rolling.M/l**2, at: first brake.reverse}
  spin: {value: f_rolling.slip, at: start}
"""


@pytest.mark.parametrize("length", [1e-9, 1e9])
@pytest.mark.parametrize("engine", ["auto", "impulse"])
def test_units_of_length_do_not_change_events_of_couplings(engine: str, length: float) -> None:
    step = 1e-2 if engine == "impulse" else None
    runner = Runner(read_text(UNITS), engine=engine, step=step)
    one, other = (runner.run({"l": size}) for size in (1.0, length))
    kinds, times = zip(*events(one.trace), strict=True)
    scaled, at = zip(*events(other.trace), strict=True)
    assert {"brake lock", "brake slip", "f_rolling lock"} <= {*kinds}
    assert scaled == kinds
    assert at == pytest.approx(times, abs=1e-12)
    assert other.outputs["spin"] == -10.0
    for name in ("way", "couple", "rolls"):
        assert other.outputs[name] == pytest.approx(one.outputs[name], abs=1e-12)


STOPPING = """
kind: scene
name: stopping
parameters: {start: 1}
bodies:
  one: {mass: 1, inertia: 1, position: [0, 0], angle: a}
  two: {mass: 1, inertia: 1, position: [1, 0], angle: c}
coordinates: {a: {}, c: {rate: start}}
couplings:
  brake: {bodies: [one], limit: {static: 5.5, kinetic: 2}}
  clutch: {bodies: [one, two], limit: {static: 3, kinetic: 1}}
forces: {turn: {body: one, moment: -6}}
stop: {time: 1.5}
"""


@pytest.mark.parametrize("start", [1.0, 1.0021, 1.0037, 1.005, 1.0063, 1.0079])
def test_a_clutch_that_stops_is_held_while_the_brake_lets_go(start: float) -> None:
    # The clutch stops at t = start and then bears 0 instead of -1: the brake would bear 6. Locked,
    # it needs 2 of 3 at the common acceleration (-6 + 2)/2.
    document = interpret(read_text(STOPPING))
    for step in (1e-2, 1e-3):
        result = statechart.run(document, engine="impulse", step=step, parameters={"start": start})
        rates = result.trace.final[2:4]
        np.testing.assert_allclose(rates, -2.0 * (1.5 - start), atol=2.0 * step)
        assert result.trace.arcs[-1].mode == ("slip-", "locked")


def test_a_stopped_wheel_stays_locked_by_steps_whatever_its_round_off() -> None:
    text = TRAILER.replace("v: 3", "v: 2.9")
    trace = statechart.run(read_text(text), engine="impulse", step=1e-3).trace
    ((name, t),) = events(trace)
    assert name == "rim_rolling lock"
    assert t == pytest.approx(run(text).trace.jumps[-1].t, abs=1e-3)
