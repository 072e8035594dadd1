"""Events of a run: what a jump is, for the outputs and transitions that wait for it."""

from __future__ import annotations

from collections.abc import Sequence

from statechart.automaton.regions import Region
from statechart.automaton.trace import Jump
from statechart.documents.outputs import Event


def happened(regions: Sequence[Region], jump: Jump, event: Event) -> bool:
    """Tell whether `jump` is `event`, by a cause or by the state entered.

    A jump names one region, but may change others at the same instant (an impact that is felt at
    every closed contact); their causes are those of the edges that they take. A region whose blows
    have a name of their own has that of its change besides: it is struck, and lifts off.
    """
    if event.region is None and jump.cause == event.cause:
        return True
    named = event.region
    for region, before, after in zip(regions, jump.source, jump.target, strict=True):
        if named is not None and region.name != named:
            continue
        if event.cause in _causes(region, jump, before, after):
            return True
        if named is not None and _entered(region, before, after, event.cause):
            return True
    return False


def _causes(region: Region, jump: Jump, before: str, after: str) -> tuple[str, ...]:
    if region.name == jump.region and jump.cause != region.blow:
        return region.causes(jump.cause)
    felt = region.name in jump.impulse
    if before == after and not felt:
        return ()
    causes = [e.cause for e in region.edges if (e.source, e.target) == (before, after)]
    hit = (region.blow,) if felt and region.blow in causes else ()
    others = [cause for cause in causes if cause != region.blow]
    return (*hit, jump.cause) if jump.cause in others else (*hit, *others[:1])


def _entered(region: Region, before: str, after: str, state: str) -> bool:
    return state in region.active(after) and state not in region.active(before)
