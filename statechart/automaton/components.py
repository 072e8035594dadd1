"""Independent components of an automaton: uncoupled parts of a declaration.

Entities are coupled if one mentions the other; each connected component is an automaton, so that
the product is not enumerated. Isomorphic components share one automaton in neutral names.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sympy.utilities.iterables import connected_components

from statechart.automaton.automaton import NEUTRAL, Automaton, Component, Places

if TYPE_CHECKING:
    from statechart.automaton.laws import Setup
    from statechart.automaton.trace import Role

Data = dict[str, Any]
"""A declaration as plain data."""
Entity = tuple[str, str]
"""Section of a declaration, and name in it."""

_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
_STILL = ("surfaces", "stop")
_DROPPED = ("doc", "ranges", "invariants", "outputs")


def split(
    data: Data, moving: Collection[str], regions: Collection[str], schema: Path
) -> list[tuple[Data, dict[str, str]]]:
    """Return the independent parts of a declaration in neutral names; none if it is connected.

    A part is a declaration, and neutral name -> name. `moving` are the sections of entities that
    change in time, or determine how others do; `regions` those of regions. Names that are words of
    the document (in its JSON Schema) are not replaced.
    """
    entities = {(s, name): data[s][name] for s in (*moving, "surfaces") for name in data.get(s, {})}
    stops = data.get("stop", {}).get("conditions", {})
    owners: dict[str, set[Entity]] = {}
    for (section, name), content in entities.items():
        names = {name, f"d{name}"} if section == "coordinates" else {name}
        names |= set(content.get("variables", ())) if section in regions else set()
        for owned_name in names:
            owners.setdefault(owned_name, set()).add((section, name))
    mentions = {entity: _mentioned_names(content, owners) for entity, content in entities.items()}
    mentions |= {("stop", name): _mentioned_names(text, owners) for name, text in stops.items()}
    # Fixed surfaces and conditions of time alone couple nothing.
    static = {entity for entity, named in mentions.items() if not named and entity[0] in _STILL}
    vertices = [entity for entity in mentions if entity not in static]
    edges = [(e, o) for e in vertices for o in mentions[e] if o not in static]
    groups = [set(group) for group in connected_components((vertices, edges))]
    idle = [group for group in groups if not any(section in regions for section, _ in group)]
    groups = [group for group in groups if group not in idle]
    if len(groups) < 2:
        return []
    shared_zeno = "contacts" in data
    if any(not _mentioned_names(event, owners) for event in _declared_events(data, shared_zeno)):
        # An event without a region couples all regions.
        return []
    words = {*_reserved_words(schema), *_words_of_regions(data, regions)}
    if any(NEUTRAL.search(text) for text in _texts(data)):
        return []
    groups[0] = groups[0].union(*idle, (e for e in static if e[0] == "stop"))
    declared = [(s, name) for s, x in data.items() if isinstance(x, dict) for name in x]
    declared += (("stop", name) for name in stops)
    order = {entity: place for place, entity in enumerate(declared)}.__getitem__
    groups = [group.union(*(mentions[e] & static for e in group)) for group in groups]
    return [_component_declaration(data, sorted(g, key=order), static, words) for g in groups]


def _component_declaration(
    data: Data, group: Sequence[Entity], static: set[Entity], words: set[str]
) -> tuple[Data, dict[str, str]]:
    entities = [e for e in group if e[0] != "stop" and e not in static]
    names = {
        name: name if {name, f"d{name}"} & words else f"zz{place}zz"
        for place, (_, name) in enumerate(entities)
    }
    # The names of rates follow from those of the coordinates.
    coordinates = (name for section, name in entities if section == "coordinates")
    rates = {f"d{name}": f"d{names[name]}" for name in coordinates}
    sections = {section for section, _ in group}
    declaration: Data = {}
    for key, content in data.items():
        if key in _DROPPED:
            continue
        if key == "stop":
            conditions = content.get("conditions", {})
            content = {**content, "conditions": {n: conditions[n] for s, n in group if s == key}}
        elif key in sections:
            content = {n: content[n] for s, n in group if s == key}
        elif key == "modes":
            content = {n: content[n] for n in names if n in content}
        elif isinstance(content, dict) and key not in ("parameters", "settings", "units"):
            continue
        declaration[key] = content if key == "parameters" else _rename(content, names | rates)
    return declaration, {neutral: name for name, neutral in names.items()}


def _rename(value: Any, names: Mapping[str, str]) -> Any:
    if isinstance(value, str):
        return _NAME.sub(lambda found: names.get(found[0], found[0]), value)
    if isinstance(value, Mapping):
        return {_rename(key, names): _rename(entry, names) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_rename(entry, names) for entry in value)
    return value


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield str(key)
            yield from _texts(entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from _texts(entry)


def _entries(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the keys and values of all mappings in nested data."""
    if isinstance(value, Mapping):
        yield from value.items()
        value = [*value.values()]
    if isinstance(value, list | tuple):
        for entry in value:
            yield from _entries(entry)


def _mentioned_names(value: Any, owners: Mapping[str, set[Entity]]) -> set[Entity]:
    names = {name for text in _texts(value) for name in _NAME.findall(text)}
    return set().union(*(owners[name] for name in names if name in owners))


def _declared_events(value: Any, shared_zeno: bool) -> Iterator[str]:
    """Yield the events in `on:`, with `zeno` only if `shared_zeno`."""
    texts = (text for key, entry in _entries(value) if key == "on" for text in _texts(entry))
    events = (event.strip() for text in texts for event in re.split(r"\bor\b", text))
    return (event for event in events if shared_zeno or event != "zeno")


def _words_of_regions(data: Data, regions: Collection[str]) -> set[str]:
    """Return the names of states and transitions."""
    names: set[str] = set()
    for key, entry in _entries([[*data.get(section, {}).values()] for section in regions]):
        if key in ("states", "regions") and isinstance(entry, Mapping):
            names.update(map(str, entry))
        if key in ("initial", "from", "to", "name"):
            names.update(_texts(entry))
    return names


@cache
def _reserved_words(schema: Path) -> frozenset[str]:
    # An energy in forces or conditions couples all bodies.
    return frozenset((*_words_of_schema(json.loads(schema.read_text("utf-8"))), "energy"))


def _words_of_schema(schema: Any) -> Iterator[str]:
    """Yield the keys and enumerated words of a JSON Schema."""
    if isinstance(schema, dict):
        yield from schema.get("properties", ())
        yield from (word for word in schema.get("enum", ()) if isinstance(word, str))
        if isinstance(schema.get("const"), str):
            yield schema["const"]
        for content in schema.values():
            yield from _words_of_schema(content)
    elif isinstance(schema, list):
        for content in schema:
            yield from _words_of_schema(content)


def compose_components(
    parts: Sequence[tuple[Data, dict[str, str]]],
    form: Callable[[Data], Data],
    compose: Callable[[Data], Automaton],
    restricted: Callable[[Automaton], Callable[[Setup, Places], Setup]],
    shown: Callable[[Role, Places], Role] = lambda role, _: role,
) -> tuple[Component, ...]:
    """Return the components of parts, with one automaton per form.

    Declared regions jump one after another; those of contacts and couplings together.
    """
    automata: dict[str, Automaton] = {}
    components = []
    for data, names in parts:
        key = json.dumps(form(data), default=str)
        automaton = automata.get(key)
        if automaton is None:
            automaton = automata[key] = compose(data)
        joint = frozenset(automaton.region_names).difference(data.get("regions", ()))
        components.append(Component(automaton, names, restricted(automaton), shown, joint))
    return tuple(components)
