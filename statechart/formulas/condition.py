"""Boolean trees of *and* and *or* over smooth atoms ``f <= 0`` and ``f < 0``.

`min`, `max`, `abs` and `sign` become *and* and *or*: ``max(a, b) + c <= 0`` is ``a + c <= 0 and b +
c <= 0``. The sign of an unknown factor is a further atom. Inside another function, ``g(max(a, b))
<= 0`` is ``a >= b and g(a) <= 0 or b >= a and g(b) <= 0``.

A certificate is a set of atoms that decide the truth of the tree, like the watched literals of SAT
solvers (Moskewicz et al., "Chaff", 2001): one false part of a false *and*, all parts of a false
*or*. The truth of the tree changes only with an atom of the certificate.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cache, partial, reduce
from itertools import combinations
from math import inf, isnan
from typing import TYPE_CHECKING, Any

from statechart.formulas.tree import Source

if TYPE_CHECKING:
    import sympy as sp

MAX_ATOMS = 100
"""Limit of the atoms of a relation; every `abs` in a sum doubles them."""

# Limit before equal atoms are merged, as of sums of abs of one variable.
MAX_SPLITS = 10 * MAX_ATOMS

_ROUND_OFF = 1e-14  # relative, of coefficients

Active = Callable[[str, str], bool]
"""Region, state -> whether the state is active."""


@dataclass(frozen=True)
class And:
    """Conjunction."""

    parts: tuple[Any, ...]


@dataclass(frozen=True)
class Or:
    """Disjunction."""

    parts: tuple[Any, ...]


@dataclass(frozen=True)
class InState:
    """``in(REGION.STATE)``: a region is in a state or in a substate; with `holds` False, is not."""

    region: str
    state: str
    holds: bool = True
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Atom:
    """``expression <= 0``, or ``expression < 0`` if `strict`."""

    expression: sp.Expr
    strict: bool

    @property
    def constant(self) -> bool | None:
        """Its truth if its expression is a number, else None."""
        if not self.expression.is_number:
            return None
        value = float(self.expression)
        return value < 0.0 or (value == 0.0 and not self.strict)


def fold(
    tree: Any,
    leaf: Callable[[Any], Any],
    within: Callable[[InState], Any],
    every: Callable[[list[Any]], Any],
    some: Callable[[list[Any]], Any],
) -> Any:
    """Fold a tree from its leaves: `every` for conjunctions, `some` for disjunctions."""
    if isinstance(tree, And | Or):
        parts = [fold(part, leaf, within, every, some) for part in tree.parts]
        return (every if isinstance(tree, And) else some)(parts)
    return within(tree) if isinstance(tree, InState) else leaf(tree)


def replaced(
    tree: Any, leaf: Callable[[Any], Any], within: Callable[[InState], Any] = lambda one: one
) -> Any:
    """Return a tree with `leaf` applied to every atom, and `within` to every `in`."""
    return fold(tree, leaf, within, lambda p: And(tuple(p)), lambda p: Or(tuple(p)))


@dataclass(frozen=True, eq=False)
class Condition:
    """A Boolean tree over numbered atoms; created by `Relation.condition`."""

    atoms: tuple[Atom, ...]
    root: Any  # leaves are indices of `atoms`

    @property
    def single(self) -> bool:
        """True if the tree is one atom."""
        return self.root == 0

    @property
    def disjoint(self) -> bool:
        """True if any true atom makes it true."""
        parts = self.root.parts if isinstance(self.root, Or) else [None]
        return self.single or all(isinstance(part, int) for part in parts)

    def instantaneous(self, moving: Collection[sp.Symbol]) -> bool:
        """Return whether a part is true at instants only: ``x <= 1 and x >= 1`` of `moving` x.

        The instant between the sides of a sign, ``x > 0 and ...`` and ``x < 0 and ...``, is not.
        """
        atoms = ((k, atom.expression) for k, atom in enumerate(self.atoms) if not atom.strict)
        closed = {k: e for k, e in atoms if set[Any]() < e.free_symbols <= {*moving}}
        if any(e.is_nonnegative and not e.is_positive for e in closed.values()):
            return True
        opposed = [{i, k} for i, k in combinations(closed, 2) if _opposed(closed[i], closed[k])]

        strict = {atom.expression: k for k, atom in enumerate(self.atoms) if atom.strict}

        def joint(tree: Any, beside: Collection[int] = ()) -> bool:
            if not isinstance(tree, And | Or):
                return False
            leaves = {part for part in tree.parts if isinstance(part, int)}
            if isinstance(tree, And):
                within = [pair for pair in opposed if pair <= leaves]
                sides = [{strict.get(closed[k]) for k in pair} for pair in within]
                return any(side.isdisjoint(beside) for side in sides) or any(map(joint, tree.parts))
            parts = [{*part.parts} if isinstance(part, And) else {part} for part in tree.parts]
            return any(joint(part, {*leaves}.union(*parts)) for part in tree.parts)

        return joint(self.root)

    def names(self, name: str) -> tuple[str, ...]:
        """Return names of the atoms: `name` for a single one, else numbered."""
        return (name,) if self.single else tuple(f"{name} #{k + 1}" for k in range(len(self.atoms)))

    def truth(self, of: Callable[[int], bool | None], active: Active) -> bool | None:
        """Return the truth in three-valued logic; `of` returns None for unknown atoms."""
        return _truth(self.root, of, active)

    def truths(self, atoms: Any, active: Callable[[str, str], Any]) -> Any:
        """Return the truth (m,) from the atoms (m, a); `active` returns (m,)."""
        return fold(
            self.root,
            lambda place: atoms[:, place],
            lambda within: active(within.region, within.state) == within.holds,
            partial(reduce, operator.and_),
            partial(reduce, operator.or_),
        )

    def margin(self, values: Sequence[float], active: Active) -> float:
        """Return the margin: maximum of an *and*, minimum of an *or*, infinite for `in`."""

        def within(tree: InState) -> float:
            return -inf if active(tree.region, tree.state) == tree.holds else inf

        margin: float = fold(self.root, values.__getitem__, within, max, min)
        return margin

    def certificate(
        self, of: Callable[[int], bool | None], active: Active, still: Callable[[int], bool]
    ) -> frozenset[int]:
        """Return atoms that decide the truth until one of them changes."""
        return _certificate(self.root, bool(self.truth(of, active)), of, active, still)


class AtomsAt:
    """Truth of atoms at the start of a flow.

    For margins within their tolerance, the sign `way(k)` of the first nonzero time derivative
    decides; if all vanish, closed atoms are true. Atoms that the flow does not change are `still`.
    Atoms whose margin `fell` are true unless it rises, or stays and the atom is not `alone` in its
    relation.
    """

    def __init__(
        self,
        margins: Sequence[float],
        tolerances: Sequence[float],
        closed: Sequence[bool],
        way: Callable[[int], float],
        *,
        fell: Collection[int] = (),
        alone: Collection[int] = (),
        still: Callable[[int], bool] = lambda _: False,
    ) -> None:
        self.tolerances = tolerances
        self._margins, self._closed, self._still = margins, closed, still
        self._fell, self._sure = fell, {*fell}.intersection(alone)
        self.way = cache(way)
        self._truths: dict[int, bool | None] = {}

    def near(self, k: int) -> bool:
        """Return whether a margin is within its tolerance."""
        return abs(self._margins[k]) <= self.tolerances[k]

    def holds(self, k: int) -> bool | None:
        """Return the truth of an atom just after this instant, None for NaN."""
        if k not in self._truths:
            self._truths[k] = self._holds(k)
        return self._truths[k]

    def _holds(self, k: int) -> bool | None:
        margin, near, fell = self._margins[k], self.near(k), k in self._fell
        if margin < -self.tolerances[k]:
            return True
        if not (fell or near):
            return None if isnan(margin) else False
        way = self.way(k)
        if way == 0.0 and near:
            return self._closed[k] or k in self._sure
        return not way > 0.0 if fell else way < 0.0

    def rests(self, k: int) -> bool:
        """Return whether an atom is constant in this flow."""
        return self._still(k) or (self.near(k) and self.way(k) == 0.0)

    def _holds_now(self, k: int) -> bool:
        """Return whether an atom is true at this instant."""
        return self._margins[k] <= (self.tolerances[k] if self._closed[k] else -self.tolerances[k])

    def truth(self, condition: Condition, first: int, active: Active) -> bool | None:
        """Return whether a condition with atoms from `first` on is true just after this instant."""
        if condition.single:
            return self.holds(first)
        return condition.truth(lambda k: self.holds(first + k), active)

    def touched(self, condition: Condition, first: int, active: Active) -> bool:
        """Return whether a condition is true at this instant."""
        return bool(condition.truth(lambda k: self._holds_now(first + k), active))

    def certificate(self, condition: Condition, first: int, active: Active) -> frozenset[int]:
        """Return the atoms of the certificate of a condition; all atoms if it is undecided."""
        places = range(len(condition.atoms))
        atoms: Collection[int] = places
        if self.truth(condition, first, active) is not None:
            rests = [self.rests(first + k) for k in places].__getitem__
            atoms = condition.certificate(lambda k: self.holds(first + k), active, rests)
        return frozenset(first + k for k in atoms)


def _truth(tree: Any, of: Callable[[int], bool | None], active: Active) -> bool | None:
    if isinstance(tree, InState):
        return active(tree.region, tree.state) is tree.holds
    if not isinstance(tree, And | Or):
        return of(tree)
    decisive = isinstance(tree, Or)
    result: bool | None = not decisive
    for part in tree.parts:
        truths = _truth(part, of, active)
        if truths is decisive:
            return decisive
        if truths is None:
            result = None
    return result


def _certificate(
    tree: Any,
    truth: bool,
    of: Callable[[int], bool | None],
    active: Active,
    unchanged: Callable[[int], bool],
) -> frozenset[int]:
    if isinstance(tree, InState):
        return frozenset()
    if not isinstance(tree, And | Or):
        return frozenset() if unchanged(tree) else frozenset((tree,))
    children = [child for child in tree.parts if _truth(child, of, active) is truth]
    certificate = [_certificate(child, truth, of, active, unchanged) for child in children]
    if isinstance(tree, Or) is truth:
        return min(certificate, key=len)
    return frozenset[int]().union(*certificate)


def _opposed(a: sp.Expr, b: sp.Expr) -> bool:
    """Return whether a is a negative multiple of b, up to round-off of coefficients."""
    first, second = (e.expand().as_coefficients_dict() for e in (a, b))
    if first.keys() != second.keys():
        return False
    ratios = [float(first[term] / second[term]) for term in first]
    return max(ratios) < 0.0 and max(ratios) - min(ratios) <= -_ROUND_OFF * max(ratios)


def condition_of(tree: Any, source: Source) -> Condition:
    """Return the condition of a tree of `Atom`, split into at most `MAX_ATOMS` smooth ones."""
    import sympy

    places: dict[Atom, int] = {}
    leaves: dict[Atom, Any] = {}

    def check(count: int, most: int) -> None:
        if count > most:
            message = f"without min, max, abs and sign it has more than {MAX_ATOMS} comparisons"
            advice = "write fewer of them in one relation; each abs in a sum doubles them"
            source.fail(message, advice=advice)

    def placed(atom: Atom) -> int:
        place = places.setdefault(atom, len(places))
        check(len(places), MAX_ATOMS)
        return place

    def split(tree: Any) -> Any:
        if isinstance(tree, And | Or):
            return _flatten(type(tree), tuple(split(part) for part in tree.parts))
        if isinstance(tree, InState):
            return tree
        if tree not in leaves:
            check(len(leaves), MAX_SPLITS)
            smooth = _split(tree)
            leaves[tree] = leaf(tree) if smooth is tree else split(smooth)
        return leaves[tree]

    def leaf(tree: Atom) -> Any:
        return placed(tree) if tree.constant is None else tree.constant

    root = split(tree)
    if isinstance(root, bool):
        # Comparisons of numbers are not simplified.
        is_constant = isinstance(tree, Atom) and tree.expression.is_number
        return Condition((tree if is_constant else Atom(sympy.Integer(1 - 2 * root), False),), 0)
    atoms = tuple(places)
    used: dict[int, int] = {}
    replaced(root, lambda place: used.setdefault(place, len(used)))
    return Condition(tuple(atoms[place] for place in used), replaced(root, used.__getitem__))


def _flatten(kind: type[And] | type[Or], parts: tuple[Any, ...]) -> Any:
    """Return a junction without constant parts."""
    decisive, neutral = (True, False) if kind is Or else (False, True)
    rest: dict[Any, None] = {}
    for part in parts:
        if part is decisive:
            return decisive
        if part is not neutral:
            rest |= dict.fromkeys(part.parts if isinstance(part, kind) else (part,))
    if not rest:
        return neutral
    return next(iter(rest)) if len(rest) == 1 else kind(tuple(rest))


def _split(atom: Atom) -> Any:
    """Return an atom as a tree without its outermost min, max, abs or sign; itself if smooth."""
    import sympy

    expression, strict = atom.expression, atom.strict
    # The angle of a nonnegative x has no branch cut, but its smooth pieces would jump there.
    uncut = {
        angle: sympy.pi / 2 - sympy.atan2(x, y)
        for angle in expression.atoms(sympy.atan2)
        for y, x in [angle.args]
        if y.free_symbols and y.is_nonnegative and not x.is_nonnegative
    }
    if uncut:
        return Atom(expression.xreplace(uncut), strict)
    corners = expression.atoms(sympy.Max, sympy.Min, sympy.Abs, sympy.sign)
    corners = {corner for corner in corners if corner.free_symbols}
    bare = _without_root(atom)
    if bare is not None or not corners:
        return bare or atom
    outermost = (c for c in corners if not any(c is not o and o.has(c) for o in corners))
    corner = min(outermost, key=sympy.default_sort_key)
    if isinstance(corner, sympy.sign):
        return _without_sign(atom, corner)
    largest = not isinstance(corner, sympy.Min)
    arguments = corner.args
    if isinstance(corner, sympy.Abs):
        arguments = (corner.args[0], -corner.args[0])

    def each(kind: type, of: sp.Expr) -> Any:
        return kind(tuple(Atom(of.xreplace({corner: part}), strict) for part in arguments))

    slot = sympy.Dummy(real=True)
    form = expression.xreplace({corner: slot})
    factor = sympy.diff(form, slot) if form.is_polynomial(slot) else slot
    if factor.has(slot):
        sign = 1 if largest else -1

        def chosen(part: sp.Expr) -> And:
            others = (other for other in arguments if other is not part)
            first = (Atom(sign * (other - part), False) for other in others)
            return And((*first, Atom(form.xreplace({slot: part}), strict)))

        return Or(tuple(map(chosen, arguments)))
    rising, falling = (And, Or) if largest else (Or, And)
    if factor.is_nonnegative:
        return each(rising, expression)
    if factor.is_nonpositive:
        return each(falling, expression)
    above = And((Atom(-factor, False), each(rising, expression)))
    return Or((above, And((Atom(factor, False), each(falling, expression)))))


def _without_root(atom: Atom) -> Any:
    """Return an atom without a root, which is nonsmooth at zero, or None.

    ``sqrt(abs(x)) <= r`` is ``abs(x) <= r**2``.
    """
    import sympy

    for term in sympy.Add.make_args(atom.expression):
        factor, root = term.as_coeff_Mul()
        base, exponent = root.as_base_exp()
        if exponent.is_integer or not (exponent.is_positive and base.is_nonnegative):
            continue
        bound = (term - atom.expression) / factor
        order = 1 / exponent if bound != 0 else sympy.S.One
        if order.is_integer and (bound == 0 or base.has(sympy.Max, sympy.Min, sympy.Abs)):
            side = 1 if factor.is_positive else -1
            sizes = -side * bound, side * (base - bound**order)
            return (And if side > 0 else Or)(tuple(Atom(size, atom.strict) for size in sizes))
    return None


def _without_sign(atom: Atom, sign: sp.Expr) -> Any:
    """Return an atom with 1 for ``sign(u)`` where u > 0, -1 where u < 0, and 0 where u = 0.

    The atom itself if it has no value where u = 0.
    """
    import sympy

    u = sign.args[0]
    plus, zero, minus = (
        Atom(atom.expression.subs(sign, value), atom.strict) for value in (1, 0, -1)
    )
    if zero.expression.has(sympy.nan, sympy.zoo):
        return atom
    # A side with the truth at zero includes zero.
    above, below = (
        zero.constant is not None and zero.constant is side.constant for side in (plus, minus)
    )
    parts = [And((Atom(-u, not above), plus)), And((Atom(u, not below), minus))]
    if not (above or below):
        parts.append(And((Atom(u, False), Atom(-u, False), zero)))
    return Or(tuple(parts))
