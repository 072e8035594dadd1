"""Which product modes are possible at a configuration, as the kind of a model judges them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from statechart.automaton.trace import Key

MOST_MODES = 4096
"""Products of more modes than this, six contacts' for one, are never enumerated."""


@dataclass(frozen=True)
class Feasibility:
    """Which product modes are possible at a configuration."""

    modes: Mapping[Key, str]  # Every product mode -> why it is not possible; "" where it is.
    # The same as the declaration counts modes (sliding without direction).
    declared: Mapping[Key, str]
    remarks: tuple[str, ...] = ()  # What a reader must know of the configuration.
