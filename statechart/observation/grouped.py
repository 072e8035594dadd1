"""The declared outputs of a model, by what they are computed from."""

from __future__ import annotations

from collections.abc import Collection

from statechart.documents.outputs import Count, Event, Integral, Maximum, Minimum, Moment, Value
from statechart.observation.observer import Observer


class Grouped:
    """The declared outputs of a model.

    Parameters
    ----------
    observer : Observer
        Of the simulator that makes the runs.
    names : collection of str, optional
        Those to compute; all by default.

    Attributes
    ----------
    names : tuple of str
        In the order of the declaration.
    at, counts, extremes, start, end, integrals
        By what they are computed from, each with its name.
    """

    def __init__(self, observer: Observer, names: Collection[str] | None = None) -> None:
        self.observer = observer
        declared = observer.automaton.declaration.outputs
        if names is not None:
            declared = {name: output for name, output in declared.items() if name in names}
        self.names = tuple(declared)
        self.at: list[tuple[str, Value, Moment]] = []
        self.counts: list[tuple[str, tuple[Event, ...]]] = []
        self.extremes: list[tuple[str, str | int | float, int]] = []
        # Taken together: one call of a kernel, not one each.
        self.start: dict[str, str | int | float] = {}
        self.end: dict[str, str | int | float] = {}
        self.integrals: dict[str, Integral] = {}
        for name, output in declared.items():
            match output:
                case Value():
                    moment = output.moment
                    if moment.events:
                        self.at.append((name, output, moment))
                    else:
                        values = self.end if moment.when == "end" else self.start
                        values[name] = output.value
                case Integral():
                    self.integrals[name] = output
                case Count():
                    self.counts.append((name, output.events))
                case Minimum():
                    self.extremes.append((name, output.minimum, 0))
                case Maximum():
                    self.extremes.append((name, output.maximum, 1))
