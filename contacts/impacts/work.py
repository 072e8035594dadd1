"""The work of impulses on bodies, computed where rounding hides it least."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array


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

    Parameters
    ----------
    jacobians : (g, 2, n), mass : (n, n)
    velocity : (n,), before : (g, 2)
        Before the impact, of the coordinates and of the contacts.
    changes : (.., n), impulses : (.., g, 2)

    Returns
    -------
    work, size : (..) array
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
