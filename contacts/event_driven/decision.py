"""Selection of the mode of the contacts at a state, or of a jam that precedes it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import compress, pairwise

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.projection import on_constraints
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import PerContact, Snapshot, close_compliant
from contacts.impacts.jamming import Jam, paradoxes, resolve_jam
from contacts.modes.classification import Before, Choice, ForceUncertainty, choose
from contacts.modes.compiled_classification import ENDLESS
from contacts.solvers.dependence import DEAD_POINT, USER_DIGITS
from contacts.states import INACTIVE, OFF, STICKING, cause_of, superstates_of
from statechart.arrays import Array
from statechart.automaton.trace import Key
from statechart.errors import DeclarationProblem, NoConsistentMode


def choose_mode(
    setup: SceneSetup,
    snapshot: Snapshot,
    touching: Sequence[bool],
    before: Before | None = None,
    uncertainty: ForceUncertainty | None = None,
) -> Choice | Jam:
    """Return the mode of the touching contacts, or the jam (impact without collision) before it.

    `uncertainty` bounds the error of a state at which contacts may have come to rest. An error
    lists every candidate with its reason, and the Painleve paradoxes.
    """
    check_listed(setup, snapshot, touching)
    snapshot = close_compliant(snapshot, touching)
    level, resting = _level_feet(setup, snapshot, touching)
    try:
        choice = choose(setup, snapshot if resting else level, touching, before, uncertainty)
        if any(choice.taken.states[i] not in STICKING for i in resting):
            choice = choose(setup, level, touching, before, uncertainty)
    except NoConsistentMode as error:
        jam = resolve_jam(setup, snapshot, touching)
        if setup.paradox == "impact" and jam is not None:
            return replace(jam, considered=error.considered)
        reports = [str(error), *map(str, paradoxes(setup, snapshot, touching).values())]
        shut = [*compress(zip(setup.contacts, snapshot.contacts, strict=True), touching)]
        slides = any(abs(contact.slip) > setup.slip_tolerance for _, contact in shut)
        may_open = all("free" in law.states for law, _ in shut)
        if len(shut) > 1 and slides and may_open and setup.paradox == "impact":
            reports.append("where friction jams several contacts at once, take the engine impulse")
        raise NoConsistentMode("; ".join(reports), considered=error.considered) from None
    if np.abs(choice.taken.forces).max(initial=0.0) > ENDLESS * setup.scales.force:
        jam = resolve_jam(setup, snapshot, touching)
        if setup.paradox == "impact" and jam is not None:
            return replace(jam, considered=choice.considered)
    if choice.warning:
        reports = [choice.warning, *map(str, paradoxes(setup, snapshot, touching).values())]
        choice = choice._replace(warning="; ".join(reports))
    return choice


# Centripetal acceleration, relative to the scale, by which two feet differ that part at once as
# their body turns. Round-off is 6e-18 (a floor that shakes level feet by 0.03 of gravity); the
# table of `test_compliant_feet` has 2.4e-7 as it swings through level.
_PARTING = 1e-8


def _level_feet(
    setup: SceneSetup, snapshot: Snapshot, touching: Sequence[bool]
) -> tuple[Snapshot, list[int]]:
    """Return the snapshot with dependent rows of nearly level feet, and the feet if they rest.

    Two compliant feet of a body aslant by an angle a pin its rotation by forces of its moment / a.
    If these are too large, the feet move by less than the tolerance of slip: one of them implies
    the other, until a margin of kind `implied` falls. Feet of a body that turns part at once.
    """
    sticking = [
        i
        for i in np.flatnonzero(snapshot.soft).tolist()
        if touching[i] and abs(snapshot.contacts[i].slip) <= setup.slip_tolerance
    ]
    if len(sticking) < 2:
        return snapshot, []
    (_, levers), scales = _motions(setup, snapshot), setup.scales
    jacobians, biases = snapshot.jacobians.copy(), snapshot.biases.copy()
    slips = np.array([contact.slip for contact in snapshot.contacts])
    independent, resting = sticking[:1], sticking
    for i in sticking[1:]:
        earlier = jacobians[independent, 1] * levers
        weights = np.linalg.lstsq(earlier.T, jacobians[i, 1] * levers)[0]
        row, bias = weights @ jacobians[independent, 1], weights @ biases[independent, 1]
        off = np.abs((row - jacobians[i, 1]) * levers).max() / scales.length
        if off > DEAD_POINT or abs(bias - biases[i, 1]) > _PARTING * scales.acceleration:
            independent.append(i)
            continue
        # The body moves along with this speed.
        along = abs(weights @ slips[independent] - slips[i])
        if off <= USER_DIGITS or along > off * setup.slip_tolerance:
            resting = []
        jacobians[i, 1], biases[i, 1] = row, bias
    if len(independent) == len(sticking):
        return snapshot, []
    return snapshot._replace(jacobians=jacobians, biases=biases), resting


def _motions(setup: SceneSetup, snapshot: Snapshot) -> tuple[Array, Array]:
    """Return the independent motions (coordinates, n) that joints allow, and their sizes (n,)."""
    whole = np.append(setup.scales.coordinates, np.ones(snapshot.unreduced.pads))
    basis = np.eye(len(whole)) if snapshot.reduction is None else snapshot.reduction.basis
    return basis, 1.0 / np.abs(basis / whole[:, None]).max(axis=0)


# A tangential row below this, relative to the scales, is zero.
_NULL_ROW = 1e-9
# Smaller accelerations, relative to the scales, are round-off.
_STILL = 1e-12
# The slip of a point is evaluated at times that shrink by this factor, at most so often, until it
# grows by a power of time to this accuracy: its leading power decides the direction.
_SHORTER, _TRIALS, _CLEAR = 4.0, 10, 0.02


def choose_at_rest(
    setup: SceneSetup,
    snapshot: Snapshot,
    touching: Sequence[bool],
    state: Array,
    at: Callable[[Array, float], Snapshot],
    before: Before | None = None,
    uncertainty: ForceUncertainty | None = None,
) -> Choice | Jam:
    """Return the mode as `choose_mode` does, also at dead points of linkages.

    At a dead point no motion moves a resting point along its surface to first order (a crank and
    its slider in line): friction cannot hold the linkage there, and the point slips as the motion
    goes on. `at` gives the snapshot at a state after a time.
    """
    slip_tolerance, sizes = setup.slip_tolerance, setup.scales.coordinates
    half = len(sizes)
    basis, levers = _motions(setup, snapshot)
    idle = [
        i
        for i, row in enumerate(snapshot.jacobians[:, 1])
        if touching[i]
        and abs(snapshot.contacts[i].slip) <= slip_tolerance
        and np.abs(row * levers).max(initial=0.0) <= _NULL_ROW * setup.scales.length
        and abs(snapshot.biases[i, 1]) <= _NULL_ROW * setup.scales.acceleration
    ]
    if idle:
        # Round-off in a row (sin(pi) is 1e-16) would divide forces by itself.
        jacobians = snapshot.jacobians.copy()
        jacobians[idle, 1] = 0.0
        snapshot = snapshot._replace(jacobians=jacobians)
    choice = choose_mode(setup, snapshot, touching, before, uncertainty)
    if not idle or isinstance(choice, Jam):
        return choice
    accelerations = snapshot.solved(choice.taken.accelerations, choice.taken.forces)[0][:half]
    paces = np.abs(accelerations) / sizes
    if not paces.max() > _STILL * setup.scales.acceleration / setup.scales.length:
        # Contacts are pinned. A coupling without a row cannot be locked: the way in which a slow
        # motion would turn it decides, so that round-off does not grow.
        idle = [i for i in idle if setup.contacts[i].coupling]
        if not idle or basis.shape[1] != 1:
            return choice
        accelerations = basis[:half, 0]
        paces = np.abs(accelerations) / sizes

    def slips(later: float) -> Array:
        """Return the slips of the points after a time."""
        rates, moved = later * accelerations, state.copy()
        moved[:half] += 0.5 * later * rates
        moved[half : 2 * half] = rates
        moved = on_constraints(("free",) * len(touching), at(moved, later), moved)
        contacts = at(moved, later).contacts
        return np.array([contacts[i].slip for i in idle])

    # The acceleration moves a point by about the scale of lengths in the longest time.
    longest = 1.0 / math.sqrt(paces.max())
    times = longest / _SHORTER ** np.arange(_TRIALS)
    found = np.array([slips(time) for time in times])
    least = _NULL_ROW * setup.scales.length * paces.max() * times
    moving, turned = [*snapshot.contacts], False
    for i, slip in zip(idle, found.T, strict=True):
        for (longer, shorter), round_off in zip(pairwise(slip.tolist()), least[1:], strict=True):
            if longer * shorter > 0.0 and abs(shorter) > round_off:
                power = math.log(longer / shorter, _SHORTER)
                if power > 0.5 and abs(power - round(power)) < _CLEAR:
                    onwards = math.copysign(2.0 * slip_tolerance, shorter)
                    moving[i], turned = moving[i]._replace(slip=onwards), True
                    break
    if not turned:
        return choice
    snapshot = snapshot._replace(contacts=tuple(moving))
    return choose_mode(setup, snapshot, touching, before, uncertainty)


def check_listed(setup: SceneSetup, snapshot: Snapshot, touching: Sequence[bool]) -> None:
    """Raise `NoConsistentMode` if a contact opens or slips and does not list that mode."""
    gap_tolerance, slip_tolerance = setup.tolerances["gap"], setup.slip_tolerance
    for law, contact, is_touching in zip(setup.contacts, snapshot.contacts, touching, strict=True):
        if (
            law.coupling
            or "free" in law.states
            or (contact.gap <= gap_tolerance and not is_touching and contact.gap_rate < 0.0)
        ):
            continue
        if not is_touching:
            motion, missing = f"leaves its surface at {contact.gap_rate:.3g}", "free"
        elif law.states == ("pin",) and abs(contact.slip) > slip_tolerance:
            motion, missing = f"slips at {contact.slip:.3g}", "slide"
        else:
            continue
        raise NoConsistentMode(
            f"contact {law.name!r} {motion}, and {missing} is not among its modes; "
            "add it, or end the run before"
        )


def explain_choice(
    before: Mapping[str, str],
    laws: Sequence[ContactLaw],
    contacts: Sequence[PerContact],
    closed: Sequence[bool],
    touching: Sequence[bool],
    after: Mapping[str, str],
) -> dict[str, str]:
    """Return mode or state -> reason why it was taken or rejected at an impact.

    `before` has the reasons that caused the impact, `after` those for the `touching` contacts,
    which remain closed; the other `closed` ones leave their surfaces.
    """
    considered = {label: f"before the impact {why}" for label, why in before.items()}
    for law, contact, struck, remains in zip(laws, contacts, closed, touching, strict=True):
        leaving = f"it leaves its surface at {contact.gap_rate:.3g}"
        for state in law.states if struck and not remains else ():
            if state in INACTIVE:
                continue
            reason = f"taken: {leaving}" if state == "free" else leaving
            known = considered.get(label := f"{law.name}:{state}")
            considered[label] = f"{reason}; {known}" if known else reason
    return {**considered, **after}


def check_declared(
    modes: Mapping[str, str],
    names: Sequence[str],
    choice: Choice,
    snapshot: Snapshot,
    touching: Sequence[bool],
    failing: Sequence[str],
) -> None:
    """Check the declared initial modes against those that the initial state requires."""
    for name, declared in modes.items():
        place = names.index(name)
        required = choice.taken.states[place]
        if declared in {required, *superstates_of((required,)).values()}:
            continue
        labels = {f"{name}:{declared}{direction}" for direction in ("", "+", "-")}
        reasons = [why for label, why in choice.considered.items() if labels & {*label.split()}]
        slips = f"its point slips at {snapshot.contacts[place].slip:.3g}"
        why = [*reasons, slips if touching[place] else "its gap is open or opening"][0]
        if required == OFF:
            why = f"the condition {failing[place]} fails"
        elif declared == OFF:
            why = "its conditions hold, and it is not inside its surface"
        raise DeclarationProblem(
            f"contact {name!r} cannot start in mode {declared!r}: {why}",
            advice=f"the initial state calls for {required!r}",
            loc=("modes", name),
        )


def cause(names: Sequence[str], source: Key, target: Key, skipping: bool) -> tuple[str, str]:
    """Return (region, cause) of the first contact that changes."""
    for name, before, after in zip(names, source, target, strict=True):
        if before != after:
            return name, "zeno" if skipping and before == "free" else cause_of(before, after)
    return names[0], "zeno"
