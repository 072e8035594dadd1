"""Couplings: dry friction as a couple between two bodies, in a joint, or along a guide."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple, Self

from pydantic import Field, model_validator

from contacts.scene.friction import DeclaredLimit, StaticKinetic, coefficients
from contacts.scene.modes import Bearing, ContactSymbols, share_of
from contacts.scene.parts import Relations
from contacts.states import COUPLING_STATES, DISENGAGED, OPEN, SLIPPING
from statechart.automaton.regions import Edge, Margin, State
from statechart.documents.documented import declare
from statechart.documents.fields import FormulaText, Part
from statechart.errors import DeclarationProblem
from statechart.formulas.relation import conjunction

if TYPE_CHECKING:
    import sympy as sp

    from statechart.automaton.trace import Role

LIMIT_MARGINS = _UPPER, _LOWER = "limit - M", "limit + M"
"""Names of the margins of a locked coupling."""
_DIRECTIONS = {"slip+": 1, "slip-": -1}


class Coupling(Part):
    """Dry friction against the relative rotation of two bodies: a brake, a clutch, a stiff joint.

    Its couple M acts on the first body, and is at most `limit`. Locked, the bodies turn together;
    slipping, the couple has the size of the limit and opposes the slip. In a joint that is a guide
    (`to: {x: ...}` or `{y: ...}`) it is a force along the free direction.
    """

    OTHER_WORDS: ClassVar = {
        "torque moment friction capacity max_torque": "limit",
        "body": "bodies: [arm]",
        "flange_a flange_b between": "bodies: [a, b]",
        "engaged active when condition": "enabled",
        "ratio": "coordinates: {q: {}}, and bodies with angle: q and angle: -q/2",
        "static kinetic peak mu mue_pos fn_max": (
            "limit: {static: s, kinetic: k}, couples such as mu*N*r"
        ),
    }

    bodies: Annotated[tuple[str, ...], Field(min_length=1, max_length=2)] | None = declare(
        "Two bodies, or one that turns against the world.",
        ["motor", "load"],
        ["wheel"],
        default=None,
    )
    joint: str | None = declare(
        "A joint instead of bodies: those that it holds; a guide's free direction.",
        "pivot",
        default=None,
    )
    limit: DeclaredLimit = declare(
        "Largest couple, a formula of time, parameters, coordinates, rates and controls; "
        "or its bounds at rest and in motion.",
        "mu*N*r",
        {"static": 11, "kinetic": 10},
        unit="force length; force along a guide",
    )
    enabled: Relations = declare(
        "Relation, or several that must all hold; while it fails, the coupling is open.",
        "time >= 0.4",
        default=(),
    )

    @model_validator(mode="after")
    def _one_pair(self) -> Self:
        if (self.bodies is None) == (self.joint is None):
            raise DeclarationProblem(
                "a coupling is of bodies, or in a joint",
                advice="write bodies: [a, b], bodies: [a] against the world, or joint: NAME",
            )
        if self.bodies is not None and len({*self.bodies}) < len(self.bodies):
            raise DeclarationProblem(
                "a coupling needs two different bodies",
                advice="write bodies: [a] for one that turns against the world",
                loc=("bodies",),
            )
        return self

    @property
    def bounds(self) -> tuple[FormulaText, FormulaText]:
        """The limits at rest and in motion."""
        return coefficients(self.limit)

    @property
    def gate(self) -> str:
        """The conditions without which it is open, as text; "" for none."""
        return conjunction(self.enabled)


class Rolling(Coupling):
    """Rolling resistance of a contact: its limit is a length times the normal force.

    It is free while the contact is.
    """

    contact: str


class CouplingSymbols(NamedTuple):
    """A coupling's quantities as expressions."""

    # Slip, acceleration, couple H over the lever, and constraint; no V
    contact: ContactSymbols
    static: sp.Expr  # Bounds of H
    kinetic: sp.Expr
    lever: sp.Expr


def coupling_states(coupling: Coupling) -> tuple[str, ...]:
    """Return the states of a coupling's region."""
    if isinstance(coupling, Rolling):
        return ("free", *COUPLING_STATES)
    return (*COUPLING_STATES, DISENGAGED) if coupling.enabled else COUPLING_STATES


def coupling_edges(coupling: Coupling) -> tuple[Edge, ...]:
    """Return the transitions of a coupling's statechart."""
    two = isinstance(coupling.limit, StaticKinetic)
    static, kinetic = ("static", "kinetic") if two else ("limit", "limit")
    edges = []
    for state, beyond in (("slip+", f"M < -{static}"), ("slip-", f"M > {static}")):
        edges.append(Edge("slip", "locked", state, beyond))
        edges.append(Edge("lock", state, "locked", f"slip = 0, |M| <= {static}"))
    for state, beyond in (("slip+", f"M > {kinetic}"), ("slip-", f"M < -{kinetic}")):
        opposite = SLIPPING[state == "slip+"]
        edges.append(Edge("reverse", state, opposite, f"slip = 0, {beyond}"))
    if isinstance(coupling, Rolling):
        opens, closes = f"{coupling.contact} opens", f"{coupling.contact} closes"
        edges += [Edge("liftoff", state, "free", opens) for state in COUPLING_STATES]
        edges += [Edge("touchdown", "free", state, closes) for state in SLIPPING]
        edges.append(Edge("lock", "free", "locked", f"{closes}, slip = 0"))
    if coupling.enabled:
        gate = coupling.gate
        edges += [Edge("open", state, DISENGAGED, f"not ({gate})") for state in COUPLING_STATES]
        edges += [Edge("close", DISENGAGED, state, gate) for state in COUPLING_STATES]
    return tuple(edges)


def coupling_state(symbols: CouplingSymbols, role: Role) -> State:
    """Return the equations and margins of a state; its conditions add theirs."""
    contact, static, kinetic, lever = symbols
    name, couple = contact.name, contact.H
    if role.state in OPEN:
        return State((couple,), ())
    if role.state == "locked":
        bounds = (_UPPER, static - couple), (_LOWER, static + couple)
        margins = tuple(Margin(f"{name}.{n}", m, "force", shown=lever * m) for n, m in bounds)
        state = State((contact.tangential_acceleration,), margins, holds=(contact.sticking,))
        if isinstance(role.share, Bearing):
            return share_of(state, contact, 0, role.share, pinned=True, limit=static)
        return state
    direction = _DIRECTIONS[role.state]
    along, rate = direction * contact.slip, direction * (contact.slip / lever)
    slip = Margin(f"{name}.slip", along, "speed", shown=rate)
    limit = Margin(f"{name}.limit", kinetic, "force", shown=lever * kinetic)
    return State((couple + direction * kinetic,), (slip, limit))
