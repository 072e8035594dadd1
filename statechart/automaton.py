"""The hybrid automaton: regions, modes, margins, and the laws at the instants between flows.

Vocabulary: a *mode* is one state per region; its *flow* is an ordinary differential equation; its
*margins* are expressions that stay >= 0 while the mode holds (its invariant); an *event* is a
margin falling; a *jump* is what the laws make of an event. Composition is conjunction: a region's
state contributes equations in the shared unknowns, never a vector field of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.errors import Unsupported
from statechart.trace import Clock, Jump, Key

if TYPE_CHECKING:
    from statechart.compose import Mode
    from statechart.constraints import Constraints
    from statechart.documents.declaration import Declaration
    from statechart.feasibility import Feasibility
    from statechart.stepping import TimeStepper


_NOTHING: Mapping[str, Any] = MappingProxyType({})

Kind = Literal["plain", "gap", "speed", "force"]

HELD = ""
"""In the key of a flow: a region whose state contributes nothing, so that what it moves rests."""

UNBOUNDED = "unbounded"
"""What ends a flow that cannot be continued, though no margin fell; the laws may know what follows
(a force that has grown without bound)."""


CAPTURED = "~"
"""In the key of a flow, before a state: the region is shown in another meanwhile, and for everybody
else its forces are what they are in that: zero."""


@lru_cache(maxsize=1024)
def uncaptured(flow: Key) -> Key:
    """Return the flow that moves the state as `flow` does, with nothing hidden from others."""
    return tuple(state.removeprefix(CAPTURED) for state in flow)


@lru_cache(maxsize=1024)
def plain(flow: Key) -> Key:
    """Return the mode of a flow: its states without what chooses among equivalent equations.

    Where a mode's equations leave quantities open that do not change the motion, a flow says after
    the state's name, separated by ``|``, what determines them (``pin|inside|nt|nt|0,1,2|``).
    """
    return tuple(state.partition("|")[0] for state in uncaptured(flow))


@dataclass(frozen=True)
class Margin:
    """An expression that is >= 0 while a mode holds.

    Attributes
    ----------
    name : str
        Such as ``tip.gap`` or ``tip.mu V - H``.
    expression : Expr
        In variables, parameters, time and unknowns.
    kind : str
        Which tolerance decides it. A `force` margin is an event once it is below minus its
        tolerance (hysteresis, so that the mode just left is not entered again); the others are
        located at their zero.
    """

    name: str
    expression: sp.Expr
    kind: Kind = "plain"


@dataclass(frozen=True)
class Loads:
    """Unknowns that the motion leaves open: something carries them in the equations of motion.

    They are solved for when the motion is known, by equations of their own.

    Attributes
    ----------
    carried : mapping
        Unknown of the automaton -> what stands for it in the equations of motion.
    carriers : tuple of Symbol
        The unknowns of that.
    laws : mapping
        Unknown -> its equation (= 0), linear in what is carried and in further unknowns.
    balances : mapping
        Unknown, which states share -> what this one adds to a sum over them that is zero.
    """

    carried: Mapping[sp.Symbol, sp.Expr]
    carriers: tuple[sp.Symbol, ...]
    laws: Mapping[sp.Symbol, sp.Expr]
    balances: Mapping[sp.Symbol, sp.Expr]


@dataclass(frozen=True)
class State:
    """What one state of a region contributes to a mode.

    Attributes
    ----------
    equations : tuple of Expr
        Each = 0, linear in the automaton's unknowns and its carriers.
    margins : tuple of Margin
        What an event of the state is the fall of.
    invariants : tuple of Margin
        What its declaration asserts besides; for checks of a trace, no run looks at them.
    values : mapping
        What the state sets: some of the automaton's controls -> expressions without unknowns.
    loads : Loads or None
        What it adds where the mode's motion leaves some of its unknowns open.
    """

    equations: tuple[sp.Expr, ...] = ()
    margins: tuple[Margin, ...] = ()
    invariants: tuple[Margin, ...] = ()
    values: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)
    loads: Loads | None = None


@dataclass(frozen=True)
class Edge:
    """A transition of a region, as text for people.

    Attributes
    ----------
    cause : str
        touchdown, liftoff, ... or the transition's name.
    source, target : str
        States of the region.
    guard, reset : str
        What fires it and what it does; "" where nothing is changed.
    on_zeno : bool
        True where no guard fires it but the accumulation of jumps out of `source`.
    """

    cause: str
    source: str
    target: str
    guard: str
    reset: str = ""
    on_zeno: bool = False


@dataclass(frozen=True, eq=False)
class Region:
    """An orthogonal region: its states, built when first asked for, and its edges.

    Attributes
    ----------
    name : str
        Of the region (a contact, a controller).
    states : tuple of str
        Names of its states.
    build : callable
        Name -> State.
    edges : tuple of Edge
        The region's own statechart.
    groups : mapping
        State -> the state as its declaration names it, where that differs (slide+ -> slide).
    forces : tuple of Symbol
        Unknowns that are zero for others while the region is captured (see `CAPTURED`).
    """

    name: str
    states: tuple[str, ...]
    build: Callable[[str], State]
    edges: tuple[Edge, ...]
    groups: Mapping[str, str] = field(default_factory=dict)
    forces: tuple[sp.Symbol, ...] = ()

    def declared(self, state: str) -> str:
        """Return the state as the declaration names it."""
        return self.groups.get(state, state)


@dataclass(frozen=True, eq=False)
class Setup:
    """The numbers of one run.

    Attributes
    ----------
    values : (p,) array
        Of the automaton's parameters.
    initial : (n,) array
        Initial state.
    tolerances : mapping
        Kind of margin -> absolute tolerance, in the scene's own units.
    relative : float
        The relative tolerance that they follow from.
    short : float
        The laws are asked to skip the rest of a sequence of jumps that accumulate once it takes
        less than this part of the sequence's longest interval.
    warnings : tuple of str
        What a reader must know of these numbers.
    sizes : (n,) array or None
        How large each variable is, where the model has scales of its own.
    horizon : float
        A long time for the first flow, in the model's own scales: how far to look ahead at first.
    modes : callable or None
        Key of a flow -> its mode, solved for the parameters of the run; set by the executor.
    """

    values: NDArray[np.float64]
    initial: NDArray[np.float64]
    tolerances: Mapping[str, float]
    relative: float
    short: float = 0.0
    warnings: tuple[str, ...] = ()
    sizes: NDArray[np.float64] | None = None
    horizon: float = float("inf")
    modes: Callable[[Key], Mode] | None = None

    @cached_property
    def zeros(self) -> frozenset[int]:
        """Places of the parameters that are exactly zero."""
        return frozenset(np.flatnonzero(self.values == 0.0).tolist())


class Flow(NamedTuple):
    """What the executor does next: flow in a mode, possibly shown as another, possibly timed.

    Attributes
    ----------
    mode : Key
        The mode shown.
    flow : Key
        The mode whose equations apply; `HELD` in the place of a region that is held.
    remaining : float
        Time until the laws are asked again even if no margin falls (a Zeno sequence's
        accumulation); inf otherwise.
    warning : str
        What a reader must know of the choice of this mode; "" where nothing.
    settled : bool
        True when the laws have seen the state that the flow starts from and keep the mode.
    notes : tuple of str
        What a reader must know of the mode, told once.
    held : mapping
        Region -> when its Zeno sequence, whose rest is skipped, comes to its end.
    tolerances : mapping
        Margin -> its tolerance in this flow, where that of its kind is not the one.
    terms : (n, k) array or None
        What each variable was summed from when the last flow ended, at a time that is rounded;
        None before the first. Kept by the executor.
    summed : (n,) array or None
        How large the terms are that jumps since then have summed each variable from.
    pending : mapping
        Region -> the jumps of this instant that it has yet to hear of. None outlasts the instant.
    start : (n,) array or None
        Where to flow on from, where a mode holds but its state is brought back onto its
        constraints; None where it is the state that the laws were asked about.
    """

    mode: Key
    flow: Key
    remaining: float = float("inf")
    warning: str = ""
    settled: bool = False
    notes: tuple[str, ...] = ()
    held: Mapping[str, Clock] = _NOTHING
    tolerances: Mapping[str, float] = _NOTHING
    terms: NDArray[np.float64] | None = None
    summed: NDArray[np.float64] | None = None
    pending: Mapping[str, tuple[Jump, ...]] = _NOTHING
    start: NDArray[np.float64] | None = None

    @property
    def sizes(self) -> NDArray[np.float64] | None:
        """How large the terms of each variable are; its rounding is relative to them."""
        return None if self.terms is None else np.abs(self.terms).sum(axis=1)


class Laws(Protocol):
    """What happens at the instants between flows; the executor knows nothing else."""

    def begin(self, setup: Setup) -> tuple[Flow, NDArray[np.float64]]:
        """Return the first mode and the state to start from."""
        ...

    def jump(
        self,
        setup: Setup,
        clock: Clock,
        j: int,
        flow: Flow,
        state: NDArray[np.float64],
        fired: tuple[str, ...],
    ) -> tuple[Jump | None, Flow] | None:
        """Return the jump that the state calls for, or None when the mode holds.

        A flow without a jump: the mode holds, but by other equations, or from another start.
        """
        ...

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Skip the rest of a sequence of jumps that accumulate.

        Parameters
        ----------
        jumps : sequence of Jump
            The last ones; the last of them is the one after which the rest can be skipped.
        rest : float
            Time to the accumulation.

        Returns
        -------
        (Jump, Flow) or None
            The last jump and the flow after it, changed; None where the sequence has to go on.

        Raises
        ------
        Zeno
            If nothing declared says what follows.
        """
        ...

    def constraints(
        self, setup: Setup, flow: Key, start: float, anchor: NDArray[np.float64]
    ) -> Constraints:
        """Return what the states of a flow satisfy.

        The flow begins in the state `anchor` at the time `start`.
        """
        ...

    def feasibility(
        self, regions: Sequence[Region], setup: Setup, state: Array, time: float
    ) -> Feasibility | None:
        """Judge every product mode of the regions at a configuration.

        None where there is no reason against any; see `statechart.feasibility.feasibility`.
        """
        ...


@dataclass(frozen=True, eq=False)
class Automaton:
    """Regions composed over shared unknowns; topology and modes on demand.

    Attributes
    ----------
    name : str
        Of the model.
    declaration : Declaration
        The document it was made from (outputs, stop, settings).
    names, variables : tuple
        Names and symbols of the state's variables.
    parameter_names, parameters : tuple
        Names and symbols of the parameters.
    time : Symbol
        Time, in expressions.
    unknowns : tuple of Symbol
        Solved for in every mode: accelerations and forces, or rates; first those that belong to
        `equations`, one by one.
    rates : tuple of Expr
        d/dt of every variable, in variables and unknowns.
    equations : tuple of Expr
        The equations that hold in every mode, each = 0.
    regions : tuple of Region
        In the order of the keys.
    stops : mapping
        Stop condition -> margin that falls when it becomes true.
    observables : mapping
        Name -> expression; what outputs, tables and figures can show.
    setup : callable
        From overrides of parameters and a relative tolerance to the numbers of a run.
    laws : Laws or None
        Initial mode, jumps, projection; None where only steps can run the model.
    idle : bool
        True where an unknown that no state sets is zero (a chart's variable without a flow).
    controls : tuple of Symbol
        What the states of regions set (`State.values`), in an order in which each value uses
        only those before it. In every mode exactly one state sets each.
    stepper : callable or None
        Makes what steps the model through time without its modes, where its kind offers that.
    own_step : callable or None
        Where nothing but steps can run the model: returns how long they should be, by its scales.
    """

    name: str
    declaration: Declaration
    names: tuple[str, ...]
    variables: tuple[sp.Symbol, ...]
    parameter_names: tuple[str, ...]
    parameters: tuple[sp.Symbol, ...]
    time: sp.Symbol
    unknowns: tuple[sp.Symbol, ...]
    rates: tuple[sp.Expr, ...]
    equations: tuple[sp.Expr, ...]
    regions: tuple[Region, ...]
    stops: Mapping[str, Margin]
    observables: Mapping[str, sp.Expr]
    setup: Callable[[Mapping[str, float], float], Setup]
    laws: Laws | None
    idle: bool = False
    controls: tuple[sp.Symbol, ...] = ()
    stepper: Callable[[], TimeStepper] | None = None
    own_step: Callable[[], float] | None = None

    @property
    def laws_of_events(self) -> Laws:
        """The laws, for those who cannot do without.

        Raises
        ------
        Unsupported
            If only steps can run the model.
        """
        if self.laws is None:
            raise Unsupported(
                f"{self.name!r} runs on the engine impulse alone: say --engine impulse "
                "--step 1e-3, or write settings: {engine: impulse, step: 1e-3}"
            )
        return self.laws

    @property
    def modes_total(self) -> int:
        """Number of product modes, directions of sliding told apart."""
        total = 1
        for region in self.regions:
            total *= len(region.states)
        return total

    @property
    def modes_declared(self) -> int:
        """Number of product modes as the declaration counts them (sliding without direction)."""
        total = 1
        for region in self.regions:
            total *= len({region.declared(state) for state in region.states})
        return total

    @cached_property
    def _outgoing(self) -> tuple[Mapping[str, tuple[Edge, ...]], ...]:
        return tuple(
            {s: tuple(e for e in region.edges if e.source == s) for s in region.states}
            for region in self.regions
        )

    def successors(self, key: Key) -> Iterator[tuple[Key, Region, Edge]]:
        """Yield the modes one edge of one region away from `key`."""
        for place, (region, outgoing) in enumerate(zip(self.regions, self._outgoing, strict=True)):
            for edge in outgoing[key[place]]:
                yield (*key[:place], edge.target, *key[place + 1 :]), region, edge

    def label(self, key: Key) -> str:
        """Return the name of a mode: ``tip:slide+``, or ``A:free B:pin``."""
        return " ".join(
            f"{region.name}:{state}" for region, state in zip(self.regions, key, strict=True)
        )
