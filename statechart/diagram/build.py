"""Construction of the diagram of an automaton, or of a run."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import Feasibility
from statechart.automaton.product import Product, drawn_region, explore
from statechart.automaton.product import visited_modes as modes_on_path
from statechart.automaton.regions import (
    UNREACHED,
    HierarchicalEdge,
    Margin,
    Region,
    hierarchical_edges,
    replace_complete_sets,
    updates_text,
)
from statechart.automaton.trace import Key, Role, Trace
from statechart.diagram.layout.ring import MAX_STEPS
from statechart.diagram.model import Chart, Diagram, Link, Node
from statechart.tabular import pluralise

_MAX_CELLS = 16  # of a grid: two contacts with mode `off`
_MAX_VISITED = 12  # modes of a run; of a longer run the first ones are drawn
_MAX_NAMED = 2  # regions on an arrow


def needs_run(automaton: Automaton) -> bool:
    """Return whether the product is too large to draw, so that a run selects its modes."""
    moving = _changing_regions(automaton)
    return len(moving) > 2 or (len(moving) == 2 and automaton.modes_declared > _MAX_CELLS)


def build(
    automaton: Automaton,
    start: Key,
    trace: Trace | None = None,
    found: Feasibility | None = None,
    *,
    visited: bool = False,
) -> Diagram:
    """Return the diagram of an automaton.

    One region is drawn as its chart, two as the grid of their product without directions of
    sliding, or as their charts if these have regions or histories. For more regions the modes that
    a run visited are drawn, and the chart of every region. `start` is the initial mode. A `trace`
    is required if `needs_run`; otherwise it replaces the product by the visited modes. Modes that
    `found` calls infeasible are marked with the reason. `visited`: omit the charts of the regions.
    """
    moving = _changing_regions(automaton)
    if trace is not None:
        modes = explore(automaton, within=0, trace=trace, found=found)
        run, notes = _run(automaton, trace, modes)
        charts = _charts(automaton, trace.start_mode)
        shown = (run,) if visited else (run, *charts)
        return Diagram(automaton.name, shown, notes, modes.graph, explained=charts)
    if needs_run(automaton):
        raise ValueError("a product of so many modes is drawn as a run visited it")
    notes = _remarks(automaton)
    if not moving:
        notes = (*notes, "one mode: no contacts, no regions")
    if len(moving) < 2 or any(map(_is_composed, moving)):
        modes = explore(automaton, found=found, unreached=True)
        charts = _charts(automaton, start)
        if len(automaton.regions) == 1:
            reasons = {key[0]: data.get("reason") for key, data in modes.modes.items()}
            charts = tuple(_mark_infeasible(chart, reasons) for chart in charts)
        return Diagram(automaton.name, charts, notes, modes.graph)
    modes = explore(automaton, found=found, directions=False, unreached=True)
    total = f"{automaton.modes_total} with the directions of sliding"
    if automaton.modes_total != automaton.modes_declared:
        notes = (*notes, f"{pluralise(automaton.modes_declared, 'mode')}, {total}")
    return Diagram(automaton.name, (_grid(automaton, start, modes),), notes, modes.graph)


def _changing_regions(automaton: Automaton) -> list[Region]:
    """Return the regions with several states or transitions; all if there is none."""
    changing = [r for r in automaton.regions if len({*r.states, *r.innermost}) > 1 or r.edges]
    return changing or list(automaton.regions)


def _is_composed(region: Region) -> bool:
    """Return whether a region does not fit in a grid.

    A grid has no place for parallel states, histories, and declared frames around a single state.
    """
    leaves = region.innermost
    around = Counter(name for leaf in leaves for name in region.active(leaf)[1:])
    lone = any(around[name] == 1 for name in region.nesting.names)
    return bool(region.nesting.histories) or lone or not {*region.states} <= {*leaves}


def _charts(automaton: Automaton, mode: Key | None) -> tuple[Chart, ...]:
    """Return the distinct charts of the regions, with initial states of `mode`."""
    charts = []
    states = dict(zip((r.name for r in automaton.regions), mode or (), strict=False))
    moving = _changing_regions(automaton)
    for regions in group_alike(moving):
        region = regions[0]
        title = ", ".join(abbreviate([r.name for r in regions]))
        if any(other.edges != region.edges for other in regions):
            title += f"; numbers of {region.name}"
        prefix = "" if len(moving) == 1 else f"{region.name}:"
        starts: dict[str | None, list[str]] = {}
        for each in regions:
            starts.setdefault(states.get(each.name), []).append(each.name)
        start = None if len(starts) > 1 else next(iter(starts))
        chart = region_chart(automaton, region, prefix=prefix, title=title, start=start)
        charts.append(_with_start_names(chart, prefix, starts) if len(starts) > 1 else chart)
    return tuple(charts)


def _with_start_names(chart: Chart, prefix: str, starts: Mapping[str | None, list[str]]) -> Chart:
    """Return a chart of regions with the names of those that start in a state beside it."""
    names = {f"{prefix}{state}": ", ".join(abbreviate(own)) for state, own in starts.items()}
    nodes = (replace(n, initial=False, starting=names.get(n.name, "")) for n in chart.nodes)
    return replace(chart, nodes=tuple(nodes))


def active_states(automaton: Automaton) -> Callable[[Key], tuple[str, ...]]:
    """Return a function from a mode to the active nodes of the charts of the regions."""
    moving = _changing_regions(automaton)
    owners = {
        region.name: "" if len(moving) == 1 else f"{regions[0].name}:"
        for regions in group_alike(moving)
        for region in regions
    }
    nesting = {region.name: region.nesting.configurations for region in moving}

    def active(key: Key) -> tuple[str, ...]:
        states = dict(zip(automaton.region_names, key, strict=True))
        found: dict[str, None] = {}
        for name, prefix in owners.items():
            for state in nesting[name].get(states[name], (states[name],)):
                found[prefix + state] = None
        return tuple(found)

    return active


def _mark_infeasible(chart: Chart, reasons: Mapping[str, str | None]) -> Chart:
    nodes = (replace(n, infeasible=reasons.get(n.name) or n.infeasible) for n in chart.nodes)
    return replace(chart, nodes=tuple(nodes))


def _grid(automaton: Automaton, start: Key, modes: Product) -> Chart:
    """Return the product of the two regions with several states."""
    regions = automaton.regions
    initial = tuple(r.declared(state) for r, state in zip(regions, start, strict=True))
    moving = {region.name for region in _changing_regions(automaton)}
    shown = [k for k, region in enumerate(regions) if region.name in moving]
    colours = [automaton.colours[region.name] for region in regions]
    nodes, links = [], []
    for key, data in modes.modes.items():
        label = "\n".join(f"{regions[k].name} {key[k]}" for k in shown)
        own, reason = tuple(colours[k][key[k]] for k in shown), data.get("reason") or None
        begins = key == initial
        nodes.append(Node(_name(key), label, initial=begins, infeasible=reason, colours=own))
    for source, target, data in modes.edges():
        words = data["event"], data["guard"], data["reset"]
        links.append(Link(_name(source), _name(target), *words, region=data["region"]))
    first, second = (_axis(automaton, regions[k], initial[k]) for k in shown)
    return Chart(tuple(nodes), tuple(links), axes=(first, second))


def _axis(automaton: Automaton, region: Region, start: str) -> Chart:
    """Return the chart of a region for a grid, with labelled frames.

    A link to a frame around its source is replaced by links to the other states in it.
    """
    plain = drawn_region(region, directions=False, unreached=True)
    name = region.name
    chart = region_chart(automaton, plain, prefix=f"{name}:", start=start, title=name)
    leaves = [node.name for node in chart.leaves]
    nodes = (
        node if node.name in leaves else replace(node, label=f"{name} {node.label}")
        for node in chart.nodes
    )
    links: list[Link] = []
    for link in chart.links:
        target = chart.entered(link.target)
        if target in chart.around(link.source):
            inner = (leaf for leaf in leaves if target in chart.around(leaf))
            links += [replace(link, target=leaf) for leaf in inner if leaf != link.source]
        else:
            links.append(replace(link, target=target))
    return replace(chart, nodes=tuple(nodes), links=tuple(links))


def _run(automaton: Automaton, trace: Trace, modes: Product) -> tuple[Chart, tuple[str, ...]]:
    """Return the chart of the modes that a run visited, and notes."""
    if trace.step is None:
        path = modes_on_path(automaton, trace)
        links = _run_links(automaton, modes)
    else:
        path, links = _stepped_links(automaton, trace)
    drawn_path = path if len(set(path)) <= _MAX_VISITED else path[:MAX_STEPS]
    shown = list(dict.fromkeys(drawn_path))
    visits = Counter(path)
    regions = list(zip(automaton.regions, zip(*visits, strict=True), strict=True))
    changing = [k for k, (_, states) in enumerate(regions) if len(set(states)) > 1]
    changing = changing or [k for k, (r, _) in enumerate(regions) if len(r.states) > 1]
    changing = changing or list(range(len(regions)))
    nodes = []
    for key in shown:
        label, lines = mode_label([(automaton.regions[k], key[k]) for k in changing])
        colours = tuple(automaton.colours[region.name][state] for region, state in lines)
        initial = key == path[0]
        nodes.append(Node(_name(key), label, initial=initial, visits=visits[key], colours=colours))
    notes = list(_remarks(automaton))
    if len(drawn_path) < len(path):
        notes.append(
            f"the first {len(drawn_path)} of {pluralise(len(path), 'visit')} to "
            f"{pluralise(len(visits), 'mode')} are drawn"
        )
    resting: dict[str, list[str]] = {}
    for k, (region, states) in enumerate(regions):
        if k not in changing and len(region.states) > 1:
            resting.setdefault(states[0], []).append(region.name)
    notes += [f"always {state}: {', '.join(abbreviate(names))}" for state, names in resting.items()]
    drawn = {_name(key) for key in shown}
    seen = tuple(link for link in links if {link.source, link.target} <= drawn)
    chart = Chart(tuple(nodes), seen, "modes of the run", tuple(map(_name, drawn_path)))
    return chart, tuple(notes)


def _stepped_links(automaton: Automaton, trace: Trace) -> tuple[tuple[Key, ...], list[Link]]:
    """Return the modes after time steps, and the links between them.

    Jumps of one step are simultaneous, and merged into one link.
    """
    path = [trace.start_mode]
    counts: dict[tuple[Key, Key], Counter[str]] = {}
    whose: dict[tuple[Key, Key, str], dict[str, None]] = {}
    for _, jumps in groupby(trace.jumps, key=lambda jump: jump.t):
        together = [jump for jump in jumps if jump.region]
        if not together or together[-1].target == path[-1]:
            continue
        ends = path[-1], together[-1].target
        path.append(ends[1])
        counts.setdefault(ends, Counter()).update(
            dict.fromkeys([jump.cause for jump in together], 1)
        )
        for jump in together:
            whose.setdefault((*ends, jump.cause), {})[jump.region] = None
    single = len(_changing_regions(automaton)) == 1
    links = []
    for (source, target), causes in counts.items():
        for cause, count in causes.items():
            regions = "" if single else _several([*whose[source, target, cause]])
            links.append(Link(_name(source), _name(target), cause, "", "", count, regions))
    return tuple(path), links


def _several(names: Sequence[str]) -> str:
    """Return names for an arrow, at most _MAX_NAMED."""
    if len(names) <= _MAX_NAMED:
        return " and ".join(names)
    return f"{names[0]} and {len(names) - 1} more"


def _run_links(automaton: Automaton, modes: Product) -> list[Link]:
    """Return the jumps of a run as links, merged if they differ in their regions only."""
    made: dict[tuple[Key, Key, str, str, str], Counter[str]] = {}
    for source, target, data in modes.edges():
        if data["visits"]:
            alike = source, target, data["event"], data["guard"], data["reset"]
            made.setdefault(alike, Counter())[data["region"]] += data["visits"]
    single = len(_changing_regions(automaton)) == 1
    links = []
    for (source, target, event, guard, reset), counts in made.items():
        regions, visits = "" if single else ", ".join(abbreviate([*counts])), counts.total()
        links.append(Link(_name(source), _name(target), event, guard, reset, visits, regions))
    return links


def _remarks(automaton: Automaton) -> tuple[str, ...]:
    notes = [automaton.declaration.doc] if automaton.declaration.doc else []
    if automaton.stops:
        notes.append(f"stops when: {', '.join(stop.name for stop in automaton.stops)}")
    moving = _changing_regions(automaton)
    for region in automaton.regions:
        if region.nesting.names and region not in moving:
            (state,) = region.innermost
            notes.append(f"always {' in '.join(region.active(state))}: {region.name}")
    return tuple(notes)


def _name(key: Iterable[str]) -> str:
    return " ".join(key)


# Names of regions in a list; lines of the name of a mode.
_MAX_NAMES, _MAX_LINES = 8, 4
_LITERAL = re.compile(r"\d+(\.\d+)?")


def region_chart(
    automaton: Automaton,
    region: Region,
    *,
    prefix: str = "",
    title: str = "",
    start: str | None = None,
) -> Chart:
    """Return the chart of a region with arrows merged over superstates.

    `prefix` precedes the names of its nodes; `start` is the initial state.
    """
    nesting = region.nesting
    leaves = region.innermost
    edges = hierarchical_edges(region)
    linked = {end for edge in edges for end in (edge.source, edge.target)}
    inner = {n: [s for s in leaves if n in region.active(s)[1:]] for n in region.frames}
    # No frame around a single direction of sliding.
    frames = {
        name
        for name, held in inner.items()
        if name not in leaves and (nesting.names or len(held) > 1 or name in linked - {*held})
    }
    colours = automaton.colours[region.name]
    begins = {*nesting.initial.values()}
    first = nesting.configurations.get(start or "", (start,))[0]
    initial = nesting.initial.get("")
    if initial is None or first not in region.entered_with(initial):
        initial = first

    def node(name: str) -> Node:
        inside = next((outer for outer in region.active(name)[1:] if outer in frames), None)
        leaf = name not in frames
        outer = None if inside is None else prefix + inside
        conditions = _conditions(automaton, region, name) if leaf else ()
        return Node(
            prefix + name, name, outer, conditions,
            initial=name == initial,
            infeasible=UNREACHED if name in nesting.unreached else None,
            colours=(colours[name],) if leaf else (),
            default=name in begins and name != nesting.initial[""],
            parallel=name in nesting.parallel,
            actions=_actions(region, name),
            final=name in nesting.final,
        )  # fmt: skip

    def history(name: str) -> Node:
        declared = nesting.histories[name]
        inside = prefix + declared.parent if declared.parent in frames else None
        refused = UNREACHED if declared.parent in nesting.unreached else None
        label = "H*" if declared.depth == "deep" else "H"
        return Node(prefix + name, label, inside, infeasible=refused, history=True)

    # Enclosing states come before a state, outer first.
    names = (n for s in leaves for n in reversed(region.active(s)) if n == s or n in frames)
    links = []
    for e in edges:
        words = e.cause, e.guard, _reset(region, e)
        links.append(Link(prefix + e.source, prefix + e.target, *words, internal=e.internal))
    nodes = (*map(node, dict.fromkeys(names)), *map(history, nesting.histories))
    return Chart(nodes, tuple(links), title)


def group_alike(regions: Iterable[Region]) -> Iterable[list[Region]]:
    """Return groups of regions whose charts differ in numbers only."""
    found: dict[tuple[tuple[str, ...], tuple[tuple[str, ...], ...]], list[Region]] = {}
    for region in regions:
        edges = (
            (e.cause, e.source, e.target, _LITERAL.sub("#", e.guard), _LITERAL.sub("#", e.reset))
            for e in region.edges
        )
        found.setdefault((region.innermost, tuple(edges)), []).append(region)
    return found.values()


def mode_label(states: Sequence[tuple[Region, str]]) -> tuple[str, tuple[tuple[Region, str], ...]]:
    """Return the name of a mode by its non-default states, and the state of every line."""
    shown = [(region, state) for region, state in states if state != region.default]
    if not shown:
        default = states[0][0].default
        return f"all {default}" if len(states) > 1 else default, (states[0],)
    if len(states) == 1:
        return shown[0][1], tuple(shown)
    if len(shown) <= _MAX_LINES:
        return "\n".join(f"{region.name} {state}" for region, state in shown), tuple(shown)
    groups: dict[str, list[tuple[Region, str]]] = {}
    for region, state in shown:
        groups.setdefault(state, []).append((region, state))
    lines = []
    for state, members in groups.items():
        total = sum(state in region.states for region, _ in states)
        several = f"{state}: {len(members)} of {total}"
        lines.append(several if len(members) > 1 else f"{members[0][0].name} {state}")
    return "\n".join(lines), tuple(members[0] for members in groups.values())


def abbreviate(names: list[str]) -> list[str]:
    """Return names for a line of text, of many the first ones and their number."""
    if len(names) <= _MAX_NAMES:
        return names
    return [*names[:3], f"... {names[-1]} ({len(names)} in all)"]


def _reset(region: Region, edge: HierarchicalEdge) -> str:
    """Return the reset of an edge, one line per choice if they differ."""
    by_reset: dict[str, list[str]] = {}
    for choice in edge.choices:
        by_reset.setdefault(choice.reset, []).append(choice.target)
    if len(by_reset) == 1:
        return edge.reset
    return "\n".join(
        f"to {' or '.join(replace_complete_sets(region, targets))}: {reset or 'nothing'}"
        for reset, targets in by_reset.items()
    )


def _actions(region: Region, state: str) -> tuple[str, ...]:
    """Return the lines of UML's compartment of internal activities, with rates for ``do /``."""
    nesting = region.nesting

    def updates(word: str, blocks: Mapping[str, Mapping[str, str | int | float]]) -> Iterator[str]:
        if text := updates_text(blocks.get(state, {})):
            yield f"{word} / {text}"

    rates = (f"{name}' = {text}" for name, text in nesting.flows.get(state, {}).items())
    return (*updates("entry", nesting.entries), *updates("exit", nesting.exits), *rates)


def _conditions(automaton: Automaton, region: Region, state: str) -> tuple[str, ...]:
    """Return the conditions of a state, or of its two directions of sliding."""
    if automaton.laws is None or region.nesting.edges or region.nesting.configurations:
        return ()
    inner = [leaf for leaf, outer in region.superstates.items() if outer == state] or [state]
    found = [_condition(automaton, region, leaf) for leaf in inner]
    return tuple(words for words in found[0] if all(words in others for others in found))


def _condition(automaton: Automaton, region: Region, state: str) -> list[str]:
    built = region.build(Role(state))
    prefix = f"{region.name}."
    conditions: dict[str, list[str]] = {}
    for margin in built.margins:
        if margin.kind != "plain":  # plain margins are guards, shown on edges
            name = margin.name.removeprefix(prefix)
            alternatives = conditions.setdefault(margin.relation or margin.name, [])
            alternatives.append(f"{name} {_sense(automaton, margin)} 0")
    return [
        *map(" or ".join, conditions.values()),
        *(m.name.removeprefix(prefix) for m in built.invariants),
    ]


def _sense(automaton: Automaton, margin: Margin) -> str:
    """Return "-" if a margin is the negative of the quantity in its name."""
    named = automaton.observables.get(margin.name)
    return "<=" if named is not None and (margin.shown or margin.expression) == -named else ">="
