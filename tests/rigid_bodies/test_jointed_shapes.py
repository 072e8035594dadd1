"""Joints between bodies with shapes, and to the world, beside closed forms and points."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from contacts.testing.symmetry import mirrored, rescaled
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G = 9.81

CHAIN = """
kind: scene
name: chain
parameters: {{l: 0.5, a: 1.2, w: 0, g: {gravity}}}
gravity: g
bodies:
{bodies}
surfaces: {{ground: {{height: {ground}}}}}
joints:
{joints}
collisions: {{all: {{bodies: [{names}], surfaces: [ground], friction: 0.5, restitution: 0}}}}
stop: {{time: {time}}}
settings: {{engine: impulse, step: {step}}}
"""


BAR = "[[-0.02, -l/2], [0.02, -l/2], [0.02, l/2], [-0.02, l/2]]"


def chain(count, *, step=1e-3, time=1.0, ground=-10, gravity=9.81):
    """Return a chain of bars that hangs from the origin, all turned by the angle a, as text."""
    bodies, joints = [], []
    for k in range(count):
        bodies.append(
            f"  bar{k}: {{mass: 1, inertia: l**2/12, shape: {{polygon: {BAR}}}, "
            f"start: {{x: {k + 0.5}*l*sin(a), y: -{k + 0.5}*l*cos(a), angle: a, "
            f"dx: {k + 0.5}*l*w*cos(a), dy: {k + 0.5}*l*w*sin(a), dangle: w}}}}"
        )
        to = "[0, 0]" if k == 0 else f"{{body: bar{k - 1}, at: [0, -l/2]}}"
        joints.append(f"  j{k}: {{point: {{body: bar{k}, at: [0, l/2]}}, to: {to}}}")
    return CHAIN.format(
        bodies="\n".join(bodies),
        joints="\n".join(joints),
        names=", ".join(f"bar{k}" for k in range(count)),
        time=time,
        step=step,
        ground=ground,
        gravity=gravity,
    )


def run(text, **values):
    result = Runner(interpret(read_text(text))).run(values)
    assert result.trace.outcome is Outcome.HORIZON, result.trace.message
    return result


def test_a_jointed_bar_swings_as_a_pendulum():
    found = solve_ivp(
        lambda _, s: (s[1], -1.5 * G / 0.5 * math.sin(s[0])), (0, 1), (1.2, 0), rtol=1e-11,
        atol=1e-12,
    )  # fmt: skip
    angle = found.y[0, -1]
    errors = []
    for step in (2e-3, 1e-3, 5e-4):
        final = run(chain(1, step=step)).trace.final
        errors.append(abs(final[2] - angle))
        # Held at the midpoints, its pivot moves by h^2 w^2 l/8 between them.
        pivot = final[:2] + 0.25 * np.array([-math.sin(final[2]), math.cos(final[2])])
        assert math.hypot(*pivot) < step**2 * found.y[1, -1] ** 2 * 0.25 + 1e-7
    # Second order, without impacts.
    assert errors[0] < 2e-4
    assert errors[2] < 0.3 * errors[1] < 0.09 * errors[0] / 0.25


def test_joints_do_not_drift_and_energy_does_not_grow_in_many_turns():
    result = run(chain(1, step=2e-3, time=40), a=2.5)
    sampled = result.observer.sample(result.trace, ["energy"], times=np.linspace(1, 40, 300))
    energy = sampled.columns["energy"]
    assert np.ptp(energy) < 0.02 * G
    assert abs(energy[-50:].mean() - energy[:50].mean()) < 2e-3 * G
    x, y, angle = result.trace.final[:3]
    assert math.hypot(x - 0.25 * math.sin(angle), y + 0.25 * math.cos(angle)) < 1e-4


@pytest.mark.parametrize(("count", "step"), [(1, 3e-2), (2, 3e-2), (5, 1e-2)])
def test_long_steps_of_joints_add_no_energy(count, step):
    """Two bars swung ever higher, by a sixth in 12 s: arms turned as in the step before."""
    result = run(chain(count, step=step, time=12, ground=-100), a=1.2)
    times = np.linspace(0, 12, 1201)
    energy = result.observer.sample(result.trace, ["energy"], times=times).columns["energy"]
    above = energy - -G * 0.25 * count**2
    quarters = above[1:].reshape(4, -1).mean(axis=1)
    assert quarters == pytest.approx(np.full(4, above[0]), rel=5e-3)
    assert not result.warnings


def test_a_bar_swings_as_high_at_a_third_of_a_radian_a_step():
    result = run(chain(1, step=3e-2, time=40, ground=-100), a=2.5)
    angle = np.abs(result.observer.sample(result.trace, ["bar0.angle"], times=np.arange(4000) / 100)
                   .columns["bar0.angle"])  # fmt: skip
    highest = angle.reshape(8, -1).max(axis=1)
    assert highest == pytest.approx(np.full(8, 2.5), abs=0.02)


def test_a_double_pendulum_moves_as_by_the_equations_of_motion():
    text = chain(2, step=2.5e-4, time=0.8)
    found = run(text).trace.final
    i, j = text.index("collisions:"), text.index("stop:")
    points = text[:i] + text[j:].replace("engine: impulse, step: 0.00025", "engine: scipy")
    expected = run(points).trace.final
    assert found == pytest.approx(expected, abs=2e-3)
    assert abs(expected[5] - 1.2) > 0.5


def test_a_spinning_chain_without_gravity_keeps_its_energy_and_spin():
    text = chain(2, gravity=0, time=4)
    result = run(text.replace("  j0: {point: {body: bar0, at: [0, l/2]}, to: [0, 0]}\n", ""), w=5)
    trace = result.trace
    n = 6
    x, v = trace.final[:n].reshape(2, 3), trace.final[n:].reshape(2, 3)
    begin, first = trace.initial[:n].reshape(2, 3), trace.initial[n:].reshape(2, 3)

    def moment(at, rates):
        across = at[:, 0] * rates[:, 1] - at[:, 1] * rates[:, 0]
        return (across + rates[:, 2] * 0.25 / 12).sum()

    assert v[:, :2].sum(axis=0) == pytest.approx(first[:, :2].sum(axis=0), abs=1e-10)
    assert moment(x, v) == pytest.approx(moment(begin, first), rel=1e-3)
    energy = result.observer.sample(trace, ["energy"], times=np.linspace(0, 4, 100))
    values = energy.columns["energy"]
    # Verlet's scheme with constraints: the error of a chord of (h w), which does not grow.
    assert values.max() <= values[0] * (1 + (1e-3 * 5) ** 2 / 8)
    assert values.min() >= values[0] * 0.995


def test_the_force_of_a_joint_balances_the_load():
    text = chain(1, time=0.2).replace(
        "stop:", "outputs: {X: {value: j0.X}, Y: {value: j0.Y}}\nstop:"
    )
    outputs = run(text, a=0).outputs
    assert outputs["Y"] == pytest.approx(G, rel=1e-9)
    assert outputs["X"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("step", [4e-3, 2e-3, 1e-3])
def test_forces_of_joints_are_of_second_order_in_first_and_last_steps(step):
    """A midpoint offset that was closed in one step took an eighth of the centripetal force."""
    w = 2.0
    pin = chain(1, step=step, gravity=0).replace(
        "stop:", "outputs: {force: {value: 'hypot(j0.X, j0.Y)'}}\nstop:"
    )
    pair = chain(2, step=step, gravity=0).replace(
        "  j0: {point: {body: bar0, at: [0, l/2]}, to: [0, 0]}\n", ""
    )
    pair = pair.replace(
        "{point: {body: bar1, at: [0, l/2]}, to: {body: bar0, at: [0, -l/2]}}",
        "{point: {body: bar1}, to: {body: bar0}, rod: l}",
    )
    pair = pair.replace("stop:", "outputs: {force: {value: j1.T}}\nstop:")
    for text in (pin, pair):
        runner = Runner(interpret(read_text(text)))
        for until in (step, 0.4 * step, 1.4 * step, 250 * step, 250.1 * step, 250.6 * step):
            force = runner.run({"w": w}, until=until).outputs["force"]
            assert force == pytest.approx(w**2 * 0.25, rel=(step * w) ** 2 / 2)


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_an_impact_leaves_no_force_in_a_weld_beside_a_floor(step):
    """Weld and floor share the load: the impulse over the step stayed in both for ever."""
    text = """
kind: scene
name: welded
gravity: 9.81
bodies:
  ball: {mass: 0.5, inertia: 0.001, shape: {disc: 0.05}, start: {x: -0.2, y: 0.06, dx: 1}}
  post: {mass: 0.2, inertia: 0.001, start: {y: 0.1},
    shape: {polygon: [[-0.02, -0.1], [0.02, -0.1], [0.02, 0.1], [-0.02, 0.1]]}}
surfaces: {floor: {height: 0}}
joints: {glue: {point: {body: post, at: [0, -0.1]}, to: [0, 0], angle: held}}
collisions: {all: {bodies: [ball, post], surfaces: [floor], friction: 0.4, restitution: 0.2}}
stop: {time: 0.5}
outputs:
  struck: {value: time, at: first post.impact}
  after: {value: "hypot(glue.X, glue.Y)"}
  most: {maximum: "hypot(glue.X, glue.Y)"}
"""
    outputs = Runner(interpret(read_text(text)), step=step).run().outputs
    assert 0.1 < outputs["struck"] < 0.2
    assert outputs["after"] <= 0.2 * G
    # A ball that falls as slowly as in one step stops within a step.
    assert outputs["most"] <= 2 * 0.5 * G


def test_a_guide_holds_one_component():
    text = chain(1, time=0.5).replace("to: [0, 0]", "to: {y: 0}")
    final = run(text, a=0.3).trace.final
    # Its centre of mass falls straight down.
    assert final[0] == pytest.approx(0.25 * math.sin(0.3), abs=1e-12)
    assert final[1] + 0.25 * math.cos(final[2]) == pytest.approx(0.0, abs=1e-5)


def test_driven_joint_moves_its_point():
    text = chain(1, time=0.7).replace(
        "to: [0, 0]", "to: [0.1*(1 - cos(5*time)), 0.05*sin(4*time)**2]"
    )
    x, y, angle = run(text, a=0.1).trace.final[:3]
    place = [0.1 * (1 - math.cos(3.5)), 0.05 * math.sin(2.8) ** 2]
    assert [x - 0.25 * math.sin(angle), y + 0.25 * math.cos(angle)] == pytest.approx(
        place, abs=1e-5
    )


CRANK = """
kind: scene
name: crank
gravity: 9.81
parameters: {R: 0.1, L: 0.3, w: 15, p: 3*pi/2, s: sqrt(L**2 - R**2*sin(p)**2), v: -R*w*sin(p)}
bodies:
  rod:
    mass: 0.2
    inertia: 0.2*L**2/12
    shape: {polygon: [[-L/2, -0.005], [L/2, -0.005], [L/2, 0.005], [-L/2, 0.005]]}
    start: {x: (2*R*cos(p) + s)/2, y: R*sin(p)/2, angle: -asin(R*sin(p)/L),
      dx: v*(1 + R*cos(p)/s/2), dy: R*w*cos(p)/2, dangle: -R*w*cos(p)/s}
  slider:
    mass: 0.5
    inertia: 0.01
    shape: {polygon: [[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]]}
    start: {x: R*cos(p) + s, dx: v*(1 + R*cos(p)/s)}
surfaces: {ground: {height: -1}}
joints:
  pin: {point: {body: rod, at: [-L/2, 0]}, to: [R*cos(w*time + p), R*sin(w*time + p)]}
  wrist: {point: {body: rod, at: [L/2, 0]}, to: {body: slider}}
  fore: {point: {body: slider, at: [0.04, 0]}, to: {y: 0}}
  aft: {point: {body: slider, at: [-0.04, 0]}, to: {y: 0}}
collisions: {all: {bodies: [rod, slider], surfaces: [ground], friction: 0, restitution: 0}}
stop: {time: 0.6}
settings: {engine: impulse, step: STEP}
"""


def test_a_crank_that_turns_drives_a_slider():
    at = 15 * 0.6 + 1.5 * math.pi
    place = 0.1 * math.cos(at) + math.sqrt(0.3**2 - (0.1 * math.sin(at)) ** 2)
    found = [run(CRANK.replace("STEP", str(step))).trace.final[3] for step in (1e-3, 5e-4)]
    assert found[0] == pytest.approx(place, abs=1e-5)
    assert abs(found[1] - place) < 0.3 * abs(found[0] - place)


def test_a_closed_loop_on_the_ground_stands():
    # Two bars lean on each other, pinned at the top; their feet stand by friction, or slip.
    text = """
kind: scene
name: ladder
parameters: {a: 0.4, mu: 0.5}
gravity: 9.81
bodies:
  one: {mass: 1, inertia: 1/12,
    shape: {polygon: [[-0.5, -0.01], [0.5, -0.01], [0.5, 0.01], [-0.5, 0.01]]},
    start: {x: -cos(pi/2 - a)/2, y: sin(pi/2 - a)/2 + 0.01*sin(a), angle: pi/2 - a}}
  two: {mass: 1, inertia: 1/12,
    shape: {polygon: [[-0.5, -0.01], [0.5, -0.01], [0.5, 0.01], [-0.5, 0.01]]},
    start: {x: cos(pi/2 - a)/2, y: sin(pi/2 - a)/2 + 0.01*sin(a), angle: a - pi/2}}
surfaces: {ground: {height: 0}}
joints: {top: {point: {body: one, at: [0.5, 0]}, to: {body: two, at: [-0.5, 0]}}}
collisions: {all: {bodies: [one, two], surfaces: [ground], friction: mu, restitution: 0}}
stop: {time: 1}
settings: {engine: impulse, step: 1e-3}
"""
    # A foot bears m g, and m g tan(a)/2 along the ground.
    stands = run(text, mu=0.5 * math.tan(0.4) * 1.08).trace
    assert np.abs(stands.final - stands.initial).max() < 1e-4
    slips = run(text, mu=0.5 * math.tan(0.4) * 0.9).trace
    assert slips.final[1] < 0.3


def hung(angles):
    """Return centres of bars that hang in a chain, and corners of the last, with Jacobians."""
    place, ways, centres, corners = np.zeros(2), np.zeros((2, len(angles))), [], []
    for k, angle in enumerate(angles):
        down = 0.25 * np.array([math.sin(angle), -math.cos(angle)])
        turn = np.array([-down[1], down[0]])
        middle = ways.copy()
        middle[:, k] += turn
        centres.append((place + down, middle))
        corners = []
        for x, y in ((-0.02, -1), (0.02, -1), (-0.02, 1), (0.02, 1)):
            side = x * np.array([math.cos(angle), math.sin(angle)]) - y * down
            moved = middle.copy()
            moved[:, k] += -side[1], side[0]
            corners.append((place + down + side, moved))
        place, ways = place + 2 * down, ways.copy()
        ways[:, k] += 2 * turn
    return centres, corners


def chained(count, angle, ground, time, e):
    """Return when a chain of bars strikes the ground without friction, and its angles then."""

    def masses(angles):
        return sum(ways.T @ ways for _, ways in hung(angles)[0]) + np.eye(count) * 0.25 / 12

    def rates(_, state):
        angles, turns = state[:count], state[count:]
        near = hung(angles + 1e-6 * turns)[0], hung(angles - 1e-6 * turns)[0]
        forces = np.zeros(count)
        for (_, ways), (_, later), (_, sooner) in zip(hung(angles)[0], *near, strict=True):
            forces -= ways.T @ ((later - sooner) @ turns / 2e-6 + np.array([0.0, G]))
        return np.concatenate([turns, np.linalg.solve(masses(angles), forces)])

    def above(_, state):
        return min(corner[1] for corner, _ in hung(state[:count])[1]) - ground

    above.terminal, above.direction = True, -1
    state, now, times = np.concatenate([np.full(count, angle), np.zeros(count)]), 0.0, []
    while True:
        found = solve_ivp(rates, (now, time), state, events=above, rtol=1e-8, atol=1e-9)
        state, now = found.y[:, -1].copy(), found.t[-1]
        if found.status == 0:
            return times, state[:count]
        _, ways = min(hung(state[:count])[1], key=lambda corner: corner[0][1])
        freed = np.linalg.solve(masses(state[:count]), ways[1])
        state[count:] -= (1 + e) * (ways[1] @ state[count:]) / (ways[1] @ freed) * freed
        times.append(now)


def test_a_chain_swings_down_and_strikes_the_ground():
    times, angles = chained(3, 1.2, -1.2, 0.65, 0.5)
    assert len(times) == 2
    for step in (1e-3, 2.5e-4):
        text = chain(3, step=step, time=0.65, ground=-1.2)
        text = text.replace("friction: 0.5, restitution: 0", "friction: 0, restitution: 0.5")
        trace = run(text).trace
        assert [jump.t for jump in trace.jumps] == pytest.approx(times, abs=step)
        assert trace.final[[2, 5, 8]] == pytest.approx(angles, abs=2 * step)


@pytest.mark.parametrize("change", [mirrored, rescaled])
def test_transformed_chains_have_transformed_runs(change):
    declared = interpret(read_text(chain(3, time=0.9, ground=-1.2)))
    changed, reading = change(declared)
    one, other = (Runner(model).run().trace for model in (declared, changed))
    assert any(jump.cause == "touchdown" for jump in one.jumps)
    assert other.final * reading.factors == pytest.approx(one.final, abs=1e-6)


def test_redundant_joints_give_a_warning():
    # The bar is held at both ends; at its ends and its middle a third joint says nothing new.
    more = "  far: {point: {body: bar0, at: [0, -l/2]}, to: {x: l*sin(a)}}\n"
    held = chain(1, time=0.1).replace("collisions:", more + "collisions:")
    assert not run(held).warnings
    third = held.replace(
        "collisions:", "  mid: {point: {body: bar0}, to: {y: -l/2*cos(a)}}\ncollisions:"
    )
    assert any("other joints imply 'mid'" in words for words in run(third).warnings)


def test_a_propped_cantilever_gives_a_warning():
    """Welded at one end, it is held; a guide at the other leaves its couple undetermined."""
    weld = "to: [0, 0], angle: held}"
    held = chain(1, time=0.1).replace("to: [0, 0]}", weld)
    assert weld in held
    assert not run(held).warnings
    prop = "  far: {point: {body: bar0, at: [0, -l/2]}, to: {x: l*sin(a)}}\n"
    warnings = run(held.replace("collisions:", prop + "collisions:")).warnings
    assert any("other joints imply" in words for words in warnings)


@pytest.mark.parametrize("digits", [6, 8, 12, 17])
def test_a_body_on_redundant_joints_stays_at_rest(digits):
    """However exactly they are declared: the three bear the weight, and the disc does not move."""
    points = [(0.1 * math.cos(p), 0.1 * math.sin(p)) for p in (0.1, 2.2, 4.3)]
    c, s = math.cos(0.3), math.sin(0.3)
    joints = "".join(
        f"  j{i}: {{point: {{body: disc, at: [{x!r}, {y!r}]}}, "
        f"to: [{round(c * x - s * y, digits)!r}, {round(s * x + c * y + 1, digits)!r}]}}\n"
        for i, (x, y) in enumerate(points)
    )
    result = run(
        f"""
kind: scene
name: held
gravity: {G}
bodies: {{disc: {{mass: 2, inertia: 0.04, shape: {{disc: 0.2}}, start: {{y: 1, angle: 0.3}}}}}}
surfaces: {{ground: {{height: 0}}}}
joints:
{joints}
collisions: {{all: {{bodies: [disc], surfaces: [ground], friction: 0.5, restitution: 0}}}}
outputs: {{X: {{value: j0.X + j1.X + j2.X}}, Y: {{value: j0.Y + j1.Y + j2.Y}}}}
stop: {{time: 0.2}}
settings: {{engine: impulse, step: 1e-3}}
"""
    )
    trace, outputs = result.trace, result.outputs
    assert np.abs(trace.final - trace.initial).max() < 1e-14
    assert trace.counts["inexact_steps"] == 0
    assert trace.counts["iterations"] < 20
    assert outputs["Y"] == pytest.approx(2 * G, rel=1e-12)
    assert outputs["X"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("friction", [0.3, 1, 5])
@pytest.mark.parametrize("arm", [0.7, 0.85, 1.0])
def test_a_jointed_bar_that_falls_on_rough_ground_stays_there(arm, friction):
    """It slips while it falls; once it sticks, nothing moves in spite of errors of the steps."""
    start = -0.3
    trace = run(
        f"""
kind: scene
name: flap
gravity: {G}
bodies:
  bar: {{mass: 1, inertia: 0.0833, shape: {{polygon: {
            [[-0.5, -0.05], [0.5, -0.05], [0.5, 0.05], [-0.5, 0.05]]
        }}}, start: {{x: {arm * math.cos(start)!r}, y: {arm * math.sin(start)!r},
    angle: {start}}}}}
surfaces: {{ground: {{height: -0.9}}}}
joints: {{pin: {{point: {{body: bar, at: [{-arm}, 0]}}, to: [0, 0]}}}}
collisions: {{all: {{bodies: [bar], surfaces: [ground], friction: {friction}, restitution: 0}}}}
stop: {{time: 1}}
settings: {{engine: impulse, step: 1e-3}}
"""
    ).trace
    assert trace.counts["inexact_steps"] == 0
    x, y, angle = trace.final[:3].tolist()
    # Its lower corner is on the ground up to its motion in a step; its pin is off by at most the
    # bending of the arm in that step.
    far = math.hypot(arm + 0.5, 0.05)
    lies = -math.asin(0.9 / far) + math.atan2(0.05, arm + 0.5)
    turn = 1e-3 * math.sqrt(2 * G * 0.9 * arm / (0.0833 + arm**2))
    assert angle == pytest.approx(lies, abs=turn)
    place = [arm * math.cos(angle), arm * math.sin(angle)]
    assert [x, y] == pytest.approx(place, abs=0.5 * turn**2 * arm)
    assert np.abs(trace.final[3:]).max() < 1e-7


@pytest.mark.parametrize("cranks", [2, 3, 5])
def test_a_bar_on_parallel_cranks_swings_however_many_there_are(cranks):
    """All but two say nothing new: the motion is that of one angle."""
    length, start, mass = 0.5, 1.0, 2.0
    bodies, joints = "", ""
    for k, x in enumerate(np.linspace(-0.5, 0.5, cranks).tolist()):
        bodies += (
            f"  c{k}: {{mass: 1, inertia: {length**2 / 12!r}, shape: {{disc: 0.01}}, start: "
            f"{{x: {x + length / 2 * math.cos(start)!r}, y: {length / 2 * math.sin(start)!r}, "
            f"angle: {start}}}}}\n"
        )
        joints += (
            f"  a{k}: {{point: {{body: c{k}, at: [-{length / 2}, 0]}}, to: [{x!r}, 0]}}\n"
            f"  b{k}: {{point: {{body: c{k}, at: [{length / 2}, 0]}}, "
            f"to: {{body: bar, at: [{x!r}, 0]}}}}\n"
        )
    trace = run(
        f"""
kind: scene
name: cranks
gravity: {G}
bodies:
  bar: {{mass: {mass}, inertia: 1, shape: {{disc: 0.01}}, start: {{
    x: {length * math.cos(start)!r}, y: {length * math.sin(start)!r}}}}}
{bodies}
surfaces: {{ground: {{height: -10}}}}
joints:
{joints}
collisions: {{all: {{bodies: [bar], surfaces: [ground], friction: 0, restitution: 0}}}}
stop: {{time: 1}}
settings: {{engine: impulse, step: 5e-4}}
"""
    ).trace
    inertia = cranks * length**2 / 3 + mass * length**2
    pull = (cranks * length / 2 + mass * length) * G
    swing = solve_ivp(
        lambda _, y: [y[1], -pull / inertia * math.cos(y[0])], (0, 1), [start, 0], rtol=1e-10
    )
    angle = float(swing.y[0, -1])
    assert trace.final[5] == pytest.approx(angle, abs=1e-4)
    place = [length * math.cos(angle), length * math.sin(angle), 0.0]
    assert trace.final[:3] == pytest.approx(place, abs=1e-4)
    assert trace.counts["inexact_steps"] == 0


def test_a_trebuchet_moves_as_by_the_equations_of_motion():
    """A weight that hangs from the short arm, a sling of a bar and a stone on the long one."""
    text = f"""
kind: scene
name: trebuchet
gravity: {G}
parameters: {{a: 0.6, u: 1.2*cos(a), v: -1.2*sin(a)}}
bodies:
  arm: {{mass: 2, inertia: 0.43, shape: {{polygon: [[-0.8, -0.03], [0.8, -0.03], [0.8, 0.03],
    [-0.8, 0.03]]}}, start: {{x: -0.4*cos(a), y: -0.4*sin(a), angle: a}}}}
  weight: {{mass: 20, inertia: 0.2, shape: {{disc: 0.15}},
    start: {{x: 0.4*cos(a), y: 0.4*sin(a) - 0.25}}}}
  sling: {{mass: 0.1, inertia: 1e-3, shape: {{disc: 0.01}}, start: {{x: 0.17 - u, y: v}}}}
  stone: {{mass: 0.5, inertia: 1e-3, shape: {{disc: 0.06}}, start: {{x: 0.34 - u, y: v}}}}
surfaces: {{ground: {{height: -9}}}}
joints:
  axle: {{point: {{body: arm, at: [0.4, 0]}}, to: [0, 0]}}
  hanger: {{point: {{body: weight, at: [0, 0.25]}}, to: {{body: arm, at: [0.8, 0]}}}}
  loop: {{point: {{body: sling, at: [-0.17, 0]}}, to: {{body: arm, at: [-0.8, 0]}}}}
  pouch: {{point: {{body: stone}}, to: {{body: sling, at: [0.17, 0]}}}}
collisions: {{all: {{bodies: [stone], surfaces: [ground], friction: 0, restitution: 0}}}}
stop: {{time: 0.4}}
settings: {{engine: impulse, step: STEP}}
"""
    i, j = text.index("collisions:"), text.index("stop:")
    points = text[:i] + text[j:].replace("engine: impulse, step: STEP", "engine: scipy")
    expected = run(points).trace.final
    # It has thrown: the sling whirls.
    assert np.abs(expected[12:]).max() > 5.0
    errors = [
        np.abs(run(text.replace("STEP", str(step))).trace.final - expected)[:12].max()
        for step in (4e-3, 2e-3, 1e-3)
    ]
    assert errors[0] < 2e-2
    assert errors[2] < 0.27 * errors[1] < 0.27**2 * errors[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("to: [0, 0]", "to: [0, 0.1]", r"its point is at \(0, 0\), .* held to at \(0, 0.1\)"),
        ("dangle: w", "dangle: 1", "joint 'j0' does not hold at the start: its ends move apart"),
        ("to: [0, 0]", "to: {body: bar7}", "no body 'bar7'"),
    ],
)
def test_wrong_joints_are_refused(old, new, words):
    with pytest.raises(DeclarationError, match=words):
        Runner(interpret(read_text(chain(1).replace(old, new)))).run()
