"""Field types of documents: names, formulas, relations, numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Annotated, Any, ClassVar, NamedTuple, Self, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from statechart.documents.documented import Documented, own_words
from statechart.errors import DeclarationError, DeclarationProblem, Findings, FormulaError
from statechart.formulas import tree
from statechart.formulas.formula import Formula, parse
from statechart.formulas.hints import no_name
from statechart.formulas.relation import Relation, conjunction, parse_relation
from statechart.formulas.syntax import NAME


def _constant(value: Any) -> Any:
    if getattr(value, "ndim", None) == 0:  # a NumPy scalar
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise PydanticCustomError("formula_type", "must be a number or a formula")
    try:
        parse(value)
    except FormulaError as error:
        raise error.problem() from None
    # One spelling of infinity, so that a model equals its YAML round trip.
    return str(value) if isinstance(value, float) and math.isinf(value) else value


def _formula(value: Any) -> Any:
    value = _constant(value)
    _check_jumps(parse(value))
    return value


TIME = "time"
"""The name of the time since the start in formulas."""


def _check_jumps(*formulas: Formula) -> None:
    """Check that formulas along a run have no jumping function except of time.

    `statechart.charts.wrapping` replaces those by counting regions.
    """
    for formula in formulas:
        for call in tree.calls_in(formula.root, tree.JUMPS):
            if all(name.name != TIME for name in tree.names_in(call.arguments[0])):
                raise DeclarationProblem(
                    f"formula {formula.text!r}: {call.function} jumps, and may stand only in "
                    "parameters, starts, copies, updates, entry and exit",
                    advice="write a parameter if its arguments are constant; along a run, write "
                    "mod(time, T), a state for each piece, or updates: {VARIABLE: FORMULA}",
                    offset=call.offset,
                )


def check_named_infinity(
    text: str | int | float, *loc: str | int, advice: str = "only a friction may be inf"
) -> None:
    """Raise `DeclarationProblem` at `loc` if a formula contains `inf`."""
    formula = parse(text)
    if formula.names_infinity:
        message = f"formula {formula.text!r}: must be finite"
        raise DeclarationProblem(message, advice=advice, loc=loc)


def _without_infinity(value: str | int | float) -> str | int | float:
    check_named_infinity(value)
    return value


def _relation(value: str) -> str:
    try:
        relation = parse_relation(value)
    except FormulaError as error:
        raise error.problem() from None
    _check_jumps(*relation.formulas)
    for one in relation.comparisons:
        # On its boundary the derivatives of a margin decide.
        check_derived(tree.Binary("-", one.left.root, one.right.root), relation.names)
    if any(formula.names_infinity for formula in relation.formulas):
        message = f"formula {value!r}: nothing is compared with infinity"
        raise DeclarationProblem(message, advice="write a finite number")
    return value


def _all_of(value: Any) -> Any:
    """Return the conjunction of a list of relations."""
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
    if value in tree.RESERVED:
        kind = "function" if value in tree.FUNCTIONS else "constant"
        advice = f"write another name, such as {value}_1"
        raise DeclarationProblem(f"{value!r} is a {kind} of formulas", advice=advice)
    return value


def _value_name(value: str) -> str:
    if value in tree.WORDS:
        advice = f"write another name, such as {value}_1"
        raise DeclarationProblem(f"{value!r} is a word of relations", advice=advice)
    return value


FormulaText = Annotated[str | int | float, BeforeValidator(_formula)]
"""A number or formula, stored as written (infinity as the text `inf`)."""

ConstantText = Annotated[str | int | float, BeforeValidator(_constant)]
"""A formula evaluated before a run or at instants, which may contain `floor` and `mod`."""

FiniteConstantText = Annotated[ConstantText, AfterValidator(_without_infinity)]
"""A formula evaluated before a run or at instants, without `inf`."""

FiniteText = Annotated[FormulaText, AfterValidator(_without_infinity)]
"""A formula without `inf`."""

OneRelation = Annotated[str, AfterValidator(_relation)]
"""A relation, stored as written."""

RelationText = Annotated[
    OneRelation, BeforeValidator(_all_of, json_schema_input_type=str | list[str])
]
"""A relation, or a list of relations, stored as their conjunction."""

NameText = Annotated[str, AfterValidator(_name)]
"""A name that formulas can use."""

ValueName = Annotated[NameText, AfterValidator(_value_name)]
"""A name of a value; not a keyword of relations."""

Label = Annotated[str, Field(min_length=1, max_length=200)]
"""Free text."""

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""A finite number, not text."""

AnyPart = TypeVar("AnyPart", bound=BaseModel)


class Part(BaseModel, metaclass=Documented):
    """Base of every model of a document: immutable, unknown keys refused."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", populate_by_name=True, json_schema_extra=own_words
    )

    OTHER_WORDS: ClassVar[Mapping[str, str]] = {}
    """Keys of other programs, separated by blanks -> our notation."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in type(self).model_fields:
            raise DeclarationError(
                f"{type(self).__name__}: {name} does not change once it is built",
                advice=f"build another one: model_copy(update={{{name!r}: ...}}), or of a model "
                "with_(...) for its parameters",
            )
        super().__setattr__(name, value)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return the part with other values of fields, validated like a new one."""
        if update is None:
            return super().model_copy(deep=deep)
        own = type(self).model_fields
        if not isinstance(update, Mapping) or not all(isinstance(name, str) for name in update):
            raise DeclarationError(
                f"{type(self).__name__}: update must map names of fields to values, not {update!r}",
                advice=f"write model_copy(update={{{next(iter(own), 'NAME')!r}: ...}})",
            )
        names = {field.alias: name for name, field in own.items()}
        fields = {name: getattr(self, name) for name in self.model_fields_set}
        renamed = {names.get(name, name): value for name, value in update.items()}
        return type(self)(**{**fields, **renamed})


def replace_fields(part: AnyPart, **fields: Any) -> AnyPart:
    """Return a part with other values of fields, without validation.

    For parts derived from validated ones; users call `model_copy`.
    """
    own = {name: getattr(part, name) for name in type(part).model_fields}
    made = part.model_construct({*part.model_fields_set, *fields}, **{**own, **fields})
    for name in type(part).__private_attributes__:
        setattr(made, name, getattr(part, name))
    return made


def check_names(formula: Formula | Relation, known: Collection[str], *loc: str | int) -> None:
    """Raise `DeclarationProblem` at the first unknown name of a formula."""
    try:
        formula.require(known)
    except FormulaError as error:
        raise error.problem(*loc) from None


def check_relation(
    text: str,
    names: Collection[str],
    states: Mapping[str, Collection[str]],
    changing: Collection[str],
    *loc: str | int,
) -> None:
    """Check names and states of a relation, and that equalities are of piecewise constants."""
    relation = parse_relation(text)
    check_names(relation, names, *loc)
    try:
        relation.require_states(states)
        relation.require_still(changing)
    except FormulaError as error:
        raise error.problem(*loc) from None


def value_of(text: str | int | float, values: Mapping[str, float], *loc: str | int) -> float:
    """Return the value of a formula; raise `DeclarationProblem` at `loc` if it has none."""
    try:
        return parse(text).value(values)
    except FormulaError as error:
        raise error.problem(*loc) from None


class ValueCheck(NamedTuple):
    """A check of values of parameters: the names that it reads, and a function that raises."""

    names: frozenset[str]
    check: Callable[[Mapping[str, float]], object]


def finite_check(text: FormulaText, *loc: str | int) -> ValueCheck:
    """Return the check that the value of a formula is finite."""

    def check(values: Mapping[str, float]) -> None:
        if not math.isfinite(value := value_of(text, values, *loc)):
            raise DeclarationProblem(f"must be finite, not {value:g}", loc=loc)

    return ValueCheck(parse(text).names, check)


def check_all(checks: Iterable[ValueCheck], values: Mapping[str, float]) -> None:
    """Make checks; raise the first `DeclarationProblem` with the others attached."""
    found = Findings()
    for _, check in checks:
        with found:
            check(values)
    found.check()


KINKED = ("abs", "sign", "min", "max", "sat")
"""Nonsmooth functions."""
SWITCHING = (*KINKED, "atan2")
"""Functions with switching surfaces: kinks and branch cuts."""
_WAVES = ("sin", "cos")
_FOLDING = {"asin": _WAVES, "acos": _WAVES, "atan2": _WAVES, "atan": ("tan",)}
"""Inverse function -> functions whose argument it folds back."""


def has_switch(
    text: str | int | float, variables: Collection[str], functions: Collection[str] = SWITCHING
) -> bool:
    """Return whether a formula contains one of `functions` of any of `variables`."""
    calls = tree.calls_in(parse(text).root, functions)
    return any(name.name in variables for call in calls for name in tree.names_in(call))


def check_smooth(
    text: str | int | float,
    variables: Collection[str],
    *,
    loc: tuple[str | int, ...],
    lacks: str,
    advice: str,
    roots: bool = False,
) -> None:
    """Check that a formula is smooth in `variables`.

    Inverses of periodic functions, as ``asin(sin(time))``, have kinks or jumps. `lacks` and
    `advice` complete the message. With `roots` the root of a square counts as a kink. Raises
    `DeclarationProblem` at the first kink.
    """
    for call in tree.calls_in(parse(text).root, (*KINKED, *_FOLDING)):
        inner = _FOLDING.get(call.function, ())
        inside = (isinstance(part, tree.Call) and part.function in inner for part in call.arguments)
        if inner and not all(inside):
            continue
        switched = {name.name for name in tree.names_in(call)}.intersection(variables)
        if switched:
            message = (
                f"{call.function} of {', '.join(sorted(switched))} has no {lacks} where it switches"
            )
            raise DeclarationProblem(message, advice=advice, loc=loc)
    rooted = sorted(_under_roots(text).intersection(variables)) if roots else []
    if rooted:
        message = f"the root of a square of {', '.join(rooted)} has no {lacks} where it is zero"
        raise DeclarationProblem(message, advice=advice, loc=loc)


def _under_roots(text: str | int | float) -> set[str]:
    """Return the names with roots of their squares in a formula."""
    import sympy as sp

    formula = parse(text)
    found = formula.to_sympy({name: sp.Symbol(name, real=True) for name in formula.names})
    return {symbol.name for root in found.atoms(sp.Abs) for symbol in root.free_symbols}


MAX_DERIVED = 7_000
"""Operations of a derivative, which take about two seconds to build."""

MAX_NESTED = 10
"""Depth of nested functions, since SymPy's assumption queries grow with it."""


def check_derived(
    root: tree.Node, variables: Collection[str], loc: tuple[str | int, ...] = (), order: int = 2
) -> None:
    """Raise `DeclarationProblem` if the derivatives of a formula are too large to be built."""
    nested = _nesting_depth(root)
    if nested > MAX_NESTED:
        message = f"{nested} nested functions are too many to differentiate"
        advice = f"at most {MAX_NESTED}; nest fewer functions"
        raise DeclarationProblem(message, advice=advice, loc=loc)
    size = _formula_sizes(root, variables)[order]
    if size > MAX_DERIVED:
        which = "second derivative" if order == 2 else "derivative"
        message = f"its {which} has about {size} operations, at most {MAX_DERIVED} are allowed"
        advice = "nest fewer functions and products; a sum may have many terms"
        raise DeclarationProblem(message, advice=advice, loc=loc)


def _nesting_depth(node: tree.Node) -> int:
    """Return the depth of nested functions."""
    within = max(map(_nesting_depth, tree.children(node)), default=0)
    return within + isinstance(node, tree.Call)


def _formula_sizes(node: tree.Node, variables: Collection[str]) -> tuple[int, int, int]:
    """Return the estimated operations of a formula and its first two derivatives."""
    match node:
        case tree.Name():
            return 1, int(node.name in variables), 0
        case tree.Unary():
            size, first, second = _formula_sizes(node.operand, variables)
            return size + 1, first + 1 if first else 0, second + 1 if first else 0
    parts = [_formula_sizes(child, variables) for child in tree.children(node)]
    size = 1 + sum(part[0] for part in parts)
    moving = [part for part in parts if part[1]]
    if isinstance(node, tree.Binary) and node.operator in "+-":
        return size, 1 + sum(p[1] for p in moving), 1 + sum(p[2] for p in moving)
    # Chain rule f_u u' + f_v v'; partial derivatives are about as large as f.
    first = sum(p[1] + size for p in moving)
    return size, first, sum(p[2] + 2 * p[1] + 2 * size for p in moving)
