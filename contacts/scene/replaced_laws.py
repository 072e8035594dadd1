"""Declared laws of impact that time stepping replaces by Moreau's."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

from contacts.scene.fields import SceneFields
from contacts.scene.parts import MOREAU, Contact, Point
from statechart.formulas.formula import parse


def replaced(scene: SceneFields, values: Mapping[str, float]) -> dict[str, str]:
    """Return what a run by time stepping does without: a declared law -> what is done instead."""
    found = {}
    hit = {name: c for name, c in scene.contacts.items() if "free" in c.kinds}
    if scene.simultaneous == "sequential" and hit and _meet(scene):
        found["simultaneous: sequential"] = (
            "time stepping resolves what is hit together at once, by Moreau's law, as with capped"
        )
    if scene.paradox == "stop" and scene.collisions:
        found["paradox: stop"] = (
            "bodies with shapes whose friction presses them in are stopped by an impact, as with "
            "impact"
        )
    others: dict[str, list[str]] = {}
    for name, contact in hit.items():
        if contact.impact != MOREAU and not _agrees(scene, contact, values):
            others.setdefault(contact.impact, []).append(name)
    for law, names in others.items():
        found[f"impact: {law} at {', '.join(names)}"] = (
            "time stepping applies Moreau's law: with events, impact: moreau is the same"
        )
    return found


def _meet(scene: SceneFields) -> bool:
    """Whether a body has several contacts, or bodies may feel those of others."""
    linked = bool(scene.joints) or any(body.position is not None for body in scene.bodies.values())
    touched = sorted(
        body
        for contact in scene.contacts.values()
        for body in (contact.point.body, scene.surfaces[contact.surface].body)
        if body is not None
    )
    return len(scene.contacts) > 1 and (linked or any(a == b for a, b in pairwise(touched)))


def _agrees(scene: SceneFields, contact: Contact, values: Mapping[str, float]) -> bool:
    """Whether all laws are one: no friction, or a particle whose push moves it along the push."""
    if contact.frictionless:
        return True
    if contact.friction is not None:
        friction = parse(contact.friction)
        if set(friction.names) <= set(values) and friction.value(values) == 0.0:
            return True
    name = contact.point.body
    body = scene.bodies[name]
    jointed = any(
        end.body == name
        for joint in scene.joints.values()
        for end in (joint.point, joint.to)
        if isinstance(end, Point)
    )
    fixed = scene.surfaces[contact.surface].body is None
    return body.inertia is None and body.position is None and fixed and not jointed
