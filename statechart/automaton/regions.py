"""Regions of an automaton: states and edges, margins, loads, nesting, events of jumps.

The executor knows flat edges, one for each state that is left. Drawn by a person, an edge that
leaves every state of a superstate (Harel 1987) leaves the superstate, and edges that enter all of
its states under one guard are one that enters it, with a choice.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

from statechart.formulas.relation import Relation, parse_relation

if TYPE_CHECKING:
    # Neither numpy nor sympy is loaded where a scene or a chart is declared.
    import sympy as sp

    from statechart.automaton.trace import Jump, Role
    from statechart.documents.outputs import Event
    from statechart.formulas.condition import Active, Condition
    from statechart.formulas.linear import Definition

MarginKind = Literal["plain", "gap", "speed", "force", "hold"]


@dataclass(frozen=True)
class Margin:
    """An expression that is >= 0 while a mode holds."""

    name: str  # For example ``tip.gap`` or ``tip.mu V - H``.
    expression: sp.Expr  # In variables, parameters, time and unknowns.
    # The kind of its tolerance. A `force` margin is an event once it is below minus its tolerance
    # (hysteresis, so that the mode just left is not entered again), a `hold` margin too, whose
    # force drops as the mode is left; the others are located at their zero.
    kind: MarginKind = "plain"
    # Name of the relation that it is one of several atoms of; "" where it stands alone.
    relation: str = ""
    # Margin of that relation; None also where the relation asks for states of regions.
    whole: sp.Expr | None = None

    def replaced(self, values: Mapping[sp.Symbol, sp.Expr]) -> Margin:
        """Return the margin with values in the place of symbols."""
        whole_margin = None if self.whole is None else self.whole.xreplace(values)
        return replace(self, expression=self.expression.xreplace(values), whole=whole_margin)


def whole_margins(margins: Iterable[Margin]) -> tuple[Margin, ...]:
    """Return the margins that are >= 0 while a mode holds: of several atoms that of the relation.

    An atom alone may be below 0 while its relation does not hold. Relations that ask for states
    of regions have no margin and are left out.
    """
    found = {
        margin.relation or margin.name: Margin(margin.relation, margin.whole)
        if margin.relation and margin.whole is not None
        else margin
        for margin in margins
        if not margin.relation or margin.whole is not None
    }
    return tuple(found.values())


def margins_of(
    name: str, relation: Relation, known: Mapping[str, sp.Expr]
) -> tuple[Condition, tuple[Margin, ...]]:
    """Return a relation over atoms, and their margins; each falls as its atom begins to hold."""
    condition = relation.condition(known)
    names = condition.names(name)
    if condition.single:
        return condition, (Margin(name, condition.atoms[0].expression),)
    whole = None if relation.members else relation.margin(known)
    return condition, tuple(
        Margin(one, atom.expression, relation=name, whole=whole)
        for one, atom in zip(names, condition.atoms, strict=True)
    )


@dataclass(frozen=True, eq=False)
class StopCondition:
    """A condition that ends a run."""

    name: str
    condition: Condition  # Its relation.
    margins: tuple[Margin, ...]  # Those of its atoms.


def stop_conditions(
    texts: Mapping[str, str], known: Mapping[str, sp.Expr]
) -> tuple[StopCondition, ...]:
    """Return stop conditions, in the names of what they may use."""
    return tuple(
        StopCondition(name, *margins_of(name, parse_relation(text), known))
        for name, text in texts.items()
    )


@dataclass(frozen=True, eq=False)
class Invariant:
    """A relation that a declaration asserts of a run, or of it as long as a state is active."""

    name: str
    text: str  # The relation.
    known: Mapping[str, sp.Expr]  # Name -> expression, of what it may use.

    @cached_property
    def relation(self) -> Relation:
        """The relation, read."""
        return parse_relation(self.text)

    @cached_property
    def _margins(self) -> dict[tuple[bool, ...], Margin]:
        return {}

    def margin(self, active: Active) -> Margin:
        """Return what is >= 0 while it holds in a mode: infinite where `in` alone decides."""
        members = self.relation.members
        key = tuple(active(member.region, member.state) for member in members)
        cached = self._margins.get(key)
        if cached is None:
            import sympy

            states = {
                (member.region, member.state): sympy.oo if one else -sympy.oo
                for member, one in zip(members, key, strict=True)
            }
            expression = -self.relation.margin(self.known, states)
            cached = self._margins[key] = Margin(self.name, expression)
        return cached


DONE = "done"
"""The event of a state that has reached its end."""
UNREACHED = "no transition leads there from the start"
"""The reason why no run is in a state of `Nesting.unreached`."""


@dataclass(frozen=True)
class Choice:
    """A state that an edge may lead to, and what is reset on the way."""

    target: str  # A state that holds no others.
    reset: str  # As of an `Edge`.


@dataclass(frozen=True)
class HierarchicalEdge:
    """Edges of a region that a person draws as one."""

    cause: str  # As of an `Edge`.
    # States or superstates. The edge leaves every state in `source`.
    source: str
    target: str
    guard: str  # As of an `Edge`.
    # States that it leads to: `target` itself, or one of the states in it, which the laws choose.
    choices: tuple[Choice, ...]
    on_zeno: bool = False  # As of an `Edge`.
    # Variable -> new value, of the values before.
    updates: Mapping[str, str | int | float] = field(default_factory=dict)
    events: tuple[str, ...] = ()  # Events of other regions that fire it.
    condition: str | None = None  # Relation that must hold at these events.
    static: bool = False  # It leaves no state.
    internal: bool = False  # It does not leave its source.

    @property
    def reset(self) -> str:
        """Reset that all its choices share; "" where it depends on the choice."""
        resets = {choice.reset for choice in self.choices}
        return resets.pop() if len(resets) == 1 else ""


class History(NamedTuple):
    """A target that stands for what was last active."""

    # It remembers states of `parent` alone, or those in them, too.
    depth: Literal["shallow", "deep"]
    parent: str  # The superstate that it remembers.
    # Its target as long as nothing is remembered: of one that remembers regions its parent.
    initial: str


@dataclass(frozen=True, eq=False)
class Nesting:
    """Declared states in states of a flattened region, beside its superstates."""

    names: tuple[str, ...] = ()  # States and superstates in the order of the document.
    # State of the region -> the innermost states that are active in it.
    configurations: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    # Superstate -> the state in it that it begins with; "" is the region.
    initial: Mapping[str, str] = field(default_factory=dict)
    # Superstates whose states are regions: all of them are active.
    parallel: frozenset[str] = frozenset()
    histories: Mapping[str, History] = field(default_factory=dict)  # Name -> history.
    # State -> updates when it is entered, or left.
    entries: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)
    exits: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)
    edges: tuple[HierarchicalEdge, ...] = ()  # As declared, of flat regions too.
    # States and superstates that no chain of transitions enters from the start.
    unreached: frozenset[str] = frozenset()
    # State -> rates of variables that it declares.
    flows: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)
    final: frozenset[str] = frozenset()  # States with which what holds them is done.
    # State of the region -> superstates that are done in it, inner ones first; also the region.
    done: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def active(self, state: str, superstates: Mapping[str, str]) -> tuple[str, ...]:
        """Return the states that are active with one of the region, and those that hold them."""
        states: dict[str, None] = {}
        for name in self.configurations.get(state, (state,)):
            states[name] = None
            while name in superstates:
                name = superstates[name]
                states[name] = None
        return tuple(states)


@dataclass(frozen=True)
class Claim:
    """Relations that all hold as long as a state is active, or of which one does not."""

    name: str  # Name of the guard, invariant or condition.
    relations: tuple[str, ...]  # As declared.
    holds: bool  # True: all of them hold. False: at least one does not.


@dataclass(frozen=True)
class Loads:
    """Unknowns that the motion leaves open: something carries them in the equations of motion.

    They are solved for when the motion is known, by equations of their own.
    """

    # Unknown of the automaton -> what stands for it in the equations of motion.
    carried: Mapping[sp.Symbol, sp.Expr]
    carriers: tuple[sp.Symbol, ...]  # The unknowns of that.
    # Unknown -> its equation (= 0), linear in what is carried and in further unknowns.
    laws: Mapping[sp.Symbol, sp.Expr]
    # Unknown, which states share -> what this one adds to a sum over them that is zero.
    balances: Mapping[sp.Symbol, sp.Expr]
    # Expression that the motion leaves open -> its value.
    known: Mapping[sp.Expr, sp.Expr] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Hold:
    """Positions that are held, and the equations that say so for accelerations."""

    places: tuple[sp.Expr, ...]  # Each = 0; their gradients are those of lengths.
    # As many, each = 0: together they say what the second derivatives of `places` do.
    equations: tuple[sp.Expr, ...]
    forces: tuple[sp.Symbol, ...]  # As many; in motions that keep the places they do no work.
    # Constant of a flow that is in `places` -> the expression of the variables that is constant.
    anchors: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)
    steep: bool = False  # Gradients of the places may grow without bound.


@dataclass(frozen=True)
class State:
    """Contribution of a region to a mode."""

    # Each = 0, linear in the automaton's unknowns and its carriers.
    equations: tuple[sp.Expr, ...] = ()
    margins: tuple[Margin, ...] = ()  # Margins whose fall is an event of the state.
    # Assertions of its declaration, for checks of a trace; runs do not evaluate them.
    invariants: tuple[Invariant, ...] = ()
    # Controls of the automaton that the state sets -> expressions without unknowns.
    values: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)
    # Its share where the motion of a mode leaves unknowns open.
    loads: Loads | None = None
    holds: tuple[Hold, ...] = ()  # Positions that its equations hold.


@dataclass(frozen=True)
class Edge:
    """A transition of a region, as text for people."""

    cause: str  # touchdown, liftoff, ... or the transition's name.
    # States of the region.
    source: str
    target: str
    # The trigger and the changes; "" where nothing is changed.
    guard: str
    reset: str = ""
    # True where no guard fires it but the accumulation of jumps out of `source`.
    on_zeno: bool = False


@dataclass(frozen=True, eq=False)
class Region:
    """An orthogonal region: its states, built when first asked for, and its edges."""

    name: str  # Name of the region (a contact, a controller).
    states: tuple[str, ...]  # Names of its states.
    build: Callable[[Role], State]  # Role -> State.
    edges: tuple[Edge, ...]  # The region's own statechart.
    # State or superstate -> the superstate that it is in; names differ, those outermost are no
    # keys.
    superstates: Mapping[str, str] = field(default_factory=dict)
    # Superstates that the declaration lists as states of their own: slide, which runs know by its
    # directions alone.
    listed: tuple[str, ...] = ()
    # Cause that its jumps have where it is struck, besides that of its change: impact; "" where
    # what strikes it changes it, as a contact.
    impact_cause: str = ""
    # Declared nesting of states.
    nesting: Nesting = field(default_factory=Nesting)
    # Unknowns that are zero for others while the region is captured (see `Role`).
    forces: tuple[sp.Symbol, ...] = ()
    # The state that goes without saying where a mode is named by its others: `free` of a contact;
    # "" where every state says something.
    default: str = ""
    # State -> the declared relations that tests compare with its runs.
    claims: Callable[[str], tuple[Claim, ...]] = lambda _: ()

    def declared(self, state: str) -> str:
        """Return the state as the declaration names it."""
        return next((name for name in self.active(state) if name in self.listed), state)

    def active(self, state: str) -> tuple[str, ...]:
        """Return the active states: a state itself and its superstates, inner first.

        Of a configuration of several, each of them with its superstates.
        """
        if state not in self._actives:
            self._actives[state] = self.nesting.active(state, self.superstates)
        return self._actives[state]

    @cached_property
    def _actives(self) -> dict[str, tuple[str, ...]]:
        return {}

    @property
    def innermost(self) -> tuple[str, ...]:
        """The states that hold no others, as declared; those that runs cannot enter come last."""
        configurations = self.nesting.configurations
        entered = (n for s in self.states for n in configurations.get(s, (s,)))
        return tuple(dict.fromkeys((*entered, *self.outside)))

    @property
    def outside(self) -> tuple[str, ...]:
        """The declared states that hold no others and are in none of `states`: none is entered."""
        holding = {*self.superstates.values()}
        unreached = self.nesting.unreached.difference(holding, self.states)
        return tuple(name for name in self.nesting.names if name in unreached)

    def within(self, name: str) -> tuple[str, ...]:
        """Return the states in which a state or superstate is active."""
        return tuple(state for state in self.states if name in self.active(state))


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode's equations, solved."""

    definitions: tuple[Definition, ...]  # Straight-line program for the controls and the unknowns.
    rates: tuple[sp.Expr, ...]  # d/dt of every variable.
    margins: tuple[Margin, ...]  # The mode's invariant, stop conditions last.
    # Forces as observers see them, where they differ from those that move the state.
    hidden: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)
    # Place of a variable that follows from the others -> expression of these, of parameters, time
    # and anchors. Its rate is that of the expression, and is integrated along with the others;
    # nothing else reads it but through `definitions`.
    eliminated: Mapping[int, sp.Expr] = field(default_factory=dict)
    # Constant of a flow -> the expression of the variables that is constant.
    anchors: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)


def active_in(regions: Sequence[Region], key: Sequence[str]) -> Active:
    """Return whether a region is in a state, or in one inside it, as `active(region, state)`."""
    states = {region.name: (region, state) for region, state in zip(regions, key, strict=True)}

    def active(region: str, state: str) -> bool:
        owner, current = states[region]
        return state in owner.active(current)

    return active


def hierarchical_edges(region: Region) -> tuple[HierarchicalEdge, ...]:
    """Return the edges of a region with as few arrows as its superstates allow.

    Edges out of all states of a superstate into one state are one; then those from one source, by
    one cause and guard, into all states of a superstate. `flat_edges` undoes it. Of a region that
    was declared with nested states they are those of its declaration.
    """
    if region.nesting.configurations:
        return region.nesting.edges
    superstates = _outermost_first(region)
    leaves = {name: region.within(name) for name in (*region.states, *superstates)}
    sources_by_edge: dict[tuple[str, str, str, str, bool], list[str]] = {}
    for e in region.edges:
        key = (e.cause, e.target, e.guard, e.reset, e.on_zeno)
        sources_by_edge.setdefault(key, []).append(e.source)
    fans: dict[tuple[str, str, str, bool], dict[str, str]] = {}
    for (cause, target, guard, reset, on_zeno), sources in sources_by_edge.items():
        for source in _covered(sources, superstates, leaves):
            fans.setdefault((cause, source, guard, on_zeno), {})[target] = reset
    return tuple(
        HierarchicalEdge(
            cause,
            source,
            target,
            guard,
            tuple(Choice(leaf, targets[leaf]) for leaf in leaves[target]),
            on_zeno,
        )
        for (cause, source, guard, on_zeno), targets in fans.items()
        for target in _covered(list(targets), superstates, leaves)
    )


def _outermost_first(region: Region) -> list[str]:
    superstates = dict.fromkeys(region.superstates.values())
    return sorted(superstates, key=lambda name: len(region.active(name)))


def _covered(
    states: Sequence[str], superstates: Sequence[str], leaves: Mapping[str, tuple[str, ...]]
) -> list[str]:
    """Return states, those that are all of a superstate as the superstate, where they are many."""
    remaining, covered = dict.fromkeys(states), dict[str, None]()
    for name in superstates:
        members = leaves[name]
        if len(members) > 1 and remaining.keys() >= set(members):
            covered[name] = None
            remaining = dict.fromkeys(state for state in remaining if state not in members)
    return [*covered, *remaining]


def happened(regions: Sequence[Region], jump: Jump, event: Event) -> bool:
    """Tell whether `jump` is `event`: a cause, a state that is entered, or one that is done.

    A jump names one region, but may change others at the same instant (an impact that is felt at
    every closed contact); their causes are those of the edges that they take. A region whose blows
    have a name of their own has that of its change besides: it is struck, and lifts off.
    """
    if event.region is None and jump.cause == event.cause:
        return True
    owner = event.region
    for region, before, after in zip(regions, jump.source, jump.target, strict=True):
        if event.cause == DONE and owner in _done(region, before, after):
            return True
        if owner is not None and region.name != owner:
            continue
        if event.cause in _causes(region, jump, before, after):
            return True
        if owner is not None and event.cause in _entered(region, before, after):
            return True
    return False


class Raised(NamedTuple):
    """An event that a jump makes, and its region; its `owner` is this, or a state that is done."""

    region: str
    owner: str
    cause: str

    def answers(self, event: Event, listener: str, own: Collection[str]) -> bool:
        """Tell whether it is what a region waits for, with states of its `own` that can be done."""
        if self.cause != event.cause or event.region not in (None, self.owner):
            return False
        return (self.region == listener) == (self.cause == DONE and event.region in own)


def raised(regions: Sequence[Region], jump: Jump) -> tuple[Raised, ...]:
    """Return the events of a jump in their order: causes, states entered from the outside, ends."""
    events: dict[Raised, None] = {}
    changes = list(zip(regions, jump.source, jump.target, strict=True))
    for region, before, after in changes:
        for cause in _causes(region, jump, before, after):
            events[Raised(region.name, region.name, cause)] = None
    for region, before, after in changes:
        for state in _entered(region, before, after):
            events[Raised(region.name, region.name, state)] = None
        for owner in _done(region, before, after):
            events[Raised(region.name, owner, DONE)] = None
    return tuple(events)


def _causes(region: Region, jump: Jump, before: str, after: str) -> tuple[str, ...]:
    if region.name == jump.region and jump.cause != region.impact_cause:
        return tuple(jump.cause.split("+"))  # Transitions taken together, see `FlatTransition`.
    struck = region.name in jump.impulse
    if before == after and not struck:
        return ()
    causes = [e.cause for e in region.edges if (e.source, e.target) == (before, after)]
    hit = (region.impact_cause,) if struck and region.impact_cause in causes else ()
    other_causes = [cause for cause in causes if cause != region.impact_cause]
    return (*hit, jump.cause) if jump.cause in other_causes else (*hit, *other_causes[:1])


def _entered(region: Region, before: str, after: str) -> list[str]:
    """Return the states entered, outer ones first."""
    if before == after:
        return []
    entered = {*region.active(after)}.difference(region.active(before))
    ordered = region.nesting.names or reversed(region.active(after))
    return [name for name in ordered if name in entered]


def _done(region: Region, before: str, after: str) -> Sequence[str]:
    done = region.nesting.done
    return [name for name in done.get(after, ()) if name not in done.get(before, ())]
