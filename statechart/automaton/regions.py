"""Regions of an automaton: states and edges, margins, loads, nesting, events of jumps.

Runs use flat edges between states. In statecharts (Harel 1987) an edge out of every state of a
superstate leaves the superstate, and edges into all of its states under one guard enter it with a
choice.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Literal, NamedTuple

from statechart.formulas.relation import Relation, parse_relation

if TYPE_CHECKING:
    import sympy as sp  # slow import, not needed by declarations

    from statechart.automaton.trace import Jump, Role
    from statechart.documents.outputs import Event
    from statechart.formulas.condition import Active, Condition
    from statechart.formulas.linear import Definition

MarginKind = Literal["plain", "gap", "speed", "force", "hold", "implied"]


@dataclass(frozen=True)
class Margin:
    """An expression that is >= 0 in a mode."""

    name: str  # such as ``tip.gap`` or ``tip.mu V - H``
    expression: sp.Expr  # of variables, parameters, time and unknowns
    # Kind of tolerance. Events of `force`, `hold` and `implied` margins are below minus their
    # tolerance (hysteresis, so that the source mode is not re-entered), others are at zero.
    kind: MarginKind = "plain"
    relation: str = ""  # name of the relation of which it is one of several atoms
    whole: sp.Expr | None = None  # margin of that relation; None if it depends on states
    # Quantity that the name stands for, if the expression is a multiple of it; reports show it
    shown: sp.Expr | None = None
    # Coefficient in that quantity, which is left out of reports where this is infinite
    coefficient: sp.Expr | None = None
    # Condition of the relation of which it is an atom
    condition: Condition | None = field(default=None, compare=False)

    def replaced(self, values: Mapping[sp.Symbol, sp.Expr]) -> Margin:
        """Return the margin with values substituted for symbols."""
        names = ("expression", "whole", "shown", "coefficient")
        own = {name: one for name in names if (one := getattr(self, name)) is not None}
        return replace(self, **{name: one.xreplace(values) for name, one in own.items()})


def whole_margins(margins: Iterable[Margin]) -> tuple[Margin, ...]:
    """Return the margins with atoms of a relation replaced by the margin of the relation.

    A single atom may be negative while its relation is false. Relations on states of regions are
    omitted.
    """
    found = {}
    for margin in margins:
        if not margin.relation:
            found[margin.name] = margin
        elif margin.whole is not None:
            found[margin.relation] = Margin(margin.relation, margin.whole)
    return tuple(found.values())


def shown_margins(margins: Iterable[Margin]) -> tuple[Margin, ...]:
    """Return the margins of whole relations, as the quantities after which they are named."""
    wholes = whole_margins(margins)
    return tuple(m if m.shown is None else replace(m, expression=m.shown) for m in wholes)


def with_coefficients(margins: Sequence[Margin]) -> tuple[sp.Expr, ...]:
    """Return the expressions of margins, then the coefficients in them, 0 without one."""
    import sympy as sp

    coefficients = (sp.S.Zero if m.coefficient is None else m.coefficient for m in margins)
    return (*(m.expression for m in margins), *coefficients)


def margins_of(
    name: str, relation: Relation, known: Mapping[str, sp.Expr]
) -> tuple[Condition, tuple[Margin, ...]]:
    """Return a relation over atoms, and the margins of the atoms, falling as they turn true."""
    condition = relation.condition(known)
    names = condition.names(name)
    if condition.single:
        return condition, (Margin(name, condition.atoms[0].expression, condition=condition),)
    whole = None if relation.members else relation.margin(known)
    pairs = zip(names, condition.atoms, strict=True)
    own = partial(Margin, relation=name, whole=whole, condition=condition)
    return condition, tuple(own(one, atom.expression) for one, atom in pairs)


@dataclass(frozen=True, eq=False)
class StopCondition:
    """A condition that ends a run."""

    name: str
    condition: Condition
    margins: tuple[Margin, ...]  # of the atoms


def stop_conditions(
    texts: Mapping[str, str], known: Mapping[str, sp.Expr]
) -> tuple[StopCondition, ...]:
    """Return the stop conditions of texts over `known` names."""
    parsed = ((name, parse_relation(text)) for name, text in texts.items())
    return tuple(StopCondition(name, *margins_of(name, one, known)) for name, one in parsed)


@dataclass(frozen=True, eq=False)
class Invariant:
    """A relation that a declaration asserts of runs, or while a state is active."""

    name: str
    text: str
    known: Mapping[str, sp.Expr]  # name -> expression

    @cached_property
    def relation(self) -> Relation:
        """The parsed relation."""
        return parse_relation(self.text)

    def margin(self, active: Active) -> Margin:
        """Return the margin in a mode, >= 0 if it holds; infinite where `in` alone decides."""
        return self._margins(tuple(active(m.region, m.state) for m in self.relation.members))

    @cached_property
    def _margins(self) -> Callable[[tuple[bool, ...]], Margin]:
        import sympy

        def margin(known: tuple[bool, ...]) -> Margin:
            states = {
                (member.region, member.state): sympy.oo if one else -sympy.oo
                for member, one in zip(self.relation.members, known, strict=True)
            }
            return Margin(self.name, -self.relation.margin(self.known, states))

        return cache(margin)


DONE = "done"
"""Event of a completed state."""
UNREACHED = "no transition leads there from the start"
"""Reason why a state of `Nesting.unreached` is infeasible."""


@dataclass(frozen=True)
class Choice:
    """A target of an edge, and its reset."""

    target: str  # an innermost state
    reset: str  # as of an `Edge`


@dataclass(frozen=True)
class HierarchicalEdge:
    """Edges of a region drawn as one arrow; `cause`, `guard`, `on_zeno` are as of an `Edge`."""

    cause: str
    source: str  # state or superstate, every state of which it leaves
    target: str  # state or superstate
    guard: str
    choices: tuple[Choice, ...]  # `target` itself, or states in it that the laws choose
    on_zeno: bool = False
    updates: Mapping[str, str | int | float] = field(default_factory=dict)  # variable -> formula
    events: tuple[str, ...] = ()  # of other regions
    condition: str | None = None  # relation at these events
    static: bool = False  # exits no state
    internal: bool = False  # does not exit its source

    @property
    def reset(self) -> str:
        """Reset common to all choices, or an empty text."""
        resets = {choice.reset for choice in self.choices}
        return resets.pop() if len(resets) == 1 else ""


class History(NamedTuple):
    """A history pseudostate: a transition to it enters the states last active in `parent`."""

    depth: Literal["shallow", "deep"]
    parent: str
    initial: str  # default target; `parent` for a history of regions


def updates_text(updates: Mapping[str, str | int | float]) -> str:
    """Return updates as text, without variables that no file declares: these have a dot.

    They are clocks and counts of transitions, and places that joints capture.
    """
    return ", ".join(f"{name} := {to}" for name, to in updates.items() if "." not in name)


@dataclass(frozen=True, eq=False)
class Nesting:
    """Declared hierarchy of a flattened region."""

    names: tuple[str, ...] = ()  # states and superstates in document order
    # Configuration -> its innermost states.
    configurations: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    initial: Mapping[str, str] = field(default_factory=dict)  # superstate ("": region) -> initial
    parallel: frozenset[str] = frozenset()
    histories: Mapping[str, History] = field(default_factory=dict)
    # State -> updates on entry, and on exit.
    entries: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)
    exits: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)
    edges: tuple[HierarchicalEdge, ...] = ()  # as declared, of flat regions too
    unreached: frozenset[str] = frozenset()  # unreachable states and superstates
    flows: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)
    final: frozenset[str] = frozenset()
    # Configuration -> completed superstates (or the region), inner first.
    done: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def active(self, state: str, superstates: Mapping[str, str]) -> tuple[str, ...]:
        """Return the active states of a configuration, and their superstates."""
        states: dict[str, None] = {}
        for name in self.configurations.get(state, (state,)):
            states[name] = None
            while name in superstates:
                name = superstates[name]
                states[name] = None
        return tuple(states)


@dataclass(frozen=True)
class Claim:
    """Relations that are all true while a state is active (`holds`), or not all true."""

    name: str  # of the guard, invariant or condition
    relations: tuple[str, ...]
    holds: bool


@dataclass(frozen=True)
class Loads:
    """Unknowns that the equations of motion do not determine, as statically indeterminate forces.

    Carriers replace them in the equations of motion; their own equations are solved afterwards.
    """

    carried: Mapping[sp.Symbol, sp.Expr]  # unknown -> expression in the equations of motion
    carriers: tuple[sp.Symbol, ...]  # unknowns of these expressions
    laws: Mapping[sp.Symbol, sp.Expr]  # unknown -> its linear equation (= 0)
    balances: Mapping[sp.Symbol, sp.Expr]  # shared unknown -> term of a sum over states (= 0)
    known: Mapping[sp.Expr, sp.Expr] = field(default_factory=dict)  # expression -> value


@dataclass(frozen=True, eq=False)
class Hold:
    """Holonomic constraints with their acceleration equations and workless forces."""

    places: tuple[sp.Expr, ...]  # constraint functions of positions, each = 0, scaled as lengths
    equations: tuple[sp.Expr, ...]  # as many, each = 0: second derivatives of `places`
    forces: tuple[sp.Symbol, ...]  # as many
    anchors: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)  # constant -> value
    steep: bool = False  # gradients may grow without bound


@dataclass(frozen=True)
class State:
    """Contribution of a region to a mode."""

    equations: tuple[sp.Expr, ...] = ()  # each = 0, linear in unknowns and carriers
    margins: tuple[Margin, ...] = ()
    invariants: tuple[Invariant, ...] = ()  # declared assertions, checked on traces
    values: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)  # control -> expression
    loads: Loads | None = None
    holds: tuple[Hold, ...] = ()


@dataclass(frozen=True)
class Edge:
    """A transition of a region as text."""

    cause: str  # touchdown, liftoff, ... or the name of the transition
    source: str
    target: str
    guard: str
    reset: str = ""
    on_zeno: bool = False  # fired by the accumulation of jumps out of `source`
    # It causes changes only in jumps of its own cause; not part of the text of an edge.
    alone: bool = field(default=False, compare=False, repr=False)


@dataclass(frozen=True, eq=False)
class Region:
    """An orthogonal region (a contact, a controller): states, built on demand, and edges."""

    name: str
    states: tuple[str, ...]
    build: Callable[[Role], State]
    edges: tuple[Edge, ...]
    superstates: Mapping[str, str] = field(default_factory=dict)  # state or superstate -> parent
    listed: tuple[str, ...] = ()  # superstates declared as states: slide, for its directions
    impact_cause: str = ""  # further cause of a jump with an impulse on it, unless a contact
    nesting: Nesting = field(default_factory=Nesting)
    forces: tuple[sp.Symbol, ...] = ()  # its unknowns; hidden while it is captured (see `Role`)
    default: str = ""  # state omitted in names of modes, such as `free`
    claims: Callable[[str], tuple[Claim, ...]] = lambda _: ()  # state -> relations for tests

    def declared(self, state: str) -> str:
        """Return the declared name of a state."""
        return next((name for name in self.active(state) if name in self.listed), state)

    @cached_property
    def active(self) -> Callable[[str], tuple[str, ...]]:
        """Function of a configuration: its active states, each followed by its superstates."""
        return cache(partial(self.nesting.active, superstates=self.superstates))

    def entered_with(self, name: str) -> set[str]:
        """Return a state and the default states that are entered with it."""
        if name in self.nesting.parallel:
            inner = [state for state, outer in self.superstates.items() if outer == name]
        else:
            inner = [state for outer, state in self.nesting.initial.items() if outer == name]
        return {name}.union(*map(self.entered_with, inner))

    @property
    def innermost(self) -> tuple[str, ...]:
        """The declared innermost states, unreachable ones last."""
        configurations = self.nesting.configurations
        entered = (n for s in self.states for n in configurations.get(s, (s,)))
        return tuple(dict.fromkeys((*entered, *self.outside)))

    @property
    def outside(self) -> tuple[str, ...]:
        """The unreachable innermost states."""
        holding = {*self.superstates.values()}
        unreached = self.nesting.unreached.difference(holding, self.states)
        return tuple(name for name in self.nesting.names if name in unreached)

    @property
    def frames(self) -> list[str]:
        """The superstates, outer first."""
        names = dict.fromkeys(self.superstates.values())
        return sorted(names, key=lambda name: len(self.active(name)))

    def within(self, name: str) -> tuple[str, ...]:
        """Return the states in which `name` is active."""
        return tuple(state for state in self.states if name in self.active(state))


@dataclass(frozen=True, eq=False)
class Mode:
    """Solved equations of a mode."""

    definitions: tuple[Definition, ...]  # straight-line program for controls and unknowns
    rates: tuple[sp.Expr, ...]  # d/dt of every variable
    margins: tuple[Margin, ...]  # stop conditions last
    hidden: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)  # forces shown to observers
    # Index of a dependent variable -> expression of the others, parameters, time and anchors. It is
    # integrated too, but only `definitions` read it.
    eliminated: Mapping[int, sp.Expr] = field(default_factory=dict)
    anchors: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)  # constant -> expression

    @cached_property
    def varying(self) -> tuple[bool, ...]:
        """Mask (n,) of the variables whose rates are not identically zero."""
        defined = dict(self.definitions)
        return tuple(defined.get(rate, rate) != 0 for rate in self.rates)

    @cached_property
    def roots(self) -> tuple[sp.Pow, ...]:
        """Powers with exponents between 0 and 1 in the rates and definitions."""
        from sympy import Pow, default_sort_key

        expressions = (*self.rates, *(e for _, e in self.definitions))
        powers = {power for e in expressions for power in e.atoms(Pow)}
        roots = [p for p in powers if p.exp.is_number and 0 < p.exp < 1]
        return tuple(sorted(roots, key=default_sort_key))


def active_in(regions: Sequence[Region], key: Sequence[str]) -> Active:
    """Return the predicate (region, state) -> whether the state is active."""
    states = {region.name: (region, state) for region, state in zip(regions, key, strict=True)}

    def active(region: str, state: str) -> bool:
        owner, current = states[region]
        return state in owner.active(current)

    return active


def hierarchical_edges(region: Region) -> tuple[HierarchicalEdge, ...]:
    """Return the edges of a region, merged over its superstates.

    Edges out of all states of a superstate into one state are merged, then edges from one source by
    one cause and guard into all states of a superstate. Regions with declared nesting have their
    declared edges.
    """
    if region.nesting.configurations:
        return region.nesting.edges
    sources_by_edge: dict[tuple[str, str, str, str, bool], list[str]] = {}
    for e in region.edges:
        key = (e.cause, e.target, e.guard, e.reset, e.on_zeno)
        sources_by_edge.setdefault(key, []).append(e.source)
    fans: dict[tuple[str, str, str, bool], dict[str, str]] = {}
    for (cause, target, guard, reset, on_zeno), sources in sources_by_edge.items():
        for source in replace_complete_sets(region, sources):
            fans.setdefault((cause, source, guard, on_zeno), {})[target] = reset
    edges = []
    for (cause, source, guard, on_zeno), targets in fans.items():
        for target in replace_complete_sets(region, list(targets)):
            choices = tuple(Choice(leaf, targets[leaf]) for leaf in region.within(target))
            edges.append(HierarchicalEdge(cause, source, target, guard, choices, on_zeno))
    return tuple(edges)


def replace_complete_sets(region: Region, states: Sequence[str]) -> list[str]:
    """Return states with complete sets replaced by their superstate."""
    remaining, covered = dict.fromkeys(states), dict[str, None]()
    for name in region.frames:
        members = region.within(name)
        if len(members) > 1 and remaining.keys() >= set(members):
            covered[name] = None
            remaining = dict.fromkeys(state for state in remaining if state not in members)
    return [*covered, *remaining]


def has_happened(regions: Sequence[Region], jump: Jump, event: Event) -> bool:
    """Return whether a jump raises an event: a cause, a state entered, or a state done.

    A jump may change several regions (an impact acts on all closed contacts); their causes are
    those of their edges. A region with an `impact_cause` raises it besides that of its change.
    """
    if event.region is None:
        changes = zip(regions, jump.source, jump.target, strict=True)
        causes = (_causes(region, jump, *change) for region, *change in changes)
        return jump.cause == event.cause or any(event.cause in own for own in causes)
    wanted = event.region, event.cause
    return any(wanted == (one.owner, one.cause) for one in raised_events(regions, jump))


class Raised(NamedTuple):
    """An event of a jump; its `owner` is the region, or a completed state."""

    region: str
    owner: str
    cause: str

    def answers(self, event: Event, listener: str, own: Collection[str]) -> bool:
        """Return whether it is an event that a region with `own` completable states waits for."""
        if self.cause != event.cause or event.region not in (None, self.owner):
            return False
        return (self.region == listener) == (self.cause == DONE and event.region in own)


def raised_events(regions: Sequence[Region], jump: Jump) -> tuple[Raised, ...]:
    """Return the events of a jump in order: causes, states entered, states done."""
    events: dict[Raised, None] = {}
    changes = list(zip(regions, jump.source, jump.target, strict=True))
    for region, before, after in changes:
        for cause in _causes(region, jump, before, after):
            events[Raised(region.name, region.name, cause)] = None
    for region, before, after in changes:
        for state in _entered_states(region, before, after):
            events[Raised(region.name, region.name, state)] = None
        for owner in _done(region, before, after):
            events[Raised(region.name, owner, DONE)] = None
    return tuple(events)


def _causes(region: Region, jump: Jump, before: str, after: str) -> tuple[str, ...]:
    if region.name == jump.region and jump.cause != region.impact_cause:
        return tuple(jump.cause.split("+"))  # combined transitions, see `FlatTransition`
    struck = region.name in jump.impulse
    if before == after and not struck:
        return ()
    edges = (edge for edge in region.edges if (edge.source, edge.target) == (before, after))
    causes = [edge.cause for edge in edges if not edge.alone or edge.cause == jump.cause]
    hit = (region.impact_cause,) if struck and region.impact_cause in causes else ()
    other_causes = [cause for cause in causes if cause != region.impact_cause]
    return (*hit, jump.cause) if jump.cause in other_causes else (*hit, *other_causes[:1])


def _entered_states(region: Region, before: str, after: str) -> list[str]:
    """Return the states entered, outer first."""
    if before == after:
        return []
    entered = {*region.active(after)}.difference(region.active(before))
    ordered = region.nesting.names or reversed(region.active(after))
    return [name for name in ordered if name in entered]


def _done(region: Region, before: str, after: str) -> Sequence[str]:
    done = region.nesting.done
    return [name for name in done.get(after, ()) if name not in done.get(before, ())]
