"""Trace of a run: arcs and jumps on hybrid time (t, j)."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import chain, groupby
from typing import Any, Literal, NamedTuple

import numpy as np

from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.automaton.lazy import LazySequence
from statechart.documents.setting import Record
from statechart.errors import StatechartError, TooLong
from statechart.formulas.tape import contiguous
from statechart.kernels.polynomials import sample_states

LARGEST = 2**28
"""Limit of a trace in bytes; with results computed from it, well below a gigabyte."""
_JUMP = 2048  # bytes of a jump and its arc besides arrays
_MAX_PREPARED = 200_000  # arcs, or jumps, cached as objects: some 200 MB

Key = tuple[str, ...]
"""A product mode: the state of every region."""


class Outcome(Enum):
    """Reason for the end of a run, as a sentence."""

    HORIZON = "The run reached its end time."
    STOPPED = "A stop condition became true."
    INTERRUPTED = "The run was interrupted; the trace ends there."
    OUT_OF_BUDGET = "The time budget was used up; the trace ends there."
    NO_CONSISTENT_MODE = "No mode of the contacts agrees with the state."
    AMBIGUOUS_MODE = "Several modes agree with the state and move it differently."
    EVENT_LOOP = "Too many jumps at one instant; the listed modes alternate without end."
    TOO_MANY_JUMPS = "The run has more jumps than settings.max_jumps; raise it, or shorten the run."
    TOO_LONG = "The run is too long to be computed or stored; shorten it, or take longer steps."
    STEP_FAILURE = "The integrator could not reach its tolerance."
    NON_FINITE = "A variable or a guard became infinite or undefined."
    UNDECIDED = "The search could not decide whether a guard becomes true."
    ZENO = "Jumps accumulate at a finite time, and the model has no transition 'on: zeno'."
    SINGULAR_MODE = "The equations of the entered mode do not determine the motion."
    STEP_TOO_LARGE = "The time step is too large for this model; take a smaller one."
    UNSOLVED_IMPULSES = (
        "The impulses of a time step do not satisfy the contact laws within impulse_bound."
    )
    UNSUPPORTED = "This engine cannot run the model; take the one that the message names."

    @property
    def succeeded(self) -> bool:
        """True if the run reached a declared end."""
        return self in (Outcome.HORIZON, Outcome.STOPPED)


FAR_TOO_MANY = 1000
"""A run expected to exceed a limit by this factor is ended early."""


def check_size(size: int, jumps: int, time: float) -> None:
    """Raise `TooLong` if a trace of `size` bytes in arrays and of `jumps` jumps is too large."""
    if size + _JUMP * jumps > LARGEST:
        raise TooLong(
            f"the trace up to t = {time:.6g} takes {LARGEST >> 20} MB, the largest allowed; "
            "end the run there, or take --record poses or --record nothing"
        )


class Role(NamedTuple):
    """Equations that a region contributes to a flow."""

    state: str  # whose equations apply
    captured: bool = False  # shown in another state, with hidden forces
    share: Hashable | None = None  # law of undetermined quantities, read by `Region.build`


Roles = tuple[Role, ...]
"""The role of every region, which determine the equations of a flow."""


@dataclass(frozen=True, eq=False)
class Arc:
    """One flow between two jumps: a polynomial in time for every variable and step.

    Attributes
    ----------
    mode : Key
        The mode.
    roles : Roles
        The equations of the flow. They differ from `mode` while the rest of a Zeno sequence is
        skipped: a contact is `free` and moves as if closed; a region with constant variables is
        `statechart.automaton.laws.HELD`.
    start : Clock
        Start time.
    j : int
        Number of jumps before it.
    times : (k + 1,) array
        Local times of the ends of steps, the first 0.
    coefficients : (k, n, d + 1) array
        Variable v over step i is ``sum(coefficients[i, v] * s**arange(d + 1))``, s in [0, 1].
    solved : (k, u) array or None
        Unknowns and controls of every time step; None if they follow from the equations.
    """

    mode: Key
    roles: Roles
    start: Clock
    j: int
    times: Array
    coefficients: Array
    solved: Array | None = None

    @property
    def duration(self) -> float:
        """Length of the arc."""
        return float(self.times[-1])

    @property
    def end(self) -> Clock:
        """End of the arc."""
        return self.start.later(self.duration)

    def states(self, local: Array) -> Array:
        """Return the states (m, n) at local times `local` (m,), 0 <= local <= duration."""
        return sample_states(self.coefficients, self.times, contiguous(local))

    def unknowns(self, local: Array) -> Array | None:
        """Return the stored unknowns (m, u) at local times, if any."""
        if self.solved is None:
            return None
        steps = np.searchsorted(self.times, local, side="right") - 1
        return self.solved[np.clip(steps, 0, len(self.solved) - 1)]


@dataclass(frozen=True, eq=False)
class Jump:
    """One discrete transition.

    Attributes
    ----------
    t : float
        Time.
    j : int
        Number of jumps before it.
    region : str
        Its region (contact); "" for a stop of the run.
    cause : str
        touchdown, liftoff, slip, stick, reverse, zeno, stop, or a chart's transition.
    source, target : Key
        Mode before and after.
    before, after : (n,) array
        State before and after.
    fired : tuple of str
        The margins that fell.
    impulse : mapping
        Region -> (normal, tangential) impulse.
    joint_impulse : mapping
        Force of a joint or couple of rolling resistance, such as ``pin.X`` -> its impulse.
    path : tuple of str
        Phases of the impact.
    considered : mapping
        Candidate mode -> verdict.
    energy : (float, float) or None
        Before and after, if the automaton has an energy.
    skipped : float
        Time from the last resolved bounce of a Zeno sequence to its accumulation point.
    """

    t: float
    j: int
    region: str
    cause: str
    source: Key
    target: Key
    before: Array
    after: Array
    fired: tuple[str, ...] = ()
    impulse: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    path: tuple[str, ...] = ()
    considered: Mapping[str, str] = field(default_factory=dict)
    energy: tuple[float, float] | None = None
    skipped: float = 0.0
    joint_impulse: Mapping[str, float] = field(default_factory=dict)


_UNKNOWN_AMOUNT = "an unknown amount, as an event is met too slowly or errors grow too fast"


@dataclass(frozen=True)
class Motion:
    """Certificate of the motion: local error bound and global error estimate.

    Attributes
    ----------
    local : float
        Proved bound of the local error of every step, from enclosures of the defect, relative to
        the largest magnitude of the variable in the run.
    at, of : float, str
        Start of the step with the largest bound, and the variable.
    whole : float
        Estimate of the global error of the final state (relative in the same way) and of the times
        of events (relative to the end); infinite beyond the validity of linearisation.
    proved : bool
        Whether `local` meets the tolerance of the run.
    """

    local: float
    at: float
    of: str
    whole: float
    proved: bool

    def __str__(self) -> str:
        if not self.of:
            return "the run has no steps"
        most = f"{self.local:.2g} of the size of a variable ({self.of} from t = {self.at:.6g} on)"
        if not self.proved:
            return f"not proved: a step may be off by {most}"
        whole = f"about {self.whole:.2g}" if self.whole < math.inf else _UNKNOWN_AMOUNT
        return f"interval enclosure: no step is off by more than {most}, the whole run by {whole}"


@dataclass(frozen=True, eq=False)
class Trace:
    """A run.

    Attributes
    ----------
    name : str
        Name of the model.
    regions, variables : tuple of str
        Names, in the order of the keys and of the states.
    parameters : mapping
        Name -> value, of this run.
    arcs, jumps : sequence
        In order of time.
    initial, final : (n,) array
        First and last state.
    start_mode, final_mode : Key
        First and last mode.
    passed_roles : mapping
        Number of jumps before -> load sharing of a mode that lasted no time.
    t_end : float
        End of the run.
    outcome : Outcome
        Reason for the end.
    message : str
        Outcome with details.
    certified : bool or "guards"
        True if every guard was decided by enclosure and the defect of every step is bounded with
        proof; "guards" if the defect was only checked.
    evidence : mapping
        Margin -> method that decided its first crossing. "motion": evidence of the steps.
    tolerances : mapping
        Kind of margin -> absolute tolerance. For time steps, "impulse" is the largest residual of
        the impulses, relative to the fastest approach velocity of a step.
    engine : str
        Engine and method.
    tolerance : float
        Relative tolerance of the integration.
    warnings : tuple of str
        Warnings.
    counts : mapping
        Steps, evaluations, boxes, jumps, modes built, instants outside compiled loops.
    step : float or None
        The fixed time step; `tolerance` is then NaN.
    margins : mapping or None
        Margin -> least value, if recorded by time stepping.
    undetermined : mapping or None
        `indeterminate`, if recorded by time stepping.
    motion : Motion or None
        Certificate of the motion, if requested.
    record : Record
        Recording: with poses `regions` are the controllers, with nothing there are none.
    outputs : mapping or None
        Declared outputs, if computed during the run.
    start_unknowns : (u,) array or None
        Unknowns and controls in the first mode of time steps.
    """

    name: str
    regions: tuple[str, ...]
    variables: tuple[str, ...]
    parameters: Mapping[str, float]
    arcs: Sequence[Arc]
    jumps: Sequence[Jump]
    initial: Array
    final: Array
    start_mode: Key
    final_mode: Key
    t_end: float
    outcome: Outcome
    message: str
    certified: bool | Literal["guards"]
    evidence: Mapping[str, str]
    tolerances: Mapping[str, float]
    engine: str
    tolerance: float
    warnings: tuple[str, ...]
    counts: Mapping[str, int]
    step: float | None = None
    margins: Mapping[str, float] | None = None
    undetermined: Mapping[Key, tuple[str, ...]] | None = None
    motion: Motion | None = None
    record: Record = Record.MODES
    outputs: Mapping[str, Any] | None = None
    start_unknowns: Array | None = None
    passed_roles: Mapping[int, Roles] = field(default_factory=dict)

    @property
    def values(self) -> Array:
        """Values (p,) of the parameters."""
        return np.fromiter(self.parameters.values(), float, len(self.parameters))

    def at_hand(self) -> Trace:
        """Return the run with arcs and jumps cached as objects, unless there are too many."""
        passing = isinstance(self.arcs, LazySequence) and not self.arcs.keeps
        if passing or max(len(self.arcs), len(self.jumps)) > _MAX_PREPARED:
            return self
        return replace(self, arcs=tuple(self.arcs), jumps=tuple(self.jumps))

    def require_motion(self) -> None:
        """Raise `StatechartError` if the run recorded only its start and end."""
        if self.record is Record.NOTHING:
            message = "the run recorded no states between its start and its end"
            raise StatechartError(f"{message}; run it with --record poses")

    @property
    def zeros(self) -> frozenset[int]:
        """Indices of the parameters that are exactly zero."""
        return frozenset(np.flatnonzero(self.values == 0.0).tolist())

    @property
    def indeterminate(self) -> dict[Key, tuple[str, ...]]:
        """Mode -> regions with quantities that the motion does not determine."""
        if self.undetermined is not None:
            return dict(self.undetermined)
        contacts: dict[Key, tuple[str, ...]] = {}
        for arc in self.arcs:
            roles = zip(self.regions, arc.roles, strict=False)
            if names := tuple(name for name, role in roles if role.share is not None):
                contacts[arc.mode] = names
        return contacts

    @property
    def modes(self) -> tuple[Key, ...]:
        """The modes in the order visited, zero-length ones included, repeats merged."""
        if not self.regions:  # not recorded
            return ()
        sequence = chain([self.start_mode], (jump.target for jump in self.jumps))
        return tuple(key for key, _ in groupby(sequence))


def sizes(trace: Trace) -> Array:
    """Return the largest magnitude (n,) of every variable at starts and middles of steps."""
    return np.abs(visited_states(trace)).max(axis=0)


def visited_states(trace: Trace) -> Array:
    """Return the states (m, n) at the ends of a run, after jumps, and at the points of `sizes`."""
    states = [np.array([trace.initial, trace.final])]
    for arc in trace.arcs:
        half = 0.5 ** np.arange(arc.coefficients.shape[2])
        states += [arc.coefficients[:, :, 0], arc.coefficients @ half]
    if trace.jumps:
        states.append(np.array([jump.after for jump in trace.jumps]))
    return np.concatenate(states)
