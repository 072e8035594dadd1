"""Checks that a formula has derivatives, and none too large to be built."""

from __future__ import annotations

from collections.abc import Collection

from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse
from statechart.formulas.tree import Binary, Call, Name, Node, Unary, children, names_in, nodes

_KINKED = ("abs", "sign", "min", "max")

PIECES = (
    "a step does not stop there, and a sign may switch for ever: declare a region with a state for "
    "each smooth piece, and a transition whose guard is where it switches"
)
"""Advice on a kink in time or in the state."""


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
        if call.function in _KINKED and switched:
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
    size = _sizes(root, variables)[order]
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


def _sizes(node: Node, variables: Collection[str]) -> tuple[int, int, int]:
    """Return how many operations a formula has, and its first and second derivative."""
    match node:
        case Name():
            return 1, int(node.name in variables), 0
        case Unary():
            size, first, second = _sizes(node.operand, variables)
            return size + 1, first + 1 if first else 0, second + 1 if first else 0
    parts = [_sizes(child, variables) for child in children(node)]
    size = 1 + sum(part[0] for part in parts)
    moving = [part for part in parts if part[1]]
    if isinstance(node, Binary) and node.operator in "+-":
        return size, 1 + sum(p[1] for p in moving), 1 + sum(p[2] for p in moving)
    # f(u, v)' = f_u u' + f_v v', and every partial derivative is about as large as f.
    first = sum(p[1] + size for p in moving)
    return size, first, sum(p[2] + 2 * p[1] + 2 * size for p in moving)
