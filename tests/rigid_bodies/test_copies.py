"""Copies of a body: their equations are composed once, their numbers are their own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contacts.kind import automaton
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.formulas.formula import Formula
from statechart.loading.kind import Kind
from statechart.loading.load import interpret
from statechart.running.runner import Runner

GRAINS = """kind: scene
name: grains
parameters: {n: 4, r: 0.1, m: 2, v: 3}
gravity: [1, -9]
bodies:
  lump: {mass: 5, inertia: 7, shape: {disc: r}, start: {y: -8, dangle: 2}}
  grain:
    copies: n
    mass: m
    inertia: m*r**2/2
    shape: {disc: r}
    start: {x: "3*r*index", y: "2 + sin(index)", angle: 1/(1 + index), dx: v, dy: "-index"}
collisions:
  all: {bodies: [lump, grain], friction: 0.5, restitution: 0}
stop: {time: 1e-3}
settings: {engine: impulse, step: 1e-3}
"""


def grains(text: str = GRAINS) -> Runner:
    return Runner(read_text(text, "grains.yaml"))


@pytest.mark.parametrize("row", ["row", "49"])
def test_copies_stand_in_rows(row):
    """Their place in it and its number are those of whole numbers, however quotients round."""
    text = GRAINS.replace("n: 4,", "n: 4000, row: 2,").replace(
        'x: "3*r*index", y: "2 + sin(index)"', f'x: "mod(index, {row})", y: floor(index/{row})'
    )
    at = grains(text).setup({"row": 49.0}).initial.reshape(2, -1, 3)[0, 1:]
    assert at[:, :2].tolist() == [[k % 49, k // 49] for k in range(4000)]


def test_the_number_of_copies_is_computed_once():
    text = GRAINS.replace("n: 4,", "W: 1.2, n: floor(W/(4*r)),").replace("0.1, m", "0.1, m")
    assert [grains(text).run({"W": w}).trace.regions[1:] for w in (1.2, 0.8)] == [
        ("grain0", "grain1", "grain2"), ("grain0", "grain1")
    ]  # fmt: skip


def test_a_copy_starts_where_the_formulas_are_at_its_number():
    setup = grains().setup({"v": 4})
    at, rates = setup.initial.reshape(2, 5, 3)
    assert at[0].tolist() == [0, -8, 0]
    assert rates[0].tolist() == [0, 0, 2]
    for k in range(4):
        expected = [0.1 * 3 * k, 2 + math.sin(k), 1 / (1 + k), 4, -k, 0]
        np.testing.assert_allclose([*at[1 + k], *rates[1 + k]], expected, rtol=1e-15, atol=1e-15)


def test_the_energy_of_copies_is_that_of_all_of_them():
    result = grains().run()
    initial, energy = result.trace.initial, result.observer.sample(result.trace, ["energy"])
    (x, y, _), (dx, dy, turn) = initial.reshape(2, 5, 3).transpose(0, 2, 1)
    mass, inertia = np.array([5, 2, 2, 2, 2]), np.array([7, *[2 * 0.1**2 / 2] * 4])
    expected = mass @ (dx**2 + dy**2) / 2 + inertia @ turn**2 / 2 - mass @ (x - 9 * y)
    assert energy.columns["energy"][0] == pytest.approx(expected, rel=1e-14)


def test_a_thousand_copies_take_no_more_formulas_than_ten(monkeypatch):
    scene = interpret(read_text(GRAINS, "grains.yaml"))
    built = Formula.to_sympy
    counts = []

    def counting(self, known):
        counts[-1] += 1
        return built(self, known)

    monkeypatch.setattr(Formula, "to_sympy", counting)
    for copies in (10, 1000):
        counts.append(0)
        found = automaton(scene.variant({"n": copies}))
        assert len(found.names) == 6 * (1 + copies)
        assert found.setup({}, 0.0).initial.shape == (6 * (1 + copies),)
    assert counts[0] == counts[1] > 0


@pytest.mark.parametrize(
    ("angle", "said", "copy"),
    [
        ("1/(2 - index)", "division by zero", 2),
        ("1e300*index", "at most", 3),
        ("log(index)", "no value", 0),
    ],
)
def test_a_copy_without_a_finite_start_is_reported_with_its_formula(angle, said, copy):
    text = GRAINS.replace("1/(1 + index)", f"'{angle}'")
    with pytest.raises(DeclarationError) as caught:
        grains(text).start()
    error = caught.value
    assert said in str(error)
    line = text.splitlines()[error.line - 1]
    assert error.source == "grains.yaml"
    assert line.index("angle:") < error.column <= line.index("dx:")
    assert f"of grain{copy}" in str(error)


def test_each_number_of_copies_is_composed_once(monkeypatch):
    composed = []
    whole = Kind.__getattribute__

    def counted(kind, name):
        if name == "automaton":
            composed.append(kind.name)
        return whole(kind, name)

    monkeypatch.setattr(Kind, "__getattribute__", counted)
    text = GRAINS.replace("{n: 4,", "{k: 2, n: 2*k,")
    runner = grains(text)
    for speed in (4, 5):
        final = runner.run({"k": 3, "v": speed}).trace.initial
        assert final.reshape(2, 7, 3)[1, 1:, 0].tolist() == [speed] * 6
    # Parameters of another run do not persist.
    assert runner.run({"k": 3}).trace.initial.reshape(2, 7, 3)[1, 1, 0] == 3
    assert len(composed) == 2
