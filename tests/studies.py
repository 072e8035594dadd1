"""Studies made up and measured, and the models that they are of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

from statechart.documents.setting import Setting
from statechart.running.runner import Runner
from statechart.study.measurements import Errors, Point
from statechart.study.study import Study
from statechart.study.trade import trade

# One event in a long smooth motion, so that the integrator decides the error.
OSCILLATOR = """\
kind: chart
name: oscillator
variables: {x: 2, v: 0, w: 0}
regions:
  mass:
    initial: swing
    states: {swing: {flows: {x: v, v: -x, w: 1}}}
    transitions:
      - {name: kick, from: swing, to: swing, guard: w >= 17 + x, updates: {v: -v/2, w: -50}}
stop: {time: 50}
outputs: {t_kick: {value: time, at: first kick}}
"""

# A ball among four discs that overlap: every impact amplifies small differences.
CHAOTIC = """\
kind: scene
name: billiard
gravity: 0
bodies:
  ball: {mass: 1, start: {x: 0, y: 0.1, dx: 1, dy: 0.33}}
surfaces:
  left: {circle: [-2, 0], radius: 1.5}
  right: {circle: [2, 0], radius: 1.5}
  top: {circle: [0, 2], radius: 1.5}
  bottom: {circle: [0, -2], radius: 1.5}
contacts:
  CONTACTS
stop: {time: TIME}
"""


def billiard(end: float) -> str:
    contacts = "\n  ".join(
        f"{name}: {{point: {{body: ball}}, surface: {name}, modes: [free, slide], friction: 0, "
        "restitution: 1}"
        for name in ("left", "right", "top", "bottom")
    )
    return CHAOTIC.replace("CONTACTS", contacts).replace("TIME", f"{end:g}")


def ticking() -> Callable[[], float]:
    """Return a clock that goes on by a thousandth of a second whenever it is looked at."""
    ticks = count()
    return lambda: next(ticks) * 1e-3


def cold(setting: Setting) -> float:
    """Return a fixed time for the first run of a process, without running one."""
    return 0.25


def traded(runner: Runner, *, settings: Sequence[Setting], **more: Any) -> Study:
    """Return a study of settings, without a clock and without further processes."""
    return trade(runner, settings=settings, repeats=1, clock=ticking(), cold=cold, **more)


def scipy(method: str, *powers: int) -> list[Setting]:
    return [Setting(engine="scipy", method=method, tolerance=10.0**-p) for p in powers]


def point(tolerance: float, error: float, seconds: float, **changes: object) -> Point:
    values: dict[str, object] = {
        "setting": Setting(engine="scipy", method="RK45", tolerance=tolerance),
        "outcome": "HORIZON",
        "same_modes": True,
        "diverged": None,
        "parted": None,
        "errors": Errors(state=error, times=0.0, outputs=0.0),
        "seconds": seconds,
        "repeats": 3,
        "cold": seconds,
        "steps": 10,
        "evaluations": 60,
        "flows": 1,
    }
    return Point.model_validate(values | changes)


def study(*points: Point, **changes: object) -> Study:
    values: dict[str, object] = {
        "model": "m",
        "fingerprint": "f",
        "until": 1.0,
        "reference": "taylor 2.2e-16",
        "check": "scipy DOP853 2.3e-14",
        "resolution": Errors(state=1e-13),
        "shift": Errors(state=1e-14),
        "parted": None,
        "planned": len(points),
        "points": points,
    }
    return Study.model_validate(values | changes)
