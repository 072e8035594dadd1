"""Checks of the initial state: joints close, contacts have an admissible mode."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import compress

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.joints import JointNumbers
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.scales import Scales
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot, SnapshotTape
from contacts.scene.expansion import Reach, Stop, limit_contacts, start_problem
from contacts.scene.lint import angles_in_degrees
from contacts.scene.parts import Point, Surface
from contacts.scene.scene import Scene
from contacts.solvers.dependence import dependent_rows, least_squares
from contacts.states import OFF
from statechart.arrays import Array
from statechart.errors import DeclarationProblem, NoConsistentMode
from statechart.kernels.jit import kernel

_MAX_ITERATIONS = 50
# Allowed residual of joint accelerations, relative to the largest. Contradictory joints have a
# residual of order 1, consistent ones round-off.
_MAX_ACCELERATION_RESIDUAL = 1e-8
# Relative residuals and changes below this are not reported.
_MIN_SHARE = 1e-6
_MAX_NAMED = 6
# A gap below this part of the length, with a speed that would not raise the contact higher, is
# probably a rounded coordinate.
_HOVERING = 1e-6
# Part of its limit by which a coupling may slip late without a warning.
_WEAK = 1e-6


@kernel
def starts_hovering(
    gap: float, rate: float, gap_tolerance: float, length: float, speed: float
) -> bool:
    """Return whether a contact starts above its surface by a gap that looks like round-off."""
    slow = rate * rate <= _HOVERING * (speed * speed)
    return gap_tolerance < gap and gap <= _HOVERING * length and slow


def hovering_warnings(
    scene: Scene,
    scales: Scales,
    gap_tolerance: float,
    names: Sequence[str],
    gaps_and_rates: Sequence[Sequence[float]],
) -> list[str]:
    """Return a warning for each contact that starts above its surface by a tiny gap.

    `names` are the contacts that are not off, `gaps_and_rates` their gaps and gap rates. The
    length may be a stopping distance: the gap is tiny beside the largest coordinate, too, unless it
    is that coordinate.
    """
    return [
        f"contact {name!r} starts {gap:.3g} off surface {scene.contacts[name].surface!r}: "
        "write the exact coordinate if it should rest there"
        for name, (gap, rate, *_) in zip(names, gaps_and_rates, strict=True)
        if starts_hovering(gap, rate, gap_tolerance, scales.length, scales.speed)
        and not _HOVERING * scales.farthest < gap < scales.farthest
    ]


def weak_coupling_warnings(
    laws: Sequence[ContactLaw], limits: Array, force_tolerance: float
) -> list[str]:
    """Return a warning for each coupling whose static limit is near the tolerance of forces.

    `limits` (k, 2) are those of the last k `laws`; those of rolling resistance are lengths.
    """
    couplings = laws[len(laws) - len(limits) :]
    return [
        f"coupling {law.name!r} slips up to {force_tolerance / static:.1g} of its limit too late, "
        f"as {law.lever * static:.3g} is tiny beside the forces of the scene: put heavy bodies "
        "into another scene"
        for law, static in zip(couplings, limits[:, 0].tolist(), strict=True)
        if law.carrier < 0 and 0.0 < _WEAK * static < force_tolerance
    ]


def check_place(scene: Scene, name: str, motion: Sequence[float]) -> None:
    """Refuse a contact at whose start its gap, a rate or a slip is not finite."""
    gap, *rates = motion
    if not math.isnan(gap) and all(map(math.isfinite, rates)):
        return
    if name in scene.contacts and isinstance(scene.surface_of(name), Reach):
        raise DeclarationProblem(
            f"rope {name!r} has both ends at one place at the start, and no direction",
            advice="move one of them",
            loc=("joints", name),
        )
    raise DeclarationProblem(
        "its place at the start is not finite",
        advice="look for a logarithm, a root or a quotient without a value there",
        loc=("contacts", name),
    )


def check_start(
    scene: Scene,
    law: ContactLaw,
    motion: Sequence[float],
    allowed_penetration: float,
    gap_tolerance: float,
    speed_tolerance: float,
) -> None:
    """Refuse a contact that starts inside its surface, or in a mode that it does not list.

    `motion` has its gap, gap rate and slip.
    """
    gap, gap_rate, slip = motion
    if gap < -allowed_penetration:
        surface = scene.surface_of(law.name)
        loc: tuple[str, str] = ("contacts", law.name)
        gated = f", or write modes: {{{law.name}: off}}" if OFF in law.states else ""
        problem = f"contact {law.name!r} starts inside its surface, {-gap:.6g} deep"
        advice = f"move the body out of the surface{gated}{_solid(surface)}"
        if isinstance(surface, Reach):
            loc, advice = ("joints", law.name), "change the start, or the length"
            problem = f"rope {law.name!r} is {-gap:.6g} shorter than the distance of its ends"
        elif isinstance(surface, Stop):
            loc, advice = ("joints", law.name.rpartition("_")[0]), "change the start, or the limits"
            problem = f"joint {loc[1]!r} starts beyond a limit of its angle"
        degrees = next(angles_in_degrees(scene), advice)
        raise DeclarationProblem(problem, advice=degrees, loc=loc)
    if "free" in law.states:
        return
    slips = abs(slip) > 2.0 * speed_tolerance and gap_rate >= -speed_tolerance
    if gap > gap_tolerance:
        state, missing = f"{gap:.6g} off its surface", "free"
        advice = "add free, or start the body on the surface"
    elif gap_rate > speed_tolerance:
        state, missing = f"leaving its surface at {gap_rate:.6g}", "free"
        advice = "add free, or start the body along the surface"
    elif law.states == ("pin",) and slips:
        state, missing = f"slipping at {slip:.6g}", "slide"
        advice = "add slide, with a friction, or start its point at rest"
    else:
        return
    raise DeclarationProblem(
        f"contact {law.name!r} starts {state}, and {missing} is not among its modes",
        advice=advice,
        loc=("contacts", law.name, "modes"),
    )


def _solid(surface: Surface) -> str:
    """Return a sentence on the solid side of a surface, for surfaces whose spelling decides it."""
    if surface.line is not None or surface.edge is not None:
        return "; the solid of a line is on the right of the way from its first point to its second"
    if surface.circle is not None:
        return "; a circle is solid around it" if surface.hollow else "; a circle is solid inside"
    return ""


def check_limits(laws: Sequence[ContactLaw], limits: Array) -> None:
    """Refuse static and kinetic limits (k, 2) of the last k laws that are invalid at the start."""
    for law, sizes in zip(laws[len(laws) - len(limits) :], limits, strict=True):
        static, kinetic = (law.lever * sizes).tolist()
        loc = ("couplings", law.name, "limit")
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
    try:
        _check_joints(mechanics, snapshots, setup, allowed)
    except DeclarationProblem as problem:
        values = dict(zip(mechanics.parameters.names, setup.values.tolist(), strict=True))
        problem.advice = next(angles_in_degrees(mechanics.scene), problem.advice)
        raise start_problem(mechanics.scene, problem, values) from None


def _check_joints(
    mechanics: Mechanics, snapshots: SnapshotTape, setup: SceneSetup, allowed: float
) -> None:
    scales, tolerances = setup.scales, setup.tolerances
    names = [row.joint for row in mechanics.joint_rows]
    joints = _joints_at(snapshots, setup, setup.initial) if names else None
    if joints is None or not joints.on.any():
        return
    names, joints = [*compress(names, joints.on)], joints.closed()
    worst, distance = _farthest(names, joints.gaps)
    if distance > max(allowed * scales.length, tolerances["gap"]):
        raise DeclarationProblem(
            f"joint {worst!r} is open at the start: {_ends(mechanics, worst)} {distance:.6g} apart",
            advice=_nearest(mechanics, snapshots, setup),
            loc=("joints", worst),
        )
    change, residual = least_squares(joints.jacobian, -joints.rates)
    speed_tolerance = max(allowed * scales.speed, tolerances["speed"])
    if np.abs(residual).max() > speed_tolerance:
        raise _contradiction(names, residual, "velocity")
    worst, speed = _farthest(names, joints.rates)
    if speed > speed_tolerance:
        size = len(change)
        rates = setup.initial[size : 2 * size] + change
        rate_names = [mechanics.scene.rate_name(name) for name in mechanics.names]
        raise DeclarationProblem(
            f"joint {worst!r} does not hold at the start: {_ends(mechanics, worst)} moving apart "
            f"at {speed:.6g}",
            advice="velocities that it allows: " + _format_values(rate_names, rates, change),
            loc=("joints", worst),
        )
    _, residual = least_squares(joints.jacobian, -joints.biases)
    largest = max(scales.acceleration, float(np.abs(joints.biases).max()))
    if np.abs(residual).max() > _MAX_ACCELERATION_RESIDUAL * largest:
        raise _contradiction(names, residual, "acceleration")
    # Rows of joints that never open are marked where others imply them.
    if any(row.closed is not None for row in mechanics.joint_rows):
        spare = dependent_rows(joints.jacobian[~joints.redundant])
        if spare.any():
            name = np.array(names)[~joints.redundant][spare][0].item()
            raise DeclarationProblem(
                f"joint {name!r} starts closed, and other closed joints imply a component of it",
                advice=_fewer_components(mechanics, name),
                loc=("joints", name),
            )


def check_closing(
    mechanics: Mechanics,
    snapshot: Snapshot,
    joint: str,
    gap_tolerance: float,
    time_error: float = 0.0,
) -> None:
    """Raise `NoConsistentMode` if a joint closes apart or beyond its limits, or is redundant.

    The allowed distance is `gap_tolerance` plus the motion during `time_error`, to second order. A
    limit that is exceeded by more than `gap_tolerance` would stay off.
    """
    reduction = snapshot.reduction
    assert reduction is not None
    rows = [row.joint == joint for row in mechanics.joint_rows]
    gaps, rates = np.abs(reduction.joints.gaps[rows]), np.abs(reduction.joints.rates[rows])
    # Closed joints are apart by h^2 w^2/8 between steps, and so is one that takes over from them.
    bends = 0.5 * time_error * time_error * np.abs(reduction.joints.biases[rows])
    if (gaps > gap_tolerance + time_error * rates + bends).any():
        raise NoConsistentMode(
            f"joint {joint!r} closes while {_ends(mechanics, joint)} {gaps.max():.6g} apart; write "
            "rest: captured, or enable it where they meet"
        )
    for name, contact in zip(mechanics.scene.contacts, snapshot.contacts, strict=False):
        if name in limit_contacts(joint) and -contact.gap > gap_tolerance:
            sooner = ", or take shorter steps" if time_error > 0.0 else ""
            raise NoConsistentMode(
                f"joint {joint!r} closes while its angle is beyond its limits; let enabled hold "
                f"within them{sooner}"
            )
    names = np.array([row.joint for row in mechanics.joint_rows])[~reduction.joints.redundant]
    spare = dependent_rows(reduction.joints.jacobian[~reduction.joints.redundant])
    if spare.any():
        raise NoConsistentMode(
            f"joint {joint!r} closes, and closed joints imply a component of "
            f"{' and '.join(dict.fromkeys(names[spare].tolist()))}; "
            f"{_fewer_components(mechanics, joint)}"
        )


def _fewer_components(mechanics: Mechanics, joint: str) -> str:
    advice = "hold fewer components"
    if mechanics.scene.joints[joint].angle is not None:
        advice += ", and the angle alone by a coupling with a limit that it never reaches"
    return advice


def _farthest(names: Sequence[str], gaps: Array) -> tuple[str, float]:
    """Return the joint whose components have the largest distance, and that."""
    result = dict.fromkeys(names, 0.0)
    for name, gap in zip(names, gaps.tolist(), strict=True):
        result[name] = math.hypot(result[name], gap)
    return max(result.items(), key=lambda item: item[1])


def _ends(mechanics: Mechanics, name: str) -> str:
    joint = mechanics.scene.joints[name]
    if isinstance(joint.to, Point):
        return f"its points of {joint.point.body!r} and {joint.to.body!r} are"
    return f"its point of {joint.point.body!r} and its place in the world are"


def _contradiction(names: Sequence[str], residual: Array, quantity: str) -> DeclarationProblem:
    large = np.abs(residual) > _MIN_SHARE * np.abs(residual).max()
    concerned = list(dict.fromkeys(compress(names, large)))
    subject = f"joint {concerned[0]!r} contradicts itself"
    if len(concerned) > 1:
        subject = f"the joints {', '.join(map(repr, concerned))} contradict one another"
    return DeclarationProblem(
        f"{subject}: no {quantity} of the bodies satisfies them",
        advice="compare the paths that they follow, or remove one",
        loc=("joints", concerned[-1]),
    )


def _joints_at(snapshots: SnapshotTape, setup: SceneSetup, state: Array) -> JointNumbers:
    """Return the joints as rows of coordinates, without the pads of compliant contacts."""
    reduction = snapshots.at(setup.values, state, 0.0).reduction
    assert reduction is not None
    joints = reduction.joints
    return joints._replace(jacobian=joints.jacobian[:, : snapshots.size])


def _nearest(mechanics: Mechanics, snapshots: SnapshotTape, setup: SceneSetup) -> str:
    size, state, closest = snapshots.size, setup.initial.copy(), np.inf
    for _ in range(_MAX_ITERATIONS):
        joints = _joints_at(snapshots, setup, state).closed()
        if not np.isfinite(joints.gaps).all():
            break
        closest = min(closest, float(np.abs(joints.gaps).max()))
        if closest <= setup.tolerances["gap"]:
            place, shift = state[:size], (state - setup.initial)[:size]
            return "a position that closes all: " + _format_values(mechanics.names, place, shift)
        state[:size] += least_squares(joints.jacobian, -joints.gaps)[0]
    return (
        f"no position near the start closes all joints (least distance found: {closest:.6g}); "
        "compare lengths and places"
    )


def _format_values(names: Sequence[str], values: Array, changes: Array) -> str:
    """Return the values that changed, the largest changes first, with digits that fit."""
    sizes = np.abs(changes)
    changed = [k for k in np.argsort(-sizes)[:_MAX_NAMED] if sizes[k] > _MIN_SHARE * sizes.max()]
    ellipsis = ", ..." if len(changed) == _MAX_NAMED < len(names) else ""
    return ", ".join(f"{names[k]} = {values[k]:.15g}" for k in changed) + ellipsis
