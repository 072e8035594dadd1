"""What names of a model measure, and in which units: as far as its declaration tells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

Dimension = Literal[
    "", "1", "length", "time", "mass", "angle", "length/time", "angle/time", "force", "impulse",
    "energy",
]  # fmt: skip
"""What a quantity is measured in; empty where nothing tells."""

BASES = ("length", "time", "mass", "force")
"""What a model may give units to besides its own names; that of forces follows from the others."""


class Quantity(NamedTuple):
    """What a name of a model measures.

    Attributes
    ----------
    words : str
        What it is, such as `x of rod`.
    dimension : Dimension
    """

    words: str
    dimension: Dimension = ""


def per_time(dimension: Dimension) -> Dimension:
    """Return what the rate of a quantity is measured in."""
    rates: Mapping[Dimension, Dimension] = {"length": "length/time", "angle": "angle/time"}
    return rates.get(dimension, "")


def unit_of(dimension: Dimension, units: Mapping[str, str]) -> str:
    """Return the unit of a dimension.

    Parameters
    ----------
    dimension : Dimension
    units : mapping of str to str
        Those of `BASES` that are declared.

    Returns
    -------
    str
        Empty where it does not follow.
    """
    length, time = units.get("length", ""), units.get("time", "")
    force = _force(units)
    match dimension:
        case "length" | "time" | "mass":
            return units.get(dimension, "")
        case "1":
            return "1"
        case "angle":
            return "rad"
        case "length/time":
            return f"{length}/{time}" if length and time else ""
        case "angle/time":
            return f"rad/{time}" if time else ""
        case "force":
            return force
        case "impulse":
            return f"{force} {time}" if force and time else ""
        case "energy":
            return "J" if (force, length) == ("N", "m") else f"{force} {length}" if force else ""
    return ""


def _force(units: Mapping[str, str]) -> str:
    length, time, mass = (units.get(base, "") for base in ("length", "time", "mass"))
    if "force" in units:
        return units["force"]
    if (mass, length, time) == ("kg", "m", "s"):
        return "N"
    return f"{mass} {length}/{time}\u00b2" if mass and length and time else ""
