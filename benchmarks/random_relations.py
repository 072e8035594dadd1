"""Random relations as guards, against their truth on a dense grid in closed form.

Each relation is a tree of *and*, *or*, *not*, `min`, `max` and `abs` over linear functions of
``cos t``, ``sin t`` and t. The first instant at which it holds is bracketed on a grid and bisected;
the guard has to fire there. Relations that hold for less than a grid step are left out.

Run with ``python benchmarks/random_relations.py [COUNT] [SEED]``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from statechart import Runner
from statechart.documents.yaml_reader import read_text

CHART = """\
kind: chart
name: relation
variables: {{u: 1, v: 0, s: 0}}
regions:
  m: {{initial: on, states: {{on: {{flows: {{u: -v, v: u, s: 1}}}}}}}}
  r:
    initial: wait
    states: {{wait: {{}}, done: {{}}}}
    transitions: [{{name: fire, from: wait, to: done, guard: "{guard}"}}]
stop: {{time: {end}}}
"""
END, GRID = 6.0, 60_001
_DEEP = 3

Value = Callable[[np.ndarray], np.ndarray]


def number(random: np.random.Generator, depth: int) -> tuple[str, Value]:
    """Return a random formula and its values."""
    kind = random.integers(4) if depth else 0
    if kind == 0:
        a, b, c, d = np.round(random.normal(size=4) * (1.0, 1.0, 0.3, 0.7), 3)
        text = f"({a}*u + {b}*v + {c}*s + {d})"
        return text, lambda t: a * np.cos(t) + b * np.sin(t) + c * t + d
    one, first = number(random, depth - 1)
    if kind == 1:
        return f"abs({one})", lambda t: np.abs(first(t))
    other, second = number(random, depth - 1)
    name, of = (("min", np.minimum), ("max", np.maximum))[kind - 2]
    return f"{name}({one}, {other})", lambda t: of(first(t), second(t))


def relation(random: np.random.Generator, depth: int) -> tuple[str, Value]:
    """Return a random relation and its truth."""
    kind = random.integers(4) if depth else 0
    if kind == 0:
        one, first = number(random, depth)
        # At zero an `abs` holds for an instant only, which no grid shows.
        level = round(random.normal(), 2) or 0.01
        sign, of = (("<=", np.less_equal), (">=", np.greater_equal))[random.integers(2)]
        return f"{one} {sign} {level}", lambda t: of(first(t), level)
    one, first = relation(random, depth - 1)
    if kind == 1:
        return f"not ({one})", lambda t: ~first(t)
    other, second = relation(random, depth - 1)
    name, of = (("and", np.logical_and), ("or", np.logical_or))[kind - 2]
    return f"({one}) {name} ({other})", lambda t: of(first(t), second(t))


def expected(truth: Value) -> float | None:
    """Return when a relation begins to hold; infinity for never, None where a grid cannot tell."""
    times = np.linspace(0.0, END, GRID)
    holds = truth(times)
    changes = np.flatnonzero(holds[1:] != holds[:-1])
    if len(changes) and np.diff(changes).min(initial=GRID) < 3:
        return None
    if holds[0]:
        return 0.0
    if not len(changes):
        return np.inf
    low, high = times[changes[0]], times[changes[0] + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if truth(np.array([middle]))[0] else (middle, high)
    return float(high)


def main(count: int = 1000, seed: int = 0) -> int:
    """Run `count` relations; print those that differ, return how many."""
    random, wrong, told, left = np.random.default_rng(seed), 0, 0, 0
    for index in range(count):
        text, truth = relation(random, int(random.integers(1, _DEEP + 1)))
        at = expected(truth)
        if at is None:
            left += 1
            continue
        runner = Runner(read_text(CHART.format(guard=text, end=END)))
        result = runner.run({})
        fired = [jump.t for jump in result.trace.jumps] or [np.inf]
        if fired[0] == at or abs(fired[0] - at) <= 1e-9:
            continue
        if result.warnings:
            told += 1
        else:
            wrong += 1
            print(f"{index}: {text}: fires at {fired[0]}, not {at}")
    print(f"{count} relations: {wrong} wrong, {told} differ with a warning, {left} left out")
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:])), 1))
