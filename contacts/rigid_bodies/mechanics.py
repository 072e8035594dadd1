"""Symbols of formulas of colliding bodies, and forces on the bodies."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.collision_detection.midpoint import ForceProgram
from contacts.dynamics.geometry import surface_frame
from contacts.dynamics.joints import JointRow
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.parameters import body_parameters
from contacts.dynamics.scales import check_range
from contacts.rigid_bodies.declared_numbers import (
    LinkedMechanics,
    led_parts,
    linked_mechanics,
    turns_about_pivot,
)
from contacts.scene.joints import Path
from contacts.scene.parts import Body
from contacts.scene.scene import Scene
from contacts.scene.shapes import INDEX
from contacts.time_stepping.stability import CHANGE, Stiffness, stiffness
from statechart.arrays import Array, Ints
from statechart.documents.fields import replace_fields, value_of
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse
from statechart.formulas.parameters import Parameters
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape

_KEYS = ("x", "y", "angle", "dx", "dy", "dangle")


class Forces(NamedTuple):
    """Forces on bodies (f,): a tape of two components and a moment each, and parameter values."""

    bodies: Ints
    tape: Tape
    values: Array

    @property
    def program(self) -> ForceProgram:
        """The arrays of the compiled step."""
        return ForceProgram(self.bodies, *self.tape.program, self.values)

    def stiffness(self, numbers: BodyNumbers, h: float, state: Array, time: float) -> Stiffness:
        """Return the stiffness of the forces; see `contacts.time_stepping.stability.stiffness`.

        With linked bodies, forces are differentiated by each variable that they read.
        """
        size = float(numbers.sizes[: len(numbers.inverse)].max())
        n, first = numbers.size, 3 * numbers.free
        if not numbers.links.bodies:
            own = self.bodies, self.tape, self.values
            return stiffness(*own, numbers.inverse, size, h, state, time)
        read = {*self.tape.reads.tolist(), *range(first, n), *range(n + first, 2 * n)}
        variables = np.array(sorted(read.intersection(range(2 * n))))
        changes = np.where(variables < n, 1.0, 1.0 / h) * CHANGE * size
        found = np.zeros((2, n, n))
        for i, change in zip(variables.tolist(), changes.tolist(), strict=True):
            around = np.tile(state, (2, 1))
            around[:, i] += [change, -change]
            # Inertial forces are those at the mean of the rates.
            more, less = self._generalised(numbers, around, time, i < n)
            found[i // n, :, i % n] = (less - more) / (2.0 * change)
        root = energy_root(numbers, state)
        scaled = root.T @ np.where(np.isfinite(found), found, 0.0) @ root
        rows, columns = np.nonzero(scaled.any(axis=0))
        places, rates = scaled[:, rows, columns]
        return Stiffness(n, rows, columns, h * h * places, 2.0 * h * rates)

    def _generalised(self, numbers: BodyNumbers, states: Array, time: float, all_of: bool) -> Array:
        """Return the generalised forces (k, n); `all_of`: including gravity on linked bodies."""
        links, free, count = numbers.links, numbers.free, len(states)
        result = np.zeros((count, numbers.size))
        if all_of:
            result[:, 3 * free :] = numbers.inertia(states)[1]
        _, gradients = numbers.linked(states)
        gradients = gradients.reshape(count, links.bodies, 3, links.size)
        times = np.full(count, time)
        forces = self.tape.table(states, self.values, times).reshape(count, -1, 3)
        for i, b in enumerate(self.bodies.tolist()):
            if b < free:
                result[:, 3 * b : 3 * b + 3] += forces[:, i]
            else:
                result[:, 3 * free :] += np.einsum(
                    "kd,kdj->kj", forces[:, i], gradients[:, b - free]
                )
        return result


def energy_root(numbers: BodyNumbers, state: Array) -> Array:
    """Return R (n, n) with ``R R^T = M^-1``: squared rates in coordinates R^-1 q are energies."""
    root, first = np.zeros((numbers.size, numbers.size)), 3 * numbers.free
    root[:first, :first] = np.diag(np.sqrt(numbers.inverse[: numbers.free]).ravel())
    if numbers.links.bodies:
        root[first:, first:] = np.linalg.cholesky(np.linalg.inv(numbers.inertia(state[None])[0][0]))
    return root


class Starts:
    """Initial poses and rates of the bodies of a scene."""

    def __init__(self, scene: Scene, parameters: Parameters) -> None:
        self._scene = scene
        counts = [
            0 if scene.bodies[name].coordinates == () else 1 if n is None else n
            for name, n in scene.counted(scene.values()).items()
        ]
        # Declared body of each moving body, and index among its copies.
        self._kinds = np.repeat(np.arange(len(counts)), counts)
        self._numbers = np.concatenate([np.arange(count) for count in counts])
        index = sp.Symbol("index", real=True)
        expressions = []
        for body in scene.bodies.values():
            known = dict(parameters.symbols) if body.copies is None else {
                **parameters.symbols, INDEX: index
            }  # fmt: skip
            expressions += [parse(body.start.get(k, 0)).to_sympy(known) for k in _KEYS]  # type: ignore[call-overload]
        self._tape = compile_tape(
            expressions,
            variables=(index,),
            parameters=parameters.ordered,
            time=sp.Symbol("t", real=True),
        )

    def at(self, values: Array, known: Mapping[str, float]) -> Array:
        """Return the poses of free bodies and the coordinates, then the rates of both.

        Raises `DeclarationProblem` if one has no value, or one out of range.
        """
        linked = [
            [
                value_of(getattr(coordinate, key), known, "coordinates", name, key)
                for name, coordinate in self._scene.coordinates.items()
            ]
            for key in ("start", "rate")
        ]
        if not len(self._numbers):
            return np.array(linked).reshape(-1)
        rows = np.arange(self._numbers.max() + 1, dtype=float)
        found = self._tape.table(rows[:, None], values, np.zeros(len(rows)))
        starts: Array = found.reshape(len(rows), -1, 6)[self._numbers, self._kinds]
        worst = np.abs(starts)
        b, at = np.unravel_index(int(np.argmax(worst)), worst.shape)
        self._check(int(b), int(at), float(starts[b, at]), known)
        free = starts.reshape(-1, 2, 3).transpose(1, 0, 2).reshape(2, -1)
        return np.concatenate([free, np.array(linked)], axis=1).reshape(-1)

    def _check(self, b: int, at: int, value: float, known: Mapping[str, float]) -> None:
        """Check the largest value of a start, or a non-finite one."""
        owner, key = list(self._scene.bodies)[self._kinds[b]], _KEYS[at]
        loc, copied = ("bodies", owner, "start", key), self._scene.bodies[owner].copies is not None
        which = f" of {owner}{self._numbers[b]}" if copied else ""
        if not np.isfinite(value):
            text = self._scene.bodies[owner].start[key]  # type: ignore[index]
            numbered = {**known, INDEX: float(self._numbers[b])} if copied else known
            try:
                value_of(text, numbered, *loc)
            except DeclarationProblem as problem:
                problem.message += f", the {key}{which}" if copied else ""
                raise
            raise DeclarationProblem(f"must be finite, not {value:g}{which}", loc=loc)
        check_range(value, f"the start{which}", loc)


class BodyMechanics(Mechanics):
    """Symbols of possibly thousands of free bodies; equations of motion are not composed.

    The `scene` has its bodies one by one, with starts in `starts`; `owners` are their declared
    bodies.
    """

    def __init__(self, scene: Scene) -> None:
        owners = scene.owners()
        self.owners = tuple(owners.values())
        kinds = {
            name: replace_fields(body, copies=None, start={}) for name, body in scene.bodies.items()
        }
        single = {
            name: _at_its_place(scene.bodies[owner], name.removeprefix(owner))
            if scene.bodies[owner].prescribed
            else kinds[owner]
            for name, owner in owners.items()
        }
        expanded = replace_fields(scene, bodies=single)
        parameters = body_parameters(scene, len(expanded.variables))
        super().__init__(expanded, parameters)
        self.starts = Starts(scene, parameters)
        self._in_states = cache(lambda states: BodyTapes(self, dict(states)))

    @cached_property
    def energy(self) -> sp.Expr:
        """Kinetic and gravitational energy."""
        gx, gy = self.gravity
        copies_of: dict[str, list[str]] = {}
        terms: list[sp.Expr] = []
        if self.linked is not None:
            known, energy = self.linked.known, self.linked.energy
            own = {x: self.known[name] for name, x in known.items() if x in energy.free_symbols}
            terms.append(energy.xreplace(own))
        for name, owner in zip(self.scene.bodies, self.owners, strict=True):
            if self.scene.bodies[name].coordinates:
                copies_of.setdefault(owner, []).append(name)
        for owner, names in copies_of.items():
            mass = self.formula(self.scene.bodies[names[0]].mass)
            x, y, dx, dy, turn = (
                [self.known[f"{name}.{c}"] for name in names]
                for c in ("x", "y", "dx", "dy", "dangle")
            )
            inertia = self.known[f"{owner}.inertia"]
            terms.append(_times(mass / 2, _squares(*dx, *dy)))
            terms.append(_times(inertia / 2, _squares(*turn)))
            terms += [_times(-mass * gx, _sum(x)), _times(-mass * gy, _sum(y))]
        return sp.Add(*terms)

    @cached_property
    def linked(self) -> LinkedMechanics | None:
        """Equations of the linked bodies."""
        return linked_mechanics(self.scene)

    @cached_property
    def joint_rows(self) -> tuple[JointRow, ...]:
        """Rows of all joints, with names and forces only; the steps have the rest as arrays."""
        rows: list[JointRow] = []
        for turns in (False, True):
            for name, joint in self.scene.joints.items():
                for component in joint.forces:
                    if (component == "M") == turns:
                        force = sp.Symbol(f"{component}{len(rows)}", real=True)
                        rows.append(JointRow(name, component, force))
        return tuple(rows)

    def at(self, states: Mapping[str, str]) -> BodyTapes:
        """Return the formulas in these controller states."""
        return self._in_states(tuple(states.items()))


class BodyTapes:
    """Formulas in given controller states, compiled on first use."""

    def __init__(self, mechanics: BodyMechanics, states: Mapping[str, str]) -> None:
        self._mechanics = mechanics
        self._definitions = mechanics.controlled(states)

    @cached_property
    def controls(self) -> Tape:
        """The tape of `Mechanics.controls`."""
        return self._mechanics.tape(self._mechanics.controls, definitions=self._definitions)

    @cached_property
    def flows(self) -> Tape:
        """Rates of the controller variables, over them and time."""
        rates, values = self._mechanics.controller_rates.values(), dict(self._definitions)
        return self._without_bodies([values.get(rate, sp.S.Zero) for rate in rates])

    @cached_property
    def paths(self) -> Tape:
        """Poses of the led bodies; see `led_parts`."""
        scene, known, found = self._mechanics.scene, self._mechanics.known, list[sp.Expr]()
        bodies, surfaces, joints = led_parts(scene)
        for name in bodies:
            found += [parse(text).to_sympy(known) for text in scene.single_bodies()[name].path]
        for name in surfaces:
            surface = scene.surfaces[name]
            if turns_about_pivot(surface):
                parts = zip(surface.displacement, surface.pivot, strict=True)
                found += [sum(parse(text).to_sympy(known) for text in pair) for pair in parts]
                found.append(parse(surface.turn).to_sympy(known))
            else:
                found += surface_frame(surface, known)
        for name in joints:
            path = scene.joints[name].to
            assert isinstance(path, Path)
            found += [parse(text or 0).to_sympy(known) for text in (path.x, path.y, 0)]
        return self._without_bodies(found)

    def _without_bodies(self, expressions: Sequence[sp.Expr]) -> Tape:
        mechanics = self._mechanics
        return compile_tape(
            expressions,
            variables=tuple(mechanics.controller_state.values()),
            parameters=mechanics.parameters.ordered,
            time=mechanics.time,
            definitions=self._definitions,
        )

    @cached_property
    def limits(self) -> Tape:
        """Limits of couplings; see `contacts.collision_detection.couplings.STATIC`."""
        mechanics, found = self._mechanics, list[sp.Expr]()
        for name in mechanics.scene.couplings:
            gate = mechanics.gate(name)
            holds = sp.S.One if gate is None else gate.by_steps({}, mechanics.sizes)
            found += [*mechanics.limits(name), holds]
        return mechanics.tape(found, definitions=self._definitions)

    def forces(self, values: Array) -> Forces:
        """Return the forces on bodies."""
        return Forces(*self._forces, values)

    @cached_property
    def _forces(self) -> tuple[Ints, Tape]:
        """The bodies on which forces act, and the tape of the forces."""
        mechanics, found = self._mechanics, dict[int, list[sp.Expr]]()
        for force in mechanics.scene.forces.values():
            for place, known in self._each(force.body):
                fx, fy = (parse(text).to_sympy(known) for text in force.force)
                ax, ay = (parse(text).to_sympy(known) for text in force.at)
                _, angle = mechanics.body_frame(list(mechanics.scene.bodies)[place])
                c, s = sp.cos(angle), sp.sin(angle)
                turn = parse(force.moment).to_sympy(known)
                turn += (c * ax - s * ay) * fy - (s * ax + c * ay) * fx
                before = found.get(place, [sp.S.Zero] * 3)
                found[place] = [a + b for a, b in zip(before, (fx, fy, turn), strict=True)]
        expressions = [expression for three in found.values() for expression in three]
        tape = mechanics.tape(expressions, definitions=self._definitions)
        return np.array([*found], dtype=np.int64), tape

    def _each(self, body: str) -> Iterator[tuple[int, Mapping[str, sp.Expr]]]:
        """Yield the places of a body or its copies, with the symbols of their formulas."""
        mechanics, scene = self._mechanics, self._mechanics.scene
        for place, (name, owner) in enumerate(zip(scene.bodies, mechanics.owners, strict=True)):
            if body not in (owner, name):
                continue
            components = () if scene.bodies[name].linked else _KEYS
            own = {f"{body}.{c}": mechanics.known[f"{name}.{c}"] for c in components}
            yield place, ChainMap(own, mechanics.known, mechanics.placed)


def _at_its_place(body: Body, number: str) -> Body:
    """Return a prescribed body, or its copy of this number, with its path as position."""
    one = body if body.copies is None else body.numbered(int(number))
    x, y, angle = one.path
    return replace_fields(one, position=(x, y), angle=angle, start={})


def _times(factor: sp.Expr, total: sp.Expr) -> sp.Expr:
    """Return an unevaluated product: SymPy would expand a number over a sum."""
    return sp.Mul(factor, total, evaluate=False) if factor != 0 else sp.S.Zero


def _squares(*symbols: sp.Symbol) -> sp.Expr:
    return _sum([sp.Pow(symbol, 2, evaluate=False) for symbol in symbols])


def _sum(terms: Sequence[sp.Expr]) -> sp.Expr:
    """Return an unevaluated sum: SymPy's search for equal terms is slow and rarely useful."""
    return sp.Add(*terms, evaluate=False)
