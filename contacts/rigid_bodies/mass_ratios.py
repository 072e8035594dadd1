"""Masses that differ by more than arithmetic carries, where impulses miss the contact laws."""

from __future__ import annotations

from collections.abc import Sequence

from statechart.arrays import Array, Ints
from statechart.kernels.jit import late

# What impulses are known to: a stack of twelve under a body of 1e8 times their mass misses 1e-6 in
# half of its steps, two bodies do so from 4e9 on, which is the rounding of one product.
_ROUNDING = 64.0 * 2.0**-52
# Impulses that miss by a tenth of the fastest approach hold nothing apart.
_HOLDS_NOTHING = 0.1


@late
def note_worst(inverse: Array, bodies: Ints, members: Ints, missed: float, worst: Array) -> None:
    """Note an island if its masses differ by more than those of islands noted before.

    Parameters
    ----------
    inverse : (b, 3)
        See `contacts.collision_detection.body_numbers.BodyNumbers`.
    bodies : (c, 2) array of int
        Which touch, -1 for a surface.
    members : (m,) array of int
        The island's contacts.
    missed : float
        Residual of their impulses.
    worst : (4,)
        Ratio of masses, the lightest body, the heaviest, and the residual; in place.
    """
    light = heavy = -1
    for i in members:
        for side in range(2):
            b = bodies[i, side]
            if b >= 0 and (light < 0 or inverse[b, 0] > inverse[light, 0]):
                light = b
            if b >= 0 and (heavy < 0 or inverse[b, 0] < inverse[heavy, 0]):
                heavy = b
    ratio = inverse[light, 0] / inverse[heavy, 0]
    if ratio > worst[0]:
        worst[0], worst[1], worst[2], worst[3] = ratio, light, heavy, missed


def ratio_remarks(worst: Array, names: Sequence[str], allowed: float) -> tuple[str, ...]:
    """Return what is said of masses at which a tolerance cannot be met."""
    ratio, light, heavy, missed = worst.tolist()
    # Beside bodies of one mass it is the tolerance that is below rounding.
    if ratio * _ROUNDING <= allowed or allowed < _ROUNDING:
        return ()
    reached = max(ratio * _ROUNDING, missed)
    looser = f", or a tolerance of {reached:.0e}" if reached < _HOLDS_NOTHING else ""
    return (
        f"the masses of bodies {names[int(light)]!r} and {names[int(heavy)]!r}, which are pressed "
        f"together, are 1 to {ratio:.2g}: rounding of the heavy one's impulses moves the light one "
        f"by more than the tolerance of impulses, {allowed:g}; they miss the contact laws by "
        f"{missed:.2g} of the fastest approach. Take masses within 1 to "
        f"{allowed / _ROUNDING:.0e}{looser}",
    )
