"""Guards of charts: clocks, margins that leave their boundary slowly, both ends of a run."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from runs import ENGINES, engine
from scenes import compose, go, region, run, scene, times
from strategies import examples

from statechart import sweep
from statechart.automaton.trace import Outcome, Trace
from statechart.documents.yaml_reader import read_text
from statechart.execution.simulator import Simulator
from statechart.loading.load import interpret
from statechart.running.runner import run as run_model

both = pytest.mark.parametrize("name", ENGINES)


@both
def test_periodic_guards_fire_once_per_period(name: str) -> None:
    chart = compose(
        {"n": 0, "x": 0},
        {
            "clock": region(
                {"day": {"x": "1"}, "night": {"x": "1"}},
                go("day", "night", "cos(time) <= 0", "dusk"),
                go("night", "day", "cos(time) >= 0", "dawn", n="n + 1"),
            )
        },
    )
    trace = run(chart, name, 100.0)
    assert [jump.t for jump in trace.jumps] == pytest.approx(
        [math.pi * (k + 0.5) for k in range(32)], abs=1e-12
    )
    assert trace.final[0] == 16
    assert trace.certified


# A block on the ground, and a clock that it does not care for.
CLOCKED = """\
kind: scene
name: clocked
parameters: {W: 2, phase: 1, late: 0, light: 1}
gravity: 9.81
bodies: {block: {mass: 1}}
surfaces: {ground: {height: 0}}
contacts:
  base: {point: {body: block}, surface: ground, friction: 0.3, restitution: 0}
regions:
  clock:
    initial: up
    states: {up: {}, down: {}}
    transitions:
      - {name: fall, from: up, to: down, guard: light*sin(W*(time - late) + phase) <= 0}
      - {name: rise, from: down, to: up, guard: light*sin(W*(time - late) + phase) >= 0}
"""


@functools.cache
def clock(of: str, name: str, fall: str, rise: str) -> Simulator:
    if of == "scene":
        return Simulator(scene(CLOCKED.replace("<=", fall).replace(">=", rise)), engine(name))
    form = "light*sin(W*(time - late) + phase)"
    up_and_down = region(
        {"up": {"x": "v", "v": "-x"}, "down": {"x": "v", "v": "-x"}},
        go("up", "down", f"{form} {fall} 0", "fall"),
        go("down", "up", f"{form} {rise} 0", "rise"),
    )
    parameters = {"W": 2.0, "phase": 1.0, "late": 0.0, "light": 1.0}
    return Simulator(compose({"x": 1, "v": 0}, {"clock": up_and_down}, parameters), engine(name))


@examples(20)
@given(
    st.sampled_from(["chart", "scene"]),
    st.sampled_from([("<=", ">="), ("<", ">"), ("<=", ">"), ("<", ">=")]),
    st.floats(0.5, 40.0),
    st.floats(0.01, 3.1),
    st.sampled_from([0.0, 0.125, -7.0, 1000.0, -1e6]),
    st.sampled_from([1.0, 1e-9, 1e12]),
    st.floats(1.0, 12.5),
)
def test_a_clock_strikes_as_often_as_its_sine_passes_zero(
    of: str,
    signs: tuple[str, str],
    rate: float,
    phase: float,
    late: float,
    light: float,
    periods: float,
) -> None:
    until = periods * 2 * math.pi / rate
    # Round-off of the phase decides whether the run ends before or after a zero.
    angle = phase - rate * late
    first, last = math.ceil(angle / math.pi), math.floor((angle + rate * until) / math.pi)
    near = 1e-12 * (1.0 + abs(rate * late))
    edges = [angle / math.pi, (angle + rate * until) / math.pi]
    if min(abs(edge - round(edge)) for edge in edges) < 100 * near:
        return
    if math.sin(angle) <= 0.0:
        phase, first, last = phase + math.pi, first + 1, last + 1
    given_ = {"W": rate, "phase": phase, "late": late, "light": light}
    expected = [(k * math.pi - phase) / rate + late for k in range(first, last + 1)]
    for name in ENGINES:
        trace = clock(of, name, *signs).run(given_, until=until)
        found = [jump.t for jump in trace.jumps]
        assert len(found) == len(expected), (name, found)
        assert found == pytest.approx(expected, abs=near + 1e-9 * until), name
        assert trace.certified


@functools.cache
def chain(order: int, name: str, strict: bool) -> Simulator:
    """Return x0' = x1, ..., the last rate constant, with a state for each sign of x0."""
    below, above = ("<", ">") if strict else ("<=", ">=")
    names = [f"x{i}" for i in range(order)]
    rates = dict(zip(names, [*names[1:], "c"], strict=True))
    chart = compose(
        {x: f"p{x}" for x in names},
        {
            "r": region(
                {"up": rates, "down": rates},
                go("up", "down", f"x0 {below} 0", "fall"),
                go("down", "up", f"x0 {above} 0", "rise"),
            )
        },
        {"c": 1.0, **{f"p{x}": 0.0 for x in names}},
    )
    return Simulator(chart, engine(name))


@examples(20)
@given(
    st.integers(1, 5),
    st.lists(st.sampled_from([0.5, 0.8, 1.25, 2.0, 2.75]), max_size=3, unique=True),
    st.booleans(),
    st.sampled_from([-1.0, 1.0, 1e-6, -1e9]),
    st.sampled_from([1.0, 60.0]),
)
def test_first_nonzero_derivative_decides_on_the_boundary(
    order: int, roots: list[float], strict: bool, amount: float, unit: float
) -> None:
    # amount t^order (1 - t/r1) (1 - t/r2) ..., t in units.
    polynomial = np.polynomial.Polynomial([0.0] * order + [amount])
    for r in sorted(roots):
        polynomial *= np.polynomial.Polynomial([1.0, -1.0 / r])
    coefficients = [float(c) * math.factorial(i) / unit**i for i, c in enumerate(polynomial.coef)]
    given_ = {"c": coefficients[-1]}
    given_ |= {f"px{i}": c for i, c in enumerate(coefficients[:-1])}
    expected = [r * unit for r in sorted(roots)]
    if amount < 0.0:
        expected.insert(0, 0.0)
    for name in ENGINES:
        trace = chain(len(coefficients) - 1, name, strict).run(given_, until=3.0 * unit)
        assert [jump.t for jump in trace.jumps] == pytest.approx(expected, abs=1e-7 * unit), name
        assert trace.final_mode == (("up", "down")[len(expected) % 2],)
        assert trace.certified


@both
@pytest.mark.parametrize(
    ("margin", "jumps"),
    [
        ("x - sin(x)", 0),
        ("sin(x) - x", 1),
        ("1 - x**2/2 - cos(x)", 1),
        ("cos(x) - 1 + x**2/2 - x**4/24", 1),
        ("exp(x) - 1 - x", 0),
        ("tan(x) - x*sqrt(1 + x**2)", 1),
        ("abs(x**3)", 0),
        ("x**3 - x**5", 1),
    ],
)
def test_equivalent_guards_leave_their_boundary_equally(name: str, margin: str, jumps: int) -> None:
    chart = compose(
        {"x": 0}, {"r": region({"a": {"x": "1"}, "b": {}}, go("a", "b", f"{margin} <= 0"))}
    )
    trace = run(chart, name, 0.9)
    expected = [0.0] * jumps if margin != "x**3 - x**5" else []
    assert times(trace) == expected


RAMP = """\
kind: scene
name: ramp
parameters: {F: 1, k: 0, p: 0}
gravity: 0
bodies: {cart: {mass: 1, start: {x: p}}}
forces: {drive: {body: cart, force: [F*time**k, 0]}}
regions:
  gate:
    initial: near
    states: {near: {}, far: {}}
    transitions: [{name: go, from: near, to: far, guard: cart.x <= p}]
"""


@both
@pytest.mark.parametrize("place", [0.0, 3.7])
@pytest.mark.parametrize("power", [0, 1, 2])
def test_a_body_pushed_off_its_boundary_by_a_growing_force_leaves_it(
    name: str, power: int, place: float
) -> None:
    automaton = scene(RAMP.replace("time**k", "*".join(["1", *["time"] * power])))
    assert not run(automaton, name, 2.0, F=1.0, p=place).jumps
    assert [jump.t for jump in run(automaton, name, 2.0, F=-1.0, p=place).jumps] == [0.0]


@both
def test_a_controllers_guard_that_is_true_on_entry_fires_at_once(name: str) -> None:
    text = CLOCKED[: CLOCKED.index("regions:")] + (
        "regions:\n  r:\n    initial: a\n    states: {a: {}, b: {}, c: {}, d: {}}\n"
        "    transitions:\n"
        "      - {name: first, from: a, to: b, guard: time >= 0}\n"
        "      - {name: second, from: b, to: c, guard: base.V >= 1}\n"
        "      - {name: third, from: c, to: d, guard: time > 0}\n"
    )
    trace = run(scene(text), name, 1.0)
    # At the start time is 0, and is about to be more.
    assert [(jump.t, jump.cause) for jump in trace.jumps] == [
        (0.0, "first"),
        (0.0, "second"),
        (0.0, "third"),
    ]


@functools.cache
def ending(of: str, name: str) -> Simulator:
    if of == "scene":
        text = (
            CLOCKED[: CLOCKED.index("contacts:")].replace("mass: 1", "mass: 1, start: {dx: W}")
            + "regions:\n  gate:\n    initial: near\n    states: {near: {}, far: {}}\n"
            + "    transitions: [{name: go, from: near, to: far, guard: block.x >= late}]\n"
        )
        return Simulator(scene(text), engine(name))
    chart = compose(
        {"x": 0, "v": "W"},
        {"gate": region({"near": {"x": "v"}, "far": {}}, go("near", "far", "x >= late"))},
        {"W": 1.0, "late": 1.0},
    )
    return Simulator(chart, engine(name))


@examples(20)
@given(st.sampled_from(["chart", "scene"]), st.floats(0.1, 10.0), st.floats(0.1, 10.0))
def test_events_exactly_at_the_end_happen(of: str, rate: float, way: float) -> None:
    end = way / rate
    for name in ENGINES:
        simulator = ending(of, name)
        trace = simulator.run({"W": rate, "late": way}, until=end)
        assert times(trace) == pytest.approx([end], rel=1e-12), name
        assert trace.final_mode == ("far",) if of == "chart" else ("free", "far")
        assert trace.outcome is Outcome.HORIZON
        before = simulator.run({"W": rate, "late": way}, until=end * (1.0 - 1e-6))
        assert not before.jumps


@both
def test_a_self_transition_is_evaluated_again_without_entry(name: str) -> None:
    hear: dict[str, Any] = {"name": "hear", "from": "on", "to": "on", "updates": {"m": "m + 1"}}
    chart = compose(
        {"x": 0, "n": 0, "m": 0},
        {
            "saw": region(
                {"rise": {"x": "1"}, "done": {}},
                go("rise", "done", "n >= 3", "stop"),
                go("rise", "rise", "x >= 1", "reset", x="x - 0.5*n", n="n + 1"),
            ),
            "ear": region({"on": {}}, {**hear, "on": "saw.rise"}),
        },
    )
    trace = run(chart, name, 9.0)
    # The first reset leaves x where it is: its guard is still true, and fires again at once.
    assert times(trace, "reset") == pytest.approx([1.0, 1.0, 1.5], abs=1e-12)
    assert times(trace, "stop") == times(trace, "reset")[-1:]
    assert trace.final.tolist()[2] == 0


@both
@pytest.mark.parametrize(
    ("following", "end"),
    [
        ("d/2", 2.0),
        ("d*(0.65 + 0.15*cos(pi*n))", 2.5),
        ("2**(-n**2)", 1.0 + sum(2.0 ** -(n**2) for n in range(1, 9))),
        ("1/(n + 1)**2", None),
        ("1/(n + 1)**3", None),
    ],
)
def test_intervals_that_do_not_tend_to_a_geometric_sequence_are_not_summed(
    name: str, following: str, end: float | None
) -> None:
    ticks = go("a", "a", "x >= d", "tick", x=0, n="n + 1", d=following)
    settle = {"name": "settle", "from": "a", "to": "b", "on": "zeno"}
    chart = compose(
        {"x": 0, "d": 1, "n": 1},
        {"r": region({"a": {"x": "1"}, "b": {}}, ticks, settle)},
        max_jumps=400,
    )
    trace = Simulator(chart, engine(name)).run(until=9.0, throw=False)
    if end is None:
        assert trace.outcome is Outcome.TOO_MANY_JUMPS
        assert not times(trace, "settle")
    else:
        assert times(trace, "settle") == pytest.approx([end], abs=1e-11)


def edge(start: str, rate: str, guard: str, name: str) -> Trace:
    text = f"""\
kind: chart
name: edge
variables: {{x: {start}}}
regions:
  r:
    initial: s
    states: {{s: {{flows: {{x: {rate}}}}}, e: {{flows: {{x: 0}}}}}}
    transitions: [{{name: go, from: s, to: e, guard: "{guard}"}}]
stop: {{time: 3}}
"""
    return run_model(read_text(text), engine=name, throw=False).trace


@pytest.mark.parametrize(
    ("start", "rate", "guard", "at"),
    [
        ("0", "1", "sqrt(x) >= 0.5", 0.25),
        ("0", "1", "sqrt(time) >= 0.5", 0.25),
        ("0", "2*time", "sqrt(x) >= 0.5", 0.5),
        ("0", "1", "x**1.5 >= 0.5", 0.5 ** (2 / 3)),
        ("0", "1", "x**0.3 >= 0.5", 0.5 ** (1 / 0.3)),
        ("0", "1", "sqrt(sqrt(x)) >= 0.5", 0.0625),
        ("0", "1", "sqrt(x) + x >= 1", (math.sqrt(1.25) - 0.5) ** 2),
        ("0", "1", "log(x) >= -1", math.exp(-1)),
        ("0", "1", "sqrt(x) <= -1", None),
        ("0", "1", "atan2(0*x, x) >= 1", None),
        ("-1", "2*time", "sqrt(1 + x) >= 0.5", 0.5),
        ("-1", "1", "acos(x) <= 2", 1 + math.cos(2)),
        ("-1", "1", "asin(x) >= -0.5", 1 - math.sin(0.5)),
        ("1", "-1", "acos(x) >= 1", 1 - math.cos(1)),
        ("1", "-1", "asin(x) <= 0.5", 1 - math.sin(0.5)),
        ("0", "1", "min(sqrt(x), 1) >= 0.5", 0.25),
        ("0", "1", "max(sqrt(x), x, -x) >= 1.5", 1.5),
        ("0", "1", "abs(sqrt(x) - 1) <= 0.5", 0.25),
    ],
)
@both
def test_guards_fire_from_the_start_of_their_domain(
    name: str, start: str, rate: str, guard: str, at: float | None
) -> None:
    found = edge(start, rate, guard, name)
    assert found.outcome is Outcome.HORIZON
    assert found.certified
    assert [jump.t for jump in found.jumps] == ([] if at is None else [pytest.approx(at, rel=1e-9)])


@pytest.mark.parametrize(
    "guard", ["sqrt(x) >= 2", "sqrt(x) < -1", "acos(1 - x) <= -1", "x**1.5 > 2"]
)
def test_guard_is_undefined_outside_the_domain_of_its_root(guard: str) -> None:
    for name in ENGINES:
        assert edge("1", "-1", guard, name).outcome is Outcome.NON_FINITE


COUNTED = """
kind: chart
name: counted
parameters: {N: 5, begun: 0}
variables: {n: begun, x: 0}
regions:
  c:
    initial: a
    states: {a: {flows: {x: 1}}}
    transitions: [{name: tick, from: a, every: 0.5, updates: {n: n + 1}}]
stop: {time: 10, conditions: {enough: n >= N}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("condition", "begun", "end"),
    [
        ("n >= N", 0, 2.5),
        ("N <= n", 0, 2.5),
        ("n > N", 0, 3.0),
        ("n >= N", 5, 0.0),
        ("n > N", 5, 0.5),
        ("x <= 0", 0, 10.0),  # it leaves its boundary the other way
        ("x + 0*n >= 1", 0, 1.0),
    ],
)
def test_stop_conditions_on_a_counter_tell_strict_from_weak_relations(
    engine: str, condition: str, begun: float, end: float
) -> None:
    text = COUNTED.replace("n >= N", condition)
    trace = run_model(interpret(read_text(text)), engine=engine, parameters={"begun": begun}).trace
    assert trace.t_end == pytest.approx(end, rel=1e-12)
    assert (trace.outcome is Outcome.STOPPED) == (end < 10.0)


BOUNCES = """
kind: scene
name: bounces
parameters: {e: 0.9, N: 3}
gravity: 10
bodies: {ball: {mass: 1, start: {y: 0.8}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: ball}, surface: floor, restitution: e, modes: [free]}}
regions:
  counter:
    initial: on
    variables: {n: 0}
    states: {on: {}}
    transitions: [{name: hit, from: on, on: c.touchdown, updates: {n: n + 1}}]
stop: {time: 5, conditions: {enough: n >= N}}
outputs: {n: {value: n}, t: {value: time}}
"""


def test_a_scene_ends_at_the_declared_bounce() -> None:
    # Falls of 0.4, then twice 0.4 times e, and e of e.
    bounces = interpret(read_text(BOUNCES))
    for count, end in ((1, 0.4), (2, 0.4 + 0.72), (3, 0.4 + 0.72 + 0.648)):
        found = run_model(bounces, parameters={"N": count}).outputs
        assert found == {"n": count, "t": pytest.approx(end, rel=1e-12)}
    rows = sweep(bounces, {"N": [1, 2, 3]})
    assert rows["n"].values.tolist() == [1, 2, 3]
    assert rows["t"].values == pytest.approx([0.4, 1.12, 1.768], rel=1e-12)


TANK = """\
kind: chart
name: tank
parameters: {c: 0.5, full: 1}
variables: {h: full}
regions:
  tank:
    initial: drains
    states: {drains: {flows: {h: -c*sqrt(h)}}, empty: {}}
    transitions: [{name: dry, from: drains, to: empty, guard: h <= 0}]
stop: {time: 20}
outputs: {dry: {value: time, at: first dry}, rest: {value: h}}
"""


@pytest.mark.parametrize(("c", "full"), [(0.5, 1.0), (1.0, 2.0), (0.3, 3.7)])
def test_a_tank_is_empty_where_the_root_of_its_level_ends(c: float, full: float) -> None:
    result = run_model(interpret(read_text(TANK)), parameters={"c": c, "full": full})
    assert result.outputs["dry"] == pytest.approx(2.0 * math.sqrt(full) / c, rel=1e-12)
    assert abs(result.outputs["rest"]) < 1e-15
    assert not result.warnings


def test_a_stop_condition_ends_a_run_where_its_rates_end() -> None:
    text = TANK.replace("stop: {time: 20}", "stop: {time: 20, conditions: {dry: h <= 0}}")
    transition = "    transitions: [{name: dry, from: drains, to: empty, guard: h <= 0}]\n"
    text = text.replace(transition, "").replace("at: first dry", "at: end")
    result = run_model(interpret(read_text(text)))
    assert result.trace.outcome is Outcome.STOPPED
    assert result.outputs["dry"] == pytest.approx(4.0, rel=1e-12)


def test_a_guard_below_the_domain_of_the_rates_does_not_fire() -> None:
    text = TANK.replace("guard: h <= 0", "guard: h <= -1e-3")
    result = run_model(interpret(read_text(text)), throw=False)
    assert result.trace.outcome is Outcome.STEP_FAILURE
