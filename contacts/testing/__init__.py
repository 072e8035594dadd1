"""Properties of every run of a scene, for users' tests and for `statechart check`.

`scene_properties` and `body_properties` are what must hold, computed from the scene's own
quantities and not from the guards that were run; `assertions` is what they share. `symmetry`
mirrors and rescales scenes, `violations` measures by how much a run misses what must hold.
"""

from contacts.testing.assertions import (
    assert_in_cone,
    largest_of,
    no_growth,
    step_ends,
)
from contacts.testing.scene_properties import (
    assert_cone,
    assert_energy,
    assert_gaps,
    assert_impulses,
    assert_no_force_when_free,
    properties,
)

__all__ = [
    "assert_cone",
    "assert_energy",
    "assert_gaps",
    "assert_impulses",
    "assert_in_cone",
    "assert_no_force_when_free",
    "largest_of",
    "no_growth",
    "properties",
    "step_ends",
]
