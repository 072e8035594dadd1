"""The kinds of documents, found through the entry points of group ``statechart.kinds``."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel

from statechart.chart import Chart
from statechart.offered import load

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from statechart.automaton import Automaton, Setup
    from statechart.feasibility import Feasibility
    from statechart.observe import Observer
    from statechart.testing import Property
    from statechart.trace import Trace


@dataclass(frozen=True)
class Kind:
    """What a package offers for one kind of document.

    Attributes
    ----------
    name : str
        The value of the document's `kind:`.
    model : type of pydantic.BaseModel
        What the document is validated as.
    automaton : callable
        Builds the automaton of a model.
    starter : str
        A commented document that runs, to start from; the word NAME in it stands for the name of
        the model.
    properties : callable, optional
        What must hold for every run of a model, besides what holds for every automaton.
    alternatives : callable, optional
        The model under the other choices that its laws leave open, by what the choice is called.
    feasibility : callable, optional
        Judges every product mode at a configuration (see `statechart.feasibility`); None where it
        knows no reason against any.
    violations : callable, optional
        From a model, an observer and a trace: by how much what must hold does not, each relative
        to the model's own scales (constraints, cones of friction).
    omitted : callable, optional
        From a model and a trace: what the run did without, and why.
    """

    name: str
    model: type[BaseModel]
    automaton: Callable[[BaseModel], object]
    starter: str
    properties: Callable[[BaseModel], Sequence[Property]] | None = None
    alternatives: Callable[[BaseModel], Mapping[str, BaseModel]] | None = None
    feasibility: (
        Callable[[Automaton, Setup, NDArray[np.float64], float], Feasibility | None] | None
    ) = None
    violations: Callable[[BaseModel, Observer, Trace], Mapping[str, float]] | None = None
    omitted: Callable[[BaseModel, Trace], Mapping[str, str]] | None = None


def kinds() -> Mapping[str, EntryPoint]:
    """Return the installed kinds by name, none of them imported."""
    return {
        entry.name: entry for entry in importlib.metadata.entry_points(group="statechart.kinds")
    }


def kind(name: str) -> Kind:
    """Return a kind, importing its package and no other.

    Parameters
    ----------
    name : str
        One of `kinds`.

    Raises
    ------
    KeyError
        If there is none of this name.
    TypeError
        If the entry point leads to something else.
    StatechartError
        If its package is hidden by another of its name.
    """
    loaded = load(kinds()[name])
    if not isinstance(loaded, Kind):
        raise TypeError(f"the entry point of kind {name!r} is not a Kind but {loaded!r}")
    return loaded


def _automaton(chart: BaseModel) -> object:
    from statechart.chart_automaton import automaton

    if not isinstance(chart, Chart):
        raise TypeError(f"a Chart was expected, not {type(chart).__name__}")
    return automaton(chart)


_STARTER = """\
# A ball that bounces: one region, two states. Run it with
#   statechart run NAME.yaml
kind: chart
name: NAME
doc: A ball dropped on the floor.

# Formulas of each other are allowed: numbers, names, + - * / **, sqrt, sin, ...
parameters:
  height: 1       # m
  g: 9.81         # m/s2
  k: 0.9          # speed after a bounce, per speed before it

# What `statechart check` varies.
ranges:
  height: [0.5, 2]
  k: [0.1, 0.95]

# Initial values, formulas of the parameters.
variables:
  x: height       # m, up
  v: 0            # m/s

regions:
  ball:
    initial: flight
    states:
      flight:
        flows: {x: v, v: -g}                 # time derivatives; all else is constant
        invariants: {above ground: x >= 0}   # must hold; tested by `statechart check`
      rest: {}
    transitions:
      # The guard is watched all the time; the transition fires when it becomes true.
      - {name: bounce, from: flight, to: flight, guard: x <= 0, updates: {v: -k*v}}
      # The bounces accumulate at one instant: from there on the ball rests.
      - {name: settle, from: flight, to: rest, on: zeno, updates: {x: 0, v: 0}}

stop: {time: 10}

outputs:
  bounces: {count: bounce}
  t_rest: {value: time, at: first settle}
  top_speed: {maximum: abs(v)}
"""

CHART = Kind("chart", Chart, _automaton, _STARTER)
