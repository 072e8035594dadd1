"""Kinks in forces, angles in degrees, lengths between parameters."""

from __future__ import annotations

import pytest

from contacts.scene.scene import Scene
from statechart.charts.chart import Chart
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.running.runner import run

FORCED = """\
kind: scene
name: forced
gravity: 0
parameters: {c: 1, l: 2}
bodies: {b: {mass: 1, start: {dx: 1}}}
controls: {push: 0}
regions:
  r:
    initial: s
    states: {s: {sets: {push: 0.5}}}
forces: {f: {body: b, force: [-c*b.dx, 0]}}
outputs: {least: {minimum: "min(b.x, 0)"}}
stop: {time: 1, conditions: {far: abs(b.x) >= 3}}
"""


@pytest.mark.parametrize(
    ("old", "new", "moved"),
    [
        # dx = 1 - t until .5, and x = 3/8 there.
        ("-c*b.dx,", "'-2*c*sign(b.dx)',", ("b.x", 0.25)),
        ("[-c*b.dx, 0]", "[0, 'max(0, b.x - 0.5)']", ("b.dy", 0.125)),
        ("[-c*b.dx, 0]", "['abs(sin(4*time)) - b.dx', 0]", ("b.y", 0.0)),
        ("push: 0.5}}}\n", "push: 'sign(sin(4*time))'}}}\n", ("b.dx", 2.0 * 0.78539816339745)),
    ],
)
def test_a_force_with_a_kink_is_flown_piece_by_piece(
    old: str, new: str, moved: tuple[str, float]
) -> None:
    text = FORCED.replace(old, new, 1)
    if "push: 0.5" in old:
        text = text.replace("-c*b.dx,", "push,")
    model = validate(read_text(text), Scene)
    name, expected = moved
    for engine, tolerance in (("taylor", 1e-12), ("scipy", 1e-10)):
        trace = run(model, engine=engine).trace
        final = dict(zip(trace.variables, trace.final.tolist(), strict=True))
        assert final[name] == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("force", ["-c*b.dx", "-abs(c)*b.dx", "min(c, l)*push - b.dx", "abs(push)"])
def test_kinks_in_constants_of_a_flow_are_allowed(force: str) -> None:
    validate(read_text(FORCED.replace("-c*b.dx", f"'{force}'")), Scene)


@pytest.mark.parametrize("incline", ["30", "-a", "pi/2 + 0.01"])
def test_an_incline_beyond_a_right_angle_is_refused(incline: str) -> None:
    text = FORCED.replace("l: 2}", "l: 2, a: 45}") + f"surfaces: {{s: {{incline: {incline}}}}}\n"
    with pytest.raises(DeclarationError, match=r"angles are in radians: .*\*pi/180") as caught:
        validate(read_text(text), Scene)
    assert "surfaces.s.incline" in str(caught.value)


@pytest.mark.parametrize("ends", ["[[l, 0], [-l, 0]]", "[[-l, 0], [l, 0]]", "[[0, l], [0, -l]]"])
@pytest.mark.parametrize("form", ["line", "edge"])
def test_a_line_between_parameters_needs_no_other_engine(ends: str, form: str) -> None:
    text = (
        FORCED
        + f"surfaces: {{s: {{{form}: {ends}}}}}\n"
        + ("contacts: {tip: {point: {body: b}, surface: s, friction: c/2, restitution: 0}}\n")
    )
    text = text.replace("dx: 1", "dx: 1, dy: 0" if "0]," in ends else "dy: 1")
    for size in (2.0, 0.5):
        found = run(validate(read_text(text), Scene), parameters={"l": size}, until=0.2)
        assert found.trace.engine == "taylor"
        assert not any("engine" in warning for warning in found.warnings)


@pytest.mark.parametrize("nested", ["sqrt(1 + x*{})", "exp({})", "sin({})", "(1 + x*{})"])
def test_a_height_whose_derivatives_are_too_large_is_refused_before_they_are_built(
    nested: str,
) -> None:
    def text(depth: int) -> str:
        height = "x"
        for _ in range(depth):
            height = nested.format(height)
        return FORCED + f"surfaces: {{s: {{height: '{height}'}}}}\n"

    with pytest.raises(DeclarationError, match="nest fewer functions") as caught:
        validate(read_text(text(28)), Scene)
    assert "surfaces.s.height" in str(caught.value)
    validate(read_text(text(5)), Scene)
    many = " + ".join(f"0.1*sin({k}*x)" for k in range(60))
    validate(read_text(FORCED + f"surfaces: {{s: {{height: {many}}}}}\n"), Scene)


def nested(form: str, depth: int, of: str) -> str:
    text = of
    for _ in range(depth):
        text = form.format(text, of=of)
    return text


DEEP = {
    "roots": nested("sqrt(1 + {of}*{0})", 25, "x"),
    "exponentials": nested("exp({0})", 20, "x"),
    "angles": nested("atan2({of}, 1 + {0})", 20, "x"),
    "product": "*".join(f"(1 + 0.1*{k}*x)" for k in range(30)),
}
PLACES = {
    "flows": ("{x: '1'}", "{x: '{deep}'}", "flows.x"),
    "guard": ("'x >= 9'", "'{deep} >= 9'", "transitions.0.guard"),
    "invariant": ("'x <= 9'", "'9 >= {deep}'", "invariants.i"),
    "stop": ("'x >= 8'", "'{deep} >= 8'", "stop.conditions.c"),
}


@pytest.mark.parametrize("deep", DEEP)
@pytest.mark.parametrize("place", PLACES)
def test_formulas_with_too_large_derivatives_are_refused(place: str, deep: str) -> None:
    text = (
        "kind: chart\nname: deep\nvariables: {x: 0}\n"
        "stop: {time: 1, conditions: {c: 'x >= 8'}}\n"
        "regions:\n  r:\n    initial: s\n    states:\n"
        "      s: {flows: {x: '1'}, invariants: {i: 'x <= 9'}}\n      e: {}\n"
        "    transitions: [{name: go, from: s, to: e, guard: 'x >= 9'}]\n"
    )
    before, after, where = PLACES[place]
    assert before in text
    validate(read_text(text.replace(before, after.replace("{deep}", "x*sqrt(1 + x)"))), Chart)
    with pytest.raises(DeclarationError, match="nest fewer functions") as caught:
        validate(read_text(text.replace(before, after.replace("{deep}", DEEP[deep]))), Chart)
    assert where in str(caught.value)
    assert caught.value.line is not None
    assert caught.value.column is not None


@pytest.mark.parametrize("deep", ["roots", "exponentials", "angles", "product"])
def test_a_force_is_refused_where_its_derivative_is_too_large(deep: str) -> None:
    force = DEEP[deep].replace("x", "b.x").replace("eb.xp", "exp")
    text = (
        "kind: scene\nname: deep\nbodies: {b: {mass: 1}}\nstop: {time: 1}\n"
        f"forces: {{f: {{body: b, force: ['{force}', 0]}}}}\n"
    )
    with pytest.raises(DeclarationError, match="nest fewer functions") as caught:
        validate(read_text(text), Scene)
    assert "forces.f.force.0" in str(caught.value)


@pytest.mark.parametrize(
    ("path", "folds"),
    [
        ("atan2(sin(3*time), cos(3*time))", True),
        ("asin(sin(time))/5", True),
        ("1 - acos(cos(time))", True),
        ("atan(tan(time))", True),
        ("asin(c/3*sin(time))", False),  # a crank
        ("atan(sin(time))", False),
        ("atan2(c*sin(time), l + c*cos(time))", False),
        ("asin(sin(c))*time", False),
    ],
)
def test_a_path_that_folds_its_argument_back_is_refused(path: str, folds: bool) -> None:
    text = FORCED + f"surfaces: {{s: {{height: -9, displacement: [0, '{path}']}}}}\n"
    if not folds:
        validate(read_text(text), Scene)
        return
    with pytest.raises(DeclarationError, match=r"of time has no slope, .* write a smooth formula"):
        validate(read_text(text), Scene)
