"""A plain interpreter of nested states: SCXML's appendix D over names, and charts drawn at random.

It uses nothing of the package; tests compare flattened charts with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from random import Random
from typing import Any

Data = Mapping[str, Any]


class Interpreter:
    """Interprets a region, declared as plain data, event by event; logs its actions in order."""

    def __init__(self, region: Data) -> None:
        self.order: list[str] = []
        self.data: dict[str, Data] = {}
        self.parent: dict[str, str | None] = {}
        self.kids: dict[str, list[str]] = {}
        self.transitions: list[Data] = []
        self._add(None, region)
        self.top = region["initial"]
        self.active: set[str] = set()
        self.stored: dict[str, set[str]] = {}
        self.done: list[str] = []
        entered: set[str] = set()
        self._add_descendants(self.top, entered)
        self._add_ancestors(self.top, None, entered)
        self._enter(entered)

    def _add(self, parent: str | None, holder: Data) -> None:
        for kind in ("states", "regions"):
            for name, data in holder.get(kind, {}).items():
                self.order.append(name)
                self.data[name], self.parent[name] = data, parent
                self.kids.setdefault(name, [])
                if parent is not None and "history" not in data:
                    self.kids[parent].append(name)
                self._add(name, data)
        self.transitions += holder.get("transitions", ())

    def parallel(self, name: str) -> bool:
        return "regions" in self.data[name]

    def ancestors(self, name: str) -> list[str | None]:
        found: list[str | None] = []
        up = self.parent[name]
        while up is not None:
            found.append(up)
            up = self.parent[up]
        return [*found, None]

    def inside(self, name: str, outer: str | None) -> bool:
        return outer in self.ancestors(name)

    def send(self, event: str) -> None:
        """Take the transitions that one event enables: one microstep."""
        self.done = []
        enabled: list[Data] = []
        for name in self.order:
            if name not in self.active or self.kids[name]:
                continue
            for holder in (name, *self.ancestors(name)):
                found = [
                    t
                    for t in self.transitions
                    if t["from"] == holder and event in t["on"].split(" or ")
                ]
                if found:
                    if found[0] not in enabled:
                        enabled.append(found[0])
                    break
        filtered: list[Data] = []
        for t1 in enabled:
            preempted, beaten = False, []
            for t2 in filtered:
                if self._exits([t1]) & self._exits([t2]):
                    if self.inside(t1["from"], t2["from"]):
                        beaten.append(t2)
                    else:
                        preempted = True
                        break
            if not preempted:
                filtered = [*(t for t in filtered if t not in beaten), t1]
        self._microstep(filtered)

    def _microstep(self, taken: list[Data]) -> None:
        left = self._exits(taken)
        for name in self.order:
            data = self.data[name]
            if "history" in data and self.parent[name] in left:
                keep = data["history"] == "deep"
                self.stored[name] = {
                    s
                    for s in self.active
                    if (self.inside(s, self.parent[name]) and not self.kids[s] if keep
                        else self.parent[s] == self.parent[name])
                }  # fmt: skip
        for name in reversed(self.order):
            if name in left:
                self.done.append(f"exit {name}")
        self.active -= left
        self.done += [f"take {t['name']}" for t in taken]
        entered: set[str] = set()
        for t in taken:
            if "to" in t:
                self._add_descendants(t["to"], entered)
                domain = self._domain(t)
                for target in self._effective(t["to"]):
                    self._add_ancestors(target, domain, entered)
        self._enter(entered)

    def _enter(self, entered: set[str]) -> None:
        self.done += [f"enter {name}" for name in self.order if name in entered]
        self.active |= entered

    def _effective(self, target: str) -> set[str]:
        if "history" not in self.data[target]:
            return {target}
        return self.stored.get(target) or self._default(target)

    def _default(self, history: str) -> set[str]:
        above = self.parent[history]
        assert above is not None
        if "initial" not in self.data[history] and self.parallel(above):
            return {*self.kids[above]}
        return {str(self.data[history].get("initial", self.data[above].get("initial")))}

    def _domain(self, t: Data) -> str | None:
        if t.get("internal"):
            return str(t["from"])
        targets = self._effective(t["to"])
        for up in self.ancestors(t["from"]):
            if (up is None or not self.parallel(up)) and all(self.inside(x, up) for x in targets):
                return up
        raise AssertionError

    def _exits(self, taken: Iterable[Data]) -> set[str]:
        return {
            name for t in taken if "to" in t for name in self.active
            if self.inside(name, self._domain(t))
        }  # fmt: skip

    def _add_descendants(self, name: str, entered: set[str]) -> None:
        if "history" in self.data[name]:
            for target in self._effective(name):
                self._add_descendants(target, entered)
            for target in self._effective(name):
                self._add_ancestors(target, self.parent[name], entered)
            return
        entered.add(name)
        if self.parallel(name):
            self._add_regions(name, entered)
        elif self.kids[name]:
            self._add_descendants(self.data[name]["initial"], entered)
            self._add_ancestors(self.data[name]["initial"], name, entered)

    def _add_ancestors(self, name: str, stop: str | None, entered: set[str]) -> None:
        for up in self.ancestors(name):
            if up is None or up == stop:
                return
            entered.add(up)
            if self.parallel(up):
                self._add_regions(up, entered)

    def _add_regions(self, name: str, entered: set[str]) -> None:
        for region in self.kids[name]:
            if not any(self.inside(s, region) for s in entered):
                self._add_descendants(region, entered)


EVENTS = ("env.a", "env.b", "env.c")


def random_region(random: Random) -> dict[str, Any]:
    """Return a region of nested states; every entry, exit and transition writes its number."""
    names = (f"s{i}" for i in range(1000))
    parents: dict[str, tuple[str, ...]] = {}
    histories: list[str] = []
    parallels: list[str] = []
    left = [random.randint(3, 14)]

    def holder(above: tuple[str, ...], depth: int, *, inner: bool) -> dict[str, Any]:
        states: dict[str, Any] = {}
        for _ in range(random.randint(1, 3)):
            if states and left[0] <= 0:
                break
            left[0] -= 1
            name = next(names)
            parents[name] = above
            here = (*above, name)
            kind = random.random() if depth < 3 and left[0] > 0 else 1.0
            if kind < 0.2:
                regions = {}
                parallels.append(name)
                for _ in range(2):
                    region = next(names)
                    parents[region] = here
                    regions[region] = holder((*here, region), depth + 2, inner=True)
                states[name] = {"regions": regions}
                if random.random() < 0.5:
                    history = next(names)
                    parents[history] = here
                    histories.append(history)
                    kept = {"history": random.choice(("shallow", "deep"))}
                    states[name]["states"] = {history: kept}
            elif kind < 0.55:
                states[name] = holder(here, depth + 1, inner=True)
            else:
                states[name] = {}
        first = random.choice(list(states))
        if inner and random.random() < 0.5:
            name = next(names)
            parents[name] = above
            histories.append(name)
            states[name] = {"history": random.choice(("shallow", "deep"))}
            if random.random() < 0.3:
                states[name]["initial"] = random.choice([s for s in states if s != name])
        return {"initial": first, "states": states}

    region = holder((), 0, inner=False)
    transitions: list[dict[str, Any]] = []
    sources = [name for name in parents if name not in histories]
    taken: set[tuple[str, str]] = set()
    for number in range(random.randint(1, 10)):
        source, target = random.choice(sources), random.choice(list(parents))
        on = [e for e in random.sample(EVENTS, random.randint(1, 2)) if (source, e) not in taken]
        if not on or _across(source, target, parents, parallels):
            continue
        taken |= {(source, event) for event in on}
        made = {"name": f"t{number}", "from": source, "to": target, "on": " or ".join(on)}
        if source in parents[target] and source not in parallels and random.random() < 0.5:
            made["internal"] = True
        elif random.random() < 0.1:
            del made["to"]
        transitions.append(made)
    return {**region, "transitions": transitions}


def _across(
    one: str, other: str, parents: Mapping[str, tuple[str, ...]], parallels: list[str]
) -> bool:
    mine, theirs = (*parents[one], one), (*parents[other], other)
    shared = [a for a, b in zip(mine, theirs, strict=False) if a == b]
    return bool(shared) and shared[-1] in parallels and shared[-1] not in (one, other)


def numbered(region: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the region with updates that log actions, and number -> action."""
    found: dict[str, str] = {}

    def number(what: str) -> dict[str, int]:
        found[str(len(found))] = what
        return {"log": len(found) - 1}

    def walk(holder: dict[str, Any]) -> dict[str, Any]:
        result = dict(holder)
        for kind in ("states", "regions"):
            if kind in holder:
                result[kind] = {n: walk(h) | actions(n, h, kind) for n, h in holder[kind].items()}
        result["transitions"] = [
            t | {"updates": number(f"take {t['name']}")} for t in holder.get("transitions", ())
        ]
        if not result["transitions"]:
            del result["transitions"]
        return result

    def actions(name: str, holder: dict[str, Any], kind: str) -> dict[str, Any]:
        if "history" in holder or kind == "regions":
            return {}
        return {"entry": number(f"enter {name}"), "exit": number(f"exit {name}")}

    return walk(region), found
