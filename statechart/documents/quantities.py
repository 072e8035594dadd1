"""Dimensions and units of the names of a model, as far as they are declared."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Literal, NamedTuple

Dimension = Literal[
    "", "1", "length", "time", "mass", "angle", "length/time", "angle/time", "force", "impulse",
    "energy",
]  # fmt: skip
"""Dimension of a quantity; empty where it is unknown."""

BASES = ("length", "time", "mass", "force")
"""Dimensions that a model may give units; the unit of force follows from the others."""

SYSTEMS: Mapping[str, Mapping[str, str]] = {
    "SI": {"length": "m", "time": "s", "mass": "kg"},
    "dimensionless": dict.fromkeys(BASES, "1"),
}
"""Words that stand for units of all bases; of what is dimensionless every unit is 1."""


class Powers(NamedTuple):
    """A dimension as powers of length, time and mass."""

    length: Fraction = Fraction(0)  # their exponents
    time: Fraction = Fraction(0)
    mass: Fraction = Fraction(0)
    angle: bool = False  # whether it is an angle, or one per time

    def times(self, other: Powers, exponent: Fraction | int = 1) -> Powers:
        """Return what the product with a power of another quantity is measured in."""
        length = self.length + exponent * other.length
        time = self.time + exponent * other.time
        mass = self.mass + exponent * other.mass
        # An arc is an angle times a length: of rad nothing is left.
        return Powers(length, time, mass, (self.angle != other.angle) and not (length or mass))


class Quantity(NamedTuple):
    """The quantity that a name of a model measures."""

    words: str  # what it is, such as `x of rod`
    dimension: Dimension = ""


_LENGTH, _TIME, _MASS = Powers(Fraction(1)), Powers(time=Fraction(1)), Powers(mass=Fraction(1))
_FORCE = _MASS.times(_LENGTH).times(_TIME, -2)
POWERS: Mapping[str, Powers] = {
    "1": Powers(),
    "rad": Powers(angle=True),
    "angle": Powers(angle=True),
    "length": _LENGTH,
    "time": _TIME,
    "mass": _MASS,
    "length/time": _LENGTH.times(_TIME, -1),
    "angle/time": Powers(angle=True).times(_TIME, -1),
    "force": _FORCE,
    "impulse": _FORCE.times(_TIME),
    "energy": _FORCE.times(_LENGTH),
}
"""Name of a dimension -> its powers."""


def per_time(dimension: Dimension) -> Dimension:
    """Return what the rate of a quantity is measured in."""
    rates: Mapping[Dimension, Dimension] = {"length": "length/time", "angle": "angle/time"}
    return rates.get(dimension, "")


def named(powers: Powers | None) -> Dimension:
    """Return the name of a dimension that is told by its powers; empty where it has none."""
    found: Iterable[Dimension] = ("1", "angle", "length", "time", "mass", "length/time",
                                  "angle/time", "force", "impulse")  # fmt: skip
    return next((name for name in found if POWERS[name] == powers), "")


def unit_of(dimension: Dimension, units: Mapping[str, str]) -> str:
    """Return the unit of a dimension."""
    if dimension == "energy" and (_force(units), units.get("length")) == ("N", "m"):
        return "J"
    return written(POWERS.get(dimension), units)


def written(powers: Powers | None, units: Mapping[str, str]) -> str:
    """Return the unit of what is measured in powers of length, time and mass."""
    if all(units.get(base) == "1" for base in ("length", "time", "mass")):
        return "rad" if powers == POWERS["angle"] else "1"
    if powers is None:
        return ""
    length, time, mass, angle = powers
    texts = {base: units.get(base, "") for base in BASES} | {"force": _force(units)}
    plain = {"mass": mass, "length": length, "time": time}
    forces = {"force": mass, "length": length - mass, "time": time + 2 * mass}
    ways = [
        way
        for way in (plain, forces)
        if all(texts[base] for base, exponent in way.items() if exponent)
    ]
    if not ways:
        return ""
    # The shorter one: a spring has N/m, a moment of inertia kg m2.
    way = min(ways, key=lambda way: sum(map(abs, way.values())))
    above = ["rad"] if angle else []
    above += [_power(texts[base], n) for base, n in way.items() if n > 0]
    below = [_power(texts[base], -n) for base, n in way.items() if n < 0]
    return "/".join([" ".join(above) or "1", *below])


def beside(unit: str) -> str:
    """Return a unit as it stands beside a number: a ratio has none."""
    return "" if unit == "1" else unit


def entitled(what: str, unit: str) -> str:
    """Return what stands at an axis, such as height in m."""
    return f"{what} in {beside(unit)}" if beside(unit) else what


def _power(unit: str, exponent: Fraction) -> str:
    if exponent == 1:
        return unit
    if exponent.denominator == 1:
        return unit + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(digit)] for digit in str(exponent))
    return f"{unit}^({exponent})"


def _force(units: Mapping[str, str]) -> str:
    """Return the unit of forces where it has a name of its own."""
    known = tuple(units.get(base, "") for base in ("mass", "length", "time"))
    return units.get("force", "N" if known == ("kg", "m", "s") else "")
