"""Plain charts on the executor: when transitions fire, and flows against closed forms."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scenes import compose, go, region, times

from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import HELD
from statechart.automaton.trace import Outcome, Role, Trace
from statechart.charts.chart import Chart
from statechart.charts.laws import automaton
from statechart.engines.engine import Engine
from statechart.engines.scipy import SciPy
from statechart.engines.taylor import Taylor
from statechart.errors import DeclarationProblem, EventLoop, NonFinite
from statechart.execution.simulator import Simulator
from statechart.formulas.relation import Relation
from statechart.formulas.writer import _Writer, _written

TAYLOR, SCIPY = Taylor(2.2e-16), SciPy(1e-12)
both = pytest.mark.parametrize("engine", [TAYLOR, SCIPY], ids=["taylor", "scipy"])


def run(chart: Automaton, engine: Engine, until: float, **parameters: float) -> Trace:
    return Simulator(chart, engine).run(parameters, until=until)


@both
def test_a_thermostat_switches_at_the_times_of_its_closed_form(engine: Engine) -> None:
    chart = compose(
        {"T": 20},
        {
            "heater": region(
                {"on": {"T": "30 - T"}, "off": {"T": "10 - T"}},
                go("on", "off", "T >= 22", "down"),
                go("off", "on", "T <= 18", "up"),
            )
        },
    )
    trace = run(chart, engine, 5.0)
    first, warm, cool = math.log(10 / 8), math.log(12 / 8), math.log(12 / 8)
    expected = [first]
    while expected[-1] + min(warm, cool) < 5.0:
        expected.append(expected[-1] + (cool if len(expected) % 2 else warm))
    # The integrator's own tolerance is 1e-12 for every step, and errors of a dozen arcs add up.
    assert [jump.t for jump in trace.jumps] == pytest.approx(expected, abs=1e-10)
    assert [jump.cause for jump in trace.jumps][:3] == ["down", "up", "down"]
    assert trace.certified


@both
def test_predator_and_prey_without_events_keep_their_integral(engine: Engine) -> None:
    chart = compose(
        {"x": 2, "y": 1}, {"field": region({"alive": {"x": "x*(1 - y)", "y": "y*(x - 1)"}})}
    )
    trace = run(chart, engine, 20.0)
    assert trace.outcome is Outcome.HORIZON
    assert not trace.jumps

    def first_integral(state: Any) -> float:
        x, y = state
        return float(x - math.log(x) + y - math.log(y))

    (arc,) = trace.arcs
    for state in arc.states(np.linspace(0.0, arc.duration, 101)):
        assert first_integral(state) == pytest.approx(first_integral([2.0, 1.0]), abs=1e-9)


def test_both_engines_agree_on_van_der_pol() -> None:
    chart = compose(
        {"x": 1, "v": 0}, {"circuit": region({"on": {"x": "v", "v": "(1 - x**2)*v - x"}})}
    )
    one, other = (run(chart, engine, 10.0) for engine in (TAYLOR, SCIPY))
    assert one.final == pytest.approx(other.final, abs=1e-9)


@both
def test_guard_on_time_fires_and_variables_without_flow_stay_constant(engine: Engine) -> None:
    chart = compose(
        {"x": 0, "fixed": 7},
        {"r": region({"wait": {}, "run": {"x": "1"}}, go("wait", "run", "time >= start"))},
        {"start": 3},
    )
    trace = run(chart, engine, 5.0)
    assert times(trace) == pytest.approx([3.0], abs=1e-15)
    assert trace.final == pytest.approx([2.0, 7.0], abs=1e-14)


@both
def test_simultaneous_guards_of_two_regions_both_fire(engine: Engine) -> None:
    def named(x: str, v: str) -> Any:
        transition = go("fly", "fly", f"{x} <= 0", "hit", **{v: f"-{v}"})
        return region({"fly": {x: v, v: "-1"}}, transition)

    chart = compose(
        {"x": 1, "v": 0, "y": 1, "w": 0}, {"left": named("x", "v"), "right": named("y", "w")}
    )
    trace = run(chart, engine, 10.0)
    assert [jump.region for jump in trace.jumps] == ["left", "right"] * 4
    bounces = [math.sqrt(2) * (2 * n + 1) for n in range(4) for _ in range(2)]
    assert [jump.t for jump in trace.jumps] == pytest.approx(bounces, abs=1e-11)
    assert trace.final[:2] == pytest.approx(trace.final[2:], abs=1e-11)


@both
def test_orthogonal_regions_do_not_disturb_each_other(engine: Engine) -> None:
    blink = region(
        {"dark": {"phase": "1"}, "light": {"phase": "-1"}},
        go("dark", "light", "phase >= 1", "rise"),
        go("light", "dark", "phase <= 0", "set"),
    )
    fall = region({"up": {"x": "v", "v": "-1"}}, go("up", "up", "x <= 0", "hit", v="-v"))
    alone = run(compose({"x": 1, "v": 0}, {"fall": fall}), engine, 9.5)
    variables = {"phase": 0, "x": 1, "v": 0}
    together = run(compose(variables, {"blink": blink, "fall": fall}), engine, 9.5)
    assert times(together, "hit") == pytest.approx(times(alone, "hit"), abs=1e-11)
    assert times(together, "rise") == pytest.approx([1, 3, 5, 7, 9], abs=1e-12)
    assert times(together, "set") == pytest.approx([2, 4, 6, 8], abs=1e-12)
    assert together.final_mode == ("light", "up")


@both
def test_state_with_true_guard_is_left_immediately(engine: Engine) -> None:
    chart = compose(
        {"x": 0},
        {
            "r": region(
                {"a": {"x": "1"}, "b": {"x": "1"}, "c": {}},
                go("a", "b", "x >= 1", "first", x=5),
                go("b", "c", "x >= 2", "second"),
            )
        },
    )
    trace = run(chart, engine, 9.0)
    assert [jump.cause for jump in trace.jumps] == ["first", "second"]
    assert trace.jumps[0].t == trace.jumps[1].t == pytest.approx(1.0, abs=1e-14)
    assert trace.jumps[1].before == pytest.approx([5.0])


@both
def test_a_guard_true_at_the_start_fires_at_time_zero(engine: Engine) -> None:
    chart = compose({"x": -1}, {"r": region({"a": {"x": "1"}, "b": {}}, go("a", "b", "x <= 0"))})
    trace = run(chart, engine, 3.0)
    assert times(trace) == [0.0]
    assert trace.final == pytest.approx([-1.0])


@both
@pytest.mark.parametrize(("rate", "jumps"), [("1", 0), ("-1", 1), ("0", 1)])
def test_on_the_boundary_the_sign_of_the_margin_rate_decides(
    engine: Engine, rate: str, jumps: int
) -> None:
    chart = compose({"x": 0}, {"r": region({"a": {"x": rate}, "b": {}}, go("a", "b", "x <= 0"))})
    assert len(run(chart, engine, 3.0).jumps) == jumps


@both
def test_at_rest_on_the_boundary_the_second_derivative_decides(engine: Engine) -> None:
    def jumps(rate: str) -> int:
        states = {"a": {"x": "v", "v": rate}, "b": {}}
        return len(
            run(
                compose({"x": 0, "v": 0}, {"r": region(states, go("a", "b", "x <= 0"))}), engine, 3
            ).jumps
        )

    assert (jumps("1"), jumps("-1")) == (0, 1)


@both
@pytest.mark.parametrize(("guard", "laps"), [("n >= 3", 3), ("n > 3", 4)])
def test_a_counter_at_its_limit_obeys_the_relation_as_written(
    engine: Engine, guard: str, laps: int
) -> None:
    chart = compose(
        {"x": 0, "n": 0},
        {
            "clock": region(
                {"run": {"x": "1"}, "done": {}},
                go("run", "done", guard, "end"),
                go("run", "run", "x >= 1", "lap", x=0, n="n + 1"),
            )
        },
    )
    trace = run(chart, engine, 10.0)
    assert times(trace, "lap") == pytest.approx(range(1, laps + 1), abs=1e-12)
    assert times(trace, "end") == pytest.approx([laps], abs=1e-12)


@both
def test_state_is_not_left_through_its_entry_boundary(engine: Engine) -> None:
    # At x = pi sin(x) is some 1e-16 off zero: whichever sign it has, nothing may fire again.
    chart = compose(
        {"x": 0},
        {
            "r": region(
                {"up": {"x": "1"}, "down": {"x": "1"}},
                go("up", "down", "sin(x) <= 0", "set"),
                go("down", "up", "sin(x) >= 0", "rise"),
            )
        },
    )
    trace = run(chart, engine, 20.0)
    assert [jump.t for jump in trace.jumps] == pytest.approx(math.pi * np.arange(1, 7), abs=1e-11)


@both
def test_a_ball_thrown_from_the_ground_with_tiny_speed_scale_is_not_lost(engine: Engine) -> None:
    # The start height says nothing of the size of the flights: no absolute tolerance will do.
    fall = region({"up": {"x": "v", "v": "-g"}}, go("up", "up", "x <= 0", "hit", v="-v"))
    for start in (0.0, 1e-9):
        chart = compose({"x": start, "v": 10}, {"fall": fall}, {"g": 10})
        hits = times(run(chart, engine, 9.0), "hit")
        assert hits == pytest.approx([2, 4, 6, 8], abs=1e-8)


@both
def test_region_reads_updates_of_another_immediately(engine: Engine) -> None:
    chart = compose(
        {"x": 0, "signal": 0},
        {
            "follower": region({"idle": {}, "awake": {}}, go("idle", "awake", "signal >= 1")),
            "leader": region({"a": {"x": "1"}, "b": {}}, go("a", "b", "x >= 2", "send", signal=1)),
        },
    )
    trace = run(chart, engine, 5.0)
    assert [(jump.region, jump.cause) for jump in trace.jumps] == [
        ("leader", "send"),
        ("follower", "go"),
    ]
    assert trace.jumps[0].t == trace.jumps[1].t == pytest.approx(2.0, abs=1e-12)


@both
def test_a_guard_made_false_by_an_earlier_transition_does_not_fire(engine: Engine) -> None:
    chart = compose(
        {"x": 0},
        {
            "first": region({"a": {"x": "1"}, "b": {}}, go("a", "b", "x >= 1", "take", x=0)),
            "second": region({"a": {}, "b": {}}, go("a", "b", "x >= 1", "late")),
        },
    )
    trace = run(chart, engine, 3.0)
    assert [jump.cause for jump in trace.jumps] == ["take"]


@both
def test_the_first_declared_of_two_transitions_fires(engine: Engine) -> None:
    states: dict[str, dict[str, Any]] = {"a": {"x": "1"}, "b": {}, "c": {}}
    guards = [go("a", "c", "x >= 1"), go("a", "b", "2*x >= 2")]
    assert run(compose({"x": 0}, {"r": region(states, *guards)}), engine, 3.0).final_mode == ("c",)
    guards.reverse()
    assert run(compose({"x": 0}, {"r": region(states, *guards)}), engine, 3.0).final_mode == ("b",)


@both
def test_transitions_that_enable_each_other_for_ever_are_named(engine: Engine) -> None:
    chart = compose(
        {"x": 0},
        {
            "r": region(
                {"a": {"x": "1"}, "b": {}},
                go("a", "b", "x >= 1", "ping", x=2),
                go("b", "a", "x >= 2", "pong"),
            )
        },
    )
    simulator = Simulator(chart, engine)
    with pytest.raises(EventLoop, match=r"ping.*pong"):
        simulator.run(until=5.0)
    trace = simulator.run(until=5.0, throw=False)
    assert trace.outcome is Outcome.EVENT_LOOP
    (instant,) = {jump.t for jump in trace.jumps}
    assert instant == pytest.approx(1.0, abs=1e-14)


@both
def test_an_update_that_keeps_its_guard_true_is_a_loop(engine: Engine) -> None:
    chart = compose({"x": 0}, {"r": region({"a": {"x": "1"}}, go("a", "a", "x >= 1", "add", x=2))})
    with pytest.raises(EventLoop, match="add"):
        run(chart, engine, 5.0)


@both
def test_updates_see_the_values_before_the_jump(engine: Engine) -> None:
    chart = compose(
        {"x": 0, "y": 5},
        {"r": region({"a": {"x": "1"}, "b": {}}, go("a", "b", "x >= 1", x="y", y="x + time"))},
    )
    assert run(chart, engine, 3.0).final == pytest.approx([5.0, 2.0], abs=1e-12)


@both
@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_a_run_in_other_units_is_the_same_run(engine: Engine, scale: float) -> None:
    fall = region(
        {"up": {"x": "v", "v": "-g"}}, go("up", "up", "x <= 0", "hit", v="-k*v"), initial="up"
    )
    chart = compose({"x": "h", "v": 0}, {"fall": fall}, {"h": 1, "g": 10, "k": 0.8})
    unit = run(chart, engine, 2.0)
    scaled = run(chart, engine, 2.0, h=scale, g=10 * scale)
    assert times(scaled, "hit") == pytest.approx(times(unit, "hit"), rel=1e-11)
    assert scaled.final / scale == pytest.approx(unit.final, rel=1e-9)


@both
def test_the_mirror_image_of_a_chart_runs_as_its_mirror_image(engine: Engine) -> None:
    fall = region({"up": {"x": "v", "v": "-1"}}, go("up", "up", "x <= 0", "hit", v="-v/2"))
    climb = region({"up": {"x": "v", "v": "1"}}, go("up", "up", "x >= 0", "hit", v="-v/2"))
    one = run(compose({"x": 1, "v": 0}, {"r": fall}), engine, 3.0)
    other = run(compose({"x": -1, "v": 0}, {"r": climb}), engine, 3.0)
    assert times(one, "hit") == pytest.approx(times(other, "hit"), abs=1e-14)
    assert one.final == pytest.approx(-other.final, abs=1e-13)


def test_guards_with_kinks_fire() -> None:
    chart = compose(
        {"x": -2},
        {"r": region({"a": {"x": "1"}, "b": {}}, go("a", "b", "max(abs(x), 0.5) <= 1"))},
    )
    assert times(run(chart, TAYLOR, 5.0)) == pytest.approx([1.0], abs=1e-12)


def test_an_update_without_a_value_ends_the_run_with_its_name() -> None:
    chart = compose(
        {"x": 0, "y": 0},
        {"r": region({"a": {"x": "1"}, "b": {}}, go("a", "b", "x >= 1", y="1/y"))},
    )
    with pytest.raises(NonFinite, match="go sets y"):
        run(chart, TAYLOR, 3.0)


def test_an_override_that_makes_the_start_infinite_is_refused() -> None:
    chart = compose({"x": "1/p"}, {"r": region({"a": {}})}, {"p": 1})
    with pytest.raises(DeclarationProblem, match="initial value of 'x' is not finite"):
        run(chart, TAYLOR, 1.0, p=0.0)


def test_invariants_are_margins_that_are_positive_while_they_hold() -> None:
    declared = region({"a": {"x": "1"}})
    declared["states"]["a"]["invariants"] = {"small": "x < 4"}
    chart = compose({"x": 1}, {"r": declared})
    (invariant,) = chart.regions[0].build(Role("a")).invariants
    margin = invariant.margin(chart.active(("a",)))
    assert margin.name == "r.small"
    assert sp.simplify(margin.expression - (4 - chart.variables[0])) == 0
    assert not chart.regions[0].build(Role(HELD)).invariants


def test_margins_of_transitions_with_one_name_differ() -> None:
    states: dict[str, dict[str, Any]] = {"a": {"x": "1"}, "b": {}, "c": {}}
    chart = compose(
        {"x": 0}, {"r": region(states, go("a", "b", "x >= 2"), go("a", "c", "x <= -1"))}
    )
    names = [margin.name for margin in chart.regions[0].build(Role("a")).margins]
    assert names == ["r.go to b", "r.go to c"]
    assert run(chart, TAYLOR, 3.0).final_mode == ("b",)


@both
def test_a_transition_fires_at_the_event_of_another_region(engine: Engine) -> None:
    tick = {"name": "tick", "on": "saw.reset", "updates": {"n": "n + 1"}}
    chart = compose(
        {"x": 0, "n": 0},
        {
            # Declared first, but the event comes first.
            "counter": region(
                {"even": {}, "odd": {}},
                {**tick, "from": "even", "to": "odd"},
                {**tick, "from": "odd", "to": "even"},
            ),
            "saw": region({"rise": {"x": "1"}}, go("rise", "rise", "x >= 1", "reset", x="0")),
        },
    )
    trace = run(chart, engine, 3.5)
    found = [(jump.t, jump.region) for jump in trace.jumps]
    assert [name for _, name in found] == ["saw", "counter"] * 3
    assert [t for t, _ in found] == pytest.approx([1, 1, 2, 2, 3, 3], abs=1e-11)
    assert trace.final[1] == 3


def test_simultaneous_events_trigger_in_order() -> None:
    def once(name: str) -> dict[str, Any]:
        return region({"a": {}, "b": {}}, go("a", "b", "t >= 1", name))

    def waiting(*events: str) -> dict[str, Any]:
        states = [f"s{i}" for i in range(len(events) + 1)]
        return region(
            {state: {} for state in states},
            *(
                {"name": "hear", "from": states[i], "to": states[i + 1], "on": event}
                for i, event in enumerate(events)
            ),
        )

    chart = compose(
        {"t": 0},
        {
            "clock": region({"run": {"t": "1"}}),
            "one": once("ping"),
            "two": once("pong"),
            "both": waiting("one.ping", "two.pong"),
            "reverse": waiting("two.pong", "one.ping"),
            "any": waiting("ping or pong", "one.b or two.b"),
            "chain": waiting("both.s2"),
        },
    )
    trace = run(chart, TAYLOR, 2.0)
    # Events before the entry of a state do not trigger its transitions.
    final = dict(zip(trace.regions, trace.final_mode, strict=True))
    assert final == {
        "clock": "run", "one": "b", "two": "b",
        "both": "s2", "reverse": "s1", "any": "s2", "chain": "s1",
    }  # fmt: skip
    assert len({jump.t for jump in trace.jumps}) == 1


def test_reactions_to_a_zeno_sequence_are_no_second_sequence() -> None:
    chart = compose(
        {"x": 1, "v": 0, "n": 0},
        {
            "ball": region(
                {"flight": {"x": "v", "v": "-10"}, "rest": {}},
                go("flight", "flight", "x <= 0", "bounce", x="0", v="-v/2"),
                {"name": "settle", "from": "flight", "to": "rest", "on": "zeno"},
            ),
            "counter": region(
                {"on": {}},
                {"name": "tick", "from": "on", "to": "on", "on": "bounce", "updates": {"n": "n+1"}},
            ),
        },
    )
    trace = run(chart, TAYLOR, 5.0)
    bounces = sum(jump.cause == "bounce" for jump in trace.jumps)
    assert trace.final_mode == ("rest", "on")
    assert trace.final[2] == bounces > 10


@pytest.mark.parametrize(
    ("on", "words"),
    [
        ("one.ping", "waits for an event of its own"),
        ("two.pang", "no cause or state 'pang'"),
        ("three.ping", "no region 'three'"),
        ("zeno or two.go", "no cause or state 'zeno'"),
    ],
)
def test_events_that_cannot_happen_are_refused(on: str, words: str) -> None:
    waits = {"name": "ping", "from": "a", "to": "b", "on": on}
    with pytest.raises(ValueError, match=words):
        compose(
            {"t": 0},
            {
                "one": region({"a": {}, "b": {}}, waits),
                "two": region({"a": {}, "b": {}}, go("a", "b", "t >= 1")),
            },
        )


def test_a_stop_condition_may_use_a_parameter_that_is_zero() -> None:
    chart = Chart.model_validate(
        {
            "name": "test",
            "parameters": {"c": 0},
            "variables": {"x": 0},
            "regions": {"only": region({"on": {"x": "1 + c"}})},
            "stop": {"conditions": {"there": "x + c >= 0.5"}},
        }
    )
    trace = run(automaton(chart), TAYLOR, 2.0)
    assert trace.outcome is Outcome.STOPPED
    assert trace.t_end == 0.5


def test_modes_of_equal_regions_compile_each_formula_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only one region differs from the mode before: the formulas of the others are compiled."""
    conditions, sums = Counter[str](), Counter[sp.Expr]()
    condition, write_sum = Relation.condition, _Writer._sum

    def count_condition(self: Relation, *known: Any) -> Any:
        conditions[self.text] += 1
        return condition(self, *known)

    def count_sum(self: _Writer, node: sp.Expr) -> int:
        sums[node] += 1
        return write_sum(self, node)

    monkeypatch.setattr(Relation, "condition", count_condition)
    monkeypatch.setattr(_Writer, "_sum", count_sum)
    _written.cache_clear()
    count = 6
    rooms = {
        f"room{i}": region(
            {
                state: {f"T{i}": f"{outside}.{i} + (T{(i + 1) % count} - T{i})/9 - T{i}"}
                for state, outside in (("on", 30), ("off", 10))
            },
            go("on", "off", f"T{i} >= 22", "down"),
            go("off", "on", f"T{i} <= 18", "up"),
        )
        for i in range(count)
    }
    chart = compose({f"T{i}": 20 for i in range(count)}, rooms)
    trace = run(chart, Taylor(2.2e-16), 1.0)
    assert trace.counts["modes_built"] > count
    # Once for the margins of its state, once for its transition.
    assert max(conditions.values()) == 2
    assert max(sums.values()) == 1
