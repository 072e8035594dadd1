"""Links between bodies without contact: pendulum rods, springs, dampers, reactions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.scene.joints import Force
from contacts.scene.parts import Point
from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.formulas.formula import evaluator
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape
from statechart.pictures.film import WORLD, Shape, ShapeKind

SAME = 1e-9
"""A length, relative to the size of its body or scene, that counts as round-off."""
# Random configurations at which an identity is tested.
_CONFIGURATIONS = 5
# Step of finite differences of forces, and relative change of a force that counts.
_MOVED, _FOLLOWS = 1e-4, 1e-6


class Links:
    """The links between the bodies of a scene, for values `known` of the automaton's parameters.

    The automaton may have more variables and parameters than the mechanics; `frames` maps bodies to
    their frames.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        automaton: Automaton,
        known: Mapping[str, float],
        frames: Mapping[str, int],
    ) -> None:
        self._mechanics, self._automaton, self._values = mechanics, automaton, known
        self._scene, self._frames, self._number = mechanics.scene, frames, evaluator(known)

    def shapes(self) -> list[Shape]:
        """Return the links as shapes."""
        return [*self._pendulums(), *self._reactions()]

    def sample_values(self, expressions: Sequence[sp.Expr], states: Array | None = None) -> Array:
        """Evaluate expressions in some states, by default in unrelated ones."""
        values = np.fromiter(self._values.values(), float, len(self._values))
        times = np.linspace(0.1, 1.0, _CONFIGURATIONS)
        tape = compile_expressions(self._automaton, expressions)
        return tape.table(self._states() if states is None else states, values, times)

    def _states(self) -> Array:
        # Irrational angles: an identity that holds in them holds generally.
        count = len(self._automaton.variables)
        return np.sin(np.outer(1.0 + np.arange(_CONFIGURATIONS), 1.0 + np.arange(count)))

    def _pendulums(self) -> list[Shape]:
        """Return links from bodies on circular paths to their centres."""
        shapes_found = []
        mechanics = self._mechanics
        for name, body in self._scene.bodies.items():
            if body.position is None:
                continue
            (x, y), _ = mechanics.body_frame(name)
            used = (x.free_symbols | y.free_symbols) & {*mechanics.q, mechanics.time}
            if len(used) != 1 or mechanics.time in used:
                continue
            (q,) = used
            terms = [x, y, x.diff(q), y.diff(q), x.diff(q, 2), y.diff(q, 2)]
            place, first, second = np.split(self.sample_values(terms), 3, axis=1)
            speed, bend = (first**2).sum(axis=1), (second**2).sum(axis=1)
            if not (bend > 0.0).all() or np.ptp(speed) > SAME * speed.max():
                continue
            centre = place + second * (speed / bend)[:, None]
            if np.ptp(centre, axis=0).max() > SAME * np.abs(place).max():
                continue
            pivot, frame = centre[0], self._frames[name]
            shapes_found.append(
                Shape("link", np.array([[0.0, 0.0], pivot]), frame, WORLD, name=name)
            )
            shapes_found.append(Shape("pivot", pivot[None, :], WORLD, WORLD, name=name))
        return shapes_found

    def _reactions(self) -> list[Shape]:
        forces = [f for f in self._scene.forces.values() if f.force != (0, 0)]
        shapes_found = []
        for one, other in combinations(forces, 2):
            if one.body == other.body or not self._opposite(one, other):
                continue
            ends = np.array([[self._number(text) for text in force.at] for force in (one, other)])
            pair = self._frames[one.body], self._frames[other.body]
            kinds = self._kinds(one, other)
            shapes_found += [Shape(kind, ends, *pair, name=one.body) for kind in kinds]
        return shapes_found

    def _kinds(self, one: Force, other: Force) -> list[ShapeKind]:
        """Return the kinds of two reactions; none if they do not act along their line."""
        states, terms = self._states(), self._terms(one, other)
        if not self._along(terms, states):
            # Coordinates that the force does not use are equal: a spring along an axis.
            states[:, self._unused(terms)] = 0.0
            return self._link_kinds(terms, states) if self._along(terms, states) else []
        return self._link_kinds(terms, states) or ["reaction"]

    def _terms(self, one: Force, other: Force) -> list[list[sp.Expr]]:
        return [[*force, *self._between(one, other)] for force in self._alternatives(one)]

    def _along(self, terms: Sequence[Sequence[sp.Expr]], states: Array) -> bool:
        still = self._at_rest(states)
        return not any(_off(self.sample_values(each, still)) for each in terms)

    def _link_kinds(self, terms: Sequence[Sequence[sp.Expr]], states: Array) -> list[ShapeKind]:
        kinds: list[ShapeKind] = []
        if any(self._stiff(each, self._at_rest(states)) for each in terms):
            kinds.append("spring")
        if any(self._damped(each, states) for each in terms):
            kinds.append("damper")
        return kinds

    def _unused(self, terms: Sequence[Sequence[sp.Expr]]) -> list[int]:
        """Return the coordinates that neither a force uses, nor its rate."""
        used = {s for x, y, *_ in terms for s in x.free_symbols | y.free_symbols}
        pairs = zip(self._mechanics.q, self._mechanics.v, strict=True)
        return [k for k, pair in enumerate(pairs) if used.isdisjoint(pair)]

    def _at_rest(self, states: Array) -> Array:
        count = len(self._mechanics.q)
        still = states.copy()
        still[:, count : 2 * count] = 0.0
        return still

    def _stiff(self, terms: Sequence[sp.Expr], still: Array) -> bool:
        """Return whether the static force grows with the length (a spring)."""
        pull, length = _line_force(self.sample_values(terms, still))
        rise, square = np.zeros(_CONFIGURATIONS), np.zeros(_CONFIGURATIONS)
        for k in range(len(self._mechanics.q)):
            states = still.copy()
            states[:, k] += _MOVED
            there, longer = _line_force(self.sample_values(terms, states))
            rise += (there - pull) * (longer - length)
            square += (longer - length) ** 2
        return bool((rise > _FOLLOWS * np.abs(pull).max() * square).any())

    def _damped(self, terms: Sequence[sp.Expr], states: Array) -> bool:
        """Return whether velocities alone give forces that dissipate energy."""
        states, count = states.copy(), len(self._mechanics.q)
        still = self.sample_values(terms, self._at_rest(states))
        moving = self.sample_values(terms, states)
        states[:, :count] += _MOVED * states[:, count : 2 * count]
        apart = self.sample_values(terms, states)[:, 2:] - moving[:, 2:]
        power = ((moving - still)[:, :2] * apart).sum(axis=1)
        size = np.hypot(*moving[:, :2].T) * np.hypot(*apart.T)
        return bool((power > _FOLLOWS * size).any() and (power > -_FOLLOWS * size).all())

    def _alternatives(self, force: Force) -> Iterator[tuple[sp.Expr, sp.Expr]]:
        mechanics = self._mechanics
        initial_values = dict(mechanics.controlled())
        regions = self._scene.controlled.flat.items()
        states = [(name, state) for name, region in regions for state in region.states]
        for sets in [mechanics.sets(*state) for state in states] or [{}]:
            x, y = mechanics.vector(force.force)
            for symbol in reversed(mechanics.controls):
                value = {**initial_values, **sets}[symbol]
                x, y = x.subs(symbol, value), y.subs(symbol, value)
            yield x, y

    def _between(self, one: Force, other: Force) -> tuple[sp.Expr, sp.Expr]:
        here, there = (self._mechanics.point(Point(body=f.body, at=f.at)) for f in (one, other))
        return there[0] - here[0], there[1] - here[1]

    def _opposite(self, one: Force, other: Force) -> bool:
        forces = self._mechanics.vector(one.force), self._mechanics.vector(other.force)
        return all(sp.expand(a + b) == 0 for a, b in zip(*forces, strict=True))


def compile_expressions(automaton: Automaton, expressions: Sequence[sp.Expr]) -> Tape:
    """Compile expressions over the variables and parameters of an automaton."""
    return compile_tape(
        expressions,
        variables=automaton.variables,
        parameters=automaton.parameters,
        time=automaton.time,
    )


def _line_force(values: Array) -> tuple[Array, Array]:
    """Return the force along a line, and its length."""
    force, way = values[:, :2], values[:, 2:]
    length = np.hypot(*way.T)
    with np.errstate(invalid="ignore"):
        return (force * way).sum(axis=1) / length, length


def _off(values: Array) -> bool:
    """Return whether a force deviates from its line; `values` as for `_line_force`."""
    force, way = values[:, :2], values[:, 2:]
    transverse = force[:, 0] * way[:, 1] - force[:, 1] * way[:, 0]
    return bool((np.abs(transverse) > SAME * np.hypot(*force.T) * np.hypot(*way.T)).any())
