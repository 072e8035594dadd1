"""Joints that ask for contacts start as their relations are at the start, against closed forms."""

from __future__ import annotations

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret

# A slider with friction 0.2 and a body that floats: both move at 2 m/s, or as the parameters say.
_PAIR = """
kind: scene
name: pair
gravity: 10
parameters: {v: 2, w: 2}
bodies: {a: {mass: 1, start: {dx: v}}, b: {mass: 1, start: {x: 5, y: 3, dx: w}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: a}, surface: floor, friction: 0.2, restitution: 0}}
joints:
  j: {point: {body: b}, to: {body: a}, rest: captured, enabled: RELATION}
forces: {up: {body: b, force: [0, 10]}}
stop: {time: 0.9}
outputs: {a: {value: a.x}, b: {value: b.x - 5}}
"""
_TOGETHER = (1.8 - 0.5 * 0.81, 1.8 - 0.5 * 0.81)  # Friction brakes both masses.
_APART = (1.8 - 0.81, 1.8)
_ENGINES = pytest.mark.parametrize(
    "setting", [{"engine": "taylor"}, {"engine": "scipy"}, {"engine": "impulse", "step": 1e-3}]
)


def _started(text: str, setting: dict[str, object], **values: float) -> statechart.Result:
    return statechart.Runner(interpret(read_text(text, "pair.yaml")), **setting).run(values)


@_ENGINES
@pytest.mark.parametrize(
    "relation",
    ["in(c.pin)", "not in(c.slide+)", "in(c.free)", "c.slip > 3", "c.gap > 1", "c.V > 11"],
)
def test_a_joint_starts_off_if_its_relation_on_a_contact_fails(
    relation: str, setting: dict[str, object]
) -> None:
    result = _started(_PAIR.replace("RELATION", relation), setting)
    assert result.trace.start_mode == ("slide+", "off")
    assert not result.trace.jumps
    assert list(result.outputs.values()) == pytest.approx(_APART, abs=1e-9)
    # The joint could not be closed on bodies that move apart.
    apart = _started(_PAIR.replace("RELATION", relation), setting, w=1)
    assert apart.trace.start_mode == ("slide+", "off")
    assert list(apart.outputs.values()) == pytest.approx((0.99, 0.9), abs=1e-9)


@_ENGINES
@pytest.mark.parametrize("relation", ["in(c.slide+)", "not in(c.pin)", "c.slip < 3", "c.V > 9"])
def test_a_joint_starts_closed_if_its_relation_on_a_contact_holds(
    relation: str, setting: dict[str, object]
) -> None:
    result = _started(_PAIR.replace("RELATION", relation), setting)
    assert result.trace.start_mode == ("slide+", "closed")
    assert not result.trace.jumps
    assert list(result.outputs.values()) == pytest.approx(_TOGETHER, abs=1e-9)
    with pytest.raises(DeclarationError, match="joint 'j' does not hold at the start"):
        _started(_PAIR.replace("RELATION", relation), setting, w=1)


@_ENGINES
def test_each_run_of_a_sweep_judges_its_own_start(setting: dict[str, object]) -> None:
    runner = statechart.Runner(
        interpret(read_text(_PAIR.replace("RELATION", "in(c.pin)"))), **setting
    )
    starts = [runner.run({"v": v, "w": v}).trace.start_mode for v in (2.0, 0.0, 1.0)]
    assert starts == [("slide+", "off"), ("pin", "closed"), ("slide+", "off")]


@_ENGINES
@pytest.mark.parametrize("last", [True, False])
def test_joints_that_depend_on_each_other_start_the_same_in_any_order(
    last: bool, setting: dict[str, object]
) -> None:
    other = "  k: {point: {body: b}, to: {y: 3}, enabled: in(j.off)}\n"
    text = _PAIR.replace("RELATION", "in(c.pin)")
    text = (
        text.replace("forces:", other + "forces:")
        if last
        else text.replace("joints:\n", "joints:\n" + other)
    )
    result = _started(text, setting)
    start = dict(zip(result.trace.regions, result.trace.start_mode, strict=True))
    assert start == {"c": "slide+", "j": "off", "k": "closed"}
    assert not result.trace.jumps


@_ENGINES
def test_a_joint_that_its_own_force_breaks_at_the_start_breaks_in_an_event(
    setting: dict[str, object],
) -> None:
    # Braking both bodies the joint bears 1 N.
    result = _started(_PAIR.replace("RELATION", "in(c.pin) or j.X**2 < 0.5"), setting)
    (jump,) = result.trace.jumps
    assert (result.trace.start_mode[1], jump.target[1]) == ("closed", "broken")
    assert jump.t <= 2e-3


def test_a_joint_of_bodies_with_shapes_that_asks_for_a_closed_one_starts_off() -> None:
    text = """
kind: scene
name: glued
gravity: 10
bodies:
  box: {mass: 1, inertia: 0.1, shape: {disc: 0.2}, start: {y: 1}}
  bead: {mass: 1, inertia: 0.1, shape: {disc: 0.1}, start: {x: 2, y: 1, dx: 1}}
surfaces: {floor: {height: 0}}
collisions: {all: {bodies: [box, bead], surfaces: [floor], friction: 0.2, restitution: 0}}
joints: {glue: {point: {body: bead}, to: {body: box}, rest: captured, enabled: in(box.slide)}}
stop: {time: 0.2}
settings: {step: 1e-3}
outputs: {x: {value: bead.x}}
"""
    result = _started(text, {})
    assert result.trace.start_mode[-1] == "off"
    assert not result.trace.jumps
    assert result.outputs["x"] == pytest.approx(2.2, abs=1e-9)
    together = text.replace("in(box.slide)", "in(box.free)").replace(
        "start: {y: 1}", "start: {y: 1, dx: 1}"
    )
    assert _started(together, {}).trace.start_mode[-1] == "closed"


_TETHER = """
kind: scene
name: tether
gravity: 9.81
bodies: {load: {mass: 2, start: {dx: 1}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: load}, surface: floor, friction: 0.4, restitution: 0}}
joints: {cord: {point: {body: load}, to: [0, 0.1], rope: 0.5, enabled: in(c.pin)}}
forces: {pull: {body: load, force: ["10*time", 0]}}
stop: {time: 1}
"""


@_ENGINES
def test_a_rope_is_on_while_a_contact_sticks(setting: dict[str, object]) -> None:
    result = _started(_TETHER, setting)
    assert result.trace.start_mode == ("slide+", "off", "off")
    # The load stops where 1 - mu g t + 10 t**2 / (2 m) = 0, and slips where 10 t = mu m g.
    stop = (3.924 - (3.924**2 - 10) ** 0.5) / 5
    within = 3e-3 if setting["engine"] == "impulse" else 1e-9
    times = {jump.cause: jump.t for jump in result.trace.jumps if jump.region == "cord_closed"}
    assert times == {
        "enable": pytest.approx(stop, abs=within),
        "disable": pytest.approx(0.7848, abs=within),
    }


def test_a_coupling_cannot_ask_for_a_state_of_a_rope() -> None:
    text = _TETHER.replace("mass: 2,", "mass: 2, inertia: 1,").replace(", enabled: in(c.pin)", "")
    text += "couplings: {rub: {bodies: [load], limit: 1, enabled: in(cord.slide)}}\n"
    with pytest.raises(DeclarationError, match="a rope, which `enabled` cannot; write in"):
        interpret(read_text(text))
