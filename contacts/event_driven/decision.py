"""The mode that a state calls for, or what resolves it where no mode does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.impacts.jamming import Jam, jammed, paradoxes
from contacts.modes.classification import ENDLESS, Before, Choice, ForceUncertainty, choose
from contacts.scene.parts import Resolution
from contacts.states import INACTIVE, OFF, cause_of, superstates_of
from statechart.automaton.trace import Key
from statechart.errors import DeclarationProblem, NoConsistentMode


def decide(
    setup: SceneSetup,
    snapshot: Snapshot,
    touching: Sequence[bool],
    paradox: Resolution,
    before: Before | None = None,
    uncertainty: ForceUncertainty | None = None,
) -> Choice | Jam:
    """Return the mode that the touching contacts take, or the jam that has to come first.

    `uncertainty` bounds the error of the state where contacts may have come to rest. An error lists
    every candidate with its reason, and the paradoxes met.
    """
    check_listed(setup, snapshot, touching)
    still = 2.0 * setup.tolerances["speed"]
    try:
        choice = choose(
            snapshot, setup.contacts, touching, setup.scales, setup.tie, still, before, uncertainty
        )
    except NoConsistentMode as error:
        jam = jammed(snapshot, setup.contacts, touching, still)
        if paradox == "impact" and jam is not None:
            return replace(jam, considered=error.considered)
        found = paradoxes(snapshot, setup.contacts, touching, still)
        reports = "".join(f"; {one}" for one in found.values())
        raise NoConsistentMode(f"{error}{reports}", considered=error.considered) from None
    if np.abs(choice.taken.forces).max(initial=0.0) > ENDLESS * setup.scales.force:
        jam = jammed(snapshot, setup.contacts, touching, still)
        if paradox == "impact" and jam is not None:
            return replace(jam, considered=choice.considered)
    if choice.warning:
        found = paradoxes(snapshot, setup.contacts, touching, still)
        warning = "; ".join([choice.warning, *map(str, found.values())])
        choice = choice._replace(warning=warning)
    return choice


def check_listed(setup: SceneSetup, snapshot: Snapshot, touching: Sequence[bool]) -> None:
    """Refuse a state that a contact does not list, whatever the forces: open, or slipping."""
    close, still = setup.tolerances["gap"], 2.0 * setup.tolerances["speed"]
    for law, contact, shut in zip(setup.contacts, snapshot.contacts, touching, strict=True):
        if (
            law.coupling
            or "free" in law.states
            or (contact.gap <= close and not shut and contact.gap_rate < 0.0)
        ):
            continue
        if not shut:
            moves, lacks = f"leaves its surface at {contact.gap_rate:.3g}", "free"
        elif law.states == ("pin",) and abs(contact.slip) > still:
            moves, lacks = f"slips at {contact.slip:.3g}", "slide"
        else:
            continue
        raise NoConsistentMode(
            f"contact {law.name!r} {moves}, and {lacks} is not among its modes; "
            "add it, or end the run before"
        )


def explained(
    before: Mapping[str, str],
    laws: Sequence[ContactLaw],
    contacts: Sequence[PerContact],
    closed: Sequence[bool],
    touching: Sequence[bool],
    after: Mapping[str, str],
) -> dict[str, str]:
    """Return what was considered at an impact: mode or state -> why it was taken or not.

    `before` holds what did not agree with the state, where that caused the impact; `closed`
    contacts took part, `touching` ones are not thrown off, and `after` was considered for those.
    """
    found = {label: f"before the impact {why}" for label, why in before.items()}
    for law, contact, hit, stays in zip(laws, contacts, closed, touching, strict=True):
        if hit and not stays:
            rises = f"it leaves its surface at {contact.gap_rate:.3g}"
            for state in law.states:
                if state not in INACTIVE:
                    label = f"{law.name}:{state}"
                    words = f"taken: {rises}" if state == "free" else rises
                    found[label] = "; ".join(filter(None, (words, found.get(label))))
    return {**found, **after}


def check_declared(
    modes: Mapping[str, str],
    names: Sequence[str],
    choice: Choice,
    snapshot: Snapshot,
    touching: Sequence[bool],
    failing: Sequence[str],
) -> None:
    """Check the initial modes that a scene declares against those that its state calls for."""
    for name, declared in modes.items():
        place = names.index(name)
        found = choice.taken.states[place]
        if declared not in {found, *superstates_of((found,)).values()}:
            why = next(
                (
                    reason
                    for label, reason in choice.considered.items()
                    if {f"{name}:{declared}{way}" for way in ("", "+", "-")} & {*label.split()}
                ),
                f"its point slips at {snapshot.contacts[place].slip:.3g}"
                if touching[place]
                else "its gap is open or opening",
            )
            if found == OFF:
                why = f"the condition {failing[place]} fails"
            elif declared == OFF:
                why = "its conditions hold, and it is not inside its surface"
            raise DeclarationProblem(
                f"contact {name!r} cannot start in mode {declared!r}: {why}",
                advice=f"the initial state calls for {found!r}",
                loc=("modes", name),
            )


def cause(names: Sequence[str], source: Key, target: Key, skipping: bool) -> tuple[str, str]:
    """Return (region, cause) of the first contact that changes."""
    for name, before, after in zip(names, source, target, strict=True):
        if before != after:
            return name, "zeno" if skipping and before == "free" else cause_of(before, after)
    return names[0], "zeno"
