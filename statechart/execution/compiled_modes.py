"""Modes compiled when a run first enters them, and kept for the next one."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import CAPTURED, HELD, shown_mode, uncaptured
from statechart.automaton.modes import build_mode, captured
from statechart.automaton.regions import Mode
from statechart.automaton.trace import Key
from statechart.engines.engine import Engine
from statechart.formulas.tape import Tape, compile_tape


@dataclass(frozen=True, eq=False)
class CompiledMode:
    """A mode with its guards on tape, and what an engine made of its rates.

    Attributes
    ----------
    mode : Mode
        Equations and margins.
    guards : Tape
        Outputs: the margins, in order.
    watched : tuple of (str, str)
        Name and kind of every margin.
    names : tuple of str
        The names.
    stepper : object
        The engine's own.
    """

    mode: Mode
    guards: Tape
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
        self._modes: dict[tuple[Key, frozenset[int]], Mode] = {}
        self._compiled: dict[tuple[Key, frozenset[int]], CompiledMode] = {}
        self._built: set[Key] = set()

    def compiled(self, key: Key, zeros: frozenset[int]) -> CompiledMode:
        """Return the mode `key`, compiled for zero parameters at the places `zeros`."""
        found = self._compiled.get((key, zeros))
        if found is None:
            mode = self.mode(key, zeros)
            found = next((made for made in self._compiled.values() if made.mode is mode), None)
            if found is None:
                bare = uncaptured(key)
                stepper = None if bare == key else self.compiled(bare, zeros).stepper
                found = self._compile(mode, stepper)
                if HELD not in key:
                    self._built.add(shown_mode(key))
            self._compiled[key, zeros] = found
        return found

    def _compile(self, mode: Mode, stepper: object) -> CompiledMode:
        """Put guards on tape; without a `stepper`, let the engine compile the rates."""
        automaton = self.automaton
        guards = compile_tape(
            [margin.expression for margin in mode.margins],
            variables=automaton.variables,
            parameters=automaton.parameters,
            time=automaton.time,
            definitions=mode.definitions,
        )
        watched = tuple((margin.name, margin.kind) for margin in mode.margins)
        names = tuple(margin.name for margin in mode.margins)
        stepper = stepper or self.engine.compile(automaton, mode)
        return CompiledMode(mode, guards, watched, names, stepper)

    def mode(self, key: Key, zeros: frozenset[int]) -> Mode:
        """Return the mode `key`, solved where the parameters at the places `zeros` are zero."""
        found = self._modes.get((key, zeros))
        if found is None:
            # Zeros that its equations do not mention call for no mode of its own.
            mentioned = zeros & self._used(key)
            found = self._modes.get((key, mentioned))
            if found is None:
                symbols, bare = self.automaton.parameters, uncaptured(key)
                if bare != key:
                    found = captured(self.automaton, self.mode(bare, zeros), key)
                else:
                    gone = frozenset(symbols[i] for i in mentioned)
                    found = build_mode(self.automaton, key, gone)
                self._modes[key, mentioned] = found
            self._modes[key, zeros] = found
        return found

    def _used(self, key: Key) -> frozenset[int]:
        """Return the places of the parameters that the equations of `key` mention."""
        automaton = self.automaton
        parts = list(automaton.equations) + list(automaton.rates)
        for region, name in zip(automaton.regions, key, strict=True):
            state = region.build(name.removeprefix(CAPTURED))
            parts += (*state.equations, *state.values.values())
        used: set[sp.Symbol] = set().union(*(part.free_symbols for part in parts))
        return frozenset(i for i, symbol in enumerate(automaton.parameters) if symbol in used)

    @property
    def built(self) -> int:
        """Number of modes whose equations were built so far."""
        return len(self._built)
