"""Modes solved and compiled when a run first enters them, and kept for the next one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from statechart.arrays import Bools
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import HELD, moving_mode, of_regions, uncaptured
from statechart.automaton.modes import ModeReconstruction, build_mode, captured, mode_reconstruction
from statechart.automaton.regions import Mode, whole_margins
from statechart.automaton.switches import Switches, switches_of
from statechart.automaton.trace import Key, Role, Roles
from statechart.engines.engine import Engine
from statechart.execution.initial_stop_conditions import InitialStopConditions
from statechart.formulas.tape import Tape


@dataclass(frozen=True, eq=False)
class TapedMode:
    """A mode with its guards and its rates on tape, whatever integrates it."""

    mode: Mode  # Equations and margins.
    guards: Tape  # Outputs: the margins, in order.
    rates: Tape  # Outputs: the rates of all variables.
    reconstruction: ModeReconstruction  # The dependent coordinates.
    wholes: Tape  # Outputs: the margins of whole relations; see `whole_margins`.

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
    """A mode on tape, and what an engine made of its rates."""

    stepper: object  # The engine's own.


class SolvedModes:
    """The modes of an automaton, each solved and put on tape when it is first asked for."""

    def __init__(self, automaton: Automaton) -> None:
        self.automaton = automaton
        self.stops = InitialStopConditions(automaton)
        self._modes: dict[tuple[Roles, frozenset[int]], Mode] = {}
        self._taped: dict[Mode, TapedMode] = {}
        self._switches: dict[Mode, Switches | None] = {}
        self._parts: dict[Automaton, SolvedModes] = {}
        self._mentioned: dict[tuple[int, Role], frozenset[int]] = {}
        self._place = {symbol: i for i, symbol in enumerate(automaton.parameters)}

    def part(self, automaton: Automaton) -> SolvedModes:
        """Return the modes of a component."""
        return self._parts.setdefault(automaton, SolvedModes(automaton))

    def taped(self, roles: Roles, zeros: frozenset[int]) -> TapedMode:
        """Return the mode of `roles` on tape, for zero parameters at the places `zeros`."""
        mode = self.mode(roles, zeros)
        found = self._taped.get(mode)
        if found is None:
            guards = self.automaton.tape([margin.expression for margin in mode.margins], mode)
            wholes = guards
            if any(margin.relation for margin in mode.margins):
                expressions = [margin.expression for margin in whole_margins(mode.margins)]
                wholes = self.automaton.tape(expressions, mode)
            bare = uncaptured(roles)
            if bare == roles:
                rates = self.automaton.tape(mode.rates, mode)
                reconstruction = mode_reconstruction(self.automaton, mode)
            else:
                moving = self.taped(bare, zeros)
                rates, reconstruction = moving.rates, moving.reconstruction
            found = self._taped[mode] = TapedMode(mode, guards, rates, reconstruction, wholes)
        return found

    def mode(self, roles: Roles, zeros: frozenset[int]) -> Mode:
        """Return the mode of `roles`, solved for zero parameters at the places `zeros`."""
        found = self._modes.get((roles, zeros))
        if found is None and (regions := of_regions(roles)) != roles:
            switches = self.switches(regions, zeros)
            assert switches is not None
            found = self._modes[roles, zeros] = switches.mode_with_signs(roles[-1].share)
        elif found is None:
            # Zeros that its equations do not mention call for no mode of its own.
            mentioned = zeros & self._used(roles)
            found = self._modes.get((roles, mentioned))
            if found is None:
                symbols, bare = self.automaton.parameters, uncaptured(roles)
                if bare != roles:
                    found = captured(self.automaton, self.mode(bare, zeros), roles)
                else:
                    gone = frozenset(symbols[i] for i in mentioned)
                    found = build_mode(self.automaton, roles, gone)
                self._modes[roles, mentioned] = found
            self._modes[roles, zeros] = found
        return found

    def switches(self, roles: Roles, zeros: frozenset[int]) -> Switches | None:
        """Return the switches of a mode; None where it has none."""
        mode = self.mode(roles, zeros)
        if self.automaton.switching and mode not in self._switches:
            self._switches[mode] = switches_of(self.automaton, mode)
        return self._switches.get(mode)

    def _used(self, roles: Roles) -> frozenset[int]:
        """Return the places of the parameters that the equations of `roles` mention."""
        return self._always.union(*(self._in_state(*pair) for pair in enumerate(roles)))

    @cached_property
    def _always(self) -> frozenset[int]:
        automaton, coordinates = self.automaton, self.automaton.coordinates
        unit = None if coordinates is None else coordinates.mass_unit
        further = () if unit is None else (unit,)
        return self._places((*automaton.equations, *automaton.rates, *further))

    def _in_state(self, region: int, role: Role) -> frozenset[int]:
        """Return the places of the parameters that one region's equations mention."""
        found = self._mentioned.get((region, role))
        if found is None:
            state = self.automaton.regions[region].build(role)
            found = self._places((*state.equations, *state.values.values()))
            self._mentioned[region, role] = found
        return found

    def _places(self, expressions: Iterable[sp.Expr]) -> frozenset[int]:
        used: set[sp.Symbol] = set().union(*(e.free_symbols for e in expressions))
        return frozenset(self._place[symbol] for symbol in used if symbol in self._place)


class CompiledModes:
    """The modes of an automaton, each compiled for an engine when it is first entered."""

    def __init__(self, solved: SolvedModes, engine: Engine) -> None:
        self.automaton, self.mode, self.taped = solved.automaton, solved.mode, solved.taped
        self.switches = solved.switches
        self.stops = solved.stops
        self.engine = engine
        self.solved = solved
        self._compiled: dict[tuple[Roles, frozenset[int]], CompiledMode] = {}
        self._built: set[Key] = set()

    def compiled(self, roles: Roles, zeros: frozenset[int]) -> CompiledMode:
        """Return the mode of `roles`, compiled for zero parameters at the places `zeros`."""
        found = self._compiled.get((roles, zeros))
        if found is None:
            taped = self.solved.taped(roles, zeros)
            mode = taped.mode
            found = next((made for made in self._compiled.values() if made.mode is mode), None)
            if found is None:
                found = self._compile(taped, roles, zeros)
                key = moving_mode(roles)
                if HELD not in key:
                    self._built.add(key)
            self._compiled[roles, zeros] = found
        return found

    def _compile(self, taped: TapedMode, roles: Roles, zeros: frozenset[int]) -> CompiledMode:
        """Let the engine compile the rates, unless they are those of another mode."""
        bare = uncaptured(roles)
        if bare == roles:
            if self.engine.allowance is not None:
                self.engine.allowance.check_for(self.engine.compiling(taped.rates))
            stepper = self.engine.compile(self.automaton, taped.mode, taped.rates)
        else:
            stepper = self.compiled(bare, zeros).stepper
        return CompiledMode(
            taped.mode, taped.guards, taped.rates, taped.reconstruction, taped.wholes, stepper
        )

    @property
    def built(self) -> int:
        """Number of modes that were compiled so far."""
        return len(self._built)
