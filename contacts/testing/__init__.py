"""Properties of every run of a scene, for users' tests and for `statechart check`.

`scene_properties` and `body_properties` are computed from the scene's own quantities and not from
the guards that were run; `assertions` has their common checks. `symmetry` mirrors and rescales
scenes and compares their runs, `violations` measures the violation of the contact laws.
"""

from contacts.dynamics.mechanics import Mechanics
from contacts.testing.assertions import assert_in_cone, largest_of, no_growth, step_ends
from contacts.testing.scene_properties import (
    assert_cone,
    assert_energy,
    assert_gaps,
    assert_impulses,
    assert_no_force_when_free,
    properties,
)
from contacts.testing.symmetry import mirrored, rescaled

__all__ = [
    "Mechanics",
    "assert_cone",
    "assert_energy",
    "assert_gaps",
    "assert_impulses",
    "assert_in_cone",
    "assert_no_force_when_free",
    "largest_of",
    "mirrored",
    "no_growth",
    "properties",
    "rescaled",
    "step_ends",
]
