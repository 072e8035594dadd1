"""Errors of this project, as one tree of exceptions.

::

    StatechartError
      DeclarationError        the input is wrong: what, where (file:line:column), what to do
        FormulaError          a formula in it cannot be read or evaluated
      SimulationError         a run cannot go on: why, with the trace so far, by class

`DeclarationProblem` stands outside the tree: validators of pydantic models raise it to point at a
field; `statechart.documents.validation.validate` turns it into a `DeclarationError`.
"""
# ruff: noqa: N818 -- the outcomes of a run are named after what happened, as users read them.

from __future__ import annotations

import difflib
import heapq
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import KW_ONLY, InitVar, dataclass
from typing import ClassVar

Loc = tuple[str | int, ...]
"""Keys and indices that lead to a place in a document."""

MAX_PROBLEMS = 20
"""Greatest number of listed problems; the search for more stops, as each takes time for advice."""


@dataclass(frozen=True, slots=True)
class Position:
    """A place in a text; lines and columns count from 1."""

    source: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}"

    def shifted(self, columns: int) -> Position:
        """Return the place `columns` further right on the same line."""
        return Position(self.source, self.line, self.column + columns)

    def error(self, message: str, advice: str = "") -> DeclarationError:
        """Return an error at this place."""
        return DeclarationError(
            message, advice=advice, source=self.source, line=self.line, column=self.column
        )


class StatechartError(Exception):
    """Root of every error that this project raises on purpose."""


@dataclass(eq=False, repr=False)
class DeclarationError(StatechartError):
    """The input is wrong.

    Parameters
    ----------
    message : str
        What is wrong and what was expected, without its place.
    advice : str
        What to do about it; may be empty.
    source : str
        The file, or a name in angle brackets for text from elsewhere; empty if unknown.
    line, column : int, optional
        The place, counted from 1.
    others : tuple of DeclarationError
        Further errors of the same document, in its order; `str` prints up to `MAX_PROBLEMS` in all.
    """

    message: str
    _: KW_ONLY
    advice: str = ""
    source: str = ""
    line: int | None = None
    column: int | None = None
    others: tuple[DeclarationError, ...] = ()

    def __post_init__(self) -> None:
        super().__init__(self.message)

    def __str__(self) -> str:
        place = [str(part) for part in (self.source, self.line, self.column) if part]
        prefix = ":".join(place) + ": " if self.source else ""
        own = prefix + "; ".join(filter(None, (self.message, self.advice)))
        listed = [own, *map(str, self.others[: MAX_PROBLEMS - 1])]
        more = len(self.others) >= MAX_PROBLEMS
        note = [f"only {MAX_PROBLEMS} problems are listed: there are more"] if more else []
        return "\n".join([*listed, *note])


@dataclass(eq=False, repr=False)
class FormulaError(DeclarationError):
    """A formula cannot be read or evaluated.

    Parameters
    ----------
    message, advice, source, line, column
        As for `DeclarationError`; the column points into the formula.
    offset : int
        Where in the formula's text, counted from 0.
    name : str
        The named formula concerned, where several are handled at once; else empty.
    text : str
        The formula as written.
    """

    _: KW_ONLY
    offset: int = 0
    name: str = ""
    text: str = ""

    def problem(self, *loc: str | int) -> DeclarationProblem:
        """Return the error as a problem of the field at `loc`."""
        return DeclarationProblem(
            self.message, advice=self.advice, loc=loc, offset=self.offset, text=self.text
        )


@dataclass(eq=False, repr=False)
class DeclarationProblem(ValueError):
    """Error of a validator of a model, which points at a field.

    Parameters
    ----------
    message, advice : str
        As for `DeclarationError`.
    loc : tuple of str or int
        Keys and indices from the validated value down to the field concerned; empty for the
        value itself.
    key : tuple of str or int
        The place instead of `loc`, if its key is wrong rather than its value.
    offset : int
        Where in the field's text, counted from 0.
    text : str
        The formula or relation that `offset` points into, as read; empty for none.
    see : tuple of str or int
        Another place that has to do with it, which `{see}` in the message stands for.
    others : tuple of DeclarationProblem
        Further problems, found by `Findings`.
    """

    message: str
    _: KW_ONLY
    advice: str = ""
    loc: Loc = ()
    key: InitVar[Loc] = ()
    offset: int = 0
    text: str = ""
    see: Loc = ()
    others: tuple[DeclarationProblem, ...] = ()

    def __post_init__(self, key: Loc) -> None:
        self.loc, self.at_key = key or self.loc, bool(key)
        super().__init__(self.message)

    def __str__(self) -> str:
        message = self.message.replace("{see}", ".".join(map(str, self.see)))
        return "; ".join(filter(None, (message, self.advice)))


class Findings:
    """Collects independent problems, and raises them as one error; at once, if they are too many.

    ::

        found = Findings()
        for name in names:
            with found:         # goes on behind it with the next one, whatever is wrong
                check(name)
        found.check()
    """

    def __init__(self) -> None:
        self._found: list[DeclarationProblem] = []

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> bool:
        if not isinstance(error, DeclarationProblem):
            return False
        self._found += [error, *error.others]
        if len(self._found) > MAX_PROBLEMS:
            self.check()
        return True

    def check(self) -> None:
        """Raise the first problem with the others attached, if there are any."""
        if self._found:
            first, *others = self._found
            first.others = tuple(others)
            raise first


class SimulationError(StatechartError):
    """A run cannot go on.

    Parameters
    ----------
    message : str
        Why, with the time, the mode and the margins concerned.
    trace : object, optional
        The trace up to here.

    Attributes
    ----------
    outcome : str
        The name of the run's outcome that this error stands for, which is its own in capitals;
        empty for none in particular.
    """

    outcome: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        if SimulationError in cls.__bases__:
            cls.outcome = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__).upper()

    def __init__(self, message: str, trace: object | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.trace = trace


class NoConsistentMode(SimulationError):
    """No mode explains the state.

    Parameters
    ----------
    message, trace
        As for `SimulationError`.
    considered : mapping, optional
        Mode -> why it does not.
    """

    def __init__(
        self, message: str, trace: object | None = None, considered: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(message, trace)
        self.considered = dict(considered or {})


class AmbiguousMode(SimulationError):
    """Several modes with different motions explain the state."""


class EventLoop(SimulationError):
    """Jumps without end at one instant."""


class SingularMode(SimulationError):
    """The equations of a mode do not determine the motion."""


class Zeno(SimulationError):
    """Jumps accumulate, and nothing declared says what follows."""


class StepFailure(SimulationError):
    """The integrator cannot meet its tolerance."""


class NonFinite(SimulationError):
    """The state became infinite or undefined."""


class OutOfBudget(SimulationError):
    """The time allowed for a run was over before its end."""


class Undecided(SimulationError):
    """The event search could neither locate nor exclude a crossing within its budget."""


class StepTooLarge(SimulationError):
    """The fixed time step is too long for the model."""


class UnsolvedImpulses(SimulationError):
    """No impulses of a time step obey the contact laws nearly enough."""


class TooLong(SimulationError):
    """The rest of a run takes more steps or memory than there is."""


class Unsupported(SimulationError):
    """The engine cannot run a feature of the model."""


_NUMBERS = re.compile(r"(\D*)(\d*)")
# Names compared with a wrong one, about 10 us each.
_MAX_COMPARED = 1000


def close_matches(name: str, known: Iterable[str]) -> str:
    """Return advice: the names in `known` that `name` may have meant, and all of them."""
    names = list(known)
    if numbered := _with_other_number(name, names):
        return numbered
    if len(names) > _MAX_COMPARED:
        letters = {*name}
        names = heapq.nsmallest(_MAX_COMPARED, names, key=lambda one: len(letters ^ {*one}))
    # Numbers in names count: grain2 is before grain10.
    names.sort(key=lambda one: [(a, len(n), n) for a, n in _NUMBERS.findall(one)])
    close = difflib.get_close_matches(name, names, n=3)
    listed = ", ".join(names[:30]) + (", ..." if len(names) > 30 else "")
    meant = f"did you mean {' or '.join(repr(match) for match in close)}? " if close else ""
    return f"{meant}known: {listed or 'none'}"


def owner_or_matches(region: str, name: str, owners: Mapping[str, Collection[str]]) -> str:
    """Return advice on ``region.name``: the one region that has `name`, else similar names.

    States and events of inner regions belong to the region of the model that holds them.
    """
    holders = [owner for owner, names in owners.items() if owner and name in names]
    similar = region not in owners and difflib.get_close_matches(region, owners)
    if len(holders) == 1 and not similar:
        return f"write {holders[0]}.{name}"
    return (
        close_matches(name, owners[region]) if region in owners else close_matches(region, owners)
    )


def _with_other_number(name: str, names: Collection[str]) -> str:
    """Return advice on names that differ from `name` in their number; "" for none."""
    split = re.fullmatch(r"(.+?)\d*((?:\.\w+)?)", name)
    if split is None:
        return ""
    stem, part = map(re.escape, split.groups())
    alike = re.compile(rf"{stem}\d+{part}")
    found = sorted(filter(alike.fullmatch, names), key=lambda one: (len(one), one))
    return f"there are {found[0]} to {found[-1]}" if len(found) > 1 else ""


def undeclared(name: str, known: Iterable[str]) -> str:
    """Return advice on a variable that is changed and has no value at the start."""
    return f"{close_matches(name, known)}; if it is new, give its start: variables: {{{name}: 0}}"
