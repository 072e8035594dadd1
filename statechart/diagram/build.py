"""From an automaton, and the run it made, to a diagram."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import product

from statechart.automaton.automaton import Automaton
from statechart.automaton.feasibility import Feasibility
from statechart.automaton.regions import Edge, Margin, Region
from statechart.automaton.trace import Key, Trace
from statechart.diagram.model import Diagram, Link, Node

# Two contacts have nine modes as users count, and a product of more than this cannot be read.
_MOST_MODES = 16
# Of more regions alike than this not all are named.
_MOST_NAMES = 8
_NUMBER = re.compile(r"\d+(\.\d+)?")

_Ends = tuple[Key, Key, str]


def needs_run(automaton: Automaton) -> bool:
    """Return whether the product is too large to draw, so that only what a run visited is."""
    return len(automaton.regions) > 1 and automaton.modes_declared > _MOST_MODES


def build(
    automaton: Automaton,
    start: Key,
    trace: Trace | None = None,
    found: Feasibility | None = None,
) -> Diagram:
    """Return the diagram of an automaton.

    One region is drawn as its own chart. Several are drawn as their product, without the
    directions of sliding; where that has too many modes, what the run visited is drawn instead,
    and beside it the chart of every region.

    Parameters
    ----------
    automaton : Automaton
        What to draw.
    start : Key
        The mode that it starts in.
    trace : Trace, optional
        A run, whose path and counts are shown; needed where `needs_run`.
    found : Feasibility, optional
        Which modes are possible where the run starts; the others are marked, with the reason.
    """
    if len(automaton.regions) == 1:
        return _chart(automaton, start, trace, found)
    if not needs_run(automaton):
        return _product(automaton, start, trace, found)
    if trace is None:
        raise ValueError("a product of so many modes is drawn as a run visited it")
    return _visited(automaton, trace)


def _chart(
    automaton: Automaton, start: Key, trace: Trace | None, found: Feasibility | None
) -> Diagram:
    """Draw the only region, directions of sliding told apart."""
    region = automaton.regions[0]
    run = None if trace is None else _Run(trace)
    links = [_link((e.source,), (e.target,), [e], "", run) for e in region.edges]
    refused = _refused({} if found is None else found.modes, run)
    return Diagram(
        automaton.name,
        tuple(
            _state(automaton, region, state, (state,) == start, run, refused.get((state,)))
            for state in region.states
        ),
        tuple(links) + _unlisted(run),
        _notes(automaton, refused),
        () if run is None else tuple(map(_name, run.path)),
    )


def _product(
    automaton: Automaton, start: Key, trace: Trace | None, found: Feasibility | None
) -> Diagram:
    """Draw all modes, sliding without direction."""
    run = None if trace is None else _Run(trace, automaton)
    declared = [
        tuple(dict.fromkeys(region.declared(state) for state in region.states))
        for region in automaton.regions
    ]
    initial = _declared(automaton, start)
    refused = _refused({} if found is None else found.declared, run)
    nodes = tuple(
        Node(
            _name(key),
            "\n".join(f"{r.name}: {s}" for r, s in zip(automaton.regions, key, strict=True)),
            initial=key == initial,
            visits=None if run is None else run.entries[key],
            infeasible=refused.get(key),
        )
        for key in product(*declared)
    )
    links: list[Link] = []
    for key in product(*declared):
        for place, region in enumerate(automaton.regions):
            for (target, _), edges in _merged(region, key[place]).items():
                after = (*key[:place], target, *key[place + 1 :])
                links.append(_link(key, after, edges, region.name, run))
    return Diagram(
        automaton.name,
        nodes,
        tuple(links) + _unlisted(run),
        _notes(automaton, refused),
        () if run is None else tuple(map(_name, run.path)),
    )


def _visited(automaton: Automaton, trace: Trace) -> Diagram:
    """Draw the modes that a run visited, and the chart of every region, those alike once."""
    run = _Run(trace)
    changing = {
        region.name
        for region, states in zip(automaton.regions, zip(*run.entries, strict=True), strict=True)
        if len(set(states)) > 1
    } or {region.name for region in automaton.regions}
    nodes = [
        Node(
            _name(key),
            "\n".join(
                f"{r.name}: {s}"
                for r, s in zip(automaton.regions, key, strict=True)
                if r.name in changing
            ),
            group="modes of the run",
            initial=key == trace.start_mode,
            visits=run.entries[key],
        )
        for key in dict.fromkeys(run.path)
    ]
    resting: dict[str, list[str]] = {}
    for region, state in zip(automaton.regions, trace.start_mode, strict=True):
        if region.name not in changing:
            resting.setdefault(state, []).append(region.name)
    links = list(_unlisted(run))
    for regions in _alike(automaton.regions):
        region = regions[0]
        group = ", ".join(_cut([r.name for r in regions]))
        if any(other.edges != region.edges for other in regions):
            group += f"; numbers of {region.name}"
        nodes += [Node(f"{region.name}:{s}", s, group=group) for s in region.states]
        links += [
            Link(
                f"{region.name}:{edge.source}", f"{region.name}:{edge.target}",
                edge.cause, edge.guard, edge.reset,
            )
            for edge in region.edges
        ]  # fmt: skip
    notes = [
        *_notes(automaton),
        "too many modes to draw: those that a run visited, and the chart of every region",
        *(f"always {state}: {', '.join(_cut(names))}" for state, names in resting.items()),
    ]
    return Diagram(
        automaton.name, tuple(nodes), tuple(links), tuple(notes), tuple(map(_name, run.path))
    )


def _alike(regions: Iterable[Region]) -> Iterable[list[Region]]:
    """Return regions together whose charts are the same but for numbers."""
    found: dict[tuple[tuple[str, ...], tuple[tuple[str, ...], ...]], list[Region]] = {}
    for region in regions:
        edges = (
            (e.cause, e.source, e.target, _NUMBER.sub("#", e.guard), _NUMBER.sub("#", e.reset))
            for e in region.edges
        )
        found.setdefault((region.states, tuple(edges)), []).append(region)
    return found.values()


def _cut(names: list[str]) -> list[str]:
    """Return names for a line of text: of many the first ones, and how many there are."""
    if len(names) <= _MOST_NAMES:
        return names
    return [*names[:3], f"... {names[-1]} ({len(names)} in all)"]


class _Run:
    """What a run did: modes entered, edges taken; without directions if an automaton is given."""

    def __init__(self, trace: Trace, automaton: Automaton | None = None) -> None:
        def shown(key: Key) -> Key:
            return key if automaton is None else _declared(automaton, key)

        path: list[Key] = [shown(trace.start_mode)]
        self.taken: Counter[_Ends] = Counter()
        self.regions: dict[_Ends, str] = {}
        self.linked: set[_Ends] = set()
        for jump in trace.jumps:
            if not jump.region:
                continue  # a stop condition, which ends the run and leads nowhere
            source, target = shown(jump.source), shown(jump.target)
            self.taken[source, target, jump.cause] += 1
            self.regions.setdefault((source, target, jump.cause), jump.region)
            if target != path[-1]:
                path.append(target)
        self.path = tuple(path)
        self.entries = Counter(path)


def _link(source: Key, target: Key, edges: Iterable[Edge], region: str, run: _Run | None) -> Link:
    """Return one link for edges that differ in their guards alone."""
    edges = tuple(edges)
    cause = edges[0].cause
    visits = None
    if run is not None:
        visits = run.taken[source, target, cause]
        run.linked.add((source, target, cause))
    return Link(
        _name(source),
        _name(target),
        f"{region} {cause}".strip(),
        " or ".join(dict.fromkeys(edge.guard for edge in edges)),
        " or ".join(dict.fromkeys(edge.reset for edge in edges if edge.reset)),
        visits,
    )


def _unlisted(run: _Run | None) -> tuple[Link, ...]:
    """Return links for jumps not drawn yet, such as those of several regions at once."""
    if run is None:
        return ()
    return tuple(
        Link(_name(ends[0]), _name(ends[1]), f"{run.regions[ends]} {ends[2]}", "", "", count)
        for ends, count in run.taken.items()
        if ends not in run.linked
    )


def _merged(region: Region, source: str) -> Mapping[tuple[str, str], list[Edge]]:
    """Return the edges out of a declared state by where they lead and why."""
    found: dict[tuple[str, str], list[Edge]] = {}
    for edge in region.edges:
        if region.declared(edge.source) == source:
            found.setdefault((region.declared(edge.target), edge.cause), []).append(edge)
    return found


def _declared(automaton: Automaton, key: Key) -> Key:
    return tuple(r.declared(state) for r, state in zip(automaton.regions, key, strict=True))


def _sense(automaton: Automaton, margin: Margin) -> str:
    """Return the sign of what the margin is named after, where that is its negative."""
    named = automaton.observables.get(margin.name)
    return "<=" if named is not None and margin.expression == -named else ">="


def _state(
    automaton: Automaton,
    region: Region,
    state: str,
    initial: bool,
    run: _Run | None,
    infeasible: str | None,
) -> Node:
    declared = region.declared(state)
    built = region.build(state)
    prefix = f"{region.name}."
    # A plain margin is the guard of a transition, which stands on its edge.
    conditions = [
        f"{m.name.removeprefix(prefix)} {_sense(automaton, m)} 0"
        for m in built.margins
        if m.kind != "plain"
    ]
    conditions += [m.name.removeprefix(prefix) for m in built.invariants]
    return Node(
        _name((state,)),
        state,
        group=declared if declared != state else None,
        invariants=tuple(conditions),
        initial=initial,
        visits=None if run is None else run.entries[(state,)],
        infeasible=infeasible,
    )


def _refused(verdicts: Mapping[Key, str], run: _Run | None) -> dict[Key, str]:
    """Return the modes that are not possible; what a run visited became possible on its way."""
    visited = set() if run is None else set(run.entries)
    return {key: why for key, why in verdicts.items() if why and key not in visited}


def _notes(automaton: Automaton, refused: Mapping[Key, str] | None = None) -> tuple[str, ...]:
    notes = [automaton.declaration.doc] if automaton.declaration.doc else []
    if automaton.stops:
        notes.append(f"stops when: {', '.join(automaton.stops)}")
    if refused:
        notes.append("infeasible: no velocity agrees with the mode where the run starts")
    return tuple(notes)


def _name(key: Key) -> str:
    return " ".join(key)
