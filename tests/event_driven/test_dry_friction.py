"""Dry friction written as -F*sign(v): against contacts, closed forms and time steps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contacts.scene.scene import Scene
from statechart.automaton.trace import Trace
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import run

engines = pytest.mark.parametrize("engine", ["taylor", "scipy"])
MU, MASS, G = 0.2, 2.0, 9.81
BLOCK = f"""\
kind: scene
name: block
gravity: {G}
parameters: {{k: 3}}
bodies: {{b: {{mass: {MASS}, start: {{x: 1}}}}}}
surfaces: {{floor: {{line: [[0, 0], [1, 0]]}}}}
contacts:
  c: {{point: {{body: b}}, surface: floor, friction: 0, modes: [slide]}}
controls: {{u: 0}}
regions: {{r: {{initial: on, states: {{on: {{sets: {{u: -{MU * MASS * G!r}*sign(b.dx)}}}}}}}}}}
forces: {{f: {{body: b, force: [-k*b.x + 6*sin(2*time) + u, 0]}}}}
outputs: {{way: {{integral: abs(b.dx)}}, heat: {{integral: u*b.dx}}}}
stop: {{time: 12}}
"""
CONTACT = BLOCK.replace("friction: 0, modes: [slide]", f"friction: {MU}, modes: [slide, pin]")
CONTACT = CONTACT.replace(" + u,", ",")
PUSHED = """\
kind: scene
name: pushed
gravity: 0
bodies:
  a: {mass: 1, start: {x: -0.1, y: 0}}
  b: {mass: 2, start: {x: 0, y: 0}}
surfaces: {face: {body: b, line: [[-0.05, -1], [-0.05, 1]]}}
contacts:
  ab: {point: {body: a}, surface: face, friction: 0, restitution: 0, modes: [free, slide]}
forces:
  push: {body: a, force: [2 + time, 0]}
  drag: {body: b, force: [-5*sign(b.dx), 0]}
stop: {time: 4}
"""


def scene(text: str) -> Scene:
    return validate(read_text(text), Scene)


def shares(drag: float | str, friction: float, force: str = "") -> Scene:
    """Return a pushed block on a floor with friction, and a force."""
    rest = f"drag: {{body: b, force: [{force or drag}, 0]}}" if drag else ""
    return scene(f"""\
kind: scene
name: both
gravity: {G}
bodies: {{b: {{mass: {MASS}, start: {{dx: 1}}}}}}
surfaces: {{floor: {{line: [[0, 0], [1, 0]]}}}}
contacts: {{c: {{point: {{body: b}}, surface: floor, friction: {friction!r}, restitution: 0}}}}
controls: {{u: 0}}
regions: {{r: {{initial: on, states: {{on: {{sets: {{u: {drag}}}}}}}}}}}
forces: {{push: {{body: b, force: [9*sin(3*time), 0]}}, {rest}}}
stop: {{time: 6}}
""")


def starts(trace: Trace) -> list[float]:
    return [arc.start.high for arc in trace.arcs[1:]]


def final(trace: Trace) -> dict[str, float]:
    return dict(zip(trace.variables, trace.final.tolist(), strict=True))


@engines
def test_a_sign_in_a_force_is_friction_of_a_contact(engine: str) -> None:
    written, declared = run(scene(BLOCK), engine=engine), run(scene(CONTACT), engine=engine)
    assert len(starts(written.trace)) == 11
    # A contact sticks until its force is beyond the cone by 1e-12 of its scale.
    assert starts(written.trace) == pytest.approx(starts(declared.trace), abs=5e-12)
    assert written.trace.final == pytest.approx(declared.trace.final, abs=1e-12)
    assert written.trace.certified
    assert not written.trace.jumps
    assert written.outputs["way"] == pytest.approx(declared.outputs["way"], abs=1e-10)
    assert written.outputs["heat"] == pytest.approx(-MU * MASS * G * written.outputs["way"])


@engines
def test_friction_holds_a_body_up_to_its_limit(engine: str) -> None:
    trace = run(scene(PUSHED), engine=engine).trace
    # t^2 + t^3/6 = 0.05; a plastic impact; 3 dv/dt = 2 + t - 5; rest until the push is 5.
    struck = next(
        root.real for root in np.roots([1 / 6, 1, 0, -0.05]) if root.imag == 0 and root.real > 0
    )
    v = (2.0 * struck + struck**2 / 2.0) / 3.0
    rest = 3.0 - math.sqrt((3.0 - struck) ** 2 - 6.0 * v)
    assert starts(trace) == pytest.approx([struck, rest, 3.0], abs=1e-11)
    assert [jump.cause for jump in trace.jumps] == ["touchdown"]
    assert final(trace)["b.dx"] == pytest.approx(1.0 / 6.0, abs=1e-11)
    assert trace.certified


@pytest.mark.parametrize(("text", "way"), [(BLOCK, 2e-4), (PUSHED, 2e-3)])
def test_steps_hold_at_rest_and_tend_to_the_run_with_events(text: str, way: float) -> None:
    exact = run(scene(text), engine="taylor").trace
    errors = []
    for step in (4e-3, 1e-3):
        trace = run(scene(text), engine="impulse", step=step).trace
        errors.append(float(np.abs(trace.final - exact.final).max()))
    assert errors[1] < max(0.5 * errors[0], 1e-5)
    assert errors[1] < way


def test_steps_stand_still_under_a_push_below_friction() -> None:
    text = BLOCK.replace("x: 1}", "x: 0.5}").replace("6*sin(2*time)", "sin(2*time)")
    result = run(scene(text), engine="impulse", step=1e-2)
    assert np.abs(result.trace.final - [0.5, 0.0, 0.0, 0.0]).max() < 1e-14
    # The control holds the block.
    assert result.outputs["way"] < 1e-12


@engines
@pytest.mark.parametrize("drag", [0.4, 2.5, 6.0])
@pytest.mark.parametrize("force", ["", "u"])
def test_sign_and_contact_share_their_limits(engine: str, drag: float, force: str) -> None:
    both = run(shares(f"-{drag}*sign(b.dx)", MU, force), engine=engine).trace
    alone = run(shares(0, MU + drag / (MASS * G)), engine=engine).trace
    assert [jump.cause for jump in both.jumps] == [jump.cause for jump in alone.jumps]
    assert [jump.t for jump in both.jumps] == pytest.approx([j.t for j in alone.jumps], abs=1e-11)
    assert both.final == pytest.approx(alone.final, abs=1e-11)
    assert both.certified


@pytest.mark.parametrize("push", [0.5, 1.5])
def test_the_smallest_forces_of_a_contact_and_a_sign_are_shown(push: float) -> None:
    text = BLOCK.replace("friction: 0, modes: [slide]", f"friction: {MU}, modes: [slide, pin]")
    text = text.replace("-k*b.x + 6*sin(2*time) + u", f"{push} - 0.5*sign(b.dx)")
    text = text.replace("outputs: {", "outputs: {H: {value: c.H}, ")
    result = run(scene(text), engine="taylor")
    # Equal springs share, until the sign is at its limit.
    assert result.outputs["H"] == pytest.approx(-max(push / 2, push - 0.5), abs=1e-12)
    assert "the forces of c, sign(b.dx) are indeterminate" in " ".join(result.warnings)
