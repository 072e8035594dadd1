"""Coulomb's friction with a static and a kinetic coefficient, the latter maybe Stribeck's curve."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import Discriminator, Tag

from statechart.documents.documented import declare
from statechart.documents.fields import KINKED, FiniteText, FormulaText, Part
from statechart.errors import DeclarationProblem, Loc
from statechart.formulas.formula import parse
from statechart.formulas.tree import Binary, Name, Node, Unary, calls_in, names_in

SLIP = "slip"
"""Name of the slip velocity of the contact in its own kinetic coefficient."""
AT_REST = 1e-300
"""Slip velocity (in the unit of the scene) that stands for the limit at zero from one side."""


class Friction(Part):
    """Coefficients of friction at rest and in motion."""

    OTHER_WORDS: ClassVar = {
        "mu coefficient": "friction: 0.5, or friction: {static: s, kinetic: k}",
        "mu_s static_friction": "static",
        "mu_k dynamic sliding dynamic_friction": "kinetic",
        "coulomb": "a number instead of the mapping, or static and kinetic",
        "viscous stribeck": (
            "{static: 0.5, kinetic: 0.3 + 0.2*exp(-abs(slip)/0.1)}, of points on surfaces"
        ),
    }

    static: FormulaText = declare(
        "Coefficient at rest: a pin holds up to static times V.", "mu_s", unit="1"
    )
    kinetic: FormulaText = declare(
        "Coefficient in motion, at most static at rest; a formula of the contact's slip too, such "
        "as 0.2 + 0.2*exp(-abs(slip)/0.1), smooth on each side of 0.",
        "mu_k",
        unit="1",
    )


class StaticKinetic(Friction):
    """A bound of friction at rest, and in motion."""

    OTHER_WORDS: ClassVar = {}

    static: FiniteText = declare(
        "Bound at rest: what it takes to start a slip.",
        "1.1*M_max",
        unit="force length; force along a guide",
    )
    kinetic: FiniteText = declare(
        "Bound in motion.", "M_max", unit="force length; force along a guide"
    )


def _friction_tag(value: Any) -> str:
    return "law" if isinstance(value, dict | list | Friction) else "coefficient"


DeclaredFriction = Annotated[
    Annotated[FormulaText, Tag("coefficient")] | Annotated[Friction, Tag("law")],
    Discriminator(_friction_tag),
]
"""One coefficient, or `Friction`."""

DeclaredLimit = Annotated[
    Annotated[FormulaText, Tag("coefficient")] | Annotated[StaticKinetic, Tag("law")],
    Discriminator(_friction_tag),
]
"""One limit of a coupling, or `StaticKinetic`."""


class FrictionLaw(NamedTuple):
    """Coefficients of a contact as formulas."""

    static: FormulaText
    kinetic: FormulaText
    slips: frozenset[str]  # Names that stand for the slip in them

    @property
    def varies(self) -> bool:
        """True if the kinetic coefficient depends on the slip."""
        return bool(parse(self.kinetic).names & self.slips)

    @property
    def splits(self) -> bool:
        """True if the coefficients at rest and in motion may differ."""
        return self.static != self.kinetic or self.varies

    @property
    def both(self) -> FormulaText:
        """A formula with the names of both; the coefficient itself where it is one."""
        return f"({self.static}) + ({self.kinetic})" if self.splits else self.static


def friction_law(
    friction: FormulaText | Friction | None, contact: str, *known: Collection[str]
) -> FrictionLaw | None:
    """Return the law of a contact; a coefficient that uses its slip is static at slip 0.

    Names that are `known` otherwise, as a parameter named slip, keep their meaning.
    """
    if friction is None:
        return None
    slips = (SLIP, f"{contact}.{SLIP}")
    own = frozenset(name for name in slips if not any(name in names for names in known))
    return FrictionLaw(*coefficients(friction), own)


def coefficients(friction: FormulaText | Friction) -> tuple[FormulaText, FormulaText]:
    """Return the static and the kinetic coefficient, or bound."""
    if isinstance(friction, Friction):
        return friction.static, friction.kinetic
    return friction, friction


def check_sides(text: FormulaText, slips: Collection[str], loc: Loc) -> None:
    """Check that a kinetic coefficient has no kink but at slip 0, where the direction changes."""
    for call in calls_in(parse(text).root, KINKED):
        used = {name.name for name in names_in(call)}.intersection(slips)
        side = call.function in ("abs", "sign") and _is_multiple(call.arguments[0], slips)
        if used and not side:
            raise DeclarationProblem(
                f"{call.function} of {min(used)} has no derivative where it switches",
                advice="write a smooth formula of abs(slip) and sign(slip)",
                loc=loc,
            )


def _is_multiple(node: Node, slips: Collection[str]) -> bool:
    """Return whether a formula is the slip times something else."""
    match node:
        case Name(name=name):
            return name in slips
        case Unary(operand=operand):
            return _is_multiple(operand, slips)
        case Binary(operator="*" | "/" as operator, left=left, right=right):
            if any(name.name in slips for name in names_in(right)):
                swapped = operator == "*" and not any(n.name in slips for n in names_in(left))
                return swapped and _is_multiple(right, slips)
            return _is_multiple(left, slips)
    return False
