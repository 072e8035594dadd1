"""How large a formula's derivatives become: what is short as text need not be when derived."""

from __future__ import annotations

from collections.abc import Collection

from statechart.errors import DeclarationProblem
from statechart.formulas.syntax import Binary, Call, Name, Node, Unary, children

MAX_DERIVED = 7_000
"""Operations of a formula's derivative; to build so many takes about two seconds."""

MAX_NESTED = 10
"""Functions in each other; SymPy asks each of all below it whether they are real, or zero."""


def check_derived(
    root: Node, variables: Collection[str], loc: tuple[str | int, ...] = (), order: int = 2
) -> None:
    """Check that the derivatives of a formula are not too large to be built.

    Parameters
    ----------
    root : Node
        Of the formula.
    variables : collection of str
        What it is differentiated by.
    loc : tuple
        Where it stands.
    order : int
        How often it is differentiated, 1 or 2.

    Raises
    ------
    DeclarationProblem
        If they are.
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
