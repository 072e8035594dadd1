"""Contributions of the contact modes free, slide and pin to a product mode (paper 3.3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import Field

from statechart.automaton.regions import Hold, Loads, Margin, MarginKind, State
from statechart.documents.documented import declare
from statechart.documents.fields import Part

if TYPE_CHECKING:
    import sympy as sp

    _Pair = tuple[sp.Expr, sp.Expr]

Row = dict[int, "sp.Expr"]
"""Sparse row: the index of a coordinate -> its entry; all others are zero."""

FORCE_MARGINS = _LOAD, _UPPER, _LOWER = "V", "mu V - H", "mu V + H"
"""Names of a closed contact's force margins: its load, and distances to the cone's two edges."""
PULL, OUTSIDE = "pull", "outside"
"""Margins of a compliant contact that is free inside its surface: it presses again, or leaves."""


class FrictionSymbols(NamedTuple):
    """Friction of a contact by direction: 0 at rest, 1 and -1 in motion."""

    # The cone's unit edges (1, mu) / hypot(1, mu), also for mu = 0 and mu = inf. Constants without
    # a coefficient: (1, 0) frictionless, (0, 1) without slide
    edges: Mapping[int, tuple[sp.Expr, sp.Expr]]
    # The coefficient that a mode uses, and its values; empty if they are equal
    used: Mapping[int, Mapping[sp.Symbol, sp.Expr]]
    at_rest: sp.Expr  # The coefficient at rest


@dataclass(frozen=True, eq=False)
class ContactSymbols:
    """A contact's quantities as expressions; lengths, speeds, forces in the scene's units.

    Places and directions are in the frame of the surface: the world's, or that of the body that
    carries it.
    """

    name: str  # Name of the contact
    gap: sp.Expr  # Distance from the surface, to first order; >= 0
    # Round-off of the gap at the start of a flight, which is subtracted, so that the duration of
    # the flight depends on its velocity alone
    gap_offset: sp.Expr
    # `gap_rate`, `slip`: Normal and tangential velocity of the point relative to the surface
    gap_rate: sp.Expr
    slip: sp.Expr
    point: _Pair  # Position of the contact point
    # `anchor`, `slipping`: Position that is constant while the contact sticks, and the direction in
    # which it slips: the point and the tangent, unless the point is on a rim
    # (`contacts.dynamics.geometry.Rim.anchored`)
    anchor: _Pair
    slipping: _Pair
    normal: _Pair  # Unit vector of the surface there, out of the solid
    # `jacobian_n`, `jacobian_t`: d(normal, tangential velocity)/d(rates)
    jacobian_n: Row
    jacobian_t: Row
    # `bias_n`, `bias_t`: Their rates at zero accelerations of the coordinates
    bias_n: sp.Expr
    bias_t: sp.Expr
    # `normal_acceleration`, `tangential_acceleration`: Their rates, in the unknown accelerations
    normal_acceleration: sp.Expr
    tangential_acceleration: sp.Expr
    # `V`, `H`: Normal and tangential force on the body
    V: sp.Symbol
    H: sp.Symbol
    friction: FrictionSymbols
    # d(normal, tangential velocity)/d(rates) on coordinates and pads
    jacobian: tuple[Row, Row]
    joints: tuple[tuple[sp.Symbol, Row], ...]  # Forces and Jacobian of the joints, row by row
    # `closing`, `sticking`: Constraints of a closed gap, and of a sticking point
    closing: Hold
    sticking: Hold
    # Normal force of a closed compliant contact, in positions and rates; None if it is rigid
    compliance: sp.Expr | None = None

    @property
    def normal_law(self) -> sp.Expr:
        """Equation along the normal of a closed contact: this expression is zero."""
        if self.compliance is None:
            return self.normal_acceleration
        return self.V - self.compliance


class Free(Part):
    """No force: V = 0, H = 0, as long as the gap is not closed."""

    mode: Literal["free"] = declare("Its name.", "free", default="free")

    def state(self, contact: ContactSymbols, direction: int) -> State:
        """Return the equations and margins of the mode."""
        from statechart.formulas.writer import Difference, Max

        gap = Difference(contact.gap, contact.gap_offset)
        margins = [Margin(f"{contact.name}.gap", gap, "gap")]
        if contact.compliance is not None:
            # A compliant contact may open while it is inside, and press again there.
            relation = f"{contact.name}.free"
            whole_margin = Max(contact.gap, -contact.compliance, evaluate=False)
            pull, name = -contact.compliance, contact.name
            margins = [
                Margin(f"{name}.gap", gap, "gap", relation, whole_margin),
                Margin(f"{name}.{PULL}", pull, "force", relation, whole_margin),
                Margin(f"{name}.{OUTSIDE}", -contact.gap, "plain", relation, whole_margin),
            ]
        values = contact.friction.used.get(0, {})
        return State((contact.V, contact.H), tuple(margins), values=values)


class Slide(Part):
    """The gap stays closed and the force lies on the edge of the cone that opposes the slip."""

    mode: Literal["slide"] = declare("Its name.", "slide", default="slide")

    def state(self, contact: ContactSymbols, direction: int) -> State:
        """Return the equations and margins for slip in `direction` (+1, -1; 0: frictionless).

        The force is ``edge (cone_n n - direction cone_t t)``; the margin `V` is that edge, so
        that it still has a sign where V itself is zero (mu = inf, equation 13).
        """
        name, (n, t) = contact.name, contact.friction.edges[direction]
        t = direction * t
        along_edge = n * contact.V - t * contact.H
        margins = [Margin(f"{name}.{_LOAD}", along_edge, "force", shown=contact.V)]
        if direction:
            margins.append(Margin(f"{name}.slip", direction * contact.slip, "speed"))
        equations = (contact.normal_law, t * contact.V + n * contact.H)
        holds = () if contact.compliance is not None else (contact.closing,)
        values = contact.friction.used.get(direction, {})
        return State(equations, tuple(margins), values=values, holds=holds)


class Pin(Part):
    """The contact point does not move, as long as the force that this takes is in the cone."""

    mode: Literal["pin"] = declare("Its name.", "pin", default="pin")

    def state(self, contact: ContactSymbols, direction: int) -> State:
        """Return the equations and margins of the mode."""
        name, (n, t) = contact.name, contact.friction.edges[0]
        margins = [Margin(f"{name}.{_LOAD}", contact.V, "force")]
        if n != 0:
            kind: MarginKind = "hold" if contact.friction.used else "force"
            mu = contact.friction.at_rest
            for side, H in ((_UPPER, contact.H), (_LOWER, -contact.H)):
                margin, distance = f"{name}.{side}", t * contact.V - n * H
                shown = mu * contact.V - H
                margins.append(Margin(margin, distance, kind, shown=shown, coefficient=mu))
        equations = (contact.normal_law, contact.tangential_acceleration)
        holds = () if contact.compliance is not None else (contact.sticking,)
        values = contact.friction.used.get(0, {})
        return State(equations, tuple(margins), values=values, holds=holds)


@dataclass(frozen=True)
class SignFriction:
    """Dry friction by a sign, as expressions."""

    name: str  # As in formulas, without spaces.
    argument: sp.Expr  # A rate, or a place where the force jumps.
    slip: sp.Expr  # The rate in the sign, or of the place.
    bias: sp.Expr  # The derivative of the slip where nothing accelerates.
    limit: sp.Expr
    row: Row = field(hash=False)  # Derivatives of the slip by the rates.


class Bearing(NamedTuple):
    """Equations of a contact that shares its load."""

    # Zone of its cone: `inside`, `upper`, `lower`, `apex`; `OWN` if the motion determines the force
    zone: str
    rows: str  # Independent constraints along normal and tangent ("n", "t")
    # Forces along normal and tangent or along the edge ("e") that carry the load in the equations
    carriers: str = ""
    coordinates: tuple[int, ...] = ()  # Independent displacements of the load sharing
    # Joint rows that these displacements satisfy; given once in a mode
    joints: tuple[int, ...] = ()
    # Signs that share the load, and their zones; named once, too
    signs: tuple[tuple[SignFriction, str], ...] = ()


OWN = "own"
"""The zone of a contact that does not share its load."""


def share_of(
    state: State,
    contact: ContactSymbols,
    direction: int,
    bearing: Bearing,
    pinned: bool,
    limit: sp.Expr | None = None,
) -> State:
    """Return a state of a contact, or of a coupling with a limit, with a shared load.

    See `contacts.modes.load_sharing`.
    """
    import sympy as sp

    zone, places = bearing.zone, bearing.coordinates
    if contact.compliance is not None and pinned and "t" not in bearing.rows:
        # Feet that sink differently turn the body: the other constraints imply this one no longer.
        slips = (("slip +", contact.slip), ("slip -", -contact.slip))
        implied = (Margin(f"{contact.name}.{side}", slip, "implied") for side, slip in slips)
        state = replace(state, margins=(*state.margins, *implied))
    constraints = {"n": contact.normal_law, "t": contact.tangential_acceleration}
    independent = tuple(constraints[row] for row in bearing.rows)
    if zone == OWN:
        other_equations = (e for e in state.equations if e not in constraints.values())
        return State((*independent, *other_equations), state.margins, values=state.values)
    n, t = contact.friction.edges[0 if pinned else direction]
    y = {place: sp.Symbol(f"y{place}", real=True) for place in places}
    w, u = (sp.Add(*(row[i] * y[i] for i in places if i in row)) for row in contact.jacobian)
    # The tangential component of the edge.
    t = t if pinned and zone == "upper" else -t if pinned else -direction * t
    if limit is None:
        bears, laws, further = _cone_zone_equations(contact, zone, (n, t), (w, u), pinned)
    else:
        bears, laws, further = _coupling_zone_equations(contact, zone, limit, u)
    margins = state.margins
    if zone != "inside":
        margins = *(m for m in margins if m.kind in ("speed", "implied")), *further
    # The force in the equations of motion: normal and tangential, or along the edge.
    own_force = contact.V if limit is None else contact.H
    carriers = {f: sp.Symbol(f"{f}_{own_force}", real=True) for f in bearing.carriers}
    edge = carriers.get("e", sp.S.Zero)
    normal_force, tangential_force = carriers.get("n", n * edge), carriers.get("t", t * edge)
    (normal, tangential), (V, H) = contact.jacobian, bears
    V, H = V - normal_force, H - tangential_force
    balances = {y[i]: sp.Add(normal.get(i, 0) * V, tangential.get(i, 0) * H) for i in places}
    carried: dict[sp.Symbol, sp.Expr] = {} if limit is not None else {contact.V: normal_force}
    carried[contact.H] = tangential_force
    for joint in bearing.joints:
        # The joint force with load sharing, and the one if the carriers bear all of the load.
        force, row = contact.joints[joint]
        reaction = sp.Symbol(f"x{joint}", real=True)
        carriers[str(force)] = carried[force] = sp.Symbol(f"alone_{force}", real=True)
        laws[force] = force - carried[force] - reaction
        shared = [i for i in places if i in row]
        displacement = balances[reaction] = sp.Add(*(row[i] * y[i] for i in shared))
        for i in shared:
            # A spring at the joint, with zero deflection, makes the pivots nonzero.
            balances[y[i]] += row[i] * (reaction + displacement)
    known: dict[sp.Expr, sp.Expr] = {}
    for sign, zone in bearing.signs:
        row, most = sign.row, sign.limit
        shared = [i for i in places if i in row]
        spring = sp.Add(*(row[i] * y[i] for i in shared))
        # A sign on its bound has it in the equations of motion.
        side = {"upper": 1, "lower": -1}.get(zone, 0)
        known[sp.sign(sign.argument)] = sp.Integer(-side)
        for i in shared:
            balances[y[i]] += row[i] * spring if side == 0 else 0
        clearances = (side * spring - most,) if side else (most - spring, most + spring)
        margins += tuple(
            Margin(f"{sign.name}.{k}", clearance, "force") for k, clearance in enumerate(clearances)
        )
    loads = Loads(carried, tuple(carriers.values()), laws, balances, known)
    if contact.compliance is not None:
        independent = tuple(equation.xreplace(carried) for equation in independent)
    return State(independent, margins, values=state.values, loads=loads)


def _cone_zone_equations(
    contact: ContactSymbols,
    zone: str,
    edge: tuple[sp.Expr, sp.Expr],
    springs: tuple[sp.Expr, sp.Expr],
    pinned: bool,
) -> tuple[tuple[sp.Expr, sp.Expr], dict[sp.Symbol, sp.Expr], tuple[Margin, ...]]:
    """Return the force of a contact in a zone of its cone, its equations, and its margins."""
    import sympy as sp

    name, (n, t), (w, u) = contact.name, edge, springs
    if zone == "inside":
        return (contact.V, contact.H), {contact.V: contact.V - w, contact.H: contact.H - u}, ()
    # Components along the edge, and perpendicular to it out of the cone.
    along_edge, across_edge = n * w + t * u, n * u - t * w
    if zone == "apex":
        margins = [Margin(f"{name}.spared", -along_edge, "force")]
        if pinned:
            margins.append(Margin(f"{name}.spared -", t * u - n * w, "force"))
        return (sp.S.Zero, sp.S.Zero), {f: f for f in (contact.V, contact.H)}, tuple(margins)
    amount = sp.Symbol(f"edge_{contact.V}", real=True)
    bears = n * amount, t * amount
    laws = {amount: amount - along_edge}
    laws |= {f: f - component for f, component in zip((contact.V, contact.H), bears, strict=True)}
    margins = [Margin(f"{name}.{_LOAD}", amount, "force", shown=n * amount)]
    if pinned:
        distance = across_edge if zone == "upper" else -across_edge
        margins.append(Margin(f"{name}.on edge", distance, "force"))
    return bears, laws, tuple(margins)


def _coupling_zone_equations(
    contact: ContactSymbols, zone: str, limit: sp.Expr, spring: sp.Expr
) -> tuple[tuple[sp.Expr, sp.Expr], dict[sp.Symbol, sp.Expr], tuple[Margin, ...]]:
    """Return the force of a locked coupling in a zone, its equation, and its margins."""
    if zone == "inside":
        return (contact.V, contact.H), {contact.H: contact.H - spring}, ()
    side = 1 if zone == "upper" else -1
    beyond = Margin(f"{contact.name}.at limit", side * spring - limit, "force")
    return (contact.V, side * limit), {contact.H: contact.H - side * limit}, (beyond,)


ContactMode = Annotated[Free | Slide | Pin, Field(discriminator="mode")]


def as_mode(value: Any) -> Any:
    """Let a mode be declared by its name alone."""
    return {"mode": value} if isinstance(value, str) else value
