"""Trace of a run: arcs and jumps on hybrid time (t, j)."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.automaton.lazy import LazySequence
from statechart.documents.setting import Record
from statechart.errors import StatechartError, TooLong
from statechart.formulas.tape import Tape, contiguous
from statechart.kernels.boxes import Steps
from statechart.kernels.polynomials import sample_states
from statechart.kernels.quadrature import integrate_outputs

Flow = tuple[float, ArrayLike, ArrayLike]
"""Start, local times (k + 1,) of the steps' ends and coefficients (k, n, d + 1) of a flow."""

# Flows of one batch.
_MAX_FLOWS = 1024


def lowest(tape: Tape, flows: Sequence[Flow], parameters: ArrayLike, per_step: int = 16) -> Array:
    """Return the least value of every output on a grid along flows.

    Raises `ValueError` if a shape does not fit.
    """
    s = np.arange(per_step + 1) / per_step
    parameters, result = contiguous(parameters), np.full(len(tape.outputs), np.inf)
    for first in range(0, len(flows), _MAX_FLOWS):
        flow_batch = flows[first : first + _MAX_FLOWS]
        checked = [checked_arc(tape, *flow[1:], parameters)[:2] for flow in flow_batch]
        begin = np.concatenate([times[:-1] for times, _ in checked])[:, None]
        end = np.concatenate([times[1:] for times, _ in checked])[:, None]
        start = np.repeat(
            [flow[0] for flow in flow_batch], [len(times) - 1 for times, _ in checked]
        )
        coeffs = np.concatenate([coeffs for _, coeffs in checked])
        local = np.where(s < 1.0, begin + s * (end - begin), end)
        states = np.swapaxes(coeffs @ s ** np.arange(coeffs.shape[2])[:, None], 1, 2)
        times = (start[:, None] + local).ravel()
        values = tape.table(states.reshape(-1, coeffs.shape[1]), parameters, times)
        result = np.minimum(result, values.min(axis=0, initial=np.inf))
    return result


def integrals(
    tape: Tape,
    times: ArrayLike,
    coeffs: ArrayLike,
    parameters: ArrayLike,
    start: float,
    t_from: float,
    t_to: float,
) -> tuple[Array, Array]:
    """Integrate every output over local time, by Gauss and Legendre with 16 nodes in a piece.

    Pieces are steps, halved until every output is resolved in them: what is narrower than a step is
    found by its enclosure, and a kink ends in a piece as wide as rounding. The limits are local
    times; what lies outside the steps does not count. Returns the integrals (n_out,), and the local
    times at which the pieces end. Raises `ValueError` if a shape does not fit.
    """
    times, coeffs, parameters = checked_arc(tape, times, coeffs, parameters)
    return integrate_outputs(
        tape.parts, Steps(times, coeffs, parameters, float(start)), float(t_from), float(t_to)
    )


def sample(coeffs: ArrayLike, times: ArrayLike, tau: ArrayLike) -> Array:
    """Evaluate the polynomials; raises `ValueError` if a shape does not fit."""
    coeffs, times, tau = contiguous(coeffs), contiguous(times), contiguous(tau)
    if coeffs.ndim != 3 or len(coeffs) == 0 or times.shape != (len(coeffs) + 1,) or tau.ndim != 1:
        raise ValueError(
            f"coeffs, times and tau have shapes {coeffs.shape}, {times.shape} and {tau.shape}, "
            "not (n_steps, n, degree + 1), (n_steps + 1,) and (m,) with a step at least"
        )
    return sample_states(coeffs, times, tau)


def checked_arc(
    tape: Tape, times: ArrayLike, coeffs: ArrayLike, parameters: ArrayLike
) -> tuple[Array, Array, Array]:
    """Return an arc's arrays and the parameters as kernels want them; their shapes fit the tape."""
    times, coeffs, parameters = contiguous(times), contiguous(coeffs), contiguous(parameters)
    tape.require(parameters)
    if coeffs.ndim != 3 or times.shape != (len(coeffs) + 1,) or coeffs.shape[1] != tape.n_variables:
        raise ValueError(
            f"times and coeffs have shapes {times.shape} and {coeffs.shape}, "
            f"not (n_steps + 1,) and (n_steps, {tape.n_variables}, degree + 1)"
        )
    return times, coeffs, parameters


LARGEST = 2**28
"""A trace may take so many bytes: with what is made of it, well below a gigabyte."""
# A jump and its arc take so many beside what they hold in arrays.
_JUMP = 2048
# Arcs, or jumps, that are made once for all who look at a run: some 200 MB.
_MAX_PREPARED = 200_000

Key = tuple[str, ...]
"""A product mode: the state of every region, in the automaton's order."""


class Outcome(Enum):
    """Reason for the end of a run, as a sentence that a user can act on."""

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
        """True if the run reached an end that its declaration names."""
        return self in (Outcome.HORIZON, Outcome.STOPPED)


FAR_TOO_MANY = 1000
"""A run that takes so many times as much as it may is ended before it has taken all."""


def check_size(size: int, jumps: int, time: float) -> None:
    """Raise `TooLong` if a trace of `size` bytes in arrays and of `jumps` jumps is too large."""
    if size + _JUMP * jumps > LARGEST:
        raise TooLong(
            f"the trace up to t = {time:.6g} takes {LARGEST >> 20} MB, the largest allowed; "
            "end the run there, or take --record poses or --record nothing"
        )


class Role(NamedTuple):
    """State whose equations a region contributes to a flow."""

    state: str  # Whose equations apply.
    # True where the region is shown in another state meanwhile: for everybody else its forces are
    # what they are in that, zero.
    captured: bool = False
    # Law of the quantities that the mode's equations leave open without effect on the motion; read
    # by the region that builds the state.
    share: Hashable | None = None


Roles = tuple[Role, ...]
"""The role of every region: what the equations of a flow follow from."""


@dataclass(frozen=True, eq=False)
class Arc:
    """One flow between two jumps: a polynomial in time for every variable and step.

    Attributes
    ----------
    mode : Key
        The mode that the trace shows.
    roles : Roles
        Whose equations moved the state. Their states differ from `mode` while the rest of a Zeno
        sequence is skipped: a contact still is `free`, and moves as if closed; that of a region
        that holds its variables meanwhile is `statechart.automaton.laws.HELD`.
    start : Clock
        When the arc starts.
    j : int
        Number of jumps before it.
    times : (k + 1,) array
        Local times of the steps' ends, the first 0.
    coefficients : (k, n, d + 1) array
        Variable v over step i is ``sum(coefficients[i, v] * s**arange(d + 1))``, s in [0, 1].
    solved : (k, u) array or None
        The automaton's unknowns and controls over every step, where stepping through time has
        found them as numbers; else the equations of the flow's mode give them.
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

    @property
    def flow(self) -> Flow:
        """Start, times and coefficients."""
        return self.start.high, self.times, self.coefficients

    def states(self, local: Array) -> Array:
        """Return the states (m, n) at local times `local` (m,), 0 <= local <= duration."""
        return sample(self.coefficients, self.times, np.ascontiguousarray(local, dtype=float))

    def unknowns(self, local: Array) -> Array | None:
        """Return the unknowns (m, u) at local times, where they are known as numbers."""
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
        When.
    j : int
        Number of jumps before it.
    region : str
        The region (contact) that it is about; "" for a stop of the whole run.
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
    path : tuple of str
        How the impact went, piece by piece.
    considered : mapping
        Candidate mode -> why it was taken or not.
    energy : (float, float) or None
        Before and after, where the automaton has an energy.
    skipped : float
        Time skipped at a Zeno point: from the last bounce that was resolved to the accumulation.
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


_UNKNOWN_AMOUNT = "an unknown amount, as an event is met too slowly or errors grow too fast"


@dataclass(frozen=True)
class Motion:
    """Proved distance of the steps of a run from their differential equations.

    Attributes
    ----------
    local : float
        The most that any step adds to the error of a variable, in parts of its largest size in
        the run; a bound, proved by enclosures of the defect.
    at, of : float, str
        When that step begins, and the variable; empty where there was no step.
    whole : float
        Estimate of what all steps together amount to: of the final state, in the same parts, and
        of the times of events, in parts of the end. Infinite where there is none: it is linear in
        errors, and these have grown beyond that.
    proved : bool
        Whether `local` is what the tolerance of the run promises.
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
        Of the model.
    regions, variables : tuple of str
        Names, in the order of the keys and of the states.
    parameters : mapping
        Name -> value, of this run.
    arcs, jumps : sequence
        In order; an arc's `j` says how many jumps precede it.
    initial, final : (n,) array
        First and last state.
    start_mode, final_mode : Key
        First and last mode.
    t_end : float
        When the run ended.
    outcome : Outcome
        Why it ended.
    message : str
        The outcome in words, with the evidence.
    certified : bool or "guards"
        True when every guard of every step was decided by enclosure, and of every step it was
        proved that it follows the rates; "guards" where the latter was checked.
    evidence : mapping
        Margin -> how its first crossing was decided. Under "motion", how it is known that steps
        follow the rates.
    tolerances : mapping
        Kind of margin -> absolute tolerance used. Of steps, "impulse" is by how much their impulses
        miss the laws of contact at most, in parts of a step's fastest approach.
    engine : str
        Engine and method.
    tolerance : float
        Relative tolerance of the integration.
    warnings : tuple of str
        What a reader must know.
    counts : mapping
        Steps, evaluations, boxes, jumps, modes built, instants that no compiled loop decided.
    step : float or None
        The time step, where it is fixed; `tolerance` is then not a number.
    margins : mapping or None
        Margin -> least value seen, where the run has noted them.
    undetermined : mapping or None
        `indeterminate`, where the run has noted it.
    motion : Motion or None
        What is proved of the steps, where that was asked for.
    record : Record
        What was kept: with poses regions are those of controllers, with nothing there are none.
    outputs : mapping or None
        Those that the model declares, where they were computed on the way.
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

    @property
    def values(self) -> Array:
        """Values (p,) of the parameters."""
        return np.fromiter(self.parameters.values(), float, len(self.parameters))

    def at_hand(self) -> Trace:
        """Return the run with all arcs and jumps as objects, for repeated access.

        A very long one is returned as it is: made, it takes ten times the memory.
        """
        passing = isinstance(self.arcs, LazySequence) and not self.arcs.keeps
        if passing or max(len(self.arcs), len(self.jumps)) > _MAX_PREPARED:
            return self
        return replace(self, arcs=tuple(self.arcs), jumps=tuple(self.jumps))

    def require_motion(self) -> None:
        """Raise `StatechartError` if the run recorded only its start and end."""
        if self.record is Record.NOTHING:
            raise StatechartError(
                "the run recorded no states between its start and its end; run it with "
                "--record poses"
            )

    @property
    def zeros(self) -> frozenset[int]:
        """Places of the parameters that are exactly zero."""
        return frozenset(np.flatnonzero(self.values == 0.0).tolist())

    def changes(self, jump: Jump) -> tuple[dict[str, str], dict[str, str]]:
        """Return region -> state before and after `jump`."""
        return (
            dict(zip(self.regions, jump.source, strict=True)),
            dict(zip(self.regions, jump.target, strict=True)),
        )

    @property
    def indeterminate(self) -> dict[Key, tuple[str, ...]]:
        """Mode -> regions some of whose quantities its motion does not determine."""
        if self.undetermined is not None:
            return dict(self.undetermined)
        contacts: dict[Key, tuple[str, ...]] = {}
        for arc in self.arcs:
            open_ones = zip(self.regions, arc.roles, strict=False)
            names = tuple(name for name, role in open_ones if role.share is not None)
            if names:
                contacts[arc.mode] = names
        return contacts

    @property
    def modes(self) -> tuple[Key, ...]:
        """The modes in the order visited, zero-length ones included, repeats merged."""
        if not self.regions:  # none were kept
            return ()
        sequence = [self.start_mode]
        for jump in self.jumps:
            if jump.target != sequence[-1]:
                sequence.append(jump.target)
        return tuple(sequence)


def sizes(trace: Trace) -> Array:
    """Return the largest magnitude (n,) of every variable where steps begin or are half done."""
    return np.abs(visited_states(trace)).max(axis=0)


def visited_states(trace: Trace) -> Array:
    """Return the states (m, n) at the ends of a run, after jumps, and as `sizes` looks at them."""
    states = [np.array([trace.initial, trace.final])]
    for arc in trace.arcs:
        half = 0.5 ** np.arange(arc.coefficients.shape[2])
        states += [arc.coefficients[:, :, 0], arc.coefficients @ half]
    if trace.jumps:
        states.append(np.array([jump.after for jump in trace.jumps]))
    return np.concatenate(states)
