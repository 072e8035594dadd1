"""Equations of a mode equal handwritten ones, and the integrated ones."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from runs import automaton

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import roles_in
from statechart.automaton.modes import build_mode
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.reporting.equations import EquationBlock, blocks, format_equations, mode_named
from statechart.running.runner import Runner


def shown(model: str, mode: str, form: str = "text") -> str:
    built = automaton(model)
    return format_equations(built, built.setup({}, 1e-12), mode, form)


def test_the_hinge_phase_is_that_of_the_paper() -> None:
    assert shown("toppling_stick", "pin") == (
        "toppling_stick, tip:pin\n"
        "eliminated:\n"
        "  stick.x = -L*sin(stick.angle) + tip.x0\n"
        "  stick.y = L*cos(stick.angle) + tip.y0\n"
        "motion:\n"
        "  stick.angle''*(I_G + L**2*M) = L*M*g*sin(stick.angle)\n"
        "forces:\n"
        "  tip.H = L*M*(stick.angle'**2*sin(stick.angle) - stick.angle''*cos(stick.angle))\n"
        "  tip.V = M*(-L*(stick.angle'**2*cos(stick.angle) + stick.angle''*sin(stick.angle)) + g)\n"
    )


def test_the_slide_phase_is_that_of_the_paper() -> None:
    found = shown("toppling_stick", "slide-").splitlines()
    assert "  stick.y = L*cos(stick.angle)" in found
    assert "  M*stick.x'' = tip.H" in found
    # Its friction opposes the slip, erratum 3.
    assert "  tip.H = mu*tip.V" in found
    assert "  tip.H = -mu*tip.V" in shown("toppling_stick", "slide+").splitlines()


def test_forces_of_a_block_at_rest_on_a_slope_match_those_by_hand() -> None:
    # For a unit mass V = g cos(alpha), H = g sin(alpha).
    _, _, found = shown("block_on_incline", "pin").partition("forces:\n")
    assert found == "  base.H = base.V*tan(alpha)\n  base.V = g*cos(alpha)\n"


def test_latex_has_greek_angles_and_dots() -> None:
    found = shown("toppling_stick", "pin", "latex")
    assert (
        r"\ddot{\theta} \left(M L^{2} + I_{G}\right) &= M g L \sin{\left(\theta \right)}" in found
    )
    assert found.count(r"\begin{align*}") == found.count(r"\end{align*}") == 3
    assert r"x_{0,\mathrm{foot one}}" in shown(
        "compass_walker", "foot_one:pin foot_two:off", "latex"
    )


def test_json_has_the_equations_as_texts() -> None:
    found = json.loads(shown("toppling_stick", "pin", "json"))
    assert found["mode"] == {"tip": "pin"}
    assert found["motion"] == ["stick.angle''*(I_G + L**2*M) = L*M*g*sin(stick.angle)"]


def test_a_chart_has_the_rates_of_its_variables() -> None:
    assert "  x' = v" in shown("bouncing_ball_chart", "flight").splitlines()


CASES = [
    ("toppling_stick", "tip:slide+"),
    ("compass_walker", "foot_one:pin foot_two:off"),
    ("compass_walker", "foot_one:slide- foot_two:off"),
    ("rocking_block", "left:free right:pin"),
    ("sliding_ladder", "foot:slide- top:slide+"),
    ("double_contact_bar", "A:pin B:free"),
    ("painleve_rod", "tip:slide-"),
    ("simplest_walker", None),
    ("hopper", None),
    ("block_on_incline", "base:pin"),
    ("stick_slip_block", "base:pin"),
]


BEAD = """\
kind: scene
name: bead
gravity: 9.81
bodies: {bead: {mass: 1.3}}
surfaces: {hill: {height: 0.1*sin(2.2*x)}}
contacts: {base: {point: {body: bead}, surface: hill, modes: [slide, pin], friction: 0.35}}
forces: {wind: {body: bead, force: [-3.7*bead.x - 0.1*bead.dx, 1e-6*time]}}
stop: {time: 1}
"""


def test_terms_that_cancel_leave_no_round_off() -> None:
    # 1e-6*time*(1 - cos^2 - sin^2), with factors in decimals, was left as 6.6e-24*time.
    built = Runner(read_text(BEAD)).automaton
    for named in ("base:pin", "base:slide+", "base:slide-"):
        numbers = [
            abs(float(number))
            for block in blocks(built, mode_named(built, named), frozenset())
            for sides in block.equations
            for side in sides
            for number in side.atoms(sp.Float)
        ]
        assert min(numbers) >= 1e-7


@pytest.mark.parametrize(("model", "named"), [*CASES, (BEAD, "base:pin"), (BEAD, "base:slide+")])
def test_integrated_motion_satisfies_the_printed_equations(model: str, named: str | None) -> None:
    built = Runner(read_text(model)).automaton if "kind: " in model else automaton(model)
    key = tuple(region.states[0] for region in built.regions)
    key = key if named is None else mode_named(built, named)
    setup = built.setup({}, 1e-12)
    mode = build_mode(built, roles_in(key), frozenset())
    made = blocks(built, key, frozenset(built.parameters[i] for i in setup.zeros))
    # Random states need not satisfy the other constraints.
    shown = [block for block in made if block.title != "held"]
    rows = [left - right for block in shown for left, right in block.equations]
    assert rows
    told_of = [left for block in shown for left, _ in block.equations if left.is_Symbol]
    assert len(told_of) == len({*told_of})
    random = np.random.default_rng(1)
    values = dict(zip(built.parameters, setup.values.tolist(), strict=True))
    state = random.uniform(-0.7, 0.7, len(built.variables))
    if built.coordinates is not None:
        state = _on(built, made, state, values)
    values |= dict(zip(built.variables, state.tolist(), strict=True)) | {built.time: 0.3}
    for symbol, value in mode.definitions:
        values[symbol] = float(value.xreplace(values))
    for row in rows:
        anchors = {s: 0.0 for s in row.free_symbols if s.name.endswith(("x0", "y0"))}
        found = [float(term.xreplace({**anchors, **values})) for term in sp.Add.make_args(row)]
        assert sum(found) == pytest.approx(0.0, abs=1e-9 * max(1.0, *map(abs, found)))


def _on(
    built: Automaton, made: list[EquationBlock], state: Array, values: dict[sp.Symbol, float]
) -> Array:
    """Substitute the eliminated variables, with anchors at zero."""
    assert built.coordinates is not None
    known = dict(zip(built.variables, state.tolist(), strict=True))
    for block in made:
        if block.title == "eliminated":
            for symbol, place in block.equations:
                anchors = {s: 0.0 for s in place.free_symbols if s.name.endswith(("x0", "y0"))}
                place = sp.sympify(place.xreplace(anchors))
                rate = built.coordinates.rate(place).xreplace(values)
                known[symbol] = float(place.xreplace(values).xreplace(known))
                follows = built.coordinates.positions.index(symbol)
                known[built.coordinates.rates[follows]] = float(rate.xreplace(known))
    return np.array([known[v] for v in built.variables])


def test_wrong_mode_names_are_refused_with_known_states() -> None:
    bar = automaton("double_contact_bar")
    with pytest.raises(DeclarationError, match="no state of B"):
        mode_named(bar, "A:pin")
    with pytest.raises(DeclarationError, match="there is no state 'A:pim'"):
        mode_named(bar, "A:pim B:free")


def test_equations_verb_prints_equations(capsys: pytest.CaptureFixture[str]) -> None:
    path = "toppling_stick"
    assert main(["modes", path, "--equations", "pin", "--latex"]) == 0
    assert re.search(r"% motion\n\\begin{align\*}", capsys.readouterr().out)


def test_printed_numbers_have_seven_digits_and_no_zeros_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bead.yaml"
    path.write_text(
        "kind: scene\nname: bead\ngravity: 9.80665123\nbodies: {bead: {mass: 1.23456789}}\n"
        "surfaces: {hill: {height: 0.1*sin(2.2*x)}}\nstop: {time: 1}\n"
        "contacts: {base: {point: {body: bead}, surface: hill, modes: [pin]}}\n"
    )
    numbers = re.compile(r"(?<![\w.])\d+\.?\d*")
    for more, most in (((), 7), (("--digits", "3"), 3), (("--json",), 17)):
        assert main(["modes", str(path), "--equations", "base:pin", *more]) == 0
        printed = numbers.findall(capsys.readouterr().out)
        digits = [len(number.replace(".", "").lstrip("0")) for number in printed]
        assert (most - 3 if most == 17 else most) <= max(digits) <= most
        assert not any("." in n and n.endswith("0") for n in printed if most == 7)


@pytest.mark.parametrize(
    "options",
    [
        ("--latex",),
        ("--equations", "pin", "--latex", "--json"),
        ("--equations", "pin", "--until", "1"),
        ("--equations", "pin", "--at", "stick.angle=0.1"),
    ],
)
def test_the_verb_refuses_options_that_it_would_ignore(
    options: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["modes", "toppling_stick", *options]) == 2
    reported = capsys.readouterr()
    assert reported.out == ""
    assert "--equations" in reported.err or "--latex" in reported.err
