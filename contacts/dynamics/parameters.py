"""Parameters of the equations of a scene, and the quantities derived from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

import sympy as sp

from contacts.scene.checks import has_switches
from contacts.scene.friction import FrictionLaw
from contacts.scene.modes import FrictionSymbols
from contacts.scene.scene import Scene
from statechart.arrays import Array
from statechart.documents.fields import FormulaText
from statechart.formulas.formula import Formula, parse
from statechart.formulas.parameters import Parameters
from statechart.formulas.writer import Max

COEFFICIENTS = ("friction", "cone_n", "cone_t")
"""Parameters of a contact with friction; ``tip.friction.ice`` where the state `ice` sets it."""
STATIC = ("static", "cone_n", "cone_t")
KINETIC = ("kinetic", "kinetic_n", "kinetic_t")
"""Parameters of a contact whose static and kinetic friction differ.

``tip.friction`` is then the one in use. Friction as a formula of slip has no KINETIC parameters.
"""

GAP_OFFSET = "gap_offset"
"""Parameter of a contact, ``tip.gap_offset``: see `contacts.scene.modes.ContactSymbols`."""
HELD_FORCE = "scene.held_force"
"""Parameters ``scene.held_force0`` of scenes that switch: see `contacts.dynamics.held_forces`."""
SIZE = "scene.size"
"""Parameters ``scene.size0`` of scenes with `enabled`: sizes of coordinates and rates by steps."""
LEVER = "scene.lever"
"""Parameter of scenes whose couplings turn: see `contacts.dynamics.scales.Scales`."""
MASS_UNIT = "scene.mass_unit"
"""Parameter of scenes with extreme masses: the power of two that modes are solved in, or 0."""
MAGNITUDES = 1e-40, 1e40
"""Range of masses (kg) whose products in determinants (five masses, and lengths) are floats."""


def coefficients_of(law: FrictionLaw) -> tuple[tuple[str, ...], ...]:
    """Return the parameters of friction: coefficient and cone, at rest and in motion."""
    if not law.splits:
        return (COEFFICIENTS,)
    return (STATIC,) if law.varies else (STATIC, KINETIC)


def friction_symbols(
    scene: Scene, known: Mapping[str, sp.Symbol]
) -> dict[str, dict[str, sp.Symbol]]:
    """Return key of `coefficients_of` -> symbol, for every contact with friction.

    Coefficients that are no parameters are set by states of controllers.
    """
    result: dict[str, dict[str, sp.Symbol]] = {}
    for i, (name, contact) in enumerate(scene.contacts.items()):
        law = scene.friction_of(name)
        if law is not None and not contact.frictionless:
            controlled = scene.controlled.region_of(law.both) is not None
            result[name] = {
                key: sp.Symbol(f"{key}{i}", real=True) if controlled else known[f"{name}.{key}"]
                for keys in coefficients_of(law)
                for key in keys
            }
    return result


def friction_cones(
    scene: Scene,
    name: str,
    coefficients: Mapping[str, sp.Symbol] | None,
    known: Mapping[str, sp.Expr],
    slip: sp.Expr,
) -> FrictionSymbols:
    """Return the cones of a contact; without `coefficients` it is smooth or cannot slip."""
    if coefficients is None:
        # A contact without the mode slide has an unlimited friction force.
        smooth = name in scene.contacts and scene.contacts[name].frictionless
        edge = (sp.S.One, sp.S.Zero) if smooth else (sp.S.Zero, sp.S.One)
        at_rest = sp.S.Zero if smooth else sp.oo
        return FrictionSymbols(dict.fromkeys((0, 1, -1), edge), {}, at_rest)
    at_rest = coefficients["cone_n"], coefficients["cone_t"]
    law = scene.friction_of(name)
    assert law is not None
    if not law.splits:
        return FrictionSymbols(dict.fromkeys((0, 1, -1), at_rest), {}, coefficients["friction"])
    used = sp.Symbol(f"{name}.friction", real=True)
    edges, values = {0: at_rest}, {0: {used: coefficients["static"]}}
    for direction in (1, -1):
        if law.varies:
            kinetic = kinetic_friction(law, direction, known, direction * slip)
            edges[direction] = sp.S.One, kinetic
        else:
            kinetic = coefficients["kinetic"]
            edges[direction] = coefficients["kinetic_n"], coefficients["kinetic_t"]
        values[direction] = {used: kinetic}
    return FrictionSymbols(edges, values, coefficients["static"])


def cone_edge(mu: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """Return the unit edge ``(1, mu) / hypot(1, mu)`` of a cone, for any mu from 0 to inf."""
    return 1 / sp.sqrt(1 + mu**2), 1 / sp.sqrt(1 + (1 / mu) ** 2)


def kinetic_friction(
    law: FrictionLaw, direction: int, known: Mapping[str, sp.Expr], speed: sp.Expr
) -> sp.Expr:
    """Return the kinetic coefficient for slip at a `speed` in a direction, 1 or -1."""
    size = sp.Symbol("speed", positive=True)
    slips = dict.fromkeys(law.slips, direction * size)
    # SymPy simplifies abs and sign of a positive symbol.
    return parse(law.kinetic).to_sympy({**known, **slips}).xreplace({size: speed})


def scene_parameters(scene: Scene) -> Parameters:
    """Return the scene's parameters, the contacts' coefficients, and the initial state."""

    def derived(known: Mapping[str, sp.Symbol]) -> dict[str, sp.Expr]:
        expressions = _derived(scene, known)
        expressions |= {f"{name}.{GAP_OFFSET}": sp.S.Zero for name in scene.contacts}
        for name, joint in scene.joints.items():
            # Set at the start of a run by `contacts.solvers.dependence.dependent_rows`.
            expressions |= {f"{name}.redundant_{c.lower()}": sp.S.Zero for c in joint.components}
            if joint.angle is not None and not joint.enabled:
                turns = [_turn(scene, end.body, known) for end in joint.ends.values()]
                expressions[f"{name}.turn0"] = turns[0] - sp.Add(*turns[1:])
        if has_switches(scene):
            expressions |= {f"{HELD_FORCE}{i}": sp.S.Zero for i in range(len(scene.variables))}
        expressions |= _sizes(scene, len(scene.variables))
        values = scene.values({})
        if not all(map(scene.along_guide, scene.couplings)):
            expressions[LEVER] = sp.S.One
        masses = [parse(body.mass).value(values) for body in scene.bodies.values()]
        if masses and not MAGNITUDES[0] <= min(masses) <= max(masses) <= MAGNITUDES[1]:
            # Set by `contacts.dynamics.scales.mass_unit`.
            expressions[MASS_UNIT] = sp.S.Zero
        return expressions

    return Parameters(scene.parameters, derived, partial(_initial, scene))


def _sizes(scene: Scene, coordinates: int) -> dict[str, sp.Expr]:
    """Return the sizes of coordinates and rates, zero until they are known, for `enabled`."""
    used = any(contact.enabled for contact in scene.contacts.values())
    used = used or any(coupling.enabled for coupling in scene.couplings.values())
    return {f"{SIZE}{i}": sp.S.Zero for i in range(2 * coordinates if used else 0)}


def with_sizes(values: Array, places: Mapping[str, int], sizes: Array) -> Array:
    """Return parameter values with the sizes of coordinates and rates, if formulas use them."""
    first = places.get(f"{SIZE}0")
    if first is None:
        return values
    result = values.copy()
    result[first : first + len(sizes)] = sizes
    return result


def body_parameters(scene: Scene, coordinates: int) -> Parameters:
    """Return the parameters of a scene of free bodies; copies of a body share theirs.

    The initial state is that of the controllers' variables alone.
    """

    def derived(known: Mapping[str, sp.Symbol]) -> dict[str, sp.Expr]:
        return _derived(scene, known) | _sizes(scene, coordinates)

    def controller_variables(known: Mapping[str, sp.Symbol]) -> list[sp.Expr]:
        return [parse(text).to_sympy(known) for text in scene.controlled.controller_state.values()]

    return Parameters(scene.parameters, derived, controller_variables)


def _derived(scene: Scene, known: Mapping[str, sp.Symbol]) -> dict[str, sp.Expr]:
    """Return the coefficients of contacts and moments of inertia."""
    result: dict[str, sp.Expr] = {}

    def in_states(text: FormulaText) -> Iterator[tuple[str, Mapping[str, sp.Expr]]]:
        for state, scope in scene.controlled.values_by_state(text, known, Formula.to_sympy):
            yield f".{state}" if state else "", scope

    for name, contact in scene.contacts.items():
        law = scene.friction_of(name)
        if law is not None and not contact.frictionless:
            at_rest = dict.fromkeys(law.slips, sp.S.Zero)
            for state, scope in in_states(law.both):
                for keys, text in zip(
                    coefficients_of(law), (law.static, law.kinetic), strict=False
                ):
                    mu = parse(text).to_sympy({**scope, **at_rest})
                    for key, value in zip(keys, (mu, *cone_edge(mu)), strict=True):
                        result[f"{name}.{key}{state}"] = value
        if contact.restitution is not None:
            for state, scope in in_states(contact.restitution):
                value = parse(contact.restitution).to_sympy(scope)
                result[f"{name}.restitution{state}"] = value
    for name, body in scene.bodies.items():
        if body.inertia is not None:
            result[f"{name}.inertia"] = parse(body.inertia).to_sympy(known)
    return result


def _initial(scene: Scene, known: Mapping[str, sp.Symbol]) -> list[sp.Expr]:
    """Return initial positions, rates and controllers' variables; then levers of the bodies."""
    texts = [*scene.starts().values(), *scene.controlled.controller_state.values()]
    begins = [parse(text).to_sympy(known) for text in texts]
    return [*begins, *_levers(scene, known)]


def _turn(scene: Scene, name: str, known: Mapping[str, sp.Symbol]) -> sp.Expr:
    """Return the angle of a body at the start."""
    starts = {n: parse(c.start).to_sympy(known) for n, c in scene.coordinates.items()}
    return parse(scene.bodies[name].path[2]).to_sympy({**known, **starts})


def _levers(scene: Scene, known: Mapping[str, sp.Symbol]) -> list[sp.Expr]:
    """Return mass times the longest arm squared of every body's contact points and joints."""
    points = [(contact.point, contact.radius or 0) for contact in scene.contacts.values()]
    for joint in scene.joints.values():
        # A captured position is known when the joint closes.
        ends = joint.ends.values() if joint.rest is None else (joint.point,)
        points += [(end, 0) for end in ends]
    arms: dict[str, list[sp.Expr]] = {name: [] for name in scene.bodies}
    for point, radius in points:
        squares = (parse(text).to_sympy(known) ** 2 for text in (*point.at, radius))
        arms[point.body].append(sp.Add(*squares))
    # Unevaluated: SymPy takes half a second to decide which arm is the longest.
    return [
        parse(scene.bodies[name].mass).to_sympy(known)
        * (Max(*lengths, evaluate=False) if lengths else sp.S.Zero)
        for name, lengths in arms.items()
    ]
