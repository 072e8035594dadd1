"""Hypothesis strategies over the ranges of a model."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import ValidationError

from statechart.documents.declaration import Declaration
from statechart.formulas.formula import parse

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy


def ranges(model: Declaration) -> dict[str, tuple[float, float]]:
    """Return what a check varies: parameter -> least and greatest value.

    Those that the model declares; if it declares none, from half to twice the value of every
    parameter that is a number other than 0 and inf, less far where the model would be wrong
    there (a restitution of 0.9 cannot be 1.8).

    Parameters
    ----------
    model : Declaration
        A chart, a scene.
    """
    if model.ranges:
        return dict(model.ranges)
    values = model.values()
    found = {}
    for name, text in model.parameters.items():
        value = values[name]
        if parse(text).names or value == 0.0 or math.isinf(value):
            continue
        ends = [_valid_towards(model, name, value, factor * value) for factor in (0.5, 2.0)]
        found[name] = (min(ends), max(ends))
    return found


def _valid_towards(model: Declaration, name: str, value: float, end: float) -> float:
    for halvings in range(8):
        candidate = value + (end - value) * 0.5**halvings
        try:
            changed = {**model.parameters, name: candidate}
            type(model).model_validate(
                {**model.model_dump(by_alias=True), "parameters": changed}, by_alias=True
            )
        except ValidationError:
            continue
        return candidate
    return value


def parameters(model: Declaration) -> SearchStrategy[dict[str, float]]:
    """Return the strategy over the `ranges` of a model.

    Shrinking leads to the declared values: what differs from them in a failing example matters.
    Ends of ranges are drawn often: what grows with a parameter is largest there.

    Parameters
    ----------
    model : Declaration
        A chart, a scene.

    Returns
    -------
    SearchStrategy
        Of parameter -> value, as runs take them.
    """
    from hypothesis import strategies as st

    values = model.values()
    choices: dict[str, SearchStrategy[float]] = {}
    for name, (least, greatest) in ranges(model).items():
        declared = values[name]
        if name in model.whole:
            choices[name] = st.integers(math.ceil(least), math.floor(greatest)).map(float)
            continue
        # Numbers below 2e-308 in size have few digits, and measure nothing.
        within = st.floats(least, greatest, allow_subnormal=False)
        drawn = [within, st.sampled_from((least, greatest))]
        if least <= declared <= greatest:
            drawn.insert(0, st.just(declared))
        choices[name] = st.one_of(drawn)
    return st.fixed_dictionaries(choices)
