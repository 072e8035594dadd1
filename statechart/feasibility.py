"""Which product modes are possible at a configuration, as the kind of a model judges them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from statechart.arrays import Array
from statechart.automaton import Automaton, Setup
from statechart.trace import Key

MOST_MODES = 4096
"""Products of more modes than this, six contacts' for one, are never enumerated."""


@dataclass(frozen=True)
class Feasibility:
    """Which product modes are possible at a configuration.

    Attributes
    ----------
    modes : mapping
        Every product mode -> why it is not possible; "" where it is.
    declared : mapping
        The same as the declaration counts modes (sliding without direction).
    remarks : tuple of str
        What a reader must know of the configuration.
    """

    modes: Mapping[Key, str]
    declared: Mapping[Key, str]
    remarks: tuple[str, ...] = ()


def feasibility(
    automaton: Automaton, setup: Setup, state: Array, time: float
) -> Feasibility | None:
    """Judge every product mode at a configuration.

    Parameters
    ----------
    automaton : Automaton
        Whose modes.
    setup : Setup
        Values of the parameters.
    state : (n,) array
        Values of the variables.
    time : float
        When.

    Returns
    -------
    Feasibility or None
        None where the laws know no reason against any mode (a chart, bodies that collide), or
        there are more modes than `MOST_MODES`.

    Raises
    ------
    StatechartError
        If the modes cannot be judged there.
    """
    if automaton.laws is None or automaton.modes_total > MOST_MODES:
        return None
    return automaton.laws.feasibility(automaton.regions, setup, state, time)
