"""Indeterminate loads of rigid bodies with shapes (static indeterminacy of rigid contacts).

Forces inside their cones and limits, of bearing contacts, joints and locked couplings, have
directions R (v, n) in coordinates of unit mass, and hold directions G (v, n). A change d of forces
with ``R^T d = 0`` moves nothing: forces of joints and couplings that it changes are indeterminate.
They differ where friction slides: if the rank of R is larger than that of G, the motion is open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import numpy as np

from contacts.collision_detection.body_numbers import ALONG_X, ALONG_Y, BOTH, ROD, ROPE, BodyNumbers
from contacts.rigid_bodies.mechanics import energy_root
from contacts.rigid_bodies.workspace import Workspace
from contacts.solvers.dependence import dependent_rows, null_space
from contacts.states import LOCKED, open_motion_warning
from contacts.time_stepping.stability import Held
from statechart.arrays import Array, Bools, Ints

MAX_BODIES = 32
"""Moving bodies up to which loads are checked: heaps are indeterminate as a rule."""

# Relative size of dependent directions: normals of bodies that rest on each other differ by the
# depths of their contacts.
_DEPENDENT = 1e-5
# Change of a force, relative to the others, below which it is determined.
_CHANGED = 1e-3
# Relative error of impulses: closer to the boundary of their cones forces are on it.
_ON_BOUNDARY = 1e-4
_COMPONENTS = {BOTH: "XY", ALONG_X: "X", ALONG_Y: "Y", ROD: "T", ROPE: "V"}


class BearingForces(NamedTuple):
    """Forces (v,) inside their cones and limits: of contacts, then those that formulas know."""

    owners: Sequence[int]  # Contacts of the first forces.
    shown: Sequence[str]  # Names of the others.
    directions: Array  # (v, n): R and G, unit vectors.
    held: Array

    @classmethod
    def of(
        cls, numbers: BodyNumbers, space: Workspace, contacts: int, modes: Ints,
        titles: tuple[Sequence[str], Sequence[str]], state: Array,
    ) -> Self | None:  # fmt: skip
        """Return the forces of the step in `space`, which has so many contacts.

        None where they leave nothing open: in a step with impacts or rolling resistance, and
        without sliding friction if there is nothing to show. `titles` are the names of joints and
        of couplings, whose modes are `modes` (c,).
        """
        active, kinds = space.active, numbers.joints.kinds
        forces, rows, bodies = space.pressed, active.rows, active.bodies
        if active.hit[:contacts].any() or active.rolling_roles[:contacts].any():
            return None
        which, parts, shown = list[int](), list[tuple[float, float]](), list[str]()
        least = _ON_BOUNDARY * float(forces[:contacts, 0].max(initial=0.0))
        rigid = active.compliances[:contacts] == 0.0
        for i in np.flatnonzero(rigid & (forces[:contacts, 0] > least)).tolist():
            pn, pt = forces[i].tolist()
            along, across = active.materials[i, :2].tolist()
            sticks = abs(pt) * along < (1.0 - _ON_BOUNDARY) * pn * across
            which += [i, i] if sticks else [i]
            parts += [(1.0, 0.0), (0.0, 1.0)] if sticks else [(1.0, pt / pn)]
        owners = which.copy()
        for j, kind in enumerate(kinds.tolist()):
            i, joint = contacts + j, titles[0][numbers.joints.owners[j]]
            for d, component in enumerate(_COMPONENTS.get(kind, "M")):
                if active.materials[i, 0] < 0.0 or forces[i, d] > 0.0:
                    which.append(i)
                    parts.append((1.0 - d, 1.0 * d))
                    shown.append(f"{joint}.{component}")
        for c in np.flatnonzero(modes == LOCKED).tolist():
            i = contacts + len(kinds) + c
            if abs(forces[i, 1]) < (1.0 - _ON_BOUNDARY) * forces[i, 0]:
                which.append(i)
                parts.append((0.0, 1.0))
                shown.append(f"{titles[1][c]}.M")
        combined = np.array(parts).reshape(-1, 2)
        slides: Bools = np.all(combined != 0.0, axis=1)
        if not owners or not (shown or slides.any()):
            return None
        root = energy_root(numbers, state)

        def unit_rows(weights: Array) -> Array:
            held = Held(bodies[which], np.einsum("vd,vdk->vk", weights, rows[which]))
            found: Array = numbers.whole(held.whole(len(numbers.inverse)), state) @ root
            return found / np.linalg.norm(found, axis=1, keepdims=True)

        directions = unit_rows(combined)
        held = unit_rows(np.where(slides[:, None], (1.0, 0.0), combined))
        # Joints that others imply are named when they close.
        loads = len(owners)
        implied = dependent_rows(directions[loads:])
        kept = np.append(np.ones(loads, np.bool_), ~implied)
        shown = [name for name, drop in zip(shown, implied.tolist(), strict=True) if not drop]
        return cls(owners, shown, directions[kept], held[kept])

    def warnings(self, time: float, pair: Callable[[int], str]) -> dict[str, str]:
        """Return warnings of indeterminate forces, and of a motion that they leave open.

        `pair` returns the names of the two bodies of a contact.
        """
        loads, result = len(self.owners), dict[str, str]()

        def pairs(changes: Array) -> list[str]:
            differ = np.flatnonzero(np.abs(changes[:loads]).max(axis=1) > _CHANGED)
            return [*dict.fromkeys(pair(self.owners[i]) for i in differ.tolist())]

        still, spare = (null_space(r.T, _DEPENDENT) for r in (self.directions, self.held))
        if spare.shape[1] > still.shape[1]:
            names = pairs(spare @ (self.directions.T @ spare).T)
            result["motion"] = open_motion_warning(names, time)
        changed = loads + np.flatnonzero(np.linalg.norm(still[loads:], axis=1) > _CHANGED)
        if len(changed):
            forces = ", ".join(self.shown[i - loads] for i in changed.tolist())
            result["forces"] = (
                f"from t = {time:.6g} the forces {forces} are indeterminate: "
                f"{', '.join(pairs(still @ still[changed].T))} can share their load in several "
                "ways, and one is shown"
            )
        return result
