"""Caches of solved and compiled modes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Bools
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import HELD, SWITCHES, moving_mode, uncaptured
from statechart.automaton.modes import (
    ModeReconstruction,
    build_mode,
    hide_captured_forces,
    mode_reconstruction,
)
from statechart.automaton.regions import Mode, whole_margins
from statechart.automaton.switches import Switches, switches_of
from statechart.automaton.trace import Key, Role, Roles
from statechart.engines.engine import Engine
from statechart.execution.initial_stop_conditions import InitialStopConditions
from statechart.formulas.tape import Tape


class Roots(NamedTuple):
    """Powers e**p, 0 < p < 1, of expressions of variables in the rates of a mode."""

    bases: Tape  # outputs: e
    exponents: tuple[float, ...]
    nonnegative: tuple[bool, ...]  # whether e is never negative, as abs(x) or max(x, 0)


@dataclass(frozen=True, eq=False)
class TapedMode:
    """A mode with tapes of its guards and rates."""

    mode: Mode
    guards: Tape  # outputs: the margins
    rates: Tape  # outputs: the rates of all variables
    reconstruction: ModeReconstruction  # of dependent coordinates
    wholes: Tape  # outputs: the margins of whole relations (`whole_margins`)
    roots: Roots

    @cached_property
    def watched(self) -> tuple[tuple[str, str], ...]:
        """Name and kind of every margin."""
        return tuple([(margin.name, margin.kind) for margin in self.mode.margins])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the margins."""
        return tuple([margin.name for margin in self.mode.margins])

    @cached_property
    def plain(self) -> Bools:
        """Mask of the margins of the kind `plain`."""
        return np.array([kind == "plain" for _, kind in self.watched], np.bool_)

    def kind(self, guard: int) -> str:
        """Return the kind of a margin."""
        return self.watched[guard][1]


@dataclass(frozen=True, eq=False)
class CompiledMode(TapedMode):
    """A mode with the stepper of an engine."""

    stepper: object


class SolvedModes:
    """The modes of an automaton, solved and taped on first use."""

    def __init__(self, automaton: Automaton) -> None:
        self.automaton = automaton
        self.stops = InitialStopConditions(automaton)
        self._modes: dict[tuple[Roles, frozenset[int]], Mode] = {}
        self._taped: dict[Mode, TapedMode] = {}
        self._switches: dict[Mode, Switches | None] = {}
        self.part = cache(SolvedModes)  # modes of a component
        self._mentioned = cache(self._in_state)
        self._place = {symbol: i for i, symbol in enumerate(automaton.parameters)}

    def taped(self, roles: Roles, zeros: frozenset[int]) -> TapedMode:
        """Return the tapes of the mode of `roles`, for parameters `zeros` that are zero."""
        mode = self.mode(roles, zeros)
        tapes = self._taped.get(mode)
        if tapes is None:
            guards = self.automaton.tape([margin.expression for margin in mode.margins], mode)
            wholes = guards
            if any(margin.relation for margin in mode.margins):
                expressions = [margin.expression for margin in whole_margins(mode.margins)]
                wholes = self.automaton.tape(expressions, mode)
            plain_roles = uncaptured(roles)
            if plain_roles == roles:
                rates = self.automaton.tape(mode.rates, mode)
                reconstruction = mode_reconstruction(self.automaton, mode)
            else:
                moving = self.taped(plain_roles, zeros)
                rates, reconstruction = moving.rates, moving.reconstruction
            tapes = self._taped[mode] = TapedMode(
                mode, guards, rates, reconstruction, wholes, self._roots(mode)
            )
        return tapes

    def mode(self, roles: Roles, zeros: frozenset[int]) -> Mode:
        """Return the mode of `roles`, solved for zero parameters at the places `zeros`."""
        mode = self._modes.get((roles, zeros))
        if mode is None and roles and roles[-1].state == SWITCHES:
            switches = self.switches(roles[:-1], zeros)
            assert switches is not None
            mode = self._modes[roles, zeros] = switches.mode_with_signs(roles[-1].share)
        elif mode is None:
            # Zero parameters that do not occur in its equations need no other mode.
            mentioned = zeros & self._used(roles)
            mode = self._modes.get((roles, mentioned))
            if mode is None:
                symbols, plain_roles = self.automaton.parameters, uncaptured(roles)
                if plain_roles != roles:
                    mode = hide_captured_forces(
                        self.automaton, self.mode(plain_roles, zeros), roles
                    )
                else:
                    vanishing = frozenset(symbols[i] for i in mentioned)
                    mode = build_mode(self.automaton, roles, vanishing)
                self._modes[roles, mentioned] = mode
            self._modes[roles, zeros] = mode
        return mode

    def switches(self, roles: Roles, zeros: frozenset[int]) -> Switches | None:
        """Return the switches of a mode, or None."""
        mode = self.mode(roles, zeros)
        if self.automaton.switching and mode not in self._switches:
            self._switches[mode] = switches_of(self.automaton, mode)
        return self._switches.get(mode)

    def _roots(self, mode: Mode) -> Roots:
        exponents: dict[sp.Expr, float] = {}
        for power in mode.roots:
            if not power.base.free_symbols <= {*self.automaton.parameters}:
                smallest = min(float(power.exp), exponents.get(power.base, 1.0))
                exponents[power.base] = smallest
        return Roots(
            self.automaton.tape([*exponents], mode),
            tuple(exponents.values()),
            tuple(bool(base.is_nonnegative) for base in exponents),
        )

    def _used(self, roles: Roles) -> frozenset[int]:
        """Return the indices of the parameters in the equations of `roles`."""
        return self._always.union(*(self._mentioned(*symbols) for symbols in enumerate(roles)))

    @cached_property
    def _always(self) -> frozenset[int]:
        automaton, coordinates = self.automaton, self.automaton.coordinates
        unit = None if coordinates is None else coordinates.mass_unit
        further = () if unit is None else (unit,)
        return self._places((*automaton.equations, *automaton.rates, *further))

    def _in_state(self, region: int, role: Role) -> frozenset[int]:
        """Return the indices of the parameters in the equations of a region."""
        state = self.automaton.regions[region].build(role)
        return self._places((*state.equations, *state.values.values()))

    def _places(self, expressions: Iterable[sp.Expr]) -> frozenset[int]:
        used: set[sp.Symbol] = set().union(*(e.free_symbols for e in expressions))
        return frozenset(self._place[symbol] for symbol in used if symbol in self._place)


class CompiledModes:
    """The modes of an automaton, compiled for an engine on first entry."""

    def __init__(self, solved: SolvedModes, engine: Engine) -> None:
        self.automaton, self.mode, self.taped = solved.automaton, solved.mode, solved.taped
        self.switches = solved.switches
        self.stops = solved.stops
        self.engine = engine
        self.solved = solved
        self._compiled: dict[Mode, CompiledMode] = {}
        self._built: set[Key] = set()

    def compiled(self, roles: Roles, zeros: frozenset[int]) -> CompiledMode:
        """Return the mode of `roles`, compiled for zero parameters at the places `zeros`."""
        mode = self.mode(roles, zeros)
        compiled_mode = self._compiled.get(mode)
        if compiled_mode is None:
            compiled_mode = self._compiled[mode] = self._compile(roles, zeros)
            key = moving_mode(roles)
            if HELD not in key:
                self._built.add(key)
        return compiled_mode

    def _compile(self, roles: Roles, zeros: frozenset[int]) -> CompiledMode:
        """Compile the rates, unless another mode has the same."""
        taped, plain_roles = self.taped(roles, zeros), uncaptured(roles)
        if plain_roles == roles:
            stepper = self.engine.compile(self.automaton, taped.mode, taped.rates)
        else:
            stepper = self.compiled(plain_roles, zeros).stepper
        return CompiledMode(
            taped.mode, taped.guards, taped.rates, taped.reconstruction, taped.wholes, taped.roots,
            stepper,
        )  # fmt: skip

    @property
    def built(self) -> int:
        """Number of compiled modes."""
        return len(self._built)
