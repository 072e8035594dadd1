"""List of the modes of a model: its regions, and the feasible products at a configuration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from statechart import tabular
from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import MAX_MODES, Feasibility, Setup
from statechart.automaton.product import explore, feasibility
from statechart.automaton.regions import Edge, HierarchicalEdge, Region, hierarchical_edges
from statechart.errors import DeclarationError, close_matches


def list_modes(
    automaton: Automaton, setup: Setup, state: Array, time: float = 0.0, built: int = 0
) -> dict[str, Any]:
    """Return the modes of a model as a JSON object, with their feasibility at a state (n,)."""
    found = feasibility(automaton, setup, state, time)
    return {
        "model": automaton.name,
        "modes_declared": automaton.modes_declared,
        "modes_total": automaton.modes_total,
        "modes_built": built,
        "enumerated": automaton.modes_total <= MAX_MODES,
        "time": time,
        "state": dict(zip(automaton.names, state.tolist(), strict=True)),
        "feasibility": None if found is None else _feasibility(automaton, found),
        "regions": [_region(region) for region in automaton.regions],
    }


def check_variables(automaton: Automaton, names: Iterable[str]) -> None:
    """Raise `DeclarationError` if a name is not a variable."""
    for name in names:
        if name not in automaton.names:
            advice = close_matches(name, automaton.names)
            raise DeclarationError(f"--at {name}: the model has no such variable", advice=advice)


def format_listing(
    listed: Mapping[str, Any], digits: int = tabular.DIGITS
) -> list[tabular.TextBlock]:
    """Return a listing as lines and tables, without directions of sliding."""
    count = format_count(listed["modes_declared"], listed["modes_total"])
    built = listed["modes_built"]
    head = f"{listed['model']}: {count}; {built or 'none'} built, each when a run enters it\n"
    parts: list[list[tabular.TextBlock]] = [[head]]
    if not listed["enumerated"]:
        counts = [
            (f"  ... {r} more: --json has all", "")
            if isinstance(r, int)
            else (f"  {r['name']}", format_count(r["modes_declared"], r["modes_total"]))
            for r in tabular.abridge(listed["regions"])
        ]
        words = f"more than {MAX_MODES} modes: the product is not enumerated; regions:\n"
        parts.append([words, tabular.Table(counts)])
    if listed["feasibility"] is not None:
        parts.append(_possible(listed, digits))
    parts += [
        [f"... {region} more: --json has all\n"] if isinstance(region, int) else _edges(region)
        for region in tabular.abridge(listed["regions"])
    ]
    return tabular.join_blocks(parts)


def format_count(declared: int, total: int) -> str:
    """Return numbers of modes as text, without and with directions of sliding."""
    directed = f" ({tabular.readable_count(total)} with directions of sliding)"
    return tabular.pluralise(declared, "mode") + (directed if total != declared else "")


def _region(region: Region) -> dict[str, Any]:
    return {
        "name": region.name,
        "modes_declared": len({region.declared(state) for state in region.states}),
        "modes_total": len(region.states),
        "states": [{"name": s, "declared": region.declared(s)} for s in region.states],
        "superstates": dict(region.superstates),
        "hierarchical_edges": [_arrow(edge) for edge in hierarchical_edges(region)],
        "edges": [_edge(edge) for edge in region.edges],
    }


def _edge(edge: Edge | HierarchicalEdge) -> dict[str, Any]:
    ends = {"cause": edge.cause, "from": edge.source, "to": edge.target}
    return {**ends, "guard": edge.guard, "reset": edge.reset}


def _arrow(edge: HierarchicalEdge) -> dict[str, Any]:
    choices = [{"to": choice.target, "reset": choice.reset} for choice in edge.choices]
    return {**_edge(edge), "choices": choices} | ({"internal": True} if edge.internal else {})


def _feasibility(automaton: Automaton, found: Feasibility) -> dict[str, Any]:
    names = [region.name for region in automaton.regions]

    def verdicts(directions: bool) -> dict[str, Any]:
        modes = explore(automaton, found=found, directions=directions).modes.items()
        named = [(dict(zip(names, key, strict=True)), data.get("reason")) for key, data in modes]
        return {
            "declared": len(named),
            "feasible": [mode for mode, reason in named if not reason],
            "infeasible": [{"mode": mode, "reason": why} for mode, why in named if why],
        }

    both = {"with_direction": verdicts(True), "without_direction": verdicts(False)}
    return {"remarks": list(found.remarks), **both}


def _possible(listed: Mapping[str, Any], digits: int) -> list[tabular.TextBlock]:
    found = listed["feasibility"]
    plain, directed = found["without_direction"], found["with_direction"]
    counts = f"{len(plain['feasible'])} of {plain['declared']}"
    if directed["declared"] != plain["declared"]:
        counts += f" ({len(directed['feasible'])} of {directed['declared']} with directions)"
    where = ", ".join(
        f"{name} = {tabular.number(x, digits)}" for name, x in listed["state"].items()
    )
    head = f"kinematically possible at t = {tabular.number(listed['time'], digits)}: {counts}\n"
    lines = [head, *(f"  {remark}\n" for remark in (where, *found["remarks"]))]
    names = [region["name"] for region in listed["regions"]]
    if not names:
        return ["".join(lines)]
    rows = [(f"  {names[0]}", *names[1:], "")]
    rows += [_mode_row(mode, "possible") for mode in plain["feasible"]]
    rows += [_mode_row(one["mode"], f"not: {one['reason']}") for one in plain["infeasible"]]
    return ["".join(lines), tabular.Table(rows, headed=True)]


def _mode_row(mode: Mapping[str, str], verdict: str) -> tuple[str, ...]:
    first, *others = mode.values()
    return (f"  {first}", *others, verdict)


def _edges(region: Mapping[str, Any]) -> list[tabular.TextBlock]:
    rows = []
    for edge in region["hierarchical_edges"]:
        guard = f"[{edge['guard']}]" + (", internal" if "internal" in edge else "")
        ends = f"  {edge['from']} -> {edge['to']}"
        rows.append((ends, edge["cause"], guard, _resets(edge["choices"])))
    return [f"{region['name']}: {_nested(region)}\n", *([tabular.Table(rows)] if rows else [])]


def _nested(region: Mapping[str, Any]) -> str:
    """Return the states of a region on one line: `free, closed {pin, slide}`."""
    superstates = region["superstates"]
    members: dict[str | None, list[str]] = {}
    for state in (listed["name"] for listed in region["states"]):
        name: str | None = state
        while name is not None:
            outer = superstates.get(name)
            siblings = members.setdefault(outer, [])
            if name not in siblings:
                siblings.append(name)
            name = outer

    def text(name: str) -> str:
        return name if name not in members else f"{name} {{{', '.join(map(text, members[name]))}}}"

    return ", ".join(map(text, members[None]))


def _resets(choices: Sequence[Mapping[str, str]]) -> str:
    """Return the resets of an edge, with the target states if they depend on these."""
    states: dict[str, list[str]] = {}
    for choice in choices:
        states.setdefault(choice["reset"], []).append(choice["to"])
    if len(states) == 1:
        return f"/ {choices[0]['reset']}" if choices[0]["reset"] else ""
    return "/ " + " or ".join(f"{reset} ({', '.join(to)})" for reset, to in states.items())
