"""The usual instants of a scene, compiled (see `statechart.automaton.laws.Ordinary`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from contacts.dynamics.contact_law import ContactLaw, cones
from contacts.dynamics.projection import Projection, landing, unseen_room
from contacts.dynamics.setup import SceneSetup
from contacts.event_driven.decision import cause, decide
from contacts.event_driven.hit import SceneWatch
from contacts.event_driven.impact_jump import Landing, Rules, flow_in, impact_jump
from contacts.event_driven.run_on import run_on
from contacts.impacts.bounces import FAST
from contacts.impacts.impact import MEANINGS, pieces
from contacts.impacts.jamming import Jam
from contacts.modes.classification import Considered
from contacts.modes.fast_classification import allowed
from contacts.scene.parts import MOREAU
from contacts.states import CODES, OFF
from statechart.arrays import Array
from statechart.automaton.laws import Flow, Instant, Setup, roles_in
from statechart.automaton.recording import Event
from statechart.automaton.trace import Clock, Jump, Key, Roles
from statechart.engines.whole_flow import Watch
from statechart.execution.ahead import KINDS, Loop
from statechart.formulas.tape import Tape
from statechart.kernels.jit import is_cached

_CAUSES = ("touchdown", "liftoff", "stick", "slip", "reverse")


class SceneInstants:
    """The usual instants of a scene without joints and conditions.

    Parameters
    ----------
    names : tuple of str
        Of the contacts.
    rules : Rules
        What the scene says of impacts, and its numbers.
    projection : Projection
        Of its constraints.
    """

    def __init__(self, names: tuple[str, ...], rules: Rules, projection: Projection) -> None:
        self._names, self._rules, self._projection = names, rules, projection
        self.tapes = rules.tape.tape, projection.tape
        self.series = tuple((name, cause) for name in names for cause in _CAUSES)

    def compiled(self) -> bool:
        """Whether the loop lies compiled on disk."""
        return is_cached(run_on)

    def listed(self, mode: Key, roles: Roles) -> Sequence[int] | None:
        """Return the numbers of the contacts' states; None where one moves as another."""
        if OFF in mode or roles != roles_in(mode):
            return None
        return [CODES[state] for state in mode]

    def takes(self, setup: Setup, flow: Flow) -> bool:
        """Whether no bounces are skipped in a flow, and its margins have their usual tolerances."""
        assert isinstance(setup, SceneSetup)
        usual = flow.tolerances is setup.bands or flow.tolerances == setup.bands
        return usual and flow.remaining == math.inf and not flow.held

    def within(self, mode: Key) -> Tape | None:
        """Return what tells that a step passed over a bump of a surface, or a dip, unseen."""
        return self._projection.unseen(mode)

    def ready(
        self, setup: Setup, loop: Loop, floors: Array
    ) -> Callable[..., tuple[int, int, float]]:
        """Return the loop for the numbers of a run."""
        assert isinstance(setup, SceneSetup)
        tolerances = setup.tolerances
        numbers, constraints = loop.tapes
        count = len(self._projection.tape.outputs)
        watch = Watch(
            setup.values,
            np.array([tolerances[kind] for kind in KINDS]),
            np.array([setup.bands.get(name, -1.0) for name in loop.margins]),
            floors,
            constraints,
            np.zeros(count),
            np.zeros(count),
            unseen_room(tolerances, setup.scales),
        )
        near, creep = landing(tolerances)
        scene = SceneWatch(
            numbers,
            allowed(tuple([law.states for law in setup.contacts])),
            cones(setup.contacts),
            np.array([law.restitution for law in setup.contacts]),
            np.array([_meaning(law) for law in setup.contacts], np.int64),
            near,
            creep,
            tolerances["gap"],
            tolerances["speed"],
            setup.tie,
            setup.scales.force,
            setup.scales.acceleration,
            setup.short,
            FAST * setup.scales.speed,
        )
        return partial(run_on, loop.program, loop.pace, watch, loop.memory, scene)

    def jump(self, setup: Setup, event: Event, fired: str) -> Jump:
        """Return the jump to the one mode that agreed with the state."""
        assert isinstance(setup, SceneSetup)
        state, time = event.before, event.t
        region, how = cause(self._names, event.source, event.target, False)
        impulse: dict[str, tuple[float, float]] = {}
        path: tuple[str, ...] = ()
        considered = partial(self.considered, setup, state, time)
        if event.struck >= 0:
            region, how = self._names[event.struck], "touchdown"
            path = (" ".join([region, *pieces(event.path)]),)
            if event.normal != 0.0 or event.tangential != 0.0:
                impulse[region] = event.normal, event.tangential
            considered = partial(self._considered_at_impact, setup, event)
        return Jump(
            time,
            event.j,
            region,
            how,
            event.source,
            event.target,
            state,
            event.after,
            (fired,),
            impulse,
            path,
            Considered(considered),
            (event.energy_before, event.energy_after),
        )

    def _considered_at_impact(self, setup: SceneSetup, event: Event) -> Mapping[str, str]:
        flow, clock = flow_in(setup, event.source), Clock(event.t)
        snapshot = self._rules.tape.at(setup.values, event.before, event.t)
        closed = [contact.gap <= setup.tolerances["gap"] for contact in snapshot.contacts]
        at = Instant(setup, clock, event.j, flow, event.before)
        here = Landing(at, setup, snapshot, event.source, closed)
        jump, _, _ = impact_jump(self._rules, here, [event.struck])
        return jump.considered

    def considered(self, setup: SceneSetup, state: Array, time: float) -> Mapping[str, str]:
        """Return every mode considered at a usual instant, and why it was taken or not."""
        snapshot = self._rules.tape.at(setup.values, state, time)
        near, slow = setup.tolerances["gap"], setup.tolerances["speed"]
        touching = [c.gap <= near and c.gap_rate <= slow for c in snapshot.contacts]
        choice = decide(setup, snapshot, touching, self._rules.paradox)
        return {} if isinstance(choice, Jam) else choice.considered


def _meaning(law: ContactLaw) -> int:
    """Return what restitution means where an impact goes along a path."""
    return -1 if law.impact == MOREAU else MEANINGS[law.impact]
