"""Scenes with controllers, and their runs."""

from __future__ import annotations

import pytest
from runs import ENGINES, engine

from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.documents.yaml_reader import read_text
from statechart.execution.simulator import Simulator
from statechart.loading.kind import kind
from statechart.loading.load import interpret

both = pytest.mark.parametrize("name", ENGINES)

CART = """\
kind: scene
name: cart
parameters: {F: 2, mu: 0.5, g: 10}
gravity: g
bodies:
  cart: {mass: 1}
surfaces:
  ground: {height: 0}
contacts:
  wheel:
    point: {body: cart}
    surface: ground
    modes: [free, slide]
    friction: 0
    restitution: 0
"""
BLOCK = CART.replace("    modes: [free, slide]\n    friction: 0", "    friction: mu")
DRIVE = "forces: {drive: {body: cart, force: [push, 0]}}\n"


def compose(text: str) -> Automaton:
    document = read_text(text, "f.yaml")
    built = kind("scene").automaton(interpret(document))
    assert isinstance(built, Automaton)
    return built


def ran(text: str, name: str, until: float, **parameters: float) -> Trace:
    return Simulator(compose(text), engine(name)).run(parameters, until=until)


def jumps(trace: Trace) -> list[tuple[str, str]]:
    return [(jump.region, jump.cause) for jump in trace.jumps]


# A push over the first metre, a brake until the cart stops, then nothing.
SPRINT = (
    CART
    + DRIVE
    + """\
controls: {push: 0}
regions:
  driver:
    initial: go
    states:
      go: {sets: {push: F}}
      brake: {sets: {push: -F}}
      rest: {}
    transitions:
      - {name: far, from: go, to: brake, guard: cart.x >= 1}
      - {name: halt, from: brake, to: rest, guard: cart.dx <= 0}
outputs:
  pushes: {value: push, at: each driver.far or driver.halt}
  energy_in: {integral: push*cart.dx, during: {driver: go}}
"""
)


STEP = (
    BLOCK
    + DRIVE
    + """\
controls: {push: 0}
regions:
  pusher:
    initial: idle
    states:
      idle: {}
      busy: {sets: {push: F}}
    transitions:
      - {name: start, from: idle, to: busy, guard: time >= 0.7}
"""
)


# Ice under a block on a slope, then grip again.
ICE = """\
kind: scene
name: ice
parameters: {alpha: 0.3, rough: 0.5, smooth: 0.1, g: 10, T: 1, melt: 1.5}
gravity: g
bodies:
  block: {mass: 2}
surfaces:
  slope: {incline: alpha}
contacts:
  base: {point: {body: block}, surface: slope, friction: 2*grip, restitution: 0}
controls: {grip: rough/2}
regions:
  weather:
    initial: dry
    states:
      dry: {}
      icy: {sets: {grip: smooth/2}}
      wet: {}
    transitions:
      - {name: freeze, from: dry, to: icy, guard: time >= T}
      - {name: thaw, from: icy, to: wet, guard: time >= melt}
outputs:
  t_slip: {value: time, at: first base.slip}
  t_stick: {value: time, at: first base.stick}
  mu: {value: 2*grip, at: each weather.icy or weather.wet}
"""


BALL = """\
kind: scene
name: ball
parameters: {h: 1, g: 10, hard: 0.8, soft: 0.25}
gravity: g
coordinates: {y: {start: h}}
bodies:
  ball: {mass: 1, position: [0, y]}
surfaces:
  floor: {height: 0}
contacts:
  skin:
    point: {body: ball}
    surface: floor
    modes: [free, slide]
    friction: 0
    restitution: bounce
controls: {bounce: hard}
regions:
  pump:
    initial: full
    states:
      full: {}
      flat: {sets: {bounce: soft}}
    transitions:
      - {name: puncture, from: full, to: flat, on: skin.touchdown}
outputs:
  speeds: {value: dy, at: each skin.touchdown}
"""


TWO = (
    CART
    + DRIVE
    + """\
controls: {push: 0, gain: 1}
regions:
  motor:
    initial: off
    states:
      off: {}
      on: {sets: {push: gain*F}}
      done: {}
    transitions:
      - {name: start, from: off, to: on, guard: time >= 1}
      - {name: end, from: on, to: done, on: gear.over}
  gear:
    initial: low
    states:
      low: {}
      high: {sets: {gain: 3}}
      over: {sets: {gain: 9}}
    transitions:
      - {name: shift, from: low, to: high, on: motor.on}
      - {name: shift, from: high, to: over, guard: cart.dx >= 3}
"""
)
