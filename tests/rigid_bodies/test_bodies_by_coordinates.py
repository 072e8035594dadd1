"""Bodies that coordinates place beside free ones: closed forms, and scenes that say the same."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from contacts.scene.scene import Scene
from contacts.testing.body_properties import body_properties
from statechart.arrays import Array
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.result import Result
from statechart.running.runner import Runner
from statechart.testing.subject import Subject

G = 9.81
BOX = "shape: {polygon: [[-0.5, -0.4], [0.5, -0.4], [0.5, 0.4], [-0.5, 0.4]]}"
FLOOR = "surfaces: {floor: {line: [[0, 0], [1, 0]]}}\n"


def _scene(text: str, gravity: float = G, step: float = 1e-3, **settings: Any) -> Scene:
    further = "".join(f", {key}: {value}" for key, value in settings.items())
    head = f"kind: scene\nname: mixed\ngravity: {gravity}\n"
    model = interpret(
        read_text(f"{head}{text}\nsettings: {{engine: impulse, step: {step}{further}}}\n")
    )
    assert isinstance(model, Scene)
    return model


def _run(text: str, until: float = 1.0, throw: bool = True, **settings: Any) -> Result:
    return Runner(_scene(text, **settings)).run(until=until, throw=throw)


def _final(result: Result) -> dict[str, float]:
    trace = result.trace
    return dict(zip(trace.variables, trace.final.tolist(), strict=True))


def _order(errors: Array) -> float:
    """Return the order of errors at steps of which each is half the one before."""
    return float(np.log2(errors[0] / errors[-1]) / (len(errors) - 1))


RAM = f"""
coordinates: {{s: {{}}}}
bodies:
  ram: {{mass: 2, position: [s, 0.5], {BOX}}}
  box: {{mass: 1, inertia: 1, start: {{x: 1.2, y: 0.4}}, {BOX}}}
{FLOOR}
collisions:
  push: {{bodies: [ram, box], friction: 0, restitution: 0}}
  slide: {{bodies: [box], surfaces: [floor], friction: 0.2, restitution: 0}}
forces: {{drive: {{body: ram, force: [10, 0]}}}}
"""


def test_a_ram_pushes_a_box_over_the_floor() -> None:
    struck = math.sqrt(2 * 0.2 * 2 / 10)
    speed, acceleration = 10 / 2 * struck * 2 / 3, (10 - 0.2 * G) / 3
    left, errors = 1.0 - struck, []
    for h in (2e-3, 1e-3, 5e-4, 2.5e-4):
        found = _final(_run(RAM, step=h))
        assert found["s"] + 1.0 == pytest.approx(found["box.x"], abs=1e-3)
        assert found["ds"] == pytest.approx(speed + acceleration * left, abs=2.0 * h)
        far = 1.2 + speed * left + acceleration * left**2 / 2
        errors.append(abs(found["box.x"] - far))
    assert errors[-1] < 1e-3
    assert _order(np.array(errors)) > 0.7


OTHERS = """
  box:
    mass: 1
    inertia: 0.2
    start: {x: 0.1, y: 1.7, dx: DX}
    shape: {polygon: [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]}
  disc: {mass: 0.5, inertia: 0.04, start: {x: 1.4, y: 0.4, dx: BACK}, shape: {disc: 0.4}}
"""
ALIKE = {
    "impacts": ("friction: 0.4, restitution: 0.3", ""),
    "two coefficients": ("friction: {static: 0.6, kinetic: 0.3}, restitution: 0", ""),
    "compliance": ("friction: 0.4, stiffness: 5000, damping: 20", ""),
    "rolling": ("friction: 0.4, restitution: 0, rolling_resistance: 0.02", ""),
    "in turn": ("friction: 0.4, restitution: 0.7", "simultaneous: sequential"),
    "at once": ("friction: 0.4, restitution: 0.7", "simultaneous: capped"),
    "forces": (
        "friction: 0.4, restitution: 0.2",
        "forces: {one: {body: ram, at: [0.2, 0.1], force: "
        '["-20*ram.x - 2*ram.dx", 5*sin(time)], moment: -0.1*ram.dangle + box.x}, '
        "two: {body: box, force: [3*ram.x, 0]}}",
    ),
    "joints": (
        "friction: 0.4, restitution: 0.2",
        "joints: {rod: {point: {body: box, at: [0.5, 0]}, to: {body: disc}, "
        f"rod: {math.hypot(0.8, 1.3)!r}}}}}",
    ),
    "carried surface": (
        "friction: 0.4, restitution: 0.2",
        "surfaces: {floor: {line: [[0, 0], [1, 0]]}, top: {edge: [[-0.7, 0.6], [0.7, 0.6]], "
        "body: ram}}",
    ),
}


@pytest.mark.parametrize("what", ALIKE)
def test_a_body_by_three_coordinates_moves_as_a_free_one(what: str) -> None:
    law, further = ALIKE[what]
    surfaces = "" if "surfaces" in further else FLOOR
    touched = "[floor, top]" if "top" in further else "[floor]"
    speeds = ("0", "0") if what == "joints" else ("0.3", "-1")
    others = OTHERS.replace("DX", speeds[0]).replace("BACK", speeds[1])
    own = f"mass: 2, inertia: 0.5, {BOX}"
    if what == "carried surface":
        others = others.replace("y: 1.7", "y: 2.2")
    runs = []
    for coordinates, place in (
        ("", "start: {y: 0.7, dangle: 0.5}"),
        ("coordinates: {v: {start: 0.7}, w: {rate: 0.5}, u: {}}", "position: [u, v], angle: w"),
    ):
        text = (
            f"{coordinates}\nbodies:{others}  ram: {{{own}, {place}}}\n{surfaces}collisions: "
            f"{{all: {{bodies: [box, disc, ram], surfaces: {touched}, {law}}}}}\n{further}\n"
        )
        runs.append(_run(text, until=1.2, impulse_tolerance=1e-10))
    free, placed = map(_final, runs)
    names = {"x": "u", "y": "v", "angle": "w", "dx": "du", "dy": "dv", "dangle": "dw"}
    placed |= {f"ram.{part}": placed[name] for part, name in names.items()}
    assert {name: placed[name] for name in free} == pytest.approx(free, abs=1e-8)
    assert len(runs[0].trace.jumps) > 10


LEG = """
bodies:
  thigh: {mass: 2, inertia: 0.05, THIGH}
  shank: {mass: 1, inertia: 0.03, SHANK, SHIN}
  ball: {mass: 0.4, inertia: 0.004, shape: {disc: 0.11}, start: {x: X, y: 0.11}}
surfaces: {floor: {line: [[0, 0], [1, 0]]}}
collisions:
  kick: {bodies: [shank, ball], friction: 0.3, restitution: 0.5}
  roll: {bodies: [ball], surfaces: [floor], friction: 0.5, restitution: 0.5}
""".replace("SHIN", "shape: {polygon: [[-0.05, -0.5], [0.05, -0.5], [0.05, 0.5], [-0.05, 0.5]]}")
BY_COORDINATES = (
    "coordinates: {a: {start: 1.2}, b: {start: 1.2}}"
    + LEG.replace("THIGH", "position: [sin(a)/2, 2.15 - cos(a)/2], angle: a").replace(
        "SHANK", "position: [sin(a) + sin(b)/2, 2.15 - cos(a) - cos(b)/2], angle: b"
    )
).replace("X,", "-0.17,")


def test_leg_by_coordinates_kicks_like_a_jointed_leg() -> None:
    s, c = math.sin(1.2), math.cos(1.2)
    by_joints = (
        LEG.replace("THIGH", f"start: {{x: {s / 2}, y: {2.15 - c / 2}, angle: 1.2}}")
        .replace("SHANK", f"start: {{x: {1.5 * s}, y: {2.15 - 1.5 * c}, angle: 1.2}}")
        .replace("X,", "-0.17,")
        + "joints:\n  hip: {point: {body: thigh, at: [0, 0.5]}, to: [0, 2.15]}\n"
        "  knee: {point: {body: shank, at: [0, 0.5]}, to: {body: thigh, at: [0, -0.5]}}\n"
    )
    apart = []
    for h in (2e-3, 1e-3, 5e-4):
        one, other = (_final(_run(text, 0.65, step=h)) for text in (BY_COORDINATES, by_joints))
        assert one["ball.dx"] < -3.0
        apart.append(
            [
                abs(one[name] - other[known])
                for name, known in {"ball.x": "ball.x", "ball.dx": "ball.dx", "a": "thigh.angle",
                                    "b": "shank.angle"}.items()
            ]
        )  # fmt: skip
    assert (np.array(apart)[-1] < [2e-4, 2e-3, 1e-3, 1e-3]).all()
    assert _order(np.array(apart).max(axis=1)) > 0.8


def _swung(t: float, q: Array) -> Array:
    """Return the rates of the leg's angles and their rates, by Lagrange's equations."""
    a, b, u, v = q
    c, s = math.cos(a - b), math.sin(a - b)
    mass = np.array([[0.55 + 1.0, c / 2], [c / 2, 0.28]])
    force = [-s / 2 * v**2 - (1.0 + 1.0) * G * math.sin(a), s / 2 * u**2 - G / 2 * math.sin(b)]
    return np.array([u, v, *np.linalg.solve(mass, force)])


def test_a_mechanism_without_contacts_converges_with_second_order() -> None:
    exact = solve_ivp(_swung, (0.0, 1.5), [1.2, 1.2, 0.0, 0.0], rtol=1e-11, atol=1e-11).y[:, -1]
    far, errors, gained = BY_COORDINATES.replace("-0.17,", "9,"), [], []
    for h in (4e-3, 2e-3, 1e-3):
        result = _run(far + "outputs: {most: {maximum: energy}, least: {minimum: energy}}\n",
                      1.5, step=h)  # fmt: skip
        found = _final(result)
        errors.append(np.abs([found[name] for name in ("a", "b", "da", "db")] - exact).max())
        gained.append(result.outputs["most"] - result.outputs["least"])
    assert errors[-1] < 1e-4
    assert _order(np.array(errors)) > 1.9
    assert _order(np.array(gained)) > 1.9


GRIPPER = """
coordinates: {z: {start: 0.36}, p: {start: 0.35}}
bodies:
  carriage: {mass: 1, position: [0, z]}
  left: {mass: 0.2, position: ["-0.08 - 0.2*sin(p)", "z - 0.2*cos(p)"], PAD}
  right: {mass: 0.2, position: ["0.08 + 0.2*sin(p)", "z - 0.2*cos(p)"], PAD}
  box:
    mass: 0.5
    inertia: 0.5*0.2**2/6
    start: {y: 0.1}
    shape: {polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}
surfaces: {floor: {line: [[0, 0], [1, 0]]}}
collisions:
  left: {bodies: [left, box], friction: 0.8, restitution: 0}
  right: {bodies: [right, box], friction: 0.8, restitution: 0}
  floor: {bodies: [box], surfaces: [floor], friction: 0.5, restitution: 0}
forces:
  left: {body: left, force: [SQUEEZE, 0]}
  right: {body: right, force: [-SQUEEZE, 0]}
  lift:
    body: carriage
    force: [0, "400*(0.36 + 0.2*min(max(time - 0.4, 0), 1) - z) - 60*dz + 19"]
""".replace("PAD", "shape: {polygon: [[-0.01, -0.06], [0.01, -0.06], [0.01, 0.06], [-0.01, 0.06]]}")


@pytest.mark.parametrize(("squeeze", "lifts"), [(20, True), (2, False)])
def test_a_four_bar_gripper_lifts_up_to_the_friction_limit(squeeze: float, lifts: bool) -> None:
    result = _run(GRIPPER.replace("SQUEEZE", str(squeeze)), 4.0)
    found, mode = (
        _final(result),
        dict(zip(result.trace.regions, result.trace.final_mode, strict=True)),
    )
    assert (found["box.x"], found["box.angle"]) == pytest.approx((0.0, 0.0), abs=1e-9)
    if lifts:
        # 2 mu N = 32 N hold the box, of 4.9 N. The lift is a spring that bears all of it.
        assert found["z"] == pytest.approx(0.56 + (19 - 1.9 * G) / 400, abs=1e-6)
        height = found["z"] - 0.2 * math.cos(found["p"])
        assert mode["box"] == "pin"
        assert found["box.y"] - height == pytest.approx(-0.065, abs=1e-3)
        # Pads are as deep as they came in a step.
        assert found["p"] == pytest.approx(math.asin(0.03 / 0.2), abs=6e-3)
    else:
        assert found["box.y"] == pytest.approx(0.1, abs=1e-6)


def test_a_pendulum_rebounds_from_a_wall() -> None:
    text = """
coordinates: {t: {start: 1}}
bodies:
  bob: {mass: 2, inertia: 0.1, position: [sin(t), -cos(t)], angle: t, shape: {disc: 0.1}}
surfaces: {wall: {line: [[-0.1, 0], [-0.1, -1]]}}
collisions: {all: {bodies: [bob], surfaces: [wall], friction: 0, restitution: 0.5}}
"""

    def swings(t: float, y: Array) -> Array:
        return np.array([y[1], -2 * G * math.sin(y[0]) / 2.1])

    def down(t: float, y: Array) -> float:
        return float(y[0])

    down.terminal = True  # type: ignore[attr-defined]
    fall = solve_ivp(swings, (0, 2), [1.0, 0.0], events=down, rtol=1e-11, atol=1e-12)
    back = [0.0, -0.5 * fall.y[1, -1]]
    exact = solve_ivp(swings, (fall.t[-1], 0.9), back, rtol=1e-11, atol=1e-12).y[:, -1]
    errors = []
    for h in (4e-3, 2e-3, 1e-3, 5e-4):
        result = _run(text, 0.9, step=h)
        jump = result.trace.jumps[0]
        assert (jump.region, jump.t) == ("bob", pytest.approx(fall.t[-1], abs=h))
        found = _final(result)
        errors.append(abs(found["t"] - exact[0]) + abs(found["dt"] - exact[1]))
    assert errors[-1] < 5e-3
    assert errors[-1] < 0.5 * errors[0]


def test_two_mechanisms_strike_each_other() -> None:
    text = """
coordinates: {t: {start: 1}, s: {}}
bodies:
  one: {mass: 2, position: [sin(t), 2 - cos(t)], shape: {disc: 0.1}}
  two: {mass: 2, position: [sin(s) - 0.2, 2 - cos(s)], shape: {disc: 0.1}}
collisions: {all: {bodies: [one, two], friction: 0, restitution: 1}}
"""
    result = _run(text, 0.8, step=5e-4)
    found = _final(result)
    assert [jump.region for jump in result.trace.jumps] == ["one"]
    assert (found["t"], found["dt"]) == pytest.approx((0.0, 0.0), abs=5e-3)
    top = 2 * G * (math.cos(found["s"]) - math.cos(1.0))
    assert found["ds"] == pytest.approx(-math.sqrt(top), abs=5e-3)


@pytest.mark.parametrize(("place", "rebound"), [("v", 0.5), ("u", 0.0)])
def test_impacts_are_together_where_bodies_share_a_coordinate(place: str, rebound: float) -> None:
    text = f"""
coordinates: {{u: {{start: 1}}, v: {{start: 1}}}}
bodies:
  one: {{mass: 2, position: [0, u], shape: {{disc: 0.1}}}}
  two: {{mass: 1, position: [2, {place}], shape: {{disc: 0.1}}}}
  three: {{mass: 1, position: [4 + v, 9], shape: {{disc: 0.1}}}}
{FLOOR}
collisions: {{all: {{bodies: [one, two], surfaces: [floor], friction: 0, restitution: 0.5}}}}
simultaneous: plastic
"""
    struck = math.sqrt(2 * 0.9 / G)
    found = _final(_run(text, struck + 0.05, step=2.5e-4))
    speed = rebound * G * struck - (0.05 * G if rebound else 0.0)
    assert found["du"] == pytest.approx(speed, abs=1e-2)


def test_controllers_turn_a_mechanism() -> None:
    text = (
        RAM.replace("force: [10, 0]", "force: [push, 0]")
        + """
controls: {push: 10}
regions:
  motor:
    initial: push
    states: {push: {}, back: {sets: {push: -10}}}
    transitions: [{name: turn, from: push, to: back, guard: ram.x > 0.5}]
stop: {conditions: {far: s < -0.3}}
outputs: {turned: {value: time, at: first motor.turn}}
"""
    )
    result = _run(text, 3.0, step=5e-4)
    struck = math.sqrt(0.08)
    speed, pushed = 10 / 2 * struck * 2 / 3, (10 - 0.2 * G) / 3
    until = struck + (math.sqrt(speed**2 + 2 * pushed * 0.3) - speed) / pushed
    assert result.outputs["turned"] == pytest.approx(until, abs=5e-3)
    assert result.trace.outcome is Outcome.STOPPED
    assert _final(result)["s"] == pytest.approx(-0.3, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "push: {",
            "b: {bodies: [box], friction: 0, restitution: 2}\n  push: {",
            "between 0 and 1",
        ),
        ("coordinates: {s: {}}", "coordinates: {s: {}, k: {}}", "it moves no body"),
        ("[s, 0.5]", "[s, 0.5], copies: 2", "all be in one place"),
        ("position: [s, 0.5]", "position: [s + 0.3, 0.5]", "deep in body 'ram'"),
        ("position: [s, 0.5]", "position: [s**3, 0.5]", "no inertia at the start"),
        (
            "forces:",
            "joints: {j: {point: {body: box, at: [0, 0]}, to: {body: ram, at: [1.2, -0.1]}}}\n"
            "forces:",
            "place the other body by coordinates",
        ),
        (
            "forces:",
            "contacts: {c: {point: {body: box, at: [0, 0]}, surface: floor, friction: 0, "
            "restitution: 0}}\nforces:",
            "touch by their shapes",
        ),
    ],
)
def test_scenes_that_cannot_mix_are_refused(old: str, new: str, words: str) -> None:
    assert old in RAM
    with pytest.raises(DeclarationError, match=words):
        _run(RAM.replace(old, new))


def test_stiff_forces_on_coordinates_are_refused() -> None:
    for force in ('"-1e8*(ram.x - 0.1)"', '"-1e5*(ds - 1)"', '"-1e8*s"'):
        result = _run(RAM.replace("force: [10, 0]", f"force: [{force}, 0]"), throw=False)
        assert result.trace.outcome is Outcome.STEP_TOO_LARGE
    # A force along a rod turns it: 2e6 N at a length of 1 swing 2 kg at 1000 radians a second.
    text = """
coordinates: {t: {}}
bodies: {bob: {mass: 2, position: [sin(t), -cos(t)], shape: {disc: 0.1}}}
surfaces: {wall: {line: [[-2, 0], [-2, -1]]}}
collisions: {all: {bodies: [bob], surfaces: [wall], friction: 0, restitution: 0.5}}
forces: {down: {body: bob, force: [0, -FORCE]}}
"""
    for force, outcome in (("2e6", Outcome.HORIZON), ("2e7", Outcome.STEP_TOO_LARGE)):
        result = _run(text.replace("FORCE", force), 0.01, throw=False)
        assert result.trace.outcome is outcome


@pytest.mark.parametrize("text", [RAM, BY_COORDINATES, GRIPPER.replace("SQUEEZE", "20")])
def test_scene_passes_all_properties(text: str) -> None:
    model = _scene(text + ("" if "stop:" in text else "stop: {time: 0.8}\n"))
    subject = Subject(model)
    for item in body_properties(model):
        item.holds(subject.case({}))


def test_masses_beyond_1e40_move_like_masses_of_kilograms() -> None:
    heavy = RAM.replace("mass: 2", "mass: 2e50").replace(
        "mass: 1, inertia: 1", "mass: 1e50, inertia: 1e50"
    )
    heavy = heavy.replace("force: [10, 0]", "force: [10e50, 0]")
    assert _final(_run(heavy)) == pytest.approx(_final(_run(RAM)), rel=1e-9, abs=1e-9)
