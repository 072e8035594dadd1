"""Violations of contact constraints in a run: penetration, forces outside the friction cone."""

from __future__ import annotations

import math

import numpy as np

from contacts.dynamics.contact_law import edges
from contacts.dynamics.setup import SceneSetup
from contacts.scene.friction import AT_REST
from contacts.scene.scene import Scene
from contacts.states import OFF, declared_state
from statechart.arrays import Array
from statechart.automaton.trace import Key, Trace
from statechart.formulas.formula import Formula, parse
from statechart.observation.observer import Observer

# Number of steps above which each is sampled once.
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
    names = [f"{name}.{what}" for name in scene.contacts for what in ("gap", "V", "H", "slip")]
    by_steps = trace.step is not None
    split = {name for name in scene.contacts if (law := scene.friction_of(name)) and law.splits}
    names += [f"{name}.friction" for name in split if by_steps]
    samples = observer.sample(trace, names, per_step=8 if steps < _MANY else 1)
    deepest = outside = 0.0
    for place, name in enumerate(scene.contacts):
        gap, normal, tangential = (samples.columns[f"{name}.{what}"] for what in ("gap", "V", "H"))
        closed = np.array([key[place] not in ("free", OFF) for key in samples.modes])[samples.mode]
        off = np.array([key[place] == OFF for key in samples.modes])[samples.mode]
        if scene.contacts[name].stiffness is None:
            deepest = max(deepest, _largest(-gap[~off]), _largest(np.abs(gap[closed])))
        outside = max(outside, _largest(-normal[closed]))
        # Per mode: controllers may change the friction.
        for number, mode in enumerate(samples.modes):
            here = closed & (samples.mode == number)
            slips, V, H = samples.columns[f"{name}.slip"][here], normal[here], tangential[here]
            n, t = cone_edges(scene, trace, mode, name, mode[place], slips)
            if by_steps and name in split:
                # Steps use the slip at their start.
                n, t = edges(samples.columns[f"{name}.friction"][here])
            outside = max(outside, _largest(n * np.abs(H) - t * V))
    return {"constraint": deepest / setup.scales.length, "cone": outside / setup.scales.force}


def cone_edges(
    scene: Scene, trace: Trace, mode: Key, name: str, state: str, slips: Array
) -> tuple[Array, Array]:
    """Return the unit edges (1, mu) / hypot(1, mu) of a contact's cone in a state, at slips (k,).

    A controller in the mode may set mu.
    """
    contact, law = scene.contacts[name], scene.friction_of(name)
    if law is None:
        # Without declared friction a pin never slides.
        return edges(np.full(len(slips), 0.0 if contact.frictionless else math.inf))
    values = {name: trace.parameters[name] for name in scene.parameters}
    region = scene.controlled.region_of(law.both)
    now = dict(zip(trace.regions, mode, strict=True)).get(region or "", "")
    seen = dict(scene.controlled.values_by_state(law.both, values, Formula.value))[now]
    text = law.kinetic if declared_state(state) == "slide" else law.static
    if state == "pin" or not law.varies:
        at_rest = dict.fromkeys(law.slips, 0.0)
        return edges(np.full(len(slips), parse(text).value({**seen, **at_rest})))
    direction = math.copysign(AT_REST, -1.0 if state == "slide-" else 1.0)
    return edges(
        np.array([
            parse(text).value({**seen, **dict.fromkeys(law.slips, slip + direction)})
            for slip in slips.tolist()
        ])
    )  # fmt: skip


def _largest(values: np.ndarray) -> float:
    return float(np.fmax.reduce(values, initial=0.0))
