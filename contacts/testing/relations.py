"""Properties of two scenes at once: a scene and its image in a mirror, and in other units."""

from __future__ import annotations

from collections.abc import Callable

from contacts.scene.scene import Scene
from contacts.testing.symmetry import mirrored, rescaled
from statechart.errors import DeclarationError
from statechart.testing.agreement import assert_same, identical
from statechart.testing.properties import Property
from statechart.testing.stories import Reading
from statechart.testing.subject import Case, Subject


def relations(scene: Scene) -> tuple[Property, ...]:
    """Return what holds of the runs of a scene and of those of its images."""
    return (
        relation("the mirror image moves as the image", scene, mirrored),
        relation("other units give the same motion", scene, rescaled),
    )


def relation(
    name: str, scene: Scene, transform: Callable[[Scene], tuple[Scene, Reading]]
) -> Property:
    """Return the property that the transformed scene has the transformed runs."""
    changed: dict[Subject, tuple[Subject, Reading]] = {}

    def compare(case: Case) -> None:
        own = case.subject
        assert isinstance(own.model, Scene)
        if own not in changed:
            turned, reading = transform(own.model)
            changed[own] = Subject(turned), reading
        subject, reading = changed[own]
        trace = case.sound[0]
        image = subject.fresh(case.parameters).trace
        assert image.outcome is trace.outcome, f"the changed scene ends: {image.message}"
        if not identical(trace, image, reading):
            assert_same(trace, image, case.sensitivity, reading=reading)

    try:
        transform(scene)
    except DeclarationError as error:
        reason = error.message
        return Property(name, lambda case: None, f"the scene cannot be transformed: {reason}")

    def holds(case: Case) -> None:
        try:
            compare(case)
        except AssertionError:
            finer = case.subject.finer
            if finer is None:
                raise
            # What impulses miss their laws by is in no variable's size, nor the image's in the
            # image: runs that miss less tell whether it was that.
            compare(finer.case(case.parameters))

    return Property(name, holds)
