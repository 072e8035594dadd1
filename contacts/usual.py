"""The usual instant: no impact, nothing to be brought back, and one mode that agrees.

One compiled call then says which; everything else is left to the laws, which go through it step by
step (`contacts.laws`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.contact_law import cones
from contacts.dynamics.projection import landing
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SnapshotTape
from contacts.states import CODES, FREE, OFF, OPEN
from contacts.usual_kernels import usual
from statechart.arrays import Array
from statechart.automaton.trace import Key

_NAMES = {code: name for name, code in CODES.items() if name != OFF}


def usual_mode(
    setup: SceneSetup, tape: SnapshotTape, state: Array, time: float, flow: Key | None
) -> tuple[Key, float] | None:
    """Return the mode that the state calls for and the energy; None where the instant is not usual.

    Parameters
    ----------
    setup : SceneSetup
        The numbers of the run.
    tape : SnapshotTape
        Of a scene without joints.
    state : (2 n,) array
        Left as it is.
    time : float
        When.
    flow : tuple of str or None
        The mode that led here; None at the start of a run.
    """
    contacts, tolerances = setup.contacts, setup.tolerances
    near, creep = landing(tolerances)
    codes = np.empty(len(contacts), np.int64)
    numbers = np.empty(len(tape.tape.outputs))
    found = usual(
        *tape.tape.program,
        state,
        setup.values,
        time,
        _allowed(tuple([law.states for law in contacts])),
        cones(contacts),
        *_kept(flow, len(contacts)),
        near,
        creep,
        tolerances["gap"],
        tolerances["speed"],
        setup.tie,
        setup.scales.force,
        setup.scales.acceleration,
        numbers,
        codes,
    )
    if not found:
        return None
    size = tape.size
    return tuple([_NAMES[code] for code in codes.tolist()]), numbers.item(size * size + size)


@lru_cache(maxsize=1024)
def _allowed(states: tuple[tuple[str, ...], ...]) -> NDArray[np.bool_]:
    """Return (c, 5): whether a contact's region has the state of that code."""
    allowed = np.zeros((len(states), len(_NAMES)), np.bool_)
    for i, several in enumerate(states):
        for name in several:
            if name != OFF:
                allowed[i, CODES[name]] = True
    return allowed


@lru_cache(maxsize=1024)
def _kept(flow: Key | None, count: int) -> tuple[bool, NDArray[np.int64]]:
    """Return whether a flow led here, and in which state it kept every contact."""
    if flow is None:
        return False, np.full(count, FREE)
    return True, np.array([FREE if s in OPEN else CODES[s] for s in flow], np.int64)
