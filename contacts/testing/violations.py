"""By how much a run violates what contacts demand: no penetration, forces within friction."""

from __future__ import annotations

import math

import numpy as np

from contacts.dynamics.contact_law import edge
from contacts.dynamics.setup import SceneSetup
from contacts.scene.scene import Scene
from contacts.states import OFF
from statechart.automaton.trace import Key, Trace
from statechart.documents.fields import FormulaText
from statechart.formulas.formula import Formula, parse
from statechart.observation.observer import Observer

# Of a run of many steps fewer points of each are looked at.
_MANY = 5000


def violations(scene: Scene, observer: Observer, trace: Trace) -> dict[str, float]:
    """Return the largest violations over a run, relative to the scene's length and force."""
    if not scene.contacts and not scene.collisions:
        return {"constraint": 0.0, "cone": 0.0}
    values = {name: trace.parameters[name] for name in scene.parameters}
    setup = observer.automaton.setup(values, 1e-12)
    assert isinstance(setup, SceneSetup)
    if scene.collisions:
        gaps = [margin for name, margin in (trace.margins or {}).items() if name.endswith(".gap")]
        return {
            "overlap": _largest(-np.array(gaps)) / setup.scales.length,
            "impulse": trace.tolerances["impulse"],
            "inexact": trace.counts["inexact_steps"] / max(trace.counts["steps"], 1),
        }
    steps = sum(len(arc.coefficients) for arc in trace.arcs)
    names = [f"{name}.{what}" for name in scene.contacts for what in ("gap", "V", "H")]
    samples = observer.sample(trace, names, per_step=8 if steps < _MANY else 1)
    cones = [cone_edges(scene, trace, mode) for mode in samples.modes]
    deepest = outside = 0.0
    for place, name in enumerate(scene.contacts):
        gap, normal, tangential = (samples.columns[f"{name}.{what}"] for what in ("gap", "V", "H"))
        closed = np.array([key[place] not in ("free", OFF) for key in samples.modes])[samples.mode]
        off = np.array([key[place] == OFF for key in samples.modes])[samples.mode]
        if scene.contacts[name].stiffness is None:
            deepest = max(deepest, _largest(-gap[~off]), _largest(np.abs(gap[closed])))
        # Of every mode; what a controller sets may differ.
        n, t = np.array([edges[name] for edges in cones])[samples.mode[closed]].T
        V, H = normal[closed], tangential[closed]
        outside = max(outside, _largest(n * np.abs(H) - t * V), _largest(-V))
    return {
        "constraint": deepest / setup.scales.length,
        "cone": outside / setup.scales.force,
    }


def cone_edges(scene: Scene, trace: Trace, mode: Key) -> dict[str, tuple[float, float]]:
    """Return the cone's unit edge (1, mu) / hypot(1, mu) of every contact in a mode."""
    values = {name: trace.parameters[name] for name in scene.parameters}
    states = dict(zip(trace.regions, mode, strict=True))
    controls = scene.controlled

    def value(text: FormulaText) -> float:
        now = states.get(controls.region_of(text) or "", "")
        seen = dict(controls.seen_in_states(text, values, Formula.value))
        return parse(text).value(seen[now])

    result = {}
    for name, contact in scene.contacts.items():
        # Where friction is not declared a pin does not slide, whatever that takes.
        held = 0.0 if contact.frictionless else math.inf
        mu = held if contact.friction is None else value(contact.friction)
        result[name] = edge(mu)
    return result


def _largest(values: np.ndarray) -> float:
    """Return the largest value that is a number and positive, else 0."""
    return float(np.fmax.reduce(values, initial=0.0))
