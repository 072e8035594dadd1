"""Solution of the equations of a mode, and reconstruction of its dependent coordinates."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Array, Ints32
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import uncaptured
from statechart.automaton.reduction import Elimination, eliminate
from statechart.automaton.regions import Loads, Margin, Mode, State
from statechart.automaton.trace import Roles
from statechart.formulas.linear import Definition, free_symbols, solve_linear
from statechart.formulas.tape import Tape, contiguous
from statechart.kernels.reconstruction import (
    ReconstructionProgram,
    reconstruct,
    reconstruction_program,
)


def build_mode(automaton: Automaton, roles: Roles, zeros: frozenset[sp.Symbol]) -> Mode:
    """Solve the equations of `roles`; raise `Singular` if they are structurally singular."""
    plain_roles = uncaptured(roles)
    if plain_roles != roles:
        return hide_captured_forces(automaton, build_mode(automaton, plain_roles, zeros), roles)
    states = [region.build(role) for region, role in zip(automaton.regions, roles, strict=True)]
    loads = [state.loads for state in states if state.loads is not None]
    substitution: dict[sp.Expr, sp.Expr] = dict.fromkeys(zeros, sp.S.Zero)
    for load in loads:
        substitution |= load.known
    values = {control: value for state in states for control, value in state.values.items()}
    controls = []
    for control in automaton.controls:
        value = values[control].xreplace(substitution)
        controls.append((control, value))
        if value.is_Atom:
            # Zeros and symbols are substituted before solving.
            substitution[control] = value
    margins = (*(m for state in states for m in state.margins), *automaton.stop_margins)
    margins = tuple(margin.replaced(substitution) for margin in margins)
    rates = tuple(rate.xreplace(substitution) for rate in automaton.rates)
    follows: dict[str, Any] = {}
    if automaton.coordinates is not None and not loads:
        holds = [hold for state in states for hold in state.holds]
        about = {e for hold in holds for e in hold.equations}
        laws = [e for state in states for e in state.equations if e not in about]
        elimination = eliminate(automaton.coordinates, holds, substitution, laws)
        if elimination is not None:
            follows = _dependent_fields(automaton, elimination)
            if not elimination.steep:
                minimal = _minimal(automaton, states, elimination, substitution)
                return Mode((*controls, *minimal), rates, margins, **follows)
    solved = _solve_mode(automaton, states, loads, substitution)
    return Mode((*controls, *solved), rates, margins, **follows)


class _MassUnit:
    """Scales forces by a unit of mass, since determinants contain products of up to five masses.

    The unit is a parameter of the automaton; if it is zero, equations are not scaled.
    """

    def __init__(
        self, automaton: Automaton, zeros: Collection[sp.Symbol], carriers: Sequence[sp.Symbol] = ()
    ) -> None:
        coordinates = automaton.coordinates
        self.count = 0 if coordinates is None else len(coordinates.accelerations)
        unit = None if coordinates is None else coordinates.mass_unit
        self._unit = None if unit in zeros else unit
        self._forces = (*automaton.unknowns[self.count :], *carriers)

    def motion(self, equations: Iterable[sp.Expr]) -> list[sp.Expr]:
        """Return equations of motion (each = 0) divided by the unit, with scaled forces."""
        unit = self._unit
        if unit is None:
            return [*equations]
        scaled = {force: unit * force for force in self._forces}
        return [
            sp.Add(*(term.xreplace(scaled) / unit for term in sp.Add.make_args(equation)))
            for equation in equations
        ]

    def solved(self, definitions: Iterable[Definition]) -> tuple[Definition, ...]:
        """Return definitions with unscaled forces."""
        if self._unit is None:
            return tuple(definitions)
        found, within = [], {force: sp.Dummy(f"{force}_unit", real=True) for force in self._forces}
        for symbol, expression in definitions:
            found.append((within.get(symbol, symbol), expression.xreplace(within)))
            if symbol in within:
                found.append((symbol, self._unit * within[symbol]))
        return tuple(found)


def _solve_mode(
    automaton: Automaton,
    states: Sequence[State],
    loads: Sequence[Loads],
    substitution: Mapping[sp.Expr, sp.Expr],
) -> tuple[Definition, ...]:
    """Solve the equations of a mode for all accelerations and forces at once."""
    carried = {unknown: by for load in loads for unknown, by in load.carried.items()}
    # In place of the carried unknowns, paired with their equations.
    carriers = [c for load in loads for c in load.carriers]
    unit = _MassUnit(automaton, substitution, carriers)
    moving = [e.xreplace(carried) if carried else e for e in automaton.equations]
    moving = [*unit.motion(moving[: unit.count]), *moving[unit.count :]]
    equations = [
        equation.xreplace(substitution)
        for equation in (*moving, *(e for s in states for e in s.equations))
    ]
    if automaton.idle:
        used = set().union(*map(free_symbols, equations))
        equations += [unknown for unknown in automaton.unknowns if unknown not in used]
    unknowns: dict[sp.Symbol, None] = {}
    for unknown in _paired_unknowns(automaton):
        by = carried.get(unknown)
        own = [unknown] if by is None else [c for c in carriers if by.has(c)]
        unknowns |= dict.fromkeys(own)
    solved = solve_linear(equations, tuple(unknowns), len(automaton.equations))
    return (*unit.solved(solved), *_solve_shared(loads, substitution))


def _paired_unknowns(automaton: Automaton) -> list[sp.Symbol]:
    """Return the unknowns in the order of their equations: those of regions last."""
    of_regions = [force for region in automaton.regions for force in region.forces]
    known = {*of_regions}
    return [*(unknown for unknown in automaton.unknowns if unknown not in known), *of_regions]


def _minimal(
    automaton: Automaton,
    states: Sequence[State],
    elimination: Elimination,
    substitution: Mapping[sp.Expr, sp.Expr],
) -> tuple[Definition, ...]:
    """Solve the equations of a mode in minimal coordinates."""
    coordinates = automaton.coordinates
    assert coordinates is not None
    count = len(coordinates.positions)
    others = [*automaton.equations[count:], *(e for s in states for e in s.equations)]
    absent = {e for e in others if e.is_Symbol}
    working = [u for u in automaton.unknowns if u not in absent | elimination.forces]
    motion = coordinates.motion(elimination, working)
    places, known = elimination.replaced, elimination.known
    laws = [e.xreplace(elimination.accelerations) for e in others if e not in places]
    # Coefficients of zero forces may be infinite, as of a disabled contact.
    nothing = dict.fromkeys(absent, sp.S.Zero)
    follow = [automaton.equations[places[e]].xreplace(nothing) for e in others if e in places]
    unit = _MassUnit(automaton, substitution)

    def inserted(equations: Iterable[sp.Expr]) -> list[sp.Expr]:
        return [e.xreplace(known).xreplace(substitution) for e in equations]

    left = [coordinates.accelerations[i] for i in coordinates.remaining(elimination)]
    forces = [u for u in _paired_unknowns(automaton) if u not in coordinates.accelerations]
    free = [force for force in forces if force not in elimination.forces]
    held = [force for force in forces if force in elimination.forces]
    moving = [e.xreplace(substitution) for e in unit.motion(motion)]
    return unit.solved(
        (
            *solve_linear([*moving, *inserted(laws)], (*left, *free), len(moving)),
            *elimination.accelerations.items(),
            *solve_linear(inserted(unit.motion(follow)), held),
        )
    )


def _dependent_fields(automaton: Automaton, elimination: Elimination) -> dict[str, Any]:
    """Return the fields of a mode for its dependent variables."""
    coordinates = automaton.coordinates
    assert coordinates is not None
    rates = dict(zip(coordinates.positions, coordinates.rates, strict=True))
    found = dict(elimination.positions)
    found |= {rates[q]: coordinates.rate(e) for q, e in elimination.positions.items()}
    places = {v: i for i, v in enumerate(automaton.variables)}
    return {"eliminated": {places[v]: e for v, e in found.items()}, "anchors": elimination.anchors}


def hide_captured_forces(automaton: Automaton, mode: Mode, roles: Roles) -> Mode:
    """Return `mode` with the forces of captured regions hidden, except in their own margins."""
    pairs = list(zip(automaton.regions, roles, strict=True))
    hidden: dict[sp.Symbol, sp.Expr] = {
        force: sp.S.Zero for region, role in pairs if role.captured for force in region.forces
    }
    margins: list[Margin] = []
    for region, role in pairs:
        region_margins = region.build(role).margins
        region_part = mode.margins[len(margins) : len(margins) + len(region_margins)]
        margins += region_part if role.captured else _without_hidden(region_part, hidden)
    margins += _without_hidden(mode.margins[len(margins) :], hidden)
    return replace(mode, margins=tuple(margins), hidden=hidden)


def _without_hidden(
    margins: Iterable[Margin], hidden: Mapping[sp.Symbol, sp.Expr]
) -> Iterable[Margin]:
    return [margin.replaced(hidden) for margin in margins]


def _solve_shared(
    loads: Sequence[Loads], substitution: Mapping[sp.Expr, sp.Expr]
) -> tuple[Definition, ...]:
    """Solve for unknowns that the motion does not determine: shared forces, displacements.

    Every unknown has an equation, and the matrix of the pairs is definite up to signs, so that its
    pivots never vanish. Displacements are eliminated first: for large friction at the edge of a
    cone, normal equations would square a stiffness of 1/mu^2.
    """
    laws = {unknown: law for load in loads for unknown, law in load.laws.items()}
    sums: dict[sp.Symbol, list[sp.Expr]] = {}
    for load in loads:
        for unknown, term in load.balances.items():
            sums.setdefault(unknown, []).append(term)
    laws |= {unknown: sp.Add(*terms) for unknown, terms in sums.items()}
    equations = [law.xreplace(substitution) for law in laws.values()]
    return solve_linear(equations, tuple(laws), len(laws), before=sums)


class Reconstruction(NamedTuple):
    """Reconstruction of dependent coordinates in a flow."""

    program: ReconstructionProgram

    def onto(self, state: Array, time: float) -> Array:
        """Return a state (n,) with dependent coordinates computed from the others."""
        if not len(self.program[3]):
            return state
        result = np.array(state)
        reconstruct(self.program, result, time)
        return result


@dataclass(frozen=True, eq=False)
class ModeReconstruction:
    """Reconstruction of dependent coordinates in the flows of a mode."""

    tape: Tape  # (variables, anchors) -> dependent coordinates
    places: Ints32  # (k,) indices of the outputs among the variables
    anchors: Tape  # initial state of a flow -> anchors

    def start(self, state: Array, parameters: Array, time: float) -> Reconstruction:
        """Return the reconstruction for a flow from `state` (n,) at an absolute time."""
        anchors = self.anchors.at(contiguous(state), parameters, time)
        program = self.tape.program
        return Reconstruction(
            reconstruction_program(*program, self.places, anchors, parameters, len(state))
        )


def mode_reconstruction(automaton: Automaton, mode: Mode) -> ModeReconstruction:
    """Compile the reconstruction of a mode."""
    return ModeReconstruction(
        automaton.tape([*mode.eliminated.values()], further=[*mode.anchors]),
        np.array([*mode.eliminated], dtype=np.int32),
        automaton.tape([*mode.anchors.values()]),
    )
