"""What transitions and regions of every kind of document have in common, as declared."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from statechart.documents.fields import NameText, Part, RelationText
from statechart.documents.outputs import Event, check_event, parse_events
from statechart.errors import DeclarationProblem, close_matches


def _checked(text: str) -> str:
    parse_events(text)
    return text


EventText = Annotated[str, AfterValidator(_checked)]
"""An event, or several joined by `or`; kept as written."""


class BaseTransition(Part):
    """A way from one state of a region to another (or the same), and what fires it."""

    name: NameText
    source: str = Field(alias="from")
    target: str = Field(alias="to")
    guard: RelationText | None = Field(default=None, description="Fires when this becomes true.")
    on: EventText | None = Field(
        default=None, description="Fires at an event of another region, such as foot.touchdown."
    )

    @property
    def events(self) -> tuple[Event, ...]:
        """What `on` says."""
        return parse_events(self.on) if self.on is not None else ()

    @model_validator(mode="after")
    def _one_trigger(self) -> Self:
        if (self.guard is None) == (self.on is None):
            raise DeclarationProblem(
                f"transition {self.name!r} needs a guard or an on, and not both",
                advice="write guard: x <= 0, or on: region.event",
            )
        return self


class BaseRegion(Part):
    """States of which exactly one is active, and the transitions between them."""

    initial: str
    states: Mapping[str, Part]
    transitions: tuple[BaseTransition, ...] = ()

    @property
    def ordered(self) -> tuple[str, ...]:
        """The states; the first is where the region starts."""
        return tuple(sorted(self.states, key=lambda state: state != self.initial))

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        """Check that states exist, and that transitions can be told apart."""
        named: list[tuple[str, tuple[str | int, ...]]] = [(self.initial, ("initial",))]
        for index, transition in enumerate(self.transitions):
            named.append((transition.source, ("transitions", index, "from")))
            named.append((transition.target, ("transitions", index, "to")))
        for state, loc in named:
            if state not in self.states:
                raise DeclarationProblem(
                    f"no state {state!r}", advice=close_matches(state, self.states), loc=loc
                )
        seen: set[tuple[str, str, str]] = set()
        for index, transition in enumerate(self.transitions):
            edge = (transition.name, transition.source, transition.target)
            if edge in seen:
                raise DeclarationProblem(
                    f"a second transition {transition.name!r} from {transition.source!r} "
                    f"to {transition.target!r}",
                    advice="give it another name",
                    loc=("transitions", index, "name"),
                )
            seen.add(edge)
        return self


def check_listening(
    region: str,
    transitions: Sequence[BaseTransition],
    causes: Mapping[str, Collection[str]],
    states: Mapping[str, Collection[str]],
    *,
    alone: Collection[str] = (),
) -> None:
    """Check that transitions wait for events that exist, of other regions.

    Parameters
    ----------
    region : str
        Whose they are.
    transitions : sequence of BaseTransition
        In the order of the declaration.
    causes, states : mapping
        Of every region, as for `Declaration.check_uses`.
    alone : collection of str
        Words that `on` may be besides.

    Raises
    ------
    DeclarationProblem
        At the first that does not.
    """
    others = {name: found for name, found in causes.items() if name != region}
    for index, transition in enumerate(transitions):
        loc = ("regions", region, "transitions", index, "on")
        for event in transition.events:
            if event.region == region:
                raise DeclarationProblem(
                    f"{region!r} waits for an event of its own",
                    advice="a transition fires on events of other regions",
                    loc=loc,
                )
            # What stands alone is nobody's: no region has the name "".
            single = event.region is None and len(transition.events) == 1
            check_event(event, {**others, "": alone} if single else others, states, *loc)
