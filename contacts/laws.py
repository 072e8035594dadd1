"""What happens to a scene between its flows: classification, impacts, Zeno capture, projection."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from contacts.classify import Choice, ContactLaw, choose
from contacts.impact import impact
from contacts.mechanics import Mechanics
from contacts.regions import states
from contacts.scales import Scales, ScaleTape
from contacts.scene import Contact, Scene
from contacts.snapshot import Snapshot, SnapshotTape, solve_kkt
from statechart.automaton import Flow, Margin, Setup
from statechart.errors import DeclarationProblem, NoConsistentMode
from statechart.formula import parse
from statechart.parameters import Parameters
from statechart.tape import compile_tape
from statechart.trace import Clock, Jump, Key

__all__ = ["SceneLaws", "SceneSetup", "cones", "scene_parameters"]

Array = NDArray[np.float64]

# Force margins may fall below zero by this much of the force scale before a mode is left: the
# size of rounding in a solved mode, with room; entering asks for half of it (hysteresis).
_FORCE_BAND = 1e-12
# A moment of inertia below this part of mass times arm squared cannot be told from zero: the
# forces that turn the body are then differences of terms that many times larger.
_POINT_MASS = 1e-12
# Positions and speeds carry rounding of this size relative to the scene.
_ROUNDING = 1e-13
# How far the first flow looks ahead, in the scene's own unit of time.
_LOOK_AHEAD = 64.0
# Constraints are projected once they are off by this part of their tolerance.
_DRIFT = 0.05
# A start may be inside a surface by so much of the scene's length (and is projected out).
_START_DEPTH = 1e-9


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneSetup(Setup):
    """The numbers of one run of a scene.

    Attributes
    ----------
    scales : Scales
        Of this run.
    contacts : tuple of ContactLaw
        With this run's coefficients.
    capture : float
        Rebounds slower than this are summed instead of simulated.
    stops : mapping
        Stop condition -> how near zero its margin counts as met; from its value at the start.
    """

    scales: Scales
    contacts: tuple[ContactLaw, ...]
    capture: float
    stops: Mapping[str, float]


def cones(scene: Scene, known: Mapping[str, sp.Symbol]) -> dict[str, tuple[sp.Expr, sp.Expr]]:
    """Return (cone_n, cone_t) per contact: symbols, or numbers where nothing is to be known."""
    result: dict[str, tuple[sp.Expr, sp.Expr]] = {}
    for name, contact in scene.contacts.items():
        if contact.friction is None:
            # Without slide a pin holds whatever it takes (no-slip); free needs no cone at all.
            result[name] = (sp.S.Zero, sp.S.One)
        elif contact.frictionless:
            result[name] = (sp.S.One, sp.S.Zero)
        else:
            result[name] = (known[f"{name}.cone_n"], known[f"{name}.cone_t"])
    return result


def scene_parameters(scene: Scene) -> Parameters:
    """Return the scene's parameters, the contacts' coefficients, and the initial state."""

    def derived(known: Mapping[str, sp.Symbol]) -> dict[str, sp.Expr]:
        result: dict[str, sp.Expr] = {}
        for name, contact in scene.contacts.items():
            if contact.friction is not None and not contact.frictionless:
                mu = parse(contact.friction).to_sympy(known)
                # 1 / hypot(1, mu) and mu / hypot(1, mu), right at mu = 0 and at mu = inf.
                result[f"{name}.friction"] = mu
                result[f"{name}.cone_n"] = 1 / sp.sqrt(1 + mu**2)
                result[f"{name}.cone_t"] = 1 / sp.sqrt(1 + (1 / mu) ** 2)
            if contact.restitution is not None:
                result[f"{name}.restitution"] = parse(contact.restitution).to_sympy(known)
        for name, body in scene.bodies.items():
            if body.inertia is not None:
                result[f"{name}.inertia"] = parse(body.inertia).to_sympy(known)
        return result

    def initial(known: Mapping[str, sp.Symbol]) -> list[sp.Expr]:
        positions: list[sp.Expr] = []
        rates: list[sp.Expr] = []
        for coordinate in scene.coordinates.values():
            positions.append(parse(coordinate.start).to_sympy(known))
            rates.append(parse(coordinate.rate).to_sympy(known))
        for body in scene.bodies.values():
            for name in body.coordinates:
                positions.append(parse(body.start.get(name, 0)).to_sympy(known))  # type: ignore[call-overload]
                rates.append(parse(body.start.get(f"d{name}", 0)).to_sympy(known))  # type: ignore[call-overload]
        return [*positions, *rates, *(lever(name, known) for name in scene.bodies)]

    def lever(name: str, known: Mapping[str, sp.Symbol]) -> sp.Expr:
        """Return mass times the longest arm squared of the body's contact points."""
        arms = [
            sp.Add(*(parse(text).to_sympy(known) ** 2 for text in contact.point.at))
            for contact in scene.contacts.values()
            if contact.point.body == name
        ]
        mass = parse(scene.bodies[name].mass).to_sympy(known)
        return mass * (sp.Max(*arms) if arms else sp.S.Zero)

    return Parameters(scene.parameters, derived, initial)


class SceneLaws:
    """The laws of a scene (see `statechart.automaton.Laws`).

    Parameters
    ----------
    scene : Scene
        As declared.
    mechanics : Mechanics
        Its equations.
    parameters : Parameters
        From `scene_parameters`.
    stops : mapping
        Stop condition -> margin.
    """

    def __init__(
        self,
        scene: Scene,
        mechanics: Mechanics,
        parameters: Parameters,
        stops: Mapping[str, Margin],
    ) -> None:
        self._scene = scene
        self._parameters = parameters
        self._places = {name: i for i, name in enumerate(parameters.names)}
        symbols = list(parameters.symbols.values())
        self._tape = SnapshotTape(mechanics, symbols)
        self._scales = ScaleTape(mechanics, symbols)
        drift: list[sp.Expr] = []
        for name in scene.contacts:
            geometry = mechanics.contact(name)
            drift += [geometry.distance, geometry.symbols.gap_rate, geometry.symbols.slip]
            drift += geometry.point
        self._drift_tape = compile_tape(
            drift,
            variables=(*mechanics.q, *mechanics.v),
            parameters=symbols,
            time=mechanics.time,
        )
        self._names = tuple(scene.contacts)
        self._contacts = tuple(
            self._reader(name, contact) for name, contact in scene.contacts.items()
        )
        self._stops = tuple(stops)
        self._stop_tape = compile_tape(
            [margin.expression for margin in stops.values()],
            variables=(*mechanics.q, *mechanics.v),
            parameters=symbols,
            time=mechanics.time,
            definitions=[
                (force, sp.S.Zero) for pair in mechanics.forces.values() for force in pair
            ],
        )
        self._inertias = [(name, self._places.get(f"{name}.inertia")) for name in scene.bodies]
        self._physical: set[tuple[tuple[str, float], ...]] = set()

    def setup(self, overrides: Mapping[str, float], relative: float) -> SceneSetup:
        """Evaluate parameters, initial state, scales and tolerances."""
        values, further = self._parameters.values(overrides)
        values, warnings = self._point_masses(values, further[-len(self._inertias) :])
        initial = further[: -len(self._inertias)]
        key = tuple(sorted(overrides.items()))
        if overrides and key not in self._physical:
            self._scene.check_numbers(self._scene.values(overrides))
            self._physical.add(key)
        if not np.isfinite(initial).all():
            raise DeclarationProblem("the initial state is not finite", loc=("bodies",))
        contacts = tuple(read(values) for read in self._contacts)
        scales = self._scales.at(values, initial)
        margins = self._stop_tape.at(initial, values, 0.0).tolist()
        tolerances = {
            "gap": max(3.0 * relative, _ROUNDING) * scales.length,
            "speed": max(10.0 * relative, 10.0 * _ROUNDING) * scales.speed,
            "force": max(10.0 * relative, _FORCE_BAND) * scales.force,
            "plain": 0.0,
        }
        return SceneSetup(
            values=values,
            initial=initial,
            tolerances=tolerances,
            relative=relative,
            warnings=warnings,
            horizon=_LOOK_AHEAD * scales.length / scales.speed,
            scales=scales,
            contacts=contacts,
            capture=math.sqrt(max(relative, _ROUNDING)) * scales.speed,
            stops={n: _ROUNDING * abs(v) for n, v in zip(self._stops, margins, strict=True)},
        )

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the first mode, checked against the declared one."""
        assert isinstance(setup, SceneSetup)
        state = setup.initial
        snapshot = self._tape.at(setup.values, state, 0.0)
        for law, contact in zip(setup.contacts, snapshot.contacts, strict=True):
            if contact.gap < -max(_START_DEPTH * setup.scales.length, setup.tolerances["gap"]):
                raise DeclarationProblem(
                    f"contact {law.name!r} starts inside its surface, {-contact.gap:.6g} deep",
                    advice="move the body out of the surface",
                    loc=("contacts", law.name),
                )
            if contact.gap > setup.tolerances["gap"] and "free" not in law.states:
                raise DeclarationProblem(
                    f"contact {law.name!r} starts {contact.gap:.6g} off its surface, "
                    "and free is not among its modes",
                    loc=("contacts", law.name, "modes"),
                )
        closed = [c.gap <= setup.tolerances["gap"] for c in snapshot.contacts]
        slow = setup.tolerances["speed"]
        touching = [
            shut and abs(c.gap_rate) <= slow
            for shut, c in zip(closed, snapshot.contacts, strict=True)
        ]
        key = tuple("slide" if shut else "free" for shut in touching)
        inside = [c.gap < 0.0 for c in snapshot.contacts]
        landed = self._projected(key, snapshot, state, inside) if any(inside) else state
        landed = self._landed(setup, key, snapshot, landed) if landed is state else landed
        if landed is not state:
            state, snapshot = landed, self._tape.at(setup.values, landed, 0.0)
        choice = self._choose(setup, snapshot, touching)
        self._check_declared(choice, touching)
        taken = choice.taken.states
        settled = not any(
            shut and c.gap_rate < -slow for shut, c in zip(closed, snapshot.contacts, strict=True)
        )
        return self._flow(setup, taken, warning=choice.warning, settled=settled), state

    def jump(
        self,
        setup: Setup,
        clock: Clock,
        j: int,
        flow: Flow,
        state: Array,
        fired: tuple[str, ...],
    ) -> tuple[Jump, Flow] | None:
        """Classify every contact from the state; see `contacts.classify`."""
        assert isinstance(setup, SceneSetup)
        snapshot = self._tape.at(setup.values, state, clock.high)
        slow, close = setup.tolerances["speed"], setup.tolerances["gap"]
        closed = [c.gap <= close for c in snapshot.contacts]
        hitting = [i for i, c in enumerate(snapshot.contacts) if closed[i] and c.gap_rate < -slow]
        if hitting:
            return self._impact(setup, clock, j, flow, state, fired, snapshot, hitting, closed)
        touching = [
            shut and c.gap_rate <= slow for shut, c in zip(closed, snapshot.contacts, strict=True)
        ]
        choice = self._choose(setup, snapshot, touching)
        target = choice.taken.states
        skipping = flow.flow != flow.mode
        if target == flow.flow and not (skipping and fired == ("zeno",)):
            return None
        after = self._landed(setup, target, snapshot, state)
        energy = snapshot.energy
        left = energy if after is state else self._energy(setup, after, clock.high)
        jump = Jump(
            clock.high,
            j,
            *self._cause(flow.mode, target, skipping),
            flow.mode,
            target,
            state,
            after,
            fired,
            considered=choice.considered,
            energy=(energy, left),
        )
        return jump, self._flow(setup, target, warning=choice.warning)

    def project(self, setup: Setup, flow: Key, state: Array, anchor: Array) -> Array:
        """Return `state` on the constraints of `flow`; the same object while they hold."""
        assert isinstance(setup, SceneSetup)
        if flow.count("free") == len(flow):
            return state
        now = self._drift_tape.at(state, setup.values, 0.0).tolist()
        then = self._drift_tape.at(anchor, setup.values, 0.0).tolist() if "pin" in flow else now
        near, slow = _DRIFT * setup.tolerances["gap"], _DRIFT * setup.tolerances["speed"]
        for i, name in enumerate(flow):
            if name == "free":
                continue
            gap, gap_rate, slip, x, y = now[5 * i : 5 * i + 5]
            off = abs(gap) > near or abs(gap_rate) > slow
            if name == "pin":
                off |= math.hypot(x - then[5 * i + 3], y - then[5 * i + 4]) > near
                off |= abs(slip) > slow
            if off:
                snapshot = self._tape.at(setup.values, state, 0.0)
                held = self._tape.at(setup.values, anchor, 0.0)
                return self._projected(flow, snapshot, state, [n != "free" for n in flow], held)
        return state

    def _impact(
        self,
        setup: SceneSetup,
        clock: Clock,
        j: int,
        flow: Flow,
        state: Array,
        fired: tuple[str, ...],
        snapshot: Snapshot,
        hitting: list[int],
        closed: list[bool],
    ) -> tuple[Jump, Flow]:
        if sum(closed) > 1:
            names = ", ".join(
                law.name for law, shut in zip(setup.contacts, closed, strict=True) if shut
            )
            raise NoConsistentMode(f"an impact with several closed contacts ({names})")
        place = hitting[0]
        law, contact = setup.contacts[place], snapshot.contacts[place]
        n = len(snapshot.velocity)
        result = impact(snapshot, contact, law, law.restitution)
        after = np.concatenate([state[:n], result.velocity])
        landed = self._tape.at(setup.values, after, clock.high)
        rebound = landed.contacts[place].gap_rate
        rest = self._rest_of_bounces(setup, landed, place, rebound)
        considered: Mapping[str, str]
        following: Key | None
        if rest is None and rebound > setup.tolerances["speed"]:
            following, considered = None, {}
        else:
            if law.restitution > 0.0:
                result = impact(snapshot, contact, law, 0.0)
                after = np.concatenate([state[:n], result.velocity])
                landed = self._tape.at(setup.values, after, clock.high)
            touching = [i == place for i in range(len(closed))]
            choice = self._choose(setup, landed, touching)
            considered = choice.considered
            following = choice.taken.states
            after = self._landed(setup, following, landed, after)
            # While bounces are skipped the contact is still free, and moves as if closed.
            target = following if rest is None else flow.mode
        if following is None:
            target = tuple("free" if i == place else name for i, name in enumerate(flow.mode))
        jump = Jump(
            clock.high,
            j,
            law.name,
            "touchdown",
            flow.mode,
            target,
            state,
            after,
            fired,
            impulse={law.name: (result.normal, result.tangential)},
            considered=considered,
            energy=(snapshot.energy, self._energy(setup, after, clock.high)),
            skipped=rest or 0.0,
        )
        if following is None:
            return jump, self._flow(setup, target)
        return jump, self._flow(setup, target, following, rest)

    def _rest_of_bounces(
        self, setup: SceneSetup, landed: Snapshot, place: int, rebound: float
    ) -> float | None:
        """Return how long the bounces after this one would take, where they need no resolving.

        They sum to ``2 v / (g_n (1 - e))`` (equation 5); the impulse of a plastic impact plus the
        weight over that time equals the exact sum of theirs.
        """
        e = setup.contacts[place].restitution
        if not 0.0 < rebound < setup.capture or not 0.0 < e < 1.0:
            return None
        free = choose(
            landed, setup.contacts, [False] * len(setup.contacts), setup.scales, 0.0, 0.0
        ).taken
        contact = landed.contacts[place]
        falling = -(float(contact.jacobian[0] @ free.accelerations) + contact.bias_n)
        return 2.0 * rebound / (falling * (1.0 - e)) if falling > 0.0 else None

    def _choose(self, setup: SceneSetup, snapshot: Snapshot, touching: list[bool]) -> Choice:
        tie = 0.5 * setup.tolerances["force"] / setup.scales.force
        return choose(
            snapshot, setup.contacts, touching, setup.scales, tie, 2.0 * setup.tolerances["speed"]
        )

    def _landed(self, setup: SceneSetup, key: Key, snapshot: Snapshot, state: Array) -> Array:
        """Return `state` on the constraints of the mode entered; the same object if it is."""
        near, slow = _DRIFT * setup.tolerances["gap"], _DRIFT * setup.tolerances["speed"]
        for contact, name in zip(snapshot.contacts, key, strict=True):
            off = abs(contact.gap) > near or abs(contact.gap_rate) > slow
            if name != "free" and (off or (name == "pin" and abs(contact.slip) > slow)):
                return self._projected(key, snapshot, state, [n != "free" for n in key])
        return state

    def _energy(self, setup: SceneSetup, state: Array, time: float) -> float:
        return self._tape.at(setup.values, state, time).energy

    def _projected(
        self,
        key: Key,
        snapshot: Snapshot,
        state: Array,
        positions: list[bool],
        held: Snapshot | None = None,
    ) -> Array:
        """Bring position and velocity onto the constraints, nearest in the mass metric.

        Parameters
        ----------
        key : Key
            Whose constraints.
        positions : list of bool
            Per contact, whether its gap is closed too.
        held : Snapshot, optional
            Where pinned points were when they were pinned.
        """
        n = len(snapshot.velocity)
        rows, off, rates = [], [], []
        for i, (contact, name) in enumerate(zip(snapshot.contacts, key, strict=True)):
            if name == "free" and not positions[i]:
                continue
            rows.append(contact.jacobian[0])
            off.append(-contact.gap)
            rates.append(-contact.gap_rate if name != "free" else 0.0)
            if name == "pin":
                moved = 0.0
                if held is not None:
                    before = held.contacts[i]
                    moved = contact.tx * (contact.x - before.x) + contact.ty * (
                        contact.y - before.y
                    )
                rows.append(contact.jacobian[1])
                off.append(-moved)
                rates.append(-contact.slip)
        if not rows:
            return state
        jacobian = np.array(rows)
        count = len(rows)
        block = np.hstack([jacobian, np.zeros((count, count))])
        zero = np.zeros(n)
        shift = solve_kkt(snapshot.mass, zero, block, jacobian.T, np.array(off))
        change = solve_kkt(snapshot.mass, zero, block, jacobian.T, np.array(rates))
        if shift is None or change is None:
            return state
        return state + np.concatenate([shift[0], change[0]])

    def _flow(
        self,
        setup: SceneSetup,
        mode: Key,
        flow: Key | None = None,
        rest: float | None = None,
        warning: str = "",
        settled: bool = True,
    ) -> Flow:
        remaining = math.inf if rest is None else rest
        return Flow(mode, flow or mode, remaining, warning, settled, tolerances=setup.stops)

    def _check_declared(self, choice: Choice, touching: list[bool]) -> None:
        for name, declared in self._scene.modes.items():
            place = self._names.index(name)
            found = choice.taken.states[place]
            if declared not in (found, found.rstrip("+-")):
                why = next(
                    (
                        reason
                        for label, reason in choice.considered.items()
                        if f"{name}:{declared}" in label.split()
                    ),
                    "its gap is closed" if touching[place] else "its gap is open or opening",
                )
                raise DeclarationProblem(
                    f"contact {name!r} cannot start in mode {declared!r}: {why}",
                    advice=f"the initial state calls for {found!r}",
                    loc=("modes", name),
                )

    def _cause(self, source: Key, target: Key, skipping: bool) -> tuple[str, str]:
        """Return (region, cause) of the first contact that changes."""
        for name, before, after in zip(self._names, source, target, strict=True):
            if before == after:
                continue
            if before == "free":
                return name, "zeno" if skipping else "touchdown"
            if after == "free":
                return name, "liftoff"
            if after == "pin":
                return name, "stick"
            return name, "slip" if before == "pin" else "reverse"
        return self._names[0], "zeno"

    def _point_masses(self, values: Array, levers: Array) -> tuple[Array, tuple[str, ...]]:
        """Set to zero the moments of inertia that cannot be told from it."""
        warnings = []
        for (name, place), lever in zip(self._inertias, levers, strict=True):
            if place is not None and 0.0 < values[place] < _POINT_MASS * lever:
                warnings.append(
                    f"the inertia of {name!r}, {values[place]:g}, is below {_POINT_MASS:g} of its "
                    "mass times arm squared: computed as a point mass"
                )
                values = values.copy()
                values[place] = 0.0
        return values, tuple(warnings)

    def _reader(self, name: str, contact: Contact) -> Callable[[Array], ContactLaw]:
        """Return what reads a contact's coefficients off the values of a run."""
        region_states = states(contact)
        n, t, e = (self._places.get(f"{name}.{k}") for k in ("cone_n", "cone_t", "restitution"))
        # Without symbols: frictionless (1, 0), or without slide (0, 1), as in `cones`.
        fixed = (1.0, 0.0) if contact.frictionless else (0.0, 1.0)

        def read(values: Array) -> ContactLaw:
            return ContactLaw(
                name,
                region_states,
                fixed[0] if n is None else float(values[n]),
                fixed[1] if t is None else float(values[t]),
                0.0 if e is None else float(values[e]),
                contact.impact,
            )

        return read
