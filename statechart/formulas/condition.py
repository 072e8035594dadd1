"""Relations as trees of *and* and *or* over smooth atoms ``f <= 0`` and ``f < 0``.

`min`, `max` and `abs` become *and* and *or*: ``max(a, b) + c <= 0`` is the same as ``a + c <= 0
and b + c <= 0``. The sign of an unknown factor is an atom, too. Inside another function,
``g(max(a, b)) <= 0`` is ``a >= b and g(a) <= 0 or b >= a and g(b) <= 0``.

A certificate is a set of atoms that alone decide the truth of the tree, as the watched literals of
SAT solvers do (Moskewicz et al., "Chaff", 2001): a false *and* needs one false part, a false *or*
all of them. As long as no atom of the certificate changes, nor does the relation.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from math import inf, isnan
from typing import TYPE_CHECKING, Any

from statechart.formulas.tree import Source

if TYPE_CHECKING:
    import sympy as sp

MAX_ATOMS = 100
"""Most atoms of a relation; every `abs` in a sum doubles them."""

# Atoms on the way there: sums of abs of one variable have many of them in common.
MAX_SPLITS = 10 * MAX_ATOMS

Active = Callable[[str, str], bool]
"""Region, state -> whether the state is active."""


@dataclass(frozen=True)
class Every:
    """Holds where all of its parts do."""

    parts: tuple[Any, ...]


@dataclass(frozen=True)
class Some:
    """Holds where one of its parts does."""

    parts: tuple[Any, ...]


@dataclass(frozen=True)
class Within:
    """Holds while a region is in a state, or as long as it is not."""

    region: str
    state: str
    holds: bool = True


@dataclass(frozen=True)
class Atom:
    """Holds where `expression` is <= 0, or where it is < 0 if `strict`."""

    expression: sp.Expr
    strict: bool


def folded(
    tree: Any,
    leaf: Callable[[Any], Any],
    within: Callable[[Within], Any],
    every: Callable[[list[Any]], Any],
    some: Callable[[list[Any]], Any],
) -> Any:
    """Return what `every` and `some` make of a tree from the bottom, given its leaves."""
    if isinstance(tree, Every | Some):
        parts = [folded(part, leaf, within, every, some) for part in tree.parts]
        return (every if isinstance(tree, Every) else some)(parts)
    return within(tree) if isinstance(tree, Within) else leaf(tree)


def replaced(
    tree: Any, leaf: Callable[[Any], Any], within: Callable[[Within], Any] = lambda one: one
) -> Any:
    """Return a tree with `leaf(x)` in the place of every leaf x, and `within` of those of `in`."""
    return folded(tree, leaf, within, lambda p: Every(tuple(p)), lambda p: Some(tuple(p)))


@dataclass(frozen=True, eq=False)
class Condition:
    """A tree over numbered atoms; build it with `Relation.condition`."""

    atoms: tuple[Atom, ...]
    root: Any  # leaves are places in `atoms`

    @property
    def single(self) -> bool:
        """True if it is one atom and nothing else."""
        return self.root == 0

    @property
    def disjoint(self) -> bool:
        """True if it holds as soon as one of its atoms does."""
        return self.single or (
            isinstance(self.root, Some) and all(isinstance(part, int) for part in self.root.parts)
        )

    def names(self, name: str) -> tuple[str, ...]:
        """Return names for its atoms: `name` itself of a single one, else numbered."""
        return (name,) if self.single else tuple(f"{name} #{k + 1}" for k in range(len(self.atoms)))

    def truth(self, of: Callable[[int], bool | None], active: Active) -> bool | None:
        """Return whether it holds; None where atoms that are not known leave it open."""
        return _truth(self.root, of, active)

    def truths(self, atoms: Any, active: Callable[[str, str], Any]) -> Any:
        """Return its truth (m,) from that of its atoms (m, a).

        `active` returns arrays (m,).
        """
        return folded(
            self.root,
            lambda place: atoms[:, place],
            lambda within: active(within.region, within.state) == within.holds,
            partial(reduce, operator.and_),
            partial(reduce, operator.or_),
        )

    def margin(self, values: Sequence[float], active: Active) -> float:
        """Return the margin of the tree from those of its atoms.

        It is the largest of an *and*, the least of an *or*, and infinite where `in` decides.
        """

        def within(tree: Within) -> float:
            return -inf if active(tree.region, tree.state) == tree.holds else inf

        margin: float = folded(self.root, values.__getitem__, within, max, min)
        return margin

    def certificate(
        self, of: Callable[[int], bool | None], active: Active, still: Callable[[int], bool]
    ) -> frozenset[int]:
        """Return atoms that decide its truth as long as they keep their own."""
        return _certificate(self.root, bool(self.truth(of, active)), of, active, still)


class AtomsAt:
    """Atoms of conditions at an instant, on their boundary judged by the way that they go.

    Within its tolerance a margin is on its boundary, and the sign `way(k)` of its first derivative
    that is not zero decides; where it stays, an atom holds if it is closed. Atoms that the flow
    does not change are `still`. The margins of those that `fell` have been found to, and must not
    rise; they hold where they stay if they are `alone` in their relation.
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
        self._find_way = way
        self._ways: dict[int, float] = {}
        self._truths: dict[int, bool | None] = {}

    def way(self, k: int) -> float:
        """Return the sign of an atom's first derivative that is not zero."""
        if k not in self._ways:
            self._ways[k] = self._find_way(k)
        return self._ways[k]

    def near(self, k: int) -> bool:
        """Return whether an atom is on its boundary."""
        return abs(self._margins[k]) <= self.tolerances[k]

    def holds(self, k: int) -> bool | None:
        """Return whether an atom holds from here on; None if it has no value."""
        if k not in self._truths:
            self._truths[k] = self._judge(k)
        return self._truths[k]

    def _judge(self, k: int) -> bool | None:
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
        """Return whether an atom stays as it is in this flow."""
        return self._still(k) or (self.near(k) and self.way(k) == 0.0)

    def _holds_now(self, k: int) -> bool:
        """Return whether an atom holds at this very instant."""
        return self._margins[k] <= (self.tolerances[k] if self._closed[k] else -self.tolerances[k])

    def truth(self, condition: Condition, first: int, active: Active) -> bool | None:
        """Return whether a condition, whose atoms begin at `first`, holds from here on."""
        return condition.truth(lambda k: self.holds(first + k), active)

    def touched(self, condition: Condition, first: int, active: Active) -> bool:
        """Return whether a condition holds at this very instant."""
        return bool(condition.truth(lambda k: self._holds_now(first + k), active))

    def certificate(self, condition: Condition, first: int, active: Active) -> frozenset[int]:
        """Return the places of atoms that decide a condition; of all where it is open."""
        places = range(len(condition.atoms))
        atoms: Collection[int] = places
        if self.truth(condition, first, active) is not None:
            rests = [self.rests(first + k) for k in places]
            atoms = condition.certificate(
                lambda k: self.holds(first + k), active, rests.__getitem__
            )
        return frozenset(first + k for k in atoms)


def _truth(tree: Any, of: Callable[[int], bool | None], active: Active) -> bool | None:
    if isinstance(tree, Within):
        return active(tree.region, tree.state) is tree.holds
    if not isinstance(tree, Every | Some):
        return of(tree)
    decisive = isinstance(tree, Some)
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
    if isinstance(tree, Within):
        return frozenset()
    if not isinstance(tree, Every | Some):
        return frozenset() if unchanged(tree) else frozenset((tree,))
    children = [child for child in tree.parts if _truth(child, of, active) is truth]
    certificate = [_certificate(child, truth, of, active, unchanged) for child in children]
    if isinstance(tree, Some) is truth:
        return min(certificate, key=len)
    return frozenset[int]().union(*certificate)


def condition_of(tree: Any, source: Source) -> Condition:
    """Return the condition of a tree whose leaves are `Atom`, split into smooth ones.

    Raises `FormulaError` where it has more than `MAX_ATOMS`.
    """
    import sympy

    places: dict[Atom, int] = {}
    leaves: dict[Atom, Any] = {}

    def check(count: int, most: int) -> None:
        if count > most:
            source.fail(
                f"without min, max and abs it has more than {MAX_ATOMS} comparisons",
                advice="write fewer of them in one relation; each abs in a sum doubles them",
            )

    def placed(atom: Atom) -> int:
        place = places.setdefault(atom, len(places))
        check(len(places), MAX_ATOMS)
        return place

    def split(tree: Any) -> Any:
        if isinstance(tree, Every | Some):
            return _flattened(type(tree), tuple(split(part) for part in tree.parts))
        if isinstance(tree, Within):
            return tree
        if tree not in leaves:
            check(len(leaves), MAX_SPLITS)
            smooth = _split(tree)
            leaves[tree] = leaf(tree) if smooth is tree else split(smooth)
        return leaves[tree]

    def leaf(tree: Atom) -> Any:
        if tree.expression.is_number:
            value = float(tree.expression)
            return value < 0.0 or (value == 0.0 and not tree.strict)
        return placed(tree)

    root = split(tree)
    if isinstance(root, bool):
        # A comparison of numbers is a margin as any other.
        is_constant = isinstance(tree, Atom) and tree.expression.is_number
        return Condition((tree if is_constant else Atom(sympy.Integer(1 - 2 * root), False),), 0)
    atoms = tuple(places)
    used: dict[int, int] = {}
    replaced(root, lambda place: used.setdefault(place, len(used)))
    return Condition(tuple(atoms[place] for place in used), replaced(root, used.__getitem__))


def _flattened(kind: type[Every] | type[Some], parts: tuple[Any, ...]) -> Any:
    """Return parts joined, without those that are always true or false."""
    decisive, neutral = (True, False) if kind is Some else (False, True)
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
    """Return an atom without its first min, max or abs, as a tree of atoms; itself if smooth."""
    import sympy

    expression, strict = atom.expression, atom.strict
    corners = expression.atoms(sympy.Max, sympy.Min, sympy.Abs)
    corners = {corner for corner in corners if corner.free_symbols}
    bare = _without_root(atom)
    if bare is not None or not corners:
        return bare or atom
    # An outer one first: those inside it come to stand alone.
    corner = min(
        (c for c in corners if not any(c is not o and o.has(c) for o in corners)),
        key=sympy.default_sort_key,
    )
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

        def chosen(part: sp.Expr) -> Every:
            others = (other for other in arguments if other is not part)
            first = (Atom(sign * (other - part), False) for other in others)
            return Every((*first, Atom(form.xreplace({slot: part}), strict)))

        return Some(tuple(map(chosen, arguments)))
    rising, falling = (Every, Some) if largest else (Some, Every)
    if factor.is_nonnegative:
        return each(rising, expression)
    if factor.is_nonpositive:
        return each(falling, expression)
    return Some(
        (
            Every((Atom(-factor, False), each(rising, expression))),
            Every((Atom(factor, False), each(falling, expression))),
        )
    )


def _without_root(atom: Atom) -> Any:
    """Return an atom without its root of what is never negative; None where it has none.

    Roots have no derivative where they are zero: ``sqrt(abs(x)) <= r`` is ``abs(x) <= r**2``.
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
            return (Every if side > 0 else Some)(tuple(Atom(size, atom.strict) for size in sizes))
    return None
