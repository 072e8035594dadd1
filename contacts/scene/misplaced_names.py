"""Names of a scene that a formula cannot use where it stands, and what to write instead."""

from __future__ import annotations

from collections.abc import Collection

from contacts.scene.fields import SceneFields
from contacts.scene.shapes import INDEX
from statechart.documents.declaration import TIME
from statechart.documents.document import Loc
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import Formula
from statechart.formulas.tree import names_in

_OF_CONTACTS = ("gap", "slip", "V", "H")

# What to write in the place of what changes.
_MOVED = "a surface that moves has a displacement, or a turn; a hill is a height, a formula of x"
_SWITCHED = (
    "it is constant as long as a state lasts: write a control, which states of a region set, with "
    "transitions where it changes (guard: abs(tip.slip) >= v)"
)
_PULLED = "write a force on the body, or let the ground move"
_CONSTANT = "write a formula of parameters"


def check_misplaced_names(
    scene: SceneFields, formula: Formula, known: Collection[str], *loc: str | int
) -> None:
    """Refuse names that a formula cannot use where it stands, with what stands in for them.

    Raises
    ------
    DeclarationProblem
        At a control, what a controller remembers, the number of a copy, or what changes along a
        run where nothing does.
    """
    for node in names_in(formula.root):
        if node.name in known:
            continue
        what, advice = _reason(scene, node.name, known, loc)
        if advice:
            raise DeclarationProblem(
                f"{node.name!r}: {what}", advice=advice, loc=loc, offset=node.offset
            )


def _reason(scene: SceneFields, name: str, known: Collection[str], loc: Loc) -> tuple[str, str]:
    """Return why a name cannot stand in a place, and what to write; nothing for any other."""
    led = loc[0] in ("surfaces", "joints") and TIME in known
    if led and name in scene.controls and scene.collisions:
        return (
            "a control changes at an instant, and moves nothing",
            "let a variable of a region flow, and write that",
        )
    if led and name in {*scene.controls, *scene.controlled.memory}:
        return (
            "controllers move no surface, and no joint, of what touches by points",
            f"write a formula of {TIME}, or give bodies shapes, and collisions",
        )
    if name == INDEX and loc[-2:-1] == ("start",):
        return "it is the number of a copy", "say how many there are, beside start: copies: N"
    if name == INDEX and any(body.copies is not None for body in scene.bodies.values()):
        return (
            "copies are alike but for their start",
            "declare bodies that differ in more one by one",
        )
    if TIME not in known and name in _changing(scene):
        switched = loc[0] == "contacts" and loc[-1] in ("friction", "restitution")
        advice = {"surfaces": _MOVED, "gravity": _PULLED}.get(str(loc[0]), _CONSTANT)
        return "it changes along a run, and this does not", _SWITCHED if switched else advice
    return "", ""


def _changing(scene: SceneFields) -> Collection[str]:
    """Return what changes along a run."""
    found = {f"{contact}.{quantity}" for contact in scene.contacts for quantity in _OF_CONTACTS}
    found |= {f"{name}.{force}" for name, one in scene.joints.items() for force in one.components}
    return {*(scene.kinematic_names - {*scene.parameters}), *found, *scene.controls, "energy"}
