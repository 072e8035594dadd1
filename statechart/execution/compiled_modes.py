"""Modes compiled when a run first enters them, and kept for the next one."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import HELD, moving_mode, uncaptured
from statechart.automaton.modes import build_mode, captured
from statechart.automaton.regions import Mode
from statechart.automaton.trace import Key, Roles
from statechart.engines.engine import Engine
from statechart.formulas.tape import Tape


@dataclass(frozen=True, eq=False)
class CompiledMode:
    """A mode with its guards on tape, and what an engine made of its rates.

    Attributes
    ----------
    mode : Mode
        Equations and margins.
    guards : Tape
        Outputs: the margins, in order.
    rates : Tape
        Outputs: the rates of all variables.
    watched : tuple of (str, str)
        Name and kind of every margin.
    names : tuple of str
        The names.
    stepper : object
        The engine's own.
    """

    mode: Mode
    guards: Tape
    rates: Tape
    watched: tuple[tuple[str, str], ...]
    names: tuple[str, ...]
    stepper: object

    def kind(self, guard: int) -> str:
        """Return the kind of a margin."""
        return self.watched[guard][1]


class CompiledModes:
    """The modes of an automaton, each solved and compiled for an engine when it is first asked for.

    Parameters
    ----------
    automaton : Automaton
        What is run.
    engine : Engine
        What it is run on.
    """

    def __init__(self, automaton: Automaton, engine: Engine) -> None:
        self.automaton = automaton
        self.engine = engine
        self._modes: dict[tuple[Roles, frozenset[int]], Mode] = {}
        self._compiled: dict[tuple[Roles, frozenset[int]], CompiledMode] = {}
        self._built: set[Key] = set()

    def compiled(self, roles: Roles, zeros: frozenset[int]) -> CompiledMode:
        """Return the mode of `roles`, compiled for zero parameters at the places `zeros`."""
        found = self._compiled.get((roles, zeros))
        if found is None:
            mode = self.mode(roles, zeros)
            found = next((made for made in self._compiled.values() if made.mode is mode), None)
            if found is None:
                bare = uncaptured(roles)
                found = self._compile(mode, None if bare == roles else self.compiled(bare, zeros))
                key = moving_mode(roles)
                if HELD not in key:
                    self._built.add(key)
            self._compiled[roles, zeros] = found
        return found

    def _compile(self, mode: Mode, bare: CompiledMode | None) -> CompiledMode:
        """Put guards on tape; let the engine compile the rates unless they are those of `bare`."""
        automaton = self.automaton
        guards = automaton.tape([margin.expression for margin in mode.margins], mode)
        watched = tuple((margin.name, margin.kind) for margin in mode.margins)
        names = tuple(margin.name for margin in mode.margins)
        if bare is not None:
            return CompiledMode(mode, guards, bare.rates, watched, names, bare.stepper)
        rates = automaton.tape(mode.rates, mode)
        stepper = self.engine.compile(automaton, mode, rates)
        return CompiledMode(mode, guards, rates, watched, names, stepper)

    def mode(self, roles: Roles, zeros: frozenset[int]) -> Mode:
        """Return the mode of `roles`, solved for zero parameters at the places `zeros`."""
        found = self._modes.get((roles, zeros))
        if found is None:
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

    def _used(self, roles: Roles) -> frozenset[int]:
        """Return the places of the parameters that the equations of `roles` mention."""
        automaton = self.automaton
        parts = list(automaton.equations) + list(automaton.rates)
        for region, role in zip(automaton.regions, roles, strict=True):
            state = region.build(role)
            parts += (*state.equations, *state.values.values())
        used: set[sp.Symbol] = set().union(*(part.free_symbols for part in parts))
        return frozenset(i for i, symbol in enumerate(automaton.parameters) if symbol in used)

    @property
    def built(self) -> int:
        """Number of modes whose equations were built so far."""
        return len(self._built)
