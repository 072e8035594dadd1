"""The product automaton as a graph: its contents, built on demand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import networkx as nx
import pytest

import statechart
from statechart.automaton.product import explore
from statechart.running.runner import Runner

BAR = "double_contact_bar"


def test_two_contacts_have_nine_modes_and_sixteen_with_directions() -> None:
    whole, plain = statechart.graph(BAR), statechart.graph(BAR, directions=False)
    assert (len(whole), len(plain)) == (16, 9)
    assert all(set(data) == {"label", "feasible", "reason"} for _, data in whole.nodes.items())
    assert all(data["feasible"] is not bool(data["reason"]) for _, data in whole.nodes.items())
    assert plain.nodes["free", "pin"]["label"] == "A:free B:pin"
    wanted = {"region", "event", "guard", "reset"}
    assert all(set(data) == wanted and data["guard"] for _, _, data in whole.edges(data=True))
    causes = {data["event"] for _, _, data in whole.edges(data=True)}
    assert causes == {"touchdown", "liftoff", "slip", "stick", "reverse", "jam", "zeno"}
    for graph_ in (whole, plain):
        numbers = [number for _, _, number in graph_.edges(keys=True)]
        assert sorted(numbers) == list(range(len(numbers)))


def test_an_edge_changes_the_region_that_it_names() -> None:
    for source, target, data in statechart.graph(BAR).edges(data=True):
        place = "AB".index(data["region"])
        assert source[1 - place] == target[1 - place]
        assert source[place] != target[place] or data["event"] == "touchdown"


def test_guards_of_both_directions_are_one_edge_without_them() -> None:
    plain = statechart.graph(BAR, directions=False)
    slips = [
        data["guard"]
        for _, _, data in plain.edges(("pin", "free"), data=True)
        if data["event"] == "slip"
    ]
    assert slips == ["H < -mu V or H > mu V"]


def test_visits_are_those_of_the_run() -> None:
    trace = statechart.run(BAR).trace
    whole = statechart.graph(BAR, trace=trace)
    entered = {key: count for key, count in whole.nodes(data="visits") if count}
    assert entered == {key: trace.modes.count(key) for key in trace.modes}
    taken = sum(count for _, _, count in whole.edges(data="visits"))
    assert taken == sum(1 for jump in trace.jumps if jump.region)
    path = statechart.graph(BAR, trace=trace, within=0)
    assert set(path) == set(trace.modes)
    assert nx.utils.nodes_equal(path.nodes(data=True), whole.subgraph(path).nodes(data=True))


def test_a_jump_of_both_contacts_is_an_edge_without_guard() -> None:
    trace = statechart.run(BAR).trace
    modes = statechart.graph(BAR, trace=trace)
    (both,) = [data for _, _, data in modes.edges(data=True) if not data["guard"]]
    assert (both["region"], both["event"], both["visits"]) == ("B", "touchdown", 1)


def test_equal_jumps_of_two_regions_are_counted_separately() -> None:
    runner = Runner("two_balls")
    trace = runner.run().trace
    start = trace.start_mode
    one = next(jump for jump in trace.jumps if jump.region == "floor1" and jump.target == start)
    modes = explore(runner.automaton, trace=replace(trace, jumps=(one,))).graph()
    touched = {d["region"]: d["visits"] for _, t, d in modes.edges(start, data=True) if t == start}
    assert touched == {"floor1": 1, "floor2": 0, "pair": 0}


def test_only_requested_modes_are_built(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise AssertionError("the product was enumerated")

    monkeypatch.setattr("statechart.automaton.product.product", refused)
    near = statechart.graph("granular_column", around=("free",) * 60, within=1)
    assert len(near) == 1 + 60 * 2
    assert len(statechart.graph("granular_column", around=("free",) * 60, within=0)) == 1
    with pytest.raises(statechart.StatechartError, match="more than 4096"):
        statechart.graph("granular_column", around=("free",) * 60, within=4)


def test_too_many_modes_or_none_of_the_model_are_refused() -> None:
    with pytest.raises(statechart.StatechartError, match="within fewer jumps"):
        statechart.graph("rimless_wheel")
    for key in (("pin",), ("pin", "pin", "pin"), ("pin", "glide"), ("pin", "slide")):
        with pytest.raises(statechart.StatechartError, match="a state of A, B"):
            statechart.graph(BAR, around=key, within=1)
    assert len(statechart.graph(BAR, around=("pin", "slide"), within=0, directions=False)) == 1
    with pytest.raises(statechart.StatechartError, match="no mode"):
        statechart.graph(BAR, trace=statechart.run("bouncing_ball").trace)


def test_start_mode_is_the_default_centre() -> None:
    assert list(statechart.graph("toppling_stick", within=0)) == [("pin",)]


def test_graphml_reads_back_equal(tmp_path: Path) -> None:
    path = tmp_path / "bar.graphml"
    statechart.draw(BAR, path, visited=True)
    read = nx.read_graphml(path, edge_key_type=int, force_multigraph=True)
    trace = statechart.run(BAR).trace
    modes = statechart.graph(BAR, trace=trace, within=0)
    shown = nx.relabel_nodes(modes, dict(modes.nodes(data="label")))
    assert nx.utils.nodes_equal(read.nodes(data=True), shown.nodes(data=True))
    assert nx.utils.edges_equal(
        read.edges(keys=True, data=True), shown.edges(keys=True, data=True), directed=True
    )
    assert read.graph["name"] == BAR
