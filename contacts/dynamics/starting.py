"""Checks of the start of a scene: its joints close, and its contacts allow it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.scales import Scales
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot, SnapshotTape
from contacts.scene.expansion import Reach, Stop, reach_of
from contacts.scene.parts import Point, Surface
from contacts.scene.scene import Scene
from contacts.solvers.dependence import implied, least
from contacts.states import OFF
from statechart.arrays import Array
from statechart.errors import DeclarationProblem, NoConsistentMode
from statechart.kernels.jit import kernel

_ITERATIONS = 50
# Part of the accelerations: contradictory ones are off by their own size, consistent ones by
# round-off.
_ACCELERATION = 1e-8
# Joints whose part in a contradiction is smaller than this take none.
_PART = 1e-6
_MOST_NAMED = 6
# A start no higher above a surface than this part of the length, and no faster than what would
# throw it so high, is at rest on it but for rounded coordinates.
_HOVERING = 1e-6


@kernel
def hovers(gap: float, rate: float, near: float, length: float, speed: float) -> bool:
    """Return whether a contact starts off its surface by next to nothing, but more than `near`."""
    slow = rate * rate <= _HOVERING * (speed * speed)
    return near < gap and gap <= _HOVERING * length and slow


def hovering(
    scene: Scene,
    scales: Scales,
    near: float,
    names: Sequence[str],
    moves: Sequence[Sequence[float]],
) -> list[str]:
    """Return a warning for each contact that starts off its surface by next to nothing.

    `names` are the contacts that are not off, `moves` their gaps and the rates of these; they are
    closed up to the gap `near`.
    """
    return [
        f"contact {name!r} starts {move[0]:.3g} off surface {scene.contacts[name].surface!r}: "
        "write the exact coordinate if it should rest there"
        for name, move in zip(names, moves, strict=True)
        if hovers(move[0], move[1], near, scales.length, scales.speed)
    ]


def check_places(names: Sequence[str], snapshot: Snapshot) -> None:
    """Refuse a start at which a contact has no place or velocity; one that is off has."""
    for name, contact in zip(names, snapshot.contacts, strict=True):
        if not all(map(math.isfinite, contact[1:5])) or math.isnan(contact.gap):
            raise DeclarationProblem(
                "its place at the start is not finite",
                advice="look for a logarithm, a root or a quotient without a value there",
                loc=("contacts", name),
            )


def check_start(
    surface: Surface,
    law: ContactLaw,
    moves: Sequence[float],
    depth: float,
    near: float,
    slow: float,
) -> None:
    """Refuse a contact that starts inside its surface, or free though it does not list that.

    It moves by its gap, the rate of that and its slip. A start may be inside by `depth`; `near` and
    `slow` are the tolerances of gap and speed.
    """
    gap, gap_rate, slip = moves
    if gap < -depth and isinstance(surface, Reach | Stop):
        rope = isinstance(surface, Reach)
        joint = law.name if rope else law.name.rpartition("_")[0]
        raise DeclarationProblem(
            f"rope {joint!r} is {-gap:.6g} shorter than the distance of its ends at the start"
            if rope
            else f"joint {joint!r} starts {-gap:.6g} rad beyond a limit of its angle",
            advice=f"change the start, or {'the length' if rope else 'the limits'}",
            loc=("joints", joint),
        )
    if gap < -depth:
        gated = f", or write modes: {{{law.name}: off}}" if OFF in law.states else ""
        raise DeclarationProblem(
            f"contact {law.name!r} starts inside its surface, {-gap:.6g} deep",
            advice=f"move the body out of the surface{gated}{_solid(surface)}",
            loc=("contacts", law.name),
        )
    if "free" in law.states:
        return
    loc = ("contacts", law.name, "modes")
    if gap > near:
        raise DeclarationProblem(
            f"contact {law.name!r} starts {gap:.6g} off its surface, "
            "and free is not among its modes",
            advice="add free, or start the body on the surface",
            loc=loc,
        )
    if gap_rate > slow:
        raise DeclarationProblem(
            f"contact {law.name!r} starts leaving its surface at {gap_rate:.6g}, "
            "and free is not among its modes",
            advice="add free, or start the body along the surface",
            loc=loc,
        )
    if law.states == ("pin",) and abs(slip) > 2.0 * slow and gap_rate >= -slow:
        raise DeclarationProblem(
            f"contact {law.name!r} starts slipping at {slip:.6g}, and slide is not among its modes",
            advice="add slide, with a friction, or start its point at rest",
            loc=loc,
        )


def _solid(surface: Surface) -> str:
    """Return where the solid of a surface is, of which that is a matter of how it is written."""
    if surface.line is not None or surface.edge is not None:
        return "; the solid of a line is on the right of the way from its first point to its second"
    if surface.circle is not None:
        return "; a circle is solid around it" if surface.hollow else "; a circle is solid inside"
    return ""


def check_limits(names: Sequence[str], limits: Array) -> None:
    """Refuse limits (k, 2) of couplings, static and kinetic, that are none at the start."""
    for name, (static, kinetic) in zip(names, limits.tolist(), strict=True):
        loc = ("couplings", name, "limit")
        if not (math.isfinite(static) and math.isfinite(kinetic)):
            problem, advice = "it has no finite value at the start", "write a limit that has one"
        elif kinetic < 0.0:
            problem = f"must be zero or positive, not {kinetic:g} at the start"
            advice = "a coupling that lets go is one with enabled: RELATION"
        elif static < kinetic:
            problem = f"the static limit {static:g} is below the kinetic one, {kinetic:g}"
            advice = "exchange them, or write one formula for both"
        else:
            continue
        raise DeclarationProblem(problem, advice=advice, loc=loc)


def check_joints(
    mechanics: Mechanics, snapshots: SnapshotTape, setup: SceneSetup, allowed: float
) -> None:
    """Check positions, velocities and accelerations of the start.

    Raises `DeclarationProblem` if a joint is open, or its bodies move apart, or joints contradict
    one another.
    """
    if not mechanics.joint_rows:
        return
    scales, tolerances = setup.scales, setup.tolerances
    names = [row.joint for row in mechanics.joint_rows]
    held = snapshots.at(setup.values, setup.initial, 0.0).held
    assert held is not None
    joints = held.joints
    if not joints.on.any():
        return
    names = [name for name, on in zip(names, joints.on.tolist(), strict=True) if on]
    joints = joints.closed()
    apart = _distances(names, joints.gaps)
    worst = max(apart, key=lambda name: apart[name])
    if apart[worst] > max(allowed * scales.length, tolerances["gap"]):
        raise DeclarationProblem(
            f"joint {worst!r} is open at the start: {_ends(mechanics, worst)} {apart[worst]:.6g} "
            "apart",
            advice=_nearest(mechanics, snapshots, setup),
            loc=("joints", worst),
        )
    change, left = least(joints.jacobian, -joints.rates)
    slow = max(allowed * scales.speed, tolerances["speed"])
    if np.abs(left).max() > slow:
        raise _contradiction(names, left, "velocity")
    speeds = _distances(names, joints.rates)
    worst = max(speeds, key=lambda name: speeds[name])
    if speeds[worst] > slow:
        size = len(change)
        rates = setup.initial[size:] + change
        rate_names = [mechanics.scene.rate_name(name) for name in mechanics.names]
        raise DeclarationProblem(
            f"joint {worst!r} does not hold at the start: {_ends(mechanics, worst)} moving apart "
            f"at {speeds[worst]:.6g}",
            advice="velocities that it allows: " + _listed(rate_names, rates, change),
            loc=("joints", worst),
        )
    _, left = least(joints.jacobian, -joints.biases)
    largest = max(scales.acceleration, float(np.abs(joints.biases).max()))
    if np.abs(left).max() > _ACCELERATION * largest:
        raise _contradiction(names, left, "acceleration")


def check_closing(
    mechanics: Mechanics, snapshot: Snapshot, joint: str, near: float, late: float = 0.0
) -> None:
    """Raise `NoConsistentMode` if the points of a joint are apart that closes.

    By more than `near` and what they move in a time `late`, to second order. Also if the other
    closed joints imply a row of it, as forces would not be determined.
    """
    held = snapshot.held
    assert held is not None
    rows = [row.joint == joint for row in mechanics.joint_rows]
    gaps, rates = np.abs(held.joints.gaps[rows]), np.abs(held.joints.rates[rows])
    # Closed joints are apart by h^2 w^2/8 between steps, and so is one that takes over from them.
    bends = 0.5 * late * late * np.abs(held.joints.biases[rows])
    if (gaps > near + late * rates + bends).any():
        raise NoConsistentMode(
            f"joint {joint!r} closes while {_ends(mechanics, joint)} {gaps.max():.6g} apart; write "
            "rest: captured, or enable it where they meet"
        )
    names = np.array([row.joint for row in mechanics.joint_rows])[~held.joints.redundant]
    spare = implied(held.joints.jacobian[~held.joints.redundant])
    if spare.any():
        raise NoConsistentMode(
            f"joint {joint!r} closes, and closed joints imply a component of "
            f"{' and '.join(dict.fromkeys(names[spare].tolist()))}; hold fewer components"
        )


def _distances(names: Sequence[str], gaps: Array) -> dict[str, float]:
    result = dict.fromkeys(names, 0.0)
    for name, gap in zip(names, gaps.tolist(), strict=True):
        result[name] = float(np.hypot(result[name], gap))
    return result


def _ends(mechanics: Mechanics, name: str) -> str:
    joint = mechanics.scene.joints[name]
    if isinstance(joint.to, Point):
        return f"its points of {joint.point.body!r} and {joint.to.body!r} are"
    return f"its point of {joint.point.body!r} and its place in the world are"


def _contradiction(names: Sequence[str], left: Array, what: str) -> DeclarationProblem:
    largest = float(np.abs(left).max())
    concerned = [n for n, r in zip(names, left.tolist(), strict=True) if abs(r) > _PART * largest]
    concerned = list(dict.fromkeys(concerned))
    subject = (
        f"the joints {', '.join(map(repr, concerned))} contradict one another"
        if len(concerned) > 1
        else f"joint {concerned[0]!r} contradicts itself"
    )
    return DeclarationProblem(
        f"{subject}: no {what} of the bodies satisfies them",
        advice="compare the paths that they follow, or remove one",
        loc=("joints", concerned[-1]),
    )


def _nearest(mechanics: Mechanics, snapshots: SnapshotTape, setup: SceneSetup) -> str:
    """Return where the joints would close, found by Gauss and Newton from the start, or not."""
    size = len(setup.initial) // 2
    state = setup.initial.copy()
    closest = np.inf
    for _ in range(_ITERATIONS):
        held = snapshots.at(setup.values, state, 0.0).held
        assert held is not None
        on = held.joints.on
        gaps = held.joints.gaps[on]
        if not np.isfinite(gaps).all():
            break
        closest = min(closest, float(np.abs(gaps).max()))
        if closest <= setup.tolerances["gap"]:
            shift = state[:size] - setup.initial[:size]
            return "a position that closes all: " + _listed(mechanics.names, state[:size], shift)
        state[:size] += least(held.joints.jacobian[on], -gaps)[0]
    return (
        f"no position near the start closes all joints (least distance found: {closest:.6g}); "
        "compare lengths and places"
    )


def _listed(names: Sequence[str], values: Array, changes: Array) -> str:
    """Return the values that changed, the largest changes first."""
    order = np.argsort(-np.abs(changes))
    changed = [k for k in order[:_MOST_NAMED] if abs(changes[k]) > _PART * np.abs(changes).max()]
    more = ", ..." if len(changed) == _MOST_NAMED < len(names) else ""
    return ", ".join(f"{names[k]} = {values[k]:.6g}" for k in changed) + more


def torn(surface: str, contact: str, state: str) -> NoConsistentMode:
    """Return why a run ends where the velocity of a surface jumps under a contact."""
    return NoConsistentMode(
        f"the velocity of surface {surface!r} jumps, and {contact!r} would "
        f"be {state}, which is not among its modes; add it, or let the velocity flow"
    )


def jumped_in(surface: str, contact: str, depth: float) -> NoConsistentMode:
    """Return why a run ends where a transition displaces a surface into a point."""
    what = f"surface {surface!r} jumps {depth:.3g} deep into the point of {contact!r}"
    if surface == reach_of(contact):
        what = f"rope {contact!r} jumps to {depth:.3g} below the distance of its ends"
    return NoConsistentMode(
        f"{what}; write a path that moves there in a time, or let a variable flow"
    )
