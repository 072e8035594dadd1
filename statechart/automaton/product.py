"""The product of the regions as a graph, and which of its modes are possible."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import networkx as nx

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.feasibility import MOST_MODES, Feasibility
from statechart.automaton.laws import Setup
from statechart.automaton.trace import Key


def product_modes(automaton: Automaton) -> Iterable[Key]:
    """Yield every product mode; their number is `automaton.modes_total`."""
    return product(*(region.states for region in automaton.regions))


def graph(automaton: Automaton, keys: Iterable[Key]) -> nx.MultiDiGraph:
    """Return the part of the product automaton on `keys`, with guards and resets on its edges.

    Nodes are keys; an edge has `region`, `cause`, `guard` and `reset`. Regions are orthogonal:
    an edge changes one region, and simultaneous changes are paths of zero duration.
    """
    import networkx as nx

    result = nx.MultiDiGraph(name=automaton.name)
    kept = dict.fromkeys(keys)
    result.add_nodes_from((key, {"label": automaton.label(key)}) for key in kept)
    for key in kept:
        for target, region, edge in automaton.successors(key):
            if target in kept:
                result.add_edge(
                    key,
                    target,
                    region=region.name,
                    cause=edge.cause,
                    guard=edge.guard,
                    reset=edge.reset,
                )
    return result


def feasibility(
    automaton: Automaton, setup: Setup, state: Array, time: float
) -> Feasibility | None:
    """Judge every product mode at a configuration.

    Parameters
    ----------
    automaton : Automaton
        Whose modes.
    setup : Setup
        Values of the parameters.
    state : (n,) array
        Values of the variables.
    time : float
        When.

    Returns
    -------
    Feasibility or None
        None where the laws know no reason against any mode (a chart, bodies that collide), or
        there are more modes than `MOST_MODES`.

    Raises
    ------
    StatechartError
        If the modes cannot be judged there.
    """
    if automaton.laws is None or automaton.modes_total > MOST_MODES:
        return None
    return automaton.laws.feasibility(automaton.regions, setup, state, time)
