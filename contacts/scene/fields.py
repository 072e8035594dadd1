"""Fields of a scene, and quantities derived from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from itertools import pairwise
from string import digits
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Discriminator, Tag

from contacts.scene.controls import Controller, Controls
from contacts.scene.couplings import Coupling, coupling_edges, coupling_states
from contacts.scene.friction import SLIP, FrictionLaw, friction_law
from contacts.scene.joints import JOINT_WORDS, Force, Joint
from contacts.scene.parts import (
    Body,
    Contact,
    Coordinate,
    Pair,
    Resolution,
    Simultaneous,
    Surface,
    used_names,
)
from contacts.scene.regions import edges, states
from contacts.scene.shapes import INDEX, Collision
from contacts.states import DISENGAGED, INACTIVE, superstates_of
from statechart.automaton.regions import Claim, Edge, Region, State
from statechart.charts.flatten import timer_dimension
from statechart.documents.declaration import TIME, Declaration
from statechart.documents.documented import declare
from statechart.documents.fields import (
    FiniteText,
    FormulaText,
    NameText,
    ValueName,
    replace_fields,
    value_of,
)
from statechart.documents.quantities import (
    POWERS,
    Dimension,
    Fact,
    Quantity,
    fields_of,
    per_time,
    rate_of,
)
from statechart.errors import DeclarationProblem
from statechart.formulas.condition import InState
from statechart.formulas.formula import parse
from statechart.formulas.relation import conjunction, parse_relation
from statechart.formulas.tree import Name

if TYPE_CHECKING:
    import sympy as sp

    from statechart.automaton.trace import Role

_OF_BODIES: Mapping[str, Dimension] = {"x": "length", "y": "length", "angle": "angle"}
_OF_CONTACTS: Mapping[str, Dimension] = {
    "gap": "length", "slip": "length/time", "V": "force", "H": "force", "friction": "1",
}  # fmt: skip
_OF_COUPLINGS: Mapping[str, Dimension] = {"M": "moment", "slip": "angle/time"}
_OF_GUIDES: Mapping[str, Dimension] = {"M": "force", "slip": "length/time"}
_OF_JOINTS: Mapping[str, Dimension] = {
    **dict.fromkeys(("X", "Y", "T", "V", "H"), "force"), "M": "moment", "gap": "length",
    "x": "length", "y": "length", "turn": "angle",  # Captured places
}  # fmt: skip
_MOST_COPIES = 10_000


def _components(value: Any) -> str:
    return "components" if isinstance(value, list | tuple) else "downwards"


Gravity = Annotated[
    Annotated[FiniteText, Tag("downwards")] | Annotated[Pair, Tag("components")],
    Discriminator(_components),
]
"""An acceleration downwards, or the components of one, `[0, -g]`."""


class SceneFields(Declaration):
    """Keys of a scene, before it is checked (see `contacts.scene.scene.Scene`)."""

    OTHER_WORDS: ClassVar = {
        **Declaration.OTHER_WORDS,
        "g": "gravity",
        "controller controllers inputs": (
            "controls: {u: 0}, and regions: {NAME: {initial: ..., states: ...}} that set it"
        ),
        "body links worldbody objects": "bodies",
        "simulation option solver": "settings",
        "keyframe qpos initial start": "start: {x: 0, y: 1} of a body",
        "ground floor plane walls": "surfaces: {floor: {height: 0}}",
        "actuator actuators": "forces: {motor: {body: arm, moment: M}}",
        "spring springs": "forces: {spring: {body: rod, force: [-k*rod.x, 0]}}",
        "motor motors": "forces: {motor: {body: arm, moment: M}}, or controls and regions",
        "damper dampers": "forces: {damper: {body: rod, force: [-c*rod.dx, 0]}}",
        "gear gears pulley pulleys": (
            "coordinates: {q: {}}, and bodies placed by it, with angle: q and angle: -q/2"
        ),
        "hinges constraints": "joints: {NAME: {point: {body: arm}, to: [0, 0]}}",
        "brake brakes clutch clutches": "couplings: {brake: {bodies: [wheel], limit: M_max}}",
        **JOINT_WORDS,
    }

    kind: Literal["scene"] = declare("Kind of the document.", "scene", default="scene")
    gravity: Gravity = declare(
        "Acceleration downwards, or its components: [0, -9.81] is downwards.",
        9.81,
        [0, -9.81],
        ["g*sin(slope)", "-g*cos(slope)"],
        unit="length/time**2",
        default=0,
    )
    coordinates: dict[ValueName, Coordinate] = declare(
        "Coordinates, by which positions of bodies are given.",
        {"theta": {"start": 0.2}},
        default={},
    )
    bodies: dict[NameText, Body] = declare(
        "Name to body.",
        {"rod": {"mass": "m", "inertia": "m*L**2/3", "start": {"y": "h"}}},
        min_length=1,
    )
    surfaces: dict[NameText, Surface] = declare(
        "Surfaces that points and bodies may touch.", {"floor": {"height": 0}}, default={}
    )
    contacts: dict[NameText, Contact] = declare(
        "Contacts: points of bodies that may touch a surface. Each is a region of the statechart.",
        {
            "tip": {
                "point": {"body": "rod", "at": [0, "-L"]},
                "surface": "floor",
                "friction": "mu",
                "restitution": 0,
            }
        },
        default={},
    )
    joints: dict[NameText, Joint] = declare(
        "Joints: points of bodies that are held.",
        {"pivot": {"point": {"body": "arm"}, "to": [0, 0]}},
        default={},
    )
    couplings: dict[NameText, Coupling] = declare(
        "Dry friction as a couple between bodies, in a joint or along a guide. Each is a "
        "region of the statechart.",
        {"brake": {"bodies": ["wheel"], "limit": "M_max"}},
        default={},
    )
    forces: dict[NameText, Force] = declare(
        "Forces and moments on bodies.",
        {"spring": {"body": "rod", "force": ["-k*rod.x", 0]}},
        default={},
    )
    collisions: dict[NameText, Collision] = declare(
        "Lists of bodies with shapes that collide; with time steps only (engine impulse).",
        {"all": {"bodies": ["die"], "surfaces": ["floor"], "friction": 0.3, "restitution": 0}},
        default={},
    )
    simultaneous: Simultaneous = declare(
        "Law for contacts that are hit together: plastic; Moreau's law reduced until energy does "
        "not rise (capped); or one after another by their own laws (sequential).",
        "sequential",
        default="capped",
    )
    paradox: Resolution = declare(
        "Reaction to Painleve's paradox (no mode of a sliding contact agrees "
        "with the state): an impact without collision, or the end of the run.",
        "stop",
        default="impact",
    )
    controls: dict[ValueName, FormulaText] = declare(
        "Controls, which states of regions set, and which forces and "
        "coefficients of contacts use: the value where no state sets it.",
        {"torque": 0},
        unit="that of each",
        default={},
    )
    regions: dict[NameText, Controller] = declare(
        "Controllers: regions that run in parallel to the contacts.",
        {
            "leg": {
                "initial": "hold",
                "states": {"hold": {}, "thrust": {"sets": {"push": 20}}},
                "transitions": [
                    {"name": "go", "from": "hold", "to": "thrust", "on": "foot.touchdown"}
                ],
            }
        },
        default={},
    )
    initial_modes: dict[
        str, Literal["free", "closed", "slide", "slide+", "slide-", "pin", "off"]
    ] = declare(
        "Modes of contacts at the start; checked, and computed where not given.",
        {"tip": "pin"},
        default={},
        alias="modes",
    )

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all coordinates."""
        of_bodies = [
            f"{n}.{c}" for n, b in self.owners().items() for c in self.bodies[b].coordinates
        ]
        return (
            (*of_bodies, *self.coordinates) if self.collisions else (*self.coordinates, *of_bodies)
        )

    def owners(self) -> dict[str, str]:
        """Return body -> declared body, for all bodies and copies.

        Free bodies come first; with collisions, bodies placed by coordinates, led bodies and fixed
        bodies follow in this order.
        """
        several = any(body.copies is not None for body in self.bodies.values())
        counts = self.counted(self.values()) if several else dict.fromkeys(self.bodies)
        groups = {
            name: 2 * body.prescribed + body.fixed + (body.linked and bool(self.collisions))
            for name, body in self.bodies.items()
        }
        result: dict[str, str] = {}
        for name in sorted(self.bodies, key=groups.__getitem__):
            count = counts[name]
            names = [name] if count is None else [f"{name}{index}" for index in range(count)]
            result |= dict.fromkeys(names, name)
        return result

    def starts(self) -> dict[str, FiniteText]:
        """Return the starts of all coordinates, then of their rates, copies one by one."""
        starts = {name: (one.start, one.rate) for name, one in self.coordinates.items()}
        for name, body in self.single_bodies().items():
            starts |= {f"{name}.{c}": body.start_of(c) for c in body.coordinates}
        rates = {self.rate_name(name): starts[name][1] for name in self.variables}
        return {name: starts[name][0] for name in self.variables} | rates

    def moving(self) -> list[str]:
        """Return the names of the bodies that forces and impulses move, copies one by one."""
        return [name for name, owner in self.owners().items() if not self.bodies[owner].prescribed]

    def single_bodies(self) -> dict[str, Body]:
        """Return the bodies, copies one by one; all alike but for the index in their start."""
        return {
            name: body if body.copies is None else body.numbered(int(name.removeprefix(owner)))
            for name, owner in self.owners().items()
            for body in (self.bodies[owner],)
        }

    def single_body(self, name: str) -> Body | None:
        """Return a body or a copy as `single_bodies` has it; None for an unknown name."""
        for end in range(len(name), len(name.rstrip(digits)) - 1, -1):
            if (body := self.bodies.get(name[:end])) is not None:
                return body if end == len(name) else body.numbered(int(name[end:]))
        return None

    @property
    def whole(self) -> frozenset[str]:
        """Parameters that count copies of bodies."""
        counts = [b.copies for b in self.bodies.values() if b.copies is not None]
        return used_names(counts) & frozenset(self.parameters)

    @property
    def timers(self) -> frozenset[str]:
        """Undeclared variables: the timers of transitions of controllers."""
        return frozenset(self.controlled.timers)

    def counted(self, values: Mapping[str, float]) -> dict[str, int | None]:
        """Return the number of copies of every body; None for a single body.

        Raises `DeclarationProblem` if a number of copies is not whole, or too large.
        """
        counts: dict[str, int | None] = dict.fromkeys(self.bodies)
        for name in (n for n, body in self.bodies.items() if body.copies is not None):
            loc = ("bodies", name, "copies")
            number = value_of(self.bodies[name].copies or 0, values, *loc)
            if number not in range(1, _MOST_COPIES + 1):
                raise DeclarationProblem(
                    f"must be a whole number from 1 to {_MOST_COPIES}, not {number:.15g}", loc=loc
                )
            counts[name] = int(number)
        return counts

    def variant(self, overrides: Mapping[str, float]) -> Self:
        """Return the scene with the numbers of copies for these overrides, or itself."""
        if not self.whole or self.counted(self.values()) == self.counted(self.values(overrides)):
            return self
        deciding, further = frozenset[str](), self.whole
        while further:
            deciding |= further
            further = used_names(map(self.parameters.__getitem__, further)) - deciding
        chosen = {name: value for name, value in overrides.items() if name in deciding}
        return replace_fields(self, parameters={**self.parameters, **chosen})

    def rate_name(self, coordinate: str) -> str:
        """Return the name of the rate of `coordinate`: stick.x -> stick.dx, theta -> dtheta."""
        *owner, name = coordinate.split(".")
        return ".".join([*owner, f"d{name}"])

    def stated(self, name: str) -> Quantity:
        """Return the physical quantity of a name of the scene."""
        owner, _, quantity = name.rpartition(".")
        dimensions, place = self._dimensions(owner), quantity.removeprefix("d")
        if quantity in dimensions:
            kind = "slack" if owner in self.joints and quantity == "gap" else quantity
            return Quantity(f"{kind} of {owner}", dimensions[quantity])
        if owner and place != quantity and place in _OF_BODIES:
            return Quantity(f"rate of {place} of {owner}", per_time(_OF_BODIES[place]))
        if name == INDEX and name not in self.parameters:
            return Quantity("number of a copy", "1")
        if dimension := timer_dimension(self.controlled.flat.values(), name):
            return Quantity(name, dimension)
        rates = {self.rate_name(coordinate): coordinate for coordinate in self.coordinates}
        if name in rates:
            return Quantity(f"rate of {rates[name]}")
        if name == SLIP:
            return Quantity("slip velocity", "length/time")
        return Quantity(name, "energy") if name == "energy" else super().stated(name)

    def _dimensions(self, owner: str) -> Mapping[str, Dimension]:
        """Return the dimensions of the quantities of a part, by name."""
        if owner in self.contacts:
            return _OF_CONTACTS
        if owner in self.coupled_names:
            return _OF_GUIDES if self.along_guide(owner) else _OF_COUPLINGS
        if owner in self.joints:
            return _OF_JOINTS
        return _OF_BODIES if owner else {}

    def facts(self) -> Iterator[Fact]:
        """Yield the dimensions of formulas, of starts and rates, too.

        Positions of bodies come first: they determine the dimensions of coordinates before constant
        gains of controllers are taken for plain numbers.
        """
        for name, body in self.bodies.items():
            yield from fields_of(body)
            for key, text in body.start.items():
                yield parse(text).root, POWERS[self.stated(f"{name}.{key}").dimension]
        for name, coordinate in self.coordinates.items():
            yield Name(self.rate_name(name)), rate_of(name)
            yield parse(coordinate.start).root, Name(name)
            yield parse(coordinate.rate).root, rate_of(name)
        # The variable of heights.
        yield Name("x"), POWERS["length"]
        yield from super().facts()

    def jams(self, contact: str) -> bool:
        """Return whether a contact may have an impact without collision.

        It needs friction, and a body that rotates or other contacts that can wedge it.
        """
        declared = self.contacts[contact]
        body = self.bodies[declared.point.body]
        rubs = "slide" in declared.kinds and not declared.frictionless
        turns = body.inertia is not None or body.position is not None
        wedged = rubs and declared.stiffness is None and (turns or len(self.contacts) > 1)
        return wedged and self.paradox == "impact"

    def bounces(self, contact: str) -> bool:
        """Return whether impacts may accumulate at a contact, alone or with coupled ones."""
        declared = self.contacts[contact]
        if declared.stiffness is not None:
            return False
        if "free" not in declared.kinds or declared.restitution != 0:
            return "free" in declared.kinds
        return self._coupled_contacts[declared.point.body] > 1

    @cached_property
    def _coupled_contacts(self) -> Mapping[str, int]:
        """Body -> contacts of the bodies that joints, coordinates and contacts couple to it."""
        from sympy.utilities.iterables import connected_components

        contacts = [(x.point.body, self.surfaces[x.surface].body) for x in self.contacts.values()]
        links = [(body, carrier) for body, carrier in contacts if carrier is not None]
        for joint in self.joints.values():
            links += pairwise(end.body for end in joint.ends.values())
        # Bodies meet at the coordinates that place them, which have other names than bodies.
        for name, body in self.bodies.items():
            links += [(name, q) for q in body.placing & self.coordinates.keys()]
        counts = Counter(body for body, _ in contacts)
        groups = connected_components(([*self.bodies, *self.coordinates], links))
        return {name: sum(counts[n] for n in group) for group in groups for name in group}

    @cached_property
    def controlled(self) -> Controls:
        """The controls and the regions that set them."""
        return Controls(self.controls, self.regions)

    def friction_of(self, contact: str) -> FrictionLaw | None:
        """Return the coefficients of a contact; None where none is declared."""
        if contact not in self.contacts:  # A coupling
            return None
        declared = self.contacts[contact].friction
        return friction_law(declared, contact, self.parameters, self.controls)

    @property
    def rolling(self) -> dict[str, str]:
        """Couplings of rolling resistance, and their contacts."""
        declared = self.contacts.items()
        return {f"{c}_rolling": c for c, x in declared if x.rolling_resistance is not None}

    @property
    def coupled_names(self) -> tuple[str, ...]:
        """Declared couplings, then those of rolling resistance."""
        return (*self.couplings, *self.rolling)

    @property
    def frictional(self) -> tuple[str, ...]:
        """Contacts, then couplings: the regions whose states are selected by their friction."""
        return (*self.contacts, *self.couplings)

    def along_guide(self, coupling: str) -> str:
        """Return the free direction, "X" or "Y", of the guide that a coupling is in; "" else."""
        declared = self.couplings.get(coupling)
        joint = self.joints.get((declared and declared.joint) or "")
        held = {"X", "Y"} & {*(joint.components if joint is not None else ())}
        return {"X": "Y", "Y": "X"}[held.pop()] if len(held) == 1 else ""

    def coupled(self, coupling: str) -> tuple[str, ...]:
        """Return the one or two bodies of a coupling; a fixed end of its joint is the world."""
        declared = self.couplings[coupling]
        if declared.bodies is not None:
            return declared.bodies
        ends = self.joints[declared.joint or ""].ends.values()
        bodies = {end.body: self.single_body(end.body) for end in ends}
        return tuple(name for name, body in bodies.items() if body is None or not body.fixed)

    @property
    def kinematic_names(self) -> frozenset[str]:
        """Names that formulas of controls and of forces may use."""
        rates = map(self.rate_name, self.variables)
        memory = self.controlled.controller_state
        return frozenset((TIME, *self.parameters, *self.variables, *rates, *memory))

    @property
    def quantity_names(self) -> frozenset[str]:
        """Names of gaps, slips and forces of contacts, ropes, joints and couplings; energy."""
        # Limits of joints have none: their gaps are angles times a length.
        touching = [*self.contacts, *(n for n, x in self.joints.items() if x.rope is not None)]
        names = {f"{c}.{quantity}" for c in touching for quantity in ("gap", "slip", "V", "H")}
        names |= {f"{name}.{force}" for name, x in self.joints.items() for force in x.forces}
        names |= {f"{name}.{quantity}" for name in self.coupled_names for quantity in ("M", "slip")}
        return frozenset((*names, "energy"))

    @property
    def leading(self) -> frozenset[str]:
        """Names of controls and variables that move surfaces of points, and of their flows."""
        if self.collisions:
            return frozenset()
        texts = [text for s in self.surfaces.values() for text in (*s.displacement, s.turn)]
        texts += [joint.rope for joint in self.joints.values() if joint.rope is not None]
        texts += [s.radius for s in self.surfaces.values() if s.radius is not None]
        names, memory = set[str](), {*self.controlled.controller_state, *self.controls}
        while fresh := {n for text in texts for n in parse(text).names & memory} - names:
            names |= fresh
            flows = self.controlled.declared_flows()
            texts = [text for _, variable, text, _ in flows if variable in fresh]
        return frozenset(names)

    @property
    def placed_names(self) -> frozenset[str]:
        """Names of the places and rates of bodies that formulas place, or that are fixed."""
        names: set[str] = set()
        for name, owner in self.owners().items():
            body = self.bodies[owner]
            if body.position is None and not body.fixed:
                continue
            turns = body.prescribed or body.angle is not None
            places = ["x", "y", "angle"] if turns else ["x", "y"]
            # How a control changes within a state is not known.
            controls = body.placing.intersection(self.controls)
            texts = [text for control in controls for text in self.controlled.texts(control)]
            rates = [] if used_names(texts) - self.parameters.keys() else [f"d{x}" for x in places]
            names |= {f"{name}.{place}" for place in (*places, *rates)}
        return frozenset(names)

    @cached_property
    def condition_states(self) -> tuple[InState, ...]:
        """The terms `in(REGION.STATE)` of the conditions of contacts, each state once."""
        texts = [text for contact in self.contacts.values() for text in contact.enabled]
        texts += [text for coupling in self.couplings.values() for text in coupling.enabled]
        members = [member for text in texts for member in parse_relation(text).members]
        return tuple({(m.region, m.state): m for m in members}.values())

    def surface_of(self, contact: str) -> Surface:
        """Return the surface that a contact touches."""
        return self.surfaces[self.contacts[contact].surface]

    def region_states(self, name: str) -> tuple[str, ...]:
        """Return the states of the region of a contact or a coupling."""
        if name in self.couplings:
            return coupling_states(self.couplings[name])
        return states(self.contacts[name], gate=self.gate(name))

    def region_edges(self, name: str) -> tuple[Edge, ...]:
        """Return the transitions of the region of a contact or a coupling."""
        if name in self.couplings:
            return coupling_edges(self.couplings[name])
        jams, bounces, gate = self.jams(name), self.bounces(name), self.gate(name)
        return edges(self.contacts[name], jams=jams, bounces=bounces, gate=gate)

    def contact_region(
        self, name: str, build: Callable[[Role], State], forces: tuple[sp.Symbol, ...]
    ) -> Region:
        """Return the region of a contact or a coupling; `build` returns its states."""
        coupling = self.couplings.get(name)
        enabled = (coupling or self.contacts[name]).enabled

        def claims(state: str) -> tuple[Claim, ...]:
            if state not in INACTIVE:
                return tuple(Claim(f"{name}: {text}", (text,), holds=True) for text in enabled)
            if self.gate(name) != conjunction(enabled):
                # The contact may also be off beyond the ends of its edge.
                return ()
            outside = () if coupling else (f"{name}.gap > 0",)
            return (Claim(f"{name} is enabled", (*enabled, *outside), holds=False),)

        names = self.region_states(name)
        return Region(
            name,
            names,
            build,
            self.region_edges(name),
            superstates_of(names),
            ("slide", "slipping"),
            forces=forces,
            default=next((state for state in (DISENGAGED, "free") if state in names), ""),
            claims=claims,
        )

    def gate(self, contact: str) -> str:
        """Return the conditions without which a contact is off, as text; "" for none."""
        if contact in self.couplings:
            return self.couplings[contact].gate
        declared = self.contacts[contact]
        ends = self.surface_of(contact).edge is not None
        return conjunction((*declared.enabled, *(["within its edge"] if ends else [])))
