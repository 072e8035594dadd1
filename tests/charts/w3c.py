"""W3C tests of SCXML that a chart can express, as plain data.

Source: SCXML 1.0 Implementation Report (w3.org/Voice/2013/scxml-irp), numbers as there. Regions
beside the region `main` take the place of `<raise>` and `<send>`: `main` hears their events;
invoked sessions are regions, or regions in the state that invokes; `<if>` and `<foreach>` are
guards of transitions.
"""

from __future__ import annotations

from typing import Any

Data = dict[str, Any]

ALWAYS = "time >= 0"


def t(source: str, target: str | None = None, name: str = "", **more: Any) -> Data:
    """Return a transition, by default without event; its name is made of its ends."""
    trigger = {} if {"on", "after", "every", "guard"} & more.keys() else {"guard": ALWAYS}
    ends = {"from": source} | ({} if target is None else {"to": target})
    return {"name": name or f"{source}_{target}", **ends, **trigger, **more}


def numbered(transitions: list[Data]) -> list[Data]:
    """Return transitions with names that differ."""
    counts: dict[str, int] = {}
    found = []
    for one in transitions:
        name = one["name"]
        counts[name] = counts.get(name, 0) + 1
        found.append(one if counts[name] == 1 else {**one, "name": f"{name}_{counts[name]}"})
    return found


def region(initial: str, states: Data, *transitions: Data) -> Data:
    """Return a region, or the contents of a state."""
    return {"initial": initial, "states": states} | (
        {"transitions": numbered(list(transitions))} if transitions else {}
    )


def raising(**heard: str) -> Data:
    """Return regions that raise events in sequence: event -> its predecessor."""
    return {
        f"of_{event}": region("on", {"on": {}}, t("on", None, event, on=on))
        for event, on in heard.items()
    }


FINAL: Data = {"final": True}


def chart(
    initial: str,
    states: Data,
    *transitions: Data,
    before: Data | None = None,
    after: Data | None = None,
    **values: float,
) -> Data:
    """Return a chart whose region `main` enters `initial` at once, to end in `pass`.

    Regions `before` it fire first, so that all their events of an instant are heard before it goes
    on; those `after` it wait until it has taken what its guards let it.
    """
    found = region(
        "begin",
        {"begin": {}, **states, "pass": FINAL, "fail": FINAL},
        t("begin", initial),
        *transitions,
    )
    variables = dict.fromkeys(("v1", "v2", "v3", "v4", "v5", "data"), 0) | values
    regions = {**(before or {}), "main": found, **(after or {})}
    return {"kind": "chart", "name": "w3c", "variables": variables, "regions": regions,
            "stop": {"time": 5}}  # fmt: skip


def up(variable: str, by: str = "1") -> Data:
    """Return the update that counts."""
    return {variable: f"{variable} + {by}"}


def digit(number: int) -> Data:
    """Return the update that appends a digit to v1."""
    return {"v1": f"10*v1 + {number}"}


FOO_BAR = raising(foo="main.s1", bar="of_foo.foo")
S0_FOO_BAR = raising(foo="main.s0", bar="of_foo.foo")
TWO = raising(event1="main.s0", event2="of_event1.event1")


def child(*transitions: Data, **states: Data) -> Data:
    """Return an invoked session: it starts when `main` enters s0."""
    return {"child": region("idle", {"idle": {}, "sub0": {}, **states, "end": FINAL},
                            t("idle", "sub0", on="main.s0"), *transitions)}  # fmt: skip


def clauses(first: str, second: str, third: str | None) -> tuple[Data, ...]:
    """Return `<if>`, `<elseif>` and `<else>`, which count their executions in v1."""
    last = [] if third is None else [t("s0", "baz", updates=up("v1"))]
    return (t("s0", "foo", guard=first, updates=up("v1")),
            t("s0", "bar", guard=second, updates=up("v1")), *last)  # fmt: skip


CLAUSES: Data = {"s0": {}, "foo": {}, "bar": {}, "baz": {}}

CHARTS: dict[str, Data] = {
    # Events are queued in the order in which they are raised.
    "144": chart(
        "s0", {"s0": {}, "s1": {}},
        t("s0", "s1", on="of_foo.foo"), t("s0", "fail", on="of_bar.bar"),
        t("s1", "pass", on="of_bar.bar"), t("s1", "fail", on="of_foo.foo"),
        before=S0_FOO_BAR,
    ),
    # The first clause that is true is taken, and it alone.
    "147": chart(
        "s0", CLAUSES, *clauses("v1 > 1", "v1 > -1", "else"),
        t("bar", "pass", guard="v1 == 1"), t("bar", "fail"), t("foo", "fail"), t("baz", "fail"),
    ),
    "148": chart(
        "s0", CLAUSES, *clauses("v1 > 1", "v1 > 2", "else"),
        t("baz", "pass", guard="v1 == 1"), t("baz", "fail"), t("foo", "fail"), t("bar", "fail"),
    ),
    "149": chart(
        "s0", CLAUSES, *clauses("v1 > 1", "v1 > 2", None),
        t("s0", "pass", on="of_bat.bat", guard="v1 == 0"), t("s0", "fail", on="of_bat.bat"),
        t("foo", "fail"), t("bar", "fail"),
        after=raising(bat="main.s0"),
    ),
    # A loop goes over its items in their order, and its body runs for each.
    "153": chart(
        "s0", {"s0": {}},
        t("s0", "fail", guard="v2 >= 1 and v1 < v2"),
        t("s0", None, guard="v2 < 3", updates={"v1": "v2 + 1", "v2": "v2 + 1"}),
        t("s0", "pass", guard="v1 == 3"),
    ),
    "155": chart(
        "s0", {"s0": {}},
        t("s0", None, guard="v2 < 3", updates={"v1": "v1 + v2 + 1", "v2": "v2 + 1"}),
        t("s0", "pass", guard="v1 == 6"), t("s0", "fail"),
    ),
    # Content is done in the order of the document.
    "158": chart(
        "s0", {"s0": {}, "s1": {}},
        t("s0", "s1", on="of_event1.event1"), t("s0", "fail", on="of_event2.event2"),
        t("s1", "pass", on="of_event2.event2"), t("s1", "fail", on="of_event1.event1"),
        before=TWO,
    ),
    # The present value, not the first, decides which event is sent.
    "172": chart(
        "s0", {"s0": {"entry": {"v1": 2}}},
        t("s0", "pass", on="of_event2.event2"), t("s0", "fail", on="of_event1.event1"),
        before={
            "of_event1": region("on", {"on": {}},
                                t("on", None, "event1", on="main.s0", guard="v1 == 1")),
            "of_event2": region("on", {"on": {}},
                                t("on", None, "event2", on="main.s0", guard="v1 == 2")),
        },
        v1=1,
    ),
    # So is a delay that is a variable.
    "175": chart(
        "s0", {"s0": {"entry": {"v1": 1, "v2": "time"}}, "s1": {}},
        t("s0", "fail", guard="time >= v2 + v1"), t("s0", "s1", after=0.5),
        t("s1", "pass", guard="time >= v2 + v1"),
    ),
    # Data of an event have the value of when it is sent.
    "176": chart(
        "s0", {"s0": {"entry": {"v1": 2}}, "s1": {}},
        t("s0", "s1", on="of_event1.event1", updates={"v2": "data"}),
        t("s1", "pass", guard="v2 == 2"), t("s1", "fail"),
        before={"of_event1": region("on", {"on": {}}, t("on", None, "event1", on="main.s0",
                                                        updates={"data": "v1"}))},
        v1=1,
    ),
    "179": chart(
        "s0", {"s0": {}},
        t("s0", "pass", on="of_event1.event1", guard="data == 123"),
        t("s0", "fail", on="of_event1.event1"),
        before={"of_event1": region("on", {"on": {}}, t("on", None, "event1", on="main.s0",
                                                        updates={"data": "123"}))},
    ),
    # Delays are respected.
    "185": chart(
        "s0", {"s0": {}, "s1": {}},
        t("s0", "s1", on="of_event1.event1"), t("s0", "fail", on="late.event2"),
        t("s1", "pass", on="late.event2"), t("s1", "fail", on="of_event1.event1"),
        before={**raising(event1="main.s0"), "late": region(
            "idle", {"idle": {}, "on": {}}, t("idle", "on", on="main.s0"),
            t("on", "idle", "event2", after=1))},
    ),
    # Data are evaluated when an event is sent, not when it arrives.
    "186": chart(
        "s0", {"s0": {"exit": {"v3": 0}}, "s1": {}},
        t("s0", None, on="late.idle_on", updates={"v1": "2"}),
        t("s0", "s1", on="late.event1", updates={"v2": "data"}),
        t("s1", "pass", guard="v2 == 1"), t("s1", "fail"),
        before={"late": region(
            "idle", {"idle": {}, "on": {}},
            t("idle", "on", on="main.s0", updates={"data": "v1"}),
            t("on", "idle", "event1", after=1))},
        v1=1,
    ),
    # Delayed events of an ended session are not sent.
    "187": chart(
        "s0", {"s0": {}},
        t("s0", "fail", on="child.child_to_parent"), t("s0", "pass", after=1),
        after=child(t("sub0", "end"), t("sub0", "end", "child_to_parent", after=0.5)),
    ),
    # A session is heard by its parent, and hears it.
    "191": chart(
        "s0", {"s0": {}},
        t("s0", "pass", on="child.child_to_parent"), t("s0", "fail", on="child.done"),
        after=child(t("sub0", "end", "child_to_parent")),
    ),
    "192": chart(
        "s0", {"s0": region("s01", {"s01": {}, "s02": {}},
                            t("s01", "s02", "parent_to_child", on="child.child_to_parent"),
                            t("s02", "pass", on="child.event_received"),
                            t("s02", "fail", on="child.done"))},
        t("s0", "fail", after=2),
        after=child(t("sub0", "sub1", "child_to_parent"),
                    t("sub1", "end", "event_received", on="main.parent_to_child"), sub1={}),
    ),
    # A session does not cancel the delayed events of another.
    "207": chart(
        "s0", {"s0": region("s01", {"s01": {}, "s02": {}},
                            t("s01", "s02", on="child.child_to_parent"),
                            t("s02", "pass", on="child.event1"),
                            t("s02", "fail", on="child.event2"))},
        t("s0", "fail", after=2),
        after=child(t("sub0", "sub1", "child_to_parent"), t("sub1", "end", "event1", after=1),
                    t("sub1", "end", "event2", after=1.5), sub1={}),
    ),
    # A state that is left waits no more.
    "208": chart(
        "s0", {"s0": {}},
        t("s0", "pass", on="late.event2"), t("s0", "fail", on="late.event1"),
        before={"late": region(
            "idle", {"idle": {}, "both": {"regions": {
                "one": region("w1", {"w1": {}, "cancelled": {}, "sent": {}},
                              t("w1", "cancelled"), t("w1", "sent", "event1", after=1)),
                "two": region("w2", {"w2": {}, "sent2": {}},
                              t("w2", "sent2", "event2", after=1.5)),
            }}},
            t("idle", "both", on="main.s0"))},
    ),
    # A session that ends is done.
    "220": chart(
        "s0", {"s0": {}}, t("s0", "pass", on="child.done"), t("s0", "fail", after=3),
        after=child(t("sub0", "end")),
    ),
    "229": chart(
        "s0", {"s0": {}}, t("s0", "pass", on="child.event_received"), t("s0", "fail", after=3),
        after={**child(t("sub0", "end", "event_received", on="of_event1.event1")),
               "of_event1": region("on", {"on": {}},
                                   t("on", None, "event1", on="child.sub0"))},
    ),
    "232": chart(
        "s0", {"s0": region("s01", {"s01": {}, "s02": {}, "s03": {}},
                            t("s01", "s02", on="child.first"), t("s02", "s03", on="child.second"),
                            t("s03", "pass", on="child.done"))},
        t("s0", "fail", after=3),
        after=child(t("sub0", "sub1", "first"), t("sub1", "end", "second"), sub1={}),
    ),
    # A guard reads the values that its event sets.
    "233": chart(
        "s0", {"s0": {}},
        t("s0", "pass", on="child.child_to_parent", guard="v1 == 2"),
        t("s0", "fail", on="child.child_to_parent"),
        after=child(t("sub0", "end", "child_to_parent", updates={"v1": "2"})),
    ),
    "235": chart(
        "s0", {"s0": {}}, t("s0", "pass", on="child.done"), t("s0", "fail", after=2),
        after=child(t("sub0", "end", after=1)),
    ),
    # `done` is the last event of a session.
    "236": chart(
        "s0", {"s0": {}, "s1": {}, "s2": {}},
        t("s0", "s1", on="child.child_to_parent"), t("s0", "fail", on="child.done"),
        t("s1", "s2", on="child.done"),
        t("s2", "fail", on="child.child_to_parent"), t("s2", "pass", after=2),
        after=child(t("sub0", "end", "child_to_parent")),
    ),
    # A session ends with the state that invoked it.
    "237": chart(
        "s0", {"s0": {"regions": {
            "here": region("wait", {"wait": {}}),
            "session": region("sub0", {"sub0": {}, "ended": FINAL}, t("sub0", "ended", after=2)),
        }}, "s1": {}},
        t("s0", "s1", after=1),
        t("s1", "fail", on="session.done"), t("s1", "pass", after=2.5),
    ),
    "244": chart(
        "s0", {"s0": {}}, t("s0", "pass", on="child.success"), t("s0", "fail", on="child.failure"),
        after=child(t("sub0", "end", "success", guard="v1 == 1"), t("sub0", "end", "failure")),
        v1=1,
    ),
    "247": chart(
        "s0", {"s0": region("s01", {"s01": {}}, t("s01", "pass", on="child.done"))},
        t("s0", "fail", after=2),
        after=child(t("sub0", "end", after=0.5)),
    ),
    # It leaves its states then.
    "250": chart(
        "s0", {"s0": {"regions": {
            "here": region("wait", {"wait": {}}),
            "session": region("sub0", {"sub0": {
                "exit": digit(2), **region("sub01", {"sub01": {"exit": digit(1)}})}}),
        }}, "s1": {}},
        t("s0", "s1", after=1), t("s1", "pass", guard="v1 == 12"), t("s1", "fail"),
    ),
    # Variables are known everywhere, and have their values from the start.
    "278": chart("s0", {"s0": {}, "s1": {}}, t("s0", "pass", guard="v1 == 1"), t("s0", "fail"),
                 v1=1),
    "279": chart("s0", {"s0": {}, "s1": {"entry": {"v2": 3}}},
                 t("s0", "pass", guard="v1 == 1 and v2 == 2"), t("s0", "fail"), v1=1, v2=2),
    "287": chart("s0", {"s0": {"entry": {"v1": 1}}}, t("s0", "pass", guard="v1 == 1"),
                 t("s0", "fail")),
    "310": chart(
        "p", {"p": {"regions": {
            "one": region("s0", {"s0": {}}), "two": region("s1", {"s1": {}})}}},
        t("s0", "pass", guard="in(main.s1)"), t("s0", "fail"),
    ),
    "347": chart(
        "s0", {"s0": region("s01", {"s01": {}, "s02": {}},
                            t("s01", "s02", "parent_to_child", on="child.child_to_parent"),
                            t("s02", "pass", on="child.done"))},
        t("s0", "fail", after=3),
        after=child(t("sub0", "sub1", "child_to_parent"),
                    t("sub1", "end", on="main.parent_to_child"), sub1={}),
    ),
    # A state is done once the final state in it is entered, and before that is left.
    "372": chart(
        "s0", {"s0": region("s0final", {"s0final": {**FINAL, "entry": {"v1": 2},
                                                    "exit": {"v1": 3}}})},
        t("s0", "pass", on="s0.done", guard="v1 == 2"), t("s0", "fail", on="s0.done"),
        t("s0", "fail", after=1), v1=1,
    ),
    # Histories enter their defaults without a memory, else the remembered states.
    "387": chart(
        "s3", {
            "s0": region("s01", {
                "s0_shallow": {"history": "shallow", "initial": "s01"},
                "s0_deep": {"history": "deep", "initial": "s022"},
                "s01": region("s011", {"s011": {}, "s012": {}}),
                "s02": region("s021", {"s021": {}, "s022": {}})}),
            "s1": region("s11", {
                "s1_shallow": {"history": "shallow", "initial": "s11"},
                "s1_deep": {"history": "deep", "initial": "s122"},
                "s11": region("s111", {"s111": {}, "s112": {}}),
                "s12": region("s121", {"s121": {}, "s122": {}})}),
            "s3": {}, "s4": {},
        },
        t("s3", "s0_shallow"),
        t("s0", "s4", on="heard.s011"),
        t("s0", "fail", on="heard.s012 or heard.s021 or heard.s022"),
        t("s4", "s1_deep"),
        t("s1", "pass", on="heard.s122"),
        t("s1", "fail", on="heard.s111 or heard.s112 or heard.s121"),
        before={"heard": region("on", {"on": {}}, *(
            t("on", None, state, on=f"main.{state}")
            for state in ("s011", "s012", "s021", "s022", "s111", "s112", "s121", "s122")))},
    ),
    "388": chart(
        "s012", {
            "s0": region("s01", {
                "s0_shallow": {"history": "shallow", "initial": "s02"},
                "s0_deep": {"history": "deep", "initial": "s022"},
                "s01": region("s011", {"s011": {}, "s012": {}}),
                "s02": region("s021", {"s021": {}, "s022": {}})}) | {"entry": up("v1")},
            "s1": {}, "s2": {},
        },
        t("s0", "s1", on="heard.s012", guard="v1 == 1"),
        t("s0", "s2", on="heard.s012", guard="v1 == 2"),
        t("s0", "pass", on="heard.s011", guard="v1 == 3"),
        t("s0", "fail", on="heard.s011 or heard.s021 or heard.s022"),
        t("s0", "fail", on="heard.s012", guard="v1 == 3"),
        t("s1", "s0_deep"), t("s2", "s0_shallow"),
        before={"heard": region("on", {"on": {}}, *(
            t("on", None, state, on=f"main.{state}") for state in ("s011", "s012", "s021", "s022")
        ))},
    ),
    # Transitions of inner states come first, then the order of the document.
    "403a": chart(
        "s0", {"s0": region(
            "s01", {"s01": {}, "s02": {}},
            t("s01", "s02", on="of_event1.event1"),
            t("s01", "fail", on="of_event1.event1 or of_event2.event2"),
            t("s02", "fail", on="of_event1.event1"),
            t("s02", "fail", on="of_event2.event2", guard="v1 > 1"))},
        t("s0", "fail", after=1), t("s0", "fail", on="of_event1.event1"),
        t("s0", "pass", on="of_event2.event2"),
        before={**raising(event1="main.s01"), **raising(event2="main.s02")},
    ),
    # One that two states select is taken once.
    "403b": chart(
        "s0", {"s0": region("p0", {"p0": {"regions": {
            "p0s1": region("p1", {"p1": {}}), "p0s2": region("p2", {"p2": {}})}}})},
        t("s0", None, "outer", on="of_event1.event1", updates=up("v1")),
        t("p0", None, "inner", on="of_event1.event1", updates=up("v1")),
        t("p1", "pass", on="of_event2.event2", guard="v1 == 1"),
        t("p1", "fail", on="of_event2.event2"),
        before={**raising(event1="main.p0"), **raising(event2="of_event1.event1")},
    ),
    # Of two conflicting transitions the first in the document is taken.
    "403c": chart(
        "s0", {"s0": region("p0", {"p0": {"regions": {
            "p0s1": region("p1", {"p1": {}}), "p0s2": region("p2", {"p2": {}}),
            "p0s3": region("p3", {"p3": {}}), "p0s4": region("p4", {"p4": {}})}}}),
         "s1": {}},
        t("s0", "fail", on="of_event2.event2"), t("s0", "fail", after=1),
        t("p1", None, on="of_event1.event1 or of_event2.event2"),
        t("p2", "p0", "again", on="of_event1.event1"),
        t("p3", "fail", on="of_event1.event1"), t("p3", "s1", on="of_event2.event2"),
        t("p4", None, on="of_event1.event1 or of_event2.event2", updates=up("v1")),
        t("s1", "pass", guard="v1 == 2"), t("s1", "fail"),
        before={**raising(event1="main.s0"), **raising(event2="main.again")},
    ),
    # Exits from the inside and the end of the document, then transitions, then entries.
    "404": chart(
        "s0", {"s0": region(
            "s01p", {"s01p": {"exit": digit(3), "regions": {
                "r1": region("s01p1", {"s01p1": {"exit": digit(2)}}),
                "r2": region("s01p2", {"s01p2": {"exit": digit(1)}})}}, "s02": {}},
            t("s01p", "s02", updates=digit(4)),
            t("s02", "pass", guard="v1 == 1234"), t("s02", "fail"))},
    ),
    "405": chart(
        "s0", {"s0": region(
            "s01p", {"s01p": {"regions": {
                "s01p1": region("s01p11", {"s01p11": {"exit": digit(2)}, "s01p12": {}},
                                t("s01p11", "s01p12", updates=digit(3))),
                "s01p2": region("s01p21", {"s01p21": {"exit": digit(1)}, "s01p22": {}},
                                t("s01p21", "s01p22", updates=digit(4)))}}},
            t("s01p", "pass", guard="v1 == 1234"), t("s01p", "fail", guard="v1 > 1000"))},
        t("s0", "fail", after=1),
    ),
    "406": chart(
        "s0", {"s0": region(
            "s01", {"s01": {}, "s0p2": {"entry": digit(2), "regions": {
                "r1": region("s01p21", {"s01p21": {"entry": digit(3)}}),
                "r2": region("s01p22", {"s01p22": {"entry": digit(4)}})}}},
            t("s01", "s0p2", updates=digit(1)),
            t("s0p2", "pass", guard="v1 == 1234"), t("s0p2", "fail"))},
    ),
    "407": chart("s0", {"s0": {"exit": up("v1")}, "s1": {}}, t("s0", "s1"),
                 t("s1", "pass", guard="v1 == 1"), t("s1", "fail")),
    "416": chart(
        "s1", {"s1": region("s11", {"s11": region(
            "s111", {"s111": {}, "s11final": FINAL}, t("s111", "s11final"))})},
        t("s11", "pass", on="s11.done"), t("s1", "fail", after=1),
    ),
    "417": chart(
        "s1", {"s1": region("s1p1", {"s1p1": {"regions": {
            "s1p11": region("s1p111", {"s1p111": {}, "s1p11final": FINAL},
                            t("s1p111", "s1p11final")),
            "s1p12": region("s1p121", {"s1p121": {}, "s1p12final": FINAL},
                            t("s1p121", "s1p12final", after=0.5))}}})},
        t("s1p1", "pass", on="s1p1.done"), t("s1", "fail", after=1),
    ),
    # Eventless transitions come before transitions of internal events.
    "419": chart(
        "s1", {"s1": {}},
        t("s1", "fail", on="of_foo.foo or of_bar.bar"), t("s1", "pass"), after=FOO_BAR,
    ),
    # Events that nothing waits for pass.
    "423": chart(
        "s0", {"s0": {}, "s1": {}},
        t("s0", "s1", on="of_foo.foo"), t("s0", "fail", on="of_bar.bar or late.event2"),
        t("s1", "pass", on="late.event2"), t("s1", "fail", on="of_foo.foo"),
        before={**S0_FOO_BAR, "late": region(
            "idle", {"idle": {}, "on": {}}, t("idle", "on", on="main.s0"),
            t("on", "idle", "event2", after=1))},
    ),
    "444": chart("s0", {"s0": {}}, t("s0", "pass", guard="v1 + 1 == 2"), t("s0", "fail"), v1=1),
    "448": chart(
        "s0", {"s0": region("s01", {"s01": {}}, t("s01", "s1", guard="v1 == 1")),
               "s1": {"regions": {"one": region("s11", {"s11": {"entry": {"v2": 2}}}),
                                  "two": region("s12", {"s12": {}})}}},
        t("s12", "pass", guard="v2 == 2"), t("s12", "fail"), v1=1,
    ),
    "451": chart(
        "p", {"p": {"regions": {
            "one": region("s0", {"s0": {}}), "two": region("s1", {"s1": {}})}}},
        t("s0", "pass", guard="in(main.s1) and not in(main.fail)"), t("s0", "fail"),
    ),
    # Without a target nothing is left.
    "503": chart(
        "s1", {"s1": {}, "s2": {"exit": up("v1")}, "s3": {}},
        t("s1", "s2"), t("s2", None, on="of_foo.foo", updates=up("v2")),
        t("s2", "s3", on="of_bar.bar", guard="v2 == 1"), t("s2", "fail", on="of_bar.bar"),
        t("s3", "pass", guard="v1 == 1"), t("s3", "fail"), after=FOO_BAR,
    ),
    # External transitions exit up to the common ancestor, internal ones do not.
    "504": chart(
        "s1", {"s1": {}, "s2": {"exit": up("v5"), **region("p", {"p": {
            "exit": up("v1"), "regions": {
                "r1": region("ps1", {"ps1": {"exit": up("v2")}}),
                "r2": region("ps2", {"ps2": {"exit": up("v3")}})}}})},
            "s3": {}},
        t("s1", "p"), t("p", "ps1", on="of_foo.foo", updates=up("v4")),
        t("p", "s3", on="of_bar.bar", guard="v4 == 1"), t("p", "fail", on="of_bar.bar"),
        t("s3", "pass", guard="v1 == 2 and v2 == 2 and v3 == 2 and v5 == 1"), t("s3", "fail"),
        after=FOO_BAR,
    ),
    "505": chart(
        "s1", {"s1": {"exit": up("v1"), **region("s11", {"s11": {"exit": up("v2")}})}, "s2": {}},
        t("s1", "s11", on="of_foo.foo", internal=True, updates=up("v3")),
        t("s1", "s2", on="of_bar.bar", guard="v3 == 1"), t("s1", "fail", on="of_bar.bar"),
        t("s2", "pass", guard="v1 == 1 and v2 == 2"), t("s2", "fail"), after=FOO_BAR,
    ),
    "550": chart("s0", {"s0": {}, "s1": {}}, t("s0", "pass", guard="v1 == 2"), t("s0", "fail"),
                 v1=2),
    # Regions are done before the state that holds them.
    "570": chart(
        "p0", {"p0": {"regions": {
            "p0s1": region("p0s11", {"p0s11": {}, "p0s1final": FINAL},
                           t("p0s11", "p0s1final", on="of_e1.e1")),
            "p0s2": region("p0s21", {"p0s21": {}, "p0s2final": FINAL},
                           t("p0s21", "p0s2final", on="of_e2.e2"))}}, "s1": {}},
        t("p0", None, on="p0s1.done", updates={"v1": "1"}), t("p0", "s1", on="p0s2.done"),
        t("p0", "fail", after=2),
        t("s1", "pass", on="p0.done", guard="v1 == 1"), t("s1", "fail", after=1),
        before={**raising(e1="main.p0"), **raising(e2="of_e1.e1")},
    ),
    # A history is never active itself.
    "580": chart(
        "p1", {"p1": {"regions": {
            "s0": region("s00", {"s00": {}}),
            "s1": region("s1a", {"s1a": {"exit": up("v1"), **region("s11", {
                "sh1": {"history": "shallow", "initial": "s11"}, "s11": {}, "s12": {}},
                t("s11", "s12"))}})}}},
        t("s00", "fail", after=2),
        t("s1a", "sh1", guard="v1 == 0 and in(main.s12)"),
        t("s1a", "pass", guard="v1 == 1"),
    ),
}  # fmt: skip
"""Number of a test -> the chart whose region `main` is to end in the state `pass`."""

S0: Data = {"s0": {}}

REFUSED: dict[str, tuple[Data, str]] = {
    "277": (chart("s0", S0, t("s0", "pass"), v1="undeclared"), "unknown name 'undeclared'"),  # type: ignore[arg-type]
    "286": (chart("s0", {"s0": {"entry": {"foo": 1}}}), "no variable 'foo'"),
    "309": (chart("s0", S0, t("s0", "fail", guard="return >= 0")), "unknown name 'return'"),
    "311": (chart("s0", S0, t("s0", "pass", updates={"foo.bar": 1})), "no variable 'foo.bar'"),
    "312": (chart("s0", {"s0": {"entry": {"v1": "return"}}}), "unknown name 'return'"),
    "313": (chart("s0", {"s0": {"entry": {"v1": "1 +"}}}), "the formula ends early"),
    "314": (chart("s0", S0, t("s0", "pass", updates={"v1": "v1 +* 2"})), "unexpected"),
    "487": (chart("s0", {"s0": {"entry": {"v1": "v1 v2"}}}), "unexpected 'v2'"),
}
"""Number of a test of errors -> a chart that is refused when it is read, and words of why."""
