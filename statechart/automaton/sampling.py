"""Instants at which a run is looked at from outside, and what may be changed then."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from statechart.automaton.trace import Arc, Jump


@dataclass(frozen=True)
class Sample:
    """What a controller is shown at an instant.

    Attributes
    ----------
    t : float
        When.
    mode : mapping of str to str
        Region -> its state.
    values : mapping of str to float
        Variable -> its value.
    """

    t: float
    mode: Mapping[str, str]
    values: Mapping[str, float]


Control = Callable[[Sample], Mapping[str, float] | None]
"""Sample -> parameters that have other values from there on; None for no change."""


class Sampling(NamedTuple):
    """When a run is looked at, and what may change then."""

    every: float  # Time between instants; inf for none.
    control: Control | None


def in_order(pieces: Iterable[Arc | Jump]) -> list[Arc | Jump]:
    """Return arcs and jumps on hybrid time: arcs of as many jumps, and the jump that ends them."""

    def place(piece: Arc | Jump) -> tuple[int, int, float]:
        if isinstance(piece, Arc):
            return piece.j, 0, piece.start.high
        return piece.j, 1, piece.t

    return sorted(pieces, key=place)
