"""Types of the fields that documents share: names, formulas, relations, numbers."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from statechart.documents.documented import Documented, own_words
from statechart.errors import DeclarationError, DeclarationProblem, FormulaError
from statechart.formulas.formula import Formula, parse
from statechart.formulas.hints import no_name
from statechart.formulas.relation import Relation, conjunction, parse_relation
from statechart.formulas.syntax import NAME
from statechart.formulas.tree import (
    JUMPS,
    RESERVED,
    WORDS,
    Binary,
    Call,
    Name,
    Node,
    Unary,
    children,
    names_in,
    nodes,
)


def problem(error: FormulaError, *loc: str | int) -> DeclarationProblem:
    """Return the error of a formula as what validators raise."""
    return DeclarationProblem(
        error.message, advice=error.advice, loc=loc, offset=error.offset, text=error.text
    )


def _constant(value: Any) -> Any:
    if getattr(value, "ndim", None) == 0:  # of NumPy: a number as any other
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise PydanticCustomError("formula_type", "must be a number or a formula")
    try:
        parse(value)
    except FormulaError as error:
        raise problem(error) from None
    # Infinity has one spelling, so that a model equals what is read back from its own text.
    return str(value) if isinstance(value, float) and math.isinf(value) else value


def _formula(value: Any) -> Any:
    value = _constant(value)
    _check_jumps(parse(value))
    return value


TIME = "time"
"""The name of the time since the start in formulas."""


def _check_jumps(*formulas: Formula) -> None:
    """Check that what is computed along a run has no function that jumps but with the time.

    Documents count whole periods of that (`statechart.charts.wrapping`).
    """
    for formula in formulas:
        for node in nodes(formula.root):
            if isinstance(node, Call) and node.function in JUMPS:
                if any(name.name == TIME for name in names_in(node.arguments[0])):
                    continue
                raise DeclarationProblem(
                    f"formula {formula.text!r}: {node.function} jumps, and may stand only in "
                    "parameters, starts and copies",
                    advice="write a parameter if its arguments are constant; along a run, write "
                    "mod(time, T), or a state for each piece",
                    offset=node.offset,
                )


def check_named_infinity(
    text: str | int | float, *loc: str | int, advice: str = "only a friction may be inf"
) -> None:
    """Raise `DeclarationProblem` at `loc` where a formula names infinity."""
    formula = parse(text)
    if formula.names_infinity:
        raise DeclarationProblem(
            f"formula {formula.text!r}: must be finite",
            advice=advice,
            loc=loc,
        )


def _without_infinity(value: str | int | float) -> str | int | float:
    check_named_infinity(value)
    return value


def _relation(value: str) -> str:
    try:
        relation = parse_relation(value)
    except FormulaError as error:
        raise problem(error) from None
    _check_jumps(*relation.formulas)
    for one in relation.comparisons:
        # The derivatives of a margin decide which way it goes on its boundary.
        check_derived(Binary("-", one.left.root, one.right.root), relation.names)
    if any(formula.names_infinity for formula in relation.formulas):
        raise DeclarationProblem(
            f"formula {value!r}: nothing is compared with infinity", advice="write a finite number"
        )
    return value


def _all_of(value: Any) -> Any:
    """Join a list of relations to the one that holds where all of them do."""
    if not isinstance(value, list | tuple):
        return value
    if not value:
        raise DeclarationProblem("an empty list is no relation", advice="write it as x <= 0")
    for place, text in enumerate(value):
        if not isinstance(text, str):
            raise DeclarationProblem("is not a relation", advice="write x <= 0", loc=(place,))
        try:
            _relation(text)
        except DeclarationProblem as error:
            error.loc = (place, *error.loc)
            raise
    return conjunction(value)


def _name(value: str) -> str:
    if not NAME.fullmatch(value):
        raise DeclarationProblem(f"{value!r} is not a name", advice=no_name(value))
    if value in RESERVED:
        raise DeclarationProblem(
            f"{value!r} already has a meaning in formulas", advice="choose another name"
        )
    return value


def _value_name(value: str) -> str:
    if value in WORDS:
        raise DeclarationProblem(f"{value!r} is a word of relations", advice="choose another name")
    return value


FormulaText = Annotated[str | int | float, BeforeValidator(_formula)]
"""A number or a formula that can be read; kept as written (infinity as the text `inf`)."""

ConstantText = Annotated[str | int | float, BeforeValidator(_constant)]
"""A formula that is computed once, before a run: it may have `floor` and `mod`, which jump."""

FiniteConstantText = Annotated[ConstantText, AfterValidator(_without_infinity)]
"""One that does not name infinity."""

FiniteText = Annotated[FormulaText, AfterValidator(_without_infinity)]
"""A formula that does not name infinity: it is computed with, not compared."""

OneRelation = Annotated[str, AfterValidator(_relation)]
"""A relation, kept as written."""

RelationText = Annotated[
    OneRelation, BeforeValidator(_all_of, json_schema_input_type=str | list[str])
]
"""A relation, or a list of them that is kept as one, joined by `and`."""

NameText = Annotated[str, AfterValidator(_name)]
"""A name that formulas can use."""

ValueName = Annotated[NameText, AfterValidator(_value_name)]
"""A name that stands alone for a value; it is no word that joins relations."""

Label = Annotated[str, Field(min_length=1, max_length=200)]
"""A few words for people."""

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""A finite number, not text that looks like one."""


class Part(BaseModel, metaclass=Documented):
    """Base of every model of a document: immutable, unknown keys refused."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", populate_by_name=True, json_schema_extra=own_words
    )

    OTHER_WORDS: ClassVar[Mapping[str, str]] = {}
    """Key of another program -> what is written for it here."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in type(self).model_fields:
            raise DeclarationError(
                f"{type(self).__name__}: {name} does not change once it is built",
                advice=f"build another one: model_copy(update={{{name!r}: ...}}), or of a model "
                "with_(...) for its parameters",
            )
        super().__setattr__(name, value)


def check_names(formula: Formula | Relation, known: Collection[str], *loc: str | int) -> None:
    """Check that a formula uses only known names.

    Raises `DeclarationProblem` at the first unknown name.
    """
    try:
        formula.require(known)
    except FormulaError as error:
        raise problem(error, *loc) from None


def check_relation(
    text: str,
    names: Collection[str],
    states: Mapping[str, Collection[str]],
    changing: Collection[str],
    *loc: str | int,
) -> None:
    """Check that a relation uses only what exists, and equalities only of what no flow changes.

    Raises `DeclarationProblem` at the first fault.
    """
    relation = parse_relation(text)
    check_names(relation, names, *loc)
    try:
        relation.require_states(states)
        relation.require_still(changing)
    except FormulaError as error:
        raise problem(error, *loc) from None


def value_of(text: str | int | float, values: Mapping[str, float], *loc: str | int) -> float:
    """Return the value of a formula; `DeclarationProblem` at `loc` where it has none."""
    try:
        return parse(text).value(values)
    except FormulaError as error:
        raise problem(error, *loc) from None


KINKED = ("abs", "sign", "min", "max", "sat")
"""Functions without a derivative where they switch."""


def switching(
    text: str | int | float, variables: Collection[str], functions: Collection[str] = KINKED
) -> bool:
    """Return whether one of these functions of any of `variables` stands in a formula."""
    calls = (node for node in nodes(parse(text).root) if isinstance(node, Call))
    return any(
        call.function in functions and any(name.name in variables for name in names_in(call))
        for call in calls
    )


def check_smooth(
    text: str | int | float,
    variables: Collection[str],
    *,
    loc: tuple[str | int, ...],
    lacks: str,
    advice: str,
    roots: bool = False,
) -> None:
    """Check that a formula has no kink in any of `variables`.

    `lacks` and `advice` say what it has not where it switches, and what to write instead. With
    `roots` the root of a square, which is smooth on either side of zero, counts as a kink. Raises
    `DeclarationProblem` at the first kink.
    """
    for call in (node for node in nodes(parse(text).root) if isinstance(node, Call)):
        switched = {name.name for name in names_in(call)}.intersection(variables)
        if call.function in KINKED and switched:
            raise DeclarationProblem(
                f"{call.function} of {', '.join(sorted(switched))} has no {lacks} where it "
                "switches",
                advice=advice,
                loc=loc,
            )
    rooted = sorted(_under_roots(text).intersection(variables)) if roots else []
    if rooted:
        raise DeclarationProblem(
            f"the root of a square of {', '.join(rooted)} has no {lacks} where it is zero",
            advice=advice,
            loc=loc,
        )


def _under_roots(text: str | int | float) -> set[str]:
    """Return the names whose squares a formula takes the root of."""
    import sympy as sp

    formula = parse(text)
    found = formula.to_sympy({name: sp.Symbol(name, real=True) for name in formula.names})
    return {symbol.name for root in found.atoms(sp.Abs) for symbol in root.free_symbols}


MAX_DERIVED = 7_000
"""Operations of a formula's derivative; to build so many takes about two seconds."""

MAX_NESTED = 10
"""Functions in each other; SymPy asks each of all below it whether they are real, or zero."""


def check_derived(
    root: Node, variables: Collection[str], loc: tuple[str | int, ...] = (), order: int = 2
) -> None:
    """Check that the derivatives of a formula are not too large to be built.

    Raises `DeclarationProblem` if they are.
    """
    nested = _nested(root)
    if nested > MAX_NESTED:
        raise DeclarationProblem(
            f"{nested} functions in each other are too many to be differentiated",
            advice=f"at most {MAX_NESTED}; nest fewer functions",
            loc=loc,
        )
    size = _formula_sizes(root, variables)[order]
    if size > MAX_DERIVED:
        which = "second derivative" if order == 2 else "derivative"
        raise DeclarationProblem(
            f"its {which} has about {size} operations, at most {MAX_DERIVED} are allowed",
            advice="nest fewer functions and products; a sum may have many terms",
            loc=loc,
        )


def _nested(node: Node) -> int:
    """Return how many functions stand in each other, at most."""
    within = max(map(_nested, children(node)), default=0)
    return within + isinstance(node, Call)


def _formula_sizes(node: Node, variables: Collection[str]) -> tuple[int, int, int]:
    """Return how many operations a formula has, and its first and second derivative."""
    match node:
        case Name():
            return 1, int(node.name in variables), 0
        case Unary():
            size, first, second = _formula_sizes(node.operand, variables)
            return size + 1, first + 1 if first else 0, second + 1 if first else 0
    parts = [_formula_sizes(child, variables) for child in children(node)]
    size = 1 + sum(part[0] for part in parts)
    moving = [part for part in parts if part[1]]
    if isinstance(node, Binary) and node.operator in "+-":
        return size, 1 + sum(p[1] for p in moving), 1 + sum(p[2] for p in moving)
    # f(u, v)' = f_u u' + f_v v', and every partial derivative is about as large as f.
    first = sum(p[1] + size for p in moving)
    return size, first, sum(p[2] + 2 * p[1] + 2 * size for p in moving)
