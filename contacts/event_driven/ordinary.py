"""The usual instants of a scene, compiled (see `statechart.automaton.laws.Ordinary`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from contacts.dynamics.contact_law import cones
from contacts.dynamics.projection import Projection, landing, unseen_room
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SnapshotTape
from contacts.event_driven.decision import cause, decide
from contacts.event_driven.run_on import SceneWatch, run_on
from contacts.impacts.jamming import Jam
from contacts.modes.classification import Considered
from contacts.modes.fast_classification import allowed
from contacts.scene.parts import Resolution
from contacts.states import CODES, OFF
from statechart.arrays import Array
from statechart.automaton.laws import Flow, Setup, roles_in
from statechart.automaton.recording import Event
from statechart.automaton.trace import Jump, Key, Roles
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
    numbers : SnapshotTape
        The scene's numbers.
    projection : Projection
        Of its constraints.
    paradox : str
        What resolves states without a mode.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        numbers: SnapshotTape,
        projection: Projection,
        paradox: Resolution,
    ) -> None:
        self._names, self._numbers, self._paradox = names, numbers, paradox
        self._projection = projection
        self.tapes = numbers.tape, projection.tape
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
            near,
            creep,
            tolerances["gap"],
            tolerances["speed"],
            setup.tie,
            setup.scales.force,
            setup.scales.acceleration,
            setup.short,
        )
        return partial(run_on, loop.program, loop.pace, watch, loop.memory, scene)

    def jump(self, setup: Setup, event: Event, fired: str) -> Jump:
        """Return the jump to the one mode that agreed with the state."""
        assert isinstance(setup, SceneSetup)
        return Jump(
            event.t,
            event.j,
            *cause(self._names, event.source, event.target, False),
            event.source,
            event.target,
            event.before,
            event.after,
            (fired,),
            considered=Considered(partial(self.considered, setup, event.before, event.t)),
            energy=(event.energy_before, event.energy_after),
        )

    def considered(self, setup: SceneSetup, state: Array, time: float) -> Mapping[str, str]:
        """Return every mode considered at a usual instant, and why it was taken or not."""
        snapshot = self._numbers.at(setup.values, state, time)
        near, slow = setup.tolerances["gap"], setup.tolerances["speed"]
        touching = [c.gap <= near and c.gap_rate <= slow for c in snapshot.contacts]
        choice = decide(setup, snapshot, touching, self._paradox)
        return {} if isinstance(choice, Jam) else choice.considered
