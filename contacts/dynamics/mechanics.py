"""Positions to equations of motion: of bodies that contacts touch and joints hold, by SymPy.

``M(q) a + b(q, v) = Q + sum J_n^T V + J_t^T H + sum J^T X`` (contacts, joints); nothing is
simplified.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import sympy as sp

from contacts.dynamics.gates import Gate, gate_of
from contacts.dynamics.geometry import ContactGeometry, Geometry, Vector, surface_frame
from contacts.dynamics.joints import JointRow
from contacts.dynamics.parameters import (
    GAP_OFFSET,
    HELD_FORCE,
    cone_edge,
    friction_cones,
    friction_symbols,
    kinetic_friction,
    scene_parameters,
)
from contacts.scene.couplings import CouplingSymbols, Rolling
from contacts.scene.expansion import Stop, stops, switched
from contacts.scene.joints import Joint
from contacts.scene.modes import ContactSymbols
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from contacts.states import CLOSED, DISENGAGED, OFF
from statechart.automaton.regions import Hold
from statechart.formulas.linear import Definition
from statechart.formulas.parameters import Parameters
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape


class _SurfaceGeometry(NamedTuple):
    """Geometry of a surface near a point."""

    # `function`, `gap`, `gap_rate`: What is zero on the surface; the distance, and its derivative
    # in time
    function: sp.Expr
    gap: sp.Expr
    gap_rate: sp.Expr
    bias: sp.Expr  # The second derivative of the gap where nothing accelerates
    # `normal`, `rates`, `drifts`: And the point's velocity, and acceleration where nothing
    # accelerates, along x and y
    normal: Vector
    rates: Vector
    drifts: Vector
    turned: sp.Expr  # Share of the turning tangent in the derivative of the slip


class Mechanics(Geometry):
    """The equations of a scene; its `parameters` are those of `scene_parameters` by default."""

    def __init__(self, scene: Scene, parameters: Parameters | None = None) -> None:
        given = parameters or scene_parameters(scene)
        symbols = given.symbols
        controlled = scene.controlled
        controls = {n: sp.Symbol(f"c{i}", real=True) for i, n in enumerate(controlled.order)}
        # Contacts see what controllers remember as they see parameters: as numbers that do not
        # change while an instant is judged.
        self.controller_state = {
            n: sp.Symbol(f"w{i}", real=True) for i, n in enumerate(controlled.controller_state)
        }
        super().__init__(scene, {**symbols, **controls, **self.controller_state})
        self.parameters = given
        self.forces = {
            name: (sp.Symbol(f"V{i}", real=True), sp.Symbol(f"H{i}", real=True))
            for i, name in enumerate(scene.contacts)
        }
        # Couples M; the limits of couplings stand in the place of normal forces.
        self.couples = {
            name: sp.Symbol(f"M{i}", real=True) for i, name in enumerate(scene.couplings)
        }
        self._controls = controlled
        self._coefficients = friction_symbols(scene, symbols)
        # Contacts whose coefficients states of a region set.
        self._switched = {
            name: region
            for name in self._coefficients
            if (law := scene.friction_of(name)) is not None
            and (region := controlled.region_of(law.both)) is not None
        }
        # Those that are in use, where contacts have a static and a kinetic one.
        self.used_friction = {
            name: sp.Symbol(f"{name}.friction", real=True)
            for name, coefficients in self._coefficients.items()
            if "static" in coefficients
        }
        self._asked = {
            (member.region, member.state): sp.Symbol(f"in{i}", real=True)
            for i, member in enumerate(scene.condition_states)
        }
        # Joints that can be off: 1 while they are closed.
        self._closed = {
            name: sp.Symbol(f"on{i}", real=True)
            for i, (name, joint) in enumerate(scene.joints.items())
            if switched(joint)
        }
        # Rates and accelerations of what paths of surfaces use of the memory.
        self._led = {
            name: (sp.Symbol(f"rate_{self.controller_state[name]}", real=True),
                   sp.Symbol(f"acceleration_{self.controller_state[name]}", real=True))
            for name in self.controller_state if name in scene.leading
        }  # fmt: skip
        self.carried = tuple(
            pair
            for name, (rate, acceleration) in self._led.items()
            for pair in ((self.controller_state[name], rate), (rate, acceleration))
        )
        # Symbols that states of controllers set, each after those that its values use: coefficients
        # of contacts, the scene's controls, and how they move surfaces.
        self.controls = (
            *(symbol for name in self._switched for symbol in self._coefficients[name].values()),
            *controls.values(),
            *self._asked.values(),
            *self.used_friction.values(),
            *self._closed.values(),
            *(rate for rate, _ in self._led.values()),
            *(acceleration for _, acceleration in self._led.values()),
        )
        self._contacts: dict[str, ContactGeometry] = {}
        self._gates: dict[str, Gate | None] = {}

    @cached_property
    def held_forces(self) -> list[int]:
        """Places of the parameters of `contacts.dynamics.held_forces`; none without switches."""
        found = enumerate(self.parameters.names)
        return [place for place, name in found if name.startswith(HELD_FORCE)]

    def tape(
        self,
        outputs: Sequence[sp.Expr],
        *,
        unknowns: Sequence[sp.Symbol] = (),
        definitions: Sequence[Definition] = (),
        whole: bool = False,
    ) -> Tape:
        """Compile expressions of state, parameters and time, and of `unknowns` behind the state.

        What controllers remember stands before the parameters; in the `whole` state, behind the
        rates.
        """
        memory, parameters = tuple(self.controller_state.values()), self.parameters.ordered
        return compile_tape(
            outputs,
            variables=(*self.variables, *(memory if whole else ()), *unknowns),
            parameters=parameters if whole else (*memory, *parameters),
            time=self.time,
            definitions=definitions,
        )

    def whole_tape(
        self,
        outputs: Sequence[sp.Expr],
        *,
        unknowns: Sequence[sp.Symbol] = (),
        definitions: Sequence[Definition] = (),
    ) -> Tape:
        """Compile as `tape` does, of the whole state."""
        return self.tape(outputs, unknowns=unknowns, definitions=definitions, whole=True)

    @cached_property
    def mass_matrix(self) -> sp.Matrix:
        """(n, n): of the kinetic energy ``v^T M v / 2``."""
        return self._inertia[0]

    @cached_property
    def generalised_forces(self) -> tuple[sp.Expr, ...]:
        """(n,): ``Q - b``, so that ``M a`` equals it where no contact is closed."""
        return tuple(q - b for q, b in zip(self._applied, self._inertia[1], strict=True))

    @cached_property
    def energy(self) -> sp.Expr:
        """Kinetic energy plus that of gravity."""
        kinetic = [
            entry * self.v[i] * self.v[k] / 2 for (i, k), entry in self.mass_matrix.todok().items()
        ]
        gx, gy = self.gravity
        potential = []
        for name, body in self.scene.bodies.items():
            (x, y), _ = self.body_frame(name)
            potential.append(-self._formula(body.mass) * (gx * x + gy * y))
        return sp.Add(*kinetic, *potential)

    @cached_property
    def controller_rates(self) -> dict[str, sp.Expr]:
        """Rates of the variables of controllers: symbols that states set, or 0."""
        flowing = self._controls.flowing
        return {
            name: sp.Symbol(f"d{symbol}", real=True) if name in flowing else sp.S.Zero
            for name, symbol in self.controller_state.items()
        }

    @cached_property
    def placed(self) -> dict[str, sp.Expr]:
        """Places and rates of bodies that formulas place, by their names in formulas."""
        found: dict[str, sp.Expr] = {}
        known = self.scene.placed_names
        for name, body in self.scene.bodies.items():
            if body.position is None:
                continue
            (x, y), angle = self.body_frame(name)
            for part, place in (("x", x), ("y", y), ("angle", angle)):
                remembered = (
                    sp.diff(place, symbol) * self.controller_rates[key]
                    for key, symbol in self.controller_state.items()
                    if symbol in place.free_symbols
                )
                found[f"{name}.{part}"] = place
                found[f"{name}.d{part}"] = sp.Add(self.rate(place), *remembered)
        return {name: expression for name, expression in found.items() if name in known}

    def gradient(self, place: sp.Expr) -> list[sp.Expr]:
        """Return the derivatives (n,) by the coordinates; few of many bodies' move a place."""
        used = place.free_symbols
        return [sp.diff(place, q) if q in used else sp.S.Zero for q in self.q]

    @cached_property
    def gravity(self) -> Vector:
        """Acceleration of gravity."""
        declared = self.scene.gravity
        if isinstance(declared, tuple):
            gx, gy = (self._formula(text) for text in declared)
            return gx, gy
        return sp.S.Zero, -self._formula(declared)

    def inertia(self, name: str, body: Body) -> tuple[sp.Expr, sp.Expr]:
        """Return the mass of a body, and its moment of inertia; 0 where it has none."""
        mass = self._formula(body.mass)
        if body.inertia is None:
            return mass, sp.S.Zero
        return mass, self.parameters.symbols[f"{name}.inertia"]

    @cached_property
    def applied_forces(self) -> tuple[sp.Expr, ...]:
        """(n,): what the declared forces do to every coordinate."""
        total = [sp.S.Zero] * len(self.q)
        for force in self.scene.forces.values():
            point = self.point(Point(body=force.body, at=force.at))
            _, angle = self.body_frame(force.body)
            components = [self._formula(text, **self.placed) for text in force.force]
            moment = self._formula(force.moment, **self.placed)
            for i, q in enumerate(self.q):
                work = [f * sp.diff(p, q) for f, p in zip(components, point, strict=True)]
                total[i] += sp.Add(*work, moment * sp.diff(angle, q))
        return tuple(total)

    @cached_property
    def _applied(self) -> tuple[sp.Expr, ...]:
        total = list(self.applied_forces)
        gx, gy = self.gravity
        for name, body in self.scene.bodies.items():
            (x, y), _ = self.body_frame(name)
            mass = self._formula(body.mass)
            for i, (dx, dy) in enumerate(zip(self.gradient(x), self.gradient(y), strict=True)):
                if dx != 0 or dy != 0:
                    total[i] += mass * (gx * dx + gy * dy)
        return tuple(total)

    @cached_property
    def _inertia(self) -> tuple[sp.Matrix, tuple[sp.Expr, ...]]:
        """Mass matrix and bias forces, summed over the bodies."""
        size = len(self.q)
        matrix = sp.zeros(size, size)
        bias = [sp.S.Zero] * size
        at_rest = dict.fromkeys(self.a, sp.S.Zero)
        for name, body in self.scene.bodies.items():
            (x, y), angle = self.body_frame(name)
            mass, inertia = self.inertia(name, body)
            for weight, position in ((mass, x), (mass, y), (inertia, angle)):
                gradient = self.gradient(position)
                moving = [i for i, g in enumerate(gradient) if g != 0]
                drift = self.rate(self.rate(position)).xreplace(at_rest)
                for i in moving:
                    bias[i] += weight * gradient[i] * drift
                    for k in moving:
                        matrix[i, k] += weight * gradient[i] * gradient[k]
        return matrix, tuple(bias)

    @cached_property
    def equations(self) -> tuple[sp.Expr, ...]:
        """(n + rows of joints that are never off,): each = 0, in accelerations and forces."""
        geometry = [self.contact(name) for name in self.scene.frictional]
        result = []
        for i, right in enumerate(self.generalised_forces):
            left = sp.Add(*self._nonzero([self.mass_matrix[i, k] for k in range(len(self.q))]))
            contact_forces = sp.Add(
                *(c.jacobian_n[i] * c.symbols.V for c in geometry if c.jacobian_n[i] != 0),
                *(c.jacobian_t[i] * c.symbols.H for c in geometry if c.jacobian_t[i] != 0),
            )
            joint_forces = sp.Add(
                *(row.jacobian[i] * row.force for row in self.joint_rows if row.jacobian[i] != 0)
            )
            result.append(left - right - contact_forces - joint_forces)
        lasting = (row for row in self.joint_rows if row.closed is None)
        return (*result, *(row.equation(self.a) for row in lasting))

    @cached_property
    def joint_rows(self) -> tuple[JointRow, ...]:
        """Rows of all joints, in the order of their declaration."""
        at_rest = dict.fromkeys(self.a, sp.S.Zero)
        rows: list[JointRow] = []
        for name, joint in self.scene.joints.items():
            for component, gap, path in self._held(name, joint):
                rate = self.rate(gap)
                rows.append(
                    JointRow(
                        name,
                        component,
                        gap,
                        rate,
                        self.rate(rate).xreplace(at_rest),
                        tuple(self.gradient(gap)),
                        sp.Symbol(f"{component}{len(rows)}", real=True),
                        path,
                        self.parameters.symbols[f"{name}.redundant_{component.lower()}"],
                        self._closed.get(name),
                    )
                )
        return tuple(rows)

    def _held(self, name: str, joint: Joint) -> Iterator[tuple[str, sp.Expr, sp.Expr]]:
        """Yield the components of a joint: what it holds at zero, and the rate of its path."""
        (x, y), (x0, y0) = self.point(joint.point), self.joint_end(joint.to)
        if joint.rod is not None:
            # Half the distance squared over the length: smooth, and the distance to first order.
            length = self._formula(joint.rod)
            apart = ((x - x0) ** 2 + (y - y0) ** 2 - length**2) / (2 * length)
            toward = (
                (x - x0) * sp.diff(x0, self.time) + (y - y0) * sp.diff(y0, self.time)
            ) / length + sp.diff(length, self.time)
            yield "T", -apart, -toward
            return
        for component, here, there in (("X", x, x0), ("Y", y, y0)):
            if component in joint.components:
                yield component, here - there, sp.diff(there, self.time)
        if joint.angle is not None:
            ends = (joint.point, joint.to)
            turns = [self.body_frame(e.body)[1] for e in ends if isinstance(e, Point)]
            held = self.known.get(f"{name}.turn", self.known.get(f"{name}.turn0"))
            yield "M", turns[0] - sp.Add(*turns[1:]) - held, sp.S.Zero

    @cached_property
    def unknown_forces(self) -> tuple[sp.Symbol, ...]:
        """Unknowns of modes beside the accelerations: of joints, contacts, couplings."""
        of_contacts = (force for pair in self.forces.values() for force in pair)
        return (*(row.force for row in self.joint_rows), *of_contacts, *self.couples.values())

    @cached_property
    def power(self) -> sp.Expr:
        """Power of the applied forces, gravity excepted, and of joints and surfaces that move."""
        applied = (q * v for q, v in zip(self.applied_forces, self.v, strict=True))
        pushed = (
            force * rate
            for name, forces in self.forces.items()
            for force, rate in zip(forces, self.surface_rate(name), strict=True)
        )
        # Springs of compliant contacts keep no energy that counts.
        soft = [self.contact(name).symbols for name in self.pads]
        pressed = (symbols.V * symbols.gap_rate for symbols in soft)
        led = (row.force * row.path_rate for row in self.joint_rows)
        return sp.Add(*applied, *pushed, *led, *pressed)

    def surface_rate(self, name: str) -> Vector:
        """Return the normal and tangential velocity of a contact's surface that moves in time."""
        surface = self.scene.surfaces[self.scene.contacts[name].surface]
        frame = surface_frame(surface, self.known)
        rates = [self.rate(expression) for expression in frame]
        swells = self.rate(self._formula(surface.radius or 0))
        if rates == [0, 0, 0]:
            return -swells if surface.hollow else swells, sp.S.Zero
        (n_x, n_y), (t_x, t_y) = self.contact(name).normal, self.contact(name).tangent
        # In its frame, as the normal and the point are.
        (x, y), (c, s) = self.contact(name).point, (sp.cos(frame[2]), sp.sin(frame[2]))
        moved = (
            c * rates[0] + s * rates[1] - rates[2] * y,
            c * rates[1] - s * rates[0] + rates[2] * x,
        )
        normal = n_x * moved[0] + n_y * moved[1]
        return normal - swells if surface.hollow else normal + swells, t_x * moved[0] + t_y * moved[
            1
        ]

    def contact(self, name: str) -> ContactGeometry:
        """Return the geometry of a contact or a coupling, derived when first asked for."""
        if name not in self._contacts:
            contact = self.scene.contacts.get(name)
            self._contacts[name] = (
                self._turning(name) if contact is None else self._geometry(name, contact)
            )
        return self._contacts[name]

    def sliding_edges(self, contact: ContactSymbols) -> tuple[sp.Expr, ...]:
        """Return the unit edges of a contact's cone in slide+ and slide-, at the slip's size."""
        law = self.scene.friction_of(contact.name)
        if law is None or not law.varies:
            return (*contact.friction.edges[1], *contact.friction.edges[-1])
        found: list[sp.Expr] = []
        for direction in (1, -1):
            mu = kinetic_friction(law, direction, self.known, sp.Abs(contact.slip))
            found += cone_edge(mu)
        return tuple(found)

    def limits(self, name: str) -> tuple[sp.Expr, sp.Expr]:
        """Return the bounds of a coupling's couple, at rest and in motion.

        Of rolling resistance, those over the normal force of its contact.
        """
        static, kinetic = self.scene.couplings[name].bounds
        return self._formula(static, **self.placed), self._formula(kinetic, **self.placed)

    def coupling(self, name: str) -> CouplingSymbols:
        """Return the quantities of a coupling."""
        static, kinetic = self.limits(name)
        coupling = self.scene.couplings[name]
        load = self.forces[coupling.contact][0] if isinstance(coupling, Rolling) else sp.S.One
        return CouplingSymbols(self.contact(name).symbols, static * load, kinetic * load)

    def sets(self, region: str, state: str) -> dict[sp.Symbol, sp.Expr]:
        """Return what a state of a controller sets: some of `controls`."""
        found: dict[sp.Symbol, sp.Expr] = {}
        for name, setting in self._switched.items():
            if setting == region:
                for key, symbol in self._coefficients[name].items():
                    found[symbol] = self.parameters.symbols[f"{name}.{key}.{state}"]
        for control, text in self._controls.values(region, state).items():
            found[self.known[control]] = self._formula(text)
        flows = self._controls.flows(region, state)
        own = {*self.scene.regions[region].variables, *self._controls.flat[region].timers}
        for name in own & self._led.keys():
            rate, acceleration = self._led[name]
            found[rate] = self._formula(flows.get(name, 0))
            found[acceleration] = self.rate(found[rate])
        active = self._controls.flat[region].active(state)
        for (asked, name), symbol in self._asked.items():
            if asked == region:
                found[symbol] = sp.Integer(1 if name in active else -1)
        if region in self._closed:
            found[self._closed[region]] = sp.Integer(state == CLOSED)
        return found

    def controlled(self, states: Mapping[str, str] | None = None) -> list[Definition]:
        """Return the values of `controls`, in order, in `states` of the controllers.

        Those at the start by default.
        """
        found = {
            used: self._coefficients[name]["static"] for name, used in self.used_friction.items()
        }
        for region, state in (states or self._controls.initial).items():
            found |= self.sets(region, state)
        return [(symbol, found[symbol]) for symbol in self.controls]

    @property
    def observables(self) -> dict[str, sp.Expr]:
        """Quantities that outputs and stop conditions may use, name -> expression."""
        result = {**self.known, **self.placed}
        for name in self.scene.contacts:
            symbols = self.contact(name).symbols
            result |= {
                f"{name}.gap": symbols.gap,
                f"{name}.slip": symbols.slip,
                f"{name}.V": symbols.V,
                f"{name}.H": symbols.H,
            }
        for name, couple in self.couples.items():
            result |= {f"{name}.slip": self.contact(name).symbols.slip, f"{name}.M": couple}
        result |= {f"{row.joint}.{row.component}": row.force for row in self.joint_rows}
        result |= {f"{name}.friction": used for name, used in self.used_friction.items()}
        for name in self._switched.keys() - self.used_friction.keys():
            result[f"{name}.friction"] = self._coefficients[name]["friction"]
        for name, joint in self.scene.joints.items():
            if joint.limits is not None and not self.scene.collisions:
                low, high = (self.forces[stop][0] for stop in stops(name))
                result[f"{name}.M"] = self._arm(joint.point) * (low - high)
        result["energy"] = self.energy
        return result

    def gate(self, name: str) -> Gate | None:
        """Return what keeps a contact on; None where it has no conditions and no ends."""
        scene = self.scene
        coupling = scene.couplings.get(name)
        contact = coupling or scene.contacts[name]
        if name not in self._gates:
            known = self.known | {
                f"{other}.{quantity}": getattr(self.contact(other).symbols, quantity)
                for other in scene.frictional
                for quantity in (("slip",) if other in scene.couplings else ("gap", "slip"))
                if contact.enabled
            }
            ends: dict[str, sp.Expr] = {}
            edge = None if coupling else scene.surface_of(name).edge
            if edge is not None:
                (x0, y0), (x1, y1) = self._corners(edge)
                x, y = self.contact(name).point
                length = sp.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2)
                along = ((x1 - x0) * (x - x0) + (y1 - y0) * (y - y0)) / length
                ends = {"begin of its edge": along, "end of its edge": length - along}
            gated = contact.enabled or ends
            self._gates[name] = (
                gate_of(
                    f"{name}.{DISENGAGED if coupling else OFF}",
                    contact.enabled,
                    known,
                    self._asked,
                    ends,
                )
                if gated
                else None
            )
        return self._gates[name]

    def valleys(self, name: str, *, acute: bool = False) -> dict[str, sp.Expr]:
        """Return how sharply edges for the same point turn up at the ends of a contact's edge.

        Ends are named as in `gate`. A positive value is a valley: what is beyond the end is below
        the other edge; an `acute` one has an angle below 90 degrees.
        """
        contact, found = self.scene.contacts[name], {}
        surface = self.scene.surfaces[contact.surface]
        for other in self.scene.contacts.values():
            beside = self.scene.surfaces[other.surface]
            moved = {"edge": surface.edge}
            if (
                surface.edge is None
                or beside.edge is None
                or (other.point, other.radius) != (contact.point, contact.radius)
                or beside.model_copy(update=moved) != surface
            ):
                continue
            one, two = self._corners(surface.edge), self._corners(beside.edge)
            (ax, ay), (bx, by) = ((x1 - x0, y1 - y0) for (x0, y0), (x1, y1) in (one, two))
            turns = ax * by - ay * bx
            back = (-ax * bx - ay * by,) if acute else ()
            if one[1] == two[0]:
                found[f"{name}: end of its edge"] = sp.Min(turns, *back)
            if one[0] == two[1]:
                found[f"{name}: begin of its edge"] = sp.Min(-turns, *back)
        return found

    def _stuck(
        self, name: str, contact: Contact, anchor: Vector, tangent: Vector
    ) -> tuple[Vector, dict[sp.Symbol, sp.Expr]]:
        """Return what is zero as long as a contact point does not move, and its constants.

        In the world's frame, where coordinates of positions are what they are.
        """
        x, y = (sp.Symbol(f"{name}.{axis}0", real=True) for axis in "xy")
        anchors = {x: anchor[0], y: anchor[1]}
        along, across = self._rim(contact).centre((x, y), tangent)
        surface, point = self.scene.surfaces[contact.surface], self.point(contact.point)
        if surface.body is None:
            here = self._in_frame(surface, point)
            return (here[0] - along, here[1] - across), anchors
        (x0, y0), angle = self.body_frame(surface.body)
        c, s = sp.cos(angle), sp.sin(angle)
        return (
            point[0] - x0 - c * along + s * across,
            point[1] - y0 - s * along - c * across,
        ), anchors

    def _surface_geometry(
        self, surface: Surface, radius: sp.Expr, centre: Vector
    ) -> _SurfaceGeometry:
        """Return the geometry of a surface near a point, at a radius from it."""
        # The surface is differentiated in its own coordinates and the point in those of its body:
        # both are short, where gap(q) and its second derivative are long.
        own = sp.Dummy("x", real=True), sp.Dummy("y", real=True)
        here = dict(zip(own, centre, strict=True))
        function, direction, factor = self._surface(surface, *own)
        # For a disc the function is linear, or a distance.
        function -= radius / factor
        # A rope that is hauled in: its circle shrinks.
        swells = self.rate(function)
        at_rest = dict.fromkeys(self.a, sp.S.Zero)
        rates = self.rate(centre[0]), self.rate(centre[1])
        drifts = self.rate(rates[0]).xreplace(at_rest), self.rate(rates[1]).xreplace(at_rest)
        gradient = [sp.diff(function, u) for u in own]
        along = [sp.diff(direction[1], u) for u in own], [-sp.diff(direction[0], u) for u in own]
        curvature = [[sp.diff(slope, u) for u in own] for slope in gradient]

        def times(rows: Sequence[sp.Expr], columns: Sequence[sp.Expr]) -> sp.Expr:
            return sp.Add(*(r.xreplace(here) * c for r, c in zip(rows, columns, strict=True)))

        def bent(rows: Sequence[Sequence[sp.Expr]]) -> sp.Expr:
            return sp.Add(*(times(r, rates) * rate for r, rate in zip(rows, rates, strict=True)))

        unit = factor.xreplace(here)
        return _SurfaceGeometry(
            function.xreplace(here),
            unit * function.xreplace(here),
            unit * (times(gradient, rates) + swells),
            # On the surface (gap = gap' = 0) this is the derivative of the normal velocity.
            unit * (times(gradient, drifts) + bent(curvature) + self.rate(swells)),
            (direction[0].xreplace(here), direction[1].xreplace(here)),
            rates,
            drifts,
            bent(along),
        )

    def _nonzero(self, row: Sequence[sp.Expr]) -> list[sp.Expr]:
        """Return the terms of a row of coefficients times the accelerations."""
        return [j * a for j, a in zip(row, self.a, strict=True) if j != 0]

    @cached_property
    def pads(self) -> dict[str, int]:
        """Compliant contacts -> numbers of their pads.

        A pad is a coordinate behind those of the scene: the normal force of its contact holds it
        against the spring, so that forces are found as those of rigid contacts.
        """
        soft = (n for n, one in self.scene.contacts.items() if one.stiffness is not None)
        return {name: k for k, name in enumerate(soft)}

    @property
    def _no_pads(self) -> tuple[sp.Expr, ...]:
        return (sp.S.Zero,) * len(self.pads)

    def _padded(
        self, name: str, normal: Sequence[sp.Expr], along: Sequence[sp.Expr]
    ) -> tuple[tuple[sp.Expr, ...], tuple[sp.Expr, ...]]:
        """Return what forces of a contact do to every coordinate, pads included."""
        pads = [*self._no_pads]
        if name in self.pads:
            normal = (sp.S.Zero,) * len(normal)
            pads[self.pads[name]] = sp.S.One
        return (*normal, *pads), (*along, *self._no_pads)

    def _compliance(self, contact: Contact, around: _SurfaceGeometry) -> sp.Expr | None:
        """Return the normal force of a compliant contact that is closed."""
        if contact.stiffness is None:
            return None
        k, d = (self._formula(text or 0) for text in (contact.stiffness, contact.damping))
        return -k * around.gap - d * around.gap_rate

    def _turning(self, name: str) -> ContactGeometry:
        """Return the geometry of a coupling: its slip is a rate of angles, its gap is closed."""
        along = self.scene.along_guide(name)
        if along:
            joint = self.scene.joints[self.scene.couplings[name].joint or ""]
            turn = self.point(joint.point)["XY".index(along)]
        elif isinstance(coupling := self.scene.couplings[name], Rolling):
            turn = self._rim(self.scene.contacts[coupling.contact]).turn
        else:
            angles = [self.body_frame(body)[1] for body in self.scene.coupled(name)]
            turn = angles[0] - sp.Add(*angles[1:])
        zero, none = sp.S.Zero, (sp.S.Zero,) * len(self.q)
        slip = self.rate(turn)
        jacobian = tuple(self.gradient(turn))
        bias = self.rate(slip).xreplace(dict.fromkeys(self.a, zero))
        acceleration = sp.Add(bias, *self._nonzero(jacobian))
        anchor = sp.Symbol(f"{name}.angle0", real=True)
        couple = self.couples[name]
        symbols = ContactSymbols(
            name, zero, zero, zero, slip, zero, acceleration, zero, couple,
            friction_cones(self.scene, name, None, self.known, slip),
            self._padded(name, none, jacobian),
            tuple((*row.jacobian, *self._no_pads) for row in self.joint_rows),
            tuple(row.force for row in self.joint_rows), Hold((), (), ()),
            Hold((turn - anchor,), (acceleration,), (couple,), {anchor: turn}),
        )  # fmt: skip
        place, tangent = (turn, zero), (sp.S.One, zero)
        return ContactGeometry(
            place, place, tangent, (zero, sp.S.One), tangent, symbols, none, jacobian, zero, bias
        )

    def _arm(self, point: Point) -> sp.Expr:
        """Return the length that makes lengths of angles: the radius of gyration about a point."""
        mass, inertia = self.inertia(point.body, self.scene.bodies[point.body])
        x, y = (self._formula(text) for text in point.at)
        return sp.sqrt(inertia / mass + x**2 + y**2)

    def _stop(self, name: str, contact: Contact, stop: Stop) -> ContactGeometry:
        """Return the geometry of a limit of an angle: a gap that nothing slips along."""
        turn = self.body_frame(contact.point.body)[1] - self._formula(stop.limit)
        if stop.other is not None:
            turn -= self.body_frame(stop.other)[1]
        turn *= stop.side
        gap, (V, H) = self._arm(contact.point) * turn, self.forces[name]
        rate, zeros = self.rate(gap), (sp.S.Zero,) * len(self.q)
        jacobian, none = tuple(self.gradient(gap)), (sp.S.Zero, sp.S.Zero)
        bias = self.rate(rate).xreplace(dict.fromkeys(self.a, sp.S.Zero))
        bearing = sp.Add(bias, *self._nonzero(jacobian))
        hold = Hold((turn,), (bearing,), (V,))
        offset = self.parameters.symbols.get(f"{name}.{GAP_OFFSET}", sp.S.Zero)
        symbols = ContactSymbols(
            name, gap, offset, rate, sp.S.Zero, bearing, sp.S.Zero, V, H,
            friction_cones(self.scene, name, None, self.known, sp.S.Zero),
            self._padded(name, jacobian, zeros),
            tuple((*row.jacobian, *self._no_pads) for row in self.joint_rows),
            tuple(row.force for row in self.joint_rows), hold, hold,
        )  # fmt: skip
        x, y = self.point(contact.point)
        return ContactGeometry(
            (x, y), none, (sp.S.One, sp.S.Zero), (sp.S.Zero, sp.S.One), (sp.S.One, sp.S.Zero),
            symbols, jacobian, zeros, bias, sp.S.Zero,
        )  # fmt: skip

    def _geometry(self, name: str, contact: Contact) -> ContactGeometry:
        surface = self.scene.surfaces[contact.surface]
        if isinstance(surface, Stop):
            return self._stop(name, contact, surface)
        x, y = centre = self._in_frame(surface, self.point(contact.point))
        rim = self._rim(contact)
        around = self._surface_geometry(surface, rim.radius, centre)
        normal, rates, drifts = around.normal, around.rates, around.drifts
        tangent = (normal[1], -normal[0])
        jacobian = list(
            zip(self.gradient(x), self.gradient(y), self.gradient(rim.turn), strict=True)
        )
        jacobian_n = tuple(
            normal[0] * dx + normal[1] * dy if dx != 0 or dy != 0 else sp.S.Zero
            for dx, dy, _ in jacobian
        )
        jacobian_t = tuple(
            tangent[0] * dx + tangent[1] * dy + rim.radius * turn
            if dx != 0 or dy != 0 or turn != 0
            else sp.S.Zero
            for dx, dy, turn in jacobian
        )
        rolling = self.rate(rim.radius * rim.turn)
        slip = tangent[0] * rates[0] + tangent[1] * rates[1] + rolling
        bias_n = around.bias
        bias_t = tangent[0] * drifts[0] + tangent[1] * drifts[1] + around.turned
        bias_t += self.rate(rolling).xreplace(dict.fromkeys(self.a, sp.S.Zero))
        V, H = self.forces[name]
        anchor, slipping = rim.anchored(centre, tangent)
        stuck, anchors = self._stuck(name, contact, anchor, tangent)
        normal_a = sp.Add(bias_n, *self._nonzero(jacobian_n))
        tangential_a = sp.Add(bias_t, *self._nonzero(jacobian_t))
        offset = self.parameters.symbols.get(f"{name}.{GAP_OFFSET}", sp.S.Zero)
        symbols = ContactSymbols(
            name, around.gap, offset, around.gap_rate, slip, normal_a, tangential_a, V, H,
            friction_cones(self.scene, name, self._coefficients.get(name), self.known, slip),
            self._padded(name, jacobian_n, jacobian_t),
            tuple((*row.jacobian, *self._no_pads) for row in self.joint_rows),
            tuple(row.force for row in self.joint_rows),
            # Not its distance: of the height of a ground y follows with a factor of 1.
            Hold((around.function,), (normal_a,), (V,), steep=self.curved(name)),
            Hold(stuck, (normal_a, tangential_a), (V, H), anchors),
            self._compliance(contact, around),
        )  # fmt: skip
        point = x - rim.radius * normal[0], y - rim.radius * normal[1]
        return ContactGeometry(
            point, anchor, slipping, normal, tangent, symbols,
            jacobian_n, jacobian_t, bias_n, bias_t,
        )  # fmt: skip
