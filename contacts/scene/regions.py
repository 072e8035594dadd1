"""A contact as a region: its states, guards and resets (paper, figure 5)."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from contacts.scene.friction import Friction
from contacts.scene.modes import Bearing, ContactSymbols, share_of
from contacts.scene.parts import Contact
from contacts.states import OFF, OPEN, declared_state
from statechart.automaton.regions import Edge, State

if TYPE_CHECKING:
    from statechart.automaton.trace import Role

BODY_STATES = ("free", "slide", "pin")
"""States and events of a body that collides by its shape."""
BODY_IMPACT = "impact"
BODY_CAUSES = ("touchdown", BODY_IMPACT, "liftoff", "slip", "stick")
BODY_EDGES = (
    *(Edge("touchdown", "free", s, "an impulse acts on the body") for s in BODY_STATES),
    *(
        Edge(BODY_IMPACT, s, t, "another contact strikes")
        for s in BODY_STATES[1:]
        for t in BODY_STATES
    ),
    *(Edge("liftoff", s, "free", "no impulse acts on the body") for s in BODY_STATES[1:]),
    Edge("stick", "slide", "pin", "a contact has no slip"),
    Edge("slip", "pin", "slide", "all contacts slip"),
)

# Characters; longer conditions are abbreviated, since every state has an edge with them.
_MAX_GATE_LENGTH = 40
_DIRECTIONS = {"slide+": 1, "slide-": -1, "slide": 0}


def states(contact: Contact, *, gate: str) -> tuple[str, ...]:
    """Return the states of a contact's region: slide with directions unless frictionless.

    A contact with a `gate` (`Scene.gate`) can be off.
    """
    sliding = ("slide",) if contact.frictionless else ("slide+", "slide-")
    per_mode = {"free": ("free",), "slide": sliding, "pin": ("pin",)}
    state_names = tuple(state for mode in contact.allowed for state in per_mode[mode.mode])
    return (*state_names, OFF) if gate else state_names


def contact_state(contact: Contact, symbols: ContactSymbols, role: Role) -> State:
    """Return the equations and margins of a state; its conditions add theirs."""
    if role.state == OFF:
        values = symbols.friction.used.get(0, {})
        return State((symbols.V, symbols.H), (), values=values)
    declared, direction = declared_state(role.state), _DIRECTIONS.get(role.state, 0)
    mode = next(mode for mode in contact.allowed if mode.mode == declared)
    state = mode.state(symbols, direction)
    if isinstance(role.share, Bearing):
        return share_of(state, symbols, direction, role.share, pinned=role.state == "pin")
    return state


def edges(contact: Contact, *, jams: bool, bounces: bool, gate: str) -> tuple[Edge, ...]:
    """Return the transitions of a contact's statechart.

    `jams`: friction may press the point in; `bounces`: impacts may accumulate (see `Scene`).
    """
    present = states(contact, gate="")
    closed = [s for s in present if s not in OPEN]
    sliding = [s for s in closed if s != "pin"]
    mu = "static" if isinstance(contact.friction, Friction) else "mu"
    result: list[Edge] = []
    if "free" in present:
        # A plastic impact can end in flight, if the surface recedes.
        plastic = contact.restitution == 0
        rebound = _landing("free") if plastic else "impact: rebound by restitution"
        soft = contact.stiffness is not None
        if not soft:
            result.append(Edge("touchdown", "free", "free", "gap = 0, dgap < 0", rebound))
        for state in closed:
            reset = "" if soft else _landing(state)
            result.append(Edge("touchdown", "free", state, "gap = 0, dgap < 0", reset))
            if bounces:
                guard = "bounces accumulate"
                result.append(Edge("zeno", "free", state, guard, _landing(state, "skip them; ")))
        result += [Edge("liftoff", state, "free", "V < 0") for state in closed]
    if "pin" in present:
        guards = {"slide": "|H| > 0", "slide+": f"H < -{mu} V", "slide-": f"H > {mu} V"}
        for state in sliding:
            result.append(Edge("slip", "pin", state, guards[state]))
            result.append(Edge("stick", state, "pin", f"slip = 0, |H| <= {mu} V", "slip := 0"))
    for state, target in product(sliding if jams else (), present):
        if target != state:
            guard, reset = "no V >= 0 prevents penetration", "impact without collision"
            result.append(Edge("jam", state, target, guard, reset, alone=True))
    if len(sliding) == 2:
        result.append(Edge("reverse", "slide+", "slide-", f"slip = 0, H > {mu} V"))
        result.append(Edge("reverse", "slide-", "slide+", f"slip = 0, H < -{mu} V"))
    if gate:
        gate = gate if len(gate) <= _MAX_GATE_LENGTH else "enabled"
        result += [Edge("disable", state, OFF, f"not ({gate})") for state in present]
        result.append(Edge("enable", OFF, "free", f"{gate}, gap >= 0"))
    return tuple(result)


def _landing(state: str, before: str = "impact; ") -> str:
    return before + ("dgap := 0, slip := 0" if state == "pin" else "dgap := 0")
