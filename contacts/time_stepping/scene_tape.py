"""Equations of a scene of points against surfaces, on a tape for time steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.contact_law import touching_pairs
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.parameters import cone_edge
from contacts.time_stepping.equations import CONTACT, JOINT
from contacts.time_stepping.stability import StepLimits
from statechart.arrays import Array
from statechart.automaton.margin_derivatives import derivative
from statechart.automaton.trace import Key
from statechart.formulas.tape import Tape
from statechart.formulas.writer import Max


class StateEquations(NamedTuple):
    """Equations at one state."""

    mass: Array  # shape (n, n)
    # (c, 2 n + CONTACT): Jacobian, then the numbers of `contacts.time_stepping.equations.CONTACT`.
    contacts: Array
    joints: Array  # (r, n + JOINT)

    @property
    def gaps(self) -> Array:
        """Gaps (c,)."""
        return self.contacts[:, 2 * len(self.mass) + 2]

    @property
    def velocities(self) -> Array:
        """Gap rates and slips (c, 2)."""
        return self.contacts[:, 2 * len(self.mass) + 3 : 2 * len(self.mass) + 5]

    def cones(self, at_rest: Array) -> Array:
        """Return cone edges (c, 2) for the slip directions; `at_rest` without slip."""
        plus, minus = self.contacts[:, -4:-2], self.contacts[:, -2:]
        slips = self.velocities[:, 1:]
        return np.where(slips > 0.0, plus, np.where(slips < 0.0, minus, at_rest))


class SteppedTape:
    """Tape of the equations that a step evaluates."""

    def __init__(self, mechanics: Mechanics, states: Mapping[str, str]) -> None:
        known = mechanics.values_in(states)
        forces = [force.xreplace(known) for force in mechanics.generalised_forces]
        set_in = [known[symbol] for symbol in mechanics.controls]
        signs = _Signs(forces, set_in, mechanics)
        forces, set_in = signs.middle[: len(forces)], signs.middle[len(forces) :]
        outputs: list[sp.Expr] = [*mechanics.dense(mechanics.mass_matrix), *forces]
        derivatives = [derivative(force, rate) for force in forces for rate in mechanics.v]
        self.damped = any(derivative != 0 for derivative in derivatives)
        if self.damped:
            outputs += derivatives
        self.scene = mechanics.scene
        self.names = tuple(mechanics.scene.frictional)
        self.couplings = len(mechanics.scene.couplings)
        rigid, sizes = self.names[: len(self.names) - self.couplings], mechanics.sizes
        for name in self.names:
            contact = mechanics.contact(name)
            outputs += mechanics.dense((contact.jacobian_n, contact.jacobian_t))
            coupled = name in mechanics.scene.couplings
            limits = mechanics.limits(name) if coupled else (contact.gap, sp.S.Zero)
            static, kinetic = (limit.xreplace(known) for limit in limits)
            motion = contact.bias_n, contact.bias_t, static, contact.gap_rate, contact.slip
            # Surface velocities depend on controller states.
            outputs += [term.xreplace(known) for term in motion] if self.scene.leading else motion
            gate = mechanics.gate(name)
            holds = sp.S.One if gate is None else gate.by_steps(known, sizes)
            outputs.append(holds)
            for acute in (False, True):
                valleys = {} if coupled else mechanics.valleys(name, acute=acute)
                outputs.append(holds if gate is None else gate.by_steps(known, sizes, valleys))
            edges = mechanics.sliding_edges(contact)
            if coupled:
                edges = 2 * _kinetic_edge(static, kinetic)
            outputs += [edge.xreplace(known) for edge in edges]
        rows = mechanics.joint_rows
        for row in rows:
            # An open joint has a zero row.
            on = known.get(row.closed, sp.S.One)
            outputs += [on * entry for entry in mechanics.dense([row.jacobian])]
            outputs += [row.gap, row.gap_rate, row.bias]
            outputs.append(row.status.xreplace(known))
        self.joint_rows = len(rows)
        self.limits = StepLimits(mechanics, forces)
        # Disabled contacts and couplings are never passed over.
        gaps = [sp.S.One] * len(self.names)
        for i, name in enumerate(rigid):
            gate = mechanics.gate(name)
            off = () if gate is None else (-gate.by_steps(known, sizes),)
            gaps[i] = Max(mechanics.contact(name).gap.xreplace(known), *off)
        self.gaps: Tape = mechanics.tape(gaps)
        self.given, self.signs = len(set_in), len(signs.functions)
        outputs += [*set_in, *signs.inputs(len(forces))]
        used = mechanics.used_friction
        places = [mechanics.controls.index(used[n]) if n in used else -1 for n in self.names]
        self.used = np.array(places, np.int64)
        self.tape: Tape = mechanics.tape(outputs)
        flows = [known.get(rate, rate) for rate in mechanics.controller_rates.values()]
        self.flows: Tape = mechanics.tape(flows)
        # Pins constrain the velocity, frictionless slides its normal component.
        modes = {name: mechanics.scene.region_states(name) for name in self.names}
        counts: dict[Key, int] = {("pin",): 2, ("slide",): 1}
        held = [0 if name in mechanics.pads else counts.get(key, 0) for name, key in modes.items()]
        slips = [2 if "slide+" in key else int("slide" in key) for key in modes.values()]
        self.held, self.slips = np.array(held, np.int64), np.array(slips, np.int64)
        # (c, 2): stiffness and damping, 0 if rigid.
        contacts = mechanics.scene.contacts.values()
        laws = [text or 0 for one in contacts for text in (one.stiffness, one.damping)]
        laws += [0] * (2 * self.couplings)
        self.soft: Tape = mechanics.tape([mechanics.formula(text) for text in laws])
        lengths = {i: mechanics.hauled(name) for i, name in enumerate(rigid)}
        self.hauled = np.array([i for i, margins in lengths.items() if margins], np.int64)
        self.lengths: Tape = mechanics.tape(
            [m.expression.xreplace(known) for margins in lengths.values() for m in margins]
        )
        self.size = len(mechanics.q)
        self.pairs = touching_pairs(mechanics.scene)
        self.plastic = mechanics.scene.simultaneous == "plastic"
        self.capped = mechanics.scene.simultaneous == "capped"
        self.may_jam = mechanics.scene.paradox == "impact"

    def equations(self, values: Array, state: Array, time: float) -> StateEquations:
        """Evaluate the equations at a state."""
        n, c, r = self.size, len(self.names), self.joint_rows
        result = self.tape.values(state, values, time)
        first = n * n + n + (n * n if self.damped else 0)
        second = first + c * (2 * n + CONTACT)
        return StateEquations(
            result[: n * n].reshape(n, n),
            result[first:second].reshape(c, 2 * n + CONTACT),
            result[second : second + r * (n + JOINT)].reshape(r, n + JOINT),
        )

    def contacts(self, values: Array, state: Array, time: float = 0.0) -> Array:
        """Return gap, gap rate, slip and two conditions (c, 5); see `equations.CONTACT`."""
        first = 2 * self.size + 2
        return self.equations(values, state, time).contacts[:, first : first + 5]


class _Signs:
    """Sign functions of positions or velocities in forces.

    Steps solve for them as for friction: see `contacts.time_stepping.scene_step.hold_signs`. They
    enter linearly; products of signs are evaluated at mid-step.
    """

    def __init__(
        self, forces: Sequence[sp.Expr], others: Sequence[sp.Expr], mechanics: Mechanics
    ) -> None:
        self._mechanics, formulas = mechanics, [*forces, *others]
        moving = {*mechanics.q, *mechanics.v}
        atoms = set[sp.Expr]().union(*(f.atoms(sp.sign) for f in forces))
        nodes = sorted((a for a in atoms if a.free_symbols & moving), key=sp.default_sort_key)
        self._signs = {node: sp.Symbol(f"sign{i}", real=True) for i, node in enumerate(nodes)}
        while True:
            forms = [formula.xreplace(self._signs) for formula in formulas]
            acts = {s: [sp.diff(form, s) for form in forms] for s in self._signs.values()}
            apart = {*self._signs.values()}
            nonlinear = {s for s in apart if any(act.free_symbols & apart for act in acts[s])}
            if not nonlinear:
                break
            self._signs = {node: s for node, s in self._signs.items() if s not in nonlinear}
        self.functions = tuple(node.args[0] for node in self._signs)
        self._acts = [acts[s] for s in self._signs.values()]
        none = dict.fromkeys(self._signs.values(), sp.S.Zero)
        # The formulas with all signs zero.
        self.middle = [form.xreplace(none) for form in forms]

    def inputs(self, count: int) -> list[sp.Expr]:
        """Return the inputs of `hold_signs`; the first `count` formulas are forces."""
        mechanics, outputs = self._mechanics, list[sp.Expr]()
        for function, acts in zip(self.functions, self._acts, strict=True):
            outputs += acts[:count]
            outputs += [derivative(function, symbol) for symbol in (*mechanics.v, *mechanics.q)]
            outputs += [function, *acts[count:]]
        return outputs


# Lower bound of a static limit, which defines the edge in motion: its square is not zero.
_TINY = 1e-150


def _kinetic_edge(static: sp.Expr, kinetic: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """Return the unit edge of a slipping coupling: its normal force is the static limit."""
    mu = sp.S.One if static == kinetic else kinetic / Max(static, _TINY)
    return cone_edge(mu)
