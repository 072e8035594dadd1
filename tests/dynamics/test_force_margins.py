"""Guards on forces of contacts are positive multiples of the margins that reports show."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import sympy as sp

from statechart.automaton.regions import Margin
from statechart.automaton.trace import Role
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

_SCENE = """\
kind: scene
name: carried
gravity: 10
parameters: {{mu: 0.7}}
bodies: {{cart: {{mass: 2}}, b: {{mass: 1, start: {{y: 4}}}}}}
surfaces: {{deck: {{body: cart, line: [[-1, 0], [4, 3]]}}, floor: {{height: 0}}}}
contacts: {{k: {{point: {{body: b}}, surface: {surface}, friction: {friction}, restitution: 0}}}}
stop: {{time: 1}}
"""
# Friction, and its kinetic coefficient at a speed; static is mu.
_LAWS: dict[str, Callable[[float, float], float]] = {
    "mu": lambda mu, _: mu,
    "{static: mu, kinetic: mu/2}": lambda mu, _: mu / 2,
    "{static: mu, kinetic: mu/2 + mu/4*exp(-abs(slip))}": lambda mu, speed: (
        mu / 2 + mu / 4 * math.exp(-speed)
    ),
}


@pytest.mark.parametrize("surface", ["floor", "deck"])
@pytest.mark.parametrize("friction", _LAWS)
def test_guards_are_positive_multiples_of_what_is_shown(surface: str, friction: str) -> None:
    automaton = Runner(read_text(_SCENE.format(surface=surface, friction=friction))).automaton
    (region,) = automaton.regions
    *_, V, H = automaton.unknowns
    modes = {
        role: {
            margin.name.removeprefix("k."): margin for margin in region.build(Role(role)).margins
        }
        for role in ("pin", "slide+", "slide-")
    }
    random = np.random.default_rng(1)
    for mu in (0.0, *random.uniform(0.1, 3.0, 3)):
        values = automaton.setup({"mu": mu}, 1e-15).values
        known = dict(zip(automaton.parameters, values.tolist(), strict=True))
        known |= dict(
            zip(automaton.variables, random.uniform(-2.0, 2.0, 99).tolist(), strict=False)
        )

        def at(expression: sp.Expr, known: dict[sp.Symbol, float] = known) -> float:
            return float(expression.subs(known))

        def both(margin: Margin, at: Callable[[sp.Expr], float] = at) -> tuple[float, float]:
            return at(margin.expression), at(margin.shown or margin.expression)

        for direction, role in ((1, "slide+"), (-1, "slide-")):
            speed = at(modes[role]["slip"].expression)
            used = _LAWS[friction](mu, speed)
            known[V] = random.uniform(-5.0, 5.0)
            known[H] = -direction * used * known[V]  # against the slip
            guard, shown = both(modes[role]["V"])
            # Edges are unit vectors unless the coefficient depends on the slip.
            size = math.hypot(1.0, used) ** (2 if "slip" in friction else 1)
            assert shown == pytest.approx(known[V], rel=1e-12)
            assert guard == pytest.approx(size * shown, rel=1e-12)
        known[H] = random.uniform(-5.0, 5.0)
        pin = modes["pin"]
        assert both(pin["V"]) == (known[V], known[V])
        for side, sign in (("mu V - H", -1), ("mu V + H", 1)):
            guard, shown = both(pin[side])
            assert shown == pytest.approx(mu * known[V] + sign * known[H], rel=1e-12)
            assert guard * math.hypot(1.0, mu) == pytest.approx(shown, rel=1e-12)
