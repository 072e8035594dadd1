"""Impulses at several contacts at once, as a complementarity problem.

Moreau's law: a contact that bears an impulse keeps its speed of separation, ``v_n+ = -e v_n-``;
friction opposes what slip remains, and lies in its cone. With e = 0 the energy never grows; else
it may.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, cones
from contacts.dynamics.snapshot import SCALARS, Snapshot
from contacts.modes.classification import ModeRules
from contacts.solvers.contact_lcp import contact_impulses, contact_problem, delassus
from contacts.solvers.contact_lcp_kernels import STEEPEST
from contacts.solvers.dependence import independent
from contacts.solvers.lcp import LcpStatus, solve_lcp
from contacts.solvers.mode_solver import solve_modes
from contacts.solvers.redundancy import connected, mode_columns, smallest
from contacts.solvers.saddle_point import SOLVED
from contacts.solvers.step_impulses import into_cone
from contacts.states import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS, SLIDING
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import part

MAX_CONTACTS = 4
"""Contacts in one impact."""
STEEP = 1e3
"""Above this mu a cone's edges alone do not span it in double precision."""
# Of the sizes of impulses and velocities: nearer to its edge an inequality is not decided here.
_EDGE = 1e-9
# Of the terms of a momentum: what no impulse explains.
_UNEXPLAINED = 1e-12


@part
def _list_choices(allowed: Bools, cone: Array, choices: Ints) -> int:
    """List what a contact may do in an impact; return how many, 0 where its cone is too steep."""
    choices[0] = FREE
    if cone[1] == 0.0:
        choices[1] = SLIDE
        return 2
    if not (allowed[SLIDE] or allowed[SLIDE_PLUS] or allowed[SLIDE_MINUS]):
        choices[1] = PIN
        return 2
    if cone[1] > STEEP * cone[0]:
        return 0
    choices[1], choices[2], choices[3] = SLIDE_PLUS, SLIDE_MINUS, PIN
    return 4


@part
def _explained(mass: Array, jacobians: Array, change: Array, impulses: Array) -> bool:
    """Whether impulses explain all changes of momentum."""
    for i in range(change.shape[0]):
        missed = terms = 0.0
        for k in range(change.shape[0]):
            missed += mass[i, k] * change[k]
            terms += abs(mass[i, k] * change[k])
        for g in range(jacobians.shape[0]):
            for d in range(2):
                missed -= jacobians[g, d, i] * impulses[g, d]
                terms += abs(jacobians[g, d, i] * impulses[g, d])
        if abs(missed) > _UNEXPLAINED * terms:
            return False
    return True


@part
def strike_group(
    rules: ModeRules, numbers: Array, restitution: Array, group: Ints, velocity: Array,
    impulse: Array,
) -> int:  # fmt: skip
    """Let a group of contacts be hit that do not rebound, and that all feel each other.

    Parameters
    ----------
    rules : ModeRules
        Of all contacts.
    numbers : (o,) array
        The scene's (`contacts.dynamics.snapshot.SnapshotTape`).
    restitution : (c,) array
    group : (g,) array of int64
        The contacts that are closed.
    velocity : (n,) array
        Rates of the coordinates; brought up to date.
    impulse : (c, 2) array
        To be filled, where the contacts are in the group.

    Returns
    -------
    int
        Modes that agree, in digits of base 8 above 1, the first contact the lowest; 0 where there
        is not one that is clear.
    """
    n, allowed, cones = velocity.shape[0], rules.allowed, rules.cones
    mass = numbers[: n * n].reshape((n, n))
    count, contacts = group.shape[0], allowed.shape[0]
    if count > MAX_CONTACTS:
        return 0
    at = n * n + n + 1
    scalars = at + (2 * n + 2) * contacts
    jacobians, start = np.empty((count, 2, n)), np.empty((count, 2))
    edges, choices = np.empty((count, 2)), np.empty((count, 4), np.int64)
    counts = np.empty(count, np.int64)
    total, fastest = 1, rules.speed
    linked = mass != 0.0
    for g in range(count):
        c = group[g]
        counts[g] = _list_choices(allowed[c], cones[c], choices[g])
        total *= counts[g]
        if restitution[c] != 0.0:
            return 0
        jacobians[g] = numbers[at + 2 * n * c : at + 2 * n * (c + 1)].reshape((2, n))
        edges[g] = cones[c]
        place = scalars + SCALARS * c
        for d in range(2):
            start[g, d] = numbers[place + 1 + d]
            fastest = max(fastest, abs(start[g, d]))
        for i in range(n):
            for k in range(n):
                touched = abs(jacobians[g, 0, i]) + abs(jacobians[g, 1, i]) > 0.0
                other = abs(jacobians[g, 0, k]) + abs(jacobians[g, 1, k]) > 0.0
                linked[i, k] = linked[i, k] or (touched and other)
    labels = connected(linked)
    for i in range(n):
        # Bodies that do not feel the impact would make groups of their own.
        if labels[i] != labels[0]:
            return 0
    if total == 0:
        return 0
    codes = np.empty((total, count), np.int64)
    for k in range(total):
        left = k
        for g in range(count):
            codes[k, g] = choices[g, left % counts[g]]
            left //= counts[g]
    everywhere = np.ones(count, np.bool_)
    status, changes = np.empty(total, np.int64), np.empty((total, n))
    forces, verdicts = np.empty((total, count, 2)), np.empty((total, 4))
    solve_modes(
        mass,
        np.zeros(n),
        jacobians,
        start,
        edges,
        codes,
        everywhere,
        everywhere,
        rules.force / rules.acceleration * fastest,
        fastest,
        status,
        changes,
        forces,
        verdicts,
        _EDGE,
    )
    # Impulses that the motion leaves open are those of no mode.
    agreeing, several = -1, False
    for k in range(total):
        if status[k] == SOLVED and verdicts[k, 0] <= _EDGE:
            several, agreeing = several or agreeing >= 0, k
    if several or agreeing < 0 or not verdicts[agreeing, 0] < -_EDGE:
        return 0
    if not _explained(mass, jacobians, changes[agreeing], forces[agreeing]):
        return 0
    columns, _ = mode_columns(codes[agreeing], edges, jacobians, -1)
    if independent(columns)[0] < columns.shape[0]:
        return 0
    path = 1
    for g in range(count - 1, -1, -1):
        path = 8 * path + codes[agreeing, g]
        impulse[group[g]] = into_cone(forces[agreeing, g], edges[g])
    for i in range(n):
        velocity[i] += changes[agreeing, i]
    return path


# Enumeration can prove that there is one solution or several; beyond this it costs too much.
_MAX_ENUMERATED = 4
# Up to here it is the last resort: inertias that differ by more than 1e12 ruin Lemke's matrix.
_MAX_LAST_RESORT = 7
_ON_EDGE = 1e-9
# Relative to the terms of each inequality: what rounding makes of equality, and what is refused.
_EXACT, _TIE = 1e-13, 1e-11
# No impulses make velocities so many times those that they are to change.
_RUNAWAY = 1e9
# Of the terms of a work: less is their rounding.
_GAIN = 1e-9
_SAME = 1e-8
# Velocities below this part of the largest in their group are not compared with themselves.
_ROUNDED = 1e-4

# As `contacts.states` numbers them; pressing is sticking that needs no friction.
_PRESS = -1
STATES = {FREE: "open", PIN: "stick", SLIDE_PLUS: "slip+", SLIDE_MINUS: "slip-", SLIDE: "slip"}
"""What a contact does in an impact, by the number of its mode."""
_NAMES = {**STATES, _PRESS: "stick"}


@dataclass(frozen=True, eq=False)
class Impulses:
    """One solution of the impact's complementarity problem."""

    change: Array  # (n,): Of the rates of the coordinates
    impulses: Array  # (c, 2): V and H on the body; zero where a contact is not closed
    states: tuple[str, ...]  # open, stick, slip+, slip- or slip (no friction), per contact
    # Contacts whose impulses the motion does not determine; the smallest are given
    indeterminate: tuple[bool, ...]
    violation: float  # The largest relative to the terms of its inequality


def collisions(
    snapshot: Snapshot,
    laws: Sequence[ContactLaw],
    closed: Sequence[bool],
    restitution: Sequence[float],
) -> tuple[Impulses, ...]:
    """Return the impulses that agree with the laws, one per distinct motion, preferred first.

    ``0 <= P_n``, ``v_n+ + e min(v_n-, 0) >= 0``, their product 0; friction in its cone, against
    the slip that remains. The state's saddle point is solved, so that no inertia need be positive
    that the contacts do not accelerate. Up to four contacts all combinations of modes are tried;
    above, Lemke's algorithm finds one, and whether it is the only one is not known. None: there
    is none, or rounding hides it, as where inertias differ by 24 decades.
    """
    group = [i for i, shut in enumerate(closed) if shut]
    problem = _Problem.of(snapshot, laws, group, restitution)
    agree: list[Impulses] = []
    if len(group) > _MAX_ENUMERATED:
        agree = problem.solve(problem.by_lemke())
    if not agree and len(group) <= _MAX_LAST_RESORT:
        agree = problem.solve(list(product(*(_choices(laws[i]) for i in group))))
    found: list[Impulses] = []
    for collision in sorted(agree, key=_preference):
        if not any(problem.same_motion(collision, one) for one in found):
            found.append(collision)
    return tuple(problem.shared_out(c, len(laws)) for c in found)


def coupled(snapshot: Snapshot, group: Sequence[int]) -> Ints:
    """Label the coordinates (n,): those with one label feel each other's impulses."""
    linked = snapshot.mass != 0.0
    for i in group:
        touched = np.abs(snapshot.jacobians[i]).max(axis=0) > 0.0
        linked |= np.outer(touched, touched)
    return connected(linked)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The contacts of a group, and the coordinates that they move."""

    group: list[int]  # Contacts
    moved: Ints  # (m,): Coordinates, of `size`
    size: int
    mass: Array  # (m, m), jacobians : (g, 2, m), cones : (g, 2)
    jacobians: Array
    cones: Array
    start: Array  # (g, 2): What v_n + e min(v_n-, 0) and v_t are without impulses
    velocity: Array  # (m,): Before
    plastic: bool  # Whether nothing rebounds: then no impulses can raise the energy

    @classmethod
    def of(
        cls,
        snapshot: Snapshot,
        laws: Sequence[ContactLaw],
        group: list[int],
        restitution: Sequence[float],
    ) -> _Problem:
        labels = coupled(snapshot, group)
        jacobians = snapshot.jacobians[group]
        touched = {label for row in jacobians for label in labels[np.abs(row).max(axis=0) > 0.0]}
        moved = np.nonzero([label in touched for label in labels])[0]
        start = [
            (c.gap_rate + restitution[i] * min(c.gap_rate, 0.0), c.slip)
            for i, c in ((i, snapshot.contacts[i]) for i in group)
        ]
        return cls(
            group,
            moved,
            len(snapshot.velocity),
            np.ascontiguousarray(snapshot.mass[np.ix_(moved, moved)]),
            np.ascontiguousarray(jacobians[:, :, moved]),
            cones(tuple(laws[i] for i in group)),
            np.array(start),
            snapshot.velocity[moved],
            not any(restitution[i] > 0.0 for i in group),
        )

    @cached_property
    def reaches(self) -> Array:
        """The sizes of the Jacobians (g, 2, m)."""
        return np.abs(self.jacobians)

    def solve(self, codes: Sequence[Sequence[int]]) -> list[Impulses]:
        """Solve the combinations of modes, and return those that agree with the laws."""
        table = np.array(codes, dtype=np.int64).reshape(-1, len(self.group))
        # A contact that presses is open, and its twin without friction closed.
        frictionless = np.tile([1.0, 0.0], (len(self.group), 1))
        pressing = table == _PRESS
        twins = np.where(pressing, SLIDE, FREE)
        unjudged = np.zeros(2 * len(self.group), dtype=np.bool_)
        status = np.empty(len(table), dtype=np.int64)
        changes = np.empty((len(table), len(self.mass)))
        forces = np.empty((len(table), 2 * len(self.group), 2))
        solve_modes(
            self.mass,
            np.zeros(len(self.mass)),
            np.concatenate([self.jacobians, self.jacobians]),
            np.concatenate([self.start, self.start]),
            np.concatenate([self.cones, frictionless]),
            np.hstack([np.where(pressing, FREE, table), twins]),
            unjudged,
            unjudged,
            1.0,
            1.0,
            status,
            changes,
            forces,
            np.empty((len(table), 4)),
            0.0,
        )
        table, changes = table[status == SOLVED], changes[status == SOLVED]
        forces = forces[status == SOLVED]
        impulses = forces[:, : len(self.group)] + forces[:, len(self.group) :]
        violations = self._violations(table, changes, impulses)
        unshared = (False,) * len(self.group)
        return [
            Impulses(
                changes[k],
                impulses[k],
                tuple(_NAMES[mode] for mode in code.tolist()),
                unshared,
                float(violations[k]),
            )
            for k, code in enumerate(table)
            if violations[k] <= _TIE and self._independent(code)
        ]

    def _after(self, change: Array) -> tuple[Array, Array]:
        """Return the velocities (.., g, 2) after, and the sizes of the terms they consist of."""
        after = self.start + np.einsum("gdn,...n->...gd", self.jacobians, change)
        terms = np.abs(self.start) + np.einsum("gdn,...n->...gd", self.reaches, np.abs(change))
        # Velocities that cancel (a ball that stays on the floor under an impact) carry rounding
        # of the impulses, though their own terms are zero.
        return after, np.maximum(terms, _ROUNDED * terms.max(axis=(-2, -1), keepdims=True))

    def _violations(self, table: Ints, changes: Array, impulses: Array) -> Array:
        """Return the largest violation of each combination, relative to its terms."""
        after, terms = self._after(changes)
        relative = np.divide(after, terms, out=np.zeros_like(after), where=terms > 0.0)
        # Of velocities so much larger than those before, rounding is larger than these: contacts
        # at one place have combinations of modes that are solved by nothing but rounding.
        runaway = terms.max(axis=(-2, -1)) > _RUNAWAY * np.abs(self.start).max(initial=0.0)
        normal, slip = relative[..., 0], relative[..., 1]
        sizes = np.hypot(impulses[..., 0], impulses[..., 1])
        cone_n, cone_t = self.cones.T
        V, H = impulses[..., 0], impulses[..., 1]
        forwards, backwards, free = table == SLIDE_PLUS, table == SLIDE_MINUS, table == FREE
        sign = np.where(forwards, 1.0, np.where(backwards, -1.0, 0.0))
        outside = np.where(
            sign != 0.0,
            sign * cone_t * H - cone_n * V,
            np.maximum(-V, cone_n * np.abs(H) - cone_t * V),
        )
        outside = np.divide(outside, sizes, out=np.zeros_like(sizes), where=sizes > 0.0)
        shut = np.maximum(np.abs(normal), outside)
        worst = np.where(free, -normal, shut)
        still = np.where((table == PIN) | (table == _PRESS), np.abs(slip), -np.inf)
        along = np.where(forwards, -slip, np.where(backwards, slip, still))
        if self.plastic:
            # Combinations that solve nothing may have any impulses.
            with np.errstate(over="ignore", invalid="ignore"):
                work, size = work_of(
                    self.jacobians, self.mass, self.velocity, self.start, changes, impulses
                )
                runaway |= work > _GAIN * size
        found = np.maximum(worst, along).max(axis=1)
        unexplained = self._unexplained(changes, impulses, terms)
        return np.where(runaway, np.inf, np.maximum(found, unexplained))

    def _unexplained(self, changes: Array, impulses: Array, speeds: Array) -> Array:
        """Return the largest change of momentum (..,) that no impulse explains, relatively.

        Of terms of the velocities after it as large as these speeds (.., g, 2).

        The solver compares a row with the largest; a light body beside heavy ones has its own. A
        mass that couples two coordinates is known to the rounding of both; and a momentum that
        moves no contact (rods that lie flat are pushed along) is rounding of what does.
        """
        pushes = np.einsum("gdn,...gd->...n", self.jacobians, impulses)
        sizes = np.hypot(impulses[..., 0], impulses[..., 1])
        roots = np.sqrt(np.diag(self.mass))
        terms = np.abs(changes) @ np.where(self.mass != 0.0, np.outer(roots, roots), 0.0)
        terms += np.einsum("gdn,...g->...n", self.reaches, sizes)
        reach = self.reaches.max(axis=(0, 1))
        inertia = np.divide(roots**2, reach, out=np.zeros_like(reach), where=reach > 0.0)
        terms += _ROUNDED * speeds.max(axis=(-2, -1))[..., None] * inertia
        missed = np.abs(changes @ self.mass - pushes)
        relative = np.divide(missed, terms, out=np.zeros_like(terms), where=terms > 0.0)
        return np.asarray(relative.max(axis=-1))

    def _independent(self, code: Ints) -> bool:
        """Whether the impulses of a combination are determined by the geometry alone.

        Elimination does not notice in rounding that two contacts are one; its impulses are then
        huge and cancel.
        """
        plain = np.where(code == _PRESS, SLIDE, code)
        columns, _ = mode_columns(plain, self.cones, self.jacobians, -1)
        return bool(independent(columns)[0] == len(columns))

    def by_lemke(self) -> list[tuple[int, ...]]:
        """Return the modes that Lemke's algorithm ends in, on the Delassus matrix.

        It serves to find the modes only, so that inertias may be filled up where they vanish.
        """
        contacts, _ = delassus(self.mass, self.jacobians, np.zeros(len(self.mass)))
        matrix, vector = contact_problem(contacts, self.start, self.cones)
        solution = solve_lcp(matrix, vector)
        if solution.status is not LcpStatus.SOLVED:
            return []
        impulses = contact_impulses(solution.z, self.cones)
        return [tuple(map(_mode, impulses.tolist(), self.cones.tolist()))]

    def same_motion(self, one: Impulses, other: Impulses) -> bool:
        """Whether the contacts, whose impulses are all that moves the bodies, move alike."""
        (after, terms), (beside, sizes) = self._after(one.change), self._after(other.change)
        return bool((np.abs(after - beside) <= _SAME * (terms + sizes)).all())

    def shared_out(self, collision: Impulses, count: int) -> Impulses:
        """Return it for all coordinates and contacts, with the smallest impulses that move so."""
        after, terms = self._after(collision.change)
        shut = np.abs(after[:, 0]) <= _TIE * terms[:, 0]
        still = np.abs(after[:, 1]) <= _TIE * terms[:, 1]
        code = np.where(
            self.cones[:, 1] == 0.0,
            SLIDE,
            np.where(still, PIN, np.where(after[:, 1] > 0.0, SLIDE_PLUS, SLIDE_MINUS)),
        )
        code = np.where(shut, code, FREE)
        given, unknown = smallest(code, self.jacobians, self.cones, collision.impulses)
        if self._unexplained(collision.change, given, terms) > _TIE:
            given = collision.impulses
        change, impulses = np.zeros(self.size), np.zeros((count, 2))
        change[self.moved] = collision.change
        impulses[self.group] = list(map(into_cone, given, self.cones))
        states, indeterminate = ["open"] * count, [False] * count
        for k, i in enumerate(self.group):
            states[i], indeterminate[i] = collision.states[k], unknown[k]
        return Impulses(change, impulses, tuple(states), tuple(indeterminate), collision.violation)


def _choices(law: ContactLaw) -> tuple[int, ...]:
    if law.cone_t == 0.0:
        return (FREE, SLIDE)
    if not any(state in SLIDING for state in law.states):
        return (FREE, PIN)  # declared not to slip, at whatever force
    steep = (_PRESS,) if law.cone_t > STEEP * law.cone_n else ()
    return (FREE, SLIDE_PLUS, SLIDE_MINUS, PIN, *steep)


def _mode(impulse: tuple[float, float], cone: tuple[float, float]) -> int:
    (V, H), (cone_n, cone_t) = impulse, cone
    if V == 0.0 and H == 0.0:
        return FREE
    if cone_t == 0.0:
        return SLIDE
    if H == 0.0:
        return _PRESS
    # Steep cones were cut for Lemke's algorithm.
    inside = cone_t * V - max(cone_n, STEEPEST) * abs(H)
    if inside > _ON_EDGE * math.hypot(V, H):
        return PIN
    return SLIDE_MINUS if H > 0.0 else SLIDE_PLUS


def _preference(collision: Impulses) -> tuple[bool, int, int, tuple[str, ...]]:
    """Most contacts closed first, then most of them sticking; names make ties deterministic."""
    states = collision.states
    return (
        collision.violation > _EXACT,
        states.count("open"),
        len(states) - states.count("stick"),
        states,
    )


def work_of(
    jacobians: Array,
    mass: Array,
    velocity: Array,
    before: Array,
    changes: Array,
    impulses: Array,
) -> tuple[Array, Array]:
    """Return the work of impulses against the surfaces, and the size of the terms it is made of.

    At the contacts, or of the bodies' momenta, whichever is made of smaller terms: where impulses
    are huge and cancel, rounding hides it in the one, and where bodies are fast in the other.

    Of (.., n) changes by (.., g, 2) impulses, from the rates `velocity` (n,) of the coordinates and
    `before` (g, 2) of the contacts.
    """
    means = 0.5 * changes
    rates = np.einsum("gdn,...n->...gd", jacobians, means)
    spread = np.einsum("gdn,...n->...gd", np.abs(jacobians), np.abs(changes))
    momenta, receding = changes @ mass, before - jacobians @ velocity
    works = np.array(
        [
            (impulses * (before + rates)).sum(axis=(-2, -1)),
            (momenta * (velocity + means)).sum(axis=-1) + (impulses * receding).sum(axis=(-2, -1)),
        ]
    )
    sizes = np.array(
        [
            (np.abs(impulses) * (np.abs(before) + spread)).sum(axis=(-2, -1)),
            (np.abs(momenta) * (np.abs(velocity) + np.abs(means))).sum(axis=-1)
            + (np.abs(impulses) * np.abs(receding)).sum(axis=(-2, -1)),
        ]
    )
    smaller = sizes.argmin(axis=0)[None]
    return (
        np.take_along_axis(works, smaller, axis=0)[0],
        np.take_along_axis(sizes, smaller, axis=0)[0],
    )
