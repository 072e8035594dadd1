"""Kinks: where a formula has no derivative, or jumps, and steps and laws need that it does not."""

from __future__ import annotations

from collections.abc import Collection

from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse
from statechart.formulas.syntax import Call, names_in, nodes

_KINKED = ("abs", "sign", "min", "max")

PIECES = (
    "a step does not stop there, and a sign may switch for ever: declare a region with a state for "
    "each smooth piece, and a transition whose guard is where it switches"
)
"""What to write instead of a kink in time or in the state."""


def check_smooth(
    text: str | int | float,
    variables: Collection[str],
    *,
    loc: tuple[str | int, ...],
    lacks: str,
    advice: str,
) -> None:
    """Check that a formula has no kink in any of `variables`.

    Parameters
    ----------
    text : str, int or float
        The formula.
    variables : collection of str
        Names whose change would pass a kink.
    loc : tuple
        Where it stands.
    lacks, advice : str
        What the formula has not where it switches, and what to write instead.

    Raises
    ------
    DeclarationProblem
        At the first kink.
    """
    for call in (node for node in nodes(parse(text).root) if isinstance(node, Call)):
        switched = {name.name for name in names_in(call)}.intersection(variables)
        if call.function in _KINKED and switched:
            raise DeclarationProblem(
                f"{call.function} of {', '.join(sorted(switched))} has no {lacks} where it "
                "switches",
                advice=advice,
                loc=loc,
            )
