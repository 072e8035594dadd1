"""The hybrid automaton: regions, modes, margins, and the laws at the instants between flows.

Vocabulary: a *mode* is one state per region; its *flow* is an ordinary differential equation; its
*margins* are expressions that stay >= 0 while the mode holds (its invariant); an *event* is a
margin falling; a *jump* is what the laws make of an event. Composition is conjunction: a region's
state contributes equations in the shared unknowns, never a vector field of its own.
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

from statechart.arrays import Array, Ints
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
"""Word shown for the state of a region whose modes a run does not record."""
NEUTRAL = re.compile(r"zz\d+zz")
"""Names that alike components share."""


@dataclass(frozen=True, eq=False)
class Automaton:
    """Regions composed over shared unknowns; topology and modes on demand."""

    name: str  # Name of the model.
    declaration: Declaration  # The document it was made from (outputs, stop, settings).
    # Names and symbols of the state's variables.
    names: tuple[str, ...]
    variables: tuple[sp.Symbol, ...]
    # Names and symbols of the parameters.
    parameter_names: tuple[str, ...]
    parameters: tuple[sp.Symbol, ...]
    time: sp.Symbol  # Time, in expressions.
    # Solved for in every mode: accelerations and forces, or rates; first those that belong to
    # `equations`, one by one.
    unknowns: tuple[sp.Symbol, ...]
    rates: tuple[sp.Expr, ...]  # d/dt of every variable, in variables and unknowns.
    equations: tuple[sp.Expr, ...]  # The equations that hold in every mode, each = 0.
    regions: tuple[Region, ...]  # In the order of the keys.
    stops: tuple[StopCondition, ...]  # Conditions that end a run.
    # Name -> expression; what outputs, tables and figures can show.
    observables: Mapping[str, sp.Expr]
    # From overrides of parameters and a relative tolerance to the numbers of a run.
    setup: Callable[[Mapping[str, float], float], Setup]
    laws: Laws | None  # Initial mode, jumps, projection; None where only steps can run the model.
    # True where an unknown that no state sets is zero (a chart's variable without a flow).
    idle: bool = False
    # True where formulas along a flow switch (abs, sign, min, max, sat).
    switching: bool = False
    # Controls set by states of regions (`State.values`), in an order in which each value uses only
    # those before it. In every mode exactly one state sets each.
    controls: tuple[sp.Symbol, ...] = ()
    # Makes what steps the model through time without its modes, where its kind offers that.
    stepper: Callable[[], TimeStepper] | None = None
    # Returns the step by the model's scales, if only steps can run the model.
    own_step: Callable[[], float] | None = None
    # Coordinates by which modes may be reduced, if the equations are those of mechanics.
    coordinates: Coordinates | None = None
    # Returns the parts that have nothing to do with each other; none where all belong together.
    components: Callable[[], tuple[Component, ...]] = tuple

    @property
    def laws_of_events(self) -> Laws:
        """The laws; raises `Unsupported` if only steps can run the model."""
        if self.laws is None:
            raise Unsupported(
                f"{self.name!r} runs by steps only; write --engine impulse --step 1e-3, or "
                "settings: {engine: impulse, step: 1e-3}"
            )
        return self.laws

    @property
    def modes_total(self) -> int:
        """Number of product modes, directions of sliding told apart."""
        return prod(len(region.states) for region in self.regions)

    @property
    def modes_declared(self) -> int:
        """Number of product modes as the declaration counts them (sliding without direction)."""
        return prod(len({*map(region.declared, region.states)}) for region in self.regions)

    @cached_property
    def stop_margins(self) -> tuple[Margin, ...]:
        """The margins of the stop conditions, which stand last among those of every mode."""
        return tuple(margin for stop in self.stops for margin in stop.margins)

    @cached_property
    def stop_of(self) -> Mapping[str, StopCondition]:
        """Margin -> the stop condition that it belongs to."""
        return {margin.name: stop for stop in self.stops for margin in stop.margins}

    def active(self, key: Key) -> Active:
        """Return the test whether a region is in a state, or in one inside it."""
        return active_in(self.recorded_regions(key), key)

    @cached_property
    def region_names(self) -> tuple[str, ...]:
        """Names of the regions, in the order of the keys."""
        return tuple(region.name for region in self.regions)

    @cached_property
    def colours(self) -> Mapping[str, Mapping[str, str]]:
        """Region -> state, also as declared -> its colour in every picture."""
        names = [
            (*region.innermost, *region.states, *map(region.declared, region.states))
            for region in self.regions
        ]
        return dict(zip(self.region_names, region_colours(names), strict=True))

    @cached_property
    def invariants(self) -> tuple[Invariant, ...]:
        """Assertions of the declaration about all of a run; runs do not evaluate them."""
        return tuple(
            Invariant(label, text, self.observables)
            for label, text in self.declaration.invariants.items()
        )

    def recorded_regions(self, key: Key) -> tuple[Region, ...]:
        """Return the regions whose states a key has: all, or where poses are kept controllers."""
        return self.regions[len(self.regions) - len(key) :]

    def recorded_states(self, key: Key) -> list[tuple[str, ...]]:
        """Return the states of all regions; of those that a key has not, `NOT_RECORDED`."""
        missing = len(self.regions) - len(key)
        return [(NOT_RECORDED,)] * missing + [
            region.states for region in self.recorded_regions(key)
        ]

    def label(self, key: Key) -> str:
        """Return the name of a mode: ``tip:slide+``, or ``A:free B:pin``."""
        return " ".join(
            f"{region.name}:{state}"
            for region, state in zip(self.recorded_regions(key), key, strict=True)
        )

    def trace(self, values: Array, **found: Any) -> Trace:
        """Return the trace of a run with these values (p,) of the parameters."""
        parameters = dict(zip(self.parameter_names, values.tolist(), strict=True))
        return Trace(self.name, self.region_names, self.names, parameters, **found)

    def tape(self, expressions: Sequence[sp.Expr], mode: Mode | None = None) -> Tape:
        """Return expressions in the variables as a program; in a mode, also in what it solves."""
        # The kernels behind it are not needed to compose an automaton, and take long to load.
        from statechart.formulas.writer import compile_tape

        return compile_tape(
            expressions,
            variables=self.variables,
            parameters=self.parameters,
            time=self.time,
            definitions=mode.definitions if mode else (),
        )


@dataclass(frozen=True, eq=False)
class Component:
    """A part of a model that has nothing to do with the rest."""

    automaton: Automaton  # Its own, in neutral names; alike components share it.
    names: Mapping[str, str]  # Neutral name -> name.
    # From the numbers of a run of the whole to those of a run of the component.
    restricted: Callable[[Setup, Places], Setup]
    # From the role of a region in the component to that in the whole.
    shown: Callable[[Role, Places], Role]
    # Components that jump at one instant do so in one jump, not one after another.
    joint: bool

    def named(self, text: str) -> str:
        """Return a text with the names that the model declares."""
        return NEUTRAL.sub(lambda found: self.names.get(found[0], found[0]), text)


class Places:
    """Places of a component's regions, variables and parameters in the whole, arrays of int."""

    def __init__(self, component: Component, whole: Automaton) -> None:
        part, named = component.automaton, component.named

        def places(names: Sequence[str], of: Sequence[str]) -> Ints:
            index = {name: place for place, name in enumerate(of)}
            return np.array([index[named(name)] for name in names], np.int64)

        self.whole = whole
        self.regions = places(part.region_names, whole.region_names)
        self.variables = places(part.names, whole.names)
        self.parameters = places(part.parameter_names, whole.parameter_names)
