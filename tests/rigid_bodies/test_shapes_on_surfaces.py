"""Bodies with shapes on surfaces of every kind, beside closed forms and points on the same."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

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
OUTLINES = {
    "disc": "mass: 2, inertia: r**2, shape: {disc: r}",
    "box": "mass: 2, inertia: 2*(a**2 + b**2)/3, "
    "shape: {polygon: [[-a, -b], [a, -b], [a, b], [-a, b]]}",
}


def scene(starts, surfaces, *, mu=0, e=0, step=1e-3, time=1.0, more="", gravity="g"):
    """Return a scene of a disc or a box, or both, as text; `starts`: body -> its start."""
    bodies = "\n".join(f"  {n}: {{{OUTLINES[n]}, start: {{{s}}}}}" for n, s in starts.items())
    grounds = "\n".join(f"  {name}: {{{text}}}" for name, text in surfaces.items())
    return f"""
kind: scene
name: shapes
parameters: {{g: 9.81, r: 0.05, a: 0.2, b: 0.1}}
gravity: {gravity}
bodies:
{bodies}
{more}
surfaces:
{grounds}
collisions:
  all: {{bodies: [{", ".join(starts)}], surfaces: [{", ".join(surfaces)}],
    friction: {mu}, restitution: {e}}}
stop: {{time: {time}}}
settings: {{engine: impulse, step: {step}}}
"""


def run(text):
    trace = Runner(interpret(read_text(text))).run().trace
    assert trace.outcome is Outcome.HORIZON, trace.message
    return trace


def at(x, y):
    return f"x: {x!r}, y: {y!r}"


def rolled(path, start, time, inertia=0.5):
    """Return where the centre of a disc is that rolls from rest.

    Parameters
    ----------
    path : callable
        Parameter of the curve of the centre -> place, first and second derivative.
    inertia : float
        Over mass and radius squared: the kinetic energy is ``(1 + inertia) m speed^2 / 2``.
    """

    def rates(_, state):
        s, ds = state
        _, first, second = path(s)
        pull = -G * first[1] / (1.0 + inertia) - (first @ second) * ds * ds
        return ds, pull / (first @ first)

    found = solve_ivp(rates, (0.0, time), (start, 0.0), rtol=1e-11, atol=1e-12)
    return path(found.y[0, -1])[0]


def offset_curve(height: Callable, r: float):
    """Return the curve at the distance r above y = height(x), which gives three derivatives."""

    def path(x):
        y, f1, f2, f3 = height(x)
        u = math.hypot(1.0, f1)
        place = np.array([x - r * f1 / u, y + r / u])
        stretch = 1.0 - r * f2 / u**3
        change = -r * (f3 / u**3 - 3.0 * f1 * f2**2 / u**5)
        first = stretch * np.array([1.0, f1])
        return place, first, change * np.array([1.0, f1]) + stretch * np.array([0.0, f2])

    return path


def wave(x):
    c, s = math.cos(2 * x), math.sin(2 * x)
    return 0.3 * c, -0.6 * s, -1.2 * c, 2.4 * s


def around(reach):
    def path(angle):
        c, s = math.cos(angle), math.sin(angle)
        return reach * np.array([s, -c]), reach * np.array([c, s]), reach * np.array([-s, c])

    return path


CURVES = {
    "height": ({"hill": "height: 0.3*cos(2*x)"}, offset_curve(wave, 0.05), 0.4, 0.8),
    "hollow": ({"drum": "circle: [0, 0], radius: 0.5, hollow: true"}, around(0.45), 1.0, 1.0),
    "round": ({"hill": "circle: [0, 0], radius: 0.5"}, around(0.55), math.pi - 0.3, 0.5),
}


@pytest.mark.parametrize("curve", CURVES)
def test_a_disc_rolls_along_a_curve(curve):
    surfaces, path, start, time = CURVES[curve]
    expected = rolled(path, start, time)
    errors = []
    for step in (2e-3, 1e-3):
        starts = {"disc": at(*path(start)[0].tolist())}
        trace = run(scene(starts, surfaces, mu=10, step=step, time=time))
        errors.append(math.hypot(*(trace.final[:2] - expected)))
        # In a step it leaves the tangent by (h v)^2/(2 R).
        assert trace.margins["disc.gap"] > -5 * step**2
    assert errors[0] < 2e-5
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.parametrize(
    "ground", ["circle: [0, -0.5], radius: 0.5", "height: sqrt(0.25 - x**2) - 0.5"]
)
def test_a_box_rocks_on_a_crest(ground):
    # k^2 + b^2 over g (R - b), for small angles.
    rate = math.sqrt(G * (0.5 - 0.1) / ((0.2**2 + 0.1**2) / 3 + 0.1**2))
    angle = 0.02
    # Rolled to the angle: the point of contact has moved by R times it.
    x = 0.6 * math.sin(angle) - 0.5 * angle * math.cos(angle)
    y = 0.6 * math.cos(angle) + 0.5 * angle * math.sin(angle) - 0.5
    start = f"{at(x, y)}, angle: {-angle}"
    time = 2 * math.pi / rate
    trace = run(scene({"box": start}, {"crest": ground}, mu=5, step=5e-4, time=time))
    assert trace.final[2] == pytest.approx(-angle, rel=0.02)
    half = run(scene({"box": start}, {"crest": ground}, mu=5, step=5e-4, time=time / 2))
    assert half.final[2] == pytest.approx(angle, rel=0.02)


def test_a_box_stays_on_a_plate_that_is_shaken_below_gravity():
    path = "displacement: [0, 0.01*(1 - cos(25*time))]"
    for ground in ("height: 0", "edge: [[-1, 0], [1, 0]]", "height: 0*x**2"):
        trace = run(scene({"box": at(0.1, 0.1)}, {"plate": f"{ground}, {path}"}, time=0.8))
        assert trace.final_mode == ("slide",)
        assert not any(jump.cause == "liftoff" for jump in trace.jumps)
        # It starts at rest, at the rise of the plate in half a step.
        rise = 0.01 * (1 - math.cos(25 * 5e-4))
        assert trace.margins["box.gap"] == pytest.approx(-rise, rel=1e-6)
        expected = 0.1 + 0.01 * (1 - math.cos(20))
        assert trace.final[1] == pytest.approx(expected, abs=0.01 * 25**2 * 1e-6)


def test_a_disc_on_a_plate_that_falls_away_is_thrown():
    # 0.01 * 50^2 = 25 > g: it leaves where the plate falls faster than it does.
    surfaces = {"plate": "height: 0, displacement: [0, 0.01*(1 - cos(50*time))]"}
    leaves = math.acos(-G / 25.0) / 50.0
    trace = run(scene({"disc": at(0.0, 0.05)}, surfaces, step=1e-4, time=leaves + 0.02))
    y = 0.05 + 0.01 * (1 + G / 25.0) + 0.5 * math.sin(50 * leaves) * 0.02 - G * 0.02**2 / 2
    assert trace.final[1] == pytest.approx(y, abs=2e-4)


def test_a_box_slips_on_a_shaken_plate_as_its_corners_do():
    path = "displacement: [0.02*(1 - cos(20*time)), 0]"
    shapes = scene({"box": at(0.0, 0.1)}, {"plate": f"height: 0, {path}"}, mu=0.4, time=0.6)
    touching = "\n".join(
        f"  {name}: {{point: {{body: box, at: [{x}, -b]}}, surface: plate, friction: 0.4,"
        " restitution: 0}"
        for name, x in (("one", "-a"), ("two", "a"))
    )
    i = shapes.index("collisions:")
    points = shapes[:i] + f"contacts:\n{touching}\n" + shapes[shapes.index("stop:") :]
    points = points.replace(OUTLINES["box"].split(", shape")[1], "").replace(", shape,", ",")
    points = points.replace("engine: impulse, step: 0.001", "engine: scipy, tolerance: 1e-10")
    expected = run(points).final
    found = run(shapes).final
    assert found[:3] == pytest.approx(expected[:3], abs=2e-4)
    assert abs(expected[0] - 0.02 * (1 - math.cos(12))) > 1e-3


def test_a_disc_on_a_belt_ends_rolling():
    # It slips for v/(3 mu g), and then rolls at a third of the belt's speed.
    surfaces = {"belt": "height: 0, displacement: [0.6*time, 0]"}
    trace = run(scene({"disc": at(0.0, 0.05)}, surfaces, mu=0.3, time=0.5))
    slips = 0.6 / (3 * 0.3 * G)
    assert trace.final[3] == pytest.approx(0.2, abs=1e-9)
    assert trace.final[5] == pytest.approx(0.4 / 0.05, abs=1e-7)
    assert trace.final[0] == pytest.approx(0.1 * slips + 0.2 * (0.5 - slips), abs=2e-4)
    assert trace.final_mode == ("pin",)


def test_a_disc_that_loops_in_a_drum_stays_on_its_wall_and_keeps_its_energy():
    # Fast enough for the wall to press it at the top, too: v^2 > 5 g R. Its normal turns by far
    # more in a step than gravity could take back.
    way, speed = 0.45, 8.0
    lost = []
    for step in (2e-3, 1e-3):
        start = f"{at(0.0, -way)}, dx: {speed}"
        drum = {"drum": "circle: [0, 0], radius: 0.5, hollow: true"}
        trace = run(scene({"disc": start}, drum, step=step, time=2.0))
        _, y, _, dx, dy, _ = trace.final
        lost.append(1 - (dx**2 + dy**2 + 2 * G * (y + way)) / speed**2)
        assert min(trace.margins.values()) > -((speed * step) ** 2) / way
        assert {jump.cause for jump in trace.jumps} <= {"touchdown", "impact"}
    assert abs(lost[1]) < 1e-3
    assert lost[0] / lost[1] == pytest.approx(4, rel=0.1)


def test_a_box_that_pivots_on_its_corner_follows_the_closed_form_to_second_order():
    # A pendulum upside down about the corner, which neither slips nor sinks.
    a, b, start, speed, time = 0.2, 0.1, math.pi / 2 - 0.3, -0.5, 0.2
    arm = np.array([a, b])

    def centre(angle):
        cos, sin = math.cos(angle), math.sin(angle)
        return np.array([cos * arm[0] - sin * arm[1], sin * arm[0] + cos * arm[1]])

    square = (a**2 + b**2) / 3 + a**2 + b**2
    swing = solve_ivp(
        lambda _, y: [y[1], -G * centre(y[0])[0] / square], (0.0, time), [start, speed],
        rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    (x, y), errors = centre(start).tolist(), []
    moving = f"angle: {start!r}, dx: {-speed * y!r}, dy: {speed * x!r}, dangle: {speed}"
    for step in (2e-3, 1e-3):
        text = scene({"box": f"{at(x, y)}, {moving}"}, {"floor": "height: 0"}, mu=50, step=step,
                     time=time)  # fmt: skip
        trace = run(text)
        assert trace.final_mode == ("pin",)
        place = centre(swing.y[0, -1])
        errors.append(float(np.abs(trace.final[:3] - [*place, swing.y[0, -1]]).max()))
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.2)


def test_a_disc_at_rest_in_a_turning_drum_rolls():
    surfaces = {"drum": "circle: [1, 2], radius: 0.5, hollow: true, turn: 2*time"}
    # Without gravity and slip it goes round as a planet does; started on that way.
    speed, spin = 0.3, (2 * 0.5 - 0.3) / 0.05
    start = f"x: 1, y: 2 - 0.45, dx: {speed}, dangle: {spin}"
    trace = run(scene({"disc": start}, surfaces, mu=1, time=2.0, gravity=0))
    angle = speed * 2.0 / 0.45
    place = [1 + 0.45 * math.sin(angle), 2 - 0.45 * math.cos(angle)]
    assert trace.final[:2] == pytest.approx(place, abs=1e-5)
    assert trace.final[5] == pytest.approx(spin, rel=1e-5)


@pytest.mark.parametrize(
    ("surface", "place", "carried"),
    [
        ("edge: [[-1, 0], [1, 0]]", (0, 0), "edge: [[-1, 0], [1, 0]]"),
        ("circle: [0.1, -0.9], radius: 0.9", (0.1, -0.9), "circle: [0, 0], radius: 0.9"),
    ],
)
def test_a_surface_on_a_path_moves_bodies_as_one_on_a_led_body(surface, place, carried):
    x, y, turn = "0.1*sin(5*time)", "0.02*sin(8*time)", "0.2*sin(3*time)"
    starts = {"box": at(0.0, 0.101), "disc": at(0.4, 0.2)}
    path = f"{surface}, displacement: [{x}, {y}], turn: {turn}"
    board = f"position: [{place[0]} + {x}, {place[1]} + {y}], angle: {turn}, shape: {{disc: 0.01}}"
    one = run(scene(starts, {"tray": path}, mu=0.4, e=0.2))
    more = f"  board: {{{board}}}"
    other = run(scene(starts, {"tray": f"{carried}, body: board"}, mu=0.4, e=0.2, more=more))
    assert len(one.jumps) == len(other.jumps) > 3
    assert one.final == pytest.approx(other.final, abs=1e-9)


def test_a_box_on_a_cart_comes_to_its_speed():
    cart = "  cart: {mass: 6, inertia: 1, start: {y: -1}}"
    surfaces = {"deck": "edge: [[-3, 1], [3, 1]], body: cart", "rail": "height: -1.1"}
    text = scene({"box": f"{at(0.0, 0.1)}, dx: 2"}, surfaces, mu=0.3, more=cart, time=1.0)
    # A cart without wheels has a shape that touches the rail, without friction.
    text = text.replace(
        "{mass: 6, inertia: 1, start: {y: -1}}",
        "{mass: 6, inertia: 1e6, start: {y: -1}, "
        "shape: {polygon: [[-3, -0.1], [3, -0.1], [3, 0.1], [-3, 0.1]]}}",
    )
    text = text.replace("  all: {bodies: [box], surfaces: [deck, rail],\n    friction: 0.3",
        "  rolls: {bodies: [cart], surfaces: [rail], friction: 0, restitution: 0}\n"
        "  all: {bodies: [box], surfaces: [deck],\n    friction: 0.3")  # fmt: skip
    trace = run(text)
    n = len(trace.final) // 2
    box, cart = trace.final[:3], trace.final[3:6]
    assert trace.final[n] == pytest.approx(0.5, abs=1e-3)
    assert trace.final[n + 3] == pytest.approx(0.5, abs=1e-3)
    # It slips by v^2 / (2 mu g (1 + m/M)).
    assert box[0] - cart[0] == pytest.approx(4 / (2 * 0.3 * G * (1 + 2 / 6)), abs=5e-3)


PIECES = {f"p{k}": f"edge: [[{k / 8}, 0], [{(k + 1) / 8}, 0]]" for k in range(12)}


@pytest.mark.parametrize("body", ["box", "disc"])
def test_bodies_slide_over_flush_plates(body):
    y = {"box": 0.1, "disc": 0.05}[body]
    trace = run(scene({body: f"{at(0.3, y)}, dx: 0.9"}, PIECES, time=0.8))
    assert trace.final == pytest.approx([0.3 + 0.72, y, 0.0, 0.9, 0.0, 0.0], abs=1e-12)


def test_a_disc_rolls_over_a_ridge_of_two_plates():
    # Down a slope onto flat ground: no energy is lost over a ridge of so small an angle.
    tilt = 0.05
    plates = {
        "up": "edge: [[-1, 0], [0, 0]]",
        "down": f"edge: [[0, 0], [{math.cos(tilt)!r}, {-math.sin(tilt)!r}]]",
    }
    trace = run(scene({"disc": f"{at(-0.3, 0.05)}, dx: 1"}, plates, time=0.7))
    # A disc that is not pressed flies over it; it lands, and stays with the slope.
    along = np.array([math.cos(tilt), -math.sin(tilt)])
    assert (trace.final[:2] - [0, 0.05]) @ [along[1] * -1, along[0]] < 0.003
    assert trace.final[3:5] @ along == pytest.approx(
        math.sqrt(1 + 2 * G * (0.05 - trace.final[1])), rel=5e-3
    )


def test_a_disc_on_the_end_of_a_shelf_falls_off():
    shelf = {"shelf": "edge: [[-1, 0], [0, 0]]"}
    stays = run(scene({"disc": at(-0.001, 0.05)}, shelf, mu=1, time=0.3))
    assert stays.final[:3] == pytest.approx([-0.001, 0.05, 0.0], abs=1e-12)
    falls = run(scene({"disc": at(0.001, math.sqrt(0.05**2 - 1e-6))}, shelf, mu=1, time=0.8))
    assert falls.final[0] > 0.02
    assert falls.final[1] < -0.1


def test_a_fast_body_meets_a_plate_within_a_step():
    text = scene({"disc": f"{at(0.0, 1.115)}, dy: -150"}, {"plate": "edge: [[-1, 0], [1, 0]]"})
    trace = Runner(interpret(read_text(text))).run().trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.final[1] > 0.0
    assert any("had to be split into up to" in warning for warning in trace.warnings)


EVERY = {
    "drum": "circle: [0.1, 0], radius: 1, hollow: true, turn: 0.5*sin(3*time)",
    "hill": "height: 0.05*cos(3*x) - 0.8, displacement: [0.02*sin(4*time), 0]",
    "post": "circle: [0.4, -0.5], radius: 0.1",
    "shelf": "edge: [[-0.5, -0.4], [-0.1, -0.5]], turn: 0.1*sin(2*time)",
}


@pytest.mark.parametrize("change", [mirrored, rescaled])
def test_transformed_scenes_have_transformed_runs(change):
    starts = {"disc": f"{at(-0.3, 0.2)}, dx: 0.3", "box": f"{at(0.2, 0.3)}, angle: 0.3"}
    declared = interpret(read_text(scene(starts, EVERY, mu=0.4, e=0.3, time=0.8)))
    changed, reading = change(declared)
    one, other = (Runner(model).run().trace for model in (declared, changed))
    assert one.outcome is Outcome.HORIZON, one.message
    assert {jump.cause for jump in one.jumps} >= {"touchdown", "impact"}
    assert other.final * reading.factors == pytest.approx(one.final, abs=1e-6)


@pytest.mark.parametrize(
    ("starts", "circle", "words"),
    [
        ({"disc": at(0.0, 2.0)}, "1", "'disc' starts outside .* 'drum'; .* 1 of .*remove hollow"),
        ({"disc": "", "box": at(0.0, 2.0)}, "1", "'box' starts outside .*; .*remove hollow"),
        ({"disc": at(0.0, 0.0)}, "1, displacement: [0, 2]", r"'disc' .* of \(0, 2\); .*hollow"),
        ({"disc": "x: 0"}, "0.04", "'disc' does not fit into 'drum': .*0.04; .*circle larger"),
    ],
)
@pytest.mark.parametrize("law", ["restitution: 0", "stiffness: 10000, damping: 10"])
def test_drum_bodies_must_start_inside(starts, circle, words, law):
    text = scene(starts, {"drum": f"circle: [0, 0], radius: {circle}, hollow: true"})
    with pytest.raises(DeclarationError, match=words):
        Runner(interpret(read_text(text.replace("restitution: 0.0", law)))).run()


def test_a_body_placed_by_a_coordinate_must_start_inside():
    text = scene({"disc": "x: 0"}, {"drum": "circle: [0, 0], radius: 1, hollow: true"})
    text = text.replace("inertia: r**2, ", "").replace("start: {x: 0}", "position: [s, 0]")
    text += "coordinates: {s: {start: 2}}\n"
    with pytest.raises(DeclarationError, match=r"disc\.position: body 'disc' starts outside"):
        Runner(interpret(read_text(text))).run()


def test_drum_bodies_over_the_rim_move_inwards():
    text = scene({"disc": at(0.0, 0.97)}, {"drum": "circle: [0, 0], radius: 1, hollow: true"})
    with pytest.raises(DeclarationError, match=r"move it by \(0, -0.02\) out$"):
        Runner(interpret(read_text(text))).run()


@pytest.mark.parametrize(
    ("surface", "words"),
    [
        ("height: 0, hollow: true", "only a circle is hollow"),
        ("edge: [[0, 0], [1, 0]], body: disc, turn: time", "moves with it"),
        ("height: 0, turn: abs(time)", "a velocity that jumps"),
        ("height: 0, turn: disc.angle", "unknown name 'disc.angle'"),
    ],
)
def test_invalid_surfaces_are_refused(surface, words):
    with pytest.raises(DeclarationError, match=words):
        interpret(read_text(scene({"disc": "y: 1"}, {"ground": surface})))


def test_points_meet_a_turning_drum_as_shapes_do():
    text = """
kind: scene
name: bead
gravity: g
parameters: {g: 9.81, R: 0.5, w: 2}
bodies: {bead: {mass: 1, start: {y: -R, dx: w*R}}}
surfaces: {drum: {circle: [0, 0], radius: R, hollow: true, turn: w*time}}
contacts: {rim: {point: {body: bead}, surface: drum, friction: 10, restitution: 0}}
stop: {time: 0.3}
"""
    # Rough enough, it is carried along.
    for settings in ("engine: scipy, tolerance: 1e-10", "engine: impulse, step: 1e-4"):
        trace = run(f"{text}settings: {{{settings}}}")
        angle = 0.6
        expected = [0.5 * math.sin(angle), -0.5 * math.cos(angle)]
        assert trace.final_mode == ("pin",)
        assert trace.final[:2] == pytest.approx(expected, abs=1e-5)
    # Without friction it swings as a pendulum, and the drum's turning is nothing to it.
    smooth = text.replace("friction: 10", "friction: 0, modes: [free, slide]")
    found = run(smooth + "settings: {engine: scipy, tolerance: 1e-10}").final
    swing = solve_ivp(
        lambda _, s: (s[1], -G / 0.5 * math.sin(s[0])), (0, 0.3), (0, 2), rtol=1e-11, atol=1e-12
    )
    expected = [0.5 * math.sin(swing.y[0, -1]), -0.5 * math.cos(swing.y[0, -1])]
    assert found[:2] == pytest.approx(expected, abs=1e-8)


ROLLERS = """
kind: scene
name: rollers
parameters: {R: 0.1, r: 0.15, a: 40*pi/180, mu: 0.2, w: 20, until: 0.2}
gravity: 9.81
bodies:
  disc: {mass: 1, inertia: r**2/2, shape: {disc: r}, start: {y: (R + r)*cos(a)}}
surfaces:
  left: {circle: [-(R + r)*sin(a), 0], radius: R, turn: w*time}
  right: {circle: [(R + r)*sin(a), 0], radius: R, turn: w*time}
collisions: {all: {bodies: [disc], surfaces: [left, right], friction: mu, restitution: 0}}
stop: {time: until}
settings: {engine: impulse, step: 1e-3}
"""


@pytest.mark.parametrize("until", [0.2, 0.20031, 0.6])
def test_a_disc_on_two_rollers_that_turn_is_spun_up_in_its_place(until):
    """Constant friction of both spins it up until it rolls; the last steps may be shorter."""
    up, across = math.cos(math.radians(40)), math.sin(math.radians(40))
    normals = np.array([[across, up], [-across, up]])
    along = np.array([[-up, across], [-up, -across]])
    forces = np.linalg.solve((normals + 0.2 * along).T, [0.0, 9.81])
    spin = -min(0.2 * forces.sum() / (0.5 * 0.15) * until, 20 * 0.1 / 0.15)
    final = Runner(interpret(read_text(ROLLERS))).run({"until": until}).trace.final
    assert final[[0, 1, 3, 4, 5]] == pytest.approx([0, 0.25 * up, 0, 0, spin], abs=1e-10)


def test_fast_disc_in_a_bowl_stops_bouncing():
    """It is pressed by 75 times its weight, which turns it more in a step than it rebounds."""
    start, grounds = {"disc": f"{at(0.0, 0.051)}, dx: 6"}, {"bowl": "height: x**2"}
    found, exact = (
        run(scene(start, grounds, e=0.3, time=0.4, gravity=1, step=h)) for h in (1e-3, 2e-5)
    )
    assert len(found.jumps) < 6
    assert not found.warnings
    np.testing.assert_allclose(found.final, exact.final, rtol=0, atol=3e-3)


BAR = "{polygon: [[-0.5, -0.1], [0.5, -0.1], [0.5, 0.1], [-0.5, 0.1]]}"


@pytest.mark.parametrize(
    ("shape", "reach", "x"),
    [
        (BAR, 0.509902, 0),  # half the diagonal
        ("{polygon: [[-0.5, -0.3], [0.5, -0.3], [0, 0.5660254]]}", 0.57735, 0),  # side/sqrt(3)
        ("{polygon: [[-0.5, -0.1], [0.5, -0.1], [0, 0.1]]}", 0.5, 0),  # obtuse: half its longest
        ("[{disc: 0.3}, {disc: 0.1, at: [0.5, 0]}]", 0.45, 0.15),
        # hypot(0.5 + x, 0.1) = 1.2 - x
        (f"[{BAR}, {{disc: 0.3, at: [0.9, 0]}}]", 0.852941, 1.18 / 3.4),
    ],
)
def test_a_body_that_cannot_fit_into_a_hollow_circle_is_said_to(shape, reach, x):
    outline = re.sub("shape: .*", f"shape: {shape}", OUTLINES["box"])
    for radius in (0.95 * reach, 1.2 * reach):
        drum = {"drum": f"circle: [0, 0], radius: {radius}, hollow: true"}
        text = scene({"box": f"x: {-x}"}, drum).replace(OUTLINES["box"], outline)
        runner = Runner(interpret(read_text(text)))
        if radius > reach:
            assert runner.run(until=0.01).trace.outcome is Outcome.HORIZON
            continue
        with pytest.raises(DeclarationError, match=f"around it has a radius of {reach:.6g}, and"):
            runner.run()


def test_a_disc_fits_into_a_hollow_circle_of_its_radius():
    text = scene({"disc": "x: 0"}, {"drum": "circle: [0, 0], radius: 0.05, hollow: true"})
    assert Runner(interpret(read_text(text))).run(until=0.01).trace.outcome is Outcome.HORIZON
