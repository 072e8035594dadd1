"""Equations of motion of bodies with contacts and joints, derived by SymPy from positions.

``M(q) a + b(q, v) = Q + sum J_n^T V + J_t^T H + sum J^T X`` (contacts, joints); expressions are not
simplified.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property
from itertools import chain
from typing import NamedTuple

import sympy as sp

from contacts.dynamics.gates import Gate, gate_of
from contacts.dynamics.geometry import (
    Geometry,
    Vector,
    in_world,
    linear_combination,
    rotation,
    surface_frame,
)
from contacts.dynamics.joints import JointRow
from contacts.dynamics.parameters import (
    GAP_OFFSET,
    HELD_FORCE,
    LEVER,
    SIZE,
    cone_edge,
    friction_cones,
    friction_symbols,
    kinetic_friction,
    scene_parameters,
)
from contacts.scene.couplings import CouplingSymbols, Rolling
from contacts.scene.expansion import Stop, is_switched, limit_contacts, reach_of
from contacts.scene.joints import Joint
from contacts.scene.modes import ContactSymbols, Row
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from contacts.states import CLOSED, DISENGAGED, OFF
from statechart.automaton.regions import Hold, Margin
from statechart.documents.fields import replace_fields
from statechart.errors import NoConsistentMode
from statechart.formulas.linear import Definition
from statechart.formulas.parameters import Parameters
from statechart.formulas.tape import Tape
from statechart.formulas.writer import Min, compile_tape

HAULED = "length"
"""Margin of a rope that is hauled in."""
# Part of its length at the start at which a rope that is hauled in ends the run.
_MIN_LENGTH = 1e-3


def winch_end_message(name: str, time: float) -> NoConsistentMode:
    """Return why a run ends at a time at which a rope is hauled in to next to nothing."""
    return NoConsistentMode(
        f"rope {name!r} is hauled in to {_MIN_LENGTH:g} of its length at the start by "
        f"t = {time:.7g}; stop the winch before, or the run by a stop condition"
    )


class _SurfaceGeometry(NamedTuple):
    """Geometry of a surface near a point."""

    # `function`, `gap`, `gap_rate`: Implicit function of the surface; distance and its rate
    function: sp.Expr
    gap: sp.Expr
    gap_rate: sp.Expr
    bias: sp.Expr  # Second derivative of the gap at zero accelerations
    # `normal`, `rates`, `drifts`: Unit normal; velocity of the point, and its acceleration at zero
    # accelerations, along x and y
    normal: Vector
    rates: Vector
    drifts: Vector
    turned: sp.Expr  # Contribution of the tangent's rotation to the derivative of the slip


class Mechanics(Geometry):
    """The equations of a scene; its `parameters` are those of `scene_parameters` by default."""

    def __init__(self, scene: Scene, parameters: Parameters | None = None) -> None:
        declared = parameters or scene_parameters(scene)
        symbols = declared.symbols
        controlled = scene.controlled
        controls = {n: sp.Symbol(f"c{i}", real=True) for i, n in enumerate(controlled.order)}
        # Controllers' variables are parameters of the contact laws: constant at an instant.
        self.controller_state = {
            n: sp.Symbol(f"w{i}", real=True) for i, n in enumerate(controlled.controller_state)
        }
        # Rates and accelerations of the controllers' variables on which paths of surfaces depend.
        self._led = {
            name: (sp.Symbol(f"rate_{symbol}", real=True),
                   sp.Symbol(f"acceleration_{symbol}", real=True))
            for name, symbol in self.controller_state.items() if name in scene.leading
        }  # fmt: skip
        carried = {self.controller_state[name]: rate for name, (rate, _) in self._led.items()}
        carried |= dict(self._led.values())
        super().__init__(scene, {**symbols, **controls, **self.controller_state}, carried)
        self.state_names = (*self.variable_names, *self.controller_state)
        self.state = (*self.variables, *self.controller_state.values())
        self.parameters = declared
        self.forces = {
            name: (sp.Symbol(f"V{i}", real=True), sp.Symbol(f"H{i}", real=True))
            for i, name in enumerate(scene.contacts)
        }
        # Couples of couplings over their levers; their limits take the role of normal forces.
        self.couples = {
            name: sp.Symbol(f"M{i}", real=True) for i, name in enumerate(scene.couplings)
        }
        self._controls = controlled
        self._coefficients = friction_symbols(scene, symbols)
        # Contacts whose coefficients are set by the states of a region.
        self._switched = {
            name: region
            for name in self._coefficients
            if (law := scene.friction_of(name)) is not None
            and (region := controlled.region_of(law.both)) is not None
        }
        # The coefficient in use, for contacts with a static and a kinetic one.
        self.used_friction = {
            name: sp.Symbol(f"{name}.friction", real=True)
            for name, coefficients in self._coefficients.items()
            if "static" in coefficients
        }
        self.state_symbols = {
            (member.region, member.state): sp.Symbol(f"in{i}", real=True)
            for i, member in enumerate(scene.condition_states)
        }
        # Joints that can be off: 1 while they are closed.
        self._closed = {
            name: sp.Symbol(f"on{i}", real=True)
            for i, (name, joint) in enumerate(scene.joints.items())
            if is_switched(joint)
        }
        # Symbols that states of controllers set, in order of dependence: coefficients of contacts,
        # the scene's controls, motions of surfaces, friction that varies with the slip on them, and
        # rates of controllers' variables.
        self.controls = (
            *(symbol for name in self._switched for symbol in self._coefficients[name].values()),
            *controls.values(),
            *self.state_symbols.values(),
            *self._closed.values(),
            *(rate for rate, _ in self._led.values()),
            *(acceleration for _, acceleration in self._led.values()),
            *self.used_friction.values(),
            *(rate for rate in self.controller_rates.values() if rate != 0),
        )
        self._contacts: dict[str, ContactSymbols] = {}
        self.gate = cache(self._gate)

    @cached_property
    def held_forces(self) -> list[int]:
        """Indices of the parameters of `contacts.dynamics.held_forces`; none without switches."""
        names = self.parameters.names
        return [index for index, name in enumerate(names) if name.startswith(HELD_FORCE)]

    def tape(
        self,
        outputs: Sequence[sp.Expr],
        *,
        unknowns: Sequence[sp.Symbol] = (),
        definitions: Sequence[Definition] = (),
    ) -> Tape:
        """Compile expressions of the state followed by `unknowns`, the parameters, and time."""
        return compile_tape(
            outputs,
            variables=(*self.state, *unknowns),
            parameters=self.parameters.ordered,
            time=self.time,
            definitions=definitions,
        )

    @cached_property
    def mass_matrix(self) -> tuple[Row, ...]:
        """Rows (n,) of M in the kinetic energy ``v^T M v / 2``."""
        return self._inertia[0]

    @cached_property
    def generalised_forces(self) -> tuple[sp.Expr, ...]:
        """``Q - b`` (n,), which equals ``M a`` without contact and joint forces."""
        gx, gy = self.gravity
        forces = [(sp.S.One, self.applied_forces)]
        for name, body in self.scene.bodies.items():
            (x, y), _ = self.body_frame(name)
            pull = linear_combination((gx, self.gradient(x)), (gy, self.gradient(y)))
            forces.append((self.formula(body.mass), pull))
        total = self.dense([linear_combination(*forces)])
        return tuple(q - b for q, b in zip(total, self._inertia[1], strict=True))

    @cached_property
    def energy(self) -> sp.Expr:
        """Kinetic energy plus that of gravity."""
        terms = [
            entry * self.v[i] * self.v[k] / 2
            for i, row in enumerate(self.mass_matrix)
            for k, entry in row.items()
        ]
        gx, gy = self.gravity
        for name, body in self.scene.bodies.items():
            (x, y), _ = self.body_frame(name)
            terms.append(-self.formula(body.mass) * (gx * x + gy * y))
        return sp.Add(*terms)

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
        """Positions and rates of bodies that are placed by formulas, by their names in formulas."""
        expressions: dict[str, sp.Expr] = {}
        for name in (n for n, body in self.scene.bodies.items() if body.position is not None):
            (x, y), angle = self.body_frame(name)
            for component, place in (("x", x), ("y", y), ("angle", angle)):
                remembered = (
                    sp.diff(place, symbol) * self.controller_rates[key]
                    for key, symbol in self.controller_state.items()
                    if symbol in place.free_symbols
                )
                expressions[f"{name}.{component}"] = place
                expressions[f"{name}.d{component}"] = sp.Add(self.rate(place), *remembered)
        return {name: expressions[name] for name in expressions if name in self.scene.placed_names}

    @cached_property
    def gravity(self) -> Vector:
        """Acceleration of gravity."""
        declared = self.scene.gravity
        if isinstance(declared, tuple):
            return self.vector(declared)
        return sp.S.Zero, -self.formula(declared)

    def inertia(self, name: str, body: Body) -> tuple[sp.Expr, sp.Expr]:
        """Return the mass of a body and its moment of inertia, 0 by default."""
        mass = self.formula(body.mass)
        if body.inertia is None:
            return mass, sp.S.Zero
        return mass, self.parameters.symbols[f"{name}.inertia"]

    @cached_property
    def applied_forces(self) -> Row:
        """Generalised forces of the declared forces."""
        work: list[tuple[sp.Expr, Row]] = []
        for force in self.scene.forces.values():
            point = self.point(Point(body=force.body, at=force.at))
            places = *point, self.body_frame(force.body)[1]
            components = [self.formula(t, **self.placed) for t in (*force.force, force.moment)]
            work += zip(components, map(self.gradient, places), strict=True)
        return linear_combination(*work)

    @cached_property
    def _inertia(self) -> tuple[tuple[Row, ...], list[sp.Expr]]:
        """Mass matrix and bias forces, summed over the bodies."""
        matrix: tuple[Row, ...] = tuple({} for _ in self.q)
        bias = [sp.S.Zero] * len(self.q)
        for name, body in self.scene.bodies.items():
            (x, y), angle = self.body_frame(name)
            mass, inertia = self.inertia(name, body)
            for weight, position in ((mass, x), (mass, y), (inertia, angle)):
                gradient = self.gradient(position)
                drift = self.drift(self.rate(position))
                for i, slope in gradient.items():
                    bias[i] += weight * slope * drift
                    for k, other in gradient.items():
                        matrix[i][k] = matrix[i].get(k, sp.S.Zero) + weight * slope * other
        return matrix, bias

    @cached_property
    def equations(self) -> tuple[sp.Expr, ...]:
        """(n + rows of joints that are never off,): each = 0, in accelerations and forces."""
        terms = [
            [*self._times_a(row), -force]
            for row, force in zip(self.mass_matrix, self.generalised_forces, strict=True)
        ]
        for force, row in self.constraint_rows.items():
            for i, entry in row.items():
                terms[i].append(-(entry * force))
        lasting = (row for row in self.joint_rows if row.closed is None)
        return (*(sp.Add(*sides) for sides in terms), *(row.equation(self.a) for row in lasting))

    @cached_property
    def constraint_rows(self) -> dict[sp.Expr, Row]:
        """Forces of joints, contacts and couplings -> derivatives of the rates they work on."""
        rows = dict[sp.Expr, Row](self._reactions)
        for contact in map(self.contact, self.scene.frictional):
            rows |= {contact.V: contact.jacobian_n, contact.H: contact.jacobian_t}
        return rows

    @cached_property
    def joint_rows(self) -> tuple[JointRow, ...]:
        """Rows of all joints, in the order of their declaration."""
        rows: list[JointRow] = []
        for name, joint in self.scene.joints.items():
            for component, gap, path in self._components(name, joint):
                rate, jacobian, bias, _ = self._motion(gap)
                force = sp.Symbol(f"{component}{len(rows)}", real=True)
                redundant = self.parameters.symbols[f"{name}.redundant_{component.lower()}"]
                motion, closed = (gap, rate, bias, jacobian), self._closed.get(name)
                rows.append(JointRow(name, component, force, *motion, path, redundant, closed))
        return tuple(rows)

    def _components(self, name: str, joint: Joint) -> Iterator[tuple[str, sp.Expr, sp.Expr]]:
        """Yield name, gap, and rate of the path of every component of a joint."""
        (x, y), (x0, y0) = self.point(joint.point), self.joint_end(joint.to)
        if joint.rod is not None:
            # Half the distance squared over the length: smooth, and the distance to first order.
            length = self.formula(joint.rod)
            stretch = ((x - x0) ** 2 + (y - y0) ** 2 - length**2) / (2 * length)
            stretch_rate = (
                (x - x0) * sp.diff(x0, self.time) + (y - y0) * sp.diff(y0, self.time)
            ) / length + sp.diff(length, self.time)
            yield "T", -stretch, -stretch_rate
            return
        for component, end, target in (("X", x, x0), ("Y", y, y0)):
            if component in joint.components:
                yield component, end - target, sp.diff(target, self.time)
        if joint.angle is not None:
            turns = [self.body_frame(end.body)[1] for end in joint.ends.values()]
            angle = self.known.get(f"{name}.turn", self.known.get(f"{name}.turn0"))
            yield "M", turns[0] - sp.Add(*turns[1:]) - angle, sp.S.Zero

    @cached_property
    def unknown_forces(self) -> tuple[sp.Symbol, ...]:
        """Unknown forces of joints, contacts and couplings."""
        of_contacts = chain.from_iterable(self.forces.values())
        return (*(row.force for row in self.joint_rows), *of_contacts, *self.couples.values())

    @property
    def solved(self) -> tuple[sp.Symbol, ...]:
        """Unknowns of a time step: accelerations, forces, and controls."""
        return (*self.a, *self.unknown_forces, *self.controls)

    @cached_property
    def power(self) -> sp.Expr:
        """Power of the applied forces, gravity excepted, and of joints and surfaces that move."""
        work = [(force, self.v[i]) for i, force in self.applied_forces.items()]
        for name, forces in self.forces.items():
            work += zip(forces, self.surface_rate(name), strict=True)
        work += [(row.force, row.path_rate) for row in self.joint_rows]
        # The energy of compliant contacts is not part of `energy`.
        work += [(symbols.V, symbols.gap_rate) for symbols in map(self.contact, self.pads)]
        return sp.Add(*(force * rate for force, rate in work))

    def hauled(self, name: str) -> tuple[Margin, ...]:
        """Return the margin that falls where a rope is hauled in to next to nothing.

        A point that circles the end of a rope turns ever faster, as the square of its length.
        """
        rope = self.scene.surfaces.get(reach_of(name))
        length = self.formula((rope and rope.radius) or 0)
        if length.free_symbols <= {*self.parameters.ordered}:
            return ()
        controlled = self.scene.controlled
        texts = {**controlled.controller_state, **controlled.declared}
        start = {self.known[n]: self.formula(text) for n, text in texts.items()}
        for _ in texts:
            start = {symbol: value.xreplace(start) for symbol, value in start.items()}
        first = length.xreplace(start).xreplace({self.time: sp.S.Zero})
        return (Margin(f"{name}.{HAULED}", length - _MIN_LENGTH * first, "gap"),)

    def surface_rate(self, name: str) -> Vector:
        """Return the normal and tangential velocity of a contact's surface that moves in time."""
        surface = self.scene.surface_of(name)
        frame = surface_frame(surface, self.known)
        dx, dy, turn = (self.rate(expression) for expression in frame)
        growth = self.rate(self.formula(surface.radius or 0)) * (-1 if surface.hollow else 1)
        if dx == dy == turn == 0:
            return growth, sp.S.Zero
        # In its frame, as the normal and the point are.
        (x, y), (n_x, n_y) = self.contact(name).point, self.contact(name).normal
        own_dx, own_dy = rotation(-frame[2])((dx, dy))
        u, w = own_dx - turn * y, own_dy + turn * x
        return n_x * u + n_y * w + growth, n_y * u - n_x * w

    def contact(self, name: str) -> ContactSymbols:
        """Return the quantities of a contact or a coupling; cached."""
        if name not in self._contacts:
            build = self._symbols if name in self.scene.contacts else self._coupling_symbols
            self._contacts[name] = build(name)
        return self._contacts[name]

    def sliding_edges(self, contact: ContactSymbols) -> tuple[sp.Expr, ...]:
        """Return the unit edges of a contact's cone in slide+ and slide-, at the slip's size."""
        law = self.scene.friction_of(contact.name)
        if law is None or not law.varies:
            return (*contact.friction.edges[1], *contact.friction.edges[-1])
        speed = sp.Abs(contact.slip)
        mus = (kinetic_friction(law, direction, self.known, speed) for direction in (1, -1))
        return tuple(component for mu in mus for component in cone_edge(mu))

    def limits(self, name: str) -> tuple[sp.Expr, sp.Expr]:
        """Return the bounds of a coupling's couple over its lever, at rest and in motion.

        Those of rolling resistance are divided by the normal force of its contact.
        """
        bounds, lever = self.scene.couplings[name].bounds, self.lever(name)
        static, kinetic = (self.formula(bound, **self.placed) / lever for bound in bounds)
        return static, kinetic

    def lever(self, name: str) -> sp.Expr:
        """Return the length that converts angles of a coupling to lengths; 1 along a guide."""
        lever: sp.Expr = self.parameters.symbols.get(LEVER, sp.S.One)
        return sp.S.One if self.scene.along_guide(name) else lever

    def coupling(self, name: str) -> CouplingSymbols:
        """Return the quantities of a coupling."""
        static, kinetic = self.limits(name)
        coupling = self.scene.couplings[name]
        load = self.forces[coupling.contact][0] if isinstance(coupling, Rolling) else sp.S.One
        return CouplingSymbols(self.contact(name), static * load, kinetic * load, self.lever(name))

    def sets(self, region: str, state: str) -> dict[sp.Symbol, sp.Expr]:
        """Return the values of the `controls` that a state of a controller sets."""
        values: dict[sp.Symbol, sp.Expr] = {}
        for name in (name for name, setting in self._switched.items() if setting == region):
            for key, symbol in self._coefficients[name].items():
                values[symbol] = self.parameters.symbols[f"{name}.{key}.{state}"]
        for control, text in self._controls.values(region, state).items():
            values[self.known[control]] = self.formula(text)
        flows = self._controls.flows(region, state)
        values |= {self.controller_rates[v]: self.formula(text) for v, text in flows.items()}
        variables = {*self.scene.regions[region].variables, *self._controls.flat[region].timers}
        for name in variables & self._led.keys():
            rate, acceleration = self._led[name]
            values[rate] = self.formula(flows.get(name, 0))
            values[acceleration] = self.rate(values[rate])
        active = self._controls.flat[region].active(state)
        for (controller, name), symbol in self.state_symbols.items():
            if controller == region:
                values[symbol] = sp.Integer(1 if name in active else -1)
        if region in self._closed:
            values[self._closed[region]] = sp.Integer(state == CLOSED)
        return values

    def controlled(self, states: Mapping[str, str] | None = None) -> list[Definition]:
        """Return the values of `controls`, in order, in `states`, by default the initial ones."""
        values = {
            used: self._coefficients[name]["static"] for name, used in self.used_friction.items()
        }
        for region, state in (states or self._controls.initial).items():
            values |= self.sets(region, state)
        return [(symbol, values[symbol]) for symbol in self.controls]

    def values_in(self, states: Mapping[str, str] | None) -> dict[sp.Symbol, sp.Expr]:
        """Return the values of `controlled`, substituted into each other."""
        values: dict[sp.Symbol, sp.Expr] = {}
        for symbol, value in self.controlled(states):
            values[symbol] = value.xreplace(values)
        return values

    def controller_rates_in(self, known: Mapping[sp.Symbol, sp.Expr]) -> dict[sp.Symbol, sp.Expr]:
        """Return the rates of the controllers' variables, with the values of `values_in`."""
        rates = self.controller_rates.items()
        return {self.controller_state[name]: rate.xreplace(known) for name, rate in rates}

    @property
    def observables(self) -> dict[str, sp.Expr]:
        """Expressions of the quantities that outputs and stop conditions may use, by name."""
        result = {**self.known, **self.placed}
        for name in self.scene.contacts:
            symbols = self.contact(name)
            result |= {f"{name}.{key}": getattr(symbols, key) for key in ("gap", "slip", "V", "H")}
        for name, couple in self.couples.items():
            lever = self.lever(name)
            result |= {f"{name}.slip": self.contact(name).slip / lever, f"{name}.M": lever * couple}
        result |= {f"{row.joint}.{row.component}": row.force for row in self.joint_rows}
        result |= {f"{name}.friction": used for name, used in self.used_friction.items()}
        for name in self._switched.keys() - self.used_friction.keys():
            result[f"{name}.friction"] = self._coefficients[name]["friction"]
        for name, joint in self.scene.joints.items():
            if joint.limits is not None and not self.scene.collisions:
                low, high = (self.forces[stop][0] for stop in limit_contacts(name))
                result[f"{name}.M"] = self._arm(joint.point) * (low - high)
        result["energy"] = self.energy
        return result

    @cached_property
    def sizes(self) -> dict[sp.Symbol, sp.Symbol]:
        """Coordinates and rates -> parameters that are their sizes; none without `enabled`."""
        parameters = self.parameters.symbols
        sizes = [symbol for name, symbol in parameters.items() if name.startswith(SIZE)]
        return dict(zip(self.variables, sizes, strict=False))

    @cached_property
    def _relation_names(self) -> dict[str, sp.Expr]:
        """Expressions of the names in relations of `enabled`."""
        names = {**self.known, **self.placed}
        for name in self.scene.contacts:
            names |= {f"{name}.{key}": getattr(self.contact(name), key) for key in ("gap", "slip")}
        slips = {n: self.contact(n).slip / self.lever(n) for n in self.scene.couplings}
        return names | {f"{name}.slip": slip for name, slip in slips.items()}

    def _gate(self, name: str) -> Gate | None:
        """Return the gate of a contact; None if it has no conditions and no ends of an edge."""
        coupling = self.scene.couplings.get(name)
        contact, ends = coupling or self.scene.contacts[name], dict[str, sp.Expr]()
        edge = None if coupling else self.scene.surface_of(name).edge
        if edge is not None:
            (x0, y0), (x1, y1) = self._corners(edge)
            x, y = self.contact(name).point
            length = sp.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2)
            fraction = ((x1 - x0) * (x - x0) + (y1 - y0) * (y - y0)) / length
            ends = {"begin of its edge": fraction, "end of its edge": length - fraction}
        if not (contact.enabled or ends):
            return None
        off = f"{name}.{DISENGAGED if coupling else OFF}"
        return gate_of(off, contact.enabled, self._relation_names, self.state_symbols, ends)

    def valleys(self, name: str, *, acute: bool = False) -> dict[str, sp.Expr]:
        """Return the convexity of corners between a contact's edge and edges of the same point.

        Ends are named as in `gate`. A positive value is a valley: beyond the end the point is
        below the other edge; an `acute` valley has an angle below 90 degrees.
        """
        contact, valleys = self.scene.contacts[name], dict[str, sp.Expr]()
        surface = self.scene.surfaces[contact.surface]
        if surface.edge is None:
            return valleys
        for other in self.scene.contacts.values():
            neighbour = self.scene.surfaces[other.surface]
            if (
                neighbour.edge is None
                or (other.point, other.radius) != (contact.point, contact.radius)
                or replace_fields(neighbour, edge=surface.edge) != surface
            ):
                continue
            edge, next_edge = self._corners(surface.edge), self._corners(neighbour.edge)
            (ax, ay), (bx, by) = ((x1 - x0, y1 - y0) for (x0, y0), (x1, y1) in (edge, next_edge))
            turns = ax * by - ay * bx
            back = (-ax * bx - ay * by,) if acute else ()
            if edge[1] == next_edge[0]:
                valleys[f"{name}: end of its edge"] = Min(turns, *back)
            if edge[0] == next_edge[1]:
                valleys[f"{name}: begin of its edge"] = Min(-turns, *back)
        return valleys

    def _stuck(
        self, name: str, contact: Contact, anchor: Vector, tangent: Vector
    ) -> tuple[Vector, dict[sp.Symbol, sp.Expr]]:
        """Return the displacement of a point from its anchor, in the world, and the anchor."""
        x, y = (sp.Symbol(f"{name}.{axis}0", real=True) for axis in "xy")
        anchors = {x: anchor[0], y: anchor[1]}
        centre = self._rim(contact).centre((x, y), tangent)
        surface, point = self.scene.surfaces[contact.surface], self.point(contact.point)
        if surface.body is None:
            point = self._in_frame(surface, point)
        else:
            centre = in_world(self.body_frame(surface.body), centre)
        return (point[0] - centre[0], point[1] - centre[1]), anchors

    def _surface_geometry(
        self, surface: Surface, radius: sp.Expr, centre: Vector
    ) -> _SurfaceGeometry:
        """Return the geometry of a surface near a point, or near a disc of this radius."""
        # Chain rule: the surface is differentiated in its own coordinates and the point in those of
        # its body, since gap(q) and its second derivative are long.
        local = sp.Dummy("x", real=True), sp.Dummy("y", real=True)
        substitution = dict(zip(local, centre, strict=True))
        function, direction, factor = self._surface(surface, *local)
        # A disc touches lines and circles only, so that the function is the distance.
        function -= radius / factor
        # Rate of the radius of a circle: a rope that is hauled in.
        radius_rate = self.rate(function)
        rates = self.rate(centre[0]), self.rate(centre[1])
        drifts = self.drift(rates[0]), self.drift(rates[1])
        gradient = [sp.diff(function, u) for u in local]
        tangent_gradients = (
            [sp.diff(direction[1], u) for u in local],
            [-sp.diff(direction[0], u) for u in local],
        )
        curvature = [[sp.diff(slope, u) for u in local] for slope in gradient]

        def times(rows: Sequence[sp.Expr], columns: Sequence[sp.Expr]) -> sp.Expr:
            return sp.Add(
                *(r.xreplace(substitution) * c for r, c in zip(rows, columns, strict=True))
            )

        def second_order(rows: Sequence[Sequence[sp.Expr]]) -> sp.Expr:
            return sp.Add(*(times(r, rates) * rate for r, rate in zip(rows, rates, strict=True)))

        unit = factor.xreplace(substitution)
        return _SurfaceGeometry(
            function.xreplace(substitution),
            unit * function.xreplace(substitution),
            unit * (times(gradient, rates) + radius_rate),
            # Equals the derivative of the normal velocity on the surface (gap = gap' = 0).
            unit * (times(gradient, drifts) + second_order(curvature) + self.rate(radius_rate)),
            (direction[0].xreplace(substitution), direction[1].xreplace(substitution)),
            rates,
            drifts,
            second_order(tangent_gradients),
        )

    def _motion(self, place: sp.Expr) -> tuple[sp.Expr, Row, sp.Expr, sp.Expr]:
        """Return the rate, the gradient and the bias of a position, and its acceleration."""
        rate, gradient = self.rate(place), self.gradient(place)
        bias = self.drift(rate)
        return rate, gradient, bias, sp.Add(bias, *self._times_a(gradient))

    def _times_a(self, row: Row) -> list[sp.Expr]:
        return [entry * self.a[i] for i, entry in row.items()]

    @cached_property
    def pads(self) -> dict[str, int]:
        """Compliant contacts -> numbers of their pads.

        A pad is an additional coordinate that the normal force of its contact balances against
        the spring: forces of compliant contacts are then unknowns as those of rigid ones.
        """
        soft = [name for name, one in self.scene.contacts.items() if one.stiffness is not None]
        return {name: k for k, name in enumerate(soft)}

    def _padded(self, name: str, normal: Row, tangential: Row) -> tuple[Row, Row]:
        """Return the rows of a contact on coordinates and pads."""
        padded = name in self.pads
        return {len(self.q) + self.pads[name]: sp.S.One} if padded else normal, tangential

    @cached_property
    def _reactions(self) -> tuple[tuple[sp.Symbol, Row], ...]:
        """Forces and rows of the joints."""
        return tuple((row.force, row.jacobian) for row in self.joint_rows)

    def _coupling_symbols(self, name: str) -> ContactSymbols:
        """Return the quantities of a coupling: its slip is a rate by lever, its gap is zero."""
        guide = self.scene.along_guide(name)
        if guide:
            joint = self.scene.joints[self.scene.couplings[name].joint or ""]
            turn = self.point(joint.point)["XY".index(guide)]
        elif isinstance(coupling := self.scene.couplings[name], Rolling):
            turn = self._rim(self.scene.contacts[coupling.contact]).turn
        else:
            angles = [self.body_frame(body)[1] for body in self.scene.coupled(name)]
            turn = angles[0] - sp.Add(*angles[1:])
        zero, still = sp.S.Zero, Row()
        turn_rate, gradient, *rest = self._motion(turn)
        lever = self.lever(name)
        place, slip, bias, acceleration = (lever * number for number in (turn, turn_rate, *rest))
        jacobian = Row({i: lever * entry for i, entry in gradient.items()})
        anchor, couple = sp.Symbol(f"{name}.angle0", real=True), self.couples[name]
        along, out = (sp.S.One, zero), (zero, sp.S.One)
        return ContactSymbols(
            name, zero, zero, zero, slip, (place, zero), (place, zero), along, out,
            still, jacobian, zero, bias, zero, acceleration,
            zero, couple, friction_cones(self.scene, name, None, self.known, slip),
            self._padded(name, still, jacobian), self._reactions, Hold((), (), ()),
            Hold((turn - anchor,), (acceleration,), (couple,), {anchor: turn}),
        )  # fmt: skip

    def _arm(self, point: Point) -> sp.Expr:
        """Return the radius of gyration about a point, which converts angles to lengths."""
        mass, inertia = self.inertia(point.body, self.scene.bodies[point.body])
        x, y = self.vector(point.at)
        return sp.sqrt(inertia / mass + x**2 + y**2)

    def _stop(self, name: str, contact: Contact, stop: Stop) -> ContactSymbols:
        turn = self.body_frame(contact.point.body)[1] - self.formula(stop.limit)
        if stop.other is not None:
            turn -= self.body_frame(stop.other)[1]
        turn *= stop.side
        gap, (V, H), zero = self._arm(contact.point) * turn, self.forces[name], sp.S.Zero
        rate, jacobian, bias, bearing = self._motion(gap)
        still, along, out = Row(), (sp.S.One, zero), (zero, sp.S.One)
        hold = Hold((turn,), (bearing,), (V,))
        offset = self.parameters.symbols.get(f"{name}.{GAP_OFFSET}", zero)
        return ContactSymbols(
            name, gap, offset, rate, zero, self.point(contact.point), (zero, zero), along, out,
            jacobian, still, bias, zero, bearing, zero,
            V, H, friction_cones(self.scene, name, None, self.known, zero),
            self._padded(name, jacobian, still), self._reactions, hold, hold,
        )  # fmt: skip

    def _symbols(self, name: str) -> ContactSymbols:
        contact, surface = self.scene.contacts[name], self.scene.surface_of(name)
        if isinstance(surface, Stop):
            return self._stop(name, contact, surface)
        x, y = centre = self._in_frame(surface, self.point(contact.point))
        rim = self._rim(contact)
        local = self._surface_geometry(surface, rim.radius, centre)
        normal, rates, drifts = local.normal, local.rates, local.drifts
        tangent = (normal[1], -normal[0])
        dx, dy = self.gradient(x), self.gradient(y)
        jacobian_n = linear_combination((normal[0], dx), (normal[1], dy))
        jacobian_t = linear_combination(
            (tangent[0], dx), (tangent[1], dy), (rim.radius, self.gradient(rim.turn))
        )
        rolling = self.rate(rim.radius * rim.turn)
        slip = tangent[0] * rates[0] + tangent[1] * rates[1] + rolling
        bias_n = local.bias
        bias_t = tangent[0] * drifts[0] + tangent[1] * drifts[1] + local.turned
        bias_t += self.drift(rolling)
        V, H = self.forces[name]
        anchor, slipping = rim.anchored(centre, tangent)
        stuck, anchors = self._stuck(name, contact, anchor, tangent)
        normal_a = sp.Add(bias_n, *self._times_a(jacobian_n))
        tangential_a = sp.Add(bias_t, *self._times_a(jacobian_t))
        offset = self.parameters.symbols.get(f"{name}.{GAP_OFFSET}", sp.S.Zero)
        point = x - rim.radius * normal[0], y - rim.radius * normal[1]
        k, d = self.vector((contact.stiffness or 0, contact.damping or 0))
        press = None if contact.stiffness is None else -k * local.gap - d * local.gap_rate
        return ContactSymbols(
            name, local.gap, offset, local.gap_rate, slip, point, anchor, slipping, normal,
            jacobian_n, jacobian_t, bias_n, bias_t, normal_a, tangential_a,
            V, H, friction_cones(self.scene, name, self._coefficients.get(name), self.known, slip),
            self._padded(name, jacobian_n, jacobian_t), self._reactions,
            # The implicit function, not the distance: it is linear in y for a height.
            Hold((local.function,), (normal_a,), (V,), steep=self.curved(name)),
            Hold(stuck, (normal_a, tangential_a), (V, H), anchors),
            press,
        )  # fmt: skip
