"""SCXML of a diagram (W3C State Chart XML, Recommendation of 1 September 2015).

SCXML has states, events, conditions and assignments, but no continuous motion: the host sets the
variables and sends the events ``REGION.CAUSE``, followed by ``.STATE`` if the target depends on an
impact. The machine raises the events that its transitions wait for: ``REGION.STATE`` on entry of a
state, and ``REGION.CAUSE`` of a transition that such an event fires. Completed states raise
``done.state.ID``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from itertools import chain

from statechart.automaton.regions import (
    DONE,
    UNREACHED,
    HierarchicalEdge,
    Region,
    hierarchical_edges,
)
from statechart.diagram.model import Diagram, Machine, printable, spell_signs, unique_identifiers
from statechart.errors import FormulaError, StatechartError
from statechart.formulas.condition import And, InState, Or
from statechart.formulas.formula import Formula, parse
from statechart.formulas.relation import Comparison, Negation, Relation, Term, parse_relation
from statechart.formulas.tree import Call, Constant, nodes
from statechart.formulas.tree import Node as FormulaNode

SCXML = "http://www.w3.org/2005/07/scxml"
"""Namespace of the elements."""

NOTES = "urn:contact-statecharts:diagram"
"""Namespace of further attributes."""


def scxml(diagram: Diagram) -> str:
    """Render the diagram of a model as an executable SCXML document.

    Titles, reasons and resets that are no SCXML expressions are attributes of the namespace
    `NOTES`; comments list what SCXML cannot express. Raises `StatechartError` for a diagram without
    a model.
    """
    if diagram.machine is None:
        raise StatechartError(f"diagram {diagram.title!r} shows no model that SCXML could run")
    root = _MachineWriter(diagram.machine).root
    for place, sentence in enumerate(unexpressed_parts(diagram.machine)):
        # Comments may not contain two hyphens.
        words = f" left out: {printable(sentence).replace('--', '- -')} "
        root.insert(place, ET.Comment(words))
    for key, text in (("title", diagram.title), ("notes", "\n".join(diagram.notes))):
        if text:
            root.set(f"diagram:{key}", printable(text))
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def unexpressed_parts(machine: Machine) -> tuple[str, ...]:
    """Return sentences on the parts of a machine that SCXML cannot express."""
    losses = _MachineWriter(machine).lost
    return tuple(f"{what}: {', '.join(whose)}" for what, whose in losses.items())


class _MachineWriter:
    """Writes a machine into `root`; `lost` maps inexpressible parts to their transitions."""

    def __init__(self, machine: Machine) -> None:
        self.lost: dict[str, list[str]] = {}
        self.root = ET.Element("scxml", {"xmlns": SCXML, "xmlns:diagram": NOTES, "version": "1.0"})
        self._data = dict.fromkeys([n for n in machine.values if n.isidentifier()])
        self._used: dict[str, None] = {}
        self._awaited = {
            event for region in machine.regions for e in region.nesting.edges for event in e.events
        }
        taken: set[str] = {name.lower() for name in self._data}
        # Initial states with superstates and default substates, whose entry raises no events.
        starting = {
            f"{region.name}.{state}"
            for region, start in zip(machine.regions, machine.start, strict=True)
            for initial in [region.nesting.initial.get("", start)]
            for state in (*region.active(initial), *region.entered_with(initial))
        }
        self._starting = starting & self._awaited
        self._started = ""
        single = len(machine.regions) == 1 and not self._starting
        data = ET.SubElement(self.root, "datamodel")
        parent = self.root
        if not single:
            (together,) = unique_identifiers(["all_regions"], taken).values()
            self.root.set("initial", together)
            parent = ET.SubElement(self.root, "parallel", {"id": together})
        if self._starting:
            names = unique_identifiers(["run", "starting", "started"], taken)
            run, before, self._started = names.values()
            whole = ET.SubElement(parent, "state", {"id": run, "initial": before})
            begin = ET.SubElement(whole, "state", {"id": before})
            ET.SubElement(begin, "transition", {"target": self._started})
            ET.SubElement(whole, "state", {"id": self._started})
        self._ids: dict[str, dict[str, str]] = {}
        tops = [self._named(region, taken, single=single) for region in machine.regions]
        self._ends: dict[tuple[str, str], str] = {}  # (region, completable state) -> event
        for region, top in zip(machine.regions, tops, strict=True):
            for owner in {*chain.from_iterable(region.nesting.done.values())}:
                ended = self._ids[region.name].get(owner, top)
                self._ends[region.name, owner] = f"done.state.{ended}"
        for region, start, top in zip(machine.regions, machine.start, tops, strict=True):
            self._region(parent, region, start, top)
        for name in self._used:
            value = machine.values.get(name, 0.0)
            ET.SubElement(data, "data", {"id": name, "expr": repr(float(value))})
        if not self._used:
            self.root.remove(data)

    def _named(self, region: Region, taken: set[str], *, single: bool) -> str:
        """Choose identifiers for the states of a region; return its own, "" for a single region."""
        prefix = "" if single else f"{region.name} "
        names = (*self._states(region), *region.nesting.histories)
        found = unique_identifiers((f"{prefix}{name}" for name in names), taken)
        self._ids[region.name] = {name.removeprefix(prefix): found[name] for name in found}
        return "" if single else unique_identifiers([region.name], taken)[region.name]

    @staticmethod
    def _states(region: Region) -> tuple[str, ...]:
        superstates = region.superstates
        return region.nesting.names or tuple(
            dict.fromkeys([*region.states, *superstates, *superstates.values()])
        )

    def _region(self, parent: ET.Element, region: Region, start: str, identifier: str) -> None:
        nesting, ids = region.nesting, self._ids[region.name]
        initial = nesting.initial.get("", start)
        if identifier:
            top = ET.SubElement(parent, "state", {"id": identifier, "initial": ids[initial]})
        else:
            top = parent
            self.root.set("initial", ids[initial])
        leaving: dict[str, list[HierarchicalEdge]] = {}
        for edge in nesting.edges or hierarchical_edges(region):
            leaving.setdefault(edge.source, []).append(edge)
        for name in self._states(region):
            if name not in region.superstates:
                self._state(top, region, name, leaving)

    def _state(
        self,
        parent: ET.Element,
        region: Region,
        name: str,
        leaving: Mapping[str, list[HierarchicalEdge]],
    ) -> None:
        nesting, ids = region.nesting, self._ids[region.name]
        inside = [inner for inner in ids if region.superstates.get(inner) == name]
        parallel = name in nesting.parallel
        final = name in nesting.final
        kind = "final" if final else "parallel" if parallel else "state"
        element = ET.SubElement(parent, kind, {"id": ids[name]})
        element.set("diagram:name", printable(name))
        if name in nesting.unreached:
            element.set("diagram:infeasible", UNREACHED)
        if inside and not parallel:
            element.set("initial", ids[nesting.initial.get(name, inside[0])])
        for tag, blocks in (("onentry", nesting.entries), ("onexit", nesting.exits)):
            self._assign(element, tag, blocks.get(name, {}), f"{region.name}.{name} ({tag})")
        if (event := f"{region.name}.{name}") in self._awaited:
            entry = element.find("onentry")
            entry = ET.SubElement(element, "onentry") if entry is None else entry
            if event in self._starting:
                entry = ET.SubElement(entry, "if", {"cond": f"In('{self._started}')"})
            ET.SubElement(entry, "raise", {"event": spell_signs(event)})
        for edge in leaving.get(name, ()):
            self._edge(element, region, edge, leaving[name])
        for history, declared in nesting.histories.items():
            if declared.parent == name:
                memory = {"id": ids[history], "type": declared.depth}
                kept = ET.SubElement(element, "history", memory)
                whole = declared.initial == name
                targets = [ids[state] for state in (inside if whole else [declared.initial])]
                ET.SubElement(kept, "transition", {"target": " ".join(targets)})
        for inner in inside:
            self._state(element, region, inner, leaving)

    def _edge(
        self,
        parent: ET.Element,
        region: Region,
        edge: HierarchicalEdge,
        leaving: Iterable[HierarchicalEdge],
    ) -> None:
        ids, what = self._ids[region.name], f"{region.name}.{edge.cause}"
        several = len(edge.choices) > 1 or sum(e.cause == edge.cause for e in leaving) > 1
        for choice in edge.choices:
            event = f"{what}.{ids[choice.target]}" if several else what
            element = ET.SubElement(parent, "transition", {"event": event})
            if edge.events:
                names = (self._event_name(region, event) for event in edge.events)
                element.set("event", " ".join(names))
            guard = edge.condition if edge.events else edge.guard
            if guard is not None and (condition := self._relation(guard)) is not None:
                element.set("cond", condition)
            elif guard is not None:
                element.set("diagram:guard", printable(guard))
                self._lose("guards (the host program sends these events)", what)
            if not edge.static:
                element.set("target", ids[choice.target])
                if edge.internal:
                    element.set("type", "internal")
            if edge.events and what in self._awaited:
                ET.SubElement(element, "raise", {"event": spell_signs(what)})
            if edge.updates:
                self._assign(element, None, edge.updates, what)
            elif choice.reset:
                element.set("diagram:reset", printable(choice.reset))
                self._lose("resets of continuous states", what)

    def _event_name(self, region: Region, event: str) -> str:
        """Return the name of an awaited event in SCXML."""
        owner, _, cause = event.rpartition(".")
        ends = {name: end for (name, state), end in self._ends.items() if state == owner}
        if cause == DONE and ends:
            return ends.get(region.name) or " ".join(ends.values())
        return spell_signs(event)

    def _assign(
        self,
        parent: ET.Element,
        tag: str | None,
        updates: Mapping[str, str | int | float],
        what: str,
    ) -> None:
        """Write simultaneous updates."""
        if not updates:
            return
        if not all(name in self._data and self._formula(text) for name, text in updates.items()):
            self._lose("updates with names or functions not in datamodel", what)
            return
        element = parent if tag is None else ET.SubElement(parent, tag)
        later: dict[str, str] = {}
        for name, text in updates.items():
            if any(name in parse(other).names for n, other in updates.items() if n != name):
                later[name] = f"new_{name}"
                self._used[later[name]] = None
            self._used[name] = None
            assigned = {"location": later.get(name, name), "expr": str(text)}
            ET.SubElement(element, "assign", assigned)
        for name, location in later.items():
            ET.SubElement(element, "assign", {"location": name, "expr": location})

    def _relation(self, text: str) -> str | None:
        """Return a guard as a condition, registering its names as data; None if impossible."""
        try:
            relation = parse_relation(text)
        except FormulaError:
            return None
        roots = [formula.root for formula in relation.formulas]
        exist = all(m.state in self._ids.get(m.region, {}) for m in relation.members)
        possible = exist and self._is_expressible(relation, roots)
        return self._text(relation.root) if possible else None

    def _text(self, term: Term) -> str:
        match term:
            case Comparison():
                return term.text
            case InState():
                return f"In('{self._ids[term.region][term.state]}')"
            case Negation():
                return f"!({self._text(term.part)})"
        parts = (
            f"({self._text(part)})" if isinstance(part, And | Or) else self._text(part)
            for part in term.parts
        )
        return (" && " if isinstance(term, And) else " || ").join(parts)

    def _formula(self, text: str | int | float) -> bool:
        formula = parse(text)
        return self._is_expressible(formula, (formula.root,))

    def _is_expressible(self, written: Formula | Relation, roots: Iterable[FormulaNode]) -> bool:
        plain = not any(isinstance(node, Call | Constant) for root in roots for node in nodes(root))
        if not (plain and written.names <= self._data.keys()):
            return False
        self._used |= dict.fromkeys(sorted(written.names))
        return True

    def _lose(self, what: str, whose: str) -> None:
        found = self.lost.setdefault(what, [])
        if whose not in found:
            found.append(whose)
