"""Small linear systems by Cramer's rule; what is too large for it by elimination."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import sympy as sp

from statechart.errors import SingularMode

Definition = tuple[sp.Symbol, sp.Expr]

# Laplace expansion grows as n!, and is exact in structure; beyond this, fraction by fraction. One
# body with a pinned point makes a system of 5.
CRAMER_LIMIT = 5


class Singular(SingularMode):
    """The equations do not determine every unknown, whatever the numbers are.

    Parameters
    ----------
    unknowns : sequence of Symbol
        The unknowns that nothing determines.
    """

    def __init__(self, unknowns: Sequence[sp.Symbol]) -> None:
        super().__init__("no equation determines " + ", ".join(str(u) for u in unknowns))
        self.unknowns = tuple(unknowns)


def naming(word: str, named: list[Definition]) -> Callable[[sp.Expr], sp.Expr]:
    """Return what gives an expression a symbol, and notes it; of symbols and numbers themselves."""

    def name(entry: sp.Expr) -> sp.Expr:
        if entry.is_number or entry.is_Symbol:
            return entry
        symbol = sp.Dummy(word, real=True)
        named.append((symbol, entry))
        return symbol

    return name


def by_determinants(
    matrix: sp.Matrix, right: sp.Matrix, unknowns: Sequence[sp.Symbol]
) -> list[Definition]:
    """Cramer's rule with every entry named, so that the determinants stay small."""
    size = len(unknowns)
    tag = str(unknowns[0])
    named: list[Definition] = []
    name = naming(f"entry_{tag}", named)
    matrix = matrix.applyfunc(name)
    right = right.applyfunc(name)
    if size > CRAMER_LIMIT:
        return named + _gauss(matrix, right, unknowns)
    determinant = sp.Dummy(f"det_{tag}", real=True)
    total = matrix.det(method="laplace")
    if total == 0:
        raise Singular(unknowns)
    result = [*named, (determinant, total)]
    for column, unknown in enumerate(unknowns):
        replaced = matrix.copy()
        replaced[:, column] = right
        result.append((unknown, replaced.det(method="laplace") / determinant))
    return result


def _gauss(matrix: sp.Matrix, right: sp.Matrix, unknowns: Sequence[sp.Symbol]) -> list[Definition]:
    """Elimination with every intermediate named: a straight-line program of O(n^3) operations."""
    size = len(unknowns)
    rows = [[matrix[i, k] for k in range(size)] + [right[i]] for i in range(size)]
    definitions: list[Definition] = []
    name = naming("elimination", definitions)
    order: list[tuple[int, list[sp.Expr]]] = []
    columns = list(range(size))
    while rows:
        candidates = [
            (sum(e != 0 for e in row[:size]), i, k)
            for i, row in enumerate(rows)
            for k in columns
            if row[k] != 0
        ]
        if not candidates:
            raise Singular([unknowns[k] for k in columns])
        _, index, column = min(candidates)
        pivot = rows.pop(index)
        order.append((column, pivot))
        columns.remove(column)
        for row in rows:
            if row[column] == 0:
                continue
            factor = name(row[column] / pivot[column])
            for k in (*columns, size):
                if pivot[k] != 0:
                    row[k] = name(row[k] - factor * pivot[k])
            row[column] = sp.S.Zero
    for column, pivot in reversed(order):
        known = sum(
            (-pivot[k] * unknowns[k] for k in range(size) if k != column and pivot[k] != 0),
            start=pivot[size],
        )
        definitions.append((unknowns[column], known / pivot[column]))
    return definitions
