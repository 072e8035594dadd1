"""Guards beside events and timeouts, final states, histories of regions, internal transitions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from runs import run_chart as run

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret

ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy"])


GATE = """
variables: {x: 0, n: 0, m: 0}
regions:
  clock:
    initial: on
    states: {on: {}}
    transitions: [{name: tick, from: on, every: 0.25, updates: {n: n + 1}}]
  plant: {initial: on, states: {on: {flows: {x: -x + 1}}}}
  listener:
    initial: low
    states: {low: {}, high: {}}
    transitions:
      - {name: rise, from: low, to: high, on: clock.tick, guard: x > 0.5}
      - {name: note, from: high, on: clock.tick, guard: n >= 6, updates: {m: m + 1}}
stop: {time: 2}
outputs: {rise: {value: time, at: each listener.rise}, notes: {value: time, at: each listener.note}}
"""


@ENGINES
def test_an_event_with_a_guard_fires_only_where_the_guard_holds(
    tmp_path: Path, engine: str
) -> None:
    # x = 1 - exp(-t) passes 1/2 at log(2) = 0.693: the next tick is at 0.75. n = 6 at 1.5.
    found = run(tmp_path, GATE, engine).outputs
    assert found["rise"] == [pytest.approx(0.75, abs=1e-14)]
    assert found["notes"] == pytest.approx([1.5, 1.75, 2.0], abs=1e-14)


WAIT = """
parameters: {D: 1}
variables: {x: 2, y: 0}
regions:
  r:
    initial: wait
    states: {wait: {flows: {x: -x}}, on: {}, off: {flows: {x: 1}}}
    transitions:
      - {name: go, from: wait, to: on, after: D, guard: x <= LEVEL}
      - {name: back, from: on, to: off, after: 0.5}
      - {name: again, from: off, to: wait, guard: x >= 2}
stop: {time: 3}
outputs: {go: {value: time, at: first r.go}, x: {value: x, at: first r.go}}
"""


@ENGINES
@pytest.mark.parametrize(
    ("level", "when"),
    [("1", 1.0), ("2*exp(-1.7)", 1.7), ("2*exp(-1)", 1.0), ("2*exp(-1) + 1e-9", 1.0)],
)
def test_guarded_timeout_fires_when_both_hold(
    tmp_path: Path, engine: str, level: str, when: float
) -> None:
    found = run(tmp_path, WAIT.replace("LEVEL", level), engine).outputs
    assert found["go"] == pytest.approx(when, abs=1e-11)


def test_guard_that_held_before_the_timeout_does_not_fire_it(tmp_path: Path) -> None:
    # cos(2 pi t) >= 1/2 in [5/6, 7/6] modulo 1: over at the time 1.25, true again at 1 + 5/6.
    text = """
variables: {x: 0}
regions:
  r:
    initial: wait
    states: {wait: {}, on: {}}
    transitions: [{name: go, from: wait, to: on, after: 1.25, guard: cos(2*pi*time) >= 0.5}]
stop: {time: 3}
outputs: {go: {value: time, at: first r.go}}
"""
    assert run(tmp_path, text).outputs["go"] == pytest.approx(1 + 5 / 6, abs=1e-14)


REMIND = """
variables: {n: 0, x: 0}
regions:
  r:
    initial: wait
    states: {wait: {flows: {x: 1}}}
    transitions: [{name: note, from: wait, after: 1, guard: x >= 1.5, updates: {n: n + 1, x: 0}}]
stop: {time: 9}
outputs: {n: {value: n}, t: {value: time, at: first r.note}}
"""


def test_internal_guarded_timeout_fires_once(tmp_path: Path) -> None:
    assert run(tmp_path, REMIND).outputs == {"n": 1.0, "t": pytest.approx(1.5, abs=1e-14)}


DONE = """
variables: {x: 0, n: 0}
regions:
  job:
    initial: work
    states:
      work:
        initial: first
        states:
          first: {flows: {x: 1}}
          ready: {final: true, entry: {n: n + 2}, exit: {n: n + 3}}
        transitions: [{name: finish, from: first, to: ready, guard: x >= 1/3}]
      both:
        regions:
          left:
            initial: l0
            states: {l0: {flows: {x: 1}}, l1: {final: true}}
            transitions: [{name: l, from: l0, to: l1, guard: x >= 1}]
          right:
            initial: r0
            states: {r0: {}, r1: {final: true}}
            transitions: [{name: r, from: r0, to: r1, after: 2}]
      end: {final: true}
    transitions:
      - {name: early, from: work, to: end, on: work.done, guard: n > 2}
      - {name: part, from: work, to: both, on: work.done, guard: n >= 2}
      - {name: all, from: both, to: end, on: both.done}
  watch:
    initial: idle
    states: {idle: {}, seen: {}, left: {}, over: {}}
    transitions:
      - {name: see, from: idle, to: seen, on: work.done}
      - {name: half, from: seen, to: left, on: left.done}
      - {name: end, from: left, to: over, on: job.done}
stop: {time: 5}
outputs:
  work: {value: time, at: each work.done}
  left: {value: time, at: each watch.half}
  both: {value: time, at: each both.done}
  job: {value: time, at: each watch.over}
  n: {value: n}
  ends: {count: left.done or right.done or both.done}
"""


@ENGINES
def test_done_event_needs_final_states_of_all_regions(tmp_path: Path, engine: str) -> None:
    found = run(tmp_path, DONE, engine)
    assert found.outputs["work"] == [pytest.approx(1 / 3, abs=1e-12)]
    assert found.outputs["left"] == [pytest.approx(1.0, abs=1e-12)]
    assert found.outputs["both"] == [pytest.approx(2 + 1 / 3, abs=1e-12)]
    assert found.outputs["job"] == found.outputs["both"]
    # The end is heard after the entry: n is 2 there, and 5 once the final state is left.
    assert found.outputs["n"] == 5
    assert found.outputs["ends"] == 2  # right and both in one jump
    assert found.trace.final_mode == ("end", "over")


ENTERED = """
variables: {x: 0}
regions:
  job:
    initial: off
    states:
      off: {}
      on: {initial: inner, states: {inner: {initial: deep, states: {deep: {}}}}}
    transitions: [{name: begin, from: off, to: on, after: 1}]
  watch:
    initial: a
    states: {a: {}, b: {}, c: {}, d: {}, e: {}}
    transitions:
      - {name: hear, from: a, to: b, on: job.begin}
      - {name: outer, from: b, to: c, on: job.on}
      - {name: middle, from: c, to: d, on: job.inner}
      - {name: last, from: d, to: e, on: job.deep}
stop: {time: 2}
"""


def test_entry_events_of_one_jump_come_outermost_first(tmp_path: Path) -> None:
    trace = run(tmp_path, ENTERED).trace
    assert [j.cause for j in trace.jumps] == ["begin", "hear", "outer", "middle", "last"]
    assert {j.t for j in trace.jumps} == {1.0}


TOGETHER = """
variables: {x: 0, y: 0, n: 0}
regions:
  r:
    initial: both
    states:
      both:
        regions:
          left:
            initial: l0
            states: {l0: {exit: {n: 10*n + 2}}, l1: {entry: {n: 10*n + 5}}}
            transitions:
              - {name: l, from: l0, to: l1, guard: time >= 1, updates: {x: 1, n: 10*n + 3}}
          right:
            initial: r0
            states: {r0: {exit: {n: 10*n + 1}}, r1: {entry: {n: 10*n + 6}}}
            transitions:
              - {name: r, from: r0, to: r1, guard: TRIGGER, updates: {y: 1, n: 10*n + 4}}
stop: {time: 2}
outputs: {n: {value: n}, l: {count: r.l}, r: {count: r.r}}
"""


@ENGINES
@pytest.mark.parametrize(
    "trigger", ["time >= 1", "time >= 1 and x <= 0.5", "time >= 1 and in(r.l0)"]
)
def test_simultaneous_region_guards_make_one_jump(
    tmp_path: Path, engine: str, trigger: str
) -> None:
    # Exits from the inside and the end of the document, updates and entries as they stand there.
    found = run(tmp_path, TOGETHER.replace("TRIGGER", trigger), engine)
    assert [jump.cause for jump in found.trace.jumps] == ["l+r"]
    assert found.outputs == {"n": 123456.0, "l": 1, "r": 1}


def test_simultaneous_timeouts_and_guards_make_one_jump(tmp_path: Path) -> None:
    text = TOGETHER.replace("guard: TRIGGER", "after: 1")
    assert [jump.cause for jump in run(tmp_path, text).trace.jumps] == ["l+r"]


def test_number_of_region_guards_is_unlimited(tmp_path: Path) -> None:
    # Seven regions with four guards each: 5**7 sets of them, of which one is taken.
    region = """
          g{i}:
            initial: a{i}
            states: {{a{i}: {{}}, b{i}: {{}}}}
            transitions:
""" + "".join(
        f"              - {{{{name: t{{i}}{k}, from: a{{i}}, to: b{{i}}, guard: time >= {k}}}}}\n"
        for k in range(1, 5)
    )
    regions = "".join(region.format(i=i) for i in range(7))
    text = (
        "variables: {x: 0}\nregions:\n  r:\n    initial: p\n    states:\n      p:\n"
        f"        regions:{regions}\nstop: {{time: 2}}\n"
    )
    (jump,) = run(tmp_path, text).trace.jumps
    assert jump.cause == "+".join(f"t{i}1" for i in range(7))


PAUSED = """
variables: {x: 0}
regions:
  r:
    initial: both
    states:
      both:
        regions:
          left:
            initial: l0
            states: {l0: {}, l1: {initial: l2, states: {l2: {}, l3: {}}}}
            transitions:
              - {name: l, from: l0, to: l3, after: 1}
          right: {initial: r0, states: {r0: {}, r1: {}},
                  transitions: [{name: r, from: r0, to: r1, after: 2}]}
        states: {last: {history: KIND}}
      pause: {}
    transitions:
      - {name: halt, from: both, to: pause, after: 1.5}
      - {name: go, from: pause, to: last, after: 1}
stop: {time: 2.7}
"""


@pytest.mark.parametrize(("kind", "mode"), [("deep", "l3|r0"), ("shallow", "l0|r0")])
def test_deep_history_restores_all_regions(tmp_path: Path, kind: str, mode: str) -> None:
    trace = run(tmp_path, PAUSED.replace("KIND", kind)).trace
    assert trace.final_mode == (mode,)


INTERNAL = """
variables: {n: 0, m: 0}
regions:
  r:
    initial: w
    states:
      w:
        initial: a
        entry: {n: n + 1}
        exit: {n: n + 10}
        states: {a: {exit: {m: m + 1}}, b: {}}
        transitions: [{name: go, from: w, to: b, guard: time >= 1 and m <= 0.5, internal: KIND}]
stop: {time: 2}
outputs: {n: {value: n}, m: {value: m}}
"""


@pytest.mark.parametrize(("kind", "n"), [("true", 1), ("false", 12)])
def test_an_internal_transition_does_not_leave_its_source(
    tmp_path: Path, kind: str, n: int
) -> None:
    assert run(tmp_path, INTERNAL.replace("KIND", kind)).outputs == {"n": n, "m": 1}


RESUMED = """
variables: {x: 0}
regions:
  r:
    initial: w
    states:
      w:
        initial: a
        states:
          a: {flows: {x: 1}}
          b: {flows: {x: 10}}
          c: {flows: {x: 100}}
          last: {history: KIND}
        transitions:
          - {name: ab, from: a, to: b, after: 1}
          - {name: bc, from: b, to: c, after: 1}
      off: {}
    transitions:
      - {name: away, from: w, to: off, on: clock.t2}
      - {name: back, from: off, to: last, on: clock.t3}
      - {name: again, from: w, to: last, internal: true, on: clock.t1 or clock.t4}
  clock:
    initial: c0
    states: {c0: {}, c1: {}, c2: {}, c3: {}, c4: {}}
    transitions:
      - {name: t1, from: c0, to: c1, after: 1.25}
      - {name: t2, from: c1, to: c2, after: 1.25}
      - {name: t3, from: c2, to: c3, after: 0.25}
      - {name: t4, from: c3, to: c4, after: 1.25}
stop: {time: 4.5}
outputs: {x: {value: x}}
"""


@pytest.mark.parametrize("kind", ["shallow", "deep"])
def test_an_internal_transition_reads_the_history_of_the_last_exit(
    tmp_path: Path, kind: str
) -> None:
    # a until 1, b until 1.25, a until 2.25, b until 2.5 (exit: b), b from 2.75 until 3.75, c until
    # 4, b again: the history is that of the exit at 2.5, and before it the initial state.
    x = 1 + 0.25 * 10 + 1 + 0.25 * 10 + 10 + 0.25 * 100 + 0.5 * 10
    result = run(tmp_path, RESUMED.replace("KIND", kind))
    assert result.outputs["x"] == pytest.approx(x, abs=1e-9)


BASE = """\
kind: chart
name: c
variables: {x: 0}
regions:
  r:
    initial: a
    states:
      a: {}
      b:
        initial: b1
        states: {b1: {}, b2: {final: true}}
      p:
        regions:
          left: {initial: l1, states: {l1: {}, l2: {}}}
    transitions:
      - {name: go, from: a, to: b, after: 1}
      - {name: out, from: b, to: a, on: b.done}
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("b2: {final: true}", "b2: {}", "'b' is never done: it holds no final state"),
        ("on: b.done", "on: r.done", "takes events of other regions, and STATE.done"),
        ("on: b.done", "on: p.done", "'p' is never done"),
        ("from: b, to: a, on: b.done", "from: b2, to: a, after: 1", "'b2' is final, and nothing"),
        ("{final: true}", "{final: true, states: {c: {}}}", "it has no 'states'; leave final out"),
        ("after: 1}", "after: 1, internal: true}", "leads to no state in 'a'; write from: a state"),
        ("from: a, to: b, after: 1", "from: p, to: l2, after: 1, internal: true", "is internal"),
        ("after: 1}", "every: 1, guard: x >= 1}", "here on: REGION.tick, guard: x >= 1"),
        ("after: 1}", "after: 1, guard: y >= 1}", "unknown name 'y'"),
        ("after: 1}", "after: 1, on: b.done}", "needs one of guard, on, after, every"),
        (
            "      - {name: out",
            "      - {name: one, from: b, to: a, on: b.done}\n"
            "      - {name: two, from: b, to: a, on: b.done, guard: x >= 1}\n      - {name: out",
            "'two' never fires: 'one'",
        ),
        (
            "left: {initial: l1",
            "last: {history: deep}\n          left: {initial: l1",
            "write states: {NAME: {history: deep}} beside regions",
        ),
    ],
)
def test_mistakes_in_final_states_and_guards_give_advice(old: str, new: str, words: str) -> None:
    assert BASE.count(old) == 1, old
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(BASE.replace(old, new), "f.yaml"))
    assert words in str(caught.value)


def test_two_guards_of_one_event_are_evaluated_in_order(tmp_path: Path) -> None:
    text = """
variables: {x: 0}
regions:
  env:
    initial: on
    states: {on: {}}
    transitions: [{name: tick, from: on, every: 1, updates: {x: x + 1}}]
  r:
    initial: a
    states: {a: {}, b: {}, c: {}}
    transitions:
      - {name: far, from: a, to: c, on: env.tick, guard: x >= 2}
      - {name: near, from: a, to: b, on: env.tick, guard: x < 1}
stop: {time: 5}
"""
    jumps = run(tmp_path, text).trace.jumps
    assert [(j.cause, j.t) for j in jumps if j.region == "r"] == [("far", 2.0)]


TIMED = """\
regions:
  wait:
    initial: on
    states: {on: {}, answered: {}, late: {}}
    transitions:
      - {name: ack, from: on, to: answered, on: peer.send}
      - {name: over, from: on, to: late, after: 3}
  peer: {initial: p, states: {p: {}, q: {}}, transitions: [{name: send, from: p, to: q, after: 2}]}
stop: {time: 5}
outputs: {t: {value: time, at: first wait.ack}}
"""


@ENGINES
def test_timed_transitions_need_no_variables(tmp_path: Path, engine: str) -> None:
    result = run(tmp_path, TIMED, engine)
    assert result.outputs["t"] == pytest.approx(2.0, abs=1e-12)
    assert result.trace.final_mode == ("answered", "q")


_TIMED = """
name: timed
parameters: {T: 1}
regions:
  r: {initial: a, states: {a: {}, b: {}}, transitions: [{name: go, from: a, to: b, KEY: T - 0.5}]}
stop: {time: 3}
outputs: {t: {value: time, at: first go}}
"""


@pytest.mark.parametrize("kind", ["kind: chart", "kind: scene\nbodies: {b: {mass: 1}}"])
@pytest.mark.parametrize("key", ["after", "every"])
def test_periods_of_the_parameters_of_a_run_are_positive(kind: str, key: str) -> None:
    model = interpret(read_text(kind + _TIMED.replace("KEY", key)))
    engines: tuple[dict[str, Any], ...] = ({"engine": "taylor"}, {"engine": "scipy"})
    if "scene" in kind:
        engines += ({"engine": "impulse", "step": 1e-3},)
    for options in engines:
        made = statechart.run(model, parameters={"T": 1.25}, **options)
        assert made.outputs["t"] == pytest.approx(0.75, abs=1e-12)
        for wrong in (0.5, 0.0, math.inf):
            with pytest.raises(DeclarationError, match=f"{key}: must be .*finite.* not"):
                statechart.run(model, parameters={"T": wrong}, **options)
    cells = statechart.sweep(model, {"T": [0.25, 1.25]})
    assert cells["outcome"].values.tolist() == ["DECLARATION_ERROR", "HORIZON"]
