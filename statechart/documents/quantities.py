"""Dimensional analysis: units of the names of a model, declared or inferred from formulas.

Inference is by unification, as of types: a formula has the unit of its field, the terms of a sum
have one dimension, sines take angles. Dimensions serve tables and axes; no model is refused for
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from itertools import islice
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel

from statechart.errors import FormulaError
from statechart.formulas.formula import parse
from statechart.formulas.tree import (
    Binary,
    Call,
    Constant,
    Name,
    Node,
    Number,
    Unary,
    children,
    is_constant,
    nodes,
)

Dimension = Literal[
    "", "1", "length", "time", "mass", "angle", "length/time", "angle/time", "force", "impulse",
    "energy", "moment",
]  # fmt: skip
"""Dimension of a quantity; empty if unknown."""

BASES = ("length", "time", "mass", "force")
"""Dimensions with units in a model; the unit of force follows from the others."""

SYSTEMS: Mapping[str, Mapping[str, str]] = {
    "SI": {"length": "m", "time": "s", "mass": "kg"},
    "dimensionless": dict.fromkeys(BASES, "1"),
}
"""Systems of units; dimensionless models have unit 1."""


class Powers(NamedTuple):
    """A dimension: exponents of length, time and mass."""

    length: Fraction = Fraction(0)
    time: Fraction = Fraction(0)
    mass: Fraction = Fraction(0)
    angle: bool = False  # an angle, or angle per time

    def times(self, other: Powers, exponent: Fraction | int = 1) -> Powers:
        """Return the dimension of the product with a power of another quantity."""
        length = self.length + exponent * other.length
        time = self.time + exponent * other.time
        mass = self.mass + exponent * other.mass
        # Arc length = angle times radius: the angle is dropped.
        return Powers(length, time, mass, (self.angle != other.angle) and not (length or mass))


class Quantity(NamedTuple):
    """The quantity of a name of a model."""

    words: str  # such as `x of rod`
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
    "moment": _FORCE.times(_LENGTH),
}
"""Name of a dimension -> its powers."""


def per_time(dimension: Dimension) -> Dimension:
    """Return the dimension of the rate of a quantity."""
    rates: Mapping[Dimension, Dimension] = {"length": "length/time", "angle": "angle/time"}
    return rates.get(dimension, "")


def dimension_name(powers: Powers | None) -> Dimension:
    """Return the name of a dimension, or an empty text."""
    found: Iterable[Dimension] = ("1", "angle", "length", "time", "mass", "length/time",
                                  "angle/time", "force", "impulse")  # fmt: skip
    return next((name for name in found if POWERS[name] == powers), "")


def unit_of(dimension: Dimension, units: Mapping[str, str]) -> str:
    """Return the unit of a dimension."""
    if dimension == "energy" and (_force(units), units.get("length")) == ("N", "m"):
        return "J"
    return unit_text(POWERS.get(dimension), units)


def unit_text(powers: Powers | None, units: Mapping[str, str]) -> str:
    """Return the unit of a dimension."""
    if all(units.get(base) == "1" for base in ("length", "time", "mass")):
        return "rad" if powers == POWERS["angle"] else "1"
    if powers is None:
        return ""
    length, time, mass, angle = powers
    texts = {base: units.get(base, "") for base in BASES} | {"force": _force(units)}
    plain = {"mass": mass, "length": length, "time": time}
    forces = {"force": mass, "length": length - mass, "time": time + 2 * mass}
    ways = [w for w in (plain, forces) if all(texts[base] for base, power in w.items() if power)]
    if not ways:
        return ""
    # The shorter one: N/m for a spring, kg m2 for a moment of inertia.
    way = min(ways, key=lambda way: sum(map(abs, way.values())))
    above = ["rad"] if angle else []
    above += [_unit_power(texts[base], n) for base, n in way.items() if n > 0]
    below = [_unit_power(texts[base], -n) for base, n in way.items() if n < 0]
    return "/".join([" ".join(above) or "1", *below])


def unit_suffix(unit: str) -> str:
    """Return a unit as written after a number; empty for a ratio."""
    return "" if unit == "1" else unit


def axis_label(what: str, unit: str) -> str:
    """Return an axis label such as `height in m`."""
    return f"{what} in {unit_suffix(unit)}" if unit_suffix(unit) else what


def _unit_power(unit: str, exponent: Fraction) -> str:
    if exponent == 1:
        return unit
    if exponent.denominator == 1:
        return unit + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(digit)] for digit in str(exponent))
    return f"{unit}^({exponent})"


def _force(units: Mapping[str, str]) -> str:
    """Return the named unit of force, or an empty text."""
    known = tuple(units.get(base, "") for base in ("mass", "length", "time"))
    return units.get("force", "N" if known == ("kg", "m", "s") else "")


Dimensions = dict[str, Powers]
Fact = tuple[Node, Node | Powers]
"""A formula with its dimension, or with a formula of the same dimension."""

_DIMENSION_PRESERVING = frozenset({"abs", "min", "max", "hypot", "mod"})
_OF_ANGLES = frozenset({"sin", "cos", "tan"})
_ANGLES = frozenset({"asin", "acos", "atan", "atan2"})
_MAX_PASSES = 20  # each pass infers at least one name
_COUNTS = range(1, 13)
_MAX_OPERATIONS = 200  # longer formulas are skipped


def infer_dimensions(facts: Iterable[Fact], known: Mapping[str, Powers]) -> Dimensions:
    """Infer the dimensions of names."""
    found, short = _Inference(known), [fact for fact in facts if _short(fact)]
    for _ in range(_MAX_PASSES):
        before = dict(found)
        for left, right in short:
            _unify(left, right, found)
        if found == before:
            break
    return found


def _short(fact: Fact) -> bool:
    """Return whether the formulas of a fact have at most _MAX_OPERATIONS."""
    trees = [part for part in fact if not isinstance(part, Powers)]
    return all(
        sum(1 for _ in islice(nodes(tree), _MAX_OPERATIONS)) < _MAX_OPERATIONS for tree in trees
    )


def dimension_of(node: Node, known: Mapping[str, Powers]) -> Powers | None:
    """Return the dimension of a formula, or None.

    A small integer is dimensionless; another number may be a conversion factor.
    """
    match node:
        case Name():
            return known.get(node.name)
        case Number():
            return Powers() if node.value in _COUNTS else None
        case Constant():
            return Powers() if node.name == "pi" else None
        case Unary():
            return dimension_of(node.operand, known)
        case Binary(operator="*" | "/", left=left, right=right):
            first, second = dimension_of(left, known), dimension_of(right, known)
            if first is None or second is None:
                return None
            if node.operator == "/" and _is_turn(right):
                first = first._replace(angle=False)
            return first.times(second, 1 if node.operator == "*" else -1)
        case Binary(operator="**", left=left, right=Number(value=value)):
            base = dimension_of(left, known)
            return None if base is None else Powers().times(base, Fraction(value))
        case Binary(operator="+" | "-", left=left, right=right):
            return _common((left, right), known)
        case Call(function="sqrt", arguments=(of,)):
            base = dimension_of(of, known)
            return None if base is None else Powers().times(base, Fraction(1, 2))
        case Call(function=function, arguments=arguments):
            if function in _DIMENSION_PRESERVING:
                return _common(arguments, known)
            return POWERS["angle"] if function in _ANGLES else Powers()
    return None


def _is_turn(node: Node) -> bool:
    """Return whether a formula has the factor pi: angle/(2*pi) is a number of turns."""
    match node:
        case Constant():
            return node.name == "pi"
        case Binary(operator="*", left=left, right=right):
            return _is_turn(left) or _is_turn(right)
        case Binary(operator="/", left=left):
            return _is_turn(left)
    return False


def _common(parts: Iterable[Node], known: Mapping[str, Powers]) -> Powers | None:
    several = tuple(parts)
    speaking = [part for part in several if not is_constant(part)] or several
    return next((p for part in speaking if (p := dimension_of(part, known)) is not None), None)


class _Inference(Dimensions):
    """Inferred dimensions of names; those in `known` are certain."""

    def __init__(self, known: Mapping[str, Powers]) -> None:
        super().__init__(known)
        self._certain = frozenset(known)

    def note(self, name: str, powers: Powers) -> None:
        """Record the dimension of a name; an angle is more specific than a number."""
        before = self.setdefault(name, powers)
        if name not in self._certain and before[:3] == powers[:3] and powers.angle:
            self[name] = powers


def _unify(left: Node, right: Node | Powers, known: _Inference) -> None:
    """Unify the dimensions of two formulas."""
    for one, other in ((left, right), (right, left)):
        if isinstance(one, Powers):
            continue
        _unify_parts(one, known)
        powers = other if isinstance(other, Powers) else None
        if not isinstance(other, Powers) and not is_constant(other):
            powers = dimension_of(other, known)
        if powers is not None:
            _infer_names(one, powers, known)


def _unify_parts(node: Node, known: _Inference) -> None:
    """Unify the terms of sums, and the arguments of sines, in a formula."""
    for part in nodes(node):
        match part:
            case Call(function=function, arguments=(of,)) if function in _OF_ANGLES:
                _infer_names(of, POWERS["angle"], known)
            case Binary(operator="+" | "-"):
                whole = dimension_of(part, known)
                if whole is not None:
                    _infer_names(part, whole, known)


def _infer_names(node: Node, powers: Powers, known: _Inference) -> None:
    """Infer the dimensions of names in a formula from that of the whole."""
    match node:
        case Name():
            if all(exponent.denominator == 1 for exponent in powers[:3]):
                known.note(node.name, powers)
        case Unary() | Binary(operator="+" | "-"):
            for part in children(node):
                _infer_names(part, powers, known)
        case Binary(operator="*" | "/", left=left, right=right):
            first, second = dimension_of(left, known), dimension_of(right, known)
            sign = 1 if node.operator == "*" else -1
            if sign == 1 and (_is_turn(left) or _is_turn(right)):
                # A number of turns.
                powers = powers._replace(angle=False)
            if first is None and second is not None:
                _infer_names(left, powers.times(second, -sign), known)
            elif first is not None and second is None:
                rest = powers.times(first, -1)
                # The divisor of an angle is a number.
                below = Powers().times(rest, -1)._replace(angle=False)
                _infer_names(right, rest if sign == 1 else below, known)
        case Binary(operator="**", left=left, right=Number(value=value)) if value:
            _infer_names(left, Powers().times(powers, 1 / Fraction(value)), known)
        case Call(function=function, arguments=arguments):
            if function in _DIMENSION_PRESERVING:
                for part in arguments:
                    _infer_names(part, powers, known)
            elif function == "sqrt":
                _infer_names(arguments[0], Powers().times(powers, 2), known)


def fields_of(part: BaseModel) -> Iterator[Fact]:
    """Yield the formulas of a part with the dimensions of their fields.

    Formulas that belong to names have the dimension of the name, or that per time.
    """
    for name, info in type(part).model_fields.items():
        extra = info.json_schema_extra
        words = extra.get("unit") if isinstance(extra, dict) else None
        value = getattr(part, name)
        if isinstance(value, Mapping) and isinstance(words, str) and words.startswith("that of"):
            for key, text in value.items():
                if isinstance(text, str | int | float):
                    yield parse(text).root, rate_of(key) if "per time" in words else Name(key)
                yield from _facts_in(text, None)
        else:
            yield from _facts_in(value, _powers(words))


def rate_of(name: str) -> Node:
    """Return a formula with the dimension of the rate of a name."""
    return Binary("/", Name(name), Name("time"))


def _facts_in(value: Any, powers: Powers | None) -> Iterator[Fact]:
    match value:
        case BaseModel():
            yield from fields_of(value)
        case Mapping():
            for item in value.values():
                yield from _facts_in(item, powers)
        case list() | tuple():
            for item in value:
                yield from _facts_in(item, powers)
        case str() if powers is not None:
            yield parse(value).root, powers


def _powers(words: object) -> Powers | None:
    """Parse the unit of a field, such as mass length**2."""
    if not isinstance(words, str):
        return None
    try:
        return dimension_of(parse(words.replace(" ", "*")).root, POWERS)
    except FormulaError:
        return None
