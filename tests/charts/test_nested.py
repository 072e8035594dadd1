"""Runs of charts with nested states, timeouts and samples, against closed forms; bad input."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest
from runs import run_chart as run

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret

ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy"])


SAMPLED = """
parameters: {T: 0.25, K: 2, r: 1}
variables: {x: 0, u: 0}
regions:
  plant: {initial: on, states: {on: {flows: {x: u - x}}}}
  controller:
    initial: hold
    states: {hold: {entry: {u: K*(r - x)}}}
    transitions:
      - {name: sample, from: hold, every: T, updates: {u: K*(r - x)}}
stop: {time: 5.1}
outputs:
  xs: {value: x, at: each controller.sample}
  ts: {value: time, at: each controller.sample}
"""


@ENGINES
def test_a_sampled_controller_follows_its_difference_equation(tmp_path: Path, engine: str) -> None:
    found = run(tmp_path, SAMPLED, engine)
    x, decay, states = 0.0, math.exp(-0.25), []
    for _ in range(20):
        x = decay * x + (1.0 - decay) * 2.0 * (1.0 - x)
        states.append(x)
    assert found.outputs["xs"] == pytest.approx(states, rel=1e-9)
    assert found.outputs["ts"] == pytest.approx([0.25 * k for k in range(1, 21)], rel=1e-15)


PI = """
parameters: {K: 2, I: 3, r: 1}
variables: {x: 0, integral: 0}
regions:
  plant: {initial: on, states: {on: {flows: {x: K*(r - x) + I*integral - x}}}}
  integrator: {initial: on, states: {on: {flows: {integral: r - x}}}}
stop: {time: 20}
outputs: {x: {value: x}, u: {value: K*(r - x) + I*integral}}
"""


def test_integral_controller_removes_the_steady_error(tmp_path: Path) -> None:
    found = run(tmp_path, PI)
    assert found.outputs == {"x": pytest.approx(1.0, abs=1e-8), "u": pytest.approx(1.0, abs=1e-8)}


TIMEOUT = """
parameters: {D: 0.3}
variables: {x: 0, n: 0}
regions:
  r:
    initial: wait
    states:
      wait: {flows: {x: 1}}
      work:
        initial: low
        entry: {n: n + 1}
        states: {low: {}, high: {}}
        transitions: [{name: rise, from: low, to: high, after: D}]
    transitions:
      - {name: begin, from: wait, to: work, guard: x >= 1/3}
      - {name: end, from: work, to: wait, after: 3*D, updates: {x: 0}}
stop: {time: 10}
outputs:
  rises: {value: time, at: each rise}
  ends: {value: time, at: each end}
  works: {integral: 1, during: {r: work}}
  entered: {count: r.work}
"""


@ENGINES
def test_samples_are_multiples_of_their_period(tmp_path: Path, engine: str) -> None:
    # 0.1 is no float: summed, a thousand of them are 300 roundings off.
    text = """
variables: {n: 0}
regions:
  s:
    initial: wait
    states: {wait: {}, on: {}}
    transitions:
      - {name: begin, from: wait, to: on, after: 0.7}
      - {name: tick, from: on, every: 0.1, updates: {n: n + 1}}
stop: {time: 0.7 + 100}
outputs: {n: {value: n}, ts: {value: time, at: each s.tick}}
"""
    found = run(tmp_path, text, engine).outputs
    assert found["n"] == 1000
    wanted = [0.7 + 0.1 * k for k in range(1, 1001)]
    assert found["ts"] == pytest.approx(wanted, rel=4 * sys.float_info.epsilon, abs=0)


@ENGINES
def test_timeouts_count_from_the_entry_of_their_source(tmp_path: Path, engine: str) -> None:
    found = run(tmp_path, TIMEOUT, engine).outputs
    cycle = 1 / 3 + 0.9
    assert found["rises"] == pytest.approx([1 / 3 + 0.3 + k * cycle for k in range(8)], rel=1e-13)
    assert found["ends"] == pytest.approx([(k + 1) * cycle for k in range(8)], rel=1e-13)
    assert found["works"] == pytest.approx(8 * 0.9, rel=1e-12)
    assert found["entered"] == 8


REMIND = """
variables: {n: 0}
regions:
  s:
    initial: wait
    states:
      wait: {}
      busy: {initial: slow, states: {slow: {}, fast: {}}}
    transitions:
      - {name: begin, from: wait, to: busy, after: 0.3}
      - {name: hurry, from: slow, to: fast, after: 0.4}
      - {name: remind, from: busy, after: 0.5, updates: {n: n + 1}}
      - {name: end, from: busy, to: wait, after: 0.9}
stop: {time: 6}
outputs: {n: {value: n}, ts: {value: time, at: each remind}}
"""


@ENGINES
def test_internal_timeout_fires_once_per_entry(tmp_path: Path, engine: str) -> None:
    found = run(tmp_path, REMIND, engine).outputs
    assert found["n"] == 5
    assert found["ts"] == pytest.approx([0.8 + 1.2 * k for k in range(5)], rel=1e-13)


def test_an_internal_timeout_comes_once_an_entry(tmp_path: Path) -> None:
    # It ended as EVENT_LOOP: the time since the entry of `busy`, which it does not leave, is over.
    text = REMIND.replace("from: busy, after", "from: busy, to: fast, internal: true, after")
    found = run(tmp_path, text).outputs
    assert found["n"] == 5
    assert found["ts"] == pytest.approx([0.8 + 1.2 * k for k in range(5)], rel=1e-13)


ORDER = """
variables: {x: 1, y: 0, z: 0}
regions:
  r:
    initial: a
    states:
      a:
        initial: b
        exit: {x: 10*x + 2}
        states: {b: {exit: {x: 10*x + 1}}}
      c:
        initial: d
        entry: {x: 10*x + 4}
        states: {d: {entry: {x: 10*x + 5}}}
    transitions:
      - {name: go, from: b, to: c, guard: time >= 1, updates: {x: 10*x + 3, y: x, z: y}}
stop: {time: 2}
outputs: {x: {value: x}, y: {value: y}, z: {value: z}}
"""


def test_exits_come_before_updates_and_these_before_entries(tmp_path: Path) -> None:
    # A block uses the values before it; the next block uses its results.
    assert run(tmp_path, ORDER).outputs == {"x": 112345.0, "y": 112.0, "z": 0.0}


RESUMED = """
variables: {x: 0}
regions:
  job:
    initial: work
    states:
      work:
        initial: first
        states:
          first: {flows: {x: 1}}
          second: {flows: {x: 2}}
          last: {history: shallow}
        transitions: [{name: onward, from: first, to: second, guard: sin(pi*time/2) >= sqrt(0.5)}]
      pause: {}
    transitions:
      - {name: stop, from: work, to: pause, guard: cos(pi*time/2) <= 0}
      - {name: go, from: pause, to: TARGET, guard: cos(pi*time/2) >= 0}
stop: {time: 4}
outputs: {x: {value: x}, first: {integral: 1, during: {job: first}}}
"""


@pytest.mark.parametrize(("target", "x", "first"), [("last", 3.5, 0.5), ("work", 2.5, 1.5)])
def test_a_history_resumes_the_interrupted_state(
    tmp_path: Path, target: str, x: float, first: float
) -> None:
    # From 0.5 on it is in its second state, pauses from 1 to 3, and works on until 4.
    found = run(tmp_path, RESUMED.replace("TARGET", target)).outputs
    assert found == {"x": pytest.approx(x, rel=1e-12), "first": pytest.approx(first, rel=1e-12)}


BASE = """\
kind: chart
name: c
parameters: {D: 1}
variables: {x: 0}
regions:
  r:
    initial: a
    states:
      a: {}
      b:
        initial: b1
        states:
          b1: {}
          b2: {}
      p:
        regions:
          left: {initial: l1, states: {l1: {}, l2: {}}}
          right: {initial: r1, states: {r1: {}}}
    transitions:
      - {name: go, from: a, to: b, after: D}
"""


@pytest.mark.parametrize(
    ("old", "new", "token", "words"),
    [
        ("        initial: b1\n", "", "b:", "and no initial one; write initial: b1"),
        ("initial: b1", "initial: l1", "l1", "no state 'l1' in 'b'"),
        ("initial: b1", "initial: b", "b\n", "no state 'b' in 'b'"),
        ("a: {}", "a: {initial: b}", "initial: b", "has `initial`, but no `states` of its own"),
        ("a: {}", "a: {history: deep}", "deep", "a state that has states; put it among"),
        ("b2: {}", "b2: {history: deep, flows: {x: 1}}", "flows", "only a target of"),
        ("b2: {}", "b2: {history: full}", "full", "must be 'shallow' or 'deep'"),
        ("b2: {}", "a: {}", "a: {}\n      p", "names of states are unique in a region"),
        ("after: D", "after: 0*D", "0*D", "must be a finite time above 0, not 0; write a number"),
        ("after: D", "after: -1", "-1", "must be a finite time above 0"),
        ("after: D", "every: D - 2", "D - 2", "must be a finite time above 0"),
        ("after: D", "after: x", "x}", "'x' changes during a run"),
        ("from: a, to: b", "from: l1, to: r1", "r1,", "active side by side; leave it as a whole"),
        ("from: a, to: b", "from: c, to: b", "c,", "no state 'c'"),
        (
            "after: D}",
            "on: q.x}",
            "q.x",
            "no region 'q'",
        ),
        (
            "      - {name: go, from: a, to: b, after: D}",
            "      - {name: go, from: a, to: b, guard: x >= 1}\n"
            "      - {name: on, from: a, to: p, guard: x >= 1}",
            "on,",
            "'on' never fires: 'go', declared before it, is taken from 'a' whenever it could be",
        ),
        (
            "a, to: b, after: D}\n",
            "a, to: b, after: D}\noutputs: {n: {count: left.go}}\n",
            "left.go",
            "no region 'left'; write r.go",
        ),
        (
            "a, to: b, after: D}\n",
            "a, to: b, after: D}\nstop: {conditions: {e: in(left.l2)}}\n",
            "in(left.l2)",
            "no region 'left'; write r.l2",
        ),
        (
            "a: {}",
            "a: {states: {c: {}}, regions: {}, initial: c, entry: {y: 1}}",
            "y: 1",
            "variable",
        ),
    ],
)
def test_mistakes_in_nested_states_are_reported_with_their_place(
    old: str, new: str, token: str, words: str
) -> None:
    assert BASE.count(old) == 1, old
    text = BASE.replace(old, new)
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(text, "f.yaml"))
    message = str(caught.value)
    assert words in message
    at = text.index(token, BASE.index(old) - 10)
    line, column = text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at)
    assert message.startswith(f"f.yaml:{line}:{column}: "), message
