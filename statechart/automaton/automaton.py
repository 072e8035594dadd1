"""The hybrid automaton: regions, modes, margins, laws of jumps.

A *mode* is one state per region; its *flow* is an ordinary differential equation; its *margins* are
expressions that are >= 0 in the mode (its invariant); an *event* is a margin falling below zero;
the laws map an event to a *jump*. Composition is conjunction: the state of a region contributes
equations in the shared unknowns, not a vector field.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.automaton.laws import Laws, Setup
from statechart.automaton.reduction import Coordinates
from statechart.automaton.regions import Invariant, Margin, Mode, Region, StopCondition, active_in
from statechart.automaton.time_stepper import TimeStepper
from statechart.automaton.trace import Key, Role, Trace
from statechart.errors import Unsupported
from statechart.palette import region_colours

if TYPE_CHECKING:
    from statechart.documents.declaration import Declaration
    from statechart.formulas.condition import Active
    from statechart.formulas.tape import Tape


NOT_RECORDED = "not recorded"
"""Label of the state of a region that a run does not record."""
NEUTRAL = re.compile(r"zz\d+zz")
"""Neutral names, shared by isomorphic components."""


@dataclass(frozen=True, eq=False)
class Automaton:
    """Regions composed over shared unknowns; modes are built on demand."""

    name: str
    declaration: Declaration  # outputs, stop, settings
    names: tuple[str, ...]  # of the variables
    variables: tuple[sp.Symbol, ...]
    parameter_names: tuple[str, ...]
    parameters: tuple[sp.Symbol, ...]
    time: sp.Symbol
    # Solved for in every mode: accelerations and forces, or rates; the first ones are paired with
    # `equations`.
    unknowns: tuple[sp.Symbol, ...]
    rates: tuple[sp.Expr, ...]  # d/dt of every variable, in variables and unknowns
    equations: tuple[sp.Expr, ...]  # of every mode, each = 0
    regions: tuple[Region, ...]  # in the order of the keys
    stops: tuple[StopCondition, ...]
    observables: Mapping[str, sp.Expr]  # name -> expression, for outputs, tables and figures
    # (overrides of parameters, relative tolerance) -> setup of a run
    setup: Callable[[Mapping[str, float], float], Setup]
    laws: Laws | None  # None if only time stepping can run the model
    idle: bool = False  # unknowns that no state sets are zero (chart variables without a flow)
    switching: bool = False  # formulas along flows are nonsmooth (abs, sign, min, max, sat)
    # Set by states of regions (`State.values`), exactly once in every mode, in order of evaluation.
    controls: tuple[sp.Symbol, ...] = ()
    stepper: Callable[[], TimeStepper] | None = None  # creates the time stepper, if any
    # Returns the default time step, from the scales of the model.
    default_step: Callable[[], float] | None = None
    coordinates: Coordinates | None = None  # of mechanics, for minimal coordinates
    components: Callable[[], tuple[Component, ...]] = tuple  # uncoupled parts; none if connected

    @property
    def laws_of_events(self) -> Laws:
        """The laws; raises `Unsupported` if only time stepping can run the model."""
        if self.laws is None:
            advice = (
                "write --engine impulse --step 1e-3, or settings: {engine: impulse, step: 1e-3}"
            )
            raise Unsupported(f"{self.name!r} runs with time steps only; {advice}")
        return self.laws

    @property
    def max_jumps(self) -> int:
        """Number of jumps after which a run ends."""
        return self.declaration.settings.max_jumps

    @property
    def modes_total(self) -> int:
        """Number of product modes, with directions of sliding."""
        return prod(len(region.states) for region in self.regions)

    @property
    def modes_declared(self) -> int:
        """Number of declared product modes, without directions of sliding."""
        return prod(len({*map(region.declared, region.states)}) for region in self.regions)

    @cached_property
    def stop_margins(self) -> tuple[Margin, ...]:
        """The margins of the stop conditions, the last ones of every mode."""
        return tuple(margin for stop in self.stops for margin in stop.margins)

    @cached_property
    def stop_of(self) -> Mapping[str, StopCondition]:
        """Margin -> its stop condition."""
        return {margin.name: stop for stop in self.stops for margin in stop.margins}

    def active(self, key: Key) -> Active:
        """Return the predicate (region, state) -> whether the state is active in a mode."""
        return active_in(self.recorded_regions(key), key)

    @cached_property
    def region_names(self) -> tuple[str, ...]:
        """Names of the regions, in the order of the keys."""
        return tuple(region.name for region in self.regions)

    @cached_property
    def places(self) -> tuple[Mapping[str, int], ...]:
        """Indices of regions, variables and parameters by name."""
        groups = self.region_names, self.names, self.parameter_names
        return tuple({name: place for place, name in enumerate(names)} for names in groups)

    @cached_property
    def colours(self) -> Mapping[str, Mapping[str, str]]:
        """Region -> state (with declared names) -> colour."""
        names = [(*r.innermost, *r.states, *map(r.declared, r.states)) for r in self.regions]
        return dict(zip(self.region_names, region_colours(names), strict=True))

    @cached_property
    def invariants(self) -> tuple[Invariant, ...]:
        """Declared assertions about runs, checked on traces."""
        declared = self.declaration.invariants.items()
        return tuple(Invariant(label, text, self.observables) for label, text in declared)

    def recorded_regions(self, key: Key) -> tuple[Region, ...]:
        """Return the regions of a key: all, or with `record: poses` the controllers."""
        return self.regions[len(self.regions) - len(key) :]

    def recorded_states(self, key: Key) -> list[tuple[str, ...]]:
        """Return the states of all regions, `NOT_RECORDED` for those missing in a key."""
        missing = [(NOT_RECORDED,)] * (len(self.regions) - len(key))
        return missing + [region.states for region in self.recorded_regions(key)]

    def label(self, key: Key) -> str:
        """Return the name of a mode: ``tip:slide+``, or ``A:free B:pin``."""
        states = zip(self.recorded_regions(key), key, strict=True)
        return " ".join(f"{region.name}:{state}" for region, state in states)

    def trace(self, values: Array, **found: Any) -> Trace:
        """Return the trace of a run with parameters `values` (p,)."""
        parameters = dict(zip(self.parameter_names, values.tolist(), strict=True))
        return Trace(self.name, self.region_names, self.names, parameters, **found)

    @cached_property
    def signs_of_time(self) -> Tape | None:
        """Functions of time alone whose signs are in the equations; None without any."""
        if not self.switching:
            return None
        signs = {sign for equation in self.equations for sign in equation.atoms(sp.sign)}
        fixed = {self.time, *self.parameters}
        functions = [s.args[0] for s in sp.ordered(signs) if self.time in s.free_symbols <= fixed]
        return self.tape(functions) if functions else None

    def tape(
        self,
        expressions: Sequence[sp.Expr],
        mode: Mode | None = None,
        further: Sequence[sp.Symbol] = (),
    ) -> Tape:
        """Return the tape of expressions in variables, `further` ones, and unknowns of a mode."""
        # Imported here, since its kernels take long to load.
        from statechart.formulas.writer import compile_tape

        return compile_tape(
            expressions, variables=(*self.variables, *further), parameters=self.parameters,
            time=self.time, definitions=mode.definitions if mode else (),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Component:
    """An uncoupled part of a model."""

    automaton: Automaton  # in neutral names, shared by isomorphic components
    names: Mapping[str, str]  # neutral name -> name
    restricted: Callable[[Setup, Places], Setup]  # setup of the whole -> setup of the component
    shown: Callable[[Role, Places], Role]  # role in the component -> role in the whole
    jump_together: frozenset[str]  # regions whose simultaneous jumps are one jump

    def named(self, text: str) -> str:
        """Return a text with declared instead of neutral names."""
        return NEUTRAL.sub(lambda found: self.names.get(found[0], found[0]), text)


class Places:
    """Indices of the regions, variables and parameters of a component in the whole."""

    def __init__(self, component: Component, whole: Automaton) -> None:
        self.whole = whole
        self.regions, self.variables, self.parameters = (
            np.array([index[component.named(name)] for name in names], np.int64)
            for index, names in zip(whole.places, component.automaton.places, strict=True)
        )
