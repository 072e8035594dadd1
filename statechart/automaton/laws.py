"""Interface of the laws of an automaton: jumps between flows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeVar

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
"""Role of a region without equations, whose variables are constant."""

SWITCHES = "switches"
"""State of the role after those of the regions, whose share are the signs of the switches (see
`statechart.automaton.switches`)."""

UNBOUNDED = "unbounded"
"""End of a flow that cannot be continued without a fallen margin, as of an unbounded force."""


@lru_cache(maxsize=1024)
def roles_in(mode: Key) -> Roles:
    """Return the roles of regions with the equations of their states."""
    roles = {state: Role(state) for state in set(mode)}
    return tuple([roles[state] for state in mode])


def region_roles(roles: Roles) -> Roles:
    """Return roles without that of switches, which may stand behind them."""
    return roles[:-1] if roles and roles[-1].state == SWITCHES else roles


@lru_cache(maxsize=1024)
def uncaptured(roles: Roles) -> Roles:
    """Return the roles with equal equations and no hidden forces."""
    return tuple([role._replace(captured=False) for role in roles])


@lru_cache(maxsize=1024)
def moving_mode(roles: Roles) -> Key:
    """Return the states of roles."""
    return tuple([role.state for role in region_roles(roles)])


@dataclass(frozen=True, eq=False)
class Setup:
    """Parameters, initial state and tolerances of a run."""

    values: Array  # (p,) parameters
    initial: Array  # (n,)
    tolerances: Mapping[str, float]  # kind of margin -> absolute tolerance
    # The rest of a Zeno sequence is skipped below this fraction of its longest interval.
    short: float = 0.0
    warnings: tuple[str, ...] = ()
    sizes: Array | None = None  # (n,) scales of the variables, if the model has some
    precision: float = 64.0 * EPS  # of margins, relative to their terms
    horizon: float = float("inf")  # first look-ahead in time
    modes: Callable[[Roles], Mode] | None = None  # roles -> solved mode; set by the executor

    @cached_property
    def zeros(self) -> frozenset[int]:
        """Indices of the parameters that are exactly zero."""
        return frozenset(np.flatnonzero(self.values == 0.0).tolist())


class Flow(NamedTuple):
    """A flow: mode, equations, tolerances, and duration if timed."""

    mode: Key  # shown in the trace
    roles: Roles  # equations; `HELD` for a held region
    remaining: float = float("inf")  # time to the next call of the laws (a Zeno accumulation)
    warning: str = ""  # about the choice of this mode
    settled: bool = False  # the laws have accepted the mode at the initial state of the flow
    notes: tuple[str, ...] = ()  # warnings about the mode, reported once
    held: Mapping[str, Clock] = _NOTHING  # region -> accumulation point of its Zeno sequence
    tolerances: Mapping[str, float] = _NOTHING  # margin -> tolerance, if not that of its kind
    # (n, k) terms of the variables at the end of the last flow, set by the executor.
    terms: Array | None = None
    summed: Array | None = None  # (n,) sizes of the terms summed by jumps since then
    pending: Mapping[str, tuple[Raised, ...]] = _NOTHING  # region -> events of this instant
    start: Array | None = None  # (n,) projected initial state, if not the present one
    values: Array | None = None  # (p,) parameters, if not those of the run
    near_bound: bool = False  # forces may start beyond their bounds by the error of the run
    signs: Roles = ()  # signs of the switches as a role, set by the executor

    @property
    def moving(self) -> Roles:
        """The roles and signs of switches, which determine the equations."""
        return (*self.roles, *self.signs) if self.signs else self.roles

    @property
    def sizes(self) -> Array | None:
        """Sizes (n,) of the terms of each variable, the scale of its round-off."""
        return None if self.terms is None else np.abs(self.terms).sum(axis=1)


_Setup = TypeVar("_Setup", bound=Setup, covariant=True)


class InstantOf(NamedTuple, Generic[_Setup]):
    """End of a flow, the input of the laws."""

    setup: _Setup
    clock: Clock
    j: int  # number of jumps before it
    flow: Flow  # the flow that ends here
    state: Array  # (n,)
    fired: tuple[str, ...] = ()  # fallen margins

    def jump(
        self, region: str, cause: str, target: Key, after: Array | None = None, **details: Any
    ) -> Jump:
        """Return a jump from here to a mode, and to the state `after` if it changes."""
        time, source, before = self.clock.high, self.flow.mode, self.state
        after = before if after is None else after
        ends = source, target, before, after
        return Jump(time, self.j, region, cause, *ends, self.fired, **details)


Instant = InstantOf[Setup]

JumpResult = tuple[Jump | None, Flow] | None
"""A jump and the flow after it; without a jump the flow goes on in the same mode."""


def flow_sizes(setup: Setup, flow: Flow, state: Array) -> Array:
    """Return the sizes (n,) of the terms of the variables, or their magnitudes."""
    result = np.abs(state)
    for sizes in (setup.sizes, flow.sizes if flow.summed is None else flow.summed):
        if sizes is not None:
            result = np.maximum(result, sizes)
    return result


class Laws(Protocol):
    """Laws of the jumps between flows; `setup` is that of their automaton."""

    @property
    def compiled_laws(self) -> CompiledLaws | None:
        """The compiled part of the laws."""

    def begin(self, setup: Any) -> tuple[Flow, Array]:
        """Return the first flow and state."""

    def jump(self, at: InstantOf[Any]) -> JumpResult:
        """Return the jump at an instant, or None if the mode is kept.

        A flow without a jump keeps the mode, with other equations or another initial state.
        """

    def change(self, at: InstantOf[Any], before: Any) -> tuple[Jump | None, Flow]:
        """Return the jump, if there is one, and the flow at a change of parameters.

        `before` is the setup with the old values, `at` holds the setup with the new ones.
        """

    def accumulate(
        self, setup: Any, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Skip the rest of a Zeno sequence.

        `jumps` are the last ones; the remaining ones take the time `rest`. Returns the changed last
        jump and the flow after it, or None if the sequence must be resolved further. Raises `Zeno`
        if the model does not declare what follows.
        """

    def constraints(self, setup: Any, roles: Roles, start: float, anchor: Array) -> Constraints:
        """Return the constraints of a flow that begins in the state `anchor` at `start`."""

    def feasibility(
        self, regions: Sequence[Region], setup: Any, state: Array, time: float
    ) -> Feasibility | None:
        """Return the feasibility of every product mode at a configuration.

        None if all are feasible; see `statechart.automaton.product.feasibility`.
        """

    def remarks(self, setup: Any, arcs: Sequence[Arc]) -> tuple[str, ...]:
        """Return warnings about a complete run."""


class CompiledLaws(Protocol):
    """Laws of unambiguous instants in compiled code; the loop stops at others."""

    @property
    def tapes(self) -> tuple[Tape, ...]:
        """Tapes that it reads."""

    @property
    def series(self) -> tuple[tuple[str, str], ...]:
        """Regions and causes of jumps that may accumulate (see `statechart.execution.zeno`)."""

    @property
    def setup(self) -> Callable[[Mapping[str, float], float], Setup]:
        """Function that computes the setup of runs that the loop starts."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of every run that it starts."""

    @property
    def has_remarks(self) -> bool:
        """True if `Laws.remarks` applies to its runs."""

    def compiled(self) -> bool:
        """Return whether the loop is in the disk cache."""

    def ready(self) -> bool:
        """Return whether the loop is cached and this process has loaded the compiler."""

    def listed(self, mode: Key, roles: Roles, margins: Sequence[str]) -> Sequence[int] | None:
        """Return the data of a mode with these margins, or None if the loop cannot enter it."""

    def within(self, mode: Key) -> Tape | None:
        """Return the outputs bounded from below, as `Constraints.within`."""

    def tolerances(self, setup: Any, state: Array, time: float) -> Mapping[str, float]:
        """Return margin -> its own tolerance in a flow from a state."""

    def takes(self, setup: Any, flow: Flow, state: Array, time: float) -> bool:
        """Return whether it can continue from the start of a flow in a known mode."""

    def call(self, loop: Any, relative: float) -> Any:
        """Return calls of the loop.

        They have the `loop`, whether it `starts` runs from values of parameters, and the `series`
        of the last started run. `inputs(names, table)` returns the first four of
        `statechart.execution.compiled_loop.BatchInputs` for values (m, p).
        `start(rows, block, found)` computes runs, and returns their number when the block is full;
        `resume(setup, floor, block, found, series)` continues a run.
        """

    def jump(self, setup: Callable[[], Any], event: RecordedEvent, fired: str) -> Jump:
        """Return the jump of a recorded event; `setup` returns the setup of its run."""


MAX_MODES = 4096
"""Larger products of modes, as of six contacts, are not enumerated."""


@dataclass(frozen=True)
class Feasibility:
    """Feasibility of the product modes at a configuration."""

    modes: Mapping[Key, str]  # mode -> reason why it is infeasible, or ""
    declared: Mapping[Key, str]  # the same without directions of sliding
    remarks: tuple[str, ...] = ()
