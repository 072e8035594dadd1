"""A motion that needs a mode which a contact does not list: refused, or ended, in words."""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import examples

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.trace import Outcome
from statechart.cli.main import main
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.engines.scipy import SciPy
from statechart.errors import DeclarationError, DeclarationProblem
from statechart.execution.simulator import Simulator
from statechart.running.runner import Runner

BLOCK = """\
kind: scene
name: block
gravity: 9.81
bodies: {b: {mass: 1, start: {dx: 1}}}
surfaces: {s: {incline: -20*pi/180}}
contacts:
  p: {point: {body: b}, surface: s, modes: [slide, pin], friction: 0.3}
stop: {time: 0.5}
"""
LEAVES = "contact 'p' starts leaving its surface at 0.34202, and free is not among its modes"
LISTS = tuple(m for r in (1, 2, 3) for m in combinations(("free", "slide", "pin"), r))


@pytest.mark.parametrize(
    "verb", [["validate"], ["run"], ["run", "--engine", "scipy"],
             ["run", "--engine", "impulse", "--step", "0.01"]],
)  # fmt: skip
def test_every_verb_refuses_a_start_that_leaves_for_an_unlisted_mode(
    verb: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "block.yaml"
    path.write_text(BLOCK)
    assert main([verb[0], str(path), *verb[1:]]) == 2
    assert f"{path}:7:44: contacts.p.modes: {LEAVES}; add free" in capsys.readouterr().err


def test_a_start_into_the_surface_strikes_it_though_the_point_is_never_free() -> None:
    block = Simulator(automaton(scene(("slide", "pin"), None, "incline: a")), SciPy(1e-12))
    a, mu = 0.3, 0.5
    trace = block.run({"a": a, "v": 1.0, "mu": mu}, until=0.5)
    assert "free" not in {mode for (mode,) in trace.modes}
    strike, stick = trace.jumps
    slip = math.cos(a) - mu * math.sin(a)
    assert strike.cause == "touchdown"
    assert strike.after[2:] == pytest.approx([slip * math.cos(a), slip * math.sin(a)], abs=1e-12)
    assert stick.t == pytest.approx(slip / (9.81 * (math.sin(a) + mu * math.cos(a))), abs=1e-9)


def test_a_point_that_may_only_be_pinned_does_not_start_slipping() -> None:
    with pytest.raises(DeclarationError, match="starts slipping at 1, and slide is not among"):
        Runner(scene(("pin",), None, "height: 0")).start({"v": 1.0})


def test_a_point_that_leaves_an_edge_must_list_free() -> None:
    with pytest.raises(DeclarationError, match="a contact that can be off comes back as free"):
        scene(("slide", "pin"), None, "edge: [[-1, 0], [0.5, 0]]")


def contact(name: str, at: float, modes: tuple[str, ...]) -> str:
    friction = ", friction: mu" if "slide" in modes else ""
    restitution = ", restitution: e" if "free" in modes else ""
    listed = ", ".join(modes)
    return (
        f"  {name}: {{point: {{body: b, at: [{at}, 0]}}, surface: s, "
        f"modes: [{listed}]{friction}{restitution}}}\n"
    )


@cache
def scene(left: tuple[str, ...], right: tuple[str, ...] | None, surface: str) -> Scene:
    text = BLOCK[: BLOCK.index("bodies")].replace(
        "gravity", "parameters: {a: 0, v: 0, u: 0, w: 0, mu: 0.5, e: 0.5, h: 0}\ngravity"
    )
    turns = ("inertia: 0.1, ", ", angle: a, dangle: w") if right else ("", "")
    text += f"bodies: {{b: {{mass: 1, {turns[0]}start: {{y: h, dx: v, dy: u{turns[1]}}}}}}}\n"
    text += f"settings: {{max_jumps: 500}}\nsurfaces: {{s: {{{surface}}}}}\ncontacts:\n"
    text += contact("p", -0.3 if right else 0.0, left)
    return validate(read_text(text + (contact("q", 0.3, right) if right else "")), Scene)


@cache
def simulator(left: tuple[str, ...], right: tuple[str, ...] | None, surface: str) -> Simulator:
    return Simulator(automaton(scene(left, right, surface)), SciPy(1e-10))


starts = st.fixed_dictionaries(
    {
        "a": st.sampled_from((0.0, 0.3, -0.3)),
        "v": st.sampled_from((0.0, 1.0, -1.0)),
        "u": st.sampled_from((0.0, 0.0, 1.0, -1.0)),
        "w": st.sampled_from((0.0, 1.0, -1.0)),
        "mu": st.sampled_from((0.1, 0.5, 1.5)),
        "e": st.sampled_from((0.0, 0.5)),
        "h": st.sampled_from((0.0, 0.0, 0.1)),
    }
)


@examples(25)
@given(st.sampled_from(LISTS), st.sampled_from((None, *LISTS)), starts)
def test_no_run_takes_a_mode_that_is_not_listed(
    left: tuple[str, ...], right: tuple[str, ...] | None, start: dict[str, float]
) -> None:
    built = simulator(left, right, "incline: a")
    try:
        trace = built.run(start, until=0.3, throw=False)
    except DeclarationProblem:
        with pytest.raises(DeclarationError):
            Runner(scene(left, right, "incline: a")).start(start)
        return
    taken = zip(*trace.modes, strict=True)
    for region, states in zip(built.automaton.regions, taken, strict=True):
        assert set(states) <= set(region.states)
    if trace.outcome is Outcome.NO_CONSISTENT_MODE:
        assert "among its modes" in trace.message or "may not slip" in trace.message
    else:
        assert trace.outcome in (Outcome.HORIZON, Outcome.TOO_MANY_JUMPS)
