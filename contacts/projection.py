"""Positions and velocities brought back onto the constraints of the closed contacts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from contacts.mechanics import Mechanics
from contacts.snapshot import Snapshot, SnapshotTape, solve_kkt
from statechart.automaton import Projector
from statechart.tape import compile_tape
from statechart.trace import Key

__all__ = ["Projection", "landed", "on_constraints"]

Array = NDArray[np.float64]

# Constraints are projected once they are off by this part of their tolerance.
_DRIFT = 0.05


class Projection:
    """Keeps the constraints of a flow: solved as accelerations only, they drift as N^2.

    No Baumgarte stabilisation: it would enter the forces that the guards read.

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    parameters : sequence of Symbol
        In the order of the values.
    snapshots : SnapshotTape
        Asked only where something has to be projected.
    """

    def __init__(
        self, mechanics: Mechanics, parameters: Sequence[sp.Symbol], snapshots: SnapshotTape
    ) -> None:
        outputs: list[sp.Expr] = []
        for name in mechanics.scene.contacts:
            geometry = mechanics.contact(name)
            outputs += [geometry.symbols.gap, geometry.symbols.gap_rate, geometry.symbols.slip]
            outputs += geometry.point
        self._snapshots = snapshots
        self._tape = compile_tape(
            outputs,
            variables=(*mechanics.q, *mechanics.v),
            parameters=parameters,
            time=mechanics.time,
        )

    def projector(
        self,
        flow: Key,
        start: float,
        anchor: Array,
        values: Array,
        tolerances: Mapping[str, float],
    ) -> Projector | None:
        """Return what keeps the constraints of `flow` (see `statechart.automaton.Laws`).

        It leaves a state alone that is off by no more than a part of the tolerances.

        Parameters
        ----------
        flow : Key
            State of every contact.
        start : float
            When the flow begins.
        anchor : (2 n,) array
            Where it begins: pinned points stay where they were there, in the surface's frame.
        values : (p,) array
            Of the parameters.
        tolerances : mapping
            Of `gap` and `speed`.
        """
        closed = [(i, name == "pin") for i, name in enumerate(flow) if name != "free"]
        if not closed:
            return None
        then = self._tape.at(anchor, values, start).tolist() if "pin" in flow else []
        near, slow = tolerances["gap"], tolerances["speed"]

        def project(state: Array, local: float) -> tuple[Array, float]:
            now = self._tape.at(state, values, start + local).tolist()
            off = 0.0
            for i, pinned in closed:
                gap, gap_rate, slip, x, y = now[5 * i : 5 * i + 5]
                off = max(off, abs(gap) / near, abs(gap_rate) / slow)
                if pinned:
                    moved = math.hypot(x - then[5 * i + 3], y - then[5 * i + 4])
                    off = max(off, moved / near, abs(slip) / slow)
            # What is not finite is left to the guards to report.
            if off <= _DRIFT or not math.isfinite(off):
                return state, 0.0
            snapshot = self._snapshots.at(values, state, start + local)
            held = self._snapshots.at(values, anchor, start)
            return on_constraints(flow, snapshot, state, held=held), off

        return project


def landed(key: Key, snapshot: Snapshot, state: Array, tolerances: Mapping[str, float]) -> Array:
    """Return `state` on the constraints of the mode entered; the same object if it is.

    Parameters
    ----------
    key : Key
        Mode entered.
    snapshot : Snapshot
        Numbers at `state`.
    state : (2 n,) array
        To be projected.
    tolerances : mapping
        Of `gap` and `speed`.
    """
    near, slow = _DRIFT * tolerances["gap"], _DRIFT * tolerances["speed"]
    for contact, name in zip(snapshot.contacts, key, strict=True):
        off = abs(contact.gap) > near or abs(contact.gap_rate) > slow
        if name != "free" and (off or (name == "pin" and abs(contact.slip) > slow)):
            return on_constraints(key, snapshot, state)
    return state


def on_constraints(
    key: Key,
    snapshot: Snapshot,
    state: Array,
    *,
    held: Snapshot | None = None,
    inside: Sequence[bool] = (),
) -> Array:
    """Bring position and velocity onto the constraints, nearest in the mass metric.

    Parameters
    ----------
    key : Key
        Whose constraints.
    snapshot : Snapshot
        Numbers at `state`.
    state : (2 n,) array
        To be projected.
    held : Snapshot, optional
        Where pinned points were when they were pinned.
    inside : sequence of bool
        Free contacts whose gap is to be closed too (a start just inside a surface).
    """
    n = len(snapshot.velocity)
    rows: list[Array] = []
    off: list[float] = []
    rates: list[float] = []
    for i, (contact, name) in enumerate(zip(snapshot.contacts, key, strict=True)):
        if name == "free" and not (inside and inside[i]):
            continue
        rows.append(contact.jacobian[0])
        off.append(-contact.gap)
        rates.append(-contact.gap_rate if name != "free" else 0.0)
        if name == "pin":
            moved = 0.0
            if held is not None:
                before = held.contacts[i]
                moved = contact.tx * (contact.x - before.x) + contact.ty * (contact.y - before.y)
            rows.append(contact.jacobian[1])
            off.append(-moved)
            rates.append(-contact.slip)
    if not rows:
        return state
    jacobian = np.array(rows)
    count = len(rows)
    block = np.hstack([jacobian, np.zeros((count, count))])
    zero = np.zeros(n)
    shift = solve_kkt(snapshot.mass, zero, block, jacobian.T, np.array(off))
    change = solve_kkt(snapshot.mass, zero, block, jacobian.T, np.array(rates))
    if shift is None or change is None:
        return state
    return state + np.concatenate([shift[0], change[0]])
