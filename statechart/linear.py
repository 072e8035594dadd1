"""Linear equations with symbolic coefficients, solved as a straight-line program.

A mode is one linear system in accelerations and forces. Eliminating by pivots that are plain
numbers, or that are alone in their row or column, divides by nothing that is not a factor of the
determinant: a moment of inertia of zero (a point mass) stays an ordinary value, and the only
singularities left are those of the mode itself, such as the Painleve boundary.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp
from sympy.utilities.iterables import connected_components

from statechart.errors import SingularMode

__all__ = ["Definition", "Singular", "solve_linear"]

Definition = tuple[sp.Symbol, sp.Expr]

# Laplace expansion grows as n!, and is exact in structure; beyond this, fraction by fraction.
_CRAMER_LIMIT = 6
# A pivot that is a number must not be small: the symbols beside it are of unknown size. The ones of
# mechanics (a force in its own equation, an acceleration in a constraint) are 1.
_SMALLEST = 0.5


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


Row = dict[sp.Symbol, sp.Expr]


def solve_linear(
    equations: Sequence[sp.Expr], unknowns: Sequence[sp.Symbol]
) -> tuple[Definition, ...]:
    """Solve `equations` (each = 0, linear in `unknowns`).

    Parameters
    ----------
    equations : sequence of Expr
        As many as there are unknowns.
    unknowns : sequence of Symbol
        What to solve for.

    Returns
    -------
    tuple of (Symbol, Expr)
        Definitions in order of evaluation; each uses the unknowns defined before it, and
        auxiliary symbols defined before it.

    Raises
    ------
    Singular
        If the structure of the equations leaves an unknown free.
    """
    place = {unknown: i for i, unknown in enumerate(unknowns)}
    rows = [_row(equation, place) for equation in equations]

    first: list[Definition] = []
    last: list[Definition] = []
    sizes: dict[sp.Expr, float] = {}
    while True:
        rows = [(row, right) for row, right in rows if row]
        pivot = _pivot(rows, sizes)
        if pivot is None:
            break
        index, unknown, where = pivot
        row, right = rows.pop(index)
        coefficient = row.pop(unknown)
        others = sum((-c * u for u, c in row.items()), start=right)
        value = others if coefficient == 1 else others / coefficient
        if where == "row":
            first.append((unknown, value))
            # A force that is exactly zero takes its quotients with it: no 0/0 where the next
            # pivot vanishes.
            known = value if value == 0 else unknown
            rows = [_insert(r, b, unknown, known) for r, b in rows]
        else:
            last.append((unknown, value))
            if where == "number":
                rows = [_eliminate(r, b, unknown, row, right, coefficient) for r, b in rows]
    block = _blocks(rows)
    solved = {u for u, _ in (*first, *block, *last)}
    missing = [u for u in unknowns if u not in solved]
    if missing:
        raise Singular(missing)
    return (*first, *block, *reversed(last))


def _row(equation: sp.Expr, unknowns: Mapping[sp.Symbol, int]) -> tuple[Row, sp.Expr]:
    """Return the coefficients of the unknowns in a linear equation, and its right-hand side.

    Term by term: most are a coefficient times an unknown, or the long ones without any, which
    need not be differentiated.
    """
    found: dict[sp.Symbol, list[sp.Expr]] = {}
    known: list[sp.Expr] = []
    for term in sp.Add.make_args(equation):
        factors = sp.Mul.make_args(term)
        direct = next((factor for factor in factors if factor in unknowns), None)
        if direct is not None:
            found.setdefault(direct, []).append(sp.Mul(*(f for f in factors if f != direct)))
            continue
        present = unknowns.keys() & term.free_symbols
        for unknown in present:
            found.setdefault(unknown, []).append(sp.diff(term, unknown))
        known.append(term.xreplace(dict.fromkeys(present, sp.S.Zero)) if present else term)
    sums = {u: sp.Add(*found[u]) for u in sorted(found, key=unknowns.__getitem__)}
    return {u: c for u, c in sums.items() if c != 0}, -sp.Add(*known)


def _pivot(
    rows: list[tuple[Row, sp.Expr]], sizes: dict[sp.Expr, float]
) -> tuple[int, sp.Symbol, str] | None:
    """Choose the cheapest pivot that divides by a factor of the determinant only.

    `sizes` keeps those of the coefficients seen so far: 0 where they are not numbers.
    """

    def size(coefficient: sp.Expr) -> float:
        if coefficient not in sizes:
            sizes[coefficient] = abs(float(coefficient)) if coefficient.is_number else 0.0
        return sizes[coefficient]

    for index, (row, _) in enumerate(rows):
        if len(row) == 1:
            return index, next(iter(row)), "row"
    count: dict[sp.Symbol, int] = {}
    for row, _ in rows:
        for unknown in row:
            count[unknown] = count.get(unknown, 0) + 1
    best: tuple[int, int, sp.Symbol, str] | None = None
    for index, (row, _) in enumerate(rows):
        largest = max(map(size, row.values()))
        for unknown, coefficient in row.items():
            if count[unknown] == 1:
                return index, unknown, "column"
            if size(coefficient) >= max(_SMALLEST, 0.1 * largest):
                # Markowitz: the fill that the elimination can make.
                cost = (len(row) - 1) * (count[unknown] - 1)
                if best is None or cost < best[0]:
                    best = (cost, index, unknown, "number")
    return None if best is None else best[1:]


def _insert(row: Row, right: sp.Expr, unknown: sp.Symbol, value: sp.Expr) -> tuple[Row, sp.Expr]:
    coefficient = row.get(unknown)
    if coefficient is None:
        return row, right
    return {u: c for u, c in row.items() if u != unknown}, right - coefficient * value


def _eliminate(
    row: Row, right: sp.Expr, unknown: sp.Symbol, by: Row, by_right: sp.Expr, pivot: sp.Expr
) -> tuple[Row, sp.Expr]:
    if unknown not in row:
        return row, right
    factor = row[unknown] / pivot
    result = {u: c for u, c in row.items() if u != unknown}
    for other, coefficient in by.items():
        total = result.get(other, sp.S.Zero) - factor * coefficient
        if total == 0:
            result.pop(other, None)
        else:
            result[other] = total
    return result, right - factor * by_right


def _blocks(rows: list[tuple[Row, sp.Expr]]) -> list[Definition]:
    """Solve what is left, one connected component at a time."""
    edges = [(index, unknown) for index, (row, _) in enumerate(rows) for unknown in row]
    vertices = [*range(len(rows)), *dict.fromkeys(unknown for _, unknown in edges)]
    definitions: list[Definition] = []
    for component in connected_components((vertices, edges)):
        indices = sorted(i for i in component if isinstance(i, int))
        unknowns = sorted((u for u in component if not isinstance(u, int)), key=str)
        if len(indices) != len(unknowns):
            raise Singular(unknowns)
        matrix = sp.Matrix([[rows[i][0].get(u, 0) for u in unknowns] for i in indices])
        right = sp.Matrix([rows[i][1] for i in indices])
        definitions += _cramer(matrix, right, unknowns)
    return definitions


def _cramer(matrix: sp.Matrix, right: sp.Matrix, unknowns: Sequence[sp.Symbol]) -> list[Definition]:
    """Cramer's rule with every entry named, so that the determinants stay small."""
    size = len(unknowns)
    tag = str(unknowns[0])
    named: list[Definition] = []

    def name(entry: sp.Expr) -> sp.Expr:
        if entry.is_number or entry.is_Symbol:
            return entry
        symbol = sp.Dummy(f"entry_{tag}", real=True)
        named.append((symbol, entry))
        return symbol

    matrix = matrix.applyfunc(name)
    right = right.applyfunc(name)
    if size > _CRAMER_LIMIT:
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

    def name(entry: sp.Expr) -> sp.Expr:
        if entry.is_number or entry.is_Symbol:
            return entry
        symbol = sp.Dummy("elimination", real=True)
        definitions.append((symbol, entry))
        return symbol

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
