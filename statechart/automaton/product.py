"""Product automaton of the regions, explored on demand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, islice, product
from math import prod
from typing import TYPE_CHECKING, Any

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import MAX_MODES, Feasibility, Setup
from statechart.automaton.regions import UNREACHED, Edge, Region
from statechart.automaton.trace import Key, Trace
from statechart.errors import StatechartError

if TYPE_CHECKING:
    import networkx as nx

_Jump = tuple[Key, Key, str, str]  # source, target, region, event


@dataclass(frozen=True)
class Product:
    """Modes of an automaton and the edges between them."""

    name: str
    modes: dict[Key, dict[str, Any]]  # mode -> attributes of the node of `graph`
    charts: tuple[Region, ...]
    taken: Counter[_Jump] | None  # number of times that a run took each edge

    def edges(self) -> Iterator[tuple[Key, Key, dict[str, Any]]]:
        """Yield source, target and attributes of every edge, sorted by source and target."""
        edges: dict[Key, dict[Key, list[dict[str, Any]]]] = {key: {} for key in self.modes}
        for source, target, data in _edges(self.charts, self.modes, self.taken):
            edges[source].setdefault(target, []).append(data)
        for source, targets in edges.items():
            for target, several in targets.items():
                yield from ((source, target, data) for data in several)

    def graph(self) -> nx.MultiDiGraph:
        """Return the networkx graph."""
        import networkx as nx  # slow import

        result = nx.MultiDiGraph(name=self.name)
        result.add_nodes_from(self.modes.items())
        edges = _edges(self.charts, self.modes, self.taken)
        for number, (source, target, data) in enumerate(edges):
            result.add_edge(source, target, number, **data)
        return result


def explore(
    automaton: Automaton,
    *,
    around: Iterable[Key] = (),
    within: int | None = None,
    trace: Trace | None = None,
    found: Feasibility | None = None,
    directions: bool = True,
    unreached: bool = False,
) -> Product:
    """Return the product automaton, or a part of it.

    Regions are orthogonal: an edge changes one of them. A simultaneous jump of several is an edge
    without guard. The part has the modes up to `within` edges from those `around`, by default the
    modes of the trace; without `within` all. Visits of `trace` are counted. `directions` of sliding
    are separate modes. With `unreached`, unreachable declared states are infeasible modes. Raises
    `StatechartError` for more than `MAX_MODES` modes, or modes of another automaton.
    """
    charts = tuple(
        drawn_region(region, directions=directions, unreached=unreached)
        for region in automaton.regions
    )
    path = () if trace is None else visited_modes(automaton, trace, directions=directions)
    begin = list(map(_key_names(automaton, directions), around)) or path
    keys = _all_modes(charts) if within is None else _neighbours(charts, begin, within)
    reasons = {} if found is None else found.modes if directions else found.declared
    entries = Counter(path)
    modes: dict[Key, dict[str, Any]] = {}
    for key in keys:
        modes[key] = {"label": automaton.label(key)}
        pairs = zip(charts, key, strict=False) if unreached else ()
        entered = all(r.nesting.unreached.isdisjoint(r.active(state)) for r, state in pairs)
        if key in reasons or not entered:
            reason = reasons.get(key, "") if entered else UNREACHED
            modes[key] |= {"feasible": not reason, "reason": reason}
        if trace is not None:
            modes[key]["visits"] = entries[key]
    taken = None if trace is None else Counter(_jumps(automaton, trace, directions=directions))
    return Product(automaton.name, modes, charts, taken)


def visited_modes(
    automaton: Automaton, trace: Trace, *, directions: bool = True
) -> tuple[Key, ...]:
    """Return the modes of a product in the order of a run, repeats merged."""
    shown = map(_key_names(automaton, directions), trace.modes)
    return tuple(key for key, _ in groupby(shown))


def _jumps(automaton: Automaton, trace: Trace, *, directions: bool = True) -> Iterator[_Jump]:
    """Yield source, target, region and event of every jump except stops."""
    shown = _key_names(automaton, directions)
    for jump in trace.jumps:
        if jump.region:
            yield shown(jump.source), shown(jump.target), jump.region, jump.cause


def feasibility(
    automaton: Automaton, setup: Setup, state: Array, time: float
) -> Feasibility | None:
    """Return the feasibility of every product mode; raise `StatechartError` if undecidable."""
    if automaton.laws is None or automaton.modes_total > MAX_MODES:
        return None
    return automaton.laws.feasibility(automaton.regions, setup, state, time)


def _key_names(automaton: Automaton, directions: bool) -> Callable[[Key], Key]:
    """Return a function from a mode of the automaton to the mode of the product."""
    names: list[dict[str, str]] = []
    for region in automaton.regions:
        declared = {state: region.declared(state) for state in region.states}
        states = region.states if directions else declared.values()
        names.append({**({} if directions else declared), **{state: state for state in states}})

    def shown(key: Key) -> Key:
        try:
            return tuple(named[state] for named, state in zip(names, key, strict=True))
        except (KeyError, ValueError):
            wanted = f"a mode is a tuple, a state of {', '.join(automaton.region_names)}"
            message = f"{automaton.name!r} has no mode {key!r}: {wanted}"
            raise StatechartError(message) from None

    return shown


def drawn_region(region: Region, *, directions: bool, unreached: bool = False) -> Region:
    """Return a region with edges merged that differ in their guards only.

    With `unreached` it has the unreachable declared states too.
    """
    named = (lambda state: state) if directions else region.declared
    alike: dict[tuple[str, str, str], list[Edge]] = {}
    for edge in region.edges:
        alike.setdefault((edge.cause, named(edge.source), named(edge.target)), []).append(edge)
    edges = []
    for ends, several in alike.items():
        guards = dict.fromkeys(edge.guard for edge in several)
        resets = dict.fromkeys(edge.reset for edge in several if edge.reset)
        edges.append(Edge(*ends, " or ".join(guards), " or ".join(resets)))
    outside = region.outside if unreached else ()
    edges += [edge for state in outside for edge in _declared_edges(region, state)]
    states = dict.fromkeys((*map(named, region.states), *outside))
    return replace(region, states=tuple(states), edges=tuple(edges))


def _declared_edges(region: Region, state: str) -> Iterator[Edge]:
    """Yield the declared edges out of an unreachable state."""
    nesting, active = region.nesting, region.active(state)
    for edge in nesting.edges:
        if edge.source in active and not edge.static:
            target = edge.target
            while target in nesting.initial or target in nesting.histories:
                history = nesting.histories.get(target)
                target = nesting.initial[target] if history is None else history.initial
            yield Edge(edge.cause, state, target, edge.guard, edge.reset)


def _all_modes(charts: Sequence[Region]) -> Iterable[Key]:
    total = prod(len(chart.states) for chart in charts)
    if total > MAX_MODES:
        raise _too_many(f"{total} modes")
    return product(*(chart.states for chart in charts))


def _neighbours(charts: Sequence[Region], around: Iterable[Key], within: int) -> Iterable[Key]:
    """Return the modes up to `within` edges away, the nearest first."""
    found = dict.fromkeys(around)
    front = tuple(found)
    for _ in range(within):
        known = len(found)
        for key in front:
            for place, chart in enumerate(charts):
                targets = (edge.target for edge in chart.edges if edge.source == key[place])
                found.update((_replace_state(key, place, target), None) for target in targets)
            if len(found) > MAX_MODES:
                raise _too_many(f"more than {MAX_MODES} modes so near")
        front = tuple(islice(found, known, None))
    return found


def _replace_state(key: Key, place: int, state: str) -> Key:
    return (*key[:place], state, *key[place + 1 :])


def _edges(
    charts: Sequence[Region], keys: Collection[Key], taken: Counter[_Jump] | None
) -> Iterator[tuple[Key, Key, dict[str, Any]]]:
    """Yield source, target and attributes of every edge between modes."""
    left = Counter(taken)
    for place, chart in enumerate(charts):
        for edge in chart.edges:
            labels = _attributes(chart.name, edge.cause, edge.guard, edge.reset)
            for source in keys:
                if source[place] != edge.source:
                    continue
                target = _replace_state(source, place, edge.target)
                if target in keys:
                    visits = left.pop((source, target, chart.name, edge.cause), 0)
                    yield source, target, labels if taken is None else {**labels, "visits": visits}
    for (source, target, name, event), visits in left.items():
        if source in keys and target in keys:
            yield source, target, {**_attributes(name, event, "", ""), "visits": visits}


def _attributes(region: str, event: str, guard: str, reset: str) -> dict[str, Any]:
    return {"region": region, "event": event, "guard": guard, "reset": reset}


def _too_many(found: str) -> StatechartError:
    return StatechartError(
        f"{found}, and a graph has at most {MAX_MODES}: ask for those within fewer jumps of a "
        "mode, or for those that a run visited"
    )
