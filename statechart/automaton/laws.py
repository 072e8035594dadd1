"""The laws of an automaton: what happens at the instants between flows, and by time steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from statechart.arrays import EPS, Array
from statechart.automaton.clock import Clock
from statechart.automaton.regions import Raised, Region
from statechart.automaton.trace import Arc, Jump, Key, Role, Roles

if TYPE_CHECKING:
    from statechart.automaton.constraints import Constraints
    from statechart.automaton.regions import Mode
    from statechart.automaton.trace_store import RecordedEvent
    from statechart.formulas.tape import Tape

_NOTHING: Mapping[str, Any] = MappingProxyType({})

HELD = ""
"""Role of a region without equations: the coordinates that it moves rest."""

SWITCHES = "switches"
"""In a role behind those of the regions: its share are the signs of the switches of a flow (see
`statechart.automaton.switches`)."""

PARAMETERS = "parameters"
"""In a role behind those of the regions: its share are the places and values of parameters that
differ in a flow from those of the run (which constraint of a linkage the others imply)."""

OTHER_PARAMETERS = "other parameters"
"""End of a flow whose equations need other values of these parameters; no margin fell."""

UNBOUNDED = "unbounded"
"""End of a flow that cannot be continued, though no margin fell; the laws may know the jump that
follows (a force that has grown without bound)."""


@lru_cache(maxsize=1024)
def roles_in(mode: Key) -> Roles:
    """Return the roles of regions whose equations are those of their states."""
    # Thousands of regions share a few states.
    roles = {state: Role(state) for state in set(mode)}
    return tuple([roles[state] for state in mode])


def of_regions(roles: Roles) -> Roles:
    """Return roles without those of parameters and switches, which may stand behind them."""
    while roles and roles[-1].state in (PARAMETERS, SWITCHES):
        roles = roles[:-1]
    return roles


@lru_cache(maxsize=1024)
def uncaptured(roles: Roles) -> Roles:
    """Return the roles that move the state as `roles` do, with nothing hidden from others."""
    return tuple([role._replace(captured=False) for role in roles])


@lru_cache(maxsize=1024)
def moving_mode(roles: Roles) -> Key:
    """Return the states whose equations apply."""
    return tuple([role.state for role in of_regions(roles)])


@dataclass(frozen=True, eq=False)
class Setup:
    """The numbers of one run."""

    values: Array  # (p,): of the automaton's parameters.
    initial: Array  # (n,): initial state.
    # Kind of margin -> absolute tolerance, in the scene's own units.
    tolerances: Mapping[str, float]
    # The laws are asked to skip the rest of a sequence of jumps that accumulate once it takes less
    # than this part of the sequence's longest interval.
    short: float = 0.0
    warnings: tuple[str, ...] = ()  # Remarks on these numbers for the reader.
    # (n,): how large each variable is, where the model has scales of its own.
    sizes: Array | None = None
    # Precision of margins, in parts of their terms: a value summed from them is off by a few
    # units in the last place of the largest.
    precision: float = 64.0 * EPS
    # A long time for the first flow, in the model's own scales: how far to look ahead at first.
    horizon: float = float("inf")
    # Roles of a flow -> its mode, solved for the parameters of the run; set by the executor.
    modes: Callable[[Roles], Mode] | None = None

    @cached_property
    def zeros(self) -> frozenset[int]:
        """Places of the parameters that are exactly zero."""
        return frozenset(np.flatnonzero(self.values == 0.0).tolist())


class Flow(NamedTuple):
    """Next flow of the executor: its mode, possibly shown as another, possibly timed."""

    mode: Key  # The mode shown.
    roles: Roles  # Whose equations apply; `HELD` is the state of a region that is held.
    # Time until the laws are asked again even if no margin falls (a Zeno sequence's accumulation);
    # inf otherwise.
    remaining: float = float("inf")
    warning: str = ""  # Warning about the choice of this mode; "" if none.
    # True when the laws have seen the state that the flow starts from and keep the mode.
    settled: bool = False
    notes: tuple[str, ...] = ()  # Warnings about the mode, given once.
    # Region -> when its Zeno sequence, whose rest is skipped, comes to its end.
    held: Mapping[str, Clock] = _NOTHING
    # Margin -> its tolerance in this flow, where that of its kind is not the one.
    tolerances: Mapping[str, float] = _NOTHING
    # (n, k): what each variable was summed from when the last flow ended, at a time that is
    # rounded; None before the first. Kept by the executor.
    terms: Array | None = None
    # (n,): how large the terms are that jumps since then have summed each variable from.
    summed: Array | None = None
    # Region -> the events of this instant that it has yet to hear. None outlasts the instant.
    pending: Mapping[str, tuple[Raised, ...]] = _NOTHING
    # (n,): where to flow on from, where a mode holds but its state is brought back onto its
    # constraints; None where it is the state that the laws were asked about.
    start: Array | None = None
    # (p,): the parameters of this flow; None where they are those of the run.
    values: Array | None = None
    # Forces may begin beyond their bounds, by the error of the run: then they fall from where they
    # begin.
    near_bound: bool = False
    # The signs of its switches as a role; none where it has no switches. Kept by the executor.
    signs: Roles = ()
    # Its own parameters as a role; none where they are those of the run. Kept by the executor.
    fixed: Roles = ()

    @property
    def moving(self) -> Roles:
        """The roles with parameters and the signs of switches: what the equations follow from."""
        return (*self.roles, *self.fixed, *self.signs) if self.fixed or self.signs else self.roles

    @property
    def sizes(self) -> Array | None:
        """Sizes of the terms of each variable; its round-off is relative to them."""
        return None if self.terms is None else np.abs(self.terms).sum(axis=1)


class Instant(NamedTuple):
    """End of a flow, as the input of the laws."""

    setup: Setup  # The numbers of the run.
    clock: Clock  # Its time.
    j: int  # Number of jumps before it.
    flow: Flow  # The flow that ends here.
    state: Array  # (n,): values of the variables.
    fired: tuple[str, ...] = ()  # Margins that have fallen.

    def jump(
        self, region: str, cause: str, target: Key, after: Array | None = None, **details: Any
    ) -> Jump:
        """Return a jump from here to a mode, and to a state where that changes."""
        return Jump(
            self.clock.high,
            self.j,
            region,
            cause,
            self.flow.mode,
            target,
            self.state,
            self.state if after is None else after,
            self.fired,
            **details,
        )


def flow_sizes(setup: Setup, flow: Flow, state: Array) -> Array:
    """Return the sizes (n,) of the terms that the variables were summed from, or of themselves."""
    result = np.abs(state)
    for sizes in (setup.sizes, flow.sizes if flow.summed is None else flow.summed):
        if sizes is not None:
            result = np.maximum(result, sizes)
    return result


class Laws(Protocol):
    """Jumps at the instants between flows; the executor knows nothing else."""

    @property
    def compiled_laws(self) -> CompiledLaws | None:
        """The part of the laws that is compiled."""
        ...

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the first mode and the state to start from."""
        ...

    def jump(self, at: Instant) -> tuple[Jump | None, Flow] | None:
        """Return the jump that the state calls for, or None when the mode holds.

        A flow without a jump: the mode holds, but by other equations, or from another start.
        """
        ...

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Skip the rest of a sequence of jumps that accumulate.

        `jumps` are the last ones; behind the last of them the rest can be skipped, which takes the
        time `rest`. Returns that jump and the flow after it, changed; None where the sequence has
        to go on. Raises `Zeno` if nothing declared says what follows.
        """
        ...

    def constraints(self, setup: Setup, roles: Roles, start: float, anchor: Array) -> Constraints:
        """Return the constraints that the states of a flow satisfy.

        The flow begins in the state `anchor` at the time `start`.
        """
        ...

    def feasibility(
        self, regions: Sequence[Region], setup: Setup, state: Array, time: float
    ) -> Feasibility | None:
        """Judge every product mode of the regions at a configuration.

        None where there is no reason against any; see `statechart.automaton.product.feasibility`.
        """
        ...

    def remarks(self, setup: Setup, arcs: Sequence[Arc]) -> tuple[str, ...]:
        """Return warnings about a run that has ended, from its arcs."""
        ...


class CompiledLaws(Protocol):
    """Unambiguous instants in compiled code; a loop stops where one needs case analysis."""

    @property
    def tapes(self) -> tuple[Tape, ...]:
        """Tapes that it reads."""
        ...

    @property
    def series(self) -> tuple[tuple[str, str], ...]:
        """Regions and causes of the jumps that it makes (see `statechart.execution.zeno`)."""
        ...

    @property
    def setup(self) -> Callable[[Mapping[str, float], float], Setup]:
        """Function of the numbers of a run that the loop computes itself where it starts runs."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of every run that it starts."""
        ...

    @property
    def has_remarks(self) -> bool:
        """True if `Laws.remarks` checks the runs that it makes."""
        ...

    def compiled(self) -> bool:
        """Return whether the loop lies compiled on disk; if not, compiling takes a while."""
        ...

    def ready(self) -> bool:
        """Return whether it does, in a process that has loaded its compiler."""
        ...

    def listed(self, mode: Key, roles: Roles, margins: Sequence[str]) -> Sequence[int] | None:
        """Return the data of a mode with these margins; None where the loop cannot enter it."""
        ...

    def within(self, mode: Key) -> Tape | None:
        """Return the outputs that must stay above a depth, as `Constraints.within`."""
        ...

    def tolerances(self, setup: Setup, state: Array, time: float) -> Mapping[str, float]:
        """Return the margins that have a tolerance of their own in a flow from a state, with it."""
        ...

    def takes(self, setup: Setup, flow: Flow, state: Array, time: float) -> bool:
        """Return whether it can go on from the start of a flow in a mode that it knows."""
        ...

    def call(self, loop: Any, relative: float) -> Any:
        """Return calls of the loop.

        They have the `loop`, whether it `starts` runs by values of their parameters, and the
        `series` of the jumps of the last run that was started. `inputs(names, table)` returns the
        first four of `statechart.execution.compiled_loop.BatchInputs` for values (m, p).
        `start(rows, block, found)` makes runs, and returns how many before the block was full;
        `begin(setup, until, most_jumps, floor, block, found)` makes one with known numbers;
        `resume(setup, floor, block, found, series)` takes a run on that has come somewhere.
        """
        ...

    def about(self, event: RecordedEvent) -> tuple[str, str]:
        """Return the region that an event is about, and its cause, as in its jump."""
        ...

    def jump(self, setup: Callable[[], Setup], event: RecordedEvent, fired: str) -> Jump:
        """Return the jump of an event that it made; `setup` gives the numbers of its run."""
        ...


MAX_MODES = 4096
"""Products of more modes than this, six contacts' for one, are never enumerated."""


@dataclass(frozen=True)
class Feasibility:
    """Verdict on the product modes at a configuration."""

    modes: Mapping[Key, str]  # Every product mode -> why it is not possible; "" where it is.
    # The same as the declaration counts modes (sliding without direction).
    declared: Mapping[Key, str]
    remarks: tuple[str, ...] = ()  # Remarks on the configuration for the reader.
