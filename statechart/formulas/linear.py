"""Symbolic solution of linear equations as a straight-line program.

A mode is a linear system in accelerations and forces. Pivots are numbers, or alone in their row or
column, so that all divisors are factors of the determinant: a zero moment of inertia (a point mass)
is regular, and the only singularities are those of the mode, such as the Painleve boundary.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from operator import attrgetter

import sympy as sp
from sympy.utilities.iterables import connected_components

from statechart.errors import SingularMode

Definition = tuple[sp.Symbol, sp.Expr]

# Cramer's rule grows as n!, and has no spurious singularities; larger systems use Gaussian
# elimination. One body with a pinned point is a system of 5.
MAX_CRAMER = 5

# A force computed from an acceleration suffers cancellation if it is small. Cramer's rule avoids
# this, for systems up to this size.
_MAX_PAIRED = 3
# Least numeric pivot, since symbolic entries have unknown size. Pivots of mechanics are 1.
_MIN_PIVOT = 0.5

Row = dict[sp.Symbol, sp.Expr]
Equation = tuple[Row, sp.Expr, int]
"""Coefficients, right-hand side, index of the original equation."""


class Singular(SingularMode):
    """The equations are structurally singular in some unknowns."""

    def __init__(self, unknowns: Sequence[sp.Symbol]) -> None:
        super().__init__("no equation determines " + ", ".join(str(u) for u in unknowns))
        self.unknowns = tuple(unknowns)


free_symbols = lru_cache(1 << 14)(attrgetter("free_symbols"))
"""Symbols of an expression; modes share most expressions."""


def solve_linear(
    equations: Sequence[sp.Expr],
    unknowns: Sequence[sp.Symbol],
    paired: int = 0,
    before: Collection[sp.Symbol] = (),
) -> tuple[Definition, ...]:
    """Solve `equations` (each = 0, linear in `unknowns`), one connected component at a time.

    The first `paired` equations and unknowns are pairs. Returns definitions in order of evaluation,
    in terms of parameters and earlier definitions. Raises `Singular` for a structurally singular
    system.
    """
    definitions: list[Definition] = []
    missing: list[sp.Symbol] = []
    for component in _connected_components(equations, unknowns):
        pairs = sum(place < paired for place in component)
        try:
            rows = tuple(equations[i] for i in component if i < len(equations))
            columns = tuple(unknowns[i] for i in component if i < len(unknowns))
            definitions += _solve_component(rows, columns, pairs, frozenset(before))
        except Singular as error:
            missing += error.unknowns
    if missing:
        raise Singular(missing)
    return tuple(definitions)


def _connected_components(
    equations: Sequence[sp.Expr], unknowns: Sequence[sp.Symbol]
) -> list[list[int]]:
    """Return the connected components of equations and unknowns; pairs are connected."""
    place = {unknown: i for i, unknown in enumerate(unknowns)}
    found = [(row, free_symbols(equation)) for row, equation in enumerate(equations)]
    edges = [(row, place[u]) for row, symbols in found for u in symbols if u in place]
    vertices = range(max(len(equations), len(unknowns)))
    return sorted(map(sorted, connected_components((vertices, edges))))


@lru_cache(4096)
def _solve_component(
    equations: tuple[sp.Expr, ...],
    unknowns: tuple[sp.Symbol, ...],
    paired: int,
    before: frozenset[sp.Symbol],
) -> tuple[Definition, ...]:
    """Solve the equations of one component; modes share the result."""
    place = {unknown: i for i, unknown in enumerate(unknowns)}
    whole: list[Equation] = [(*_linear_row(e, place), i) for i, e in enumerate(equations)]
    first, rows, last = _reduce(whole, unknowns, before, paired)
    if paired and _largest(rows) > 2 * _MAX_PAIRED:
        first, rows, last = _reduce(whole, unknowns, before)
    if paired and _largest(rows) > 2 * MAX_CRAMER:
        mirrors = _mirrors(whole, unknowns, paired)
        first, rows, last = _reduce(whole, unknowns, before, mirrors=mirrors)
    block = _blocks(rows, place, (paired, len(unknowns)) if paired else ())
    solved = {u for u, _ in (*first, *block, *last)}
    missing = [u for u in unknowns if u not in solved]
    if missing:
        raise Singular(missing)
    return (*first, *block, *reversed(last))


def _reduce(
    rows: list[Equation],
    unknowns: Sequence[sp.Symbol],
    before: Collection[sp.Symbol],
    motions: int = 0,
    mirrors: Collection[int] | None = None,
) -> tuple[list[Definition], list[Equation], list[Definition]]:
    """Eliminate by pivots that are numbers, or alone in their row or column.

    Unknowns from `motions` on are eliminated by their own equations only. `mirrors` are symmetric
    pairs: their pivots are on the diagonal, so that the Schur complement stays definite. Returns
    the unknowns known at once, the remaining equations, and the eliminated unknowns in reverse
    order of evaluation.
    """
    place = {unknown: i for i, unknown in enumerate(unknowns)}
    first: list[Definition] = []
    last: list[Definition] = []
    sizes: dict[sp.Expr, float] = {}
    swapped: set[int] = set()
    while True:
        rows = [equation for equation in rows if equation[0]]
        pivot = _pivot(rows, place, sizes, swapped, before, motions, mirrors)
        if pivot is None:
            return first, rows, last
        index, unknown, where = pivot
        row, right, origin = rows.pop(index)
        if origin != place[unknown]:
            # A constraint solved for an acceleration: the equation of motion is paired with the
            # constraint force.
            partner = place[unknown]
            rows = [(e, b, origin if i == partner else i) for e, b, i in rows]
            swapped.add(origin)
        row = dict(row)
        coefficient = row.pop(unknown)
        others = sum((-c * u for u, c in row.items()), start=right)
        value = others if coefficient == 1 else others / coefficient
        if where == "row":
            first.append((unknown, value))
            # A force that is exactly zero is substituted: no 0/0 if the next pivot vanishes.
            known = value if value == 0 else unknown
            rows = [_insert(equation, unknown, known) for equation in rows]
        else:
            last.append((unknown, value))
            if where == "number":
                rows = [_eliminate(e, unknown, row, right, coefficient) for e in rows]


def _mirrors(rows: list[Equation], unknowns: Sequence[sp.Symbol], paired: int) -> set[int]:
    """Return the pairs with symmetric rows and columns up to signs, of the first `paired`."""
    mirrors = set()
    for row, _, k in rows:
        own = (row.get(unknowns[j], sp.S.Zero) for j in range(paired))
        others = (rows[j][0].get(unknowns[k], sp.S.Zero) for j in range(paired))
        if all(one in (other, -other) for one, other in zip(own, others, strict=True)):
            mirrors.add(k)
    return mirrors


def _linear_row(equation: sp.Expr, unknowns: Mapping[sp.Symbol, int]) -> tuple[Row, sp.Expr]:
    """Return the coefficients of the unknowns in a linear equation, and its right-hand side.

    Term by term, since most terms need no differentiation.
    """
    coefficients: dict[sp.Symbol, list[sp.Expr]] = {}
    known: list[sp.Expr] = []
    for term in sp.Add.make_args(equation):
        factors = sp.Mul.make_args(term)
        direct = next((factor for factor in factors if factor in unknowns), None)
        if direct is not None:
            coefficients.setdefault(direct, []).append(sp.Mul(*(f for f in factors if f != direct)))
            continue
        present = unknowns.keys() & term.free_symbols
        for unknown in present:
            coefficients.setdefault(unknown, []).append(sp.diff(term, unknown))
        known.append(term.xreplace(dict.fromkeys(present, sp.S.Zero)) if present else term)
    sums = {u: sp.Add(*coefficients[u]) for u in sorted(coefficients, key=unknowns.__getitem__)}
    return {u: c for u, c in sums.items() if c != 0}, -sp.Add(*known)


def _pivot(
    rows: list[Equation],
    place: Mapping[sp.Symbol, int],
    sizes: dict[sp.Expr, float],
    wanted: Collection[int],
    before: Collection[sp.Symbol],
    motions: int,
    mirrors: Collection[int] | None,
) -> tuple[int, sp.Symbol, str] | None:
    """Choose the cheapest pivot (Markowitz) that divides by a factor of the determinant only.

    `sizes` caches magnitudes of coefficients, 0 for symbolic ones. `wanted` pairs and `before`
    unknowns have priority. `motions`, `mirrors`: see `_reduce`.
    """

    def size(coefficient: sp.Expr) -> float:
        if coefficient not in sizes:
            sizes[coefficient] = abs(float(coefficient)) if coefficient.is_number else 0.0
        return sizes[coefficient]

    for index, (row, _, _) in enumerate(rows):
        if len(row) == 1:
            return index, next(iter(row)), "row"
    count = Counter(unknown for row, _, _ in rows for unknown in row)
    best: tuple[tuple[bool, int], int, sp.Symbol, str] | None = None
    for index, (row, _, origin) in enumerate(rows):
        largest = max(map(size, row.values()))
        for unknown, coefficient in row.items():
            if count[unknown] == 1:
                return index, unknown, "column"
            partner = place[unknown]
            if mirrors is not None and origin != partner and not {origin, partner} <= {*mirrors}:
                continue
            if 0 < motions <= partner and (origin != partner or origin in wanted):
                continue
            if size(coefficient) >= max(_MIN_PIVOT, 0.1 * largest):
                # Bound of the fill-in.
                fill = (len(row) - 1) * (count[unknown] - 1)
                fill = -1 if origin == partner and origin in wanted else fill
                cost = unknown not in before, fill
                if best is None or cost < best[0]:
                    best = (cost, index, unknown, "number")
    return None if best is None else best[1:]


def _insert(equation: Equation, unknown: sp.Symbol, value: sp.Expr) -> Equation:
    row, right, origin = equation
    coefficient = row.get(unknown)
    if coefficient is None:
        return equation
    return {u: c for u, c in row.items() if u != unknown}, right - coefficient * value, origin


def _eliminate(
    equation: Equation,
    unknown: sp.Symbol,
    by: Row,
    by_right: sp.Expr,
    pivot: sp.Expr,
    name: Callable[[sp.Expr], sp.Expr] = lambda entry: entry,
) -> Equation:
    row, right, origin = equation
    if unknown not in row:
        return equation
    factor = name(row[unknown] / pivot)
    result = {u: c for u, c in row.items() if u != unknown}
    for other, coefficient in by.items():
        total = result.get(other, sp.S.Zero) - factor * coefficient
        if total == 0:
            result.pop(other, None)
        else:
            result[other] = name(total)
    return result, name(right - factor * by_right), origin


def _blocks(
    rows: list[Equation], place: Mapping[sp.Symbol, int], pairs: tuple[int, ...]
) -> list[Definition]:
    """Solve the remaining equations by components, eliminating `pairs` of large ones first."""
    definitions: list[Definition] = []
    for component in _components(rows):
        indices = sorted(i for i in component if isinstance(i, int))
        unknowns = sorted((u for u in component if not isinstance(u, int)), key=str)
        if len(indices) != len(unknowns):
            raise Singular(unknowns)
        component_rows = [rows[i] for i in indices]
        if len(unknowns) > MAX_CRAMER and pairs:
            named, rest, later = _eliminate_pairs(component_rows, unknowns, place, pairs[0])
            definitions += [*named, *_blocks(rest, place, pairs[1:]), *reversed(later)]
        elif len(unknowns) > MAX_CRAMER:
            definitions += _solve_by_elimination(component_rows, unknowns)
        else:
            definitions += _solve_by_determinants(component_rows, unknowns)
    return definitions


def _components(rows: list[Equation]) -> list[list[int | sp.Symbol]]:
    edges = [(index, unknown) for index, (row, _, _) in enumerate(rows) for unknown in row]
    vertices = [*range(len(rows)), *dict.fromkeys(unknown for _, unknown in edges)]
    return connected_components((vertices, edges))


def _largest(rows: list[Equation]) -> int:
    return max((len(component) for component in _components(rows)), default=0)


def _eliminate_named(
    rows: list[Equation],
    pivot: Callable[[list[Equation]], tuple[int, sp.Symbol] | None],
    name: Callable[[sp.Expr], sp.Expr],
) -> tuple[list[Equation], list[Definition]]:
    """Eliminate unknowns by chosen pivots, naming every intermediate result.

    Returns the remaining equations, and the eliminated unknowns in reverse order of evaluation.
    """
    rows = [({u: name(c) for u, c in row.items()}, name(right), i) for row, right, i in rows]
    last: list[Definition] = []
    while (definitions := pivot(rows)) is not None:
        index, unknown = definitions
        row, right, _ = rows.pop(index)
        others = {u: c for u, c in row.items() if u != unknown}
        rows = [_eliminate(e, unknown, others, right, row[unknown], name) for e in rows]
        last.append((unknown, sum((-c * u for u, c in others.items()), start=right) / row[unknown]))
    return rows, last


def _eliminate_pairs(
    rows: list[Equation], unknowns: Sequence[sp.Symbol], place: Mapping[sp.Symbol, int], paired: int
) -> tuple[list[Definition], list[Equation], list[Definition]]:
    """Eliminate unknowns by their paired equations, motions first.

    Returns intermediate results, the remaining equations, and the eliminated unknowns in reverse
    order of evaluation.
    """
    todo = sorted((u for u in unknowns if place[u] < paired), key=place.__getitem__)

    def own(rows: list[Equation]) -> tuple[int, sp.Symbol] | None:
        while todo:
            unknown = todo.pop(0)
            for index, (row, _, origin) in enumerate(rows):
                if origin == place[unknown] and unknown in row:
                    return index, unknown
        return None

    named: list[Definition] = []
    rest, last = _eliminate_named(rows, own, _naming_function("pair", named))
    return named, rest, last


def _solve_by_elimination(rows: list[Equation], unknowns: Sequence[sp.Symbol]) -> list[Definition]:
    """Solve by Gaussian elimination, in O(n^3) operations."""
    columns = {unknown: k for k, unknown in enumerate(unknowns)}

    def sparsest(rows: list[Equation]) -> tuple[int, sp.Symbol] | None:
        if not rows:
            return None
        costs = [(len(row), i, columns[u]) for i, (row, _, _) in enumerate(rows) for u in row]
        if not costs:
            raise Singular(list(columns))
        _, index, column = min(costs)
        columns.pop(unknowns[column])
        return index, unknowns[column]

    named: list[Definition] = []
    _, last = _eliminate_named(rows, sparsest, _naming_function("elimination", named))
    return [*named, *reversed(last)]


def _solve_by_determinants(rows: list[Equation], unknowns: Sequence[sp.Symbol]) -> list[Definition]:
    """Solve by Cramer's rule with named entries, so that the determinants are short."""
    tag = str(unknowns[0])
    result: list[Definition] = []
    name = _naming_function(f"entry_{tag}", result)
    matrix = sp.Matrix([[row.get(u, 0) for u in unknowns] for row, _, _ in rows]).applyfunc(name)
    right = sp.Matrix([right for _, right, _ in rows]).applyfunc(name)
    determinant = sp.Dummy(f"det_{tag}", real=True)
    total = matrix.det(method="laplace")
    if total == 0:
        raise Singular(unknowns)
    result.append((determinant, total))
    for column, unknown in enumerate(unknowns):
        replaced = matrix.copy()
        replaced[:, column] = right
        result.append((unknown, replaced.det(method="laplace") / determinant))
    return result


def _naming_function(word: str, named: list[Definition]) -> Callable[[sp.Expr], sp.Expr]:
    """Return a function that replaces compound expressions by new symbols."""
    known: dict[sp.Expr, sp.Symbol] = {}

    def name(entry: sp.Expr) -> sp.Expr:
        if entry.is_number or entry.is_Symbol:
            return entry
        if entry not in known:
            known[entry] = sp.Dummy(word, real=True)
            named.append((known[entry], entry))
        return known[entry]

    return name
