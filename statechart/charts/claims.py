"""The relations that states of a region claim to hold, or not to hold."""

from __future__ import annotations

from statechart.automaton.regions import Claim
from statechart.charts.firing import guards
from statechart.charts.flat_region import FlatRegion


def guard_claims(name: str, declared: FlatRegion, state: str) -> tuple[Claim, ...]:
    """Return that no guard out of `state` holds while it is active."""
    return tuple(
        Claim(guard.name, (guard.relation.text,), holds=False)
        for guard in guards(0, name, declared.transitions, state)
    )
