"""`mod` and `floor` of time: sums over periods in closed form, events where periods end."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest
from runs import run_chart

from statechart.charts.wrapping import periodic_calls
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, NoConsistentMode
from statechart.loading.load import interpret
from statechart.running.result import Result
from statechart.running.runner import Runner, run

G = 9.81
T, V = 0.4, 1.2
ENGINES = ("{engine: taylor}", "{engine: scipy}", "{engine: impulse, step: 1e-4}")
engines = pytest.mark.parametrize("settings", ENGINES)

SAW = """
parameters: {T: 0.4, v: 1.2, mu: 0.3}
gravity: 9.81
bodies: {ball: {mass: 1}}
surfaces: {table: {height: 0, displacement: [X, Y]}}
contacts: {foot: {point: {body: ball}, surface: table, friction: mu, restitution: 0}}
outputs:
  lands: {value: time, at: each foot.touchdown}
  sticks: {value: time, at: each foot.stick}
  wraps: {value: time, at: each mod.wrap}
"""


def scene(x: str, y: str, settings: str, **further: Any) -> Result:
    text = SAW.replace("X", f'"{x}"').replace("Y", f'"{y}"')
    whole = f"kind: scene\nname: n\n{text}\nsettings: {settings}\n"
    return Runner(interpret(read_text(whole))).run(until=1.5, **further)


@engines
def test_a_ball_on_a_saw_tooth_table_is_thrown_and_lands_in_every_period(settings: str) -> None:
    near = 3e-4 if "impulse" in settings else 1e-12
    result = scene("0", "v*mod(time, T)", settings)
    assert result.outputs["wraps"] == pytest.approx([T, 2 * T, 3 * T], abs=1e-15)
    # Against the table, which falls by v T and rises again at v, it has no velocity at first.
    flight = math.sqrt(2 * V * T / G)
    assert result.outputs["lands"][1:] == pytest.approx([T + flight, 2 * T + flight], abs=near)
    since = 1.5 - 3 * T
    expected = V * T + V * since - G * since**2 / 2
    assert result.trace.final[1] == pytest.approx(expected, abs=30 * near)


def test_a_variable_named_doc_is_no_documentation() -> None:
    text = "kind: chart\nname: n\nvariables: {doc: 0}\nstop: {time: 1}\nregions:\n"
    text += '  r: {initial: a, states: {a: {flows: {doc: "mod(doc + time, 1)"}}}}\n'
    with pytest.raises(DeclarationError, match="mod of doc is not periodic in time"):
        interpret(read_text(text))


@engines
def test_friction_that_varies_with_the_slip_on_a_conveyor_can_be_read(settings: str) -> None:
    result = Runner(
        interpret(
            read_text(
                f"""
kind: scene
name: n
gravity: 9.81
bodies: {{block: {{mass: 1, start: {{dx: 2}}}}}}
surfaces: {{belt: {{height: 0, displacement: ['0.5*mod(time, 0.4)', 0]}}}}
contacts:
  foot: {{point: {{body: block}}, surface: belt, friction: 0.2 + 0.1*exp(-abs(slip)),
    restitution: 0}}
settings: {settings}
"""
            )
        )
    ).run(until=0.1)
    before = result.at(0.05).values
    assert before["foot.slip"] == pytest.approx(before["block.dx"] - 0.5, abs=1e-12)
    near = 2e-4 if "impulse" in settings else 1e-12
    mu = 0.2 + 0.1 * math.exp(-before["foot.slip"])
    assert before["foot.H"] == pytest.approx(-mu * G, abs=near)
    first = -(0.2 + 0.1 * math.exp(-1.5)) * G
    assert result.samples["foot.H"].iloc[0] == pytest.approx(first, abs=near)


@engines
def test_a_conveyor_that_jumps_back_carries_on(settings: str) -> None:
    near = 1e-3 if "impulse" in settings else 1e-12
    result = scene("v*mod(time, T)", "0", settings)
    stuck = V / (0.3 * G)
    assert result.outputs["sticks"] == pytest.approx([stuck], abs=near)
    assert result.trace.final[0] == pytest.approx(V * (1.5 - stuck / 2), abs=near)


@engines
def test_a_cam_strikes_at_the_phase_at_which_it_turns_round(settings: str) -> None:
    # It falls as slowly as the point can follow, and rises as fast from the next period on.
    path = "0.02*sin(pi*mod(time + T/4, T)/T) - 0.02*sin(pi/4)"
    result = scene("0", path, settings, parameters={"T": 0.5})
    assert result.outputs["wraps"] == pytest.approx([0.375, 0.875, 1.375], abs=1e-15)
    near = 1e-4 if "impulse" in settings else 1e-12
    assert result.outputs["lands"][1:] == pytest.approx([0.375, 0.875, 1.375], abs=near)
    assert result.trace.final[1] == pytest.approx(0.0, abs=20 * near)


@pytest.mark.parametrize("settings", ENGINES)
def test_a_table_that_jumps_into_a_ball_ends_the_run(settings: str) -> None:
    with pytest.raises(NoConsistentMode, match=r"surface 'table' jumps 0\.48"):
        scene("0", "-v*mod(time, T)", settings)


FLOWS = """
parameters: {T: 0.3, w: 2, p: 0.1}
variables: {x: 0, y: 0, z: 0, r: 0}
regions:
  a:
    initial: on
    states:
      on: {flows: {x: "mod(time, T)", y: "floor(w*time + p)", z: "mod(-time, T)"}}
      late: {flows: {r: "max(0, mod(time, T) - 0.1)"}}
    transitions:
      - {name: go, from: on, to: late, guard: "mod(time, T) - floor(time/T)/10 <= -0.35"}
outputs:
  gone: {value: time, at: first a.go}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_wrapped_time_in_flows_and_guards_integrates_exactly(tmp_path: Path, engine: str) -> None:
    result = run_chart(tmp_path, FLOWS + "stop: {time: 2}\n", engine)
    gone = 1.2
    assert result.outputs["gone"] == pytest.approx(gone, abs=1e-12)
    x, y, z, r, *_ = result.trace.final
    assert x == pytest.approx(4 * 0.3**2 / 2, abs=1e-12)
    # From .45 on it is 1, from .95 on 2.
    assert y == pytest.approx(0.5 + 2 * (gone - 0.95), abs=1e-12)
    assert z == pytest.approx(4 * 0.3**2 / 2, abs=1e-12)
    assert r == pytest.approx(2 * 0.2**2 / 2 + 0.1**2 / 2, abs=1e-12)


LED = """
gravity: 9.81
bodies:
  plate:
    shape: {polygon: [[-1, -0.1], [1, -0.1], [1, 0], [-1, 0]]}
    position: [0, "v*mod(time, T)"]
  disc: {mass: 1, inertia: 0.005, shape: {disc: 0.1}, start: {y: 0.1}}
parameters: {T: 0.4, v: 1.2}
collisions: {all: {bodies: [plate, disc], friction: 0.3, restitution: 0}}
outputs: {lands: {value: time, at: each disc.touchdown}, wraps: {value: time, at: each mod.wrap}}
"""


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_prescribed_saw_tooth_body_throws_a_disc(step: float) -> None:
    whole = f"kind: scene\nname: n\n{LED}\nsettings: {{engine: impulse, step: {step}}}\n"
    result = Runner(interpret(read_text(whole))).run(until=1.1)
    assert result.outputs["wraps"] == pytest.approx([T, 2 * T], abs=1e-12)
    assert result.outputs["lands"][1] == pytest.approx(T + math.sqrt(2 * V * T / G), abs=2 * step)


def test_generated_region_names_do_not_collide(tmp_path: Path) -> None:
    text = FLOWS.replace("w: 2", "mod: 2").replace("w*time", "mod*time")
    result = run_chart(tmp_path, text + "stop: {time: 1}\n")
    assert {"mod2.count", "mod3.count", "floor.count"} <= {*result.trace.variables}


def test_wraps_yields_calls_with_their_arguments() -> None:
    found = list(
        periodic_calls("a.mod + 2*mod( (time + min(p, q)) , T/2) - mod(p, q) + floor(w*time)")
    )
    assert [wrap.key for wrap in found] == [
        ("mod", "(time + min(p, q))", "T/2"),
        ("floor", "w*time", "1"),
    ]


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("mod(time, -T)", "the period of mod is -0.4; write a number above 0"),
        ("mod(time, time)", "the period of mod changes"),
        ("mod(time + s, T)", "mod of s is not periodic in time; write mod of time"),
        ("mod(mod(time, T), T)", "mod of a formula that jumps is not periodic"),
        ("mod(T, 1)", "along a run, write mod(time, T)"),
    ],
)
def test_formulas_that_are_not_periodic_are_refused(path: str, message: str) -> None:
    moved = SAW.replace(
        "outputs:", "regions: {r: {initial: a, variables: {s: 0}, states: {a: {}}}}\noutputs:"
    )
    text = moved.replace("X", "0").replace("Y", f'"{path}"')
    with pytest.raises(DeclarationError, match=re.escape(message)):
        interpret(read_text(f"kind: scene\nname: n\n{text}"))


@pytest.mark.parametrize("period", [0.0, -1.0])
def test_a_period_given_for_a_run_is_refused_at_its_place(period: float) -> None:
    moved = SAW.replace("X", '"mod(time, T)"').replace("Y", "0")
    steps = "settings: {engine: impulse, step: 0.01}\n"
    shape = "ball: {mass: 1, inertia: 1, shape: {disc: 1}, start: {y: 1}}"
    shapes = moved[: moved.index("contacts:")].replace("ball: {mass: 1}", shape) + (
        "collisions: {all: {bodies: [ball], surfaces: [table], friction: mu, restitution: 0}}\n"
    )
    places = {
        f"kind: scene\n{moved}": "displacement.0",
        f"kind: scene\n{moved}{steps}": "displacement.0",
        f"kind: scene\n{shapes}{steps}": "displacement.0",
        f"kind: chart\n{FLOWS}": "flows.x",
    }
    for text, place in places.items():
        problem = re.escape(f"{place}: the period of mod is {period:g} (with T = {period:g})")
        with pytest.raises(DeclarationError, match=problem):
            Runner(interpret(read_text(f"name: n\n{text}"))).run({"T": period}, until=1.0)


@pytest.mark.parametrize(
    "section",
    [
        "outputs: {o: {value: 'mod(time, 2)'}}",
        "stop: {conditions: {late: 'mod(time, 2) >= 1'}}",
        "joints: {pin: {point: {body: ball}, to: ['mod(time, 1)', 0]}}",
    ],
)
def test_mod_is_refused_in_outputs_and_in_pins_of_points(section: str) -> None:
    whole = f"kind: scene\nname: n\nbodies: {{ball: {{mass: 1}}}}\n{section}\n"
    with pytest.raises(DeclarationError, match="mod jumps, and cannot stand in this field"):
        interpret(read_text(whole))


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_chart_receives_the_end_of_a_period(engine: str, tmp_path: Path) -> None:
    # The switch is on from the beginning of each period until the saw tooth reaches
    # time/4 + 1/16: for 1/12, 5/12 and 3/4 of a period.
    text = """
variables: {x: 0}
regions:
  switch:
    initial: "on"
    states: {"on": {flows: {x: 1}}, "off": {}}
    transitions:
      - {name: cut, from: "on", to: "off", guard: "4*mod(time, 1) >= time + 1/4"}
      - {name: restore, from: "off", to: "on", on: mod.wrap}
stop: {time: 2.9}
outputs: {x: {value: x}, n: {value: mod.count}, cuts: {value: time, at: each switch.cut}}
"""
    result = run_chart(tmp_path, text, engine)
    assert result.outputs["cuts"] == pytest.approx([1 / 12, 17 / 12, 11 / 4], abs=1e-12)
    assert result.outputs["x"] == pytest.approx(1 / 12 + 5 / 12 + 3 / 4, abs=1e-12)
    assert result.outputs["n"] == 2


LIGHT = """\
kind: chart
name: light
regions:
  light:
    initial: red
    states: {red: {}, green: {}}
    transitions:
      - {name: go, from: red, to: green, guard: GO}
      - {name: halt, from: green, to: red, guard: HALT}
stop: {time: 7}
outputs: {go: {value: time, at: each go}, green: {integral: 1, during: {light: green}}}
"""


@pytest.mark.parametrize(
    ("go", "halt", "times", "green"),
    [
        ("time >= 2 and time < 3", "time >= 4", [2.0], 2.0),
        ('"mod(time, 3) >= 2"', '"mod(time, 3) <= 1"', [2.0, 5.0], 2.0),
    ],
)
@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_charts_on_time_alone_need_no_variables(
    go: str, halt: str, times: list[float], green: float, engine: str
) -> None:
    result = run(read_text(LIGHT.replace("GO", go).replace("HALT", halt)), engine=engine)
    assert result.outputs["go"] == pytest.approx(times, rel=1e-12)
    assert result.outputs["green"] == pytest.approx(green, rel=1e-12)


@pytest.mark.parametrize(
    "head",
    ["kind: chart\n", "kind: scene\nbodies: {ball: {mass: 1}}\n"],
)
def test_a_variable_may_start_at_a_jumping_function_of_parameters(head: str) -> None:
    text = "name: n\nparameters: {a: 7, b: 2}\nregions:\n  r: {initial: s, states: {s: {}}VALUES}\n"
    starts = "variables: {n: 'floor(a/b)', m: 'mod(a, b)'}"
    own = head.startswith("kind: scene")
    text = head + text.replace("VALUES", f", {starts}" if own else "")
    text += "stop: {time: 1}\n" + ("" if own else f"{starts}\n")
    trace = run(read_text(text)).trace
    values = dict(zip(trace.variables, trace.final.tolist(), strict=True))
    assert (values["n"], values["m"]) == (3, 1)


# A position encoder of width q, and an input of the value it shows, held for T.
SAMPLED = """
    initial: a
    variables: {u: 0, i: 0, n: 0}
    states:
      a: {CONTENT}
      b: {entry: {n: "floor(10*i/4)"}, CONTENT}
    transitions:
      - name: sample
        from: a
        every: T
        updates: {u: "-2*q*floor(X/q + 1/2) - DX", i: "mod(i + 1, 4)"}
      - {name: leave, from: a, to: b, after: 4.6}
stop: {time: 5}
outputs:
  x: {value: X}
  u: {value: u, at: each sample}
  i: {value: i, at: each sample}
  n: {value: n}
"""
AS_SCENE = """kind: scene
name: n
parameters: {q: 0.1, T: 0.25, c: 0.3}
bodies: {b: {mass: 1, start: {x: 1}}}
controls: {held: 0}
forces: {f: {body: b, force: [held - c*b.dx, 0]}}
regions:
  r:""" + SAMPLED.replace("DX", "b.dx").replace("X", "b.x").replace("CONTENT", "sets: {held: u}")
AS_CHART = """kind: chart
name: n
parameters: {q: 0.1, T: 0.25, c: 0.3}
variables: {x: 1, v: 0, u: 0, i: 0, n: 0}
regions:
  r:""" + SAMPLED.replace("    variables: {u: 0, i: 0, n: 0}\n", "").replace("DX", "v").replace(
    "X", "x"
).replace("CONTENT", "flows: {x: v, v: u - c*v}")


def quantised_samples() -> tuple[list[float], float]:
    """Return the samples of the input, and the place at 5, by the closed form between samples."""
    x, v, u, c, period = 1.0, 0.0, 0.0, 0.3, 0.25
    samples = []

    def after(t: float) -> tuple[float, float]:
        decay = math.exp(-c * t)
        return x + u / c * t + (v - u / c) * (1 - decay) / c, u / c + (v - u / c) * decay

    for _ in range(18):
        x, v = after(period)
        u = -0.2 * math.floor(x / 0.1 + 0.5) - v
        samples.append(u)
    return samples, after(0.5)[0]


@pytest.mark.parametrize(
    ("text", "options", "tolerance"),
    [
        (AS_CHART, {"engine": "taylor"}, 1e-13),
        (AS_CHART, {"engine": "scipy"}, 1e-10),
        (AS_SCENE, {"engine": "taylor"}, 1e-13),
        (AS_SCENE, {"engine": "scipy"}, 1e-10),
        (AS_SCENE, {"engine": "impulse", "step": 1e-3}, 1e-7),
    ],
)
def test_updates_quantise_and_count_in_a_ring(text: str, options: Any, tolerance: float) -> None:
    samples, place = quantised_samples()
    result = run(read_text(text), **options)
    assert result.outputs["u"] == pytest.approx(samples, abs=tolerance)
    assert result.outputs["x"] == pytest.approx(place, abs=tolerance)
    assert result.outputs["i"] == [(k + 1) % 4 for k in range(18)]
    assert result.outputs["n"] == 5  # of 10*2/4


def test_guards_at_the_bound_that_a_quantised_update_sets_are_decided() -> None:
    # The step of a stair at 0.3 = 3 q: the guard is on its boundary after the update.
    text = """
kind: chart
name: stair
parameters: {q: 0.1}
variables: {x: 0.3, y: 0}
regions:
  r:
    initial: a
    states: {a: {}, b: {}}
    transitions:
      - {name: sample, from: a, after: 1, to: b, updates: {y: "q*floor(x/q)"}}
      - {name: back, from: b, to: a, guard: y >= 3*q}
stop: {time: 1.5}
outputs: {y: {value: y}, back: {count: back}}
"""
    result = run(read_text(text))
    assert result.outputs == {"y": pytest.approx(0.3, rel=1e-15), "back": 1}


PULSES = """
kind: chart
name: n
parameters: {T: 1, duty: 0.1}
regions:
  r:
    initial: a
    states: {a: {}, b: {}}
    transitions:
      - {name: on, from: a, to: b, guard: "GUARD"}
      - {name: off, from: b, to: a, guard: "mod(time, T) >= 0.5"}
stop: {time: 3.25}
outputs: {on: {value: time, at: each r.on}}
"""


@pytest.mark.parametrize(
    "guard",
    [
        "mod(time, T) <= 0",
        "mod(time, 1) >= 1",
        "mod(time, T) >= T",
        "mod(time, T) < 0",
        "1/2 <= mod(time, 1/4)",
        "0 >= (mod(time + 0.5, T))",
    ],
)
def test_comparisons_that_a_mod_fulfils_for_instants_only_are_refused(guard: str) -> None:
    text = PULSES.replace("GUARD", guard)
    with pytest.raises(DeclarationError, match="the comparison holds for no span of time"):
        interpret(read_text(text))


@pytest.mark.parametrize("guard", ["mod(time, T) != 0", "not mod(time, T) == 0"])
def test_equality_of_a_mod_is_refused_as_of_any_changing_value(guard: str) -> None:
    with pytest.raises(DeclarationError, match=r"compares .*, which changes between events"):
        interpret(read_text(PULSES.replace("GUARD", guard)))


def test_bounds_of_parameters_are_accepted_as_they_may_change_before_a_run() -> None:
    chart = interpret(read_text(PULSES.replace("GUARD", "mod(time, T) <= T - 1")))
    halves = run(chart, parameters={"T": 1.5}).outputs["on"]
    assert halves == pytest.approx([0.0, 1.5, 3.0], abs=1e-12)


@pytest.mark.parametrize("enabled", ["WINDOW", "not (PHASE >= 0.1 and PHASE < 0.5)"])
def test_a_brake_is_enabled_outside_a_window_of_each_period(enabled: str) -> None:
    enabled = enabled.replace("WINDOW", "PHASE <= 0 or PHASE >= 0.5 or PHASE < 0.1")
    text = f"""
kind: scene
name: n
bodies: {{w: {{mass: 1, inertia: 1, start: {{dangle: 9}}}}}}
joints: {{axle: {{point: {{body: w}}, to: [0, 0]}}}}
couplings: {{b: {{bodies: [w], limit: 2, enabled: '{enabled.replace("PHASE", "mod(time, 1)")}'}}}}
stop: {{time: 2}}
"""
    final = run(interpret(read_text(text))).trace
    rate = final.final[final.variables.index("w.dangle")]
    assert rate == pytest.approx(9 - 2 * 2 * 0.6, abs=1e-12)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("guard", "first"),
    [
        ("mod(time, T) <= 0.1", 0.0),
        ("mod(time, T) < duty*T", 0.0),
        ("T <= 4*mod(time, T) and mod(time, T) < 0.5", 0.25),
        ("mod(time, T) <= 0 or mod(time, T) < 0.1", 0.0),
    ],
)
def test_comparisons_that_a_mod_fulfils_for_a_span_fire_in_every_period(
    guard: str, first: float, engine: str
) -> None:
    result = run(interpret(read_text(PULSES.replace("GUARD", guard))), engine=engine)
    assert result.outputs["on"] == pytest.approx([first + k for k in range(4)], abs=1e-12)


def test_a_duty_of_zero_is_no_mistake() -> None:
    chart = interpret(read_text(PULSES.replace("GUARD", "mod(time, T) < duty*T")))
    assert run(chart, parameters={"duty": 0}).outputs["on"] == []
